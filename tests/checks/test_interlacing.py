"""Crossing numbers: right hitches, and every way that swaps and approaches go wrong."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from hitchopt.forming.prehitch import find_prehitch
from hitchopt.forming.swap_settings import SwapSettings
from hitchopt.hitch import Team
from hitchopt.hitch.requirements import Limits
from hitchopt.motion.cable_state import CableState
from hitchopt.motion.motion import concatenated
from hitchopt.planners.stages import (
    reversed_stages,
    straight_lines,
)
from hitchopt.values import Array
from tests.helpers.by_hand import crossings, in_sheets
from tests.helpers.motions import altered, free_motion, random_flight, row, through
from tests.helpers.swaps import POLYGONS, SPEC, stage_of, stages_of, wrong

CLASPING, TIGHTENING, FREE = CableState.CLASPING, CableState.TIGHTENING, CableState.FREE


def points(n: int) -> set[str]:
    return {f"p{k}" for k in range(n)}


@pytest.mark.parametrize("n", POLYGONS)
@pytest.mark.parametrize("sense", [1, -1])
def test_two_swaps_tie_and_their_reverse_unties(n: int, sense: int) -> None:
    _, stages = stages_of(n, sense)
    assert not wrong(*stages)
    assert not wrong(*stages, *reversed_stages(stages))
    # A hitch that was there at first: tied with every q going up first.
    assert wrong(*reversed_stages(stages)) == (set() if sense == 1 else points(n))
    if n in {4, 12}:  # chords are parallel there, of which samples say nothing
        return
    counts = crossings(concatenated(stages[:3]).drones, 2_001)
    neighbours = {(min(k, (k + 1) % n), max(k, (k + 1) % n)) for k in range(n)}
    assert {pair: abs(count) for pair, count in counts.items() if count} == dict.fromkeys(
        neighbours, 1
    )


@pytest.mark.parametrize("n", POLYGONS)
def test_untied_hitches_name_all_vertices(n: int) -> None:
    """Drones turn back in the second swap, swap only once, or never."""
    hitch, stages = stages_of(n)
    back = stage_of(hitch, "swap 2", stages[0].drones.reversed(), CLASPING)
    here = stages[0].drones.coefficients[-1, ..., -1]
    flight = straight_lines(hitch.team, Limits(), here, hitch.drones)
    on = stage_of(hitch, "tighten", flight, TIGHTENING)
    there = stage_of(hitch, "hold", stages[-1].drones, FREE)
    for flown in (
        [stages[0], back, *stages[2:]],
        [stages[0], on, stages[3]],
        [stages[0], stages[3]],
        [there, stages[-1]],
    ):
        assert wrong(*flown) == points(n)


@pytest.mark.parametrize("left_out", [(0,), (2,), (1, 3)])
def test_a_vertex_left_out_is_named(left_out: tuple[int, ...]) -> None:
    """One pair rests while all others swap; then all move to the hitch."""
    _, stages = stages_of(5)
    pairs = [drone for k in left_out for drone in (2 * k, 2 * ((k - 1) % 5) + 1)]
    start = stages[0].drones.coefficients[0, pairs, :, :1]

    def stay(c: Array) -> None:
        c[:, pairs] = start

    stayed = [altered(each, "drones", stay) for each in stages[:2]]
    assert wrong(*stayed, *stages[2:]) == {f"p{k}" for k in left_out}


def test_a_vertex_turned_the_other_way_in_the_second_swap_is_named() -> None:
    hitch, stages = stages_of(5)
    pre, senses = find_prehitch(hitch, SPEC, SwapSettings()), np.ones(5)
    senses[3] = -1.0
    turned = pre.with_senses(senses).ellipses
    first, second, other = (
        stage_of(hitch, "swap", turns.half_turn(Limits(), i, None), CLASPING)
        for turns, i in ((pre.ellipses, 0), (turned, 1), (turned, 0))
    )
    assert wrong(first, second, *stages[2:]) == {"p3"}
    assert not wrong(other, second, *stages[2:])  # mixed senses hold as well


def test_a_tangled_approach_is_named_by_its_pair() -> None:
    """Cable 0 is carried once through the opposite cable 2 of a square."""
    hitch, stages = stages_of(4)
    start = stages[0].drones.coefficients[0, ..., 0]
    places = [start]
    # Down below the chord of cable 2, out beyond it, up and back over it: no drone meets another.
    for offset in ([0, 0, -0.9], [0, -2.2, -0.9], [0, -2.2, 0.9], [0, 0, 0.9], [0, 0, 0]):
        places.append(start.copy())
        places[-1][0] += offset
    approach = stage_of(hitch, "approach", through(np.arange(6.0), places), FREE)
    assert {"cable 0", "cable 2"} <= wrong(approach, *stages)


@pytest.mark.parametrize(
    "seed", [2, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (0, 1))]
)
def test_chord_crossings_match_samples(seed: int) -> None:
    """Chords of free cables, and drones between a chord and its cable, by signs of volumes."""
    team, drones = random_flight(seed, n=5, pieces=2)
    counted = {pair for pair, count in crossings(drones).items() if count}
    expected = set()
    for i, j in counted | in_sheets(drones, team.cable_length):
        clasp = {(0, 4): "p0"}.get((i, j), f"p{j}" if j == i + 1 else "")
        expected |= {clasp} if clasp else {f"cable {i}", f"cable {j}"}
    motion = free_motion(team, drones)
    assert wrong(motion) == expected
    for mirror in ([-1.0, 1.0, 1.0], [1.0, -1.0, 1.0]):
        other = altered(motion, "drones", partial(np.multiply, np.array(mirror)[:, None]))
        assert wrong(other) == expected


SQUARE = [[0, 0, 1], [1, 0, 1], [0, 1, 1], [1, 1, 1.0]]
OVER = np.array([[0, 0, 0.5], [1, 0, 0.5], [0.5, -1, 0], [0.5, 1, 0.0]])
TOUCHING, BELOW = OVER * [1, 1, 0], OVER * [1, 1, -1]
ALONG = np.array([[-1.1, 0, 0], [1.6, 0, 0], [0.4, 0, 0], [1.1, 0, 0]])
INTO = OVER + [[0, 0, 0], [0, 0, 0], [0, 1, 0], [0, 1, 0]]
FLIGHTS: dict[str, tuple[list[Array], bool]] = {
    "opposite sides of a square slide along each other in one plane": (
        [
            np.array(SQUARE),
            np.array(SQUARE) + [[0.7, 0, 0], [0.7, 0, 0], [-0.7, 0, 0], [-0.7, 0, 0]],
        ],
        False,
    ),
    "one line lies in another": ([np.array([*SQUARE[:2], [2, 0, 1], [3, 0, 1.0]])] * 2, False),
    "down onto a chord and back": ([OVER, TOUCHING, TOUCHING, OVER], False),
    "down onto a chord and through": ([OVER, TOUCHING, TOUCHING, BELOW], True),
    "over while they touch": ([OVER, TOUCHING, TOUCHING], True),
    "through, and back": ([OVER, BELOW, OVER], False),
    "into another chord's end": ([INTO, INTO - [[0, 0, 1], [0, 0, 1], [0, 0, 0], [0, 0, 0]]], True),
    "overlapping for good": ([ALONG, ALONG], True),
}
"""Places of two chords one after the other, and whether they have, or may have, crossed."""


@pytest.mark.parametrize("name", FLIGHTS)
def test_two_chords(name: str) -> None:
    places, crossed = FLIGHTS[name]
    spans = np.linalg.norm(np.array(places)[:, 1::2] - np.array(places)[:, 0::2], axis=-1)
    team = Team(2, np.max(spans, axis=0) * (1.0 + 1e-6), topology="open")
    motion = free_motion(team, through(np.arange(float(len(places))), places))
    assert wrong(motion) == ({"p1"} if crossed else set())


@pytest.mark.parametrize(("height", "caught"), [(0.0, True), (-1.5, False), (1.2, False)])
def test_drones_inside_hanging_cables_are_detected(height: float, caught: bool) -> None:
    """A drone passes between chord and cable, far from both; not below or above."""
    start = np.array([[0, 0, 2], [1, 0, 2], [0.5, -1, 1.5], [0.5, -1.5, 1.5]], dtype=np.float64)
    start[2:, 2] += height
    end = start.copy()
    end[2] += [0, 2, 0]  # q1 to the other side; r1 stays
    team = Team(2, [2.4, 4.0], topology="open")
    motion = free_motion(team, through([0.0, 4.0], [start, end]))
    assert not any(crossings(motion.drones).values())
    assert wrong(motion) == ({"p1"} if caught else set())
    if caught:
        assert row(motion, "interlacing").time == pytest.approx(2.0, abs=0.3)


@pytest.mark.slow
@pytest.mark.parametrize("n", POLYGONS)
def test_tightening_beyond_the_hitch_overstretches_cables(n: int) -> None:
    """Cables are overstretched, although no chord is longer than a cable."""
    hitch, stages = stages_of(n)
    assert row(concatenated(stages), "cable_length").holds
    drones = hitch.drones
    farther = np.mean(drones, axis=0) + 1.1 * (drones - np.mean(drones, axis=0))
    out = [
        stage_of(hitch, "tighten", straight_lines(hitch.team, Limits(), first, last), TIGHTENING)
        for first, last in ((drones, farther), (farther, drones))
    ]
    motion = concatenated([*stages[:3], *out, stages[3]])
    assert row(motion, "span").holds
    torn = row(motion, "cable_length")
    assert not torn.holds
    # Farthest out, around the hitch's vertices: two longer legs and the edge between them.
    layout, reach = hitch.team.layout, np.linalg.norm
    legs = reach(farther - hitch.vertices[layout.anchors], axis=1).reshape(-1, 2)
    needed = (np.sum(legs, axis=1) + hitch.polygon.edge_lengths) / hitch.team.cable_length
    assert np.max(needed) > 1.02
    assert torn.worst == pytest.approx(np.max(needed) - 1.0, rel=2e-4)
