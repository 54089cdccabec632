"""States of cables: one record for each, of which all other modules ask what they need."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass
from typing import ClassVar

from hitchopt.errors import OneLine


@dataclass(frozen=True)
class CableState(OneLine):
    """State of the cables in a phase; the certificate verifies it from the polynomials."""

    word: str  # Its name in plan files, reports and messages
    _: KW_ONLY
    has_cables: bool = True  # False for single drones
    on_ground: bool = False  # Cables lie at least partly on it; drones fly straight up or down
    linked: bool = False  # Neighbouring cables may hold each other
    tied: bool = False  # They do: their crossing number is ±1, and vertices are possible clasps
    pulls: bool = False  # Planned tensions pull drones toward ``Motion.pull_points``
    hitched: bool = False  # Cables are taut; vertices, legs and tensions have a meaning

    NONE: ClassVar[CableState]
    GROUND: ClassVar[CableState]
    FREE: ClassVar[CableState]
    CLASPING: ClassVar[CableState]
    LOOSE: ClassVar[CableState]
    TIGHTENING: ClassVar[CableState]
    HITCHED: ClassVar[CableState]

    def __str__(self) -> str:
        return self.word

    @classmethod
    def of(cls, word: object) -> CableState:
        """Return the state with a word; raise ValueError without one."""
        for state in STATES:
            if state.word == word:
                return state
        raise ValueError(f"{word!r} is not a valid {cls.__name__}")

    @property
    def slack(self) -> bool:
        """Return whether cables exist that are slack or lie on the ground."""
        return self.has_cables and not self.hitched

    @property
    def hangs(self) -> bool:
        """Return whether slack cables hang from both drones, at known heights."""
        return self.slack and not self.on_ground and not self.loose

    @property
    def clasped(self) -> bool:
        """Return whether neighbouring cables may hold each other although no hitch exists."""
        return self.linked and not self.hitched

    @property
    def clasping(self) -> bool:
        """Return whether drones of neighbouring cables turn about each other."""
        return self.linked and not self.tied

    @property
    def loose(self) -> bool:
        """Return whether tied cables are slack since another one was lost at the start."""
        return self.tied and not self.pulls

    @property
    def tightening(self) -> bool:
        """Return whether tied cables are being tightened to a hitch, or loosened."""
        return self.pulls and not self.hitched


CableState.NONE = CableState("none", has_cables=False)
CableState.GROUND = CableState("on the ground", on_ground=True)
CableState.FREE = CableState("hanging free")
CableState.CLASPING = CableState("clasping", linked=True)
CableState.LOOSE = CableState("loose after a loss", linked=True, tied=True)
CableState.TIGHTENING = CableState("being tightened", linked=True, tied=True, pulls=True)
CableState.HITCHED = CableState("hitched", linked=True, tied=True, pulls=True, hitched=True)

STATES = (
    *(CableState.NONE, CableState.GROUND, CableState.FREE, CableState.CLASPING),
    *(CableState.LOOSE, CableState.TIGHTENING, CableState.HITCHED),
)
"""All states, from drones without cables to a hitch."""

StateTest = Callable[[CableState], bool]
"""A question about a state, such as ``lambda state: state.hangs``."""
