"""Pairs of bodies of a hitch that come near one another, with the normals that keep them apart."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from hitchopt.geometry import differences, shortest_offset
from hitchopt.hitch.leg_program import Parts
from hitchopt.hitch.requirements import Separation
from hitchopt.values import Array, Indices


@dataclass(frozen=True, eq=False)
class NearPairs:
    """Pairs of bodies that come near one another, each at one of K instants.

    Attributes
    ----------
    frame: (m,), the instant.
    first, second: (m, 2), nodes (of 3n) at the ends of each body; a drone's are the same.
    kind: (m,), as in ``hitch.leg_program``.
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


def near_pairs(nodes: Array, separation: Separation, margins: Array, reach: Array) -> NearPairs:
    """Return all pairs that come within ``reach`` of the distance to enforce.

    Parameters
    ----------
    nodes: (K, 3n, 2) [m]
    separation: distances to enforce.
    margins: (K,), how many times those.
    reach: (K,) [m]
    """
    parts = Parts.of(nodes.shape[1] // 3)
    limits = np.array([2.0 * separation.radius, separation.cable, separation.crossing])
    corners = nodes[:, parts.nodes]
    cutoff = float(np.max(limits * np.max(margins)) + np.max(reach))
    boxes = corners.min(axis=2), corners.max(axis=2)
    frame, i, j, kind = parts.near(*boxes, limits, cutoff)
    ends = [nodes[frame[:, None], parts.nodes[body]] for body in (i, j)]
    offset = shortest_offset(differences(*ends))
    distance = np.linalg.norm(offset, axis=1)
    middle = (ends[0] - ends[1]).mean(axis=1)
    normal = np.where(distance[:, None] > 1e-6, offset, middle)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    enforced = limits[kind] * margins[frame]
    found = NearPairs(frame, parts.nodes[i], parts.nodes[j], kind, normal, enforced)
    return found.chosen(distance < enforced + reach[frame])
