"""Outlines from drawings: SVG, DXF, GeoJSON, tables of coordinates; and from shapely's geometries.

A drawing that states its unit is converted to metres; other numbers are metres. Curves are
flattened to chords. Lines that meet are joined to closed outlines, holes are left out, and of
several outlines apart from each other the convex hull is taken.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from hitchopt.errors import FileError, HitchoptError, InputError, UnsupportedError
from hitchopt.storage.files import parsed_json
from hitchopt.values import Array

FLATNESS = 1e-4
"""[m] Largest distance of a curve to its chords, of chords to the corners that are kept, and of a
convex outline to its hull."""

CHORDS = 256
"""Chords of a curve in SVG: they are FLATNESS off a quarter of a circle of 20 m."""

GRID = 1e-6
"""[m] Ends of lines that are nearer than this are one point."""

MAX_SIZE = 20_000_000
"""Largest file [B]: a larger one is no drawing of a single part."""

LARGEST = 20.0
"""[m] No outline is larger: it is one in other units."""

INCH, PIXELS = 0.0254, 96.0
"""[m] An inch, and pixels on it, by CSS: lengths with units in SVG are converted to pixels."""

Lines = list[Array]


def read_outline(path: str | Path) -> Array:
    """Return the outline of a drawing, (m, 2) [m], its first point not repeated.

    Raises
    ------
    FileError: the file cannot be read as what its name says.
    InputError: there is no closed outline in it, or one larger than objects are, in other units.
    UnsupportedError: a package for such files is not installed.
    """
    path = Path(path)
    kind = path.suffix.lower()
    if kind not in READERS:
        known = ", ".join(READERS)
        raise InputError("outline", path.name, f"a drawing ({known})", "save it as one of these")
    try:
        if path.stat().st_size > MAX_SIZE:
            raise FileError(f"{path}: has more than {MAX_SIZE:.0e} bytes, too many for an outline")
        lines = READERS[kind](path)
    except HitchoptError:
        raise
    except Exception as error:  # parsers raise their own kinds, and builtin ones
        reason = str(error).splitlines()
        raise FileError(f"{path}: cannot be read: {reason[0] if reason else error!r}") from None
    outline = _joined(lines, path.name)
    size = float(np.max(np.ptp(outline, axis=0)))
    if size > LARGEST:
        bound = f"at most {LARGEST:g} m across, not {size:.4g} m"
        remedy = "state the drawing's unit: numbers without one are metres"
        raise InputError("outline", path.name, bound, remedy)
    return outline


def outline_of_geometry(geometry: Any) -> Array:
    """Return the outline (m, 2) [m] of a geometry of shapely, or of what shapely can read."""
    return _joined(_rings(_library("shapely.geometry").shape(geometry)), "geometry")


def _read_svg(path: Path) -> Lines:
    elements = _library("svgelements")
    drawing = elements.SVG.parse(str(path), reify=True)
    sizes = [drawing.values["attributes"].get(name) for name in ("width", "height")]
    stated = {size is not None and size[-2:].isalpha() for size in sizes}
    if len(stated) == 2:
        bound, remedy = "a drawing with both width and height in units", "add the other one"
        raise InputError("outline", path.name, bound, remedy)
    scale = INCH / PIXELS if stated == {True} else 1.0
    lines: Lines = []
    for shape in drawing.elements(lambda each: isinstance(each, elements.Shape)):
        for part in elements.Path(shape).as_subpaths():
            ends = [
                segment.npoint(np.linspace(0.0, 1.0, CHORDS + 1)[:: CHORDS if straight else 1])
                for segment in part
                if segment.start is not None and not isinstance(segment, elements.Move)
                for straight in [isinstance(segment, elements.Line)]
            ]
            if ends:  # y points down in drawings
                lines.append(np.concatenate(ends).astype(np.float64) * [scale, -scale])
    return lines


def _read_dxf(path: Path) -> Lines:
    paths, units = _library("ezdxf.path"), _library("ezdxf.units")
    drawing = _library("ezdxf").readfile(str(path))
    scale = units.conversion_factor(drawing.units, units.M) if drawing.units else 1.0
    lines: Lines = []
    for entity in _entities(drawing.modelspace()):
        try:
            curve = paths.make_path(entity)
        except TypeError:
            continue  # texts, dimensions and the like have no path
        points = np.array([[p.x, p.y] for p in curve.flattening(FLATNESS / scale)])
        if len(points) > 1:
            lines.append(scale * points)
    return lines


def _entities(layout: Any) -> Iterator[Any]:
    """Return the entities of a drawing, blocks taken apart; dimensions and leaders stay whole."""
    for entity in layout:
        if entity.dxftype() == "INSERT":
            yield from _entities(entity.virtual_entities())
        else:
            yield entity


def _read_geojson(path: Path) -> Lines:
    text = path.read_text("utf-8").strip()
    if text.startswith("["):
        points = np.array(parsed_json(text), dtype=np.float64)
        if points.ndim != 2 or points.shape[1] != 2:
            raise ValueError("an outline is a list of points [x, y]")
        return [np.concatenate([points, points[:1]])]
    shapely = _library("shapely")
    try:
        return _rings(shapely.from_geojson(text))
    except shapely.errors.ShapelyError:
        raise ValueError("it is neither GeoJSON nor a list of points [x, y]") from None


def _read_table(path: Path) -> Lines:
    """Read coordinates: columns are apart by commas, semicolons, tabs or blanks.

    Lines without a number before the first ones are headings; beside semicolons, decimals may have
    commas.
    """
    rows: list[list[float]] = []
    for number, line in enumerate(path.read_text("utf-8-sig").splitlines(), 1):
        text = line.partition("#")[0].strip().rstrip(",;")
        commas = "." if ";" in text else " "
        words = text.replace(",", commas).replace(";", " ").split()
        try:
            row = [float(word) for word in words]
        except ValueError:
            if not rows and not any(character.isdigit() for character in text):
                continue
            raise ValueError(f"line {number} is not a point x, y: {line.strip()}") from None
        if row:
            rows.append(row)
    if {len(row) for row in rows} != {2}:
        raise ValueError("an outline is a list of points x, y, one on each line")
    return [np.array([*rows, rows[0]])]


def _rings(geometry: Any) -> Lines:
    """Return the outer rings and lines of a geometry of shapely."""
    if hasattr(geometry, "geoms"):
        return [line for part in geometry.geoms for line in _rings(part)]
    line = geometry.exterior if hasattr(geometry, "exterior") else geometry
    return [np.array(line.coords, dtype=np.float64)[:, :2]]


def _joined(lines: Lines, name: str) -> Array:
    """Return the outer outline (m, 2) [m] that lines make."""
    shapely, polygonize = _library("shapely"), _library("shapely.ops").polygonize
    rings = [np.round(line / GRID) * GRID for line in lines]
    if not all(np.all(np.isfinite(ring)) for ring in rings):
        raise InputError("outline", name, "finite", "check its coordinates")
    usable = [shapely.LineString(ring) for ring in rings if len(ring) > 1]
    crossing = (each for each in usable if each.is_closed and not each.is_simple)
    if any(len(list(polygonize(shapely.unary_union(each)))) > 1 for each in crossing):
        bound, remedy = "an outline that does not cross itself", "check the order of its points"
        raise InputError("outline", name, bound, remedy)
    areas = list(polygonize(shapely.unary_union(usable)))
    if not areas:
        bound, remedy = "a drawing with a closed outline", "join the ends of its lines"
        raise InputError("outline", name, bound, remedy)
    whole = shapely.unary_union(areas)
    hull = whole.convex_hull
    one = hasattr(whole, "exterior")
    if not one or hull.exterior.hausdorff_distance(whole.exterior) < FLATNESS:
        whole = hull
    return np.array(whole.simplify(FLATNESS).exterior.coords, dtype=np.float64)[:-1]


def _library(name: str) -> Any:
    try:
        return import_module(name)
    except ImportError as error:
        needed = error.name or f"other libraries ({error})"
        message = f"drawings need {needed}; pip install 'hitchopt[fit]'"
        raise UnsupportedError(message) from None


READERS: dict[str, Callable[[Path], Lines]] = {
    ".svg": _read_svg,
    ".dxf": _read_dxf,
    ".geojson": _read_geojson,
    ".json": _read_geojson,
    ".csv": _read_table,
    ".txt": _read_table,
}
"""Readers by the endings of files' names; each returns lines (points, 2) [m]."""
