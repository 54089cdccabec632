"""What every kind of step of a mission is: a record with its checks, its planning and its edits."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any, ClassVar, Self

import numpy as np

from hitchopt.errors import InfeasibleError, InputError
from hitchopt.geometry import Outline
from hitchopt.hitch import Team
from hitchopt.hitch.cable_slack import fitting_polygon
from hitchopt.motion.motion import Motion
from hitchopt.one_line import OneLine
from hitchopt.steps.edits import StepEdit, Tunable, lasting_for
from hitchopt.steps.free_cables import lasting
from hitchopt.steps.situation import StepPlan, StepTask
from hitchopt.steps.slack_split import slack_split
from hitchopt.units import DURATION, check_unit
from hitchopt.values import Array, as_array, flag, positive


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
    """What the problem file calls it."""

    summary: ClassVar[str]
    """What it does, in a few words."""

    needs_hitch: ClassVar[bool | None] = True
    """Whether a hitch must be there before it (True), must not (False), or may (None)."""

    blendable: ClassVar[bool] = False
    """Whether it can follow another step, or be followed, without a stop."""

    stages: ClassVar[tuple[Stage, Stage] | None] = (Stage.FREE, Stage.FREE)
    """Where it begins and ends with respect to an object that is carried; None for anywhere."""

    def __post_init__(self) -> None:
        for name in ("blend", "optimize"):
            flag(name, getattr(self, name, False))
        if self.given_duration is not None:
            object.__setattr__(self, "duration", positive("duration", self.given_duration))
            check_unit("duration", vars(self)["duration"], DURATION)

    @classmethod
    def from_file(cls, values: dict[str, Any]) -> Self:
        """Return the step with the values of a problem file, in which angles are in degrees.

        Raises
        ------
        InputError: values that do not go together; its key is the step's own.
        """
        return cls(
            **{
                key.removesuffix("_deg"): math.radians(value) if key.endswith("_deg") else value
                for key, value in values.items()
            }
        )

    @property
    def given_duration(self) -> float | None:
        """How long it takes [s], where it was given that, or None."""
        found: float | None = getattr(self, "duration", None)
        return found

    @property
    def blends(self) -> bool:
        """Whether it goes on into the next step without a stop."""
        return bool(getattr(self, "blend", False))

    def fitting(self, team: Team) -> Self:
        """Return the step with its polygon as an outline and its legs as an array, if it has any.

        Raises
        ------
        InputError: one that does not fit the team.
        """
        given = {key: vars(self).get(key) for key in ("polygon", "legs")}
        fitted: dict[str, Any] = {
            key: fitting_polygon(team, value) if key == "polygon" else slack_split(value, team)
            for key, value in given.items()
            if value is not None
        }
        changed = any(value is not given[key] for key, value in fitted.items())
        return replace(self, **fitted) if changed else self

    def polygon_left(self, team: Team, outline: Outline | None) -> Outline | None:
        """Return the outline after the step; None where there is no hitch.

        Raises
        ------
        InputError: as ``polygon_after``, or a step that needs a hitch where there is none, or none
            where there is one.
        """
        if self.needs_hitch is True and outline is None:
            raise InputError("", "no hitch", "given a hitch at that point", "form one before")
        if self.needs_hitch is False and outline is not None:
            bound = "given drones on free cables at that point"
            raise InputError("", "a hitch", bound, "release it before")
        return self.polygon_after(team, outline)

    def polygon_after(self, team: Team, outline: Any) -> Outline | None:  # noqa: ARG002
        """Return the outline that the step makes of ``outline``, which is there if it needs one.

        Raises
        ------
        InputError: an index beyond the team's, or an outline that is not convex.
        """
        found: Outline | None = outline
        return found

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
        return lasting(motion, self.given_duration, task.index, self.name)

    def part(self, step: Step, task: StepTask) -> StepPlan:
        """Return the plan of another step as a part of this one, which refusals name."""
        try:
            return step.plan(task)
        except InfeasibleError as error:
            inner, own = (f"step {task.index} ({kind.name})" for kind in (step, self))
            told = [replace(v, when=v.when.replace(inner, own)) for v in error.violations]
            raise InfeasibleError(told, error.note) from None

    def advice(self, check: str) -> str:  # noqa: ARG002
        """Return what to change in the step where it breaks a check; nothing if that is unknown."""
        return ""

    def tunables(self) -> Iterator[Tunable]:
        """Yield the numbers that repair may change."""
        if self.given_duration is not None:
            yield lasting_for("duration", self.given_duration, frozenset({"duration"}))

    def scaled(self, factor: float, centre: Array) -> tuple[StepEdit | None, Array]:  # noqa: ARG002
        """Return the edit that scales the step's outline, and the centre of the outline after it.

        Parameters
        ----------
        factor: of all outlines.
        centre: (2,) [m], about which the outline before the step is scaled.
        """
        return None, centre


def convex_outline(team: Team, points: Array, key: str, value: Array | None) -> Outline:
    """Return the points as an outline; an error names the step's ``key`` and its ``value``."""
    try:
        return fitting_polygon(team, points)
    except InputError as error:
        bound = (
            f"such that the outline stays convex and clockwise ({error.key} = {error.value} would "
            f"have to be {error.bound})"
        )
        raise InputError(key, np.asarray(value).tolist(), bound, "go less far") from None


def check_index(key: str, index: object) -> None:
    """Raise InputError for what is no index."""
    if isinstance(index, bool) or not isinstance(index, int | np.integer) or index < 0:
        raise InputError(key, index, "a whole number from 0 on", "indices start at 0")


def check_within(key: str, index: int, count: int) -> None:
    """Raise InputError where ``index`` is none of ``count``."""
    if index >= count:
        raise InputError(key, index, f"from 0 to {count - 1}", "indices start at 0")


def numbers(key: str, value: object, shape: tuple[int | None, ...], words: str) -> Array:
    """Return ``value`` as a read-only array of that shape; None stands for one or more.

    Raises
    ------
    InputError: another shape, described by ``words``, or numbers that are not finite.
    """
    array = as_array(value)
    fits = array.ndim == len(shape) and all(
        size == wanted if wanted is not None else size > 0
        for size, wanted in zip(array.shape, shape, strict=True)
    )
    value = value.tolist() if isinstance(value, np.ndarray) else value
    if not fits:
        raise InputError(key, value, words, "give plain numbers in SI units")
    if not np.all(np.isfinite(array)):
        raise InputError(key, value, "finite", "nan and inf are no quantities")
    array.setflags(write=False)
    return array
