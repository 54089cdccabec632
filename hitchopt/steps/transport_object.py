"""Transport an object: enclose, grasp, lift, carry, set down, loosen and leave it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, get_args

import numpy as np

from hitchopt.errors import InputError
from hitchopt.motion.motion import Motion, joined_motions
from hitchopt.objects.placing import TOUCH
from hitchopt.steps.carry import Carry
from hitchopt.steps.carrying import object_of
from hitchopt.steps.enclose import Enclose
from hitchopt.steps.grasp import By, Grasp
from hitchopt.steps.keys import OBJECT, YAW, Key
from hitchopt.steps.leave import Leave
from hitchopt.steps.lift import Lift
from hitchopt.steps.loosen import Loosen
from hitchopt.steps.set_down import SetDown
from hitchopt.steps.situation import Situation, StepPlan, StepTask
from hitchopt.steps.step import Step, numbers
from hitchopt.values import Array, choice, finite, positive

LIFT = 0.3
"""[m] An object is lifted this far above the higher of the two places that it stands on."""


@dataclass(frozen=True, eq=False)
class TransportObject(Step):
    """An object is taken from where it stands and set down elsewhere, in seven steps.

    Parameters
    ----------
    object: its name.
    to: (3,) [m], where the origin of its base goes.
    by: as of Grasp; None for ``rest`` if it has a rim, else ``grip``.
    tension: as of Grasp.
    yaw: by how much it turns, counter-clockwise [rad].
    lift: how far it is lifted above the higher of the two places [m].
    """

    name: ClassVar[str] = "transport_object"
    summary: ClassVar[str] = "Enclose, grasp, lift, carry, set down, loosen and leave an object"
    object: Annotated[str, OBJECT]
    to: Annotated[Array, Key("Point3", "Where its base goes, [x, y, z] [m]", ([1, 0, 0],))]
    by: Annotated[
        By | None,
        Key(("rest", "grip"), "How it is held, as in grasp; without it rest if it has a rim"),
    ] = None
    tension: Annotated[
        float | None, Key("Positive", "Of all cables while it is held [N]; without it the team's")
    ] = None
    yaw: Annotated[float, YAW] = 0.0
    lift: Annotated[float, Key("Positive", "How far it is lifted [m]")] = LIFT

    def __post_init__(self) -> None:
        object.__setattr__(self, "to", numbers("to", self.to, (3,), "a point [x, y, z]"))
        object.__setattr__(self, "lift", positive("lift", self.lift))
        object.__setattr__(self, "yaw", finite("yaw", self.yaw))
        if self.by is not None:
            choice("by", self.by, get_args(By))
        if self.tension is not None:
            object.__setattr__(self, "tension", positive("tension", self.tension))
        super().__post_init__()

    def plan(self, task: StepTask) -> StepPlan:
        """Return the plan of the seven steps.

        Raises
        ------
        InputError: no surface to stand on at ``to``.
        """
        body = object_of(task, self.object)
        high = max(float(body.at[2]), float(self.to[2])) + self.lift
        steps: list[Step] = [
            Enclose(self.object),
            Grasp(self.object, self.by or ("rest" if body.rim else "grip"), self.tension),
            Lift(high - float(body.at[2])),
            Carry(self.object, np.append(self.to[:2], high), self.yaw),
            SetDown(self.object),
            Loosen(self.object),
            Leave(self.object),
        ]
        motions: list[Motion] = []
        situation = task.before
        for step in steps:
            planned = step.plan(task.within(situation.at_objects(task.requirements), situation))
            motions.append(planned.motion)
            situation = planned.after
            if isinstance(step, SetDown):
                self._check_place(situation, task.index)
        return StepPlan(joined_motions(motions), situation)

    def _check_place(self, situation: Situation, index: int) -> None:
        """Raise InputError where the object does not stand as high as was asked."""
        objects = situation.objects or {}
        height = float(objects[self.object].at[2])
        if abs(height - self.to[2]) > TOUCH:
            raise InputError(
                f"mission[{index}].{self.name}.to",
                self.to.tolist(),
                f"on what is below it, which is at {height:.6g} m",
                f"write {[*self.to[:2].tolist(), round(height, 9)]}",
            )
