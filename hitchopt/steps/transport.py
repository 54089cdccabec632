"""Transport: the whole hitch goes elsewhere and turns."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

from hitchopt.errors import InputError, UnitWarning
from hitchopt.geometry import Outline
from hitchopt.hitch import Hitch, Team
from hitchopt.planners.path.path_feasibility import check_loads
from hitchopt.planners.path.rigid_path import RigidPath
from hitchopt.planners.timing.fly_path import fly
from hitchopt.steps.hitch_step import HitchStep
from hitchopt.steps.keys import MAX_TURNS, YAW, Key, Seconds
from hitchopt.steps.situation import StepPlan, StepTask
from hitchopt.steps.step import convex_outline, numbers
from hitchopt.units import warn_of_unit
from hitchopt.values import MAX_COORDINATE, Array, finite


@dataclass(frozen=True, eq=False)
class Transport(HitchStep):
    """The whole hitch goes elsewhere and turns; its shape and legs stay.

    Parameters
    ----------
    to: (3,) [m], where the centroid of the outline goes.
    yaw: by how much it turns about that, counter-clockwise [rad]; more than a turn is one.
    duration: as of Morph.
    """

    name: ClassVar[str] = "transport"
    summary: ClassVar[str] = "Carry the whole hitch"
    to: Annotated[Array, Key("Point3", "Where its centroid goes, [x, y, z] [m]", ([0, 0, 1],))]
    yaw: Annotated[float, YAW] = 0.0
    duration: Seconds = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "to", numbers("to", self.to, (3,), "a point [x, y, z]"))
        object.__setattr__(self, "yaw", finite("yaw", self.yaw))
        if abs(self.yaw) > MAX_TURNS * 2.0 * math.pi:
            bound = f"at most {MAX_TURNS} turns either way"
            remedy = f"turn in several steps; if degrees were meant, {math.radians(self.yaw):.3g}"
            raise InputError("yaw", self.yaw, bound, remedy)
        if abs(self.yaw) > 2.0 * math.pi and self.yaw == round(self.yaw):  # rarely of radians
            meant = f"if degrees were meant, {math.radians(self.yaw):.3g}"
            warn_of_unit(UnitWarning("yaw", f"{self.yaw:g} rad, more than a turn; {meant}"))
        super().__post_init__()

    def polygon_after(self, team: Team, outline: Outline) -> Outline:
        """Return the outline turned about its centroid, which goes to its new place."""
        if abs(self.to[2]) > MAX_COORDINATE:
            bound = f"within ±{MAX_COORDINATE:g} m"
            raise InputError("to", self.to.tolist(), bound, "check its coordinates")
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        turned = (outline.vertices - outline.centroid) @ np.array([[c, s], [-s, c]])
        return convex_outline(team, turned + self.to[:2], "to", self.to)

    def fly(self, task: StepTask) -> StepPlan:
        """Return the plan of a rigid motion."""
        start, limits = task.hitch, task.requirements.limits
        path = RigidPath(start, self.to, self.yaw)
        outline = self.polygon_after(start.team, start.polygon)
        end = Hitch(start.team, outline, float(self.to[2]), start.q_legs, start.roll)
        self.check_end(end, task)
        if path.still:
            return task.ended(self.motion(task, None, end), end)
        check_loads(path, limits)
        flight = fly(path, limits, self.duration)
        return task.ended(self.motion(task, flight, end), end)

    def scaled(self, factor: float, centre: Array) -> tuple[None, Array]:  # noqa: ARG002
        """Return no edit, and the place that the hitch is carried to."""
        return None, self.to[:2]
