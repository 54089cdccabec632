"""How far legs are rolled out of their plane, where level ones come too near to cables.

Along nearly straight edges a drone on a level leg stands beside its own edge, ``d sin φ`` from it.
A roll lifts it off: the exterior angle φ no longer limits the number of robots. One angle serves
all clasps, the smallest that is found: rolled legs pull up or down as well, which costs thrust.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import product

import numpy as np

from hitchopt.errors import InfeasibleError
from hitchopt.geometry.vectors import dot, length, unit
from hitchopt.hitch.leg_lengths import reference_kept, reference_margin, split_slack
from hitchopt.hitch.leg_program import LegBodies
from hitchopt.hitch.leg_task import LIMIT_MARGIN, LegLengths, LegTask
from hitchopt.hitch.statics import leg_directions
from hitchopt.values import Array

LADDER = tuple(math.radians(angle) for angle in (5.0, 10.0, 15.0, 20.0, 30.0, 40.0, 50.0, 60.0))
"""[rad] Rolls that are tried until one suffices: up to 60° clasps hold in simulated ropes."""

COARSE = tuple(math.radians(angle) for angle in (20.0, 40.0))
"""[rad] Rolls at which other lengths of legs are looked for, which takes longer."""

HALVINGS = 7
"""Number of halvings of the step of the ladder in which the smallest roll lies: 0.1° are left."""

LESS = 0.9
"""Share of the roll that the reference needs at which other leg lengths have to suffice, for a
search with all of them to be worth its time."""


def split_with_least_roll(task: LegTask) -> tuple[LegLengths, Array]:
    """Return leg lengths on one polygon and the roll (clasps,) [rad] that goes with them.

    There is no roll where legs keep all limits without. Else it is the smallest one found with
    which they keep the margin that is wanted, else the limits; none where no roll helps. Its
    sense is that of the task's own roll, upward of q-legs without one. Where legs carry weight the
    other sense is tried as well if that one does not help.

    Parameters
    ----------
    task: of one polygon; its own roll is what legs have without need.
    """
    own = np.zeros(len(task.team.layout.clasps)) if task.roll is None else task.roll[0]
    without = reference_kept(task, LegBodies(task, *task.bounds))
    if without is None and level_margin_bound(task) >= 1.0:
        without = split_slack(task)
    if without is not None and without.margin >= 1.0:
        return without, own
    margins: dict[float, float] = {}  # of chosen lengths, at the rolls that were tried
    for sense, margin in product(_senses(task, own), dict.fromkeys((task.wanted, LIMIT_MARGIN))):
        aim = replace(task, margin=margin)
        roll = _least(aim, margins, sense)
        if roll is not None:
            return split_slack(_rolled(aim, roll)), np.full(len(own), roll)
    return without or split_slack(task), own


def level_margin_bound(task: LegTask) -> float:
    """Return a bound of the margin that any leg lengths have without roll, infinite if unknown.

    A leg of length d at an angle to its own edge ends at most ``d sin`` from it, and d is at most
    the slack of its cable. Legs that may end beyond the edge do not count.
    """
    team, cable = task.team, task.requirements.separation.cable
    if not task.level or cable == 0.0:
        return math.inf
    edges = team.layout.edges(task.polygons)
    lengths, u = length(edges), unit(edges)
    q, r = leg_directions(u, team.tension, team.topology)
    reach = task.slack
    bound = math.inf
    for out, along in ((q, u), (r, -u)):
        ahead = dot(out, along)
        beside = (ahead > 0.0) & (reach * ahead <= lengths) & (reach > 0.0)
        away = reach * np.sqrt(np.maximum(1.0 - ahead**2, 0.0))
        bound = min(bound, float(np.min(away, where=beside, initial=math.inf)) / cable)
    return bound


def least_roll_of_reference(task: LegTask) -> Array:
    """Return the smallest roll (clasps,) [rad] with which the reference itself keeps all limits.

    None, which is zero, where it keeps them without, or where no roll is found to help.
    """
    none = np.zeros(len(task.team.layout.clasps))
    if reference_margin(task) >= 1.0:
        return none
    rolls = (_least_as_they_are(task, sense) for sense in _senses(task, none))
    return none + next((roll for roll in rolls if roll is not None), 0.0)


def _senses(task: LegTask, own: Array) -> tuple[float, ...]:
    """Return the signs of the rolls that are tried, that of the task's own roll first.

    Without weight one is the other one seen from below. A plan whose roll changes its sense passes
    through none: the smaller one of the two is not looked for.
    """
    first = -1.0 if np.sum(own) < 0.0 else 1.0
    return (first, -first) if task.team.loaded else (first,)


def _least(task: LegTask, margins: dict[float, float], sense: float) -> float | None:
    """Return the smallest roll [rad] with which leg lengths keep the task's margin, or None.

    Lengths as they are come first, which takes no program to be solved.

    Parameters
    ----------
    margins: those of chosen lengths at the rolls of COARSE, once they are known.
    sense: sign of the rolls.
    """

    def chosen(angle: float) -> bool:
        roll = sense * angle
        if angle not in COARSE:
            return split_slack(_rolled(task, roll)).margin >= task.wanted * (1.0 - 1e-6)
        if roll not in margins:
            margins[roll] = split_slack(_rolled(task, roll)).margin
        return margins[roll] >= task.wanted * (1.0 - 1e-6)

    given = _least_as_they_are(task, sense)
    if given is None:
        found = _first(chosen, COARSE, 3)
    elif _possible(chosen, LESS * abs(given)):
        found = _first(chosen, (LESS * abs(given),), 3)
    else:
        return given
    return None if found is None else sense * found


def _least_as_they_are(task: LegTask, sense: float) -> float | None:
    """Return the same of the reference's own leg lengths."""

    def suffices(angle: float) -> bool:
        return reference_margin(_rolled(task, sense * angle)) >= task.wanted

    found = _first(suffices, LADDER)
    return None if found is None else sense * found


def _first(
    suffices: Callable[[float], bool], ladder: tuple[float, ...], halvings: int = HALVINGS
) -> float | None:
    """Return the smallest roll that is found to suffice, between two rungs of a ladder; or None."""
    lower = 0.0
    for rung in ladder:
        if _possible(suffices, rung):
            upper = rung
            for _ in range(halvings):
                middle = 0.5 * (lower + upper)
                lower, upper = (lower, middle) if _possible(suffices, middle) else (middle, upper)
            return upper
        lower = rung
    return None


def _possible(suffices: Callable[[float], bool], roll: float) -> bool:
    """Return whether a roll suffices; one that leaves loads no balance does not."""
    try:
        return suffices(roll)
    except InfeasibleError:
        return False


def _rolled(task: LegTask, roll: float) -> LegTask:
    return replace(task, roll=np.full((1, len(task.team.layout.clasps)), roll))
