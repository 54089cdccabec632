"""A problem: team, limits, a start and a list of steps, checked in shape but not yet planned."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from hitchopt.errors import InputError, UnitWarning
from hitchopt.geometry import Outline
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.cable_slack import FAR_OFF, fitting_polygon
from hitchopt.mission.step_order import fitting_steps
from hitchopt.motion.asked import asked, hitch_start
from hitchopt.objects import SolidObject
from hitchopt.objects.placing import check_placed
from hitchopt.one_line import OneLine
from hitchopt.requirements import Arena, Limits, Requirements, Separation, check_requirements
from hitchopt.steps import Step
from hitchopt.steps.slack_split import SlackSplit, slack_split
from hitchopt.units import HEIGHT, check_unit, warn_of_unit
from hitchopt.values import Array, coordinate, instance, points, sequence, text


@dataclass(frozen=True, eq=False)
class HitchStart(OneLine):
    """Start as a formed hitch.

    Parameters
    ----------
    polygon: its outline, or its points (n, 2) [m] until a Problem knows the topology.
    altitude: [m]
    legs: ``balanced``, ``spread`` or (n,) ``d_k`` [m].
    """

    polygon: Outline
    altitude: float
    legs: SlackSplit = "spread"

    def __post_init__(self) -> None:
        object.__setattr__(self, "altitude", coordinate("altitude", self.altitude))
        check_unit("altitude", self.altitude, HEIGHT)


@dataclass(frozen=True, eq=False)
class DronesStart(OneLine):
    """Start as drones on free cables, at rest: hovering, or on the ground.

    Parameters
    ----------
    q, r: (n, 3) [m], where the drones of every robot are.
    """

    q: Array
    r: Array

    def __post_init__(self) -> None:
        for name in ("q", "r"):
            remedy = "give one point [x, y, z] a robot"
            given = points(name, getattr(self, name), (2, 3), "(n, 3)", remedy)
            object.__setattr__(self, name, given)

    @property
    def drones(self) -> Array:
        """Starts of all drones (2n, 3) [m]: q0, r0, q1, r1, …."""
        return np.stack([self.q, self.r], axis=1).reshape(-1, 3)


Start = HitchStart | Hitch | DronesStart
"""Start as a hitch to be made, as one that is there, or as drones on free cables."""


@dataclass(frozen=True, eq=False)
class Problem(OneLine):
    """All that a planner needs to know.

    Parameters
    ----------
    team, start, mission: who, from where, and the steps in order (at least one).
    limits, separation, arena, title: what to keep, and what to call it.
    objects: by name, those that are carried, or stand in the way.

    Raises
    ------
    InputError: an object that floats or stands in another one, no steps, or some that do not fit
        the team, the outline or one another.
    """

    team: Team
    start: Start
    mission: tuple[Step, ...]
    limits: Limits = field(default_factory=Limits)
    separation: Separation = field(default_factory=Separation)
    arena: Arena | None = None
    title: str = ""
    objects: Mapping[str, SolidObject] = field(default_factory=dict)

    def __post_init__(self) -> None:
        instance("team", self.team, Team)
        instance("start", self.start, HitchStart, Hitch, DronesStart)
        check_requirements(self)
        text("title", self.title)
        steps = sequence("mission", self.mission)
        for i, step in enumerate(steps):
            instance(f"mission[{i}]", step, Step)
        object.__setattr__(self, "objects", named_objects(self.objects))
        if self.objects:
            check_placed(self.objects, self.requirements.floor)
        object.__setattr__(self, "start", fitting_start(self.team, self.start))
        if not steps:
            raise InputError("mission", [], "a list of at least one step", "add a morph or a hold")
        object.__setattr__(
            self, "mission", fitting_steps(self.team, self.start_outline, steps, self.objects)
        )

    @property
    def requirements(self) -> Requirements:
        """What the plan must satisfy."""
        return Requirements(self.limits, self.separation, self.arena, objects=self.objects)

    @property
    def asked(self) -> dict[str, Any]:
        """What its plan is asked, as plan files store it (``hitchopt.motion.asked``).

        Where a hitch starts its drones are not known before it is planned: the polygon is.
        """
        if isinstance(self.start, DronesStart):
            drones = {"q": self.start.q.tolist(), "r": self.start.r.tolist()}
            return asked(self.team, self.requirements, {"drones": drones})
        hitch = hitch_start(self.start.polygon.vertices, self.start.altitude)
        return asked(self.team, self.requirements, {"hitch": hitch})

    @property
    def start_outline(self) -> Outline | None:
        """The outline at the start; None where cables are free."""
        return None if isinstance(self.start, DronesStart) else self.start.polygon


def named_objects(objects: Mapping[str, SolidObject]) -> dict[str, SolidObject]:
    """Return objects by name.

    Raises
    ------
    InputError: they are no mapping of names to objects.
    """
    if not isinstance(objects, Mapping):
        remedy = "write {'box': hitchopt.SolidObject(…)}"
        raise InputError("objects", objects, "a dict of objects by name", remedy)
    for name, body in objects.items():
        instance(f"objects.{name}", body, SolidObject)
    return dict(objects)


def fitting_start(team: Team, start: Start) -> Start:
    """Return the start with its polygon as an outline and its legs as an array, if it is a hitch.

    Raises
    ------
    InputError: a start that does not fit the team; its key is that of the problem file.
    """
    if isinstance(start, Hitch):
        if start.team is not team:
            raise InputError("start", "a hitch", "a hitch of the problem's team", "give its team")
        return start
    key = "hitch" if isinstance(start, HitchStart) else "drones"
    try:
        if isinstance(start, HitchStart):
            outline, legs = fitting_polygon(team, start.polygon), slack_split(start.legs, team)
            return replace(start, polygon=outline, legs=legs)
        for name, given in (("q", start.q), ("r", start.r)):
            if len(given) != team.robots:
                bound = f"a list of {team.robots} points"
                remedy = "add or remove points, or change team.robots"
                raise InputError(name, f"{len(given)} points", bound, remedy)
        apart = np.linalg.norm(start.q - start.r, axis=1)
        k = int(np.argmax(apart / team.cable_length))
        if apart[k] > FAR_OFF * team.cable_length[k]:
            words = f"{apart[k]:.4g} m from q[{k}] on a cable of {team.cable_length[k]:g} m"
            meant = "if millimetres were meant, write metres"
            warn_of_unit(UnitWarning(f"start.drones.r[{k}]", f"{words}; {meant}"))
    except InputError as error:
        raise error.within(f"start.{key}") from None
    return start
