"""Setpoints as flight controllers receive them: streamed packets, or uploaded curves."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hitchopt.drones.controllers import (
    CONTROLLERS,
    HELD,
    STOCK,
    FlightController,
    Gains,
    latency_scale,
)
from hitchopt.errors import InputError
from hitchopt.exports.exporting import Export, export_flight
from hitchopt.exports.formats.crazyflie import CrazyflieFormat, Crazyswarm2
from hitchopt.exports.options import ExportOptions
from hitchopt.hitch import Quadrotor, Team
from hitchopt.lab.simulation.settings import DRONES, ESTIMATORS, IDEAL, Settings
from hitchopt.lab.simulation.task import RATE, Commands, Received, Task, TeamTask
from hitchopt.motion.flight import Flight
from hitchopt.motion.plan_file import SavedPlan
from hitchopt.motion.states import HOVER, attitudes
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array, alternatives, counted
from hitchopt.values.fields import with_fields

QUANTUM = 1e-3  # Resolution of a full-state packet [m], [m/s], [m/s²], [rad/s]
MAX_COUNT = 32767  # Largest 16-bit number of a packet

PACKET_RATES = ("mellinger",)  # Controllers that follow body rates of a packet
CURVE_RATES = ("mellinger", "lee")  # Controllers that follow body rates from the jerk of curves


def resolved(task: Task, settings: Settings) -> Settings:
    """Return settings that state controller, estimator and upload: those of a task if omitted.

    Exact states are None in these. Raise InputError for settings of a flight controller without
    one, or a latency without an estimator.
    """
    if settings.drones is not None:
        settings = _of_drones(task, settings)
    if task.received is not None:
        settings = _of_files(task.received, settings)
    if settings.controller is None:
        settings = _of_plan(task, settings)
    estimator = None if settings.estimator == IDEAL else settings.estimator
    if settings.latency is not None and estimator is None:
        _refuse_latency(task, settings)
    return replace(settings, estimator=estimator, upload=bool(settings.upload))


def _of_plan(task: Task, settings: Settings) -> Settings:
    """Return settings with the controller that all drones of a plan name, or the ideal one.

    By default its drones have the estimator of its kind, and fly uploaded trajectories where these
    need no offsets to hold the tension.
    """
    names = named_controllers(task)
    common_name = next(iter(names)) if len(names) == 1 else None
    controller = common_name or IDEAL  # Drones name several, or none
    if controller == IDEAL:
        _require_controller(settings, names)
        return replace(settings, controller=controller)
    settings = replace(settings, controller=controller)
    estimator = settings.estimator
    if estimator is None and STOCK[controller].filtered:
        estimator = HELD
    upload = settings.upload
    if upload is None:
        teams = [flown_team(part.team, settings) for part in task.teams]
        needs_offsets = any(np.any(team.integral_gain > 0.0) for team in teams)
        upload = task.flight is not None and not needs_offsets
    return replace(settings, estimator=estimator, upload=upload)


def _refuse_latency(task: Task, settings: Settings) -> None:
    """Raise InputError for the latency of drones whose state is estimated without delay."""
    remedy = "add estimator=crazyflie"
    if task.received is not None and task.received.loops:
        remedy = "omit it: these files are for drones whose filter is not simulated"
    elif settings.controller == IDEAL:
        remedy = "add controller=mellinger and estimator=crazyflie"
    raise InputError("latency", settings.latency, "omitted without an estimator", remedy)


def _of_drones(task: Task, settings: Settings) -> Settings:
    """Return settings with controller and filter of ``settings.drones``, unless others are stated.

    Those of files and of plans stay. Raise InputError for files and controllers of other drones.
    """
    name = settings.drones or ""
    kind, loops = DRONES[name], () if task.received is None else task.received.loops
    if loops:
        if (own := loops[0].name) not in kind.controllers:
            bound = f"drones that fly these files, whose controller is {own}"
            raise InputError("drones", name, bound, "omit it, or export for these drones")
        return settings
    names = named_controllers(task)
    controller = settings.controller
    if controller is None:
        if len(names) == 1 and names <= {*kind.controllers}:
            return settings
        controller = kind.controllers[0]
    if controller not in kind.controllers:
        bound = f"{alternatives(kind.controllers)} with drones={name}"
        raise InputError("controller", controller, bound, "omit one of the two")
    estimator = settings.estimator or kind.estimator
    return replace(settings, controller=controller, estimator=estimator)


def _require_controller(settings: Settings, names: set[str | None]) -> None:
    """Raise InputError for settings of flight controllers, which the drones have not, or several.

    ``names`` are those of their controllers.
    """
    own = "name several controllers" if len(names) > 1 else "have no flight controller"
    bound = f"omitted for this plan, whose drones {own} (team.quadrotor.controller)"
    first, *others = CONTROLLERS
    remedy = f"add controller={first} (or {', '.join(others)})"
    for key in ("gains", "estimator", "upload"):
        if (value := getattr(settings, key)) and value != IDEAL:
            raise InputError(key, _shown(value), bound, remedy)


def _shown(value: object) -> object:
    """Return the value of a setting as it is stated: an estimator by its name."""
    names = (name for name, each in ESTIMATORS.items() if each == value)
    return next(names, value)


OF_LOOPS = ("controller", "gains", "estimator", "stiffness")
"""Settings that files state which hold gains."""


def _of_files(files: Received, settings: Settings) -> Settings:
    """Return settings with controller and filter of exported files, if these hold gains."""
    unstated = Settings()
    for name in ("upload", *(OF_LOOPS if files.loops else ())):
        if (value := getattr(settings, name)) != getattr(unstated, name):
            raise InputError(name, _shown(value), "omitted for an export", "its files state it")
    settings = replace(settings, upload=files.flown_by == "upload")
    if not files.loops:
        return settings
    name = files.loops[0].name
    estimator = (files.estimator or HELD) if STOCK[name].filtered else IDEAL
    return replace(settings, controller=name, estimator=estimator)


DEFAULTS = "defaults of its firmware"  # Source of gains that nobody states


def flown_gains(task: Task, settings: Settings) -> str:
    """Return in words the gains that fly exported files, and who states them."""
    reason = _reason_for_ideal(task, settings)
    settings, files = resolved(task, settings), task.received
    name = settings.controller or IDEAL
    if name == IDEAL:
        return f"gains: an ideal controller's; {reason}"
    if files is not None and files.loops:
        loops, source = files.loops, "those of the files"
    else:
        teams = [part.team for part in task.teams]
        loops = tuple(kind.loop for team in teams for kind in flown_team(team, settings).kinds)
        own = {kind for team in teams for kind in team.quadrotor}
        sources = {_source_of_gains(kind, settings) for kind in own}
        source = f"{' and '.join(sorted(sources))}, since the files contain none"
    loop, others = loops[0], "" if len({*loops}) == 1 else ", other drones differ"
    gains = ((key, getattr(loop, key)) for key in ("kp", "kd", "ki"))
    text = ", ".join(f"{key} [{level:.3g}, {upright:.3g}]" for key, (level, upright) in gains)
    return f"gains: {name} {text}{others}: {source}"


def _reason_for_ideal(task: Task, settings: Settings) -> str:
    """Return in words why the simplified controller flies settings that name no other."""
    if settings.controller == IDEAL:
        return "as requested"
    if len(named_controllers(task)) > 1:
        return "the plan names several flight controllers"
    return "files and plan name no flight controller"


def _source_of_gains(kind: Quadrotor, settings: Settings) -> str:
    """Return in words who states the gains with which a kind of drones flies the settings."""
    if settings.gains is not None or settings.stiffness is not None:
        return "as requested"
    if kind.controller == settings.controller:
        return "the plan's" if kind.gains is not None else DEFAULTS
    if math.isinf(STOCK[settings.controller or ""].stiffest[0]):
        return DEFAULTS
    return "the stiffest" if kind.stiffness is None else "of the plan's stiffness"


def named_controllers(task: Task) -> set[str | None]:
    """Return the names of the controllers of a task's drones, with None for drones without one."""
    return {kind.controller for part in task.teams for kind in part.team.quadrotor}


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
    if gains is None and math.isfinite(k):
        scale = latency_scale(kind.latency)
        stiffness = settings.stiffness or kind.stiffness or scale**2 * k * kind.mass
        damping = c * math.sqrt(stiffness * kind.mass / k)
        gains = Gains(kp=stiffness, kd=damping, ki=0.0)
    elif gains is None and settings.stiffness is not None:
        own = kind.gains if kind.controller == name else None
        gains = _scaled(FlightController.of(name, kind.mass, own), settings.stiffness)
    return Quadrotor(kind.mass, kind.max_thrust, controller=name, gains=gains)


