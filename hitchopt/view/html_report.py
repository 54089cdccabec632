"""report.html: a plan in one file that needs no network, with playback, plots and certificate."""

from __future__ import annotations

import hashlib
import html
import json
import math
import platform
from importlib import metadata
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from hitchopt.checks.certificate import Certificate, Check
from hitchopt.motion.motion import CableState, Motion
from hitchopt.motion.tensions import stated_tensions
from hitchopt.values import Array
from hitchopt.view.cable_curves import CLASPS, HOOKED, POINTS
from hitchopt.view.curves import Curves, sampled_curves
from hitchopt.view.house_colours import drone_colours, facts, object_colours, verdict
from hitchopt.view.object_shape import object_shape
from hitchopt.view.sample_packing import packed
from hitchopt.view.scene import Scene, concerned, scene_of
from hitchopt.view.time_plots import Panel, panels, worst_of

PACKAGES = ("numpy", "scipy", "casadi", "toppra", "osqp", "ruckig")
"""Packages whose versions a report states, besides hitchopt's."""

DIGESTED = ("plan.npz", "setpoints.csv")
"""Files of a plan whose digests a report states."""

SCRIPTS = ("samples.js", "cable_tubes.js", "stage.js", "plots.js", "report.js")
"""Parts of the page's script."""

HEADROOM = 1.2
"""Height of a plot over its largest value."""


def write_report(
    path: Path, motion: Motion, certificate: Certificate, title: str = "", problem: str = "",
    directory: Path | None = None,
) -> None:  # fmt: skip
    """Write the page of a plan.

    Parameters
    ----------
    path: file, replaced if there is one.
    motion, certificate, title: the plan.
    problem: the text of its problem file, if it is known.
    directory: that of the plan's files, whose digests the report states; by default that of
        ``path``.

    Raises
    ------
    OSError: the file cannot be written.
    """
    scene = scene_of(motion)
    entries, samples = packed(
        {
            "drones": scene.drones,
            "attitudes": scene.quaternions[..., 1:],
            "thrusts": scene.thrusts[..., None],
            "forces": scene.cable_forces,
            "cables": scene.cables,
            "places": scene.objects[..., :3],
            "turns": scene.objects[..., 3:],
        }
    )
    name = title or "Plan"
    data = {
        "title": name,
        "facts": facts(motion),
        "verdict": verdict(certificate),
        "certified": certificate.certified,
        "arrays": entries,
        "plots": _plots(motion, certificate),
        "checks": [_check(motion, check) for check in certificate.checks],
        "problem": problem,
        "origin": _origin(problem, directory or path.parent),
        **_described(scene),
    }
    page = files("hitchopt.view") / "page"
    parts = {
        "TITLE": html.escape(name),
        "STYLE": (page / "report.css").read_text("utf-8"),
        "DATA": _in_script(data),
        "SAMPLES": samples,
        "LIBRARY": (page / "three.bundle.js").read_text("utf-8"),
        "SCRIPT": "\n".join((page / script).read_text("utf-8") for script in SCRIPTS),
    }
    pieces = (page / "report.html").read_text("utf-8").split("%")
    pieces[1::2] = [parts[piece] for piece in pieces[1::2]]
    path.write_text("".join(pieces), encoding="utf-8")


def _in_script(data: Any) -> str:
    """Return JSON that cannot end the script that holds it, whatever texts it has."""
    text = json.dumps(data, allow_nan=False, ensure_ascii=False, separators=(",", ":"))
    return text.replace("<", "\\u003c")


