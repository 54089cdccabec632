"""Flight controllers: gains of position loops, feed-forward of setpoints, parameters of filters.

A drone of mass m with position error e [m] from its setpoint s responds with the force

    kp e + kd ė + ∫ ki e dt  (+ m s̈ and the cable force of the setpoints, with feed-forward),

with separate gains for horizontal and vertical errors. The values are the defaults of the public
firmwares: the gains of the Crazyflie's Mellinger controller are in newtons and independent of mass;
the others are per mass.

A drone's tracking error grows with its offset in wind, the wind's force over kp:
``base_error + wind_gain * wind_force(mass) / kp``. Base errors and gains are chosen so that at
least 95 of 100 perturbed flights keep it (``python -m benchmarks tracking_errors``).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np

from hitchopt.errors import InputError, OneLine
from hitchopt.values import SCALAR, Array, check_choice, form_of, plain, positive, units
from hitchopt.values.fields import (
    Key,
    Kind,
    Record,
    documented,
    either,
    mapping_of,
    one_or_each,
    with_fields,
)

Pair = tuple[float, float]  # One horizontal value, for x and y, and one vertical value, for z

DAMPING_RATIO = 5.0 / 6.0
"""kd / (2 √(kp m)) if no damping is specified: gains of 36/s² and 10/s times the mass."""

INTEGRAL_TIME = 2.0  # [s] kp / ki if only the presence of an integral is specified

MIN_TRACKING, MAX_TRACKING = 0.06, 1000.0
"""[m] Bounds of tracking errors that follow from gains.

In ten perturbed flights of ``problems/retuned_triangle.yaml`` with ropes, largest errors of the
stiffest loops are 5.0 cm in the mean and deviate by 0.4 cm: 95 of 100 stay below 5.7 cm. They occur
as cables become taut. The softest gains that are accepted would have errors beyond the largest
coordinate."""

WIND, WIND_MASS = 0.05, 0.132
"""[N] Force of indoor gusts, and of a steady wind, on drones of WIND_MASS [kg] or more."""

PULL_TIME = 0.0225
"""[s] Velocity that the exported filter estimates under a steady pull, per acceleration.

