"""The Python interface: plan problems, missions and single steps, repair problems, export plans."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from hitchopt.checks.custom import Rule
from hitchopt.errors import InfeasibleError, InputError, Progress, time_limit
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.casadi_model import CostFunction
from hitchopt.hitch.requirements import Arena, Limits, Prism, Separation
from hitchopt.mission.cache import Cache
from hitchopt.mission.others import Other
from hitchopt.mission.problem import Problem
from hitchopt.mission.solving import solve_problem
from hitchopt.mission.starts import DronesStart, HitchStart, Start
from hitchopt.motion.motion import Motion
from hitchopt.motion.request import check_request
from hitchopt.objects import SolidObject
from hitchopt.plan import Plan, load
from hitchopt.planners.candidates import outcome
from hitchopt.steps.keys import Legs, Polygon, SettleAtEnd
from hitchopt.steps.moving import Morph
from hitchopt.steps.step import Step
from hitchopt.storage.yaml_file import read_text
from hitchopt.values import Points, check_instance, integer, path, positive, sequence, text
from hitchopt.values.fields import suggest_keywords

if TYPE_CHECKING:
    from hitchopt.exports.exporting import Export


@suggest_keywords
def solve(
    start: Problem | str | Path | Start | Points | Mapping[str, Any],
    mission: Step | Mapping[str, Any] | Sequence[Step | Mapping[str, Any]] | None = None,
    *,
    team: Team | Mapping[str, Team] | None = None,
    limits: Limits | None = None,
    separation: Separation | None = None,
    arena: Arena | None = None,
    title: str = "",
    objects: Mapping[str, SolidObject] | None = None,
    others: Mapping[str, Other] | None = None,
    keep_out: Iterable[Prism] = (),
    rules: Iterable[Rule[Any]] = (),
    limit: float | None = None,
    progress: Progress | None = None,
    cache: Cache | None = None,
) -> Plan:
    """Return the certified plan of a mission from a start, of a problem, or of a problem file.

    Parameters
    ----------
    start: a problem, or the path of a problem file, without a mission; or the start of one: a
        hitch, drones of a hitch to be formed, positions (N, 3) [m] of single drones, or a mapping
        of these by the names of several teams.
    mission: a step, such as ``hitchopt.Morph(polygon)``, or a list of steps. For several teams, an
        item or a list of items: mappings of their names to a step or a list of steps.
    team: the team, or the teams by name; a hitch names its own.
    limits, separation, arena, title, objects, others, keep_out: as of ``hitchopt.Problem``.
    rules: custom limits, in addition to those of a problem.
    limit: time limit [s]; None: unlimited.
    progress: status callback.
    cache: steps of earlier plans, which are reused where their requests are equal, and of this one.

    Raises
    ------
    InputError, FileError: the problem, an argument or a rule is invalid.
    InfeasibleError: the problem cannot be met; lists the limits that bind, where and when.
    TimeLimitError: no plan within ``limit``.
    """
    stated: dict[str, Any] = {
        "team": team,
        "limits": limits,
        "separation": separation,
        "arena": arena,
        "title": title or None,
        "objects": objects,
        "others": others,
        "keep_out": sequence("keep_out", keep_out) or None,
    }
    source = ""
    added = sequence("rules", rules)
    if mission is not None and not isinstance(start, Problem | str | Path):
        stated["team"] = _own_team(start) if team is None else team
        steps = (mission,) if isinstance(mission, Step | Mapping) else mission
        task = Problem(start=start, mission=steps, **_given(stated))
    else:
        if isinstance(start, str | Path):
            from hitchopt.mission.loading import parse_problem  # heavy

            source, name = read_text(start)
            start = parse_problem(source, name, Path(start).parent)
        if isinstance(start, Hitch | HitchStart | DronesStart):
            bound = "a step, or a list of steps"
            raise InputError("mission", None, bound, "pass one, such as hitchopt.Hold(1.0)")
        task = loaded(start, key="start")
        for name, value in _given({"mission": mission, **stated}).items():
            bound = "omitted: the problem states it"
            raise InputError(name, value, bound, "change it there, or pass a start and a mission")
    if cache is not None:
        check_instance("cache", cache, Cache)
    if added:
        task = replace(task, rules=(*task.rules, *added))
    with time_limit(seconds_of(limit), progress) as report:
        solution = solve_problem(task, report, cache=cache)
    check_request(task.request, solution.flight)
    return Plan(solution.flight, solution.certificate, task.title, source)


def _given(arguments: Mapping[str, Any]) -> dict[str, Any]:
    """Return the arguments that are not None: those left out have the defaults of a problem."""
    return {name: value for name, value in arguments.items() if value is not None}


def _own_team(start: Any) -> Team | dict[str, Team]:
    """Return the team of a hitch, or the teams of hitches by name; raise InputError for others."""
    if isinstance(start, Hitch):
        return start.team
    if isinstance(start, Mapping) and all(isinstance(each, Hitch) for each in start.values()):
        return {name: hitch.team for name, hitch in start.items()}
    bound = "given: only a hitch names its team"
    raise InputError("team", None, bound, "pass team, such as hitchopt.Team(3, 2.4)")


@suggest_keywords
def morph(
    start: Hitch,
    polygon: Polygon,
    legs: Legs | None = None,
    duration: float | None = None,
    optimize: bool = False,
    tension: tuple[float, float] | None = None,
    settle: SettleAtEnd = "auto",
    *,
    limits: Limits | None = None,
    separation: Separation | None = None,
    arena: Arena | None = None,
    limit: float | None = None,
    cost: CostFunction | None = None,
    like: Plan | None = None,
) -> Plan:
    """Return the certified plan of a change of the polygon: every vertex moves to its goal.

    Parameters
    ----------
    start: the hitch at t = 0.
    polygon: vertices [x, y] [m] of a convex polygon, clockwise seen from above, one per robot; one
        more of the convex arc of an open chain.
    legs: slack split of the cables: balanced, spread, or a list of q-legs d_k [m]; or a mapping
        with sharing (one of these) and roll_deg, at the step's end.
    duration: exact duration [s]; default: as fast as the limits allow.
    optimize: search for a faster route even if the straight one is feasible, by default only if
        that takes more than 1.3 times its lower bound; then refine the route together with its
        speed, within a fixed amount of work.
    tension: range of tensions during the step [N].
    settle: duration of the over-travels that end the step where cables slid against friction, added
        to its duration [s]; auto: as far as limits allow; or false.
    limits, separation, arena: requirements of the plan; defaults as in a problem file.
    limit: time limit [s]; None: unlimited.
    cost: a function of the hitch in motion in casadi, to be minimised together with the duration:
        its integral over the flight's time counts as seconds. It takes outputs of ``model`` by name
        (``positions``, ``velocities``, ``accelerations``, ``thrusts``, ``tilt_cosines``, ``legs``,
        ``exterior_angles``, ``separations``), the inputs ``vertices``, ``vertex_velocities``,
        ``vertex_accelerations``, ``q_legs`` and ``tensions``, and s. The optimiser then always
        runs.
    like: plan of a team of the same size between nearly the same hitches. Its route, slack splits
        and roll, moved to the new ends, are tried first, which spares searching a route. Of a
        straight morph its clock is used as well, stretched or shortened to the limits; such plans
        take a few percent longer than the fastest.

    Raises
    ------
    InputError: an argument is invalid.
    InfeasibleError: the step cannot be planned; lists the limits that bind, where and when.
    TimeLimitError: no plan within ``limit``.
    """
    check_instance("start", start, Hitch)
    step = Morph(
        polygon=polygon,
        legs=legs,
        duration=duration,
        optimize=optimize,
        tension=tension,
        settle=settle,
        cost=cost,
        like=None if like is None else _tied_motion(like, start.team),
    )
    seconds = seconds_of(limit)
    problem = step_problem(start.team, start, step, limits, separation, arena)
    with step_errors(step):
        return solve(problem, limit=seconds)


def _tied_motion(plan: Plan, team: Team) -> Motion:
    """Return the motion of a plan; InputError unless it is of a tied hitch of a team's size."""
    check_instance("like", plan, Plan)
    motion = plan.motion
    same = motion.team.has_cables and motion.team.layout.points == team.layout.points
    if not same or not np.all(motion.formed) or np.any(motion.holding):
        bound = f"a plan of a hitch of {team.robots} robots that is tied and holds nothing"
        raise InputError("like", str(plan), bound, "pass an earlier morph's, or omit it")
    return motion


