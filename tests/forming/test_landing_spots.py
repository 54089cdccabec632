"""Landing spots of ``release`` and ``land``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hitchopt as ho
from hitchopt import verify as second

TEAM = ho.Team(robots=3, cable_length=2.4, cable_density=0.005, quadrotor="paper_132g")
START = ho.Hitch.spread(TEAM, [[0, 0.58], [0.5, -0.29], [-0.5, -0.29]], altitude=1.4)
SPOTS = np.array([[2.2, -1.0], [2.2, 0.0], [3.4, -1.0], [3.4, 0.0], [2.8, 2.0], [2.8, 1.0]])
ARENA = ho.Arena([-3, -3, 0], [5, 4, 4])


def landed(spots: Any = SPOTS, shift: Any = (0, 0), **options: Any) -> ho.Plan:
    """A hitch that is untied, and whose drones land."""
    place = START.vertices[:, :2] + shift
    start = ho.Hitch.spread(TEAM, place, altitude=1.4)
    assign = options.pop("assign", "auto")
    steps = [ho.Release(), ho.Land(to=np.asarray(spots), assign=assign)]
    return ho.solve(start, steps, **options)


def ends(plan: ho.Plan) -> np.ndarray:
    """Drones (2n, 3) at the end, in the order of the problem."""
    places: np.ndarray = plan.motion.drones.at(plan.duration)[plan.motion.team.listed]
    return places


@pytest.mark.slow
@pytest.mark.parametrize("assign", ["auto", "fixed"])
def test_drones_land_on_the_spots(assign: str, tmp_path: Path) -> None:
    plan = landed(assign=assign, arena=ARENA)
    distances = np.linalg.norm(ends(plan)[:, None, :2] - SPOTS, axis=-1)
    np.testing.assert_allclose(np.min(distances, axis=0), 0.0, atol=1e-9)
    np.testing.assert_allclose(ends(plan)[:, 2], 0.0, atol=1e-9)
    is_in_order = np.array_equal(np.argmin(distances, axis=1), np.arange(6))
    assert is_in_order == (assign == "fixed")
    robots = np.argmin(distances, axis=1).reshape(3, 2) // 2
    np.testing.assert_array_equal(robots[:, 0], robots[:, 1])  # a robot takes one pair
    plan.save(tmp_path)
    assert {row.verdict for row in second.verify(tmp_path / "plan.npz")} <= second.PASSING


@pytest.mark.slow
def test_all_is_moved_alike() -> None:
    shift = np.array([12.5, -7.0])
    here, there = landed(), landed(SPOTS + shift, shift)
    assert there.duration == pytest.approx(here.duration, rel=1e-6)
    np.testing.assert_allclose(ends(there)[:, :2], ends(here)[:, :2] + shift, atol=1e-6)


@pytest.mark.slow
def test_released_drones_hover_over_the_spots_and_land_there() -> None:
    start = ho.Hitch.spread(TEAM, START.polygon, altitude=1.4)
    plan = ho.solve(start, [ho.Release(to=SPOTS, assign="fixed"), ho.Land()])
    released = next(phase.end for phase in plan.motion.phases[::-1] if phase.step == 0)
    over = plan.motion.drones.at(released)[plan.motion.team.listed]
    np.testing.assert_allclose(over[:, :2], SPOTS, atol=1e-9)
    assert np.min(over[:, 2]) > 1.0
    np.testing.assert_allclose(ends(plan)[:, :2], SPOTS, atol=1e-9)


def test_wrong_numbers_of_spots_are_refused() -> None:
    with pytest.raises(ho.InputError, match=r"land\.to = .* must be 6 spots, one per drone"):
        landed(SPOTS[:5])
    with pytest.raises(ho.InputError, match=r"a point \[x, y\]"):
        landed(np.zeros((6, 3)))


BRICK = ho.Section(ho.regular_polygon(4, 0.4).vertices)
CROWDED, OUTSIDE, FAR = SPOTS.copy(), SPOTS.copy(), SPOTS.copy()
CROWDED[2] = SPOTS[0] + [0.2, 0.0]
OUTSIDE[5] = [2.8, 4.2]
FAR[1] = [2.2, 2.0]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("spots", "options", "words"),
    [
        (CROWDED, {}, r"separation: .* at [qr][01], [qr][01] landed, in step 1"),
        (OUTSIDE, {"arena": ARENA}, r"arena: .* at [qr]\d landed, in step 1"),
        (FAR, {}, r"span: .* landed, in step 1"),
        (
            SPOTS,
            {"objects": {"box": ho.SolidObject(BRICK, upper=0.4, at=[2.2, 0, 0], fixed=True)}},
            r"object_clearance|keep_out: .* box .* landed, in step 1",
        ),
    ],
)
def test_impossible_spots_are_named(spots: Any, options: dict[str, Any], words: str) -> None:
    with pytest.raises(ho.InfeasibleError, match=words):
        landed(spots, assign="fixed", **options)
