"""Energy of cables between compliant drones, and its minimum.

Nodes are the drones q0, r0, q1, …, then the clasps. Every cable connects four nodes: drone, clasp,
clasp, drone. At the end of a chain without a leg the drone also takes the place of the clasp, and
the span between the two does not exist.

A hanging span with chord v, chord length s, level length D, height h and tension m at the height of
the chord's midpoint has the energy ``∫ (tension) ds``, which is ``E(v, m) = m (D²/BL + L + h²/L) /
2`` with the terms of ``hitchopt.hitch.taut``. Its derivative with respect to m is the arc length L,
that with respect to v the force on the ends without half of the weight, ``(m/L) (D/B, h)``. The
tension grows with height: ``m = T + w (z - z₀)``, where z is the height of the chord's midpoint and
T is the same for all spans of a cable. With the cable's length L and its stretch ``a (T - T₀)`` the
energy of a cable is the maximum over T of ``Σ E(v, m) - T L - a (T - T₀)²/2``, where arcs and
stretch add up to the length. T is bounded below by the tension at which the cable becomes slack;
arcs are constant below that tension.

Drones add ``½ k (x - x_set)² - F·x``, with different horizontal and vertical stiffness k, and loads
``-w·x``. For weightless cables the energy is convex and its minimum global. With friction at the
clasps the tension of a leg is ``e^{μβ}`` times that of its edge, with the bend β of ``twists``:
forces balance, but there is no energy.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hitchopt.drones.quadrotor import GRAVITY
from hitchopt.geometry.vectors import length
from hitchopt.hitch.taut import LARGEST_SMALL, closed_sag, series_sag
from hitchopt.hitch.team import Team
from hitchopt.hitch.twists import bend
from hitchopt.values import Array, Indices

AXIAL_STIFFNESS = 1e4
"""[N] EA of a braided polyethylene line of 1 mm. Without stretch, tensions of rigid drones would be
undetermined."""

SLACK_RATIO = 1.2
"""A cable is slack below this ratio of its tension to the weight of its longest span at first:
level spans of that length then sag by 12 % of it."""

LARGEST_SAG = 0.43
"""Largest ``(w D / 2m)²``, D the level length of a span that grew: catenaries end at 0.439."""

TENSION_TOLERANCE = 1e-10  # Relative tolerance of a cable's tension
TENSION_ITERATIONS = 100  # Largest number of iterations of a cable's tension
COMPLEX_STEP = 1e-30  # [m], [N] Step of complex-step derivatives
FORCE_TOLERANCE = 1e-11  # [N] Force tolerance of all nodes without friction
FRICTION_TOLERANCE = 1e-7  # [N] Force tolerance of all nodes with friction

FORCE_ROUNDING = 16.0 * float(np.finfo(np.float64).eps)
"""Rounding error of forces over the cables' stiffness times the coordinates."""

MIN_DAMPING = 1e-9
"""[N/m] Damping that is always added to the Hessian's diagonal, as clasps of slack cables are
free."""

FIRST_DAMPING = 1e-3  # [N/m] Damping after the first failed step
MAX_DAMPING = 1e6  # [N/m] Largest damping
NEWTON_ITERATIONS = 200  # Largest number of Newton iterations
FRICTION_ITERATIONS = 20  # Largest number of Newton iterations per friction level
HALVINGS = 30  # Largest number of halvings of a step
DESCENT = 1e-4  # Fraction of the linear decrease that a step must attain (Armijo)
ROUNDING = 1e-14  # Relative rounding error of energies
MAX_STEP = 0.3  # [m] Largest displacement of a node in a step without friction
MAX_FRICTION_STEP = 0.1  # [m] Largest displacement of a node in a step with friction
INTEGRAL_ERROR = 1e-4  # [m] Position error within which an integral's force is not saturated

FRICTION_LEVELS = np.linspace(0.1, 1.0, 10)
"""Fractions of the friction coefficient on the continuation path to an end of the band."""

CABLE_COORDINATES = 12  # Number of coordinates of the four nodes of a cable


