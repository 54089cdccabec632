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
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np

from hitchopt.checks.bodies import clasped_outlines
from hitchopt.forming.swap_settings import SwapSettings
from hitchopt.geometry import hull_distance
from hitchopt.geometry.vectors import cross, left_of, length, unit
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.catenary import Catenary
from hitchopt.hitch.forces import hanging_tensions
from hitchopt.hitch.hitch import ALTITUDE_TOLERANCE
from hitchopt.hitch.requirements import HANGING, Limits, Requirements, Separation
from hitchopt.motion.cable_state import CableState
from hitchopt.motion.motion import Motion
from hitchopt.planners.stages import (
    SLACK_SAMPLES,
    best,
    ground_clearance,
    hover_altitude,
    on_lines,
    rise_seconds,
    stage,
    tension_stage,
    tightening_progress,
)
from hitchopt.planners.timing.profile import usable_accelerations
from hitchopt.planners.timing.ramps import fastest_clock, timed_curve
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array

LEG_SHARES = (0.6, 0.5, 0.4, 0.3, 0.2, 0.1)
"""Fractions of the hitch's legs, in the order of the search."""

SCALES = (1.0, 0.9, 0.8, 0.7, 0.6, 1.15, 1.3, 1.5, 1.8)
"""Scales of the hitch's polygon, in the order of the search."""

TIGHTENING_SPEED = 0.1
"""[m/s] Largest speed of drones from where their errors could pull a cable taut.

At up to 0.4 m/s, simulated cables of 0.6 N whose drones were 15 and 17 cm off were pulled with 2.4
and 5.0 N: the drones' kinetic energy stretches a cable, and the pull grows with their speed."""

DEFAULT_TILT = math.radians(45.0)
"""[rad] Default tilt of the axis of turning. It keeps drones out of hanging cables for any number
of robots; horizontal axes do so for up to about seven."""

MIN_SEPARATION = 1.05
"""Minimum separation [1] of drones in planned stages, such as a pair that turns."""

SAMPLED_SEPARATION = 0.99 * MIN_SEPARATION
"""Smallest separation [1] at samples of the swaps, whose ellipses are made for MIN_SEPARATION."""

MAX_SPAN_RATIO = 0.97  # Largest distance of the drones of a hanging cable, over its length

SLACK_OVER_ERROR = 6.0
"""Slack of hanging cables over the position error of drones, which displaces tauter ones far."""

CLEARANCE = 1.05  # Clearance of drones to cables, over ``Separation.cable``.

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

HELD_BACK = 0.01
"""[m] Largest distance by which sagging cables hold back drones, at rest, as tensions rise.

Where the plan has its drones, cables that hang along their routes have the full tension. Drones
that feed a lower one forward are pulled inward until the cables sag enough for it. With 1 cm,
tensions rise from 0.45 of the full one for cables of 5 g/m, and from 0.75 for 10 g/m."""

CLASP_SHARES = (0.0, 0.2, 0.4, 0.6, 0.8, 1.0)
"""Fractions of the line from pre-hitch to hitch that are candidates for the clasps."""


def longest_spans(team: Team, requirements: Requirements) -> Array:
    """Return the distances (n,) [m] of drones from which hanging cables are drawn taut."""
    height_error = requirements.height_error
    longest_hanging = MAX_SPAN_RATIO * team.cable_length
    with_slack = team.cable_length - SLACK_OVER_ERROR * height_error
    return np.asarray(np.minimum(longest_hanging, with_slack))


