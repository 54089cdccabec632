"""Steps of the optimiser until a way comes to rest."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hitchopt.planners.optimise.knot_path import Way
from hitchopt.planners.optimise.morph_program import build_program
from hitchopt.planners.optimise.solver import solve_program
from hitchopt.planners.optimise.variable_bounds import Bounds, Step

SETTLED = 0.3
"""Of its stride: a step of the optimiser that moves no vertex by more is the last one."""


def iterates(
    way: Way, bounds: Bounds, step: Step, most: int, settled: float = SETTLED
) -> Iterator[Way]:
    """Yield the ways that one after another are reached in steps of the optimiser.

    Every step sees the pairs that come near on it, along normals that fit. The iterator ends where
    a step fails, or after one that moves no vertex by ``settled`` times its stride.
    """
    for _ in range(most):
        moved = solve_program(build_program(way, bounds, step))
        if moved is None:
            return
        far = float(np.max(np.abs(moved.polygons - way.polygons)))
        way = moved
        yield way
        if far < settled * step.stride:
            return
