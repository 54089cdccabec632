"""Grips: the certificate against samples, balances and false plans; how they close and open."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq

import hitchopt as ho
from benchmarks.families import wild_carry
from hitchopt import verify as second
from hitchopt.carrying.holding import residual_grip
from hitchopt.carrying.planner import check_opens
from hitchopt.checks.grips import GRIP, Gripped, arc_lengths
from hitchopt.checks.stops import carried_paths
from hitchopt.errors import FileError
from hitchopt.hitch import GRAVITY
from hitchopt.hitch.requirements import Requirements
from hitchopt.motion.motion import HoldBy, Motion, PhaseHold
from hitchopt.motion.plan_file import read_plan, write_plan
from hitchopt.motion.retiming import cut
from hitchopt.objects.placing import in_frame
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.values import Array
from hitchopt.verify.objects import gripped
from tests.helpers.carried_plans import (
    DRUM,
    RADIUS,
    check,
    drum,
    lifted,
    moved,
    plan,
    slipped,
    with_body,
)
from tests.helpers.clasp_balance import unit

OBJECTS = ["drum", pytest.param("stone", marks=pytest.mark.slow)]


@pytest.fixture(scope="module")
def motion() -> Motion:
    return plan("drum").motion


def parts_of(motion: Motion, t: Array) -> tuple[Array, Array, Array]:
    """Return the straight parts (times, n, 3) of edges, and contacts (times, n, 2, 3) [m]."""
    p, c = motion.vertices.at(t), motion.contacts.at(t)
    return c[:, :, 0] - p, np.roll(p, -1, axis=1) - c[:, :, 1], c


def angle(a: Array, b: Array) -> Array:
    cross = np.linalg.norm(np.cross(a, b), axis=-1)
    found: Array = np.arctan2(cross, np.sum(a * b, axis=-1))
    return found


@pytest.mark.slow
@pytest.mark.parametrize("name", OBJECTS)
def test_edges_move_the_object(name: str) -> None:
    motion = plan(name).motion
    t = lifted(motion)
    body = next(iter(motion.requirements.objects.values()))
    leaving, arriving, contacts = parts_of(motion, t)
    T = motion.tensions.at(t)[..., None]
    poses = motion.poses.at(t)[:, 0]
    centre = poses[:, None, :3] + [0.0, 0.0, body.centre_of_mass[2]]
    force = np.sum(T * (unit(arriving) - unit(leaving)), axis=1)
    a = motion.poses.differentiated(2).at(t)[:, 0, :3]
    np.testing.assert_allclose(force, body.mass * (a + [0, 0, GRAVITY]), atol=1e-3)
    moment = np.cross(contacts[:, :, 1] - centre, T * unit(arriving))
    moment -= np.cross(contacts[:, :, 0] - centre, T * unit(leaving))
    assert np.max(np.abs(np.sum(moment, axis=1))) < 1e-3


def arcs_of(section: ho.Section, seen: Array) -> Array:
    """Return the lengths (times, n) [m] of edges between contacts (times, n, 2, 2) on a section.

    On a polygon they run along its sides, clockwise.
    """
    chords = seen[:, :, 1] - seen[:, :, 0]
    if section.radius is not None:
        angles = angle(*(np.pad(seen[:, :, end], ((0, 0), (0, 0), (0, 1))) for end in (0, 1)))
        touching = np.linalg.norm(chords, axis=-1) > 1e-9
        arcs: Array = section.radius * np.where(touching, angles, 0.0)
        return arcs
    outline = section.core
    to_corners = np.linalg.norm(seen[..., None, :] - outline, axis=-1)
    sides = np.linalg.norm(np.roll(outline, -1, axis=0) - outline, axis=-1)
    along = np.append(0.0, np.cumsum(sides))[np.argmin(to_corners, axis=-1)]
    bent = np.max(np.min(to_corners, axis=-1), axis=-1) < 1e-6
    lengths = (along[..., 1] - along[..., 0]) % np.sum(sides)
    found: Array = np.where(bent, lengths, np.linalg.norm(chords, axis=-1))
    return found


@pytest.mark.parametrize("name", OBJECTS)
def test_parts_of_cables_add_up_to_their_lengths(name: str) -> None:
    """Legs, tangents and what lies on the section use up the cable."""
    motion = plan(name).motion
    t, team = np.linspace(0.0, motion.duration, 700), motion.team
    section = next(iter(motion.requirements.objects.values())).section
    leaving, arriving, contacts = parts_of(motion, t)
    arcs = arcs_of(section, in_frame(motion.poses.at(t)[:, None, None, 0], contacts)[..., :2])
    legs = motion.drones.at(t) - motion.vertices.at(t)[:, team.layout.anchors]
    sizes = np.linalg.norm(legs, axis=-1).reshape(len(t), -1, 2).sum(axis=-1)
    straight = np.linalg.norm(leaving, axis=-1) + np.linalg.norm(arriving, axis=-1)
    error = np.abs(sizes + straight + arcs - team.cable_length)
    assert np.max(error) < 2.5e-3  # sag is omitted here


def ratios(motion: Motion, t: Array) -> Array:
    """Return slip load over load (times,), with the worst clasps."""
    (body,) = motion.requirements.objects.values()
    leaving, arriving, _ = parts_of(motion, t)
    flat = np.array([1.0, 1.0, 0.0])
    theta = angle(flat * leaving, flat * arriving)
    legs = motion.drones.at(t) - motion.vertices.at(t)[:, motion.team.layout.anchors]
    wrapped = np.maximum(angle(-legs[:, 0::2], leaving), angle(-legs[:, 1::2], -arriving))
    least = motion.tensions.at(t) * np.exp(-motion.team.friction * np.pi * np.sin(0.5 * wrapped))
    a = motion.poses.differentiated(2).at(t)[:, 0, 2]
    slip: Array = body.friction * np.sum(least * theta, axis=1)
    return slip / (body.mass * (GRAVITY + a))


@pytest.mark.parametrize("name", OBJECTS)
def test_no_sample_is_below_the_bound_of_grip(name: str) -> None:
    motion = plan(name).motion
    least = float(np.min(ratios(motion, lifted(motion))))
    found = check(motion, "grip")
    assert found.holds
    assert found.worst <= least + 1e-9
    assert found.worst > 0.95 * least  # what turns the drum is counted in its load


def bound_on_piece(motion: Motion, piece: int) -> float:
    """Return the lower bound of slip load over load on a piece, wherever contacts are."""
    pieces = np.arange(motion.drones.pieces) == piece
    (spans,) = Gripped.of_object(motion, 0, pieces)
    return float(np.min(spans.slip_load / spans.load))


def test_turning_faster_loads_the_grip(motion: Motion) -> None:
    """A uniform drum that is turned needs friction sideways, at half of its radius."""
    carry = next(p for p in motion.phases if p.name == "carry")
    poses, breaks, pushed = motion.poses, motion.drones.breaks, 40.0  # rad/s²
    inside = (breaks[:-1] >= carry.start - 1e-9) & (breaks[1:] <= carry.end + 1e-9)
    piece = int(np.argmin(np.where(inside, np.diff(breaks), np.inf)))
    turned = 0.5 * pushed * float(np.diff(breaks)[piece]) ** 2
    assert turned < 0.5
    powers = np.zeros((2, 11))  # cosine and sine, by the share of the piece
    powers[0, [0, 4, 8]] = 1.0, -(turned**2) / 2.0, turned**4 / 24.0
    powers[1, [2, 6, 10]] = turned, -(turned**3) / 6.0, turned**5 / 120.0
    made = poses.elevated(max(poses.degree, 10)).coefficients.copy()
    values = np.vander(bernstein.nodes(made.shape[-1] - 1), 11, increasing=True) @ powers.T
    made[piece, 0, 3:] = bernstein.interpolate(values.T)
    placed = replace(motion, poses=PiecewisePolynomial(poses.breaks, made))
    t = np.linspace(breaks[piece], breaks[piece + 1], 201)[1:-1]
    least = np.min(ratios(motion, t)) * GRAVITY / math.hypot(GRAVITY, 0.5 * RADIUS * pushed)
    assert 0.5 * least < bound_on_piece(placed, piece) <= least
    assert bound_on_piece(motion, piece) > least


@pytest.mark.parametrize(
    ("part", "change", "words"),
    [
        ("drum", {"at": [6.3, 0.2, 0.0]}, "stand"),
        ("drum", {"yaw": 1e-6}, "stand"),
        ("hold", {"cables": [0, 1, 7]}, "from 0 to 2"),
        ("hold", {"object": "crate"}, "an object of"),
    ],
)
def test_files_with_false_objects_are_refused(
    motion: Motion, tmp_path: Path, part: str, change: dict[str, Any], words: str
) -> None:
    write_plan(tmp_path / "plan.npz", ho.Flight.of(motion))
    arrays = dict(np.load(tmp_path / "plan.npz"))
    settings = json.loads(str(arrays["settings"]))
    records = settings["groups"][0]["records"]
    {**records["requirements"]["objects"], **records["phases"][2]}[part].update(change)
    np.savez(tmp_path / "plan.npz", **arrays | {"settings": np.array(json.dumps(settings))})
    with pytest.raises(FileError, match=words):
        read_plan(tmp_path / "plan.npz")


def test_a_plan_from_the_middle_of_a_flight_is_read(motion: Motion, tmp_path: Path) -> None:
    carry = next(phase for phase in motion.phases if phase.name == "carry")
    first = int(np.searchsorted(motion.drones.breaks, carry.start + 1e-9))
    write_plan(tmp_path / "plan.npz", ho.Flight.of(cut(motion, first, motion.drones.pieces)))
    found = read_plan(tmp_path / "plan.npz")
    body = found.requirements.objects["drum"]
    np.testing.assert_allclose(body.pose, found.poses.at(0.0)[0], atol=1e-12)
    assert body.at[2] > 0.05


def held_by(motion: Motion, change: Callable[[PhaseHold], PhaseHold | None]) -> Motion:
    """Return the motion whose phases claim other holds."""
    holds = [phase.hold and change(phase.hold) for phase in motion.phases]
    phases = (replace(p, hold=hold) for p, hold in zip(motion.phases, holds, strict=True))
    return replace(motion, phases=tuple(phases))


def borne_before(motion: Motion) -> Motion:
    """Return the motion in which the drum's weight is borne from the start, by nothing."""
    coefficients = motion.load_share.coefficients.copy()
    coefficients[0, ..., -1] = 0.1
    return replace(motion, load_share=motion.load_share.replaced(coefficients))


