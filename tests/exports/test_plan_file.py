from __future__ import annotations

import dataclasses
import io
import json
import random
import re
import tracemalloc
import zipfile
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from handmade import made_motion, made_swarm

from hitchopt import Prism, Section, SolidObject, solve
from hitchopt.cli import main
from hitchopt.errors import FileError
from hitchopt.hitch import Team
from hitchopt.motion.motion import Motion
from hitchopt.motion.plan_file import read_plan, read_title, write_plan


@pytest.fixture(scope="module")
def motion() -> Motion:
    return made_motion()


PROBLEMS = Path(__file__).parents[2] / "problems"
TITLE = 'Ein "Dreieck", 三角 \\ \n – with everything'


def bits(value: Any) -> Any:
    """All that a plan holds, arrays as bytes."""
    if isinstance(value, np.ndarray):
        return value.shape, np.asarray(value, dtype=np.float64).tobytes()
    if dataclasses.is_dataclass(value):
        return type(value), [bits(getattr(value, f.name)) for f in dataclasses.fields(value)]
    if isinstance(value, dict):
        return [(key, bits(part)) for key, part in value.items()]
    return [bits(part) for part in value] if isinstance(value, tuple) else repr(value)


def rewritten(path: Path, change: Callable[[dict[str, Any]], None], **how: Any) -> None:
    """Save the arrays of the plan again after ``change``."""
    with np.load(path) as file:
        arrays = dict(file)
    change(arrays)
    (np.savez_compressed if how.get("compressed") else np.savez)(path, **arrays)


@pytest.fixture
def path(motion: Motion, tmp_path: Path) -> Path:
    write_plan(tmp_path / "plan.npz", motion, TITLE)
    return tmp_path / "plan.npz"


def controlled() -> Motion:
    """A motion none of whose team's fields is its default; a new field has to be given here."""
    motion, plain = made_motion(), Team(4, 2.0)
    kinds = tuple(
        dataclasses.replace(
            kind, stiffness=4.75 + k if k else None, integral=k == 1, feed_forward=k != 2
        )
        for k, kind in enumerate(motion.team.quadrotor)
    )
    load = np.array([0.001, 0.002, 0.003, 0.004])
    team = dataclasses.replace(motion.team, cable_friction=0.2, load=load, quadrotor=kinds)
    for field in dataclasses.fields(Team):
        value, default = getattr(team, field.name), getattr(plain, field.name)
        assert field.name in {"robots", "topology"} or not np.array_equal(value, default)
    return dataclasses.replace(motion, team=team)


def walled() -> Motion:
    """Drones between a prism and a pole."""
    swarm, outline = made_swarm(), [[-9.0, 0.0], [-9.0, 1.0], [-8.0, 1.0]]
    pole = SolidObject(Section(radius=0.1), 0.0, 1.5, at=[-6.0, 0.0, 0.0], fixed=True)
    requirements = dataclasses.replace(
        swarm.requirements, keep_out=(Prism(outline, 0.1, 2.0),), objects={"pole": pole}
    )
    return dataclasses.replace(swarm, requirements=requirements)


@pytest.mark.parametrize(
    "kind",
    [
        *(made_motion, made_swarm, controlled, walled),
        *("open_arc", "friction", "form_triangle"),
        *(pytest.param(name, marks=pytest.mark.slow) for name in ("carry_box", "grip_drum")),
    ],
)
def test_a_plan_comes_back_bit_by_bit(kind: str | Callable[[], Motion], tmp_path: Path) -> None:
    motion = solve(PROBLEMS / f"{kind}.yaml").motion if isinstance(kind, str) else kind()
    write_plan(tmp_path / "plan.npz", motion, TITLE)
    read = read_plan(tmp_path / "plan.npz")
    assert bits(read) == bits(motion)
    assert read_title(tmp_path / "plan.npz") == TITLE
    write_plan(tmp_path / "again.npz", read, TITLE)
    assert (tmp_path / "again.npz").read_bytes() == (tmp_path / "plan.npz").read_bytes()
    rewritten(tmp_path / "plan.npz", lambda _: None, compressed=True)
    assert bits(read_plan(tmp_path / "plan.npz")) == bits(motion)


