"""Steps of a mission, one file each: its keys, its record, its planning and what repair edits."""

from hitchopt.steps.adjust import Adjust as Adjust
from hitchopt.steps.carry import Carry as Carry
from hitchopt.steps.enclose import Enclose as Enclose
from hitchopt.steps.follow_vertex import FollowVertex as FollowVertex
from hitchopt.steps.form import Form as Form
from hitchopt.steps.grasp import Grasp as Grasp
from hitchopt.steps.hold import Hold as Hold
from hitchopt.steps.land import Land as Land
from hitchopt.steps.leave import Leave as Leave
from hitchopt.steps.lift import Lift as Lift
from hitchopt.steps.loosen import Loosen as Loosen
from hitchopt.steps.morph import Morph as Morph
from hitchopt.steps.move_edge import MoveEdge as MoveEdge
from hitchopt.steps.move_vertex import MoveVertex as MoveVertex
from hitchopt.steps.release import Release as Release
from hitchopt.steps.set_down import SetDown as SetDown
from hitchopt.steps.step import Step as Step
from hitchopt.steps.transport import Transport as Transport
from hitchopt.steps.transport_object import TransportObject as TransportObject

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
    Enclose,
    Grasp,
    Lift,
    Carry,
    SetDown,
    Loosen,
    Leave,
    TransportObject,
)
"""All kinds of steps, in the order in which a problem file's keys are listed."""
