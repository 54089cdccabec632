"""Tied hitches whose cables slide through their clasps: three elastic segments per cable.

A cable runs from drone q through two clasps to drone r: a leg, an edge and a leg. There are no
links, hence nothing that catches. All arrays begin with an axis of flights of the same team.

Segments. A segment of weight w per length, unstretched length a and tension T at the height of its
middle hangs in an arc of the length ``s (1 + w² h² / (24 T²))``, for a chord s with a horizontal
part h. That is its stretched length ``a (1 + T/EA)``; T makes one Newton step per time step. Half
of the weight acts on each end.

Masses. A clasp has half of the mass of the four segments that end at it, and its load. Clasps of
cables without weight have a small mass, but no weight.

Friction. Cables twist about each other as in ``hitch.twists``, cross at θ, and bend by β. A cable
that slides alone has ``|ln(T_leg/T_edge)| = μ β``. With z = (x, y), their ``ln(T_leg/T_edge) / (μ
β)``, cables of a clasp satisfy

    zᵀ G z = x² + y² + 2 x y cos θ ≤ sin² θ.

Slips maximise the dissipation: they are normal to this ellipse. Each time step takes the tensions
of stuck cables, and returns z to the ellipse along its normal by slips (return mapping, as in
plasticity; both cables are taken to be equally stiff), so there is no smallest speed of sliding.
"""

from __future__ import annotations

import math

import numpy as np

from hitchopt.geometry.vectors import cross_product, length, skew_matrix
from hitchopt.hitch import GRAVITY, Team
from hitchopt.hitch.team import Layout
from hitchopt.hitch.twists import bend
from hitchopt.lab.simulation.world import RigidBodies, inertia_of
from hitchopt.values import Array

AXIAL_STIFFNESS = 100.0
"""[N] Axial stiffness EA: cables stretch by 0.4 % at 0.4 N, which their planned length includes."""

MAX_STEP = 0.001
"""[s] Longest time step of the cables. Steps of 2 ms excite the drones on their elastic cables."""

DAMPING_TIME = 0.01  # [s] Kelvin-Voigt time of the cables: damping over stiffness
AIR_DECAY = 1.0  # [1/s] Rate at which the air damps the clasps
MIN_MASS = 0.004  # [kg] Smallest inertia of a clasp, so that time steps resolve its vibrations
SLACK_SAG = 0.25  # Sag over chord of a cable whose tension is not computed any further

TINY = 1e-4
"""[N] Smallest tension in ratios. Also the smallest limit of their logarithms, which moves vertices
by under 0.1 mm, and half-axis of the ellipse."""

MIN_LEG = 0.02  # [m] Unstretched length below which a segment's stiffness no longer grows

MAX_SWEEPS = 8
"""Most iterations of the slips of one time step. Slips at both ends of an edge are solved for
together, since otherwise they excite short edges."""

SLIP_TOLERANCE = 1e-7
"""[m] Change of slips below which they have converged, mostly in one iteration: vertices are within
a micrometre of those with many more, or within a millimetre at edges of 0.1 m."""


