"""Distances between the teams of a flight, and between them and external plans.

Each team is certified alone (``certify``). Between teams, the same distances apply as within one:
checks ``separation``, ``cable_clearance``, ``crossing``, ``keep_out`` and ``object_clearance``; and
``downwash``, which concerns drones above another team only. Two teams are compared on their common
breaks, in runs of pieces on which neither ties nor unties its hitch; they are at rest before and
after their motions.

Cables without a hitch stay within vertical regions (``checks.bodies``). The distance of such a
region is the larger of its horizontal distance and its difference in height.

Where tracking errors are larger vertically than horizontally, all heights are divided by their
ratio (``Requirements.height_ratio``): errors are then within a ball, and no distance is longer.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from hitchopt.checks.bodies import (
    Bodies,
    CableSheets,
    cable_sheets,
    drones_of,
    taut_cables,
    taut_parts,
)
from hitchopt.checks.certificate import Check
from hitchopt.checks.distances import Moving, Shape, nearest_of
from hitchopt.checks.downwash import below, half_axes, moves, pairs_with_object
from hitchopt.checks.objects import placed_corners
from hitchopt.checks.rule import CheckRule, WorstCase, largest_error
from hitchopt.checks.solids import PlacedObject, Solid, from_above, pairs_with_shape, placed_objects
from hitchopt.checks.spans import ROUNDING, cable_names, cached, flight_magnitude, magnitude
from hitchopt.checks.tracking import downwash_radius, slack_rules, touching_radius
from hitchopt.hitch.pairs import DISTANCES, DistanceRule
from hitchopt.hitch.requirements import Requirements, Separation
from hitchopt.motion.flight import Flight, TeamMotion, moved_objects, same_object
from hitchopt.motion.motion import CLASPED_STATES, CableState, Motion
from hitchopt.motion.retiming import on_breaks_of, padded
from hitchopt.objects import Slab
from hitchopt.objects.placing import REST_DRIFT
from hitchopt.trajectory.enclosed import Bound, Enclosed
from hitchopt.trajectory.piecewise import merged_breaks
from hitchopt.values import Array

LAID = frozenset({CableState.LAYING})


@dataclass(frozen=True, eq=False)
class Side:
    """A team on a run of pieces, and the regions of its cables while it has no hitch."""

    flown: TeamMotion
    """The team's motion on these pieces."""

    sheets: CableSheets | None
    """Regions of its cables; None without cables."""

    carried: frozenset[str]
    """Names of the objects that it moves at any time."""

    @property
    def motion(self) -> Motion:
        """The team's motion."""
        return self.flown.motion

    @property
    def drones(self) -> Bodies:
        """The team's drones."""
        return drones_of(self.motion).labelled(self.flown.label)


@dataclass(frozen=True, eq=False)
class Run:
    """Two teams on common pieces on which each has a hitch or none, and their distances."""

    first: Side
    """One of the teams."""

    second: Side
    """The other one."""

    separation: Separation
    """Distances of the flight."""

    @property
    def both(self) -> tuple[tuple[Side, Side], ...]:
        """Both orders of the two teams."""
        return (self.first, self.second), (self.second, self.first)

    @property
    def margin(self) -> float:
        """Rounding error of differences of positions [m]."""
        return ROUNDING * (magnitude(self.first.motion) + magnitude(self.second.motion))

    def moving(self, first: Bodies, second: Bodies, **options: Any) -> Moving:
        """Return the pairs of bodies of the first and the second team."""
        options = {"margin": self.margin} | options
        return Moving.between(self.first.motion, first, second, **options)

    def around(
        self,
        points: Array | Enclosed,
        names: Sequence[str],
        label: str,
        shape: Solid,
        pose: Enclosed,
    ) -> Moving:
        """Return the pairs of bodies of one team and a shape that moves with a pose."""
        points = points if isinstance(points, Enclosed) else Enclosed(points)
        margin = self.margin + ROUNDING * shape.slab.size
        return pairs_with_shape(self.first.motion, points, names, label, shape, pose, margin=margin)


@cached
def runs(flight: Flight) -> tuple[Run, ...]:
    """Return the runs of all pairs of teams, at least one of them the flight's own."""
    all_runs = list[Run]()
    for index, first in enumerate(flight.teams):
        for second in flight.all_teams[index + 1 :]:
            all_runs += _runs(first, second, flight.requirements.separation)
    return tuple(all_runs)


