"""Hanging cables: catenaries of given lengths between moving ends."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from .arithmetic import (
    FAR,
    TINY,
    TOLERANCE,
    UP,
    Array,
    Index,
    Line,
    concatenate,
    maximum,
    minimum,
    norm,
)
from .shapes import distance
from .spans import Spans

LINKS = 96  # number of links of a hanging cable
OWN_DISTANCES = 2.0  # distance along a cable from which it counts for its drone, over the smallest
OWN_LINK = 0.75  # place of the end of the last link that does not count, over that distance


def catenary_sigma(ratio: Array) -> Array:
    """Return σ of ``sinh σ / σ = ratio``, by bisection; nan for ratios up to 1."""
    low = np.zeros_like(ratio)
    high = 8.0 + 2.0 * np.log(np.maximum(ratio, 1.0))
    for _ in range(60):
        x = 0.5 * (low + high)
        below = np.sinh(x) < ratio * x
        low, high = np.where(below, x, low), np.where(below, high, x)
    return np.where(ratio > 1.0, low, np.nan)


def catenary(s: Spans, i: Index) -> tuple[Line, Line]:
    """Return vectors from drone i to its cable's other end, and σ.

    ``sinh σ / σ = √(L² - h²) / s`` with horizontal distance s and height h of the other end;
    ``σ' = σ² / (σ cosh σ - sinh σ)``.
    """
    chord = s.point(i + 1 - 2 * (i % 2)) - s.point(i)
    square = -(chord[2] * chord[2]) + s.plan.length[i // 2] ** 2
    root = square.map(np.sqrt, lambda x: 0.5 / np.sqrt(x))

    def slope(x: Array) -> Array:
        sigma = catenary_sigma(x)
        return sigma**2 / (sigma * np.cosh(sigma) - np.sinh(sigma))

    return chord, (root * chord[:2].norm().inverse()).map(catenary_sigma, slope)


def catenary_force(s: Spans, i: Index) -> Line:
    """Return the force of a cable of unit weight on drone i: ``(s / 2σ, ½ h coth σ - ½ L)``."""
    chord, sigma = catenary(s, i)
    coth = sigma.map(lambda x: 1.0 / np.tanh(x), lambda x: -1.0 / np.sinh(x) ** 2)
    return concatenate(chord[:2] * sigma.inverse(), chord[2] * coth - s.plan.length[i // 2]) * 0.5


def catenary_depth(L: Array, h: Array, sigma: Array, mu: Array) -> Array:
    """Return depths of cables below their chords at μ from -1 to 1."""
    arch = L * np.sinh(0.5 * (1.0 + mu) * sigma) * np.sinh(0.5 * (1.0 - mu) * sigma)
    return np.asarray((arch - 0.5 * h * np.sinh(mu * sigma)) / np.sinh(sigma) + 0.5 * h * mu)


def depth_rate(s: Spans, k: Index, span: Line, sigma: Line) -> Array:
    """Return bounds (m,) of the rates at which points of cables k move below their chords.

    Points are at fixed μ: depths change by at most ``(L + |h|) / 4`` by σ and ½ by h.
    """
    longest = s.plan.length[k, 0] + np.abs(span.v[:, 2]) + span.deviation
    return np.asarray(0.25 * longest * sigma.rate + 0.5 * span[2].rate)


class Links(NamedTuple):
    """A chain that replaces hanging cables: points at fractions of lengths and positions μ.

    ``chord`` has points of chords above, ``sag`` (m, 1) how far cables sag below links, and
    ``rate`` (m,) bounds rates of depths below chords, and of lengths up to points.
    """

    cable: list[Line]
    chord: list[Line]
    sag: Array
    shares: Array
    places: Array
    rate: Array


def catenary_links(s: Spans, k: Index, *distances: float) -> Links:
    """Return the links of cables, with points at distances along them from both ends as well.

    At μ from -1 to 1 a cable is ``L (cosh σ - cosh μσ) / 2 sinh σ + h (μ - sinh μσ / sinh σ) / 2``
    below its chord, and ``L (1 + sinh μσ / sinh σ) / 2 - h (cosh σ - cosh μσ) / 2 sinh σ`` long up
    to there, both with derivatives of at most ``(L + |h|) / 4`` by σ and ½ by h. A convex curve
    sags below a link by at most a quarter of its width times the change of slope.
    """
    span, sigma = catenary(s, 2 * k)
    L = s.plan.length[k, 0]
    h = span.v[:, 2]
    g = sigma.v[:, 0]
    tilt = np.arcsinh(h / np.sqrt(L**2 - h**2))
    ends = [np.minimum(x / L, 1.0) for x in distances]
    ends += [1.0 - x for x in ends]
    shares = np.linspace(0.0, 1.0, LINKS + 1)[:, None] + 0.0 * L
    shares = np.sort(np.concatenate([shares, *(x[None] for x in ends)]), axis=0)
    low = np.sinh(tilt - g)
    high = np.sinh(tilt + g)
    slopes = low + shares * (high - low)  # proportional to the length
    places = np.clip((np.arcsinh(slopes) - tilt) / g, -1.0, 1.0)
    rate = depth_rate(s, k, span, sigma)
    cable, chord = [], []
    for mu in places:
        depth = catenary_depth(L, h, g, mu)[:, None]
        chord.append(s.point(2 * k) + span * (0.5 * (1.0 + mu))[:, None])
        cable.append(chord[-1] - Line(depth, 0.0 * depth, rate, s.t) * UP)
    sag = np.max(np.diff(slopes, axis=0) * np.diff(places, axis=0), axis=0)
    sag = 0.125 * (sag * norm(span.v[:, :2]))[:, None]
    return Links(cable, chord, sag, shares, places, rate)


def own_cable_gap(s: Spans, i: Index, k: Index) -> Line:
    """Return distances of drones i from their hanging cables k, where these rise again.

    That is beyond OWN_DISTANCES of the minimum distance along the cable. Slopes are ``sinh(μσ +
    artanh(h / L))``. Links that lead down, or end nearer, throughout a span are ignored.
    """
    nearest = OWN_DISTANCES * s.plan.cable_limit[1]
    links = catenary_links(s, k, OWN_LINK * nearest)
    span, sigma = catenary(s, 2 * k)
    at_r = i % 2 == 1
    L = s.plan.length[k, 0]
    h = span[2]
    share = np.minimum((np.abs(h.v[:, 0]) + h.deviation) / L, 1.0)
    turn = np.arctanh(h.v[:, 0] / L), h.deviation / np.maximum(L * (1.0 - share**2), TINY)
    rates = (np.abs(links.places) * sigma.deviation + turn[1]) / s.t
    y = links.places * sigma.v[:, 0] + turn[0]
    along = links.shares * L
    reached = OWN_LINK * nearest * (1.0 + TOLERANCE)

    def line(x: Array, rate: Array) -> Line:
        return Line(x[:, None], s.zero.g, rate, s.t)

    values, counted = list[Array](), list[Line]()
    for j, link in enumerate(pairwise(links.cable)):  # positive where a link does not count
        descent = np.where(at_r, y[j], -y[j + 1]), np.where(at_r, rates[j], rates[j + 1])
        far_end = np.where(at_r, L - along[j], along[j + 1])
        ahead = np.where(far_end <= reached, nearest - far_end, -nearest)
        away = maximum(line(*descent), line(ahead, links.rate))
        absent = away.low > 0.0
        gap = distance([s.point(i)], link, s.plan.ratio)
        counted.append(gap.where(~absent) + np.where(absent, FAR, 0.0)[:, None])
        values.append(np.where(away.v > 0.0, FAR, gap.v))
    value = np.min(values, axis=0)
    gap = minimum(*counted)
    unsure = np.any(value > gap.v, axis=1)  # whether nearer links count
    gap = gap.where(~unsure) + line(value[:, 0], (value[:, 0] - gap.low) / s.t).where(unsure)
    return gap - links.sag - shift(s, k)


def shift(s: Spans, k: Index) -> Line:
    """Return how far points of hanging cables move by the tracking error r of ends, beyond r.

    They move by ``√(1 + ¼) r`` and by the effect of σ: ``(coth σ - 1/σ) σ' = (ln √(L² - h²) / s)'``
    s and h within 2 r. Slopes of depths over L are at most ¼, and ``(1/eσ + e^-σ) / 2`` for σ > 1.
    Errors of h are larger by the ratio, by which heights are divided; σ only moves points
    vertically.
    """
    L = s.plan.length[k, 0]
    r = 2.0 * s.plan.tracking
    ratio = s.plan.ratio
    up = r * ratio

    def bound(low: Array, high: Array, h: Array) -> Array:
        whole, flat = (np.sqrt(L**2 - x**2) for x in (h, h + up))
        g = catenary_sigma(flat / (high + r))
        change = np.log(low / (low - r) * whole / flat) / (1.0 / np.tanh(g) - 1.0 / g)
        wide = np.maximum(g, 1.0)
        slope = L * np.minimum(0.25, 0.5 * (np.exp(-1.0) / wide + np.exp(-wide)))
        return np.asarray((slope + 0.25 * (h + up)) * change / ratio + 0.06 * r)

    if not r:
        return s.zero
    span = s.q_to_r(k)
    horizontal = span[:2].norm()
    h = np.abs(span.v[:, 2])
    x = bound(horizontal.v[:, 0], horizontal.v[:, 0], h)
    q = (bound(horizontal.low, horizontal.high, h + span[2].deviation) - x) / s.t
    return Line(x[:, None], 0.0 * x[:, None], q, s.t)


def lowest_height(s: Spans, k: Index) -> Line:
    """Return heights of the lowest points of hanging cables.

    Slopes are ``sinh(μσ + artanh(h / L))``: at the middle of a span the lowest point is where they
    vanish, or an end. No point at a fixed μ moves faster than the ends of its chord and its depth.
    """
    q, r = s.ends(k)
    span, sigma = catenary(s, 2 * k)
    L = s.plan.length[k, 0]
    h = span.v[:, 2]
    g = sigma.v[:, 0]
    lowest_place = np.clip(-np.arctanh(h / L) / g, -1.0, 1.0)
    chord_height = q.v[:, 2] + 0.5 * (1.0 + lowest_place) * h
    height = chord_height - catenary_depth(L, h, g, lowest_place)
    rate = np.maximum(q[2].rate, r[2].rate) + depth_rate(s, k, span, sigma)
    return Line(height[:, None], s.zero.g, rate, s.t)


def above_floor(s: Spans, k: Index) -> Line:
    """Return heights of hanging cables over the floor; only errors are larger by the ratio."""
    p = s.plan
    more: float = (p.ratio - 1.0) * p.settings["separation"]["cable"]
    return (lowest_height(s, k) - p.floor + more) * (1.0 / p.ratio) - shift(s, k)
