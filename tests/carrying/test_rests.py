"""Objects on clasps: what the certificate says against samples and force balances; flat trays."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

import hitchopt as ho
from hitchopt.carrying.holds import MAX_REST_ACCELERATION
from hitchopt.checks.certifying import certify, merged
from hitchopt.checks.registry import RULE_OF
from hitchopt.hitch import GRAVITY
from hitchopt.mission.loading import problem_from_dict
from hitchopt.motion.motion import HoldBy, Motion, PhaseHold
from hitchopt.motion.retiming import cut
from hitchopt.objects.placing import in_frame
from hitchopt.storage.yaml_file import read_yaml
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.values import Array
from tests.helpers.carried_plans import MASS, TO, check, lifted, moved, plan, slipped, with_body
from tests.helpers.clasp_balance import unit
from tests.helpers.plans import PROBLEMS, planned


@pytest.fixture(scope="module")
def motion() -> Motion:
    return plan("tray").motion


def accelerations(motion: Motion, t: Array) -> Array:
    found: Array = motion.poses.differentiated(2).at(t)[:, 0, :3]
    return found


def pulls_of(motion: Motion, t: Array, directions: int = 3) -> Array:
    """Forces (times, n, directions) [N] of cables on clasps, all of the tension in them."""
    layout, p, T = motion.team.layout, motion.vertices.at(t), motion.tensions.at(t)[..., None]
    legs = unit((motion.drones.at(t) - p[:, layout.anchors])[..., :directions])
    edges = unit(layout.edges(p)[..., :directions])
    leaving, arriving = T * (legs[:, 0::2] + edges), T * (legs[:, 1::2] - edges)
    found: Array = leaving[:, layout.ahead] + arriving[:, layout.behind]
    return found


def test_the_tray_ends_at_its_goal(motion: Motion) -> None:
    pose = motion.poses.at(motion.duration)[0]
    angle = np.radians(60.0)
    np.testing.assert_allclose(pose, [*TO, np.cos(angle), np.sin(angle)], atol=1e-9)
    assert motion.load_share.at(motion.duration)[0] == 0.0


def test_cables_carry_weight_and_inertia_gently(motion: Motion) -> None:
    """The cables' forces on clasps, from the drones alone, add up to what moves the tray.

    Simulated clasps without friction slide on a rim at 1 m/s².
    """
    t = lifted(motion)
    p, a, team = motion.vertices.at(t), accelerations(motion, t), motion.team
    on_clasps = pulls_of(motion, t)
    wanted = MASS * (a + [0.0, 0.0, GRAVITY])
    cables = team.cable_density * GRAVITY * float(np.sum(team.cable_length))
    found = np.sum(on_clasps, axis=1)
    np.testing.assert_allclose(found[:, :2], wanted[:, :2], atol=0.01)
    extra = found[:, 2] - wanted[:, 2]  # of cables, half of the legs being on the drones
    assert np.all((extra > 0.2 * cables) & (extra < cables))
    centre = motion.poses.at(t)[:, 0, :3] + [0.0, 0.0, 0.15]
    moments = np.sum(np.cross(p - centre[:, None], on_clasps), axis=1)
    assert np.max(np.abs(moments[:, :2])) < 0.01
    level = np.max(np.linalg.norm(a[:, :2], axis=-1)) / MAX_REST_ACCELERATION
    assert 0.5 < level <= 1.0 + 1e-6


def test_legs_pass_the_rims_edge_and_pull_level_with_all_their_tension(motion: Motion) -> None:
    """A cable that slides over the rim's edge has one tension on both sides of it.

    What the rim takes is that of the weight, so only while the tray hardly accelerates. Simulated
    legs pass the edge as high as it is within millimetres.
    """
    t = lifted(motion)
    t = t[np.linalg.norm(accelerations(motion, t), axis=-1) < 0.01]
    assert len(t) > 20
    np.testing.assert_allclose(pulls_of(motion, t, 2), 0.0, atol=2e-3)
    poses, p = motion.poses.at(t)[:, None, 0], motion.vertices.at(t)
    start = in_frame(poses, p[:, motion.team.layout.anchors])
    along = in_frame(poses, motion.drones.at(t)) - start
    a = np.sum(along[..., :2] ** 2, axis=-1)
    b = np.sum(along[..., :2] * start[..., :2], axis=-1)
    c = np.sum(start[..., :2] ** 2, axis=-1) - 0.3**2
    heights = start[..., 2] + (np.sqrt(b**2 - a * c) - b) / a * along[..., 2]
    np.testing.assert_allclose(heights, 0.25, atol=2e-3)
    assert np.max(start[..., 2]) < 0.25 - 0.01


def carried(motion: Motion, pushed: list[float]) -> Motion:
    """The flight with the tray, all of it accelerated [m/s²] besides."""
    carry = next(phase for phase in motion.phases if phase.name == "carry")
    flown = cut(motion, *np.searchsorted(motion.drones.breaks, [carry.start, carry.end]).tolist())
    first, last = flown.drones.breaks[:-1], flown.drones.breaks[1:]
    squares = np.stack([first**2, first * last, last**2], axis=-1)
    path = 0.5 * np.array(pushed)[:, None] * squares[:, None, None]

    def off(part: PiecewisePolynomial, count: int) -> PiecewisePolynomial:
        c = part.elevated(max(part.degree, 2)).coefficients.copy()
        c[:, :count, :3] += bernstein.elevate(path, c.shape[-1] - 1)
        return part.replaced(c)

    return flown.replaced(vertices=off(flown.vertices, 3), poses=off(flown.poses, 1))


@pytest.mark.parametrize("pushed", [[0.0] * 3, [0.8, -0.4, 3.0], [-0.8, 0.4, -3.0]])
def test_support_is_below_the_force_line(motion: Motion, pushed: list[float]) -> None:
    flown = carried(motion, pushed)
    t = np.linspace(0.0, flown.duration, 3001)
    poses, a, p = flown.poses.at(t)[:, 0], accelerations(flown, t), flown.vertices.at(t)
    height = (poses[:, 2] + 0.15 - p[:, 0, 2])[:, None]
    foot = poses[:, :2] - height * a[:, :2] / (GRAVITY + a[:, 2:])
    onward = (np.roll(p, -1, axis=1) - p)[..., :2]
    inward = unit(np.stack([onward[..., 1], -onward[..., 0]], axis=-1))
    apart = float(np.min(np.sum(inward * (foot[:, None] - p[..., :2]), axis=-1)))
    assert apart - 2.2e-3 <= check(flown, "support").worst <= apart


@pytest.mark.parametrize(
    ("change", "name"),
    [
        (
            lambda m: replace(m, load_share=m.load_share.replaced(0.5 * m.load_share.coefficients)),
            "support",
        ),
        (lambda m: replace(m, load_share=None), "support"),
        (lambda m: replace(m, phases=tuple(replace(p, hold=None) for p in m.phases)), "support"),
        (lambda m: replace(m, poses=moved(m.poses, [0.2, 0, 0, 0, 0])), "support"),
        (lambda m: replace(m, poses=moved(m.poses, [0, 0, 0.01, 0, 0])), "support"),
        (lambda m: slipped(m, 0.001), "support"),
        (lambda m: with_body(m, "tray", mass=1.1 * MASS), "equilibrium"),
    ],
    ids=[
        "half borne",
        "not borne",
        "not held",
        "elsewhere",
        "apart",
        "turned",
        "heavier",
    ],
)
def test_false_claims_are_refused(
    motion: Motion, change: Callable[[Motion], Motion], name: str
) -> None:
    assert not check(change(motion), name).holds


def test_slip_accumulates_over_the_parts_of_a_plan(motion: Motion) -> None:
    lie = slipped(motion, 0.001)
    carry = next(phase for phase in lie.phases if phase.name == "carry")
    times = np.linspace(carry.start, carry.end, 9)
    joints = np.searchsorted(lie.drones.breaks, times - 1e-6).tolist()
    parts = [certify(cut(lie, a, b), reports=()) for a, b in pairwise(joints)]
    assert all(part["support"].holds for part in parts)
    assert not merged(cut(lie, joints[0], joints[-1]), parts)["support"].holds


def claimed(to: list[float], x: float, rim: ho.Rim | None, by: HoldBy = HoldBy.REST) -> Motion:
    """Return the flight of a hitch whose phase says that it holds a pole at x [m]."""
    start = ho.Hitch.spread(ho.Team(3, 2.4), ho.regular_polygon(3, 0.9), altitude=1.0)
    flight = ho.solve(start, ho.Transport(to)).motion
    pole = ho.SolidObject(ho.Section(radius=0.08), 0.0, 1.5, at=[x, 0.0, 0.0], rim=rim)
    held = tuple(replace(p, hold=PhaseHold("pole", by, (0, 1, 2))) for p in flight.phases)
    requirements = replace(flight.requirements, objects={"pole": pole})
    return flight.replaced(phases=held, requirements=requirements)


@pytest.mark.parametrize(
    ("by", "rim"), [(HoldBy.GRIP, None), (HoldBy.REST, ho.Rim(ho.Section(radius=2.0), 1.2))]
)
def test_a_claimed_hold_lets_no_cable_through_an_object(by: HoldBy, rim: ho.Rim | None) -> None:
    assert not check(claimed([3.0, 0.0, 1.0], 1.5, rim, by), "object_clearance").holds


@pytest.mark.parametrize(
    ("x", "rim", "holds", "is_clear"),
    [(0.0, 1.4, True, True), (0.0, 1.1, False, False), (5.0, 1.4, False, True)],
)
def test_clasps_of_a_rest_are_below_the_rim_and_around(
    x: float, rim: float, holds: bool, is_clear: bool
) -> None:
    """Clasps that rise from 1 m to 1.3 m may claim a pole between them with a rim above."""
    changed = claimed([0.0, 0.0, 1.3], x, ho.Rim(ho.Section(radius=0.5), rim))
    for name, passes in (("support", holds), ("object_clearance", is_clear)):
        found = RULE_OF[name].check(changed)
        assert found is None or found.holds == passes


@pytest.mark.slow
def test_flat_trays_are_carried_from_below_and_obstacles_are_named() -> None:
    flat = planned("carry_tray")
    tray = list(flat.motion.requirements.objects).index("tray")
    carry = next(phase for phase in flat.phases if phase.name == "carry")
    there = flat.at(np.linspace(carry.start, carry.end, 40))
    below = there.object_poses[:, tray, None, :3] - there.vertices
    assert np.all(below[..., 2] >= -1e-6)
    assert np.all(np.linalg.norm(below[..., :2], axis=-1) < 0.33)
    end = flat.at(flat.duration).object_poses[tray, :3]
    assert end == pytest.approx([0.2, 1.8, 0.5], abs=1e-6)
    given: Any = read_yaml(PROBLEMS / "carry_tray.yaml")
    given["objects"]["pillar"]["circle"] = 0.3
    words = r"^object_clearance: 0 m is below the limit of 0\.085 m at .*pillar"
    with pytest.raises(ho.InfeasibleError, match=words):
        ho.solve(problem_from_dict(given))
