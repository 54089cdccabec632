"""Wild families: how many problems of each family are planned and proven, and in what time.

Usage: python -m benchmarks families [FAMILY ...] [--problems N] [--first SEED]

Families: ``form``, irregular hitches tied from scattered robots; ``scattered_form``, those of 3 to
10 robots on the ground, with light and heavy cables; ``carry``, objects held by rims or
grips, half of them beside a table; ``fitted`` and ``overloaded``, objects carried with the cables
that ``fit`` states, and at most, or 1.05 times, the mass that it states; ``morph`` and
``heavy_morph``, irregular hitches into each other; ``past_post``, ``past_pillars``, ``past_team``
and ``tube``, such morphs past a post, past pillars and walls, past another team that stays or
crosses, and with tracking errors; ``many``, of 20 and 24 robots; ``chain``, of two cables;
``curves``, letters and closed curves that a vertex writes; ``timed``, such curves with the times of
their points; ``blends``, steps in a row without a stop; ``timed_blends``, steps of all kinds, some
of which blend or have durations; ``box``, ``door`` and ``corridor``, single
drones in tight boxes, through doors and past each other. Both ends of every problem are certified
at rest before it is planned, those of ``carry`` are drawn by geometry alone, and none is left out
afterwards.
"""

from __future__ import annotations

import math
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable
from functools import partial
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.distance import pdist

import hitchopt as ho
from benchmarks.measuring import Array, Table, most_common, parser
from hitchopt import verify
from hitchopt.motion.motion import Motion
from problems.random_morph import (
    WILD_EDGE,
    WILD_SLACK,
    is_certified,
    random_convex_polygon,
    wild_morph,
    wild_polygon,
)
from problems.random_steps import (
    random_blend,
    random_curve,
    random_timed_blend,
    random_timed_curve,
)
from problems.swarm import random_box, random_corridor, random_door

LIMITATIONS = (
    "one machine, one run each; processor time of planning alone, with the certificate's; planned "
    "ones are certified, proven ones also by hitchopt verify; refused ones by the first limit "
    "named; the search is local: failure does not prove infeasibility; over bound: duration over "
    "the sum of what the slowest drone or vertex of each phase takes alone, from rest to rest, "
    "within the limits of speed and acceleration"
)

FORM_ROBOTS = range(3, 9)
"""Numbers of robots of hitches that are tied or morphed, in turn."""

CARRY_ROBOTS = range(3, 7)
"""Numbers of robots that carry an object, in turn."""

CABLE_DENSITY = 0.005
"""Density of cables that hang or hold objects [kg/m]."""

FORM_ALTITUDE = (1.2, 1.8)
"""Altitude of formed hitches, minimum and maximum [m]."""

SPAN = (0.35, 0.85)
"""Distance of the drones of a hanging cable over its length, minimum and maximum."""

HOVER = (1.0, 2.0)
"""Mean heights of hovering pairs, minimum and maximum [m]."""

HOVER_STEP = 0.15
"""Largest difference of a hovering drone from its pair's mean height [m]."""

START_TRIES = 20
"""Number of starts that are drawn for a goal before another goal is drawn."""

MIN_REACH = 0.8
"""Half the width of the square in which robots start, over the root of their number [m]."""

REACH_GROWTH = 1.01
"""Factor by which the square grows until all robots fit in."""

ROBOTS_APART = 0.9
"""Smallest distance of the middles of two robots at the start, in plan view [m]."""

DRONES_APART = 0.35
"""Smallest distance of two drones at the start, in plan view [m]."""


def wild_form(seed: int) -> dict[str, Any]:
    """Return a problem that ties an irregular n-gon from robots scattered about it.

    Half of the teams have equal cables, half stand on the ground and half hover, and a third take
    the edges in their order.
    """
    n = _robots(seed, FORM_ROBOTS)
    rng = np.random.default_rng([n, seed, 1])
    edge, on_ground = rng.uniform(*WILD_EDGE), bool(rng.random() < 0.5)
    equal, fixed = bool(rng.random() < 0.5), bool(rng.random() < 1.0 / 3.0)
    slack = rng.uniform(*WILD_SLACK)
    altitude = round(float(rng.uniform(*FORM_ALTITUDE)), 2)
    start = None
    while start is None:
        polygon = wild_polygon(n, edge, rng).translated(rng.uniform(-0.5, 0.5, 2))
        lengths = polygon.edge_lengths
        cables = np.full(n, np.max(lengths) + slack)
        if not equal:
            cables = lengths + rng.uniform(WILD_SLACK[0], max(slack, 0.8), n)
        cables = np.round(cables, 2)
        corners = np.round(polygon.vertices, 3).tolist()
        if not _is_convex(corners):
            continue
        hitch = {"polygon": corners, "altitude": altitude, "legs": "spread"}
        if is_certified(_team(cables), {"hitch": hitch}):
            order = np.arange(n) if fixed or equal else rng.permutation(n)
            start = _certified_start(cables[order], on_ground, rng)
    form = {"polygon": corners, "altitude": altitude, **({"assign": "fixed"} if fixed else {})}
    return {
        "title": f"Wild form, n = {n}, seed {seed}",
        "team": _team(cables[order]),
        "start": {"drones": start},
        "mission": [{"form": form}],
    }


