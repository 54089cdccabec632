"""Rows of shapes along a path: distances, walls, obstacles, legs, angles and tensions.

Unknowns of a shape are changed by splines over s; rows are by the splines' coefficients.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp

from hitchopt.checks.solids import Solid
from hitchopt.geometry.vectors import length, unit
from hitchopt.hitch.pairs import end_combinations
from hitchopt.hitch.requirements import Requirements
from hitchopt.planners.morph.detours import Obstacle, obstacles_of
from hitchopt.planners.optimise.parts import Columns, PartFunctions
from hitchopt.planners.optimise.program import near_pairs
from hitchopt.planners.optimise.splines import DEGREE, LocalBasis, PathSplines, scattered
from hitchopt.planners.path import Path
from hitchopt.values import Array, Indices

MARGIN_RAMP = 0.06  # Distance from an end in s over which margins rise

END_MARGIN = 1.0005
"""Enforced distances over their limits next to the ends, which are as near as limits allow."""

MIN_SINE = 0.026  # Smallest sine of exterior angles, unless the route has a smaller one
LEG_MARGIN = 1e-3  # [m] Margin of the shortest legs and of walls
TENSION_SHARE = 1e-3  # Margin at both ends of a range of tensions, over the range


class ShapeBlock(NamedTuple):
    """Rows of distances, legs, walls, angles and tensions."""

    rows: sp.csr_array[np.float64]  # (rows, coefficients): derivatives by the splines' coefficients
    smallest: Array  # (rows,): smallest changes

    @classmethod
    def stacked(cls, blocks: Sequence[ShapeBlock]) -> ShapeBlock:
        """Return the rows of several blocks, at least one."""
        rows = sp.csr_array(sp.vstack([block.rows for block in blocks]))
        return cls(rows, np.concatenate([block.smallest for block in blocks]))


class Slopes(NamedTuple):
    """Derivatives of quantities of bodies by the unknowns of their parts."""

    values: Array  # (J, bodies, …, largest size of a part)
    # (bodies, largest size of a part): the unknowns; any for entries that are zero
    columns: Indices

    @classmethod
    def zeros(cls, *shape: int) -> Slopes:
        """Return derivatives that are zero, of a shape (J, bodies, …, largest size of a part)."""
        return cls(np.zeros(shape), np.zeros((shape[1], shape[-1]), dtype=np.intp))


@dataclass(frozen=True, eq=False)
class PathShapes:
    """Shapes of a path at J samples, with their derivatives by the splines' coefficients.

    Nodes are those of ``Layout.routes``: points, then drones.
    """

    splines: PathSplines  # The splines that are added to the path
    s: Array  # (J,): the samples
    unknowns: Array  # (J, unknowns)
    nodes: Array  # (J, nodes, 3) [m]: positions
    drone_slopes: Slopes  # (J, 2n, 3, …): derivatives of drones
    turns: Array  # (J, clasps): sines of exterior angles
    turn_slopes: Slopes  # (J, clasps, …): derivatives of these

    @classmethod
    def of(
        cls, splines: PathSplines, functions: Sequence[PartFunctions], path: Path, s: Array
    ) -> PathShapes:
        """Return the shapes of a path at s (J,)."""
        columns = splines.columns
        team = columns.team
        layout = team.layout
        unknowns = splines.unknowns(path, s, 1)[..., 0]
        heights = path.vertices.jet(s, 1)[:, :, 2, 0]
        points = np.concatenate([unknowns[:, columns.points], heights[..., None]], axis=2)
        drones = points[:, layout.anchors]  # final at a chain's ends
        clasps = [each for each in functions if not each.group.kind.chain_end]
        size = max(each.group.kind.size for each in clasps)
        drone_slopes = Slopes.zeros(len(s), team.drones, 3, size)
        # A chain's ends are their points
        drone_slopes.columns[:, :2] = columns.points[layout.anchors]
        drone_slopes.values[:, :, :2, :2] = np.eye(2)
        turns = np.zeros((len(s), len(layout.clasps)))
        turn_slopes = Slopes.zeros(len(s), len(layout.clasps), size)
        first = 0
        for each in clasps:
            group = each.group
            values, by_unknowns = each.shapes(unknowns, heights)
            for side in range(2):
                rows = slice(3 * side, 3 * side + 3)
                of_side = group.drones[:, side]
                drones[:, of_side] = values[:, :, rows]
                drone_slopes.values[:, of_side] = by_unknowns[:, :, rows]
                drone_slopes.columns[of_side] = group.columns
            own = slice(first, first + len(group.columns))
            turns[:, own] = values[:, :, 6]
            turn_slopes.values[:, own] = by_unknowns[:, :, 6]
            turn_slopes.columns[own] = group.columns
            first = own.stop
        nodes = np.concatenate([points, drones], axis=1)
        return cls(splines, s, unknowns, nodes, drone_slopes, turns, turn_slopes)

    @property
    def columns(self) -> Columns:
        """The unknowns."""
        return self.splines.columns

    @cached_property
    def basis(self) -> LocalBasis:
        """The B-splines at the samples."""
        return self.splines.basis(self.s, 1)

    def _rows(self, sample: Indices, columns: Indices, slopes: Array) -> sp.csr_array[np.float64]:
        """Return rows of the derivatives (rows, k) by unknowns (rows, k) at samples (rows,)."""
        basis = self.basis.at(sample)
        entries = basis.jets[:, :, None, 0] * slopes[:, None]
        places = self.splines.places(basis, columns)
        shape = len(sample), (DEGREE + 1) * columns.shape[1]
        return scattered(places.reshape(shape), entries.reshape(shape), self.splines.width)

    def _of_nodes(self, sample: Indices, node: Indices, gradient: Array) -> tuple[Indices, Array]:
        """Return unknowns and derivatives (rows, k) of gradients (rows, 3) times positions."""
        points = self.columns.team.layout.points
        drone = np.maximum(node - points, 0)
        is_point = (node < points)[:, None]
        slopes = np.einsum("ra,rak->rk", gradient, self.drone_slopes.values[sample, drone])
        columns = self.drone_slopes.columns[drone]
        of_points = np.zeros_like(slopes)
        of_points[:, :2] = gradient[:, :2]
        point_columns = np.zeros_like(columns)
        point_columns[:, :2] = self.columns.points[np.minimum(node, points - 1)]
        return (
            np.where(is_point, point_columns, columns),
            np.where(is_point, of_points, slopes),
        )

    def _between(
        self, sample: Indices, first: Indices, second: Indices, gradient: Array, enforced: Array
    ) -> ShapeBlock:
        """Return rows of ``gradient · (first - second) ≥ enforced`` for nodes (rows,)."""
        ahead, of_ahead = self._of_nodes(sample, first, gradient)
        behind, of_behind = self._of_nodes(sample, second, -gradient)
        offset = self.nodes[sample, first] - self.nodes[sample, second]
        rows = self._rows(
            sample,
            np.concatenate([ahead, behind], axis=1),
            np.concatenate([of_ahead, of_behind], axis=1),
        )
        return ShapeBlock(rows, enforced - np.sum(gradient * offset, axis=1))

    def _beyond(self, sample: Indices, node: Indices, gradient: Array, least: Array) -> ShapeBlock:
        """Return rows of ``gradient · node ≥ least`` for nodes (rows,)."""
        columns, slopes = self._of_nodes(sample, node, gradient)
        places = self.nodes[sample, node]
        return ShapeBlock(
            self._rows(sample, columns, slopes), least - np.sum(gradient * places, axis=1)
        )

    def margins(self, margin: float) -> Array:
        """Return the margins (J,), which decrease to END_MARGIN where the path is fixed."""
        from_end = np.minimum(self.s, 1.0 - self.s) / MARGIN_RAMP
        return np.asarray(END_MARGIN + (margin - END_MARGIN) * np.minimum(from_end, 1.0))

    def pair_block(self, requirements: Requirements, reach: float, margin: float) -> ShapeBlock:
        """Return the rows of distances of near pairs of drones and cables, in space."""
        layout = self.columns.team.layout
        pairs = near_pairs(
            layout, self.nodes, requirements, self.margins(margin), np.full(len(self.s), reach)
        )
        pair, first, second = end_combinations(pairs.kind, pairs.first, pairs.second)
        return self._between(
            pairs.frame[pair], first, second, pairs.gradient[pair], pairs.enforced[pair]
        )

    def leg_block(self, requirements: Requirements, reach: float) -> ShapeBlock:
        """Return the rows of short legs."""
        layout = self.columns.team.layout
        drone = np.flatnonzero(layout.has_leg.ravel())
        anchor = layout.anchors[drone]
        scale = requirements.error_scale
        legs = (self.nodes[:, layout.points + drone] - self.nodes[:, anchor]) * scale
        enforced = requirements.limits.leg + LEG_MARGIN
        sample, leg = np.nonzero(length(legs) < enforced + reach)
        gradient = unit(legs[sample, leg]) * scale
        return self._between(
            sample,
            layout.points + drone[leg],
            anchor[leg],
            gradient,
            np.full(len(sample), enforced),
        )

    def wall_block(self, requirements: Requirements, reach: float) -> ShapeBlock:
        """Return the rows of drones near walls of the arena."""
        arena = requirements.arena
        if arena is None:
            return self._no_rows
        points = self.columns.team.layout.points
        samples: list[Indices] = []
        nodes: list[Indices] = []
        gradients: list[Array] = []
        least: list[Array] = []
        for axis in range(3):
            for sign, wall in ((1.0, arena.lower[axis]), (-1.0, arena.upper[axis])):
                bound = sign * wall + LEG_MARGIN
                sample, drone = np.nonzero(sign * self.nodes[:, points:, axis] < bound + reach)
                gradient = np.zeros((len(sample), 3))
                gradient[:, axis] = sign
                samples.append(sample)
                nodes.append(points + drone)
                gradients.append(gradient)
                least.append(np.full(len(sample), bound))
        return self._beyond(
            np.concatenate(samples),
            np.concatenate(nodes),
            np.concatenate(gradients),
            np.concatenate(least),
        )

    @property
    def _no_rows(self) -> ShapeBlock:
        """No rows."""
        return ShapeBlock(sp.csr_array((0, self.splines.width)), np.zeros(0))

    def obstacle_blocks(
        self, requirements: Requirements, reach: float, margin: float
    ) -> Iterator[ShapeBlock]:
        """Yield the rows of drones and cables near prisms and objects."""
        for obstacle in obstacles_of(self.columns.team.layout, requirements):
            yield self._obstacle_block(obstacle, requirements.height_ratio, reach, margin)

    def _obstacle_block(
        self, obstacle: Obstacle, height_ratio: float, reach: float, margin: float
    ) -> ShapeBlock:
        """Return the rows of bodies near an obstacle."""
        solid = Solid(obstacle.slab).flattened(height_ratio)
        scale = np.array([1.0, 1.0, 1.0 / height_ratio])
        place, (cosine, sine) = obstacle.pose[:3], obstacle.pose[3:]
        to_slab = np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])
        nodes = (self.nodes - place) @ to_slab.T * scale
        blocks = [self._no_rows]
        for ends, distance in obstacle.bodies:
            corners = nodes[:, ends]  # (J, bodies, 2, 3)
            normals = solid.normals(corners[:, :, None])[:, :, 0]
            along = np.sum(corners * normals[:, :, None], axis=-1)
            gaps = np.min(along, axis=2) - solid.support(normals)
            sample, body = np.nonzero(gaps < margin * distance + reach)
            gradient = normals[sample, body] * scale @ to_slab
            least = solid.support(normals[sample, body]) + margin * distance + gradient @ place
            blocks += [self._beyond(sample, ends[body, end], gradient, least) for end in range(2)]
        return ShapeBlock.stacked(blocks)

    def turn_block(self) -> ShapeBlock:
        """Return the rows of the sines of exterior angles, which do not become too small."""
        sample, clasp = np.indices(self.turns.shape).reshape(2, -1)
        slopes = self.turn_slopes
        rows = self._rows(sample, slopes.columns[clasp], slopes.values[sample, clasp])
        return ShapeBlock(rows, np.minimum(MIN_SINE - self.turns[sample, clasp], 0.0))

    def tension_block(self, tension: tuple[float, float]) -> ShapeBlock:
        """Return the rows of a range of tensions [N]."""
        smallest, largest = tension
        margin = TENSION_SHARE * (largest - smallest)
        columns = self.columns.tensions
        tensions = self.unknowns[:, columns]
        sample, cable = np.indices(tensions.shape).reshape(2, -1)
        of_cables = columns[cable][:, None]
        ones = np.ones((len(sample), 1))
        above = np.minimum(smallest + margin - tensions, 0.0)
        below = np.minimum(tensions - largest + margin, 0.0)
        return ShapeBlock.stacked(
            [
                ShapeBlock(self._rows(sample, of_cables, ones), above.ravel()),
                ShapeBlock(self._rows(sample, of_cables, -ones), below.ravel()),
            ]
        )
