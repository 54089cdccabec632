"""The commands for fleets: export, lint."""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from hitchopt.cli.commands import main
from hitchopt.cli.failures import UNMET
from hitchopt.cli.output import record, say
from hitchopt.cli.paths import GivenPath, plan_path
from hitchopt.cli.shell_completion import complete_format
from hitchopt.exports.export_options import ROS_DISTROS, STORAGES

if TYPE_CHECKING:
    from hitchopt.exports.exporting import Export


@main.command()
@click.argument("directory", metavar="DIR", type=GivenPath())
@click.option(
    "--format",
    metavar="NAME",
    required=True,
    shell_complete=complete_format,
    help="One of those above.",
)
@click.option(
    "-o",
    "--output",
    "folder",
    metavar="PATH",
    type=GivenPath(),
    help="The folder to write, or the file where there is but one (plan.csv); by default DIR's "
    "name, a dash and NAME, next to DIR.",
)
@click.option("--frame", metavar="FRAME", help="enu, nwu or ned; by default the format's usual.")
@click.option(
    "--origin",
    metavar="X Y Z",
    type=(float, float, float),
    default=(0.0, 0.0, 0.0),
    help="Where the plan's origin lies in the file's frame: east, north, up [m].",
)
@click.option(
    "--yaw-deg",
    "yaw",
    metavar="DEG",
    default=0.0,
    callback=lambda _, __, degrees: math.radians(degrees),
    help="Angle by which the plan is turned there, counter-clockwise from above.",
)
@click.option(
    "--fleet",
    metavar="FILE",
    type=GivenPath(),
    help="YAML: drones: {q0: {name: cf1, uri: radio://0/80/2M/E7E7E7E701, type: cf21}, …}, "
    "or a crazyflies.yaml with a role for each robot.",
)
@click.option("--rate", metavar="HZ", type=float, help="Samples per second, where it samples.")
@click.option(
    "--stretch", metavar="FACTOR", default=1.0, help="Factor of all durations, from 1 on."
)
@click.option(
    "--storage", type=click.Choice([*STORAGES]), default="mcap", help="Storage of a ros2bag."
)
@click.option(
    "--ros-distro",
    type=click.Choice([*ROS_DISTROS]),
    default="humble",
    help="The release that a ros2bag is for; later ones read bags for earlier ones.",
)
@click.option(
    "--hold-tension",
    is_flag=True,
    help="Move set points outward, for controllers that do not feed the cable force forward.",
)
@click.option(
    "--stiffness", metavar="N/M", type=float, help="Of these controllers; by default the team's."
)
@click.option(
    "--damping",
    metavar="N·S/M",
    type=float,
    help="Of these controllers; by default that of a damping ratio of 5/6.",
)
def export(directory: Path, folder: Path | None, **options: Any) -> None:
    """Write the plan in DIR as fleets read it, and certify what was written.

    Formats: crazyswarm2, compressed, skybrush, skybrush_csv, mavsdk_drone_show, ros2bag; csv,
    parquet, npz, json for scripts.
    """
    from hitchopt.cli.progress import LateProgress
    from hitchopt.exports.export_options import ExportOptions
    from hitchopt.exports.formats.known_formats import format_of
    from hitchopt.exports.plan_export import export_motion
    from hitchopt.motion.plan_file import read_plan, read_title

    chosen = ExportOptions(**options)
    format_of(chosen.format)  # a wrong name before a long read
    path = plan_path(directory)
    place = _place(path.parent, chosen.format) if folder is None else folder
    with LateProgress(sys.stderr, "certifying") as progress:
        done = export_motion(read_plan(path), read_title(path), chosen, place, progress)
    record(parts=[_entry(part) for part in done])
    for part in done:
        _show(part)


def _place(directory: Path, name: str) -> Path:
    """Return the folder next to DIR that is called after both."""
    folder = f"{directory.resolve().name or 'plan'}-{name}"
    if directory.name in {"", ".."}:
        return directory / ".." / folder
    return directory.with_name(folder)


def _entry(part: Export) -> dict[str, Any]:
    """Return what was written, as ``--json`` prints it."""
    verdict = part.verdict
    return {
        "folder": str(part.folder),
        "files": list(part.files),
        "begins": part.begins,
        "duration": verdict.duration,
        "position_error": vars(verdict.position),
        "velocity_error": vars(verdict.velocity),
        "checks": [vars(check) for check in verdict.checks],
        "not_carried": verdict.not_carried,
        "notes": list(part.notes),
    }


def _show(part: Export) -> None:
    from hitchopt.checks import Certificate
    from hitchopt.cli.console_tables import certificate_table

    verdict = part.verdict
    say(certificate_table(Certificate(verdict.duration, verdict.checks)))
    position, velocity = verdict.position, verdict.velocity
    say(
        f"at most {1e3 * position.worst:.3g} mm ({position.drone}, t = {position.time:.3f} s) and "
        f"{1e3 * velocity.worst:.3g} mm/s ({velocity.drone}, t = {velocity.time:.3f} s) "
        "from the plan, over all time"
    )
    say(f"not carried: {verdict.not_carried}")
    for note in part.notes:
        say(f"note: {note}")
    say(f"certified as exported; {len(part.files)} files in {part.folder}")


@main.command()
@click.argument("path", metavar="PATH", type=GivenPath())
@click.option(
    "--speed",
    metavar="M/S",
    type=float,
    help="Limit; by default the show's own, or 3 where it has none.",
)
@click.option(
    "--acceleration",
    metavar="M/S²",
    type=float,
    help="Limit; by default the show's own, or 10 where it has none.",
)
@click.option("--radius", metavar="M", default=0.12, help="A drone's ellipsoid, across.")
@click.option("--height", metavar="M", default=0.3, help="A drone's ellipsoid, up.")
@click.option(
    "--relative",
    is_flag=True,
    help="Every drone flies from where it stands (initial_position, home), not in one frame.",
)
def lint(path: Path, relative: bool, **limits: float | None) -> None:
    """Read fleet files back, hitchopt's or anybody else's, and report what would go wrong.

    PATH is a file or a folder of any format that `export` writes. The limits that a show sets
    itself are always held. Ends with 3 if there are errors.
    """
    from hitchopt.cli.lint_report import report_entry, say_report
    from hitchopt.exports.lint.joint_flight import Rules
    from hitchopt.exports.lint.linting import lint as linted
    from hitchopt.requirements import Separation
    from hitchopt.values import positive

    given = {key: positive(f"--{key}", x) for key, x in limits.items() if x is not None}
    separation = Separation(given["radius"], given["height"])
    rules = Rules(given.get("speed"), given.get("acceleration"), separation)
    reports = linted(path, rules, relative=relative)
    record(reports=[report_entry(report) for report in reports])
    for report in reports:
        say_report(report)
    if not all(report.sound for report in reports):
        click.get_current_context().exit(UNMET)
