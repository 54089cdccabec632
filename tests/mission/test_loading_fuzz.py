"""Whatever is done to a good problem, the answer is a problem or a told error."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from problem_cases import VALIDATOR, hitch_start, triangle

import hitchopt as ho
from hitchopt.errors import HitchoptError, InputError
from hitchopt.mission.loading import problem_from_dict

pytestmark = pytest.mark.filterwarnings("ignore::hitchopt.UnitWarning")


def paths_of(data: Any, path: tuple[str | int, ...] = ()) -> Iterator[tuple[str | int, ...]]:
    for key, value in data.items() if isinstance(data, dict) else enumerate(data):
        yield (*path, key)
        if isinstance(value, dict | list):
            yield from paths_of(value, (*path, key))


ODD = [0, -0.0, 1e308, 5e-324, math.pi, 10**5000, "", "spread", "open", "1", b"x", object()]
KEYS = ["morph", "hold", "land", "mass", "q", "hitch", "seconds", "é\n"]
inner: st.SearchStrategy[Any] = st.none() | st.floats() | st.just({}) | st.just({"seconds": 1})
values = st.one_of(
    *(st.none(), st.booleans(), st.integers(), st.integers(-3, 12), st.floats(), st.floats(-3, 3)),
    *(st.integers(10**300, 10**310), st.sampled_from(ODD), st.text(max_size=8)),
    st.lists(st.floats() | st.integers(-3, 3), max_size=4),
    st.lists(st.lists(st.floats(-3, 3), min_size=2, max_size=2), min_size=3, max_size=5),
    st.dictionaries(st.sampled_from(KEYS), inner, max_size=2),
    st.just(np.ones((3, 2))),
)

ACTIONS = ["set", "drop", "add", "twice"]
mutation = st.tuples(st.sampled_from(list(paths_of(triangle()))), st.sampled_from(ACTIONS), values)


def mutated(changes: list[tuple[tuple[str | int, ...], str, Any]]) -> dict[str, Any]:
    data: Any = triangle()
    for path, action, value in changes:
        place = data
        with contextlib.suppress(LookupError, TypeError, ValueError):  # removed by now
            for part in path[:-1]:
                place = place[part]
            if action == "set":
                place[path[-1]] = value
            elif action == "drop":
                del place[path[-1]]
            elif action == "add" and isinstance(place, dict):
                place[f"{path[-1]}s"] = value
            elif isinstance(place, list):
                place.append(place[-1] if action == "twice" else value)
    return dict(data)


@given(st.lists(mutation, min_size=1, max_size=3))
@settings(max_examples=150, suppress_health_check=[HealthCheck.too_slow])
def test_a_changed_problem_is_valid_by_the_schema_or_a_told_error(changes: Any) -> None:
    data = mutated(changes)
    try:
        answer: ho.Problem | HitchoptError = problem_from_dict(data)
    except HitchoptError as error:
        answer = error
    if isinstance(answer, ho.Problem):
        assert len(hitch_start(answer).polygon) == answer.team.robots
        assert np.all(np.isfinite(hitch_start(answer).polygon.vertices))
        VALIDATOR.validate(_listed(data))
    elif isinstance(answer, InputError):
        assert answer.key
        assert answer.remedy
    assert len(str(answer)) < 20_000
    str(answer).encode("utf-8")  # a terminal can show it


def _listed(data: Any) -> Any:
    if isinstance(data, dict):
        return {key: _listed(value) for key, value in data.items()}
    if isinstance(data, list):
        return [_listed(value) for value in data]
    return data.tolist() if isinstance(data, np.ndarray) else data
