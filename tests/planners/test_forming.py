"""Swaps, pre-hitches, clocks and approaches: geometry by other means, and laws."""

from __future__ import annotations

import math
from itertools import islice, pairwise, permutations, product

import numpy as np
import pytest
from numpy.typing import NDArray

import hitchopt as ho
from hitchopt.checks.bounds.chord_crossings import chord_crossings
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.assignment import Assignment
from hitchopt.hitch.catenary import Catenary
from hitchopt.planners.forming.assigning import assigned
from hitchopt.planners.forming.prehitch import PreHitch, candidates, find_prehitch
from hitchopt.planners.forming.straight import straight
from hitchopt.planners.forming.turns import APART, SwapSettings, Turns, rise_that_clears, swap
from hitchopt.planners.forming.tying_stages import (
    PULL_SECONDS,
    SMOOTH,
    Stage,
    rise_seconds,
    tied,
    undone,
)
from hitchopt.planners.forming.wheels import Wheels, turned
from hitchopt.planners.timing.ramps import fastest_clock
from hitchopt.requirements import Limits, Separation
from hitchopt.trajectory import joined
from problems.random_morph import random_convex_polygon

Array = NDArray[np.float64]

IRREGULAR = np.array([[0, 1.0], [1.1, 0.5], [0.8, -0.6], [-0.4, -0.8], [-0.9, 0.3]]) + [3.0, -2.0]
LENGTHS = np.array([2.2, 2.3, 2.1, 2.4, 2.2])
KINDS = [ho.Quadrotor(0.12 + 0.01 * k, 2.4 + 0.1 * k) for k in range(5)]


def pentagon(shift: int = 0, density: float = 0.0) -> Hitch:
    """Unequal cables, drones and legs, off the origin; renumbered by ``shift``."""
    order = (np.arange(5) + shift) % 5
    team = Team(5, LENGTHS[order], cable_density=density, quadrotor=[KINDS[k] for k in order])
    slack = LENGTHS - ho.ConvexPolygon(IRREGULAR).edge_lengths
    q_legs = slack * np.array([0.5, 0.45, 0.55, 0.5, 0.6])
    return Hitch(team, IRREGULAR[order], 1.7, q_legs[order])


def stages_of(hitch: Hitch, settings: SwapSettings | None = None) -> tuple[PreHitch, list[Stage]]:
    settings = settings or SwapSettings()
    pre = find_prehitch(hitch, Separation(), settings)
    return pre, tied(pre, hitch, Limits(), settings)


def sampled(stage: Stage, order: int = 0, count: int = 1001) -> Array:
    return stage.drones.at(np.linspace(0.0, stage.drones.duration, count), order)


@pytest.mark.parametrize(("goal", "speed"), [(0.004, 1.0), (0.3, 1.0), (2.0, 0.6), (9.0, 3.0)])
def test_the_clock_is_the_fastest_one(goal: float, speed: float) -> None:
    """Against the closed forms of jerk-limited profiles, and its own limits at samples."""
    a, j = 1.7, 11.0
    clock = fastest_clock(goal, speed, a, j)
    t = np.linspace(0.0, clock.duration, 5001)
    rates = [clock.at(t, k) for k in range(4)]
    assert np.all(np.diff(rates[0]) >= -1e-12)
    assert rates[0][[0, -1]] == pytest.approx([0.0, goal], abs=1e-12)
    for rate, limit in zip(rates[1:], (speed, a, j), strict=True):
        assert np.max(np.abs(rate)) <= limit * (1.0 + 1e-9)
    assert np.max(np.abs(np.diff(rates[2]))) <= j * (t[1] - t[0]) * (1.0 + 1e-6)
    if goal <= 2.0 * a**3 / j**2:  # never comes to the largest acceleration
        expected = 4.0 * np.cbrt(goal / (2.0 * j))
    elif goal <= speed * (speed / a + a / j):  # never comes to the largest speed
        expected = a / j + math.sqrt((a / j) ** 2 + 4.0 * goal / a)
    else:
        expected = goal / speed + speed / a + a / j
    assert clock.duration == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("tilt", [0.0, 20.0, 45.0, 70.0])
