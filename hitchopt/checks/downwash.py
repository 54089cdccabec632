"""Check ``downwash``: bodies below a drone that its downwash would move are outside its ellipsoid.

Between drones, ``separation`` keeps two ellipsoids apart. The lower half of a drone's ellipsoid,
with the semi-axes ``radius`` and ``height``, also keeps clear of taut cables of other teams, and of
objects that they carry or that the drone's downwash would move. In coordinates scaled by these
semi-axes, the minimum distance is 1.

The momentum of a rotor's wake per time is its thrust (momentum theory: Leishman, Principles of
Helicopter Aerodynamics, 2006, section 2.2), so the wake pushes a body by no more. A free-standing
object would slide if the largest thrust exceeds its friction. Heavier and fixed ones do not move.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np

from hitchopt.checks.bodies import Bodies, drones_of
from hitchopt.checks.distances import Moving, PairSpans, Shape, gap, nearest
from hitchopt.checks.objects import in_object_frame
from hitchopt.checks.rule import CheckRule, Evaluator
from hitchopt.checks.solids import PlacedObject, Solid, placed_objects
from hitchopt.checks.spans import ROUNDING, magnitude
from hitchopt.drones.quadrotor import GRAVITY
from hitchopt.hitch.pairs import DISTANCES
from hitchopt.hitch.requirements import Separation
from hitchopt.hitch.team import Team
from hitchopt.motion.motion import Motion
from hitchopt.objects import Section, Slab, SolidObject
from hitchopt.trajectory.enclosed import Bound, Enclosed
from hitchopt.values import Array


def half_axes(separation: Separation) -> Array:
    """Return scale factors (3,) [1/m]: the ellipsoid of a drone has the radius 1 in these."""
    return 2.0 * separation.scale


def moves(body: SolidObject, team: Team) -> bool:
    """Return whether the downwash of a team's drones would move a free-standing object."""
    grip = body.friction * body.mass * GRAVITY
    return not body.fixed and grip < float(np.max(team.max_thrust))


def below(spans: PairSpans, floor: float | None = None) -> Bound:
    """Return scaled distances of drones from bodies, infinite for those above the drones.

    Bodies are the second ones of pairs, or a slab with a ``floor``.
    """
    distances = gap(spans)
    is_above = lead(spans, floor) >= 0.0
    return Bound(np.where(is_above, np.inf, distances.value), distances.x)


def lead(spans: PairSpans, floor: float | None) -> Array:
    """Return by how much bodies are above drones (spans,), less the rounding error."""
    drone, body = spans.ends
    heights = body[:, :, 2] if floor is None else np.full_like(drone[:, :, 2], floor)
    rise: Array = np.min(heights - drone[:, :1, 2], axis=(1, 2))
    return rise - spans.source.margin


def pairs_with_slab(
    points: Array,
    pose: Enclosed,
    slab: Slab,
    scale: Array,
    *,
    formula: Callable[..., Bound] = below,
    shape: Callable[[Slab], Shape] = Solid,
    **options: Any,
) -> Moving:
    """Return the pairs of drones (pieces, N, 1, 3, degree + 1) [m] and a slab that moves.

    Coordinates are multiplied by ``scale`` (3,), the first two alike. The formula takes the slab's
    ``floor``, and the shape is that of the slab.
    """
    local = in_object_frame(pose, Enclosed(points))
    across, _, upward = scale
    section = slab.section
    outline = None if section.outline is None else across * section.outline
    radius = None if section.radius is None else across * section.radius
    scaled = Slab(Section(outline, radius), upward * slab.lower, upward * slab.upper)
    margin = options.pop("margin") + ROUNDING * slab.size + float(np.max(local.r))
    return Moving(
        options.pop("breaks"),
        local.c * scale[:, None],
        np.zeros((len(points), 1, 1, 3, 1)),
        margin=margin * float(np.max(scale)),
        shape=shape(scaled),
        formula=partial(formula, floor=scaled.lower),
        **options,
    )


def pairs_with_object(
    motion: Motion, drones: Bodies, placed: PlacedObject, scale: Array, **options: Any
) -> Iterator[Moving]:
    """Yield the pairs of drones of a motion and the slabs of an object, in scaled coordinates.

    ``options`` are those of ``pairs_with_slab``.
    """
    for slab in placed.body.slabs:
        yield pairs_with_slab(
            drones.corners,
            placed.pose,
            slab,
            scale,
            breaks=motion.drones.breaks,
            names=(drones.names, (placed.name,)),
            **options,
        )


def drones_above_objects(motion: Motion, scale: Array, **options: Any) -> Iterator[Moving]:
    """Yield pairs of single drones and objects in their path, in scaled coordinates.

    ``options`` are those of ``pairs_with_slab``.
    """
    drones = drones_of(motion)
    margin = ROUNDING * magnitude(motion)
    for placed in placed_objects(motion):
        if moves(placed.body, motion.team):
            yield from pairs_with_object(motion, drones, placed, scale, margin=margin, **options)


def _scaled_cases(motion: Motion) -> Iterator[Moving]:
    """Yield the pairs of a motion, in coordinates in which ellipsoids have the radius 1."""
    yield from drones_above_objects(motion, half_axes(motion.requirements.separation))


def _limit(motion: Motion) -> float | None:
    """Return the limit, if single drones have objects in their way that they would move."""
    if motion.team.has_cables:
        return None
    objects = motion.requirements.objects.values()
    if not any(moves(body, motion.team) for body in objects):
        return None
    return DISTANCES["downwash"].limit(motion.requirements.separation)


DOWNWASH = CheckRule(
    "downwash",
    "ratio",
    "min",
    _limit,
    (Evaluator(nearest(_scaled_cases, scaled=True), exported=True, formulas=(below,)),),
    "fly higher above what the downwash would move, or next to it, or lower separation.height",
    group="distances",
    key="separation.height",
    bodies=(("drones", "movable"), ("drones", "taut")),
    proves="the minimum distance of drones' lower half ellipsoids from taut cables and objects of "
    "other teams that the thrust could move, 1 if they touch",
    unproven="wakes below the ellipsoid, on hanging cables, and within a team",
)
"""Lower halves of drones' ellipsoids meet no object that they would move, and no taut cable of
another team."""
