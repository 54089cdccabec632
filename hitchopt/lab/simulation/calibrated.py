"""Drones as they are: tilted bodies, thrust factors and rotor drag, and what their plan knows.

A rigid body that is defined tilted, or bent arms, tilts the frame of a drone's controller from its
thrust. At rest the thrust is upright, so the controller sees a tilt φ, and a position loop of
stiffness k holds it by an offset of m g tan φ / k from the setpoint: the drone's trim.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from hitchopt.errors import FileError, InputError
from hitchopt.geometry.vectors import length
from hitchopt.hitch import GRAVITY
from hitchopt.hitch.team import MEASURED, Quadrotor, kinds_of
from hitchopt.lab.simulation.settings import Settings
from hitchopt.lab.simulation.task import Task
from hitchopt.lab.simulation.world import RigidBodies
from hitchopt.storage.yaml_file import read_yaml
from hitchopt.values import Array

ROTOR_DRAG = 0.012  # Drag of rotors over the speed, measured on Crazyflies [N s/m]


def read_calibrated(path: Path) -> Mapping[str, Any]:
    """Return the drones in a file of ``hitchopt calibrate``, or under ``team`` of a problem file.

    Raises FileError or InputError for files of another form.
    """
    data: Any = read_yaml(path)
    for key in ("team", "quadrotor"):
        if isinstance(data, Mapping) and key in data:
            data = data[key]
    if not isinstance(data, Mapping):
        raise FileError(f"{path}: holds no drones; write a mapping such as q0: {{trim: [x, y]}}")
    return data


def flown_kinds(task: Task, settings: Settings) -> tuple[Quadrotor, ...]:
    """Return the kinds (2n,) of the drones that fly: those of the plan, as calibrated if stated.

    Raises InputError for drones that the team does not have.
    """
    team, stated = task.team, settings.as_calibrated
    if stated is None:
        return team.kinds
    task.require_one_team("drones as calibrated")
    try:
        kinds = kinds_of(stated, team.robots, "robot", team.drone_names)
    except InputError as error:
        raise error.within("as_calibrated") from None
    kinds = tuple(kind for kind in kinds for _ in range(team.drones // len(kinds)))
    pairs = zip(team.kinds, kinds, strict=True)
    return tuple(
        replace(kind, **{name: getattr(own, name) for name in MEASURED}) for kind, own in pairs
    )


@dataclass(frozen=True, eq=False)
class FlownDrones:
    """How drones differ from those that a plan without calibration assumes."""

    trims: Array  # (2n, 3) [m], that the plan knows: setpoints minus planned places
    turns: Array  # (2n, 3, 3), axes of the controllers' frames as columns, in those of the thrust
    thrust_factors: Array  # (2n,), commanded over actual thrusts
    drag: float  # [N s/m], over the speed

    @classmethod
    def nominal(cls, drones: int) -> FlownDrones:
        """Return a number of drones that are as a plan without calibration assumes."""
        turns = np.tile(np.eye(3), (drones, 1, 1))
        return cls(np.zeros((drones, 3)), turns, np.ones(drones), 0.0)

    @classmethod
    def of(cls, task: Task, settings: Settings, stiffness: Array) -> FlownDrones:
        """Return the drones of a task whose position loops have some stiffness (2n, 3) [N/m]."""
        kinds, team = flown_kinds(task, settings), task.team
        trims = np.array([kind.trim or (0.0, 0.0) for kind in kinds])
        lean = stiffness[:, :1] * trims / (GRAVITY * team.mass[:, None])  # tangents of tilts
        axis, size = np.column_stack([-lean[:, 1], lean[:, 0]]), length(lean)
        angle = np.arctan(size) / np.maximum(size, 1e-12)
        turns = Rotation.from_rotvec(np.insert(axis * angle[:, None], 2, 0.0, axis=1)).as_matrix()
        drag = settings.perturbations.rotor_drag
        if drag is None:
            drag = ROTOR_DRAG if settings.as_calibrated is not None else 0.0
        factors = np.array([kind.thrust_factor or 1.0 for kind in kinds])
        return cls(np.insert(team.trim, 2, 0.0, axis=1), turns, factors, drag)

    @cached_property
    def _is_tilted(self) -> bool:
        return bool(np.any(self.turns != np.eye(3)))

    def measured(self, bodies: RigidBodies) -> RigidBodies:
        """Return bodies with attitudes and rates in the controllers' frames."""
        if not self._is_tilted:
            return bodies
        attitudes = bodies.attitudes @ self.turns
        rates = np.einsum("iba,ib->ia", self.turns, bodies.rates)
        return replace(bodies, attitudes=attitudes, rates=rates)

    def actual(self, thrusts: Array, moments: Array) -> tuple[Array, Array]:
        """Return thrusts (2n,) and moments (2n, 3) about the bodies' axes, from commanded ones."""
        if self._is_tilted:
            moments = np.einsum("iab,ib->ia", self.turns, moments)
        return thrusts / self.thrust_factors, moments