def slid(motion: Motion) -> Motion:
    """Return the motion in which edges slip up and down by a millimetre on one piece."""
    coefficients = motion.contacts.coefficients.copy()
    carry = next(phase for phase in motion.phases if phase.name == "carry")
    piece = int(np.searchsorted(motion.drones.breaks, carry.end)) - 2
    coefficients[piece, :, :, 2, 1:-1] += 0.001
    return replace(motion, contacts=motion.contacts.replaced(coefficients))


def twisted(motion: Motion, angle: float) -> Motion:
    """Return the motion in which contacts turn about the drum: forces cancel, moments do not."""
    contacts = motion.contacts.coefficients.copy()
    poses = motion.poses.elevated(contacts.shape[-1] - 1)
    centre = poses.coefficients[:, None, None, 0, :2]
    turn = [[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]]
    contacts[..., :2, :] = centre + np.array(turn) @ (contacts[..., :2, :] - centre)
    return replace(motion, contacts=motion.contacts.replaced(contacts))


@pytest.mark.parametrize(
    ("change", "contradicted"),
    [
        (lambda m: replace(m, contacts=None), "grip"),
        (slid, "grip"),
        (lambda m: slipped(m, 0.001), "grip"),
        (lambda m: slipped(m, 0.0, 0.001), "grip"),
        (lambda m: replace(m, poses=moved(m.poses, [0, 0, 0, 0.001, 0])), "support"),
        (lambda m: twisted(m, 0.03), "equilibrium"),
        (lambda m: held_by(m, lambda _: None), "support"),
        (lambda m: held_by(m, lambda hold: replace(hold, by=HoldBy.REST)), "support"),
        (borne_before, "support"),
        (lambda m: replace(m, poses=moved(m.poses, [0.001, 0, 0, 0, 0])), "grip"),
        (lambda m: replace(m, contacts=moved(m.contacts, [0.0, 0.001, 0.0])), "grip"),
        (lambda m: with_body(m, "drum", mass=0.98 * DRUM), "equilibrium"),
        (lambda m: with_body(m, "drum", mass=1.02 * DRUM), "equilibrium"),
        (lambda m: with_body(m, "drum", section=ho.Section(radius=RADIUS + 0.001)), "grip"),
        (lambda m: with_body(m, "drum", section=ho.Section(radius=RADIUS - 0.001)), "grip"),
    ],
)
def test_false_claims_are_refused(
    motion: Motion, change: Callable[[Motion], Motion], contradicted: str
) -> None:
    assert not check(change(motion), contradicted).holds


