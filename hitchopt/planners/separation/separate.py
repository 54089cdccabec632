"""The planner: guesses, convex programs around them, and the certificate that ends the search."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import InfeasibleError, Violation
from hitchopt.planners.separation.end_checks import check_ends
from hitchopt.planners.separation.evaluation import Standing, standing_of
from hitchopt.planners.separation.guess import Manners, pushed_apart
from hitchopt.planners.separation.planes import ClosePieces, close_pieces, planes_between
from hitchopt.planners.separation.qp import ProgramError, Solver
from hitchopt.planners.separation.separation_program import MARGIN, Around, build_program
from hitchopt.planners.separation.setting import Course, course_of
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

STALLED = 6
"""Rounds in a row that may bring nothing while drones still meet."""

UNCLEAR, LATE = 1e9, 1e6
"""Orders of demerit: of curves that break a limit at any speed, and of those that take too long."""

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
        raise InfeasibleError([_too_short(task, course.bound, "no drone can be as fast")])
    tried: list[Standing] = []
    if standing_of(course, course.nominal).clear:  # nobody is in anybody's way
        found = _improved(course, course.nominal, say)
        if found.clear and found.duration <= (task.duration or math.inf):
            return _separated(course, found, "")
        tried.append(found)
    for manners in GUESSES:
        patience = manners.patience
        if task.duration is not None and patience * course.alone > task.duration:
            continue
        say(f"guess: {manners}")
        way = course if patience == 1.0 else course_of(task, patience)
        found = _improved(way, pushed_apart(way, manners), say)
        if found.clear and found.duration <= (task.duration or math.inf):
            return _separated(way, found, str(manners))
        tried.append(found)
    return _last_resort(task, tried, say)


def _improved(course: Course, guess: Array, say: Progress) -> Standing:
    """Return the best curves that programs around a guess lead to, clear ones if there are any."""
    solver = Solver()
    here = best = standing_of(course, guess)
    known: ClosePieces | None = None
    idle = 0
    for round_number in range(ROUNDS):
        around = _around(course, here, known)
        known = around.planes.between
        built = build_program(course, around)
        first = np.zeros(len(built.program.q))  # unknowns are changes
        try:
            solution = solver.solve(built.program, first, built.kept_rows)
        except ProgramError:
            break
        here = standing_of(course, built.moved(solution.x))
        say(f"round {round_number + 1}: {here.duration:.3g} s, separation {here.closest:.3f}")
        idle = 0 if _demerit(course, here) < (1.0 - GAIN) * _demerit(course, best) else idle + 1
        if _demerit(course, here) < _demerit(course, best):
            best = here
        if _enough(course, here, best, idle):
            break
    return best


def _around(course: Course, here: Standing, known: ClosePieces | None) -> Around:
    """Return where the next program is set up, with the planes of the last one among its own."""
    task = course.task
    radius = task.requirements.separation.radius
    aimed = FASTER * here.duration if here.clear else here.duration
    floor = BARELY * course.alone if task.duration is None else task.duration
    pieces = course.grid.pieces_of(here.coefficients)
    scaled = pieces * course.scale[:, None]
    close = close_pieces(scaled, 1.0 + MARGIN + REACH)
    if known is not None:
        close = close.united(known, task.drones)
    trust = TRUST * radius
    walls = walls_before(pieces, task.requirements.keep_out, radius, radius + 2.0 * trust)
    planes = planes_between(scaled, close)
    return Around(here.coefficients, max(aimed, floor), trust, planes, walls)


def _enough(course: Course, here: Standing, best: Standing, idle: int) -> bool:
    """Return whether more rounds are not worth their while."""
    if not best.clear:
        return idle >= STALLED
    if course.task.duration is not None:
        return idle >= (1 if best.duration <= course.task.duration else PATIENCE)
    if best.duration <= max(GOOD, BARELY) * course.alone:
        return True
    nearly = best.duration <= NEARLY * course.alone and here.clear
    return idle >= (1 if nearly else PATIENCE)


def _demerit(course: Course, standing: Standing) -> float:
    """Return a number that is smaller the better.

    What is not clear is worst. Of the rest the fastest is best; or, where the duration is given and
    kept, what is nearest to the nominal curves.
    """
    given = course.task.duration
    if not standing.clear:
        return UNCLEAR * (2.0 - min(standing.closest, 1.0))
    if given is None:
        return standing.duration
    if standing.duration > given:
        return LATE * standing.duration / given
    s, weights = course.grid.quadrature
    offset = np.einsum(
        "sc,ncd->nsd", course.grid.sampled(s), standing.coefficients - course.nominal
    )
    return float(np.sum(weights[:, None] * offset**2)) / course.size**2 / len(offset)


def _separated(course: Course, found: Standing, remark: str) -> Separated:
    duration = found.duration if course.task.duration is None else course.task.duration
    curves = course.grid.curves(found.coefficients, duration)
    return Separated(curves, found.closest, course.bound, remark)


def _last_resort(task: SeparationTask, tried: list[Standing], say: Progress) -> Separated:
    """Return the fastest flight at the pace that is asked for, or say how long it takes."""
    nearest = max(tried, key=lambda standing: standing.closest)
    note = f"no way was found from {len(tried)} guesses, which proves nothing"
    if task.duration is None:
        raise InfeasibleError(nearest.broken, note)
    say("looking for a duration that would do")
    try:
        found = separate(replace(task, duration=None), say)
    except InfeasibleError:
        raise InfeasibleError(nearest.broken, note) from None
    needed = found.drones.duration
    if needed > task.duration:
        raise InfeasibleError([_too_short(task, needed, "the fastest way found takes longer")])
    return replace(found, drones=found.drones.stretched(task.duration / needed))


def _too_short(task: SeparationTask, needed: float, which: str) -> Violation:
    grain = 10.0 ** (math.floor(math.log10(needed)) - 3)  # upward: what is told must do
    enough = grain * math.ceil(needed / grain * (1.0 + 1e-9))
    return Violation(
        "duration",
        needed,
        task.duration or math.nan,
        "max",
        "s",
        (),
        "",
        f"{which}; allow {enough:.4g} s, or raise the limits",
    )


def _silent(_: str) -> None:
    pass
