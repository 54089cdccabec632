"""The Python interface of repair."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

from hitchopt.api import loaded, solve
from hitchopt.errors import InfeasibleError, Progress
from hitchopt.mission import NO_CHANGE
from hitchopt.mission.problem import Problem
from hitchopt.mission.solving import solve_problem
from hitchopt.plan import Plan
from hitchopt.planners.candidates import error_of, outcome
from hitchopt.repairs.repair import BUDGET, Suggestion, find_suggestions
from hitchopt.values.fields import suggest_keywords


@suggest_keywords
def suggestions(
    problem: Problem | str | Path, budget: float = BUDGET, progress: Progress | None = None
) -> tuple[Suggestion, ...]:
    """Return up to three changes that make a problem feasible, the smallest first.

    Each change has been verified by planning the changed problem. It affects one quantity, or two
    or three if no single one suffices. The result is empty if the problem is feasible. An empty
    result for an infeasible problem does not prove that no change exists.

    Parameters
    ----------
    problem: a problem, or the path of a problem file.
    budget: search time [s]; the last plan is completed.
    progress: status callback.
    """
    task = loaded(problem, "hitch")
    error = error_of(partial(solve_problem, task, progress))
    return () if error is None else find_suggestions(task, error, budget, progress)


@suggest_keywords
def repair(
    problem: Problem | str | Path, budget: float = BUDGET, progress: Progress | None = None
) -> Plan:
    """Return the certified plan of a problem with the smallest change that makes it feasible.

    The plan's title names the change; a feasible problem is planned unchanged. Arguments are those
    of ``suggestions``. Raises InfeasibleError if no change is found.
    """
    task = loaded(problem, "hitch")
    plan = outcome(partial(solve, task, progress=progress))
    if not isinstance(plan, InfeasibleError):
        return plan
    candidates = find_suggestions(task, plan, budget, progress)
    if not candidates:
        raise plan.with_note(NO_CHANGE)
    change = candidates[0].change
    plan = solve(change.problem, progress=progress)
    return replace(plan, title=f"{task.title} with {change}".strip())
