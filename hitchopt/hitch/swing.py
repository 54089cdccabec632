"""Swing of a hitch: how far nodes are from a plan in which forces balance as they do at rest.

Cables and loads have inertia, for which planned drones do not allow. About planned rests, nodes are
displaced by u from their planned places p:

    M ü + C u̇ + K u = -m p̈.

K is the Hessian of the hitch's energy, with drones on the springs of their position loops. M are
the masses of all nodes, and m those of cables and loads alone: controllers add the drones' own
inertia, and planned forces that of held bodies. Spans have consistent masses, as finite elements: a
third of a span's mass at each end and a sixth across. C is the damping of position loops, and of
clasps in air. The model is linear, so its error is of second order in the displacements. Friction,
which holds vertices back and damps, is omitted, as are errors of drones that follow their setpoints
late.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from hitchopt.drones.controllers import STOCK
from hitchopt.drones.quadrotor import GRAVITY
from hitchopt.hitch.energy import HitchEnergy, energy_of
from hitchopt.hitch.rest_errors import loops_of
from hitchopt.hitch.team import Team
from hitchopt.values import Array, Indices

CLASP_DECAY = 1.0
"""[1/s] Rate at which air slows clasps down, as in simulated flights with clasps."""

SPAN_MASSES = np.array([[2.0, 1.0], [1.0, 2.0]]) / 6.0
"""Consistent masses of a straight span at and across its ends, over its mass."""


@dataclass(frozen=True, eq=False)
class LinearHitch:
    """A hitch near J rests, linear in the displacements of its nodes, with N = 3 nodes axes."""

    stiffness: Array  # (J, N, N) [N/m], K
    damping: Array  # (J, N) [N s/m], the diagonal of C
    masses: Array  # (J, N, N) [kg], M
    inertia: Array  # (J, nodes, nodes) [kg], m on each axis
    points: Indices  # (points,), node of each point

    @classmethod
    def of(cls, team: Team, rests: Mapping[str, Array], held: Array) -> LinearHitch:
        """Return the hitch near rests (J, …), see ``planned_rest``.

        ``held`` (J, clasps) are the masses of held bodies at the clasps [kg].
        """
        energy = energy_of(team, loops_of(team), rests)
        clasps = energy.points[team.layout.clasps]
        energy.loads[:, clasps, 2] -= GRAVITY * held
        nodes = energy.at_rest()
        stiffness = energy.matrix(nodes, energy.linear(nodes).forces)
        inertia = _span_masses(energy, nodes, team.cable_density)
        inertia[:, clasps, clasps] += team.load
        masses = inertia.copy()
        masses[:, clasps, clasps] += held
        damping = np.zeros(nodes.shape)
        damping[:, clasps] = CLASP_DECAY * np.sum(masses, axis=2)[:, clasps, None]
        masses[:, : energy.drones, : energy.drones] += np.diag(team.mass)
        stiffest = STOCK["mellinger"].stiffest[1] * team.mass[:, None]
        damping[:, : energy.drones] = np.where(np.isinf(team.damping), stiffest, team.damping)
        on_axes = np.einsum("jab,xy->jaxby", masses, np.eye(3))
        return cls(
            stiffness,
            damping.reshape(len(nodes), -1),
            on_axes.reshape(stiffness.shape),
            inertia,
            energy.points,
        )

    def response(self, samples: Indices, accelerations: Array, step: float) -> Array:
        """Return displacements u (S, nodes, 3) [m] of nodes, which are at rest before.

        Newmark's method with average accelerations: of second order in the step, stable for any
        step, and without numerical damping.

        Parameters
        ----------
        samples: (J,), number of samples near each rest, in order of time; S in all.
        accelerations: p̈ (S, nodes, 3) [m/s²].
        step: time between samples [s].
        """
        size = self.stiffness.shape[1]
        damping = np.eye(size) * self.damping[:, None]
        quarter = 0.25 * step**2
        inverses = np.linalg.inv(self.masses + 0.5 * step * damping + quarter * self.stiffness)
        by_states = inverses @ np.concatenate([self.stiffness, damping], axis=2)  # (J, N, 2N)
        displacements = np.zeros((len(accelerations), size))
        state = np.zeros(2 * size)  # u, then its rate
        place, rate = state[:size], state[size:]
        acceleration = np.zeros(size)
        sample = 0
        for rest, count in enumerate(samples.tolist()):
            forces = -self.inertia[rest] @ accelerations[sample : sample + count]
            by_forces = forces.reshape(count, size) @ inverses[rest].T
            for by_force in by_forces:
                rate += 0.5 * step * acceleration
                place += step * rate - quarter * acceleration
                acceleration = by_force - by_states[rest] @ state
                place += quarter * acceleration
                rate += 0.5 * step * acceleration
                displacements[sample] = place
                sample += 1
        return displacements.reshape(accelerations.shape)


def _span_masses(energy: HitchEnergy, nodes: Array, density: float) -> Array:
    """Return consistent masses (J, nodes, nodes) [kg] of cables with nodes (J, nodes, 3) [m]."""
    lengths = energy.spans(nodes[:, energy.nodes]).lengths  # (J, n, 3)
    masses = np.zeros((*nodes.shape[:2], nodes.shape[1]))
    for span in range(3):
        ends = energy.nodes[:, span : span + 2]  # (n, 2)
        shares = density * lengths[:, :, span, None, None] * SPAN_MASSES
        rows, columns = np.broadcast_arrays(ends[:, :, None], ends[:, None, :])
        np.add.at(masses.transpose(1, 2, 0), (rows, columns), np.moveaxis(shares, 0, -1))
    return masses
