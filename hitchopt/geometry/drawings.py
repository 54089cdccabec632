"""Outlines from drawings: SVG, DXF, GeoJSON, tables of coordinates; and from shapely's geometries.

A drawing that states its unit is converted to metres; other numbers are metres. What is not drawn,
as on layers that are off, is left out. Curves are flattened to chords. Lines that meet are joined
to closed outlines; holes are left out. Of several outlines apart from each other the convex hull is
taken. Notes say so, with sizes.
"""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from hitchopt.errors import FileError, HitchoptError, InputError, UnsupportedError
from hitchopt.storage.files import parsed_json
from hitchopt.storage.tables import COMMA_REMEDY, numeric_table, text_lines, with_decimal_point
from hitchopt.values import Array

FLATNESS = 1e-4
"""[m] Largest distance of a curve to its chords, of chords to the remaining corners, and of a
convex outline to its hull."""

CHORDS = 256
"""Chords of a curve in SVG: they are FLATNESS off a quarter of a circle of 20 m."""

GRID = 1e-6
"""[m] Lines are noded on this grid."""

MEET = 1e-3
"""Ends of lines that are nearer than this share of a drawing, and than FLATNESS, meet."""

GAP = 0.02
"""Ends that are nearer than this share of a drawing may have been meant to meet."""

LARGER = 1.0 + 1e-6
"""Ratio of areas from which on an outline without gaps is another one."""

MAX_SIZE = 20_000_000
"""Largest file [B]: a larger one is no drawing of a single part."""

LARGEST = 20.0
"""[m] No outline is larger: it is one in other units."""

INCH, PIXELS = 0.0254, 96.0
"""[m] An inch, and pixels on it, by CSS: lengths with units in SVG are converted to pixels."""

SAME_SIZE = 5e-4
"""Largest share of its box that a rectangle along the axes leaves out."""

LENGTH = re.compile(
    r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?)\s*(mm|cm|in|pt|pc|px|%|)\s*", re.I
)
LENGTHS = ("x", "y", "width", "height", "r", "rx", "ry", "cx", "cy", "x1", "x2", "y1", "y2")
"""Attributes of shapes in SVG that are lengths, and those that are understood."""

Lines = list[Array]


@dataclass(frozen=True, eq=False)
class Drawing:
    """An outline, and notes on how it was taken."""

    outline: Array  # (m, 2) [m], its first point not repeated
    notes: tuple[str, ...]


