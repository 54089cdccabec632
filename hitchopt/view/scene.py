"""Scenes of plans over time: drones, cables, forces and objects, for pictures, films and pages.

A ghost is the scene of another plan, or of a simulated or evaluated flight.
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
from hitchopt.storage.archive import PLAN, READ_ERRORS, RECORDING, read_arrays
from hitchopt.values import Array
from hitchopt.view.cables import MIN_RADIUS, POINTS, THICKNESS, cable_curves
from hitchopt.view.shapes import Appearance

# Maximum number of coordinates in a scene, minimum number of times besides the ends of phases, and
# maximum rate [Hz]
MAX_SAMPLES, MIN_TIMES, MAX_RATE = 1_000_000, 48, 30.0
PER_DRONE = 11  # Number of a drone's coordinates at a time
# Prefixes of names of cables in ``where`` of a check
CABLE_PREFIXES = ("cable ", "edge ", "c", "q-leg ", "r-leg ")


@dataclass(frozen=True, eq=False)
class Moment:
    """Places and forces at a time, or at several times if arrays have a leading axis of times."""

    drones: Array  # positions (N, 3) [m]
    quaternions: Array  # attitudes (N, 4), w, x, y, z
    thrusts: Array  # (N,) [N]
    cable_forces: Array  # (N, 3) [N], on the drones
    cables: Array  # (n, POINTS, 3) [m]
    objects: Array  # (objects, 7) places of their bases [m], and quaternions


@dataclass(frozen=True, eq=False)
class Scene(Moment):
    """Samples of a plan over time: the arrays of ``Moment`` (times, …)."""

    motion: Motion  # the plan, with limits, arena, keep-outs and objects
    t: Array  # (times,) [s] from its start, including the ends of all phases
    radius: float  # radius of drawn cables [m]

    @cached_property
    def appearance(self) -> Appearance:
        """Names, colours and shapes."""
        return Appearance.of(self.motion)

    def at(self, time: float) -> Moment:
        """Return the scene at a time [s], interpolated between its samples."""
        i = int(np.clip(np.searchsorted(self.t, time, side="right"), 1, len(self.t) - 1))
        share = float(np.clip((time - self.t[i - 1]) / (self.t[i] - self.t[i - 1]), 0.0, 1.0))
        arrays = [getattr(self, field.name) for field in fields(Moment)]
        return Moment(*((1.0 - share) * array[i - 1] + share * array[i] for array in arrays))


def scene_of(motion: Motion, samples: int = MAX_SAMPLES) -> Scene:
    """Return the scene of a plan at even times and at the ends of its phases.

    ``samples`` is the maximum number of coordinates, which determines the number of times.
    """
    teams = [group.motion.team for group in motion.all_groups]
    size = sum(PER_DRONE * team.drones + 3 * POINTS * team.robots for team in teams)
    count = int(np.clip(samples // size, MIN_TIMES, MAX_RATE * motion.duration + 2))
    ends = [phase.end for phase in motion.phases]
    times = np.concatenate([np.linspace(0.0, motion.duration, count), ends])
    return scene_at(motion, np.unique(np.clip(np.round(times, 6), 0.0, motion.duration)))


def scene_at(motion: Motion, t: Array, thickness: float = THICKNESS) -> Scene:
    """Return the scene of a plan, with other plans, at ascending times (times,) [s].

    ``thickness`` is the radius of a drawn cable as a share of the scene's extent.
    """
    begin, rows, radii = motion.drones.breaks[0], list[Any](), list[float]()
    poses = [motion.poses.at(begin + np.minimum(t, motion.duration))]
    for group in motion.all_groups:
        own, is_other = group.motion, group in motion.others
        states = states_at(own, np.clip(begin + t - own.drones.breaks[0], 0.0, own.duration))
        cables, radius = cable_curves(own, states, thickness)
        thrusts = np.linalg.norm(states.thrusts(own.team), axis=-1)
        rows.append((states.positions, states.quaternions, thrusts, states.cable_forces, cables))
        radii += [radius] * (own.team.has_cables or len(motion.all_groups) == 1)
        poses += [states.object_poses] * is_other
    pose = np.concatenate(poses, axis=1)
    half = 0.5 * np.unwrap(np.arctan2(pose[..., 4], pose[..., 3]), axis=0)[..., None]
    turns = [np.cos(half), 0.0 * half, 0.0 * half, np.sin(half)]
    drones, attitudes, thrusts, forces, curves = (
        np.concatenate(each, axis=1) for each in zip(*rows, strict=True)
    )
    objects, radius = (
        np.concatenate([pose[..., :3], *turns], axis=-1),
        min(radii, default=MIN_RADIUS),
    )
    return Scene(drones, attitudes, thrusts, forces, curves, objects, motion, t, radius)


def ghost_scene(path: Path, motion: Motion) -> Scene:
    """Return the scene of another plan, or of a simulated or evaluated flight of ``motion``.

    ``path`` is a recording or a plan, or the directory of either. Raises FileError if the file is
    missing or damaged, or if the flight is another team's.
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
    except READ_ERRORS as error:
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
    """Return the scene of a simulated flight; attitudes of drones are not recorded.

    Groups without cables, and other plans, are at their planned places.

    Parameters
    ----------
    motion: the plan of the flight.
    t: (frames,) [s], negative while cables settle.
    nodes: (frames, nodes, 3) [m], in the order of cables, with drones at their ends.
    first: (n + 1,), first node of each cable, and the number of nodes.
    poses: (frames, objects, 7) places of the objects' bases [m], and quaternions.
    """
    in_flight = t >= 0.0
    indices = [np.linspace(a, b - 1, POINTS).round().astype(int) for a, b in pairwise(first)]
    curves = np.stack([nodes[in_flight][:, x] for x in indices], axis=1).astype(np.float64)
    plan = scene_at(motion, t[in_flight])
    recorded = [x.motion.team.has_cables and x not in motion.others for x in motion.all_groups]
    teams = [(group.motion.team, x) for group, x in zip(motion.all_groups, recorded, strict=True)]
    drones = np.concatenate([np.full(team.drones, x) for team, x in teams])
    cables = np.concatenate([np.full(team.robots, x) for team, x in teams])
    plan.drones[:, drones] = curves[:, :, [0, -1]].reshape(len(curves), -1, 3)
    plan.quaternions[:, drones] = [1.0, 0.0, 0.0, 0.0]
    plan.thrusts[:, drones], plan.cable_forces[:, drones] = 0.0, 0.0
    plan.cables[:, cables], plan.objects[:, : poses.shape[1]] = curves, poses[in_flight]
    return replace(plan, radius=scene_of(motion, 0).radius)


class Highlight(NamedTuple):
    """Indices of drones, cables and vertices that a check names."""

    drones: tuple[int, ...] = ()
    cables: tuple[int, ...] = ()
    vertices: tuple[int, ...] = ()


def highlight_of(motion: Motion, where: Sequence[str]) -> Highlight:
    """Return the indices for the names in ``where`` of a check; unknown names are ignored."""
    drones, cables, vertices, names = [], [], [], set(where)
    for group in motion.all_groups:
        team = group.motion.team
        drones += [{group.label(f"{x[0]}-leg {x[1:]}"), group.label(x)} for x in team.drone_names]
        cables += [{group.label(f"{x}{k}") for x in CABLE_PREFIXES} for k in range(team.robots)]
        vertices += [{group.label(x)} for x in team.point_names]
    aliases = drones, cables, vertices
    indices = ([k for k, x in enumerate(each) if x & names] for each in aliases)
    return Highlight(*map(tuple, indices))
