"""What the problem in a plan file asks for: each key that the plan contradicts is found."""

from __future__ import annotations

import copy
import json
from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

import hitchopt as ho
from hitchopt import verify as second
from hitchopt.cli import main
from hitchopt.errors import FileError
from hitchopt.mission.loading import problem_from_dict
from hitchopt.motion.motion import Motion, concatenated
from hitchopt.motion.plan_file import write_plan
from hitchopt.motion.request import check_request
from hitchopt.motion.retiming import cut, resting
from hitchopt.steps import STEP_KINDS, Step
from hitchopt.storage.yaml_file import parse_yaml
from hitchopt.values.fields import keys_of
from hitchopt.verify import request, steps
from tests.helpers.plans import PROBLEMS, planned, planned_of

Path_ = tuple[str | int, ...]

TIED = """
team: {robots: 3, cable_length: 2.4, cable_density: 0.005, quadrotor: paper_132g}
start:
  drones:
    q: [[-0.5, -1.2, 0], [-0.5, 0, 0], [-0.5, 1.2, 0]]
    r: [[0.5, -1.2, 0], [0.5, 0, 0], [0.5, 1.2, 0]]
mission:
  - form:
      polygon: [[0, 0.58], [0.5, -0.29], [-0.5, -0.29]]
      altitude: 1.2
      swap: {radius: 0.15, tilt_deg: 50, sense: down}
"""
SWUNG = """
team:
  robots: 4
  cable_length: [2.4, 2.5, 2.4, 2.5]
  cable_density: 0.01
  cable_friction: 0.15
  tension: [0.8, 0.8, 0.8, 0.9]
  quadrotor: paper_132g
start:
  hitch:
    polygon: [[1.5, 1.1], [2.6, 1.0], [2.5, -0.1], [1.5, -0.1]]
    altitude: 1.5
    legs: {sharing: [0.65, 0.6, 0.65, 0.6], roll_deg: [8, 5, -3, 8]}
mission:
  - adjust: {legs: {sharing: [0.6, 0.6, 0.65, 0.6], roll_deg: [9, 4, -3, 8]}, settle: 21}
  - adjust: {legs: {sharing: [0.65, 0.6, 0.65, 0.6], roll_deg: 7}, settle: false}
"""
MOVED = """
team: {robots: 3, cable_length: [2.4, 2.3, 2.4], tension: 0.5}
limits: {speed: 0.9, floor: 0.2, tilt_deg: 40, tracking: {level: 0.01, height: 0.01}}
separation: {cable: 0.09}
arena: {lower: [-4, -4, 0], upper: [4, 4, 3]}
start: {hitch: {polygon: [[0, -1], [-0.4, 0.5], [0.4, 0.5]], altitude: 1.0, legs: [0.3, 0.3, 0.3]}}
mission:
  - morph: {polygon: [[0, -0.9], [-0.4, 0.5], [0.4, 0.5]], legs: [0.35, 0.35, 0.3], duration: 3}
  - move_vertex: {vertex: 0, to: [0, -0.8]}
  - move_vertex: {vertex: 1, by: [-0.1, 0.0]}
  - move_edge: {edge: 1, by: [0, 0.1]}
  - follow_vertex: {vertex: 0, path: [[2, 0, -0.85], [4, 0, -0.8]]}
  - follow_vertex: {vertex: 0, path: [[0, -0.82], [0, -0.84]], speed: 0.1}
  - adjust: {legs: {sharing: [0.4, 0.35, 0.35], roll_deg: 4}}
  - transport: {to: [0.3, 0.2, 1.3], yaw_deg: 20}
  - hold: {seconds: 0.5}
"""
CHAINED = """
team: {robots: 3, cable_length: [2.3, 2.2, 2.4], topology: open, tension: 0.4}
start:
  hitch: {polygon: [[12.7, 20], [13.2, 20.5], [14, 20.6], [14.5, 20]], altitude: 1.5}
mission:
  - morph: {polygon: [[12.7, 20], [13.2, 20.6], [14, 20.7], [14.5, 20]]}
  - move_vertex: {vertex: 0, by: [0.1, -0.1]}
  - move_vertex: {vertex: 2, to: [14, 20.65]}
  - move_edge: {edge: 2, by: [0.1, 0]}
  - follow_vertex: {vertex: 3, path: [[2, 14.6, 19.9], [4, 14.6, 20]]}
  - transport: {to: [13.6, 20.3, 1.8], yaw_deg: 20}
  - hold: {seconds: 0.5}
"""
SAGGING = """
team: {robots: 3, cable_length: 2.8, cable_density: 0.01, tension: 0.8, quadrotor: paper_132g}
start:
  hitch: {polygon: [[0, 0.5], [0.5, -0.4], [-0.5, -0.4]], altitude: 1.5, legs: [0.7, 0.7, 0.7]}
mission:
  - adjust: {legs: [0.75, 0.7, 0.7]}
"""
UNSTOPPED = """
team: {robots: 3, cable_length: 2.4}
start: {hitch: {polygon: [[0, -1], [-0.4, 0.5], [0.4, 0.5]], altitude: 1.0}}
mission:
  - move_vertex: {vertex: 0, to: [0, -0.8], blend: true}
  - move_vertex: {vertex: 0, by: [0.1, 0.1], blend: true}
  - move_edge: {edge: 1, by: [0, 0.1]}
"""
CARRIED_ON = """
team: {robots: 3, cable_length: 2.4}
start: {hitch: {polygon: [[0, -1], [-0.4, 0.5], [0.4, 0.5]], altitude: 1.0}}
mission:
  - move_vertex: {vertex: 0, to: [0, -0.8], blend: true}
  - transport: {to: [0.5, 0.2, 1.3], yaw_deg: 40, duration: 5, blend: true}
  - move_edge: {edge: 1, by: [0, 0.1]}
  - move_edge: {edge: 1, by: [0, -0.1], blend: true}
  - transport: {to: [0.8, 0.2, 1.2], yaw_deg: 20, duration: 4}
"""
GRASPED = """
team: {robots: 3, cable_length: 1.69, tension: 1.0}
objects: {drum: {circle: 0.2, to: 0.3, mass: 0.03, at: [0, 0, 0]}}
start: {hitch: {polygon: [[0.67, 0], [-0.335, -0.58], [-0.335, 0.58]], altitude: 1.2}}
mission:
  - enclose: {object: drum}
  - grasp: {object: drum, by: grip, tension: 1.1}
  - lift: {by: 0.1}
  - carry: {object: drum, to: [0.2, 0, 0.1]}
  - set_down: {object: drum}
"""
LANDED = f"""{TIED}
  - release: {{to: [[-1, 2], [-1, 1], [0, 2], [0, 1], [1, 1], [1, 2]]}}
  - land: {{to: [[1, 2], [1, 1], [0, 1], [0, 2], [-1, 1], [-1, 2]], assign: auto}}
"""
MEASURED = """
team:
  robots: 3
  cable_length: 2.4
  quadrotor: {mass: 0.132, max_thrust: 2.6, trim: [0.01, 0.0], tracking: 0.002}
start: {hitch: {polygon: [[0, -1], [-0.4, 0.5], [0.4, 0.5]], altitude: 1.0}}
mission: [{hold: {seconds: 1.0}}]
"""
TEXTS = {
    "landed": LANDED,
    "tied": TIED,
    "moved": MOVED,
    "swung": SWUNG,
    "chained": CHAINED,
    "unstopped": UNSTOPPED,
    "carried_on": CARRIED_ON,
    "grasped": GRASPED,
    "measured": MEASURED,
}
ROLLED, BOX = "roll_square", "carry_box"


