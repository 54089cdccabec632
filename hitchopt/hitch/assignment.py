"""Assignment of robots to roles, of which role k holds edge k."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hitchopt.errors import InputError, OneLine
from hitchopt.hitch.team import Team
from hitchopt.values import Array, sequence, whole


@dataclass(frozen=True)
class Assignment(OneLine):
    """An assignment of robots to roles.

    Parameters
    ----------
    robots: for every role the robot that flies it, each once.
    flipped: for every role whether that robot's q and r are exchanged.

    Raises
    ------
    InputError: no such assignment.
    """

    robots: tuple[int, ...]
    flipped: tuple[bool, ...]

    def __post_init__(self) -> None:
        for name in ("robots", "flipped"):
            object.__setattr__(self, name, sequence(f"assignment.{name}", getattr(self, name)))
        n = len(self.robots)
        for i, robot in enumerate(self.robots):
            whole(f"assignment.robots[{i}]", robot, 0)
        if sorted(self.robots) != list(range(n)):
            raise InputError("assignment.robots", self.robots, f"0 to {n - 1}, each once", "sort")
        if len(self.flipped) != n:
            bound = f"{n} truth values"
            raise InputError("assignment.flipped", self.flipped, bound, "give one per role")

    @classmethod
    def fixed(cls, robots: int) -> Assignment:
        """Return the assignment under which robot k flies role k as it is."""
        return cls(tuple(range(robots)), (False,) * robots)

    def to_dict(self) -> dict[str, object]:
        """Return the assignment as files store it."""
        return {"robots": list(self.robots), "flipped": list(self.flipped)}

    def team(self, team: Team) -> Team:
        """Return the team in the order of its roles."""
        order = list(self.robots)
        return replace(
            team,
            cable_length=team.cable_length[order],
            tension=team.tension[order],
            quadrotor=tuple(team.quadrotor[i] for i in order),
        )

    def drones(self, drones: Array) -> Array:
        """Return robots' drones (2n, 3) in the order of their roles."""
        pairs = drones.reshape(-1, 2, 3)[list(self.robots)]
        flipped = np.array(self.flipped, dtype=np.bool_)
        pairs = np.where(flipped[:, None, None], pairs[:, ::-1], pairs)
        ordered: Array = pairs.reshape(-1, 3)
        return ordered
