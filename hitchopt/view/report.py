"""Report of a plan as a page that needs no network; export of a plan as page, picture or film."""

from __future__ import annotations

import base64
import hashlib
import html
import json
import math
import platform
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from importlib import metadata
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from hitchopt.checks.certificate import Certificate
from hitchopt.checks.registry import RULE_OF
from hitchopt.errors import InputError, Progress
from hitchopt.motion.flight import Flight, TeamMotion
from hitchopt.motion.loads import stated_tensions
from hitchopt.storage.files import digest
from hitchopt.values import Array
from hitchopt.view import style
from hitchopt.view.cables import CLASPS, POINTS
from hitchopt.view.pictures import Page, draw_summary, panels, sample_states
from hitchopt.view.scene import RigidSurface, Scene, highlight_of, mesh, scene_of

PAGE = ".html"  # Suffix of pages
PICTURES = (".png", ".svg", ".pdf")  # Suffixes of pictures
FILMS = (".mp4", ".gif")  # Suffixes of films
PACKAGES = ("numpy", "scipy", "casadi", "toppra", "osqp", "ruckig")
# Files whose digests a report states
DIGESTED_FILES = ("plan.npz", "setpoints.csv")
# Parts of the page's script
SCRIPTS = ("samples.js", "cable_tubes.js", "stage.js", "plots.js", "report.js")
HEADROOM = 1.2  # Height of a plot over its largest value
LEVELS = 65535  # Largest number of 16 bits


def save_view(
    path: Path,
    flight: Flight,
    certificate: Certificate,
    title: str = "",
    problem: str = "",
    progress: Progress | None = None,
    page: Page | None = None,
) -> None:
    """Write a plan as a page, a picture or a film, according to the file name's extension.

    ``problem`` is the text of its file; ``progress`` receives the finished fraction of a film;
    ``page`` makes a picture a figure for a paper. Raises
    InputError for another extension, UnsupportedError for a missing package, and FileError if the
    file cannot be written.
    """
    kind = path.suffix.lower()
    if page is not None and kind in (PAGE, *FILMS):
        raise InputError("width", page.width, "of a picture", f"save {', '.join(PICTURES)}")
    if kind in FILMS:
        from hitchopt.view.film import save_film

        tell = progress or (lambda _: None)
        save_film(path, scene_of(flight), title, lambda done: tell(f"drawing, {done:.0%}"))
        return
    if kind not in (*PICTURES, PAGE):
        bound = f"a name that ends in one of {', '.join((PAGE, *PICTURES, *FILMS))}"
        raise InputError("save", str(path), bound, "such as plan.html")
    with style.atomic_write(path) as draft:
        if kind == PAGE:
            write_report(draft, flight, certificate, title, problem, path.parent)
        else:
            style.save_figure(draw_summary(flight, certificate, title, page), draft)


def write_report(
    path: Path, flight: Flight, certificate: Certificate, title: str = "", problem: str = "",
    directory: Path | None = None, ghost: Scene | None = None,
) -> None:  # fmt: skip
    """Write the page of a plan: playback, plots, certificate, and the cables of a ghost.

    ``problem`` is the text of its file. The plan's files, whose digests the report states, are in
    ``directory``, by default that of ``path``. Raises OSError if the file cannot be written.
    """
    scene = scene_of(flight)
    name = title or "Plan"
    arrays = dict[str, Array]()
    if ghost is not None:
        arrays["ghost"] = np.stack([ghost.at(time).cables for time in scene.t.tolist()])
    arrays |= {
        "drones": scene.drones,
        "attitudes": scene.quaternions[..., 1:],
        "thrusts": scene.thrusts[..., None],
        "forces": scene.cable_forces,
        "cables": scene.cables,
        "places": scene.objects[..., :3],
        "turns": scene.objects[..., 3:],
    }
    entries, samples = pack_samples(arrays)
    checks = certificate.to_dict()["checks"]
    for check in checks:
        check["concerned"] = highlight_of(flight, check["where"])._asdict()
    groups = certificate.groups.items()
    data = {
        "title": name,
        "facts": style.facts(flight),
        "verdict": style.verdict(certificate),
        "certified": certificate.certified,
        "arrays": entries,
        "plots": list(plots_of(flight, certificate)),
        "checks": checks,
        "groups": {title: [[x.name, x.title] for x in group] for title, group in groups},
        "opens": _first_hitch(flight),
        "problem": problem,
        "origin": _versions_and_digests(problem, directory or path.parent),
        **_scene_data(scene),
    }
    # Escaped so that no text can end the script element.
    text = json.dumps(data, allow_nan=False, ensure_ascii=False, separators=(",", ":"))
    page = files("hitchopt.view") / "page"
    parts = {
        "TITLE": html.escape(name),
        "STYLE": (page / "report.css").read_text("utf-8"),
        "DATA": text.replace("<", "\\u003c"),
        "SAMPLES": samples,
        "LIBRARY": (page / "three.bundle.js").read_text("utf-8"),
        "SCRIPT": "\n".join((page / script).read_text("utf-8") for script in SCRIPTS),
    }
    pieces = (page / "report.html").read_text("utf-8").split("%")
    pieces[1::2] = [parts[piece] for piece in pieces[1::2]]
    path.write_text("".join(pieces), encoding="utf-8")


