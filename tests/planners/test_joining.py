"""Robots that join and withdraw in missions: how legs are split for it, and what refuses it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import hitchopt as ho
from hitchopt.errors import InfeasibleError
from hitchopt.hitch import Hitch
from hitchopt.hitch.requirements import Requirements
from hitchopt.hitch.team import PartTeam
from hitchopt.mission.loading import any_problem_from_dict
from hitchopt.planners.forming.joining import corner_restored, leaving

HEXAGON = 0.8 * ho.regular_polygon(6, 1.0).vertices
PENTAGON = np.concatenate([[2.0 * HEXAGON[0] - HEXAGON[5]], HEXAGON[2:]])
"""A hexagon [m] with the corner beyond its first edge not cut off."""


def solved(
    polygon: Any, lengths: Any, *steps: dict[str, Any], by: str = "swaps", tension: float = 0.7
) -> ho.Plan:
    """The plan of a ring, and of robots that wait beside it on the ground."""
    n, count = len(polygon), len(lengths)
    half, row = 0.45 * np.array(lengths)[:, None], 2.0 - np.arange(count)[:, None]
    q = np.hstack([-half, row, 0.0 * row])
    q[n:] = np.hstack([-3.0 - (row[n:] - row[-1]), -half[n:], 0.0 * half[n:]])
    r = q * [[-1.0, 1.0, 1.0]]
    r[n:] = q[n:] * [1.0, -1.0, 1.0]
    form = {"polygon": np.round(polygon, 6).tolist(), "altitude": 1.6, "by": by}
    team = {"robots": count, "cable_length": [*lengths], "cable_density": 0.01, "tension": tension}
    data = {
        "team": team,
        "start": {"drones": {"q": q.tolist(), "r": r.tolist()}},
        "mission": [{"form": {**form, "robots": [*range(n)]}}, *steps],
    }
    problem = any_problem_from_dict(data)
    assert isinstance(problem, ho.Problem)
    return ho.solve(problem)


def test_a_pentagon_becomes_a_hexagon_and_a_pentagon_again() -> None:
    """Short legs would lean too much where cut edges sag: its pairs would not count as open."""
    steps = {"join": {"robot": 5, "vertex": 0, "cut": 0.8}}, {"withdraw": {"robot": 5}}
    plan = solved(PENTAGON, [2.6, 1.5, 1.5, 1.5, 2.3, 1.6], *steps)
    assert plan.certificate.certified
    rings = [len(phase.ring or ()) for phase in plan.phases]
    assert {5, 6} == {*rings}
    assert rings[-1] == 5
    (start,) = (p.start for p in plan.phases if p.name == "pass weight")
    hexagon = plan.at(start).vertices[:, :2]
    np.testing.assert_allclose(hexagon, HEXAGON, atol=1e-6)


def test_cables_that_pull_too_hard_for_their_drones_to_roll_are_refused() -> None:
    with pytest.raises(InfeasibleError) as refused:
        solved(ho.regular_polygon(3, 1.3).vertices, [2.3] * 3, by="laying", tension=1.0)
    assert refused.value.violations[0].constraint == "tilt"


def test_neighbours_that_are_too_short_to_meet_are_told_by_how_much() -> None:
    """Without robot 2 its neighbours' edges grow by 0.8 m, beyond legs of 0.35 m."""
    team, kept = ho.Team(6, 1.5), Requirements()
    after = Hitch.balanced(team, HEXAGON)
    outline, grown = corner_restored(after.polygon, 2, 2)
    ring = PartTeam.of(team, [0, 1, 3, 4, 5])
    with pytest.raises(InfeasibleError) as refused:
        leaving(after, ring, 2, outline, grown, np.ones(6), kept)
    (broken,) = refused.value.violations
    assert (broken.constraint, broken.where) == ("legs", ("cable 1", "cable 3"))
    assert broken.value == pytest.approx(0.8 * 0.7 - 0.8)
    assert broken.limit == kept.limits.leg
