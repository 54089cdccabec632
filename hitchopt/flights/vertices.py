"""Vertices of a hitch from markers on its edges: crossings of local lines, seen from above.

A point near an edge belongs to it, whatever its label. In windows of time the points of an edge
give a line, aside and in height: offset, slope and rate by robust least squares, besides the sag of
a cable under its tension. Round by round gates and windows shrink. A vertex is where the lines of
neighbouring edges cross seen from above, at their mean height. Standard errors follow from how
markers, not samples, scatter about lines: what bends a cable is alike in all samples of a window.
"""

from __future__ import annotations

from dataclasses import dataclass

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
# Distances from its edge within which a point counts [m], and windows [s], round by round; the last
# window is the default one. Windows begin one after the other OVERLAP times within each
GATES, WINDOWS, WINDOW, OVERLAP = (0.30, 0.12, 0.05, 0.03), (1.0, 0.6, 0.3), 0.1, 5
# Solutions of a window, scatters beyond which points count little, and the least scatter [m]
REWEIGHTED, FAR, FINEST = 4, 3.0, 1e-4
RIDGE = np.array([0.0, 1e-6, 1e-6])  # Added to mean squares of places [m²] and times [s²]
LEAST_SPREAD = 1e-3  # Least sum of squares of the places of an edge's markers [m²]
SPACING = 0.03  # Distance along an edge from which on points are of different markers [m]
BENT = 1e-3  # Scatter about lines of ropes that clasps bend, besides that of markers [m]
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


@dataclass(frozen=True, eq=False)
class _Lines:
    """Local lines of all edges at some times; nan with fewer than two markers."""

    fit: Array  # (t, n, 2, 2): aside and above; offset at the expected start, and slope
    density: Array  # (n,) [kg/m], of the sag besides
    markers: Array  # (t, n, 3): number, mean place [m], and sum of squares of places [m²]
    scatter: Array  # (2,) [m], of markers about lines, aside and above


def line_variances(markers: Array, s: Array) -> Array:
    """Return variances of lines at places along (…) [m] over that of markers about them.

    ``markers`` has their number, mean place [m] and sum of squares of places [m²] (…, 3).
    """
    count, mean, squares = np.moveaxis(markers, -1, 0)
    return np.asarray(1.0 / count + (s - mean) ** 2 / squares)


def crossing_errors(aside: Array, above: Array, sine: Array) -> Array:
    """Return standard errors (…) [m] of crossings of two lines at an angle.

    ``aside`` and ``above`` are the sums of both lines' variances there (…) [m²].
    """
    return np.asarray(np.sqrt(aside / sine**2 + 0.25 * above))


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
    layout, n = task.team.layout, task.team.robots
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
    off = values[..., :2].copy()
    off[..., 1] -= (known or 0.0) * values[..., 2]
    for gate, width in zip(GATES, (*WINDOWS, window), strict=True):
        distance = np.where((s > ends[0]) & (s < ends[1]), length(off), np.inf)
        edge = np.argmin(distance, axis=1)
        near = np.flatnonzero(np.min(distance, axis=1) < gate)
        near = near[np.lexsort((time[near], edge[near]))]
        grid = np.arange(t[0], t[-1] + width, width / OVERLAP) if gate > GATES[-1] else t
        given = edge[near], time[near], s[near, edge[near]], values[near, edge[near]]
        lines = _fitted(grid, width, n, *given, known)
        edges = _Edges.of(task, grid, _at(cloud.t, moved, grid))
        crossings, errors, crossed = _crossings(edges, lines, layout)
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


