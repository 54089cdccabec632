"""Calibration: recordings read from tables, and estimates from those that the laws alone compute.

They are exact without noise, honest with it.
"""

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
from hitchopt.flights.readers import HEADER
from hitchopt.flights.recordings import Recording, windows_of
from hitchopt.geometry.vectors import unit
from hitchopt.hitch import GRAVITY
from hitchopt.motion.states import States
from hitchopt.simulation.task import Task, read_task
from hitchopt.statics.calibrate import COSINES, IN_SPACE, TURNS, Estimate, friction_pulls
from hitchopt.statics.files import team_text
from hitchopt.statics.settle import conditions_of, energy_of
from hitchopt.storage.yaml_file import parse_yaml
from hitchopt.values import Array

DENSITY, MU, RATE = 0.012, 0.17, 20.0
HELD, MOVED = 2.0, 6.0  # Times at rest, before and after, and time of the movement [s]
SOFT, HARD = ho.Quadrotor(mass=0.14), ho.Quadrotor(mass=0.2)
K = np.repeat([4.0, 9.0, 4.0], 2)
POLYGON = np.array([[3.0, -1.1], [2.4, 0.4], [3.5, 0.5]])
ARC = np.array([[1.0, 0.0], [1.6, 1.0], [2.9, 1.1], [3.6, 0.0]])

Pair = tuple[ho.Hitch, ho.Hitch]
Wind = tuple[float, float]


def balanced(
    team: ho.Team, density: float, drones: Array, guess: Array, rates: Array, friction: float
) -> tuple[Array, Array]:
    """Points (points, 3) [m] at which clasps are in balance, and forces (2n, 3) [N] on drones."""
    layout, many = team.layout, team.drones
    conditions = conditions_of(team, cable_density=density, stiffness=1.0, feed_forward=False)
    plan = dict.fromkeys(("cable_forces", "offsets", "forces"), 0.0 * drones)
    plan |= {"positions": drones, "vertices": guess, "tensions": team.tension}
    plan |= {"cable_length": team.cable_length}
    energy = energy_of(team, conditions, {name: value[None] for name, value in plan.items()})
    nodes, ahead, behind = energy.nodes, layout.ahead, layout.behind

    def pulls(x: Array) -> Array:
        at = np.concatenate([drones, x.reshape(-1, 3)])[None]
        units = unit(np.diff(at[:, nodes], axis=-2))
        bends = np.arccos(np.clip(np.sum(units[..., 1:, :] * units[..., :-1, :], axis=-1), -1, 1))
        used = np.zeros((team.robots, 2))
        turned = np.stack([bends[0, ahead, 0], bends[0, behind, 1]], axis=-1)
        slid = np.stack([rates[2 * ahead], rates[2 * behind + 1]], axis=-1)
        used[ahead, 0], used[behind, 1] = friction * (friction_pulls(turned, slid) / turned).T
        forces = energy.forces(at[:, nodes], team.tension[None], used)[0]
        return np.asarray(energy.pulls(forces)[0])

    def missing(x: Array) -> Array:
        return pulls(x)[many:].ravel()

    x = root(missing, guess[layout.clasps].ravel(), tol=1e-12).x
    assert np.max(np.abs(missing(x))) < 1e-9
    points = guess.copy()
    points[layout.anchors] = drones  # a chain's ends
    points[layout.clasps] = x.reshape(-1, 3)
    return points, -pulls(x)[:many]


