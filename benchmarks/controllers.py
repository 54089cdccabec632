"""Flights by flight controllers: who forms and holds a hitch, with which filter, and how sent.

Usage: python -m benchmarks controllers [--problems NAME ...] [--controllers NAME ...]
                                        [--filters NAME ...] [--sent streamed uploaded]
                                        [--runs N] [--seed S] [--preset NAME] [--friction MU]
                                        [--processes P]
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal

import numpy as np

import hitchopt as ho
from benchmarks.measuring import PROBLEMS, Table, parser
from hitchopt.simulation.commands import flown_team
from hitchopt.simulation.judgement import Simulation
from hitchopt.simulation.settings import ESTIMATORS, Settings

LIMITATIONS = (
    "laws and filter are written from their mathematics and agree with the Crazyflie's firmware in "
    "a bench; no hardware has flown any of it. Ropes of the fast preset place vertices within 1 to "
    "2 cm. Cables weigh 5 g/m where the problem gives no weight, which plans know; they keep "
    "distances for the tracking error of retuned gains, without an arena. Perturbed: gusts and "
    "steady wind of 0.05 N each, less for lighter drones by their faces, downwash, cables 0.5 % "
    "and starts 2 cm off. Figures are means over flights that formed, of their rest of a second; "
    "tilt, distance in flight and least ratio are the worst of all"
)

STOCK: dict[str, float] = {}
CONTROLLERS: dict[str, tuple[str, dict[str, float] | None]] = {
    "mellinger retuned": ("mellinger", None),
    "mellinger": ("mellinger", STOCK),
    "lee retuned": ("lee", None),
    "lee": ("lee", STOCK),
    "pid": ("pid", STOCK),
    "px4": ("px4", STOCK),
}
"""Laws, and gains: stock ones, or those of the problem's team or the stiffest that fly."""


SENT = ("streamed", "uploaded")
DENSITY = 0.005  # Of cables where the problem gives none [kg/m]
WIND, HEAVY = 0.05, 0.132  # Force of gusts, and of steady wind [N], on a drone of this mass [kg]

COLUMNS = (
    "problem", "controller", "filter", "sent", "formed", "first failures", "vertices [cm]",
    "drones [cm]", "tension / planned", "tilt [°]", "off in flight [cm]", "least ratio",
)  # fmt: skip

Case = tuple[str, str, str, str]


@dataclass(frozen=True)
class Flown:
    """Figures of a flight; nan if it did not reach them."""

    formed: bool
    failure: str
    vertex: float = np.nan  # mean distance of mean places at rest [cm]
    drone: float = np.nan  # mean distance at rest [cm]
    tension: float = np.nan  # mean at rest, over the planned one
    tilt: float = np.nan  # largest [°]
    off: float = np.nan  # largest distance in flight [cm]
    ratio: float = np.nan  # least separation in flight

    @classmethod
    def of(cls, done: Simulation, separation: ho.Separation) -> Flown:
        """Return the figures of a flight."""
        flight, outcome = done.flight, done.outcome
        record, task = flight.record, flight.task
        ends_formed = bool(task.formed[-1])
        formed = outcome.hitched if ends_formed else outcome.succeeded
        aloft = record.t <= task.duration
        off = 100.0 * np.linalg.norm(record.drones - record.commanded, axis=-1)
        semi_axes = [separation.radius, separation.radius, separation.height]
        places = record.drones[aloft] / (2.0 * np.array(semi_axes))
        first, second = np.triu_indices(places.shape[1], 1)
        ratios = np.linalg.norm(places[:, first] - places[:, second], axis=-1)
        known = {"tilt": done.figures["peak_tilt"], "off": np.max(off[aloft])}
        known["ratio"] = np.min(ratios)
        if formed and ends_formed:
            rest = (record.t > task.duration) & (record.t <= flight.rested)
            seen = done.errors.offsets[done.errors.t > task.duration]
            known["vertex"] = 100.0 * np.mean(np.linalg.norm(np.nanmean(seen, axis=0), axis=-1))
            known["drone"] = np.mean(off[rest])
            known["tension"] = np.mean(record.tensions[rest] / task.tensions[-1])
        failure = outcome.failures[0].kind if outcome.failures else ""
        return cls(formed, failure, **{name: float(value) for name, value in known.items()})


