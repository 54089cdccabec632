"""The law of cables between drones that give way, and where their energy is least.

Nodes are the drones q0, r0, q1, …, then the clasps. Every cable runs over four of them, drone,
clasp, clasp, drone. Where a chain's end has no leg the drone stands in for the clasp as well, and
the span between the two is left out.

A hanging span with chord v, of length s and level length h, and with the tension m at the height
of its chord's middle, costs the energy ``∫ (tension) ds``; to the second order in its weight w over
m that is ``E(v, m) = m s - w² s h²/(24 m)``. Its slope by m is its arc length ``s + w² s h²/(24
m²)``, its slope by v the force on its ends but for half of its weight. Tension grows with height:
``m = T + w (z - z₀)``, z the height of the chord's middle, with one T for all spans of a cable.
With the cable's length L and its stretch ``a (T - T₀)`` the energy of a cable is the maximum over T
of ``Σ E(v, m) - T L - a (T - T₀)²/2``: there arcs and stretch make up the length. T is at least the
tension at which the cable is slack; below that tension arcs are constant.

Drones of stiffness k add ``½ k |x - x_set|² - F·x``, loads ``-w·x``. Where cables weigh nothing the
energy is convex, so that its minimum is global. With friction at the clasps legs pull with
``e^{μθ}`` times what edges do, θ the angle of the bend: forces balance, but there is no energy.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csc_array
from scipy.sparse.linalg import splu

from hitchopt.hitch import Team
from hitchopt.hitch.team import Index
from hitchopt.values import Array

SAG_RATIO = 4.0
"""A cable is slack where a level span as long as its longest one would hang by more than its chord
over this number."""

CONVERGED, CABLE_STEPS = 1e-12, 100
"""Relative step at which a cable's tension is found, and number of steps at most."""

IMAGINARY = 1e-30
"""[m], [N] Imaginary step by which derivatives are taken: exact to rounding."""

SMALL_FORCE = 1e-11
"""[N] Forces this small on every node end the iteration."""

ROUNDED_FORCE = 16.0 * float(np.finfo(np.float64).eps)
"""Forces end it as well that are this small over the cables' stiffness times the coordinates."""

LEAST_STIFFNESS = 1e-9
"""[N/m] Added to the Hessian's diagonal: slack cables hold their clasps by nothing."""

NEWTON_STEPS, HALVINGS = 200, 30
"""Number of Newton steps (5 to 30 are usual), and of times that one is halved."""

FIRST_DAMPING, MOST_DAMPING = 1e-3, 1e6
"""[N/m] Damping after the first step that does not descend, and the largest one."""

DESCENT, ROUNDING = 1e-4, 1e-14
"""Share of the linear decrease that a step must bring (Armijo), and rounding of the energies."""

LONGEST_STEP = 0.3
"""[m] Longest step of a node: directions change beyond it."""

SHARES = np.linspace(0.1, 1.0, 10)
"""Shares of the friction at which the hitch settles on its way to an end of its band."""

BAND_STEPS, LARGEST_FORCE, LONGEST_BAND_STEP = 20, 1e-7, 0.1
"""Number of Newton steps at each of them (three to five are usual), the largest force without
balance [N] but for rounding of stiff cables, and the longest step of a node [m]."""


