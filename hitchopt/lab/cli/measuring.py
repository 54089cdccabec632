"""The command evaluate: list a recorded flight, compare it with its plan, and place markers."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import hitchopt as ho
from hitchopt.cli.options import PATH, command, option, paper_option, picture_format, plan_path
from hitchopt.cli.output import ProgressBar, known_text, say
from hitchopt.errors import InputError, Missing
from hitchopt.tables import table

if TYPE_CHECKING:
    from hitchopt.lab.flights.evaluation import Evaluation
    from hitchopt.lab.flights.recordings import RecordedFlight
    from hitchopt.lab.simulation.task import TeamTask

RESULTS = "evaluation"  # Default directory of the results, next to the recording


@command(
    "recording [RECORDING]",
    option(
        "--plan",
        "Plan or export that was flown; without it, the contents of the recording are listed.",
        PATH,
        "DIR",
    ),
    option("-o --output", "Output directory; default: evaluation next to RECORDING.", PATH, "OUT"),
    option("--names", "Drones by their recorded names, such as cf231=q0,cf7=r0,…", str, "NAMES"),
    option(
        "--frame",
        "plan, y-up, fit, or a file such as another flight's evaluation.json.",
        str,
        "FRAME",
    ),
    option(
        "--start", "Time of the recording at which the plan begins; otherwise fitted.", float, "S"
    ),
    option(
        "--unit",
        "Unit of lengths: m, cm, mm, in, ft; default: that of the file, or m.",
        str,
        "UNIT",
    ),
    option(
        "--topic",
        "Topic with the drones' positions, such as /cf1/pose, where * matches any text; default: "
        "measured, then estimated, then commanded positions.",
        str,
        "TOPIC",
    ),
    option("--density", "Measured density of the cables.", float, "KG/M"),
    option("--diameter", "Cable diameter: errors are then those of the clasps.", float, "M"),
    option("--window", "Time over which markers are averaged.", 0.1, "S"),
    paper_option(),
    option(
        "--markers", "Print where to place markers on the cables of the plan; needs no recording."
    ),
    required=False,
)
def evaluate(
    recording: Path | None,
    plan: Path | None,
    output: Path | None,
    width: float | None,
    *,
    markers: bool,
    **options: Any,
) -> None:
    """Compare RECORDING, a flight, with the plan in --plan: vertices (from markers) and drones.

    For an export, times are those of its files and of fly.py.

    Without a plan, the contents of RECORDING are listed: bodies, quantities, topics, rates and
    gaps. RECORDING is a table of Motive or Vicon, C3D, a ROS bag, Crazyflie uSD logs, a PX4 ulog,
    DIR/simulation, or a CSV file with the columns t, name, x, y, z, whose rows named marker are
    points without a name. Clock, frame and names are fitted. Writes evaluation.json, vertices.csv,
    evaluation.tex, a picture, and recording.npz, which `hitchopt view DIR --ghost OUT` shows.
    """
    from hitchopt.lab.simulation.exported import is_export, team_task
    from hitchopt.support import Feature

    task = None
    if plan is not None:
        task = team_task(plan if is_export(plan) else plan_path(plan).parent, Feature.EVALUATE)
    if markers:
        if task is None:
            remedy = "name the directory of the plan"
            raise InputError("plan", None, "used with markers=True", remedy)
        _say_markers(task)
        return
    if recording is None:
        bound = "a recording, or none with --markers"
        raise InputError("RECORDING", Missing(), bound, "name the file that was recorded")
    if task is None:
        with ProgressBar("reading"):
            flight = ho.read_flight(recording, options["unit"], options["topic"])
        _say_contents(flight)
        return
    from hitchopt.lab.flights.evaluation import LATEX, summary

    with ProgressBar("reading and evaluating"):
        result = ho.evaluate(recording, task, **options)
    beside = recording if recording.name else recording.absolute()  # but for `.`
    folder = beside.parent / RESULTS if output is None else output
    with ProgressBar("writing the results"):
        result.save(folder, picture_format(width), width)
    say(_tables(result), directory=str(folder), evaluation=summary(result))
    for remark in result.remarks:
        say(f"note: {remark}")
    say(f"results are in {folder}; {LATEX} is the LaTeX table")


WHOLE = ("moving", "resting", "all")  # Rows of the table that are not of one phase


def _tables(evaluation: Evaluation) -> str:
    """Return the tables of errors of vertices and drones, and of the alignment."""
    kind = "crossings" if evaluation.clasps is None else "clasps"
    drones = evaluation.task.team.drone_names
    rows: list[dict[str, object]] = []
    for row in evaluation.short_table:
        cells: dict[str, object] = {"of": row.name, "phase": row.phase}
        if row.phase not in WHOLE:
            cells["phase"] = f"{row.phase}, {row.start:.1f} to {row.end:.1f} s"
        errors = {"mean": row.mean, "std": row.std, "max": row.max}
        errors["standard error"] = row.standard_error
        millimetres = {name: known_text(1e3 * x) for name, x in errors.items()}
        rows.append({**cells, **millimetres, "found": f"{row.found:.0%}"})
    fit = evaluation.alignment
    parts = [
        table(f"Distances from the plan [mm], {kind} of cables and drones", rows),
        evaluation.sag,
        f"{evaluation.flight.source}: plan time is {fit.rate:.6g} t {fit.offset:+.3f} s, frame "
        f"{fit.frame}, drones {1e3 * fit.rms:.0f} mm from the plan (root mean square)",
    ]
    if any(math.isfinite(row.standard_error) for row in evaluation.short_table):
        parts.append(
            "standard errors include the scatter of markers about their cables; it is constant in "
            "a flight, so averaging over time does not reduce it"
        )
    if fit.names != drones:
        listed = ((fit.names[place], drones[place]) for place in evaluation.task.team.listed)
        parts.append("names: " + ", ".join(map("=".join, listed)))
    return "\n\n".join(parts)


def _say_contents(flight: RecordedFlight) -> None:
    """Report bodies and quantities of a recording, with topics, rates and gaps."""
    contents = flight.contents
    rows: list[dict[str, object]] = [
        {
            "body": f"{body} (load)" if body in flight.loads and body != "load" else body,
            "quantity": quantity.replace("_", " "),
            "of": each["topic"],
            "samples": each["samples"],
            "rate [Hz]": f"{each['rate']:.0f}",
            "largest gap [s]": f"{each['largest_gap']:.2f}",
            "from [s]": f"{each['start']:.2f}",
            "to [s]": f"{each['end']:.2f}",
        }
        for body, quantities in contents.items()
        for quantity, each in quantities.items()
    ]
    clock = "one clock" if flight.one_clock else "a separate clock for each body"
    if flight.clock_shifts:
        words = ", ".join(f"{name} {shift:+.3f} s" for name, shift in flight.clock_shifts.items())
        clock += f" (separate clocks shifted: {words})"
    points = f"{len(flight.markers.t)} unnamed points"
    say(
        "\n\n".join([table(flight.source, rows), f"{clock}; {points}"]),
        source=flight.source,
        bodies=contents,
        one_clock=flight.one_clock,
        epoch=flight.epoch,
        clock_shifts=dict(flight.clock_shifts),
        markers=len(flight.markers.t),
        notes=list(flight.notes),
    )
    for note in flight.notes:
        say(f"note: {note}")


def _say_markers(task: TeamTask) -> None:
    """Report the positions of markers on every cable."""
    from hitchopt.lab.flights.vertices import ROPE_SCATTER, marker_plan

    markers = marker_plan(task)
    team = task.team
    rows: list[dict[str, object]] = []
    for k, (lower, upper) in enumerate(markers.stretches.tolist()):
        stretch = f"{lower:.2f} to {upper:.2f}" if upper > lower else "nothing"
        positions = ", ".join(f"{position:.2f}" for position in markers.places[k])
        rows.append({"cable": k, "stays on its edge [m]": stretch, "markers at [m]": positions})
    errors: list[dict[str, object]] = [
        {"vertex": team.point_names[p], "median": known_text(x), "largest": known_text(y)}
        for p, (x, y) in enumerate((1e3 * markers.standard_errors).tolist())
        if not math.isnan(x)
    ]
    parts = [table("Markers from q's end of every cable", rows)]
    parts.append(table("Standard errors [mm]", errors))
    parts.append(f"of vertices, if markers scatter by {1e3 * ROPE_SCATTER:g} mm about their lines")
    content = vars(markers) | {"places": [each.tolist() for each in markers.places]}
    for name in ("stretches", "standard_errors"):
        content[name] = content[name].tolist()
    say("\n\n".join(parts), markers=content)
