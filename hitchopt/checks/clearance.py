"""Clearances of drones and cables from other cables, prisms and objects.

Checks ``cable_clearance``, ``keep_out`` and ``object_clearance``.

Taut cables are straight. A cable that hangs between its drones is a catenary
(``hitchopt.checks.hanging``). During take-off and landing, cables lie at least partly on the
ground, between their drones.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from itertools import product
from operator import eq
from typing import Any

import numpy as np

from hitchopt.checks.bodies import (
    Bodies,
    cable_ends,
    cable_sheets,
    clasped_cables,
    drones_of,
    plan_points,
    taut_cables,
)
from hitchopt.checks.certificate import Check
from hitchopt.checks.distances import (
    GROUND,
    Flags,
    Ground,
    Moving,
    PairSpans,
    Shape,
    gap,
    nearest,
    upright_distance,
)
from hitchopt.checks.hanging import (
    CHAIN_TOLERANCE,
    cables_and_drones,
    cables_and_ground,
    chain_distance,
    drones_and_own_cables,
    lowered_ground,
)
from hitchopt.checks.objects import placed_corners
from hitchopt.checks.rule import CheckRule, Evaluator
from hitchopt.checks.separation import OTHER_LEGS, leg_remedy
from hitchopt.checks.solids import (
    PlacedObject,
    Solid,
    from_above,
    obstacles,
    pairs_with_shape,
    placed_objects,
)
from hitchopt.checks.spans import cable_names, phase_parts
from hitchopt.hitch.pairs import CABLE, DISTANCES, TautBodies
from hitchopt.motion.loads import RIM_CUT, RIM_REMEDY, held_pieces
from hitchopt.motion.motion import HoldBy, Motion
from hitchopt.objects import Slab, SolidObject
from hitchopt.objects.placing import CONTACT_GAP, REST_DRIFT, section_gap, surface_below
from hitchopt.trajectory.enclosed import Bound, Enclosed, largest_of
from hitchopt.values import Array, Indices


def _drones_and_taut(motion: Motion) -> Iterator[Moving]:
    """Yield pairs of drones and all parts of taut cables except the one that ends at the drone."""
    cables = taut_cables(motion)
    table = TautBodies.of(motion.team.layout)
    body = table.of_parts(cables.part)

    def foreign(drone: Indices, part: Indices) -> Flags:
        flags: Flags = table.kind(drone, body[part]) == CABLE
        return flags

    yield Moving.between(motion, drones_of(motion), cables, allowed=foreign)


def _drones_and_chords(motion: Motion) -> Iterator[Moving]:
    """Yield pairs of drones and the chords of other cables, projected from above."""
    level = plan_points(motion)
    drones = Bodies(level, motion.team.drone_names)
    chords = Bodies(cable_ends(level), cable_names(motion))
    yield Moving.between(motion, drones, chords, allowed=lambda drone, cable: drone // 2 != cable)


def _drones_and_hanging(motion: Motion) -> Iterator[Moving]:
    """Yield pairs of hanging cables and drones, those of other cables and their own, or the ground.

    Phases are searched separately: a search stops within millimetres, so its result depends on the
    time span.
    """
    for part in phase_parts(motion):
        yield cables_and_drones(part.motion)
        yield drones_and_own_cables(part.motion)
        yield from cables_and_ground(part.motion)


def _drones_and_clasped(motion: Motion) -> Iterator[Moving]:
    """Yield pairs of drones and other cables that are being clasped or tightened.

    A pair of drones that turns about a clasp passes through the regions of both its cables. These
    drones keep their distance to the cables as they hang between their drones.
    """
    layout = motion.team.layout
    turns = np.zeros((layout.robots, 2 * layout.robots), dtype=np.bool_)
    turns[layout.ahead, 2 * layout.behind + 1] = True
    turns[layout.behind, 2 * layout.ahead] = True
    clasped = [state for state in motion.cable_states if state.clasped]
    for state in sorted(clasped, key=str):
        excepted = turns if state.clasping else np.zeros_like(turns)

        def counts(cable: Indices, drone: Indices, excepted: Flags = excepted) -> Flags:
            return np.asarray((drone // 2 != cable) & ~excepted[cable, drone])

        regions = replace(clasped_cables(motion), pieces=motion.in_states(partial(eq, state)))
        exact = {"tolerance": None} if state.loose else {}
        yield Moving.between(motion, regions, drones_of(motion), allowed=counts, **exact)


def _loose_and_ground(motion: Motion) -> Iterator[Moving]:
    """Yield pairs of the regions of loose cables and the ground."""
    regions = clasped_cables(motion)
    points = Enclosed(regions.corners[:, :, regions.outline :])
    for ground in lowered_ground(motion):
        yield pairs_with_shape(motion, points, regions.names, GROUND, ground)


CABLE_CLEARANCE = CheckRule(
    "cable_clearance",
    "m",
    "min",
    lambda motion: DISTANCES["cable_clearance"].limit(motion.requirements.separation),
    (
        Evaluator(
            nearest(_drones_and_taut), lambda state: state.hitched, exported=True, formulas=(gap,)
        ),
        Evaluator(nearest(_drones_and_chords), lambda state: state.on_ground, exported=True),
        Evaluator(
            nearest(_drones_and_hanging),
            lambda state: state.hangs,
            exported=True,
            formulas=(chain_distance,),
        ),
        Evaluator(nearest(_loose_and_ground), lambda state: state.loose, exported=True),
        Evaluator(
            nearest(_drones_and_clasped),
            lambda state: state.has_cables,
            formulas=(upright_distance,),
        ),
    ),
    f"{OTHER_LEGS}, or allow a smaller separation.cable",
    "place the robots farther apart, use longer cables or more height, "
    "or allow a smaller separation.cable",
    "length",
    start_remedy="place the robots farther apart, or allow a smaller separation.cable",
    remedy_at=partial(leg_remedy, distance="separation.cable"),
    group="distances",
    key="separation.cable",
    bodies=(("drones", "cables"), ("cables", "ground")),
    proves="the minimum distance [m] of a drone to any cable part that does not end at it, and of "
    "hanging cables to the ground",
    unproven="how ropes swing, and touch while pairs swap",
)
"""Distance of cables from other drones and the ground; horizontal while they lie on it."""


def _drones_and_objects(motion: Motion, *, held: bool) -> Iterator[Moving]:
    """Yield pairs of drones and objects that can be ``held`` by cables, or cannot."""
    drones = drones_of(motion)
    points = Enclosed(drones.corners)
    for name, body, pose in placed_objects(motion):
        if (motion.team.has_cables and not body.fixed) is held:
            for slab in body.slabs:
                yield pairs_with_shape(motion, points, drones.names, name, Solid(slab), pose)


def _drones_and_standing(motion: Motion) -> Iterator[Moving]:
    """Yield pairs of drones and prisms, and of drones and objects that nothing can hold."""
    drones = drones_of(motion)
    points = Enclosed(drones.corners)
    for prism in motion.requirements.keep_out:
        yield pairs_with_shape(motion, points, drones.names, "", Solid(prism.slab))
    yield from _drones_and_objects(motion, held=False)


KEEP_OUT = CheckRule(
    "keep_out",
    "m",
    "min",
    lambda motion: (
        DISTANCES["keep_out"].limit(motion.requirements.separation) if obstacles(motion) else None
    ),
    (
        Evaluator(
            nearest(_drones_and_standing),
            exported=True,
            formulas=(gap, Solid.normals),
            bodies=(("drones", "objects"),),
        ),
        Evaluator(
            nearest(partial(_drones_and_objects, held=True)),
            exported=True,
            bodies=(("drones", "held"),),
        ),
    ),
    "move the keep-out volumes or objects, fly farther from them, or lower separation.radius",
    group="distances",
    key="separation.radius",
    bodies=(("drones", "objects"), ("drones", "held")),
    proves="the minimum distance [m] of a drone to an object, or of a single drone to a prism",
    unproven="prisms for hitches",
)
"""Distance of drones from prisms and objects: at least the radius of their ellipsoids.

