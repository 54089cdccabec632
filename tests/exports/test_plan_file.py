"""Plan files are restored bit by bit; false claims and damage are refused."""

from __future__ import annotations

import copy
import dataclasses
import io
import json
import random
import re
import zipfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import GenericAlias
from typing import Any, cast

import numpy as np
import pytest
from click.testing import CliRunner

import hitchopt as ho
from hitchopt import verify as second
from hitchopt.checks import certify
from hitchopt.cli import main
from hitchopt.errors import FileError
from hitchopt.hitch.team import Assignment, Errors
from hitchopt.mission.loading import request_in
from hitchopt.motion.motion import CURVES, Motion
from hitchopt.motion.plan_file import read_plan, read_saved_plan, write_plan
from hitchopt.motion.request import check_request, decoded, encoded, request_of
from hitchopt.plan import read_requested_plan
from hitchopt.storage.yaml_file import parse_yaml
from hitchopt.verify import UnreadableError, read
from hitchopt.verify.consistency import consistency
from tests.helpers.exported_plans import hitch_plan, swarm_plan
from tests.helpers.groups import with_swarm
from tests.helpers.plans import PROBLEMS, planned
from tests.helpers.refusals import memory_below

TITLE = 'Ein "Dreieck", 三角 \\ – with everything'

FORM = """
title: tied
team:
  robots: 3
  cable_length: [2.4, 2.4, 2.6]
  cable_density: 0.003
  cable_friction: 0.05
  tension: 0.5
  quadrotor: [{mass: 0.132}, {mass: 0.14}, {mass: 0.15, max_thrust: 2.8}]
limits: {speed: 0.9}
arena: {lower: [-4, -4, 0], upper: [4, 4, 4]}
objects: {table: {circle: 0.2, to: 0.4, at: [3, 3, 0], fixed: true}}
start:
  drones:
    q: [[0.9, 0.2, 1.5], [-1.2, -0.6, 1.5], [-0.4, 1.2, 1.5]]
    r: [[0.2, -1.2, 1.5], [-1.0, 0.6, 1.5], [0.8, 0.9, 1.5]]
mission:
- form: {polygon: [[0, -0.6], [-0.52, 0.3], [0.52, 0.3]], altitude: 1.6}
"""


GROUP = "groups/0/"
"""Folder of a single team."""


def changed(path: Path, statement: str) -> None:
    """Save a plan again after a change of its settings s, records r, first phase p or arrays a."""
    with np.load(path) as file:
        arrays = {name.removeprefix(GROUP): file[name] for name in file}
    settings, written = json.loads(str(arrays["settings"])), arrays["settings"]
    records = settings["groups"][0]["records"]
    names = {"s": settings, "r": records, "q": records["requirements"], "t": records["team"]}
    exec(statement, {**names, "a": arrays, "np": np, "p": records["phases"][0]})
    if arrays.get("settings") is written:
        arrays["settings"] = np.array(json.dumps(settings))
    heads = {name: arrays.pop(name) for name in ("format", "settings") if name in arrays}
    np.savez(path, **heads, **{GROUP + name: array for name, array in arrays.items()})


@pytest.fixture(scope="module")
def formed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A formed hitch of unlike robots, saved by the command line with its problem's text."""
    folder = tmp_path_factory.mktemp("formed")
    (folder / "tied.yaml").write_text(FORM)
    done = CliRunner().invoke(
        main, ["solve", str(folder / "tied.yaml"), "-o", str(folder / "out"), "-q"]
    )
    assert done.exit_code == 0, done.output
    return folder / "out" / "plan.npz"


@pytest.fixture
def path(tmp_path: Path) -> Path:
    write_plan(tmp_path / "plan.npz", ho.Flight.of(hitch_plan()), TITLE)
    return tmp_path / "plan.npz"


def bits(value: Any) -> Any:
    """All that a plan holds, arrays as bytes."""
    if isinstance(value, np.ndarray):
        return value.shape, np.asarray(value, dtype=np.float64).tobytes()
    if dataclasses.is_dataclass(value):
        return type(value), [
            bits(getattr(value, f.name)) for f in dataclasses.fields(value) if f.init
        ]
    if isinstance(value, dict):
        return [(key, bits(part)) for key, part in value.items()]
    return [bits(part) for part in value] if isinstance(value, tuple) else repr(value)


