"""How a user says where a cable's slack goes: the legs of its two drones, and their roll."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from hitchopt.errors import InputError
from hitchopt.hitch import Team
from hitchopt.hitch.cable_slack import checked_roll
from hitchopt.values import Array, finite, not_negative, per_robot, positive

AUTO = "auto"
"""Word for a roll that is none unless legs without it break a limit."""


@dataclass(frozen=True, eq=False)
class RolledLegs:
    """Legs that are rolled out of their plane.

    Attributes
    ----------
    sharing: how cables share their slack, as without roll.
    roll: (clasps,) [rad]; None for none unless legs break a limit without.
    """

    sharing: Literal["balanced", "spread"] | Array
    roll: Array | None = None


SlackSplit = Literal["balanced", "spread"] | Array | RolledLegs
"""The slack split of a hitch: ``balanced``, ``spread``, or (n,) [m] the q-legs ``d_k``; or one of
these with a roll. Spread legs without one are rolled where they break a limit otherwise."""


def slack_split(
    legs: str | Sequence[float] | ArrayLike | Mapping[str, Any] | RolledLegs, team: Team
) -> SlackSplit:
    """Return what a user wrote for ``legs``, checked.

    Parameters
    ----------
    legs: a mapping has ``sharing`` and ``roll_deg``: ``auto``, one angle, or one per clasp [deg].

    Raises
    ------
    InputError: another word, or a list that does not have one positive length per robot, none of
        them zero but the first of a chain.
    """
    if isinstance(legs, RolledLegs):
        roll = None if legs.roll is None else checked_roll(team, legs.roll)
        return RolledLegs(_sharing(legs.sharing, team), roll)
    if not isinstance(legs, Mapping):
        return _sharing(legs, team)
    unknown = legs.keys() - {"sharing", "roll_deg"}
    if unknown:
        key = f"legs.{min(unknown)}"
        raise InputError(key, legs[min(unknown)], "left out", "use sharing and roll_deg")
    sharing = _sharing(legs.get("sharing", "spread"), team)
    given = legs.get("roll_deg", AUTO)
    if isinstance(given, str):
        if given != AUTO:
            raise InputError("legs.roll_deg", given, "auto, an angle, or a list", "write auto")
        return RolledLegs(sharing)
    clasps = len(team.layout.clasps)
    degrees = per_robot("legs.roll_deg", given, clasps, finite, "clasp")
    worst = float(np.max(np.abs(degrees)))
    if worst >= 90.0:
        raise InputError("legs.roll_deg", worst, "within ±90°", "give a smaller angle")
    return RolledLegs(sharing, checked_roll(team, degrees * (math.pi / 180.0)))


def _sharing(
    legs: str | Sequence[float] | ArrayLike, team: Team
) -> Literal["balanced", "spread"] | Array:
    bound = "balanced, spread or a list of d_k"
    if isinstance(legs, str):
        if legs == "balanced":
            return "balanced"
        if legs == "spread":
            return "spread"
        raise InputError("legs", legs, bound, "write legs: spread")
    if isinstance(legs, int | float):
        raise InputError("legs", legs, bound, "give one length per robot")
    q_legs = per_robot("legs", legs, team.robots, not_negative)
    zero = np.flatnonzero(team.layout.has_leg[:, 0] & (q_legs == 0.0))
    if len(zero) > 0:
        positive(f"legs[{zero[0]}]", 0.0)
    return q_legs
