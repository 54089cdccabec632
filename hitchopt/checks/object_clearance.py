"""Check ``object_clearance``: cables and held objects keep off objects.

Taut cables are straight. One that hangs lies in the plane of its chord, or on the ground below it.
Cables that hold an object come as close as they like, but not into it; where edges that grip are
wrapped, check ``grip`` says.
"""

from __future__ import annotations

import math
from functools import partial

import numpy as np
from numpy.typing import NDArray

from hitchopt.checks.bounds.bodies import cable_parts
from hitchopt.checks.bounds.cable_states import phase_parts
from hitchopt.checks.bounds.hanging_links import chains, cut
from hitchopt.checks.bounds.object_frames import seen_from
from hitchopt.checks.bounds.rounding_margins import ROUNDING, magnitude
from hitchopt.checks.bounds.slab_distance import nearest, smallest_gap
from hitchopt.checks.bounds.solid_gaps import TALL, carried_gap, taut_gap_to_ground
from hitchopt.checks.certificate import within
from hitchopt.checks.rule import CheckRule, Ease, Finder, Finding
from hitchopt.motion.motion import CableState, Motion
from hitchopt.motion.phases import FREE_STATES, HITCHED_STATE, HoldBy
from hitchopt.objects import Slab
from hitchopt.trajectory import bernstein
from hitchopt.trajectory.extremum import Cells, Estimate, Search
from hitchopt.values import Array

NOTHING = Finding(math.inf, 0.0)
"""Stands for the distance of what is not there."""

CONTACT = 2e-5
"""[m] Cables that hold an object and are no closer to its body enter it."""

TOLERANCE = 1e-3
"""[m] How closely the distance of a hanging cable is found: its links are off by that much."""


def _to_taut(motion: Motion, limit: float) -> Finding:
    """Return the smallest distance of a taut cable to an object that it does not hold.

    Or of an object that is carried to another one; zero where a cable enters what it holds, or the
    ground.
    ``where`` names the cable or object, and the object.
    """
    ground = taut_gap_to_ground(motion)
    if ground.worst < -CONTACT:
        return Finding(0.0, ground.time, ground.where, magnitude(motion))
    parts = cable_parts(motion)
    cables = parts.part // 3
    breaks, size = motion.drones.breaks, magnitude(motion)
    aim = within(limit, "min", size, 0.5)
    best, poses = carried_gap(motion), motion.object_poses.coefficients
    for index, (name, each) in enumerate(motion.requirements.objects.items()):
        counted = ~_holding(motion, name)[:, cables]
        seen = seen_from(poses[:, index], parts.corners)
        body, outside = each.slabs[0], _beside(motion, name) | (parts.part % 3 != 1)
        margin = seen.error + ROUNDING * (size + body.size)
        aimed = 2.0 * CONTACT
        entered = (
            outside & ~counted & (each.stem is not None)
        )  # what is below a flat tray is off it
        found = smallest_gap(breaks, seen.points, body, margin, aimed, entered)
        if found.worst < CONTACT < best.worst:
            best = Finding(0.0, found.time, (f"cable {cables[found.item]}", name), size)
        for slab in each.slabs:
            margin = seen.error + ROUNDING * (size + slab.size)
            found = smallest_gap(breaks, seen.points, slab, margin, aim, counted)
            if found.worst < best.worst:
                cable = f"cable {cables[found.item]}"
                best = Finding(found.worst, found.time, (cable, name), size)
    return best


def _holding(motion: Motion, name: str) -> NDArray[np.bool_]:
    """Return (pieces, n) which cables may touch an object, since their phase holds it."""
    index = motion.phase_of_piece
    held = np.zeros((motion.drones.pieces, motion.team.robots), dtype=np.bool_)
    for i, phase in enumerate(motion.phases):
        if phase.hold is not None and phase.hold.object == name:
            held[np.ix_(index == i, list(phase.hold.cables))] = True
    return held


