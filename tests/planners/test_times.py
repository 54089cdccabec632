"""Rows of speeds and accelerations against the limits that they linearise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import hitchopt as ho
from hitchopt.geometry.vectors import length
from hitchopt.planners.optimise.guesses import turning_edges
from hitchopt.planners.optimise.knots import KnotPath
from hitchopt.planners.optimise.times import (
    TimedRows,
    acceleration_rows,
    accelerations,
    segment_times,
    speed_rows,
    step_times,
)

LIMITS = ho.Limits()


def turning_path() -> KnotPath:
    """Return a path of a square that turns by half a right angle and shrinks, off the origin."""
    team = ho.Team(4, 3.0)
    start, goal = (
        ho.Hitch.balanced(team, ho.regular_polygon(4, edge).rotated(angle).translated(centre))
        for edge, angle, centre in ((1.4, 0.1, (1.0, -2.0)), (1.0, -0.7, (2.5, -1.5)))
    )
    polygons = turning_edges(start.polygon, goal.polygon, 0.8, np.linspace(0.0, 1.0, 9))
    assert polygons is not None
    return KnotPath.through("turned", start, goal, polygons)


def changed(
    path: KnotPath, times: np.ndarray, rows: TimedRows, kind: str
) -> tuple[np.ndarray, np.ndarray]:
    """Return the changes of the rows' values with a small step: by the rows, and true ones."""
    rng = np.random.default_rng(7)
    inner, knots = np.zeros_like(path.table), slice(1, -1)
    inner[knots] = 1e-6 * rng.normal(size=path.table[knots].shape)
    shift = 1e-6 * rng.normal(size=len(times))
    linear = np.asarray(rows.by_table(path) @ inner[knots].ravel())
    row, step, entry = rows.by_times(len(times))
    np.add.at(linear, row, entry * shift[step])

    def values(table: np.ndarray, durations: np.ndarray) -> np.ndarray:
        """Return all nodes' values at all steps, or all knots."""
        places = table[:, path.columns.nodes]
        if kind == "speed":
            speeds = np.repeat([LIMITS.vertex_speed, LIMITS.speed], [4, 8])
            return np.asarray(length(np.diff(places, axis=0)) / speeds - durations[:, None])
        return np.asarray(length(accelerations(places, durations)[0]))

    at = (rows.steps[:, 0] if kind == "speed" else rows.knots[:, 1]), rows.node
    true = values(path.table + inner, times + shift) - values(path.table, times)
    return linear, true[at]


@pytest.mark.parametrize("kind", ["speed", "acceleration"])
def test_rows_are_derivatives_of_what_they_limit(kind: str) -> None:
    path = turning_path()
    times = step_times(path, LIMITS)
    rows = (speed_rows if kind == "speed" else acceleration_rows)(path, LIMITS, times)
    assert len(rows.spare) > 4
    linear, true = changed(path, times, rows, kind)
    np.testing.assert_allclose(linear, true, rtol=1e-3, atol=1e-9)


def test_accelerations_are_those_of_a_known_motion() -> None:
    """From rest with a constant acceleration, to rest with the opposite one."""
    times = np.array([0.3, 0.5, 0.5, 0.3])
    t = np.append(0.0, np.cumsum(times))
    half = 0.5 * t[-1]
    s = np.where(t <= half, 0.5 * t**2, half**2 - 0.5 * (t[-1] - t) ** 2)
    places = np.multiply.outer(s, [[3.0, 4.0]])
    found, _, _ = accelerations(places, times)
    np.testing.assert_allclose(length(found[[0, 1, 3, 4], 0]), 5.0)
    np.testing.assert_allclose(found[2], 0.0, atol=1e-12)


def test_steps_take_as_long_as_on_the_fastest_flight() -> None:
    """Longer than speeds alone would need, since drones speed up."""
    path = turning_path()
    times, alone = step_times(path, LIMITS), np.max(segment_times(path, LIMITS), axis=1)
    assert np.all(times >= alone)
    assert np.sum(times) > np.sum(alone) + 0.3
    swift = replace(LIMITS, acceleration=150.0, tilt=1.5)
    np.testing.assert_allclose(np.sum(step_times(path, swift)), np.sum(alone), rtol=0.1)
