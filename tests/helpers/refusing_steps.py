"""Steps that refuse, fail or run out of time, handed to searches in place of real ones."""

from __future__ import annotations

from typing import Any

import hitchopt as ho
from hitchopt.errors import Violation
from hitchopt.planners.task import StepPlan, StepTask
from hitchopt.steps.moving import Hold

TRIANGLE = [[0.0, -1.0], [-0.4, 0.5], [0.4, 0.5]]
NEEDED_SPEED = 2.0  # [m/s] of the limit with which a brittle step is feasible


def refusal(name: str, limit: float, ratio: float = 2.0) -> ho.InfeasibleError:
    """Return the refusal of a quantity that exceeds its limit by a ratio."""
    value, remedy = ratio * limit, "lower it"
    violation = Violation(name, value, limit, "max", "", ("q0",), "at the start", remedy)
    return ho.InfeasibleError([violation])


def problem_of(step: Hold, **limits: Any) -> ho.Problem:
    """Return the problem of a triangle at rest, with a step."""
    team = ho.Team(3, 2.4)
    start = ho.Hitch.spread(team, TRIANGLE)
    return ho.Problem(team, start, (step,), limits=ho.Limits(**limits))


def brittle_problem(then: BaseException) -> ho.Problem:
    """Return a problem that needs a higher speed limit, and plans only once with such a limit.

    Every further plan ends with the exception ``then``.
    """
    planned = list[float]()

    class Brittle(Hold):
        """A step that breaks once it has been planned."""

        def plan(self, task: StepTask) -> StepPlan:
            speed = task.requirements.limits.speed
            if speed < NEEDED_SPEED:
                raise refusal("speed", speed, 1.01)
            if planned:
                raise then
            planned.append(speed)
            return super().plan(task)

    return problem_of(Brittle(1.0), speed=1.0)
