"""The outline that a step leaves behind, and what is wrong with steps before any planning."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import InputError
from hitchopt.geometry import Outline
from hitchopt.hitch import Team
from hitchopt.hitch.cable_slack import fitting_polygon
from hitchopt.mission.form_records import Form, Land, Release
from hitchopt.mission.leg_sharing import leg_sharing
from hitchopt.mission.step_records import (
    Adjust,
    FollowVertex,
    HitchStep,
    Hold,
    Morph,
    MoveEdge,
    MoveVertex,
    ShapeStep,
    Step,
    Transport,
)
from hitchopt.values import MAX_COORDINATE

Array = NDArray[np.float64]


def outline_after(team: Team, outline: Outline, step: HitchStep) -> Outline:
    """Return the outline that ``step`` makes of ``outline``.

    Raises
    ------
    InputError: an index beyond the team's, or an outline that is not convex.
    """
    if isinstance(step, Morph):
        return fitting_polygon(team, step.polygon)
    if isinstance(step, Hold | Adjust):
        return outline
    if isinstance(step, Transport):
        return transported(team, outline, step)
    points = outline.vertices.copy()
    if isinstance(step, MoveEdge):
        check_index("edge", step.edge, team.robots)
        ends = [step.edge, (step.edge + 1) % len(points)]
        points[ends] = points[ends] + np.asarray(step.by) if step.to is None else step.to
        return _convex(team, points, step)
    check_index("vertex", step.vertex, len(points))
    if isinstance(step, FollowVertex):
        points[step.vertex] = step.path[-1, 1:]
    else:
        here = points[step.vertex]
        points[step.vertex] = here + np.asarray(step.by) if step.to is None else step.to
    return _convex(team, points, step)


def transported(team: Team, outline: Outline, step: Transport) -> Outline:
    """Return the outline turned about its centroid, which goes to its new place."""
    if abs(step.to[2]) > MAX_COORDINATE:
        raise InputError(
            "to", step.to.tolist(), f"within ±{MAX_COORDINATE:g} m", "check its coordinates"
        )
    centre = outline.centroid
    c, s = math.cos(step.yaw), math.sin(step.yaw)
    points = (outline.vertices - centre) @ np.array([[c, s], [-s, c]]) + step.to[:2]
    return _convex(team, points, step)


def check_index(key: str, index: int, count: int) -> None:
    """Raise InputError where ``index`` is none of ``count``."""
    if index >= count:
        raise InputError(key, index, f"from 0 to {count - 1}", "indices start at 0")


def outline_left(team: Team, outline: Outline | None, step: Step) -> Outline | None:
    """Return the outline after a step that may form or release; None where there is no hitch.

    Raises
    ------
    InputError: as outline_after, or a step that needs a hitch where there is none, or none where
        there is one.
    """
    if isinstance(step, Hold) and outline is None:
        return None
    if isinstance(step, Form | Land):
        if outline is not None:
            raise InputError(
                "", "a hitch", "given drones on free cables at that point", "release it before"
            )
        return fitting_polygon(team, step.polygon) if isinstance(step, Form) else None
    if outline is None:
        raise InputError("", "no hitch", "given a hitch at that point", "form one before")
    return None if isinstance(step, Release) else outline_after(team, outline, step)


def fitting_steps(team: Team, outline: Outline | None, steps: tuple[Step, ...]) -> tuple[Step, ...]:
    """Return the steps with their polygons as outlines and their legs as arrays.

    Parameters
    ----------
    team: who flies them.
    outline: the hitch's at the start; None where cables are free.
    steps: with polygons and legs as a user writes them.

    Raises
    ------
    InputError: a step that does not fit the team, the outline it meets, or the next step; its key
        is that of the problem file, from ``mission`` on.
    """
    fitted: list[Step] = []
    for i, given in enumerate(steps):
        try:
            step = _fitting_step(team, given)
            outline = outline_left(team, outline, step)
            _check_tension(step, team)
            _check_blend(step, steps[i + 1] if i + 1 < len(steps) else None)
            if i > 0 and getattr(steps[i - 1], "blend", False):
                _check_untimed(step)
        except InputError as error:
            raise error.within(f"mission[{i}].{given.name}") from None
        fitted.append(step)
    return tuple(fitted)


def _fitting_step(team: Team, step: Step) -> Step:
    """Return the step with its polygon as an outline and its legs as an array, if it has any."""
    changes: dict[str, Any] = {}
    if isinstance(step, Morph | Form):
        changes["polygon"] = fitting_polygon(team, step.polygon)
    legs = getattr(step, "legs", None)
    if legs is not None:
        changes["legs"] = leg_sharing(legs, team)
    return replace(step, **changes) if changes else step


def _convex(team: Team, points: Array, step: HitchStep) -> Outline:
    """Return the points as an outline, what is wrong with them told of the step's own key."""
    try:
        return fitting_polygon(team, points)
    except InputError as error:
        key = "path" if isinstance(step, FollowVertex) else "to"
        if getattr(step, key, None) is None:
            key = "by"
        value = np.asarray(getattr(step, key)).tolist()
        raise InputError(
            key,
            value,
            f"such that the outline stays convex and clockwise ({error.key} = {error.value} would "
            f"have to be {error.bound})",
            "go less far",
        ) from None


def _check_tension(step: Step, team: Team) -> None:
    """Raise InputError where a step begins and ends with tensions outside its own range."""
    if not isinstance(step, Morph) or step.tension is None:
        return
    least, most = step.tension
    smallest, largest = float(np.min(team.tension)), float(np.max(team.tension))
    if least > smallest or most < largest:
        raise InputError(
            "tension",
            {"min": least, "max": most},
            f"such that team.tension lies within ({smallest:g} to {largest:g} N)",
            "widen it: a step begins and ends with the team's tensions",
        )


def _check_blend(step: Step, following: Step | None) -> None:
    if not getattr(step, "blend", False):
        return
    if following is None:
        raise InputError("blend", True, "false in the last step", "leave it out: nothing follows")
    if not isinstance(following, ShapeStep):
        names = ", ".join(kind.name for kind in (Morph, MoveVertex, MoveEdge, Adjust))
        raise InputError(
            "blend",
            True,
            f"false before a {following.name}",
            f"leave it out: only {names} go on into one another",
        )
    _check_untimed(step)


def _check_untimed(step: Step) -> None:
    for key in ("optimize", "tension"):
        if getattr(step, key, None):
            raise InputError(
                key,
                getattr(step, key),
                "left out of steps that are blended, whose path is not optimised",
                f"leave out {key} or blend",
            )
    duration = getattr(step, "duration", None)
    if duration is not None:
        raise InputError(
            "duration",
            duration,
            "left out of steps that are blended, which have no stop to end with",
            "leave out duration or blend",
        )
