"""Problem files, and a problem to a plan, step by step.

A file is read (``loading``) into a ``problem``: teams with their ``starts``, steps in a valid
``step_order``, ``objects`` and ``others``. ``solving`` plans its steps, with a ``cache``, and
``teams`` fly on one clock. Refusals get ``advice``, or ``repair`` tries ``trials`` of ``changes``.
"""

NO_CHANGE = "no change was found that makes it feasible"  # Message without any suggestion
MAX_SUGGESTIONS = 3  # Maximum number of suggestions
