"""Slip loads of grips: simulated, and predicted from the friction of cables at their clasps.

Usage: python -m benchmarks.slip_loads [CASE ...] [--preset NAME]

A calm flight each: the object is planned three times as rough, gripped, lifted by 10 cm and held,
while its friction falls by 0.03 a second until it slips. Its weight is the slip load at that
friction. ``grip_history`` predicts it from the plan's drones and tensions, for cables as thick as
simulated ones. A run is written to benchmarks/results/slip_loads.csv as it ends, not flown again.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.carrying import ROUNDING, SIDES, add_row, rounded_sides, rows
from benchmarks.carrying_loads import task_of
from benchmarks.environment import busy, environment
from benchmarks.grip_history import Rounding
from benchmarks.grip_prediction import held_grip
from hitchopt.hitch import GRAVITY
from hitchopt.mission.loading import problem_from_dict
from hitchopt.plan import Plan
from hitchopt.planning import solve
from hitchopt.simulation.rope_flight import _Run
from hitchopt.simulation.simulation_settings import PRESETS, Settings
from hitchopt.values import Array

RESULTS = Path(__file__).parent / "results"
TABLE, SUMMARY = RESULTS / "slip_loads.csv", RESULTS / "slip_loads.md"

COLUMNS = (
    *("case", "preset", "mass_g", "friction", "predicted", "without_friction", "certified"),
    *("nodes", "load", "date"),
)

ROUGHER, BEGIN = 3.0, 1.35
"""Friction planned with, and friction as the flight begins, over that at which a slip is due."""

FALL = 0.03
"""[1/s] Rate at which friction falls."""

LOOSE, FALLING = 0.06, 0.01
"""Depth [m] at which an object has slipped, and the speed [m/s] beyond which it slips."""


@dataclass(frozen=True)
class Case:
    """What is gripped how.

    Attributes
    ----------
    body: circle or outline.
    robots: number n.
    cable: length [m].
    tied: radius [m] of the hitch that comes around it.
    clasps: coefficient of friction of cables on each other.
    mass: [kg]
    friction: of the object, at which a slip is due.
    tension: [N]
    corners: radius [m] of the body's corners; None of a disc.
    """

    body: dict[str, Any]
    robots: int
    cable: float
    tied: float
    clasps: float
    mass: float
    friction: float
    tension: float = 1.3
    corners: float | None = None

    def problem(self) -> dict[str, Any]:
        """Return the problem of a hitch that encloses, grips, lifts and holds it."""
        angles = -2.0 * np.pi * np.arange(self.robots) / self.robots
        polygon = self.tied * np.column_stack([np.cos(angles), np.sin(angles)])
        rough = {"friction": ROUGHER * self.friction, "mass": self.mass, "at": [0.0, 0.0, 0.0]}
        return {
            "team": {
                "robots": self.robots,
                "cable_length": self.cable,
                "cable_density": 0.01,
                "tension": 1.0,
                "cable_friction": self.clasps,
            },
            "limits": {"tilt_deg": 60},
            "objects": {"held": {**self.body, **rough}},
            "start": {"hitch": {"polygon": polygon.tolist(), "altitude": 0.8}},
            "mission": [
                {"enclose": {"object": "held"}},
                {"grasp": {"object": "held", "by": "grip", "tension": self.tension}},
                {"lift": {"by": 0.1}},
                {"hold": {"seconds": 20.0}},
            ],
        }


DISC, BOX = {"circle": 0.2}, {"outline": SIDES}

CASES = {
    "drum-3": Case(DISC, 3, 1.6, 0.56, 0.15, 0.25, 0.445),
    "drum-3-rough": Case(DISC, 3, 1.6, 0.56, 0.25, 0.1453, 0.45),
    "drum-3-even": Case(DISC, 3, 1.6, 0.56, 0.05, 0.2187, 0.45, tension=1.1),
    "drum-3-small": Case({"circle": 0.15}, 3, 1.4, 0.5, 0.10, 0.2024, 0.45),
    "drum-3-medium": Case({"circle": 0.17}, 3, 1.5, 0.5, 0.15, 0.2, 0.45),
    "drum-3-wide": Case({"circle": 0.23}, 3, 1.75, 0.62, 0.15, 0.279, 0.45),
    "drum-3-gentle": Case(DISC, 3, 1.6, 0.56, 0.15, 0.2054, 0.45, tension=1.0),
    "drum-3-sticky": Case({"circle": 0.18}, 3, 1.55, 0.53, 0.20, 0.26, 0.6, tension=1.2),
    "drum-3-smooth": Case({"circle": 0.16}, 3, 1.45, 0.5, 0.08, 0.2752, 0.5),
    "box-4": Case(BOX, 4, 1.3, 0.46, 0.15, 0.1784, 0.7, corners=0.0),
    "box-4-round": Case(
        {"outline": rounded_sides()}, 4, 1.3, 0.46, 0.15, 0.165, 0.7, corners=ROUNDING
    ),
}
"""The first one is that by which the law was found; the others were chosen before they were flown,
and their masses such that the prediction for the friction is met."""


BESIDES = """
The last four columns are predicted over simulated slip loads. drum-3 led to the first law; its
flight began with a friction of 0.62, not 0.60. The other cases were written down, and predicted,
before they were flown, drum-3-medium and drum-3-wide when the rest had been, then box-4-round.
These three and the last three drums were flown by the command above, the other five by a script
with the same protocol. A box on four cables with a friction of 0.05 was to be another, and was not
planned (separation, 0.996). The certificate's slip load is a lower bound, no prediction.

