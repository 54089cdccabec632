"""The command check: the certificate of a plan, recomputed."""

from __future__ import annotations

import sys
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from hitchopt.cli.commands import main, show_plan
from hitchopt.cli.output import record, say
from hitchopt.cli.paths import GivenPath, plan_path

if TYPE_CHECKING:
    from hitchopt.losing.survivable import Survivable
    from hitchopt.motion.motion import Motion
    from hitchopt.plan import Plan


@main.command()
@click.argument("directory", metavar="DIR", type=GivenPath())
@click.option("--closest", is_flag=True, help="Report the closest pairs of drones over time.")
@click.option("--picture", metavar="PNG", type=GivenPath(), help="Draw the same to a file.")
@click.option(
    "--gamma",
    default=1.0,
    help="How many times farther than drones vertices may be off, for tracking_radius.",
)
@click.option(
    "--survivable",
    is_flag=True,
    help="Report for how many losses of a drone there is a certified reaction; this takes a while.",
)
def check(
    directory: Path, closest: bool, picture: Path | None, gamma: float, survivable: bool
) -> None:
    """Recompute the certificate of the plan in DIR, or of a plan.npz, from its polynomials only."""
    from hitchopt.checks import certify
    from hitchopt.cli.progress import LateProgress
    from hitchopt.plan import Plan, read_asked_plan

    path = plan_path(directory)
    motion, _ = read_asked_plan(path)
    with LateProgress(sys.stderr, "certifying") as progress:
        certificate = certify(motion, progress, gamma)
    losses = _losses(motion) if survivable else None
    if losses is not None:
        certificate = replace(certificate, checks=(*certificate.checks, losses.check))
    show_plan("", motion, certificate)
    without = [] if losses is None else losses.without
    if losses is not None:
        record(without_reaction=[asdict(lost) for lost in without])
    for lost in without:
        say(f"{lost.drone}, {lost.start:.4g} s to {lost.end:.4g} s: {lost.reason}")
    if closest or picture is not None:
        _show_closest(Plan(motion, certificate), picture)
    certificate.raise_if_violated()
    say(f"certified; recomputed from {path}")


def _losses(motion: Motion) -> Survivable:
    """Return which losses of a drone have a certified reaction."""
    from hitchopt.cli.progress import LateProgress
    from hitchopt.losing.survivable import survivable

    with LateProgress(sys.stderr, "planning reactions") as progress:
        return survivable(motion, progress=progress)


def _show_closest(plan: Plan, picture: Path | None) -> None:
    from hitchopt.plan import closest

    found = closest(plan, picture=picture)
    record(closest=str(found).splitlines())
    say(f"Closest neighbours\n{found}\n")
    if picture is not None:
        say(f"the closest neighbours over time are drawn in {picture}")
