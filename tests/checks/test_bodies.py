"""Cables are in the regions of their states, also where states change; nothing passes them."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import hitchopt as ho
from hitchopt.checks.bodies import cable_sheets
from hitchopt.checks.registry import RULE_OF
from hitchopt.geometry import hull_offset
from hitchopt.hitch import Team
from hitchopt.motion.cable_state import STATES, CableState
from hitchopt.motion.flight import Flight, TeamMotion
from hitchopt.motion.motion import Motion, Phase
from hitchopt.motion.retiming import on_breaks_of, shifted, slice_time
from hitchopt.teams.across import check_across
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.trajectory.piecewise import merged_breaks, on_breaks
from hitchopt.values import Array
from hitchopt.verify import objects, teams, tying
from tests.helpers.by_hand import (
    Samples,
    cable_points,
    clasped_outlines,
    hull_gaps,
    point_to_segment,
)
from tests.helpers.motions import free_motion, random_flight, row, through
from tests.helpers.plans import planned
from tests.helpers.second_opinions import opinion_of, violated

DEEP = ho.Limits(floor=-20.0)
TYING = ("tie_carry_untie", "form_square")
CLASPED = tuple(state for state in STATES if state.clasped)


def cables(motion: Motion, t: float) -> Array:
    """Return points (n, 201, 3) of the cables at a time: catenaries, or taut over the vertices."""
    phase = next(p for p in motion.phases if p.end >= t)
    x = motion.drones.at(t)
    if not phase.state.tied:
        return cable_points(motion.team.cable_length, x)
    p, layout = motion.vertices.at(t), motion.team.layout
    route = np.stack([x[0::2], p[layout.starts], p[layout.ends], x[1::2]], axis=1)
    share = np.linspace(0.0, 1.0, 67)[:, None]
    parts = [a[:, None] + share * (b - a)[:, None] for a, b in zip(*route_ends(route), strict=True)]
    return np.concatenate(parts, axis=1)


def route_ends(route: Array) -> tuple[list[Array], list[Array]]:
    """Return both ends of the three parts of routes (n, 4, 3)."""
    return [route[:, i] for i in range(3)], [route[:, i + 1] for i in range(3)]


@cache
def hitch(name: str) -> Motion:
    return planned(name).motion


def passing(whole: Motion, t: float, start: Array, end: Array, seconds: float = 1.0) -> Flight:
    """Return a hitch and a single drone that flies from start to end, in the middle at t."""
    begin, last = whole.drones.breaks[[0, -1]].tolist()
    inner = np.clip([t - 0.5 * seconds, t + 0.5 * seconds], begin + 1e-3, last - 1e-3)
    places = np.array([start, start, end, end])[:, None]
    drones = through([begin, *inner, last], places)
    phases = [Phase("fly", 0, begin, last)]
    single = Motion.single(ho.Swarm(1), whole.requirements, drones, phases)
    return Flight((TeamMotion("a", whole), TeamMotion("s", single)))


@pytest.mark.parametrize("name", ["tie_carry_untie", "form_triangle"])
def test_no_drone_passes_from_one_side_of_a_cable_to_the_other(name: str) -> None:
    whole, rule = hitch(name), RULE_OF["cable_clearance"]
    for i, phase in enumerate(whole.phases):
        part = slice_time(whole, phase.start, phase.end)
        for j, share in enumerate((0.05, 0.5, 0.95)):
            t = phase.start + share * (phase.end - phase.start)
            k = (i + j) % whole.team.robots  # every cable, and every part of a phase
            points = cables(whole, t)[k]
            place, chord = points[100], points[-1] - points[0]
            side = 0.8 * np.array([-chord[1], chord[0], 0.0]) / np.linalg.norm(chord[:2])
            check = check_across(rule, passing(part, t, place - side, place + side, 0.2))
            assert check is not None
            assert not check.holds, (phase, k)


@pytest.mark.parametrize("name", TYING)
def test_regions_contain_the_cables_on_both_sides_of_joints_of_phases(name: str) -> None:
    whole = hitch(name)
    sheets, breaks = cable_sheets(whole), whole.drones.breaks
    corners = PiecewisePolynomial(breaks, sheets.corners)
    for phase in whole.phases:
        for joint, inward in ((phase.start, 1e-9), (phase.end, -1e-9)):
            if phase.state.hitched or not breaks[0] < joint < breaks[-1]:
                continue
            region = corners.at(joint + inward)
            for near in (joint - 1e-9, joint + 1e-9):  # the cable is in either state
                points = cables(whole, near)
                outline = np.broadcast_to(
                    region[:, None, : sheets.outline], (*points.shape[:2], sheets.outline, 3)
                )
                assert np.max(hull_gaps(points[:, :, None], outline)) < 2e-3, (phase, joint)
                assert np.all(points[..., 2] <= np.max(region[..., 2], axis=1)[:, None] + 0.02)
                assert np.all(points[..., 2] >= np.min(region[..., 2], axis=1)[:, None] - 0.02)


@pytest.mark.parametrize("name", ["tie_carry_untie", "form_square"])
def test_regions_of_a_flight_in_reverse_are_the_same(name: str) -> None:
    """Clasps that tighten are at those of the hitch after them, and those that relax, before."""
    whole = hitch(name)
    begin, end = whole.drones.breaks[[0, -1]].tolist()
    phases = [p.retimed(begin + end - p.end, begin + end - p.start) for p in reversed(whole.phases)]
    back = whole.map_curves(lambda part: part.reversed(), phases)
    clasped = cable_sheets(whole).clasped
    regions = cable_sheets(whole).corners[clasped]
    reversed_regions = cable_sheets(back).corners[::-1][clasped]
    assert np.any(clasped)
    np.testing.assert_allclose(reversed_regions[..., ::-1], regions, atol=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_no_cable_of_a_hitch_that_is_tied_is_closer_than_bounds(seed: int) -> None:
    whole, rng = hitch("tie_carry_untie"), np.random.default_rng(seed)
    states = [p for p in whole.phases if p.state.clasped]
    phase = states[seed % len(states)]
    t = float(rng.uniform(phase.start, phase.end))
    centre = np.mean(whole.drones.at(t), axis=0)
    ends = centre + rng.uniform(-1.0, 1.0, (2, 3)) * [1.6, 1.6, 0.9]
    flight = passing(whole, t, ends[0], ends[1], seconds=4.0)
    drone = flight.teams[1].motion
    check = check_across(RULE_OF["cable_clearance"], flight)
    assert check is not None
    for time in np.linspace(phase.start, phase.end, 150):
        points, x = cables(whole, float(time)), drone.drones.at(time)
        gaps = point_to_segment(x[0], points[:, :-1], points[:, 1:] + 1e-12)
        assert np.min(gaps) >= check.worst


def test_ones_own_drones_keep_off_a_cable_that_is_tightened(tmp_path: Path) -> None:
    whole = hitch("form_square")
    k = next(i for i, p in enumerate(whole.phases) if p.state.tightening)
    phase, breaks = whole.phases[k], whole.drones.breaks
    pieces = np.flatnonzero((breaks[:-1] >= phase.start - 1e-9) & (breaks[1:] <= phase.end + 1e-9))
    c = whole.drones.coefficients.copy()
    middle = np.mean(whole.vertices.at(phase.start)[[0, 1]], axis=0)
    c[pieces, 4] = middle[:, None]  # of the opposite robot, on the edge's line
    caught = whole.replaced(drones=PiecewisePolynomial(breaks, c))
    check = row(caught, "cable_clearance")
    assert not check.holds
    assert check.where == (whole.team.cable_names[0], whole.team.drone_names[4])
    assert phase.start <= check.time <= phase.end
    assert not row(caught, "crossing").holds  # the cable passes the region, not the chord
    rows = opinion_of(caught, tmp_path, tying.free_cables)
    assert {"cable_clearance", "crossing"} <= violated(rows)


def tied(state: CableState) -> tuple[Motion, float, Array]:
    """Return a phase, its middle, and a place between chord and taut route of cable 0 there."""
    whole = hitch("form_triangle")
    similar = CableState.TIGHTENING if state.loose else state
    phase = next(p for p in whole.phases if p.state == similar)
    part = shifted(slice_time(whole, phase.start, phase.end), -phase.start)
    part = part.replaced(phases=tuple(replace(each, state=state) for each in part.phases))
    x, p = part.drones.at(0.5 * part.duration), whole.vertices.at(phase.end)
    place = 0.5 * (np.mean(p[[0, 1]], axis=0) + np.mean(x[[0, 1]], axis=0))
    return part, 0.5 * part.duration, place


def visit(whole: Motion, t: float, place: Array) -> tuple[ho.SolidObject, PiecewisePolynomial]:
    """Return a small object that comes up from far below to a place at t, and its poses."""
    begin, last = whole.drones.breaks[[0, -1]].tolist()
    there, home = np.array([*place, 1.0, 0.0]), np.array([*place - [0.0, 0.0, 9.0], 1.0, 0.0])
    body = ho.SolidObject(ho.Section(radius=0.02), 0.0, 0.05, at=home[:3], mass=0.1)
    stops = np.array([home, home, there, home, home])[:, None]
    poses = through([begin, t - 0.05, t, t + 0.05, last], stops)
    return body, poses


@pytest.mark.parametrize("state", CLASPED, ids=str)
def test_ones_own_objects_keep_off_a_cable_that_is_tied(state: CableState, tmp_path: Path) -> None:
    whole, t, place = tied(state)
    for away, kept in ((0.0, False), (3.0, True)):
        body, poses = visit(whole, t, place + [away, 0.0, 0.0])
        needs = replace(whole.requirements, objects={"visitor": body}, limits=DEEP)
        breaks = merged_breaks([whole.drones.breaks, poses.breaks])
        finer = on_breaks_of(whole, breaks)
        visited = finer.replaced(requirements=needs, poses=on_breaks(poses, breaks))
        assert row(visited, "object_clearance").holds is kept
        broken = violated(opinion_of(visited, tmp_path, objects.clear_objects))
        assert ("object_clearance" not in broken) is kept


@pytest.mark.parametrize("state", CLASPED, ids=str)
def test_objects_of_other_teams_keep_off_a_cable_that_is_tied(
    state: CableState, tmp_path: Path
) -> None:
    whole, t, place = tied(state)
    for away, kept in ((0.0, False), (3.0, True)):
        body, poses = visit(whole, t, place + [away, 0.0, 0.0])
        needs = replace(whole.requirements, objects={"visitor": body}, limits=DEEP)
        drones = PiecewisePolynomial.constant(poses.breaks, np.array([[9.0, 9.0, 1.0]]))
        phases = [Phase("fly", 0, *poses.breaks[[0, -1]].tolist())]
        other = Motion.single(ho.Swarm(1), needs, drones, phases).replaced(poses=poses)
        flight = Flight((TeamMotion("a", whole), TeamMotion("s", other)))
        check = check_across(RULE_OF["object_clearance"], flight)
        assert check is not None
        assert check.holds is kept
        broken = violated(opinion_of(flight, tmp_path, teams.object_distances))
        assert ("object_clearance" not in broken) is kept


@pytest.mark.parametrize("kind", ["ring", "chain"])
def test_regions_contain_routes_over_the_middles_of_pairs_that_turn(kind: str) -> None:
    whole = hitch("form_square")
    if kind == "chain":  # three of its cables, as a chain
        team = ho.Team(3, whole.team.cable_length[:3], topology="open")
        drones = whole.drones.replaced(whole.drones.coefficients[:, :6])
        whole = Motion.single(team, whole.requirements, drones, whole.phases)
    times = [0.5 * (p.start + p.end) for p in whole.phases if p.state.clasping]
    sheets = cable_sheets(whole)
    region = PiecewisePolynomial(whole.drones.breaks, sheets.corners).at(times)
    routes = clasped_outlines(Samples(whole, np.array(times)), CableState.CLASPING)
    for corner in range(4):
        outside = hull_gaps(routes[:, :, [corner]], region[:, :, : sheets.outline])
        assert np.max(outside) < 1e-9


def test_the_offset_of_hulls_is_that_of_their_nearest_points() -> None:
    rng = np.random.default_rng(3)
    for k, m in ((1, 1), (1, 4), (2, 2), (6, 3), (6, 6)):
        a = rng.normal(size=(50, k, 2))
        b = rng.normal(size=(50, m, 2)) + [7.0, -6.0]
        offset = hull_offset(a[:, :, None] - b[:, None])
        flat = [np.concatenate([each, np.zeros_like(each[..., :1])], axis=-1) for each in (a, b)]
        assert np.linalg.norm(offset, axis=-1) == pytest.approx(hull_gaps(*flat), abs=1e-9)
        along = np.einsum("skmd,sd->skm", a[:, :, None] - b[:, None], offset)
        squared = np.sum(offset**2, axis=-1)
        assert np.min(along, axis=(1, 2)) == pytest.approx(squared, rel=1e-9)


def test_stated_vertices_beside_the_edges_do_not_free_these(tmp_path: Path) -> None:
    whole = hitch("tie_carry_untie")
    phase = next(p for p in whole.phases if p.name == "loosen")
    breaks, c = whole.drones.breaks, whole.drones.elevated(whole.vertices.degree).coefficients
    pieces = np.flatnonzero((breaks[:-1] >= phase.start - 1e-9) & (breaks[1:] <= phase.end + 1e-9))
    vertices = whole.vertices.elevated(whole.drones.degree).coefficients.copy()
    behind = 2 * whole.team.layout.behind + 1
    middles = 0.5 * (c[pieces][:, 0::2] + c[pieces][:, behind])  # of pairs, outside of the edges
    vertices[pieces] = middles[..., : vertices.shape[-1]]
    lying = whole.replaced(vertices=PiecewisePolynomial(breaks, vertices))
    t = 0.5 * (phase.start + phase.end)
    ends = whole.vertices.at(phase.start)
    edge = np.mean(ends[[0, 1]], axis=0)
    inside = edge + 0.2 * (np.mean(ends, axis=0) - edge) / np.linalg.norm(np.mean(ends, 0) - edge)
    begin, last = whole.drones.breaks[[0, -1]].tolist()
    times = [
        begin,
        phase.start,
        t,
        phase.end,
        phase.end + 0.3,
        last,
    ]  # to the edge and back, then away
    away = inside + [0.0, 0.0, 5.0]
    places = np.array([away, inside, edge, inside, away, away])[:, None]
    single = Motion.single(
        ho.Swarm(1), whole.requirements, through(times, places), [Phase("fly", 0, begin, last)]
    )
    flight = Flight((TeamMotion("a", lying), TeamMotion("s", single)))
    check = check_across(RULE_OF["cable_clearance"], flight)
    assert check is not None
    assert check.worst < 0.01
    assert abs(check.time - t) < 0.1
    assert "cable_clearance" in violated(opinion_of(flight, tmp_path, teams.between_plans))


@pytest.mark.parametrize("topology", ["closed", "open"])
@pytest.mark.parametrize("n", [3, 4, 5])
def test_clasps_turn_about_the_middles_of_their_pairs(n: int, topology: str) -> None:
    """Vertex p_k is that of q_k and r_{k-1}; a chain ends at its first q and its last r."""
    team, drones = random_flight(n, n=n, pieces=2)
    team = replace(team, topology=topology)
    sheets = cable_sheets(free_motion(team, drones, CableState.CLASPING))
    assert sheets.outline == 6
    begin, end = drones.breaks[[0, -1]]
    for t in np.linspace(begin, end, 7):
        corners = PiecewisePolynomial(drones.breaks, sheets.corners).at(t)
        q, r = drones.at(t).reshape(n, 2, 3).swapaxes(0, 1)
        for k in range(n):
            starts = q[k] if topology == "open" and k == 0 else 0.5 * (q[k] + r[k - 1])
            is_last = topology == "open" and k == n - 1
            ends = r[k] if is_last else 0.5 * (q[(k + 1) % n] + r[k])
            np.testing.assert_allclose(corners[k, [0, 1, 4, 5]], [q[k], starts, ends, r[k]])


@pytest.mark.parametrize("robots", [2, 3])
def test_neighbours_that_are_not_linked_do_not_cross(robots: int) -> None:
    """They share a clasp later; before, they are as far apart as others."""
    places = np.array([[-0.7, 0.0, 2.0], [0.7, 0.0, 2.0], [0.0, -0.7, 2.6], [0.0, 0.7, 2.6]])
    far = [[9.0, 0.0, 2.0], [9.0, 1.4, 2.0]]
    places = np.concatenate([places, far]) if robots == 3 else places
    topology = "open" if robots == 2 else "closed"
    drones = PiecewisePolynomial.constant([0.0, 1.0], places)
    motion = free_motion(Team(robots, 2.0, topology=topology), drones, CableState.FREE)
    check = row(motion, "crossing")
    assert (check.holds, check.where, check.worst) == (False, ("cable 0", "cable 1"), 0.0)
    linked = free_motion(Team(robots, 2.0, topology=topology), drones, CableState.TIGHTENING)
    assert row(linked, "crossing").holds
