"""The commands simulate and sweep: simulated flights, campaigns and parameter studies."""

from __future__ import annotations

import math
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import hitchopt as ho
from hitchopt.cli.failures import exit_infeasible
from hitchopt.cli.options import PATH, command, option, plan_path
from hitchopt.cli.output import ProgressBar, quantities, say, span_text, table
from hitchopt.errors import InputError

if TYPE_CHECKING:
    from hitchopt.lab.simulation.judgement import Simulation, Spread
    from hitchopt.lab.simulation.settings import Settings
    from hitchopt.lab.simulation.task import Task
    from hitchopt.lab.sweeps.campaign import Campaign
    from hitchopt.lab.sweeps.sweep import Summary

RESULTS = "simulation"  # Default directory of the results, in DIR
# Message instead of vertex errors in flights of the fast preset
INEXACT = "the fast preset is 1 to 2 cm off; take the accurate one"
OBJECT_COLUMNS = ("name", "placed", "tilted", "turned", "slipped", "free")
# Figures that only exact presets have, and their labels
ERRORS = {
    "vertex_error": "vertices, sag included [cm]",
    "resting": "  while the plan stands still",
    "moving": "  while it moves",
    "without_sag": "vertices without sag (level part) [cm]",
}
MAX_REASONS, MAX_POINTS = 8, 40  # Maximum numbers of limits and points of a sweep that are listed


@command(
    "directory DIR",
    option("-o --output", "Results; else DIR/simulation.", PATH, "OUT"),
    option(
        "--preset",
        "Whether it holds; or with correct friction, five times slower.",
        "fast",
        choices=("fast", "accurate"),
    ),
    option("--runs", "Simulate N flights, with seeds S, S+1, ….", int, "N"),
    option("--seed", "Random seed.", 0, "S"),
    option("--processes", "Processes; by default all processors.", int, "P"),
    option(
        "--perturbed",
        "Downwash, noise of 1 cm and 3 cm/s, 0.05 N each of gusts and of steady wind, cables "
        "0.5 % and starts 2 cm off, objects 10 % in mass, 20 % in friction and 2 cm in place;"
        " or as given. The team's cable friction always acts.",
    ),
    option("--noise", "Error of measured positions per axis [m].", float, "M"),
    option("--velocity-noise", "Of velocities, per axis [m/s].", float, "M/S"),
    option("--wind", "Force of gusts on every drone [N].", float, "N"),
    option("--steady-wind", "Constant level force on drones [N].", float, "N"),
    option("--lag", "Time constant of the thrust [s].", float, "S"),
    option("--vertex-noise", "Of measured vertices, per axis [m].", float, "M"),
    option("--vertex-delay", "Age of measured vertices [s].", float, "S"),
    option("--cable-error", "Relative error of cable lengths.", float, "X"),
    option("--start-error", "Error of starts per axis [m].", float, "M"),
    option("--downwash/--no-downwash", "Whether drones push down those below them.", None),
    option("--object-mass", "Largest error of objects' masses.", float, "X"),
    option("--object-friction", "Of their friction, relative.", float, "X"),
    option("--object-place", "Of where they stand [m].", float, "M"),
    option(
        "--stiffness",
        "Of position loops; by default the team's, as the following two.",
        float,
        "N/M",
    ),
    option("--friction", "Cable friction.", float, "MU"),
    option("--density", "Cable density.", float, "KG/M"),
    option(
        "--controller",
        "Flight controller: mellinger, lee, pid or px4, at its own rates, with motors that "
        "lag 30 ms; its gains are the team's where it names this controller, else the "
        "stiffest that fly. By default a quick one, which is none of these.",
        str,
        "NAME",
    ),
    option(
        "--estimator",
        "What it knows of its state: the truth but for --noise and --velocity-noise, or what "
        "a Crazyflie's filter makes of motion capture (100 Hz, 1 mm, --latency) and an IMU, "
        "with the parameters that are exported, or with the firmware's own, for rigid bodies "
        "or for one marker.",
        "ideal",
        choices=("ideal", "crazyflie", "firmware", "one_marker"),
    ),
    option(
        "--latency",
        "Delay of motion capture and streamed setpoints, with such a filter; by default the "
        "team's, or 0.01.",
        float,
        "SECONDS",
    ),
    option(
        "--upload",
        "It flies exported files, which hold the tension by offsets if it has no integral.",
    ),
    option("--feedback", "Correct setpoints by measured vertices, as ho.Feedback does."),
    option(
        "--lose", "Stop its motors then, such as q0@12.5; the others react.", str, "DRONE@SECONDS"
    ),
    option("--reaction/--no-reaction", "Or they fly on as if nothing had happened.", True),
)
def simulate(
    directory: Path,
    output: Path | None,
    runs: int | None,
    processes: int | None,
    lose: str | None,
    *,
    reaction: bool,
    **options: Any,
) -> None:
    """Simulate the plan in DIR with ropes and drones (needs mujoco).

    Drones follow the plan's setpoints at 100 Hz, including cable forces, without feedback of
    vertices unless --feedback is set. Vertex errors are distances in three dimensions, including
    sag. A single flight ends with 3 if drones touch, a vertex does not hold, an object is touched,
    dropped or not placed within 3 cm and 5°, or the simulation leaves its valid range; with --lose,
    if a survivor touches anything or there is no reaction. A campaign (--runs) ends with 0 and
    reports the success rate.
    """
    from hitchopt.lab.simulation.judgement import warnings
    from hitchopt.lab.simulation.settings import settings_of
    from hitchopt.lab.simulation.task import read_task
    from hitchopt.lab.sweeps.campaign import run_campaign, save_campaign

    directory = plan_path(directory).parent
    if lose is not None and runs is not None:
        raise InputError("lose", lose, "of a single flight", "leave out --runs")
    settings = settings_of(**options)
    with ProgressBar("reading the plan"):
        task = read_task(directory)
    if lose is not None:
        settings, task = _with_loss(directory, settings, task, lose, react=reaction)
    for warning in warnings(task, settings):
        say(f"note: {warning}")
    folder = directory / RESULTS if output is None else output
    if runs is None:
        _simulate_one(task, settings, folder, directory)
        return
    with ProgressBar("flying") as progress:
        campaign = run_campaign(task, settings, runs, processes, progress)
    save_campaign(folder, campaign)
    message = f"{_campaign_tables(campaign)}\nresults are in {folder}"
    say(message, directory=str(folder), campaign=campaign.to_dict())