def test_a_rigid_loop_is_not_written(path: Path) -> None:
    with np.load(path) as file:
        assert not {"stiffness", "integral", "feed_forward"} & set(file)


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("stiffness", -1.0, "stiffness = -1.0: must be greater than 0"),
        ("stiffness", np.nan, "stiffness = nan: must be finite"),
        ("integral", 0.5, "integral = 0.5: must be 0 or 1"),
        ("feed_forward", np.nan, "feed_forward = nan: must be 0 or 1"),
    ],
)
def test_damaged_controllers_are_refused(
    motion: Motion, tmp_path: Path, name: str, value: float, words: str
) -> None:
    kinds = [dataclasses.replace(kind, stiffness=5.0) for kind in motion.team.quadrotor]
    path = tmp_path / "plan.npz"
    team = dataclasses.replace(motion.team, quadrotor=tuple(kinds))
    write_plan(path, dataclasses.replace(motion, team=team))
    rewritten(path, lambda a: a.update({name: np.array([value, *a[name][1:]])}))
    with pytest.raises(FileError, match=re.escape(words)):
        read_plan(path)


@pytest.mark.parametrize(
    "content", [b"", b"hello", b"PK\x03\x04", b"\x93NUMPY\x01\x00v\x00{'descr': '<f8'", b"\0" * 999]
)
def test_other_files_are_no_plans(path: Path, content: bytes) -> None:
    path.write_bytes(content)
    with pytest.raises(FileError, match=r"plan\.npz: not a plan"):
        read_plan(path)


def resettled(change: Callable[[dict[str, Any]], object]) -> Callable[[dict[str, Any]], None]:
    """A change of a plan's arrays from one of its settings."""

    def within(arrays: dict[str, Any]) -> None:
        settings = json.loads(str(arrays["settings"]))
        change(settings)
        arrays["settings"] = np.array(json.dumps(settings))

    return within


def spans(*ends: tuple[float, float]) -> Callable[[dict[str, Any]], None]:
    """Phases over these parts of the plan's 2.53 s."""

    def change(settings: dict[str, Any]) -> None:
        phase = settings["phases"][0]
        settings["phases"] = [phase | {"start": 2.53 * a, "end": 2.53 * b} for a, b in ends]

    return resettled(change)


def _phase(key: str, value: object, settings: dict[str, Any]) -> None:
    settings["phases"][0][key] = value


def without(name: str) -> Callable[[dict[str, Any]], None]:
    def change(arrays: dict[str, Any]) -> None:
        arrays.pop(name)

    return change


ARRAYS = (
    *("format", "settings", "breaks", "drones", "vertices", "legs", "tensions", "cable_length"),
    *("tension", "mass", "max_thrust"),
)

