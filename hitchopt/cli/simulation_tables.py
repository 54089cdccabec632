"""Simulated flights as tables to read on a terminal."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from rich.text import Text

from hitchopt.cli.tables import new_table, rendered

if TYPE_CHECKING:
    from hitchopt.simulation.campaign import Campaign
    from hitchopt.simulation.simulate import Simulation


def flight_tables(simulation: Simulation) -> str:
    """Return how the vertices, cables and drones of one flight fared."""
    from hitchopt.simulation.error_measures import Spread, tracking_errors

    outcome, errors, record = simulation.outcome, simulation.errors, simulation.flight.record
    vertices = new_table(
        "Vertices: distances to the plan's, mean ± standard deviation (largest)",
        [("vertex", "left")],
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
    tracking = tracking_errors(simulation.flight)
    figures = new_table("Flight", [("quantity", "left")], ["value"])
    for name, value in (
        ("drones to their setpoints [cm]", _spread(Spread.of(tracking))),
        ("vertices, all [cm]", _spread(Spread.of(errors.errors))),
        ("vertices without sag [cm]", _spread(Spread.of(errors.without_sag))),
        ("largest tension", f"{np.max(record.peak_tensions):.3f} N"),
        ("largest thrust", f"{np.max(record.thrusts):.3f} N"),
        ("thrust saturated", f"{np.mean(record.saturated):.2%} of samples"),
        ("pace", f"{simulation.pace:.2f} times real time, on one processor"),
    ):
        figures.add_row(name, value)
    parts = [rendered(vertices)] if outcome.clasps else []
    return "\n\n".join([*parts, rendered(figures)]) + "\n"


def campaign_tables(campaign: Campaign) -> str:
    """Return how often a campaign succeeded, and what failed where."""
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
    runs = new_table("Runs, over all flights", [("quantity", "left")], ["mean", "largest"])
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
    failed = new_table("First failures", [("kind", "left"), ("where", "left")], ["flights"])
    for (kind, where), number in campaign.failures.most_common():
        failed.add_row(kind, where, str(number))
    return f"{head}\n{rendered(runs)}\n\n{rendered(failed)}\n"


def _spread(spread: object) -> str:
    mean, deviation, largest = (getattr(spread, x) for x in ("mean", "deviation", "largest"))
    if not np.isfinite(mean):
        return "none"
    return f"{100 * mean:.1f} ± {100 * deviation:.1f} ({100 * largest:.1f})"


def _centimetres(value: float | np.floating) -> str:
    return f"{100 * value:.1f} cm" if np.isfinite(value) else ""