def _beside(motion: Motion, name: str) -> NDArray[np.bool_]:
    """Return (pieces, 1) where edges stay out of an object by themselves: where none grips it."""
    gripping = [
        phase.hold is not None and phase.hold.object == name and phase.hold.by is HoldBy.GRIP
        for phase in motion.phases
    ]
    found: NDArray[np.bool_] = ~np.array(gripping)[motion.phase_of_piece][:, None]
    return found


def _to_hanging(motion: Motion, _: float) -> Finding:
    """Return the smallest distance of a hanging cable, or of one on the ground, to an object.

    From above, a cable is on its chord; a hanging one is above or below an object besides.
    """
    best = NOTHING
    for part in phase_parts(motion):
        hanging = part.phase.state is not CableState.GROUND
        drones = cut(part.motion.drones)
        c = drones.coefficients
        ends = np.stack([c[:, 0::2], c[:, 1::2]], axis=2)
        poses = part.motion.object_poses.coefficients  # nothing moves them: check support
        lengths = np.broadcast_to(
            motion.team.cable_length[:, None, None], (len(c), motion.team.robots, 1, 1)
        )
        for index, (name, each) in enumerate(motion.requirements.objects.items()):
            seen = seen_from(poses[:1, index, :, :1], ends)
            rows = seen.points.reshape(*seen.points.shape[:2], 6, -1)
            for slab in each.slabs:
                margin = seen.error + ROUNDING * (magnitude(motion) + slab.size)
                search = Search(
                    partial(_bound, slab=slab, hanging=hanging),
                    relative=TOLERANCE,
                    absolute=TOLERANCE,
                    known=best.worst,
                )
                search.add(Cells.over(drones.breaks, [rows, lengths], margin))
                found = search.finish()
                if found.item >= 0 and found.worst < best.worst:
                    where = (f"cable {found.item}", name)
                    best = Finding(max(found.worst, 0.0), found.time, where, magnitude(motion))
    return best


def _bound(blocks: tuple[Array, ...], slab: Slab, hanging: bool) -> Estimate:
    """Bound the distance of cables to a body from below: rows of q, r; lengths."""
    rows, length = blocks
    ends = rows.reshape(len(rows), 2, 3, -1)
    half = bernstein.basis(np.array(0.5), bernstein.degree(rows))
    tall = Slab(slab.section, -TALL, TALL)  # the chord is compared as seen from above
    flat = ends * np.array([1.0, 1.0, 0.0])[:, None]
    _, towards = nearest(flat @ half, tall)
    apart = np.einsum("md,mkdi->mki", towards[:, :2], ends[:, :, :2])
    bound = np.min(apart, axis=(1, 2)) - slab.section.support(towards[:, :2])
    value = np.min(apart @ half, axis=1) - slab.section.support(towards[:, :2])
    if hanging:
        hung = chains(ends[:, 0], ends[:, 1], length[:, 0, 0])
        heights = hung.points[:, :, 2]
        off, bend = np.max(hung.off, axis=1), np.max(hung.bend, axis=1)
        bound = np.maximum(bound, np.min(heights, axis=(1, 2)) - off - slab.upper)
        value = np.maximum(value, np.min(heights @ half, axis=1) - bend - slab.upper)
    return Estimate(np.maximum(bound, 0.0), np.maximum(value, 0.0), np.full(len(rows), 0.5))


def _limit(motion: Motion) -> float | None:
    requirements = motion.requirements
    return requirements.separation.object if requirements.objects else None


RULE = CheckRule(
    "object_clearance",
    "m",
    "min",
    _limit,
    (
        Finder(_to_taut, HITCHED_STATE, exported=True),
        Finder(_to_hanging, FREE_STATES, exported=True),
    ),
    "fly higher over objects or farther from them, lift the held one higher, use shorter cables "
    "or stand it higher where the ground is near, or allow a smaller separation.object",
    "form and release farther from objects or higher above them, or allow a smaller "
    "separation.object",
    Ease.NOTHING,
)
