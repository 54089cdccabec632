"""Polygons, cable lengths and tensions that fit objects, outlines and drones, by statics alone.

The enclosing polygon has short edges of similar lengths at the clearance from the outline. Cables
are the shortest that keep the separation of the drones.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from hitchopt.errors import InfeasibleError, Violation
from hitchopt.geometry import ConvexPolygon, Outline
from hitchopt.geometry.vectors import dot, left_of, length, turn, unit
from hitchopt.hitch.forces import cable_slack_of
from hitchopt.hitch.holding import Grip
from hitchopt.hitch.quadrotor import GRAVITY
from hitchopt.hitch.requirements import Requirements
from hitchopt.hitch.slack_split import LIMIT_MARGIN, SPREAD_MARGIN, LegTask
from hitchopt.hitch.team import Team
from hitchopt.objects import Section
from hitchopt.planners.carrying.polygons import (
    EDGE_MARGIN,
    GRIP_STRETCHES,
    GripTask,
    HoldPolygons,
    best_grip,
)
from hitchopt.values import Array
from hitchopt.values.fields import with_fields

AXES = 24
"""Number of directions of stretch of enclosing polygons; those of the section's sides are added."""

ROTATIONS = 16
"""Number of rotations of enclosing polygons within a period of symmetry."""

ASPECT_RATIOS = np.geomspace(0.25, 4.0, 41)
"""Aspect ratios of enclosing polygons over the section's own."""

MIN_TURN = 0.6
"""Smallest exterior angle, over the mean."""

MIN_EDGE = 0.5
"""Smallest edge, over the mean."""

ROUNDING = 1e-9
"""Tolerance within which lengths or margins are equal."""

CENTIMETRE = 0.01
"""[m] Step of cable lengths."""

STRIDE = 20
"""Stride of candidates with unbalanced legs, in these steps."""

RANGE_STRIDE = 5
"""Stride of ranges, in these steps."""

MAX_EXTRA_LENGTH = 1.0
"""[m] Largest length beyond the one that legs need."""

WEIGHT_SAFETY = 2.0
"""Smallest tension over the one from which on heavy cables balance."""

MAX_EDGE_WEIGHT = 0.35
"""Largest weight of half an edge over its tension. The sag of second order errs in the balance by
the fourth power of it over six: 0.0025 of the tension, half of what clasps may be out of balance.
"""

MAX_TENSION_RATIO = 30.0
"""Largest over smallest tension of the search."""

TENSIONS = 60
"""Number of tensions of the search."""

Range = tuple[float, float]  # Smallest and largest value