Objects that can be held err with the vertices that hold them.
"""


EDGE = 1  # Kind of parts of cables that are edges, as in ``Layout.parts``.
ENTRY_DISTANCE = 2e-5  # [m] Holding cables that come closer to an object's body enter it


def entry(spans: PairSpans) -> Bound:
    """Return zero where bodies come closer than ENTRY_DISTANCE, else infinity."""
    distances = gap(spans)
    return Bound(np.where(distances.value < ENTRY_DISTANCE, 0.0, np.inf), distances.x)


def _taut_and_objects(motion: Motion) -> Iterator[Moving]:
    """Yield pairs of taut cables and objects that they do not hold.

    The distance is zero where a cable enters an object that it holds, or the ground, and where it
    cuts a rim that rests on it higher than RIM_CUT.
    """
    taut = taut_cables(motion)
    yield from _entered_ground(motion, taut)
    for placed in placed_objects(motion):
        is_holding = _holding_parts(motion, placed.name, taut.part)
        yield from _entered_object(motion, taut, placed, is_holding)
        for slab in placed.body.slabs:
            yield _pairs_with_cables(motion, taut, placed, Solid(slab), active=~is_holding)


def _entered_ground(motion: Motion, taut: Bodies) -> Iterator[Moving]:
    """Yield the pairs of the ground, if there is one, and cables while they hold an object.

    No part is lower than its ends and the bends of edges wrapped around an object.
    """
    floor = motion.requirements.floor
    if floor is None:
        return
    active = np.repeat(motion.holding[:, None], len(taut.part), axis=1)
    ground = Ground(floor - 2.0 * ENTRY_DISTANCE)
    points = Enclosed(taut.corners)
    yield pairs_with_shape(motion, points, taut.names, GROUND, ground, active=active, formula=entry)


def _holding_parts(motion: Motion, name: str, parts: Indices) -> Flags:
    """Return on which pieces parts of cables (parts,) hold an object (pieces, parts)."""
    holds = [phase.hold for phase in motion.phases]
    cables = [hold.cables if hold and hold.object == name else () for hold in holds]
    in_phase = np.array([np.isin(parts // 3, holding) for holding in [*cables, ()]])
    return np.asarray(in_phase[motion.phase_of_piece])


def _entered_object(
    motion: Motion, taut: Bodies, placed: PlacedObject, is_holding: Flags
) -> Iterator[Moving]:
    """Yield the pairs of parts of cables that hold an object, and parts of it not to be entered.

    - Legs must not enter a body that edges grip; edges touch it.
    - No part may enter the body below a rim that rests on cables; a flat tray is above them.
    - No part may enter the rim above edges that grip a body: it bears on no cable.
    - No part may be above a rim that rests on cables by more than RIM_CUT within its outline.
    """
    name, body, _ = placed
    is_gripping = held_pieces(motion, name, HoldBy.GRIP)[:, None] & is_holding
    not_in_body = is_gripping & (taut.part % 3 != EDGE)
    if body.stem is not None:
        not_in_body |= is_holding & ~is_gripping
    body_slab, *rim_slabs = body.slabs
    yield _pairs_with_cables(motion, taut, placed, Solid(body_slab), not_in_body, entry)
    for rim_slab in rim_slabs:
        is_bearing = held_pieces(motion, name, HoldBy.REST)[:, None] & is_holding
        height = rim_slab.upper + RIM_CUT
        cut = Solid(Slab(rim_slab.section, height, height))
        yield _pairs_with_cables(motion, taut, placed, Solid(rim_slab), is_gripping, entry)
        yield _pairs_with_cables(motion, taut, placed, cut, is_bearing, entry)


def _pairs_with_cables(
    motion: Motion,
    taut: Bodies,
    placed: PlacedObject,
    shape: Solid,
    active: Flags,
    formula: Callable[[PairSpans], Bound] = gap,
) -> Moving:
    """Return the pairs of taut cables, on the pieces (pieces, parts), and a part of an object."""
    points = Enclosed(taut.corners)
    name, _, pose = placed
    return pairs_with_shape(
        motion, points, taut.names, name, shape, pose, active=active, formula=formula
    )


def _hanging_and_objects(motion: Motion) -> Iterator[Moving]:
    """Yield pairs of cables that hang, or lie on the ground, and objects at rest.

    Horizontally, a cable is on its chord; a hanging one may also pass above an object.
    """
    for part in phase_parts(motion):
        is_on_chord = part.phase.state.on_ground
        cables = cables_and_drones(part.motion)
        ends = Enclosed(cables.first)
        options: dict[str, Any] = {
            "breaks": cables.breaks,
            "lengths": cables.lengths,
            "tolerance": CHAIN_TOLERANCE,
        }
        for name, body, pose in placed_objects(part.motion):
            at_rest = Enclosed(pose.c[:1, :, :1])
            for slab in body.slabs:
                formula = gap if is_on_chord else partial(beside_or_above, top=slab.upper)
                yield pairs_with_shape(
                    part.motion,
                    ends,
                    cables.names[0],
                    name,
                    from_above(slab),
                    at_rest,
                    formula=formula,
                    **options,
                )


def _clasped_and_objects(motion: Motion) -> Iterator[Moving]:
    """Yield pairs of objects and cables that are being clasped or tightened."""
    if not any(state.clasped for state in motion.cable_states):
        return
    names = cable_names(motion)
    sheets = cable_sheets(motion)
    prisms = Enclosed(sheets.prisms)
    active = np.repeat(sheets.clasped[:, None], len(names), axis=1)
    for name, body, pose in placed_objects(motion):
        for slab in body.slabs:
            shape = Solid(slab, rounding=0.0)
            yield pairs_with_shape(motion, prisms, names, name, shape, pose, active=active)


def moving_object_pairs(motion: Motion) -> Iterator[Moving]:
    """Yield pairs of moving objects and all others, and of moving objects and the ground.

    An object may touch the support that it leaves or approaches vertically (``_on_support``).
    """
    every = [*placed_objects(motion)]
    for placed in every:
        is_moving = np.any(_travel(placed) > REST_DRIFT, axis=-1)
        if not np.any(is_moving):
            continue
        for other in (*every, None):  # None is the ground
            if other is placed or (other is None and motion.requirements.floor is None):
                continue
            is_apart = is_moving & ~_on_support(motion, placed, other)
            yield from _pairs_of_objects(motion, placed, other, is_apart)


def _travel(placed: PlacedObject) -> Array:
    """Return the ranges (pieces, 5) of an object's x, y, z [m], cosine and sine of yaw."""
    return np.asarray(np.ptp(placed.pose.c, axis=-1))


