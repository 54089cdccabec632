"""What a picture, a film or a page shows of a plan over time: drones, cables, forces.

Everything that draws in three dimensions draws a ``Scene``, so that all of them show the same.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from hitchopt.motion.motion import Motion
from hitchopt.motion.states import States, states_at
from hitchopt.values import Array
from hitchopt.view.cable_curves import POINTS, THICKNESS, CableCurves, cable_curves

SAMPLES = 1_000_000
"""Largest number of coordinates of drones and cables in a scene, unless FEWEST needs more."""

FEWEST = 48
"""Least number of times over a plan, besides the ends of its phases."""

RATE = 30.0
"""Largest number of times a second [Hz]."""

PER_DRONE = 11
"""Numbers that a scene has of a drone at a time."""

CONCERNED = re.compile(r"(?:cable |[qr]-leg |edge |[cpqrd])(\d+)")
"""Names in ``where`` of a check that stand for something in the scene."""


@dataclass(frozen=True, eq=False)
class Scene:
    """Samples of a plan over time.

    Attributes
    ----------
    motion: the plan.
    t: (times,) [s], from its start; the ends of all phases among them.
    drones: positions (times, N, 3) [m].
    quaternions: attitudes (times, N, 4), w, x, y, z.
    thrusts: (times, N) [N].
    cable_forces: (times, N, 3) [N], on the drones.
    cables: (times, n, POINTS, 3) [m].
    objects: (times, objects, 7): places of their bases [m], and quaternions.
    radius: of drawn cables [m].
    """

    motion: Motion
    t: Array
    drones: Array
    quaternions: Array
    thrusts: Array
    cable_forces: Array
    cables: Array
    objects: Array
    radius: float

    def at(self, time: float) -> Moment:
        """Return the scene at a time [s], interpolated between its samples."""
        i = int(np.clip(np.searchsorted(self.t, time, side="right"), 1, len(self.t) - 1))
        share = float(np.clip((time - self.t[i - 1]) / (self.t[i] - self.t[i - 1]), 0.0, 1.0))
        return Moment(
            *(
                (1.0 - share) * getattr(self, field.name)[i - 1]
                + share * getattr(self, field.name)[i]
                for field in fields(Moment)
            )
        )


@dataclass(frozen=True, eq=False)
class Moment:
    """A scene at one time; shapes as in ``Scene``, without that of the times."""

    drones: Array
    quaternions: Array
    thrusts: Array
    cable_forces: Array
    cables: Array
    objects: Array


def scene_of(motion: Motion, samples: int = SAMPLES) -> Scene:
    """Return the scene of a plan.

    Parameters
    ----------
    motion: the plan.
    samples: largest number of coordinates, by which the number of times follows from the team.
    """
    return scene_at(motion, scene_times(motion, samples))


def scene_at(motion: Motion, t: Array, thickness: float = THICKNESS) -> Scene:
    """Return the scene of a plan at ascending times (times,) [s].

    Parameters
    ----------
    motion: the plan.
    t: the times.
    thickness: radius of a drawn cable as a share of the scene's extent.
    """
    states = states_at(motion, t)
    curves = cable_curves(motion, states, thickness)
    return _scene(motion, states, curves)


def extent_points(scene: Scene) -> Array:
    """Return points (times, m, 3) [m] that a picture of a scene has to show.

    They are the drones, the places on the ground below them, and boxes around the objects.
    """
    floor = scene.drones * [1.0, 1.0, 0.0] + [0.0, 0.0, scene.motion.requirements.floor]
    points = [scene.drones, floor]
    for i, body in enumerate(scene.motion.requirements.objects.values()):
        reach = body.circumradius
        for z in (body.lower, body.upper):
            corners = [[x, y, z] for x in (-reach, reach) for y in (-reach, reach)]
            points.append(scene.objects[:, i, None, :3] + corners)
    return np.concatenate(points, axis=1)


def scene_times(motion: Motion, samples: int = SAMPLES) -> Array:
    """Return times (times,) [s] over a plan: even ones, and the ends of its phases."""
    team = motion.team
    each = PER_DRONE * len(team.drone_names) + 3 * POINTS * team.robots
    count = int(np.clip(samples // each, FEWEST, RATE * motion.duration + 2))
    ends = [phase.end for phase in motion.phases]
    times = np.concatenate([np.linspace(0.0, motion.duration, count), ends])
    return np.unique(np.clip(np.round(times, 6), 0.0, motion.duration))


def _scene(motion: Motion, states: States, curves: CableCurves) -> Scene:
    return Scene(
        motion,
        states.t,
        states.positions,
        states.quaternions,
        np.linalg.norm(states.thrusts(motion.team), axis=-1),
        states.cable_forces,
        curves.points,
        _upright(states.object_poses),
        curves.radius,
    )


def _upright(poses: Array) -> Array:
    """Return places and quaternions (times, objects, 7) of poses (times, objects, 5)."""
    half = 0.5 * np.unwrap(np.arctan2(poses[..., 4], poses[..., 3]), axis=0)[..., None]
    return np.concatenate([poses[..., :3], np.cos(half), 0.0 * half, 0.0 * half, np.sin(half)], -1)


@dataclass(frozen=True)
class Concerned:
    """Indices of what a check names: drones, cables and vertices."""

    drones: tuple[int, ...] = ()
    cables: tuple[int, ...] = ()
    vertices: tuple[int, ...] = ()


def concerned(motion: Motion, where: Sequence[str]) -> Concerned:
    """Return what the names in ``where`` of a check stand for; others are ignored."""
    index = {name: i for i, name in enumerate(motion.team.drone_names)}
    found: dict[str, set[int]] = {"drones": set(), "cables": set(), "vertices": set()}
    for name in where:
        match = CONCERNED.fullmatch(name)
        if match is None:
            continue
        k = int(match[1])
        if name in index:
            found["drones"].add(index[name])
        elif name.startswith("p"):
            found["vertices"].add(k)
        else:
            found["cables"].add(k)
            if "-leg" in name:
                found["drones"].add(index[f"{name[0]}{k}"])
    sorted_found: dict[str, Any] = {key: tuple(sorted(values)) for key, values in found.items()}
    return Concerned(**sorted_found)
