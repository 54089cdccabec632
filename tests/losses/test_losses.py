"""After the loss of any robot the others hold an open chain, which they reach clear of all."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.spatial import Delaunay

import hitchopt as ho
from hitchopt.checks.distances import smallest
from hitchopt.drones.quadrotor import GRAVITY
from hitchopt.hitch.losses import Losses, displacements, places_after_loss
from hitchopt.losses.checks import SURVIVABLE, after_losses
from hitchopt.losses.table import after_loss
from hitchopt.values import Array
from tests.helpers.by_hand import catenary
from tests.helpers.survivors import BOUNDS, at_bound, below_a_whole_cable, held

SOFT = ho.Quadrotor(stiffness=4.75)
SURVIVE = ho.Limits(survive="cable")


def places_of(hitch: ho.Hitch) -> Array:
    return places_after_loss(hitch.team, hitch.drones, hitch.vertices, hitch.team.tension)[0]


@pytest.mark.parametrize("robots", [3, 4, 6, 8])
def test_what_remains_is_the_hitch_of_a_chain(robots: int) -> None:
    """All drones but two stand where those of an open chain of the other cables do."""
    polygon = ho.regular_polygon(robots, 1.1).vertices * [1.0, 1.1]
    hitch = ho.Hitch.balanced(ho.Team(robots, 1.9), polygon, 1.5)
    places, losses = places_of(hitch), Losses.of(hitch.team.layout)
    for lost in range(robots):
        rest = (lost + 1 + np.arange(robots - 1)) % robots
        moved = dict(zip(losses.drone.tolist(), places, strict=True))
        drones = hitch.drones.copy()
        ends = 2 * rest[0], 2 * rest[-1] + 1
        drones[list(ends)] = [moved[end] for end in ends]
        inner = hitch.vertices[(rest[1:]) % robots]
        arc = np.concatenate([drones[None, ends[0]], inner, drones[None, ends[1]]])[:, :2]
        legs = np.append(0.0, hitch.legs[rest[1:], 0])
        chain = ho.Hitch(ho.Team(robots - 1, 1.9, topology="open"), arc, 1.5, legs)
        np.testing.assert_allclose(chain.drones.reshape(-1, 2, 3), drones.reshape(-1, 2, 3)[rest])


@pytest.mark.parametrize("seed", range(6))
def test_the_other_clasp_feels_the_same_force(seed: int) -> None:
    """Of a heavy cable with its tension at the clasp, a catenary."""
    rng = np.random.default_rng(seed)
    team = ho.Team(4, 2.3, tension=rng.uniform(0.5, 0.7, 4), cable_density=0.01)
    roll = rng.uniform(-0.3, 0.3, 4)
    hitch = ho.Hitch.balanced(team, ho.regular_polygon(4, 1.2), 1.5, roll)
    losses = Losses.of(team.layout)
    for place, drone, clasp, far in zip(
        places_of(hitch), losses.drone, losses.clasp, losses.far, strict=True
    ):
        tension, weight = team.tension[drone // 2], 0.01 * GRAVITY

        def force(chord: Array, tension: float = tension, weight: float = weight) -> Array:
            """Return the tension where a part leaves the vertex, a vector, and its length."""
            start, _, length = catenary(chord[None], np.array([tension]), np.array([0.5 * weight]))
            return np.append(start[0], length[0])

        before = force(hitch.vertices[clasp] - hitch.vertices[far])
        after = force(place - hitch.vertices[far])
        np.testing.assert_allclose(after[:3], before[:3], atol=1e-5 * tension)
        own_leg = force(hitch.drones[drone] - hitch.vertices[clasp])
        assert after[3] == pytest.approx(before[3] + own_leg[3], abs=1e-6)


def test_no_history_of_tension_displaces_drones_more() -> None:
    """The bang-bang history that swings a drone most nearly reaches the bound."""
    for stiffness, ratio in ((4.75, 0.83), (4.75, 0.2), (2.0, 1.3)):
        damping = 2.0 * ratio * np.sqrt(stiffness * 0.132)
        gains = {"kp": stiffness, "kd": damping}
        drone = ho.Quadrotor(controller="mellinger", gains=gains)
        team = ho.Team(3, 2.4, tension=0.5, quadrotor=drone)
        (bound,) = set(np.round(displacements(team), 9))
        x, v, largest, dt = 0.0, 0.0, 0.0, 2e-4
        for _ in range(100_000):
            push = 0.5 if v >= 0.0 else -0.5
            v += dt * (push - stiffness * x - damping * v) / 0.132
            x += dt * v
            largest = max(largest, abs(x))
        assert 0.985 * bound <= largest <= 1.002 * bound or ratio > 1.0
        assert largest <= 1.002 * bound


@cache
def plan_of(robots: int, length: float, density: float) -> ho.Plan:
    team = ho.Team(robots, length, tension=0.3, cable_density=density, release=True, quadrotor=SOFT)
    corners = ho.regular_polygon(robots, 1.1).vertices
    start = ho.Hitch.balanced(team, corners, 1.6)
    moved = corners + 0.1 * np.eye(robots)[:, :1]
    steps = [ho.Morph(moved), ho.Transport(to=[0.4, 0.2, 1.6], yaw=0.3)]
    return ho.solve(start, steps, limits=SURVIVE)


@pytest.mark.parametrize(("robots", "length", "density"), [(3, 2.4, 0.005), (5, 2.0, 0.0)])
def test_samples_between_intervals_find_no_closer_way(
    robots: int, length: float, density: float
) -> None:
    plan = plan_of(robots, length, density)
    assert plan.certificate["survivable"].worst == 1.0
    (after,) = after_losses(plan.motion)
    motion = plan.motion
    need = motion.requirements.with_reserve.separation
    losses = Losses.of(motion.team.layout)
    for t in np.random.default_rng(3).uniform(0.0, motion.duration, 40):
        drones, vertices = motion.drones.at(t), motion.vertices.at(t)
        places, _ = places_after_loss(motion.team, drones, vertices, motion.team.tension)
        ways = drones[losses.drone] + np.linspace(0, 1, 21)[:, None, None] * (
            places - drones[losses.drone]
        )
        for row, (drone, lost) in enumerate(zip(losses.drone, losses.lost, strict=True)):
            others = [i for i in range(2 * robots) if i != drone and i // 2 != lost]
            gaps = (ways[:, row, None] - drones[others]) * need.scale
            assert np.min(np.linalg.norm(gaps, axis=-1)) >= 1.0
            ends = [i for i in np.flatnonzero(losses.lost == lost) if i != row]
            gaps = (ways[:, None, row] - ways[None, :, ends[0]]) * need.scale
            assert np.min(np.linalg.norm(gaps, axis=-1)) >= 1.0
    longest = np.max(np.linalg.norm(places - drones[losses.drone], axis=1))
    assert np.max(after.ways) >= longest - 1e-9


def test_ends_that_would_meet_are_refused() -> None:
    """Two ends of a regular hexagon move toward one point, as far as its edges are long."""
    for long, holds in ((0.8, False), (0.3, True)):
        legs, others = np.full(6, 0.3), np.full(6, 0.3)
        legs[1] = others[5] = long
        team = ho.Team(6, 1.0 + legs + others, tension=0.3, release=True, quadrotor=SOFT)
        hitch = ho.Hitch(team, ho.regular_polygon(6, 1.0), 1.6, legs)
        motion = ho.solve(hitch, ho.Hold(0.5)).motion
        need = replace(motion.requirements, limits=ho.Limits(survive="cable", tracking=0.01))
        check = SURVIVABLE.check(motion.replaced(requirements=need))
        assert check is not None
        assert check.holds == holds
        if not holds:
            assert check.worst == pytest.approx(5.0 / 6.0)
            assert check.where[0] == "cable 0"


def test_the_certificate_states_what_remains() -> None:
    table = after_loss(plan_of(3, 2.4, 0.005).flight)
    assert [row["robot"] for row in table["robots"]] == ["0", "1", "2"]
    ways = table["robots"][1]["ways"]
    assert set(ways) == {"q2", "r0"}
    assert all(0.5 < way < 1.0 for way in ways.values())
    assert table.keys() == {"robots"}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"release": None}, "set team.release: true"),
        ({"quadrotor": (ho.Quadrotor(),) * 3}, "name team.quadrotor.controller or model"),
        ({"load": np.array([0.0, 0.01, 0.0])}, "omit team.load"),
    ],
)
def test_what_no_loss_leaves_intact_is_refused_by_key(change: dict[str, Any], words: str) -> None:
    team = ho.Team(3, 2.4, tension=0.3, release=True, quadrotor=SOFT)
    start = ho.Hitch.balanced(replace(team, **change), ho.regular_polygon(3, 1.0), 1.5)
    with pytest.raises(ho.InputError, match=rf"^limits\.survive.*{words}"):
        ho.solve(start, ho.Hold(1.0), limits=SURVIVE)


@pytest.mark.parametrize("n", [3, 4, 5])
def test_all_that_may_meet_after_a_loss_is_compared(n: int) -> None:
    """Pairs by counting: 2n drones move, of which two after one loss, in which two drones leave.

    The others' n - 1 cables are those of both, and n - 3 that keep their clasps.
    """
    (after,) = after_losses(plan_of(n, 2.4 if n == 3 else 2.2, 0.002).motion)
    counts = list[tuple[str, int]]()
    for case in after.cases():
        assert case.moving.second is not None
        assert case.moving.allowed is not None
        sizes = case.moving.first.shape[1], case.moving.second.shape[1]
        pairs = np.broadcast_to(case.moving.allowed(*np.indices(sizes)), sizes)
        counts.append((case.check, int(np.sum(pairs))))
    moved, drones, whole = 2 * n, 2 * n, n - 3

    def of(name: str) -> list[int]:
        return [count for check, count in counts if check == name]

    ways = [moved * (drones - 3), moved, moved * 2]  # to those that stay, to each other, below two
    rising = [drones * (drones - 2)]
    assert of("separation") == ways + rising
    foreign = {3: 0, 4: 4, 5: 8}[n]  # of a square, the only loss leaves those of two cables
    assert sorted(of("cable_clearance")) == sorted(
        [
            moved * whole,  # ways and whole cables
            moved,  # loose cables and the other way
            moved * (drones - 4),  # loose cables and drones of other cables
            moved * (drones - 3),  # cables in their last places and all others
            n * foreign,  # drones of other cables than a whole one
            drones * whole,  # drones that rise and whole cables
            moved * 2,  # loose cables and drones that rise
            *(moved, n if whole else 0),  # loose and whole cables and the ground
        ]
    )
    clasped = {3: 1, 4: 0, 5: 0}[n]  # both loose cables of a triangle share a clasp
    both_whole = {3: (0, 0), 4: (0, 0), 5: (0, 5)}[n]  # of a pentagon, two neighbours are whole
    assert of("crossing") == [
        moved * max(whole - 1, 0),
        moved * (1 - clasped),
        both_whole[0],
    ]
    assert of("interlacing") == [
        4 * moved * min(whole, 1),
        16 * moved * clasped,
        both_whole[1],
    ]


@pytest.mark.parametrize("bound", BOUNDS)
@pytest.mark.parametrize("margin", [4e-3, -4e-3])
def test_losses_are_survived_just_within_a_bound(bound: str, margin: float) -> None:
    check = SURVIVABLE.check(at_bound(bound, margin))
    assert check is not None
    assert check.holds == (margin > 0.0), check


def test_drones_that_rise_below_a_cable_touch_it() -> None:
    (after,) = after_losses(below_a_whole_cable())
    cases = [case for case in after.cases() if case.moving.second is not None]
    pairs = [(smallest(case.moving, target=case.limit), case) for case in cases]
    touching = [
        case.moving.pair_names(pair.item) for pair, case in pairs if pair.worst <= 1e-9 * case.limit
    ]
    assert ("q0", "cable 2") in touching


def test_loose_cables_are_below_all_places_of_their_drones() -> None:
    """Seen from above, at any share of the way."""
    motion = held(robots=5, length=2.1)
    (after,) = after_losses(motion)
    outlines = after.loose.corners[0, :, : after.loose.outline, :2, 0]
    for outline, start, place in zip(outlines, after.start[0], after.place[0], strict=True):
        shares = np.linspace(0.001, 0.999, 20)[:, None]
        ways = start[:2, 0] + shares * (place - start)[:2, 0]
        assert np.all(Delaunay(outline).find_simplex(ways, tol=1e-6) >= 0)
