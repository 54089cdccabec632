"""Crazyflies: memory, packing by cflib, settings and fleets, parts, fly.py flown by a stand-in.

The stand-in for crazyflie_py has the semantics of the firmware's high-level commander: an upload
copies pieces into memory at once, a trajectory, also a finished one, is evaluated from there at
every step, and takeoff, goTo and land fly a piece outside of that memory. A relative start shifts
the trajectory to the current setpoint, and a broadcast one is relative whatever is requested.
"""

from __future__ import annotations

import json
import re
import runpy
import shutil
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from cflib.crazyflie.mem.trajectory_memory import CompressedSegment, CompressedStart, Poly4D
from generators.drone_lists import write_checklist
from ruamel.yaml import YAML

import hitchopt as ho
from hitchopt.checks.certifying import certificate_of
from hitchopt.errors import InfeasibleError, InputError
from hitchopt.exports.contents import read_manifest
from hitchopt.exports.exporting import Export
from hitchopt.exports.formats.crazyflie import (
    BYTES,
    DEGREE,
    POLY,
    CompressedBytes,
    encode,
)
from hitchopt.exports.held_tension import REST_TIME, held_tension
from hitchopt.exports.lint import lint
from hitchopt.exports.placing import (
    Fleet,
    Member,
    ReferenceFrame,
    placeholder_fleet,
    read_fleet,
)
from hitchopt.hitch.requirements import Requirements
from hitchopt.mission.loading import problem_from_dict
from hitchopt.motion.cable_state import CableState
from hitchopt.motion.motion import Motion, Phase
from hitchopt.motion.states import flight_states_at
from hitchopt.plan import Plan
from hitchopt.trajectory import PiecewisePolynomial
from problems.swarm import reversed_stack
from tests.helpers.exported_plans import (
    Array,
    exported,
    hitch_plan,
    restless_plan,
    swarm_of,
    swarm_plan,
)
from tests.helpers.format_readers import polynomials, segments
from tests.helpers.plans import ROOT, planned


def test_the_bytes_are_those_of_cflib(tmp_path: Path) -> None:
    (part,) = exported(hitch_plan(), "crazyswarm2", tmp_path, yaw=0.25)
    for path in sorted(tmp_path.glob("*.csv")):
        table, data = np.loadtxt(path, delimiter=",", skiprows=1, comments="#"), b""
        for duration, *powers in table.tolist():
            axes = [Poly4D.Poly(powers[i : i + 8]) for i in range(0, 32, 8)]
            data += bytes(Poly4D(duration, *axes).pack())
        assert f"{len(table)} pieces, {len(data)} of 4096 bytes" in part.notes[0]
        np.testing.assert_allclose(table[:, 25:], np.eye(1, 8) * 0.25 + 0.0 * table[:, 25:])
        # In single precision nothing is lost: the numbers have been rounded to it.
        single = np.frombuffer(data, dtype="<f4").reshape(-1, 33)
        np.testing.assert_allclose(single, np.roll(table, -1, axis=1), rtol=1e-8)


def test_cflib_packs_the_same_bytes(tmp_path: Path) -> None:
    motion = hitch_plan()
    exported(motion, "compressed", tmp_path, yaw=0.25)
    (files,) = Plan(
        ho.Flight.of(motion), certificate_of(ho.Flight.of(motion)), "A plan"
    ).compressed(yaw=0.25, allow_slack=True)
    assert set(files) == set(motion.team.drone_names)
    for name, data in files.items():
        assert data == (tmp_path / f"{name}_enu.bin").read_bytes()
        start, found, rest = segments(data)
        assert (rest, start[3]) == (b"", round(np.degrees(0.25) * 10))
        # cflib truncates: half a unit more, away from zero, lands on the integers.
        nudged = [(v + 0.5 * np.sign(v)) / 1000.0 for v in start[:3]]
        packed = bytes(CompressedStart(*nudged, np.radians((start[3] + 0.5) / 10.0)).pack())
        for duration, axes in found:
            near = [[(v + 0.5 * np.sign(v)) / 1000.0 for v in axis] for axis in axes[:3]]
            segment = CompressedSegment((duration + 0.5) / 1000.0, *near, axes[3])
            packed += bytes(segment.pack())
        assert packed + bytes(CompressedSegment(0.0, [], [], [], []).pack()) == data


