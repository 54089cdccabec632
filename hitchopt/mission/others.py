"""Other plans that fly at the same time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated

from hitchopt.checks import certify
from hitchopt.checks.certifying import rest_continuity
from hitchopt.errors import InputError
from hitchopt.motion.flight import Flight, TeamMotion
from hitchopt.motion.plan_file import saved_others
from hitchopt.storage.archive import PLAN
from hitchopt.values import ByValue, path
from hitchopt.values.fields import Key, dict_of, documented, mapping_of, store, strings
from hitchopt.values.units import START_TIME

MAX_TEAMS = 20  # Maximum number of teams, and of other plans, in a file

NAME = strings(20, 1, "[A-Za-z_][A-Za-z0-9_]*", "of letters, digits and _, a letter first")
"""Names of teams and of other plans."""


def named_teams(name: str, teams: Sequence[TeamMotion]) -> list[TeamMotion]:
    """Return teams with the prefix ``name``: ``name.a``, or ``name`` for a nameless team."""
    return [replace(each, name=".".join(filter(None, (name, each.name)))) for each in teams]


@documented
@dataclass(frozen=True, eq=False)
class Other(ByValue):
    """An external plan in the same airspace, at rest before and after.

    It is read and certified when the record is created.

    Raises
    ------
    InputError: a time before the start, or a plan whose own certificate does not hold, or that does
        not begin and end at rest.
    FileError: no plan there, or a damaged one.
    UnsupportedError: several teams, one with cables that are tied around an object.
    """

    plan: Annotated[
        Path | str, Key(strings(1000, 1), "Directory of the plan, relative to this file", "../show")
    ]
    at: Annotated[float, Key(START_TIME, "Start time on the clock of this plan")] = 0.0

    def __post_init__(self) -> None:
        store(self, plan=str(path("plan", self.plan)), at=self.at)
        certificate = certify(Flight(self._teams), reports=())
        if not certificate.certified:
            names = ", ".join(check.name for check in certificate.violated)
            bound = f"a plan whose certificate holds, unlike {names}"
            raise InputError("plan", self.plan, bound, "solve its problem again")
        whole = Flight(self._teams).breaks[[0, -1]] + [-1.0, 1.0]
        if (rest := rest_continuity(self._teams, *whole.tolist())) is not None and not rest.holds:
            names = ", ".join(rest.where)
            bound = f"a plan at rest at its start and end, unlike {names} at t = {rest.time:.4g} s"
            raise InputError("plan", self.plan, bound, "end it with hold")

    @cached_property
    def _teams(self) -> tuple[TeamMotion, ...]:
        return saved_others("", Path(self.plan) / PLAN, str(self.plan), self.at)

    def teams(self, name: str) -> Sequence[TeamMotion]:
        """Return its teams under a name, with times on the clock of this plan."""
        return named_teams(name, self._teams)


OTHERS = dict_of(mapping_of(Other), NAME, MAX_TEAMS)
