"""Vertices of a hitch from markers on its edges: crossings of fitted lines, seen from above.

Points are assigned to the nearest edge, regardless of labels. In a time window, a line is fitted to
the points of an edge by least squares, laterally and in height: offset, slope and rate, in addition
to the sag of a cable under its tension. Gates and windows shrink from round to round, and points
are weighted by their distance to the previous line (Tukey's biweight). A vertex is the crossing of
the lines of neighbouring edges seen from above, at their mean height. Standard errors follow from
the scatter of markers, not of samples, since the offset of a marker from its cable is constant.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d
from scipy.special import stdtrit

from hitchopt.drones.quadrotor import GRAVITY
from hitchopt.errors import OneLine
from hitchopt.geometry.vectors import cross, left_of, length, unit
from hitchopt.hitch.team import Layout
from hitchopt.lab.flights.recordings import Track, plan_at, taut_at
from hitchopt.lab.simulation.task import TeamTask
from hitchopt.values import Array, Indices

RATE = 20.0  # Sampling rate of vertices [Hz]
DRONE_RADIUS = 0.09  # Distance from a drone within which markers belong to it [m]
WINDOW = 0.1  # Default time window of line fits [s]
RIDGE = np.array([0.0, 1e-6, 1e-6])  # Added to mean squares of positions [m²] and times [s²]
MIN_SPREAD = 1e-3  # Smallest sum of squared positions of an edge's markers [m²]
MIN_SPACING = 0.03  # Minimum distance of two markers along an edge [m]
ROPE_SCATTER = 1e-3  # Scatter about lines due to the bending of ropes at clasps [m]
ONE_SIGMA = 0.8413  # Standard normal distribution function at 1
MIN_WEIGHT = 0.25  # Smallest weight of points that count as markers
SMOOTHING = 1.0  # Averaging time of the common displacement of the drones [s]
MAX_ERROR = 0.05  # Largest standard error of a vertex [m]
MIN_SINE = 0.05  # Smallest sine of the angle between crossing edges
# Largest distance of a sample from the running median, over the scatter: others are outliers
OUTLIER_RATIO = 6.0
MEDIAN_TIME = 0.5  # Half width of the window of the running median [s]
MIN_SCATTER = 2e-3  # Smallest scatter about the running median [m]
MIN_DENSITY = 5e-4  # Smallest density of a plan that models weight [kg/m]
MAX_DENSITY = 0.1  # Largest fitted density [kg/m]
# Distance from the crossing of two cables to their contact, over the diameter: a + b tan(φ/2) for a
# turn φ; from simulated flights with ropes of 12 mm
CONTACT_OFFSET = (0.8, 0.75)
CLASP_DISTANCE = 0.05  # Distance of planned markers to clasps [m]
MIN_SECTION = 0.1  # Shortest marked section [m]
MARKERS = 3  # Number of planned markers on an edge


class Round(NamedTuple):
    """One of the rounds in which points are assigned to edges and lines are fitted."""

    gate: float  # largest distance of points from their line [m]
    window: float | None  # time window of the fits [s]; None for the default one


ROUNDS = (
    Round(0.30, 1.0),
    Round(0.12, 0.6),
    Round(0.05, 0.3),
    Round(0.03, None),
    Round(0.02, None),
)
OVERLAP = 5  # Overlapping windows per window of the first rounds


@dataclass(frozen=True, eq=False)
class Measured:
    """Measured vertices in the plan's frame."""

    crossings: Array  # (times, points, 3) [m]; nan if not measured, and at the ends of a chain
    standard_errors: Array  # (times, points) [m]; nan where ``crossings`` are
    density: Array  # of every cable (n,) [kg/m], stated or fitted
    markers: Array  # mean number of markers of every edge in a window (n,)


