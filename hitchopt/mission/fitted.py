"""Cable lengths and tensions that statics suggest for a problem, as ``hitchopt fit`` does."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from hitchopt.errors import HitchoptError
from hitchopt.geometry import ConvexPolygon, Outline
from hitchopt.mission.changes import size_of
from hitchopt.mission.problem import Problem
from hitchopt.planners.carrying.polygons import EDGE_MARGIN, GripTask, rest_polygons
from hitchopt.planners.fitting import (
    enclosing_polygon,
    grip_and_cable,
    separating_cables,
    shortest_cable,
)
from hitchopt.steps.step import Knob
from hitchopt.steps.tying import Form

PULL_SHARE = 0.9
"""Largest tension of suggestions over the largest level pull, as motion needs more."""

BETWEEN = (0.25, 0.5, 0.75)
"""Shares of the straight path between two polygons at which legs are separated as well."""


def fitted_sizes(problem: Problem, knobs: Sequence[Knob]) -> Iterator[tuple[Knob, float]]:
    """Yield knobs of all cables and tensions with relative sizes that statics suggest.

    Smaller changes come first, in both directions.
    """
    team, fitted = problem.team, list[tuple[str, float]]()
    if any(knob.key == "team.tension" for knob in knobs):
        pull = min(kind.level_pull(problem.limits.tilt)[0] for kind in team.quadrotor)
        tensions = min(kind.tension for kind in team.quadrotor), PULL_SHARE * pull
        fitted += [("team.tension", value / float(np.max(team.tension))) for value in tensions]
    if any(knob.key == "team.cable_length" for knob in knobs):
        longest = float(np.max(team.cable_length))
        fitted += [("team.cable_length", value / longest) for value in fitting_cables(problem)]
    for key, ratio in sorted(fitted, key=lambda each: size_of(each[1] - 1.0, is_factor=True)):
        sign = 1 if ratio > 1.0 else -1
        size = abs(ratio - 1.0)
        yield from (
            (x, size) for x in knobs if (x.key, x.sign) == (key, sign) and size >= x.min_size
        )


def fitting_cables(problem: Problem) -> list[float]:
    """Return lengths of the longest cable [m] that fit the problem's polygons and held objects.

    Legs are separated on all polygons of the file, those on the straight path between them and
    those below rims. For objects to be gripped, only the lengths that grip them are returned.
    """
    mission, team = problem.teams[""], problem.team
    requirements, outline = mission.requirements.with_reserve, mission.start_outline
    if mission.changes or team.robots == 2:
        return []
    outlines, lengths = [] if outline is None else [outline], list[float]()
    for step in mission.steps:
        after = step.checked_polygon_after(team, outline)
        if outline and after and not isinstance(step, Form) and vars(step).get("polygon"):
            ends = outline.vertices, after.vertices
            outlines += [type(after)((1.0 - s) * ends[0] + s * ends[1]) for s in BETWEEN]
        outlines += [after] if after else []
        outline = after
    for name in dict.fromkeys(vars(step).get("object", "") for step in mission.steps):
        if name:
            found = _cables_around(problem, name)
            outlines += found[0]
            lengths += found[1]
    if outlines and not lengths:
        lengths += separating_cables(outlines, requirements, team)
    return lengths


def _cables_around(problem: Problem, name: str) -> tuple[list[Outline], list[float]]:
    """Return outlines around an object that rests on cables, or lengths [m] that grip it."""
    mission, team, body = problem.teams[""], problem.team, problem.objects[name]
    requirements, n = mission.requirements.with_reserve, team.robots
    gap = requirements.separation.object + EDGE_MARGIN
    try:
        if body.rim is not None:
            polygons = rest_polygons(name, body, n, gap)
            centred = (polygons.around, polygons.clasps)
            return [ConvexPolygon(each) for each in centred], []
        kind, section, tension = team.quadrotor[0], body.section, float(np.min(team.tension))
        cable = shortest_cable([enclosing_polygon(section, n, gap)], requirements)
        task = GripTask(section, n, cable, tension, team.cable_friction, requirements, kind)
        return [], [grip_and_cable(task, gap)[1]]
    except HitchoptError:  # nothing is known of the object's polygons
        return [], []
