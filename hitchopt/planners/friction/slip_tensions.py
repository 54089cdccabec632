"""The friction that is counted on while cables slide, as far as legs can lean against it.

How hard friction pulls is known only roughly: by ``e^{μ θ}`` if one cable slides about the other
(θ the angle that it wraps), by less where both do, since then they slide past each other less.
Counted on is ``ln(P/T) = μ θ v / (|v_q| + |v_r|)`` for the speeds ``v`` at which legs grow: all of
it for one cable, half for two at the same speed. That law is no theory but what brings simulated
ropes closest to their plans (``python -m benchmarks.flights``). The law by relative velocity of
``calibration/clasp_sliding.py`` was fitted later; at turns of 60° it makes this half 0.7.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.interpolate import BSpline

from hitchopt.geometry.vectors import length
from hitchopt.hitch import GRAVITY
from hitchopt.hitch.layout import Layout
from hitchopt.motion.motion import Motion
from hitchopt.requirements import Separation
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array

DEGREE = 5
"""Degree of the splines by which friction grows and fades: smooth up to the snap."""

SPACING = 0.4
"""[s] Spacing of their knots; friction then reverses within a second."""

FEWEST, MOST = 4, 200
"""Bounds of the number of knot intervals: with more, the legs of a short motion would have to lean
faster than drones fly, and a long one would have ten thousands of pieces."""

AT_REST = 3
"""Number of coefficients at both ends that are zero: legs begin and end
at rest, where they hold alone."""

SLOW = 0.1
"""Share of the largest speed of a leg: legs much slower than that plan for little friction."""

STILL = 1e-5
"""[m/s] Rate of a leg below which nothing slides."""

FARTHEST = math.radians(12.0)
"""A leg leans no farther: toward what friction would ask for where it locks a sharp vertex, the
two legs close in on each other."""

ROOM = 1.02
"""Factor on the limits of the distances of a clasp's drones from each other and their legs."""

ROUGHEST = 5.0
"""Coefficient of friction beyond which no more is counted on: legs lean as far as they may by far
less, and the exponential of more is no number."""

TOUCHING = 1e-3
"""[m] Distance of drones from the other leg of their clasp where they have no limit."""

HALVINGS = 20
"""Number of halvings of the interval in which the largest bearable share of friction lies."""


def counted_on(motion: Motion, share: float) -> PiecewisePolynomial | None:
    """Return ln(P/T) of the legs over time, of shape (clasps, 2): r_{k-1}'s and q_k's at each.

    Zero, and at rest, at both ends; None where nothing slides.

    Parameters
    ----------
    motion: from rest to rest, formed all of the time.
    share: of the friction that legs can bear, in (0, 1].
    """
    layout = motion.team.layout
    if np.max(np.abs(motion.legs.differentiated().coefficients)) <= STILL:
        return None
    start, duration = float(motion.drones.breaks[0]), motion.duration
    count = min(max(FEWEST, round(duration / SPACING)), MOST)
    inner = np.linspace(0.0, duration, count + 1)
    knots = np.concatenate([np.zeros(DEGREE), inner, np.full(DEGREE, duration)])
    t = start + np.mean(sliding_window_view(knots[1:-1], DEGREE), axis=-1)
    rates = _at_clasps(layout, motion.legs.at(t, 1))
    fastest = float(np.max(np.abs(rates)))
    if fastest <= STILL:
        return None
    both = np.sum(np.abs(rates), axis=-1, keepdims=True) + SLOW * fastest
    clasps = _Clasps.of(motion, t)
    friction = min(motion.team.cable_friction, ROUGHEST)
    wanted = friction * clasps.wrapped * rates / both
    wanted *= share * clasps.bearable(wanted)[..., None]
    wanted[:AT_REST] = wanted[-AT_REST:] = 0.0
    return PiecewisePolynomial.from_spline(BSpline(start + knots, wanted, DEGREE))


def _at_clasps(layout: Layout, legs: Array) -> Array:
    """Return (J, clasps, 2) of (J, n, 2): of r_{k-1} and of q_k, the two at every clasp."""
    return np.stack([legs[..., layout.behind, 1], legs[..., layout.ahead, 0]], axis=-1)


