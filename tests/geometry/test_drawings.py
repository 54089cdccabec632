"""Outlines from drawings: units, curves, lines that meet, and what is refused."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hitchopt as ho
from hitchopt.geometry.drawings import FLATNESS, outline_of_geometry, read_outline
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
]
"""Files with a box of 0.4 m by 0.3 m, times a factor."""


@pytest.mark.parametrize(("name", "text", "size"), BOXES)
def test_boxes_have_their_size(tmp_path: Path, name: str, text: str, size: float) -> None:
    """SVG states its unit or is in metres; tables are as other programs write them."""
    (tmp_path / name).write_text(text, encoding="utf-8")
    found = size_and_area(read_outline(tmp_path / name))
    assert found == pytest.approx((0.4 * size, 0.3 * size, 0.12 * size**2), rel=1e-4)


def test_svg_is_not_mirrored_and_curves_are_flat_to_a_tenth_of_a_millimetre(tmp_path: Path) -> None:
    drawing = tmp_path / "wedge.svg"
    drawing.write_text(SVG.format(size="", shape='<polygon points="0,0 4,0 0,2"/>'))
    assert sorted(read_outline(drawing).tolist()) == [[0.0, -2.0], [0.0, 0.0], [4.0, 0.0]]
    drawing.write_text(SVG.format(size="", shape='<circle cx="1" cy="2" r="0.2"/>'))
    outline = read_outline(drawing) - [1.0, -2.0]
    middles = 0.5 * (outline + np.roll(outline, -1, axis=0))
    away = np.hypot(*np.concatenate([outline, middles]).T)
    assert np.max(np.abs(away - 0.2)) < 2.0 * FLATNESS


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
def test_dxf_lines_are_joined_and_blocks_taken_apart(
    tmp_path: Path, units: int, draw: Callable[[Any], object], expected: tuple[float, ...]
) -> None:
    drawing = import_module("ezdxf").new(units=units, setup=draw is block)
    draw(drawing.modelspace())
    drawing.saveas(tmp_path / "a.dxf")
    found = size_and_area(read_outline(tmp_path / "a.dxf"))
    assert found == pytest.approx(expected, rel=2e-3 if draw is arcs else 1e-4)


def test_holes_of_geometries_are_left_out() -> None:
    shapely = import_module("shapely")
    holed = shapely.box(0, 0, 0.4, 0.3).difference(shapely.box(0.1, 0.1, 0.2, 0.2))
    assert size_and_area(outline_of_geometry(holed)) == pytest.approx((0.4, 0.3, 0.12))


WRONG = {
    ho.FileError: [
        ("a.svg", "<svg", "cannot be read"),
        ("a.json", "[[0, 0, 0], [1, 0, 0], [1, 1, 0]]", "a list of points"),
        ("a.csv", "0, 0\n1, 0\nx, 1\n", "line 3 is not a point"),
        ("a.csv", "O.1,0.2\n0.4,0\n0.4,0.3\n", "line 1 is not a point"),
        ("a.csv", "0, 0, 0\n1, 0, 0\n1, 1, 0\n", "one on each line"),
        ("a.geojson", '{"type": "Polygon", "coordinates": 3}', "neither GeoJSON nor"),
    ],
    ho.InputError: [
        ("a.csv", "0, nan\n1, 0\n1, 1", "finite"),
        ("a.csv", "0, 0\n1, 0", "closed outline"),
        ("a.csv", "0, 0\n1, 1\n1, 0\n0, 1", "cross itself"),
        ("a.csv", "0, 0\n400, 0\n400, 300\n", "400 m; state the drawing's unit"),
        ("a.svg", SVG.format(size='width="4cm" ', shape=RECTANGLE), "both"),
        ("a.step", "", "a drawing"),
    ],
}


@pytest.mark.parametrize(("kind", "files"), WRONG.items())
def test_what_is_no_outline_is_refused(
    tmp_path: Path, kind: type[ho.HitchoptError], files: list[tuple[str, str, str]]
) -> None:
    for name, text, words in files:
        (tmp_path / name).write_text(text)
        with pytest.raises(kind, match=words):
            read_outline(tmp_path / name)
