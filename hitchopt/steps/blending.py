"""Steps that go on into one another, as one motion from rest to rest."""

from __future__ import annotations

from collections.abc import Sequence
from typing import cast

import numpy as np

from hitchopt.errors import InputError
from hitchopt.motion.motion import Phase
from hitchopt.planners.path.blended_path import SAME, BlendedMorph, passing_times
from hitchopt.steps.certified_motions import flying
from hitchopt.steps.friction_lean import against_friction
from hitchopt.steps.hitch_step import ShapeStep
from hitchopt.steps.situation import Situation, StepPlan, StepTask
from hitchopt.steps.step import Step


def plan_blended(steps: Sequence[Step], task: StepTask) -> StepPlan:
    """Return the plan of steps without a stop in between; ``task`` is that of the first.

    One path through all hitches that they would have ended with, timed as a whole; each phase ends
    when its step's hitch is passed.

    Raises
    ------
    InputError: a step that moves nothing.
    InfeasibleError, HitchoptError: as ``Step.plan``.
    """
    requirements, hitches = task.requirements, [task.hitch]
    for i, step in enumerate(cast("Sequence[ShapeStep]", steps), task.index):
        here = StepTask(Situation.formed(hitches[-1]), i, requirements)
        end = step.end(here).hitch
        step.check_end(end, here)
        if np.max(np.abs(end.drones - hitches[-1].drones)) < SAME:
            raise InputError(
                f"mission[{i}].{step.name}",
                "no motion",
                "a step that moves something where steps are blended",
                "leave it out, or leave out blend",
            )
        hitches.append(end)
    planner = BlendedMorph(hitches, requirements)
    whole, flight = planner.problem, planner.solve()
    passed = passing_times(whole.path, whole.s[1:-1], flight)
    times = [0.0, *passed.tolist(), flight.duration]
    remarks = ["goes on without a stop"] * (len(steps) - 1) + [""]
    phases = [
        Phase(step.name, task.index + j, times[j], times[j + 1], remarks[j])
        for j, step in enumerate(steps)
    ]
    plan = task.ended(flying(flight, task.hitch.team, requirements, phases), hitches[-1])
    return against_friction(plan, timed=False)