def text_of(name: str) -> str:
    given = TEXTS.get(name)
    return given or (PROBLEMS / f"{name}.yaml").read_text("utf-8")


@cache
def flight_of(name: str) -> ho.Flight:
    data: Any = parse_yaml(text_of(name))
    plan: ho.Plan = planned_of(data) if name in TEXTS else planned(name)
    return plan.flight


def found(name: str, path: Path_, value: Any, folder: Path) -> list[str]:
    """Return the keys that verify finds where the problem asks for another value."""
    file = folder / "plan.npz"
    write_plan(file, flight_of(name), "", text_of(name))
    with np.load(file) as read:
        arrays = dict(read)
    settings = json.loads(str(arrays["settings"]))
    if path:
        entry = settings["request"]
        for key in path[:-1]:
            entry = entry[key]
        entry[path[-1]] = value
    np.savez(file, **{**arrays, "settings": np.array(json.dumps(settings))})
    rows = [row for plan in second.read(file)[0] for row in second.requested(plan)]
    return [key for row in rows if row.verdict == "violated" for key in row.where.split(", ")]


def lie(name: str, path: str, value: Any) -> Any:
    """Return a lie by the words of its key, as ``mission 0 morph polygon``."""
    keys = tuple(int(x) if x.isdigit() else x for x in path.split())
    slow = name in (BOX, "two_teams")
    marks = [pytest.mark.slow] if slow else []
    return pytest.param(name, keys, value, id=f"{name}: {path}", marks=marks)


