"""Downwash: lower halves of drones' ellipsoids meet no taut cable and nothing that they move."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import hitchopt as ho
from hitchopt import verify
from hitchopt.checks import Check, certify
from hitchopt.checks.registry import RULE_OF
from hitchopt.hitch.pairs import DISTANCES
from hitchopt.hitch.requirements import Separation
from hitchopt.motion.flight import Flight, TeamMotion, moved_objects, own_objects
from hitchopt.motion.motion import Motion
from hitchopt.motion.plan_file import write_plan
from hitchopt.teams.across import check_across, radius_across
from hitchopt.teams.schedule import SampledPath, slacks
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array
from tests.helpers.groups import moved
from tests.helpers.motions import TRIANGLE, lines, random_motion, row, still
from tests.helpers.plans import planned

SEPARATION = Separation(radius=0.11, height=0.29)
BOX = ho.Section([[0.0, 0.1], [0.3, 0.1], [0.3, -0.1], [0.0, -0.1]])
TOP = 0.55  # [m]


def hover(at: Array, **box: float | bool) -> Motion:
    """Return a single drone that hovers beside a box, off the origin."""
    values: dict[str, float | bool] = {"mass": 0.1, "friction": 0.5} | box
    body = ho.SolidObject(BOX, 0.05, TOP, at=[3.0, -2.0, 0.0], **values)  # type: ignore[arg-type]
    place = (np.array([3.15, -2.0, 0.0]) + at)[None]
    return lines(place, place, separation=SEPARATION, objects={"box": body})


@pytest.mark.parametrize(
    ("at", "ratio"),
    [
        ([0.0, 0.0, TOP + 0.2], 0.2 / 0.29),
        ([0.0, 0.0, TOP + 0.4], 0.4 / 0.29),
        ([0.0, 0.1 + 0.08, TOP + 0.1], np.hypot(0.08 / 0.11, 0.1 / 0.29)),
        ([0.0, 0.1 + 0.2, 0.3], 0.2 / 0.11),
    ],
)
def test_the_ratio_is_that_of_the_nearest_point_below(at: list[float], ratio: float) -> None:
    check = row(hover(np.array(at)), "downwash")
    assert check.worst == pytest.approx(ratio, rel=1e-6)
    assert check.where == ("d0", "box")


def test_nothing_above_the_drone_counts() -> None:
    check = row(hover(np.array([0.0, 0.0, -0.2])), "downwash")
    assert not check.is_evaluated
    assert check.holds


@pytest.mark.parametrize("box", [{"mass": 0.6}, {"friction": 3.0}, {"fixed": True}])
def test_only_what_the_largest_thrust_would_push_along_counts(box: dict[str, float]) -> None:
    motion = hover(np.array([0.0, 0.0, TOP + 0.2]), **box)
    assert "downwash" not in {check.name for check in certify(motion, reports=()).checks}
    thrust = float(motion.team.max_thrust[0])
    body = motion.requirements.objects["box"]
    assert body.fixed or body.mass * body.friction * 9.81 > thrust


@pytest.mark.parametrize("order", [1, -1])
@pytest.mark.parametrize(("share", "counts"), [(0.9, True), (1.1, False)])
def test_the_strongest_drone_of_a_team_decides_what_it_would_move(
    order: int, share: float, *, counts: bool, tmp_path: Path
) -> None:
    """With a friction of a share of its largest thrust; weaker ones make no difference."""
    kinds = [ho.Quadrotor(max_thrust=x) for x in (2.0, 5.0, 3.0)][::order]
    friction, far = share * 5.0 / (0.4 * 9.81), np.array([2.0, 2.0, 0.0])
    alone = hover(np.array([0.0, 0.0, TOP + 0.2]), mass=0.4, friction=friction)
    (place,) = alone.drones.at(0.0)
    places = np.array([place, place + far, place - far])
    objects = alone.requirements.objects
    flown = lines(places, places, separation=SEPARATION, objects=dict(objects))
    motion = flown.replaced(team=ho.Swarm(3, quadrotor=kinds))
    names = {check.name for check in certify(motion, reports=()).checks}
    assert ("downwash" in names) is counts
    write_plan(tmp_path / "plan.npz", ho.Flight.of(motion))
    rows = {each.name: each.verdict for each in verify.verify(tmp_path)}
    assert ("downwash" in rows) is counts
    assert not counts or rows["downwash"] == "violated"


@pytest.mark.parametrize(
    "seed", [0, 1, 5, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (2, 3, 4))]
)
def test_no_sample_of_a_cable_below_a_drone_exceeds_the_bound(seed: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(seed)
    hitch = random_motion(3 + seed % 3, seed, separation=SEPARATION)
    centre = np.mean(hitch.vertices.coefficients, axis=(0, 1, 3))
    places = centre + rng.uniform(-0.7, 0.7, (4, 2, 3)) + [0.0, 0.0, 0.35]
    swarm = lines(*places, seconds=4.0, separation=SEPARATION)
    motion = Flight((TeamMotion("a", hitch), TeamMotion("s", swarm)))
    check = check_across(RULE_OF["downwash"], motion)
    assert check is not None
    times = np.linspace(0.0, 4.0, 801)
    x, p, d = hitch.drones.at(times), hitch.vertices.at(times), swarm.drones.at(times)
    onward, share = np.roll(p, -1, axis=1), np.linspace(0.0, 1.0, 41)[:, None]
    parts = [(x[:, 0::2], p), (p, onward), (onward, x[:, 1::2])]
    worst = np.inf
    for a, b in parts:
        points = (a[:, :, None] + share * (b - a)[:, :, None]).reshape(len(times), 1, -1, 3)
        offset = (points - d[:, :, None]) / [SEPARATION.radius] * 1.0
        offset[..., 2] *= SEPARATION.radius / SEPARATION.height
        ratio = np.where(offset[..., 2] <= 0.0, np.linalg.norm(offset, axis=-1), np.inf)
        worst = min(worst, float(np.min(ratio)))
    assert check.worst <= worst
    write_plan(tmp_path / "plan.npz", motion)
    rows = [each for each in verify.verify(tmp_path) if each.name == "downwash"]
    assert (rows[0].verdict == "proven") is (check.worst >= 1.0)


def turned(motion: Motion, angle: float, shift: Array) -> Motion:
    """Return a motion without objects, turned about the vertical axis and shifted."""
    c, s = np.cos(angle), np.sin(angle)
    rotation = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    parts = {name: getattr(motion, name) for name in ("drones", "vertices")}
    return motion.replaced(
        **{
            name: part.replaced(rotation @ part.coefficients + shift[:, None])
            for name, part in parts.items()
        }
    )


@pytest.mark.parametrize("height", [0.05, 0.35, 0.7])
def test_errors_up_to_the_radius_bring_no_drone_over_a_cable(height: float) -> None:
    below = held(turned(planned("triangle").motion, 0.7, np.array([3.0, -7.0, 0.4])))
    q, r = below.vertices.at(0.0)[:2]
    place = 0.45 * q + 0.55 * r + [0.0, 0.0, height]
    radius = team_radius(below, place)
    assert (radius > 0.0) is (height > 0.3)
    rng = np.random.default_rng(0)
    ways = rng.normal(size=(30, 2, 3)) + [[0.0, 0.0, -2.0], [0.0, 0.0, 2.0]]
    ways /= np.linalg.norm(ways, axis=-1, keepdims=True)
    for drone, cable in 0.999 * radius * ways:
        check = across_check(moved(below, *cable), place + drone, "downwash")
        assert radius == 0.0 or check is None or check.worst >= 1.0


def held(motion: Motion) -> Motion:
    """Return a motion that stays at its start, in its first state."""
    parts = ("drones", "vertices", "legs", "tensions")
    at_start = {
        name: getattr(motion, name).replaced(
            np.repeat(getattr(motion, name).coefficients[..., :1], 2, axis=-1)
        )
        for name in parts
    }
    still = motion.replaced(**at_start)
    return still.slice_pieces(slice(0, 1), still.phases[:1])


def across_check(below: Motion, place: Array, name: str) -> Check | None:
    """Return the check between a group and a drone that hovers."""
    drone = lines(place[None], place[None], seconds=below.duration)
    return check_across(RULE_OF[name], Flight((TeamMotion("a", below), TeamMotion("s", drone))))


def team_radius(below: Motion, place: Array) -> float:
    """Return the tracking radius of what is between a group and a drone that hovers."""
    drone = lines(place[None], place[None], seconds=below.duration)
    flight = Flight((TeamMotion("a", below), TeamMotion("s", drone)))
    between = {RULE_OF[name]: check_across(RULE_OF[name], flight) for name in DISTANCES}
    return radius_across(flight, flight.requirements, between, 1.0).worst


def test_planned_drones_fly_over_what_they_would_move_in_height() -> None:
    box = ho.SolidObject(BOX, 0.0, 0.6, at=[1.0, 0.0, 0.0])
    start, goal = np.array([[0.0, 0.0, 0.8]]), np.array([[2.2, 0.0, 0.8]])
    plan = ho.separate(ho.Problem(ho.Swarm(1), start, [ho.Fly(goal)], objects={"box": box}))
    check = plan.certificate["downwash"]
    assert check.holds
    assert check.worst < 3.0  # it does not just go far around


def test_ones_own_objects_and_cables_are_excepted() -> None:
    names = {check.name for check in planned("carry_tray").certificate.checks}
    assert "downwash" not in names


def test_what_another_team_carries_counts_also_while_it_rests() -> None:
    whole = planned("carry_tray").motion
    heavy = {
        name: ho.SolidObject(
            **{key: getattr(body, key) for key in vars(body) if key != "mass"}, mass=15.0
        )
        for name, body in whole.requirements.objects.items()
    }
    carrier = whole.replaced(requirements=replace(whole.requirements, objects=heavy))
    (name,) = moved_objects(carrier)
    index, end = list(heavy).index(name), float(whole.drones.breaks[-1])
    top = whole.poses.at(end)[index, :3] + [0.0, 0.0, heavy[name].upper + 0.2]
    drone = lines(top[None], top[None], seconds=end, separation=SEPARATION)
    motion = Flight((TeamMotion("a", carrier), TeamMotion("s", drone)))
    check = check_across(RULE_OF["downwash"], motion)
    assert check is not None
    assert not check.holds


def test_schedules_keep_drones_off_what_is_below_them() -> None:
    hitch = still(ho.Team(3, 2.4), TRIANGLE, [0.35, 0.5, 0.45], separation=SEPARATION)
    edge = np.mean(hitch.vertices.at(0.0)[[0, 1]], axis=0)
    box = hover(np.array([0.0, 0.0, 9.0]))
    poses = np.repeat(box.poses.coefficients, 2, axis=-1)
    carrier = box.replaced(poses=PiecewisePolynomial(box.drones.breaks, poses))
    top = carrier.requirements.objects["box"].at + [0.15, 0.0, TOP]
    for motion, owned, place in ((hitch, set[str](), edge), (carrier, {"box"}, top)):
        group = SampledPath(TeamMotion("a", motion), frozenset(owned))
        for height in (0.2, 0.4, -0.7):
            at = (place + [0.0, 0.0, height])[None]
            drone = SampledPath(TeamMotion("s", lines(at, at, separation=SEPARATION)))
            slack = slacks(group, drone, SEPARATION)
            np.testing.assert_allclose(slacks(drone, group, SEPARATION).T, slack)
            if height > 0.0:
                assert slack[0, 0] == pytest.approx((height / 0.29 - 1.0) * 0.11)
            else:
                assert slack[0, 0] > 0.05


def test_schedules_keep_drones_off_objects_of_another_team_that_they_do_not_know() -> None:
    """A team may tie its cables around an object, and leave it where it stands."""
    post = ho.SolidObject(ho.Section(radius=0.1), 0.0, 2.0, at=[3.0, 1.0, 0.0], fixed=True)
    places = np.array([[3.2, 1.0, 1.0]]), np.array([[8.0, 1.0, 1.0]])
    near, far = (lines(place, place, separation=SEPARATION) for place in places)
    owner = far.replaced(requirements=replace(far.requirements, objects={"post": post}))
    knows = near.replaced(requirements=owner.requirements)
    for motion, apart in ((near, 0.1 - 0.11), (knows, np.inf)):
        own = own_objects(owner, [owner, motion])
        assert own == ({"post"} if motion is near else set())
        for names in (own, frozenset({"post"})):  # a third team may not know it
            tracks = (
                SampledPath(TeamMotion("a", owner), names),
                SampledPath(TeamMotion("s", motion)),
            )
            np.testing.assert_allclose(slacks(*tracks, SEPARATION), [[apart] * 11] * 11)
