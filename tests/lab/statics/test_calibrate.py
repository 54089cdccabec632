"""Calibration from tables and from recordings computed from the model: exact without noise."""

from __future__ import annotations

import json
from dataclasses import fields, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result
from scipy.optimize import root

import hitchopt as ho
from hitchopt.cli import main
from hitchopt.geometry.vectors import unit
from hitchopt.hitch import GRAVITY
from hitchopt.hitch.energy import bends_of, energy_of
from hitchopt.lab.flights.readers import HEADER
from hitchopt.lab.flights.recordings import RecordedFlight, Recording, Track, windows_of
from hitchopt.lab.simulation.exported import team_task
from hitchopt.lab.simulation.task import TeamTask
from hitchopt.lab.statics.calibrate import Estimate, friction_pulls
from hitchopt.lab.statics.equilibrium import conditions_of
from hitchopt.motion.states import States
from hitchopt.storage.yaml_file import parse_yaml
from hitchopt.support import Feature
from hitchopt.values import Array

DENSITY, MU, RATE = 0.012, 0.17, 20.0
REST_TIME, MOVE_TIME = 2.0, 6.0  # durations of rest before and after, and of the movement [s]
SOFT, HARD = ho.Quadrotor(mass=0.14), ho.Quadrotor(mass=0.2)
K = np.repeat([4.0, 9.0, 4.0], 2)
POLYGON = np.array([[3.0, -1.1], [2.4, 0.4], [3.5, 0.5]])
ARC = np.array([[1.0, 0.0], [1.6, 1.0], [2.9, 1.1], [3.6, 0.0]])

Pair = tuple[ho.Hitch, ho.Hitch]
Wind = tuple[float, float]


def balance_clasps(
    team: ho.Team, density: float, drones: Array, guess: Array, rates: Array, friction: float
) -> tuple[Array, Array]:
    """Return points (points, 3) [m] with clasps in balance, and forces (2n, 3) [N] on drones."""
    layout, drone_count = team.layout, team.drones
    conditions = conditions_of(team, cable_density=density, stiffness=1.0, feed_forward=False)
    plan = dict.fromkeys(("cable_forces", "offsets", "forces"), 0.0 * drones)
    plan |= {"positions": drones, "vertices": guess, "tensions": team.tension}
    plan |= {"cable_length": team.cable_length}
    energy = energy_of(team, conditions, {name: value[None] for name, value in plan.items()})
    nodes, ahead, behind = energy.nodes, layout.ahead, layout.behind

    def pulls(x: Array) -> Array:
        at = np.concatenate([drones, x.reshape(-1, 3)])[None]
        units = unit(np.diff(at[:, nodes], axis=-2))
        bends = bends_of(units)
        used = np.zeros((team.robots, 2))
        angles = np.stack([bends[0, ahead, 0], bends[0, behind, 1]], axis=-1)
        sliding = np.stack([rates[2 * ahead], rates[2 * behind + 1]], axis=-1)
        used[ahead, 0], used[behind, 1] = friction * (friction_pulls(angles, sliding) / angles).T
        forces = energy.forces(at[:, nodes], team.tension[None], used).on_ends
        return np.asarray(energy.pulls(forces)[0])

    def missing(x: Array) -> Array:
        return pulls(x)[drone_count:].ravel()

    x = root(missing, guess[layout.clasps].ravel(), tol=1e-12).x
    assert np.max(np.abs(missing(x))) < 1e-9
    points = guess.copy()
    points[layout.anchors] = drones  # a chain's ends
    points[layout.clasps] = x.reshape(-1, 3)
    return points, -pulls(x)[:drone_count]


