"""Verify the files of an export against the plan.

Checks use the drones' curves of the files, and the plan's vertices, legs and tensions. So every
``worst`` bounds the exported motion for all t, as in the plan's certificate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hitchopt.checks.certificate import Check, worst_of
from hitchopt.checks.drones import largest_rate
from hitchopt.checks.registry import RULE_OF, RULES, check_of
from hitchopt.checks.rule import CheckRule
from hitchopt.checks.spans import ROUNDING, value_cache
from hitchopt.errors import FileError, Violation
from hitchopt.exports.contents import FileContents, held_until
from hitchopt.exports.placing import ReferenceFrame
from hitchopt.motion.flight import Flight, TeamMotion
from hitchopt.motion.motion import JOINT, Motion
from hitchopt.motion.retiming import slice_time
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.trajectory.piecewise import merged_breaks, on_breaks
from hitchopt.values import Array

EXPORT_RULES = tuple(rule for rule in RULES if any(each.exported for each in rule.evaluators))
"""Rules of the checks of exported motions, in order."""

SETPOINT_RULES = tuple(
    rule for rule in EXPORT_RULES if any("drones" in pair for pair in rule.pairs)
)
"""Rules for setpoints with offsets that hold the tension. Drones fly to their setpoints if their
cables break or go slack; otherwise the plan's certificate applies."""

SLOWER_REMEDY = "fly it more slowly with stretch=, plan below the limit, or choose another format"
MARGIN_REMEDY = "plan with a wider margin there, sample at a higher rate=, or choose another format"
"""Remedies for checks of derivatives, and for other checks."""

NOT_CARRIED = (
    "Velocity is discontinuous at samples; acceleration, jerk, thrust and tilt are not certified.",
    "Acceleration is discontinuous between pieces; thrust and tilt are those within pieces.",
    "Jerk is discontinuous between pieces.",
)
"""Sentences on what is discontinuous in files, by the highest continuous derivative."""


@dataclass(frozen=True)
class Deviation:
    """The largest deviation of exported curves from the plan's over all time."""

    worst: float  # bound for all t [m] or [m/s]
    time: float  # approximate time of the maximum [s]
    drone: str


@dataclass(frozen=True)
class Verdict:
    """Errors and checks of an exported flight."""

    duration: float  # [s]
    position: Deviation  # [m]
    velocity: Deviation  # [m/s]
    checks: tuple[Check, ...]  # checks of quantities that the format carries
    not_carried: str  # what is discontinuous, and not certified

    @property
    def violated(self) -> tuple[Check, ...]:
        """Checks that do not hold."""
        return tuple(check for check in self.checks if not check.holds)

    def violations(self, flight: Flight, accuracy: float) -> list[Violation]:
        """Return the violated limits of an export; ``accuracy`` is the format's [m]."""
        violations = []
        for check in self.violated:
            rule = RULE_OF[check.name]
            planned = check_of(rule, flight, exported=True) or check
            values = f"{planned.worst:.6g}, the export loses {abs(check.worst - planned.worst):.3g}"
            when = f"at t = {check.time:.4g} s (the plan keeps {values})"
            remedy = SLOWER_REMEDY if rule.derivative > 0 else MARGIN_REMEDY
            violations.append(check.violation(when, remedy))
        worst, when = self.position.worst, f"at t = {self.position.time:.4g} s"
        if worst > accuracy:
            remedy = "choose another format, such as csv, or a higher rate= if it samples"
            where = (self.position.drone,)
            error = Violation("position_error", worst, accuracy, "max", "m", where, when, remedy)
            violations.append(error)
        return violations


