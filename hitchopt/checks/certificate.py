"""Certificates: a list of checks, each with its worst value over all of the time."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from html import escape
from typing import Any

from hitchopt.errors import HitchoptError, OneLine, Violation, broken_limit, distinct
from hitchopt.values import closest_word

FORMAT = "hitchopt-certificate/1"

TOLERANCE = 1e-9
"""Relative tolerance of checks, to the limit or to the largest length that enters."""


GROUPS = {
    "distances": (
        "separation", "cable_clearance", "crossing", "keep_out", "object_clearance", "arena",
        "tracking_radius",
    ),
    "motion": ("speed", "acceleration", "jerk", "vertex_speed", "body_rate"),
    "forces": ("thrust", "tilt", "equilibrium", "tension", "grip", "support"),
    "cables": ("legs", "cable_length", "span", "convexity", "interlacing"),
    "timing": ("continuity", "stoppable", "survivable", "duration"),
}  # fmt: skip
"""Checks under the headings of the certificate's table; others stand under "other"."""

TIE = 1e-9  # smallest relative difference of utilization between checks that do not tie
# Checks of which faster motion takes more, and how far from its limit one that binds may be: the
# planners' margins and what the search for the worst value adds
PACE, BINDING = (*GROUPS["motion"], "thrust", "tilt"), 0.02
DIGITS, MAX_NAMES = 4, 2  # significant digits of values, and number of names, in a row of a table


class CertificateError(HitchoptError):
    """A plan's certificate shows that a limit is broken."""


def within(limit: float, sense: str, size: float = 1.0, share: float = 1.0) -> float:
    """Return the limit with its tolerance, by the largest length that enters; 1 for no length.

    Searches aim at half of it, the ``share``, and leave rounding the rest.
    """
    slack = share * TOLERANCE * max(abs(limit), size)
    return limit - slack if sense == "min" else limit + slack


@dataclass(frozen=True)
class Check(OneLine):
    """One quantity held against its limit.

    Attributes
    ----------
    name: as in the certificate's table (README).
    holds: whether ``worst`` satisfies the limit, within ``TOLERANCE``.
    worst: bounds the quantity for all t, rounding included; None if nothing was evaluated.
    limit: in the same unit; None if the quantity is only reported.
    sense: ``min`` if the quantity must not fall below the limit, ``max`` if not rise above it.
    unit: such as ``m`` or ``ratio``.
    time: [s], when the quantity is about at its worst.
    where: names of the drones, cables or vertices.
    method: ``continuous`` or ``sampled``.
    gamma: ratio of vertex errors to drone errors, if the quantity assumes one.
    """

    name: str
    holds: bool
    worst: float | None
    limit: float | None
    sense: str
    unit: str
    time: float
    where: tuple[str, ...]
    method: str = "continuous"
    gamma: float | None = None

    @classmethod
    def of(
        cls,
        name: str,
        worst: float,
        limit: float | None,
        sense: str,
        unit: str,
        time: float,
        where: tuple[str, ...],
        size: float = 1.0,
        gamma: float | None = None,
    ) -> Check:
        """Return the check; it holds if it is only reported, or ``within`` its limit by ``size``.

        Infinities become the largest number and nan the worst one: files hold neither. An infinity
        that holds is the extremum of an empty set: then there is no ``worst`` and no place.
        """
        largest, limit = sys.float_info.max, None if limit is None else float(limit)
        if worst == _nothing(sense):
            return cls(name, True, None, limit, sense, unit, float(time), (), gamma=gamma)
        outward = -largest if sense == "min" else largest
        worst = outward if math.isnan(worst) else min(max(float(worst), -largest), largest)
        edge = outward if limit is None else within(limit, sense, size)
        holds = bool(worst >= edge if sense == "min" else worst <= edge)
        return cls(name, holds, worst, limit, sense, unit, float(time), where, gamma=gamma)

    @property
    def row(self) -> dict[str, str]:
        """The row of a table by its columns' heads.

        A worst value within TOLERANCE of 0 is 0; one that breaks its limit differs from it as
        written. A quantity without a limit has its assumption about the vertices in that column.
        """
        worst, limit = "–", "–" if self.gamma is None else f"γ = {self.gamma:g}"
        if self.worst is not None:
            rounding = abs(self.worst) <= TOLERANCE * max(1.0, abs(self.limit or 0.0))
            other = math.nan if self.holds else self.number
            worst = distinct(0.0 if rounding and self.holds else self.worst, other, DIGITS)[0]
        if self.limit is not None:
            limit = f"{'≥' if self.sense == 'min' else '≤'} {self.limit:.{DIGITS}g}"
        more = len(self.where) - MAX_NAMES
        timed = self.worst is not None and math.isfinite(self.time)
        return {
            "check": self.name,
            "worst": worst,
            "limit": limit,
            "unit": "" if self.unit == "1" else self.unit,
            "where": ", ".join(self.where[:MAX_NAMES]) + (f" and {more} more" if more > 0 else ""),
            "when": f"{self.time:.3f} s" if timed else "",
        }

    @property
    def _summary(self) -> tuple[str, float, float, str, str, tuple[str, ...]]:
        return self.name, self.bound, self.number, self.sense, self.unit, self.where

    def violation(self, when: str, remedy: str) -> Violation:
        """Return the check, which does not hold, as a violation."""
        return Violation(*self._summary, when, remedy)

    @property
    def number(self) -> float:
        """The limit; nan if there is none."""
        return math.nan if self.limit is None else self.limit

    @property
    def bound(self) -> float:
        """The worst value; an infinity that holds if nothing was evaluated."""
        return _nothing(self.sense) if self.worst is None else self.worst

    @property
    def utilization(self) -> float:
        """Excess of the worst value over its limit: relative, or absolute if the limit is 0.

        Negative if the check holds with a margin. Without a limit, the signed worst value.
        """
        out = -1.0 if self.sense == "min" else 1.0
        if self.limit is None:
            return out * self.bound
        return out * (self.bound - self.limit) / (abs(self.limit) or 1.0)


