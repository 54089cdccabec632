"""Energy of cables between compliant drones, and its minimum.

Nodes are the drones q0, r0, q1, …, then the clasps. Every cable connects four nodes: drone, clasp,
clasp, drone. At the end of a chain without a leg the drone also takes the place of the clasp, and
the span between the two does not exist.

A hanging span with chord v, chord length s, level length h and tension m at the height of the
chord's midpoint has the energy ``∫ (tension) ds``. To second order in its weight per length w over
m this is ``E(v, m) = m s - w² s h²/(24 m)``. Its derivative by m is the arc length ``s + w² s
h²/(24 m²)``, its derivative by v the force on the ends without half of the weight. The tension
grows with height: ``m = T + w (z - z₀)``, where z is the height of the chord's midpoint and T is
the same for all spans of a cable. With the cable's length L and its stretch ``a (T - T₀)`` the
energy of a cable is the maximum over T of ``Σ E(v, m) - T L - a (T - T₀)²/2``, where arcs and
stretch add up to the length. T is bounded below by the tension at which the cable becomes slack;
arcs are constant below that tension.

Drones add ``½ k (x - x_set)² - F·x``, with different level and upright stiffness k, and loads
``-w·x``. For weightless cables the energy is convex and its minimum global. With friction at the
clasps the tension of a leg is ``e^{μθ}`` times that of its edge, θ the angle of the bend: forces
balance, but there is no energy.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csc_array
from scipy.sparse.linalg import splu

from hitchopt.geometry.vectors import length
from hitchopt.hitch.quadrotor import GRAVITY
from hitchopt.hitch.team import Team
from hitchopt.values import Array, Indices

# EA of a braided polyethylene line of 1 mm [N]. Without stretch, tensions of rigid drones would be
# undetermined
AXIAL_STIFFNESS = 1e4

# A cable is slack if a level span of its largest length would sag by more than the chord over
# this
SAG_RATIO = 4.0

TENSION_TOLERANCE = 1e-10  # Relative tolerance of a cable's tension
TENSION_ITERATIONS = 100  # Largest number of iterations of a cable's tension
COMPLEX_STEP = 1e-30  # Step of complex-step derivatives [m], [N]

FORCE_TOLERANCE = 1e-11  # Force tolerance of all nodes without friction [N]
FRICTION_TOLERANCE = 1e-7  # Force tolerance of all nodes with friction [N]
# Rounding error of forces over the cables' stiffness times the coordinates
FORCE_ROUNDING = 16.0 * float(np.finfo(np.float64).eps)

# Damping that is always added to the Hessian's diagonal [N/m], as clasps of slack cables are free
MIN_DAMPING = 1e-9
FIRST_DAMPING = 1e-3  # Damping after the first failed step [N/m]
MAX_DAMPING = 1e6  # Largest damping [N/m]

NEWTON_ITERATIONS = 200  # Largest number of Newton iterations
FRICTION_ITERATIONS = 20  # Largest number of Newton iterations per friction level
HALVINGS = 30  # Largest number of halvings of a step

DESCENT = 1e-4  # Fraction of the linear decrease that a step must attain (Armijo)
ROUNDING = 1e-14  # Relative rounding error of energies
MAX_STEP = 0.3  # Largest displacement of a node in a step without friction [m]
MAX_FRICTION_STEP = 0.1  # Largest displacement of a node in a step with friction [m]
INTEGRAL_ERROR = 1e-4  # Position error within which an integral's force is not saturated [m]

# Fractions of the friction coefficient on the continuation path to an end of the band
FRICTION_LEVELS = np.linspace(0.1, 1.0, 10)


@dataclass(frozen=True, eq=False)
class HitchEnergy:
    """The energy of S samples of a hitch."""

    nodes: Indices  # (n, 4), nodes of each cable
    exist: NDArray[np.bool_]  # (n, 3), whether q-leg, edge and r-leg exist
    points: Indices  # (points,), node of each point
    free: NDArray[np.bool_]  # (nodes, 3), whether a node moves along an axis: drones may be rigid
    start: Array  # (S, nodes, 3) [m], setpoints of drones and planned clasps
    stiffness: Array  # (2n, 3) [N/m], zero for rigid drones
    integral: Array  # (2n, 3) [N], largest force of integrals, zero for rigid drones
    loads: Array  # (S, nodes, 3) [N], feed-forward on drones and weights at clasps
    lengths: Array  # (S, n) [m], L at the tension T₀
    weight: float  # weight of cables per length [N/m]
    compliance: Array  # (n,) [m/N], a: stretch of a cable per tension
    reference: Array  # (S, n) [N], T₀
    heights: Array  # (S, n) [m], z₀
    slack_tension: Array  # (S, n) [N], tension at which a cable becomes slack

    @property
    def drones(self) -> int:
        """Number of drones, the first nodes."""
        return len(self.stiffness)

    @property
    def accuracy(self) -> float:
        """Rounding error of forces per coordinate [N/m]."""
        return FORCE_ROUNDING / float(np.min(self.compliance))

    def spans(self, ends: Any) -> tuple[Any, Any, Any]:
        """Return chords (…, S, n, 3, 3) of nodes (…, S, n, 4, 3), lengths and midpoint heights."""
        chords = np.where(self.exist[..., None], np.diff(ends, axis=-2), 0.0)
        sizes = np.sqrt(np.sum(chords * chords, axis=-1))
        middles = 0.5 * (ends[..., 1:, 2] + ends[..., :-1, 2])
        return chords, sizes, middles - self.heights[..., None]

    def forces(self, ends: Any, T: Any, friction: Any = 0.0) -> tuple[Any, Any, Any]:
        """Return forces (…, S, n, 4, 3) [N], lengths [m] and energies [J] of cables (…, S, n).

        Forces are minus those of cables on their nodes; without friction, gradients of the energy.
        Nodes (…, S, n, 4, 3) [m] and tensions T (…, S, n) [N] are real or complex. The friction of
        all legs, or of each (…, S, n, 2), is positive if legs pull more than edges.
        """
        chords, sizes, heights = self.spans(ends)
        units = chords / np.where(sizes.real > 0.0, sizes, 1.0)[..., None]
        m = T[..., None] + self.weight * heights
        sag, bounded = self._sag(m)
        slope = -sag * (2.0 * bounded - m)  # derivative of the energy by s h²
        level = chords[..., 0] ** 2 + chords[..., 1] ** 2
        pulls = (m + slope * level)[..., None] * units
        pulls[..., :2] += (2.0 * slope * sizes)[..., None] * chords[..., :2]
        arcs = sizes * (1.0 + sag * level)
        stretched = T - self.reference
        energies = np.sum(sizes * (m + slope * level), axis=-1) - T * self.lengths
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
        """Return derivatives of arcs by s h², and tensions m (…, 3) [N] bounded from below."""
        bounded = np.where(m.real > self.slack_tension[..., None], m, self.slack_tension[..., None])
        return self.weight**2 / 24.0 / np.where(bounded.real > 0.0, bounded, 1.0) ** 2, bounded

    def tensions(self, x: Array) -> Array:
        """Return T (S, n) [N] for which cables over nodes x (S, nodes, 3) [m] have their lengths.

        Arcs are convex in T: Newton's iteration from below does not overshoot.
        """
        chords, sizes, heights = self.spans(x[:, self.nodes])
        missing = np.sum(sizes, axis=-1) - self.lengths + self.compliance * self.reference
        bulges = sizes * (chords[..., 0] ** 2 + chords[..., 1] ** 2)
        T = np.maximum(self.slack_tension, missing / self.compliance)
        for _ in range(TENSION_ITERATIONS if self.weight else 0):
            sag, bounded = self._sag(T[..., None] + self.weight * heights)
            excess = missing - self.compliance * T + np.sum(sag * bulges, axis=-1)
            slope = self.compliance + np.sum(2.0 * sag * bulges / bounded, axis=-1)
            previous, T = T, np.maximum(self.slack_tension, T + excess / slope)
            if np.all(np.abs(T - previous) <= TENSION_TOLERANCE * T):
                break
        return np.asarray(T)

    def values(self, x: Array) -> Array:
        """Return energies (S,) [J] of nodes x (S, nodes, 3) [m]."""
        energies = np.sum(self.forces(x[:, self.nodes], self.tensions(x))[2], axis=-1)
        energies += np.sum(self.springs(x)[0], axis=(1, 2))
        return np.asarray(energies - np.einsum("sni,sni->s", self.loads, x))

    def slopes(self, x: Array, friction: float | Array = 0.0) -> Array:
        """Return minus the force on every node (S, nodes, 3) [N], zero for rigid drones."""
        slopes = self.pulls(self.forces(x[:, self.nodes], self.tensions(x), friction)[0])
        slopes[:, : self.drones] += self.springs(x)[1]
        return np.where(self.free, slopes, 0.0)

    def springs(self, x: Array) -> tuple[Array, Array, Array]:
        """Return energies of position loops, first and second derivatives, (S, 2n, 3) each.

        At rest, an integral has removed the error e or saturates at its largest force b, which has
        the energy b |e|, smoothed within INTEGRAL_ERROR.
        """
        errors = (x - self.start)[:, : self.drones]
        k, b, smoothed = self.stiffness, self.integral, np.hypot(errors, INTEGRAL_ERROR)
        energies = 0.5 * k * errors * errors + b * (smoothed - INTEGRAL_ERROR)
        return energies, (k + b / smoothed) * errors, k + b * INTEGRAL_ERROR**2 / smoothed**3

    def bends(self, x: Array) -> Array:
        """Return angles (S, n, 2) [rad] between each edge and its legs, zero without a leg."""
        chords, sizes, _ = self.spans(x[:, self.nodes])
        angles = bends_of(chords / np.where(sizes > 0.0, sizes, 1.0)[..., None])
        return np.where(self.exist[:, ::2], angles, 0.0)

    def leg_pulls(self, x: Array) -> Array:
        """Return tensions of legs along them (S, n, 2, 3) [N], toward the end of the cable."""
        chords, sizes, heights = self.spans(x[:, self.nodes])
        units = chords / np.where(sizes > 0.0, sizes, 1.0)[..., None]
        m = self.tensions(x)[..., None] + self.weight * heights
        return np.asarray((m[..., None] * units)[..., ::2, :])

    def pulls(self, at_ends: Any) -> Any:
        """Return minus the forces of cables and loads on nodes (S, nodes, 3) [N]."""
        pulls = -self.loads.astype(at_ends.dtype)
        np.add.at(pulls.swapaxes(0, 1), self.nodes, np.moveaxis(at_ends, 0, 2))
        return pulls

    def linear(self, x: Array, friction: float | Array = 0.0) -> tuple[Array, Array, Array]:
        """Return derivatives of the cables' forces and tensions at nodes x (S, nodes, 3) [m].

        These are (S, n, 12, 13) of forces by a cable's nodes, with T varying, and by T; (S, n, 12)
        of T by the nodes; and (S, n) minus that of T by the length, zero for slack cables.
        """
        ends, T = x[:, self.nodes], self.tensions(x)
        steps = 1j * COMPLEX_STEP * np.eye(13).reshape(13, 1, 1, 13)
        perturbed = ends + steps[..., :12].reshape(13, 1, 1, 4, 3)
        forces, arcs, _ = self.forces(perturbed, T + steps[..., 12], friction)
        columns = np.moveaxis(forces.imag / COMPLEX_STEP, 0, -1).reshape(*T.shape, 12, 13)
        arc_slopes = np.moveaxis(arcs.imag / COMPLEX_STEP, 0, -1)
        softness = 1.0 / (self.compliance - arc_slopes[..., 12])
        softness = np.where(self.slack_tension >= T, 0.0, softness)
        tensions = softness[..., None] * arc_slopes[..., :12]
        columns[..., :12] += columns[..., 12:] * tensions[..., None, :]
        return columns, tensions, softness

    def matrix(self, x: Array, blocks: Array, damping: Array | float = MIN_DAMPING) -> csc_array:
        """Return the block-diagonal Hessian (S N, S N) [N/m] of all samples, N = 3 nodes.

        Nodes are at x (S, nodes, 3) [m]; ``blocks`` are those of ``linear``; ``damping`` (S,) [N/m]
        is added to the diagonal.
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
        """Return displacements (S, nodes, 3, …) [m] caused by forces of this shape [N]."""
        free = np.flatnonzero(np.tile(self.free.ravel(), len(forces)))
        displacements = np.zeros((forces.shape[0] * forces.shape[1] * 3, *forces.shape[3:]))
        # The matrix is nearly symmetric: pivots are taken from the diagonal.
        order: Any = {"permc_spec": "MMD_AT_PLUS_A", "options": {"SymmetricMode": True}}
        factors = splu(matrix[free][:, free], diag_pivot_thresh=0.0, **order)
        displacements[free] = factors.solve(forces.reshape(displacements.shape)[free])
        return displacements.reshape(forces.shape)

    def steps(
        self, x: Array, damping: Array | float, max_length: float, friction: float | Array
    ) -> Any:
        """Return Newton steps (S, nodes, 3) [m] of bounded length for each node, and the slopes."""
        slopes = self.slopes(x, friction)
        steps = self.solved(self.matrix(x, self.linear(x, friction)[0], damping), -slopes)
        sizes = np.max(np.linalg.norm(steps, axis=-1), axis=1)
        shares = np.minimum(1.0, max_length / np.maximum(sizes, 1e-300))
        return steps * shares[:, None, None], slopes

    def at_rest(self) -> Array:
        """Return the nodes (S, nodes, 3) [m] of least energy, by a damped Newton method.

        Steps are halved until the energy decreases enough; damping grows if no step does. Forces
        are no merit function, as steps along stiff cables increase them. The caller recomputes the
        residuals.
        """
        x, damping = self.start, np.full(len(self.start), MIN_DAMPING)
        values = self.values(x)
        for _ in range(NEWTON_ITERATIONS):
            steps, slopes = self.steps(x, damping, MAX_STEP, 0.0)
            small = FORCE_TOLERANCE + self.accuracy * np.max(np.abs(x), axis=(1, 2))
            active = np.max(np.abs(slopes), axis=(1, 2)) > small
            if not active.any():
                break
            falls, previous = -np.einsum("sni,sni->s", steps, slopes), values
            shares = np.where(active & (falls > 0.0), 1.0, 0.0)
            for _ in range(HALVINGS):
                trial = x + shares[:, None, None] * steps
                values, rounding = self.values(trial), ROUNDING * (1.0 + np.abs(previous))
                high = values > previous - DESCENT * shares * falls + rounding
                if not high.any():
                    break
                shares = np.where(high, 0.5 * shares, shares)
            x, failed = trial, (shares == 0.0) | high
            raised = np.clip(10.0 * damping, FIRST_DAMPING, MAX_DAMPING)
            damping = np.where(failed, raised, np.maximum(0.1 * damping, MIN_DAMPING))
        return x

    def rest_with_friction(self, rest: Array, friction: float | Array) -> Array:
        """Return the nodes (S, nodes, 3) [m] at an end of the band; nan without convergence.

        ``rest`` are the nodes without friction. A positive coefficient lets legs pull more than
        edges, a negative one less; it is that of all legs, or of each (S, n, 2).
        """
        x, failed = rest, np.zeros((len(rest), 1, 1), dtype=np.bool_)
        small = FRICTION_TOLERANCE + 10.0 * self.accuracy * float(np.max(np.abs(rest)))
        for share in FRICTION_LEVELS if np.any(friction) else ():
            for _ in range(FRICTION_ITERATIONS):
                steps, slopes = self.steps(x, MIN_DAMPING, MAX_FRICTION_STEP, share * friction)
                moving = ~failed & ~(np.max(np.abs(slopes), axis=(1, 2), keepdims=True) <= small)
                if not np.any(moving):
                    break
                x = np.where(moving, x + steps, x)
            else:
                failed = failed | moving
                x = np.where(failed, rest, x)
        return np.where(failed, np.nan, x)