def verify(
    flight: Flight,
    contents: FileContents,
    frame: ReferenceFrame,
    names: Sequence[str],
    rules: Sequence[CheckRule] = EXPORT_RULES,
    trims: Array | float = 0.0,
) -> Verdict:
    """Return errors and checks of files of the plan ``flight``, from t = 0.

    ``frame`` is that of the files, ``names`` (D,) are the drones' names in them, in the order of
    the problem. Setpoints differ from the positions by ``trims`` (D, 3) [m] in the plan. Raises
    FileError for other drones than the plan's, and if the files are too short.
    """
    missing = [name for name in names if name not in contents.names]
    if missing or len(contents.names) != len(names):
        reason = f"{missing[0]} is missing" if missing else "there are more drones"
        raise FileError(f"its drones are not those of the plan: {reason}")
    numbers = np.argsort(flight.team.listed)  # of the drones in the flight's order
    index = [contents.names.index(names[drone]) for drone in numbers]
    offsets = np.broadcast_to(trims, (len(names), 3))[numbers]
    firsts = np.cumsum([len(each.motion.team.drone_names) for each in flight.teams])[:-1]
    carried = [rule for rule in rules if rule.derivative <= contents.smooth + 1]
    checks, deviations, end = list[list[Check | None]](), list[list[Deviation]](), 0.0
    for window in contents.windows():
        start = float(window.breaks[0])
        if abs(start - end) > JOINT:
            raise FileError(f"begins at t = {start:g} s, not at {end:g} s")
        end = float(window.breaks[-1])
        curves = frame.in_plan(window.replaced(window.coefficients[:, index]))
        places = curves.coefficients - offsets[..., None]
        coefficients = np.split(places, firsts, axis=1)
        teams = list[TeamMotion]()
        for flown, part in zip(flight.teams, coefficients, strict=True):
            planned = _plan_between(flown.motion, window.breaks)
            exported = on_breaks(curves.replaced(part), planned.drones.breaks)
            deviations.append(_deviations(exported, planned, flown))
            teams.append(replace(flown, motion=replace(planned, drones=exported)))
        others = [replace(x, motion=slice_time(x.motion, start, end)) for x in flight.others]
        whole = Flight(tuple(teams), tuple(others))
        with value_cache():
            checks.append([check_of(rule, whole, exported=True) for rule in carried])
    if end < flight.duration - JOINT:
        raise FileError(f"ends at t = {end:g} s, before the plan does, at {flight.duration:g} s")
    each = zip(*deviations, strict=True)
    position, velocity = (max(errors, key=lambda error: error.worst) for errors in each)
    worst = tuple(filter(None, map(worst_of, zip(*checks, strict=True))))
    return Verdict(end, position, velocity, worst, NOT_CARRIED[contents.smooth])


def _plan_between(motion: Motion, breaks: Array) -> Motion:
    """Return the plan over the span of ``breaks``, with these breaks, at rest after its end."""
    start, end = float(breaks[0]), float(breaks[-1])
    inner = motion.drones.breaks
    common = merged_breaks([breaks, inner[(inner > start) & (inner < end)]])

    def span(part: PiecewisePolynomial) -> PiecewisePolynomial:
        return on_breaks(held_until(part, end), common)

    last = motion.phases[-1:]
    phases = motion.phases[:-1] + tuple(replace(p, end=max(p.end, end)) for p in last)
    overlapping = tuple(p for p in phases if p.end > start + JOINT and p.start < end - JOINT)
    return motion.map_curves(span, overlapping)


def _deviations(
    exported: PiecewisePolynomial, motion: Motion, flown: TeamMotion
) -> list[Deviation]:
    """Return the largest deviations of curves on a plan's breaks, in position and velocity."""
    degree, deviations = max(exported.degree, motion.drones.degree), []
    planned = bernstein.elevate(motion.drones.coefficients, degree)
    difference = exported.replaced(bernstein.elevate(exported.coefficients, degree) - planned)
    for order, margin in enumerate((ROUNDING * float(np.max(np.abs(planned))), 0.0)):
        worst = largest_rate(difference, order)
        drone = flown.label(motion.team.drone_names[worst.item])
        deviations.append(Deviation(worst.worst + margin, worst.time, drone))
    return deviations