@dataclass(frozen=True, eq=False)
class SwapEllipses:
    """Ellipses at the clasps on which pairs of drones turn about each other, with a common angle.

    At clasp k the drones ``q_k`` and ``r_{k-1}`` turn about the middle c of their chord, on

        q_k = c + a cos θ t + h sin θ w,      r_{k-1} = c - a cos θ t - h sin θ w,

    t along the chord, w normal to it. The axis of turning is the outward normal of the chord,
    tilted upward, so that the upper drone passes inside and the lower one outside. Otherwise, at a
    vertex with nearly collinear edges, it would fly into the loop of its neighbour's hanging cable.
    """

    team: Team  # Team of the drones
    centres: Array  # (clasps, 3) [m], c
    along: Array  # (clasps, 3), t: horizontal unit vectors from ``r_{k-1}`` to ``q_k``
    upward: Array  # (clasps, 3), w: unit vectors normal to t, upward and tilted inward
    half: Array  # (clasps,) [m], a: half of the chord
    rise: Array  # (clasps,) [m], h: the other semi-axis, negative if q_k goes down first
    ends: Array  # (k, 3) [m]: drones at the ends of a chain, which do not turn

    def drones(self, angle: Array | float, derivative: int = 0) -> Array:
        """Return the drones (…, 2n, 3) [m] at angles θ (…), or a derivative in the angle."""
        theta = np.asarray(angle, dtype=np.float64)[..., None, None] + 0.5 * np.pi * derivative
        along_chord = (self.half[:, None] * self.along) * np.cos(theta)
        normal_to_chord = (self.rise[:, None] * self.upward) * np.sin(theta)
        offset = along_chord + normal_to_chord
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
        angles = np.linspace(start, start + math.pi, 25)
        usable = float(np.min(usable_accelerations(self.team, limits, self.drones(angles))))
        semi_axis = float(max(np.max(self.half), np.max(np.abs(self.rise))))

        def turn(centripetal_share: float) -> PiecewisePolynomial:
            """Return the turn with a centripetal share of the acceleration, within all limits."""
            rate_of_centripetal = math.sqrt(centripetal_share * usable / semi_axis)
            top_rate = min(limits.speed / semi_axis, rate_of_centripetal)
            centripetal = top_rate * top_rate * semi_axis
            remaining = usable * usable - centripetal**2
            tangential = math.sqrt(max(remaining, 1e-6**2))
            clock = fastest_clock(
                math.pi,
                speed=top_rate,
                acceleration=tangential / semi_axis,
                jerk=JERK_SHARE * limits.jerk / semi_axis,
            )
            return timed_curve(
                lambda angle, k: self.drones(start + angle, k),
                clock,
                MAX_PIECE_ANGLE,
                limits,
                usable,
            )

        fastest = min(map(turn, TURNING_SHARES), key=lambda drones: drones.duration)
        shortest = seconds or 0.0
        return fastest.stretched(max(1.0, shortest / fastest.duration))

    @property
    def link_length(self) -> float:
        """Smallest length [m] of two cables beyond the crossing of their chords at a clasp.

        In plan view after half a turn; negative if they do not cross.
        """
        layout = self.team.layout
        drones = self.drones(math.pi)[:, :2]
        r = drones[2 * layout.behind + 1]
        q = drones[2 * layout.ahead]
        back = unit(drones[2 * layout.behind] - r)
        onward = unit(drones[2 * layout.ahead + 1] - q)
        offset = q - r
        # offset = s back - t onward, at the lengths s and t beyond the crossing
        determinant = cross(back, onward)
        numerators = np.stack([cross(offset, onward), cross(offset, back)])
        parallel = np.full_like(numerators, -np.inf)
        lengths = np.divide(numerators, determinant, out=parallel, where=determinant != 0.0)
        return float(np.min(lengths, initial=np.inf))

    def clasp_points(self, hitch: Hitch) -> Array:
        """Return the points (points, 3) [m] of clasps with the shortest cable routes.

        Clasps are on the lines from the ellipses' centres to the hitch's vertices; the ends of
        chains are at their drones.
        """
        layout = hitch.team.layout
        drones = self.drones(0.0)
        centres = hitch.vertices.copy()
        centres[layout.clasps] = self.centres
        polygons = [centres + share * (hitch.vertices - centres) for share in CLASP_SHARES]
        ends = np.flatnonzero(~layout.has_leg.ravel())
        for points in polygons:
            points[layout.anchors[ends]] = drones[ends]
        return min(polygons, key=lambda points: _route_ratio(hitch.team, drones, points))


