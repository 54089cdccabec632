"""Where a mission stands between two steps, what a step is asked, and what its planning gives."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from hitchopt.checks import Certificate
from hitchopt.errors import InputError
from hitchopt.hitch import Hitch, Team
from hitchopt.motion.motion import Motion
from hitchopt.planners.forming.turns import SwapSettings
from hitchopt.requirements import Requirements
from hitchopt.values import Array


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
    """

    team: Team
    drones: Array
    hitch: Hitch | None = None
    senses: Array | None = None
    swap: SwapSettings = field(default_factory=SwapSettings)

    @classmethod
    def holding(cls, hitch: Hitch) -> Situation:
        """Return the situation of a hitch that is there at first."""
        return cls(hitch.team, hitch.drones, hitch)


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

    def ended(
        self, motion: Motion, hitch: Hitch, certificate: Certificate | None = None
    ) -> StepPlan:
        """Return the plan of a motion that ends with a hitch."""
        after = replace(self.before, hitch=hitch, drones=hitch.drones)
        return StepPlan(motion, after, certificate)
