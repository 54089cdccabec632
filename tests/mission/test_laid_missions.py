"""Hitches that are laid, opened and closed in missions, and what is refused by name."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from plans import planned

import hitchopt as ho
from hitchopt.errors import InfeasibleError, InputError, UnsupportedError

TEAM = ho.Team(3, 2.3, tension=0.7, cable_density=0.01)
TRIANGLE = ho.regular_polygon(3, 1.3, angle=0.4).vertices + [1.0, -2.0]
LINES = np.array([[-0.7, -1.2, 2.0], [-0.7, 0.0, 2.0], [-0.7, 1.2, 2.0]])
MIRROR = np.array([-1, 1, 1])


def laid(team: ho.Team = TEAM, **keys: Any) -> ho.Plan:
    given = {"team": team, "polygon": TRIANGLE, "altitude": 1.5, "by": "laying", **keys}
    return ho.form(q=LINES, r=LINES * MIRROR, **given)


def test_a_mission_lays_opens_closes_and_unlays() -> None:
    plan = planned("lay_hexagon")
    assert [phase.name for phase in plan.phases] == [
        *("take-off", "approach", "draw taut", "slide in", "lay", "tension", "roll"),
        *("open_vertex", "hold", "close_vertex"),
        *("unroll", "relax", "lift", "slide out", "slacken", "land"),
    ]
    assert plan.certificate.certified
    places = plan.at(np.linspace(9.0, 17.0, 50)).vertices
    assert np.max(np.ptp(places, axis=0)) < 1e-9
    # Only the pair of the open vertex moves, and its cables run straight there.
    closed, opened = (plan.at(p.end).positions for p in plan.phases if p.name in {"roll", "hold"})
    moved = np.linalg.norm(opened - closed, axis=1) > 1e-6
    assert np.flatnonzero(moved).tolist() == [3, 4]  # r1 and q2
    q, p, r = opened[4], plan.at(13.0).vertices[2], plan.at(13.0).vertices[3]
    assert (q - p) @ (r - p) < -0.99 * np.linalg.norm(q - p) * np.linalg.norm(r - p)


def test_the_order_says_who_lies_on_top() -> None:
    plan = laid(order=[2, 0, 1])
    before = next(phase for phase in plan.phases if phase.name == "lay").start
    heights = plan.at(before).positions[:, 2].reshape(3, 2).mean(axis=1)
    assert np.argsort(heights).tolist() == [2, 0, 1]
    assert plan.certificate.certified


def test_a_hitch_that_is_there_opens_and_a_vertex_that_is_closed_does_not_close() -> None:
    hitch = ho.Hitch(TEAM, TRIANGLE, 1.5, np.full(3, 0.64))
    plan = ho.open_vertex(hitch, 1)
    assert plan.certificate.certified
    mission = ho.Mission(team=TEAM, start=hitch)
    opened = mission.open_vertex(1)
    with pytest.raises(InputError, match="the open one, 1"):
        opened.close_vertex(2).solve()
    with pytest.raises(InputError, match="open_vertex, then hold or close_vertex"):
        opened.morph(TRIANGLE)
    with pytest.raises(InputError, match="open_vertex, then hold or close_vertex"):
        mission.close_vertex(1)
    with pytest.raises(InputError, match="0 to 2"):
        ho.open_vertex(hitch, 3)
    assert opened.hold(0.5).close_vertex(1).morph(1.05 * TRIANGLE).solve().certificate.certified


@pytest.mark.parametrize(
    ("team", "words"),
    [
        (ho.Team(3, 2.3, tension=0.7), "cables without weight"),
        (ho.Team(3, 2.3, tension=[0.7, 0.7, 0.6], cable_density=0.01), "unequal tensions"),
        (ho.Team(3, 2.3, tension=0.7, cable_density=0.01, load=0.01), "loads on clasps"),
    ],
)
def test_teams_that_cannot_be_laid_are_refused_by_name(team: ho.Team, words: str) -> None:
    with pytest.raises(UnsupportedError, match=words):
        laid(team)


@pytest.mark.parametrize("order", [[0, 1], [0, 1, 1], [0, 1, 3]])
def test_an_order_names_every_robot_once(order: list[int]) -> None:
    with pytest.raises(InputError, match="order"):
        laid(order=order)
    with pytest.raises(InputError, match="by: laying"):
        laid(order=[0, 1, 2], by="swaps")


def test_legs_that_do_not_clear_as_they_roll_bind_separation() -> None:
    short = ho.Team(3, 2.0, tension=0.7, cable_density=0.01)
    with pytest.raises(InfeasibleError, match="separation"):
        laid(short, legs=[0.42, 0.42, 0.42])
    assert laid(short).certificate["separation"].bound > 1.0
