"""Whether a hitch holds an object by its rim at rest, and what to change where it does not."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import partial
from itertools import chain
from typing import Any

import numpy as np

from hitchopt.errors import HitchoptError, InfeasibleError, Violation
from hitchopt.hitch import Hitch, Team
from hitchopt.planners.carrying.held_motion import HeldHitch
from hitchopt.planners.carrying.moves import held_flight
from hitchopt.planners.carrying.rest_capacity import (
    EASED,
    EMPTY,
    TENSIONS,
    broken_at,
    rest_capacity,
)
from hitchopt.planners.carrying.rest_polygon import rest_polygons
from hitchopt.requirements import Requirements
from hitchopt.steps.carrying import (
    gap_around,
    gap_below,
    held_motion,
    polygon_at,
    resting_move,
    rim_move,
    transferred,
)
from hitchopt.steps.certified_motions import Certified, certified, infeasible
from hitchopt.steps.end_hitch import end_of_morph, split_hitch
from hitchopt.steps.situation import Holding, StepTask
from hitchopt.steps.slack_split import RolledLegs

WEIGHTY = frozenset({"load", "thrust", "tilt", "equilibrium"})
"""Limits at which less weight, or more of what bears it, is all that helps."""

LIGHTER = np.append(np.arange(1.0, 0.85, -0.03), np.geomspace(0.85, 0.1, 10))
"""Masses that certificates are computed for, over the largest."""

NEAR = 0.02
"""Share by which a tension that is suggested differs at least from the one that was asked for."""

TRIED = 8
"""Tensions that certificates are computed for."""

OTHER_ROBOTS = 5
"""So many more or fewer robots are tried."""

MORE_ROLL = 1.3
"""Factor of the least roll with which legs without a load keep off each other, where a load brings
them nearer."""

SPARE, SPREAD = 1.01, 1.03
"""Distances of the hitch at rest, over those to be kept: those with which legs stay as they are,
since the way takes some of them, and those to which they are moved otherwise."""


class HoldRefusedError(InfeasibleError):
    """A hold that breaks limits at rest.

    Attributes
    ----------
    task: of the step after which the hitch would hold the object.
    """

    def __init__(self, violations: Iterable[Violation], task: StepTask) -> None:
        self.task = task
        super().__init__(violations)


def check_hold(task: StepTask, *, taken: bool) -> None:
    """Raise HoldRefusedError where the hitch cannot hold the object of the task at rest.

    Parameters
    ----------
    taken: whether it has to rise to the rim and take the weight as well.
    """
    name = task.holding.name
    words = f"with objects.{name} on the clasps"
    try:
        found = _at_rest(task)
        if taken and found.certificate.certified:
            words = f"as the clasps take objects.{name}"
            found = _taken(task)
    except InfeasibleError as error:
        raise HoldRefusedError([replace(v, when=words) for v in error.violations], task) from None
    if not found.certificate.certified:
        raise HoldRefusedError(infeasible(found.certificate, found.motion, words).violations, task)


def farther_legs(start: Hitch, hitch: Hitch, requirements: Requirements) -> RolledLegs:
    """Return legs that keep larger distances: rolled more, if they are rolled, or moved on.

    Parameters
    ----------
    start, hitch: before and after closing.
    """
    if np.any(hitch.roll):
        return RolledLegs(hitch.q_legs, MORE_ROLL * hitch.roll)
    moved = end_of_morph(start, hitch.polygon, None, spaced(requirements, SPREAD)).hitch
    return RolledLegs(moved.q_legs, moved.roll)


def spaced(requirements: Requirements, factor: float) -> Requirements:
    """Return requirements with larger distances between drones and cables."""
    far = {key: factor * value for key, value in vars(requirements.separation).items()}
    return replace(requirements, separation=replace(requirements.separation, **far))


def advised(error: InfeasibleError) -> InfeasibleError:
    """Return an error that says what to change, where it is that a hold is refused.

    Certificates hold for taking the object's weight with any of the changes.
    """
    if not isinstance(error, HoldRefusedError):
        return error
    task = error.task
    held = _held(task)
    legs = list(_legs(task))
    ways = [*_lighter(task, legs), *_tighter(task, legs), *_by_others(task)]
    capacity = rest_capacity(held, task.holding.tension, task.requirements.limits)
    told = []
    for each in error.violations:
        own = [] if each.constraint in WEIGHTY else [each.remedy]
        if each.constraint == "tilt":
            own = ["raise limits.tilt_deg"]
        remedy = ", or ".join([*ways, *own]) or "use stronger quadrotors or a lighter object"
        binds = f" ({capacity.binding} binds)" if each.constraint == "load" else ""
        told.append(replace(each, remedy=remedy + binds))
    return InfeasibleError(told)


def _taken(task: StepTask) -> Certified:
    """Return the certificate of the hitch that rises to the rim and takes the object's weight.

    Raises
    ------
    InfeasibleError: a weight that the tensions cannot carry.
    """
    moves = rim_move(task, gap_below(task.requirements), 0.0), transferred(task, 0.0, 1.0)
    return certified(held_motion(task, [held_flight(_held(task), move) for move in moves], "lift"))


def _held(task: StepTask) -> HeldHitch:
    held = task.holding.held
    assert isinstance(held, HeldHitch)
    return held


def _at_rest(task: StepTask) -> Certified:
    """Return the certificate of the hitch at rest that bears the object's weight.

    Raises
    ------
    InfeasibleError: a weight that the tensions cannot carry.
    """
    held, holding, here = _held(task), task.holding, _holding(task, borne=True)
    held.at_rest(holding.tension, held.body.mass)
    return certified(held_motion(here, [held_flight(held, resting_move(here, 1.0))], "hold"))


def _holds(task: StepTask, legs: Iterable[Hitch] = ()) -> bool:
    """Return whether the hitch rises to the rim and takes the object's weight.

    Distances are kept a little larger than asked for, since motions take some of that.

    Parameters
    ----------
    legs: hitches whose legs are tried besides its own.
    """
    held, task = _held(task), replace(task, requirements=spaced(task.requirements, SPARE))
    tasks = (_holding(task, held=replace(held, fractions=h.fractions, roll=h.roll)) for h in legs)
    for each in chain([task], tasks):
        try:
            if _taken(each).certificate.certified:
                return True
        except InfeasibleError:
            continue
    return False


def _legs(task: StepTask) -> Iterator[Hitch]:
    """Yield hitches with the other legs that are tried before a hold is refused."""
    hitch, requirements = task.hitch, task.requirements
    for legs in (
        partial(farther_legs, hitch, hitch, requirements),
        partial(RolledLegs, "balanced"),
    ):
        try:
            yield split_hitch(hitch.team, hitch.polygon, hitch.altitude, legs(), requirements)
        except InfeasibleError:
            continue


def _lighter(task: StepTask, legs: list[Hitch]) -> Iterator[str]:
    """Yield the largest mass tried with which a lighter object is held, if there is one."""
    name, held, limits = task.holding.name, _held(task), task.requirements.limits
    capacity = rest_capacity(held, task.holding.tension, limits).mass
    upper = EASED * min(capacity, held.body.mass)
    if upper == 0.0:
        return
    masses = (float(f"{share * upper:.3g}") for share in LIGHTER)
    found = next((mass for mass in masses if _holds(_with_mass(task, mass), legs)), None)
    if found is not None:
        yield f"lower objects.{name}.mass to {found:g} kg"


def _tighter(task: StepTask, legs: list[Hitch]) -> Iterator[str]:
    """Yield the tension nearest to that asked with which it is held, if there is one."""
    held, limits = _held(task), task.requirements.limits
    asked = float(np.mean(task.holding.tension))
    others = TENSIONS[np.abs(TENSIONS - asked) > NEAR * asked]
    near = sorted(others, key=lambda value: abs(value - asked))
    fitting = (
        value
        for value in (float(f"{each:.3g}") for each in near)
        for pulls in [np.full(held.team.robots, value)]
        if not broken_at(held, held.body.mass, pulls, limits)
        and not broken_at(held, 0.0, EMPTY * pulls, limits)
    )
    for value, _ in zip(fitting, range(TRIED), strict=False):
        pulls = np.full(held.team.robots, value)
        if _holds(_holding(task, tension=pulls), legs):
            yield f"ask for a tension of {value:g} N"
            return


def _by_others(task: StepTask) -> Iterator[str]:
    """Yield the number of robots nearest to the team's that hold it, if there is one."""
    team = task.before.team
    if len(set(team.quadrotor)) > 1 or np.ptp(team.cable_length) > 0.0:
        return
    for change in range(1, 1 + OTHER_ROBOTS):
        for robots in (team.robots + change, team.robots - change):
            try:
                other = _with_robots(task, robots)
            except HitchoptError:
                continue
            if _holds(other, _legs(other)):
                yield f"use {robots} robots"
                return


