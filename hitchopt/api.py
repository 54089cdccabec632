"""The Python interface: plan problems and missions, repair problems, export plans.

``solve`` plans problems and problem files. ``Mission`` builds a problem step by step, with a method
for each kind of step. ``single_steps.py`` has functions that plan one step.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Self, TypeVar

from numpy.typing import ArrayLike

from hitchopt.checks.custom import Rule
from hitchopt.errors import InfeasibleError, InputError, Progress, time_limit
from hitchopt.geometry import Outline
from hitchopt.mission.problem import Problem
from hitchopt.mission.repair import BUDGET, NO_CHANGE, Suggestion, find_suggestions
from hitchopt.mission.solving import solve_problem
from hitchopt.motion.request import check_request
from hitchopt.plan import Plan, load
from hitchopt.planners.forming import SwapSettings
from hitchopt.steps.carrying import (
    Carry,
    Enclose,
    Grasp,
    HoldMethod,
    Leave,
    Lift,
    Loosen,
    SetDown,
    TransportObject,
)
from hitchopt.steps.moving import (
    Adjust,
    FollowVertex,
    Hold,
    Morph,
    MoveEdge,
    MoveVertex,
    Settle,
    Transport,
)
from hitchopt.steps.step import Step
from hitchopt.steps.straddling import Tie, Untie
from hitchopt.steps.tying import Assign, CloseVertex, Form, Land, OpenVertex, Release
from hitchopt.storage.yaml_file import read_text
from hitchopt.values import Points, check_instance, path, positive, sequence, text
from hitchopt.values.fields import suggest_keywords

if TYPE_CHECKING:
    from hitchopt.exports.exporting import Export

Polygon = Outline | Points
"""Vertices [x, y] [m] of a hitch, clockwise seen from above."""

SettleTime = float | Literal["auto", False]
"""Duration [s] of the swings that end a step of cables with friction."""

Legs = str | Points | Mapping[str, Any]
"""Legs as an argument: a mode, (n,) ``d_k`` [m], or a mapping with sharing and roll_deg."""


def solve(
    problem: Problem | str | Path,
    progress: Progress | None = None,
    *,
    limit: float | None = None,
    rules: Iterable[Rule[Any]] = (),
) -> Plan:
    """Return the certified plan of a problem.

    Parameters
    ----------
    problem: a problem, or the path of a problem file.
    progress: status callback.
    limit: time limit [s]; None: unlimited.
    rules: custom limits, in addition to those of the problem.

    Raises
    ------
    InputError, FileError: the problem or a rule is invalid.
    InfeasibleError: the problem cannot be met; lists the limits that bind, where and when.
    TimeLimitError: no plan within ``limit``.
    """
    source = ""
    if isinstance(problem, str | Path):
        from hitchopt.mission.loading import parse_problem  # heavy

        source, name = read_text(problem)
        problem = parse_problem(source, name, Path(problem).parent)
    task = _loaded(problem)
    if added := sequence("rules", rules):
        task = replace(task, rules=(*task.rules, *added))
    with time_limit(_seconds(limit), progress) as report:
        solution = solve_problem(task, report)
    check_request(task.request, solution.flight)
    return Plan(solution.flight, solution.certificate, task.title, source)


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
    result for an infeasible problem does not prove that no change exists.

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
    """Return a time limit [s], None if there is none; raise InputError if it is not positive."""
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

    There is a method for each kind of step, with the arguments of its record. It raises InputError
    if the step is invalid or does not fit. The arguments of a mission are those of a Problem.
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

    @suggest_keywords
    def morph(
        self,
        polygon: Polygon,
        legs: Legs | None = None,
        duration: float | None = None,
        blend: bool = False,
        optimize: bool = False,
        tension: tuple[float, float] | None = None,
        settle: SettleTime = "auto",
    ) -> Self:
        """Change the polygon: every vertex moves to its goal.

        Parameters
        ----------
        polygon: vertices [x, y] [m] of a convex polygon, clockwise seen from above, one per robot;
            one more of the convex arc of an open chain.
        legs: slack split of the cables: balanced, spread, or a list of q-legs d_k [m]; or a mapping
            with sharing (one of these) and roll_deg, at the step's end.
        duration: exact duration [s]; default: as fast as the limits allow.
        blend: continue into the next step without a stop.
        optimize: search for a faster route even if the straight one is feasible; by default only if
            that takes more than 1.3 times its lower bound.
        tension: range of tensions during the step [N].
        settle: duration of the swings that end the step where cables slid against friction, added
            to its duration [s]; auto: as far as limits allow; or false.
        """
        return self.then(
            new_step(
                Morph,
                polygon=polygon,
                legs=legs,
                duration=duration,
                blend=blend,
                optimize=optimize,
                tension=tension,
                settle=settle,
            )
        )

    @suggest_keywords
    def hold(self, seconds: float) -> Self:
        """Keep everything at rest.

        Parameters
        ----------
        seconds: duration [s].
        """
        return self.then(new_step(Hold, seconds=seconds))

    @suggest_keywords
    def move_vertex(
        self,
        vertex: int,
        to: ArrayLike | None = None,
        by: ArrayLike | None = None,
        legs: Legs | None = None,
        duration: float | None = None,
        blend: bool = False,
        settle: SettleTime = "auto",
    ) -> Self:
        """Move one vertex.

        Only four drones move, those whose legs continue the two edges of the vertex; where a limit
        binds, further drones slide along their cables as well.

        Parameters
        ----------
        vertex: index, from 0.
        to: goal [x, y] [m].
        by: displacement [dx, dy] [m], instead of to.
        legs: slack split of the cables: balanced, spread, or a list of q-legs d_k [m]; or a mapping
            with sharing (one of these) and roll_deg, at the step's end.
        duration: exact duration [s]; default: as fast as the limits allow.
        blend: continue into the next step without a stop.
        settle: duration of the swings that end the step where cables slid against friction, added
            to its duration [s]; auto: as far as limits allow; or false.
        """
        return self.then(
            new_step(
                MoveVertex,
                vertex=vertex,
                to=to,
                by=by,
                legs=legs,
                duration=duration,
                blend=blend,
                settle=settle,
            )
        )

    @suggest_keywords
    def move_edge(
        self,
        edge: int,
        to: ArrayLike | None = None,
        by: ArrayLike | None = None,
        legs: Legs | None = None,
        duration: float | None = None,
        blend: bool = False,
        settle: SettleTime = "auto",
    ) -> Self:
        """Move both ends of one edge.

        Edge k runs from vertex k to vertex k + 1. Four drones move, or six where edges turn.

        Parameters
        ----------
        edge: index, from 0.
        to: goals of its ends, [[x, y], [x, y]] [m], its first vertex first.
        by: displacement [dx, dy] [m], instead of to.
        legs: slack split of the cables: balanced, spread, or a list of q-legs d_k [m]; or a mapping
            with sharing (one of these) and roll_deg, at the step's end.
        duration: exact duration [s]; default: as fast as the limits allow.
        blend: continue into the next step without a stop.
        settle: duration of the swings that end the step where cables slid against friction, added
            to its duration [s]; auto: as far as limits allow; or false.
        """
        return self.then(
            new_step(
                MoveEdge,
                edge=edge,
                to=to,
                by=by,
                legs=legs,
                duration=duration,
                blend=blend,
                settle=settle,
            )
        )

    @suggest_keywords
    def adjust(
        self,
        legs: Legs = "balanced",
        duration: float | None = None,
        blend: bool = False,
        settle: SettleTime = "auto",
    ) -> Self:
        """Slide cables through their clasps; the outline does not change.

        Parameters
        ----------
        legs: slack split of the cables: balanced, spread, or a list of q-legs d_k [m]; or a mapping
            with sharing (one of these) and roll_deg.
        duration: exact duration [s]; default: as fast as the limits allow.
        blend: continue into the next step without a stop.
        settle: duration of the swings that end the step where cables slid against friction, added
            to its duration [s]; auto: as far as limits allow; or false.
        """
        return self.then(new_step(Adjust, legs=legs, duration=duration, blend=blend, settle=settle))

    @suggest_keywords
    def follow_vertex(
        self,
        vertex: int,
        path: Points,
        legs: Legs | None = None,
        speed: float | None = None,
        settle: SettleTime = "auto",
    ) -> Self:
        """Move one vertex through points, at rest before and after.

        It meets timed points at their times. With a speed, points need no times: it moves at this
        speed on a smooth path through them. It stops where the path turns by more than 90°, and
        slows down where a drone's limit binds.

        Parameters
        ----------
        vertex: index, from 0.
        path: points [t, x, y] [s, m, m], t from the step's start, increasing; the vertex rests
            between equal consecutive points; with a speed also points [x, y].
        legs: slack split of the cables: balanced, spread, or a list of q-legs d_k [m]; or a mapping
            with sharing (one of these) and roll_deg, at the step's end.
        speed: largest speed of the vertex on its path through points [x, y] [m/s];
            None: limits.vertex_speed.
        settle: duration of the swings that end the step where cables slid against friction, added
            to its duration [s]; auto: as far as limits allow; or false.
        """
        return self.then(
            new_step(FollowVertex, vertex=vertex, path=path, legs=legs, speed=speed, settle=settle)
        )

    @suggest_keywords
    def transport(self, to: ArrayLike, yaw: float = 0.0, duration: float | None = None) -> Self:
        """Move the whole hitch and turn it about its centroid, without changing its shape or legs.

        Parameters
        ----------
        to: goal [x, y, z] of its centroid [m].
        yaw: rotation, counter-clockwise [rad].
        duration: exact duration [s]; default: as fast as the limits allow.
        """
        return self.then(new_step(Transport, to=to, yaw=yaw, duration=duration))

    @suggest_keywords
    def settle(self, seconds: float | Literal["auto"] = "auto") -> Self:
        """Swing the drones to remove friction hysteresis at the clasps.

        Drones swing about their positions with decreasing amplitude; planned vertices do not move.

        Parameters
        ----------
        seconds: duration [s]; auto: four swings, slower where limits require it.
        """
        return self.then(new_step(Settle, seconds=seconds))

    @suggest_keywords
    def form(
        self,
        polygon: Polygon,
        altitude: float = 1.0,
        legs: Legs | None = None,
        assign: Assign = "auto",
        swap: SwapSettings | None = None,
        settle: SettleTime = "auto",
        by: Literal["swaps", "laying"] = "swaps",
        order: ArrayLike | Literal["auto"] = "auto",
        duration: float | None = None,
    ) -> Self:
        """Tie a hitch from hanging cables, then raise the tension to the team's.

        Without ``legs`` they are spread, with a margin to the cables where drones are close to
        them.

        Parameters
        ----------
        polygon: vertices [x, y] [m] of a convex polygon, clockwise seen from above, one per robot;
            one more of the convex arc of an open chain.
        altitude: height of the hitch's plane [m].
        legs: slack split of the cables: balanced, spread, or a list of q-legs d_k [m]; or a mapping
            with sharing (one of these) and roll_deg, at the step's end; spread without it.
        assign: auto: choose which robot takes which edge, and which end is its q; fixed: in order.
        swap: how drones turn in pairs.
        settle: duration of the swings that end the step where cables slid against friction, added
            to its duration [s]; auto: as far as limits allow; or false.
        by: swaps: pairs of drones swap positions; laying: taut cables are laid on one another, and
            every pair rolls by half a turn.
        order: order of laying, robots from bottom to top; auto: alternating levels.
        duration: exact duration [s]; default: as fast as the limits allow.
        """
        return self.then(
            new_step(
                Form,
                polygon=polygon,
                altitude=altitude,
                legs=legs,
                assign=assign,
                swap=swap or SwapSettings(),
                settle=settle,
                by=by,
                order=order,
                duration=duration,
            )
        )

    @suggest_keywords
    def open_vertex(self, vertex: int, duration: float | None = None) -> Self:
        """Roll a vertex's pair until both cables run straight and lie on each other.

        The rest is a chain on the same lines, with all other vertices intact.

        Parameters
        ----------
        vertex: index, from 0.
        duration: exact duration [s]; default: as fast as the limits allow.
        """
        return self.then(new_step(OpenVertex, vertex=vertex, duration=duration))

    @suggest_keywords
    def close_vertex(self, vertex: int, duration: float | None = None) -> Self:
        """Roll the pair of an open vertex back into its clasp.

        Parameters
        ----------
        vertex: index, from 0.
        duration: exact duration [s]; default: as fast as the limits allow.
        """
        return self.then(new_step(CloseVertex, vertex=vertex, duration=duration))

    @suggest_keywords
    def release(self, duration: float | None = None) -> Self:
        """Untie the hitch in the reverse order of tying, until its cables hang free.

        Parameters
        ----------
        duration: exact duration [s]; default: as fast as the limits allow.
        """
        return self.then(new_step(Release, duration=duration))

    @suggest_keywords
    def land(self, duration: float | None = None) -> Self:
        """Descend straight to the ground.

        Parameters
        ----------
        duration: exact duration [s]; default: as fast as the limits allow.
        """
        return self.then(new_step(Land, duration=duration))

    @suggest_keywords
    def enclose(self, object: str, duration: float | None = None) -> Self:
        """Rise above an object, change to a polygon around it, and descend.

        It ends just below the object's rim, or at the height of its centre of mass if it has none.

        Parameters
        ----------
        object: name of the object.
        duration: exact duration [s]; default: as fast as the limits allow.
        """
        return self.then(new_step(Enclose, object=object, duration=duration))

    @suggest_keywords
    def grasp(
        self,
        object: str,
        by: HoldMethod = "rest",
        tension: float | None = None,
        duration: float | None = None,
    ) -> Self:
        """Close the hitch below the object's rim and rise to it, or close it around its body.

        Parameters
        ----------
        object: name of the object.
        by: rest: its rim lies on the clasps; grip: cables are wrapped around it.
        tension: tension of all cables while it is held [N]; default: the team's.
        duration: exact duration [s]; default: as fast as the limits allow.
        """
        return self.then(new_step(Grasp, object=object, by=by, tension=tension, duration=duration))

    @suggest_keywords
    def lift(self, by: float, duration: float | None = None) -> Self:
        """Transfer the object's weight to the clasps, and lift it vertically.

        Parameters
        ----------
        by: height to lift [m].
        duration: exact duration [s]; default: as fast as the limits allow.
        """
        return self.then(new_step(Lift, by=by, duration=duration))

    @suggest_keywords
    def carry(
        self, object: str, to: ArrayLike, yaw: float = 0.0, duration: float | None = None
    ) -> Self:
        """Fly the object along a straight line, gently enough that it stays on its supports.

        Parameters
        ----------
        object: name of the object.
        to: goal [x, y, z] of its base [m].
        yaw: rotation, counter-clockwise [rad].
        duration: exact duration [s]; default: as fast as the limits allow.
        """
        return self.then(new_step(Carry, object=object, to=to, yaw=yaw, duration=duration))

    @suggest_keywords
    def set_down(self, object: str, duration: float | None = None) -> Self:
        """Lower the object onto its support, and transfer its weight to it.

        Parameters
        ----------
        object: name of the object.
        duration: exact duration [s]; default: as fast as the limits allow.
        """
        return self.then(new_step(SetDown, object=object, duration=duration))

    @suggest_keywords
    def loosen(self, object: str, duration: float | None = None) -> Self:
        """Open the hitch around the object, below its rim, and return to the team's tension.

        Parameters
        ----------
        object: name of the object.
        duration: exact duration [s]; default: as fast as the limits allow.
        """
        return self.then(new_step(Loosen, object=object, duration=duration))

    @suggest_keywords
    def leave(self, object: str, duration: float | None = None) -> Self:
        """Rise vertically until the hitch is above all objects.

        Parameters
        ----------
        object: name of the object.
        duration: exact duration [s]; default: as fast as the limits allow.
        """
        return self.then(new_step(Leave, object=object, duration=duration))

    @suggest_keywords
    def transport_object(
        self,
        object: str,
        to: ArrayLike,
        by: HoldMethod | None = None,
        tension: float | None = None,
        yaw: float = 0.0,
        lift: float = 0.3,
        via: Points | None = None,
    ) -> Self:
        """Carry an object to a new position, in seven steps, or more with ``via``.

        Two robots tie their cables around it, and untie them.

        Parameters
        ----------
        object: name of the object.
        to: goal [x, y, z] of its base [m].
        by: rest: its rim lies on the clasps; grip: cables are wrapped around it; without it rest if
            it has a rim.
        tension: tension of all cables while it is held [N]; default: the team's.
        yaw: rotation, counter-clockwise [rad].
        lift: height above the higher of start and goal [m].
        via: intermediate positions of its base, where it stops.
        """
        return self.then(
            new_step(
                TransportObject,
                object=object,
                to=to,
                by=by,
                tension=tension,
                yaw=yaw,
                lift=lift,
                via=via,
            )
        )

    @suggest_keywords
    def tie(
        self,
        around: str,
        at: float | None = None,
        tension: float | None = None,
        duration: float | None = None,
    ) -> Self:
        """Lay two cables past both sides of an object, tie them beyond it, and draw them taut.

        The cables are lowered next to the object and bent around it, and each pair of drones makes
        a full turn. They then grip the object with the team's tension.

        Parameters
        ----------
        around: name of the object.
        at: height of the clasps above its base [m]; None: as high as is safe, but
            below its rim.
        tension: tension of all cables while they are tied [N]; None: as low as their weight
            permits.
        duration: exact duration [s]; default: as fast as the limits allow.
        """
        return self.then(new_step(Tie, around=around, at=at, tension=tension, duration=duration))

    @suggest_keywords
    def untie(self, duration: float | None = None) -> Self:
        """Untie the cables in the reverse order of tying, until they hang next to the object.

        Parameters
        ----------
        duration: exact duration [s]; default: as fast as the limits allow.
        """
        return self.then(new_step(Untie, duration=duration))


S = TypeVar("S", bound=Step)


def new_step(kind: type[S], **arguments: Any) -> S:
    """Return a step; its record converts and checks the arguments."""
    return kind(**arguments)


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
