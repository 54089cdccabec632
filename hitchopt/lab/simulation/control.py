"""Drones as they are, disturbances, and the simplified controller.

A rigid body that is defined tilted, or bent arms, tilts the frame of a drone's controller from its
thrust. At rest the thrust is vertical, so the controller sees a tilt φ, and a position loop of
stiffness k holds it by an offset of m g tan φ / k from the setpoint: the drone's trim.

The controller is the geometric one of T. Lee, M. Leok and N. H. McClamroch, "Geometric tracking
control of a quadrotor UAV on SE(3)", CDC 2010, with two changes for hitches: only the planned force
of the cable is fed forward, and the position loop is soft, since a stiff loop converts position
errors to tension. The actual force follows the desired one with an attitude loop (about 60 ms of
delay) and motors (first order, 20 ms).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from hitchopt.errors import InputError
from hitchopt.geometry.vectors import axial_vector, cross_product, left_of, length, unit
from hitchopt.hitch import GRAVITY, Team
from hitchopt.lab.simulation.settings import Perturbations, Settings
from hitchopt.lab.simulation.task import Task
from hitchopt.lab.simulation.world import (
    BODY_HALF_HEIGHT,
    BODY_RADIUS,
    Airframes,
    RigidBodies,
    World,
)
from hitchopt.motion.states import States
from hitchopt.objects import SolidObject
from hitchopt.values import Array

NOISE_TIME = 0.3  # Correlation time of errors of measured positions [s]
VELOCITY_NOISE_TIME = 0.1  # Correlation time of errors of measured velocities [s]
GUST_TIME = 1.0  # Correlation time of gusts [s]

AIR_DENSITY = 1.2  # Density of air [kg/m³]
DRAG_COEFFICIENT = 1.2  # Drag coefficient of a cylinder across the flow at a cord's Reynolds number

# Half-width of a turbulent round jet per distance (Pope, Turbulent Flows, 2000, table 5.1)
SPREADING = 0.094

BLOCKED = 0.5  # Fraction of the momentum through a drone's disk that acts on the drone

# Gain of the position loop of a team without stiffness [1/s²]: 4.75 N/m at 132 g
POSITION_GAIN = 36.0
VELOCITY_GAIN = 10.0  # Its gain of velocities [1/s]. Other stiffnesses have the same damping ratio

INTEGRAL_TIME = 2.0  # Integral time constant of the position loop [s]

ATTITUDE_GAIN = 900.0  # Gain of the attitude loop, which has a delay of about 60 ms [1/s²]
RATE_GAIN = 54.0  # Its gain of angular rates [1/s]

# Lever arm of the thrust in a drone's largest roll and pitch moments, over the drone's radius
ARM = 0.5
MIN_FORCE = 1e-9  # Smallest divisor of thrusts [N]

# Largest roll, pitch and yaw moment over the largest roll moment; drag of propellers is small
MOMENT_SHARES = np.array([1.0, 1.0, 0.2])

ROUNDING = 1e-9  # Rounding error of sums of periods [s]
UP = np.array([0.0, 0.0, 1.0])  # Also the direction of a zero thrust


SCALED = ("mellinger", "pid")
"""Controllers whose exported parameters contain the thrust factor that the plan states."""


@dataclass(frozen=True, eq=False)
class FlownDrones:
    """Drones with the trims and thrust factors that a plan states, and with rotor drag."""

    trims: Array  # (2n, 3) [m], in the plan: setpoints minus planned positions
    turns: Array  # (2n, 3, 3), axes of the controllers' frames as columns, in those of the thrust
    thrust_factors: Array  # (2n,), commanded over actual thrusts, beyond what is exported
    drag: float  # [N s/m], over the speed

    @classmethod
    def of(cls, task: Task, settings: Settings, stiffness: Array) -> FlownDrones:
        """Return the drones of a task whose position loops have some stiffness (2n, 3) [N/m]."""
        team = task.team
        lean = stiffness[:, :1] * team.trim / (GRAVITY * team.mass[:, None])  # tangents of tilts
        axis, size = left_of(lean), length(lean)
        angle = np.arctan(size) / np.maximum(size, 1e-12)
        turns = Rotation.from_rotvec(np.insert(axis * angle[:, None], 2, 0.0, axis=1)).as_matrix()
        exported = [kind.controller in SCALED for kind in team.kinds]
        factors = np.where(exported, 1.0, team.thrust_factor)
        trims = np.insert(team.trim, 2, 0.0, axis=1)
        return cls(trims, turns, factors, settings.perturbations.rotor_drag)

    def repeated(self, flights: int) -> FlownDrones:
        """Return the drones of several flights, flight after flight."""
        trims, turns, factors = (
            np.concatenate([each] * flights)
            for each in (self.trims, self.turns, self.thrust_factors)
        )
        return FlownDrones(trims, turns, factors, self.drag)

    @cached_property
    def _is_tilted(self) -> bool:
        return bool(np.any(self.turns != np.eye(3)))

    def measured(self, bodies: RigidBodies) -> RigidBodies:
        """Return bodies with attitudes and rates in the controllers' frames."""
        if not self._is_tilted:
            return bodies
        attitudes = bodies.attitudes @ self.turns
        rates = np.einsum("iba,ib->ia", self.turns, bodies.rates)
        return replace(bodies, attitudes=attitudes, rates=rates)

    def actual(self, thrusts: Array, moments: Array) -> tuple[Array, Array]:
        """Return thrusts (2n,) and moments (2n, 3) about the bodies' axes, from commanded ones."""
        if self._is_tilted:
            moments = np.einsum("iab,ib->ia", self.turns, moments)
        return thrusts / self.thrust_factors, moments


