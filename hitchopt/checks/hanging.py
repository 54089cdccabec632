"""Hanging cables on spans of time: their distances from drones and from the ground.

On a time span, a hanging cable is replaced by a chain through points of the catenary at fixed μ,
with the steepness at mid time and the height difference of the polynomials. The distance of the
catenary from that chain is at most a bound on its bend between the points, plus ¼ (L + |h|) times
the deviation of its steepness from that at mid time (see ``hitchopt.hitch.catenary``).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import product

import numpy as np

from hitchopt.checks.bodies import cable_ends
from hitchopt.checks.certificate import with_tolerance
from hitchopt.checks.distances import GROUND, Flags, Ground, Moving, PairSpans, Shape, nearest
from hitchopt.checks.drone_forces import steepness_of
from hitchopt.checks.spans import ROUNDING, cable_names, position_margin
from hitchopt.hitch.catenary import (
    SERIES_LIMIT,
    Catenary,
    depth_terms,
    displacement_bound,
    level_length,
)
from hitchopt.hitch.pairs import DISTANCES
from hitchopt.motion.motion import Motion
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.trajectory.enclosed import Bound, Enclosed, Interval
from hitchopt.trajectory.piecewise import on_breaks
from hitchopt.values import Array

CHAIN_TOLERANCE = 1e-3
"""[m] Largest gap of ``worst`` below an attained distance, in addition to the distance of a cable
from its links: bounds of catenaries, which are not polynomials, tighten slowly."""

POINTS_BY_LENGTH = 20
"""Number of links between a chain's points at equal distances along the cable, which resolve steep
ends. The cable deviates from the links by at most about 0.2 % of its length, where it bends the
most, and much less elsewhere."""

POINTS_BY_PLACE = 16
"""Number of a chain's points at equal horizontal distances, which resolve the lowest part."""

MIN_LINK = 1e-12  # Smallest length of a link in units of a chain's steepness, in quotients
MAX_REACH = 0.25  # [m] Pieces on which a drone may move farther are split
MAX_PARTS = 200  # Largest number of parts of a piece: only curves of no plan are longer

OWN_DISTANCES = 2.0
"""Distance along a cable from its drone, over ``separation.cable``, beyond which it is checked
there where it rises again. Errors of drones add to that limit."""

OWN_SHARE = 0.75
"""End of the last link that is ignored for the cable's own drone, over the distance along the
cable beyond which it is checked."""

ROUNDING_SHARE = 1e-9  # Rounding of the end of that link, over the same distance


def chains(q: Array, r: Array, length: Array) -> tuple[Array, Array]:
    """Return points of chains that replace hanging cables, and bounds of their distance.

    For cables between ends (spans, 3, degree + 1) of ``length`` (spans,) [m], these are (spans,
    links + 1, 3, degree + 1) and (spans, links) [m], for each link at all times of the span.
    """
    hanging = Hanging.between(q, r, length)
    return hanging.chain(hanging.chain_parameters())


