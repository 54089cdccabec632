"""The paper's actions ``move_vertex``, ``move_edge`` and ``adjust``, and ``follow_vertex``.

An action defines which vertices move and which legs keep their lengths.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import EXCHANGED, InfeasibleError, Violation
from hitchopt.geometry import Outline
from hitchopt.hitch import Hitch
from hitchopt.hitch.hitch import cable_slack
from hitchopt.hitch.requirements import Requirements
from hitchopt.motion.motion import Motion
from hitchopt.planners.morph.legs import PATH_SAMPLES, rolling_paths, with_legs_clear, worst_point
from hitchopt.planners.morph.morph import (
    MIN_LEG,
    POSITION_TOLERANCE,
    check_loads,
    check_shapes,
    load_violation,
    shape_violation,
)
from hitchopt.planners.morph.tracks import eased, spline_through, vertex_track
from hitchopt.planners.path import LegLaw, Path, drones_along, path_jets, roll_between, shapes_along
from hitchopt.planners.timing.stretch import needed_stretch
from hitchopt.planners.timing.swing import check_swing
from hitchopt.planners.timing.timed_motion import (
    MAX_CABLE_ERROR,
    MAX_PIECES,
    cable_error,
    check_duration,
    clocked_limits,
    in_duration,
    motion_along,
)
from hitchopt.trajectory import PiecewisePolynomial, joined
from hitchopt.values import Array
from hitchopt.values.fields import with_fields

UNIT_BREAKS = np.array([0.0, 1.0])  # Breakpoints of s for a path of one piece


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


START_TOLERANCE = 1e-6  # [m] Largest distance of a point at t = 0 from the vertex


def move_vertex(start: Hitch, polygon: Outline, vertex: int) -> Action:
    """Return the paper's action 2, which moves only one vertex of the outline.

    ``e_k`` and ``d_{k-1}`` are constant, so that ``q_k, r_{k-1}`` move with the vertex and
    ``q_{k+1}, r_{k-2}`` turn with its edges; with unequal tensions, drones at ``p_{k-1}, p_{k+1}``
    may move too.
    """
    length = start.q_legs.copy()
    share = np.zeros(start.team.robots)
    if start.team.layout.closed or vertex < start.team.robots:
        length[vertex] = -start.r_legs[vertex]
        share[vertex] = 1.0
    return Action(start, polygon, length, share)


def move_edge(start: Hitch, polygon: Outline, edge: int) -> Action:
    """Return the paper's action 3, which moves only the ends of one edge.

    ``d_{k-1}``, ``e_{k+1}`` and the fractions of cable k are constant. If the ends slide along the
    lines of edges k-1 and k+1, only ``q_k, r_k, r_{k-1}, q_{k+1}`` move; otherwise those edges turn
    and ``r_{k-2}, q_{k+2}`` with them.
    """
    robots = start.team.robots
    length = start.q_legs.copy()
    share = np.zeros(robots)
    length[edge] = 0.0
    share[edge] = start.fractions[edge]
    if start.team.layout.closed or edge + 1 < robots:
        following = (edge + 1) % robots
        length[following] = -start.r_legs[following]
        share[following] = 1.0
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
        ``x, y``, which are not timed. The first of those may be the vertex's own position.

    Raises
    ------
    InfeasibleError: a point at t = 0 that differs from the vertex.
    """
    action = move_vertex(start, polygon, vertex)
    origin = start.vertices[vertex, :2]
    first = points[0, -2:]
    distance = float(np.linalg.norm(first - origin))
    if points.shape[1] == 2:
        ahead = points[1:] if distance <= START_TOLERANCE else points
        if not len(ahead):
            return action
        places = np.vstack([origin, ahead])
        covered = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(places, axis=0), axis=1)))
        s = covered / covered[-1]
        path = PiecewisePolynomial(s, spline_through(s, places, (2, 3)))  # straight at the ends
        return replace(action, track=_of_all_vertices(start, vertex, path))
    later = points
    if points[0, 0] == 0.0:
        if distance > START_TOLERANCE:
            raise InfeasibleError([_other_start(vertex, origin, first)])
        later = points[1:]
    times = np.append(0.0, later[:, 0])
    seconds = float(times[-1])
    track = vertex_track(times, np.vstack([origin, later[:, 1:]]))
    path = track.replaced(track.coefficients, times / seconds)
    return replace(action, track=_of_all_vertices(start, vertex, path), seconds=seconds)