def _on_support(motion: Motion, placed: PlacedObject, other: PlacedObject | None) -> Flags:
    """Return on which pieces an object may touch another one, or the ground (pieces,).

    These are runs of pieces on which it moves vertically, one of which begins or ends in contact,
    and the first run above the support on which it stands at the start.
    """
    floor = motion.requirements.ground_or(-math.inf)
    is_vertical = np.max(_travel(placed)[:, [0, 1, 3, 4]], axis=-1) <= CONTACT_GAP
    base = placed.pose.c[:, 2] + placed.body.lower
    heights = base - floor if other is None else base - other.pose.c[:, 2] - other.body.upper
    ends_touch = np.any(np.abs(heights[:, [0, -1]]) <= CONTACT_GAP, axis=1)
    touches = is_vertical & ends_touch
    if other is not None and np.any(touches):
        poses = placed.pose.c[touches, :, 0]
        other_poses = other.pose.c[touches, :, 0]
        touches[touches] = _stand_on(placed.body, other.body, poses, other_poses)
    places = motion.poses.coefficients[0, :, :, 0]
    _, first_support = surface_below(motion.requirements.objects, places, placed.name, floor)
    stands_on_it = first_support == (None if other is None else other.name)
    runs = np.cumsum(~is_vertical)
    may_touch = np.isin(runs, runs[touches]) | ((runs == 0) & stands_on_it)
    is_above = np.min(heights, axis=1) >= -CONTACT_GAP
    return np.asarray(may_touch & is_vertical & is_above)