def test_the_ellipse_clears_the_pair_at_every_angle(tilt: float) -> None:
    """The closed form against all angles; a little less would not do."""
    separation = Separation(radius=0.11, height=0.37)
    a = APART * 0.11
    h = rise_that_clears(separation, math.radians(tilt), 0.0)
    angle = np.linspace(0.0, 2.0 * math.pi, 4001)

    def closest(rise: float) -> float:
        w = np.array([0.0, -math.sin(math.radians(tilt)), math.cos(math.radians(tilt))])
        offset = 2.0 * (
            a * np.cos(angle)[:, None] * [1.0, 0.0, 0.0] + rise * np.sin(angle)[:, None] * w
        )
        return float(np.min(np.linalg.norm(offset * separation.scale, axis=1)))

    assert closest(h) == pytest.approx(APART, rel=1e-6)
    assert closest(0.9 * h) < 0.96 * APART
    assert rise_that_clears(separation, math.radians(tilt), 5.0) == 5.0


@pytest.mark.parametrize("density", [0.0, 0.02])
def test_all_stages_keep_the_limits_and_follow_one_another(density: float) -> None:
    hitch = pentagon(density=density)
    _, stages = stages_of(hitch)
    assert [s.name for s in stages] == ["swap 1", "swap 2", "tighten", "tension"]
    assert [s.pull is not None for s in stages] == [False, False, False, True]
    assert [str(s.state) for s in stages] == ["clasping"] * 2 + ["being tightened", "hitched"]
    for before, after in pairwise(stages):
        np.testing.assert_allclose(sampled(before)[-1], sampled(after)[0], atol=1e-12)
    np.testing.assert_allclose(sampled(stages[-1])[-1], hitch.drones, atol=1e-12)
    for stage in stages:
        for order, limit in ((1, 1.0), (2, 2.0), (3, 20.0)):
            rates = np.linalg.norm(sampled(stage, order), axis=-1)
            assert np.max(rates) <= limit
            if order < 3:
                np.testing.assert_allclose(rates[[0, -1]], 0.0, atol=1e-9)
    fastest = max(np.max(np.linalg.norm(sampled(s, 2), axis=-1)) for s in stages[:2])
    assert fastest > 0.9 * 2.0  # the limit that binds is used
    assert stages[-1].drones.duration == pytest.approx(rise_seconds(hitch.team))


def test_drones_stay_on_their_ellipses_and_change_places_twice() -> None:
    hitch = pentagon()
    pre, stages = stages_of(hitch)
    turns, layout = pre.turns, hitch.team.layout
    for stage in stages[:2]:
        places = sampled(stage)
        q, r = places[:, 2 * layout.ahead], places[:, 2 * layout.behind + 1]
        np.testing.assert_allclose(0.5 * (q + r) - turns.centres, 0.0, atol=1e-9)
        offset = 0.5 * (q - r)
        along = np.sum(offset * turns.along, axis=-1) / turns.half
        upward = np.sum(offset * turns.upward, axis=-1) / turns.rise
        np.testing.assert_allclose(along**2 + upward**2, 1.0, atol=1e-7)
        angle = np.unwrap(np.arctan2(upward, along), axis=0)
        assert np.all(np.diff(angle, axis=0) > -1e-9)  # one sense, all of the way
        np.testing.assert_allclose(angle[-1] - angle[0], math.pi, atol=1e-9)
        np.testing.assert_allclose(q[-1], r[0], atol=1e-9)
        np.testing.assert_allclose(r[-1], q[0], atol=1e-9)
    np.testing.assert_allclose(sampled(stages[1])[-1], pre.drones, atol=1e-9)
    # The axis is normal to the chord, and leans outward and up: the upper drone passes inside.
    np.testing.assert_allclose(np.sum(turns.along * turns.upward, axis=1), 0.0, atol=1e-12)
    inward = turns.centres - np.append(hitch.polygon.centroid, hitch.altitude)
    assert np.all(np.sum(turns.upward * inward, axis=1) < 0.0)


