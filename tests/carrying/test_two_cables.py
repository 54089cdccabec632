"""Two cables around an object: tied, carried and untied; laws of the plan."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hitchopt as ho
from hitchopt import verify
from hitchopt.checks import certify
from hitchopt.checks.clasps import BALANCE_LIMIT, PASSED_SHARE
from hitchopt.checks.registry import RULE_OF
from hitchopt.checks.tracking import DRAWING_SPEED
from hitchopt.checks.violations import infeasible_error
from hitchopt.drones.quadrotor import GRAVITY
from hitchopt.errors import Violation
from hitchopt.geometry.vectors import unit
from hitchopt.hitch.catenary import Catenary
from hitchopt.hitch.forces import hanging_forces
from hitchopt.hitch.holding import Grip, grip_capacity, wraps_around
from hitchopt.hitch.requirements import Requirements
from hitchopt.mission.loading import problem_from_dict
from hitchopt.motion.motion import CableState, Motion
from hitchopt.motion.plan_file import write_plan
from hitchopt.objects import Section
from hitchopt.objects.placing import REST_DRIFT
from hitchopt.planners.carrying.hinge import EDGE, PREFERRED_HINGE, clasp_height, needed_height
from hitchopt.planners.carrying.holds import GripHold
from hitchopt.planners.carrying.planner import (
    MAX_PUSH,
    GraspState,
    MovePlanner,
    first_violated,
    lowest_untying_tension,
)
from hitchopt.planners.carrying.polygons import HoldPolygons, grip_clasps
from hitchopt.planners.carrying.straddle_planner import BESIDE, find_straddle
from hitchopt.steps.straddling import Tie
from hitchopt.values import Array
from hitchopt.verify import objects
from tests.helpers.groups import part
from tests.helpers.plans import planned
from tests.helpers.second_opinions import opinion_of

DRUM: dict[str, Any] = {"circle": 0.12, "to": 0.4, "mass": 0.08, "friction": 0.5}
AT = [0.4, -0.3, 0.0]


def problem(mission: list[dict[str, Any]], body: dict[str, Any] = DRUM, **team: Any) -> ho.Problem:
    """Two cables beside an object off the origin; names q and r as a user may give them."""
    places = [[-0.7, 0.4, 0.0], [1.5, -1.0, 0.0]], [[1.5, 0.4, 0.0], [-0.7, -1.0, 0.0]]
    drones = {"q": places[0], "r": [places[1][0], places[1][1]]}
    cables = {"robots": 2, "cable_length": 2.4, "cable_density": 0.005, "tension": 1.0}
    return problem_from_dict(
        {
            "team": {**cables, "quadrotor": "paper_132g", **team},
            "limits": {"tilt_deg": 60, "tracking": 0.0},
            "objects": {"drum": {**body, "at": AT}},
            "start": {"drones": drones},
            "mission": mission,
        }
    )


TIE: dict[str, Any] = {"tie": {"around": "drum", "at": 0.3}}


@cache
def cycle() -> ho.Plan:
    """A drum that is tied, carried, set down and untied."""
    return planned("two_robots_drum")


@cache
def tied() -> Motion:
    """The same drum, only tied."""
    return part(cycle().motion, "draw taut", "tighten")


def violated(motion: Motion) -> set[str]:
    """The names of the checks that do not hold."""
    return {check.name for check in certify(motion, reports=()).violated}


def test_drum_is_tied_carried_and_untied() -> None:
    plan = cycle()
    assert plan.certificate.certified
    names = [phase.name for phase in plan.motion.phases]
    assert [x for x in ("straddle", "roll", "draw", "lift", "unroll") if x not in names] == []
    states = {phase.name: phase.state for phase in plan.motion.phases}
    assert states["straddle"] is states["lay"] is CableState.BENT
    assert states["roll"] is CableState.ROLLING
    end = plan.motion.poses.at(plan.duration)[0]
    np.testing.assert_allclose(end, [0.5, 0.0, 0.0, 1.0, 0.0], atol=REST_DRIFT)
    assert plan.certificate["hinge"].worst == pytest.approx(PREFERRED_HINGE, abs=1e-6)
    assert not np.any(plan.motion.formed[-1])
    pairs = plan.motion.drones.coefficients[-1, ..., -1].reshape(2, 2, 3)
    (x, y), (u, v) = (pairs[:, 1] - pairs[:, 0])[:, :2].T, (end[:2] - pairs[:, 0, :2]).T
    assert np.all(x * v - y * u < 0.0)  # the object is on the right of both


def test_drones_draw_cables_taut_slowly_from_where_their_errors_could() -> None:
    motion = part(cycle().motion, "draw taut", "draw taut")
    error = motion.requirements.limits.tube.level
    t = np.linspace(0.0, motion.duration, 800)
    pairs = motion.drones.at(t).reshape(len(t), 2, 2, 3)
    chords = np.linalg.norm(pairs[:, :, 1] - pairs[:, :, 0], axis=-1)
    speeds = np.max(np.linalg.norm(motion.drones.at(t, 1), axis=-1), axis=-1)
    could_be_taut = np.any(chords + 2.0 * error >= motion.team.cable_length, axis=1)
    assert error == 0.05
    assert np.any(could_be_taut)
    assert 0.5 * DRAWING_SPEED < np.max(speeds[could_be_taut]) < DRAWING_SPEED
    assert np.max(speeds[~could_be_taut]) > 5.0 * DRAWING_SPEED  # no slower than needed


@pytest.mark.slow
def test_long_heavy_cables_are_loosened_with_a_tension_that_keeps_their_shape() -> None:
    """With the usual 0.3 N, cables of 42 g would sag too far for their clasps to balance."""
    body = {"circle": 0.15, "to": 0.4, "mass": 0.2, "friction": 0.5}
    places = [[-1.5, 0.7, 0.0], [2.3, -1.3, 0.0]], [[2.3, 0.7, 0.0], [-1.5, -1.3, 0.0]]
    heavy = problem_from_dict(
        {
            "team": {
                **{"robots": 2, "cable_length": 4.2, "cable_density": 0.01, "tension": 1.7},
                "quadrotor": {"mass": 2.0, "max_thrust": 40},
            },
            "limits": {"tilt_deg": 45, "tracking": 0.0},
            "objects": {"drum": {**body, "at": AT}},
            "start": {"drones": {"q": places[0], "r": places[1]}},
            "mission": [{"transport_object": {"object": "drum", "to": [1.4, -0.3, 0.0]}}],
        }
    )
    plan = ho.solve(heavy)
    assert plan.certificate.certified
    phases = {phase.name: phase for phase in plan.phases}
    assert phases["loosen"].tension is not None
    assert phases["loosen"].tension[0] > 0.3
    # What slows a phase down is said.
    slowed = "slowed down from "
    assert phases["carry"].remark.startswith(slowed)
    assert phases["carry"].remark.endswith(" to keep equilibrium at drum")
    assert not phases["lift"].remark


def test_the_tension_that_a_drum_needs_is_that_of_the_documentation() -> None:
    """About 0.4 m g/μ for the limit of 1.5, to which the grip is proportional."""
    motion, grip = cycle().motion, cycle().certificate["grip"]
    drum = motion.requirements.objects["drum"]
    tension = float(np.max(motion.team.tension)) * 1.5 / grip.worst
    assert grip.limit == 1.5
    assert 0.36 < tension * drum.friction / (drum.mass * GRAVITY) < 0.4


def test_drones_are_pulled_along_their_cables_in_every_state() -> None:
    motion = tied()
    times = np.linspace(0.0, motion.duration, 60)
    plan = ho.Plan(ho.Flight.of(motion), certify(motion, reports=()))
    states = plan.at(times)
    anchors = motion.anchors.at(motion.drones.breaks[0] + times).reshape(len(times), 4, 3)
    breaks = motion.drones.breaks
    pieces = np.clip(np.searchsorted(breaks, breaks[0] + times) - 1, 0, None)
    index = motion.phase_of_piece[pieces]
    bent = np.array([p.state is CableState.BENT and p.hold is not None for p in motion.phases])
    bent = bent[index]
    legs = anchors[bent] - states.positions[bent]
    level = states.cable_forces[bent, :, :2]
    along = np.sum(level * legs[..., :2], axis=-1)
    assert np.all(along > 0.0)
    tension = float(motion.phases[-2].tension[0]) if motion.phases[-2].tension else 0.0
    assert np.all(np.linalg.norm(level, axis=-1) > 0.8 * tension)


def test_cables_beside_the_object_are_catenaries_within_what_bent_cables_may_lack() -> None:
    motion = tied()
    team, (lower,) = motion.team, [p for p in motion.phases if p.name == "lower"]
    times = np.linspace(lower.start, lower.end, 20) - motion.drones.breaks[0]
    states = ho.Plan(ho.Flight.of(motion), certify(motion, reports=())).at(times)
    q, r = states.positions[:, 0::2], states.positions[:, 1::2]
    half = 0.5 * GRAVITY * team.cable_density / states.tensions[..., None]
    weights = half * (team.cable_length[:, None] - states.legs[..., ::-1])
    second_order = (half * team.cable_length[:, None]) ** 2
    forces = states.cable_forces - hanging_forces(team, states.positions)
    errors = np.linalg.norm(forces, axis=-1).reshape(weights.shape) / states.tensions[..., None]
    assert np.all(errors <= PASSED_SHARE * weights + second_order + BALANCE_LIMIT)
    # Where legs meet edges, they are displaced by what they lack, over their stiffness
    begin = motion.drones.breaks[0]
    anchors, middles = (each.at(begin + times) for each in (motion.anchors, motion.contacts))
    chord = (r - q)[..., None, :2]
    shares = np.sum((anchors - q[..., None, :])[..., :2] * chord, axis=-1)
    shares = np.moveaxis(shares / np.sum(chord**2, axis=-1), -1, 0)
    depths = Catenary.between(q, r, team.cable_length).depth(2.0 * shares - 1.0)
    heights = np.moveaxis(q[..., 2] + shares * (r - q)[..., 2] - depths, 0, -1)
    edges = np.linalg.norm(anchors - middles, axis=-1)
    displaced = PASSED_SHARE * weights + BALANCE_LIMIT
    displaced = displaced * states.legs * edges / (states.legs + edges)
    assert np.all(np.abs(anchors[..., 2] - heights) <= displaced)
    assert np.max(np.abs(anchors[..., 2] - heights)) > 0.2 * np.max(displaced)


# Laws.


def transformed(motion: Motion, change: Callable[[Array], Array], turn: Array) -> Motion:
    """The motion with all points changed (…, 3, k), headings turned by a matrix (2, 2)."""
    values: dict[str, Any] = {}
    for name in ("drones", "vertices", "contacts", "anchors"):
        part = getattr(motion, name)
        points = change(np.moveaxis(part.coefficients, -2, -1))
        values[name] = part.replaced(np.moveaxis(points, -1, -2))
    poses = motion.poses.coefficients.copy()
    poses[:, :, :3] = np.moveaxis(change(np.moveaxis(poses[:, :, :3], -2, -1)), -1, -2)
    poses[:, :, 3:] = np.einsum("ij,pojk->poik", turn, poses[:, :, 3:])
    objects = {
        name: replace(
            body,
            at=change(body.at),
            yaw=float(np.arctan2(*(turn @ [np.cos(body.yaw), np.sin(body.yaw)])[::-1])),
        )
        for name, body in motion.requirements.objects.items()
    }
    requirements = replace(motion.requirements, objects=objects)
    return motion.replaced(requirements=requirements, poses=motion.poses.replaced(poses), **values)


def same(one: Motion, other: Motion, tolerance: float = 1e-3) -> None:
    """Both have the same certificate."""
    first, second = (certify(x, reports=()) for x in (one, other))
    assert first.certified
    assert second.certified
    for check in first.checks:
        if check.is_evaluated and check.name != "tension":
            assert second[check.name].worst == pytest.approx(check.worst, rel=tolerance, abs=1e-4)


@pytest.mark.slow
def test_translation_and_rotation_change_no_check() -> None:
    c, s = np.cos(0.7), np.sin(0.7)
    matrix = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    moved = transformed(tied(), lambda x: x @ matrix.T + [3.0, -2.0, 0.0], matrix[:2, :2])
    same(tied(), moved)


@cache
def tied_harder() -> Motion:
    """A drum that is tied with more than the team's tension."""
    body = {**DRUM, "circle": 0.13, "mass": 0.07}
    tie = {"tie": {"around": "drum", "at": 0.25, "tension": 1.0}}
    return ho.solve(problem([tie], body, tension=0.6, cable_length=2.5)).motion


