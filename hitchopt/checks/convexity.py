"""Check ``convexity``: the outline turns right at every vertex, and not too far in all.

A closed hitch turns once around, an open chain less than that.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from hitchopt.checks.bounds.bodies import edge_vectors
from hitchopt.checks.bounds.rounding_margins import ROUNDING, position_margin
from hitchopt.checks.bounds.thrust_enclosure import NO_DIRECTION
from hitchopt.checks.rule import CheckRule, Finder, Finding
from hitchopt.motion.motion import Motion
from hitchopt.motion.phases import HITCHED_STATE
from hitchopt.trajectory import bernstein
from hitchopt.trajectory.extremum import Cells, Estimate, smallest
from hitchopt.values import Array

BACKWARD = -180.0
"""[deg] The smallest angle there is; also that of an edge without direction."""


def _find(motion: Motion, _: float) -> Finding:
    """Return the smallest exterior angle in degrees, seen from above; ``where`` names the vertex.

    A polygon that goes w times around its inside, w not 1, has ``360 (1 - w)`` reported if that is
    less. The number at the start is that of all times unless an angle passes -180° in between,
    which is worse already.

    A chain has 360° less all of its turning reported if that is less; ``where`` names both ends.
    """
    edges, layout = edge_vectors(motion)[:, :, :2], motion.team.layout
    rows = np.concatenate([edges[:, layout.behind], edges[:, layout.ahead]], axis=2)
    start = _angles_at(rows[0, :, :, 0])
    names = motion.team.point_names
    places: list[tuple[str, ...]] = [(names[k],) for k in layout.clasps]
    offsets = np.zeros(len(places))
    if layout.closed:
        room = 360.0 * (1 - round(float(np.sum(start)) / 360.0))
    else:
        # What is left of once around is 180° and the turn from the last edge to the first one
        # reversed, an angle that jumps from -180° to 180° only where nothing is left.
        room = 360.0 - float(np.sum(start))
        ends = np.concatenate([edges[:, -1:], -edges[:, :1]], axis=2)
        rows, offsets = np.concatenate([rows, ends], axis=1), np.append(offsets, 180.0)
        places.append((names[0], names[-1]))
    added = np.broadcast_to(offsets[:, None, None], (*rows.shape[:2], 1, 1))
    noise = position_margin(motion)
    cells = Cells.over(motion.vertices.breaks, [rows, added])
    found = smallest(cells, partial(_bound, noise=noise))
    worst, time, where = max(found.worst, BACKWARD), found.time, places[found.item]
    if worst > BACKWARD and room < min(worst, 0.0):
        worst, time = room, float(motion.vertices.breaks[0])
        where = () if layout.closed else places[-1]
    return Finding(worst, time, where)


def _bound(blocks: tuple[Array, ...], noise: float) -> Estimate:
    """Bound the angle of the curve (dot, cross) by its coefficients' angles.

    Seen from its direction at mid time, a curve whose coefficients all lie ahead stays within the
    wedge that they span. Past 180° angles start again at -180°.
    """
    rows, added = blocks[0], blocks[1][:, 0, 0]
    along, right = _products(rows)
    degree = bernstein.degree(along)
    x0, y0 = bernstein.evaluate(along, 0.5), bernstein.evaluate(right, 0.5)
    ahead = x0[:, None] * along + y0[:, None] * right
    aside = x0[:, None] * right - y0[:, None] * along
    relative = np.degrees(np.arctan2(aside, ahead))
    start = np.degrees(np.arctan2(y0, x0))
    # How far rounding of both edges turns a point of the wedge, all of them being this far out.
    least = np.min(ahead, axis=-1) / np.hypot(x0, y0)
    spread = 4.0 * (ROUNDING * np.max(np.abs(rows), axis=(1, 2)) + noise)
    spread = np.degrees(spread * np.sum(np.max(np.abs(rows), axis=-1), axis=-1) / least)
    bound = start + np.min(relative, axis=-1) - spread
    highest = start + np.max(relative, axis=-1) + spread
    wedge = (least > 0.0) & (spread < 1.0) & (highest < -BACKWARD)
    angles = np.where(wedge[:, None], relative, np.arctan2(right, along))
    index = np.argmin(angles, axis=-1)
    value = added + _angles_at(bernstein.evaluate_at(rows, index[:, None], degree))
    # Where the middle is a point without direction nothing above is a number; nor is it needed.
    return Estimate(
        np.where(wedge & (bound > BACKWARD), added + bound, BACKWARD), value, index / max(1, degree)
    )


def _products(rows: Array) -> tuple[Array, Array]:
    """Return dot and right-hand cross product of two edges (…, 4, degree + 1)."""
    bx, by, ax, ay = (rows[..., i, :] for i in range(4))
    along = bernstein.multiply(bx, ax) + bernstein.multiply(by, ay)
    right = bernstein.multiply(by, ax) - bernstein.multiply(bx, ay)
    return along, right


def _angles_at(rows: Array) -> Array:
    """Return the angles between pairs of edges (…, 4) [deg]; a short edge turns backward."""
    along, right = (product[..., 0] for product in _products(rows[..., None]))
    lengths = np.minimum(np.hypot(rows[..., 0], rows[..., 1]), np.hypot(rows[..., 2], rows[..., 3]))
    return np.where(lengths > NO_DIRECTION, np.degrees(np.arctan2(right, along)), BACKWARD)


RULE = CheckRule(
    "convexity",
    "deg",
    "min",
    0.0,
    (Finder(_find, HITCHED_STATE),),
    "go by a polygon in between, in two morphs",
)
