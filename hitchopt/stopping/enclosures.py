"""Objects in the way of a landing: what a hitch is around, and where the plan is free of it.

A hitch that holds an object cannot be lowered or untied: what is in the air would fall. It lands
from one of the plan's own rests at which it is around no object: ahead where the object has been
moved, as it is set down there, behind where it has not been lifted yet.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hitchopt.motion.cutting import rests
from hitchopt.motion.motion import Motion
from hitchopt.motion.phases import JOINT, HoldBy
from hitchopt.objects import SolidObject
from hitchopt.objects.placing import STILL, in_world
from hitchopt.values import Array


@dataclass(frozen=True)
class Enclosed:
    """An object that a hitch is around, or holds, at a plan time.

    Attributes
    ----------
    name: of the object.
    held: whether cables may touch it from then on.
    onward: whether the hitch lands from a rest ahead, not from one behind.
    way_out: plan time of that rest, the nearest at which it is around no object [s]; None where
        there is none on either side.
    """

    name: str
    held: bool
    onward: bool
    way_out: float | None


class Enclosures:
    """What the hitch of a plan is around.

    Parameters
    ----------
    motion: the plan.
    """

    def __init__(self, motion: Motion) -> None:
        self.motion = motion
        still = motion.drones.breaks[rests(motion)].tolist() if motion.requirements.objects else []
        self._free = np.array([time for time in still if self._name(time) is None])

    def at(self, time: float) -> Enclosed | None:
        """Return what the hitch is around at a plan time [s]; None where that is nothing.

        It goes on where the object has been moved, or is gripped, as grips open otherwise than they
        close; else back. Where there is no rest on that side it is the other one.
        """
        name = self._name(time)
        if name is None:
            return None
        before, after = self._free[self._free < time], self._free[self._free > time]
        holds = [
            phase.hold.by
            for phase in self.motion.phases
            if phase.hold is not None and phase.start < time + JOINT < phase.end
        ]
        onward = HoldBy.GRIP in holds or not len(before)
        if not onward:
            index = list(self.motion.requirements.objects).index(name)
            poses = self.motion.object_poses.at(np.array([before[-1], time]))[:, index]
            onward = bool(np.max(np.abs(poses[1] - poses[0])) > STILL)
        onward = onward and len(after) > 0
        way_out = after[:1] if onward else before[-1:]
        return Enclosed(name, bool(holds), onward, float(way_out[0]) if len(way_out) else None)

    def _name(self, time: float) -> str | None:
        """Return the name of an object that the hitch is around."""
        motion = self.motion
        phase = next(p for p in reversed(motion.phases) if p.start < time + JOINT)
        if not (motion.requirements.objects and phase.formed and motion.team.layout.closed):
            return None
        vertices, poses = motion.vertices.at(time), motion.object_poses.at(time)
        for pose, (name, body) in zip(poses, motion.requirements.objects.items(), strict=True):
            if not body.fixed and _encloses(vertices, pose, body):
                return name
        return None


def _encloses(vertices: Array, pose: Array, body: SolidObject) -> bool:
    """Return whether a polygon of vertices (n, 3) [m] goes around an object, below its top."""
    top = body.upper if body.rim is None else max(body.upper, body.rim.height)
    middle = in_world(pose, np.append(body.section.centroid, top))
    away = (vertices - middle)[:, :2] @ [1.0, 1.0j]
    turned = np.sum(np.angle(np.roll(away, -1) * away.conj()))
    return bool(abs(turned) > np.pi and np.min(vertices[:, 2]) < middle[2])