def flight_between(
    pair: Pair,
    density: float,
    friction: float = 0.0,
    wind: Wind = (0.0, 0.0),
    stiffness: Array = K,
) -> tuple[TeamTask, Recording]:
    """Return a plan from one hitch to another that neglects the cables' weight, and its flight.

    Drones have a ``stiffness`` (2n,) [N/m].
    """
    (first, second), team, layout = pair, pair[0].team, pair[0].team.layout
    t = np.arange(round((2.0 * REST_TIME + MOVE_TIME) * RATE) + 1) / RATE
    s = np.clip((t - REST_TIME) / MOVE_TIME, 0.0, 1.0)
    s = s * s * (3.0 - 2.0 * s)
    drones = first.drones + s[:, None, None] * (second.drones - first.drones)
    moving = np.flatnonzero((t > REST_TIME + 0.8) & (t < REST_TIME + MOVE_TIME - 0.8))
    rates = np.zeros(drones.shape[:2])
    for _ in range(2 if friction else 1):  # sliding directions depend on the flight
        points, forces, guess = np.zeros((len(t), layout.points, 3)), 0.0 * drones, first.vertices
        for _ in range(4):
            guess, _ = balance_clasps(team, density, drones[0], guess, rates[0], friction)
        for i, (place, rate) in enumerate(zip(drones, rates, strict=True)):
            guess, forces[i] = balance_clasps(team, density, place, guess, rate, friction)
            points[i] = guess
        # Clasps are about to slide before they do, and stick afterwards.
        rates = np.gradient(np.linalg.norm(drones - points[:, layout.anchors], axis=-1), t, axis=0)
        rates = rates[np.clip(np.arange(len(t)), moving[0], moving[-1])]
    fed_forward = -np.repeat(team.tension, 2)[:, None] * unit(drones - points[:, layout.pulled_to])
    commanded = drones - (forces + [*wind, 0.0] - fed_forward) / stiffness[:, None]
    values: Any = dict.fromkeys((each.name for each in fields(States)), 0.0 * drones)
    values |= {"t": t, "positions": commanded, "cable_forces": fed_forward, "vertices": points}
    values |= {"formed": np.ones(len(t), np.bool_), "tensions": np.tile(team.tension, (len(t), 1))}
    return TeamTask(team, States(**values)), Recording(t, drones, points)


def hitch_pair(topology: str = "closed", *, outward: bool = False) -> Pair:
    """Return two hitches of the same polygon, between which cables slide through their clasps.

    With ``outward`` a vertex moves instead, and both cables of its clasp slide alike.
    """
    points, kinds = POLYGON if topology == "closed" else ARC, [SOFT, HARD, SOFT]
    options: Any = {"topology": topology, "tension": [0.5, 0.6, 0.55], "quadrotor": kinds}
    team = ho.Team(3, [2.6, 2.5, 2.7], **options)
    middle = ho.Hitch.balanced(team, points, 1.3)
    if outward:
        moved_points = points + [[0.0, -0.25], [0.0, 0.0], [0.0, 0.0]]
        return middle, ho.Hitch.balanced(team, moved_points, 1.3)
    shift = np.array([0.12, -0.1, 0.15]) * team.layout.has_leg.all(axis=1)
    before, after = (ho.Hitch(team, points, 1.3, middle.q_legs + s * shift) for s in (-1.0, 1.0))
    return before, after


@cache
def weighted_recording(friction: float = 0.0) -> tuple[TeamTask, Recording]:
    return flight_between(hitch_pair(), DENSITY, friction)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("pair", "friction", "tolerance", "wind"),
    [
        (hitch_pair(), MU, 0.005, (0.05, -0.08)),  # wind does not bias the stiffness
        (hitch_pair(outward=True), MU, 0.015, (0.0, 0.0)),
        (hitch_pair("open"), 0.0, 1e-5, (0.0, 0.0)),
    ],
)
def test_without_noise_stiffness_and_friction_are_nearly_exact(
    pair: Pair, friction: float, tolerance: float, wind: Wind
) -> None:
    task, recording = flight_between(pair, DENSITY, friction, wind)
    result = ho.calibrate(recording, task, density=DENSITY)
    assert all(one.known for one in result.stiffness)
    np.testing.assert_allclose([one.value for one in result.stiffness], K[::2], rtol=0.02)
    assert result.friction.known
    assert result.friction.value == pytest.approx(friction, abs=tolerance)
    assert abs(result.friction.value - friction) < max(result.friction.error, 1e-3)


@pytest.mark.slow
def test_cable_lengths_are_those_of_catenaries() -> None:
    task, recording = weighted_recording()
    rows = {name: getattr(recording, name)[:30] for name in ("t", "drones", "vertices")}
    result = ho.calibrate(replace(recording, **rows), task, density=DENSITY)
    layout, drones, points = task.team.layout, recording.drones[0], recording.vertices[0]
    corners = drones[0::2], points[layout.starts], points[layout.ends], drones[1::2]
    spans = np.diff(np.stack(corners, axis=1), axis=1)
    level, chord = np.hypot(spans[..., 0], spans[..., 1]), np.linalg.norm(spans, axis=-1)
    # The horizontal pull over the weight per length, such that the mean tension is right.
    pull = task.team.tension[:, None] * level / chord / (GRAVITY * DENSITY)
    lengths = np.hypot(spans[..., 2], 2.0 * pull * np.sinh(level / (2.0 * pull)))
    values = [one.value for one in result.lengths]
    np.testing.assert_allclose(values, np.sum(lengths, axis=1), atol=1e-4)


