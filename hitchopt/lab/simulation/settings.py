"""Settings of a simulated flight: resolution of the ropes, and disturbances."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from hitchopt.errors import InputError, OneLine
from hitchopt.hitch.estimator import FIRMWARE, HELD, ONE_MARKER, EstimatorParameters
from hitchopt.hitch.flight_controller import CONTROLLERS, Gains
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
    """Resolution of the ropes in space and time.

    Parameters
    ----------
    name: one of PRESETS.
    segment: largest length of a rope's segments [m].
    diameter: rope diameter [m]; larger than that of real cables, as contacts require.
    time_step: integration step [s].
    """

    name: str
    segment: float
    diameter: float
    time_step: float

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

    Parameters
    ----------
    noise: standard deviation per axis of the error of the measured drone positions [m].
    velocity_noise: standard deviation per axis of the error of the measured velocities [m/s].
    wind: root mean square of the gust force on a drone [N].
    steady_wind: constant level force on every drone, in one random direction [N].
    lag: time constant of the motors' thrust [s]; None: MOTOR_LAG of a flight controller, else
        SHORT_LAG, to which the attitude loop adds another 60 ms.
    cable_error: standard deviation of the cable lengths, relative.
    start_error: standard deviation per axis of the drones' start positions [m].
    downwash: whether drones push down drones below them.
    vertex_noise: standard deviation per axis of measured vertices, independent at every
        measurement [m]; vertices are only measured for ``feedback``.
    vertex_delay: age of the measured vertices when they arrive [s].
    rotor_drag: drag of drones over their speed [N s/m]; None: 0.012 of calibrated drones, else 0.
    object_mass, object_friction: largest deviations of objects' masses and friction, relative.
    object_place: largest distance of movable objects from their planned positions [m].
    """

    noise: float = 0.0
    velocity_noise: float = 0.0
    wind: float = 0.0
    steady_wind: float = 0.0
    lag: float | None = None
    cable_error: float = 0.0
    start_error: float = 0.0
    downwash: bool = False
    vertex_noise: float = 0.0
    vertex_delay: float = 0.0
    object_mass: float = 0.0
    object_friction: float = 0.0
    object_place: float = 0.0
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
    """Settings of one simulated flight; None is what the plan states.

    Parameters
    ----------
    preset: resolution of the ropes.
    perturbations: disturbances.
    seed: seed of all random numbers.
    friction: coefficient at the clasps; None: the team's.
    density: cable density [kg/m]; None: the team's, or for cables without weight that of the
        lightest ropes that the preset holds. It is unknown to the drones.
    stiffness: of the drones' position loops [N/m]; None: the team's, or 36/s² times their masses
        for rigid drones.
    pull_test: whether the flight ends with a pull test of the hitch, if no drone is lost.
    lost: loss of a drone; None: no loss.
    feedback: whether setpoints are corrected by measured vertices, as ``Feedback`` does.
    controller: ``mellinger``, ``lee``, ``pid`` or ``px4``, or ``ideal``: a simplified one. None:
        that of the team's drones, with the filter and the setpoints of exports to it; ``ideal`` if
        they name none, or several.
    gains: of its position loops, a ``Gains`` or a mapping; None: those of the team's drones with
        this controller, for others the stiffest stable ones.
    estimator: state estimator from motion capture and IMU, in place of ``noise`` and
        ``velocity_noise``; ``ideal``: exact states with these errors. None: ``ideal`` if a
        controller is given or has another filter, else the Crazyflie's as exports set it.
    latency: delay of motion capture, and of streamed setpoints, with an estimator [s]; None: that
        of the team's drones, or 0.01.
    upload: whether drones fly exported files, which hold the tension by offsets, or streamed
        setpoints. None: streamed if a controller is given, cannot hold the tension, or has no
        memory for the plan.
    as_calibrated: what was measured on drones that fly, a mapping of their names as in
        ``team.quadrotor``, whatever the plan knows of them; None: what the plan states.
    """

    preset: Preset = FAST
    perturbations: Perturbations = CALM
    seed: int = 0
    friction: float | None = None
    density: float | None = None
    stiffness: float | None = None
    pull_test: bool = True
    lost: Loss | None = None
    feedback: bool = False
    controller: str | None = None
    gains: Gains | Mapping[str, Any] | None = None
    estimator: EstimatorParameters | str | None = None
    upload: bool | None = None
    latency: float | None = None
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
