"""The polygon at which a hitch grips an object, what it grips at most, and whether it opens."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from hitchopt.errors import InfeasibleError, InputError, Violation
from hitchopt.hitch import GRAVITY, Hitch, Team
from hitchopt.hitch.requirements import Requirements
from hitchopt.holding.capacity import EASED, Capacity
from hitchopt.holding.grip import largest_tension
from hitchopt.holding.grip_search import GripTask, best_grip, grip_capacity, merit
from hitchopt.holding.wraps import wraps_around
from hitchopt.objects import Section, SolidObject
from hitchopt.planners.carrying.grip import balanced, contacts_of
from hitchopt.planners.carrying.rest import HoldPolygons
from hitchopt.values import Array

FACTOR = 1.5
"""Least slip load over load."""

SEARCHED = 0.9
"""Share of the largest level pull with which polygons are looked for: they do not depend on it."""

LARGER, TURN = np.linspace(1.0, 1.05, 21), math.radians(2.0)
"""Sizes of grips that are tried, over the best one's; and by how much [rad] edges are to turn
before they meet other corners."""

BALANCING = 30
"""Newton's steps with which they are balanced."""

SHARES, BORNE = np.linspace(0.0, 1.0, 9), 1e-6
"""Shares of the weight with which they are tried, and the last step [m] where clasps find balance.
"""

TENSIONS = np.geomspace(0.2, 5.0, 60)
"""[N] Tensions that are tried for a suggestion."""

ROBOTS = (3, 4)
"""Numbers of robots that are tried for a suggestion: more do not wrap enough."""


def grip_task(
    body: SolidObject, team: Team, tension: float, requirements: Requirements
) -> GripTask:
    """Return the search for a grip by a team.

    Raises
    ------
    InputError: cables or drones that differ.
    """
    for name, values in (("cable_length", team.cable_length), ("quadrotor", team.quadrotor)):
        if len(set(values)) > 1:
            bound = "alike for all robots where they grip an object"
            raise InputError(f"team.{name}", list(values), bound, "use one kind")
    return GripTask(
        body.section,
        team.robots,
        float(team.cable_length[0]),
        tension,
        team.cable_friction,
        requirements,
        team.quadrotor[0],
    )


def grip_polygons(
    name: str, body: SolidObject, team: Team, requirements: Requirements, gap: float
) -> HoldPolygons:
    """Return the polygons of the grip whose slip load is largest.

    Parameters
    ----------
    name, body: the object.
    gap: how far edges around it keep from it [m].

    Raises
    ------
    InfeasibleError: no grip was found.
    """
    most, _ = largest_tension(requirements, team.quadrotor[0])
    task = grip_task(body, team, SEARCHED * most, requirements)
    try:
        closed = best_grip(task).vertices[:, :2]
    except InfeasibleError as error:
        words = f"around objects.{name}"
        raise InfeasibleError([replace(v, when=words) for v in error.violations]) from None
    centre = body.centre_of_mass[:2]
    closed = _between_corners(task, closed, centre, GRAVITY * body.mass)
    return HoldPolygons.with_short_edges(closed, centre, (body.section,), gap)


def _between_corners(task: GripTask, closed: Array, centre: Array, weight: float) -> Array:
    """Return a grip (n, 2) [m] whose edges meet no other corners when clasps move a little.

    The best grip often has an edge along a side; clasps of one that is larger by some per cent are
    as far from there as inertia moves them. Of those that bear the weight [N] with drones apart,
    balanced again and within all limits, the one with the largest slip load times the angle by
    which edges may turn is taken.
    """
    section = task.section
    if section.outline is None:
        return closed
    larger = LARGER[:, None, None] * (closed - centre)
    grips, pulls, none = larger, np.ones(larger.shape[:-1]), np.zeros((len(larger), 3))
    for _ in range(BALANCING):
        wraps = wraps_around(section, centre + grips)
        contacts = contacts_of(centre + grips, wraps, section.core)
        level = np.pad(grips, ((0, 0), (0, 0), (0, 1)))
        with np.errstate(divide="ignore", invalid="ignore"):  # clasps that have come to the section
            grips = balanced(level, pulls, contacts - centre, none)[..., :2]
    turns = wraps_around(section, centre + grips).least_turns(section)
    merits = np.array([merit(task, task.grip(each)) for each in centre + grips])
    worth = np.nan_to_num(np.minimum(turns, TURN) * np.maximum(merits, 0.0))
    loaded = _loaded(section, centre, grips, weight / task.tension)
    worth *= [_apart(task, each, weight) for each in centre + loaded]
    found: Array = centre + grips[np.argmax(worth)]
    return found if np.max(worth) > 0.0 else closed


