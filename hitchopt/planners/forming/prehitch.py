"""The pre-hitch: drone positions from which the swaps start, without taut cables or collisions.

Every pair has its directions of the hitch, with legs shortened by a common share, but at least a
smallest radius. The search first decreases the share. It then shrinks the polygon, so that cables
reach, and enlarges it, so that pairs on short edges keep their distances, also on the path to the
hitch. If none of these suffices and the chords of pairs are too oblique for cables to clasp, the
chords are laid across the vertices.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np

from hitchopt.checks.bodies import clasped_outlines
from hitchopt.geometry import hull_distance
from hitchopt.geometry.vectors import cross, left_of, unit
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.catenary import Catenary
from hitchopt.hitch.hitch import ALTITUDE_TOLERANCE
from hitchopt.hitch.requirements import Limits, Requirements, Separation
from hitchopt.motion.motion import CableState, Motion
from hitchopt.planners.forming import SwapSettings
from hitchopt.planners.forming.stages import (
    best,
    ground_clearance,
    hover_altitude,
    line_progress,
    on_lines,
    rise_seconds,
    stage,
    tension_stage,
)
from hitchopt.planners.timing.profile import usable_accelerations
from hitchopt.planners.timing.ramps import fastest_clock, timed_curve
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array

LEG_SHARES = (0.6, 0.5, 0.4, 0.3, 0.2, 0.1)
"""Fractions of the hitch's legs, in the order of the search."""

SCALES = (1.0, 0.9, 0.8, 0.7, 0.6, 1.15, 1.3, 1.5, 1.8)
"""Scales of the hitch's polygon, in the order of the search."""

DEFAULT_TILT = math.radians(45.0)
"""[rad] Default tilt of the axis of turning. It keeps drones out of hanging cables for any number
of robots; horizontal axes do so for up to about seven."""

MIN_SEPARATION = 1.05
"""Minimum separation [1] of drones in planned stages, such as a pair that turns."""

MAX_SPAN_RATIO = 0.97  # Largest distance of the drones of a hanging cable, over its length
CLEARANCE = 1.05  # Clearance of drones to cables, over ``Separation.cable``

MIN_LINK = 0.05
"""[m] Smallest length of two cables beyond the crossing of their chords at a clasp, in plan view
after the first swap: cables that do not cross there do not clasp."""

ANGLES = 73  # Number of sampled angles; the certificate bounds all of them

SAMPLES = np.linspace(0.0, 1.0, 41)
"""Sampled fractions of a hanging cable's length and of straight flights."""

