"""The table of drone models and the pilot's checklist, from the package's own data."""

from __future__ import annotations

import hitchopt as ho
from hitchopt.drones.quadrotor import MODELS
from hitchopt.exports.formats.crazyflie import pilot_checklist


def write_model_table() -> str:
    """Return the table of drone models."""
    rows = [
        f"| `{name}` | {1e3 * each.mass:g} g | {each.max_thrust:.2g} N | {each.source} |"
        for name, each in MODELS.items()
    ]
    return "\n".join(["| model | mass | thrust | source |", "|---|---|---|---|", *rows, ""])


def write_checklist() -> str:
    """Return the pilot's checklist before arming a hitch of drones without a stated latency."""
    start = ho.Hitch.spread(ho.Team(robots=3, cable_length=2.4), ho.regular_polygon(3, 1.3))
    items = pilot_checklist(ho.solve(start, ho.Hold(1.0)).flight).splitlines()
    return "\n".join([*(item.strip() for item in items), ""])
