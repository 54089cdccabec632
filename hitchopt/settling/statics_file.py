"""Files statics.json and statics.png in a plan's directory, replaced both at once."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hitchopt.exports.directory import STATICS, STATICS_PICTURE
from hitchopt.settling.settled_hitch import Settled
from hitchopt.settling.statics_picture import save_statics_picture
from hitchopt.settling.tolerance import Tolerance
from hitchopt.storage.atomic import replace_files
from hitchopt.storage.strict_json import write_strict_json

FORMAT = "hitchopt-statics/1"


def save_statics(directory: Path, settled: Settled, ranges: Tolerance | None) -> Path:
    """Write what settles, and its ranges if there are any; return the directory.

    Parameters
    ----------
    directory: that of the plan; only files of these two names are replaced.
    settled: samples (S,), one per time.
    ranges: at the same times; None for no errors.

    Raises
    ------
    FileError: the directory cannot be written to.
    """
    content = statics_content(settled, ranges)
    writers = {
        STATICS_PICTURE: lambda path: save_statics_picture(path, settled, ranges),
        STATICS: lambda path: write_strict_json(path, content),
    }
    return replace_files(directory, writers, tuple(writers), seal=STATICS)


def statics_content(settled: Settled, ranges: Tolerance | None) -> dict[str, Any]:
    """Return what statics.json says: lists over the times ``t``, in SI units."""
    team = settled.team
    cables: list[dict[str, Any]] = [
        {
            "name": f"c{k}",
            "planned_tension": settled.planned_tensions[:, k].tolist(),
            "tension": settled.tensions[:, k].tolist(),
            "slack": settled.slack[:, k].tolist(),
        }
        for k in range(team.robots)
    ]
    vertices: list[dict[str, Any]] = [
        {
            "name": name,
            "planned": settled.planned_vertices[:, k].tolist(),
            "position": settled.vertices[:, k].tolist(),
        }
        for k, name in enumerate(team.point_names)
    ]
    drones = [
        {
            "name": name,
            "planned": settled.planned_drones[:, i].tolist(),
            "position": settled.drones[:, i].tolist(),
        }
        for i, name in enumerate(team.drone_names)
    ]
    content: dict[str, Any] = {
        "format": FORMAT,
        "t": settled.t.tolist(),
        "slack_cables": list(settled.slack_cables),
        "loose_clasps": list(settled.loose_clasps),
        "force_residual": float(settled.force_residual.max()),
        "length_residual": float(settled.length_residual.max()),
    }
    if ranges is not None:
        content["errors"] = {
            name: {"bound": size.bound, "deviation": size.deviation}
            for name, size in vars(ranges.errors).items()
        }
        content["may_be_slack"] = list(ranges.slack_cables)
        content["tension_remainder"] = ranges.tension_remainders.tolist()
        content["vertex_remainder"] = ranges.vertex_remainders.tolist()
        limits = ranges.tensions
        for k, cable in enumerate(cables):
            cable["smallest"] = limits[:, k, 0].tolist()
            cable["largest"] = limits[:, k, 1].tolist()
        for k, vertex in enumerate(vertices):
            vertex["half_widths"] = ranges.vertex_halves[:, k].tolist()
            vertex["radius"] = ranges.radii[:, k].tolist()
    return {**content, "cables": cables, "vertices": vertices, "drones": drones}
