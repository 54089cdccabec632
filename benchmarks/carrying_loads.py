"""Loads in rope simulation: held at 0.8 of the planner's largest mass, lost at 1.5 slip loads.

Usage: python -m benchmarks.carrying_loads [CASE ...] [--runs N] [--seed S] [--preset NAME]

Cases: tray-3, tray-4, tray-6, drum-3: lifted by 10 cm and held for 10 s by 0.8 of the largest mass
that is planned, found by halving; drum-3-slips: 1.5 times the slip load `μ Σ T θ` with legs and
edges that pull alike. (The certificate's is lower by what friction at the clasps takes off at
worst.) The planner's check is off there: its object is three times as rough as the simulated one.
Perturbed but for mass and friction, which are the question. A run is written to
benchmarks/results/carrying_loads.csv as it ends, not flown again.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.carrying import (
    CABLES,
    FOOT,
    FRICTION,
    GRIPPED,
    PULL,
    TIED_AROUND,
    add_row,
    rows,
    wilson,
)
from benchmarks.environment import busy, environment
from hitchopt.errors import InfeasibleError
from hitchopt.mission.loading import problem_from_dict
from hitchopt.plan import Plan
from hitchopt.planning import solve
from hitchopt.simulation.flight_task import Task, read_task
from hitchopt.simulation.simulate import simulate
from hitchopt.simulation.simulation_settings import PRESETS, USUAL, Settings

RESULTS = Path(__file__).parent / "results"
TABLE, SUMMARY = RESULTS / "carrying_loads.csv", RESULTS / "carrying_loads.md"

COLUMNS = ("case", "preset", "seed", "mass_g", "held", "slipped_cm", "lifted_cm", "load", "date")

CASES = ("tray-3", "tray-4", "tray-6", "drum-3", "drum-3-slips")

HELD, LOST = 0.8, 1.5
"""Mass over the largest one planned, and over the slip load."""

SLIPPED = 0.03
"""[m] Objects that slip so far are not held."""

ROUGHNESS = 0.5
"""Coefficient of friction of the drum."""


BESIDES = """
## Besides these rows

drum-3-slips was flown once with 1.5 times the certificate's slip load, that with the worst friction
at the clasps (1.5 · 167 g = 251 g, accurate, seed 6000): held for 10 s, slipped by 1.2 cm. That
prediction is a lower bound: the simulated drum slips at half as much again or more. With legs and
edges that pull alike it is 234 g.

Why simulated drums hold more than `μ Σ T θ` of the plan says (one calm accurate flight, planned for
a load of 234 g, whose object weighed 60 % of that and then grew heavier by 18 % of it a second):

- At the load of the plan it hung 0.5 cm above it. Legs pulled with 1.39 N and edges at the drum
  with 1.44 N in place of 1.3 N, and edges bent by 79° in space in place of 77°: 1.11 times the
  tension.
- Of this, clasps that rub on each other hold 4 %: the load draws edges out of them. Ropes are about
  2.5 cm shorter than their thickness needs, so legs pull harder: the allowance for their bends
  takes the polygon's angles, but a grip's cables turn by 118° at clasps, not by 60°, and go around
  the drum at a distance of 6 mm (0.73 cm).
- What is heavier than planned draws the hitch down, whose drones hold by their position loops, and
  tightens it: at 1.49 times the slip load, 10 cm lower, edges pulled with 1.78 N and bent by 86°,
  and it had slipped by 0.3 cm when it touched the ground. `μ Σ T θ` of these is 1.74 times the
  plan's.
- Planned for their masses drums are not drawn down so: 1.07 times the slip load (251 g, above) was
  held, 1.5 times lost (drum-3-slips, seed 6000). The slip load is between; where is not measured,
  nor that the prediction is within 10 %.
- With an allowance for a grip's own bends legs pulled with 1.33 N in place of 1.37 N when the grip
  had closed (accurate, calm; stopped as the drum left the ground). A perturbed full mission
  (drum-3, fast, seed 5600) then put the drum down 1.2 cm off but failed, so turned by more than 5°.
  That change was not kept: it has not been flown with the accurate preset.

Trays at 0.8 of the largest mass hang lower than lighter ones: tray-4 with 424 g 0.8 cm below its
plan in a calm flight (fast), with 200 g 0.3 cm above it. A likely cause, computed and not tested:
plans have straight legs, but cables that run level below the rim and rise from its edge need less
length, by 1.3 cm a leg where legs rise by 33°, so they pull less.
"""
"""What other flights found."""


def problem(case: str, mass: float, friction: float = ROUGHNESS) -> dict[str, Any]:
    """Return the problem of a hitch that comes around an object of a mass [kg] and holds it."""
    n, gripped = int(case.split("-")[1]), case.startswith("drum")
    angles = -2.0 * np.pi * np.arange(n) / n
    radius = TIED_AROUND[n] if gripped else 0.4
    body: dict[str, Any] = {"circle": FOOT, "to": 0.3, "rim": {"circle": 0.3, "at": 0.25}}
    grasp: dict[str, Any] = {"object": "held"}
    team = {"robots": n, "cable_length": CABLES[n], "cable_density": 0.01, "tension": 1.0}
    if gripped:
        body = {"circle": 0.2, "friction": friction}
        grasp |= {"by": "grip", "tension": PULL}
        team |= {"cable_length": GRIPPED[n], "cable_friction": FRICTION}
    polygon = radius * np.column_stack([np.cos(angles), np.sin(angles)])
    return {
        "team": team,
        "limits": {"tilt_deg": 60},
        "objects": {"held": {**body, "mass": mass, "at": [0.0, 0.0, 0.0]}},
        "start": {"hitch": {"polygon": polygon.tolist(), "altitude": 0.8}},
        "mission": [
            {"enclose": {"object": "held"}},
            {"grasp": grasp},
            {"lift": {"by": 0.1}},
            {"hold": {"seconds": 10.0}},
        ],
    }


def largest_mass(case: str) -> float:
    """Return the largest mass [kg] that is planned, to one per cent."""
    low, high = 0.02, 1.0
    while high > 1.01 * low:
        middle = float(np.sqrt(low * high))
        try:
            solve(problem_from_dict(problem(case, middle)))
            low = middle
        except InfeasibleError:
            high = middle
    return low


def slip_load() -> float:
    """Return the load [kg] at which the drum slips, by a light one's plan, legs and edges alike."""
    light = 0.05
    smooth = problem("drum-3-slips", light)
    smooth["team"]["cable_friction"] = 0.0
    grip = solve(problem_from_dict(smooth)).certificate["grip"]
    assert grip.worst is not None
    return grip.worst * light


