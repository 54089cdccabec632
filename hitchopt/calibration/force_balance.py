"""Linear balance of forces at clasps and drones, in the tensions of legs and edges.

Friction makes the tensions of a cable's legs and edge differ, therefore each part has its own. All
windows are treated at once as a sparse system; its size is linear in windows times robots.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array

from hitchopt.calibration.flight_windows import Windows
from hitchopt.hitch import GRAVITY, Team
from hitchopt.hitch.cable_parts import CableParts
from hitchopt.values import Array

Index = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class ForceBalance:
    """Forces on clasps and drones at measured places, as functions of the parts' tensions.

    The unknowns of a window are the tensions of the n edges, then those of the legs, q0, r0, q1, …
    as far as there are legs; those of windows follow each other.

    Attributes
    ----------
    windows: where it was measured, and what was commanded there.
    parts: legs and edges.
    clasps: sparse (windows · clasps · 3, unknowns), forces of unit tensions on the clasps.
    weights: (windows · clasps · 3,) [N], weight of cables and loads that clasps carry.
    leg_unknown: (2n,), unknown that pulls at each drone, within its window.
    outward: (windows, 2n, 3), directions from the points that cables lead to.
    hanging: (windows, 2n, 3) [N], weight of the cables that drones carry.
    """

    windows: Windows
    parts: CableParts
    clasps: csr_array
    weights: Array
    leg_unknown: Index
    outward: Array
    hanging: Array

    @property
    def per_window(self) -> int:
        """Number of unknowns of a window."""
        return int(np.max(self.leg_unknown)) + 1

    @classmethod
    def of(cls, team: Team, windows: Windows, density: float) -> ForceBalance:
        """Return the balance at measured windows, of cables of a density [kg/m]."""
        layout, n, count = team.layout, team.robots, len(windows.t)
        parts = CableParts.of(team, windows.drones, windows.vertices)
        has_leg = layout.has_leg.ravel()
        leg_unknown = np.repeat(np.arange(n), 2)
        leg_unknown[has_leg] = n + np.arange(np.sum(has_leg))
        per_window = n + int(np.sum(has_leg))
        after, before = layout.ahead, layout.behind
        q, r = 2 * after, 2 * before + 1
        columns = np.stack([leg_unknown[q], after, leg_unknown[r], before], axis=-1)
        forces = np.stack(
            [
                parts.outward[:, q],
                parts.along[:, after],
                parts.outward[:, r],
                -parts.along[:, before],
            ],
            axis=-2,
        )  # (windows, clasps, 4, 3)
        clasps = len(after)
        w, c, _, axis = np.indices(forces.shape)
        rows = (w * clasps + c) * 3 + axis
        at = w * per_window + columns[None, :, :, None]
        shape = (count * clasps * 3, count * per_window)
        matrix = coo_array((forces.ravel(), (rows.ravel(), at.ravel())), shape=shape).tocsr()
        half = 0.5 * GRAVITY * density
        carried = half * (
            parts.legs[:, q] + parts.edges[:, after] + parts.legs[:, r] + parts.edges[:, before]
        )
        weights = np.zeros((count, clasps, 3))
        weights[..., 2] = carried + GRAVITY * team.load
        own = np.where(has_leg, parts.legs, np.repeat(parts.edges, 2, axis=-1))
        hanging = np.zeros_like(windows.drones)
        hanging[..., 2] = half * own
        return cls(windows, parts, matrix, weights.ravel(), leg_unknown, parts.outward, hanging)

    def first_guess(self) -> Array:
        """Return the planned tensions as unknowns (windows · per_window,) [N]."""
        n = self.windows.tensions.shape[1]
        guess = np.zeros((len(self.windows.t), self.per_window))
        guess[:, :n] = self.windows.tensions
        guess[:, self.leg_unknown] = np.repeat(self.windows.tensions, 2, axis=-1)
        return guess.ravel()

    def leg_pulls(self) -> csr_array:
        """Return sparse (windows · 2n · 3, unknowns): forces of unit tensions on the drones."""
        count, drones, _ = self.outward.shape
        w, d, axis = np.indices(self.outward.shape)
        rows = (w * drones + d) * 3 + axis
        columns = w * self.per_window + self.leg_unknown[None, :, None]
        columns = np.broadcast_to(columns, rows.shape)
        shape = (count * drones * 3, count * self.per_window)
        entries = (-self.outward.ravel(), (rows.ravel(), columns.ravel()))
        return coo_array(entries, shape=shape).tocsr()

    def surplus(self, feed_forward: NDArray[np.bool_]) -> Array:
        """Return (windows, 2n, 3) [N]: weight on the drones less what controllers know of cables.

        The forces of the legs come on top of it.
        """
        known = np.where(feed_forward[:, None], self.windows.cable_forces, 0.0)
        surplus: Array = -self.hanging - known
        return surplus