def test_resting_drones_take_two_rows_and_no_bytes(tmp_path: Path) -> None:
    places = np.array([[[0.0, 0.0, 1.0]], [[0.4, 0.0, 1.0]]])
    moving, still = (swarm_of(p, np.array([0.0, 3.0])) for p in (places, places[[0, 0]]))
    exported(moving, "compressed", tmp_path)
    data = (tmp_path / "d0_enu.bin").read_bytes()
    _, found, _ = segments(data)
    assert all(axes[1] == axes[2] == axes[3] == [] for _, axes in found)
    assert len(data) == 8 + len(found) * (3 + 14) + 3
    (part,) = exported(still, "crazyswarm2", tmp_path, frame="nwu")
    header, *rows = (tmp_path / "d0.csv").read_text().splitlines()
    assert (header.count(","), len(rows), lint(tmp_path)[0].frame) == (32, 2, "nwu")
    assert part.verdict.duration == pytest.approx(3.0, abs=1e-3)


@pytest.mark.parametrize("axes", [1, 2, 3])
def test_a_drone_has_memory_for_as_many_bytes_as_are_planned(axes: int) -> None:
    coefficients = np.zeros((1, 2, 3, DEGREE + 1))
    coefficients[0, 1, :axes, -1] = 1.0
    most = CompressedBytes().max_pieces(PiecewisePolynomial(np.array([0.0, 1.0]), coefficients))
    points = np.zeros((most + 1, 3, DEGREE + 1), dtype=np.int64)
    points[:, :axes, 1:] = 1
    seconds = np.full(most + 1, 1000)
    assert len(encode(seconds[1:], points[1:], 0.0)) <= BYTES < len(encode(seconds, points, 0.0))


