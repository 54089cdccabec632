"""Durations do not depend on rounding: noise in the last places of the input changes nothing."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
import pytest
from plans import PROBLEMS

import hitchopt as ho
from hitchopt.mission.loading import any_problem_from_dict
from hitchopt.storage.yaml_file import read_yaml


def noisy(points: Any, rng: np.random.Generator) -> Any:
    """Return lists of coordinates [m] with noise."""
    if isinstance(points, list):
        return [noisy(point, rng) for point in points]
    return points + 1e-14 * float(rng.uniform(-1.0, 1.0))


@pytest.mark.parametrize(
    ("name", "shape"),
    [
        ("transport", "legs of a symmetric triangle are split one way or the mirrored one"),
        ("form_square", "two assignments of robots are as short, and two ways to turn a cable"),
        ("move_edge", "the acceleration jumps where the mesh of a flight looks at it"),
    ],
)
def test_ties_are_settled_by_a_rule(name: str, shape: str) -> None:
    given: Any = read_yaml(PROBLEMS / f"{name}.yaml")
    changed = copy.deepcopy(given)
    rng = np.random.default_rng(1)
    for start in changed["start"].values():
        for key in sorted({"polygon", "q", "r"} & set(start)):
            start[key] = noisy(start[key], rng)
    durations = [ho.solve(any_problem_from_dict(data)).duration for data in (given, changed)]
    assert durations[1] == pytest.approx(durations[0], rel=1e-6), shape
