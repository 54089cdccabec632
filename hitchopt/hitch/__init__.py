"""Floor 2: team, limits, configuration, equilibrium, leg sharing. Knows no time."""

from hitchopt.hitch.configuration import Hitch
from hitchopt.hitch.keep_out import Prism
from hitchopt.hitch.limits import Arena, Limits, Separation
from hitchopt.hitch.swarm import Swarm
from hitchopt.hitch.team import GRAVITY, Quadrotor, Team

__all__ = [
    "GRAVITY",
    "Arena",
    "Hitch",
    "Limits",
    "Prism",
    "Quadrotor",
    "Separation",
    "Swarm",
    "Team",
]