def controlled() -> Motion:
    """A motion none of whose team's fields is its default; a new field has to be given here."""
    motion, plain = hitch_plan(), ho.Team(3, 2.0)
    kinds = tuple(
        dataclasses.replace(
            kind,
            stiffness=4.75 + k if k else None,
            integral=k == 1 or None,
            feed_forward=None if k != 2 else False,
        )
        for k, kind in enumerate(motion.team.quadrotor)
    )
    load = np.array([0.001, 0.002, 0.003])
    errors = Errors(cable_length=0.004, drone=ho.Tube(0.01, 0.02), friction=0.1)
    team = dataclasses.replace(
        motion.team, cable_friction=0.2, load=load, quadrotor=kinds, errors=errors, release=True
    )
    team = Assignment((1, 2, 0), (False, True, True)).team(team)
    for field in dataclasses.fields(ho.Team):
        value, default = getattr(team, field.name), getattr(plain, field.name)
        assert field.name in {"robots", "topology"} or not np.array_equal(value, default)
    return dataclasses.replace(motion, team=team)


def calibrated() -> Motion:
    """A motion of drones that were calibrated, and that are flown by named controllers."""
    motion, tube = hitch_plan(), ho.Tube(0.08, 0.2)
    own: dict[str, Any] = {"trim": (0.1, -0.02), "thrust_factor": 1.1, "tracking": tube}
    named = ho.Quadrotor(controller="mellinger", gains={"kp": [4.7, 3], "ki": 0}, **own)
    team = dataclasses.replace(
        motion.team, quadrotor=(named, ho.Quadrotor(controller="px4"), motion.team.quadrotor[2])
    )
    limits = dataclasses.replace(motion.requirements.limits, tracking=tube)
    needs = dataclasses.replace(motion.requirements, limits=limits)
    return dataclasses.replace(motion, team=team, requirements=needs)


def walled() -> Motion:
    """Drones beside a prism and a pole."""
    swarm, outline = swarm_plan(), [[-9.0, 0.0], [-9.0, 1.0], [-8.0, 1.0]]
    pole = ho.SolidObject(ho.Section(radius=0.1), 0.0, 1.5, at=[-6.0, 0.0, 0.0], fixed=True)
    requirements = dataclasses.replace(
        swarm.requirements, keep_out=(ho.Prism(outline, 0.1, 2.0),), objects={"pole": pole}
    )
    return swarm.replaced(requirements=requirements)


@pytest.mark.parametrize(
    "kind",
    [
        *(hitch_plan, swarm_plan, controlled, calibrated, walled, with_swarm),
        *("open_arc", "form_triangle", "triangle", "two_teams", "beside_a_show"),
        "friction",
        *(
            pytest.param(name, marks=pytest.mark.slow)
            for name in ("carry_tray", "grip_drum", "swarms/head_on")
        ),
    ],
)
def test_a_plan_is_restored_bit_by_bit_with_its_request(
    kind: str | Callable[[], Motion | ho.Flight], tmp_path: Path
) -> None:
    if isinstance(kind, str):
        file = PROBLEMS / f"{kind}.yaml"
        text = file.read_text()
        flight = planned(kind).flight
        check_request(request_in(text, flight.requirements.objects), flight)
    else:
        flight = ho.Flight.of(kind())
    write_plan(tmp_path / "plan.npz", flight, TITLE)
    restored, title, *_ = read_saved_plan(tmp_path / "plan.npz")
    assert (bits(restored), title) == (bits(flight), TITLE)
    assert {next(consistency(own)).verdict for own in read(tmp_path / "plan.npz")[0]} == {"proven"}
    write_plan(tmp_path / "again.npz", restored, TITLE)
    assert (tmp_path / "again.npz").read_bytes() == (tmp_path / "plan.npz").read_bytes()
    with np.load(tmp_path / "plan.npz") as arrays:
        np.savez_compressed(tmp_path / "packed.npz", **arrays)
    assert bits(read_plan(tmp_path / "packed.npz")) == bits(flight)


