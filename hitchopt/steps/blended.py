"""Several steps without a stop in between, or with as few stops as possible."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

from hitchopt.errors import InfeasibleError, RequestError, broken_limit
from hitchopt.planners.blending import BlendedSteps, PassedStep
from hitchopt.planners.candidates import Candidate, first_certified
from hitchopt.planners.morph.morph import moves
from hitchopt.planners.task import (
    RestState,
    StepPlan,
    StepTask,
    plan_in_sequence,
    require_certified,
)
from hitchopt.steps.hitch_step import NonstopStep
from hitchopt.values.fields import with_fields


def plan_blended(steps: Sequence[NonstopStep], task: StepTask) -> StepPlan:
    """Return the plan of steps without a stop in between; ``task`` is the first step's.

    Where no such plan is found, it stops after as many of them as it can fly without a stop.
    Raises InputError for a step without motion.
    """

    def stopping(count: int, error: InfeasibleError) -> Candidate[StepPlan] | None:
        """Return the candidate that stops after ``count`` steps; None without any."""
        if count == 0:
            return None
        planner = partial(_plan_stopping, steps, count, _reason(error), task)
        return Candidate("flight with a stop", planner, lambda _: stopping(count - 1, error))

    nonstop = Candidate(
        "flight without a stop",
        partial(_plan_nonstop, steps, task),
        lambda error: stopping(len(steps) - 1, error),
    )
    return first_certified([nonstop], task.effort, task.progress)


def _reason(error: InfeasibleError) -> str:
    """Return the first limit that a plan breaks, without time and remedy."""
    if not error.violations:
        return str(error)
    first = error.violations[0]
    return broken_limit(
        first.constraint, first.value, first.limit, first.sense, first.unit, first.where
    )


def _plan_stopping(
    steps: Sequence[NonstopStep], count: int, reason: str, task: StepTask
) -> StepPlan:
    """Return the plan that stops after ``count`` steps, for a ``reason`` in its remark."""

    def first(task: StepTask) -> StepPlan:
        """Return the plan of the steps up to the stop."""
        plan = _plan_nonstop(steps[:count], task)
        return plan.with_remark(f"stops: without a stop, {reason}", at_end=True)

    def others(task: StepTask) -> StepPlan:
        """Return the plan of the steps after the stop."""
        after = replace(task, index=task.index + count)
        return plan_blended(steps[count:], after)

    return plan_in_sequence([first, others], task)


def _plan_nonstop(steps: Sequence[NonstopStep], task: StepTask) -> StepPlan:
    """Return the certified plan of steps without a stop; of one step that of its own."""
    if len(steps) == 1:
        return require_certified(steps[0].plan(task))
    passed = list[PassedStep]()
    start = task.hitch
    for index, step in enumerate(steps, task.index):
        step_task = StepTask(RestState(start.team, start.drones, start), index, task.requirements)
        end = step.end(step_task).hitch
        step.check_end(end, step_task)
        if not moves(start, end):
            bound = "a step with motion if steps are blended"
            remedy = "omit it, or omit blend"
            raise RequestError(f"mission[{index}].{step.name}", "no motion", bound, remedy)
        hitches = partial(step.passed, step_task)
        passed.append(PassedStep(step.name, hitches, step.prescribed_duration))
        start = end

    def stopped() -> list[StepPlan]:
        """Return the fastest certified plans of the steps, each from the end of the last one."""
        plans = list[StepPlan]()
        state = task.before
        for index, step in enumerate(steps, task.index):
            step_task = replace(task.within(task.requirements, state), index=index)
            untimed = with_fields(step, duration=None)
            plans.append(require_certified(untimed.plan_uncompensated(step_task)))
            state = plans[-1].after
        return plans

    free_legs = all(step.split is None for step in steps[:-1])
    return BlendedSteps(task, passed, stopped, free_legs).plan()