def of_both(motion: Motion, folder: Path, name: str) -> tuple[float, list[verify.Row]]:
    """Return the bound of a check, and verify's rows of it."""
    write_plan(folder / "plan.npz", ho.Flight.of(motion))
    rows = [each for each in verify.verify(folder) if each.name == name]
    return certify(motion, reports=())[name].worst, rows


@pytest.mark.parametrize(
    "name", ["cable_length", pytest.param("equilibrium", marks=pytest.mark.slow)]
)
def test_both_say_the_same_of_cables_tied_with_more_than_the_team_s_tension(
    name: str, tmp_path: Path
) -> None:
    """As tensions rise, cables sag as at the tension to which these rise."""
    bound, rows = of_both(tied_harder(), tmp_path, name)
    assert [each.verdict for each in rows] == ["proven"]
    assert bound == pytest.approx(rows[0].worst, rel=0.05, abs=3e-7)


@pytest.mark.parametrize(("factor", "holds"), [(1.0, True), (1.2, False)])
def test_tensions_rise_to_that_at_which_cables_are_taut(
    factor: float, *, holds: bool, tmp_path: Path
) -> None:
    """No farther on one ramp, whatever the phase permits."""
    motion = part(tied_harder(), "take-off", "tension")
    *before, ramp = motion.phases
    motion = motion.replaced(phases=(*before, replace(ramp, tension=(1.0, 1.3))))
    motion = motion.replaced(
        tensions=motion.tensions.replaced(motion.tensions.coefficients * factor)
    )
    pulls = motion.leg_tensions.replaced(motion.leg_tensions.coefficients * factor)
    bound, rows = of_both(motion.replaced(leg_tensions=pulls), tmp_path, "tension")
    assert (rows[0].verdict == "proven") is holds
    assert (bound <= 1e-4) is holds
    assert holds or bound > 0.05


