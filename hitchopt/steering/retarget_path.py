"""Motion of a hitch from a moving state to rest in another hitch: flat outputs in closed form.

The polygon's mean point, its shape as seen from a frame that turns with it, and the split of the
cables' slack are curves of ``smooth_change``. The frame itself turns from rest to rest, so that a
hitch that is to be turned keeps its shape.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np

from hitchopt.geometry.vectors import dot, length
from hitchopt.hitch import Hitch, Team
from hitchopt.model.evaluation import FlatJets, drone_jets
from hitchopt.motion.motion import Motion
from hitchopt.planners.path import jets
from hitchopt.planners.timing.flight_curves import Flight
from hitchopt.steering.smooth_change import JET, STATE, SmoothChange
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.values import Array

SAME_STATE = 1e-6
"""[m] Largest distance of drones from where the team's tensions put them, to begin from there."""

SIDE = 1e-9
"""Share of a piece by which one-sided derivatives are taken inside of it."""


ORDERS = np.tile(np.arange(JET, dtype=np.float64), 2)[:, None]
"""Orders of the derivatives at both ends of a piece."""


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
        fractions = np.empty_like(slack)
        (d, v, a), (s, w, b), (f, g, h) = legs[:, 0].T, slack.T, fractions.T
        np.divide(d, s, out=f)
        np.divide(v - f * w, s, out=g)
        np.divide(a - 2.0 * g * w - f * b, s, out=h)
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
class PathJets:
    """A path at J times.

    Attributes
    ----------
    vertices: (J, points, 3, 4) [m] and derivatives by time.
    drones: (J, 2n, 3, 4)
    legs: (J, n, 2, 4)
    thrusts: (J, 2n, 3) [N]
    """

    vertices: Array
    drones: Array
    legs: Array
    thrusts: Array


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

    def flat(self, t: Array, brake: float, shift: float) -> FlatJets:
        """Return the flat outputs' jets at times t (J,) [s]; the rest is of SmoothChange."""
        team, layout = self.team, self.team.layout
        each = self._change.jets(t, brake, shift)
        centre, split = each[:, :3], each[:, 3 + 3 * layout.points :]
        shape = each[:, 3 : 3 + 3 * layout.points].reshape(len(t), layout.points, 3, JET)
        vertices = centre[:, None] + self._turned(shape, t, shift)
        edges = layout.edges(vertices, axis=1)
        chords = jets.square_root(np.sum(jets.product(edges, edges), axis=2))
        slack = -chords
        slack[..., 0] += team.cable_length
        wanted, orders = jets.product(split, slack), np.moveaxis(slack, -1, 0)
        q_legs = np.moveaxis(layout.q_legs_of(np.moveaxis(wanted, -1, 0), orders), 0, -1)
        tensions = np.zeros((len(t), team.robots, JET))
        tensions[..., 0] = team.tension
        return FlatJets(vertices, q_legs, tensions)

    def _turned(self, shape: Array, t: Array, shift: float) -> Array:
        """Return the jets of shapes seen from the world."""
        if self.yaw == 0.0:
            return shape
        rest = SmoothChange(np.zeros(3), np.array(self.yaw))
        angle = rest.jets(t, shift, shift)
        c, s = np.cos(angle[:, 0]), np.sin(angle[:, 0])
        outer = np.stack([[c, -s, -c, s], [s, c, -s, -c]])  # derivatives of cosine and sine
        around = jets.chained(np.moveaxis(outer, 2, 0), angle[:, None])
        # (J, points, 2, 2, 4): cosine and sine times x and y.
        parts = jets.product(around[:, None, :, None], shape[:, :, None, :2])
        found = shape.copy()
        found[:, :, 0] = parts[:, :, 0, 0] - parts[:, :, 1, 1]
        found[:, :, 1] = parts[:, :, 1, 0] + parts[:, :, 0, 1]
        return found

    def jets(self, t: Array, brake: float, shift: float) -> PathJets:
        """Return vertices and drones at times t (J,) [s]."""
        flat = self.flat(t, brake, shift)
        found = drone_jets(self.team, flat)
        return PathJets(flat.vertices, found.positions, found.legs, found.thrusts)

    def flight(self, breaks: Array, brake: float, shift: float) -> Flight:
        """Return the polynomials, which meet the state itself at their start."""
        count, h = len(breaks) - 1, SIDE * (breaks[1:] - breaks[:-1])
        found = self.jets(np.concatenate([breaks[:-1] + h, breaks[1:] - h]), brake, shift)
        legs = found.legs * self.team.layout.has_leg[..., None]
        starts = (self.state.drones, self.state.vertices, self.state.legs)
        each = [part.reshape(2 * count, -1, JET) for part in (found.drones, found.vertices, legs)]
        start = np.concatenate([part.reshape(-1, STATE) for part in starts])
        orders = np.moveaxis(np.concatenate(each, axis=1), -1, 0)
        left, right = orders[:, :count], orders[:, count:]
        left[:STATE, 1:] = right[:STATE, :-1]
        left[:STATE, 0] = start.T
        right[1:STATE, -1] = 0.0
        ends = np.concatenate([left, right]) * ((breaks[1:] - breaks[:-1]) ** ORDERS)[..., None]
        curves = bernstein.combined(ends.transpose(1, 2, 0), _septics())
        both = PiecewisePolynomial(breaks, curves)
        drones, vertices, leg_curves = both.split([part.shape[:-1] for part in starts])
        pulls = np.repeat(self.team.tension[None, :, None], count, axis=0)
        return Flight(drones, vertices, leg_curves, both.alike(pulls))


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
