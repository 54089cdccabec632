"""Flight controllers by name, as drones run them: position loops, attitude loops and motors.

A controller computes a desired force ``f = m (a + g ẑ) + kp e + kd ė + ∫ ki e dt`` from a setpoint.
Gains and feed-forward are those of a ``FlightController``. Controllers differ in their use of f:

**mellinger** and **lee** align the body's z axis with f and thrust by its component along it (D.
Mellinger and V. Kumar, "Minimum snap trajectory generation and control for quadrotors", ICRA 2011;
T. Lee, M. Leok and N. H. McClamroch, "Geometric tracking control of a quadrotor UAV on SE(3)", CDC
2010). **pid** is the Crazyflie's cascade: its tilt is the horizontal force over the weight, its
thrust the vertical force, regardless of the tilt. **px4** is the position law of PX4's
multicopters: horizontal force is reduced to the tilt limit, and the thrust is the norm of f.

Attitude loops have the gains of stock Crazyflies over their moments of inertia: gains of larger
drones are assumed to be scaled with inertia. Motors lag individually.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from hitchopt.drones.controllers import FlightController
from hitchopt.drones.firmware import attitude_loop
from hitchopt.geometry.vectors import axial_vector, cross_product, length
from hitchopt.hitch import GRAVITY
from hitchopt.lab.simulation.control import ARM, MOMENT_SHARES, UP, PositionGains, desired_attitudes
from hitchopt.lab.simulation.estimator import RATE, READINGS, Estimator
from hitchopt.lab.simulation.settings import MOTOR_LAG
from hitchopt.lab.simulation.task import Commands
from hitchopt.lab.simulation.world import BODY_RADIUS, RigidBodies
from hitchopt.values import Array

PERIOD = 1.0 / READINGS  # Period of the attitude loops [s]

TICKS = round(1.0 / (RATE * PERIOD))  # Number of periods between predictions of the filter
# Number of periods from a prediction to the arrival of a frame; position loops run after both.
# The delay of 8 ms, in which predicted velocities act uncorrected, agrees with estimates of the
# firmware in a bench test
ARRIVAL = 4
MIN_LIFT = 0.1  # Smallest vertical force over the weight in px4
TINY = 1e-9  # Smallest divisor of level forces [N]
MAX_SPEED = 1.1  # Largest velocity setpoint of pid for an offset, along an axis [m/s]

# Signs of the moments about the body's axes by motors in an X configuration
MOMENT_SIGNS = np.array([[-1, -1, -1], [-1, 1, 1], [1, 1, -1], [1, -1, 1]], dtype=np.float64)


def per_axis(loops: Sequence[FlightController], name: str) -> Array:
    """Return a pair of gains of the loops (2n,), horizontal and vertical, by axis (2n, 3)."""
    return np.array([getattr(loop, name) for loop in loops])[:, [0, 0, 1]]


class Autopilots:
    """Flight controllers of one kind with estimators and motors.

    Attributes
    ----------
    gains: of the position loops.
    """

    def __init__(
        self,
        loops: Sequence[FlightController],
        masses: Array,
        inertia: Array,
        max_thrust: Array,
        lag: float = MOTOR_LAG,
        estimator: Estimator | None = None,
    ) -> None:
        self._name, self._masses, self._inertia = loops[0].name, masses[:, None], inertia
        self._kp, self._kd, self._ki, self._limit = (
            per_axis(loops, name) for name in ("kp", "kd", "ki", "ki_limit")
        )
        self._integrates, self._weight = bool(np.any(self._ki)), GRAVITY * self._masses * UP
        feed_forward = np.array([loop.feed_forward for loop in loops])
        self.gains = PositionGains(self._kp, self._kd, self._ki, feed_forward)
        self._feed_forward = feed_forward[:, None]
        self._tilt = np.array([loop.max_tilt for loop in loops])[:, None]
        gains = attitude_loop(self._name)
        pairs = [gains.stiffness, gains.damping, (gains.lead, 0.0), gains.integral]
        self._attitude_gains = np.array(pairs)[:, [0, 0, 1]]
        self._integrates_attitudes = any(gains.integral)
        self._estimator, self._ticks = estimator, 0
        self._integral = self._attitude_integral = self._force = np.zeros_like(inertia)
        self._goal, self._thrust = np.zeros((len(loops), 3, 3)), np.zeros(len(loops))
        self._last_error: Array | None = None
        arms = ARM * BODY_RADIUS * MOMENT_SHARES
        self._mixer, self._wrench = (MOMENT_SIGNS / (4.0 * arms)).T, MOMENT_SIGNS * arms
        self._max_thrust, self._lag = 0.25 * max_thrust[:, None], lag
        self._motors = np.tile(0.25 * GRAVITY * self._masses, 4)

    @property
    def thrusts(self) -> Array:
        """Current thrusts (2n,) [N]."""
        return np.asarray(np.add.reduce(self._motors, axis=1))

    @property
    def moments(self) -> Array:
        """Current moments (2n, 3) [N m] about the bodies' axes."""
        return self._motors @ self._wrench

    def advance(self, commands: Commands, bodies: RigidBodies, seconds: float) -> None:
        """Run controllers and motors for the next ``seconds``, by the received setpoints.

        ``bodies`` are true states if there are estimators, and measured ones otherwise.
        """
        estimator = self._estimator
        rates = bodies.rates if estimator is None else estimator.read(bodies)
        state = bodies if estimator is None else estimator
        phase, self._ticks = self._ticks % TICKS, self._ticks + 1
        if phase in (0, ARRIVAL):
            is_prediction = phase == 0
            if estimator is not None:
                if is_prediction:
                    estimator.predict()
                else:
                    estimator.correct()
            periods_since_last_run = TICKS - ARRIVAL if is_prediction else ARRIVAL
            self._set_goals(commands, state, seconds * periods_since_last_run)
        thrust, angular_accelerations = self._attitude_loops(
            state.attitudes, rates, commands.rates, seconds
        )
        gyroscopic_moments = cross_product(rates, self._inertia * rates)
        moments = self._inertia * angular_accelerations + gyroscopic_moments
        goals = 0.25 * thrust[:, None] + moments @ self._mixer
        limit = self._max_thrust
        if np.logical_or.reduce(goals > limit, axis=None):  # attitude first
            excess = np.maximum.reduce(goals, axis=1, keepdims=True) - limit
            goals -= np.maximum(excess, 0.0)
        goals = np.minimum(np.maximum(goals, 0.0), limit)
        decay = math.exp(-seconds / self._lag) if self._lag > 0.0 else 0.0
        self._motors = goals + (self._motors - goals) * decay

    def _set_goals(
        self, commands: Commands, state: RigidBodies | Estimator, seconds: float
    ) -> None:
        """Run the position loops, which set desired attitudes, and thrusts of cascades."""
        push = self._kp * (commands.positions - state.positions)
        if self._name == "pid":
            push = np.clip(push, -MAX_SPEED * self._kd, MAX_SPEED * self._kd)
        if self._integrates:
            integral, limit = self._integral + seconds * self._ki / self._kp * push, self._limit
            self._integral = np.minimum(np.maximum(integral, -limit), limit)
        force = push + self._integral + self._weight - self._kd * state.velocities
        feed_forward = self._masses * commands.accelerations + self._kd * commands.velocities
        force += self._feed_forward * feed_forward
        self._force, level, lift = force, force[:, :2], force[:, 2:]
        weight = self._weight[:, 2:]
        if self._name == "pid":
            tilt = np.clip(level / weight, -self._tilt, self._tilt)
            force = np.hstack([np.tan(tilt), np.ones_like(lift)])
            self._thrust = lift[:, 0]
        elif self._name == "px4":
            lift = np.maximum(lift, MIN_LIFT * weight)
            size = length(level)[:, None]
            level = level * np.minimum(1.0, lift * np.tan(self._tilt) / np.maximum(size, TINY))
            force = np.hstack([level, lift])
            self._thrust = length(force)
        self._goal = desired_attitudes(force)

    def _attitude_loops(
        self, attitudes: Array, rates: Array, desired_rates: Array, seconds: float
    ) -> tuple[Array, Array]:
        """Return thrusts (2n,) [N] and angular accelerations (2n, 3) [1/s²] of the attitude loops.

        They are those that the loops command, about the bodies' axes.
        """
        error = axial_vector(self._goal.transpose(0, 2, 1) @ attitudes)  # of R_d^T R
        rate_error = rates - desired_rates
        stiffness, damping, lead, integral = self._attitude_gains
        if self._integrates_attitudes:
            self._attitude_integral = self._attitude_integral + seconds * integral * error
        # The accelerations that would increase the errors; the loops command the opposite ones
        opposed = stiffness * error + damping * rate_error
        if self._integrates_attitudes:
            opposed += self._attitude_integral
        if self._last_error is not None:
            opposed += lead * (rate_error - self._last_error) / seconds
        self._last_error = rate_error
        if self._name in ("pid", "px4"):
            return self._thrust, -opposed
        return np.add.reduce(self._force * attitudes[:, :, 2], axis=1), -opposed
