"""Estimates of the drones' states: motion capture, an IMU, and the Kalman filter of Crazyflies.

The filter is the nine-state error-state filter of M. W. Mueller, M. Hamer and R. D'Andrea, "Fusing
ultra-wideband range measurements with accelerometers and rate gyroscopes for quadrocopter state
estimation", ICRA 2015: position, velocity in the body's frame and a small rotation of the attitude.
It predicts by the accelerometer along the body's z axis and the gyroscope alone, like the motion of
a drone without a cable, and is corrected by the captured position and, of a rigid body, attitude.
Readings of the IMU pass the low-pass filters of the firmware's sensor driver
(``sensors_bmi088_bmp3xx.c``).
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from math import floor, isfinite, pi, sqrt, tan

import numpy as np
from scipy.spatial.transform import Rotation

from hitchopt.drones.controllers import EstimatorParameters
from hitchopt.geometry.vectors import axial_vector, cross_product, dot, length, skew_matrix
from hitchopt.hitch import GRAVITY
from hitchopt.lab.simulation.control import Streams
from hitchopt.lab.simulation.world import RigidBodies
from hitchopt.motion.states import HOVER
from hitchopt.values import Array

RATE = 100.0  # Rate of filter predictions and of motion capture [Hz]
READINGS = 500.0  # Rate of the IMU's readings [Hz]
LATENCY = 0.01  # Delay of motion capture [s] if none is stated, up to the use of a frame


@dataclass(frozen=True)
class Sensors:
    """Standard deviations of readings of motion capture and of an IMU, and its low-pass filters."""

    position: float = 1e-3  # Deviation of captured positions, per axis and frame [m]
    attitude: float = 1e-2  # Deviation of captured attitudes, per axis and frame [rad]
    gyroscope: float = 0.02  # Deviation of angular rates, per reading [rad/s]
    accelerometer: float = 0.45  # Deviation of specific forces, per reading [m/s²]
    # Cutoff frequency of angular rates [Hz]; infinite without a filter
    gyroscope_cutoff: float = 80.0
    # Cutoff frequency of specific forces [Hz]; infinite without a filter
    accelerometer_cutoff: float = 30.0


SENSORS = Sensors()

TURN_NOISE = 0.1  # The firmware's process noise of attitudes [rad/s]
NOISE_RATE = 1000.0  # Rate at which process noise is added [Hz]
MIN_VARIANCE = 1e-6  # Lower bound of variances

ROUNDING = 1e-9  # Rounding error of a number of steps

INITIAL_ERRORS = np.repeat([0.01, 0.01, 0.01], 3)  # Errors of a converged filter [m], [m/s], [rad]

EYE = np.eye(3)
SMALL_ANGLE = 1e-3  # Below it, a series gives the angle over the sine of its half [rad]


def frame_age(latency: float) -> float:
    """Return the age [s] of frames that arrive after a stated delay [s] when they are used.

    A frame that arrives at a step of the filter, or later, waits for the next one. So the
    firmware's flights with the stiffest gains are steady at 10 and 19 ms, and swing at 20 ms.
    """
    return (floor(latency * RATE + ROUNDING) + 1) / RATE


def rotation(turn: Array) -> Array:
    """Return the matrices (…, 3, 3) of rotations by vectors (…, 3) [rad], by Rodrigues' formula."""
    half = length(turn) / (2.0 * np.pi)
    sine, cosine = np.sinc(2.0 * half), 0.5 * np.sinc(half) ** 2  # sin θ / θ, (1 - cos θ) / θ²
    by_turn = skew_matrix(turn)
    cubed = cosine[..., None, None] * (by_turn @ by_turn)
    return np.asarray(EYE + sine[..., None, None] * by_turn + cubed)