def _with_loss(
    directory: Path, settings: Settings, task: Task, text: str, *, react: bool
) -> tuple[Settings, Task]:
    """Return settings and task of a flight with the loss of a drone, and report the reaction."""
    from hitchopt.lab.simulation.settings import Loss
    from hitchopt.live.lost import RELEASE_TIME, Reactions
    from hitchopt.motion.plan_file import read_plan

    loss = Loss.parsed(text)
    settings = replace(settings, lost=loss)
    if not react:
        return settings, task
    with ProgressBar("planning the reaction"):
        reaction = Reactions(read_plan(plan_path(directory))).plan(loss.drone, loss.time)
    say(
        f"reaction: tension is let go from t = {reaction.start:.3f} s on, all are on the ground "
        f"at {reaction.motion.duration:.3f} s; hovering with its weight takes up to "
        f"{reaction.thrust:.0%} of a thrust"
    )
    return settings, task.released(reaction.motion, reaction.start, RELEASE_TIME)


def _simulate_one(task: Task, settings: Settings, folder: Path, directory: Path) -> None:
    """Simulate, save and report one flight; exit with EXIT_INFEASIBLE unless it succeeded."""
    from hitchopt.lab.simulation.judgement import FAILED, NOT_SIMULATED, UNSIMULATED
    from hitchopt.lab.simulation.judgement import simulate as simulate_task
    from hitchopt.lab.simulation.report import ending, save_simulation, summary
    from hitchopt.motion.plan_file import read_saved_plan

    with ProgressBar("building ropes") as progress:
        simulation = simulate_task(task, settings, progress)
    saved = read_saved_plan(plan_path(directory))
    with ProgressBar("writing the results"):
        save_simulation(folder, simulation, saved.motion, saved.title)
    message = f"{flight_tables(simulation)}\n\n{ending(simulation)}; results are in {folder}"
    say(message, directory=str(folder), simulation=summary(simulation))
    for failure in simulation.outcome.failures:
        status = NOT_SIMULATED if failure.kind in UNSIMULATED else FAILED
        say(f"{status}: t = {failure.time:.2f} s, {failure.words}", err=True)
    if not simulation.outcome.succeeded:
        exit_infeasible()


def flight_tables(simulation: Simulation) -> str:
    """Return the tables of one flight's vertices, objects and figures."""
    from hitchopt.lab.simulation.report import summary

    content, figures, flight = summary(simulation), simulation.figures, simulation.flight
    exact, nearest = simulation.settings.preset.exact, content["nearest"]
    spreads = simulation.spreads
    rows: dict[str, object] = {}
    if exact:
        rows |= {label: spread_text(spreads[name]) for name, label in ERRORS.items()}
    rows |= {
        "drones to their setpoints [cm]": spread_text(spreads["tracking"]),
        "largest tension [N]": figures["peak_tension"],
        "largest thrust [N]": figures["peak_thrust"],
        "largest tilt [°]": figures["peak_tilt"],
        "stiffness of position loops [N/m]": span_text(flight.gains.stiffness.ravel(), ".3g"),
        "nearest drones [m]": f"{nearest['distance']:.3f}, {' and '.join(nearest['drones'])}",
        "ropes weigh [g/m]": _grams(content["density"]["simulated"]),
        "  as the plan knows": _grams(content["density"]["planned"]),
        "ropes longer for their bends [mm]": f"≤ {1e3 * flight.extra_length:.1f}",
    }
    parts = []
    if content["clasps"]:
        parts.append(table("Vertices after the flight [N, m]", map(dict, content["clasps"])))
    if loss := content.get("loss"):
        loss |= {name: [" and ".join(x) for x in loss[name]] for name in ("among", "others")}
        parts.append(quantities("Loss of a drone [s, N, m]", loss))
    if content["objects"]:
        objects = [{key: each[key] for key in OBJECT_COLUMNS} for each in content["objects"]]
        parts.append(table("Objects, to the plan's, and while carried [m, °]", objects))
    parts.append(quantities("Flight, errors as mean ± deviation (largest)", rows))
    return "\n\n".join(parts if exact else [*parts, f"vertex errors: {INEXACT}"])


