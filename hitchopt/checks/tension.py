"""Check ``tension``: cables pull as hard as the team or the step says, and nothing jumps."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from hitchopt.checks.bounds.friction_range import angles_at, wrapped, wrapping_vectors
from hitchopt.checks.bounds.rounding_margins import ROUNDING, position_margin
from hitchopt.checks.bounds.thrust_enclosure import NO_DIRECTION, thrust_cells, thrust_from
from hitchopt.checks.rule import CheckRule, Finder, Finding
from hitchopt.geometry.vectors import length
from hitchopt.motion.motion import Motion
from hitchopt.motion.phases import FREE_STATES, HITCHED_STATE
from hitchopt.motion.tensions import ranged_phases, stated_tensions
from hitchopt.trajectory import bernstein
from hitchopt.trajectory.extremum import Cells, Estimate, largest
from hitchopt.values import Array

Mask = NDArray[np.bool_]

LIMIT = 1e-4
"""[N] A quarter of a thousandth of a usual tension, and far below what a drone could tell."""

STILL = 1e-9
"""[m] What stays within this of one place rests."""


def _find(motion: Motion, _: float) -> Finding:
    """Return the largest jump of a tension or thrust, or distance of a tension to its range [N].

    While the hitch exists every cable pulls with the team's tension, but for three ranges.

    - A range that the phase states (``Phase.tension``). It is part of the problem, as limits and
      the team's tension are: the plan's file is believed in what was asked for, never in whether it
      is kept. It holds within its phase only; at both of the phase's ends tensions are the team's,
      except from one phase to the next while an object is held.
    - A ramp, in which a tension is from 0 to the team's. No file names it: it is next to a span of
      time without a hitch, nothing moves in it, and it ends where the tension comes to the team's,
      which it has to.
    - Legs pull with up to ``e^{μ θ}`` times the range's upper end, and down to ``e^{-μ θ}`` times
      its lower one, for the angle θ that the cable wraps at its clasp.

    Jumps are those of tensions, of legs' pulls and of thrusts at all joints of pieces. Where there
    is no hitch tensions and pulls count as 0, whatever the plan says of them. ``where`` names the
    cable, or the drone whose leg or thrust it is.
    """
    found = [_jump_of_pulls(motion), _jump_of_thrusts(motion)]
    if np.any(motion.formed):
        found += [_outside(motion), _off_at_ends(motion)]
        found += [_pulls_outside(motion)] if motion.leg_tensions is not None else []
    return max(found, key=lambda each: each.worst)


def _named(motion: Motion, worst: float, time: float, item: int) -> Finding:
    """Return the finding with an item of the cables, then the drones, named."""
    if not worst > 0.0:
        return Finding(worst, time)
    cables = motion.team.robots
    where = (f"cable {item}" if item < cables else motion.team.drone_names[item - cables],)
    return Finding(worst, time, where)


def _jump_of_pulls(motion: Motion) -> Finding:
    """Return the largest jump of a cable's tension or of a leg's pull."""
    each = motion.tensions.coefficients[..., [0, -1]]
    if motion.leg_tensions is not None:  # else they jump as their cables' tensions do
        each = np.concatenate([each, motion.pulls.coefficients[..., [0, -1]]], axis=1)
    left, right = np.moveaxis(np.where(motion.formed[:, None, None], each, 0.0), -1, 0)
    jumps = np.abs(left[1:] - right[:-1])
    jumps += ROUNDING * (np.abs(left[1:]) + np.abs(right[:-1]))
    return _largest_jump(motion, jumps, 0)


def _jump_of_thrusts(motion: Motion) -> Finding:
    """Return the largest jump of a drone's thrust, by its norm."""
    if motion.drones.pieces == 1:
        return _largest_jump(motion, np.zeros((0, 1)), 0)
    drones = 2 * motion.team.robots
    blocks = thrust_cells(motion).blocks
    noise = position_margin(motion)
    ends, slop = [], []
    for end in (0, -1):
        there = thrust_from([block[..., end] for block in blocks])
        legs = length(blocks[1][..., end])
        turned = 2.0 * noise / np.maximum(legs, NO_DIRECTION) * np.abs(blocks[2][:, 0, end])
        ends.append(there.vectors.reshape(-1, drones, 3))
        slop.append((there.pull + turned + blocks[3][:, 0, 0]).reshape(-1, drones))
    jumps = length(ends[0][1:] - ends[1][:-1]) + slop[0][1:] + slop[1][:-1]
    return _largest_jump(motion, jumps, motion.team.robots)


def _largest_jump(motion: Motion, jumps: Array, first: int) -> Finding:
    """Return the largest of jumps (pieces - 1, items), whose first item has the name ``first``."""
    if jumps.size == 0:
        return _named(motion, 0.0, float(motion.drones.breaks[0]), 0)
    joint, item = np.unravel_index(int(np.argmax(jumps)), jumps.shape)
    time = float(motion.drones.breaks[joint + 1])
    return _named(motion, float(jumps[joint, item]), time, first + int(item))


def _outside(motion: Motion) -> Finding:
    """Return how far a cable's tension is outside of its range at most."""
    tension = motion.tensions.coefficients
    blocks = [tension[:, :, None], _ranges(motion)[..., None]]
    return _farthest(motion, blocks, 0)