def _stand_on(body: SolidObject, other: SolidObject, poses: Array, other_poses: Array) -> Flags:
    """Return for which poses (k, 5) the base of a body is, in plan, on the top of another one."""
    base = [slab.section for slab in body.slabs if slab.lower == body.lower]
    top = [slab.section for slab in other.slabs if slab.upper == other.upper]
    both = np.stack([poses, other_poses], axis=1)
    both[:, :, 2] = 0.0  # heights do not matter
    cases, index = np.unique(both, axis=0, return_inverse=True)
    overlap = list[bool]()
    for pose, other_pose in cases:
        gaps = [section_gap(lower, pose, upper, other_pose) for lower, upper in product(base, top)]
        overlap.append(min(gaps) < 0.0)
    return np.array(overlap)[index.ravel()]


def _pairs_of_objects(
    motion: Motion, placed: PlacedObject, other: PlacedObject | None, active: Flags
) -> Iterator[Moving]:
    """Yield the pairs of an object, on some pieces (pieces,), and another one, or the ground."""
    name, body, pose = placed
    for slab in body.slabs:
        corners = placed_corners(pose, slab)
        shapes: list[Shape] = [Ground(motion.requirements.ground_or(-math.inf))]
        if other is not None:
            rounding = slab.section.rounding
            shapes = [Solid(other_slab, rounding) for other_slab in other.body.slabs]
        for shape in shapes:
            yield pairs_with_shape(
                motion,
                corners,
                (name,),
                GROUND if other is None else other.name,
                shape,
                None if other is None else other.pose,
                active=active[:, None],
            )


