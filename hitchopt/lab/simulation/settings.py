"""Settings of a simulated flight: resolution of the ropes, and disturbances."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from hitchopt.errors import InputError, OneLine
from hitchopt.hitch.flight_controller import (
    CONTROLLERS,
    FIRMWARE,
    HELD,
    ONE_MARKER,
    EstimatorParameters,
    Gains,
)
from hitchopt.values import check_choice, nonnegative, positive

# Largest relative deviations; larger numbers are probably percentages
MAX_DEVIATIONS = {"cable_error": 0.1, "object_mass": 0.9, "object_friction": 0.9}

SHORT_LAG, MOTOR_LAG = 0.02, 0.03  # Time constants of the motors' thrust [s]
IDEAL = "ideal"  # Name of the simplified controller, and of exact states in place of a filter


def _check(record: object, checked: Callable[[str, object], float], *names: str) -> None:
    """Validate the named values of a frozen record, except None."""
    for name in names:
        if (value := getattr(record, name)) is not None:
            object.__setattr__(record, name, checked(name, value))


@dataclass(frozen=True)
class Preset:
    """Resolution of the ropes in space and time."""

    name: str  # one of PRESETS
    segment: float  # largest length of a rope's segments [m]
    diameter: float  # of ropes [m], larger than that of real cables, as contacts require
    time_step: float  # integration step [s]

    @property
    def exact(self) -> bool:
        """Whether positions of vertices are accurate to a centimetre."""
        return self.segment <= ACCURATE.segment


# FAST shows whether a hitch holds, but its links catch at clasps
FAST = Preset("fast", 0.030, 0.012, 0.001)
ACCURATE = Preset("accurate", 0.010, 0.012, 0.0004)
PRESETS = {preset.name: preset for preset in (FAST, ACCURATE)}


@dataclass(frozen=True)
class Perturbations(OneLine):
    """Disturbances that the plan does not model, all drawn from one seed.

    Errors are standard deviations, of vectors per axis; those of objects are the largest.
    """

    noise: float = 0.0  # error of measured drone positions [m]
    velocity_noise: float = 0.0  # error of measured velocities [m/s]
    wind: float = 0.0  # root mean square of the gust force on a drone [N]
    steady_wind: float = 0.0  # constant level force on every drone, in one random direction [N]
    # time constant of the motors' thrust [s]; None: MOTOR_LAG of a flight controller, else
    # SHORT_LAG, to which the attitude loop adds another 60 ms
    lag: float | None = None
    cable_error: float = 0.0  # error of the cable lengths, relative
    start_error: float = 0.0  # error of the drones' start positions [m]
    downwash: bool = False  # whether drones push down drones below them
    # error of measured vertices, independent at every measurement [m], and their age when they
    # arrive [s]; vertices are only measured for feedback
    vertex_noise: float = 0.0
    vertex_delay: float = 0.0
    object_mass: float = 0.0  # error of objects' masses, relative
    object_friction: float = 0.0  # error of objects' friction, relative
    object_place: float = 0.0  # distance of movable objects from their planned positions [m]
    # drag of drones over their speed [N s/m]; None: 0.012 of calibrated drones, else 0
    rotor_drag: float | None = None

    def __post_init__(self) -> None:
        _check(self, nonnegative, *(name for name in vars(self) if name != "downwash"))
        for name, most in MAX_DEVIATIONS.items():
            if getattr(self, name) > most:
                raise InputError(name, getattr(self, name), f"at most {most}", "give a fraction")


CALM = Perturbations()

# Typical perturbations indoors, in addition to the lag of the thrust and the team's friction
INDOOR = Perturbations(
    noise=0.01,
    velocity_noise=0.03,
    wind=0.05,
    steady_wind=0.05,
    cable_error=0.005,
    start_error=0.02,
    downwash=True,
    vertex_noise=0.01,
    vertex_delay=0.05,
    object_mass=0.1,
    object_friction=0.2,
    object_place=0.02,
)


@dataclass(frozen=True)
class Loss(OneLine):
    """Loss of a drone, by name, whose motors stop at a time of the flight [s]."""

    drone: str
    time: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "time", nonnegative("lose", self.time))

    @classmethod
    def parsed(cls, text: str) -> Loss:
        """Return the loss of a text ``DRONE@SECONDS``; InputError for other texts."""
        if (match := re.fullmatch(r"([\w.-]+)@(\d+(?:\.\d*)?)", text)) is None:
            raise InputError("lose", text, "DRONE@SECONDS", "write q0@12.5")
        return cls(match[1], float(match[2]))


@dataclass(frozen=True)
class Settings(OneLine):
    """Settings of one simulated flight; None is what the plan states."""

    preset: Preset = FAST  # resolution of the ropes
    perturbations: Perturbations = CALM  # disturbances
    seed: int = 0  # of all random numbers
    friction: float | None = None  # coefficient at the clasps
    # cable density [kg/m]; None: the team's, or for cables without weight that of the lightest
    # ropes that the preset holds. It is unknown to the drones
    density: float | None = None
    # of the drones' position loops [N/m]; None: the team's, or 36/s² times their masses for rigid
    # drones
    stiffness: float | None = None
    pull_test: bool = True  # whether the flight ends with a pull test, if no drone is lost
    lost: Loss | None = None  # loss of a drone; None: no loss
    feedback: bool = False  # whether measured vertices correct setpoints, as ``Feedback`` does
    # ``mellinger``, ``lee``, ``pid`` or ``px4``, or ``ideal``: a simplified one. None: that of the
    # team's drones, with the filter and the setpoints of exports to it; ``ideal`` if they name
    # none, or several
    controller: str | None = None
    # of its position loops; None: those of the team's drones with this controller, for others the
    # stiffest stable ones
    gains: Gains | Mapping[str, Any] | None = None
    # state estimator from motion capture and IMU, in place of ``noise`` and ``velocity_noise``;
    # ``ideal``: exact states with these errors. None: ``ideal`` if a controller is given or has
    # another filter, else the Crazyflie's as exports set it
    estimator: EstimatorParameters | str | None = None
    # whether drones fly exported files, which hold the tension by offsets, or streamed setpoints.
    # None: streamed if a controller is given, cannot hold the tension, or has no memory for the
    # plan
    upload: bool | None = None
    # delay of motion capture, and of streamed setpoints, with an estimator [s]; None: that of the
    # team's drones, or 0.01
    latency: float | None = None
    # what was measured on drones that fly, a mapping of their names as in ``team.quadrotor``,
    # whatever the plan knows of them
    as_calibrated: Mapping[str, Any] | None = None

    def __post_init__(self) -> None:
        if self.controller is not None:
            check_choice("controller", self.controller, (*CONTROLLERS, IDEAL))
        if self.controller == IDEAL:
            for name in ("gains", "estimator", "upload"):
                if (value := getattr(self, name)) and value != IDEAL:
                    remedy = f"name one of {', '.join(CONTROLLERS)}"
                    raise InputError(name, value, "left out without a controller", remedy)
        if isinstance(self.estimator, str):
            check_choice("estimator", self.estimator, (IDEAL,))
        if self.gains is not None:
            object.__setattr__(self, "gains", Gains.of(self.gains))
        if self.upload and self.feedback:
            bound = "left out with upload"
            raise InputError("feedback", True, bound, "uploaded files cannot be corrected")
        if isinstance(self.seed, bool) or self.seed < 0:
            raise InputError("seed", self.seed, "a whole number, at least 0", "0 will do")
        _check(self, nonnegative, "friction", "latency")
        _check(self, positive, "density", "stiffness")

    @property
    def lag(self) -> float:
        """Time constant of the motors' thrust [s]."""
        usual = MOTOR_LAG if self.controller in CONTROLLERS else SHORT_LAG
        return usual if self.perturbations.lag is None else self.perturbations.lag


ESTIMATORS: Mapping[str, EstimatorParameters | str] = {
    IDEAL: IDEAL, "crazyflie": HELD, "firmware": FIRMWARE, "one_marker": ONE_MARKER
}  # fmt: skip
"""Estimators by name: exact states, the exported parameters, and the firmware's defaults with a
rigid body or with one marker."""


def settings_of(preset: str, *, perturbed: bool, **given: Any) -> Settings:
    """Return settings from names of their fields and of perturbations; None counts as absent.

    Other perturbations are INDOOR if ``perturbed``, else CALM. The estimator may be a name of
    ESTIMATORS.
    """
    usual = INDOOR if perturbed else CALM
    stated = {name: value for name, value in given.items() if value is not None}
    changes = {name: stated.pop(name) for name in vars(usual) if name in stated}
    if isinstance(name := stated.get("estimator"), str):
        check_choice("estimator", name, tuple(ESTIMATORS))
        stated["estimator"] = ESTIMATORS[name]
    return Settings(preset=PRESETS[preset], perturbations=replace(usual, **changes), **stated)
