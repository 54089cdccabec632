"""Settings of a simulated flight: resolution of the ropes, and disturbances.

Perturbations and settings declare their keys, from which the command line follows.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Any

from hitchopt.drones.controllers import (
    CONTROLLERS,
    FIRMWARE,
    HELD,
    ONE_MARKER,
    EstimatorParameters,
    Gains,
)
from hitchopt.errors import InputError, OneLine
from hitchopt.values import nonnegative
from hitchopt.values.fields import (
    FLAGS,
    Key,
    Record,
    integers,
    keys_of,
    mapping_of,
    words,
)
from hitchopt.values.units import (
    DELAY,
    DISTANCE,
    DRAG,
    FORCE,
    FRICTION,
    LIGHT_DENSITY,
    SPEED_OR_ZERO,
    STIFFNESS,
    deviation,
)

SHORT_LAG = 0.02  # Time constant of the motors' thrust, to which the attitude loop adds [s]
MOTOR_LAG = 0.03  # Time constant of the motors' thrust of a flight controller [s]
ROPES, CLASPS = "ropes", "clasps"  # Models of cables
IDEAL = "ideal"  # Name of the simplified controller, and of exact states in place of a filter
MAX_SEED = 2**63 - 1

ESTIMATORS: Mapping[str, EstimatorParameters | str] = {
    IDEAL: IDEAL, "crazyflie": HELD, "firmware": FIRMWARE, "one_marker": ONE_MARKER
}  # fmt: skip
"""Estimators by name: exact states, the exported parameters, and the firmware's defaults with a
rigid body or with one marker."""


def _estimator(key: str, value: object) -> EstimatorParameters | str:
    """Return parameters as they are, and a name of ESTIMATORS."""
    if isinstance(value, EstimatorParameters):
        return value
    name: str = _NAMES.check(key, value)
    return name


_NAMES = words(*ESTIMATORS)
ESTIMATOR = replace(_NAMES, check=_estimator)


@dataclass(frozen=True)
class Preset:
    """Resolution of the ropes in space and time."""

    name: str  # one of PRESETS
    segment: float  # largest length of a rope's segments [m]
    diameter: float  # of ropes [m], larger than that of real cables, as contacts require
    time_step: float  # integration step [s]
    reserve: float = 2.0  # resolved tension over the planned or current one; pull tests need 1.5

    @property
    def exact(self) -> bool:
        """Return whether positions of vertices are accurate to a centimetre."""
        return self.segment <= ACCURATE.segment


# FAST shows whether a hitch holds, but its links catch at clasps
FAST = Preset("fast", 0.030, 0.012, 0.001)
# With 2.0, clasps of ropes of 5 g/m at 0.7 N jerk by up to 12 N in the accurate preset
ACCURATE = Preset("accurate", 0.010, 0.012, 0.0004, 3.0)
PRESETS = {preset.name: preset for preset in (FAST, ACCURATE)}


@dataclass(frozen=True, eq=False)
class Perturbations(Record):
    """Disturbances that the plan does not model, all drawn from one seed.

    Errors are standard deviations, of vectors per axis; those of objects are the largest.
    """

    noise: Annotated[float, Key(DISTANCE, "Error of measured positions per axis")] = 0.0
    velocity_noise: Annotated[float, Key(SPEED_OR_ZERO, "Error of velocities per axis")] = 0.0
    wind: Annotated[float, Key(FORCE, "Root mean square of the gusts' force on a drone")] = 0.0
    steady_wind: Annotated[float, Key(FORCE, "Constant horizontal force on every drone")] = 0.0
    lag: Annotated[
        float | None,
        Key(
            DELAY,
            f"Time constant of the motors' thrust; null: {MOTOR_LAG} s of a flight controller, "
            f"else {SHORT_LAG} s, to which the attitude loop adds another 0.06 s",
        ),
    ] = None
    cable_error: Annotated[float, Key(deviation(0.1), "Relative error of cable lengths")] = 0.0
    start_error: Annotated[float, Key(DISTANCE, "Error of starts per axis")] = 0.0
    downwash: Annotated[bool, Key(FLAGS, "Simulate the downwash of drones on those below them")] = (
        False
    )
    object_mass: Annotated[
        float, Key(deviation(0.9), "Largest relative error of objects' masses")
    ] = 0.0
    object_friction: Annotated[
        float, Key(deviation(0.9), "Largest relative error of objects' friction")
    ] = 0.0
    object_place: Annotated[float, Key(DISTANCE, "Largest error of movable objects' places")] = 0.0
    rotor_drag: Annotated[float, Key(DRAG, "Drag of drones over their speed")] = 0.0


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
    object_mass=0.1,
    object_friction=0.2,
    object_place=0.02,
)


@dataclass(frozen=True)
class DroneKind:
    """Drones that fly in place of the plan's idealized ones."""

    controllers: tuple[str, ...]  # of their firmware; the first if the plan names none of them
    estimator: str  # one of ESTIMATORS
    perturbations: Perturbations