def _grams(densities: float | list[float]) -> float | str:
    """Return a density, or the range of several [kg/m], in grams per metre."""
    if isinstance(densities, float):
        return 1e3 * densities
    return span_text((1e3 * x for x in densities), ".4g")


def spread_text(spread: Spread) -> str:
    """Return mean, deviation and largest value of errors in centimetres, as text."""
    if not math.isfinite(spread.mean):
        return "none"
    return f"{100 * spread.mean:.1f} ± {100 * spread.deviation:.1f} ({100 * spread.largest:.1f})"


def _campaign_tables(campaign: Campaign) -> str:
    """Return a campaign's success rate, and tables of figures and first failures."""
    (low, high), runs = campaign.interval, campaign.runs
    exact, not_simulated, rows = campaign.settings.preset.exact, campaign.not_simulated, []
    for name in max((run.figures for run in runs), key=len):  # flights that fail to start have none
        values = [x for run in runs if math.isfinite(x := run.figures.get(name, math.nan))]
        if values and (exact or not name.startswith(tuple(ERRORS))):
            row = {"mean": sum(values) / len(values), "largest": max(values)}
            rows.append({"figure": name.replace("_", " "), **row})
    parts = [
        f"{campaign.successes} of {len(runs)} flights succeeded: "
        f"{campaign.successes / len(runs):.1%} ({low:.1%} to {high:.1%} at 95 %), "
        f"seeds {runs[0].seed} to {runs[-1].seed}, preset {campaign.settings.preset.name}"
    ]
    if not_simulated:
        parts.append(f"{not_simulated} could not be simulated and count as not succeeded")
    parts += [] if exact else [f"vertices: {INEXACT}"]
    parts.append(table("All flights [m, N, °]", rows))
    if campaign.failures:
        parts.append(table("First failures", campaign.to_dict()["first_failures"]))
    return "\n\n".join(parts)


@command(
    "study STUDY",
    option("-o --output", "Results; else ./ and the stem.", PATH, "DIR"),
    option("--workers", "Processes; by default all processors.", int, "N"),
    option("--scheduler", "A dask scheduler, such as tcp://host:8786.", str, "ADDRESS"),
)
def sweep(study: Path, output: Path | None, workers: int | None, scheduler: str | None) -> None:
    """Plan or simulate every case of STUDY.yaml (needs dask.distributed).

    Every result is saved at once as a line of DIR/rows.jsonl. The same command continues an
    interrupted sweep: only missing rows are computed. If STUDY is the DIR of a sweep, its results
    are shown.
    """
    from hitchopt.lab.sweeps.sweep import PICTURE, draw_sweep, outcomes, read_study, summary
    from hitchopt.view.style import atomic_write, save_figure

    folder = study if study.is_dir() else Path(study.stem) if output is None else output
    if not study.is_dir():
        with ProgressBar("starting workers") as progress:
            ho.run_sweep(study, folder, workers=workers, scheduler=scheduler, progress=progress)
    rows = ho.load_sweep(folder)
    sweep, points = summary(rows, len(read_study(folder)["cases"])), outcomes(rows)
    say(_sweep_tables(sweep, points), directory=str(folder), summary=asdict(sweep), points=points)
    if (figure := draw_sweep(points)) is not None:
        with atomic_write(folder / PICTURE) as path:
            save_figure(figure, path)
        say(f"drawn in {folder / PICTURE}")
    say(f"rows are in {folder}; ho.load_sweep returns them for pandas")


def _sweep_tables(sweep: Summary, points: list[dict[str, Any]]) -> str:
    """Return the results of a sweep's points, and its totals."""
    binding = [{"limit": name, "rows": count} for name, count in sweep.binding[:MAX_REASONS]]
    parts = [table("What bound", binding)] if binding else []
    parts.append(table("Plans", points[:MAX_POINTS]))
    parts += [f"{len(points) - MAX_POINTS} more"] if len(points) > MAX_POINTS else []
    count, share = f"{sweep.planned.rows} of {sweep.cases} rows", sweep.planned
    parts.append(f"{count}; planned: {share.count} of {share.rows}")  # not a random sample
    if sweep.succeeded is not None:
        parts.append(f"simulated flights that succeeded: {sweep.succeeded}")
    return "\n\n".join(parts)
