"""What every kind of step is: a record with its keys, its planning and what repair may change."""

from __future__ import annotations

import math
import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import cache, cached_property
from typing import Any, ClassVar, Literal, Self

import numpy as np

from hitchopt.checks import Certificate, certify
from hitchopt.checks.registry import RULES
from hitchopt.checks.rule import Ease
from hitchopt.errors import InputError, OneLine
from hitchopt.geometry import Outline
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.hitch import fitting_polygon
from hitchopt.hitch.requirements import Requirements
from hitchopt.motion.motion import Motion
from hitchopt.objects import SolidObject
from hitchopt.planners.carrying.grip import GrippedHitch
from hitchopt.planners.carrying.rest import HeldHitch, HoldPolygons
from hitchopt.planners.forming import SwapSettings
from hitchopt.steps.step_keys import keys_of, slack_split
from hitchopt.values import Array

IDLE = 0.01
"""Duration [s] of a step that moves nothing and was given none."""

DECIMALS, LEAST_LEFT = 9, 0.1
"""Decimals of numbers in edits, and share of a quantity that is left where it is lowered."""

PLAN_DURATION = "plan duration"
"""The plan's duration as a constraint, told apart from a step's, which is too short."""


@cache
def eased(by: Literal["length", "time", "tension"]) -> frozenset[str]:
    """Return the checks that longer legs, slower or shorter motion, or lower tensions ease."""
    return frozenset(rule.name for rule in RULES if rule.ease is Ease[by.upper()])


@dataclass(frozen=True)
class Edit(OneLine):
    """What to write into a problem file."""

    key: str  # path such as ``mission[0].morph.polygon``; of a step's own edits, within the step
    value: object  # number, word, list or mapping, in the file's units


Edits = tuple[Edit, ...]
"""Edits that are made together."""


@dataclass(frozen=True, eq=False)
class Knob:
    """A number that repair may raise or lower."""

    key: str  # as the file has it; of a step's number, within the step
    old: float  # its value
    unit: str  # of the value; ``times`` for a factor
    # gives what to write for another value; None for the value itself under the key
    written: Callable[[float], Edits] | None = None
    sign: int = 1  # 1 where it is raised, -1 where it is lowered, to LEAST_LEFT of it at most
    # constraints that it can repair; where others are broken too it is not tried
    covers: frozenset[str] = frozenset()
    words: str = ""  # what it is, where the key does not tell
    extent: float | None = None  # what sizes are relative to [unit]; the old value unless given
    least: float = 0.0  # sizes below are known not to do
    most: float = math.inf  # sizes above make no sense

    def __post_init__(self) -> None:
        if self.sign < 0 and self.extent is None:
            object.__setattr__(self, "most", min(self.most, 1.0 - LEAST_LEFT))

    def edits(self, value: float) -> Edits:
        """Return what to write for another value."""
        return (Edit(self.key, value),) if self.written is None else self.written(value)


def points_scaled(points: Array, factor: float, centre: Array) -> Array:
    """Return the points (…, 2) [m] moved away from ``centre`` by a factor."""
    return np.round(centre + factor * (points - centre), DECIMALS)


def outline_edit(key: str, outline: Outline, factor: float) -> Edit:
    """Return the edit of an outline that is scaled about its centroid."""
    return Edit(key, points_scaled(outline.vertices, factor, outline.centroid).tolist())


@dataclass(frozen=True, eq=False)
class Holding:
    """An object that a hitch is around, or holds."""

    name: str  # of the object
    polygons: HoldPolygons  # of the hitch, in the object's frame
    tension: Array  # (n,) [N], what cables pull with from grasping to loosening
    # the hitch that holds it; None while it is only around it
    held: HeldHitch | GrippedHitch | None = None
    borne: bool = False  # whether clasps carry its weight


@dataclass(frozen=True, eq=False)
class Situation:
    """A moment of rest: a hitch, or drones on free cables."""

    team: Team  # who flies
    drones: Array  # (2n, 3) [m], in the order q0, r0, q1, r1, …
    hitch: Hitch | None = None  # what they hold, or None where cables are free
    # (clasps,), how pairs have turned to form it, 1 where q went up first; a hitch that was there
    # at first is taken to have been formed so
    senses: Array | None = None
    swap: SwapSettings = field(default_factory=SwapSettings)  # the settings of these turns
    # what the hitch is around or holds; ``hitch`` is then as if it carried nothing
    holding: Holding | None = None
    # where objects are by now; None where the problem has them
    objects: Mapping[str, SolidObject] | None = None

    @classmethod
    def formed(cls, hitch: Hitch) -> Situation:
        """Return the situation of a hitch that is there at first."""
        return cls(hitch.team, hitch.drones, hitch)

    def at_objects(self, requirements: Requirements) -> Requirements:
        """Return requirements with objects where they are by now."""
        return requirements if self.objects is None else replace(requirements, objects=self.objects)


@dataclass(frozen=True, eq=False)
class StepPlan:
    """The motion of a step from rest to rest, and the situation after it."""

    motion: Motion
    after: Situation

    @cached_property
    def certificate(self) -> Certificate:
        """Certificate of the motion alone, its duration left open; computed when first needed."""
        return certify(self.motion.untimed, part=True)

    def remarked(self, words: str) -> StepPlan:
        """Return the same plan, the remarks of its phases with these words at their end."""
        phases = [
            replace(phase, remark=f"{phase.remark}; {words}" if phase.remark else words)
            for phase in self.motion.phases
        ]
        made = StepPlan(self.motion.altered(phases=tuple(phases)), self.after)
        if "certificate" in vars(self):  # which tells nothing of remarks
            vars(made)["certificate"] = self.certificate
        return made


