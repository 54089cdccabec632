"""Plans for the flights of ``benchmarks.flights``, each made for a given friction."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import hitchopt as ho
from hitchopt.mission.loading import problem_from_dict
from hitchopt.mission.problem import Problem
from hitchopt.simulation.flight_task import Task, read_task
from hitchopt.storage.yaml_file import read_yaml

PROBLEMS = Path(__file__).parents[1] / "problems"


@dataclass(frozen=True)
class Experiment:
    """One experiment of the paper, or one of ours.

    Attributes
    ----------
    name: name of its problem file.
    printed: the paper's result, with remarks.
    forms: whether it ties a hitch; the planner then leans no legs, whatever the friction.
    """

    name: str
    printed: str
    forms: bool = False


SAME = "8.2 ± 5.6, 16.8 ± 14.5, 76.2 ± 8.8 cm (the same as for experiment"

EXPERIMENTS = (
    Experiment("paper_experiment_1", "8 of 10 formed", forms=True),
    Experiment("form_square", "formed (one picture)", forms=True),
    Experiment("paper_experiment_2", f"{SAME} 3)"),
    Experiment("paper_experiment_3", f"{SAME} 2)"),
    Experiment(
        "paper_experiment_4",
        "3.6 ± 3.6, 2.6 ± 8.4, 4.3 ± 98.7 cm (printed so: 0.987 and 0.043)",
    ),
    Experiment("triangle", "none: ours"),
)

EDGE, LENGTH = 1.3, 2.2
"""Edge length of the hitches that are tied, and length of their cables [m]."""

MOVED, MOVED_BY, MOVED_IN = 2.4, 0.4, 8.0
"""Cable length [m] of the triangle whose vertex is moved outward, distance [m] and time [s]."""


def experiment(name: str, friction: float | None = None) -> Problem:
    """Return the problem of a name, with the friction of its cables replaced if given."""
    data = read_yaml(PROBLEMS / f"{name}.yaml")
    if not isinstance(data, dict) or not isinstance(team := data["team"], dict):
        raise TypeError(f"{name}: not a problem of a hitch")
    if friction is not None:
        team["cable_friction"] = friction
    return problem_from_dict(data)


def tied(n: int, friction: float = 0.1) -> Problem:
    """Return the problem of a regular hitch of n robots, tied from rows of two on the ground."""
    row, column = np.divmod(np.arange(n), 2)
    q = np.column_stack([1.8 * column - 1.4, 1.5 - 0.9 * row, np.zeros(n)])
    r = q + [1.0, 0.0, 0.0]
    step = {"form": {"polygon": _polygon(n), "altitude": 1.6, "legs": "balanced"}}
    start = {"drones": {"q": q.tolist(), "r": r.tolist()}}
    return problem_from_dict(
        {"team": _team(n, LENGTH, friction), "start": start, "mission": [step]}
    )


def at_rest(n: int) -> Problem:
    """Return the problem of a regular hitch without friction that stands for a second."""
    hitch = {"polygon": _polygon(n), "altitude": 1.6, "legs": "balanced"}
    steps = [{"hold": {"seconds": 1.0}}]
    return problem_from_dict(
        {"team": _team(n, LENGTH, 0.0), "start": {"hitch": hitch}, "mission": steps}
    )


def moved(friction: float, n: int = 3) -> Problem:
    """Return the problem of a regular hitch, one of its vertices moved outward."""
    hitch = {"polygon": _polygon(n), "altitude": 1.0, "legs": "balanced"}
    step = {"vertex": 0, "by": [0.0, MOVED_BY], "duration": MOVED_IN}
    data = {
        "team": _team(n, MOVED, friction),
        "start": {"hitch": hitch},
        "mission": [{"move_vertex": step}],
    }
    return problem_from_dict(data)


def standing_and_moved() -> Problem:
    """Return the problem of a regular triangle whose vertex moves out and back, with long stops.

    Its team has cables without weight and friction.
    """
    hitch = {"polygon": _polygon(3), "altitude": 1.0, "legs": "balanced"}
    out, back = (
        {"move_vertex": {"vertex": 0, "by": [0.0, by], "duration": 8.0}}
        for by in (MOVED_BY, -MOVED_BY)
    )
    stop, end = {"hold": {"seconds": 8.0}}, {"hold": {"seconds": 2.0}}
    data = {
        "team": {**_team(3, MOVED, 0.0), "cable_density": 0.0},
        "start": {"hitch": hitch},
        "mission": [stop, out, stop, back, end],
    }
    return problem_from_dict(data)


def irregular(seed: int, friction: float) -> Task:
    """Return the plan of a random triangle, a random vertex of which is moved by 0.3 m in 6 s.

    It is the first one of the seed that can be planned without friction.
    """
    rng = np.random.default_rng(seed)
    while True:
        polygon = ho.regular_polygon(3, 1.2).vertices + rng.uniform(-0.2, 0.2, (3, 2))
        vertex, angle = int(rng.integers(3)), rng.uniform(0.0, 2.0 * np.pi)
        by = [0.3 * float(np.cos(angle)), 0.3 * float(np.sin(angle))]
        data = {
            "team": _team(3, MOVED, 0.0),
            "start": {"hitch": {"polygon": polygon.tolist(), "altitude": 1.0}},
            "mission": [{"move_vertex": {"vertex": vertex, "by": by, "duration": 6.0}}],
        }
        try:
            ho.solve(problem_from_dict(data))
        except ho.HitchoptError:
            continue
        return planned(problem_from_dict({**data, "team": _team(3, MOVED, friction)}))


def planned(problem: Problem) -> Task:
    """Return the problem's plan, read back from files as any other simulation does."""
    with tempfile.TemporaryDirectory() as place:
        ho.solve(problem).save(place)
        return read_task(Path(place))


def _team(n: int, length: float, friction: float) -> dict[str, object]:
    return {
        "robots": n,
        "cable_length": length,
        "cable_density": 0.01,
        "cable_friction": friction,
        "tension": 0.5,
    }


def _polygon(n: int) -> list[list[float]]:
    """Return a regular polygon's points [m], clockwise from the one farthest up."""
    angle = 0.5 * np.pi - 2.0 * np.pi * np.arange(n) / n
    radius = EDGE / (2.0 * np.sin(np.pi / n))
    points: list[list[float]] = (radius * np.column_stack([np.cos(angle), np.sin(angle)])).tolist()
    return points
