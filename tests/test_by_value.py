"""Records that are written compare by value: problems, their parts, and steps."""

from __future__ import annotations

import copy
import dataclasses
import inspect
import json
import pickle
from importlib import import_module
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import hitchopt as ho
from hitchopt.drones.controllers import Gains
from hitchopt.forming.swap_settings import SwapSettings
from hitchopt.hitch.requirements import Requirements
from hitchopt.hitch.team import Assignment
from hitchopt.mission.others import Other
from hitchopt.motion.request import decoded, encoded
from hitchopt.planners.ends import RolledLegs
from hitchopt.slices import by_module
from hitchopt.steps import STEP_KINDS
from hitchopt.steps.moving import Hold, Morph, MoveStep
from hitchopt.steps.step import Step
from hitchopt.trajectory.enclosed import Enclosed
from hitchopt.values import ByValue
from hitchopt.values.fields import EMPTY, keys_of

ROOMS = ho.ROOM_NAMES | by_module("room_names")  # Names by their modules

TRIANGLE = [[0.0, 0.6], [0.5, -0.3], [-0.5, -0.3]]
ARC = [[-1.2, 0.1], [-0.4, 0.9], [0.4, 0.9], [1.2, 0.1]]
Q = [[-0.6, 1.2, 1.5], [-0.6, 0.0, 1.5], [-0.6, -1.2, 1.5]]
R = [[0.6, 1.2, 1.5], [0.6, 0.0, 1.5], [0.6, -1.2, 1.5]]


def examples() -> list[Any]:
    """Make records anew, one of every type at least."""
    unequal = {"tension": [0.4, 0.5, 0.6], "load": [0.01, 0.0, 0.02], "cable_density": 0.005}
    team = ho.Team(3, [2.4, 2.5, 2.6], quadrotor=["paper_132g", *[ho.Quadrotor()] * 2], **unequal)  # type: ignore[arg-type]
    rim = ho.Rim(ho.Section(TRIANGLE), 0.2)
    box = ho.SolidObject(ho.Section([[-0.2, 0.1], [0.2, 0.1], [0.2, -0.1], [-0.2, -0.1]]), rim=rim)
    arena, limits = ho.Arena([-3, -3, 0], [3, 3, 3]), ho.Limits(speed=0.8, tilt_deg=40.0)
    prism = ho.Prism([[2, 2], [2, 3], [3, 2]], 0.0, 2.0)
    start = ho.Hitch(ho.Team(3, 2.4), TRIANGLE, 1.5, [0.6, 0.7, 0.65], roll=0.05)
    required: dict[str, Any] = {"limits": limits, "arena": arena, "objects": {"box": box}}
    steps = [Morph(ho.ConvexPolygon([[0.0, 0.7], *TRIANGLE[1:]])), Hold(1.0)]
    swarm = ho.Swarm(2, quadrotor="crazyflie_2.1")
    return [
        *(team, ho.Team(3, 2.0, topology="open"), swarm),
        *(start, ho.ConvexPolygon(TRIANGLE), ho.ConvexArc(ARC)),
        *(limits, ho.Tube(0.08, 0.2), ho.Separation(0.2), arena, prism),
        Requirements(keep_out=(prism,), **required),
        *(rim, box, box.section, ho.Section(radius=0.2)),
        *(ho.HitchStart(ho.ConvexPolygon(TRIANGLE), 1.2, [0.3, 0.4, 0.5]), ho.DronesStart(Q, R)),
        ho.Problem(start.team, start, steps, title="Two steps", **required),
        ho.Problem(start.team, start, [ho.Morph(TRIANGLE, [0.6, 0.6, 0.7])], **required),
        ho.Problem(swarm, [[0, 0, 1], [1, 0, 1]], [ho.Fly(np.array([[0, 1, 1], [1, 1, 1]]))]),
        *(SwapSettings(0.2), RolledLegs("spread", np.array([0.1, 0.2, 0.1]))),
        *(Assignment((1, 0), (True, False)), ho.Quadrotor(0.1, 2.0), Gains(kp=(1.0, 2.0))),
        *(map(example_of, STEP_KINDS.values())),
        example_of(ho.Fly),
        ho.Rule("height", "m", "max", 2.0, ho.DroneSpans, height),
    ]


def height(spans: ho.DroneSpans) -> Enclosed:
    """Return the height of drones [m], for a rule."""
    return spans.position[2]


def example_of(kind: type[Step]) -> Step:
    """Return an example of a kind of step."""
    values = {k: key.example for k, key in keys_of(kind).items() if key.default is EMPTY}
    return kind(**values, **({"by": [0.0, 0.1]} if issubclass(kind, MoveStep) else {}))


EXAMPLES = examples()
IDS = [f"{i}-{type(each).__name__}" for i, each in enumerate(EXAMPLES)]


@pytest.mark.parametrize("i", range(len(EXAMPLES)), ids=IDS)
def test_equal_records_are_equal_and_have_equal_hashes(i: int) -> None:
    record = EXAMPLES[i]
    for same in (examples()[i], copy.deepcopy(record), pickle.loads(pickle.dumps(record))):
        assert same is not record
        assert same == record
        assert hash(same) == hash(record)
    others = [each for k, each in enumerate(EXAMPLES) if k != i]
    assert record not in others
    assert {*EXAMPLES, *examples()} == {*EXAMPLES}
    assert record != np.zeros(3).tolist()
    assert record != "record"
    assert record is not None


