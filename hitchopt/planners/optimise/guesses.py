"""Initial guesses of a path between two outlines: polygons between, and legs that roll meanwhile.

Guesses belong to different homotopy classes. Straight lines need not be convex, and collapse to a
point in a half turn. Edges that turn evenly, with the nearest lengths that close, form convex
polygons; so do polygons that turn while their shape changes, if the shapes are similar. If all legs
rise and sink between the ends, cables pass above each other on polygons of any size; on polygons
that are widened halfway, they pass side by side.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import numpy as np
import scipy.sparse as sp

from hitchopt.geometry import Outline
from hitchopt.geometry.outline import centroids
from hitchopt.geometry.vectors import length
from hitchopt.hitch import Hitch
from hitchopt.hitch.forces import if_balanced
from hitchopt.hitch.quadratic_program import QuadraticProgram, solve_qp
from hitchopt.hitch.requirements import Requirements
from hitchopt.hitch.slack_split import LegTask
from hitchopt.planners.morph.morph import exterior_angles
from hitchopt.planners.optimise.knots import KnotPath
from hitchopt.values import Array

STRAIGHT = "straight"  # Name of the guess on straight lines
WIDENED = "widened"  # Name of the guess on the same lines, widened halfway

MIN_OTHER_TURN = 0.75 * math.pi
"""[rad] Smallest turn for which the opposite turn is a guess as well."""

MIN_EDGE_SHARE = 0.3  # Smallest edge of a guess whose edges turn, over the shorter of both ends

WIDENING = 1.4
"""Scale of the outline halfway on a widened path, on which legs pass the tips of stars."""

MIN_SHAPE_SHARE = 0.1  # Smallest exterior angle and edge of a guess, over those at its ends
MAX_MARGIN = 1.1  # Largest margin of distances that is computed

ROLLS = tuple(math.radians(angle) for angle in (0.0, 15.0, 30.0, 45.0))
"""[rad] Rolls of all legs midway; 0 keeps the linear roll between the ends."""

ROLLED_STEPS = 16  # Number of steps between the knots of a guess that rolls, which resolve its rise
ROLL_RAMP = 0.25  # Fraction of the path in which the roll of a guess rises, and in which it sinks
ROLL_COST = 0.3  # [1/rad] Penalty of the roll of a guess, in units of its margin
TURN_COST = 0.3  # [1/rad] Penalty of the turns of a guess, in units of its margin

EVENNESS = (0.0, 1.0)
"""Changes of fractions of legs midway toward equal ones, over the whole change."""


def polygon_guesses(first: Outline, last: Outline, count: int) -> dict[str, Array]:
    """Return the outlines (count, points, 2) [m] of guesses by name."""
    s = np.linspace(0.0, 1.0, count)
    straight = _line(first.vertices, last.vertices, s)
    if not first.closed:
        return {STRAIGHT: straight}
    middles = straight.mean(axis=1, keepdims=True)
    scales = 1.0 + (WIDENING - 1.0) * np.sin(math.pi * s)[:, None, None]
    guesses = {STRAIGHT: straight, WIDENED: middles + scales * (straight - middles)}
    for turn in turns(first, last):
        name = _turn_name(turn)
        # Polygons that turn while their shape changes
        unturned_last = _rotated(last.vertices - last.centroid, np.array([-turn]))[0]
        shapes = _line(first.vertices - first.centroid, unturned_last, s)
        centres = _line(first.centroid, last.centroid, s)[:, None]
        guesses[name] = centres + _rotated(shapes, turn * s)
        outlines = turning_edges(first, last, turn, s)
        if outlines is not None:
            guesses[f"edges {name}"] = outlines
    return guesses


def _turn_name(turn: float) -> str:
    """Return the name of a guess that turns [rad]."""
    return f"turned {math.degrees(turn):.0f}°"


def turns(first: Outline, last: Outline) -> tuple[float, ...]:
    """Return the mean turn of the edges [rad], and the opposite one if both are about as large."""
    # The turns of edges differ by less than a full turn and are unwrapped together.
    mean = float(np.mean(_edge_angles(last) - _edge_angles(first)))
    turn = mean - 2.0 * math.pi * math.ceil((mean - math.pi) / (2.0 * math.pi))
    other = turn - math.copysign(2.0 * math.pi, turn)
    return (turn, other) if abs(turn) > MIN_OTHER_TURN else (turn,)


def turning_edges(first: Outline, last: Outline, turn: float, s: Array) -> Array | None:
    """Return outlines (J, points, 2) [m] whose edges turn evenly; None if no lengths close them.

    Parameters
    ----------
    turn: mean turn of the edges [rad].
    s: (J,), path parameters.
    """
    first_angles = _edge_angles(first)
    last_angles = _edge_angles(last)
    angles = _line(first_angles, last_angles + turn - np.mean(last_angles - first_angles), s)
    directions = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    lengths = _line(first.edge_lengths, last.edge_lengths, s)
    if first.closed:
        shortest = MIN_EDGE_SHARE * np.minimum(first.edge_lengths, last.edge_lengths)
        closing_lengths = _closing_lengths(directions, lengths, shortest)
        if closing_lengths is None:
            return None
        lengths = closing_lengths
    edges = lengths[..., None] * directions
    edge_ends = np.cumsum(edges, axis=1)
    if first.closed:
        corners = edge_ends - edges
        middles = centroids(corners)
        required_middles = _line(first.centroid, last.centroid, s)
    else:
        corners = np.concatenate([np.zeros_like(edges[:, :1]), edge_ends], axis=1)
        middles = corners.mean(axis=1)
        required_middles = _line(first.vertices.mean(axis=0), last.vertices.mean(axis=0), s)
    outlines: Array = corners + (required_middles - middles)[:, None]
    return outlines


def _closing_lengths(directions: Array, lengths: Array, shortest: Array) -> Array | None:
    """Return the edges' lengths (J, n) [m] nearest to given ones that close polygons.

    Parameters
    ----------
    directions: (J, n, 2), unit vectors along edges.
    lengths: (J, n) [m], which close the first and the last polygon.
    shortest: (n,) [m], smallest lengths; None is returned if no polygon has them.
    """
    gap_by_lengths = np.swapaxes(directions, 1, 2)
    gaps = gap_by_lengths @ lengths[..., None]
    multipliers = np.linalg.solve(gap_by_lengths @ directions, gaps)
    nearest: Array = lengths - (directions @ multipliers)[..., 0]
    if np.all(nearest >= shortest):
        return nearest
    inner_lengths = _bounded_closing_lengths(directions[1:-1], lengths[1:-1], shortest)
    if inner_lengths is None:
        return None
    nearest[1:-1] = inner_lengths
    return nearest


def _bounded_closing_lengths(directions: Array, lengths: Array, shortest: Array) -> Array | None:
    """Return the edges' lengths (J, n) [m] nearest to given ones that close polygons, or None.

    Parameters
    ----------
    directions: (J, n, 2), unit vectors along edges.
    lengths: (J, n) [m], which need not close.
    shortest: (n,) [m], smallest lengths.
    """
    gaps_by_lengths = sp.block_diag([sp.csc_array(edges.T) for edges in directions])
    no_gaps = np.zeros(gaps_by_lengths.shape[0])
    program = QuadraticProgram(
        P=sp.csc_array(sp.eye_array(lengths.size)),
        q=-lengths.ravel(),
        A=sp.csc_array(gaps_by_lengths),
        lower=no_gaps,
        upper=no_gaps,
        x_min=np.tile(shortest, len(lengths)),
    )
    solution = solve_qp(program)
    if solution is None:
        return None
    return solution.reshape(lengths.shape)


def rolled_guesses(start: Hitch, end: Hitch, requirements: Requirements) -> list[KnotPath]:
    """Return guesses whose edges turn evenly and whose legs roll, the most promising first.

    The roll of all legs rises from that of the start, and sinks to that of the end. Fractions are
    linear, or equal midway.
    """
    first = start.polygon
    last = end.polygon
    s = np.linspace(0.0, 1.0, ROLLED_STEPS + 1)
    side = -1.0 if np.sum(start.roll) + np.sum(end.roll) < 0.0 else 1.0
    ranked = list[tuple[float, KnotPath]]()
    for turn in turns(first, last):
        polygons = turning_edges(first, last, turn, s)
        if polygons is None:
            continue
        path = KnotPath.through(f"edges {_turn_name(turn)}", start, end, polygons)
        if is_hitch(path):
            ranked += _ranked_rolls(path, turn, side, requirements)
    ranked.sort(key=lambda guess: guess[0])
    return [path for _, path in ranked]


def _ranked_rolls(
    path: KnotPath, turn: float, side: float, requirements: Requirements
) -> list[tuple[float, KnotPath]]:
    """Return guesses with the polygons of a path, with all ROLLS and EVENNESS, and their costs.

    Costs are penalties of roll and turn minus the margin of distances; the smallest is tried first.

    Parameters
    ----------
    turn: of the edges on the path [rad].
    side: sign of the roll.
    """
    s = np.linspace(0.0, 1.0, path.steps + 1)
    ramp = np.minimum(1.0, np.minimum(s, 1.0 - s) / ROLL_RAMP)
    midway = (ramp * ramp * (3.0 - 2.0 * ramp))[:, None]
    variants = list(product(ROLLS, EVENNESS))
    paths = [_rolled(path, side * roll, midway, evenness) for roll, evenness in variants]
    margins = np.min(distance_margins(paths, requirements)[:, 1:-1], axis=1)
    ranked = list[tuple[float, KnotPath]]()
    for rolled, (roll, _), margin in zip(paths, variants, margins.tolist(), strict=True):
        cost = ROLL_COST * roll + TURN_COST * abs(turn) - min(margin, 1.0)
        ranked.append((cost, rolled))
    return ranked


def _rolled(path: KnotPath, roll: float, midway: Array, evenness: float) -> KnotPath:
    """Return a path whose legs have a roll [rad] midway; 0 keeps that of the path.

    Parameters
    ----------
    midway: (J + 1, 1), 0 at the ends and 1 between.
    evenness: fraction of the change to equal fractions midway.
    """
    clasps = len(path.team.layout.clasps)
    rolls = np.zeros((len(midway), clasps)) if path.roll is None else path.roll
    name = path.name
    if roll != 0.0:
        rolls = rolls + midway * (roll - rolls)
        name += f", roll {math.degrees(roll):.0f}°"
    fractions = path.q_legs / path.slack
    q_legs = (fractions + evenness * midway * (0.5 - fractions)) * path.slack
    return replace(path, name=name, q_legs=q_legs, roll=rolls if np.any(rolls) else None)


def distance_margins(paths: Sequence[KnotPath], requirements: Requirements) -> Array:
    """Return the margins (paths, J + 1) of distances at the knots of paths of one team.

    They are zero if clasps have no balance with the roll of a path.
    """
    team = paths[0].team
    knots = len(paths[0].polygons)
    no_roll = np.zeros((knots, len(team.layout.clasps)))
    rolls = [no_roll if path.roll is None else path.roll for path in paths]
    task = LegTask(
        team,
        replace(requirements, arena=None),
        polygons=np.concatenate([path.polygons for path in paths]),
        reference=np.concatenate([path.q_legs for path in paths]),
        shortest_leg=0.0,
        margin=MAX_MARGIN,
        roll=np.concatenate(rolls),
    )
    margins = if_balanced(task.reference_margins, np.zeros(len(paths) * knots))
    return margins.reshape(len(paths), knots)


def is_hitch(path: KnotPath) -> bool:
    """Return whether a guess is convex, with edges and slack, at all knots."""
    angles = exterior_angles(path.team.layout, path.edges)
    has_slack = bool(np.min(path.slack) > 0.0)
    return has_slack and not (_degenerates(angles) or _degenerates(length(path.edges)))


def _degenerates(values: Array) -> bool:
    """Return whether values (J + 1, …) are much smaller at a knot than at both ends."""
    return bool(np.min(values) <= MIN_SHAPE_SHARE * np.min(values[[0, -1]]))


def _edge_angles(outline: Outline) -> Array:
    """Return the angles (n,) [rad] of the edges from east, decreasing by the exterior angles."""
    east, north = outline.edge_directions[0]
    first_angle = math.atan2(north, east)
    after_first = outline.exterior_angles[1:] if outline.closed else outline.exterior_angles
    return first_angle - np.append(0.0, np.cumsum(after_first))


def _line(first: Array, last: Array, s: Array) -> Array:
    """Return linear interpolations at s (J,)."""
    return first + np.multiply.outer(s, last - first)


def _rotated(points: Array, angles: Array) -> Array:
    """Return points (n, 2) or (J, n, 2) rotated by angles (J,), as (J, n, 2)."""
    cosines = np.cos(angles)
    sines = np.sin(angles)
    transposed_rotations = np.array([[cosines, sines], [-sines, cosines]])
    rotated: Array = points @ np.moveaxis(transposed_rotations, -1, 0)
    return rotated
