"""Polygons, cable lengths and tensions that fit objects, outlines and drones, by statics alone.

The enclosing polygon has short edges of similar lengths at the clearance from the outline. Cables
are the shortest that keep the separation of the drones.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hitchopt.drones.quadrotor import GRAVITY
from hitchopt.errors import InfeasibleError, Violation
from hitchopt.geometry import ConvexPolygon, Outline
from hitchopt.geometry.vectors import dot, left_of, length, turn, unit
from hitchopt.hitch.forces import cable_slack_of, if_balanced
from hitchopt.hitch.requirements import Requirements
from hitchopt.hitch.slack_split import LIMIT_MARGIN, SPREAD_MARGIN, LegTask
from hitchopt.hitch.team import Team
from hitchopt.objects import Section
from hitchopt.values import Array
from hitchopt.values.fields import with_fields

AXES = 24
"""Number of directions of stretch of enclosing polygons; those of the section's sides are added."""

ROTATIONS = 16  # Number of rotations of enclosing polygons within a period of symmetry

ASPECT_RATIOS = np.geomspace(0.25, 4.0, 41)
"""Aspect ratios of enclosing polygons over the section's own."""

MIN_TURN = 0.6  # Smallest exterior angle, over the mean
MIN_EDGE = 0.5  # Smallest edge, over the mean
ROUNDING = 1e-9  # Tolerance within which lengths or margins are equal
CENTIMETRE = 0.01  # [m] Step of cable lengths

UNBALANCED_STRIDE = 20
"""Distance of cable lengths with unbalanced legs that are tried, in steps of CENTIMETRE."""

RANGE_STRIDE = 5  # Distance of cable lengths that are tried for a range, in steps of CENTIMETRE
MAX_EXTRA_LENGTH = 1.0  # [m] Largest length beyond the one that legs need
WEIGHT_SAFETY = 2.0  # Smallest tension over the lowest one at which heavy cables balance

MAX_EDGE_WEIGHT = 0.35
"""Largest weight of half an edge over its tension: it then sags by a tenth of its length, up to
which the series of ``hitchopt.hitch.taut`` are exact."""

MAX_TENSION_RATIO = 30.0  # Largest over smallest tension of the search
TENSIONS = 60  # Number of tensions of the search


class Range(NamedTuple):
    """An interval of cable lengths [m] or tensions [N]."""

    smallest: float  # Smallest value
    largest: float  # Largest value; infinite without a bound


def enclosing_polygon(section: Section, n: int, clearance: float) -> ConvexPolygon:
    """Return an n-gon of short edges of similar lengths at a distance [m] from a section.

    Candidates have the edge directions of regular polygons, rotated and stretched in proportion to
    the section's widths. The one with the least sum of squared edge lengths is taken.
    InfeasibleError: all have flat corners or short edges, as around a narrow section.
    """
    directions = _candidate_edge_directions(section, n, clearance)
    outward = left_of(directions)
    distances = section.support(outward) + clearance
    corners = _corners_of_lines(outward, distances)
    edges = np.roll(corners, -1, axis=-2) - corners
    feasible = _are_well_shaped(edges, directions)
    if not np.any(feasible):
        violation = Violation("convexity", n, n - 1, "max", "edges", (), "", "use fewer robots")
        raise InfeasibleError([violation], "the section is too narrow for so many edges around it")
    sums_of_squares = np.where(feasible, np.sum(edges**2, axis=(-2, -1)), np.inf)
    is_best = sums_of_squares <= (1.0 + ROUNDING) * np.min(sums_of_squares)
    return ConvexPolygon(corners[np.argmax(is_best)])  # the first one


def _candidate_edge_directions(section: Section, n: int, clearance: float) -> Array:
    """Return unit vectors (candidates, n, 2) along the edges of clockwise candidates.

    They are those of regular polygons, rotated and stretched along all axes by all aspect ratios.
    """
    sides = np.roll(section.core, -1, axis=0) - section.core
    even_angles = math.pi * np.arange(AXES) / AXES
    axis_angles = np.append(even_angles, np.arctan2(sides[:, 1], sides[:, 0]))
    cosines = np.cos(axis_angles)
    sines = np.sin(axis_angles)
    axes = np.stack([cosines, sines, -sines, cosines], axis=-1).reshape(-1, 2, 2)
    half_widths = 0.5 * (section.support(axes) + section.support(-axes)) + clearance
    roots = np.sqrt(ASPECT_RATIOS)
    stretches = np.column_stack([roots, 1.0 / roots])
    rotations = np.arange(ROTATIONS)[:, None] / ROTATIONS
    angles = 2.0 * math.pi / n * (rotations - np.arange(n))
    regular = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    # Axes a, ratios k, rotations t, corners n; coordinates j along the axes and i in the plane
    shapes = np.einsum("aj,kj,tnj,aji->aktni", half_widths, stretches, regular, axes)
    shapes = shapes.reshape(-1, n, 2)
    return unit(np.roll(shapes, -1, axis=-2) - shapes)