def around(motion: Motion, radius: float) -> Motion:
    """Return the motion with a rough drum of another radius, and tangents to it on its left."""
    made = with_body(motion, "drum", section=ho.Section(radius=radius), friction=3.0)
    x, breaks = bernstein.nodes(9), motion.drones.breaks
    t = (breaks[:-1, None] + np.diff(breaks)[:, None] * x).ravel()
    centre, contacts = motion.poses.at(t)[:, 0], motion.contacts.at(t)
    away = (motion.vertices.at(t) - centre[:, None, :3]) @ [1.0, 1j, 0.0]
    turned = radius + np.sqrt(radius**2 - np.abs(away) ** 2 + 0j) * np.array([-1, 1])[:, None, None]
    first, last = radius * away / np.abs(away) ** 2 * turned
    there = np.stack([first, np.roll(last, -1, axis=-1)], axis=-1)
    contacts[..., :2] = np.stack([there.real, there.imag], -1) + centre[:, None, None, :2]
    c = np.moveaxis(contacts.reshape(-1, len(x), *contacts.shape[1:]), 1, -1)
    held = np.array([phase.hold is not None for phase in motion.phases])[motion.phase_of_piece]
    old = bernstein.elevate(motion.contacts.coefficients, 9)
    c = np.where(held[:, None, None, None, None], bernstein.interpolate(c), old)
    return replace(made, contacts=PiecewisePolynomial(breaks, c))


