"""The check ``convexity`` of the outline, by its exterior angles."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hitchopt.checks.certificate import with_tolerance
from hitchopt.checks.clasps import clasp_names
from hitchopt.checks.rule import CheckRule, Evaluator, WorstCase
from hitchopt.checks.spans import MotionSpans, cached, edge_vectors
from hitchopt.geometry.vectors import turn
from hitchopt.motion.motion import Motion
from hitchopt.trajectory.enclosed import Bound, Enclosed
from hitchopt.trajectory.search import worst
from hitchopt.values import Array

MIN_ANGLE = -180.0  # [deg] Smallest angle, also of edges without direction
ANGLE_ROUNDING = 1e-6  # [deg] Rounding of the sum of all angles


@cached
def _corners(motion: Motion) -> Array:
    """Return the horizontal edges behind and ahead of corners (pieces, corners, 2, 2, …).

    A chain has an additional corner between its last edge and the reversed first one.
    """
    layout = motion.team.layout
    edges = edge_vectors(motion)[:, :, :2]
    at_clasps = np.stack([edges[:, layout.behind], edges[:, layout.ahead]], axis=2)
    if layout.closed:
        return at_clasps
    at_ends = np.stack([edges[:, -1:], -edges[:, :1]], axis=2)
    return np.concatenate([at_clasps, at_ends], axis=1)


class Corners(MotionSpans):
    """Spans of the outline's corners."""

    @classmethod
    def names(cls, motion: Motion) -> Sequence[str]:
        """Return the corners' names."""
        names = clasp_names(motion)
        return names if motion.team.layout.closed else [*names, "ends"]


def _exterior(spans: Corners) -> Bound:
    """Return the right turns [deg] of the outline at its corners.

    At a chain's ends, it is the remainder of a full turn. Angles are bounded relative to that at
    mid span; they are ambiguous beyond 180°.
    """
    edges = spans.read(_corners(spans.source))
    behind = Enclosed(edges[:, 0], spans.noise)
    ahead = Enclosed(edges[:, 1], spans.noise)
    dot = behind.dot(ahead)
    cross = ahead.cross(behind)
    mid_angle = np.arctan2(cross.middle, dot.middle)
    cosine = np.cos(mid_angle)
    sine = np.sin(mid_angle)
    along = (dot * cosine + cross * sine).range
    across = (cross * cosine - dot * sine).range
    least_change = np.arctan2(across.low, np.where(across.low < 0.0, along.low, along.high))
    largest_change = np.arctan2(across.high, np.where(across.high < 0.0, along.high, along.low))
    lowest = mid_angle[:, 0] + least_change
    highest = mid_angle[:, 0] + largest_change
    unambiguous = (along.low > 0.0) & (highest <= np.pi)
    is_clasp = spans.item < len(spans.source.team.layout.clasps)
    offset = np.where(is_clasp, 0.0, 180.0)
    turns = np.where(unambiguous, offset + np.degrees(lowest), MIN_ANGLE)
    return Bound(turns, cross.lower.x)


def _smallest_angle(motion: Motion, limit: float) -> WorstCase:
    """Return the smallest exterior angle in degrees, seen from above; ``where`` names the vertex.

    If the outline turns by more than 360° in all at the start, it is the negative remainder: for a
    polygon that winds around its inside more than once, or a chain, whose ends ``where`` names.
    """
    layout = motion.team.layout
    names = motion.team.point_names
    ends = () if layout.closed else (names[0], names[-1])
    target = with_tolerance(limit, "min", share=0.5)
    smallest = worst(Corners.of(motion), _exterior, "min", target=target)
    angle = max(smallest.worst, MIN_ANGLE)
    at_start = _corners(motion)[0, : len(layout.clasps), :, :, 0]
    behind, ahead = np.moveaxis(at_start, 1, 0)
    remainder = 360.0 - float(np.sum(np.degrees(turn(ahead, behind))))
    if angle > MIN_ANGLE and remainder < min(angle, -ANGLE_ROUNDING):
        return WorstCase(remainder, float(motion.vertices.breaks[0]), ends)
    is_clasp = smallest.item < len(layout.clasps)
    where = (names[layout.clasps[smallest.item]],) if is_clasp else ends
    return WorstCase(angle, smallest.time, where)


CONVEXITY = CheckRule(
    "convexity",
    "deg",
    "min",
    0.0,
    (Evaluator(_smallest_angle, lambda state: state.hitched, formulas=(_exterior,)),),
    "use an intermediate polygon, in two morphs",
    group="cables",
    bodies=(("clasps",),),
    proves="the smallest exterior angle of the outline [deg]",
    unproven="that a nearly straight corner is robust",
)
