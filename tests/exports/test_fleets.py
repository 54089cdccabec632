"""Exports of several groups as one fleet, equal to those of single groups."""

from __future__ import annotations

import csv
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import hitchopt as ho
from hitchopt.checks import CertificateError, certify
from hitchopt.exports.contents import read_manifest
from hitchopt.exports.firmware import team_parameters
from hitchopt.exports.format import format_of
from hitchopt.exports.held_tension import held_tension
from hitchopt.exports.lint import lint
from hitchopt.exports.options import HOMES
from hitchopt.motion.states import States, flight_states_at, states_at
from tests.helpers.exported_plans import exported, task_of
from tests.helpers.format_readers import READERS
from tests.helpers.groups import alone, beside, flown_by, hitch_and_swarm, moved, two_hitches

MOTIONS = {"two hitches": two_hitches, "hitch and swarm": hitch_and_swarm}


def is_held(name: str, kind: str) -> bool:
    """Uploaded setpoints hold the tension where hitches are not too near to each other for it."""
    return name in {"crazyswarm2", "compressed", "skybrush"} and kind == "hitch and swarm"


@pytest.mark.parametrize(
    ("densities", "keys"),
    [
        ({}, ["team"]),
        ({"": 0}, []),
        ({"b": 0}, ["teams.a"]),
        ({"a": 0.0, "b": 0.003}, []),
        ({"c": None}, ["teams.a", "teams.b"]),
    ],
)
def test_hitches_of_unstated_density_are_noted_with_their_sag(
    densities: dict[str, float | None], keys: list[str], tmp_path: Path
) -> None:
    """A density of 0 that is written out counts as stated."""
    teams, start = dict[str, dict[str, float]](), dict[str, object]()
    for i, name in enumerate([""] if not {*densities} - {""} else ["a", "b"]):
        teams[name] = {"robots": 3, "cable_length": 2.4, "tension": 0.6}
        if (density := densities.get(name)) is not None:
            teams[name]["cable_density"] = density
        polygon = [[5.0 * i + x, y] for x, y in ((0, 0.58), (0.5, -0.29), (-0.5, -0.29))]
        start[name] = {"hitch": {"polygon": polygon, "altitude": 1.2}}
    hold = {"hold": {"seconds": 0.5}}
    single = {"team": teams.get(""), "start": start.get(""), "mission": [hold]}
    several = {"teams": teams, "start": start, "mission": [dict.fromkeys(teams, hold)]}
    text = json.dumps(single if "" in teams else several)
    (tmp_path / "problem.yaml").write_text(text)
    plan = ho.solve(tmp_path / "problem.yaml")
    plan.save(tmp_path / "plan")
    saved = ho.load(tmp_path / "plan")
    (part,) = saved.export("csv", tmp_path / "files")
    notes = [note for note in part.notes if "weightless" in note]
    assert plan.notes == saved.notes == tuple(notes)
    assert all(note in plan._repr_html_() for note in notes)
    unknown = {each.name for each in plan.flight.teams if each.motion.team.cable_density == 0.0}
    assert len(replace(plan, problem="").notes) == len(unknown)  # of a script, that states nothing
    assert [note.partition("state ")[2] for note in notes] == [f"{x}.cable_density" for x in keys]
    assert all("at 10 g/m vertices would hang 9.7 cm lower" in note for note in notes)
    assert set(notes) <= set((read_manifest(tmp_path / "files") or {})["notes"])


def test_the_sag_is_that_of_the_cables_that_a_model_flies() -> None:
    """It is proportional to the density, here 1.5 of 10 g/m."""
    drops = []
    for kind in (ho.Quadrotor(), ho.Quadrotor(model="crazyflie_2.1_brushless")):
        team = ho.Team(3, 2.4, tension=0.15, quadrotor=kind)
        start = ho.Hitch.balanced(team, ho.regular_polygon(3, 0.6), 1.2)
        (note,) = ho.solve(start, ho.Hold(0.5)).notes
        words = re.search(r"at ([\d.]+) g/m vertices would hang ([\d.]+) cm lower", note)
        drops.append([float(x) for x in words.groups()] if words else [])
    (density, drop), (own, own_drop) = drops
    assert (density, own) == (10.0, 1.5)
    assert own_drop == pytest.approx(0.15 * drop, rel=0.05)


