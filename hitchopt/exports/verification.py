"""Verify the files of an export against the plan.

Checks use the drones' curves of the files, and the plan's vertices, legs and tensions. So every
``worst`` bounds the exported motion for all t, as in the plan's certificate.

Setpoints s = x + δ hold the tension of a plan x (``held_tension``). Their equation of motion treats
s and x alike but for the cable force, so that drones that follow the files' setpoints s + e fly
x + e: limits of motion are checked for the files' curves minus δ.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hitchopt.checks.certificate import Check, worst_of
from hitchopt.checks.certifying import check_of
from hitchopt.checks.drones import ACCELERATION, largest_rate
from hitchopt.checks.registry import RULE_OF, RULES
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
"""Rules for setpoints with offsets that hold the tension. Drones fly to them if their cables break
or go slack."""

SLOWER_REMEDY = "fly it more slowly with stretch=, plan below the limit, or choose another format"
MARGIN_REMEDY = "plan with a wider margin there, sample at a higher rate=, or choose another format"
"""Remedies for checks of derivatives, and for other checks."""

NOT_CARRIED = (
    "Velocity is discontinuous at samples; acceleration, thrust, tilt, jerk and body rates are not "
    "certified.",
    "Acceleration is discontinuous between pieces, and not certified; thrust and tilt are those "
    "within pieces; jerk and body rates are not certified.",
    "Jerk is discontinuous between pieces; jerk and body rates are not certified.",
)
"""Sentences on what is discontinuous in files, or not certified, by the highest continuous
derivative."""

TRAILING = (
    "Drones trail positions: only distances of setpoints are certified, and speed, acceleration, "
    "thrust, tilt, jerk and body rates are not."
)
"""The sentence for receivers that follow positions alone with offsets that hold the tension."""


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
    not_carried: str  # what is discontinuous, or not certified

    @property
    def violated(self) -> tuple[Check, ...]:
        """Checks that do not hold."""
        return tuple(check for check in self.checks if not check.holds)

    def violations(self, flown: Flown, accuracy: float) -> list[Violation]:
        """Return the violated limits of an export; ``accuracy`` is the format's [m]."""
        violations = []
        for check in self.violated:
            rule = RULE_OF[check.name]
            planned = check_of(rule, flown.limited_by(rule), exported=True) or check
            values = f"{planned.worst:.6g}, the export loses {abs(check.worst - planned.worst):.3g}"
            when = f"at t = {check.time:.4g} s (the plan keeps {values})"
            remedy = SLOWER_REMEDY if rule.derivative > 0 else MARGIN_REMEDY
            violations.append(check.violation(when, remedy))
        worst = self.position.worst
        when = f"at t = {self.position.time:.4g} s"
        if worst > accuracy:
            remedy = "choose another format, such as csv, or a higher rate= if it samples"
            where = (self.position.drone,)
            error = Violation("position_error", worst, accuracy, "max", "m", where, when, remedy)
            violations.append(error)
        return violations


@dataclass(frozen=True, eq=False)
class Flown:
    """What an export contains, and what drones fly by it."""

    setpoints: Flight  # The flight with setpoints as drones
    # The flight without the offsets that hold the tension; None if there are none
    plan: Flight | None = None
    # True if drones follow positions alone, so that only distances of setpoints are certified
    trails: bool = False

    @property
    def rules(self) -> tuple[CheckRule, ...]:
        """The rules that limit it."""
        return SETPOINT_RULES if self.plan is not None and self.trails else EXPORT_RULES

    def limited_by(self, rule: CheckRule) -> Flight:
        """Return the planned flight that a rule limits, that of setpoints if both are."""
        return self.setpoints if self.plan is None or rule in SETPOINT_RULES else self.plan


def verify(
    flown: Flown,
    contents: FileContents,
    frame: ReferenceFrame,
    names: Sequence[str],
    rules: Sequence[CheckRule] = EXPORT_RULES,
    trims: Array | float = 0.0,
) -> Verdict:
    """Return errors and checks of files, from t = 0.

    ``frame`` is that of the files, ``names`` (D,) are the drones' names in them, in the order of
    the problem. Setpoints differ from the positions by ``trims`` (D, 3) [m] in the plan. Raises
    FileError for other drones than the plan's, and if the files are too short.
    """
    flight = flown.setpoints
    missing = [name for name in names if name not in contents.names]
    if missing or len(contents.names) != len(names):
        reason = f"{missing[0]} is missing" if missing else "there are more drones"
        raise FileError(f"its drones are not those of the plan: {reason}")
    numbers = np.argsort(flight.team.listed)  # of the drones in the flight's order
    index = [contents.names.index(names[drone]) for drone in numbers]
    offsets = np.broadcast_to(trims, (len(names), 3))[numbers]
    firsts = np.cumsum([len(each.motion.team.drone_names) for each in flight.teams])[:-1]
    carried = [rule for rule in rules if rule.derivative <= contents.smooth + 1]
    if contents.smooth < ACCELERATION.derivative:
        carried = [rule for rule in carried if rule is not ACCELERATION]
    checks = list[Check | None]()
    deviations = list[list[Deviation]]()
    end = 0.0
    for window in contents.windows():
        start = float(window.breaks[0])
        if abs(start - end) > JOINT:
            raise FileError(f"begins at t = {start:g} s, not at {end:g} s")
        end = float(window.breaks[-1])
        curves = frame.in_plan(window.replaced(window.coefficients[:, index]))
        places = curves.coefficients - offsets[..., None]
        written = [curves.replaced(part) for part in np.split(places, firsts, axis=1)]
        exported, planned = _exported(flight, written, window.breaks)
        for after, before in zip(exported.teams, planned.teams, strict=True):
            deviations.append(_deviations(after, before.motion))
        limited = [(exported, carried)]
        if flown.plan is not None:
            limited = [(exported, [rule for rule in carried if rule in SETPOINT_RULES])]
            if not flown.trails:
                limited.append((_followed(exported, planned, flown.plan), carried))
        for whole, applied in limited:
            with value_cache():
                checks += (check_of(rule, whole, exported=True) for rule in applied)
    if end < flight.duration - JOINT:
        raise FileError(f"ends at t = {end:g} s, before the plan does, at {flight.duration:g} s")
    each = zip(*deviations, strict=True)
    position, velocity = (max(errors, key=lambda error: error.worst) for errors in each)
    found = [check for check in checks if check is not None]
    by_rule = (worst_of(check for check in found if check.name == rule.name) for rule in carried)
    not_carried = NOT_CARRIED[contents.smooth]
    if flown.plan is not None:
        not_carried = TRAILING if flown.trails else f"{not_carried} {_rates(flight, contents)}"
    return Verdict(end, position, velocity, tuple(filter(None, by_rule)), not_carried)


