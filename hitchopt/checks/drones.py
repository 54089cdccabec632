"""Checks of every drone by itself, from ``speed`` to ``legs``, and ``vertex_speed``.

A drone of mass m needs the thrust ``f = m (a + g ẑ) - (force of its cable)``. The cable pulls along
its leg (at a chain's end, along its edge) and leaves it half of the weight of that. A cable that
hangs free pulls inward by ``w s / 2σ``, and the higher end carries ``w h coth(σ) / 2`` more than
half of it: w its weight per length, σ its steepness (see ``hitchopt.hitch.catenary``). While a
cable is drawn taut the one fades into the other with its tautness, a polynomial.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cached_property, partial
from operator import attrgetter

import numpy as np

from hitchopt.checks.certificate import within
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
from hitchopt.motion.loads import leg_tensions, lowered, tautness
from hitchopt.motion.motion import HITCHED_STATE, CableState, Motion
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.trajectory.enclosed import Bound, Enclosed, Interval, vector
from hitchopt.trajectory.search import Extremum, Spans, worst
from hitchopt.values import Array

# Degree of the factors of a turning rate: on spans that matter they err by 1e-9
ORDER = 6
# [m] Drones of a cable that may be one above the other count as this far apart seen from above: the
# rate of their cable's pull has no bound there, and becomes almost infinite
NEAREST = 1e-9


@cached
def taut_shares(motion: Motion) -> Array:
    """Return the tautness of every drone's cable (pieces, 2n, degree + 1)."""
    return np.repeat(lowered(tautness(motion)), 2, axis=1)


@cached
def tensions_of_legs(motion: Motion) -> Array:
    """Return the tension of every drone's leg at its clasp (pieces, 2n, degree + 1) [N]."""
    return lowered(leg_tensions(motion))


@cached
def edge_sags(motion: Motion) -> list[Array]:
    """Return half of the weight per length of cables [N/m] and their tension [N], (pieces, n, …).

    A common factor, as where both rise from zero, is left out: it cancels in their ratio.
    """
    return _sags(motion, tautness(motion), motion.tensions.coefficients)


@cached
def leg_sags(motion: Motion) -> list[Array]:
    """Return half of the weight per length of legs [N/m] and their tension [N], (pieces, 2n, …)."""
    return _sags(motion, taut_shares(motion), leg_tensions(motion))


def _sags(motion: Motion, taut: Array, tensions: Array) -> list[Array]:
    return without_shared_zeros([0.5 * GRAVITY * motion.team.cable_density * taut, tensions])


@cached
def partners(motion: Motion) -> Array:
    """Return the other drone of each drone's cable, seen from it (pieces, 2n, 3, degree + 1)."""
    c = motion.drones.coefficients
    return c[:, np.arange(c.shape[1]) ^ 1] - c


