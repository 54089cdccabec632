"""Several teams: distances of drones, cables and objects of two plans."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import product
from typing import NamedTuple

import numpy as np

from .arithmetic import BIG, Array, Index, Items, Line, Mask, elevate, maximum, minimum, runs_of
from .drones import moves
from .objects import body_gap
from .plan import WRAP_TOL, Plan
from .shapes import Slab, distance, prism_gap
from .spans import Row, Spans, prove

Corners = Sequence[Line]

DRONES = "drones"
TAUT = "taut"
HANGING = "hanging"
CLASPING = "clasping"
CONTACT_ERROR = 3.0 * WRAP_TOL
"""[m] Largest distance of contacts from a section that ``wrap`` allows."""

REGIONS = {HANGING, CLASPING}  # Cables without a hitch, which vertical regions contain


class Bodies(NamedTuple):
    """Drones of a plan, or its cables in one state."""

    kind: str
    pieces: Mask
    names: Sequence[str]
    corners: Callable[[Spans, Index], Corners]


class PlanObject(NamedTuple):
    """A convex section of an object of a plan, or the one on which its cables bend around it.

    Cables being clasped may be above its ``top`` [m], which is that of its object.
    """

    number: int
    slab: Slab
    top: float
    pieces: Mask
    names: Sequence[str]


class Pair(Plan):
    """Two plans on common breaks; a plan rests before its start and after its end.

    Items of its spans are pairs of items. Minimum distances are the largest of all teams.
    """

    erring_bodies = 2

    def __init__(
        self, p: Plan, q: Plan, separation: dict[str, float], tube: tuple[float, float]
    ) -> None:
        self.plans = (p, q)
        self.size = max(p.size, q.size)
        self.effort = p.effort
        self.breaks = np.unique(np.concatenate([p.breaks, q.breaks]))
        self.h = np.diff(self.breaks)
        self.set_distances(separation, tube)

    def spans(self, first: Bodies | PlanObject, second: Bodies | PlanObject) -> Spans:
        """Return spans of all pairs of a body of the first plan and one of the second plan."""
        middles = self.breaks[:-1] + 0.5 * self.h
        first_piece, second_piece = (piece_at(p, middles) for p in self.plans)
        both = first.pieces[first_piece] & second.pieces[second_piece]
        items = np.indices((len(first.names), len(second.names))).reshape(2, -1).T
        return Spans.of(self, both, items, first.names, second.names)

    def both(self, s: Spans) -> tuple[Spans, Spans]:
        """Return spans of each plan at the times of spans of the pair."""
        p, q = self.plans
        return at_times_of(s, p), at_times_of(s, q)


def piece_at(p: Plan, time: Array) -> Items:
    """Return the pieces of a plan at times (m,), the first or last one beyond its duration."""
    return np.clip(np.searchsorted(p.breaks, time) - 1, 0, len(p.h) - 1)


def at_times_of(s: Spans, p: Plan) -> Spans:
    """Return the spans of a plan at the times of spans of a pair of plans."""
    piece = piece_at(p, s.time)
    x = (s.time - p.breaks[piece]) / p.h[piece]
    spans = Spans(p, piece, s.item, np.clip(x, 0.0, 1.0), 0.0 * x)
    spans.t, spans.zero = s.t, s.zero
    spans.moving = np.asarray(1.0 * ((x > 0.0) & (x < 1.0)))
    return spans


def bodies_of(p: Plan) -> list[Bodies]:
    """Return drones and cables: segments, or what contains cables without a hitch."""
    hanging = p.free & ~p.clasping
    return [
        Bodies(DRONES, p.all_pieces, p.names, lambda s, i: [s.point(i)]),
        Bodies(TAUT, p.formed, p.segment_names, Spans.segment),
        Bodies(HANGING, hanging, p.cables, Spans.sheet),
        Bodies(CLASPING, p.clasping, p.cables, Spans.hull),
    ]


def between_plans(pair: Pair) -> Iterator[Row]:
    """Prove distances between drones and cables of two plans.

    Distances to vertical regions are horizontal or vertical ones.
    """
    p, q = pair.plans
    for first, second in product(bodies_of(p), bodies_of(q)):
        spans = pair.spans(first, second)
        kinds = {first.kind, second.kind}
        limit = pair.cable_limit if DRONES in kinds else pair.crossing_limit
        measure: Callable[[Corners, Corners], Line] = partial(distance, ratio=pair.ratio)
        if kinds == {DRONES}:
            limit = ("separation ratio min", 1.0)
            measure = partial(separation_ratio, pair)
        elif kinds & REGIONS:
            measure = partial(prism_gap, ratio=pair.ratio)
        yield prove(*limit, spans, between(pair, first, second, measure))
        if kinds == {DRONES, TAUT}:
            downwash = between(pair, first, second, partial(downwash_ratio, pair))
            yield prove("downwash ratio min", 1.0, spans, downwash)


def arc_distances(pair: Pair) -> Iterator[Row]:
    """Prove distances of drones, cables and objects of a plan to another plan's arcs of cables."""
    p, q = pair.plans
    drones = bodies_of(p)[0]
    for arc in arcs_of(q):
        for bodies in bodies_of(p):
            limit = pair.cable_limit if bodies.kind == DRONES else pair.crossing_limit
            yield prove(*limit, pair.spans(bodies, arc), from_object(pair, bodies, arc))
        yield prove("downwash ratio min", 1.0, pair.spans(drones, arc), object_downwash(pair, arc))
        for other in arcs_of(p):
            spans = pair.spans(other, arc)
            yield prove(*pair.crossing_limit, spans, between_objects(pair, other, arc))
        limit = pair.object_limit[0], pair.object_limit[1] + pair.tracking  # objects err too
        for carried in own_objects(p, q):
            spans = pair.spans(carried, arc)
            yield prove(*limit, spans, between_objects(pair, carried, arc))