def _first_hitch(flight: Flight) -> float:
    """Return the time [s] at which a hitch first stands, 0 without one."""
    begins = flight.drones.breaks[0]
    parts = [x.motion for x in flight.teams if x.motion.team.has_cables and np.any(x.motion.formed)]
    starts = [part.drones.breaks[np.argmax(part.formed)] - begins for part in parts]
    return float(max(0.0, min(starts, default=0.0)))


def pack_samples(arrays: Mapping[str, Array]) -> tuple[list[dict[str, Any]], str]:
    """Return descriptions of arrays (times, …, axes) for JSON, and their samples as text.

    The text is base64 of deflated second differences with 16 bits, which ``page/samples.js``
    decodes: smooth motion has small differences, and shrinks to about a third. The error of a
    sample is at most half of its axis's range over ``LEVELS``.
    """
    entries, planes = [], []
    for name, array in arrays.items():
        points = np.reshape(array, (-1, array.shape[-1]))
        if not len(points):  # of no items, such as objects
            points = np.zeros((1, array.shape[-1]))
        lower, extent = np.min(points, axis=0), np.ptp(points, axis=0)
        step = np.where(extent > 0.0, extent / LEVELS, 1.0)
        levels = np.rint((array - lower) / step).astype(np.int64).reshape(len(array), -1)
        columns = levels.shape[1]
        at_rest = np.zeros((2, columns), np.int64)  # before the first sample
        second_differences = np.diff(levels, n=2, axis=0, prepend=at_rest)
        words = second_differences.T.astype(np.uint16)  # wraps around like the page's sums
        low_bytes, high_bytes = words & 255, words >> 8
        planes += [part.astype(np.uint8).tobytes() for part in (low_bytes, high_bytes)]
        ranges = {"lower": lower.tolist(), "step": step.tolist()}
        entries.append({"name": name, "columns": columns, **ranges})
    return entries, base64.b64encode(zlib.compress(b"".join(planes), 9)).decode("ascii")


def _scene_data(scene: Scene) -> dict[str, Any]:
    """Return the appearance, the phases, and other data that is constant over time."""
    flight, look = scene.flight, scene.appearance
    return {
        "t": np.round(scene.t, 6).tolist(),
        "duration": flight.duration,
        "phases": [
            {
                **{name: getattr(phase, name) for name in ("name", "start", "end", "remark")},
                "hooked": phase.state.tied,
            }
            for phase in flight.phases
        ],
        "names": list(look.drones),
        "colours": list(look.drone_colours),
        "cable_colours": list(look.cable_colours),
        "mark": style.MARK_COLOUR,
        "points": POINTS,
        "radius": scene.radius,
        "clasps": [
            {"name": each.name, "vertex": each.vertex, "point": each.cable * POINTS + CLASPS[0]}
            for each in look.clasps
        ],
        "drone_parts": list(map(_solid, look.drone_parts())),
        "objects": list(map(_solid, look.objects)),
        "keep_outs": list(map(_solid, look.keep_outs)),
        "arena": look.arena.ravel().tolist(),
        "floor": scene.ground,
        "ellipsoid": list(look.ellipsoid),
    }


