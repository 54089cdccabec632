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
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d
from scipy.special import stdtrit

from hitchopt.errors import OneLine
from hitchopt.flights.recordings import WINDOW_TIGHT, Track, planned, tight
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
BENT = 1e-3  # Scatter of ropes that clasps bend about lines, besides that of markers [m]
ONE_SIGMA = 0.8413  # Share of a normal distribution below its mean and a standard deviation
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
# Of planned markers: distance to clasps, shortest stretch [m], and number on an edge
CLEAR, SHORTEST, MARKERS = 0.05, 0.1, 3


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


def relative_errors(markers: Array, ends: Array, sine: Array, layout: Layout) -> Array:
    """Return standard errors of clasps (t, clasps) over the scatter of markers about lines.

    ``markers`` has number, mean place [m] and sum of squares of places [m²] of edges (t, n, 3);
    ``ends`` places at which they are crossed (2, t, n) [m], at angles whose ``sine`` is given.
    """
    count, mean, squares = np.moveaxis(markers, -1, 0)
    variances = 1.0 / count + (ends - mean) ** 2 / squares
    both = variances[1][:, layout.behind] + variances[0][:, layout.ahead]
    return np.asarray(np.sqrt(both * (1.0 / sine**2 + 0.25)))  # Aside, and mean heights


def measured_vertices(
    task: Task, t: Array, cloud: Track, drones: Array, density: float | None, window: float
) -> Measured:
    """Return the vertices at times at which the plan has its hitch.

    Parameters
    ----------
    task: the plan.
    t: (times,) [s], ascending.
    cloud: points in the plan's time and frame, at times at which the plan has its hitch; those of
        the drones' own markers may be among them.
    drones: places of the drones at the cloud's times, each once (frames, 2n, 3) [m].
    density: of the cables [kg/m]; None: the plan's, or fitted if the plan knows no weight.
    window: time over which places are averaged [s].
    """
    team, layout = task.team, task.team.layout
    known = density
    if density is None and team.cable_density >= WEIGHTLESS:
        known = team.cable_density
    times, frame = np.unique(cloud.t, return_inverse=True)
    moved = np.median(drones - planned(task, times, task.setpoints.positions), axis=1)
    frames = max(1, round(SMOOTH * len(times) / max(np.ptp(times), SMOOTH)))
    moved = uniform_filter1d(moved, frames, axis=0, mode="nearest")
    own = np.min(length(cloud.positions[:, None] - drones[frame]), axis=1) < BODY
    frame, time = frame[~own], cloud.t[~own]
    expected = _Edges.of(task, times, moved)
    s, values = expected.seen(frame, cloud.positions[~own])
    ends: list[Array] = [np.zeros(s.shape), expected.span[frame]]
    off = values[..., :2] - (known or 0.0) * values[..., 2:] * [0.0, 1.0]
    for gate, width in ((gate, width or window) for gate, width in ROUNDS):
        distance = np.where((s > ends[0]) & (s < ends[1]), length(off), np.inf)
        edge, share = np.argmin(distance, axis=1), np.min(distance, axis=1) / gate
        grid = np.arange(t[0], t[-1] + width, width / OVERLAP) if width > window else t
        lines = []
        for k in range(s.shape[1]):
            near = (share < 1.0) & (edge == k)
            given = time[near], s[near, k], values[near, k], (1.0 - share[near] ** 2) ** 2
            lines.append(_fitted(*given, grid, width, known))
        fit, markers = (np.stack(each, axis=1) for each in list(zip(*lines, strict=True))[:2])
        densities, squares, freedom = np.array([line[2:] for line in lines]).T
        edges = _Edges.of(task, grid, through_gaps(times, moved, grid))
        crossings, crossed, sine = _crossings(edges, fit, densities, layout)
        there = through_gaps(grid, fit, time)
        off = values[..., :2] - np.nan_to_num(there[..., 0, :] + s[..., None] * there[..., 1, :])
        off[..., 1] -= densities * values[..., 2]
        within = (through_gaps(grid, each, time) for each in crossed)
        ends = [np.where(np.isnan(a), b, a) for a, b in zip(within, ends, strict=True)]
    # Markers are the same in all windows: as many squares are free as in one of them
    free = max(float(np.sum(freedom)), 1.0)
    scatter = np.hypot(np.sqrt(np.sum(squares) / free) * float(stdtrit(free, ONE_SIGMA)), BENT)
    errors = np.full(crossings.shape[:2], np.nan)
    errors[:, layout.clasps] = scatter * relative_errors(markers, crossed, sine, layout)
    wrong = ~(errors < LARGEST) | _outlying(crossings - planned(task, t, task.vertices))
    crossings[wrong], errors[wrong] = np.nan, np.nan
    return Measured(crossings, errors, densities, np.mean(np.nan_to_num(markers[..., 0]), axis=0))


