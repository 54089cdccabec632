"""Cable lengths and tensions that fit polygons: drones stand well apart, and hold their cables."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hitchopt.errors import InfeasibleError
from hitchopt.geometry import ConvexPolygon
from hitchopt.hitch.hitch import balanced_legs
from hitchopt.hitch.requirements import Requirements
from hitchopt.hitch.slack_split import LIMIT_MARGIN, LegTask
from hitchopt.hitch.team import Team

LENGTH_STEP, MAX_EXTRA_LENGTH = 0.05, 1.0
"""Step of cable lengths, and largest length beyond the one that legs need [m]."""

WEIGHT_SAFETY, MAX_TENSION_RATIO, TENSIONS = 2.0, 30.0, 60
"""Smallest tension over the one from which on heavy cables balance; largest over smallest tension
of the search, and their number."""

Range = tuple[float, float]
"""Smallest and largest value."""


def fitting_lengths(
    team: Team, polygons: Sequence[ConvexPolygon], requirements: Requirements
) -> Range | None:
    """Return the shortest and longest cable length [m] whose balanced legs keep all distances.

    They do so on all polygons, and at all lengths between, in steps of 5 cm. The longest is
    infinite if none up to MAX_EXTRA_LENGTH beyond the one that legs need is too long. None if no
    length fits. Lengths of the team do not matter.
    """
    edge = max(float(np.max(each.edge_lengths)) for each in polygons)
    first = math.ceil((edge + 2.0 * requirements.limits.leg) / LENGTH_STEP)
    counts, fitting = np.arange(round(MAX_EXTRA_LENGTH / LENGTH_STEP)), list[float]()
    for cable in np.round(LENGTH_STEP * (first + counts), 2).tolist():
        sized = replace(team, cable_length=np.full(team.robots, cable))
        if _keeps_distances(sized, polygons, requirements):
            fitting.append(cable)
        elif fitting:
            return fitting[0], fitting[-1]
    return (fitting[0], math.inf) if fitting else None


def fitting_tensions(
    team: Team, polygons: Sequence[ConvexPolygon], requirements: Requirements
) -> Range:
    """Return the smallest and largest tension [N] at which drones and cables hold hitches.

    The largest is the level pull of the weakest drones. The smallest is WEIGHT_SAFETY times the one
    from which on heavy cables with balanced legs keep all distances on all polygons; zero without
    weight. Tensions of the team do not matter.
    """
    pulls = [kind.level_pull(requirements.limits.tilt)[0] for kind in team.quadrotor]
    smallest = largest = min(pulls)
    if team.cable_density == 0.0:
        return 0.0, largest
    for tension in np.geomspace(largest, largest / MAX_TENSION_RATIO, TENSIONS).tolist():
        stretched = replace(team, tension=np.full(team.robots, tension))
        if not _keeps_distances(stretched, polygons, requirements):
            break
        smallest = tension
    return min(WEIGHT_SAFETY * smallest, largest), largest


def _keeps_distances(
    team: Team, polygons: Sequence[ConvexPolygon], requirements: Requirements
) -> bool:
    """Return whether balanced legs keep all distances on all polygons.

    They do not where cables are too short for legs, or clasps have no balance.
    """
    shortest = requirements.limits.leg
    try:
        for polygon in polygons:
            legs = balanced_legs(team, polygon)
            task = LegTask.at_rest(team, polygon, legs, requirements, LIMIT_MARGIN)
            if np.min(legs) < shortest or task.reference_margin() < LIMIT_MARGIN:
                return False
    except InfeasibleError:
        return False
    return True
