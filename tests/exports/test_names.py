"""A drone is who it was: whatever edge it takes, files name it as the problem does."""

from __future__ import annotations

import csv
import json
import re
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

import hitchopt as ho
from hitchopt import verify as second
from hitchopt.cli import main
from hitchopt.drones.firmware import firmware_parameters
from hitchopt.errors import InputError
from hitchopt.exports.placing import read_fleet
from hitchopt.mission.loading import problem_from_dict
from hitchopt.motion.plan_file import read_plan
from hitchopt.storage.yaml_file import read_yaml
from hitchopt.values import Array

STARTS: Array = np.array(
    [
        [[-0.6, -1.2, 0.0], [0.6, -1.2, 0.0]],
        [[-0.47, 0.0, 0.0], [0.73, 0.0, 0.0]],
        [[-0.6, 1.2, 0.0], [0.6, 1.2, 0.0]],
    ]
)
LENGTHS, TENSIONS = [2.4, 2.42, 2.45], [0.4, 0.42, 0.41]
MASSES = [0.132, 0.134, 0.136, 0.138, 0.14, 0.142]
TRIMS = [[0.02, 0.0], [0.0, 0.03], [-0.01, 0.01], [0.03, -0.02], [0.0, -0.03], [-0.02, -0.01]]
ORDERS = {
    "as listed": ([0, 1, 2], [0, 0, 0]),
    "in another order": ([2, 0, 1], [0, 0, 0]),
    "and turned around": ([1, 2, 0], [1, 0, 1]),
}
"""Robots in the order in which a problem lists them, and whether their q and r are exchanged."""

OTHER_ORDERS = [pytest.param("in another order", marks=pytest.mark.slow), "and turned around"]

FORM: dict[str, Any] = {"polygon": [[0.0, 0.6], [0.5, -0.3], [-0.5, -0.3]], "altitude": 1.5}


def drones_of(name: str) -> list[int]:
    """Return the physical drones, 0 to 5, that a problem calls q0, r0, q1, …."""
    order, flips = ORDERS[name]
    return [2 * k + (end ^ flips[k]) for k in order for end in (0, 1)]