TIGHTENING_SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Fractions of the move from the pre-hitch to the hitch at which cable heights are sampled."""

MAX_PIECE_ANGLE = 0.3
"""[rad] Largest angle on one polynomial of degree 7, which is within 1e-9 of the ellipse."""

TURNING_SHARES = (0.25, 0.35, 0.45, 0.55, 0.65, 0.75, 0.85)
"""Fractions of the acceleration that are centripetal at full speed; the rest is tangential."""

JERK_SHARE = 0.7  # Fraction of the jerk for the angle's own rate
TURN_ANGLES = 25  # Number of angles of half a turn at which usable accelerations are computed

CLASP_SHARES = (0.0, 0.2, 0.4, 0.6, 0.8, 1.0)
"""Fractions of the line from pre-hitch to hitch that are candidates for the clasps."""


@dataclass(frozen=True, eq=False)
class SwapEllipses:
    """Ellipses at the clasps on which pairs of drones turn about each other, with a common angle.

    At clasp k the drones ``q_k`` and ``r_{k-1}`` turn about the middle c of their chord, on

        q_k = c + a cos θ t + h sin θ w,      r_{k-1} = c - a cos θ t - h sin θ w,

    t along the chord, w normal to it. The axis of turning is the outward normal of the chord,
    tilted upward, so that the upper drone passes inside and the lower one outside. Otherwise, at a
    vertex with nearly collinear edges, it would fly into the loop of its neighbour's hanging cable.
    """

    team: Team  # of the drones
    centres: Array  # (c, 3) [m]
    along: Array  # (c, 3), t: horizontal unit vectors from ``r_{k-1}`` to ``q_k``
    upward: Array  # (c, 3), w: unit vectors normal to t, upward and tilted inward
    half: Array  # (c,) [m], a: half of the chord
    rise: Array  # (c,) [m], h: the other semi-axis, negative if q_k goes down first
    ends: Array  # (k, 3) [m]: drones at the ends of a chain, which do not turn

    def drones(self, angle: Array | float, derivative: int = 0) -> Array:
        """Return the drones (…, 2n, 3) [m] at angles θ (…), or a derivative by the angle."""
        theta = np.asarray(angle, dtype=np.float64)[..., None, None] + 0.5 * np.pi * derivative
        offset = (self.half[:, None] * self.along) * np.cos(theta)
        offset = offset + (self.rise[:, None] * self.upward) * np.sin(theta)
        centre = self.centres if derivative == 0 else np.zeros_like(self.centres)
        layout = self.team.layout
        drones = np.zeros((*offset.shape[:-2], 2 * layout.robots, 3))
        drones[..., 2 * layout.ahead, :] = centre + offset
        drones[..., 2 * layout.behind + 1, :] = centre - offset
        if derivative == 0:
            drones[..., ~layout.has_leg.ravel(), :] = self.ends
        return drones

    def raised(self, by: float) -> SwapEllipses:
        """Return the ellipses raised by a height [m]."""
        up = np.array([0.0, 0.0, by])
        return replace(self, centres=self.centres + up, ends=self.ends + up)

    def half_turn(self, limits: Limits, first: int, seconds: float | None) -> PiecewisePolynomial:
        """Return the drones (2n, 3) [m] on half a turn of all pairs, from rest to rest.

        The turn is as fast as the limits of every drone's speed, acceleration and jerk allow.

        Parameters
        ----------
        limits: of every drone.
        first: 0 for the turn from θ = 0, 1 for the one from θ = π.
        seconds: shortest duration [s], or None.
        """
        start = first * math.pi
        angles = np.linspace(start, start + math.pi, TURN_ANGLES)
        usable = float(np.min(usable_accelerations(self.team, limits, self.drones(angles))))
        size = float(max(np.max(self.half), np.max(np.abs(self.rise))))

        def turn(share: float) -> PiecewisePolynomial:
            """Return the turn with a centripetal share of the acceleration, within all limits."""
            speed = min(limits.speed / size, math.sqrt(share * usable / size))
            tangential = math.sqrt(max(usable * usable - (speed * speed * size) ** 2, 1e-12)) / size
            clock = fastest_clock(math.pi, speed, tangential, JERK_SHARE * limits.jerk / size)
            return timed_curve(
                lambda at, k: self.drones(start + at, k), clock, MAX_PIECE_ANGLE, limits, usable
            )

        fastest = min(map(turn, TURNING_SHARES), key=lambda drones: drones.duration)
        return fastest.stretched(max(1.0, (seconds or 0.0) / fastest.duration))

    @property
    def link_length(self) -> float:
        """Smallest length [m] of two cables beyond the crossing of their chords at a clasp.

        In plan view after half a turn; negative if they do not cross.
        """
        layout = self.team.layout
        drones = self.drones(math.pi)[:, :2]
        r, q = drones[2 * layout.behind + 1], drones[2 * layout.ahead]
        back, onward = unit(drones[2 * layout.behind] - r), unit(drones[2 * layout.ahead + 1] - q)
        turn, offset = cross(back, onward), q - r
        # offset = s back - t onward, at the lengths s and t beyond the crossing
        both = np.stack([cross(offset, onward), cross(offset, back)])
        lengths = np.divide(both, turn, out=np.full_like(both, -np.inf), where=turn != 0.0)
        return float(np.min(lengths, initial=np.inf))

    def clasp_points(self, hitch: Hitch) -> Array:
        """Return the points (points, 3) [m] of clasps with the shortest cable routes.

        Clasps are on the lines from the ellipses' centres to the hitch's vertices; the ends of
        chains are at their drones.
        """
        layout, drones = hitch.team.layout, self.drones(0.0)
        centres = hitch.vertices.copy()
        centres[layout.clasps] = self.centres
        polygons = [centres + share * (hitch.vertices - centres) for share in CLASP_SHARES]
        ends = np.flatnonzero(~layout.has_leg.ravel())
        for points in polygons:
            points[layout.anchors[ends]] = drones[ends]
        return min(polygons, key=lambda points: _route_ratio(hitch.team, drones, points))


class Bound(NamedTuple):
    """A requirement of the pre-hitch at samples, under the name of the certificate's check."""

    ratio: float  # above 1 if it is violated
    constraint: str  # name of the check
    value: float  # worst value of the samples [unit]
    limit: float  # [unit]
    sense: Literal["min", "max"]  # of the limit
    unit: str  # of value and limit

    @classmethod
    def least(
        cls, constraint: str, value: float, limit: float, unit: str, scale: float = 0.0
    ) -> Bound:
        """Return a lower bound; its ratio is relative to ``scale``, to the value without one."""
        ratio = limit / max(value, 1e-9) if scale == 0.0 else (limit - value + scale) / scale
        return cls(ratio, constraint, value, limit, "min", unit)

    @classmethod
    def largest(cls, constraint: str, value: float, limit: float, unit: str) -> Bound:
        """Return an upper bound."""
        return cls(value / limit, constraint, value, limit, "max", unit)