SCATTERED_ROBOTS = range(3, 11)
"""Numbers of robots that tie a polygon of random edges, in turn."""

SCATTERED_SIZE = (1.4, 3.2)
"""Width of a polygon of random edges along its longer side, minimum and maximum [m]."""

SCATTERED_SLACK = (0.5, 2.2)
"""Length of its cables beyond its longest edge, minimum and maximum [m]."""

SHORTEST_EDGE = 0.15
"""Shortest edge of such a polygon [m]."""

SCATTERED_DENSITY = (0.001, 0.02)
"""Density of its cables, minimum and maximum [kg/m], drawn evenly on a logarithmic scale."""

SCATTERED_TENSION = (0.3, 0.8)
"""Tension of its cables, minimum and maximum [N]."""

SCATTERED_ALTITUDE = (0.8, 2.0)
"""Altitude at which it is tied, minimum and maximum [m]."""


def scattered_form(seed: int) -> dict[str, Any]:
    """Return a problem that ties a polygon of random edges from robots scattered on the ground.

    Edges are as uneven as those of a random convex polygon, cables light or heavy, and their
    tension is drawn independently. Three of four teams have the tracking errors of a drone's model.
    """
    n = _robots(seed, SCATTERED_ROBOTS)
    rng = np.random.default_rng([n, seed, 7])
    while True:
        corners = np.round(_random_edges(n, rng) * rng.uniform(*SCATTERED_SIZE), 3)
        lengths = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
        density = math.exp(rng.uniform(*np.log(SCATTERED_DENSITY)))
        team: dict[str, Any] = {
            "robots": n,
            "cable_length": round(float(np.max(lengths) + rng.uniform(*SCATTERED_SLACK)), 2),
            "cable_density": round(density, 4),
            "tension": round(float(rng.uniform(*SCATTERED_TENSION)), 2),
        }
        if seed // len(SCATTERED_ROBOTS) % 4:
            team["quadrotor"] = "paper_132g"
        altitude = round(float(rng.uniform(*SCATTERED_ALTITUDE)), 2)
        if np.min(lengths) < SHORTEST_EDGE or not _is_convex(corners.tolist()):
            continue
        form = {"polygon": corners.tolist(), "altitude": altitude}
        if not is_certified(team, {"hitch": {**form, "legs": "spread"}}):
            continue
        drones = _scattered(np.full(n, team["cable_length"]), True, rng)
        if is_certified(team, {"drones": drones}):
            break
    return {
        "title": f"Scattered form, n = {n}, seed {seed}",
        "team": team,
        "start": {"drones": drones},
        "mission": [{"form": form}],
    }


def _random_edges(n: int, rng: np.random.Generator) -> Array:
    """Return a random convex polygon (n, 2), clockwise about the origin, of width 1 (Valtr 1995).

    Steps between sorted random coordinates, which sum to zero along either axis, are paired at
    random; the edges follow each other by their headings.
    """
    steps = np.empty((n, 2))
    for axis in range(2):
        inner = rng.uniform(size=n - 2)
        upper = rng.random(n - 2) < 0.5
        up, down = (np.sort(np.concatenate([[0.0, 1.0], inner[side]])) for side in (upper, ~upper))
        steps[:, axis] = rng.permutation(np.concatenate([np.diff(up), -np.diff(down)]))
    headings = np.arctan2(steps[:, 1], steps[:, 0])
    corners: Array = np.cumsum(steps[np.argsort(-headings)], axis=0)
    return np.asarray(corners - np.mean(corners, axis=0))


def _is_convex(corners: list[list[float]]) -> bool:
    """Return whether rounded corners of a polygon are still those of a convex one."""
    try:
        ho.ConvexPolygon(corners)
    except ho.HitchoptError:
        return False
    return True


def _robots(seed: int, numbers: range) -> int:
    """Return the number of robots of a seed: all numbers in turn."""
    return numbers[seed % len(numbers)]


def _team(cables: Array) -> dict[str, Any]:
    """Return a team with cable lengths (n,) [m]."""
    lengths = cables.tolist() if np.ptp(cables) else float(cables[0])
    return {"robots": len(cables), "cable_length": lengths, "cable_density": CABLE_DENSITY}


def _certified_start(
    cables: Array, on_ground: bool, rng: np.random.Generator
) -> dict[str, Any] | None:
    """Return positions of drones at which robots with cables (n,) [m] are certified at rest."""
    for _ in range(START_TRIES):
        start = _scattered(cables, on_ground, rng)
        if is_certified(_team(cables), {"drones": start}):
            return start
    return None