def enclosing_polygon(section: Section, n: int, clearance: float) -> ConvexPolygon:
    """Return an n-gon of short edges of similar lengths at a distance [m] from a section.

    Candidates have the edge directions of regular polygons, rotated and stretched in proportion to
    the section's widths. The one with the least sum of squared edge lengths is taken.
    InfeasibleError: all have flat corners or short edges, as around a narrow section.
    """
    sides = np.roll(section.core, -1, axis=0) - section.core
    angles = np.append(math.pi * np.arange(AXES) / AXES, np.arctan2(sides[:, 1], sides[:, 0]))
    cosines, sines = np.cos(angles), np.sin(angles)
    axes = np.stack([cosines, sines, -sines, cosines], axis=-1).reshape(-1, 2, 2)
    widths = 0.5 * (section.support(axes) + section.support(-axes)) + clearance
    ratios = np.column_stack([np.sqrt(ASPECT_RATIOS), 1.0 / np.sqrt(ASPECT_RATIOS)])
    turns = 2.0 * math.pi / n * (np.arange(ROTATIONS)[:, None] / ROTATIONS - np.arange(n))
    regular = np.stack([np.cos(turns), np.sin(turns)], axis=-1)
    shapes = np.einsum("aj,kj,tnj,aji->aktni", widths, ratios, regular, axes).reshape(-1, n, 2)
    edges = unit(np.roll(shapes, -1, axis=-2) - shapes)
    outward = left_of(edges)
    distances = section.support(outward) + clearance
    pairs = np.stack([np.roll(outward, 1, axis=-2), outward], axis=-2)
    reaches = np.stack([np.roll(distances, 1, axis=-1), distances], axis=-1)
    corners = np.linalg.solve(pairs, reaches[..., None])[..., 0]
    onward = np.roll(corners, -1, axis=-2) - corners
    sizes = length(onward)
    right_turns = turn(onward, np.roll(onward, 1, axis=-2))
    feasible = np.isclose(np.sum(right_turns, axis=-1), 2.0 * math.pi)
    feasible &= np.all(right_turns >= MIN_TURN * 2.0 * math.pi / n, axis=-1)
    feasible &= np.min(sizes, axis=-1) >= MIN_EDGE * np.mean(sizes, axis=-1)
    feasible &= np.all(dot(onward, edges) > 0.0, axis=-1)
    if not np.any(feasible):
        violation = Violation("convexity", n, n - 1, "max", "edges", (), "", "use fewer robots")
        raise InfeasibleError([violation], "the section is too narrow for so many edges around it")
    squares = np.where(feasible, np.sum(onward**2, axis=(-2, -1)), np.inf)
    return ConvexPolygon(corners[np.argmax(squares <= (1.0 + ROUNDING) * np.min(squares))])


def shortest_cable(polygons: Sequence[Outline], requirements: Requirements) -> float:
    """Return the shortest cable length [m], in centimetres, with well separated balanced legs.

    They are separated on all polygons, of the same number of robots. If there is no such length,
    return the one with the largest margin over all slack splits. Cables have no weight, and drones
    carry no load. InfeasibleError: no length up to MAX_EXTRA_LENGTH keeps drones separated.
    """
    team = Team(len(polygons[0]), 1.0)
    for balanced in (True, False):
        best, shortest = 0.0, 0.0
        for cable, margin in _margins(polygons, requirements, team, balanced=balanced):
            if margin > best + ROUNDING:
                best, shortest = margin, cable
            if best >= SPREAD_MARGIN:
                break
        if best >= LIMIT_MARGIN:
            return shortest
    remedy = f"{'use fewer robots, or ' if len(polygons[0]) > 3 else ''}change the clearance"
    violation = Violation("separation", best, LIMIT_MARGIN, "min", "ratio", (), "", remedy)
    raise InfeasibleError([violation], "no cable length separates the drones around the object")


def separating_cables(
    polygons: Sequence[Outline], requirements: Requirements, team: Team
) -> list[float]:
    """Return cable lengths [m] with separated legs on all polygons, as of ``shortest_cable``.

    They are the shortest and longest whose balanced legs keep the limits, and the shortest whose
    legs are well separated; of all slack splits if balanced legs never suffice.
    """
    lengths: list[float] = []
    for balanced in (True, False):
        pairs = list(_margins(polygons, requirements, team, balanced=balanced))
        feasible = [pair for pair in pairs if pair[1] >= LIMIT_MARGIN]
        if feasible:
            best = max(feasible, key=lambda pair: (round(pair[1], 9), -pair[0]))
            lengths = [feasible[0][0], best[0], feasible[-1][0]]
            break
    return list(dict.fromkeys(lengths))


def fitting_lengths(
    polygons: Sequence[Outline], requirements: Requirements, team: Team
) -> Range | None:
    """Return the shortest and longest cable length [m] whose balanced legs keep all distances.

    They do so on all polygons, and at all lengths between, in steps of 5 cm. The longest is
    infinite if none up to MAX_EXTRA_LENGTH beyond the one that legs need is too long. None if no
    length fits.
    """
    first = last = 0.0
    for cable, margin in _margins(polygons, requirements, team, stride=RANGE_STRIDE):
        if margin >= LIMIT_MARGIN:
            first, last = first or cable, cable
        elif first:
            return first, last
    return (first, math.inf) if first else None


