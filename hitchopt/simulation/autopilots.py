"""Flight controllers by name, as drones run them: position loops, attitude loops and motors.

A controller turns a set point into a desired force ``f = m (a + g ẑ) + kp e + kd ė + ∫ ki e dt``,
its gains and what it adds of the set point's acceleration and velocity being those of a
``FlightController``; what a controller does with the force differs:

**mellinger** and **lee** turn the body's z axis to f and thrust by its part along that axis (D.
Mellinger and V. Kumar, "Minimum snap trajectory generation and control for quadrotors", ICRA 2011;
T. Lee, M. Leok and N. H. McClamroch, "Geometric tracking control of a quadrotor UAV on SE(3)", CDC
2010). **pid** is the Crazyflie's cascade: its tilt is the level force over the weight, its thrust
the upright force, whatever the tilt. **px4** is the position law of PX4's multicopters: level force
is given up for tilt, and the thrust is all of f.

Attitude loops have the gains of stock Crazyflies over their moments of inertia, so that drones of
any size turn alike: who flies a larger one is assumed to scale them. Motors lag, each by itself.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hitchopt.geometry.vectors import length
from hitchopt.hitch import GRAVITY
from hitchopt.hitch.flight_controller import FlightController
from hitchopt.simulation.commands import Commands
from hitchopt.simulation.control import ARM, MOMENT_SHARES, UP, PositionGains, desired_attitudes
from hitchopt.simulation.estimator import RATE, Estimator
from hitchopt.simulation.settings import MOTOR_LAG
from hitchopt.simulation.world import BODY_RADIUS, Bodies
from hitchopt.values import Array

PERIOD = 0.002  # Of the attitude loops [s]

# Periods from one prediction of the filter to the next, and to the frame that arrives in between;
# position loops run after both. Until a frame corrects it, a velocity that is predicted for a
# level pull acts: 8 ms agree with what the firmware believed, and where it was, in a bench
TICKS, ARRIVAL = round(1.0 / (RATE * PERIOD)), 4
LEAST_LIFT = 0.1  # Least upright force over the weight that px4 asks for
TINY = 1e-9  # Least level force that is divided by [N]
TOP_SPEED = 1.1  # Largest velocity with which pid answers an offset, along an axis [m/s]

# Signs with which motors, arranged in an X, turn the body about its axes when they thrust more
TURNS = np.array([[-1, -1, -1], [-1, 1, 1], [1, 1, -1], [1, -1, 1]], dtype=np.float64)


@dataclass(frozen=True)
class AttitudeGains:
    """Angular accelerations by which an attitude loop answers; pairs are tilt and yaw.

    Parameters
    ----------
    stiffness, damping: by an angle [1/s²], by a rate [1/s].
    lead: by an angular acceleration.
    integral: by an angle and time [1/s³].
    """

    stiffness: tuple[float, float]
    damping: tuple[float, float]
    lead: float = 0.0
    integral: tuple[float, float] = (0.0, 0.0)


# The firmwares' gains over a Crazyflie's moments of inertia, 1.66e-5 and 2.93e-5 kg m², where a
# motor gives 1.9 µN by unit of its command, 3.25 cm from the axes. px4's rate loop is a usual one
ATTITUDES: Mapping[str, AttitudeGains] = {
    "mellinger": AttitudeGains((1040.0, 228.0), (149.0, 22.8), 1.49),
    "lee": AttitudeGains((422.0, 273.0), (69.4, 68.4), 0.0, (1810.0, 1025.0)),
    "pid": AttitudeGains((636.0, 78.0), (106.0, 13.0), 1.06, (318.0, 13.0)),
    "px4": AttitudeGains((130.0, 28.0), (20.0, 10.0)),
}


def per_axis(loops: Sequence[FlightController], name: str) -> Array:
    """Return a pair of the loops (2n,), level and upright, by axis (2n, 3)."""
    return np.array([getattr(loop, name) for loop in loops])[:, [0, 0, 1]]


class Autopilots:
    """The drones' controllers of one kind, their estimators and their motors.

    Attributes
    ----------
    gains: of the position loops.
    thrusts, moments: present ones, (2n,) [N], (2n, 3) [N m] about the bodies' axes.
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
        self._kp, self._kd, self._ki, self._most = (
            per_axis(loops, name) for name in ("kp", "kd", "ki", "ki_limit")
        )
        feeds = np.array([loop.feed_forward for loop in loops])
        self.gains, self._feeds = PositionGains(self._kp, self._kd, self._ki, feeds), feeds[:, None]
        self._tilt = np.array([loop.max_tilt for loop in loops])[:, None]
        turn = ATTITUDES[self._name]
        tilt = [turn.stiffness, turn.damping, (turn.lead, 0.0), turn.integral]
        self._turn = np.array(tilt)[:, [0, 0, 1]]
        self._estimator, self._ticks = estimator, 0
        self._wound = self._twisted = self._force = np.zeros_like(inertia)
        self._goal, self._thrust = np.zeros((len(loops), 3, 3)), np.zeros(len(loops))
        self._last: Array | None = None
        arms = ARM * BODY_RADIUS * MOMENT_SHARES
        self._mixer, self._wrench = TURNS / (4.0 * arms), TURNS * arms
        self._max_thrust, self._lag = 0.25 * max_thrust[:, None], lag
        self._motors = np.tile(0.25 * GRAVITY * self._masses, 4)

    @property
    def thrusts(self) -> Array:
        """Present thrusts (2n,) [N]."""
        return np.asarray(np.sum(self._motors, axis=1))

    @property
    def moments(self) -> Array:
        """Present moments (2n, 3) [N m] about the bodies' axes."""
        return self._motors @ self._wrench

    def stop(self, drone: int) -> None:
        """Stop the motors of a drone, whose thrust fades with their lag."""
        self._max_thrust[drone] = 0.0

    def advance(self, commands: Commands, bodies: Bodies, seconds: float) -> None:
        """Run the motors for the next ``seconds``, by the set points that were received.

        ``bodies`` are as they are where there are estimators, else as they are measured.
        """
        estimator = self._estimator
        rates = bodies.rates if estimator is None else estimator.read(bodies)
        state = bodies if estimator is None else estimator
        phase, self._ticks = self._ticks % TICKS, self._ticks + 1
        if phase in (0, ARRIVAL):
            if estimator is not None:
                estimator.predict(bodies) if phase == 0 else estimator.correct(bodies)
            self._aim(commands, state, seconds * (ARRIVAL if phase else TICKS - ARRIVAL))
        attitudes = state.attitudes
        thrust, answer = self._turned(attitudes, rates, commands.rates, seconds)
        moments = self._inertia * answer + np.cross(rates, self._inertia * rates)
        goals = 0.25 * thrust[:, None] + moments @ self._mixer.T
        over = np.max(goals, axis=1, keepdims=True) - self._max_thrust
        goals = np.clip(goals - np.maximum(over, 0.0), 0.0, self._max_thrust)  # attitude first
        remains = np.exp(-seconds / self._lag) if self._lag > 0.0 else 0.0
        self._motors = goals + (self._motors - goals) * remains

    def _aim(self, commands: Commands, state: Bodies | Estimator, seconds: float) -> None:
        """Run the position loops, which give desired attitudes, and thrusts for cascades."""
        weight = GRAVITY * self._masses
        push = self._kp * (commands.positions - state.positions)
        if self._name == "pid":
            push = np.clip(push, -TOP_SPEED * self._kd, TOP_SPEED * self._kd)
        wound = self._wound + seconds * self._ki / self._kp * push
        self._wound = np.clip(wound, -self._most, self._most)
        force = push + self._wound + weight * UP - self._kd * state.velocities
        fed = self._masses * commands.accelerations + self._kd * commands.velocities
        force = self._force = force + self._feeds * fed
        level, lift = force[:, :2], force[:, 2:]
        if self._name == "pid":
            tilt = np.clip(level / weight, -self._tilt, self._tilt)
            force = np.hstack([np.tan(tilt), np.ones_like(lift)])
            self._thrust = lift[:, 0]
        elif self._name == "px4":
            lift = np.maximum(lift, LEAST_LIFT * weight)
            size = length(level)[:, None]
            level = level * np.minimum(1.0, lift * np.tan(self._tilt) / np.maximum(size, TINY))
            force = np.hstack([level, lift])
            self._thrust = length(force)
        self._goal = desired_attitudes(force)

    def _turned(
        self, attitudes: Array, rates: Array, desired_rates: Array, seconds: float
    ) -> tuple[Array, Array]:
        """Run the attitude loops: return thrusts (2n,) [N], angular accelerations (2n, 3)."""
        across = self._goal.transpose(0, 2, 1) @ attitudes  # R_d^T R
        error = 0.5 * np.stack(
            [across[:, i, j] - across[:, j, i] for i, j in ((2, 1), (0, 2), (1, 0))], axis=-1
        )
        off = rates - desired_rates
        stiffness, damping, lead, integral = self._turn
        self._twisted = self._twisted + seconds * integral * error
        answer = stiffness * error + damping * off + self._twisted
        if self._last is not None:
            answer = answer + lead * (off - self._last) / seconds
        self._last = off
        if self._name in ("pid", "px4"):
            return self._thrust, -answer
        return np.einsum("ia,ia->i", self._force, attitudes[:, :, 2]), -answer