@pytest.mark.slow
def test_standard_errors_are_those_of_repeated_flights() -> None:
    """Over flights with noise of 1.5 mm, deviations are about as large as the stated errors."""
    (task, recording), scores = weighted_recording(MU), []
    for seed in range(6):
        rng, noise = np.random.default_rng(seed), 1.5e-3
        places = recording.drones, recording.vertices
        drones, vertices = (each + noise * rng.normal(size=each.shape) for each in places)
        noisy = replace(recording, drones=drones, vertices=vertices)
        result = ho.calibrate(noisy, task, density=DENSITY)
        soft, hard = result.stiffness[0], result.stiffness[1]
        assert abs(result.friction.value - MU) < 0.05
        scores.append([(soft.value - 4.0) / soft.error, (hard.value - 9.0) / hard.error])
    assert np.all(np.sqrt(np.mean(np.square(scores), axis=0)) < 2.5)
    assert np.max(np.abs(scores)) > 0.2  # the bounds are not vacuous


@pytest.mark.slow
def test_steady_forces_on_drones_whose_plan_knows_the_weight_determine_no_stiffness() -> None:
    """They displace drones by more than the errors of their plan.

    Lines of thick ropes cross up to 2 cm inward of their contact.
    """
    angles = np.radians(90.0 - 72.0 * np.arange(5))
    corners = 0.8 * np.column_stack([np.cos(angles), np.sin(angles)])
    tensions, k = 0.5 * (1.0 + np.array([0.08, -0.1, -0.06, 0.07, 0.05])), 4.75
    hitch = ho.Hitch.balanced(ho.Team(5, 3.0, tension=tensions), corners, 1.5)
    flown = flight_between((hitch, hitch), DENSITY, stiffness=np.full(10, k))
    task, recording = flown
    drones, vertices = recording.drones, recording.vertices
    fed_forward = task.states.cable_forces
    uniform = -0.5 * unit(drones - vertices[:, task.team.layout.pulled_to])  # tensions, to the plan
    weights = k * (drones - task.states.positions)
    commands = replace(
        task.states,
        positions=drones - (fed_forward - uniform) / k,
        cable_forces=uniform + weights,
        tensions=np.full_like(task.states.tensions, 0.5),
    )
    task = replace(task, team=ho.Team(5, 3.0, tension=0.5), states=commands)
    inward = unit(np.mean(vertices, axis=1, keepdims=True) - vertices)
    for seed in range(6):
        rng = np.random.default_rng(seed)
        steady = rng.normal(size=(10, 3)) * 0.03 / k
        noisy = drones + steady + 1e-3 * rng.normal(size=drones.shape)
        crossings = vertices + inward * rng.uniform(0.0, 0.02, (1, 5, 1))
        noisy_recording = replace(recording, drones=noisy, vertices=crossings)
        result = ho.calibrate(noisy_recording, task, density=DENSITY)
        assert "displacements of drones are too small" in result.stiffness[0].remark


@pytest.mark.slow
def test_vertices_weigh_by_their_standard_errors() -> None:
    """A vertex with a large error changes estimates less if its standard error is large."""
    task, recording = weighted_recording()
    vertices, errors = recording.vertices.copy(), np.full(recording.vertices.shape[:2], 1e-3)
    vertices[::2, 0] += [0.05, 0.05, 0.0]
    errors[:, 0] = 0.05
    deviations = []
    for each in (None, errors):
        noisy = replace(recording, vertices=vertices, standard_errors=each)
        result = ho.calibrate(noisy, task, density=DENSITY)
        deviations.append(abs(result.stiffness[0].value / 4.0 - 1.0))
    assert deviations[1] < 0.5 * deviations[0]


