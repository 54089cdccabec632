"""Tied hitches whose cables slide through their clasps: three elastic segments per cable.

A cable runs from drone q through two clasps to drone r: a leg, an edge and a leg. There are no
links, hence nothing that catches. All arrays begin with an axis of flights of the same team.

Segments. A segment of weight w per length, unstretched length a and tension T at the height of its
middle hangs in an arc of the length ``s (1 + w² h² / (24 T²))``, for a chord s with a horizontal
part h. That is its stretched length ``a (1 + T/EA)``; T makes one Newton step per time step. Half
of the weight acts on each end.

Masses. A clasp has half of the mass of the four segments that end at it, and its load. Clasps of
cables without weight have a small mass, but no weight.

Friction. A cable sticks to its clasp while ``|ln(T_leg/T_edge)| < μ θ``, where θ is its angle of
wrap (the capstan equation). Both cables of a clasp share one contact, in which friction opposes
their relative velocity and is at most μ times the contact force. Their tangents cross there at an
angle α. With z = (x, y), their ``ln(T_leg/T_edge) / (μ θ)``, the components of such a friction
along both tangents satisfy

    zᵀ G z = x² + y² + 2 x y cos α ≤ sin² α.

Slips maximise the dissipation: they are normal to this ellipse. Each time step takes the tensions
of stuck cables, and returns z to the ellipse along its normal by slips (return mapping, as in
plasticity; both cables are taken to be equally stiff), so there is no smallest speed of sliding.
"""

from __future__ import annotations

import math

import numpy as np

from hitchopt.geometry.vectors import cross_product, dot, length, skew_matrix, unit
from hitchopt.hitch import GRAVITY, Team
from hitchopt.hitch.team import Layout
from hitchopt.lab.simulation.world import RigidBodies, inertia_of
from hitchopt.values import Array

AXIAL_STIFFNESS = 100.0
"""[N] Axial stiffness EA: cables stretch by 0.4 % at 0.4 N, which their planned length includes."""

CROSSING = math.radians(60.0)
"""[rad] Angle α at which the tangents of both cables of a clasp cross.

It is fitted, not derived: after three morphs of a triangle at μ = 0.1, vertices rest within 0.8 cm
of those of ropes with links of 10 mm. With 45° and 75° they are up to 0.7 and 1.1 cm off."""

PARTS = 0.5 * np.array([[1.0, 1.0], [1.0, -1.0]])
"""Common and opposite part of x and y, from these; twice it is its inverse."""

EIGENVALUES = 1.0 + math.cos(CROSSING) * np.array([[1.0], [-1.0]])
"""Eigenvalues of G, for both parts."""

MAX_STEP = 0.001
"""[s] Longest time step of the cables. Steps of 2 ms excite the drones on their elastic cables."""

DAMPING_TIME = 0.01
"""[s] Kelvin-Voigt time of the cables: damping over stiffness."""

AIR_DECAY = 1.0
"""[1/s] Rate at which the air damps the clasps."""

MIN_MASS = 0.004
"""[kg] Smallest inertia of a clasp, so that time steps resolve its vibrations."""

SLACK_SAG = 0.25
"""Sag over chord of a cable whose tension is not computed any further."""

TINY = 1e-4
"""[N] Smallest tension in ratios. Also the smallest μ θ, which moves vertices by under 0.1 mm."""

MIN_LEG = 0.02
"""[m] Unstretched length below which a segment's stiffness no longer grows."""

UPWARD = np.array([[1.0], [-1.0]])
"""Signs of rises toward the clasp, along legs of the cables ahead of and behind it."""

SWEEPS = 4
"""Iterations of the ratios of tensions at the clasps. For given ratios slips are exact: otherwise
they excite cables without friction, most of all at short edges."""


