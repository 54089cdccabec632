"""Friction feed-forward: legs lean against friction, so that vertices stay in place.

A cable that slides through a clasp has a higher tension on the side toward which it slides. Without
feed-forward the vertex is dragged along until the clasp is in balance. With it legs pull with the
tension changed by friction, and lean as the force triangle at the clasp requires
(``hitch.model.slipping_drones``).

The expected ratio of tensions follows from the rates at which legs grow, as both cables share the
friction of their contact (``hitch.twists``).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from hitchopt.geometry.vectors import dot, length
from hitchopt.hitch import GRAVITY
from hitchopt.hitch.forces import chord_pull
from hitchopt.hitch.model import slipping_drones
from hitchopt.hitch.requirements import Separation
from hitchopt.hitch.series import JET, chained, product
from hitchopt.hitch.team import Layout
from hitchopt.hitch.twists import bend, sliding_parts
from hitchopt.motion.motion import Motion
from hitchopt.planners.path import cables_of_legs
from hitchopt.planners.timing.stretch import needed_stretch
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.trajectory.piecewise import divided, on_breaks
from hitchopt.trajectory.splines import bspline
from hitchopt.values import Array

MIN_LEAN = math.radians(0.5)  # [rad] Smallest lean, below which there is no feed-forward
PIECES_PER_INTERVAL = 2  # Number of pieces of the drones' polynomials per interval of the splines


@dataclass(frozen=True, eq=False)
class FrictionFeedforward:
    """A motion whose legs lean against friction."""

    motion: Motion  # The motion with ``leg_tensions`` and stretched phases
    lean: float  # [rad] Largest angle by which a leg leans


def friction_feedforward(
    motion: Motion, share: float, *, slower: bool
) -> FrictionFeedforward | None:
    """Return the motion with friction feed-forward, or None.

    The paths of vertices, legs and edge tensions do not change. There is None if no leg would lean,
    if the motion would have to be slower but may not, or if it violates limits at rest.

    Parameters
    ----------
    motion: from rest to rest, hitched at all times.
    share: of the expected friction, in (0, 1].
    slower: whether the motion may be slowed down to its limits.
    """
    feedforward = _feedforward_of(motion, expected_slip(motion, share))
    if feedforward is None or feedforward.lean < MIN_LEAN:
        return None
    factor = needed_stretch(feedforward.motion)
    if factor > 1.0 and (not slower or not math.isfinite(factor)):
        return None
    return replace(feedforward, motion=feedforward.motion.slowed(max(factor, 1.0)))


def feedforward_matters(motion: Motion) -> bool:
    """Return whether legs would lean by at least MIN_LEAN, regardless of limits."""
    slip = expected_slip(motion, 1.0)
    feedforward = _feedforward_of(motion, slip)
    return slip is not None and (feedforward is None or feedforward.lean >= MIN_LEAN)


def _feedforward_of(motion: Motion, slip: PiecewisePolynomial | None) -> FrictionFeedforward | None:
    """Return the motion with leg tensions ``T e^slip``; None if a clasp has no balance."""
    if slip is None:
        return None
    layout = motion.team.layout
    longest = motion.duration / (PIECES_PER_INTERVAL * slip.pieces)
    # Rounding does not add a piece to a whole number of them
    parts = np.ceil(np.diff(motion.drones.breaks) / longest - 1e-9).astype(np.intp)
    breaks = divided(motion.drones.breaks, np.maximum(1, parts))
    vertices = on_breaks(motion.vertices, breaks)
    legs = on_breaks(motion.legs, breaks)
    tensions = on_breaks(motion.tensions, breaks)

    drone_jets = _jets_at_breaks(on_breaks(motion.drones, breaks))
    vertex_jets = _jets_at_breaks(vertices)
    leg_jets = _jets_at_breaks(legs)
    tension_jets = _jets_at_breaks(tensions)
    slip_jets = slip.jet(np.concatenate([breaks[:-1], breaks[1:]]), JET)
    ratios = chained(np.repeat(np.exp(slip_jets[..., :1]), JET, axis=-1), slip_jets)
    pulls = np.repeat(tension_jets[:, :, None], 2, axis=2)
    pulls[:, layout.behind, 1] = product(ratios[:, :, 0], tension_jets[:, layout.behind])
    pulls[:, layout.ahead, 0] = product(ratios[:, :, 1], tension_jets[:, layout.ahead])
    chords = drone_jets - vertex_jets[:, layout.anchors]
    cables = cables_of_legs(motion.team, chords, leg_jets, tension_jets)
    balanced = slipping_drones(
        motion.team, vertex_jets, leg_jets, tension_jets, pulls, drone_jets, cables
    )
    if not np.all(np.isfinite(balanced)):
        return None
    r_drones = 2 * layout.behind + 1
    q_drones = 2 * layout.ahead
    original = np.stack([drone_jets[:, r_drones], drone_jets[:, q_drones]], axis=2)[..., 0]
    clasps = vertex_jets[:, layout.clasps][..., 0][:, :, None]
    legs_before = original - clasps
    legs_after = balanced[..., 0] - clasps
    sines = length(np.cross(legs_before, legs_after))
    leans = np.arctan2(sines, dot(legs_before, legs_after))
    drone_jets[:, r_drones] = balanced[:, :, 0]
    drone_jets[:, q_drones] = balanced[:, :, 1]
    with_feedforward = motion.replaced(
        drones=_hermite(breaks, drone_jets),
        vertices=vertices,
        legs=legs,
        tensions=tensions,
        leg_tensions=_hermite(breaks, pulls),
    )
    return FrictionFeedforward(with_feedforward, float(np.max(leans)))


def _jets_at_breaks(curve: PiecewisePolynomial) -> Array:
    """Return jets at the starts of all pieces, then at their ends (2 pieces, …, JET).

    Jerks jump where a vertex starts to follow points, so that both sides of a break count.
    """
    return np.stack([np.concatenate(curve.ends(order)) for order in range(JET)], axis=-1)


def _hermite(breaks: Array, both: Array) -> PiecewisePolynomial:
    """Return the polynomials with jets (2 pieces, *shape, 4) at all left, then all right ends."""
    left, right = np.split(np.moveaxis(both, -1, 0), 2, axis=1)
    return PiecewisePolynomial.hermite(breaks, left, right)


DEGREE = 5  # Degree of the friction splines, with four continuous derivatives
KNOT_SPACING = 0.4  # [s] Spacing of their knots, with which friction reverses within a second

MIN_INTERVALS = 4
"""Minimum number of knot intervals, which limits the speed at which legs lean in short motions."""

MAX_INTERVALS = 200
"""Maximum number of knot intervals, which limits the number of pieces of long motions."""

ZERO_COEFFICIENTS = 3
"""Number of zero coefficients at both ends, where legs are at rest and without friction."""

SLOW_SHARE = 0.1
"""Share of the largest leg rate that is added to divisors; slow legs then expect less friction."""

MIN_LEG_RATE = 1e-5  # [m/s] Rate of a leg below which nothing slides

MAX_LEAN = math.radians(12.0)
"""[rad] Largest lean, since the two legs of a sharp, locked vertex would approach each other."""

DISTANCE_FACTOR = 1.02  # Factor on the distance limits of a clasp's drones and legs

MAX_FRICTION = 5.0
"""Upper bound of the friction coefficient: legs reach MAX_LEAN with much less, and exponentials of
larger ones overflow."""

MIN_DISTANCE = 1e-3  # [m] Distance of drones to the other leg of their clasp if they have no limit
BISECTIONS = 20  # Number of bisections for the largest feasible fraction of friction


def expected_slip(motion: Motion, share: float) -> PiecewisePolynomial | None:
    """Return ln(P/T) of legs over time, of shape (clasps, 2) for r_{k-1} and q_k at each clasp.

    It is zero and at rest at both ends; None if nothing slides.

    Parameters
    ----------
    motion: from rest to rest, hitched at all times.
    share: of the friction that legs can hold, in (0, 1].
    """
    layout = motion.team.layout
    start = float(motion.drones.breaks[0])
    duration = motion.duration
    count = min(max(MIN_INTERVALS, round(duration / KNOT_SPACING)), MAX_INTERVALS)
    inner = np.linspace(0.0, duration, count + 1)
    knots = np.concatenate([np.zeros(DEGREE), inner, np.full(DEGREE, duration)])
    t = start + np.mean(sliding_window_view(knots[1:-1], DEGREE), axis=-1)
    rates = _at_clasps(layout, motion.legs.at(t, 1))
    fastest = float(np.max(np.abs(rates)))
    if fastest <= MIN_LEG_RATE:
        return None
    clasps = _ForceTriangles.of(motion, t)
    friction = min(motion.team.friction, MAX_FRICTION)
    along, speed = sliding_parts(clasps.cosine, rates)
    slip = friction * clasps.bends * along / (speed + SLOW_SHARE * fastest)[..., None]
    slip *= share * clasps.feasible_share(slip)[..., None]
    slip[:ZERO_COEFFICIENTS] = 0.0
    slip[-ZERO_COEFFICIENTS:] = 0.0
    return bspline(start + knots, slip, DEGREE)


def _at_clasps(layout: Layout, legs: Array) -> Array:
    """Return values (J, clasps, 2) of r_{k-1} and q_k at every clasp from (J, n, 2) of legs."""
    return np.stack([legs[..., layout.behind, 1], legs[..., layout.ahead, 0]], axis=-1)


@dataclass(frozen=True, eq=False)
class _ForceTriangles:
    """The force triangles of all clasps at some times."""

    pull: Array  # (J, clasps) [N]: magnitude of V, the pull of the edges
    tensions: Array  # (J, clasps, 2) [N]: those of the cables behind and ahead
    legs: Array  # (J, clasps, 2) [m]: ``e_{k-1}`` and ``d_k``
    separation: Separation  # Limits of distances

    @classmethod
    def of(cls, motion: Motion, t: Array) -> _ForceTriangles:
        """Return the force triangles of a motion at times t (J,) [s]."""
        layout = motion.team.layout
        team = motion.team
        edges = layout.edges(motion.vertices.at(t))
        directions = edges / length(edges)[..., None]
        edge_tensions = motion.tensions.at(t)
        legs = motion.legs.at(t)
        half_weight = 0.5 * GRAVITY * team.cable_density
        level = edges[..., 0] ** 2 + edges[..., 1] ** 2
        pulls = chord_pull(edge_tensions, half_weight, level)[..., None] * directions
        total = pulls[:, layout.behind] - pulls[:, layout.ahead]
        if team.loaded:
            rest = team.cable_length - legs[..., ::-1].swapaxes(-1, -2)  # L - e, L - d
            carried = rest[:, 0, layout.ahead] + rest[:, 1, layout.behind]
            total[..., 2] += half_weight * carried
            total[..., 2] += GRAVITY * team.load
        behind = edge_tensions[:, layout.behind]
        ahead = edge_tensions[:, layout.ahead]
        return cls(
            pull=length(total),
            tensions=np.stack([behind, ahead], axis=-1),
            legs=_at_clasps(layout, legs),
            separation=motion.requirements.separation,
        )

    @cached_property
    def leg_angles(self) -> Array:
        """(J, clasps, 2) [rad]: angles between the legs and V without friction."""
        return self.angles(np.zeros_like(self.tensions))

    @property
    def bends(self) -> Array:
        """(J, clasps, 2) [rad]: bends of both cables, whose turns V bisects without clasp loads.

        They are 0 for straight cables, whose legs cannot lean.
        """
        return np.asarray(np.nan_to_num(bend(np.cos(2.0 * self.leg_angles))))

    @property
    def cosine(self) -> Array:
        """(J, clasps): cosines of the angles at which cables cross, means of their turns'."""
        return np.asarray(np.nan_to_num(np.mean(np.cos(2.0 * self.leg_angles), axis=-1), nan=1.0))

    def feasible_share(self, slip: Array) -> Array:
        """Return the largest feasible shares (J, clasps) of slips (J, clasps, 2).

        Leans are at most MAX_LEAN, and drones keep their distances to each other and to both legs.
        """
        before = self._distances(self.leg_angles)
        lower = np.zeros(slip.shape[:-1])
        upper = np.ones(slip.shape[:-1])
        trial = upper
        for _ in range(BISECTIONS):
            angles = self.angles(trial[..., None] * slip)
            is_small = np.abs(angles - self.leg_angles) <= MAX_LEAN
            distances = self._distances(angles)
            is_clear = (distances >= DISTANCE_FACTOR) | (distances >= before)
            feasible = np.all(is_small, axis=-1) & np.all(is_clear, axis=-1)
            lower = np.where(feasible, trial, lower)
            upper = np.where(feasible, upper, trial)
            trial = 0.5 * (lower + upper)
        return lower

    def angles(self, slip: Array) -> Array:
        """Return angles (J, clasps, 2) [rad] between the legs and V; nan without a triangle."""
        tensions = self.tensions * np.exp(slip)  # by the capstan equation
        other_tensions = tensions[..., ::-1]
        clasp_pull = self.pull[..., None]
        # The law of cosines
        squares = clasp_pull**2 + tensions**2 - other_tensions**2
        products = 2.0 * clasp_pull * tensions
        infinite = np.full_like(squares, np.inf)
        cosines = np.divide(squares, products, out=infinite, where=products > 0.0)
        return np.arccos(np.where(np.abs(cosines) < 1.0, cosines, np.nan))

    def _distances(self, angles: Array) -> Array:
        """Return distances over their limits (J, clasps, 3), of the drones and to both legs."""
        between = np.sum(angles, axis=-1, keepdims=True)
        e = self.legs[..., :1]
        d = self.legs[..., 1:]
        squares = e**2 + d**2 - 2.0 * e * d * np.cos(between)
        drones = np.sqrt(np.maximum(squares, 0.0))
        to_legs = np.where(between < 0.5 * np.pi, self.legs * np.sin(between), self.legs)
        limits = self.separation
        cable = max(limits.cable, MIN_DISTANCE)
        return np.concatenate([drones / (2.0 * limits.radius), to_legs / cable], axis=-1)
