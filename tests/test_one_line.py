"""The ``repr`` of every public record: one line of at most 100 characters, whatever it holds."""

from __future__ import annotations

import dataclasses
import inspect

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

import hitchopt as ho
from hitchopt.errors import LONGEST, OneLine, short

TRIANGLE = [[0.0, -1.0], [-0.4, 0.5], [0.4, 0.5]]
RECORDS = [
    value
    for name in ho.__all__
    if inspect.isclass(value := getattr(ho, name)) and not issubclass(value, BaseException)
]


def test_every_public_record_is_written_on_one_line() -> None:
    other = [kind for kind in RECORDS if getattr(kind, "__repr__") is not OneLine.__repr__]  # noqa: B009
    assert other == []


VALUES = st.recursive(
    st.none()
    | st.booleans()
    | st.floats()
    | st.text(max_size=300)
    | st.sampled_from(
        [np.zeros((4, 3)), np.arange(5000.0), np.zeros(0), np.float64(2.5), object()]
    ),
    lambda inner: st.lists(inner, max_size=12) | st.lists(inner, max_size=12).map(tuple),
)


@given(st.lists(VALUES, max_size=8))
@settings(max_examples=30)
def test_no_value_makes_it_longer(values: list[object]) -> None:
    names = [f"field_{i}" for i in range(len(values))]
    kind = dataclasses.make_dataclass("Record", names, bases=(OneLine,))
    text = repr(kind(*values))
    assert len(text) <= LONGEST
    assert len(text.splitlines()) == 1
    assert text.startswith("Record(")


def test_fields_that_differ_from_their_defaults_are_written() -> None:
    assert repr(ho.Limits()) == "Limits()"
    assert repr(ho.Limits(speed=0.8)) == "Limits(speed=0.8)"
    assert repr(ho.ConvexPolygon(TRIANGLE)) == (
        "ConvexPolygon(vertices=[[0, -1], [-0.4, 0.5], [0.4, 0.5]])"
    )
    assert short(np.full(600, 2.4)) == "2.4"
    assert short(np.zeros((600, 3))) == "array(600, 3)"


def test_a_plan_says_what_it_is() -> None:
    team = ho.Team(3, 2.4)
    start = ho.Hitch(team, TRIANGLE, 1.0, [0.3, 0.8, 0.25])
    plan = ho.hold(start, 2.0)
    assert repr(plan) == "Plan(6 drones, 2 s, phases: 1, 17 of 17 checks hold)"
    words = "3 robots, closed, altitude=1, q_legs=[0.3, 0.8, 0.25], roll=0"
    assert repr(start) == f"Hitch({words})"
    assert repr(plan.certificate) == "Certificate(certified, 17 checks, 2 s)"
    assert repr(plan.certificate["speed"]) == "Check(speed: 0 ≤ 1 m/s, holds, t = 0 s, at q0)"
    parts = [plan.motion, plan.motion.drones, plan.at([0.0, 1.0]), plan.phases[0], ho.closest(plan)]
    for part in parts:
        assert len(repr(part)) <= LONGEST


def test_errors_are_written_on_one_line_too() -> None:
    error = ho.InputError("key", "value\n" * 50, "bound", "remedy " * 50)
    assert len(repr(error)) <= LONGEST
    assert repr(error).startswith('InputError("key = ')