def _corners_of_lines(normals: Array, distances: Array) -> Array:
    """Return the intersections (…, n, 2) [m] of each line with the one before it.

    Parameters
    ----------
    normals: (…, n, 2), unit normals of lines.
    distances: (…, n) [m], of the lines from the origin.
    """
    normal_pairs = np.stack([np.roll(normals, 1, axis=-2), normals], axis=-2)
    distance_pairs = np.stack([np.roll(distances, 1, axis=-1), distances], axis=-1)
    corners: Array = np.linalg.solve(normal_pairs, distance_pairs[..., None])[..., 0]
    return corners


def _are_well_shaped(edges: Array, directions: Array) -> NDArray[np.bool_]:
    """Return whether polygons (…) with edges (…, n, 2) [m] are convex, without flat or short parts.

    Edges have to point along their ``directions`` (…, n, 2).
    """
    n = edges.shape[-2]
    lengths = length(edges)
    right_turns = turn(edges, np.roll(edges, 1, axis=-2))
    turns_once = np.isclose(np.sum(right_turns, axis=-1), 2.0 * math.pi)
    has_corners = np.all(right_turns >= MIN_TURN * 2.0 * math.pi / n, axis=-1)
    has_edges = np.min(lengths, axis=-1) >= MIN_EDGE * np.mean(lengths, axis=-1)
    keeps_directions = np.all(dot(edges, directions) > 0.0, axis=-1)
    return np.asarray(turns_once & has_corners & has_edges & keeps_directions)


def shortest_cable(
    polygons: Sequence[Outline], requirements: Requirements, team: Team | None = None
) -> float:
    """Return the shortest cable length [m], in centimetres, with well separated balanced legs.

    They are separated on all polygons, of the same number of robots. If there is no such length,
    return the one with the largest margin over all slack splits. Cables have the weight and tension
    of the ``team``, none without one, and carry no load. InfeasibleError: no length up to
    MAX_EXTRA_LENGTH keeps drones separated.
    """
    team = Team(len(polygons[0]), 1.0) if team is None else team
    for balanced in (True, False):
        best = _best_length(polygons, requirements, team, balanced=balanced)
        if best.margin >= LIMIT_MARGIN:
            return best.cable_length
    remedy = "change the clearance"
    if len(polygons[0]) > 3:
        remedy = f"use fewer robots, or {remedy}"
    violation = Violation("separation", best.margin, LIMIT_MARGIN, "min", "ratio", (), "", remedy)
    raise InfeasibleError([violation], "no cable length separates the drones around the object")


def _best_length(
    polygons: Sequence[Outline], requirements: Requirements, team: Team, *, balanced: bool
) -> CableMargin:
    """Return the shortest length with the largest margin, at most SPREAD_MARGIN.

    Lengths with balanced legs are tried in steps of RANGE_STRIDE, and then those before the best.
    """
    margins = partial(_cable_margins, polygons, requirements, team, balanced=balanced)
    tried = list[CableMargin]()
    for candidate in margins(stride=RANGE_STRIDE):
        tried.append(candidate)
        if candidate.margin >= SPREAD_MARGIN:
            break
    best = max(tried, key=lambda each: each.margin)
    if balanced:
        between = CENTIMETRE * np.arange(1 - RANGE_STRIDE, RANGE_STRIDE)
        lengths = np.round(best.cable_length + between, 9)
        shortest = tried[0].cable_length
        tried = list(margins(lengths=lengths[lengths >= shortest].tolist()))
    largest = max(each.margin for each in tried) - ROUNDING
    return min(each for each in tried if each.margin >= largest)


def separating_cables(
    polygons: Sequence[Outline], requirements: Requirements, team: Team
) -> list[float]:
    """Return cable lengths [m] with separated legs on all polygons, as of ``shortest_cable``.

    They are the shortest and longest whose balanced legs keep the limits, and the shortest whose
    legs are well separated; of all slack splits if balanced legs never suffice.
    """
    for balanced in (True, False):
        candidates = _cable_margins(polygons, requirements, team, balanced=balanced)
        feasible = [candidate for candidate in candidates if candidate.margin >= LIMIT_MARGIN]
        if feasible:
            best = max(
                feasible,
                key=lambda each: (round(each.margin, 9), -each.cable_length),
            )
            chosen = (feasible[0], best, feasible[-1])
            return list(dict.fromkeys(candidate.cable_length for candidate in chosen))
    return []


