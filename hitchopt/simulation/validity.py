"""Validity of a simulation: MuJoCo itself reports nothing when ropes pass through each other."""

from __future__ import annotations

import numpy as np

from hitchopt.errors import HitchoptError
from hitchopt.simulation.mujoco_world import World
from hitchopt.values import Array

MOST_STRAIN = 0.02
"""Largest relative change of a segment's length; beyond it the time step is too long."""

MOST_PENETRATION = 0.3
"""Largest penetration over the diameter; ropes that press deeper are about to pass each other."""


class InvalidRunError(HitchoptError):
    """A simulation that has left the range in which it is meaningful.

    Attributes
    ----------
    quantity: ``strain``, ``penetration``, ``tension`` or ``state`` (MuJoCo's own warnings).
    value: its value; nan for a state.
    time: [s], from the flight's start; negative while the cables settle.
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
    """Return (edges,) [N]: the tension of every segment, in the order of ``edge_cables``."""
    found: Array = -world.data.efc_force[: len(world.edge_cables)]
    return found


def check_valid(world: World, time: float) -> None:
    """Check that the last step is meaningful.

    Parameters
    ----------
    world: simulated world, after a step.
    time: [s], from the flight's start.

    Raises
    ------
    InvalidRunError: the state is not finite, or a limit is exceeded.
    """
    data, ropes = world.data, world.ropes
    if not np.all(np.isfinite(data.qpos)) or data.warning.number.any():
        raise InvalidRunError("state", float("nan"), 0.0, "", time, "all")
    finer = ropes.preset.time_step / world.model.opt.timestep
    strain = np.abs(world.strains)
    for quantity, values, limit, unit in (
        ("strain", strain, MOST_STRAIN, "m/m"),
        ("tension", tensions(world), finer**2 * ropes.largest_tension, "N"),
    ):
        worst = int(np.argmax(values))
        if values[worst] > limit:
            where = f"cable {world.edge_cables[worst]}"
            raise InvalidRunError(quantity, float(values[worst]), limit, unit, time, where)
    if not data.ncon:
        return
    flexes = data.contact.flex
    depth = np.where(np.all(flexes >= 0, axis=1), -data.contact.dist, 0.0)
    worst, limit = int(np.argmax(depth)), MOST_PENETRATION * ropes.preset.diameter
    if depth[worst] > limit:
        where = f"cables {flexes[worst][0]} and {flexes[worst][1]}"
        raise InvalidRunError("penetration", float(depth[worst]), limit, "m", time, where)
