"""Friction feed-forward: legs lean against friction, so that vertices stay in place.

A cable that slides through a clasp pulls harder on the side that it is drawn to. With legs where
they hold without friction the vertex is dragged along until the clasp balances again. Planned for,
the legs restore the balance: they pull with the tension changed by friction, and lean
as the force triangle at the clasp requires (``model.evaluation.slipping_drones``).

How hard friction pulls is known only roughly: by ``e^{μ θ}`` if one cable slides about the other
(θ the angle that it wraps), by less where both do, since then they slide past each other less.
Counted on is ``ln(P/T) = μ θ v / (|v_q| + |v_r|)`` for the speeds ``v`` at which legs grow: all of
it for one cable, half for two at the same speed. The law is empirical: it brings simulated
ropes closest to their plans (``python -m benchmarks flights``). The law by relative velocity of
``calibration/clasp_sliding.py`` was fitted later; at turns of 60° it makes this half 0.7.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.interpolate import BSpline

from hitchopt.geometry.vectors import dot, length
from hitchopt.hitch import GRAVITY, Team
from hitchopt.hitch.forces import chord_pull
from hitchopt.hitch.model import slipping_drones
from hitchopt.hitch.requirements import Separation
from hitchopt.hitch.series import JET
from hitchopt.hitch.team import Layout
from hitchopt.motion.motion import Motion
from hitchopt.planners.morph import jets
from hitchopt.planners.morph.path import cable_along
from hitchopt.planners.timing.flight import needed_stretch
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.trajectory.piecewise import on_breaks
from hitchopt.values import Array

SMALLEST = math.radians(0.5)
"""Smallest lean: legs that would lean less stay as they are."""

FINER = 2
"""Number of pieces of the drones' polynomials for one of the splines."""


@dataclass(frozen=True, eq=False)
class FrictionFeedforward:
    """A motion whose legs lean against friction.

    Attributes
    ----------
    motion: with ``leg_tensions``, its phases slowed with it.
    turned: the largest angle by which a leg leans [rad].
    """

    motion: Motion
    turned: float


def friction_feedforward(
    motion: Motion, share: float, *, slower: bool
) -> FrictionFeedforward | None:
    """Return the motion with friction feed-forward; None if no leg would lean.

    Vertices, legs' lengths and edges' tensions stay as they are, but for the pace.

    Parameters
    ----------
    motion: from rest to rest, formed all of the time; its limits are kept by going slower.
    share: of the friction that is counted on, in (0, 1].
    slower: whether it may last longer; else None is returned where it would have to. So it is where
        legs at rest pull their drones beyond a limit.
    """
    feedforward = _feedforward_of(motion, counted_on(motion, share))
    if feedforward is None or feedforward.turned < SMALLEST:
        return None
    leaned = feedforward.motion
    factor = needed_stretch(leaned)
    if factor > 1.0 and (not slower or not math.isfinite(factor)):
        return None
    return replace(feedforward, motion=leaned.slowed(max(factor, 1.0)))


def feedforward_matters(motion: Motion) -> bool:
    """Return whether legs lean by SMALLEST or more, limits aside."""
    slip = counted_on(motion, 1.0)
    feedforward = _feedforward_of(motion, slip)
    return slip is not None and (feedforward is None or feedforward.turned >= SMALLEST)


SWINGS, SWING = 8, 2.0
"""Number of swings that settle the clasps, and duration of a swing [s]. In simulations
(friction 0.1, thin segments, noise and wind) three leave 3 cm of 5, eight 1 to 2 cm."""

USED = 0.98
"""Share of the friction that is used, which leaves room for interpolation."""


