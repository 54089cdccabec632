"""Ropes: limits of a preset, first shapes, links, and the length that bends of thick ropes take."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

import hitchopt as ho
from hitchopt.hitch import GRAVITY
from hitchopt.lab.simulation import ropes as shapes
from hitchopt.lab.simulation.flight import fly
from hitchopt.lab.simulation.ropes import Ropes
from hitchopt.lab.simulation.settings import ACCURATE, FAST, Preset, Settings
from hitchopt.lab.simulation.task import TeamTask
from hitchopt.values import Array
from tests.helpers.plans import planned
from tests.helpers.scripted import regular_hitch, resting_task

PRESETS = pytest.mark.parametrize("preset", [FAST, ACCURATE], ids=lambda preset: preset.name)


def ropes_of(team: ho.Team, **given: object) -> Ropes:
    return Ropes.of(team, Settings(**given), team.cable_length)  # type: ignore[arg-type]


def test_too_light_ropes_are_refused_with_a_feasible_density() -> None:
    team, coarse = ho.Team(3, 2.4, cable_density=0.01), replace(FAST, time_step=0.004)
    with pytest.raises(ho.InputError, match=r"density = 0\.01: must be at least") as caught:
        ropes_of(team, preset=coarse).check_tension(0.5)
    least = float(caught.value.bound.split()[2])
    heavy = ropes_of(team, preset=coarse, density=1.001 * least)
    heavy.check_tension(0.5)
    # The wave's speed is sqrt(T/density), and 0.7 of a segment of 30 mm is passed in a step.
    assert heavy.largest_tension == pytest.approx(1.001 * least * (0.7 * 0.03 / 0.004) ** 2)
    assert 1.0 <= heavy.largest_tension < 1.01
    with pytest.raises(ho.InputError, match="heavier cables"):
        ropes_of(team, density=0.0005).check_tension(0.5)
    for density, count in ((0.01, 1), (0.001, 2), (0.0005, 3), (0.00002, 8)):
        light = Ropes.of(team, Settings(density=density), team.cable_length, 0.5)
        assert light.preset.time_step == pytest.approx(FAST.time_step / count)
        assert (light.substeps(0.5) == 1) is (count < 8)  # at most 8
        assert light.substeps(-0.1) == 1


def test_accurate_ropes_of_5_g_a_metre_take_smaller_steps_at_06_newton() -> None:
    """With steps of 0.4 ms, clasps jerked by up to 12 N, and simulations ended as invalid."""
    team = ho.Team(3, 2.4, cable_density=0.005, tension=0.6)
    for preset, steps in ((FAST, 1), (ACCURATE, 2)):
        ropes = Ropes.of(team, Settings(preset=preset), team.cable_length, 0.6)
        assert ropes.preset.time_step == pytest.approx(preset.time_step / steps)


@pytest.mark.parametrize(
    ("density", "given", "expected"),
    [
        (0.004, {}, (0.004, 0.3)),
        (0.004, {"density": 0.02}, (0.02, 0.3)),
        (0.004, {"friction": 0.0}, (0.004, 0.0)),
    ],
)
def test_density_and_friction_are_those_given_or_the_teams(
    density: float, given: dict[str, float], expected: tuple[float, float]
) -> None:
    ropes = ropes_of(ho.Team(3, 2.4, cable_density=density, cable_friction=0.3), **given)
    assert (ropes.density, ropes.friction) == expected


@PRESETS
@pytest.mark.parametrize("tension", [0.12, 0.6])
def test_ropes_of_weightless_cables_are_the_lightest_for_the_time_step(
    preset: Preset, tension: float
) -> None:
    team = ho.Team(3, [1.7, 2.43, 2.0], tension=tension)
    ropes = [Ropes.of(team, Settings(preset=preset), s * team.cable_length) for s in (0.98, 1.02)]
    densities = {float(each.density) for each in ropes}
    assert len(densities) == 1  # whatever the errors of their lengths
    (density,) = densities
    for scale in (1.0, 0.85):
        count = math.ceil(math.sqrt(preset.reserve / 2.0 / scale))
        given = Settings(preset=preset, density=scale * density)
        for size in (0.98, 1.02):
            light = Ropes.of(team, given, size * team.cable_length, tension)
            assert light.preset.time_step == pytest.approx(preset.time_step / count)
    stronger = Ropes.of(team, Settings(preset=preset), team.cable_length, 2.0 * tension)
    assert stronger.density == pytest.approx(2.0 * density, rel=0.1)  # in two digits


def assert_exact(cables: list[Array], ropes: Ropes) -> None:
    for cable, count, length in zip(cables, ropes.segments, ropes.segment_lengths, strict=True):
        assert cable.shape == (count + 1, 3)
        steps = np.linalg.norm(np.diff(cable, axis=0), axis=-1)
        np.testing.assert_allclose(steps, length, rtol=1e-9)


def dense(cable: Array, parts: int = 12) -> Array:
    share = np.arange(parts)[None, :, None] / parts
    return (cable[:-1, None] * (1.0 - share) + cable[1:, None] * share).reshape(-1, 3)


def uneven_hitch(n: int, roll: float) -> ho.Hitch:
    """Return an irregular hitch whose legs rise, with a roll [°] of all clasps."""
    shifts = np.random.default_rng(n).uniform(-0.03, 0.03, (n, 2))
    outline = ho.regular_polygon(n, 1.3).vertices + shifts
    team = ho.Team(n, 2.2, cable_density=0.018)
    return ho.Hitch.spread(team, outline, 1.8, roll=np.full(n, np.radians(roll)))


def hitch_with_short_edge(edge: float, roll: float) -> ho.Hitch:
    """Return a pentagon one of whose edges is short [m], with a roll [°] of all clasps."""
    outline = [[2.0, -1.3], [1.2, -1.3 - edge], [1.2 - edge, -1.2 - edge], [0.4, 0.3], [1.4, 0.6]]
    team = ho.Team(5, 2.9, cable_density=0.018)
    return ho.Hitch.spread(team, outline, 1.8, roll=np.full(5, np.radians(roll)))


CHAIN = ho.Team(3, 2.4, topology="open", cable_density=0.01)
ARC = [[0.0, 0.0], [0.8, 1.2], [2.2, 1.3], [3.0, 0.0]]
HITCHES: dict[str, Callable[[], ho.Hitch]] = {
    **{f"regular {n}": partial(regular_hitch, n) for n in (3, 6)},
    "chain": partial(ho.Hitch.balanced, CHAIN, ARC, altitude=1.0),
    **{f"{n} by {x}": partial(uneven_hitch, n, x) for n, x in ((3, -30.0), (12, 20.0))},
    **{f"edge {x} by {y}": partial(hitch_with_short_edge, x, y) for x, y in ((0.06, 35), (0.1, 0))},
}


@PRESETS
@pytest.mark.parametrize("name", HITCHES)
def test_initial_cables_are_linked_separate_and_end_near_their_drones(
    name: str, preset: Preset
) -> None:
    hitch = HITCHES[name]()
    ropes, layout = ropes_of(hitch.team, preset=preset), hitch.team.layout
    cables = shapes.clasped(ropes, layout, hitch.drones, hitch.vertices)
    assert_exact(cables, ropes)
    expected = np.zeros((len(cables),) * 2, dtype=int)
    expected[layout.behind, layout.ahead] = expected[layout.ahead, layout.behind] = 1
    linking = shapes.linking_matrix(cables)
    np.testing.assert_array_equal(np.abs(linking), expected)
    for i, j in zip(layout.behind, layout.ahead, strict=True):
        assert np.min(cKDTree(dense(cables[i])).query(dense(cables[j]))[0]) > preset.diameter
    if name.startswith("regular"):
        assert len(set(linking[linking != 0])) == 1  # all of one sense
        ends = np.concatenate([cable[[0, -1]] for cable in cables])
        assert np.max(np.linalg.norm(ends - hitch.drones, axis=-1)) < 0.12


@pytest.mark.parametrize("across", [(1.2, 0.0, 0.0), (0.3, -0.4, 0.5), (1.5, 0.9, -0.4)])
def test_hanging_cables_end_at_their_drones(across: tuple[float, float, float]) -> None:
    """Their lengths are exact, and their slope grows evenly, as along a catenary."""
    ropes = Ropes(np.array([2.0]), 0.01, 0.0, replace(ACCURATE, segment=0.002))
    q = np.array([0.4, -0.7, 3.0])
    (cable,) = shapes.hanging(ropes, np.array([q, q + across]), 0.0)
    assert_exact([cable], ropes)
    np.testing.assert_allclose(cable[[0, -1]], [q, q + across], atol=1e-4)
    steps = np.diff(cable, axis=0)
    bends = np.diff(steps[:, 2] / np.hypot(*steps[:, :2].T))
    np.testing.assert_allclose(bends, np.mean(bends), rtol=1e-3)
    with pytest.raises(shapes.ShapeError, match=r"cable 0: its drones start 2\.1 m apart"):
        shapes.hanging(ropes, np.array([q, q + [2.1, 0.0, 0.0]]), 0.0)


@PRESETS
@pytest.mark.parametrize(
    ("q", "r", "length"),
    [
        ((0.0, 0.0, 1.0), (0.7, 0.3, 1.0), 3.1),  # longer than a straight cable on the ground
        ((0.0, 0.0, 1.0), (0.7, 0.3, 0.6), 2.2),
        ((0.0, 0.0, 1.0), (-1.9, 0.3, 0.05), 2.6),
        ((0.0, 0.0, 0.1), (1.2, 0.5, 0.1), 2.0),
        ((0.0, 0.0, 0.0), (1.9, 0.0, 0.0), 2.0),  # drones that stand on the ground
    ],
)
def test_long_cables_hang_to_the_ground_and_lie_on_it(
    q: tuple[float, ...], r: tuple[float, ...], length: float, preset: Preset
) -> None:
    ropes = Ropes(np.array([length]), 0.01, 0.0, preset)
    (cable,) = shapes.hanging(ropes, np.array([q, r]), -0.03)
    assert_exact([cable], ropes)
    link = float(ropes.segment_lengths[0])
    assert np.max(np.abs(cable[[0, -1]] - [q, r])) < link  # settling corrects it
    floor = -0.03 + 0.5 * preset.diameter
    lying = np.flatnonzero(cable[:, 2] < floor + 1e-9)
    assert np.min(cable[:, 2]) == pytest.approx(floor, abs=1e-9)
    np.testing.assert_array_equal(np.diff(lying), 1)  # all of it in one piece
    assert len(lying) > 0.1 * len(cable)
    along = np.subtract(r, q)[:2] / np.hypot(*np.subtract(r, q)[:2])
    off = (cable[:, :2] - np.array(q)[:2]) @ [-along[1], along[0]]
    assert (
        np.max(np.abs(off)) < (shapes.FOLD_LINKS + 1) * link
    )  # to and fro beside the straight line
    for rising in (cable[lying[-1] :], cable[lying[0] :: -1]):  # a catenary: an even pull
        steps = np.diff(rising, axis=0)
        slopes = steps[:, 2] / np.maximum(np.hypot(*steps[:, :2].T), 1e-12)
        assert np.all(np.diff(slopes) > 0.0)
        np.testing.assert_allclose(np.diff(slopes[:6], n=2), 0.0, atol=1e-6 * slopes[-1])


@pytest.mark.parametrize("seed", range(30))
def test_linking_numbers_of_random_polygons_are_those_of_their_crossings(seed: int) -> None:
    """Half the signed crossings seen from above are the same number, however one turns both."""
    random, turn = np.random.default_rng(seed), Rotation.random(random_state=seed)
    one, other = random.normal(size=(7, 3)), 0.3 + random.normal(size=(9, 3))
    a, c = one[:, None], other[None]
    u, v, w = np.roll(one, -1, axis=0)[:, None] - a, np.roll(other, -1, axis=0)[None] - c, c - a
    area, s, t = (np.cross(x, y)[..., 2] for x, y in ((u, v), (w, v), (w, u)))
    s, t = s / area, t / area
    met = (s > 0.0) & (s < 1.0) & (t > 0.0) & (t < 1.0)
    above = np.sign((a + s[..., None] * u - c - t[..., None] * v)[..., 2])
    expected = 0.5 * np.sum((np.sign(area) * above)[met])
    assert shapes.linking_number(one, other) == expected
    assert shapes.linking_number(turn.apply(one) - 0.7, turn.apply(other) - 0.7) == expected


@pytest.mark.parametrize("n", [3, 5, 12])
def test_thick_cables_are_longer_by_their_bends_and_lead_legs_past_the_vertex(n: int) -> None:
    """Drawn as polygons: a circle of one diameter about the other cable, and tangents to it."""
    hitch, turn, diameter = regular_hitch(n), 2.0 * np.pi / n, 0.01
    (task,) = resting_task(hitch, 0.1).teams
    angle = np.linspace(0.5 * turn, np.pi - 0.5 * turn, 2001) + 0.5 * np.pi
    arc = 0.5 * diameter + diameter * np.exp(1j * angle)
    far = np.exp(0.5j * turn)
    longer = np.sum(np.abs(np.diff([far, *arc, far.conjugate()]))) - 2.0
    np.testing.assert_allclose(shapes.bend_lengths(task, diameter, 0.0), longer, atol=1e-4)
    allowance = shapes.thickness_allowance(task, diameter, 0.0)
    np.testing.assert_allclose(allowance, 2.0 * longer, atol=2e-4)
    coarse = shapes.thickness_allowance(task, diameter, 0.02)
    expected = 2.0 * shapes.COARSENESS * 0.02**2 / diameter * np.cos(0.5 * turn)
    np.testing.assert_allclose(coarse - allowance, expected)
    (free,) = resting_task(hitch, 0.1, formed=False).teams
    np.testing.assert_array_equal(
        shapes.thickness_allowance(free, FAST.diameter, 0.03), np.zeros(n)
    )
    # A leg on the tangent at the arc's end passes the vertex at this distance, on the outside.
    distance = (arc[0] * far.conjugate()).imag
    offsets = shapes.leg_end_offsets(task, diameter)[-1]
    np.testing.assert_allclose(np.linalg.norm(offsets, axis=-1), distance, rtol=0.02)
    np.testing.assert_allclose(np.sum(offsets * hitch.leg_directions, axis=-1), 0.0, atol=1e-12)
    outward = (hitch.vertices - np.mean(hitch.vertices, axis=0))[hitch.team.layout.anchors]
    assert np.all(np.sum(offsets * outward, axis=-1) > 0.0)
    half = replace(task, states=replace(task.states, tensions=0.5 * task.states.tensions))
    np.testing.assert_allclose(shapes.leg_end_offsets(half, diameter)[-1], 0.5 * offsets)
    np.testing.assert_array_equal(shapes.leg_end_offsets(free, diameter), 0.0)


@pytest.mark.slow
@pytest.mark.parametrize(("preset", "longer"), [(FAST, 0.015), (ACCURATE, 0.01)])
def test_thick_cables_act_like_thin_ones(preset: Preset, longer: float) -> None:
    """Legs, edges and their arcs add up to the plan's length, and vertices are not drawn inward."""
    task = resting_task(regular_hitch(3, cable_friction=0.0), 0.1)
    flight = fly(task, Settings(preset, pull_test=False))
    record, layout = flight.record, task.team.layout
    rows = (record.t > 0.1) & (record.t <= flight.rested)
    drones, vertices = (np.mean(x[rows], axis=0) for x in (record.drones, record.vertices))
    corners = drones[0::2], vertices[layout.starts], vertices[layout.ends], drones[1::2]
    chords = np.linalg.norm(np.diff(np.stack(corners, axis=1), axis=1), axis=-1)
    sag = (GRAVITY * flight.density / np.mean(record.tensions[rows], axis=0)[:, None]) ** 2
    lengths = np.sum(chords + sag * chords**3 / 24.0, axis=-1)
    np.testing.assert_allclose(lengths, task.team.cable_length, atol=4e-3)
    assert flight.extra_length > longer  # the allowance compensates the bends
    vertices = task.states.vertices[-1]
    planned = np.linalg.norm(vertices - np.mean(vertices, axis=0), axis=-1)
    outward = np.linalg.norm(vertices - np.mean(vertices, axis=0), axis=-1) - planned
    assert np.max(np.abs(outward)) < 0.01
    cables = flight.film.cables
    ends = flight.film.nodes[-1][np.column_stack([cables[:-1], cables[1:] - 1]).ravel()]
    end_offsets = ends - record.drones[-1]  # without offsets vertices are 14 mm inward
    expected = shapes.leg_end_offsets(task.teams[0], preset.diameter)[-1]
    np.testing.assert_allclose(end_offsets, expected, atol=1e-3)
    assert flight.end_offset == pytest.approx(0.0068, abs=1e-4)


