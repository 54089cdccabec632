"""Objects on clasps: what the certificate says against samples and force balances; flat trays."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from carried_plans import MASS, TO, lifted, plan, tray

import hitchopt as ho
from hitchopt.checks.registry import RULE_OF
from hitchopt.exports.exporting import export_motion
from hitchopt.exports.options import ExportOptions
from hitchopt.hitch import GRAVITY
from hitchopt.hitch.hitch import cable_slack
from hitchopt.live.abort import Aborts
from hitchopt.mission.loading import any_problem_from_dict
from hitchopt.motion.motion import Hold, HoldBy, Motion
from hitchopt.objects import SolidObject
from hitchopt.objects.placing import in_frame
from hitchopt.planners.carrying.rest import GENTLE, STRETCHES, HeldHitch, HoldPolygons
from hitchopt.storage.yaml_file import parse_yaml
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array


@pytest.fixture(scope="module")
def motion() -> Motion:
    return plan("tray").motion


def test_the_tray_ends_where_it_was_sent(motion: Motion) -> None:
    states = plan("tray").at(motion.duration)
    np.testing.assert_allclose(states.object_poses[0, :3], TO, atol=1e-9)
    yaw = np.degrees(np.arctan2(states.object_poses[0, 4], states.object_poses[0, 3]))
    assert yaw == pytest.approx(60.0)
    assert states.borne[0] == 0.0


def test_cables_carry_weight_and_inertia(motion: Motion) -> None:
    """The cables' forces on clasps, from the drones alone, add up to what moves the tray."""
    t = lifted(motion)
    p, drones, tensions = motion.vertices.at(t), motion.drones.at(t), motion.tensions.at(t)
    layout, team = motion.team.layout, motion.team
    legs = drones - p[:, layout.anchors]
    legs /= np.linalg.norm(legs, axis=-1, keepdims=True)
    pulls = np.repeat(tensions, 2, axis=1)[..., None] * legs
    on_clasps = pulls[:, 2 * layout.ahead] + pulls[:, 2 * layout.behind + 1]
    edges = layout.edges(p)
    edges /= np.linalg.norm(edges, axis=-1, keepdims=True)
    on_clasps += tensions[:, layout.ahead, None] * edges[:, layout.ahead]
    on_clasps -= tensions[:, layout.behind, None] * edges[:, layout.behind]
    a = motion.object_poses.differentiated(2).at(t)[:, 0, :3]
    wanted = MASS * (a + [0.0, 0.0, GRAVITY])
    cables = team.cable_density * GRAVITY * float(np.sum(team.cable_length))
    found = np.sum(on_clasps, axis=1)
    np.testing.assert_allclose(found[:, :2], wanted[:, :2], atol=0.01)
    extra = found[:, 2] - wanted[:, 2]  # of cables, half of the legs being on the drones
    assert np.all((extra > 0.2 * cables) & (extra < cables))
    centre = motion.object_poses.at(t)[:, 0, :3] + [0.0, 0.0, 0.15]
    moments = np.sum(np.cross(p - centre[:, None], on_clasps), axis=1)
    assert np.max(np.abs(moments[:, :2])) < 0.01


def test_legs_below_a_rim_pull_level_with_all_of_their_tension(motion: Motion) -> None:
    """A cable that slides over the rim's edge has one tension on both sides of it.

    What the rim takes is that of the weight, so only while the tray hardly accelerates.
    """
    t = lifted(motion)
    pushed = np.linalg.norm(motion.object_poses.differentiated(2).at(t)[:, 0, :3], axis=-1)
    t = t[pushed < 0.01]
    assert len(t) > 20
    p, drones, tensions = motion.vertices.at(t), motion.drones.at(t), motion.tensions.at(t)
    layout = motion.team.layout
    legs, edges = (drones - p[:, layout.anchors])[..., :2], layout.edges(p)[..., :2]
    legs /= np.linalg.norm(legs, axis=-1, keepdims=True)
    edges /= np.linalg.norm(edges, axis=-1, keepdims=True)
    T = tensions[..., None]
    level = (T * (legs[:, 0::2] + edges))[:, layout.ahead]
    level = level + (T * (legs[:, 1::2] - edges))[:, layout.behind]
    np.testing.assert_allclose(level, 0.0, atol=2e-3)


