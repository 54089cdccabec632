"""Teams, hitches, leg lengths and static equilibrium, independent of time."""

from hitchopt.drones.quadrotor import GRAVITY, Quadrotor
from hitchopt.hitch.hitch import Hitch
from hitchopt.hitch.team import Swarm, Team

__all__ = ["GRAVITY", "Hitch", "Quadrotor", "Swarm", "Team"]