def fitting_lengths(
    polygons: Sequence[Outline], requirements: Requirements, team: Team
) -> Range | None:
    """Return the shortest and longest cable length [m] whose balanced legs keep all distances.

    They do so on all polygons, and at all lengths between, in steps of 5 cm. The longest is
    infinite if none up to MAX_EXTRA_LENGTH beyond the one that legs need is too long. None if no
    length fits.
    """
    fitting: list[float] = []
    for candidate in _cable_margins(polygons, requirements, team, stride=RANGE_STRIDE):
        if candidate.margin >= LIMIT_MARGIN:
            fitting.append(candidate.cable_length)
        elif fitting:
            return Range(fitting[0], fitting[-1])
    return Range(fitting[0], math.inf) if fitting else None


def fitting_tensions(polygons: Sequence[Outline], requirements: Requirements, team: Team) -> Range:
    """Return the smallest and largest tension [N] at which drones and cables hold hitches.

    The largest is the horizontal pull of the weakest drones. The smallest is WEIGHT_SAFETY times
    the lowest one at which heavy cables with balanced legs keep all distances on all polygons, and
    at least that of edges of MAX_EDGE_WEIGHT; zero without weight. Tensions of the team do not
    matter.
    """
    tilt = requirements.limits.tilt
    largest = min(quadrotor.level_pull(tilt)[0] for quadrotor in team.quadrotor)
    if team.cable_density == 0.0:
        return Range(0.0, largest)
    vertices = np.stack([polygon.vertices for polygon in polygons])
    balancing = largest
    for tension in np.geomspace(largest, largest / MAX_TENSION_RATIO, TENSIONS).tolist():
        tensioned = with_fields(team, tension=np.full(team.robots, tension))
        if _margin(tensioned, vertices, requirements) < LIMIT_MARGIN:
            break
        balancing = tension
    longest_edge = max(float(np.max(polygon.edge_lengths)) for polygon in polygons)
    half_weight = 0.5 * GRAVITY * team.cable_density * longest_edge
    smallest = max(WEIGHT_SAFETY * balancing, half_weight / MAX_EDGE_WEIGHT)
    return Range(min(smallest, largest), largest)


class CableMargin(NamedTuple):
    """A cable length that is tried."""

    cable_length: float  # [m] Length of the longest cable of the team
    margin: float  # Smallest margin of legs, as of ``_margin``


def _cable_margins(
    polygons: Sequence[Outline],
    requirements: Requirements,
    team: Team,
    *,
    balanced: bool = True,
    stride: int = 1,
    lengths: Sequence[float] | None = None,
) -> Iterator[CableMargin]:
    """Yield the margins of lengths from the one that legs need on, in the ratios of the team.

    Parameters
    ----------
    balanced: whether legs are balanced, or else those of the best slack split.
    stride: distance of lengths with balanced legs, in steps of CENTIMETRE.
    lengths: these [m] instead.
    """
    ratios = team.cable_length / np.max(team.cable_length)
    vertices = np.stack([polygon.vertices for polygon in polygons])
    edge_lengths = np.stack([polygon.edge_lengths for polygon in polygons])
    needed_by_edges = float(np.max(edge_lengths / ratios))
    needed_by_legs = 2.0 * LIMIT_MARGIN * requirements.limits.leg
    first = math.ceil((needed_by_edges + needed_by_legs) / CENTIMETRE)
    centimetres = np.arange(first, first + round(MAX_EXTRA_LENGTH / CENTIMETRE))
    if lengths is None:
        strided = centimetres[:: stride if balanced else UNBALANCED_STRIDE]
        lengths = (strided / 100.0).tolist()
    for cable_length in lengths:
        sized = with_fields(team, cable_length=cable_length * ratios)
        margin = _margin(sized, vertices, requirements, balanced=balanced)
        yield CableMargin(cable_length, margin)


def _margin(
    team: Team, vertices: Array, requirements: Requirements, *, balanced: bool = True
) -> float:
    """Return the smallest margin of legs on polygons (..., n, 2) [m], of at most SPREAD_MARGIN.

    Legs are balanced, or else those of the best slack split. The margin is negative where cables
    are too short, or clasps have no balance.
    """
    layout = team.layout
    slack = cable_slack_of(team, layout.edges(vertices))
    q_legs = layout.q_legs_of(0.5 * slack, slack)
    legs = layout.legs_of(q_legs, slack)[..., layout.has_leg]
    if np.min(legs) < requirements.limits.leg:  # heavy cables sag
        return -1.0
    task = LegTask(
        team,
        requirements,
        polygons=vertices,
        reference=q_legs,
        shortest_leg=requirements.limits.leg,
        margin=SPREAD_MARGIN,
    )

    def smallest_margin() -> float:
        """Return the smallest margin; splits are those of single polygons, not of a path."""
        if balanced:
            return task.reference_margin()
        pairs = zip(task.polygons, task.reference, strict=True)
        singles = [replace(task, polygons=p[None], reference=legs[None]) for p, legs in pairs]
        return min(single.split().margin for single in singles)

    return min(if_balanced(smallest_margin, -1.0), SPREAD_MARGIN)