@dataclass(frozen=True, eq=False)
class PreHitch:
    """A pre-hitch: drones and cables before and after the swaps."""

    hitch: Hitch  # to be tied, at the altitude of the swaps
    settings: SwapSettings  # of the swaps
    ellipses: SwapEllipses  # of all pairs
    share: float  # of the hitch's legs
    depth: float  # largest depth of a cable below the drones' plane during the swaps [m]
    linked: bool  # whether cables cross at all clasps after the first swap
    tightest: Bound  # the requirement that is closest to its limit, or violated most

    @property
    def violation(self) -> float:
        """Relative violation of the requirements; none if at most zero."""
        return self.tightest.ratio - 1.0

    @property
    def doubtful(self) -> bool:
        """Whether samples violate a requirement."""
        return self.violation > 0.0

    @property
    def drones_hanging(self) -> Array:
        """(2n, 3) [m]: positions of the drones before and after the swaps."""
        return self.ellipses.drones(0.0)

    @property
    def senses(self) -> Array:
        """(clasps,): 1 if q_k goes up first, -1 if down."""
        return np.sign(self.ellipses.rise)

    def clear_of_ground(self, requirements: Requirements) -> PreHitch:
        """Return the pre-hitch at the altitude that its cables need, hanging as they are tied."""
        hitch, start = self.hitch, self.drones_hanging
        tightening = (start + x * (hitch.drones - start) for x in TIGHTENING_SHARES)
        hanging = (hover_altitude(hitch.team, drones, requirements) for drones in tightening)
        clearance = ground_clearance(requirements)
        altitude = max(hitch.altitude, requirements.floor + clearance + self.depth, *hanging)
        rise = altitude - hitch.altitude
        if rise <= ALTITUDE_TOLERANCE:
            return self
        return replace(self, hitch=hitch.at_altitude(altitude), ellipses=self.ellipses.raised(rise))

    def with_senses(self, senses: Array) -> PreHitch:
        """Return the pre-hitch with turning senses (c,): 1 if q_k goes up first, -1 if down."""
        turned = replace(self.ellipses, rise=np.abs(self.ellipses.rise) * senses)
        return replace(self, ellipses=turned)

    def stages(self, requirements: Requirements, index: int = 0) -> list[Motion]:
        """Return two swaps, tightening and tension, which lead to the hitch, in step ``index``.

        While drones move out, clasps move on lines too. Their ends are within reach of all cables,
        and since the lengths of routes are convex, so are the points between.
        """
        hitch, team, limits = self.hitch, self.hitch.team, requirements.limits
        start, context = self.drones_hanging, (team, requirements, index)
        # Upper bound of the drones' motion for any polygon.
        distance = (1.0 - self.share) * float(np.max(hitch.legs))
        progress = line_progress(team, limits, start, hitch.drones, distance)
        clasps = on_lines(progress, self.ellipses.clasp_points(hitch), hitch.vertices)
        outward, stages = on_lines(progress, start, hitch.drones), list[Motion]()
        for k in (0, 1):
            turn = self.ellipses.half_turn(limits, k, self.settings.seconds)
            still = PiecewisePolynomial.constant(turn.breaks, hitch.vertices)
            state = CableState.CLASPING
            stages.append(stage(f"swap {k + 1}", turn, *context, state, vertices=still))
        stages.append(stage("tighten", outward, *context, CableState.TIGHTENING, vertices=clasps))
        at_rest = hitch.drones, hitch.legs, rise_seconds(team)
        tied = tension_stage(hitch, *at_rest, requirements, index, CableState.HITCHED)
        return [*stages, tied]


