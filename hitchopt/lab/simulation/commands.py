"""Setpoints as flight controllers receive them: streamed packets, or uploaded curves."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from hitchopt.errors import InfeasibleError, InputError
from hitchopt.exports.exporting import Export, export_flight
from hitchopt.exports.formats.crazyflie import CompressedBytes, CrazyflieFormat, Crazyswarm2
from hitchopt.exports.options import ExportOptions
from hitchopt.hitch import Quadrotor, Team
from hitchopt.hitch.flight_controller import HELD, STOCK, Gains, latency_scale
from hitchopt.lab.simulation.settings import IDEAL, Settings
from hitchopt.lab.simulation.task import RATE, Task
from hitchopt.motion.flight import Flight
from hitchopt.motion.states import HOVER, attitudes
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array
from hitchopt.values.fields import with_fields

QUANTUM = 1e-3  # Resolution of a full-state packet [m], [m/s], [m/s²], [rad/s]
MAX_COUNT = 32767  # Largest 16-bit number of a packet

PACKET_RATES = ("mellinger",)  # Controllers that follow body rates of a packet
CURVE_RATES = ("mellinger", "lee")  # Controllers that follow body rates from the jerk of curves


@dataclass(frozen=True, eq=False)
class Commands:
    """Setpoints at some times (…); yaw is 0."""

    positions: Array  # (…, 2n, 3) [m]
    velocities: Array  # (…, 2n, 3) [m/s]
    accelerations: Array  # (…, 2n, 3) [m/s²]; less F / m if the force F of cables is fed forward
    rates: Array  # (…, 2n, 3) [rad/s], about the bodies' axes

    @classmethod
    def joined(cls, each: Sequence[Commands]) -> Commands:
        """Return the samples of several teams; those that end early hold their last one."""
        samples = np.arange(max(len(commands.positions) for commands in each))

        def joined(name: str) -> Array:
            columns = (getattr(commands, name).take(samples, 0, mode="clip") for commands in each)
            return np.concatenate([*columns], axis=1)

        return cls(*(joined(field.name) for field in fields(cls)))

    def __getitem__(self, index: int) -> Commands:
        """Return the setpoints of one sample, of the last one beyond it."""
        i = min(index, len(self.positions) - 1)
        return Commands(self.positions[i], self.velocities[i], self.accelerations[i], self.rates[i])


def resolved(task: Task, settings: Settings) -> Settings:
    """Return settings that state controller, estimator and upload: those of a task if left out.

    Exact states are None in these. Raise InputError for settings of a flight controller without
    one, or a latency without an estimator.
    """
    estimator, upload = settings.estimator, settings.upload
    if settings.controller is None:
        names = named_controllers(task)
        name = (names.pop() if len(names) == 1 else None) or IDEAL
        settings = replace(settings, controller=name)
        if name != IDEAL:
            if estimator is None and STOCK[name].filtered:
                estimator = HELD
            if upload is None:
                # Exported files would hold the tension by offsets
                teams = (flown_team(part.team, settings) for part in task.parts)
                upload = task.flight is not None and not settings.feedback
                upload = upload and not any(np.any(team.integral_gain > 0.0) for team in teams)
    estimator = None if estimator == IDEAL else estimator
    if settings.latency is not None and estimator is None:
        bound, remedy = "left out without an estimator", "add estimator='crazyflie'"
        raise InputError("latency", settings.latency, bound, remedy)
    return replace(settings, estimator=estimator, upload=bool(upload))


def named_controllers(task: Task) -> set[str | None]:
    """Return the names of the controllers of a task's drones, with None for drones without one."""
    return {kind.controller for part in task.parts for kind in part.team.quadrotor}


def flown_team(team: Team, settings: Settings) -> Team:
    """Return the team with the controller and gains of the settings."""
    return with_fields(
        team, quadrotor=tuple(_configured(kind, settings) for kind in team.quadrotor)
    )


def _configured(kind: Quadrotor, settings: Settings) -> Quadrotor:
    name, gains = settings.controller or "", settings.gains
    if gains is None and kind.controller == name and settings.stiffness is None:
        return kind
    k, c = STOCK[name].stiffest
    if gains is None and math.isfinite(k):  # other controllers have stock gains
        scale = latency_scale(kind.latency)
        stiffness = settings.stiffness or kind.stiffness or scale**2 * k * kind.mass
        damping = c * math.sqrt(stiffness * kind.mass / k)
        gains = Gains(kp=stiffness, kd=damping, ki=0.0)
    return Quadrotor(kind.mass, kind.max_thrust, controller=name, gains=gains)


