from __future__ import annotations

import dataclasses
import io
import json
import random
import re
import tracemalloc
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from handmade import made_motion, made_swarm

from hitchopt.cli import main
from hitchopt.errors import FileError
from hitchopt.hitch import Quadrotor, Swarm, Team
from hitchopt.motion.motion import CableState, Motion
from hitchopt.motion.plan_file import read_plan, read_title, write_plan
from hitchopt.requirements import Limits


@pytest.fixture(scope="module")
def motion() -> Motion:
    return made_motion()


TITLE = 'Ein "Dreieck", 三角 \\ \n – with everything'


def bits(array: Any) -> tuple[tuple[int, ...], bytes]:
    values = np.asarray(array, dtype=np.float64)
    return values.shape, values.tobytes()


def assert_same(a: Motion, b: Motion) -> None:
    assert isinstance(a, Motion)
    for name in ("drones", "vertices", "legs", "tensions"):
        for part in ("breaks", "coefficients"):
            x, y = (getattr(getattr(motion, name), part) for motion in (a, b))
            assert bits(x) == bits(y)
    assert type(a.team) is type(b.team)
    for field in dataclasses.fields(a.team):
        x, y = getattr(a.team, field.name), getattr(b.team, field.name)
        assert bits(x) == bits(y) if isinstance(x, np.ndarray) else x == y
    for name in ("mass", "max_thrust", "cable_weight"):
        assert bits(getattr(a.team, name)) == bits(getattr(b.team, name))
    assert a.requirements.limits == b.requirements.limits
    assert a.requirements.separation == b.requirements.separation
    assert (a.requirements.arena is None) == (b.requirements.arena is None)
    if a.requirements.arena is not None and b.requirements.arena is not None:
        assert bits(a.requirements.arena.lower) == bits(b.requirements.arena.lower)
        assert bits(a.requirements.arena.upper) == bits(b.requirements.arena.upper)
    assert a.phases == b.phases


def rewritten(path: Path, change: Callable[[dict[str, Any]], None], **how: Any) -> None:
    """Save the arrays of the plan again after ``change``."""
    with np.load(path) as file:
        arrays = dict(file)
    change(arrays)
    (np.savez_compressed if how.get("compressed") else np.savez)(path, **arrays)


def resettled(path: Path, change: Callable[[dict[str, Any]], None]) -> None:
    """Save the plan again after ``change`` of its settings."""

    def within(arrays: dict[str, Any]) -> None:
        settings = json.loads(str(arrays["settings"]))
        change(settings)
        arrays["settings"] = np.array(json.dumps(settings))

    rewritten(path, within)


@pytest.fixture
def path(motion: Motion, tmp_path: Path) -> Path:
    write_plan(tmp_path / "plan.npz", motion, TITLE)
    return tmp_path / "plan.npz"


def test_a_plan_comes_back_bit_by_bit(motion: Motion, path: Path) -> None:
    assert_same(read_plan(path), motion)
    assert read_title(path) == TITLE


def test_every_field_of_a_team_comes_back(motion: Motion, tmp_path: Path) -> None:
    """A field that is added to the team is in the file too, or this fails."""
    plain = Team(motion.team.robots, 2.0, topology="closed")
    given = dataclasses.replace(
        motion,
        team=dataclasses.replace(
            motion.team, cable_friction=0.2, load=np.full(len(motion.team.layout.clasps), 0.002)
        ),
    )
    for field in dataclasses.fields(Team):
        value, default = getattr(given.team, field.name), getattr(plain, field.name)
        assert field.name in {"robots", "topology"} or not np.array_equal(value, default)
    write_plan(tmp_path / "plan.npz", given)
    assert_same(read_plan(tmp_path / "plan.npz"), given)


