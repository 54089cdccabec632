"""Cables that slide through clasps: laws of rest, friction and energy, and flights of seeds."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import hitchopt as ho
from hitchopt.errors import InputError
from hitchopt.hitch import GRAVITY, Hitch
from hitchopt.lab.simulation import clasps
from hitchopt.lab.simulation.campaign import Distribution, run_campaign, save_campaign
from hitchopt.lab.simulation.clasps import AXIAL_STIFFNESS, ClaspWorld
from hitchopt.lab.simulation.flight import fly, fly_seeds
from hitchopt.lab.simulation.judgement import vertex_errors, warnings
from hitchopt.lab.simulation.report import Simulation, ending
from hitchopt.lab.simulation.settings import CLASPS, INDOOR, Loss, Settings
from hitchopt.lab.simulation.task import Task
from hitchopt.lab.simulation.world import RigidBodies
from hitchopt.values import Array
from tests.helpers.plans import planned
from tests.helpers.scripted import regular_hitch, resting_task

STIFFNESS = 2000.0  # Of the springs that hold drones [N/m]
SLIDING = Settings(cables=CLASPS, friction=0.0)


def pointed(density: float = 0.005, **of_team: object) -> Hitch:
    """Return a triangle with a pointed vertex, whose legs rise."""
    team = ho.Team(3, 2.4, tension=0.4, cable_density=density, **of_team)  # type: ignore[arg-type]
    return Hitch.balanced(team, [[0.0, 0.8], [0.45, -0.3], [-0.45, -0.3]], altitude=1.5)


def narrow() -> Hitch:
    """Return a hitch with an edge of 12 cm, which is stiff beside its legs."""
    corners = [[-0.2, -0.8], [-0.06, 0.8], [0.06, 0.8], [0.2, -0.6]]
    return Hitch.balanced(ho.Team(4, 2.54, tension=0.4), corners, altitude=1.5)


def chain() -> Hitch:
    """Return a chain of three cables, whose ends have no legs."""
    team = ho.Team(3, 1.4, topology="open", tension=0.4, cable_density=0.005)
    return Hitch.balanced(team, [[-0.9, -0.3], [-0.4, 0.0], [0.4, 0.0], [0.9, -0.3]], altitude=1.5)


def world_of(hitch: Hitch, offsets: Array | float = 0.0, friction: float = 0.0) -> ClaspWorld:
    """Return the world of a hitch whose vertices are displaced by offsets (points, 3) [m]."""
    team, still = hitch.team, np.zeros_like(hitch.drones)
    bodies = RigidBodies(hitch.drones, still, np.tile(np.eye(3), (len(still), 1, 1)), still)
    lengths = (team.cable_length / (1.0 + team.tension / AXIAL_STIFFNESS))[None]
    density = float(team.cable_density)
    world = ClaspWorld(team, hitch.vertices + offsets, bodies, lengths, team.tension, density)
    world.friction = friction
    return world


def held(world: ClaspWorld, hitch: Hitch, seconds: float, shift: Array | float = 0.0) -> None:
    """Let a world rest while springs hold its drones, displaced by a ``shift`` (2n, 3) [m]."""
    damping = 2.0 * np.sqrt(STIFFNESS * world.masses)[:, None]
    weights = GRAVITY * world.masses[:, None] * [0.0, 0.0, 1.0]
    still = np.zeros_like(hitch.drones)
    for _ in range(round(seconds / 0.002)):
        bodies = world.bodies
        pull = STIFFNESS * (hitch.drones + shift - bodies.positions) - damping * bodies.velocities
        world.push(np.zeros(len(still)), still, pull + weights - hitch.cable_forces)
        world.step(0.002)


def use_of_friction(world: ClaspWorld, hitch: Hitch, friction: float) -> Array:
    """Return the share (clasps,) of the largest friction that holds weightless cables."""
    layout, nodes, tensions = hitch.team.layout, world.nodes[0], world.tensions.reshape(-1, 3)
    cosines, used = np.zeros((2, 2, len(layout.clasps)))
    for row, (cables, leg) in enumerate(((layout.ahead, 0), (layout.behind, 2))):
        vectors = np.diff(nodes[cables], axis=1)
        units = vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
        cosines[row] = np.sum(units[:, leg] * units[:, 1], axis=-1)
        bends = np.pi * np.sin(0.5 * np.arccos(cosines[row]))  # along half a turn of a helix
        ratio = tensions[cables, leg] / tensions[cables, 1]
        used[row] = np.log(ratio) / (friction * bends)
    (x, y), crossing = used, np.mean(cosines, axis=0)
    shares: Array = np.sqrt((x**2 + y**2 + 2.0 * x * y * crossing) / (1.0 - crossing**2))
    return shares


def legs_of(world: ClaspWorld, hitch: Hitch) -> Array:
    """Return the lengths (2, clasps) [m] of the legs of both cables of every clasp."""
    layout = hitch.team.layout
    lengths = np.linalg.norm(np.diff(world.nodes[0], axis=1), axis=-1)
    return np.stack([lengths[layout.ahead, 0], lengths[layout.behind, 2]])


@pytest.mark.parametrize(
    "hitch",
    [pointed(), pointed(0.0), chain(), narrow()],
    ids=["heavy", "light", "chain", "narrow"],
)
def test_without_friction_vertices_rest_where_they_are_planned(
    hitch: Hitch, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Displaced ones return to the equilibrium of the catenary model, within a millimetre."""
    monkeypatch.setattr(clasps, "AIR_DECAY", 8.0)  # they vibrate for less time
    offsets = np.zeros((hitch.team.layout.points, 3))
    offsets[hitch.team.layout.clasps[0]] = [0.02, -0.05, 0.0]
    world = world_of(hitch, offsets)
    held(world, hitch, 3.0)
    clasps_of_plan = hitch.vertices[hitch.team.layout.clasps]
    np.testing.assert_allclose(world.vertices[0], clasps_of_plan, atol=1e-3)
    planned = hitch.team.tension[:, None] * hitch.team.layout.exists
    np.testing.assert_allclose(world.tensions, planned[planned > 0.0][None], rtol=0.03)


