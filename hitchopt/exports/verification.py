"""Verification of exported numbers against the plan: their errors and their certificate.

Drones are read from the files, after rounding; vertices, legs and tensions are the plan's. So every
``worst`` bounds what is flown, for all t, as in the plan's certificate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hitchopt.checks.bounds.rates import largest_rate, norm_bound
from hitchopt.checks.bounds.rounding_margins import ROUNDING
from hitchopt.checks.certificate import Certificate, Check, most_pressing
from hitchopt.checks.registry import RULE_OF, RULES
from hitchopt.checks.rule import CheckRule
from hitchopt.errors import FileError, Violation
from hitchopt.exports.recording import Recording, lasted
from hitchopt.exports.reference_frame import ReferenceFrame
from hitchopt.motion.motion import JOINT, Motion
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.trajectory.extremum import Cells, Extremum, largest
from hitchopt.trajectory.splitting import merged_breaks, on_breaks
from hitchopt.values import Array

FLOWN = tuple(rule for rule in RULES if any(finder.exported for finder in rule.finders))
"""Rules of the checks of what is flown, as they are listed."""

PLACES = tuple(RULE_OF[name] for name in ("separation", "cable_clearance", "keep_out", "arena"))
"""Rules for set points that hold a tension. They are not where the drones are, of which the plan's
certificate says everything; but a drone whose cable breaks or goes slack flies there."""

SLOWER = "fly it slower with --stretch, plan below the limit, or choose another format"
"""Remedy for checks that a slower flight eases."""

CLEARER = "plan with a wider margin there, or choose another format"
"""Remedy for the others."""

NOT_CARRIED = {
    0: "straight lines between samples: velocity jumps, so acceleration, jerk, thrust and tilt "
    "are not in these files",
    1: "acceleration jumps between pieces, so jerk is not in these files; thrust and tilt are "
    "those within the pieces",
    2: "jerk jumps between pieces; acceleration is smooth",
}


@dataclass(frozen=True)
class Deviation:
    """The largest distance of exported curves from the plan's over all of the time.

    Attributes
    ----------
    worst: [m] or [m/s], a bound for all t.
    time: [s], where it is about attained.
    drone: name of the drone.
    """

    worst: float
    time: float
    drone: str


@dataclass(frozen=True)
class Verdict:
    """Errors and checks of exported numbers.

    Attributes
    ----------
    duration: duration of what is flown [s].
    position, velocity: deviations from the plan [m], [m/s].
    checks: those of FLOWN that the format carries.
    not_carried: what the format cannot carry, in words.
    """

    duration: float
    position: Deviation
    velocity: Deviation
    checks: tuple[Check, ...]
    not_carried: str

    @property
    def lost(self) -> tuple[Check, ...]:
        """Checks that do not hold."""
        return tuple(check for check in self.checks if not check.holds)

    def violations(self, certificate: Certificate, accuracy: float) -> tuple[Violation, ...]:
        """Return what is lost, each limit with the value that the plan keeps of it.

        Parameters
        ----------
        certificate: the plan's certificate.
        accuracy: largest position error [m].
        """
        planned = {check.name: check for check in certificate.checks}
        found = [_violation(check, planned[check.name]) for check in self.lost]
        worst, when = self.position.worst, f"at t = {self.position.time:.4g} s"
        if worst > accuracy:
            remedy = "choose another format, such as csv, or a higher --rate where it samples"
            where = (self.position.drone,)
            error = Violation("position_error", worst, accuracy, "max", "m", where, when, remedy)
            found.append(error)
        return tuple(found)


def _violation(check: Check, planned: Check) -> Violation:
    lost = abs(check.bound - planned.bound)
    unit = "" if check.unit in {"1", "ratio"} else f" {check.unit}"
    return check.violation(
        f"at t = {check.time:.4g} s (the plan keeps {planned.bound:.6g}{unit}, "
        f"the export loses {lost:.3g}{unit})",
        SLOWER if RULE_OF[check.name].derivative else CLEARER,
    )


def verify(
    motion: Motion,
    recording: Recording,
    frame: ReferenceFrame,
    names: Sequence[str],
    rules: Sequence[CheckRule] = FLOWN,
) -> Verdict:
    """Return errors and checks of a recording that stands for the plan ``motion``.

    Parameters
    ----------
    motion: the plan, from t = 0 on.
    recording: what files say.
    frame: where the plan lies in their axes.
    names: (D,) what the files call the plan's drones, in its order.
    rules: of the checks.

    Raises
    ------
    FileError: drones that are not the plan's, or less than all of its time.
    """
    index = _order(recording, names)
    carried = [rule for rule in rules if rule.derivative <= recording.smooth + 1]
    checks: list[list[Check | None]] = [[] for _ in carried]
    deviations: list[tuple[Deviation, Deviation]] = []
    end = 0.0
    for window in recording.windows():
        if abs(float(window.breaks[0]) - end) > JOINT:
            raise FileError(f"begins at t = {window.breaks[0]:g} s, not at {end:g} s")
        end = float(window.breaks[-1])
        curves = PiecewisePolynomial(window.breaks, window.coefficients[:, index])
        planned = _planned(motion, window.breaks)
        flown = on_breaks(frame.in_plan(curves), planned.drones.breaks)
        deviations.append(_deviations(flown, planned.drones, motion.team.drone_names))
        exported = replace(planned, drones=flown)
        for rule, results in zip(carried, checks, strict=True):
            results.append(rule.check(exported, exported=True))
    if end < motion.duration - JOINT:
        raise FileError(f"ends at t = {end:g} s, before the plan does, at {motion.duration:g} s")
    position, velocity = (
        max(each, key=lambda d: d.worst) for each in zip(*deviations, strict=True)
    )
    worst = tuple(check for check in map(most_pressing, checks) if check is not None)
    return Verdict(end, position, velocity, worst, NOT_CARRIED[recording.smooth])


def _order(recording: Recording, names: Sequence[str]) -> NDArray[np.intp]:
    where = {name: i for i, name in enumerate(recording.names)}
    missing = [name for name in names if name not in where]
    if missing or len(where) != len(names):
        reason = f"{missing[0]} is missing" if missing else "there are more of them"
        raise FileError(f"its drones are not those of the plan: {reason}")
    return np.array([where[name] for name in names], dtype=np.intp)


def _planned(motion: Motion, breaks: Array) -> Motion:
    """Return the plan over the span of ``breaks``, split there too; at rest after its end."""
    start, end = float(breaks[0]), float(breaks[-1])
    inner = motion.drones.breaks
    common = merged_breaks([breaks, inner[(inner > start) & (inner < end)]])

    def span(part: PiecewisePolynomial) -> PiecewisePolynomial:
        return on_breaks(lasted(part, end), common)

    last = motion.phases[-1:]
    phases = motion.phases[:-1] + tuple(replace(p, end=max(p.end, end)) for p in last)
    here = tuple(p for p in phases if p.end > start + JOINT and p.start < end - JOINT)
    return motion.changed(span, here)


def _deviations(
    flown: PiecewisePolynomial, planned: PiecewisePolynomial, names: Sequence[str]
) -> tuple[Deviation, Deviation]:
    degree = max(flown.degree, planned.degree)
    a = bernstein.elevate(flown.coefficients, degree)
    b = bernstein.elevate(planned.coefficients, degree)
    apart = PiecewisePolynomial(flown.breaks, a - b)
    margin = ROUNDING * float(np.max(np.abs(b)))
    position = largest(Cells.over(apart.breaks, [apart.coefficients], margin), norm_bound)
    velocity = largest_rate(apart, 1)

    def named(found: Extremum) -> Deviation:
        return Deviation(found.worst, found.time, names[found.item])

    return named(position), named(velocity)