def test_plans_made_in_python_and_their_aborts_are_read_again(tmp_path: Path) -> None:
    start = ho.Hitch.spread(ho.Team(3, 2.4), [[0.0, -1.0], [-0.4, 0.5], [0.4, 0.5]], altitude=1.0)
    plan = ho.morph(start, [[0, -0.5], [-0.4, 0.5], [0.4, 0.5]])
    for i, each in enumerate((plan, plan.abort(1.0))):
        each.save(tmp_path / str(i))
        assert ho.load(tmp_path / str(i)).certificate.certified
    hitch = request_of(plan.motion)["start"]["hitch"]
    assert [*hitch["polygon"][0], hitch["altitude"]] == pytest.approx([0.0, -1.0, 1.0])


def test_requests_are_in_the_order_of_the_problem(formed: Path) -> None:
    motion = read_plan(formed).teams[0].motion
    assert motion.assignment is not None
    request, robots = request_of(motion), motion.assignment.robots
    masses = [kind.mass for kind in request["team"].quadrotor]
    assert masses == [0.132, 0.14, 0.15]
    assert [kind.mass for kind in motion.team.quadrotor] == [masses[i] for i in robots]
    assert request["start"]["drones"]["q"][1] == pytest.approx([-1.2, -0.6, 1.5])
    assert request["limits"].tilt == pytest.approx(np.radians(45.0))


ARRAYS = ("format", "settings", *(GROUP + name for name in ("breaks", *CURVES)))

SPANS = "e = a['breaks'][-1]; r['phases'] = [p | {'start': e * x, 'end': e * y} for x, y in %s]"

LIES = [
    ("a['drones'][1, 2, 0, 3] = np.nan", ""),
    ("a['breaks'][-1] = np.inf", ""),
    ("a['breaks'] = a['breaks'][::-1]", ""),
    ("a['breaks'] += 0.5", r"phases = \["),
    ("a['legs'] = a['legs'].astype(np.float32)", ""),
    ("a['legs'] = np.array([{}, [], 1], dtype=object)", "objects"),
    ("a['drones'] = a['drones'][:, :-1]", ""),
    ("a['tensions'] = np.array(0.4)", ""),
    ("t['quadrotor'][1]['mass'] = 0.0", ""),
    *(
        (f"t['quadrotor'][0]{change}", words)
        for change, words in (
            ("['stiffness'] = -1.0", "stiffness = -1.0: must be greater than 0"),
            ("['integral'] = 0.5", "integral = 0.5: must be of the type bool"),
            ("['feed_forward'] = 'x'", "feed_forward = 'x': must be of the type bool"),
            (" |= {'controller': 'mellinger', 'gains': {'kp': [4.7, 0.0]}}", "gains.kp"),
            ("['tracking'] = {'level': -0.1, 'height': 0.1}", "tracking.level"),
        )
    ),
    ("t['quadrotor'] = t['quadrotor'][:2]", ""),
    ("t['tension'][0] = -0.4", ""),
    ("a['settings'] = np.array('[' * 100_000)", ""),
    ("a['settings'] = np.array('[]')", ""),
    ("del r['team']", ""),
    ("q['limits']['colour'] = 1.0", "colour = 1.0: unknown key"),
    ("q['limits']['speed'] = 0.0", "speed"),
    ("q['arena']['lower'] = [9.0, 9.0, 9.0]", ""),
    ("t['robots'] = 5", ""),
    ("t['robots'] = 10**9", ""),
    ("del p['name']", "name"),
    ("p['step'] = 1.5", "of the type int"),
    ("p['state'] = 'standing'", "CableState"),
    ("p['state'] = 3", "CableState"),
    ("p['tension'] = [0.8, 0.3]", "tension"),
    ("p['tension'] = [0.0, 0.8]", "tension"),
    ("p['tension'] = [0.3, 1e999]", ""),
    (SPANS % "((0, 1), (1, 0), (0, 1))", r"phases = \["),
    (SPANS % "((0, 0.5), (0.6, 1))", r"phases = \["),
    (SPANS % "((0.5, 1),)", r"phases = \["),
    (SPANS % "()", r"phases = \["),
    *(
        (f"del a[{name.removeprefix(GROUP)!r}]", f"contains the array '{name}' 0 times")
        for name in ARRAYS
    ),
]
"""Changes after which a file is no plan, and what is said of it."""

