"""Base class of steps: records with keys, planning and the knobs of repair."""

from __future__ import annotations

import math
import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cache
from typing import Annotated, Any, ClassVar, Final, Literal, Self

import numpy as np

from hitchopt.checks.registry import RULES
from hitchopt.errors import Circumstance, InputError, OneLine, UnitWarning
from hitchopt.geometry import Outline
from hitchopt.hitch import Team
from hitchopt.hitch.hitch import checked_polygon, checked_roll
from hitchopt.hitch.pairs import FIXED
from hitchopt.hitch.requirements import Separation
from hitchopt.hitch.team import MAX_ROBOTS
from hitchopt.motion.motion import Motion, Phase
from hitchopt.objects import SolidObject
from hitchopt.planners.carrying.moves import Move
from hitchopt.planners.carrying.planner import GraspState
from hitchopt.planners.ends import SPLIT, SPLIT_TEXT, RolledLegs, SlackSplit
from hitchopt.planners.task import StepPlan, StepTask, slowed_to_duration
from hitchopt.values import Array, Points, finite, per_robot
from hitchopt.values.fields import (
    FLAGS,
    Key,
    Record,
    either,
    integers,
    mapping_of,
    points,
    strings,
    words,
)
from hitchopt.values.units import (
    DURATION,
    LENGTH,
    LENGTH_OR_ZERO,
    USUAL_OUTLINE,
    quantity,
    warn_of_unit,
    within_usual,
)

# Kinds of values, and fields shared by several kinds of steps.

OBJECT_NAME = strings(50, 1, "[A-Za-z0-9_ -]+", "of letters, digits, spaces, - and _")
POINT2 = points((2,), "x, y")
POINT3 = points((3,), "x, y, z")
OUTLINE = within_usual(points((None, 2), "x, y", 3, MAX_ROBOTS + 1, Outline), USUAL_OUTLINE, 0.7)
INDEX = integers(0, MAX_ROBOTS - 1)

OUTLINE_TEXT = (
    "Vertices [x, y] [m] of a convex polygon, clockwise seen from above, one per robot; one more "
    "of the convex arc of an open chain"
)
LEGS_TEXT = f"{SPLIT_TEXT}; or a mapping with sharing (one of these) and roll_deg"

TRIANGLE = [[0, -1], [-0.4, 0.5], [0.4, 0.5]]
"""[m] Example of an outline."""

AUTO: Final = "auto"
"""Automatic choice of a duration, or of a roll that is zero unless limits require one."""

LEGS = either(SPLIT, mapping_of(RolledLegs))

Legs = str | Points | Mapping[str, Any] | RolledLegs
"""Legs as arguments: a mode, q-legs ``d_k`` (n,) [m], or these with a roll."""


def slack_split(legs: Legs, team: Team) -> SlackSplit:
    """Return the checked value of ``legs``.

    A mapping has ``sharing`` and ``roll_deg``: ``auto``, one angle, or one per clasp [deg]. A list
    has one positive length per robot; the first length of a chain may be zero.
    """
    split = LEGS.check("legs", legs)
    if not isinstance(split, RolledLegs):
        return _checked_sharing(split, team)
    roll = split.roll
    if roll is not None:
        clasps = len(team.layout.clasps)
        roll = checked_roll(team, per_robot("legs.roll_deg", roll, clasps, finite, "clasp"))
    return RolledLegs(_checked_sharing(split.sharing, team), roll)


def _checked_sharing(legs: Any, team: Team) -> Literal["balanced", "spread"] | Array:
    """Return a word, or checked q-legs (n,) [m]."""
    if isinstance(legs, str):
        return "balanced" if legs == "balanced" else "spread"
    q_legs = per_robot("legs", legs, team.robots, LENGTH_OR_ZERO.check)
    zero = np.flatnonzero(team.layout.has_leg[:, 0] & (q_legs == 0.0))
    if len(zero) > 0:
        LENGTH.check(f"legs[{zero[0]}]", 0.0)
    return q_legs


def shown_legs(legs: object) -> dict[str, Any]:
    """Return the lengths of q-legs (n,) [m] that a key ``legs`` states; nothing for a word."""
    sharing = legs.sharing if isinstance(legs, RolledLegs) else legs
    return {} if sharing is None or isinstance(sharing, str) else {"legs": sharing}


MAX_TURNS = 5
"""Maximum number of turns in one step: the number of polynomial pieces is bounded."""

