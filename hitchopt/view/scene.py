"""A plan over time as pictures, films and pages show it: drones, cables, forces, objects.

Everything that draws in three dimensions draws a ``Scene``, so that all of them show the same.
A ghost, beside a plan, is the scene of another plan or of a flight that was simulated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import FileError
from hitchopt.motion.motion import Motion
from hitchopt.motion.plan_file import read_plan
from hitchopt.motion.states import states_at
from hitchopt.storage.archive import BROKEN, PLAN, RECORDING, read_arrays
from hitchopt.values import Array
from hitchopt.view.cables import POINTS, THICKNESS, THINNEST, cable_curves
from hitchopt.view.shapes import Appearance

# Largest number of coordinates of drones and cables in a scene; least number of times, besides
# the ends of its phases, whatever that comes to; and most times a second [Hz]
SAMPLES, FEWEST, RATE = 1_000_000, 48, 30.0
PER_DRONE = 11  # Numbers that a scene has of a drone at a time
# Beginnings of names in ``where`` of a check that concern a cable
OF_CABLES = ("cable ", "edge ", "c", "q-leg ", "r-leg ")


@dataclass(frozen=True, eq=False)
class Moment:
    """Places and forces at a time; at many of them if all arrays have times before their axes."""

    drones: Array  # positions (N, 3) [m]
    quaternions: Array  # attitudes (N, 4), w, x, y, z
    thrusts: Array  # (N,) [N]
    cable_forces: Array  # (N, 3) [N], on the drones
    cables: Array  # (n, POINTS, 3) [m]
    objects: Array  # (objects, 7): places of their bases [m], and quaternions


@dataclass(frozen=True, eq=False)
class Scene(Moment):
    """Samples of a plan over time: the arrays of ``Moment`` (times, …)."""

    motion: Motion  # the plan, with limits, arena, keep-outs and objects
    t: Array  # (times,) [s], from its start; the ends of all phases among them
    radius: float  # of drawn cables [m]

    @cached_property
    def appearance(self) -> Appearance:
        """Names, colours and shapes of all that is drawn."""
        return Appearance.of(self.motion)

    def at(self, time: float) -> Moment:
        """Return the scene at a time [s], interpolated between its samples."""
        i = int(np.clip(np.searchsorted(self.t, time, side="right"), 1, len(self.t) - 1))
        share = float(np.clip((time - self.t[i - 1]) / (self.t[i] - self.t[i - 1]), 0.0, 1.0))
        every = [getattr(self, field.name) for field in fields(Moment)]
        return Moment(*((1.0 - share) * each[i - 1] + share * each[i] for each in every))


def scene_of(motion: Motion, samples: int = SAMPLES) -> Scene:
    """Return the scene of a plan at even times, and at the ends of its phases.

    ``samples`` is the largest number of coordinates, from which the number of times follows.
    """
    teams = [group.motion.team for group in motion.flying]
    each = sum(PER_DRONE * team.drones + 3 * POINTS * team.robots for team in teams)
    count = int(np.clip(samples // each, FEWEST, RATE * motion.duration + 2))
    ends = [phase.end for phase in motion.phases]
    times = np.concatenate([np.linspace(0.0, motion.duration, count), ends])
    return scene_at(motion, np.unique(np.clip(np.round(times, 6), 0.0, motion.duration)))


def scene_at(motion: Motion, t: Array, thickness: float = THICKNESS) -> Scene:
    """Return the scene of a plan at ascending times (times,) [s].

    ``thickness`` is the radius of a drawn cable as a share of the scene's extent. What others fly
    besides is part of it, at rest before and after.
    """
    begin, rows, radii = motion.drones.breaks[0], list[Any](), list[float]()
    poses = [motion.object_poses.at(begin + np.minimum(t, motion.duration))]
    for group in motion.flying:
        own, foreign = group.motion, group in motion.others
        since = np.clip(begin + t - own.drones.breaks[0], 0.0, own.duration)
        states = states_at(own, since)
        cables, radius = cable_curves(own, states, thickness)
        thrusts = np.linalg.norm(states.thrusts(own.team), axis=-1)
        rows.append((states.positions, states.quaternions, thrusts, states.cable_forces, cables))
        radii += [radius] * (own.team.has_cables or len(motion.flying) == 1)
        poses += [states.object_poses] * foreign
    at = np.concatenate(poses, axis=1)
    half = 0.5 * np.unwrap(np.arctan2(at[..., 4], at[..., 3]), axis=0)[..., None]
    turns = [np.cos(half), 0.0 * half, 0.0 * half, np.sin(half)]
    drones, attitudes, thrust, forces, curves = (
        np.concatenate(each, axis=1) for each in zip(*rows, strict=True)
    )
    objects, radius = np.concatenate([at[..., :3], *turns], axis=-1), min(radii, default=THINNEST)
    return Scene(drones, attitudes, thrust, forces, curves, objects, motion, t, radius)


def ghost_scene(path: Path, motion: Motion) -> Scene:
    """Return the scene of another plan, or of a simulated or evaluated flight of ``motion``.

    ``path`` is a recording or a plan, or the directory of either. It is a FileError if there is
    neither, if it is damaged, or if the flight is that of another team.
    """
    if path.is_dir():
        names = [name for name in (RECORDING, PLAN) if (path / name).exists()]
        if not names:
            raise FileError(f"{path}: holds neither {RECORDING} nor {PLAN}; name another directory")
        path = path / names[0]
    if path.name != RECORDING:
        return scene_of(read_plan(path))
    try:
        arrays = read_arrays(path, ("t", "nodes", "cables", "poses"))
    except BROKEN as error:
        raise FileError(f"{path}: not the recording of a flight: {error}") from error
    first, t = arrays["cables"], arrays["t"]
    if (
        len(first) != sum(group.motion.team.robots for group in motion.groups) + 1
        or np.sum(t >= 0.0) < 2
    ):
        raise FileError(f"{path}: a flight of {len(first) - 1} cables; name one of this plan")
    return recorded_scene(motion, t, arrays["nodes"], first, arrays["poses"])


def recorded_scene(
    motion: Motion, t: Array, nodes: NDArray[Any], first: NDArray[Any], poses: NDArray[Any]
) -> Scene:
    """Return the scene of a simulated flight, whose drones' attitudes are not recorded.

    Groups without cables, and what flies besides, are where the plan has them.

    Parameters
    ----------
    motion, t: the plan that was flown; (frames,) [s], negative while cables settle.
    nodes: (frames, nodes, 3) [m], cable after cable, drones at their ends.
    first: (n + 1,), first node of each cable, and the number of nodes.
    poses: of the objects (frames, objects, 7): places of their bases [m], and quaternions.
    """
    flown = t >= 0.0
    places = [np.linspace(a, b - 1, POINTS).round().astype(int) for a, b in pairwise(first)]
    curves = np.stack([nodes[flown][:, each] for each in places], axis=1).astype(np.float64)
    plan = scene_at(motion, t[flown])
    own = [group.motion.team.robots * (group not in motion.others) for group in motion.flying]
    each = [(group.motion.team, n) for group, n in zip(motion.flying, own, strict=True)]
    drones = np.concatenate([np.full(team.drones, n > 0) for team, n in each])
    cables = np.concatenate([np.full(team.robots, n > 0) for team, n in each])
    plan.drones[:, drones] = curves[:, :, [0, -1]].reshape(len(curves), -1, 3)
    plan.quaternions[:, drones] = [1.0, 0.0, 0.0, 0.0]
    plan.thrusts[:, drones], plan.cable_forces[:, drones] = 0.0, 0.0
    plan.cables[:, cables], plan.objects[:, : poses.shape[1]] = curves, poses[flown]
    return replace(plan, radius=scene_of(motion, 0).radius)


class Concerned(NamedTuple):
    """Indices of drones, cables and vertices that a check names."""

    drones: tuple[int, ...] = ()
    cables: tuple[int, ...] = ()
    vertices: tuple[int, ...] = ()


def concerned(motion: Motion, where: Sequence[str]) -> Concerned:
    """Return the indices that belong to the names in ``where`` of a check; others are ignored."""
    drones, cables, vertices, named = [], [], [], set(where)
    for group in motion.flying:
        team = group.motion.team
        drones += [{group.label(f"{x[0]}-leg {x[1:]}"), group.label(x)} for x in team.drone_names]
        cables += [{group.label(f"{x}{k}") for x in OF_CABLES} for k in range(team.robots)]
        vertices += [{group.label(x)} for x in team.point_names]
    found = ([k for k, x in enumerate(each) if x & named] for each in (drones, cables, vertices))
    return Concerned(*map(tuple, found))
