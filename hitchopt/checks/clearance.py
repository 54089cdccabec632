"""What drones and cables keep off: checks ``cable_clearance``, ``keep_out``, ``object_clearance``.

Taut cables are straight. A cable that hangs between its drones is a catenary. Taking off and
landing, cables lie on the ground at least in part, in between their drones.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from hitchopt.checks.distances import (
    GROUND,
    Allowed,
    Flags,
    Ground,
    Moving,
    PairSpans,
    cable_ends,
    cable_names,
    gap,
    nearest,
    plan_points,
)
from hitchopt.checks.gripping import seen_from
from hitchopt.checks.hanging import TOLERANCE, above, cables_and_drones, cables_and_ground, cut
from hitchopt.checks.rule import CheckRule, Ease, Finder, Finding
from hitchopt.checks.solids import Solid, carried, from_above
from hitchopt.checks.spans import ROUNDING, magnitude, position_margin
from hitchopt.checks.story import phase_parts
from hitchopt.checks.tables import cable_parts
from hitchopt.motion.motion import FREE_STATES, HITCHED_STATE, CableState, HoldBy, Motion
from hitchopt.objects import Slab, SolidObject
from hitchopt.trajectory import bernstein
from hitchopt.trajectory.enclosed import Bound, Enclosed
from hitchopt.values import Array, Indices

CONTACT = 2e-5
"""[m] Cables that hold an object and are no closer to its body enter it."""


def _to_taut(motion: Motion, limit: float) -> Finding:
    """Return the smallest distance of a drone to any part of a foreign cable, or to its own edge.

    A drone at a chain's end stands on its own edge.
    """
    parts, on_leg = cable_parts(motion), motion.team.layout.has_leg.ravel()

    def strange(drones: Indices, bodies: Indices) -> Flags:
        part = parts.part[bodies]
        counted: Flags = (drones // 2 != part // 3) | ((part % 3 == 1) & on_leg[drones])
        return counted

    drones = motion.drones.elevated(bernstein.degree(parts.corners)).coefficients
    return _to_segments(motion, drones[:, :, None], parts.corners, parts.part // 3, strange, limit)


def _seen_from_above(motion: Motion, limit: float) -> Finding:
    """Return the smallest level distance of a drone to the chord of a cable not its own."""

    def foreign(drones: Indices, cables: Indices) -> Flags:
        apart: Flags = drones // 2 != cables
        return apart

    flat, cables = plan_points(motion), np.arange(motion.team.robots)
    return _to_segments(motion, flat, cable_ends(flat), cables, foreign, limit)


def _to_segments(
    motion: Motion, drones: Array, segments: Array, cables: Indices, allowed: Allowed, limit: float
) -> Finding:
    """Return the smallest distance; ``where`` names the drone and the cable."""
    names = motion.team.drone_names, [f"cable {k}" for k in cables]
    margin, breaks = position_margin(motion), motion.drones.breaks
    return nearest(motion, [Moving(breaks, drones, segments, margin, allowed, names=names)], limit)


def _to_hanging(motion: Motion, limit: float) -> Finding:
    """Return the smallest distance of a drone, or of the ground, to a hanging cable not its own.

    ``where`` names the drone (or ``ground``) and the cable. Each phase is searched on its own: a
    search stops within millimetres, so that what it finds depends on the span of time.
    """
    parts = [part.motion for part in phase_parts(motion)]
    each = (cables_and_drones, cables_and_ground)
    return nearest(motion, (cases(part) for part in parts for cases in each), limit)


CABLE_CLEARANCE = CheckRule(
    "cable_clearance",
    "m",
    "min",
    lambda motion: motion.requirements.separation.cable,
    (
        Finder(_to_taut, HITCHED_STATE, exported=True, shown=(gap,)),
        Finder(_seen_from_above, frozenset({CableState.GROUND}), exported=True),
        Finder(_to_hanging, FREE_STATES - {CableState.GROUND}, exported=True),
    ),
    "give the drones longer legs (a longer cable or a smaller polygon), "
    "other leg lengths, or a smaller separation.cable",
    "place the robots farther apart, use longer cables or more height, "
    "or allow a smaller separation.cable",
    Ease.LENGTH,
    far_remedy="use other leg lengths, another cable length or polygon, "
    "or a smaller separation.cable",
)
"""Drones, and the ground, stay off cables; drones as seen from above while these lie there."""


def _kept_out(motion: Motion, limit: float) -> Finding:
    """Return the smallest distance of any drone to a prism or an object, zero within.

    ``where`` names the drone, and the object where it is one.
    """
    return nearest(motion, _drones_past(motion), limit)


def _drones_past(motion: Motion) -> Iterator[Moving]:
    points, names = Enclosed(motion.drones.coefficients[:, :, None]), motion.team.drone_names
    for prism in motion.requirements.keep_out:
        yield _past(motion, points, prism.slab, names, "")
    for name, each, pose in _placed(motion):
        seen = seen_from(pose, points)
        yield from (_past(motion, seen, slab, names, name) for slab in each.slabs)


def _placed(motion: Motion) -> Iterator[tuple[str, SolidObject, Enclosed]]:
    """Yield the names of objects, these, and their poses (pieces,)."""
    poses = motion.object_poses.coefficients
    for index, (name, each) in enumerate(motion.requirements.objects.items()):
        yield name, each, Enclosed(poses[:, index])


def _past(
    motion: Motion, seen: Enclosed, slab: Slab, names: Sequence[str], name: str, **further: Any
) -> Moving:
    """Return what moves past a slab that has a name; ``further`` as in Moving."""
    margin = float(np.max(seen.r)) + ROUNDING * (magnitude(motion) + slab.size)
    given: dict[str, Any] = {"margin": margin, "names": (names, (name,))} | further
    return Moving.past(motion.drones.breaks, seen.c, Solid(slab), **given)


KEEP_OUT = CheckRule(
    "keep_out",
    "m",
    "min",
    lambda motion: (
        motion.requirements.separation.radius
        if motion.requirements.keep_out or motion.requirements.objects
        else None
    ),
    (Finder(_kept_out, exported=True, shown=(gap, Solid.towards)),),
    "move the keep-out volumes or objects, fly farther from them, or lower separation.radius",
)
"""Drones stay off prisms and objects, by the radius of their ellipsoids."""


def _objects_to_taut(motion: Motion, limit: float) -> Finding:
    """Return the smallest distance of a taut cable to an object that it does not hold.

    Or of an object that is carried to another one; zero where a cable enters what it holds, or the
    ground. ``where`` names the cable or object, and the object.
    """
    return nearest(motion, [*_taut_past(motion), *carried(motion)], limit)


def _taut_past(motion: Motion) -> Iterator[Moving]:
    parts, contact = cable_parts(motion), {"contact": CONTACT}
    cables, points = parts.part // 3, Enclosed(parts.corners)
    names = [f"cable {k}" for k in cables]
    # No part is lower than all of its ends, and bends of what is wrapped around an object.
    holding = np.array([phase.hold is not None for phase in motion.phases], dtype=np.bool_)
    on = np.append(holding, False)[motion.phase_of_piece]
    yield Moving.past(
        motion.drones.breaks,
        parts.corners,
        Ground(motion.requirements.floor - 2.0 * CONTACT),
        counted=np.repeat(on[:, None], len(parts), axis=1),
        names=(names, (GROUND,)),
        **contact,
    )
    for name, each, pose in _placed(motion):
        held, gripped = _holding(motion, name)
        counted, seen = ~held[:, cables], seen_from(pose, points)
        if each.stem is not None:  # what is below a flat tray is off it
            entering = (~gripped | (parts.part % 3 != 1)) & ~counted
            yield _past(motion, seen, each.slabs[0], names, name, counted=entering, **contact)
        for slab in each.slabs:
            yield _past(motion, seen, slab, names, name, counted=counted)


def _holding(motion: Motion, name: str) -> tuple[Flags, Flags]:
    """Return which cables may touch an object, since their phase holds it, (pieces, n).

    And whether it is gripped, (pieces, 1): else edges stay out of it by themselves.
    """
    index = motion.phase_of_piece
    held = np.zeros((motion.drones.pieces, motion.team.robots), dtype=np.bool_)
    gripped = np.zeros((motion.drones.pieces, 1), dtype=np.bool_)
    for i, phase in enumerate(motion.phases):
        if phase.hold is not None and phase.hold.object == name:
            held[np.ix_(index == i, list(phase.hold.cables))] = True
            gripped[index == i] = phase.hold.by is HoldBy.GRIP
    return held, gripped


def _objects_to_hanging(motion: Motion, limit: float) -> Finding:
    """Return the smallest distance of a hanging cable, or of one on the ground, to an object.

    From above, a cable is on its chord; a hanging one is above or below an object besides.
    """
    return nearest(motion, _hanging_past(motion), limit)


def _hanging_past(motion: Motion) -> Iterator[Moving]:
    for part in phase_parts(motion):
        drones = cut(part.motion.drones)
        ends = Enclosed(cable_ends(drones.coefficients))
        on_ground = part.phase.state is CableState.GROUND
        for name, each, pose in _placed(part.motion):  # nothing moves them: check support
            seen = seen_from(Enclosed(pose.c[:1, :, :1]), ends)
            for slab in each.slabs:
                yield Moving.past(
                    drones.breaks,
                    seen.c,
                    from_above(slab),
                    margin=float(np.max(seen.r)) + ROUNDING * (magnitude(motion) + slab.size),
                    lengths=motion.team.cable_length,
                    names=(cable_names(motion), (name,)),
                    formula=gap if on_ground else over(slab.upper),
                    tolerance=TOLERANCE,
                )


def over(top: float) -> Callable[[PairSpans], Bound]:
    """Return the formula of how far hanging cables are off a body, aside of it or above [m]."""

    def formula(spans: PairSpans) -> Bound:
        aside, higher = gap(spans), above(top)(spans)
        up = higher.value > aside.value
        return Bound(np.where(up, higher.value, aside.value), np.where(up, higher.x, aside.x))

    return formula


OBJECT_CLEARANCE = CheckRule(
    "object_clearance",
    "m",
    "min",
    lambda motion: motion.requirements.separation.object if motion.requirements.objects else None,
    (
        Finder(_objects_to_taut, HITCHED_STATE, exported=True, shown=(gap,)),
        Finder(_objects_to_hanging, FREE_STATES, exported=True, shown=(over,)),
    ),
    "fly higher over objects or farther from them, lift the held one higher, use shorter cables "
    "or stand it higher where the ground is near, or allow a smaller separation.object",
    "form and release farther from objects or higher above them, or allow a smaller "
    "separation.object",
    Ease.NOTHING,
)
"""Cables and held objects keep off objects.

Cables that hold an object come as close as they like, but not into it; where edges that grip are
wrapped, check ``grip`` says.
"""
