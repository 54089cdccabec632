"""The flight of an action to the hitch that it ends with."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import InfeasibleError
from hitchopt.hitch import Hitch
from hitchopt.planners.actions.action import Action
from hitchopt.planners.actions.sliding import cleared
from hitchopt.planners.actions.timed import fly_timed
from hitchopt.planners.path.path_feasibility import SHORTEST_LEG, check_loads, check_shapes
from hitchopt.planners.path.shape_path import ShapePath, drones_along, shapes_along
from hitchopt.planners.timing.flight_curves import MOVES, Flight, moving
from hitchopt.planners.timing.fly_path import fly
from hitchopt.requirements import Requirements

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


def fly_action(
    action: Action, end: Hitch, requirements: Requirements, duration: float | None = None
) -> Flying:
    """Return the flight to ``end``, further cables sliding where a limit binds on the path.

    Parameters
    ----------
    action: what moves, and by which law.
    end: the hitch after it; its legs may differ from those that the law keeps.
    requirements: limits and distances.
    duration: exactly that long [s]; None for as fast as the limits allow.

    Raises
    ------
    InfeasibleError, TimingError, WarpError: as straight_morph.
    """
    start, timed = action.start, action.seconds is not None
    if not timed and np.max(np.abs(end.drones - start.drones)) < MOVES:
        return Flying(None)
    path = action.path(end)
    _check_outline(path)
    clear = cleared(path, requirements, at_rest=timed)
    check_shapes(clear.path)
    check_loads(clear.path, requirements.limits)
    flight: Flight = (
        fly(clear.path, requirements.limits, duration)
        if action.seconds is None
        else fly_timed(clear.path, action.seconds)
    )
    names = np.array(start.team.drone_names)
    own = _moved_by_law(action)
    further = moving(flight.drones) & ~np.isin(names, action.named)
    return Flying(
        flight,
        tuple(names[further & own].tolist()),
        tuple(names[further & ~own].tolist()),
        clear.worst,
    )


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
