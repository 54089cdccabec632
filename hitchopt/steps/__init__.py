"""Steps of a mission, one file each: its keys, its record, its planning and what repair edits."""

from hitchopt.steps.adjust import Adjust
from hitchopt.steps.follow_vertex import FollowVertex
from hitchopt.steps.form import Form
from hitchopt.steps.hold import Hold
from hitchopt.steps.land import Land
from hitchopt.steps.morph import Morph
from hitchopt.steps.move_edge import MoveEdge
from hitchopt.steps.move_vertex import MoveVertex
from hitchopt.steps.release import Release
from hitchopt.steps.step import Step
from hitchopt.steps.transport import Transport

STEPS: tuple[type[Step], ...] = (
    Morph,
    Hold,
    MoveVertex,
    MoveEdge,
    Adjust,
    FollowVertex,
    Transport,
    Form,
    Release,
    Land,
)
"""All kinds of steps, in the order in which a problem file's keys are listed."""

__all__ = [
    "STEPS",
    "Adjust",
    "FollowVertex",
    "Form",
    "Hold",
    "Land",
    "Morph",
    "MoveEdge",
    "MoveVertex",
    "Release",
    "Step",
    "Transport",
]