@dataclass(frozen=True, eq=False)
class Hanging:
    """Cables that hang between two ends on spans of time."""

    start: Array  # (spans, 3, degree + 1) [m], positions of the first ends
    offset: Enclosed  # (spans, 3) [m], positions of the second ends relative to the first ones
    length: Array  # (spans,) [m], lengths of the cables
    cable: Catenary  # The cables (spans,) at mid time
    sigma: Interval  # (spans,), steepness of the cables on the whole span

    @classmethod
    def between(cls, q: Array, r: Array, length: Array) -> Hanging:
        """Return the cables between ends (spans, 3, degree + 1) of ``length`` (spans,) [m]."""
        offset = Enclosed(r - q)
        at_mid_time = Catenary.between(Enclosed(q).middle, Enclosed(r).middle, length)
        return cls(q, offset, length, at_mid_time, steepness_of(offset, length))

    def chain_parameters(self, *distances: float) -> Array:
        """Return parameters μ (links + 1, spans) of a chain's points.

        ``distances`` [m] from the start, along the cable, are among them.
        """
        spans = len(self.length)
        even_shares = np.linspace(0.0, 1.0, POINTS_BY_LENGTH + 1)
        shares = [np.full(spans, share) for share in even_shares]
        shares += [np.minimum(distance / self.length, 1.0) for distance in distances]
        by_length = self.cable.parameter(np.array(shares))
        centres = (np.arange(POINTS_BY_PLACE) + 0.5) * (2.0 / POINTS_BY_PLACE) - 1.0
        by_place = np.repeat(centres[:, None], spans, axis=1)
        return np.sort(np.concatenate([by_length, by_place]), axis=0)

    def chain(self, mu: Array) -> tuple[Array, Array]:
        """Return points and bounds as ``chains``, at parameters μ (links + 1, spans)."""
        level, skew = depth_terms(self.cable.sigma, mu)
        fraction = (0.5 * (1.0 + mu)).T[..., None, None]
        points = self.start[:, None] + fraction * self.offset.c[:, None]
        level_depth = (self.length * level).T[..., None]
        skew_depth = skew.T[..., None] * self.offset.c[:, None, 2]
        points[:, :, 2] -= level_depth + skew_depth
        steeper = self.sigma.high - self.cable.sigma
        flatter = self.cable.sigma - self.sigma.low
        drift = np.maximum(steeper, flatter)
        largest_rise = np.max(np.abs(self.offset.c[:, 2]), axis=-1)
        errors = np.maximum(self._bend(mu), 0.0) + ROUNDING * self.length
        errors = errors + 0.25 * (self.length + largest_rise) * drift
        return points, errors.T

    def _bend(self, mu: Array) -> Array:
        """Return the largest vertical distances (links, spans) [m] of cables from their links.

        In units of ``Λ / 2 sinh σ``, the cable at mid time is a hyperbolic cosine, which is
        farthest from a link where it is parallel to it.
        """
        sigma = np.maximum(self.cable.sigma, SERIES_LIMIT)
        place = mu * sigma + np.arcsinh(self.cable.tilt)
        start = place[:-1]
        end = place[1:]
        slope = np.diff(np.cosh(place), axis=0) / np.maximum(np.diff(place, axis=0), MIN_LINK)
        parallel = np.clip(np.arcsinh(slope), start, end)
        bend: Array = np.cosh(start) + slope * (parallel - start) - np.cosh(parallel)
        bend *= 0.5 * level_length(self.cable.rise, self.length) / np.sinh(sigma)
        return bend

    def leads_away(self, mu: Array, distance: float) -> Flags:
        """Return which links (spans, links) lead down from the start, or begin near it, throughout.

        Near is up to a ``distance`` [m] along the cable.

        With σ the steepness and h the rise, the slope at μ is ``sinh(μ σ + artanh(h / L))``, and
        the length from the start is ``½ L (1 + sinh μσ / sinh σ) - ½ h (cosh σ - cosh μσ) / sinh
        σ``. Both fractions are monotone in σ.
        """
        rise = self.offset[2].range
        steepness = (self.sigma.low, self.sigma.high)
        steepest = np.maximum(*(mu * np.maximum(sigma, SERIES_LIMIT) for sigma in steepness))
        descending = steepest + np.arctanh(rise.high / self.length) <= 0.0
        largest_sine_ratio = np.maximum(*(_sine_ratio(mu, sigma) for sigma in steepness))
        ends = product(steepness, (rise.low, rise.high))
        falls = [-height * _cosine_ratio(mu, sigma) for sigma, height in ends]
        largest_fall = np.maximum.reduce(falls)
        longest = 0.5 * (self.length * (1.0 + largest_sine_ratio) + largest_fall)
        mid_steepness = self.cable.sigma
        by_rise = self.cable.rise * _cosine_ratio(mu, mid_steepness)
        at_mid_time = 0.5 * (self.length * (1.0 + _sine_ratio(mu, mid_steepness)) - by_rise)
        near = longest <= distance
        near &= at_mid_time <= OWN_SHARE * distance * (1.0 + ROUNDING_SHARE)
        return np.asarray((descending | near)[1:].T)


def _sine_ratio(mu: Array, sigma: Array) -> Array:
    """Return ``sinh μσ / sinh σ``."""
    steepness = np.maximum(sigma, SERIES_LIMIT)
    return np.asarray(np.sinh(mu * steepness) / np.sinh(steepness))


def _cosine_ratio(mu: Array, sigma: Array) -> Array:
    """Return ``(cosh σ - cosh μσ) / sinh σ``."""
    steepness = np.maximum(sigma, SERIES_LIMIT)
    return np.asarray((np.cosh(steepness) - np.cosh(mu * steepness)) / np.sinh(steepness))


def split_long_pieces(drones: PiecewisePolynomial) -> PiecewisePolynomial:
    """Return the curves on pieces on which no drone moves farther than MAX_REACH.

    No piece is split into more than MAX_PARTS.
    """
    extents = np.linalg.norm(np.ptp(drones.coefficients, axis=-1), axis=-1)
    longest = np.max(extents, axis=1)
    counts = np.clip(np.ceil(longest / MAX_REACH), 1, MAX_PARTS).astype(np.intp)
    if np.all(counts == 1):
        return drones
    starts = [
        np.linspace(start, end, count, endpoint=False)
        for start, end, count in zip(drones.breaks[:-1], drones.breaks[1:], counts, strict=True)
    ]
    return on_breaks(drones, np.concatenate([*starts, drones.breaks[-1:]]))


def cables_and_drones(motion: Motion) -> Moving:
    """Return the pairs of hanging cables and drones of other cables."""
    drones = split_long_pieces(motion.drones)
    return Moving(
        drones.breaks,
        cable_ends(drones.coefficients),
        drones.coefficients[:, :, None],
        position_margin(motion),
        allowed=lambda cables, drones: drones // 2 != cables,
        lengths=motion.team.cable_length,
        names=(cable_names(motion), motion.team.drone_names),
        formula=chain_distance,
        tolerance=CHAIN_TOLERANCE,
    )


