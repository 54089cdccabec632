"""What was exported, held against the plan: errors and certificate of the numbers in the files.

The drones are those that the files say, after rounding; vertices, legs and tensions are the plan's.
So every ``worst`` speaks of what is flown, for all t, in the same way as the plan's certificate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hitchopt.checks.bounds.rates import largest_rate, norm_bound
from hitchopt.checks.bounds.rounding_margins import ROUNDING
from hitchopt.checks.certificate import Check, most_pressing
from hitchopt.checks.registry import RULES
from hitchopt.errors import FileError
from hitchopt.exports.frame import Room
from hitchopt.exports.recording import Recording, lasted
from hitchopt.motion.motion import JOINT, Motion
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.trajectory.extremum import Cells, Extremum, largest
from hitchopt.trajectory.splitting import merged_breaks, on_breaks

Array = NDArray[np.float64]

FLOWN = tuple(rule for rule in RULES if any(finder.exported for finder in rule.finders))
"""Rules of the checks of what is flown, as they are listed."""

NOT_CARRIED = {
    0: "straight lines between samples: velocity jumps, so acceleration, jerk, thrust and tilt "
    "are not in these files",
    1: "acceleration jumps between pieces, so jerk is not in these files; thrust and tilt are "
    "those within the pieces",
    2: "jerk jumps between pieces; acceleration is smooth",
}


@dataclass(frozen=True)
class Deviation:
    """How far exported curves are from the plan's, at most over all of the time.

    Attributes
    ----------
    worst: [m] or [m/s], a bound for all t.
    time: [s], where it is about attained.
    drone: whose.
    """

    worst: float
    time: float
    drone: str


@dataclass(frozen=True)
class Verdict:
    """What is to be said of exported numbers.

    Attributes
    ----------
    duration: of what is flown [s].
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
        """The checks that do not hold."""
        return tuple(check for check in self.checks if not check.holds)


def judge(motion: Motion, recording: Recording, room: Room, names: Sequence[str]) -> Verdict:
    """Return errors and checks of a recording that stands for the plan ``motion``.

    Parameters
    ----------
    motion: the plan, from t = 0 on.
    recording: what files say.
    room: where the plan lies in their frame.
    names: (D,) what the files call the plan's drones, in its order.

    Raises
    ------
    FileError: drones that are not the plan's, or less than all of its time.
    """
    index = _order(recording, names)
    carried = [rule for rule in FLOWN if rule.derivative <= recording.smooth + 1]
    results: list[list[Check | None]] = []
    deviations: tuple[list[Deviation], list[Deviation]] = ([], [])
    end = 0.0
    for window in recording.windows():
        if abs(float(window.breaks[0]) - end) > JOINT:
            raise FileError(f"begins at t = {window.breaks[0]:g} s, not at {end:g} s")
        end = float(window.breaks[-1])
        curves = PiecewisePolynomial(window.breaks, window.coefficients[:, index])
        planned = _planned(motion, window.breaks)
        flown = on_breaks(room.in_plan(curves), planned.drones.breaks)
        for found, deviation in zip(
            deviations, _deviations(flown, planned.drones, motion.team.drone_names), strict=True
        ):
            found.append(deviation)
        judged = replace(planned, drones=flown)
        results.append([rule.check(judged, exported=True) for rule in carried])
    if end < motion.duration - JOINT:
        raise FileError(f"ends at t = {end:g} s, before the plan does, at {motion.duration:g} s")
    worst = [most_pressing(checks) for checks in zip(*results, strict=True)]
    return Verdict(
        end,
        max(deviations[0], key=lambda d: d.worst),
        max(deviations[1], key=lambda d: d.worst),
        tuple(check for check in worst if check is not None),
        NOT_CARRIED[recording.smooth],
    )


def flown_checks(motion: Motion) -> dict[str, Check]:
    """Return the checks of FLOWN of the plan itself, by name."""
    found = [rule.check(motion, exported=True) for rule in FLOWN]
    return {check.name: check for check in found if check is not None}


def _order(recording: Recording, names: Sequence[str]) -> NDArray[np.intp]:
    where = {name: i for i, name in enumerate(recording.names)}
    missing = [name for name in names if name not in where]
    if missing or len(where) != len(names):
        told = f"{missing[0]} is missing" if missing else "there are more of them"
        raise FileError(f"its drones are not those of the plan: {told}")
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