def test_edges_that_bend_to_the_left_grip_nothing(motion: Motion, tmp_path: Path) -> None:
    """Drawn to a drum that straight edges miss they would turn by more than half around it."""
    changed = around(motion, 0.03)
    assert not check(changed, "grip").holds
    write_plan(tmp_path / "plan.npz", ho.Flight.of(changed))
    (told,), _ = second.read(tmp_path / "plan.npz")
    assert ("wrap", "violated") in {(row.name, row.verdict) for row in gripped(told, 0)}


def test_grips_open_with_little_tension(motion: Motion) -> None:
    loosen = next(p for p in motion.phases if p.name == "loosen")
    pulls = motion.pulls.at(np.linspace(loosen.start, loosen.end, 101))
    assert np.min(pulls) == pytest.approx(0.3, abs=1e-5)
    section, pose = motion.requirements.objects["drum"].section, motion.poses.at(loosen.end)
    p = in_frame(pose, motion.vertices.at(loosen.end))[:, :2]
    assert np.min(section.segment_distance(p, np.roll(p, -1, axis=0))) > 0.035


NINE = [
    *([0.044, 0.181], [-0.136, 0.131], [-0.171, 0.084], [-0.185, -0.05], [-0.099, -0.16]),
    *([0.069, -0.173], [0.082, -0.168], [0.145, -0.121], [0.133, 0.134]),
]
"""Two edges come to touch it long before the third does [m]."""


def around_a_stone(mass: float, clasps: float = 0.0) -> ho.Problem:
    given = drum(circle=None, outline=NINE, mass=mass, friction=1.0, at=[0.0, 0.0, 0.0])
    given["team"] |= {"cable_density": 0.01, "cable_friction": clasps}
    polygon = 0.42 * np.array([[1.0, 0.0], [-0.5, -0.8667], [-0.5, 0.8667]])
    given["start"] = {"hitch": {"polygon": polygon.tolist(), "altitude": 1.2}}
    steps = {"enclose": {}, "grasp": {"by": "grip", "tension": 1.3}, "loosen": {}}
    given["mission"] = [{name: {"object": "drum", **keys}} for name, keys in steps.items()]
    return ho.problem_from_dict(given)


