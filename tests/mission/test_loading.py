"""Files and mappings to problems: every value, every problem file, faults, and any change."""

from __future__ import annotations

import contextlib
import copy
import math
import random
import re
import subprocess
import sys
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from ruamel.yaml import YAML

import hitchopt as ho
from hitchopt.cli.planning import problem_text
from hitchopt.errors import (
    MAX_LISTED,
    UNKNOWN_KEY,
    Circumstance,
    FileError,
    HitchoptError,
    InputError,
    JointInputError,
)
from hitchopt.forming.steps import Form
from hitchopt.forming.swap_settings import SwapSettings
from hitchopt.hitch.requirements import Limits, Separation
from hitchopt.mission.loading import (
    load_problem,
    problem_from_dict,
    problem_schema,
)
from hitchopt.mission.objects import ObjectKeys
from hitchopt.mission.starts import HitchStart
from hitchopt.steps import STEP_KINDS
from hitchopt.steps.moving import Adjust, FollowVertex, Hold, Morph, MoveEdge, MoveVertex, Transport
from hitchopt.storage.yaml_file import parse_yaml, read_yaml, split_key, value_at
from hitchopt.values import SYNONYMS
from hitchopt.values.fields import Key, keys_of
from tests.helpers.plans import BAD, GOOD, INFEASIBLE, PROBLEMS, header
from tests.helpers.problem_cases import TEMPLATE, VALIDATOR, hitch_start, triangle
from tests.helpers.refusals import memory_below

MINIMAL: dict[str, Any] = {
    "team": {"robots": 3, "cable_length": 2.4},
    "start": {"hitch": {"polygon": [[0, -1], [-0.4, 0.5], [0.4, 0.5]]}},
    "mission": [{"hold": {"seconds": 2}}],
}


def changed(path: list[str | int], value: object) -> dict[str, Any]:
    data: Any = triangle()
    place = data
    for part in path[:-1]:
        place = place[part]
    place[path[-1]] = value
    return dict(data)