def _scattered(cables: Array, on_ground: bool, rng: np.random.Generator) -> dict[str, Any]:
    """Return random positions of drones in a square, with hanging cables (n,) [m]."""
    n, reach = len(cables), MIN_REACH * math.sqrt(len(cables))
    while True:
        middles = rng.uniform(-reach, reach, (n, 2))
        angles = rng.uniform(-math.pi, math.pi, n)
        arms = 0.5 * (rng.uniform(*SPAN, n) * cables)[:, None]
        arms = arms * np.column_stack([np.cos(angles), np.sin(angles)])
        places = np.stack([middles - arms, middles + arms], axis=1)
        apart = np.min(pdist(middles)) > ROBOTS_APART
        if apart and np.min(pdist(places.reshape(-1, 2))) > DRONES_APART:
            break
        reach *= REACH_GROWTH
    heights = np.zeros((n, 2))
    if not on_ground:
        heights = rng.uniform(*HOVER, n)[:, None] + rng.uniform(-HOVER_STEP, HOVER_STEP, (n, 2))
    drones = np.round(np.concatenate([places, heights[..., None]], axis=-1), 3)
    return {"q": drones[:, 0].tolist(), "r": drones[:, 1].tolist()}


CARRY_ALTITUDE = 1.3
"""Altitude of a hitch before it takes an object [m]."""

MAX_GRIPPING = 4
"""Largest number of robots that grip: more hold less."""

RIM_SHARE = 0.7
"""Share of the objects that rest on a rim; the others are gripped."""

HALF_WIDTH = (0.18, 0.28)
"""Half of the smaller width of a rim or of a gripped object, minimum and maximum [m]."""

ASPECT = (1.0, 1.5)
"""Width of an object along its longer axis, over the smaller one, minimum and maximum."""

STEM_SHARE = {3: (0.2, 0.35), 4: (0.3, 0.5), 5: (0.3, 0.5), 6: (0.3, 0.5)}
"""Ratio of the body's width to that of its rim, minimum and maximum, by number of robots: three
clasps form a triangle, which leaves less room for it."""

RIM_HEIGHT = (0.3, 0.45)
"""Height of rims above the ground, minimum and maximum [m]."""

RESTING_MASS = (0.1, 0.4)
"""Mass of objects on rims, minimum and maximum [kg]."""

GRIPPED_MASS = (0.04, 0.1)
"""Mass of gripped objects, minimum and maximum [kg]."""

AROUND = 0.09
"""Distance of the hitch around an object to an ellipse about the object [m]."""

LEG = 0.29
"""Shortest leg of cables whose edge is the longest [m]; drones of a triangle are 27 cm apart."""

EXTRA_CABLE = (0.0, 0.2)
"""Length of cables beyond it, minimum and maximum [m]."""

START_SCALE = (0.9, 1.1)
"""Size of the hitch at the start over that around the object, minimum and maximum."""

UNEVEN = 0.1
"""Largest turn of a vertex of the hitch at the start, over the angle between two."""

BESIDE = (0.15, 0.55)
"""Distance of a table to drones at the ends of level legs around the object, as a range [m]."""

TABLE_HEIGHT = (0.2, 0.6)
"""Height of a table, minimum and maximum [m]."""

PLACES = (1.2, 2.2)
"""Distance of the object from the hitch and of its goal from its start, minimum and maximum [m]."""

LIMITS = {"tilt_deg": 60}
"""Limits of teams that carry."""


