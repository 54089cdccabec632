"""Simulations that become invalid are ended, each for its own reason."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hitchopt.simulation.cable_shapes import hanging
from hitchopt.simulation.mujoco_world import World
from hitchopt.simulation.ropes import Ropes
from hitchopt.simulation.simulation_settings import FAST
from hitchopt.simulation.validity import InvalidRunError, check_valid, tensions

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
