"""Verification of exported numbers against the plan: their errors and their certificate.

Drones are read from the files, after rounding; vertices, legs and tensions are the plan's. So every
``worst`` bounds what is flown, for all t, as in the plan's certificate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from hitchopt.checks.certificate import Certificate, Check
from hitchopt.checks.rule import CheckRule
from hitchopt.errors import FileError, Violation
from hitchopt.exports.recording import Recording, lasted
from hitchopt.exports.reference_frame import ReferenceFrame
from hitchopt.exports.worst_values import (
    FLOWN,
    Worst,
    eased_by_slowing,
    largest_distance,
    worst_of,
    written_checks,
)
from hitchopt.motion.motion import JOINT, Motion
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.trajectory.splitting import merged_breaks, on_breaks
from hitchopt.values import Array

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
            found.append(check.violation(when, SLOWER if eased_by_slowing(check.name) else CLEARER))
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
    apart: list[tuple[Worst, Worst]] = []
    end = 0.0
    for window in recording.windows():
        if abs(float(window.breaks[0]) - end) > JOINT:
            raise FileError(f"begins at t = {window.breaks[0]:g} s, not at {end:g} s")
        end = float(window.breaks[-1])
        curves = PiecewisePolynomial(window.breaks, window.coefficients[:, index])
        planned = _planned(motion, window.breaks)
        flown = on_breaks(frame.in_plan(curves), planned.drones.breaks)
        apart.append(largest_distance(flown, planned.drones))
        checks.append(written_checks(replace(planned, drones=flown), carried))
    if end < motion.duration - JOINT:
        raise FileError(f"ends at t = {end:g} s, before the plan does, at {motion.duration:g} s")
    worst = [max(each, key=lambda d: d.value) for each in zip(*apart, strict=True)]
    position, velocity = (
        Deviation(each.value, each.time, motion.team.drone_names[each.drone]) for each in worst
    )
    found = map(worst_of, zip(*checks, strict=True))
    kept = tuple(check for check in found if check is not None)
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