def wild_carry(seed: int) -> dict[str, Any]:
    """Return a problem in which a hitch takes an object and sets it down elsewhere.

    It follows from random numbers and geometry alone, so that one seed is one problem whatever the
    planner and the certificate find. The hitch around the object is a regular polygon that is
    stretched about an ellipse; cables leave legs beyond its edges and those at the start.
    """
    n = _robots(seed, CARRY_ROBOTS)
    rng = np.random.default_rng([n, seed, 2])
    rests = bool(n > MAX_GRIPPING or rng.random() < RIM_SHARE)
    is_round = bool(rng.random() < 0.3)
    half = float(rng.uniform(*HALF_WIDTH))
    widths = np.array([half, half if is_round else half * float(rng.uniform(*ASPECT))])
    axes = widths if is_round else math.sqrt(2.0) * widths  # of an ellipse through its corners
    directions = rng.uniform(-math.pi, math.pi, 3)
    away, onward = rng.uniform(*PLACES, 2)
    at = away * np.array([math.cos(directions[0]), math.sin(directions[0])])
    to = at + onward * np.array([math.cos(directions[1]), math.sin(directions[1])])
    body: dict[str, Any] = {"at": [*_rounded(at), 0.0]}
    body["yaw_deg"] = round(float(rng.uniform(0.0, 360.0)), 1)
    if rests:
        share, height = float(rng.uniform(*STEM_SHARE[n])), float(rng.uniform(*RIM_HEIGHT))
        body |= {**_section(share * widths, is_round), "to": round(height + 0.05, 3)}
        body["rim"] = {"at": round(height, 3), **_section(widths, is_round)}
        body["mass"] = round(float(rng.uniform(*RESTING_MASS)), 3)
    else:
        body |= {**_section(widths, is_round), "to": round(float(rng.uniform(0.25, 0.4)), 3)}
        body |= {"mass": round(float(rng.uniform(*GRIPPED_MASS)), 3), "friction": 0.6}
    table: tuple[float, float] | None = None
    if rng.random() < 0.5:
        table = float(rng.uniform(*BESIDE)), float(rng.uniform(*TABLE_HEIGHT))
    radius = float(np.sqrt(np.mean((axes + AROUND) ** 2))) / math.cos(math.pi / n)
    uneven = UNEVEN * rng.uniform(-1.0, 1.0, n)
    angles = rng.uniform(0.0, 2.0 * math.pi) - 2.0 * math.pi / n * (np.arange(n) + uneven)
    polygon = radius * rng.uniform(*START_SCALE) * np.stack([np.cos(angles), np.sin(angles)], -1)
    longest = float(np.max(np.linalg.norm(np.roll(polygon, -1, axis=0) - polygon, axis=1)))
    longest = max(longest, 2.0 * radius * math.sin(math.pi / n))
    cable = longest + 2.0 * LEG + float(rng.uniform(*EXTRA_CABLE))
    team: dict[str, Any] = {"robots": n, "cable_length": round(cable, 2)}
    team |= {"cable_density": CABLE_DENSITY, "tension": 1.0}
    team |= {} if rests else {"cable_friction": 0.15}
    objects = {"thing": body}
    if table is not None:
        beside, height = table
        reach = radius + 0.5 * cable - radius * math.sin(math.pi / n)
        away_from = reach + beside + 0.5 * TABLE_DEPTH
        centre = away_from * np.array([math.cos(directions[2]), math.sin(directions[2])])
        is_goal = bool(np.linalg.norm(to - at - centre) < TABLE_RADIUS)
        side = directions[2] + math.pi * is_goal  # the goal is on the ground
        objects["table"] = _table(at, reach + beside, side, height)
    carry: dict[str, Any] = {"object": "thing", "to": [*_rounded(to), 0.0]}
    carry |= {"yaw_deg": round(float(rng.uniform(-120.0, 120.0)), 1)}
    carry |= {} if rests else {"tension": 1.3}
    return {
        "title": f"Wild carry, n = {n}, seed {seed}",
        "team": team,
        "limits": LIMITS,
        "objects": objects,
        "start": {"hitch": {"polygon": np.round(polygon, 3).tolist(), "altitude": CARRY_ALTITUDE}},
        "mission": [{"transport_object": carry}],
    }


def _table(at: Array, distance: float, direction: float, height: float) -> dict[str, Any]:
    """Return a table whose longer side faces an object at (2,) [m], at a distance [m]."""
    side = np.array([math.cos(direction), math.sin(direction)])
    return {
        "outline": TABLE,
        "to": round(height, 3),
        "fixed": True,
        "at": [*_rounded(at + (distance + 0.5 * TABLE_DEPTH) * side), 0.0],
        "yaw_deg": round((math.degrees(direction) + 90.0) % 360.0, 1),
    }


TABLE_DEPTH = 0.6
"""Depth of a table, in the direction of the object [m]."""

TABLE_RADIUS = 0.67
"""Distance of a table's corners from its middle [m]."""

RECTANGLE = np.array([[-1.0, -1.0], [-1.0, 1.0], [1.0, 1.0], [1.0, -1.0]])
"""Corners of a rectangle of half widths 1, clockwise."""

TABLE = [[-0.6, -0.3], [0.6, -0.3], [0.6, 0.3], [-0.6, 0.3]]
"""Outline of a table [m]."""


def _rounded(point: Array) -> list[float]:
    """Return a point in whole millimetres."""
    return [round(float(x), 3) for x in point]


def _section(half_widths: Array, is_round: bool) -> dict[str, Any]:
    """Return the section of an object with half widths (2,) [m]."""
    a, b = (round(float(x), 3) for x in half_widths)
    return {"circle": a} if is_round else {"outline": [[-a, -b], [a, -b], [a, b], [-a, b]]}


FITTED_ROBOTS = range(3, 6)
"""Numbers of robots whose cables and mass ``fit`` states, in turn."""

FITTED_TENSION = (0.8, 1.3)
"""Tension of these cables, minimum and maximum [N]."""

FITTED_DENSITY = (0.001, 0.005)
"""Density of these cables, minimum and maximum [kg/m]."""

FITTED_SHARE = (0.3, 1.0)
"""Mass of an object over the largest one that ``fit`` states, minimum and maximum."""

OVERLOAD = 1.05
"""Mass of an object that is too heavy, over the largest one that ``fit`` states."""

LEAST_MASS = 0.03
"""Smallest mass that ``fit`` states of an object that is drawn [kg]."""