class Bound(NamedTuple):
    """A requirement of the pre-hitch at samples, under the name of the certificate's check."""

    ratio: float  # Above 1 if the requirement is violated
    constraint: str  # Name of the check
    value: float  # Worst value of the samples [unit]
    limit: float  # Its limit [unit]
    sense: Literal["min", "max"]  # Sense of the limit
    unit: str  # Unit of value and limit

    @classmethod
    def least(
        cls, constraint: str, value: float, limit: float, unit: str, scale: float = 0.0
    ) -> Bound:
        """Return a lower bound; its ratio is relative to ``scale``, to the value without one."""
        ratio = (limit - value + scale) / scale if scale > 0.0 else limit / max(value, 1e-9)
        return cls(ratio, constraint, value, limit, "min", unit)

    @classmethod
    def largest(cls, constraint: str, value: float, limit: float, unit: str) -> Bound:
        """Return an upper bound."""
        return cls(value / limit, constraint, value, limit, "max", unit)


@dataclass(frozen=True, eq=False)
class PreHitch:
    """A pre-hitch: drones and cables before and after the swaps."""

    hitch: Hitch  # The hitch to be tied, at the altitude of the swaps
    settings: SwapSettings  # Settings of the swaps
    ellipses: SwapEllipses  # Ellipses of all pairs
    share: float  # Share of the hitch's legs
    depth: float
    """Largest depth of a cable below the drones' plane during the swaps [m].

    It is infinite where errors of position may pull a cable taut.
    """

    linked: bool  # True if cables cross at all clasps after the first swap
    tightest: Bound  # The requirement that is closest to its limit, or violated most

    @property
    def violation(self) -> float:
        """Relative violation of the requirements; none if at most zero."""
        return self.tightest.ratio - 1.0

    @property
    def doubtful(self) -> bool:
        """Return whether samples violate a requirement."""
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
        """Return the pre-hitch at the altitude that its cables need, hanging as they are tied.

        Raises InfeasibleError where errors of position may pull a cable taut.
        """
        hitch = self.hitch
        if not math.isfinite(self.depth):
            _ = hover_altitude(
                hitch.team, SampledSwaps(self.ellipses, requirements).drones, requirements
            )
        start = self.drones_hanging
        altitudes = [
            hover_altitude(hitch.team, start + share * (hitch.drones - start), requirements)
            for share in TIGHTENING_SHARES
        ]
        ground = requirements.ground_for(HANGING)
        lowest_of_swaps = ground + ground_clearance(requirements) + self.depth
        altitude = max(hitch.altitude, lowest_of_swaps, *altitudes)
        rise = altitude - hitch.altitude
        if rise <= ALTITUDE_TOLERANCE:
            return self
        return replace(self, hitch=hitch.at_altitude(altitude), ellipses=self.ellipses.raised(rise))

    def with_senses(self, senses: Array) -> PreHitch:
        """Return the pre-hitch with senses (clasps,): 1 if q_k goes up first, -1 if down."""
        turned = replace(self.ellipses, rise=np.abs(self.ellipses.rise) * senses)
        return replace(self, ellipses=turned)

    def stages(self, requirements: Requirements, index: int = 0) -> list[Motion]:
        """Return the phases up to the hitch in step ``index``: two swaps, tightening, tension.

        While drones move out, clasps move on lines too. Their ends are within reach of all cables,
        and since the lengths of routes are convex, so are the points between. With the drones, the
        tensions rise to those of cables that hang along their routes (``hanging_share``).
        """
        hitch = self.hitch
        team = hitch.team
        limits = requirements.limits
        start = self.drones_hanging
        stages = list[Motion]()
        for k in (0, 1):
            turn = self.ellipses.half_turn(limits, k, self.settings.seconds)
            still = PiecewisePolynomial.constant(turn.breaks, hitch.vertices)
            swap = stage(
                f"swap {k + 1}",
                turn,
                team,
                requirements,
                index,
                CableState.CLASPING,
                vertices=still,
            )
            stages.append(swap)
        # Upper bound of the drones' motion for any polygon.
        distance = (1.0 - self.share) * float(np.max(hitch.legs))
        ends = start, hitch.drones
        slack = self._slack_while_tightening()
        error = requirements.position_error
        progress = tightening_progress(
            team, limits, *ends, slack, error, TIGHTENING_SPEED, distance
        )
        outward = on_lines(progress, start, hitch.drones)
        clasps = on_lines(progress, self.ellipses.clasp_points(hitch), hitch.vertices)
        pull_at_end = hanging_share(hitch) * team.tension
        pulls = progress.coefficients[:, None] * pull_at_end[:, None]
        tighten = stage(
            "tighten",
            outward,
            team,
            requirements,
            index,
            CableState.TIGHTENING,
            vertices=clasps,
            tensions=PiecewisePolynomial(progress.breaks, pulls),
        )
        tension = tension_stage(
            hitch,
            hitch.drones,
            hitch.legs,
            rise_seconds(team),
            requirements,
            index,
            CableState.HITCHED,
            pull_at_end,
        )
        return [*stages, tighten, tension]

    def _slack_while_tightening(self) -> Array:
        """Return the length (S,) [m] that the tautest cable lacks during the move to the hitch."""
        team = self.hitch.team
        start, clasps = self.drones_hanging, self.ellipses.clasp_points(self.hitch)
        slack = list[float]()
        for share in np.linspace(0.0, 1.0, SLACK_SAMPLES).tolist():
            drones = start + share * (self.hitch.drones - start)
            points = clasps + share * (self.hitch.vertices - clasps)
            slack.append(float(np.min(team.cable_length - _route_lengths(team, drones, points))))
        return np.array(slack)