def fitting_tensions(polygons: Sequence[Outline], requirements: Requirements, team: Team) -> Range:
    """Return the smallest and largest tension [N] at which drones and cables hold hitches.

    The largest is the level pull of the weakest drones. The smallest is WEIGHT_SAFETY times the one
    from which on heavy cables with balanced legs keep all distances on all polygons, and at least
    that of edges of MAX_EDGE_WEIGHT; zero without weight. Tensions of the team do not matter.
    """
    smallest = largest = min(x.level_pull(requirements.limits.tilt)[0] for x in team.quadrotor)
    if team.cable_density == 0.0:
        return 0.0, largest
    vertices = np.stack([each.vertices for each in polygons])
    for tension in np.geomspace(largest, largest / MAX_TENSION_RATIO, TENSIONS).tolist():
        stretched = with_fields(team, tension=np.full(team.robots, tension))
        if _margin(stretched, vertices, requirements) < LIMIT_MARGIN:
            break
        smallest = tension
    longest_edge = max(float(np.max(each.edge_lengths)) for each in polygons)
    half_weight = 0.5 * GRAVITY * team.cable_density * longest_edge
    smallest = max(WEIGHT_SAFETY * smallest, half_weight / MAX_EDGE_WEIGHT)
    return min(smallest, largest), largest


def _margins(
    polygons: Sequence[Outline],
    requirements: Requirements,
    team: Team,
    *,
    balanced: bool = True,
    stride: int = 1,
) -> Iterator[tuple[float, float]]:
    """Yield lengths [m] of the longest cable with the margins of all legs (``_margin``)."""
    leg = requirements.limits.leg
    ratios = team.cable_length / np.max(team.cable_length)
    vertices = np.stack([polygon.vertices for polygon in polygons])
    edge_lengths = np.stack([polygon.edge_lengths for polygon in polygons])
    needed = np.max(edge_lengths / ratios)
    first = math.ceil((float(needed) + 2.0 * LIMIT_MARGIN * leg) / CENTIMETRE)
    lengths = np.arange(first, first + round(MAX_EXTRA_LENGTH / CENTIMETRE)) / 100.0
    for cable in lengths[:: stride if balanced else STRIDE].tolist():
        cut = with_fields(team, cable_length=cable * ratios)
        yield cable, _margin(cut, vertices, requirements, balanced=balanced)


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
    try:
        margin = task.reference_margin() if balanced else _smallest_split_margin(task)
    except InfeasibleError:
        return -1.0
    return min(margin, SPREAD_MARGIN)


def _smallest_split_margin(task: LegTask) -> float:
    """Return the smallest margin of the best splits of single polygons.

    They are split one by one, as a path of polygons is split from its reference only.
    """
    margins = list[float]()
    for j in range(len(task.polygons)):
        polygon = task.polygons[j : j + 1]
        single = replace(task, polygons=polygon, reference=task.reference[j : j + 1])
        margins.append(single.split().margin)
    return min(margins)


def grip_and_cable(task: GripTask, clearance: float) -> tuple[Grip, float]:
    """Return the grip with the largest slip load, and its cable length [m].

    It is that of the task, or longer if the polygon needs it that encloses the section with a
    ``clearance`` [m] before the grip closes. InfeasibleError: the search failed.
    """
    grip = best_grip(task)
    # ``enclose`` adds a margin for errors of the object's pose around the closed grip
    gap = clearance + EDGE_MARGIN
    centre = task.section.centroid
    polygons = HoldPolygons.about(grip.vertices, centre, (task.section,), gap, GRIP_STRETCHES)
    around = polygons.around
    try:
        needed = shortest_cable([ConvexPolygon(around)], task.requirements)
        if needed > task.cable_length:
            return best_grip(replace(task, cable_length=needed)), needed
    except InfeasibleError:  # the shorter cable grips, but may not enclose
        pass
    return grip, task.cable_length