def planned(case: str) -> tuple[Task, float]:
    """Return the task of a case, and the simulated mass [kg]."""
    if not case.endswith("slips"):
        mass = HELD * largest_mass(case)
        return task_of(solve(problem_from_dict(problem(case, mass)))), mass
    mass = LOST * slip_load()
    task = task_of(solve(problem_from_dict(problem(case, mass, 3.0 * ROUGHNESS))))
    body = replace(task.cargo.objects["held"], friction=ROUGHNESS)
    return replace(task, cargo=replace(task.cargo, objects={"held": body})), mass


def task_of(plan: Plan) -> Task:
    """Return a plan as it is simulated."""
    with tempfile.TemporaryDirectory() as folder:
        return read_task(plan.save(Path(folder) / "plan"))


def main(arguments: Sequence[str] | None = None) -> int:
    """Fly the cases' runs that are not in the table; return 0."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("cases", nargs="*", help=f"{', '.join(CASES)}; by default all")
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--seed", type=int, default=6000)
    parser.add_argument("--preset", choices=sorted(PRESETS), default="accurate")
    given = parser.parse_args(arguments)
    if not set(given.cases) <= set(CASES):
        parser.error(f"cases are {', '.join(CASES)}")
    perturbed = replace(USUAL, object_mass=0.0, object_friction=0.0)
    settings = Settings(preset=PRESETS[given.preset], perturbations=perturbed, pull_test=False)
    for case in given.cases or CASES:
        task, mass = planned(case)
        flown = {(row["case"], row["preset"], int(row["seed"])) for row in rows(TABLE)}
        for seed in range(given.seed, given.seed + given.runs):
            if (case, given.preset, seed) not in flown:
                fly(task, replace(settings, seed=seed), case, mass)
                summarise()
    return 0


def fly(task: Task, settings: Settings, case: str, mass: float) -> None:
    """Fly once, and add the run to the table."""
    simulation = simulate(task, settings)
    (state,) = simulation.outcome.objects
    ended = simulation.flight.error is None
    held = ended and np.isnan(state.dropped) and state.slipped <= SLIPPED
    values = (
        *(case, settings.preset.name, settings.seed, f"{1000.0 * mass:.1f}"),
        *("yes" if held else "no", f"{100.0 * state.slipped:.2f}", f"{100.0 * state.lifted:.2f}"),
        *(f"{busy():.1f}", time.strftime("%Y-%m-%d")),
    )
    add_row(TABLE, COLUMNS, values)


def summarise() -> None:
    """Write the table of all runs so far."""
    found = rows(TABLE)
    loads = [float(row["load"]) for row in found]
    days = ", ".join(sorted({row["date"] for row in found}))
    lines = [
        f"# Loads held and lost, {days}",
        "",
        "`python -m benchmarks.carrying_loads`, a flight at a time, resumed where it was stopped",
        "",
        environment(("mujoco",)),
        f"- load (processes that want a core) {min(loads):.1f} to {max(loads):.1f}; goals: 19 of "
        "20 held, 19 of 20 lost where it slips",
        "- limitations: as many flights as the table says; held means not 5 cm below its plan, not "
        "3 cm off the hitch, for 10 s; friction and mass are those of the plan",
        "- lifted: mean height over the plan's",
        "",
        "| case | preset | mass [g] | held (95 %) | slipped [cm] | lifted [cm] |",
        "|---|---|---|---|---|---|",
    ]
    for case, preset in sorted({(row["case"], row["preset"]) for row in found}):
        runs = [row for row in found if (row["case"], row["preset"]) == (case, preset)]
        held = sum(row["held"] == "yes" for row in runs)
        low, high = wilson(held, len(runs))
        slipped, lifted = (
            np.nanmean([float(row[name]) for row in runs]) for name in ("slipped_cm", "lifted_cm")
        )
        lines.append(
            f"| {case} | {preset} | {runs[0]['mass_g']} | {held} of {len(runs)} ({low:.0%} to "
            f"{high:.0%}) | {slipped:.1f} | {lifted:.1f} |"
        )
    SUMMARY.write_text("\n".join(lines) + "\n" + BESIDES, encoding="utf-8")


if __name__ == "__main__":
    raise SystemExit(main())