@pytest.mark.slow
def test_cables_pull_as_planned_while_their_tensions_rise() -> None:
    """From the tension of cables that hang, as drones arrive, which are hardly held back by it."""
    flight = fly(Task.of(planned("form_triangle").flight), SLIDING)
    record, states = flight.record, flight.task.states
    planned_tensions = states.tensions[record.index]
    np.testing.assert_allclose(record.tensions[0], planned_tensions[0], rtol=0.05)
    np.testing.assert_allclose(record.tensions, planned_tensions, rtol=0.25)
    assert planned_tensions[0, 0] < 0.6 * planned_tensions[-1, 0]
    off = np.linalg.norm(record.drones - states.positions[record.index], axis=-1)
    assert np.max(off) < 0.02


def test_both_cables_of_a_clasp_share_a_bound_of_friction() -> None:
    """Sliding ones are on the ellipse of a helix's crossing tangents, resting ones within it."""
    hitch, friction = pointed(0.0), 0.2
    world = world_of(hitch, friction=friction)
    legs = legs_of(world, hitch)
    outward = 0.25 * (hitch.drones - hitch.vertices[hitch.team.layout.pulled_to])
    moving = np.zeros_like(outward)
    moving[0] = 1.0  # q0 pulls its cable through two clasps
    for step in range(1, 301):
        held(world, hitch, 0.01, outward * moving * step / 300)
    used = use_of_friction(world, hitch, friction)
    assert np.all(used <= 1.01)
    slides = np.max(np.abs(legs_of(world, hitch) - legs), axis=0) > 0.05
    assert slides.any()
    np.testing.assert_allclose(used[slides], 1.0, atol=0.03)