@dataclass(frozen=True, eq=False)
class _Edges:
    """Expected edges at times (t,): local frames of the lines that are fitted."""

    origin: Array  # (t, n, 3) [m]
    along: Array  # (t, n, 2), level unit vectors
    span: Array  # (t, n) [m], level length
    slope: Array  # (t, n)
    curvature: Array  # (t, n) [m²/kg], second derivative of the height over the density

    @classmethod
    def of(cls, task: TeamTask, t: Array, displacement: Array) -> _Edges:
        """Return the edges of a plan at times (t,), with a displacement (t, 3) [m]."""
        layout = task.team.layout
        points = plan_at(task, t, task.states.vertices) + displacement[:, None]
        edges = layout.edges(points)
        span = np.maximum(length(edges[..., :2]), 1e-9)
        tensions = np.maximum(plan_at(task, t, task.states.tensions), 0.1 * task.team.tension)
        along = edges[..., :2] / span[..., None]
        slope = edges[..., 2] / span
        return cls(points[:, layout.starts], along, span, slope, GRAVITY / tensions)

    def local(self, time: Indices, x: Array) -> tuple[Array, Array]:
        """Return positions along all edges (k, n) [m], and offsets (k, n, 3), of points (k, 3).

        Offsets are lateral and vertical [m], and the sag over the density [m²/kg] at that position.
        """
        off = x[:, None] - self.origin[time]
        u = self.along[time]
        s = np.sum(off[..., :2] * u, axis=-1)
        vertical = off[..., 2] - self.slope[time] * s
        return s, np.stack([cross(u, off), vertical, self.sag(s, time)], axis=-1)

    def sag(self, s: Array, time: Indices | slice = slice(None)) -> Array:
        """Return heights over the density at positions along edges (…, n) [m], zero at the ends."""
        return np.asarray(0.5 * self.curvature[time] * s * (s - self.span[time]))


def relative_errors(markers: Array, ends: Array, sine: Array, layout: Layout) -> Array:
    """Return standard errors of clasps (t, clasps) over the scatter of markers about lines.

    ``markers`` (t, n, 3) are number, mean position [m] and sum of squared positions [m²] by edge;
    ``ends`` (2, t, n) [m] positions of crossings on edges, and ``sine`` (t, clasps) that of angles.
    """
    count, mean, squares = np.moveaxis(markers, -1, 0)
    variances = 1.0 / count + (ends - mean) ** 2 / squares
    both = variances[1][:, layout.behind] + variances[0][:, layout.ahead]
    return np.asarray(np.sqrt(both * (1.0 / sine**2 + 0.25)))  # Lateral, and of mean heights


def measured_vertices(
    task: TeamTask, t: Array, cloud: Track, drones: Array, density: float | None, window: float
) -> Measured:
    """Return the vertices at times at which the plan's hitch is taut.

    Parameters
    ----------
    task: the plan.
    t: (times,) [s], ascending.
    cloud: markers in the plan's time and frame while the hitch is taut, those of drones included.
    drones: positions of the drones at the unique times of the cloud (frames, 2n, 3) [m].
    density: of the cables [kg/m]; None: the plan's, or fitted if the plan models no weight.
    window: time window of the line fits [s].
    """
    team = task.team
    layout = task.team.layout
    if density is None and team.cable_density >= MIN_DENSITY:
        density = team.cable_density
    times, frame = np.unique(cloud.t, return_inverse=True)
    displacement = _smoothed_displacement(task, times, drones)
    of_drones = np.min(length(cloud.positions[:, None] - drones[frame]), axis=1) < DRONE_RADIUS
    frame = frame[~of_drones]
    time = cloud.t[~of_drones]
    expected = _Edges.of(task, times, displacement)
    s, values = expected.local(frame, cloud.positions[~of_drones])
    ends: list[Array] = [np.zeros(s.shape), expected.span[frame]]
    off = values[..., :2] - (density or 0.0) * values[..., 2:] * [0.0, 1.0]
    for gate, stated_width in ROUNDS:
        width = stated_width or window
        distance = np.where((s > ends[0]) & (s < ends[1]), length(off), np.inf)
        edge = np.argmin(distance, axis=1)
        ratio = np.min(distance, axis=1) / gate
        grid = np.arange(t[0], t[-1] + width, width / OVERLAP) if width > window else t
        lines = list[_Lines]()
        for k in range(s.shape[1]):
            on = (ratio < 1.0) & (edge == k)
            points = _Points(time[on], s[on, k], values[on, k], (1.0 - ratio[on] ** 2) ** 2)
            lines.append(_Lines.fitted(points, grid, width, density))
        fit = np.stack([each.fit for each in lines], axis=1)
        densities = np.array([each.density for each in lines])
        edges = _Edges.of(task, grid, through_gaps(times, displacement, grid))
        crossings, ends_at_grid, sine = _crossings(edges, fit, densities, layout)
        offset, slope = np.moveaxis(through_gaps(grid, fit, time), -2, 0)
        off = values[..., :2] - np.nan_to_num(offset + s[..., None] * slope)
        off[..., 1] -= densities * values[..., 2]
        crossed_at_points = (through_gaps(grid, each, time) for each in ends_at_grid)
        ends = [np.where(np.isnan(a), b, a) for a, b in zip(crossed_at_points, ends, strict=True)]
    markers = np.stack([each.markers for each in lines], axis=1)
    scatter = np.hypot(_scatter_of(lines), ROPE_SCATTER)
    errors = np.full(crossings.shape[:2], np.nan)
    errors[:, layout.clasps] = scatter * relative_errors(markers, ends_at_grid, sine, layout)
    wrong = ~(errors < MAX_ERROR) | _outlying(crossings - plan_at(task, t, task.states.vertices))
    crossings[wrong], errors[wrong] = np.nan, np.nan
    return Measured(crossings, errors, densities, np.mean(np.nan_to_num(markers[..., 0]), axis=0))


