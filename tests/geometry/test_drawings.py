"""Outlines from drawings: units, curves, joined lines, and invalid files."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import hitchopt as ho
from hitchopt.errors import FileError
from hitchopt.geometry.drawings import FLATNESS, drawing_of_geometry, read_drawing
from hitchopt.values import Array

SVG = '<svg xmlns="http://www.w3.org/2000/svg" {size}viewBox="0 0 400 300">{shape}</svg>'
RECTANGLE = '<rect x="0" y="0" width="400" height="300"/>'
SMALL = '<rect x="0" y="0" width="4" height="3"/>'
RING = [[0.0, 0.0], [0.4, 0.0], [0.4, 0.3], [0.0, 0.3], [0.0, 0.0]]


def size_and_area(outline: Array) -> tuple[float, float, float]:
    section = ho.Section(outline)
    width, depth = np.ptp(section.core, axis=0)
    return float(width), float(depth), section.area


POLYGON = {"type": "Polygon", "coordinates": [RING]}
FEATURE = {"type": "Feature", "properties": {}, "geometry": POLYGON}

BOXES: list[tuple[str, str, float]] = [
    ("a.svg", SVG.format(size='width="400mm" height="300mm" ', shape=RECTANGLE), 1.0),
    ("a.svg", SVG.format(size="", shape=SMALL), 10.0),
    ("a.svg", SVG.format(size='width="800" height="600" ', shape=SMALL), 20.0),
    ("a.json", json.dumps(POLYGON), 1.0),
    ("a.json", json.dumps({"type": "FeatureCollection", "features": [FEATURE]}), 1.0),
    ("a.json", json.dumps(RING[:-1]), 1.0),
    ("a.csv", "# x, y\n0.0, 0.0\n0.4, 0.0\n0.4, 0.3\n0.0, 0.3", 1.0),
    ("a.txt", "\ufeffx [m];y [m]\n0;0\n0,4;0\n0,4;0,3\n0;0,3\n", 1.0),
    ("a.csv", "0\t0\n0.4\t0\n\n0.4\t0.3  # a corner\n0\t0.3", 1.0),
    ("a.csv", "0, 0;\n0.4, 0;\n0.4, 0.3;\n0, 0.3;\n", 1.0),
    ("a.csv", "0,0\n0.4,0\n0.4,0.3\n0,0.3\n", 1.0),  # whole numbers, no decimal comma
    ("a.csv", "0,0\n4,0\n4,3\n0,3\n", 10.0),
    ("a.csv", "0,0;0\n0,4;0\n0,4;0,3\n0;0,3\n", 1.0),
    ("a.csv", "x;y\n\u22120,4;\u22120,3\n0;\u22120,3\n0;0\n\u22120,4;0\n", 1.0),
    ("a.csv", "\u22120.4,\u22120.3\n0,-0.3\n0,0\n-0.4,0\n", 1.0),
]
"""Files with a box of 0.4 m by 0.3 m, times a factor."""


@pytest.mark.parametrize(("name", "text", "size"), BOXES)
def test_boxes_keep_their_size(tmp_path: Path, name: str, text: str, size: float) -> None:
    """SVG states its unit or is in metres; tables have the formats of other programs."""
    (tmp_path / name).write_text(text, encoding="utf-8")
    result = size_and_area(read_drawing(tmp_path / name).outline)
    assert result == pytest.approx((0.4 * size, 0.3 * size, 0.12 * size**2), rel=1e-4)


@pytest.mark.parametrize("unit", ["px", "mm", ""])
def test_pixels_are_noted_as_no_physical_unit(unit: str, tmp_path: Path) -> None:
    path, part = tmp_path / "a.svg", RECTANGLE if unit else SMALL
    path.write_text(SVG.format(size=f'width="400{unit}" height="300{unit}" ', shape=part))
    notes = read_drawing(path).notes
    assert ["three quarters" in note for note in notes] == [True] * (unit == "px")


def test_svg_is_not_mirrored_and_curves_are_flattened_within_0_1_mm(tmp_path: Path) -> None:
    drawing = tmp_path / "wedge.svg"
    drawing.write_text(SVG.format(size="", shape='<polygon points="0,0 4,0 0,2"/>'))
    assert sorted(read_drawing(drawing).outline.tolist()) == [[0.0, -2.0], [0.0, 0.0], [4.0, 0.0]]
    drawing.write_text(SVG.format(size="", shape='<circle cx="1" cy="2" r="0.2"/>'))
    outline = read_drawing(drawing).outline - [1.0, -2.0]
    middles = 0.5 * (outline + np.roll(outline, -1, axis=0))
    away = np.hypot(*np.concatenate([outline, middles]).T)
    assert np.max(np.abs(away - 0.2)) < 2.0 * FLATNESS


def rectangle(x: float, y: float, width: float, height: float) -> tuple[str, str]:
    size = f'x="{x}" y="{y}" width="{width}" height="{height}"'
    return f"<rect {size}/>", f"M{x} {y}h{width}v{height}h{-width}z"


def rounded(x: float, y: float, width: float, height: float) -> tuple[str, str]:
    rx, ry = 0.3 * width, 0.2 * height
    size = f'x="{x}" y="{y}" width="{width}" height="{height}" rx="{rx}" ry="{ry}"'
    path = f"M{x + rx} {y}h{width - 2 * rx}a{rx} {ry} 0 0 1 {rx} {ry}v{height - 2 * ry}"
    path += f"a{rx} {ry} 0 0 1 {-rx} {ry}h{2 * rx - width}a{rx} {ry} 0 0 1 {-rx} {-ry}"
    return f"<rect {size}/>", f"{path}v{2 * ry - height}a{rx} {ry} 0 0 1 {rx} {-ry}z"


def oval(x: float, y: float, width: float, height: float) -> tuple[str, str]:
    rx, ry = 0.5 * width, 0.5 * height
    shape = f'<ellipse cx="{x}" cy="{y}" rx="{rx}" ry="{ry}"/>'
    return shape, f"M{x - rx} {y}a{rx} {ry} 0 0 0 {width} 0a{rx} {ry} 0 0 0 {-width} 0z"


def disc(x: float, y: float, width: float, height: float) -> tuple[str, str]:
    width = min(width, height)
    path = oval(x, y, width, width)[1]
    return f'<circle cx="{x}" cy="{y}" r="{0.5 * width}"/>', path


def kite(x: float, y: float, width: float, height: float) -> tuple[str, str]:
    points = f"{x},{y} {x + width},{y} {x + 0.4 * width},{y + height}"
    return f'<polygon points="{points}"/>', f"M{points}z"


def strokes_of_kite(x: float, y: float, width: float, height: float) -> tuple[str, str]:
    ends = f"{x + width},{y} {x + 0.4 * width},{y + height} {x},{y}"
    line = f'<line x1="{x}" y1="{y}" x2="{x + width}" y2="{y}" stroke="red"/>'
    return f'{line}<polyline points="{ends}"/>', f"M{x} {y}L{ends}"


SHAPES = [rectangle, rounded, oval, disc, kite, strokes_of_kite]
COORDINATES = st.floats(-0.8, 0.8).map(lambda x: round(x, 4))
SIZES = st.floats(0.4, 0.8).map(lambda x: round(x, 4))
OUTER = {
    "": np.eye(2),
    "rotate(30)": np.array([[0.75**0.5, -0.5], [0.5, 0.75**0.5]]),
    "skewX(45) scale(-1 0.5)": np.array([[-1.0, 0.5], [0.0, 0.5]]),
}
"""Transforms of a group, and their matrices."""


@pytest.mark.parametrize("shape", SHAPES)
@given(
    box=st.tuples(COORDINATES, COORDINATES, SIZES, SIZES),
    inner=st.tuples(*6 * [COORDINATES]),
    outer=st.sampled_from([*OUTER]),
)
@settings(max_examples=5)
def test_svg_shapes_are_transformed_as_their_paths(
    shape: Callable[..., tuple[str, str]],
    box: tuple[float, ...],
    inner: tuple[float, ...],
    outer: str,
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    """The transform may be the shape's own or a group's. Outlines are compared by their extents."""
    a, b, c, d, e, f = inner
    assume(abs(a * d - b * c) > 0.05)
    file = tmp_path_factory.getbasetemp() / f"{shape.__name__}.svg"

    def extents(text: str, matrix: Array, offset: Array) -> Array:
        file.write_text(SVG.format(size="", shape=text))
        moved = (read_drawing(file).outline * [1.0, -1.0]) @ matrix.T + offset
        angles = np.linspace(0.0, 2.0 * math.pi, 33)
        reach: Array = np.max(moved @ [np.cos(angles), np.sin(angles)], axis=0)
        return reach

    drawn, command = shape(*box)
    transform = f'transform="matrix({a} {b} {c} {d} {e} {f})"'
    path = f'<path d="{command}" {transform}/>'
    group = f'<g transform="{outer}">'
    here, linear = (np.eye(2), np.zeros(2)), OUTER[outer] @ [[a, c], [b, d]]
    expected = extents(drawn, linear, OUTER[outer] @ [e, f])
    for text in (drawn.replace("/>", f" {transform}/>"), f"<g {transform}>{drawn}</g>", path):
        found = extents(f"{group}{text}</g>", *here)
        np.testing.assert_allclose(found, expected, atol=4.0 * FLATNESS)


def lines(space: Any) -> None:
    corners = [(0, 0), (16, 0), (16, 12), (0, 12), (0, 0)]
    for first, last in pairwise(corners):
        space.add_line(first, last)
    space.add_text("not a part of it")


def arcs(space: Any) -> None:
    space.add_arc((0, 0), 0.2, 90, 270)
    space.add_line((0, -0.2), (0.3, -0.2))
    space.add_arc((0.3, 0), 0.2, 270, 90)
    space.add_line((0.3, 0.2), (0, 0.2))


def block(space: Any) -> None:
    part = space.doc.blocks.new("part")
    part.add_lwpolyline([(0, 0), (400, 0), (400, 150), (0, 150)], close=True)
    space.add_blockref("part", (50, 20), dxfattribs={"yscale": 2.0})
    space.add_linear_dim(base=(0, -30), p1=(0, 0), p2=(200, 0)).render()  # no part of it


@pytest.mark.parametrize(
    ("units", "draw", "expected"),
    [
        (4, lines, (16e-3, 12e-3, 192e-6)),
        (0, lines, (16.0, 12.0, 192.0)),
        (6, arcs, (0.7, 0.4, math.pi * 0.04 + 0.12)),
        (4, block, (0.4, 0.3, 0.12)),
    ],
)
def test_dxf_lines_are_joined_and_blocks_expanded(
    tmp_path: Path, units: int, draw: Callable[[Any], object], expected: tuple[float, ...]
) -> None:
    drawing = import_module("ezdxf").new(units=units, setup=draw is block)
    draw(drawing.modelspace())
    drawing.saveas(tmp_path / "a.dxf")
    result = size_and_area(read_drawing(tmp_path / "a.dxf").outline)
    assert result == pytest.approx(expected, rel=2e-3 if draw is arcs else 1e-4)


def test_dxf_with_decimal_commas_or_unknown_units(tmp_path: Path) -> None:
    path, drawing = tmp_path / "a.dxf", import_module("ezdxf").new(units=4)
    drawing.modelspace().add_lwpolyline([(0.25, 0.5), (300.75, 0.5), (300.75, 200.75)], close=True)
    drawing.saveas(path)
    plain = path.read_text()
    for text in (plain, re.sub(r"(?m)^(-?\d+)\.(\d+)$", r"\1,\2", plain)):
        path.write_text(text, encoding="utf-8-sig")
        assert size_and_area(read_drawing(path).outline)[:2] == pytest.approx((0.3005, 0.20025))
    path.write_text(re.sub(r"(\$INSUNITS\s+70\s+)4", r"\g<1>77", plain))
    with pytest.raises(ho.InputError, match="INSUNITS = 77"):
        read_drawing(path)


PART = [(60, 90), (260, 90), (260, 190), (200, 210), (60, 190)]  # 200 x 120
HOLE = [(100, 120), (120, 120), (110, 150)]


def test_holes_are_ignored_and_noted_with_their_sizes(tmp_path: Path) -> None:
    path = tmp_path / "a.svg"
    shape = '<rect width="4" height="2.9"/><circle cx="1" cy="1" r="0.5"/>'
    shape += '<circle cx="3" cy="1" r="0.1"/>'
    path.write_text(SVG.format(size="", shape=shape))
    result = read_drawing(path)
    assert size_and_area(result.outline)[:2] == pytest.approx((4.0, 2.9))
    assert result.notes == (
        "holes within it are omitted: 1 x 1 m, 0.2 x 0.2 m; if it is a page or a frame around the "
        "part, hide it",
    )
    path.write_text(
        SVG.format(size="", shape='<circle cx="3" cy="1" r="0.4"/>' + SMALL.replace("4", "1"))
    )
    (note,) = read_drawing(path).notes
    assert note == "2 separate outlines, 1 x 3 m, 0.8 x 0.8 m: their convex hull is used"


INVISIBLE = [
    '<rect width="100%" height="100%" fill="white"/>',
    '<path d="M-9 -9h300v300h-300z" style="fill:#ffffff;stroke:none"/>',
    '<g opacity="0"><rect width="400" height="300"/></g>',
    '<rect visibility="hidden" width="400" height="300"/>',
    '<g display="none"><rect width="400" height="300"/></g>',
    '<rect width="400" height="300" fill="none" stroke="#fff0"/>',
    '<symbol id="a"><rect width="400" height="300"/></symbol>',
    '<marker id="a"><rect width="400" height="300"/></marker>',
]


@pytest.mark.parametrize("invisible", INVISIBLE)
def test_invisible_svg_shapes_are_ignored(invisible: str, tmp_path: Path) -> None:
    part = '<rect x="20" y="20" width="20 CM" height="120mm" fill="none" stroke="red"/>'
    for size in ('width="40 cm" height="30CM" ', 'width="400mm" height=" 300.0 Mm " '):
        path = tmp_path / "a.svg"
        path.write_text(SVG.format(size=size, shape=invisible + part), encoding="utf-8-sig")
        result = read_drawing(path)
        expected = np.array([0.2, 0.12]) * 3.7795275590551  # pixels in a view of millimetres
        assert size_and_area(result.outline)[:2] == pytest.approx(tuple(expected), rel=1e-4)
        assert len(result.notes) == ("fill" in invisible or "opacity" in invisible)


STATES = ["off", "freeze", "plot", "entity", "block", "frozen block", "block of another layer"]


@pytest.mark.parametrize("state", STATES)
def test_invisible_dxf_entities_are_ignored(state: str, tmp_path: Path) -> None:
    drawing = import_module("ezdxf").new(units=4)
    layer, space = drawing.layers.add("FRAME"), drawing.modelspace()
    space.add_lwpolyline(PART, close=True)
    frame = drawing.blocks.new("frame")
    outer = [(0, 0), (500, 0), (500, 300), (0, 300)]
    if "block" in state:
        own = "0" if state == "block" else "seen"  # layer 0 is that of the block
        frame.add_lwpolyline(outer, close=True, dxfattribs={"layer": own})
        space.add_blockref("frame", (0, 0), dxfattribs={"layer": "FRAME"})
    else:
        line = space.add_lwpolyline(outer, close=True, dxfattribs={"layer": "FRAME"})
    if state == "entity":
        line.dxf.invisible = 1
    elif state == "plot":
        layer.dxf.plot = 0
    else:
        (layer.freeze if state.startswith("fr") else layer.off)()
    drawing.saveas(tmp_path / "a.dxf")
    result = read_drawing(tmp_path / "a.dxf")
    if "another" in state:  # entities of a block on a hidden layer are visible, unless on layer 0
        assert size_and_area(result.outline)[:2] == pytest.approx((0.5, 0.3))
        return
    assert size_and_area(result.outline)[:2] == pytest.approx((0.2, 0.12))
    assert ("FRAME" in "".join(result.notes)) is (state != "entity")


def strokes(gap: float, seed: int, place: tuple[float, float]) -> list[Array]:
    """Return the sides of PART in random directions and order, ends displaced by up to gap / 2."""
    chance = np.random.default_rng(seed)
    ring = np.array(PART) / 1e3 + place
    sides = np.stack([ring, np.roll(ring, -1, axis=0)], axis=1)
    angles = chance.uniform(0.0, 2.0 * math.pi, sides.shape[:2])
    sides += 0.5 * gap * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    return [side[:: chance.choice([-1, 1])] for side in chance.permutation(sides)]


@pytest.mark.parametrize("gap", [0.0, 1e-15, 4e-7, 1e-6, 9e-5])
def test_nearby_ends_are_joined_at_any_position(gap: float) -> None:
    shapely = import_module("shapely")
    for seed in range(20):
        place = (0.5e-6 * seed, 1.0 - 1e-7 * seed)
        lines = shapely.MultiLineString(strokes(gap, seed, place))
        width, depth = np.ptp(drawing_of_geometry(lines).outline, axis=0)
        assert (width, depth) == pytest.approx((0.2, 0.12), abs=2.0 * gap + 1e-5)
    ring = np.array([*PART, PART[0]]) / 1e3
    ring[-1] += [0.6 * gap, 0.8 * gap]  # one line that ends near its start
    assert np.ptp(drawing_of_geometry(shapely.LineString(ring)).outline, axis=0) == pytest.approx(
        (0.2, 0.12), abs=2.0 * gap + 1e-5
    )


def test_relevant_gaps_are_reported_with_place_and_size() -> None:
    shapely, ring = import_module("shapely"), np.array([*PART, PART[0]]) / 1e3
    part, hole = shapely.LineString(ring[:-1]), shapely.Polygon(np.array(HOLE) / 1e3)
    closing = shapely.LineString([ring[-2], ring[-1] + [0.0, 0.0007]])  # 0.7 mm short of its end
    stray = shapely.LineString([(0.057, 0.09), (0.02, 0.09)])  # nearer to the gap than to its ends
    for lines in ([part, closing], [part, closing, hole], [part, closing, stray]):
        words = r"gaps of 0\.7 mm at \[0\.06, 0\.0903\] m$"
        with pytest.raises(ho.InputError, match=words):
            drawing_of_geometry(shapely.GeometryCollection(lines))
    whole = shapely.LineString(ring)
    inside = shapely.LineString([(0.1, 0.1), (0.2, 0.1), (0.2, 0.15), (0.1, 0.15), (0.1, 0.1007)])
    axes = [shapely.LineString([(x, 0.15), (x + 0.03, 0.15)]) for x in np.arange(0.0, 0.4, 0.033)]
    for lines in ([whole, inside], [whole, *axes], [part, shapely.LineString(ring[-2:]), *axes]):
        result = drawing_of_geometry(shapely.GeometryCollection(lines))
        assert np.ptp(result.outline, axis=0) == pytest.approx((0.2, 0.12), abs=1e-4)


def test_holes_of_geometries_are_ignored() -> None:
    shapely = import_module("shapely")
    holed = shapely.box(0, 0, 0.4, 0.3).difference(shapely.box(0.1, 0.1, 0.2, 0.2))
    assert size_and_area(drawing_of_geometry(holed).outline) == pytest.approx((0.4, 0.3, 0.12))


DEGREES = [[4.3711, 51.9991], [4.3713, 51.9991], [4.3713, 51.9992], [4.3711, 51.9991]]
ROOF = {"type": "Polygon", "coordinates": [DEGREES]}

INVALID = {
    FileError: [
        ("a.svg", "<svg", "cannot be read"),
        ("a.json", "[[0, 0, 0], [1, 0, 0], [1, 1, 0]]", "a list of points"),
        ("a.csv", "0, 0\n1, 0\nx, 1\n", "line 3: column 1 is 'x', not a number"),
        ("a.csv", "O.1,0.2\n0.4,0\n0.4,0.3\n", "line 1: column 1 is 'O.1', not a number"),
        ("a.csv", "0, 0, 0\n1, 0, 0\n1, 1, 0\n", "one on each line"),
        ("a.csv", "0,4,0,3\n0,1,0,2\n", "not 4 numbers; decimal commas need semicolons"),
        ("a.geojson", '{"type": "Polygon", "coordinates": 3}', "neither GeoJSON nor"),
    ],
    ho.InputError: [
        ("a.csv", "0, nan\n1, 0\n1, 1", "finite"),
        ("a.csv", "0, 0\n1, 0", "closed outline"),
        ("a.csv", "0, 0\n1, 1\n1, 0\n0, 1", "cross itself"),
        ("a.csv", "0, 0\n400, 0\n400, 300\n", "not 400 x 300 m; state the drawing's unit"),
        ("a.csv", "4.3711, 52\n4.3712, 52\n4.3712, 52.0001\n", "at least 0.01 m .* degrees"),
        ("a.geojson", json.dumps(ROOF), "at least 0.01 m .* 0.0002 x 0.0001 m; .* degrees"),
        (
            "a.geojson",
            '{"type":"FeatureCollection","features":[]}',
            "no lines: trace pictures and te",
        ),
        ("a.geojson", '{"type": "Point", "coordinates": [1, 2]}', "no lines"),
        ("a.svg", SVG.format(size="", shape='<image width="4"/><text>a</text>'), "no lines"),
        ("a.svg", SVG.format(size="", shape="<text>a</text>" + INVISIBLE[3]), "no lines"),
        ("a.svg", SVG.format(size='width="4cm" ', shape=RECTANGLE), "both"),
        *(
            (
                "a.svg",
                SVG.format(size=f'width="{x}" height="3cm" ', shape=RECTANGLE),
                f"width='{x}'",
            )
            for x in ("0.4m", "400,5mm", "10em", "1 ft", "40 q", "cm")
        ),
        ("a.svg", SVG.format(size="", shape='<rect width="4 m" height="3"/>'), "width='4 m'"),
        ("a.step", "", "a drawing"),
    ],
}


@pytest.mark.parametrize(("kind", "files"), INVALID.items())
def test_invalid_outlines_are_refused(
    tmp_path: Path, kind: type[ho.HitchoptError], files: list[tuple[str, str, str]]
) -> None:
    for name, text, words in files:
        (tmp_path / name).write_text(text)
        with pytest.raises(kind, match=words):
            read_drawing(tmp_path / name)