def energy_of(
    team: Team, conditions: Mapping[str, Any], samples: Mapping[str, Array]
) -> HitchEnergy:
    """Return the energy of samples, see ``samples_of``."""
    layout = team.layout
    clasps = team.drones + np.arange(len(layout.clasps))
    points = np.zeros(layout.points, dtype=np.intp)
    points[-1] = team.drones - 1  # ends of a chain are its outer drones
    points[layout.clasps] = clasps
    nodes = np.append(points, np.arange(team.drones))[layout.routes]
    drones, vertices = samples["positions"], samples["vertices"][:, layout.clasps]
    ends = np.concatenate([drones, vertices], axis=1)[:, nodes]
    longest = np.max(length(np.diff(ends, axis=2)), axis=-1)
    weight = GRAVITY * float(conditions["cable_density"])
    rigid = np.isinf(conditions["stiffness"])
    loads = np.zeros((len(ends), team.drones + len(clasps), 3))
    feed_forward = conditions["feed_forward"][:, None] * samples["cable_forces"]
    loads[:, : team.drones] = samples["forces"] - feed_forward
    loads[:, team.drones :, 2] = -GRAVITY * conditions["load"]
    free = np.ones((team.drones + len(clasps), 3), dtype=np.bool_)
    free[: team.drones] = ~rigid
    return HitchEnergy(
        nodes,
        exist=layout.exists,
        points=points,
        free=free,
        start=np.concatenate([drones + samples["offsets"], vertices], axis=1),
        stiffness=np.where(rigid, 0.0, conditions["stiffness"]),
        integral=np.where(rigid, 0.0, conditions["integral"]),
        loads=loads,
        lengths=samples["cable_length"],
        weight=weight,
        compliance=team.cable_length / conditions["axial_stiffness"],
        reference=samples["tensions"],
        heights=0.5 * (ends[:, :, 1, 2] + ends[:, :, 2, 2]),
        slack_tension=weight * SAG_RATIO / 8.0 * longest,
    )


def bends_of(units: Any) -> Any:
    """Return angles (…, 2) [rad] between consecutive spans with directions (…, 3, 3)."""
    cosines = np.sum(units[..., 1:, :] * units[..., :-1, :], axis=-1)
    return np.arccos(np.where(np.abs(cosines.real) < 1.0, cosines, np.sign(cosines.real)))