class Drones(MotionSpans):
    """Spans of drones: their motion, the force of their cable and the thrust that they need."""

    moving = True

    names = staticmethod(attrgetter("team.drone_names"))

    def moved(self, order: int) -> Enclosed:
        """Return a derivative of the position by time."""
        return self.derivative(self.source.drones, order)

    @cached_property
    def mass(self) -> Array:
        """(spans, 1) [kg]."""
        return self.source.team.mass[self.item, None]

    def scalar(self, table: Callable[[Motion], Array], order: int = 0) -> Enclosed:
        """Return a scalar of a table (pieces, 2n, degree + 1), or its derivative by time."""
        c = self.read(rate(self.source, table) if order else table(self.source))[:, None]
        return Enclosed(c, ROUNDING * np.max(np.abs(c), axis=(1, 2)))

    @cached_property
    def leg(self) -> Enclosed:
        """The vector from where the cable pulls to the drone [m]."""
        return Enclosed(self.read(pull_vectors(self.source)), self.noise)

    @cached_property
    def along(self) -> Enclosed:
        """Direction of the leg."""
        return self.leg.direction

    @cached_property
    def sag(self) -> Enclosed:
        """[1/m] Half of the leg's weight per length over its tension."""
        half, tension = self.scalars(leg_sags(self.source))
        return (half * tension.inverse).reduced(ORDER)

    @cached_property
    def level(self) -> Enclosed:
        """[m²] The squared length of the leg as seen from above."""
        return self.leg.level.dot(self.leg.level)

    @cached_property
    def levelled(self) -> Enclosed:
        """Pull of the leg over its tension if its ends were level."""
        pull: Enclosed = chord_pull(1.0, self.sag, self.level)
        return pull.reduced(ORDER)

    @cached_property
    def pull(self) -> Enclosed:
        """[N] Pull of the leg along its chord: ``chord_pull``, with T factored out."""
        tension = self.scalar(tensions_of_legs)
        if not self.heavy:
            return tension
        return tension * self.levelled + self.taut_weight * self.leg[2]

    @property
    def heavy(self) -> bool:
        """Whether cables have weight."""
        return self.source.team.cable_density > 0.0

    @property
    def hangs(self) -> bool:
        """Whether any cable hangs at any time."""
        return self.heavy and bool(np.any(taut_shares(self.source) != 1.0))

    @property
    def half(self) -> float:
        """[N/m] Half of the weight per length of cables."""
        return 0.5 * GRAVITY * self.source.team.cable_density

    @cached_property
    def taut_weight(self) -> Enclosed:
        """[N/m] Half of the weight per length of taut cables."""
        return self.half * self.scalar(taut_shares)

    @cached_property
    def slack_weight(self) -> Enclosed:
        """[N/m] Half of the weight per length of hanging cables."""
        return self.half - self.taut_weight

    @cached_property
    def partner(self) -> Enclosed:
        """[m] The other end of the cable."""
        return Enclosed(self.read(partners(self.source)), self.noise)

    @cached_property
    def length(self) -> Array:
        """The cable's length (spans,) [m]."""
        return self.source.team.cable_length[self.item // 2]

    @cached_property
    def load(self) -> Enclosed:
        """[N] Minus the force of the cable on the drone."""
        load = self.along * self.pull
        if self.heavy:
            load = load + (self.leg.norm * self.taut_weight).upward()
        if self.hangs:
            inward, downward = self.pull_terms
            load = load - _pulled(self.partner, inward, downward, self.slack_weight)
            load = load + (self.slack_weight * self.length[:, None]).upward()
        return load

    @cached_property
    def pull_terms(self) -> tuple[Interval, Interval]:
        """1/σ and coth σ, which fall with the σ of the cable if it hung free."""
        sigma = steepness_of(self.partner, self.length)
        low, high = pull_terms(sigma.high), pull_terms(sigma.low)
        return Interval(low[0], high[0]), Interval(low[1], high[1])

    @cached_property
    def thrust(self) -> Enclosed:
        """[N] f = m (a + g ẑ) - (force of the cable)."""
        hover = self.mass * GRAVITY * UPWARD
        own = self.moved(2) * self.mass + hover if self.moving else Enclosed(hover[..., None])
        return own + self.load if self.source.team.has_cables else own

    @cached_property
    def load_rate(self) -> Enclosed:
        """[N/s] The derivative of the load by time."""
        parts = self.source.drones, self.source.vertices
        margin = sum(float(np.max(derivative_margin(part, 1))) for part in parts)
        velocity = Enclosed(self.read(rate(self.source, pull_vectors)), margin)
        along = self.along.reduced(ORDER)
        swept = (velocity * self.leg.norm.inverse).reduced(ORDER)
        turning = swept - along * along.dot(swept).reduced(ORDER)  # d/dt (y/|y|)
        pulled = self.scalar(tensions_of_legs, 1)
        if self.heavy:
            gained = self.half * self.scalar(taut_shares, 1)
            # Of h z + √(T² - h² s²): h half of the weight per length, s and z of the leg.
            falls = gained * self.level + self.taut_weight * self.leg.level.dot(velocity.level)
            pulled = (pulled - self.sag * falls.reduced(ORDER)) * self.levelled.inverse
            pulled = pulled.reduced(ORDER) + gained * self.leg[2] + self.taut_weight * velocity[2]
        slope = along * pulled + turning * self.pull
        if self.heavy:
            growing = along.dot(velocity)
            slope = slope + (self.leg.norm * gained + growing * self.taut_weight).upward()
        if self.hangs:
            slope = slope + self._hanging_rate(gained)
        return slope

    def _hanging_rate(self, gained: Enclosed) -> Enclosed:
        """Return the derivative of the load of free cables.

        ``(coth σ - 1/σ) σ̇ = Λ̇/Λ - ṡ/s``, s the ends' distance as seen from above, h their height
        difference and ``Λ² = L² - h²``; 1/σ falls by ``σ̇/σ²`` and coth σ by ``σ̇/sinh² σ``.
        """
        moved = Enclosed(self.read(rate(self.source, partners)), ROUNDING)
        inward, downward = self.pull_terms
        across, rise = self.partner.level, self.partner[2]
        widening = across.dot(moved.level).range * _inverse_square(across.norm_range)
        heights = rise.norm_range
        whole = (level_length(each, self.length) for each in (heights.high, heights.low))
        lifting = (rise * moved[2]).range * _inverse_square(Interval(*whole))
        slope = Interval(downward.high - inward.high, downward.low - inward.low)  # rises with σ
        falling = (widening + lifting) * slope.inverse  # -σ̇
        change = (
            falling * Interval(inward.low**2, inward.high**2),
            falling * Interval(downward.low**2 - 1.0, downward.high**2 - 1.0),
        )
        lost = _pulled(self.partner, inward, downward, -gained)
        lost = lost + _pulled(moved, inward, downward, self.slack_weight)
        lost = lost + _pulled(self.partner, *change, self.slack_weight)
        return -lost - (gained * self.length[:, None]).upward()

    @cached_property
    def turning(self) -> Enclosed:
        """ω = f × ḟ / |f|² [rad/s], about the axes across the thrust."""
        own = self.moved(3) * self.mass
        change = own + self.load_rate if self.source.team.has_cables else own
        f, change = self.thrust.reduced(ORDER), change.reduced(ORDER)
        ratio = (f.cross(change).reduced(ORDER) * f.norm.inverse).reduced(ORDER)
        return ratio * f.norm.inverse


def _pulled(offset: Enclosed, inward: Interval, downward: Interval, w: Enclosed) -> Enclosed:
    """Return ``w (k x, k y, l z)`` of an offset."""
    return vector(offset.level * inward.enclosed, offset[2] * downward.enclosed) * w


class Hovering(Drones):
    """Spans of drones, as if they hovered at their positions."""

    moving = False


class Points(MotionSpans):
    """Spans of the hitch's points."""

    names = staticmethod(attrgetter("team.point_names"))


def steepness_of(offset: Enclosed, length: Array) -> Interval:
    """Return the steepness of hanging cables of lengths (spans,) [m], given their ends' offsets."""
    apart, heights = offset.level.norm_range, offset[2].norm_range
    tiny = 1e-6 * length
    return Interval(
        steepness(level_length(heights.high, length) / np.maximum(apart.high, tiny)),
        steepness(level_length(heights.low, length) / np.maximum(apart.low, tiny)),
    )


def _inverse_square(size: Interval) -> Interval:
    return Interval(*(np.maximum(end, NEAREST) ** -2 for end in (size.high, size.low)))


def tilt(spans: Drones) -> Bound:
    """Return the angle of the thrust from +z [deg].

    It is largest where the thrust rises least, and leads aside most, or least if it leads down.
    """
    rise, level = spans.thrust[2].below.value, spans.thrust.level
    most = level.norm_above
    aside = np.where(rise >= 0.0, most.value, level.norm_below.value)
    return Bound(np.degrees(np.arctan2(aside, rise)), most.x)


def turning_rate(spans: Drones) -> Bound:
    """Return the body rate about x and y [deg/s]; infinite where a thrust may vanish."""
    rates, known = spans.turning.norm_above, np.isfinite(spans.thrust.norm.inverse.r)
    return Bound(np.where(known, np.degrees(rates.value) * (1.0 + ROUNDING), np.inf), rates.x)


def _norm(spans: MotionSpans, order: int) -> Bound:
    """Return the norm of a derivative of a position by time."""
    part = spans.source.vertices if isinstance(spans, Points) else spans.source.drones
    return spans.derivative(part, order).norm_above


def _rate_rule(name: str, unit: str, order: int, over: type[MotionSpans] = Drones) -> CheckRule:
    """Return the rule that holds the norm of a derivative against ``Limits.with_reserve.name``."""
    limit_of = attrgetter(f"requirements.limits.with_reserve.{name}")
    largest = WorstOverSpans(over, partial(_norm, order=order), "max", 0.0)
    states = HITCHED_STATE if over is Points else frozenset(CableState)
    evaluators = (Evaluator(largest, states, order == 1 and over is Drones),)
    remedy = f"raise limits.{name}"
    return CheckRule(name, unit, "max", limit_of, evaluators, remedy, ease="time", derivative=order)


FASTEST = WorstOverSpans(Drones, partial(_norm, order=1), "max", 0.0)

SPEED = _rate_rule("speed", "m/s", 1)
ACCELERATION = _rate_rule("acceleration", "m/s²", 2)
JERK = _rate_rule("jerk", "m/s³", 3)
VERTEX_SPEED = _rate_rule("vertex_speed", "m/s", 1, Points)


def used_thrust(spans: Drones) -> Bound:
    """Return the thrust over the drone's ``max_thrust``."""
    thrust = spans.thrust.norm_above
    return Bound(thrust.value / spans.source.team.max_thrust[spans.item], thrust.x)


USED_THRUST = WorstOverSpans(
    Drones, used_thrust, "max", item_limits=lambda motion: motion.team.max_thrust
)

THRUST = CheckRule(
    "thrust",
    "N",
    "max",
    lambda motion: float(np.max(motion.team.max_thrust)),
    (Evaluator(USED_THRUST, exported=True, shown=(Drones.thrust, Drones.load)),),
    "give the drone more thrust, or lower team.tension",
    "give the drone more thrust, or lower team.cable_density",
    "tension",
    derivative=2,
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
)


TURNING_RATE = WorstOverSpans(Drones, turning_rate, "max", 0.0)

BODY_RATE = CheckRule(
    "body_rate",
    "deg/s",
    "max",
    lambda motion: (
        None if (limit := motion.requirements.limits.body_rate) is None else math.degrees(limit)
    ),
    (Evaluator(TURNING_RATE, shown=(Drones.turning, Drones.load_rate)),),
    "raise limits.body_rate_deg",
    ease="time",
    derivative=3,
)


class Legs(MotionSpans):
    """Spans of legs."""

    @classmethod
    def names(cls, motion: Motion) -> Sequence[str]:
        """Return the legs' names."""
        return [f"{end}-leg {k}" for k in range(motion.team.robots) for end in "qr"]


def _length(spans: Legs) -> Bound:
    """Return the length of ``q_k - p_k`` or ``r_k - p_{k+1}`` [m], infinite at a chain's ends."""
    lengths = Enclosed(spans.read(leg_vectors(spans.source)), spans.noise).norm_below
    there = spans.source.team.layout.has_leg.ravel()[spans.item]
    return Bound(np.where(there, lengths.value, np.inf), lengths.x)


LEGS = CheckRule(
    "legs",
    "m",
    "min",
    lambda motion: motion.requirements.limits.leg,
    (Evaluator(WorstOverSpans(Legs, _length, "min", magnitude), HITCHED_STATE),),
    "use a longer cable, a smaller polygon, or a smaller limits.leg",
    ease="length",
)
"""The shortest leg ``|q_k - p_k|`` or ``|r_k - p_{k+1}|``; ``where`` is ``q-leg k``."""


def largest_rate(
    part: PiecewisePolynomial,
    order: int,
    limit: float = math.nan,
    size: Callable[[Enclosed], Bound] = lambda rate: rate.norm_above,
) -> Extremum:
    """Return the largest norm, or other size, of a derivative by time of points (items, d).

    The bound is as tight as needed to decide whether it satisfies the limit.
    """
    rates, margin = derivative(part, order), derivative_margin(part, order)

    def formula(spans: Spans) -> Bound:
        return size(Enclosed(spans.read(rates), margin[spans.piece, spans.item]))

    spans = Spans.all_of(part, part.breaks, part.shape[0])
    return worst(spans, formula, "max", target=within(limit, "max", 0.0, 0.5))


def largest_at_rest(motion: Motion, quantity: Callable[[Drones], Bound]) -> float:
    """Return the largest ``tilt`` [deg], or ``used_thrust``, of drones that hover, for all t."""
    return worst(Hovering.of(motion), quantity, "max").worst
