"""Comparison of hitches formed by laying and by swaps: from hover, and flown with ropes.

Usage: python -m benchmarks laying [--random N] [--flown N] [--seed S]

The forms of the problem files, with cables of 10 g/m, and random irregular hitches of 3 to 6
robots, the first ``--flown`` of them flown. All begin at the altitude of the hitch.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np

import hitchopt as ho
from benchmarks.flights import irregular, success
from benchmarks.measuring import PROBLEMS, Table, parser, timed
from hitchopt.lab.simulation.judgement import CampaignRun
from hitchopt.mission.starts import DronesStart
from hitchopt.steps.moving import Hold
from hitchopt.steps.tying import Form

LIMITATIONS = (
    "fast preset; cables of 10 g/m, ropes of 12 mm, friction 0.1, as planned, without "
    "settling; perturbed: noise of 1 cm and 3 cm/s, 0.05 N each of gusts and of steady wind, "
    "downwash, cables 0.5 % off, starts 2 cm off; means are over hitches that both methods plan"
)

FORMS = ("triangle", "square", "pentagon", "hexagon", "twelve_gon")
"""Suffixes of the problem files ``form_*``."""

Method = Literal["swaps", "laying"]

METHODS: tuple[Method, Method] = ("swaps", "laying")

REST = 3.0
"""Duration of the rest at the end [s]."""

COLUMNS = (
    "forms in [s]", "plan [s]", "separation", "flights", "succeeded (95 %)", "first failures",
    "tension [N]",
)  # fmt: skip


class Outcome(NamedTuple):
    """A plan, its processor time [s], and its perturbed flight, if any."""

    plan: ho.Plan
    elapsed: float
    run: CampaignRun | None


def from_hover(problem: ho.Problem, method: Method) -> ho.Problem:
    """Return the problem of its form step alone, by a method, with hovering drones."""
    form = next(step for step in problem.mission if isinstance(step, Form))
    start = problem.start
    assert isinstance(start, DronesStart)
    up = np.array([0.0, 0.0, form.altitude])
    raised = DronesStart(*(np.asarray(x) * [1.0, 1.0, 0.0] + up for x in (start.q, start.r)))
    tied = replace(form, by=method, legs=None, settle=False)
    team = replace(problem.team, cable_density=0.01, cable_friction=0.1)
    return replace(problem, team=team, start=raised, mission=(tied, Hold(REST)))


def outcome(problem: ho.Problem, method: Method, seed: int | None) -> Outcome | None:
    """Return the outcome of a form step, flown if there is a ``seed``; None if infeasible."""
    try:
        plan, elapsed = timed(lambda: ho.solve(from_hover(problem, method)))
    except ho.HitchoptError:
        return None
    flown = None if seed is None else ho.simulate(plan, perturbed=True, seed=seed).run
    return Outcome(plan, elapsed, flown)


def figures(outcomes: Sequence[Outcome]) -> tuple[object, ...]:
    """Return the cells of outcomes: means, minimum separation, and results of flights."""
    if not outcomes:
        return ("",) * len(COLUMNS)
    runs = [each.run for each in outcomes if each.run is not None]
    planned = (
        np.mean([each.plan.duration - REST for each in outcomes]),
        np.mean([each.elapsed for each in outcomes]),
        min(each.plan.certificate["separation"].worst for each in outcomes),
    )
    if not runs:
        return (*planned, "", "", "", "")
    return (*planned, *success(runs), max(run.figures["peak_tension"] for run in runs))


def main() -> None:
    """Print and write both tables."""
    options = parser(__doc__, random=40, flown=20, seed=1000).parse_args()
    table = Table(options.output / "laying.md", "Laying and swaps", LIMITATIONS, ("mujoco",))
    table.section("Problems", "problem", "method", *COLUMNS)
    for name in FORMS:
        problem = ho.load_problem(PROBLEMS / f"form_{name}.yaml")
        for method in METHODS:
            result = outcome(problem, method, options.seed)
            table.row(f"form_{name}", method, *figures([result] if result else []))
    random = [ho.problem_from_dict(irregular(i, 0.1, settle=False)) for i in range(options.random)]
    pairs = [
        [
            outcome(each, method, options.seed + i if i < options.flown else None)
            for method in METHODS
        ]
        for i, each in enumerate(random)
    ]
    table.section(f"{options.random} random irregular hitches", "method", "planned", *COLUMNS)
    for method, outcomes in zip(METHODS, zip(*pairs, strict=True), strict=True):
        compared = [x for x, pair in zip(outcomes, pairs, strict=True) if x and all(pair)]
        table.row(method, sum(map(bool, outcomes)), *figures(compared))