@pytest.mark.slow
def test_gripping_cables_are_longer_by_bends_around_objects_and_clasps() -> None:
    """Cables of a drum's grip follow the path that their thickness makes of the plan's lines."""
    motion = planned("grip_drum").motion
    task, layout = TeamTask.of(motion), motion.team.layout
    assert motion.has_wraps
    (carried,) = np.nonzero(task.cargo.carried.any(axis=1))
    t = float(task.states.t[carried[len(carried) // 2]])
    vertices, drones = motion.vertices.at(t), motion.drones.at(t)
    first, last = np.moveaxis(motion.contacts.at(t), 1, 0)
    path = np.diff(np.stack([drones[0::2], vertices[layout.starts], first], axis=1), axis=1)
    path /= np.linalg.norm(path, axis=-1, keepdims=True)
    turn = np.arccos(np.sum(path[:, 0] * path[:, 1], axis=-1))  # from leg to edge
    offset = 0.5 * (first + last)[:, :2] - motion.poses.at(t)[0, :2]
    (drum,) = motion.requirements.objects.values()
    wrapped = 2.0 * np.arccos(np.linalg.norm(offset, axis=1) / drum.section.rounding)
    allowance = shapes.thickness_allowance(task, FAST.diameter, 0.0)
    expected = 2.0 * FAST.diameter * (turn - np.sin(0.5 * turn)) + 0.5 * FAST.diameter * wrapped
    np.testing.assert_allclose(allowance, expected, atol=1e-3)
    straight = shapes.thickness_allowance(replace(task, motion=None), FAST.diameter, 0.0)
    assert np.all(allowance > straight + 0.015)
