"""The planner: guesses, convex programs, and the certificate that ends the search."""

from __future__ import annotations

from collections.abc import Callable

from hitchopt.planners.separation.task import Separated, SeparationTask


def separate(task: SeparationTask, progress: Callable[[str], None] | None = None) -> Separated:
    """Return curves for all drones that keep all of the task for all of the time.

    Parameters
    ----------
    task: who flies from where to where, and what must hold.
    progress: called with what is being done now.

    Raises
    ------
    InfeasibleError: it cannot be met, or no way was found; the violations name the pair and the
        time.
    """
    raise NotImplementedError