def _other_start(vertex: int, origin: Array, first: Array) -> Violation:
    """Return the violation of a first point (2,) [m], at t = 0, off the origin (2,) [m]."""
    distance = float(np.linalg.norm(first - origin))
    is_exchanged = float(np.linalg.norm(first[::-1] - origin)) <= START_TOLERANCE
    remedy = (
        f"the path begins at t = 0 at {first.tolist()}, the vertex is at "
        f"{origin.round(9).tolist()}: start there, or later{EXCHANGED if is_exchanged else ''}"
    )
    where = (f"p{vertex}",)
    return Violation("continuity", distance, START_TOLERANCE, "max", "m", where, "at t = 0", remedy)


def _of_all_vertices(start: Hitch, vertex: int, track: PiecewisePolynomial) -> PiecewisePolynomial:
    """Return the path (points, 3) [m] on which one vertex follows a track (2,), others rest."""
    constants = np.repeat(start.vertices[None, ..., None], track.pieces, axis=0)
    coefficients = np.repeat(constants, track.degree + 1, axis=-1)
    coefficients[:, vertex, :2] = track.coefficients
    return PiecewisePolynomial(track.breaks, coefficients)


@dataclass(frozen=True, eq=False)
class FlownAction:
    """The motion of an action, with names of further drones that move."""

    motion: Motion  # The motion, without phases
    path: Path | None = None  # The path that was timed; None if s is time
    # Names of drones that the law moves only because of unequal tensions or weight
    turning: tuple[str, ...] = ()
    sliding: tuple[str, ...] = ()  # Names of drones that move only because the law was infeasible
    worst: float | None = None  # The law's largest violation is at this s; None without one


MAX_EASED_STRETCH = 2.0
"""Stretch in time of a timed track beyond which no other through the same points is sought."""