def _smoothed_displacement(task: TeamTask, times: Array, drones: Array) -> Array:
    """Return the common displacement (times, 3) [m] of drones (times, 2n, 3) [m] from the plan."""
    displacement = np.median(drones - plan_at(task, times, task.states.positions), axis=1)
    frames = max(1, round(SMOOTHING * len(times) / max(np.ptp(times), SMOOTHING)))
    smoothed: Array = uniform_filter1d(displacement, frames, axis=0, mode="nearest")
    return smoothed


def through_gaps(t: Array, values: Array, times: Array) -> Array:
    """Return values (t, …) at other times, interpolated between those that are finite."""
    flat = values.reshape(len(t), -1)
    curves = np.full((len(times), flat.shape[1]), np.nan)
    for i, column in enumerate(flat.T):
        finite = np.isfinite(column)
        if np.any(finite):
            curves[:, i] = np.interp(times, t[finite], column[finite])
    return curves.reshape(len(times), *values.shape[1:])


class _Points(NamedTuple):
    """Points of one edge, in order of time."""

    time: Array  # (k,) [s]
    s: Array  # (k,) [m], positions along the edge
    values: Array  # (k, 3): lateral and vertical offset [m], and sag over the density [m²/kg]
    weight: Array  # (k,)


class _Moments(NamedTuple):
    """Weighted moments of points in windows (t,): of ones, positions, times and values.

    Positions and times are relative to the means and middles of the windows.
    """

    first: Indices  # (t,), first point of every window
    end: Indices  # (t,), point after the last one
    size: Array  # (t,), sum of weights
    middle: Array  # (t,) [m], mean position
    products: Array  # (t, 6, 6)

    @classmethod
    def of(cls, points: _Points, grid: Array, width: float) -> _Moments:
        """Return the moments in windows of a width [s] about times (t,)."""
        ones = np.ones(len(points.s))
        columns = np.column_stack([ones, points.s, points.time, points.values])
        weighted = points.weight[:, None, None] * columns[:, :, None] * columns[:, None]
        total = np.concatenate([np.zeros((1, 6, 6)), np.cumsum(weighted, axis=0)])
        first = np.searchsorted(points.time, grid - 0.5 * width)
        end = np.searchsorted(points.time, grid + 0.5 * width)
        products = total[end] - total[first]
        size = np.maximum(products[:, 0, 0], 1e-9)
        middle = products[:, 0, 1] / size
        shift = np.tile(np.eye(6), (len(grid), 1, 1))
        shift[:, 1, 0] = -middle
        shift[:, 2, 0] = -grid
        return cls(first, end, size, middle, shift @ products @ np.swapaxes(shift, 1, 2))

    def fit(self) -> Array:
        """Return offset, slope and rate of every value (t, 3, 3) by regularised least squares."""
        H = self.products[:, :3, :3] + self.size[:, None, None] * np.diag(RIDGE)
        H = H + 1e-12 * np.eye(3)
        return np.asarray(np.linalg.solve(H, self.products[:, :3, 3:]), dtype=np.float64)

    def density(self, fit: Array) -> float:
        """Return the density [kg/m] with which heights about lines are least."""
        explained = np.swapaxes(self.products[:, :3, 3:], 1, 2) @ fit
        residuals = self.products[:, 3:, 3:] - explained
        both, squares = np.sum(residuals[:, 1:, 2], axis=0)
        return float(np.clip(both / max(squares, 1e-12), 0.0, MAX_DENSITY))