class Spans(NamedTuple):
    """Chords between consecutive nodes of cables: q-leg, edge and r-leg."""

    chords: Any  # (…, S, n, 3, 3) [m], zero where a span does not exist
    lengths: Any  # (…, S, n, 3) [m]
    # (…, S, n, 3) [m], of their midpoints over the height at which a cable has its tension
    heights: Any

    @property
    def directions(self) -> Any:
        """(…, S, n, 3, 3): unit vectors, zero where a span does not exist."""
        return self.chords / np.where(self.lengths.real > 0.0, self.lengths, 1.0)[..., None]


class Arcs(NamedTuple):
    """Spans (…, S, n, 3) as taut cables."""

    lengths: Any  # [m], L
    softness: Any  # [m/N], minus the derivative of L with respect to the tension
    energies: Any  # [J], E
    level_pulls: Any  # [N/m], level force over the level chord
    rise_pulls: Any  # [N/m], vertical force over the rise, without half of the weight

    def pulls(self, chords: Any) -> Any:
        """Return forces (…, S, n, 3, 3) [N] along chords (…, S, n, 3, 3) [m], without weights."""
        factors = np.stack([self.level_pulls, self.level_pulls, self.rise_pulls], axis=-1)
        return factors * chords


class CableForces(NamedTuple):
    """Forces and energies of cables."""

    on_ends: Any  # (…, S, n, 4, 3) [N], minus the forces of a cable on its nodes
    lengths: Any  # (…, S, n) [m], sums of the arcs of a cable
    energies: Any  # (…, S, n) [J]


class SpringForces(NamedTuple):
    """Energies of position loops, and derivatives in drone positions, (S, 2n, 3) each."""

    energies: Array  # [J]
    slopes: Array  # [N]
    curvatures: Array  # [N/m]