def under_a_rim(radius: float, above: float) -> tuple[Motion, str]:
    """Return the drum as it is carried elsewhere, with a rim above the contacts, and its name."""
    carried = part(cycle().motion, "carry", "carry")
    c, s = np.cos(0.7), np.sin(0.7)
    matrix = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    moved = transformed(carried, lambda x: x @ matrix.T + [3.0, -2.0, 0.0], matrix[:2, :2])
    ((name, body),) = moved.requirements.objects.items()
    rim = ho.Rim(Section(radius=radius), 0.35 + above)
    objects = {name: replace(body, rim=rim)}
    return moved.replaced(requirements=replace(moved.requirements, objects=objects)), name


RIMS = [*product([0.125, 0.14, 0.25, 0.6], [0.0, 0.002, 0.02, 0.045])]
"""Radii of rims, and heights above where cables leave the body [m]."""


@pytest.mark.parametrize(
    ("radius", "above"),
    [pytest.param(*rim, marks=pytest.mark.slow if k % 5 else ()) for k, rim in enumerate(RIMS)],
)
def test_cables_that_hold_an_object_do_not_pass_through_its_rim(
    radius: float, above: float, tmp_path: Path
) -> None:
    """Which bears on no cable, as these rise away from the body. Samples tell."""
    motion, name = under_a_rim(radius, above)
    times = np.linspace(0.0, motion.duration, 400)
    begin, index = motion.drones.breaks[0], list(motion.requirements.objects).index(name)
    pose = motion.poses.at(begin + times)[:, index]
    x, v, contacts = (
        each.at(begin + times) for each in (motion.drones, motion.vertices, motion.contacts)
    )
    ends = np.stack([v, np.roll(v, -1, axis=1)], axis=2)
    pairs = x.reshape(ends.shape)
    both = [np.stack(each, axis=-2) for each in ((contacts, ends), (ends, pairs))]
    parts = np.concatenate([each.reshape(len(times), -1, 2, 3) for each in both], axis=1)
    share = np.linspace(0.0, 1.0, 2001)[:, None]
    points = parts[:, :, None, 0] + share * (parts[:, :, 1] - parts[:, :, 0])[:, :, None]
    local = points - pose[:, None, None, :3]
    level = np.linalg.norm(local[..., :2], axis=-1)
    reaches = local[..., 2] >= 0.35 + above - 1e-5
    expected = bool(np.any(reaches & (level <= radius)))
    check = RULE_OF["object_clearance"].check(motion)
    assert check is not None
    assert check.holds is not expected
    write_plan(tmp_path / "plan.npz", ho.Flight.of(motion))
    ((plan,), _) = verify.read(tmp_path / "plan.npz")
    rows = [each for each in objects.clear_held(plan, index) if each.samples]
    assert any(each.verdict != "proven" for each in rows) is expected


