"""Plans of somebody else that fly besides."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated

from hitchopt.checks import certify
from hitchopt.errors import InputError, OneLine
from hitchopt.motion.motion import Group, Motion
from hitchopt.motion.plan_file import read_plan
from hitchopt.motion.retiming import shifted
from hitchopt.storage import files
from hitchopt.storage.archive import PLAN
from hitchopt.values.fields import Key, documented, mapping_of, named, store, texts
from hitchopt.values.units import START_TIME

MAX_GROUPS = 20
"""Largest number of teams, and of other plans, in a file."""

NAME = texts(20, 1, "[A-Za-z_][A-Za-z0-9_]*", "of letters, digits and _, a letter first")
"""Names of teams and of other plans."""


def groups_of(name: str, motion: Motion, at: float = 0.0, digest: str = "") -> Sequence[Group]:
    """Return the groups of a motion that begins at a time [s], their names after ``name``."""
    return [
        Group(f"{name}.{each.name}" if each.name else name, shifted(each.motion, at), digest)
        for each in motion.groups
    ]


@documented
@dataclass(frozen=True, eq=False)
class Other(OneLine):
    """A plan of somebody else that flies besides, at rest before and after.

    It is read and certified when the record is made.

    Raises
    ------
    InputError: a time before the start, or a plan whose own certificate does not hold.
    FileError: no plan there, or a damaged one.
    """

    plan: Annotated[
        Path | str, Key(texts(1000, 1), "Directory of the plan, relative to this file", "../show")
    ]
    at: Annotated[float, Key(START_TIME, "When it begins on the clock of this plan")] = 0.0

    def __post_init__(self) -> None:
        store(self, plan=str(self.plan), at=self.at)
        certificate = certify(self._motion, reports=())
        if not certificate.certified:
            names = ", ".join(check.name for check in certificate.violated)
            bound = f"a plan whose own certificate holds, not without {names}"
            raise InputError("plan", self.plan, bound, "solve its problem again")

    @property
    def file(self) -> Path:
        """The plan's file."""
        return Path(self.plan) / PLAN

    @cached_property
    def _motion(self) -> Motion:
        return read_plan(self.file)

    @cached_property
    def digest(self) -> str:
        """The SHA-256 of the plan's file."""
        return files.digest(self.file)

    def groups(self, name: str) -> Sequence[Group]:
        """Return its groups under a name, at their times on the clock of this plan."""
        return groups_of(name, self._motion, self.at, self.digest)


OTHERS = named(mapping_of(Other), NAME, MAX_GROUPS)
