"""What pages show: where a drone is seen, and what a change alters."""

from __future__ import annotations

import io
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from matplotlib.image import imread

import hitchopt as ho
from hitchopt.values import Array

SETTLE = 1500
"""Least time for which a page draws what it was sent [ms]; software draws slowly."""

SHARP = "/?fixedDpr=1"
"""End of a live view's address: slow graphics do not lower its resolution, which alters all."""

NEAR = 5.0
"""Largest distance of a drawn drone to its place in the plan [pixels]."""


@cache
def tied_plan() -> ho.Plan:
    """Return the plan that the pages show: a hitch tied off the origin."""
    team = ho.Team(robots=3, cable_length=[2.4, 2.5, 2.4])
    q = np.array([[0.4, -2.2, 1.0], [0.4, -1.0, 1.0], [0.4, 0.2, 1.0]])
    triangle = [[1.1, -0.3], [1.6, -1.2], [0.6, -1.3]]
    return ho.form(team, q, q + [1.2, 0.0, 0.0], triangle, altitude=1.5)


def projected(
    point: Array, eye: Array, target: Array, view: float, size: tuple[float, float]
) -> Array:
    """Return where a point (3,) is seen (2,) [pixels], from the upper left corner.

    Parameters
    ----------
    point: (3,) [m]
    eye, target: places of the camera and of what it looks at (3,) [m]; z is up.
    view: vertical field of view [rad].
    size: width and height of the picture [pixels].
    """
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    away = point - eye
    scale = 0.5 * size[1] / np.tan(0.5 * view) / (away @ forward)
    return np.array([0.5 * size[0] + scale * (away @ right), 0.5 * size[1] - scale * (away @ up)])


def changed_place(picture: Callable[[], bytes], change: Callable[[], None]) -> Array:
    """Return the middle of what a change alters in a picture (2,) [pixels]."""
    before = _levels(picture())
    change()
    after = _levels(picture())
    rows, columns = np.nonzero(np.max(np.abs(after - before), axis=-1) > 0.1)
    assert len(rows) > 20, "nothing has changed"
    return np.array([np.mean(columns) + 0.5, np.mean(rows) + 0.5])


def drawn(page: Any) -> None:
    """Wait until a live view's scene is there, its camera too."""

    def coloured() -> bool:
        levels = _levels(page.screenshot(clip={"x": 0, "y": 200, "width": 800, "height": 600}))
        return float(np.mean(np.ptp(levels, axis=-1) > 0.2)) > 0.002

    waited(page, coloured)
    page.wait_for_timeout(SETTLE)
    settled(page)


def settled(page: Any) -> None:
    """Wait until a page has shown the same picture three times; busy machines draw late."""
    page.wait_for_timeout(SETTLE)
    last, same = b"", 0
    for _ in range(30):
        picture = page.screenshot()
        same = same + 1 if picture == last else 0
        if same == 2:
            return
        last = picture
        page.wait_for_timeout(300)


def waited(page: Any, holds: Callable[[], bool]) -> None:
    """Wait until a condition holds."""
    for _ in range(100):
        if holds():
            return
        page.wait_for_timeout(100)
    raise AssertionError("the page has not answered")


def vividness(png: bytes) -> float:
    """Return the sum of all pixels' distances from grey."""
    levels = _levels(png)
    return float(np.sum(np.max(levels, axis=-1) - np.min(levels, axis=-1)))


def _levels(png: bytes) -> Array:
    return np.asarray(imread(io.BytesIO(png), format="png")[..., :3], dtype=np.float64)
