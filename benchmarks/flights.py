"""Plans flown through the rope simulation: the paper's experiments, hitches formed, friction.

Usage: python -m benchmarks.flights [capstan] [experiments] [formed] [--runs N] [--seed S]
                                    [--processes P] [--only WORD]

Without names: all three. Minutes; results are printed as they come, as the lines of tables.

capstan: tension ratio of a right-angled clasp, per preset and friction.
experiments: the paper's four, at low and at high friction: one calm flight with the accurate preset
    beside the paper's figures, and N perturbed ones with the fast preset.
formed: regular hitches tied from the ground, N perturbed flights each with the fast preset.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import hitchopt as ho
from benchmarks.environment import busy, print_environment
from hitchopt.mission.loading import problem_from_dict
from hitchopt.mission.problem import Problem
from hitchopt.simulate.campaign import run_campaign
from hitchopt.simulate.capstan import capstan_test
from hitchopt.simulate.measures import Spread
from hitchopt.simulate.settings import ACCURATE, FAST, USUAL, Settings
from hitchopt.simulate.simulation import Task, read_task, simulate

PROBLEMS = Path(__file__).parents[1] / "problems"

LIMITATIONS = (
    "cables of 10 g/m where the problem gives none, thicker than real ones; errors are distances "
    "of the contact force's centre to vertices.csv, the predicted sag taken off; perturbed: 1 cm "
    "of noise, 0.05 N of wind, cables 0.5 % off, starts 2 cm off; a touch of any drone fails"
)

FRICTIONS = {"low (leather)": 0.1, "high (nylon)": 0.3}
"""The paper names its ropes and no coefficients; these are ours."""


@dataclass(frozen=True)
class Experiment:
    """One of the paper's.

    Attributes
    ----------
    name: of its problem file.
    printed: what the paper says, with what speaks against it.
    """

    name: str
    printed: str


EXPERIMENTS = (
    Experiment("paper_experiment_1", "8 of 10 formed"),
    Experiment("form_square", "formed (one picture)"),
    Experiment(
        "paper_experiment_2", "8.2 ± 5.6, 16.8 ± 14.5, 76.2 ± 8.8 cm (the same as for experiment 3)"
    ),
    Experiment(
        "paper_experiment_3", "8.2 ± 5.6, 16.8 ± 14.5, 76.2 ± 8.8 cm (the same as for experiment 2)"
    ),
    Experiment(
        "paper_experiment_4", "3.6 ± 3.6, 2.6 ± 8.4, 4.3 ± 98.7 cm (so printed: 0.987 beside 0.043)"
    ),
)

FORMED = (3, 4, 6, 8, 12)
"""Robots of the regular hitches that are tied."""

EDGE, LENGTH = 1.3, 2.2
"""[m] Of their polygons, and of their cables."""

PARTS = ("capstan", "experiments", "formed")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the named parts; return 0."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("parts", nargs="*", help="capstan, experiments, formed; by default all")
    parser.add_argument("--runs", type=int, default=10)
    parser.add_argument("--seed", type=int, default=1000)
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--only", default="", help="problems whose names contain this")
    given = parser.parse_args(arguments)
    parts = given.parts or PARTS
    if not set(parts) <= set(PARTS):
        parser.error(f"parts are {', '.join(PARTS)}, not {', '.join(parts)}")
    print_environment(LIMITATIONS)
    print(f"seeds from {given.seed} on; load {busy():.1f}")
    if "capstan" in parts:
        capstan()
    if "experiments" in parts:
        experiments(given.only, given.runs, given.seed, given.processes)
    if "formed" in parts:
        formed(given.only, given.runs, given.seed, given.processes)
    return 0


def capstan() -> None:
    """Print the friction of clasps."""
    print("\n| preset | μ | tension ratio | exp(μ π/2) | off by |\n| --- | --- | --- | --- | --- |")
    for preset in (ACCURATE, FAST):
        for friction, slide in ((0.0, 1.0), (0.1, 1.0), (0.2, 2.0), (0.3, 3.0)):
            found = capstan_test(preset, friction, slide=slide)
            off = found.ratio / found.expected - 1.0
            told(
                preset.name,
                f"{friction}",
                f"{found.ratio:.3f}",
                f"{found.expected:.3f}",
                f"{off:+.1%}",
            )


def experiments(only: str, runs: int, seed: int, processes: int) -> None:
    """Print the paper's experiments at low and high friction, beside its figures."""
    print(
        "\n| experiment | friction | preset | flights | succeeded (95 %) | vertex errors, mean ± "
        "standard deviation (largest) [cm] | the paper's |\n"
        "| --- | --- | --- | --- | --- | --- | --- |"
    )
    for experiment in EXPERIMENTS:
        if only not in experiment.name:
            continue
        task = planned(experiment.name)
        for word, friction in FRICTIONS.items():
            calm = Settings(preset=ACCURATE, friction=friction)
            done = simulate(task, calm)
            errors = done.errors.without_sag
            texts = [spread(Spread.of(errors[:, c])) for c in range(errors.shape[1])]
            held = "yes" if done.outcome.succeeded else done.outcome.failures[0].words
            told(
                experiment.name,
                f"{word}, {friction}",
                "accurate, calm",
                "1",
                held,
                "; ".join(texts),
                experiment.printed,
            )
            campaign(task, experiment.name, f"{word}, {friction}", friction, runs, seed, processes)


