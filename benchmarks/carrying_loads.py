"""Loads in rope simulation: held at 0.8 of the planner's largest mass, lost above the slip load.

Usage: python -m benchmarks.carrying_loads [CASE ...] [--runs N] [--seed S] [--preset NAME]

Cases: tray-3, tray-4, tray-6, drum-3, box-4: lifted by 10 cm and held for 10 s by 0.8 of the
largest mass that is planned, found by halving. The others are drums of 0.9, 1.1 or 1.5 times the
slip load `μ Σ T θ` with legs and edges that pull alike, held by cables that rub on each other
(drum-3-slips) or do not. (The certificate's is lower by what friction at the clasps takes off at
worst.) box-4-slips is a box of 1.5 times the slip load that ``grip_prediction`` has for it,
box-4-round-slips one whose corners are round, box-4-sharp-slips one of 1.5 times what ropes hold
whose nodes alone touch its sharp corners. The planner's check is off there: its object is three or
four times as rough as the simulated one.
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
    SIDES,
    TIED_AROUND,
    add_row,
    label,
    rounded_sides,
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

HELD = {"tray-3": 0.8, "tray-4": 0.8, "tray-6": 0.8, "drum-3": 0.8, "box-4": 0.8}
"""Mass over the largest one that is planned, by cases."""

SLIPPING = {
    "drum-3-slips": 1.5,
    "drum-3-smooth-1.5": 1.5,
    "drum-3-smooth-1.1": 1.1,
    "drum-3-smooth-0.9": 0.9,
    "box-4-slips": 1.5,
    "box-4-round-slips": 1.5,
    "box-4-sharp-slips": 1.5,
}
"""Mass over the slip load, by cases."""

PLANS_SINCE = {"tray-3": 6100, "tray-4": 6100, "tray-6": 6100}
"""First seeds of the present plans; flights of earlier ones are listed apart."""

CASES = (*HELD, *SLIPPING)

SLIPPED = 0.03
"""[m] Objects that slip so far are not held."""

UNKNOWN = "unknown"
"""Said of flights that were not simulated to their end before the object was lost."""

DRUM: dict[str, Any] = {"circle": 0.2, "friction": 0.5}
BOX: dict[str, Any] = {"outline": SIDES, "friction": 0.8}
ROUND = {**BOX, "outline": rounded_sides()}
"""What is gripped, and its coefficient of friction."""

ROUGHER, ROUGHEST = 3.0, 4.0
"""Friction planned with where the object is to slip, over the simulated one, and the same of the
heaviest, box-4-sharp-slips."""

PREDICTED = {"box-4-slips": 0.2161, "box-4-round-slips": 0.1923, "box-4-sharp-slips": 0.335}
"""[kg] Slip loads of boxes, as ``grip_prediction`` had them before they were flown, the last one
for ropes whose nodes alone touch corners. The first two are 2 % less since it knows that edges
slope along their arcs."""


BESIDES = """
## Besides these rows

The certificate's slip load, that with the worst friction at the clasps, is 167 g by a light
object's plan, 172 g by a heavy one's: a lower bound. A drum of 251 g (accurate, seed 6000) was held
for 10 s, slipped by 1.2 cm. Slip loads measured (calm, accurate, one flight each): planned with a
rough object, whose friction then falls by 0.03 a second while it is held.

- Cables that do not rub on each other: the object of 235 g begins to slip at a friction of 0.50,
  between 0.489 and 0.506. `μ Σ T θ` of the plan is 242 g at rest, 234 g while it is lifted.
  Perturbed (drum-3-smooth-0.9), 0.9 times these 234 g slip as well: the noise shakes them down.
- Cables that rub (0.15): that of 250 g slips at 0.44 (0.436 to 0.449), where cables press on it
  with what holds 284 g at 0.5. That is 1.17 times 242 g: edges pull with 1.09 times what legs do
  (+8 %), bend by 75° in place of 70° (+8 %), legs pull 2 % more, and edges slope (-2 %).
- Why, and a prediction that knows it: slip_loads.md. As it has closed (edges 0.82 times legs,
  wraps of 62°) the grip holds 180 g, about what the certificate says; the weight draws clasps in.
