"""What is remembered: every field of every record, to the last bit, and nobody can change it."""

from __future__ import annotations

import copy
import pickle
import typing
from collections.abc import Iterator
from dataclasses import dataclass, is_dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from problem_cases import GOOD

import hitchopt as ho
from hitchopt.mission.memory import VARIABLE, pickled, request_key
from hitchopt.requirements import Requirements
from hitchopt.steps import STEPS as KINDS
from hitchopt.steps.situation import Situation


@pytest.fixture(autouse=True)
def _remembering(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(VARIABLE)


TRIANGLE = ho.ConvexPolygon([[0.3, -1.0], [-0.4, 0.5], [0.4, 0.55]])
TEAM = ho.Team(
    3,
    [2.4, 2.5, 2.6],
    cable_density=0.003,
    cable_friction=0.1,
    tension=[0.4, 0.5, 0.45],
    quadrotor=[ho.Quadrotor(), ho.Quadrotor(0.14), ho.Quadrotor(0.13, 2.8, 4.75, True, False)],
)
HITCH = ho.Hitch.balanced(TEAM, TRIANGLE, 1.3)
POINTS = np.arange(9.0).reshape(3, 3)
REQUIREMENTS = Requirements(
    ho.Limits(duration=20.0),
    ho.Separation(),
    ho.Arena([-3.0, -2.0, 0.1], [3.0, 4.0, 2.5]),
    objects={
        "tray": ho.SolidObject(
            ho.Section(TRIANGLE.vertices), at=POINTS[0], rim=ho.Rim(ho.Section(radius=2.0), 0.2)
        )
    },
)
STEPS = (
    ho.Morph(TRIANGLE, HITCH.q_legs, 3.0, tension=(0.3, 0.6)),
    ho.MoveVertex(1, to=np.array([0.1, 0.2])),
    ho.MoveEdge(0, by=np.array([0.1, 0.2]), legs="balanced"),
    ho.Adjust("balanced"),
    ho.FollowVertex(2, POINTS + 1.0),
    ho.Transport(np.array([0.1, 0.2, 1.0]), 0.3),
    ho.Hold(1.5),
    ho.Form(TRIANGLE, 1.2, "spread", "fixed", ho.SwapSettings(0.2, 0.4, 2.0, 1)),
    ho.Release(2.0),
    ho.Land(),
    ho.Enclose("tray", 9.0),
    ho.Grasp("tray", "rest", 0.7),
    ho.Lift(0.3),
    ho.Carry("tray", np.array([0.1, 0.2, 1.0]), 0.3),
    ho.SetDown("tray"),
    ho.Loosen("tray"),
    ho.Leave("tray"),
    ho.TransportObject("tray", np.array([0.1, 0.2, 1.0]), "rest", 0.7, 0.1, 0.4),
)
SWARM = ho.SwarmProblem(
    ho.Swarm(
        3,
        quadrotor=[ho.Quadrotor(), ho.Quadrotor(0.14), ho.Quadrotor(0.13, 2.8, 4.75, True, False)],
    ),
    POINTS,
    POINTS + 5.0,
    arena=ho.Arena([-30.0] * 3, [30.0] * 3),
    keep_out=(ho.Prism(TRIANGLE.translated([20.0, 0.0]), 0.1, 2.0),),
    duration=9.0,
    title="three",
)
ROOTS: dict[str, Any] = {
    **{type(step).__name__: step for step in STEPS},
    "Team": TEAM,
    "Hitch": HITCH,
    "HitchStart": ho.HitchStart(TRIANGLE, 1.1),
    "DronesStart": ho.DronesStart(POINTS, POINTS + 2.0),
    "Requirements": REQUIREMENTS,
    "Situation": Situation(TEAM, HITCH.drones, HITCH, np.ones(3), ho.SwapSettings()),
    "SwarmProblem": SWARM,
    "Problem": ho.Problem(TEAM, ho.HitchStart(TRIANGLE, 1.1), STEPS[:1], title="one"),
}


def with_part(record: Any, name: str, value: object) -> Any:
    """A copy of a record with one of its parts exchanged, whether or not it is sound."""
    other = copy.copy(record)
    object.__setattr__(other, name, value)
    return other


def variants(value: Any) -> Iterator[Any]:
    """The same with one number, word or place of it changed, each in turn; records by all that
    they hold, not by what they say are their fields."""
    if is_dataclass(value):
        for name, part in vars(value).items():
            for other in variants(part):
                yield with_part(value, name, other)
    elif isinstance(value, tuple):
        yield from [value[:-1]] if value else []
        for i, item in enumerate(value):
            for other in variants(item):
                yield (*value[:i], other, *value[i + 1 :])
    elif isinstance(value, dict):
        yield from changed_mappings(value)
    elif isinstance(value, np.ndarray):
        for place in np.ndindex(value.shape):
            other = value.copy()
            other[place] = np.nextafter(value[place], np.inf)
            yield other
        yield from [value[:-1]] if len(value) else []
    else:
        yield changed_scalar(value)


def changed_scalar(value: Any) -> Any:
    """A word or number a little different."""
    if value is None or isinstance(value, str):
        return f"{value}'"
    if isinstance(value, bool):
        return not value
    return value + 1 if isinstance(value, int) else float(np.nextafter(value, np.inf))


def changed_mappings(value: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """The same with one more key, or one of its values changed."""
    for name, part in value.items():
        yield {**value, f"{name}'": part}
        for other in variants(part):
            yield {**value, name: other}


def copied(value: Any) -> Any:
    """What is recalled of a value that was stored."""
    found = pickled(value)
    assert found is not None
    return pickle.loads(found)


@pytest.mark.parametrize("name", ROOTS)
def test_whatever_changes_in_a_record_changes_its_key(name: str) -> None:
    root = ROOTS[name]
    others = [request_key(other) for other in variants(root)]
    assert len({request_key(root), *others}) == 1 + len(others)


def test_every_kind_of_step_is_looked_at() -> None:
    assert {type(step) for step in STEPS} == set(KINDS)


@pytest.mark.parametrize("name", ROOTS)
def test_records_of_the_same_contents_have_one_key(name: str) -> None:
    root = ROOTS[name]
    assert request_key(copy.deepcopy(root)) == request_key(root)
    assert request_key(root) is not None
    assert request_key(copied(root)) == request_key(root)


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(max_size=3),
    lambda inner: st.lists(inner, max_size=3) | st.lists(inner, max_size=3).map(tuple),
    max_leaves=6,
)


@given(VALUES, VALUES)
def test_values_have_one_key_where_they_are_written_alike(first: object, last: object) -> None:
    assert (request_key(first) == request_key(last)) == (repr(first) == repr(last))


def test_things_that_look_alike_are_told_apart() -> None:
    array = np.arange(6.0).reshape(2, 3)
    alike: list[tuple[object, ...]] = [
        (1,),
        (1.0,),
        (True,),
        ("1",),
        (np.float64(1.0),),
        (np.float32(1.0),),
        (np.ones(1),),
        (np.ones((1, 1)),),
        (np.ones(1, dtype=np.int64),),
        (0.0,),
        (-0.0,),
        ("ab", "c"),
        ("a", "bc"),
        (("ab",), "c"),
        ((), ()),
        ((),),
        (),
        ([],),
        (array,),
        (np.asfortranarray(array),),
        (array.reshape(3, 2),),
        (ho.Release(1.0),),
        (ho.Land(1.0),),
    ]
    assert len({request_key(*values) for values in alike}) == len(alike)


@dataclass(frozen=True)
class Foreign:
    """A record that is not the package's."""

    value: float = 1.0


class Bent(ho.ConvexPolygon):
    """One whose methods may be anything."""


def test_records_of_other_classes_and_with_more_than_their_fields_have_other_keys() -> None:
    more = copy.copy(HITCH)
    object.__setattr__(more, "beside", 1.0)
    alike = [HITCH, more, TRIANGLE, Bent(TRIANGLE.vertices), Foreign(), Foreign(2.0)]
    assert len({request_key(value) for value in alike}) == len(alike)


@pytest.mark.parametrize("path", GOOD, ids=lambda path: path.stem)
def test_a_file_that_is_read_twice_gives_one_key(path: Path) -> None:
    assert request_key(ho.read_problem(path)) == request_key(ho.read_problem(path)) is not None


def test_what_cannot_be_pickled_has_no_key() -> None:
    for value in (lambda: 1, memoryview(b""), (i for i in range(2))):
        for place in (value, (1.0, value), ho.HitchStart(typing.cast(Any, value), 1.0)):
            assert request_key(place) is None
            assert pickled(place) is None


@given(
    arrays(np.float64, array_shapes(min_dims=0, max_dims=3, min_side=0), elements=st.floats()),
    st.randoms(use_true_random=False),
)
def test_stored_arrays_are_the_same_and_never_change(array: np.ndarray, random: Any) -> None:
    axes = list(range(array.ndim))
    random.shuffle(axes)
    given_array = array.transpose(axes)
    before = given_array.tobytes()
    (found,) = copied((given_array,))
    assert found.dtype == array.dtype
    assert found.shape == given_array.shape
    if given_array.flags.forc:  # the order in which it lies in memory decides how sums round
        order = (found.flags.c_contiguous, found.flags.f_contiguous)
        assert order == (given_array.flags.c_contiguous, given_array.flags.f_contiguous)
    array[...] = 7.0
    assert found.tobytes() == before
    with pytest.raises(ValueError, match="read-only"):
        found[...] = 0.0
    with pytest.raises(ValueError, match="WRITEABLE"):
        found.setflags(write=True)


def test_what_was_one_stays_one_and_is_counted_once() -> None:
    large = np.zeros((100, 1000))
    once, twice, both = map(pickled, ((large,), (large, large), (large, large.copy())))
    assert once is not None
    assert twice is not None
    assert both is not None
    values = pickle.loads(twice)
    assert values[0] is values[1]
    size, again, two = map(len, (once, twice, both))
    assert large.nbytes < size <= again < 1.1 * large.nbytes
    assert two > 2 * large.nbytes
    situation = copied(ROOTS["Situation"])
    assert situation.hitch.team is situation.team


def arrays_in(value: Any) -> Iterator[np.ndarray]:
    """All arrays that a value holds, however deep."""
    if isinstance(value, np.ndarray):
        yield value
    for part in vars(value).values() if is_dataclass(value) else ():
        yield from arrays_in(part)
    for part in value if isinstance(value, tuple) else ():
        yield from arrays_in(part)


def test_a_stored_record_shares_no_memory_with_the_one_that_was_given() -> None:
    root = ROOTS["Situation"]
    mine, theirs = list(arrays_in(root)), list(arrays_in(copied(root)))
    assert len(mine) == len(theirs) > 5
    for a, b in [*zip(mine, theirs, strict=True), *pairwise(theirs)]:
        assert a is b or not np.shares_memory(a, b)