def _apart(task: GripTask, vertices: Array, weight: float) -> bool:
    """Return whether drones of clasps (n, 2) [m] stay apart while edges bear a weight [N]."""
    if np.any(np.isnan(vertices)):
        return False
    try:
        margins = task.margins(task.grip(vertices, weight))
    except InfeasibleError:
        return False
    return float(np.min(margins["separation"])) >= 0.0


def _loaded(section: Section, centre: Array, grips: Array, load: float) -> Array:
    """Return where clasps (grips, n, 2) [m] find balance with a load; nan where they do not.

    About a nearly round outline some hardly resist turning: slopes of edges turn them farther than
    to where there is a balance.

    Parameters
    ----------
    load: weight over tension.
    """
    planned = np.repeat(grips[:, None], len(SHARES), axis=1)
    loads = np.multiply.outer(SHARES, [0.0, 0.0, load])
    clasps = np.pad(planned, ((0, 0), (0, 0), (0, 0), (0, 1)))
    bends, pulls = wraps_around(section, centre + planned).bends, np.ones(planned.shape[:-1])
    with np.errstate(all="ignore"):  # what finds no balance may go anywhere
        for _ in range(BALANCING):
            before, places = clasps, centre + clasps[..., :2]
            contacts = contacts_of(places, wraps_around(section, places, bends), section.core)
            clasps = balanced(clasps, pulls, contacts - centre, loads, (planned, SHARES))
    settled = np.max(np.abs(clasps - before), axis=(1, 2, 3)) < BORNE
    return np.where(settled[:, None, None], clasps[:, -1, :, :2], np.nan)


def check_pull(tension: float, team: Team, requirements: Requirements) -> None:
    """Raise InfeasibleError for level pulls that no drone can hold."""
    most, binding = largest_tension(requirements, team.quadrotor[0])
    if tension <= most:
        return
    own = requirements.limits
    remedy = f"grasp with a tension of {most:.3g} N or less"
    if binding == "tilt":
        needed = np.degrees(np.arctan(tension / (9.81 * team.mass[0])))
        remedy = (
            f"level pulls of {tension:.3g} N need limits.tilt_deg of {np.ceil(needed) + 5:.0f}, "
            f"above {np.degrees(own.tilt):.3g}; or {remedy}"
        )
    raise InfeasibleError(
        [Violation(binding, tension, most, "max", "N", (), "to grip at rest", remedy)]
    )


def capacity_of(
    body: SolidObject, closed: Array, team: Team, tension: float, requirements: Requirements
) -> Capacity:
    """Return the largest mass [kg] that is gripped with a tension, and what binds."""
    task = grip_task(body, team, tension, requirements)
    return grip_capacity(task, task.grip(closed), body.friction, FACTOR)


def grip_suggestion(
    name: str,
    body: SolidObject,
    closed: Array,
    team: Team,
    tension: float,
    requirements: Requirements,
) -> tuple[Capacity, str]:
    """Return what is gripped, and in words what to change so that the object is.

    Parameters
    ----------
    name, body: the object.
    closed: (n, 2) [m], clasps in its frame.
    team, tension: as asked for.
    requirements: limits and distances.
    """
    capacity = capacity_of(body, closed, team, tension, requirements)
    ways = []
    if capacity.mass > 0.0:
        ways.append(f"lower objects.{name}.mass to {EASED * capacity.mass:.3g} kg")
    most, _ = largest_tension(requirements, team.quadrotor[0])
    for value in TENSIONS[(tension < TENSIONS) & (most > TENSIONS)]:
        if EASED * capacity_of(body, closed, team, float(value), requirements).mass >= body.mass:
            ways.append(f"ask for a tension of {value:.3g} N")
            break
    if capacity.binding == "grip" and capacity.mass > 0.0:
        rougher = body.friction * body.mass / (EASED * capacity.mass)
        ways.append(f"use rougher cables, objects.{name}.friction {rougher:.3g} or more")
    for robots in ROBOTS:
        if robots == team.robots:
            continue
        task = replace(grip_task(body, team, tension, requirements), robots=robots)
        try:
            found = grip_capacity(task, best_grip(task), body.friction, FACTOR)
        except InfeasibleError:
            continue
        if EASED * found.mass >= body.mass:
            ways.append(f"use {robots} robots")
    return capacity, ", or ".join(ways) or "give it a rim, or use stronger quadrotors"