- Of what was suspected, ropes 2.4 cm too short made legs pull by 0.04 N more and the drum hang 0.4
  cm higher; with ropes as long as needed cables press on it as hard (262 and 260 g, object of 234 g
  and a friction of 1.5). Ropes that meet objects with 4 mm in place of 12 mm changed nothing either
  (283 g, object of 240 g), and were not kept.

A load that grows beyond the plan's draws the hitch down, and tightens it: another measure.

Why heavy trays hung low, by calm flights (fast) of tray-4 with 424 g: drones neither sank (0.04 cm)
nor did ropes stretch (0.05 %), so the load is fed forward in full. Plans took legs to be straight,
but cables run level below the rim up to its edge, which takes 1.4 cm a leg less. The tray hung 0.85
cm low; with ropes 1.4 and 2.6 cm shorter 0.05 cm low and 0.6 cm high. Plans that know it: 0.7 cm
high (cables of 12 mm lift the rim by 6), tray-3 0.0 in place of 0.5 cm low, tray-6 1.7 in place of
2.6 cm low. Perturbed, seeds 6000 to 6002, flown once with each: tray-4 -0.3, -0.2 and 0.2 cm in
place of -1.8, -1.7 and -1.3, tray-6 -0.1, -0.4 and -0.1 in place of -1.1, -1.4 and -1.1. Rows of
trays begin anew at 6100 with these plans.

Why tray-6 hung low in that calm flight (again 1.8 cm): only nodes of ropes meet objects, and with
segments of 3 cm four of six cables passed through the rim's edge between two nodes. Two cables
carried 89 % of the weight, and clasps slid outward by 3.6 cm. Drones were 0.04 cm low. In the
accurate preset, calm, tray-3, tray-4 and tray-6 (211.7, 424.3 and 494.4 g) hang 0.8, 0.9 and 0.8 cm
high, of which 0.6 are half of a rope; all cables carry alike, clasps are within 1.3 cm of their
plan, and drones within 0.02 cm of their height on average. The preset makes the difference, not
plan or controller: heights of trays are to be judged in the accurate one.

Seeds 6300 and on, accurate preset, were written down before they were flown, in rounds: drum-3,
drum-3-slips, box-4, box-4-slips, box-4-round-slips, tray-3 and tray-4, then the next seed; tray-3
of 6300 was stopped unfinished once, and flown again. The sharp corners of box-4-slips press too
hard (slip_loads.md): it slipped by 3.0, 4.2 and 9.6 cm. Round corners, by which it slipped by 26, 9
and 19 cm, were added before they were flown. drum-3-slips is 1.5 times `μ Σ T θ`, 1.03 times what
is predicted for clasps that rub; 1.5 times 324 g were not lifted (slip_loads.md). drum-3-smooth-1.5
was stopped after 9 of 20 flights. box-4-sharp-slips, 1.5 times what ropes of nodes are predicted to
hold, was added, its load written down, before any of it was flown; its seeds begin at 6300 too.
Accurate flights of drum-3 and drum-3-slips with seed 6000 were flown with the ropes that were too
short.