def test_a_lip_saves_no_friction() -> None:
    pot = {**DRUM, "to": 0.4, "mass": 0.1, "friction": 0.1, "rim": {"circle": 0.2, "at": 0.32}}
    steps: list[dict[str, Any]] = [{"tie": {"around": "drum"}}, {"lift": {"by": 0.1}}]
    with pytest.raises(ho.InfeasibleError, match=r"grip: 0\.\d+ is below the limit of 1\.5"):
        ho.solve(problem(steps, pot))


@pytest.mark.slow
def test_mirror_image_has_the_other_sense() -> None:
    """Reflected cables exchange q and r, to run clockwise, and both clasps change their sense."""
    motion, flip = tied(), np.array([1.0, -1.0, 1.0])
    mirrored = transformed(motion, lambda x: x * flip, np.diag([1.0, -1.0]))
    swap = {"drones": [1, 0, 3, 2], "vertices": [1, 0], "tensions": [0, 1]}
    values: dict[str, Any] = {
        name: getattr(mirrored, name).replaced(getattr(mirrored, name).coefficients[:, order])
        for name, order in swap.items()
    }
    for name in ("legs", "leg_tensions", "contacts", "anchors"):
        part = getattr(mirrored, name)
        values[name] = part.replaced(part.coefficients[:, :, ::-1])
    same(motion, mirrored.replaced(**values))


@pytest.mark.slow
def test_renumbered_cables_change_no_check() -> None:
    motion, values = tied(), dict[str, Any]()
    orders = {"drones": [2, 3, 0, 1], "vertices": [1, 0]}
    for name in ("drones", "vertices", "legs", "tensions", "leg_tensions", "contacts", "anchors"):
        part = getattr(motion, name)
        values[name] = part.replaced(part.coefficients[:, orders.get(name, [1, 0])])
    same(motion, motion.replaced(**values))


@pytest.mark.slow
def test_tying_in_reverse_unties() -> None:
    motion = tied()
    both = float(motion.drones.breaks[0] + motion.drones.breaks[-1])
    phases = [p.retimed(both - p.end, both - p.start) for p in reversed(motion.phases)]
    start = float(motion.drones.breaks[0])
    phases[0] = phases[0].retimed(start, phases[0].end)
    same(motion, motion.map_curves(lambda part: part.reversed(), phases))


@pytest.mark.parametrize(
    ("at", "tracking", "words"),
    [
        pytest.param(0.24, 0.05, r"hinge.*0\.04.*0\.08.*tie it at 0\.28 m", marks=pytest.mark.slow),
        (0.15, 0.0, r"hinge.*-0\.05.*0\.03.*tie it at 0\.23 m"),
    ],
)
def test_clasps_below_the_centre_of_mass_are_refused(
    at: float, tracking: float, words: str
) -> None:
    exact = problem([{"tie": {"around": "drum", "at": at}}, {"lift": {"by": 0.1}}])
    with pytest.raises(ho.InfeasibleError, match=words):
        ho.solve(replace(exact, limits=replace(exact.limits, tracking=tracking)))


def prism(sides: int, radius: float) -> dict[str, Any]:
    """The drum with a regular section of that many sides, of a circumradius [m]."""
    angles = 2.0 * np.pi * np.arange(sides) / sides
    points = radius * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    return {**{k: v for k, v in DRUM.items() if k != "circle"}, "outline": points.tolist()}


LESS: dict[str, Any] = {"tie": TIE["tie"] | {"tension": 0.3}}
SMALL = {"tension": 0.12, "cable_density": 0.0015, "quadrotor": "crazyflie_2.1_brushless"}
BOX = [[-0.16, -0.16], [-0.16, 0.16], [0.16, 0.16], [0.16, -0.16]]


@pytest.mark.parametrize(
    ("step", "body", "team"),
    [
        pytest.param(TIE, prism(8, 0.12), {}, marks=pytest.mark.slow),
        pytest.param(TIE, prism(10, 0.12), {}, marks=pytest.mark.slow),
        pytest.param(TIE, {**DRUM, "circle": 0.05, "mass": 0.04}, {}, marks=pytest.mark.slow),
        pytest.param(TIE, {**prism(8, 0.25), "mass": 0.09}, {}, marks=pytest.mark.slow),
        (LESS, DRUM, {"cable_friction": 0.15}),
        (TIE, {**DRUM, "mass": 0.008}, SMALL),
        (TIE, {**prism(4, 0.1), "outline": BOX}, {}),
    ],
    ids=[
        *("level along a side of 8", "level along a side of 10", "a thin light post"),
        *("sides along the cables", "less than legs that lean", "a small team", "sag at corners"),
    ],
)
def test_unusual_bodies_and_teams_are_tied(
    step: dict[str, Any], body: dict[str, Any], team: dict[str, Any]
) -> None:
    assert ho.solve(problem([step], body, **team)).certificate.certified


def test_clasps_that_are_tied_in_place_need_no_time_to_be_drawn() -> None:
    post = {**DRUM, "circle": 0.06, "to": 2.5, "mass": 5.0}
    phases = ho.solve(problem([{"tie": {"around": "drum", "at": 1.2}}], post)).motion.phases
    (drawn,) = (phase for phase in phases if phase.name == "draw")
    assert drawn.end - drawn.start < 2.0


