"""The stiffness of yaw of a section that edges and legs hold."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from hitchopt.geometry.vectors import dot
from hitchopt.values import Array

MIN_STIFFNESS = 1e-9  # Added stiffness of moves over the largest one, with which they are unique


class YawTerms(NamedTuple):
    """Second derivatives of the energy of edges and legs at constant tension, seen from above.

    A section turns by an angle and moves, with its clasps, between drones at rest. Straight parts
    of edges, from a contact c about the centroid to a clasp, have the direction u, the normal m
    and the length d. The turn lengthens them in second order by ``(u·c) (1 + u·c/d) / 2``. Its
    energy, less what clasps and section yield, is the stiffness of yaw. If it is negative, the
    section turns away: edges pull it about its corners until it sticks out between the clasps.
    """

    turns: Array  # (…, n, 2) [N m], by the turn: ``T (u·c) (1 + u·c/d)``
    # (…, n, 2, 2) [N], by the turn and the move of a clasp from the section: ``-T m (u·c)/d``
    both: Array
    parts: Array  # (…, n, 2, 2, 2) [N/m], by that move: ``T m m'/d``
    legs: Array  # (…, n, 2, 2, 2) [N/m], by the move of a clasp: the same for legs

    def matrix(self, moves: Array) -> Array:
        """Return the second derivatives (…, 2n + 3, 2n + 3) by the turn, then by moves.

        ``moves`` (n, 2, 2, 2n + 2) are those of clasps from the section, at the ends of edges, by
        those of the section and of clasps.
        """
        of_clasps = np.concatenate([np.zeros_like(moves[..., :2]), moves[..., 2:]], axis=-1)
        by_moves = np.einsum("keai,...keab,kebj->...ij", moves, self.parts, moves)
        by_moves += np.einsum("keai,...keab,kebj->...ij", of_clasps, self.legs, of_clasps)
        by_both = np.einsum("...kea,keai->...i", self.both, moves)[..., None]
        by_turn = np.sum(self.turns, axis=(-2, -1))[..., None, None]
        first = np.concatenate([by_turn, np.swapaxes(by_both, -2, -1)], axis=-1)
        others = np.concatenate([by_both, by_moves], axis=-1)
        return np.concatenate([first, others], axis=-2)


@lru_cache
def moves_of_ends(n: int) -> Array:
    """Return the moves of ``YawTerms.matrix`` for n clasps."""
    moves = np.zeros((n, 2, 2, 2 * n + 2))
    moves[..., :2] = -np.eye(2)
    for k, end in np.ndindex(n, 2):
        clasp = (k + end) % n
        moves[k, end, :, 2 + 2 * clasp : 4 + 2 * clasp] = np.eye(2)
    return moves


def stiffness_of_turn(matrix: Array) -> Array:
    """Return the stiffness (…) of the first coordinate where the others yield freely.

    ``matrix`` (…, m, m) are second derivatives, positive definite by the others.
    """
    of_moves = matrix[..., 1:, 1:]
    largest = np.max(np.abs(of_moves), axis=(-2, -1))[..., None, None]
    unique = of_moves + MIN_STIFFNESS * largest * np.eye(of_moves.shape[-1])
    moved = np.linalg.solve(unique, matrix[..., 1:, :1])[..., 0]
    return np.asarray(matrix[..., 0, 0] - dot(matrix[..., 0, 1:], moved))


def least_stiffness_of_turn(terms: YawTerms, errors: YawTerms) -> Array:
    """Return the lower bound (…) of ``stiffness_of_turn`` for terms with errors.

    A symmetric error is at most the diagonal of the sums of its rows. The bound is minus infinity
    where moves may be unstable.
    """
    moves = moves_of_ends(terms.turns.shape[-2])
    sums = np.sum(errors.matrix(np.abs(moves)), axis=-1)
    lowest = terms.matrix(moves) - sums[..., None] * np.eye(sums.shape[-1])
    is_stable = np.linalg.eigvalsh(lowest[..., 1:, 1:])[..., 0] > 0.0
    stable = np.where(is_stable[..., None, None], lowest, np.eye(sums.shape[-1]))
    return np.where(is_stable, stiffness_of_turn(stable), -np.inf)


# Balance of clasps.
