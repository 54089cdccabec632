"""Hitches at the ends of steps: on a polygon, with the legs that are stated or the nearest ones."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from hitchopt.errors import AT_END, InfeasibleError, Violation
from hitchopt.geometry import ConvexPolygon, Outline
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.hitch import balanced_legs, cable_slack
from hitchopt.hitch.requirements import Requirements
from hitchopt.hitch.slack_split import SPREAD_MARGIN, LegTask
from hitchopt.hitch.team import MAX_ROBOTS
from hitchopt.planners.candidates import Candidate, Effort, first_certified, if_feasible
from hitchopt.planners.morph.actions import Action
from hitchopt.planners.morph.legs import SLIDING_TOLERANCE
from hitchopt.planners.rests import check_at_rest
from hitchopt.values import Array, ByValue, Points
from hitchopt.values.fields import Key, either, list_of, one_or_each, words
from hitchopt.values.units import LENGTH_OR_ZERO, ROLL

SPLIT_TEXT = "Slack split of the cables: balanced, spread, or a list of q-legs d_k"

SPLIT = either(words("balanced", "spread"), list_of(LENGTH_OR_ZERO, 2, MAX_ROBOTS))


@dataclass(frozen=True, eq=False)
class RolledLegs(ByValue):
    """Legs that are rolled out of their plane."""

    sharing: Annotated[Literal["balanced", "spread"] | Array, Key(SPLIT, SPLIT_TEXT)] = "spread"
    roll: Annotated[
        Array | None,
        Key(
            either(words(auto=None), one_or_each(ROLL, 1, MAX_ROBOTS)),
            "Roll of the legs about their clasps, q up and r down, one for all or one per clasp; "
            "auto: none unless legs without it break a limit",
        ),
    ] = None


SlackSplit = Literal["balanced", "spread"] | Array | RolledLegs
"""Slack split of a hitch: ``balanced``, ``spread``, or the q-legs ``d_k`` (n,) [m]; or one of these
with a roll. Spread legs without a roll are rolled where they would break a limit."""


def split_hitch(
    team: Team,
    polygon: Outline | Points,
    altitude: float,
    legs: SlackSplit,
    requirements: Requirements,
) -> Hitch:
    """Return the hitch with the slack split ``legs``."""
    sharing = legs.sharing if isinstance(legs, RolledLegs) else legs
    roll = legs.roll if isinstance(legs, RolledLegs) else None
    if isinstance(sharing, str) and sharing == "spread":
        return Hitch.spread(
            team,
            polygon,
            altitude,
            roll=roll,
            limits=requirements.limits,
            separation=requirements.separation,
        )
    initial_roll = 0.0 if roll is None else roll
    if isinstance(sharing, str):
        hitch = Hitch.balanced(team, polygon, altitude, initial_roll)
    else:
        hitch = Hitch(team, polygon, altitude, sharing, initial_roll)
    auto_roll = isinstance(legs, RolledLegs) and roll is None
    return hitch.least_rolled(requirements) if auto_roll else hitch


class End(NamedTuple):
    """The end of a step."""

    hitch: Hitch  # Hitch after the step
    # Description of the limit that the legs of the paper's action would break, if they do
    reason: str = ""


def end_of_morph(
    start: Hitch, polygon: Outline, legs: SlackSplit | None, requirements: Requirements
) -> End:
    """Return the hitch on ``polygon``; by default its fractions are nearest to the initial ones."""
    if legs is not None:
        return End(split_hitch(start.team, polygon, start.altitude, legs, requirements))
    return End(_nearest(start, polygon, start.fractions, requirements))


def moved_points(outline: Outline, to: Array, yaw: float) -> Array:
    """Return the points (n, 2) [m] of an outline turned about its centroid, and moved to a goal.

    ``to`` is the goal (2,) or (3,) of the centroid [m], ``yaw`` the angle [rad].
    """
    turned = outline.translated(-outline.centroid).rotated(yaw)
    points: Array = turned.vertices + to[:2]
    return points


def end_of_transport(start: Hitch, to: Array, yaw: float) -> Hitch:
    """Return the hitch turned about its centroid by ``yaw`` [rad], and moved to ``to`` (3,) [m]."""
    polygon = moved_points(start.polygon, to, yaw)
    return Hitch(start.team, polygon, float(to[2]), start.q_legs, start.roll)


def end_of_action(action: Action, legs: SlackSplit | None, requirements: Requirements) -> End:
    """Return the hitch after an action; by default its legs are nearest to the action's own."""
    start = action.start
    polygon = action.polygon
    if legs is not None:
        return end_of_morph(start, polygon, legs, requirements)
    legs_by_law = action.legs_by_law

    def by_law() -> End:
        """Return the hitch with the legs of the action's law."""
        hitch = Hitch(start.team, polygon, start.altitude, legs_by_law, start.roll)
        check_at_rest(hitch, requirements, AT_END)
        return End(hitch)

    def nearest_to_law(violation: Violation) -> End:
        """Return the feasible hitch with the nearest legs; they avoid the violation of the law."""
        fractions = legs_by_law / cable_slack(start.team, polygon)
        nearest = _nearest(start, polygon, fractions, requirements)
        # A cable that does not slide keeps its legs to the last bit, so that its drones stay
        slides = np.abs(nearest.q_legs - legs_by_law) >= SLIDING_TOLERANCE
        q_legs = np.where(slides, nearest.q_legs, legs_by_law)
        end = Hitch(start.team, polygon, start.altitude, q_legs, nearest.roll)
        reason = replace(violation, when=AT_END, remedy="with the action's own legs")
        return End(end, str(reason))

    def amended(error: InfeasibleError) -> Candidate[End]:
        """Return the nearest legs as a candidate."""
        return Candidate("nearest legs", partial(nearest_to_law, error.violations[0]))

    return first_certified([Candidate("the action's own legs", by_law, amended)], Effort())


def _nearest(
    start: Hitch, polygon: Outline, fractions: ArrayLike, requirements: Requirements
) -> Hitch:
    """Return the feasible hitch with the nearest fractions."""
    return Hitch.nearest(
        start.team,
        polygon,
        start.altitude,
        fractions,
        roll=start.roll,
        limits=requirements.limits,
        separation=requirements.separation,
        arena=requirements.arena,
    )


def spread_hitch(
    team: Team, polygon: ConvexPolygon, altitude: float, requirements: Requirements
) -> Hitch | None:
    """Return the hitch with spread legs without roll, or None if they break a distance."""

    def spread() -> Hitch | None:
        """Return the hitch."""
        legs = balanced_legs(team, polygon)
        split = LegTask.at_rest(team, polygon, legs, requirements, SPREAD_MARGIN).split()
        return Hitch(team, polygon, altitude, split.q_legs[0]) if split.margin >= 1.0 else None

    return if_feasible("spread legs", spread, None)
