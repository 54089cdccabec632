"""Kinds of values of steps, and keys that several kinds of steps share."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Annotated, Any, Final, Literal

import numpy as np

from hitchopt.errors import Circumstance, InputError, UnitWarning
from hitchopt.geometry import Outline
from hitchopt.hitch import Team
from hitchopt.hitch.hitch import checked_roll
from hitchopt.hitch.team import MAX_DRONES, MAX_ROBOTS
from hitchopt.planners.ends import SPLIT, SPLIT_TEXT, RolledLegs, SlackSplit
from hitchopt.values import Array, Points, counted, finite, per_robot
from hitchopt.values.fields import (
    FLAGS,
    Key,
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

OBJECT_NAME = strings(50, 1, "[A-Za-z0-9_ -]+", "of letters, digits, spaces, - and _")
POINT2 = points((2,), "x, y")
POINT3 = points((3,), "x, y, z")
SWARM_PLACES = points((None, 3), "x, y, z", 1, MAX_DRONES)
OUTLINE = within_usual(points((None, 2), "x, y", 3, MAX_ROBOTS + 1, Outline), USUAL_OUTLINE, 0.7)
INDEX = integers(0, MAX_ROBOTS - 1)

OUTLINE_TEXT = (
    "Vertices [x, y] [m] of a convex polygon, clockwise seen from above, one per robot; one more "
    "of the convex arc of an open chain"
)
LEGS_TEXT = f"{SPLIT_TEXT}; or a mapping with sharing (one of these) and roll_deg"

TRIANGLE = [[0, -1], [-0.4, 0.5], [0.4, 0.5]]  # [m] Example of an outline

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


MAX_TURNS = 5  # Maximum number of turns in one step: the number of polynomial pieces is bounded
MAX_YAW = MAX_TURNS * 2.0 * math.pi  # [rad] Largest turn of one step


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


def check_count(key: str, places: Array, team: Team) -> None:
    """Raise InputError unless there is one position per drone."""
    if len(places) != team.drones:
        needed = counted(team.drones, "point")
        counts = Circumstance(f"{counted(len(places), 'point')}, not {needed}, one per drone")
        raise InputError(key, counts, needed, "change team.drones, or these")
