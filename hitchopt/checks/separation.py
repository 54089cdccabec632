"""Check ``separation`` of drones, what separates them, and the closest pairs of a plan.

In coordinates scaled by ``Separation.scale``, the distance of two drones is their separation: 1
where their ellipsoids touch.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np

from hitchopt.checks.certificate import Check
from hitchopt.checks.distances import Moving, distance, gap, nearest, smallest
from hitchopt.checks.rule import CheckRule, Evaluator
from hitchopt.checks.spans import ROUNDING, cable_names, flight_magnitude, magnitude
from hitchopt.errors import InputError, OneLine
from hitchopt.geometry import shortest_offset
from hitchopt.geometry.vectors import unit
from hitchopt.hitch.pairs import DISTANCES
from hitchopt.hitch.requirements import Separation
from hitchopt.motion.flight import Flight
from hitchopt.motion.motion import Motion
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.trajectory.piecewise import merged_breaks, on_breaks

# Changes that separate a drone from another one, or from a cable, of one hitch
LONGER_LEGS = "use a longer cable or a smaller polygon"
LARGER_POLYGON = "a larger polygon"
OTHER_LEGS = "change the leg lengths: use cables of another length, or another polygon"

PARALLEL = 0.02
"""Largest component along an edge, of the difference of unit vectors along the legs beyond it, up
to which both legs are parallel: lengths of cables then have no effect on their distance."""


def leg_remedy(motion: Motion, check: Check, distance: str) -> str:
    """Return what separates two drones, or a drone and a cable, of one hitch; empty for others.

    ``distance`` is the key of the limit. A leg continues the next edge of the polygon. With
    exterior angle τ at both ends of an edge e and a cable of length L, the drones of that cable are
    ``e (1 + cos τ) - L cos τ`` apart: always farther on a larger polygon; on a shorter cable where
    their legs converge (τ < 90°: polygons of five vertices or more), on a longer one where they
    diverge (triangles). The longer its leg, the farther a drone is from the edges at its vertex and
    from the other drone there, unless the pair rolls: its drones pass each other at a distance of
    the difference of their legs.
    """
    change = _leg_change(motion, check)
    return change and f"{change}, or allow a smaller {distance}"


def _leg_change(motion: Motion, check: Check) -> str:
    """Return the change of a cable's length, or of the polygon, that increases a distance."""
    layout = motion.team.layout
    all_drones = motion.team.drone_names
    all_cables = cable_names(motion)
    drones = [all_drones.index(name) for name in check.where if name in all_drones]
    cables = [all_cables.index(name) for name in check.where if name in all_cables]
    if len(check.where) != 2 or len(drones) + len(cables) != 2 or not drones:
        return ""
    drone = drones[0]
    cable = drone // 2
    other_cable = cables[0] if cables else drones[1] // 2
    if other_cable != cable:
        ends = layout.starts[other_cable], layout.ends[other_cable]
        vertices_of_other = ends if cables else (layout.anchors[drones[1]],)
        return LONGER_LEGS if layout.anchors[drone] in vertices_of_other else OTHER_LEGS
    if not np.all(layout.has_leg[cable]):
        return OTHER_LEGS
    time = float(np.clip(check.time, *motion.drones.breaks[[0, -1]]))
    places = motion.drones.at(time)
    vertices = motion.vertices.at(time)
    q = places[2 * cable]
    r = places[2 * cable + 1]
    start = vertices[layout.starts[cable]]
    end = vertices[layout.ends[cable]]
    if cables:
        far_leg = [end, r] if drone % 2 == 0 else [start, q]
        to_edge = shortest_offset(places[drone] - [start, end])
        to_leg = shortest_offset(places[drone] - far_leg)
        if np.linalg.norm(to_edge) <= np.linalg.norm(to_leg):
            return LONGER_LEGS
    spread = float((unit(r - end) - unit(q - start)) @ unit(end - start))
    if abs(spread) <= PARALLEL:
        return f"use {LARGER_POLYGON}"
    polygon = f" or {LARGER_POLYGON}" if motion.hold_at(time) is None else ""  # or the object's
    return f"use a {'shorter' if spread < 0.0 else 'longer'} cable{polygon}"


def _scaled_drones(
    drones: PiecewisePolynomial, names: Sequence[str], separation: Separation, size: float
) -> Moving:
    """Return all pairs of drones, scaled by ``Separation.scale``: ratios are distances.

    ``size`` is the largest coordinate [m].
    """
    scale = separation.scale
    margin = ROUNDING * size * float(np.max(scale))
    points = (drones.coefficients * scale[:, None])[:, :, None]
    return Moving(drones.breaks, points, margin=margin, names=(names, names))


