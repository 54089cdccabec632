"""Edges that are drawn around an object."""

from __future__ import annotations

import numpy as np

from hitchopt.holding.wraps import wraps_around
from hitchopt.objects import Section
from hitchopt.view.wrapped_edges import wrapped_lengths, wrapped_points


def test_arcs_are_on_the_circle_and_points_evenly_spaced() -> None:
    section = Section(radius=0.2)
    angles = 0.3 - 2.0 * np.pi * np.arange(3) / 3
    flat = 0.24 * np.column_stack([np.cos(angles), np.sin(angles)])
    wraps = wraps_around(section, flat)
    first = np.column_stack([flat, np.zeros(3)])
    contacts = np.concatenate([wraps.contacts, np.zeros((3, 2, 1))], axis=-1)
    last = np.roll(first, -1, axis=0)
    np.testing.assert_allclose(wrapped_lengths(first, last, contacts), wraps.lengths, atol=1e-12)
    shares = np.tile(np.linspace(0.0, 1.0, 2001), (3, 1))
    points = wrapped_points(first, last, contacts, shares)
    np.testing.assert_allclose(points[:, [0, -1]], np.stack([first, last], axis=1), atol=1e-12)
    steps = np.linalg.norm(np.diff(points, axis=1), axis=-1)
    np.testing.assert_allclose(2000 * steps / wraps.lengths[:, None], 1.0, rtol=1e-3)
    away = np.linalg.norm(points, axis=-1)
    assert np.min(away) > 0.2 - 1e-12
    share = wraps.arcs / wraps.lengths
    np.testing.assert_allclose(np.mean(away < 0.2 + 1e-9, axis=1), share, atol=2e-3)


def test_straight_edges_stay_straight() -> None:
    first, last = np.zeros((1, 3)), np.array([[1.0, 0.5, 0.0]])
    middle = 0.5 * (first + last)
    contacts = np.stack([middle, middle], axis=1)
    shares = np.linspace(0.0, 1.0, 5)[None]
    points = wrapped_points(first, last, contacts, shares)
    np.testing.assert_allclose(points[0], shares.T * last, atol=1e-12)
