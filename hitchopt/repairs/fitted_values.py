"""Cable lengths, tensions and frictions that statics suggest, as ``hitchopt fit`` does."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from hitchopt.carrying.grasps import shortest_judge
from hitchopt.carrying.polygons import EDGE_MARGIN
from hitchopt.errors import InputError, RequestError
from hitchopt.geometry import ConvexPolygon, Outline
from hitchopt.mission.problem import Problem
from hitchopt.motion.motion import HoldBy
from hitchopt.planners.candidates import if_feasible
from hitchopt.planners.fitting import separating_cables
from hitchopt.repairs.changes import size_of
from hitchopt.steps.knob import Knob

MIN_SIZE = 0.005  # Smallest relative change that is suggested

PULL_SHARE = 0.9
"""Largest tension of suggestions over the largest horizontal pull, since motion needs more."""

BETWEEN = (0.25, 0.5, 0.75)
"""Fractions of the straight path between two polygons at which legs are separated as well."""


def fitted_sizes(problem: Problem, knobs: Sequence[Knob]) -> Iterator[tuple[Knob, float]]:
    """Yield knobs of all cables, tensions and friction with relative sizes that statics suggest.

    Friction comes first, then smaller changes, in both directions.
    """
    keys = {knob.key for knob in knobs}
    yield from ((knob, knob.min_size) for knob in knobs if knob.key == "team.cable_friction")
    ratios = list[tuple[str, float]]()
    if "team.tension" in keys:
        largest = float(np.max(problem.team.tension))
        ratios += [("team.tension", value / largest) for value in fitting_tensions(problem)]
    if "team.cable_length" in keys:
        longest = float(np.max(problem.team.cable_length))
        ratios += [("team.cable_length", value / longest) for value in fitting_cables(problem)]
    for key, ratio in sorted(ratios, key=lambda each: size_of(each[1] - 1.0, is_factor=True)):
        sign = 1 if ratio > 1.0 else -1
        size = abs(ratio - 1.0)
        for knob in knobs:
            if (knob.key, knob.sign) == (key, sign) and size >= max(knob.min_size, MIN_SIZE):
                yield knob, size


def fitting_tensions(problem: Problem) -> list[float]:
    """Return tensions [N] of the team's drones: the usual one, and nearly their largest pull."""
    kinds = problem.team.quadrotor
    largest_pull = min(kind.level_pull(problem.limits.tilt)[0] for kind in kinds)
    tensions = min(kind.tension for kind in kinds), PULL_SHARE * largest_pull
    return [tension for tension in tensions if tension > 0.0]


def fitting_cables(problem: Problem) -> list[float]:
    """Return lengths of the longest cable [m] that fit the problem's polygons and held objects.

    Legs are separated on all polygons of the file, convex ones on the straight path between them
    and those below rims. For objects to be gripped, only the lengths that grip them are returned.
    """
    team = problem.team
    mission = problem.teams[""]
    outline = mission.start_outline
    outlines = [] if outline is None else [outline]
    for step in mission.steps:
        after = step.checked_polygon_after(team, outline)
        if outline and after and step.goal_outline is not None:
            outlines += _outlines_between(outline, after)
        if after:
            outlines.append(after)
        outline = after
    lengths = list[float]()
    for name in dict.fromkeys(filter(None, (step.object_name for step in mission.steps))):
        around = _cables_around(problem, name)
        outlines += around.outlines
        lengths += around.lengths
    if outlines and not lengths:
        return separating_cables(outlines, mission.requirements.with_reserve, team)
    return lengths


def _outlines_between(first: Outline, last: Outline) -> list[Outline]:
    """Return the convex outlines on the straight path between two, at the shares BETWEEN."""
    outlines = list[Outline]()
    for share in BETWEEN:
        points = (1.0 - share) * first.vertices + share * last.vertices
        with contextlib.suppress(InputError):
            outlines.append(type(last)(points))
    return outlines


@dataclass(frozen=True)
class CablesAround:
    """What is known of cables that hold an object."""

    lengths: list[float] = field(default_factory=list)  # [m] Lengths that carry it
    # Polygons around it and below its rim, if no length carries it
    outlines: list[Outline] = field(default_factory=list)


def _cables_around(problem: Problem, name: str) -> CablesAround:
    """Return the cables that hold an object; nothing if no polygon is known for it."""
    body = problem.objects[name]
    requirements = problem.teams[""].requirements.with_reserve
    gap = requirements.separation.object + EDGE_MARGIN
    by = HoldBy.GRIP if body.rim is None else HoldBy.REST

    def fitted() -> CablesAround:
        """Return the shortest cables, or the polygons that they should have carried it on."""
        judge = shortest_judge(name, problem.team, requirements, by, gap, body.mass)
        if by is HoldBy.GRIP or judge.carries(body.mass):
            return CablesAround(lengths=[float(judge.team.cable_length[0])])
        polygons = judge.planner.state.polygons
        both = ConvexPolygon(polygons.around), ConvexPolygon(polygons.clasps)
        return CablesAround(outlines=[*both])

    try:
        return if_feasible("hold", fitted, CablesAround())
    except RequestError:  # the object cannot be held, as its step will say
        return CablesAround()