def recorded(
    pair: Pair, density: float, friction: float = 0.0, wind: Wind = (0.0, 0.0)
) -> tuple[Task, Recording]:
    """Return a plan from one hitch to another, whose drones do not know the cables' weight."""
    (first, second), team, layout = pair, pair[0].team, pair[0].team.layout
    t = np.arange(round((2.0 * HELD + MOVED) * RATE) + 1) / RATE
    s = np.clip((t - HELD) / MOVED, 0.0, 1.0)
    s = s * s * (3.0 - 2.0 * s)
    drones = first.drones + s[:, None, None] * (second.drones - first.drones)
    moving = np.flatnonzero((t > HELD + 0.8) & (t < HELD + MOVED - 0.8))
    rates = np.zeros(drones.shape[:2])
    for _ in range(2 if friction else 1):  # which way cables slide follows from the flight itself
        points, forces, guess = np.zeros((len(t), layout.points, 3)), 0.0 * drones, first.vertices
        for _ in range(4):
            guess, _ = balanced(team, density, drones[0], guess, rates[0], friction)
        for i, (place, rate) in enumerate(zip(drones, rates, strict=True)):
            guess, forces[i] = balanced(team, density, place, guess, rate, friction)
            points[i] = guess
        # Clasps are about to slide before they do, and stick afterwards.
        rates = np.gradient(np.linalg.norm(drones - points[:, layout.anchors], axis=-1), t, axis=0)
        rates = rates[np.clip(np.arange(len(t)), moving[0], moving[-1])]
    known = -np.repeat(team.tension, 2)[:, None] * unit(drones - points[:, layout.pulled_to])
    commanded = drones - (forces + [*wind, 0.0] - known) / K[:, None]
    given: Any = dict.fromkeys((each.name for each in fields(States)), 0.0 * drones)
    given |= {"t": t, "positions": commanded, "cable_forces": known, "vertices": points}
    given |= {"formed": np.ones(len(t), np.bool_), "tensions": np.tile(team.tension, (len(t), 1))}
    return Task(team, States(**given)), Recording(t, drones, points)


def hitches(topology: str = "closed", *, outward: bool = False) -> Pair:
    """The same polygon, cables slid: one drone of a cable comes nearer as the other goes.

    Or a vertex moved ``outward``: both cables of its clasp slide alike.
    """
    points, kinds = POLYGON if topology == "closed" else ARC, [SOFT, HARD, SOFT]
    given: dict[str, Any] = {"topology": topology, "tension": [0.5, 0.6, 0.55], "quadrotor": kinds}
    team = ho.Team(3, [2.6, 2.5, 2.7], **given)
    middle = ho.Hitch.balanced(team, points, 1.3)
    if outward:
        moved = points + [[0.0, -0.25], [0.0, 0.0], [0.0, 0.0]]
        return middle, ho.Hitch.balanced(team, moved, 1.3)
    slid = np.array([0.12, -0.1, 0.15]) * team.layout.has_leg.all(axis=1)
    before, after = (ho.Hitch(team, points, 1.3, middle.q_legs + s * slid) for s in (-1.0, 1.0))
    return before, after