MISSION = """- morph: {polygon: [[0, -0.5], [-0.4, 0.5], [0.4, 0.5]], tension: {min: 0.3, max: 0.5}}
- transport: {to: [0.2, 0.1, 1.2], yaw_deg: 30, duration: 4}
"""
START = """team: {robots: 3, cable_length: 2.4}
start: {hitch: {polygon: [[0, -1], [-0.4, 0.5], [0.4, 0.5]], altitude: 1.0}}
mission:
"""
OTHER_MISSIONS = (
    ("[0, -0.5]", "[0, -0.51]", "mission[0].morph.polygon"),
    ("min: 0.3", "min: 0.4", "mission[0].morph.tension"),
    (", tension: {min: 0.3, max: 0.5}", "", "mission[0].morph.tension"),
    ("[0.2, 0.1, 1.2]", "[0.2, 0.1, 1.3]", "mission[1].transport.to"),
    ("yaw_deg: 30", "yaw_deg: 31", "mission[1].transport.yaw_deg"),
    ("duration: 4", "duration: 5", "mission[1].transport.duration"),
    ("- transport: {to: [0.2, 0.1, 1.2], yaw_deg: 30, duration: 4}\n", "", "2"),
)
"""Changes of a mission, and the key by which a plan of the first one is refused."""


def reason_of_refusal(folder: Path, text: str, motion: Motion) -> str:
    """Return why a plan file of a motion with the text of a problem is not read, or nothing."""
    write_plan(folder / "plan.npz", ho.Flight.of(motion), "", text)
    try:
        ho.load(folder)
    except FileError as error:
        return str(error)
    return ""


def test_a_plan_is_of_its_own_mission_alone(tmp_path: Path) -> None:
    problem: Any = parse_yaml(START + MISSION, "problem")
    motion = ho.solve(ho.problem_from_dict(problem)).motion
    pulled = [dataclasses.replace(motion.phases[0], tension=(0.35, 0.45)), *motion.phases[1:]]
    assert not reason_of_refusal(tmp_path, START + MISSION, motion)
    wild = dataclasses.replace(motion.phases[0], tension=(0.2, 0.5))
    wilder = dataclasses.replace(motion, phases=(wild, *motion.phases[1:]))
    assert "mission[0].morph.tension" in reason_of_refusal(tmp_path, START + MISSION, wilder)
    for old, new, key in OTHER_MISSIONS:
        assert old in MISSION
        used = pulled if old == "min: 0.3" else motion.phases
        least = [dataclasses.replace(used[0], tension=(0.3, 0.5)), *used[1:]]
        flown = dataclasses.replace(motion, phases=tuple(least))
        assert key in reason_of_refusal(tmp_path, START + MISSION.replace(old, new), flown)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("old", "new", "key"),
    [
        ("to: [2.2, 2.4, 0.4]", "to: [2.2, 2.3, 0.4]", "to"),
        ("object: box,", "object: box, yaw_deg: 9,", "yaw_deg"),
        ("object: box,", "object: box, by: grip,", "by"),
        ("object: box,", "object: box, lift: 0.31,", "lift"),
        ("object: box,", "object: box, via: [[1.0, 1.0, 0.6]],", "via"),
    ],
)
def test_objects_are_carried_as_requested(tmp_path: Path, old: str, new: str, key: str) -> None:
    text = (PROBLEMS / "carry_box.yaml").read_text()
    assert old in text
    reason = reason_of_refusal(tmp_path, text.replace(old, new), planned("carry_box").motion)
    assert f"mission[1].transport_object.{key} is not as requested" in reason