@dataclass(frozen=True, eq=False)
class Cables:
    """Lengths, weight and stretch of the cables (S, n) of S samples.

    Attributes
    ----------
    exist: (n, 3), whether q-leg, edge and r-leg exist.
    lengths: (S, n) [m], L at the tension T₀.
    weight: per length [N/m].
    compliance: (n,) [m/N], a: what a cable grows by per tension.
    reference: (S, n) [N], T₀.
    heights: (S, n) [m], z₀.
    least: (S, n) [N], tension at which a cable is slack.
    """

    exist: NDArray[np.bool_]
    lengths: Array
    weight: float
    compliance: Array
    reference: Array
    heights: Array
    least: Array

    def spans(self, ends: Any) -> tuple[Any, Any, Any]:
        """Return the chords (…, S, n, 3, 3) between nodes (…, S, n, 4, 3), lengths and heights [m].

        Heights (…, 3) are those of the middles, over z₀.
        """
        chords = np.where(self.exist[..., None], np.diff(ends, axis=-2), 0.0)
        sizes = np.sqrt(np.sum(chords * chords, axis=-1))
        middles = 0.5 * (ends[..., 1:, 2] + ends[..., :-1, 2])
        return chords, sizes, middles - self.heights[..., None]

    def forces(self, ends: Any, T: Any, friction: Any = 0.0) -> tuple[Any, Any, Any]:
        """Return what cables of tensions T pull their nodes with, turned round, and more.

        Parameters
        ----------
        ends: (…, S, n, 4, 3) [m], nodes of each cable; real or complex.
        T: (…, S, n) [N], likewise.
        friction: that is used, of all legs or of each (…, S, n, 2); positive where legs pull more
            than edges, negative where they pull less.

        Returns
        -------
        forces: (…, S, n, 4, 3) [N], slopes of the energy by the nodes where there is no friction.
        arcs: (…, S, n) [m], lengths of the cables.
        energies: (…, S, n) [J], but for a constant and for friction.
        """
        chords, sizes, heights = self.spans(ends)
        units = chords / np.where(sizes.real > 0.0, sizes, 1.0)[..., None]
        m = T[..., None] + self.weight * heights
        sag = self._sag(m)
        bent = -sag * (2.0 * self._held(m) - m)  # slope of the energy by s h²
        level = chords[..., 0] ** 2 + chords[..., 1] ** 2
        pulls = (m + bent * level)[..., None] * units
        pulls[..., :2] += (2.0 * bent * sizes)[..., None] * chords[..., :2]
        arcs = sizes * (1.0 + sag * level)
        stretched = T - self.reference
        energies = np.sum(sizes * (m + bent * level), axis=-1) - T * self.lengths
        energies = energies - 0.5 * self.compliance * stretched * stretched
        if np.any(friction):
            pulls[..., 0::2, :] *= np.exp(friction * bends_of(units))[..., None]
        forces = np.zeros(ends.shape, dtype=pulls.dtype)
        forces[..., 1:, :] += pulls
        forces[..., :-1, :] -= pulls
        forces[..., 1:, 2] += 0.5 * self.weight * arcs
        forces[..., :-1, 2] += 0.5 * self.weight * arcs
        return forces, np.sum(arcs, axis=-1), energies

    def tensions(self, ends: Array) -> Array:
        """Return the T (S, n) [N] at which cables over nodes (S, n, 4, 3) have their lengths."""
        chords, sizes, heights = self.spans(ends)
        a = self.compliance
        spare = np.sum(sizes, axis=-1) - self.lengths + a * self.reference
        if self.weight == 0.0:
            return np.asarray(np.maximum(self.least, spare / a))
        bulges = sizes * (chords[..., 0] ** 2 + chords[..., 1] ** 2)

        def excess(T: Array) -> tuple[Array, Array]:
            """Return the excess of length, and how much it falls with T."""
            m = T[..., None] + self.weight * heights
            arcs = self._sag(m) * bulges
            falls = np.where(m > self.least[..., None], 2.0 * arcs / self._held(m), 0.0)
            return spare - a * T + np.sum(arcs, axis=-1), a + np.sum(falls, axis=-1)

        T = np.maximum(self.least, spare / a)
        low, high = self.least, T + np.maximum(excess(T)[0], 0.0) / a
        for _ in range(CABLE_STEPS):  # Newton's method within a bracket
            over, fall = excess(T)
            low, high = np.where(over > 0.0, T, low), np.where(over > 0.0, high, T)
            step = over / fall
            done = (np.abs(step) <= CONVERGED * T) | ((over <= 0.0) & (self.least >= T))
            inside = (T + step > low) & (T + step < high)
            T = np.where(done, T, np.where(inside, T + step, np.sqrt(low * high)))
            if np.all(done):
                break
        return np.asarray(T)

    def hanging(self, ends: Array, T: Array) -> NDArray[np.bool_]:
        """Return (S, n) whether cables are slack, or one of their spans hangs as slack ones do.

        A span that has come down pulls with less than T: it hangs by its chord over SAG_RATIO where
        its own tension is ``SAG_RATIO w s/8``.
        """
        _, sizes, heights = self.spans(ends)
        m = T[..., None] + self.weight * heights
        deep = 8.0 * m < SAG_RATIO * self.weight * sizes
        return np.asarray((self.least >= T) | np.any(deep, axis=-1))

    def _held(self, m: Any) -> Any:
        return np.where(m.real > self.least[..., None], m, self.least[..., None])

    def _sag(self, m: Any) -> Any:
        """Return the slope of arcs by s h² for tensions m (…, 3) [N]."""
        held = self._held(m)
        return self.weight**2 / 24.0 / np.where(held.real > 0.0, held, 1.0) ** 2