def _pulls_outside(motion: Motion) -> Finding:
    """Return how far a leg's pull is outside of what friction makes of the range at most."""
    pulls = motion.pulls.coefficients
    ranges = np.repeat(_ranges(motion), 2, axis=1)
    blocks = [pulls[:, :, None], ranges[..., None], wrapping_vectors(motion)]
    return _farthest(motion, blocks, motion.team.robots)


def _farthest(motion: Motion, blocks: list[Array], first: int) -> Finding:
    margin = ROUNDING * np.max(np.abs(blocks[0]))
    cells = Cells.over(motion.drones.breaks, blocks, margin)
    if not np.all(motion.formed):
        cells = cells.take(np.repeat(motion.formed, blocks[0].shape[1]))
    friction, noise = motion.team.cable_friction, position_margin(motion)
    bound = partial(_bound, friction=friction, noise=noise)
    found = largest(cells, bound)
    return _named(motion, found.worst, found.time, first + found.item)


def _bound(blocks: tuple[Array, ...], friction: float, noise: float) -> Estimate:
    pull, (least, most) = blocks[0][:, 0], np.moveaxis(blocks[1][..., 0], -1, 0)
    held = there = np.ones(len(pull))
    x = np.full(len(pull), 0.5)
    if len(blocks) > 2:
        held = np.exp(friction * wrapped(blocks[2], noise))
        there = np.exp(friction * angles_at(blocks[2], x))
    else:
        beyond = np.maximum(pull - most[:, None], least[:, None] - pull)
        x = np.argmax(beyond, axis=-1) / max(1, bernstein.degree(pull))
    over = np.maximum(np.max(pull, axis=-1) - most * held, least / held - np.min(pull, axis=-1))
    here = bernstein.evaluate(pull, x)
    value = np.maximum(here - most * there, least / there - here)
    return Estimate(np.maximum(over, 0.0), np.maximum(value, 0.0), x)


def _ranges(motion: Motion) -> Array:
    """Return (pieces, n, 2) [N] the range of every cable's tension, those of ramps from 0."""
    ranges = stated_tensions(motion)
    if not np.all(motion.formed):  # else there is no ramp, as it is next to a span without a hitch
        ranges[..., 0] = np.where(_ramps(motion), 0.0, ranges[..., 0])
    return ranges


def _off_at_ends(motion: Motion) -> Finding:
    """Return how far tensions are from the team's where phases that state a range begin or end.

    Not where an object is held before and after, as if on before and after the motion: the range is
    that of a grasp, which its steps share.
    """
    if all(phase.tension is None for phase in motion.phases):
        return _named(motion, 0.0, float(motion.drones.breaks[0]), 0)
    index = np.concatenate([[-1], ranged_phases(motion), [-1]])
    if np.all(index < 0):
        return _named(motion, 0.0, float(motion.drones.breaks[0]), 0)
    held = [phase.hold is not None for phase in motion.phases] or [False]
    holding = np.array(held)[motion.phase_of_piece]
    holding = np.concatenate([holding[:1], holding, holding[-1:]])
    c, team = motion.tensions.coefficients, motion.team.tension
    off = np.zeros((motion.drones.pieces + 1, motion.team.robots))
    for end, other, shift in ((0, slice(0, -2), 0), (-1, slice(2, None), 1)):
        changes = (index[1:-1] != index[other]) & (index[1:-1] >= 0) & motion.formed
        changes &= ~(holding[1:-1] & holding[other])
        joints = np.flatnonzero(changes) + shift
        off[joints] = np.maximum(off[joints], np.abs(c[changes][..., end] - team))
    joint, cable = np.unravel_index(int(np.argmax(off)), off.shape)
    return _named(motion, float(off[joint, cable]), float(motion.drones.breaks[joint]), int(cable))


def _ramps(motion: Motion) -> Mask:
    """Return (pieces, n) where tensions rise after, or fall before, a span without a hitch."""
    resting = motion.formed
    for part in (motion.drones, motion.vertices):
        resting = resting & (np.max(np.ptp(part.coefficients, axis=-1), axis=(1, 2)) <= STILL)
    c = motion.tensions.coefficients
    full = motion.team.tension[:, None] - c[..., [0, -1]] <= LIMIT
    free = ~motion.formed
    up = _rising(free, resting, full)
    return up | _rising(free[::-1], resting[::-1], full[::-1, :, ::-1])[::-1]


def _rising(free: Mask, resting: Mask, full: Mask) -> Mask:
    """Return (pieces, n) the pieces at rest from one without a hitch to the team's tension.

    Parameters
    ----------
    free, resting: (pieces,) without a hitch; with one, and nothing moves.
    full: (pieces, n, 2), whether the team's tension is reached where a piece begins and ends.
    """
    begins = resting & np.concatenate([[False], free[:-1]])
    begun, stopped = _latest(begins[:, None]), _latest(~resting[:, None] | full[..., 0])
    reached = _latest(full[::-1, :, 1])[::-1]
    left = _latest(~resting[::-1, None])[::-1]
    return (begun > stopped) & (reached > left)


def _latest(mask: Mask) -> NDArray[np.intp]:
    """Return (pieces, …) the index of the latest piece so far for which the mask holds, or -1."""
    pieces = np.arange(len(mask))[:, None]
    return np.maximum.accumulate(np.where(mask, pieces, -1), axis=0)


RULE = CheckRule(
    "tension", "N", "max", LIMIT, (Finder(_find, FREE_STATES | HITCHED_STATE),), whole=True
)
