"""Whether a run still means anything: MuJoCo itself stays silent when ropes pass each other."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import HitchoptError
from hitchopt.simulation.mujoco_world import World

Array = NDArray[np.float64]

MOST_STRAIN = 0.02
"""Relative; a rope that stretches more has been torn at harder than its time step bears."""

MOST_PENETRATION = 0.3
"""Of the diameter; ropes that press deeper are about to pass each other."""


class InvalidRunError(HitchoptError):
    """A simulation that has left the range in which it means anything.

    Attributes
    ----------
    quantity: ``strain``, ``penetration``, ``tension`` or ``state`` (MuJoCo's own warnings).
    value: what it was; nan of a state.
    time: [s], from the flight's start; negative while it settles.
    where: names of cables.
    """

    def __init__(
        self, quantity: str, value: float, limit: float, unit: str, time: float, where: str
    ) -> None:
        self.quantity = quantity
        self.value = value
        self.time = time
        self.where = where
        broken = (
            "its state is no longer finite"
            if quantity == "state"
            else f"{quantity} of {value:.4g} {unit} is beyond {limit:.4g} {unit} at {where}"
        )
        super().__init__(
            f"simulation: {broken}, t = {time:.3f} s: ropes may have passed each other; take a "
            "finer preset or a shorter time step, or fly more gently"
        )


def tensions(world: World) -> Array:
    """Return (edges,) [N]: the pull in every segment, in the order of ``edge_cables``."""
    found: Array = -world.data.efc_force[: len(world.edge_cables)]
    return found


def check_valid(world: World, time: float) -> None:
    """Raise InvalidRunError if the last step is not to be believed.

    Parameters
    ----------
    world: after a step.
    time: [s], from the flight's start.
    """
    data, model = world.data, world.model
    if not np.all(np.isfinite(data.qpos)) or data.warning.number.any():
        raise InvalidRunError("state", float("nan"), 0.0, "", time, "all")
    strain = np.abs(data.flexedge_length / model.flexedge_length0 - 1.0)
    worst = int(np.argmax(strain))
    if strain[worst] > MOST_STRAIN:
        where = f"cable {world.edge_cables[worst]}"
        raise InvalidRunError("strain", float(strain[worst]), MOST_STRAIN, "m/m", time, where)
    pull = tensions(world)
    worst = int(np.argmax(pull))
    if pull[worst] > world.ropes.largest_tension:
        where = f"cable {world.edge_cables[worst]}"
        limit = world.ropes.largest_tension
        raise InvalidRunError("tension", float(pull[worst]), limit, "N", time, where)
    if not data.ncon:
        return
    flexes = data.contact.flex
    depth = np.where(np.all(flexes >= 0, axis=1), -data.contact.dist, 0.0)
    worst = int(np.argmax(depth))
    limit = MOST_PENETRATION * world.ropes.preset.diameter
    if depth[worst] > limit:
        where = f"cables {flexes[worst][0]} and {flexes[worst][1]}"
        raise InvalidRunError("penetration", float(depth[worst]), limit, "m", time, where)
