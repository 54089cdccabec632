"""Outlines from drawings: units, curves, joined lines, and invalid files."""

from __future__ import annotations

import json
import math
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

import hitchopt as ho
from hitchopt.errors import FileError
from hitchopt.geometry.drawings import drawing_of_geometry, read_drawing
from hitchopt.values import Array

RING = [[0.0, 0.0], [0.4, 0.0], [0.4, 0.3], [0.0, 0.3], [0.0, 0.0]]


def size_and_area(outline: Array) -> tuple[float, float, float]:
    section = ho.Section(outline)
    width, depth = np.ptp(section.core, axis=0)
    return float(width), float(depth), section.area


POLYGON = {"type": "Polygon", "coordinates": [RING]}
FEATURE = {"type": "Feature", "properties": {}, "geometry": POLYGON}

BOXES: list[tuple[str, str, float]] = [
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
    """Tables have the formats of other programs."""
    (tmp_path / name).write_text(text, encoding="utf-8")
    result = size_and_area(read_drawing(tmp_path / name).outline)
    assert result == pytest.approx((0.4 * size, 0.3 * size, 0.12 * size**2), rel=1e-4)


PART = [(60, 90), (260, 90), (260, 190), (200, 210), (60, 190)]  # 200 x 120
HOLE = [(100, 120), (120, 120), (110, 150)]


def test_holes_are_ignored_and_noted_with_their_sizes() -> None:
    shapely = import_module("shapely")
    holes = [shapely.box(x - r, 1 - r, x + r, 1 + r) for x, r in ((1.0, 0.5), (3.0, 0.1))]
    rings = [each.exterior for each in (shapely.box(0, 0, 4, 2.9), *holes)]
    result = drawing_of_geometry(shapely.MultiLineString(rings))
    assert size_and_area(result.outline)[:2] == pytest.approx((4.0, 2.9))
    assert result.notes == (
        "holes within it are omitted: 1 x 1 m, 0.2 x 0.2 m; if it is a page or a frame around the "
        "part, hide it",
    )
    boxes = shapely.MultiPolygon([shapely.box(0, 0, 1, 3), shapely.box(2.6, 0.6, 3.4, 1.4)])
    (note,) = drawing_of_geometry(boxes).notes
    assert note == "2 separate outlines, 0.8 x 0.8 m, 1 x 3 m: their convex hull is used"


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
        ("a.csv", "0, 0\n400, 0\n400, 300\n", "not 400 x 300 m; write it in metres"),
        ("a.csv", "4.3711, 52\n4.3712, 52\n4.3712, 52.0001\n", "at least 0.01 m .* degrees"),
        ("a.geojson", json.dumps(ROOF), "at least 0.01 m .* 0.0002 x 0.0001 m; .* degrees"),
        ("a.geojson", '{"type":"FeatureCollection","features":[]}', "no lines"),
        ("a.svg", "<svg/>", "`.svg` is gone; save the outline as GeoJSON"),
        ("a.DXF", "", "`.dxf` is gone; save the outline as GeoJSON"),
        ("a.geojson", '{"type": "Point", "coordinates": [1, 2]}', "no lines"),
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
