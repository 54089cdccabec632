"""Simulated flights with ropes: the paper's experiments and hitches tied from the ground.

Usage: python -m benchmarks flights [--runs N] [--seed S] [--preset NAME] [--friction MU ...]
                                    [--formed N ...] [--processes P]
                                    [--irregular SEED ... [--methods METHOD ...]]

Plans include the friction of the ropes. Each is flown perturbed, with consecutive seeds. With
``--irregular`` hitches that settle after they are formed are compared with those that do not.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import binomtest

import hitchopt as ho
from benchmarks.measuring import PROBLEMS, Table, most_common, parser
from hitchopt.lab.simulation.judgement import CampaignRun

LIMITATIONS = (
    "cables of 10 g/m where the problem gives none, ropes of 12 mm; drones feed forward the cable "
    "forces of setpoints.csv and nothing else; errors are distances of the contact force's centre "
    "to vertices.csv, sag included; perturbed: noise of 1 cm and 3 cm/s, 0.05 N each of gusts and "
    "of steady wind, downwash, cables 0.5 % off, starts 2 cm off; a touch of any drone fails"
)

DENSITY = 0.01  # Of ropes of plans with weightless cables [kg/m]

EXPERIMENTS = (
    "paper_experiment_1",
    "paper_experiment_2",
    "paper_experiment_3",
    "paper_experiment_4",
    "form_square",
    "triangle",
)

FLOWN = ("flights", "succeeded (95 %)", "first failures", "moving [cm]", "at rest [cm]")


def formed_problem(n: int, friction: float) -> dict[str, Any]:
    """Return the problem of a regular hitch of n robots, formed from rows of two on the ground."""
    row, column = np.divmod(np.arange(n), 2)
    q = np.column_stack([1.8 * column - 1.4, 1.5 - 0.9 * row, np.zeros(n)])
    r = q + [1.0, 0.0, 0.0]
    polygon = ho.regular_polygon(n, 1.3).vertices.tolist()
    return {
        "team": {
            "robots": n, "cable_length": 2.2, "cable_density": 0.01, "cable_friction": friction
        },
        "start": {"drones": {"q": q.tolist(), "r": r.tolist()}},
        "mission": [
            {"form": {"polygon": polygon, "altitude": 1.6, "legs": "balanced"}},
            {"hold": {"seconds": 5.0}},
        ],
    }  # fmt: skip


def experiment(name: str, friction: float) -> ho.Plan:
    """Return the plan of a problem file with another cable friction."""
    problem = ho.load_problem(PROBLEMS / f"{name}.yaml")
    return ho.solve(replace(problem, team=replace(problem.team, cable_friction=friction)))


def fly(
    plan: ho.Plan, runs: int, seed: int, preset: str, processes: int, **settings: Any
) -> list[CampaignRun]:
    """Return the figures of perturbed flights of a plan with consecutive seeds."""
    if not plan.motion.team.cable_density:
        settings["density"] = DENSITY
    with tempfile.TemporaryDirectory() as place, ProcessPoolExecutor(processes) as pool:
        one = partial(_one, plan.save(Path(place) / "plan"), preset, settings)
        return list(pool.map(one, range(seed, seed + runs)))


def _one(place: Path, preset: str, settings: dict[str, Any], seed: int) -> CampaignRun:
    return ho.simulate(place, preset=preset, perturbed=True, seed=seed, **settings).run  # type: ignore[arg-type]


def success(runs: Sequence[CampaignRun]) -> tuple[int, str, str]:
    """Return the number of flights, the number of successes, and the first failures."""
    count = sum(run.succeeded for run in runs)
    low, high = binomtest(count, len(runs)).proportion_ci(0.95, method="wilson")
    failures = most_common(run.failures[0].kind for run in runs if run.failures)
    return len(runs), f"{count} ({low:.0%} to {high:.0%})", failures or "none"


def centimetres(values: Sequence[float]) -> str:
    """Return the mean of the finite lengths [m] in centimetres, or nothing."""
    finite = [value for value in values if np.isfinite(value)]
    return f"{100.0 * np.mean(finite):.1f}" if finite else ""


def errors(runs: Sequence[CampaignRun]) -> tuple[str, str]:
    """Return mean vertex errors while a vertex moves, and at rest [cm]."""
    return tuple(
        centimetres([run.figures.get(f"{name}_mean", np.nan) for run in runs])
        for name in ("moving", "resting")
    )  # type: ignore[return-value]


METHODS = {
    "settled": (0.1, "auto"),
    "not settled": (0.1, False),
    "without friction": (0.0, False),
}
"""Friction, and ``settle`` of form."""

CALM = {"noise": 0.01, "velocity_noise": 0.03, "wind": 0.05}
"""Noise and gusts only."""


def irregular(seed: int, friction: float, settle: object) -> dict[str, Any]:
    """Return the problem of a hitch with 3 to 6 robots and an irregular outline."""
    random = np.random.default_rng(seed)
    problem = formed_problem(3 + seed % 4, friction)
    form, hold = problem["mission"][0]["form"], problem["mission"][1]["hold"]
    points = np.array(form["polygon"]) * random.uniform(0.9, 1.15)
    angle = random.uniform(0.0, 2.0 * np.pi)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    points = points @ turn + random.normal(0.0, 0.04, points.shape)
    form |= {"polygon": points.round(4).tolist(), "settle": settle}
    problem["team"]["tension"] = round(float(random.uniform(0.5, 0.7)), 3)
    hold["seconds"] = 2.0
    return problem


def resting(job: tuple[int, str]) -> tuple[object, ...]:
    """Return the row of a flight: vertex errors in the last second of rest."""
    seed, method = job
    friction, settle = METHODS[method]
    plan = ho.solve(ho.problem_from_dict(irregular(seed, friction, settle)))
    flown = ho.simulate(plan, preset="accurate", pull_test=False, seed=seed, perturbations=CALM)
    last = flown.errors.t > flown.errors.t[-1] - 1.0
    level = flown.errors.without_sag[last]
    each = ", ".join(f"{100.0 * value:.1f}" for value in np.nanmean(level, axis=0))
    return seed, 3 + seed % 4, method, f"{100.0 * np.nanmean(level):.1f}", each


def main() -> None:
    """Print and write the tables."""
    cli = parser(__doc__, runs=10, seed=1000, preset="fast", processes=1)
    cli.add_argument("--friction", type=float, nargs="*", default=[0.1, 0.3])
    cli.add_argument("--formed", type=int, nargs="*", default=[3, 4, 6])
    cli.add_argument("--irregular", type=int, nargs="*", default=[], metavar="SEED")
    cli.add_argument("--methods", nargs="*", choices=METHODS, default=list(METHODS))
    options = cli.parse_args()
    table = Table(options.output / "flights.md", "Flights", LIMITATIONS, ("mujoco",))
    table.note(f"preset {options.preset}, seeds from {options.seed} on")
    if options.irregular:
        note = "Irregular hitches tied in calm (noise, gusts), accurate preset: level distances"
        table.section(f"{note} in the last second", "seed", "n", "method", "mean [cm]", "each [cm]")
        with ProcessPoolExecutor(options.processes) as pool:
            jobs = [(seed, method) for seed in options.irregular for method in options.methods]
            for row in pool.map(resting, jobs):
                table.row(*row)
        return
    settings = options.runs, options.seed, options.preset, options.processes
    table.section("The paper's experiments", "problem", "friction", *FLOWN)
    for name in EXPERIMENTS:
        for friction in options.friction:
            runs = fly(experiment(name, friction), *settings)
            table.row(name, friction, *success(runs), *errors(runs))
    table.section("Regular hitches tied from the ground", "n", "friction", *FLOWN)
    for n in options.formed:
        plan = ho.solve(ho.problem_from_dict(formed_problem(n, options.friction[0])))
        runs = fly(plan, *settings)
        table.row(n, options.friction[0], *success(runs), *errors(runs))