class CableSlopes(NamedTuple):
    """Derivatives of the cables' forces and tensions."""

    forces: Array
    """(S, n, 12, 13), derivatives of forces with respect to a cable's nodes, with T varying, and to
    T."""

    tensions: Array  # (S, n, 12) [N/m], derivative of T with respect to the nodes
    # (S, n) [N/m], minus the derivative of T with respect to the length; zero for slack cables
    softness: Array


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
    weight: float  # Weight of cables per length [N/m]
    compliance: Array  # (n,) [m/N], a: stretch of a cable per tension
    reference: Array  # (S, n) [N], T₀
    heights: Array  # (S, n) [m], z₀
    slack_tension: Array  # (S, n) [N], tension at which a cable becomes slack
    alike: bool = False  # Whether both cables of every clasp slide alike, and so share its friction

    @property
    def drones(self) -> int:
        """Number of drones, the first nodes."""
        return len(self.stiffness)

    @property
    def accuracy(self) -> float:
        """Rounding error of forces per coordinate [N/m]."""
        return FORCE_ROUNDING / float(np.min(self.compliance))

    def spans(self, ends: Any) -> Spans:
        """Return the spans of cables with nodes (…, S, n, 4, 3) [m]."""
        chords = np.where(self.exist[..., None], np.diff(ends, axis=-2), 0.0)
        lengths = np.sqrt(np.sum(chords * chords, axis=-1))
        middles = 0.5 * (ends[..., 1:, 2] + ends[..., :-1, 2])
        return Spans(chords, lengths, middles - self.heights[..., None])

    def forces(self, ends: Any, T: Any, friction: Any = 0.0) -> CableForces:
        """Return the forces and energies of cables.

        Without friction, forces are gradients of the energy. Nodes (…, S, n, 4, 3) [m] and tensions
        T (…, S, n) [N] are real or complex. The friction of all legs, or of each (…, S, n, 2), is
        positive if legs pull more than edges.
        """
        spans = self.spans(ends)
        m = T[..., None] + self.weight * spans.heights
        arcs = self._arcs(spans, m)
        span_energies = arcs.energies
        pulls = arcs.pulls(spans.chords)
        energies = np.sum(span_energies, axis=-1) - T * self.lengths
        excess_tension = T - self.reference
        energies = energies - 0.5 * self.compliance * excess_tension * excess_tension
        if np.any(friction):
            pulls[..., 0::2, :] *= np.exp(friction * self._bends(spans.directions))[..., None]
        on_ends = np.zeros(ends.shape, dtype=pulls.dtype)
        on_ends[..., 1:, :] += pulls
        on_ends[..., :-1, :] -= pulls
        on_ends[..., 1:, 2] += 0.5 * self.weight * arcs.lengths
        on_ends[..., :-1, 2] += 0.5 * self.weight * arcs.lengths
        return CableForces(on_ends, np.sum(arcs.lengths, axis=-1), energies)

    def _arcs(self, spans: Spans, m: Any) -> Arcs:
        """Return the arcs of spans with tensions m (…, 3) [N] at the heights of their midpoints.

        Below the tension at which a cable becomes slack, arcs keep their lengths and energies are
        linear in the tension.
        """
        if not self.weight:
            pulls = m / np.where(spans.lengths.real > 0.0, spans.lengths, 1.0)
            return Arcs(spans.lengths, np.zeros(m.shape), m * spans.lengths, pulls, pulls)
        slack = self.slack_tension[..., None]
        bounded = np.where(m.real > slack, m, slack)
        bounded = np.where(bounded.real > 0.0, bounded, 1.0)
        squared_level = spans.chords[..., 0] ** 2 + spans.chords[..., 1] ** 2
        squared_rise = spans.chords[..., 2] ** 2
        squared_weight = (0.5 * self.weight / bounded) ** 2
        of_level = squared_level * squared_weight
        of_level = np.where(of_level.real < LARGEST_SAG, of_level, LARGEST_SAG)
        of_rise = squared_rise * squared_weight
        is_small = np.max((of_level + of_rise).real) < LARGEST_SMALL
        sag = (series_sag if is_small else closed_sag)(of_level, of_rise)
        exists = self.exist
        lengths = np.sqrt(np.where(exists, squared_rise + squared_level * sag.stretch, 1.0))
        level = squared_level / (sag.bulge * lengths)
        energies = 0.5 * bounded * (level + lengths + squared_rise / lengths)
        rise_pulls = bounded / lengths
        level_pulls = rise_pulls / sag.bulge
        share = of_level * sag.stretch_slope
        share = share / (1.0 - share)  # minus the elasticity of the length to the tension
        missing = m - bounded
        if np.any(missing.real < 0.0):
            softer = missing / bounded
            of_x = -2.0 * (1.0 + share)
            of_bulge = of_x * sag.x * sag.bulge_slope / sag.bulge
            energies = energies + lengths * missing
            level_pulls = level_pulls * (1.0 + softer * (1.0 + share - of_bulge))
            rise_pulls = rise_pulls * (1.0 + softer * (1.0 + share))
        return Arcs(
            np.where(exists, lengths, 0.0),
            np.where(exists, lengths * share / bounded, 0.0),
            np.where(exists, energies, 0.0),
            np.where(exists, level_pulls, 0.0),
            np.where(exists, rise_pulls, 0.0),
        )

    def tensions(self, positions: Array) -> Array:
        """Return T (S, n) [N] for which cables have their lengths.

        Nodes are at positions (S, nodes, 3) [m]. Arcs are convex in T: after the first step,
        Newton's iteration is below the solution and does not overshoot.
        """
        spans = self.spans(positions[:, self.nodes])
        chord_sum = np.sum(spans.lengths, axis=-1)
        missing = chord_sum - self.lengths + self.compliance * self.reference
        lowest = np.maximum(self.slack_tension, missing / self.compliance)
        if not self.weight:
            return np.asarray(lowest)
        by_heights = self.weight * spans.heights
        T = np.maximum(lowest, self.reference)
        for _ in range(TENSION_ITERATIONS):
            arcs = self._arcs(spans, T[..., None] + by_heights)
            excess = missing - self.compliance * T + np.sum(arcs.lengths, axis=-1) - chord_sum
            slope = self.compliance + np.sum(arcs.softness, axis=-1)
            previous = T
            T = np.maximum(lowest, T + excess / slope)
            if (np.abs(T - previous) <= TENSION_TOLERANCE * T).all():
                break
        return np.asarray(T)

    def values(self, positions: Array) -> Array:
        """Return energies (S,) [J] of nodes at positions (S, nodes, 3) [m]."""
        cables = self.forces(positions[:, self.nodes], self.tensions(positions))
        energies = np.sum(cables.energies, axis=-1)
        energies += np.sum(self.springs(positions).energies, axis=(1, 2))
        return np.asarray(energies - np.einsum("sni,sni->s", self.loads, positions))

    def slopes(
        self, positions: Array, friction: float | Array = 0.0, T: Array | None = None
    ) -> Array:
        """Return minus the force on every node (S, nodes, 3) [N], zero for rigid drones.

        T are the ``tensions`` at these positions, if they are known.
        """
        T = self.tensions(positions) if T is None else T
        cables = self.forces(positions[:, self.nodes], T, friction)
        slopes = self.pulls(cables.on_ends)
        slopes[:, : self.drones] += self.springs(positions).slopes
        return np.where(self.free, slopes, 0.0)

    def springs(self, positions: Array) -> SpringForces:
        """Return energies of position loops and their derivatives.

        At rest, an integral has removed the error e or saturates at its largest force b, which has
        the energy b |e|, smoothed within INTEGRAL_ERROR.
        """
        errors = (positions - self.start)[:, : self.drones]
        smoothed = np.hypot(errors, INTEGRAL_ERROR)
        of_stiffness = 0.5 * self.stiffness * errors * errors
        of_integral = self.integral * (smoothed - INTEGRAL_ERROR)
        return SpringForces(
            energies=of_stiffness + of_integral,
            slopes=(self.stiffness + self.integral / smoothed) * errors,
            curvatures=self.stiffness + self.integral * INTEGRAL_ERROR**2 / smoothed**3,
        )

    def bends(self, positions: Array) -> Array:
        """Return the bends (S, n, 2) [rad] of cables at both clasps, zero without a leg."""
        bends = self._bends(self.spans(positions[:, self.nodes]).directions)
        return np.where(self.exist[:, ::2], bends, 0.0)

    def _bends(self, directions: Any) -> Any:
        """Return the bends (…, 2) [rad] between spans, times shares of friction if ``alike``."""
        bends = bends_of(directions)
        return bends * (bends / np.pi) if self.alike else bends

    def leg_pulls(self, positions: Array) -> Array:
        """Return pulls of legs (S, n, 2, 3) [N], toward the end of the cable, without weights."""
        spans = self.spans(positions[:, self.nodes])
        m = self.tensions(positions)[..., None] + self.weight * spans.heights
        pulls = self._arcs(spans, m).pulls(spans.chords)
        return np.asarray(pulls[..., ::2, :])

    def pulls(self, on_ends: Any) -> Any:
        """Return minus the forces of cables and loads on nodes (S, nodes, 3) [N]."""
        pulls = -self.loads.astype(on_ends.dtype)
        np.add.at(pulls.swapaxes(0, 1), self.nodes, np.moveaxis(on_ends, 0, 2))
        return pulls

    def linear(
        self, positions: Array, friction: float | Array = 0.0, T: Array | None = None
    ) -> CableSlopes:
        """Return derivatives of the cables' forces and tensions.

        Nodes are at positions (S, nodes, 3) [m]. They are complex-step derivatives with respect to
        the 12 coordinates of a cable's nodes, then to T; ``T`` is that of ``slopes``.
        """
        ends = positions[:, self.nodes]
        T = self.tensions(positions) if T is None else T
        variables = CABLE_COORDINATES + 1
        steps = 1j * COMPLEX_STEP * np.eye(variables).reshape(variables, 1, 1, variables)
        end_steps = steps[..., :CABLE_COORDINATES].reshape(variables, 1, 1, 4, 3)
        tension_steps = steps[..., CABLE_COORDINATES]
        perturbed = self.forces(ends + end_steps, T + tension_steps, friction)
        by_variable = np.moveaxis(perturbed.on_ends.imag / COMPLEX_STEP, 0, -1)
        forces = by_variable.reshape(*T.shape, CABLE_COORDINATES, variables)
        lengths = np.moveaxis(perturbed.lengths.imag / COMPLEX_STEP, 0, -1)
        softness = 1.0 / (self.compliance - lengths[..., CABLE_COORDINATES])
        softness = np.where(self.slack_tension >= T, 0.0, softness)
        tensions = softness[..., None] * lengths[..., :CABLE_COORDINATES]
        by_tension = forces[..., CABLE_COORDINATES:]
        forces[..., :CABLE_COORDINATES] += by_tension * tensions[..., None, :]
        return CableSlopes(forces, tensions, softness)

    def matrix(
        self, positions: Array, force_slopes: Array, damping: Array | float = MIN_DAMPING
    ) -> Array:
        """Return the Hessians (S, N, N) [N/m] of all samples, N = 3 nodes.

        Nodes are at positions (S, nodes, 3) [m]; ``force_slopes`` are the ``forces`` of ``linear``;
        ``damping`` (S,) [N/m] is added to the diagonal.
        """
        samples = len(force_slopes)
        size = 3 * len(self.free)
        first_entries = size * size * np.arange(samples)[:, None, None, None]
        coordinates = (3 * self.nodes[:, :, None] + np.arange(3)).reshape(-1, CABLE_COORDINATES)
        entries = size * coordinates[:, :, None] + coordinates[:, None, :]
        of_cables = force_slopes[..., :CABLE_COORDINATES]
        sums = np.bincount(
            (first_entries + entries).ravel(), of_cables.ravel(), samples * size * size
        )
        matrices = np.asarray(sums, dtype=np.float64).reshape(samples, size, size)
        springs = self.springs(positions).curvatures.reshape(samples, -1)
        diagonals = np.einsum("sii->si", matrices)
        diagonals += np.reshape(damping, (-1, 1))
        diagonals[:, : 3 * self.drones] += springs
        return matrices

    def solved(self, matrices: Array, forces: Array) -> Array:
        """Return displacements (S, nodes, 3, …) [m] caused by forces of this shape [N]."""
        samples, nodes, axes, *right_sides = forces.shape
        free = np.flatnonzero(self.free)
        displacements = np.zeros((samples, nodes * axes, math.prod(right_sides)))
        on_free = forces.reshape(displacements.shape)[:, free]
        displacements[:, free] = solutions_of(matrices[:, free[:, None], free], on_free)
        return displacements.reshape(forces.shape)

    def steps(
        self,
        positions: Array,
        damping: Array | float,
        max_length: float,
        friction: float | Array,
        tolerance: float = 0.0,
    ) -> tuple[Array, Array]:
        """Return Newton steps (S, nodes, 3) [m] of bounded length for each node, and the slopes.

        If no slope exceeds the ``tolerance`` [N], no node moves.
        """
        T = self.tensions(positions)
        slopes = self.slopes(positions, friction, T)
        if np.max(np.abs(slopes)) <= tolerance:
            return np.zeros_like(positions), slopes
        matrices = self.matrix(positions, self.linear(positions, friction, T).forces, damping)
        steps = self.solved(matrices, -slopes)
        longest = np.max(np.linalg.norm(steps, axis=-1), axis=1)
        shares = np.minimum(1.0, max_length / np.maximum(longest, 1e-300))
        return np.asarray(steps * shares[:, None, None]), slopes

    def at_rest(self) -> Array:
        """Return the nodes (S, nodes, 3) [m] of least energy, by a damped Newton method.

        Steps are halved until the energy decreases enough; damping grows if no step does. Forces
        are no merit function, as steps along stiff cables increase them. The caller recomputes the
        residuals.
        """
        positions = self.start
        damping = np.full(len(positions), MIN_DAMPING)
        values = self.values(positions)
        for _ in range(NEWTON_ITERATIONS):
            steps, slopes = self.steps(positions, damping, MAX_STEP, 0.0)
            tolerance = FORCE_TOLERANCE + self.accuracy * np.max(np.abs(positions), axis=(1, 2))
            active = np.max(np.abs(slopes), axis=(1, 2)) > tolerance
            if not active.any():
                break
            decreases = -np.einsum("sni,sni->s", steps, slopes)  # of the linear model
            previous = values
            rounding = ROUNDING * (1.0 + np.abs(previous))
            shares = np.where(active & (decreases > 0.0), 1.0, 0.0)
            for _ in range(HALVINGS):
                trial = positions + shares[:, None, None] * steps
                values = self.values(trial)
                too_high = values > previous - DESCENT * shares * decreases + rounding
                if not too_high.any():
                    break
                shares = np.where(too_high, 0.5 * shares, shares)
            positions = trial
            failed = (shares == 0.0) | too_high
            raised = np.clip(10.0 * damping, FIRST_DAMPING, MAX_DAMPING)
            lowered = np.maximum(0.1 * damping, MIN_DAMPING)
            damping = np.where(failed, raised, lowered)
        return positions

    @np.errstate(over="ignore", invalid="ignore")  # of friction that no balance bears
    def rest_with_friction(self, rest: Array, friction: float | Array) -> Array:
        """Return the nodes (S, nodes, 3) [m] at an end of the band; nan without convergence.

        ``rest`` are the nodes without friction. A positive coefficient lets legs pull more than
        edges, a negative one less; it is that of all legs, or of each (S, n, 2).
        """
        positions = rest
        failed = np.zeros((len(rest), 1, 1), dtype=np.bool_)
        tolerance = FRICTION_TOLERANCE + 10.0 * self.accuracy * float(np.max(np.abs(rest)))
        for share in FRICTION_LEVELS if np.any(friction) else ():
            for _ in range(FRICTION_ITERATIONS):
                steps, slopes = self.steps(
                    positions, MIN_DAMPING, MAX_FRICTION_STEP, share * friction
                )
                largest = np.max(np.abs(slopes), axis=(1, 2), keepdims=True)
                moving = ~failed & ~(largest <= tolerance)
                if not np.any(moving):
                    break
                positions = np.where(moving, positions + steps, positions)
            else:
                failed = failed | moving
                positions = np.where(failed, rest, positions)
        return np.where(failed, np.nan, positions)


