"""Custom rules as plan files state them: without their formulas, hence not recomputed."""

from __future__ import annotations

import re
from dataclasses import dataclass

from hitchopt.errors import InputError
from hitchopt.values import ByValue, check_choice, finite, line

NAME = re.compile(r"[a-z][a-z0-9_]{0,39}")
SENSES = ("min", "max")
MAX_UNIT = 16  # Maximum number of characters of a unit


@dataclass(frozen=True, eq=False)
class StatedRule(ByValue):
    """A custom rule with the worst value that was certified when its plan was saved.

    Nothing recomputes it without its formula. It is violated if ``worst`` violates the limit, and
    not recomputed otherwise.

    Attributes
    ----------
    name, unit, sense, limit: as in ``Rule``.
    worst: stated bound of the quantity for all t; None if nothing was evaluated, or the plan has
        changed since.

    Raises
    ------
    InputError: an argument is invalid.
    """

    name: str
    unit: str
    sense: str
    limit: float
    worst: float | None = None

    def __post_init__(self) -> None:
        if not NAME.fullmatch(line("name", self.name)):
            bound = "lower-case letters, digits and _, at most 40"
            raise InputError("name", self.name, bound, "write one such as leg_angle")
        if not 0 < len(line("unit", self.unit)) <= MAX_UNIT:
            bound = f"of 1 to {MAX_UNIT} characters"
            raise InputError("unit", self.unit, bound, "write a unit such as deg; 1 for ratios")
        check_choice("sense", self.sense, SENSES)
        object.__setattr__(self, "limit", finite("limit", self.limit))
        if self.worst is not None:
            object.__setattr__(self, "worst", finite("worst", self.worst))

    def __str__(self) -> str:
        unit = "" if self.unit == "1" else f" {self.unit}"
        sign = "≥" if self.sense == "min" else "≤"
        worst = "no value" if self.worst is None else f"{self.worst:.4g}{unit}"
        return f"{self.name} ({worst}, limit {sign} {self.limit:.4g}{unit})"
