"""Minimum distances of bodies, and the pairs of a taut hitch that keep them.

``DISTANCES`` has the limits of all distances and the bodies of different teams that keep them, from
which follows how tracking errors shorten them; checks, planners and start times read it. Bodies and
errors within a team are those of each check's rule. ``TautBodies`` has the pairs of one hitch.

Nodes are those of ``Layout.routes``. Bodies are pairs of nodes: first all drones (both nodes the
same), then the taut cable parts of ``Layout.parts``. Cables need not form a single ring.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from hitchopt.geometry.broadphase import Boxes, few_close_pairs
from hitchopt.hitch.requirements import Requirements, Separation
from hitchopt.hitch.team import Layout
from hitchopt.values import Array, Indices

SEPARATION = 0  # Kind of pairs of two drones
CABLE = 1  # Kind of pairs of a drone and a cable
CROSSING = 2  # Kind of pairs of two cables


MAX_DIRECT_BODIES = 64
"""Maximum number of bodies all of whose pairs are compared, without a spatial index."""

MAX_SWEPT_PAIRS = 20
"""Maximum number of close pairs per body, each counted twice, of frames processed together."""


MIN_GAP = 1e-4
"""[m] Closer cables may touch, and pass through each other, regardless of limits: a hundred times
the largest jump at a joint."""


Kind = Literal[
    "drones",
    "vertices",
    "clasps",
    "cables",
    "taut",
    "held",
    "objects",
    "movable",
    "walls",
    "ground",
]
"""Kinds of bodies: ``taut`` are parts of taut cables, ``held`` objects that a team holds,
``movable`` those that downwash would move, ``walls`` those of the arena."""

Bodies = tuple[Kind, ...]  # The kind of single bodies, or both kinds of a pair

FIXED: frozenset[Kind] = frozenset({"objects", "movable", "walls", "ground"})
"""Kinds of bodies that do not move with a team."""


@dataclass(frozen=True)
class DistanceRule:
    """A distance that bodies keep, within a team and between teams.

    Parameters
    ----------
    check: name of the check.
    kinds: kinds of bodies of different teams that keep it; ``objects`` are those of a team.
    limit: minimum distance [m], or ratio.
    """

    check: str
    kinds: tuple[tuple[Kind, Kind], ...]
    limit: Callable[[Separation], float]

    def approach(self, error: float) -> float:
        """Return the largest approach of two bodies of different teams per radius of errors.

        Drones are within the radius of their plan, cables and objects within ``error`` times it.
        """
        return max(sum(1.0 if kind == "drones" else error for kind in pair) for pair in self.kinds)


DISTANCES = {
    rule.check: rule
    for rule in (
        DistanceRule("separation", (("drones", "drones"),), lambda _: 1.0),
        DistanceRule("cable_clearance", (("drones", "cables"),), lambda s: max(s.cable, MIN_GAP)),
        DistanceRule("crossing", (("cables", "cables"),), lambda s: max(s.crossing, MIN_GAP)),
        DistanceRule("keep_out", (("drones", "objects"),), lambda s: s.radius),
        DistanceRule("downwash", (("drones", "taut"), ("drones", "movable")), lambda _: 1.0),
        DistanceRule(
            "object_clearance",
            (("cables", "objects"), ("objects", "objects")),
            lambda s: max(s.object, MIN_GAP),
        ),
    )
}
"""All distances, by check. Rules of checks within a team take their limits from here, too."""


def limits_of(separation: Separation) -> Array:
    """Return the minimum distances (3,) [m] by kind of pairs, as planners keep them."""
    return np.array([2.0 * separation.radius, separation.cable, separation.crossing])


def scales_of(requirements: Requirements) -> Array:
    """Return the scale factors (3, 3) of the axes in distances, by kind of pairs."""
    separation = requirements.separation
    scales = np.ones((3, 3))
    scales[:, 2] = 1.0 / requirements.height_ratio
    scales[SEPARATION, 2] = separation.radius / separation.height
    return scales


@dataclass(frozen=True, eq=False)
class TautBodies:
    """The bodies of a hitch."""

    layout: Layout  # Its indices
    nodes: Indices  # (bodies, 2), both ends

    @classmethod
    @lru_cache(maxsize=64)
    def of(cls, layout: Layout) -> TautBodies:
        """Return the bodies of a hitch."""
        drones = layout.points + np.arange(2 * layout.robots)
        nodes = np.concatenate([np.column_stack([drones, drones]), layout.part_nodes])
        return cls(layout, nodes)

    def of_parts(self, parts: Indices) -> Indices:
        """Return the bodies of cable parts, which are numbered as in ``Layout.parts``."""
        return 2 * self.layout.robots + np.searchsorted(self.layout.parts, parts)

    def kind(self, i: Indices, j: Indices) -> Indices:
        """Return the kind of each pair of bodies, drones first, or -1 if they may touch.

        A drone may touch the part that ends at it (its leg, or its edge without one), and parts may
        touch at a common clasp.
        """
        layout = self.layout
        drones = 2 * layout.robots
        is_drone = i < drones
        other_is_drone = j < drones
        drone = np.minimum(i, drones - 1)
        has_leg = layout.has_leg.ravel()[drone]
        own_end = np.where(has_leg, layout.points + drone, layout.anchors[drone])
        is_foreign = np.all(self.nodes[j] != own_end[:, None], axis=1)
        vertices = self._vertices(i)[:, :, None]
        other_vertices = self._vertices(j)[:, None, :]
        is_common = (vertices == other_vertices) & (vertices >= 0)
        clasped = np.any(is_common, axis=(1, 2))
        kind = np.where(is_drone | clasped, -1, CROSSING)
        kind[is_drone & ~other_is_drone & is_foreign] = CABLE
        kind[is_drone & other_is_drone] = SEPARATION
        return kind

    def _vertices(self, bodies: Indices) -> Indices:
        """Return the vertices at both ends of bodies (bodies, 2), -1 where there is none."""
        nodes = self.nodes[bodies]
        return np.where(nodes < self.layout.points, nodes, -1)

    def near(self, lowest: Array, highest: Array, limits: Array, cutoff: float) -> Indices:
        """Return (4, pairs): frame, both bodies and kind of the pairs with close boxes per frame.

        Parameters
        ----------
        lowest, highest: (J, bodies, 2) [m], opposite corners of the boxes in J frames.
        limits: (3,) [m], distances by kind; kinds with limit zero are omitted.
        cutoff: largest distance of close boxes [m].
        """
        frames = len(lowest)
        swept = Boxes(lowest.min(axis=0), highest.max(axis=0))
        if len(self.nodes) <= MAX_DIRECT_BODIES:
            i, j, kind = self.all_pairs
            limited = limits[kind] > 0.0
            if frames > 1:
                limited &= _are_close(swept.lower, swept.upper, i, j, cutoff)
        else:
            max_pairs = MAX_SWEPT_PAIRS * len(self.nodes) if frames > 1 else np.inf
            pairs = few_close_pairs(swept, None, cutoff, max_pairs)
            if pairs is None:  # too many: half of the frames have fewer
                half = frames // 2
                first = self.near(lowest[:half], highest[:half], limits, cutoff)
                last = self.near(lowest[half:], highest[half:], limits, cutoff)
                last[0] += half
                return np.concatenate([first, last], axis=1)
            i = pairs.first
            j = pairs.second
            kind = self.kind(i, j)
            limited = (kind >= 0) & (limits[kind] > 0.0)
        i = i[limited]
        j = j[limited]
        kind = kind[limited]
        frame, pair = _are_close(lowest, highest, i, j, cutoff).nonzero()
        near = np.empty((4, len(frame)), dtype=np.intp)
        near[0] = frame
        near[1] = i[pair]
        near[2] = j[pair]
        near[3] = kind[pair]
        return near

    @cached_property
    def all_pairs(self) -> tuple[Indices, Indices, Indices]:
        """Both bodies and the kind of all pairs that may not touch."""
        i, j = np.triu_indices(len(self.nodes), 1)
        kind = self.kind(i, j)
        apart = kind >= 0
        return i[apart], j[apart], kind[apart]


def _are_close(
    lowest: Array, highest: Array, i: Indices, j: Indices, cutoff: float
) -> NDArray[np.bool_]:
    """Return whether boxes i and j (pairs,) with corners (…, bodies, 2) are within ``cutoff``."""
    behind = lowest[..., i, :] - highest[..., j, :]
    ahead = lowest[..., j, :] - highest[..., i, :]
    gaps = np.maximum(behind, ahead)
    x_gap = np.maximum(gaps[..., 0], 0.0)
    y_gap = np.maximum(gaps[..., 1], 0.0)
    close: NDArray[np.bool_] = x_gap * x_gap + y_gap * y_gap <= cutoff * cutoff
    return close


def end_combinations(
    kind: Indices, first: Indices, second: Indices
) -> tuple[Indices, Indices, Indices]:
    """Return (pair, first node, second node) for every combination of ends of two bodies.

    Bodies are separated by as much as all their ends are along a normal. Pairs have kinds (m,) and
    nodes (m, 2) at the ends of their bodies; a drone's are the same.
    """
    ends_of_kind = {
        SEPARATION: [(0, 0)],
        CABLE: [(0, 0), (0, 1)],
        CROSSING: [(0, 0), (0, 1), (1, 0), (1, 1)],
    }
    pairs = list[Indices]()
    first_nodes = list[Indices]()
    second_nodes = list[Indices]()
    for which, combinations in ends_of_kind.items():
        pair = np.flatnonzero(kind == which)
        for first_end, second_end in combinations:
            pairs.append(pair)
            first_nodes.append(first[pair, first_end])
            second_nodes.append(second[pair, second_end])
    return np.concatenate(pairs), np.concatenate(first_nodes), np.concatenate(second_nodes)