def changed(value: Any) -> Any:
    """Return another value of the same form."""
    other: Any = f"{value} changed"
    if isinstance(value, bool):
        other = not value
    elif isinstance(value, int | float):
        other = value + 1
    elif isinstance(value, np.ndarray):
        other = np.concatenate([value[:-1], value[-1:] + 1e-9]) if len(value) else np.ones(1)
    elif isinstance(value, tuple) and value:
        other = (*value[:-1], changed(value[-1]))
    elif isinstance(value, dict) and value:
        other = {name: changed(each) for name, each in value.items()}
    elif dataclasses.is_dataclass(value):
        first = dataclasses.fields(value)[0].name
        other = with_attribute(value, first, changed(getattr(value, first)))
    return other


def with_attribute(record: Any, name: str, value: Any) -> Any:
    """Return a copy of a record with another value, unchecked."""
    other = copy.copy(record)
    object.__setattr__(other, name, value)
    return other


@pytest.mark.parametrize("record", EXAMPLES, ids=IDS)
def test_every_argument_counts(record: Any) -> None:
    for each in dataclasses.fields(record):
        if each.init:
            value = changed(getattr(record, each.name))
            assert with_attribute(record, each.name, value) != record, each.name


STORED = (ho.Team, ho.Limits, ho.Separation, ho.Quadrotor, ho.Arena, ho.Prism, ho.SolidObject)


@pytest.mark.parametrize("record", [x for x in EXAMPLES if type(x) in STORED], ids=str)
def test_records_of_plan_files_are_read_back_as_they_were(record: Any) -> None:
    assert decoded(type(record), json.loads(json.dumps(encoded(record)))) == record


def test_a_problem_equals_the_one_that_its_file_says() -> None:
    data: dict[str, Any] = {
        "team": {"robots": 3, "cable_length": 2.4, "quadrotor": "paper_132g"},
        "start": {"hitch": {"polygon": TRIANGLE, "altitude": 1.5}},
        "mission": [{"morph": {"polygon": [[0.0, 0.7], *TRIANGLE[1:]]}}, {"hold": {"seconds": 1}}],
        "objects": {"drum": {"circle": 0.2, "at": [2, 0, 0]}},
    }
    problem = ho.problem_from_dict(data)
    assert problem == ho.problem_from_dict(copy.deepcopy(data))
    team = ho.Team(3, 2.4, quadrotor="paper_132g")
    start = ho.HitchStart(ho.ConvexPolygon(TRIANGLE), 1.5)
    drum = ho.SolidObject(ho.Section(radius=0.2), at=(2.0, 0.0, 0.0))
    steps = [ho.Morph([[0.0, 0.7], *TRIANGLE[1:]]), ho.Hold(1.0)]
    assert problem == ho.Problem(team, start, steps, objects={"drum": drum})
    data["mission"][1]["hold"]["seconds"] = 2
    assert problem != ho.problem_from_dict(data)


numbers = st.floats(0.5, 5.0) | st.sampled_from([1.0, 2.0])


@given(numbers, numbers, st.lists(numbers, min_size=3, max_size=3))
def test_teams_are_equal_where_their_numbers_are(a: float, b: float, lengths: list[float]) -> None:
    assert (ho.Team(3, a) == ho.Team(3, b)) == (a == b)
    assert (ho.Team(3, [a, a, b]) == ho.Team(3, lengths)) == ([a, a, b] == lengths)
    assert ho.Team(3, tuple(lengths)) == ho.Team(3, np.array(lengths))
    assert ho.Team(3, [a] * 3) == ho.Team(3, a)
    assert len({ho.Team(3, x) for x in (a, b, *lengths)}) == len({a, b, *lengths})


def test_zeros_of_both_signs_are_equal() -> None:
    zero, negative = (ho.SolidObject(ho.Section(radius=0.1), at=[x, 1, 0]) for x in (0.0, -0.0))
    assert zero == negative
    assert hash(zero) == hash(negative)


RESULTS = frozenset(
    (
        *("Alignment", "Calibration", "Change", "Evaluation", "Fit", "Grip", "Holding"),
        *("Flight", "Motion", "TeamMotion"),
        *("PiecewisePolynomial", "Plan", "RecordedFlight", "Recording", "Retarget", "Setpoints"),
        *("Path", "Equilibrium", "Signal", "States", "Suggestion", "Tolerance", "Track"),
    )
)
"""Public records that compare by identity: plans and what is computed or measured."""


def test_all_other_public_records_compare_by_value() -> None:
    in_rooms = [(f"hitchopt.{room}", name) for room, names in ROOMS.items() for name in names]
    places = [*(("hitchopt", name) for name in ho.__all__), *in_rooms]
    public = {name: getattr(import_module(module), name) for module, name in places}
    records = {name: each for name, each in public.items() if inspect.isclass(each)}
    for name, record in records.items():
        if dataclasses.is_dataclass(record):
            by_value = issubclass(record, ByValue) or record.__eq__ is not object.__eq__
            assert by_value == (name not in RESULTS), name
    seen = {type(each) for each in EXAMPLES}
    assert {x for x in records.values() if issubclass(x, ByValue)} <= {*seen, Other}
