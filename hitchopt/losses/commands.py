"""The command react: what follows the loss of a robot."""

from __future__ import annotations

from pathlib import Path

import hitchopt as ho
from hitchopt.cli.options import PATH, command, option, plan_path
from hitchopt.cli.output import ProgressBar, say, show_plan

THEN = ("hold", "land")  # What follows a loss


@command(
    "directory DIR",
    option(
        "--lose", "Robot that is lost: its number, or a.2 of team a.", str, "ROBOT", required=True
    ),
    option("--at", "Time of the loss.", float, "SECONDS", required=True),
    option("-o --output", "Output directory.", PATH, "OUT", required=True),
    option(
        "--then",
        "Hold the chain that remains, or land: untied, tied, or without cables.",
        "hold",
        choices=THEN,
    ),
)
def react(directory: Path, lose: str, at: float, output: Path, then: str) -> None:
    """Plan what follows the loss of a robot in flight, and certify it.

    Writes a plan to OUT. It begins with the loss: all fly on, for 0.1 s or to the next prepared
    stop, the lost robot's drones rise, and the others form a chain.
    """
    from hitchopt.losses.losing import after_loss_of
    from hitchopt.motion.plan_file import read_plan

    flight = read_plan(plan_path(directory))
    with ProgressBar("planning"):
        found = after_loss_of(flight, lose, at, then)
    plan = ho.Plan(found.flight, found.certificate, f"Robot {lose} lost at {at:g} s")
    show_plan(plan.title, plan.flight, plan.certificate)
    plan.save(output)
    rests = f"all rest within {found.stops:.3f} s, where the plan is at t = {found.rest:.3f} s"
    if found.robots:
        say(
            f"after the loss, {rests}; drones at the ends begin to move after {found.starts:.3f} "
            f"s, and the chain is taut after {found.taut:.3f} s"
        )
        names = ", ".join(f"{own} is {old}" for own, old in found.robots.items())
        say(f"robots: {names}")
    else:
        say(f"no landing of the chain is certified: all drop their cables, {rests}, and land")
    say(
        f"certified; the plan is in {output}",
        directory=str(output),
        stops=found.stops,
        rest=found.rest,
        starts=found.starts,
        taut=found.taut,
        rise=found.rise,
        robots=found.robots,
    )
