"""Which drones and cable parts of a path come near enough to matter, and along which normals."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from hitchopt.geometry import differences, shortest_offset
from hitchopt.geometry.broadphase import Boxes, close_pairs
from hitchopt.hitch.parts import Parts, end_combinations
from hitchopt.requirements import Separation
from hitchopt.values import Array, Indices


@dataclass(frozen=True, eq=False)
class NearPairs:
    """Pairs of bodies that come near one another, each at one of K instants.

    Attributes
    ----------
    frame: (m,), the instant.
    first, second: (m, 2), nodes (of 3n) at the ends of each body; a drone's are the same.
    kind: (m,), as in ``hitch.parts``.
    normal: (m, 2), unit vector from the second body to the first where they are closest.
    enforced: (m,) [m], the distance to enforce.
    """

    frame: Indices
    first: Indices
    second: Indices
    kind: Indices
    normal: Array
    enforced: Array

    def chosen(self, which: NDArray[np.bool_]) -> NearPairs:
        """Return the pairs where ``which`` (m,) holds."""
        return NearPairs(*(getattr(self, field.name)[which] for field in fields(self)))

    def sides(self) -> tuple[Indices, Indices, Indices]:
        """Return (pair, node of the first, node of the second) of all their ends against all.

        Bodies whose ends all lie on their sides of a normal are apart by as much.
        """
        return end_combinations(self.kind, self.first, self.second)


def near_pairs(nodes: Array, separation: Separation, margins: Array, reach: float) -> NearPairs:
    """Return all pairs that come within ``reach`` [m] of the distance to enforce.

    Parameters
    ----------
    nodes: (K, 3n, 2) [m]
    separation: distances to enforce.
    margins: (K,), how many times those.
    reach: [m]
    """
    parts = Parts.of(nodes.shape[1] // 3)
    limits = np.array([2.0 * separation.radius, separation.cable, separation.crossing])
    frame, i, j, kind = _near(nodes, parts, limits, float(np.max(limits * np.max(margins))) + reach)
    ends = [nodes[frame[:, None], parts.nodes[body]] for body in (i, j)]
    offset = shortest_offset(differences(*ends))
    distance = np.linalg.norm(offset, axis=1)
    middle = (ends[0] - ends[1]).mean(axis=1)
    normal = np.where(distance[:, None] > 1e-6, offset, middle)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    enforced = limits[kind] * margins[frame]
    found = NearPairs(frame, parts.nodes[i], parts.nodes[j], kind, normal, enforced)
    return found.chosen(distance < enforced + reach)


def _near(
    nodes: Array, parts: Parts, limits: Array, cutoff: float
) -> tuple[Indices, Indices, Indices, Indices]:
    """Return (instant, body, body, kind) of all pairs whose boxes come near; nodes (K, 3n, 2)."""
    corners = nodes[:, parts.nodes]
    lower, upper = corners.min(axis=2).reshape(-1, 2), corners.max(axis=2).reshape(-1, 2)
    # A third coordinate keeps the instants apart, so that one tree serves them all.
    step = 4.0 * (cutoff + float(np.max(upper) - np.min(lower)))
    level = np.repeat(np.arange(len(nodes)) * step, len(parts.nodes))
    boxes = Boxes(np.column_stack([lower, level]), np.column_stack([upper, level]))
    pairs = close_pairs(boxes, None, cutoff)
    frame, i = np.divmod(pairs.first, len(parts.nodes))
    j = pairs.second % len(parts.nodes)
    kind = parts.kind(i, j)
    wanted = (kind >= 0) & (limits[kind] > 0.0)
    return frame[wanted], i[wanted], j[wanted], kind[wanted]
