"""The paper's actions ``move_vertex``, ``move_edge`` and ``adjust``, and ``follow_vertex``.

An action tells which vertices move, and which legs keep their lengths meanwhile.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import InfeasibleError, Violation
from hitchopt.geometry import Outline
from hitchopt.hitch import Hitch
from hitchopt.hitch.hitch import cable_slack
from hitchopt.hitch.requirements import Requirements
from hitchopt.motion.motion import Motion
from hitchopt.planners.morph.jets import polynomials_through, quintic_spline
from hitchopt.planners.morph.legs import PROBES, with_legs_clear, worst_place
from hitchopt.planners.morph.morph import SAME, SHORTEST_LEG, check_loads, check_shapes
from hitchopt.planners.morph.path import (
    LegLaw,
    ShapePath,
    drones_along,
    path_jets,
    roll_between,
    shapes_along,
)
from hitchopt.planners.timing.flight import FINEST, MODEL_ERROR, cable_error, fly, in_duration
from hitchopt.trajectory import PiecewisePolynomial, joined
from hitchopt.values import Array

WHOLE = np.array([0.0, 1.0])
"""Breaks of s, of a path in one piece."""


@dataclass(frozen=True, eq=False)
class Action:
    """A change of shape and the legs that it keeps.

    Parameters
    ----------
    start: the hitch before.
    polygon: the outline after.
    length, share: (n,) [m] and without unit; the legs kept are ``d = length + share · slack``.
    track: of shape (n, 3) over s from 0 to 1 [m], the vertices in between; None for straight lines.
    seconds: [s] how long, where s is time already; else None.
    """

    start: Hitch
    polygon: Outline
    length: Array
    share: Array
    track: PiecewisePolynomial | None = None
    seconds: float | None = None

    @property
    def kept_legs(self) -> Array:
        """(n,) [m]: the q-legs that the law leaves after the action, of any sign."""
        slack = cable_slack(self.start.team, self.polygon)
        return self.start.team.layout.q_legs_of(self.length + self.share * slack, slack)

    def path(self, end: Hitch | None = None) -> ShapePath:
        """Return the path that ends with a hitch's legs and roll, those kept if None.

        What they differ by from the kept ones is made up along the path.
        """
        deviation = np.zeros_like(self.length) if end is None else end.q_legs - self.kept_legs
        # Along s; at rest at both ends where it is time.
        grown = np.array([0.0, 1.0] if self.seconds is None else [0.0, 0.0, 0.0, 1.0, 1.0, 1.0])
        length = (self.length[:, None] + deviation[:, None] * grown)[None]
        share = PiecewisePolynomial.constant(WHOLE, self.share)
        law = LegLaw(PiecewisePolynomial(WHOLE, length), share)
        roll = roll_between(self.start, self.start if end is None else end, tuple(grown))
        track = self.track
        if track is None:
            points = self.polygon.vertices
            last = np.column_stack([points, np.full(len(points), self.start.altitude)])
            both = np.stack([self.start.vertices, last], axis=-1)
            track = PiecewisePolynomial(WHOLE, both[None])
        return ShapePath(self.start.team, track, law, roll=roll)


SAME_PLACE = 1e-6
"""[m] Largest distance of a point at t = 0 from the vertex."""


def move_vertex(start: Hitch, polygon: Outline, vertex: int) -> Action:
    """Return the paper's action 2: of the outline only ``vertex`` changes.

    ``e_k`` and ``d_{k-1}`` are kept, so ``q_k``, ``r_{k-1}`` go with the vertex and ``q_{k+1}``,
    ``r_{k-2}`` turn with its edges; where tensions differ, so may others at ``p_{k-1}, p_{k+1}``.
    """
    length, share = start.q_legs.copy(), np.zeros(start.team.robots)
    if start.team.layout.closed or vertex < start.team.robots:
        length[vertex], share[vertex] = -start.r_legs[vertex], 1.0
    return Action(start, polygon, length, share)


def move_edge(start: Hitch, polygon: Outline, edge: int) -> Action:
    """Return the paper's action 3: of the outline only the ends of ``edge`` change.

    ``d_{k-1}`` and ``e_{k+1}`` are kept, and the fractions of cable k. Where the ends slide along
    the lines of edges k-1 and k+1 only ``q_k, r_k, r_{k-1}, q_{k+1}`` move; else those edges turn,
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
    """Return the paper's action 4: cables slide through their clasps, the outline stays.

    Drones move of those cables only whose legs change.
    """
    return Action(start, polygon, start.q_legs, np.zeros(start.team.robots))