def settling_swings(rest: Motion, share: float) -> tuple[FrictionFeedforward, float] | None:
    """Return a hitch at rest whose drones swing to remove friction hysteresis at the clasps.

    Legs lean as friction fully used would have them hold the vertices, ``P = T e^{± μ θ}``, to one
    side and the other by turns, farthest at first and by less and less, as iron is demagnetised.
    Vertices, legs' lengths and edges' tensions stay. With it comes the share of the friction that
    is used where legs can bear the least. None where no leg can lean by SMALLEST.

    Parameters
    ----------
    rest: the hitch, for as long as it is to swing.
    share: of the friction that legs can bear, in (0, 1].
    """
    start, count = float(rest.drones.breaks[0]), 2 * SWINGS + 1
    times = start + rest.duration * np.linspace(0.0, 1.0, count + 1)
    clasps = _Clasps.of(rest, times[:1])
    friction = USED * min(rest.team.cable_friction, ROUGHEST)
    most = friction * clasps.wrapped
    for _ in range(ANGLE_ROUNDS):  # legs that close in on each other wrap less
        most = friction * (clasps.upright + np.nan_to_num(clasps.angles(-most)))
    borne = share * np.minimum(clasps.bearable(most), clasps.bearable(-most))
    most *= borne[..., None]
    decay = np.linspace(1.0, 0.0, count, endpoint=False) * (-1.0) ** np.arange(count)
    decay = np.concatenate([[0.0], decay[:-1], [0.0]])
    curve = jets.quintic_spline(times, decay[:, None, None] * most, (1, 2))
    swings = _feedforward_of(rest, PiecewisePolynomial.from_spline(curve))
    if swings is None or swings.turned < SMALLEST:
        return None
    return swings, float(np.min(borne))


def _feedforward_of(motion: Motion, slip: PiecewisePolynomial | None) -> FrictionFeedforward | None:
    """Return the motion with pulls ``T e^slip``; None without, or if a clasp is out of balance."""
    if slip is None:
        return None
    layout = motion.team.layout
    coarse, longest = motion.drones.breaks, motion.duration / (FINER * slip.pieces)
    parts = np.maximum(1, np.ceil(np.diff(coarse) / longest - 1e-9).astype(np.intp))
    breaks = jets.divided(coarse, parts)
    drones, vertices, legs, tensions = (
        on_breaks(part, breaks)
        for part in (motion.drones, motion.vertices, motion.legs, motion.tensions)
    )
    # From both sides of every break: jerks jump where timed points begin to be followed.
    d, p, lengths, T = (
        np.stack([np.concatenate(part.ends(order)) for order in range(JET)], axis=-1)
        for part in (drones, vertices, legs, tensions)
    )
    logs = slip.jet(np.concatenate([breaks[:-1], breaks[1:]]), JET)
    grown = jets.chained(np.repeat(np.exp(logs[..., :1]), JET, axis=-1), logs)
    pulls = np.repeat(T[:, :, None], 2, axis=2)
    pulls[:, layout.behind, 1] = jets.product(grown[:, :, 0], T[:, layout.behind])
    pulls[:, layout.ahead, 0] = jets.product(grown[:, :, 1], T[:, layout.ahead])
    cables = cables_of_legs(motion.team, d - p[:, layout.anchors], lengths, T)
    drones_in_balance = slipping_drones(motion.team, p, lengths, T, pulls, d, cables)
    if not np.all(np.isfinite(drones_in_balance)):
        return None
    places = np.stack([d[:, 2 * layout.behind + 1], d[:, 2 * layout.ahead]], axis=2)[..., 0]
    clasps = p[:, layout.clasps][..., 0][:, :, None]
    before, after = places - clasps, drones_in_balance[..., 0] - clasps
    turned = np.arctan2(length(np.cross(before, after)), dot(before, after))
    d[:, 2 * layout.behind + 1], d[:, 2 * layout.ahead] = (
        drones_in_balance[:, :, 0],
        drones_in_balance[:, :, 1],
    )
    leaned = replace(
        motion,
        drones=_hermite(breaks, d),
        vertices=vertices,
        legs=legs,
        tensions=tensions,
        leg_tensions=_hermite(breaks, pulls),
    )
    return FrictionFeedforward(leaned, float(np.max(turned)))


