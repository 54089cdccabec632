"""Slice, join, slow down and retime motions."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np

from hitchopt.errors import InputError
from hitchopt.motion.motion import JOINT, WAIT, CableState, Motion, Phase, concatenated
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.trajectory.clock_phases import ClockPhases, advance
from hitchopt.trajectory.piecewise import BREAK_TOLERANCE, on_breaks
from hitchopt.values import Array, Indices


def cut(motion: Motion, first: int, last: int) -> Motion:
    """Return the pieces from break ``first`` to break ``last``, starting at t = 0."""
    start, end = motion.drones.breaks[[first, last]].tolist()
    return shifted(slice_time(motion, start, end), -start)


def slice_time(motion: Motion, start: float, end: float) -> Motion:
    """Return the motion between two times [s], at its times; ``padded`` outside its own time."""
    motion = padded(motion, start, end)
    inner = motion.drones.breaks
    inner = inner[(inner > start + BREAK_TOLERANCE) & (inner < end - BREAK_TOLERANCE)]
    breaks = np.concatenate([[start], inner, [end]])
    phases = [
        phase.retimed(max(phase.start, start), min(phase.end, end))
        for phase in motion.overlapping(start, end)
    ]
    return motion.map_curves(lambda part: on_breaks(part, breaks), phases)


def shifted(motion: Motion, by: float) -> Motion:
    """Return the same motion, delayed by a time [s]."""
    breaks = motion.drones.breaks + by
    phases = [phase.retimed(phase.start + by, phase.end + by) for phase in motion.phases]
    return motion.map_curves(lambda part: part.replaced(part.coefficients, breaks), phases)


def on_breaks_of(motion: Motion, breaks: Array) -> Motion:
    """Return the motion on other breaks that include its own, as ``on_breaks``."""
    return motion.map_curves(lambda part: on_breaks(part, breaks), motion.phases)


def padded(motion: Motion, start: float, end: float) -> Motion:
    """Return the motion from ``start`` to ``end`` [s], at rest before and after its own time.

    Phases at rest are named WAIT and belong to its first and last step.
    """
    first, last = motion.drones.breaks[[0, -1]].tolist()
    if max(first - start, end - last) <= JOINT:
        return motion
    parts = [shifted(motion, -first)]
    if first - start > JOINT:
        parts.insert(0, _waiting(motion, first - start, motion.phases[0], first=True))
    if end - last > JOINT:
        parts.append(_waiting(motion, end - last, motion.phases[-1], first=False))
    return shifted(concatenated(parts), min(start, first))


def _waiting(motion: Motion, seconds: float, phase: Phase, *, first: bool) -> Motion:
    """Return a motion that waits at another one's end, or at its start with ``first``."""
    wait = replace(phase, name=WAIT, tension=None, remark="")
    return resting(motion, seconds, wait, first=first)


def stretched(motion: Motion, factor: float) -> Motion:
    """Return the same curves, slowed down by ``factor``, without a limit on their duration."""
    if not 1.0 <= factor <= 100.0:
        raise InputError("stretch", factor, "from 1 to 100", "1.05 flies 5 % slower")
    if factor == 1.0:
        return motion
    return motion.untimed.slowed(factor)


MAX_PIECE = 0.1
"""[s] Longest piece: degree 7 fits the retimed curve on it to little more than rounding."""

MIN_SPACING = 4e-3
"""[s] Minimum distance of the plan's breaks from the clock's: derivatives on short pieces suffer
from rounding."""

ORDERS = 4
"""Number of derivatives, the zeroth included, interpolated at both ends of every piece."""

INWARD = 1e-12
"""[s] Distance from a break at which the cell of the clock on one side of it is sought."""


def on_clock(motion: Motion, clock: ClockPhases) -> Motion:
    """Return the motion on a clock, from t = 0, with three exact derivatives at all breaks.

    The clock's phases are contiguous and within the motion's time.
    """
    cells, pieces = clock.cut(motion.drones.breaks)
    pieces = np.clip(pieces, 0, motion.drones.pieces - 1)
    times = np.concatenate([[0.0], np.cumsum(cells.duration)])
    phase_ends = np.concatenate([[0.0], np.cumsum(clock.duration)])
    breaks = _subdivide(times, phase_ends)

    def clock_at(ends: Array, inward: float) -> tuple[Indices, Array]:
        """Return the plan's pieces at ends of pieces [s], and jets (ends, 4) of the clock there."""
        cell = np.clip(np.searchsorted(times, ends + inward) - 1, 0, len(cells) - 1)
        return pieces[cell], advance(cells.jets[cell], ends - times[cell])

    at_starts = clock_at(breaks[:-1], INWARD)
    at_ends = clock_at(breaks[1:], -INWARD)
    middles = 0.5 * (breaks[1:] + breaks[:-1])
    phase_index = motion.phase_of_piece[pieces[np.searchsorted(times, middles) - 1]]
    states = np.array([phase.state for phase in motion.phases])[phase_index]
    smooth = np.flatnonzero(states[1:] == states[:-1])  # else legs and tensions may jump
    runs = pairwise(np.flatnonzero(np.diff(phase_index, prepend=-1, append=-1)).tolist())
    phases = [
        motion.phases[phase_index[first]].retimed(float(breaks[first]), float(breaks[last]))
        for first, last in runs
    ]

    def part(whole: PiecewisePolynomial) -> PiecewisePolynomial:
        left = _jets(whole, *at_starts)
        right = _jets(whole, *at_ends)
        left[:3, smooth + 1] = right[:3, smooth]
        fitted = PiecewisePolynomial.hermite(breaks, left, right)
        if whole is motion.load_share:  # its second derivatives may jump; it stays within [0, 1]
            fitted = PiecewisePolynomial(breaks, np.clip(fitted.coefficients, 0.0, 1.0))
        return fitted

    return motion.map_curves(part, phases)