def plain(value: Any) -> Any:
    """All that a problem holds, by the names of fields."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    if is_dataclass(value):
        return {field.name: plain(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, Mapping):
        return {key: plain(part) for key, part in value.items()}
    return [plain(part) for part in value] if isinstance(value, list | tuple) else value


def test_every_value_of_the_file_arrives_where_it_belongs() -> None:
    array: Any = np.array  # outlines, too, are made of points
    kinds = [
        ho.Quadrotor(0.132, 2.6),
        ho.Quadrotor(0.14, stiffness=4.75, integral=True, feed_forward=False),
        ho.Quadrotor(max_thrust=2.8),
    ]
    keys: Any = {"cable_density": 0.003, "cable_friction": 0.05, "tension": [0.4, 0.45, 0.5]}
    tilt, turning = math.radians(40.0), math.radians(150.0)
    expected = ho.Problem(
        ho.Team(3, [2.4, 2.5, 2.6], **keys, quadrotor=kinds),
        ho.HitchStart(array([[2.0, 0.2], [1.6, 1.7], [2.4, 1.7]]), 1.3, array([0.4, 0.7, 0.45])),
        (
            Morph(array([[2, 0.7], [1.6, 1.7], [2.4, 1.7]]), legs="balanced"),
            Hold(1.5),
            Morph(array([[2.1, 0.6], [1.5, 1.8], [2.4, 1.6]]), duration=7.5),
            MoveVertex(2, by=array([0.1, 0.05]), legs="spread", duration=3.5),
            MoveEdge(1, to=array([[1.6, 1.7], [2.4, 1.75]]), blend=True),
            Adjust(array([0.5, 0.6, 0.45])),
            FollowVertex(0, array([[0, 2.1, 0.6], [3.5, 2.0, 0.7]])),
            Transport(array([2.0, 1.2, 1.6]), yaw=math.radians(-30.0), duration=9),
        ),
        ho.Limits(0.9, 1.9, 19.0, tilt, 0.4, 0.16, 60.0, turning),
        ho.Separation(0.11, 0.29, 0.09, 0.0),
        ho.Arena([-1, -2, 0.1], [5, 4, 3.3]),
        "Off the origin",
    )
    assert plain(problem_from_dict(triangle())) == plain(expected)


def test_defaults_are_those_of_the_interface() -> None:
    problem = problem_from_dict(MINIMAL)
    start, team = hitch_start(problem), plain(problem.team)
    assert (problem.title, problem.arena, start.altitude, start.legs) == ("", None, 1.0, "spread")
    assert (team["tension"], team["cable_density"], team["cable_friction"]) == ([0.4] * 3, 0.0, 0.0)
    assert set(problem.team.mass.tolist()) == {0.132}
    assert set(problem.team.max_thrust.tolist()) == {2.6}
    limits = ho.Limits(1.0, 2.0, 20.0, math.radians(45.0), 0.5, 0.15, None, None, 1.0)
    assert problem.limits == limits
    assert problem.separation == ho.Separation(0.12, 0.30, 0.10, 0.05, 0.035)


def test_arrays_tuples_and_whole_numbers_are_as_good_as_lists_and_floats() -> None:
    data: Any = triangle()
    data["team"] |= {"cable_length": np.array([2.4, 2.5, 2.6]), "robots": np.int64(3)}
    data["limits"]["speed"] = np.float64(0.9)
    data["start"]["hitch"]["polygon"] = np.array(data["start"]["hitch"]["polygon"])
    data["mission"] = tuple(data["mission"])
    assert plain(problem_from_dict(data)) == plain(problem_from_dict(triangle()))


FORM = {"form": {"polygon": [[2.0, 0.2], [1.6, 1.7], [2.4, 1.7]], "assign": "fixed"}}
PLACES: dict[str, Any] = {
    "q": [[0.0, 1, 2], [1, 1, 2], [2, 1, 2.5]],
    "r": [[0, 2, 2], [1, 2, 2], [2, 2, 2]],
}

SQUARE = [[-0.5, -0.5], [-0.5, 0.5], [0.5, 0.5], [0.5, -0.5]]
CORNERS = [[0, 0.7], [0.6, -0.35], [-0.6, -0.35]]
STAY = {"hold": {"seconds": 1}}


def drones(**places: Any) -> dict[str, Any]:
    """Changes to a problem that begins with drones on free cables."""
    return {"start": {"drones": PLACES | places}, "mission": [FORM]}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"mission": [STAY, FORM]}, r"mission\[1\]\.form: there is a hitch at that point"),
        (
            {"mission": [{"release": {}}, {"adjust": {"legs": "balanced"}}]},
            r"step 0 \(release\) untied it: form one",
        ),
        (
            {"mission": [FORM], "start": None},
            r"must be given; add start: \{drones: \{q: \[.*\}\}, 3 points each",
        ),
        ({"mission": [{"enclose": {"object": "box"}}]}, "one of objects: there are none; add it"),
        (
            drones(q=PLACES["q"][:2]),
            r"start\.drones\.q: 2 points, not 3, one per robot; add points, or",
        ),
        (
            {"start": {"hitch": {"polygon": SQUARE, "altitude": 1}}},
            r"polygon: 4 points, not 3, one per robot; remove points, or",
        ),
        (
            {"start": {"hitch": {"polygon": [p[::-1] for p in CORNERS], "altitude": 1}}},
            r"in clockwise order .*, or are x and y swapped\?",
        ),
        (drones(r=[[1e9, 0, 1], *PLACES["r"][1:]]), r"start\.drones\.r\[0\] = .* finite and with"),
        (drones(r=[[1, 0], *PLACES["r"][1:]]), r"drones\.r\[0\] = .* must be a point \[x, y, z\]"),
    ],
)
def test_steps_or_starts_that_do_not_fit_are_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        problem_from_dict({**triangle(), **changes})


def test_every_key_of_form_arrives() -> None:
    keys: Any = {**FORM["form"], "altitude": 1.7, "legs": [0.4, 0.7, 0.45], "duration": 30}
    swap = {"radius": 0.2, "tilt_deg": 30, "seconds": 2.5, "sense": "down"}
    steps = [{"form": {**keys, "swap": swap}}, {"release": {}}, STAY, FORM]
    problem = problem_from_dict({**triangle(), **drones(), "mission": steps})
    form = Form(**keys, swap=SwapSettings(0.2, math.radians(30), 2.5, -1))
    assert plain(problem.start) == plain(ho.DronesStart(**PLACES))
    assert plain(problem.mission[0]) == plain(form.resolved_for(problem.team))
    assert [step.name for step in problem.mission] == ["form", "release", "hold", "form"]


FAULTS: list[tuple[str | list[str | int], object, str]] = [
    ("limits.leg", 1e-300, r"1e-300: must be from 1e-09 to 10000 m; "),
    ("limits.jerk", 1e300, r"1e+300: must be from 1e-09 to 1e+09 m/s³; "),
    ("team.robots", 10**5000, r"inf: must be an integer; "),
    ("team.tensio", 1.0, r"1.0: unknown key; did you mean tension?"),
    ("team.quadrotor[1].mas", 1, r"1: unknown key; did "),
    ("team.cable_density", -1e-09, r"-1e-09: must be at least 0; "),
    ("team.tension[2]", math.nan, r"nan: must be finite; "),
    ("mission[2].morph.polygon", None, r"None: must be given; add polygon: [[0, -1]"),
    ("mission[3].move_vertex.blend", 1, r"1: must be true or"),
    ("mission[7].transport.to[0]", 1e6, r"mission[7].transport.to = [1000000.0, 1.2, 1.6]: m"),
    ("mission[7].transport.yaw_deg", 1801, r"[7].transport.yaw_deg = 1801: must be from -1800"),
    ("mission", [], "[]: must be given; add mission: [{hold: {seconds: 1.0}}]"),
    (
        "mission[2]",
        {"wait": 2},
        "[2].wait = 2: unknown step; did you mean hold: {seconds: 1.0}?",
    ),
    ("mission[2]", {"hold": 2}, "[2].hold = 2: must be a mapping; write hold: {seconds: 1.0}"),
    ("mission[7].transport.height", 0.4, "height = 0.4: unknown key; did you mean to?"),
    ("mission[2]", "release", "mission[2] = 'release': must be a mapping; write release: {}"),
    (
        "mission[2]",
        {"morph": {"polgon": []}},
        "polgon = []: unknown key; did you mean poly",
    ),
    ("team.cable_length", "2,4", "; write 2.4: decimals have a point (Lengths of cables, one"),
    ("team.cable_length", "2024-01-01", "a list; use a plain number in SI units (Lengths of"),
    ("title", "x" * 201, r": must be at most 200 characters long; shorten it"),
    ("mission", {"hold": {"seconds": 1}}, "a list of steps; begin each step with a dash: - hold:"),
    (
        "team.mass",
        0.14,
        "write it as team.quadrotor.mass, with a model by name as {model: NAME, mass: …}",
    ),
    ("limits.radius", 0.1, "unknown key; write it as separation.radius"),
    ("limits.tilt", 30, "unknown key; did you mean tilt_deg?"),
    ("mission[2].morph.tilt", 30, "unknown key; write it as limits.tilt_deg"),
    ("team.quadrotor[1]", "cf21B_500", "did you mean crazyflie_2.1_brushless?"),
    ("mission[2].morph.speed", 0.5, "unknown key; write it as limits.speed"),
    ("team.limits", {"speed": 0.5}, "unknown key; write limits at the top level of the file"),
    ("tilt_deg", 50, "unknown key; write it as limits.tilt_deg"),
    ("team.quadrotor[1]", "brushless", "did you mean crazyflie_2.1_brushless?"),
    (["a\x1b[31m b"], 1, r"'a\x1b[31m b' = 1: unknown key; use one of team, start"),
]


QUADROTOR: dict[str, Any] = {"controller": "lee", "gains": {"kp": 1.0}, "tracking": {"level": 0.1}}
BOX: dict[str, Any] = {"circle": 0.1, "at": [3, 0, 0], "rim": {"circle": 0.2, "at": 0.2}}
COMMON: dict[str, Any] = {
    "limits": {"speed": 0.8, "tracking": {"level": 0.1}},
    "separation": {"radius": 0.13},
    "arena": {"lower": [-4, -4, 0], "upper": [4, 4, 3]},
    "keep_out": [{"polygon": [[2, 2], [3, 2], [3, 3]], "lower": 0, "upper": 2}],
    "objects": {"box": BOX},
}
HITCH_TEAM: dict[str, Any] = {
    "robots": 3,
    "cable_length": 2.4,
    "quadrotor": QUADROTOR,
    "errors": {"cable_length": 0.01},
}
STEPS: list[dict[str, Any]] = [
    *({name: {}} for name in STEP_KINDS),
    {"form": {"polygon": CORNERS, "swap": {"radius": 0.2}}},
]
FORMS: dict[str, Any] = {
    "hitch": COMMON
    | {
        "team": HITCH_TEAM,
        "start": {"hitch": {"polygon": CORNERS, "altitude": 1.1}},
        "mission": STEPS,
    },
    "drones": COMMON
    | {"team": HITCH_TEAM, "start": {"drones": PLACES}, "mission": [FORM, {"hold": {}}]},
    "swarm": COMMON
    | {
        "team": {"drones": 2, "quadrotor": QUADROTOR},
        "start": [[-1, 0, 1], [1, 0, 1]],
        "goal": [[1, 0, 1], [-1, 0, 1]],
    },
    "teams": COMMON
    | {
        "teams": {"a": HITCH_TEAM, "b": {"drones": 2, "quadrotor": QUADROTOR}},
        "start": {"a": {"hitch": {"polygon": CORNERS}}, "b": [[-1, 3, 1], [1, 3, 1]]},
        "mission": [{"a": {"hold": {}}, "b": {"fly": {"goal": [[1, 3, 1], [-1, 3, 1]]}}}],
    },
}
"""Problems of every form, with every section and step; steps lack what they need."""


def key_words() -> list[str]:
    """The keys of all records, their fields, synonyms and misspellings, in a mixed order."""
    keys = {
        name
        for definition in problem_schema()["$defs"].values()
        for name in definition.get("properties", {})
    }
    fields_of_keys = {key.removesuffix("_deg") for key in keys}
    synonyms = {word for key in keys for word in SYNONYMS.get(key, "").split()}
    misspelt = {f"{key[:-2]}{key[-1]}" for key in keys if len(key) > 3}
    with_unit = {f"{key.removesuffix('_deg')}_deg" for key in keys}
    words = sorted(keys | fields_of_keys | synonyms | misspelt | with_unit)
    random.Random(5).shuffle(words)
    return words


def unknown_keys(data: Any) -> list[InputError]:
    """The errors of unknown keys of a problem's data."""
    try:
        problem_from_dict(data)
    except InputError as error:
        errors = getattr(error, "errors", (error,))
        return [each for each in errors if each.bound == UNKNOWN_KEY]
    return []


