"""The command ``simulate``: rope simulation of a plan's setpoints."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from hitchopt.cli.commands import main
from hitchopt.cli.failures import UNMET
from hitchopt.cli.output import record, say
from hitchopt.cli.paths import GivenPath, plan_path
from hitchopt.errors import FileError, InputError

if TYPE_CHECKING:
    from hitchopt.simulation.flight_task import Task
    from hitchopt.simulation.simulate import Simulation
    from hitchopt.simulation.simulation_settings import Settings
    from hitchopt.view.scene import Scene

RESULTS = "simulation"
"""Default directory of the results, in DIR."""

PATH = GivenPath()


@main.command()
@click.argument("directory", metavar="DIR", type=PATH)
@click.option("-o", "--output", metavar="OUT", type=PATH, help="Results; else DIR/simulation.")
@click.option(
    "--preset",
    type=click.Choice(["fast", "accurate"]),
    default="fast",
    help="fast: whether it holds; accurate: with correct friction, five times slower.",
)
@click.option(
    "--drones",
    "body",
    type=click.Choice(["rigid", "point"]),
    default="rigid",
    help="Rigid bodies with an attitude, or point masses.",
)
@click.option("--runs", metavar="N", type=int, help="Simulate N flights, with seeds S, S+1, ….")
@click.option("--seed", metavar="S", type=int, default=0, help="Random seed.")
@click.option("--processes", metavar="P", type=int, help="Processes; by default all processors.")
@click.option(
    "--perturbed",
    is_flag=True,
    help="Downwash, noise of 1 cm and 3 cm/s, 0.05 N each of gusts and of steady wind, cables "
    "0.5 % and starts 2 cm off, objects 10 % in mass, 20 % in friction and 2 cm in place; or as "
    "given. The team's cable friction always acts.",
)
@click.option("--noise", metavar="M", type=float, help="Error of measured positions per axis [m].")
@click.option("--velocity-noise", metavar="M/S", type=float, help="Of velocities, per axis [m/s].")
@click.option("--wind", metavar="N", type=float, help="Force of gusts on every drone [N].")
@click.option("--steady-wind", metavar="N", type=float, help="Constant level force on drones [N].")
@click.option("--lag", metavar="S", type=float, help="Time constant of the thrust [s].")
@click.option("--vertex-noise", metavar="M", type=float, help="Of measured vertices, per axis [m].")
@click.option("--vertex-delay", metavar="S", type=float, help="Age of measured vertices [s].")
@click.option("--cable-error", metavar="X", type=float, help="Relative error of cable lengths.")
@click.option("--start-error", metavar="M", type=float, help="Error of starts per axis [m].")
@click.option(
    "--downwash/--no-downwash", default=None, help="Whether drones push down those below them."
)
@click.option("--object-mass", metavar="X", type=float, help="Largest error of objects' masses.")
@click.option("--object-friction", metavar="X", type=float, help="Of their friction, relative.")
@click.option("--object-place", metavar="M", type=float, help="Of where they stand [m].")
@click.option(
    "--stiffness", metavar="N/M", type=float, help="Of position loops; by default the team's."
)
@click.option(
    "--integral/--no-integral", default=None, help="Integral action; by default the team's."
)
@click.option(
    "--feed-forward/--no-feed-forward",
    default=None,
    help="Whether the cable forces of setpoints.csv are added; by default the team's.",
)
@click.option(
    "--feedback",
    is_flag=True,
    help="Correct setpoints by measured vertices, as ho.Feedback does.",
)
@click.option("--friction", metavar="MU", type=float, help="Cable friction; by default the team's.")
@click.option("--density", metavar="KG/M", type=float, help="Cable density; by default the team's.")
@click.option(
    "--ground",
    metavar="M",
    type=float,
    help="Height of the ground [m]; by default 0 or lower; where there are objects, the arena's.",
)
@click.option(
    "--lose",
    metavar="DRONE@SECONDS",
    help="Stop a drone's motors then, such as q0@12.5; the others fly their certified reaction.",
)
@click.option(
    "--reaction/--no-reaction",
    default=True,
    help="Whether they do; else they fly on as if nothing had happened.",
)
@click.option("--film", metavar="FILE", type=PATH, help="Film of a single flight, .gif or .mp4.")
def simulate(
    directory: Path,
    output: Path | None,
    runs: int | None,
    processes: int | None,
    film: Path | None,
    lose: str | None,
    reaction: bool,
    **options: float | str | bool | None,
) -> None:
    """Simulate the setpoints in DIR with ropes and drones (needs mujoco).

    It reads the plan's team, and vertices.csv for the initial shape of the cables, for comparison,
    and for the length that the bends of thick simulated ropes use up, which it prints.
    Drones follow setpoints.csv and nothing else, unless --feedback corrects them: of the cables
    they feed forward cable_x, cable_y and cable_z. Vertex errors are distances in three dimensions,
    sag included. The exit code of one flight is 3 if anything fails: drones touch, a vertex does
    not hold, or an object is touched, dropped or not placed within 3 cm and 5°. It is also 3 if the
    simulation leaves its valid range, which is reported as not simulated and says nothing about the
    plan. With --lose it is 3 if a survivor touches anything, or if there is no reaction; no hitch
    is judged then. The exit code of a campaign (--runs) is 0; it reports the rate of success.
    """
    from hitchopt.simulation.flight_task import read_task
    from hitchopt.view.film import check_film

    directory = plan_path(directory).parent
    if film is not None:
        check_film(film)
        if runs is not None:
            remedy = "leave out --runs, give a seed"
            raise InputError("--film", str(film), "of a single flight", remedy)
    settings = _settings(options)
    task = read_task(directory)
    if lose is not None:
        if runs is not None:
            raise InputError("--lose", lose, "of a single flight", "leave out --runs")
        settings, task = _lost(directory, settings, task, lose, react=reaction)
    place = directory / RESULTS if output is None else output
    if runs is None:
        _simulate_one(task, settings, place, film, directory)
    else:
        _simulate_campaign(task, settings, place, runs, processes)


def _lost(
    directory: Path, settings: Settings, task: Task, text: str, *, react: bool
) -> tuple[Settings, Task]:
    """Return settings and task of a flight in which a drone is lost.

    Raises
    ------
    InputError: no such drone, or a time after the flight.
    InfeasibleError: there is no reaction to its loss.
    """
    from hitchopt.losing.flown_reaction import reacting
    from hitchopt.losing.reaction import Reactions
    from hitchopt.motion.plan_file import read_plan
    from hitchopt.simulation.simulation_settings import Loss
    from hitchopt.storage.archive import PLAN

    loss = Loss.parsed(text)
    settings = replace(settings, lost=loss)
    if not react:
        return settings, task
    found = Reactions(read_plan(directory / PLAN)).found(loss.drone, loss.time)
    course = found.course
    held, inward = found.held, found.inward
    also = "" if held is None else f"{loss.drone} is held until {held.ends:.3f} s, "
    if inward is not None:
        also += f"the others push inward from {inward.begins:.3f} to {inward.ends:.3f} s, "
    say(
        f"reaction: tension is let go from t = {course.begins:.3f} s on, {also}all are on the "
        f"ground at {course.duration:.3f} s; hovering with its weight takes up to "
        f"{found.thrust:.0%} of a thrust"
    )
    return settings, reacting(task, found)


def _settings(options: dict[str, float | str | bool | None]) -> Settings:
    """Return the settings that options of the command line ask for."""
    from hitchopt.simulation.simulation_settings import CALM, PRESETS, USUAL, Settings

    usual = USUAL if options.pop("perturbed") else CALM
    given = {name: options.pop(name) for name in vars(usual)}
    chosen: dict[str, Any] = {name: x for name, x in given.items() if x is not None}
    preset = PRESETS[str(options.pop("preset"))]
    others: dict[str, Any] = {**options, "preset": preset}
    return Settings(perturbations=replace(usual, **chosen), **others)


def _simulate_one(
    task: Task, settings: Settings, place: Path, film: Path | None, directory: Path
) -> None:
    """Simulate, save and report one flight; exit with UNMET unless it succeeded."""
    from hitchopt.cli.progress import LateProgress
    from hitchopt.cli.simulation_tables import flight_tables, headline
    from hitchopt.motion.plan_file import read_plan, read_title
    from hitchopt.simulation.flight_outcome import FAILED, NOT_SIMULATED, UNSIMULATED
    from hitchopt.simulation.run_report import save_simulation, summary
    from hitchopt.simulation.simulate import simulate as simulated
    from hitchopt.storage.archive import PLAN

    with LateProgress(sys.stderr, "building ropes") as progress:
        done = simulated(task, settings, progress)
    plan, title = read_plan(directory / PLAN), read_title(directory / PLAN)
    save_simulation(place, done, plan, title)
    record(directory=str(place), simulation=summary(done))
    say(flight_tables(done))
    say(f"{_verdict(done)}; results are in {place}")
    say(headline(done))
    for failure in done.outcome.failures:
        word = NOT_SIMULATED if failure.kind in UNSIMULATED else FAILED
        say(f"{word}: t = {failure.time:.2f} s, {failure.words}", err=True)
    if film is not None:
        from hitchopt.simulation.flight_picture import flight_scene

        scene = flight_scene(done, plan)
        if scene is None:
            raise FileError(f"{film}: the flight ended before there was anything to film")
        save_flight_film(film, scene, title)
    if not done.outcome.succeeded:
        click.get_current_context().exit(UNMET)


def save_flight_film(path: Path, scene: Scene, title: str) -> None:
    """Write the film of a simulated flight."""
    from hitchopt.cli.progress import LateProgress
    from hitchopt.view.film import save_film

    with LateProgress(sys.stderr, "drawing the film") as progress:
        words = f"{title} (simulated)".strip()
        save_film(path, scene, words, lambda share: progress(f"drawing the film, {share:.0%}"))
    say(f"the film is {path}")


def _verdict(done: Simulation) -> str:
    """Return the verdict on a flight's hitch in words."""
    if done.loss is not None:
        return "no two survivors touch" if done.loss.apart else "survivors TOUCH each other"
    if done.flight.linking is None:
        return "not simulated to its end: nothing is known of the hitch"
    if done.flight.task.formed[-1]:
        held = done.outcome.hitched
        return "hitched: every vertex is linked and held" if held else "NOT hitched"
    return "NOT untied" if done.flight.linking.any() else "untied: no two cables are linked"


def _simulate_campaign(
    task: Task, settings: Settings, place: Path, runs: int, processes: int | None
) -> None:
    """Simulate, save and report a campaign."""
    from hitchopt.cli.progress import LateProgress
    from hitchopt.cli.simulation_tables import campaign_tables
    from hitchopt.sweeps.campaign import run_campaign, save_campaign

    with LateProgress(sys.stderr, "flying") as progress:
        campaign = run_campaign(task, settings, runs, processes, progress)
    save_campaign(place, campaign)
    record(directory=str(place), campaign=campaign.to_dict())
    say(campaign_tables(campaign))
    say(f"results are in {place}")