def _scaled(loop: FlightController, stiffness: float) -> Gains:
    """Return the gains of a loop with another horizontal stiffness [N/m], and its damping ratio."""
    scale = stiffness / loop.kp[0]
    powers = {"kp": scale, "kd": math.sqrt(scale), "ki": scale}
    pairs = {key: tuple(x * gain for gain in getattr(loop, key)) for key, x in powers.items()}
    return Gains(**pairs)


def received(task: TeamTask, team: Team, settings: Settings) -> Commands:
    """Return the setpoints of a task that a team's controllers receive, at RATE.

    Raises InputError for an upload without a plan, InfeasibleError for a plan too large for it.
    """
    if not settings.upload:
        is_filtered = settings.estimator is not None
        false_pull = team.false_pull if is_filtered else np.zeros((team.drones, 3))
        return streamed(task, team, false_pull, follows=settings.controller in PACKET_RATES)
    if task.flight is None:
        raise InputError("upload", True, "with a plan", "pass the plan's directory")
    return uploaded(task.flight, team, follows=settings.controller in CURVE_RATES)


def streamed(task: TeamTask, team: Team, false_pull: Array, *, follows: bool) -> Commands:
    """Return the rounded packets of full states, with body rates if ``follows``.

    ``false_pull`` (2n, 3) is that of the filters that fly, as in ``States.held_forces``; zero if
    states are exact.
    """
    setpoints, mass = task.states, team.mass[:, None]
    forward = setpoints.accelerations - setpoints.held_forces(false_pull) / mass
    rates = body_rates(mass, forward, task.states.t, follows=follows)
    return packets(Commands(setpoints.positions, setpoints.velocities, forward, rates))


