"""Knobs: numbers of a problem file that repair may raise or lower, and edits of the file."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from typing import Literal

import numpy as np

from hitchopt.checks.registry import RULES, distances_from, names_of
from hitchopt.checks.swing import SWING
from hitchopt.errors import OneLine
from hitchopt.geometry import Outline
from hitchopt.hitch.pairs import FIXED
from hitchopt.values import Array

DECIMALS = 9  # Number of decimals of numbers in edits
MIN_REMAINING_SHARE = 0.1  # Minimum fraction of a quantity that lowering leaves

PLAN_DURATION = "plan duration"
"""Constraint that the plan is too long; ``duration`` means that a step is too short."""


@cache
def checks_relaxed_by(by: Literal["length", "time", "tension"]) -> frozenset[str]:
    """Return the checks relaxed by larger lengths, longer times or lower tensions."""
    of_rules = names_of(rule for rule in RULES if rule.ease == by)
    return of_rules | {SWING.name} if by == "time" else of_rules


@dataclass(frozen=True)
class Edit(OneLine):
    """A change of one value in a problem file."""

    key: str  #: Path such as ``mission[0].morph.polygon``; a step's own edits omit the step's path.
    value: object  #: Number, word, list or mapping, in the file's units


Edits = tuple[Edit, ...]  # Edits that are applied together


@dataclass(frozen=True, eq=False)
class Knob:
    """A number that repair may raise or lower."""

    key: str  #: Key in the file; a step's own knobs omit the step's path
    old: float  #: Current value
    unit: str  #: Unit of the value; ``times`` for a factor
    #: Returns the edits for a new value; None for the value itself under the key
    make_edits: Callable[[float], Edits] | None = None
    sign: int = 1  #: 1 to raise the value, -1 to lower it
    #: Constraints that it can repair; it is not tried while others are broken
    covers: frozenset[str] = frozenset()
    words: str = ""  #: Description, if the key is not enough
    extent: float | None = None  #: Reference of relative sizes [unit]; by default the old value
    min_size: float = 0.0  #: Relative size below which changes are known to fail
    max_size: float = math.inf  #: Relative size above which changes make no sense

    def __post_init__(self) -> None:
        if self.sign < 0 and self.extent is None:
            max_size = min(self.max_size, 1.0 - MIN_REMAINING_SHARE)
            object.__setattr__(self, "max_size", max_size)

    def edits(self, value: float) -> Edits:
        """Return the edits for a new value."""
        return (Edit(self.key, value),) if self.make_edits is None else self.make_edits(value)


ALTITUDE_CHECKS = names_of(distances_from(*FIXED)) | {"tracking_radius", "survivable"}
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