def test_slips_of_short_edges_converge(monkeypatch: pytest.MonkeyPatch) -> None:
    """Vertices are those of many more iterations, while cables stick and slip at all clasps."""
    corners = [[-0.2, -0.8], [-0.12, 0.8], [0.12, 0.8], [0.2, -0.6]]
    team = ho.Team(4, 2.54, tension=0.4, cable_density=0.005)
    hitch = Hitch.balanced(team, corners, altitude=1.5)
    ways = np.sin(np.arange(24.0)).reshape(8, 3)
    ends = []
    for tolerance in (clasps.SLIP_TOLERANCE, 0.0):
        monkeypatch.setattr(clasps, "SLIP_TOLERANCE", tolerance)
        world = world_of(hitch, friction=0.1)
        for step in range(60):
            held(world, hitch, 0.01, 0.03 * np.sin(0.1 * step) * ways)
        ends.append(world.vertices)
    np.testing.assert_allclose(ends[0], ends[1], atol=3e-4)


@pytest.mark.slow
@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_friction_holds_vertices_in_the_band_of_statics(
    sense: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From outside, they creep to its ends, where both cables of every clasp slide alike."""
    monkeypatch.setattr(clasps, "AIR_DECAY", 50.0)
    polygon = ho.regular_polygon(3, 1.0)
    team = ho.Team(3, 2.4, tension=0.4, cable_density=0.005, cable_friction=0.1)
    plan = ho.solve(ho.HitchStart(polygon, 1.5), ho.Hold(0.3), team=team)
    stiff = {"stiffness": STIFFNESS, "axial_stiffness": AXIAL_STIFFNESS}
    rest = ho.equilibrium(plan, 0.0, **stiff, friction=0.04)
    outward = plan.end.vertices - np.mean(plan.end.vertices, axis=0)
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    world = world_of(plan.end, 0.1 * sense * outward, 0.04)
    held(world, plan.end, 5.0)
    moved = np.sum((world.vertices[0] - plan.end.vertices) * outward, axis=1)
    np.testing.assert_allclose(moved, rest.band[:, 1 if sense > 0.0 else 0], atol=5e-3)


def test_vertices_that_friction_holds_are_in_balance() -> None:
    """The pulls of leg and edge of both cables of a clasp cancel."""
    hitch = pointed(0.0)
    world = world_of(hitch, np.array([[0.0, -0.04, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]), 0.1)
    held(world, hitch, 2.0)
    assert np.linalg.norm(world.vertices[0, 0] - hitch.vertices[0]) > 0.02
    layout, nodes, tensions = hitch.team.layout, world.nodes[0], world.tensions.reshape(-1, 3, 1)
    vectors = np.diff(nodes, axis=1)
    pulls = tensions * vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
    ahead = pulls[layout.ahead, 1] - pulls[layout.ahead, 0]
    behind = pulls[layout.behind, 2] - pulls[layout.behind, 1]
    np.testing.assert_allclose(ahead + behind, 0.0, atol=1e-3)
    np.testing.assert_allclose(world.bearing[0], np.linalg.norm(ahead, axis=1))


BRISK = replace(
    Settings(cables=CLASPS, controller="mellinger"),
    perturbations=replace(INDOOR, start_error=0.0),
)


def test_flights_do_not_depend_on_those_beside_them() -> None:
    task = resting_task(regular_hitch(3), 0.3)
    both = fly_seeds(task, BRISK, [7, 8])
    for seed, flight in zip((7, 8), both, strict=True):
        alone = fly(task, replace(BRISK, seed=seed))
        for name in ("drones", "vertices", "tensions", "thrusts", "bearing"):
            values, expected = (getattr(each.record, name) for each in (flight, alone))
            np.testing.assert_allclose(values, expected, atol=1e-6)
        assert flight.settings == alone.settings
    assert np.max(np.abs(both[0].record.drones - both[1].record.drones)) > 1e-3


def test_a_flight_is_judged_where_the_hitch_is_tied() -> None:
    """It flies from the first sample with a hitch, and at the end every vertex holds."""
    hitch = regular_hitch(3)
    flight = fly(resting_task(hitch, 0.6, since=20), SLIDING)
    result = Simulation.judged(flight)
    assert flight.record.t[0] == pytest.approx(0.2)
    assert result.outcome.succeeded
    assert result.outcome.hitched
    assert ending(result) == "every vertex holds"
    assert [rest.phase for rest in result.rests] == ["rest"]
    assert np.max(vertex_errors(flight).errors) < 1e-3
    np.testing.assert_allclose(flight.record.tensions, 0.5, atol=0.01)
    (note,) = (each for each in warnings(flight.task, SLIDING) if "hitch" in each)
    assert "t = 0.2 to 0.6 s" in note


@pytest.mark.slow
def test_a_morph_that_friction_stops_short_is_seen() -> None:
    """A vertex that moved out stays inward by a part of its band; without friction it does not."""
    team = ho.Team(3, 2.4, tension=0.4, cable_density=0.005)
    start = ho.HitchStart([[0.0, 0.58], [0.5, -0.29], [-0.5, -0.29]], 1.5)
    plan = ho.solve(
        start, [ho.Morph([[0.0, 0.75], [0.45, -0.3], [-0.45, -0.3]]), ho.Hold(2.0)], team=team
    )
    task = Task.of(plan.flight)
    errors = [
        Simulation.judged(fly(task, replace(SLIDING, friction=friction))).rests[-1].vertices["p0"]
        for friction in (0.0, 0.1)
    ]
    assert errors[0].mean < 0.01
    assert 0.03 < errors[1].mean < 0.12


@pytest.mark.slow
@pytest.mark.parametrize("friction", [0.0, 0.1])
def test_drones_keep_up_with_over_travels_and_vertices_rest_at_their_goals(friction: float) -> None:
    """Where motors saturate as drones turn back, these fall by 6 cm: out of their tubes."""
    quadrotor = ho.Quadrotor(controller="mellinger", gains={"kp": 4.75, "kd": 1.32, "ki": 0.0})
    tied = pointed(cable_friction=0.1, quadrotor=quadrotor)
    flight = fly(
        Task.of(ho.solve(tied, ho.Settle()).flight),
        Settings(cables=CLASPS, friction=friction, drones="crazyflie"),
    )
    simulation = Simulation.judged(flight)
    assert simulation.outcome.succeeded
    assert max(each.mean for each in simulation.rests[-1].vertices.values()) < 0.02


def test_a_campaign_has_distributions_of_vertices(tmp_path: Path) -> None:
    task, messages = resting_task(regular_hitch(3), 0.3), list[str]()
    campaign = run_campaign(task, BRISK, 4, workers=1, progress=messages.append)
    assert messages == ["4 of 4 flown, 4 succeeded"]
    assert [run.seed for run in campaign.runs] == [0, 1, 2, 3]
    save_campaign(tmp_path, campaign)
    content = json.loads((tmp_path / "campaign.json").read_text(encoding="utf-8"))
    rows = content["vertex_errors"]
    assert [row["vertex"] for row in rows] == ["p0", "p1", "p2"]
    errors = [run.rests[rows[0]["rest"]]["p0"] for run in campaign.runs]
    assert rows[0]["mean"] == pytest.approx(np.mean(errors))
    assert rows[0]["median"] == pytest.approx(np.median(errors))
    assert rows[0]["largest"] == max(errors)
    separations = [run.figures["separation"] for run in campaign.runs]
    assert content["figures"]["separation"]["mean"] == pytest.approx(np.mean(separations))
    assert (tmp_path / "campaign.png").stat().st_size > 10_000
    assert np.isnan(Distribution.of([np.nan]).mean)


def test_what_needs_ropes_is_refused() -> None:
    settings = replace(SLIDING, lost=Loss("0", 0.1))
    with pytest.raises(InputError, match=r"cut = .*simulate ropes"):
        fly(resting_task(regular_hitch(3), 0.2), settings)
    with pytest.raises(InputError, match="a plan without a hitch"):
        fly(resting_task(regular_hitch(3), 0.2, formed=False), SLIDING)
