"""The command fit: polygons that hold an object, and the largest masses."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import hitchopt as ho
from hitchopt.cli.options import (
    PATH,
    assignment_option,
    command,
    option,
    paper_option,
    picture_format,
)
from hitchopt.cli.output import ProgressBar, say
from hitchopt.errors import InputError
from hitchopt.tables import table

if TYPE_CHECKING:
    import click

CIRCLE = "circle:"  # Prefix of a radius in place of an outline


def _fit_options() -> Sequence[click.Option]:
    """Return the option for the object and the team of a fit."""
    from hitchopt.carrying.outline_fit import FitTask
    from hitchopt.values.fields import keys_of

    task = keys_of(FitTask)
    quadrotor = keys_of(ho.Quadrotor)
    keys = {name: key for name, key in task.items() if name not in {"section", "kind"}}
    keys["tilt_deg"] = keys_of(ho.Limits)["tilt"]
    keys["quadrotor_mass"] = replace(quadrotor["mass"], text="Mass of every drone")
    keys["max_thrust"] = quadrotor["max_thrust"]
    words = "Value of the object or the team, such as tension=1.2; may be repeated."
    return (assignment_option("--set values", words, keys),)


@command(
    "outline OUTLINE",
    option("--robots", "Number of robots.", int, "N", required=True),
    option(
        "-o --output",
        "Directory for fit.json and its picture; nothing is written without it.",
        PATH,
        "DIR",
    ),
    option("--mass", "Mass to hold [kg]; exits with 3 if it cannot be held.", float, "KG"),
    option("--by", "How to hold --mass.", "grip", choices=("grip", "rest")),
    _fit_options,
    paper_option(),
    type=str,
)
def fit(
    outline: str,
    robots: int,
    output: Path | None,
    mass: float | None,
    by: str,
    width: float | None,
    values: dict[str, Any],
) -> None:
    """Fit a hitch to OUTLINE: polygons that enclose, grip and support it, and maximum masses.

    OUTLINE is a drawing (GeoJSON, CSV), points as '[[x, y], …]', or circle:RADIUS, in metres.
    """
    from hitchopt.carrying.fit_files import fit_as_json, save_fit
    from hitchopt.values import positive

    if mass is not None:
        positive("mass", mass)
    usual = ho.Quadrotor()
    kind = ho.Quadrotor(
        values.pop("quadrotor_mass", usual.mass), values.pop("max_thrust", usual.max_thrust)
    )
    limits = ho.Limits(tilt=values.pop("tilt_deg", ho.Limits().tilt))
    with ProgressBar("fitting"):
        result = ho.fit(_outline(outline), robots, quadrotor=kind, limits=limits, **values)
        content = fit_as_json(result)
    notes = [f"note: {note}" for note in result.notes]
    say("\n\n".join([*notes, *_fit_tables(content)]), fit=content)
    if output is not None:
        picture = picture_format(width)
        save_fit(output, result, mass, by, picture, width)
        say(f"fit.json and fit.{picture} are in {output}", directory=str(output))
    if mass is not None:
        result.raise_if_too_heavy(mass, by)
        say(f"{1e3 * mass:g} g is held by {by}")


def _outline(text: str) -> object:
    """Parse an outline: a radius, points, or the path of a drawing."""
    from hitchopt.storage.files import parsed_json
    from hitchopt.values import positive

    if not text.lstrip().startswith((CIRCLE, "[")):
        return Path(text)
    try:
        value = parsed_json(text.removeprefix(CIRCLE))
    except ValueError:
        bound = "circle:RADIUS, [[x, y], …] or a file"
        raise InputError("OUTLINE", text, bound, "write circle:0.2") from None
    return positive("OUTLINE", value) if text.startswith(CIRCLE) else value


def _fit_tables(content: dict[str, Any]) -> Iterator[str]:
    """Yield the tables of polygons and of masses."""
    grip, rest = content["grip"] or {}, content["rest"] or {}
    polygons = {
        "enclosing [m]": content["enclosing"],
        "gripping [m]": grip.get("polygon"),
        "resting [m]": rest.get("polygon"),
    }
    rows = []
    for k in range(content["robots"]):
        vertices = {head: points[k] for head, points in polygons.items() if points}
        rounded = {head: [round(x, 4) + 0.0 for x in point] for head, point in vertices.items()}
        rows.append({"vertex": f"p{k}", **rounded})
        if grip:
            rows[k]["wrap [°]"] = grip["wraps_deg"][k]
    yield table(f"Polygons of {content['robots']} cables of {content['cable_length']:.2f} m", rows)
    masses = content["largest_mass"].items()
    rows = [{"robots": n, "by": by, **row} for by, table_ in masses for n, row in table_.items()]
    yield table("Largest mass [kg]", rows)