def follow_vertex(start: Hitch, polygon: Outline, vertex: int, points: Array) -> Action:
    """Return the action that leads ``vertex`` along timed points, legs kept as by move_vertex.

    Parameters
    ----------
    start: the hitch before.
    polygon: the outline after.
    vertex: which.
    points: (J, 3), rows ``t, x, y`` [s, m, m]; t increases from 0 or later.

    Raises
    ------
    InfeasibleError: a point at t = 0 that is not where the vertex is.
    """
    here = start.vertices[vertex, :2]
    if points[0, 0] == 0.0:
        away, begin = float(np.linalg.norm(points[0, 1:] - here)), points[0, 1:].tolist()
        if away > SAME_PLACE:
            where, place = (f"p{vertex}",), here.round(9).tolist()
            remedy = f"the path begins at t = 0 at {begin}, the vertex is at {place}: "
            remedy += "begin there, or later"
            violation = Violation(
                "continuity", away, SAME_PLACE, "max", "m", where, "at t = 0", remedy
            )
            raise InfeasibleError([violation])
        points = points[1:]
    times = np.append(0.0, points[:, 0])
    track = vertex_track(times, np.vstack([here, points[:, 1:]]))
    still = np.repeat(start.vertices[None, ..., None], track.pieces, axis=0)
    coefficients = np.repeat(still, track.degree + 1, axis=-1)
    coefficients[:, vertex, :2] = track.coefficients
    seconds = float(times[-1])
    path = PiecewisePolynomial(times / seconds, coefficients)
    return replace(move_vertex(start, polygon, vertex), track=path, seconds=seconds)


def vertex_track(times: Array, places: Array) -> PiecewisePolynomial:
    """Return the path through ``places`` (J, d) [m] at ``times`` (J,) [s], one piece each.

    Each moving stretch is a quintic spline with four continuous derivatives, which is the smoothest
    one in the sense of least jerk; it is at rest at both ends.
    """
    gaps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    resting = gaps < SAME
    # A stretch ends where the vertex stops or starts.
    changes = np.flatnonzero(resting[1:] | resting[:-1]) + 1
    bounds = [0, *changes.tolist(), len(gaps)]
    coefficients = np.empty((len(gaps), places.shape[1], 6))
    for first, last in pairwise(bounds):
        span = slice(first, last)
        if resting[first]:
            coefficients[span] = places[span, :, None]
            continue
        knots = times[first : last + 1]
        met = places[first : last + 1]
        spline = quintic_spline(knots - knots[0], met, (1, 2))
        coefficients[span] = PiecewisePolynomial.from_spline(spline).coefficients
        coefficients[span, :, 0] = places[first:last]
        coefficients[span, :, -1] = places[first + 1 : last + 1]
    return PiecewisePolynomial(times, coefficients)


@dataclass(frozen=True, eq=False)
class Flying:
    """The flight of an action, and which drones move in it.

    Attributes
    ----------
    motion: without phases; None where nothing moves.
    turning: names of the drones that its law moves only as tensions differ, or for weight.
    sliding: names of those that move only because its law could not be kept.
    worst: s where the law broke a limit on the path, or None.
    """

    motion: Motion | None
    turning: tuple[str, ...] = ()
    sliding: tuple[str, ...] = ()
    worst: float | None = None