def formed(only: str, runs: int, seed: int, processes: int) -> None:
    """Print how often regular hitches are tied and hold."""
    print(
        "\n| problem | friction | preset | flights | succeeded (95 %) | vertex error [cm] | first "
        "failures |\n| --- | --- | --- | --- | --- | --- | --- |"
    )
    for n in FORMED:
        if only in (name := f"n = {n}"):
            with tempfile.TemporaryDirectory() as place:
                ho.solve(regular(n)).save(place)
                task = read_task(Path(place))
            campaign(task, name, f"{task.team.cable_friction}", None, runs, seed, processes)


def regular(n: int) -> Problem:
    """Return the problem of a regular hitch of n robots, tied from rows of two on the ground."""
    angle = 0.5 * np.pi - 2.0 * np.pi * np.arange(n) / n
    radius = EDGE / (2.0 * np.sin(np.pi / n))
    polygon = radius * np.column_stack([np.cos(angle), np.sin(angle)])
    row, column = np.divmod(np.arange(n), 2)
    q = np.column_stack([1.8 * column - 1.4, 1.5 - 0.9 * row, np.zeros(n)])
    r = q + [1.0, 0.0, 0.0]
    team = {
        "robots": n,
        "cable_length": LENGTH,
        "cable_density": 0.01,
        "cable_friction": 0.1,
        "tension": 0.5,
    }
    step = {"form": {"polygon": polygon.tolist(), "altitude": 1.6, "legs": "balanced"}}
    start = {"drones": {"q": q.tolist(), "r": r.tolist()}}
    return problem_from_dict({"team": team, "start": start, "mission": [step]})


def campaign(
    task: Task, name: str, word: str, friction: float | None, runs: int, seed: int, processes: int
) -> None:
    """Print one line of perturbed flights with the fast preset."""
    settings = Settings(preset=FAST, perturbations=USUAL, friction=friction, seed=seed)
    begin = time.perf_counter()
    found = run_campaign(task, settings, runs, processes)
    low, high = found.interval
    means = np.array([run.without_sag.mean for run in found.runs])
    failures = "; ".join(
        f"{kind} {where}: {count}" for (kind, where), count in found.failures.most_common()
    )
    pace = np.nanmedian([run.pace for run in found.runs])
    told(
        name,
        word,
        "fast, perturbed",
        f"{runs}",
        f"{found.successes} ({low:.0%} to {high:.0%})",
        f"{100 * np.nanmean(means):.1f} on average" if np.isfinite(means).any() else "",
        f"{failures or 'none'}; {pace:.1f} times real time",
    )
    print(f"({time.perf_counter() - begin:.0f} s)", file=sys.stderr)


def planned(name: str) -> Task:
    """Return the plan of a problem, read back from files as any other simulation does."""
    with tempfile.TemporaryDirectory() as place:
        ho.solve(PROBLEMS / f"{name}.yaml").save(place)
        return read_task(Path(place))


def spread(errors: Spread) -> str:
    """Return an error's mean, deviation and largest value in centimetres."""
    return f"{100 * errors.mean:.1f} ± {100 * errors.deviation:.1f} ({100 * errors.largest:.1f})"


def told(*cells: str) -> None:
    """Print a line of a table, at once."""
    print(f"| {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    sys.exit(main())
