"""The paper's actions ``move_vertex``, ``move_edge`` and ``adjust``, and ``follow_vertex``.

An action defines which vertices move and which legs keep their lengths.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import EXCHANGED, InfeasibleError, Violation
from hitchopt.geometry import Outline
from hitchopt.hitch import Hitch
from hitchopt.hitch.hitch import cable_slack
from hitchopt.hitch.requirements import Requirements
from hitchopt.motion.motion import Motion
from hitchopt.planners.morph.legs import PATH_SAMPLES, with_legs_clear, worst_point
from hitchopt.planners.morph.morph import MIN_LEG, POSITION_TOLERANCE, check_loads, check_shapes
from hitchopt.planners.morph.path import (
    LegLaw,
    Path,
    drones_along,
    path_jets,
    roll_between,
    shapes_along,
)
from hitchopt.planners.timing.timed_motion import (
    MAX_CABLE_ERROR,
    MAX_PIECES,
    cable_error,
    in_duration,
    motion_along,
)
from hitchopt.trajectory import PiecewisePolynomial, joined
from hitchopt.trajectory.splines import interpolated
from hitchopt.values import Array
from hitchopt.values.fields import with_fields

UNIT_BREAKS = np.array([0.0, 1.0])
"""Breakpoints of s for a path of one piece."""


@dataclass(frozen=True, eq=False)
class Action:
    """A change of shape with its leg law.

    Parameters
    ----------
    start: the hitch before.
    polygon: the outline after.
    length, share: (n,) [m] and without unit, of the leg law ``d = length + share · slack``.
    track: of shape (n, 3) over s from 0 to 1 [m], the vertices; None for straight lines.
    seconds: duration [s] if s is proportional to time, else None.
    """

    start: Hitch
    polygon: Outline
    length: Array
    share: Array
    track: PiecewisePolynomial | None = None
    seconds: float | None = None

    @property
    def legs_by_law(self) -> Array:
        """(n,) [m]: the q-legs after the action by its law, of any sign."""
        slack = cable_slack(self.start.team, self.polygon)
        return self.start.team.layout.q_legs_of(self.length + self.share * slack, slack)

    def path(self, end: Hitch | None = None) -> Path:
        """Return the path that ends with the legs and roll of a hitch, or by the law if None."""
        deviation = np.zeros_like(self.length) if end is None else end.q_legs - self.legs_by_law
        # Linear in s, or at rest at both ends if s is time.
        progress = np.repeat([0.0, 1.0], 1 if self.seconds is None else 3)
        length = (self.length[:, None] + deviation[:, None] * progress)[None]
        share = PiecewisePolynomial.constant(UNIT_BREAKS, self.share)
        law = LegLaw(PiecewisePolynomial(UNIT_BREAKS, length), share)
        roll = roll_between(self.start, self.start if end is None else end, tuple(progress))
        track = self.track
        if track is None:
            points = self.polygon.vertices
            last = np.column_stack([points, np.full(len(points), self.start.altitude)])
            both = np.stack([self.start.vertices, last], axis=-1)
            track = PiecewisePolynomial(UNIT_BREAKS, both[None])
        return Path(self.start.team, track, law, roll=roll)


START_TOLERANCE = 1e-6
"""[m] Largest distance of a point at t = 0 from the vertex."""


def move_vertex(start: Hitch, polygon: Outline, vertex: int) -> Action:
    """Return the paper's action 2, which moves only one vertex of the outline.

    ``e_k`` and ``d_{k-1}`` are constant, so that ``q_k, r_{k-1}`` move with the vertex and
    ``q_{k+1}, r_{k-2}`` turn with its edges; with unequal tensions, drones at ``p_{k-1}, p_{k+1}``
    may move too.
    """
    length, share = start.q_legs.copy(), np.zeros(start.team.robots)
    if start.team.layout.closed or vertex < start.team.robots:
        length[vertex], share[vertex] = -start.r_legs[vertex], 1.0
    return Action(start, polygon, length, share)


def move_edge(start: Hitch, polygon: Outline, edge: int) -> Action:
    """Return the paper's action 3, which moves only the ends of one edge.

    ``d_{k-1}``, ``e_{k+1}`` and the fractions of cable k are constant. If the ends slide along the
    lines of edges k-1 and k+1, only ``q_k, r_k, r_{k-1}, q_{k+1}`` move; otherwise those edges turn
    and ``r_{k-2}, q_{k+2}`` with them.
    """
    n = start.team.robots
    length, share = start.q_legs.copy(), np.zeros(n)
    length[edge], share[edge] = 0.0, start.fractions[edge]
    after = edge + 1
    if start.team.layout.closed or after < n:
        length[after % n], share[after % n] = -start.r_legs[after % n], 1.0
    return Action(start, polygon, length, share)


def adjust(start: Hitch, polygon: Outline) -> Action:
    """Return the paper's action 4: cables slide through their clasps, with a constant outline.

    Only drones of cables whose legs change move.
    """
    return Action(start, polygon, start.q_legs, np.zeros(start.team.robots))


def follow_vertex(start: Hitch, polygon: Outline, vertex: int, points: Array) -> Action:
    """Return the action that moves a vertex through points, with the law of move_vertex.

    Parameters
    ----------
    start: the hitch before.
    polygon: the outline after.
    vertex: index of the vertex.
    points: (J, 3), rows ``t, x, y`` [s, m, m], t increasing from 0 or later; or (J, 2) [m], rows
        ``x, y``, which are not timed. The first of those may be the vertex's own place.

    Raises
    ------
    InfeasibleError: a point at t = 0 that differs from the vertex.
    """
    origin, action = start.vertices[vertex, :2], move_vertex(start, polygon, vertex)
    first = points[0, -2:]
    distance = float(np.linalg.norm(first - origin))
    if points.shape[1] == 2:
        ahead = points[1:] if distance <= START_TOLERANCE else points
        path = _smooth_track(np.vstack([origin, ahead])) if len(ahead) else None
        return replace(action, track=path and _of_all_vertices(start, vertex, path))
    if points[0, 0] == 0.0:
        if distance > START_TOLERANCE:
            where, place = (f"p{vertex}",), origin.round(9).tolist()
            remedy = f"the path begins at t = 0 at {first.tolist()}, the vertex is at {place}: "
            exchanged = float(np.linalg.norm(first[::-1] - origin)) <= START_TOLERANCE
            remedy += f"begin there, or later{EXCHANGED if exchanged else ''}"
            violation = Violation(
                "continuity", distance, START_TOLERANCE, "max", "m", where, "at t = 0", remedy
            )
            raise InfeasibleError([violation])
        points = points[1:]
    times = np.append(0.0, points[:, 0])
    track, seconds = vertex_track(times, np.vstack([origin, points[:, 1:]])), float(times[-1])
    path = track.replaced(track.coefficients, times / seconds)
    return replace(action, track=_of_all_vertices(start, vertex, path), seconds=seconds)


def _of_all_vertices(start: Hitch, vertex: int, track: PiecewisePolynomial) -> PiecewisePolynomial:
    """Return the path (points, 3) [m] on which one vertex follows a track (2,), others rest."""
    constants = np.repeat(start.vertices[None, ..., None], track.pieces, axis=0)
    coefficients = np.repeat(constants, track.degree + 1, axis=-1)
    coefficients[:, vertex, :2] = track.coefficients
    return PiecewisePolynomial(track.breaks, coefficients)


def _smooth_track(points: Array) -> PiecewisePolynomial:
    """Return the spline through points (J, d) [m] over s, a piece per stretch; straight at ends."""
    lengths = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
    s = lengths / lengths[-1]
    return PiecewisePolynomial(s, _through(s, points, (2, 3)))


def _through(s: Array, points: Array, zero_orders: tuple[int, int]) -> Array:
    """Return the coefficients (J - 1, d, 6) of a quintic spline through points (J, d) at s (J,)."""
    coefficients = interpolated(s - s[0], points, zero_orders=zero_orders).coefficients.copy()
    coefficients[..., 0], coefficients[..., -1] = points[:-1], points[1:]
    return coefficients


def vertex_track(times: Array, points: Array) -> PiecewisePolynomial:
    """Return the path through points (J, d) [m] at times (J,) [s], a piece per interval.

    Each moving stretch is a quintic spline with four continuous derivatives, which minimizes the
    squared jerk; it is at rest at both ends.
    """
    distances = np.linalg.norm(np.diff(points, axis=0), axis=1)
    resting = distances < POSITION_TOLERANCE
    # Stretches end where the vertex stops or starts.
    changes = np.flatnonzero(resting[1:] | resting[:-1]) + 1
    bounds = [0, *changes.tolist(), len(distances)]
    coefficients = np.empty((len(distances), points.shape[1], 6))
    for first, last in pairwise(bounds):
        span = slice(first, last)
        if resting[first]:
            coefficients[span] = points[span, :, None]
            continue
        knots = slice(first, last + 1)
        coefficients[span] = _through(times[knots], points[knots], (1, 2))
    return PiecewisePolynomial(times, coefficients)


@dataclass(frozen=True, eq=False)
class FlownAction:
    """The motion of an action, with names of further drones that move."""

    motion: Motion | None
    """The motion, without phases; None if nothing moves."""

    path: Path | None = None
    """The path that was timed; None if nothing moves, or s is time."""

    turning: tuple[str, ...] = ()
    """Names of drones that the law moves only because of unequal tensions or weight."""

    sliding: tuple[str, ...] = ()
    """Names of drones that move only because the law was infeasible."""

    worst: float | None = None
    """The law's largest violation is at this s; None without one."""