def hinted_key(error: InputError) -> str:
    """The key that the remedy of an unknown key names; empty where it lists all keys."""
    for pattern, place in (
        (r"did you mean (\w+)\?", error.key.rpartition(".")[0]),
        (r"write (\w+) at the top level of the file", ""),
        (r"write it as ([\w.\[\]]+)(?:,.*)?", ""),
    ):
        if match := re.fullmatch(pattern, error.remedy):
            return f"{place}.{match[1]}".lstrip(".")
    assert re.match("use one of |single drones have |a hitch has ", error.remedy), error
    return ""


@pytest.mark.filterwarnings("ignore::hitchopt.UnitWarning")
@pytest.mark.parametrize("form", FORMS)
def test_a_hint_names_a_key_that_the_reader_accepts(form: str) -> None:
    """A key of any record, misspelt or where it does not belong, in every section and step."""
    words, size = key_words(), 12  # fewer than the reader lists
    places = [(), *(path for path in paths_of(FORMS[form]) if path[0] != "title")]
    mappings = [path for path in places if isinstance(value_at(FORMS[form], path), dict)]
    hints = 0
    for number, place in enumerate(mappings):
        mixed = words[number % 6 :: 6]
        for first in range(0, len(mixed), size):
            data = copy.deepcopy(FORMS[form])
            section = value_at(data, place)
            # With robots, single drones would be a team with cables, which has other keys
            own = {*section, "robots"}
            stated = [word for word in mixed[first : first + size] if word not in own]
            section |= dict.fromkeys(stated, 0.5)
            for error in unknown_keys(data):
                if not (hinted := hinted_key(error)):
                    continue
                follow = copy.deepcopy(FORMS[form])
                *parents, last = split_key(hinted)
                target = follow
                for part in parents:
                    target = target[part]
                target[last] = 0.5
                assert hinted not in {each.key for each in unknown_keys(follow)}, str(error)
                hints += 1
    assert hints > 50


