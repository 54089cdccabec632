"""Motions whose legs pull more or less than their edges, as friction allows."""

from __future__ import annotations

import numpy as np

from hitchopt.motion.motion import Motion
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.trajectory.piecewise import divided, on_breaks
from hitchopt.values import Array

PARTS = 8  # Pieces in place of one
STEP = 0.02  # [s] Step of differences


def leaning(motion: Motion, slip: float) -> Motion:
    """Return the motion of a level, weightless hitch with other pulls of legs in between.

    Those of q are larger by up to ``exp(slip)``, those of r smaller; vertices, legs and edges are
    the same. Ends of a chain pull as their cables.
    """
    team, layout = motion.team, motion.team.layout
    breaks = divided(motion.drones.breaks, np.full(motion.drones.pieces, PARTS))
    q, r = 2 * layout.ahead, 2 * layout.behind + 1

    def at(t: Array) -> tuple[Array, Array]:
        """Return drones (J, 2n, 3) [m] and pulls (J, n, 2) [N]."""
        inner = np.clip(t, 0.0, motion.duration)
        vertices, drones = motion.vertices.at(inner), motion.drones.at(inner)
        tensions = motion.tensions.at(inner)
        pulls = np.repeat(tensions, 2, axis=1)
        size = slip * np.sin(np.pi * inner / motion.duration)[:, None] ** 4
        pulls[:, q] *= np.exp(size)
        pulls[:, r] *= np.exp(-size)
        edges = vertices[:, layout.ends] - vertices[:, layout.starts]
        edges *= (tensions / np.linalg.norm(edges, axis=-1))[..., None]
        held = (edges[:, layout.behind] - edges[:, layout.ahead]) @ [1.0, 1j, 0.0]
        clasps = vertices[:, layout.clasps]
        for own, other in ((q, r), (r, q)):
            before = (drones[:, own] - clasps) @ [1.0, 1j, 0.0]
            a, b, c = pulls[:, own], pulls[:, other], np.abs(held)
            turn = np.arccos((a**2 + c**2 - b**2) / (2.0 * a * c))
            side = np.sign(np.angle(before / held))
            after = np.abs(before) * np.exp(1j * side * turn) * held / c
            drones[:, own, :2] = clasps[..., :2] + np.stack([after.real, after.imag], axis=-1)
        return drones, pulls.reshape(len(t), team.robots, 2)

    places = breaks[:, None] + STEP * np.arange(-2, 3)
    drones, pulls = (
        PiecewisePolynomial.through_jets(breaks, _jets(x.reshape(*places.shape, *x.shape[1:])))
        for x in at(places.ravel())
    )
    return motion.replaced(
        drones=drones,
        leg_tensions=pulls,
        **{name: on_breaks(getattr(motion, name), breaks) for name in ("vertices", "legs")},
        tensions=on_breaks(motion.tensions, breaks),
    )


def _jets(x: Array) -> Array:
    """Return values and three derivatives (J, …, 4) from samples (J, 5, …) around each time."""
    a, b, c, d, e = np.moveaxis(x, 1, 0)
    first = (a - 8.0 * b + 8.0 * d - e) / (12.0 * STEP)
    second = (-a + 16.0 * b - 30.0 * c + 16.0 * d - e) / (12.0 * STEP**2)
    third = (-a + 2.0 * b - 2.0 * d + e) / (2.0 * STEP**3)
    return np.stack([c, first, second, third], axis=-1)