@dataclass(frozen=True, eq=False)
class ActionMorph:
    """A planner of actions, in which cables slide if a limit binds on the path."""

    action: Action
    """The action."""

    end: Hitch
    """The hitch after it; its legs may differ from those of the law."""

    requirements: Requirements
    """Limits and distances."""

    duration: float | None = None
    """Prescribed duration [s]; None for the fastest one."""

    @cached_property
    def own_path(self) -> Path:
        """The path by the action's own law."""
        return self.action.path(self.end)

    @cached_property
    def problem(self) -> Path:
        """The path to be timed; raises InfeasibleError as ``straight_path``."""
        own = self.own_path
        try:
            check_shapes(own)
        except InfeasibleError as error:  # other legs may be feasible if there is slack
            slack = np.sum(shapes_along(own, np.linspace(0.0, 1.0, PATH_SAMPLES)).legs, axis=-1)
            if error.violations[0].constraint != "legs" or np.min(slack) < 2.0 * MIN_LEG:
                raise
        timed = self.action.seconds is not None
        path = with_legs_clear(own, self.requirements, few=True, at_rest=timed)
        check_shapes(path)
        check_loads(path, self.requirements.limits)
        return path

    def solve(self) -> FlownAction:
        """Return the flight; errors are those of ``problem`` and ``motion_along``."""
        action, seconds = self.action, self.action.seconds
        team = action.start.team
        distance = np.max(np.abs(self.end.drones - action.start.drones))
        if action.track is None and distance < POSITION_TOLERANCE:
            return FlownAction(None)
        path = self.problem
        if seconds is None:
            motion = motion_along(path, self.requirements, self.duration)
        else:
            motion = fly_timed(path, self.requirements, seconds)
        # The action's own drones are those that the law moves with equal tensions and no weight.
        law = action.path()
        ideal = self.own_path if action.polygon is action.start.polygon else law
        equal = with_fields(
            team, tension=np.ones(team.robots), load=0.0 * team.load, cable_density=0.0
        )
        s = np.linspace(0.0, 1.0, PATH_SAMPLES)
        by_law = _moving(law, s)
        by_action = _moving(replace(ideal, team=equal, roll=None), s)
        hulls = motion.drones.coefficients
        travel = np.max(np.linalg.norm(hulls - hulls[0, ..., :1], axis=-2), axis=(0, -1))
        further = (travel > POSITION_TOLERANCE) & ~by_action
        names = np.array(team.drone_names)
        turning = tuple(names[further & by_law].tolist())
        sliding = tuple(names[further & ~by_law].tolist())
        worst = None if path is self.own_path else worst_point(self.own_path, self.requirements)
        timed_path = path if seconds is None else None
        return FlownAction(motion, timed_path, turning, sliding, worst)