def _runs(first: TeamMotion, second: TeamMotion, separation: Separation) -> Iterator[Run]:
    """Yield the runs of two teams."""
    teams = first, second
    ends = np.array([flown.motion.drones.breaks[[0, -1]] for flown in teams])
    begin = float(np.min(ends))
    end = float(np.max(ends))
    at_rest_besides = [padded(flown.motion, begin, end) for flown in teams]
    breaks = merged_breaks([motion.drones.breaks for motion in at_rest_besides])
    motions = [on_breaks_of(motion, breaks) for motion in at_rest_besides]
    tied = [motion.formed for motion in motions]
    clasped = [motion.in_states(CLASPED_STATES) for motion in motions]
    states = np.array([*tied, *clasped])
    changes = np.flatnonzero(np.any(states[:, 1:] != states[:, :-1], axis=0)) + 1
    sheets = [cable_sheets(motion) if motion.team.has_cables else None for motion in motions]

    def side(index: int, start: int, stop: int) -> Side:
        """Return one of the teams on a run of pieces."""
        motion = motions[index]
        cables = sheets[index]
        pieces = slice(start, stop)
        phases = motion.overlapping(breaks[start], breaks[stop])
        flown = replace(teams[index], motion=motion.slice_pieces(pieces, phases))
        return Side(flown, cables and cables.on(pieces), moved_objects(motion))

    for start, stop in pairwise([0, *changes.tolist(), len(breaks) - 1]):
        yield Run(side(0, start, stop), side(1, start, stop), separation)


def cables_of(side: Side, *, parts: bool = False) -> Bodies | None:
    """Return a team's cables, with names of taut parts if ``parts``; None for single drones."""
    motion = side.motion
    sheets = side.sheets
    if sheets is None:
        return None
    if not motion.formed[0]:
        cables = Bodies(sheets.corners, cable_names(motion), sheets.outline)
    elif parts:
        cables = taut_parts(motion)
    else:
        cables = taut_cables(motion)
    return cables.labelled(side.flown.label)


def drone_pairs(run: Run) -> Iterator[Moving]:
    """Yield the pairs of drones, scaled for separation."""
    scale = run.separation.scale
    first = run.first.drones.scaled(scale)
    second = run.second.drones.scaled(scale)
    yield run.moving(first, second, margin=run.margin * float(np.max(scale)))


def drones_and_cables(run: Run) -> Iterator[Moving]:
    """Yield the pairs of drones of one team and cables of the other."""
    for one, other in run.both:
        cables = cables_of(other)
        if cables is not None:
            yield run.moving(one.drones, cables)


def cable_pairs(run: Run) -> Iterator[Moving]:
    """Yield the pairs of cables."""
    first = cables_of(run.first, parts=True)
    second = cables_of(run.second, parts=True)
    if first is not None and second is not None:
        yield run.moving(first, second)


def _objects(one: Side, other: Side) -> Iterator[PlacedObject]:
    """Yield the objects of one team that are not obstacles of the other."""
    obstacles = other.motion.requirements.objects
    for placed in placed_objects(one.motion):
        name, body, pose = placed
        is_moving = np.max(np.abs(pose.c - body.pose[:, None])) > REST_DRIFT
        if is_moving or name not in obstacles or not same_object(body, obstacles[name]):
            yield placed


class PlacedSlab(NamedTuple):
    """A slab of an object."""

    name: str
    """Name of the object."""

    slab: Slab
    """The slab, in the object's frame."""

    pose: Enclosed
    """(pieces,) x, y, z [m], cosine and sine of yaw of the object."""


def _slabs(one: Side, other: Side) -> Iterator[PlacedSlab]:
    """Yield the slabs of the objects of one team that are not obstacles of the other."""
    for name, body, pose in _objects(one, other):
        for slab in body.slabs:
            yield PlacedSlab(name, slab, pose)


def drones_and_objects(run: Run) -> Iterator[Moving]:
    """Yield the pairs of drones of one team and objects of the other."""
    for one, other in run.both:
        drones = one.drones
        for name, slab, pose in _slabs(other, one):
            yield run.around(drones.corners, drones.names, name, Solid(slab), pose)


def taut_or_laid(side: Side) -> Bodies | None:
    """Return the cables of a team that are under tension: parts, or strips while they are laid."""
    cables = cables_of(side, parts=True)
    if cables is None or not cables.outline:
        return cables
    is_laid = side.motion.in_states(LAID)
    return replace(cables, outline=0, pieces=is_laid) if np.any(is_laid) else None


def drones_above_cables(
    run: Run,
    scale: Array | None = None,
    *,
    formula: Callable[..., Bound] = below,
    shape: Callable[[Slab | None], Shape] | None = None,
) -> Iterator[Moving]:
    """Yield the pairs of drones of one team and taut cables of the other, in scaled coordinates.

    Options are those of ``pairs_with_slab``; the shape is that without a slab. By default,
    ellipsoids have the radius 1.
    """
    scale = half_axes(run.separation) if scale is None else scale
    for one, other in run.both:
        cables = taut_or_laid(other)
        if cables is not None:
            options: dict[str, Any] = {} if shape is None else {"shape": shape(None)}
            yield run.moving(
                one.drones.scaled(scale),
                cables.scaled(scale),
                margin=run.margin * float(np.max(scale)),
                formula=formula,
                **options,
            )