The law has been mended since. By the first one the rows up to box-4-round were 0.962, 1.026, 0.698,
0.936, 1.161, 0.928, 0.968 and 0.953. It left out two things that are seen in drum-3-even flown
again (0.525): an arc presses with the level part of its tension only, 5 % less, and cables slope
along arcs too, where upright friction bends them to parabolas. Both follow from statics; nothing
was fitted, and those rows are computed anew. There clasps are 44.5 mm above the mean of contacts
(44.3 mm by the law, for its wraps), and level pulls, wraps and friction hold the weight within 1 %.
drum-3-gentle, -sticky and -smooth were predicted by the new law before they were flown.

It is within 6.5 % in eight of ten cases without a sharp corner (and in the one with, by nodes), and
too high by 11 and 12 % where cables hardly rub: drum-3-even (0.05) and drum-3-smooth (0.08). There
friction would hold edges at most 8 and 13 % tenser than legs, and the law has them so. In
drum-3-even they are (1.05 to 1.08) until the drum leaves the ground; then it turns by 1.6° within
0.3 s, by 2.7° in all, cables run through the clasps, and edges end at 1.00 times what legs pull
with, wraps at 71.5°. Both legs of a cable pull with 1.22 and 1.06 N then: they are of unequal
lengths around the drum and of equal ones where it is gripped, so cables run as it closes, and rub
on the drum. Without any friction at the clasps as it lifts the law has 0.97 and 0.89 times what is
simulated.

Wraps at the slip as predicted, and simulated: 77° and 75° (drum-3), 61° and 58° (drum-3-rough), 67°
and 67° (drum-3-small), 33° and 34° (box-4); edges pull with 1.11 and 1.09, 0.78 and 0.78, 1.02 and
1.05, 0.84 and 0.88 times what legs do. As it has closed wraps are 63° and 62°, 53° and 49°, 59° and
57°, 32° and 32°. What contacts press with, times friction, is the weight within 2.2 % where an
object slips. While drums' hitches close and touch nothing yet, edges pull less than legs by as much
as with 0.74, 0.77, 0.74 and 0.67 times their cables' friction (drum-3, -rough, -even and -small;
medians of 9 to 22 samples); it is 0.71 where both cables slide alike.

At a friction of 0.5 the prediction for the drum of 0.2 m and clasps of 0.15 is 342 g (324 g by the
first law): it grows with the load. 1.5 times 324 g (planned with a friction of 3) stayed on the
ground in 4 of 4 perturbed flights (fast, 6200 to 6203); 352 g were lost in 20 of 20.

box-4 holds more than its cables can: an artefact of sharp corners and coarse ropes. Only nodes of
ropes meet objects. Two that rest on both sides of a corner press on its faces, and what they press
with adds up to `2 T sin(θ/2) / cos φ`, φ = 45° for faces of a right angle: 1.39 times `T θ` for a
bend of 34°. In the flight it was 1.32 times, by which the prediction would be 0.90. Where links s
are shorter, or the corner is round, so that two nodes that touch it are r from its centre, φ is
`asin(s / 2r)`: r is half of the rope's thickness at a sharp corner, 6 mm. That makes 1.39, 1.11 and
1.04 of 10 mm at radii of 0, 5 and 10 mm, and 1.08 and 1.01 of 5 mm at 0 and 5 mm. The column nodes
has this share, not fitted, and known after box-4 had been flown; of it box-4-sharp-slips was
computed (carrying_loads.md) before any flight.

`python -m benchmarks.rope_corners` bends a rope by 34° about a fixed corner. Ranges are of three
places of nodes: what it presses with over `T θ`, and what friction takes over `μ T θ` as it slides.

| radius [mm] | segments of 10 mm | segments of 5 mm | segments of 2.5 mm |
|---|---|---|---|
| 0 | 0.98 to 1.39, 0.97 to 1.38 | 0.98 to 1.10, 0.97 to 1.08 | 1.02 to 1.03, 1.00 to 1.02 |
| 5 | 0.98 to 1.10, 0.97 to 1.09 | 1.01 to 1.02, 1.00 to 1.01 | 1.01 to 1.02, 0.99 to 1.00 |
| 10 | 0.98 to 1.04, 0.97 to 1.03 | 1.00 to 1.01, 0.99 to 1.00 | 1.00 to 1.01, 0.99 to 1.00 |
| 20, 50 | 1.00 to 1.01, 0.94 to 1.02 | 1.00 to 1.01, 0.98 to 1.00 | 1.00 to 1.01, 0.98 to 0.99 |