@cache
def weighted(friction: float = 0.0) -> tuple[Task, Recording]:
    return recorded(hitches(), DENSITY, friction)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("pair", "friction", "within", "wind"),
    [
        (hitches(), MU, 0.005, (0.05, -0.08)),  # which is no stiffness
        (hitches(outward=True), MU, 0.01, (0.0, 0.0)),
        (hitches("open"), 0.0, 1e-5, (0.0, 0.0)),
    ],
)
def test_without_noise_stiffness_and_friction_are_exact(
    pair: Pair, friction: float, within: float, wind: Wind, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hitchopt.statics.calibrate.UNCERTAIN_RATE", 1e-4)  # no creep
    task, recording = recorded(pair, DENSITY, friction, wind)
    found = ho.calibrate(recording, task, density=DENSITY)
    assert all(one.known for one in found.stiffness)
    np.testing.assert_allclose([one.value for one in found.stiffness], K[::2], rtol=0.02)
    assert found.friction.known
    assert found.friction.value == pytest.approx(friction, abs=within)
    assert abs(found.friction.value - friction) < max(found.friction.error, 1e-3)


@pytest.mark.slow
def test_cable_lengths_are_those_of_catenaries() -> None:
    task, recording = weighted()
    rows = {name: getattr(recording, name)[:30] for name in ("t", "drones", "vertices")}
    found = ho.calibrate(replace(recording, **rows), task, density=DENSITY)
    layout, drones, points = task.team.layout, recording.drones[0], recording.vertices[0]
    corners = drones[0::2], points[layout.starts], points[layout.ends], drones[1::2]
    spans = np.diff(np.stack(corners, axis=1), axis=1)
    level, chord = np.hypot(spans[..., 0], spans[..., 1]), np.linalg.norm(spans, axis=-1)
    # The horizontal pull over the weight per length, such that the mean tension is right.
    pull = task.team.tension[:, None] * level / chord / (GRAVITY * DENSITY)
    lengths = np.hypot(spans[..., 2], 2.0 * pull * np.sinh(level / (2.0 * pull)))
    values = [one.value for one in found.lengths]
    np.testing.assert_allclose(values, np.sum(lengths, axis=1), atol=1e-4)


@pytest.mark.slow
def test_standard_errors_are_those_of_repeated_flights() -> None:
    """Over flights with noise of 1.5 mm, deviations are about as large as the stated errors."""
    (task, recording), scores = weighted(MU), []
    for seed in range(6):
        rng, noise = np.random.default_rng(seed), 1.5e-3
        places = recording.drones, recording.vertices
        drones, vertices = (each + noise * rng.normal(size=each.shape) for each in places)
        noisy = replace(recording, drones=drones, vertices=vertices)
        found = ho.calibrate(noisy, task, density=DENSITY)
        soft, hard = found.stiffness[0], found.stiffness[1]
        assert abs(found.friction.value - MU) < 0.05
        scores.append([(soft.value - 4.0) / soft.error, (hard.value - 9.0) / hard.error])
    assert np.all(np.sqrt(np.mean(np.square(scores), axis=0)) < 2.5)
    assert np.max(np.abs(scores)) > 0.2  # they are no vacuous bounds


@pytest.mark.slow
def test_standard_errors_cover_where_a_plan_knows_the_weight(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Steady forces on drones displace them by more than what their plan leaves out.

    Lines of thick ropes cross inward of where they touch, by up to 2 cm.
    """
    angles = np.radians(90.0 - 72.0 * np.arange(5))
    corners = 0.8 * np.column_stack([np.cos(angles), np.sin(angles)])
    tensions, k = 0.5 * (1.0 + np.array([0.08, -0.1, -0.06, 0.07, 0.05])), 4.75
    hitch = ho.Hitch.balanced(ho.Team(5, 3.0, tension=tensions), corners, 1.5)
    monkeypatch.setattr("test_calibrate.K", np.full(10, k))
    (task, recording), scores = recorded((hitch, hitch), DENSITY), []
    drones, vertices, known = recording.drones, recording.vertices, task.states.cable_forces
    equal = -0.5 * unit(drones - vertices[:, task.team.layout.pulled_to])  # tensions, to the plan
    weights = k * (drones - task.states.positions)
    positions, tensions = drones - (known - equal) / k, np.full_like(task.states.tensions, 0.5)
    commands = replace(
        task.states, positions=positions, cable_forces=equal + weights, tensions=tensions
    )
    task = replace(task, team=ho.Team(5, 3.0, tension=0.5), states=commands)
    inward = unit(np.mean(vertices, axis=1, keepdims=True) - vertices)
    for seed in range(6):
        rng = np.random.default_rng(seed)
        steady = rng.normal(size=(10, 3)) * 0.03 / k
        noisy = drones + steady + 1e-3 * rng.normal(size=drones.shape)
        crossed = vertices + inward * rng.uniform(0.0, 0.02, (1, 5, 1))
        seen = replace(recording, drones=noisy, vertices=crossed)
        assert not ho.calibrate(seen, task, density=DENSITY).stiffness[0].known
        with monkeypatch.context() as patch:
            patch.setattr("hitchopt.statics.calibrate.MAX_STIFFNESS_ERROR", np.inf)
            found = ho.calibrate(seen, task, density=DENSITY).stiffness[0]
        scores.append(np.log(found.value / k) * found.value / found.error)
    assert np.sqrt(np.mean(np.square(scores))) < 1.3


@pytest.mark.slow
def test_vertices_weigh_by_their_standard_errors() -> None:
    """One that is far off, and says so, changes estimates by less."""
    task, recording = weighted()
    vertices, errors = recording.vertices.copy(), np.full(recording.vertices.shape[:2], 1e-3)
    vertices[::2, 0] += [0.05, 0.05, 0.0]
    errors[:, 0] = 0.05
    found = []
    for each in (None, errors):
        seen = replace(recording, vertices=vertices, standard_errors=each)
        one = ho.calibrate(seen, task, density=DENSITY)
        found.append(abs(one.stiffness[0].value / 4.0 - 1.0))
    assert found[1] < 0.5 * found[0]


@pytest.mark.slow
def test_what_a_recording_does_not_determine_is_said() -> None:
    task, recording = recorded(hitches(), 0.0)
    weightless = ho.calibrate(recording, task, density=0.0)
    assert not any(one.known for one in weightless.stiffness)
    assert "displacements of drones are too small" in weightless.stiffness[0].remark
    assert "neither determined nor stated" in weightless.friction.remark
    task, recording = recorded((hitches()[0],) * 2, DENSITY)
    still = ho.calibrate(recording, task, density=DENSITY)
    assert all(one.known for one in still.stiffness)
    assert "cables slide by 0.0 cm" in still.friction.remark
    task, recording = weighted()
    wound = replace(recording, integral=np.ones(6, dtype=np.bool_))
    assert "integral action" in ho.calibrate(wound, task, density=DENSITY).stiffness[0].remark
    unseen = replace(recording, vertices=np.full_like(recording.vertices, np.nan))
    with pytest.raises(ho.InputError, match="record the vertices too"):
        ho.calibrate(unseen, task, density=DENSITY)


@pytest.mark.slow
def test_errors_are_distances_to_the_plan_which_stands_still_before_and_after() -> None:
    task, recording = weighted()
    places, t = task.states.positions, recording.t + 0.5 / RATE
    early = np.append(t - 2.0 * t[-1], t)
    drones = np.tile(recording.drones + [0.0, 0.3, 0.4], (2, 1, 1))
    vertices = np.tile(task.states.vertices[-1] + [0.02, 0.0, 0.0], (len(early), 1, 1))
    found = ho.calibrate(replace(recording, t=early, drones=drones, vertices=vertices), task)
    middle = np.vstack([0.5 * (places[1:] + places[:-1]), places[-1:]])
    planned = np.concatenate([np.tile(places[0], (len(t), 1, 1)), middle])
    np.testing.assert_allclose(found.drone_errors, np.linalg.norm(drones - planned, axis=-1))
    assert found.vertex_errors[-1] == pytest.approx(0.02)


def test_friction_is_coulombs_in_space() -> None:
    """Against vectors: it opposes one surface's velocity over the other's, swapped or reversed."""
    random = np.random.default_rng(7)
    for turn in np.radians([20.0, 52.0, 88.0, 119.0]):
        c, space = np.interp(turn, TURNS, COSINES), np.interp(turn, TURNS, IN_SPACE)
        frame = np.linalg.qr(random.normal(size=(3, 3)))[0]
        along_a, along_b = frame[0], c * frame[0] + np.sqrt(1.0 - c**2) * frame[1]
        assert along_a @ along_b == pytest.approx(c)
        for rates in random.normal(size=(20, 2)):
            over = unit(rates[0] * along_a - rates[1] * along_b)
            on_a, on_b = -turn * space * over, turn * space * over
            # Where friction pulls a cable back, its leg is pulled the harder by as much.
            expected = [-on_a @ along_a, -on_b @ along_b]
            turns = np.full(2, turn)
            np.testing.assert_allclose(friction_pulls(turns, rates), expected)
            np.testing.assert_allclose(friction_pulls(turns, rates[::-1]), expected[::-1])
            np.testing.assert_allclose(friction_pulls(turns, -rates), np.negative(expected))
            np.testing.assert_allclose(friction_pulls(turns, 7.0 * rates), expected)


TRIANGLE = [[0.0, -0.75], [-0.6, 0.4], [0.7, 0.4]]


@pytest.fixture(scope="module")
def solved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the plan of a triangle, at rest for two seconds."""
    team = ho.Team(3, [2.4, 2.5, 2.45], tension=0.5)
    hitch = ho.Hitch.balanced(team, TRIANGLE, altitude=1.4)
    return ho.hold(hitch, seconds=2.0).save(tmp_path_factory.mktemp("plan") / "out")


def rows_of(task: Task) -> list[str]:
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


def test_flights_as_planned_have_lengths_and_no_errors(solved: Path, tmp_path: Path) -> None:
    table = write(tmp_path / "flight.csv", rows_of(read_task(solved)))
    output = tmp_path / "team.yaml"
    result = run("calibrate", table, "--plan", solved, "-o", output)
    assert result.exit_code == 0, result.output
    for words in (" 2.4 ", " 2.5 ", " 2.45 ", "0.0 ± 0.0 (0.0)", "not determined"):
        assert words in result.stdout
    assert "displacements of drones are too small" in result.stdout
    found = ho.calibrate(table, solved)
    np.testing.assert_allclose([one.value for one in found.lengths], [2.4, 2.5, 2.45], atol=1e-6)
    team: Any = parse_yaml(output.read_text(encoding="utf-8"))
    mission = {"start": {"hitch": {"polygon": TRIANGLE}}, "mission": [{"hold": {"seconds": 1.0}}]}
    problem = ho.problem_from_dict(team | mission)
    np.testing.assert_allclose(problem.team.cable_length, [2.4, 2.5, 2.45], atol=1e-4)
    np.testing.assert_allclose(problem.team.tension, 0.5)


def test_order_other_columns_and_unknown_names_do_not_matter(solved: Path, tmp_path: Path) -> None:
    rows = rows_of(read_task(solved))
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
    task = Task.of(ho.hold(ho.Hitch.balanced(team, ARC, altitude=1.4), seconds=2.0).motion)
    rows = [row for row in rows_of(task) if ",p0," not in row and ",p3," not in row]
    found = ho.calibrate(write(tmp_path / "flight.csv", rows), task)
    np.testing.assert_array_equal(found.recording.vertices, task.states.vertices[::5])
    np.testing.assert_allclose([one.value for one in found.lengths], team.cable_length, atol=1e-6)


def test_bodies_seen_at_other_times_are_interpolated_between_neighbours() -> None:
    own = np.arange(0.0, 1.0, 0.02) + 0.003
    own = own[(own < 0.4) | (own > 0.7)]
    line = np.outer(own, [1.0, 2.0, -1.0])
    t = np.arange(0.01, 0.95, 0.02)
    places, near = ho.Track(own, line).at(t)
    np.testing.assert_allclose(places, np.outer(t, [1.0, 2.0, -1.0]))
    np.testing.assert_array_equal(near, (t < 0.48) | (t > 0.605))


def test_windows_count_of_which_half_was_seen(solved: Path) -> None:
    task = read_task(solved)
    vertices = task.states.vertices.copy()
    vertices[55:120, 0] = np.nan  # of 50 samples 5, of the next 30 are left
    drones = task.states.positions.copy()
    drones[160:190, 1] = np.nan
    errors = np.full(vertices.shape[:2], 0.003)
    seen = Recording(task.states.t, drones, vertices, standard_errors=errors)
    found = windows_of(seen, task, 0.5)
    np.testing.assert_allclose(found.errors[:, 1], 0.003 / np.sqrt(5.0))  # of 0.1 s each
    np.testing.assert_allclose(found.t, [0.245, 0.745, 1.245])  # of the fourth, q0 is not seen
    np.testing.assert_array_equal(found.visible[:, 0], [True, False, True])
    assert np.all(found.visible[:, 1:])
    np.testing.assert_allclose(found.vertices, found.planned)
    assert found.errors[1, 0] >= 0.01 > np.max(found.errors[[0, 2]])
    np.testing.assert_allclose(found.tensions, 0.5)
    vertices[:, 1:] = np.nan  # two of three
    assert (
        len(windows_of(Recording(task.states.t, task.states.positions, vertices), task, 0.5).t) == 0
    )


def test_means_of_half_a_movement_are_of_all_of_it() -> None:
    """Where a vertex is not seen it is as far off the plan as where it is."""
    task, recording = weighted()
    moving = (task.states.t > HELD) & (task.states.t < HELD + MOVED)
    vertices = task.states.vertices + [0.01, 0.02, 0.0]
    vertices[moving & (np.floor(2.0 * task.states.t) / 2.0 + 0.2 > task.states.t), 1] = np.nan
    found = windows_of(replace(recording, vertices=vertices), task, 0.5)
    assert np.all(found.visible)
    np.testing.assert_allclose(found.vertices - found.planned - [0.01, 0.02, 0.0], 0.0, atol=1e-9)


def test_tables_that_are_no_recordings_are_refused(solved: Path, tmp_path: Path) -> None:
    rows = rows_of(read_task(solved))
    tables = (
        ([r for r in rows if ",r1," not in r], "5 bodies (q0, r0, q1, q2, r2) of 6"),
        ([*rows, "inf,q0,1,2,3"], "a time is not finite"),
        ([f"1{r}" for r in rows if r[0] == "1"], "nowhere near the plan"),
        ([r.replace(",q", ",r", 1) for r in rows if ",r" not in r], "3 bodies (r0"),
        ([r for r in rows if ",p" not in r], "record the vertices too"),
    )
    table, plan = write(tmp_path / "flight.csv", rows), ("--plan", solved)
    cases: list[tuple[tuple[str | Path, ...], str]] = [
        ((table,), "plan.npz: there is no such file"),
        ((table, *plan, "--density", "-1"), "density = -1.0: must be at least 0"),
    ]
    for k, (lines, words) in enumerate(tables):
        cases.append(((write(tmp_path / f"{k}.csv", lines), *plan), words))
    for arguments, words in cases:
        result = run("calibrate", *arguments)
        assert (result.exit_code, words in result.stderr) == (2, True), result.output


def changed(rows: list[str], times: Any, places: Any = None) -> list[str]:
    """Return rows with times (n,) and places (n, 3) mapped; a place that is None is blank."""
    out = []
    for k, row in enumerate(rows):
        t, name, *place = row.split(",")
        x = places(k, np.array(place, np.float64)) if places else place
        cells = ["", "", ""] if x is None else [repr(float(each)) for each in x]
        out.append(",".join([repr(float(times(k, float(t)))), name, *cells]))
    return out


def test_what_is_doubtful_is_mended_with_a_note_or_refused(solved: Path, tmp_path: Path) -> None:
    rows, lost = rows_of(read_task(solved)), np.random.default_rng(5).random(1000) < 0.1

    def same(_: int, t: float) -> float:
        return t

    mended = {
        "rows omitted: no position": changed(rows, same, lambda k, x: None if lost[k] else x),
        "or a repeated time": [*rows, rows[-1]],
        "not determined": changed(rows, lambda k, t: t + 0.003 * (k % 9)),
    }
    refused = {
        "millimetres? unit='mm'": changed(rows, same, lambda _, x: 1e3 * x),
        "drones are 0.95 m from the plan": changed(rows, same, lambda _, x: x + [0.0, 0.95, 0.0]),
        "name the plan that was flown": changed(rows, same, lambda _, x: x[[0, 2, 1]] * [1, 1, -1]),
        "milliseconds, divide by 1e+03": changed(rows, lambda _, t: 1e3 * t),
        "nanoseconds, divide by 1e+09": changed(rows, lambda _, t: 1e9 * (t + 1.7e9)),
        "nothing moves in the plan": changed(rows, lambda _, t: t + 1.7e9),
        "nowhere near the plan": changed(rows, lambda _, t: t + 100.0),
    }
    for words, lines in mended.items():
        result = run("calibrate", write(tmp_path / "a.csv", lines), "--plan", solved)
        assert result.exit_code == 0, result.output
        assert words in " ".join(result.stdout.split())
        found = ho.calibrate(tmp_path / "a.csv", solved)
        np.testing.assert_allclose([x.value for x in found.lengths], [2.4, 2.5, 2.45], atol=1e-6)
    for words, lines in refused.items():
        table, output = write(tmp_path / "b.csv", lines), tmp_path / "team.yaml"
        result = run("calibrate", table, "--plan", solved, "-o", output)
        assert (result.exit_code, words in result.stderr) == (2, True), result.output
        assert not output.exists()


def test_recordings_of_markers_are_measured_first() -> None:
    """A cloud of markers on the edges, in the plan's frame, later on another clock."""
    hitch = ho.Hitch.balanced(ho.Team(3, [2.4, 2.5, 2.45], tension=0.5), TRIANGLE, altitude=1.4)
    plan = ho.move_vertex(hitch, 0, by=[0.0, -0.3], duration=5.0)
    task = Task.of(plan.motion)
    t, shares = task.states.t[::2], np.array([0.3, 0.5, 0.7])
    ends = task.states.vertices[::2], np.roll(task.states.vertices[::2], -1, axis=1)
    points = ends[0][:, :, None] + shares[:, None] * (ends[1] - ends[0])[:, :, None]
    cloud = ho.Track(np.repeat(t + 40.0, 9), points.reshape(-1, 3))
    drones = np.moveaxis(task.states.positions[::2], 1, 0)
    tracks = {f"cf{k}": ho.Track(t + 40.0, x) for k, x in enumerate(drones)}
    flight = ho.RecordedFlight("made", tracks, cloud)
    found = ho.calibrate(flight, task)
    np.testing.assert_allclose([x.value for x in found.lengths], [2.4, 2.5, 2.45], atol=2e-3)
    errors: Any = found.recording.standard_errors
    assert 0.0 < float(np.nanmax(errors)) < 0.01
    assert "clock is fitted" in " ".join(found.recording.notes)


@pytest.mark.slow
def test_a_simulated_flight_is_calibrated_from_its_files(solved: Path) -> None:
    flown = run("simulate", solved, "--stiffness", "6", "--density", "0.012")
    assert flown.exit_code == 0, flown.output
    found = ho.calibrate(solved / "simulation")  # the plan is where the results lie
    assert found.density == 0.012
    assert np.isfinite(found.recording.vertices[-1]).all()  # drones are recorded for longer
    np.testing.assert_allclose([one.value for one in found.lengths], [2.4, 2.5, 2.45], atol=5e-3)
    assert found.stiffness[0].value == pytest.approx(6.0, rel=0.1)
    assert not found.friction.known
    summary = solved / "simulation" / "simulation.json"
    mean = json.loads(summary.read_text(encoding="utf-8"))["vertex_error"]["all"]["mean"]
    assert np.nanmean(found.vertex_errors) == pytest.approx(mean, rel=0.02)
    summary.write_text("{}", encoding="utf-8")
    broken = run("calibrate", solved / "simulation")
    assert (broken.exit_code, "simulate again" in broken.stderr) == (2, True)


def test_a_team_of_different_kinds_lists_them(solved: Path) -> None:
    task = read_task(solved)
    seen = Recording(task.states.t, task.states.positions, task.states.vertices)
    plain = ho.calibrate(seen, task, density=0.01)
    stiffness = (Estimate(4.0, 0.2), Estimate(4.0, 0.2), Estimate(np.nan, np.inf, "nothing moves"))
    text = team_text(replace(plain, stiffness=stiffness, friction=Estimate(0.123, 0.02)))
    given: Any = parse_yaml(text)
    assert [kind["stiffness"] for kind in given["team"]["quadrotor"]] == [4, 4, None]
    assert given["team"]["cable_friction"] == 0.123
    assert "# ± 0.02" in text
    assert text.count("not determined") == 1