def rotation_vector(matrices: Array) -> Array:
    """Return the vectors (…, 3) [rad] of rotation matrices (…, 3, 3).

    Rotations by less than 90° have the formula that ``Rotation`` uses for them, without its checks.
    """
    cosines = matrices[..., 0, 0] + matrices[..., 1, 1] + matrices[..., 2, 2]
    if cosines.min() <= 1.0:
        return np.asarray(Rotation.from_matrix(matrices).as_rotvec())
    axis, w = 2.0 * axial_vector(matrices), 1.0 + cosines  # a quaternion before normalisation
    size = np.sqrt(dot(axis, axis) + w * w)
    axis, w = axis / size[..., None], w / size
    angle = 2.0 * np.arctan2(length(axis), w)
    square = angle * angle
    series = 2.0 + square / 12.0 + 7.0 * square * square / 2880.0
    small = angle <= SMALL_ANGLE
    factor = np.where(small, series, angle / np.sin(0.5 * np.where(small, 1.0, angle)))
    return np.asarray(factor[..., None] * axis)


class LowPass:
    """Second-order Butterworth filters of readings (…) at a rate [Hz], by the bilinear transform.

    ``start`` (…) is what readings have been so far. A filter of infinite cutoff [Hz] passes all.
    """

    def __init__(self, cutoff: float, start: Array, rate: float = READINGS) -> None:
        self._filters = isfinite(cutoff)
        warped = tan(pi * cutoff / rate) if self._filters else 1.0
        scale = 1.0 + sqrt(2.0) * warped + warped**2
        self._passed = warped**2 / scale  # share of a reading that passes at once
        self._first = 2.0 * (1.0 - warped**2) / scale
        self._second = -(1.0 - sqrt(2.0) * warped + warped**2) / scale
        self._read = self._given = start, start  # the last two readings and results

    def apply(self, reading: Array) -> Array:
        """Return the filtered reading (…)."""
        if not self._filters:
            return reading
        (last, previous), (given, before) = self._read, self._given
        sums = reading + 2.0 * last + previous
        result = self._passed * sums + self._first * given + self._second * before
        self._read, self._given = (reading, last), (result, given)
        return np.asarray(result)


class Filter:
    """Kalman filters of several drones, from initial states in the world's frame.

    ``variances`` (k, 9, 9) are of position, velocity and rotation errors [m], [m/s], [rad].
    """

    def __init__(
        self, parameters: EstimatorParameters, positions: Array, velocities: Array, attitudes: Array
    ) -> None:
        self.positions, self.attitudes = positions, attitudes
        self._velocities = np.einsum("iba,ib->ia", attitudes, velocities)
        self.variances = np.tile(np.diag(INITIAL_ERRORS**2), (len(positions), 1, 1))
        level, upright = parameters.level_noise, parameters.upright_noise
        accelerations, dt = np.array([level, level, upright]), 1.0 / NOISE_RATE
        added = np.concatenate([accelerations * dt**2, accelerations * dt, [TURN_NOISE * dt] * 3])
        self._added = NOISE_RATE * added**2  # Per second
        errors = np.repeat([parameters.position_error, parameters.attitude_error or 0.0], 3)
        self._observed = np.r_[0:3, 6:9] if parameters.attitude_error else np.r_[0:3]
        self._errors = np.diag(errors[: len(self._observed)] ** 2)
        # Derivatives (k, 9, 9) of errors by those one step ago, which predictions fill in
        self._transition = np.tile(np.eye(9), (len(positions), 1, 1))

    @property
    def velocities(self) -> Array:
        """Velocities (k, 3) [m/s] in the world's frame."""
        return np.asarray(np.einsum("iab,ib->ia", self.attitudes, self._velocities))

    def advance(self, rates: Array, specific_forces: Array, dt: float) -> None:
        """Predict over a time [s] from mean rates (k, 3) [rad/s] and forces along z (k,) [m/s²]."""
        upward, v = self.attitudes[:, 2], self._velocities  # the world's z axis in the body's frame
        turn, transition = self.attitudes, self._transition
        crossed_by_rates, crossed_by_v, crossed_by_up = skew_matrix(np.array([rates, v, upward]))
        transition[:, 0:3, 3:6] = turn * dt
        transition[:, 0:3, 6:9] = -turn @ crossed_by_v * dt
        transition[:, 3:6, 6:9] = -GRAVITY * crossed_by_up * dt
        transition[:, 3:6, 3:6] = transition[:, 6:9, 6:9] = EYE - crossed_by_rates * dt
        force = -GRAVITY * upward
        force[:, 2] += specific_forces
        step = dt * v + 0.5 * dt**2 * force
        self.positions = self.positions + np.einsum("iab,ib->ia", turn, step)
        self._velocities = v + dt * (force - cross_product(rates, v))
        self.attitudes = turn @ rotation(dt * rates)
        self.variances = transition @ self.variances @ transition.transpose(0, 2, 1)
        bounded = self._bounded_diagonals()
        bounded += dt * self._added

    def observe(self, positions: Array, attitudes: Array | None = None) -> None:
        """Correct with captured positions (k, 3) [m] and attitudes (k, 3, 3), if these are used."""
        observed, p = self._observed, self.variances
        residual = positions - self.positions
        if len(observed) > 3:
            if attitudes is None:
                raise ValueError("the filter needs captured attitudes")
            relative = self.attitudes.transpose(0, 2, 1) @ attitudes
            residual = np.concatenate([residual, rotation_vector(relative)], axis=1)
        rows = p[:, observed]
        innovation = rows[:, :, observed] + self._errors
        gain = np.linalg.solve(innovation, rows).transpose(0, 2, 1)
        step = np.einsum("iab,ib->ia", gain, residual)
        self.positions = self.positions + step[:, 0:3]
        self._velocities = self._velocities + step[:, 3:6]
        self.attitudes = self.attitudes @ rotation(step[:, 6:9])
        p = p - gain @ rows
        self.variances = 0.5 * (p + p.transpose(0, 2, 1))
        self._bounded_diagonals()

    def _bounded_diagonals(self) -> Array:
        """Bound the variances' diagonals from below; return a view (k, 9) of them."""
        diagonals: Array = np.einsum("iaa->ia", self.variances)
        return np.maximum(diagonals, MIN_VARIANCE, out=diagonals)


