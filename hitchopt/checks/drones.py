"""Checks of single drones, from ``speed`` to ``legs``, and ``vertex_speed``."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from operator import attrgetter

import numpy as np

from hitchopt.checks.certificate import with_tolerance
from hitchopt.checks.drone_forces import DroneForces, hanging_jets, hanging_terms
from hitchopt.checks.rule import CheckRule, Evaluator, WorstOverSpans
from hitchopt.checks.spans import (
    ROUNDING,
    MotionSpans,
    derivative,
    derivative_margin,
    leg_vectors,
    magnitude,
    rate,
)
from hitchopt.motion.motion import Motion
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.trajectory.enclosed import Bound, Enclosed
from hitchopt.trajectory.jets import ORDER, Jet
from hitchopt.trajectory.search import Extremum, TimeSpans, worst
from hitchopt.values import Array, lazy

EXPORTED_ACCELERATION = 1.02
"""The limit of accelerations in files, over that in plans: quintics between samples exceed it where
jerk is discontinuous."""


class Drones(MotionSpans, DroneForces[Enclosed]):
    """Spans of drones: their motion, the force of their cable and their thrust."""

    names = staticmethod(attrgetter("team.drone_names"))

    def motion_rate(self, order: int) -> Enclosed:
        """Return a time derivative of the position."""
        return self.derivative(self.source.drones, order)

    @lazy
    def curves(self) -> dict[Callable[[Motion], Array], Enclosed]:
        """Curves that have been read, by their tables."""
        return {}

    def vector_of(self, table: Callable[[Motion], Array]) -> Enclosed:
        """Return differences of positions."""
        if table not in self.curves:
            self.curves[table] = Enclosed(self.read(table(self.source)), self.noise)
        return self.curves[table]

    def scalar_of(self, table: Callable[[Motion], Array]) -> Enclosed:
        """Return a computed scalar."""
        if table not in self.curves:
            c = self.read(table(self.source))[:, None]
            self.curves[table] = Enclosed(c, _rounding(c))
        return self.curves[table]

    @lazy
    def pull_terms(self) -> tuple[Enclosed, Enclosed]:
        """1/σ and coth σ of the cable as if hanging."""
        inward, downward = hanging_terms(self.partner, self.length)
        return inward.enclosed, downward.enclosed

    @lazy
    def jets(self) -> DroneJets:
        """The same forces with their time derivatives."""
        return DroneJets(self)

    def by_time(self, rate: Enclosed) -> Enclosed:
        """Return a time derivative, from that with respect to the plan's time."""
        return rate

    @lazy
    def turning(self) -> Enclosed:
        """ω = f × ḟ / |f|² [rad/s], about axes perpendicular to the thrust."""
        thrust = self.thrust.reduced(ORDER)
        moment = thrust.cross(self.jets.thrust.rate.reduced(ORDER)).reduced(ORDER)
        return (moment * thrust.norm.inverse).reduced(ORDER) * thrust.norm.inverse


class DroneJets(DroneForces[Jet]):
    """Forces of drones on spans, with their time derivatives."""

    def __init__(self, spans: Drones) -> None:
        self.spans, self.source, self.item = spans, spans.source, spans.item

    def motion_rate(self, order: int) -> Jet:
        """Return a time derivative of the position."""
        return Jet(self.spans.motion_rate(order), self.spans.motion_rate(order + 1))

    def vector_of(self, table: Callable[[Motion], Array]) -> Jet:
        """Return differences of positions."""
        parts = self.source.drones, self.source.vertices
        margin = sum(float(np.max(derivative_margin(part, 1))) for part in parts)
        change = Enclosed(self.spans.read(rate(self.source, table)), margin)
        return Jet(self.spans.vector_of(table), self.spans.by_time(change))

    def scalar_of(self, table: Callable[[Motion], Array]) -> Jet:
        """Return a computed scalar."""
        c = self.spans.read(rate(self.source, table))[:, None]
        return Jet(self.spans.scalar_of(table), self.spans.by_time(Enclosed(c, _rounding(c))))

    @lazy
    def pull_terms(self) -> tuple[Jet, Jet]:
        """1/σ and coth σ of the cable as if hanging."""
        return hanging_jets(self.partner, self.length)


def _rounding(c: Array) -> Array:
    """Return the rounding errors (spans,) of computed polynomials (spans, components, …)."""
    return np.asarray(ROUNDING * np.max(np.abs(c), axis=(1, 2)))


class Hovering(Drones):
    """Spans of drones that hover at their positions."""

    def motion_rate(self, order: int) -> Enclosed:
        """Return the position, or zero for its derivatives."""
        if order == 0:
            return super().motion_rate(0)
        return Enclosed(np.zeros((len(self), 3, 1)))


class Points(MotionSpans):
    """Spans of the hitch's points."""

    names = staticmethod(attrgetter("team.point_names"))


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
        applies=lambda state: state.hitched or over is not Points,
        exported=order <= 2 and over is Drones,
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
        exported_share=EXPORTED_ACCELERATION if order == 2 else 1.0,
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
    (Evaluator(THRUST_SHARE, exported=True, formulas=(DroneForces.thrust, DroneForces.load)),),
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
    # Already lowered to what controllers allow, by ``Requirements.flown_by``
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
    (Evaluator(TURNING_RATE, formulas=(Drones.turning,)),),
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
    scale = spans.source.requirements.error_scale
    legs = spans.read(leg_vectors(spans.source)) * scale[:, None]
    lengths = Enclosed(legs, spans.noise).norm_lower
    exists = spans.source.team.layout.has_leg.ravel()[spans.item]
    return Bound(np.where(exists, lengths.value, np.inf), lengths.x)


LEGS = CheckRule(
    "legs",
    "m",
    "min",
    lambda motion: motion.requirements.limits.leg,
    (Evaluator(WorstOverSpans(Legs, _length, "min", magnitude), lambda state: state.hitched),),
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