def hanging_share(hitch: Hitch) -> float:
    """Return the share of a hitch's tensions with which no cable holds back drones by HELD_BACK."""
    layout, vertices = hitch.team.layout, hitch.vertices
    legs = (hitch.drones - vertices[layout.anchors])[:, :2]
    edges = layout.edges(vertices)[:, :2]
    routes = length(edges) + np.sum(length(legs).reshape(-1, 2), axis=1)
    tensions = hanging_tensions(hitch.team, routes - 2.0 * HELD_BACK)
    return min(float(np.max(tensions / hitch.team.tension)), 1.0)


def find_prehitch(hitch: Hitch, requirements: Requirements, settings: SwapSettings) -> PreHitch:
    """Return the first pre-hitch without a violation, or the one with the smallest violation.

    Chords across the vertices are considered only if some other candidate would not link its
    cables.
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
    layout = hitch.team.layout
    drones = hitch.drones
    tilt = DEFAULT_TILT if settings.tilt is None else settings.tilt
    centre = np.append(hitch.polygon.centroid, hitch.altitude)
    vertices = hitch.vertices[layout.clasps]
    q = drones[2 * layout.ahead]
    r = drones[2 * layout.behind + 1]
    chord = (q - r) * [1.0, 1.0, 0.0]  # pairs swap at equal heights
    chord_lengths = np.linalg.norm(chord, axis=1)
    along = unit(chord)
    offsets = 0.5 * (q + r) - vertices
    if across:
        edges = unit(layout.edges(hitch.vertices))
        along = unit(edges[layout.behind] + edges[layout.ahead])
        offsets -= np.sum(offsets * along, axis=1, keepdims=True) * along
    outward = left_of(along)
    upward = math.cos(tilt) * np.array([0.0, 0.0, 1.0]) - math.sin(tilt) * outward
    # The scaled chord and normal are orthogonal: both axes of the ellipse need the separation.
    scaled_normal = separation.scale * [0.0, math.sin(tilt), math.cos(tilt)]
    rise = max(settings.radius, 0.5 * MIN_SEPARATION / float(np.linalg.norm(scaled_normal)))
    smallest_half = max(settings.radius, MIN_SEPARATION * separation.radius)
    sense = settings.sense or 1
    ends = drones[~layout.has_leg.ravel()]
    return SwapEllipses(
        hitch.team,
        centres=vertices + share * offsets + (scale - 1.0) * (vertices - centre),
        along=along,
        upward=upward,
        half=np.maximum(0.5 * share * chord_lengths, smallest_half),
        rise=sense * np.full(len(along), rise),
        ends=ends + (scale - 1.0) * (ends - centre),
    )


@dataclass(frozen=True, eq=False)
class SampledSwaps:
    """Drones and hanging cables at samples of the two swaps."""

    ellipses: SwapEllipses  # Ellipses of all pairs
    requirements: Requirements  # Distances to keep, and tracking errors

    @cached_property
    def drones(self) -> Array:
        """(angles, 2n, 3) [m]: drones on two half turns."""
        return self.ellipses.drones(np.linspace(0.0, 2.0 * math.pi, ANGLES))

    @property
    def q(self) -> Array:
        """(angles, n, 3) [m]: drones at the first ends of cables."""
        return self.drones[:, 0::2]

    @property
    def r(self) -> Array:
        """(angles, n, 3) [m]: drones at the last ends of cables."""
        return self.drones[:, 1::2]

    @cached_property
    def cables(self) -> Catenary:
        """The hanging cables (angles, n)."""
        return Catenary.between(self.q, self.r, self.ellipses.team.cable_length)

    @cached_property
    def cable_points(self) -> Array:
        """(samples, angles, n, 3) [m]: points of the cables."""
        parameter = self.cables.parameter(SAMPLES[:, None, None])
        chord_share = 0.5 * (1.0 + parameter)
        points = self.q + chord_share[..., None] * (self.r - self.q)
        points[..., 2] -= self.cables.depth(parameter)
        return points

    @cached_property
    def displacement(self) -> float:
        """Largest displacement [m] of cables beyond that of their drones by tracking errors."""
        position_error = self.requirements.position_error
        height_ratio = self.requirements.height_ratio
        return float(np.max(self.cables.extra_displacement(position_error, height_ratio)))

    @property
    def depth(self) -> float:
        """Largest depth [m] of a cable below the drones' plane."""
        lowest = float(np.min(self.cable_points[..., 2]))
        plane = float(self.ellipses.centres[0, 2])
        return plane - lowest + self.requirements.height_ratio * self.displacement

    def opening(self, hitch: Hitch) -> float:
        """Return the smallest distance [m] from q to r along a cable's edge, before the swaps.

        If it is negative, pairs would swap on the wrong side.
        """
        edge_directions = unit(self.ellipses.team.layout.edges(hitch.vertices))
        chords = self.r[0] - self.q[0]
        return float(np.min(np.sum(chords * edge_directions, axis=-1)))

    @property
    def cable_clearance(self) -> float:
        """Smallest distance [m] of a drone to the other cable at its clasp, heights scaled."""
        layout = self.ellipses.team.layout
        q = self.q[:, layout.ahead]
        r = self.r[:, layout.behind]
        to_q = self.cable_points[:, :, layout.behind] - q
        to_r = self.cable_points[:, :, layout.ahead] - r
        scale = self.requirements.error_scale
        distances = np.linalg.norm(np.stack([to_q, to_r]) * scale, axis=-1)
        return float(np.min(distances, initial=np.inf))

    def bounds(self, hitch: Hitch) -> list[Bound]:
        """Return the requirements of the swaps that lead to a hitch."""
        separation = self.requirements.separation
        radius = separation.radius
        closest = smallest_separation(self.drones, separation)
        diameter = 2.0 * MIN_SEPARATION * radius
        opening = self.opening(hitch)
        link_length = self.ellipses.link_length
        spans = np.linalg.norm(self.r - self.q, axis=-1)
        span_ratio = float(np.max(spans / self.ellipses.team.cable_length))
        bounds = [
            Bound.largest("span", span_ratio, MAX_SPAN_RATIO, "ratio"),
            Bound.least("separation", opening, diameter, "m", scale=radius),
            Bound.least("interlacing", link_length, MIN_LINK, "m", scale=radius),
            Bound.least("separation", closest, SAMPLED_SEPARATION, "ratio"),
        ]
        if separation.cable > 0.0:
            limit = CLEARANCE * (separation.cable + self.displacement)
            bounds.append(Bound.least("cable_clearance", self.cable_clearance, limit, "m"))
        return bounds


