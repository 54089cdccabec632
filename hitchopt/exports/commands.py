"""The commands export and lint: files of fleets."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import hitchopt as ho
from hitchopt.cli.failures import exit_infeasible
from hitchopt.cli.options import (
    PATH,
    assignment_option,
    command,
    completing,
    key_option,
    option,
    plan_path,
)
from hitchopt.cli.output import ProgressBar, record, say, show_places
from hitchopt.errors import InputError, Missing
from hitchopt.tables import table

if TYPE_CHECKING:
    import click

    from hitchopt.exports.exporting import Export
    from hitchopt.exports.lint import Report

MAX_LISTED = 5  # Maximum number of findings listed per rule


def placement_options() -> Sequence[click.Option]:
    """Return the options that place a plan in the frame of files or of drones."""
    from hitchopt.exports.options import ExportOptions
    from hitchopt.values.fields import keys_of

    keys = keys_of(ExportOptions)
    return (
        key_option("--origin", keys["origin"], "X Y Z"),
        key_option("--yaw-deg", keys["yaw"], "DEG"),
    )


def _format_option() -> Sequence[click.Option]:
    """Return the option for the format of an export, of hitchopt or of another package."""
    from hitchopt.exports.options import registered_formats

    names = [*registered_formats()]
    description = f"One of {', '.join(names)}."
    return (option("--format", description, str, "NAME", **completing(lambda: names)),)


def _export_options() -> Sequence[click.Option]:
    """Return the other options that ``ExportOptions`` declares."""
    from hitchopt.exports.options import ExportOptions
    from hitchopt.values.fields import keys_of

    keys = keys_of(ExportOptions)
    return (
        key_option("--frame", keys["frame"]),
        key_option("--rate", keys["rate"]),
        key_option("--stretch", keys["stretch"], "FACTOR"),
        key_option("--storage", keys["storage"]),
        key_option("--hold-tension", keys["hold_tension"]),
        key_option("--allow-slack", keys["allow_slack"]),
        key_option("--positions-only", keys["positions_only"]),
        key_option("--stiffness", keys["stiffness"]),
        key_option("--damping", keys["damping"], "N·S/M"),
    )


@command(
    "directory DIR",
    _format_option,
    option(
        "-o --output",
        "Output folder, or file for formats of one file; default: DIR-NAME.",
        PATH,
        "PATH",
    ),
    option(
        "--fleet",
        "YAML file that names drones, as drones: "
        "{q0: {name: cf1, uri: radio://…, type: cf21}, …}, or a crazyflies.yaml with a role for "
        "each robot.",
        PATH,
        "FILE",
    ),
    placement_options,
    _export_options,
    required=False,
)
def export(directory: Path | None, output: Path | None, yaw_deg: float, **options: Any) -> None:
    """Export the plan in DIR to a format of fleets, scripts or viewers, and certify the files.

    Without DIR or --format it lists the formats.
    """
    from hitchopt.exports.exporting import export_flight
    from hitchopt.exports.format import format_of, usable_formats
    from hitchopt.exports.options import ExportOptions
    from hitchopt.exports.placing import read_fleet
    from hitchopt.motion.plan_file import read_saved_plan

    if directory is None or options["format"] is None:
        summaries = [(kind.name, type(kind).__doc__ or "") for kind in usable_formats()]
        rows = [{"format": name, "what it is": text.partition("\n")[0]} for name, text in summaries]
        say(table("Formats", rows), err=True)
        key, remedy = "format", "choose one, such as --format csv"
        if directory is None and options["format"]:
            key, remedy = "DIR", "name the directory of a plan"
        raise InputError(key, Missing(), "given", remedy)
    parsed = ExportOptions(yaw=math.radians(yaw_deg), **options)
    format_of(parsed.format)  # report an unknown name before reading the plan
    path = plan_path(directory)
    if output is None:
        output = _beside(path.parent, parsed.format)
    with ProgressBar("certifying") as progress:
        saved = read_saved_plan(path)
        exports = export_flight(saved, parsed, output, progress)
    addresses = dict[str, str]()
    if parsed.fleet is not None:
        members = read_fleet(parsed.fleet, saved.flight.team.listed_names).members
        addresses = {each.role: f"{each.name}, {each.uri}" for each in members}
    show_places(saved.flight, addresses)
    reported = set[str]()  # notes of earlier parts
    for part in exports:
        _report_part(part, reported)
        reported |= {*part.notes}
    record(parts=[_part_entry(part) for part in exports])


def _beside(directory: Path, kind: str) -> Path:
    """Return the directory of the exports of a plan's directory, next to it."""
    is_unnamed = directory.name in {"", ".."}
    parent = directory / ".." if is_unnamed else directory.parent
    return parent / f"{directory.resolve().name or 'plan'}-{kind}"