def through_gaps(t: Array, values: Array, times: Array) -> Array:
    """Return values (t, …) at other times, linear between those that are not nan."""
    flat = values.reshape(len(t), -1)
    curves = np.full((len(times), flat.shape[1]), np.nan)
    for i, column in enumerate(flat.T):
        there = np.isfinite(column)
        if np.any(there):
            curves[:, i] = np.interp(times, t[there], column[there])
    return curves.reshape(len(times), *values.shape[1:])


def _fitted(
    time: Array, s: Array, values: Array, weight: Array, grid: Array, width: float, known: Any
) -> tuple[Array, Array, float, float, float]:
    """Return the lines of an edge in windows about times ``grid`` (t,), and of their markers.

    Lines follow from moments of ones, places, times and values (k, 3) of the edge's points, summed
    over windows. The density of the cable is fitted unless it is ``known``.

    Returns
    -------
    Offset and slope (t, 2, 2), aside and above; nan with fewer than two markers. Number, mean place
    [m] and squares of places [m²] of markers (t, 3). Density [kg/m]. Mean over windows of the
    squares of markers' distances from lines [m²], and how many of these are free.
    """
    q = np.column_stack([np.ones(len(s)), s, time, values])
    products = np.cumsum(weight[:, None, None] * q[:, :, None] * q[:, None], axis=0)
    total = np.concatenate([np.zeros((1, 6, 6)), products])
    first, end = (np.searchsorted(time, grid + share * width) for share in (-0.5, 0.5))
    moments = total[end] - total[first]  # (t, 6, 6)
    size = np.maximum(moments[:, 0, 0], 1e-9)
    middle = moments[:, 0, 1] / size
    shift = np.tile(np.eye(6), (len(grid), 1, 1))  # To mean places and windows' times
    shift[:, 1, 0], shift[:, 2, 0] = -middle, -grid
    moments = shift @ moments @ np.swapaxes(shift, 1, 2)
    H = moments[:, :3, :3] + size[:, None, None] * np.diag(RIDGE) + 1e-12 * np.eye(3)
    fit, density = np.linalg.solve(H, moments[:, :3, 3:]), known
    if density is None:
        left = moments[:, 3:, 3:] - np.swapaxes(moments[:, :3, 3:], 1, 2) @ fit
        both, squares = np.sum(left[:, 1:, 2], axis=0)
        density = float(np.clip(both / max(squares, 1e-12), 0.0, DENSEST))
    fit = fit[..., :2] - density * fit[..., 2:] * [0.0, 1.0]
    window = np.repeat(np.arange(len(grid)), end - first)
    row = np.concatenate([np.arange(a, b) for a, b in zip(first, end, strict=True)])
    window, row = window[counted := weight[row] > COUNTED], row[counted]
    at = np.stack([np.ones(len(row)), s[row] - middle[window], time[row] - grid[window]], axis=1)
    left = values[row, :2] - density * values[row, 2:] * [0.0, 1.0]
    left = left - np.einsum("kc,kcv->kv", at, fit[window])
    # Points of a window that lie close along the edge are those of one marker
    order = np.lexsort((s[row], window))
    window, places, left = window[order], s[row[order]], left[order]
    new = (np.diff(window, prepend=-1) > 0) | (np.diff(places, prepend=-np.inf) > SPACING)
    marker, of = np.cumsum(new) - 1, window[new]
    place, *off = (np.bincount(marker, x) / np.bincount(marker) for x in (places, *left.T))
    count = np.bincount(of, minlength=len(grid))
    mean = np.bincount(of, place, len(grid)) / np.maximum(count, 1)
    squares = np.bincount(of, (place - mean[of]) ** 2, len(grid))
    markers = np.column_stack([count, mean, squares])
    fit[:, 0] -= fit[:, 1] * middle[:, None]
    none = (count < 2) | (squares < LEAST_SPREAD)
    fit[none], markers[none] = np.nan, np.nan
    free = 2.0 * np.mean(np.maximum(count - 2, 0))
    scatter = np.sum(np.square(off)[:, count[of] > 2]) / len(grid)
    return fit[:, :2], markers, density, float(scatter), float(free)


