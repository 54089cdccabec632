"""The page of the records of steps."""

from __future__ import annotations

from hitchopt.steps import STEP_KINDS

PAGE = """# Steps in Python

Each step of a mission is a record, with the keys of problem files ({{doc}}`problem_file`) as arguments.

```{{eval-rst}}
.. currentmodule:: hitchopt

.. autosummary::
   :toctree: .
   :nosignatures:

{names}
```
"""


def write_steps_page() -> str:
    """Return the page."""
    return PAGE.format(names="\n".join(f"   {kind.__name__}" for kind in STEP_KINDS.values()))
