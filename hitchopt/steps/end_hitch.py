"""The hitch that a step ends with, and why its legs are not those of the paper."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from hitchopt.errors import InfeasibleError, Violation
from hitchopt.geometry import Outline
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.cable_slack import cable_slack
from hitchopt.planners.actions.action import Action
from hitchopt.planners.actions.sliding import SLIDES
from hitchopt.planners.path.shape_path import ShapePath, shapes_along
from hitchopt.requirements import Requirements
from hitchopt.steps.certified_motions import certificate_at_rest
from hitchopt.steps.slack_split import RolledLegs, SlackSplit


@dataclass(frozen=True, eq=False)
class End:
    """The hitch after a step.

    Attributes
    ----------
    hitch: at rest.
    reason: what the action's own legs would break, in words; nothing if they break nothing.
    """

    hitch: Hitch
    reason: str = ""


def split_hitch(
    team: Team,
    polygon: Outline | ArrayLike,
    altitude: float,
    legs: SlackSplit,
    requirements: Requirements,
) -> Hitch:
    """Return the hitch whose slack is split as ``legs`` says."""
    roll, auto = None, False
    if isinstance(legs, RolledLegs):
        sharing, roll, auto = legs.sharing, legs.roll, legs.roll is None
    else:
        sharing = legs
    if isinstance(sharing, str) and sharing == "spread":
        return Hitch.spread(
            team,
            polygon,
            altitude,
            limits=requirements.limits,
            separation=requirements.separation,
            roll=roll,
        )
    given = 0.0 if roll is None else roll
    if isinstance(sharing, str):
        hitch = Hitch.balanced(team, polygon, altitude, given)
    else:
        hitch = Hitch(team, polygon, altitude, sharing, given)
    return hitch.least_rolled(requirements) if auto else hitch


def end_of_morph(
    start: Hitch, polygon: Outline, legs: SlackSplit | None, requirements: Requirements
) -> End:
    """Return the hitch on ``polygon``; without ``legs`` with fractions nearest to those before."""
    if legs is not None:
        return End(split_hitch(start.team, polygon, start.altitude, legs, requirements))
    return End(_nearest(start, polygon, start.fractions, requirements))


def end_of_action(action: Action, legs: SlackSplit | None, requirements: Requirements) -> End:
    """Return the hitch after an action; without ``legs`` with those nearest to its law's.

    Those themselves where they keep every limit.
    """
    start, polygon = action.start, action.polygon
    if legs is not None:
        return End(split_hitch(start.team, polygon, start.altitude, legs, requirements))
    wanted = action.kept_legs
    try:
        hitch = Hitch(start.team, polygon, start.altitude, wanted, start.roll)
    except InfeasibleError as error:
        reason = _words(replace(error.violations[0], limit=requirements.limits.leg))
    else:
        reason = broken_at_rest(hitch, requirements)
        if not reason:
            return End(hitch)
    nearest = _nearest(start, polygon, wanted / cable_slack(start.team, polygon), requirements)
    # A cable that need not slide keeps its legs to the last bit, so that its drones stay.
    same = np.abs(nearest.q_legs - wanted) < SLIDES
    q_legs = np.where(same, wanted, nearest.q_legs)
    end = Hitch(start.team, polygon, start.altitude, q_legs, nearest.roll)
    return End(end, f"{reason} at the end")


def broken_on_the_way(
    path: ShapePath, s: float, altitude: float, requirements: Requirements
) -> str:
    """Return what the path's hitch at s breaks, or comes closest to breaking, in words."""
    shape = shapes_along(path, np.array([s]))
    given, roll = shape.legs[0], 0.0 if shape.roll is None else shape.roll[0]
    legs = np.where(path.team.layout.has_leg, given, np.inf)
    place = f"at {s:.0%} of the path"
    if np.min(legs) <= 0.0:
        k, end = np.unravel_index(int(np.argmin(legs)), legs.shape)
        name = f"{'qr'[end]}{k}"
        limit, value = requirements.limits.leg, float(legs[k, end])
        short = Violation("legs", value, limit, "min", "m", (name,), place, "")
        return f"{_words(short)} {place}"
    points = path.vertices.at(s)[:, :2]
    broken = broken_at_rest(Hitch(path.team, points, altitude, given[:, 0], roll), requirements)
    return f"{broken} {place}" if broken else f"distances would all but reach their limits {place}"


def broken_at_rest(hitch: Hitch, requirements: Requirements) -> str:
    """Return the first limit that the hitch breaks, in words; nothing if it keeps them all."""
    broken = certificate_at_rest(hitch, requirements).violated
    return _words(broken[0].violation("", "")) if broken else ""


def _words(broken: Violation) -> str:
    """Return such as "legs 0.11 m at q0 would be below 0.15 m"."""
    unit = "" if broken.unit in {"1", "ratio"} else f" {broken.unit}"
    relation = "below" if broken.sense == "min" else "above"
    place = f" at {', '.join(broken.where)}" if broken.where else ""
    what = f"{broken.constraint} {broken.value:.3g}{unit}{place}"
    return f"{what} would be {relation} {broken.limit:.3g}{unit}"


def _nearest(
    start: Hitch, polygon: Outline, fractions: ArrayLike, requirements: Requirements
) -> Hitch:
    return Hitch.nearest(
        start.team,
        polygon,
        start.altitude,
        fractions,
        limits=requirements.limits,
        separation=requirements.separation,
        arena=requirements.arena,
        roll=start.roll,
    )