PASSES = 60
"""Times that an angle and the friction over it are computed from each other."""

OUTWARD = 0.02
"""[m] Clasps are opened that go outward by more: they are nowhere to a centimetre."""


def check_opens(hitch: Hitch, around: Array, requirements: Requirements, remedy: str) -> None:
    """Raise InfeasibleError where friction keeps legs from opening a hitch.

    A clasp opens where its legs, which enclose β, pull outward by more than its edges do inward:
    ``cos(β/2) > e^{μ θ} cos(β_edges/2)``, μ the cables' friction and θ the mean of both angles, by
    which cables turn. Legs enclose the least angle where their drones are side by side.

    Parameters
    ----------
    hitch: closed, as it is now.
    around: (n, 2) [m], where its vertices are to go, as seen from a common centre or not.
    requirements: the distance of drones.
    remedy: what to change.
    """
    friction, layout = hitch.team.cable_friction, hitch.team.layout
    if friction == 0.0 or np.any(hitch.roll):
        return
    here = hitch.polygon.vertices
    inward = [np.roll(here, shift, axis=0) - here for shift in (-1, 1)]
    ahead, behind = (each / np.linalg.norm(each, axis=1, keepdims=True) for each in inward)
    outward = -(ahead + behind) / np.linalg.norm(ahead + behind, axis=1, keepdims=True)
    moved = (around - np.mean(around, axis=0)) - (here - np.mean(here, axis=0))
    opened = np.sum(outward * moved, axis=1) > OUTWARD
    edges = np.arccos(np.clip(np.sum(ahead * behind, axis=1), -1.0, 1.0))
    d, e = hitch.legs[layout.ahead, 0], hitch.legs[layout.behind, 1]
    apart = 2.0 * requirements.separation.radius
    legs = np.arccos(np.clip((d**2 + e**2 - apart**2) / (2.0 * d * e), -1.0, 1.0))
    turned, room = 0.5 * (edges + legs), np.log(np.cos(0.5 * legs) / np.cos(0.5 * edges))
    excess = np.where(opened, np.exp(friction * turned - room), 0.0)
    worst = int(np.argmax(excess))
    if excess[worst] <= 1.0:
        return
    where, words = (hitch.team.point_names[layout.clasps[worst]],), "as the hitch opens"
    smoother = room[worst] / turned[worst]
    if smoother > 0.0:
        smoother = math.floor(1000.0 * smoother) / 1000.0
        remedy = f"{remedy}, or use smoother cables, team.cable_friction {smoother:.3g} or less"
    raise InfeasibleError(
        [Violation("equilibrium", float(excess[worst]), 1.0, "max", "ratio", where, words, remedy)]
    )


def grip_left(legs: Array, tension: Array, clasp_friction: float, friction: float) -> float:
    """Return the largest slip load [N] of a hitch that has been opened as far as friction lets it.

    Where legs enclose β, cables slide on each other until edges enclose ``β_edges``, ``cos(β_edges
    /2) = e^{-μ θ} cos(β/2)``, θ the mean of both angles and μ the cables' friction. What these
    angles add up to beyond those of a polygon is wrapped around the object.

    Parameters
    ----------
    legs: (n, 2, 2) [m], the two legs at every clasp as seen from above.
    tension: (n,) [N], of legs.
    clasp_friction: coefficient of cables on each other.
    friction: coefficient of cables on the object.
    """
    directions = legs / np.linalg.norm(legs, axis=-1, keepdims=True)
    between = np.arccos(np.clip(np.sum(directions[:, 0] * directions[:, 1], axis=-1), -1.0, 1.0))
    edges = between
    for _ in range(PASSES):
        rubbed = np.exp(-clasp_friction * 0.5 * (edges + between))
        edges = 2.0 * np.arccos(rubbed * np.cos(0.5 * between))
    wrapped = max(float(np.sum(edges)) - (len(legs) - 2) * math.pi, 0.0)
    return friction * float(np.max(tension) / np.min(rubbed)) * wrapped
