"""What has been planned is not planned again, and nobody can tell from what comes of it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import is_dataclass, replace
from typing import Any

import numpy as np
import pytest

import hitchopt as ho
from hitchopt.mission.solving import contents

TRIANGLE = [[0.0, -1.0], [-0.4, 0.5], [0.4, 0.5]]
PULLED_IN = [[0.0, -0.5], [-0.4, 0.5], [0.4, 0.5]]
TEAM = ho.Team(robots=3, cable_length=2.4)
KNOWN = "planned before, taken from memory"


def mission(last: float = 0.3, limits: ho.Limits | None = None) -> ho.Problem:
    """Five steps of the paper's triangle, two of them blended, the last one by so much."""
    goal = ho.ConvexPolygon(PULLED_IN)
    steps = (
        ho.Morph(goal),
        ho.Hold(1.0),
        ho.MoveVertex(0, by=np.array([0.1, 0.0]), blend=True),
        ho.MoveVertex(1, by=np.array([0.0, 0.1])),
        ho.Transport(np.array([last, 0.2, 1.1]), 0.2),
    )
    start = ho.HitchStart(ho.ConvexPolygon(TRIANGLE), 1.0)
    return ho.Problem(TEAM, start, steps, limits or ho.Limits())


def arrays_in(value: Any) -> Iterator[np.ndarray]:
    """All arrays that a plan holds."""
    if isinstance(value, np.ndarray):
        yield value
    for part in vars(value).values() if is_dataclass(value) else ():
        yield from arrays_in(part)
    for part in value if isinstance(value, tuple) else ():
        yield from arrays_in(part)


def test_nothing_can_be_written_into_a_plan() -> None:
    plan = ho.hold(ho.Hitch.spread(TEAM, TRIANGLE), 1.0)
    found = [array for array in arrays_in(plan) if array.size]
    assert len(found) > 5
    for array in found:
        for place in ((0,) * array.ndim, (-1,) * array.ndim):
            with pytest.raises(ValueError, match="read-only"):
                array[place] = 7.0


def test_after_an_edit_only_what_it_changes_is_planned() -> None:
    def known(problem: ho.Problem) -> tuple[ho.Plan, list[bool]]:  # of its four motions
        heard: list[str] = []
        plan = ho.solve(problem, heard.append)
        told = [word for word in heard if word == KNOWN or word.startswith("certifying step")]
        return plan, [word == KNOWN for word in told]

    first, told = known(mission(0.3))
    assert told == [False] * 4
    assert known(mission(0.4))[1] == [True, True, True, False]
    assert known(replace(mission(0.4), title="renamed"))[1] == [True] * 4
    assert known(mission(0.4, ho.Limits(speed=0.99)))[1] == [False] * 4
    again, told = known(mission(0.3))
    assert told == [True] * 4
    ho.forget()
    anew, told = known(mission(0.3))
    assert told == [False] * 4
    held = [[array.tobytes() for array in arrays_in(plan)] for plan in (first, again, anew)]
    assert held[0] == held[1] == held[2]


def test_requests_of_other_contents_are_told_apart() -> None:
    array = np.arange(6.0).reshape(2, 3)
    alike = [1, 1.0, True, "1", (1,), [1], np.float32(1.0), 0.0, -0.0, np.nextafter(1.0, 2.0)]
    alike += [array, array.reshape(3, 2), np.asfortranarray(array), ho.Release(1.0), ho.Land(1.0)]
    assert len({repr(contents(value)) for value in [*alike, *alike]}) == len(alike)