The filter measures what acts along the thrust, and takes a pull across it for an acceleration that
the drone does not have. A drone of 132 g that leans by 17° under 0.4 N appears to move against the
pull at 6 cm/s, and down at 2 cm/s. In a bench with the firmware's own filter, tilts of 9 to 35° and
masses of 39 and 132 g have the same time, within 2 %. It is 18 to 27 ms, depending on the time from
predictions to frames, which is unknown on export; this is the mean."""

RECORDED_TUBE = (0.08, 0.20)
"""[m] Horizontal and vertical errors that recorded drones reached: with full setpoints at rest, and
before their thrust was calibrated."""


def wind_force(mass: float) -> float:
    """Return the force [N] of indoor gusts, and of a steady wind, on a drone of a mass [kg].

    It grows with the area of drones of equal density up to WIND_MASS.
    """
    return float(WIND * min(1.0, (mass / WIND_MASS) ** (2.0 / 3.0)))


def _pair(quantity: Kind) -> Kind:
    """Return the kind of a pair of gains, horizontal and vertical; one number sets both."""
    both = replace(one_or_each(quantity, 2, 2), accepted=(SCALAR, "[level, upright]"))

    def check(key: str, value: Any) -> Pair:
        if form_of(plain(key, value)) not in both.forms:
            raise InputError(key, value, both.bound, "specify one or two numbers")
        gains = both.check(key, value)
        level, upright = gains if isinstance(gains, list) else (gains, gains)
        return level, upright

    return replace(both, check=check)


@documented
@dataclass(frozen=True)
class Tube(Record):
    """Tracking errors of a drone: it is within an ellipsoid about its planned position.

    The ellipsoid has the semi-axes ``level``, horizontally, and ``height``. A height below
    ``level`` is replaced by ``level``: the ellipsoid is then a ball.

    Raises
    ------
    InputError: a number out of its range, or a height with a level of zero.
    """

    level: Annotated[float, Key(units.TRACKING_ERROR, "Largest horizontal error")]
    height: Annotated[float, Key(units.TRACKING_ERROR, "Largest vertical error")]

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.height > 0.0 and self.level == 0.0:
            bound = f"greater than 0 with a height of {self.height:g} m"
            raise InputError("level", self.level, bound, "specify a horizontal error, too")

    @classmethod
    def of(cls, tracking: float | Tube | None) -> Tube:
        """Return the tube of a tracking error: a ball for a number, nothing for None."""
        if isinstance(tracking, Tube):
            return tracking
        return with_fields(cls(0.0, 0.0), level=tracking or 0.0, height=tracking or 0.0)

    @classmethod
    def enclosing(cls, tubes: Iterable[Tube]) -> Tube | None:
        """Return the smallest tube that contains all of some tubes; None without any."""
        sizes = [(tube.level, tube.height) for tube in tubes]
        if not sizes:
            return None
        level, height = map(max, zip(*sizes, strict=True))
        return with_fields(cls(0.0, 0.0), level=level, height=height)

    @property
    def ratio(self) -> float:
        """Height over level, at least 1.

        Dividing heights by it turns the tube into a ball and lengthens no distance, so distances
        that are kept with errors in the ball are kept with errors in the tube.
        """
        return max(1.0, self.height / self.level) if self.level else 1.0

    @property
    def largest(self) -> float:
        """Largest error in any direction [m]."""
        return max(self.level, self.height)

    @property
    def tracking(self) -> float | Tube:
        """The tracking error as in files: a number for a ball, otherwise the tube."""
        return self.level if self.height == self.level else self

    def contains(self, errors: Array) -> bool:
        """Return whether all errors (…, 3) [m] are within the tube."""
        scaled = errors / np.array([1.0, 1.0, self.ratio])
        return bool(np.max(np.linalg.norm(scaled, axis=-1), initial=0.0) <= self.level)

    def __str__(self) -> str:
        level = f"{self.level:.3g} m"
        if self.height == self.level:
            return level
        return f"{level} horizontally, {self.height:.3g} m vertically"


TRACKING = either(units.TRACKING_ERROR, mapping_of(Tube))
"""Tracking errors in files: a number, or level and height."""

GAIN = float | Pair | None


@documented
@dataclass(frozen=True)
class Gains(Record):
    """Gains of a position loop: a number or [horizontal, vertical]; null: the controller's default.

    Raises
    ------
    InputError: a gain of another form, or out of its range.
    """

    kp: Annotated[GAIN, Key(_pair(units.STIFFNESS), "Force per offset")] = None
    kd: Annotated[GAIN, Key(_pair(units.DAMPING), "Force per velocity")] = None
    ki: Annotated[GAIN, Key(_pair(units.INTEGRAL), "Force per offset and time")] = None

    @classmethod
    def of(cls, gains: object) -> Gains:
        """Return ``gains``, converted from a mapping; None for the defaults."""
        return cls() if gains is None else mapping_of(Gains).check("gains", gains)


LATENCY = 0.015  # [s] Longest stated delay of motion capture and commands for the stiffest gains

UNSTATED_LATENCY = 0.02
"""[s] Delay that has to be stated.

With the stiffest gains the Crazyflie's firmware in the loop with simulated cables swings at 20 ms
(by 1.8 to 2.6 cm, standard deviation) but not at 19 ms (0.2 cm)."""

LOOP_LAG = 0.04
"""[s] Lag of attitude loop, motors and filter, as a delay at the position loop's crossover.

In the simulated bench gains scaled by 0.85, 0.7 and 0.5 sway at 33, 51 and 80 ms as the stiffest do
at 20 ms, which makes it 0.054, 0.052 and 0.04 s."""


def latency_scale(latency: float | None) -> float:
    """Return the factor s of gains for a delay [s]: kp is scaled by s² and kd by s, at most 1.

    These gains scale the crossover frequency of the position loop by s and keep the phase of its PD
    part there. The phase that delay and lags take, crossover times ``latency + LOOP_LAG``, is that
    of LATENCY for ``s = (LATENCY + LOOP_LAG) / (latency + LOOP_LAG)``.
    """
    return min(1.0, (LATENCY + LOOP_LAG) / ((latency or 0.0) + LOOP_LAG))


UNBOUNDED: Pair = (math.inf, math.inf)


@dataclass(frozen=True)
class StockController:
    """A firmware's default parameters."""

    kp: Pair  # Stiffness [1/s²], or [N/m] if not per mass
    kd: Pair  # Damping [1/s], or [N s/m]
    ki: Pair  # Gain of the integral [1/s³], or [N/(m s)]
    base_error: float  # [m] Tracking error of a rigid loop
    wind_gain: float  # Tracking error beyond it, over the offset in wind
    ki_range: Pair = UNBOUNDED  # [m s] Largest integral of the position error
    per_mass: bool = True  # True if gains are per mass
    stiffest: Pair = UNBOUNDED
    """[1/s²], [1/s] Largest horizontal kp and its kd, over mass, that fly at delays up to
    LATENCY."""

    feed_forward: bool = True  # True if streamed accelerations are added
    max_tilt: float = 0.5 * math.pi  # [rad] Largest tilt that it commands
    filtered: bool = True  # True if the Crazyflie's filter estimates its state


