"""Bodies of a team in each of their states: drones, and where cables may be.

Checks within a team and between teams compare them (``checks.distances``).

- Taut cables are straight between drones, contacts and vertices (``spans.cable_parts``).
- A cable that hangs, or lies on the ground, is in the vertical sheet below its chord, no
  deeper than a cable that leads straight down and up again.
- A cable that is clasped or tightened, or the reverse, or loose after a loss, is somewhere between
  its chord and its route over the clasps: in the vertical region below the hull of both.
  Its clasps are near the middles of the pairs of drones that turn about each other, or near the
  plan's vertices while drones move out, and as taut as those of the hitch before or after.

At a joint of phases both regions contain the cable, and one contains the other one or both contain
the chord, so no body passes from one side of a cable to the other.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from hitchopt.checks.spans import cable_names, cable_parts, cached, part_names
from hitchopt.hitch.team import Layout
from hitchopt.motion.motion import Motion
from hitchopt.trajectory import bernstein
from hitchopt.trajectory.bernstein import same_degree
from hitchopt.trajectory.enclosed import Enclosed
from hitchopt.values import Array, Indices, true_runs

Flags = NDArray[np.bool_]

PLAN_AXES = np.array([1.0, 1.0, 0.0])[:, None]  # Factors of coordinates, seen from above


@dataclass(frozen=True, eq=False)
class Bodies:
    """Bodies of one kind, as hulls of their corners."""

    corners: Array  # (pieces, bodies, k, 3, degree + 1) [m]
    names: Sequence[str]  # (bodies,), names of the bodies, or of the cables to which they belong
    # Number of corners that span vertical regions in plan view; 0 for other bodies
    outline: int = 0
    pieces: Flags | None = None  # (pieces,), on which the bodies are compared; None for all
    # (bodies,), numbers of parts of taut cables as in ``Layout.parts``; empty for other bodies.
    part: Indices = field(default_factory=lambda: np.zeros(0, dtype=np.intp))

    def labelled(self, label: Callable[[str], str]) -> Bodies:
        """Return the bodies with full names, such as ``a.q0``."""
        return replace(self, names=tuple(map(label, self.names)))

    def scaled(self, scale: Array) -> Bodies:
        """Return the bodies in coordinates scaled by (3,)."""
        return replace(self, corners=self.corners * scale[:, None])


def plan_points(motion: Motion) -> Array:
    """Return drones (pieces, 2n, 1, 3, degree + 1) [m], projected to height 0."""
    level = motion.drones.coefficients * PLAN_AXES
    return np.asarray(level[:, :, None])


def cable_ends(drones: Array) -> Array:
    """Return the ends (pieces, n, 2, 3, degree + 1) of cables between drones (pieces, 2n, …)."""
    return drones.reshape(len(drones), -1, 2, *drones.shape[-2:])


def drones_of(motion: Motion) -> Bodies:
    """Return all drones."""
    return Bodies(motion.drones.coefficients[:, :, None], motion.team.drone_names)


def taut_parts(motion: Motion) -> Bodies:
    """Return the parts of taut cables, with names such as ``q-leg 0``."""
    corners, part = cable_parts(motion)
    return Bodies(corners, part_names(motion, part), part=part)


def taut_cables(motion: Motion) -> Bodies:
    """Return the parts of taut cables with the names of cables."""
    corners, part = cable_parts(motion)
    names = cable_names(motion)
    return Bodies(corners, [names[cable] for cable in (part // 3).tolist()], part=part)


def clasped_cables(motion: Motion) -> Bodies:
    """Return the regions of cables, on pieces on which they are clasped or tightened."""
    sheets = cable_sheets(motion)
    return Bodies(sheets.corners, cable_names(motion), sheets.outline, sheets.clasped)


@dataclass(frozen=True, eq=False)
class CableSheets:
    """Vertical regions that contain cables without a hitch.

    The first ``outline`` of the corners span a region in plan view, and its top; the last two are
    at its bottom.
    """

    corners: Array  # (pieces, n, outline + 2, 3, degree + 1) [m]
    outline: int  # Number of corners that span a region in plan view
    clasped: Flags  # (pieces,), whether cables are clasped or tightened

    def on(self, pieces: slice) -> CableSheets:
        """Return the regions on a run of pieces, with two corners if none is clasped."""
        corners = self.corners[pieces]
        clasped = self.clasped[pieces]
        if self.outline == 2 or np.any(clasped):
            return CableSheets(corners, self.outline, clasped)
        both_drones = corners[:, :, [0, self.outline - 1, -2, -1]]
        return CableSheets(both_drones, 2, clasped)

    @property
    def prisms(self) -> Array:
        """Corners (pieces, n, 2 outline, 3, degree + 1) [m] of floor and top, as of a slab."""
        top = self.corners[:, :, : self.outline]
        floor = top.copy()
        floor[..., 2, :] = self.corners[:, :, -1:, 2]
        return np.concatenate([floor, top], axis=2)


@cached
def cable_sheets(motion: Motion) -> CableSheets:
    """Return the regions that contain the cables on pieces without a hitch.

    Regions on other pieces have no meaning. While any cable is clasped or tightened, an outline has
    six corners: both drones, and two positions of both clasps.
    """
    bottoms = _bottoms(motion)
    clasped = motion.in_states(lambda state: state.clasped)
    if not np.any(clasped):
        chords = cable_ends(motion.drones.coefficients)
        return CableSheets(np.concatenate([chords, bottoms], axis=2), 2, clasped)
    drones, vertices = same_degree(motion.drones.coefficients, motion.vertices.coefficients)
    turning = motion.in_states(lambda state: state.clasping)[:, None, None, None]
    clasps = np.where(turning, _middles(motion, drones), vertices)
    taut = _taut_clasps(motion, clasps, clasped)
    outlines = clasped_outlines(motion.team.layout, drones, clasps, taut)
    on_chords = np.repeat(cable_ends(drones), 3, axis=2)
    outlines[~clasped] = on_chords[~clasped]
    bottoms = bernstein.elevate(bottoms, bernstein.degree(drones))
    corners = np.concatenate([outlines, bottoms], axis=2)
    return CableSheets(corners, outlines.shape[2], clasped)


def _bottoms(motion: Motion) -> Array:
    """Return two points (pieces, n, 2, 3, degree + 1) [m] at the bottom of every cable's region."""
    q = motion.drones.coefficients[:, 0::2]
    r = motion.drones.coefficients[:, 1::2]
    bottoms = np.repeat(0.5 * (q + r)[:, :, None], 2, axis=2)
    bottoms[:, :, :, 2] -= 0.5 * motion.team.cable_length[:, None, None]
    loose = motion.in_states(lambda state: state.loose)
    if np.any(loose):
        level = Enclosed((r - q)[loose]).xy.norm_lower.value
        shallower = 0.5 * motion.team.cable_length - hanging_depth(motion.team.cable_length, level)
        bottoms[loose, :, :, 2] += shallower[..., None, None]
    return bottoms