Of seeds 6300 to 6319 in the accurate preset, 20 a case, 0.8 of the largest mass was held in 20
(drum-3), 19 (box-4), 20 and 20 (tray-3, tray-4), and 1.5 times the slip load lost in 20 and 20
(drum-3-slips, box-4-round-slips). Heights are within 1.5 cm in 77 of the 80 that are held: two of
tray-3 are 1.6 and 2.1 cm high, one of tray-4 1.53. Sixteen flights of box-4-sharp-slips broke off
before the box was lifted, where a cable pulled harder than simulated ropes are made for (3.00 N,
beyond 2.99): the four others lost it, which shows little. Until then such flights were counted as
lost.
"""
"""What other flights found."""


def problem(case: str, mass: float, rougher: float = 1.0) -> dict[str, Any]:
    """Return the problem of a hitch that comes around an object of a mass [kg] and holds it.

    Parameters
    ----------
    rougher: friction planned with, over that of what is gripped.
    """
    n, gripped = int(case.split("-")[1]), not case.startswith("tray")
    angles = -2.0 * np.pi * np.arange(n) / n
    radius = TIED_AROUND[n] if gripped else 0.4
    body: dict[str, Any] = {"circle": FOOT, "to": 0.3, "rim": {"circle": 0.3, "at": 0.25}}
    grasp: dict[str, Any] = {"object": "held"}
    team = {"robots": n, "cable_length": CABLES[n], "cable_density": 0.01, "tension": 1.0}
    if gripped:
        body = dict(DRUM if n == 3 else ROUND if "round" in case else BOX)
        body["friction"] *= rougher
        grasp |= {"by": "grip", "tension": PULL}
        team |= {
            "cable_length": GRIPPED[n],
            "cable_friction": 0.0 if "smooth" in case else FRICTION,
        }
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


def slip_load(case: str) -> float:
    """Return the load [kg] at which what is gripped slips.

    Of a drum it is `μ Σ T θ` of a light one's plan, legs and edges alike.
    """
    if case in PREDICTED:
        return PREDICTED[case]
    light = 0.05
    grip = solve(problem_from_dict(problem("drum-3-smooth", light))).certificate["grip"]
    return (grip.worst or 0.0) * light


def planned(case: str) -> tuple[Task, float]:
    """Return the task of a case, and the simulated mass [kg]."""
    if case in HELD:
        mass = HELD[case] * largest_mass(case)
        return task_of(solve(problem_from_dict(problem(case, mass)))), mass
    mass = SLIPPING[case] * slip_load(case)
    rougher = ROUGHEST if "sharp" in case else ROUGHER
    task = task_of(solve(problem_from_dict(problem(case, mass, rougher))))
    body = task.cargo.objects["held"]
    body = replace(body, friction=body.friction / rougher)
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
    tasks: dict[str, tuple[Task, float]] = {}
    flown = {(row["case"], row["preset"], int(row["seed"])) for row in rows(TABLE)}
    for seed in range(given.seed, given.seed + given.runs):
        for case in given.cases or CASES:
            if (case, given.preset, seed) not in flown:
                if case not in tasks:
                    tasks[case] = planned(case)
                task, mass = tasks[case]
                fly(task, replace(settings, seed=seed), case, mass)
                summarise()
    return 0


def fly(task: Task, settings: Settings, case: str, mass: float) -> None:
    """Fly once, and add the run to the table."""
    simulation = simulate(task, settings)
    (state,) = simulation.outcome.objects
    lost = not np.isnan(state.dropped) or state.slipped > SLIPPED
    unknown = simulation.flight.error is not None
    held = "no" if lost else UNKNOWN if unknown else "yes"
    values = (
        *(case, settings.preset.name, settings.seed, f"{1000.0 * mass:.1f}"),
        *(held, f"{100.0 * state.slipped:.2f}", f"{100.0 * state.lifted:.2f}"),
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
        "- lifted: mean height over the plan's, and the farthest from it",
        "- unknown: not simulated to their end, before the object was lost; not counted",
        "",
        "| case | preset | mass [g] | held (95 %) | unknown | slipped [cm] | lifted [cm] |",
        "|---|---|---|---|---|---|---|",
    ]
    for case, preset in sorted({(label(row, PLANS_SINCE), row["preset"]) for row in found}):
        flown = [row for row in found if (label(row, PLANS_SINCE), row["preset"]) == (case, preset)]
        runs = [row for row in flown if row["held"] != UNKNOWN]
        if not runs:
            lines.append(f"| {case} | {preset} | {flown[0]['mass_g']} | - | {len(flown)} | - | - |")
            continue
        held = sum(row["held"] == "yes" for row in runs)
        low, high = wilson(held, len(runs))
        slipped, lifted = (
            np.array([float(row[name]) for row in runs]) for name in ("slipped_cm", "lifted_cm")
        )
        lines.append(
            f"| {case} | {preset} | {flown[0]['mass_g']} | {held} of {len(runs)} ({low:.0%} to "
            f"{high:.0%}) | {len(flown) - len(runs) or '-'} | {np.mean(slipped):.1f} | "
            f"{np.mean(lifted):.1f} ({lifted[np.argmax(np.abs(lifted))]:.1f}) |"
        )
    SUMMARY.write_text("\n".join(lines) + "\n" + BESIDES, encoding="utf-8")


if __name__ == "__main__":
    raise SystemExit(main())
