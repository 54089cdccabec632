"""How long objects are carried: over the bound of speed and acceleration, and what slows moves."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.families import lower_bound
from hitchopt.carrying.planner import AROUND_SPEED, CLOSING_SPEED
from hitchopt.motion.motion import Motion
from hitchopt.values import Array
from tests.helpers.carried_plans import plan
from tests.helpers.groups import part
from tests.helpers.plans import planned

SAMPLES = 101
"""Number of times at which speeds are compared."""

OBJECTS = [
    "tray",
    "drum",
    pytest.param("stone", marks=pytest.mark.slow),
]


@pytest.mark.parametrize("name", OBJECTS)
def test_carries_take_at_most_two_and_a_half_times_their_bound(name: str) -> None:
    """Three times where edges meet seven corners, at each of which drones rest."""
    assert plan(name).duration < (3.0 if name == "stone" else 2.5) * lower_bound(plan(name))


def velocities(motion: Motion, name: str) -> Array:
    """Return the velocities (times, n, 3) [m/s] of clasps at times of a phase."""
    phase = next(phase for phase in motion.phases if phase.name == name)
    t = np.linspace(phase.start, phase.end, SAMPLES)
    return motion.vertices.differentiated().at(t)


def speeds(motion: Motion, name: str) -> Array:
    """Return the largest speeds [m/s] of clasps at times of a phase."""
    largest: Array = np.max(np.linalg.norm(velocities(motion, name), axis=-1), axis=-1)
    return largest


@pytest.mark.parametrize("name", OBJECTS)
def test_clasps_around_an_object_are_slow(name: str) -> None:
    motion = plan(name).motion
    assert np.max(speeds(motion, "leave")) < 1.001 * AROUND_SPEED
    for phase in ("grasp", "loosen"):
        assert np.max(speeds(motion, phase)) < 1.001 * AROUND_SPEED
        sliding = velocities(motion, phase)[..., :2]  # a hitch rises to a rim as it is
        assert np.max(np.linalg.norm(sliding, axis=-1)) < 1.001 * CLOSING_SPEED


def test_hitches_descend_as_they_travel() -> None:
    """From 1.4 m a hitch that encloses a tray at 0.6 m stops once, above it."""
    motion = planned("carry_tray").motion
    moving = speeds(motion, "enclose") > 0.05
    starts = np.flatnonzero(~moving[:-1] & moving[1:])
    assert len(starts) == 2
    first = part(motion, "enclose", "enclose")
    halfway = first.vertices.at(0.25 * first.duration)[0]
    assert np.all(np.abs(halfway - first.vertices.at(0.0)[0])[[0, 2]] > 0.05)
