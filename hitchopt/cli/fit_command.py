"""The command ``fit``: the hitch polygon for an object's outline."""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import Any

import click

from hitchopt.cli.commands import main
from hitchopt.cli.output import record, say
from hitchopt.cli.paths import GivenPath
from hitchopt.errors import InputError

CIRCLE = "circle:"


@main.command()
@click.argument("outline", metavar="OUTLINE")
@click.option("--robots", metavar="N", type=int, required=True, help="Number of robots.")
@click.option(
    "-o", "--output", "directory", metavar="DIR", type=GivenPath(),
    help="Directory for fit.json and fit.png; nothing is written without it.",
)  # fmt: skip
@click.option("--clearance", metavar="M", default=0.035, help="Of cables, while enclosing.")
@click.option("--object-height", "height", metavar="M", default=0.3, help="Height of the object.")
@click.option("--mass", metavar="KG", type=float, help="To be held; ends with 3 if it is not.")
@click.option(
    "--by", type=click.Choice(["grip", "rest"]), default="grip", help="How --mass is to be held."
)
@click.option("--friction", default=0.5, help="Between cables and object.")
@click.option("--clasp-friction", default=0.15, help="Of cables on each other.")
@click.option("--tension", metavar="N", type=float, help="Of all cables; the largest level pull.")
@click.option("--cable-length", metavar="M", type=float, help="Of all cables; the shortest.")
@click.option("--tilt-deg", metavar="DEG", default=45.0, help="Largest tilt of drones.")
@click.option("--quadrotor-mass", metavar="KG", default=0.132, help="Of every drone.")
@click.option("--max-thrust", metavar="N", default=2.6, help="Of every drone.")
def fit(
    outline: str,
    robots: int,
    directory: Path | None,
    mass: float | None,
    by: str,
    tilt_deg: float,
    quadrotor_mass: float,
    max_thrust: float,
    **given: Any,
) -> None:
    """Fit a hitch to OUTLINE: what encloses it, what grips it, what it rests on, and how much.

    OUTLINE is a drawing (SVG, DXF, GeoJSON, CSV), points as '[[x, y], …]', or circle:RADIUS, in
    metres unless a drawing states its unit.
    """
    from hitchopt.cli.fit_tables import fit_tables
    from hitchopt.cli.progress import LateProgress
    from hitchopt.fitting.fit import fit as fitted
    from hitchopt.fitting.fit_file import fit_as_json, save_fit
    from hitchopt.hitch import Quadrotor
    from hitchopt.requirements import Limits
    from hitchopt.values import positive

    if not 0.0 < tilt_deg < 90.0:
        raise InputError("--tilt-deg", tilt_deg, "above 0 and below 90", "45 is usual")
    if mass is not None:
        positive("--mass", mass)
    kind = Quadrotor(quadrotor_mass, max_thrust)
    limits = Limits(tilt=math.radians(tilt_deg))
    with LateProgress(sys.stderr, "fitting"):
        found = fitted(_outline(outline), robots, quadrotor=kind, limits=limits, **given)
        text = fit_tables(found)
    record(fit=fit_as_json(found))
    say(text)
    if directory is not None:
        save_fit(directory, found)
        record(directory=str(directory))
        say(f"fit.json and fit.png are in {directory}")
    if mass is not None:
        found.raise_if_too_heavy(mass, by)
        say(f"{1e3 * mass:g} g are held by {by}")


def _outline(text: str) -> object:
    """Return the outline that an argument names: a radius, points, or the path of a drawing."""
    from hitchopt.storage.strict_json import parsed_json

    if text.startswith(CIRCLE):
        try:
            return float(text.removeprefix(CIRCLE))
        except ValueError:
            raise InputError("OUTLINE", text, "circle:RADIUS", "write circle:0.2") from None
    if text.lstrip().startswith("["):
        try:
            return parsed_json(text)
        except ValueError:
            raise InputError("OUTLINE", text, "[[x, y], …]", "write it as JSON") from None
    return Path(text)