@pytest.mark.parametrize("made", [made_motion, made_swarm])
def test_controllers_come_back_and_a_rigid_one_without_them(
    made: Callable[[], Motion], tmp_path: Path
) -> None:
    motion, path = made(), tmp_path / "plan.npz"
    kinds = [
        dataclasses.replace(
            kind, stiffness=None if k == 0 else 4.75 + k, integral=k == 1, feed_forward=k != 2
        )
        for k, kind in enumerate(motion.team.quadrotor)
    ]
    given = dataclasses.replace(motion, team=with_kinds(motion.team, kinds))
    write_plan(path, given)
    assert read_plan(path).team.quadrotor == tuple(kinds)
    assert_same(read_plan(path), given)
    write_plan(path, motion)
    with np.load(path) as file:
        assert not {"stiffness", "integral", "feed_forward"} & set(file)


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("stiffness", -1.0, "stiffness = -1.0: must be greater than 0"),
        ("stiffness", np.nan, "stiffness = nan: must be finite"),
        ("stiffness", -np.inf, "stiffness = -inf: must be finite"),
        ("integral", 0.5, "integral = 0.5: must be 0 or 1"),
        ("feed_forward", np.nan, "feed_forward = nan: must be 0 or 1"),
    ],
)
def test_damaged_controllers_are_refused(
    motion: Motion, tmp_path: Path, name: str, value: float, words: str
) -> None:
    kinds = [dataclasses.replace(kind, stiffness=5.0) for kind in motion.team.quadrotor]
    path = tmp_path / "plan.npz"
    write_plan(path, dataclasses.replace(motion, team=with_kinds(motion.team, kinds)))

    def change(arrays: dict[str, Any]) -> None:
        arrays[name] = np.array([value, *arrays[name][1:]])

    rewritten(path, change)
    with pytest.raises(FileError, match=re.escape(words)):
        read_plan(path)


def with_kinds(team: Team, kinds: list[Quadrotor]) -> Team:
    if team.has_cables:
        return dataclasses.replace(team, quadrotor=tuple(kinds))
    return Swarm(team.drones, quadrotor=kinds)


def test_a_plan_without_arena_and_duration_comes_back(motion: Motion, tmp_path: Path) -> None:
    bare = dataclasses.replace(
        motion,
        requirements=dataclasses.replace(
            motion.requirements, arena=None, limits=Limits(tilt=np.nextafter(0.7, 1.0))
        ),
    )
    write_plan(tmp_path / "plan.npz", bare)
    assert_same(read_plan(tmp_path / "plan.npz"), bare)
    assert read_title(tmp_path / "plan.npz") == ""


def test_the_same_plan_gives_the_same_bytes(motion: Motion, path: Path, tmp_path: Path) -> None:
    write_plan(tmp_path / "again.npz", motion, TITLE)
    write_plan(tmp_path / "read.npz", read_plan(path), TITLE)
    assert (tmp_path / "again.npz").read_bytes() == path.read_bytes()
    assert (tmp_path / "read.npz").read_bytes() == path.read_bytes()


def test_a_plan_repacked_with_compression_is_the_same(motion: Motion, path: Path) -> None:
    rewritten(path, lambda _: None, compressed=True)
    assert_same(read_plan(path), motion)


def test_no_truncation_is_taken_for_a_plan(path: Path) -> None:
    whole = path.read_bytes()
    for size in {*range(0, len(whole), 97), len(whole) - 1}:
        path.write_bytes(whole[:size])
        with pytest.raises(FileError, match=r"plan\.npz"):
            read_plan(path)


def test_no_flipped_bit_goes_unnoticed(motion: Motion, path: Path) -> None:
    whole = path.read_bytes()
    chance = random.Random(5)
    refused = 0
    for _ in range(300):
        damaged = bytearray(whole)
        damaged[chance.randrange(len(whole))] ^= 1 << chance.randrange(8)
        path.write_bytes(damaged)
        try:
            read = read_plan(path)
        except FileError:
            refused += 1
        else:  # a bit that nobody reads, such as an entry's date
            assert_same(read, motion)
    assert refused > 150


