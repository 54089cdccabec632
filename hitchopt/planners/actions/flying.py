"""The flight of an action to the hitch that it ends with."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import InfeasibleError
from hitchopt.hitch import Hitch
from hitchopt.planners.actions.action import Action
from hitchopt.planners.actions.sliding import Clearance, cleared
from hitchopt.planners.path.jets import polynomials_through
from hitchopt.planners.path.path_feasibility import SHORTEST_LEG, check_loads, check_shapes
from hitchopt.planners.path.shape_path import ShapePath, drones_along, path_jets, shapes_along
from hitchopt.planners.timing.flight_curves import MOVES, Flight, moving
from hitchopt.planners.timing.fly_path import FINEST, MODEL_ERROR, fly
from hitchopt.requirements import Requirements
from hitchopt.trajectory import PiecewisePolynomial, joined

PLACES = np.array([0.21, 0.5, 0.79])
"""Places in a piece where its polynomials are compared with the model."""

PROBES = 65
"""Number of points of a path at which it is determined which drones its law moves."""


@dataclass(frozen=True, eq=False)
class Flying:
    """The flight of an action, and which drones move in it.

    Attributes
    ----------
    flight: None where nothing moves.
    turning: names of the drones beyond the named ones that the action's own law moves.
    sliding: names of those that move only because its law could not be kept.
    worst: s where the law broke a limit on the path, or None.
    """

    flight: Flight | None
    turning: tuple[str, ...] = ()
    sliding: tuple[str, ...] = ()
    worst: float | None = None


@dataclass(frozen=True, eq=False)
class ActionFlight:
    """The planner of an action, further cables sliding where a limit binds on the path.

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

    @property
    def problem(self) -> Clearance:
        """The path that is flown, and where the action's own law breaks a limit on it.

        Raises InfeasibleError as that of StraightMorph.
        """
        path = self.action.path(self.end)
        _check_outline(path)
        clear = cleared(path, self.requirements, at_rest=self.action.seconds is not None)
        check_shapes(clear.path)
        check_loads(clear.path, self.requirements.limits)
        return clear

    def solve(self) -> Flying:
        """Return the flight to ``end``; errors as of StraightMorph."""
        start, seconds = self.action.start, self.action.seconds
        if seconds is None and np.max(np.abs(self.end.drones - start.drones)) < MOVES:
            return Flying(None)
        clear = self.problem
        if seconds is None:
            flight = fly(clear.path, self.requirements.limits, self.duration)
        else:
            flight = fly_timed(clear.path, seconds)
        names = np.array(start.team.drone_names)
        own = _moved_by_law(self.action)
        further = moving(flight.drones) & ~np.isin(names, self.action.named)
        turning, sliding = (tuple(names[further & some].tolist()) for some in (own, ~own))
        return Flying(flight, turning, sliding, clear.worst)


def _check_outline(path: ShapePath) -> None:
    """Raise InfeasibleError where no leg lengths make the path one of hitches."""
    try:
        check_shapes(path)
    except InfeasibleError as error:
        slack = np.sum(shapes_along(path, np.linspace(0.0, 1.0, PROBES)).legs, axis=-1)
        if error.violations[0].constraint != "legs" or np.min(slack) < 2.0 * SHORTEST_LEG:
            raise


def _moved_by_law(action: Action) -> NDArray[np.bool_]:
    """Return which drones (2n,) the action's own law moves, whether or not it can be kept."""
    s = np.linspace(0.0, 1.0, PROBES)
    places = drones_along(action.path(), s).positions[..., 0]
    away = np.linalg.norm(places - places[:1], axis=-1)
    moved: NDArray[np.bool_] = np.max(away, axis=0) > MOVES
    return moved


def fly_timed(path: ShapePath, seconds: float) -> Flight:
    """Return the flight on which the path's s is time over ``seconds`` [s].

    Pieces of the vertices' path stay apart, so that no polynomial smooths over a joint of them.
    """
    parts = [_on_piece(path, i) for i in range(path.vertices.pieces)]
    drones, vertices, legs = (joined(list(kind)) for kind in zip(*parts, strict=True))
    tensions = PiecewisePolynomial.constant(drones.breaks, path.team.tension)
    return Flight(drones, vertices, legs, tensions).lasting(seconds)


def _on_piece(path: ShapePath, piece: int) -> list[PiecewisePolynomial]:
    """Return drones, vertices and legs over s on one piece, halved until they fit the model."""
    track = path.vertices.taken(slice(piece, piece + 1))
    own = replace(path, vertices=track)
    count = 1
    while True:
        breaks = np.linspace(track.breaks[0], track.breaks[1], count + 1)
        parts = [polynomials_through(breaks, jets) for jets in path_jets(own, breaks)[:3]]
        probes = (breaks[:-1, None] + np.diff(breaks)[:, None] * PLACES).reshape(-1)
        drones, _, legs = (
            np.max(np.abs(part.at(probes) - jets[..., 0]))
            for part, jets in zip(parts, path_jets(own, probes), strict=False)
        )
        error = 2.0 * drones + legs
        if count >= FINEST or error <= MODEL_ERROR * np.min(path.team.cable_length):
            return parts
        count *= 2