def _moving(path: Path, s: Array) -> NDArray[np.bool_]:
    """Return the mask (2n,) of drones that move between points s of a path."""
    drones = drones_along(path, s).positions[..., 0]
    moving: NDArray[np.bool_]
    moving = np.max(np.linalg.norm(drones - drones[:1], axis=-1), axis=0) > POSITION_TOLERANCE
    return moving


def fly_timed(path: Path, requirements: Requirements, seconds: float) -> Motion:
    """Return the motion on which the path's s is time over ``seconds`` [s].

    Polynomials do not extend over joints of the vertices' path. All pieces are refined until the
    flight satisfies MAX_CABLE_ERROR.
    """
    count = 1
    while True:
        parts = []
        for i in range(path.vertices.pieces):
            track = path.vertices.slice_pieces(slice(i, i + 1))
            breaks = np.linspace(track.breaks[0], track.breaks[1], count + 1)
            curves = path_jets(replace(path, vertices=track), breaks)[:3]
            parts.append([PiecewisePolynomial.through_jets(breaks, each) for each in curves])
        drones, vertices, legs = (joined(list(kind)) for kind in zip(*parts, strict=True))
        tensions = PiecewisePolynomial.constant(drones.breaks, path.team.tension)
        motion = Motion(path.team, requirements, drones, vertices, legs, tensions, phases=())
        if drones.pieces >= MAX_PIECES or cable_error(motion) <= MAX_CABLE_ERROR:
            return in_duration(motion, seconds)
        count *= 2
