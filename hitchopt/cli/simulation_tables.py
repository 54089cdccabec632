"""Tables of simulated flights for a terminal."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from rich.text import Text

from hitchopt.cli.console_tables import new_table, rendered

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from rich.table import Table

    from hitchopt.simulation.error_measures import Spread
    from hitchopt.simulation.lost_drones import LossOutcome
    from hitchopt.simulation.simulate import Simulation
    from hitchopt.sweeps.campaign import Campaign

LYING = 0.05
"""[m] A lost drone that is so low lies on the ground, perhaps on its cable."""


def flight_tables(simulation: Simulation) -> str:
    """Return the tables of one flight's vertices, cables and drones."""
    from hitchopt.simulation.error_measures import Spread

    outcome, errors, run = simulation.outcome, simulation.errors, simulation.run
    vertices = new_table(
        "Vertices, in cm: distances to the plan's, mean ± standard deviation (largest); mean\n"
        "height over the plan; movement under the pull test",
        ["vertex"],
        ["linked", "bears [N]", "error", "height", "without sag", "pulled", "holds"],
    )
    for c, clasp in enumerate(outcome.clasps):
        vertices.add_row(
            clasp.name,
            str(clasp.linking),
            f"{clasp.bearing:.3f} {'≥' if clasp.bears else '<'} {clasp.least_bearing:.3f}",
            spread_text(Spread.of(errors.errors[:, c])),
            _height(errors.offsets[:, c, 2]),
            spread_text(Spread.of(errors.without_sag[:, c])),
            f"{100 * clasp.moved:.1f}" if np.isfinite(clasp.moved) else "",
            Text("yes" if clasp.holds else "NO", style="green" if clasp.holds else "bold red"),
        )
    figures = new_table("Flight", ["quantity"], ["value"])
    for name, value in (
        ("vertices, sag included [cm]", spread_text(run.vertex_error)),
        ("  while the plan stands still", spread_text(run.resting)),
        ("  while it moves", spread_text(run.moving)),
        ("vertices without sag (level part) [cm]", spread_text(run.without_sag)),
        ("drones to their setpoints [cm]", spread_text(run.tracking)),
        ("largest tension", f"{run.peak_tension:.3f} N"),
        ("largest thrust", f"{run.peak_thrust:.3f} N"),
        ("thrust saturated", f"{run.saturated:.2%} of samples"),
        ("pace", f"{run.pace:.2f} times real time, on one processor"),
    ):
        figures.add_row(name, value)
    parts = [rendered(vertices)] if outcome.clasps else []
    if simulation.loss is not None:
        parts.append(rendered(_loss_table(simulation.loss)))
    if outcome.objects:
        parts.append(rendered(_object_table(simulation)))
    return "\n\n".join([*parts, rendered(figures), rendered(_conditions(simulation))]) + "\n"


def _loss_table(loss: LossOutcome) -> Table:
    """Return the table of what became of the others after the loss of a drone."""
    table = new_table(f"{loss.drone} is lost at t = {loss.time:.3f} s", ["quantity"], ["value"])
    pairs = ", ".join(f"{touch.first} and {touch.second}" for touch in loss.among)
    others = ", ".join(f"{touch.first} and {touch.second}" for touch in loss.others)
    where = f"{100 * loss.hangs:.0f} cm above the ground" if loss.hangs > LYING else "on the ground"
    for name, value in (
        ("survivors that touch each other", pairs or "none"),
        ("survivors that touch a cable or the lost drone", others or "none"),
        ("largest tension from then on", f"{loss.peak_tension:.3f} N"),
        ("largest thrust of a survivor", f"{loss.peak_thrust:.3f} N"),
        ("survivors from their setpoints", f"{100 * loss.moved:.0f} cm at most"),
        ("the lost drone ends", f"{100 * loss.dropped:.0f} cm lower, {where}"),
        ("clasps that are linked at the end", ", ".join(loss.linked) or "none"),
    ):
        table.add_row(name, value)
    return table


