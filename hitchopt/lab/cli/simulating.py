"""The command simulate: simulated flights and campaigns."""

from __future__ import annotations

import math
import shlex
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hitchopt.cli.failures import exit_infeasible
from hitchopt.cli.options import (
    PATH,
    assignment_option,
    command,
    key_option,
    option,
    paper_option,
    picture_format,
    plan_path,
)
from hitchopt.cli.output import ProgressBar, known_text, quantities, say, span_text
from hitchopt.errors import InputError
from hitchopt.tables import table

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    import click

    from hitchopt.lab.simulation.campaign import Campaign
    from hitchopt.lab.simulation.exported import ExportedFlight
    from hitchopt.lab.simulation.judgement import Spread
    from hitchopt.lab.simulation.report import Simulation
    from hitchopt.lab.simulation.rests import Rest
    from hitchopt.lab.simulation.settings import Settings
    from hitchopt.lab.simulation.task import Task

RESULTS = "simulation"  # Default directory of the results, in DIR
ERROR_COLUMNS = ("mean", "deviation", "largest")
# Headings of tables by field, with units
OBJECT_COLUMNS = {
    "name": "object",
    "placed": "off the plan [m]",
    "tilted": "tilt [°]",
    "turned": "turn [°]",
    "slipped": "slip while carried [m]",
    "free": "free of cables",
}
CLASP_COLUMNS = {
    "name": "vertex",
    "linking": "linking number",
    "bearing": "contact force [N]",
    "least_bearing": "at least [N]",
    "moved": "slip if pulled [m]",
    "holds": "holds",
}
FIGURES = {
    "separation": "minimum separation of drones [ellipsoids]",
    "peak_tension": "largest tension [N]",
    "peak_thrust": "largest thrust [N]",
    "peak_tilt": "largest tilt [°]",
    "placed": "objects off the plan [cm]",
    "tilted": "tilt of objects [°]",
    "slipped": "slip of objects [cm]",
}
# Of these spreads campaigns show mean and largest value
SPREADS = {
    "vertex_error": "vertex error [cm]",
    "resting": "vertex error while the plan rests [cm]",
    "moving": "vertex error while vertices move [cm]",
    "tracking": "drone error [cm]",
    "tension_ratio": "tension / planned tension",
}
DISTRIBUTION_COLUMNS = {
    "mean": "mean",
    "deviation": "deviation",
    "median": "median",
    "high": "95 % below",
    "largest": "largest",
}
LOSS_ROWS = {
    "lost": "lost",
    "time": "time of the loss [s]",
    "among": "survivors that touch",
    "others": "survivors that touch cables or what is lost",
    "peak_tension": "largest tension since the loss [N]",
    "moved": "largest distance of a survivor from its setpoint [m]",
    "displaced": "largest displacement of a survivor since the loss [m]",
    "bound": "its bound, loss_displacement [m]",
    "taut_after": "time until cables are under tension again [s]",
    "hangs": "height of the lost drones at the end [m]",
    "linked": "clasps linked at the end",
}
# Errors of all vertices, and their labels
ERRORS = {
    "vertex_error": "all",
    "resting": "all, at rest",
    "moving": "all, moving",
    "without_sag": "all, without sag",
}


def _settings_options() -> Sequence[click.Option]:
    """Return the options that the keys of settings declare."""
    from hitchopt.lab.simulation.settings import Settings, perturbation_keys
    from hitchopt.values.fields import keys_of

    keys = keys_of(Settings)
    return (
        key_option("--seed", keys["seed"], "S"),
        key_option("--cables", keys["cables"]),
        assignment_option(
            "--perturb",
            "Value of a disturbance, or of a parameter of the plan, such as wind=0.1; may be "
            "repeated.",
            perturbation_keys(),
        ),
        key_option("--drones", keys["drones"]),
        key_option("--controller", keys["controller"]),
        key_option("--estimator", keys["estimator"]),
        key_option("--latency", keys["latency"], "SECONDS"),
        key_option("--upload/--stream", keys["upload"]),
    )