class Estimator(Filter):
    """Kalman filters and sensors of all drones, initialised with the true states.

    Frames arrive ``age`` readings after they are captured.
    """

    def __init__(
        self,
        parameters: EstimatorParameters,
        bodies: RigidBodies,
        random: np.random.Generator | Streams,
        age: int = 5,
        sensors: Sensors = SENSORS,
    ) -> None:
        super().__init__(parameters, bodies.positions, bodies.velocities, bodies.attitudes)
        self._random, self._sensors = random, sensors
        self._rates: list[Array] = []  # filtered readings since the last prediction
        self._specific_forces: list[Array] = []
        self._passed = deque([bodies], age + 1)  # at the last readings
        self._gyroscope = LowPass(sensors.gyroscope_cutoff, bodies.rates)
        hovering = np.full(len(bodies.rates), GRAVITY)
        self._accelerometer = LowPass(sensors.accelerometer_cutoff, hovering)

    def read(self, bodies: RigidBodies) -> Array:
        """Read the IMU; return the angular rates (2n, 3) [rad/s] that it gives for true states."""
        previous, noise, random = self._passed[-1], self._sensors, self._random
        self._passed.append(bodies)
        shift = noise.gyroscope * random.standard_normal(bodies.rates.shape)
        rates = self._gyroscope.apply(bodies.rates + shift)
        gained = READINGS * (bodies.velocities - previous.velocities) + HOVER
        thrust_axis = 0.5 * (bodies.attitudes + previous.attitudes)[..., 2]
        forces = np.einsum("ia,ia->i", gained, thrust_axis)
        forces += noise.accelerometer * random.standard_normal(len(forces))
        self._rates.append(rates)
        self._specific_forces.append(self._accelerometer.apply(forces))
        return rates

    def predict(self) -> None:
        """Predict from the readings since the last prediction, 1 / RATE ago."""
        count = len(self._rates)
        rates = np.add.reduce(self._rates) / count
        specific_forces = np.add.reduce(self._specific_forces) / count
        self._rates, self._specific_forces = [], []
        self.advance(rates, specific_forces, 1.0 / RATE)

    def correct(self) -> None:
        """Correct with the frame that arrives."""
        captured = self._passed[0]
        shift = self._random.standard_normal(captured.positions.shape)
        turn = self._random.standard_normal(captured.positions.shape)
        self.observe(
            captured.positions + self._sensors.position * shift,
            captured.attitudes @ rotation(self._sensors.attitude * turn),
        )
