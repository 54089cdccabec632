"""Distances between the teams of a flight, and between them and external plans.

Each team is certified alone (``certify``). Between teams, the same distances apply as within one:
checks ``separation``, ``cable_clearance``, ``crossing``, ``keep_out`` and ``object_clearance``; and
``downwash``, which concerns drones above another team only. Two teams are compared on their common
breaks, in runs of pieces on which the cables of each are taut or not; they are at rest before and
after their motions.

Cables without tension stay within vertical regions (``checks.bodies``). The distance of such a
region is the larger of its horizontal distance and its difference in height. Taut cables are
straight, but for their arcs around an object that they grip: these are on its section, at one
height, as the check ``grip`` verifies.

Where tracking errors are larger vertically than horizontally, all heights are divided by their
ratio (``Requirements.height_ratio``): errors are then within a ball, and no distance is longer.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from hitchopt.checks.bodies import (
    Bodies,
    CableSheets,
    Flags,
    cable_sheets,
    drones_of,
    taut_cables,
    taut_parts,
)
from hitchopt.checks.certificate import Check
from hitchopt.checks.distances import Moving, Shape, nearest_of
from hitchopt.checks.downwash import (
    below,
    half_axes,
    moves,
    pairs_with_object,
    pairs_with_slab,
)
from hitchopt.checks.grips import WRAP_GAP, gripped_objects
from hitchopt.checks.objects import placed_corners
from hitchopt.checks.rule import CheckRule, WorstCase, largest_error
from hitchopt.checks.solids import PlacedObject, Solid, from_above, pairs_with_shape, placed_objects
from hitchopt.checks.spans import ROUNDING, cable_names, cached, flight_magnitude, magnitude
from hitchopt.checks.tracking import downwash_radius, slack_rules, touching_radius
from hitchopt.hitch.pairs import DISTANCES, DistanceRule
from hitchopt.hitch.requirements import Requirements, Separation
from hitchopt.motion.flight import Flight, TeamMotion, moved_objects, same_object
from hitchopt.motion.motion import Motion
from hitchopt.motion.retiming import on_breaks_of, padded
from hitchopt.objects import Slab
from hitchopt.objects.placing import REST_DRIFT
from hitchopt.trajectory.bernstein import same_degree
from hitchopt.trajectory.enclosed import Bound, Enclosed
from hitchopt.trajectory.piecewise import merged_breaks
from hitchopt.values import Array, true_runs


@dataclass(frozen=True, eq=False)
class Side:
    """A team on a run of pieces, and the regions of its cables while these are not taut."""

    flown: TeamMotion  # The team's motion on these pieces
    sheets: CableSheets | None  # Regions of its cables; None without cables
    carried: frozenset[str]  # Names of the objects that it moves at any time

    @property
    def motion(self) -> Motion:
        """The team's motion."""
        return self.flown.motion

    @property
    def drones(self) -> Bodies:
        """The team's drones."""
        return drones_of(self.motion).labelled(self.flown.label)

    @property
    def is_taut(self) -> bool:
        """Whether its cables consist of taut parts."""
        return bool(self.motion.formed[0])


@dataclass(frozen=True, eq=False)
class Run:
    """Two teams on common pieces on which the cables of each are taut or not, and distances."""

    first: Side  # One of the teams
    second: Side  # The other one
    separation: Separation  # Distances of the flight

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
        pieces: Flags,
    ) -> Moving:
        """Return the pairs of bodies of one team and a shape that moves with a pose, on pieces."""
        points = points if isinstance(points, Enclosed) else Enclosed(points)
        margin = self.margin + ROUNDING * shape.slab.size
        active = np.repeat(pieces[:, None], len(names), axis=1)
        motion = self.first.motion
        return pairs_with_shape(
            motion, points, names, label, shape, pose, margin=margin, active=active
        )


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
    taut = [motion.formed for motion in motions]
    clasped = [motion.in_states(lambda state: state.clasped) for motion in motions]
    states = np.array([*taut, *clasped])
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
    if not side.is_taut:
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
        yield from _drones_and_slabs(run, one, arcs_of(other))


def cable_pairs(run: Run) -> Iterator[Moving]:
    """Yield the pairs of cables."""
    first = cables_of(run.first, parts=True)
    second = cables_of(run.second, parts=True)
    if first is not None and second is not None:
        yield run.moving(first, second)
    for one, other in run.both:
        yield from _cables_and_slabs(run, one, arcs_of(other))
    yield from _slab_pairs(run, [*arcs_of(run.first)], arcs_of(run.second))


def _objects(one: Side, other: Side) -> Iterator[PlacedObject]:
    """Yield the objects of one team that are not obstacles of the other."""
    obstacles = other.motion.requirements.objects
    for placed in placed_objects(one.motion):
        name, body, pose = placed
        is_moving = np.max(np.abs(pose.c - body.pose[:, None])) > REST_DRIFT
        if is_moving or name not in obstacles or not same_object(body, obstacles[name]):
            yield placed


