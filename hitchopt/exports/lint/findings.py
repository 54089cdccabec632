"""Findings, reports, and the records that the readers and rules of the lint exchange."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import SupportsInt, TypeGuard

from hitchopt.checks.certificate import Check
from hitchopt.exports.lint.show_limits import ShowLimits
from hitchopt.exports.recording import Recording

ERROR, WARNING, NOTE = LEVELS = ("error", "warning", "note")
"""Levels of a finding: the flight fails; it may fail; information for the pilot."""

FARTHEST = 1e6
"""[m] No drone is farther from its origin: sums and squares of such numbers stay finite."""


@dataclass(frozen=True)
class Finding:
    """One problem, or one piece of information, found in fleet files.

    Attributes
    ----------
    level: ERROR, WARNING or NOTE.
    rule: name of the rule in one word or two, such as ``memory`` or ``end marker``.
    where: drone or file; empty for all of them.
    message: value, bound, and the remedy.
    """

    level: str
    rule: str
    where: str
    message: str

    def __str__(self) -> str:
        place = f" {self.where}:" if self.where else ""
        return f"{self.level}: {self.rule}:{place} {self.message}"


error, warning, note = (partial(Finding, level) for level in (ERROR, WARNING, NOTE))
"""Constructors of findings of each level from rule, place and message."""


def and_more(name: str, count: SupportsInt) -> str:
    """Return the name, and how many more of the ``count`` drones are concerned."""
    return name if int(count) == 1 else f"{name} and {int(count) - 1} more"


def is_place(value: object, lengths: Collection[int]) -> TypeGuard[list[float]]:
    """Return whether a value from a file is a list of so many coordinates within FARTHEST [m]."""
    return (
        isinstance(value, list)
        and len(value) in lengths
        and all(type(x) in {int, float} and abs(x) <= FARTHEST for x in value)
    )


@dataclass(frozen=True)
class DroneFacts:
    """Size and duration of one drone's file.

    Attributes
    ----------
    name: of the drone.
    pieces: of its curve; 0 where it is sampled.
    size: [bytes] in the drone's memory; 0 where it is not uploaded.
    duration: [s] of its own file; 0 where all drones share their times.
    """

    name: str
    pieces: int = 0
    size: int = 0
    duration: float = 0.0


@dataclass(frozen=True, eq=False)
class Loaded:
    """Contents of a path, read.

    Attributes
    ----------
    kind: of format, as in ``hitchopt export --format``.
    recording: what the drones fly.
    facts: one per drone.
    findings: those made while reading.
    streamed: whether samples are sent in flight: gaps between them count then.
    places: where drones stand before the flight, (2,) or (3,) [m], by name, as far as known.
    place_key: name of these places in the files.
    own: limits that a show sets itself.
    together: whether all trajectories are in one frame, so that distances mean something.
    """

    kind: str
    recording: Recording
    facts: tuple[DroneFacts, ...]
    findings: tuple[Finding, ...] = field(default=())
    streamed: bool = False
    places: Mapping[str, Sequence[float]] = field(default_factory=dict)
    place_key: str = "place"
    own: ShowLimits = field(default_factory=ShowLimits)
    together: bool = True


@dataclass(frozen=True)
class Flight:
    """Figures of the drones' joint flight over all of the time.

    Attributes
    ----------
    duration: [s]
    speed, acceleration: the largest of any drone [m/s], [m/s²]; nan where the files have none.
    separation: smallest ratio over pairs, 1 where ellipsoids touch; inf for one drone, nan where
        trajectories are relative to places that are not known.
    jumps: the largest between pieces, of position [m], velocity [m/s] and acceleration [m/s²], as
        far as the format means them to be smooth.
    reach: the largest coordinate, control points included [m].
    speed_limit, acceleration_limit: limits of these two [m/s], [m/s²]; inf where only the show's
        own limits apply.
    own: checks of the show's own limits.
    """

    duration: float
    speed: float
    acceleration: float
    separation: float
    jumps: tuple[float, ...]
    reach: float
    speed_limit: float
    acceleration_limit: float
    own: tuple[Check, ...] = ()


@dataclass(frozen=True)
class Report:
    """Findings and figures of a path.

    Attributes
    ----------
    path: file or folder that was read.
    kind: of format.
    frame: enu, nwu or ned; empty where the files do not state it.
    facts: one per drone.
    flight: of all drones together.
    findings: the errors first.
    """

    path: Path
    kind: str
    frame: str
    facts: tuple[DroneFacts, ...]
    flight: Flight
    findings: tuple[Finding, ...]

    @property
    def sound(self) -> bool:
        """Whether there is no error; warnings are for the pilot to judge."""
        return all(finding.level != ERROR for finding in self.findings)