@dataclass(frozen=True, eq=False)
class ActionMorph:
    """A planner of actions, in which cables slide if a limit binds on the path."""

    action: Action  # The action
    end: Hitch  # The hitch after it; its legs may differ from those of the law
    requirements: Requirements  # Limits and distances
    duration: float | None = None  # Prescribed duration [s]; None for the fastest one

    @cached_property
    def path_by_law(self) -> Path:
        """The path by the law of the action."""
        return self.action.path(self.end)

    @cached_property
    def path(self) -> Path:
        """The path to be timed; raises InfeasibleError as ``straight_path``."""
        by_law = self.path_by_law
        violation = shape_violation(by_law)
        if violation is not None:  # other legs may be feasible if there is slack
            shapes = shapes_along(by_law, np.linspace(0.0, 1.0, PATH_SAMPLES))
            slack = np.sum(shapes.legs, axis=-1)
            if violation.constraint != "legs" or np.min(slack) < 2.0 * MIN_LEG:
                raise InfeasibleError([violation])
        path = with_legs_clear(by_law, self.requirements, few=True, at_rest=self._is_timed)
        check_shapes(path)
        check_loads(path, self.requirements.limits)
        return path

    @property
    def _is_timed(self) -> bool:
        """Return whether the path's s is time."""
        return self.action.seconds is not None

    @cached_property
    def rolling(self) -> list[Path]:
        """Paths on which legs roll between the ends and keep all distances, the fastest first."""
        paths = rolling_paths(self.path_by_law, self.requirements, at_rest=self._is_timed)
        limits = self.requirements.limits
        return [
            path
            for path in paths
            if shape_violation(path) is None and load_violation(path, limits) is None
        ]

    def solve(self) -> FlownAction | None:
        """Return the flight; None if nothing moves.

        Errors are those of ``path`` and ``motion_along``.
        """
        action = self.action
        distance = np.max(np.abs(self.end.drones - action.start.drones))
        if action.track is None and distance < POSITION_TOLERANCE:
            return None
        return self.flown(self.path)

    def flown(self, path: Path) -> FlownAction:
        """Return the flight along one of its paths; errors are those of ``motion_along``."""
        seconds = self.action.seconds
        if seconds is None:
            motion = motion_along(path, self.requirements, self.duration)
        else:
            motion = self._timed(path, seconds)
        moved = self._moved_drones(motion)
        names = np.array(self.action.start.team.drone_names)
        by_law = self.path_by_law
        return FlownAction(
            motion,
            path=path if seconds is None else None,
            turning=tuple(names[moved.further & moved.by_law].tolist()),
            sliding=tuple(names[moved.further & ~moved.by_law].tolist()),
            worst=None if path is by_law else worst_point(by_law, self.requirements),
        )

    def _timed(self, path: Path, seconds: float) -> Motion:
        """Return the motion whose s is time over ``seconds`` [s], eased if it exceeds a limit.

        Raises InfeasibleError with the smallest time if that is not enough.
        """
        motion = fly_timed(path, self.requirements, seconds)
        if 1.0 < needed_stretch(motion) < MAX_EASED_STRETCH:
            limits = clocked_limits(path, self.requirements)
            motion = fly_timed(eased(path, limits, seconds), self.requirements, seconds)
            check_duration(seconds, needed_stretch(motion) * seconds)
        check_swing(motion)
        return motion

    def _moved_drones(self, motion: Motion) -> MovedDrones:
        """Return which drones the law moves, and which further ones the motion moves.

        Those of the action itself are those that the law moves with equal tensions and no weight.
        """
        action = self.action
        team = action.start.team
        s = np.linspace(0.0, 1.0, PATH_SAMPLES)
        law = action.path()
        ideal = self.path_by_law if action.polygon is action.start.polygon else law
        ideal_team = with_fields(
            team, tension=np.ones(team.robots), load=0.0 * team.load, cable_density=0.0
        )
        by_action = _moving(replace(ideal, team=ideal_team, roll=None), s)
        coefficients = motion.drones.coefficients
        distances = np.linalg.norm(coefficients - coefficients[0, ..., :1], axis=-2)
        travel = np.max(distances, axis=(0, -1))
        further = (travel > POSITION_TOLERANCE) & ~by_action
        return MovedDrones(by_law=_moving(law, s), further=further)


class MovedDrones(NamedTuple):
    """The drones that move during an action."""

    by_law: NDArray[np.bool_]  # (2n,): those that its law moves
    # (2n,): those that the motion moves in addition to those of the paper's action
    further: NDArray[np.bool_]


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
        drone_parts = list[PiecewisePolynomial]()
        vertex_parts = list[PiecewisePolynomial]()
        leg_parts = list[PiecewisePolynomial]()
        for i in range(path.vertices.pieces):
            track = path.vertices.slice_pieces(slice(i, i + 1))
            breaks = np.linspace(track.breaks[0], track.breaks[1], count + 1)
            jets = path_jets(replace(path, vertices=track), breaks)
            drone_parts.append(PiecewisePolynomial.through_jets(breaks, jets.drones))
            vertex_parts.append(PiecewisePolynomial.through_jets(breaks, jets.vertices))
            leg_parts.append(PiecewisePolynomial.through_jets(breaks, jets.legs))
        drones = joined(drone_parts)
        vertices = joined(vertex_parts)
        legs = joined(leg_parts)
        tensions = PiecewisePolynomial.constant(drones.breaks, path.team.tension)
        motion = Motion(path.team, requirements, drones, vertices, legs, tensions, phases=())
        if drones.pieces >= MAX_PIECES or cable_error(motion) <= MAX_CABLE_ERROR:
            return in_duration(motion, seconds)
        count *= 2