def test_plans_that_exceed_memory_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InfeasibleError, match=r"range: 3.* limit of 32\.767 m"):
        exported(swarm_plan(), "compressed", tmp_path / "out", origin=[31.0, 0.0, 0.0])
    with pytest.raises(InfeasibleError, match=r"limit of 31 pieces(.|\n)*it: format=ros2bag"):
        exported(restless_plan(), "crazyswarm2", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_settings_name_every_drone_below_its_start(tmp_path: Path) -> None:
    """ROS refuses lists of integers and floats; a loader of YAML 1.1 wants a point in a float."""
    starts = np.array([[1.0, -2.0, 1.0], [1e-5, -1e-9, 1.0], [123456.789, 0.1234567, 1.0]])
    still = swarm_of(starts[None] + np.zeros((2, 1, 1)), np.array([0.0, 3.0]))
    still = replace(still, requirements=replace(still.requirements, arena=None))
    exported(still, "crazyswarm2", tmp_path)
    text = (tmp_path / "crazyflies.yaml").read_text()
    found = re.findall(r"initial_position: \[(.*), (.*), (.*)\]", text)
    assert all(re.fullmatch(r"-?[0-9]+\.[0-9]+", number) for numbers in found for number in numbers)
    np.testing.assert_allclose(np.array(found, float), starts * [1.0, 1.0, 0.0], atol=1e-6)
    settings = YAML(typ="safe").load(text)
    assert (settings["fileversion"], list(settings["robots"])) == (3, ["d0", "d1", "d2"])
    assert settings["all"]["firmware_params"]["commander"]["enHighLevel"] == 1
    for robot in settings["robots"].values():
        assert robot["enabled"] is True
        assert robot["uri"].startswith("radio://")
        assert robot["type"] in settings["robot_types"]


def fleet_of(folder: Path, data: object, roles: Sequence[str]) -> Fleet:
    (folder / "fleet.yaml").write_text(json.dumps(data))
    return read_fleet(folder / "fleet.yaml", roles)


def bare(fleet: Fleet) -> list[Member]:
    return [replace(each, firmware_params={}) for each in fleet.members]


def test_a_fleet_is_read_from_the_settings_that_were_written(tmp_path: Path) -> None:
    roles = swarm_plan().team.drone_names
    drones: dict[str, dict[str, Any]] = {
        role: {"name": f"cf{i}", "uri": f"radio://0/80/2M/E7E7E7E70{i}", "type": "cf21"}
        for i, role in enumerate(reversed(roles))
    }
    drones["d1"]["firmware_params"] = {"ring": {"effect": 7}, "kalman": {"pNAcc_xy": 0.5}}
    types = {"cf21": {"big_quad": True, "motion_capture": {"marker": "frame"}}}
    data = {"drones": drones, "types": types, "settings": {"a": {"b": 1e-5}}}
    path = tmp_path / "fleet.yaml"
    given = fleet_of(tmp_path, data, roles)
    for turn in ("first", "second"):
        (part,) = exported(swarm_plan(), "crazyswarm2", tmp_path / turn, fleet=path)
        replaced = [note for note in part.notes if "replaced" in note]
        assert [note.partition("plan's: ")[2] for note in replaced] == [
            "cf1: kalman.pNAcc_xy (0.5)"
        ] * (turn == "first")
        path = tmp_path / turn / "crazyflies.yaml"
        fleet, text = read_fleet(path, roles), path.read_text()
        assert text == (tmp_path / "first" / "crazyflies.yaml").read_text()
        assert bare(fleet) == bare(given)
        # What is given goes first, but the plan's parameters; the server needs the rest.
        own = fleet.members[1].firmware_params
        assert own["ring"] == {"effect": 7}
        assert isinstance(own["ring"]["effect"], int)
        assert own["kalman"] == {"pNAcc_xy": 20.0, "pNAcc_z": 20.0}
        capture = {"tracking": "librigidbodytracker", "marker": "frame", "dynamics": "default"}
        assert fleet.types["cf21"]["big_quad"] is True
        assert fleet.types["cf21"]["motion_capture"] == capture
        assert fleet.settings["firmware_logging"]["enabled"] is True
        assert '{"b": 1.0e-05}' in text  # YAML 1.1 takes 1e-05 for a text
    exported(swarm_plan(), "crazyswarm2", tmp_path / "placeholders")
    again = read_fleet(tmp_path / "placeholders" / "crazyflies.yaml", roles)
    assert bare(again) == bare(placeholder_fleet(roles))
    many = placeholder_fleet([f"d{i}" for i in range(300)])
    assert len({member.uri for member in many.members}) == 300
    assert [member.uri[:9] for member in many.members[14:16]] == ["radio://0", "radio://1"]


NAMES = ["q0", "r0", "q1", "r1", "q2", "r2"]
DRONES: dict[str, dict[str, Any]] = {
    "q0": {"name": "cf7", "uri": "radio://0/80/2M/E7E7E7E707", "type": "cf21"},
    "r0": {"name": "cf9", "uri": "radio://1/90/2M/E7E7E7E709"},
}
ROBOTS: dict[str, dict[str, Any]] = {
    "cf7": {"uri": "radio://0/80/2M/E7E7E7E707", "initial_position": [0, 0.5, 0], "role": "r0"},
    "q0": {"enabled": True, "uri": "radio://0/80/2M/E7E7E7E709", "type": "cf21"},
    "cf3": {"enabled": False, "uri": "radio://0/80/2M/E7E7E7E703", "type": "cf21"},
}


def test_robots_fly_their_roles_else_their_names(tmp_path: Path) -> None:
    data = {"fileversion": 3, "robots": ROBOTS, "robot_types": {"cf21": {}}, "all": {"a": 1}}
    fleet = fleet_of(tmp_path, data, ("q0", "r0"))
    told = [(m.role, m.name, m.type) for m in fleet.members]
    assert told == [("q0", "q0", "cf21"), ("r0", "cf7", "default")]
    assert (fleet.types, fleet.settings, fleet.is_placeholder) == ({"cf21": {}}, {"a": 1}, False)


MISTAKES: list[tuple[str, str, dict[str, object] | None, str]] = [
    ("drones", "q1", {"name": "cf1", "uri": "radio://0/1/2M/E7"}, "'q1': must be a drone of"),
    ("drones", "q0", {"uri": None}, "missing drones.q0.uri"),
    ("drones", "q0", {"name": "../up"}, "drones.q0.name = '../up': must be letters"),
    ("drones", "q0", {"name": "On"}, "no word of YAML"),
    ("drones", "q0", {"name": "CF9"}, "must be unique among drones"),
    ("drones", "q0", {"uri": DRONES["r0"]["uri"]}, "uri = .* must be unique among drones"),
    ("drones", "q0", {"uri": "E7E7E7E707"}, "drones.q0.uri = 'E7E7E7E707': must be an address"),
    ("drones", "q0", {"channel": 80}, "drones.q0.channel = 80: unknown key"),
    ("drones", "q0", {"name": 7}, "drones.q0.name = 7: must be a string"),
    ("robots", "cf3", {"enabled": True}, "robots = 'cf3': .* a robot's role states which one it"),
    ("robots", "cf3", {"enabled": True, "role": "r0"}, "robots.cf3.role = 'r0': .* and cf7 has"),
    ("robots", "cf7", {"uri": None}, "robots.cf7.uri"),
    ("drones", "r0", None, "drones = 'r0': must be named once"),
    ("others", "q0", {}, "others = .*unknown key"),
]


@pytest.mark.parametrize(("root", "name", "keys", "reported"), MISTAKES)
def test_mistakes_of_fleets_are_reported_by_key(
    root: str, name: str, keys: dict[str, object] | None, reported: str, tmp_path: Path
) -> None:
    entries: dict[str, Any] = {"drones": DRONES, "robots": ROBOTS}.get(root, {})
    entry = {k: v for k, v in {**entries.get(name, {}), **(keys or {})}.items() if v is not None}
    given = {**entries, name: entry}
    if keys is None:
        del given[name]
    with pytest.raises(InputError, match=reported):
        fleet_of(tmp_path, {root: given}, ("q0", "r0"))


@pytest.fixture(scope="module")
def parts(tmp_path_factory: pytest.TempPathFactory) -> tuple[Export, ...]:
    folder = tmp_path_factory.mktemp("mission")
    return exported(planned("tie_carry_untie").motion, "crazyswarm2", folder)


@pytest.mark.slow
def test_long_plans_are_cut_at_rests(parts: tuple[Export, ...], tmp_path: Path) -> None:
    motion, home = planned("tie_carry_untie").motion, parts[0].folder.parent
    checked = [{check.name for check in part.verdict.checks} for part in parts]
    assert all({"separation", "cable_clearance"} <= names for names in checked)
    linted = lint(home)
    assert [report.path for report in linted] == [part.folder for part in parts]
    assert all(report.sound for report in linted)
    assert all(fact.size <= 4096 for report in linted for fact in report.facts)
    manifest = read_manifest(home)
    assert manifest["parts"] == [part.folder.name for part in parts]
    spans = manifest["plan_spans"]
    assert [begins for begins, _ in spans] == [part.begins for part in parts]
    assert [0.0, *(end for _, end in spans)] == [*(begins for begins, _ in spans), motion.duration]
    for part, (begins, ends) in zip(parts, spans, strict=True):
        told = f"part {parts.index(part) + 1} of {len(parts)}, t = {begins:.3f} s to "
        assert any(note.startswith(told) for note in part.notes)
        assert any("goTo every drone's hover point" in note for note in part.notes)
        assert all(
            told in (part.folder / file).read_text("utf-8") for file in ("README.txt", "fly.py")
        )
        assert read_manifest(part.folder)["plan_span"] == [begins, ends]
        # What is flown lasts as long and rests longer, rounded up to the format's clock.
        last, path = np.array([part.verdict.duration]), part.folder / "q0.csv"
        assert 0.0 <= last[0] - (ends - begins + REST_TIME) < POLY.quantum
        t = np.array([0.0, 0.7, ends - begins])
        held = held_tension(ho.Flight.of(motion).between(begins, ends)).flight
        places = flight_states_at(held, t).listed(motion.team).positions[:, 0]
        np.testing.assert_allclose(polynomials(path, t), places, atol=1e-3)
        for at in (np.zeros(1), last):
            assert all(np.max(np.abs(polynomials(path, at, order))) < 1e-4 for order in (1, 2))
    # A shorter plan in the same folder leaves none of the parts behind.
    later = Path(shutil.copytree(home, tmp_path / "later"))
    exported(hitch_plan(), "crazyswarm2", later)
    assert [p for p in later.iterdir() if p.is_dir()] == []


def test_stacked_starts_are_reported(tmp_path: Path) -> None:
    motion = ho.solve(problem_from_dict(reversed_stack(3))).motion
    (part,) = exported(motion, "crazyswarm2", tmp_path)
    assert any("would take off from the same position" in note for note in part.notes)


class Craft:
    """One Crazyflie: where it hovers, how long it is busy, and what its memory holds."""

    def __init__(self, show: Show, name: str, place: Array) -> None:
        self.show, self.name, self.place = show, name, place
        self.armed, self.state, self.busy = isinstance(self, OldCraft), "idle", 0.0
        self.rows = np.zeros((0, 33))
        self.held = {"kalman.pNAcc_xy": 0.5}  # parameters on board
        self.read = dict[str, float]()  # what the server has read of them

    def getParam(self, name: str) -> float:
        return self.read.get(name, float("nan"))

    def setParam(self, name: str, value: float) -> None:
        self.held[name] = self.read[name] = value

    def _go(self, state: str, goal: Sequence[float], duration: float) -> None:
        assert self.show.now >= self.busy - 1e-6  # what it flies is not cut off
        assert state != "hovering" or goal[2] > 0.04  # never on the floor
        if self.armed:
            self.state, self.place = state, np.array(goal)
            self.busy = self.show.now + duration

    def takeoff(self, targetHeight: float, duration: float) -> None:
        self.show.calls.append((self.name, "takeoff"))
        if self.state == "idle":
            self._go("hovering", [*self.place[:2], targetHeight], duration)

    def land(self, targetHeight: float, duration: float) -> None:
        self._go("idle", [*self.place[:2], targetHeight], duration)

    def goTo(self, goal: Sequence[float], _yaw: float, duration: float) -> None:
        self.show.calls.append((self.name, "goTo"))
        self._go("hovering", goal, duration)

    def arm(self, arm: bool) -> None:
        self.show.calls.append((self.name, "arm"))
        self.armed = arm

    def uploadTrajectory(self, _number: int, offset: int, trajectory: Rows) -> None:
        self.show.calls.append((self.name, "uploadTrajectory"))
        assert offset == 0
        assert self.state != "flying"  # a trajectory, also a finished one, is flown from memory
        self.rows = trajectory.rows

    def startTrajectory(
        self, _number: int, timescale: float = 1.0, reverse: bool = False, relative: bool = True
    ) -> None:
        self.show.calls.append((self.name, "startTrajectory"))
        assert (timescale, reverse) == (1.0, False)
        shift, last = self.place - self.rows[0, [1, 9, 17]], self.rows[-1]
        # Hovering drones must not jump; others stand where the pilot has put them.
        assert np.linalg.norm(shift) < (0.1 if self.state == "idle" else 2e-3)
        end = last[1:25].reshape(3, 8) @ last[0] ** np.arange(8) + relative * shift
        self._go("flying", end.tolist(), float(np.sum(self.rows[:, 0])))


class OldCraft(Craft):
    """As clients before arming know it."""

    arm = property()


class Rows:
    """Stands for uav_trajectory.Trajectory."""

    def loadcsv(self, path: Path) -> None:
        self.rows = np.loadtxt(path, delimiter=",", skiprows=1, usecols=range(33), ndmin=2)


class Show:
    """Stands for Crazyswarm, its allcfs and its timeHelper; drones stand by the settings."""

    def __init__(
        self, folder: Path, kind: type[Craft] = Craft, beside: float = 0.0, launches: int = 2
    ) -> None:
        self.now, self.calls = 0.0, list[tuple[str, str]]()
        self.robots = YAML(typ="safe").load(folder / "crazyflies.yaml")["robots"]
        self.crazyfliesByName = {
            name: kind(self, name, np.array(robot["initial_position"]) + [beside, beside, 0.0])
            for name, robot in self.robots.items()
        }
        self.allcfs = self.timeHelper = self
        for _ in range(launches):
            self.launch()

    def launch(self) -> None:
        """Read what the drones hold, and then write what the file says, as the server does."""
        for name, craft in self.crazyfliesByName.items():
            craft.read = dict(craft.held)
            groups = self.robots[name]["firmware_params"]
            craft.held |= {
                f"{g}.{key}": x for g, named in groups.items() for key, x in named.items()
            }

    def sleep(self, duration: float) -> None:
        self.now += duration

    def __getattr__(self, name: str) -> Callable[..., None]:
        if name not in {"land", "startTrajectory"}:
            raise AttributeError(name)

        def command(*args: object, **keys: object) -> None:
            self.calls.append(("all", name))
            if name == "startTrajectory":
                keys["relative"] = True  # the server drops what is requested
            for craft in self.crazyfliesByName.values():
                getattr(craft, name)(*args, **keys)

        return command

    def run(
        self, monkeypatch: pytest.MonkeyPatch, script: Path, *arguments: str, answer: str = ""
    ) -> None:
        """Run a script as a user does."""
        package, reader = ModuleType("crazyflie_py"), ModuleType("crazyflie_py.uav_trajectory")
        package.__dict__["Crazyswarm"] = lambda: self
        reader.__dict__["Trajectory"] = Rows
        with monkeypatch.context() as patched:
            patched.setitem(sys.modules, "crazyflie_py", package)
            patched.setitem(sys.modules, "crazyflie_py.uav_trajectory", reader)
            patched.setattr("builtins.input", lambda _: answer)
            patched.setattr(sys, "argv", [script.name, *arguments])
            runpy.run_path(str(script), run_name="__main__")


def end_of(folder: Path, name: str) -> Array:
    path = folder / f"{name}.csv"
    last = float(np.sum(np.loadtxt(path, delimiter=",", skiprows=1)[:, 0]))
    place: Array = polynomials(path, np.array([last]))[0]
    return place


@pytest.mark.slow
def test_no_setpoint_jumps_through_all_parts(
    parts: tuple[Export, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    count = len(parts)
    assert count > 1
    show = Show(parts[0].folder)
    for number, part in enumerate(parts, 1):
        options, answer = ["--from-here"] * (number > 1), "stay\n" * (number < count)
        show.run(monkeypatch, part.folder / "fly.py", *options, answer=answer)
        for name, craft in show.crazyfliesByName.items():
            assert craft.state == ("flying" if answer else "idle")
            # The plan ends on the floor: landing moves nobody.
            assert np.linalg.norm(craft.place - end_of(part.folder, name)) < 1e-5
    show = Show(parts[0].folder)  # started in the air without its option
    show.run(monkeypatch, parts[0].folder / "fly.py", answer="stay")
    show.run(monkeypatch, parts[-1].folder / "fly.py")
    for name, craft in show.crazyfliesByName.items():
        assert craft.state == "idle"
        assert np.linalg.norm(craft.place - end_of(parts[-1].folder, name)) < 1e-5


def from_the_floor() -> Motion:
    places = np.array([[[0.1, 0.2, 0.0], [1.1, 0.3, 0.8]], [[0.1, 0.5, 1.0], [1.1, 0.6, 0.9]]])
    return swarm_of(places, np.array([0.0, 3.0]))


EXPORT_RULES: dict[str, tuple[Callable[[], Motion], list[str]]] = {
    "in the air": (swarm_plan, ["takeoff", "goTo"]),
    "on the floor": (from_the_floor, []),
}
"""Plans by where their first drone begins, and what is done before its upload."""


@pytest.mark.parametrize("kind", [Craft, OldCraft])
@pytest.mark.parametrize("begins", EXPORT_RULES)
def test_a_whole_plan_from_take_off_to_landing(
    begins: str, kind: type[Craft], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Drones on the floor are armed at last: the trajectory begins right after it.

    All end where the plan does, although they stand 3 cm beside their places in x and y.
    """
    plan, before = EXPORT_RULES[begins]
    exported(plan(), "crazyswarm2", tmp_path)
    show = Show(tmp_path, kind, 0.03)
    show.run(monkeypatch, tmp_path / "fly.py")
    for name, craft in show.crazyfliesByName.items():
        landed = [*end_of(tmp_path, name)[:2], 0.04]
        np.testing.assert_allclose(craft.place, landed, atol=1e-5)
    arming = ["arm"] * (kind is Craft)
    first = plan().team.drone_names[0]
    calls = [call for who, call in show.calls if who == first]
    own = [*before, "uploadTrajectory"]
    assert calls == (arming + own if before else own + arming) + ["startTrajectory"]
    assert [call for who, call in show.calls if who == "all"] == ["land"]
    note = (tmp_path / "README.txt").read_text(encoding="utf-8")
    assert note.index("goTo (absolute)") < note.index("only then upload")
    assert all(words in note for words in ("Brushless", "relative=False", "placeholders"))


def test_a_broadcast_start_would_keep_drones_beside_their_trajectories(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The server's is relative, so the script starts each drone by itself."""
    exported(from_the_floor(), "crazyswarm2", tmp_path)
    script, other = tmp_path / "fly.py", tmp_path / "other.py"
    text = script.read_text(encoding="utf-8")
    loop = "for drone in drones.values():  # not by the broadcast, which is relative: see above\n"
    assert loop in text
    other.write_text(text.replace(loop, "for drone in [everyone]:\n"), encoding="utf-8")
    for each, off in ((script, 0.0), (other, 0.05)):
        show = Show(tmp_path, beside=0.05)
        show.run(monkeypatch, each)
        craft = show.crazyfliesByName["d0"]
        np.testing.assert_allclose(craft.place[:2] - end_of(tmp_path, "d0")[:2], off, atol=1e-5)


def test_drones_that_end_tied_land_without_the_pull(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Their setpoints go to the plan's places first, from up to 15 cm outside."""
    kind = ho.Quadrotor(controller="mellinger", gains={"kp": 4.75, "kd": 1.32, "ki": 0})
    team = ho.Team(3, 2.4, tension=0.6, quadrotor=kind)
    hitch = ho.Hitch.balanced(team, [[0.3, 0.4], [0.8, -0.5], [-0.2, -0.5]], 1.2)
    origin, yaw = (1.0, 0.5, 0.2), 0.4
    motion, place = ho.solve(hitch, ho.Hold(0.5)).motion, {"origin": origin, "yaw": yaw}
    exported(motion, "crazyswarm2", tmp_path, **place)
    planned_places = ReferenceFrame("enu", origin, yaw).points(hitch.drones)
    for answer, word in (("", "idle"), ("stay", "flying")):
        show = Show(tmp_path)
        show.run(monkeypatch, tmp_path / "fly.py", answer=answer)
        for name, goal in zip(NAMES, planned_places, strict=True):
            craft = show.crazyfliesByName[name]
            off = np.linalg.norm(craft.place[:2] - goal[:2])
            assert craft.state == word
            assert off == pytest.approx(0.0, abs=1e-5) if word == "idle" else 0.1 < off < 0.2
    assert "SLACK" in (tmp_path / "README.txt").read_text(encoding="utf-8")
    exported(hitch_plan(), "crazyswarm2", tmp_path)  # whose setpoints are the plan's places
    assert "\nSLACK = {}  #" in (tmp_path / "fly.py").read_text(encoding="utf-8")
    assert "SLACK" not in (tmp_path / "README.txt").read_text(encoding="utf-8")


def test_set_points_that_hold_a_weight_are_above_drones_that_stand(tmp_path: Path) -> None:
    """Half a cable of 72 g moves them up by 18 cm; the drones stand on the floor all the same."""
    team = ho.Team(3, 2.4, cable_density=0.03, tension=0.6, quadrotor=ho.Quadrotor(stiffness=2.0))
    places = [[x, y + 0.2 * x * y, 0.0] for y in (-1.0, 0.1, 1.3) for x in (-0.7, 0.7)]
    drones = PiecewisePolynomial.constant([0.0, 0.5], places)
    phases = [Phase("stand", 0, 0.0, 0.5, state=CableState.GROUND)]
    for ground, standing in ((-0.1, []), (0.0, NAMES)):
        needs = Requirements(ho.Limits(floor=ground))
        here = ho.Motion.single(team, needs, drones, phases)
        exported(here, "crazyswarm2", tmp_path, hold_tension=True)
        script = (tmp_path / "fly.py").read_text(encoding="utf-8")
        assert f"\nSTANDING = {standing}  #" in script
        assert f"\nLANDED = {bool(standing)}  #" in script
        first = polynomials(tmp_path / "q0.csv", np.zeros(1))[0]
        assert first[2] - here.drones.at(0.0)[0, 2] > 0.1


@pytest.mark.parametrize("fault", ["one launch", "power cycle", "changed", ""])
def test_drones_that_hold_other_parameters_are_not_armed(
    fault: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    exported(from_the_floor(), "crazyswarm2", tmp_path)
    show = Show(tmp_path, launches=1 if fault == "one launch" else 2)
    craft = show.crazyfliesByName["d1"]
    if fault == "power cycle":
        craft.held = {}
        show.launch()
    elif fault == "changed":
        craft.read["locSrv.extQuatStdDev"] = 0.05
    if not fault:
        craft.held["kalman.pNAcc_z"] = 1.0  # by a launch that has written another file
        show.run(monkeypatch, tmp_path / "fly.py")
        assert craft.held["kalman.pNAcc_z"] == 20.0
        return
    for _ in range(2):  # a refusal changes nothing that a second try could read
        with pytest.raises(
            SystemExit, match=r"d1: locSrv.extQuatStdDev is .*, not 0.01(.|\n)*twice"
        ):
            show.run(monkeypatch, tmp_path / "fly.py")
    assert show.calls == []


def test_lint_reads_the_parameters_and_markers_of_robots(tmp_path: Path) -> None:
    exported(from_the_floor(), "crazyswarm2", tmp_path)
    path, found = tmp_path / "crazyflies.yaml", list[list[str]]()
    text = path.read_text(encoding="utf-8")
    other = text.replace('"pNAcc_xy": 20.0', '"pNAcc_xy": 0.5', 1)
    for change in (
        text,
        other,
        other.replace("      locSrv", "      x", 1),
        text.replace('"marker": "default"', '"marker": "default_single_marker"'),
        text.replace("enabled: true", "enabled: false").replace("20.0", "1.0"),
        "robots: {d0: 7, d1: {type: [1]}}\nall: 3",
    ):
        path.write_text(change, encoding="utf-8")
        (report,) = lint(tmp_path)
        rules = ("parameters", "markers")
        found.append([str(f) for f in report.findings if f.rule in rules])
    assert [len(each) for each in found] == [0, 1, 1, 2, 0, 1]
    assert found[1] == [
        "error: parameters: d0: kalman.pNAcc_xy is 0.5, not 20.0: fly.py refuses to arm"
    ]
    assert "locSrv.extPosStdDev is missing, not 0.001" in found[2][0]
    assert found[3][0].startswith("warning: markers: d0: one marker (default_single_marker)")
    # Others' files are judged by the filter alone, on all three levels of the server's settings.
    path.write_text(other, encoding="utf-8")
    (tmp_path / "export.json").unlink()
    assert lint(tmp_path)[0].sound
    filter_alone = {"kalman": {"pNAcc_xy": 20, "pNAcc_z": 20}, "locSrv": {"extPosStdDev": 1e-3}}
    (report,) = lint(tmp_path)
    assert [f.level for f in report.findings if f.rule == "parameters"] == ["warning"]
    own, kind = ({"locSrv": {"extQuatStdDev": value}} for value in (0.01, 0.05))
    robot = {"type": "a", "firmware_params": own}
    levels = {"robots": {"d0": robot}, "robot_types": {"a": {"firmware_params": kind}}}
    path.write_text(json.dumps({**levels, "all": {"firmware_params": filter_alone}}))
    assert not [f for f in lint(tmp_path)[0].findings if f.rule == "parameters"]


def test_the_note_says_where_each_drone_is_on_the_hitch(tmp_path: Path) -> None:
    motion = hitch_plan()
    exported(motion, "crazyswarm2", tmp_path)
    rows = re.findall(
        r"^(\w+) +(\w+) +edge (\d), (start|end) +p(\d)",
        (tmp_path / "README.txt").read_text("utf-8"),
        re.MULTILINE,
    )
    assert [role for _, role, *_ in rows] == list(motion.team.listed_names)
    for (_, _, edge, end, vertex), place in zip(rows, motion.team.listed, strict=True):
        assert 2 * int(edge) + ("start", "end").index(end) == place
        assert int(vertex) == motion.team.layout.anchors[place]


def test_the_checklist_is_the_same_everywhere(tmp_path: Path) -> None:
    exported(hitch_plan(), "crazyswarm2", tmp_path)
    page = (ROOT / "docs/how_to/before_you_fly.md").read_text(encoding="utf-8")
    assert "generated/checklist.inc" in page.partition("## Checklist")[2]
    items = re.findall(r"^(\d+\. .*)$", write_checklist(), re.MULTILINE)
    assert len(items) == 11
    for file in ("fly.py", "README.txt"):
        text = (tmp_path / file).read_text(encoding="utf-8")
        assert all(line in text for line in items)