def _object_table(simulation: Simulation) -> Table:
    """Return the table of the objects at the end, and of how they were held."""
    table = new_table(
        "Objects, in cm and degrees: from the plan's place, tilt, turn from the plan's yaw; while\n"
        "carried, mean height over the plan's and slip relative to the hitch",
        ["object"],
        ["placed", "tilted", "turned", "height", "slipped", "free", "well placed"],
    )
    for state in simulation.outcome.objects:
        good = state.well_placed
        table.add_row(
            state.name,
            f"{100 * state.placed:.1f}",
            f"{state.tilted:.1f}",
            f"{state.turned:+.1f}",
            f"{100 * state.lifted:+.1f}" if np.isfinite(state.lifted) else "",
            f"{100 * state.slipped:.1f}" if np.isfinite(state.slipped) else "",
            "yes" if state.free else "no",
            Text("yes" if good else "NO", style="green" if good else "bold red"),
        )
    return table


def headline(simulation: Simulation) -> str:
    """Return the flight's main figure in words: the vertices' errors with sag."""
    run = simulation.run
    if not np.isfinite(run.vertex_error.mean):
        return "vertex error: none, the plan has no hitch or none was formed"
    return (
        f"vertex error in 3-D, sag included: {spread_text(run.vertex_error)} cm, mean ± σ (largest)"
    )


def _conditions(simulation: Simulation) -> Table:
    """Return the table of how drones are controlled, and of what the simulation corrects."""
    from hitchopt.simulation.error_measures import effective_lengths

    flight, preset = simulation.flight, simulation.settings.preset
    team, gains = flight.task.team, flight.gains
    stated = np.all(np.isfinite(team.stiffness)) or simulation.settings.stiffness is not None
    table = new_table("Control, and what is corrected", ["quantity"], ["value"])
    off = 1e3 * (effective_lengths(flight) - team.cable_length)
    for name, value in (
        ("stiffness of position loops", f"{_range(gains.stiffness)} N/m"),
        ("  stated by", "team or option" if stated else "nobody: the simulator's own"),
        ("cable forces of setpoints fed forward", _yes(gains.feed_forward)),
        ("integral action", _yes(gains.integral > 0.0)),
        (
            "ropes weigh",
            f"{1e3 * flight.density:g} g/m; the plan knows {1e3 * team.cable_density:g}",
        ),
        (
            f"ropes of {1e3 * preset.diameter:g} mm longer for their bends",
            f"≤ {1e3 * flight.longer:.1f} mm",
        ),
    ):
        table.add_row(name, value)
    if np.all(np.isfinite(off)):  # there are none where no hitch is left
        table.add_row("  their effective lengths are off by", _range(off, "+.1f") + " mm")
    return table


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
        ("mean vertex error, sag included", [run.vertex_error.mean for run in campaign.runs]),
        ("  while the plan stands still", [run.resting.mean for run in campaign.runs]),
        ("  while it moves", [run.moving.mean for run in campaign.runs]),
        ("mean vertex error without sag", [run.without_sag.mean for run in campaign.runs]),
        ("mean tracking error", [run.tracking.mean for run in campaign.runs]),
        ("objects from their places", [run.placed for run in campaign.runs]),
        ("objects slipped", [run.slipped for run in campaign.runs]),
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


def spread_text(spread: Spread) -> str:
    """Return mean, deviation and largest value of some errors, in centimetres."""
    if not np.isfinite(spread.mean):
        return "none"
    return f"{100 * spread.mean:.1f} ± {100 * spread.deviation:.1f} ({100 * spread.largest:.1f})"


def _height(errors: NDArray[np.float64]) -> str:
    """Return a vertex's mean height over its plan, in centimetres; nothing where it is lost."""
    there = errors[np.isfinite(errors)]
    return f"{100 * np.mean(there):+.1f}" if there.size else ""


def _range(values: NDArray[np.float64], digits: str = ".3g") -> str:
    """Return the smallest and largest of some values, or the one that all are."""
    low, high = f"{np.min(values):{digits}}", f"{np.max(values):{digits}}"
    return low if low == high else f"{low} to {high}"


def _yes(drones: NDArray[np.bool_]) -> str:
    """Return whether something is so for all drones, for none or for some of them."""
    return (
        "yes" if np.all(drones) else f"{np.sum(drones)} of {len(drones)}" if drones.any() else "no"
    )


def _centimetres(value: float | np.floating) -> str:
    """Return a length in centimetres; nothing for nan."""
    return f"{100 * value:.1f} cm" if np.isfinite(value) else ""
