"""What became of a team one of whose drones' motors stopped in flight."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hitchopt.one_line import OneLine
from hitchopt.simulation.flight_records import Flight, Touch
from hitchopt.simulation.mujoco_xml import BODY_HALF_HEIGHT
from hitchopt.simulation.simulation_settings import Loss

SETTLED = 0.5
"""[s] Time at the end of a flight over which it is judged what hangs."""


@dataclass(frozen=True)
class LossOutcome(OneLine):
    """What became of a team after a loss, in a simulated flight.

    Attributes
    ----------
    drone, time: the loss.
    among: contacts of two survivors.
    others: contacts of survivors with cables or with the lost drone.
    peak_tension: largest tension of any cable from the loss on [N].
    peak_thrust: largest thrust of a survivor from the loss on [N].
    moved: largest distance of a survivor from its setpoint from the loss on [m].
    dropped: height by which the lost drone is lower at the end than when it was lost [m].
    hangs: its mean height over the ground at the end [m]; 0.005 m and less where it lies there.
    linked: clasps whose cables are linked at the end, by name.
    """

    drone: str
    time: float
    among: tuple[Touch, ...]
    others: tuple[Touch, ...]
    peak_tension: float
    peak_thrust: float
    moved: float
    dropped: float
    hangs: float
    linked: tuple[str, ...]

    @property
    def apart(self) -> bool:
        """Whether no two survivors touch."""
        return not self.among


def loss_outcome(flight: Flight, loss: Loss) -> LossOutcome:
    """Return what became of a flight's team after a loss."""
    record, team = flight.record, flight.task.team
    lost = team.drone_names.index(loss.drone)
    after = record.t >= loss.time - 1e-9
    after[-1] = True
    survivors = np.arange(team.drones) != lost
    names = set(team.drone_names)
    late = [touch for touch in flight.touches if touch.time >= loss.time - 1e-9]
    among, others = [], []
    for touch in late:
        pair = {touch.first, touch.second}
        if pair <= names - {loss.drone}:
            among.append(touch)
        elif pair & (names - {loss.drone}):
            others.append(touch)
    off = np.linalg.norm(record.drones - record.commanded, axis=-1)[after][:, survivors]
    heights = record.drones[:, lost, 2]
    end = heights[record.t > record.t[-1] - SETTLED]
    linked: tuple[str, ...] = ()
    if flight.linking is not None:
        layout = team.layout
        found = np.abs(flight.linking[layout.behind, layout.ahead]) == 1
        linked = tuple(team.point_names[point] for point in layout.clasps[found])
    return LossOutcome(
        loss.drone,
        loss.time,
        tuple(among),
        tuple(others),
        float(np.max(record.peak_tensions[after])),
        float(np.max(record.thrusts[after][:, survivors])),
        float(np.max(off)),
        float(heights[np.flatnonzero(after)[0]] - end[-1]),
        float(np.mean(end)) - flight.ground - BODY_HALF_HEIGHT,
        linked,
    )