@pytest.mark.slow
def test_undetermined_parameters_are_reported() -> None:
    task, recording = flight_between(hitch_pair(), 0.0)
    weightless = ho.calibrate(recording, task, density=0.0)
    assert not any(one.known for one in weightless.stiffness)
    assert "displacements of drones are too small" in weightless.stiffness[0].remark
    assert "neither determined nor stated" in weightless.friction.remark
    task, recording = flight_between((hitch_pair()[0],) * 2, DENSITY)
    at_rest = ho.calibrate(recording, task, density=DENSITY)
    assert all(one.known for one in at_rest.stiffness)
    assert "cables slide by 0.0 cm" in at_rest.friction.remark
    task, recording = weighted_recording()
    with_integral = replace(recording, integral=np.ones(6, dtype=np.bool_))
    result = ho.calibrate(with_integral, task, density=DENSITY)
    assert "integral action" in result.stiffness[0].remark
    without_vertices = replace(recording, vertices=np.full_like(recording.vertices, np.nan))
    with pytest.raises(ho.InputError, match="record the vertices too"):
        ho.calibrate(without_vertices, task, density=DENSITY)


@pytest.mark.slow
def test_errors_are_distances_to_the_plan_extended_by_rest() -> None:
    task, recording = weighted_recording()
    places, t = task.states.positions, recording.t + 0.5 / RATE
    early = np.append(t - 2.0 * t[-1], t)
    drones = np.tile(recording.drones + [0.0, 0.3, 0.4], (2, 1, 1))
    vertices = np.tile(task.states.vertices[-1] + [0.02, 0.0, 0.0], (len(early), 1, 1))
    result = ho.calibrate(replace(recording, t=early, drones=drones, vertices=vertices), task)
    middle = np.vstack([0.5 * (places[1:] + places[:-1]), places[-1:]])
    planned = np.concatenate([np.tile(places[0], (len(t), 1, 1)), middle])
    np.testing.assert_allclose(result.drone_errors, np.linalg.norm(drones - planned, axis=-1))
    assert result.vertex_errors[-1] == pytest.approx(0.02)


def test_friction_is_coulombs_along_helices() -> None:
    """It opposes the relative velocity of the surfaces, also for swapped or reversed rates."""
    random = np.random.default_rng(7)
    for turn in np.radians([20.0, 52.0, 88.0, 119.0]):
        c, bend = np.cos(turn), np.pi * np.sin(0.5 * turn)
        frame = np.linalg.qr(random.normal(size=(3, 3)))[0]
        along_a, along_b = frame[0], c * frame[0] + np.sqrt(1.0 - c**2) * frame[1]
        assert along_a @ along_b == pytest.approx(c)
        for rates in random.normal(size=(20, 2)):
            over = unit(rates[0] * along_a - rates[1] * along_b)
            on_a, on_b = -bend * over, bend * over
            # Friction that pulls a cable back increases the pull of its leg.
            expected = [-on_a @ along_a, -on_b @ along_b]
            bends = np.full(2, bend)
            np.testing.assert_allclose(friction_pulls(bends, rates), expected)
            np.testing.assert_allclose(friction_pulls(bends, rates[::-1]), expected[::-1])
            np.testing.assert_allclose(friction_pulls(bends, -rates), np.negative(expected))
            np.testing.assert_allclose(friction_pulls(bends, 7.0 * rates), expected)


TRIANGLE = [[0.0, -0.75], [-0.6, 0.4], [0.7, 0.4]]