def _fitted(
    grid: Array, width: float, n: int, edge: Indices, time: Array, s: Array, values: Array,
    known: float | None,
) -> _Lines:  # fmt: skip
    """Return the lines of n edges in windows about times, of points sorted by edge and time.

    ``values`` are aside, above and sag (k, 3); of a cable without ``known`` density it is fitted.
    """
    size = len(grid)
    key = 2.0 * (np.max(np.abs(np.append(time, grid))) + width)  # Times of an edge are apart
    sorted_by = edge * key + time
    middle = (np.arange(n)[:, None] * key + grid).ravel()
    first, end = (np.searchsorted(sorted_by, middle + d) for d in (-0.5 * width, 0.5 * width))
    count = end - first
    group = np.repeat(np.arange(n * size), count)
    row = np.arange(len(group)) - np.repeat(np.cumsum(count) - count, count) + first[group]

    def summed(values: Array) -> Array:
        return np.asarray(np.bincount(group, values, n * size), np.float64)

    along, late = s[row], time[row] - grid[group % size]
    place = summed(along) / np.maximum(count, 1)
    A = np.stack([np.ones(len(row)), along - place[group], late], axis=-1)
    y, weight = values[row], np.ones(len(row))
    density = np.full(n, known or 0.0)
    for _ in range(REWEIGHTED):
        total = np.maximum(summed(weight), 1e-9)
        H, g = np.empty((n * size, 3, 3)), np.empty((n * size, 3, 3))
        for i in range(3):
            for j in range(3):
                H[:, i, j] = summed(weight * A[:, i] * A[:, j])
                g[:, i, j] = summed(weight * A[:, i] * y[:, j])
        H += total[:, None, None] * np.diag(RIDGE) + 1e-12 * np.eye(3)
        fit = np.linalg.solve(H, g)
        left = y - np.einsum("ki,kij->kj", A, fit[group])
        if known is None:
            each = group // size
            both = np.bincount(each, weight * left[:, 1] * left[:, 2], n)
            own = np.bincount(each, weight * left[:, 2] ** 2, n)
            density = np.clip(both / np.maximum(own, 1e-12), 0.0, DENSEST)
        left = np.column_stack([left[:, 0], left[:, 1] - density[group // size] * left[:, 2]])
        off = length(left)
        far = off / (FAR * max(1.4826 * float(np.median(off)) if len(off) else 0.0, FINEST))
        weight = 1.0 / (1.0 + far**2) ** 2
    markers, scatter = _markers(group, n * size, along, left, weight)
    of = np.arange(n * size) // size
    lines = np.stack([fit[:, :2, 0], fit[:, :2, 1] - density[of, None] * fit[:, :2, 2]], axis=1)
    lines[..., 0] -= lines[..., 1] * place[:, None]
    none = (markers[:, 0] < 2) | (markers[:, 2] < LEAST_SPREAD)
    lines[none], markers[none] = np.nan, np.nan
    shaped = (np.moveaxis(x.reshape(n, size, *x.shape[1:]), 0, 1) for x in (lines, markers))
    return _Lines(next(shaped), density, next(shaped), scatter)


def _markers(
    group: Indices, groups: int, s: Array, left: Array, weight: Array
) -> tuple[Array, Array]:
    """Return number, mean place and squares of markers in groups of points, and their scatter.

    Points of a group that lie close along the edge are those of one marker; the scatter is that of
    its mean residuals (k, 2) [m].
    """
    used = np.flatnonzero(weight > 0.25)  # As far as FAR scatters
    used = used[np.lexsort((s[used], group[used]))]
    group, s, left = group[used], s[used], left[used]
    new = (np.diff(group, prepend=-1) > 0) | (np.diff(s, prepend=-np.inf) > SPACING)
    marker = np.cumsum(new) - 1
    size = np.bincount(marker)
    place, aside, above = (np.bincount(marker, x) / size for x in (s, *left.T))
    of = group[new]
    count = np.bincount(of, minlength=groups).astype(np.float64)
    mean = np.bincount(of, place, groups) / np.maximum(count, 1.0)
    squares = np.bincount(of, (place - mean[of]) ** 2, groups)
    many = count[of] >= 3
    freedom = np.sum(np.where(count >= 3, count - 2.0, 0.0))
    if freedom:
        scatter = [np.sqrt(np.sum(x[many] ** 2) / freedom) for x in (aside, above)]
    else:  # Two markers are always on a line; so their samples' scatter counts
        scatter = [float(np.std(x)) if len(x) else np.nan for x in left.T]
    return np.column_stack([count, mean, squares]), np.hypot(scatter, BENT)


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
    aside, above = lines.scatter**2
    errors[:, layout.clasps] = crossing_errors(aside * both, above * both, sine)
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