def bends_of(units: Any) -> Any:
    """Return the angles (…, 2) [rad] between spans of directions (…, 3, 3), at both clasps."""
    cosines = np.sum(units[..., 1:, :] * units[..., :-1, :], axis=-1)
    return np.arccos(np.where(np.abs(cosines.real) < 1.0, cosines, np.sign(cosines.real)))


@dataclass(frozen=True, eq=False)
class Linear:
    """Derivatives of cables that have settled, S samples of n.

    Attributes
    ----------
    forces: (S, n, 12, 12) [N/m], of the forces on a cable's nodes by these, T following.
    pulls: (S, n, 12) [N/m], what a longer cable changes these forces by, turned round.
    tensions: (S, n, 12) [N/m], of T by the nodes.
    softness: (S, n) [N/m], what T loses per length; zero where a cable is slack.
    """

    forces: Array
    pulls: Array
    tensions: Array
    softness: Array


@dataclass(frozen=True, eq=False)
class HitchEnergy:
    """The energy of S samples of a hitch.

    Attributes
    ----------
    nodes: (n, 4), nodes that each cable runs over.
    points: (points,), the node at each point.
    free: (nodes,), whether a node moves: clasps, and drones that are not held in place.
    law: of the cables.
    places: (S, 2n, 3) [m], where drones are led.
    stiffness: (2n,) [N/m], zero for drones that are held.
    loads: (S, nodes, 3) [N], forces of feed-forward on drones and of loads on clasps.
    """

    nodes: Index
    points: Index
    free: NDArray[np.bool_]
    law: Cables
    places: Array
    stiffness: Array
    loads: Array

    @property
    def drones(self) -> int:
        """Number of drones, the first nodes."""
        return len(self.stiffness)

    @property
    def accuracy(self) -> float:
        """Rounding of the forces per coordinate [N/m]."""
        return ROUNDED_FORCE / float(np.min(self.law.compliance))

    def values(self, x: Array) -> Array:
        """Return the energies (S,) [J] of nodes x (S, nodes, 3) [m]."""
        ends = x[:, self.nodes]
        energies = np.sum(self.law.forces(ends, self.law.tensions(ends))[2], axis=-1)
        away = x[:, : self.drones] - self.places
        energies += 0.5 * np.einsum("sdi,d,sdi->s", away, self.stiffness, away)
        return np.asarray(energies - np.einsum("sni,sni->s", self.loads, x))

    def slopes(self, x: Array, friction: float = 0.0) -> Array:
        """Return minus the force on every node (S, nodes, 3) [N], zero on those that are held."""
        ends = x[:, self.nodes]
        slopes = self.pulls(self.law.forces(ends, self.law.tensions(ends), friction)[0])
        slopes[:, : self.drones] += self.stiffness[:, None] * (x[:, : self.drones] - self.places)
        return np.where(self.free[:, None], slopes, 0.0)

    def pulls(self, at_ends: Array) -> Array:
        """Return minus the forces of cables, of loads and of feed-forward (S, nodes, 3) [N].

        ``at_ends`` (S, n, 4, 3) [N] are those of every cable, turned round.
        """
        pulls = -self.loads
        np.add.at(pulls.swapaxes(0, 1), self.nodes, np.moveaxis(at_ends, 0, 2))
        return pulls

    def linear(self, x: Array, friction: float = 0.0) -> Linear:
        """Return the derivatives of the cables' law at nodes x (S, nodes, 3) [m]."""
        ends, law = x[:, self.nodes], self.law
        T = law.tensions(ends)
        moved = np.eye(12).reshape(12, 1, 1, 4, 3) * (1j * IMAGINARY)
        by_nodes = law.forces(ends + moved, T + 0j * moved[..., 0, 0], friction)
        by_tension = law.forces(ends + 0j, T + 1j * IMAGINARY, friction)
        columns = np.moveaxis(by_nodes[0].imag / IMAGINARY, 0, -1).reshape(*T.shape, 12, 12)
        arcs = np.moveaxis(by_nodes[1].imag / IMAGINARY, 0, -1)
        pulled = (by_tension[0].imag / IMAGINARY).reshape(*T.shape, 12)
        softness = 1.0 / (law.compliance - by_tension[1].imag / IMAGINARY)
        softness = np.where(law.least >= T, 0.0, softness)
        along = softness[..., None] * arcs
        forces = columns + pulled[..., :, None] * along[..., None, :]
        return Linear(forces, softness[..., None] * pulled, along, softness)

    def matrix(self, blocks: Array, damping: Array | float = LEAST_STIFFNESS) -> csc_array:
        """Return the derivatives (S N, S N) [N/m] of all forces, N = 3 nodes, sample by sample.

        Parameters
        ----------
        blocks: (S, n, 12, 12), those of the cables.
        damping: (S,) [N/m], added to the diagonal.
        """
        samples, size = len(blocks), 3 * len(self.free)
        shift = size * np.arange(samples)[:, None, None]
        own = (3 * self.nodes[:, :, None] + np.arange(3)).reshape(-1, 12) + shift
        rows = np.broadcast_to(own[..., :, None], blocks.shape).ravel()
        columns = np.broadcast_to(own[..., None, :], blocks.shape).ravel()
        diagonal = np.zeros((samples, size)) + np.reshape(damping, (-1, 1))
        diagonal[:, : 3 * self.drones] += np.repeat(self.stiffness, 3)
        all_ = np.arange(samples * size)
        entries = np.concatenate([blocks.ravel(), diagonal.ravel()])
        places = np.concatenate([rows, all_]), np.concatenate([columns, all_])
        return coo_array((entries, places), shape=(samples * size,) * 2).tocsc()

    def solved(self, matrix: csc_array, forces: Array) -> Array:
        """Return the displacements (S, nodes, 3, …) [m] that forces of this shape [N] cause."""
        free = np.flatnonzero(np.tile(np.repeat(self.free, 3), len(forces)))
        found = np.zeros((forces.shape[0] * forces.shape[1] * 3, *forces.shape[3:]))
        options = {"SymmetricMode": True}  # all but symmetric: its diagonal has the pivots
        factors = splu(
            matrix[free][:, free],
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options=options,
        )
        found[free] = factors.solve(forces.reshape(found.shape)[free])
        return found.reshape(forces.shape)


