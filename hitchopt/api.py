"""The way in: plan a problem, a mission step by step, or one step alone.

``solve`` plans problems and problem files; ``Mission`` builds one step by step, with a method for
every kind of step; each kind without an object is a function too: ``morph``, ``form``, ….
Methods and functions come from ``hitchopt.steps.STEPS``, with the arguments and the words of the
steps' records; ``__init__.pyi`` lists them for type checkers and completion.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Self, TypedDict

from numpy.typing import ArrayLike

from hitchopt.errors import InfeasibleError, InputError, OneLine, Progress, time_limit
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.requirements import Arena, Limits, Separation
from hitchopt.mission.problem import (
    DronesStart,
    Problem,
    Start,
    SwarmProblem,
    checked_parts,
    fitting_steps,
)
from hitchopt.mission.repair import BUDGET, NO_CHANGE, Suggestion, find_suggestions
from hitchopt.mission.solving import solve_problem, solve_swarm
from hitchopt.motion.asked import check_asked
from hitchopt.objects import SolidObject
from hitchopt.plan import Plan, load
from hitchopt.steps import STEPS, Settle, Step
from hitchopt.steps.step import Stage
from hitchopt.steps.step_keys import keys_of
from hitchopt.values import flag, instance, path, positive, text

if TYPE_CHECKING:
    from hitchopt.exports.exporting import Export
    from hitchopt.simulation.judgement import Simulation

Legs = str | Sequence[float] | ArrayLike | Mapping[str, Any]
"""Legs as a user writes them: a word, (n,) ``d_k`` [m], or a mapping of sharing and roll_deg."""


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
    task = _loaded(problem, Problem, SwarmProblem)
    seconds = None if limit is None else positive("limit", limit)
    with time_limit(seconds, progress) as tell:
        if isinstance(task, SwarmProblem):
            found = solve_swarm(task, tell)
        else:
            found = solve_problem(task, tell)
    check_asked(task.asked, found.motion, whole=False)
    return Plan(found.motion, found.certificate, task.title)


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
    progress, limit: as of solve.

    Raises
    ------
    InputError, FileError, InfeasibleError, TimeLimitError: as solve.
    """
    return solve(_loaded(problem, SwarmProblem), progress, limit=limit)


def suggestions(
    problem: Problem | str | Path, budget: float = BUDGET, progress: Progress | None = None
) -> tuple[Suggestion, ...]:
    """Return up to three single changes that make a problem feasible, the smallest first.

    There is none where it is feasible already. Each has been verified by planning the problem with
    it. None is no proof that there is none.

    Parameters
    ----------
    problem: or the path of a problem file.
    budget: how long to search [s]; the last plan that was begun is waited for.
    progress: called with what is being done now.

    Raises
    ------
    InputError, FileError: a problem that is wrong in itself.
    """
    task = _loaded(problem, Problem)
    try:
        solve_problem(task, progress)
    except InfeasibleError as error:
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
    instance("problem", problem, *kinds)
    return problem


@dataclass(frozen=True, eq=False)
class Mission(OneLine):
    """A mission that is built step by step; every method returns a longer one.

    There is a method for every kind of step, with the arguments of its record: ``form``, ``morph``,
    ``move_vertex``, …. What is wrong in itself is refused by the step that has it.

    Parameters
    ----------
    team: who flies.
    start: a Hitch, a HitchStart, or a DronesStart: drones on free cables.
    limits, separation, arena, title, objects: as of a Problem.

    Raises
    ------
    InputError: a start that does not fit the team, or a wrong type.
    """

    team: Team
    start: Start
    limits: Limits = field(default_factory=Limits)
    separation: Separation = field(default_factory=Separation)
    arena: Arena | None = None
    title: str = ""
    steps: tuple[Step, ...] = ()
    objects: Mapping[str, SolidObject] = field(default_factory=dict)

    def __post_init__(self) -> None:
        steps = checked_parts(self, "steps")
        outline = None if isinstance(self.start, DronesStart) else self.start.polygon
        fitted = fitting_steps(self.team, outline, steps, self.objects, complete=False)
        object.__setattr__(self, "steps", fitted)

    @property
    def problem(self) -> Problem:
        """The problem that ``solve`` plans; raises InputError where there is no step."""
        rest = self.limits, self.separation, self.arena, self.title, self.objects
        return Problem(self.team, self.start, self.steps, *rest)

    def then(self, step: Step) -> Self:
        """Return the mission with one more step, given as its record.

        Raises
        ------
        InputError: it is none, or does not fit what is there before it.
        """
        instance("step", step, Step)
        return replace(self, steps=(*self.steps, step))

    def solve(self, progress: Progress | None = None, *, limit: float | None = None) -> Plan:
        """Return the certified plan; arguments and errors are those of ``hitchopt.solve``."""
        return solve(self.problem, progress, limit=limit)


class Required(TypedDict, total=False):
    """Keywords of every function of a step: what the plan must satisfy."""

    limits: Limits | None
    separation: Separation | None
    arena: Arena | None


def _parameters(names: Sequence[str], **defaults: Any) -> list[inspect.Parameter]:
    kind = inspect.Parameter.POSITIONAL_OR_KEYWORD
    empty = inspect.Parameter.empty
    return [inspect.Parameter(name, kind, default=defaults.get(name, empty)) for name in names]


def _arguments(kind: type[Step]) -> dict[str, Any]:
    """Return the fields of a kind of step with their defaults, ``empty`` for none."""
    defaults = {name: default for name, (_, default) in keys_of(kind).items()}
    return {
        name: default() if isinstance(default, type) else default
        for name, default in defaults.items()
    } | {name: inspect.Parameter.empty for name in defaults if defaults[name] is MISSING}