LIES = [
    lie("moved", "team cable_length", [2.4, 2.4, 2.4]),
    lie("moved", "team tension", 0.51),
    lie("moved", "team topology", "open"),
    lie("moved", "team quadrotor", {"mass": 0.14}),
    lie("measured", "team quadrotor trim 0", 0.02),
    lie("measured", "team quadrotor tracking", 0.003),
    lie("moved", "limits speed", 0.8),
    lie("moved", "limits floor", 0.1),
    lie("moved", "limits tilt_deg", 39),
    lie("moved", "limits tracking", 0.02),
    lie("moved", "limits tracking height", 0.02),
    lie("moved", "separation cable", 0.1),
    lie("moved", "arena upper", [4, 4, 2.9]),
    lie("moved", "start hitch polygon", [[0, -1.01], [-0.4, 0.5], [0.4, 0.5]]),
    lie("moved", "start hitch altitude", 1.01),
    lie("moved", "start hitch legs", [0.3, 0.3, 0.31]),
    lie("moved", "mission 0 morph polygon", [[0, -0.91], [-0.4, 0.5], [0.4, 0.5]]),
    lie("moved", "mission 0 morph legs", [0.35, 0.3, 0.35]),
    lie("moved", "mission 0 morph duration", 3.1),
    lie("moved", "mission 0 morph tension", {"min": 0.55, "max": 0.6}),
    lie("moved", "mission 1 move_vertex to", [0, -0.81]),
    lie("moved", "mission 1 move_vertex vertex", 1),
    lie("moved", "mission 2 move_vertex by", [-0.11, 0.0]),
    lie("moved", "mission 3 move_edge by", [0.01, 0.1]),
    lie("moved", "mission 3 move_edge to", [[-0.51, 0.6], [0.4, 0.6]]),
    lie("moved", "mission 3 move_edge edge", 0),
    lie("moved", "mission 4 follow_vertex path", [[2, 0, -0.86], [4, 0, -0.8]]),
    lie("moved", "mission 4 follow_vertex path", [[2.1, 0, -0.84], [4, 0, -0.8]]),
    lie("moved", "mission 5 follow_vertex path", [[0.05, -0.82], [0, -0.84]]),
    lie("moved", "mission 5 follow_vertex speed", 0.02),
    lie("moved", "mission 6 adjust legs", [0.4, 0.35, 0.3]),
    lie("moved", "mission 6 adjust legs sharing", [0.4, 0.35, 0.3]),
    lie("moved", "mission 6 adjust legs roll_deg", -4),
    lie("moved", "mission 6 adjust legs roll_deg", [4, 4, 5]),
    lie("moved", "mission 7 transport to", [0.3, 0.2, 1.31]),
    lie("moved", "mission 7 transport to", [0.31, 0.2, 1.3]),
    lie("moved", "mission 7 transport yaw_deg", -20),
    lie("moved", "mission 8 hold seconds", 0.6),
    lie("moved", "mission", []),
    lie("moved", "mission 0", {"hold": {"seconds": 3}}),
    lie("moved", "mission 1", {"adjust": {}}),
    lie("moved", "mission 1", {"settle": {}}),
    lie("moved", "mission 8", {"release": {}}),
    lie("unstopped", "mission 1 move_vertex by", [0.1, 0.11]),
    lie("unstopped", "mission 2 move_edge by", [0, 0.11]),
    lie("chained", "team topology", "closed"),
    lie("chained", "mission 3 move_edge edge", 1),
    lie("chained", "mission 5 transport to", [13.6, 20.31, 1.8]),
    lie("chained", "mission 5 transport yaw_deg", -20),
    lie("tied", "start drones q 0", [-0.5, -1.2, 0.1]),
    lie("tied", "mission 0 form altitude", 1.3),
    lie("tied", "mission 0 form polygon 0", [0, 0.6]),
    lie("tied", "mission 0 form swap radius", 0.5),
    lie("tied", "mission 0 form swap seconds", 30.0),
    lie("tied", "mission 0 form swap tilt_deg", 51),
    lie("tied", "mission 0 form swap tilt_deg", 40),
    lie("tied", "mission 0 form swap sense", "up"),
    lie("tied", "mission 0 form swap sense", 1),
    lie("landed", "mission 1 release to 0", [-1, 2.01]),
    lie("landed", "mission 1 release assign", "fixed"),
    lie("landed", "mission 2 land to 5", [-1, 2.01]),
    lie("landed", "mission 2 land assign", "fixed"),
    lie("swung", "start hitch legs roll_deg", [8, 5, -2.99, 8]),
    lie("swung", "start hitch legs roll_deg", 8),
    lie("swung", "mission 0 adjust legs roll_deg 0", 9.01),
    lie("swung", "mission 0 adjust legs roll_deg 2", 3),
    lie("swung", "mission 0 adjust settle", 20),
    lie("swung", "mission 0 adjust settle", False),
    lie("swung", "mission 1 adjust legs roll_deg", -7),
    lie("tied", "mission 0 form legs", [0.5, 0.5, 0.5]),
    lie("grasped", "mission 1 grasp by", "rest"),
    lie("grasped", "mission 1 grasp tension", 1.2),
    lie("grasped", "objects drum mass", 0.031),
    lie("grasped", "objects drum circle", 0.21),
    lie("grasped", "objects drum at", [0.1, 0, 0]),
    lie("grasped", "mission 2 lift by", 0.11),
    lie("grasped", "mission 3 carry to", [0.2, 0.1, 0.1]),
    lie("grasped", "mission 3 carry yaw_deg", 10),
    lie("grasped", "mission 3 carry object", "box"),
    lie("grasped", "mission 4", {"loosen": {"object": "drum"}}),
    lie("grasped", "mission 4", {"land": {}}),
    lie("landed", "mission 2", {"hold": {"seconds": 1.0}}),
    lie(BOX, "mission 1 transport_object to", [2.2, 2.3, 0.4]),
    lie(BOX, "mission 1 transport_object yaw_deg", 10),
    lie(BOX, "mission 1 transport_object lift", 0.4),
    lie(BOX, "mission 1 transport_object via", [[1.0, 1.0, 1.0]]),
    lie(BOX, "mission 1 transport_object by", "grip"),
    lie(BOX, "mission 1 transport_object tension", 0.9),
    lie("two_teams", "teams b cable_length", 2.1),
    lie("two_teams", "start b hitch altitude", 1.6),
    lie("two_teams", "mission 0 b transport to", [0, 2.6, 1.5]),
    lie("blended", "mission 0 move_vertex blend", False),
    lie("carried_on", "mission 1 transport blend", False),
    lie("carried_on", "mission 1 transport to 0", 0.51),
    lie("carried_on", "mission 1 transport yaw_deg", 41),
    lie("carried_on", "mission 1 transport duration", 9),
    lie("carried_on", "mission 2 move_edge by 1", 0.11),
    lie("carried_on", "mission 4 transport to 2", 1.21),
    lie("carried_on", "mission 4 transport yaw_deg", 21),
    lie("carried_on", "mission 4 transport duration", 9),
    lie("swarms/circle_6", "goal 0", [0, 0, 1]),
    lie("swarms/circle_6", "start 0", [0, 0, 1]),
    lie("swarms/circle_6", "duration", 30.0),
    lie("swarms/circle_6", "keep_out", [{"polygon": [[9, 8], [8, 8], [8, 9]], "lower": 0}]),
]