UNITS: list[tuple[str, object, str]] = [
    ("start.hitch.altitude", 180.0, "centimetres were meant, 1.8"),
    ("start.hitch.altitude", 900.0, "millimetres were meant, 0.9"),
    ("start.hitch.polygon", [[0, -900], [-300, 450], [300, 450]], "millimetres were meant, 0.9"),
    ("limits.tracking", 6, "centimetres were meant, 0.06"),
    ("objects.box.mass", 120, "grams were meant, 0.12"),
    ("objects.box.circle", 150, "millimetres were meant, 0.15"),
    ("objects.box.to", 250, "millimetres were meant, 0.25"),
    ("objects.box.from", -30, "centimetres were meant, -0.3"),
    ("objects.box.friction", 50, "per cent were meant, 0.5"),
    ("objects.box.rim", {"circle": 0.3, "at": 40}, "centimetres were meant, 0.4"),
    ("objects.box.outline", [[0, 0], [0, 300], [200, 0]], "millimetres were meant, 0.3"),
]


@pytest.mark.parametrize(("key", "value", "likely"), UNITS)
def test_the_likely_unit_is_named_once(key: str, value: object, likely: str) -> None:
    body = {} if "outline" in key else {"circle": 0.1}
    data: Any = {
        "team": {"robots": 3, "cable_length": 2.4},
        "start": {"hitch": {"polygon": [[0, -0.9], [-0.3, 0.45], [0.3, 0.45]], "altitude": 1.0}},
        "limits": {},
        "objects": {"box": {**body, "at": [3, 0, 0]}},
        "mission": [{"hold": {"seconds": 1}}],
    }
    *path, name = key.split(".")
    section = data
    for each in path:
        section = section[each]
    section[name] = value
    with pytest.warns(ho.UnitWarning) as caught, contextlib.suppress(InputError):
        problem_from_dict(data)
    messages = [str(each.message) for each in caught]
    assert likely in messages[0]
    assert messages[0].startswith(key)
    assert len({message.split(": ", 1)[1] for message in messages}) == 1


