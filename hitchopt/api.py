"""The Python interface: plan problems, missions and single steps; export plans.

``solve`` plans problems and problem files. ``Mission`` builds a problem step by step, with a method
for each kind of step. Kinds of steps without an object are functions too: ``morph``, ``form``, ….
Methods and functions are generated from ``hitchopt.steps.STEPS``, with the arguments and docstrings
of the steps' records; ``__init__.pyi`` lists them for type checkers and completion.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Self, TypedDict

from numpy.typing import ArrayLike

from hitchopt.errors import InfeasibleError, InputError, Progress, time_limit
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.requirements import Arena, Limits, Separation
from hitchopt.mission.problem import DronesStart, Problem, Start
from hitchopt.mission.repair import BUDGET, NO_CHANGE, Suggestion, find_suggestions
from hitchopt.mission.solving import solve_problem
from hitchopt.motion.request import check_request
from hitchopt.plan import Plan, load
from hitchopt.steps import STEPS
from hitchopt.steps.moving import Settle
from hitchopt.steps.step import Stage, Step
from hitchopt.steps.straddling import Tie
from hitchopt.storage.yaml_file import read_text
from hitchopt.values import check_instance, path, positive, text
from hitchopt.values.fields import EMPTY, check_keywords, keys_of, parameter_docs

if TYPE_CHECKING:
    from hitchopt.exports.exporting import Export

Legs = str | Sequence[float] | ArrayLike | Mapping[str, Any]
"""Legs as an argument: a mode, (n,) ``d_k`` [m], or a mapping with sharing and roll_deg."""


def solve(
    problem: Problem | str | Path,
    progress: Progress | None = None,
    *,
    limit: float | None = None,
) -> Plan:
    """Return the certified plan of a problem.

    Parameters
    ----------
    problem: a problem, or the path of a problem file.
    progress: status callback.
    limit: time limit [s]; None for none.

    Raises
    ------
    InputError, FileError: the problem is invalid.
    InfeasibleError: the problem cannot be met; lists the limits that bind, where and when.
    TimeLimitError: no plan within ``limit``.
    """
    source = ""
    if isinstance(problem, str | Path):
        from hitchopt.mission.loading import parse_problem  # heavy

        source, name = read_text(problem)
        problem = parse_problem(source, name, Path(problem).parent)
    task = _loaded(problem)
    with time_limit(_seconds(limit), progress) as report:
        solution = solve_problem(task, report)
    check_request(task.request, solution.motion)
    return Plan(solution.motion, solution.certificate, task.title, source)


def separate(
    problem: Problem | str | Path,
    progress: Progress | None = None,
    *,
    limit: float | None = None,
) -> Plan:
    """Return the certified plan of a problem of single drones that avoid each other's downwash.

    Arguments and errors are those of ``solve``.
    """
    return solve(_loaded(problem, "swarm"), progress, limit=limit)


def suggestions(
    problem: Problem | str | Path, budget: float = BUDGET, progress: Progress | None = None
) -> tuple[Suggestion, ...]:
    """Return up to three changes that make a problem feasible, the smallest first.

    Each change has been verified by planning the changed problem. It affects one quantity, or two
    or three if no single one suffices. The result is empty if the problem is feasible. An empty
    result for an infeasible problem is no proof that no change exists.

    Parameters
    ----------
    problem: a problem, or the path of a problem file.
    budget: search time [s]; the last plan is completed.
    progress: status callback.
    """
    task = _loaded(problem, "hitch")
    try:
        solve_problem(task, progress)
    except InfeasibleError as error:
        return find_suggestions(task, error, budget, progress)
    return ()


def repair(
    problem: Problem | str | Path, budget: float = BUDGET, progress: Progress | None = None
) -> Plan:
    """Return the certified plan of a problem with the smallest change that makes it feasible.

    The plan's title names the change; a feasible problem is planned unchanged. Arguments are those
    of ``suggestions``. Raises InfeasibleError if no change is found.
    """
    task = _loaded(problem, "hitch")
    try:
        return solve(task, progress)
    except InfeasibleError as error:
        candidates = find_suggestions(task, error, budget, progress)
        if not candidates:
            note = f"{error.note}\n{NO_CHANGE}" if error.note else NO_CHANGE
            raise InfeasibleError(error.violations, note) from None
    change = candidates[0].change
    return replace(solve(change.problem, progress), title=f"{task.title} with {change}".strip())


def _seconds(limit: Any) -> float | None:
    """Return a time limit [s], None for none; raise InputError if it is not positive."""
    return None if limit is None else positive("limit", limit)


def _loaded(given: Any, kind: Literal["hitch", "swarm"] | None = None) -> Problem:
    """Return a problem, of a kind if specified, loaded if it is a path."""
    from hitchopt.mission import loading  # heavy

    problem = loading.load_problem(given) if isinstance(given, str | Path) else given
    if not isinstance(problem, Problem):
        remedy = "read one with load_problem, or convert a dict with problem_from_dict"
        raise InputError("problem", problem, "a path or a hitchopt.Problem", remedy)
    problem = problem.problem if isinstance(problem, Mission) else problem
    if kind is not None and problem.kind != kind:
        key = "teams" if problem.kind == "teams" else "team"
        robots = "catenary robots" if kind == "hitch" else "single drones"
        raise InputError(key, problem.kind, f"one team of {robots}", "solve plans all kinds")
    return problem


@dataclass(frozen=True, eq=False)
class Mission(Problem):
    """A problem that is built step by step; every method returns a mission with one more step.

    There is a method for each kind of step, with the arguments of its record: ``form``, ``morph``,
    ``move_vertex``, …. It raises InputError if a step is invalid. The other arguments are those of
    a Problem.
    """

    complete: ClassVar[bool] = False
    mission: tuple[Step, ...] = ()

    @property
    def steps(self) -> tuple[Step, ...]:
        """The steps so far."""
        return self.mission

    @property
    def problem(self) -> Problem:
        """The problem that ``solve`` plans; raises InputError if the mission has no steps."""
        return Problem(
            **{each.name: getattr(self, each.name) for each in fields(self) if each.init}
        )

    def then(self, step: Step) -> Self:
        """Return the mission with one more step; raises InputError if the step does not fit."""
        check_instance("step", step, Step)
        return replace(self, mission=(*self.mission, step))

    def solve(self, progress: Progress | None = None, *, limit: float | None = None) -> Plan:
        """Return the certified plan; arguments and errors are those of ``hitchopt.solve``."""
        return solve(self.problem, progress, limit=limit)


class Required(TypedDict, total=False):
    """Keywords of every step function: requirements of the plan, and the time limit."""

    limits: Limits | None
    separation: Separation | None
    arena: Arena | None
    limit: float | None


START_PARAMETERS = {
    "start": "start: the hitch at t = 0.",
    "team": "team: the robots; the drones of robot k start at ``q[k]`` and ``r[k]``.\n"
    "q, r: (n, 3) [m], at rest: hovering, or on the ground with their cables between them.",
}
"""Documentation of the first parameters of step functions."""

REQUIREMENTS = """
limits, separation, arena: requirements of the plan; defaults as in a problem file.
limit: time limit [s]; None for none.

