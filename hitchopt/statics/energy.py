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

Drones of stiffness k, level and upright apart, add ``½ k (x - x_set)² - F·x``, loads ``-w·x``. If
cables weigh nothing the energy is convex, so that its minimum is global. With friction at the
clasps legs pull with ``e^{μθ}`` times what edges do, θ the angle of the bend: forces balance, but
there is no energy.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csc_array
from scipy.sparse.linalg import splu

from hitchopt.values import Array, Indices

CONVERGED = 1e-10  # Relative step at which a cable's tension has converged
CABLE_STEPS = 100  # Most steps
IMAGINARY = 1e-30  # Imaginary step by which derivatives are taken [m], [N]: exact to rounding

# Forces this small on all nodes end the iteration [N], without friction and with it, and [1] over
# the cables' stiffness times the coordinates
SMALL_FORCE, BAND_FORCE, ROUNDED_FORCE = 1e-11, 1e-7, 16.0 * float(np.finfo(np.float64).eps)

# Added to the Hessian's diagonal [N/m]: as slack cables hold their clasps by nothing; after the
# first step that does not descend; and at most
LEAST_DAMPING, FIRST_DAMPING, MOST_DAMPING = 1e-9, 1e-3, 1e6

# Newton steps at most, 3 to 30 are usual; for each share of friction; times that one is halved
NEWTON_STEPS, BAND_STEPS, HALVINGS = 200, 20, 30

DESCENT = 1e-4  # Share of the linear decrease that a step must bring (Armijo)
ROUNDING = 1e-14  # Of the energies
LONGEST_STEP, LONGEST_BAND_STEP = 0.3, 0.1  # Of a node [m]: directions change beyond it

DEAD = 1e-4  # Error within which an integral's force is not at its largest [m]

# Shares of the friction at which the hitch settles on its way to an end of its band
SHARES = np.linspace(0.1, 1.0, 10)