LENGTH_RECORDS = (Limits, Separation, HitchStart, ObjectKeys, SwapSettings, *STEP_KINDS.values())
LENGTH_KEYS = [
    pytest.param(key, f"{record.__name__}.{field}", id=f"{record.__name__}.{field}")
    for record in LENGTH_RECORDS
    for field, key in keys_of(record).items()
    if key.kind.unit == "m" and isinstance(key.default, float) and key.default > 0.0
]


@pytest.mark.parametrize(("key", "name"), LENGTH_KEYS)
def test_a_default_length_in_another_unit_is_noticed(key: Key, name: str) -> None:
    assert key.kind.check(name, key.default) == key.default  # warnings are errors
    for unit, size in (("centimetres", 1e-2), ("millimetres", 1e-3)):
        with pytest.warns(ho.UnitWarning, match=f"if {unit} were meant, {key.default:g}") as caught:
            key.kind.check(name, key.default / size)
        (warning,) = caught
        assert isinstance(warning.message, ho.UnitWarning)
        assert warning.message.factor == size


@pytest.mark.parametrize(("key", "value", "message"), FAULTS, ids=[f[2][:40] for f in FAULTS])
def test_faults_are_told_with_place(
    key: str | list[str | int], value: object, message: str
) -> None:
    with pytest.raises(InputError) as caught:
        problem_from_dict(changed(list(split_key(key)) if isinstance(key, str) else key, value))
    assert message in str(caught.value)
    assert caught.value.key == key or " = " in message
    assert not isinstance(caught.value, JointInputError)


