"""Energy of a hitch whose drones give way: its nodes, spans and cables, and its minimum.

Nodes are the drones q0, r0, q1, …, then the clasps. Every cable runs over four of them, drone,
clasp, clasp, drone. Where a chain's end has no leg the drone stands in for the clasp as well, and
the span between the two is left out.

Clasps are without friction. A hanging span with chord v, of length s and level length h, and with
the tension m at the height of its chord's middle, costs the energy ``∫ (tension) ds``; to the
second order in its weight w over m

    E(v, m) = m s - w² s h²/(24 m).

Its slope by m is its arc length ``s + w² s h²/(24 m²)``, its slope by v the force on its ends but
for half of its weight. Tension grows with height: ``m = T + w (z - z₀)``, z the height of the
chord's middle, with one T for all spans of a cable. With the cable's length L and its stretch ``a
(T - T₀)`` the energy of a cable is the maximum over T of

    Σ E(v, m) - T L - a (T - T₀)²/2;

at the maximum arcs and stretch make up the length. The next order is ``7 (w s/m)⁴ m s/1920``, and
nothing where spans hang by less than a tenth of their chord. T is at least the tension at which the
cable is slack; below that tension arcs are taken to be constant.

Drones of stiffness k add ``½ k |x - x_set|² - F·x``, loads ``-w·x``. Newton's method finds the
minimum for many samples at once. The Hessian is exact and sparse; a diagonal is added where a step
does not descend, and steps are shortened until the energy falls enough (Armijo). Where cables weigh
nothing the energy is convex, so that the minimum is global.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csc_array
from scipy.sparse.linalg import SuperLU, splu

from hitchopt.hitch import Team
from hitchopt.values import Array

Index = NDArray[np.intp]

INCIDENCE = np.array([[-1.0, 1.0, 0.0, 0.0], [0.0, -1.0, 1.0, 0.0], [0.0, 0.0, -1.0, 1.0]])
"""(3, 4): each span of a cable from one of its nodes to the next."""

MIDDLES = 0.5 * np.abs(INCIDENCE)
"""(3, 4): the middle of each span."""


def add_at_nodes(totals: Array, nodes: Index, added: Array) -> None:
    """Add values (S, *k, …) to those of the nodes (*k) in totals (S, nodes, …); nodes may recur."""
    np.add.at(totals.swapaxes(0, 1), nodes, np.moveaxis(added, 0, nodes.ndim))


@dataclass(frozen=True, eq=False)
class Rigging:
    """Nodes and spans of a team, and which nodes give way.

    Attributes
    ----------
    drones: number 2n of drones, the first nodes.
    clasps: (c,), the points that are clasps; their nodes follow.
    nodes: (n, 4), nodes that each cable runs over.
    spans: (n, 3), whether q-leg, edge and r-leg exist.
    free: (2n + c,), whether a node moves: clasps, and drones that are not held in place.
    points: (points,), the node at each point.
    """

    drones: int
    clasps: Index
    nodes: Index
    spans: NDArray[np.bool_]
    free: NDArray[np.bool_]
    points: Index

    @classmethod
    def of(cls, team: Team, held: NDArray[np.bool_]) -> Rigging:
        """Return the rigging of a team whose drones (2n,) are held in place or give way."""
        layout, n = team.layout, team.robots
        points = np.zeros(layout.points, dtype=np.intp)
        points[layout.clasps] = 2 * n + np.arange(len(layout.clasps))
        for point, drone in ((0, 0), (layout.points - 1, 2 * n - 1)) if not layout.closed else ():
            points[point] = drone
        cables = np.arange(n)
        nodes = np.column_stack(
            [2 * cables, points[layout.starts], points[layout.ends], 2 * cables + 1]
        )
        spans = np.column_stack([layout.has_leg[:, 0], np.ones(n, np.bool_), layout.has_leg[:, 1]])
        free = np.concatenate([~held, np.ones(len(layout.clasps), np.bool_)])
        return cls(2 * n, layout.clasps, nodes, spans, free, points)

    @property
    def count(self) -> int:
        """Number of nodes."""
        return len(self.free)

    @cached_property
    def unknowns(self) -> Index:
        """(m,): indices of the coordinates that move, in an array (nodes, 3) that is flattened."""
        return np.flatnonzero(np.repeat(self.free, 3))

    @cached_property
    def _pattern(self) -> tuple[Index, Index, csc_array]:
        """Rows and columns of the entries of a Hessian, and the sum of blocks into entries."""
        coordinates = (3 * self.nodes[:, :, None] + np.arange(3)).reshape(-1, 12)
        rows = np.concatenate(
            [np.repeat(coordinates, 12, axis=1).ravel(), np.arange(3 * self.count)]
        )
        columns = np.concatenate([np.tile(coordinates, 12).ravel(), np.arange(3 * self.count)])
        keys, place = np.unique(columns * (3 * self.count) + rows, return_inverse=True)
        shape = (len(keys), len(rows))
        total = coo_array((np.ones(len(rows)), (place, np.arange(len(rows)))), shape=shape)
        return keys % (3 * self.count), keys // (3 * self.count), csc_array(total)

    def matrix(self, blocks: Array, diagonal: Array) -> csc_array:
        """Return the block-diagonal matrix (S N, S N) of the Hessians of S samples, N = 3 nodes.

        Parameters
        ----------
        blocks: (S, n, 12, 12), one per cable and its four nodes.
        diagonal: (S, N), added to it.
        """
        rows, columns, total = self._pattern
        samples, size = len(blocks), 3 * self.count
        parts = np.concatenate([blocks.reshape(samples, -1), diagonal], axis=1)
        values = (total @ parts.T).T
        shift = size * np.arange(samples)[:, None]
        places = ((rows + shift).ravel(), (columns + shift).ravel())
        return csc_array((values.ravel(), places), shape=(samples * size, samples * size))

    def factor(self, blocks: Array, diagonal: Array) -> Factor:
        """Return the factors of the Hessians in the coordinates that move."""
        samples, size = len(blocks), 3 * self.count
        moving = (self.unknowns + size * np.arange(samples)[:, None]).ravel()
        inner = self.matrix(blocks, diagonal)[moving][:, moving]
        # Symmetric and all but positive definite: the diagonal serves as pivots.
        factors = splu(
            csc_array(inner),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )
        return Factor(self, samples, factors)


@dataclass(frozen=True, eq=False)
class Factor:
    """Factors of the Hessians of some samples."""

    rigging: Rigging
    samples: int
    factors: SuperLU

    def solve(self, forces: Array) -> Array:
        """Return the displacements that forces (S, nodes, 3, …) cause, of the same shape."""
        shape = forces.shape
        unknowns = self.rigging.unknowns
        flat = forces.reshape(self.samples, 3 * self.rigging.count, -1)
        right = np.ascontiguousarray(flat[:, unknowns].reshape(-1, flat.shape[-1]))
        found = np.zeros(flat.shape)
        solved = self.factors.solve(right)
        found[:, unknowns] = solved.reshape(self.samples, len(unknowns), -1)
        return found.reshape(shape)


NEWTON = 60
"""Number of Newton iterations for T; from below they rise by half at least, then converge
quadratically."""

CONVERGED = 1e-11
"""Relative step that ends the iteration: the next one would be the square of it."""

BEGINNING = 1e-9
"""Rounding of the tension at which a span begins to be taut, over that tension."""

SAG_RATIO = 4.0
"""A cable is slack where a level span as long as its longest one would hang by more than its chord
over this number."""

LEVEL = np.array([1.0, 1.0, 0.0])
"""Level part of a vector."""


def least_tension(weight: float, chords: Array) -> Array:
    """Return (…, n) [N] the tension at which the longest span hangs by its chord over SAG_RATIO.

    Parameters
    ----------
    weight: of the cables per length [N/m].
    chords: (…, n, 3) [m], of the spans.
    """
    least: Array = weight * SAG_RATIO / 8.0 * np.max(chords, axis=-1)
    return least


@dataclass(frozen=True, eq=False)
class Spans:
    """Spans of cables.

    Attributes
    ----------
    vectors: (…, n, 3, 3) [m], from end to end; zero where a chain's end has no leg.
    middles: (…, n, 3) [m], heights of their middles.
    chords: (…, n, 3) [m], lengths.
    directions: (…, n, 3, 3), zero where there is no length.
    bulges: (…, n, 3) [m³], ``s h²``.
    """

    vectors: Array
    middles: Array
    chords: Array
    directions: Array
    bulges: Array

    @classmethod
    def between(cls, ends: Array, exist: NDArray[np.bool_]) -> Spans:
        """Return the spans between the four nodes (…, n, 4, 3) [m] of cables.

        Parameters
        ----------
        exist: (n, 3), which of them there are.
        """
        vectors = np.where(exist[..., None], np.diff(ends, axis=-2), 0.0)
        chords = np.linalg.norm(vectors, axis=-1)
        directions = vectors / np.where(chords > 0.0, chords, 1.0)[..., None]
        middles = 0.5 * (ends[..., 1:, 2] + ends[..., :-1, 2])
        level = np.sum(vectors[..., :2] ** 2, axis=-1)
        return cls(vectors, middles, chords, directions, chords * level)

    @property
    def bulge_slopes(self) -> Array:
        """(…, n, 3, 3) [m²]: slopes of the bulges by the vectors."""
        level = np.sum(self.vectors[..., :2] ** 2, axis=-1)[..., None]
        return np.asarray(
            level * self.directions + 2.0 * self.chords[..., None] * self.vectors * LEVEL
        )

    def curvatures(self, tensions: Array, sagging: Array) -> Array:
        """Return (…, n, 3, 3, 3): second derivatives by the vectors.

        Parameters
        ----------
        tensions, sagging: (…, n, 3), factors of the chords and of the bulges.
        """
        u, v = self.directions, self.vectors * LEVEL
        across = np.eye(3) - u[..., :, None] * u[..., None, :]
        across /= np.where(self.chords > 0.0, self.chords, np.inf)[..., None, None]
        mixed = u[..., :, None] * v[..., None, :]
        level = np.sum(self.vectors[..., :2] ** 2, axis=-1)
        found = (tensions + sagging * level)[..., None, None] * across
        found += 2.0 * sagging[..., None, None] * (mixed + np.swapaxes(mixed, -1, -2))
        found += 2.0 * (sagging * self.chords)[..., None, None] * np.diag(LEVEL)
        return np.asarray(found)


@dataclass(frozen=True, eq=False)
class CableLaw:
    """Lengths, weight and stretch of cables (…, n).

    Attributes
    ----------
    lengths: (…, n) [m], L at the tension T₀.
    weight: per length [N/m].
    compliance: (n,) [m/N], a: what a cable grows by per tension.
    reference: (…, n) [N], T₀.
    heights: (…, n) [m], z₀.
    least: (…, n) [N], tension at which a cable is slack.
    """

    lengths: Array
    weight: float
    compliance: Array
    reference: Array
    heights: Array
    least: Array

    def tensions(self, spans: Spans) -> Array:
        """Return T (…, n) [N]."""
        a = self.compliance
        spare = np.sum(spans.chords, axis=-1) - self.lengths + a * self.reference
        if self.weight == 0.0:
            return np.asarray(np.maximum(self.least, spare / a))
        # The excess of length falls with T. It is convex but where a span begins to pull with more
        # than the least tension: from the last such T at which there is an excess, Newton's method
        # rises to the solution.
        T = np.maximum(self.least, np.maximum(spare / a, 0.0))
        c = self.weight**2 / 24.0

        def excess(T: Array) -> tuple[Array, Array]:
            """Return the excess of length and how much it falls with T."""
            m, least = self.middle_tensions(spans, T), self.least[..., None]
            held = np.maximum(m, least)
            arcs = c * spans.bulges / held**2
            falling = np.where(m >= (1.0 - BEGINNING) * least, 2.0 * arcs / held, 0.0)
            return spare - a * T + np.sum(arcs, axis=-1), a + np.sum(falling, axis=-1)

        begins = self.least[..., None] + self.weight * (self.heights[..., None] - spans.middles)
        for begin in np.moveaxis(begins, -1, 0):
            if np.any(begin > T):
                T = np.where((begin > T) & (excess(begin)[0] >= 0.0), begin, T)
        for _ in range(NEWTON):
            over, fall = excess(T)
            step: Array = np.maximum(over, 0.0) / fall
            T = T + step
            if np.all(step <= CONVERGED * T):
                break
        return np.asarray(T)

    def slack(self, tensions: Array) -> NDArray[np.bool_]:
        """Return (…, n) whether cables of these tensions [N] are slack."""
        return np.asarray(tensions <= self.least)

    def hanging(self, spans: Spans, tensions: Array) -> NDArray[np.bool_]:
        """Return (…, n) whether cables of these tensions [N] are slack, or hang as slack ones do.

        A span that has come down pulls with less than T: it hangs by its chord over SAG_RATIO where
        its own tension is ``SAG_RATIO w s/8``.
        """
        m = self.middle_tensions(spans, tensions)
        deep = 8.0 * m < SAG_RATIO * self.weight * spans.chords
        return np.asarray(self.slack(tensions) | np.any(deep, axis=-1))

    def middle_tensions(self, spans: Spans, tensions: Array) -> Array:
        """Return m (…, n, 3) [N] at the heights of the spans' middles."""
        higher = spans.middles - self.heights[..., None]
        found: Array = tensions[..., None] + self.weight * higher
        return found

    def energies(self, spans: Spans, tensions: Array) -> Array:
        """Return (…, n) [J], but for a constant; T is that of ``tensions``."""
        m = self.middle_tensions(spans, tensions)
        hanging = m * spans.chords + self._factors(m)[0] * spans.bulges
        stretch = 0.5 * self.compliance * (tensions - self.reference) ** 2
        energies: Array = np.sum(hanging, axis=-1) - tensions * self.lengths - stretch
        return energies

    def pulls(self, spans: Spans, tensions: Array) -> Array:
        """Return (…, n, 3, 3) [N]: slopes of the energy by the spans' vectors."""
        m = self.middle_tensions(spans, tensions)
        sagging = self._factors(m)[0][..., None] * spans.bulge_slopes
        return np.asarray(m[..., None] * spans.directions + sagging)

    def weights(self, spans: Spans, tensions: Array) -> Array:
        """Return (…, n, 3) [N] the weights of the spans: slopes of the energy by their heights."""
        return np.asarray(self.weight * (spans.chords + self.arcs(spans, tensions)))

    def arcs(self, spans: Spans, tensions: Array) -> Array:
        """Return (…, n, 3) [m]: what arcs are longer than their chords."""
        m = self.middle_tensions(spans, tensions)
        return np.asarray(self._factors(m)[1] * spans.bulges)

    def softness(self, spans: Spans, tensions: Array) -> Array:
        """Return (…, n) [m/N]: what a cable gives per tension, by stretch and by less sag."""
        m = self.middle_tensions(spans, tensions)
        sag = np.sum(self._factors(m)[2] * spans.bulges, axis=-1)
        return np.asarray(self.compliance - sag)

    def length_slopes(self, spans: Spans, tensions: Array) -> Array:
        """Return (…, n) [N/m]: what T loses per length that the cable is longer."""
        return np.where(self.slack(tensions), 0.0, 1.0 / self.softness(spans, tensions))

    def arc_slopes(self, spans: Spans, tensions: Array) -> tuple[Array, Array]:
        """Return the slopes of the arc lengths by vectors (…, n, 3, 3) and heights (…, n, 3)."""
        _, second, third = self._factors(self.middle_tensions(spans, tensions))
        by_vectors = spans.directions + second[..., None] * spans.bulge_slopes
        return by_vectors, self.weight * third * spans.bulges

    def curvatures(self, spans: Spans, tensions: Array) -> Array:
        """Return (…, n, 3, 3, 3) [N/m]: second derivatives by the vectors at constant T."""
        m = self.middle_tensions(spans, tensions)
        return spans.curvatures(m, self._factors(m)[0])

    def _factors(self, m: Array) -> tuple[Array, Array, Array]:
        """Return the factors of the bulges in energy, arc length, and its slope by m."""
        if self.weight == 0.0:
            return (np.zeros_like(m),) * 3
        c = self.weight**2 / 24.0
        held = np.maximum(m, self.least[..., None])
        inside = np.where(m > self.least[..., None], -2.0 * c / held**3, 0.0)
        return c * (-1.0 / held + (m - held) / held**2), c / held**2, inside