DRONES: Mapping[str, DroneKind] = {
    # Errors of positions are those of motion capture in the filter. A drone of 39 g has 0.015 N in
    # a wind in which one of 132 g has 0.03 N
    "crazyflie": DroneKind(
        ("mellinger", "lee", "pid"),
        "crazyflie",
        replace(
            INDOOR, noise=0.0, velocity_noise=0.0, wind=0.015, steady_wind=0.015, rotor_drag=0.012
        ),
    ),
    "px4": DroneKind(("px4",), IDEAL, INDOOR),  # its filter is not simulated, but its errors are
}
"""Drones by name, with which a flight has what real ones have."""


@dataclass(frozen=True)
class Loss(OneLine):
    """Loss of a robot by name, such as ``2``, at a time of the flight [s].

    Both of its drones let go of their cable.
    """

    name: str
    time: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "time", nonnegative("cut", self.time))

    @classmethod
    def parsed(cls, text: str) -> Loss:
        """Return the loss of a text ``ROBOT@SECONDS``; raise InputError for other texts."""
        if match := re.fullmatch(r"([\w.-]+)@(\d+(?:\.\d*)?)", text):
            return cls(match[1], float(match[2]))
        raise InputError("cut", text, "ROBOT@SECONDS", "write 2@12.5")

    @property
    def drones(self) -> tuple[str, str]:
        """Names of the drones that are lost."""
        return f"q{self.name}", f"r{self.name}"

    @property
    def cable(self) -> str:
        """Name of the cable that is let go."""
        return f"cable {self.name}"