def hitch_energy(
    team: Team,
    stiffness: Array,
    planned: tuple[Array, Array],
    reference: Array,
    lengths: Array,
    weight: float,
    axial_stiffness: float,
    places: Array,
    loads: tuple[Array, Array],
) -> tuple[HitchEnergy, Array]:
    """Return the energy of S samples of a team, and the nodes (S, nodes, 3) [m] to start from.

    Parameters
    ----------
    team: cables and drones.
    stiffness: (2n,) [N/m], infinite for drones that are held.
    planned: drones (S, 2n, 3) and vertices (S, points, 3) [m] of the plan.
    reference: (S, n) [N], planned tensions.
    lengths: (S, n) [m], under these.
    weight: of the cables per length [N/m].
    axial_stiffness: EA of the cables [N].
    places: (S, 2n, 3) [m], where drones are led.
    loads: forces on drones (S, 2n, 3) and on clasps (clasps, 3) [N].
    """
    layout, n = team.layout, team.robots
    points = np.zeros(layout.points, dtype=np.intp)
    points[layout.clasps] = 2 * n + np.arange(len(layout.clasps))
    for point, drone in ((0, 0), (layout.points - 1, 2 * n - 1)) if not layout.closed else ():
        points[point] = drone
    cables = np.arange(n)
    ends = points[layout.starts], points[layout.ends]
    nodes = np.column_stack([2 * cables, *ends, 2 * cables + 1])
    legs = layout.has_leg
    exist = np.column_stack([legs[:, 0], np.ones(n, dtype=np.bool_), legs[:, 1]])
    drones, vertices = planned
    clasps = vertices[:, layout.clasps]
    at = np.concatenate([drones, clasps], axis=1)[:, nodes]
    chords = np.linalg.norm(np.diff(at, axis=2), axis=-1)
    law = Cables(
        exist,
        lengths,
        weight,
        team.cable_length / axial_stiffness,
        reference,
        0.5 * (at[:, :, 1, 2] + at[:, :, 2, 2]),
        weight * SAG_RATIO / 8.0 * np.max(chords, axis=-1),
    )
    held = np.isinf(stiffness)
    free = np.concatenate([~held, np.ones(len(layout.clasps), dtype=np.bool_)])
    pushed = np.concatenate([loads[0], np.broadcast_to(loads[1], clasps.shape)], axis=1)
    soft = np.where(held, 0.0, stiffness)
    start = np.concatenate([places, clasps], axis=1)
    return HitchEnergy(nodes, points, free, law, places, soft, pushed), start


