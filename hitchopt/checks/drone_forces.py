"""Forces of cables on drones and thrusts: formulas over enclosed values, or over their jets.

A drone of mass m needs the thrust ``f = m (a + g ẑ) - (force of its cable)``. The cable pulls along
the upper end of its leg (at a chain's end, of its edge; see ``hitchopt.hitch.taut``). A hanging
cable pulls inward by ``w s / 2σ``, and the higher end carries ``w h coth(σ) / 2`` more than half of
it: w its weight per length, σ its steepness (see ``hitchopt.hitch.catenary``). While a cable is
being tightened, these forces blend by its tautness, a polynomial.

How curves are read is not here: ``Drones`` reads values, and ``DroneJets`` their derivatives, too.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Generic, NamedTuple, TypeVar

import numpy as np

from hitchopt.checks.sagging import sagging_part
from hitchopt.checks.spans import UPWARD, cached, pull_vectors, without_shared_zeros
from hitchopt.hitch import GRAVITY
from hitchopt.hitch.catenary import level_length, pull_terms, steepness
from hitchopt.motion.loads import leg_tensions, reduce_constants, tautness
from hitchopt.motion.motion import Motion
from hitchopt.trajectory.enclosed import Enclosed, Interval
from hitchopt.trajectory.jets import ORDER, Jet
from hitchopt.values import Array, Indices, lazy

MIN_SPAN = 1e-9
"""[m] Smallest horizontal distance of a cable's drones: if one may be above the other, the rate of
their cable's pull is unbounded, and becomes almost infinite."""

MIN_RELATIVE_SPAN = 1e-6
"""Smallest horizontal distance of a cable's drones over its length, in quotients."""

Q = TypeVar("Q", Enclosed, Jet)


@cached
def taut_shares(motion: Motion) -> Array:
    """Return the tautness of every drone's cable (pieces, 2n, degree + 1)."""
    return np.repeat(reduce_constants(tautness(motion)), 2, axis=1)


@cached
def tensions_of_legs(motion: Motion) -> Array:
    """Return the tension of every drone's leg at its clasp (pieces, 2n, degree + 1) [N]."""
    return reduce_constants(leg_tensions(motion))


class SagTerms(NamedTuple):
    """Quantities (pieces, parts, degree + 1) whose ratio determines how parts of cables sag.

    Common zeros, as where both rise from zero, are divided out: they cancel in the ratio.
    """

    half_densities: Array  # [N/m], half of the weight per length
    tensions: Array  # [N], the tensions

    @classmethod
    def of(cls, motion: Motion, taut: Array, tensions: Array) -> SagTerms:
        """Return the terms of parts with a tautness and tensions (pieces, parts, degree + 1)."""
        half_densities = 0.5 * GRAVITY * motion.team.cable_density * taut
        terms = without_shared_zeros([half_densities[:, :, None], tensions[:, :, None]])
        return cls(*(term[:, :, 0] for term in terms))


@cached
def edge_sags(motion: Motion) -> SagTerms:
    """Return the terms of edges (pieces, n, degree + 1)."""
    return SagTerms.of(motion, tautness(motion), motion.tensions.coefficients)


@cached
def leg_sags(motion: Motion) -> SagTerms:
    """Return the terms of legs (pieces, 2n, degree + 1)."""
    return SagTerms.of(motion, taut_shares(motion), leg_tensions(motion))


def sagging_half_densities(motion: Motion) -> Array:
    """Return half of the weight per length of legs [N/m], as in ``leg_sags``."""
    return leg_sags(motion).half_densities


def sagging_tensions(motion: Motion) -> Array:
    """Return the tensions of legs [N], as in ``leg_sags``."""
    return leg_sags(motion).tensions


@cached
def partners(motion: Motion) -> Array:
    """Return offsets to the other drone of each drone's cable (pieces, 2n, 3, degree + 1) [m]."""
    places = motion.drones.coefficients
    return places[:, np.arange(motion.team.drones) ^ 1] - places


