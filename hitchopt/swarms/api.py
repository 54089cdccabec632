"""The Python interface of single drones."""

from __future__ import annotations

from pathlib import Path

from hitchopt.api import loaded, solve
from hitchopt.errors import Progress
from hitchopt.mission.problem import Problem
from hitchopt.plan import Plan
from hitchopt.values.fields import suggest_keywords


@suggest_keywords
def separate(
    problem: Problem | str | Path,
    progress: Progress | None = None,
    *,
    limit: float | None = None,
) -> Plan:
    """Return the certified plan of a problem of single drones that avoid each other's downwash.

    Arguments and errors are those of ``solve``.
    """
    return solve(loaded(problem, "swarm"), progress=progress, limit=limit)
