"""The planner: guesses, convex programs around them, and the certificate that ends the search."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import InfeasibleError, Violation
from hitchopt.planners.separation.course import Course, course_of
from hitchopt.planners.separation.feasibility import check_ends
from hitchopt.planners.separation.guess import Manners, pushed_apart
from hitchopt.planners.separation.planes import ClosePieces, close_pieces, planes_between
from hitchopt.planners.separation.program import MARGIN, Around, build_program
from hitchopt.planners.separation.qp import ProgramError, Solver
from hitchopt.planners.separation.standing import Standing, standing_of
from hitchopt.planners.separation.task import Separated, SeparationTask
from hitchopt.planners.separation.walls import walls_before

Array = NDArray[np.float64]
Progress = Callable[[str], None]

GUESSES = (
    Manners(0.5),
    Manners(0.5, layers=3),
    Manners(0.5, patience=1.5),
    Manners(-0.5),
    Manners(0.5, patience=2.0),
    Manners(1.5, layers=2),
    Manners(0.5, patience=3.0),
)
"""How drones give way when they meet, in the order in which it is tried."""

ROUNDS = 16
"""Programs around one guess, at most."""

FASTER = 0.85
"""Share of the duration that the next program aims at, as long as the curves are clear."""

BARELY = 1.03
"""Times what each takes alone: splines on the grid cannot be faster, so nothing aims at less."""

GOOD = 1.05
"""Times what each takes alone: what is as fast is not improved any more."""

PATIENCE = 3
"""Rounds in a row that may gain nothing."""

GAIN = 0.02
"""Share of the duration: rounds that gain less are the last ones."""

TRUST = 2.5
"""Radii that a coefficient may move by in one program."""

REACH = 1.0
"""Pieces this much farther apart than they must be get a plane as well."""

NEARLY = 1.15
"""Times what each takes alone: as fast as this, one round without a gain is the last one."""


def separate(task: SeparationTask, progress: Progress | None = None) -> Separated:
    """Return curves for all drones that keep all of the task for all of the time.

    Parameters
    ----------
    task: who flies from where to where, and what must hold.
    progress: called with what is being done now.

    Raises
    ------
    InfeasibleError: it cannot be met, or no way was found; the violations name the pair and the
        time.
    """
    say = progress if progress is not None else _silent
    check_ends(task)
    course = course_of(task)
    if task.duration is not None and task.duration < course.bound:
        raise InfeasibleError([_too_short(course, course.bound, "no drone can be as fast")])
    tried: list[Standing] = []
    for manners in GUESSES:
        patience = manners.patience
        if task.duration is not None and patience * course.alone > task.duration:
            continue
        say(f"guess: {manners}")
        way = course if patience == 1.0 else course_of(task, patience)
        found = _improved(way, pushed_apart(way, manners), say)
        if found.clear and (task.duration is None or found.duration <= task.duration):
            return _separated(way, found, str(manners))
        tried.append(found)
    nearest = min(tried, key=_distance)
    if nearest.clear:
        raise InfeasibleError([_too_short(course, nearest.duration, "the fastest way found")])
    raise InfeasibleError(nearest.broken, f"no way was found from {len(tried)} guesses")


def _improved(course: Course, guess: Array, say: Progress) -> Standing:
    """Return the best curves that programs around a guess lead to: clear ones, the fastest."""
    task = course.task
    solver = Solver()
    here = standing_of(course, guess)
    best = here
    trust = TRUST * task.separation.radius
    known: ClosePieces | None = None
    idle = 0
    for round_number in range(ROUNDS):
        target = here.duration if not here.clear else FASTER * here.duration
        floor = BARELY * course.alone if task.duration is None else task.duration
        target = max(target, floor, 1e-3)
        pieces = course.grid.pieces_of(here.coefficients)
        scaled = pieces * course.scale[:, None]
        close = close_pieces(scaled, 1.0 + MARGIN + REACH)
        if known is not None:
            close = close.united(known, task.drones)
        known = close
        radius = task.separation.radius
        walls = walls_before(pieces, task.keep_out, radius, radius + 2.0 * trust)
        around = Around(here.coefficients, target, trust, planes_between(scaled, close), walls)
        built = build_program(course, around)
        try:
            solution = solver.solve(built.program, np.zeros(len(built.program.q)), built.kept_rows)
        except ProgramError:
            break
        here = standing_of(course, built.moved(solution.x))
        say(
            f"round {round_number + 1}: {here.duration:.3g} s, separation {here.closest:.3f} "
            f"{len(close)} {solution.iterations} {solution.residual:.1e}"
        )
        better = _distance(here) < _distance(best) * (1.0 - GAIN)
        idle = 0 if better else idle + 1
        if _distance(here) < _distance(best):
            best = here
        patience = 1 if best.duration <= NEARLY * course.alone and here.clear else PATIENCE
        if best.clear and (idle >= patience or best.duration <= max(GOOD * course.alone, floor)):
            break
    return best


def _distance(standing: Standing) -> float:
    """Return a number that is smaller the better: durations, above those what is not clear."""
    if standing.clear:
        return standing.duration
    return 1e9 * (2.0 - min(standing.closest, 1.0))


def _separated(course: Course, found: Standing, remark: str) -> Separated:
    duration = found.duration if course.task.duration is None else course.task.duration
    curves = course.grid.curves(found.coefficients, duration)
    return Separated(curves, found.closest, course.bound, remark)


def _too_short(course: Course, needed: float, which: str) -> Violation:
    given = course.task.duration or math.nan
    return Violation(
        "duration",
        needed,
        given,
        "max",
        "s",
        (),
        "",
        f"{which}; allow {needed:.4g} s, or raise the limits",
    )


def _silent(_: str) -> None:
    pass