def carried(body: dict[str, Any], **team: Any) -> ho.Plan:
    """An object that is carried by 0.5 m, by drones that are off by up to 5 cm."""
    steps = [{"transport_object": {"object": "drum", "to": [0.9, -0.3, 0.0]}}]
    stated = problem(steps, body, **team)
    return ho.solve(replace(stated, limits=replace(stated.limits, tracking=0.05)))


def random_body(seed: int) -> dict[str, Any]:
    """A circle, box or hexagon, with 0.3 to 0.8 of the mass that two cables hold at 1 N."""
    rng = np.random.default_rng(seed)
    size, aspect, share = rng.uniform(0.12, 0.2), rng.uniform(0.6, 1.0), rng.uniform(0.3, 0.8)
    body = {"to": rng.uniform(0.3, 0.7), "friction": rng.uniform(0.4, 0.7), "mass": 0.1}
    body["yaw_deg"] = rng.uniform(-180.0, 180.0)
    angles = -np.pi * np.arange(6) / 3.0
    hexagon = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    box = np.array([[-1.0, -1.0], [-1.0, 1.0], [1.0, 1.0], [1.0, -1.0]])
    shapes: list[dict[str, Any]] = [{"circle": size}]
    shapes += [{"outline": (size * x * [1.0, aspect]).tolist()} for x in (box, hexagon)]
    body |= shapes[seed % 3]
    stated = problem([TIE], body)
    requirements, solid = stated.teams[""].requirements.with_reserve, stated.objects["drum"]
    clasps = next(grip_clasps("drum", solid, stated.team, requirements))
    grip = Grip.of(solid.section, clasps, 2.4, 1.0)
    capacity = grip_capacity(grip, stated.team.quadrotor[0], solid.friction, 1.5)
    return body | {"mass": share * capacity.mass}


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(6))
def test_random_sections_are_carried(seed: int) -> None:
    assert carried(random_body(seed)).certificate.certified


@pytest.mark.slow
def test_pentagon_hangs_below_the_line_through_its_clasps() -> None:
    """Of the grips around it, that with the most friction would tilt it."""
    assert carried({**prism(5, 0.12), "mass": 0.05}).certificate.certified


@pytest.mark.parametrize(("gap", "stiffness"), [(0.02, -0.375), (0.11, 0.0165)])
def test_crates_keep_their_yaw_or_are_refused(gap: float, stiffness: float, tmp_path: Path) -> None:
    """Between two clasps on the line through its sides' middles, at 1 N; ``verify`` agrees."""
    crate = [[-0.16, -0.13], [-0.16, 0.13], [0.16, 0.13], [0.16, -0.13]]
    stated = problem([TIE], {**prism(4, 0.1), "outline": crate, "mass": 0.02})
    team, body = stated.team, stated.objects["drum"]
    clasps = np.array([[0.16 + gap, 0.0], [-0.16 - gap, 0.0]])
    hold = GripHold.tied(team, body, clasps, 0.3)
    state = GraspState("drum", HoldPolygons(clasps, clasps), team.tension, hold, carried=True)
    planner = MovePlanner(state, replace(stated.teams[""].requirements, objects=stated.objects), 0)
    motion = planner.motion([planner.rest(0.5)])
    check = RULE_OF["yaw"].check(motion)
    assert check is not None
    assert check.worst == pytest.approx(stiffness, rel=0.05)
    assert check.holds == (stiffness > 0.0)
    (row,) = opinion_of(motion, tmp_path, objects.steady)
    assert row.worst == pytest.approx(check.worst, rel=1e-3)
    assert (row.verdict == "proven") == check.holds


def test_cables_that_pull_unequally_press_an_object_toward_the_edge_of_its_foot(
    tmp_path: Path,
) -> None:
    """By the moment of their difference about its foot, over its weight."""
    grip, requirements = tied_grip(problem([TIE]))
    tensions = np.array([1.0, 0.95])
    state = GraspState("drum", HoldPolygons(grip.polygon, grip.polygon), tensions, grip)
    planner = MovePlanner(state, requirements, 0)
    motion = planner.motion([planner.rest(0.5)])
    bent = replace(motion.phases[0], state=CableState.BENT)
    motion = motion.replaced(phases=(bent,))
    wraps = wraps_around(grip.body.section, grip.polygon)
    pulls = tensions[:, None] * (wraps.arriving - wraps.leaving)
    moment = grip.height * float(np.linalg.norm(np.sum(pulls, axis=0)))
    expected = DRUM["circle"] - moment / (DRUM["mass"] * GRAVITY)
    check = RULE_OF["support"].check(motion)
    assert check is not None
    (row,) = (each for each in opinion_of(motion, tmp_path, objects.hinged) if each.samples)
    assert check.worst == pytest.approx(expected, abs=1e-3)
    assert row.worst == pytest.approx(expected, abs=1e-3)


@pytest.mark.parametrize("shift", [0.01, 0.03])
def test_clasps_do_not_balance_an_object_beside_the_line_through_them(
    shift: float, tmp_path: Path
) -> None:
    """They lack its weight's moment, over its radius and their tension."""
    motion = part(cycle().motion, "carry", "carry")
    poses = motion.poses.coefficients.copy()
    poses[:, 0, 0] += shift
    motion = motion.replaced(poses=motion.poses.replaced(poses))
    drum = motion.requirements.objects["drum"]
    lacking = drum.mass * GRAVITY * shift / drum.section.circumradius
    expected = lacking / float(np.min(motion.team.tension))
    check = RULE_OF["equilibrium"].check(motion)
    assert check is not None
    rows = opinion_of(motion, tmp_path, objects.gripped)
    (row,) = (each for each in rows if each.name == "equilibrium")
    assert check.worst == pytest.approx(expected, abs=BALANCE_LIMIT)
    assert row.worst == pytest.approx(expected, abs=BALANCE_LIMIT)