PID_LEVEL = 9.81 * math.radians(1.0)
"""[m/s²] Acceleration per degree of tilt of the PID controller, which commands 25° per m/s."""

STOCK: Mapping[str, StockController] = {
    "mellinger": StockController(
        kp=(0.40, 1.25),
        kd=(0.2, 0.4),
        ki=(0.05, 0.05),
        ki_range=(2.0, 0.4),
        base_error=0.02,
        wind_gain=2.9,
        per_mass=False,
        stiffest=(36.0, 10.0),
    ),
    "lee": StockController(
        kp=(7.0, 7.0),
        kd=(4.0, 4.0),
        ki=(0.0, 0.0),
        base_error=0.16,
        wind_gain=1.0,
        stiffest=(14.0, 6.5),
    ),
    "pid": StockController(
        kp=(51.0 * PID_LEVEL, 51.0 * PID_LEVEL),  # 2/s times 25° per m/s, and 1° per m
        kd=(25.0 * PID_LEVEL, 25.0 * PID_LEVEL),
        ki=(2.0 * PID_LEVEL, 51.0 / 4.0 * PID_LEVEL),  # integral times of 25 s and 4 s
        base_error=0.485,
        wind_gain=1.7,
        feed_forward=False,
        max_tilt=math.radians(20.0),
    ),
    "px4": StockController(
        kp=(1.71, 4.0),
        kd=(1.8, 4.0),
        ki=(1.71 / 4.6, 2.0),
        base_error=0.105,
        wind_gain=1.52,
        max_tilt=math.radians(45.0),
        filtered=False,
    ),
}
"""Default parameters by controller name."""

CONTROLLERS = tuple(STOCK)  # Names of flight controllers

PX4_RANGES: Mapping[str, Pair] = {
    "MPC_XY_P": (0.0, 2.0),
    "MPC_Z_P": (0.0, 1.5),
    "MPC_XY_VEL_P_ACC": (1.2, 5.0),
    "MPC_Z_VEL_P_ACC": (2.0, 15.0),
    "MPC_XY_VEL_I_ACC": (0.0, 60.0),
    "MPC_Z_VEL_I_ACC": (0.2, 3.0),
}
"""Smallest and largest gains that PX4 declares: [1/s] and, of integrals, [1/s²]."""


def px4_gains(kp: Pair, kd: Pair, ki: Pair, mass: float) -> dict[str, float]:
    """Return the gains of PX4 that are nearest to a position loop, within PX4_RANGES."""
    gains = dict[str, float]()
    for axes, stiffness, damping, integral in zip(("XY", "Z"), kp, kd, ki, strict=True):
        gains[f"MPC_{axes}_P"] = stiffness / damping
        gains[f"MPC_{axes}_VEL_P_ACC"] = damping / mass
        gains[f"MPC_{axes}_VEL_I_ACC"] = integral * damping / (stiffness * mass)
    clipped = dict[str, float]()
    for name, gain in gains.items():
        smallest, largest = PX4_RANGES[name]
        clipped[name] = min(max(gain, smallest), largest)
    return clipped


def _px4_loop(gains: Mapping[str, float], mass: float) -> Iterator[Pair]:
    """Yield kp, kd and ki of PX4's gains, whose velocity loop follows ``P e + ė``."""
    level = gains["MPC_XY_P"]
    upright = gains["MPC_Z_P"]
    level_damping = mass * gains["MPC_XY_VEL_P_ACC"]
    upright_damping = mass * gains["MPC_Z_VEL_P_ACC"]
    level_integral = mass * gains["MPC_XY_VEL_I_ACC"]
    upright_integral = mass * gains["MPC_Z_VEL_I_ACC"]
    yield level * level_damping, upright * upright_damping
    yield level_damping, upright_damping
    yield level * level_integral, upright * upright_integral


def of_same_firmware(name: str) -> tuple[str, ...]:
    """Return the controllers of the firmware that has a controller: the Crazyflie's, or PX4."""
    return tuple(each for each in STOCK if STOCK[each].filtered == STOCK[name].filtered)


