"""What repair may change in a step, and how a file says so."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from hitchopt.checks.registry import RULES
from hitchopt.checks.rule import Ease
from hitchopt.geometry import Outline
from hitchopt.values import Array

DECIMALS = 9
"""Decimals of numbers in edits: far below any tolerance, and short enough to read."""

PLAN_DURATION = "plan duration"
"""The plan's duration as a constraint, told apart from a step's, which is too short."""

SPACE, RATES, FORCES = (
    frozenset(rule.name for rule in RULES if rule.ease is ease)
    for ease in (Ease.LENGTH, Ease.TIME, Ease.TENSION)
)
"""Checks that longer legs, slower or shorter motion, and lower tensions ease."""


@dataclass(frozen=True, eq=False)
class StepEdit:
    """One key of a step with another value.

    Attributes
    ----------
    key: within the step, as the file has it.
    value: to write there, in the file's units.
    changes: the record's fields with their new values.
    """

    key: str
    value: object
    changes: Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class Tunable:
    """A number of a step that repair may raise or lower.

    Attributes
    ----------
    key: within the step, as the file has it.
    old, unit: its value, and the unit of it.
    put: gives the edit to another value.
    raises, lowers: constraints that a larger or a smaller value repairs.
    words: what it is, where the key does not tell.
    """

    key: str
    old: float
    unit: str
    put: Callable[[float], StepEdit]
    raises: frozenset[str] = frozenset()
    lowers: frozenset[str] = frozenset()
    words: str = ""


def lasting_for(key: str, seconds: float, raises: frozenset[str] = frozenset()) -> Tunable:
    """Return the tunable duration [s] of a step."""
    lowers = frozenset({PLAN_DURATION})
    return Tunable(key, seconds, "s", lambda new: StepEdit(key, new, {key: new}), raises, lowers)


def points_scaled(points: Array, factor: float, centre: Array) -> Array:
    """Return the points (…, 2) [m] moved away from ``centre`` by a factor."""
    return np.round(centre + factor * (points - centre), DECIMALS)


def outline_scaled(outline: Outline, factor: float) -> Outline:
    """Return the outline scaled about its centroid."""
    return type(outline)(points_scaled(outline.vertices, factor, outline.centroid))


def outline_edit(outline: Outline, factor: float) -> StepEdit:
    """Return the edit that scales a step's polygon about its centroid."""
    scaled = outline_scaled(outline, factor)
    return StepEdit("polygon", scaled.vertices.tolist(), {"polygon": scaled})