def _subdivide(times: Array, edges: Array) -> Array:
    """Return edges, and times not within MIN_SPACING of them, with pieces split at MAX_PIECE."""
    near = np.min(np.abs(times[:, None] - edges), axis=1)
    breaks = np.union1d(edges, times[near > MIN_SPACING])
    parts = [
        np.linspace(first, last, max(1, int(np.ceil((last - first) / MAX_PIECE))) + 1)[:-1]
        for first, last in pairwise(breaks)
    ]
    return np.concatenate([*parts, breaks[-1:]])


def _jets(part: PiecewisePolynomial, pieces: Indices, clock: Array) -> Array:
    """Return time derivatives (ORDERS, ends, *shape) at jets (ends, 4) of a clock.

    At the ends of pieces they are exact: tensions that vanish there stay zero.
    """
    axes = (-1, *(1,) * len(part.shape))
    durations = part.durations[pieces]
    since_start = clock[:, 0] - part.breaks[pieces]
    until_end = part.breaks[pieces + 1] - clock[:, 0]
    place = since_start / durations
    place = np.where(until_end <= BREAK_TOLERANCE, 1.0, place)
    place = np.where(since_start <= BREAK_TOLERANCE, 0.0, place).reshape(axes)
    coefficients = part.coefficients[pieces]
    derivatives = []
    for order in range(ORDERS):
        values = bernstein.evaluate(coefficients, place)
        derivatives.append(values / durations.reshape(axes) ** order)
        coefficients = bernstein.differentiate(coefficients)
    value, first, second, third = derivatives
    rate, slope, curvature = (clock[:, order].reshape(axes) for order in (1, 2, 3))
    acceleration = rate**2 * second + slope * first
    jerk = rate**3 * third + 3.0 * rate * slope * second + curvature * first
    return np.stack([value, rate * first, acceleration, jerk])


def truncated(motion: Motion, time: float) -> Motion:
    """Return the motion up to a time [s], exact up to rounding."""
    return slice_time(motion, float(motion.drones.breaks[0]), time)


def append_motion(first: Motion, second: Motion) -> Motion:
    """Return two motions in sequence; a continued phase stays one phase."""
    motion = concatenated([first, second])
    count = len(first.phases)
    last, following = motion.phases[count - 1 : count + 1]
    merged = last.retimed(last.start, following.end)
    if following.retimed(last.start, following.end) != merged:
        return motion
    phases = (*motion.phases[: count - 1], merged, *motion.phases[count + 1 :])
    return motion.replaced(phases=phases)


def resting(
    motion: Motion, seconds: float, phase: Phase | None = None, *, first: bool = False
) -> Motion:
    """Return a motion at rest at another one's end, in ``phase`` or by default in its last phase.

    With ``first``, it rests at the other one's start, by default in its first phase. Instead of
    clasping, cables hang free.
    """
    end = (0, ..., 0) if first else (-1, ..., -1)

    def part(whole: PiecewisePolynomial) -> PiecewisePolynomial:
        return PiecewisePolynomial.constant([0.0, seconds], whole.coefficients[end])

    rest_phase = motion.phases[0 if first else -1] if phase is None else phase
    if rest_phase.state is CableState.CLASPING:
        rest_phase = replace(rest_phase, state=CableState.FREE)
    return motion.map_curves(part, [rest_phase.retimed(0.0, seconds)])


def prolonged(motion: Motion, seconds: float) -> Motion:
    """Return a motion that goes on at rest at its end, for some time in its last phase."""
    if seconds == 0.0:
        return motion

    def part(whole: PiecewisePolynomial) -> PiecewisePolynomial:
        return PiecewisePolynomial.constant([0.0, seconds], whole.coefficients[-1, ..., -1])

    rest = motion.map_curves(part, [motion.phases[-1].retimed(0.0, seconds)])
    return append_motion(motion, rest)


def with_last_poses(previous: Motion, motion: Motion) -> Motion:
    """Return a motion with objects at rest at their last poses in a previous motion."""
    last = previous.poses.coefficients[-1, ..., -1]
    return motion.replaced(poses=PiecewisePolynomial.constant(motion.drones.breaks, last))