@command(
    "directory DIR",
    option("-o --output", "Output directory; default: DIR/simulation.", PATH, "OUT"),
    option("--plan", "Plan of an exported file; export folders have a copy.", PATH, "PLAN"),
    option(
        "--preset",
        "Ropes: fast, links of 30 mm, to see whether the hitch holds; accurate, links of 10 mm, "
        "correct friction, five times slower.",
        "fast",
        choices=("fast", "accurate"),
    ),
    option("--runs", "Simulate N flights, with seeds S, S+1, ….", int, "N"),
    option("--workers", "Processes; by default one per processor.", int, "N"),
    option(
        "--perturbed",
        "Downwash, noise of 1 cm and 3 cm/s, 0.05 N each of gusts and of steady wind, cables "
        "0.5 % and starts 2 cm off, objects 10 % in mass, 20 % in friction and 2 cm in place; "
        "--perturb overrides these. The team's cable friction always acts.",
    ),
    _settings_options,
    option(
        "--cut",
        "Let a robot drop its cable and leave upward at a time, such as 2@12.5; the others react "
        "as hitchopt react plans.",
        str,
        "ROBOT@SECONDS",
    ),
    option("--reaction/--no-reaction", "Let the others react to the loss.", True),
    paper_option("the picture of a single flight"),
)
def simulate(
    directory: Path,
    output: Path | None,
    plan: Path | None,
    runs: int | None,
    workers: int | None,
    cut: str | None,
    perturb: Mapping[str, Any],
    width: float | None,
    *,
    reaction: bool,
    **options: Any,
) -> None:
    """Simulate the plan or export in DIR with cables and drones (ropes need mujoco).

    DIR is a plan, or an export, a folder or file that hitchopt export wrote. An export is flown by
    its files, with their gains and filter and the pauses of fly.py between parts; a plan by the
    files or the stream that its controller takes. Options replace single settings.

    A single flight exits with 3 if drones touch, leave limits.tracking or the arena, or hit the
    ground in flight; if a cable is pulled with five times its planned tension; if a vertex does not
    hold at a rest; if an object is touched, dropped or not placed within 3 cm and 5° beyond the
    plan's tracking errors; or if the simulation leaves its valid range. With --cut it also does if
    anything but the falling cable is touched. A campaign (--runs) exits with 0 and reports the
    success rate. Vertex errors are distances in space, sag included.
    """
    from hitchopt.lab.simulation.commands import flown_gains
    from hitchopt.lab.simulation.exported import is_export
    from hitchopt.lab.simulation.judgement import warnings
    from hitchopt.lab.simulation.settings import settings_of
    from hitchopt.lab.simulation.task import read_task
    from hitchopt.motion.plan_file import read_saved_plan

    _check_flights(runs, workers, cut, width, reaction=reaction)
    exported = None
    if plan is not None or is_export(directory):
        exported, source = _read_export(directory, plan), plan or directory
        directory = directory if directory.is_dir() else directory.parent
    else:
        directory = source = plan_path(directory).parent
    settings = settings_of(**options, **perturb)
    with ProgressBar("reading the plan"):
        task = read_task(directory) if exported is None else exported.task
    if exported is not None:
        gains = flown_gains(task, settings)
        say(gains, gains=gains)
    if settings.drones is not None:
        drones = _disturbed_drones(task, settings)
        say(drones, drones=drones)
    if cut is not None:
        settings, task = _with_cut(settings, task, cut, react=reaction)
    for warning in warnings(task, settings):
        say(f"note: {warning}")
    folder = directory / RESULTS if output is None else output
    if runs is None:
        simulation = _flown(task, settings)
        if exported is None:
            saved = read_saved_plan(plan_path(directory))
            title, flight = saved.title, saved.flight
        else:
            title, flight = exported.title, exported.flight
        with ProgressBar("writing the results"):
            simulation.save(folder, title, flight, picture_format(width), width)
        _report(simulation, folder, source)
        return
    _fly_campaign(task, settings, runs, workers, folder)


def _check_flights(
    runs: int | None,
    workers: int | None,
    cut: str | None,
    width: float | None,
    *,
    reaction: bool,
) -> None:
    """Raise InputError for options of a single flight with several, or the reverse."""
    if runs is not None and cut is not None:
        raise InputError("cut", cut, "of a single flight", "omit --runs")
    if runs is not None and width is not None:
        raise InputError("width", width, "of the picture of a single flight", "omit --runs")
    if runs is None and workers is not None:
        raise InputError("workers", workers, "of several flights", "add --runs")
    if cut is None and not reaction:
        raise InputError("reaction", False, "omitted without a loss", "add --cut")


def _read_export(directory: Path, plan: Path | None) -> ExportedFlight:
    """Return an export with its plan, and report what it contains."""
    from hitchopt.lab.simulation.exported import read_exported

    with ProgressBar("reading the export"):
        exported = read_exported(directory, None if plan is None else plan_path(plan))
    say(str(exported), exported=exported.facts)
    return exported


