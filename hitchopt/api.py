"""The way in: plan a problem, a mission step by step, or one step alone.

``solve`` plans problems and problem files; ``Mission`` builds one step by step, with a method for
every kind of step; each kind without an object is a function too: ``morph``, ``form``, ….
Methods and functions come from ``hitchopt.steps.STEPS``, with the arguments and the words of the
steps' records; ``__init__.pyi`` lists them for type checkers and completion.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Self, TypedDict

from numpy.typing import ArrayLike

from hitchopt.errors import InfeasibleError, InputError, Progress, time_limit
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.requirements import Arena, Limits, Separation
from hitchopt.mission.problem import DronesStart, Problem, Start, SwarmProblem
from hitchopt.mission.repair import BUDGET, NO_CHANGE, Suggestion, find_suggestions
from hitchopt.mission.solving import solve_problem
from hitchopt.mission.teams import solve_any
from hitchopt.mission.teams_problem import AnyProblem, TeamsProblem
from hitchopt.motion.plan_file import check_request
from hitchopt.plan import Plan, load
from hitchopt.steps import STEPS, Join, Replace, Settle, Step, Withdraw
from hitchopt.steps.step import Stage
from hitchopt.values import check_instance, closest_word, flag, path, positive, text
from hitchopt.values.fields import EMPTY, check_keywords, keys_of, parameter_docs

if TYPE_CHECKING:
    from hitchopt.exports.exporting import Export
    from hitchopt.simulation.judgement import Simulation

Legs = str | Sequence[float] | ArrayLike | Mapping[str, Any]
"""Legs as a user writes them: a word, (n,) ``d_k`` [m], or a mapping of sharing and roll_deg."""


def solve(
    problem: AnyProblem | str | Path,
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
    task = _loaded(problem, Problem, SwarmProblem, TeamsProblem)
    seconds = None if limit is None else positive("limit", limit)
    with time_limit(seconds, progress) as tell:
        found = solve_any(task, tell)
    check_request(task.asked, found.motion)
    return Plan(found.motion, found.certificate, task.title)


def separate(
    problem: SwarmProblem | str | Path,
    progress: Progress | None = None,
    *,
    limit: float | None = None,
) -> Plan:
    """Return the certified plan of single drones that keep out of each other's downwash.

    Arguments and errors are those of ``solve``, for a problem of single drones or its file.
    """
    return solve(_loaded(problem, SwarmProblem), progress, limit=limit)


def suggestions(
    problem: Problem | str | Path, budget: float = BUDGET, progress: Progress | None = None
) -> tuple[Suggestion, ...]:
    """Return up to three changes that make a problem feasible, the smallest first.

    There is none where it is feasible already. Each has been verified by planning the problem with
    it, and is of one quantity, or of two or three where none does alone. None is no proof that
    there is none.

    Parameters
    ----------
    problem: or the path of a problem file.
    budget: how long to search [s]; the last plan that was begun is waited for.
    progress: called with what is being done now.
    """
    task = _loaded(problem, Problem)
    try:
        solve_any(task, progress)
    except InfeasibleError as error:
        return find_suggestions(task, error, budget, progress)
    return ()


def repair(
    problem: Problem | str | Path, budget: float = BUDGET, progress: Progress | None = None
) -> Plan:
    """Return the certified plan of a problem, by the smallest change that makes it feasible.

    The plan's title names the change; a feasible problem gives the plan of ``solve``. Arguments are
    those of ``suggestions``; InfeasibleError says what binds where no change was found.
    """
    task = _loaded(problem, Problem)
    try:
        return solve(task, progress)
    except InfeasibleError as error:
        found = find_suggestions(task, error, budget, progress)
        if not found:
            note = f"{error.note}\n{NO_CHANGE}" if error.note else NO_CHANGE
            raise InfeasibleError(error.violations, note) from None
    change = found[0].change
    found_plan = solve(change.problem, progress)
    return replace(found_plan, title=f"{task.title} with {change}".strip())


def _loaded(problem: Any, *kinds: type) -> Any:
    """Return a problem of one of the kinds, or the one in the file at a path."""
    if isinstance(problem, str | Path):
        from hitchopt.mission import loading  # heavy, as of all files

        read = {Problem: loading.load_problem, SwarmProblem: loading.load_swarm}
        return (read[kinds[0]] if len(kinds) == 1 else loading.read_problem)(problem)
    if not isinstance(problem, kinds):
        names = " or ".join(f"hitchopt.{kind.__name__}" for kind in kinds)
        remedy = "read one with load_problem, or make one of a dict with problem_from_dict"
        raise InputError("problem", problem, f"a path or a {names}", remedy)
    return problem.problem if isinstance(problem, Mission) else problem


@dataclass(frozen=True, eq=False)
class Mission(Problem):
    """A problem that is built step by step; every method returns a longer one.

    There is a method for every kind of step, with the arguments of its record: ``form``, ``morph``,
    ``move_vertex``, …. What is wrong in itself is refused by the step that has it. All but the
    steps is given as to a Problem.
    """

    complete: ClassVar[bool] = False
    mission: tuple[Step, ...] = ()

    @property
    def steps(self) -> tuple[Step, ...]:
        """The steps so far."""
        return self.mission

    @property
    def problem(self) -> Problem:
        """The problem that ``solve`` plans; raises InputError where there is no step."""
        return Problem(**vars(self))

    def then(self, step: Step) -> Self:
        """Return the mission with one more step, given as its record, if it fits."""
        check_instance("step", step, Step)
        return replace(self, mission=(*self.mission, step))

    def solve(self, progress: Progress | None = None, *, limit: float | None = None) -> Plan:
        """Return the certified plan; arguments and errors are those of ``hitchopt.solve``."""
        return solve(self.problem, progress, limit=limit)


class Required(TypedDict, total=False):
    """Keywords of every function of a step: what the plan must satisfy."""

    limits: Limits | None
    separation: Separation | None
    arena: Arena | None


BEGUN = {
    "start": "start: the hitch at t = 0.",
    "team": "team: who flies; robot k's drones start at ``q[k]`` and ``r[k]``.\n"
    "q, r: (n, 3) [m], at rest: hovering, or on the ground with their cables between them.",
}
"""First parameters of the functions of steps."""

PLANNED = """
limits, separation, arena: what the plan must satisfy; defaults as in a problem file.

