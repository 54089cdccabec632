"""Checks of single drones, from ``speed`` to ``legs``, and ``vertex_speed``.

A drone of mass m needs the thrust ``f = m (a + g ẑ) - (force of its cable)``. The cable pulls along
its leg (at a chain's end, along its edge), and the drone carries half of the weight of that part. A
hanging cable pulls inward by ``w s / 2σ``, and the higher end carries ``w h coth(σ) / 2`` more than
half of it: w its weight per length, σ its steepness (see ``hitchopt.hitch.catenary``). While a
cable is being tightened, these forces blend by its tautness, a polynomial.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from operator import attrgetter
from typing import NamedTuple

import numpy as np

from hitchopt.checks.certificate import with_tolerance
from hitchopt.checks.rule import CheckRule, Evaluator, WorstOverSpans
from hitchopt.checks.spans import (
    ROUNDING,
    UPWARD,
    MotionSpans,
    cached,
    derivative,
    derivative_margin,
    leg_vectors,
    magnitude,
    pull_vectors,
    rate,
    without_shared_zeros,
)
from hitchopt.hitch import GRAVITY
from hitchopt.hitch.catenary import level_length, pull_terms, steepness
from hitchopt.hitch.forces import chord_pull
from hitchopt.motion.loads import leg_tensions, reduce_constants, tautness
from hitchopt.motion.motion import HITCHED_STATE, TAUT_STATES, CableState, Motion
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.trajectory.enclosed import Bound, Enclosed, Interval, vector
from hitchopt.trajectory.search import Extremum, TimeSpans, worst
from hitchopt.values import Array, lazy

ORDER = 6
"""Degree of the factors of a turning rate: they err by 1e-9 on the spans that matter."""

MIN_SPAN = 1e-9
"""[m] Smallest horizontal distance of a cable's drones: if one may be above the other, the rate of
their cable's pull is unbounded, and becomes almost infinite."""

MIN_RELATIVE_SPAN = 1e-6
"""Smallest horizontal distance of a cable's drones over its length, in quotients."""


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

    half_densities: Array
    """[N/m], half of the weight per length."""

    tensions: Array
    """[N], the tensions."""

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


@cached
def partners(motion: Motion) -> Array:
    """Return offsets to the other drone of each drone's cable (pieces, 2n, 3, degree + 1) [m]."""
    places = motion.drones.coefficients
    return places[:, np.arange(motion.team.drones) ^ 1] - places