class Streams:
    """Normal random numbers of several flights, whose rows of every array are their own.

    Flights have generators of their own, so that none depends on how many there are. Numbers are
    drawn in blocks: a call of each generator in each step would take longer than the step.
    """

    BLOCK = 4096  # Numbers that a generator draws at a time

    def __init__(self, generators: Sequence[np.random.Generator]) -> None:
        self._generators = generators
        self._drawn: Array = np.zeros((len(generators), 0))
        self._used = 0

    def standard_normal(self, shape: int | tuple[int, ...]) -> Array:
        """Return numbers of a shape whose first axis has the rows of all flights."""
        flights = len(self._generators)
        count = (shape if isinstance(shape, int) else math.prod(shape)) // flights
        if self._used + count > self._drawn.shape[1]:
            block = max(count, self.BLOCK)
            new = [generator.standard_normal(block) for generator in self._generators]
            self._drawn = np.hstack([self._drawn[:, self._used :], new])
            self._used = 0
        numbers = self._drawn[:, self._used : self._used + count]
        self._used += count
        return numbers.reshape(shape)


class Drift:
    """Ornstein-Uhlenbeck process with exact steps of any size.

    Values have the standard deviation ``spread`` and the correlation ``time`` [s].
    """

    def __init__(
        self,
        spread: float,
        time: float,
        shape: tuple[int, ...],
        random: np.random.Generator | Streams,
    ) -> None:
        self._spread, self._correlation_time, self._random = spread, time, random
        self.value: Array = spread * random.standard_normal(shape)

    def advance(self, seconds: float) -> Array:
        """Return the value ``seconds`` later."""
        if not self._spread:
            return self.value
        decay = math.exp(-seconds / self._correlation_time)
        new = self._spread * math.sqrt(1.0 - decay**2)
        self.value = decay * self.value + new * self._random.standard_normal(self.value.shape)
        return self.value


class Disturbances:
    """Disturbances of flights of n robots, one per seed.

    Every quantity has its own random stream, which does not depend on other perturbations:
    ``sensor_random`` is that of motion capture and IMUs. Arrays have a row for each cable or drone
    of all flights, flight after flight; objects are those of the first.
    """

    def __init__(self, perturbations: Perturbations, robots: int, *seeds: int) -> None:
        flights = [
            [np.random.default_rng(child) for child in np.random.SeedSequence(seed).spawn(9)]
            for seed in seeds
        ]
        streams = [Streams(generators) for generators in zip(*flights, strict=True)]
        # The eighth is unused: seeds keep the flights that are published
        cables, start, noise, wind, velocity, _, _, _, self.sensor_random = streams
        self._objects = flights[0][6]
        sizes = self._perturbations = perturbations
        robots = robots * len(seeds)
        drones = (2 * robots, 3)
        # Lengths of cables (n,) over the team's; offsets of the drones' starts (2n, 3) [m]; errors
        # of their measured states (2n, 3) [m], [m/s]; gusts and a level wind (2n, 3) [N]
        self.cable_scale: Array = 1.0 + sizes.cable_error * cables.standard_normal(robots)
        self.start_offset: Array = sizes.start_error * start.standard_normal(drones)
        self.noise = Drift(sizes.noise, NOISE_TIME, drones, noise)
        self.velocity_noise = Drift(sizes.velocity_noise, VELOCITY_NOISE_TIME, drones, velocity)
        self.wind = Drift(sizes.wind / np.sqrt(3.0), GUST_TIME, drones, wind)
        heading = np.array([generators[5].uniform(0.0, 2.0 * np.pi) for generators in flights])
        level = np.column_stack([np.cos(heading), np.sin(heading), np.zeros(len(seeds))])
        self.steady_wind: Array = sizes.steady_wind * np.repeat(
            level, drones[0] // len(seeds), axis=0
        )

    def disturbed(self, objects: Mapping[str, SolidObject]) -> dict[str, SolidObject]:
        """Return objects with random deviations; each call draws new ones."""
        sizes = self._perturbations
        mass, friction, r_squared = self._objects.uniform(-1.0, 1.0, (3, len(objects)))
        heading = self._objects.uniform(0.0, 2.0 * np.pi, len(objects))
        r = sizes.object_place * np.sqrt(np.abs(r_squared))
        offsets = np.column_stack([r * np.cos(heading), r * np.sin(heading), 0.0 * r])
        return {
            name: replace(
                each,
                mass=each.mass * (1.0 + sizes.object_mass * mass[i]),
                friction=each.friction * (1.0 + sizes.object_friction * friction[i]),
                at=each.at if each.fixed else each.at + offsets[i],
            )
            for i, (name, each) in enumerate(objects.items())
        }