Raises
------
InputError: arguments that are wrong in themselves.
InfeasibleError: it cannot be met; says what binds, where and when.
"""


def _arguments(kind: type[Step]) -> dict[str, Any]:
    """Return the fields of a kind of step with their defaults, EMPTY for none."""
    return {name: key.default for name, key in keys_of(kind).items()}


def _named(
    made: Callable[..., Any], name: str, arguments: Mapping[str, Any], words: str, listed: str
) -> Callable[..., Any]:
    """Return a function with a name, a signature with arguments, and a docstring."""
    either, only = inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY
    kinds = [only if key in Required.__annotations__ else either for key in arguments]
    given = [
        inspect.Parameter(key, kind, default=value)
        for kind, (key, value) in zip(kinds, arguments.items(), strict=True)
    ]
    made.__name__, made.__qualname__ = name.rpartition(".")[2], name
    made.__doc__ = f"{words}\n\nParameters\n----------\n{listed}"
    vars(made)["__signature__"] = inspect.Signature(given)
    return made


def _method(kind: type[Step]) -> Callable[..., Mission]:
    """Return the method of Mission that adds a step of a kind."""

    def add(self: Mission, *args: Any, **kwargs: Any) -> Mission:
        check_keywords(kind.name, [*_arguments(kind)], kwargs)
        given = inspect.signature(add).bind(self, *args, **kwargs).arguments
        return self.then(kind(**{key: value for key, value in given.items() if key != "self"}))

    words = f"Return the mission with this step: {_words(kind)}"
    arguments = {"self": EMPTY, **_arguments(kind)}
    return _named(add, f"Mission.{kind.name}", arguments, words, parameter_docs(kind))


def _function(kind: type[Step]) -> Callable[..., Plan]:
    """Return the function that plans a step of a kind alone."""
    arguments = {key: value for key, value in _arguments(kind).items() if key != "blend"}
    begun = ("team", "q", "r") if kind.needs_hitch is False else ("start",)

    def planned(*args: Any, **kwargs: Any) -> Plan:
        check_keywords(kind.name, [*every], kwargs)
        given = inspect.signature(planned).bind(*args, **kwargs).arguments
        kept = {name: given.pop(name, None) for name in Required.__annotations__}
        start: Start
        if kind.needs_hitch is False:
            team, start = given.pop("team"), DronesStart(given.pop("q"), given.pop("r"))
            check_instance("team", team, Team)
        else:
            hitch = start = given.pop("start")
            check_instance("start", hitch, Hitch)
            team = hitch.team
        optional = {key for key, value in arguments.items() if value is not EMPTY}
        step = kind(**{k: v for k, v in given.items() if v is not None or k not in optional})
        resolved = step.resolved_for(team)  # what is wrong in itself is said first
        resolved.checked_polygon_after(team, start.polygon if isinstance(start, Hitch) else None)
        chosen: dict[str, Any] = {name: part for name, part in kept.items() if part is not None}
        try:
            found = solve_problem(Problem(team, start, (resolved,), **chosen))
        except InputError as error:  # its key is that of an argument here
            key = re.sub(rf"^(start\.drones|mission\[0\]\.{kind.name})\b\.?", "", error.key)
            raise InputError(key or kind.name, error.value, error.bound, error.remedy) from None
        return Plan(found.motion, found.certificate)

    words = f"Return the certified plan of this step alone: {_words(kind)}"
    listed = f"{BEGUN[begun[0]]}\n{parameter_docs(kind, exclude='blend')}{PLANNED}"
    every = dict.fromkeys(begun, EMPTY) | arguments | dict.fromkeys(Required.__annotations__)
    return _named(planned, kind.name, every, words, listed)


def _words(kind: type[Step]) -> str:
    """Return what a kind of step does, without its parameters."""
    return inspect.cleandoc(kind.__doc__ or "").partition("\n\nParameters")[0]


ALONE = tuple(
    kind
    for kind in STEPS
    if (kind.stages is None or kind.stages[0] is Stage.FREE)
    and "object" not in keys_of(kind)
    and kind not in (Settle, Join, Withdraw, Replace)
)
"""Kinds of steps that are functions too: those that need neither object nor waiting robot, and
whose name is free (``hitchopt.settle`` tells where drones that give way come to rest)."""

for _kind in STEPS:
    setattr(Mission, _kind.name, _method(_kind))
globals().update({_kind.name: _function(_kind) for _kind in ALONE})


def simulate(
    plan: Plan | Path | str,
    *,
    preset: Literal["fast", "accurate"] = "fast",
    perturbed: bool = False,
    perturbations: dict[str, float | bool] | None = None,
    progress: Progress | None = None,
    **settings: Any,
) -> Simulation:
    """Fly a plan's setpoints with simulated ropes in MuJoCo; return the judged flight.

    Parameters
    ----------
    plan: a plan with cables, or the directory that one was saved to. The hitches of several teams
        fly in one world; single drones beside them, and others, are on their set points.
    preset: ``fast``: whether it holds; ``accurate``: with correct friction, five times slower.
    perturbed: whether there are the usual disturbances of a flight indoors.
    perturbations: fields of ``Perturbations`` that differ from those, such as ``wind`` [N].
    progress: called with what is being done now.
    settings: further fields of ``Settings``: ``seed``, ``friction``, ``density``, ``stiffness``,
        ``pull_test``, ``feedback``; ``controller`` by name, with ``gains``, ``upload`` and an
        ``estimator``: ``ideal``, ``crazyflie``, ``firmware``, ``one_marker``.

    Raises
    ------
    InputError: an argument that is wrong in itself.
    CertificateError: the plan's certificate does not hold.
    UnsupportedError: mujoco is not installed, single drones alone, or several teams with feedback.
    """
    from hitchopt.simulation.judgement import simulate as simulated
    from hitchopt.simulation.settings import CALM, PRESETS, Settings, settings_of
    from hitchopt.simulation.task import Task, read_task

    if text("preset", preset) not in PRESETS:
        raise InputError("preset", preset, " or ".join(PRESETS), "write fast")
    changes = _known("perturbations", {} if perturbations is None else perturbations, vars(CALM))
    given = _known("settings", settings, vars(Settings()))
    usual = flag("perturbed", perturbed)
    chosen = settings_of(preset, perturbed=usual, **given, **changes)
    if isinstance(plan, str | Path):
        return simulated(read_task(Path(plan)), chosen, progress)
    check_instance("plan", plan, Plan)
    plan.certificate.raise_if_violated()
    return simulated(Task.of(plan.motion), chosen, progress)


def _known(key: str, given: dict[str, Any], names: dict[str, Any]) -> dict[str, Any]:
    """Return the fields that a user gave, or raise InputError for one that there is not."""
    if not isinstance(given, dict):
        raise InputError(key, given, "a dict", f"use the keys {', '.join(names)}")
    for name in given.keys() - names.keys():
        remedy = closest_word(str(name), [*names])
        raise InputError(f"{key}.{name}", given[name], "left out", remedy)
    return given


def export(
    plan: Plan | Path | str, format: str, folder: Path | str, **options: Any
) -> tuple[Export, ...]:
    """Write a plan, or the one in a directory, in a fleet's format; see ``Plan.export``."""
    text("format", format)
    path("folder", folder)
    if isinstance(plan, str | Path):
        plan = load(plan)
    check_instance("plan", plan, Plan)
    return plan.export(format, folder, **options)
