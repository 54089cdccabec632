"""Enclose: a hitch comes down around an object."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Annotated, ClassVar

import numpy as np

from hitchopt.errors import InfeasibleError, Violation
from hitchopt.geometry import ConvexPolygon, Outline
from hitchopt.motion.motion import Motion, joined_motions
from hitchopt.objects import SolidObject
from hitchopt.objects.placing import TOUCH
from hitchopt.planners.carrying.clasp_opening import check_opens
from hitchopt.planners.carrying.hold_polygons import HoldPolygons
from hitchopt.planners.carrying.rest_polygon import rest_polygons
from hitchopt.requirements import Requirements
from hitchopt.steps.carrying import (
    AROUND_SPEED,
    gap_around,
    gap_below,
    object_of,
    one_phase,
    polygon_at,
    rolling_morph,
)
from hitchopt.steps.keys import OBJECT, Seconds
from hitchopt.steps.morph import Morph
from hitchopt.steps.situation import Holding, Situation, StepPlan, StepTask
from hitchopt.steps.step import Stage, Step
from hitchopt.steps.transport import Transport
from hitchopt.values import Array

LEVEL = 1e-6
"""[m] Heights that differ by less are the same."""

OVER = 0.10
"""[m] Room between drones' lowest places and objects below, besides ``separation.radius``."""


@dataclass(frozen=True)
class Enclose(Step):
    """The hitch goes above an object, takes a polygon around it, and comes down around it.

    It ends just below the object's rim, or, without one, as high as the centre of mass.

    Parameters
    ----------
    object: its name.
    duration: of the whole step, exactly that long [s]; None for as fast as the limits allow.
    """

    name: ClassVar[str] = "enclose"
    summary: ClassVar[str] = "Come down around an object"
    stages: ClassVar[tuple[Stage, Stage] | None] = (Stage.FREE, Stage.AROUND)
    object: Annotated[str, OBJECT]
    duration: Seconds = None

    def plan(self, task: StepTask) -> StepPlan:
        """Return the plan from anywhere to around the object.

        Raises
        ------
        InfeasibleError: no polygon, one that is close to the ground, or clasps that rub on each
            other and do not open so far.
        """
        requirements, hitch = task.requirements, task.hitch
        body, gap = object_of(task, self.object), gap_around(requirements)
        if body.rim is None:
            from hitchopt.planners.carrying.grip_polygon import grip_polygons

            found = grip_polygons(self.object, body, task.before.team, requirements, gap)
            inside = float(body.at[2] + body.centre_of_mass[2])
        else:
            found = rest_polygons(self.object, body, len(hitch.polygon), gap)
            inside = float(body.at[2]) + body.rim.height - gap_below(requirements)
        self._check_height(task, inside)
        polygons, polygon = _numbered(found, body, hitch.polygon)
        wide = float(np.max(np.linalg.norm(polygon.vertices - polygon.centroid, axis=1)))
        remedy = f"tie the hitch as large as around objects.{self.object}, {wide:.2g} m in radius"
        check_opens(hitch, polygon.vertices, requirements, remedy)
        steps = [
            Transport(np.append(hitch.polygon.centroid, altitude_over(task))),
            Transport(np.append(polygon.centroid, altitude_over(task))),
            Morph(polygon),
        ]
        motions: list[Motion] = []
        here = task
        for step in steps:
            if isinstance(step, Transport) and _there(step, here.before):
                continue
            planned = (
                rolling_morph(self, step, here)
                if isinstance(step, Morph)
                else self.part(step, here)
            )
            motions.append(planned.motion)
            here = task.within(requirements, planned.after)
        down = Transport(np.append(polygon.centroid, inside))
        planned = self.part(down, task.within(slowly(requirements), here.before))
        motion = one_phase(joined_motions([*motions, planned.motion]), task, self.name)
        holding = Holding(self.object, polygons, task.before.team.tension)
        after = replace(planned.after, holding=holding)
        return StepPlan(self.lasting(task, motion), after)

    def _check_height(self, task: StepTask, inside: float) -> None:
        """Raise InfeasibleError where the hitch around the object would be close to the ground."""
        requirements = task.requirements
        least, height = requirements.separation.object, inside - requirements.floor
        if height < least - TOUCH:
            body = requirements.objects[self.object]
            name = f"objects.{self.object}"
            remedy = "stand it on something"
            if body.rim is None or body.stem is not None:
                higher = f"make {name} higher" if body.rim is None else f"raise {name}.rim.at"
                remedy = f"{higher}, or {remedy}"
            where, when = ("ground",), f"with the hitch around objects.{self.object}"
            broken = Violation("object_clearance", height, least, "min", "m", where, when, remedy)
            raise InfeasibleError([broken])


def altitude_over(task: StepTask) -> float:
    """Return the hitch's altitude, or a higher one at which it passes above all objects [m]."""
    requirements = task.requirements
    tops = [float(each.at[2]) + each.upper for each in requirements.objects.values()]
    over = requirements.separation.radius + OVER
    sink = task.hitch.altitude - float(np.min(task.hitch.drones[:, 2]))
    return max(task.hitch.altitude, *(top + over + max(sink, 0.0) for top in tops))


def slowly(requirements: Requirements) -> Requirements:
    """Return requirements with the speed at which hitches come down around objects."""
    limits = requirements.limits
    slow = replace(
        limits,
        speed=min(limits.speed, AROUND_SPEED),
        vertex_speed=min(limits.vertex_speed, AROUND_SPEED),
    )
    return replace(requirements, limits=slow)


def _there(step: Transport, situation: Situation) -> bool:
    """Return whether a hitch is where it would be carried to."""
    hitch = situation.hitch
    assert hitch is not None
    here = np.append(hitch.polygon.centroid, hitch.altitude)
    return bool(np.max(np.abs(here - step.to)) < LEVEL)


def _numbered(
    found: HoldPolygons, body: SolidObject, polygon: Outline
) -> tuple[HoldPolygons, ConvexPolygon]:
    """Return the polygons numbered so that vertices have the shortest paths, and that around."""
    here = polygon.vertices - polygon.centroid
    if body.rim is None and body.section.radius is not None:
        found = _turned(found, body, here)
    around = polygon_at(body, found.around)
    there = around.vertices - around.centroid
    lengths = [np.sum((np.roll(there, -k, axis=0) - here) ** 2) for k in range(len(there))]
    best = int(np.argmin(lengths))
    shifted = HoldPolygons(*(np.roll(p, -best, axis=0) for p in (found.around, found.closed)))
    return shifted, around.renumbered(best)


def _turned(found: HoldPolygons, body: SolidObject, here: Array) -> HoldPolygons:
    """Return polygons around a circle, turned so that vertices have the shortest paths.

    Parameters
    ----------
    here: (n, 2) [m], vertices of the hitch about its centroid.
    """
    c, s = math.cos(body.yaw), math.sin(body.yaw)
    there = found.around @ np.array([[c, s], [-s, c]])
    turns = []
    for k in range(len(there)):
        one = np.roll(there, -k, axis=0)
        cross = float(np.sum(one[:, 0] * here[:, 1] - one[:, 1] * here[:, 0]))
        turns.append(
            (math.hypot(cross, float(np.sum(one * here))), cross, float(np.sum(one * here)))
        )
    _, cross, along = max(turns)
    angle = math.atan2(cross, along)
    c, s = math.cos(angle), math.sin(angle)
    turn = np.array([[c, s], [-s, c]])
    return HoldPolygons(found.around @ turn, found.closed @ turn)
