"""What the limits of motion allow a common clock to do with a plan.

With x(τ) the plan, D its derivatives by plan time and s = dτ/dt, a clock makes the acceleration
``s² D²x + ṡ Dx`` and the jerk ``s³ D³x + 3 s ṡ D²x + s̈ Dx``, and the thrust ``m (a + g ẑ)`` less
the cable's force, which depends on the place alone. On a phase of constant s̈ within one piece all
are polynomials of time; norms are convex, so that Bernstein coefficients bound them. Speeds fall
with s. Of what else there is only the balance of carried objects changes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hitchopt.checks.bounds.carried_inertia import CarriedInertia
from hitchopt.checks.bounds.rounding_margins import ROUNDING, derivative_margin
from hitchopt.checks.bounds.static_thrust import ORDER, StaticThrust
from hitchopt.checks.bounds.thrust_turning import turning
from hitchopt.geometry.vectors import column_lengths
from hitchopt.motion.motion import Motion
from hitchopt.time_limit import check_time
from hitchopt.trajectory import bernstein
from hitchopt.trajectory.clock_phases import ClockPhases
from hitchopt.trajectory.enclosure import Enclosure
from hitchopt.values import Array, Indices

Flags = NDArray[np.bool_]

Measure = Callable[[Array], Array]
"""Convex function of vectors (…, 3, m), giving (…, m)."""

PROBES = np.linspace(0.0, 1.0, 4)
"""Places on a cell where samples are taken."""

HALVINGS = 7
"""Halvings of a cell in which a bound is decided; what is undecided then counts as broken."""

BATCH = 3000
"""Pairs of a cell and a drone that are looked at in one go."""


def _length(vectors: Array) -> Array:
    return column_lengths(vectors)


@dataclass(frozen=True, eq=False)
class _Pairs:
    """Pairs of a cell of a clock and a drone."""

    cell: Indices
    drone: Indices

    def taken(self, index: Flags | slice) -> _Pairs:
        return _Pairs(self.cell[index], self.drone[index])


class ClockLimits:
    """The limits of a motion, for clocks.

    Parameters
    ----------
    motion: the plan.
    """

    def __init__(self, motion: Motion) -> None:
        self.motion = motion
        drones = motion.drones
        self.breaks = drones.breaks
        self.derivatives = [drones.differentiated(k).coefficients for k in (1, 2, 3)]
        self.margins = [derivative_margin(drones, k) for k in (1, 2, 3)]
        self.sizes = [
            np.max(column_lengths(c), axis=-1) + margin
            for c, margin in zip(self.derivatives, self.margins, strict=True)
        ]
        self.static = StaticThrust.of(motion)
        self.hover = self.static.largest
        self.tilt = motion.requirements.limits.tilt
        self.beyond = self.static.beyond_cone(self.tilt)
        self.inertia = CarriedInertia.of(motion)
        """What is carried; None where nothing is."""

    def keep(self, phases: ClockPhases, owners: int, *, sampled: bool = False) -> Flags:
        """Return (owners,) whether the phases of each clock keep all limits.

        Parameters
        ----------
        phases: with rates from -1 to 1.
        owners: how many clocks there are.
        sampled: look at samples only, as a first guess; otherwise bound all of the time.
        """
        cells, pieces = phases.cut(self.breaks)
        flown = (pieces >= 0) & (pieces < len(self.breaks) - 1)
        cells, pieces = cells.taken(flown), pieces[flown]
        kept = np.ones(owners, dtype=np.bool_)
        for first in range(0, len(cells), BATCH):
            check_time()
            part, here = cells.taken(slice(first, first + BATCH)), pieces[first : first + BATCH]
            self._look(part, here, kept, sampled)
            if self.inertia is not None:
                left = np.flatnonzero(kept[part.owner])
                broken = self.inertia.broken(part.taken(left), here[left], sampled=sampled)
                kept[part.owner[left[broken]]] = False
        return kept

    def _look(self, cells: ClockPhases, pieces: Indices, kept: Flags, sampled: bool) -> None:
        """Set ``kept`` to False for clocks that break a limit in these cells."""
        limits, team = self.motion.requirements.limits, self.motion.team
        V, A, J = (size[pieces] for size in self.sizes)
        _, s0, a0, j0 = cells.jets.T
        _, s1, a1, _ = cells.ends.T
        middle = s0 + 0.5 * cells.duration * a0  # the rate's coefficients hold it between them
        s = np.max(np.abs([s0, middle, s1]), axis=0)[:, None]
        a = np.maximum(np.abs(a0), np.abs(a1))[:, None]
        j = np.abs(j0)[:, None]
        acceleration = s**2 * A + a * V
        jerk = s**3 * J + 3.0 * s * a * A + j * V
        extra = team.mass * acceleration
        open_: tuple[tuple[str, Flags], ...] = (
            ("acceleration", ~(acceleration <= limits.acceleration)),
            ("jerk", ~(jerk <= limits.jerk)),
            ("thrust", ~(self.hover[pieces] + extra <= team.max_thrust)),
            ("tilt", ~(self.beyond[pieces] + extra <= 0.0)),
        )
        if limits.body_rate is not None:  # no quick bound comes close
            open_ += (("body_rate", np.ones_like(jerk, dtype=np.bool_)),)
        for name, beyond in open_:
            if not np.any(beyond):
                continue
            pairs = _Pairs(*np.nonzero(beyond & kept[cells.owner][:, None]))
            for first in range(0, len(pairs.cell), BATCH):
                each = pairs.taken(slice(first, first + BATCH))
                each = each.taken(kept[cells.owner[each.cell]])
                if len(each.cell):
                    broken = self._broken(name, cells, pieces, each, sampled)
                    kept[cells.owner[each.cell[broken]]] = False

    def _broken(
        self, name: str, cells: ClockPhases, pieces: Indices, pairs: _Pairs, sampled: bool
    ) -> Flags:
        """Return (pairs,) whether a limit is not shown to be kept."""
        limits, team = self.motion.requirements.limits, self.motion.team
        piece, drone = pieces[pairs.cell], pairs.drone
        own = cells.taken(pairs.cell)
        if name == "body_rate":
            return self._turning(own, piece, drone)
        cone = np.array([np.cos(self.tilt), np.sin(self.tilt)])
        measure: Measure = _length
        force = name in ("thrust", "tilt")
        if name == "tilt":

            def measure(f: Array) -> Array:
                beyond: Array = (
                    np.hypot(f[..., 0, :], f[..., 1, :]) * cone[0] - f[..., 2, :] * cone[1]
                )
                return beyond

        limit = {
            "acceleration": np.full(len(piece), limits.acceleration),
            "jerk": np.full(len(piece), limits.jerk),
            "thrust": team.max_thrust[drone],
            "tilt": np.zeros(len(piece)),
        }[name]
        radius = self.static.thrust.radius[piece, drone] if force else np.zeros(len(piece))
        order = 3 * self.motion.drones.degree - 2
        if force:
            order = max(order, 3 * bernstein.degree(self.static.thrust.coefficients))
        nodes = PROBES if sampled else bernstein.nodes(order)
        values = self._values(name, own, piece, drone, nodes)
        broken: Flags = ~np.all(measure(values) + radius[:, None] <= limit[:, None], axis=-1)
        if sampled or np.all(broken):
            return broken
        left = ~broken
        largest = np.max(np.abs(values), axis=(-2, -1))
        slack = (
            limit
            - radius
            - self._margin(name, own, piece, drone)
            - bernstein.interpolation_error(order) * largest
        )
        undecided = _beyond(bernstein.interpolate(values[left]), measure, slack[left])
        broken[left] = undecided
        return broken

    def _turning(self, cells: ClockPhases, piece: Indices, drone: Indices) -> Flags:
        """Return (pairs,) whether the thrust is not shown to turn slowly enough."""
        rates, limit = self.static.rate, self.motion.requirements.limits.body_rate
        assert rates is not None
        assert limit is not None
        order = max(3 * self.motion.drones.degree - 2, 3 * ORDER + 2)
        nodes = bernstein.nodes(order)
        x, jets = cells.values(self.breaks, piece, nodes)
        thrust = self._values("thrust", cells, piece, drone, nodes)
        rate = self.motion.team.mass[drone][:, None, None] * self._values(
            "jerk", cells, piece, drone, nodes
        ) + jets[:, None, :, 1] * self._at(rates.coefficients, piece, drone, x)
        error = bernstein.interpolation_error(order)
        radii = (
            self.static.thrust.radius[piece, drone]
            + self._margin("thrust", cells, piece, drone)
            + error * np.max(np.abs(thrust), axis=(1, 2)),
            rates.radius[piece, drone]
            + self.motion.team.mass[drone] * self._margin("jerk", cells, piece, drone)
            + error * np.max(np.abs(rate), axis=(1, 2)),
        )
        vectors = bernstein.interpolate(np.stack([thrust, rate]))
        broken = np.zeros(len(piece), dtype=np.bool_)
        index = np.arange(len(piece))
        for _ in range(HALVINGS):
            found = turning(*(Enclosure(c, r[index]) for c, r in zip(vectors, radii, strict=True)))
            broken[index[~(found.value <= limit)]] = True
            left = (found.bound > limit) & ~broken[index]
            if not np.any(left):
                return broken
            vectors = np.concatenate(bernstein.halve(vectors[:, left]), axis=1)
            index = np.tile(index[left], 2)
        broken[index] = True
        return broken

    def _values(
        self, name: str, cells: ClockPhases, piece: Indices, drone: Indices, nodes: Array
    ) -> Array:
        """Return accelerations, jerks or thrusts (pairs, 3, nodes)."""
        x, jets = cells.values(self.breaks, piece, nodes)
        x = np.clip(x, 0.0, 1.0)
        s, a, j = (jets[:, None, :, k] for k in (1, 2, 3))
        v, acc = (self._at(self.derivatives[k], piece, drone, x) for k in (0, 1))
        if name == "jerk":
            jerk = self._at(self.derivatives[2], piece, drone, x)
            return s**3 * jerk + 3.0 * s * a * acc + j * v
        values = s**2 * acc + a * v
        if name == "acceleration":
            return values
        mass = self.motion.team.mass[drone][:, None, None]
        return mass * values + self._at(self.static.thrust.coefficients, piece, drone, x)

    @staticmethod
    def _at(coefficients: Array, piece: Indices, drone: Indices, x: Array) -> Array:
        """Return the values (pairs, 3, nodes) of a drone's polynomials at x (pairs, nodes)."""
        weights = bernstein.basis(x, bernstein.degree(coefficients))
        return coefficients[piece, drone] @ np.swapaxes(weights, 1, 2)

    def _margin(self, name: str, cells: ClockPhases, piece: Indices, drone: Indices) -> Array:
        """Return (pairs,) what rounding may add to a quantity."""
        first, second, third = (margin[piece, drone] for margin in self.margins)
        a = np.maximum(np.abs(cells.jets[:, 2]), np.abs(cells.ends[:, 2]))
        acceleration = second + a * first
        if name == "jerk":
            margin: Array = third + 3.0 * a * second + np.abs(cells.jets[:, 3]) * first
            return margin
        if name == "acceleration":
            return acceleration
        hover = ROUNDING * self.hover[piece, drone]
        return self.motion.team.mass[drone] * acceleration + hover


def _beyond(coefficients: Array, measure: Measure, limit: Array) -> Flags:
    """Return (cells,) whether a measure of polynomials (cells, 3, m) is not shown to keep limits.

    Cells are halved until coefficients keep the limit or a value breaks it.
    """
    broken = np.zeros(len(limit), dtype=np.bool_)
    index = np.arange(len(limit))
    for _ in range(HALVINGS):
        sizes = measure(coefficients)
        most = limit[index]
        broken[index[~(np.maximum(sizes[:, 0], sizes[:, -1]) <= most)]] = True
        left = (np.max(sizes, axis=-1) > most) & ~broken[index]
        if not np.any(left):
            return broken
        halves = bernstein.halve(coefficients[left])
        index = np.tile(index[left], 2)
        coefficients = np.concatenate(halves)
    broken[index] = True
    return broken
