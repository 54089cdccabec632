"""Several steps without a stop in between, or with as few stops as possible."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial

from hitchopt.checks.linking import DURATION
from hitchopt.errors import InfeasibleError, RequestError, broken_limit
from hitchopt.hitch import Hitch
from hitchopt.motion.motion import concatenated
from hitchopt.planners.blending import BlendedSteps, PassedStep, hitches_along
from hitchopt.planners.candidates import Candidate, first_certified, outcome
from hitchopt.planners.morph.morph import moves
from hitchopt.planners.task import RestState, StepPlan, StepTask, require_certified
from hitchopt.steps.hitch_step import NonstopStep
from hitchopt.values.fields import with_fields


def plan_blended(steps: Sequence[NonstopStep], task: StepTask) -> StepPlan:
    """Return the plan of steps without a stop in between; ``task`` is the first step's.

    Where no such plan is found, or none that is faster than with stops, it stops after as many of
    them as it can fly without a stop. Raises InputError for a step without motion.
    """
    blended = list[BlendedStep]()
    state = task.before
    for index, step in enumerate(steps, task.index):
        step_task = replace(task.within(task.requirements, state), index=index)
        blended.append(BlendedStep(step, step_task))
        state = blended[-1].after
        if not moves(step_task.hitch, state.tied):
            bound = "a step with motion if steps are blended"
            remedy = "omit it, or omit blend"
            raise RequestError(f"mission[{index}].{step.name}", "no motion", bound, remedy)
    return _plan_with_few_stops(blended)


@dataclass(frozen=True, eq=False)
class BlendedStep:
    """A step that is flown without a stop, or stops."""

    step: NonstopStep
    task: StepTask  # Its task if the steps before it stop

    @cached_property
    def stopping(self) -> StepPlan | InfeasibleError:
        """Its certified plan from rest to rest, or why there is none.

        It takes longer than the step's duration if that is too short for a stop.
        """
        task = self.task
        steps = [self.step]
        if self.step.prescribed_duration is not None:
            steps.append(with_fields(self.step, duration=None))

        def certified(step: NonstopStep) -> StepPlan:
            """Return the certified plan of the step, with its duration or without."""
            return require_certified(step.plan(task))

        candidates = [Candidate("step with a stop", partial(certified, step)) for step in steps]
        return outcome(partial(first_certified, candidates, task.effort, task.progress))

    @cached_property
    def after(self) -> RestState:
        """The state after it; raises InfeasibleError if it breaks a limit at rest."""
        if isinstance(self.stopping, StepPlan):
            return self.stopping.after
        end = self.step.end(self.task).hitch
        self.step.check_end(end, self.task)
        return replace(self.task.before, hitch=end, drones=end.drones)

    @property
    def passed(self) -> PassedStep:
        """The step of a flight without a stop."""
        stopping = self.stopping if isinstance(self.stopping, StepPlan) else None
        return PassedStep(self.step.name, self.hitches, self.step.prescribed_duration, stopping)

    @cached_property
    def hitches(self) -> Callable[[int], list[Hitch]]:
        """A function that returns the end, and before it a number of hitches, or about it.

        They are of the route on which it stops. They are found once for all flights that pass them.
        """
        return cache(self._hitches)

    def _hitches(self, count: int) -> list[Hitch]:
        """Return the end, and before it about ``count`` hitches."""
        route = self.stopping.path if isinstance(self.stopping, StepPlan) else None
        if route is not None and count > 0:
            on_way = hitches_along(route, count)
        else:
            on_way = self.step.on_way(self.task, count)
        return [*on_way, self.after.tied]


def _plan_with_few_stops(steps: Sequence[BlendedStep]) -> StepPlan:
    """Return the certified plan that stops after as many steps as it can fly without a stop."""
    task = steps[0].task

    def stopping(count: int, error: InfeasibleError) -> Candidate[StepPlan] | None:
        """Return the candidate that stops after ``count`` steps; None without any."""
        if count == 0:
            return None
        planner = partial(_plan_stopping, steps, count, _reason(error))
        return Candidate("flight with a stop", planner, lambda _: stopping(count - 1, error))

    nonstop = Candidate(
        "flight without a stop",
        partial(_plan_nonstop, steps),
        lambda error: stopping(len(steps) - 1, error),
    )
    return first_certified([nonstop], task.effort, task.progress)


def _reason(error: InfeasibleError) -> str:
    """Return why a flight stops, from what it would break without a stop."""
    if not error.violations:
        return f"without a stop, {error}"
    first = error.violations[0]
    if first.constraint == DURATION.name:
        return f"not faster without a stop ({first.value:.3g} s or more, {first.limit:.3g} s with)"
    limit = broken_limit(
        first.constraint, first.value, first.limit, first.sense, first.unit, first.where
    )
    return f"without a stop, {limit}"


def _plan_stopping(steps: Sequence[BlendedStep], count: int, reason: str) -> StepPlan:
    """Return the plan that stops after ``count`` steps, for a ``reason`` in its remark."""
    first = _plan_nonstop(steps[:count])
    first = first.with_remark(f"stops: {reason}", at_end=True)
    others = _plan_with_few_stops(steps[count:])
    return StepPlan(concatenated([first.motion, others.motion]), others.after)


def _plan_nonstop(steps: Sequence[BlendedStep]) -> StepPlan:
    """Return the certified plan of steps without a stop; of one step that of its own."""
    if len(steps) > 1:
        free_legs = all(blended.step.split is None for blended in steps[:-1])
        passed = [blended.passed for blended in steps]
        return BlendedSteps(steps[0].task, passed, free_legs).plan()
    if isinstance(steps[0].stopping, InfeasibleError):
        raise steps[0].stopping
    return steps[0].stopping
