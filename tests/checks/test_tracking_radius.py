"""``tracking_radius`` and closest neighbours: closed forms, samples, displaced plans, and laws."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import pairwise, product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hitchopt as ho
from hitchopt.checks import Check, certify, tracking
from hitchopt.checks.certifying import certificate_of
from hitchopt.checks.registry import RULES, TEAM_REPORTS
from hitchopt.checks.rule import approach
from hitchopt.checks.separation import closeness
from hitchopt.hitch import Team
from hitchopt.hitch.catenary import Catenary
from hitchopt.hitch.pairs import DISTANCES, Bodies
from hitchopt.hitch.requirements import Arena, Limits, Prism, Requirements, Separation
from hitchopt.motion.motion import Motion
from hitchopt.objects import Section
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array
from tests.helpers.by_hand import cable_points, ratios, sampled, tracking_radius
from tests.helpers.groups import part
from tests.helpers.motions import (
    ARENA,
    free_motion,
    lines,
    random_curves,
    random_flight,
    random_motion,
    row,
    single,
    still,
)
from tests.helpers.plans import planned
from tests.helpers.refusals import assert_refused
from tests.helpers.second_opinions import opinion_of


def radius_of(motion: Motion, gamma: float = 1.0) -> Check:
    return certify(motion, gamma=gamma, reports=TEAM_REPORTS)["tracking_radius"]


def crossing(seed: int) -> Motion:
    """Drones at all heights: the pair of the least ratio need not be the one that counts."""
    places = np.random.default_rng(seed).uniform(-3.0, 3.0, (2, 9, 3)) + [0.0, 0.0, 5.0]
    return lines(*places)


MOTIONS: dict[str, Callable[[], Motion]] = {
    **{f"hitch {n}": partial(random_motion, n, n, arena=ARENA) for n in (3, 4)},
    "crossing": partial(crossing, 0),
    "triangle": lambda: planned("triangle").motion,
    "open pair": lambda: planned("open_pair").motion,
    "stack": lambda: planned("swarms/stack").motion,
}


@pytest.mark.parametrize("name", MOTIONS)
def test_the_radius_matches_samples(name: str) -> None:
    motion = MOTIONS[name]()
    breaks, check = motion.drones.breaks, radius_of(motion)
    least = tracking_radius(motion, np.union1d(np.linspace(breaks[0], breaks[-1], 201), breaks))
    if not row(motion, "separation").holds:
        assert check.worst == 0.0
    else:
        assert 0.95 * least - 1e-6 <= check.worst <= least * (1.0 + 1e-4)


DISTANCE_KEYS = {"separation": "radius", "cable_clearance": "cable", "crossing": "crossing"}
"""Keys of ``Separation`` by the checks whose limits they are."""


@pytest.mark.parametrize("name", sorted(MOTIONS.keys() - {"crossing"}))  # there drones touch
def test_only_a_larger_distance_of_the_binding_check_lowers_the_radius(name: str) -> None:
    motion = MOTIONS[name]()
    check = radius_of(motion)
    lowering = set()
    for distance, key in DISTANCE_KEYS.items():
        separation = motion.requirements.separation
        larger = replace(separation, **{key: getattr(separation, key) + 1e-5})
        stricter = replace(motion.requirements, separation=larger)
        if radius_of(motion.replaced(requirements=stricter)).worst < check.worst - 1e-7:
            lowering.add(distance)
    assert check.binding in {*DISTANCE_KEYS, "legs", "arena", "span"}
    assert lowering == {check.binding} & DISTANCE_KEYS.keys()


def test_a_refusal_names_the_distance_that_limits_the_radius() -> None:
    motion = with_tracking(planned("triangle").motion, 0.3)
    check = radius_of(motion)
    assert not check.holds
    words = f"; limited by {check.binding}; {tracking.TRACKING_RADIUS.remedy}"
    assert words in str(check.violation("at rest", tracking.TRACKING_RADIUS.remedy))


def with_tracking(motion: Motion, tracking: float | ho.Tube | None) -> Motion:
    limits = replace(motion.requirements.limits, tracking=tracking)
    return replace(motion, requirements=replace(motion.requirements, limits=limits))


@pytest.mark.parametrize(
    ("seed", "gamma", "ratio"), [(0, 0.6, 1.0), (0, 1.8, 2.5), (1, 1.8, 1.0), (1, 1.0, 2.5)]
)
def test_distances_hold_for_errors_up_to_the_radius(seed: int, gamma: float, ratio: float) -> None:
    """In random directions, and all bodies toward the middle."""
    motion, rng = random_motion(4 + seed, seed, arena=ARENA), np.random.default_rng(seed)
    motion = with_tracking(motion, ho.Tube(0.02, 0.02 * ratio))
    radius, requirements = radius_of(motion, gamma).worst, motion.requirements
    assert radius > 1e-3
    times = np.linspace(0.0, motion.duration, 101)

    def off(part: PiecewisePolynomial, by: float, inward: bool) -> PiecewisePolynomial:
        c = part.coefficients
        way = rng.normal(size=c.shape[1:3])
        if inward:
            way = np.mean(c, axis=(0, 1, 3)) - np.mean(c, axis=(0, 3)) + 0.1 * way
        way *= by / np.linalg.norm(way / [1.0, 1.0, ratio], axis=-1, keepdims=True)
        return PiecewisePolynomial(part.breaks, c + way[..., None])

    for i in range(8):
        moved = replace(
            motion,
            drones=off(motion.drones, radius, i % 2 == 0),
            vertices=off(motion.vertices, gamma * radius, i % 4 == 0),
        )
        result = sampled(moved, times)
        assert result["separation"] >= 1.0
        assert result["cable_clearance"] >= requirements.separation.cable
        assert result["crossing"] >= requirements.separation.crossing
        assert result["legs"] >= requirements.limits.leg
        assert result["arena"] >= 0.0


LAW_MOTIONS: dict[str, Callable[[], Motion]] = {
    "crossing": lambda: crossing(2),
    "free": lambda: free_motion(*random_flight(5, n=2, pieces=1)),
    "formed": lambda: part(planned("form_triangle").motion, "swap 1", "tension"),
}


@pytest.mark.parametrize(
    "name", [pytest.param(x, marks=pytest.mark.slow if x == "formed" else ()) for x in LAW_MOTIONS]
)
def test_tubes_of_equal_axes_are_numbers_and_higher_ones_never_help(name: str) -> None:
    motion = LAW_MOTIONS[name]()
    number, *balls = (
        certify(with_tracking(motion, x), reports=TEAM_REPORTS).to_dict()
        for x in (0.02, ho.Tube(0.02, 0.02), ho.Tube(0.02, 0.001))
    )
    assert balls == [number, number]
    radii = [
        radius_of(with_tracking(motion, ho.Tube(0.02, 0.02 * ratio))).worst
        for ratio in (1.0, 1.2, 5.0)
    ]
    assert radii == sorted(radii, reverse=True)


def test_upright_errors_do_not_bring_level_neighbours_nearer() -> None:
    places = np.array([[0.0, 0.0, 3.0], [1.0, 0.0, 3.0]])  # high above the floor
    beside, above = lines(places, places), lines(places[:, ::-1], places[:, ::-1])
    for tube, moved in ((ho.Tube(0.08, 0.2), 1.0), (ho.Tube(0.08, 0.4), 1.0)):
        radius = radius_of(with_tracking(beside, tube)).worst
        assert radius == pytest.approx(0.5 * (moved - 0.24), rel=1e-3)
        radius = radius_of(with_tracking(above, tube)).worst
        assert radius == pytest.approx(0.5 * (moved - 0.6) * tube.level / tube.height, rel=1e-3)


@pytest.mark.parametrize("ratio", [1.0, 2.5])
def test_upright_errors_bring_drones_nearer_to_what_is_below(ratio: float) -> None:
    prism = Prism([[-1.0, -1.0], [-1.0, 1.0], [1.0, 1.0], [1.0, -1.0]], 0.0, 1.0)
    above = lines([[0.0, 0.0, 1.9]], [[0.1, 0.0, 1.9]], keep_out=(prism,))
    radius = radius_of(with_tracking(above, ho.Tube(0.08, 0.08 * ratio))).worst
    assert radius == pytest.approx(0.9 / ratio - 0.12, rel=1e-4)


@pytest.mark.parametrize("ratio", [1.0, 2.5])
@pytest.mark.parametrize("seed", range(5))
def test_hanging_cables_keep_off_the_ground_for_all_errors(seed: int, ratio: float) -> None:
    """Whatever it is sunk by as drones come nearer to each other; and not by much less.

    Its limit is not larger where errors are larger upright.
    """
    rng = np.random.default_rng(seed)
    length = rng.uniform(1.0, 2.0)
    way = rng.uniform(-1.0, 1.0, 3) * [1.0, 1.0, 0.4]
    way *= rng.uniform(0.5, 0.93) * length / np.linalg.norm(way)
    q, r = np.array([0.0, 0.0, 5.0]), way + [0.0, 0.0, 5.0]

    def lowest(ends: Array) -> Array:
        low: Array = np.min(cable_points([length], ends)[..., 2], axis=(-1, -2))
        return low

    floor = float(lowest(np.stack([q, r]))) - 0.10 - 0.05
    ends = np.stack([q, r, q + [0.0, 9.0, 5.0], r + [0.0, 9.0, 5.0]])  # another one far away
    drones, team = PiecewisePolynomial.constant([0.0, 1.0], ends), Team(2, length, topology="open")
    arena = Arena([-50.0, -50.0, floor], [50.0, 50.0, 50.0])
    tube = ho.Tube(0.02, 0.02 * ratio)
    radius = radius_of(with_tracking(free_motion(team, drones, arena=arena), tube)).worst
    shifts = rng.normal(size=(400, 2, 3)) - [0.0, 0.0, 2.0]
    shifts[:200, 0] += way / np.linalg.norm(way)
    shifts[:200, 1] -= way / np.linalg.norm(way)
    shifts *= radius / np.linalg.norm(shifts / [1.0, 1.0, ratio], axis=-1, keepdims=True)
    assert np.min(lowest(np.stack([q, r]) + shifts)) >= floor + 0.10
    assert radius > 0.002 / ratio


@pytest.mark.parametrize("distance", [0.1, 0.3])
@pytest.mark.parametrize("rise", [0.0, 0.5])
def test_hanging_cables_alone_approach_an_object_at_rest(distance: float, rise: float) -> None:
    """The radius is that at which they are displaced by their distance beyond the limit."""
    q, r = np.array([-0.8, 0.0, 3.0]), np.array([0.8, 0.0, 3.0 + rise])
    far = [0.0, 9.0, 0.0]
    drones = PiecewisePolynomial.constant([0.0, 1.0], np.stack([q, r, q + far, r + far]))
    team = Team(2, 2.0, topology="open")
    column = ho.SolidObject(Section(radius=0.1), 0.0, 6.0, 1.0, 0.5, at=[0.0, 0.1 + distance, 0.0])
    motion = free_motion(team, drones, objects={"column": column})
    radius = radius_of(with_tracking(motion, ho.Tube(0.01, 0.01))).worst
    cable = Catenary.between(q, r, 2.0)
    displacement = radius + float(cable.extra_displacement(radius))
    assert displacement == pytest.approx(distance - motion.requirements.separation.object, rel=1e-4)


def test_fixed_objects_may_touch_the_ceiling() -> None:
    places = np.array([[-0.5, 0, 1.5], [0.5, 0, 1.5], [-0.5, -1, 1.5], [0.5, -1, 1.5]])
    drones = PiecewisePolynomial.constant([0.0, 1.0], places)
    team, arena = Team(2, 1.2, topology="open"), Arena([-3.0, -3.0, 0.0], [3.0, 3.0, 2.2])
    radii = list[float]()
    for top in (2.1, 2.2):
        column = ho.SolidObject(Section(radius=0.1), 0.0, top, 1.0, at=[0.0, 1.0, 0.0], fixed=True)
        motion = free_motion(team, drones, objects={"column": column}, arena=arena)
        radii.append(radius_of(with_tracking(motion, ho.Tube(0.01, 0.01))).worst)
    assert radii[1] == pytest.approx(radii[0])


@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))]
)
def test_drones_and_hanging_cables_may_go_toward_each_other(seed: int) -> None:
    """A cable that is moved as a whole goes as far as its drones."""
    team, drones = random_flight(seed, n=3, pieces=1)
    motion = free_motion(team, drones)
    most = tracking_radius(motion, np.linspace(0.0, motion.duration, 201))
    assert 0.0 <= radius_of(motion).worst <= most * (1.0 + 1e-4)


def test_certificates_of_another_gamma_are_not_those_of_exports() -> None:
    hitch = ho.Hitch.balanced(ho.Team(3, 2.4), [[0, -0.6], [-0.52, 0.3], [0.52, 0.3]], 1.5)
    flight = ho.solve(hitch, ho.Hold(0.5), limits=ho.Limits(tracking=0.01)).flight
    for gamma in (0.0, 3.0):
        certify(flight, gamma=gamma)
        assert certificate_of(flight)["tracking_radius"].gamma == 1.0


def test_larger_gammas_never_help_and_are_stated() -> None:
    motion = random_motion(4, 7)
    radii = [radius_of(motion, gamma).worst for gamma in (0.0, 0.5, 1.0, 1.5, 3.0)]
    assert radii == sorted(radii, reverse=True)
    certificate = certify(motion, gamma=1.5)
    *others, entry, _, _ = certificate.to_dict()["checks"]
    assert (entry["name"], entry["gamma"], entry["limit"]) == ("tracking_radius", 1.5, None)
    assert entry["holds"] is True
    assert all("gamma" not in other for other in others)
    with pytest.raises(ho.InputError, match="gamma"):
        certify(motion, gamma=-1.0)


def test_binding_distances_are_named() -> None:
    """Of a triangle at rest the legs, the walls, and with a long leg limit nothing is left."""
    outline = np.array([[0.0, -1.0], [-0.8, 0.6], [0.8, 0.6]])
    motion = still(Team(3, 3.0), outline, [0.4] * 3)

    def keeping(**requirements: object) -> Motion:
        return replace(motion, requirements=Requirements(**requirements))  # type: ignore[arg-type]

    short = keeping(limits=Limits(leg=0.39))
    shortest = row(short, "legs")
    for gamma in (1.0, 3.0):
        check = radius_of(short, gamma)
        assert check.worst == pytest.approx((shortest.worst - 0.39) / (1.0 + gamma), rel=1e-6)
        assert check.where == shortest.where
    assert radius_of(keeping(limits=Limits(leg=0.9))).worst == 0.0
    for name, limit, both in (("crossing", "crossing", 6.0), ("cable_clearance", "cable", 4.0)):
        near = keeping(separation=Separation(**{limit: row(motion, name).worst - 1e-3}))
        for gamma, number in ((1.0, 2.0), (3.0, both)):
            assert radius_of(near, gamma).worst == pytest.approx(1e-3 / number, rel=1e-3), name
    low = keeping(arena=Arena([-9, -9, 0.999], [9, 9, 3]))
    assert radius_of(low).worst == pytest.approx(1e-3, rel=1e-6)


def test_every_distance_enters_by_its_slack_or_by_pairs_of_bodies() -> None:
    distances = {rule.name for rule in RULES if rule.pairs}
    by_slack = {rule.name for rule in tracking.slack_rules(RULES)}
    assert distances >= DISTANCES.keys()
    assert distances - by_slack == {"separation", "downwash"}


OBSTACLES = {
    "box": ho.Section([[0.0, 0.1], [0.3, 0.15], [0.3, -0.1], [0.0, -0.1]]),
    "disc": ho.Section(radius=0.2),
}


PLACES = [
    *product(
        [[0.1, 0.0, 0.6], [0.1, 0.0, -0.4], [0.45, 0.1, 0.3], [0.1, 0.45, 0.25], [0.5, 0.5, 0.02]],
        OBSTACLES,
        [1.0, 2.5],
    )
]
"""Places of obstacles [m], their sections, and ratios of the axes of tubes."""


@pytest.mark.parametrize(
    ("at", "section", "ratio"),
    [
        pytest.param(*place, marks=() if k in {0, 15} else pytest.mark.slow)
        for k, place in enumerate(PLACES)
    ],
)
def test_single_drones_keep_all_distances_up_to_the_radius(
    at: list[float], section: str, ratio: float
) -> None:
    """Also where errors bring a drone above a thin plate that it passes below; and not much more.

    The plate hovers off the origin, turned.
    """
    plate = ho.SolidObject(
        OBSTACLES[section], 1.0, 1.02, 0.02, 0.3, at=[2.0, -1.0, 0.0], yaw=0.8, fixed=False
    )
    turn = np.array([[np.cos(0.8), -np.sin(0.8), 0.0], [np.sin(0.8), np.cos(0.8), 0.0], [0, 0, 1]])
    place = np.array([2.0, -1.0, 1.02]) + turn @ at

    def motion(place: Array) -> Motion:
        hover = lines(place[None], place[None], objects={"plate": plate}, separation=WIDE)
        return with_tracking(hover, ho.Tube(0.01, 0.01 * ratio))

    radius = radius_of(motion(place)).worst
    assert 0.0 < radius < 1.0
    rng = np.random.default_rng(3)
    ways = rng.normal(size=(150, 3))
    ways = np.concatenate([ways, np.eye(3), -np.eye(3), plate.at + [0.1, 0.0, 1.02] - place + ways])
    ways /= np.linalg.norm(ways / [1.0, 1.0, ratio], axis=-1, keepdims=True)

    def holds(place: Array) -> bool:
        return all(row(motion(place), name).holds for name in ("downwash", "keep_out"))

    assert all(holds(place + 0.999 * radius * way) for way in ways)
    assert ratio > 1.0 or not all(holds(place + (1.25 * radius + 0.01) * way) for way in ways)


WIDE = Separation(radius=0.12, height=0.3)


def test_the_floor_is_ignored_for_standing_drones() -> None:
    """It is for those that come down to it elsewhere; walls count at all times."""
    up = np.array([[0.0, 0.0], [0.0, 0.0], [0.0, 1.0]])
    across = np.array([[0.0, 1.0], [0.0, 0.0], [1.0, 1.0]])
    low = across * [[1.0], [1.0], [0.0]] + [[0.0], [0.0], [0.02]]
    down = np.array([[1.0, 1.0], [0.0, 0.0], [1.0, 0.0]])
    for middle, left in ((across, 0.7), (low, 0.02)):
        c = np.stack([up * [[1], [1], [middle[2, 0]]], middle, down * [[1], [1], [middle[2, 0]]]])
        drones = PiecewisePolynomial(np.arange(4.0), c[:, None])
        lower, upper = np.array([-0.7, -2.0, 0.0]), np.array([2.0, 2.0, 3.0])
        for shift in (0.0, 0.4):
            moved = drones.replaced(drones.coefficients + shift)
            arena = Arena(lower + shift, upper + shift)
            check = radius_of(single(moved, arena=arena))
            assert check.worst == pytest.approx(left, rel=1e-6)


def swarm(n: int, seed: int) -> Motion:
    """Drones on curves that meet now and then; continuous or not is of no matter here."""
    return single(random_curves(n, seed), separation=Separation(0.1, 0.2))


def apart(motion: Motion, t: Array) -> Array:
    return ratios(motion.drones.at(t), motion.requirements.separation)


@pytest.mark.parametrize(("n", "spans"), [(2, 7), (9, 20), (30, 5)])
def test_closest_pairs_bound_samples_and_match_the_certificate(n: int, spans: int) -> None:
    motion = swarm(n, n)
    result = closeness(ho.Flight.of(motion), spans)
    assert (len(result.spans), result.spans[0].start, result.spans[-1].end) == (spans, 0.0, 2.4)
    assert all(a.end == b.start for a, b in pairwise(result.spans))
    for span in result.spans:  # curves may jump at the joints
        least = np.min(apart(motion, np.linspace(span.start, span.end, 801)[1:-1]))
        assert span.bound <= least + 1e-9
        assert span.start <= span.time <= span.end
        assert span.bound <= span.value <= least + 1e-3
    names = motion.team.drone_names
    pairs = [(names[i], names[j]) for i, j in zip(*np.triu_indices(n, 1), strict=True)]
    sampled = dict(zip(pairs, np.min(apart(motion, np.linspace(0.0, 2.4, 5001)), 0), strict=True))
    for pair in result.pairs:
        assert sampled[pair.pair] - 5e-3 <= pair.bound <= sampled[pair.pair] + 1e-9
    bounds = [pair.bound for pair in result.pairs]
    assert bounds == sorted(bounds)
    worst = row(motion, "separation").worst
    for bound in (bounds[0], min(span.bound for span in result.spans)):
        assert bound == pytest.approx(worst, rel=2e-4, abs=1e-6)
    assert str(result).count("\n") == len(result.pairs)
    assert ", ".join(result.pairs[0].pair) in str(result)


def test_a_single_drone_is_refused() -> None:
    assert_refused(lambda: closeness(ho.Flight.of(swarm(1, 0))), "drones", "neighbour")
    assert_refused(lambda: closeness(ho.Flight.of(swarm(2, 0)), 0), "spans", "at least 1")


def test_what_is_held_errs_with_the_vertices_that_hold_it() -> None:
    """A drone may approach a held object by two radii: its own, and that of the vertices."""
    standing: Bodies = ("drones", "objects")
    held: Bodies = ("drones", "held")
    assert approach([standing], 1.0, hitched=True) == 1.0
    assert approach([standing, held], 1.0, hitched=True) == 2.0
    assert approach([held], 3.0, hitched=False) == 4.0


@pytest.mark.slow
def test_drones_keep_off_a_held_box_if_both_err() -> None:
    motion = planned("carry_box").motion
    radius = radius_of(motion).worst
    index, box = next(
        (k, body) for k, body in enumerate(motion.requirements.objects.values()) if not body.fixed
    )
    closest = np.inf
    for t in np.linspace(0.0, motion.duration, 400):
        pose = motion.poses.at(t)[index]
        cosine, sine = pose[3:5]
        local = (motion.drones.at(t) - pose[:3]) @ np.array(
            [[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]]
        )
        closest = min(closest, *(np.min(slab.clearance(local).distance) for slab in box.slabs))
    assert closest - 2.0 * radius >= motion.requirements.separation.radius


def test_a_drone_above_what_can_be_held_may_err_half_as_far(tmp_path: Path) -> None:
    """The post errs with the vertices, in ``verify`` too; one that is fixed does not."""
    team = ho.Team(robots=3, cable_length=2.4)
    start = ho.Hitch.spread(team, [[1, -1], [0.6, 0.5], [1.4, 0.5]], altitude=1.5)
    motion = ho.solve(start, ho.Hold(1.0)).motion
    x, y, z = start.drones[0]

    def beside(limits: Limits, *, fixed: bool) -> Motion:
        top = float(z) - 0.15
        post = ho.SolidObject(ho.Section(radius=0.1), 0.0, top, 0.1, 0.5, at=[x, y, 0], fixed=fixed)
        need = replace(motion.requirements, objects={"post": post}, limits=limits)
        from_objects: dict[str, Any] = {"poses": None, "load_share": None}
        return replace(motion, requirements=need, **from_objects)

    held = radius_of(beside(motion.requirements.limits, fixed=False))
    assert held.binding == "keep_out"
    assert held.worst == pytest.approx(0.5 * (0.15 - 0.12), rel=1e-6)
    tracked = Limits(tracking=0.02)
    for fixed in (True, False):
        rows = opinion_of(beside(tracked, fixed=fixed), tmp_path)
        verdicts = {row.verdict for row in rows if row.name == "keep_out"}
        assert verdicts == ({"proven"} if fixed else {"violated"})