@dataclass(frozen=True, eq=False)
class Settings(Record):
    """Settings of one simulated flight; None is what the plan states.

    Attributes without a key are ``preset``, the resolution of the ropes; ``perturbations``; and
    ``lost``, the loss of a robot, if any.
    """

    preset: Preset = FAST
    perturbations: Perturbations = CALM
    seed: Annotated[int, Key(integers(0, MAX_SEED), "Random seed")] = 0
    cables: Annotated[
        str,
        Key(
            words(ROPES, CLASPS),
            "Model of the cables: ropes of links that collide, from the plan's start to its end; "
            "or clasps, through which cables slide with friction, while the hitch is tied: exact "
            "vertices and many flights, but no tying, contacts, objects that move or pull tests",
        ),
    ] = ROPES
    friction: Annotated[float | None, Key(FRICTION, "Cable friction; null: the team's")] = None
    density: Annotated[
        float | None,
        Key(
            LIGHT_DENSITY,
            "Cable density, unknown to the drones; null: the team's, or for weightless cables the "
            "lightest that the preset holds",
        ),
    ] = None
    stiffness: Annotated[
        float | None,
        Key(
            STIFFNESS,
            "Stiffness of the drones' position loops; null: the team's, or 36/s² times the masses "
            "of rigid drones",
        ),
    ] = None
    pull_test: Annotated[bool, Key(FLAGS, "Pull the vertices at rests and after the plan")] = True
    lost: Loss | None = None
    drones: Annotated[
        str | None,
        Key(
            words(*DRONES),
            "Drones to simulate: their controller and filter if the plan names none of theirs, "
            "cables 0.5 % and starts 2 cm off, wind, downwash and errors of objects; other "
            "options override these; null: as the plan states, undisturbed",
        ),
    ] = None
    controller: Annotated[
        str | None,
        Key(
            words(*CONTROLLERS, IDEAL),
            "Flight controller, ideal being a simplified one; null: that of the team's drones, "
            "with its filter and exported files. Gains are the team's if it names this "
            "controller, otherwise the stiffest that fly",
        ),
    ] = None
    gains: Annotated[
        Gains | Mapping[str, Any] | None,
        Key(
            mapping_of(Gains),
            "Gains of the controller's position loops; null: the team's if it names this "
            "controller, otherwise the stiffest stable ones",
        ),
    ] = None
    estimator: Annotated[
        EstimatorParameters | str | None,
        Key(
            ESTIMATOR,
            "State estimator: ideal, exact except for noise and velocity_noise; crazyflie, the "
            "Crazyflie's filter with exported parameters on motion capture (100 Hz, 1 mm, "
            "latency) and an IMU; firmware or one_marker, the same with the firmware's parameters "
            "for rigid bodies or for one marker; null: crazyflie for a Crazyflie's controller of "
            "the "
            "team, otherwise ideal",
        ),
    ] = None
    upload: Annotated[
        bool | None,
        Key(
            FLAGS,
            "Fly exported files, which hold the tension by offsets if the controller has no "
            "integral, or streamed setpoints; null: files if the team's controller holds the "
            "tension with them",
        ),
    ] = None
    latency: Annotated[
        float | None,
        Key(
            DELAY,
            "Delay of motion capture and streamed setpoints, with a filter; null: the team's, or "
            "0.01 s",
        ),
    ] = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.controller == IDEAL:
            for name in ("gains", "estimator", "upload"):
                if (value := getattr(self, name)) and value != IDEAL:
                    remedy = f"name one of {', '.join(CONTROLLERS)}"
                    raise InputError(name, value, "omitted without a controller", remedy)
        if isinstance(self.estimator, str):
            object.__setattr__(self, "estimator", ESTIMATORS[self.estimator])

    @property
    def measures_vertices(self) -> bool:
        """Return whether positions of vertices are accurate to a centimetre."""
        return self.cables == CLASPS or self.preset.exact

    @property
    def lag(self) -> float:
        """Time constant of the motors' thrust [s]."""
        usual = MOTOR_LAG if self.controller in CONTROLLERS else SHORT_LAG
        return usual if self.perturbations.lag is None else self.perturbations.lag


PHYSICAL = ("friction", "density", "stiffness")
"""Settings that replace parameters of the plan, as perturbations do."""


def perturbation_keys() -> dict[str, Key]:
    """Return the keys of perturbations, and of settings that replace parameters of the plan."""
    settings = keys_of(Settings)
    return keys_of(Perturbations) | {name: settings[name] for name in PHYSICAL}


def settings_of(preset: str, *, perturbed: bool, **given: Any) -> Settings:
    """Return settings from names of their fields and of perturbations; None means absent.

    Other perturbations are INDOOR if ``perturbed``, else those of the ``drones``, if any, else
    CALM.
    """
    stated = {name: value for name, value in given.items() if value is not None}
    kind = stated.get("drones")
    of_drones = CALM if kind is None else DRONES[words(*DRONES).check("drones", kind)].perturbations
    usual = INDOOR if perturbed else of_drones
    changes = {name: stated.pop(name) for name in vars(usual) if name in stated}
    return Settings(preset=PRESETS[preset], perturbations=replace(usual, **changes), **stated)