def settled_nodes(energy: HitchEnergy, start: Array) -> Array:
    """Return the nodes (S, nodes, 3) [m] of least energy, by Newton's method.

    The caller recomputes the residuals. A diagonal is added where a step does not descend; steps
    are halved until the energy falls enough.

    Parameters
    ----------
    energy: of S samples.
    start: (S, nodes, 3) [m], where held drones are, and guesses for the other nodes.
    """
    x, damping, values = start, np.full(len(start), LEAST_STIFFNESS), energy.values(start)
    for _ in range(NEWTON_STEPS):
        slopes = energy.slopes(x)
        small = SMALL_FORCE + energy.accuracy * np.max(np.abs(x), axis=(1, 2))
        active = np.max(np.abs(slopes), axis=(1, 2)) > small
        if not active.any():
            break
        matrix = energy.matrix(energy.linear(x).forces, damping)
        steps = _shortened(-energy.solved(matrix, slopes), LONGEST_STEP)
        falls = np.einsum("sni,sni->s", steps, slopes)
        pending, failed = active & (falls < 0.0), active & (falls >= 0.0)
        found, reached = x, values
        for share in 0.5 ** np.arange(HALVINGS):
            if not pending.any():
                break
            tried = x + share * steps
            energies = energy.values(tried)
            allowed = values + DESCENT * share * falls + ROUNDING * (1.0 + np.abs(values))
            good = pending & (energies <= allowed)
            found = np.where(good[:, None, None], tried, found)
            reached = np.where(good, energies, reached)
            pending = pending & ~good
        raised = np.minimum(np.maximum(10.0 * damping, FIRST_DAMPING), MOST_DAMPING)
        damping = np.where(failed | pending, raised, np.maximum(0.1 * damping, LEAST_STIFFNESS))
        x, values = found, reached
    return x


def rubbing_nodes(energy: HitchEnergy, rest: Array, friction: float) -> Array:
    """Return the nodes (S, nodes, 3) [m] at an end of the band; nan where no rest is found.

    Parameters
    ----------
    energy: of S samples.
    rest: (S, nodes, 3) [m], where they rest without friction.
    friction: coefficient, positive for legs that pull more than edges, negative for less.
    """
    x, lost = rest, np.zeros(len(rest), dtype=np.bool_)
    small = LARGEST_FORCE + 10.0 * energy.accuracy * float(np.max(np.abs(rest)))
    for share in SHARES if friction else ():
        for _ in range(BAND_STEPS):
            slopes = energy.slopes(x, share * friction)
            moving = ~lost & ~(np.max(np.abs(slopes), axis=(1, 2)) <= small)
            if not np.any(moving):
                break
            matrix = energy.matrix(energy.linear(x, share * friction).forces)
            steps = _shortened(-energy.solved(matrix, slopes), LONGEST_BAND_STEP)
            x = np.where(moving[:, None, None], x + steps, x)
        else:
            lost |= moving
            x = np.where(lost[:, None, None], rest, x)
    return np.where(lost[:, None, None], np.nan, x)


def _shortened(steps: Array, longest: float) -> Array:
    """Return steps (S, nodes, 3) [m], each sample's shortened such that no node goes farther."""
    sizes = np.max(np.linalg.norm(steps, axis=-1), axis=1)
    return np.asarray(steps * np.minimum(1.0, longest / np.maximum(sizes, 1e-300))[:, None, None])