@dataclass(frozen=True, eq=False)
class _Clasps:
    """The force triangles of all clasps at some times.

    Attributes
    ----------
    pull: (J, clasps), size of V, what the edges pull with [N].
    tensions: (J, clasps, 2) [N], of the cables behind and ahead.
    legs: (J, clasps, 2) [m], ``e_{k-1}`` and ``d_k``.
    separation: distances of their drones.
    """

    pull: Array
    tensions: Array
    legs: Array
    separation: Separation

    @classmethod
    def of(cls, motion: Motion, t: Array) -> _Clasps:
        layout = motion.team.layout
        edges = layout.edges(motion.vertices.at(t))
        u = edges / length(edges)[..., None]
        behind, ahead = u[:, layout.behind], u[:, layout.ahead]
        T = motion.tensions.at(t)
        tensions = np.stack([T[:, layout.behind], T[:, layout.ahead]], axis=-1)
        V = tensions[..., :1] * behind - tensions[..., 1:] * ahead
        both = motion.legs.at(t)
        legs, team = _at_clasps(layout, both), motion.team
        if team.loaded:
            half = 0.5 * GRAVITY * team.cable_density
            rest = team.cable_length - both[..., ::-1].swapaxes(-1, -2)  # L - e, L - d
            V[..., 2] += half * (rest[:, 0, layout.ahead] + rest[:, 1, layout.behind])
            V[..., 2] += GRAVITY * team.load
        return cls(length(V), tensions, legs, motion.requirements.separation)

    @cached_property
    def upright(self) -> Array:
        """(J, clasps, 2) [rad]: angles between the legs and V, without friction."""
        return self._angles(np.zeros_like(self.tensions))

    @property
    def wrapped(self) -> Array:
        """(J, clasps, 2) [rad], the angles that both cables wrap: V halves them.

        Nearly so where clasps carry weight. 0 where the cables run on straight: no leg can lean.
        """
        return np.nan_to_num(2.0 * self.upright)

    def bearable(self, slip: Array) -> Array:
        """Return (J, clasps): the largest share of ``slip`` (J, clasps, 2) that legs may lean to.

        None leans FARTHEST, and no drone comes too close to the other one or to its leg.
        """
        before = self._gaps(self.upright)
        lower, upper = np.zeros(slip.shape[:-1]), np.ones(slip.shape[:-1])
        trial = upper
        for _ in range(HALVINGS):
            angles = self._angles(trial[..., None] * slip)
            leans = np.abs(angles - self.upright) <= FARTHEST
            gaps = self._gaps(angles)
            apart = (gaps >= ROOM) | (gaps >= before)
            borne = np.all(leans, axis=-1) & np.all(apart, axis=-1)
            lower, upper = np.where(borne, trial, lower), np.where(borne, upper, trial)
            trial = 0.5 * (lower + upper)
        return lower

    def _angles(self, slip: Array) -> Array:
        """Return (J, clasps, 2) [rad] between the legs and V; nan where there is no triangle."""
        pulls = self.tensions * np.exp(slip)
        others, pull = pulls[..., ::-1], self.pull[..., None]
        squares, products = pull**2 + pulls**2 - others**2, 2.0 * pull * pulls
        none = np.full_like(squares, np.inf)
        sides = np.divide(squares, products, out=none, where=products > 0.0)
        return np.arccos(np.where(np.abs(sides) < 1.0, sides, np.nan))

    def _gaps(self, angles: Array) -> Array:
        """Return (J, clasps, 3): distances over their limits, of the drones and to both legs."""
        between = np.sum(angles, axis=-1, keepdims=True)
        e, d = self.legs[..., :1], self.legs[..., 1:]
        drones = np.sqrt(np.maximum(e**2 + d**2 - 2.0 * e * d * np.cos(between), 0.0))
        aside = np.where(between < 0.5 * np.pi, self.legs * np.sin(between), self.legs)
        limits = self.separation
        cable = max(limits.cable, TOUCHING)
        return np.concatenate([drones / (2.0 * limits.radius), aside / cable], axis=-1)