def _exported(
    flight: Flight, written: Sequence[PiecewisePolynomial], breaks: Array
) -> tuple[Flight, Flight]:
    """Return a flight over the span of ``breaks``, with the drones of the files, and as planned.

    ``written`` are curves of each team's drones.
    """
    start = float(breaks[0])
    end = float(breaks[-1])
    others = tuple(replace(x, motion=slice_time(x.motion, start, end)) for x in flight.others)
    planned, exported = list[TeamMotion](), list[TeamMotion]()
    for flown, curves in zip(flight.teams, written, strict=True):
        motion = _plan_between(flown.motion, breaks)
        drones = on_breaks(curves, motion.drones.breaks)
        planned.append(replace(flown, motion=motion))
        exported.append(replace(flown, motion=replace(motion, drones=drones)))
    return Flight(tuple(exported), others), Flight(tuple(planned), others)


def _followed(exported: Flight, planned: Flight, plan: Flight) -> Flight:
    """Return the flight of drones that follow exported setpoints, whose plan lies beside them."""
    teams = list[TeamMotion]()
    for each, setpoints, flown in zip(exported.teams, planned.teams, plan.teams, strict=True):
        motion = _plan_between(flown.motion, each.motion.drones.breaks)
        error = _difference(each.motion.drones, setpoints.motion.drones)
        positions = bernstein.elevate(motion.drones.coefficients, error.degree)
        drones = error.replaced(positions + error.coefficients)
        teams.append(replace(flown, motion=replace(motion, drones=drones)))
    return Flight(tuple(teams), exported.others)


def _difference(curves: PiecewisePolynomial, planned: PiecewisePolynomial) -> PiecewisePolynomial:
    """Return curves on the breaks of planned ones minus these."""
    degree = max(curves.degree, planned.degree)
    before = bernstein.elevate(planned.coefficients, degree)
    return curves.replaced(bernstein.elevate(curves.coefficients, degree) - before)


def _rates(flight: Flight, contents: FileContents) -> str:
    """Return the sentence on the rates of setpoints that hold the tension."""
    speed, acceleration = (largest_rate(flight.drones, order).worst for order in (1, 2))
    rates = f"{speed:.3g} m/s"
    if contents.smooth >= ACCELERATION.derivative:
        rates += f" and {acceleration:.3g} m/s²"
    return f"Limits of motion hold for drones that follow the setpoints, which reach {rates}."


def _plan_between(motion: Motion, breaks: Array) -> Motion:
    """Return the plan over the span of ``breaks``, with these breaks, at rest after its end."""
    start = float(breaks[0])
    end = float(breaks[-1])
    inner = motion.drones.breaks
    common = merged_breaks([breaks, inner[(inner > start) & (inner < end)]])

    def span(part: PiecewisePolynomial) -> PiecewisePolynomial:
        return on_breaks(held_until(part, end), common)

    last = motion.phases[-1:]
    phases = motion.phases[:-1] + tuple(replace(p, end=max(p.end, end)) for p in last)
    overlapping = tuple(p for p in phases if p.end > start + JOINT and p.start < end - JOINT)
    return motion.map_curves(span, overlapping)


def _deviations(exported: TeamMotion, planned: Motion) -> list[Deviation]:
    """Return the largest deviations of exported drones from a plan, in position and velocity."""
    difference = _difference(exported.motion.drones, planned.drones)
    rounding = ROUNDING * float(np.max(np.abs(planned.drones.coefficients)))
    deviations = []
    for order, margin in enumerate((rounding, 0.0)):
        worst = largest_rate(difference, order)
        drone = exported.label(planned.team.drone_names[worst.item])
        deviations.append(Deviation(worst.worst + margin, worst.time, drone))
    return deviations