def stiffest_gains(
    mass: float, latency: float | None = None, name: str = "mellinger"
) -> dict[str, Any]:
    """Return the stiffest stable gains of a controller for a mass [kg] and a delay [s].

    Those of px4 are the largest that it declares.
    """
    if name == "px4":
        largest = {key: high for key, (_, high) in PX4_RANGES.items()}
        stiffness, damping, _ = _px4_loop(largest, mass)
        return {"kp": [*stiffness], "kd": [*damping], "ki": 0.0}
    scale = latency_scale(latency)
    kp, kd = STOCK[name].stiffest
    gains = {"kp": scale**2 * kp * mass, "kd": scale * kd * mass, "ki": 0.0}
    return {key: float(f"{gain:.3g}") for key, gain in gains.items()}


@dataclass(frozen=True)
class FlightController(OneLine):
    """A drone's position loop; pairs are horizontal and vertical values.

    Attributes
    ----------
    name: one of CONTROLLERS, or empty if the problem specifies numbers only.
    kp: stiffness [N/m]; infinite for a rigid loop, as are kd and ki then.
    kd: damping [N s/m]
    ki: gain of the integral [N/(m s)], zero without.
    ki_limit: largest force of the integral [N]; zero without one, infinite if unbounded.
    feed_forward: whether streamed accelerations, including the cable force, are added.
    max_tilt: largest tilt that it commands [rad]; π/2 if unlimited.
    tracking: largest tracking error of its drones [m], or None if unknown.
    false_pull: force of the damping on the false velocity that the Crazyflie's filter estimates,
        over the pull across the thrust, to which it is parallel. Zero for exact estimates.
    """

    name: str
    kp: Pair
    kd: Pair
    ki: Pair
    ki_limit: Pair
    feed_forward: bool
    max_tilt: float
    tracking: float | None
    false_pull: Pair = (0.0, 0.0)

    @classmethod
    def of(
        cls,
        name: str,
        mass: float,
        gains: Gains | Mapping[str, Any] | None = None,
        latency: float | None = None,
    ) -> FlightController:
        """Return the named controller for a drone's mass [kg]; ``gains`` override its defaults.

        Gains of px4 are clipped to PX4_RANGES. Raise InputError for an unknown name, or for gains
        that are too stiff to fly at a delay ``latency`` [s]; None is below UNSTATED_LATENCY.
        """
        check_choice("controller", name, CONTROLLERS)
        stock = STOCK[name]
        stated = Gains.of(gains)
        scale_of_stock = mass if stock.per_mass else 1.0

        def gain(key: str) -> Pair:
            """Return the stated gain, horizontal and vertical, or the default one."""
            level, upright = getattr(stock, key)
            given: Pair | None = getattr(stated, key)
            return (scale_of_stock * level, scale_of_stock * upright) if given is None else given

        kp, kd, ki = gain("kp"), gain("kd"), gain("ki")
        if name == "px4":
            kp, kd, ki = _px4_loop(px4_gains(kp, kd, ki, mass), mass)
        _check_gains(
            name, mass, latency, kp[0], kd[0], is_kp_checked=bool(stated.kp) or bool(latency)
        )
        tracking = stock.base_error + stock.wind_gain * wind_force(mass) / kp[0]
        pull_time = PULL_TIME if stock.filtered else 0.0
        return cls(
            name,
            kp,
            kd,
            ki,
            ki_limit=(
                _largest_integral_force(ki[0], stock.ki_range[0]),
                _largest_integral_force(ki[1], stock.ki_range[1]),
            ),
            feed_forward=stock.feed_forward,
            max_tilt=stock.max_tilt,
            tracking=min(max(tracking, MIN_TRACKING), MAX_TRACKING),
            false_pull=(pull_time * kd[0] / mass, pull_time * kd[1] / mass),
        )

    @classmethod
    def of_px4(cls, parameters: Mapping[str, float], mass: float) -> FlightController:
        """Return the position loop of PX4's parameters ``MPC_…`` for a drone's mass [kg]."""
        kp, kd, ki = _px4_loop(parameters, mass)
        level, upright = (math.inf if gain else 0.0 for gain in ki)
        stock = cls.of("px4", mass)
        return replace(stock, kp=kp, kd=kd, ki=ki, ki_limit=(level, upright), tracking=None)

    @classmethod
    def plain(
        cls, mass: float, stiffness: float | None, *, integral: bool, feed_forward: bool
    ) -> FlightController:
        """Return a loop with one stiffness [N/m] on all axes; None is rigid."""
        kp = math.inf if stiffness is None else stiffness
        kd = 2.0 * DAMPING_RATIO * math.sqrt(kp * mass)
        ki = kp / INTEGRAL_TIME if integral else 0.0
        ki_limit = math.inf if integral else 0.0
        return cls(
            name="",
            kp=(kp, kp),
            kd=(kd, kd),
            ki=(ki, ki),
            ki_limit=(ki_limit, ki_limit),
            feed_forward=feed_forward,
            max_tilt=0.5 * math.pi,
            tracking=None,
        )