ASKED = (
    ("{mass: 0.14}", "{mass: 0.2}", "request.team.quadrotor[1].mass"),
    ("speed: 0.9", "speed: 0.8", "request.limits.speed"),
    ("[0.8, 0.9, 1.5]", "[0.8, 0.8, 1.5]", "request.start.drones.r[2][1]"),
)


def of_problem(text: str) -> str:
    """Return the change after which a plan is of another problem."""
    return f"s.update(problem={text!r}, request={parse_yaml(text)!r})"


GONE_OBJECTS = """q["objects"] = {}
for name in ("poses", "load_share"):
    a[name] = a[name][:, :0]
"""
OTHERS = [
    ("a['drones'] = a['drones'][:, [1, 0, *range(2, 6)]]", "request.start.drones"),
    ("t['quadrotor'][0]['mass'] *= 0.5", "mass"),
    ("t['cable_length'][0] *= 1.01", "cable_length"),
    ("t['cable_density'] = 0.0", "cable_density"),
    ("t['cable_friction'] = 0.0", "cable_friction"),
    ("t['load'] = [0.01, 0.0, 0.0]", "load"),
    ("q['limits']['speed'] = 9.0", "limits.speed"),
    ("q['separation']['radius'] = 0.01", "separation.radius"),
    ("q['arena'] = None", "arena"),
    ("q['arena']['upper'] = [4.0, 4.0, 9.0]", "arena.upper[2]"),
    ("q['objects']['table']['section']['radius'] = 0.1", "objects.table"),
    ("q['keep_out'] = [{'polygon': [[5, 5], [5, 6], [6, 6]], 'lower': 0, 'upper': 1}]", "keep_out"),
    (GONE_OBJECTS, "objects"),
    *((of_problem(FORM.replace(old, new)), key) for old, new, key in ASKED),
    ("s['problem'] = 'team: {}'", "request.team"),
]  # fmt: skip
"""Changes after which a plan is not what was asked, and the key that is named."""


def refused(path: Path, words: str) -> None:
    with pytest.raises(FileError, match=r"plan\.npz: not a plan") as caught:
        read_plan(path)
    assert re.search(words, str(caught.value))


@pytest.mark.parametrize(("lie", "words"), LIES, ids=range(len(LIES)))
def test_changes_that_invalidate_a_plan_are_refused(path: Path, lie: str, words: str) -> None:
    changed(path, lie)
    refused(path, words)
    with pytest.raises(UnreadableError):
        read(path)


@pytest.mark.parametrize(("lie", "key"), OTHERS, ids=range(len(OTHERS)))
def test_other_plans_than_requested_are_refused_by_key(
    lie: str, key: str, formed: Path, tmp_path: Path
) -> None:
    (tmp_path / "plan.npz").write_bytes(formed.read_bytes())
    changed(tmp_path / "plan.npz", lie)
    with pytest.raises(FileError, match=re.escape(key)):
        ho.load(tmp_path)


@pytest.mark.parametrize(
    "lie",
    [
        "a = r['assignment']['robots']; a[0], a[1] = a[1], a[0]",
        *(
            pytest.param(lie, marks=pytest.mark.slow)
            for lie in ("r['assignment']['flipped'][2] ^= True", "r['assignment'] = None")
        ),
    ],
)
def test_other_places_than_those_of_the_drones_are_refused_by_both(
    lie: str, formed: Path, tmp_path: Path
) -> None:
    path = tmp_path / "plan.npz"
    path.write_bytes(formed.read_bytes())
    changed(path, lie)
    assert not ho.load(tmp_path).certificate.certified
    assert any(row.verdict == "violated" for row in second.verify(path))


def test_places_that_the_problem_fixes_are_compared(formed: Path, tmp_path: Path) -> None:
    path = tmp_path / "plan.npz"
    path.write_bytes(formed.read_bytes())
    fixed = FORM.replace("altitude: 1.6", "altitude: 1.6, assign: fixed")
    changed(path, of_problem(fixed))
    with pytest.raises(FileError, match=r"request\.start\.assignment\.robots\[0\]"):
        ho.load(tmp_path)