def test_plans_that_leave_no_room_for_tracking_errors_say_so() -> None:
    ends = np.array([[-1.0, 0.01, 1.0], [1.0, 0.0, 1.0]])
    notes = {}
    for tracking in (None, 0.01, 0.05):
        limits = ho.Limits(tracking=tracking)
        plan = ho.separate(ho.Problem(ho.Swarm(2), ends, [ho.Fly(ends[::-1])], limits=limits))
        notes[tracking] = plan.notes
    (note,) = notes.pop(None)
    assert note.startswith("tracking_radius is ")
    assert note.endswith("set limits.tracking to your drones' error")
    assert set(notes.values()) == {()}


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        *((name, "hitch and swarm") for name in HOMES),
        *((name, "two hitches") for name in ("csv", "mavsdk_drone_show")),
        pytest.param("skybrush", "two hitches", marks=pytest.mark.slow),
    ],
)
def test_all_drones_are_in_the_files(name: str, kind: str, tmp_path: Path) -> None:
    flight = MOTIONS[kind]()
    roles = flight.team.drone_names
    options = {"rate": 20.0} if format_of(name).rate else {}
    (part,) = exported(flight, name, tmp_path, **options)
    assert part.goes_slack == (format_of(name).flown_by == "upload" and not is_held(name, kind))
    manifest = read_manifest(tmp_path)
    names = [role if format_of(name).dotted else role.replace(".", "_") for role in roles]
    assert manifest["drones"] == dict(zip(roles, names, strict=True))
    assert part.verdict.violated == ()
    read = READERS[name](tmp_path, names, np.linspace(0.0, flight.duration, 60))
    slower = manifest["plan_span"][1] / flight.duration  # as rounding would break a limit
    states = flight_states_at(flight, np.minimum(read.t / slower, flight.duration))
    if not is_held(name, kind):
        east, north, up = np.moveaxis(states.positions, -1, 0)
        axes = {"enu": (east, north, up), "nwu": (north, -east, up), "ned": (north, east, -up)}
        there = np.stack(axes[format_of(name).frames[0]], axis=-1)
        off = np.linalg.norm(read.places - there, axis=-1)
        assert np.max(off) <= part.verdict.position.worst + 1e-6
    if read.forward is not None and name != "mavsdk_drone_show":
        held = states.held_forces(flight.team.false_pull) / flight.team.mass[:, None]
        np.testing.assert_allclose(read.forward, states.accelerations - held, atol=1e-6)
    (linted,) = lint(tmp_path)
    assert {finding.level for finding in linted.findings} <= {"warning", "note"}
    assert len(linted.facts) == len(roles)


@pytest.mark.parametrize("kind", MOTIONS)
def test_states_are_those_of_each_group(kind: str) -> None:
    flight, first = MOTIONS[kind](), 0
    t = np.linspace(0.0, flight.duration, 25)
    whole = flight_states_at(flight, t)
    for group in flight.teams:
        own, count = states_at(group.motion, t), group.motion.team.drones
        here = slice(first, first + count)
        for name in (
            *("positions", "velocities", "accelerations", "masses", "quaternions", "body_rates"),
            *("cable_forces", "cable_force_rates"),
        ):
            np.testing.assert_array_equal(getattr(whole, name)[:, here], getattr(own, name))
        names = [f"{group.name}.{drone}" for drone in group.motion.team.drone_names]
        assert list(flight.team.drone_names[here]) == names
        thrusts = States.thrusts(whole, flight.team)[:, here]
        np.testing.assert_array_equal(thrusts, own.thrusts(group.motion.team))
        first += count


def test_a_group_is_exported_as_if_it_flew_alone(tmp_path: Path) -> None:
    """The rows of a drone are those of its own plan, and so are its setpoints and parameters."""
    flight = two_hitches()
    exported(flight, "csv", tmp_path / "all", rate=20.0)
    exported(alone(flight, "b"), "csv", tmp_path / "b", rate=20.0)

    def rows(folder: str) -> dict[tuple[str, str], list[str]]:
        with (tmp_path / folder / "setpoints_enu.csv").open() as file:
            return {(row[0], row[1]): row[2:] for row in csv.reader(file)}

    whole, own = rows("all"), rows("b")
    assert {(t, name): whole[t, f"b.{name}"] for t, name in own if t != "t"} == {
        key: row for key, row in own.items() if key[0] != "t"
    }
    held, by_itself = held_tension(flight), held_tension(ho.Flight.of(alone(flight, "b")))
    times = np.linspace(0.0, by_itself.flight.duration, 50)
    places = alone(held.flight, "b").drones.at(times)
    np.testing.assert_array_equal(places, by_itself.flight.drones.at(times))
    parameters = team_parameters(flight.team)
    for name, values in team_parameters(alone(flight, "b").team).items():
        assert parameters[f"b.{name}"] == values
    gains = [parameters[name]["ctrlMel"]["kp_xy"] for name in ("a.q0", "b.q0")]
    assert gains == [4.75, 4.0]


def test_exports_of_groups_are_read_back_and_certified(tmp_path: Path) -> None:
    """Of exact samples each check is the plan's, with the names of its groups."""
    flight = two_hitches()
    (part,) = exported(flight, "csv", tmp_path)
    planned = {check.name: check for check in certify(flight).checks}
    for check in part.verdict.checks:
        if check.name in ("separation", "speed", "thrust", "tilt", "crossing"):
            assert check.worst == pytest.approx(planned[check.name].worst, rel=1e-3)
        assert all(place[:2] in ("a.", "b.") for place in check.where)
    assert {"cable_clearance", "crossing", "cable_length"} <= {c.name for c in part.verdict.checks}


