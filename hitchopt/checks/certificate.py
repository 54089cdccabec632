"""Certificates: lists of checks, each with its worst value over all of the time."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property, partial
from html import escape
from typing import Any

from hitchopt.errors import HitchoptError, OneLine, Violation, broken_limit, distinct
from hitchopt.motion.stated_rules import StatedRule
from hitchopt.tables import table
from hitchopt.values import closest_word

FORMAT = "hitchopt-certificate/1"

TOLERANCE = 1e-9  # Tolerance of checks, relative to the limit or to the largest length that enters


GROUPS = ("distances", "motion", "forces", "cables", "timing")
"""Headings of the certificate's table, in order."""

OTHER = "other"  # Heading of checks of no group
CUSTOM = "custom rules"  # Heading of custom rules, which ``hitchopt verify`` does not prove

CONTINUOUS, SAMPLED = "continuous", "sampled"
"""Methods: bounds for all t, or values at samples of time."""

TIE = 1e-9  # relative difference of utilization up to which checks tie
# Largest margin of a check that binds: planners keep margins, and the search for the worst value
# adds its own
BINDING = 0.02
NOTHING = "nothing to check"  # Place of checks for which nothing was evaluated
DIGITS = 4  # Number of significant digits of values in a table row
MAX_NAMES = 2  # Maximum number of names in a table row


class CertificateError(HitchoptError):
    """A plan's certificate shows a violated limit."""


def with_tolerance(limit: float, sense: str, size: float = 1.0, share: float = 1.0) -> float:
    """Return the limit with its tolerance, for the largest length that enters; 1 without lengths.

    Searches use a ``share`` of one half of the tolerance, and leave the rest for rounding.
    """
    slack = share * TOLERANCE * max(abs(limit), size)
    return limit - slack if sense == "min" else limit + slack


@dataclass(frozen=True)
class Check(OneLine):
    """A quantity and its limit.

    Attributes
    ----------
    name: such as ``separation``.
    holds: whether ``worst`` satisfies the limit, within ``TOLERANCE``.
    worst: bound of the quantity for all t, rounding included, if it is not sampled; an infinity
        that holds if nothing was evaluated, which is null in files.
    limit: in the same unit; None if the quantity is only reported.
    sense: ``min`` if the limit is a lower bound, ``max`` if it is an upper bound.
    unit: such as ``m`` or ``ratio``.
    time: [s], at which the quantity is close to its worst value.
    where: names of the drones, cables or vertices.
    method: CONTINUOUS or SAMPLED.
    gamma: ratio of vertex errors to drone errors, if the quantity assumes one.
    binding: name of the check that determines ``tracking_radius``; empty for other quantities.
    group: heading in the table: one of GROUPS, CUSTOM or OTHER.
    is_error: whether the quantity is an error, titled as such in tables.
    derivative: highest time derivative of positions in the quantity; 0 for none.
    binds_within: largest margin, over the limit, with which it limits a plan's speed.
    """

    name: str
    holds: bool
    worst: float
    limit: float | None
    sense: str
    unit: str
    time: float
    where: tuple[str, ...]
    method: str = CONTINUOUS
    gamma: float | None = None
    binding: str = ""
    group: str = OTHER
    is_error: bool = False
    derivative: int = 0
    binds_within: float = BINDING

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
        binding: str = "",
        **metadata: Any,
    ) -> Check:
        """Return the check; it holds without a limit, or within its tolerance for ``size``.

        Files cannot store infinities and nan: they become the largest number and the worst one. An
        infinite worst value that holds is the extremum of an empty set; ``where`` is then empty.
        ``metadata`` are ``group``, ``is_error``, ``derivative``, ``binds_within`` and ``method``.
        """
        largest = sys.float_info.max
        if limit is not None:
            limit = float(limit)
        if worst == empty_value(sense):
            metadata |= {"gamma": gamma}
            return cls(name, True, float(worst), limit, sense, unit, float(time), (), **metadata)
        outward = -largest if sense == "min" else largest
        worst = outward if math.isnan(worst) else min(max(float(worst), -largest), largest)
        bound = outward if limit is None else with_tolerance(limit, sense, size)
        holds = bool(worst >= bound if sense == "min" else worst <= bound)
        metadata |= {"gamma": gamma, "binding": binding}
        return cls(name, holds, worst, limit, sense, unit, float(time), where, **metadata)

    @property
    def custom(self) -> bool:
        """Return whether it is a custom rule, which ``hitchopt verify`` does not prove."""
        return self.group == CUSTOM

    @property
    def title(self) -> str:
        """The name in tables, which states whether the quantity is an error."""
        return f"{self.name} error" if self.is_error else self.name

    @property
    def row(self) -> dict[str, str]:
        """The row of a table by its columns' headings.

        A worst value within TOLERANCE of 0 is shown as 0, and one that violates its limit with the
        digits that distinguish it. Without a limit, its column shows the assumed gamma. Where
        nothing was evaluated, the place says so.
        """
        further = len(self.where) - MAX_NAMES
        is_timed = self.is_evaluated and math.isfinite(self.time)
        names = ", ".join(self.where[:MAX_NAMES]) if self.is_evaluated else NOTHING
        return {
            "check": self.title,
            "worst": self._worst_in_words,
            "limit": self._limit_in_words,
            "unit": "number" if self.unit == "1" else self.unit,
            "where": f"{names} and {further} more" if further > 0 else names,
            "when": f"{self.time:.3f} s" if is_timed else "",
        }

    @property
    def _worst_in_words(self) -> str:
        """The worst value in tables."""
        if not self.is_evaluated:
            return "–"
        is_rounding = abs(self.worst) <= TOLERANCE * max(1.0, abs(self.limit or 0.0))
        shown = 0.0 if is_rounding and self.holds else self.worst
        violated_limit = math.nan if self.holds else self.number
        return distinct(shown, violated_limit, DIGITS)[0]

    @property
    def _limit_in_words(self) -> str:
        """The limit in tables."""
        if self.limit is not None:
            sign = "≥" if self.sense == "min" else "≤"
            return f"{sign} {self.limit:.{DIGITS}g}"
        return "–" if self.gamma is None else f"γ = {self.gamma:g}"

    @property
    def in_words(self) -> str:
        """The violated limit, its value, place and time in words."""
        broken = broken_limit(self.name, self.worst, self.number, self.sense, self.unit, self.where)
        return f"{broken}, t = {self.time:.4g} s"

    def violation(self, when: str, remedy: str, **known: Any) -> Violation:
        """Return a check that does not hold as a violation; its remedy begins with what binds.

        ``known`` are further fields of the violation.
        """
        if self.binding:
            remedy = f"limited by {self.binding}; {remedy}"
        summary = self.name, self.worst, self.number, self.sense, self.unit, self.where
        return Violation(*summary, when, remedy, **known)

    @property
    def number(self) -> float:
        """The limit; nan if there is none."""
        return math.nan if self.limit is None else self.limit

    @property
    def is_evaluated(self) -> bool:
        """Return whether anything was evaluated."""
        return math.isfinite(self.worst)

    @property
    def utilization(self) -> float:
        """Excess of the worst value over its limit: relative, or absolute if the limit is 0.

        Negative if the check holds with a margin. Without a limit, the signed worst value.
        """
        out = -1.0 if self.sense == "min" else 1.0
        if self.limit is None:
            return out * self.worst
        return out * (self.worst - self.limit) / (abs(self.limit) or 1.0)


