"""Downwash preserves the jet's momentum; drag slows; contacts are reported by name."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from hitchopt.simulation.air_forces import BLOCKED, downwash, drag
from hitchopt.simulation.cable_shapes import hanging
from hitchopt.simulation.drone_contacts import touching
from hitchopt.simulation.mujoco_world import World
from hitchopt.simulation.mujoco_xml import BODY_HALF_HEIGHT, BODY_RADIUS
from hitchopt.simulation.ropes import Ropes
from hitchopt.simulation.simulation_settings import FAST

Array = NDArray[np.float64]

APART = np.array(
    [[0.0, 0.0, 3.0], [1.0, 0.0, 3.0], [0.0, 2.0, 3.0], [1.0, 2.0, 3.0]]
)  # q0, r0, q1, r1


def hung(drones: Array) -> World:
    ropes = Ropes(np.array([1.5, 1.5]), 0.01, 0.1, FAST)
    world = World(ropes, np.full(4, 0.13), rigid=False)
    world.place(hanging(ropes, drones, 0.0))
    return world


def test_downwash_goes_down_on_those_below_and_fades_aside() -> None:
    drones = np.array([[0.0, 0.0, 2.0], [0.0, 0.0, 1.4], [0.3, 0.0, 1.4], [3.0, 0.0, 1.0]])
    found = downwash(drones, np.full(4, 1.3))
    np.testing.assert_array_equal(found[:, :2], 0.0)
    assert found[0, 2] == 0.0
    assert -BLOCKED * 1.3 <= found[1, 2] < -0.05
    assert found[1, 2] < found[2, 2] <= 0.0
    assert abs(found[3, 2]) < 1e-6


@pytest.mark.parametrize("depth", [1.5, 3.0])
def test_the_jet_carries_the_momentum_of_the_thrust(depth: float) -> None:
    """Small adjacent disks over the whole plane receive all of it."""
    grid = np.linspace(-1.5, 1.5, 121)
    below = np.array([[x, y, 0.0] for x in grid for y in grid])
    total = 0.0
    for chunk in np.array_split(below, 40):
        drones = np.vstack([[0.0, 0.0, depth], chunk])
        thrusts = np.zeros(len(drones))
        thrusts[0] = 1.3
        total += -np.sum(downwash(drones, thrusts)[1:, 2])
    cell = (grid[1] - grid[0]) ** 2
    caught = total / BLOCKED * cell / (np.pi * BODY_RADIUS**2)
    assert caught == pytest.approx(1.3, rel=0.01)


def test_drag_opposes_motion_and_grows_with_its_square() -> None:
    world = hung(APART)
    world.data.qvel[world.node_dofs] = [0.3, -0.4, 0.0]
    slow = drag(world)
    world.data.qvel[world.node_dofs] *= 2.0
    fast = drag(world)
    np.testing.assert_allclose(fast, 4.0 * slow)
    np.testing.assert_allclose(slow[:, 0] / slow[:, 1], -0.75)
    assert np.all(slow[:, 0] < 0.0)
    length = world.ropes.segment_lengths[0]
    np.testing.assert_allclose(
        np.linalg.norm(slow, axis=1), 0.5 * 1.2 * 1.2 * FAST.diameter * length * 0.25
    )


def test_nothing_touches_where_all_is_apart() -> None:
    assert touching(hung(APART)) == []


def test_drones_and_cables_in_contact_are_reported_by_name() -> None:
    drones = APART.copy()
    drones[2:] = [[0.1, 0.0, 3.02], [0.1, 1.0, 3.0]]  # q1 next to q0
    found = set(touching(hung(drones)))
    assert ("q0", "q1") in found
    through = APART.copy()
    middle = hung(APART).cables[0]
    through[3] = middle[len(middle) // 2] + [0.0, 0.05, 0.0]  # r1 at the lowest point of cable 0
    through[2] = through[3] + [0.0, 1.0, 0.5]
    found = set(touching(hung(through)))
    assert found == {("r1", "cable 0")}
    above = APART.copy()
    above[2:] = [[0.0, 0.0, 3.0 + 2.1 * BODY_HALF_HEIGHT], [0.0, 1.0, 3.0]]  # no ball
    assert ("q0", "q1") not in touching(hung(above))


def test_a_free_cable_hangs_on_as_it_was_placed() -> None:
    world = hung(APART)
    before = world.nodes.copy()
    weight = 9.81 * (0.13 + 0.5 * 0.01 * 1.5)
    for _ in range(200):
        force = np.zeros((4, 3))
        force[:, 2] = weight
        force += 40.0 * (APART - world.drones) - 2.0 * world.data.qvel[world.drone_dofs]
        world.data.xfrc_applied[world.drone_bodies, :3] = force
        world.step()
    assert np.max(np.linalg.norm(world.nodes - before, axis=1)) < 0.03


def test_a_drone_that_has_landed_may_stand_on_its_own_cable() -> None:
    """Its two drones are side by side, and the cable between them is folded up."""
    for height, expected in ((0.04, []), (1.0, ["cable 0"])):
        ropes = Ropes(np.array([0.5, 1.5]), 0.01, 0.1, FAST)
        world = World(ropes, np.full(4, 0.13), rigid=False)
        cable = np.linspace([0.0, 0.0, height], [0.16, 0.0, height], ropes.segments[0] + 1)
        far = np.linspace([0.0, 2.0, height], [1.5, 2.0, height], ropes.segments[1] + 1)
        world.place([cable, far])
        assert sorted({second for _, second in touching(world)}) == expected
