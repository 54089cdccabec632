"""Crossing numbers: right hitches, and every way that swaps and approaches go wrong."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from free_cases import free_motion, random_flight, through

import hitchopt as ho
from hitchopt.checks.story import INTERLACING, chord_crossings, entered
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.requirements import Limits, Requirements, Separation
from hitchopt.motion.motion import CableState, Motion, joined_motions
from hitchopt.planners.forming import SwapSettings
from hitchopt.planners.forming.prehitch import find_prehitch
from hitchopt.planners.forming.stages import stage, straight, swap, tied, undone
from hitchopt.trajectory import PiecewisePolynomial

KEPT = Requirements(Limits(), Separation(), None)
POLYGONS = {
    3: (2.4, [[0.1, 0.6], [0.5, -0.3], [-0.55, -0.25]]),
    4: (2.0, [[-0.5, 0.5], [0.5, 0.5], [0.5, -0.5], [-0.5, -0.5]]),
    5: (2.2, [[0, 1.0], [1.1, 0.5], [0.8, -0.6], [-0.4, -0.8], [-0.9, 0.3]]),
    12: (2.3, ho.regular_polygon(12, 1.3, angle=0.1).vertices),
    30: (2.3, ho.regular_polygon(30, 1.3, angle=0.1).vertices),
}
FEW = [3, 4, 5, 12]


def hitch_of(n: int) -> Hitch:
    length, polygon = POLYGONS[n]
    return Hitch.balanced(Team(n, length), np.array(polygon) + [4.0, -3.0], 1.8)


def stages_of(n: int, settings: SwapSettings | None = None) -> tuple[Hitch, list[Motion]]:
    hitch = hitch_of(n)
    settings = settings or SwapSettings()
    pre = find_prehitch(hitch, Separation(), settings)
    return hitch, tied(pre, hitch, KEPT, settings)


def stage_of(hitch: Hitch, name: str, drones: PiecewisePolynomial, state: CableState) -> Motion:
    """A stage whose vertices are the hitch's."""
    vertices = PiecewisePolynomial.constant(drones.breaks, hitch.vertices)
    return stage(name, drones, hitch.team, KEPT, 0, state, vertices=vertices)


def counts(drones: PiecewisePolynomial) -> dict[tuple[int, int], int]:
    """Pairs that crossed, with their numbers."""
    met = chord_crossings(drones)
    pairs = zip(met.first.tolist(), met.second.tolist(), strict=True)
    return {pair: count for pair, count in zip(pairs, met.count.tolist(), strict=True) if count}


def wrong(motion: Motion) -> set[str]:
    found = INTERLACING.check(motion)
    assert found is not None
    assert (found.worst == 0.0) is found.holds is (not found.where)
    return {name for name in found.where if not name.startswith("phase ")}


@pytest.mark.parametrize("n", FEW)
@pytest.mark.parametrize("sense", [1, -1])
def test_two_swaps_hold_and_their_way_back_lets_go(n: int, sense: int) -> None:
    _, stages = stages_of(n, SwapSettings(sense=sense))
    assert not wrong(joined_motions(stages))
    assert not wrong(joined_motions([*stages, *undone(stages)]))
    # A hitch that was there at first: tied with every q going up first.
    everywhere = {f"p{k}" for k in range(n)}
    assert wrong(joined_motions(undone(stages))) == (set() if sense == 1 else everywhere)
    met = chord_crossings(joined_motions(stages[:3]).drones)
    assert np.all(np.abs(met.count) == 1)
    assert np.all(met.certain)
    assert len(met.count) == n
    pairs = set(zip(met.first.tolist(), met.second.tolist(), strict=True))
    assert pairs == {(min(k, (k + 1) % n), max(k, (k + 1) % n)) for k in range(n)}


@pytest.mark.parametrize("n", FEW)
def test_a_hitch_that_swaps_did_not_tie_is_named_everywhere(n: int) -> None:
    """Drones turn back in the second swap, swap only once, or never."""
    hitch, stages = stages_of(n)
    back = stage_of(hitch, "swap 2", stages[0].drones.reversed(), CableState.CLASPING)
    here = stages[0].drones.coefficients[-1, ..., -1]
    flight = straight(hitch.team, Limits(), here, hitch.drones)
    on = stage_of(hitch, "tighten", flight, CableState.TIGHTENING)
    there = stage_of(hitch, "hold", stages[-1].drones, CableState.FREE)
    for flown in (
        [stages[0], back, *stages[2:]],
        [stages[0], on, stages[3]],
        [stages[0], stages[3]],
        [there, stages[-1]],
    ):
        assert wrong(joined_motions(flown)) == {f"p{k}" for k in range(n)}


