"""Vertices of a hitch from markers on its edges: crossings of local lines, seen from above.

A point near an edge belongs to it, whatever its label. In windows of time the points of an edge
give a line, aside and in height: offset, slope and rate by least squares, besides the sag of a
cable under its tension. Round by round gates and windows shrink; within a gate, points count the
less the farther they are from the last round's line (Tukey's biweight). A vertex is where the lines
of neighbouring edges cross seen from above, at their mean height. Standard errors follow from how
markers, not samples, scatter about lines: a marker beside its cable is so in all samples.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from hitchopt.flights.flight import Markers
from hitchopt.flights.recordings import planned
from hitchopt.geometry.vectors import length, unit
from hitchopt.hitch.team import GRAVITY, Layout
from hitchopt.simulation.task import Task
from hitchopt.values import Array, Indices

RATE = 20.0  # Of the times of vertices [Hz]
BODY = 0.09  # Distance from a drone within which markers are its own [m]
WINDOW = 0.1  # Default time over which places are averaged [s]
# Distance from its edge within which a point counts [m], and window [s], None for the default one,
# of every round. Windows begin one after the other OVERLAP times within each
ROUNDS = ((0.30, 1.0), (0.12, 0.6), (0.05, 0.3), (0.03, None), (0.02, None))
OVERLAP = 5
RIDGE = np.array([0.0, 1e-6, 1e-6])  # Added to mean squares of places [m²] and times [s²]
LEAST_SPREAD = 1e-3  # Least sum of squares of the places of an edge's markers [m²]
SPACING = 0.03  # Distance along an edge from which on points are of different markers [m]
BENT = 1e-3  # Scatter about lines of ropes that clasps bend, besides that of markers [m]
COUNTED = 0.25  # Weight from which on a point is of a marker
SMOOTH = 1.0  # Time over which the displacement of all drones is averaged [s]
LARGEST = 0.05  # Largest standard error of a vertex [m]
SINE = 0.05  # Least sine of the angle at which edges cross
# Distance of a vertex' offset from the median of so much time on either side [s], over the scatter,
# from which on it is left out, and the least scatter [m]
OUTLYING, AROUND, LEAST_SCATTER = 6.0, 0.5, 2e-3
# Density of a plan below which it knows no weight, and the largest that is fitted [kg/m]
WEIGHTLESS, DENSEST = 5e-4, 0.1
# Distance from the crossing of two cables to where they touch, over their diameter: a + b tan(φ/2)
# of the turn φ; from simulated flights with ropes of 12 mm
INWARD = (0.8, 0.75)


@dataclass(frozen=True, eq=False)
class Measured:
    """Measured vertices in the plan's frame.

    Attributes
    ----------
    crossings: (times, points, 3) [m]; nan if not measured, and at the ends of a chain.
    standard_errors: (times, points) [m]; nan likewise.
    density: of every cable (n,) [kg/m]: as stated, or as fitted.
    markers: markers of every edge within a window, the mean over times (n,).
    """

    crossings: Array
    standard_errors: Array
    density: Array
    markers: Array


@dataclass(frozen=True, eq=False)
class _Edges:
    """Expected edges at some times: frames in which lines along them are described."""

    origin: Array  # (t, n, 3) [m]
    along: Array  # (t, n, 2), level unit vectors
    span: Array  # (t, n) [m], level
    slope: Array  # (t, n)
    curvature: Array  # (t, n) [m²/kg]: second derivative of heights over the density

    @classmethod
    def of(cls, task: Task, t: Array, moved: Array) -> _Edges:
        """Return the edges of a plan at times (t,), displaced by (t, 3) [m]."""
        layout = task.team.layout
        points = planned(task, t, task.vertices) + moved[:, None]
        edges = layout.edges(points)
        span = np.maximum(length(edges[..., :2]), 1e-9)
        tensions = np.maximum(planned(task, t, task.tensions), 0.1 * task.team.tension)
        along, slope = edges[..., :2] / span[..., None], edges[..., 2] / span
        return cls(points[:, layout.starts], along, span, slope, GRAVITY / tensions)

    def seen(self, time: Indices, x: Array) -> tuple[Array, Array]:
        """Return places along (k, n) [m], and aside, above and sag (k, n, 3) of points (k, 3)."""
        off, u = x[:, None] - self.origin[time], self.along[time]
        s = np.sum(off[..., :2] * u, axis=-1)
        aside = off[..., 1] * u[..., 0] - off[..., 0] * u[..., 1]
        above = off[..., 2] - self.slope[time] * s
        return s, np.stack([aside, above, self.sag(s, time)], axis=-1)

    def sag(self, s: Array, time: Indices | slice = slice(None)) -> Array:
        """Return heights over the density at places along (…, n) [m], zero at the ends."""
        return np.asarray(0.5 * self.curvature[time] * s * (s - self.span[time]))


class _Points(NamedTuple):
    """Points by ascending edges and times."""

    edge: Indices  # (k,)
    time: Array  # (k,) [s]
    s: Array  # (k,) [m], along the edge
    values: Array  # (k, 3): aside, above and sag
    weight: Array  # (k,)


@dataclass(frozen=True, eq=False)
class _Lines:
    """Local lines of all edges at some times; nan with fewer than two markers."""

    fit: Array  # (t, n, 2, 2): aside and above; offset at the expected start, and slope
    density: Array  # (n,) [kg/m], of the sag besides
    markers: Array  # (t, n, 3): number, mean place [m], and sum of squares of places [m²]
    scatter: float  # [m], of markers about lines


def line_variances(markers: Array, s: Array) -> Array:
    """Return variances of lines at places along (…) [m] over that of markers about them.

    ``markers`` has their number, mean place [m] and sum of squares of places [m²] (…, 3).
    """
    count, mean, squares = np.moveaxis(markers, -1, 0)
    return np.asarray(1.0 / count + (s - mean) ** 2 / squares)


def crossing_errors(variances: Array, sine: Array) -> Array:
    """Return standard errors (…) [m] of crossings of two lines at an angle.

    ``variances`` is the sum of both lines' variances there (…) [m²], aside and in height.
    """
    return np.asarray(np.sqrt(variances * (1.0 / sine**2 + 0.25)))


def measured_vertices(
    task: Task,
    t: Array,
    cloud: Markers,
    drones: Array,
    *,
    density: float | None = None,
    window: float = WINDOW,
) -> Measured:
    """Return the vertices at times at which the plan has its hitch.

    Parameters
    ----------
    task: the plan.
    t: (times,) [s], ascending.
    cloud: points in the plan's time and frame, at times at which the plan has its hitch; those of
        the drones' own markers may be among them.
    drones: places of the drones at the cloud's times (frames, 2n, 3) [m].
    density: of the cables [kg/m]; None: the plan's, or fitted if the plan knows no weight.
    window: time over which places are averaged [s].
    """
    planned_density = task.team.cable_density
    known = planned_density if planned_density >= WEIGHTLESS else None
    known = known if density is None else density
    moved = np.median(drones - planned(task, cloud.t, task.setpoints.positions), axis=1)
    frames = max(1, round(SMOOTH * len(cloud.t) / max(np.ptp(cloud.t), SMOOTH)))
    moved = uniform_filter1d(moved, frames, axis=0, mode="nearest")
    nearest = np.min(length(cloud.positions[:, None] - drones[cloud.frame]), axis=1)
    frame, x = cloud.frame[nearest > BODY], cloud.positions[nearest > BODY]
    time, expected = cloud.t[frame], _Edges.of(task, cloud.t, moved)
    s, values = expected.seen(frame, x)
    ends: list[Array] = [np.zeros(s.shape), expected.span[frame]]
    off = values[..., :2] - (known or 0.0) * values[..., 2:] * [0.0, 1.0]
    for gate, width in ((gate, width or window) for gate, width in ROUNDS):
        distance = np.where((s > ends[0]) & (s < ends[1]), length(off), np.inf)
        edge, share = np.argmin(distance, axis=1), np.min(distance, axis=1) / gate
        near = np.flatnonzero(share < 1.0)
        near = near[np.argsort(edge[near], kind="stable")]
        given = s[near, edge[near]], values[near, edge[near]], (1.0 - share[near] ** 2) ** 2
        grid = np.arange(t[0], t[-1] + width, width / OVERLAP) if width > window else t
        points = _Points(edge[near], time[near], *given)
        lines = _fitted(points, grid, width, s.shape[1], known)
        edges = _Edges.of(task, grid, _at(cloud.t, moved, grid))
        crossings, errors, crossed = _crossings(edges, lines, task.team.layout)
        fit = _at(grid, lines.fit, time)
        off = values[..., :2] - np.nan_to_num(fit[..., 0] + s[..., None] * fit[..., 1])
        off[..., 1] -= lines.density * values[..., 2]
        within = (_at(grid, each, time) for each in crossed)
        ends = [np.where(np.isnan(a), b, a) for a, b in zip(within, ends, strict=True)]
    wrong = ~(errors < LARGEST) | _outlying(crossings - planned(task, t, task.vertices))
    crossings[wrong], errors[wrong] = np.nan, np.nan
    return Measured(crossings, errors, lines.density, _mean(lines.markers[..., 0]))


def _at(t: Array, values: Array, times: Array) -> Array:
    """Return values (t, …) at other times, linear between those that are not nan."""
    flat = values.reshape(len(t), -1)
    curves = np.full((len(times), flat.shape[1]), np.nan)
    for i, column in enumerate(flat.T):
        there = np.isfinite(column)
        if np.any(there):
            curves[:, i] = np.interp(times, t[there], column[there])
    return curves.reshape(len(times), *values.shape[1:])


def _mean(values: Array) -> Array:
    """Return the means over the first axis, nan counting as zero."""
    return np.asarray(np.mean(np.nan_to_num(values), axis=0))


def _fitted(points: _Points, grid: Array, width: float, n: int, known: float | None) -> _Lines:
    """Return the lines of n edges in windows about times (t,).

    They follow from moments of ones, places, times and values, summed over windows. The density of
    cables is fitted unless it is ``known``.
    """
    size = len(grid)
    q = np.column_stack([np.ones(len(points.s)), points.s, points.time, points.values])
    products = points.weight[:, None, None] * q[:, :, None] * q[:, None]
    total = np.concatenate([np.zeros((1, 6, 6)), np.cumsum(products, axis=0)])
    bounds = np.searchsorted(points.edge, np.arange(n + 1))
    first, end = (
        np.stack([a + np.searchsorted(points.time[a:b], grid + d) for a, b in pairwise(bounds)])
        for d in (-0.5 * width, 0.5 * width)
    )
    moments = total[end] - total[first]  # (n, t, 6, 6)
    weight = np.maximum(moments[..., 0, 0], 1e-9)
    shift = np.broadcast_to(np.eye(6), moments.shape).copy()  # To mean places and windows' times
    shift[..., 1, 0], shift[..., 2, 0] = -moments[..., 0, 1] / weight, -grid
    moments = shift @ moments @ np.swapaxes(shift, -1, -2)
    H = moments[..., :3, :3] + weight[..., None, None] * np.diag(RIDGE) + 1e-12 * np.eye(3)
    fit = np.linalg.solve(H, moments[..., :3, 3:])
    density = np.full(n, known or 0.0)
    if known is None:
        left = moments[..., 3:, 3:] - np.swapaxes(moments[..., :3, 3:], -1, -2) @ fit
        both, squares = np.sum(left[..., 1:, 2], axis=1).T
        density = np.clip(both / np.maximum(squares, 1e-12), 0.0, DENSEST)
    fit = fit[..., :2] - density[:, None, None, None] * fit[..., 2:] * [0.0, 1.0]
    count = (end - first).ravel()
    group = np.repeat(np.arange(n * size), count)
    row = np.arange(len(group)) - np.repeat(np.cumsum(count) - count - first.ravel(), count)
    A = np.einsum("kij,kj->ki", shift.reshape(-1, 6, 6)[group, :3, :3], q[row, :3])
    sag = density[points.edge[row], None] * q[row, 5:] * [0.0, 1.0]
    left = q[row, 3:5] - sag - np.einsum("kc,kcv->kv", A, fit.reshape(-1, 3, 2)[group])
    used = points.weight[row] > COUNTED
    markers, scatter = _markers(group[used], n * size, points.s[row[used]], left[used])
    markers = markers.reshape(n, size, 3)
    fit[..., 0, :] += fit[..., 1, :] * shift[..., 1, :1]
    none = (markers[..., 0] < 2) | (markers[..., 2] < LEAST_SPREAD)
    fit[none], markers[none] = np.nan, np.nan
    lines = np.swapaxes(np.moveaxis(fit[..., :2, :], 0, 1), -1, -2)
    return _Lines(lines, density, np.moveaxis(markers, 0, 1), scatter)


def _markers(group: Indices, groups: int, s: Array, left: Array) -> tuple[Array, float]:
    """Return number, mean place and squares of markers in groups of points, and their scatter [m].

    Points of a group that lie close along the edge are those of one marker. The scatter is that of
    markers' mean residuals, of points (k, 2), aside and in height.
    """
    order = np.lexsort((s, group))
    group, s, left = group[order], s[order], left[order]
    new = (np.diff(group, prepend=-1) > 0) | (np.diff(s, prepend=-np.inf) > SPACING)
    marker, of = np.cumsum(new) - 1, group[new]
    size = np.bincount(marker)
    place, *off = (np.bincount(marker, x) / size for x in (s, *left.T))
    count = np.bincount(of, minlength=groups).astype(np.float64)
    mean = np.bincount(of, place, groups) / np.maximum(count, 1.0)
    squares = np.bincount(of, (place - mean[of]) ** 2, groups)
    freedom = 2.0 * np.sum(np.where(count >= 3, count - 2.0, 0.0))
    if freedom:
        scatter = float(np.sqrt(np.sum(np.square(off)[:, count[of] >= 3]) / freedom))
    else:  # Two markers are always on a line; so their samples' scatter counts
        scatter = float(np.sqrt(np.mean(left**2))) if len(left) else np.nan
    return np.column_stack([count, mean, squares]), float(np.hypot(scatter, BENT))


def _crossings(
    edges: _Edges, lines: _Lines, layout: Layout
) -> tuple[Array, Array, tuple[Array, Array]]:
    """Return crossings (t, points, 3) and standard errors (t, points) [m] of neighbouring lines.

    Then places along every edge (t, n) at which it is crossed at its start and its end, or nan.
    """
    u, (a, b) = edges.along, (layout.behind, layout.ahead)
    normal = np.stack([-u[..., 1], u[..., 0]], axis=-1)
    base = edges.origin[..., :2] + lines.fit[..., 0, :1] * normal
    toward = u + lines.fit[..., 0, 1:] * normal
    sine = _cross(toward[:, a], toward[:, b])
    sine = np.where(np.abs(sine) < SINE, np.nan, sine)
    crossed = np.full((2, *edges.span.shape), np.nan)  # At their starts, and at their ends
    between = base[:, b] - base[:, a]
    crossed[0][:, b] = _cross(between, toward[:, a]) / sine
    crossed[1][:, a] = _cross(between, toward[:, b]) / sine
    heights = edges.origin[..., 2] + lines.fit[..., 1, 0]
    heights = heights + crossed * (edges.slope + lines.fit[..., 1, 1])
    heights = heights + lines.density * edges.sag(crossed)
    relative = line_variances(lines.markers, crossed)
    both = relative[1][:, a] + relative[0][:, b]
    crossings = np.full((len(u), layout.points, 3), np.nan)
    errors = np.full(crossings.shape[:2], np.nan)
    crossings[:, layout.clasps, :2] = base[:, b] + crossed[0][:, b, None] * toward[:, b]
    crossings[:, layout.clasps, 2] = 0.5 * (heights[1][:, a] + heights[0][:, b])
    errors[:, layout.clasps] = crossing_errors(lines.scatter**2 * both, sine)
    return crossings, errors, (crossed[0], crossed[1])


def _cross(a: Array, b: Array) -> Array:
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def _outlying(off: Array) -> NDArray[np.bool_]:
    """Return which vertices (times, points) are far from the median of their offsets around."""
    around = round(AROUND * RATE)
    padded = np.pad(off, ((around, around), (0, 0), (0, 0)), constant_values=np.nan)
    windows = sliding_window_view(padded, 2 * around + 1, axis=0)
    none = np.isnan(windows).all(axis=-1, keepdims=True)
    far = length(off - np.nanmedian(np.where(none, 0.0, windows), axis=-1))
    scatter = [
        1.4826 * np.median(x[np.isfinite(x)]) if np.isfinite(x).any() else 0.0 for x in far.T
    ]
    return np.asarray(far > OUTLYING * np.maximum(scatter, LEAST_SCATTER))


def clasps_of(crossings: Array, layout: Layout, diameter: float) -> Array:
    """Return contacts of cables of a diameter [m], outward of crossings (…, points, 3) [m]."""
    along = unit(layout.edges(crossings[..., :2]))
    inward = unit(along[..., layout.ahead, :] - along[..., layout.behind, :])
    cosine = np.sum(along[..., layout.ahead, :] * along[..., layout.behind, :], axis=-1)
    half = np.sqrt((1.0 - cosine) / np.maximum(1.0 + cosine, 1e-9))  # Tangent of half the turn
    clasps = np.full_like(crossings, np.nan)
    clasps[..., layout.clasps, :] = crossings[..., layout.clasps, :]
    off = diameter * (INWARD[0] + INWARD[1] * half)
    clasps[..., layout.clasps, :2] -= off[..., None] * inward
    return clasps