@dataclass(frozen=True, eq=False)
class HitchEnergy:
    """The energy of S samples of a hitch.

    Attributes
    ----------
    rigging: nodes and spans.
    law: of the cables, (S, n) where it says (…, n).
    places: (S, 2n, 3) [m], where drones are led.
    stiffness: (2n,) [N/m], finite for those that give way.
    forces: (S, nodes, 3) [N], of feed-forward on drones and of loads on clasps.
    """

    rigging: Rigging
    law: CableLaw
    places: Array
    stiffness: Array
    forces: Array

    def spans(self, x: Array) -> Spans:
        """Return the spans between nodes x (S, nodes, 3) [m]."""
        return Spans.between(x[:, self.rigging.nodes], self.rigging.spans)

    def values(self, x: Array) -> Array:
        """Return the energies (S,) [J]."""
        spans = self.spans(x)
        cables = np.sum(self.law.energies(spans, self.law.tensions(spans)), axis=-1)
        away = x[:, : self.rigging.drones] - self.places
        drones = 0.5 * np.einsum("sdi,d,sdi->s", away, self._soft, away)
        values: Array = cables + drones - np.einsum("sni,sni->s", self.forces, x)
        return values

    def slopes(self, x: Array) -> Array:
        """Return the slopes (S, nodes, 3) [N]: minus the force on every node."""
        spans = self.spans(x)
        T = self.law.tensions(spans)
        at_ends = np.einsum("pa,snpi->snai", INCIDENCE, self.law.pulls(spans, T))
        at_ends[..., 2] += self.law.weights(spans, T) @ MIDDLES
        slopes: Array = -self.forces.copy()
        add_at_nodes(slopes, self.rigging.nodes, at_ends)
        away = x[:, : self.rigging.drones] - self.places
        slopes[:, : self.rigging.drones] += self._soft[:, None] * away
        return slopes

    def length_slopes(self, spans: Spans, tensions: Array) -> Array:
        """Return (S, n, 4, 3): slopes of the cables' arc lengths by their four nodes."""
        by_vectors, by_heights = self.law.arc_slopes(spans, tensions)
        slopes = np.einsum("pa,snpi->snai", INCIDENCE, by_vectors)
        slopes[..., 2] += by_heights @ MIDDLES
        return np.asarray(slopes)

    def blocks(self, x: Array) -> Array:
        """Return (S, n, 12, 12) [N/m]: each cable's share of the Hessian, at its four nodes."""
        spans, law = self.spans(x), self.law
        T = law.tensions(spans)
        inner = np.zeros((*T.shape, 3, 3, 3, 3))
        own = np.arange(3)
        inner[:, :, own, :, own, :] = np.moveaxis(law.curvatures(spans, T), 2, 0)
        blocks = _by_ends(_by_ends(inner, 2), 4)
        if law.weight > 0.0:  # forces grow with height, and weights with arcs
            by_vectors, by_heights = law.arc_slopes(spans, T)
            lift = law.weight * np.einsum("pa,snpi,pb->snaib", INCIDENCE, by_vectors, MIDDLES)
            blocks[..., 2] += lift
            blocks[:, :, :, 2] += np.einsum("snbja->snabj", lift)
            higher = law.weight * np.einsum("pa,snp,pb->snab", MIDDLES, by_heights, MIDDLES)
            blocks[:, :, :, 2, :, 2] += higher
        longer = self.length_slopes(spans, T)
        stiff = law.length_slopes(spans, T)[..., None, None, None, None]
        blocks += stiff * longer[..., :, :, None, None] * longer[:, :, None, None]
        return np.asarray(blocks.reshape(*T.shape, 12, 12))

    @property
    def diagonal(self) -> Array:
        """(3 nodes,) [N/m]: what the drones' stiffness adds to the Hessian."""
        diagonal = np.zeros(3 * self.rigging.count)
        diagonal[: 3 * self.rigging.drones] = np.repeat(self._soft, 3)
        return diagonal

    @property
    def _soft(self) -> Array:
        free = self.rigging.free[: self.rigging.drones]
        return np.where(free, np.where(free, self.stiffness, 1.0), 0.0)


