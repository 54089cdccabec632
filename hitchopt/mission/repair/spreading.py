"""Legs spread where others were given, as changes of one size only."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from hitchopt.errors import InfeasibleError
from hitchopt.geometry import Outline
from hitchopt.hitch.cable_slack import balanced_legs
from hitchopt.mission.problem import HitchStart, Problem
from hitchopt.mission.repair.change import Change, Edit, Edited
from hitchopt.mission.repair.constraints import broken_constraints
from hitchopt.mission.repair.editing import with_step_edit
from hitchopt.steps.edits import SPACE, StepEdit
from hitchopt.steps.end_hitch import split_hitch
from hitchopt.steps.slack_split import RolledLegs, SlackSplit

COVERS = SPACE | {"crossing", "arena"}


def spread_changes(problem: Problem, error: InfeasibleError) -> Iterator[Change]:
    """Yield the changes from given or balanced legs to spread ones, at the start and after steps.

    Their relative size is the farthest that a drone goes, over its cable's length.
    """
    if not broken_constraints(error) <= COVERS:
        return
    outline, start = problem.start_outline, problem.start
    places: list[tuple[str, SlackSplit, Outline, Edited]] = []
    if isinstance(start, HitchStart) and outline is not None:
        key, changed = "start.hitch.legs", replace(problem, start=replace(start, legs="spread"))
        places.append((key, start.legs, outline, Edited(changed, (Edit(key, "spread"),))))
    for i, step in enumerate(problem.mission):
        outline = step.polygon_left(problem.team, outline)
        legs = getattr(step, "legs", None)
        if legs is not None and outline is not None:
            edited = with_step_edit(problem, i, StepEdit("legs", "spread", {"legs": "spread"}))
            places.append((edited.edits[0].key, legs, outline, edited))
    for key, legs, shape, edited in places:
        sharing = legs.sharing if isinstance(legs, RolledLegs) else legs
        if isinstance(sharing, str) and sharing == "spread":
            continue
        try:
            relative = _farthest(problem, shape, legs)
        except InfeasibleError:  # no cable is left for any legs
            continue
        words = legs if isinstance(legs, str) else "as given"
        yield Change(key, "", words, "spread", "", relative, edited.problem, edited.edits)


def _farthest(problem: Problem, outline: Outline, legs: SlackSplit) -> float:
    """Return how far a leg is from the spread ones at most, over its cable's length."""
    team = problem.team
    lengths = legs.sharing if isinstance(legs, RolledLegs) else legs
    given = balanced_legs(team, outline) if isinstance(lengths, str) else lengths
    spread = split_hitch(team, outline, 0.0, "spread", problem.requirements)
    return float(np.max(np.abs(spread.q_legs - given) / team.cable_length))
