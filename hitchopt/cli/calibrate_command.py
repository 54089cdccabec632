"""The command ``calibrate``: a team's estimates from a recorded flight, and its errors."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import click

from hitchopt.cli.commands import main
from hitchopt.cli.output import record, say
from hitchopt.cli.paths import GivenPath, plan_path

if TYPE_CHECKING:
    from hitchopt.calibration.calibrate import Calibration
    from hitchopt.calibration.estimates import Estimate

PATH = GivenPath()


@main.command()
@click.argument("recording", metavar="RECORDING", type=PATH)
@click.option("--plan", metavar="DIR", type=PATH, help="Plan flown; else where RECORDING lies.")
@click.option("-o", "--output", metavar="FILE", type=PATH, help="Team with the estimates (YAML).")
@click.option("--picture", metavar="FILE", type=PATH, help="Recording and plan, .png or .pdf.")
@click.option("--density", metavar="KG/M", type=float, help="Cable density, as weighed.")
def calibrate(
    recording: Path,
    plan: Path | None,
    output: Path | None,
    picture: Path | None,
    density: float | None,
) -> None:
    """Estimate cable lengths, stiffness and friction from a recorded flight.

    RECORDING is a CSV file with the columns t, name, x, y, z: seconds from the plan's start, q0,
    r0, … or p0, …, and metres; or the results of `hitchopt simulate`, DIR/simulation. Estimates
    come with standard errors, and what the recording does not determine is said so. Distances to
    the plan are in three dimensions.
    """
    from hitchopt.calibration.calibrate import calibrate as calibrated
    from hitchopt.calibration.calibration_picture import save_calibration_picture
    from hitchopt.calibration.team_file import save_team

    found = calibrated(recording, None if plan is None else plan_path(plan).parent, density=density)
    record(
        lengths=[vars(estimate) for estimate in found.lengths],
        stiffness=[vars(estimate) for estimate in found.stiffness],
        friction=vars(found.friction),
    )
    say(_tables(found))
    if output is not None:
        save_team(output, found)
        say(f"the team is in {output}")
    if picture is not None:
        save_calibration_picture(picture, found)
        say(f"the picture is {picture}")


def _tables(found: Calibration) -> str:
    """Return the tables of estimates and of distances to the plan."""
    from hitchopt.cli.console_tables import new_table, rendered
    from hitchopt.cli.simulation_tables import spread_text

    team, remarks = found.task.team, []
    estimates = new_table("Estimates", ["quantity"], ["value", "± error", "in the plan"])

    def add(name: str, estimate: Estimate, unit: str, planned: float) -> None:
        if estimate.known:
            digits = ".4f" if unit == "m" else ".3g"
            value, error = f"{estimate.value:{digits}} {unit}", f"{estimate.error:.1g}"
        else:
            value, error = "not determined", ""
            remarks.append(f"{name}: {estimate.remark}")
        estimates.add_row(name, value, error, _planned(planned, unit))

    for k, estimate in enumerate(found.lengths):
        add(f"length of cable {k}", estimate, "m", float(team.cable_length[k]))
    same = len(set(found.stiffness)) == 1
    for k, estimate in enumerate(found.stiffness[:1] if same else found.stiffness):
        name = "stiffness" if same else f"stiffness of q{k}, r{k}"
        add(name, estimate, "N/m", float(team.stiffness[2 * k]))
    add("friction", found.friction, "", team.cable_friction)
    errors = new_table(
        "Distances to the plan [cm], mean ± standard deviation (largest)",
        ["of"],
        ["whole flight", "plan at rest", "plan moving"],
    )
    compared = found.comparison
    for names, columns in (
        (team.point_names, compared.vertices),
        (team.drone_names, compared.drones),
    ):
        for name, spreads in zip(names, compared.spreads(columns), strict=True):
            errors.add_row(name, *map(spread_text, spreads))
    return "\n\n".join([rendered(estimates), *remarks, rendered(errors)]) + "\n"


def _planned(value: float, unit: str) -> str:
    """Return what the plan's team says of a quantity."""
    return f"{value:.4g} {unit}" if math.isfinite(value) else "rigid"