def _described(scene: Scene) -> dict[str, Any]:
    """Return what does not change over time, and the phases."""
    motion, team = scene.motion, scene.motion.team
    requirements = motion.requirements
    arena, separation = requirements.arena, requirements.separation
    layout, names = team.layout, team.point_names if team.has_cables else ()
    return {
        "t": np.round(scene.t, 6).tolist(),
        "duration": motion.duration,
        "phases": [
            {
                **{name: getattr(phase, name) for name in ("name", "start", "end", "remark")},
                "state": "" if phase.state is CableState.NONE else str(phase.state),
                "hooked": phase.state in HOOKED,
            }
            for phase in motion.phases
        ],
        "names": list(team.drone_names),
        "colours": list(drone_colours(team)),
        "cables": team.robots,
        "points": POINTS,
        "radius": scene.radius,
        "clasps": [
            {"name": names[p], "vertex": int(p), "point": int(k) * POINTS + CLASPS[0]}
            for p, k in zip(layout.clasps, layout.ahead, strict=True)
        ],
        "objects": [
            {"colour": colour, "corners": np.ravel(mesh.vertices[mesh.faces]).tolist()}
            for colour, mesh in zip(
                object_colours(motion),
                map(object_shape, requirements.objects.values()),
                strict=True,
            )
        ],
        "floor": requirements.floor,
        "ellipsoid": [separation.radius, separation.radius, separation.height],
        "arena": arena and {"lower": arena.lower.tolist(), "upper": arena.upper.tolist()},
        "keep_out": [
            {"polygon": prism.polygon.vertices.tolist(), "lower": prism.lower, "upper": prism.upper}
            for prism in requirements.keep_out
        ],
    }


def _check(motion: Motion, check: Check) -> dict[str, Any]:
    return {
        **{name: getattr(check, name) for name in ("name", "holds", "worst", "limit", "sense")},
        **{"unit": check.unit, "time": check.time, "where": list(check.where)},
        "concerned": vars(concerned(motion, check.where)),
    }


def _plots(motion: Motion, certificate: Certificate) -> list[dict[str, Any]]:
    curves = sampled_curves(motion)
    ends = [0.0, motion.duration]
    plots = []
    for panel in panels(motion, curves):
        plot = _plot(panel, curves.t, certificate)
        plot["limits"] = [
            {"t": ends, "values": 2 * [panel.limit], "words": f"limit {panel.limit:.4g}"}
        ]
        plots.append(plot)
    if motion.team.has_cables and np.any(curves.states.formed):
        plots.append(_tension_plot(motion, curves))
    return plots


def _plot(panel: Panel, t: Array, certificate: Certificate) -> dict[str, Any]:
    worst = worst_of(panel, certificate)
    top = HEADROOM * max(panel.limit, float(np.max(panel.values)), worst[1] if worst else 0.0)
    return {
        "label": panel.label,
        "t": _rounded(t),
        "curves": [_rounded(panel.values)],
        "worst": worst and {"time": worst[0], "value": worst[1]},
        "sense": panel.rule.sense,
        "top": top,
    }


def _tension_plot(motion: Motion, curves: Curves) -> dict[str, Any]:
    """Return the largest and the smallest tension while there is a hitch, and what is stated."""
    states = curves.states
    tensions = np.where(states.formed[:, None], states.tensions, np.nan)
    stated = stated_tensions(motion)
    breaks = motion.drones.breaks - motion.drones.breaks[0]
    steps = np.repeat(breaks, 2)[1:-1]
    limits = []
    for bound in (np.min(stated[..., 0], axis=1), np.max(stated[..., 1], axis=1)):
        values = np.repeat(np.where(motion.formed, bound, np.nan), 2)
        limits.append({"t": _rounded(steps), "values": _rounded(values), "words": ""})
    return {
        "label": "tension [N],\nas stated",
        "t": _rounded(curves.t),
        "curves": [_rounded(np.min(tensions, axis=1)), _rounded(np.max(tensions, axis=1))],
        "limits": limits,
        "worst": None,
        "sense": "max",
        "top": HEADROOM * float(np.nanmax(np.concatenate([stated.ravel(), tensions.ravel()]))),
    }


def _rounded(values: Array) -> list[float | None]:
    """Return numbers in five significant digits; nothing where there is none."""
    return [float(f"{x:.5g}") if math.isfinite(x) else None for x in values.tolist()]


def _origin(problem: str, directory: Path) -> list[tuple[str, str]]:
    """Return versions and digests, as rows of a table."""
    rows = [("Python", platform.python_version())]
    for package in ("hitchopt", *PACKAGES):
        try:
            rows.append((package, metadata.version(package)))
        except metadata.PackageNotFoundError:
            rows.append((package, "(not installed)"))
    if problem:
        rows.append(("problem file, SHA-256", hashlib.sha256(problem.encode()).hexdigest()))
    for name in DIGESTED:
        if (directory / name).is_file():
            with (directory / name).open("rb") as file:
                rows.append((f"{name}, SHA-256", hashlib.file_digest(file, "sha256").hexdigest()))
    return rows