def fitted_carry(seed: int, *, overloaded: bool = False) -> dict[str, Any]:
    """Return a problem in which a hitch with the numbers that ``fit`` states carries an object.

    Rims are round or oblong above a round stem, and gripped objects are round, oblong or
    triangular. The mass is a share of what ``fit`` states, or OVERLOAD times it.
    """
    n = _robots(seed, FITTED_ROBOTS)
    rng = np.random.default_rng([n, seed, 8])
    while True:
        rests = bool(n > MAX_GRIPPING or rng.random() < RIM_SHARE)
        outline = _fitted_outline(rng, rests=rests)
        section = ho.Section(radius=outline) if isinstance(outline, float) else ho.Section(outline)
        width = float(np.min(section.support(np.eye(2)) + section.support(-np.eye(2))))
        values: dict[str, Any] = {
            "height": round(float(rng.uniform(*RIM_HEIGHT)), 2),
            "tension": round(float(rng.uniform(*FITTED_TENSION)), 2),
            "cable_density": round(float(rng.uniform(*FITTED_DENSITY)), 4),
        }
        if rests:
            values["stem"] = round(0.5 * width * float(rng.uniform(*STEM_SHARE[n])), 3)
        limits = ho.Limits(tilt=math.radians(LIMITS["tilt_deg"]))
        try:
            fitted = ho.fit(outline, n, limits=limits, compared=(), **values)
        except ho.InfeasibleError:
            continue
        stated = fitted.holding.capacity("rest" if rests else "grip").mass
        share = OVERLOAD if overloaded else float(rng.uniform(*FITTED_SHARE))
        if stated < LEAST_MASS or fitted.enclosing is None:
            continue
        around = fitted.enclosing.vertices * float(rng.uniform(1.0, 1.2))
        hitch = {"polygon": np.round(around, 3).tolist(), "altitude": CARRY_ALTITUDE}
        team = {
            "robots": n,
            "cable_length": fitted.holding.cable_length,
            "tension": values["tension"],
            "cable_density": values["cable_density"],
        }
        team |= {} if rests else {"cable_friction": fitted.holding.task.clasp_friction}
        if is_certified(team, {"hitch": hitch}, {"limits": LIMITS}):
            break
    sections = {"circle": outline} if isinstance(outline, float) else {"outline": outline}
    away = rng.uniform(-math.pi, math.pi, 2)
    at = PLACES[1] * np.array([math.cos(away[0]), math.sin(away[0])])
    to = at + rng.uniform(*PLACES) * np.array([math.cos(away[1]), math.sin(away[1])])
    thing: dict[str, Any] = {
        "mass": round(share * stated, 4),
        "at": [*_rounded(at), 0.0],
        "yaw_deg": round(float(rng.uniform(0.0, 360.0)), 1),
    }
    if rests:
        rim = {**sections, "at": values["height"]}
        thing |= {"circle": values["stem"], "to": round(values["height"] + 0.05, 3), "rim": rim}
    else:
        thing |= {**sections, "to": values["height"]}
    turn = round(float(rng.uniform(-90.0, 90.0)), 1)
    carry = {"object": "thing", "to": [*_rounded(to), 0.0], "yaw_deg": turn}
    return {
        "title": f"Fitted carry, n = {n}, seed {seed}",
        "team": team,
        "limits": LIMITS,
        "objects": {"thing": thing},
        "start": {"hitch": hitch},
        "mission": [{"transport_object": carry}],
    }


def _fitted_outline(rng: np.random.Generator, *, rests: bool) -> float | list[list[float]]:
    """Return a radius, or corners of a rectangle or of a triangle that is to be gripped, [m]."""
    half = float(rng.uniform(*HALF_WIDTH))
    kind = rng.random()
    if kind < 0.5:
        return round(half, 3)
    if rests or kind < 0.85:
        a, b = round(half, 3), round(half * float(rng.uniform(*ASPECT)), 3)
        return [[-a, -b], [-a, b], [a, b], [a, -b]]
    angles = rng.uniform(0.0, math.pi) - 2.0 * math.pi * np.arange(3) / 3.0
    corners = half * np.column_stack([np.cos(angles), np.sin(angles)])
    return [_rounded(corner) for corner in corners - np.mean(corners, axis=0)]


def wild_pair(seed: int, *, heavy: bool = False) -> dict[str, Any]:
    """Return a morph between wild polygons, with weightless or ``heavy`` cables."""
    return wild_morph(_robots(seed, FORM_ROBOTS), seed, heavy=heavy)


TRAVEL_GAP = 0.4
"""Gap between a post or another team midway and the hitch at its ends [m]."""

POST_HALF_WIDTH = 0.1
"""Half the width of a post in the way of a morph [m]."""

MAX_POST_OFFSET = 0.3
"""Largest distance of a post from the line between the centres of both polygons [m]."""

WAITING = {"polygon": [[0.0, 0.75], [0.65, -0.375], [-0.65, -0.375]], "altitude": 1.5}
"""Hitch of the team that stays or crosses."""

WAITING_TEAM = {"robots": 3, "cable_length": 2.0}
"""The team that stays or crosses."""

WAITING_REACH = 1.5
"""Reach of that team from its middle [m]."""

LEVEL_ERRORS, HEIGHT_ERRORS = (0.005, 0.03), (0.005, 0.06)
"""Tracking errors of a tube, horizontal and vertical, minimum and maximum [m]."""