class Drones(MotionSpans):
    """Spans of drones: their motion, the force of their cable and their thrust."""

    is_moving = True

    names = staticmethod(attrgetter("team.drone_names"))

    def motion_rate(self, order: int) -> Enclosed:
        """Return a time derivative of the position."""
        return self.derivative(self.source.drones, order)

    @lazy
    def mass(self) -> Array:
        """(spans, 1) [kg]."""
        return self.source.team.mass[self.item, None]

    def scalar(self, table: Callable[[Motion], Array], order: int = 0) -> Enclosed:
        """Return a scalar of a table (pieces, 2n, degree + 1), or its time derivative."""
        values = rate(self.source, table) if order else table(self.source)
        coefficients = self.read(values)[:, None]
        return Enclosed(coefficients, ROUNDING * np.max(np.abs(coefficients), axis=(1, 2)))

    @lazy
    def leg(self) -> Enclosed:
        """Vector along the straight part of cable that ends at the drone [m]."""
        return Enclosed(self.read(pull_vectors(self.source)), self.noise)

    @lazy
    def along(self) -> Enclosed:
        """Direction of the leg."""
        return self.leg.direction

    @lazy
    def sag(self) -> Enclosed:
        """[1/m] Half of the leg's weight per length over its tension."""
        half_density, tension = self.scalars(leg_sags(self.source))
        return (half_density * tension.inverse).reduced(ORDER)

    @lazy
    def span_squared(self) -> Enclosed:
        """[m²] Squared horizontal length of the leg."""
        return self.leg.xy.dot(self.leg.xy)

    @lazy
    def level_pull(self) -> Enclosed:
        """Pull of the leg over its tension if its ends were at equal heights."""
        pull: Enclosed = chord_pull(1.0, self.sag, self.span_squared)
        return pull.reduced(ORDER)

    @lazy
    def pull(self) -> Enclosed:
        """[N] Pull of the leg along its chord: ``chord_pull``, with T factored out."""
        tension = self.scalar(tensions_of_legs)
        if not self.has_weight:
            return tension
        return tension * self.level_pull + self.taut_weight * self.leg[2]

    @property
    def has_weight(self) -> bool:
        """Return whether cables have weight."""
        return self.source.team.cable_density > 0.0

    @property
    def has_hanging(self) -> bool:
        """Return whether any cable hangs at any time."""
        return self.has_weight and bool(np.any(taut_shares(self.source) != 1.0))

    @property
    def half_density(self) -> float:
        """[N/m] Half of the weight per length of cables."""
        return 0.5 * GRAVITY * self.source.team.cable_density

    @lazy
    def taut_weight(self) -> Enclosed:
        """[N/m] Half of the weight per length of taut cables."""
        return self.half_density * self.scalar(taut_shares)

    @lazy
    def slack_weight(self) -> Enclosed:
        """[N/m] Half of the weight per length of hanging cables."""
        return self.half_density - self.taut_weight

    @lazy
    def partner(self) -> Enclosed:
        """[m] Offset of the cable's other end."""
        return Enclosed(self.read(partners(self.source)), self.noise)

    @lazy
    def length(self) -> Array:
        """The cable's length (spans,) [m]."""
        return self.source.team.cable_length[self.item // 2]

    @lazy
    def load(self) -> Enclosed:
        """[N] Minus the force of the cable on the drone."""
        load = self.along * self.pull
        if self.has_weight:
            load = load + (self.leg.norm * self.taut_weight).along_z()
        if self.has_hanging:
            inward, downward = self.pull_terms
            load = load - _hanging_force(self.partner, inward, downward, self.slack_weight)
            load = load + (self.slack_weight * self.length[:, None]).along_z()
        return load

    @lazy
    def pull_terms(self) -> tuple[Interval, Interval]:
        """1/σ and coth σ of the cable as if hanging; both decrease with σ."""
        sigma = steepness_of(self.partner, self.length)
        least_inward, least_downward = pull_terms(sigma.high)
        largest_inward, largest_downward = pull_terms(sigma.low)
        return Interval(least_inward, largest_inward), Interval(least_downward, largest_downward)

    @lazy
    def thrust(self) -> Enclosed:
        """[N] f = m (a + g ẑ) - (force of the cable)."""
        hover = self.mass * GRAVITY * UPWARD
        force = Enclosed(hover[..., None])
        if self.is_moving:
            force = self.motion_rate(2) * self.mass + hover
        return force + self.load if self.source.team.has_cables else force

    @lazy
    def load_rate(self) -> Enclosed:
        """[N/s] The time derivative of the load."""
        parts = self.source.drones, self.source.vertices
        margin = sum(float(np.max(derivative_margin(part, 1))) for part in parts)
        velocity = Enclosed(self.read(rate(self.source, pull_vectors)), margin)
        along = self.along.reduced(ORDER)
        swept = (velocity * self.leg.norm.inverse).reduced(ORDER)
        turning = swept - along * along.dot(swept).reduced(ORDER)  # d/dt (y/|y|)
        pull_rate = self.scalar(tensions_of_legs, 1)
        if self.has_weight:
            growth = self.half_density * self.scalar(taut_shares, 1)
            # Rate of h z + √(T² - h² s²), h half of the weight per length, s and z of the leg.
            sag_rate = growth * self.span_squared + self.taut_weight * self.leg.xy.dot(velocity.xy)
            pull_rate = (pull_rate - self.sag * sag_rate.reduced(ORDER)) * self.level_pull.inverse
            pull_rate = pull_rate.reduced(ORDER) + growth * self.leg[2]
            pull_rate = pull_rate + self.taut_weight * velocity[2]
        slope = along * pull_rate + turning * self.pull
        if self.has_weight:
            weight = self.leg.norm * growth + along.dot(velocity) * self.taut_weight
            slope = slope + weight.along_z()
        if self.has_hanging:
            slope = slope + self._hanging_rate(growth)
        return slope

    def _hanging_rate(self, growth: Enclosed) -> Enclosed:
        """Return the derivative of the load of hanging cables.

        ``(coth σ - 1/σ) σ̇ = Λ̇/Λ - ṡ/s``, s the ends' horizontal distance, h their height difference
        and ``Λ² = L² - h²``; the rates of 1/σ and coth σ are ``-σ̇/σ²`` and ``-σ̇/sinh² σ``.
        """
        velocity = Enclosed(self.read(rate(self.source, partners)), ROUNDING)
        inward, downward = self.pull_terms
        horizontal = self.partner.xy
        rise = self.partner[2]
        widening = horizontal.dot(velocity.xy).range * _inverse_square(horizontal.norm_range)
        heights = rise.norm_range
        least_level = level_length(heights.high, self.length)
        largest_level = level_length(heights.low, self.length)
        level = Interval(least_level, largest_level)
        lifting = (rise * velocity[2]).range * _inverse_square(level)
        slope = Interval(downward.high - inward.high, downward.low - inward.low)  # rises with σ
        falling = (widening + lifting) * slope.inverse  # -σ̇
        inward_rate = falling * Interval(inward.low**2, inward.high**2)
        downward_rate = falling * Interval(downward.low**2 - 1.0, downward.high**2 - 1.0)
        weight = self.slack_weight
        force_rate = _hanging_force(self.partner, inward, downward, -growth)
        force_rate = force_rate + _hanging_force(velocity, inward, downward, weight)
        force_rate = force_rate + _hanging_force(self.partner, inward_rate, downward_rate, weight)
        return -force_rate - (growth * self.length[:, None]).along_z()

    @lazy
    def turning(self) -> Enclosed:
        """ω = f × ḟ / |f|² [rad/s], about axes perpendicular to the thrust."""
        thrust_rate = self.motion_rate(3) * self.mass
        if self.source.team.has_cables:
            thrust_rate = thrust_rate + self.load_rate
        thrust = self.thrust.reduced(ORDER)
        moment = thrust.cross(thrust_rate.reduced(ORDER)).reduced(ORDER)
        ratio = (moment * thrust.norm.inverse).reduced(ORDER)
        return ratio * thrust.norm.inverse


def _hanging_force(
    offset: Enclosed, inward: Interval, downward: Interval, half_density: Enclosed
) -> Enclosed:
    """Return the pull of hanging cables on one end, beyond half of their weights [N].

    It is ``½ w (x / σ, y / σ, z coth σ)`` of an ``offset`` (x, y, z) [m] of the ends, where
    ``inward`` and ``downward`` enclose 1/σ and coth σ.
    """
    return vector(offset.xy * inward.enclosed, offset[2] * downward.enclosed) * half_density


class Hovering(Drones):
    """Spans of drones that hover at their positions."""

    is_moving = False


class Points(MotionSpans):
    """Spans of the hitch's points."""

    names = staticmethod(attrgetter("team.point_names"))


def steepness_of(offset: Enclosed, length: Array) -> Interval:
    """Return the steepness of hanging cables of lengths (spans,) [m] with offsets of their ends."""
    across = offset.xy.norm_range
    rise = offset[2].norm_range
    narrowest = MIN_RELATIVE_SPAN * length
    flattest = level_length(rise.high, length) / np.maximum(across.high, narrowest)
    steepest = level_length(rise.low, length) / np.maximum(across.low, narrowest)
    return Interval(*steepness([flattest, steepest]))


def _inverse_square(size: Interval) -> Interval:
    """Return the inverse squares of distances [1/m²]."""
    return Interval(
        low=np.maximum(size.high, MIN_SPAN) ** -2, high=np.maximum(size.low, MIN_SPAN) ** -2
    )


def tilt(spans: Drones) -> Bound:
    """Return the angle of the thrust from +z [deg].

    It is largest at the smallest vertical component, with the largest horizontal one, or with the
    smallest if the thrust points down.
    """
    rise = spans.thrust[2].lower.value
    level = spans.thrust.xy
    largest = level.norm_upper
    horizontal = np.where(rise >= 0.0, largest.value, level.norm_lower.value)
    return Bound(np.degrees(np.arctan2(horizontal, rise)), largest.x)


def turning_rate(spans: Drones) -> Bound:
    """Return the body rate about x and y [deg/s]; infinite where a thrust may vanish."""
    rates = spans.turning.norm_upper
    is_bounded = np.isfinite(spans.thrust.norm.inverse.r)
    body_rates = np.degrees(rates.value) * (1.0 + ROUNDING)
    return Bound(np.where(is_bounded, body_rates, np.inf), rates.x)


def _norm(spans: MotionSpans, order: int) -> Bound:
    """Return the norm of a time derivative of a position."""
    part = spans.source.vertices if isinstance(spans, Points) else spans.source.drones
    return spans.derivative(part, order).norm_upper


def _rate_rule(
    name: str,
    unit: str,
    order: int,
    proves: str,
    unproven: str,
    over: type[MotionSpans] = Drones,
) -> CheckRule:
    """Return the rule that compares the norm of a derivative with ``Limits.with_reserve.name``."""
    evaluator = Evaluator(
        WorstOverSpans(over, partial(_norm, order=order), "max", 0.0),
        states=HITCHED_STATE if over is Points else frozenset(CableState),
        exported=order == 1 and over is Drones,
    )
    return CheckRule(
        name,
        unit,
        "max",
        attrgetter(f"requirements.limits.with_reserve.{name}"),
        (evaluator,),
        f"raise limits.{name}",
        ease="time",
        derivative=order,
        group="motion",
        key=f"limits.{name}",
        bodies=(("vertices",),) if over is Points else (("drones",),),
        proves=proves,
        unproven=unproven,
    )


SPEED = _rate_rule(
    "speed",
    "m/s",
    1,
    "the largest speed of a drone",
    "the speed of a drone that deviates from its plan",
)
ACCELERATION = _rate_rule(
    "acceleration",
    "m/s²",
    2,
    "the largest acceleration of a drone",
    "that motors can produce it: see `thrust` and `tilt`",
)
JERK = _rate_rule(
    "jerk", "m/s³", 3, "the largest jerk of a drone", "jumps of the jerk between pieces"
)
VERTEX_SPEED = _rate_rule(
    "vertex_speed",
    "m/s",
    1,
    "the largest speed of a vertex while the hitch exists",
    "the speed of real crossings, which friction and sag displace",
    over=Points,
)


def thrust_share(spans: Drones) -> Bound:
    """Return the thrust over the drone's ``max_thrust``."""
    thrust = spans.thrust.norm_upper
    return Bound(thrust.value / spans.source.team.max_thrust[spans.item], thrust.x)


THRUST_SHARE = WorstOverSpans(
    Drones, thrust_share, "max", item_limits=lambda motion: motion.team.max_thrust
)

THRUST = CheckRule(
    "thrust",
    "N",
    "max",
    lambda motion: float(np.max(motion.team.max_thrust)),
    (Evaluator(THRUST_SHARE, exported=True, formulas=(Drones.thrust, Drones.load)),),
    "use a drone with more thrust, or lower team.tension",
    "use a drone with more thrust, or lower team.cable_density",
    "tension",
    derivative=2,
    group="forces",
    key="team.quadrotor.max_thrust",
    bodies=(("drones",),),
    proves="the largest norm of m (a + g ẑ) − cable force [N], of the drone nearest to its own "
    "`max_thrust`",
    unproven="thrust for gusts, downwash and wrong tensions",
)
"""The largest thrust of the drone closest to its own ``max_thrust``."""


TILT = CheckRule(
    "tilt",
    "deg",
    "max",
    lambda motion: math.degrees(motion.requirements.limits.tilt),
    (Evaluator(WorstOverSpans(Drones, tilt, "max"), exported=True),),
    "raise limits.tilt_deg, or lower team.tension",
    "raise limits.tilt_deg, or lower team.cable_density",
    "tension",
    derivative=2,
    group="forces",
    key="limits.tilt_deg",
    bodies=(("drones",),),
    proves="the largest angle of a thrust from vertical [deg]",
    unproven="attitudes that correct errors",
)


def _largest_body_rate(motion: Motion) -> float | None:
    """Return the limit of body rates [deg/s]; None without one."""
    body_rate = motion.requirements.limits.body_rate
    return None if body_rate is None else math.degrees(body_rate)


TURNING_RATE = WorstOverSpans(Drones, turning_rate, "max", 0.0)

BODY_RATE = CheckRule(
    "body_rate",
    "deg/s",
    "max",
    _largest_body_rate,
    (Evaluator(TURNING_RATE, formulas=(Drones.turning, Drones.load_rate)),),
    "raise limits.body_rate_deg",
    ease="time",
    derivative=3,
    group="motion",
    key="limits.body_rate_deg",
    bodies=(("drones",),),
    proves="the largest turning rate of a thrust vector [deg/s], if limited",
    unproven="rates that correct errors",
)


class Legs(MotionSpans):
    """Spans of legs."""

    names = staticmethod(attrgetter("team.leg_names"))


def _length(spans: Legs) -> Bound:
    """Return the length of ``q_k - p_k`` or ``r_k - p_{k+1}`` [m]; infinite at a chain's ends.

    Heights are divided by ``Requirements.height_ratio``.
    """
    legs = spans.read(leg_vectors(spans.source))
    height_ratio = spans.source.requirements.height_ratio
    if height_ratio != 1.0:
        legs = legs * np.array([1.0, 1.0, 1.0 / height_ratio])[:, None]
    lengths = Enclosed(legs, spans.noise).norm_lower
    exists = spans.source.team.layout.has_leg.ravel()[spans.item]
    return Bound(np.where(exists, lengths.value, np.inf), lengths.x)


LEGS = CheckRule(
    "legs",
    "m",
    "min",
    lambda motion: motion.requirements.limits.leg,
    (Evaluator(WorstOverSpans(Legs, _length, "min", magnitude), TAUT_STATES),),
    "use a longer cable, a smaller polygon, or a smaller limits.leg",
    ease="length",
    group="cables",
    key="limits.leg",
    bodies=(("drones", "vertices"),),
    proves="the shortest leg while the hitch exists [m]",
    unproven="the ends of a chain, which have no legs",
)
"""The shortest leg ``|q_k - p_k|`` or ``|r_k - p_{k+1}|``; ``where`` is ``q-leg k``."""

LIMITS = (SPEED, ACCELERATION, JERK, VERTEX_SPEED, THRUST, TILT, BODY_RATE, LEGS)
"""The checks of this module, in the certificate's order."""


def largest_rate(
    part: PiecewisePolynomial,
    order: int,
    limit: float = math.nan,
    size: Callable[[Enclosed], Bound] = lambda rate: rate.norm_upper,
) -> Extremum:
    """Return the largest norm, or other size, of a time derivative of points (items, d).

    The bound is as tight as the comparison with the limit requires.
    """
    rates = derivative(part, order)
    margin = derivative_margin(part, order)

    def formula(spans: TimeSpans) -> Bound:
        return size(Enclosed(spans.read(rates), margin[spans.piece, spans.item]))

    spans = TimeSpans.all_of(part, part.breaks, part.shape[0])
    return worst(spans, formula, "max", target=with_tolerance(limit, "max", 0.0, 0.5))


def largest_at_rest(motion: Motion, quantity: Callable[[Drones], Bound]) -> float:
    """Return the largest ``tilt`` [deg] or ``thrust_share`` of hovering drones, for all t."""
    return worst(Hovering.of(motion), quantity, "max").worst
