"""The command ``statics``: where a plan's hitch comes to rest, and in which ranges."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from hitchopt.cli.commands import main
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
    from hitchopt.cli.statics_tables import statics_tables
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
