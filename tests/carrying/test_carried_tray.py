"""A tray carried by three robots: what the certificate says against samples and force balances."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hitchopt as ho
from hitchopt.checks.registry import RULE_OF
from hitchopt.exports.export_options import ExportOptions
from hitchopt.exports.plan_export import export_motion
from hitchopt.hitch import GRAVITY
from hitchopt.motion.motion import Motion
from hitchopt.motion.phases import Hold, HoldBy
from hitchopt.objects.placing import in_frame
from hitchopt.planners.carrying.held_motion import GENTLE
from hitchopt.stopping.abort import Aborts
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array

MASS = 0.2
TO = [-0.3, 0.9, 0.1]


def tray(**changes: Any) -> dict[str, Any]:
    """A tray off the origin, to be set down on a low table, turned."""
    held = {"circle": 0.1, "to": 0.3, "mass": MASS, "at": [1.1, 0.2, 0.0], "yaw_deg": 20.0}
    held["rim"] = {"circle": 0.3, "at": 0.25}
    table = {"circle": 0.3, "to": 0.1, "at": [*TO[:2], 0.0], "fixed": True}
    given: dict[str, Any] = {
        "team": {"robots": 3, "cable_length": 2.2, "tension": 0.8, "cable_density": 0.004},
        "limits": {"tilt_deg": 60},
        "objects": {"tray": {**held, **changes}, "table": table},
        "start": {
            "hitch": {"polygon": [[1.5, 0.2], [0.9, -0.1], [0.9, 0.5]], "altitude": 0.9},
        },
    }
    step = {"object": "tray", "to": TO, "tension": 1.0, "yaw_deg": 40.0, "lift": 0.1}
    given["mission"] = [{"transport_object": step}]
    return given


@pytest.fixture(scope="module")
def motion() -> Motion:
    plan = ho.solve(ho.problem_from_dict(tray()))
    assert plan.certificate.certified
    return plan.motion


def lifted(motion: Motion) -> Array:
    """Times at which the tray is off its supports."""
    lift, down = (next(p for p in motion.phases if p.name == n) for n in ("lift", "set_down"))
    return np.linspace(lift.start + 1.6, down.end - 1.6, 301)


def test_the_tray_ends_where_it_was_sent(motion: Motion) -> None:
    states = ho.solve(ho.problem_from_dict(tray())).at(motion.duration)
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


@pytest.mark.slow
def test_legs_that_lean_as_if_the_weight_hung_at_clasps_are_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Simulated ones drag their clasps outward: T cos(slope) is not what such legs pull with."""
    place = "hitchopt.planners.carrying.held_motion.strut_share"
    monkeypatch.setattr(place, lambda *_: np.zeros(()))
    with pytest.raises(ho.InfeasibleError) as refusal:
        ho.solve(ho.problem_from_dict(tray()))
    assert {each.constraint for each in refusal.value.violations} == {"equilibrium"}


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


def test_cables_that_run_level_below_the_rim_are_as_long_as_they_are(motion: Motion) -> None:
    """Legs run level from the clasp to the rim's edge and rise there; straight ones are longer."""
    t, layout = lifted(motion), motion.team.layout
    pushed = np.linalg.norm(motion.object_poses.differentiated(2).at(t)[:, 0, :3], axis=-1)
    t = t[pushed < 0.01]
    poses = motion.object_poses.at(t)[:, None, 0]
    clasps = in_frame(poses, motion.vertices.at(t))
    clasps[..., 2] = 0.25
    start, end = clasps[:, layout.anchors], in_frame(poses, motion.drones.at(t))
    along = (end - start)[..., :2]
    along /= np.linalg.norm(along, axis=-1, keepdims=True)
    inward = np.sum(start[..., :2] * along, axis=-1)
    level = np.sqrt(inward**2 - np.sum(start[..., :2] ** 2, axis=-1) + 0.3**2) - inward
    bend = start.copy()
    bend[..., :2] += level[..., None] * along
    legs = level + np.linalg.norm(end - bend, axis=-1)
    edges = np.linalg.norm(layout.edges(clasps), axis=-1)
    lengths = legs[:, 0::2] + edges + legs[:, 1::2]
    np.testing.assert_allclose(lengths, 2.2, atol=1e-3)


@pytest.mark.slow
def test_straight_legs_of_a_bent_cable_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    place = "hitchopt.planners.carrying.held_motion.rim_savings"
    monkeypatch.setattr(place, lambda *_: np.zeros(()))
    with pytest.raises(ho.InfeasibleError) as refusal:
        ho.solve(ho.problem_from_dict(tray()))
    assert {each.constraint for each in refusal.value.violations} == {"cable_length"}


def test_vertices_at_the_rim_itself_do_not_bear(monkeypatch: pytest.MonkeyPatch) -> None:
    place = "hitchopt.planners.carrying.held_motion.rim_drop"
    monkeypatch.setattr(place, lambda *_: np.zeros(()))
    with pytest.raises(ho.InfeasibleError) as refusal:
        ho.solve(ho.problem_from_dict(tray()))
    assert {each.constraint for each in refusal.value.violations} == {"support"}


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


def test_shares_differ_from_one_by_more_than_rounding(motion: Motion) -> None:
    assert motion.borne is not None
    rounded = replace(motion, borne=shares(motion, 1.0 - 1e-15)).object_shares.coefficients
    whole = motion.borne.coefficients == 1.0
    assert np.any(whole)
    np.testing.assert_array_equal(rounded[whole], 1.0)
    less = replace(motion, borne=shares(motion, 1.0 - 1e-9)).object_shares.coefficients
    assert np.all(less[whole] < 1.0)


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


