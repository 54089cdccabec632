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
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.model import DroneJets, FlatJets, drone_jets
from hitchopt.hitch.requirements import Limits
from hitchopt.motion.motion import Motion
from hitchopt.planners.morph import jets
from hitchopt.planners.timing.flight import Flight
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.values import Array

JET, STATE = 4, 3  # numbers of derivatives of a jet and of a state, the zeroth included
BRAKES = (0.3, 0.45, 0.7, 1.0, 1.5, 2.2, 3.2)  # durations of the brake that are tried [s]
SHORTEST = 0.3  # shortest shift [s]
SIDE = 1e-9  # share of a duration by which one-sided derivatives are taken inside of it

# Shares of the limits that are used at samples, by the brake alone and by the whole, and to which
# that is prolonged; the rest is for what is between samples
BRAKE_SHARE, SHARE, AIM = 0.9, 0.99, 0.989

# Samples over the duration, of the whole and of a brake
PLACES = np.linspace(0.0, 1.0, 16, endpoint=False)
BRAKE_PLACES = np.append(np.linspace(0.0, 1.0, 8, endpoint=False), 1.0 - SIDE)

# Maximum number of times that a shift is prolonged, and the least factor by which it is
ROUNDS, GROWTH = 10, 1.04


@dataclass(frozen=True, eq=False)
class MovingState:
    """A hitch in motion: values with their first two derivatives by time."""

    vertices: Array  # (points, 3, 3) [m]
    fractions: Array  # (n, 3), ``d_k / (d_k + e_k)``
    drones: Array  # (2n, 3, 3) [m]
    legs: Array  # (n, 2, 3) [m]

    @classmethod
    def at_end(cls, motion: Motion) -> MovingState:
        """Return the state in which a motion ends."""
        legs, layout = motion.legs.end_jet(STATE), motion.team.layout
        slack = legs[:, 0] + legs[:, 1]
        free = ~np.all(layout.has_leg, axis=1) & (slack[:, 0] <= 0.0)
        slack[free, 0] = 1.0  # of cables at a chain's ends that have no leg at all
        fractions = jets.product(legs[:, 0], jets.reciprocal(slack))
        return cls(motion.vertices.end_jet(STATE), fractions, motion.drones.end_jet(STATE), legs)

    @property
    def moves(self) -> bool:
        """Whether anything moves or accelerates."""
        return bool((np.abs(self.drones[..., 1:]) > 1e-9).any())


