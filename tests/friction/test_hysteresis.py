"""Laws of where friction holds the vertices of a hitch whose cables slide back and forth."""

from __future__ import annotations

from functools import cache
from itertools import pairwise

import numpy as np
import pytest

import hitchopt as ho
from hitchopt.friction.hysteresis import held_vertices
from hitchopt.hitch.rest_errors import planned_rest
from hitchopt.motion.motion import Motion
from hitchopt.motion.states import states_at
from hitchopt.values import Array

TRIANGLE = ho.ConvexPolygon([[0.0, 0.75], [0.65, -0.375], [-0.65, -0.375]])
WAY = np.array([0.05, 0.2])


@cache
def moved_out() -> Motion:
    """A vertex that moves out by 0.2 m; no leg leans."""
    team = ho.Team(3, 2.4, tension=0.5)
    problem = ho.Problem(team, ho.HitchStart(TRIANGLE, 1.0), [ho.MoveVertex(0, by=WAY)])
    return ho.solve(problem).motion


def followed(times: Array, frictions: list[float], held: float = 0.0) -> Array:
    """Return vertices (S, F, points, 3) [m] at times of that motion, in any order."""
    motion = moved_out()
    states = states_at(motion, times)
    rests = planned_rest(
        motion.team, states.positions, states.vertices, states.tensions, states.cable_forces
    )
    shares = np.full(len(frictions), held)
    return held_vertices(motion.team, rests, np.array(frictions), shares)


def there_and_back(shares: list[float], steps: int) -> Array:
    """Return times at shares of the motion's way, with steps between."""
    runs = [np.linspace(start, end, steps + 1)[1:] for start, end in pairwise(shares)]
    return np.concatenate([shares[:1], *runs]) * moved_out().duration


def planned(times: Array) -> Array:
    return np.asarray(moved_out().vertices.at(times))


def test_without_friction_vertices_follow_their_plan() -> None:
    t = there_and_back([0.0, 1.0, 0.3], 4)
    np.testing.assert_allclose(followed(t, [0.0])[:, 0], planned(t), atol=1e-5)


def test_strong_friction_holds_cables_where_they_are() -> None:
    """While cables stick, their legs keep their lengths, as far as drones are held by springs."""
    t = there_and_back([0.0, 0.35], 3)
    vertices = followed(t, [1.0])[:, 0]
    moves = np.linalg.norm(planned(t)[-1] - planned(t)[0], axis=-1)
    drones = moved_out().drones.at(t)
    legs = np.linalg.norm(drones - vertices[:, moved_out().team.layout.anchors], axis=-1)
    assert moves[0] > 0.02
    changes = np.abs(moved_out().legs.at(t[-1]) - moved_out().legs.at(t[0]))
    assert np.max(np.abs(legs[-1] - legs[0])) < 0.2 * np.max(changes)
    assert np.max(np.linalg.norm(vertices - planned(t), axis=-1)) > 0.4 * moves[0]


def test_more_friction_holds_vertices_farther_back() -> None:
    t = there_and_back([0.0, 1.0], 4)
    vertices = followed(t, [0.0, 0.03, 0.06, 0.1])
    back = (planned(t)[-1, 0] - vertices[-1, :, 0]) @ np.append(WAY, 0.0) / np.linalg.norm(WAY)
    assert np.all(np.diff(back) > 0.01)


def test_returns_across_the_band_forget_what_was_before() -> None:
    """The vertex that moves ends alike; no other ends farther apart than it began."""
    t = there_and_back([0.0, 1.0, 0.0, 1.0], 3)
    before, after = [followed(t, [0.02], held)[:, 0] for held in (-1.0, 1.0)]
    apart = np.linalg.norm(after - before, axis=-1)
    assert np.min(apart[0]) > 0.04
    assert apart[-1, 0] < 0.3 * apart[0, 0]
    assert np.max(apart[-1]) <= np.max(apart[0])


def test_rests_depend_on_turning_points_not_on_steps() -> None:
    ends = [
        followed(there_and_back([0.0, 1.0, 0.4, 0.8], steps), [0.05, 0.1])[-1] for steps in (2, 8)
    ]
    np.testing.assert_allclose(ends[0], ends[1], atol=3e-3)


def test_turned_hitches_are_held_alike() -> None:
    """At an open chain, whose ends are drones, too."""
    c, s = np.cos(1.0), np.sin(1.0)
    turn = np.array([[c, s], [-s, c]])
    corners, by = np.array([[0.0, 0.0], [0.5, 0.6], [1.2, 0.5]]), np.array([0.0, 0.15])
    found = list[Array]()
    for matrix in (np.eye(2), turn):
        team = ho.Team(2, 2.0, tension=0.5, topology="open")
        start = ho.HitchStart(ho.ConvexArc(corners @ matrix), 1.0)
        motion = ho.solve(ho.Problem(team, start, [ho.MoveVertex(1, by=by @ matrix)])).motion
        states = states_at(motion, np.linspace(0.0, motion.duration, 5))
        rests = planned_rest(
            team, states.positions, states.vertices, states.tensions, states.cable_forces
        )
        vertices = held_vertices(team, rests, np.array([0.1]), np.zeros(1))[-1, 0]
        off = vertices - states.vertices[-1]
        assert np.all(np.isfinite(off))
        found.append(np.hstack([off[:, :2] @ matrix.T, off[:, 2:]]))
    assert np.linalg.norm(found[0][1]) > 0.01
    np.testing.assert_allclose(found[0], found[1], atol=1e-3)


@pytest.mark.parametrize("share", [0.25, 0.5, 1.0])
def test_bands_are_nested(share: float) -> None:
    """What less friction can hold, more friction holds too: the vertices do not move."""
    t = np.zeros(2)
    less = followed(t[:1], [0.1 * share], 1.0)[0, 0]
    more = followed(t, [0.1], share)
    np.testing.assert_allclose(more[0, 0], less, atol=1e-3)
    np.testing.assert_allclose(more[1], more[0], atol=1e-6)
