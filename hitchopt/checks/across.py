"""Distances between several groups of one plan, and between them and plans that fly besides.

Each group keeps its own limits alone (``certify``). Across, the same distances count that its own
drones, cables and objects keep: checks ``separation``, ``cable_clearance``, ``crossing``,
``keep_out`` and ``object_clearance``. Two groups are compared on their common breaks, one run of
pieces at a time on which neither ties or unties its hitch, at rest before and after their motions.

A cable that hangs, or lies, stays within the upright sheet below its chord, down to where a cable
that hung straight down from both drones would end. Such a sheet is compared from above, where it is
its chord, and by height: bodies are apart by the larger one of the two.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from hitchopt.checks.certificate import Check
from hitchopt.checks.clearance import CHAIN_TOLERANCE, Solid, from_above
from hitchopt.checks.distances import (
    TOUCHING,
    Moving,
    aside,
    nearest,
    smallest,
    taut_strips,
)
from hitchopt.checks.joining import lowered_over
from hitchopt.checks.objects import placed, seen_from
from hitchopt.checks.rule import CheckRule, WorstCase
from hitchopt.checks.spans import ROUNDING, cable_names, cable_parts, cached, magnitude, part_names
from hitchopt.checks.tracking import Ellipsoid
from hitchopt.hitch.requirements import Separation
from hitchopt.motion.combined import same_object
from hitchopt.motion.motion import CableState, Group, Motion
from hitchopt.motion.retiming import on_breaks_of, padded
from hitchopt.objects import SolidObject
from hitchopt.objects.placing import STILL
from hitchopt.trajectory import bernstein
from hitchopt.trajectory.enclosed import Enclosed
from hitchopt.trajectory.piecewise import merged_breaks
from hitchopt.values import Array


@dataclass(frozen=True, eq=False)
class Run:
    """Two groups on common pieces on which each has a hitch, or none; ``scale`` of separation."""

    first: Group
    second: Group
    scale: Array

    @property
    def both(self) -> tuple[tuple[Group, Group], ...]:
        """Each group with the other one."""
        return (self.first, self.second), (self.second, self.first)

    @property
    def margin(self) -> float:
        """Rounding error of differences of positions [m]."""
        return ROUNDING * (magnitude(self.first.motion) + magnitude(self.second.motion))

    def moving(self, first: Bodies, second: Bodies, **options: object) -> Moving:
        """Return the pairs of bodies of one group and of the other one."""
        order = max(bernstein.degree(first.corners), bernstein.degree(second.corners))
        a, b = (bernstein.elevate(each.corners, order) for each in (first, second))
        if first.upright or second.upright:
            options = {"formula": aside, "tolerance": CHAIN_TOLERANCE} | options
        values = {"margin": self.margin, "names": (first.names, second.names)} | options
        return Moving(self.first.motion.drones.breaks, a, b, **values)  # type: ignore[arg-type]


@dataclass(frozen=True, eq=False)
class Bodies:
    """Bodies of a group: corners (pieces, bodies, k, 3, degree + 1) [m], names, whether upright."""

    corners: Array
    names: tuple[str, ...]
    upright: bool = False


@cached
def runs(motion: Motion) -> tuple[Run, ...]:
    """Return the runs of all pairs of groups of which one at least is the motion's own."""
    groups, scale = motion.flying, motion.requirements.separation.scale
    own, found = len(motion.groups), list[Run]()
    for i in range(own):
        for j in range(i + 1, len(groups)):
            found += _runs(groups[i], groups[j], scale)
    return tuple(found)