def _with_mass(task: StepTask, mass: float) -> StepTask:
    """Return the task with an object of another mass [kg]."""
    name, held = task.holding.name, _held(task)
    body = replace(held.body, mass=mass)
    objects = {**task.requirements.objects, name: body}
    lighter = replace(task, requirements=replace(task.requirements, objects=objects))
    return _holding(lighter, held=replace(held, body=body))


def _with_robots(task: StepTask, robots: int) -> StepTask:
    """Return the task of another number of them, whose legs are balanced.

    Raises
    ------
    HitchoptError: too few or too many, or no polygon below the rim.
    """
    held, old = _held(task), task.before.team
    body = held.body
    assert body.rim is not None
    team = Team(
        robots,
        float(old.cable_length[0]),
        cable_density=old.cable_density,
        cable_friction=old.cable_friction,
        tension=float(np.mean(old.tension)),
        quadrotor=old.quadrotor[0],
    )
    polygons = rest_polygons(task.holding.name, body, robots, gap_around(task.requirements))
    at, legs = float(body.at[2]) + body.rim.height, RolledLegs("balanced")
    hitch = split_hitch(team, polygon_at(body, polygons.closed), at, legs, task.requirements)
    places = np.column_stack([polygons.closed, np.full(robots, body.rim.height)])
    pulls = np.full(robots, float(np.mean(task.holding.tension)))
    other = HeldHitch(team, body, places, hitch.fractions, hitch.roll)
    holding = Holding(task.holding.name, polygons, pulls, other)
    return replace(task, before=replace(task.before, team=team, hitch=hitch, holding=holding))


def _holding(task: StepTask, **changes: Any) -> StepTask:
    """Return the task with a hitch that holds the object otherwise."""
    return replace(task, before=replace(task.before, holding=replace(task.holding, **changes)))