def test_edges_that_turn_a_standing_crate_are_counted() -> None:
    """The force of edges vanishes, their moment does not: they may turn what is light."""
    crate = ho.Section([[-0.16, -0.13], [-0.16, 0.13], [0.16, 0.13], [0.16, -0.13]])
    around = np.array([[0.31, -0.16], [-0.31, 0.16]])
    team = problem([TIE]).team
    body = ho.SolidObject(crate, 0.0, 0.4, mass=0.06, friction=0.5)
    hold = replace(GripHold.tied(team, body, 0.7 * around, 0.3), around=around)
    push = hold.largest_push(np.full(2, 0.5))
    grip = Grip.of(crate, around, 2.4, 0.5)
    assert push >= abs(grip.imbalance[2]) / crate.friction_radius > 0.1
    wide = np.array([[0.3, 0.0], [-0.3, 0.0]])
    assert GripHold.tied(team, body, wide, 0.3).largest_push(np.full(2, 0.5)) < 1e-9


def test_cables_are_untied_so_weakly_that_one_alone_does_not_move_what_stands() -> None:
    """Its pull would tip a cup of 8 g before friction lets it slide."""
    cables = {"robots": 2, "cable_length": 2.4, "cable_density": 0.001, "tension": 0.12}
    cup = {"circle": 0.08, "to": 0.3, "mass": 0.008, "friction": 0.5}
    mission: list[dict[str, Any]] = [{"tie": {"around": "drum", "at": 0.26}}, {"untie": {}}]
    plan = ho.solve(problem(mission, cup, **cables, quadrotor={"mass": 0.0393, "max_thrust": 0.8}))
    assert plan.certificate.certified
    motion = plan.motion
    phases = {phase.name: phase for phase in motion.phases}
    assert phases["straddle"].tension == pytest.approx((0.12, 0.12))
    assert phases["unstraddle"].tension == phases["unroll"].tension
    opened = phases["unroll"].start
    contacts, vertices = motion.contacts.at(opened)[0], motion.vertices.at(opened)
    before, behind = unit(contacts[0] - vertices[0]), unit(vertices[1] - contacts[1])
    pull = float(np.max(motion.tensions.at(opened))) * np.linalg.norm(behind - before)
    tips = cup["mass"] * GRAVITY * cup["circle"] / 0.26
    assert pull == pytest.approx(MAX_PUSH * tips, rel=0.02)
    assert tips < cup["friction"] * cup["mass"] * GRAVITY


def test_cables_are_tied_so_far_out_that_one_alone_can_leave_a_light_object_standing() -> None:
    """The nearest clasps that keep distances would bend a cable more than a cup of 8 g stands."""
    cup = {"circle": 0.08, "to": 0.3, "mass": 0.008, "friction": 0.5}
    stated = problem([TIE], cup, **SMALL)
    grip, requirements = tied_grip(stated)
    planner = find_straddle("drum", grip, Tie("drum").tension_for(stated.team), requirements)
    lowest = lowest_untying_tension(stated.team)
    assert lowest <= MAX_PUSH * planner.path.hold.standing_tension < 1.5 * lowest


@pytest.mark.parametrize("name", ["draw", "loosen"])
def test_cables_do_not_slide_along_an_object_as_they_are_drawn_and_loosened(name: str) -> None:
    """Both would turn it by friction, in the same sense: a cup by 120°, a crate by 26°.

    The length from a contact to the drone at its end changes as much as at the other end.
    """
    drawn = part(cycle().motion, name, name)
    t = np.linspace(0.0, drawn.duration, 40)
    vertices, contacts = drawn.vertices.at(t), drawn.contacts.at(t)
    pairs = drawn.drones.at(t).reshape(contacts.shape)
    clasps = np.stack([vertices, np.roll(vertices, -1, axis=1)], axis=2)
    to_drones = np.linalg.norm(clasps - contacts, axis=-1) + np.linalg.norm(pairs - clasps, axis=-1)
    assert np.all(np.ptp(to_drones, axis=0) > 0.05)
    assert np.all(np.ptp(to_drones[..., 0] - to_drones[..., 1], axis=0) < 2e-3)


def rounded(corners: list[list[float]], radius: float, sides: int) -> list[list[float]]:
    """Clockwise corners, rounded by some sides each."""
    points, outline = np.array(corners), list[list[float]]()
    neighbours = np.roll(points, 1, axis=0), points, np.roll(points, -1, axis=0)
    for before, corner, after in zip(*neighbours, strict=True):
        onward, ahead = ((x - y) / math.dist(x, y) for x, y in ((corner, before), (after, corner)))
        turn = math.acos(float(onward @ ahead))
        angles = math.atan2(onward[0], -onward[1]) - turn * np.arange(sides + 1) / sides
        bisector = (ahead - onward) / math.dist(ahead, onward)
        centre = corner + radius / math.cos(0.5 * turn) * bisector
        round_off = radius * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        outline += (centre + round_off).tolist()
    return outline


OCTAGON = [
    [0.14 * math.cos(-k), 0.14 * math.sin(-k)] for k in math.pi * (0.25 * np.arange(8) + 0.1)
]


@pytest.mark.slow
@pytest.mark.parametrize("radius", [1e-4, 5e-3])
def test_rounded_corners_are_no_sides_that_cables_meet(radius: float) -> None:
    """Cables pass the short sides of rounded corners while they are pitched, as on a disc."""
    body = {**prism(8, 0.1), "outline": rounded(OCTAGON, radius, 4), "mass": 0.05}
    assert ho.solve(problem([TIE], body)).certificate.certified