def _method(kind: type[Step]) -> Callable[..., Mission]:
    """Return the method of Mission that adds a step of a kind."""

    def add(self: Mission, *args: Any, **kwargs: Any) -> Mission:
        return self.then(kind(*args, **kwargs))

    arguments = _arguments(kind)
    signature = inspect.Signature(_parameters(["self", *arguments], **arguments))
    return _named(add, f"Mission.{kind.name}", signature, kind, "Return the mission with this step")


def _function(kind: type[Step]) -> Callable[..., Plan]:
    """Return the function that plans a step of a kind alone."""
    arguments = {key: value for key, value in _arguments(kind).items() if key != "blend"}
    begun = ["team", "q", "r"] if kind.needs_hitch is False else ["start"]
    required = [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=None, annotation=kept)
        for name, kept in Required.__annotations__.items()
    ]
    signature = inspect.Signature([*_parameters([*begun, *arguments], **arguments), *required])

    def planned(*args: Any, **kwargs: Any) -> Plan:
        given = signature.bind(*args, **kwargs).arguments
        kept = {name: given.pop(name, None) for name in Required.__annotations__}
        start: Start
        if kind.needs_hitch is False:
            team, start = given.pop("team"), DronesStart(given.pop("q"), given.pop("r"))
            instance("team", team, Team)
        else:
            hitch = start = given.pop("start")
            instance("start", hitch, Hitch)
            team = hitch.team
        optional = {key for key, value in arguments.items() if value is not inspect.Parameter.empty}
        step = kind(**{k: v for k, v in given.items() if v is not None or k not in optional})
        fitting = step.fitting(team)  # what is wrong in itself is said first
        fitting.polygon_left(team, start.polygon if isinstance(start, Hitch) else None)
        chosen: dict[str, Any] = {name: part for name, part in kept.items() if part is not None}
        found = solve_problem(Problem(team, start, (fitting,), **chosen))
        return Plan(found.motion, found.certificate)

    words = "Return the certified plan of this step alone"
    _named(planned, kind.name, signature, kind, words, BEGUN[begun[0]], PLANNED)
    planned.__doc__ = (planned.__doc__ or "").replace(BLEND, "").replace(", blend:", ":")
    return planned


BEGUN = {
    "start": "start: the hitch at t = 0.\n",
    "team": "team: who flies; robot k's drones start at ``q[k]`` and ``r[k]``.\n"
    "q, r: (n, 3) [m], at rest: hovering, or on the ground with their cables between them.\n",
}
"""What functions of steps begin with."""

PLANNED = """
limits, separation, arena: what the plan must satisfy; defaults as in a problem file.

Raises
------
InputError: arguments that are wrong in themselves.
InfeasibleError: it cannot be met; says what binds, where and when.
"""

BLEND = "blend: go on into the next step without a stop.\n"
"""What a step alone does not do."""

PARAMETERS = "Parameters\n----------\n"


def _named(
    made: Callable[..., Any],
    name: str,
    signature: inspect.Signature,
    kind: type[Step],
    words: str,
    before: str = "",
    after: str = "",
) -> Callable[..., Any]:
    """Return a function with a name, a signature, and the words of a step's record.

    Parameters
    ----------
    words: what it does.
    before, after: further words, before and after the record's parameters.
    """
    record = inspect.cleandoc(kind.__doc__ or "")
    if PARAMETERS not in record:
        record = f"{record}\n\n{PARAMETERS}" if before else record
    listed = record.replace(PARAMETERS, f"{PARAMETERS}{before}")
    made.__name__, made.__qualname__ = name.rpartition(".")[2], name
    made.__doc__ = f"{words}: {listed}{after}"
    vars(made)["__signature__"] = signature
    return made


ALONE = tuple(
    kind
    for kind in STEPS
    if (kind.stages is None or kind.stages[0] is Stage.FREE)
    and "object" not in _arguments(kind)
    and kind is not Settle
)
"""Kinds of steps that are functions too: those that need no object, and whose name is free
(``hitchopt.settle`` tells where drones that give way come to rest)."""

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

    ``hitchopt simulate`` does the same for a plan's directory, and writes what came of it.

    Parameters
    ----------
    plan: a plan of a team with cables, or the directory that one was saved to.
    preset: ``fast``: whether it holds; ``accurate``: with correct friction, five times slower.
    perturbed: whether there are the usual disturbances of a flight indoors.
    perturbations: fields of ``Perturbations`` that differ from those, such as ``wind`` [N].
    progress: called with what is being done now.
    settings: further fields of ``Settings``: ``seed``, ``friction``, ``density``, ``stiffness``,
        ``pull_test``, ``feedback``.

    Raises
    ------
    InputError: an argument that is wrong in itself.
    CertificateError: the plan's certificate does not hold.
    UnsupportedError: mujoco is not installed, or single drones.
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
    instance("plan", plan, Plan)
    plan.certificate.raise_if_violated()
    return simulated(Task.of(plan.motion), chosen, progress)


def _known(key: str, given: dict[str, Any], names: dict[str, Any]) -> dict[str, Any]:
    """Return the fields that a user gave, or raise InputError for one that there is not."""
    if not isinstance(given, dict):
        raise InputError(key, given, "a dict", f"use the keys {', '.join(names)}")
    for name in given.keys() - names.keys():
        raise InputError(f"{key}.{name}", given[name], "left out", f"use {', '.join(names)}")
    return given


def export(
    plan: Plan | Path | str, format: str, folder: Path | str, **options: Any
) -> tuple[Export, ...]:
    """Write a plan, or the one in a directory, in a fleet's format; see ``Plan.export``."""
    text("format", format)
    path("folder", folder)
    if isinstance(plan, str | Path):
        plan = load(plan)
    instance("plan", plan, Plan)
    return plan.export(format, folder, **options)
