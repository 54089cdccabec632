"""Outlines from GeoJSON, tables of coordinates, and geometries of shapely.

Numbers are metres. Lines that meet are joined to closed outlines, and holes are ignored. Several
separate outlines are replaced by their convex hull. Notes list what was ignored or replaced, with
sizes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from hitchopt.errors import FileError, HitchoptError, InputError, optional_module
from hitchopt.retired import refuse_retired
from hitchopt.storage.files import parsed_json, require_file
from hitchopt.storage.tables import COMMA_REMEDY, numeric_table, text_lines
from hitchopt.values import Array

FLATNESS = 1e-4
"""[m] Largest distance of an outline from its simplification, and of a convex outline from its
hull."""

GRID = 1e-6  # [m] Grid on which lines are noded

JOIN_TOLERANCE = 1e-3
"""Largest gap between ends that meet, relative to the drawing's size; at most FLATNESS."""

MAX_GAP = 0.02  # Largest gap that may be a drawing error, relative to the drawing's size

MIN_AREA_RATIO = 1.0 + 1e-6
"""Smallest ratio of areas at which closing the gaps yields a different outline."""

MAX_FILE_SIZE = 20_000_000  # [B] Largest file: a drawing of a single part is smaller

MIN_EXTENT = 0.01  # [m] Smallest outline: smaller ones have other units, such as degrees
MAX_EXTENT = 20.0  # [m] Largest outline: larger ones have other units, such as millimetres

PAGE_TOLERANCE = 5e-4  # Largest fraction of its bounding box that a page or frame leaves out

Lines = list[Array]


@dataclass(frozen=True, eq=False)
class Drawing:
    """An outline, and notes on how it was derived."""

    outline: Array  # (m, 2) [m], its first point not repeated
    notes: tuple[str, ...]


