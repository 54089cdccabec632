"""The ghost beside a plan: another plan, or a flight that was simulated."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import FileError
from hitchopt.motion.motion import Motion
from hitchopt.motion.plan_file import read_plan
from hitchopt.storage.archive import BROKEN, PLAN, RECORDING, read_arrays
from hitchopt.values import Array
from hitchopt.view.cable_curves import POINTS
from hitchopt.view.scene import Scene, scene_of


def ghost_scene(path: Path, motion: Motion) -> Scene:
    """Return the scene of another plan, or of a simulated flight of ``motion``.

    Parameters
    ----------
    path: a recording or a plan, or the directory of either.
    motion: the plan at whose side it is shown.

    Raises
    ------
    FileError: there is neither, it is damaged, or the flight is that of another team.
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
        raise FileError(f"{path}: not a recording of a simulated flight: {error}") from error
    first, t = arrays["cables"], arrays["t"]
    if len(first) != motion.team.robots + 1 or len(t) < 2:
        raise FileError(f"{path}: a flight of {len(first) - 1} cables; simulate this plan")
    return recorded_scene(motion, t, arrays["nodes"], first, arrays["poses"])


def recorded_scene(
    motion: Motion, t: Array, nodes: NDArray[Any], first: NDArray[Any], poses: NDArray[Any]
) -> Scene:
    """Return the scene of a simulated flight, whose drones' attitudes are not recorded.

    Parameters
    ----------
    motion: the plan that was flown.
    t: (frames,) [s]; negative ones, while cables settle, are left out.
    nodes: (frames, nodes, 3) [m], cable after cable, drones at their ends.
    first: (n + 1,), first node of each cable, and the number of nodes.
    poses: of the objects (frames, objects, 7): places of their bases [m], and quaternions.
    """
    flown = t >= 0.0
    cables = [
        nodes[flown][:, np.linspace(start, end - 1, POINTS).round().astype(int)]
        for start, end in pairwise(first)
    ]
    curves = np.stack(cables, axis=1).astype(np.float64)
    drones = curves[:, :, [0, -1]].reshape(len(curves), -1, 3)
    upright = np.broadcast_to([1.0, 0.0, 0.0, 0.0], (*drones.shape[:2], 4))
    nothing = np.zeros(drones.shape[:2])
    radius = scene_of(motion, 0).radius
    forces, objects = np.zeros_like(drones), poses[flown].astype(np.float64)
    return Scene(motion, t[flown], drones, upright, nothing, forces, curves, objects, radius)