def test_no_span_comes_taut_and_its_measures_are_what_samples_say() -> None:
    hitch = pentagon()
    pre, stages = stages_of(hitch)
    places = np.concatenate([sampled(stage) for stage in stages[:3]])
    pairs = places.reshape(len(places), 5, 2, 3)
    spans = np.linalg.norm(pairs[:, :, 1] - pairs[:, :, 0], axis=-1) / LENGTHS
    assert np.max(spans) == pytest.approx(pre.measures.span, abs=2e-3)
    assert np.max(spans) < 0.971
    swaps = np.concatenate([sampled(stage) for stage in stages[:2]]).reshape(-1, 5, 2, 3)
    lowest = Catenary.between(swaps[:, :, 0], swaps[:, :, 1], LENGTHS).lowest + swaps[:, :, 0, 2]
    assert 1.7 - np.min(lowest) == pytest.approx(pre.measures.lowest, abs=5e-3)


def test_half_way_the_spans_sum_to_legs_and_edges() -> None:
    """With legs of full length: over all cables e + l + d, which is the sum of all cables."""
    hitch = Hitch.balanced(Team(6, 2.0), ho.regular_polygon(6, 1.0).vertices, 1.5)
    pre, _ = stages_of(hitch)
    half = pre.turns.drones(np.array(math.pi))
    spans = np.linalg.norm(half[1::2] - half[0::2], axis=1)
    # On the lines of the edges: their lengths plus the shortened legs at both ends.
    assert spans == pytest.approx(1.0 + pre.share * (2.0 - 1.0), abs=1e-9)


def test_narrow_vertices_are_widened_and_short_cables_get_a_smaller_polygon() -> None:
    sharp = Hitch.balanced(Team(3, 2.4), np.array([[0, -1], [-0.4, 0.5], [0.4, 0.5]]), 1.5)
    pre, _ = stages_of(sharp)
    assert np.min(pre.turns.half) == pytest.approx(0.15)
    chord = np.linalg.norm(sharp.drones[0] - sharp.drones[5])
    assert chord < 0.3  # it stands closer in the hitch
    short = Hitch.balanced(Team(6, 1.4), ho.regular_polygon(6, 1.0).vertices, 1.5)
    pre = find_prehitch(short, Separation(), SwapSettings(radius=0.25))
    assert pre.scale < 1.0
    assert pre.shortfall <= 0.0
    never = find_prehitch(short, Separation(), SwapSettings(radius=0.5))
    assert never.shortfall > 0.0


def clasped(turns: Turns) -> bool:
    """Whether the chords of neighbours pass through each other once on a whole turn, everywhere."""
    met = chord_crossings(joined([swap(turns, Limits(), half, None) for half in (0, 1)]))
    n, layout = turns.team.robots, turns.team.layout
    numbers = np.zeros((n, n), dtype=np.intp)
    numbers[met.first, met.second] += met.count
    numbers += numbers.T
    return bool(np.all(np.abs(numbers[layout.behind, layout.ahead]) == 1))


def test_cables_clasp_where_their_chords_cross_half_way() -> None:
    """Tensions that differ lay some chords of pairs along an edge, and then cables do not clasp."""
    seen = {False: 0, True: 0}
    for seed in range(4):
        rng = np.random.default_rng(seed)
        n = int(rng.integers(5, 8))
        polygon = random_convex_polygon(n, 1.0, rng)
        hitch = Hitch.balanced(Team(n, 1.9, tension=rng.uniform(0.3, 0.5, n)), polygon, 1.5)
        for found in islice(candidates(hitch, Separation(), SwapSettings()), 0, 90, 15):
            linked = found.measures.linked
            if abs(linked) > 5e-3:
                seen[linked > 0.0] += 1
                assert clasped(found.turns) == (linked > 0.0)
    assert min(seen.values()) > 2