def _report_part(part: Export, reported: Collection[str]) -> None:
    """Print certificate, errors, new notes and files of an exported part."""
    verdict = part.verdict
    position, velocity = verdict.position, verdict.velocity
    say(str(ho.Certificate(verdict.duration, verdict.checks)))
    say(
        f"at most {1e3 * position.worst:.3g} mm ({position.drone}, t = {position.time:.3f} s) "
        f"and {1e3 * velocity.worst:.3g} mm/s ({velocity.drone}, t = {velocity.time:.3f} s) "
        f"from the plan, at all times\n{verdict.not_carried}"
    )
    for note in part.notes:
        if note not in reported:
            say(f"note: {note}")
    state = "exported; cables go slack" if part.goes_slack else "certified as exported"
    count = len(part.files)
    files = str(part.folder / part.files[0]) if count == 1 else f"{count} files in {part.folder}"
    say(f"{state}; {files}")


def _part_entry(part: Export) -> dict[str, Any]:
    """Return what ``--json`` has of an exported part."""
    verdict = asdict(part.verdict)
    return {
        "folder": str(part.folder),
        "files": part.files,
        "begins": part.begins,
        "position_error": verdict.pop("position"),
        "velocity_error": verdict.pop("velocity"),
        **verdict,
        "notes": part.notes,
        "goes_slack": part.goes_slack,
    }


def _rule_options() -> Sequence[click.Option]:
    """Return the option for the limits of lint."""
    from hitchopt.exports.lint import Rules
    from hitchopt.values.fields import keys_of

    rules, separation = keys_of(Rules), keys_of(ho.Separation)
    limits = {name: rules[name] for name in ("speed", "acceleration")}
    semi_axes = {name: separation[name] for name in ("radius", "height")}
    words = "Limit, such as speed=2; may be repeated."
    return (assignment_option("--set limits", words, limits | semi_axes),)


@command("paths PATH...", _rule_options, nargs=-1, required=True)
def lint(paths: tuple[Path, ...], limits: dict[str, float]) -> None:
    """Check fleet files from any source and report errors.

    Each PATH is a file or a folder of any format that `export` writes, and a flight of its own.
    Limits that a show declares are always checked. Exits with code 3 if there are errors.
    """
    from hitchopt.exports.lint import Rules

    semi_axes = {name: limits[name] for name in ("radius", "height") if name in limits}
    separation = ho.Separation(**semi_axes)
    rules = Rules(limits.get("speed"), limits.get("acceleration"), separation)
    with ProgressBar("reading and checking"):
        reports = ho.lint(paths, rules)
    entries = []
    for report in reports:
        entry = asdict(report)
        entry |= {"path": str(report.path), "sound": report.sound, "drones": entry.pop("facts")}
        entries.append(entry)
        _say_report(report)
    record(reports=entries)
    if not all(report.sound for report in reports):
        exit_infeasible()


def _say_report(report: Report) -> None:
    """Print the figures, the findings, and their numbers."""
    from hitchopt.exports.contents import ERROR, WARNING
    from hitchopt.exports.formats.crazyflie import BYTES
    from hitchopt.values import counted

    facts, flight = report.facts, report.flight
    figures: list[tuple[str, float | None, float | None]] = [
        ("speed [m/s]", flight.speed, flight.speed_limit),
        ("acceleration [m/s²]", flight.acceleration, flight.acceleration_limit),
        *(
            (f"{own.name} [{own.unit}], declared by the show", own.worst, own.limit)
            for own in flight.own
        ),
        ("separation [ellipsoids]", flight.separation, 1.0),
        ("largest distance from the origin [m]", flight.reach, None),
        ("pieces of a drone", max(fact.pieces or 0 for fact in facts) or None, None),
        ("bytes of a drone", max(fact.size or 0 for fact in facts) or None, BYTES),
    ]
    for size, unit in zip(flight.jumps, ("m", "m/s", "m/s²"), strict=False):
        figures.append((f"jump between pieces [{unit}]", size, None))
    frame = f", frame {report.frame}" if report.frame else ""
    drones = counted(len(facts), "drone")
    title = f"{report.path}: {report.kind}, {drones}{frame}, {flight.duration:.3f} s"
    heads = ("figure", "worst", "limit")
    say(table(title, [dict(zip(heads, row, strict=True)) for row in figures if row[1] is not None]))
    by_rule: dict[tuple[str, str], list[str]] = {}
    for finding in report.findings:
        by_rule.setdefault((finding.level, finding.rule), []).append(str(finding))
    for (level, rule), lines in by_rule.items():
        if (more := len(lines) - MAX_LISTED) > 0:
            lines[MAX_LISTED:] = [f"{level}: {rule}: and {more} more"]
        say("\n".join(lines), err=level == ERROR)
    levels = [finding.level for finding in report.findings]
    say(f"{levels.count(ERROR)} errors, {levels.count(WARNING)} warnings")