def _solid(solid: RigidSurface) -> dict[str, Any]:
    """Return the colours of a solid, and the corners of its triangles."""
    vertices, triangles = mesh(solid.faces)
    corners = np.round(np.float64(vertices[triangles]).ravel(), 6).tolist()
    return {"colours": list(solid.colours), "corners": corners}


def plots_of(flight: Flight, certificate: Certificate) -> Iterator[dict[str, Any]]:
    """Yield the plots of limited quantities, and of the extreme tensions of each hitch."""
    states = sample_states(flight)
    duration = flight.duration
    for panel in panels(flight, states):
        bound = (np.array([0.0, duration]), np.full(2, panel.limit), f"limit {panel.limit:.4g}")
        worst = panel.worst_of(certificate)
        sense = RULE_OF[panel.name].sense
        yield _plot(panel.label, sense, states.t, [panel.values], [bound], worst)
    for each in flight.teams:
        yield from _tensions(each)


def _tensions(flown: TeamMotion) -> Iterator[dict[str, Any]]:
    """Yield the plot of the extreme tensions of a team's hitch, if it has one."""
    motion = flown.motion
    limits = list[tuple[Array, Array, str]]()
    if motion.team.has_cables and np.any(motion.formed):
        states = sample_states(Flight.of(motion))
        curves = np.full((2, len(states.t)), np.nan)
        tensions = states.tensions[states.formed]
        curves[:, states.formed] = np.min(tensions, axis=1), np.max(tensions, axis=1)
        ranges = stated_tensions(motion)
        breaks = motion.drones.breaks - motion.drones.breaks[0]
        ends_of_pieces = np.repeat(breaks, 2)[1:-1]
        for bounds in (np.min(ranges[..., 0], axis=1), np.max(ranges[..., 1], axis=1)):
            of_pieces = np.where(motion.formed, bounds, np.nan)
            limits.append((ends_of_pieces, np.repeat(of_pieces, 2), ""))
        yield _plot(
            f"{flown.label('tension')} [N],\nas stated", "max", states.t, curves, limits, None
        )


def _plot(
    label: str,
    sense: str,
    t: Array,
    curves: Iterable[Array],
    limits: Sequence[tuple[Array, Array, str]],
    worst: tuple[float, float] | None,
) -> dict[str, Any]:
    """Return a plot: ``limits`` are times, values and labels, ``worst`` a time and a value."""
    values = [*curves, *(values for _, values, _ in limits), np.array(worst[1:] if worst else [])]
    return {
        "label": label,
        "sense": sense,
        "t": _rounded_list(t),
        "curves": [_rounded_list(curve) for curve in curves],
        "limits": [
            {"t": _rounded_list(a), "values": _rounded_list(b), "words": c} for a, b, c in limits
        ],
        "worst": worst and {"time": worst[0], "value": worst[1]},
        "top": HEADROOM * float(np.nanmax(np.concatenate(values))),
    }


def _rounded_list(values: Array) -> list[float | None]:
    """Return numbers with five significant digits; None for those that are not finite."""
    return [float(f"{x:.5g}") if math.isfinite(x) else None for x in values.tolist()]


def _versions_and_digests(problem: str, directory: Path) -> list[tuple[str, str]]:
    """Return versions and digests, as rows of a table."""
    rows = [("Python", platform.python_version())]
    for package in ("hitchopt", *PACKAGES):
        try:
            rows.append((package, metadata.version(package)))
        except metadata.PackageNotFoundError:
            rows.append((package, "(not installed)"))
    if problem:
        rows.append(("problem file, SHA-256", hashlib.sha256(problem.encode()).hexdigest()))
    digested = [name for name in DIGESTED_FILES if (directory / name).is_file()]
    return rows + [(f"{name}, SHA-256", digest(directory / name)) for name in digested]
