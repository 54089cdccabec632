"""Motion of a hitch from a moving state to rest in another hitch, in closed form.

The polygon's mean point, its shape as seen from a frame that turns with it, and the split of the
cables' slack are sums of two curves: a *brake*, the quartic with the least jerk that comes to rest
in a given time wherever that is, and a *shift*, the quintic from rest to rest that leads from there
to the goal. The longer the shift takes the less it adds, so that the sum keeps every limit that the
brake keeps with something to spare. The frame turns from rest to rest, so that a hitch that is to
be turned keeps its shape. Drones follow from these flat outputs.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cache, cached_property
from math import perm

import numpy as np

from hitchopt.geometry.vectors import dot, length
from hitchopt.hitch import GRAVITY, Hitch, Team
from hitchopt.hitch.requirements import Limits
from hitchopt.model.evaluation import DroneJets, FlatJets, drone_jets
from hitchopt.motion.motion import Motion
from hitchopt.planners.morph import jets
from hitchopt.planners.timing.flight import Flight
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.values import Array

JET, STATE = 4, 3
"""Numbers of derivatives of a jet and of a state, the zeroth included."""

QUINTIC = np.array([0.0, 0.0, 0.0, 10.0, -15.0, 6.0])
"""Coefficients of the quintic from 0 to 1, by powers of time over duration."""

PEAK_SPEED, PEAK_ACCELERATION, PEAK_JERK = 1.875, 10.0 / np.sqrt(3.0), 60.0
"""Largest derivatives of the quintic, by time over duration."""

FACTORS = np.array([[perm(k, order) for k in range(len(QUINTIC))] for order in range(JET)], float)
"""Factors of the powers' derivatives."""

BRAKES = (0.3, 0.45, 0.7, 1.0, 1.5, 2.2, 3.2)
"""[s] Durations of the brake that are tried."""

BRAKE_SHARES, SHARE = (0.85, 0.95), 0.99
"""Shares of the limits that are used at samples, by the brake alone (the larger one where no brake
keeps the smaller) and by the whole; the rest is for what is between samples."""

AFTER = 1e-6
"""Share of a duration before its end at which one-sided derivatives are taken."""

PLACES = np.linspace(0.0, 1.0, 16, endpoint=False)
BRAKE_PLACES = np.append(np.linspace(0.0, 1.0, 8, endpoint=False), 1.0 - AFTER)
"""Samples over the duration, of the whole and of a brake."""

SHORTEST = 0.3
"""[s] Shortest shift."""

ROUNDS, GROWTH = 8, 1.04
"""Maximum number of times that a shift is prolonged, and the least factor by which it is."""

ROUNDING = 1e-6
"""Relative difference of durations that rounding may make of equal states."""

SIDE = 1e-9
"""Share of a piece by which one-sided derivatives are taken inside of it."""

ORDERS = np.tile(np.arange(JET, dtype=np.float64), 2)[:, None]
"""Orders of the derivatives at both ends of a piece."""


@dataclass(frozen=True, eq=False)
class SmoothChange:
    """Curves of values of one shape, from a moving state to rest at a goal.

    Attributes
    ----------
    start: (*shape, 3), value, velocity and acceleration at time 0.
    goal: (*shape)
    """

    start: Array
    goal: Array

    def braked(self, brake: float) -> Array:
        """Return where a brake of a duration [s] comes to rest, (*shape)."""
        rest: Array = self.start @ np.array([1.0, 0.5 * brake, brake**2 / 12.0])
        return rest

    def jets(self, t: Array, brake: float, shift: float) -> Array:
        """Return the jets (J, *shape, 4) at times t (J,) [s].

        Parameters
        ----------
        brake, shift: durations [s].
        """
        p, v, a = (self.start[..., k] for k in range(3))
        b = brake
        third, fourth = -(v / b + 2.0 * a / 3.0) / b, (0.5 * v / b + 0.25 * a) / b**2
        stop = self.braked(brake)
        slowed = _polynomial(np.stack([p, v, 0.5 * a, third, fourth]), np.minimum(t, b))
        slowed[t >= b, ..., 1:] = 0.0
        moved = _polynomial(QUINTIC, np.minimum(t / shift, 1.0)) / shift ** np.arange(JET)
        moved[t >= shift, 1:] = 0.0
        axes = (len(t), *(1,) * stop.ndim, JET)
        result: Array = slowed + (self.goal - stop)[..., None] * moved.reshape(axes)
        return result