def drones_above_objects(run: Run, scale: Array | None = None, **options: Any) -> Iterator[Moving]:
    """Yield the pairs of drones of one team and objects of the other that they would move.

    Coordinates and options are those of ``drones_above_cables``.
    """
    scale = half_axes(run.separation) if scale is None else scale
    for one, other in run.both:
        for placed in _objects(other, one):
            if placed.name in other.carried or moves(placed.body, one.motion.team):
                yield from pairs_with_object(
                    one.motion, one.drones, placed, scale, margin=run.margin, **options
                )


def cables_and_objects(run: Run) -> Iterator[Moving]:
    """Yield the pairs of cables of one team and objects of the other."""
    for one, other in run.both:
        cables = cables_of(one)
        if cables is not None:
            for placed in _slabs(other, one):
                yield _cables_and_slab(run, one, cables, placed)


def object_pairs(run: Run) -> Iterator[Moving]:
    """Yield the pairs of objects."""
    for name, slab, pose in _slabs(run.second, run.first):
        for other_name, other_slab, other_pose in _slabs(run.first, run.second):
            corners = placed_corners(other_pose, other_slab)
            solid = Solid(slab, rounding=other_slab.section.rounding)
            yield run.around(corners, (other_name,), name, solid, pose)


def _cables_and_slab(run: Run, side: Side, cables: Bodies, placed: PlacedSlab) -> Moving:
    """Return the pairs of cables of a team and a slab of the other one.

    The distance of cables that hang, lie or are laid is horizontal.
    """
    sheets = side.sheets
    if sheets is None or not cables.outline:
        corners = cables.corners
        shape = Solid(placed.slab)
    elif cables.outline == 2:
        corners = cables.corners[:, :, :2]  # chords
        shape = from_above(placed.slab)
    else:
        corners = sheets.prisms
        shape = Solid(placed.slab, rounding=0.0)
    return run.around(corners, cables.names, placed.name, shape, placed.pose)


PAIRS: dict[tuple[str, str], Callable[[Run], Iterator[Moving]]] = {
    ("drones", "drones"): drone_pairs,
    ("drones", "cables"): drones_and_cables,
    ("drones", "objects"): drones_and_objects,
    ("drones", "taut"): drones_above_cables,
    ("drones", "movable"): drones_above_objects,
    ("cables", "cables"): cable_pairs,
    ("cables", "objects"): cables_and_objects,
    ("objects", "objects"): object_pairs,
}
"""Pairs of bodies of two teams, by their kinds in DISTANCES."""


def pairs_between(flight: Flight, rule: DistanceRule) -> Iterator[Moving]:
    """Yield the pairs of bodies of all pairs of teams that keep a distance."""
    for run in runs(flight):
        for kinds in rule.kinds:
            yield from PAIRS[kinds](run)


def check_across(
    rule: CheckRule, flight: Flight, requirements: Requirements | None = None
) -> Check | None:
    """Return the check of a rule between teams; None if nothing is compared.

    ``requirements`` are the flight's own by default, or these with another ``height_ratio``.
    """
    if rule.name not in DISTANCES:
        return None
    requirements = requirements or flight.requirements
    between_teams = DISTANCES[rule.name]
    limit = between_teams.limit(requirements.separation)
    ratio = requirements.height_ratio if rule.unit == "m" else 1.0
    cases = (moving.flattened(ratio) for moving in pairs_between(flight, between_teams))
    closest = nearest_of(cases, limit, flight_magnitude(flight))
    return None if math.isinf(closest.worst) else closest.check(rule, limit)


def radius_across(
    flight: Flight,
    requirements: Requirements,
    between: Mapping[CheckRule, Check | None],
    gamma: float,
) -> WorstCase:
    """Return the largest tracking error with which teams keep their distances [m].

    Heights are divided by the ``height_ratio`` of the requirements, also in the checks ``between``
    teams.
    """
    error = largest_error(gamma)
    terms = [WorstCase(math.inf, 0.0)]
    for rule in slack_rules(between):
        check = between[rule]
        if check is not None and rule.name in DISTANCES:
            slack = max(check.worst - check.number, 0.0)
            radius = slack / DISTANCES[rule.name].approach(error)
            terms.append(WorstCase(radius, check.time, check.where, binding=rule.name))

    def above(scale: Array, **options: Any) -> Iterator[Moving]:
        """Yield what is below drones of all pairs of teams."""
        for run in runs(flight):
            yield from drones_above_cables(run, scale, **options)
            yield from drones_above_objects(run, scale, **options)

    terms.append(downwash_radius(above, requirements, DISTANCES["downwash"].approach(error)))
    tightest = min(terms, key=lambda term: term.worst)
    for run in runs(flight):
        pairs = run.moving(run.first.drones, run.second.drones)
        tightest = touching_radius(pairs, requirements, tightest)
    return replace(tightest, worst=tightest.worst * (1.0 - ROUNDING))