def read_drawing(path: str | Path) -> Drawing:
    """Return the outline of a drawing.

    Raises
    ------
    FileError: the file cannot be read in the format that its suffix names.
    InputError: it has no closed outline, or one that is too large, probably in other units.
    UnsupportedError: a package that the format needs is not installed.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in READERS:
        refuse_retired(suffix)
        suffixes = ", ".join(READERS)
        raise InputError("outline", path.name, f"a drawing ({suffixes})", "save it as one of these")
    try:
        require_file(path)
        if path.stat().st_size > MAX_FILE_SIZE:
            raise FileError(f"{path}: has more than {MAX_FILE_SIZE:.0e} bytes")
        lines = READERS[suffix](path)
    except HitchoptError:
        raise
    except FileNotFoundError:
        raise FileError(f"{path}: there is no such file; name a drawing") from None
    except Exception as error:  # parsers raise errors of their own, and builtin ones
        reason = str(error).splitlines()
        raise FileError(f"{path}: cannot be read: {reason[0] if reason else error!r}") from None
    return _drawing_of(lines, path.name)


def drawing_of_geometry(geometry: Any) -> Drawing:
    """Return the outline of a geometry of shapely, or of a mapping that shapely accepts."""
    return _drawing_of(_rings(_library("shapely.geometry").shape(geometry)), "geometry")


def format_size(points: Array) -> str:
    """Return the size of points (m, 2) [m] along the axes."""
    width, depth = np.ptp(points, axis=0)
    return f"{width:.4g} x {depth:.4g} m"


def _read_geojson(path: Path) -> Lines:
    text = "\n".join(text_lines(path)).strip()
    if text.startswith("["):
        points = np.array(parsed_json(text), dtype=np.float64)
        if points.ndim != 2 or points.shape[1] != 2:
            raise ValueError("an outline is a list of points [x, y], without decimal commas")
        return [np.concatenate([points, points[:1]])]
    shapely = _library("shapely")
    try:
        return _rings(shapely.from_geojson(text))
    except shapely.errors.ShapelyError:
        raise ValueError("it is neither GeoJSON nor a list of points [x, y]") from None


def _read_table(path: Path) -> Lines:
    table = numeric_table(partial(text_lines, path), str(path))
    if table.width != 2:
        words = f"an outline is a list of points x, y, one on each line, not {table.width} numbers"
        raise ValueError(f"{words}; {COMMA_REMEDY}" if table.width == 4 else words)
    points = table.numbers([0, 1])
    return [np.concatenate([points, points[:1]])]


def _rings(geometry: Any) -> Lines:
    """Return the outer rings and lines of a geometry of shapely."""
    if hasattr(geometry, "geoms"):
        return [line for part in geometry.geoms for line in _rings(part)]
    line = geometry.exterior if hasattr(geometry, "exterior") else geometry
    return [np.array(line.coords, dtype=np.float64)[:, :2]]


def _drawing_of(lines: Lines, name: str) -> Drawing:
    """Return the outer outline of lines."""
    shapely, notes = _library("shapely"), list[str]()
    if not all(np.all(np.isfinite(line)) for line in lines):
        raise InputError("outline", name, "finite", "check its coordinates")
    strings = [shapely.LineString(line) for line in lines if len(line) > 1]
    if not strings:
        raise InputError("outline", name, "a drawing with lines", "it has no lines")
    points = np.concatenate(lines)
    size = float(np.max(np.ptp(points, axis=0)))
    if not MIN_EXTENT <= size <= MAX_EXTENT:
        extreme = f"least {MIN_EXTENT:g}" if size < MIN_EXTENT else f"most {MAX_EXTENT:g}"
        bound = f"at {extreme} m across, not {format_size(points)}"
        remedy = "write it in metres"
        if size < MIN_EXTENT:
            remedy = f"{remedy}; if these are degrees, as in GeoJSON, project them to metres"
        raise InputError("outline", name, bound, remedy)
    crossing = (line for line in strings if line.is_closed and not line.is_simple)
    if any(len(_faces(line)[0]) > 1 for line in crossing):
        bound, remedy = "an outline that does not cross itself", "check the order of its points"
        raise InputError("outline", name, bound, remedy)
    tolerance = min(FLATNESS, JOIN_TOLERANCE * size)
    strings += list(_bridges(strings, tolerance))
    faces, ends = _faces(strings)
    _check_gaps(strings, faces, ends, name)
    outlines = _geometries(shapely.unary_union(faces))
    _note_holes(outlines, faces, notes)
    outer = shapely.unary_union(outlines)
    hull = outer.convex_hull
    if len(outlines) > 1 or hull.exterior.hausdorff_distance(outer.exterior) < FLATNESS:
        outer = hull
    outline = np.array(outer.simplify(FLATNESS).exterior.coords, dtype=np.float64)[:-1]
    if len(outlines) > 1:
        sizes = _format_sizes(outlines)
        notes.append(f"{len(outlines)} separate outlines, {sizes}: their convex hull is used")
    return Drawing(outline, tuple(notes))


def _faces(lines: Any) -> tuple[list[Any], Array]:
    """Return the faces between lines, and their free ends (k, 2) [m]."""
    shapely = _library("shapely")
    noded = shapely.unary_union(lines, grid_size=GRID)
    faces = shapely.polygonize_full([noded])[0]
    each = [np.array(line.coords)[[0, -1]] for line in _geometries(noded) if not line.is_closed]
    nodes = np.round(np.concatenate([np.zeros((0, 2)), *each]) / GRID)
    ends, counts = np.unique(nodes, axis=0, return_counts=True)
    return _geometries(faces), ends[counts == 1] * GRID


def _geometries(geometry: Any) -> list[Any]:
    """Return the parts of a geometry, or itself, if not empty."""
    each = getattr(geometry, "geoms", [geometry])
    return [part for part in each if not part.is_empty]


def _bridges(strings: Sequence[Any], tolerance: float) -> Iterator[Any]:
    """Yield bridges from free ends of lines to lines within a tolerance [m]."""
    shapely = _library("shapely")
    open_lines = [k for k, string in enumerate(strings) if not string.is_closed]
    ends = [shapely.Point(strings[k].coords[i]) for k in open_lines for i in (0, -1)]
    if not ends:
        return
    pairs = shapely.STRtree(strings).query(ends, predicate="dwithin", distance=tolerance)
    for end, k in pairs.T.tolist():
        other = ends[end ^ 1] if open_lines[end // 2] == k else strings[k]
        bridge = shapely.shortest_line(ends[end], other)
        if 0.0 < bridge.length <= tolerance:
            yield bridge


def _check_gaps(lines: Sequence[Any], faces: Sequence[Any], ends: Array, name: str) -> None:
    """Raise InputError if there is no closed outline, or if closing gaps would enlarge it."""
    shapely = _library("shapely")
    size = float(np.max(np.ptp(shapely.get_coordinates(lines), axis=0), initial=0.0))
    pairs: list[Array] = []
    if len(ends) > 1:
        each = shapely.points(ends)
        other = shapely.STRtree(each).query_nearest(each, exclusive=True, all_matches=False)[1]
        mutual = [i for i in range(len(ends)) if other[other[i]] == i < other[i]]
        pairs = sorted((ends[[i, other[i]]] for i in mutual), key=_length)
    narrow = [pair for pair in pairs if _length(pair) < MAX_GAP * size]
    if faces and narrow:
        closed = _faces([*lines, *map(shapely.LineString, narrow)])[0]
        if shapely.unary_union(closed).area <= MIN_AREA_RATIO * shapely.unary_union(faces).area:
            return
        pairs = narrow
    if not faces or narrow:
        each = (
            f"{1e3 * _length(p):.3g} mm at {np.mean(p, axis=0).round(4).tolist()} m" for p in pairs
        )
        gaps = f": gaps of {', '.join(list(each)[:3])}" if pairs else ""
        bound, remedy = "a drawing with a closed outline", f"join the ends of its lines{gaps}"
        raise InputError("outline", name, bound, remedy)


def _length(pair: Array) -> float:
    return float(np.hypot(*(pair[1] - pair[0])))


def _note_holes(outlines: Sequence[Any], faces: Sequence[Any], notes: list[str]) -> None:
    """Note the largest holes of a single outline, which may be a page around the part."""
    shapely = _library("shapely")
    rings = [shapely.Polygon(ring) for face in faces for ring in face.interiors]
    holes: list[Any] = []
    for ring in sorted(rings, key=lambda ring: -ring.area):
        if not any(other.contains(ring) for other in holes):
            holes.append(ring)
    if len(outlines) == 1 and holes:
        fills_box = outlines[0].area > (1.0 - PAGE_TOLERANCE) * outlines[0].envelope.area
        question = "; if it is a page or a frame around the part, hide it" if fills_box else ""
        notes.append(f"holes within it are omitted: {_format_sizes(holes)}{question}")


def _format_sizes(outlines: Sequence[Any]) -> str:
    sizes = [format_size(np.array(outline.exterior.coords)) for outline in outlines[:4]]
    return ", ".join([*sizes, "…"] if len(outlines) > 4 else sizes)


_library = partial(optional_module, purpose="drawings need", extra="fit")

READERS: dict[str, Callable[[Path], Lines]] = {
    ".geojson": _read_geojson,
    ".json": _read_geojson,
    ".csv": _read_table,
    ".txt": _read_table,
}
"""Readers by file suffix; each returns lines (points, 2) [m]."""
