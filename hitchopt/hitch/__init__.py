"""Teams, hitches, leg lengths and equilibrium; knows no time."""

from hitchopt.hitch.hitch import Hitch
from hitchopt.hitch.swarm import Swarm
from hitchopt.hitch.team import GRAVITY, Quadrotor, Team

__all__ = ["GRAVITY", "Hitch", "Quadrotor", "Swarm", "Team"]