def empty_value(sense: str) -> float:
    """Return the extremum of an empty set."""
    return math.inf if sense == "min" else -math.inf


def worst_of(checks: Iterable[Check | None]) -> Check | None:
    """Return the worst of one quantity's checks over several time spans; None if there is none."""
    worst: Check | None = None
    for check in filter(None, checks):
        if worst is None:
            worst = check
            continue
        # Of those that tie, the first one is the worst
        tie = TIE * max(1.0, abs(worst.utilization)) if worst.is_evaluated else 0.0
        if check.utilization > worst.utilization + tie:
            worst = check
    return worst


@dataclass(frozen=True)
class Certificate(OneLine):
    """All checks of a plan with a duration [s], in the order of the table.

    ``limited`` are those with a limit; ``reports`` returns the others, which always hold.
    ``not_recomputed`` are custom rules that the plan states, without their formulas.
    ``flight_digest`` is that of the certified flight (``plan_file.flight_digest``), empty if there
    is none.
    """

    duration: float
    limited: tuple[Check, ...]
    reports: Callable[[], Iterable[Check]] = field(default=tuple, compare=False, repr=False)
    not_recomputed: tuple[StatedRule, ...] = ()
    flight_digest: str = field(default="", compare=False, repr=False)

    @cached_property
    def checks(self) -> tuple[Check, ...]:
        """All checks; reports are evaluated on first access."""
        return (*self.limited, *self.reports())

    def __reduce__(self) -> tuple[Any, ...]:
        """Let certificates be pickled, with their reports evaluated."""
        reports = partial(tuple, self.checks[len(self.limited) :])
        content = self.duration, self.limited, reports, self.not_recomputed, self.flight_digest
        return Certificate, content

    def __str__(self) -> str:
        """Return the table of the checks, by groups, with their worst values over all time.

        If a check fails, a column shows the verdicts; otherwise the last line names the limits that
        bind.
        """
        rows: list[dict[str, object]] = []
        for heading, checks in self.groups.items():
            rows.append({"check": f"{heading}:"})
            for check in checks:
                rows.append({**check.row, "check": f" {check.title}"})
                rows[-1] |= {} if self.certified else {"holds": check.holds}
        text = "\n\n".join([table("Certificate", rows), *self.notes])
        if not (self.certified and self.binding):
            return text
        *names, last = self.binding
        limits = f"{', '.join(names)} and {last} allow" if names else f"{last} allows"
        return f"{text}\n\nas fast as {limits}"

    def _repr_html_(self) -> str:
        """Return HTML for notebooks: the verdict, and the checks with their worst values."""
        rows = [check.row for check in self.checks]
        violated = ", ".join(check.name for check in self.violated)
        verdict = f"not certified: {violated}" if violated else "certified for all t"
        if violated:
            for check, row in zip(self.checks, rows, strict=True):
                row["holds"] = "yes" if check.holds else "NO"
        table = html_table([*rows[0]], [[*row.values()] for row in rows]) if rows else ""
        notes = "".join(f"<p>{escape(note)}</p>" for note in self.notes)
        return f"<p><b>{escape(verdict)}</b></p>{table}{notes}"

    @property
    def groups(self) -> dict[str, tuple[Check, ...]]:
        """The checks under the headings of the table, in its order."""
        groups: dict[str, tuple[Check, ...]] = {}
        for heading in (*GROUPS, OTHER, CUSTOM):
            checks = tuple(check for check in self.checks if check.group == heading)
            if checks:
                groups[heading] = checks
        return groups

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes below the table on custom rules."""
        notes = list[str]()
        custom = [check.name for check in self.limited if check.custom]
        if custom:
            notes.append(f"custom rules, which hitchopt verify does not prove: {', '.join(custom)}")
        if self.not_recomputed:
            stated = ", ".join(map(str, self.not_recomputed))
            notes.append(f"not recomputed: {stated}; pass rules=[…] to hitchopt.certify")
        return tuple(notes)

    @property
    def stated_rules(self) -> tuple[StatedRule, ...]:
        """Its custom rules, as plan files state them."""
        custom = [check for check in self.limited if check.custom]
        return (*map(stated_rule, custom), *self.not_recomputed)

    def stating(self, rules: Iterable[StatedRule]) -> Certificate:
        """Return the certificate with custom rules that a plan states, in place of earlier ones.

        They are not recomputed. A rule whose stated worst value breaks its limit is violated, at an
        unknown time: the start is stated.
        """
        checks, remaining = list[Check](), list[StatedRule]()
        for rule in rules:
            worst = rule.limit if rule.worst is None else rule.worst
            values = worst, rule.limit, rule.sense, rule.unit, 0.0, ()
            check = Check.of(rule.name, *values, group=CUSTOM)
            if check.holds:
                remaining.append(rule)
            else:
                checks.append(check)
        limited = (*self.limited, *checks)
        return replace(self, limited=limited, not_recomputed=tuple(remaining))

    @property
    def binding(self) -> tuple[str, ...]:
        """Names of the checks that limit the plan's speed, closest to its limit first.

        They depend on derivatives of positions, and are within their ``binds_within`` of the limit.
        """
        rates = [check for check in self.limited if check.derivative]
        near = [check for check in rates if check.utilization >= -check.binds_within]
        return tuple(check.name for check in sorted(near, key=lambda check: -check.utilization))

    @property
    def certified(self) -> bool:
        """Return whether every check holds."""
        return all(check.holds for check in self.limited)

    @property
    def violated(self) -> tuple[Check, ...]:
        """The checks that do not hold."""
        return tuple(check for check in self.limited if not check.holds)

    def __getitem__(self, name: str) -> Check:
        """Return the check of that name, or raise KeyError."""
        for check in self.limited:  # reports are computed only if they are asked for
            if check.name == name:
                return check
        for check in self.checks:
            if check.name == name:
                return check
        names = [check.name for check in self.checks]
        raise KeyError(f"no check {name!r}; {closest_word(str(name), names)}")

    def raise_if_violated(self) -> None:
        """Raise CertificateError naming every check that does not hold."""
        if self.violated:
            raise CertificateError("\n".join(check.in_words for check in self.violated))

    def to_dict(self) -> dict[str, Any]:
        """Return the content of ``certificate.json``."""
        content: dict[str, Any] = {
            "format": FORMAT,
            "certified": self.certified,
            "duration": self.duration,
            "checks": [_entry(check) for check in self.checks],
        }
        if self.not_recomputed:
            content["not_recomputed"] = [*map(asdict, self.not_recomputed)]
        return content


def stated_rule(check: Check) -> StatedRule:
    """Return the check of a custom rule as plan files state it."""
    worst = check.worst if check.is_evaluated else None
    return StatedRule(check.name, check.unit, check.sense, check.number, worst)


def _entry(check: Check) -> dict[str, Any]:
    """Return a check's entry in ``certificate.json``; gamma and custom are omitted if unset."""
    entry: dict[str, Any] = {
        "name": check.name,
        "holds": check.holds,
        "worst": check.worst if check.is_evaluated else None,
        "limit": check.limit,
        "sense": check.sense,
        "unit": check.unit,
        "time": check.time,
        "where": list(check.where),
        "method": check.method,
    }
    if check.gamma is not None:
        entry["gamma"] = check.gamma
    if check.custom:
        entry["custom"] = True
    return entry


def html_table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return an HTML table with its texts escaped."""
    lines = [_html_row("th", heads), *(_html_row("td", row) for row in rows)]
    return f"<table>{''.join(lines)}</table>"


def _html_row(tag: str, texts: Iterable[str]) -> str:
    """Return a row of an HTML table, each text in an element of its own."""
    cells = "".join(f"<{tag}>{escape(text)}</{tag}>" for text in texts)
    return f"<tr>{cells}</tr>"
