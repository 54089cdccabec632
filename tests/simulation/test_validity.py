"""Simulations that become invalid are ended, each for its own reason."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hitchopt.simulation.cable_shapes import hanging
from hitchopt.simulation.mujoco_world import World
from hitchopt.simulation.ropes import Ropes
from hitchopt.simulation.simulation_settings import ACCURATE, FAST
from hitchopt.simulation.validity import MOST_STRAIN, InvalidRunError, check_valid, tensions

PLACES = np.array([[0.0, 0.0, 3.0], [1.0, 0.0, 3.0], [0.0, 2.0, 3.0], [1.0, 2.0, 3.0]])


@pytest.fixture
def world() -> World:
    """Return two cables that hang between four drones."""
    ropes = Ropes(np.array([1.5, 1.5]), 0.01, 0.1, FAST)
    found = World(ropes, np.full(4, 0.13), rigid=False)
    found.place(hanging(ropes, PLACES, 0.0))
    return found


def pulled(world: World, force: float, steps: int) -> None:
    """Pull the drones of cable 1 apart, against the weight of all."""
    world.data.xfrc_applied[world.drone_bodies, 2] = 9.81 * 0.1375
    world.data.xfrc_applied[world.drone_bodies[2:], 0] = [-force, force]
    for _ in range(steps):
        world.step()
        check_valid(world, 0.25)


def test_a_cable_that_hangs_is_valid_and_pulls_as_a_catenary_does(world: World) -> None:
    pulled(world, 0.0, 1)
    pull = tensions(world)
    assert np.all(pull > -0.01)
    assert np.max(pull) < 0.01 * 9.81 * 1.5


def test_ropes_that_become_firmer_do_not_jerk() -> None:
    """What they have yielded under their tension is not to pull at once when steps are refined."""
    ropes = Ropes(np.array([1.5, 1.5]), 0.01, 0.1, ACCURATE)
    world = World(ropes, np.full(4, 0.13), rigid=False)
    world.place(hanging(ropes, PLACES, 0.0))
    force = np.array([[-0.5, 0.0, 0.0], [0.5, 0.0, 0.0]] * 2)
    force[:, 2] = 9.81 * 0.1375

    def largest(steps: int, finer: int) -> float:
        found = 0.0
        for _ in range(steps):
            slowed = force - 2.0 * world.data.qvel[world.drone_dofs]
            world.data.xfrc_applied[world.drone_bodies, :3] = slowed
            world.step(10, finer=finer)
            found = max(found, float(np.max(tensions(world))))
        return found

    largest(600, 1)
    taut = largest(20, 1)
    assert taut == pytest.approx(0.5, abs=0.05)
    assert largest(100, 2) < 1.5 * taut


def test_an_overloaded_cable_is_reported(world: World) -> None:
    with pytest.raises(InvalidRunError, match="ropes may have passed each other") as caught:
        pulled(world, 12.0, 2000)
    assert caught.value.quantity in {"strain", "tension"}
    assert caught.value.where == "cable 1"
    assert caught.value.time == 0.25
    if caught.value.quantity == "tension":
        assert caught.value.value > world.ropes.largest_tension


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


def test_a_rope_picked_up_from_the_ground_is_valid_since_its_lengths_answer_faster() -> None:
    drones, lifted = np.array([[0.0, 0.0, 0.03], [0.6, 0.0, 0.03]]), []
    for loose in (False, True):
        found = World(Ropes(np.array([1.2]), 0.01, 0.0, ACCURATE), np.full(2, 0.13), rigid=False)
        found.place(hanging(found.ropes, drones, 0.0))
        step, worst = ACCURATE.time_step, 0.0
        for k in range(int(0.9 / (5 * step))):
            # Drones that are led upward at 1 m/s by a soft position loop.
            goal = drones + [0.0, 0.0, 5 * step * k]
            away = goal - found.drones, [0.0, 0.0, 1.0] - found.data.qvel[found.drone_dofs]
            force = 40.0 * away[0] + 4.0 * away[1] + [0.0, 0.0, 9.81 * 0.136]
            found.data.xfrc_applied[found.drone_bodies, :3] = force
            found.step(5, loose=loose)
            worst = max(worst, float(np.max(np.abs(found.strains))))
            assert found.data.time == pytest.approx(5 * step * (k + 1))
        assert np.min(found.nodes[:, 2]) > 0.1  # all of it has left the ground
        lifted.append(worst)
    assert lifted[0] > 1.3 * MOST_STRAIN
    assert lifted[1] < 0.8 * MOST_STRAIN