def _fly_campaign(
    task: Task, settings: Settings, runs: int, workers: int | None, folder: Path
) -> None:
    """Simulate several flights; report and write their results."""
    from hitchopt.lab.simulation.campaign import (
        expected_seconds,
        processes,
        run_campaign,
        save_campaign,
    )
    from hitchopt.values import counted

    with ProgressBar("building ropes"):
        seconds, count = expected_seconds(task, settings), processes(runs, workers)
    if math.isfinite(seconds):
        total = f"about {math.ceil(runs / count) * seconds:.0f} s"
        say(f"{counted(runs, 'flight')} of about {seconds:.0f} s each, {count} at once: {total}")
    with ProgressBar("flying") as progress:
        campaign = run_campaign(task, settings, runs, workers, progress)
    save_campaign(folder, campaign)
    message = f"{_campaign_tables(campaign)}\nresults are in {folder}"
    say(message, directory=str(folder), campaign=campaign.to_dict())


def _with_cut(settings: Settings, task: Task, text: str, *, react: bool) -> tuple[Settings, Task]:
    """Return settings and task of a flight that loses a robot, and report the reaction."""
    from hitchopt.lab.simulation.cuts import task_with_cut
    from hitchopt.lab.simulation.settings import Loss

    loss = Loss.parsed(text)
    if task.received is not None:
        raise InputError("cut", text, "of a plan, since files do not react", "name a plan's folder")
    with ProgressBar("planning the reaction"):
        flown, found = task_with_cut(task, loss, react=react)
    if react:
        say(
            f"reaction: all rest at t = {loss.time + found.stops:.3f} s, drones at the ends begin "
            f"to move at {loss.time + found.starts:.3f} s, and the chain is taut at "
            f"{loss.time + found.taut:.3f} s"
        )
    return replace(settings, lost=loss), flown


def _flown(task: Task, settings: Settings) -> Simulation:
    """Simulate one flight; report what it flies, and how long that takes."""
    from hitchopt.lab.simulation.flight import FlightInProgress
    from hitchopt.lab.simulation.report import Simulation
    from hitchopt.lab.simulation.settings import CLASPS

    if settings.cables == CLASPS:
        with ProgressBar("flying") as progress:
            return Simulation.of(task, settings, progress)
    with ProgressBar("building ropes"):
        flight = FlightInProgress(task, settings)
        seconds = flight.expected_seconds()
    if flight.files:
        say(
            f"simulates the files that export would write ({flight.files}); to simulate files on "
            "disk, name the folder of their export",
            files=flight.files,
        )
    say(f"{flight.steps:,} steps, about {seconds:.0f} s")
    with ProgressBar("flying") as progress:
        return Simulation.judged(flight.flown(progress))


def _report(simulation: Simulation, folder: Path, source: Path) -> None:
    """Report one flight of a plan or an export.

    Exits with EXIT_INFEASIBLE unless it succeeded.
    """
    from hitchopt.lab.simulation.judgement import (
        FAILED,
        NOT_SIMULATED,
        UNSIMULATED,
        tracking_verdict,
    )
    from hitchopt.lab.simulation.report import ending, summary

    message = f"{flight_tables(simulation)}\n\n{ending(simulation)}; results are in {folder}"
    say(message, directory=str(folder), simulation=summary(simulation))
    if words := tracking_verdict(simulation.flight):
        say(words, tracking=words)
    for time, test in simulation.flight.pull_tests.items():
        if test.error is not None:
            say(f"note: no pull test at t = {time:.2f} s: {test.error}")
    plan = simulation.flight.task.flight
    is_comparable = plan is not None and len(plan.teams) == 1 and simulation.loss is None
    if simulation.errors.t.size and is_comparable:
        command = shlex.join(["hitchopt", "evaluate", str(folder), "--plan", str(source)])
        say(f"for a LaTeX table of the planned motion: {command}")
    for failure in simulation.outcome.failures:
        status = NOT_SIMULATED if failure.kind in UNSIMULATED else FAILED
        say(f"{status}: t = {failure.time:.2f} s, {failure.words}", err=True)
    if not simulation.outcome.succeeded:
        exit_infeasible()