@dataclass(frozen=True, eq=False)
class _Lines:
    """Lines of an edge in windows about times (t,), and statistics of its markers."""

    fit: Array  # (t, 2, 2), offset and slope, lateral and vertical; nan without two markers
    markers: Array  # (t, 3): number, mean position [m], sum of squared positions [m²]
    density: float  # [kg/m], stated or fitted
    squares: float  # [m²], mean over windows of the markers' squared residuals
    freedom: float  # mean over windows of the degrees of freedom

    @classmethod
    def fitted(cls, points: _Points, grid: Array, width: float, density: float | None) -> _Lines:
        """Return the lines in windows of a width [s]; the density is fitted if it is None."""
        moments = _Moments.of(points, grid, width)
        fit = moments.fit()
        density = moments.density(fit) if density is None else density
        fit = fit[..., :2] - density * fit[..., 2:] * [0.0, 1.0]
        owner, position, errors = _markers(points, grid, moments, fit, density)
        count = np.bincount(owner, minlength=len(grid))
        mean = np.bincount(owner, position, len(grid)) / np.maximum(count, 1)
        squares = np.bincount(owner, (position - mean[owner]) ** 2, len(grid))
        markers = np.column_stack([count, mean, squares])
        fit[:, 0] -= fit[:, 1] * moments.middle[:, None]
        unusable = (count < 2) | (squares < MIN_SPREAD)
        fit[unusable] = np.nan
        markers[unusable] = np.nan
        scatter = np.sum(np.square(errors)[:, count[owner] > 2]) / len(grid)
        freedom = 2.0 * np.mean(np.maximum(count - 2, 0))
        return cls(fit[:, :2], markers, density, float(scatter), float(freedom))


def _markers(
    points: _Points, grid: Array, moments: _Moments, fit: Array, density: float
) -> tuple[Indices, Array, Array]:
    """Return markers (m,) in windows: index of the window, position [m] and errors (2, m) [m].

    Points of a window that are close along the edge belong to one marker.
    """
    window = np.repeat(np.arange(len(grid)), moments.end - moments.first)
    bounds = zip(moments.first, moments.end, strict=True)
    i = np.concatenate([np.arange(first, end) for first, end in bounds])
    heavy = points.weight[i] > MIN_WEIGHT
    window = window[heavy]
    i = i[heavy]
    from_middle = points.s[i] - moments.middle[window]
    design = np.stack([np.ones(len(i)), from_middle, points.time[i] - grid[window]], axis=1)
    residuals = points.values[i, :2] - density * points.values[i, 2:] * [0.0, 1.0]
    residuals = residuals - np.einsum("kc,kcv->kv", design, fit[window])
    order = np.lexsort((points.s[i], window))
    window = window[order]
    positions = points.s[i[order]]
    residuals = residuals[order]
    new = (np.diff(window, prepend=-1) > 0) | (np.diff(positions, prepend=-np.inf) > MIN_SPACING)
    marker = np.cumsum(new) - 1
    members = np.bincount(marker)
    position, *errors = (np.bincount(marker, x) / members for x in (positions, *residuals.T))
    return window[new], position, np.array(errors)


def _scatter_of(lines: list[_Lines]) -> float:
    """Return the scatter of markers about lines [m], larger with few degrees of freedom."""
    # All windows see the same markers: the degrees of freedom are those of one window
    freedom = max(float(np.sum([each.freedom for each in lines])), 1.0)
    squares = np.sum([each.squares for each in lines])
    return float(np.sqrt(squares / freedom) * stdtrit(freedom, ONE_SIGMA))


def _crossings(
    edges: _Edges, fit: Array, density: Array, layout: Layout
) -> tuple[Array, Array, Array]:
    """Return crossings (t, points, 3) [m] of neighbouring lines (t, n, 2, 2).

    Then follow positions of the crossings at the start and the end of every edge (2, t, n) [m], nan
    without a crossing, and sines of the angles (t, clasps).
    """
    u = edges.along
    a, b = (layout.behind, layout.ahead)
    normal = left_of(u)
    base = edges.origin[..., :2] + fit[..., 0, :1] * normal
    toward = u + fit[..., 1, :1] * normal
    sine = cross(toward[:, a], toward[:, b])
    sine = np.where(np.abs(sine) < MIN_SINE, np.nan, sine)
    crossed = np.full((2, *edges.span.shape), np.nan)
    between = base[:, b] - base[:, a]
    crossed[0][:, b] = cross(between, toward[:, a]) / sine
    crossed[1][:, a] = cross(between, toward[:, b]) / sine
    heights = edges.origin[..., 2] + fit[..., 0, 1] + crossed * (edges.slope + fit[..., 1, 1])
    heights = heights + density * edges.sag(crossed)
    crossings = np.full((len(u), layout.points, 3), np.nan)
    crossings[:, layout.clasps, :2] = base[:, b] + crossed[0][:, b, None] * toward[:, b]
    crossings[:, layout.clasps, 2] = 0.5 * (heights[1][:, a] + heights[0][:, b])
    return crossings, crossed, sine


