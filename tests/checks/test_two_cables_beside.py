"""Two cables around an object beside other teams: samples beat no bound, laws, lies, and plans."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hitchopt.checks.across import check_across
from hitchopt.checks.registry import RULE_OF
from hitchopt.geometry.vectors import rotated
from hitchopt.hitch.pairs import DISTANCES
from hitchopt.hitch.requirements import Separation
from hitchopt.motion.flight import Flight, TeamMotion
from hitchopt.motion.motion import TAUT_STATES, Motion
from hitchopt.motion.retiming import shifted
from hitchopt.values import Array
from hitchopt.verify import teams
from tests.helpers.groups import moved, part
from tests.helpers.motions import lines
from tests.helpers.plans import planned
from tests.helpers.second_opinions import opinion_of, violated

WIDE = Separation(radius=0.05, height=0.1, cable=0.2, crossing=0.06)
"""Distances with which cables, not the object below them, keep drones off."""

PARTS = {
    "tie": ("draw taut", "tighten"),
    "hold": ("tighten", "tighten"),
    "carry": ("tighten", "carry"),
}
KINDS = "tie", "carry"


@cache
def tied(kind: str) -> Motion:
    """Return two cables that bend around a drum and are tied, hold it, or carry it."""
    return exact(part(planned("two_robots_drum").motion, *PARTS[kind]))


def exact(motion: Motion) -> Motion:
    """Return a motion without tracking errors, with these distances."""
    limits = replace(motion.requirements.limits, tracking=0.0)
    requirements = replace(motion.requirements, separation=WIDE, limits=limits)
    return motion.replaced(requirements=requirements)


def beside(motion: Motion, *others: Motion) -> Flight:
    """Return a flight of cables around an object and other teams, b and c."""
    flown = [TeamMotion(name, each) for name, each in zip("abc", (motion, *others), strict=False)]
    return Flight(tuple(flown))


def distances(flight: Flight) -> dict[str, float]:
    """Return the certified distances between teams."""
    checks = {name: check_across(RULE_OF[name], flight) for name in DISTANCES}
    return {name: check.worst for name, check in checks.items() if check is not None}


def wanderers(seed: int, seconds: float) -> Motion:
    """Return single drones that fly past a drum at [0, 0, 0], above, next to and below cables."""
    rng = np.random.default_rng(seed)
    places = rng.uniform([-1.2, -1.2, 0.1], [1.2, 1.2, 0.9], (5, 3, 3))
    return lines(*places, seconds=seconds, separation=WIDE)


def triangle(place: Array, start: float) -> Motion:
    """Return a triangle of cables that turns and changes its shape about a place [m]."""
    motion = planned("square_to_rectangle").motion
    middle = np.mean(motion.drones.coefficients, axis=(0, 1, 3))
    return exact(shifted(moved(motion, *(place - middle)), start))


# Bounds and samples.

SAMPLES = 600
ON_ARC = 40


def points_on_cables(motion: Motion, times: Array) -> Array:
    """Return points of taut cables (times, n, points, 3) [m], including arcs about a disc.

    Arcs lead clockwise from contact to contact; both are one point of straight cables.
    """
    drones = motion.drones.at(times).reshape(len(times), -1, 2, 3)
    ends, contacts = motion.inner_ends.at(times), motion.contacts.at(times)
    share = np.linspace(0.0, 1.0, ON_ARC)[:, None]
    parts = [
        a[:, :, None] + share * (b - a)[:, :, None]
        for end in (0, 1)
        for a, b in pairwise([drones[:, :, end], ends[:, :, end], contacts[:, :, end]])
    ]
    centre = motion.poses.at(times)[:, 0, None, None, :2]
    arms = contacts[..., :2] - centre
    angles = np.arctan2(arms[..., 1], arms[..., 0])
    turn = (angles[..., :1] - angles[..., 1:]) % (2.0 * np.pi)
    on_arc = angles[..., :1] - np.where(turn > 6.28, 0.0, turn) * share[:, 0]
    radius = np.linalg.norm(arms[:, :, :1], axis=-1)
    level = np.stack([radius * np.cos(on_arc), radius * np.sin(on_arc)], axis=-1) + centre
    heights = np.broadcast_to(contacts[:, :, :1, 2:], (*level.shape[:-1], 1))
    arcs = np.concatenate([level, heights], axis=-1)
    np.testing.assert_allclose(arcs[:, :, -1], contacts[:, :, 1], atol=1e-4)
    return np.concatenate([*parts, arcs], axis=2)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", range(3))
def test_no_sampled_drone_is_nearer_to_a_bent_cable_than_the_bound(kind: str, seed: int) -> None:
    motion = tied(kind).spans(TAUT_STATES)[0]
    start, end = motion.drones.breaks[[0, -1]].tolist()
    other = wanderers(seed, end)
    times: Array = np.linspace(start, end, SAMPLES)
    drones = other.drones.at(times)[:, None, :, None]
    offsets = points_on_cables(motion, times)[:, :, None] - drones
    nearest = float(np.min(np.linalg.norm(offsets, axis=-1)))
    found = distances(beside(motion, other))["cable_clearance"]
    assert nearest - 0.24 < found <= nearest + 1e-9  # the section is as wide as that


def next_to_an_arc(distance: float) -> Motion:
    """Return a drone that hovers at a distance [m] from the middle of an arc, at its height."""
    motion = tied("hold")
    contacts = motion.contacts.at(0.0)[0]
    middle = np.mean(contacts, axis=0)
    outward = middle[:2] / np.linalg.norm(middle[:2])
    (body,) = motion.requirements.objects.values()
    place = np.append((body.section.rounding + distance) * outward, middle[2])
    return lines(place[None], place[None], seconds=motion.duration, separation=WIDE)


def test_a_drone_next_to_an_arc_is_as_far_as_from_the_section() -> None:
    """Legs and chords are farther away than the arc, which bulges towards it."""
    found = distances(beside(tied("hold"), next_to_an_arc(0.15)))
    assert found["cable_clearance"] == pytest.approx(0.15, abs=1e-4)
    assert found["keep_out"] == pytest.approx(0.15, abs=1e-4)


# Laws.


def transformed(motion: Motion, angle: float, by: Array, *, mirror: bool = False) -> Motion:
    """Return a motion with its objects turned about the origin, moved, or mirrored before."""
    sign = -1.0 if mirror else 1.0

    def placed(points: Array) -> Array:
        """Return points (…, 3, degree + 1)."""
        x, y, z = np.moveaxis(points, -2, 0)
        level = rotated(np.stack([x, sign * y], axis=-1), angle)
        return np.stack([*np.moveaxis(level, -1, 0), z], axis=-2) + by[:, None]

    curves: dict[str, Any] = {}
    for name in ("drones", "vertices", "contacts", "anchors"):
        curve = getattr(motion, name)
        curves[name] = curve.replaced(placed(curve.coefficients))
    poses = motion.poses.coefficients
    cosine, sine = poses[:, :, 3], sign * poses[:, :, 4]
    heading = rotated(np.stack([cosine, sine], axis=-1), angle)
    turned = np.concatenate([placed(poses[:, :, :3]), np.moveaxis(heading, -1, -2)], axis=2)
    curves["poses"] = motion.poses.replaced(turned)
    objects = {
        name: body.moved_to(
            np.append(turned[0, index, :3, 0], np.arctan2(*turned[0, index, 4:2:-1, 0]))
        )
        for index, (name, body) in enumerate(motion.requirements.objects.items())
    }
    requirements = replace(motion.requirements, objects=objects)
    return motion.replaced(requirements=requirements, **curves)


NEAR = (np.array([0.9, -0.4, 0.8]), 4.0)
"""Place of a triangle near the drum, and when it starts."""


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    "change",
    [
        pytest.param(
            lambda x: transformed(x, 0.0, np.array([7.0, -5.0, 2.0])),
            id="moved",
            marks=pytest.mark.slow,
        ),
        pytest.param(lambda x: transformed(x, 1.1, np.zeros(3)), id="turned"),
        pytest.param(lambda x: transformed(x, 0.0, np.zeros(3), mirror=True), id="mirrored"),
        pytest.param(lambda x: shifted(x, 2.5), id="later"),
    ],
)
def test_distances_do_not_depend_on_place_and_sense(
    kind: str, change: Callable[[Motion], Motion]
) -> None:
    all_of = tied(kind), triangle(*NEAR), wanderers(1, 10.0)
    here = distances(beside(*all_of))
    assert here.keys() == DISTANCES.keys()
    there = distances(beside(*map(change, all_of)))
    assert there == pytest.approx(here, rel=2e-3, abs=2e-3)


@pytest.mark.parametrize("kind", KINDS)
def test_distances_do_not_depend_on_the_order_of_teams(kind: str) -> None:
    motion, other, drones = tied(kind), triangle(*NEAR), wanderers(1, 10.0)
    here = distances(beside(motion, other, drones))
    assert distances(beside(drones, other, motion)) == pytest.approx(here, rel=1e-3, abs=1e-6)
    others = tuple(
        TeamMotion(f"show.{name}", each) for name, each in zip("bc", (other, drones), strict=True)
    )
    apart = distances(Flight((TeamMotion("", motion),), others))
    for name in apart:  # b and c are not compared
        assert apart[name] >= here[name] - 1e-6


# Both opinions.


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", range(2))
def test_check_and_verify_agree(kind: str, seed: int, tmp_path: Path) -> None:
    motion = tied(kind)
    flight = beside(motion, wanderers(seed, motion.duration), triangle(*NEAR))
    rows = opinion_of(
        flight, tmp_path, teams.between_plans, teams.object_distances, teams.arc_distances
    )
    found: dict[str, float] = {}
    for row in rows:
        if row.samples:
            found[row.name] = min(found.get(row.name, np.inf), row.worst)
    here = distances(flight)
    assert here.keys() == found.keys()
    for name, value in here.items():
        limit = DISTANCES[name].limit(flight.requirements.separation)
        if value >= limit:
            assert found[name] == pytest.approx(value, rel=0.02)
        else:
            assert found[name] < limit


def through(motion: Motion) -> Motion:
    """Return the triangle where its cables pass through those around the drum."""
    return triangle(np.array([0.9, 0.0, 0.35]), motion.duration - 4.0)


LIES: dict[str, tuple[str, Callable[[Motion], Motion], set[str]]] = {
    "a drone is next to an arc": (
        "hold",
        lambda _: next_to_an_arc(0.18),
        {"cable_clearance"},
    ),
    "cables pass through bent ones": ("tie", through, {"crossing", "cable_clearance"}),
    "cables pass through the drum": (
        "carry",
        lambda _: triangle(np.array([0.0, 0.6, 0.5]), 0.0),
        {"object_clearance"},
    ),
    "drones pass through the drum": (
        "carry",
        lambda x: lines([[-2.0, 0.1, 0.3]], [[2.0, 0.1, 0.3]], seconds=x.duration, separation=WIDE),
        {"keep_out", "downwash"},
    ),
}


@pytest.mark.parametrize("lie", LIES)
@pytest.mark.parametrize("external", [False, True], ids=["teams", "others"])
def test_lies_are_refused_twice(lie: str, tmp_path: Path, *, external: bool) -> None:
    kind, other_of, broken = LIES[lie]
    motion = tied(kind)
    other = other_of(motion)
    flight = beside(motion, other)
    if external:
        flight = Flight((TeamMotion("", motion),), (TeamMotion("show.b", other, "0" * 64),))
    refused = {x for x in DISTANCES if (c := check_across(RULE_OF[x], flight)) and not c.holds}
    assert refused >= broken
    rows = opinion_of(
        flight, tmp_path, teams.between_plans, teams.object_distances, teams.arc_distances
    )
    assert violated(rows) >= broken
    if lie == "a drone is next to an arc":  # which the segments of cables do not show
        assert refused == broken
        own = opinion_of(flight, tmp_path, teams.between_plans, teams.object_distances)
        assert not violated(own)
        (whole,) = (x for x in opinion_of(flight, tmp_path) if x.name == "cable_clearance")
        assert whole.verdict == "violated"
        assert whole.worst == pytest.approx(0.18, abs=1e-3)