class Network:
    """Which nodes the segments join, and at which clasps: nodes are the points, then the drones.

    Attributes
    ----------
    routes: nodes along each cable (n, 4), from q to r. The end of a chain is its drone.
    cables: cable of each segment (segments,).
    differences: matrix (segments, nodes) from positions to the segments' vectors.
    halves: halves of each segment at its two nodes (segments, nodes).
    legs, edges: segments at each clasp (2, clasps), of the cable whose edge starts there, and of
        the one whose edge ends there.
    other_ends: matrix (2 · clasps, 2 · clasps) from slips to those at the other ends of the edges.
    lengthening: matrix (2 · clasps, segments) from slips to changes of unstretched lengths.
    """

    def __init__(self, layout: Layout) -> None:
        count = layout.points + 2 * layout.robots
        self.cables, kinds = np.divmod(layout.parts, 3)
        self.routes = layout.routes.copy()
        for point, drone in ((1, 0), (2, 3)):
            alone = ~layout.has_leg[:, drone // 3]
            self.routes[alone, point] = self.routes[alone, drone]
        starts, ends = self.routes[self.cables, kinds], self.routes[self.cables, kinds + 1]
        nodes = np.eye(count)
        self.differences: Array = nodes[ends] - nodes[starts]
        self.halves: Array = 0.5 * np.abs(self.differences)
        segments = np.zeros((layout.robots, 3), dtype=np.intp)
        segments[self.cables, kinds] = np.arange(len(kinds))
        ahead, behind = layout.ahead, layout.behind
        self.legs = np.stack([segments[ahead, 0], segments[behind, 2]])
        self.edges = np.stack([segments[ahead, 1], segments[behind, 1]])
        edges = self.edges.ravel()
        is_other = (edges[:, None] == edges) & ~np.eye(len(edges), dtype=np.bool_)
        self.other_ends: Array = is_other.astype(np.float64)
        each = np.eye(len(kinds))
        self.lengthening: Array = each[self.legs.ravel()] - each[edges]

    def shares(self, chords: Array) -> Array:
        """Return the shares (segments,) of segments in the chords [m] of their cables."""
        by_cable = np.bincount(self.cables, chords)
        return np.asarray(chords / by_cable[self.cables])


class ClaspWorld:
    """Drones at the ends of cables that slide through clasps, in several flights of a team.

    Its hitch is formed, with ``vertices`` (points, 3) [m] and ``tension`` (n,) [N], and its drones
    have the state ``bodies`` (2n, …) in all flights. Cables of the unstretched ``lengths``
    (flights, n) [m] and of a ``density`` [kg/m] are divided like the hitch's chords.

    Attributes
    ----------
    masses, inertia: of the drones of all flights (flights · 2n,) [kg], (flights · 2n, 3) [kg m²].
    friction: coefficient at the clasps.
    tensions: at the middles of the segments (flights, segments) [N].
    slid: length that slid through clasps (flights, 2, clasps) [m], of both cables.
    """

    def __init__(
        self,
        team: Team,
        vertices: Array,
        bodies: RigidBodies,
        lengths: Array,
        tension: Array,
        density: float,
    ) -> None:
        layout, flights = team.layout, len(lengths)
        self.friction = 0.0
        self.masses = np.tile(team.mass, flights)
        self.inertia = inertia_of(self.masses)
        self._flights, self._points, self._clasps = flights, layout.points, layout.clasps
        self._weight = GRAVITY * density  # per length [N/m]
        positions = np.concatenate([vertices, bodies.positions])
        velocities = np.concatenate([np.zeros_like(vertices), bodies.velocities])
        self._positions = np.tile(positions, (flights, 1, 1))
        self._velocities = np.tile(velocities, (flights, 1, 1))
        self._attitudes = np.tile(bodies.attitudes, (flights, 1, 1))
        self._rates = np.tile(bodies.rates, (flights, 1))
        self._network = network = Network(layout)
        chords = length(network.differences @ positions)
        self._unstretched = network.shares(chords) * lengths[:, network.cables]
        self._slack = self._weight / (8.0 * SLACK_SAG) * float(np.max(chords)) + TINY
        taut = np.maximum(tension[network.cables], self._slack)
        self.tensions = np.tile(taut, (flights, 1))
        self._slips = np.zeros((flights, *network.legs.shape))  # to the legs, in the last step [m]
        self._last_slips = self._slips
        self._multiplier = np.zeros((flights, 1, len(layout.clasps)))  # λ in the last step
        self.slid = np.zeros_like(self._slips)
        load = np.concatenate([np.zeros(layout.points), team.mass])
        load[layout.clasps] = team.load
        carried = density * (network.shares(chords) * team.cable_length[network.cables])
        masses = load + carried @ network.halves
        masses[layout.points :] = team.mass
        masses = np.maximum(masses, MIN_MASS)[:, None]
        self._per_mass = 1.0 / masses
        self._decay = AIR_DECAY * masses
        self._decay[layout.points :] = 0.0
        self._gravity = np.zeros_like(positions)
        self._gravity[:, 2] = -GRAVITY * load
        self._constant = np.tile(self._gravity, (flights, 1, 1))  # forces during a step [N]
        self._thrusts = np.zeros(len(self.masses))
        self._moments = self._forces = np.zeros_like(self._rates)

    @property
    def drones(self) -> Array:
        """Positions of the drones (flights · 2n, 3) [m]."""
        return self._positions[:, self._points :].reshape(-1, 3)

    @property
    def vertices(self) -> Array:
        """Positions of the clasps (flights, clasps, 3) [m]."""
        return self._positions[:, self._clasps]

    @property
    def bodies(self) -> RigidBodies:
        """State of the drones of all flights (flights · 2n, …)."""
        velocities = self._velocities[:, self._points :].reshape(-1, 3)
        return RigidBodies(self.drones, velocities, self._attitudes, self._rates)

    @property
    def nodes(self) -> Array:
        """Nodes of the cables (flights, n, 4, 3) [m], from q to r."""
        return self._positions[:, self._network.routes]

    @property
    def mean_tensions(self) -> Array:
        """Tensions of cables (flights, n) [N], averaged over their lengths."""
        cables = np.eye(len(self._network.routes))[self._network.cables]
        lengths = np.maximum(self._unstretched, 0.0)
        mean = (lengths * np.maximum(self.tensions, 0.0)) @ cables / (lengths @ cables)
        return np.asarray(mean)

    @property
    def largest_tensions(self) -> Array:
        """Largest tensions of cables (flights, n) [N]."""
        of_cable = self._network.cables == np.arange(len(self._network.routes))[:, None]
        return np.asarray(np.max(np.where(of_cable, self.tensions[:, None], 0.0), axis=-1))

    @property
    def bearing(self) -> Array:
        """Contact forces of the clasps (flights, clasps) [N]: pulls of leg and edge ahead."""
        vectors = self._network.differences @ self._positions
        pulls = np.maximum(self.tensions, 0.0)[..., None] * unit(vectors)
        return length(pulls[:, self._network.edges[0]] - pulls[:, self._network.legs[0]])

    @property
    def shortest_leg(self) -> tuple[float, int]:
        """Unstretched length [m] and clasp of the shortest leg of all flights."""
        legs = np.min(self._unstretched[:, self._network.legs], axis=(0, 1), initial=np.inf)
        clasp = int(np.argmin(legs))
        return float(legs[clasp]), clasp

    def push(self, thrusts: Array, moments: Array, forces: Array) -> None:
        """Apply thrusts (…,) and moments about the bodies' axes, and forces (…, 3) [N]."""
        self._thrusts, self._moments, self._forces = thrusts, moments, forces

    def step(self, seconds: float) -> None:
        """Advance by some time, with the thrusts' directions at its middle."""
        self._turn(0.5 * seconds)
        applied = self._forces + self._thrusts[:, None] * self._attitudes[:, :, 2]
        self._constant = np.tile(self._gravity, (self._flights, 1, 1))
        self._constant[:, self._points :] += applied.reshape(self._flights, -1, 3)
        count = max(1, math.ceil(seconds / MAX_STEP - 1e-9))
        dt = seconds / count
        for _ in range(count):
            force = self._constant - self._decay * self._velocities + self._cable_forces(dt)
            self._velocities = self._velocities + dt * self._per_mass * force
            self._positions = self._positions + dt * self._velocities
        self._turn(0.5 * seconds)

    def _turn(self, dt: float) -> None:
        """Turn the drones for some time [s]."""
        rates, inertia = self._rates, self.inertia
        moments = self._moments - cross_product(rates, inertia * rates)
        self._rates = rates + dt * moments / inertia
        step = skew_matrix(0.5 * dt * (rates + self._rates))
        turned = self._attitudes + self._attitudes @ (step + 0.5 * (step @ step))
        # One Newton step to the nearest rotation
        self._attitudes = 1.5 * turned - 0.5 * (turned @ (turned.transpose(0, 2, 1) @ turned))

    def _cable_forces(self, dt: float) -> Array:
        """Advance tensions by one time step [s]; return the cables' forces on nodes [N]."""
        before, weight = self.tensions, self._weight
        vectors = self._network.differences @ self._positions
        squares = vectors * vectors
        level = squares[..., 0] + squares[..., 1]
        chords = np.sqrt(level + squares[..., 2])
        tension = np.maximum(before, self._slack)
        steepness = weight**2 / 24.0 / (tension * tension)
        sags = steepness * level
        arcs = chords * (1.0 + sags)
        lengths = self._unstretched
        compliance = np.maximum(lengths, MIN_LEG) / AXIAL_STIFFNESS + 2.0 * chords * sags / tension
        extensions = arcs - lengths * (1.0 + before / AXIAL_STIFFNESS)
        trial = np.maximum(before + extensions / compliance, -self._slack)
        slips = self._returned(vectors, chords, trial, 1.0 / compliance)
        change = slips.reshape(self._flights, -1) @ self._network.lengthening
        self.tensions = tension = trial - change / compliance
        self._unstretched = lengths + change
        damped = tension + (DAMPING_TIME / dt) * (tension - before)
        pulls = np.where(tension > 0.0, np.maximum(damped, 0.0), 0.0)
        along = pulls * (1.0 - sags) / chords
        forces = vectors * along[..., None]
        forces[..., :2] -= vectors[..., :2] * (2.0 * steepness * pulls * chords)[..., None]
        on_nodes = -self._network.differences.T @ forces
        on_nodes[..., 2] -= (weight * arcs) @ self._network.halves
        return np.asarray(on_nodes)

    def _returned(self, vectors: Array, chords: Array, trial: Array, stiffness: Array) -> Array:
        """Return the slips (flights, 2, clasps) [m] from edges to legs in one time step.

        ``trial`` are the tensions [N] of cables that stick, ``stiffness`` [N/m] their increase per
        extension.
        """
        legs, edges = self._network.legs, self._network.edges
        units = vectors / chords[..., None]
        cosines = dot(units[:, legs], units[:, edges])
        wraps = np.arccos(np.minimum(np.maximum(cosines, -1.0), 1.0))
        limits = np.maximum(self.friction * wraps, TINY)
        # Tensions at the clasps' heights, from those at the middles of the segments
        rises = (0.5 * self._weight) * vectors[..., 2]
        leg = np.maximum(trial[:, legs] + UPWARD * rises[:, legs], TINY)
        edge = trial[:, edges] - UPWARD * rises[:, edges]
        leg_stiffness, edge_stiffness = stiffness[:, legs], stiffness[:, edges]
        slips = 2.0 * self._slips - self._last_slips
        for _ in range(SWEEPS):
            now = np.maximum(edge + edge_stiffness * self._at_other_ends(slips), TINY)
            ratio = np.exp(limits * self._nearest(np.log(leg / now) / limits))
            stiffness = leg_stiffness + ratio * edge_stiffness
            alone = (leg - ratio * edge) / stiffness  # if the edge's other end sticks
            response = ratio * edge_stiffness / stiffness  # to a slip there
            both = alone - response * self._at_other_ends(alone)
            slips = both / (1.0 - response * self._at_other_ends(response))
        self._last_slips, self._slips = self._slips, slips
        self.slid += np.abs(slips)
        return slips

    def _at_other_ends(self, values: Array) -> Array:
        """Return values (flights, 2, clasps) at the edges' other ends; 0 at the ends of chains."""
        others = values.reshape(self._flights, -1) @ self._network.other_ends
        return np.asarray(others.reshape(values.shape))

    def _nearest(self, z: Array) -> Array:
        """Return the points of the ellipse nearest to z (flights, 2, clasps); z itself inside.

        The ellipse's axes are the common and the opposite part of z, which the point shrinks by 1 +
        λ times the eigenvalues. λ takes one step per call of the iteration of Moré and Sorensen for
        trust regions, for which ``1/sqrt(zᵀ G z)`` is almost linear.
        """
        parts = PARTS @ z
        multiplier = self._multiplier
        shrunk = 1.0 / (1.0 + EIGENVALUES * multiplier)
        squares = (2.0 * EIGENVALUES) * (parts * shrunk) ** 2
        square = np.add.reduce(squares, axis=1, keepdims=True) + TINY**2
        slope = np.add.reduce(EIGENVALUES * shrunk * squares, axis=1, keepdims=True) + TINY**3
        excess = np.sqrt(square) * (1.0 / math.sin(CROSSING)) - 1.0
        self._multiplier = multiplier = np.maximum(multiplier + square * excess / slope, 0.0)
        nearest: Array = 2.0 * PARTS @ (parts / (1.0 + EIGENVALUES * multiplier))
        return nearest
