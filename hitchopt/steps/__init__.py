"""Steps of a mission: classes with their keys, planning and knobs, in one list."""

from hitchopt.steps.carrying import Carry as Carry
from hitchopt.steps.carrying import Enclose as Enclose
from hitchopt.steps.carrying import Grasp as Grasp
from hitchopt.steps.carrying import Leave as Leave
from hitchopt.steps.carrying import Lift as Lift
from hitchopt.steps.carrying import Loosen as Loosen
from hitchopt.steps.carrying import SetDown as SetDown
from hitchopt.steps.carrying import TransportObject as TransportObject
from hitchopt.steps.moving import Adjust as Adjust
from hitchopt.steps.moving import FollowVertex as FollowVertex
from hitchopt.steps.moving import Hold as Hold
from hitchopt.steps.moving import Morph as Morph
from hitchopt.steps.moving import MoveEdge as MoveEdge
from hitchopt.steps.moving import MoveVertex as MoveVertex
from hitchopt.steps.moving import Settle as Settle
from hitchopt.steps.moving import Transport as Transport
from hitchopt.steps.step import Step as Step
from hitchopt.steps.straddling import Tie as Tie
from hitchopt.steps.straddling import Untie as Untie
from hitchopt.steps.tying import CloseVertex as CloseVertex
from hitchopt.steps.tying import Form as Form
from hitchopt.steps.tying import Land as Land
from hitchopt.steps.tying import OpenVertex as OpenVertex
from hitchopt.steps.tying import Release as Release

STEPS: tuple[type[Step], ...] = (
    *(Morph, Hold, MoveVertex, MoveEdge, Adjust, FollowVertex, Transport, Settle),
    *(Form, OpenVertex, CloseVertex, Release, Land),
    *(Enclose, Grasp, Lift, Carry, SetDown, Loosen, Leave, TransportObject),
    *(Tie, Untie),
)
"""All kinds of steps, in the order in which a problem file's keys are listed."""

STEP_KINDS = {kind.name: kind for kind in STEPS}  # Kinds of steps by their keys in a problem file
