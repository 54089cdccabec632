"""Tracks of a vertex through timed points, at rest before and after.

Of all tracks, ``vertex_track`` has the least squared jerk of the vertex. Its drones may exceed
their limits where others do not: ``eased`` changes it between the points until they keep them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from hitchopt.errors import check_time
from hitchopt.hitch.model import drone_jets
from hitchopt.hitch.requirements import Limits
from hitchopt.planners.path import Path
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.trajectory.splines import interpolated
from hitchopt.values import Array

REST_TOLERANCE = 1e-9
"""[m] Distance of two consecutive points below which the vertex rests between them."""

AT_REST = (1, 2)  # Orders of the derivatives that vanish where a track begins and ends


def spline_through(s: Array, points: Array, zero_orders: tuple[int, int]) -> Array:
    """Return the coefficients (J - 1, d, 6) of a quintic spline through points (J, d) at s (J,)."""
    coefficients = interpolated(s - s[0], points, zero_orders=zero_orders).coefficients.copy()
    coefficients[..., 0] = points[:-1]
    coefficients[..., -1] = points[1:]
    return coefficients


def vertex_track(times: Array, points: Array) -> PiecewisePolynomial:
    """Return the path through points (J, d) [m] at times (J,) [s], a piece per interval.

    Each moving stretch is a quintic spline with four continuous derivatives, which minimises the
    squared jerk; it is at rest at both ends.
    """
    coefficients = np.empty((len(times) - 1, points.shape[1], 6))
    for span in _stretches(points):
        if _rests(points[span.start : span.start + 2]):
            coefficients[span] = points[span, :, None]
            continue
        knots = slice(span.start, span.stop + 1)
        coefficients[span] = spline_through(times[knots], points[knots], AT_REST)
    return PiecewisePolynomial(times, coefficients)


def _rests(points: Array) -> bool:
    """Return whether a vertex rests between two points (2, d) [m]."""
    return bool(np.linalg.norm(points[1] - points[0]) < REST_TOLERANCE)


def _stretches(points: Array) -> list[slice]:
    """Return the intervals between points (J, d) [m], split where the vertex stops or starts."""
    distances = np.linalg.norm(np.diff(points, axis=0), axis=1)
    resting = distances < REST_TOLERANCE
    changes = np.flatnonzero(resting[1:] | resting[:-1]) + 1
    bounds = [0, *changes.tolist(), len(distances)]
    return [slice(first, last) for first, last in pairwise(bounds)]


MAX_FREE = 200  # Maximum number of free values of a track along either axis

MAX_PARTS = 3
"""Maximum number of parts of an interval between points, at whose ends a track is free."""

SAMPLES_PER_PART = 4  # Number of samples of each part

EXPONENTS = (6.0, 12.0, 24.0, 48.0)
"""Exponents of stretches whose sum is minimised, each from the last one's track: the larger, the
closer to the largest stretch."""

MAX_STEPS = 8  # Maximum number of Newton steps for an exponent

EASED = 0.99
"""Largest stretch at samples at which a track is eased enough; enclosures need about 0.001."""

MIN_GAIN = 1e-3  # Relative decrease of the sum in a step, below which the next exponent follows
MIN_STEP = 1e-3  # Smallest share of a Newton step that is tried
SMALL_WEIGHT = 1e-9  # Weight of a row relative to the largest one, below which it is left out
DIFFERENCE = 1e-5  # Change of a jet of the vertex for difference quotients of the drones' jets
DAMPING = 1e-10  # Damping of Newton's matrix, relative to its diagonal


def eased(path: Path, limits: Limits, seconds: float) -> Path:
    """Return the path of a timed track with smaller speeds, accelerations and jerks of its drones.

    The vertex passes its points at the same times. Its positions between them are free, and
    minimise the sum of powers ``σ^p`` over samples of drones, where ``σ = (|x⁽ᵏ⁾| / limit)^(1/k)``
    is the stretch in time that a derivative of order k needs. Newton's method has the drones' exact
    dependence on the vertex up to first order; p rises until all samples keep the limits.

    Parameters
    ----------
    path: its s is time over ``seconds`` [s], and one of its vertices moves.
    """
    moving = np.ptp(path.vertices.coefficients, axis=(0, 3)).max(axis=1)
    vertex = int(np.argmax(moving))
    track = _FreeTrack.of(path.vertices, vertex)
    if not track.free.shape[0]:
        return path
    program = _EasedTrack.of(replace(path, vertices=track.fixed), vertex, track, limits, seconds)
    values = np.zeros((track.free.shape[0], 2))
    best = program.state(values)
    state = best
    for exponent in EXPONENTS:
        for _ in range(MAX_STEPS):
            if best.stretch <= EASED:
                return replace(path, vertices=track.with_values(best.values, vertex))
            check_time()
            better = program.improved(state, exponent)
            if better is None:
                break
            gain = state.sum_of_powers(exponent, state.stretch)
            gain -= better.sum_of_powers(exponent, state.stretch)
            is_last = gain < MIN_GAIN * state.sum_of_powers(exponent, state.stretch)
            state = better
            best = min(best, state, key=lambda each: each.stretch)
            if is_last:
                break
    return replace(path, vertices=track.with_values(best.values, vertex))


class _FreeTrack(NamedTuple):
    """A track that is refined by values between its points, and the splines of these values."""

    fixed: PiecewisePolynomial  # (points, 3) over s [m], all vertices, on the refined breaks
    # (values,) over s: 1 at one of the places between the points, and 0 at all others
    free: PiecewisePolynomial

    @classmethod
    def of(cls, vertices: PiecewisePolynomial, vertex: int) -> _FreeTrack:
        """Return the refined track of a vertex of a path (points, 3) [m]."""
        points = vertices.at(vertices.breaks)[:, vertex, :2]
        parts = int(np.clip(1 + MAX_FREE // vertices.pieces, 1, MAX_PARTS))
        shares = np.arange(parts) / parts
        starts = vertices.breaks[:-1, None] + np.diff(vertices.breaks)[:, None] * shares
        breaks = np.append(starts.ravel(), vertices.breaks[-1])
        positions = vertices.at(breaks)
        coefficients = np.repeat(positions[:-1, ..., None], 6, axis=-1)
        blocks = list[tuple[slice, Array]]()
        for span in _stretches(points):
            if _rests(points[span.start : span.start + 2]):
                continue
            pieces = slice(parts * span.start, parts * span.stop)
            s = breaks[pieces.start : pieces.stop + 1]
            through = positions[pieces.start : pieces.stop + 1, vertex, :2]
            coefficients[pieces, vertex, :2] = spline_through(s, through, AT_REST)
            is_free = np.arange(len(s)) % parts != 0
            splines = interpolated(s - s[0], np.eye(len(s))[:, is_free], zero_orders=AT_REST)
            blocks.append((pieces, splines.coefficients))
        count = sum(block.shape[1] for _, block in blocks)
        basis = np.zeros((len(breaks) - 1, count, 6))
        first = 0
        for pieces, block in blocks:
            basis[pieces, first : first + block.shape[1]] = block
            first += block.shape[1]
        return cls(PiecewisePolynomial(breaks, coefficients), PiecewisePolynomial(breaks, basis))

    def with_values(self, values: Array, vertex: int) -> PiecewisePolynomial:
        """Return all vertices with changes (values, 2) [m] of one between its points."""
        coefficients = self.fixed.coefficients.copy()
        coefficients[:, vertex, :2] += np.einsum("pvc,va->pac", self.free.coefficients, values)
        return self.fixed.replaced(coefficients)


ORDERS = np.arange(1, 4)  # Orders of the derivatives that have limits


class _Rates(NamedTuple):
    """Rates of points along a track."""

    values: Array  # (values, 2) [m]: changes of the track between its points
    vertices: Array  # (J, points, 3, 4): jets of all vertices in s, at J samples
    # (J, movers, 3, 3): derivatives of orders 1 to 3 over their limits, of drones and vertex
    ratios: Array

    @property
    def stretch(self) -> float:
        """Largest stretch in time that a sample needs."""
        sizes = np.linalg.norm(self.ratios, axis=2)
        return float(np.max(sizes ** (1.0 / ORDERS)))

    def sum_of_powers(self, exponent: float, scale: float) -> float:
        """Return the sum of powers of all stretches over a scale."""
        sizes = np.linalg.norm(self.ratios, axis=2)
        return float(np.sum((sizes / scale**ORDERS) ** (exponent / ORDERS)))


@dataclass(frozen=True, eq=False)
class _EasedTrack:
    """The program of ``eased``."""

    path: Path  # The path with the track as it is
    vertex: int  # Index of the vertex
    s: Array  # (J,): samples of the path
    jets: Array  # (J, points, 3, 4): jets of the vertices of the track as it is
    free: Array  # (J, values, 4): jets of the splines of the free values
    limits: Array  # (movers, 3): limits of derivatives by s; infinite without one

    @classmethod
    def of(
        cls, path: Path, vertex: int, track: _FreeTrack, limits: Limits, seconds: float
    ) -> _EasedTrack:
        """Return the program of a track."""
        breaks = track.fixed.breaks
        shares = np.arange(SAMPLES_PER_PART) / SAMPLES_PER_PART
        s = np.append((breaks[:-1, None] + np.diff(breaks)[:, None] * shares).ravel(), 1.0)
        of_drone = [limits.speed, limits.acceleration, limits.jerk]
        of_vertex = [limits.vertex_speed, np.inf, np.inf]
        rows = np.array([of_drone] * path.team.drones + [of_vertex]) * seconds**ORDERS
        return cls(path, vertex, s, track.fixed.jet(s, 4), track.free.jet(s, 4), rows)

    def state(self, values: Array) -> _Rates:
        """Return the rates of the track with changes (values, 2) [m]."""
        vertices = self.jets.copy()
        vertices[:, self.vertex, :2] += np.einsum("jvm,va->jam", self.free, values)
        return _Rates(values, vertices, self._ratios(vertices))

    def _ratios(self, vertices: Array) -> Array:
        """Return the ratios of ``_Rates`` for jets of vertices."""
        drones = drone_jets(self.path.team, self.path.flat_of(vertices, self.s)).positions
        movers = np.concatenate([drones, vertices[:, self.vertex, None]], axis=1)
        ratios: Array = movers[..., 1:] / self.limits[:, None]
        return ratios

    def _slopes(self, state: _Rates) -> Array:
        """Return the derivatives (2, 4, J, movers, 3, 3) of ratios by the jets of the vertex."""
        slopes = np.empty((2, 4, *state.ratios.shape))
        for axis, order in np.ndindex(2, 4):
            changed = state.vertices.copy()
            changed[:, self.vertex, axis, order] += DIFFERENCE
            slopes[axis, order] = (self._ratios(changed) - state.ratios) / DIFFERENCE
        return slopes

    def improved(self, state: _Rates, exponent: float) -> _Rates | None:
        """Return the track after a Newton step to a smaller sum of powers; None without one."""
        step = self._newton_step(state, exponent)
        scale = state.stretch
        before = state.sum_of_powers(exponent, scale)
        share = 1.0
        while share >= MIN_STEP:
            moved = self.state(state.values + share * step)
            if moved.sum_of_powers(exponent, scale) < before:
                return moved
            share *= 0.5
        return None

    def _newton_step(self, state: _Rates, exponent: float) -> Array:
        """Return Newton's step (values, 2) [m] of the sum of powers of stretches."""
        slopes = self._slopes(state)
        size = 2 * len(state.values)
        gradient = np.zeros(size)
        hessian = np.zeros((size, size))
        for order in ORDERS:
            scale = state.stretch**order
            ratios = state.ratios[..., order - 1].reshape(-1, 3) / scale
            by_jets = slopes[..., order - 1]
            by_values = np.einsum("amjdc,jvm->jdcva", by_jets, self.free) / scale
            power = exponent / order
            sizes = np.maximum(np.linalg.norm(ratios, axis=1), np.finfo(float).tiny)
            weights = power * sizes ** (power - 2.0)
            heavy = weights > SMALL_WEIGHT * np.max(weights)
            rows = by_values.reshape(-1, 3, size)[heavy]
            weight = weights[heavy]
            along = np.einsum("rc,rcv->rv", ratios[heavy] / sizes[heavy, None], rows)
            gradient += (weight * sizes[heavy]) @ along
            hessian += ((power - 2.0) * weight[:, None] * along).T @ along
            weighted = (np.sqrt(weight)[:, None, None] * rows).reshape(-1, size)
            hessian += weighted.T @ weighted
        scales = np.sqrt(np.maximum(np.diag(hessian), np.finfo(float).tiny))
        scaled = hessian / np.outer(scales, scales) + DAMPING * np.eye(size)
        step: Array = -np.linalg.solve(scaled, gradient / scales) / scales
        return step.reshape(-1, 2)