@dataclass(frozen=True, eq=False)
class StepTask:
    """What a step is asked to plan."""

    before: Situation  # where the mission stands
    index: int  # of the step in its mission
    requirements: Requirements  # what the plan must satisfy
    optimiser: bool = True  # whether the optimiser may be used

    @property
    def hitch(self) -> Hitch:
        """The hitch to start with; raises InputError where cables are free."""
        if self.before.hitch is None:
            raise InputError(f"mission[{self.index}]", None, "given a hitch", "form one before")
        return self.before.hitch

    @property
    def holding(self) -> Holding:
        """What the hitch is around or holds; raises InputError where that is nothing."""
        if self.before.holding is None:
            words = "around an object", "enclose it before"
            raise InputError(f"mission[{self.index}]", None, *words)
        return self.before.holding

    def within(self, requirements: Requirements, situation: Situation) -> StepTask:
        """Return the same task in another situation, with other requirements."""
        return replace(self, before=situation, requirements=requirements)

    def ended(self, motion: Motion, hitch: Hitch) -> StepPlan:
        """Return the plan of a motion that ends with a hitch."""
        return StepPlan(motion, replace(self.before, hitch=hitch, drones=hitch.drones))


class Stage(StrEnum):
    """How far a hitch is with an object."""

    FREE = "free of objects"
    AROUND = "around an object"
    GRASPED = "holding an object that stands"
    LIFTED = "carrying an object"


@dataclass(frozen=True, eq=False)
class Step(OneLine, ABC):
    """A step of a mission; its fields are annotated with the keys of the problem file."""

    name: ClassVar[str]
    """What the problem file calls it: the name of the class, in words of lower case."""

    needs_hitch: ClassVar[bool | None] = True
    """Whether a hitch must be there before it (True), must not (False), or may (None)."""

    blendable: ClassVar[bool] = False
    """Whether it can follow another step, or be followed, without a stop."""

    stages: ClassVar[tuple[Stage, Stage] | None] = (Stage.FREE, Stage.FREE)
    """Where it begins and ends with respect to an object that is carried; None for anywhere."""

    time_key: ClassVar[str] = "duration"
    """Name of the field that says how long it takes, if it has one."""

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        cls.name = re.sub(r"(?<=.)([A-Z])", r"_\1", cls.__name__).lower()

    def __post_init__(self) -> None:
        for name, (key, default) in keys_of(type(self)).items():
            value = getattr(self, name)
            if key.check is not None and (value is not None or default is not None):
                object.__setattr__(self, name, key.check(name, value))

    @classmethod
    def from_file(cls, values: dict[str, Any]) -> Self:
        """Return the step with the values of a problem file, in which angles are in degrees."""
        return cls(
            **{
                key.removesuffix("_deg"): math.radians(value) if key.endswith("_deg") else value
                for key, value in values.items()
            }
        )

    @property
    def given_duration(self) -> float | None:
        """How long it takes [s], where it was given that, or None."""
        found = getattr(self, self.time_key, None)
        return found if isinstance(found, float) else None

    @property
    def blends(self) -> bool:
        """Whether it goes on into the next step without a stop."""
        return bool(getattr(self, "blend", False))

    def fitting(self, team: Team) -> Self:
        """Return the step with its polygon as an outline and its legs as an array, if they fit."""
        polygon, legs = (vars(self).get(key) for key in ("polygon", "legs"))
        changed: dict[str, Any] = {}
        if polygon is not None:
            changed["polygon"] = fitting_polygon(team, polygon)
        if legs is not None:
            changed["legs"] = slack_split(legs, team)
        return replace(self, **changed) if changed else self

    def polygon_left(self, team: Team, outline: Outline | None) -> Outline | None:
        """Return the outline after the step, None for no hitch; raise InputError if none fits."""
        if self.needs_hitch is True and outline is None:
            raise InputError("", "no hitch", "given a hitch at that point", "form one before")
        if self.needs_hitch is False and outline is not None:
            bound = "given drones on free cables at that point"
            raise InputError("", "a hitch", bound, "release it before")
        return self.polygon_after(team, outline)

    def polygon_after(self, team: Team, outline: Any) -> Outline | None:
        """Return the outline that the step makes of ``outline``: its own polygon, if it has one."""
        own = vars(self).get("polygon", outline)
        return None if own is None else fitting_polygon(team, own)

    @abstractmethod
    def plan(self, task: StepTask) -> StepPlan:
        """Return the plan of the step, from rest to rest.

        Raises
        ------
        InfeasibleError: the end breaks a limit at rest, or no route was found.
        HitchoptError: a planner failed.
        """

    def lasting(self, task: StepTask, motion: Motion) -> Motion:
        """Return the motion slowed to last as long as the step was given, if it was."""
        from hitchopt.planners.timing.flight import check_duration

        duration = self.given_duration
        if duration is None:
            return motion
        check_duration(duration, motion.duration, f"of step {task.index} ({self.name})")
        return motion.slowed(duration / motion.duration)

    def knobs(self) -> Iterator[Knob]:
        """Yield the numbers that repair may change: a duration that was given."""
        seconds = self.given_duration
        if seconds is not None:
            yield Knob(self.time_key, seconds, "s", covers=frozenset({"duration"}))
            covers = frozenset({PLAN_DURATION})
            yield Knob(self.time_key, seconds, "s", sign=-1, covers=covers)

    def scaled(self, factor: float, centre: Array) -> tuple[Edits, Array]:
        """Return the edits that scale its outline by a factor, and the outline's centre after it.

        ``centre`` (2,) [m] is that of the outline before, about which points go; a polygon is
        scaled about its own centroid.
        """
        own: Outline | None = vars(self).get("polygon")
        return (
            ((), centre) if own is None else ((outline_edit("polygon", own, factor),), own.centroid)
        )
