"""Where a mission stands between two steps, what a step is asked, and what its planning gives."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from hitchopt.checks import Certificate
from hitchopt.errors import InputError
from hitchopt.hitch import Hitch, Team
from hitchopt.motion.motion import Motion
from hitchopt.objects import SolidObject
from hitchopt.planners.forming.turns import SwapSettings
from hitchopt.requirements import Requirements
from hitchopt.values import Array

if TYPE_CHECKING:
    from hitchopt.planners.carrying.gripped_hitch import GrippedHitch
    from hitchopt.planners.carrying.held_motion import HeldHitch
    from hitchopt.planners.carrying.hold_polygons import HoldPolygons


@dataclass(frozen=True, eq=False)
class Holding:
    """An object that a hitch is around, or holds.

    Attributes
    ----------
    name: of the object.
    polygons: of the hitch, in the object's frame.
    tension: (n,) [N], what cables pull with from grasping to loosening.
    held: the hitch that holds it; None while it is only around it.
    borne: whether clasps carry its weight.
    """

    name: str
    polygons: HoldPolygons
    tension: Array
    held: HeldHitch | GrippedHitch | None = None
    borne: bool = False


@dataclass(frozen=True, eq=False)
class Situation:
    """A moment of rest: a hitch, or drones on free cables.

    Attributes
    ----------
    team: who flies.
    drones: (2n, 3) [m], in the order q0, r0, q1, r1, ….
    hitch: what they hold, or None where cables are free.
    senses: (clasps,), how pairs have turned to form it, 1 where q went up first; a hitch that
        was there at first is taken to have been formed so.
    swap: the settings of these turns.
    holding: what the hitch is around or holds; ``hitch`` is then as if it carried nothing.
    objects: where objects are by now; None where the problem has them.
    """

    team: Team
    drones: Array
    hitch: Hitch | None = None
    senses: Array | None = None
    swap: SwapSettings = field(default_factory=SwapSettings)
    holding: Holding | None = None
    objects: Mapping[str, SolidObject] | None = None

    @classmethod
    def formed(cls, hitch: Hitch) -> Situation:
        """Return the situation of a hitch that is there at first."""
        return cls(hitch.team, hitch.drones, hitch)

    def at_objects(self, requirements: Requirements) -> Requirements:
        """Return requirements with objects where they are by now."""
        return requirements if self.objects is None else replace(requirements, objects=self.objects)


@dataclass(frozen=True, eq=False)
class StepPlan:
    """The motion of a step, and where it ends.

    Attributes
    ----------
    motion: from rest to rest.
    after: where it ends.
    certificate: of the step alone, its duration left open; None where it was not computed yet.
    """

    motion: Motion
    after: Situation
    certificate: Certificate | None = None


@dataclass(frozen=True, eq=False)
class StepTask:
    """What a step is asked to plan.

    Attributes
    ----------
    before: where the mission stands.
    index: of the step in its mission.
    requirements: what the plan must satisfy.
    optimiser: whether the optimiser may be used.
    """

    before: Situation
    index: int
    requirements: Requirements
    optimiser: bool = True

    @property
    def hitch(self) -> Hitch:
        """The hitch to start with; raises InputError where cables are free."""
        if self.before.hitch is None:
            raise InputError(f"mission[{self.index}]", None, "given a hitch", "form one before")
        return self.before.hitch

    @property
    def holding(self) -> Holding:
        """What the hitch is around or holds; raises InputError where that is nothing."""
        if self.before.holding is None:
            raise InputError(
                f"mission[{self.index}]", None, "around an object", "enclose it before"
            )
        return self.before.holding

    def within(self, requirements: Requirements, situation: Situation) -> StepTask:
        """Return the same task in another situation, with other requirements."""
        return replace(self, before=situation, requirements=requirements)

    def ended(
        self, motion: Motion, hitch: Hitch, certificate: Certificate | None = None
    ) -> StepPlan:
        """Return the plan of a motion that ends with a hitch."""
        after = replace(self.before, hitch=hitch, drones=hitch.drones)
        return StepPlan(motion, after, certificate)