class CableDrag:
    """Drag on the cables' inner nodes, as on cylinders."""

    def __init__(self, world: World) -> None:
        ropes, self._world = world.ropes, world
        inner = ropes.segments - 1
        segments = np.repeat(ropes.segment_lengths, inner)
        density = np.repeat(np.broadcast_to(ropes.density, ropes.lengths.shape), inner)
        # Drag over the square of the speed (nodes,) [N s²/m²]
        self._resistance = 0.5 * AIR_DENSITY * DRAG_COEFFICIENT * (ropes.preset.diameter * segments)
        self._mass = density * segments

    def apply(self, damping: float = 0.0) -> None:
        """Apply the drag at current velocities, which ``damping`` [1/s] lets decay in addition."""
        world = self._world
        velocities = world.data.qvel[world.node_dofs]
        rate = self._resistance * length(velocities)
        if damping:
            rate += damping * self._mass
        world.data.qfrc_applied[world.node_dofs] = -rate[:, None] * velocities


def downwash(drones: Array, thrusts: Array) -> Array:
    """Return downwash forces on drones from drones above (…, 2n, 3) [N].

    A wake is a turbulent round jet with the momentum of the thrust. Its profile is Gaussian, with a
    half-width that grows from half of the drone's radius by ``SPREADING`` per distance (Pope 2000,
    section 5.1). A drone receives ``BLOCKED`` times the momentum through its disk. Drones are at
    (…, 2n, 3) [m], with thrusts (…, 2n) [N].
    """
    offset = drones[..., None, :, :] - drones[..., :, None, :]  # [below, above]
    x, y, depth = offset[..., 0], offset[..., 1], offset[..., 2]
    forces, is_above = np.zeros_like(drones), depth > BODY_HALF_HEIGHT
    if not np.logical_or.reduce(is_above, axis=None):
        return forces
    half_width = 0.5 * BODY_RADIUS + SPREADING * np.maximum(depth, 0.0)
    # Over the variance of the momentum, the square of the speed
    half = 2.0 * math.log(2.0) / (half_width * half_width)
    share = BODY_RADIUS**2 * half * np.exp(-half * (x * x + y * y))
    push = np.minimum(share, 1.0) * is_above
    forces[..., 2] = -BLOCKED * np.add.reduce(push * thrusts[..., None, :], axis=-1)
    return forces


@dataclass(frozen=True, eq=False)
class PositionGains:
    """Gains of the drones' position loops."""

    stiffness: Array  # (2n, 3) [N/m]
    damping: Array  # (2n, 3) [N s/m]
    integral: Array  # (2n, 3) [N/(m s)]
    feed_forward: NDArray[np.bool_]  # (2n,), whether the planned cable force is fed forward

    @classmethod
    def of(cls, team: Team, settings: Settings) -> PositionGains:
        """Return the gains of a team's drones, scaled to the settings' stiffness.

        Raises InputError for an unstable loop: the characteristic polynomial of a drone's loop,
        including lag and attitude loop, has a root with a positive real part.
        """
        masses = np.repeat(team.mass[:, None], 3, axis=1)
        nominal = np.where(np.isfinite(team.stiffness), team.stiffness, POSITION_GAIN * masses)
        stiffness = np.broadcast_to(settings.stiffness or nominal, masses.shape)
        scale = stiffness / nominal
        default = VELOCITY_GAIN * np.sqrt(nominal * masses / POSITION_GAIN)
        damping = np.where(np.isfinite(team.damping), team.damping, default) * np.sqrt(scale)
        gain, default = team.integral_gain, nominal / INTEGRAL_TIME * (team.integral > 0.0)
        integral = np.where(np.isfinite(gain), gain, default) * scale
        lag = [settings.lag, 1.0, RATE_GAIN, ATTITUDE_GAIN]  # highest power first
        columns = [values.ravel() for values in (masses, damping, stiffness, integral)]
        for mass, *gains in np.unique(columns, axis=1).T:
            loop = np.polyadd(np.polymul(lag, [mass / ATTITUDE_GAIN, 0.0, 0.0, 0.0]), gains)
            if np.any(np.roots(loop).real > 0.0):
                bound = f"lower: a drone of {mass:g} kg is unstable, since its thrust lags"
                raise InputError("stiffness", float(gains[1]), bound, "lower it")
        return cls(stiffness, damping, integral, team.feed_forward)

    def of_drones(self, drones: slice) -> PositionGains:
        """Return the gains of some drones."""
        return PositionGains(*(gain[drones] for gain in vars(self).values()))


