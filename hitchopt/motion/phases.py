"""Phases of a plan, and the state of the cables in each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import pairwise

from hitchopt.errors import InputError
from hitchopt.one_line import OneLine

JOINT = 1e-6
"""[s] Phases meet within this, and cables change their state within this of a break."""


class CableState(StrEnum):
    """State of the cables in a phase; the certificate verifies it from the polynomials.

    While cables are not hitched, vertices, legs and tensions have no meaning, except that
    vertices are where the clasps may lie while cables are being tightened.
    """

    NONE = "none"
    """Single drones carry no cables."""
    GROUND = "on the ground"
    """Cables lie on the ground at least in part; drones rest, or fly straight up or down."""
    FREE = "hanging free"
    CLASPING = "clasping"
    """Drones of neighbouring cables turn about each other, to clasp the cables or to undo that."""
    TIGHTENING = "being tightened"
    """Clasped cables are drawn out to their full length, or slackened again."""
    HITCHED = "hitched"


FREE_STATES = frozenset(
    {CableState.GROUND, CableState.FREE, CableState.CLASPING, CableState.TIGHTENING}
)
"""States of cables without a hitch."""

HITCHED_STATE = frozenset({CableState.HITCHED})
"""The state in which the hitch exists, as a set."""


class HoldBy(StrEnum):
    """How a hitch holds an object."""

    REST = "rest"
    """Its rim lies on the clasps."""
    GRIP = "grip"
    """Cables are wrapped around its section."""


@dataclass(frozen=True)
class Hold:
    """What a hitch holds in a phase; the certificate verifies it from the polynomials.

    Attributes
    ----------
    object: name of the object.
    by: how it is held.
    cables: those that hold it, and may touch it.
    """

    object: str
    by: HoldBy
    cables: tuple[int, ...]


@dataclass(frozen=True)
class Phase(OneLine):
    """A span of a plan's time.

    Attributes
    ----------
    name: such as ``morph`` or ``hold``; a label that nothing depends on.
    step: index of the mission's step that it belongs to.
    start, end: [s]
    remark: what happens that was not asked for, and why; mostly nothing.
    state: of the cables.
    tension: smallest and largest tension [N] that the step allows during its motion; None where
        all tensions are the team's. Like the limits it is part of the problem: the check
        ``tension`` requires it within the phase, and the team's tensions at both of its ends.
    hold: what the hitch holds, from where its cables may touch that until they no longer do; None
        where it holds nothing.
    """

    name: str
    step: int
    start: float
    end: float
    remark: str = ""
    state: CableState = CableState.HITCHED
    tension: tuple[float, float] | None = None
    hold: Hold | None = None

    @property
    def formed(self) -> bool:
        """Whether the hitch exists; else the cables hang free, or slack in one another."""
        return self.state is CableState.HITCHED

    def lasting(self, start: float, end: float) -> Phase:
        """Return the same phase at other times [s]."""
        made = object.__new__(Phase)
        vars(made).update(vars(self), start=start, end=end)
        return made


def check_phases(phases: Sequence[Phase], start: float, end: float) -> None:
    """Raise InputError unless phases follow one another and cover the time from start to end [s].

    They may begin earlier and end later: a part of a motion has all phases that it overlaps.
    """
    if not phases:
        return
    good = phases[0].start <= start + JOINT and phases[-1].end >= end - JOINT
    good = good and phases[0].start < phases[0].end
    for a, b in pairwise(phases):
        good = good and -JOINT <= b.start - a.end <= JOINT and b.start < b.end
    if not good:
        raise InputError(
            "phases",
            [[phase.start, phase.end] for phase in phases],
            f"one after the other from {start:g} to {end:g} s, each ending after it starts",
            "give each phase the time from the end of the one before to its own end",
        )
