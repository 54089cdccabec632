"""Robots that join and withdraw in missions: slack splits and refusals."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from plans import planned

import hitchopt as ho
from hitchopt.errors import InfeasibleError
from hitchopt.hitch import Hitch
from hitchopt.hitch.requirements import Arena, Requirements
from hitchopt.hitch.team import PartTeam
from hitchopt.mission.loading import problem_from_dict
from hitchopt.motion.chapters import chapters
from hitchopt.motion.motion import Motion
from hitchopt.planners.forming.ring_change import (
    RingChangeMotions,
    corner_cut,
    corner_restored,
    find_joining,
    find_leaving,
)
from hitchopt.values import Array

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
    problem = problem_from_dict(data)
    assert isinstance(problem, ho.Problem)
    return ho.solve(problem)


@pytest.mark.slow
def test_a_pentagon_becomes_a_hexagon_and_a_pentagon_again() -> None:
    """Short legs would slope too much on sagging cut edges: pairs would not count as open."""
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


def test_neighbours_too_short_to_meet_are_refused_with_the_deficit() -> None:
    """Without robot 2 its neighbours' edges grow by 0.8 m, beyond legs of 0.35 m."""
    team, kept = ho.Team(6, 1.5), Requirements()
    after = Hitch.balanced(team, HEXAGON)
    outline, extensions = corner_restored(after.polygon, 2, 2)
    ring = PartTeam.of(team, [0, 1, 3, 4, 5])
    with pytest.raises(InfeasibleError) as refused:
        find_leaving(after, ring, 2, outline, extensions, np.ones(6), kept)
    (broken,) = refused.value.violations
    assert (broken.constraint, broken.where) == ("legs", ("cable 1", "cable 3"))
    assert broken.value == pytest.approx(0.8 * 0.7 - 0.8)
    assert broken.limit == kept.limits.leg


def test_cables_that_sag_too_much_for_joining_are_refused_by_name() -> None:
    """Cut edges of 10 g/m at 0.2 N sag by a decimetre where the new robot's cable lies on them."""
    whole = ho.Team(4, [2.3, 2.3, 2.3, 1.6], tension=0.2, cable_density=0.01)
    before = Hitch.balanced(PartTeam.of(whole, [0, 1, 2]), ho.regular_polygon(3, 1.4), 2.0)
    outline = corner_cut(before.polygon, 0, 0.7)
    with pytest.raises(InfeasibleError) as refused:
        find_joining(
            before, PartTeam.of(whole, [3, 0, 1, 2]), 0, outline, np.ones(3), 1.0, Requirements()
        )
    (broken,) = refused.value.violations
    assert (broken.constraint, broken.where) == ("tension", ("cable 3",))
    assert broken.value < broken.limit == 1.0


def nodes(motion: Motion) -> tuple[Array, Array]:
    """Ends of the parts of a ring's cables (parts, 2, 3) at the end, and all drones."""
    ring, drones = chapters(motion)[-1].groups[0].motion, motion.drones.at(motion.duration)
    own = np.concatenate([x.at(x.breaks[-1]) for x in (ring.vertices, ring.drones)])
    return own[ring.team.layout.part_nodes], drones


def test_a_robot_that_has_left_waits_beside_the_ring() -> None:
    parts, drones = nodes(planned("join_a_fourth").motion)
    own, share = drones[6:, :2], np.linspace(0.0, 1.0, 41)[:, None]
    line = own[0] + share * (own[1] - own[0])
    ring = np.concatenate([a + share * (b - a) for a, b in parts[..., :2]])
    apart = np.linalg.norm(line[:, None] - ring, axis=-1)
    assert 0.5 <= np.min(apart) < 0.7


def test_a_replaced_robot_keeps_clear_of_its_own_other_leg() -> None:
    """Robot 1's edge shrinks, and its drones pass its legs; they once came within 5 cm."""
    motion = planned("replace_in_flight").motion
    (phase,) = (p for p in motion.phases if p.name == "morph")
    ring = next(c for c in chapters(motion) if len(c.groups) == 1).groups[0].motion
    k, n, least = ring.team.labels.index(1), ring.team.robots, np.inf
    for t in np.linspace(phase.start, phase.end, 41):
        points, drones = ring.vertices.at(t), ring.drones.at(t)
        legs = (points[k], drones[2 * k]), (points[(k + 1) % n], drones[2 * k + 1])
        for drone, (start, end) in zip((drones[2 * k + 1], drones[2 * k]), legs, strict=True):
            line = start + np.linspace(0.0, 1.0, 401)[:, None] * (end - start)
            least = min(least, float(np.min(np.linalg.norm(line - drone, axis=1))))
    assert 0.149 < least < 0.2


def test_two_robots_that_have_left_wait_at_different_places() -> None:
    whole, kept = ho.Team(5, [2.3, 2.3, 2.3, 1.4, 1.4], tension=0.7), Requirements()
    before = Hitch.balanced(PartTeam.of(whole, [0, 1, 2]), ho.regular_polygon(3, 1.4), 2.0)
    ring, outline = PartTeam.of(whole, [3, 0, 1, 2]), corner_cut(before.polygon, 0, 0.5)
    joined = find_joining(before, ring, 0, outline, np.ones(3), 1.0, kept)
    first = RingChangeMotions(joined, whole, {}, kept, 0).waiting_position()
    second = RingChangeMotions(joined, whole, {4: first}, kept, 0).waiting_position()
    apart = np.linalg.norm((second[:, None] - first)[..., :2], axis=-1)
    assert np.min(apart) >= 0.5
    over = joined.robot_clear(kept)[0]
    upright = np.array([[4.0, 0.0, 1.0], [4.0, 0.0, 2.0]])  # one over the other
    prism = RingChangeMotions(joined, whole, {4: upright}, kept, 0)._prism(4, upright)
    assert prism.lower < 0.5
    assert prism.upper > 2.0
    assert np.ptp(prism.corners, axis=0)[:2] == pytest.approx(2.0 * kept.separation.cable)
    narrow = replace(kept, arena=Arena(np.min(over, axis=0) - 0.05, np.max(over, axis=0) + 0.05))
    np.testing.assert_array_equal(
        RingChangeMotions(joined, whole, {}, narrow, 0).waiting_position(), over
    )
