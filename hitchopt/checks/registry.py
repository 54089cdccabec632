"""All checks and reports of a certificate, and which of them concern which bodies."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from hitchopt.checks import (
    arena,
    cables,
    clasps,
    clearance,
    convexity,
    crossing,
    drones,
    grips,
    separation,
    stops,
    support,
)
from hitchopt.checks.downwash import DOWNWASH
from hitchopt.checks.linking import CONTINUITY, DURATION, INTERLACING
from hitchopt.checks.rule import CheckRule, FlightReport, Quantity, ReportRule
from hitchopt.checks.swing import SWING
from hitchopt.checks.tracking import TRACKING_RADIUS
from hitchopt.checks.vertex_errors import VERTEX_ERROR
from hitchopt.hitch.pairs import Kind
from hitchopt.slices import check_modules


def _of_slices(kind: str) -> tuple[Any, ...]:
    """Return the rules or reports of a kind of all slices."""
    return tuple(each for module in check_modules() for each in getattr(module, kind, ()))


RULES: tuple[CheckRule, ...] = (
    separation.SEPARATION,
    clearance.CABLE_CLEARANCE,
    crossing.CROSSING,
    *drones.LIMITS,
    cables.CABLE_LENGTH,
    cables.SPAN,
    clasps.EQUILIBRIUM,
    convexity.CONVEXITY,
    arena.ARENA,
    arena.FLOOR,
    clearance.KEEP_OUT,
    DOWNWASH,
    cables.TENSION,
    CONTINUITY,
    INTERLACING,
    clearance.OBJECT_CLEARANCE,
    grips.GRIP,
    grips.YAW,
    support.SUPPORT,
    *_of_slices("RULES"),
    DURATION,
)
"""One rule per check, in the order of a certificate."""

PART_REPORTS: tuple[ReportRule, ...] = (TRACKING_RADIUS, *_of_slices("PART_REPORTS"))
"""Reports of each team whose values of a joined motion follow from those of its parts."""

TEAM_REPORTS = (
    *PART_REPORTS,
    *_of_slices("TEAM_REPORTS"),
    SWING,
    VERTEX_ERROR,
)  # Reports of each team
FLIGHT_REPORTS = (stops.STOPPABLE,)  # Reports of whole flights

REPORTS = (*TEAM_REPORTS, *FLIGHT_REPORTS)
"""Quantities that a certificate reports after its checks, usually without a limit."""

QUANTITIES: tuple[Quantity, ...] = (*RULES, *REPORTS)  # All quantities of certificates
RULE_OF = {rule.name: rule for rule in RULES}  # The rules by name

RULE_OF_KEY = {rule.key: rule for rule in RULES if rule.key.startswith("limits.")}
"""The rules by the key of their limit among ``limits`` of problem files."""

Report = ReportRule | FlightReport

NAMES = tuple(quantity.name for quantity in QUANTITIES)
"""Names of all checks, which custom rules cannot take."""


def distances_of(*kinds: Kind) -> tuple[CheckRule, ...]:
    """Return the rules of distances between bodies of these kinds."""
    return tuple(rule for rule in RULES if any(set(pair) <= set(kinds) for pair in rule.pairs))


def distances_from(*kinds: Kind) -> tuple[CheckRule, ...]:
    """Return the rules of distances of any body from one of these kinds."""
    return tuple(rule for rule in RULES if any(set(pair) & set(kinds) for pair in rule.pairs))


def names_of(rules: Iterable[Quantity]) -> frozenset[str]:
    """Return the names of rules."""
    return frozenset(rule.name for rule in rules)