@pytest.mark.parametrize(
    ("times", "remedy"),
    [
        ([0.0], "add a point with a later time"),
        ([0.0, 0.0], "add a point with a later time"),
        ([1e-4], "leave 0.001 s or more before each of its points"),
        ([1.0, 1.0001, 3.0], "leave 0.001 s or more before each of its points"),
        ([-1.0, 2.0], "count times from the start of the step"),
        ([-1.0], "count times from the start of the step"),
        ([3.0, 1.0], "sort its points by time"),
        ([2.0, 1.0, 0.0], "sort its points by time"),
    ],
)
def test_the_remedy_for_times_of_a_path_is_what_helps(times: list[float], remedy: str) -> None:
    path = [[t, 2.0 + 0.1 * k, 0.5] for k, t in enumerate(times)]
    with pytest.raises(InputError, match=f"; {remedy}") as caught:
        FollowVertex(0, path)
    assert caught.value.key == "path"


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        (["objects"], {"box": {"at": [0, 0, 0]}}, "box: has none of outline, circle, file; write"),
        (
            ["objects"],
            {"box": {"circle": 1, "outline": [[0, 0], [0, 1], [1, 1]], "at": [0, 0, 0]}},
            "objects.box: has outline and circle; keep one of them",
        ),
        (["team", "cable_length:2"], None, "write a blank after the colon: cable_length: 2"),
        (["mission", 2], {"carry": {"object": "box", "to": [0, 0, 0]}}, "add it to objects"),
        (
            ["mission", 2],
            {"lift": {"by": 0.3}},
            "mission[2].lift: lift needs a grasped object, and there is no object; enclose, grasp",
        ),
        (["mission", 0], {"form": {"polygon": SQUARE[:3], "altitude": 1}}, "there is a hitch at"),
    ],
)
def test_what_is_missing_or_in_the_way_is_named(
    path: list[str | int], value: object, message: str
) -> None:
    with pytest.raises(InputError) as caught:
        problem_from_dict(changed(path, value))
    assert message in str(caught.value)


def test_all_faults_are_told_in_one_go_and_a_flood_is_cut() -> None:
    data: Any = triangle()
    data["limits"]["speed"] = "fast"
    data["team"]["robot"] = 3
    del data["mission"][1]["hold"]["seconds"]
    with pytest.raises(JointInputError) as caught:
        problem_from_dict(data)
    keys = ["team.robot", "limits.speed", "mission[1].hold.seconds"]
    assert [error.key for error in caught.value.errors] == keys
    assert str(caught.value).splitlines() == [str(error) for error in caught.value.errors]
    data = changed(["mission"], [{"hold": {"seconds": -k}} for k in range(1, 501)])
    with pytest.raises(JointInputError) as caught:
        problem_from_dict(data)
    lines = str(caught.value).splitlines()
    assert (len(lines), lines[-1]) == (MAX_LISTED + 1, f"and {500 - MAX_LISTED} more")
    assert caught.value.within("file").key == "file.mission[0].hold.seconds"


def test_sizes_are_refused_before_memory_is_spent() -> None:
    with memory_below(20e6):
        with pytest.raises(InputError, match=r"team\.robots = 1\d+: must be at most 10000"):
            problem_from_dict(changed(["team", "robots"], 10**18))
        with pytest.raises(InputError, match="values in all"):
            problem_from_dict(changed(["team", "tension"], np.broadcast_to(0.4, (10**9,))))


@pytest.mark.parametrize("data", [None, 3, [], "text", {1: 2}, {"team": object()}, {"title": b"x"}])
def test_what_is_no_mapping_of_plain_data_is_an_input_error(data: Any) -> None:
    with pytest.raises(InputError):
        problem_from_dict(data)


def paths_of(data: Any, path: tuple[str | int, ...] = ()) -> Iterator[tuple[str | int, ...]]:
    for key, value in data.items() if isinstance(data, dict) else enumerate(data):
        yield (*path, key)
        if isinstance(value, dict | list):
            yield from paths_of(value, (*path, key))


ODD = [0, -0.0, 1e308, 5e-324, math.pi, 10**5000, "", "spread", "open", "1", b"x", object()]


inner: st.SearchStrategy[Any] = st.none() | st.floats() | st.just({}) | st.just({"seconds": 1})
values = st.one_of(
    *(st.none(), st.booleans(), st.integers(-3, 12), st.floats(), st.floats(-3, 3)),
    *(st.integers(10**300, 10**310), st.sampled_from(ODD), st.text(max_size=8)),
    st.lists(st.floats() | st.integers(-3, 3), max_size=4),
    st.lists(st.lists(st.floats(-3, 3), min_size=2, max_size=2), min_size=3, max_size=5),
    st.dictionaries(st.sampled_from(["morph", "mass", "q", "hitch", "é\n"]), inner, max_size=2),
)
mutation = st.tuples(
    st.sampled_from(list(paths_of(triangle()))), st.sampled_from(["set", "drop", "add"]), values
)


