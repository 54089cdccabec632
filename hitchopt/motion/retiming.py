"""Slice, join, slow down and retime motions."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from hitchopt.errors import InputError
from hitchopt.hitch.series import JET, chained
from hitchopt.motion.cable_state import CableState
from hitchopt.motion.motion import JOINT, WAIT, Motion, Phase, concatenated
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.trajectory.clock_phases import ClockPhases, advance
from hitchopt.trajectory.piecewise import BREAK_TOLERANCE, MIN_SPACING, on_breaks
from hitchopt.values import Array, Indices


def cut(motion: Motion, first: int, last: int) -> Motion:
    """Return the pieces from break ``first`` to break ``last``, starting at t = 0."""
    start, end = motion.drones.breaks[[first, last]].tolist()
    return shifted(slice_time(motion, start, end), -start)


def slice_time(motion: Motion, start: float, end: float) -> Motion:
    """Return the motion between two times [s], at its times; ``padded`` outside its own time."""
    motion = padded(motion, start, end)
    old_breaks = motion.drones.breaks
    is_inner = (old_breaks > start + BREAK_TOLERANCE) & (old_breaks < end - BREAK_TOLERANCE)
    breaks = np.concatenate([[start], old_breaks[is_inner], [end]])
    phases = [
        phase.retimed(max(phase.start, start), min(phase.end, end))
        for phase in motion.overlapping(start, end)
    ]
    return motion.map_curves(lambda curve: on_breaks(curve, breaks), phases)


def shifted(motion: Motion, by: float) -> Motion:
    """Return the same motion, delayed by a time [s]."""
    breaks = motion.drones.breaks + by
    phases = [phase.retimed(phase.start + by, phase.end + by) for phase in motion.phases]
    return motion.map_curves(lambda curve: curve.replaced(curve.coefficients, breaks), phases)


def on_breaks_of(motion: Motion, breaks: Array) -> Motion:
    """Return the motion on other breaks that include its own, as ``on_breaks``."""
    return motion.map_curves(lambda curve: on_breaks(curve, breaks), motion.phases)


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

INWARD = 1e-12
"""[s] Distance from a break at which the cell of the clock on one side of it is sought."""


def on_clock(motion: Motion, clock: ClockPhases) -> Motion:
    """Return the motion on a clock, from t = 0, with three exact derivatives at all breaks.

    The clock's phases are contiguous and within the motion's time.
    """
    cells, pieces = clock.cut(motion.drones.breaks)
    pieces = np.clip(pieces, 0, motion.drones.pieces - 1)
    cell_times = np.concatenate([[0.0], np.cumsum(cells.duration)])
    phase_times = np.concatenate([[0.0], np.cumsum(clock.duration)])
    breaks = _subdivide(cell_times, phase_times)

    def clock_at(times: Array, inward: float) -> ClockPlaces:
        """Return where the clock is at times [s], in the cells that contain times + inward."""
        cell = np.clip(np.searchsorted(cell_times, times + inward) - 1, 0, len(cells) - 1)
        return ClockPlaces(pieces[cell], advance(cells.jets[cell], times - cell_times[cell]))

    starts = clock_at(breaks[:-1], INWARD)
    ends = clock_at(breaks[1:], -INWARD)
    middles = 0.5 * (breaks[1:] + breaks[:-1])
    cell_of_middle = np.searchsorted(cell_times, middles) - 1
    phase_index = motion.phase_of_piece[pieces[cell_of_middle]]
    states = np.array([phase.state for phase in motion.phases])[phase_index]
    # Where the state changes, legs and tensions may jump
    in_one_state = np.flatnonzero(states[1:] == states[:-1])

    def retimed(curve: PiecewisePolynomial) -> PiecewisePolynomial:
        """Return a curve on the clock."""
        left = _derivatives_on_clock(curve, starts)
        right = _derivatives_on_clock(curve, ends)
        # Value, velocity and acceleration are equal to the last bit on both sides of a break
        left[:3, in_one_state + 1] = right[:3, in_one_state]
        fitted = PiecewisePolynomial.hermite(breaks, left, right)
        if curve is motion.load_share:  # its second derivatives may jump; it stays within [0, 1]
            fitted = PiecewisePolynomial(breaks, np.clip(fitted.coefficients, 0.0, 1.0))
        return fitted

    return motion.map_curves(retimed, _phases_on(motion, phase_index, breaks))


class ClockPlaces(NamedTuple):
    """Where a clock is in a plan at K times."""

    pieces: Indices  # (K,): pieces of the plan
    jets: Array  # (K, 4): plan time [s] and its derivatives by time


def _subdivide(times: Array, edges: Array) -> Array:
    """Return edges, and times not within MIN_SPACING of them, with pieces split at MAX_PIECE."""
    distances = np.min(np.abs(times[:, None] - edges), axis=1)
    breaks = np.union1d(edges, times[distances > MIN_SPACING])
    parts = list[Array]()
    for first, last in pairwise(breaks.tolist()):
        count = max(1, math.ceil((last - first) / MAX_PIECE))
        parts.append(np.linspace(first, last, count + 1)[:-1])
    return np.concatenate([*parts, breaks[-1:]])


def _phases_on(motion: Motion, phase_index: Indices, breaks: Array) -> list[Phase]:
    """Return the phases of pieces between breaks (pieces + 1,) [s] by their indices (pieces,)."""
    run_breaks = np.flatnonzero(np.diff(phase_index, prepend=-1, append=-1))
    return [
        motion.phases[phase_index[first]].retimed(float(breaks[first]), float(breaks[last]))
        for first, last in pairwise(run_breaks.tolist())
    ]


def _derivatives_on_clock(curve: PiecewisePolynomial, clock: ClockPlaces) -> Array:
    """Return the derivatives (4, K, *shape) of a curve by time, the zeroth first."""
    by_plan_time = _exact_jets(curve, clock.pieces, clock.jets[:, 0])
    clock_jets = clock.jets.reshape(-1, *(1,) * len(curve.shape), JET)
    return np.moveaxis(chained(by_plan_time, clock_jets), -1, 0)


def _exact_jets(curve: PiecewisePolynomial, pieces: Indices, times: Array) -> Array:
    """Return the jets (K, *shape, 4) of a curve's pieces (K,) at times (K,) [s].

    At the ends of pieces they are exact: tensions that vanish there stay zero.
    """
    column = (-1, *(1,) * len(curve.shape))  # of numbers (K,) next to values
    durations = curve.durations[pieces].reshape(column)
    since_start = (times - curve.breaks[pieces]).reshape(column)
    until_end = (curve.breaks[pieces + 1] - times).reshape(column)
    place = since_start / durations
    place = np.where(until_end <= BREAK_TOLERANCE, 1.0, place)
    place = np.where(since_start <= BREAK_TOLERANCE, 0.0, place)
    coefficients = curve.coefficients[pieces]
    jets = np.empty((len(pieces), *curve.shape, JET))
    for order in range(JET):
        jets[..., order] = bernstein.evaluate(coefficients, place) / durations**order
        coefficients = bernstein.differentiate(coefficients)
    return jets


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

    def constant(curve: PiecewisePolynomial) -> PiecewisePolynomial:
        return PiecewisePolynomial.constant([0.0, seconds], curve.coefficients[end])

    if phase is None:
        phase = motion.phases[0 if first else -1]
    if phase.state.clasping:
        phase = replace(phase, state=CableState.FREE)
    return motion.map_curves(constant, [phase.retimed(0.0, seconds)])


def prolonged(motion: Motion, seconds: float) -> Motion:
    """Return a motion that goes on at rest at its end, for some time in its last phase."""
    if seconds == 0.0:
        return motion

    def constant(curve: PiecewisePolynomial) -> PiecewisePolynomial:
        return PiecewisePolynomial.constant([0.0, seconds], curve.coefficients[-1, ..., -1])

    rest = motion.map_curves(constant, [motion.phases[-1].retimed(0.0, seconds)])
    return append_motion(motion, rest)


def with_last_poses(previous: Motion, motion: Motion) -> Motion:
    """Return a motion with objects at rest at their last poses in a previous motion."""
    last = previous.poses.coefficients[-1, ..., -1]
    return motion.replaced(poses=PiecewisePolynomial.constant(motion.drones.breaks, last))