def _crossings(
    edges: _Edges, fit: Array, density: Array, layout: Layout
) -> tuple[Array, Array, Array]:
    """Return crossings (t, points, 3) [m] of neighbouring lines (t, n, 2, 2).

    Then places at which every edge is crossed at its start and its end (2, t, n) [m], nan where it
    is not, and sines of angles (t, clasps).
    """
    u, (a, b) = edges.along, (layout.behind, layout.ahead)
    normal = np.stack([-u[..., 1], u[..., 0]], axis=-1)
    base = edges.origin[..., :2] + fit[..., 0, :1] * normal
    toward = u + fit[..., 1, :1] * normal
    sine = _cross(toward[:, a], toward[:, b])
    sine = np.where(np.abs(sine) < SINE, np.nan, sine)
    crossed = np.full((2, *edges.span.shape), np.nan)
    between = base[:, b] - base[:, a]
    crossed[0][:, b] = _cross(between, toward[:, a]) / sine
    crossed[1][:, a] = _cross(between, toward[:, b]) / sine
    heights = edges.origin[..., 2] + fit[..., 0, 1] + crossed * (edges.slope + fit[..., 1, 1])
    heights = heights + density * edges.sag(crossed)
    crossings = np.full((len(u), layout.points, 3), np.nan)
    crossings[:, layout.clasps, :2] = base[:, b] + crossed[0][:, b, None] * toward[:, b]
    crossings[:, layout.clasps, 2] = 0.5 * (heights[1][:, a] + heights[0][:, b])
    return crossings, crossed, sine


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


@dataclass(frozen=True, eq=False)
class MarkerPlan(OneLine):
    """Markers of every cable, and the errors of vertices that they give.

    Attributes
    ----------
    stretches: (n, 2) [m], from q's end: the part of each cable that stays on its edge while the
        hitch is drawn tight; its end is before its beginning if there is none.
    places: of each cable, where its markers go [m] from q's end.
    standard_errors: (points, 2) [m], median and largest over time, of markers that scatter by
        BENT; nan at the ends of a chain, infinite without two markers on both edges.
    """

    stretches: Array
    places: tuple[Array, ...]
    standard_errors: Array


def marker_plan(task: Task) -> MarkerPlan:
    """Return where markers go on the cables of a plan's hitch.

    On a stretch that never leaves the edge there are three, as far apart as can be. If a cable
    slides too far for that, markers follow one another such that three are on the edge at any time.
    """
    layout, hitched = task.team.layout, tight(task, task.t - task.t[0], WINDOW_TIGHT)
    vertices, drones = task.vertices[hitched], task.setpoints.positions[hitched]
    edges, starts = layout.edges(vertices), length(drones - vertices[:, layout.anchors])[:, ::2]
    begins, ends = starts + CLEAR, starts + length(edges) - CLEAR
    stretches = np.column_stack([np.max(begins, axis=0), np.min(ends, axis=0)])
    places, markers = [], np.full((*begins.shape, 3), np.nan)
    for k, (lower, upper) in enumerate(stretches):
        step = max(float(np.min(ends[:, k] - begins[:, k])), SHORTEST) / MARKERS
        each = np.arange(np.min(begins[:, k]), np.max(ends[:, k]) + 0.5 * step, step)
        each = np.linspace(lower, upper, MARKERS) if upper - lower >= SHORTEST else each
        on = (each >= begins[:, k, None]) & (each <= ends[:, k, None])
        count, s = np.sum(on, axis=1), each - starts[:, k, None]
        mean = np.sum(s * on, axis=1) / np.maximum(count, 1)
        squares = np.sum((s - mean[:, None]) ** 2 * on, axis=1)
        markers[:, k] = np.where(count > 1, [count, mean, squares], np.nan).T
        places.append(each)
    u, crossed = unit(edges[..., :2]), np.stack([0.0 * starts, length(edges)])
    sine = _cross(u[:, layout.behind], u[:, layout.ahead])
    of_clasps = np.nan_to_num(relative_errors(markers, crossed, sine, layout), nan=np.inf)
    errors = np.full((layout.points, 2), np.nan)
    if np.any(hitched):
        medians = np.median(of_clasps, axis=0), np.max(of_clasps, axis=0)
        errors[layout.clasps] = BENT * np.column_stack(medians)
    return MarkerPlan(stretches, tuple(places), errors)