def beside_or_above(spans: PairSpans, top: float) -> Bound:
    """Return the distance of hanging cables from a body, horizontal or above it [m]."""
    return largest_of([gap(spans), chain_distance(spans, Ground(top))])


def _rim_remedy(motion: Motion, check: Check) -> str:
    """Return what to do about legs that cut a rim which rests on them; empty for others."""
    hold = motion.hold_at(check.time)
    is_rest = hold is not None and hold.by is HoldBy.REST and hold.object in check.where
    is_holding = any(name in check.where for name in cable_names(motion))
    return RIM_REMEDY if check.worst == 0.0 and is_rest and is_holding else ""


OBJECT_CLEARANCE = CheckRule(
    "object_clearance",
    "m",
    "min",
    lambda motion: (
        DISTANCES["object_clearance"].limit(motion.requirements.separation)
        if motion.requirements.objects
        else None
    ),
    (
        Evaluator(
            nearest(_taut_and_objects), lambda state: state.hitched, exported=True, formulas=(gap,)
        ),
        Evaluator(nearest(moving_object_pairs), lambda state: state.hitched),
        Evaluator(
            nearest(_hanging_and_objects),
            lambda state: state.slack,
            exported=True,
            formulas=(beside_or_above,),
        ),
        Evaluator(nearest(_clasped_and_objects), lambda state: state.has_cables),
    ),
    "fly higher over objects or farther away, lift the held one higher, use shorter cables, place "
    "it higher, or allow a smaller separation.object",
    "form and release farther from objects or higher above them, or allow a smaller "
    "separation.object",
    remedy_at=_rim_remedy,
    group="distances",
    key="separation.object",
    bodies=(("cables", "objects"), ("held", "objects"), ("held", "ground")),
    proves="the minimum distance [m] of a cable to an object that it does not hold, and of a "
    "carried object to others and the ground",
    unproven="distances of holding cables, which may touch",
)
"""Distance of cables and held objects from other objects.

Cables may touch an object that they hold, but not enter it; the check ``grip`` verifies wrapped
edges.
"""
