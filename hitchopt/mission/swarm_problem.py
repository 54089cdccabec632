"""A problem of single drones: who flies from where to where, checked in shape, not yet planned."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from hitchopt.errors import InputError
from hitchopt.hitch import Swarm
from hitchopt.motion.asked import asked
from hitchopt.objects import SolidObject
from hitchopt.objects.placing import check_placed
from hitchopt.one_line import OneLine
from hitchopt.requirements import Arena, Limits, Prism, Requirements, Separation, check_requirements
from hitchopt.values import Array, instance, points, positive, sequence, text


@dataclass(frozen=True, eq=False)
class SwarmProblem(OneLine):
    """All that the separation planner needs to know.

    Parameters
    ----------
    team: who.
    start, goal: (N, 3) [m]
    limits, separation, arena, keep_out, title: what to keep, and what to call it.
    duration: of the flight, exactly [s], or None: as fast as is found.
    objects: by name; they stand where they are, and the drones stay off them.

    Raises
    ------
    InputError: not one point per drone, or a point that is not finite.
    """

    team: Swarm
    start: Array
    goal: Array
    limits: Limits = field(default_factory=Limits)
    separation: Separation = field(default_factory=Separation)
    arena: Arena | None = None
    keep_out: tuple[Prism, ...] = ()
    duration: float | None = None
    title: str = ""
    objects: Mapping[str, SolidObject] = field(default_factory=dict)

    @property
    def requirements(self) -> Requirements:
        """What the plan must satisfy."""
        return Requirements(self.limits, self.separation, self.arena, self.keep_out, self.objects)

    @property
    def asked(self) -> dict[str, Any]:
        """What its plan is asked, as plan files store it (``hitchopt.motion.asked``)."""
        return asked(self.team, self.requirements, {"drones": self.start.tolist()})

    def __post_init__(self) -> None:
        instance("team", self.team, Swarm)
        for name in ("start", "goal"):
            bound, remedy = "a list of points [x, y, z]", "give three numbers per drone"
            given = points(name, getattr(self, name), (1, 3), bound, remedy)
            if len(given) != self.team.drones:
                bound = f"{self.team.drones} points, one per drone"
                remedy = "add or remove points, or change team.drones"
                raise InputError(name, f"{len(given)} points", bound, remedy)
            object.__setattr__(self, name, given)
        object.__setattr__(self, "keep_out", sequence("keep_out", self.keep_out))
        check_requirements(self)
        object.__setattr__(self, "objects", dict(self.objects))
        check_placed(self.objects, self.requirements.floor)
        text("title", self.title)
        if self.duration is not None:
            object.__setattr__(self, "duration", positive("duration", self.duration))
