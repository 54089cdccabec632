"""Motion of a hitch from a moving state to rest in another hitch: flat outputs in closed form.

The polygon's mean point, its shape as seen from a frame that turns with it, and the split of the
cables' slack are curves of ``smooth_change``. The frame itself turns from rest to rest, so that a
hitch that is to be turned keeps its shape.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from hitchopt.compiled.kernel_switch import kernels_on
from hitchopt.geometry.vectors import length
from hitchopt.hitch import GRAVITY, Hitch, Team
from hitchopt.model.evaluation import FlatJets, drone_jets
from hitchopt.motion.motion import Motion
from hitchopt.planners.path import jets
from hitchopt.planners.timing.flight_curves import Flight
from hitchopt.steering.smooth_change import JET, SmoothChange
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array, Indices

SAME_STATE = 1e-6
"""[m] Largest distance of drones from where the team's tensions put them, to begin from there."""

SIDE = 1e-9
"""Share of a piece by which one-sided derivatives are taken inside of it."""


@dataclass(frozen=True, eq=False)
class MovingState:
    """A hitch in motion.

    Attributes
    ----------
    vertices: (points, 3, 4), positions and their derivatives by time.
    fractions: (n, 4), ``d_k / (d_k + e_k)``.
    drones: (2n, 3, 4)
    legs: (n, 2, 4)
    """

    vertices: Array
    fractions: Array
    drones: Array
    legs: Array

    @classmethod
    def of(cls, motion: Motion, time: float) -> MovingState:
        """Return the state of a motion at a time [s]."""
        t = np.array([time])
        legs = motion.legs.jet(t, JET)[0]
        slack = np.sum(legs, axis=1)
        has_both = np.all(motion.team.layout.has_leg, axis=1)
        slack[~has_both, 0] = np.where(slack[~has_both, 0] > 0.0, slack[~has_both, 0], 1.0)
        fractions = jets.product(legs[:, 0], jets.reciprocal(slack))
        return cls(motion.vertices.jet(t, JET)[0], fractions, motion.drones.jet(t, JET)[0], legs)

    @property
    def moves(self) -> bool:
        """Whether anything moves or accelerates."""
        return bool(np.any(np.abs(self.drones[..., 1:3]) > 1e-9))


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
        left = _turn(state.vertices[:, :2, 0], end.vertices[:, :2])
        left += 2.0 * np.pi * np.round((yaw - left) / (2.0 * np.pi))
        return cls(team, state, end.vertices, end.fractions, left)

    @cached_property
    def _change(self) -> SmoothChange:
        """Curves of the mean point, of the shape about it, and of the fractions, in a row."""
        points = self.state.vertices[..., :3]
        centre = points.mean(axis=0)
        goal = self.end.mean(axis=0)
        c, s = np.cos(self.yaw), np.sin(self.yaw)
        back = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        shape = (points - centre).reshape(-1, 3)
        start = np.concatenate([centre, shape, self.state.fractions[..., :3]])
        ends = np.concatenate([goal, ((self.end - goal) @ back).ravel(), self.fractions])
        return SmoothChange(start, ends)

    def farthest(self, brake: float) -> float:
        """Return about how far a shift takes the vertices, and its turn the drones [m]."""
        vertices = self.state.vertices[..., :3]
        rest = SmoothChange(vertices, self.end).braked(brake)
        moved = float(np.max(length(self.end - rest)))
        radius = float(np.max(length(self.state.drones[..., 0] - vertices[..., 0].mean(axis=0))))
        return max(moved, 0.5 * abs(self.yaw) * radius)

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
        if self.compiled:
            from hitchopt.compiled.path_kernel import path_jets

            timing = np.array([brake, shift, self.yaw])
            start, goal, stencil, has_leg, rows = self.arrays
            return PathJets(*path_jets(start, goal, t, timing, stencil, has_leg, rows))
        flat = self.flat(t, brake, shift)
        found = drone_jets(self.team, flat)
        return PathJets(flat.vertices, found.positions, found.legs, found.thrusts)

    @property
    def compiled(self) -> bool:
        """Whether compiled code takes this path."""
        team = self.team
        return kernels_on() and not team.loaded and bool(np.all(team.tension == team.tension[0]))

    @property
    def arrays(self) -> tuple[Array, Array, Indices, NDArray[np.bool_], Array]:
        """Start and goal of the curves, the layout's stencil and legs, and the team's rows.

        As compiled code takes them.
        """
        change, layout = self._change, self.team.layout
        return change.start, change.goal, layout.stencil, layout.has_leg, _rows(self.team)

    def flight(self, breaks: Array, brake: float, shift: float) -> Flight:
        """Return the polynomials, which meet the state itself at their start."""
        h = np.diff(breaks)
        count = len(h)
        sides = np.concatenate([breaks[:-1] + SIDE * h, breaks[1:] - SIDE * h])
        found = self.jets(sides, brake, shift)
        legs = found.legs * self.team.layout.has_leg[..., None]
        each = (found.drones, found.vertices, legs)
        starts = (self.state.drones, self.state.vertices, self.state.legs)
        values = np.concatenate([part.reshape(2 * count, -1, JET) for part in each], axis=1)
        start = np.concatenate([part.reshape(-1, JET) for part in starts])
        orders = np.moveaxis(values, -1, 0).copy()
        left, right = orders[:, :count], orders[:, count:]
        left[:3, 1:] = right[:3, :-1]
        left[:3, 0] = start.T[:3]
        right[1:3, -1] = 0.0
        both = PiecewisePolynomial.hermite(breaks, left, right)
        drones, vertices, leg_curves = both.split([part.shape[:-1] for part in starts])
        tensions = PiecewisePolynomial.constant(breaks, self.team.tension)
        return Flight(drones, vertices, leg_curves, tensions)


@lru_cache(maxsize=16)
def _rows(team: Team) -> Array:
    """Return the row of every robot that compiled code takes, (n, 5)."""
    columns = [team.cable_length, team.tension, team.mass.reshape(-1, 2)]
    return np.column_stack([*columns, np.full(team.robots, GRAVITY)])


def _turn(first: Array, last: Array) -> float:
    """Return the angle [rad] by which points (k, 2) about their mean fit the last ones best."""
    x, y = (points - points.mean(axis=0) for points in (first, last))
    turned = np.sum(x[:, 0] * y[:, 1] - x[:, 1] * y[:, 0])
    return float(np.arctan2(turned, np.sum(x * y)))