def test_tables_have_all_groups(tmp_path: Path) -> None:
    plan = ho.Plan(two_hitches(), certify(two_hitches()), "Two")
    plan.save(tmp_path, rate=5.0)
    with (tmp_path / "vertices.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert {row["vertex"] for row in rows} == {f"a.p{i}" for i in range(3)} | {
        f"b.p{i}" for i in range(4)
    }
    for name, k in (("a", 1), ("b", 3)):
        own = [row for row in rows if row["vertex"] == f"{name}.p{k}"]
        t = np.minimum([float(row["t"]) for row in own], plan.duration)  # of 9 digits
        found = np.array([[float(row[c]) for c in ("x", "y", "z", "tension")] for row in own])
        group = alone(plan.flight, name)
        np.testing.assert_allclose(found[:, :3], group.vertices.at(t)[:, k], atol=1e-11)
        np.testing.assert_allclose(found[:, 3], group.tensions.at(t)[:, k], atol=1e-11)
    frame = plan.to_dataframe(2.0)
    assert set(frame["drone"]) == set(plan.flight.team.drone_names)
    assert {phase.rpartition(" (")[0] for phase in frame["phase"].unique()} == {
        "a transport, b transport",
        "a wait, b transport",
    }


def test_parts_are_cut_where_all_rest() -> None:
    """A waits while b flies on, so that only starts and ends are rests of both."""
    flight = two_hitches()
    times = flight.breaks[flight.rest_breaks]
    np.testing.assert_allclose(times, [0.0, flight.duration], atol=1e-9)
    own = alone(flight, "a")
    assert len(ho.Flight.of(own).rest_breaks) == 3  # it flies, then waits
    half = flight.between(0.0, flight.breaks[flight.drones.pieces // 2])
    assert [each.name for each in half.teams] == ["a", "b"]


def test_stretching_slows_all_groups_but_not_others(tmp_path: Path) -> None:
    flight = hitch_and_swarm()
    slow, t = flight.stretched(1.5), np.linspace(0.0, flight.duration, 9)
    np.testing.assert_allclose(slow.drones.at(1.5 * t), flight.drones.at(t), atol=1e-12)
    with_others = beside(flight, moved(alone(flight, "triangle"), 0.0, 0.0, 50.0), 2.0)
    later = with_others.stretched(1.5)
    assert later.others[0].motion is with_others.others[0].motion
    (part,) = exported(with_others, "csv", tmp_path, stretch=1.5)
    assert any("next to show, which starts at t = 2 s" in note for note in part.notes)
    near = beside(flight, alone(flight, "ring"), 0.5)
    with pytest.raises(CertificateError, match="separation"):
        exported(near, "csv", tmp_path / "near")


def test_addresses_are_by_names_of_groups(tmp_path: Path) -> None:
    flight = hitch_and_swarm()
    roles = flight.team.drone_names
    members = {role: {"name": f"cf{i}", "uri": f"udp://10.0.0.{i}"} for i, role in enumerate(roles)}
    (tmp_path / "fleet.yaml").write_text(json.dumps({"drones": members}))
    exported(flight, "csv", tmp_path / "out", fleet=tmp_path / "fleet.yaml")
    assert read_manifest(tmp_path / "out")["drones"]["ring.d1"] == members["ring.d1"]["name"]
    assert task_of(flight).names == tuple(role.replace(".", "_") for role in roles)


def test_controllers_count_where_cables_pull(tmp_path: Path) -> None:
    """An integral, which overrides tensions, is refused for drones of a hitch alone."""
    kind = ho.Quadrotor(controller="mellinger")
    flight = flown_by(hitch_and_swarm(), triangle=kind)
    with pytest.raises(ho.InfeasibleError, match="Integral action"):
        exported(flight, "compressed", tmp_path, allow_slack=False)
    flight = flown_by(hitch_and_swarm(), ring=kind)
    exported(flight, "compressed", tmp_path, allow_slack=False)


def test_a_scene_names_the_cables_of_all_groups(tmp_path: Path) -> None:
    flight = hitch_and_swarm()
    flight = beside(flight, moved(alone(flight, "triangle"), 0.0, 0.0, 50.0), 0.0)
    exported(flight, "gltf", tmp_path)
    data = (tmp_path / "plan.glb").read_bytes()
    size = int.from_bytes(data[12:16], "little")
    nodes = [node["name"] for node in json.loads(data[20 : 20 + size])["nodes"]]
    assert [name for name in nodes if name.startswith("triangle_cable") and "span" not in name] == [
        f"triangle_cable {k}" for k in range(3)
    ]
    assert not any("show" in name for name in nodes)