LIES: dict[str, tuple[Callable[[dict[str, Any]], Any], str]] = {
    "another format": (lambda a: a.update(format=np.array("hitchopt-plan/2")), "hitchopt-plan/2"),
    "not a number": (lambda a: a["drones"].__setitem__((1, 2, 0, 3), np.nan), ""),
    "an infinite break": (lambda a: a["breaks"].__setitem__(-1, np.inf), ""),
    "breaks that fall": (lambda a: a.update(breaks=a["breaks"][::-1]), ""),
    "breaks from 0.5": (lambda a: a.update(breaks=a["breaks"] + 0.5), r"phases = \["),
    "single precision": (lambda a: a.update(legs=a["legs"].astype(np.float32)), ""),
    "complex numbers": (lambda a: a.update(legs=a["legs"].astype(np.complex128)), ""),
    "objects": (lambda a: a.update(mass=np.array([{}, [], 1, 2], dtype=object)), "objects"),
    "a drone too few": (lambda a: a.update(drones=a["drones"][:, :-1]), ""),
    "a piece too few": (lambda a: a.update(vertices=a["vertices"][:-1]), ""),
    "no coefficients": (lambda a: a.update(vertices=a["vertices"][..., :0]), ""),
    "a scalar": (lambda a: a.update(tensions=np.array(0.4)), ""),
    "no mass": (lambda a: a["mass"].__setitem__(1, 0.0), ""),
    "a mass too many": (lambda a: a.update(mass=np.ones(5)), ""),
    "and its thrust": (lambda a: a.update(mass=np.ones(5), max_thrust=np.ones(5)), ""),
    "a negative tension": (lambda a: a["tension"].__setitem__(0, -0.4), ""),
    "no JSON": (lambda a: a.update(settings=np.array("{")), ""),
    "deep JSON": (lambda a: a.update(settings=np.array("[" * 100_000)), ""),
    "a list": (lambda a: a.update(settings=np.array("[]")), ""),
    "settings of numbers": (lambda a: a.update(settings=np.arange(3.0)), ""),
    "no team": (resettled(lambda s: s.pop("team")), ""),
    "an unknown limit": (resettled(lambda s: s["limits"].update(colour=1.0)), "colour"),
    "a limit of zero": (resettled(lambda s: s["limits"].update(speed=0.0)), "speed"),
    "a limit of nan": (resettled(lambda s: s["limits"].update(jerk=float("nan"))), "jerk"),
    "a radius in words": (resettled(lambda s: s["separation"].update(radius="wide")), "radius"),
    "arena of two": (resettled(lambda s: s["arena"].update(lower=[0.0, 1.0])), "lower"),
    "arena inside out": (resettled(lambda s: s["arena"].update(lower=[9.0, 9.0, 9.0])), ""),
    "one robot more": (resettled(lambda s: s["team"].update(robots=5)), ""),
    "very many robots": (resettled(lambda s: s["team"].update(robots=10**9)), ""),
    "half a robot": (resettled(lambda s: s["team"].update(robots=3.5)), ""),
    "an open chain": (resettled(lambda s: s["team"].update(topology="open")), ""),
    "a phase without a name": (resettled(lambda s: s["phases"][0].pop("name")), "name"),
    "a phase with a number": (resettled(lambda s: s["phases"][0].update(name=3)), "name"),
    "a phase from nan": (resettled(lambda s: s["phases"][0].update(start=float("nan"))), ""),
    "a step of 1.5": (resettled(lambda s: s["phases"][0].update(step=1.5)), "step"),
    **{
        f"a state {state!r}": (
            resettled(partial(_phase, "state", state)),
            "state",
        )
        for state in ("standing", "none", 3, ["clasping"])
    },
    **{
        f"a range {x!r}": (resettled(partial(_phase, "tension", x)), "tension")
        for x in ([0.8, 0.3], [0.0, 0.8], [0.3], "0.3", [0.3, True], [0.3, 1e999], {"min": 0.3})
    },
    "phases back": (spans((0.0, 1.0), (1.0, 0.0), (0.0, 1.0)), r"phases = \["),
    "phases with a gap": (spans((0.0, 0.5), (0.6, 1.0)), r"phases = \["),
    "phases that overlap": (spans((0.0, 0.6), (0.5, 1.0)), r"phases = \["),
    "phases from before": (spans((-0.5, 1.0)), r"phases = \["),
    "phases from later": (spans((0.5, 1.0)), r"phases = \["),
    "phases too long": (spans((0.0, 1.5)), r"phases = \["),
    "no phases": (spans(), r"phases = \["),
    **{f"no {name}": (without(name), f"'{name}' is in it 0 times") for name in ARRAYS},
}


@pytest.mark.parametrize("lie", LIES)
def test_what_makes_no_plan_is_refused(path: Path, lie: str) -> None:
    change, words = LIES[lie]
    rewritten(path, change)
    with pytest.raises(FileError, match=r"plan\.npz: not a plan") as caught:
        read_plan(path)
    assert re.search(words, str(caught.value))
    if lie == "phases with a gap":
        result = CliRunner().invoke(main, ["check", str(path.parent)])
        assert result.exit_code == 2
        assert "phases = [" in result.output


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


def edits(whole: bytes, chance: random.Random) -> Iterator[bytes]:
    """Yield damaged copies: flipped bytes, the arrays' headers above all, cuts, insertions."""
    headers = [
        at for m in re.finditer(b"\x93NUMPY", whole) for at in range(m.start(), m.end() + 90)
    ]
    for at in [*chance.sample(headers, 150), *chance.choices(range(len(whole)), k=150)]:
        damaged = bytearray(whole)
        damaged[at] = chance.randrange(256)
        yield bytes(damaged)
        flipped = bytearray(whole)
        flipped[at] ^= 1 << chance.randrange(8)
        yield bytes(flipped)
    for size in {*range(0, len(whole), 97), len(whole) - 1}:
        yield whole[:size]
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
            assert bits(read) == bits(motion)
    assert refused > 400


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
