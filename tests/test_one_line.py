"""The ``repr`` of every public record, one line of at most 100 characters; violations in words."""

from __future__ import annotations

import dataclasses
import inspect
import math
import sys
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import hitchopt as ho
from hitchopt.errors import LONGEST, OneLine, broken_limit, short

TRIANGLE = [[0.0, -1.0], [-0.4, 0.5], [0.4, 0.5]]
ARRAYS = [np.zeros((4, 3)), np.arange(5000.0), np.zeros(0), np.float64(2.5), object()]
PLAIN = st.none() | st.floats() | st.text(max_size=300) | st.sampled_from(ARRAYS)
VALUES = PLAIN | st.lists(PLAIN, max_size=12) | st.lists(st.lists(PLAIN, max_size=3), max_size=12)


@given(st.lists(VALUES, max_size=8))
@settings(max_examples=15)
def test_every_public_record_is_written_on_one_line_whatever_its_values(values: list[Any]) -> None:
    public = [getattr(ho, name) for name in ho.__all__]
    records = [x for x in public if inspect.isclass(x) and not issubclass(x, BaseException)]
    assert records
    assert all(getattr(kind, "__repr__") is OneLine.__repr__ for kind in records)  # noqa: B009
    names = [f"field_{i}" for i in range(len(values))]
    text = repr(dataclasses.make_dataclass("Record", names, bases=(OneLine,))(*values))
    assert len(text) <= LONGEST
    assert len(text.splitlines()) == 1
    assert text.startswith("Record(")


def test_records_are_written_in_their_own_words() -> None:
    start = ho.Hitch(ho.Team(3, 2.4), TRIANGLE, 1.0, [0.3, 0.8, 0.25])
    plan = ho.hold(start, 2.0)
    polygon = "[[0, -1], [-0.4, 0.5], [0.4, 0.5]]"
    for record, words in (
        (ho.Limits(), "Limits()"),
        (ho.Limits(speed=0.8), "Limits(speed=0.8)"),
        (ho.ConvexPolygon(TRIANGLE), f"ConvexPolygon(vertices={polygon})"),
        (plan, "Plan(6 drones, 2 s, phases: 1, 17 of 17 checks hold)"),
        (start, "Hitch(3 robots, closed, altitude=1, q_legs=[0.3, 0.8, 0.25], roll=0)"),
    ):
        assert repr(record) == words
    assert (short(np.full(600, 2.4)), short(np.zeros((600, 3)))) == ("2.4", "array(600, 3)")
    assert short([[1.0] * 30] * 20) == "<20 entries>"
    error = ho.InputError("key", "value\n" * 50, "bound", "remedy " * 50)
    assert repr(error).startswith('InputError("key = ')
    states = plan.at([0.0, 1.0])
    parts = (plan.phases[0], ho.closest(plan), plan.certificate, plan.certificate["speed"])
    for part in (error, plan.motion, plan.motion.drones, states, *parts):
        assert len(repr(part)) <= LONGEST


@pytest.mark.parametrize(
    ("limit", "words"),
    [
        (("grip", -math.inf, 1.5, "min", "1", ("drum",)), "-inf is below the limit of 1.5 at drum"),
        (("grip", -sys.float_info.max, 1.5, "min", "1", ()), "-inf is below the limit of 1.5"),
        (
            ("speed", 1.0 + 1e-11, 1.0, "max", "m/s", ()),
            "1.00000000001 m/s is above the limit of 1 m/s",
        ),
    ],
)
def test_values_just_beyond_a_limit_differ_from_it_in_words(limit: Any, words: str) -> None:
    """What contradicts itself is infinitely far off."""
    assert broken_limit(*limit) == f"{limit[0]}: {words}"