def travelling(seed: int, half_width: float) -> dict[str, Any]:
    """Return a wild morph eastwards past the origin, where something is about so wide [m]."""
    problem = wild_pair(seed)
    start, morph = problem["start"]["hitch"], problem["mission"][0]["morph"]
    cable = problem["team"]["cable_length"]
    for outline, side in ((start, -1.0), (morph, 1.0)):
        polygon = ho.ConvexPolygon(outline["polygon"])
        corners = polygon.vertices - polygon.centroid
        reach = float(np.max(np.linalg.norm(corners, axis=1)))
        reach += cable - float(np.min(polygon.edge_lengths))
        away = reach + half_width + TRAVEL_GAP
        outline["polygon"] = np.round(corners + [side * away, 0.0], 6).tolist()
    return problem


def past_post(seed: int) -> dict[str, Any]:
    """Return a wild morph past a post on its way."""
    offset = np.random.default_rng([seed, 3]).uniform(-MAX_POST_OFFSET, MAX_POST_OFFSET)
    post = {
        "outline": (POST_HALF_WIDTH * RECTANGLE).tolist(),
        "to": 4.0,
        "at": [0.0, round(float(offset), 3), 0.0],
        "fixed": True,
    }
    return {**travelling(seed, POST_HALF_WIDTH), "objects": {"post": post}}


def past_pillars(seed: int) -> dict[str, Any]:
    """Return a wild morph in any direction past one or two pillars, boxes, hexagons or walls."""
    rng = np.random.default_rng([seed, 8])
    while True:
        half_width = float(rng.uniform(*PILLAR_HALF_WIDTH))
        problem = travelling(seed, half_width)
        heading = float(rng.uniform(0.0, 2.0 * math.pi))
        hitches = problem["start"]["hitch"], problem["mission"][0]["morph"]
        nearer = float(rng.uniform(*NEARER))
        for outline in hitches:
            polygon = ho.ConvexPolygon(outline["polygon"])
            moved = polygon.translated(-nearer * polygon.centroid)
            outline["polygon"] = np.round(_turned(moved.vertices, heading), 6).tolist()
        pillars = {f"pillar{k}": _pillar(half_width, heading, rng) for k in range(1 + seed % 2)}
        obstacles = {"objects": pillars}
        ends = [{**hitch, "altitude": 1.5, "legs": "spread"} for hitch in hitches]
        if all(is_certified(problem["team"], {"hitch": end}, obstacles) for end in ends):
            return {**problem, **obstacles}


PILLAR_HALF_WIDTH = (0.08, 0.35)
"""Half the width of a pillar, box or hexagon, minimum and maximum [m]."""

PILLAR_HEIGHT = (2.2, 4.0)
"""Height of a pillar, minimum and maximum [m]."""

NEARER = (0.0, 0.5)
"""Share of the way to a pillar by which both polygons are moved closer to it."""

MAX_PILLAR_OFFSET = 0.8
"""Largest distance of a pillar from the line between the centres of both polygons [m]."""

WALL_HALF_LENGTH = (0.5, 1.2)
"""Half the length of a wall, minimum and maximum [m]."""


def _pillar(half_width: float, heading: float, rng: np.random.Generator) -> dict[str, Any]:
    """Return an obstacle about the middle of a way with a heading [rad]."""
    kind = rng.integers(4)
    angles = -2.0 * math.pi * np.arange(6) / 6
    corners = half_width * np.column_stack([np.cos(angles), np.sin(angles)])
    if kind == 0:
        corners = half_width * RECTANGLE
    elif kind == 1:
        corners = np.array([0.1, float(rng.uniform(*WALL_HALF_LENGTH))]) * RECTANGLE
    place = _turned(np.array([0.0, rng.uniform(-MAX_PILLAR_OFFSET, MAX_PILLAR_OFFSET)]), heading)
    height = round(float(rng.uniform(*PILLAR_HEIGHT)), 2)
    yaw = heading + float(rng.uniform(-0.5, 0.5))
    section = {"outline": np.round(corners, 3).tolist()}
    if kind == 2:
        section = {"circle": round(half_width, 3)}
    pose = {"at": [*_rounded(place), 0.0], "yaw_deg": round(math.degrees(yaw) % 360.0, 1)}
    return {**section, "to": height, **pose, "fixed": True}


def _turned(points: Array, angle: float) -> Array:
    """Return points (…, 2) turned about the origin [rad]."""
    cosine, sine = math.cos(angle), math.sin(angle)
    turned: Array = points @ np.array([[cosine, sine], [-sine, cosine]])
    return turned


