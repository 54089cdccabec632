"""The command ``abort``: certified aborts for every time of a plan."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from hitchopt.cli.commands import main
from hitchopt.cli.failures import UNMET
from hitchopt.cli.output import record, say
from hitchopt.cli.paths import GivenPath, plan_path

HOWS = ("hold", "back", "release_and_land", "land")


@main.command()
@click.argument("directory", metavar="DIR", type=GivenPath())
@click.option(
    "--how",
    type=click.Choice([*HOWS]),
    help="hold: stop and stay; back: fly backward until cables hang free; release_and_land: untie "
    "and land; land: straight down. By default release_and_land, land without cables.",
)
@click.option(
    "--every", metavar="SECONDS", default=2.0, show_default=True, help="Distance of the entries."
)
def abort(directory: Path, how: str | None, every: float) -> None:
    """Plan and certify aborts over all of the plan in DIR.

    Writes aborts.json and aborts.zip to DIR: from every time the common clock alone, running on and
    then slowing to rest, reaches an entry, whose plan goes on from there. Ends with 3 if there are
    times from which no abort was found.
    """
    from hitchopt.checks.bounds.static_thrust import largest_static_thrust, largest_static_tilt
    from hitchopt.cli.console_tables import new_table, rendered
    from hitchopt.cli.progress import LateProgress
    from hitchopt.motion.plan_file import read_plan
    from hitchopt.stopping.abort_table import abort_table, save_aborts

    path = plan_path(directory)
    motion = read_plan(path)
    chosen = how or ("release_and_land" if motion.team.has_cables else "land")
    with LateProgress(sys.stderr, "planning aborts") as progress:
        table = abort_table(motion, chosen, every, progress)
    shown = new_table(f"Aborts: {chosen}", ["phase"], ["commands until", "at rest after", "ends"])
    for entry in table.entries:
        phase = next((p for p in motion.phases if p.end >= entry.rest - 1e-6), motion.phases[-1])
        ends = entry.certified.motion.duration
        times = (entry.start, entry.start + entry.seconds, ends)
        shown.add_row(phase.name, *(f"{t:.3f} s" for t in times))
    say(rendered(shown))
    thrust, tilt = largest_static_thrust(motion), largest_static_tilt(motion)
    say(f"hovering anywhere on the paths takes up to {thrust:.1%} of a drone's thrust, {tilt:.2f}°")
    save_aborts(path.parent, table)
    record(
        directory=str(path.parent),
        how=table.how,
        entries=[{"start": entry.start, "seconds": entry.seconds} for entry in table.entries],
        missing=[list(span) for span in table.missing],
        longest=table.longest if table.entries else None,
    )
    say(f"aborts.json and aborts.zip are in {path.parent}")
    if table.entries:
        say(f"at rest {table.longest:.3f} s after any command at the latest")
    if table.missing:
        spans = ", ".join(f"{a:.4g} s to {b:.4g} s" for a, b in table.missing)
        say(f"no abort was found for commands from {spans}", err=True)
        click.get_current_context().exit(UNMET)