def _evaluate(
    ellipses: SwapEllipses,
    hitch: Hitch,
    requirements: Requirements,
    settings: SwapSettings,
    share: float,
) -> PreHitch:
    """Return the pre-hitch with these ellipses, sampled over the swaps and up to the hitch."""
    swaps = SampledSwaps(ellipses, requirements)
    bounds = swaps.bounds(hitch)
    if all(bound.ratio <= 1.0 for bound in bounds):
        bounds += _bounds_of_tightening(ellipses, hitch, requirements.separation)
    tightest = max(bounds, key=lambda bound: bound.ratio)
    linked = ellipses.link_length >= MIN_LINK
    return PreHitch(hitch, settings, ellipses, share, swaps.depth, linked, tightest)


def _bounds_of_tightening(
    ellipses: SwapEllipses, hitch: Hitch, separation: Separation
) -> list[Bound]:
    """Return the requirements of the move from the swaps to the hitch, at its samples."""
    start = ellipses.drones(0.0)
    clasps = ellipses.clasp_points(hitch)
    drones = start + SAMPLES[:, None, None] * (hitch.drones - start)
    closest = smallest_separation(drones, separation)
    route = _route_ratio(hitch.team, start, clasps)
    gap = _tightening_gap(hitch, start, clasps)
    return [
        Bound.least("separation", closest, 1.0, "ratio"),
        Bound.largest("cable_length", route, 1.0, "ratio"),
        Bound.least("cable_clearance", gap, CLEARANCE * separation.cable, "m"),
    ]