def find_prehitch(hitch: Hitch, requirements: Requirements, settings: SwapSettings) -> PreHitch:
    """Return the first pre-hitch without a violation, else the one with the smallest violation.

    Chords across the vertices are considered only if some other
    candidate would not link its cables.
    """

    def candidates() -> Iterator[tuple[float, PreHitch]]:
        linked = True
        for across, scale, share in itertools.product((False, True), SCALES, LEG_SHARES):
            if across and linked:
                return
            ellipses = _ellipses(hitch, requirements.separation, settings, share, scale, across)
            candidate = _evaluate(ellipses, hitch, requirements, settings, share)
            linked &= candidate.linked
            yield -candidate.violation, candidate

    return best(candidates(), 0.0)


def _ellipses(
    hitch: Hitch,
    separation: Separation,
    settings: SwapSettings,
    share: float,
    scale: float,
    across: bool,
) -> SwapEllipses:
    """Return the ellipses for a fraction of the legs and a scale of the polygon.

    If legs or tensions at a vertex differ much, the chord of its drones may be too oblique for
    their cables to cross after a swap; ``across`` lays chords along the vertices' bisectors.
    """
    layout, drones = hitch.team.layout, hitch.drones
    tilt = DEFAULT_TILT if settings.tilt is None else settings.tilt
    centre = np.append(hitch.polygon.centroid, hitch.altitude)
    vertices = hitch.vertices[layout.clasps]
    q, r = drones[2 * layout.ahead], drones[2 * layout.behind + 1]
    chord = (q - r) * [1.0, 1.0, 0.0]  # pairs swap at equal heights
    lengths, along = np.linalg.norm(chord, axis=1), unit(chord)
    offsets = 0.5 * (q + r) - vertices
    if across:
        edges = unit(layout.edges(hitch.vertices))
        along = unit(edges[layout.behind] + edges[layout.ahead])
        offsets -= np.sum(offsets * along, axis=1, keepdims=True) * along
    outward = left_of(along)
    upward = math.cos(tilt) * np.array([0.0, 0.0, 1.0]) - math.sin(tilt) * outward
    # The scaled chord and w are orthogonal: both axes of the ellipse need the separation.
    w = separation.scale * [0.0, math.sin(tilt), math.cos(tilt)]
    rise = max(settings.radius, 0.5 * MIN_SEPARATION / float(np.linalg.norm(w)))
    ends = drones[~layout.has_leg.ravel()]
    return SwapEllipses(
        hitch.team,
        vertices + share * offsets + (scale - 1.0) * (vertices - centre),
        along,
        upward,
        np.maximum(0.5 * share * lengths, max(settings.radius, MIN_SEPARATION * separation.radius)),
        (settings.sense or 1) * np.full(len(along), rise),
        ends + (scale - 1.0) * (ends - centre),
    )