def mutated(changes: list[tuple[tuple[str | int, ...], str, Any]]) -> dict[str, Any]:
    data: Any = triangle()
    for (*parents, last), action, value in changes:
        place = data
        with contextlib.suppress(LookupError, TypeError, ValueError):  # removed by now
            for part in parents:
                place = place[part]
            if action == "drop":
                del place[last]
            else:
                place[last if action == "set" else f"{last}s"] = value
    return dict(data)


@pytest.mark.filterwarnings("ignore::hitchopt.UnitWarning")
@given(st.lists(mutation, min_size=1, max_size=3))
@settings(max_examples=100, suppress_health_check=[HealthCheck.too_slow])
def test_a_changed_problem_is_valid_by_the_schema_or_a_told_error(changes: Any) -> None:
    data = mutated(changes)
    try:
        answer: ho.Problem | HitchoptError = problem_from_dict(data)
    except HitchoptError as error:
        answer = error
    if isinstance(answer, ho.Problem):
        assert len(hitch_start(answer).outline) == answer.team.robots
        assert np.all(np.isfinite(hitch_start(answer).outline.vertices))
        VALIDATOR.validate(data)
        return
    assert not isinstance(answer, InputError) or (answer.key and answer.remedy)
    assert len(str(answer)) < 20_000
    str(answer).encode("utf-8")  # a terminal can show it


SWARMS = PROBLEMS / "swarms"
READ = [*GOOD, *INFEASIBLE, TEMPLATE, *sorted(SWARMS.glob("*.yaml"))]
REFUSED = [*BAD, *sorted((SWARMS / "bad").glob("*.yaml"))]


@pytest.mark.parametrize("path", READ, ids=lambda path: path.stem)
def test_what_can_be_planned_is_read_and_valid(path: Path) -> None:
    data: Any = read_yaml(path)
    assert data == YAML(typ="safe", pure=True).load(path)
    VALIDATOR.validate(data)
    problem = load_problem(path)
    assert problem.title
    for name, team in data.get("teams", {"": data.get("team")}).items():
        read = problem.teams[name].team
        assert team.get("robots", 0) == read.robots
        assert team.get("drones", 2 * read.robots) == read.drones


@pytest.mark.parametrize("path", REFUSED, ids=lambda path: path.stem)
def test_what_is_wrong_in_itself_is_told_with_its_place(path: Path) -> None:
    with pytest.raises((InputError, FileError)) as caught:
        load_problem(path)
    assert path not in BAD or header(path, "Names") in str(caught.value)
    if isinstance(caught.value, InputError):
        for error in getattr(caught.value, "errors", (caught.value,)):
            if not isinstance(error.value, Circumstance):
                assert re.search("must be|unknown (key|step)|missing", str(error))
            assert "; " in str(error)
    expected = header(path, "Schema") if path in BAD else "unjudged"
    try:
        data = read_yaml(path)
    except HitchoptError:
        assert expected == "unreadable"
        return
    if expected != "unjudged":  # JSON has no nan
        assert VALIDATOR.is_valid(data) is (expected == "accepts")


def test_the_schema_describes_every_key() -> None:
    """Each kind of fault also has its own file."""
    assert len({header(path, "Fault") for path in BAD}) == len(BAD) >= 25
    VALIDATOR.validate(triangle())
    defaults: dict[str, Any] = {}
    for model in problem_schema()["$defs"].values():
        assert model["additionalProperties"] is False
        assert model["description"]
        for name, entry in model["properties"].items():
            assert "description" in entry or "$ref" in entry, name
            defaults |= {name: entry["default"]} if "default" in entry else {}
    for name, value in {"speed": 1.0, "assign": "auto", "height": 0.3, "jerk": 20.0}.items():
        assert defaults[name] == value