def _polynomial(powers: Array, t: Array) -> Array:
    """Return the jets (J, *shape, 4) of polynomials with coefficients (N, *shape) by t."""
    count = len(powers)
    table = t[:, None] ** np.arange(count)
    rows = np.zeros((JET, len(t), count))
    for order in range(JET):
        rows[order, :, order:] = FACTORS[order, order:count] * table[:, : count - order]
    found = rows.reshape(-1, count) @ powers.reshape(count, -1)
    found = found.reshape(JET, len(t), *powers.shape[1:])
    return found.transpose(*range(1, found.ndim), 0)


@dataclass(frozen=True, eq=False)
class MovingState:
    """A hitch in motion.

    Attributes
    ----------
    vertices: (points, 3, 3), positions and their first two derivatives by time.
    fractions: (n, 3), ``d_k / (d_k + e_k)``.
    drones: (2n, 3, 3)
    legs: (n, 2, 3)
    """

    vertices: Array
    fractions: Array
    drones: Array
    legs: Array

    @classmethod
    def at_end(cls, motion: Motion) -> MovingState:
        """Return the state in which a motion ends."""
        legs, layout = motion.legs.end_jet(STATE), motion.team.layout
        slack = legs[:, 0] + legs[:, 1]
        if not layout.closed:
            has_both = np.all(layout.has_leg, axis=1)
            slack[~has_both, 0] = np.where(slack[~has_both, 0] > 0.0, slack[~has_both, 0], 1.0)
        (d, v, a), (s, w, b) = legs[:, 0].T, slack.T
        f = d / s
        g = (v - f * w) / s
        fractions = np.stack([f, g, (a - 2.0 * g * w - f * b) / s], axis=1)
        return cls(motion.vertices.end_jet(STATE), fractions, motion.drones.end_jet(STATE), legs)

    @property
    def moves(self) -> bool:
        """Whether anything moves or accelerates."""
        return bool((np.abs(self.drones[..., 1:]) > 1e-9).any())

    @cached_property
    def curves(self) -> Array:
        """(3 + 3 points + n, 3): the mean point, the shape about it, and the fractions."""
        centre = _mean(self.vertices)
        shape = (self.vertices - centre).reshape(-1, STATE)
        return np.concatenate([centre, shape, self.fractions])

    @cached_property
    def radius(self) -> float:
        """Distance of the farthest drone from the mean point [m]."""
        return float(np.max(length(self.drones[..., 0] - self.curves[:3, 0])))