def own_cable_distance(motion: Motion) -> float:
    """Return the distance along cables beyond which they are checked for their own drones [m]."""
    requirements = motion.requirements
    limit = DISTANCES["cable_clearance"].limit(requirements.separation)
    return OWN_DISTANCES * (limit + 2.0 * requirements.limits.tube.level)


def drones_and_own_cables(motion: Motion) -> Moving:
    """Return the pairs of drones and their own hanging cables, where these rise again.

    The part that leads down from a drone never comes back to it.
    """
    drones = split_long_pieces(motion.drones)
    places = drones.coefficients
    other_ends = places[:, np.arange(motion.team.drones) ^ 1]
    names = cable_names(motion)
    return Moving(
        drones.breaks,
        np.stack([places, other_ends], axis=2),
        places[:, :, None],
        position_margin(motion),
        matched=True,
        lengths=np.repeat(motion.team.cable_length, 2),
        names=([names[k // 2] for k in range(motion.team.drones)], motion.team.drone_names),
        formula=partial(chain_distance, beyond=own_cable_distance(motion)),
        tolerance=CHAIN_TOLERANCE,
    )


def cables_and_ground(motion: Motion) -> Iterator[Moving]:
    """Yield the pairs of hanging cables and the ground, if there is one."""
    for ground in lowered_ground(motion):
        cables = cables_and_drones(motion)
        yield replace(
            cables,
            second=np.zeros((len(cables.first), 1, 1, 3, 1)),
            names=(cables.names[0], (GROUND,)),
            allowed=None,
            shape=ground,
        )


def lowered_ground(motion: Motion) -> Iterator[Ground]:
    """Yield the ground, if there is one, from which cables keep the limit of their clearance.

    It is lowered so that cables at ``Requirements.ground_clearance`` keep the limit where heights
    are divided by ``height_ratio``: that division lengthens their distances only.
    """
    requirements = motion.requirements
    if requirements.floor is None:
        return
    scaled_limit = requirements.height_ratio * requirements.separation.cable
    lowered = scaled_limit - requirements.ground_clearance
    yield Ground(requirements.floor - lowered)


def chain_distance(spans: PairSpans, shape: Shape | None = None, beyond: float = 0.0) -> Bound:
    """Return the distances of hanging cables from points, or from a half-space [m].

    With ``beyond``, points are the cables' own starts, and only links that rise are checked, beyond
    that distance [m] along them.
    """
    ends, point = spans.ends
    shape = shape or spans.source.shape
    hanging = Hanging.between(ends[:, 0], ends[:, 1], spans.lengths)
    mu = hanging.chain_parameters(*([OWN_SHARE * beyond] if beyond else []))
    points, errors = hanging.chain(mu)
    offsets = points - point  # (spans, links + 1, 3, degree + 1)
    height_ratio = spans.source.height_ratio
    if height_ratio != 1.0:
        offsets[:, :, 2] /= height_ratio
        shape = shape.flattened(height_ratio)
    middle = Enclosed(offsets).middle
    normals = shape.normals(np.stack([middle[:, :-1], middle[:, 1:]], axis=2))
    to_start = np.einsum("sld,sldi->sli", normals, offsets[:, :-1])
    to_end = np.einsum("sld,sldi->sli", normals, offsets[:, 1:])
    distances = np.minimum(to_start, to_end) - (errors + shape.support(normals))[..., None]
    if beyond:
        distances[hanging.leads_away(mu, beyond)] = np.inf
    lower = Enclosed(np.min(distances, axis=1, keepdims=True), spans.source.margin).lower
    return Bound(np.maximum(lower.value, 0.0), lower.x)


def above_ground(motion: Motion) -> bool:
    """Return whether hanging cables would keep ``separation.cable`` from the ground, if any."""
    limit = motion.requirements.separation.cable
    closest = nearest(cables_and_ground)(motion, limit)
    return closest.worst >= with_tolerance(limit, "min", closest.size)


def cable_displacement(motion: Motion) -> Callable[[float], float]:
    """Return the largest displacement [m] of hanging cables as a function of tracking errors [m].

    Heights are divided by ``Requirements.height_ratio``.
    """
    ends = cable_ends(split_long_pieces(motion.drones).coefficients)
    offset = Enclosed(ends[:, :, 1] - ends[:, :, 0])
    distances = offset.xy.norm_range
    across = (distances.low, distances.high)
    rise = offset[2].norm_upper.value
    cable_length = motion.team.cable_length
    height_ratio = motion.requirements.height_ratio

    def displacement(radius: float) -> float:
        return float(np.max(displacement_bound(across, rise, cable_length, radius, height_ratio)))

    return displacement