def _outlying(off: Array) -> NDArray[np.bool_]:
    """Return a mask of vertices (times, points) whose offsets are far from their running median."""
    half = round(MEDIAN_TIME * RATE)
    padded = np.pad(off, ((half, half), (0, 0), (0, 0)), constant_values=np.nan)
    windows = sliding_window_view(padded, 2 * half + 1, axis=0)
    empty = np.isnan(windows).all(axis=-1, keepdims=True)
    distances = length(off - np.nanmedian(np.where(empty, 0.0, windows), axis=-1))
    scatter = [
        1.4826 * np.median(x[np.isfinite(x)]) if np.isfinite(x).any() else 0.0 for x in distances.T
    ]
    return np.asarray(distances > OUTLIER_RATIO * np.maximum(scatter, MIN_SCATTER))


def clasps_of(crossings: Array, layout: Layout, diameter: float) -> Array:
    """Return contacts of cables of a diameter [m], outward of crossings (…, points, 3) [m]."""
    along = unit(layout.edges(crossings[..., :2]))
    inward = unit(along[..., layout.ahead, :] - along[..., layout.behind, :])
    cosine = np.sum(along[..., layout.ahead, :] * along[..., layout.behind, :], axis=-1)
    tangent = np.sqrt((1.0 - cosine) / np.maximum(1.0 + cosine, 1e-9))  # Tangent of half the turn
    clasps = np.full_like(crossings, np.nan)
    clasps[..., layout.clasps, :] = crossings[..., layout.clasps, :]
    off = diameter * (CONTACT_OFFSET[0] + CONTACT_OFFSET[1] * tangent)
    clasps[..., layout.clasps, :2] -= off[..., None] * inward
    return clasps


@dataclass(frozen=True, eq=False)
class MarkerPlan(OneLine):
    """Marker positions on every cable, and the resulting errors of vertices."""

    # (n, 2) [m] from q's end, section of each cable that stays on its edge while the hitch is taut;
    # if there is none, the second bound is below the first
    stretches: Array
    places: tuple[Array, ...]  # positions of the markers on each cable [m] from q's end
    # (points, 2) [m], median and largest over time, for a scatter of ROPE_SCATTER; nan at the ends
    # of a chain, infinite without two markers on both edges
    standard_errors: Array


def marker_plan(task: TeamTask) -> MarkerPlan:
    """Return marker positions on the cables of a plan's hitch.

    A section that never leaves the edge gets three evenly spaced markers. If a cable slides too far
    for that, markers are spaced such that three are on the edge at any time.
    """
    layout = task.team.layout
    hitched = taut_at(task, task.states.t - task.states.t[0])
    vertices, drones = task.states.vertices[hitched], task.states.positions[hitched]
    edges = layout.edges(vertices)
    legs = length(drones - vertices[:, layout.anchors])[:, ::2]
    lower_ends = legs + CLASP_DISTANCE
    upper_ends = legs + length(edges) - CLASP_DISTANCE
    stretches = np.column_stack([np.max(lower_ends, axis=0), np.min(upper_ends, axis=0)])
    places = []
    markers = np.full((*lower_ends.shape, 3), np.nan)
    for k, (first, last) in enumerate(stretches):
        step = max(float(np.min(upper_ends[:, k] - lower_ends[:, k])), MIN_SECTION) / MARKERS
        positions = np.arange(np.min(lower_ends[:, k]), np.max(upper_ends[:, k]) + 0.5 * step, step)
        positions = np.linspace(first, last, MARKERS) if last - first >= MIN_SECTION else positions
        on_edge = (positions >= lower_ends[:, k, None]) & (positions <= upper_ends[:, k, None])
        count = np.sum(on_edge, axis=1)
        s = positions - legs[:, k, None]
        mean = np.sum(s * on_edge, axis=1) / np.maximum(count, 1)
        squares = np.sum((s - mean[:, None]) ** 2 * on_edge, axis=1)
        markers[:, k] = np.where(count > 1, [count, mean, squares], np.nan).T
        places.append(positions)
    u = unit(edges[..., :2])
    ends = np.stack([0.0 * legs, length(edges)])
    sine = cross(u[:, layout.behind], u[:, layout.ahead])
    of_clasps = np.nan_to_num(relative_errors(markers, ends, sine, layout), nan=np.inf)
    errors = np.full((layout.points, 2), np.nan)
    if np.any(hitched):
        statistics = np.median(of_clasps, axis=0), np.max(of_clasps, axis=0)
        errors[layout.clasps] = ROPE_SCATTER * np.column_stack(statistics)
    return MarkerPlan(stretches, tuple(places), errors)
