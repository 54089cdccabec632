"""Rows of limits of motion along a flight: speeds, accelerations, jerks, thrusts and tilts.

They are at samples of the flight's clock, and depend on the splines that are added to its path and
on the spline x, the squared rate of a clock over that of the flight.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from hitchopt.geometry.vectors import length
from hitchopt.hitch.requirements import Requirements
from hitchopt.hitch.series import JET, chained
from hitchopt.planners.optimise.parts import (
    DRONE_LIMITS,
    Group,
    Limit,
    PartFunctions,
    groups_of,
)
from hitchopt.planners.optimise.splines import LocalBasis, PathSplines, scattered
from hitchopt.planners.path import Path
from hitchopt.planners.timing.clock import Clock, ClockedPath, inside
from hitchopt.planners.timing.profile import LIMIT_SHARE, Demands
from hitchopt.planners.timing.timed_motion import clocked_limits
from hitchopt.trajectory.splines import knots_through
from hitchopt.values import Array, Indices

RATE_DEGREE = 3  # Degree of the spline x


@dataclass(frozen=True, eq=False)
class ClockSamples:
    """M samples of a flight, the Gauss nodes of its clock τ, by which derivatives are."""

    path: Path  # The path of the flight
    clock: Clock  # Its clock, of which x may have been changed
    splines: PathSplines  # The splines that are added to the path
    nodes: int  # Number of nodes in each piece of the clock

    @cached_property
    def tau(self) -> Array:
        """(M,) [s]: the nodes."""
        return inside(self.clock.knots, np.polynomial.legendre.leggauss(self.nodes)[0])

    @cached_property
    def weights(self) -> Array:
        """(M,) [s]: weights of integrals over τ."""
        _, weights = np.polynomial.legendre.leggauss(self.nodes)
        return np.asarray((0.5 * np.diff(self.clock.knots)[:, None] * weights).ravel())

    @cached_property
    def progress(self) -> Array:
        """(M, 4): s and its derivatives."""
        progress = self.clock.progress.jet(self.tau, JET)
        progress[:, 0] = progress[:, 0].clip(0.0, 1.0)
        return progress

    @cached_property
    def unknowns(self) -> Array:
        """(M, 4, unknowns): the flat outputs and their derivatives."""
        by_s = self.splines.unknowns(self.path, self.progress[:, 0], JET)
        return np.ascontiguousarray(chained(by_s, self.progress[:, None]).swapaxes(1, 2))

    @cached_property
    def heights(self) -> Array:
        """(M, 4, points) [m]: the points' heights and their derivatives."""
        by_s = self.path.vertices.jet(self.progress[:, 0], JET)[:, :, 2]
        return np.ascontiguousarray(chained(by_s, self.progress[:, None]).swapaxes(1, 2))

    @cached_property
    def basis(self) -> LocalBasis:
        """The splines that are added, and their derivatives."""
        basis = self.splines.basis(self.progress[:, 0], JET)
        return LocalBasis(basis.first, chained(basis.jets, self.progress[:, None]))

    @cached_property
    def rate(self) -> Array:
        """(M, 3): x and its derivatives."""
        return self.clock.squared_rate.jet(self.tau, JET - 1)

    @cached_property
    def rate_knots(self) -> Array:
        """Knots of the spline x."""
        return knots_through(self.clock.knots, RATE_DEGREE)

    @cached_property
    def rate_basis(self) -> LocalBasis:
        """The B-splines of x, and their derivatives."""
        return LocalBasis.of(self.rate_knots, RATE_DEGREE, self.tau, JET - 1)

    @property
    def rate_count(self) -> int:
        """Number of coefficients of x."""
        return len(self.rate_knots) - RATE_DEGREE - 1

    @property
    def rate_coefficients(self) -> Array:
        """(rate_count,): x where each coefficient matters most."""
        averages = np.convolve(
            self.rate_knots[1:-1], np.full(RATE_DEGREE, 1.0 / RATE_DEGREE), "valid"
        )
        return self.clock.squared_rate.at(averages)

    @property
    def width(self) -> int:
        """Number of coefficients of all splines, then of x."""
        return self.splines.width + self.rate_count

    def moved_rate(self, change: Array) -> Array:
        """Return x and its derivatives (M, 3) after a change (rate_count,) of coefficients."""
        basis = self.rate_basis
        shift: Array = np.einsum("rco,rc->ro", basis.jets, change[basis.indices])
        return self.rate + shift


class Ratios(NamedTuple):
    """Limits of motion over their limits at M samples."""

    drones: Array  # (5, M, 2n), in the order of DRONE_LIMITS
    vertices: Array  # (M, points): speeds of points


