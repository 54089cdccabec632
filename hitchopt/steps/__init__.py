"""Steps of a mission: classes with their keys, planning and knobs, in one list."""

from hitchopt.steps import carrying, moving, straddling, tying
from hitchopt.steps.step import Step as Step

STEPS: tuple[type[Step], ...] = (
    *(moving.Morph, moving.Hold, moving.MoveVertex, moving.MoveEdge, moving.Adjust),
    *(moving.FollowVertex, moving.Transport, moving.Settle, tying.Form, tying.OpenVertex),
    *(
        tying.CloseVertex,
        tying.Release,
        tying.Land,
        carrying.Enclose,
        carrying.Grasp,
        carrying.Lift,
        carrying.Carry,
    ),
    *(carrying.SetDown, carrying.Loosen, carrying.Leave, carrying.TransportObject),
    *(straddling.Tie, straddling.Untie),
)
"""All kinds of steps, in the order in which a problem file's keys are listed."""

STEP_KINDS = {kind.name: kind for kind in STEPS}  # Kinds of steps by their keys in a problem file