def test_narrow_outlines_are_refused_before_anything_is_planned() -> None:
    box = [[-0.07, -0.05], [-0.07, 0.05], [0.07, 0.05], [0.07, -0.05]]
    words = r"cable_clearance: 0\.1\d+ m is below the limit of 0\.2 m as cables bend.*circle"
    with pytest.raises(ho.InfeasibleError, match=words):
        carried({**prism(4, 0.1), "outline": box})


def test_an_object_too_heavy_for_the_grip_that_can_be_tied_is_refused_with_why() -> None:
    """The strongest one holds it at its ends, but cables along its sides are too close there."""
    crate = [[-0.2, -0.09], [-0.2, 0.09], [0.2, 0.09], [0.2, -0.09]]
    body = {**prism(4, 0.1), "outline": crate, "mass": 0.1}
    words = (
        r"grip: 0\.7\d+ is below the limit of 1\.5 at drum at rest.*\n?.*strongest grip cannot be "
    )
    with pytest.raises(ho.InfeasibleError, match=words + r"tied: cable_clearance: 0\.17\d+ m is"):
        carried(body)


def test_cables_fly_as_high_as_bounds_on_their_displacements_require() -> None:
    """Bounds of ``tracking_radius`` are larger than displacements at samples, by a millimetre."""
    stated = problem([{"tie": {"around": "drum", "at": 0.35}}], {**DRUM, "mass": 0.008}, **SMALL)
    q, r = ([[x, 0.5, 0.0], [-x, -0.5, 0.0]] for x in (-1.0, 1.0))
    start = ho.DronesStart(*(np.array(each) + AT for each in (q, r)))
    limits = replace(stated.limits, tracking=0.05)
    assert ho.solve(replace(stated, start=start, limits=limits)).certificate.certified


def test_cables_that_meet_sides_as_they_cross_are_refused() -> None:
    """Clasps 2 cm off the middles of two sides; another grip can be tied."""
    stated = problem([TIE], prism(10, 0.3))
    best, requirements = tied_grip(stated)
    middle = 0.306 * np.array([math.cos(math.pi / 10.0), math.sin(math.pi / 10.0)])
    hold = GripHold.tied(stated.team, best.body, np.stack([middle, -middle]), best.height)
    with pytest.raises(ho.InfeasibleError, match=r"continuity.*deg.*longer cables.*circle"):
        find_straddle("drum", hold, np.ones(2), requirements)
    find_straddle("drum", best, np.ones(2), requirements)


@pytest.mark.parametrize(
    ("step", "message"),
    [
        ({"release": {}}, "two robots"),
        ({"enclose": {"object": "drum"}}, "two robots"),
        ({"tie": {"around": "drum", "at": 0.39}}, "0.38"),
        ({"tie": {"around": "drun"}}, r"tie\.around = .*drum"),
        ({"untie": {}}, "no object.* tie, lift"),
    ],
)
def test_steps_that_do_not_fit_are_refused(step: dict[str, Any], message: str) -> None:
    with pytest.raises(ho.InputError, match=message):
        ho.solve(problem([step]))


@pytest.mark.slow
@pytest.mark.parametrize("height", [0.0, 1.0])
@pytest.mark.parametrize("y", [(2.0, 2.8), (0.9, -1.4)])
def test_cables_start_anywhere_also_both_beyond_the_object(
    y: tuple[float, float], height: float
) -> None:
    """They fly over it, each to its side, whichever of their drones are named q."""
    q, r = (np.array([[x, each, height] for each in y]) for x in (1.3, -0.7))
    far = replace(problem([TIE]), start=ho.DronesStart(q, r))
    plan = ho.solve(far)
    assert plan.certificate.certified
    assert plan.motion.phases[-1].state is CableState.HITCHED


@pytest.mark.parametrize("tension", [0.12, 0.2, 1.0])
@pytest.mark.parametrize("density", [0.0015, 0.02])
def test_cables_are_tied_with_no_more_than_the_team_s_tension(
    tension: float, density: float
) -> None:
    team = problem([TIE], tension=tension, cable_density=density).team
    assert np.all(Tie("drum").tension_for(team) <= tension)


@pytest.mark.parametrize("error", [0.0, 0.03, 0.06])
@pytest.mark.parametrize("top", [0.12, 0.25, 0.4, 2.5])
def test_clasps_are_tied_above_the_centre_of_mass_and_below_the_top(
    top: float, error: float
) -> None:
    """By the height with which the object hangs upright in wind, if drones' errors leave it."""
    stated = problem([TIE], {**DRUM, "to": top})
    stated = replace(stated, limits=replace(stated.limits, tracking=error))
    requirements, body = stated.teams[""].requirements, stated.objects["drum"]
    lowest = needed_height(body, requirements)
    height = clasp_height(body, requirements)
    assert min(lowest, top - EDGE) <= height <= top - EDGE
    assert height <= max(lowest, top - error) + 1e-9
    assert height <= max(lowest, 0.5 * top + PREFERRED_HINGE)
    assert top < 1.0 or height == 0.5 * top + PREFERRED_HINGE


def test_fixed_objects_and_those_below_others_are_tied_but_not_lifted() -> None:
    lift = [TIE, {"lift": {"by": 0.1}}]
    with pytest.raises(ho.InputError, match=r"objects\.drum\.fixed = True: must be false"):
        ho.solve(problem(lift, {**DRUM, "fixed": True}))
    whole = problem(lift)
    lid = ho.SolidObject(Section(radius=0.05), 0.0, 0.02, 0.01, 0.5, at=[*AT[:2], 0.4])
    stacked = replace(whole, objects={**whole.objects, "lid": lid})
    with pytest.raises(ho.InputError, match=r"objects\.lid\.at .* must be off objects\.drum"):
        ho.solve(stacked)


