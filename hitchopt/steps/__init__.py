"""Steps of a mission: records with their keys, planning and knobs.

A module's ``__all__`` names its steps. From these lists follow the attributes of ``hitchopt``, the
keys of problem files and the pages of the reference.
"""

from hitchopt.carrying import steps as carrying
from hitchopt.forming import steps as tying
from hitchopt.steps import moving
from hitchopt.steps.step import Step as Step

STEPS: tuple[type[Step], ...] = tuple(
    getattr(module, name) for module in (moving, tying, carrying) for name in module.__all__
)
"""All kinds of steps, in the order in which a problem file's keys are listed."""

STEP_KINDS = {kind.name: kind for kind in STEPS}  # Kinds of steps by their keys in a problem file
