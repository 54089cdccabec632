"""The stages of a plan one by one: ``route``, ``time``, and ``certify`` of ``checks``.

``morph`` and all steps that reshape a hitch pass through the same stages: a route is searched,
timed (``motion_along``) and certified.
"""

from __future__ import annotations

import numpy as np

from hitchopt.api import step_errors, step_problem
from hitchopt.errors import Circumstance, InputError, time_limit
from hitchopt.geometry.vectors import length
from hitchopt.hitch import Hitch
from hitchopt.hitch.casadi_model import CostFunction
from hitchopt.hitch.requirements import Arena, Limits, Requirements, Separation
from hitchopt.mission.solving import route_of
from hitchopt.motion.motion import Motion, Phase
from hitchopt.planners.morph.morph import check_loads, check_shapes
from hitchopt.planners.path import Path
from hitchopt.planners.timing.following import following_motion
from hitchopt.planners.timing.profile import TimingError
from hitchopt.steps.keys import Legs, Polygon
from hitchopt.steps.moving import Morph
from hitchopt.values import check_instance, positive
from hitchopt.values.fields import suggest_keywords


@suggest_keywords
def route(
    start: Hitch,
    polygon: Polygon,
    legs: Legs | None = None,
    optimize: bool = False,
    tension: tuple[float, float] | None = None,
    *,
    limits: Limits | None = None,
    separation: Separation | None = None,
    arena: Arena | None = None,
    limit: float | None = None,
    cost: CostFunction | None = None,
) -> Path:
    """Return the path on which ``morph`` changes the polygon.

    Vertices move straight, with the leg lengths nearest to linear ones that keep all distances. If
    that path is infeasible or slow, a sequence of sparse quadratic programs moves vertices and legs
    at the knots of a spline, with exact derivatives from casadi; PIQP solves them
    (``casadi.conic``). A path is accepted if its motion, by ``time``, is certified: routing takes
    as long as planning.

    Parameters
    ----------
    start: the hitch at s = 0.
    polygon, legs, optimize, tension, limits, separation, arena, limit, cost: as of ``morph``.

    Raises
    ------
    InputError: an argument is invalid, or the polygon and legs are those of the start.
    InfeasibleError: there is no route; lists the limits that bind, where and when.
    TimeLimitError: no route within ``limit``.
    """
    check_instance("start", start, Hitch)
    step = Morph(
        polygon=polygon,
        legs=legs,
        optimize=optimize,
        tension=tension,
        settle=False,
        cost=cost,
    )
    seconds = None if limit is None else positive("limit", limit)
    problem = step_problem(start.team, start, step, limits, separation, arena)
    with step_errors(step), time_limit(seconds):
        path = route_of(problem)
    if path is None:
        raise InputError("polygon", polygon, "different from the start's", "nothing moves")
    return path


@suggest_keywords
def time(
    path: Path,
    duration: float | None = None,
    *,
    limits: Limits | None = None,
    separation: Separation | None = None,
    arena: Arena | None = None,
) -> Motion:
    """Return the motion along a path, from rest to rest, as fast as the limits of motion allow.

    TOPP-RA (H. Pham and Q.-C. Pham, IEEE T-RO 34, 2018), by ``toppra.algorithm.TOPPRA``, computes
    the fastest speed without a jerk limit, in polygons of (s̈, ṡ²) of all drones' limits. The
    jerk-limited clock after it is ours: a cubic spline of the squared rate (after F. Debrouwere et
    al., IEEE T-RO 29, 2013). Polynomials with the path's derivatives at every breakpoint are halved
    until they follow the path within 0.1 mm (vertices by an upper bound for all t, drones at eight
    times on each), and slowed down until the limits hold between breakpoints.

    A path with a duration of its own (``Path.of``) keeps its timing, and the limits of motion are
    not enforced. Distances, arena and cable lengths follow from the path. ``certify`` checks both.

    Parameters
    ----------
    path: by ``route`` or ``Path.of``.
    duration: exact duration [s]; default: as fast as the limits allow, or that of the path.
    limits: limits of motion; default as in a problem file.
    separation, arena: requirements that ``certify`` checks; defaults as in a problem file. As
        there, drones' models and controllers provide what they do not state.

    Raises
    ------
    InputError: an argument is invalid, or the path has no timing, as where all drones rest, or
        turns too often for 10,000 polynomials.
    InfeasibleError: a polygon on the path is not convex, a leg vanishes, drones cannot hover there,
        or the duration is too short.
    """
    check_instance("path", path, Path)
    seconds = None if duration is None else positive("duration", duration)
    if seconds is not None and path.duration is not None:
        bound = f"omitted: the path takes {path.duration:g} s"
        raise InputError("duration", duration, bound, "state it in Path.of")
    requirements = Requirements(
        Limits() if limits is None else limits,
        Separation() if separation is None else separation,
        arena,
    ).flown_by(path.team)
    enforced = requirements.with_reserve
    check_shapes(path)
    check_loads(path, enforced.limits)
    try:
        motion = following_motion(path, enforced, seconds)
    except TimingError as error:
        raise _untimed(path) from error
    span = None
    if path.tensions is not None:
        tensions = motion.tensions.coefficients
        span = float(np.min(tensions)), float(np.max(tensions))
    phase = Phase("path", 0, 0.0, motion.duration, tension=span)
    return motion.replaced(phases=(phase,), requirements=requirements)


MOVING_SAMPLES = 257  # Number of points of a path at which drones are compared

MIN_MOVE = 1e-9  # [m] Smallest motion of some drone between two of these


def _untimed(path: Path) -> InputError:
    """Return the error of a path that has no timing, with where all drones rest, if they do."""
    s = np.linspace(0.0, 1.0, MOVING_SAMPLES)
    moves = np.max(length(np.diff(path.drones(s), axis=0)), axis=1)
    resting = np.flatnonzero(moves < MIN_MOVE)
    if not resting.size:
        return InputError(
            "path", Circumstance("no timing exists"), "smooth", "make it smoother or split it"
        )
    after = np.flatnonzero(np.diff(resting) > 1)
    last = resting[after[0]] if after.size else resting[-1]
    found = Circumstance(f"rests from s = {s[resting[0]]:.3g} to {s[last + 1]:.3g}")
    return InputError("path", found, "moving everywhere", "split it there, and hold between")