@dataclass(frozen=True, eq=False)
class RetargetPath:
    """Flat outputs from a moving state to a hitch at rest."""

    team: Team
    state: MovingState
    end: Array  # vertices (points, 3) [m] at rest
    fractions: Array  # (n,), shares of the slack at rest
    yaw: float = 0.0  # angle by which the frame turns [rad]

    @classmethod
    def to(cls, team: Team, state: MovingState, end: Hitch, yaw: float) -> RetargetPath:
        """Return the path to a hitch, full turns chosen to come closest to a yaw [rad].

        Its frame turns by what is left from the state to the hitch, also where the state has not
        finished an earlier turn: on straight lines to the goal a half-turned polygon would shrink.
        """
        vertices = end.vertices
        left = _turn(state.vertices[:, :2, 0], vertices[:, :2])
        left += 2.0 * math.pi * round((yaw - left) / (2.0 * math.pi))
        return cls(team, state, vertices, end.fractions, left)

    @cached_property
    def _ends(self) -> tuple[Array, Array]:
        """Mean point, shape about it, fractions, turn: (m, 3) at the start, (m,) in the end."""
        centre, goal = self.state.vertices.mean(axis=0), self.end.mean(axis=0)
        shape = (self.state.vertices - centre).reshape(-1, STATE)
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        back = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        first = (centre, shape, self.state.fractions, np.zeros((1, STATE)))
        last = (goal, ((self.end - goal) @ back).ravel(), self.fractions, [self.yaw])
        return np.concatenate(first), np.concatenate(last)

    def jets(self, t: Array, brake: float, shift: float | None) -> tuple[Array, DroneJets]:
        """Return the jets of vertices (J, points, 3, 4) and of drones at times t (J,) [s].

        ``brake`` and ``shift`` are durations [s]; no shift leads to where the brake does.
        """
        team, layout = self.team, self.team.layout
        start, goal = self._ends
        rest = start @ np.array([1.0, 0.5 * brake, brake**2 / 12.0])
        each = _to_rest(start, rest, brake, t)
        if shift is not None:
            each += _to_rest(np.zeros(start.shape), goal - rest, shift, t)
        centre, split = each[:, :3], each[:, 3 + 3 * layout.points : -1]
        shape = each[:, 3 : 3 + 3 * layout.points].reshape(len(t), layout.points, 3, JET)
        vertices = centre[:, None] + (_turned(shape, each[:, -1]) if self.yaw != 0.0 else shape)
        edges = layout.edges(vertices, axis=1)
        slack = -jets.square_root(np.sum(jets.product(edges, edges), axis=2))
        slack[..., 0] += team.cable_length
        wanted, orders = jets.product(split, slack), np.moveaxis(slack, -1, 0)
        q_legs = np.moveaxis(layout.q_legs_of(np.moveaxis(wanted, -1, 0), orders), 0, -1)
        tensions = np.zeros((len(t), team.robots, JET))
        tensions[..., 0] = team.tension
        return vertices, drone_jets(team, FlatJets(vertices, q_legs, tensions))

    def flight(self, breaks: Array, brake: float, shift: float) -> Flight:
        """Return the polynomials, which meet the state itself at their start."""
        count, h = len(breaks) - 1, SIDE * (breaks[1:] - breaks[:-1])
        sides = np.concatenate([breaks[:-1] + h, breaks[1:] - h])
        vertices, found = self.jets(sides, brake, shift)
        legs = found.legs * self.team.layout.has_leg[..., None]
        starts = (self.state.drones, self.state.vertices, self.state.legs)
        each = [part.reshape(2 * count, -1, JET) for part in (found.positions, vertices, legs)]
        orders = np.moveaxis(np.concatenate(each, axis=1), -1, 0)
        left, right = orders[:, :count], orders[:, count:]
        left[:STATE, 1:] = right[:STATE, :-1]
        left[:STATE, 0] = np.concatenate([part.reshape(-1, STATE) for part in starts]).T
        right[1:STATE, -1] = 0.0
        both = PiecewisePolynomial.hermite(breaks, left, right)
        drones, points, leg_curves = both.split([part.shape[:-1] for part in starts])
        pulls = np.repeat(self.team.tension[None, :, None], count, axis=0)
        return Flight(drones, points, leg_curves, both.alike(pulls))

    def excess(self, limits: Limits, t: Array, brake: float, shift: float | None) -> float:
        """Return how many times slower a motion would have to be at times (J,) [s], at most.

        Exact for speed, acceleration and jerk; thrust and tilt, which do not scale, count by the
        square root of their share of the limit. At the first one, 0, only the jerk counts: the
        state is given.
        """
        points, found = self.jets(t, brake, shift)
        squared = np.einsum("jdxk,jdxk->kjd", found.positions, found.positions)
        moved = points[1:, ..., 1]
        thrust = found.thrusts[1:]
        level2, up = thrust[..., 0] ** 2 + thrust[..., 1] ** 2, thrust[..., 2]
        ratios = (
            math.sqrt(np.max(squared[1, 1:])) / limits.speed,
            math.sqrt(np.max(np.einsum("jpx,jpx->jp", moved, moved))) / limits.vertex_speed,
            np.max(squared[2, 1:]) ** 0.25 / math.sqrt(limits.acceleration),
            math.sqrt(np.max(np.sqrt(level2 + up * up) / self.team.max_thrust)),
            math.sqrt(np.max(np.arctan2(np.sqrt(level2), up)) / limits.tilt),
            (np.max(squared[3]) / limits.jerk**2) ** (1.0 / 6.0),
        )
        most = float(max(ratios))
        return most if math.isfinite(sum(ratios)) else math.inf

    def brake(self, limits: Limits) -> float | None:
        """Return the duration [s] in which the state comes to rest within the limits, or None."""
        if not self.state.moves:
            return BRAKES[0]
        for brake in BRAKES:
            if self.excess(limits, brake * BRAKE_PLACES, brake, None) <= BRAKE_SHARE:
                return brake
        return None

    def shortest_shift(self, limits: Limits, brake: float) -> float | None:
        """Return the duration [s] of a shift that keeps all limits at samples, or None."""
        shift = SHORTEST
        for _ in range(ROUNDS):
            last = np.array([brake, shift]) * (1.0 - SIDE)
            times = np.concatenate([max(shift, brake) * PLACES, last])
            found = self.excess(limits, times, brake, shift)
            if found <= SHARE:
                return shift
            if not math.isfinite(found):
                return None
            shift *= max(found / AIM, GROWTH)
        return None


def _to_rest(start: Array, rest: Array, duration: float, t: Array) -> Array:
    """Return the jets (J, m, 4) of the quintics from a state (m, 3) to rest at a place (m,)."""
    p, v, a = start.T
    curves = np.stack([p, p + duration / 5.0 * v, rest, rest, rest, rest], axis=-1)
    curves[:, 2] = p + duration * (0.4 * v + duration / 20.0 * a)
    weights = bernstein.jet_basis(np.minimum(t / duration, 1.0), 5, JET)
    weights[t >= duration, :, 1:] = 0.0
    found: Array = curves @ (weights / duration ** np.arange(JET))
    return found


def _turned(shape: Array, angle: Array) -> Array:
    """Return the jets of shapes (J, points, 3, 4) turned by angles with jets (J, 4)."""
    c, s = np.cos(angle[:, 0]), np.sin(angle[:, 0])
    outer = np.stack([[c, -s, -c, s], [s, c, -s, -c]])  # derivatives of cosine and sine
    around = jets.chained(np.moveaxis(outer, 2, 0), angle[:, None])
    # (J, points, 2, 2, 4): cosine and sine times x and y.
    parts = jets.product(around[:, None, :, None], shape[:, :, None, :2])
    found = shape.copy()
    found[:, :, 0] = parts[:, :, 0, 0] - parts[:, :, 1, 1]
    found[:, :, 1] = parts[:, :, 1, 0] + parts[:, :, 0, 1]
    return found


def _turn(first: Array, last: Array) -> float:
    """Return the angle [rad] by which points (k, 2) about their mean fit the last ones best."""
    x, y = first - first.mean(axis=0), last - last.mean(axis=0)
    return math.atan2(x[:, 0] @ y[:, 1] - x[:, 1] @ y[:, 0], np.vdot(x, y))