@pytest.mark.parametrize(("name", "path", "value"), LIES)
def test_keys_that_the_plan_contradicts_are_found(
    name: str, path: Path_, value: Any, tmp_path: Path
) -> None:
    assert found(name, path, value, tmp_path)


@pytest.mark.parametrize("name", [*TEXTS, ROLLED, "swarms/circle_6", "beside_a_show"])
def test_plans_show_what_was_asked_for(name: str, tmp_path: Path) -> None:
    assert found(name, (), None, tmp_path) == []


def test_plans_for_controllers_that_tilt_less_are_as_requested(tmp_path: Path) -> None:
    """PX4 commands at most 45°: plans state that limit; a lower one of the problem counts."""
    drones = "quadrotor: {mass: 0.25, max_thrust: 5.0, controller: px4}"
    text = f"""team: {{robots: 3, cable_length: 2.6, {drones}}}
limits: {{tilt_deg: 60, tracking: 0.01}}
start: {{hitch: {{polygon: [[0, -1], [-0.4, 0.5], [0.4, 0.5]], altitude: 1.0}}}}
mission: [{{hold: {{seconds: 1.0}}}}]
"""
    (tmp_path / "problem.yaml").write_text(text)
    arguments = ["solve", str(tmp_path / "problem.yaml"), "-o", str(tmp_path / "plan")]
    solved = CliRunner().invoke(main, [*arguments, "--no-picture"])
    assert solved.exit_code == 0
    assert "limits.tilt_deg is 60, but the controllers tilt by at most 45" in solved.output
    for command in ("check", "verify"):
        assert CliRunner().invoke(main, [command, str(tmp_path / "plan")]).exit_code == 0
    flown = {"tilt": np.radians(45.0)}
    assert not request.contradicts("tilt_deg", 60.0, flown)
    assert request.contradicts("tilt_deg", 44.0, flown)


