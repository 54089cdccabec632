"""What a certificate says: a list of checks, each with its worst value over all of the time."""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from hitchopt.errors import HitchoptError, InputError, broken_limit

FORMAT = "hitchopt-certificate/1"


TOLERANCE = 1e-9
"""Of a limit, or of the largest length or the unit of what it is of: checks hold within that."""


class CertificateError(HitchoptError):
    """A plan's certificate shows that a limit is broken."""


def within(limit: float, sense: str, size: float = 1.0, share: float = 1.0) -> float:
    """Return the number that keeps a limit to the last digit; what is not beyond it holds.

    Parameters
    ----------
    limit, sense: of a check.
    size: the largest length that enters the quantity, in its unit; 1 for what is no length.
    share: of the tolerance: searches that aim at half of it leave rounding the rest.
    """
    slack = share * TOLERANCE * max(abs(limit), size)
    return limit - slack if sense == "min" else limit + slack


@dataclass(frozen=True)
class Check:
    """One quantity held against its limit.

    Attributes
    ----------
    name: as in the certificate's table (README).
    holds: whether ``worst`` keeps the limit, within ``TOLERANCE``.
    worst: bounds the quantity for all t, rounding included.
    limit: in the same unit.
    sense: ``min`` if the quantity must not fall below the limit, ``max`` if not rise above it.
    unit: such as ``m`` or ``ratio``.
    time: [s], when the quantity is about at its worst.
    where: names of the drones, cables or vertices.
    method: ``continuous`` or ``sampled``.
    """

    name: str
    holds: bool
    worst: float
    limit: float
    sense: str
    unit: str
    time: float
    where: tuple[str, ...]
    method: str = "continuous"

    @classmethod
    def of(
        cls,
        name: str,
        worst: float,
        limit: float,
        sense: str,
        unit: str,
        time: float,
        where: tuple[str, ...],
        size: float = 1.0,
    ) -> Check:
        """Return the check, ``holds`` following from the numbers, within the tolerance.

        ``size`` is the largest length that enters the quantity, in its unit, as ``within`` has it.
        What is beyond all numbers becomes the largest one, and nan the worst: files hold neither.
        """
        largest = sys.float_info.max
        outward = -largest if sense == "min" else largest
        worst = outward if math.isnan(worst) else min(max(float(worst), -largest), largest)
        kept = within(limit, sense, size)
        holds = worst >= kept if sense == "min" else worst <= kept
        return cls(name, bool(holds), worst, float(limit), sense, unit, float(time), where)


def most_pressing(checks: Sequence[Check]) -> Check | None:
    """Return, of one quantity's checks over several spans of time, the worst; None of none."""

    def beyond(check: Check) -> float:
        excess = check.worst - check.limit
        return -excess if check.sense == "min" else excess

    return max(checks, key=beyond, default=None)


@dataclass(frozen=True)
class Certificate:
    """All checks of one plan.

    Attributes
    ----------
    duration: of the plan [s].
    checks: in the order of the table.
    """

    duration: float
    checks: tuple[Check, ...]

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
        for check in self.checks:
            if check.name == name:
                return check
        raise KeyError(name)

    def raise_if_violated(self) -> None:
        """Raise CertificateError naming every check that does not hold."""
        if not self.certified:
            raise CertificateError("\n".join(describe(check) for check in self.violated))

    def to_dict(self) -> dict[str, Any]:
        """Return what ``certificate.json`` holds."""
        return {
            "format": FORMAT,
            "certified": self.certified,
            "duration": self.duration,
            "checks": [
                {
                    "name": c.name,
                    "holds": c.holds,
                    "worst": c.worst,
                    "limit": c.limit,
                    "sense": c.sense,
                    "unit": c.unit,
                    "time": c.time,
                    "where": list(c.where),
                    "method": c.method,
                }
                for c in self.checks
            ],
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Certificate:
        """Return the certificate that ``to_dict`` wrote, or raise InputError."""
        if data.get("format") != FORMAT:
            raise InputError("format", data.get("format"), FORMAT, "use a file that hitchopt wrote")
        checks = tuple(
            Check(**{**entry, "where": tuple(entry["where"])}) for entry in data["checks"]
        )
        return cls(float(data["duration"]), checks)


def describe(check: Check) -> str:
    """Return one sentence on a check that does not hold."""
    broken = broken_limit(
        check.name, check.worst, check.limit, check.sense, check.unit, check.where
    )
    return f"{broken}, t = {check.time:.4g} s"
