"""Rope simulation of plans: the paper's experiments, hitches formed, friction.

Usage: python -m benchmarks.flights [weight] [capstan] [experiments] [moved] [irregular] [perturbed]
                                    [formed] [--runs N] [--seed S] [--processes P] [--only WORD]
                                    [--robots N ...] [--preset NAME] [--of NAME ...]

Without names: all of them. Minutes; results are printed as they come, as the lines of tables.

weight: vertex errors with sag of hitches that stand, that move and that are formed, ropes of 10 g/m
    and plans that know it, calm and perturbed; of N robots, 3 by default, with a preset, ``fast``
    by default, and with the usual perturbations or those of them that are named.

capstan: tension ratio of a right-angled clasp, per preset and friction.
experiments: the paper's that move a hitch, at low and at high friction: calm flights with the
    accurate preset, of plans made for that friction, and of plans that know of none as a control.
moved: the same of a regular triangle, one vertex moved outward; without friction too.
irregular: the same of ten random triangles, a random vertex moved somewhere.
perturbed: N flights each of all of the paper's with the fast preset; plans know the friction.
formed: regular hitches tied from the ground, N perturbed flights each with the fast preset.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np

from benchmarks.capstan import capstan_test
from benchmarks.environment import busy, print_environment
from benchmarks.flight_plans import (
    EXPERIMENTS,
    at_rest,
    experiment,
    irregular,
    moved,
    planned,
    tied,
)
from hitchopt.simulation.error_measures import Spread
from hitchopt.simulation.flight_task import Task
from hitchopt.simulation.simulate import simulate
from hitchopt.simulation.simulation_settings import (
    ACCURATE,
    FAST,
    PRESETS,
    USUAL,
    Perturbations,
    Preset,
    Settings,
)
from hitchopt.sweeps.campaign import Campaign, run_campaign

LIMITATIONS = (
    "cables of 10 g/m where the problem gives none, thicker than real ones; drones feed forward "
    "the cable forces of setpoints.csv and nothing else; errors are distances in three dimensions "
    "of the contact force's centre to vertices.csv, sag included; perturbed: noise of 1 cm and "
    "3 cm/s, 0.05 N each of gusts and of steady wind, downwash, cables 0.5 % off, starts 2 cm off; "
    "a touch of any drone fails"
)

FRICTIONS = {0.1: "low (leather)", 0.3: "high (nylon)"}
"""Friction coefficients by name; the paper names its ropes without coefficients."""

RANDOM, LOW = 10, 0.1
"""Number of random triangles, and their friction."""

FORMED = (3, 4, 6, 8, 12)
"""Numbers of robots of the regular hitches that are tied."""

PARTS = ("weight", "capstan", "experiments", "moved", "irregular", "perturbed", "formed")


@dataclass(frozen=True)
class Campaigns:
    """Flights of each plan under perturbations.

    Attributes
    ----------
    only: text that the names of the problems contain.
    runs: flights of each.
    seed: seed of the first one.
    processes: number at a time.
    preset: resolution of the part weight.
    perturbations: those of the part weight.
    """

    only: str
    runs: int
    seed: int
    processes: int
    preset: Preset
    perturbations: Perturbations


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the named parts; return 0."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("parts", nargs="*", help=f"{', '.join(PARTS)}; by default all")
    parser.add_argument("--runs", type=int, default=10)
    parser.add_argument("--seed", type=int, default=1000)
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--only", default="", help="problems whose names contain this")
    parser.add_argument("--robots", type=int, nargs="*", default=[3], help="of the part weight")
    parser.add_argument("--preset", choices=PRESETS, default="fast", help="of the part weight")
    parser.add_argument("--of", nargs="*", choices=asdict(USUAL), help="of the part weight")
    given = parser.parse_args(arguments)
    parts = given.parts or PARTS
    if not set(parts) <= set(PARTS):
        parser.error(f"parts are {', '.join(PARTS)}, not {', '.join(parts)}")
    preset = PRESETS[given.preset]
    some = {name: getattr(USUAL, name) for name in given.of or asdict(USUAL)}
    campaigns = Campaigns(
        given.only, given.runs, given.seed, given.processes, preset, Perturbations(**some)
    )
    print_environment(LIMITATIONS)
    print(f"calm flights: seed 0; perturbed: seeds from {given.seed} on; load {busy():.1f}")
    if "weight" in parts:
        weight(campaigns, given.robots)
    if "capstan" in parts:
        capstan()
    if "experiments" in parts:
        experiments(given.only)
    if "moved" in parts:
        triangles()
    if "irregular" in parts:
        random_triangles()
    if "perturbed" in parts:
        perturbed(campaigns)
    if "formed" in parts:
        formed(campaigns)
    return 0


def weight(given: Campaigns, robots: Sequence[int]) -> None:
    """Print vertex errors with sag of hitches whose plans know the ropes' weight."""
    print_head(
        "hitch",
        "flight",
        "succeeded",
        "at rest, sag included [cm]",
        "moving, sag included [cm]",
        "all, without sag [cm]",
        "drones to setpoints [cm]",
        "at rest, seed by seed [cm]",
        "first failures",
    )
    for n in robots:
        for name, problem in (
            ("at rest", at_rest(n)),
            ("a vertex moved", moved(0.0, n)),
            ("formed", tied(n, 0.0)),
        ):
            if given.only not in name:
                continue
            task = planned(problem)
            for word, settings, runs in (
                ("calm", Settings(preset=given.preset), 1),
                (
                    "perturbed",
                    Settings(
                        preset=given.preset, perturbations=given.perturbations, seed=given.seed
                    ),
                    given.runs,
                ),
            ):
                if not runs:
                    continue
                found = run_campaign(task, settings, runs, given.processes)
                print_row(
                    f"n = {n}, {name}",
                    word,
                    f"{found.successes} of {runs}",
                    mean([run.resting for run in found.runs]),
                    mean([run.moving for run in found.runs]),
                    mean([run.without_sag for run in found.runs]),
                    mean([run.tracking for run in found.runs]),
                    ", ".join(f"{100 * run.resting.mean:.2f}" for run in found.runs),
                    first_failures(found),
                )