def flight_tables(simulation: Simulation) -> str:
    """Return the tables of one flight's vertices, objects and figures."""
    import numpy as np

    from hitchopt.lab.simulation.report import summary

    content, figures, flight = summary(simulation), simulation.figures, simulation.flight
    spreads, nearest, separation = simulation.spreads, content["nearest"], content["separation"]
    densities = {key: np.atleast_1d(x) for key, x in content["density"].items()}
    grams = {key: span_text(1e3 * x, ".4g") for key, x in densities.items()}
    rows: dict[str, object] = {
        "minimum separation of drones [ellipsoids]": _of_pair(separation, ".2f"),
        "minimum distance of drones [m]": _of_pair(nearest, ".3f"),
        "drone errors [cm]": spread_text(spreads["tracking"]),
        "tension / planned tension": spread_text(spreads["tension_ratio"], 1.0, ".2f"),
        "largest tension [N]": figures["peak_tension"],
        "largest thrust [N]": figures["peak_thrust"],
        "largest tilt [°]": figures["peak_tilt"],
        "flown by": _flown_by(simulation.settings),
        "stiffness of position loops [N/m]": span_text(flight.gains.stiffness.ravel(), ".3g"),
        "cable density: simulated [g/m]": grams["simulated"],
        "cable density: planned [g/m]": grams["planned"],
        "extra rope for bends [mm]": f"≤ {1e3 * flight.extra_length:.1f}",
    }
    parts = []
    if content["clasps"]:
        parts.append(
            table(
                "Vertices after the flight", [_headed(x, CLASP_COLUMNS) for x in content["clasps"]]
            )
        )
    measured = simulation.settings.measures_vertices
    if simulation.errors.t.size and measured:
        errors, team = content["vertex_error"], flight.task.team
        each = {name: errors[name] for name in (team.point_names[p] for p in team.layout.clasps)}
        each |= {label: vars(simulation.spreads[name]) for name, label in ERRORS.items()}
        vertices = [
            {"vertex": name, **{key: known_text(100.0 * x) for key, x in values.items()}}
            for name, values in each.items()
        ]
        parts.append(table("Vertex errors, sag included [cm]", vertices))
    if simulation.rests:
        parts += _tables_of_rests(simulation.rests, measured=measured)
    if loss := content.get("loss"):
        loss |= {name: [" and ".join(x) for x in loss[name]] for name in ("among", "others")}
        parts.append(quantities("Loss", _headed(loss, LOSS_ROWS)))
    if content["objects"]:
        objects = [_headed(each, OBJECT_COLUMNS) for each in content["objects"]]
        parts.append(table("Objects after the flight, relative to the plan", objects))
    parts.append(quantities("Flight, errors as mean ± deviation (largest)", rows))
    return "\n\n".join([*parts, *_inexact(simulation.settings)])


def _campaign_rows(campaign: Campaign) -> Iterator[dict[str, object]]:
    """Yield the rows of the distributions of a campaign's figures."""
    figures, measured = campaign.figures, campaign.settings.measures_vertices
    headings = {
        f"{name}_{statistic}": f"{statistic} {heading}"
        for name, heading in SPREADS.items()
        for statistic in ("mean", "largest")
        if measured or name not in ERRORS
    }
    for name, heading in (headings | FIGURES).items():
        values = figures.get(name, [])
        if any(map(math.isfinite, values)):
            in_cm = "[cm]" in heading
            yield {"figure": heading} | _distribution(values, in_cm=in_cm)


def _distribution(values: Iterable[float], *, in_cm: bool) -> dict[str, object]:
    """Return the distribution of values, or of lengths [m] in centimetres, by heading."""
    from hitchopt.lab.simulation.campaign import Distribution

    unit, digits = (0.01, ".1f") if in_cm else (1.0, ".3g")
    each = vars(Distribution.of(values)).items()
    texts = {name: known_text(x / unit, digits=digits) for name, x in each}
    return _headed(texts, DISTRIBUTION_COLUMNS)


def _headed(values: Mapping[str, Any], headings: Mapping[str, str]) -> dict[str, object]:
    """Return the values that have headings, by heading."""
    return {heading: values[key] for key, heading in headings.items()}