The limit is `T θ`, as predicted. box-4-round, its corners of 20 mm radius (arcs of five points),
was added for this before it was flown. Other tables' boxes have sharp corners, and hold more, but
for box-4-round-slips: give outlines the corners that boxes have.
"""
"""What the flights showed besides."""


class _SlippedError(Exception):
    """The object has slipped."""


class _Falling(_Run):
    """A flight in which an object's friction falls from a time on, until it slips."""

    def begin(self, friction: float, time: float) -> None:
        """Let friction fall from a value on, from a time [s] on."""
        world = self._world
        bodies = world.model.geom_bodyid
        self._geoms = np.flatnonzero(np.isin(bodies, world.object_bodies))
        self._friction, self._begin = friction, time
        self._heights: list[tuple[float, float, float]] = []

    def _step(self, time: float, index: int, pull: float, offset: Array | float = 0.0) -> None:
        falling = max(time - self._begin, 0.0)
        friction = self._friction - FALL * falling
        self._world.model.geom_friction[self._geoms, 0] = friction
        super()._step(time, index, pull, offset)
        if falling > 0.0:
            height = float(self._world.poses[0, 2])
            self._heights.append((time, friction, height))
            if height < self._heights[0][2] - LOOSE:
                raise _SlippedError

    @property
    def slipped_at(self) -> float:
        """Friction at which the object began to slip for good."""
        t, friction, height = np.array(self._heights)[::10].T
        slow = np.flatnonzero(np.gradient(height, t) > -FALLING)
        return float(friction[slow[-1]])


def simulated(plan: Plan, case: Case, settings: Settings) -> float:
    """Return the friction at which the object slips; nan where it does not."""
    task = task_of(plan)
    friction = BEGIN * case.friction
    body = replace(task.cargo.objects["held"], friction=friction)
    task = replace(task, cargo=replace(task.cargo, objects={"held": body}))
    run = _Falling(task, settings, None)
    run.begin(friction, plan.motion.phases[-1].start + 0.3)
    try:
        run.fly()
    except _SlippedError:
        return run.slipped_at
    return float("nan")


def fly(name: str, settings: Settings) -> None:
    """Fly a case once, and add it to the table."""
    case = CASES[name]
    plan = solve(problem_from_dict(case.problem()))
    friction = simulated(plan, case, settings)
    weight = GRAVITY * case.mass
    ropes = case.tied, case.clasps, settings.preset.diameter
    grip = held_grip(plan, task_of(plan), *ropes)
    corners = None
    if case.corners is not None:
        thick = 0.5 * settings.preset.diameter
        corners = Rounding(case.corners + thick, settings.preset.segment)
    history, nodes = grip.slip_load(friction), grip.slip_load(friction, corners)
    smooth = replace(case, clasps=0.0)
    grips = [
        plan.certificate["grip"] for plan in (solve(problem_from_dict(smooth.problem())), plan)
    ]
    shares = [(grip.worst or 0.0) * friction / (ROUGHER * case.friction) for grip in grips]
    values = (
        *(name, settings.preset.name, f"{1000.0 * case.mass:.1f}", f"{friction:.3f}"),
        *(f"{share:.3f}" for share in (history / weight, *shares, nodes / weight)),
        *(f"{busy():.1f}", time.strftime("%Y-%m-%d")),
    )
    add_row(TABLE, COLUMNS, values)


def summarise() -> None:
    """Write the table of all runs so far."""
    found = rows(TABLE)
    days = ", ".join(sorted({row["date"] for row in found}))
    lines = [
        f"# Slip loads of grips, {days}",
        "",
        "`python -m benchmarks.slip_loads`",
        "",
        environment(("mujoco",)),
        "- goal: predicted within 10 % of what is simulated",
        "- limitations: one calm flight a case; drums on three cables and boxes on four",
        "- history: as friction leaves the clasps, cables sliding as the grip closes and sticking "
        "as it lifts; nodes: the same of ropes whose nodes alone touch corners; without friction: "
        "`μ Σ T θ` of the plan of cables that do not rub; "
        "certified: with the worst friction at the clasps",
        "",
        "| case | preset | cables' friction | mass [g] | slips at | history | nodes "
        "| without friction | certified |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    lines += [
        f"| {row['case']} | {row['preset']} | {CASES[row['case']].clasps} | {row['mass_g']} "
        f"| {row['friction']} | {row['predicted']} | {row['nodes']} "
        f"| {row['without_friction']} | {row['certified']} |"
        for row in found
    ]
    SUMMARY.write_text("\n".join(lines) + "\n" + BESIDES, encoding="utf-8")


def main(arguments: Sequence[str] | None = None) -> int:
    """Fly the cases that are not in the table; return 0."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("cases", nargs="*", help=f"{', '.join(CASES)}; by default all")
    parser.add_argument("--preset", choices=sorted(PRESETS), default="accurate")
    given = parser.parse_args(arguments)
    if not set(given.cases) <= set(CASES):
        parser.error(f"cases are {', '.join(CASES)}")
    settings = Settings(preset=PRESETS[given.preset], pull_test=False)
    for name in given.cases or CASES:
        if (name, given.preset) not in {(row["case"], row["preset"]) for row in rows(TABLE)}:
            fly(name, settings)
            summarise()
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