@dataclass(frozen=True, eq=False)
class ActionMorph:
    """The planner of an action, cables sliding where a limit binds on the path.

    Attributes
    ----------
    action: what moves, and by which law.
    end: the hitch after it; its legs may differ from those that the law keeps.
    requirements: limits and distances.
    duration: exactly that long [s]; None for as fast as the limits allow.
    """

    action: Action
    end: Hitch
    requirements: Requirements
    duration: float | None = None

    @cached_property
    def own(self) -> ShapePath:
        """The path by the action's own law."""
        return self.action.path(self.end)

    @cached_property
    def problem(self) -> ShapePath:
        """The path that is timed; raises InfeasibleError as that of a straight morph."""
        own = self.own
        try:
            check_shapes(own)
        except InfeasibleError as error:  # other legs may do if there is slack
            slack = np.sum(shapes_along(own, np.linspace(0.0, 1.0, PROBES)).legs, axis=-1)
            if error.violations[0].constraint != "legs" or np.min(slack) < 2.0 * SHORTEST_LEG:
                raise
        timed = self.action.seconds is not None
        path = with_legs_clear(own, self.requirements, few=True, at_rest=timed)
        check_shapes(path)
        check_loads(path, self.requirements.limits)
        return path

    def solve(self) -> Flying:
        """Return the flight, and who moves in it; raises what a straight morph's ``solve`` does."""
        action, seconds = self.action, self.action.seconds
        team, s = action.start.team, np.linspace(0.0, 1.0, PROBES)
        if seconds is None and np.max(np.abs(self.end.drones - action.start.drones)) < SAME:
            return Flying(None)
        path = self.problem
        if seconds is None:
            motion = fly(path, self.requirements, self.duration)
        else:
            motion = fly_timed(path, self.requirements, seconds)
        # Which drones the action means: those that its law moves if tensions and weights are alike.
        own_law = action.path()
        meant = self.own if action.polygon is action.start.polygon else own_law
        alike = replace(team, tension=np.ones(team.robots), load=0.0 * team.load, cable_density=0.0)
        meant = replace(meant, team=alike, roll=None)
        turned, named = (_moving(each, s) for each in (own_law, meant))
        hulls = motion.drones.coefficients
        away = np.max(np.linalg.norm(hulls - hulls[0, ..., :1], axis=-2), axis=(0, -1))
        names, further = np.array(team.drone_names), (away > SAME) & ~named
        turning, sliding = (tuple(names[further & some].tolist()) for some in (turned, ~turned))
        worst = None if path is self.own else worst_place(self.own, self.requirements)
        return Flying(motion, turning, sliding, worst)


def _moving(path: ShapePath, s: Array) -> NDArray[np.bool_]:
    """Return which drones (2n,) are elsewhere at one of the points s of a path."""
    places = drones_along(path, s).positions[..., 0]
    moving: NDArray[np.bool_]
    moving = np.max(np.linalg.norm(places - places[:1], axis=-1), axis=0) > SAME
    return moving


def fly_timed(path: ShapePath, requirements: Requirements, seconds: float) -> Motion:
    """Return the motion on which the path's s is time over ``seconds`` [s].

    Pieces of the vertices' path stay apart, so that no polynomial smooths over a joint of them; all
    are halved until the flight fits the model.
    """
    count = 1
    while True:
        parts = []
        for i in range(path.vertices.pieces):
            track = path.vertices.slice_pieces(slice(i, i + 1))
            breaks = np.linspace(track.breaks[0], track.breaks[1], count + 1)
            curves = path_jets(replace(path, vertices=track), breaks)[:3]
            parts.append([polynomials_through(breaks, each) for each in curves])
        drones, vertices, legs = (joined(list(kind)) for kind in zip(*parts, strict=True))
        tensions = PiecewisePolynomial.constant(drones.breaks, path.team.tension)
        motion = Motion(path.team, requirements, drones, vertices, legs, tensions, phases=())
        if drones.pieces >= FINEST or cable_error(motion) <= MODEL_ERROR:
            return in_duration(motion, seconds)
        count *= 2
