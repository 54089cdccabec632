"""The filter of measured errors, and the law of corrections, for steps of ``Feedback``."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hitchopt.feedback.covered_set import ONES, HalfSpaces
from hitchopt.values import Array


class Law(NamedTuple):
    """Constants of the filter and the law, as ``hitchopt.feedback.feedback`` explains them."""

    proportional: float
    integral: float
    lead: float
    unwinding: float
    smoothing: float
    largest_error: float
    largest_move: float
    held: float
    fading: float
    passes: int
    largest: float


class CorrectionState(NamedTuple):
    """What a step changes in place.

    Attributes
    ----------
    error: (clasps, 3) [m], filtered.
    speed: (clasps, 3) [m/s], planned.
    integral: (clasps, 3) [m]
    age: (clasps,) [s], since each was measured.
    offsets: (drones, 3) [m], of setpoints.
    """

    error: Array
    speed: Array
    integral: Array
    age: Array
    offsets: Array


class StepTimes(NamedTuple):
    """Numbers of one step.

    Attributes
    ----------
    seconds: since the last one [s].
    reach: largest change of an offset [m].
    share: of corrections that applies, from 0 to 1.
    """

    seconds: float
    reach: float
    share: float


class StepFlags(NamedTuple):
    """Whether the integral grows, another cell follows, and this cell is entered."""

    growing: bool
    followed: bool
    entered: bool


def filtered(state: CorrectionState, vertices: Array, planned: Array, law: Law) -> None:
    """Filter the errors of vertices, measured and planned (clasps, 3); nan is not measured."""
    error = planned - vertices
    good = (error * error) @ ONES <= law.largest_error * law.largest_error  # false for nan
    weight = -np.expm1(state.age / -law.smoothing)
    weight[state.age > law.held] = 1.0
    if not good.all():
        weight[~good] = 0.0
        error[~good] = 0.0
    np.add(state.error, weight[:, None] * (error - state.error), out=state.error)
    state.age[good] = 0.0


def corrected(
    state: CorrectionState,
    cells: tuple[HalfSpaces, HalfSpaces],
    response: tuple[Array, Array],
    times: StepTimes,
    flags: StepFlags,
    law: Law,
) -> Array:
    """Return the next offsets (drones, 3) [m], and advance the integral.

    Parameters
    ----------
    cells: this one, and the one that follows.
    response: forward and inverse, of ``VertexResponse`` here.
    """
    cell, following = cells
    forward, inverse = response
    wanted = times.share * _wanted(state, times, flags, law)
    asked = (inverse @ wanted.ravel()).reshape(-1, 3)
    goal = cell.within(asked)
    if flags.followed:
        goal = following.within(goal)
    offsets = _toward(goal, state, cell if flags.entered else None, times)
    missed = (forward @ (offsets - asked).ravel()).reshape(-1, 3)
    np.add(state.integral, min(times.seconds / law.unwinding, 1.0) * missed, out=state.integral)
    return offsets


def uncorrected(
    state: CorrectionState, cell: HalfSpaces | None, times: StepTimes, flags: StepFlags, law: Law
) -> Array:
    """Return the next offsets (drones, 3) [m] where none is wanted; the integral goes on."""
    _wanted(state, times, flags, law)
    return _toward(np.zeros_like(state.offsets), state, cell if flags.entered else None, times)


def _wanted(state: CorrectionState, times: StepTimes, flags: StepFlags, law: Law) -> Array:
    """Return by how much vertices are to be moved (clasps, 3) [m], and advance the integral."""
    error, speed, integral = state.error, state.speed, state.integral
    fresh = state.age <= law.held
    if not fresh.all():
        error, speed = fresh[:, None] * error, fresh[:, None] * speed
        integral[~fresh] *= math.exp(-times.seconds / law.fading)
    if flags.growing:
        np.add(integral, (law.integral * times.seconds) * error, out=integral)
    np.minimum(np.maximum(integral, -law.largest_move), law.largest_move, out=integral)
    wanted: Array = law.proportional * error + integral + law.lead * speed
    return wanted


def _toward(
    goal: Array, state: CorrectionState, cell: HalfSpaces | None, times: StepTimes
) -> Array:
    """Return offsets on the straight line to a goal, and within a cell that is entered.

    Else they are between two of the same convex set.
    """
    change = goal - state.offsets
    largest = math.sqrt(np.maximum.reduce((change * change) @ ONES))
    step = min(1.0, times.reach / largest) if largest > 0.0 else 0.0
    offsets = state.offsets + step * change
    return offsets if cell is None else cell.within(offsets)