def _by_ends(values: Array, axis: int) -> Array:
    """Return what derivatives by three spans are by their four ends, along ``axis``: INCIDENCEᵀ."""
    wide = [(0, 0)] * values.ndim
    wide[axis] = (1, 1)
    return np.asarray(-np.diff(np.pad(values, wide), axis=axis))


SMALL_FORCE = 1e-11
"""[N] Forces this small on every node end the iteration."""

ROUNDED_FORCE = 16.0 * float(np.finfo(np.float64).eps)
"""Forces end it as well that are this small over the cables' stiffness times the coordinates."""

LEAST_STIFFNESS = 1e-9
"""[N/m] Added to the Hessian's diagonal: slack cables hold their clasps by nothing."""

NEWTON_STEPS = 200
"""Number of Newton iterations; warm starts take 5 to 30."""

HALVINGS = 30
"""Number of times that a step is halved before damping is raised."""

LEAST_DAMPING, MOST_DAMPING = 1e-9, 1e6
"""[N/m] Range of the damping: clasps of slack cables have no stiffness of their own."""

FIRST_DAMPING = 1e-3
"""[N/m] Damping after the first step that does not descend."""

DESCENT = 1e-4
"""Share of the linear decrease that a step must bring (Armijo)."""

ROUNDING = 1e-14
"""Relative rounding of the energies, by which they may rise."""