def arcs_of(p: Plan) -> Iterator[PlanObject]:
    """Yield the sections around which cables of a plan bend, from lowest to highest contact.

    Cables touch the stem of an object that they grip, at one height while they do.
    """
    contacts = p.edges[1:3].ravel()
    for number, body in enumerate(p.bodies):
        for pieces in runs_of(p.grip[number]):
            heights = p.points.c[0][pieces][:, contacts, 2]
            bases = p.poses.c[0][pieces, number, None, 2]
            count = max(heights.shape[-1], bases.shape[-1])
            above_base = elevate(heights, count) - elevate(bases, count)
            low, high = float(np.min(above_base)), float(np.max(above_base))
            on = np.isin(np.arange(len(p.h)), pieces)
            yield PlanObject(
                number, body.stem.enlarged(CONTACT_ERROR, low, high), high, on, [body.name]
            )


def between(
    pair: Pair, first: Bodies, second: Bodies, measure: Callable[[Corners, Corners], Line]
) -> Callable[[Spans, Index, Index], Line]:
    """Return the formula of a measure of the corners of two bodies, i and j of their plans."""

    def formula(s: Spans, i: Index, j: Index) -> Line:
        first_spans, second_spans = pair.both(s)
        return measure(first.corners(first_spans, i), second.corners(second_spans, j))

    return formula


def separation_ratio(pair: Pair, first: Corners, second: Corners) -> Line:
    """Return the distance of two drones over that at which their ellipsoids touch."""
    return ((first[0] - second[0]) * pair.scale).norm()


def downwash_ratio(pair: Pair, first: Corners, second: Corners) -> Line:
    """Return the distance over half an ellipsoid, large for cables above the drone.

    The distance of a point from a strip is that of the chord above from the points up to the
    strip's depth over that point.
    """
    drone, cable = (first[0], second) if len(first) == 1 else (second[0], first)
    drone = drone * pair.wash
    cable = [corner * pair.wash for corner in cable]
    rise = minimum(*(corner[2] for corner in cable)) - drone[2] - pair.wash_lead
    start, end, *below = cable
    points = [drone, drone + (start - below[0])] if below else [drone]
    return distance(points, [start, end]).unless(rise)