class PlacedSlab(NamedTuple):
    """A slab of an object, or that on which cables bend around it."""

    name: str  # Name of the object
    slab: Slab  # The slab, in the object's frame
    pose: Enclosed  # (pieces,) x, y, z [m], cosine and sine of yaw of the object
    pieces: Flags  # (pieces,), on which it is compared


def _slabs(one: Side, other: Side) -> Iterator[PlacedSlab]:
    """Yield the slabs of the objects of one team that are not obstacles of the other."""
    always = np.ones(one.motion.drones.pieces, np.bool_)
    for name, body, pose in _objects(one, other):
        for slab in body.slabs:
            yield PlacedSlab(name, slab, pose, always)


def drones_and_objects(run: Run) -> Iterator[Moving]:
    """Yield the pairs of drones of one team and objects of the other."""
    for one, other in run.both:
        yield from _drones_and_slabs(run, one, _slabs(other, one))


def arcs_of(side: Side) -> Iterator[PlacedSlab]:
    """Yield the sections that contain the arcs of a team's cables around objects that they grip.

    They are between the lowest and the highest contact with the object, which are as high if the
    check ``grip`` holds.
    """
    motion = side.motion
    for index, name, pieces in gripped_objects(motion):
        heights, base = same_degree(
            motion.contacts.coefficients[:, :, :, 2],
            motion.poses.coefficients[:, index, None, None, 2],
        )
        section = motion.requirements.objects[name].section.widened(WRAP_GAP)
        pose = Enclosed(motion.poses.coefficients[:, index])
        for first, last in true_runs(pieces):
            of_contacts = (heights - base)[first:last]
            slab = Slab(section, float(np.min(of_contacts)), float(np.max(of_contacts)))
            in_run = np.isin(np.arange(len(pieces)), np.arange(first, last))
            yield PlacedSlab(name, slab, pose, in_run)


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
        cables = cables_of(other, parts=True)
        if cables is not None and not cables.outline:
            options: dict[str, Any] = {} if shape is None else {"shape": shape(None)}
            yield run.moving(
                one.drones.scaled(scale),
                cables.scaled(scale),
                margin=run.margin * float(np.max(scale)),
                formula=formula,
                **options,
            )
        drones = one.drones
        for name, slab, pose, pieces in arcs_of(other):
            yield pairs_with_slab(
                drones.corners,
                pose,
                slab,
                scale,
                breaks=one.motion.drones.breaks,
                names=(drones.names, (name,)),
                margin=run.margin,
                active=np.repeat(pieces[:, None], len(drones.names), axis=1),
                formula=formula,
                shape=shape or Solid,
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
        yield from _cables_and_slabs(run, one, _slabs(other, one))
        yield from _slab_pairs(run, [*arcs_of(one)], _slabs(other, one))


def object_pairs(run: Run) -> Iterator[Moving]:
    """Yield the pairs of objects."""
    yield from _slab_pairs(run, [*_slabs(run.first, run.second)], _slabs(run.second, run.first))


def _drones_and_slabs(run: Run, side: Side, slabs: Iterable[PlacedSlab]) -> Iterator[Moving]:
    """Yield the pairs of drones of a team and slabs of the other one."""
    drones = side.drones
    for name, slab, pose, pieces in slabs:
        yield run.around(drones.corners, drones.names, name, Solid(slab), pose, pieces)


def _cables_and_slabs(run: Run, side: Side, slabs: Iterable[PlacedSlab]) -> Iterator[Moving]:
    """Yield the pairs of cables of a team, if it has any, and slabs of the other one.

    The distance of cables that hang, lie or are laid is horizontal.
    """
    cables = cables_of(side)
    if cables is None:
        return
    sheets = side.sheets
    for name, slab, pose, pieces in slabs:
        if sheets is None or not cables.outline:
            corners = cables.corners
            shape = Solid(slab)
        elif cables.outline == 2:
            corners = cables.corners[:, :, :2]  # chords
            shape = from_above(slab)
        else:
            corners = sheets.prisms
            shape = Solid(slab, rounding=0.0)
        yield run.around(corners, cables.names, name, shape, pose, pieces)


def _slab_pairs(
    run: Run, slabs: Sequence[PlacedSlab], others: Iterable[PlacedSlab]
) -> Iterator[Moving]:
    """Yield the pairs of slabs of a team and slabs of the other one."""
    for other in others:
        for name, slab, pose, pieces in slabs:
            yield run.around(
                placed_corners(pose, slab),
                (name,),
                other.name,
                Solid(other.slab, rounding=slab.section.rounding),
                other.pose,
                pieces & other.pieces,
            )


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
