"""Adjust: cables slide through their clasps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

from hitchopt.errors import InputError
from hitchopt.planners.actions.action import Action
from hitchopt.planners.actions.shape_moves import adjust
from hitchopt.steps.end_hitch import split_hitch
from hitchopt.steps.hitch_step import ActionStep
from hitchopt.steps.keys import LEGS_TEXT, Blend, Key, Seconds
from hitchopt.steps.situation import StepTask
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

    def __post_init__(self) -> None:
        if self.legs is None:
            raise InputError("legs", None, "balanced, spread or a list of d_k", "write balanced")
        super().__post_init__()

    def action(self, task: StepTask) -> Action:
        """Return the action."""
        start = task.hitch
        altitude, requirements = start.altitude, task.requirements
        wanted = split_hitch(start.team, start.polygon, altitude, self.legs, requirements)
        return adjust(start, wanted.q_legs)