def hanging_depth(lengths: Array, spans: Array) -> Array:
    """Return how far cables hang at most below the middle of their ends [m].

    They are within an ellipsoid of revolution about both ends, which are at least ``spans`` [m]
    apart, seen from above.
    """
    return np.asarray(0.5 * np.sqrt(np.maximum(lengths**2 - spans**2, 0.0)))


def clasped_outlines(layout: Layout, drones: Array, clasps: Array, taut: Array) -> Array:
    """Return outlines (m, n, 6, 3, …) [m] of regions of cables that are clasped or tightened.

    Parameters
    ----------
    drones: (m, 2n, 3, …) [m], samples or coefficients.
    clasps: (m, points, 3, …) [m], positions of the clasps.
    taut: (m, points, 3, …) [m], clasps of the hitch before or after.
    """
    outline = [
        drones[:, 0::2],
        clasps[:, layout.starts],
        taut[:, layout.starts],
        taut[:, layout.ends],
        clasps[:, layout.ends],
        drones[:, 1::2],
    ]
    return np.stack(outline, axis=2)


def _middles(motion: Motion, drones: Array) -> Array:
    """Return the middles (pieces, points, 3, degree + 1) [m] of pairs; ends of chains at drones."""
    layout = motion.team.layout
    middles = np.zeros((len(drones), layout.points, *drones.shape[2:]))
    q_ahead = drones[:, 2 * layout.ahead]
    r_behind = drones[:, 2 * layout.behind + 1]
    middles[:, layout.clasps] = 0.5 * (q_ahead + r_behind)
    ends = np.flatnonzero(~layout.has_leg.ravel())
    middles[:, layout.anchors[ends]] = drones[:, ends]
    return middles


def _taut_clasps(motion: Motion, clasps: Array, clasped: Flags) -> Array:
    """Return the clasps (pieces, points, 3, degree + 1) [m] of the hitch before or after.

    Without such a hitch, and after a loss, they are the given ones.
    """
    taut = clasps.copy()
    vertices = motion.vertices.coefficients
    for first, last in true_runs(clasped & ~motion.in_states(lambda state: state.loose)):
        if first > 0 and motion.formed[first - 1]:
            taut[first:last] = vertices[first - 1, ..., -1:]
        elif last < len(clasped) and motion.formed[last]:
            taut[first:last] = vertices[last, ..., :1]
    return taut