def past_team(seed: int) -> dict[str, Any]:
    """Return a wild morph past another team, which stays, or crosses from south to north."""
    problem = travelling(seed, WAITING_REACH)
    step = {"a": problem["mission"][0], "b": {"hold": {"seconds": 1.0}}}
    waiting = np.array(WAITING["polygon"])
    if seed % 2:
        away = np.array([0.0, 3.0])
        waiting, goal = waiting - away, waiting + away
        step["b"] = {"morph": {"polygon": goal.tolist()}}
    hitch = {**WAITING, "polygon": waiting.tolist()}
    return {
        "teams": {"a": problem["team"], "b": WAITING_TEAM},
        "start": {"a": problem["start"], "b": {"hitch": hitch}},
        "mission": [step],
    }


def wild_tube(seed: int) -> dict[str, Any]:
    """Return a wild morph of drones that track their positions within a tube."""
    rng = np.random.default_rng([seed, 4])
    level = round(float(rng.uniform(*LEVEL_ERRORS)), 3)
    height = round(max(level, float(rng.uniform(*HEIGHT_ERRORS))), 3)
    limits = {"limits": {"tracking": {"level": level, "height": height}}}
    while True:
        problem = {**wild_morph(_robots(seed, FORM_ROBOTS), seed), **limits}
        goal = {**problem["start"]["hitch"], "polygon": problem["mission"][0]["morph"]["polygon"]}
        ends = problem["start"], {"hitch": goal}
        if all(is_certified(problem["team"], end, limits) for end in ends):
            return problem
        seed += len(FORM_ROBOTS) * 1000


def many(seed: int) -> dict[str, Any]:
    """Return a morph between irregular polygons of 20 or 24 robots, with evened angles."""
    n = MANY_ROBOTS[seed % len(MANY_ROBOTS)]
    rng = np.random.default_rng([n, seed, 5])
    while True:
        edges = rng.uniform(*MANY_EDGE, 2)
        polygons = [random_convex_polygon(n, edge, rng, MANY_JITTER) for edge in edges]
        longest = max(float(np.max(polygon.edge_lengths)) for polygon in polygons)
        team = {"robots": n, "cable_length": round(longest + float(rng.uniform(0.45, 1.0)), 2)}
        start, goal = (
            {"polygon": np.round(polygon.vertices, 6).tolist(), "altitude": 1.5, "legs": "spread"}
            for polygon in polygons
        )
        if is_certified(team, {"hitch": start}) and is_certified(team, {"hitch": goal}):
            return {
                "team": team,
                "start": {"hitch": start},
                "mission": [{"morph": {"polygon": goal["polygon"]}}],
            }


MANY_ROBOTS = (20, 24)
"""Numbers of robots of large hitches."""

MANY_EDGE = (1.1, 1.6)
"""Mean edge of a large hitch, minimum and maximum [m]."""

MANY_JITTER = 0.2
"""Jitter of the vertices of a large hitch."""


def wild_chain(seed: int) -> dict[str, Any]:
    """Return a morph of two cables with one clasp, from any bend to any other by any turn."""
    rng = np.random.default_rng([seed, 6])
    while True:
        ends = list[list[list[float]]]()
        for _ in range(2):
            arms, heading = rng.uniform(0.6, 1.6, 2), rng.uniform(0.0, 2.0 * math.pi)
            bend = rng.uniform(math.radians(15.0), math.radians(150.0))
            first = arms[0] * np.array([math.cos(heading), math.sin(heading)])
            second = arms[1] * np.array([math.cos(heading - bend), math.sin(heading - bend)])
            clasp = rng.uniform(-MAX_CHAIN_SHIFT, MAX_CHAIN_SHIFT, 2)
            ends.append(np.round([clasp - first, clasp, clasp + second], 3).tolist())
        longest = max(math.dist(*edge) for outline in ends for edge in pairwise(outline))
        cable = round(longest + float(rng.uniform(0.45, 1.2)), 2)
        team = {"robots": 2, "topology": "open", "cable_length": cable}
        hitches = [{"polygon": each, "altitude": 1.5, "legs": "spread"} for each in ends]
        if all(is_certified(team, {"hitch": hitch}) for hitch in hitches):
            return {
                "team": team,
                "start": {"hitch": hitches[0]},
                "mission": [{"morph": {"polygon": ends[1]}}],
            }


MAX_CHAIN_SHIFT = 0.5
"""Largest coordinate of the clasp of two cables [m]."""

FAMILIES: dict[str, Callable[[int], dict[str, Any]]] = {
    "form": wild_form,
    "scattered_form": scattered_form,
    "carry": wild_carry,
    "fitted": fitted_carry,
    "overloaded": partial(fitted_carry, overloaded=True),
    "morph": wild_pair,
    "heavy_morph": partial(wild_pair, heavy=True),
    "past_post": past_post,
    "past_pillars": past_pillars,
    "past_team": past_team,
    "tube": wild_tube,
    "many": many,
    "chain": wild_chain,
    "curves": random_curve,
    "timed": random_timed_curve,
    "blends": random_blend,
    "timed_blends": random_timed_blend,
    "box": random_box,
    "door": random_door,
    "corridor": random_corridor,
}