def object_distances(pair: Pair) -> Iterator[Row]:
    """Prove distances of drones, cables and objects of a plan to another plan's own objects."""
    p, q = pair.plans
    drones = bodies_of(p)[0]
    cable_limit = pair.object_limit[0], pair.object_limit[1] + pair.tracking  # objects err too
    drone_limit = "keep_out m min", pair.sep["radius"] + pair.tracking
    for obstacle in own_objects(q, p):
        for bodies in bodies_of(p):
            limit = drone_limit if bodies.kind == DRONES else cable_limit
            yield prove(*limit, pair.spans(bodies, obstacle), from_object(pair, bodies, obstacle))
        if np.any(q.moving[obstacle.number]) or moves(p, q.bodies[obstacle.number]):
            spans = pair.spans(drones, obstacle)
            yield prove("downwash ratio min", 1.0, spans, object_downwash(pair, obstacle))
        for carried in own_objects(p, q):
            spans = pair.spans(carried, obstacle)
            yield prove(*cable_limit, spans, between_objects(pair, carried, obstacle))


def own_objects(p: Plan, q: Plan) -> Iterator[PlanObject]:
    """Yield the objects of a plan that it moves, or that another plan does not know as they are."""
    objects, other_objects = p.settings["objects"], q.settings["objects"]
    for number, slab in p.slabs:
        name = p.bodies[number].name
        if np.any(p.moving[number]) or objects[name] != other_objects.get(name):
            top = max(part.upper for part in p.bodies[number].slabs)
            yield PlanObject(number, slab, top, p.all_pieces, [name])


def from_object(
    pair: Pair, bodies: Bodies, obstacle: PlanObject
) -> Callable[[Spans, Index, Index], Line]:
    """Return the formula of the distance of bodies to an object of the other plan.

    It is horizontal for cables that are not taut. Cables being clasped may also be above the
    object's top.
    """
    slab = obstacle.slab
    column = slab.enlarged(0.0, -BIG, BIG)

    def formula(s: Spans, i: Index, _: Index) -> Line:
        spans, other_spans = pair.both(s)
        corners = [other_spans.local(obstacle.number, x) for x in bodies.corners(spans, i)]
        if bodies.kind in (DRONES, TAUT):
            return slab.gap(*corners, ratio=pair.ratio)
        if bodies.kind == HANGING:  # in the vertical plane through its ends
            start, end = corners[:2]
            return column.gap(start, end, ratio=pair.ratio)
        *outline, lowest = corners  # of what contains a cable being clasped
        height = (lowest[2] - obstacle.top) * (1.0 / pair.ratio)
        return maximum(column.gap(*outline, outline[0], ratio=pair.ratio), height)

    return formula


def object_downwash(pair: Pair, obstacle: PlanObject) -> Callable[[Spans, Index, Index], Line]:
    """Return the formula of the distance of an object over half an ellipsoid below a drone."""
    slab = obstacle.slab.scaled(pair.wash)

    def formula(s: Spans, i: Index, _: Index) -> Line:
        spans, other_spans = pair.both(s)
        drone = other_spans.local(obstacle.number, spans.point(i))
        return slab.below(drone * pair.wash, pair.wash_lead)

    return formula


def between_objects(
    pair: Pair, carried: PlanObject, obstacle: PlanObject
) -> Callable[[Spans, Index, Index], Line]:
    """Return the formula of the distance of an object of each plan."""

    def formula(s: Spans, _i: Index, _j: Index) -> Line:
        spans, other_spans = pair.both(s)
        first, second = (carried.number, carried.slab), (obstacle.number, obstacle.slab)
        return body_gap(spans, *first, other_spans, *second, pair.ratio)

    return formula