def planned(name: str) -> ho.Plan:
    """Return the plan of a problem for drones with a controller, the problem's or a retuned one."""
    problem = ho.load_problem(PROBLEMS / f"{name}.yaml")
    team = flown_team(problem.team, Settings(controller=CONTROLLERS["mellinger retuned"][0]))
    team = replace(team, cable_density=team.cable_density or DENSITY)
    return ho.solve(replace(problem, team=team, arena=None))


def fly(
    place: Path,
    team: ho.Team,
    case: Case,
    preset: Literal["fast", "accurate"],
    friction: float | None,
    seed: int,
) -> Flown:
    """Return the figures of a perturbed flight of a saved plan."""
    _, controller, known, sent = case
    name, gains = CONTROLLERS[controller]
    wind = WIND * min(1.0, (float(np.min(team.mass)) / HEAVY) ** (2.0 / 3.0))
    done = ho.simulate(
        place,
        preset=preset,
        perturbed=True,
        perturbations={"wind": wind, "steady_wind": wind},
        seed=seed,
        friction=friction,
        controller=name,
        gains=gains,
        estimator=known,
        upload=sent == "uploaded",
    )
    motion = done.flight.task.motion
    return Flown.of(done, ho.Separation() if motion is None else motion.requirements.separation)


def row(case: Case, flights: Sequence[Flown]) -> tuple[object, ...]:
    """Return the cells of a case's flights."""

    def mean(name: str) -> str:
        values = [value for each in flights if np.isfinite(value := getattr(each, name))]
        return f"{np.mean(values):.2g}" if values else ""

    first = Counter(each.failure for each in flights if each.failure)
    return (
        *case,
        f"{sum(each.formed for each in flights)} of {len(flights)}",
        "; ".join(f"{kind}: {count}" for kind, count in first.most_common()),
        *map(mean, ("vertex", "drone", "tension")),
        f"{max(each.tilt for each in flights):.0f}",
        f"{max(each.off for each in flights):.1f}",
        f"{min(each.ratio for each in flights):.2f}",
    )


def main() -> None:
    """Print and write the table."""
    options = parser(__doc__)
    problems = ("retuned_triangle", "crazyflie_triangle", "form_square", "tie_carry_untie")
    options.add_argument("--problems", nargs="*", default=problems)
    options.add_argument("--controllers", nargs="*", choices=CONTROLLERS, default=[*CONTROLLERS])
    options.add_argument("--filters", nargs="*", choices=ESTIMATORS, default=[*ESTIMATORS])
    options.add_argument("--sent", nargs="*", choices=SENT, default=SENT)
    options.add_argument("--runs", type=int, default=1)
    options.add_argument("--seed", type=int, default=1000)
    options.add_argument("--preset", choices=("fast", "accurate"), default="fast")
    options.add_argument("--friction", type=float)
    options.add_argument("--processes", type=int, default=1)
    given = options.parse_args()
    table = Table(given.output / "controllers.md", "Flight controllers", LIMITATIONS, ("mujoco",))
    friction = "the team's" if given.friction is None else f"{given.friction:g}"
    table.note(f"preset {given.preset}, seeds from {given.seed} on, friction {friction}")
    table.section("", *COLUMNS)
    with TemporaryDirectory() as folder, ProcessPoolExecutor(given.processes) as pool:
        for problem in given.problems:
            plan = planned(problem)
            place = plan.save(Path(folder) / problem)
            for case in product([problem], given.controllers, given.filters, given.sent):
                one = partial(fly, place, plan.motion.team, case, given.preset, given.friction)
                seeds = range(given.seed, given.seed + given.runs)
                try:
                    table.row(*row(case, list(pool.map(one, seeds))))
                except ho.HitchoptError as error:  # such as an upload that memory does not hold
                    table.row(*case, f"refused: {str(error).splitlines()[0]}")


if __name__ == "__main__":
    main()
