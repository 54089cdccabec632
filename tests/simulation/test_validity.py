"""The world: runs that become invalid end, contacts have names, wakes keep their momentum."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hitchopt.simulation.contacts import touching
from hitchopt.simulation.control import BLOCKED, SPREADING, downwash
from hitchopt.simulation.ropes import Ropes, hanging
from hitchopt.simulation.settings import ACCURATE, FAST, Preset
from hitchopt.simulation.world import (
    BODY_HALF_HEIGHT,
    BODY_RADIUS,
    MOST_STRAIN,
    InvalidRunError,
    World,
    check_valid,
)
from hitchopt.values import Array

PLACES = np.array([[0.0, 0.0, 3.0], [1.0, 0.0, 3.0], [0.0, 2.0, 3.0], [1.0, 2.0, 3.0]])


def hung(drones: Array, preset: Preset = FAST) -> World:
    """Return two cables that hang between four drones."""
    world = World(Ropes(np.array([1.5, 1.5]), 0.01, 0.1, preset), np.full(4, 0.13), 0.0, {})
    world.place(hanging(world.ropes, drones, 0.0))
    return world


@pytest.fixture
def world() -> World:
    return hung(PLACES)


@pytest.mark.slow
def test_ropes_that_become_firmer_do_not_jerk() -> None:
    """What they have yielded under their tension is not to pull at once when steps are refined."""
    world, peaks = hung(PLACES, ACCURATE), []
    force = np.array([[-0.5, 0.0, 0.0], [0.5, 0.0, 0.0]] * 2)
    force[:, 2] = 9.81 * 0.1375
    for step in range(720):
        slowed = force - 2.0 * world.data.qvel[world.drone_dofs]
        world.data.xfrc_applied[world.drone_bodies, :3] = slowed
        world.step(10, finer=1 if step < 620 else 2)
        peaks.append(float(np.max(world.tensions)))
    taut = max(peaks[600:620])
    assert taut == pytest.approx(0.5, abs=0.05)
    assert max(peaks[620:]) < 1.5 * taut


def test_an_overloaded_cable_is_reported(world: World) -> None:
    world.data.xfrc_applied[world.drone_bodies, 2] = 9.81 * 0.1375
    world.data.xfrc_applied[world.drone_bodies[2:], 0] = [-12.0, 12.0]

    with pytest.raises(InvalidRunError, match="ropes may have passed each other") as caught:  # noqa: PT012
        for _ in range(2000):
            world.step()
            check_valid(world, 0.25)
    assert caught.value.quantity in {"strain", "tension"}
    assert (caught.value.where, caught.value.time) == ("cable 1", 0.25)


def test_cables_that_penetrate_each_other_are_reported(world: World) -> None:
    shifted = [world.cables[0].copy(), world.cables[0] + [0.0, 0.006, 0.0]]
    world.place(shifted)
    world.step()
    with pytest.raises(InvalidRunError, match=r"penetration of 0\.00") as caught:
        check_valid(world, 1.0)
    assert caught.value.where == "cables 0 and 1"


def test_numbers_that_explode_end_the_run_and_leave_no_file(
    world: World, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    world.data.xfrc_applied[world.drone_bodies, :3] = 1e12
    world.step()
    with pytest.raises(InvalidRunError, match=r"its state is no longer finite, t = 2\.000 s"):
        check_valid(world, 2.0)
    assert list(tmp_path.iterdir()) == []
    assert capfd.readouterr() == ("", "")


@pytest.mark.slow
def test_a_rope_picked_up_from_the_ground_is_valid_since_its_lengths_answer_faster() -> None:
    drones, lifted = np.array([[0.0, 0.0, 0.03], [0.6, 0.0, 0.03]]), []
    for loose in (False, True):
        found = World(Ropes(np.array([1.2]), 0.01, 0.0, ACCURATE), np.full(2, 0.13), 0.0, {})
        found.place(hanging(found.ropes, drones, 0.0))
        step, worst = ACCURATE.time_step, 0.0
        for k in range(int(0.9 / (5 * step))):
            # Drones that are led upward at 1 m/s by a soft position loop.
            goal = drones + [0.0, 0.0, 5 * step * k]
            away = goal - found.drones, [0.0, 0.0, 1.0] - found.data.qvel[found.drone_dofs]
            force = 40.0 * away[0] + 4.0 * away[1] + [0.0, 0.0, 9.81 * 0.136]
            found.data.xfrc_applied[found.drone_bodies, :3] = force
            found.step(5, loose=loose)
            strains = found.data.flexedge_length / found.model.flexedge_length0 - 1.0
            worst = max(worst, float(np.max(np.abs(strains))))
            assert found.data.time == pytest.approx(5 * step * (k + 1))
        assert np.min(found.nodes[:, 2]) > 0.1  # all of it has left the ground
        lifted.append(worst)
    assert lifted[0] > 1.3 * MOST_STRAIN
    assert lifted[1] < 0.8 * MOST_STRAIN


@pytest.mark.parametrize("depth", [1.5, 3.0])
def test_the_jet_carries_the_momentum_of_the_thrust(depth: float) -> None:
    """Small adjacent disks over the whole plane receive all of it."""
    grid, total = np.linspace(-1.5, 1.5, 61), 0.0
    for x in grid:
        below = np.column_stack([np.full_like(grid, x), grid, np.zeros_like(grid)])
        thrusts = np.append(1.3, np.zeros(len(grid)))
        total -= np.sum(downwash(np.vstack([[0.0, 0.0, depth], below]), thrusts)[1:, 2])
    caught = total / BLOCKED * (grid[1] - grid[0]) ** 2 / (np.pi * BODY_RADIUS**2)
    assert caught == pytest.approx(1.3, rel=0.01)
    width = 0.5 * BODY_RADIUS + SPREADING * depth  # where its speed is half of that on its axis
    two = np.array([[0.0, 0.0, depth], [0.0, 0.0, 0.0], [width, 0.0, 0.0]])
    on_axis, aside = downwash(two, np.array([1.3, 0.0, 0.0]))[1:, 2]
    assert aside / on_axis == pytest.approx(0.25)


def test_drones_and_cables_in_contact_are_reported_by_name() -> None:
    next_to, above, through = PLACES.copy(), PLACES.copy(), PLACES.copy()
    next_to[2:] = [[0.1, 0.0, 3.02], [0.1, 1.0, 3.0]]  # q1 next to q0
    assert ("q0", "q1") in touching(hung(next_to))
    above[2:] = [[0.0, 0.0, 3.0 + 2.1 * BODY_HALF_HEIGHT], [0.0, 1.0, 3.0]]  # no ball
    assert ("q0", "q1") not in touching(hung(above))
    middle = hung(PLACES).cables[0]
    through[3] = middle[len(middle) // 2] + [0.0, 0.05, 0.0]  # r1 at the lowest point of cable 0
    through[2] = through[3] + [0.0, 1.0, 0.5]
    assert touching(hung(through)) == [("r1", "cable 0")]


def test_a_drone_that_has_landed_may_stand_on_its_own_cable() -> None:
    """Its two drones are side by side, and the cable between them is folded up."""
    for height, expected in ((0.04, []), (1.0, [("q0", "cable 0"), ("r0", "cable 0")])):
        world = World(Ropes(np.array([0.5, 1.5]), 0.01, 0.1, FAST), np.full(4, 0.13), 0.0, {})
        count = world.ropes.segments + 1
        cable = np.linspace([0.0, 0.0, height], [0.16, 0.0, height], count[0])
        world.place([cable, np.linspace([0.0, 2.0, height], [1.5, 2.0, height], count[1])])
        assert [pair for pair in touching(world) if pair[1] == "cable 0"] == expected
