"""The commands statics and calibrate: static equilibrium and calibration."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import hitchopt as ho
from hitchopt.cli.failures import exit_infeasible
from hitchopt.cli.options import (
    PATH,
    assignment_option,
    command,
    option,
    paper_option,
    picture_format,
    plan_path,
)
from hitchopt.cli.output import ProgressBar, known_text, record, say, span_text
from hitchopt.tables import table

if TYPE_CHECKING:
    from hitchopt.lab.statics.calibrate import Calibration

if TYPE_CHECKING:
    import click


def _statics_options() -> Sequence[click.Option]:
    """Return the options for real values of the team, and for their errors."""
    from hitchopt.lab.statics.equilibrium import condition_keys
    from hitchopt.lab.statics.tolerance import ERROR_KEYS

    return (
        assignment_option(
            "--perturb", "Real value, such as density=0.005; may be repeated.", condition_keys()
        ),
        option(
            "--tolerance",
            "Compute ranges for errors: --error, or ±1 cm of cables and ±2 cm of drones.",
        ),
        assignment_option(
            "--error",
            "Size of an error: cable=0.01 is a bound, cable=sd:0.01 a standard deviation; may be "
            "repeated.",
            ERROR_KEYS,
        ),
    )


@command(
    "directory DIR",
    option(
        "--at times",
        "Time [s]; may be repeated; default: 25 times with a taut hitch.",
        float,
        "T",
        multiple=True,
    ),
    _statics_options,
    paper_option(),
)
def statics(
    directory: Path,
    times: tuple[float, ...],
    perturb: dict[str, Any],
    error: dict[str, Any],
    width: float | None,
    *,
    tolerance: bool,
) -> None:
    """Compute the static equilibrium of the hitch in DIR: positions, tensions, and their ranges.

    Lengths, density, friction and controllers are the plan's by default. With friction, a vertex
    rests anywhere in its band, depending on the history of the clasps. Writes statics.json and
    a picture to DIR, or to DIR/TEAM for several teams. Exits with code 3 if a cable is slack or a
    clasp does not hold.
    """
    import numpy as np

    from hitchopt.hitch.forces import undetermined_tension
    from hitchopt.lab.statics.equilibrium import conditions_of, equilibrium
    from hitchopt.lab.statics.files import save_statics, statics_content
    from hitchopt.lab.statics.tolerance import ERROR_KEYS, ErrorSize, taut_times
    from hitchopt.lab.statics.tolerance import tolerance as ranges_of
    from hitchopt.motion.plan_file import read_plan

    path = plan_path(directory)
    usual = {name: ErrorSize(key.default) for name, key in ERROR_KEYS.items()}
    sizes = error or (usual if tolerance else {})
    errors = {f"{name}_error": size for name, size in sizes.items()}
    names = {"density": "cable_density"}  # in equilibrium
    picture = picture_format(width)
    conditions = {names.get(name, name): value for name, value in perturb.items()}
    lengths = conditions.get("cable_length")
    flight = read_plan(path)
    contents = dict[str, Any]()
    loose = list[str]()
    hitches = [each for each in flight.teams if each.motion.team.has_cables]
    for flown in hitches or flight.teams:
        part = flown.motion
        folder = path.parent / flown.name
        if isinstance(lengths, list) and len(lengths) == part.team.robots:
            conditions["cable_length"] = [lengths[robot] for robot in part.team.labels]
        t = list(times) if times else taut_times(part)
        with ProgressBar("settling"):
            if errors:
                ranges = ranges_of(part, t, **errors, **conditions)
                rest = ranges.equilibrium
            else:
                ranges = None
                rest = equilibrium(part, t, **conditions)
            save_statics(folder, rest, ranges, picture, width)
        content = contents[flown.name] = statics_content(rest, ranges)
        tables = _statics_tables(content)
        say(f"Team {flown.name}\n{tables}" if flown.name else tables)
        values = conditions_of(part.team, **conditions)
        for note in undetermined_tension(
            integral=bool(np.isinf(values["integral"][..., :2]).any()),  # level
            feed_forward=bool(values["feed_forward"].all()),
        ):
            say(f"note: {note}")
        say(f"statics.json and statics.{picture} are in {folder}")
        loose += map(flown.label, (*content["slack_cables"], *content["loose_clasps"]))
    record(directory=str(path.parent), statics=contents.get("", contents))
    if loose:
        say(f"slack cables or loose clasps: {', '.join(loose)}", err=True)
        exit_infeasible()


def _statics_tables(content: dict[str, Any]) -> str:
    """Return the tables of cables and vertices, with ranges over all times."""
    cables = []
    vertices = []
    t = content["t"]
    may_be_slack = content.get("may_be_slack", ())
    for each in content["cables"]:
        name = each["name"]
        slack = "yes" if any(each["slack"]) else "no"
        row = {"planned [N]": each["planned_tension"], "at rest [N]": each["tension"]}
        if "smallest" in each:
            row["range [N]"] = each["smallest"] + each["largest"]
            slack = "may be" if slack == "no" and name in may_be_slack else slack
        spans = {head: span_text(values) for head, values in row.items()}
        cables.append({"cable": name, **spans, "slack": slack})
    for each in content["vertices"]:
        pairs = list(zip(each["planned"], each["position"], strict=True))
        row = {"off the plan [mm]": f"{1e3 * max(math.dist(*pair) for pair in pairs):.1f}"}
        row["below the plan [mm]"] = span_text((1e3 * (p[2] - r[2]) for p, r in pairs), ".1f")
        inner, outer = zip(*each["band"], strict=True)
        if inner != outer:
            ends = f"{1e3 * min(inner):+.0f} to {1e3 * max(outer):+.0f}"
            row["band of rest, outward [mm]"] = ends
        if "radius" in each:
            row["range around it [mm]"] = f"±{1e3 * max(each['radius']):.1f}"
        vertices.append({"vertex": each["name"], **row})
    over = "smallest to largest value over the times"
    when = f"at t = {t[0]:g} s" if len(t) == 1 else f"at {len(t)} times, {t[0]:g} to {t[-1]:g} s"
    parts = [table(f"Cables: {over}", cables), table(f"Vertices: {over}", vertices), when]
    return "\n\n".join(parts)


@command(
    "recording RECORDING",
    option("--plan", "Plan that was flown; default: the plan next to RECORDING.", PATH, "DIR"),
    option("-o --output", "YAML file for the estimates of the team.", PATH, "FILE"),
    option("--density", "Measured density of the cables.", float, "KG/M"),
)
def calibrate(
    recording: Path, plan: Path | None, output: Path | None, density: float | None
) -> None:
    """Estimate a team's cables, friction and trims from a flight of a plan.

    RECORDING is a CSV file with the columns t, name, x, y, z: seconds from the plan's start, q0,
    r0, … or p0, …, and metres; the results of `hitchopt simulate`, DIR/simulation; or any recording
    that `hitchopt evaluate` reads. Estimates have standard errors; values that the recording does
    not determine are marked. Distances to the plan are in three dimensions.
    """
    folder = None if plan is None else plan_path(plan).parent
    with ProgressBar("estimating"):
        calibration = ho.calibrate(recording, folder, density=density)
    say(
        _calibration_tables(calibration),
        lengths=[vars(estimate) for estimate in calibration.lengths],
        stiffness=[vars(estimate) for estimate in calibration.stiffness],
        friction=vars(calibration.friction),
        trims=calibration.at_rests.trims.tolist(),
        errors=asdict(calibration.errors),
        vertex_error={
            "planned": calibration.planned_vertex_error,
            "calibrated": calibration.vertex_error,
        },
        notes=list(calibration.recording.notes),
    )
    if output is not None:
        calibration.save(output)
        say(f"wrote the team to {output}")


def _calibration_tables(calibration: Calibration) -> str:
    """Return the tables of estimates and of distances to the plan."""
    from hitchopt.lab.cli.simulating import spread_text
    from hitchopt.lab.simulation.judgement import Spread

    task = calibration.task
    team = task.team.of_problem
    estimates = [
        (f"length of cable {k} [m]", x, team.cable_length[k])
        for k, x in enumerate(calibration.lengths)
    ]
    per_kind = team.drones // len(calibration.stiffness)
    for k, estimate in enumerate(calibration.stiffness):
        names = ", ".join(team.drone_names[per_kind * k : per_kind * (k + 1)])
        stated = team.stiffness[per_kind * k, 0]
        estimates.append((f"stiffness of {names} [N/m]", estimate, stated))
    estimates.append(("friction", calibration.friction, team.friction))
    rows, remarks = [], []
    for name, estimate, planned in estimates:
        cells = {"value": "not determined", "± error": ""}
        if estimate.known:
            cells = {"value": f"{estimate.value:.5g}", "± error": f"{estimate.error:.1g}"}
        else:
            remarks.append(f"{name}: {estimate.remark}")
        rows.append({"quantity": name, **cells, "in the plan": float(planned)})
    columns = [*zip(team.point_names, calibration.vertex_errors.T, strict=True)]
    errors = calibration.drone_errors.T[task.team.listed]
    columns += zip(team.drone_names, errors, strict=True)
    distances = [{"of": name, "distance": spread_text(Spread.of(x))} for name, x in columns]
    title = "Errors [cm], mean ± standard deviation (largest)"
    remarks += [f"note: {note}" for note in calibration.recording.notes]
    tables = [table("Estimates", rows), *remarks, *_rest_tables(calibration)]
    return "\n\n".join([*tables, table(title, distances)]) + "\n"


def _rest_tables(calibration: Calibration) -> list[str]:
    """Return the table of trims, and the sentence on errors at rest; nothing without a rest."""
    from hitchopt.values import counted

    at_rests = calibration.at_rests
    team = calibration.task.team.of_problem
    if not len(at_rests.t):
        return []
    errors = at_rests.trim_errors
    rows = [
        {
            "drone": name,
            "trim [cm]": known_text(*(100.0 * at_rests.trims[k])),
            "± [cm]": known_text(100.0 * errors[k]) if math.isfinite(errors[k]) else "one rest",
            "in the plan [cm]": known_text(*(100.0 * at_rests.flown_trims[k])),
        }
        for k, name in enumerate(team.drone_names)
    ]
    found = calibration.errors
    largest = 100.0 * at_rests.largest_error
    text = f"Errors at rest: cables {100.0 * found.cable_length:.1f} cm, drones {largest:.1f} cm."
    before, after = calibration.planned_vertex_error, calibration.vertex_error
    if before is not None and after is not None:
        bounds = f"{100.0 * after:.3g} cm instead of {100.0 * before:.3g} cm"
        text += f" With them vertex_error is {bounds}."
    return [table(f"Trims from {counted(len(at_rests.t), 'rest')}", rows), text]