@pytest.mark.parametrize(("seed", "n"), [(6, 7), (19, 8)])
def test_cables_clasp_whose_tensions_differ(seed: int, n: int) -> None:
    """They turn legs; pairs stand across their vertices then, and keep apart on their way out."""
    rng = np.random.default_rng(seed)
    polygon = random_convex_polygon(n, 0.9, rng)
    team = Team(n, 1.7, tension=rng.uniform(0.35, 0.5, n))
    y = 1.1 * (np.arange(n) - 0.5 * (n - 1))
    q = np.column_stack([np.full(n, -0.7), y[::-1], np.full(n, 1.5)])
    plan = ho.form(team, q, q * [-1.0, 1.0, 1.0], polygon, altitude=1.5)
    assert plan.certificate.certified


def test_release_is_form_reversed() -> None:
    _, stages = stages_of(pentagon())
    back = undone(stages)
    assert [s.name for s in back] == ["relax", "loosen", "unswap 1", "unswap 2"]
    for there, again in zip(stages, reversed(back), strict=True):
        np.testing.assert_allclose(sampled(there), sampled(again)[::-1], atol=1e-9)
    pull = back[0].pull
    assert pull is not None
    assert pull[0, 0] == 1.0
    assert pull[0, -1] == 0.0


def kept_swing(team: Team, seconds: float, beads: int = 60) -> float:
    """Return the swing of a string of beads over its lift, after a rise along ``SMOOTH``.

    The string is robot 0's cable, its mass and half of the loads at its clasps spread evenly.
    """
    length, tension = team.cable_length[0], team.tension[0]
    mass = team.cable_density * length + 0.5 * (team.load[0] + team.load[1])
    bead, spacing = mass / beads, length / (beads + 1)
    bends = 2.0 * np.eye(beads) - np.eye(beads, k=1) - np.eye(beads, k=-1)
    squares, modes = np.linalg.eigh(tension / spacing / bead * bends)
    s, weights = np.polynomial.legendre.leggauss(200)
    s, weights = 0.5 * (s + 1.0), 0.5 * weights
    rate = sum(
        7.0 * (SMOOTH[i + 1] - SMOOTH[i]) * math.comb(6, i) * s**i * (1.0 - s) ** (6 - i)
        for i in range(7)
    )
    turned = np.exp(1j * np.sqrt(squares)[:, None] * seconds * s)
    left = np.abs(turned @ (weights * rate)) * (modes.T @ np.ones(beads)) / squares
    lift = modes @ (modes.T @ np.ones(beads) / squares)
    return float(np.max(np.abs(modes) @ np.abs(left)) / np.max(lift))


@pytest.mark.parametrize(
    "team",
    [
        Team(4, 2.2, tension=0.5, cable_density=0.01),
        Team(4, 2.9, tension=0.4, cable_density=0.003, load=[0.02, 0.01, 0.0, 0.0]),
        Team(4, 2.4, tension=0.7, load=0.03),
    ],
)
def test_tensions_rise_so_slowly_that_cables_hang_still(team: Team) -> None:
    """Against the modes of a string of beads: a rise of half the time leaves a tenth or more."""
    seconds = rise_seconds(team)
    assert seconds > PULL_SECONDS
    assert kept_swing(team, seconds) < 0.03
    assert kept_swing(team, 0.5 * seconds) > 0.1


