"""How many infeasible problems of different kinds get a verified suggestion, and how soon.

Usage: python -m benchmarks.repairs

Each problem is a good one with one thing of it broken; what was broken need not be what is
suggested. A suggestion counts after its edits have been written into the problem's mapping and
that has been planned anew.
"""

from __future__ import annotations

import copy
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import hitchopt as ho
from benchmarks.environment import print_environment
from benchmarks.problem_edits import edited, put
from hitchopt.mission.loading import problem_from_dict
from hitchopt.storage.yaml_file import read_yaml

PROBLEMS = Path(__file__).parents[1] / "problems"

BREAKS: tuple[tuple[str, str, object], ...] = (
    ("triangle", "team.cable_length", 1.5),
    ("triangle", "team.cable_length", 1.9),
    ("triangle", "team.cable_length", [1.7, 2.4, 2.4]),
    ("hexagon", "team.cable_length", 1.4),
    ("open_chain", "team.cable_length", 1.1),
    ("unequal_cables", "team.cable_length", [1.3, 1.8, 2.1, 1.35, 2.0]),
    ("triangle", "arena", {"lower": [-1, -2, 0], "upper": [1, 1.2, 3]}),
    ("triangle", "arena", {"lower": [-0.9, -1.2, 0], "upper": [0.9, 0.9, 3]}),
    ("transport", "arena", {"lower": [-1, -2, 0], "upper": [1.2, 2, 3]}),
    ("hexagon", "arena", {"lower": [-4, -4, 1.2], "upper": [4, 4, 3]}),
    ("triangle", "team.quadrotor", {"mass": 0.132, "max_thrust": 1.2}),
    ("pentagon", "team.quadrotor", {"mass": 0.25, "max_thrust": 2.4}),
    ("triangle", "mission[0].morph.duration", 0.4),
    ("triangle", "mission[0].morph.duration", 1.2),
    ("move_vertex", "mission[0].move_vertex.duration", 0.3),
    ("move_edge", "mission[0].move_edge.duration", 0.3),
    ("transport", "mission[0].transport.duration", 0.5),
    ("triangle", "limits.duration", 1.5),
    ("pentagon", "limits.duration", 0.8),
    ("triangle", "team.tension", 3.5),
    ("hexagon", "team.tension", 2.4),
    ("unequal_cables", "team.tension", [0.4, 3.0, 0.4, 0.5, 0.4]),
    ("triangle", "limits.tilt_deg", 10),
    ("hexagon", "limits.tilt_deg", 16),
    ("triangle", "limits.leg", 0.45),
    ("open_chain", "limits.leg", 0.6),
    ("triangle", "start.hitch.legs", [0.8, 0.1, 0.4]),
    ("triangle", "mission[0].morph.legs", [1.2, 0.4, 0.9]),
    ("triangle", "separation.radius", 0.3),
    ("triangle", "mission[0]", {"follow_vertex": {"vertex": 0, "path": [[0.7, 0, -0.5]]}}),
)
"""Problem, key, value: what is wrong with each of them."""


@dataclass(frozen=True)
class Row:
    """What became of one problem.

    Attributes
    ----------
    mended: by a suggestion whose edits were planned anew.
    text: row of the table.
    """

    mended: bool
    text: str


def broken_problem(stem: str, key: str, value: object) -> dict[str, Any]:
    """Return the mapping of a good problem with one value broken."""
    data: Any = copy.deepcopy(read_yaml(PROBLEMS / f"{stem}.yaml"))
    put(data, key, value)
    return dict(data)


def measure(stem: str, key: str, value: object) -> Row:
    """Return what becomes of one broken problem."""
    name = f"{stem:15s} {key:32s}"
    data = broken_problem(stem, key, value)
    problem = problem_from_dict(data)
    try:
        ho.solve(problem)
    except ho.InfeasibleError as error:
        binds = error.violations[0].constraint
    else:
        raise SystemExit(f"{name}: is not infeasible, so it belongs not here")
    began = time.perf_counter()
    found = ho.suggestions(problem)
    seconds = time.perf_counter() - began
    if not found:
        return Row(False, f"{name} {binds:16s} {seconds:6.1f}  nothing")
    ho.solve(problem_from_dict(edited(data, found[0].change.edits)))
    return Row(True, f"{name} {binds:16s} {seconds:6.1f}  {found[0].change}")


def main() -> None:
    """Print machine, versions, limitations, a row for every problem, and how many were mended."""
    print_environment("one run each, in one process; the smallest suggestion shown; 15 s of search")
    print(f"{'problem':15s} {'what was broken':32s} {'binds first':16s}   [s]  suggestion")
    mended = 0
    for stem, key, value in BREAKS:
        row = measure(stem, key, value)
        mended += row.mended
        print(row.text, flush=True)
    print(f"{mended} of {len(BREAKS)} mended")


if __name__ == "__main__":
    main()
