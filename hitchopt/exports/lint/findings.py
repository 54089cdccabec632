"""What a lint says."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from hitchopt.checks.certificate import Check
from hitchopt.exports.lint.show_limits import ShowLimits
from hitchopt.exports.recording import Recording

ERROR, WARNING, NOTE = "error", "warning", "note"
"""It will go wrong; it may; it is good to know."""


FARTHEST = 1e6
"""[m] No drone is farther from its origin: sums and squares of such numbers stay finite."""


@dataclass(frozen=True)
class Finding:
    """One thing to be said.

    Attributes
    ----------
    level: ERROR, WARNING or NOTE.
    rule: in one word or two, such as ``memory`` or ``end marker``.
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


@dataclass(frozen=True)
class DroneFacts:
    """What one drone's file amounts to.

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
    """What a path holds, read.

    Attributes
    ----------
    kind: of format, as in ``hitchopt export --format``.
    recording: what the drones fly.
    facts: one per drone.
    findings: what has been seen while reading.
    streamed: whether samples are sent in flight: gaps between them count then.
    places: where drones stand before the flight, (2,) or (3,) [m], by name, as far as known.
    place_key: what the files call that.
    own: the limits that a show sets itself.
    together: whether all trajectories are in one frame, so that distances mean something.
    """

    kind: str
    recording: Recording
    facts: tuple[DroneFacts, ...]
    findings: tuple[Finding, ...] = field(default=())
    streamed: bool = False
    places: Mapping[str, Sequence[float]] = field(default_factory=dict)
    place_key: str = "place"
    own: ShowLimits | None = None
    together: bool = True


@dataclass(frozen=True)
class Flight:
    """What the drones of a folder fly together, over all of the time.

    Attributes
    ----------
    duration: [s]
    speed, acceleration: the largest of any drone [m/s], [m/s²]; nan where the files have none.
    separation: smallest ratio over pairs, 1 where ellipsoids touch; inf for one drone, nan where
        trajectories are relative to places that are not known.
    jumps: the largest between pieces, of position [m], velocity [m/s] and acceleration [m/s²], as
        far as the format means them to be smooth.
    reach: the largest coordinate, control points included [m].
    speed_limit, acceleration_limit: what those two are held against [m/s], [m/s²]; inf where only
        the show's own limits are.
    own: the show's own limits, held against it.
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
    """All that is to be said of a path.

    Attributes
    ----------
    path: what was read.
    kind: of format.
    frame: enu, nwu or ned; empty where the files do not say.
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