@pytest.mark.parametrize("step", [TIE, {"untie": {}}])
def test_three_robots_neither_tie_nor_untie(step: dict[str, Any]) -> None:
    """Whatever way they hold an object."""
    tray = {**DRUM, "rim": {"circle": 0.3, "at": 0.25}}
    team = {"robots": 3, "cable_length": 2.2, "cable_density": 0.01, "tension": 1.0}
    outline = [[0.4, 0.0], [-0.2, -0.35], [-0.2, 0.35]]
    before = [{"enclose": {"object": "drum"}}, {"grasp": {"object": "drum"}}]
    stated = {
        "team": team,
        "objects": {"drum": tray | {"at": [1.2, 0, 0]}},
        "start": {"hitch": {"polygon": outline, "altitude": 1.0}},
        "mission": [*before, step] if "untie" in step else [step],
    }
    with pytest.raises(ho.InputError, match=r"(tie|untie)\.robots = 3: must be 2"):
        ho.solve(ho.problem_from_dict(stated))


PX4: dict[str, Any] = {"mass": 0.25, "max_thrust": 6.0, "controller": "px4"}


def tied_grip(stated: ho.Problem) -> tuple[GripHold, Requirements]:
    """The grip of the drum at the height of ``tie``, and the requirements of planners."""
    requirements = stated.teams[""].requirements.flown_by(stated.team).with_reserve
    body = stated.objects["drum"]
    clasps = next(grip_clasps("drum", body, stated.team, requirements))
    height = clasp_height(body, requirements)
    return GripHold.tied(stated.team, body, clasps, height), requirements


@pytest.mark.parametrize(
    ("kp", "kd", "tension"), [(9.0, 2.5, 1.0), (2.0, 1.2, 1.7), (1.2, 1.0, 1.0)]
)
def test_cables_hang_beside_an_object_with_a_reserve_beyond_their_displacement(
    kp: float, kd: float, tension: float
) -> None:
    """By which drones' errors of position displace them, also cables with ends of two heights."""
    quadrotor = {**PX4, "gains": {"kp": kp, "kd": kd}}
    stated = problem([TIE], {**DRUM, "mass": 0.2}, tension=tension, quadrotor=quadrotor)
    stated = replace(stated, limits=replace(stated.limits, tracking=None))
    grip, requirements = tied_grip(stated)
    error = requirements.position_error
    assert error > 0.07
    tensions = Tie("drum").tension_for(stated.team)
    planner = find_straddle("drum", grip, tensions, requirements)
    drones = planner.hanging.drones
    q, r = drones[0::2], drones[1::2]
    assert np.max(np.abs(r - q)[:, 2]) > 1e-3
    across = (r - q)[:, :2]
    to_centre = np.array(AT[:2]) - q[:, :2]
    sideways = np.abs(across[:, 0] * to_centre[:, 1] - across[:, 1] * to_centre[:, 0])
    distance = sideways / np.linalg.norm(across, axis=1) - DRUM["circle"]
    displacement = Catenary.between(q, r, stated.team.cable_length).extra_displacement(error)
    assert np.min(distance - displacement) >= requirements.separation.object + BESIDE - 1e-9


def test_errors_that_leave_no_room_around_an_object_are_refused() -> None:
    """Also where another distance, of which more is missing from the reserve, keeps its limit."""
    stated = problem([TIE], DRUM, quadrotor=PX4)
    stated = replace(stated, limits=replace(stated.limits, tracking=0.15))
    grip, requirements = tied_grip(stated)
    tensions = Tie("drum").tension_for(stated.team)
    with pytest.raises(ho.InfeasibleError, match="as cables bend around the object and roll"):
        find_straddle("drum", grip, tensions, requirements)


@pytest.mark.parametrize(("friction", "violated"), [(1.2, set()), (0.5, {"grip"})])
def test_carrying_is_slowed_until_two_clasps_balance_the_object(
    friction: float, violated: set[str]
) -> None:
    """However weak they pull; friction that does not suffice at rest slows nothing down."""
    body = {**DRUM, "to": 0.5, "mass": 0.2, "friction": friction}
    stated = problem([TIE], body, quadrotor=PX4)
    grip, requirements = tied_grip(stated)
    polygons = HoldPolygons(grip.polygon, grip.polygon)
    grasp = GraspState("drum", polygons, stated.team.tension, grip, carried=True)
    planner = MovePlanner(grasp, requirements, 0)
    move = planner.carry(planner.body.place + [0.5, 0.0, 0.0, 0.0], 1.0)
    motion = planner.motion([move])
    found = {name for name in ("equilibrium", "grip") if first_violated(motion, [name])}
    assert found == violated


def test_objects_that_slip_are_refused_for_that_alone() -> None:
    """Their forces are out of balance too, which is named only where nothing else is violated."""
    lifted = part(cycle().motion, "lift", "carry")
    drum = lifted.requirements.objects["drum"]
    refused = list[list[Violation]]()
    for friction in (0.1, drum.friction):
        heavy = replace(drum, mass=1.2 * drum.mass, friction=friction)
        requirements = replace(lifted.requirements, objects={"drum": heavy})
        motion = lifted.replaced(requirements=requirements)
        certificate = certify(motion, reports=())
        assert not certificate["equilibrium"].holds
        refused.append(list(infeasible_error(certificate, motion).violations))
    slipping, gripping = refused
    assert [violation.constraint for violation in slipping] == ["grip"]
    assert [violation.constraint for violation in gripping] == ["equilibrium"]