@pytest.mark.parametrize(
    "content", [b"", b"hello", b"PK\x03\x04", b"\x93NUMPY\x01\x00v\x00{'descr': '<f8'", b"\0" * 999]
)
def test_other_files_are_no_plans(path: Path, content: bytes) -> None:
    path.write_bytes(content)
    with pytest.raises(FileError, match=r"plan\.npz: not a plan"):
        read_plan(path)


def test_a_missing_plan_and_a_directory_are_file_errors(tmp_path: Path) -> None:
    with pytest.raises(FileError, match=r"plan\.npz: there is no such file"):
        read_plan(tmp_path / "plan.npz")
    (tmp_path / "plan.npz").mkdir()
    with pytest.raises(FileError, match="cannot be read"):
        read_plan(tmp_path / "plan.npz")


NAMES = ("format", "settings", "breaks", "drones", "vertices", "legs", "tensions", "cable_length")


@pytest.mark.parametrize("name", [*NAMES, "tension", "mass", "max_thrust"])
def test_every_array_is_needed(path: Path, name: str) -> None:
    rewritten(path, lambda arrays: arrays.pop(name))
    with pytest.raises(FileError, match=f"'{name}' is in it 0 times"):
        read_plan(path)


CHANGES: dict[str, Callable[[dict[str, Any]], None]] = {
    "another format": lambda a: a.update(format=np.array("hitchopt-plan/2")),
    "not a number": lambda a: a["drones"].__setitem__((1, 2, 0, 3), np.nan),
    "an infinite break": lambda a: a["breaks"].__setitem__(-1, np.inf),
    "breaks that fall": lambda a: a.update(breaks=a["breaks"][::-1]),
    "single precision": lambda a: a.update(legs=a["legs"].astype(np.float32)),
    "complex numbers": lambda a: a.update(legs=a["legs"].astype(np.complex128)),
    "a drone too few": lambda a: a.update(drones=a["drones"][:, :-1]),
    "a piece too few": lambda a: a.update(vertices=a["vertices"][:-1]),
    "no coefficients": lambda a: a.update(vertices=a["vertices"][..., :0]),
    "a scalar": lambda a: a.update(tensions=np.array(0.4)),
    "no mass": lambda a: a["mass"].__setitem__(1, 0.0),
    "a mass too many": lambda a: a.update(mass=np.ones(5)),
    "a mass too many and its thrust": lambda a: a.update(mass=np.ones(5), max_thrust=np.ones(5)),
    "a negative tension": lambda a: a["tension"].__setitem__(0, -0.4),
    "no JSON": lambda a: a.update(settings=np.array("{")),
    "deep JSON": lambda a: a.update(settings=np.array("[" * 100_000)),
    "a list": lambda a: a.update(settings=np.array("[]")),
    "settings of numbers": lambda a: a.update(settings=np.arange(3.0)),
}


@pytest.mark.parametrize("name", CHANGES)
def test_arrays_that_make_no_plan_are_refused(path: Path, name: str) -> None:
    rewritten(path, CHANGES[name])
    with pytest.raises(FileError, match=r"plan\.npz: not a plan"):
        read_plan(path)


SETTINGS: dict[str, Callable[[dict[str, Any]], None]] = {
    "no team": lambda s: s.pop("team"),
    "an unknown limit": lambda s: s["limits"].update(colour=1.0),
    "a limit of zero": lambda s: s["limits"].update(speed=0.0),
    "a limit of nan": lambda s: s["limits"].update(jerk=float("nan")),
    "a word for a radius": lambda s: s["separation"].update(radius="wide"),
    "arena of two numbers": lambda s: s["arena"].update(lower=[0.0, 1.0]),
    "arena inside out": lambda s: s["arena"].update(lower=[9.0, 9.0, 9.0]),
    "one robot more": lambda s: s["team"].update(robots=5),
    "very many robots": lambda s: s["team"].update(robots=10**9),
    "half a robot": lambda s: s["team"].update(robots=3.5),
    "an open chain": lambda s: s["team"].update(topology="open"),
    "a phase without a name": lambda s: s["phases"][0].pop("name"),
    "a phase with a number": lambda s: s["phases"][0].update(name=3),
    "a phase from nan": lambda s: s["phases"][0].update(start=float("nan")),
    "a step of 1.5": lambda s: s["phases"][0].update(step=1.5),
}


