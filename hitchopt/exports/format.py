"""The interface of formats: the plans they write, and the recordings they read from files."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from hitchopt.exports.firmware import refuse_controllers
from hitchopt.exports.options import HOMES, STORAGES, ExportOptions
from hitchopt.exports.placing import Fleet, ReferenceFrame
from hitchopt.exports.recording import Recording
from hitchopt.hitch import Team
from hitchopt.hitch.flight_controller import CONTROLLERS
from hitchopt.motion.motion import Motion
from hitchopt.motion.states import (
    UPWARD,
    States,
    attitudes,
    iterate_states,
    sample_times,
    states_at,
)
from hitchopt.values import Array, check_choice

FLIPPED = np.array([1.0, -1.0, -1.0])  # Signs of axes that are turned by 180° about x


@dataclass(frozen=True, eq=False)
class Task:
    """A plan or a part of it, and everything that its files depend on."""

    motion: Motion  # from t = 0 on
    title: str
    frame: ReferenceFrame  # the file's axes, and where the plan lies in them
    fleet: Fleet  # who flies its drones
    rate: float  # samples a second of the formats that sample [Hz]
    options: ExportOptions  # what the user asked for
    begins: float = 0.0  # when in the plan the motion begins [s]; 0 unless the plan was cut
    number: int = 1  # which part of the plan the motion is, from 1 on
    part: str = ""  # description of that part; empty for the whole
    unheld: Motion | None = None  # the plan, where offsets of the motion hold its tension
    bound: float = 1.0  # error of refits over the usual one
    undetermined: tuple[str, ...] = ()  # why the files leave the cables' tension undetermined
    settings: Mapping[str, Any] = field(default_factory=dict)  # of receivers, for the manifest
    notes: tuple[str, ...] = ()  # what else the user should know of it

    @property
    def names(self) -> tuple[str, ...]:
        """Names (D,) that the files give the drones, in the plan's order."""
        return tuple(member.name for member in self.fleet.members)

    def samples(self, t: Array) -> dict[str, Array]:
        """Return the setpoints at times (S,) [s], in the file's axes, (S, D, 3) each.

        Besides the states there are ``yaw`` (S, D, 1) [rad]; ``feed_forward``, the acceleration for
        controllers that add gravity, ``a_ff = a - G F / m``, G being ``Team.pull_gain``;
        ``quaternions`` (S, D, 4), w, x, y, z, from the body's axes, whose z axis is along the
        thrust ``m (a_ff + g ẑ)``; and the ``body_rates`` [rad/s] about these. Where z points down
        the body's axes are forward, right, down, else forward, left, up. Where offsets hold the
        tension there are no cable forces.
        """
        return self._samples(states_at(self.motion, t))

    def heights(self, t: float) -> Array:
        """Return the drones' heights (D,) [m] above the floor at a time; set points may be off."""
        if self.unheld is None:
            places = self.motion.drones.at(t)
        else:
            places = self.unheld.drones.at(min(self.begins + t, self.unheld.duration))
        heights: Array = places[:, 2] - self.motion.requirements.floor
        return heights

    def blocks(self, rows: int) -> Iterator[tuple[Array, dict[str, Array]]]:
        """Yield times (S,) and samples at the task's rate, so many rows (time, drone) at once."""
        times = sample_times(self.motion.duration, self.rate)
        for states in iterate_states(self.motion, times, max(1, rows // len(self.names))):
            yield states.t, self._samples(states)

    def _samples(self, states: States) -> dict[str, Array]:
        frame, mass = self.frame, self.motion.team.mass[:, None]
        turned, heading = frame.vectors, frame.heading
        share = 0.0 if self.options.hold_tension else 1.0
        forces, force_rates = share * states.cable_forces, share * states.cable_force_rates
        gain = self.motion.team.pull_gain
        forward = states.accelerations - gain * forces / mass
        thrusts, rates = (
            turned(mass * (forward + UPWARD)),
            turned(mass * states.jerks - gain * force_rates),
        )
        flip = FLIPPED if turned(UPWARD)[2] < 0.0 else np.ones(3)
        attitude = attitudes(thrusts * flip, rates * flip, heading * flip[2])
        return {
            "positions": frame.points(states.positions),
            "velocities": turned(states.velocities),
            "accelerations": turned(states.accelerations),
            "jerks": turned(states.jerks),
            "yaw": np.full((*states.positions.shape[:-1], 1), heading),
            "cable_forces": turned(forces),
            "feed_forward": turned(forward),
            "quaternions": attitude.quaternions * [1.0, *flip],
            "body_rates": attitude.body_rates * flip,
        }


@dataclass(frozen=True, eq=False)
class Written:
    """Files, notes and facts that a format wrote into a folder."""

    files: tuple[str, ...]  # names
    notes: tuple[str, ...] = ()  # what the user should know of them
    receiver: Mapping[str, Any] = field(default_factory=dict)  # its settings, for the manifest


class Format(ABC):
    """One file format: what is written, and how files are read, of any origin."""

    name: str  # as given to ``--format``
    file: str  # its name, with ``{frame}``, ``{name}`` or ``{number}`` of the drone, ``{ending}``
    endings: tuple[str, ...]  # of the files that hold trajectories
    several: tuple[str, ...] = ()  # those of them of which every drone has a file
    header: str = "(?!)"  # pattern that the first line of its CSV files begins with, in lower case
    frames: tuple[str, ...]  # those that its files may be in, the usual one first
    rate: float = 0.0  # samples a second if nothing else is asked [Hz]; 0 where nothing is sampled
    accuracy: float  # the largest position error that it is meant to have [m]
    feed_forward: str  # whether the consumer needs the cable's pull, and what is done about it
    flown_by: str = "upload"  # or stream, with the pull in it, or nothing if it is not flown
    controllers: tuple[str, ...] = CONTROLLERS  # names of those that may fly the files
    streamed: float = 0.0  # least useful rate of samples that are sent in flight [Hz]; 0: none are
    dotted: bool = False  # whether drones of several teams may be called a.q0, not a_q0
    receiver_integral: bool = False  # whether controllers have one of which the team says nothing
    bounds: tuple[float, ...] = (1.0,)  # errors of refits over the usual one, tried in a row

    def settings(self, team: Team, options: ExportOptions) -> Mapping[str, Any]:
        """Return settings of receivers that fly a team.

        InputError tells of a named controller that does not fly the files.
        """
        refuse_controllers(team, self.controllers, self.name)
        return self.parameters(team, options)

    def parameters(self, team: Team, options: ExportOptions) -> Mapping[str, Any]:  # noqa: ARG002
        """Return the effect of ``settings`` on controllers that fly the files."""
        return {}

    @abstractmethod
    def write(self, folder: Path, task: Task) -> Written:
        """Write the files of a task, or raise InfeasibleError: the format cannot hold the plan."""

    @abstractmethod
    def load(self, files: Sequence[Path]) -> Recording:
        """Read files of any origin; raise FileError if they are damaged."""

    def read(self, folder: Path, task: Task) -> Recording:
        """Return the receiver's motion for a task's files.

        InfeasibleError tells that what they hold besides the flight breaks a limit.
        """
        return self.load([folder / name for name in self.files(task)])

    def files(self, task: Task) -> tuple[str, ...]:
        """Return the names of the files with the trajectories of a task."""
        fields = {"frame": task.frame.name, "ending": STORAGES[task.options.storage]}
        each = enumerate(task.names, 1)
        names = (self.file.format(name=name, number=i, **fields) for i, name in each)
        return tuple(dict.fromkeys(names))

    def parts(self, task: Task, share: float) -> Sequence[Task]:  # noqa: ARG002
        """Return a task cut into parts to be flown one after the other; nothing if none hold it.

        They are refitted within this share of the usual error.
        """
        return ()


def format_of(name: str) -> Format:
    """Return the format of that name; raise InputError if there is none."""
    check_choice("format", name, [*HOMES])
    module, _, kind = HOMES[name].partition(":")
    chosen: Format = getattr(import_module(f"hitchopt.exports.formats.{module}"), kind)()
    return chosen
