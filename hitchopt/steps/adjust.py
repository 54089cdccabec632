"""Adjust: cables slide through their clasps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

from hitchopt.hitch import Hitch
from hitchopt.planners.actions.action import Action
from hitchopt.planners.actions.shape_moves import adjust
from hitchopt.requirements import Requirements
from hitchopt.steps.end_hitch import split_hitch
from hitchopt.steps.hitch_step import ActionStep
from hitchopt.steps.keys import LEGS_TEXT, Blend, Key, Seconds
from hitchopt.steps.slack_split import SlackSplit


@dataclass(frozen=True, eq=False)
class Adjust(ActionStep):
    """Cables slide through their clasps; the outline stays.

    Parameters
    ----------
    legs: at the end.
    duration, blend: as of Morph.
    """

    name: ClassVar[str] = "adjust"
    summary: ClassVar[str] = "Change the legs"
    legs: Annotated[SlackSplit, Key("Legs", LEGS_TEXT, ("balanced",))]
    duration: Seconds = None
    blend: Blend = False

    def action(self, start: Hitch, requirements: Requirements) -> Action:
        """Return the action."""
        wanted = split_hitch(start.team, start.polygon, start.altitude, self.legs, requirements)
        return adjust(start, wanted.q_legs)
