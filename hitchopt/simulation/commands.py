"""Set points as flight controllers receive them: packets that are streamed, or uploaded curves."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hitchopt.errors import InfeasibleError, InputError
from hitchopt.exports.exporting import Export, export_motion
from hitchopt.exports.formats.crazyflie import CompressedBytes, CrazyflieFormat, Crazyswarm2
from hitchopt.exports.options import ExportOptions
from hitchopt.hitch import Quadrotor, Team
from hitchopt.hitch.flight_controller import Gains
from hitchopt.motion.motion import Motion
from hitchopt.motion.states import UPWARD, attitudes
from hitchopt.simulation.settings import Settings
from hitchopt.simulation.task import RATE, Task
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array

# Units of a full-state packet [m], [m/s], [m/s²], [rad/s], and its largest number, of 16 bits
QUANTUM, MOST = 1e-3, 32767

# Stiffest gains over the mass that fly, [1/s²] and [1/s]: what exports set where a team names no
# controller, or another one; of other controllers the stock ones
STIFFEST = {"mellinger": (36.0, 10.0), "lee": (14.0, 6.5)}

# Controllers that follow body rates: those of a packet, and those of curves' jerks
BODY_RATES, CURVES_RATES = ("mellinger",), ("mellinger", "lee")


@dataclass(frozen=True, eq=False)
class Commands:
    """Set points at some times (…); yaw is 0.

    Attributes
    ----------
    positions, velocities: (…, 2n, 3) [m], [m/s]
    accelerations: (…, 2n, 3) [m/s²]; where cables' forces F are fed forward, less F / m.
    rates: (…, 2n, 3) [rad/s], about the bodies' axes.
    """

    positions: Array
    velocities: Array
    accelerations: Array
    rates: Array

    def __getitem__(self, index: int) -> Commands:
        """Return the set points of one sample, of the last one for later ones."""
        last = len(self.positions) - 1
        return Commands(*(values[min(index, last)] for values in vars(self).values()))


def flown_team(team: Team, settings: Settings) -> Team:
    """Return the team as the settings' controller and gains fly it."""
    return replace(team, quadrotor=tuple(_piloted(kind, settings) for kind in team.quadrotor))


def _piloted(kind: Quadrotor, settings: Settings) -> Quadrotor:
    name, gains = settings.controller or "", settings.gains
    if gains is None and kind.controller == name and settings.stiffness is None:
        return kind
    if gains is None and name in STIFFEST:
        k, c = STIFFEST[name]
        stiffness = settings.stiffness or kind.stiffness or k * kind.mass
        damping = c * math.sqrt(stiffness * kind.mass / k)
        gains = Gains(kp=stiffness, kd=damping, ki=0.0)
    return Quadrotor(kind.mass, kind.max_thrust, controller=name, gains=gains)


def received(task: Task, team: Team, settings: Settings) -> Commands:
    """Return what the controllers of a team receive of a task, at RATE.

    Raises
    ------
    InputError: an upload of set points that are no plan's.
    InfeasibleError: a plan that uploads do not hold.
    """
    if not settings.upload:
        return streamed(task, team, follows=settings.controller in BODY_RATES)
    if task.motion is None:
        raise InputError("upload", True, "with a plan", "give the plan's directory")
    return uploaded(task.motion, team, follows=settings.controller in CURVES_RATES)


def streamed(task: Task, team: Team, *, follows: bool) -> Commands:
    """Return the packets of full states, rounded as they are sent; ``follows``: with body rates."""
    sent, mass = task.setpoints, team.mass[:, None]
    forward = sent.accelerations - team.pull_gain * sent.cable_forces / mass
    rates = _body_rates(mass, forward, task.t, follows=follows)
    numbers = (sent.positions, sent.velocities, forward, rates)
    return Commands(*(QUANTUM * np.clip(np.rint(x / QUANTUM), -MOST, MOST) for x in numbers))


def uploaded(motion: Motion, team: Team, *, follows: bool) -> Commands:
    """Return set points as drones evaluate the files that are uploaded to them.

    They hold the cables' tension by offsets, as controllers add no cable force to them. For
    controllers with integrals they cannot: these fly what is exported for drones of no controller.
    """
    hold_tension = not np.any(team.integral_gain > 0.0)
    unnamed = tuple(Quadrotor(kind.mass, kind.max_thrust) for kind in team.quadrotor)
    kinds = team.quadrotor if hold_tension else unnamed
    motion = motion.replaced(team=replace(team, quadrotor=kinds))
    refusals = []
    for kind in (Crazyswarm2(), CompressedBytes()):  # the second one holds three times as much
        options = ExportOptions(kind.name, hold_tension=hold_tension)
        try:
            with tempfile.TemporaryDirectory() as folder:
                parts = export_motion(motion, "", options, folder)
                curves = [_read(kind, part, team.drone_names) for part in parts]
            break
        except InfeasibleError as error:
            refusals.append(error)
    else:
        raise refusals[0]
    begins = [part.begins for part in parts]
    end = begins[-1] + max(curve.duration for curve in curves[-1])
    t = np.arange(np.ceil(RATE * end) + 1) / RATE
    at = np.searchsorted(begins, t + 1e-9, side="right") - 1
    jets = np.zeros((3, len(t), team.drones, 3))
    for i, (begin, part) in enumerate(zip(begins, curves, strict=True)):
        chosen = at == i
        for d, curve in enumerate(part):
            elapsed = t[chosen] - begin
            jet = curve.jet(np.minimum(elapsed, curve.duration), 3)
            jets[:, chosen, d] = np.moveaxis(jet, -1, 0)
            jets[1:, chosen & (t > begin + curve.duration), d] = 0.0  # it hovers where it ended
    rates = _body_rates(team.mass[:, None], jets[2], t, follows=follows)
    return Commands(jets[0], jets[1], jets[2], rates)


def _read(kind: CrazyflieFormat, part: Export, names: Sequence[str]) -> list[PiecewisePolynomial]:
    """Return the curves (3,) of all drones from files that were written."""
    files = [kind.file.format(name=name, frame=kind.frames[0]) for name in names]
    return [kind.upload(part.folder / file).curve for file in files]


def _body_rates(mass: Array, accelerations: Array, t: Array, *, follows: bool) -> Array:
    """Return rates (samples, 2n, 3) [rad/s] of bodies whose thrusts give accelerations alone.

    They are zero at the last time, whose set point is held from then on.
    """
    rates = np.zeros_like(accelerations)
    if follows:
        thrusts = mass * (accelerations + UPWARD)
        rates[:-1] = attitudes(thrusts, np.gradient(thrusts, t, axis=0)).body_rates[:-1]
    return rates
