"""Distances to hanging cables, spans and pulls: bounds that no sample beats, and that are close."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from certificate_cases import applied
from certificate_sampling import cable_points
from free_cases import free_motion, random_flight, through

from hitchopt.checks import certify
from hitchopt.checks.clearance import CABLE_CLEARANCE, chains, cut
from hitchopt.checks.distances import CROSSING
from hitchopt.checks.drones import Drones
from hitchopt.geometry import shortest_offset
from hitchopt.geometry.vectors import differences
from hitchopt.hitch import Team
from hitchopt.motion.motion import CableState
from hitchopt.motion.states import states_at
from hitchopt.trajectory import PiecewisePolynomial, bernstein


def test_cables_on_the_ground_are_looked_at_from_above() -> None:
    """They lie between their drones: a drone right above one is at distance zero."""
    team, drones = random_flight(3)
    motion = free_motion(team, drones, CableState.GROUND)
    t = np.linspace(0.0, motion.duration, 1501)
    places = drones.at(t)[..., :2]
    ends = places.reshape(len(t), 4, 2, 2)
    gaps = []
    for k in range(4):
        others = np.delete(places, [2 * k, 2 * k + 1], axis=1)
        segment = np.broadcast_to(ends[:, k][:, None], (len(t), 6, 2, 2))
        gaps.append(
            np.linalg.norm(shortest_offset(differences(others[:, :, None], segment)), axis=-1)
        )
    found = applied(CABLE_CLEARANCE, motion)
    smallest = float(np.min(gaps))
    assert found.bound <= smallest + 1e-9
    assert found.worst == pytest.approx(smallest, abs=2e-3)


@pytest.mark.parametrize("seed", range(2))
def test_clasped_neighbours_may_cross(seed: int) -> None:
    team, drones = random_flight(seed)
    motion = free_motion(team, drones, CableState.CLASPING)
    flat = drones.at(np.linspace(0.0, motion.duration, 2001))[..., :2].reshape(-1, 4, 2, 2)
    i, j = np.array([0, 1]), np.array([2, 3])  # opposite ones
    gaps = np.linalg.norm(shortest_offset(differences(flat[:, i], flat[:, j])), axis=-1)
    found = applied(CROSSING, motion).worst
    assert np.min(gaps) - 2e-3 <= found <= np.min(gaps) + 1e-9


def test_before_it_is_halved_an_enclosure_of_thrusts_holds_as_well() -> None:
    """The radius is needed: the pull of a cable that moves is no polynomial."""
    team, drones = random_flight(1)
    motion = free_motion(Team(4, team.cable_length, cable_density=0.03), drones)
    (spans,) = Drones.of(motion)
    found = spans.thrust
    off = []
    for x in np.linspace(0.0, 1.0, 21)[1:-1]:
        t = motion.drones.breaks[:-1] + x * motion.drones.durations
        middle = bernstein.evaluate(found.c, np.full((len(spans), 1), x))
        thrusts = states_at(motion, t).thrusts(motion.team).reshape(-1, 3)
        off.append(np.linalg.norm(middle - thrusts, axis=-1))
    assert np.all(np.max(off, axis=0) <= found.r)
    assert np.max(off) > 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("told", [-0.3, 5.0])
def test_no_leg_pulls_where_there_is_none(told: float) -> None:
    """Whatever a plan says that cables are under while they hang free."""
    motion = free_motion(*random_flight(0))
    true = certify(motion)
    constant, breaks = PiecewisePolynomial.constant, motion.drones.breaks
    for said in (
        replace(motion, tensions=constant(breaks, np.full(4, told))),
        replace(motion, leg_tensions=constant(breaks, np.full((4, 2), told))),
    ):
        found = certify(said)
        for name in ("thrust", "tilt"):
            assert found[name].worst == true[name].worst


@pytest.mark.parametrize("seed", range(2))
def test_cables_stay_as_near_to_their_chains_as_is_said(seed: int) -> None:
    team, drones = random_flight(seed)
    c = cut(drones).coefficients
    q, r = c[:, 0::2].reshape(-1, 3, 6), c[:, 1::2].reshape(-1, 3, 6)
    places, off = chains(q, r, np.tile(team.cable_length, len(c)))
    for x in (0.0, 0.2, 0.5, 0.9, 1.0):
        motionless = PiecewisePolynomial(np.array([0.0, 1.0]), c.reshape(-1, 3, 6)[None]).at(
            np.array(x)
        )
        one = Team(len(q), np.tile(team.cable_length, len(c)), topology="open")
        points = cable_points(one.cable_length, motionless)
        links = PiecewisePolynomial(np.array([0.0, 1.0]), places[None]).at(np.array(x))
        for k in range(0, len(q), 5):
            gaps = np.stack([links[k, :-1], links[k, 1:]], axis=1)[None] - points[k][:, None, None]
            to_links = np.linalg.norm(shortest_offset(gaps), axis=-1) - off[k]
            assert np.max(np.min(to_links, axis=1)) <= 1e-9


def test_a_drone_in_a_cable_is_told_with_time_and_names() -> None:
    """q1 goes straight through the lowest point of cable 0, which hangs still."""
    team = Team(2, [1.5, 0.8], topology="open")
    hung = np.array([[0, 0, 2], [1, 0, 2], [9, 9, 9], [9, 9.5, 9]])
    low = float(np.min(cable_points(team.cable_length, hung)[0, :, 2]))
    first = np.array([[0, 0, 2], [1, 0, 2], [0.5, -1, low], [0.9, -1.3, low]], dtype=np.float64)
    last = first.copy()
    last[2:, 1] += 2.0
    motion = free_motion(team, through(np.array([0.0, 4.0]), np.stack([first, last])))
    found = applied(CABLE_CLEARANCE, motion)
    assert not found.holds
    assert found.bound < 1e-2
    assert found.where == ("q1", "cable 0")
    assert found.time == pytest.approx(2.0, abs=0.1)