def received(task: Task, team: Team, settings: Settings) -> Commands:
    """Return the setpoints of a task that a team's controllers receive, at RATE.

    Raises InputError for an upload without a plan, InfeasibleError for a plan too large for it.
    """
    if not settings.upload:
        return streamed(task, team, follows=settings.controller in PACKET_RATES)
    if task.flight is None:
        raise InputError("upload", True, "with a plan", "give the plan's directory")
    return uploaded(task.flight, team, follows=settings.controller in CURVE_RATES)


def streamed(task: Task, team: Team, *, follows: bool) -> Commands:
    """Return the rounded packets of full states, with body rates if ``follows``."""
    setpoints, mass = task.states, team.mass[:, None]
    forward = setpoints.accelerations - team.pull_gain * setpoints.cable_forces / mass
    rates = _body_rates(mass, forward, task.states.t, follows=follows)
    values = setpoints.positions, setpoints.velocities, forward, rates
    counts = (np.rint(x / QUANTUM) for x in values)
    return Commands(*(QUANTUM * np.clip(x, -MAX_COUNT, MAX_COUNT) for x in counts))


def uploaded(flight: Flight, team: Team, *, follows: bool) -> Commands:
    """Return setpoints as drones evaluate uploaded files.

    Offsets hold the cables' tension, as controllers add no cable force to uploads. Controllers with
    integrals would remove offsets: they fly the export for drones without a named controller.
    """
    hold_tension = not np.any(team.integral_gain > 0.0)
    unnamed = tuple(Quadrotor(kind.mass, kind.max_thrust) for kind in team.quadrotor)
    kinds = tuple(kind.uncalibrated for kind in team.quadrotor) if hold_tension else unnamed
    flown = with_fields(team, quadrotor=kinds)
    flight = flight.each_team(lambda motion: motion.replaced(team=flown))
    refusals = []
    for kind in (Crazyswarm2(), CompressedBytes()):  # the second one has three times the capacity
        options = ExportOptions(kind.name, allow_slack=not hold_tension, longer_rests=False)
        try:
            with tempfile.TemporaryDirectory() as folder:
                parts = export_flight(flight, "", options, folder)
                curves = [_read(kind, part, team.drone_names) for part in parts]
            break
        except InfeasibleError as error:
            refusals.append(error)
    else:
        raise refusals[0]
    starts = [part.begins for part in parts]
    end = starts[-1] + max(curve.duration for curve in curves[-1])
    t = np.arange(np.ceil(RATE * end) + 1) / RATE
    at = np.searchsorted(starts, t + 1e-9, side="right") - 1
    jets = np.zeros((3, len(t), team.drones, 3))
    for i, (start, part) in enumerate(zip(starts, curves, strict=True)):
        current = at == i
        for d, curve in enumerate(part):
            elapsed = t[current] - start
            jet = curve.jet(np.minimum(elapsed, curve.duration), 3)
            jets[:, current, d] = np.moveaxis(jet, -1, 0)
            jets[1:, current & (t > start + curve.duration), d] = 0.0  # it hovers at the end
    rates = _body_rates(team.mass[:, None], jets[2], t, follows=follows)
    return Commands(jets[0], jets[1], jets[2], rates)


def _read(kind: CrazyflieFormat, part: Export, names: Sequence[str]) -> list[PiecewisePolynomial]:
    """Return the curves (3,) of all drones from exported files."""
    files = (kind.file.format(name=name, frame=kind.frames[0]) for name in names)
    return [kind.upload(part.folder / file).curve for file in files]


def _body_rates(mass: Array, accelerations: Array, t: Array, *, follows: bool) -> Array:
    """Return body rates (samples, 2n, 3) [rad/s] of free drones with some accelerations.

    Rates are zero at the last time, whose setpoint is held.
    """
    rates = np.zeros_like(accelerations)
    if follows:
        thrusts = mass * (accelerations + HOVER)
        rates[:-1] = attitudes(thrusts, np.gradient(thrusts, t, axis=0)).body_rates[:-1]
    return rates