LONGEST_STEP = 0.3
"""[m] Longest step of a node: directions change beyond it."""


def settled_nodes(energy: HitchEnergy, start: Array) -> Array:
    """Return the nodes (S, nodes, 3) [m] of least energy; the caller recomputes the residuals.

    Parameters
    ----------
    energy: of S samples.
    start: (S, nodes, 3) [m], where held drones are, and guesses for the other nodes.
    """
    x = start.copy()
    free = energy.rigging.free[:, None]
    damping = np.full(len(x), LEAST_DAMPING)
    values = energy.values(x)
    stiffest = 1.0 / np.min(energy.law.compliance)
    small = SMALL_FORCE + ROUNDED_FORCE * stiffest * np.max(np.abs(x), axis=(1, 2))
    for _ in range(NEWTON_STEPS):
        slopes = np.where(free, energy.slopes(x), 0.0)
        active = np.max(np.abs(slopes), axis=(1, 2)) > small
        if not active.any():
            break
        added = energy.diagonal + damping[:, None]
        factor = energy.rigging.factor(energy.blocks(x), added)
        steps = -factor.solve(slopes)
        longest = np.max(np.linalg.norm(steps, axis=-1), axis=1)
        steps *= np.minimum(1.0, LONGEST_STEP / np.maximum(longest, 1e-300))[:, None, None]
        falls = np.einsum("sni,sni->s", steps, slopes)
        share = np.where(active & (falls < 0.0), 1.0, 0.0)
        found, reached = x, values
        pending = share > 0.0
        for _ in range(HALVINGS):
            if not pending.any():
                break
            tried = x + share[:, None, None] * steps
            energies = energy.values(tried)
            allowed = values + DESCENT * share * falls + ROUNDING * (1.0 + np.abs(values))
            good = pending & (energies <= allowed)
            found = np.where(good[:, None, None], tried, found)
            reached = np.where(good, energies, reached)
            pending &= ~good
            share = np.where(pending, 0.5 * share, share)
        failed = active & ((falls >= 0.0) | pending)
        raised = np.maximum(10.0 * damping, FIRST_DAMPING)
        damping = np.where(failed, raised, np.maximum(0.1 * damping, LEAST_DAMPING))
        damping = np.minimum(damping, MOST_DAMPING)
        x, values = found, reached
    return x