@pytest.mark.slow
@pytest.mark.parametrize("name", [BOX, "two_teams", "carry_tray"])
def test_long_plans_show_what_was_asked_for(name: str, tmp_path: Path) -> None:
    assert found(name, (), None, tmp_path) == []


EXCURSION = """
team: {robots: 3, cable_length: [2.4, 2.3, 2.4], tension: 0.5, cable_friction: FRICTION}
start: {hitch: {polygon: [[0, -1], [-0.4, 0.5], [0.4, 0.5]], altitude: 1.0, legs: [0.3, 0.3, 0.3]}}
mission:
  - FIRST
  - transport: {to: [-0.03, 0, 1.0]}
  - transport: {to: [0, 0, 1.0]}
"""
STILL = "adjust: {legs: [0.3, 0.3, 0.3], duration: 1, settle: false}"
SLIDE = "adjust: {legs: [0.35, 0.3, 0.3], settle: false}"


@pytest.mark.parametrize(
    ("first", "friction", "name", "ends", "is_believed"),
    [
        (STILL, 0.1, "adjust", 3, False),
        (STILL, 0.1, "settle", 3, False),
        (SLIDE, 0.1, "settle", 3, True),
        (SLIDE, 0.0, "settle", 3, False),
        (SLIDE, 0.1, "settle", 2, False),
        (SLIDE, 0.1, "Settle", 3, False),
    ],
)
def test_only_returns_after_a_slide_are_over_travels(
    first: str, friction: float, name: str, ends: int, is_believed: bool, tmp_path: Path
) -> None:
    """A step lasts as long as all other motion at its end, whatever its phases are called."""
    text = EXCURSION.replace("FRICTION", str(friction)).replace("FIRST", first)
    data: Any = parse_yaml(text)
    whole = planned_of(data).motion
    motion = cut(whole, 0, int(np.flatnonzero(whole.phase_of_piece == ends - 1)[-1]) + 1)
    adjust = motion.phases[0]
    excursion = replace(adjust, name=name, start=adjust.end, end=motion.duration)
    moved = motion.replaced(phases=(adjust, excursion))
    asked = data["mission"][0]["adjust"] | {"duration": adjust.end, "settle": "auto"}
    data["mission"] = [{"adjust": asked}]
    assert believed(moved, data, tmp_path) is is_believed


