"""The report of ``lint`` on the terminal."""

from __future__ import annotations

import math
from collections import Counter
from typing import TYPE_CHECKING, Any

from hitchopt.cli.output import say
from hitchopt.exports.formats.crazyflie_memory import BYTES
from hitchopt.exports.lint.findings import ERROR, WARNING

if TYPE_CHECKING:
    from hitchopt.exports.lint.findings import Report

MAX_SHOWN = 5
"""Number of findings of one rule that are shown; the rest are counted."""


def say_report(report: Report) -> None:
    """Write the contents of the files, then the findings, then their number."""
    facts, flight = report.facts, report.flight
    frame = f", frame {report.frame}" if report.frame else ""
    drones = "drone" if len(facts) == 1 else "drones"
    say(f"{report.path}: {report.kind}, {len(facts)} {drones}{frame}, {flight.duration:.3f} s")
    pieces = [fact.pieces for fact in facts if fact.pieces]
    if pieces:
        say(f"  pieces        {_span(pieces)} per drone")
    sizes = [fact.size for fact in facts if fact.size]
    if sizes:
        say(f"  memory        {_span(sizes)} of {BYTES} bytes per drone")
    say(f"  speed         {_against(flight.speed, flight.speed_limit)} m/s")
    if math.isfinite(flight.acceleration):
        say(f"  acceleration  {_against(flight.acceleration, flight.acceleration_limit)} m/s²")
    for check in flight.own:
        say(f"  {check.name:<13} {check.bound:.4g} of {check.limit:g} {check.unit}, the show's own")
    if math.isfinite(flight.separation):
        say(f"  separation    {flight.separation:.4g}, 1 where ellipsoids touch")
    jumps = ", ".join(
        f"{size:.2g} {unit}" for size, unit in zip(flight.jumps, ("m", "m/s", "m/s²"), strict=False)
    )
    say(f"  jumps         {jumps} where pieces join")
    say(f"  reach         {flight.reach:.4g} m from the origin")
    said: Counter[tuple[str, str]] = Counter()
    for finding in report.findings:
        key = (finding.level, finding.rule)
        said[key] += 1
        if said[key] <= MAX_SHOWN:
            say(str(finding), err=finding.level == ERROR)
    for (level, rule), count in said.items():
        if count > MAX_SHOWN:
            say(f"{level}: {rule}: and {count - MAX_SHOWN} more", err=level == ERROR)
    errors = sum(finding.level == ERROR for finding in report.findings)
    warnings = sum(finding.level == WARNING for finding in report.findings)
    say(f"{errors} errors, {warnings} warnings")


def report_entry(report: Report) -> dict[str, Any]:
    """Return a report as ``--json`` prints it."""
    flight = report.flight
    return {
        "path": str(report.path),
        "kind": report.kind,
        "frame": report.frame,
        "sound": report.sound,
        "drones": [vars(fact) for fact in report.facts],
        "flight": {**vars(flight), "own": [vars(check) for check in flight.own]},
        "findings": [vars(finding) for finding in report.findings],
    }


def _span(values: list[int]) -> str:
    low, high = min(values), max(values)
    return f"{low}" if low == high else f"{low} to {high}"


def _against(value: float, limit: float) -> str:
    return f"{value:.4g} of {limit:g}" if math.isfinite(limit) else f"{value:.4g}"
