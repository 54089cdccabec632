"""Contacts of objects: with what may not touch them at the time, and with cables at all."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hitchopt.simulation.flight_cargo import Cargo
from hitchopt.simulation.mujoco_world import World

Index = NDArray[np.intp]

GROUND, DRONE, CABLE, OBJECT = range(4)
"""Kinds of things in contact."""


class ObjectContacts:
    """Contacts of the objects of a world.

    Parameters
    ----------
    world: simulated world.
    cargo: what the plan does with the objects.
    """

    def __init__(self, world: World, cargo: Cargo) -> None:
        self._world, self._cargo, self._aloft = world, cargo, cargo.aloft
        model = world.model
        kind_of = np.full(model.nbody, GROUND)
        rank_of = np.zeros(model.nbody, dtype=np.intp)
        cable = np.repeat(np.arange(len(world.ropes.lengths)), np.diff(world.cable_vertices))
        kind_of[model.flex_vertbodyid], rank_of[model.flex_vertbodyid] = CABLE, cable
        for kind, bodies in ((DRONE, world.drone_bodies), (OBJECT, world.object_bodies)):
            kind_of[bodies], rank_of[bodies] = kind, np.arange(len(bodies))
        self._kind, self._rank = kind_of[model.geom_bodyid], rank_of[model.geom_bodyid]
        drones = [f"{end}{k}" for k in range(len(world.ropes.lengths)) for end in "qr"]
        cables = [f"cable {k}" for k in range(len(world.ropes.lengths))]
        self._names = (["the ground"], drones, cables, cargo.names)

    def wrong(self, index: int) -> list[tuple[str, str]]:
        """Return what touches objects and should not, by name.

        Cables may touch the objects that the plan holds; objects that are aloft touch nothing else;
        drones touch nothing.

        Parameters
        ----------
        index: sample of the plan.
        """
        kinds, ranks = self._pairs()
        if not len(kinds):
            return []
        thing, other = ranks[:, 0], ranks[:, 1]
        held, aloft = self._cargo.held[index], self._aloft[index]
        above = aloft[thing] | ((kinds[:, 1] == OBJECT) & aloft[np.minimum(other, len(aloft) - 1)])
        cable = kinds[:, 1] == CABLE
        chosen = np.where(cable, ~held[thing], (kinds[:, 1] == DRONE) | above)
        found = np.unique(np.column_stack([kinds[:, 1], other, thing])[chosen], axis=0)
        return [(self._names[k][j], self._names[OBJECT][i]) for k, j, i in found]

    @property
    def cables(self) -> NDArray[np.bool_]:
        """Whether cables touch an object (objects,)."""
        touched = np.zeros(len(self._cargo.objects), dtype=np.bool_)
        kinds, ranks = self._pairs()
        touched[ranks[kinds[:, 1] == CABLE, 0]] = True
        return touched

    def _pairs(self) -> tuple[Index, Index]:
        """Return kinds and ranks (contacts, 2) of the objects in contact, and what touches them."""
        contact = self._world.data.contact
        geoms = contact.geom[np.all(contact.geom >= 0, axis=1) & (contact.efc_address >= 0)]
        kinds, ranks = self._kind[geoms], self._rank[geoms]
        with_objects = np.any(kinds == OBJECT, axis=1)
        kinds, ranks = kinds[with_objects], ranks[with_objects]
        order = np.argsort(kinds != OBJECT, axis=1, kind="stable")  # the object first
        return np.take_along_axis(kinds, order, 1), np.take_along_axis(ranks, order, 1)
