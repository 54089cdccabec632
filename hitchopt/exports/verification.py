"""Exported numbers against the plan: their errors, and the checks' formulas on what is flown.

Drones are read from the files, after rounding; vertices, legs and tensions are the plan's. So every
``worst`` bounds what is flown, for all t, as in the plan's certificate. Lint uses the same rules.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hitchopt.checks.certificate import Certificate, Check, most_pressing
from hitchopt.checks.drones import largest_rate
from hitchopt.checks.registry import RULE_OF, RULES
from hitchopt.checks.rule import CheckRule
from hitchopt.checks.spans import ROUNDING
from hitchopt.errors import FileError, Violation
from hitchopt.exports.recording import Recording, lasted
from hitchopt.exports.reference_frame import ReferenceFrame
from hitchopt.hitch import Swarm
from hitchopt.hitch.requirements import Requirements
from hitchopt.motion.motion import JOINT, Motion
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.trajectory.splitting import merged_breaks, on_breaks
from hitchopt.values import Array

FLOWN = tuple(rule for rule in RULES if any(finder.exported for finder in rule.finders))
"""Rules of the checks of what is flown, as they are listed."""

LINES = tuple(rule for rule in FLOWN if rule.derivative <= 1)
"""Rules for drones that fly along lines: velocities jump where they meet."""

PLACES = tuple(RULE_OF[name] for name in ("separation", "cable_clearance", "keep_out", "arena"))
"""Rules for set points that hold a tension. They are not where the drones are, of which the plan's
certificate says everything; but a drone whose cable breaks or goes slack flies there."""

SLOWER = "fly it slower with --stretch, plan below the limit, or choose another format"
"""Remedy for checks that a slower flight eases."""

CLEARER = "plan with a wider margin there, or choose another format"  # Remedy for the others

NOT_CARRIED = {
    0: "straight lines between samples: velocity jumps, so acceleration, jerk, thrust and tilt "
    "are not in these files",
    1: "acceleration jumps between pieces, so jerk is not in these files; thrust and tilt are "
    "those within the pieces",
    2: "jerk jumps between pieces; acceleration is smooth",
}


@dataclass(frozen=True)
class Deviation:
    """The largest distance of exported curves from the plan's over all of the time."""

    worst: float  # [m] or [m/s], a bound for all t
    time: float  # [s], where it is about attained
    drone: str


@dataclass(frozen=True)
class Verdict:
    """Errors and checks of exported numbers."""

    duration: float  # of what is flown [s]
    position: Deviation  # from the plan [m]
    velocity: Deviation  # [m/s]
    checks: tuple[Check, ...]  # those of what is flown that the format carries
    not_carried: str  # what the format cannot carry, in words

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
        found = []
        for check in self.lost:
            kept = planned[check.name].bound
            unit = "" if check.unit in {"1", "ratio"} else f" {check.unit}"
            when = (
                f"at t = {check.time:.4g} s (the plan keeps {kept:.6g}{unit}, "
                f"the export loses {abs(check.bound - kept):.3g}{unit})"
            )
            eased = RULE_OF[check.name].derivative > 0
            found.append(check.violation(when, SLOWER if eased else CLEARER))
        worst, when = self.position.worst, f"at t = {self.position.time:.4g} s"
        if worst > accuracy:
            remedy = "choose another format, such as csv, or a higher --rate where it samples"
            where = (self.position.drone,)
            error = Violation("position_error", worst, accuracy, "max", "m", where, when, remedy)
            found.append(error)
        return tuple(found)


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
    where = {name: i for i, name in enumerate(recording.names)}
    missing = [name for name in names if name not in where]
    if missing or len(where) != len(names):
        reason = f"{missing[0]} is missing" if missing else "there are more of them"
        raise FileError(f"its drones are not those of the plan: {reason}")
    index = [where[name] for name in names]
    carried = [rule for rule in rules if rule.derivative <= recording.smooth + 1]
    checks: list[list[Check | None]] = []
    apart: list[tuple[Deviation, Deviation]] = []
    end = 0.0
    for window in recording.windows():
        if abs(float(window.breaks[0]) - end) > JOINT:
            raise FileError(f"begins at t = {window.breaks[0]:g} s, not at {end:g} s")
        end = float(window.breaks[-1])
        curves = PiecewisePolynomial(window.breaks, window.coefficients[:, index])
        planned = _planned(motion, window.breaks)
        flown = on_breaks(frame.in_plan(curves), planned.drones.breaks)
        apart.append(_deviations(flown, planned))
        checks.append(written_checks(replace(planned, drones=flown), carried))
    if end < motion.duration - JOINT:
        raise FileError(f"ends at t = {end:g} s, before the plan does, at {motion.duration:g} s")
    position, velocity = (max(each, key=lambda d: d.worst) for each in zip(*apart, strict=True))
    kept = tuple(filter(None, map(most_pressing, zip(*checks, strict=True))))
    return Verdict(end, position, velocity, kept, NOT_CARRIED[recording.smooth])


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


def _deviations(flown: PiecewisePolynomial, motion: Motion) -> tuple[Deviation, Deviation]:
    """Return how far curves on the breaks of a plan are off, in position and in velocity."""
    degree = max(flown.degree, motion.drones.degree)
    wanted = bernstein.elevate(motion.drones.coefficients, degree)
    apart = bernstein.elevate(flown.coefficients, degree) - wanted
    margins = (ROUNDING * float(np.max(np.abs(wanted))), 0.0)
    position, velocity = (
        Deviation(found.worst + margin, found.time, motion.team.drone_names[found.item])
        for order, margin in enumerate(margins)
        for found in (largest_rate(PiecewisePolynomial(flown.breaks, apart), order),)
    )
    return position, velocity


def written_checks(motion: Motion, rules: Sequence[CheckRule] = FLOWN) -> list[Check | None]:
    """Return what the rules say of a motion whose drones were read from files, rule by rule."""
    return [rule.check(motion, exported=True) for rule in rules]


def drone_check(name: str, curves: PiecewisePolynomial, asked: Requirements) -> Check | None:
    """Return a check of drones alone on their curves (D, 3) [m]; they are named d0, d1, …."""
    return RULE_OF[name].check(Motion.single(Swarm(curves.shape[0]), asked, curves, ()))
