"""The thrust that every drone needs, enclosed: what the checks thrust and tilt have in common.

It is ``m (a + g ẑ)`` less the cable's force, which is the pull of the leg (at a chain's end, of the
edge) toward its vertex, and half of its weight (see ``hitchopt.hitch.statics.cable_forces``).
Neither the direction nor the length of a leg is a polynomial; both are enclosed by
one. A cable that hangs free pulls inward by ``w s / 2σ``, and the higher end carries ``w h coth(σ)
/ 2`` more than half of it (w its weight per length; see ``hitchopt.hitch.catenary``): enclosed by
the range of its steepness σ. While a cable is drawn taut that part fades with its tautness, a
polynomial (see ``hitchopt.motion.tensions``).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from hitchopt.checks.bounds.bodies import pull_vectors
from hitchopt.checks.bounds.hanging_links import steepness_range
from hitchopt.checks.bounds.leg_directions import Directions, drone_directions
from hitchopt.checks.bounds.rounding_margins import ROUNDING, derivative_margin
from hitchopt.checks.bounds.shared_values import once
from hitchopt.geometry.vectors import length
from hitchopt.hitch import GRAVITY
from hitchopt.hitch.catenary import pull_terms
from hitchopt.motion.motion import Motion
from hitchopt.motion.tensions import chord_pulls, lowered, tautness
from hitchopt.trajectory import bernstein, enclosure
from hitchopt.trajectory.extremum import Cells
from hitchopt.values import Array, Indices

NO_DIRECTION = 1e-5
"""[m] A leg or an edge this short points anywhere: below it, rounding would say where."""


UNSCALED = (1, 5, 7)
"""Indices of the blocks that are lengths, not forces."""

_UPWARD = np.array([0.0, 0.0, 1.0])


def thrust_cells(motion: Motion, unit: Array | None = None, *, moving: bool = True) -> Cells:
    """Return one cell per piece and drone, with the blocks that ``thrust_enclosure`` takes.

    Parameters
    ----------
    unit: (drones,) [N], what each drone's forces are divided by; None for newtons.
    moving: with the drones' accelerations; without, the thrusts of hovering at every place.
    """
    if moving and unit is None:
        return once(motion, _moving_cells)
    blocks = list(once(motion, _blocks))
    if not moving:
        hover = np.zeros((*blocks[0].shape[:3], 1))
        hover[:, :, 2] = motion.team.mass[:, None] * GRAVITY
        slop = derivative_margin(motion.drones, 2) * motion.team.mass
        slop = slop + ROUNDING * (hover[:, :, 2, 0] + np.max(np.abs(blocks[2]), axis=(2, 3)))
        blocks[0], blocks[3] = hover, slop[:, :, None, None]
    if unit is not None:
        share = (1.0 / unit)[:, None, None]
        blocks = [block if i in UNSCALED else share * block for i, block in enumerate(blocks)]
    return Cells.over(motion.drones.breaks, blocks)


def _moving_cells(motion: Motion) -> Cells:
    """Return the cells of moving drones, in newtons."""
    return Cells.over(motion.drones.breaks, once(motion, _blocks))


def _blocks(motion: Motion) -> list[Array]:
    """Return the blocks of moving drones, in newtons."""
    mass = motion.team.mass[:, None]
    free = motion.drones.differentiated(2).coefficients * mass[..., None]
    free[:, :, 2] += mass * GRAVITY
    if motion.team.has_cables:
        legs = pull_vectors(motion)
        tension = lowered(chord_pulls(motion))
    else:  # no cable, no pull, whichever way it points
        legs = np.broadcast_to(np.eye(3)[2, :, None], (*free.shape[:3], 1))
        tension = np.zeros((*free.shape[:2], 1))
    slop = derivative_margin(motion.drones, 2) * mass[:, 0]
    slop += ROUNDING * (np.abs(free).max(axis=(-2, -1)) + np.abs(tension).max(axis=-1))
    blocks = [free, legs, tension[:, :, None], slop[:, :, None, None]]
    if motion.team.has_cables and motion.team.cable_density > 0.0:
        blocks += _weight_blocks(motion)
    return blocks


def _weight_blocks(motion: Motion) -> list[Array]:
    """Return, per piece and drone, the weight per length of taut cable that it carries, halved.

    Then what hangs free: its partner's offset, its cable's weight per length, and length. The
    weights are those of the shares that are taut and that hang; nothing is returned of the latter
    where no cable hangs.
    """
    c, team = motion.drones.coefficients, motion.team
    taut = np.repeat(lowered(tautness(motion)), 2, axis=1)
    whole = GRAVITY * team.cable_density
    blocks = [(0.5 * taut * whole)[:, :, None]]
    if np.all(taut == 1.0):
        return blocks
    across = c.reshape(len(c), team.robots, 2, *c.shape[2:])
    partner = across[:, :, ::-1].reshape(c.shape) - c
    weight = (1.0 - taut) * whole
    length = np.broadcast_to(np.repeat(team.cable_length, 2), weight.shape[:2])
    return [*blocks, partner, weight[:, :, None], length[..., None, None]]


def thrust_enclosure(
    blocks: tuple[Array, ...], noise: float, along: enclosure.Enclosure | None = None
) -> enclosure.Enclosure:
    """Return polynomials (cells, 3, degree + 1) and radii (cells,) around the thrusts.

    Parameters
    ----------
    blocks: of ``thrust_cells``.
    noise: of the positions [m].
    along: directions of the legs, where they are known.
    """
    free, legs, tension, slop = blocks[:4]
    along = enclosure.direction(legs, noise) if along is None else along
    pull = bernstein.multiply(along.coefficients, tension)
    parts = [free, pull]
    radius = np.max(np.abs(tension), axis=(-2, -1)) * along.radius + slop[:, 0, 0]
    for weight in _weights(blocks, noise):
        parts.append(weight.coefficients)
        radius = radius + weight.radius
    order = max(bernstein.degree(part) for part in parts)
    thrust = bernstein.elevate(free, order) + bernstein.elevate(pull, order)
    for part in parts[2:]:
        thrust += bernstein.elevate(part, order)
    return enclosure.Enclosure(thrust, radius)


def known_directions(motion: Motion) -> Directions | None:
    """Return the directions of the legs of ``thrust_cells``; None without cables."""
    return drone_directions(motion) if motion.team.has_cables else None


def _weights(blocks: tuple[Array, ...], noise: float) -> Iterator[enclosure.Enclosure]:
    """Yield what the weights of taut and of hanging cables add to the thrust (cells, 3)."""
    if len(blocks) > 4:
        legs, weight = blocks[1], blocks[4][:, 0]
        sizes = enclosure.norm(legs)
        lift = bernstein.multiply(weight, sizes.coefficients)
        upward = np.stack([np.zeros_like(lift), np.zeros_like(lift), lift], axis=1)
        radius = np.max(np.abs(weight), axis=-1) * (sizes.radius + 2.0 * noise)
        yield enclosure.Enclosure(upward, radius)
    if len(blocks) > 5:
        yield _hanging_weight(*blocks[5:])


def _hanging_weight(partner: Array, weight: Array, length: Array) -> enclosure.Enclosure:
    """Enclose what free cables add to the thrust (cells, 3): half of their weight, and their pull.

    Parameters
    ----------
    partner: (cells, 3, degree + 1) [m], offset of the cable's other end.
    weight: (cells, 1, degree + 1), per length.
    length: (cells, 1, 1) [m]
    """
    lower, upper = steepness_range(partner, length[:, 0, 0])
    most, least = (np.array(pull_terms(sigma)) for sigma in (lower, upper))  # both fall with σ
    return pulled(partner, weight, least, most, length)


def pulled(
    offset: Array, weight: Array, least: Array, most: Array, length: Array | float = 0.0
) -> enclosure.Enclosure:
    """Enclose ``-w/2 (k x, k y, l z - L)`` for an offset (x, y, z) and k, l between bounds.

    Parameters
    ----------
    offset: (cells, 3, degree + 1)
    weight: (cells, 1, degree + 1), w.
    least, most: (2, cells), k and l.
    length: (cells, 1, 1), L.
    """
    middle, spread = 0.5 * (most + least), 0.5 * (most - least)
    factors = np.stack([-middle[0], -middle[0], -middle[1]], axis=1)
    size = np.max(np.abs(offset), axis=-1)
    radius = spread[0] * np.hypot(size[:, 0], size[:, 1]) + spread[1] * size[:, 2]
    scaled = factors[..., None] * offset
    scaled[:, 2:] += length
    pull = bernstein.multiply(weight, 0.5 * scaled)
    return enclosure.Enclosure(pull, 0.5 * np.max(np.abs(weight), axis=(-2, -1)) * radius)


@dataclass(frozen=True, eq=False)
class Thrust:
    """Thrusts at one time a cell.

    Attributes
    ----------
    vectors: (cells, 3); without the cable's pull where the leg has no direction.
    pull: (cells,), how large a pull comes on top there, else 0.
    """

    vectors: Array
    pull: Array


def thrust_at(blocks: tuple[Array, ...], index: Indices, order: int) -> Thrust:
    """Return the thrusts at ``index / order`` (cells,)."""
    return thrust_from([bernstein.evaluate_at(each, index[:, None], order) for each in blocks])


def thrust_from(there: Sequence[Array]) -> Thrust:
    """Return the thrusts, given the blocks' values (cells, rows)."""
    free, legs, tension = there[:3]
    size = length(legs)[..., None]
    known = size > NO_DIRECTION
    pull = np.where(known, tension * legs / np.where(known, size, 1.0), 0.0)
    if len(there) > 4:
        free = free + there[4] * size * _UPWARD
    if len(there) > 5:
        partner, weight, whole = (each[..., None] for each in there[5:])
        free = free + _hanging_weight(partner, weight, whole).coefficients[..., 0]
    return Thrust(free + pull, np.where(known, 0.0, np.abs(tension))[:, 0])
