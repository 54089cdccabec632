"""Compiled arithmetic of a step of ``Feedback``: the filter of errors, and the law of corrections.

Arrays of the state are changed in place.
"""

from __future__ import annotations

import numpy as np

from hitchopt.compiled.correction_records import CorrectionState, Law, StepFlags, StepTimes
from hitchopt.compiled.half_space_kernel import Box, Spaces, within
from hitchopt.compiled.kernel_switch import kernel
from hitchopt.values import Array


@kernel
def filtered(state: CorrectionState, vertices: Array, planned: Array, law: Law) -> None:
    """Filter the errors of vertices as ``correction_law.filtered``."""
    error, age = state.error, state.age
    for k in range(len(age)):
        x, y, z = planned[k] - vertices[k]
        if not x * x + y * y + z * z <= law.largest_error * law.largest_error:
            continue
        weight = 1.0 if age[k] > law.held else -np.expm1(age[k] / -law.smoothing)
        error[k, 0] += weight * (x - error[k, 0])
        error[k, 1] += weight * (y - error[k, 1])
        error[k, 2] += weight * (z - error[k, 2])
        age[k] = 0.0


@kernel
def _product(matrix: Array, vectors: Array) -> Array:
    """Return a matrix (3a, 3b) times vectors (b, 3), as vectors (a, 3)."""
    out, flat = np.zeros(len(matrix)), vectors.copy().reshape(3 * len(vectors))
    for i in range(len(matrix)):
        for j in range(len(flat)):
            out[i] += matrix[i, j] * flat[j]
    return out.reshape(len(matrix) // 3, 3)


@kernel
def corrected(
    state: CorrectionState,
    cells: tuple[tuple[Spaces, Box], tuple[Spaces, Box]],
    response: tuple[Array, Array],
    times: StepTimes,
    flags: StepFlags,
    law: Law,
) -> Array:
    """Return the next offsets as ``correction_law.corrected``; cells as ``by_drones``."""
    error, speed, integral, age, offsets = state
    seconds, reach, share = times
    growing, followed, entered = flags
    wanted, most = np.zeros_like(error), law.largest_move
    for k in range(len(age)):
        if age[k] > law.held:
            integral[k] *= np.exp(-seconds / law.fading)
        for axis in range(3):
            known = error[k, axis] if age[k] <= law.held else 0.0
            onward = speed[k, axis] if age[k] <= law.held else 0.0
            grown = integral[k, axis] + (law.integral * seconds * known if growing else 0.0)
            integral[k, axis] = min(max(grown, -most), most)
            move = law.proportional * known + integral[k, axis] + law.lead * onward
            wanted[k, axis] = share * move
    asked = _product(response[1], wanted)
    goal = within(cells[0][0], cells[0][1], asked, law.passes, law.largest)
    if followed:
        goal = within(cells[1][0], cells[1][1], goal, law.passes, law.largest)
    largest, step = 0.0, 0.0
    for k in range(len(goal)):
        x, y, z = goal[k] - offsets[k]
        largest = max(largest, np.sqrt(x * x + y * y + z * z))
    if largest > 0.0:
        step = min(1.0, reach / largest)
    found = offsets + step * (goal - offsets)
    if entered:
        found = within(cells[0][0], cells[0][1], found, law.passes, law.largest)
    integral += min(seconds / law.unwinding, 1.0) * _product(response[0], found - asked)
    return found