@dataclass(frozen=True, eq=False)
class HitchEnergy:
    """The energy of S samples of a hitch."""

    nodes: Indices  # (n, 4) that each cable runs over
    exist: NDArray[np.bool_]  # (n, 3), whether q-leg, edge and r-leg exist
    points: Indices  # (points,), the node at each point
    free: NDArray[np.bool_]  # (nodes, 3), whether a node moves along an axis: drones may be held
    start: Array  # (S, nodes, 3) [m], where drones are led, and clasps planned
    stiffness: Array  # (2n, 3) [N/m], zero for drones that are held
    integral: Array  # (2n, 3) [N], largest force of integrals, zero likewise
    loads: Array  # (S, nodes, 3) [N], feed-forward on drones and weights at clasps
    lengths: Array  # (S, n) [m], L at the tension T₀
    weight: float  # of cables, per length [N/m]
    compliance: Array  # (n,) [m/N], a: growth of a cable per tension
    reference: Array  # (S, n) [N], T₀
    heights: Array  # (S, n) [m], z₀
    least: Array  # (S, n) [N], tension at which a cable is slack

    @property
    def drones(self) -> int:
        """Number of drones, the first nodes."""
        return len(self.stiffness)

    @property
    def accuracy(self) -> float:
        """Rounding of the forces per coordinate [N/m]."""
        return ROUNDED_FORCE / float(np.min(self.compliance))

    def spans(self, ends: Any) -> tuple[Any, Any, Any]:
        """Return chords (…, S, n, 3, 3) of nodes (…, S, n, 4, 3), lengths, middles' heights."""
        chords = np.where(self.exist[..., None], np.diff(ends, axis=-2), 0.0)
        sizes = np.sqrt(np.sum(chords * chords, axis=-1))
        middles = 0.5 * (ends[..., 1:, 2] + ends[..., :-1, 2])
        return chords, sizes, middles - self.heights[..., None]

    def forces(self, ends: Any, T: Any, friction: Any = 0.0) -> tuple[Any, Any, Any]:
        """Return forces (…, S, n, 4, 3) [N], lengths [m] and energies [J] of cables (…, S, n).

        The forces are minus those of cables on their nodes: without friction, slopes of the energy.
        Nodes (…, S, n, 4, 3) [m] and tensions T (…, S, n) [N] are real or complex. The friction
        that is used, of all legs or of each (…, S, n, 2), is positive if legs pull more than edges.
        """
        chords, sizes, heights = self.spans(ends)
        units = chords / np.where(sizes.real > 0.0, sizes, 1.0)[..., None]
        m = T[..., None] + self.weight * heights
        sag, held = self._sag(m)
        bent = -sag * (2.0 * held - m)  # slope of the energy by s h²
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

    def _sag(self, m: Any) -> tuple[Any, Any]:
        """Return the slope of arcs by s h² for tensions m (…, 3) [N], and these, at least least."""
        held = np.where(m.real > self.least[..., None], m, self.least[..., None])
        return self.weight**2 / 24.0 / np.where(held.real > 0.0, held, 1.0) ** 2, held

    def tensions(self, x: Array) -> Array:
        """Return the T (S, n) [N] at which cables over nodes x (S, nodes, 3) have their lengths.

        Arcs are convex in T: Newton's steps from below do not pass the solution.
        """
        chords, sizes, heights = self.spans(x[:, self.nodes])
        spare = np.sum(sizes, axis=-1) - self.lengths + self.compliance * self.reference
        bulges = sizes * (chords[..., 0] ** 2 + chords[..., 1] ** 2)
        T = np.maximum(self.least, spare / self.compliance)
        for _ in range(CABLE_STEPS if self.weight else 0):
            sag, held = self._sag(T[..., None] + self.weight * heights)
            excess = spare - self.compliance * T + np.sum(sag * bulges, axis=-1)
            fall = self.compliance + np.sum(2.0 * sag * bulges / held, axis=-1)
            before, T = T, np.maximum(self.least, T + excess / fall)
            if np.all(np.abs(T - before) <= CONVERGED * T):
                break
        return np.asarray(T)

    def values(self, x: Array) -> Array:
        """Return the energies (S,) [J] of nodes x (S, nodes, 3) [m]."""
        energies = np.sum(self.forces(x[:, self.nodes], self.tensions(x))[2], axis=-1)
        energies += np.sum(self.springs(x)[0], axis=(1, 2))
        return np.asarray(energies - np.einsum("sni,sni->s", self.loads, x))

    def slopes(self, x: Array, friction: float = 0.0) -> Array:
        """Return minus the force on every node (S, nodes, 3) [N], zero on those that are held."""
        slopes = self.pulls(self.forces(x[:, self.nodes], self.tensions(x), friction)[0])
        slopes[:, : self.drones] += self.springs(x)[1]
        return np.where(self.free, slopes, 0.0)

    def springs(self, x: Array) -> tuple[Array, Array, Array]:
        """Return the energies of position loops, their slopes and curvatures, (S, 2n, 3) each.

        At rest an integral has grown until the error is zero, or it gives its largest force b:
        energy b |e|, rounded within DEAD of no error.
        """
        away = (x - self.start)[:, : self.drones]
        k, b, round_ = self.stiffness, self.integral, np.hypot(away, DEAD)
        energies = 0.5 * k * away * away + b * (round_ - DEAD)
        return energies, (k + b / round_) * away, k + b * DEAD**2 / round_**3

    def pulls(self, at_ends: Any) -> Any:
        """Return minus the forces on nodes (S, nodes, 3) [N] but for springs, by the cables'."""
        pulls = -self.loads.astype(at_ends.dtype)
        np.add.at(pulls.swapaxes(0, 1), self.nodes, np.moveaxis(at_ends, 0, 2))
        return pulls

    def linear(self, x: Array, friction: float = 0.0) -> tuple[Array, Array, Array]:
        """Return derivatives of the cables' forces and tensions at nodes x (S, nodes, 3) [m].

        They are (S, n, 12, 13) of the forces by a cable's nodes, T following, and by T; (S, n, 12)
        of T by the nodes; and (S, n) what T loses per length, zero where a cable is slack.
        """
        ends, T = x[:, self.nodes], self.tensions(x)
        steps = 1j * IMAGINARY * np.eye(13).reshape(13, 1, 1, 13)
        moved = ends + steps[..., :12].reshape(13, 1, 1, 4, 3)
        forces, arcs, _ = self.forces(moved, T + steps[..., 12], friction)
        columns = np.moveaxis(forces.imag / IMAGINARY, 0, -1).reshape(*T.shape, 12, 13)
        longer = np.moveaxis(arcs.imag / IMAGINARY, 0, -1)
        softness = np.where(self.least >= T, 0.0, 1.0 / (self.compliance - longer[..., 12]))
        tensions = softness[..., None] * longer[..., :12]
        columns[..., :12] += columns[..., 12:] * tensions[..., None, :]
        return columns, tensions, softness

    def matrix(self, x: Array, blocks: Array, damping: Array | float = LEAST_DAMPING) -> csc_array:
        """Return the derivatives (S N, S N) [N/m] of all forces, N = 3 nodes, sample by sample.

        Nodes are at x (S, nodes, 3) [m]; ``blocks`` are those of cables; ``damping`` (S,) [N/m] is
        added to the diagonal.
        """
        samples, size = len(blocks), 3 * len(self.free)
        shift = size * np.arange(samples)[:, None, None]
        own = (3 * self.nodes[:, :, None] + np.arange(3)).reshape(-1, 12) + shift
        rows, columns = np.broadcast_arrays(own[..., :, None], own[..., None, :])
        diagonal = np.zeros((samples, size)) + np.reshape(damping, (-1, 1))
        diagonal[:, : 3 * self.drones] += self.springs(x)[2].reshape(samples, -1)
        all_ = np.arange(samples * size)
        entries = np.concatenate([blocks[..., :12].ravel(), diagonal.ravel()])
        places = np.concatenate([[rows.ravel(), columns.ravel()], [all_, all_]], axis=1)
        return coo_array((entries, places), shape=(samples * size,) * 2).tocsc()

    def solved(self, matrix: csc_array, forces: Array) -> Array:
        """Return the displacements (S, nodes, 3, …) [m] that forces of this shape [N] cause."""
        free = np.flatnonzero(np.tile(self.free.ravel(), len(forces)))
        displacements = np.zeros((forces.shape[0] * forces.shape[1] * 3, *forces.shape[3:]))
        # All but symmetric: its diagonal has the pivots.
        order: Any = {"permc_spec": "MMD_AT_PLUS_A", "options": {"SymmetricMode": True}}
        factors = splu(matrix[free][:, free], diag_pivot_thresh=0.0, **order)
        displacements[free] = factors.solve(forces.reshape(displacements.shape)[free])
        return displacements.reshape(forces.shape)

    def steps(self, x: Array, damping: Array | float, longest: float, friction: float) -> Any:
        """Return Newton's steps (S, nodes, 3) [m], no node's longer than that, and the slopes."""
        slopes = self.slopes(x, friction)
        steps = self.solved(self.matrix(x, self.linear(x, friction)[0], damping), -slopes)
        sizes = np.max(np.linalg.norm(steps, axis=-1), axis=1)
        shares = np.minimum(1.0, longest / np.maximum(sizes, 1e-300))
        return steps * shares[:, None, None], slopes

    def settled(self) -> Array:
        """Return the nodes (S, nodes, 3) [m] of least energy, by Newton's method.

        Steps are halved until the energy falls enough; where none descends the diagonal grows. The
        force's size is no measure: steps along cables that hardly stretch raise it. The caller
        recomputes the residuals.
        """
        x, damping = self.start, np.full(len(self.start), LEAST_DAMPING)
        values = self.values(x)
        for _ in range(NEWTON_STEPS):
            steps, slopes = self.steps(x, damping, LONGEST_STEP, 0.0)
            small = SMALL_FORCE + self.accuracy * np.max(np.abs(x), axis=(1, 2))
            active = np.max(np.abs(slopes), axis=(1, 2)) > small
            if not active.any():
                break
            falls, before = -np.einsum("sni,sni->s", steps, slopes), values
            shares = np.where(active & (falls > 0.0), 1.0, 0.0)
            for _ in range(HALVINGS):
                trial = x + shares[:, None, None] * steps
                values, rounding = self.values(trial), ROUNDING * (1.0 + np.abs(before))
                high = values > before - DESCENT * shares * falls + rounding
                if not high.any():
                    break
                shares = np.where(high, 0.5 * shares, shares)
            x, failed = trial, (shares == 0.0) | high
            raised = np.clip(10.0 * damping, FIRST_DAMPING, MOST_DAMPING)
            damping = np.where(failed, raised, np.maximum(0.1 * damping, LEAST_DAMPING))
        return x

    def rubbing(self, rest: Array, friction: float) -> Array:
        """Return the nodes (S, nodes, 3) [m] at an end of the band; nan if none is reached.

        ``rest`` is where they are without friction, whose coefficient is positive for legs that
        pull more than edges, negative for less.
        """
        x, lost = rest, np.zeros((len(rest), 1, 1), dtype=np.bool_)
        small = BAND_FORCE + 10.0 * self.accuracy * float(np.max(np.abs(rest)))
        for share in SHARES if friction else ():
            for _ in range(BAND_STEPS):
                steps, slopes = self.steps(x, LEAST_DAMPING, LONGEST_BAND_STEP, share * friction)
                moving = ~lost & ~(np.max(np.abs(slopes), axis=(1, 2), keepdims=True) <= small)
                if not np.any(moving):
                    break
                x = np.where(moving, x + steps, x)
            else:
                lost = lost | moving
                x = np.where(lost, rest, x)
        return np.where(lost, np.nan, x)


def bends_of(units: Any) -> Any:
    """Return the angles (…, 2) [rad] between spans of directions (…, 3, 3), at both clasps."""
    cosines = np.sum(units[..., 1:, :] * units[..., :-1, :], axis=-1)
    return np.arccos(np.where(np.abs(cosines.real) < 1.0, cosines, np.sign(cosines.real)))