def energy_of(
    team: Team, conditions: Mapping[str, Any], samples: Mapping[str, Array]
) -> HitchEnergy:
    """Return the energy of samples, see ``samples_of``."""
    layout = team.layout
    clasps = team.drones + np.arange(len(layout.clasps))
    count = team.drones + len(clasps)
    points = np.zeros(layout.points, dtype=np.intp)
    points[-1] = team.drones - 1  # ends of a chain are its outer drones
    points[layout.clasps] = clasps
    nodes = np.append(points, np.arange(team.drones))[layout.routes]
    drones = samples["positions"]
    vertices = samples["vertices"][:, layout.clasps]
    ends = np.concatenate([drones, vertices], axis=1)[:, nodes]
    longest = np.max(length(np.diff(ends, axis=2)), axis=-1)
    edge_heights = 0.5 * (ends[:, :, 1, 2] + ends[:, :, 2, 2])
    weight = GRAVITY * float(conditions["cable_density"])
    rigid = np.isinf(conditions["stiffness"])
    loads = np.zeros((len(ends), count, 3))
    feed_forward = conditions["feed_forward"][:, None] * samples["cable_forces"]
    loads[:, : team.drones] = samples["forces"] - feed_forward
    loads[:, team.drones :, 2] = -GRAVITY * conditions["load"]
    free = np.ones((count, 3), dtype=np.bool_)
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
        heights=edge_heights,
        slack_tension=SLACK_RATIO * weight * longest,
    )


def bends_of(directions: Any) -> Any:
    """Return the bends (…, 2) [rad] between consecutive spans with directions (…, 3, 3)."""
    cosines = cosines_of(directions)
    valid = np.abs(cosines.real) < 1.0
    return bend(np.where(valid, cosines, np.sign(cosines.real)))


def cosines_of(directions: Any) -> Any:
    """Return cosines (…, 2) of the angles between consecutive spans with directions (…, 3, 3)."""
    return np.sum(directions[..., 1:, :] * directions[..., :-1, :], axis=-1)


def solutions_of(matrices: Array, right_sides: Array) -> Array:
    """Return the solutions of linear systems (S, …), nan where a matrix is singular."""
    try:
        return np.asarray(np.linalg.solve(matrices, right_sides))
    except np.linalg.LinAlgError:
        if len(matrices) == 1:
            return np.full_like(right_sides, np.nan)
    pairs = zip(matrices[:, None], right_sides[:, None], strict=True)
    return np.concatenate([solutions_of(*pair) for pair in pairs])