def test_legs_that_just_keep_apart_without_a_load_are_moved_on() -> None:
    """A weight on the clasps brings q1 and r1 nearer by 0.01 %."""
    sides = np.array([[-1.0, -0.9], [1.0, -0.9], [1.0, 0.9], [-1.0, 0.9]])
    box: dict[str, Any] = {"to": 0.25, "mass": 0.1, "at": [2.34, 2.09, 0.5]}
    box["outline"] = (0.084 * sides).tolist()
    box["rim"] = {"outline": (0.156 * np.array([1.0, 1.06]) * sides).tolist(), "at": 0.2}
    plan = ho.solve(
        ho.problem_from_dict(
            {
                "team": {"robots": 4, "cable_length": 1.4, "tension": 0.8},
                "limits": {"tilt_deg": 60},
                "objects": {
                    "box": box,
                    "table": {"circle": 0.6, "to": 0.5, "at": [2.34, 2.09, 0.0], "fixed": True},
                },
                "start": {
                    "hitch": {
                        "polygon": [[2.087, 2.318], [2.568, 2.343], [2.593, 1.862], [2.112, 1.837]],
                        "altitude": 1.59,
                    }
                },
                "mission": [{"transport_object": {"object": "box", "to": [-0.22, -0.08, 0.0]}}],
            }
        )
    )
    assert plan.certificate.certified
    assert plan.certificate["separation"].worst == pytest.approx(1.0, abs=0.05)


def refused(problem: dict[str, Any], text: str) -> None:
    with pytest.raises(ho.HitchoptError, match=re.escape(text)):
        ho.solve(ho.problem_from_dict(problem))


def test_too_heavy_an_object_is_refused_with_what_to_change() -> None:
    refused(tray(mass=0.6), "lower objects.tray.mass to 0.")
    refused(tray(mass=0.6), "load binds")


def test_a_narrow_rim_is_refused() -> None:
    refused(tray(rim={"circle": 0.12, "at": 0.25}), "give objects.tray a wider rim")


@pytest.mark.parametrize(
    ("steps", "text"),
    [
        ([{"lift": {"by": 0.2}}], "must be one holding an object that stands"),
        ([{"enclose": {"object": "tr"}}], "must be one of objects: tray, table"),
        (
            [{"enclose": {"object": "tray"}}, {"leave": {"object": "tray"}}]
            + [{"move_vertex": {"vertex": 0, "by": [0.1, 0]}}],
            "morph before",
        ),
        ([{"enclose": {"object": "table"}}], "false where it is held"),
        ([{"grasp": {"object": "tray", "tension": -1}}], "greater than"),
    ],
)
def test_steps_in_a_wrong_order_are_refused(steps: list[dict[str, Any]], text: str) -> None:
    refused({**tray(), "mission": steps}, text)


def test_refusals_name_the_step_that_the_file_has() -> None:
    low = tray() | {"arena": {"lower": [-3, -3, 0], "upper": [3, 3, 0.53]}}
    low["start"]["hitch"]["altitude"] = 0.5
    low["mission"] = [{"enclose": {"object": "tray"}}]
    with pytest.raises(ho.InfeasibleError, match=r"at the end of step 0 \(enclose\)"):
        ho.solve(ho.problem_from_dict(low))


def test_six_hold_a_tray_by_rolled_legs_that_cross() -> None:
    """Legs of one cable pass each other; with a load they would touch at the least roll."""
    x, y = 0.3, -0.2
    angles = -2.0 * np.pi * np.arange(6) / 6
    polygon = np.column_stack([x + 0.45 * np.cos(angles), y + 0.45 * np.sin(angles)])
    body = {"circle": 0.1, "to": 0.3, "mass": MASS, "rim": {"circle": 0.3, "at": 0.25}}
    steps = ("enclose", "grasp", "set_down", "loosen", "leave")
    mission: list[dict[str, Any]] = [{name: {"object": "tray"}} for name in steps]
    mission.insert(2, {"lift": {"by": 0.1}})
    problem = {
        "team": {"robots": 6, "cable_length": 1.4, "tension": 1.0, "cable_density": 0.01},
        "limits": {"tilt_deg": 60},
        "objects": {"tray": {**body, "at": [x, y, 0.0]}},
        "start": {"hitch": {"polygon": polygon.tolist(), "altitude": 0.8}},
        "mission": mission,
    }
    plan = ho.solve(ho.problem_from_dict(problem))
    assert plan.certificate.certified
    t = lifted(plan.motion)
    p, drones = plan.motion.vertices.at(t), plan.motion.drones.at(t)
    legs = drones - p[:, plan.motion.team.layout.anchors]
    rise = legs[..., 2] / np.linalg.norm(legs, axis=-1)
    assert np.all(np.abs(rise[:, 0::2] - rise[:, 1::2]) > 0.05)
    shares = np.linspace(0.0, 1.0, 201)[:, None]
    for k in range(6):
        one = p[150, k] + shares * legs[150, 2 * k]
        other = p[150, (k + 1) % 6] + shares * legs[150, 2 * k + 1]
        gaps = np.linalg.norm(one[:, None] - other[None], axis=-1)
        assert np.min(gaps) > 0.05


def test_a_plan_with_a_load_is_not_stretched_far(motion: Motion, tmp_path: Path) -> None:
    options = ExportOptions(format="csv", stretch=2.0)
    with pytest.raises(ho.InfeasibleError, match="inertia of what is carried") as caught:
        export_motion(motion, "tray", options, tmp_path / "out")
    assert caught.value.violations[0].constraint == "equilibrium"
    assert not (tmp_path / "out").exists()