def morphs(
    pairs: Iterable[tuple[Hitch, Polygon]],
    *,
    workers: int | None = None,
    progress: Progress | None = None,
    **options: Any,
) -> list[Plan | InfeasibleError]:
    """Return the plans of many changes of polygons, planned by several processes, in order.

    Where processes are spawned, a script must guard its own start by ``__name__ == "__main__"``.

    Parameters
    ----------
    pairs: starts and their goals, as of ``morph``.
    workers: number of processes; by default as many as processors.
    progress: called with the number of finished pairs; by default a bar is shown on a terminal.
    options: further arguments of ``morph``, the same for all pairs.

    Returns
    -------
    A plan for each pair, or the error of one that cannot be planned.

    Raises
    ------
    InputError: an argument is invalid.
    """
    from concurrent.futures import ProcessPoolExecutor, as_completed  # heavy

    given = [(*_pair(i, each), options) for i, each in enumerate(sequence("pairs", pairs))]
    count = os.cpu_count() or 1 if workers is None else integer("workers", workers, 1)
    with ExitStack() as stack:
        report = progress or stack.enter_context(_bar("planning morphs", len(given)))
        pool = stack.enter_context(ProcessPoolExecutor(min(count, max(len(given), 1))))
        stack.callback(pool.shutdown, cancel_futures=True)
        futures = [pool.submit(_morph_or_error, *each) for each in given]
        for done, future in enumerate(as_completed(futures), 1):
            future.result()  # invalid arguments end all others
            report(f"planning morphs, {done} of {len(given)}")
        return [future.result() for future in futures]


