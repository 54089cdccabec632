"""Polygons around an object, and the legs of a hitch below its rim, against other computations."""

from __future__ import annotations

import math

import numpy as np
import pytest

import hitchopt as ho
from hitchopt.hitch.hitch import cable_slack
from hitchopt.objects import SolidObject
from hitchopt.planners.carrying.rest import HeldHitch, HoldPolygons
from hitchopt.values import Array

GAP = 0.08
BOX = ho.Section(outline=np.array([[-0.2, -0.15], [-0.2, 0.15], [0.2, 0.15], [0.2, -0.15]]))
DRUM = ho.Section(radius=0.2)
CENTRE = np.zeros(2)


def ring(n: int, x: float, y: float, turn: float = 0.0) -> Array:
    """Return a clockwise polygon (n, 2) [m] on an ellipse."""
    angles = turn - 2.0 * np.pi * np.arange(n) / n
    return np.column_stack([x * np.cos(angles), y * np.sin(angles)])


def edge_lengths(polygon: Array) -> Array:
    lengths: Array = np.linalg.norm(np.roll(polygon, -1, axis=0) - polygon, axis=1)
    return lengths


@pytest.mark.parametrize(
    ("section", "closed"),
    [(BOX, ring(4, 0.356, 0.171)), (DRUM, ring(3, 0.22, 0.22)), (BOX, ring(3, 0.4, 0.45, 0.3))],
)
def test_edges_around_keep_off_and_are_short(section: ho.Section, closed: Array) -> None:
    sections = (section,)
    short = HoldPolygons.with_short_edges(closed, CENTRE, sections, GAP).around
    alike = HoldPolygons.about(closed, CENTRE, sections, GAP).around
    for around in (short, alike):
        gaps = section.segment_distance(around, np.roll(around, -1, axis=0))
        assert np.min(gaps) == pytest.approx(GAP, abs=1e-9)
    assert np.max(edge_lengths(short)) <= np.max(edge_lengths(alike)) * (1.0 + 1e-12)


@pytest.mark.slow
def test_a_flat_grip_has_a_nearly_square_hitch_around_it() -> None:
    """The shortest rhombus around a box, by a search over its half diagonals a and b.

    Its edges are ``GAP`` from the corners where ``a b - x b - y a = GAP hypot(a, b)``.
    """
    closed = ring(4, 0.356, 0.171)
    found = HoldPolygons.with_short_edges(closed, CENTRE, (BOX,), GAP).around
    a = np.linspace(0.3, 0.9, 6001)
    b = np.linspace(0.2, 0.9, 7001)[:, None]
    off = (a * b - 0.2 * b - 0.15 * a) / np.hypot(a, b)
    shortest = float(np.min(np.hypot(a, b), where=off >= GAP, initial=math.inf))
    assert np.max(edge_lengths(found)) == pytest.approx(shortest, rel=2e-3)
    assert np.max(edge_lengths(HoldPolygons.about(closed, CENTRE, (BOX,), GAP).around)) > 0.77


def below_a_rim(roll: float) -> tuple[HeldHitch, ho.Hitch]:
    """Return a hitch of six below a rim, and the one that it closes from."""
    team = ho.Team(robots=6, cable_length=1.4, tension=1.0, cable_density=0.01)
    polygon = ring(6, 0.26, 0.26)
    legs = 0.4 * cable_slack(team, ho.ConvexPolygon(polygon))
    hitch = ho.Hitch(team, polygon, 0.25, legs, roll)
    rim = ho.Rim(ho.Section(radius=0.3), 0.25)
    tray = SolidObject(ho.Section(radius=0.1), 0.0, 0.3, 0.2, rim=rim)
    places = np.column_stack([polygon, np.full(6, 0.25)])
    return HeldHitch(team, tray, places, hitch.fractions, hitch.roll), hitch


@pytest.mark.parametrize("roll", [0.0, 0.15, -0.2])
def test_legs_below_a_rim_are_those_that_they_were_before(roll: float) -> None:
    held, hitch = below_a_rim(roll)
    drones, _ = held.drones(held.team.tension, np.zeros((6, 3)))
    np.testing.assert_allclose(drones, hitch.drones, atol=1e-9)


@pytest.mark.parametrize("taken", [None, 0.03, 0.1])
@pytest.mark.parametrize("roll", [0.0, 0.15, -0.2])
def test_rolled_legs_carry_what_lies_on_clasps(roll: float, taken: float | None) -> None:
    """Legs and edges balance the weight at every clasp; directions from the drones alone.

    A rim takes a share of what edges pull with, and nothing of what legs do.
    """
    held, _ = below_a_rim(roll)
    light = ho.Team(robots=6, cable_length=1.4, tension=1.0)
    held = HeldHitch(light, held.body, held.places, held.fractions, held.roll)
    weight = np.array([0.0, 0.0, -0.2 * 9.81 / 6.0])
    share = None if taken is None else np.array(taken)
    drones, _ = held.drones(light.tension, np.tile(weight, (6, 1)), share)
    q = drones[0::2] - held.places
    r = np.roll(drones[1::2], 1, axis=0) - held.places
    onward = np.roll(held.places, -1, axis=0) - held.places
    pulls = [each / np.linalg.norm(each, axis=1, keepdims=True) for each in (q, r, onward)]
    pulls[2] *= 1.0 - (taken or 0.0)
    force = pulls[0] + pulls[1] + pulls[2] - np.roll(pulls[2], 1, axis=0)
    np.testing.assert_allclose(force + weight, 0.0, atol=1e-9)