def capstan() -> None:
    """Print the friction of clasps."""
    print_head("preset", "μ", "tension ratio", "exp(μ π/2)", "off by")
    for preset in (ACCURATE, FAST):
        for friction, slide in ((0.0, 1.0), (0.1, 1.0), (0.2, 2.0), (0.3, 3.0)):
            found = capstan_test(preset, friction, slide=slide)
            off = f"{found.ratio / found.expected - 1.0:+.1%}"
            ratios = (f"{found.ratio:.3f}", f"{found.expected:.3f}")
            print_row(preset.name, f"{friction}", *ratios, off)


CALM = (
    "experiment",
    "friction",
    "the plan knows",
    "lasts",
    "held",
    "while it moves a vertex [cm]",
    "at rest [cm]",
    "p0; p1; p2, all of the flight [cm]",
    "all, without sag [cm]",
)


def experiments(only: str) -> None:
    """Print calm flights of the paper's experiments that move a hitch, with its figures."""
    print_head(*CALM, "the paper's")
    for one in EXPERIMENTS:
        if one.forms or only not in one.name:
            continue
        for friction, word in FRICTIONS.items():
            for known in (friction, 0.0):
                task = planned(experiment(one.name, known))
                print_row(
                    one.name, f"{friction}, {word}", *calm(task, friction, known), one.printed
                )


def triangles() -> None:
    """Print calm flights of a regular triangle, one of its vertices moved outward."""
    print_head(*CALM)
    for friction, known in ((0.0, 0.0), (0.1, 0.1), (0.1, 0.0), (0.3, 0.3), (0.3, 0.0)):
        print_row("regular triangle", f"{friction}", *calm(planned(moved(known)), friction, known))