def believed(motion: Motion, data: Any, folder: Path) -> bool:
    """Return whether a motion is read by both readers as what a problem asks for."""
    write_plan(folder / "plan.npz", ho.Flight.of(motion), "", json.dumps(data))
    try:
        (plan,), _ = second.read(folder / "plan.npz")
    except second.UnreadableError:
        plan = None
    believes = plan is not None and all(row.verdict == "proven" for row in second.requested(plan))
    try:
        ho.load(folder)
    except FileError:
        assert not believes
        return False
    assert believes
    return True


def test_a_wait_stands_still_and_one_team_waits_for_nobody(tmp_path: Path) -> None:
    data: Any = parse_yaml(MOVED)
    motion = flight_of("moved").teams[0].motion
    morph, *others = motion.phases
    times = motion.drones.breaks
    middle = float(times[np.argmin(np.abs(times - 1.5))])
    data["mission"][0]["morph"]["duration"] = middle
    halves = [morph.retimed(0.0, middle), replace(morph, name="wait", start=middle)]
    assert not believed(motion.replaced(phases=(*halves, *others)), data, tmp_path)
    data = parse_yaml(MOVED)
    end = int(np.argmin(np.abs(times - morph.end)))
    flown, rest = cut(motion, 0, end), cut(motion, end, motion.drones.pieces)
    wait = resting(flown, 1.0, replace(morph, name="wait"))
    assert believed(concatenated([flown, rest]), data, tmp_path)
    assert not believed(concatenated([flown, wait, rest]), data, tmp_path)


def test_legs_of_cables_that_sag_are_those_asked_for(tmp_path: Path) -> None:
    """Lengths of legs exceed their chords, which plans store, by a tenth of a millimetre here."""
    data: Any = parse_yaml(SAGGING)
    plan = planned_of(data)
    check_request(problem_from_dict(data).request, plan.flight)
    write_plan(tmp_path / "plan.npz", plan.flight, "", SAGGING)
    (own,), _ = second.read(tmp_path / "plan.npz")
    assert [row.verdict for row in second.requested(own)] == ["proven"]
    chord = plan.motion.legs.coefficients[0, 0, 0, 0]
    assert 5e-5 < 0.7 - chord < 5e-4
    data["start"]["hitch"]["legs"][0] = 0.701
    with pytest.raises(ho.InputError, match=r"request\.start\.hitch\.legs\[0\]"):
        check_request(problem_from_dict(data).request, plan.flight)


def row_of(step: str, key: str) -> str:
    """Return the row of the table that a key of a step looks up."""
    return f"{step}.{key}" if f"{step}.{key}" in steps.STEP_KEYS else key


def test_every_key_of_the_table_has_a_lie() -> None:
    """A lie counts for the row that its step and key look up, not for rows of other steps."""
    lies = [[word for word in param.values[1] if isinstance(word, str)] for param in LIES]
    told = {row_of(*words) for lie in lies for words in pairwise(lie) if words[0] in STEP_KINDS}
    told |= {
        row_of("fly", lie[0]) for lie in lies
    }  # single drones' keys stand outside of a mission
    assert steps.STEP_KEYS.keys() - {"form.assign"} <= told  # "assign" is below