@pytest.fixture(scope="module")
def plan_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the plan of a triangle, at rest for two seconds."""
    team = ho.Team(3, [2.4, 2.5, 2.45], tension=0.5)
    hitch = ho.Hitch.balanced(team, TRIANGLE, altitude=1.4)
    return ho.solve(hitch, ho.Hold(seconds=2.0)).save(tmp_path_factory.mktemp("plan") / "out")


def rows_of(task: TeamTask) -> list[str]:
    """Return the rows of a recording in which all is as planned."""
    places = np.concatenate([task.states.positions, task.states.vertices], axis=1)
    names = (*task.team.drone_names, *task.team.point_names)
    return [
        f"{float(task.states.t[i])!r},{name}," + ",".join(repr(float(x)) for x in place)
        for i in range(0, len(task.states.t), 5)
        for name, place in zip(names, places[i], strict=True)
    ]


def write(path: Path, rows: list[str], header: str = HEADER) -> Path:
    path.write_text("\n".join([header, *rows, ""]), encoding="utf-8")
    return path


def run(*arguments: str | Path) -> Result:
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


def test_flights_as_planned_have_lengths_and_no_errors(plan_folder: Path, tmp_path: Path) -> None:
    table = write(tmp_path / "flight.csv", rows_of(team_task(plan_folder, Feature.CALIBRATE)))
    output = tmp_path / "team.yaml"
    result = run("calibrate", table, "--plan", plan_folder, "-o", output)
    assert result.exit_code == 0, result.output
    for words in (" 2.4 ", " 2.5 ", " 2.45 ", "0.0 ± 0.0 (0.0)", "not determined"):
        assert words in result.stdout
    assert "displacements of drones are too small" in result.stdout
    calibration = ho.calibrate(table, plan_folder)
    np.testing.assert_allclose(
        [one.value for one in calibration.lengths], [2.4, 2.5, 2.45], atol=1e-6
    )
    team: Any = parse_yaml(output.read_text(encoding="utf-8"))
    mission = {"start": {"hitch": {"polygon": TRIANGLE}}, "mission": [{"hold": {"seconds": 1.0}}]}
    problem = ho.problem_from_dict(team | mission)
    np.testing.assert_allclose(problem.team.cable_length, [2.4, 2.5, 2.45], atol=1e-4)
    np.testing.assert_allclose(problem.team.tension, 0.5)


def test_order_other_columns_and_unknown_names_do_not_matter(
    plan_folder: Path, tmp_path: Path
) -> None:
    rows = rows_of(team_task(plan_folder, Feature.CALIBRATE))
    plain = ho.read_flight(write(tmp_path / "a.csv", rows)).tracks
    mixed = sorted(rows, key=lambda row: row.split(",")[1][::-1])  # one body after another
    fields = [row.split(",") for row in mixed]
    other = [f"{z},{name},{x},0.5,{t},{y}" for t, name, x, y, z in fields]
    other += ["1.0,camera,2.0,3.0,0.0,1.0"]
    table = write(tmp_path / "b.csv", other, "z,name,x,battery,t,y")
    again = ho.read_flight(table).tracks
    assert set(again) - set(plain) == {"camera"}
    for name, track in plain.items():
        np.testing.assert_array_equal(again[name].t, track.t)
        np.testing.assert_array_equal(again[name].positions, track.positions)


def test_a_chain_ends_at_its_outer_drones(tmp_path: Path) -> None:
    team = ho.Team(3, [2.2, 2.6, 2.3], topology="open", tension=0.5)
    task = TeamTask.of(
        ho.solve(ho.Hitch.balanced(team, ARC, altitude=1.4), ho.Hold(seconds=2.0)).motion
    )
    rows = [row for row in rows_of(task) if ",p0," not in row and ",p3," not in row]
    result = ho.calibrate(write(tmp_path / "flight.csv", rows), task)
    np.testing.assert_array_equal(result.recording.vertices, task.states.vertices[::5])
    np.testing.assert_allclose([one.value for one in result.lengths], team.cable_length, atol=1e-6)


def test_positions_are_interpolated_between_neighbours() -> None:
    own = np.arange(0.0, 1.0, 0.02) + 0.003
    own = own[(own < 0.4) | (own > 0.7)]
    line = np.outer(own, [1.0, 2.0, -1.0])
    t = np.arange(0.01, 0.95, 0.02)
    places, near = Track(own, line).at(t)
    np.testing.assert_allclose(places, np.outer(t, [1.0, 2.0, -1.0]))
    np.testing.assert_array_equal(near, (t < 0.48) | (t > 0.605))


def test_windows_need_half_of_their_samples(plan_folder: Path) -> None:
    task = team_task(plan_folder, Feature.CALIBRATE)
    vertices = task.states.vertices.copy()
    vertices[55:120, 0] = np.nan  # 5 of 50 samples are left, then 30
    drones = task.states.positions.copy()
    drones[160:190, 1] = np.nan
    errors = np.full(vertices.shape[:2], 0.003)
    recording = Recording(task.states.t, drones, vertices, standard_errors=errors)
    windows = windows_of(recording, task, 0.5)
    np.testing.assert_allclose(windows.errors[:, 1], 0.003 / np.sqrt(5.0))  # of 0.1 s each
    np.testing.assert_allclose(windows.t, [0.245, 0.745, 1.245])  # q0 is not visible in the fourth
    np.testing.assert_array_equal(windows.visible[:, 0], [True, False, True])
    assert np.all(windows.visible[:, 1:])
    np.testing.assert_allclose(windows.vertices, windows.planned)
    assert windows.errors[1, 0] >= 0.01 > np.max(windows.errors[[0, 2]])
    np.testing.assert_allclose(windows.tensions, 0.5)
    vertices[:, 1:] = np.nan  # two of three
    assert (
        len(windows_of(Recording(task.states.t, task.states.positions, vertices), task, 0.5).t) == 0
    )


def test_gaps_in_movements_do_not_bias_means() -> None:
    """Windows with gaps have the same mean deviation from the plan as those without."""
    task, recording = weighted_recording()
    moving = (task.states.t > REST_TIME) & (task.states.t < REST_TIME + MOVE_TIME)
    vertices = task.states.vertices + [0.01, 0.02, 0.0]
    vertices[moving & (np.floor(2.0 * task.states.t) / 2.0 + 0.2 > task.states.t), 1] = np.nan
    windows = windows_of(replace(recording, vertices=vertices), task, 0.5)
    assert np.all(windows.visible)
    np.testing.assert_allclose(windows.vertices, windows.planned + [0.01, 0.02, 0.0], atol=1e-9)


def test_invalid_recordings_are_refused(plan_folder: Path, tmp_path: Path) -> None:
    rows = rows_of(team_task(plan_folder, Feature.CALIBRATE))
    tables = (
        ([r for r in rows if ",r1," not in r], "5 bodies (q0, r0, q1, q2, r2) for 6"),
        ([*rows, "inf,q0,1,2,3"], "a time is not finite"),
        ([f"1{r}" for r in rows if r[0] == "1"], "nowhere near the plan"),
        ([r.replace(",q", ",r", 1) for r in rows if ",r" not in r], "3 bodies (r0"),
        ([r for r in rows if ",p" not in r], "record the vertices too"),
    )
    table, plan = write(tmp_path / "flight.csv", rows), ("--plan", plan_folder)
    cases: list[tuple[tuple[str | Path, ...], str]] = [
        ((table,), f'No plan in "{tmp_path}"'),
        ((table, *plan, "--density", "-1"), "density = -1.0: must be at least 0"),
    ]
    for k, (lines, words) in enumerate(tables):
        cases.append(((write(tmp_path / f"{k}.csv", lines), *plan), words))
    for arguments, words in cases:
        result = run("calibrate", *arguments)
        assert (result.exit_code, words in result.stderr) == (2, True), result.output


def map_rows(rows: list[str], times: Any, places: Any = None) -> list[str]:
    """Return rows with times (n,) and places (n, 3) mapped; a place that is None is blank."""
    out = []
    for k, row in enumerate(rows):
        t, name, *place = row.split(",")
        x = places(k, np.array(place, np.float64)) if places else place
        cells = ["", "", ""] if x is None else [repr(float(each)) for each in x]
        out.append(",".join([repr(float(times(k, float(t)))), name, *cells]))
    return out


def test_doubtful_recordings_are_repaired_with_a_note_or_refused(
    plan_folder: Path, tmp_path: Path
) -> None:
    rows, lost = (
        rows_of(team_task(plan_folder, Feature.CALIBRATE)),
        np.random.default_rng(5).random(1000) < 0.1,
    )

    def unchanged(_: int, t: float) -> float:
        return t

    repaired = {
        "rows omitted: no position": map_rows(rows, unchanged, lambda k, x: None if lost[k] else x),
        "or a repeated time": [*rows, rows[-1]],
        "not determined": map_rows(rows, lambda k, t: t + 0.003 * (k % 9)),
    }
    refused = {
        "millimetres? unit='mm'": map_rows(rows, unchanged, lambda _, x: 1e3 * x),
        "drones are 0.95 m from the plan": map_rows(
            rows, unchanged, lambda _, x: x + [0.0, 0.95, 0.0]
        ),
        "name the plan that was flown": map_rows(
            rows, unchanged, lambda _, x: x[[0, 2, 1]] * [1, 1, -1]
        ),
        "milliseconds, divide by 1e+03": map_rows(rows, lambda _, t: 1e3 * t),
        "nanoseconds, divide by 1e+09": map_rows(rows, lambda _, t: 1e9 * (t + 1.7e9)),
        "nothing moves in the plan": map_rows(rows, lambda _, t: t + 1.7e9),
        "nowhere near the plan": map_rows(rows, lambda _, t: t + 100.0),
    }
    for words, lines in repaired.items():
        result = run("calibrate", write(tmp_path / "a.csv", lines), "--plan", plan_folder)
        assert result.exit_code == 0, result.output
        assert words in " ".join(result.stdout.split())
        calibration = ho.calibrate(tmp_path / "a.csv", plan_folder)
        np.testing.assert_allclose(
            [x.value for x in calibration.lengths], [2.4, 2.5, 2.45], atol=1e-6
        )
    for words, lines in refused.items():
        table, output = write(tmp_path / "b.csv", lines), tmp_path / "team.yaml"
        result = run("calibrate", table, "--plan", plan_folder, "-o", output)
        assert (result.exit_code, words in result.stderr) == (2, True), result.output
        assert not output.exists()


def test_vertices_are_estimated_from_markers_first() -> None:
    """The recording is a cloud of markers on the edges, on another clock."""
    hitch = ho.Hitch.balanced(ho.Team(3, [2.4, 2.5, 2.45], tension=0.5), TRIANGLE, altitude=1.4)
    plan = ho.solve(hitch, ho.MoveVertex(0, by=[0.0, -0.3], duration=5.0))
    task = TeamTask.of(plan.motion)
    t, shares = task.states.t[::2], np.array([0.3, 0.5, 0.7])
    ends = task.states.vertices[::2], np.roll(task.states.vertices[::2], -1, axis=1)
    points = ends[0][:, :, None] + shares[:, None] * (ends[1] - ends[0])[:, :, None]
    cloud = Track(np.repeat(t + 40.0, 9), points.reshape(-1, 3))
    drones = np.moveaxis(task.states.positions[::2], 1, 0)
    tracks = {f"cf{k}": Track(t + 40.0, x) for k, x in enumerate(drones)}
    flight = RecordedFlight("markers", tracks, cloud)
    result = ho.calibrate(flight, task)
    np.testing.assert_allclose([x.value for x in result.lengths], [2.4, 2.5, 2.45], atol=2e-3)
    errors: Any = result.recording.standard_errors
    assert 0.0 < float(np.nanmax(errors)) < 0.01
    assert "clock is fitted" in " ".join(result.recording.notes)


@pytest.mark.slow
def test_a_simulated_flight_is_calibrated_from_its_files(plan_folder: Path) -> None:
    simulated = run(
        "simulate", plan_folder, "--perturb", "stiffness=6", "--perturb", "density=0.012"
    )
    assert simulated.exit_code == 0, simulated.output
    result = ho.calibrate(plan_folder / "simulation")  # the plan is in the parent folder
    assert result.density == 0.012
    assert np.isfinite(result.recording.vertices[-1]).all()  # drones are recorded for longer
    np.testing.assert_allclose([one.value for one in result.lengths], [2.4, 2.5, 2.45], atol=5e-3)
    assert result.stiffness[0].value == pytest.approx(6.0, rel=0.1)
    assert not result.friction.known
    summary = plan_folder / "simulation" / "simulation.json"
    mean = json.loads(summary.read_text(encoding="utf-8"))["vertex_error"]["all"]["mean"]
    assert np.nanmean(result.vertex_errors) == pytest.approx(mean, rel=0.02)
    summary.write_text("{}", encoding="utf-8")
    refusal = run("calibrate", plan_folder / "simulation")
    assert (refusal.exit_code, "simulate again" in refusal.stderr) == (2, True)


def test_a_team_of_different_kinds_lists_them(plan_folder: Path) -> None:
    task = team_task(plan_folder, Feature.CALIBRATE)
    recording = Recording(task.states.t, task.states.positions, task.states.vertices)
    plain = ho.calibrate(recording, task, density=0.01)
    stiffness = (Estimate(4.0, 0.2), Estimate(4.0, 0.2), Estimate(np.nan, np.inf, "nothing moves"))
    text = replace(plain, stiffness=stiffness, friction=Estimate(0.123, 0.02)).text
    content: Any = parse_yaml(text)
    assert [kind["stiffness"] for kind in content["team"]["quadrotor"]] == [4, 4, None]
    assert content["team"]["cable_friction"] == 0.123
    assert "# ± 0.02" in text
    assert text.count("not determined") == 1