class Pilots:
    """The drones' simplified controllers and their motors.

    Attributes
    ----------
    thrusts, moments: current values, (2n,) [N], (2n, 3) [N m] about the bodies' axes.
    """

    def __init__(self, world: Airframes, team: Team, settings: Settings) -> None:
        self.gains = PositionGains.of(team, settings)
        self._masses = world.masses[:, None]
        self._inertia = world.inertia
        self._lag = settings.lag
        self._max_thrust = np.array(team.max_thrust)
        self._integral_limit = team.integral
        self._integral: Array = np.zeros((team.drones, 3))  # force of the integral action so far
        self._state: Array | None = None  # thrusts and moments, (2n, 4), after the first command
        self.thrusts = np.zeros(team.drones)
        self.moments = np.zeros((team.drones, 3))

    def integrate(self, errors: Array, seconds: float) -> None:
        """Integrate position errors (2n, 3) [m] over some time."""
        integral = self._integral + seconds * self.gains.integral * errors
        self._integral = np.clip(integral, -self._integral_limit, self._integral_limit)

    def command(
        self, setpoints: States, bodies: RigidBodies, seconds: float, pull: Array | float
    ) -> None:
        """Run controllers and motors for the next ``seconds``.

        Bodies are measured states; ``pull`` (2n, 3) [N] is added to the desired force.
        """
        masses, max_thrust, gains = self._masses, self._max_thrust, self.gains
        error = setpoints.positions - bodies.positions
        error_rate = setpoints.velocities - bodies.velocities
        desired: Array = masses * (setpoints.accelerations + GRAVITY * UP)
        desired += gains.stiffness * error + gains.damping * error_rate + self._integral
        desired += pull - gains.feed_forward[:, None] * setpoints.cable_forces
        attitudes, rates = bodies.attitudes, bodies.rates
        thrust = np.einsum("ia,ia->i", desired, attitudes[:, :, 2])
        limit = ARM * BODY_RADIUS * max_thrust[:, None] * MOMENT_SHARES
        turning = desired, masses * setpoints.jerks, attitudes, rates, self._inertia
        moments = np.clip(turning_moments(*turning), -limit, limit)
        command = np.column_stack([np.clip(thrust, 0.0, max_thrust), moments])
        decay = np.exp(-seconds / self._lag) if self._lag > 0.0 else 0.0
        previous = command if self._state is None else self._state
        state = self._state = command + (previous - command) * decay
        self.thrusts, self.moments = state[:, 0], state[:, 1:]


def turning_moments(
    desired: Array, growth: Array, attitudes: Array, rates: Array, inertia: Array
) -> Array:
    """Return moments (2n, 3) [N m] about the bodies' axes that turn drones to desired thrusts.

    Thrusts ``desired`` and their derivatives ``growth`` are (2n, 3) [N], [N/s]. The bodies' axes
    are columns of attitudes (2n, 3, 3), and the axes of rates and inertia (2n, 3) [rad/s], [kg m²].
    """
    goals = desired_attitudes(desired)
    size = np.maximum(length(desired), MIN_FORCE)[:, None]
    turning = cross_product(goals[..., 2], growth) / size
    goal_rates = np.einsum("iba,ib->ia", goals, turning)
    relative = np.einsum("iba,ibc->iac", goals, attitudes)  # R_d^T R
    error = axial_vector(relative)
    feed_forward = np.einsum("iba,ib->ia", relative, goal_rates)  # R^T R_d omega_d
    acceleration = -ATTITUDE_GAIN * error - RATE_GAIN * (rates - feed_forward)
    return np.asarray(inertia * acceleration + cross_product(rates, inertia * rates))


def desired_attitudes(desired: Array) -> Array:
    """Return attitudes (2n, 3, 3) with the third axis along the thrust and the first toward x."""
    third = unit(desired, UP)
    second = np.zeros_like(third)  # across the thrust and x
    second[:, 1], second[:, 2] = third[:, 2], -third[:, 1]
    second = unit(second)
    axes: Array = np.empty((*third.shape, 3))
    axes[..., 0], axes[..., 1], axes[..., 2] = cross_product(second, third), second, third
    return axes