def test_the_slowest_cable_sets_the_rise_and_none_has_the_shortest() -> None:
    """A quarter of the tension or four times the mass double it; a chain's ends have one clasp."""
    plain = Team(3, [2.0, 2.6, 2.2], tension=[0.4, 0.5, 0.6], cable_density=0.01)
    assert rise_seconds(plain) == pytest.approx(6.0 * 2.6 * math.sqrt(0.01 / 0.5))
    weak = Team(3, plain.cable_length, tension=0.25 * plain.tension, cable_density=0.01)
    assert rise_seconds(weak) == pytest.approx(2.0 * rise_seconds(plain))
    assert rise_seconds(Team(3, 2.4, tension=0.5)) == PULL_SECONDS
    chain = Team(3, 2.5, topology="open", tension=0.5, load=[0.03, 0.0])
    assert rise_seconds(chain) == pytest.approx(6.0 * math.sqrt(2.5 * 0.015 / 0.5))
    middle = Team(3, 2.5, topology="open", tension=0.5, load=[0.03, 0.01])
    assert rise_seconds(middle) == pytest.approx(6.0 * math.sqrt(2.5 * 0.02 / 0.5))


@pytest.mark.parametrize("shift", [1, 3])
def test_renumbering_robots_renumbers_the_plan(shift: int) -> None:
    _, stages = stages_of(pentagon())
    _, others = stages_of(pentagon(shift))
    for one, other in zip(stages, others, strict=True):
        assert other.drones.duration == pytest.approx(one.drones.duration, rel=1e-9)
        rolled = np.roll(sampled(one).reshape(-1, 5, 2, 3), -shift, axis=1)
        np.testing.assert_allclose(sampled(other).reshape(-1, 5, 2, 3), rolled, atol=1e-7)


def test_moving_and_turning_the_hitch_moves_and_turns_the_plan() -> None:
    hitch = pentagon()
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    moved = Hitch(hitch.team, hitch.polygon.vertices @ turn.T + [2.0, 5.0], 2.7, hitch.q_legs)
    _, stages = stages_of(hitch)
    _, others = stages_of(moved)
    for one, other in zip(stages, others, strict=True):
        expected = sampled(one)
        expected[..., :2] = expected[..., :2] @ turn.T + [2.0, 5.0]
        expected[..., 2] += 1.0
        np.testing.assert_allclose(sampled(other), expected, atol=1e-7)


def test_mirror_images_turn_the_other_way_with_the_same_clearances() -> None:
    """Mirrored, every robot's q and r change places; what went up first then goes down."""
    hitch = pentagon()
    mirrored = hitch.polygon.mirrored()
    # Edge k of the mirror image is edge n-2-k (cyclic), run through the other way.
    order = (3 - np.arange(5)) % 5
    team = Team(5, LENGTHS[order], quadrotor=[KINDS[k] for k in order])
    image = Hitch(team, mirrored, 1.7, hitch.legs[order, 1])
    up, stages = stages_of(hitch, SwapSettings(sense=1))
    down, others = stages_of(image, SwapSettings(sense=-1))
    assert down.share == up.share
    assert np.sort(down.measures.clearances) == pytest.approx(
        np.sort(up.measures.clearances), abs=1e-9
    )
    for one, other in zip(stages, others, strict=True):
        expected = sampled(one).reshape(-1, 5, 2, 3)[:, order][:, :, ::-1] * [-1.0, 1.0, 1.0]
        np.testing.assert_allclose(sampled(other).reshape(-1, 5, 2, 3), expected, atol=1e-7)


@pytest.mark.parametrize("n", [7, 12, 40])
def test_the_time_from_the_pre_hitch_does_not_depend_on_how_many_there_are(n: int) -> None:
    """Same edge, cable, legs and ellipse: within 1 %, as the paper claims."""
    settings = SwapSettings(radius=0.28, tilt=math.radians(45.0))

    def total(robots: int) -> float:
        hitch = Hitch.balanced(Team(robots, 2.2), ho.regular_polygon(robots, 1.3).vertices, 1.5)
        pre, stages = stages_of(hitch, settings)
        assert pre.turns.half == pytest.approx(0.28)
        return sum(stage.drones.duration for stage in stages)

    assert total(n) == pytest.approx(total(6), rel=1e-2)