@pytest.mark.parametrize(
    ("left_out", "broken"),
    [
        pytest.param("strut_share", "equilibrium", marks=pytest.mark.slow),  # T cos(slope) is more
        pytest.param("rim_savings", "cable_length", marks=pytest.mark.slow),  # straight legs
        ("rim_drop", "support"),  # vertices at the rim itself
    ],
)
def test_a_planner_that_leaves_out_what_the_rim_does_is_refused(
    left_out: str, broken: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = f"hitchopt.planners.carrying.rest.{left_out}"
    monkeypatch.setattr(place, lambda *_: np.zeros(()))
    with pytest.raises(ho.InfeasibleError) as refusal:
        ho.solve(ho.problem_from_dict(tray()))
    assert {each.constraint for each in refusal.value.violations} == {broken}


def test_the_rim_lies_on_straight_legs(motion: Motion) -> None:
    """Legs pass the rim's edge as high as it is; simulated ones do within millimetres."""
    t = lifted(motion)
    pushed = np.linalg.norm(motion.object_poses.differentiated(2).at(t)[:, 0, :3], axis=-1)
    t = t[pushed < 0.01]
    poses, p = motion.object_poses.at(t)[:, None, 0], motion.vertices.at(t)
    start = in_frame(poses, p[:, motion.team.layout.anchors])
    along = in_frame(poses, motion.drones.at(t)) - start
    a = np.sum(along[..., :2] ** 2, axis=-1)
    b = np.sum(along[..., :2] * start[..., :2], axis=-1)
    c = np.sum(start[..., :2] ** 2, axis=-1) - 0.3**2
    heights = start[..., 2] + (np.sqrt(b**2 - a * c) - b) / a * along[..., 2]
    np.testing.assert_allclose(heights, 0.25, atol=2e-3)
    assert np.max(start[..., 2]) < 0.25 - 0.01


def test_what_rests_on_clasps_is_carried_gently(motion: Motion) -> None:
    """Simulated clasps without friction slide on a rim at 1 m/s²."""
    t = lifted(motion)
    a = motion.object_poses.differentiated(2).at(t)[:, 0, :2]
    largest = float(np.max(np.linalg.norm(a, axis=-1)))
    assert 0.5 * GENTLE < largest <= GENTLE + 1e-6


def test_support_is_below_the_force_line(motion: Motion) -> None:
    check = RULE_OF["support"].check(motion)
    assert check is not None
    t = lifted(motion)
    poses = motion.object_poses.at(t)[:, 0]
    a = motion.object_poses.differentiated(2).at(t)[:, 0, :3]
    p = motion.vertices.at(t)
    height = (poses[:, 2] + 0.15 - p[:, 0, 2])[:, None]
    foot = poses[:, :2] - height * a[:, :2] / (GRAVITY + a[:, 2:])
    onward = (np.roll(p, -1, axis=1) - p)[..., :2]
    inward = np.stack([onward[..., 1], -onward[..., 0]], axis=-1)
    inward /= np.linalg.norm(inward, axis=-1, keepdims=True)
    apart = np.sum(inward * (foot[:, None] - p[..., :2]), axis=-1)
    assert check.bound <= float(np.min(apart)) + 1e-9
    assert check.bound >= float(np.min(apart)) - 2e-3


def test_distances_are_below_all_samples(motion: Motion) -> None:
    t = np.linspace(0.0, motion.duration, 2000)
    poses, drones = motion.object_poses.at(t), motion.drones.at(t)
    nearest = np.inf
    for i, body in enumerate(motion.requirements.objects.values()):
        seen = in_frame(poses[:, None, i], drones)
        nearest = min(nearest, *(float(np.min(s.clearance(seen).distance)) for s in body.slabs))
    check = RULE_OF["keep_out"].check(motion)
    assert check is not None
    assert nearest - 2e-3 <= check.bound <= nearest


def shares(motion: Motion, value: float) -> PiecewisePolynomial:
    assert motion.borne is not None
    return PiecewisePolynomial(motion.borne.breaks, value * motion.borne.coefficients)


def test_stops_after_the_tray_was_carried_are_certified(motion: Motion) -> None:
    """A stop joins polynomials of other degrees, which must not round what is borne as a whole."""
    leave = motion.phases[-1]
    assert leave.name == "leave"
    held = Aborts(motion).found(leave.start + 0.3, "hold")
    assert held.start < leave.start + 0.8
    assert held.rest < motion.duration - 0.1


@pytest.mark.parametrize("kind", ["half borne", "not borne", "not held", "elsewhere", "apart"])
def test_what_contradicts_the_polynomials_is_refused(motion: Motion, kind: str) -> None:
    changed = motion
    assert motion.poses is not None
    if kind == "half borne":
        changed = replace(motion, borne=shares(motion, 0.5))
    elif kind == "not borne":
        changed = replace(motion, borne=None)
    elif kind == "not held":
        changed = replace(motion, phases=tuple(replace(p, hold=None) for p in motion.phases))
    elif kind == "elsewhere":
        moved = motion.poses.coefficients + np.array([0.2, 0, 0, 0, 0])[:, None]
        changed = replace(motion, poses=PiecewisePolynomial(motion.poses.breaks, moved))
    else:
        raised = motion.poses.coefficients + np.array([0, 0, 0.01, 0, 0])[:, None]
        changed = replace(motion, poses=PiecewisePolynomial(motion.poses.breaks, raised))
    check = RULE_OF["support"].check(changed)
    assert check is not None
    assert not check.holds


@pytest.mark.parametrize("by", list(HoldBy))
@pytest.mark.parametrize("rim", [False, True])
def test_a_claimed_hold_lets_no_cable_through_an_object(by: HoldBy, rim: bool) -> None:
    """A hitch that flies across a pole cuts it, whatever its phase says that it holds."""
    team = ho.Team(3, 2.4)
    start = ho.Hitch.spread(team, ho.regular_polygon(3, 0.9), altitude=1.0)
    flight = ho.transport(start, [3.0, 0.0, 1.0]).motion
    top = ho.Rim(ho.Section(radius=2.0), 1.2) if rim else None
    pole = ho.SolidObject(ho.Section(radius=0.08), 0.0, 1.5, at=[1.5, 0.0, 0.0], rim=top)
    held = tuple(replace(p, hold=Hold("pole", by, (0, 1, 2))) for p in flight.phases)
    requirements = replace(flight.requirements, objects={"pole": pole})
    check = RULE_OF["object_clearance"].check(
        replace(flight, phases=held, requirements=requirements)
    )
    assert check is not None
    assert not check.holds


@pytest.mark.parametrize(
    ("x", "rim", "holds"), [(0.0, 1.4, True), (0.0, 1.1, False), (5.0, 1.4, False)]
)
def test_clasps_of_a_hold_by_rest_are_below_the_rim_and_around(
    x: float, rim: float, holds: bool
) -> None:
    """Clasps that rise from 1 m to 1.3 m may claim a pole between them with a rim above."""
    start = ho.Hitch.spread(ho.Team(3, 2.4), ho.regular_polygon(3, 0.9), altitude=1.0)
    flight = ho.transport(start, [0.0, 0.0, 1.3]).motion
    top = ho.Rim(ho.Section(radius=0.5), rim)
    pole = ho.SolidObject(ho.Section(radius=0.08), 0.0, 1.5, at=[x, 0.0, 0.0], rim=top)
    held = tuple(replace(p, hold=Hold("pole", HoldBy.REST, (0, 1, 2))) for p in flight.phases)
    requirements = replace(flight.requirements, objects={"pole": pole})
    changed = replace(flight, phases=held, requirements=requirements)
    for name, passes in (("support", holds), ("object_clearance", True)):
        check = RULE_OF[name].check(changed)
        assert check is None or check.holds == passes


def test_equilibrium_counts_what_is_carried(motion: Motion) -> None:
    objects = dict(motion.requirements.objects)
    objects["tray"] = replace(objects["tray"], mass=1.1 * MASS)
    requirements = replace(motion.requirements, objects=objects)
    check = RULE_OF["equilibrium"].check(replace(motion, requirements=requirements))
    assert check is not None
    assert not check.holds


def test_a_plan_with_a_load_is_not_stretched_far(motion: Motion, tmp_path: Path) -> None:
    options = ExportOptions(format="csv", stretch=2.0)
    with pytest.raises(ho.InfeasibleError, match="inertia of what is carried") as caught:
        export_motion(motion, "tray", options, tmp_path / "out")
    assert caught.value.violations[0].constraint == "equilibrium"
    assert not (tmp_path / "out").exists()


FILE = Path(__file__).parents[2] / "problems" / "carry_tray.yaml"


def on_a_pillar(**objects: Any) -> dict[str, Any]:
    """Return the problem of the collection with some keys of its objects changed."""
    given: Any = parse_yaml(FILE.read_text(), FILE.name)
    for name, keys in objects.items():
        given["objects"][name] |= keys
    return given  # type: ignore[no-any-return]


@pytest.fixture(scope="module")
def flat() -> ho.Plan:
    return ho.solve(FILE)


def test_a_flat_tray_is_carried_from_below(flat: ho.Plan) -> None:
    assert flat.certificate.certified
    motion = flat.motion
    names = list(motion.requirements.objects)
    lift = next(phase for phase in motion.phases if phase.name == "carry")
    times = np.linspace(lift.start, lift.end, 40)
    there = flat.at(times)
    underside = there.object_poses[:, names.index("tray"), 2]
    assert np.all(there.vertices[..., 2] <= underside[:, None] + 1e-6)
    level = there.vertices[..., :2] - there.object_poses[:, None, names.index("tray"), :2]
    assert np.all(np.linalg.norm(level, axis=-1) < 0.33)
    end = flat.at(flat.duration).object_poses[names.index("tray"), :3]
    assert end == pytest.approx([0.2, 1.8, 0.5], abs=1e-6)


def test_cables_keep_off_the_pillar(flat: ho.Plan) -> None:
    """By samples of edges, the pillar standing upright: level distances to its axis."""
    grasp, lift = (
        next(phase for phase in flat.phases if phase.name == name) for name in ("grasp", "lift")
    )
    vertices = flat.at(np.linspace(grasp.start, lift.start + 2.0, 200)).vertices
    starts, along = vertices[..., :2], np.roll(vertices, -1, axis=1)[..., :2] - vertices[..., :2]
    to = np.array([1.5, 0.0]) - starts
    share = np.clip(np.sum(to * along, -1) / np.sum(along * along, -1), 0.0, 1.0)
    apart = np.linalg.norm(to - share[..., None] * along, axis=-1) - 0.06
    worst = flat.certificate["object_clearance"].worst
    assert worst is not None
    assert float(np.min(apart)) >= worst - 1e-9
    assert worst >= 0.035


@pytest.mark.parametrize(
    ("name", "radius"), [("pillar", 0.3), pytest.param("stand", 0.31, marks=pytest.mark.slow)]
)
def test_what_is_in_the_way_is_refused_by_its_name(name: str, radius: float) -> None:
    with pytest.raises(ho.InfeasibleError) as caught:
        ho.solve(any_problem_from_dict(on_a_pillar(**{name: {"circle": radius}})))
    broken = caught.value.violations[0]
    assert broken.constraint == "object_clearance"
    assert name in broken.where
    assert (broken.value, broken.limit) == (0.0, 0.035)


@pytest.mark.parametrize("height", [-0.01, 0.06])
def test_a_rim_is_on_its_body(height: float) -> None:
    rim = ho.Rim(ho.Section(radius=0.33), height)
    with pytest.raises(ho.InputError, match=r"from the body's floor, 0 m, to its ceiling, 0\.05 m"):
        ho.SolidObject(ho.Section(radius=0.33), 0.0, 0.05, rim=rim)


GAP = 0.08
BOX = ho.Section(outline=np.array([[-0.2, -0.15], [-0.2, 0.15], [0.2, 0.15], [0.2, -0.15]]))
DISC = ho.Section(radius=0.2)
CENTRE = np.zeros(2)


def ring(n: int, x: float, y: float, turn: float = 0.0) -> Array:
    """Return a clockwise polygon (n, 2) [m] on an ellipse."""
    angles = turn - 2.0 * np.pi * np.arange(n) / n
    return np.column_stack([x * np.cos(angles), y * np.sin(angles)])


def edge_lengths(polygon: Array) -> Array:
    lengths: Array = np.linalg.norm(np.roll(polygon, -1, axis=0) - polygon, axis=1)
    return lengths


@pytest.mark.parametrize(
    ("section", "closed"),
    [(BOX, ring(4, 0.356, 0.171)), (DISC, ring(3, 0.22, 0.22)), (BOX, ring(3, 0.4, 0.45, 0.3))],
)
def test_edges_around_keep_off_and_are_short(section: ho.Section, closed: Array) -> None:
    sections = (section,)
    short = HoldPolygons.about(closed, CENTRE, sections, GAP, STRETCHES).around
    alike = HoldPolygons.about(closed, CENTRE, sections, GAP).around
    for around in (short, alike):
        gaps = section.segment_distance(around, np.roll(around, -1, axis=0))
        assert np.min(gaps) == pytest.approx(GAP, abs=1e-9)
    assert np.max(edge_lengths(short)) <= np.max(edge_lengths(alike)) * (1.0 + 1e-12)


@pytest.mark.slow
def test_a_flat_grip_has_a_nearly_square_hitch_around_it() -> None:
    """The shortest rhombus around a box, by a search over its half diagonals a and b.

    Its edges are ``GAP`` from the corners where ``a b - x b - y a = GAP hypot(a, b)``.
    """
    closed = ring(4, 0.356, 0.171)
    found = HoldPolygons.about(closed, CENTRE, (BOX,), GAP, STRETCHES).around
    a = np.linspace(0.3, 0.9, 6001)
    b = np.linspace(0.2, 0.9, 7001)[:, None]
    off = (a * b - 0.2 * b - 0.15 * a) / np.hypot(a, b)
    shortest = float(np.min(np.hypot(a, b), where=off >= GAP, initial=math.inf))
    assert np.max(edge_lengths(found)) == pytest.approx(shortest, rel=2e-3)
    assert np.max(edge_lengths(HoldPolygons.about(closed, CENTRE, (BOX,), GAP).around)) > 0.77


def below_a_rim(roll: float) -> tuple[HeldHitch, ho.Hitch]:
    """Return a hitch of six below a rim, and the one that it closes from."""
    team = ho.Team(robots=6, cable_length=1.4, tension=1.0, cable_density=0.01)
    polygon = ring(6, 0.26, 0.26)
    legs = 0.4 * cable_slack(team, ho.ConvexPolygon(polygon))
    hitch = ho.Hitch(team, polygon, 0.25, legs, roll)
    rim = ho.Rim(ho.Section(radius=0.3), 0.25)
    tray = SolidObject(ho.Section(radius=0.1), 0.0, 0.3, 0.2, rim=rim)
    places = np.column_stack([polygon, np.full(6, 0.25)])
    return HeldHitch(team, tray, places, hitch.fractions, hitch.roll), hitch


@pytest.mark.parametrize("roll", [0.0, 0.15, -0.2])
def test_legs_below_a_rim_are_those_that_they_were_before(roll: float) -> None:
    held, hitch = below_a_rim(roll)
    drones, _ = held.drones(held.team.tension, np.zeros((6, 3)))
    np.testing.assert_allclose(drones, hitch.drones, atol=1e-9)


@pytest.mark.parametrize("taken", [None, 0.03, 0.1])
@pytest.mark.parametrize("roll", [0.0, 0.15, -0.2])
def test_rolled_legs_carry_what_lies_on_clasps(roll: float, taken: float | None) -> None:
    """Legs and edges balance the weight at every clasp; directions from the drones alone.

    A rim takes a share of what edges pull with, and nothing of what legs do.
    """
    held, _ = below_a_rim(roll)
    light = ho.Team(robots=6, cable_length=1.4, tension=1.0)
    held = HeldHitch(light, held.body, held.places, held.fractions, held.roll)
    weight = np.array([0.0, 0.0, -0.2 * 9.81 / 6.0])
    share = None if taken is None else np.array(taken)
    drones, _ = held.drones(light.tension, np.tile(weight, (6, 1)), share)
    q = drones[0::2] - held.places
    r = np.roll(drones[1::2], 1, axis=0) - held.places
    onward = np.roll(held.places, -1, axis=0) - held.places
    pulls = [each / np.linalg.norm(each, axis=1, keepdims=True) for each in (q, r, onward)]
    pulls[2] *= 1.0 - (taken or 0.0)
    force = pulls[0] + pulls[1] + pulls[2] - np.roll(pulls[2], 1, axis=0)
    np.testing.assert_allclose(force + weight, 0.0, atol=1e-9)