MAX_YAW = MAX_TURNS * 2.0 * math.pi
"""[rad] Largest turn of one step."""


def _turn_angle(key: str, value: object) -> float:
    """Return a yaw angle [rad] within MAX_TURNS; warn if it seems to be in degrees."""
    yaw = finite(key, value)
    suggestion = f"if degrees were meant, {math.radians(yaw):.3g}"
    if abs(yaw) > MAX_YAW:
        bound = f"at most {MAX_TURNS} turns either way"
        raise InputError(key, yaw, bound, f"turn in several steps; {suggestion}")
    if abs(yaw) > 2.0 * math.pi and yaw == round(yaw):  # rare in radians
        warn_of_unit(UnitWarning(key, f"{yaw:g} rad, more than a turn; {suggestion}"))
    return yaw


TURN = replace(quantity("rad", (-MAX_YAW, MAX_YAW), (-MAX_YAW, MAX_YAW)), check=_turn_angle)
AUTO_SECONDS = either(words(AUTO), DURATION)
SETTLE_TEXT = (
    "Duration of the over-travels that end the step where cables slid against friction, added to "
    "its duration; auto: as far as limits allow; or false"
)

Seconds = Annotated[
    float | None, Key(DURATION, "Exact duration; default: as fast as the limits allow")
]
Blend = Annotated[
    bool,
    Key(FLAGS, "Continue into the next step without a stop; their durations are then least ones"),
]
SettleAtEnd = Annotated[
    float | Literal["auto", False], Key(either(AUTO_SECONDS, words(False)), SETTLE_TEXT)
]
LegsAtEnd = Annotated[Legs | None, Key(LEGS, f"{LEGS_TEXT}, at the step's end")]
WhichPoint = Annotated[int, Key(INDEX, "Index, from 0", 0)]
ObjectOf = Annotated[str, Key(OBJECT_NAME, "Name of the object", "box")]
Place = Annotated[Points, Key(POINT3, "Goal [x, y, z] of its base [m]", [1, 0, 0])]
Yaw = Annotated[float, Key(TURN, "Rotation, counter-clockwise")]
Polygon = Annotated[Outline | Points, Key(OUTLINE, OUTLINE_TEXT, TRIANGLE)]


# Records of repair.

DECIMALS = 9
"""Number of decimals of numbers in edits."""

MIN_REMAINING_SHARE = 0.1
"""Minimum fraction of a quantity that lowering leaves."""

PLAN_DURATION = "plan duration"
"""Constraint that the plan is too long; ``duration`` means that a step is too short."""


@cache
def checks_relaxed_by(by: Literal["length", "time", "tension"]) -> frozenset[str]:
    """Return the checks relaxed by larger lengths, longer times or lower tensions."""
    return frozenset(rule.name for rule in RULES if rule.ease == by)


@dataclass(frozen=True)
class Edit(OneLine):
    """A change of one value in a problem file."""

    key: str
    """Path such as ``mission[0].morph.polygon``; a step's own edits omit the step's path."""

    value: object
    """Number, word, list or mapping, in the file's units."""


Edits = tuple[Edit, ...]
"""Edits that are applied together."""


@dataclass(frozen=True, eq=False)
class Knob:
    """A number that repair may raise or lower."""

    key: str
    """Key in the file; a step's own knobs omit the step's path."""

    old: float
    """Current value."""

    unit: str
    """Unit of the value; ``times`` for a factor."""

    make_edits: Callable[[float], Edits] | None = None
    """Returns the edits for a new value; None for the value itself under the key."""

    sign: int = 1
    """1 to raise the value, -1 to lower it."""

    covers: frozenset[str] = frozenset()
    """Constraints that it can repair; it is not tried while others are broken."""

    words: str = ""
    """Description, if the key is not enough."""

    extent: float | None = None
    """Reference of relative sizes [unit]; by default the old value."""

    min_size: float = 0.0
    """Relative size below which changes are known to fail."""

    max_size: float = math.inf
    """Relative size above which changes make no sense."""

    def __post_init__(self) -> None:
        if self.sign < 0 and self.extent is None:
            max_size = min(self.max_size, 1.0 - MIN_REMAINING_SHARE)
            object.__setattr__(self, "max_size", max_size)

    def edits(self, value: float) -> Edits:
        """Return the edits for a new value."""
        return (Edit(self.key, value),) if self.make_edits is None else self.make_edits(value)


