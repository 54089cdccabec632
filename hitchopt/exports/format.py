"""The interface of formats: write plans to files, and read their contents."""

from __future__ import annotations

import math
import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import numpy as np

from hitchopt.checks.certificate import Check
from hitchopt.drones.controllers import CONTROLLERS, STOCK
from hitchopt.errors import InputError, UnsupportedError, contained
from hitchopt.exports.contents import FileContents
from hitchopt.exports.firmware import refuse_controllers
from hitchopt.exports.held_tension import REST_TIME, held_tension
from hitchopt.exports.options import HOMES, STORAGES, ExportOptions, registered_formats
from hitchopt.exports.placing import AXES, Fleet, ReferenceFrame
from hitchopt.hitch import Team
from hitchopt.motion.flight import Flight
from hitchopt.motion.states import (
    HOVER,
    States,
    attitudes,
    flight_states_at,
    iterate_flight_states,
    sample_times,
)
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array, Indices, closest_word

FLIPPED = np.array([1.0, -1.0, -1.0])  # Signs of axes after a rotation by 180° about x
MAX_INT16 = 32.767  # Largest coordinate in integer millimetres of 16 bits, as in Crazyflies [m]


@dataclass(frozen=True, eq=False)
class ExportTask:
    """A plan or a part of it, and all options of its files.

    Drones are in the order of the problem, but those of the flight are in order along the hitch.
    """

    flight: Flight  # starts at t = 0; with setpoints as drones if offsets hold the tension
    title: str
    frame: ReferenceFrame  # the files' frame
    fleet: Fleet  # the drones
    rate: float  # sampling rate of formats with samples [Hz]
    options: ExportOptions
    begins: float = 0.0  # start of the part in the plan [s]
    number: int = 1  # number of the part, from 1
    part: str = ""  # description of the part; empty for the whole plan
    without_offsets: Flight | None = None  # the same without offsets that hold the tension, if any
    rest: float = 0.0  # duration of the rest that is added to the part's end [s]
    bound: float = 1.0  # factor of the usual refit error
    trailing: Check | None = None  # of the distances of drones that trail positions alone
    undetermined: tuple[str, ...] = ()  # reasons why the tension is undetermined
    settings: Mapping[str, Any] = field(default_factory=dict)  # of receivers, for the manifest
    notes: tuple[str, ...] = ()  # notes for the user
    plan_digest: str = ""  # of the plan's file, for the manifest
    stretch: float = 1.0  # factor of the plan's durations
    has_trims: bool = True  # whether setpoints include trims, which turn with the heading

    @property
    def trims(self) -> Array:
        """Setpoints minus planned positions (D, 3) [m] in the plan, in which drones' yaw is 0."""
        trims: Array = np.insert(self.flight.team.trim[self.order], 2, 0.0, axis=1)
        return trims if self.has_trims else 0.0 * trims

    @property
    def order(self) -> Indices:
        """(D,): indices of the drones in the flight."""
        return self.flight.team.listed

    @property
    def curves(self) -> PiecewisePolynomial:
        """Curves (D, 3) [m] of the drones in the plan."""
        drones = self.flight.drones
        return drones.replaced(drones.coefficients[:, self.order])

    @property
    def masses(self) -> Array:
        """(D,) [kg]: masses of the drones."""
        return self.flight.team.mass[self.order]

    def placed(self, part: PiecewisePolynomial) -> PiecewisePolynomial:
        """Return curves (D, 3) of drones [m] as setpoints in the files' frame."""
        return self.frame.placed(part.replaced(part.coefficients + self.trims[..., None]))

    @property
    def holds_tension(self) -> bool:
        """Return whether the flight has offsets to hold its tension."""
        return self.without_offsets is not None

    @property
    def plan(self) -> Flight:
        """The plan or the part of it, from t = 0, without offsets."""
        return self.flight if self.without_offsets is None else self.without_offsets

    @property
    def rests_longer(self) -> bool:
        """Return whether parts end with longer rests than the plan, until offsets are at rest."""
        is_alone = self.flight.alone is not None
        return self.options.longer_rests and self.holds_tension and is_alone

    @property
    def timeline(self) -> Flight:
        """The flight at whose rests parts are cut: the plan if they rest longer."""
        return self.plan if self.rests_longer else self.flight

    def stretched(self, factor: float) -> ExportTask:
        """Return the task of the plan flown slower by a factor."""
        slower = replace(self, flight=self.plan.stretched(factor), stretch=factor * self.stretch)
        if self.without_offsets is None:
            return slower
        held = held_tension(slower.flight, self.options.stiffness, self.options.damping)
        return replace(slower, flight=held.flight, without_offsets=slower.flight)

    def between(self, start: float, end: float) -> ExportTask:
        """Return the task of the part between two times [s] of the flight at which drones rest.

        If parts rest longer, the times are those of the plan, and the part has offsets of its own.
        """
        part = replace(self, begins=start)
        if self.rests_longer:
            plan = self.plan.between(start, end)
            held = held_tension(plan, self.options.stiffness, self.options.damping)
            return replace(part, flight=held.flight, without_offsets=plan, rest=REST_TIME)
        if self.without_offsets is not None:
            part = replace(part, without_offsets=self.without_offsets.between(start, end))
        return replace(part, flight=self.flight.between(start, end))

    @property
    def names(self) -> tuple[str, ...]:
        """Names (D,) of the drones in the files."""
        return tuple(member.name for member in self.fleet.members)

    def samples(self, t: Array) -> dict[str, Array]:
        """Return the setpoints at times (S,) [s] in the files' frame, (S, D, 3) each.

        In addition to the states: ``yaw`` (S, D, 1) [rad]; ``feed_forward``, the acceleration for
        controllers that add gravity, ``a_ff = a - G F / m`` with G F = ``States.held_forces``;
        ``quaternions`` (S, D, 4), w, x, y, z, from the body frame, whose z axis is along the thrust
        ``m (a_ff + g ẑ)``; and ``body_rates`` [rad/s] in the body frame. In frames with z down, the
        body axes are forward, right, down, otherwise forward, left, up. If offsets hold the
        tension, cable forces are zero.
        """
        return self._samples(flight_states_at(self.flight, t).listed(self.flight.team))

    def planned(self, t: float) -> Array:
        """Return the drones' positions (D, 3) [m] in the plan at a time, without offsets."""
        return self.plan.drones.at(min(t, self.plan.duration))[self.order]

    def heights(self, t: float) -> Array:
        """Return the drones' heights (D,) [m] above the floor at a time, without offsets.

        They are infinite without one.
        """
        heights: Array = self.planned(t)[:, 2] - self.flight.requirements.ground_or(-math.inf)
        return heights

    def blocks(self, rows: int) -> Iterator[tuple[Array, dict[str, Array]]]:
        """Yield times (S,) and samples at the task's rate, in blocks of rows (time, drone).

        Raises UnsupportedError if the class of the format states no rate.
        """
        if not self.rate:
            words = "samples without a rate: set the attribute rate [Hz] of its class"
            raise UnsupportedError(f"the format {self.options.format} {words}")
        times = sample_times(self.flight.duration, self.rate)
        for states in iterate_flight_states(self.flight, times, max(1, rows // len(self.names))):
            yield states.t, self._samples(states.listed(self.flight.team))

    def _samples(self, states: States) -> dict[str, Array]:
        frame = self.frame
        mass = self.masses[:, None]
        rotated, heading = frame.vectors, frame.heading
        share = 0.0 if self.holds_tension else 1.0
        false_pull = self.flight.team.false_pull[self.order]
        forward = states.accelerations - share * states.held_forces(false_pull) / mass
        thrusts = rotated(mass * (forward + HOVER))
        rates = rotated(mass * states.jerks - share * states.held_force_rates(false_pull))
        flip = FLIPPED if rotated(HOVER)[2] < 0.0 else np.ones(3)
        attitude = attitudes(thrusts * flip, rates * flip, heading * flip[2])
        return {
            "positions": frame.points(states.positions + self.trims),
            "velocities": rotated(states.velocities),
            "accelerations": rotated(states.accelerations),
            "jerks": rotated(states.jerks),
            "yaw": np.full((*states.positions.shape[:-1], 1), heading),
            "cable_forces": rotated(share * states.cable_forces),
            "feed_forward": rotated(forward),
            "quaternions": attitude.quaternions * [1.0, *flip],
            "body_rates": attitude.body_rates * flip,
        }


@dataclass(frozen=True, eq=False)
class FormatOutput:
    """Files, notes and receiver settings of one export."""

    files: tuple[str, ...]  # names
    notes: tuple[str, ...] = ()  # notes for the user
    receiver: Mapping[str, Any] = field(default_factory=dict)  # settings, for the manifest


class Format(ABC):
    """A file format, with a writer and a reader.

    Packages register subclasses as entry points of the group ``hitchopt.formats``, by their name.
    The first line of the docstring of a subclass describes it in lists.
    """

    name: str  # value of ``--format``, and name of the entry point
    file: str  # file name, with ``{frame}``, ``{name}`` or ``{number}`` of the drone, ``{ending}``
    endings: tuple[str, ...]  # suffixes of files with trajectories
    several: tuple[str, ...] = ()  # suffixes of files that each have one drone
    header: str = "(?!)"  # pattern of the first line of CSV files, in lower case
    frames: tuple[str, ...]  # supported frames, the default first
    rate: float = 0.0  # default sampling rate [Hz]; 0 for formats without samples
    accuracy: float  # maximum position error [m]
    reach: float = MAX_INT16  # largest coordinate that receivers can store [m]
    feed_forward: str  # description of the feed-forward of cable forces
    flown_by: str = "upload"  # upload, stream (with cable forces), or empty if it is not flown
    controllers: tuple[str, ...] = CONTROLLERS  # names of controllers that can fly the files
    needs_stiffness: bool = True  # whether tensions are lost if the stiffness is unknown
    has_gains: bool = False  # whether gains of the position loops are exported
    stiffest: float = STOCK["mellinger"].stiffest[0]  # stiffness of its loops over mass [1/s²]
    streamed: float = 0.0  # minimum rate of samples sent in flight [Hz]; 0 if none are
    dotted: bool = False  # whether drones of several teams may be called a.q0, not a_q0
    has_heading: bool = True  # whether files determine the drones' heading
    # receivers' settings by which they follow velocities, if these are not in the files
    velocity_settings: str = ""
    bounds: tuple[float, ...] = (1.0,)  # candidate factors of the usual refit error

    def settings(self, team: Team, options: ExportOptions) -> Mapping[str, Any]:
        """Return the receiver settings for a team.

        Raises InputError for a named controller that cannot fly the files.
        """
        refuse_controllers(team, self.controllers, self.name)
        return self.parameters(team, options)

    def parameters(self, team: Team, options: ExportOptions) -> Mapping[str, Any]:  # noqa: ARG002
        """Return the receiver settings for a team with supported controllers."""
        return {}

    @abstractmethod
    def write(self, folder: Path, task: ExportTask) -> FormatOutput:
        """Write the files of a task; raises InfeasibleError if the format cannot hold the plan."""

    @abstractmethod
    def load(self, files: Sequence[Path]) -> FileContents:
        """Read files from any source; raises FileError if they are damaged."""

    def sent(self, files: Sequence[Path], manifest: Mapping[str, Any]) -> FileContents:  # noqa: ARG002
        """Read exported files of a plan as a receiver gets them, from the plan's start on.

        Drones have the names of the manifest; streamed accelerations include cable forces.
        """
        return self.load(files)

    def read(self, folder: Path, task: ExportTask) -> FileContents:
        """Return the receiver's motion for a task's files.

        Raises InfeasibleError if other contents, such as coordinated returns, violate a limit.
        """
        return self.load([folder / name for name in self.files(task)])

    def files(self, task: ExportTask) -> tuple[str, ...]:
        """Return the names of the trajectory files of a task."""
        fields = {"frame": task.frame.name, "ending": STORAGES[task.options.storage]}
        each = enumerate(task.names, 1)
        names = (self.file.format(name=name, number=i, **fields) for i, name in each)
        return tuple(dict.fromkeys(names))

    def parts(
        self,
        task: ExportTask,  # noqa: ARG002
        share_of: Callable[[ExportTask], float],  # noqa: ARG002
    ) -> Sequence[ExportTask]:
        """Return a task cut into parts that are flown one by one; empty if that is not possible.

        ``share_of`` returns the fraction of the usual refit error that a part may have.
        """
        return ()


def format_of(name: str) -> Format:
    """Return the format with a name.

    Raises InputError if it is unknown, and UnsupportedError if the package that registers it has
    none that can be used.
    """
    formats = registered_formats()
    if name not in formats:
        remedy = closest_word(str(name), [*formats], "hitchopt export lists them")
        raise InputError("format", name, f"one of {', '.join(formats)}", remedy)
    return _loaded(formats[name])


def usable_formats() -> list[Format]:
    """Return all formats, those of hitchopt first; a FaultWarning names each that is unusable."""
    formats = list[Format]()
    for entry in registered_formats().values():
        with contained("loading formats"):
            formats.append(_loaded(entry))
    return formats


def own_endings() -> tuple[str, ...]:
    """Return the suffixes of files with trajectories in the formats of hitchopt."""
    return tuple(sorted({ending for name in HOMES for ending in format_of(name).endings}))


def _loaded(entry: EntryPoint) -> Format:
    """Return the format of an entry point; raises UnsupportedError, in one line, if it is none."""
    try:
        kind: Format = entry.load()()
        _check_format(kind, entry.name)
    except Exception as error:  # any, since other packages raise it
        package = "hitchopt" if entry.dist is None else entry.dist.name
        reason = f"{entry.value} of {package} cannot be used: {type(error).__name__}: {error}"
        line = f"format {entry.name}: {reason}; update or uninstall {package}"
        raise UnsupportedError(" ".join(line.split())) from error
    return kind


def _check_format(kind: Format, name: str) -> None:
    """Raise TypeError, ValueError or re.error if a registered object cannot be used as a format."""
    if not isinstance(kind, Format):
        raise TypeError("is not derived from hitchopt.exports.format.Format")
    if missing := [each for each in Format.__annotations__ if not hasattr(kind, each)]:
        raise TypeError(f"states no {', '.join(missing)}")
    for key in ("endings", "several", "frames"):
        if not isinstance(getattr(kind, key), tuple):
            raise TypeError(f"{key} = {getattr(kind, key)!r} is not a tuple")
    if unknown := [frame for frame in kind.frames if frame not in AXES]:
        raise ValueError(f"frame {unknown[0]} is not one of {', '.join(AXES)}")
    if kind.name != name:
        raise ValueError(f"is registered as {name}, and its name is {kind.name}")
    re.compile(kind.header)
