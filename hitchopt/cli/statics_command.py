"""The command ``statics``: where a plan's hitch comes to rest, and in which ranges."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np
from rich.text import Text

from hitchopt.cli.commands import main
from hitchopt.cli.console_tables import new_table, rendered
from hitchopt.cli.failures import UNMET
from hitchopt.cli.output import record, say
from hitchopt.cli.paths import GivenPath, plan_path
from hitchopt.errors import InputError

if TYPE_CHECKING:
    from hitchopt.settling.error_sizes import Errors

USUAL_CABLE, USUAL_POSITION = "0.01", "0.02"
"""[m] Bounds of errors if --tolerance stands alone: cables cut to a centimetre, drones flown by
motion capture."""

MAX_TIMES = 1000
"""Most times that one call settles."""


@main.command()
@click.argument("directory", metavar="DIR", type=GivenPath())
@click.option("--at", "times", metavar="T", type=float, multiple=True, help="Time [s]; repeatable.")
@click.option(
    "--samples", metavar="N", type=int, default=25, show_default=True, help="Times without --at."
)
@click.option("--stiffness", metavar="N/M", type=float, help="Of the position loops; inf is rigid.")
@click.option("--integral/--no-integral", default=None, help="Position errors are driven to zero.")
@click.option(
    "--feed-forward/--no-feed-forward", default=None, help="The cable force is fed forward."
)
@click.option("--cable-length", metavar="M[,M…]", help="Real lengths: one, or one per cable [m].")
@click.option("--density", metavar="KG/M", type=float, help="Real cable density.")
@click.option("--load", metavar="KG", type=float, help="Real mass at every clasp.")
@click.option("--axial-stiffness", metavar="N", type=float, help="EA of the cables; 10 kN.")
@click.option(
    "--tolerance", is_flag=True, help="Ranges for errors: cables ±1 cm, drones ±2 cm, or as given."
)
@click.option("--cable-error", metavar="M", help="Error of cable lengths: 0.01 bound, sd:0.01.")
@click.option("--position-error", metavar="M", help="Error of drones' positions, likewise.")
@click.option("--force-error", metavar="N", help="Error of the force feed-forward, likewise.")
def statics(
    directory: Path,
    times: tuple[float, ...],
    samples: int,
    cable_length: str | None,
    density: float | None,
    tolerance: bool,
    cable_error: str | None,
    position_error: str | None,
    force_error: str | None,
    **given: Any,
) -> None:
    """Settle the hitch of the plan in DIR: where it rests, with what tensions, in which ranges.

    What is not given is the plan's: lengths, density, and the drones' controllers. Writes
    statics.json and statics.png to DIR. Ends with 3 if a cable is slack or a clasp does not hold.
    """
    from hitchopt.cli.progress import LateProgress
    from hitchopt.motion.plan_file import read_plan
    from hitchopt.settling.conditions import Conditions
    from hitchopt.settling.settle import settle_motion
    from hitchopt.settling.statics_file import save_statics, statics_content
    from hitchopt.settling.tolerance import taut_times, tolerance_of_motion

    path = plan_path(directory)
    sizes = {"cable": cable_error, "position": position_error, "force": force_error}
    errors = _errors(sizes, usual=tolerance)
    if not 0 < max(samples, len(times)) <= MAX_TIMES or samples < 1:
        raise InputError("--samples", samples, f"from 1 to {MAX_TIMES}", "25 are usual")
    chosen = {name: value for name, value in given.items() if value is not None}
    lengths = None if cable_length is None else _lengths(cable_length)
    conditions = Conditions(cable_length=lengths, cable_density=density, **chosen)
    motion = read_plan(path)
    t = list(times) if times else taut_times(motion, samples)
    with LateProgress(sys.stderr, "settling"):
        if errors is None:
            ranges, settled = None, settle_motion(motion, t, conditions)
        else:
            ranges = tolerance_of_motion(motion, t, errors, conditions)
            settled = ranges.settled
    say(statics_tables(settled, ranges))
    for note in conditions.notes(motion.team):
        say(f"note: {note}")
    save_statics(path.parent, settled, ranges)
    record(directory=str(path.parent), statics=statics_content(settled, ranges))
    say(f"statics.json and statics.png are in {path.parent}")
    if settled.slack_cables or settled.loose_clasps:
        names = ", ".join((*settled.slack_cables, *settled.loose_clasps))
        say(f"slack, or without hold: {names}", err=True)
        click.get_current_context().exit(UNMET)


def _lengths(text: str) -> float | list[float]:
    """Return the lengths that a text says, one or several."""
    try:
        lengths = [float(part) for part in text.split(",")]
    except ValueError:
        raise InputError("--cable-length", text, "numbers with commas", "2.4,2.41,2.39") from None
    return lengths[0] if len(lengths) == 1 else lengths


def _errors(texts: dict[str, str | None], *, usual: bool) -> Errors | None:
    """Return the errors that were given; None if there are none."""
    from hitchopt.settling.error_sizes import Errors, ErrorSize

    given = {name: text for name, text in texts.items() if text is not None}
    if not given and usual:
        given = {"cable": USUAL_CABLE, "position": USUAL_POSITION}
    if not given:
        return None
    return Errors(
        **{name: ErrorSize.parsed(f"--{name}-error", text) for name, text in given.items()}
    )


if TYPE_CHECKING:
    from hitchopt.settling.settled_hitch import Settled
    from hitchopt.settling.tolerance import Tolerance

MOST_ROWS = 24
"""Cables or vertices that a table shows; the others are in statics.json."""


def statics_tables(settled: Settled, ranges: Tolerance | None) -> str:
    """Return the tables of cables and vertices, each with its extremes over the times."""
    numbers = ["planned [N]", "at rest [N]"] + (["range [N]"] if ranges is not None else [])
    cables = new_table(_title("Cables", settled.team.robots), ["cable"], numbers)
    cables.add_column("slack", overflow="fold")
    limits = None if ranges is None else ranges.tensions
    for k in range(min(settled.team.robots, MOST_ROWS)):
        row = [_span(settled.planned_tensions[:, k]), _span(settled.tensions[:, k])]
        slack = "yes" if settled.slack[:, k].any() else "no"
        if limits is not None and ranges is not None:
            row.append(_span(limits[:, k]))
            slack = "may be" if slack == "no" and ranges.slack[:, k].any() else slack
        cables.add_row(f"c{k}", *row, Text(slack, style="green" if slack == "no" else "bold red"))
    numbers = ["from the plan [mm]", "lower by [mm]"]
    numbers += ["range around it [mm]"] if ranges is not None else []
    names = settled.team.point_names
    vertices = new_table(_title("Vertices", len(names)), ["vertex"], numbers)
    lower = settled.planned_vertices[..., 2] - settled.vertices[..., 2]
    for k, name in enumerate(names[:MOST_ROWS]):
        row = [f"{1e3 * np.max(settled.displacements[:, k]):.1f}", _span(1e3 * lower[:, k], 1)]
        if ranges is not None:
            row.append(f"±{1e3 * np.max(ranges.radii[:, k]):.1f}")
        vertices.add_row(name, *row)
    t = settled.t
    when = f"at t = {t[0]:g} s" if len(t) == 1 else f"at {len(t)} times, {t[0]:g} to {t[-1]:g} s"
    rest = (
        f"{when}; forces balance to {np.max(settled.force_residual):.1e} N, lengths to "
        f"{np.max(settled.length_residual):.1e} m"
    )
    lines = [rendered(cables), rendered(vertices), rest]
    if ranges is not None:
        lines.append(
            f"ranges include {np.max(ranges.tension_remainders):.3g} N and "
            f"{1e3 * np.max(ranges.vertex_remainders):.3g} mm beyond first order"
        )
    return "\n\n".join(lines[:2]) + "\n\n" + "\n".join(lines[2:])


def _title(what: str, count: int) -> str:
    more = f" (the first {MOST_ROWS} of {count})" if count > MOST_ROWS else ""
    return f"{what}: smallest to largest value over the times{more}"


def _span(values: np.ndarray, digits: int = 3) -> str:
    """Return the smallest and the largest value, or the only one."""
    low, high = (f"{value + 0.0:.{digits}f}" for value in (np.min(values), np.max(values)))
    return low if low == high else f"{low} to {high}"