def test_models_of_drones_are_named_in_files() -> None:
    other = {"model": "crazyflie_2.1", "mass": 0.031}
    kinds = ["crazyflie_2.1_brushless", other, {"mass": 0.04, "max_thrust": 0.8}]
    team = {"robots": 3, "cable_length": 2.4}
    read: Any = problem_from_dict({**MINIMAL, "team": {**team, "quadrotor": kinds}}).team
    others = ho.Quadrotor(model="crazyflie_2.1", mass=0.031), ho.Quadrotor(0.04, 0.8)
    assert read.quadrotor == (ho.Quadrotor(model="crazyflie_2.1_brushless"), *others)
    assert read.tension.tolist() == [0.12, others[0].tension, 0.4]
    drawn = ho.load_problem(PROBLEMS / "crazyflie_triangle.yaml").team
    named = problem_from_dict({**MINIMAL, "team": {**team, "quadrotor": kinds[0]}}).team
    assert named.tension.tolist() == drawn.tension.tolist()
    for name in ("mass", "max_thrust", "stiffness", "damping", "integral_gain", "max_tilt"):
        np.testing.assert_allclose(getattr(named, name), getattr(drawn, name), rtol=0.01)


@pytest.mark.parametrize(
    ("kind", "team"), [("", "Team"), ("_carry", "Team"), ("_swarm", "SwarmTeam")]
)
def test_templates_show_every_key_with_its_default(kind: str, team: str) -> None:
    """Uncommented, their sections are read, and change nothing but that semi-axes are stated."""
    text = problem_text(TEMPLATE.with_stem(f"template{kind}"))
    text = re.sub(r"\n  quadrotor: \S+ .*", "", text)  # the model, instead of its numbers
    uncommented = re.sub(
        r"^( *)# ?(?=( *)\w+:(  |$))|^( *)# ?(?=( *)\w+: \S+ +# )", r"\1\4", text, flags=re.M
    )
    data: Any = parse_yaml(uncommented)
    plain_data: Any = parse_yaml(text)
    schema, swarm = problem_schema()["$defs"], "Swarm" if kind == "_swarm" else ""
    for key, name in (("limits", "Limits"), ("separation", "Separation")):
        assert sorted(data[key]) == sorted(schema[f"{swarm}{name}"]["properties"])
    assert set(data["team"]) == set(schema[team]["properties"])
    assert list(data["team"]["quadrotor"]) == [x.name for x in keys_of(ho.Quadrotor).values()]
    if kind == "_carry":
        alternatives = {"circle", "file"}  # to an outline
        assert set(data["objects"]["box"]) | alternatives == set(schema["ObjectKeys"]["properties"])
    axes = {"radius": ho.Separation.radius, "height": ho.Separation.height}
    stated = {**plain_data, "separation": axes}  # over those of the drones' models
    read, unchanged = (problem_from_dict(each) for each in (data, stated))
    assert plain(read) == plain(unchanged)


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"path": [[2.0, 0.3], [2.05, 0.35]], "speed": 0.05}, ""),
        ({"path": [[3.0, 2.0, 0.3]], "speed": 0.2}, ""),
        ({"path": [[3.0, 2.0, 0.3]], "speed": None}, ""),
        ({"path": [[2.0, 0.3]]}, "mission[0].follow_vertex.path = [[2.0, 0.3]]: must be points"),
        ({"path": [[2.0, 0.3], [1.0, 2.0, 0.4]], "speed": 0.1}, "follow_vertex.path[1] = "),
        ({"path": [[[], 0.3, 0.4], [1.0, 2.0, 0.4]]}, "follow_vertex.path[0][0] = []"),
        ({"path": [[2.0, 0.3]], "speed": 0.0}, "follow_vertex.speed = 0"),
    ],
)
def test_a_vertex_follows_points_with_times_or_at_a_speed(
    keys: dict[str, Any], message: str
) -> None:
    data = {**triangle(), "mission": [{"follow_vertex": {"vertex": 0, **keys}}]}
    if message:
        with pytest.raises(InputError) as caught:
            problem_from_dict(data)
        assert message in str(caught.value)
        return
    (step,) = problem_from_dict(data).mission
    assert step.speed == keys["speed"]
    np.testing.assert_array_equal(step.path, keys["path"])
    VALIDATOR.validate(data)


def test_files_are_read_without_solvers() -> None:
    """Errors of a file are reported before any planner is imported."""
    script = (
        "import sys, hitchopt as ho\n"
        f"ho.load_problem({str(PROBLEMS / 'grip_drum.yaml')!r})\n"
        "print(*{name.partition('.')[0] for name in sys.modules})"
    )
    process = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    assert not {"scipy", "casadi", "toppra", "ruckig", "mujoco", "numba"} & set(
        process.stdout.split()
    )