def cables_of_legs(team: Team, chords: Array, lengths: Array, tensions: Array) -> Array | None:
    """Return jets (J, n, 2, 4) of the lengths of cable in legs [m]; None where they do not sag.

    By ``hitch.forces.cable_of``, for chords (J, 2n, 3, 4) [m] that are ``lengths`` long.
    """
    if team.cable_density == 0.0:
        return None
    return cable_along(team, chords, np.repeat(tensions, 2, axis=1)).reshape(lengths.shape)


def _hermite(breaks: Array, both: Array) -> PiecewisePolynomial:
    """Return the polynomials with given jets (2 pieces, *shape, 4): first all left ends."""
    left, right = np.split(np.moveaxis(both, -1, 0), 2, axis=1)
    return PiecewisePolynomial.hermite(breaks, left, right)


DEGREE = 5
"""Degree of the splines by which friction grows and fades: smooth up to the snap."""

SPACING = 0.4
"""[s] Spacing of their knots; friction then reverses within a second."""

MIN_INTERVALS, MAX_INTERVALS = 4, 200
"""Bounds of the number of knot intervals: with more, the legs of a short motion would have to lean
faster than drones fly, and a long one would have ten thousands of pieces."""

AT_REST = 3
"""Number of coefficients at both ends that are zero: legs begin and end
at rest, where they hold alone."""

SLOW = 0.1
"""Share of the largest speed of a leg: legs much slower than that plan for little friction."""

MIN_LEG_RATE = 1e-5
"""[m/s] Rate of a leg below which nothing slides."""

FARTHEST = math.radians(12.0)
"""A leg leans no farther: toward what friction would ask for where it locks a sharp vertex, the
two legs close in on each other."""

ROOM = 1.02
"""Factor on the limits of the distances of a clasp's drones from each other and their legs."""

ROUGHEST = 5.0
"""Coefficient of friction above which the excess is ignored: legs reach FARTHEST by far
less, and the exponential of more overflows."""

TOUCHING = 1e-3
"""[m] Distance of drones from the other leg of their clasp where they have no limit."""

ANGLE_ROUNDS = 8
"""Rounds in which the angle is found that legs wrap with the friction that it gives them."""

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
    start, duration = float(motion.drones.breaks[0]), motion.duration
    count = min(max(MIN_INTERVALS, round(duration / SPACING)), MAX_INTERVALS)
    inner = np.linspace(0.0, duration, count + 1)
    knots = np.concatenate([np.zeros(DEGREE), inner, np.full(DEGREE, duration)])
    t = start + np.mean(sliding_window_view(knots[1:-1], DEGREE), axis=-1)
    rates = _at_clasps(layout, motion.legs.at(t, 1))
    fastest = float(np.max(np.abs(rates)))
    if fastest <= MIN_LEG_RATE:
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
        both = motion.legs.at(t)
        legs, team = _at_clasps(layout, both), motion.team
        half = 0.5 * GRAVITY * team.cable_density
        level = edges[..., 0] ** 2 + edges[..., 1] ** 2
        pull = chord_pull(T, half, level)[..., None]
        V = pull[:, layout.behind] * behind - pull[:, layout.ahead] * ahead
        if team.loaded:
            rest = team.cable_length - both[..., ::-1].swapaxes(-1, -2)  # L - e, L - d
            V[..., 2] += half * (rest[:, 0, layout.ahead] + rest[:, 1, layout.behind])
            V[..., 2] += GRAVITY * team.load
        return cls(length(V), tensions, legs, motion.requirements.separation)

    @cached_property
    def upright(self) -> Array:
        """(J, clasps, 2) [rad]: angles between the legs and V, without friction."""
        return self.angles(np.zeros_like(self.tensions))

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
            angles = self.angles(trial[..., None] * slip)
            leans = np.abs(angles - self.upright) <= FARTHEST
            gaps = self._gaps(angles)
            apart = (gaps >= ROOM) | (gaps >= before)
            borne = np.all(leans, axis=-1) & np.all(apart, axis=-1)
            lower, upper = np.where(borne, trial, lower), np.where(borne, upper, trial)
            trial = 0.5 * (lower + upper)
        return lower

    def angles(self, slip: Array) -> Array:
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
