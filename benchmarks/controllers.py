"""Flights by flight controllers: forming and holding a hitch, by filter and transmission.

Default tracking errors are measured by ``python -m benchmarks tracking_errors``, in more flights.

Usage: python -m benchmarks controllers [--problems NAME ...] [--controllers NAME ...]
                                        [--filters NAME ...] [--sent streamed uploaded]
                                        [--runs N] [--seed S] [--preset NAME] [--friction MU]
                                        [--processes P]
"""

from __future__ import annotations

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
from benchmarks.measuring import PROBLEMS, Table, most_common, parser
from hitchopt.drones.controllers import wind_force
from hitchopt.lab.simulation.commands import flown_team
from hitchopt.lab.simulation.report import Simulation
from hitchopt.lab.simulation.settings import ESTIMATORS, Settings

LIMITATIONS = (
    "laws and filter are written from their mathematics and agree with the Crazyflie's firmware in "
    "a bench; no hardware has flown any of it. Ropes of the fast preset are accurate to 1 to "
    "2 cm at vertices. Cables weigh 5 g/m if the problem gives no weight; plans include it "
    "and allow for the tracking error of retuned gains, without an arena. Perturbed: gusts and "
    "steady wind of 0.05 N each, less for lighter, smaller drones, downwash, cables 0.5 % "
    "and starts 2 cm off. Figures are means over the last second at rest of flights that formed; "
    "tilt, distance in flight and smallest ratio are the worst of all"
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
"""Control laws and gains: stock gains, or those of the problem's team or the stiffest feasible."""


SENT = ("streamed", "uploaded")
DENSITY = 0.005  # Default density of cables [kg/m]

COLUMNS = (
    "problem", "controller", "filter", "sent", "formed", "first failures", "vertices [cm]",
    "drones [cm]", "tension / planned", "tilt [°]", "off in flight [cm]",
    "default [cm]", "least ratio",
)  # fmt: skip

Case = tuple[str, str, str, str]


@dataclass(frozen=True)
class FlightFigures:
    """Figures of a flight; nan if not available."""

    formed: bool
    failure: str
    vertex: float = np.nan  # mean distance of mean positions at rest [cm]
    drone: float = np.nan  # mean distance at rest [cm]
    tension: float = np.nan  # mean at rest, over the planned one
    tilt: float = np.nan  # largest [°]
    off: float = np.nan  # largest distance in flight [cm]
    ratio: float = np.nan  # least separation in flight

    @classmethod
    def of(cls, simulation: Simulation) -> FlightFigures:
        """Return the figures of a flight."""
        flight, outcome = simulation.flight, simulation.outcome
        record, task = flight.record, flight.task
        ends_formed = bool(task.states.formed[-1])
        formed = outcome.hitched if ends_formed else outcome.succeeded
        in_flight = record.t <= task.duration
        off = 100.0 * np.linalg.norm(record.drones - record.commanded, axis=-1)
        figures = {"tilt": simulation.figures["peak_tilt"], "off": np.max(off[in_flight])}
        figures["ratio"] = simulation.figures["separation"]
        if formed and ends_formed:
            rest = (record.t > task.duration) & (record.t <= flight.rested)
            offsets = simulation.errors.offsets[simulation.errors.t > task.duration]
            mean_offset = np.linalg.norm(np.nanmean(offsets, axis=0), axis=-1)
            figures["vertex"] = 100.0 * np.mean(mean_offset)
            figures["drone"] = np.mean(off[rest])
            figures["tension"] = np.mean(record.tensions[rest] / task.states.tensions[-1])
        failure = outcome.failures[0].kind if outcome.failures else ""
        return cls(formed, failure, **{name: float(value) for name, value in figures.items()})


def plan_for_controller(name: str) -> ho.Plan:
    """Return the plan of a problem with its own or a retuned controller."""
    problem = ho.load_problem(PROBLEMS / f"{name}.yaml")
    team = flown_team(problem.team, Settings(controller=CONTROLLERS["mellinger retuned"][0]))
    team = replace(team, cable_density=team.cable_density or DENSITY)
    return ho.solve(replace(problem, team=team, arena=None))


def fly(
    plan: Path,
    team: ho.Team,
    case: Case,
    preset: Literal["fast", "accurate"],
    friction: float | None,
    seed: int,
) -> FlightFigures:
    """Return the figures of a perturbed flight of a saved plan."""
    _, controller, estimator, sent = case
    name, gains = CONTROLLERS[controller]
    wind = wind_force(float(np.min(team.mass)))
    simulation = ho.simulate(
        plan,
        preset=preset,
        perturbed=True,
        perturbations={"wind": wind, "steady_wind": wind},
        seed=seed,
        friction=friction,
        controller=name,
        gains=gains,
        estimator=estimator,
        upload=sent == "uploaded",
    )
    return FlightFigures.of(simulation)


def default_tracking(team: ho.Team, controller: str) -> float:
    """Return the tracking error [cm] for which plans allow if drones have a controller."""
    name, gains = CONTROLLERS[controller]
    flown = flown_team(team, Settings(controller=name, gains=gains))
    return max(100.0 * (kind.loop.tracking or 0.0) for kind in flown.kinds)


def row(case: Case, team: ho.Team, flights: Sequence[FlightFigures]) -> tuple[object, ...]:
    """Return the cells of a case's flights."""

    def mean(name: str) -> str:
        values = [value for each in flights if np.isfinite(value := getattr(each, name))]
        return f"{np.mean(values):.2g}" if values else ""

    return (
        *case,
        f"{sum(each.formed for each in flights)} of {len(flights)}",
        most_common(each.failure for each in flights if each.failure),
        *map(mean, ("vertex", "drone", "tension")),
        f"{max(each.tilt for each in flights):.0f}",
        f"{max(each.off for each in flights):.1f}",
        f"{default_tracking(team, case[1]):.1f}",
        f"{min(each.ratio for each in flights):.2f}",
    )


def main() -> None:
    """Print and write the table."""
    cli = parser(__doc__, runs=1, seed=1000, preset="fast", processes=1)
    problems = ("retuned_triangle", "crazyflie_triangle", "form_square", "tie_carry_untie")
    cli.add_argument("--problems", nargs="*", default=problems)
    cli.add_argument("--controllers", nargs="*", choices=CONTROLLERS, default=[*CONTROLLERS])
    cli.add_argument("--filters", nargs="*", choices=ESTIMATORS, default=[*ESTIMATORS])
    cli.add_argument("--sent", nargs="*", choices=SENT, default=SENT)
    cli.add_argument("--friction", type=float)
    options = cli.parse_args()
    table = Table(options.output / "controllers.md", "Flight controllers", LIMITATIONS, ("mujoco",))
    friction = "the team's" if options.friction is None else f"{options.friction:g}"
    table.note(f"preset {options.preset}, seeds from {options.seed} on, friction {friction}")
    table.section("", *COLUMNS)
    with TemporaryDirectory() as folder, ProcessPoolExecutor(options.processes) as pool:
        for problem in options.problems:
            plan = plan_for_controller(problem)
            place = plan.save(Path(folder) / problem)
            for case in product([problem], options.controllers, options.filters, options.sent):
                one = partial(fly, place, plan.motion.team, case, options.preset, options.friction)
                seeds = range(options.seed, options.seed + options.runs)
                try:
                    table.row(*row(case, plan.motion.team, list(pool.map(one, seeds))))
                except ho.HitchoptError as error:  # such as an upload that exceeds the memory
                    table.row(*case, f"refused: {str(error).splitlines()[0]}")