def _tables_of_rests(rests: Sequence[Rest], *, measured: bool) -> list[str]:
    """Return the tables of every vertex, of the drones and of every object at every rest.

    Errors of vertices are shown if they are ``measured``.
    """
    vertices, drones, objects = list[dict[str, object]](), list[dict[str, object]](), []
    for rest in rests:
        label = {"rest": str(rest)}
        for name, vertex in rest.vertices.items():
            columns = ERROR_COLUMNS if measured else ()
            errors = {key: known_text(100.0 * getattr(vertex, key)) for key in columns}
            pulled = known_text(100.0 * vertex.moved)
            row = {"vertex": name, **errors, "slip if pulled": pulled, "holds": vertex.holds}
            vertices.append(label | row)
        sizes = zip(("horizontal", "vertical"), rest.drones, strict=True)
        of_drones: dict[str, object] = {key: known_text(100.0 * size) for key, size in sizes}
        if rest.within is not None:
            allowed = known_text(100.0 * rest.allowed.level, 100.0 * rest.allowed.height)
            of_drones |= {"allowed": allowed, "within": rest.within}
        drones.append(label | {"vertices": ", ".join(rest.vertices)} | of_drones)
        objects += [label | _headed(vars(each), OBJECT_COLUMNS) for each in rest.objects]
    parts = [
        table("Vertices at rest, where steps end [cm]", vertices),
        table("Largest errors of drones at rest, relative to the plan [cm]", drones),
    ]
    return [*parts, table("Objects at rest", objects)] if objects else parts


def _cables_of(settings: Settings) -> str:
    """Return the model of the cables in words."""
    from hitchopt.lab.simulation.settings import ROPES

    return f"preset {settings.preset.name}" if settings.cables == ROPES else settings.cables


def _inexact(settings: Settings) -> list[str]:
    """Return the line that says that a preset's links are too long to measure vertices, if so."""
    from hitchopt.lab.simulation.settings import ACCURATE, CLASPS

    preset = settings.preset
    line = (
        f"preset {preset.name}: links of {1e3 * preset.segment:g} mm catch at clasps and move "
        f"vertices by 1 to 2 cm; to measure vertices, use --cables {CLASPS}, or --preset "
        f"{ACCURATE.name} ({1e3 * ACCURATE.segment:g} mm)"
    )
    return [] if settings.measures_vertices else [line]


def _disturbed_drones(task: Task, settings: Settings) -> str:
    """Return in words what drones of a kind fly with."""
    from hitchopt.lab.simulation.commands import resolved
    from hitchopt.lab.simulation.settings import CALM

    usual = vars(CALM)
    values = {key: x for key, x in vars(settings.perturbations).items() if x != usual[key]}
    perturbed = ", ".join(f"{key}={value}" for key, value in values.items())
    return f"drones {settings.drones}: {_flown_by(resolved(task, settings))}; {perturbed or 'calm'}"


def _flown_by(settings: Settings) -> str:
    """Return controller, estimator and setpoints of a flight in words."""
    from hitchopt.lab.simulation.settings import ESTIMATORS, IDEAL

    if settings.controller == IDEAL:
        return IDEAL
    known = [name for name, each in ESTIMATORS.items() if each == (settings.estimator or IDEAL)]
    sent = "exported files" if settings.upload else "streamed setpoints"
    return f"{settings.controller}, estimator {known[0] if known else 'custom'}, {sent}"


def _of_pair(closest: Mapping[str, Any], digits: str) -> str:
    """Return the distance and the names of the two closest drones."""
    return f"{closest['distance']:{digits}}, {' and '.join(closest['drones'])}"


def spread_text(spread: Spread, unit: float = 0.01, digits: str = ".1f") -> str:
    """Return mean, deviation and largest value as text, of errors in centimetres."""
    if not math.isfinite(spread.mean):
        return "none"
    mean, deviation, largest = (f"{x / unit:{digits}}" for x in vars(spread).values())
    return f"{mean} ± {deviation} ({largest})"


def _campaign_tables(campaign: Campaign) -> str:
    """Return a campaign's success rate, and tables of figures and first failures."""
    (low, high), runs = campaign.interval, campaign.runs
    not_simulated, measured = campaign.not_simulated, campaign.settings.measures_vertices
    vertices = [
        {"rest": rest, "vertex": vertex} | _distribution(errors, in_cm=True)
        for (rest, vertex), errors in campaign.rests.items()
        if measured
    ]
    parts = [
        f"{campaign.successes} of {len(runs)} flights succeeded: "
        f"{campaign.successes / len(runs):.1%} ({low:.1%} to {high:.1%} at 95 %), "
        f"seeds {runs[0].seed} to {runs[-1].seed}, {_cables_of(campaign.settings)}"
    ]
    if not_simulated:
        parts.append(f"{not_simulated} could not be simulated and count as not succeeded")
    parts += [f"flown by: {_flown_by(campaign.settings)}", *_inexact(campaign.settings)]
    if vertices:
        parts.append(table("Mean errors of vertices at rest [cm]", vertices))
    parts.append(table("All flights", _campaign_rows(campaign)))
    if campaign.failures:
        parts.append(table("First failures", campaign.to_dict()["first_failures"]))
    return "\n\n".join(parts)