@dataclass(frozen=True, eq=False)
class RetargetPath:
    """Flat outputs from a moving state to a hitch at rest.

    Attributes
    ----------
    team: whose cables.
    state: at time 0.
    end: vertices (points, 3) [m] and fractions (n,) at rest.
    fractions: see ``end``.
    yaw: by how much the frame turns [rad].
    """

    team: Team
    state: MovingState
    end: Array
    fractions: Array
    yaw: float = 0.0

    @classmethod
    def to(cls, team: Team, state: MovingState, end: Hitch, yaw: float) -> RetargetPath:
        """Return the path to a hitch.

        Its frame turns by what is left from the state to the hitch, also where the state has not
        finished an earlier turn: on straight lines to the goal a half-turned polygon would shrink.

        Parameters
        ----------
        yaw: that is asked for [rad]; full turns are chosen to come closest to it.
        """
        vertices = end.vertices
        left = _turn(state.vertices[:, :2, 0], vertices[:, :2])
        left += 2.0 * math.pi * round((yaw - left) / (2.0 * math.pi))
        return cls(team, state, vertices, end.fractions, left)

    @cached_property
    def _change(self) -> SmoothChange:
        """Curves of the mean point, of the shape about it, and of the fractions, in a row."""
        goal = _mean(self.end)
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        back = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        ends = np.concatenate([goal, ((self.end - goal) @ back).ravel(), self.fractions])
        return SmoothChange(self.state.curves, ends)

    def farthest(self, brake: float) -> float:
        """Return about how far a shift takes the vertices, and its turn the drones [m]."""
        away = self.end - SmoothChange(self.state.vertices, self.end).braked(brake)
        moved = math.sqrt(float(np.max(dot(away, away))))
        return max(moved, 0.5 * abs(self.yaw) * self.state.radius)

    def jets(self, t: Array, brake: float, shift: float) -> tuple[Array, DroneJets]:
        """Return the jets of vertices (J, points, 3, 4) and of drones at times t (J,) [s]."""
        team, layout = self.team, self.team.layout
        each = self._change.jets(t, brake, shift)
        centre, split = each[:, :3], each[:, 3 + 3 * layout.points :]
        shape = each[:, 3 : 3 + 3 * layout.points].reshape(len(t), layout.points, 3, JET)
        vertices = centre[:, None] + self._turned(shape, t, shift)
        edges = layout.edges(vertices, axis=1)
        slack = -jets.square_root(np.sum(jets.product(edges, edges), axis=2))
        slack[..., 0] += team.cable_length
        wanted, orders = jets.product(split, slack), np.moveaxis(slack, -1, 0)
        q_legs = np.moveaxis(layout.q_legs_of(np.moveaxis(wanted, -1, 0), orders), 0, -1)
        tensions = np.zeros((len(t), team.robots, JET))
        tensions[..., 0] = team.tension
        return vertices, drone_jets(team, FlatJets(vertices, q_legs, tensions))

    def _turned(self, shape: Array, t: Array, shift: float) -> Array:
        """Return the jets of shapes seen from the world."""
        if self.yaw == 0.0:
            return shape
        angle = SmoothChange(np.zeros(3), np.array(self.yaw)).jets(t, shift, shift)
        c, s = np.cos(angle[:, 0]), np.sin(angle[:, 0])
        outer = np.stack([[c, -s, -c, s], [s, c, -s, -c]])  # derivatives of cosine and sine
        around = jets.chained(np.moveaxis(outer, 2, 0), angle[:, None])
        # (J, points, 2, 2, 4): cosine and sine times x and y.
        parts = jets.product(around[:, None, :, None], shape[:, :, None, :2])
        found = shape.copy()
        found[:, :, 0] = parts[:, :, 0, 0] - parts[:, :, 1, 1]
        found[:, :, 1] = parts[:, :, 1, 0] + parts[:, :, 0, 1]
        return found

    def flight(self, breaks: Array, brake: float, shift: float) -> Flight:
        """Return the polynomials, which meet the state itself at their start."""
        count, h = len(breaks) - 1, SIDE * (breaks[1:] - breaks[:-1])
        sides = np.concatenate([breaks[:-1] + h, breaks[1:] - h])
        vertices, found = self.jets(sides, brake, shift)
        legs = found.legs * self.team.layout.has_leg[..., None]
        starts = (self.state.drones, self.state.vertices, self.state.legs)
        each = [part.reshape(2 * count, -1, JET) for part in (found.positions, vertices, legs)]
        start = np.concatenate([part.reshape(-1, STATE) for part in starts])
        orders = np.moveaxis(np.concatenate(each, axis=1), -1, 0)
        left, right = orders[:, :count], orders[:, count:]
        left[:STATE, 1:] = right[:STATE, :-1]
        left[:STATE, 0] = start.T
        right[1:STATE, -1] = 0.0
        ends = np.concatenate([left, right]) * ((breaks[1:] - breaks[:-1]) ** ORDERS)[..., None]
        curves = bernstein.combined(ends.transpose(1, 2, 0), _septics())
        both = PiecewisePolynomial(breaks, curves)
        drones, points, leg_curves = both.split([part.shape[:-1] for part in starts])
        pulls = np.repeat(self.team.tension[None, :, None], count, axis=0)
        return Flight(drones, points, leg_curves, both.alike(pulls))

    def excess(self, limits: Limits, t: Array, brake: float, shift: float) -> float:
        """Return how many times slower a motion would have to be at its samples, at most.

        Exact for speed, acceleration and jerk; thrust and tilt, which do not scale, count by the
        square root of their share of the limit. At t = 0 the state is given: there only the jerk
        counts.

        Parameters
        ----------
        t: (J,) times [s], the first one 0.
        brake, shift: durations [s].
        """
        points, found = self.jets(t, brake, shift)
        squared = np.einsum("jdxk,jdxk->kjd", found.positions, found.positions)
        speed = math.sqrt(float(np.max(squared[1, 1:]))) / limits.speed
        acceleration = math.sqrt(float(np.max(squared[2, 1:]))) / limits.acceleration
        jerk = math.sqrt(float(np.max(squared[3]))) / limits.jerk
        moved = points[1:, ..., 1]
        vertex = math.sqrt(float(np.max(dot(moved, moved)))) / limits.vertex_speed
        thrust = found.thrusts[1:]
        level2, up = thrust[..., 0] ** 2 + thrust[..., 1] ** 2, thrust[..., 2]
        force = float(np.max(np.sqrt(level2 + up * up) / self.team.max_thrust))
        lean = float(np.max(np.arctan2(np.sqrt(level2), up))) / limits.tilt
        most = max(speed, vertex, math.sqrt(max(acceleration, force, lean)), float(np.cbrt(jerk)))
        return most if math.isfinite(most) else math.inf

    def brake(self, limits: Limits) -> float | None:
        """Return the duration [s] in which the state comes to rest within the limits, or None.

        Of a path that does not turn; where it leads makes no difference.
        """
        if not self.state.moves:
            return BRAKES[0]
        left = None
        for brake in BRAKES:
            found = self.excess(limits, brake * BRAKE_PLACES, brake, math.inf)
            if found <= BRAKE_SHARES[0]:
                return brake
            if left is None and found <= BRAKE_SHARES[1]:
                left = brake
        return left

    def shortest_shift(self, limits: Limits, brake: float) -> float | None:
        """Return the duration [s] of a shift that keeps all limits at samples, or None."""
        far = self.farthest(brake)
        if not math.isfinite(far):
            return None
        shift = max(
            PEAK_SPEED * far / limits.speed,
            math.sqrt(PEAK_ACCELERATION * far / limits.acceleration),
            float(np.cbrt(PEAK_JERK * far / limits.jerk)),
            SHORTEST,
        )
        for _ in range(ROUNDS):
            last = (brake * (1.0 - AFTER), shift * (1.0 - AFTER))
            times = np.concatenate([max(shift, brake) * PLACES, last])
            found = self.excess(limits, times, brake, shift)
            if found <= SHARE * (1.0 + ROUNDING):  # a prolonged shift often just keeps it
                return shift
            if not math.isfinite(found):
                return None
            shift *= max(found / SHARE, GROWTH)
        return None


def turning_slowly(limits: Limits) -> Limits:
    """Return limits whose jerk is at most what turns a hovering drone at ``body_rate``."""
    if limits.body_rate is None:
        return limits
    return replace(limits, jerk=min(limits.jerk, GRAVITY * limits.body_rate))


@cache
def _septics() -> Array:
    """Return coefficients (8, 8) by derivatives at both ends times powers of the duration."""
    unit = np.eye(2 * JET)
    curves = PiecewisePolynomial.hermite([0.0, 1.0], unit[:JET, None], unit[JET:, None])
    by_order: Array = curves.coefficients[0].T
    return by_order


def _mean(points: Array) -> Array:
    """Return the mean of points (k, …), in a part of the time that ``numpy.mean`` takes."""
    mean: Array = np.add.reduce(points) / len(points)
    return mean


def _turn(first: Array, last: Array) -> float:
    """Return the angle [rad] by which points (k, 2) about their mean fit the last ones best."""
    x, y = first - _mean(first), last - _mean(last)
    return math.atan2(x[:, 0] @ y[:, 1] - x[:, 1] @ y[:, 0], np.vdot(x, y))
