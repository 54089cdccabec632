"""Tables of simulated flights for a terminal."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from rich.text import Text

from hitchopt.cli.console_tables import new_table, rendered

if TYPE_CHECKING:
    from hitchopt.simulation.campaign import Campaign
    from hitchopt.simulation.error_measures import Spread
    from hitchopt.simulation.simulate import Simulation


def flight_tables(simulation: Simulation) -> str:
    """Return the tables of one flight's vertices, cables and drones."""
    from hitchopt.simulation.error_measures import Spread

    outcome, errors, run = simulation.outcome, simulation.errors, simulation.run
    vertices = new_table(
        "Vertices: distances to the plan's, mean ± standard deviation (largest)",
        ["vertex"],
        ["linked", "bears [N]", "error [cm]", "without sag [cm]", "pull test moves it", "holds"],
    )
    for c, clasp in enumerate(outcome.clasps):
        vertices.add_row(
            clasp.name,
            str(clasp.linking),
            f"{clasp.bearing:.3f} {'≥' if clasp.bears else '<'} {clasp.least_bearing:.3f}",
            _spread(Spread.of(errors.errors[:, c])),
            _spread(Spread.of(errors.without_sag[:, c])),
            _centimetres(clasp.moved),
            Text("yes" if clasp.holds else "NO", style="green" if clasp.holds else "bold red"),
        )
    figures = new_table("Flight", ["quantity"], ["value"])
    for name, value in (
        ("drones to their setpoints [cm]", _spread(run.tracking)),
        ("vertices, all [cm]", _spread(run.vertex_error)),
        ("vertices without sag [cm]", _spread(run.without_sag)),
        ("largest tension", f"{run.peak_tension:.3f} N"),
        ("largest thrust", f"{run.peak_thrust:.3f} N"),
        ("thrust saturated", f"{run.saturated:.2%} of samples"),
        ("pace", f"{run.pace:.2f} times real time, on one processor"),
    ):
        figures.add_row(name, value)
    parts = [rendered(vertices)] if outcome.clasps else []
    return "\n\n".join([*parts, rendered(figures)]) + "\n"


def campaign_tables(campaign: Campaign) -> str:
    """Return the tables of a campaign: its success rate, errors and failures."""
    low, high = campaign.interval
    count = len(campaign.runs)
    lost = campaign.not_simulated
    note = f", {lost} could not be simulated and count as not succeeded" if lost else ""
    head = (
        f"{campaign.successes} of {count} flights succeeded{note}: "
        f"{campaign.successes / count:.1%} ({low:.1%} to {high:.1%} at 95 %), "
        f"seeds {campaign.runs[0].seed} to {campaign.runs[-1].seed}, "
        f"preset {campaign.settings.preset.name}\n"
    )
    runs = new_table("Runs, over all flights", ["quantity"], ["mean", "largest"])
    for name, values in (
        ("mean vertex error", [run.vertex_error.mean for run in campaign.runs]),
        ("mean vertex error without sag", [run.without_sag.mean for run in campaign.runs]),
        ("mean tracking error", [run.tracking.mean for run in campaign.runs]),
    ):
        there = np.array(values)[np.isfinite(values)]
        if there.size:
            runs.add_row(name, _centimetres(np.mean(there)), _centimetres(np.max(there)))
    if not campaign.failures:
        return f"{head}\n{rendered(runs)}\n"
    failed = new_table("First failures", ["kind", "where"], ["flights"])
    for (kind, where), number in campaign.failures.most_common():
        failed.add_row(kind, where, str(number))
    return f"{head}\n{rendered(runs)}\n\n{rendered(failed)}\n"


def _spread(spread: Spread) -> str:
    """Return mean, deviation and largest value of some errors, in centimetres."""
    if not np.isfinite(spread.mean):
        return "none"
    return f"{100 * spread.mean:.1f} ± {100 * spread.deviation:.1f} ({100 * spread.largest:.1f})"


def _centimetres(value: float | np.floating) -> str:
    """Return a length in centimetres; nothing for nan."""
    return f"{100 * value:.1f} cm" if np.isfinite(value) else ""
