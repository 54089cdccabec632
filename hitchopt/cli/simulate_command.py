"""The command ``simulate``: a plan's setpoints through a rope simulation."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from hitchopt.cli.commands import main
from hitchopt.cli.failures import UNMET, say
from hitchopt.errors import InputError

if TYPE_CHECKING:
    from hitchopt.simulation.simulate import Simulation, Task
    from hitchopt.simulation.simulation_settings import Settings

RESULTS = "simulation"
"""The directory in DIR that results go to unless another one is named."""


@main.command()
@click.argument("directory", metavar="DIR", type=click.Path(path_type=Path))
@click.option(
    "-o",
    "--output",
    metavar="OUT",
    type=click.Path(path_type=Path),
    help="Where results go; by default DIR/simulation.",
)
@click.option(
    "--preset",
    type=click.Choice(["fast", "accurate"]),
    default="fast",
    show_default=True,
    help="fast: does it hold; accurate: with the right friction, five times slower.",
)
@click.option(
    "--drones",
    "body",
    type=click.Choice(["rigid", "point"]),
    default="rigid",
    show_default=True,
    help="Rigid bodies with an attitude, or point masses.",
)
@click.option("--runs", metavar="N", type=int, help="Fly N times, seeds S, S+1, …")
@click.option("--seed", metavar="S", type=int, default=0, show_default=True)
@click.option("--processes", metavar="P", type=int, help="At a time; by default all processors.")
@click.option(
    "--perturbed",
    is_flag=True,
    help="1 cm of noise, 0.05 N of wind, cables 0.5 % off, starts 2 cm off, unless said otherwise.",
)
@click.option("--noise", metavar="M", type=float, help="Of believed positions, per axis [m].")
@click.option("--wind", metavar="N", type=float, help="Gusts on every drone [N].")
@click.option("--lag", metavar="S", type=float, help="Of the thrust [s].")
@click.option("--cable-error", metavar="X", type=float, help="Of cables' lengths, relative.")
@click.option("--start-error", metavar="M", type=float, help="Of the drones' start, per axis [m].")
@click.option("--downwash", is_flag=True, help="Drones blow on those below them.")
@click.option("--friction", metavar="MU", type=float, help="At the clasps; else the team's.")
@click.option("--density", metavar="KG/M", type=float, help="Of the cables; else the team's.")
@click.option("--ground", metavar="M", type=float, help="Height of the ground [m]; 0 or lower.")
@click.option(
    "--film",
    metavar="FILE",
    type=click.Path(path_type=Path),
    help="Write a film, .gif or .mp4; of one flight only.",
)
def simulate(
    directory: Path,
    output: Path | None,
    runs: int | None,
    processes: int | None,
    film: Path | None,
    **options: float | str | bool | None,
) -> None:
    """Fly the setpoints in DIR through a simulation of ropes (needs mujoco).

    Of the plan it reads its team, and vertices.csv for the cables' shape at the start and to
    compare with, and for where cables simulated so thick need their ends, less than their 12 mm
    aside. Drones get setpoints.csv and nothing else. One flight ends with 3 if anything fails:
    drones touch, a vertex does not hold. It also ends with 3 if the simulation leaves the range in
    which it means anything: that is reported as not simulated, since it says nothing of the plan. A
    campaign (--runs) ends with 0 and says how often.
    """
    from hitchopt.simulation.simulate import read_task

    if film is not None:
        _check_film(film, runs)
    settings = _settings(options)
    task = read_task(directory)
    place = directory / RESULTS if output is None else output
    if runs is None:
        _fly_once(task, settings, place, film)
    else:
        _fly_often(task, settings, place, runs, processes)


def _check_film(film: Path, runs: int | None) -> None:
    from hitchopt.simulation.flight_film import check_film

    check_film(film)
    if runs is not None:
        raise InputError("--film", str(film), "of a single flight", "leave out --runs, give a seed")


def _settings(options: dict[str, float | str | bool | None]) -> Settings:
    from hitchopt.simulation.simulation_settings import (
        CALM,
        PRESETS,
        USUAL,
        Perturbations,
        Settings,
    )

    usual = USUAL if options.pop("perturbed") else CALM
    names = ("noise", "wind", "lag", "cable_error", "start_error", "downwash")
    given = {name: options.pop(name) for name in names}
    chosen = {name: value for name, value in given.items() if value is not None}
    preset = PRESETS[str(options.pop("preset"))]
    perturbations = Perturbations(**{**vars(usual), **chosen})
    return Settings(preset=preset, perturbations=perturbations, **options)  # type: ignore[arg-type]


def _fly_once(task: Task, settings: Settings, place: Path, film: Path | None) -> None:
    from hitchopt.cli.progress import LateProgress
    from hitchopt.cli.simulation_tables import flight_tables
    from hitchopt.simulation.flight_film import save_film
    from hitchopt.simulation.flight_outcome import FAILED, NOT_SIMULATED, UNSIMULATED
    from hitchopt.simulation.run_report import save_simulation
    from hitchopt.simulation.simulate import simulate as simulated

    with LateProgress(sys.stderr, "building ropes") as progress:
        done = simulated(task, settings, progress)
    save_simulation(place, done)
    say(flight_tables(done))
    say(f"{_verdict(done)}; results are in {place}")
    for failure in done.outcome.failures:
        word = NOT_SIMULATED if failure.kind in UNSIMULATED else FAILED
        say(f"{word}: t = {failure.time:.2f} s, {failure.words}", err=True)
    if film is not None:
        with LateProgress(sys.stderr, "drawing the film"):
            save_film(film, done.flight.film)
        say(f"the film is {film}")
    if not done.outcome.succeeded:
        click.get_current_context().exit(UNMET)


def _verdict(done: Simulation) -> str:
    if done.flight.linking is None:
        return "not simulated to its end: nothing is known of the hitch"
    if done.task.ends_formed:
        held = done.outcome.hitched
        return "hitched: every vertex is linked and held" if held else "NOT hitched"
    return "NOT untied" if done.flight.linking.any() else "untied: no two cables are linked"


def _fly_often(
    task: Task, settings: Settings, place: Path, runs: int, processes: int | None
) -> None:
    from hitchopt.cli.progress import LateProgress
    from hitchopt.cli.simulation_tables import campaign_tables
    from hitchopt.simulation.campaign import run_campaign, save_campaign

    with LateProgress(sys.stderr, "flying") as progress:
        campaign = run_campaign(task, settings, runs, processes, progress)
    save_campaign(place, campaign)
    say(campaign_tables(campaign))
    say(f"results are in {place}")
