"""Distances between groups on one clock: samples beat no bound, and laws of combined motions."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import hitchopt as ho
from hitchopt.checks import Certificate, Check, certify
from hitchopt.checks.certifying import check_of
from hitchopt.checks.registry import RULE_OF
from hitchopt.hitch.pairs import DISTANCES
from hitchopt.hitch.requirements import Separation
from hitchopt.motion.flight import Flight, TeamMotion
from hitchopt.motion.motion import Motion
from hitchopt.motion.retiming import shifted
from hitchopt.teams.across import PAIRS
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array
from tests.helpers.by_hand import segment_to_segment
from tests.helpers.groups import moved
from tests.helpers.motions import free_motion, lines, random_flight, random_motion

SEPARATION = Separation(radius=0.11, height=0.3)


def taut(seed: int, by: Array) -> Motion:
    """Return a hitch of three or four robots that moves."""
    return moved(random_motion(3 + seed % 2, seed, separation=SEPARATION), *by)


def hanging(seed: int, by: Array) -> Motion:
    """Return robots that wander with free cables."""
    return moved(free_motion(*random_flight(seed, 3), separation=SEPARATION), *by)


def middle(motion: Motion) -> Array:
    return np.asarray(np.mean(motion.drones.coefficients, axis=(0, 1, 3)))


def beside(kinds: str, seed: int) -> tuple[Motion, Motion]:
    """Return two motions near each other, each taut (t), hanging (h) or of single drones (s)."""
    rng = np.random.default_rng(seed)
    motions = []
    for k, kind in enumerate(kinds):
        if kind == "s":
            places = rng.uniform(-1.0, 1.0, (4, 3, 3))
            motion = lines(*places, seconds=3.0, separation=SEPARATION)
        else:
            motion = (taut if kind == "t" else hanging)(seed + 7 * k, np.zeros(3))
        motions.append(motion)
    goal = np.array([4.0, -3.0, 5.0])
    first, second = (moved(each, *(goal - middle(each))) for each in motions)
    away = rng.uniform(-1.0, 1.0, 3) * [2.4, 2.4, 1.2]
    return first, shifted(moved(second, *away), float(rng.uniform(0.0, 2.0)))


def bodies(motion: Motion, times: Array) -> tuple[Array, Array, bool]:
    """Return drones (times, N, 3), cables as segments (times, m, 2, 3), and whether these hang."""
    at = np.clip(times, *motion.drones.breaks[[0, -1]])
    x, p, n = motion.drones.at(at), motion.vertices.at(at), motion.team.robots
    if n == 0:
        return x, np.zeros((len(x), 0, 2, 3)), False
    if not motion.formed.all():
        return x, np.stack([x[:, 0::2], x[:, 1::2]], axis=2), True
    onward = np.roll(p, -1, axis=1)
    ends = [(x[:, 0::2], p), (p, onward), (onward, x[:, 1::2])]
    return x, np.concatenate([np.stack(each, axis=2) for each in ends], axis=1), False


def sampled(first: Motion, second: Motion, times: Array) -> dict[str, float]:
    """Return the minimum distances between groups by check; hanging cables are sheets."""
    (x, a, hung), (y, b, also) = (bodies(each, times) for each in (first, second))
    r = x[:, :, None] - y[:, None]
    wide, high = 2.0 * SEPARATION.radius, 2.0 * SEPARATION.height
    ratio = np.hypot(np.linalg.norm(r[..., :2], axis=-1) / wide, r[..., 2] / high)
    result = {"separation": float(np.min(ratio))}
    sheets = [(m.team.cable_length if m.team.robots else None) for m in (first, second)]
    points = x[:, :, None].repeat(2, 2), y[:, :, None].repeat(2, 2)
    near = [apart(points[0], None, b, sheets[1] if also else None)]
    near.append(apart(points[1], None, a, sheets[0] if hung else None))
    result["cable_clearance"] = min(near)
    result["crossing"] = apart(a, sheets[0] if hung else None, b, sheets[1] if also else None)
    return result


def apart(a: Array, long: Array | None, b: Array, wide: Array | None) -> float:
    """Return the minimum distance of segments; of sheets, horizontal or vertical."""
    if not a.shape[1] or not b.shape[1]:
        return math.inf
    flat = np.array([1.0, 1.0, 0.0]) if long is not None or wide is not None else 1.0
    ends = [each * flat + np.zeros(3) for each in (a[:, :, None], b[:, None])]
    every = [
        np.broadcast_arrays(ends[0][..., i, :], ends[1][..., j, :]) for i in (0, 1) for j in (0, 1)
    ]
    q, r, s, t = every[0][0], every[3][0], every[0][1], every[3][1]
    with np.errstate(invalid="ignore"):
        gap = segment_to_segment(*(each + 1e-12 * k for k, each in enumerate((q, r, s, t))))
    if long is not None or wide is not None:
        spans = []
        for each, length in ((a, long), (b, wide)):
            low, high = each[..., 2].min(-1), each[..., 2].max(-1)
            if length is not None:
                low = np.minimum(low, each[..., 2].mean(-1) - 0.5 * length)
            spans.append((low, high))
        over = np.maximum(
            spans[0][0][:, :, None] - spans[1][1][:, None],
            spans[1][0][:, None] - spans[0][1][:, :, None],
        )
        gap = np.maximum(gap, over)
    return float(np.min(gap))


def across(first: Motion, second: Motion) -> Certificate:
    """Return the certificate of both, with checks between groups as the worst."""
    return certify(Flight((TeamMotion("a", first), TeamMotion("b", second))), reports=())


@pytest.mark.parametrize("kinds", ["tt", "th", "hh", "ts", "sh", "ss"])
@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))]
)
def test_no_sample_exceeds_a_bound_between_groups(kinds: str, seed: int) -> None:
    first, second = beside(kinds, seed)
    end = max(each.drones.breaks[-1] for each in (first, second))
    times: Array = np.unique(
        np.concatenate(
            [np.linspace(0.0, float(end), 3001), first.drones.breaks, second.drones.breaks]
        )
    )
    both = Flight((TeamMotion("a", first), TeamMotion("b", second)))
    for name, value in sampled(first, second, times).items():
        checks = [check_of(RULE_OF[name], Flight.of(each)) for each in (both, first, second)]
        known, *own = (math.inf if check is None else check.worst for check in checks)
        least = min(value, *own)
        if math.isinf(least):  # no cables
            assert math.isinf(known)
            continue
        assert known <= least + 1e-9
        assert known >= least - max(2e-2 * abs(least), 3e-3), name


def worst(certificate: Certificate) -> dict[str, float]:
    return {check.name: check.worst for check in certificate.checks}


@pytest.mark.parametrize("kinds", ["tt", "th", "ts"])
def test_certificates_do_not_depend_on_place_order_or_names(kinds: str) -> None:
    first, second = beside(kinds, 5)
    here = worst(across(first, second))
    by = np.array([40.0, -30.0, 10.0])
    assert worst(across(second, first)) == pytest.approx(here, rel=1e-3, abs=1e-6)
    away = worst(across(moved(first, *by), moved(second, *by)))
    away["floor"] -= by[2]
    for name in here.keys() - {"cable_length", "continuity", "equilibrium"}:  # rounding grows
        assert away[name] == pytest.approx(here[name], rel=2e-3, abs=2e-3), name
    later = worst(across(shifted(first, 3.0), shifted(second, 3.0)))
    assert later == pytest.approx(here, rel=1e-3, abs=1e-6)


def test_a_single_group_is_unchanged() -> None:
    motion = taut(3, np.zeros(3))
    alone = Flight((TeamMotion("a", motion),))
    assert alone.drones is motion.drones
    assert alone.teams[0].name == ""
    assert worst(certify(alone)) == worst(certify(motion))


def test_external_plans_count_before_and_after_their_time() -> None:
    """Drones rest in the way before their start, or after their end."""
    mine = lines([[0.0, 0, 1]], [[4.0, 0, 1]], seconds=4.0, separation=SEPARATION)
    there = lines([[2.0, 0, 1]], [[2.0, 5, 1]], seconds=1.0, separation=SEPARATION)
    hit = {
        at: Flight((TeamMotion("", mine),), (TeamMotion("show", shifted(there, at), "abc"),))
        for at in (0.0, 6.0)
    }
    assert certify(hit[0.0], reports=())["separation"].holds
    check = certify(hit[6.0], reports=())["separation"]
    assert not check.holds
    assert check.time == pytest.approx(2.0, abs=1e-3)
    assert check.where == ("d0", "show.d0")
    back = lines([[2.0, 5, 1]], [[2.0, 0, 1]], seconds=1.0, separation=SEPARATION)
    assert not certify(Flight((TeamMotion("", mine),), (TeamMotion("show", back),)), reports=())[
        "separation"
    ].holds
    after = Flight(
        (TeamMotion("", mine),), (TeamMotion("show", shifted(moved(back, 2.0, 0.0, 0.0), 9.0)),)
    )
    assert certify(after, reports=())["separation"].time == pytest.approx(
        10.0, abs=1e-3
    )  # mine rests at its end


def test_distances_are_the_larger_ones_of_both() -> None:
    one = lines([[0.0, 0, 1]], [[1.0, 0, 1]], separation=Separation(radius=0.1, height=0.2))
    other = lines([[0.0, 1, 1]], [[1.0, 1, 1]], separation=Separation(radius=0.3, height=0.3))
    for pair in ((one, other), (other, one)):
        assert across(*pair)["separation"].worst == pytest.approx(1.0 / 0.6, rel=1e-6)


@pytest.mark.parametrize("moved_first", [False, True])
def test_an_object_counts_where_it_rests_after_it_was_moved(*, moved_first: bool) -> None:
    """The other group has it as an obstacle at its former position."""
    body = ho.SolidObject(ho.Section(radius=0.1), 0.0, 1.0, at=[3.0, 1.0, 0.0], mass=15.0)
    mine = lines([[0.0, 0, 0.5]], [[4.0, 0, 0.5]], seconds=4.0, separation=SEPARATION)
    theirs = lines([[3.0, 9, 0.5]], [[3.0, 8, 0.5]], seconds=4.0, separation=SEPARATION)
    both = [
        each.replaced(requirements=replace(each.requirements, objects={"post": body}))
        for each in (mine, theirs)
    ]
    assert across(*both)["keep_out"].holds
    rests = body.moved_to(np.array([2.0, 0.3, 0.0, 0.0])).pose
    there = PiecewisePolynomial.constant(both[1].drones.breaks, rests[None])
    both[1] = both[1].replaced(poses=there)
    if moved_first:
        both.reverse()
    certificate = across(*both)
    check = certificate["keep_out"]
    assert check.worst == pytest.approx(0.3 - 0.1, abs=1e-4)  # of radius 0.1, passed 0.3 m away
    # The drone is off toward the object, which is off as far as vertices that carry it.
    slack = check.worst - SEPARATION.radius
    whole = Flight((TeamMotion("a", both[0]), TeamMotion("b", both[1])))
    for gamma in (0.5, 1.0, 3.0):
        radius = certify(whole, gamma=gamma)["tracking_radius"]
        assert radius.worst == pytest.approx(slack / (1.0 + max(1.0, gamma)), rel=1e-6)
        assert radius.where == check.where
    assert {name[2:] for name in check.where} == {"d0", "post"} or "post" in check.where


@pytest.mark.parametrize(("away", "limit"), [([0, 1, 0], 0.22), ([0, 0, 1], 0.6)])
@pytest.mark.parametrize("ratio", [1.0, 2.5])
def test_tracking_radius_is_half_of_the_slack_between_groups(
    away: list[int], limit: float, ratio: float
) -> None:
    """Upright errors bring groups nearer that are above each other."""
    one, other = (lines([x], [x + [1, 0, 0]], separation=SEPARATION)
                  for x in (np.array([0.0, 0, 1]), np.array([0.0, 0, 1]) + away))  # fmt: skip

    def radius(off: float) -> Check:
        limits = replace(one.requirements.limits, tracking=ho.Tube(off, off * ratio))
        both = [
            each.replaced(requirements=replace(each.requirements, limits=limits))
            for each in (one, other)
        ]
        return certify(Flight((TeamMotion("a", both[0]), TeamMotion("b", both[1]))))[
            "tracking_radius"
        ]

    slack = 0.5 * (1.0 - limit) / (ratio if away[2] else 1.0)
    assert radius(0.01).worst == pytest.approx(slack, rel=1e-4)
    assert not radius(0.5).holds


def test_start_times_and_certificates_keep_the_same_distances() -> None:
    assert DISTANCES.keys() <= RULE_OF.keys()
    assert {kinds for rule in DISTANCES.values() for kinds in rule.kinds} == PAIRS.keys()


@pytest.mark.parametrize("several", [False, True])
def test_what_flies_far_away_changes_no_check(*, several: bool) -> None:
    """Of one team beside an external plan, and of one of two teams."""
    one, far = taut(1, np.zeros(3)), taut(1, np.array([60.0, 0.0, 0.0]))
    other = TeamMotion("b", far)
    own, others = (
        ((TeamMotion("a", one), other), ()) if several else ((TeamMotion("", one),), (other,))
    )
    both = Flight(own, others)
    alone, found = certify(one), certify(both)
    for check in alone.checks:
        bound = pytest.approx(check.worst, rel=1e-6, abs=1e-5)  # b rounds at its coordinates
        assert found[check.name].worst == bound, check.name
