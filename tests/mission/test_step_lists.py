"""Steps and starts as records of plain lists: what a Problem makes of them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import hitchopt as ho

TRIANGLE: Any = [[0.0, 0.58], [0.5, -0.29], [-0.5, -0.29]]
ARC: Any = [[0.0, 0.0], [0.8, 1.2], [2.2, 1.3], [3.0, 0.0]]
Q: Any = [[-0.5, 1, 0], [-0.5, 0, 0], [-0.5, -1, 0]]
R: Any = [[0.5, 1, 0], [0.5, 0, 0], [0.5, -1, 0]]
LEGS: Any = [0.7, 0.72, 0.68]
WORD: Any = "even"
RAGGED: Any = [[1], [1, 2]]
TEAM = ho.Team(3, 2.4)
CHAIN = ho.Team(3, 2.4, topology="open")


def _problem(start: Any, step: Any) -> ho.Problem:
    return ho.Problem(TEAM, start, (step,))


@pytest.mark.parametrize(
    ("team", "points", "kind"), [(TEAM, TRIANGLE, ho.ConvexPolygon), (CHAIN, ARC, ho.ConvexArc)]
)
def test_points_become_outlines_of_the_teams_topology(
    team: ho.Team, points: Any, kind: type[object]
) -> None:
    begun = ho.Problem(team, ho.HitchStart(points, 1.2), (ho.Morph(points), ho.Adjust("balanced")))
    formed = ho.Problem(team, ho.DronesStart(Q, R), (ho.Form(points, 1.2),))
    first, last = begun.mission[0], formed.mission[0]
    assert isinstance(begun.start, ho.HitchStart)
    assert isinstance(first, ho.Morph)
    assert isinstance(last, ho.Form)
    for outline in (begun.start.polygon, first.polygon, last.polygon):
        assert isinstance(outline, kind)
        np.testing.assert_array_equal(outline.vertices, points)


@pytest.mark.parametrize(
    ("make", "key"),
    [
        (lambda: (ho.DronesStart(Q, R), ho.Form(TRIANGLE[::-1])), "mission[0].form.polygon"),
        (lambda: (ho.DronesStart(Q, R), ho.Form(TRIANGLE[:2])), "mission[0].form.polygon"),
        (lambda: (ho.DronesStart(Q, R), ho.Form(ARC)), "mission[0].form.polygon"),
        (lambda: (ho.DronesStart(Q, R), ho.Form(WORD)), "mission[0].form.polygon"),
        (lambda: (ho.DronesStart(Q, R), ho.Form(TRIANGLE, legs=LEGS[:2])), "mission[0].form.legs"),
        (lambda: (ho.HitchStart(TRIANGLE, 1.2), ho.Adjust(WORD)), "mission[0].adjust.legs"),
        (lambda: (ho.HitchStart(TRIANGLE, 1.2), ho.Morph(RAGGED)), "mission[0].morph.polygon"),
        (lambda: (ho.HitchStart(RAGGED, 1.2), ho.Hold(1.0)), "start.hitch.polygon"),
        (lambda: (ho.HitchStart(TRIANGLE, 1.2, WORD), ho.Hold(1.0)), "start.hitch.legs"),
        (lambda: (ho.DronesStart(RAGGED, R), ho.Land()), "q"),
        (lambda: (ho.DronesStart(Q, WORD), ho.Land()), "r"),
    ],
)
def test_lists_that_are_no_outline_are_refused_with_their_key(
    make: Callable[[], tuple[Any, Any]], key: str
) -> None:
    with pytest.raises(ho.InputError) as caught:
        _problem(*make())
    assert caught.value.key == key
