"""One motor stopped at a random time: simulated flights with the certified reaction and without.

Usage: python -m benchmarks.lost [--flights N] [--first SEED] [--calm] [--preset NAME]

Every flight carries a regular hitch of 3 to 12 robots at an altitude of 1.0 to 2.2 m and loses a
random drone at a random time, with the usual perturbations. It is flown twice from the same seed.
Printed are contacts of survivors with each other and with cables or the lost drone, and the largest
tensions from the loss on: of a segment of a rope, and of a cable's mean over its length. Losses
without a reaction and flights that the simulation could not follow are listed as such. Peaks of the
fast preset are mostly noise of single segments. Limits of this sample: hitches are tied already,
and move level.
"""

from __future__ import annotations

import argparse
import platform
import tempfile
import time
from dataclasses import dataclass, replace

import numpy as np

import hitchopt as ho
from hitchopt.errors import InfeasibleError
from hitchopt.geometry import regular_polygon
from hitchopt.losing.flown_reaction import reacting
from hitchopt.losing.reaction import Reactions
from hitchopt.losing.reaction_records import Reaction
from hitchopt.simulation.flight_task import Task, read_task
from hitchopt.simulation.lost_drones import LossOutcome, loss_outcome
from hitchopt.simulation.rope_flight import fly
from hitchopt.simulation.simulation_settings import CALM, PRESETS, USUAL, Loss, Settings

ROBOTS = (3, 4, 5, 6, 8, 10, 12)
EDGE, LENGTH, TENSION = 1.0, 2.2, 0.5
LOW, HIGH = 1.0, 2.2


@dataclass(frozen=True)
class Case:
    """A flight that loses a drone.

    Attributes
    ----------
    robots, altitude: of the hitch; [m].
    task: its setpoints.
    loss: who is lost, and when.
    reaction: of the others; None where there is none.
    """

    robots: int
    altitude: float
    task: Task
    loss: Loss
    reaction: Reaction | None


def case(seed: int) -> Case:
    """Return the flight of a seed."""
    rng = np.random.default_rng(seed)
    n, altitude = ROBOTS[seed % len(ROBOTS)], float(rng.uniform(LOW, HIGH))
    team = ho.Team(robots=n, cable_length=LENGTH, tension=TENSION)
    start = ho.Hitch.spread(team, regular_polygon(n, EDGE).vertices, altitude=altitude)
    goal = [*rng.uniform(-1.0, 1.0, 2).tolist(), altitude]
    plan = ho.transport(start, to=goal)
    drone = str(rng.choice(team.drone_names))
    loss = Loss(drone, float(rng.uniform(0.05, 0.95)) * plan.duration)
    with tempfile.TemporaryDirectory() as place:
        task = read_task(plan.save(place))
    try:
        reaction = Reactions(plan.motion).found(loss.drone, loss.time)
    except InfeasibleError:
        reaction = None
    return Case(n, altitude, task, loss, reaction)


@dataclass(frozen=True)
class Flown:
    """A flight that has lost a drone.

    Attributes
    ----------
    outcome: what became of the survivors.
    mean: largest tension of a cable from the loss on, averaged over the cable's length [N].
    error: why it was not simulated to its end; empty where it was.
    """

    outcome: LossOutcome
    mean: float
    error: str

    @property
    def words(self) -> str:
        """The columns of the table."""
        touched = f"{len(self.outcome.among)}/{len(self.outcome.others)}"
        note = " (not simulated to its end)" if self.error else ""
        peaks = f"{self.outcome.peak_tension:.2f}, {self.mean:.2f}{note}"
        return f"{touched} | {peaks} | {self.outcome.moved:.2f}"


def flown(task: Task, loss: Loss, settings: Settings) -> Flown:
    """Return a flight of a task that loses a drone."""
    flight = fly(task, replace(settings, lost=loss))
    after = flight.record.t >= loss.time
    mean = float(np.max(flight.record.tensions[after]))
    error = "" if flight.error is None else str(flight.error)
    return Flown(loss_outcome(flight, loss), mean, error)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--flights", type=int, default=40)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--calm", action="store_true")
    parser.add_argument("--preset", choices=sorted(PRESETS), default="accurate")
    given = parser.parse_args()
    perturbations = CALM if given.calm else USUAL
    print(f"{platform.machine()}, Python {platform.python_version()}, numpy {np.__version__}\n")
    print("Touches are survivors with each other / with cables or the lost drone.")
    print(
        "Peaks are the largest tension of a segment, and of a cable's mean over its length [N].\n"
    )
    print(
        "| seed | n | altitude [m] | lost | flies on: touches | peaks | moved [m] | "
        "reacts: touches | peaks | moved [m] |"
    )
    print("|---|---|---|---|---|---|---|---|---|---|")
    apart = lower = lower_mean = compared = reacted = 0
    for seed in range(given.first, given.first + given.flights):
        begin = time.process_time()
        made = case(seed)
        settings = Settings(
            perturbations=perturbations, seed=seed, pull_test=False, preset=PRESETS[given.preset]
        )
        without = flown(made.task, made.loss, settings)
        row = f"| {seed} | {made.robots} | {made.altitude:.2f} | {made.loss.drone} at "
        row += f"{made.loss.time:.2f} s | {without.words} | "
        if made.reaction is None:
            row += "no reaction | – | – |"
        else:
            done = flown(reacting(made.task, made.reaction), made.loss, settings)
            row += f"{done.words} |"
            reacted += 1
            apart += done.outcome.apart and not done.error
            if not (done.error or without.error):
                compared += 1
                lower += done.outcome.peak_tension < without.outcome.peak_tension
                lower_mean += done.mean < without.mean
        print(row, f"<!-- {time.process_time() - begin:.0f} s -->", flush=True)
        print(
            f"<!-- no two survivors touch in {apart} of {reacted} that react; of {compared} pairs "
            f"simulated to their end {lower} peaks are lower, {lower_mean} by the mean -->",
            flush=True,
        )


if __name__ == "__main__":
    main()