class DroneForces(ABC, Generic[Q]):
    """Forces on one drone each, on spans of time, by curves that subclasses read from tables."""

    source: Motion  # The motion
    item: Indices  # The drones (spans,)

    @abstractmethod
    def motion_rate(self, order: int) -> Q:
        """Return a time derivative of the position."""

    @abstractmethod
    def vector_of(self, table: Callable[[Motion], Array]) -> Q:
        """Return differences of positions from a table (pieces, 2n, 3, degree + 1) [m]."""

    @abstractmethod
    def scalar_of(self, table: Callable[[Motion], Array]) -> Q:
        """Return a computed scalar from a table (pieces, 2n, degree + 1)."""

    @property
    @abstractmethod
    def pull_terms(self) -> tuple[Q, Q]:
        """1/σ and coth σ of the cable as if hanging."""

    @lazy
    def mass(self) -> Array:
        """(spans, 1) [kg]."""
        return self.source.team.mass[self.item, None]

    @lazy
    def length(self) -> Array:
        """The cable's length (spans,) [m]."""
        return self.source.team.cable_length[self.item // 2]

    @property
    def half_density(self) -> float:
        """[N/m] Half of the weight per length of cables."""
        return 0.5 * GRAVITY * self.source.team.cable_density

    @property
    def has_weight(self) -> bool:
        """Return whether cables have weight."""
        return self.half_density > 0.0

    @property
    def has_hanging(self) -> bool:
        """Return whether any cable hangs at any time."""
        return self.has_weight and bool(np.any(taut_shares(self.source) != 1.0))

    @lazy
    def leg(self) -> Q:
        """Vector along the straight part of cable that ends at the drone [m]."""
        return self.vector_of(pull_vectors)

    @lazy
    def along(self) -> Q:
        """Direction of the leg."""
        return self.leg.direction

    @lazy
    def partner(self) -> Q:
        """[m] Offset of the cable's other end."""
        return self.vector_of(partners)

    @lazy
    def sag(self) -> Q:
        """[1/m] Half of the leg's weight per length over its tension at the inner end."""
        half_density = self.scalar_of(sagging_half_densities)
        return (half_density * self.scalar_of(sagging_tensions).inverse).reduced(ORDER)

    @lazy
    def load(self) -> Q:
        """[N] Minus the force of the cable on the drone."""
        tension = self.scalar_of(tensions_of_legs)
        if not self.has_weight:
            return self.along * tension
        load: Q = sagging_part(self.leg, self.sag).force(second=True) * tension
        if self.has_hanging:
            inward, downward = self.pull_terms
            slack_weight = self.half_density - self.half_density * self.scalar_of(taut_shares)
            hanging = (self.partner.xy * inward).with_z(self.partner[2] * downward)
            load = load - hanging * slack_weight
            load = load + (slack_weight * self.length[:, None]).along_z()
        return load

    @lazy
    def thrust(self) -> Q:
        """[N] f = m (a + g ẑ) - (force of the cable)."""
        hover = self.mass * GRAVITY * UPWARD
        force: Q = self.motion_rate(2) * self.mass + hover
        return force + self.load if self.source.team.has_cables else force


def steepness_of(offset: Enclosed, length: Array) -> Interval:
    """Return the steepness of hanging cables of lengths (spans,) [m] with offsets of their ends."""
    across = offset.xy.norm_range
    rise = offset[2].norm_range
    narrowest = MIN_RELATIVE_SPAN * length
    flattest = level_length(rise.high, length) / np.maximum(across.high, narrowest)
    steepest = level_length(rise.low, length) / np.maximum(across.low, narrowest)
    return Interval(*steepness([flattest, steepest]))


def hanging_terms(offset: Enclosed, length: Array) -> tuple[Interval, Interval]:
    """Return 1/σ and coth σ of hanging cables with offsets of their ends; both decrease with σ."""
    sigma = steepness_of(offset, length)
    least_inward, least_downward = pull_terms(sigma.high)
    largest_inward, largest_downward = pull_terms(sigma.low)
    return Interval(least_inward, largest_inward), Interval(least_downward, largest_downward)


def hanging_jets(offset: Jet, length: Array) -> tuple[Jet, Jet]:
    """Return 1/σ and coth σ of hanging cables with offsets of their ends.

    ``(coth σ - 1/σ) σ̇ = Λ̇/Λ - ṡ/s``, s the ends' horizontal distance, h their height difference
    and ``Λ² = L² - h²``; the rates of 1/σ and coth σ are ``-σ̇/σ²`` and ``-σ̇/sinh² σ``.
    """
    inward, downward = hanging_terms(offset.value, length)
    across, rise = offset.value.xy, offset.value[2]
    heights = rise.norm_range
    level = Interval(level_length(heights.high, length), level_length(heights.low, length))
    widening = across.dot(offset.rate.xy).range * _inverse_square(across.norm_range)
    lifting = (rise * offset.rate[2]).range * _inverse_square(level)
    slope = Interval(downward.high - inward.high, downward.low - inward.low)  # rises with σ
    falling = (widening + lifting) * slope.inverse  # -σ̇
    inward_rate = falling * Interval(inward.low**2, inward.high**2)
    downward_rate = falling * Interval(downward.low**2 - 1.0, downward.high**2 - 1.0)
    return (
        Jet(inward.enclosed, inward_rate.enclosed),
        Jet(downward.enclosed, downward_rate.enclosed),
    )


def _inverse_square(size: Interval) -> Interval:
    """Return the inverse squares of distances [1/m²]."""
    return Interval(
        low=np.maximum(size.high, MIN_SPAN) ** -2, high=np.maximum(size.low, MIN_SPAN) ** -2
    )