GONE = object()


def entries(value: Any, at: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yield the paths of all settings; of lists the first and the last entry's."""
    if at:
        yield at
    keys = value if isinstance(value, dict) else range(len(value) if isinstance(value, list) else 0)
    for key in list(keys)[:: max(1, len(keys) - 1)] if isinstance(keys, range) else keys:
        yield from entries(value[key], (*at, key))


def put(settings: Any, at: tuple[Any, ...], value: object) -> None:
    """Set an entry of the settings, or take it out."""
    for key in at[:-1]:
        settings = settings[key]
    if value is GONE:
        del settings[at[-1]]
    else:
        settings[at[-1]] = value


def codes(path: Path) -> tuple[int, int]:
    """Exit codes of both readers of a plan file; nothing else is raised."""
    words = ""
    try:
        first = 0 if certify(read_requested_plan(path).flight).certified else 3
    except FileError as error:
        first, words = 2, str(error)
    try:
        other = 0 if all(row.verdict in second.PASSING for row in second.verify(path)) else 3
    except second.UnreadableError as error:
        other, words = 2, words + str(error)
    assert "\n" not in words
    return first, other


UNREAD = {"problem", "controller", "model"}
"""Texts of which the second reader needs nothing but that they are texts."""


@pytest.mark.slow
@pytest.mark.parametrize(
    "value",
    [GONE, None, True, -1, 1e999, 10**400, "x", [], {}],
    ids=["gone", "null", "true", "negative", "infinite", "huge", "text", "list", "mapping"],
)
def test_both_readers_agree_on_every_edit(value: object, tmp_path: Path) -> None:
    write_plan(tmp_path / "plan.npz", ho.Flight.of(walled()), TITLE)
    with np.load(tmp_path / "plan.npz") as file:
        arrays = dict(file)
    settings, tried = json.loads(str(arrays["settings"])), 0
    for at in entries(settings):
        edited = copy.deepcopy(settings)
        put(edited, at, value)
        if edited != settings and at[-1] not in UNREAD:
            np.savez(tmp_path / "e.npz", **{**arrays, "settings": np.array(json.dumps(edited))})
            one, other = codes(tmp_path / "e.npz")
            assert one == other, f"{at}, {one}, {other}"
            tried += 1
    assert tried > 70


@pytest.mark.parametrize(
    "edit",
    [
        *(f"a['{name}'] = a['{name}'].{how}" for name in ("breaks", "drones", "legs", "contacts")
          for how in ("astype('f4')", "ravel()[:-1]", "__mul__(np.nan)")),
        "a['legs'] = a['legs'].__neg__()",
        *("a['breaks'] += 1e-7", "a['drones'] = a['drones'][..., :0]", "a['extra'] = a['legs']"),
        *("s['extra'] = 1", "r['extra'] = 1", "s['groups'][0]['name'] = 'a'", "s['groups'] *= 2"),
        "t['quadrotor'][0]['integral'] = 0", "p['end'] -= 0.1", "p['tension'] = [0.5, 0.4]",
        "p['hold'] = {'object': 'box', 'by': 'rest', 'cables': [0]}", "p['state'] = 'hanging free'",
        "p['ring'] = None", "s['problem'] = None",
        "pass",
    ],
)  # fmt: skip
def test_both_readers_agree_on_arrays_and_phases(path: Path, edit: str) -> None:
    changed(path, edit)
    one, other = codes(path)
    refuted = "__neg" in edit or edit == "p['state'] = 'hanging free'"
    expected = 0 if edit == "pass" or "extra'] = a" in edit else 3 if refuted else 2
    assert (one, other) == (expected, expected)


def with_member(path: Path, name: str, content: bytes, compression: int) -> None:
    with zipfile.ZipFile(path) as old:
        members = {m: old.read(m) for m in old.namelist()}
    members[f"{name}.npy"] = content
    with zipfile.ZipFile(path, "w", compression) as new:
        for member, data in members.items():
            new.writestr(member, data)


def header(shape: tuple[int, ...]) -> bytes:
    stream = io.BytesIO()
    described = {"descr": "<f8", "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(stream, described)
    return stream.getvalue()


BOMB = 70 * 2**20  # [bytes]


class Alias:
    """A generic alias of a type that is no class, as numpy.typing.NDArray is since numpy 2.5."""

    def __getitem__(self, arguments: Any) -> GenericAlias:
        return GenericAlias(cast(Any, self), arguments)


VECTOR: Any = Alias()[float]


@dataclass(frozen=True)
class Annotated:
    """A record as plan files store it, annotated by an alias."""

    places: VECTOR
    names: Mapping[str, VECTOR]


def test_fields_are_read_whatever_their_annotations_are() -> None:
    values = {"places": [0.0, 1.0], "names": {"q0": [2.0]}}
    assert encoded(decoded(Annotated, values)) == values


@pytest.mark.parametrize(
    ("shape", "size", "words"),
    [
        *((shape, 1000, "drones' claims") for shape in ((10**7, 8, 3, 10), (2**62, 8))),
        *((shape, 1000, "drones' claims") for shape in ((2**200,), (-1, 8, 3, 10))),
        ((BOMB // 8,), BOMB, "would unpack to"),
    ],
)
def test_claims_and_bombs_cost_nothing(
    path: Path, shape: tuple[int, ...], size: int, words: str
) -> None:
    packing = zipfile.ZIP_DEFLATED if size == BOMB else zipfile.ZIP_STORED
    with_member(path, GROUP + "drones", header(shape) + bytes(size), packing)
    assert path.stat().st_size < 2**20
    with memory_below(2e6), pytest.raises(FileError, match=words):
        read_plan(path)


def edits(whole: bytes, chance: random.Random) -> Iterator[bytes]:
    """Yield damaged copies: flipped bytes, the arrays' headers above all, cuts, insertions."""
    headers = [
        at for m in re.finditer(b"\x93NUMPY", whole) for at in range(m.start(), m.end() + 90)
    ]
    for at in [*chance.sample(headers, 150), *chance.choices(range(len(whole)), k=150)]:
        for byte in (chance.randrange(256), whole[at] ^ 1 << chance.randrange(8)):
            yield whole[:at] + bytes([byte]) + whole[at + 1 :]
    for size in {*range(0, len(whole), 97), len(whole) - 1}:
        yield whole[:size]
    for _ in range(60):
        at = chance.randrange(len(whole))
        yield whole[:at] + chance.randbytes(chance.randrange(1, 20)) + whole[at:]
        yield whole[:at] + whole[at + chance.randrange(1, 50) :]


def test_every_byte_edit_is_the_same_plan_or_a_file_error(tmp_path: Path) -> None:
    flight, path, refused = ho.Flight.of(swarm_plan()), tmp_path / "plan.npz", 0
    write_plan(path, flight, TITLE)
    for damaged in edits(path.read_bytes(), random.Random(13)):
        path.write_bytes(damaged)
        try:
            read, title, *_ = read_saved_plan(path)
        except FileError:
            refused += 1
        else:
            assert (bits(read), title) == (bits(flight), TITLE)
    assert refused > 400


ORDINARY = "{'descr': '<f8', 'fortran_order': False, 'shape': "


@pytest.mark.parametrize(
    "text",
    [
        *(ORDINARY + rest for rest in ("(4,), ", "((((((4,), }", "(4L,), '''")),
        "{'descr': [('a', '<f8')], 'fortran_order': False, 'shape': (4,), }",
        "{'descr': '<f7', 'fortran_order': False, 'shape': (4,), }",
        *("[" * 9000, "\\", ""),
    ],
)
def test_headers_that_numpy_does_not_write_are_never_evaluated(path: Path, text: str) -> None:
    """With their checksums right: nothing but the header gives them away."""
    start = b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little")
    with_member(path, GROUP + "legs", start + text.encode() + bytes(32), zipfile.ZIP_STORED)
    with pytest.raises(FileError, match="array 'groups/0/legs'"):
        read_plan(path)
