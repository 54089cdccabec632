"""A drone keeps off its own hanging cable where that rises again, as off all others."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import hitchopt as ho
from hitchopt import verify
from hitchopt.checks.distances import smallest
from hitchopt.checks.hanging import drones_and_own_cables
from hitchopt.hitch import Team
from hitchopt.motion.motion import Motion
from hitchopt.motion.plan_file import write_plan
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array
from tests.helpers.by_hand import own_cable_distance
from tests.helpers.motions import free_motion, random_flight, row


def turned(angle: float) -> Array:
    """Return the rotation about the vertical axis."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def pair(offsets: Array, length: float = 2.4, **requirements: object) -> Motion:
    """Two cables, turned and off the origin; the first one's lower drone moves past its end.

    ``offsets`` (k, 3) [m] are of the upper drone from the lower one, coefficients of a polynomial.
    """
    lower = np.zeros_like(offsets)
    far = np.array([0.0, 16.0, 0.0]) + np.zeros_like(offsets)
    beyond = far + [0.6 * length, 0.0, 0.0]
    places = np.stack([lower, lower + offsets, far, beyond]) @ turned(0.8).T + [4.0, -3.0, 16.0]
    drones = PiecewisePolynomial(np.array([0.0, 2.0]), np.moveaxis(places, 1, -1)[None])
    return free_motion(Team(2, length, topology="open"), drones, **requirements)


def proven(motion: Motion, folder: Path) -> bool:
    """Whether verify proves the clearance of cables."""
    write_plan(folder / "plan.npz", ho.Flight.of(motion))
    rows = [each for each in verify.verify(folder) if each.name == "cable_clearance"]
    return all(each.verdict == "proven" for each in rows)


@pytest.mark.parametrize(
    ("first", "last", "holds"),
    [
        ([0.005, 0.0, 0.65], [0.005, 0.0, 0.65], False),
        ([0.3, 0.0, 0.65], [0.02, 0.08, 0.7], False),
        ([0.3, 0.0, 0.65], [0.2, 0.2, 0.9], True),
        ([0.8, 0.0, 0.0], [0.5, 0.3, 0.0], True),
        ([0.6, 0.0, 2.0], [1.5, 0.0, 1.7], True),
        ([0.6, 0.0, 2.25], [0.4, 0.0, 2.3], True),
    ],
)
@pytest.mark.parametrize("upper_first", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_cables_do_not_rise_past_their_own_lower_drone(
    first: list[float], last: list[float], *, holds: bool, upper_first: bool, tmp_path: Path
) -> None:
    """A cable that is nearly taut, and leads away from both drones, does not."""
    offsets = np.array([first, last]) * (-1.0 if upper_first else 1.0)
    motion = pair(offsets)
    check = row(motion, "cable_clearance")
    assert check.holds is holds
    if not holds:
        assert check.where == ("r0" if upper_first else "q0", "cable 0")
    assert proven(motion, tmp_path) is holds


@pytest.mark.parametrize("length", [0.9, 2.4, 14.0])
def test_cables_of_any_length_leave_their_drones(length: float, tmp_path: Path) -> None:
    """Links of long cables end where they begin to count."""
    rise = 0.3 * length
    motion = pair(np.array([[0.5, 0.0, rise], [0.4, 0.1, 0.9 * rise]]), length)
    assert row(motion, "cable_clearance").holds
    assert proven(motion, tmp_path)


def test_errors_of_drones_do_not_bring_taut_cables_nearer() -> None:
    """What is within twice the widened limit along the cable is not checked."""
    motion = pair(np.array([[0.6, 0.0, 2.25], [0.4, 0.0, 2.3]]), limits=ho.Limits(tracking=0.08))
    found = smallest(drones_and_own_cables(motion), relative=1e-3, absolute=1e-3)
    least = own_cable_distance(motion, motion.drones.at(np.linspace(0.0, 2.0, 401)), 1201)
    assert least > 0.45
    assert 0.7 * least <= found.worst <= least


@pytest.mark.parametrize("seed", range(8))
def test_no_sample_of_an_own_cable_is_nearer(seed: int) -> None:
    rng = np.random.default_rng(seed)
    if seed % 2:
        team, drones = random_flight(seed, n=2, pieces=2)
        motion = free_motion(team, drones)
    else:
        ends = rng.uniform(-0.4, 0.4, (4, 3)) * [1.0, 1.0, 2.0] + [0.0, 0.0, 0.5]
        motion = pair(ends, 2.9)
    found = smallest(drones_and_own_cables(motion), relative=1e-3, absolute=1e-3)
    breaks = motion.drones.breaks
    times = np.linspace(breaks[0], breaks[-1], 401)
    least = own_cable_distance(motion, motion.drones.at(times), 1201)
    assert found.worst <= least
    assert found.worst >= 0.9 * least - 0.02


def test_problems_whose_cables_start_between_rotors_are_refused() -> None:
    ends = np.array([[0.7, 2.2, 1.8], [0.7, 0.9, 1.8], [0.7, -0.4, 1.8]])
    problem = {
        "team": {"robots": 3, "cable_length": 2.3, "cable_density": 0.01, "tension": 0.7},
        "start": {"drones": {"q": ends.tolist(), "r": (ends + [0.03, 0.01, 0.7]).tolist()}},
        "mission": [
            {"form": {"polygon": [[0.0, 0.63], [0.55, -0.32], [-0.55, -0.32]], "altitude": 1.5}}
        ],
    }
    with pytest.raises(ho.InfeasibleError, match=r"cable_clearance: 0\.0\d+ m.*q\d, cable \d"):
        ho.solve(ho.problem_from_dict(problem))