def section(name: str, shift: float = 0.0) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the sections ``team`` and ``start`` of a problem, moved along x [m]."""
    order, drones = ORDERS[name][0], drones_of(name)
    names = [f"{end}{k}" for k in range(3) for end in "qr"]
    each = zip(names, drones, strict=True)
    kinds = {name: {"mass": MASSES[i], "trim": TRIMS[i], "thrust_factor": 1.0 + 0.01 * i}
             for name, i in each}  # fmt: skip
    gains = {"kp": 4.75, "kd": 1.32, "ki": 0.0}
    common = {"max_thrust": 2.6, "controller": "mellinger", "gains": gains}
    team = {
        "robots": 3,
        "cable_length": [LENGTHS[k] for k in order],
        "tension": [TENSIONS[k] for k in order],
        "quadrotor": {**common, **kinds},
    }
    places = STARTS.reshape(-1, 3)[drones] + [shift, 0.0, 0.0]
    return team, {"drones": {"q": places[0::2].tolist(), "r": places[1::2].tolist()}}


@cache
def solved(name: str) -> ho.Plan:
    team, start = section(name)
    problem = {"team": team, "start": start, "mission": [{"form": FORM}, {"release": {}}]}
    return ho.solve(problem_from_dict(problem))


def rows_of(path: Path) -> list[dict[str, str]]:
    """Return the rows of a table."""
    return [*csv.DictReader(path.read_text("utf-8").splitlines())]


def saved(name: str, folder: Path) -> ho.Plan:
    solved(name).save(folder / name, rate=5.0)
    return ho.load(folder / name)


def flights(plan: ho.Plan, name: str) -> tuple[Array, Array]:
    """Return positions (times, 6, 3) [m] and forces [N] of the physical drones."""
    states = plan.at(np.linspace(0.0, plan.duration, 40))
    order = np.argsort(drones_of(name))
    return states.positions[:, order], states.cable_forces[:, order]


@pytest.mark.parametrize("name", OTHER_ORDERS)
def test_every_order_of_robots_gives_the_same_flight_of_every_drone(
    name: str, tmp_path: Path
) -> None:
    plan, other = saved("as listed", tmp_path), saved(name, tmp_path)
    assert plan.certificate.certified
    assert other.certificate.certified
    for one, another in zip(flights(plan, "as listed"), flights(other, name), strict=True):
        np.testing.assert_allclose(another, one, atol=1e-9)
    assert {row.verdict for row in second.verify(tmp_path / name / "plan.npz")} <= second.PASSING
    starts = STARTS.reshape(-1, 3)[drones_of(name)]
    np.testing.assert_array_equal(other.at(0.0).positions, starts)


@pytest.mark.parametrize("name", ["as listed", *OTHER_ORDERS])
def test_rows_and_arrays_are_in_the_order_of_the_problem(name: str, tmp_path: Path) -> None:
    saved(name, tmp_path)
    folder, drones, order = tmp_path / name, drones_of(name), ORDERS[name][0]
    rows = rows_of(folder / "setpoints.csv")[:6]
    assert [row["drone"] for row in rows] == ["q0", "r0", "q1", "r1", "q2", "r2"]
    places = [[float(row[axis]) for axis in "xyz"] for row in rows]
    np.testing.assert_allclose(places, STARTS.reshape(-1, 3)[drones], atol=1e-9)
    with np.load(folder / "plan.npz") as file:
        arrays, records = {k: file[k] for k in file}, json.loads(str(file["settings"]))
    np.testing.assert_array_equal(arrays["groups/0/drones"][0, ..., 0], places)
    assert np.max(arrays["groups/0/tensions"], axis=(0, 2)) == pytest.approx(
        [TENSIONS[k] for k in order]
    )
    team = records["groups"][0]["records"]["team"]
    assert team["cable_length"] == [LENGTHS[k] for k in order]
    assert [kind["mass"] for kind in team["quadrotor"]] == [MASSES[i] for i in drones]


@pytest.mark.parametrize("name", ["as listed", *OTHER_ORDERS])
def test_vertices_and_assignment_tell_who_holds_which_edge(name: str, tmp_path: Path) -> None:
    plan, order = saved(name, tmp_path), ORDERS[name][0]
    told = json.loads((tmp_path / name / "certificate.json").read_text("utf-8"))["assignment"]
    hitched = next(phase.end for phase in plan.phases if phase.name == "tension")
    states = plan.at(hitched)
    for edge, (robot, turned) in enumerate(zip(told["robots"], told["flipped"], strict=True)):
        first = states.positions[2 * robot + turned]  # at the edge's start, its leg's vertex
        distances = np.linalg.norm(states.vertices - first, axis=1)
        assert int(np.argmin(distances)) == edge
    rows = rows_of(tmp_path / name / "vertices.csv")
    last = [row for row in rows if abs(float(row["t"]) - hitched) < 0.1][-3:]
    expected = [TENSIONS[order[robot]] for robot in told["robots"]]
    assert [float(row["tension"]) for row in last] == pytest.approx(expected, abs=1e-3)


@pytest.mark.parametrize("name", OTHER_ORDERS)
def test_addresses_trims_and_masses_reach_their_drones(name: str, tmp_path: Path) -> None:
    saved(name, tmp_path)
    names = [f"{end}{k}" for k in range(3) for end in "qr"]
    fleet = {
        role: {"name": f"cf{i}", "uri": f"radio://0/80/2M/E7E7E7E70{i}", "type": "cf21"}
        for role, i in zip(names, drones_of(name), strict=True)
    }
    (tmp_path / "fleet.yaml").write_text(json.dumps({"drones": fleet}), "utf-8")
    arguments = ["--format", "crazyswarm2", "--fleet", str(tmp_path / "fleet.yaml")]
    folder = tmp_path / "files"
    result = CliRunner().invoke(
        main, ["export", str(tmp_path / name), *arguments, "-o", str(folder)]
    )
    assert result.exit_code == 0, result.output
    table = re.findall(
        r"^(\S+) +edge (\d), (\w+) +(p\d) +([de]_\d) +(\S+) g +(\S+),", result.stdout, re.M
    )
    assert [row[0] for row in table] == names
    assert [float(row[5]) for row in table] == [1e3 * MASSES[i] for i in drones_of(name)]
    assert [row[6] for row in table] == [f"cf{i}" for i in drones_of(name)]
    part = folder / "part1" if (folder / "part1").is_dir() else folder
    settings: Any = read_yaml(part / "crazyflies.yaml")
    robots = settings["robots"]
    assert [*robots] == [f"cf{i}" for i in drones_of(name)]
    for i, (x, y, _) in enumerate(STARTS.reshape(-1, 3).tolist()):
        robot = robots[f"cf{i}"]
        assert robot["uri"].endswith(f"70{i}")
        assert robot["initial_position"] == pytest.approx([x, y, 0.0])
        assert robot["firmware_params"]["ctrlMel"]["mass"] == pytest.approx(MASSES[i])
        first = np.loadtxt(part / f"cf{i}.csv", delimiter=",", skiprows=1)[0, [1, 9]]
        assert first == pytest.approx([x + TRIMS[i][0], y + TRIMS[i][1]], abs=1e-5)


def test_the_thrust_factor_is_multiplied_into_the_command_of_thrust() -> None:
    def command(controller: str, group: str, key: str, factor: float | None) -> float:
        kind = ho.Quadrotor(0.132, 2.6, controller=controller, thrust_factor=factor)
        return float(firmware_parameters(kind, kind.loop)[group][key])

    for controller, group, key in (
        ("mellinger", "ctrlMel", "massThrust"),
        ("pid", "posCtlPid", "thrustBase"),
    ):
        plain = command(controller, group, key, None)
        assert command(controller, group, key, 1.08) == pytest.approx(1.08 * plain, rel=1e-4)


@pytest.mark.slow
def test_drones_of_several_teams_keep_their_names(tmp_path: Path) -> None:
    """Each team's drones are its problem's; what is between teams names them as well."""
    first, second_name = [*ORDERS][1:]
    sections = {"a": section(first), "b": section(second_name, 4.0)}
    problem = {
        "teams": {name: team for name, (team, _) in sections.items()},
        "start": {name: start for name, (_, start) in sections.items()},
        "mission": [
            {
                "a": {"form": FORM},
                "b": {"form": FORM | {"polygon": [[x + 4.0, y] for x, y in FORM["polygon"]]}},
            }
        ],
    }
    ho.solve(problem_from_dict(problem)).save(tmp_path, rate=5.0)
    plan = ho.load(tmp_path)
    assert plan.certificate.certified
    starts = [
        STARTS.reshape(-1, 3)[drones_of(name)] + [x, 0.0, 0.0]
        for name, x in ((first, 0.0), (second_name, 4.0))
    ]
    np.testing.assert_allclose(plan.at(0.0).positions, np.concatenate(starts), atol=1e-12)
    rows = rows_of(tmp_path / "setpoints.csv")[:12]
    names = [f"{team}.{end}{k}" for team in "ab" for k in range(3) for end in "qr"]
    assert [row["drone"] for row in rows] == names
    assert [float(row["x"]) for row in rows] == pytest.approx(np.concatenate(starts)[:, 0])
    assert {row.verdict for row in second.verify(tmp_path / "plan.npz")} <= second.PASSING
    (export,) = plan.export("csv", tmp_path / "files")
    contents = (tmp_path / "files" / export.files[0]).read_text("utf-8").splitlines()[1:13]
    assert [line.split(",")[1] for line in contents] == names


def test_a_plan_from_the_end_of_another_keeps_the_names() -> None:
    first = ho.solve(
        problem_from_dict(
            {
                "team": section("and turned around")[0],
                "start": section("and turned around")[1],
                "mission": [{"form": FORM}],
            }
        )
    )
    polygon = [[0.0, 0.5], [0.5, -0.3], [-0.5, -0.3]]
    after = ho.morph(first.end, polygon)
    np.testing.assert_allclose(
        after.at(0.0).positions, first.at(first.duration).positions, atol=1e-6
    )
    assert after.motion.assignment == first.motion.assignment


def test_read_plans_are_the_plans_that_were_written(tmp_path: Path) -> None:
    plan = solved("and turned around")
    saved("and turned around", tmp_path)
    motion = read_plan(tmp_path / "and turned around" / "plan.npz")
    np.testing.assert_array_equal(motion.drones.coefficients, plan.motion.drones.coefficients)
    assert motion.team == plan.motion.team


@pytest.mark.parametrize(
    "entry",
    ["{name: cf1}", "{}", "{uri: x, name: 1}", "{role: q0x, uri: radio://0/80/2M/E7E7E7E701}"],
)
def test_who_is_no_drone_of_the_plan_is_said_first(entry: str, tmp_path: Path) -> None:
    """Whatever else is wrong with its entry; robots that are not enabled may have any name."""
    fleet = tmp_path / "fleet.yaml"
    fleet.write_text(f"drones:\n  a0: {entry}\n", "utf-8")
    role = "q0x" if "q0x" in entry else "a0"
    with pytest.raises(InputError, match=rf"^drones = '{role}': must be a drone of the plan; "):
        read_fleet(fleet, ["q0", "r0"])
    uris = [f"radio://0/80/2M/E7E7E7E70{k}" for k in (1, 2)]
    lines = [
        f"  q0: {{uri: {uris[0]}}}",
        f"  r0: {{uri: {uris[1]}}}",
        f"  a0: {{enabled: false, uri: {uris[0]}}}",
    ]
    fleet.write_text("\n".join(["drones:", *lines]), "utf-8")
    assert [member.role for member in read_fleet(fleet, ["q0", "r0"]).members] == ["q0", "r0"]
