"""Bodies of a taut hitch, and the pairs of them that keep off each other: one table for all rooms.

Checks, leg lengths, the optimiser of paths and corrections in flight read it. Nodes are those of
``Layout.routes``. Bodies are pairs of nodes: all drones (both nodes the same), then the taut cable
parts of ``Layout.parts``. Nothing here asks whether the cables make one ring.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from hitchopt.geometry.broadphase import Boxes, few_close_pairs
from hitchopt.geometry.vectors import dot
from hitchopt.hitch.requirements import Separation
from hitchopt.hitch.team import Layout
from hitchopt.values import Array, Indices

SEPARATION, CABLE, CROSSING = 0, 1, 2
"""Kinds of pairs: drone and drone, drone and cable, cable and cable."""


SWEPT = 20
"""Most pairs per body, counted both ways, that are close in any of the frames looked at at once."""


@dataclass(frozen=True)
class PairRule:
    """The distance that a kind of pairs keeps: limit [m], and how much more heights count."""

    check: str
    limit: Callable[[Separation], float]
    height: Callable[[Separation], float] = lambda _: 1.0


PAIRS = (
    PairRule("separation", lambda s: 2.0 * s.radius, lambda s: s.radius / s.height),
    PairRule("cable_clearance", lambda s: s.cable),
    PairRule("crossing", lambda s: s.crossing),
)
"""The rules by kind."""


def limits_of(separation: Separation) -> Array:
    """Return the smallest distances (3,) [m] by kind."""
    return np.array([rule.limit(separation) for rule in PAIRS])


def scales_of(separation: Separation) -> Array:
    """Return the factors (3, 3) of the axes, by kind, with which distances are measured."""
    return np.array([[1.0, 1.0, rule.height(separation)] for rule in PAIRS])


@dataclass(frozen=True, eq=False)
class Bodies:
    """The bodies of a hitch.

    Attributes
    ----------
    layout: its indices.
    nodes: (bodies, 2), both ends.
    """

    layout: Layout
    nodes: Indices

    @classmethod
    @lru_cache(maxsize=64)
    def of(cls, layout: Layout) -> Bodies:
        """Return the bodies of a hitch."""
        drones = layout.points + np.arange(2 * layout.robots)
        nodes = np.concatenate([np.column_stack([drones, drones]), layout.part_nodes])
        return cls(layout, nodes)

    def of_parts(self, parts: Indices) -> Indices:
        """Return the bodies of cable parts, numbered as in ``Layout.parts``."""
        return 2 * self.layout.robots + np.searchsorted(self.layout.parts, parts)

    def kind(self, i: Indices, j: Indices) -> Indices:
        """Return the kind of each pair of bodies, drones first, or -1 if they are free to touch.

        Free are a drone and the part that ends at it, its leg or else its edge, and parts that meet
        at a clasp.
        """
        layout, drones = self.layout, 2 * self.layout.robots
        i_drone, j_drone = i < drones, j < drones
        on_leg, drone = layout.has_leg.ravel(), np.minimum(i, drones - 1)
        own_end = np.where(on_leg[drone], layout.points + drone, layout.anchors[drone])
        apart = np.all(self.nodes[j] != own_end[:, None], axis=1)
        # Only vertices are clasps.
        (a, b) = (np.where(n < layout.points, n, -1) for n in (self.nodes[i], self.nodes[j]))
        clasped = np.any((a[:, :, None] == b[:, None, :]) & (a[:, :, None] >= 0), axis=(1, 2))
        kind = np.where(i_drone | clasped, -1, CROSSING)
        kind[i_drone & ~j_drone & apart] = CABLE
        kind[i_drone & j_drone] = SEPARATION
        return kind

    def near(self, lowest: Array, highest: Array, limits: Array, cutoff: float) -> Indices:
        """Return (4, pairs): frame, both bodies and kind of pairs whose boxes come near in a frame.

        Parameters
        ----------
        lowest, highest: (J, bodies, 2) [m], opposite corners of the boxes in J frames.
        limits: (3,) [m], distances by kind; pairs of a kind without one are left out.
        cutoff: [m]
        """
        swept, frames = Boxes(np.min(lowest, axis=0), np.max(highest, axis=0)), len(lowest)
        most = SWEPT * len(self.nodes) if frames > 1 else np.inf
        pairs = few_close_pairs(swept, None, cutoff, most)
        if pairs is None:  # fewer are close in half of the frames
            half = frames // 2
            parts = slice(half), slice(half, None)
            first, last = (self.near(lowest[p], highest[p], limits, cutoff) for p in parts)
            last[0] += half
            return np.concatenate([first, last], axis=1)
        kind = self.kind(pairs.first, pairs.second)
        limited = (kind >= 0) & (limits[kind] > 0.0)
        i, j, kind = pairs.first[limited], pairs.second[limited], kind[limited]
        gaps = np.maximum(lowest[:, i] - highest[:, j], lowest[:, j] - highest[:, i])
        apart = np.maximum(gaps, 0.0)
        frame, pair = np.nonzero(dot(apart, apart) <= cutoff * cutoff)
        return np.stack([frame, i[pair], j[pair], kind[pair]])


def end_combinations(
    kind: Indices, first: Indices, second: Indices
) -> tuple[Indices, Indices, Indices]:
    """Return (pair, node of the first, node of the second) of all ends of pairs against all.

    Bodies whose ends all lie on their sides of a normal are apart by as much. Of kinds of pairs
    (m,) and the nodes (m, 2) at the ends of their bodies; a drone's are the same.
    """
    rows: list[tuple[Indices, Indices, Indices]] = []
    for which, ends, other_ends in (
        (SEPARATION, (0,), (0,)),
        (CABLE, (0,), (0, 1)),
        (CROSSING, (0, 1), (0, 1)),
    ):
        pair = np.flatnonzero(kind == which)
        rows += [(pair, first[pair, a], second[pair, b]) for a in ends for b in other_ends]
    pairs, a, b = (np.concatenate(column) for column in zip(*rows, strict=True))
    return pairs, a, b