@pytest.mark.parametrize("name", SETTINGS)
def test_settings_that_make_no_plan_are_refused(path: Path, name: str) -> None:
    resettled(path, SETTINGS[name])
    with pytest.raises(FileError, match=r"plan\.npz: not a plan"):
        read_plan(path)


def with_member(path: Path, name: str, content: bytes, compression: int) -> None:
    with zipfile.ZipFile(path) as old:
        members = {m: old.read(m) for m in old.namelist()}
    members[f"{name}.npy"] = content
    with zipfile.ZipFile(path, "w", compression) as new:
        for member, data in members.items():
            new.writestr(member, data)


def header(shape: tuple[int, ...], descr: str = "<f8") -> bytes:
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        stream, {"descr": descr, "fortran_order": False, "shape": shape}
    )
    return stream.getvalue()


@pytest.mark.parametrize("shape", [(10**7, 8, 3, 10), (2**62, 8), (2**200,), (-1, 8, 3, 10)])
def test_a_claim_of_absurd_size_costs_nothing(path: Path, shape: tuple[int, ...]) -> None:
    with_member(path, "drones", header(shape) + bytes(1000), zipfile.ZIP_STORED)
    tracemalloc.start()
    with pytest.raises(FileError, match="'drones' claims"):
        read_plan(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 2e6


def test_a_decompression_bomb_is_refused_before_it_goes_off(path: Path) -> None:
    size = 160 * 2**20
    with_member(path, "drones", header((size // 8,)) + bytes(size), zipfile.ZIP_DEFLATED)
    assert path.stat().st_size < 2**20
    tracemalloc.start()
    with pytest.raises(FileError, match="would unpack to"):
        read_plan(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 2e6


def test_objects_are_never_unpickled(path: Path) -> None:
    rewritten(path, lambda arrays: arrays.update(mass=np.array([{}, [], 1, 2], dtype=object)))
    with pytest.raises(FileError, match="objects"):
        read_plan(path)


def test_an_array_given_twice_is_refused(path: Path) -> None:
    with (
        zipfile.ZipFile(path, "a") as file,
        pytest.warns(UserWarning, match="Duplicate"),
    ):
        file.writestr("mass.npy", header((4,)) + np.ones(4).tobytes())
    with pytest.raises(FileError, match="'mass' is in it 2 times"):
        read_plan(path)


def test_the_plan_of_a_swarm_comes_back(tmp_path: Path) -> None:
    swarm = made_swarm()
    write_plan(tmp_path / "plan.npz", swarm, TITLE)
    again = read_plan(tmp_path / "plan.npz")
    assert isinstance(again, Motion)
    assert again.team.quadrotor == swarm.team.quadrotor
    assert (again.requirements.limits, again.requirements.separation) == (
        swarm.requirements.limits,
        swarm.requirements.separation,
    )
    assert again.phases == swarm.phases
    assert bits(again.drones.coefficients) == bits(swarm.drones.coefficients)
    assert bits(again.drones.breaks) == bits(swarm.drones.breaks)
    assert read_title(tmp_path / "plan.npz") == TITLE


def test_whether_the_hitch_is_formed_comes_back(motion: Motion, tmp_path: Path) -> None:
    phases = (dataclasses.replace(motion.phases[0], state=CableState.FREE), motion.phases[1])
    write_plan(tmp_path / "plan.npz", dataclasses.replace(motion, phases=phases))
    assert read_plan(tmp_path / "plan.npz").phases == phases


@pytest.mark.parametrize(
    "spans",
    [
        [[0.0, 1.0], [1.0, 0.0], [0.0, 1.0]],
        [[0.0, 0.5], [0.6, 1.0]],
        [[0.0, 0.6], [0.5, 1.0]],
        [[-0.5, 1.0]],
        [[0.5, 1.0]],
        [[0.0, 1.5]],
        [],
    ],
)
def test_phases_cover_the_plan_once(motion: Motion, path: Path, spans: list[list[float]]) -> None:
    def spoilt(settings: dict[str, Any]) -> None:
        phase = settings["phases"][0]
        settings["phases"] = [
            phase | {"start": motion.duration * start, "end": motion.duration * end}
            for start, end in spans
        ]

    resettled(path, spoilt)
    with pytest.raises(FileError, match=r"phases = \["):
        read_plan(path)
    result = CliRunner().invoke(main, ["check", str(path.parent)])
    assert result.exit_code == 2
    assert "phases = [" in result.output


def test_breaks_begin_at_zero(path: Path) -> None:
    rewritten(path, lambda arrays: arrays.update(breaks=arrays["breaks"] + 0.5))
    with pytest.raises(FileError, match=r"phases = \["):
        read_plan(path)


def test_formed_is_yes_or_no(path: Path) -> None:
    def spoilt(settings: dict[str, Any]) -> None:
        settings["phases"][0]["formed"] = "yes"
        del settings["phases"][0]["state"]

    resettled(path, spoilt)
    with pytest.raises(FileError, match="formed"):
        read_plan(path)


def edits(whole: bytes, chance: random.Random) -> Iterator[bytes]:
    """Yield damaged copies: flipped bytes, the arrays' headers above all, cuts, insertions."""
    headers = [
        at for m in re.finditer(b"\x93NUMPY", whole) for at in range(m.start(), m.end() + 90)
    ]
    for at in [*chance.sample(headers, 150), *chance.choices(range(len(whole)), k=150)]:
        damaged = bytearray(whole)
        damaged[at] = chance.randrange(256)
        yield bytes(damaged)
    for _ in range(60):
        at = chance.randrange(len(whole))
        yield whole[:at] + chance.randbytes(chance.randrange(1, 20)) + whole[at:]
        yield whole[:at] + whole[at + chance.randrange(1, 50) :]
        yield whole[:at]


def test_every_byte_edit_is_the_same_plan_or_a_file_error(motion: Motion, path: Path) -> None:
    refused = 0
    for damaged in edits(path.read_bytes(), random.Random(13)):
        path.write_bytes(damaged)
        try:
            read = read_plan(path)
            assert read_title(path) == TITLE
        except FileError:
            refused += 1
        else:
            assert_same(read, motion)
    assert refused > 250


@pytest.mark.parametrize(
    "text",
    [
        "{'descr': '<f8', 'fortran_order': False, 'shape': (4,), ",
        "{'descr': '<f8', 'fortran_order': False, 'shape': ((((((4,), }",
        "{'descr': '<f8', 'fortran_order': False, 'shape': (4L,), '''",
        "{'descr': [('a', '<f8')], 'fortran_order': False, 'shape': (4,), }",
        "{'descr': '<f7', 'fortran_order': False, 'shape': (4,), }",
        "[" * 9000,
        "\\",
        "",
    ],
)
def test_headers_that_numpy_does_not_write_are_never_evaluated(path: Path, text: str) -> None:
    """With their checksums right: nothing but the header gives them away."""
    start = b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little")
    with_member(path, "mass", start + text.encode() + bytes(32), zipfile.ZIP_STORED)
    with pytest.raises(FileError, match="array 'mass'"):
        read_plan(path)


@pytest.mark.parametrize("compression", [zipfile.ZIP_LZMA, zipfile.ZIP_BZIP2])
def test_unusual_compression_is_refused(path: Path, compression: int) -> None:
    with_member(path, "mass", header((4,)) + np.ones(4).tobytes(), compression)
    with pytest.raises(FileError, match="packed by an unknown method"):
        read_plan(path)