def _largest_integral_force(ki: float, ki_range: float) -> float:
    """Return the largest force [N] of an integral, also with an unbounded range and a gain of 0."""
    return ki * ki_range if ki else 0.0


@dataclass(frozen=True)
class EstimatorParameters(OneLine):
    """Noise parameters of the Crazyflie's extended Kalman filter, by default those of exports.

    The filter predicts from the thrust axis and the gyroscope alone. A horizontal cable force shows
    only in its prediction error. If the process noise is small compared with that force, the filter
    attributes it to a false tilt or velocity.

    Parameters
    ----------
    level_noise, upright_noise: process noise of the acceleration along the body's x and y, and
        along its z (``kalman.pNAcc_xy``, ``kalman.pNAcc_z``) [m/s²].
    position_error: standard deviation of captured positions (``locSrv.extPosStdDev``) [m].
    attitude_error: standard deviation of captured attitudes (``locSrv.extQuatStdDev``) [rad]; None
        for drones with one marker, which has no attitude.

    Raises
    ------
    InputError: a number that is not positive.
    """

    level_noise: float = 20.0
    upright_noise: float = 20.0
    position_error: float = 1e-3
    attitude_error: float | None = 1e-2

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if value is not None:
                object.__setattr__(self, name, positive(name, value))

    @property
    def firmware_params(self) -> dict[str, dict[str, float]]:
        """The firmware's parameters by group and name, as crazyflies.yaml holds them."""
        kalman = {"pNAcc_xy": self.level_noise, "pNAcc_z": self.upright_noise}
        errors = {"extPosStdDev": self.position_error}
        if self.attitude_error is not None:
            errors["extQuatStdDev"] = self.attitude_error
        return {"kalman": kalman, "locSrv": errors}


HELD = EstimatorParameters()  # Values that exports set for rigid bodies of several markers

FIRMWARE = EstimatorParameters(
    level_noise=0.5, upright_noise=1.0, position_error=1e-2, attitude_error=4.5e-3
)
"""Defaults of the firmware for rigid bodies."""

ONE_MARKER = EstimatorParameters(
    level_noise=0.5, upright_noise=1.0, position_error=1e-2, attitude_error=None
)
"""Defaults of the firmware for drones with one marker; hitches do not hold with them."""


def _check_gains(
    name: str, mass: float, latency: float | None, kp: float, kd: float, *, is_kp_checked: bool
) -> None:
    """Raise InputError if horizontal gains are too stiff to fly at a delay ``latency`` [s].

    Default stiffness is checked for stated delays only: without one, the firmware's defaults are
    taken to fly. Damping has a limit only at delays beyond LATENCY, for which the stiffest gains
    are scaled down: up to there the limit of kp alone applies.
    """
    scale = latency_scale(latency)
    largest_kp, largest_kd = STOCK[name].stiffest
    if is_kp_checked:
        _check_stiffness(name, mass, latency, "kp", kp, scale**2 * largest_kp)
    if scale < 1.0:
        _check_stiffness(name, mass, latency, "kd", kd, scale * largest_kd)


GAIN_ROUNDING = 0.01  # Relative rounding of stated gains
GAIN_UNITS = {"kp": ("/s²", "N/m"), "kd": ("/s", "N s/m")}  # Units of gains, per mass and in total


def _check_stiffness(
    name: str, mass: float, latency: float | None, key: str, value: float, largest: float
) -> None:
    """Raise InputError if a horizontal gain exceeds ``largest`` times the mass, up to rounding."""
    if value <= (1.0 + GAIN_ROUNDING) * largest * mass:
        return
    per_mass, unit = GAIN_UNITS[key]
    when = f" at a latency of {1e3 * latency:g} ms" if latency else ""
    limit = f"{largest * mass:.3g} {unit} horizontally{when}"
    bound = f"at most {largest:.4g}{per_mass} times the mass, {limit}"
    stiffest = f"{stiffest_gains(mass, latency, name)}".replace("'", "")
    remedy = f"stiffer loops of {name} oscillate; the stiffest stable gains are {stiffest}"
    raise InputError(f"gains.{key}", value, bound, remedy)
