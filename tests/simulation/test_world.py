"""The world: invalid runs end, contacts have names, wakes keep momentum, clasps have friction."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scripted import world_of

from hitchopt.hitch import Hitch, Team
from hitchopt.simulation.contacts import touching
from hitchopt.simulation.control import (
    BLOCKED,
    POSITION_GAIN,
    SPREADING,
    VELOCITY_GAIN,
    downwash,
)
from hitchopt.simulation.ropes import Ropes, clasped, hanging
from hitchopt.simulation.settings import ACCURATE, FAST, Preset, Settings
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
WEIGHT = 9.81 * 0.1375  # Of a drone and half of its cable [N]


def hung(drones: Array = PLACES, preset: Preset = FAST) -> World:
    """Return two cables that hang between four drones."""
    world = world_of(1.5, 1.5, preset=preset)
    world.place(hanging(world.ropes, drones, 0.0))
    return world


@pytest.mark.slow
def test_ropes_that_become_firmer_do_not_jerk() -> None:
    """What they have yielded under their tension is not to pull at once when steps are refined."""
    world, peaks = hung(preset=ACCURATE), []
    force = np.array([[-0.5, 0.0, WEIGHT], [0.5, 0.0, WEIGHT]] * 2)
    for step in range(720):
        slowed = force - 2.0 * world.data.qvel[world.drone_dofs]
        world.data.xfrc_applied[world.drone_bodies, :3] = slowed
        world.step(10, finer=1 if step < 620 else 2)
        peaks.append(float(np.max(world.tensions)))
    taut = max(peaks[600:620])
    assert taut == pytest.approx(0.5, abs=0.05)
    assert max(peaks[620:]) < 1.5 * taut


@pytest.mark.parametrize(
    ("pull", "shift", "steps", "words", "where"),
    [
        (12.0, 0.0, 2000, "of .* ropes may have passed each other", "cable 1"),  # strain, tension
        (0.0, 0.006, 1, r"penetration of 0\.00", "cables 0 and 1"),
        (1e12, 0.0, 1, r"its state is no longer finite, t = 0\.250 s", "all"),
    ],
)
def test_what_leaves_its_range_ends_the_run_and_writes_nothing(
    place: Path,
    capfd: pytest.CaptureFixture[str],
    pull: float,
    shift: float,
    steps: int,
    words: str,
    where: str,
) -> None:
    world = hung()
    if shift:
        world.place([world.cables[0].copy(), world.cables[0] + [0.0, shift, 0.0]])
    world.data.xfrc_applied[world.drone_bodies, 2] = WEIGHT
    world.data.xfrc_applied[world.drone_bodies[2:], 0] = [-pull, pull]
    with pytest.raises(InvalidRunError, match=words) as caught:  # noqa: PT012
        for _ in range(steps):
            world.step()
            check_valid(world, 0.25)
    assert (caught.value.where, caught.value.time) == (where, 0.25)
    assert list(place.iterdir()) == []
    assert capfd.readouterr() == ("", "")


@pytest.mark.slow
def test_a_rope_picked_up_from_the_ground_is_valid_since_its_lengths_answer_faster() -> None:
    drones, lifted = np.array([[0.0, 0.0, 0.03], [0.6, 0.0, 0.03]]), []
    for loose in (False, True):
        world = world_of(1.2, preset=ACCURATE, friction=0.0)
        world.place(hanging(world.ropes, drones, 0.0))
        step, worst = ACCURATE.time_step, 0.0
        for k in range(int(0.9 / (5 * step))):
            # Drones that are led upward at 1 m/s by a soft position loop.
            away = drones + [0.0, 0.0, 5 * step * k] - world.drones
            rate = [0.0, 0.0, 1.0] - world.data.qvel[world.drone_dofs]
            force = 40.0 * away + 4.0 * rate + [0.0, 0.0, 9.81 * 0.136]
            world.data.xfrc_applied[world.drone_bodies, :3] = force
            world.step(5, loose=loose)
            strains = world.data.flexedge_length / world.model.flexedge_length0 - 1.0
            worst = max(worst, float(np.max(np.abs(strains))))
            assert world.data.time == pytest.approx(5 * step * (k + 1))
        assert np.min(world.nodes[:, 2]) > 0.1  # all of it has left the ground
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
    middle = hung().cables[0]
    through[3] = middle[len(middle) // 2] + [0.0, 0.05, 0.0]  # r1 at the lowest point of cable 0
    through[2] = through[3] + [0.0, 1.0, 0.5]
    assert touching(hung(through)) == [("r1", "cable 0")]


@pytest.mark.parametrize("height", [0.04, 1.0])
def test_a_drone_that_has_landed_may_stand_on_its_own_cable(height: float) -> None:
    """Its two drones are side by side, and the cable between them is folded up."""
    world = world_of(0.5, 1.5)
    count = world.ropes.segments + 1
    folded = np.linspace([0.0, 0.0, height], [0.16, 0.0, height], count[0])
    world.place([folded, np.linspace([0.0, 2.0, height], [1.5, 2.0, height], count[1])])
    found = [one for one, other in touching(world) if other == "cable 0"]
    assert found == (["q0", "r0"] if height == 1.0 else [])


LEG, SIDE, SPEED, FRICTION = 0.4, 0.6, 0.05, 0.3  # Parts of cables [m], and speed [m/s]

# Times at which cables are perpendicular, and tight, when one begins to slide; and times from and
# to which tensions are measured [s]
TURNED, DRAWN, MEASURED, END = 0.9, 1.0, 3.5, 4.0


@pytest.mark.slow
def test_the_accurate_preset_has_a_capstans_friction() -> None:
    """One of two cables that clasp each other at a right angle is drawn through, without gravity.

    Each is in its own plane, the planes perpendicular to each other: the ratio of tensions before
    and after the clasp is ``exp(μ π/2)``. Where both lie in one plane, as in a hitch, each passes
    under the other and over it, and the ratio is larger: 1.21 for 1.17 at μ = 0.1.
    """
    given = {"tension": 0.5, "cable_density": 0.01, "cable_friction": FRICTION}
    team = Team(2, LEG + SIDE, topology="open", **given)  # type: ignore[arg-type]
    hitch = Hitch(team, [[-SIDE, 0.0], [0.0, 0.0], [0.0, -SIDE]], 1.0, [0.0, LEG])
    ropes = Ropes.of(team, Settings(preset=ACCURATE), team.cable_length)
    world = World(ropes, team.mass, 0.0, {})
    world.model.opt.gravity[:] = 0.0
    world.place(clasped(ropes, team.layout, hitch.drones, hitch.vertices))
    loose, clasp = world.drones - hitch.drones, hitch.vertices[1]
    along = np.vstack([0.0 * hitch.drones[:2], hitch.leg_directions[2:]])
    along[3] *= -1.0  # q1 outward, r1 after it
    edges = np.flatnonzero(world.edge_cables == 1)
    pulled, other = edges[2 : len(edges) // 4], edges[int(0.7 * len(edges)) : -2]
    node, sums = 0.01 * ropes.segment_lengths[0], np.zeros(2)
    for time in ACCURATE.time_step * np.arange(round(END / ACCURATE.time_step)):
        slid, drawn = max(time - DRAWN, 0.0), min(1.0, time / DRAWN)
        turn = 0.5 * np.pi * min(time / TURNED, 1.0)  # of cable 0 about the clasp's bisector
        turned = Rotation.from_rotvec(turn * np.array([-1.0, 1.0, 0.0]) / np.sqrt(2.0))
        goal, ahead = hitch.drones + SPEED * slid * along, -hitch.cable_forces
        ahead[:, 2] = 0.0  # no gravity here
        goal[:2], ahead[:2] = clasp + turned.apply(goal[:2] - clasp), turned.apply(ahead[:2])
        error = goal + (1.0 - drawn) * loose - world.drones
        rate = SPEED * along * (slid > 0.0) - world.data.qvel[world.drone_dofs]
        force = team.mass[:, None] * (POSITION_GAIN * error + VELOCITY_GAIN * rate)
        world.data.xfrc_applied[world.drone_bodies, :3] = force + drawn * ahead
        slowing = 40.0 * (1.0 - drawn) * node  # lest cables whip
        world.data.qfrc_applied[world.node_dofs] = -slowing * world.data.qvel[world.node_dofs]
        world.step()
        check_valid(world, time)
        if time >= MEASURED:
            sums += [np.mean(world.tensions[part]) for part in (pulled, other)]
    assert sums[0] / sums[1] == pytest.approx(np.exp(0.5 * np.pi * FRICTION), rel=0.05)