def random_triangles() -> None:
    """Print calm flights of random triangles, a random vertex of each moved somewhere."""
    print_head(*CALM)
    for seed in range(RANDOM):
        for known in (LOW, 0.0):
            print_row(f"triangle {seed}", f"{LOW}", *calm(irregular(seed, known), LOW, known))


def calm(task: Task, friction: float, known: float) -> tuple[str, ...]:
    """Return the cells of one flight with the accurate preset, and print its processor time."""
    done = simulate(task, Settings(preset=ACCURATE, friction=friction))
    errors = done.errors
    held = "yes" if done.outcome.succeeded else done.outcome.failures[0].words
    if errors.lost:
        held += f"; {errors.lost:.1%} lost"
    print(f"({done.processor:.0f} s of processor)", file=sys.stderr)
    return (
        f"{known:g}" if known else "none",
        f"{done.flight.task.duration:.1f} s",
        held,
        spread(done.run.moving),
        spread(done.run.resting),
        "; ".join(spread(Spread.of(column)) for column in errors.errors.T),
        spread(done.run.without_sag),
    )


PERTURBED = (
    "problem",
    "friction",
    "flights",
    "succeeded (95 %)",
    "mean vertex error, moving; at rest; all without sag [cm]",
    "first failures",
    "pace",
)


def perturbed(given: Campaigns) -> None:
    """Print success rates of the paper's experiments, whose plans know the friction."""
    print_head(*PERTURBED)
    for one in EXPERIMENTS:
        if given.only in one.name:
            for friction in FRICTIONS:
                campaign(planned(experiment(one.name, friction)), one.name, given)


def formed(given: Campaigns) -> None:
    """Print success rates of regular hitches that are tied."""
    print_head(*PERTURBED)
    for n in FORMED:
        if given.only in (name := f"n = {n}"):
            campaign(planned(tied(n)), name, given)


def campaign(task: Task, name: str, given: Campaigns) -> None:
    """Print one line of perturbed flights with the fast preset, at the plan's own friction."""
    settings = Settings(preset=FAST, perturbations=USUAL, seed=given.seed)
    begin = time.perf_counter()
    found = run_campaign(task, settings, given.runs, given.processes)
    low, high = found.interval
    kinds = ("moving", "resting", "without_sag")
    errors = "; ".join(mean([getattr(run, kind) for run in found.runs]) for kind in kinds)
    print_row(
        name,
        f"{task.team.cable_friction:g}",
        f"{given.runs}",
        f"{found.successes} ({low:.0%} to {high:.0%})",
        errors,
        first_failures(found),
        f"{np.nanmedian([run.pace for run in found.runs]):.1f}",
    )
    print(f"({time.perf_counter() - begin:.0f} s)", file=sys.stderr)


def first_failures(found: Campaign) -> str:
    """Return what failed first in how many flights."""
    counts = found.failures.most_common()
    return "; ".join(f"{kind} {where}: {count}" for (kind, where), count in counts) or "none"


def mean(errors: list[Spread]) -> str:
    """Return the mean over flights in centimetres, where there are errors."""
    means = np.array([one.mean for one in errors])
    there = means[np.isfinite(means)]
    return f"{100 * np.mean(there):.1f}" if there.size else "–"


def spread(errors: Spread) -> str:
    """Return an error's mean, deviation and largest value in centimetres."""
    if not np.isfinite(errors.mean):
        return "–"
    return f"{100 * errors.mean:.1f} ± {100 * errors.deviation:.1f} ({100 * errors.largest:.1f})"


def print_head(*titles: str) -> None:
    """Print the head of a table."""
    print()
    print_row(*titles)
    print_row(*["---"] * len(titles))


def print_row(*cells: str) -> None:
    """Print a line of a table, at once."""
    print(f"| {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    sys.exit(main())
