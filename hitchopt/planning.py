"""The user's side of whole problems: plan one, or find what change would make it feasible."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from hitchopt.errors import InfeasibleError
from hitchopt.mission.problem import Problem
from hitchopt.mission.repair.change import BUDGET, NO_CHANGE, Suggestion
from hitchopt.mission.solving import solve_problem
from hitchopt.mission.swarm_problem import SwarmProblem
from hitchopt.mission.swarm_solving import solve_swarm
from hitchopt.motion.asked import check_asked
from hitchopt.plan import Plan
from hitchopt.time_limit import Progress, time_limit
from hitchopt.values import instance, positive


def solve(
    problem: Problem | SwarmProblem | str | Path,
    progress: Progress | None = None,
    *,
    limit: float | None = None,
) -> Plan:
    """Return the certified plan of a problem, or of the problem file at a path.

    Parameters
    ----------
    problem: what is to be flown.
    progress: called with what is being done now.
    limit: gives up after so many seconds; None: takes as long as it takes.

    Raises
    ------
    InputError, FileError: a problem that is wrong in itself.
    InfeasibleError: it cannot be met; says what binds, where and when.
    TimeLimitError: no plan within ``limit``.
    """
    if isinstance(problem, str | Path):
        from hitchopt.mission.loading import read_problem  # heavy, as of all files

        problem = read_problem(problem)
    instance("problem", problem, Problem, SwarmProblem)
    seconds = None if limit is None else positive("limit", limit)
    with time_limit(seconds, progress) as tell:
        if isinstance(problem, SwarmProblem):
            found = solve_swarm(tell, problem)
        else:
            found = solve_problem(problem, tell)
    check_asked(problem.asked, found.motion, whole=False)
    return Plan(found.motion, found.certificate, problem.title)


def separate(
    problem: SwarmProblem | str | Path,
    progress: Progress | None = None,
    *,
    limit: float | None = None,
) -> Plan:
    """Return the certified plan of single drones that keep out of each other's downwash.

    Parameters
    ----------
    problem: who flies from where to where, or the path of such a problem's file.
    progress: called with what is being done now.
    limit: gives up after so many seconds; None: takes as long as it takes.

    Raises
    ------
    InputError, FileError: a problem that is wrong in itself.
    InfeasibleError: it cannot be met; says which drones, where and when.
    TimeLimitError: no plan within ``limit``.
    """
    if isinstance(problem, str | Path):
        from hitchopt.mission.loading import load_swarm

        problem = load_swarm(problem)
    instance("problem", problem, SwarmProblem)
    return solve(problem, progress, limit=limit)


def suggestions(
    problem: Problem | str | Path, budget: float = BUDGET, progress: Progress | None = None
) -> tuple[Suggestion, ...]:
    """Return up to three single changes that make a problem feasible, the smallest first.

    There is none where it is feasible already.

    Each has been verified by planning the problem with it. None is no proof that there is none.

    Parameters
    ----------
    problem: or the path of a problem file.
    budget: how long to search [s]; the last plan that was begun is waited for.
    progress: called with what is being done now.

    Raises
    ------
    InputError, FileError: a problem that is wrong in itself.
    """
    task = _loaded(problem)
    try:
        solve_problem(task, progress)
    except InfeasibleError as error:
        from hitchopt.mission.repair.suggest import find_suggestions

        return find_suggestions(task, error, budget, progress)
    return ()


def repair(
    problem: Problem | str | Path, budget: float = BUDGET, progress: Progress | None = None
) -> Plan:
    """Return the certified plan of a problem, by the smallest single change that makes it feasible.

    The plan's title names the change; a feasible problem gives the plan of ``solve``.

    Parameters
    ----------
    problem, budget, progress: as of suggestions.

    Raises
    ------
    InfeasibleError: what binds; no single change was found that makes it feasible.
    InputError, FileError: a problem that is wrong in itself.
    """
    task = _loaded(problem)
    try:
        return solve(task, progress)
    except InfeasibleError as error:
        from hitchopt.mission.repair.suggest import find_suggestions

        found = find_suggestions(task, error, budget, progress)
        if not found:
            note = f"{error.note}\n{NO_CHANGE}" if error.note else NO_CHANGE
            raise InfeasibleError(error.violations, note) from None
    change = found[0].change
    found_plan = solve(change.problem, progress)
    return replace(found_plan, title=f"{task.title} with {change}".strip())


def _loaded(problem: Problem | str | Path) -> Problem:
    if isinstance(problem, str | Path):
        from hitchopt.mission.loading import load_problem

        return load_problem(problem)
    instance("problem", problem, Problem)
    return problem