class Network:
    """Which nodes the segments join, and where cables bend: nodes are the points, then the drones.

    Every edge has two ends, at clasps or, without a leg, at the ends of a chain: 2n ends, first the
    starts of all edges, then their ends.

    Attributes
    ----------
    routes: nodes along each cable (n, 4), from q to r. The end of a chain is its drone.
    cables: cable of each segment (segments,), in order; ``firsts`` (n,) are their first segments.
    differences: matrix (nodes, segments) from positions to the segments' vectors.
    on_nodes: matrix (segments, nodes) from pulls of segments to forces on their nodes.
    halves: halves of each segment at its two nodes (segments, nodes).
    beside: segments at the ends (4n,): first their legs, then their edges; without a leg, twice the
        edge.
    at_clasps: ends of the cables ahead of and behind each clasp (2, clasps).
    fixed: whether an end is that of a chain, through which nothing slides (2n,).
    to_ends: signs (4n,) of the rises of these segments, from their middles to the ends.
    others: matrix (2n, 2n) from values at ends to those at the edges' other ends.
    lengthening: matrix (2n, segments) from slips to changes of unstretched lengths.
    parts: matrix (2n, 2 · clasps) from x and y of the clasps to their common and their opposite
        parts, along the axes of the ellipse.
    joined: its inverse (2 · clasps, 2n), with zeros at the ends of chains.
    averages: matrix (2 · clasps, 2n) from values of the parts to their averages, at the ends.
    crossings: matrix (2n, 2 · clasps) from cosines at the ends to the average of each clasp, for
        its common part, and its negative.
    sums, pairs: matrices from values of the parts (2 · clasps, 2 · clasps), or of the ends (2n,
        2n), to the sums of both at their clasp.
    """

    def __init__(self, layout: Layout) -> None:
        count, robots = layout.points + 2 * layout.robots, layout.robots
        self.cables, kinds = np.divmod(layout.parts, 3)
        self.firsts = np.searchsorted(self.cables, np.arange(robots))
        self.routes = layout.routes.copy()
        for point, drone in ((1, 0), (2, 3)):
            alone = ~layout.has_leg[:, drone // 3]
            self.routes[alone, point] = self.routes[alone, drone]
        starts, ends = self.routes[self.cables, kinds], self.routes[self.cables, kinds + 1]
        nodes = np.eye(count)
        between: Array = nodes[ends] - nodes[starts]
        self.differences = between.T.copy()
        self.on_nodes = -between
        self.halves: Array = 0.5 * np.abs(between)
        segments = np.zeros((robots, 3), dtype=np.intp)
        segments[self.cables, kinds] = np.arange(len(kinds))
        edges = np.tile(segments[:, 1], 2)
        self.fixed = ~layout.has_leg.T.ravel()
        legs = np.where(self.fixed, edges, segments[:, [0, 2]].T.ravel())
        self.beside = np.concatenate([legs, edges])
        self.to_ends = np.repeat([1.0, -1.0, -1.0, 1.0], robots)
        self.others: Array = np.roll(np.eye(2 * robots), robots, axis=0)
        each = np.eye(len(kinds))
        self.lengthening: Array = each[legs] - each[edges]
        self.at_clasps = np.stack([layout.ahead, robots + layout.behind])
        ahead, behind = np.eye(2 * robots)[self.at_clasps]
        self.joined: Array = np.concatenate([ahead + behind, ahead - behind])
        self.parts: Array = 0.5 * self.joined.T
        self.averages: Array = 0.5 * np.abs(self.joined)
        self.crossings: Array = self.averages.T * np.repeat([1.0, -1.0], len(ahead))
        self.sums: Array = np.tile(np.eye(len(ahead)), (2, 2))
        self.pairs: Array = (ahead + behind).T @ (ahead + behind)

    def shares(self, chords: Array) -> Array:
        """Return the shares (segments,) of segments in the chords [m] of their cables."""
        by_cable = np.bincount(self.cables, chords)
        return np.asarray(chords / by_cable[self.cables])


class ClaspWorld:
    """Drones at the ends of cables that slide through clasps, in several flights of a team.

    Its hitch is formed, with ``vertices`` (points, 3) [m] and ``tension`` (n,) [N], and its drones
    have the state ``bodies`` (2n, …) in all flights. Cables of the unstretched ``lengths``
    (flights, n) [m] and of a ``density`` [kg/m] are divided like the hitch's chords.

    Vectors of nodes and segments are (3 · flights, …), so that one product of matrices gives all
    segments. Products are written ``a.dot(b)``, and constants have the shape of what they multiply:
    for small arrays both take a third of the time.

    Attributes
    ----------
    masses, inertia: of the drones of all flights (flights · 2n,) [kg], (flights · 2n, 3) [kg m²].
    friction: coefficient at the clasps.
    tensions: at the middles of the segments (flights, segments) [N].
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
        nodes = np.concatenate([vertices, bodies.positions]).T
        speeds = np.concatenate([np.zeros_like(vertices), bodies.velocities]).T
        self._positions = np.repeat(nodes, flights, axis=0)
        self._velocities = np.repeat(speeds, flights, axis=0)
        self._attitudes = np.tile(bodies.attitudes, (flights, 1, 1))
        self._rates = np.tile(bodies.rates, (flights, 1))
        self._network = network = Network(layout)
        chords = length((nodes @ network.differences).T)
        self._unstretched = network.shares(chords) * lengths[:, network.cables]
        self._slack = self._weight / (8.0 * SLACK_SAG) * float(np.max(chords)) + TINY
        taut = np.maximum(tension[network.cables], self._slack)
        self.tensions = np.tile(taut, (flights, 1))
        # From edges to legs, in the last steps (flights, 2n) [m]
        self._slips = self._last_slips = np.zeros((flights, len(network.fixed)))
        self._multiplier = np.zeros((flights, len(network.joined)))  # λ, for both parts
        self._shrinking = np.ones_like(self._multiplier)  # by it
        self._rigid = np.tile(np.where(network.fixed, np.inf, 0.0), (flights, 1))
        self._to_ends = np.tile(0.5 * self._weight * network.to_ends, (flights, 1))
        load = np.concatenate([np.zeros(layout.points), team.mass])
        load[layout.clasps] = team.load
        carried = density * (network.shares(chords) * team.cable_length[network.cables])
        masses = load + carried @ network.halves
        masses[layout.points :] = team.mass
        axes = 3 * flights
        self._per_mass = np.tile(1.0 / np.maximum(masses, MIN_MASS), (axes, 1))
        decay = np.where(np.arange(len(masses)) < layout.points, AIR_DECAY, 0.0)
        self._decay = np.tile(decay, (axes, 1))
        self._gravity = np.zeros_like(self._positions)
        self._gravity[-flights:] = -GRAVITY * load
        self._thrusts = np.zeros(len(self.masses))
        self._moments = self._forces = np.zeros_like(self._rates)

    @property
    def drones(self) -> Array:
        """Positions of the drones (flights · 2n, 3) [m]."""
        return self._of_nodes(self._positions)[:, :, self._points :].reshape(3, -1).T

    @property
    def vertices(self) -> Array:
        """Positions of the clasps (flights, clasps, 3) [m]."""
        return self._of_nodes(self._positions)[:, :, self._clasps].transpose(1, 2, 0)

    @property
    def bodies(self) -> RigidBodies:
        """State of the drones of all flights (flights · 2n, …)."""
        velocities = self._of_nodes(self._velocities)[:, :, self._points :].reshape(3, -1).T
        return RigidBodies(self.drones, velocities, self._attitudes, self._rates)

    @property
    def nodes(self) -> Array:
        """Nodes of the cables (flights, n, 4, 3) [m], from q to r."""
        return np.moveaxis(self._of_nodes(self._positions)[:, :, self._network.routes], 0, -1)

    def _of_nodes(self, vectors: Array) -> Array:
        """Return vectors of nodes as (3, flights, nodes)."""
        return vectors.reshape(3, self._flights, -1)

    @property
    def mean_tensions(self) -> Array:
        """Tensions of cables (flights, n) [N], averaged over their lengths."""
        firsts, lengths = self._network.firsts, self._unstretched
        sums = np.add.reduceat(lengths * np.maximum(self.tensions, 0.0), firsts, axis=1)
        return np.asarray(sums / np.add.reduceat(lengths, firsts, axis=1))

    @property
    def largest_tensions(self) -> Array:
        """Largest tensions of cables (flights, n) [N]."""
        largest = np.maximum.reduceat(self.tensions, self._network.firsts, axis=1)
        return np.asarray(np.maximum(largest, 0.0))

    @property
    def bearing(self) -> Array:
        """Contact forces of the clasps (flights, clasps) [N]: pulls of leg and edge ahead."""
        vectors = self._positions.dot(self._network.differences)
        _, chords, _ = self._sizes(vectors)
        pulls = self._of_nodes(vectors) * (np.maximum(self.tensions, 0.0) / chords)
        ahead = self._network.at_clasps[0]
        legs, edges = (self._network.beside[start + ahead] for start in (0, self._slips.shape[1]))
        forces = pulls[:, :, edges] - pulls[:, :, legs]
        return np.asarray(np.sqrt(np.add.reduce(forces * forces, axis=0)))

    @property
    def shortest_leg(self) -> tuple[float, int]:
        """Unstretched length [m] and clasp of the shortest leg of all flights."""
        legs = self._network.beside[self._network.at_clasps]
        lengths = np.minimum.reduce(self._unstretched[:, legs], axis=(0, 1))
        clasp = int(np.argmin(lengths))
        return float(lengths[clasp]), clasp

    def push(self, thrusts: Array, moments: Array, forces: Array) -> None:
        """Apply thrusts (…,) and moments about the bodies' axes, and forces (…, 3) [N]."""
        self._thrusts, self._moments, self._forces = thrusts, moments, forces

    def step(self, seconds: float) -> None:
        """Advance by some time, with the thrusts' mean directions."""
        before = self._attitudes[:, :, 2]
        self._turn(seconds)
        directions = 0.5 * (before + self._attitudes[:, :, 2])
        applied = self._forces + self._thrusts[:, None] * directions
        constant = self._gravity.copy()  # forces during the step [N]
        of_drones = self._of_nodes(constant)[:, :, self._points :]
        of_drones += applied.T.reshape(3, self._flights, -1)
        count = max(1, math.ceil(seconds / MAX_STEP - 1e-9))
        dt = seconds / count
        keep, per_force = 1.0 - dt * self._decay, dt * self._per_mass
        for _ in range(count):
            force = constant + self._cable_forces(dt)
            self._velocities = keep * self._velocities + per_force * force
            self._positions = self._positions + dt * self._velocities

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
        network, lengths, before = self._network, self._unstretched, self.tensions
        vectors = self._positions.dot(network.differences)
        level, chords, rises = self._sizes(vectors)
        tension = np.maximum(before, self._slack)
        bends = self._weight**2 / 24.0 / (tension * tension)
        sags = bends * level
        added = chords * sags
        arcs = chords + added
        stretch = np.maximum(lengths, MIN_LEG) / AXIAL_STIFFNESS
        stiffness = 1.0 / (stretch + 2.0 * (added / tension))
        extensions = arcs - lengths - lengths * before / AXIAL_STIFFNESS
        trial = np.maximum(before + extensions * stiffness, -self._slack)
        slips = self._returned(self._cosines(vectors, chords), rises, trial, stiffness)
        change = slips.dot(network.lengthening)
        self.tensions = tension = trial - change * stiffness
        self._unstretched = lengths + change
        damped = tension + (DAMPING_TIME / dt) * (tension - before)
        pulls = np.maximum(damped, 0.0) * (tension > 0.0)
        along = (1.0 - sags) * pulls / chords
        level_along = along - 2.0 * (bends * pulls * chords)
        forces = vectors * np.concatenate([level_along, level_along, along])
        on_nodes = forces.dot(network.on_nodes)
        on_nodes[-self._flights :] -= (self._weight * arcs).dot(network.halves)
        return np.asarray(on_nodes)

    def _sizes(self, vectors: Array) -> tuple[Array, Array, Array]:
        """Return squared horizontal parts [m²], lengths and vertical parts [m] of segments."""
        flights = self._flights
        squares = vectors * vectors
        level = squares[:flights] + squares[flights:-flights]
        return level, np.sqrt(level + squares[-flights:]), vectors[-flights:]

    def _cosines(self, vectors: Array, chords: Array) -> Array:
        """Return the cosines (flights, 2n) of the angles by which cables turn at the ends."""
        flights, ends = self._flights, self._slips.shape[1]
        beside, sizes = (each.take(self._network.beside, -1) for each in (vectors, chords))
        products = beside[:, :ends] * beside[:, ends:]
        sums = products[:flights] + products[flights:-flights] + products[-flights:]
        return np.asarray(sums / (sizes[:, :ends] * sizes[:, ends:]))

    def _returned(self, cosines: Array, rises: Array, trial: Array, stiffness: Array) -> Array:
        """Return the slips (flights, 2n) [m] from edges to legs in one time step.

        ``cosines`` are those of ``_cosines``, ``rises`` the segments' vertical parts [m]. ``trial``
        are the tensions [N] of cables that stick, ``stiffness`` [N/m] their increase per extension.
        """
        network, ends = self._network, cosines.shape[1]
        others, beside = network.others, network.beside
        limits = np.maximum(self.friction * bend(np.minimum(cosines, 1.0)), TINY)
        eigenvalues = 1.0 + cosines.dot(network.crossings)  # of G
        half_axes = np.maximum(np.sqrt(np.maximum(1.0 - 0.5 * eigenvalues, 0.0)), TINY)
        # Tensions at the clasps' heights, from those at the middles of the segments
        tensions = trial.take(beside, -1) + self._to_ends * rises.take(beside, -1)
        leg, edge = np.maximum(tensions[:, :ends], TINY), tensions[:, ends:]
        stiffness = stiffness.take(beside, -1)
        leg_stiffness, edge_stiffness = stiffness[:, :ends] + self._rigid, stiffness[:, ends:]
        slips = 2.0 * self._slips - self._last_slips
        for _ in range(MAX_SWEEPS):
            added = edge_stiffness * slips.dot(others)
            z = np.log(leg / np.maximum(edge + added, TINY)) / limits
            nearest = self._nearest(z, eigenvalues, half_axes)
            ratio = np.exp(limits * nearest)
            # Shares to which ratios, instead of slips, follow a slip at the edge's other end: 1
            # where cables stick, and 0 along the normal of the ellipse
            normal = z - nearest
            squares = normal * normal
            across = 1.0 - squares / (squares.dot(network.pairs) + TINY**3)
            follows = across * self._shrinking.dot(network.averages)
            coupling = ratio * edge_stiffness
            stiffness = leg_stiffness + coupling
            alone = (leg - ratio * (edge + follows * added)) / stiffness
            response = (1.0 - follows) * coupling / stiffness
            both = alone - response * alone.dot(others)
            estimate, slips = slips, both / (1.0 - response * response.dot(others))
            if np.maximum.reduce(np.abs(slips - estimate), axis=None) < SLIP_TOLERANCE:
                break
        self._last_slips, self._slips = self._slips, slips
        return slips

    def _nearest(self, z: Array, eigenvalues: Array, half_axes: Array) -> Array:
        """Return the points of the ellipse nearest to z (flights, 2n); z itself inside.

        The ellipse's axes are the common and the opposite part of z, which the point shrinks by 1 +
        λ times the eigenvalues. λ takes one step per call of the iteration of Moré and Sorensen for
        trust regions, for which ``1/sqrt(zᵀ G z)`` is almost linear.
        """
        network = self._network
        parts = z.dot(network.parts) / half_axes
        near = parts * self._shrinking
        squares = near * near
        square = squares.dot(network.sums)
        slope = (eigenvalues * self._shrinking * squares).dot(network.sums) + TINY**3
        steps = square * (np.sqrt(square) - 1.0) / slope
        self._multiplier = np.maximum(self._multiplier + steps, 0.0)
        self._shrinking = 1.0 / (1.0 + eigenvalues * self._multiplier)
        nearest: Array = (parts * self._shrinking * half_axes).dot(network.joined)
        return nearest
