"""Steps of a mission, one file each: its keys, its record, its planning and what repair edits."""

from hitchopt.steps.adjust import Adjust as Adjust
from hitchopt.steps.follow_vertex import FollowVertex as FollowVertex
from hitchopt.steps.form import Form as Form
from hitchopt.steps.hold import Hold as Hold
from hitchopt.steps.land import Land as Land
from hitchopt.steps.morph import Morph as Morph
from hitchopt.steps.move_edge import MoveEdge as MoveEdge
from hitchopt.steps.move_vertex import MoveVertex as MoveVertex
from hitchopt.steps.release import Release as Release
from hitchopt.steps.step import Step as Step
from hitchopt.steps.transport import Transport as Transport

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