def _pairs_of_drones(motion: Motion) -> tuple[Moving]:
    """Return all pairs of drones of a team, scaled by ``Separation.scale``."""
    names = motion.team.drone_names
    separation = motion.requirements.separation
    return (_scaled_drones(motion.drones, names, separation, magnitude(motion)),)


SEPARATION = CheckRule(
    "separation",
    "ratio",
    "min",
    lambda motion: (
        DISTANCES["separation"].limit(motion.requirements.separation)
        if motion.team.drones > 1
        else None
    ),
    (Evaluator(nearest(_pairs_of_drones, scaled=True), exported=True, formulas=(gap, distance)),),
    f"{OTHER_LEGS}, or allow a smaller separation.radius",
    "use longer cables or a larger polygon, or allow a smaller separation.radius",
    "length",
    start_remedy="place the drones farther apart, or allow a smaller separation.radius",
    remedy_at=partial(leg_remedy, distance="separation.radius"),
    group="distances",
    key="separation.radius",
    bodies=(("drones", "drones"),),
    proves="the minimum distance between two drones, 1 if their ellipsoids touch",
    unproven="that the ellipsoid is large enough for your drones",
)
"""The ellipsoids of drones do not intersect."""


CLOSENESS_SPANS = 48  # Default number of time spans
MAX_PAIRS = 12  # Maximum number of closest pairs


@dataclass(frozen=True)
class Closest(OneLine):
    """A lower bound of separation (ratio) from ``start`` to ``end`` [s].

    ``bound`` holds for all pairs in a time span, or for ``pair`` over the plan. The separation of
    ``pair`` is close to ``value`` at ``time`` [s].
    """

    start: float
    end: float
    bound: float
    value: float
    pair: tuple[str, str]
    time: float


@dataclass(frozen=True)
class Closeness(OneLine):
    """Time spans that cover the plan, and up to MAX_PAIRS closest pairs, closest first."""

    spans: tuple[Closest, ...]
    pairs: tuple[Closest, ...]

    def __str__(self) -> str:
        header = f"{'pair':16}  separation       when"
        rows = [
            f"{', '.join(closest.pair):16}  {closest.bound:10.5f}  {closest.time:7.3f} s"
            for closest in self.pairs
        ]
        return "\n".join([header, *rows])


def closeness(flight: Flight, spans: int = CLOSENESS_SPANS) -> Closeness:
    """Return the closest pairs of drones, for all t.

    Every bound holds on all of its span, rounding included, within 1e-4 of an attained value,
    relative.

    Parameters
    ----------
    flight: a flight of at least two drones.
    spans: number of equal time spans.

    Raises
    ------
    InputError: a single drone, or no span.
    """
    names = flight.team.drone_names
    if len(names) < 2:
        raise InputError("drones", len(names), "at least 2", "one drone has no neighbour")
    if spans < 1:
        raise InputError("spans", spans, "at least 1", "48 are usual")
    ends = np.linspace(flight.breaks[0], flight.breaks[-1], spans + 1)
    drones = on_breaks(flight.drones, merged_breaks([ends, flight.breaks]))
    separation = flight.requirements.separation
    all_pairs = _scaled_drones(drones, names, separation, flight_magnitude(flight))
    by_span = []
    for start, end in pairwise(ends.tolist()):
        first, last = np.searchsorted(drones.breaks, (start, end)).tolist()
        by_span.append(_closest(all_pairs.part(first, last), start, end))
    closest_first = sorted(by_span, key=_bound)
    pairs = []
    for pair in list(dict.fromkeys(span.pair for span in closest_first))[:MAX_PAIRS]:
        both = all_pairs.first[:, [names.index(name) for name in pair]]
        one_pair = replace(all_pairs, first=both, names=(pair, pair))
        pairs.append(_closest(one_pair, float(ends[0]), float(ends[-1])))
    return Closeness(tuple(by_span), tuple(sorted(pairs, key=_bound)))


def _closest(moving: Moving, start: float, end: float) -> Closest:
    """Return the closest one of some pairs of drones on a span of time [s]."""
    minimum = smallest(moving)
    first, second = moving.pair_names(minimum.item)
    return Closest(start, end, minimum.worst, minimum.value, (first, second), minimum.time)


def _bound(closest: Closest) -> float:
    """Return the bound of a separation, by which pairs are sorted."""
    return closest.bound