def packets(commands: Commands) -> Commands:
    """Return commands as they are rounded in the packets of full states."""
    arrays = commands.positions, commands.velocities, commands.accelerations, commands.rates
    counts = (np.clip(np.rint(x / QUANTUM), -MAX_COUNT, MAX_COUNT) for x in arrays)
    positions, velocities, accelerations, rates = (QUANTUM * count for count in counts)
    return Commands(positions, velocities, accelerations, rates, commands.files)


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
    kind = Crazyswarm2()
    options = ExportOptions(kind.name, allow_slack=not hold_tension, longer_rests=False)
    with tempfile.TemporaryDirectory() as folder:
        parts = export_flight(SavedPlan(flight), options, folder, simulated=True)
        curves = [_read(kind, part, team.drone_names) for part in parts]
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
    rates = body_rates(team.mass[:, None], jets[2], t, follows=follows)
    count = counted(len(parts), "part")
    options_given = f"longer_rests={options.longer_rests}, allow_slack={options.allow_slack}"
    words = f"{kind.name}, {count}, {options_given}"
    return Commands(jets[0], jets[1], jets[2], rates, words)


def _read(kind: CrazyflieFormat, part: Export, names: Sequence[str]) -> list[PiecewisePolynomial]:
    """Return the curves (3,) of all drones from exported files."""
    files = (kind.file.format(name=name, frame=kind.frames[0]) for name in names)
    return [kind.upload(part.folder / file).curve for file in files]


def body_rates(mass: Array, accelerations: Array, t: Array, *, follows: bool) -> Array:
    """Return body rates (samples, 2n, 3) [rad/s] of free drones with some accelerations.

    Rates are zero at the last time, whose setpoint is held.
    """
    rates = np.zeros_like(accelerations)
    if follows:
        thrusts = mass * (accelerations + HOVER)
        rates[:-1] = attitudes(thrusts, np.gradient(thrusts, t, axis=0)).body_rates[:-1]
    return rates