def read_drawing(path: str | Path) -> Drawing:
    """Return the outline of a drawing.

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
    notes: list[str] = []
    try:
        if path.stat().st_size > MAX_SIZE:
            raise FileError(f"{path}: has more than {MAX_SIZE:.0e} bytes, too many for an outline")
        lines = READERS[kind](path, notes)
    except HitchoptError:
        raise
    except FileNotFoundError:
        raise FileError(f"{path}: there is no such file; give a drawing") from None
    except Exception as error:  # parsers raise their own kinds, and builtin ones
        reason = str(error).splitlines()
        raise FileError(f"{path}: cannot be read: {reason[0] if reason else error!r}") from None
    return _joined(lines, path.name, notes)


def drawing_of_geometry(geometry: Any) -> Drawing:
    """Return the outline of a geometry of shapely, or of data that shapely can read."""
    return _joined(_rings(_library("shapely.geometry").shape(geometry)), "geometry", [])


def size_in_words(points: Array) -> str:
    """Return the size of points (m, 2) [m] along the axes."""
    width, depth = np.ptp(points, axis=0)
    return f"{width:.4g} x {depth:.4g} m"


def _read_svg(path: Path, notes: list[str]) -> Lines:
    elements, root = _library("svgelements"), ElementTree.fromstring(path.read_bytes())
    _prepare(root, path.name)
    sizes = [root.get(name) for name in ("width", "height")]
    stated = {size is not None and size[-2:].isalpha() for size in sizes}
    if len(stated) == 2:
        bound, remedy = "a drawing with both width and height in units", "add the other one"
        raise InputError("outline", path.name, bound, remedy)
    scale = INCH / PIXELS if stated == {True} else 1.0
    drawing = elements.SVG.parse(io.BytesIO(ElementTree.tostring(root)), reify=True)
    drawn: dict[bool, Lines] = {True: [], False: []}
    for shape in drawing.elements(lambda each: isinstance(each, elements.Shape)):
        if shape.values.get("visibility") in {"hidden", "collapse"}:
            continue
        for part in elements.Path(shape).as_subpaths():
            ends = [
                segment.npoint(np.linspace(0.0, 1.0, CHORDS + 1)[:: CHORDS if straight else 1])
                for segment in part
                if segment.start is not None and not isinstance(segment, elements.Move)
                for straight in [isinstance(segment, elements.Line)]
            ]
            if ends:  # y points down in drawings
                line = np.concatenate(ends).astype(np.float64) * [scale, -scale]
                drawn[_is_seen(shape)].append(line)
    if drawn[True] and drawn[False]:
        size = size_in_words(np.concatenate(drawn[False]))
        notes.append(f"what has no lines, and is white or not filled, is left out: {size} in all")
    return drawn[True] or drawn[False]


def _prepare(root: ElementTree.Element, name: str) -> None:
    """Normalise lengths, and move elements that are drawn only by reference into defs."""
    for parent in list(root.iter()):
        for key in LENGTHS:
            if (value := parent.get(key)) is not None:
                if (match := LENGTH.fullmatch(value)) is None:
                    bound = f"lengths in mm, cm, in, pt, pc or px, and not {key}={value[:30]!r}"
                    raise InputError("outline", name, bound, "save it in mm, with decimal points")
                parent.set(key, "".join(match.groups()).lower())
        for i, child in enumerate(list(parent)):
            space, _, tag = str(child.tag).rpartition("}")
            if tag in {"symbol", "marker", "mask"}:
                parent[i] = ElementTree.Element(f"{space}}}defs" if space else "defs")
                child.tag = f"{space}}}g" if space else "g"
                parent[i].append(child)


def _is_seen(shape: Any) -> bool:
    """Return whether a shape is seen on white paper."""
    stroke, fill = shape.stroke, shape.fill
    lines = stroke is not None and stroke.value is not None and stroke.alpha > 0
    lines = lines and shape.stroke_width != 0.0
    filled = fill is not None and fill.value is not None and fill.alpha > 0
    seen = lines or (filled and fill.hex != "#ffffff")
    return bool(seen) and shape.values.get("opacity") not in {"0", "0.0", "0%"}


def _read_dxf(path: Path, notes: list[str]) -> Lines:
    ezdxf, paths, units = map(_library, ("ezdxf", "ezdxf.path", "ezdxf.units"))
    try:
        drawing = ezdxf.readfile(str(path))
    except (OSError, ValueError, ezdxf.DXFError):  # perhaps a byte order mark, or commas
        text = list(text_lines(path))
        text[1::2] = map(with_decimal_point, text[1::2])  # a code and its value take a line each
        drawing = ezdxf.read(io.StringIO("\n".join(text)))
    if not 0 <= drawing.units <= max(units.InsertUnits):
        bound = f"a drawing in a known unit, and not $INSUNITS = {drawing.units}"
        raise InputError("outline", path.name, bound, "set it to 4, millimetres, or to 6, metres")
    scale = units.conversion_factor(drawing.units, units.M) if drawing.units else 1.0
    lines: Lines = []
    hidden: set[str] = set()
    for entity in _entities(drawing, drawing.modelspace(), "0", hidden):
        try:
            curve = paths.make_path(entity)
        except TypeError:
            continue  # texts, dimensions and the like have no path
        points = np.array([[p.x, p.y] for p in curve.flattening(FLATNESS / scale)])
        if len(points) > 1:
            lines.append(scale * points)
    if hidden:
        layers = ", ".join(sorted(hidden))
        notes.append(f"layers that are off, frozen or not plotted are left out: {layers}")
    return lines


def _entities(drawing: Any, layout: Any, around: str, hidden: set[str]) -> Iterator[Any]:
    """Yield the entities of a drawing that are seen, blocks taken apart.

    Dimensions and leaders stay whole. In blocks layer 0 is that of the block, ``around``; names of
    layers that are not seen are added to ``hidden``.
    """
    for entity in layout:
        layer = around if entity.dxf.layer == "0" else entity.dxf.layer
        given = drawing.layers.get(layer) if drawing.layers.has_entry(layer) else None
        block = entity.dxftype() == "INSERT"
        off = given is not None and (given.is_frozen() or (given.is_off() and not block))
        off |= given is not None and not given.dxf.plot and not block
        if off or layer.lower() == "defpoints":
            hidden.add(layer)
        elif entity.dxf.get("invisible", 0):
            continue
        elif block:
            yield from _entities(drawing, entity.virtual_entities(), layer, hidden)
        else:
            yield entity


def _read_geojson(path: Path, notes: list[str]) -> Lines:  # noqa: ARG001
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


def _read_table(path: Path, notes: list[str]) -> Lines:  # noqa: ARG001
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


def _joined(lines: Lines, name: str, notes: list[str]) -> Drawing:
    """Return the outer outline that lines make."""
    shapely = _library("shapely")
    if not all(np.all(np.isfinite(line)) for line in lines):
        raise InputError("outline", name, "finite", "check its coordinates")
    places = np.concatenate([np.zeros((0, 2)), *lines])
    size = float(np.max(np.ptp(places, axis=0))) if len(places) else 0.0
    if size > LARGEST:
        bound = f"at most {LARGEST:g} m across, not {size:.4g} m"
        remedy = "state the drawing's unit: numbers without one are metres"
        raise InputError("outline", name, bound, remedy)
    strings = [shapely.LineString(line) for line in lines if len(line) > 1]
    crossing = (each for each in strings if each.is_closed and not each.is_simple)
    if any(len(_faces(each)[0]) > 1 for each in crossing):
        bound, remedy = "an outline that does not cross itself", "check the order of its points"
        raise InputError("outline", name, bound, remedy)
    near = min(FLATNESS, MEET * size)
    strings += list(_bridges(strings, near))
    faces, ends = _faces(strings)
    _refuse_gaps(strings, faces, ends, name, notes)
    outlines = _geometries(shapely.unary_union(faces))
    _note_holes(outlines, faces, notes)
    whole = shapely.unary_union(outlines)
    hull = whole.convex_hull
    one = len(outlines) == 1
    if not one or hull.exterior.hausdorff_distance(whole.exterior) < FLATNESS:
        whole = hull
    outline = np.array(whole.simplify(FLATNESS).exterior.coords, dtype=np.float64)[:-1]
    if not one:
        each = _sizes(outlines)
        notes.append(f"{len(outlines)} outlines apart from each other, {each}: their convex hull")
    return Drawing(outline, tuple(notes))


def _faces(lines: Any) -> tuple[list[Any], Array]:
    """Return the faces between lines, and the ends (k, 2) [m] at which nothing else is."""
    shapely = _library("shapely")
    noded = shapely.unary_union(lines, grid_size=GRID)
    faces = shapely.polygonize_full([noded])[0]
    each = [np.array(line.coords)[[0, -1]] for line in _geometries(noded) if not line.is_closed]
    nodes = np.round(np.concatenate([np.zeros((0, 2)), *each]) / GRID)
    ends, counts = np.unique(nodes, axis=0, return_counts=True)
    return _geometries(faces), ends[counts == 1] * GRID


def _geometries(geometry: Any) -> list[Any]:
    """Return the lines or polygons that are a geometry, or its parts."""
    each = getattr(geometry, "geoms", [geometry])
    return [part for part in each if not part.is_empty]


def _bridges(strings: Sequence[Any], near: float) -> Iterator[Any]:
    """Yield bridges from the ends of lines to lines within a distance [m]."""
    shapely = _library("shapely")
    opened = [k for k, string in enumerate(strings) if not string.is_closed]
    ends = [shapely.Point(strings[k].coords[i]) for k in opened for i in (0, -1)]
    if not ends:
        return
    pairs = shapely.STRtree(strings).query(ends, predicate="dwithin", distance=near)
    for end, k in pairs.T.tolist():
        other = ends[end ^ 1] if opened[end // 2] == k else strings[k]
        bridge = shapely.shortest_line(ends[end], other)
        if 0.0 < bridge.length <= near:
            yield bridge


def _refuse_gaps(
    lines: Sequence[Any], faces: Sequence[Any], ends: Array, name: str, notes: Sequence[str]
) -> None:
    """Raise InputError if lines close to no outline, or to a larger one without their gaps."""
    shapely = _library("shapely")
    size = float(np.max(np.ptp(shapely.get_coordinates(lines), axis=0), initial=0.0))
    pairs: list[Array] = []
    if len(ends) > 1:
        each = shapely.points(ends)
        other = shapely.STRtree(each).query_nearest(each, exclusive=True, all_matches=False)[1]
        mutual = [i for i in range(len(ends)) if other[other[i]] == i < other[i]]
        pairs = sorted((ends[[i, other[i]]] for i in mutual), key=_length)
    small = [pair for pair in pairs if _length(pair) < GAP * size]
    if faces and small:
        closed = _faces([*lines, *map(shapely.LineString, small)])[0]
        if shapely.unary_union(closed).area <= LARGER * shapely.unary_union(faces).area:
            return
        pairs = small
    if not faces or small:
        each = (
            f"{1e3 * _length(p):.3g} mm at {np.mean(p, axis=0).round(4).tolist()} m" for p in pairs
        )
        gaps = f": gaps of {', '.join(list(each)[:3])}" if pairs else ""
        bound, remedy = "a drawing with a closed outline", f"join the ends of its lines{gaps}"
        raise InputError("outline", name, bound, "; ".join([remedy, *notes]))


def _length(pair: Array) -> float:
    return float(np.hypot(*(pair[1] - pair[0])))


def _note_holes(outlines: Sequence[Any], faces: Sequence[Any], notes: list[str]) -> None:
    """Note the largest rings within a single outline, which may be a part on a sheet of paper."""
    shapely = _library("shapely")
    rings = [shapely.Polygon(ring) for face in faces for ring in face.interiors]
    inner: list[Any] = []
    for ring in sorted(rings, key=lambda ring: -ring.area):
        if not any(other.contains(ring) for other in inner):
            inner.append(ring)
    if len(outlines) == 1 and inner:
        box = outlines[0].area > (1.0 - SAME_SIZE) * outlines[0].envelope.area
        question = "; if it is a page or a frame around the part, hide it" if box else ""
        notes.append(f"left out as holes within it: {_sizes(inner)}{question}")


def _sizes(outlines: Sequence[Any]) -> str:
    each = [size_in_words(np.array(outline.exterior.coords)) for outline in outlines[:4]]
    return ", ".join([*each, "…"] if len(outlines) > 4 else each)


def _library(name: str) -> Any:
    try:
        return import_module(name)
    except ImportError as error:
        needed = error.name or f"other libraries ({error})"
        message = f"drawings need {needed}; pip install 'hitchopt[fit]'"
        raise UnsupportedError(message) from None


READERS: dict[str, Callable[[Path, list[str]], Lines]] = {
    ".svg": _read_svg,
    ".dxf": _read_dxf,
    ".geojson": _read_geojson,
    ".json": _read_geojson,
    ".csv": _read_table,
    ".txt": _read_table,
}
"""Readers by the endings of files' names, which return lines (points, 2) [m] and add notes."""
