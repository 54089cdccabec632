"""Base class of steps."""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any, ClassVar, Literal, Self

from hitchopt.checks.swing import SWING
from hitchopt.errors import Circumstance, InputError
from hitchopt.geometry import Outline
from hitchopt.hitch import Team
from hitchopt.hitch.hitch import checked_polygon
from hitchopt.hitch.requirements import Requirements, Separation
from hitchopt.hitch.team import Assignment
from hitchopt.motion.motion import Motion, Phase
from hitchopt.objects import SolidObject
from hitchopt.planners.ends import SlackSplit
from hitchopt.planners.task import StepPlan, StepTask, slowed_to_duration
from hitchopt.steps.keys import slack_split
from hitchopt.steps.knob import PLAN_DURATION, Edits, Knob, scaled_outline_edit
from hitchopt.values import Array
from hitchopt.values.fields import Record


def key_of(name: str) -> str:
    """Return the key in problem files of a record of steps: its name in snake case."""
    return re.sub(r"(?<=.)([A-Z])", r"_\1", name).lower()


class Stage(StrEnum):
    """Stage of a hitch with respect to an object."""

    FREE = "no object"
    AROUND = "an enclosed object"
    GRASPED = "a grasped object"
    LIFTED = "a lifted object"


@dataclass(frozen=True, eq=False)
class Step(Record, ABC):
    """A step of a mission; its fields are annotated with the keys of the problem file."""

    name: ClassVar[str]  #: Key in the problem file: the class's name in snake case
    #: True if the step starts with a hitch, False if on free cables, None for either
    needs_hitch: ClassVar[bool | None] = True
    #: True if the step can precede or follow another one without a stop
    blendable: ClassVar[bool] = False
    #: Stages at the start and the end; None if the stage does not matter
    stages: ClassVar[tuple[Stage, Stage] | None] = (Stage.FREE, Stage.FREE)
    time_key: ClassVar[str] = "duration"  #: Field of the prescribed duration
    object_key: ClassVar[str] = "object"  #: Key in the problem file of the name of its object
    #: True if the step is for single drones without cables
    of_single_drones: ClassVar[bool] = False

    #: Effort to plan the step, per robot, beyond which no further candidate is tried
    effort_per_robot: ClassVar[float] = 2e5
    #: True if the step moves single points of an outline, which the file then has to state
    moves_points: ClassVar[bool] = False

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        cls.name = key_of(cls.__name__)

    @property
    def prescribed_duration(self) -> float | None:
        """The prescribed duration [s], or None."""
        seconds = getattr(self, self.time_key, None)
        return seconds if isinstance(seconds, float) else None

    @property
    def goal_outline(self) -> Outline | None:
        """The polygon that a resolved step states; None if it states none."""
        outline: Outline | None = vars(self).get("polygon")
        return outline

    @property
    def object_name(self) -> str | None:
        """Name of the object that it states; None if it states none."""
        name: str | None = getattr(self, "object", None)
        return name

    @property
    def split(self) -> SlackSplit | None:
        """The slack split that a resolved step states; None if it states none."""
        legs: SlackSplit | None = vars(self).get("legs")
        return legs

    @property
    def blends(self) -> bool:
        """Return whether it continues into the next step without a stop."""
        return bool(getattr(self, "blend", False))

    @property
    def settling(self) -> float | Literal["auto", False]:
        """Duration of the over-travels at its end [s], ``auto``, or False for none."""
        return getattr(self, "settle", False)

    def resolved_for(self, team: Team) -> Self:
        """Return the step for a team: polygon as an outline, legs as an array."""
        checked: dict[str, Any] = {}
        if self.goal_outline is not None:
            checked["polygon"] = checked_polygon(team, self.goal_outline)
        if self.split is not None:
            checked["legs"] = slack_split(self.split, team)
        return replace(self, **checked) if checked else self

    def checked_polygon_after(
        self, team: Team, outline: Outline | None, reason: str = "as start states"
    ) -> Outline | None:
        """Return ``polygon_after``; raise InputError if the step needs, or forbids, a hitch.

        ``reason`` explains why there is a hitch before the step, or none.
        """
        if self.needs_hitch is True and outline is None:
            bound = "given a hitch at that point"
            missing = Circumstance("there is no hitch at that point")
            raise InputError("", missing, bound, f"{reason}: form one first")
        if self.needs_hitch is False and outline is not None:
            bound = "given drones on free cables at that point"
            tied = Circumstance("there is a hitch at that point")
            raise InputError("", tied, bound, f"{reason}: release it first")
        return self.polygon_after(team, outline)

    def polygon_after(self, team: Team, outline: Any) -> Outline | None:
        """Return the outline after the step: its own polygon, if it has one, else ``outline``."""
        polygon = outline if self.goal_outline is None else self.goal_outline
        return None if polygon is None else checked_polygon(team, polygon)

    def place_after(self, body: SolidObject, below: float) -> Array | None:  # noqa: ARG002
        """Return the goal of a held object's base: x, y, z [m], yaw [rad]; None if it stays.

        ``below`` is the height of the surface below it [m].
        """
        return None

    def advice(self, check: str, key: str) -> str:  # noqa: ARG002
        """Return specific advice if its motion violates a check; ``key`` is its key in files.

        ``check`` is the name of the check that binds, or the key of a wall of the arena.
        """
        return ""

    def least_increase(
        self,
        knob: Knob,  # noqa: ARG002
        objects: Mapping[str, SolidObject],  # noqa: ARG002
        names: Sequence[str],  # noqa: ARG002
        separation: Separation,  # noqa: ARG002
    ) -> float:
        """Return the relative size below which an increase of a knob cannot repair violations.

        ``names`` are the bodies that violations concern.
        """
        return 0.0

    @abstractmethod
    def plan(self, task: StepTask) -> StepPlan:
        """Return the plan of the step, from rest to rest.

        Raises InfeasibleError if the end breaks a limit at rest or no feasible route was found,
        HitchoptError if a planner failed.
        """

    def phase(self, task: StepTask) -> Phase:
        """Return the phase of the step, which planners retime."""
        return Phase(self.name, task.index, 0.0, 0.0)

    def with_duration(self, task: StepTask, motion: Motion) -> Motion:
        """Return the motion slowed down to the prescribed duration, if there is one."""
        return slowed_to_duration(motion, self.prescribed_duration, self.phase(task))

    @property
    def assigns_in_order(self) -> bool | None:
        """Return whether robot k takes edge k; None if the step ties no hitch."""
        return None

    def assignment(self, team: Team, drones: Array, requirements: Requirements) -> Assignment:  # noqa: ARG002
        """Return the assignment of robots to edges that a step makes which ties a hitch."""
        return Assignment.fixed(team.robots)

    def knobs(self) -> Iterator[Knob]:
        """Yield the numbers that repair may change: a prescribed duration."""
        seconds = self.prescribed_duration
        if seconds is not None:
            longer = Knob(self.time_key, seconds, "s", covers=frozenset({"duration", SWING.name}))
            yield longer
            yield replace(longer, sign=-1, covers=frozenset({PLAN_DURATION}))

    def scaled(self, factor: float, centre: Array) -> tuple[Edits, Array]:
        """Return the edits that scale its geometry about ``centre``, and that of later steps.

        Centres are (2,) [m]: one point until the hitch is carried elsewhere or formed again.
        """
        if self.goal_outline is None:
            return (), centre
        return (scaled_outline_edit("polygon", self.goal_outline, factor, centre),), centre