def _tightening_gap(hitch: Hitch, start: Array, clasps: Array) -> float:
    """Return the minimum distance [m] of drones at a clasp to the regions of its cables.

    Seen from above, at samples of the move to the hitch; see ``checks.bodies``.
    """
    layout = hitch.team.layout
    share = np.array(TIGHTENING_SHARES)[:, None, None]
    drones = start + share * (hitch.drones - start)
    points = clasps + share * (hitch.vertices - clasps)
    taut = np.broadcast_to(hitch.vertices, points.shape)
    regions = clasped_outlines(layout, drones, points, taut)[..., :2]
    q = drones[:, 2 * layout.ahead, None, :2]
    r = drones[:, 2 * layout.behind + 1, None, :2]
    gaps = [
        hull_distance(regions[:, layout.ahead], r),
        hull_distance(regions[:, layout.behind], q),
    ]
    return max(float(np.min(gaps, initial=np.inf)), 1e-9)


def smallest_separation(drones: Array, separation: Separation) -> float:
    """Return the minimum separation [1] of drones (J, m, 3) [m] at J times.

    The drones of all times are in one tree. Its fourth axis keeps those of two times farther apart
    than any two drones of one time. The smallest separation of the first time bounds the search.
    """
    from scipy.spatial import cKDTree

    scaled = drones * separation.scale
    times, count, _ = scaled.shape
    extent = np.ptp(scaled.reshape(-1, 3), axis=0)
    distance_of_times = float(np.linalg.norm(extent)) + 1.0
    fourth = np.repeat(distance_of_times * np.arange(times), count)
    points = np.column_stack([scaled.reshape(-1, 3), fourth])
    tree = cKDTree(points, balanced_tree=False)
    second_nearest = [2]  # the nearest point is the drone itself
    first = float(np.min(tree.query(points[:count], k=second_nearest)[0]))
    distances, _ = tree.query(points[count:], k=second_nearest, distance_upper_bound=first)
    return min(first, float(np.min(distances, initial=np.inf)))


def _route_ratio(team: Team, drones: Array, points: Array) -> float:
    """Return the largest length of a cable's route around the points, over the cable's length."""
    return float(np.max(_route_lengths(team, drones, points) / team.cable_length))


def _route_lengths(team: Team, drones: Array, points: Array) -> Array:
    """Return the lengths (n,) [m] of the cables' routes around the points."""
    layout = team.layout
    legs = np.linalg.norm(drones - points[layout.anchors], axis=1).reshape(-1, 2)
    edges = np.linalg.norm(points[layout.ends] - points[layout.starts], axis=1)
    return np.asarray(np.sum(legs, axis=1) + edges)