def _evaluate(
    ellipses: SwapEllipses,
    hitch: Hitch,
    requirements: Requirements,
    settings: SwapSettings,
    share: float,
) -> PreHitch:
    """Return the pre-hitch with these ellipses, sampled over the swaps and up to the hitch."""
    drones = ellipses.drones(np.linspace(0.0, 2.0 * math.pi, ANGLES))
    q, r = drones[:, 0::2], drones[:, 1::2]
    layout, length = ellipses.team.layout, ellipses.team.cable_length
    cables = Catenary.between(q, r, length)
    mu = cables.parameter(SAMPLES[:, None, None])
    points = q + (0.5 * (1.0 + mu))[..., None] * (r - q)  # (samples, angles, n, 3)
    points[..., 2] -= cables.depth(mu)
    separation = requirements.separation
    off, ratio = requirements.position_error, requirements.height_ratio
    displacement = float(np.max(cables.extra_displacement(off, ratio)))
    depth = float(ellipses.centres[0, 2]) - float(np.min(points[..., 2])) + ratio * displacement
    # Distance from q to r along the edge: if negative, pairs would swap on the wrong side.
    opening = float(np.min(np.sum((r[0] - q[0]) * unit(layout.edges(hitch.vertices)), axis=-1)))
    link_length, radius = ellipses.link_length, separation.radius
    diameter, closest = 2.0 * MIN_SEPARATION * radius, smallest_separation(drones, separation)
    longest = float(np.max(np.linalg.norm(r - q, axis=-1) / length))
    bounds = [
        Bound.largest("span", longest, MAX_SPAN_RATIO, "ratio"),
        Bound.least("separation", opening, diameter, "m", scale=radius),
        Bound.least("interlacing", link_length, MIN_LINK, "m", scale=radius),
        Bound.least("separation", closest, 0.99 * MIN_SEPARATION, "ratio"),
    ]
    if separation.cable > 0.0:
        pairs = (q[:, layout.ahead], layout.behind), (r[:, layout.behind], layout.ahead)
        scale = np.array([1.0, 1.0, 1.0 / ratio])
        offsets = [(points[:, :, cable] - drone) * scale for drone, cable in pairs]
        clearance = float(np.min(np.linalg.norm(offsets, axis=-1), initial=np.inf))
        limit = CLEARANCE * (separation.cable + displacement)
        bounds.append(Bound.least("cable_clearance", clearance, limit, "m"))
    if all(bound.ratio <= 1.0 for bound in bounds):
        start, move = drones[0], hitch.drones - drones[0]
        closest = smallest_separation(start + SAMPLES[:, None, None] * move, separation)
        clasps = ellipses.clasp_points(hitch)
        gap, limit = _tightening_gap(hitch, start, clasps), CLEARANCE * separation.cable
        bounds += [
            Bound.least("separation", closest, 1.0, "ratio"),
            Bound.largest("cable_length", _route_ratio(hitch.team, start, clasps), 1.0, "ratio"),
            Bound.least("cable_clearance", gap, limit, "m"),
        ]
    tightest = max(bounds, key=lambda bound: bound.ratio)
    return PreHitch(hitch, settings, ellipses, share, depth, link_length >= MIN_LINK, tightest)


def _tightening_gap(hitch: Hitch, start: Array, clasps: Array) -> float:
    """Return the minimum distance [m] of drones at a clasp to the regions of its cables.

    Seen from above, at samples of the move to the hitch; see ``checks.bodies``.
    """
    layout, share = hitch.team.layout, np.array(TIGHTENING_SHARES)[:, None, None]
    drones = start + share * (hitch.drones - start)
    points = clasps + share * (hitch.vertices - clasps)
    taut = np.broadcast_to(hitch.vertices, points.shape)
    regions = clasped_outlines(layout, drones, points, taut)[..., :2]
    pairs = (2 * layout.behind + 1, layout.ahead), (2 * layout.ahead, layout.behind)
    gaps = [hull_distance(regions[:, cable], drones[:, drone, None, :2]) for drone, cable in pairs]
    return max(float(np.min(gaps, initial=np.inf)), 1e-9)


def smallest_separation(drones: Array, separation: Separation) -> float:
    """Return the minimum separation [1] of drones (J, m, 3) [m] at J times."""
    from scipy.spatial import cKDTree

    scaled = drones * separation.scale
    return min(float(np.min(cKDTree(points).query(points, k=[2])[0])) for points in scaled)


def _route_ratio(team: Team, drones: Array, points: Array) -> float:
    """Return the largest length of a cable's route around the points, over the cable's length."""
    layout = team.layout
    legs = np.linalg.norm(drones - points[layout.anchors], axis=1).reshape(-1, 2)
    edges = np.linalg.norm(points[layout.ends] - points[layout.starts], axis=1)
    return float(np.max((np.sum(legs, axis=1) + edges) / team.cable_length))
