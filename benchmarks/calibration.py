"""Estimates from simulated flights against what was simulated.

Usage: python -m benchmarks.calibration [--flights N] [--first S] [--noise M] [--calm]
                                        [--output FILE]

A regular triangle stands, moves a vertex outward, stands again and moves it back, flown with the
accurate preset by drones whose stiffness, and with ropes whose lengths and friction, are drawn from
the seed;
positions are recorded with white noise. The plan knows neither weight nor friction; the calibration
knows the ropes' weight alone.
"""

from __future__ import annotations

import argparse
import datetime
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

import hitchopt as ho
from benchmarks.environment import busy, environment
from benchmarks.flight_plans import planned, standing_and_moved
from hitchopt.calibration.calibrate import estimate_team
from hitchopt.simulation.disturbances import Disturbances
from hitchopt.simulation.rope_flight import fly
from hitchopt.simulation.simulation_settings import ACCURATE, USUAL, Perturbations, Settings

LIMITATIONS = (
    "simulated ropes of 12 mm, whose true length for the hitch is known to 2 mm (n = 3); regular "
    "triangles alone; one flight each; white measurement noise on drones and vertices"
)

FRICTIONS = (0.0, 0.1, 0.2, 0.3)
"""Friction of the flights, one after the other."""

SOFTEST, STIFFEST = 2.0, 15.0
"""Range of the stiffness [N/m]."""

WITHIN = (3e-3, 0.1, 0.05)
"""Errors that are wanted: of a length [m], of a stiffness (relative), of a friction coefficient."""


@dataclass(frozen=True)
class Calibrated:
    """One flight's errors of estimation.

    Attributes
    ----------
    row: of the table.
    errors: largest of the lengths [m], of the stiffness (relative), of the friction; nan where not
        determined.
    scores: the same over the stated standard errors.
    """

    row: str
    errors: tuple[float, float, float]
    scores: tuple[float, float, float]


def calibrated(seed: int, noise: float, perturbed: bool) -> Calibrated:
    """Return the errors of one flight's estimates."""
    random = np.random.default_rng(seed)
    friction = FRICTIONS[seed % len(FRICTIONS)]
    stiffness = float(np.exp(random.uniform(np.log(SOFTEST), np.log(STIFFEST))))
    perturbations = USUAL if perturbed else Perturbations(cable_error=USUAL.cable_error)
    settings = Settings(
        preset=ACCURATE,
        perturbations=perturbations,
        seed=seed,
        friction=friction,
        stiffness=stiffness,
        pull_test=False,
    )
    task = planned(standing_and_moved())
    flight = fly(task, settings)
    clean = ho.Recording.of_flight(flight)
    recording = replace(
        clean,
        drones=clean.drones + noise * random.normal(size=clean.drones.shape),
        vertices=clean.vertices + noise * random.normal(size=clean.vertices.shape),
    )
    found = estimate_team(recording, task, flight.density)
    scale = Disturbances(perturbations, task.team.robots, seed).cable_scale
    lengths = task.team.cable_length * scale
    off = np.array([one.value for one in found.lengths]) - lengths
    worst = int(np.argmax(np.abs(off)))
    k, mu = found.stiffness[0], found.friction
    errors = (float(abs(off[worst])), abs(k.value / stiffness - 1.0), abs(mu.value - friction))
    scores = (
        float(abs(off[worst])) / found.lengths[worst].error,
        abs(k.value - stiffness) / k.error,
        abs(mu.value - friction) / mu.error,
    )
    cells = (
        str(seed),
        "usual" if perturbed else "cables 0.5 % off",
        f"{1e3 * off[worst]:+.1f} ± {1e3 * found.lengths[worst].error:.1f}",
        f"{stiffness:.2f}",
        f"{k.value:.2f} ± {k.error:.2f}" if k.known else "not determined",
        f"{friction:g}",
        f"{mu.value:.3f} ± {mu.error:.3f}" if mu.known else "not determined",
        "completed" if flight.error is None else str(flight.error),
    )
    return Calibrated(f"| {' | '.join(cells)} |", errors, scores)


COLUMNS = (
    "seed",
    "perturbations",
    "worst length off by [mm]",
    "k [N/m]",
    "estimated",
    "μ",
    "estimated",
    "flight",
)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print and write a row for every flight, and how many estimates are within what is wanted."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--flights", type=int, default=8)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--noise", type=float, default=1e-3)
    parser.add_argument("--calm", action="store_true", help="cable errors alone")
    parser.add_argument("--output", type=Path)
    given = parser.parse_args(arguments)
    lines = [
        f"# Calibration from simulated flights, {datetime.date.today()}",
        "",
        "`python -m benchmarks.calibration`",
        "",
        f"- {environment()}",
        f"- limitations: {LIMITATIONS}",
        f"- noise of recorded positions {1e3 * given.noise:g} mm; load {busy():.1f}",
        "",
        f"| {' | '.join(COLUMNS)} |",
        f"| {' | '.join(['---'] * len(COLUMNS))} |",
    ]
    print("\n".join(lines), flush=True)
    found = []
    for seed in range(given.first, given.first + given.flights):
        found.append(calibrated(seed, given.noise, not given.calm))
        lines.append(found[-1].row)
        print(found[-1].row, flush=True)
    errors = np.array([one.errors for one in found])
    scores = np.array([one.scores for one in found])
    summary = ["", "| quantity | within | flights | largest error over stated error |"]
    summary.append("|---" * 4 + "|")
    for c, name in enumerate(("cable lengths: 3 mm", "stiffness: 10 %", "friction: 0.05")):
        within = int(np.sum(errors[:, c] <= WITHIN[c]))
        summary.append(f"| {name} | {within} | {len(found)} | {np.nanmax(scores[:, c]):.1f} |")
    lines += summary
    print("\n".join(summary))
    if given.output is not None:
        given.output.write_text("\n".join([*lines, ""]), encoding="utf-8")


if __name__ == "__main__":
    main()
