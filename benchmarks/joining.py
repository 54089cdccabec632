"""Hitches that are laid, joined, left, or that change a robot, flown with simulated ropes.

Usage: python -m benchmarks joining [MISSION ...] [--runs N] [--seed S]

Each mission ends with a rest of 3 s. Flights are perturbed, with consecutive seeds, in the fast
preset, at a friction of 0.1 that plans know.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

import hitchopt as ho
from benchmarks.flights import centimetres, success
from benchmarks.measuring import PROBLEMS, Table, parser, timed
from hitchopt.lab.simulation.judgement import closest

LIMITATIONS = (
    "fast preset; ropes of 10 g/m and 12 mm; the last ring is judged, others by touches; "
    "perturbed: noise of 1 cm and 3 cm/s, 0.05 N each of gusts and of steady wind, downwash, "
    "cables 0.5 % off, starts 2 cm off; processor time of planning with the certificate's"
)

FRICTION, REST = 0.1, 3.0
"""Friction of cables, and duration of the rest at the end of a mission [s]."""


def pentagon() -> ho.Problem:
    """Return the problem of a pentagon, a hexagon with an uncut corner, and a sixth robot."""
    hexagon = ho.regular_polygon(6, 0.8).vertices
    points = np.concatenate([[2.0 * hexagon[0] - hexagon[5]], hexagon[2:]])
    lengths = np.array([2.6, 1.5, 1.5, 1.5, 2.3, 1.6])
    row, flat = 2.0 - np.arange(6.0), np.zeros(6)
    q = np.column_stack([-0.45 * lengths, row, flat])
    q[5] = [-3.0, -0.45 * lengths[5], 0.0]
    r = q * [-1.0, 1.0, 1.0]
    r[5] = q[5] * [1.0, -1.0, 1.0]
    form = {"polygon": points.round(6).tolist(), "altitude": 1.6, "robots": [0, 1, 2, 3, 4]}
    data: dict[str, Any] = {
        "team": {
            "robots": 6, "cable_length": lengths.tolist(), "cable_density": 0.01, "tension": 0.7
        },
        "start": {"drones": {"q": q.tolist(), "r": r.tolist()}},
        "mission": [
            {"form": form}, {"join": {"robot": 5, "vertex": 0, "cut": 0.8}},
            {"hold": {"seconds": 1.0}}, {"withdraw": {"robot": 5}},
        ],
    }  # fmt: skip
    return ho.problem_from_dict(data)


MISSIONS = {
    "triangle, laid": ("lay_triangle", 1),
    "hexagon, laid": ("lay_hexagon", 1),
    "twelve-gon, laid": ("lay_twelve", 1),
    "triangle, a fourth joins": ("join_a_fourth", 2),
    "triangle, a fourth joins and leaves": ("join_a_fourth", 4),
    "square, one is replaced": ("replace_in_flight", 2),
    "pentagon, a sixth joins": ("", 2),
    "pentagon, a sixth joins and leaves": ("", 4),
}
"""Problem file, if there is one, and number of its steps."""


def mission(name: str) -> ho.Problem:
    """Return the problem of a mission."""
    file, steps = MISSIONS[name]
    problem = ho.load_problem(PROBLEMS / f"{file}.yaml") if file else pentagon()
    team = replace(problem.team, cable_friction=FRICTION)
    return replace(problem, team=team, mission=(*problem.mission[:steps], ho.Hold(REST)))


def row(name: str, runs: int, seed: int) -> tuple[object, ...]:
    """Return the row of a mission."""
    plan, elapsed = timed(lambda: ho.solve(mission(name)))
    flown = [ho.simulate(plan, perturbed=True, seed=seed + i) for i in range(runs)]
    figures = [each.run.figures for each in flown]
    return (
        name,
        plan.duration,
        elapsed,
        *success([each.run for each in flown]),
        centimetres([each["resting_mean"] for each in figures]),
        centimetres([max(each["resting_largest"] for each in figures)]),
        max(each["peak_tension"] for each in figures),
        min(closest(each.flight).distance for each in flown),
    )


def main() -> None:
    """Print and write the table."""
    cli = parser(__doc__, runs=5, seed=1000)
    cli.add_argument("missions", nargs="*", choices=[*MISSIONS, []], default=[], help="or all")
    options = cli.parse_args()
    table = Table(options.output / "joining.md", "Joining", LIMITATIONS, ("mujoco",))
    table.note(f"python -m benchmarks joining --runs {options.runs} --seed {options.seed}")
    errors = "at rest [cm]", "largest [cm]", "tension [N]", "nearest drones [m]"
    columns = "lasts [s]", "plan [s]", "flights", "succeeded (95 %)", "first failures"
    table.section("", "mission", *columns, *errors)
    for name in options.missions or MISSIONS:
        table.row(*row(name, options.runs, options.seed))