def _runs(first: Group, second: Group, scale: Array) -> Iterator[Run]:
    ends = np.array([each.motion.drones.breaks[[0, -1]] for each in (first, second)])
    begin, end = float(np.min(ends)), float(np.max(ends))
    both = [padded(each.motion, begin, end) for each in (first, second)]
    breaks = merged_breaks([each.drones.breaks for each in both])
    one, other = (on_breaks_of(each, breaks) for each in both)
    taut = frozenset({CableState.LAYING})
    kinds = [each.formed + 2 * each.in_states(taut) for each in (one, other)]
    changes = np.flatnonzero(np.diff(3 * kinds[0] + kinds[1])) + 1
    edges = [0, *changes.tolist(), len(breaks) - 1]
    for start, stop in pairwise(edges):
        a, b = (
            each.slice_pieces(slice(start, stop), each.overlapping(breaks[start], breaks[stop]))
            for each in (one, other)
        )
        yield Run(replace(first, motion=a), replace(second, motion=b), scale)


def drones_of(group: Group) -> Bodies:
    """Return its drones."""
    names = tuple(map(group.label, group.motion.team.drone_names))
    return Bodies(group.motion.drones.coefficients[:, :, None], names)


def cables_of(group: Group, *, parts: bool = False) -> Bodies | None:
    """Return its cables, the straight ``parts`` of taut ones by their names; None without any."""
    motion = group.motion
    if not motion.team.has_cables:
        return None
    if motion.formed[0]:
        corners, part = cable_parts(motion)
        whole = cable_names(motion)
        named = part_names(motion, part) if parts else [whole[k // 3] for k in part.tolist()]
        return Bodies(corners, tuple(map(group.label, named)))
    if CableState.LAYING in motion.cable_states:
        return Bodies(taut_strips(motion), tuple(map(group.label, cable_names(motion))), True)
    q, r = motion.drones.coefficients[:, 0::2], motion.drones.coefficients[:, 1::2]
    lowest = 0.5 * (q + r)
    lowest[:, :, 2] -= 0.5 * motion.team.cable_length[:, None]
    names = tuple(map(group.label, cable_names(motion)))
    return Bodies(np.stack([q, r, lowest], axis=2), names, upright=True)


def separated(run: Run) -> Iterator[Moving]:
    """Yield the pairs of drones, every axis times the scale of separation."""
    bodies = (drones_of(each) for each in (run.first, run.second))
    first, second = (replace(each, corners=each.corners * run.scale[:, None]) for each in bodies)
    yield run.moving(first, second, margin=run.margin * float(np.max(run.scale)))


def past_cables(run: Run) -> Iterator[Moving]:
    """Yield the pairs of drones of one group and cables of the other one."""
    for one, other in run.both:
        if (cables := cables_of(other)) is not None:
            yield run.moving(drones_of(one), cables)


def crossings(run: Run) -> Iterator[Moving]:
    """Yield the pairs of cables.

    Edges on which a robot's taut cable comes straight down are no pairs with it then: they are
    compared as it joins (``checks.joining``).
    """
    first, second = (cables_of(each, parts=True) for each in (run.first, run.second))
    if first is None or second is None:
        return
    one, other = run.first.motion, run.second.motion
    counted = np.ones(first.corners.shape[:2], dtype=np.bool_)
    if other.team.robots == 1 and one.formed[0]:
        part = cable_parts(one)[1]
        for each in lowered_over(one, other):
            counted[each.pieces, np.isin(part, 3 * each.edges + 1)] = False
    yield run.moving(first, second, counted=None if np.all(counted) else counted)


def _objects(one: Group, other: Group) -> Iterator[tuple[str, SolidObject, Enclosed]]:
    """Yield the objects of one group that are not obstacles of the other one, and their poses."""
    shared = other.motion.requirements.objects
    for index, (name, body) in enumerate(one.motion.requirements.objects.items()):
        pose = one.motion.object_poses.coefficients[:, index]
        away = np.max(np.abs(pose - body.pose[:, None])) > STILL  # where the other looks for it
        if away or name not in shared or not same_object(body, shared[name]):
            yield name, body, Enclosed(pose)


def past_objects(run: Run) -> Iterator[Moving]:
    """Yield the pairs of drones of one group and objects of the other one."""
    for one, other in run.both:
        drones = drones_of(one)
        for name, body, pose in _objects(other, one):
            for slab in body.slabs:
                yield _beside(run, drones, name, Solid(slab), pose)


def around_objects(run: Run) -> Iterator[Moving]:
    """Yield the pairs of objects of one group, and cables and objects of the other one.

    Hanging cables keep off objects as seen from above.
    """
    for one, other in run.both:
        for name, body, pose in _objects(other, one):
            for slab in body.slabs:
                if (cables := cables_of(one)) is not None:
                    if cables.upright:
                        cables = replace(cables, corners=cables.corners[:, :, :2])
                    shape = from_above(slab) if cables.upright else Solid(slab)
                    yield _beside(run, cables, name, shape, pose)
                if one is run.first:
                    for label, its, there in _objects(one, other):
                        for block in its.slabs:
                            seen = placed(there, block)
                            bodies = Bodies(seen.c, (label,))
                            solid = Solid(slab, block.section.rounding)
                            yield _beside(run, bodies, name, solid, pose, float(np.max(seen.r)))


def _beside(
    run: Run, bodies: Bodies, label: str, shape: Solid, pose: Enclosed, error: float = 0.0
) -> Moving:
    """Return the pairs of bodies and a shape that moves with a pose."""
    seen = seen_from(pose, Enclosed(bodies.corners))
    margin = run.margin + ROUNDING * shape.slab.size + float(np.max(seen.r)) + error
    return Moving(
        run.first.motion.drones.breaks,
        seen.c,
        np.zeros((len(seen.c), 1, 1, 3, 1)),
        margin=margin,
        shape=shape,
        names=(bodies.names, (label,)),
    )


ACROSS: dict[str, tuple[Callable[[Run], Iterable[Moving]], Callable[[Separation], float]]] = {
    "separation": (separated, lambda _: 1.0),
    "cable_clearance": (past_cables, lambda s: max(s.cable, TOUCHING)),
    "crossing": (crossings, lambda s: max(s.crossing, TOUCHING)),
    "keep_out": (past_objects, lambda s: s.radius),
    "object_clearance": (around_objects, lambda s: max(s.object, TOUCHING)),
}
"""The pairs across and their distances, by the checks that they belong to."""

CLOSER: dict[str, Callable[[float], float]] = {
    "cable_clearance": lambda most: 1.0 + most,
    "crossing": lambda most: 2.0 * most,
    "keep_out": lambda most: 1.0 + most,
    "object_clearance": lambda most: 2.0 * most,
}
"""How far bodies across come together per radius that drones are off, by the largest of 1 and γ."""


def check_across(rule: CheckRule, motion: Motion) -> Check | None:
    """Return the check of a rule between groups; None where nothing is compared."""
    if rule.name not in ACROSS:
        return None
    pairs, distance_of = ACROSS[rule.name]
    limit = distance_of(motion.requirements.separation)
    found = nearest(lambda whole: (each for run in runs(whole) for each in pairs(run)))
    worst = found(motion, limit)
    return None if math.isinf(worst.worst) else worst.check(rule, limit)


def radius_across(motion: Motion, checks: Iterable[Check | None], gamma: float) -> WorstCase:
    """Return by how much all drones may be off with every distance across kept [m]."""
    terms, most = [WorstCase(math.inf, 0.0)], max(1.0, gamma)
    for check in filter(None, checks):
        if check.name in CLOSER:
            left = max(check.bound - check.number, 0.0) / CLOSER[check.name](most)
            terms.append(WorstCase(left, check.time, check.where))
    least, shape = (
        min(terms, key=lambda term: term.worst),
        Ellipsoid(1.0 / motion.requirements.separation.scale),
    )
    for run in runs(motion):
        moving = run.moving(drones_of(run.first), drones_of(run.second), shape=shape)
        pair = smallest(moving, known=2.0 * least.worst)
        radius = max(0.5 * pair.worst, 0.0)
        if pair.item >= 0 and radius < least.worst:
            least = WorstCase(radius, pair.time, moving.named(pair.item))
    return replace(least, worst=least.worst * (1.0 - ROUNDING))
