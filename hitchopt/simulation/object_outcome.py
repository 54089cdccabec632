"""Outcome of a flight for the objects: where each ends, and how well it was held on the way."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from hitchopt.geometry.vectors import length
from hitchopt.objects import SolidObject
from hitchopt.simulation.flight_records import Flight

Array = NDArray[np.float64]

PLACED, TILTED = 0.03, 5.0
"""Largest distance [m] of an object from where the plan puts it down, and largest angle [°] to its
planned attitude."""

DROPPED = 0.05
"""Depth below its planned height from which on a carried object is dropped [m]."""

JUDGED = 0.2
"""Time over which it is judged whether an object is free [s]."""


@dataclass(frozen=True)
class ObjectState:
    """State of one object after the rest, and how it was held.

    Attributes
    ----------
    name: of the object.
    placed: distance of its base from the plan's [m].
    tilted: angle of its axis from the vertical [°].
    turned: difference of its yaw from the plan's [°].
    lifted: mean height over the plan's while the hitch carries all of it [m]; nan if never.
    slipped: largest movement relative to the hitch while that carries all of it [m]; nan if never.
    dropped: time at which it was first DROPPED below its plan while carried [s]; nan if never.
    free: whether no cable touches it.
    round: whether it looks the same however it is turned, which is not judged then.
    """

    name: str
    placed: float
    tilted: float
    turned: float
    lifted: float
    slipped: float
    dropped: float
    free: bool
    round: bool = False

    @property
    def well_placed(self) -> bool:
        """Whether it is where the plan puts it, and upright."""
        turned = 0.0 if self.round else abs(self.turned)
        return self.placed <= PLACED and max(self.tilted, turned) <= TILTED


def object_states(flight: Flight) -> tuple[ObjectState, ...]:
    """Return the states of all objects that can move, at the end of the rest or of the record."""
    task, record, cargo = flight.task, flight.record, flight.task.cargo
    if not cargo.movable.any():
        return ()
    end = flight.rested if np.isfinite(flight.rested) else record.t[-1]
    last = int(np.searchsorted(record.t, end + 1e-9, side="right")) - 1
    rows = np.array([task.index(t) for t in record.t[: last + 1]], dtype=np.intp)
    poses, plan = record.poses[: last + 1], cargo.poses[rows]
    offsets = poses[..., :3] - plan[..., :3]
    hitch = _hitch_offset(flight, rows)
    recent = record.t[: last + 1] > end - JUDGED
    found = []
    for i in np.flatnonzero(cargo.movable):
        carried = cargo.carried[rows, i]
        turn = Rotation.from_quat(poses[-1, i, 3:], scalar_first=True)
        axes = turn.as_matrix()
        yaw = np.arctan2(axes[1, 0], axes[0, 0]) - np.arctan2(plan[-1, i, 4], plan[-1, i, 3])
        slips = _slips(offsets[:, i] - hitch, carried)
        low = np.flatnonzero(carried & (offsets[:, i, 2] < -DROPPED))
        found.append(
            ObjectState(
                cargo.names[i],
                placed=float(length(offsets[-1, i])),
                tilted=float(np.degrees(np.arccos(np.clip(axes[2, 2], -1.0, 1.0)))),
                turned=float(np.degrees(np.arctan2(np.sin(yaw), np.cos(yaw)))),
                lifted=float(np.mean(offsets[carried, i, 2])) if carried.any() else np.nan,
                slipped=float(np.max(slips)) if len(slips) else np.nan,
                dropped=float(record.t[low[0]]) if low.size else np.nan,
                free=not bool(record.touched[: last + 1][recent, i].any()),
                round=_looks_round(cargo.objects[cargo.names[i]]),
            )
        )
    return tuple(found)


def _slips(offsets: Array, carried: NDArray[np.bool_]) -> Array:
    """Return how far it has moved from where it was as it was lifted, whenever it is carried [m].

    Parameters
    ----------
    offsets: (samples, 3) [m], from the hitch; nan where there is none.
    carried: (samples,), whether the hitch carries all of it.
    """
    chosen = np.flatnonzero(carried & np.isfinite(offsets[:, 0]))
    times = np.split(chosen, np.flatnonzero(np.diff(np.cumsum(~carried)[chosen])) + 1)
    return np.concatenate([length(offsets[run] - offsets[run[:1]]) for run in times])


def _looks_round(body: SolidObject) -> bool:
    """Return whether an object looks the same however it is turned."""
    sections = [body.section] if body.rim is None else [body.section, body.rim.section]
    return all(each.radius is not None for each in sections)


def _hitch_offset(flight: Flight, rows: NDArray[np.intp]) -> Array:
    """Return the mean offset of the vertices from their plan (samples, 3) [m]; nan without all."""
    planned = flight.task.vertices[rows][:, flight.task.team.layout.clasps]
    offset: Array = np.mean(flight.record.vertices[: len(rows)] - planned, axis=1)
    return offset
