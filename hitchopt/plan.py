"""The user's side: plan, look, save, load."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Generic

from numpy.typing import ArrayLike
from typing_extensions import TypeVar

from hitchopt.certificate import Certificate, certify
from hitchopt.errors import InfeasibleError
from hitchopt.export.directory import PLAN, SUMMARY, save_plan
from hitchopt.export.plan_file import read_plan, read_title
from hitchopt.export.sampling import States, states_at
from hitchopt.mission.loading import load_problem
from hitchopt.mission.problem import Problem
from hitchopt.mission.repair import BUDGET, NO_CHANGE, Suggestion, find_suggestions
from hitchopt.mission.solving import solve_problem
from hitchopt.model.motion import Flying, Motion, Phase

Progress = Callable[[str], None]

M = TypeVar("M", bound=Flying, default=Any)
"""What flies: a hitch's Motion or a SwarmMotion; left open where a file decides."""


@dataclass(frozen=True, eq=False)
class Plan(Generic[M]):
    """A certified motion of a hitch, or of a swarm without cables.

    Attributes
    ----------
    motion: the polynomials, and what they keep.
    certificate: its checks, valid for all t.
    title: what the problem is called.
    """

    motion: M
    certificate: Certificate
    title: str = ""

    @property
    def duration(self) -> float:
        """Of all steps together [s]."""
        return self.motion.duration

    @property
    def phases(self) -> tuple[Phase, ...]:
        """The steps' spans of time, in order."""
        return self.motion.phases

    def at(self, t: ArrayLike) -> States:
        """Return what drones and vertices do at times t (…) [s]: arrays of leading shape (…).

        After its end a plan stays at rest where it ended.

        Raises
        ------
        InputError: a time before the start, or one that is not finite.
        """
        return states_at(self.motion, t)

    def save(
        self, directory: Path | str, rate: float = 100.0, progress: Progress | None = None
    ) -> Path:
        """Write plan, setpoints at ``rate`` [Hz], certificate and picture; return the directory.

        All of them or none, also if the process is killed; only files of these names are replaced.

        Raises
        ------
        CertificateError: the certificate does not hold.
        InputError: a rate that is not positive.
        FileError: the directory cannot be written to.
        """
        from hitchopt.view.summary import save_summary

        motion = self.motion
        pictures = {}
        if isinstance(motion, Motion):
            hitch = motion
            pictures[SUMMARY] = lambda path: save_summary(path, hitch, self.certificate, self.title)

        def share(fraction: float) -> None:
            if progress is not None:
                progress(f"writing setpoints, {fraction:.0%}")

        return save_plan(directory, motion, self.certificate, self.title, rate, pictures, share)


def solve(problem: Problem | str | Path, progress: Progress | None = None) -> Plan:
    """Return the certified plan of a problem, or of the problem file at a path.

    Parameters
    ----------
    problem: what is to be flown.
    progress: called with what is being done now.

    Raises
    ------
    InputError, FileError: a problem that is wrong in itself.
    InfeasibleError: it cannot be met; says what binds, where and when.
    """
    task = problem if isinstance(problem, Problem) else load_problem(problem)
    found = solve_problem(task, progress)
    return Plan(found.motion, found.certificate, task.title)


def suggestions(
    problem: Problem | str | Path, budget: float = BUDGET, progress: Progress | None = None
) -> tuple[Suggestion, ...]:
    """Return up to three single changes that mend a problem, the smallest first; none if it is met.

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
    task = problem if isinstance(problem, Problem) else load_problem(problem)
    try:
        solve_problem(task, progress)
    except InfeasibleError as error:
        return find_suggestions(task, error, budget, progress)
    return ()


def repair(
    problem: Problem | str | Path, budget: float = BUDGET, progress: Progress | None = None
) -> Plan:
    """Return the certified plan of a problem, by the smallest single change that mends it.

    The plan's title tells the change; without need of one the plan is that of solve.

    Parameters
    ----------
    problem, budget, progress: as of suggestions.

    Raises
    ------
    InfeasibleError: what binds; no single change was found that mends it.
    InputError, FileError: a problem that is wrong in itself.
    """
    task = problem if isinstance(problem, Problem) else load_problem(problem)
    try:
        return solve(task, progress)
    except InfeasibleError as error:
        found = find_suggestions(task, error, budget, progress)
        if not found:
            note = f"{error.note}\n{NO_CHANGE}" if error.note else NO_CHANGE
            raise InfeasibleError(error.violations, note) from None
    change = found[0].change
    mended = solve(change.problem, progress)
    return replace(mended, title=f"{task.title} with {change}".strip())


def load(directory: Path | str) -> Plan:
    """Return the plan in a directory, its certificate computed anew from its polynomials.

    Raises
    ------
    FileError: no plan there, or one that is broken.
    """
    path = Path(directory) / PLAN
    motion = read_plan(path)
    return Plan(motion, certify(motion), read_title(path))
