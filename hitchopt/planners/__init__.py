"""Floor 5: planners; each takes a hitch and limits and gives trajectories.

All have in common a problem that can be looked at, and its solution.
"""

from __future__ import annotations

from typing import Protocol, TypeVar

Problem_co = TypeVar("Problem_co", covariant=True)
Solution_co = TypeVar("Solution_co", covariant=True)


class Planner(Protocol[Problem_co, Solution_co]):
    """A strategy, as a frozen record of what it is asked; making one computes nothing."""

    @property
    def problem(self) -> Problem_co:
        """What is asked as data, before it is solved: a path, first guesses, a task.

        Raises InfeasibleError where it cannot be solved in itself.
        """

    def solve(self) -> Solution_co:
        """Return the solution.

        Raises
        ------
        InfeasibleError: the problem cannot be solved; it says what binds.
        HitchoptError: no solution was found.
        """
