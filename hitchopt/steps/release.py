"""Release: the hitch is taken apart as it was formed, backwards."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from hitchopt.hitch import Team
from hitchopt.motion.motion import joined_motions
from hitchopt.planners.forming.tying_stages import tied, undone
from hitchopt.steps.free_cables import LEVEL, staged
from hitchopt.steps.keys import Seconds
from hitchopt.steps.situation import StepPlan, StepTask
from hitchopt.steps.step import Step
from hitchopt.steps.tying_site import lifted, tying_site


@dataclass(frozen=True)
class Release(Step):
    """The hitch is taken apart as it was formed, backwards, until its cables hang free.

    Parameters
    ----------
    duration: as of Form.
    """

    name: ClassVar[str] = "release"
    summary: ClassVar[str] = "The reverse of form"
    duration: Seconds = None

    def polygon_after(self, team: Team, outline: Any) -> None:
        """Return None: there is no hitch."""

    def plan(self, task: StepTask) -> StepPlan:
        """Return the plan from a hitch to drones on free cables."""
        before, hitch, requirements = task.before, task.hitch, task.requirements
        senses = before.senses
        if senses is None:
            senses = np.ones(len(before.team.layout.clasps))
        site = tying_site(hitch, before.swap, senses, requirements)
        stages = undone(tied(site.pre, site.hitch, requirements.limits, before.swap))
        parts = [staged(stages, site.hitch, task.index, requirements)]
        if abs(site.hitch.altitude - hitch.altitude) > LEVEL:
            parts.insert(0, lifted(hitch, site.hitch.altitude, "raise", task))
        after = replace(before, drones=site.pre.drones, hitch=None, senses=None)
        motion = self.lasting(task, joined_motions(parts))
        return StepPlan(motion, after)