def assert_pushes_less_as_it_closes(motion: Motion) -> None:
    """Edges would push the object along at their full tension, and close with less."""
    grasp = next(phase for phase in motion.phases if phase.name == "grasp")
    (held,) = {phase.hold.object for phase in motion.phases if phase.hold is not None}
    body = motion.requirements.objects[held]
    t = np.linspace(grasp.start, grasp.end, 4001)
    leaving, arriving, _ = parts_of(motion, t)
    T, away = motion.tensions.at(t), unit(leaving) - unit(arriving)
    pushed = np.max(np.linalg.norm(np.sum(T[..., None] * away, axis=1)[:, :2], axis=-1))
    most = body.friction * body.mass * GRAVITY
    assert 0.05 < pushed < most < np.max(T) * pushed / np.min(T)


@pytest.mark.slow
def test_edges_that_touch_first_have_low_tensions_or_are_refused() -> None:
    grasped = ho.solve(around_a_stone(0.03)).motion
    assert_pushes_less_as_it_closes(grasped)
    grasp = next(phase for phase in grasped.phases if phase.name == "grasp")
    np.testing.assert_allclose(grasped.tensions.at(np.array([grasp.end])), 1.3)
    for mass, clasps, words in ((0.002, 0.0, "pushed by the edges"), (0.05, 0.2, "clasps stick")):
        with pytest.raises(ho.InfeasibleError, match=words):
            ho.solve(around_a_stone(mass, clasps))


@pytest.mark.slow
def test_edges_close_around_a_light_box_with_so_little_tension_that_it_stays() -> None:
    plan = ho.solve(ho.problem_from_dict(wild_carry(12)))
    assert plan.certificate.certified
    assert_pushes_less_as_it_closes(plan.motion)


def opening(friction: float, radius: float = 0.12) -> str:
    """Return what a regular hitch of 0.4 m off the origin is told that opens to 0.56 m.

    Its drones keep a distance of two radii [m].
    """
    angles = 0.3 - 2.0 * np.pi * np.arange(3) / 3
    corners = np.column_stack([np.cos(angles), np.sin(angles)])
    outline = ho.ConvexPolygon(0.4 * corners + [0.7, -0.2])
    hitch = ho.Hitch.balanced(ho.Team(3, 1.6, cable_friction=friction), outline, altitude=1.0)
    requirements = Requirements(separation=ho.Separation(radius=radius))
    try:
        check_opens(hitch, 0.56 * corners + [0.7, -0.2], requirements, "tie it larger")
    except ho.InfeasibleError as error:
        return error.violations[0].remedy
    return ""


def test_hitches_are_not_told_to_be_tied_where_drones_would_come_close() -> None:
    assert "tie it larger" in opening(0.25)
    close = opening(0.25, radius=0.22)
    assert "smoother cables" in close
    assert "tie it larger" not in close


def test_the_suggested_friction_is_the_largest_that_opens() -> None:
    remedy = opening(0.25)
    assert "larger, or use smoother cables" in remedy
    most = float(remedy.split("cable_friction ")[1].split()[0])
    assert not opening(most)
    assert opening(most + 0.002)
    # At the limit both sides of the clasp's balance are the same, drones side by side.
    leg = 0.5 * (1.6 - 0.4 * math.sqrt(3.0))
    legs = np.arcsin(Requirements().separation.radius / leg)
    turn = legs + np.pi / 6.0  # of helices, whose contact both cables share
    exact = np.log(np.cos(legs) / np.cos(np.pi / 6.0)) / (np.pi * np.sin(0.5 * turn) ** 2)
    assert most == pytest.approx(exact, abs=1e-3)


def test_residual_grip_solves_the_law_of_clasps() -> None:
    """Found by bisection: edges pull harder than legs where clasps stick, by both cables' share."""
    between, mu = np.radians(50.0), 0.15  # between the two legs at a clasp, of unequal lengths
    turned = 0.7 + 2.0 * np.pi * np.arange(3)[:, None] / 3 + [-between / 2.0, between / 2.0]
    legs = np.stack([np.cos(turned), np.sin(turned)], axis=-1) * [[[0.5], [0.3]]]

    def harder(edges: float) -> float:
        return math.exp(mu * math.pi * math.sin(0.25 * (edges + between)) ** 2)

    edges = brentq(lambda x: harder(x) * np.cos(0.5 * x) - np.cos(0.5 * between), between, np.pi)
    found = residual_grip(legs, np.array([0.3, 0.2, 0.1]), mu, 0.4)
    assert found == pytest.approx(0.4 * 0.3 * harder(edges) * (3.0 * edges - np.pi), rel=1e-9)
    assert found > 0.06