ALTITUDE_CHECKS = frozenset(
    rule.name for rule in RULES if any(not FIXED.isdisjoint(pair) for pair in rule.pairs)
) | {"tracking_radius", "survivable"}
"""Constraints that another altitude may repair."""


def altitude_knobs(key: str, altitude: float) -> Iterator[Knob]:
    """Yield the knobs that raise and lower an altitude [m]; one at the ground is only raised."""
    if altitude > 0.0:
        knob = Knob(key, altitude, "m", covers=ALTITUDE_CHECKS)
        yield knob
        yield replace(knob, sign=-1)
    else:
        yield Knob(key, altitude, "m", covers=ALTITUDE_CHECKS, extent=1.0)


def scaled_points(points: Array, factor: float, centre: Array) -> Array:
    """Return points (…, 2) [m] scaled about ``centre``."""
    return np.round(centre + factor * (points - centre), DECIMALS)


def scaled_outline_edit(key: str, outline: Outline, factor: float, centre: Array) -> Edit:
    """Return the edit that scales an outline about ``centre``."""
    return Edit(key, scaled_points(outline.vertices, factor, centre).tolist())


class Stage(StrEnum):
    """Stage of a hitch with respect to an object, or to an open vertex."""

    FREE = "no object"
    OPEN = "an open vertex"
    AROUND = "an enclosed object"
    GRASPED = "a grasped object"
    LIFTED = "a lifted object"


@dataclass(frozen=True, eq=False)
class Step(Record, ABC):
    """A step of a mission; its fields are annotated with the keys of the problem file."""

    name: ClassVar[str]
    """Key in the problem file: the class's name in snake case."""

    needs_hitch: ClassVar[bool | None] = True
    """True if the step starts with a hitch, False if on free cables, None for either."""

    blendable: ClassVar[bool] = False
    """True if the step can precede or follow another one without a stop."""

    stages: ClassVar[tuple[Stage, Stage] | None] = (Stage.FREE, Stage.FREE)
    """Stages at the start and the end; None if the stage does not matter."""

    time_key: ClassVar[str] = "duration"
    """Field of the prescribed duration."""

    object_key: ClassVar[str] = "object"
    """Key in the problem file of the name of its object."""

    of_single_drones: ClassVar[bool] = False
    """True if the step is for single drones without cables."""

    of_two_robots: ClassVar[bool] = False
    """True if teams of two robots support the step; their cables form a hitch only around an
    object."""

    effort_per_robot: ClassVar[float] = 2e5
    """Effort to plan the step, per robot, beyond which no further candidate is tried."""

    moves_points: ClassVar[bool] = False
    """True if the step moves single points of an outline, which the file then has to state."""

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        cls.name = re.sub(r"(?<=.)([A-Z])", r"_\1", cls.__name__).lower()

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
    def rolls_pairs(self) -> bool:
        """Return whether pairs of drones roll by half a turn, one above the other."""
        return False

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

    def plan_of_moves(self, task: StepTask, grasp: GraspState, moves: Sequence[Move]) -> StepPlan:
        """Return the plan of consecutive moves to a grasp, in the prescribed duration.

        Their laws are slowed down, not their curves: legs tilt with the object's acceleration.
        """
        from hitchopt.planners.timing.timed_motion import check_duration

        duration = self.prescribed_duration
        if duration is not None:
            fastest = sum(move.law.duration for move in moves)
            check_duration(duration, fastest, f"of step {task.index} ({self.name})")
            moves = [replace(move, law=move.law.slowed(duration / fastest)) for move in moves]
        motion = task.held.motion(moves, self.name)
        last = moves[-1]
        return task.plan_with_object(motion, grasp, last.end, last.below[1])

    def knobs(self) -> Iterator[Knob]:
        """Yield the numbers that repair may change: a prescribed duration."""
        seconds = self.prescribed_duration
        if seconds is not None:
            longer = Knob(self.time_key, seconds, "s", covers=frozenset({"duration"}))
            yield longer
            yield replace(longer, sign=-1, covers=frozenset({PLAN_DURATION}))

    def scaled(self, factor: float, centre: Array) -> tuple[Edits, Array]:
        """Return the edits that scale its geometry about ``centre``, and that of later steps.

        Centres are (2,) [m]: one point until the hitch is carried elsewhere or formed again.
        """
        if self.goal_outline is None:
            return (), centre
        return (scaled_outline_edit("polygon", self.goal_outline, factor, centre),), centre