@pytest.mark.parametrize("left_out", [(0,), (2,), (1, 3)])
def test_a_vertex_left_out_is_named(left_out: tuple[int, ...]) -> None:
    """The pair there stays where it is while all others swap; then all go to the hitch."""
    hitch, stages = stages_of(5)
    changed = []
    for swapped in stages[:2]:
        c = swapped.drones.coefficients.copy()
        for k in left_out:
            for drone in (2 * k, 2 * ((k - 1) % 5) + 1):
                c[:, drone] = stages[0].drones.coefficients[0, drone, :, :1]
        drones = PiecewisePolynomial(swapped.drones.breaks, c)
        (phase,) = swapped.phases
        changed.append(stage_of(hitch, phase.name, drones, phase.state))
    found = wrong(joined_motions([*changed, *stages[2:]]))
    assert found == {f"p{k}" for k in left_out}


def test_a_vertex_turned_the_other_way_in_the_second_swap_is_named() -> None:
    hitch = hitch_of(5)
    pre = find_prehitch(hitch, Separation(), SwapSettings())
    senses = np.ones(5)
    senses[3] = -1.0
    first = stage_of(hitch, "swap 1", swap(pre.turns, Limits(), 0, None), CableState.CLASPING)
    turned = pre.turns.with_senses(senses)
    second = stage_of(hitch, "swap 2", swap(turned, Limits(), 1, None), CableState.CLASPING)
    rest = tied(pre, hitch, KEPT, SwapSettings())[2:]
    assert wrong(joined_motions([first, second, *rest])) == {"p3"}
    both = [
        stage_of(hitch, f"swap {i + 1}", swap(turned, Limits(), i, None), CableState.CLASPING)
        for i in (0, 1)
    ]
    assert not wrong(joined_motions([*both, *rest]))  # mixed senses hold as well


def test_a_tangled_approach_is_named_by_its_pair() -> None:
    """Cable 0 is carried once around through cable 2 of a square: opposite ones, no clasp."""
    hitch, stages = stages_of(4)
    start = stages[0].drones.coefficients[0, ..., 0]
    places = [start]
    # Down below the chord of cable 2, out beyond it, up and back over it: no drone meets another.
    for offset in ([0, 0, -0.9], [0, -2.2, -0.9], [0, -2.2, 0.9], [0, 0, 0.9], [0, 0, 0]):
        place = start.copy()
        place[0] += offset
        places.append(place)
    way = through(np.arange(6.0), np.array(places))
    approach = stage_of(hitch, "approach", way, CableState.FREE)
    motion = joined_motions([approach, *stages])
    assert {"cable 0", "cable 2"} <= wrong(motion)


@pytest.mark.parametrize("seed", range(6))
def test_counts_against_samples_of_the_volume(seed: int) -> None:
    """Signs of the volume at samples, wherever chords are close and cross from some side."""
    _, drones = random_flight(seed, n=5, pieces=2)
    assert np.all(chord_crossings(drones).certain)
    counted = counts(drones)
    t = np.linspace(0.0, drones.duration, 40001)
    ends = drones.at(t).reshape(len(t), 5, 2, 3)
    for i in range(5):
        for j in range(i + 1, 5):
            qi, ri, qj, rj = ends[:, i, 0], ends[:, i, 1], ends[:, j, 0], ends[:, j, 1]
            normal = np.cross(ri - qi, rj - qj)
            volume = np.sum((qj - qi) * normal, axis=1)
            change = np.flatnonzero(np.sign(volume[1:]) != np.sign(volume[:-1]))
            total = 0
            for m in change:
                # Where the lines meet: shares of both chords.
                matrix = np.column_stack([ri[m] - qi[m], -(rj[m] - qj[m])])
                shares, *_ = np.linalg.lstsq(matrix, qj[m] - qi[m], rcond=None)
                if np.all((shares > 0.0) & (shares < 1.0)):
                    total += int(np.sign(volume[m + 1]))
            assert counted.get((i, j), 0) == total


@pytest.mark.parametrize("seed", range(3))
def test_laws_of_counting(seed: int) -> None:
    _, drones = random_flight(seed, n=5)
    found = counts(drones)

    def again(c: np.ndarray, sign: int = 1) -> None:
        other = counts(PiecewisePolynomial(drones.breaks, c))
        assert {pair: sign * count for pair, count in other.items()} == found

    c = drones.coefficients
    turn = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    again(np.einsum("ij,pdjk->pdik", turn, c) + np.array([7.0, -2.0, 3.0])[:, None])
    again(c * np.array([-1.0, 1.0, 1.0])[:, None], -1)  # a mirror turns all crossings around
    swapped = c.reshape(len(c), 5, 2, 3, -1)[:, :, ::-1].reshape(c.shape)
    again(swapped)  # q and r exchanged everywhere: both chords turned round
    backward = counts(drones.reversed())
    assert {pair: -count for pair, count in backward.items()} == found