def carried(motion: Motion) -> Motion:
    """Return the part of the drum's flight on which it is carried."""
    carry = next(p for p in motion.phases if p.name == "carry")
    return cut(motion, *np.searchsorted(motion.drones.breaks, [carry.start, carry.end]).tolist())


def wound(motion: Motion, turn: float, cut_in: float) -> Motion:
    """Return the drum's way within an outline of which one edge turns about it by an angle [rad].

    The other edges are straight, and the line of the bent one's first part cuts into the drum [m],
    before its end or beyond it.
    """
    at = 0.5 * np.pi + np.array([0.5, -0.5]) * turn
    ends = RADIUS * np.column_stack([np.cos(at), np.sin(at)])
    lean = np.array([math.copysign(math.acos(1.0 - abs(cut_in) / RADIUS), cut_in), 0.0])
    along = 2.0 * RADIUS * np.column_stack([np.sin(at + lean), -np.cos(at + lean)])
    p = np.array([ends[0] - along[0], ends[1] + along[1], [0.0, -4.0 * RADIUS]])
    contacts = np.repeat(0.5 * (p + np.roll(p, -1, axis=0))[:, None], 2, axis=1)
    contacts[0] = ends
    pose = carried(motion).poses.coefficients[:, 0]

    def placed(x: Array) -> PiecewisePolynomial:
        level = np.einsum("...i,pk->p...ik", x, pose[:, 3])
        level += np.einsum("...i,pk->p...ik", x[..., ::-1] * [-1.0, 1.0], pose[:, 4])
        up = np.full((*level.shape[:-2], 1, level.shape[-1]), 0.15)
        origin = np.expand_dims(pose[:, :3], tuple(range(1, x.ndim)))
        return carried(motion).poses.replaced(np.concatenate([level, up], axis=-2) + origin)

    return carried(motion).replaced(vertices=placed(p), contacts=placed(contacts))


@pytest.mark.parametrize(
    ("turn", "cut_in", "holds"),
    [(t, 0.0, 0.0 < t < 180.0) for t in (-40.0, -4.0, 4.0, 60.0, 176.0, 184.0)]
    + [(60.0, cut, abs(cut) < 2e-5) for cut in (-3e-5, -1e-5, 1e-5, 3e-5)],
)
def test_edges_bend_toward_the_drum_by_half_a_turn_at_most_and_stay_out_of_it(
    motion: Motion, turn: float, cut_in: float, holds: bool
) -> None:
    """Those that bend away would pull it; of symmetric ones the forces balance all the same."""
    found = check(wound(motion, math.radians(turn), cut_in), "grip").worst
    assert (found >= 0.0) == holds


@pytest.mark.parametrize("size", [0.5, 3.0])
@pytest.mark.parametrize(("aside", "apart"), [(0.9, 0.0), (1.1, 0.0), (0.0, 0.9), (0.0, 1.1)])
def test_edges_without_load_are_straight(size: float, aside: float, apart: float) -> None:
    """They pass one point within 0.02 mm of the line between their ends, however long they are."""
    triangle = ho.regular_polygon(3, size / math.sqrt(3.0))
    flight = ho.solve(
        ho.Hitch.spread(ho.Team(3, 1.5 + size), triangle), ho.Transport([0.3, 0.2, 1.0])
    ).motion
    p = flight.vertices.coefficients
    onward = np.roll(p, -1, axis=1) - p
    along = onward[..., :1] / np.linalg.norm(onward[..., :1], axis=2, keepdims=True)
    off = np.stack([0.0 * along, 2e-5 * apart * along], axis=2)
    off[..., 2, :] += 2e-5 * aside
    contacts = (p + 0.5 * onward)[:, :, None] + off
    bent = replace(flight, contacts=flight.vertices.replaced(contacts))
    equilibrium = check(bent, "equilibrium")
    assert equilibrium.holds == (max(aside, apart) < 1.0)
    assert equilibrium.holds or equilibrium.where == ("edge 0 bends without an object",)
    assert GRIP.check(bent) is None