@dataclass(frozen=True, eq=False)
class ChosenRows:
    """Limits of motion that have rows."""

    drones: NDArray[np.bool_]  # (5, M, 2n), in the order of DRONE_LIMITS
    vertices: NDArray[np.bool_]  # (M, points)

    @classmethod
    def near(cls, ratios: Ratios, share: float) -> ChosenRows:
        """Return the limits above a share."""
        return cls(ratios.drones > share, ratios.vertices > share)

    def without(self, others: ChosenRows) -> ChosenRows:
        """Return the chosen rows without the others."""
        return ChosenRows(self.drones & ~others.drones, self.vertices & ~others.vertices)

    def plus(self, others: ChosenRows) -> ChosenRows:
        """Return the chosen rows and the others."""
        return ChosenRows(self.drones | others.drones, self.vertices | others.vertices)

    @property
    def any(self) -> bool:
        """Return whether there are any."""
        return bool(np.any(self.drones) or np.any(self.vertices))

    def of(self, group: Group) -> Iterator[RowsOfLimit]:
        """Yield those of the parts of a group."""
        for limit, is_chosen in zip(DRONE_LIMITS, self.drones, strict=True):
            for side in range(group.kind.sides):
                sample, part = np.nonzero(is_chosen[:, group.drones[:, side]])
                if len(sample):
                    yield RowsOfLimit(limit, side, sample, part)
        sample, part = np.nonzero(self.vertices[:, group.vertices])
        if len(sample):
            yield RowsOfLimit(Limit.VERTEX_SPEED, 0, sample, part)


class RowsOfLimit(NamedTuple):
    """Rows of one limit of the parts of a group."""

    limit: Limit  # The limit
    side: int  # Which drone of a part it limits
    sample: Indices  # (rows,): samples
    part: Indices  # (rows,): parts


class LimitBlock(NamedTuple):
    """Rows of limits of motion."""

    # (rows, variables): derivatives by the splines' coefficients, then by those of x
    rows: sp.csr_array[np.float64]
    values: Array  # (rows,): values over the limits

    @property
    def largest(self) -> Array:
        """(rows,): largest changes."""
        return np.maximum(LIMIT_SHARE - self.values, 0.0)

    @classmethod
    def stacked(cls, blocks: Sequence[LimitBlock]) -> LimitBlock:
        """Return the rows of several blocks, at least one."""
        rows = sp.csr_array(sp.vstack([block.rows for block in blocks]))
        return cls(rows, np.concatenate([block.values for block in blocks]))


@dataclass(frozen=True, eq=False)
class MotionLimits:
    """Limits of motion at the samples of a flight."""

    samples: ClockSamples  # The samples
    requirements: Requirements  # Requirements of all flights

    @cached_property
    def functions(self) -> list[PartFunctions]:
        """The functions of all parts."""
        path = self.samples.path
        climbs = bool(np.ptp(path.vertices.coefficients[:, :, 2]) > 0.0)
        limits = clocked_limits(path, self.requirements)
        tilt = LIMIT_SHARE * limits.tilt
        return [
            PartFunctions(group, limits, tilt, path.team.max_thrust)
            for group in groups_of(self.samples.splines.columns, climbs=climbs)
        ]

    def ratios(self, path: Path, rate: Array) -> Ratios:
        """Return the limits at the samples of a path and x (M, 3)."""
        limits = self.functions[0].limits
        progress = self.samples.progress
        flat = path.flat(progress[:, 0])
        clocked = ClockedPath.of(Demands.of(path.team, flat, limits), progress)
        root = np.sqrt(rate[:, :1])
        speeds = root * length(clocked.first) / limits.speed
        drones = np.concatenate([speeds[None], clocked.ratios(rate.T)])
        vertex_speeds = root * progress[:, 1:2] * length(flat.vertices[..., 1])
        return Ratios(drones, vertex_speeds / limits.vertex_speed)

    def block(self, chosen: ChosenRows) -> LimitBlock:
        """Return the rows of chosen limits."""
        no_rows = LimitBlock(sp.csr_array((0, self.samples.width)), np.zeros(0))
        blocks = [
            self._rows(functions, rows)
            for functions in self.functions
            for rows in chosen.of(functions.group)
        ]
        return LimitBlock.stacked([no_rows, *blocks])

    def _rows(self, functions: PartFunctions, rows: RowsOfLimit) -> LimitBlock:
        """Return the rows of one limit of the parts of a group."""
        samples = self.samples
        sample = rows.sample
        slopes = functions.slopes(
            rows.limit,
            rows.side,
            rows.part,
            samples.unknowns[sample],
            samples.heights[sample],
            samples.rate[sample],
        )
        basis = samples.basis.at(sample)
        rate_basis = samples.rate_basis.at(sample)
        by_splines = np.einsum("rok,rco->rck", slopes.by_unknowns, basis.jets)
        by_rate = np.einsum("ro,rco->rc", slopes.by_clock, rate_basis.jets)
        places = samples.splines.places(basis, functions.group.columns[rows.part])
        count = len(sample)
        columns = [places.reshape(count, -1), samples.splines.width + rate_basis.indices]
        entries = [by_splines.reshape(count, -1), by_rate]
        matrix = scattered(
            np.concatenate(columns, axis=1), np.concatenate(entries, axis=1), samples.width
        )
        return LimitBlock(matrix, slopes.ratio)