def _pair(index: int, pair: object) -> tuple[Hitch, Polygon]:
    """Return a start and a goal, or raise InputError for anything but two entries."""
    if not isinstance(pair, tuple | list) or len(pair) != 2:
        bound = "a pair of a hitch and a polygon"
        raise InputError(f"pairs[{index}]", pair, bound, "write (start, polygon)")
    return pair[0], pair[1]


def _morph_or_error(
    start: Hitch, polygon: Polygon, options: Mapping[str, Any]
) -> Plan | InfeasibleError:
    """Return the plan of a morph, or the error that it is infeasible.

    The error has no traceback and no earlier errors, which some packages pickle, too.
    """
    planned = outcome(partial(morph, start, polygon, **options))
    if isinstance(planned, InfeasibleError):
        planned.__cause__ = planned.__context__ = None
        return planned.with_traceback(None)
    return planned


@contextmanager
def _bar(message: str, total: int) -> Iterator[Progress]:
    """Show a progress bar on a terminal; yield the callback that advances it."""
    from rich.console import Console
    from rich.progress import Progress as Bar

    console = Console(stderr=True)
    with Bar(console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(message, total=total)
        yield lambda _: bar.advance(task)


def step_problem(
    team: Team,
    start: Hitch | DronesStart,
    step: Step,
    limits: Limits | None,
    separation: Separation | None,
    arena: Arena | None,
) -> Problem:
    """Return the problem of one step; errors name its arguments as those of a function."""
    resolved = step.resolved_for(team)  # invalid arguments of the step are reported first
    outline = start.polygon if isinstance(start, Hitch) else None
    resolved.checked_polygon_after(team, outline)
    required = {"limits": limits, "separation": separation, "arena": arena}
    with step_errors(step):
        return Problem(team, start, (resolved,), **_given(required))


@contextmanager
def step_errors(step: Step) -> Iterator[None]:
    """Name the arguments in errors of a step as those of a function."""
    try:
        yield
    except InputError as error:
        nested = rf"^(start\.drones|mission\[0\]\.{step.name})\b\.?"
        raise error.renamed(lambda key: re.sub(nested, "", key) or step.name) from None


def seconds_of(limit: Any) -> float | None:
    """Return a time limit [s], None if there is none; raise InputError if it is not positive."""
    return None if limit is None else positive("limit", limit)


def loaded(
    given: Any, kind: Literal["hitch", "swarm"] | None = None, key: str = "problem"
) -> Problem:
    """Return a problem, of a kind if specified, loaded if it is a path."""
    from hitchopt.mission import loading  # heavy

    problem = loading.load_problem(given) if isinstance(given, str | Path) else given
    if not isinstance(problem, Problem):
        remedy = "read one with load_problem, or convert a dict with problem_from_dict"
        raise InputError(key, problem, "a path or a hitchopt.Problem", remedy)
    if kind is not None and problem.kind != kind:
        key = "teams" if problem.kind == "teams" else "team"
        robots = "catenary robots" if kind == "hitch" else "single drones"
        raise InputError(key, problem.kind, f"one team of {robots}", "solve plans all kinds")
    return problem


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
