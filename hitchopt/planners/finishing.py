"""Plans as slices finish them: legs that lean against friction, and rests after the last step."""

from __future__ import annotations

from typing import NamedTuple

from hitchopt.planners.task import StepPlan, StepTask
from hitchopt.slices import hooks


class Finished(NamedTuple):
    """A plan as slices finish it."""

    plan: StepPlan  # The plan
    share: float = 1.0  # Smallest share of what they correct that limits allow


def finished(plan: StepPlan, *, timed: bool) -> Finished:
    """Return the plan as slices finish it; ``timed`` if its duration is prescribed."""
    share = 1.0
    for finish in hooks("finish"):
        plan, allowed = finish(plan, timed=timed)
        share = min(share, allowed)
    return Finished(plan, share)


def after_step(plan: StepPlan, task: StepTask, settle: float | str | bool) -> StepPlan:
    """Return the plan of a step with what slices append; ``settle`` is ``Step.settling``."""
    for append in hooks("after_step"):
        plan = append(plan, task, settle)
    return plan