def test_a_stop_uses_only_the_remaining_friction(motion: Motion) -> None:
    """Half by its push and half by its turn: a drum may be pushed and turned at once."""
    flown = carried(motion)
    ((path, slack),) = carried_paths(flown)
    for piece, (first, last) in enumerate(pairwise(path.breaks.tolist())):
        t = np.linspace(first, last, 40)
        a = flown.poses.differentiated(2).at(t)[:, 0, 2]
        half = 0.5 * np.min((ratios(flown, t) / 1.5 - 1.0) * DRUM * (GRAVITY + a))
        pushed, turned = DRUM * slack[piece, :2]
        assert 0.0 < pushed <= half
        assert 0.9 * half < RADIUS * turned <= half


def test_too_heavy_objects_are_refused_with_the_capacity_of_fit() -> None:
    cables: Any = {"cable_length": 1.6, "cable_density": 0.004, "clasp_friction": 0.1}
    limits = ho.Limits(tilt_deg=60)
    found = ho.fit(RADIUS, 3, tension=1.3, limits=limits, compared=(), **cables).holding
    grip, rim = (found.capacity(by).mass for by in ("grip", "rest"))
    with pytest.raises(ho.InfeasibleError) as refused:
        ho.solve(ho.problem_from_dict(drum(mass=0.7)))
    assert f"(a grip holds {grip:.2g} kg, a rim {rim:.2g} kg)" in str(refused.value)


CIRCLE = 0.3
X = np.linspace(0.0, 1.0, 41)


def arcs(seed: int, spread: float, least: float = 0.0) -> Array:
    """Rows (200, 5, 6) of ``wrapped_arcs``: chords of a circle, and a polygon's sides."""
    rng = np.random.default_rng(seed)
    rows = np.zeros((200, 5, 6))
    along = rng.normal(size=(200, 3, 1))
    along *= rng.uniform(least, 1.7 * CIRCLE, (200, 1, 1)) / np.linalg.norm(along, axis=1)[:, None]
    rows[:, :3] = along + spread * rng.uniform(-1.0, 1.0, (200, 3, 6))
    rows[:100, 3] = CIRCLE
    rows[100:, :3], rows[100:, 4] = 0.0, rng.uniform(0.0, 2.0, (100, 1))
    return rows


def exact(rows: Array) -> Array:
    """Lengths (200, times) at times X."""
    there = rows @ bernstein.basis(X, rows.shape[-1] - 1).T
    on_circle = 2.0 * CIRCLE * np.arcsin(np.linalg.norm(there[:, :3], axis=1) / (2.0 * CIRCLE))
    return np.where(rows[:, 3, :1] > 0.0, on_circle, rows[:, 4, :1])


@pytest.mark.parametrize("spread", [0.0, 1e-5, 1e-3, 0.03])
def test_arcs_are_enclosed_and_at_a_point_known(spread: float) -> None:
    rows = arcs(3, spread)
    found, lengths = arc_lengths(rows), exact(rows)
    there = (found.c @ bernstein.basis(X, found.degree).T)[:, 0]
    assert np.all(np.abs(there - lengths) <= np.asarray(found.r)[:, None] + 1e-14)
    points = arc_lengths((rows @ bernstein.basis(X, 5).T)[..., 7:8])
    np.testing.assert_allclose(points.c[:, 0, 0], lengths[:, 7], rtol=1e-12)
    assert np.max(points.r) < 1e-11


def test_short_arcs_have_tight_bounds_and_chords_beyond_the_diameter_none() -> None:
    """The error falls with the square of how much a chord varies, as its norm's does."""
    chords = (arcs(5, spread, 0.5 * CIRCLE)[:100] for spread in (1e-3, 1e-4))
    wide, narrow = (np.max(arc_lengths(each).r) for each in chords)
    assert narrow < 1.1e-2 * wide
    assert wide < 1e-5
    rows = np.zeros((1, 5, 2))
    rows[0, 0], rows[0, 3] = [0.5, 0.7], CIRCLE
    assert np.all(np.isinf(arc_lengths(rows).r))