class Outcome(NamedTuple):
    """The outcome of one problem."""

    seed: int
    size: int  # number of robots, or of single drones
    seconds: float  # processor time [s]
    duration: float | None  # of the flight [s]; None if it was refused
    proven: bool  # also by ``hitchopt verify``
    refusal: str  # first limit named by a refusal
    over_bound: float | None = None  # duration over ``lower_bound``; None if it was refused


def lower_bound(plan: ho.Plan) -> float:
    """Return what the slowest drone or vertex would need alone [s].

    It is the sum, over all phases of the slowest team, of the fastest straight flights from rest to
    rest within the limits of speed and acceleration.
    """
    return max(_bound_of(team.motion) for team in plan.flight.teams)


JUST_INSIDE = 1e-9
"""[s] Distance to the ends of a phase, where vertices may jump as cables change their state."""


def _bound_of(motion: Motion) -> float:
    """Return that sum for one team [s]."""
    limits = motion.requirements.limits
    bound = 0.0
    for phase in motion.phases:
        moved = [(motion.drones, limits.speed)]
        if phase.state.hitched:
            moved.append((motion.vertices, limits.vertex_speed))
        durations = [
            _straight_flights(
                points.at(phase.end - JUST_INSIDE) - points.at(phase.start + JUST_INSIDE),
                speed,
                limits.acceleration,
            )
            for points, speed in moved
        ]
        bound += float(np.max(np.concatenate(durations)))
    return bound


def _straight_flights(travel: Array, speed: float, acceleration: float) -> Array:
    """Return the shortest durations [s] of straight flights (points, 3) [m] from rest to rest."""
    distances = np.linalg.norm(travel, axis=-1)
    ramps = np.sqrt(np.minimum(distances / acceleration, (speed / acceleration) ** 2))
    cruises = np.maximum(distances - speed**2 / acceleration, 0.0) / speed
    durations: Array = 2.0 * ramps + cruises
    return durations


def outcome(data: dict[str, Any], seed: int) -> Outcome:
    """Return the outcome of a problem, planned alone and then proven."""
    problem = ho.problem_from_dict(data)
    team = data["team"] if "team" in data else data["teams"]["a"]
    size = team.get("robots", team.get("drones", 0))
    start_time = time.process_time()
    try:
        plan = ho.solve(problem)
    except ho.HitchoptError as error:
        seconds = time.process_time() - start_time
        violations = getattr(error, "violations", ())
        refusal = violations[0].constraint if violations else type(error).__name__
        return Outcome(seed, size, seconds, None, False, refusal)
    seconds = time.process_time() - start_time
    with tempfile.TemporaryDirectory() as folder:
        plan.save(folder)
        proven = all(row.verdict in verify.PASSING for row in verify.verify(folder))
    if not plan.certificate.certified:
        return Outcome(seed, size, seconds, None, proven, "")
    over_bound = plan.duration / lower_bound(plan)
    return Outcome(seed, size, seconds, plan.duration, proven, "", over_bound)


def add_rows(table: Table, family: str, outcomes: list[Outcome]) -> None:
    """Add a row for each number of robots of a family, and one for all of them."""
    by_size = defaultdict[int, list[Outcome]](list)
    for each in outcomes:
        by_size[each.size].append(each)
    groups = [(str(size), by_size[size]) for size in sorted(by_size)]
    if len(groups) > len(FORM_ROBOTS):
        groups = []
    for size, group in [*groups, ("all", outcomes)]:
        planned = [each for each in group if each.duration is not None]
        refused = [f"{each.seed} ({each.refusal})" for each in group if each.duration is None]
        seconds = [each.seconds for each in group]
        counts = len(group), len(planned), sum(each.proven for each in planned)
        rate = f"{100.0 * len(planned) / len(group):.0f} %"
        times = float(np.median(seconds)), max(seconds)
        ratios = [each.over_bound for each in planned if each.over_bound is not None]
        over_bound = (float(np.median(ratios)), max(ratios)) if ratios else ("", "")
        table.row(family, size, *counts, rate, ", ".join(refused), *times, *over_bound)


def main() -> None:
    """Print and write the families' rows."""
    cli = parser(__doc__, problems=40, first=0)
    cli.add_argument("families", nargs="*", choices=[*FAMILIES, []], default=[], help="or all")
    options = cli.parse_args()
    table = Table(options.output / "families.md", "Wild families", LIMITATIONS)
    columns = ("family", "n", "problems", "planned", "proven", "rate", "refused: seed (limit)")
    times = "median [s]", "most [s]"
    table.section("", *columns, *times, "over bound: median", "most")
    outcome(wild_morph(3, 0), 0)  # imports are not measured
    reasons = list[str]()
    for family in options.families or FAMILIES:
        seeds = range(options.first, options.first + options.problems)
        outcomes = list[Outcome]()
        for seed in seeds:
            outcomes.append(outcome(FAMILIES[family](seed), seed))
            print(f"{family}: {outcomes[-1]}", file=sys.stderr, flush=True)
        reasons += [f"{family}: {each.refusal}" for each in outcomes if each.duration is None]
        add_rows(table, family, outcomes)
    table.note(f"refusals: {most_common(reasons) or 'none'}")
