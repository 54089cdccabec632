"""Taut parts of cables over enclosed values: ``hitchopt.hitch.taut`` with bounds of all errors."""

from __future__ import annotations

from typing import Any

import numpy as np

from hitchopt.hitch.taut import LARGEST_SMALL, Sag, TautPart, closed_sag, series_sag, taut_part
from hitchopt.trajectory.enclosed import Enclosed
from hitchopt.trajectory.jets import Jet
from hitchopt.values import Array

ORDER = 4  # Degree of factors: sags hardly change on spans that matter

CURVATURE = 2.0
"""Bound of all second derivatives of S and B by ``(w D / 2m)²`` and ``(w h / 2m)²``, times ``(1 -
u)⁶``, u the sum of both."""

LARGEST = 0.4
"""Largest u, up to which the curvature is bounded: a part sags by a fifth of its length."""


def sagging_part(chord: Any, ratio: Any) -> TautPart:
    """Return ``taut_part`` of an enclosed chord, or of its jet."""
    if isinstance(chord, Jet):
        return taut_part(chord, _low(ratio), _low)
    return taut_part(chord, _low(ratio), _low, _enclosed_sag)


def _low(factor: Any) -> Any:
    """Return a factor in a low degree."""
    return factor.reduced(ORDER)


def _enclosed_sag(of_level: Enclosed, of_rise: Enclosed) -> Sag:
    """Return ``series_sag`` enclosed values: the tangents at mid span, within their curvature."""
    middle = of_level.middle[..., 0], of_rise.middle[..., 0]
    is_taut = sum(middle) < LARGEST
    level, rise = (np.where(is_taut, each, 0.0) for each in middle)
    is_small = float(np.max(level + rise, initial=0.0)) < LARGEST_SMALL
    sag = (series_sag if is_small else closed_sag)(level, rise)
    by_rise = 1.0 / (1.0 - level * sag.stretch_slope)  # derivatives of x
    by_level = sag.stretch * by_rise
    of_level, of_rise = of_level - level[..., None], of_rise - rise[..., None]
    change = of_level.size + of_level.r + of_rise.size + of_rise.r
    largest = level + rise + change
    is_valid = is_taut & (largest < LARGEST)
    curvature = CURVATURE / (1.0 - np.where(is_valid, largest, 0.0)) ** 6
    error = np.where(is_valid, 0.5 * curvature * change * change, np.inf)

    def tangent(value: Array, slope: Array) -> Enclosed:
        along: Enclosed = of_level * (slope * by_level)[..., None]
        along = along + of_rise * (slope * by_rise)[..., None]
        return (along + value[..., None]).widened(error)

    return Sag(
        x=tangent(sag.x, np.ones_like(level)),
        stretch=tangent(sag.stretch, sag.stretch_slope),
        bulge=tangent(sag.bulge, sag.bulge_slope),
    )