def test_parallel_and_coplanar_chords_do_not_cross() -> None:
    """Opposite sides of a square slide along each other in one plane; one line lies in another."""
    start = np.array([[0, 0, 1], [1, 0, 1], [0, 1, 1], [1, 1, 1], [2, 0, 1], [3, 0, 1.0]])
    end = start + np.array(
        [[0.7, 0, 0], [0.7, 0, 0], [-0.7, 0, 0], [-0.7, 0, 0], [0, 0, 0], [0, 0, 0]]
    )
    met = chord_crossings(through(np.array([0.0, 1.0]), np.array([start, end])))
    assert not np.any(met.count)
    assert np.all(met.certain)


def test_chords_that_touch_and_turn_back_at_the_moment_of_touching() -> None:
    """Down onto the other chord to the last bit, a rest there, then back or through."""
    start = np.array([[0, 0, 0.5], [1, 0, 0.5], [0.5, -1, 0], [0.5, 1, 0.0]])
    touching = start * [1, 1, 0]
    below = start - [[0, 0, 1], [0, 0, 1], [0, 0, 0], [0, 0, 0]]
    for last, count in ((start, 0), (below, 1)):
        places = np.array([start, touching, touching, last])
        met = chord_crossings(through(np.array([0.0, 1.0, 2.0, 3.0]), places))
        assert np.all(met.certain)
        assert np.sum(np.abs(met.count)) == count
    met = chord_crossings(through(np.array([0.0, 1.0, 2.0]), np.array([start, touching, touching])))
    assert not np.any(met.certain)  # over while they touch: nobody knows


def test_a_chord_that_runs_into_anothers_end_is_not_told() -> None:
    start = np.array([[0, 0, 0.5], [1, 0, 0.5], [0.5, 0, 0], [0.5, 2, 0.0]])
    below = start - [[0, 0, 1], [0, 0, 1], [0, 0, 0], [0, 0, 0]]
    met = chord_crossings(through(np.array([0.0, 1.0]), np.array([start, below])))
    assert not np.any(met.certain)


def test_a_drone_that_dives_through_a_hanging_cable_is_caught() -> None:
    """Between chord and cable from one side to the other, far from both: only the sheet is met."""
    team = Team(2, [2.4, 0.8], topology="open")
    start = np.array([[0, 0, 2], [1, 0, 2], [0.5, -1, 1.5], [0.5, -1.5, 1.5]], dtype=np.float64)
    end = start.copy()
    end[2] += [0, 2, 0]  # q1 to the other side; r1 stays
    motion = free_motion(team, through(np.array([0.0, 4.0]), np.array([start, end])))
    motion = replace(motion, team=Team(2, [2.4, 4.0], topology="open"))
    met = chord_crossings(motion.drones)
    assert not np.any(met.count)
    drone, cable, time = entered(motion)
    assert (drone.tolist(), cable.tolist()) == ([2], [0])
    assert time == pytest.approx([2.0], abs=0.3)
    assert wrong(motion) == {"p1"}
    # Below the cable, or over the chord, nothing is caught.
    for height in (-1.5, 1.2):
        around = start.copy(), end.copy()
        for places in around:
            places[2:, 2] += height
        other = replace(motion, drones=through(np.array([0.0, 4.0]), np.array(around)))
        assert len(entered(other)[0]) == 0


@pytest.mark.parametrize("degree", [0, 3])
def test_chords_that_overlap_for_good_are_uncertain_at_once(degree: int) -> None:
    """Halved down to the last cell they would come to 2**30 of them."""
    on_one_line = np.array([[-1.1, 0, 0], [1.6, 0, 0], [0.4, 0, 0], [1.1, 0, 0]])
    met = chord_crossings(PiecewisePolynomial.constant([0.0, 1.0], on_one_line, degree))
    assert list(met.certain) == [False]


@pytest.mark.slow
@pytest.mark.parametrize("n", FEW)
def test_tightening_beyond_the_hitch_tears_cables(n: int) -> None:
    """They are drawn out farther than they reach, though no chord is longer than one."""
    hitch, stages = stages_of(n)
    right = ho.certify(joined_motions(stages))["cable_length"]
    assert right.holds
    drones = hitch.drones
    farther = np.mean(drones, axis=0) + 1.1 * (drones - np.mean(drones, axis=0))
    out = [
        stage_of(
            hitch, "tighten", straight(hitch.team, Limits(), first, last), CableState.TIGHTENING
        )
        for first, last in ((drones, farther), (farther, drones))
    ]
    torn = ho.certify(joined_motions([*stages[:3], *out, stages[3]]))
    assert torn["span"].holds
    assert not torn["cable_length"].holds
    # Farthest out, around the hitch's vertices: two longer legs and the edge between them.
    layout, reach = hitch.team.layout, np.linalg.norm
    legs = reach(farther - hitch.vertices[layout.anchors], axis=1).reshape(-1, 2)
    edges = reach(hitch.vertices[layout.ends] - hitch.vertices[layout.starts], axis=1)
    needed = np.max((np.sum(legs, axis=1) + edges) / hitch.team.cable_length)
    assert needed > 1.02
    assert torn["cable_length"].worst == pytest.approx(needed - 1.0, rel=2e-4)