def test_slower_swaps_take_as_long_as_is_said() -> None:
    pre, _ = stages_of(pentagon())
    assert swap(pre.turns, Limits(), 0, 4.0).duration == pytest.approx(4.0, rel=1e-12)
    fast = swap(pre.turns, Limits(), 0, None)
    assert swap(pre.turns, Limits(), 0, 0.01).duration == fast.duration


def test_heavy_cables_leave_less_to_accelerate_with() -> None:
    """A drone of little thrust that carries half a heavy cable: slower, or none at all."""
    weak = [ho.Quadrotor(0.12, 1.45)] * 5
    light, heavy = (
        Team(5, LENGTHS, cable_density=density, quadrotor=weak) for density in (0.0, 0.01)
    )
    start = pentagon().drones
    end = start + [0.0, 1.5, 0.0]
    quick = straight(light, Limits(), start, end)
    slow = straight(heavy, Limits(), start, end)
    assert slow.duration > 1.05 * quick.duration
    with pytest.raises(ho.InfeasibleError, match=r"^thrust: .* hovering with a hanging cable"):
        straight(Team(5, LENGTHS, cable_density=0.05, quadrotor=weak), Limits(), start, end)


def test_straight_ways_stay_between_their_ends_to_the_last_bit() -> None:
    start = pentagon().drones
    down = start * [1.0, 1.0, 0.0]
    flight = straight(pentagon().team, Limits(), start, down)
    assert np.min(flight.coefficients[:, :, 2]) == 0.0
    assert np.max(flight.coefficients[:, :, 2]) == np.max(start[:, 2])
    still = straight(pentagon().team, Limits(), start, start)
    assert still.duration < 0.1


def test_wheels_turn_the_shorter_way_on_circles() -> None:
    rng = np.random.default_rng(5)
    start, goal = rng.uniform(-2.0, 2.0, (2, 10, 3))
    wheels = Wheels.between(start, goal, 0.2)
    assert np.all(np.abs(wheels.angles) <= math.pi)
    flight = turned(pentagon().team, wheels, Limits())
    places = flight.at(np.linspace(0.0, flight.duration, 501)).reshape(-1, 5, 2, 3)
    arms = 0.5 * (places[:, :, 1] - places[:, :, 0])
    np.testing.assert_allclose(np.linalg.norm(arms, axis=-1), 0.2, atol=1e-8)
    np.testing.assert_allclose(places.mean(axis=2) - wheels.centres, 0.0, atol=1e-9)
    headings = np.unwrap(np.arctan2(arms[..., 1], arms[..., 0]), axis=0)
    np.testing.assert_allclose(headings[-1] - headings[0], wheels.angles, atol=1e-9)
    last = goal.reshape(5, 2, 3)
    directions = last[:, 1, :2] - last[:, 0, :2]
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    np.testing.assert_allclose(arms[-1, :, :2] / 0.2, directions, atol=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_the_assignment_is_the_best_of_all(seed: int) -> None:
    """Against all permutations and orientations of four robots."""
    rng = np.random.default_rng(seed)
    team = Team(4, 2.0)
    outline = ho.ConvexPolygon(np.array([[-0.5, 0.5], [0.6, 0.5], [0.5, -0.5], [-0.5, -0.4]]))
    drones = rng.uniform(-2.0, 2.0, (8, 3))
    found = assigned(team, drones, outline, 0.15)
    ends = np.stack([outline.vertices, np.roll(outline.vertices, -1, axis=0)], axis=1)

    def cost(robots: tuple[int, ...], flipped: tuple[bool, ...]) -> float:
        places = Assignment(robots, flipped).drones(drones).reshape(4, 2, 3)[..., :2]
        return float(np.sum((places - ends) ** 2))

    best = min(
        cost(robots, flipped)
        for robots in permutations(range(4))
        for flipped in product((False, True), repeat=4)
    )
    assert cost(found.robots, found.flipped) == pytest.approx(best, rel=1e-12)


def test_long_edges_go_to_long_cables() -> None:
    team = Team(3, [1.5, 2.6, 2.6])
    outline = ho.ConvexPolygon(np.array([[0.0, 1.8], [0.4, 0.0], [-0.4, 0.0]]))
    drones = np.zeros((6, 3))
    drones[:, 0] = np.arange(6)
    found = assigned(team, drones, outline, 0.15)
    assert found.team(team).cable_length[1] == 1.5  # the only edge that it can hold
    assert sorted(found.robots) == [0, 1, 2]


def test_assignments_are_checked() -> None:
    with pytest.raises(ho.InputError, match=r"assignment\.robots = \(0, 0\): must be 0 to 1"):
        Assignment((0, 0), (False, False))
    with pytest.raises(ho.InputError, match=r"assignment\.flipped"):
        Assignment((0, 1), (False,))


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"radius": 0.0}, r"radius = 0\.0: must be greater than 0"),
        ({"seconds": -1.0}, r"seconds = -1\.0: must be greater than 0"),
        ({"tilt": math.radians(95)}, r"tilt = 1\.65\d*: must be below π/2 rad"),
        ({"sense": 2}, r"sense = 2: must be 1, -1 or 0"),
    ],
)
def test_settings_are_checked(keys: dict[str, float], message: str) -> None:
    with pytest.raises(ho.InputError, match=message):
        SwapSettings(**keys)  # type: ignore[arg-type]