Raises
------
InputError: an argument is invalid.
InfeasibleError: the step cannot be planned; lists the limits that bind, where and when.
TimeLimitError: no plan within ``limit``.
"""


def _arguments(kind: type[Step]) -> dict[str, Any]:
    """Return the fields of a kind of step with their defaults, EMPTY for none."""
    return {name: key.default for name, key in keys_of(kind).items()}


def _documented(
    function: Callable[..., Any], name: str, arguments: Mapping[str, Any], doc: str
) -> Callable[..., Any]:
    """Return a function with a name, a signature with default arguments, and a docstring."""
    either, only = inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY
    function.__name__, function.__qualname__ = name.rpartition(".")[2], name
    function.__doc__ = doc
    kinds = {key: only if key in Required.__annotations__ else either for key in arguments}
    listed = [inspect.Parameter(k, kinds[k], default=v) for k, v in arguments.items()]
    vars(function)["__signature__"] = inspect.Signature(listed)
    return function


def _method(kind: type[Step]) -> Callable[..., Mission]:
    """Return the method of Mission that adds a step of a kind."""

    def method(self: Mission, *args: Any, **kwargs: Any) -> Mission:
        check_keywords(kind.name, [*_arguments(kind)], kwargs)
        bound = inspect.signature(method).bind(self, *args, **kwargs).arguments
        return self.then(kind(**{key: value for key, value in bound.items() if key != "self"}))

    doc = _docstring(kind, "Return the mission with this step", parameter_docs(kind))
    return _documented(method, f"Mission.{kind.name}", {"self": EMPTY, **_arguments(kind)}, doc)


def _function(kind: type[Step]) -> Callable[..., Plan]:
    """Return the function that plans a single step of a kind."""
    fields = {key: value for key, value in _arguments(kind).items() if key != "blend"}
    first = ("team", "q", "r") if kind.needs_hitch is False else ("start",)

    def function(*args: Any, **kwargs: Any) -> Plan:
        check_keywords(kind.name, [*arguments], kwargs)
        bound = inspect.signature(function).bind(*args, **kwargs).arguments
        requirements = {name: bound.pop(name, None) for name in Required.__annotations__}
        limit = _seconds(requirements.pop("limit"))
        start: Start
        if kind.needs_hitch is False:
            team, start = bound.pop("team"), DronesStart(bound.pop("q"), bound.pop("r"))
            check_instance("team", team, Team)
        else:
            hitch = start = bound.pop("start")
            check_instance("start", hitch, Hitch)
            team = hitch.team
        optional = {key for key, default in fields.items() if default is not EMPTY}
        step = kind(**{k: v for k, v in bound.items() if v is not None or k not in optional})
        resolved = step.resolved_for(team)  # invalid arguments are reported first
        resolved.checked_polygon_after(team, start.polygon if isinstance(start, Hitch) else None)
        specified: dict[str, Any] = {k: v for k, v in requirements.items() if v is not None}
        try:
            return solve(Problem(team, start, (resolved,), **specified), limit=limit)
        except InputError as error:
            nested = rf"^(start\.drones|mission\[0\]\.{kind.name})\b\.?"
            raise error.renamed(lambda key: re.sub(nested, "", key) or kind.name) from None

    listed = f"{START_PARAMETERS[first[0]]}\n{parameter_docs(kind, exclude='blend')}{REQUIREMENTS}"
    doc = _docstring(kind, "Return the certified plan of this single step", listed)
    arguments = dict.fromkeys(first, EMPTY) | fields | dict.fromkeys(Required.__annotations__)
    return _documented(function, kind.name, arguments, doc)


def _docstring(kind: type[Step], summary: str, listed: str) -> str:
    """Return a docstring with the description of a kind of step and a list of parameters."""
    description = inspect.cleandoc(kind.__doc__ or "").partition("\n\nParameters")[0]
    return f"{summary}: {description}\n\nParameters\n----------\n{listed}"


STEP_FUNCTIONS = tuple(
    kind
    for kind in STEPS
    if (kind.stages is None or kind.stages[0] is Stage.FREE)
    and "object" not in keys_of(kind)
    and kind not in (Settle, Tie)
)
"""Kinds of steps that are functions too: those that need neither an object nor an idle robot, and
whose name is free (``hitchopt.settle`` computes the static equilibrium with compliant drones)."""

for _kind in STEPS:
    setattr(Mission, _kind.name, _method(_kind))
globals().update({_kind.name: _function(_kind) for _kind in STEP_FUNCTIONS})


def export(
    plan: Plan | Path | str, format: str, folder: Path | str, **options: Any
) -> tuple[Export, ...]:
    """Write a plan, or the one saved in a directory, in a fleet's format; see ``Plan.export``."""
    text("format", format)
    path("folder", folder)
    if isinstance(plan, str | Path):
        plan = load(plan)
    check_instance("plan", plan, Plan)
    return plan.export(format, folder, **options)
