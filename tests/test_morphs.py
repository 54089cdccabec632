"""Many morphs at once are those planned one by one, in order."""

from __future__ import annotations

import numpy as np
import pytest

import hitchopt as ho
from hitchopt.api import _morph_or_error

TEAM = ho.Team(robots=3, cable_length=2.4)
START = ho.Hitch.spread(TEAM, [[0, -1], [-0.4, 0.5], [0.4, 0.5]], altitude=1.2)
GOALS: list[list[list[float]]] = [[[0, -0.7 - 0.1 * k], [-0.4, 0.5], [0.4, 0.5]] for k in range(3)]
FAR: list[list[float]] = [[0, -7], [-3.0, 5.0], [3.0, 5.0]]


def test_many_morphs_are_those_planned_one_by_one_in_order() -> None:
    said = list[str]()
    pairs = [(START, GOALS[0]), (START, FAR), (START, GOALS[1])]
    first, none, last = ho.morphs(
        pairs, workers=2, progress=said.append, limits=ho.Limits(speed=0.8)
    )
    for found, goal in ((first, GOALS[0]), (last, GOALS[1])):
        assert isinstance(found, ho.Plan)
        alone = ho.morph(START, goal, limits=ho.Limits(speed=0.8))
        assert found.duration == alone.duration
        np.testing.assert_array_equal(
            found.motion.drones.coefficients, alone.motion.drones.coefficients
        )
        assert found.certificate.certified
    assert isinstance(none, ho.InfeasibleError)
    assert said == [f"planning morphs, {k} of 3" for k in (1, 2, 3)]
    assert ho.morphs([]) == []


def test_errors_bring_no_tracebacks_and_earlier_errors_along() -> None:
    """Where packages extend pickle, these are pickled, too, which exceeds the recursion limit."""
    error = _morph_or_error(START, FAR, {})
    assert isinstance(error, ho.InfeasibleError)
    assert (error.__traceback__, error.__context__, error.__cause__) == (None, None, None)


def test_invalid_arguments_are_refused() -> None:
    with pytest.raises(ho.InputError, match="polygon"):
        ho.morphs([(START, [[0, 0], [1, 1]])], workers=1)
    with pytest.raises(ho.InputError, match="workers = 0"):
        ho.morphs([], workers=0)
    for pair in (START, (START,), (START, GOALS[0], 1.0), "ab"):
        with pytest.raises(
            ho.InputError, match=r"pairs\[1\] = .*: must be a pair of a hitch and a"
        ):
            ho.morphs([(START, GOALS[0]), pair])  # type: ignore[list-item]