NOT_COMPARED = {
    "move_vertex.vertex",  # These say what moves, which `to`, `by` and `others_stay` compare
    "move_edge.edge",
    "follow_vertex.vertex",
    "morph.optimize",  # How to plan, which no plan contradicts
}


def test_every_step_shows_what_it_does() -> None:
    """By a key of its own, or without one: a step that is not compared could do anything."""
    of_own_key = {key.partition(".")[0] for key in steps.STEP_KEYS if "." in key}
    kinds: list[type[Step]] = [*STEP_KINDS.values(), ho.Fly]
    assert {kind.name for kind in kinds} <= of_own_key | {*steps.IMPLIED}


def test_every_key_of_a_step_has_a_row() -> None:
    """No key of a step is left out of comparison unless it is named here, with the reason."""
    kinds: tuple[type[Step], ...] = (*STEP_KINDS.values(), ho.Fly)
    keys = [(kind.name, key.name) for kind in kinds for key in keys_of(kind).values()]
    assert {".".join(key) for key in keys if row_of(*key) not in steps.STEP_KEYS} == NOT_COMPARED
    assert steps.STEP_KEYS.keys() <= {row_of(*key) for key in keys}


def test_places_in_order_are_found_only_where_they_are(tmp_path: Path) -> None:
    in_order = np.array_equal(flight_of("tied").teams[0].motion.team.listed, range(6))
    wrong = found("tied", ("mission", 0, "form", "assign"), "fixed", tmp_path)
    assert bool(wrong) is not in_order


def test_plans_are_read_only_with_the_legs_asked_for() -> None:
    data: Any = parse_yaml(MOVED)
    check_request(problem_from_dict(copy.deepcopy(data)).request, flight_of("moved"))
    data["start"]["hitch"]["legs"] = [0.3, 0.3, 0.31]
    with pytest.raises(ho.InputError) as caught:
        check_request(problem_from_dict(data).request, flight_of("moved"))
    assert caught.value.key == "request.start.hitch.legs[2]"


def test_check_names_keys_that_only_the_curves_between_show(tmp_path: Path) -> None:
    text = MOVED.replace("[2, 0, -0.85]", "[2, 0, -0.86]")
    write_plan(tmp_path / "plan.npz", flight_of("moved"), "", text)
    run = CliRunner().invoke(main, ["check", str(tmp_path)])
    assert run.exit_code == 2
    assert "mission[4].follow_vertex.path is not as requested" in run.output


def test_check_refuses_in_one_line_what_the_verifier_does_not_read(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """A plan that our reader takes and the verifier's refuses is refused, without a traceback."""

    def refused(_: Path) -> None:
        raise second.UnreadableError("breaks are not increasing")

    write_plan(tmp_path / "plan.npz", flight_of("moved"), "", MOVED)
    monkeypatch.setattr("hitchopt.verify.request.read", refused)
    run = CliRunner().invoke(main, ["check", str(tmp_path)])
    assert run.exit_code == 2
    (line,) = (each for each in run.output.splitlines() if each.startswith("error: "))
    assert line.endswith("plan.npz: not a plan, or a damaged one: breaks are not increasing")
    assert "Traceback" not in run.output


def test_a_text_and_its_data_are_the_same(tmp_path: Path) -> None:
    """Readers without YAML believe the data, so all others compare them with the text."""
    file = tmp_path / "plan.npz"
    write_plan(file, flight_of("moved"), "", MOVED)
    with np.load(file) as read:
        arrays = dict(read)
    settings = json.loads(str(arrays["settings"]))
    settings["request"]["limits"]["speed"] = 1.0
    np.savez(file, **{**arrays, "settings": np.array(json.dumps(settings))})
    with pytest.raises(FileError, match=r"request\.limits\.speed"):
        ho.load(tmp_path)