def _nothing(sense: str) -> float:
    """Return the extreme value of an empty set."""
    return math.inf if sense == "min" else -math.inf


def worst_of(checks: Iterable[Check | None]) -> Check | None:
    """Return the worst of one quantity's checks over several spans of time; None if empty."""
    worst: Check | None = None
    for check in filter(None, checks):  # of those that tie the first one
        tie = TIE * max(1.0, abs(worst.utilization)) if worst and worst.worst is not None else 0.0
        if worst is None or check.utilization > worst.utilization + tie:
            worst = check
    return worst


@dataclass(frozen=True)
class Certificate(OneLine):
    """All checks of one plan of a duration [s], in the order of the table."""

    duration: float
    checks: tuple[Check, ...]

    def _repr_html_(self) -> str:
        """Return HTML for notebooks: the verdict, and the checks with their worst values."""
        rows = [check.row for check in self.checks]
        violated = ", ".join(check.name for check in self.violated)
        verdict = f"not certified: {violated}" if violated else "certified for all t"
        if violated:
            for check, row in zip(self.checks, rows, strict=True):
                row["holds"] = "yes" if check.holds else "NO"
        table = html_table([*rows[0]], [[*row.values()] for row in rows]) if rows else ""
        return f"<p><b>{escape(verdict)}</b></p>{table}"

    @property
    def groups(self) -> dict[str, tuple[Check, ...]]:
        """The checks under the headings of the table, in its order."""
        heading = {name: title for title, names in GROUPS.items() for name in names}
        groups: dict[str, tuple[Check, ...]] = {}
        for title in (*GROUPS, "other"):
            checks = tuple(c for c in self.checks if heading.get(c.name, "other") == title)
            groups |= {title: checks} if checks else {}
        return groups

    @property
    def binding(self) -> tuple[str, ...]:
        """Names of the checks that bind, the closest first: the plan is as fast as they allow.

        They are those of PACE whose worst value is within 2 % of its limit.
        """
        near = [c for c in self.checks if c.name in PACE and c.utilization >= -BINDING]
        return tuple(check.name for check in sorted(near, key=lambda check: -check.utilization))

    @property
    def certified(self) -> bool:
        """Whether every check holds."""
        return all(check.holds for check in self.checks)

    @property
    def violated(self) -> tuple[Check, ...]:
        """The checks that do not hold."""
        return tuple(check for check in self.checks if not check.holds)

    def __getitem__(self, name: str) -> Check:
        """Return the check of that name, or raise KeyError."""
        by_name = {check.name: check for check in self.checks}
        if name not in by_name:
            raise KeyError(f"no check {name!r}; {closest_word(str(name), [*by_name])}")
        return by_name[name]

    def raise_if_violated(self) -> None:
        """Raise CertificateError naming every check that does not hold."""
        lines = [f"{broken_limit(*c._summary)}, t = {c.time:.4g} s" for c in self.violated]
        if lines:
            raise CertificateError("\n".join(lines))

    def to_dict(self) -> dict[str, Any]:
        """Return the content of ``certificate.json``."""
        return {
            "format": FORMAT,
            "certified": self.certified,
            "duration": self.duration,
            "checks": [_entry(check) for check in self.checks],
        }


def _entry(check: Check) -> dict[str, Any]:
    """Return a check's entry in ``certificate.json``; gamma is left out if None."""
    entry = asdict(check) | {"where": list(check.where)}
    return {key: value for key, value in entry.items() if key != "gamma" or value is not None}


def html_table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return an HTML table with its texts escaped."""
    lines = ["".join(f"<th>{escape(head)}</th>" for head in heads)]
    lines += ["".join(f"<td>{escape(text)}</td>" for text in row) for row in rows]
    return f"<table>{''.join(f'<tr>{line}</tr>' for line in lines)}</table>"