def test_ellipses_are_turned_by_derivatives_that_finite_differences_confirm() -> None:
    pre, _ = stages_of(pentagon())
    turns: Turns = pre.turns
    angle, step = np.array([0.7, 2.9, 4.4]), 1e-5
    for order in range(3):
        slope = (turns.drones(angle + step, order) - turns.drones(angle - step, order)) / (2 * step)
        np.testing.assert_allclose(turns.drones(angle, order + 1), slope, atol=1e-9)


def test_drones_that_pass_each_other_on_their_way_out_go_one_after_the_other() -> None:
    """Legs that are long for their edge: q and r of a cable end on the other's side."""
    polygon = np.array(
        [[1.53, -0.14], [-0.74, -0.79], [-0.99, 0.07], [-0.77, 0.85]]
        + [[-0.15, 1.4], [1.08, 1.17], [1.46, 0.59]]
    )
    team = Team(7, [3.25, 2.08, 1.83, 1.91, 2.15, 1.88, 1.99])
    hitch = Hitch(team, polygon, 1.5, [0.45, 0.59, 0.24, 0.42, 0.45, 0.73, 0.63])
    pre, stages = stages_of(hitch)
    at_once = straight(team, Limits(), pre.drones, hitch.drones)
    scale = Separation().scale

    def closest(places: Array) -> float:
        pairs = places.reshape(len(places), 7, 2, 3)
        return float(np.min(np.linalg.norm((pairs[:, :, 1] - pairs[:, :, 0]) * scale, axis=-1)))

    assert closest(at_once.at(np.linspace(0.0, at_once.duration, 401))) < 1.0
    ways = [stage for stage in stages if stage.name == "tighten"]
    assert len(ways) == 2
    assert min(closest(sampled(way)) for way in ways) >= 1.0
    first = np.any(sampled(ways[0])[-1] != sampled(ways[0])[0], axis=-1).reshape(7, 2)
    assert np.all(np.sum(first, axis=1) == 1)  # one of every cable
    np.testing.assert_allclose(sampled(ways[1])[-1], hitch.drones, atol=1e-12)
    assert [s.name for s in undone(stages)][1:3] == ["loosen", "loosen"]
