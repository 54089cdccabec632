"""Settings of a simulated flight: the resolution of its ropes, and everything that disturbs it."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from hitchopt.errors import InputError, OneLine
from hitchopt.hitch.estimator import FIRMWARE, HELD, ONE_MARKER, EstimatorParameters
from hitchopt.hitch.flight_controller import CONTROLLERS, Gains
from hitchopt.values import check_choice, nonnegative, positive

# Largest relative deviations; more is most likely a percentage
LARGEST = {"cable_error": 0.1, "object_mass": 0.9, "object_friction": 0.9}

SHORT_LAG, MOTOR_LAG = 0.02, 0.03  # Time constants of the motors' thrust [s]

DENSITY = 0.01  # Cable density where the team gives none [kg/m]: a cord of 4 mm


def _check(record: object, checked: Callable[[str, object], float], *names: str) -> None:
    """Replace the named values of a frozen record by checked ones; None stays."""
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
    diameter: rope diameter [m]; larger than that of real cables, because contact needs it.
    time_step: integration step [s].
    """

    name: str
    segment: float
    diameter: float
    time_step: float

    @property
    def exact(self) -> bool:
        """Whether places of vertices are true to a centimetre."""
        return self.segment <= ACCURATE.segment


# Whether a hitch holds, with too few segments in its bends for friction; and a capstan's friction
FAST = Preset("fast", 0.030, 0.012, 0.001)
ACCURATE = Preset("accurate", 0.010, 0.012, 0.0004)
PRESETS = {preset.name: preset for preset in (FAST, ACCURATE)}


@dataclass(frozen=True)
class Perturbations(OneLine):
    """Disturbances that the plan does not know, all drawn from one seed.

    Parameters
    ----------
    noise: standard deviation per axis of the error of the measured drone positions [m].
    velocity_noise: standard deviation per axis of the error of the measured velocities [m/s].
    wind: root mean square of the gust force on a drone [N].
    steady_wind: constant level force on every drone, in one direction that the seed gives [N].
    lag: time constant of the motors' thrust [s]; None: MOTOR_LAG of a named controller, else
        SHORT_LAG, to which the attitude loop adds another 60 ms.
    cable_error: standard deviation of the cable lengths, relative.
    start_error: standard deviation per axis of the drones' start positions [m].
    downwash: whether drones push down those below them.
    vertex_noise: standard deviation per axis of measured vertices, new at every measurement [m];
        vertices are measured for ``feedback`` alone.
    vertex_delay: age of the measured vertices when they arrive [s].
    object_mass, object_friction: largest deviations of objects' masses and friction, relative.
    object_place: largest distance of movable objects from where they are said to stand [m].
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

    def __post_init__(self) -> None:
        _check(self, nonnegative, *(name for name in vars(self) if name != "downwash"))
        for name, most in LARGEST.items():
            if getattr(self, name) > most:
                raise InputError(name, getattr(self, name), f"at most {most}", "give a fraction")


CALM = Perturbations()

# Perturbations of a flight indoors, besides the lag of the thrust and the team's friction
USUAL = Perturbations(
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
    """A drone, by name, whose motors stop at a time of the flight [s]."""

    drone: str
    time: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "time", nonnegative("lose", self.time))

    @classmethod
    def parsed(cls, text: str) -> Loss:
        """Return the loss that ``DRONE@SECONDS`` names; InputError where it is none."""
        if (match := re.fullmatch(r"([\w.-]+)@(\d+(?:\.\d*)?)", text)) is None:
            raise InputError("lose", text, "DRONE@SECONDS", "write q0@12.5")
        return cls(match[1], float(match[2]))


@dataclass(frozen=True)
class Settings(OneLine):
    """Settings of one simulated flight.

    Parameters
    ----------
    preset: resolution of the ropes.
    perturbations: disturbances.
    seed: seed of all random numbers.
    friction: coefficient at the clasps that replaces the team's; None: the team's.
    density: cable density that replaces the team's [kg/m]; None: the team's, and DENSITY where its
        cables have no weight, as ropes need some. Drones do not know what the ropes weigh.
    stiffness: of the drones' position loops [N/m]; None: the team's, and 36/s² times their masses
        where the team's drones are rigid.
    pull_test: whether the flight ends with a pull test of the hitch, if no drone is lost.
    lost: a drone whose motors stop; None: all fly on.
    feedback: whether setpoints are corrected by measured vertices, as ``Feedback`` does.
    controller: ``mellinger``, ``lee``, ``pid`` or ``px4``, which flies the drones; None: a quick
        one, which is none of these.
    gains: of its position loops, a ``Gains`` or a mapping; None: those of the team's drones that
        name this controller, for others the stiffest ones that fly.
    estimator: of drones that know their state from a motion capture and an IMU, in place of
        ``noise`` and ``velocity_noise``; needs a controller. None: they know it but for these.
    upload: whether the controller flies the files of an export, which hold the tension by offsets,
        not what is streamed to it.
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
    estimator: EstimatorParameters | None = None
    upload: bool = False

    def __post_init__(self) -> None:
        if self.controller is not None:
            check_choice("controller", self.controller, CONTROLLERS)
        else:
            for name in ("gains", "estimator", "upload"):
                if value := getattr(self, name):
                    remedy = f"name one of {', '.join(CONTROLLERS)}"
                    raise InputError(name, value, "left out without a controller", remedy)
        if self.gains is not None:
            object.__setattr__(self, "gains", Gains.of(self.gains))
        if self.upload and self.feedback:
            bound = "left out with upload"
            raise InputError("feedback", True, bound, "uploaded files cannot be corrected")
        if isinstance(self.seed, bool) or self.seed < 0:
            raise InputError("seed", self.seed, "a whole number, at least 0", "0 will do")
        _check(self, nonnegative, "friction")
        _check(self, positive, "density", "stiffness")

    @property
    def lag(self) -> float:
        """Time constant of the motors' thrust [s]."""
        usual = SHORT_LAG if self.controller is None else MOTOR_LAG
        return usual if self.perturbations.lag is None else self.perturbations.lag


ESTIMATORS: Mapping[str, EstimatorParameters | None] = {
    "ideal": None, "crazyflie": HELD, "firmware": FIRMWARE, "one_marker": ONE_MARKER
}  # fmt: skip
"""Estimators by name: exact states, the exported parameters, and the firmware's defaults with a
rigid body or with one marker."""


def settings_of(preset: str, *, perturbed: bool, **given: Any) -> Settings:
    """Return settings by the names of their fields and of perturbations'; None counts as absent.

    Perturbations that are not given are the USUAL ones if ``perturbed``, else CALM. The estimator
    may be named, as in ESTIMATORS.
    """
    usual = USUAL if perturbed else CALM
    stated = {name: value for name, value in given.items() if value is not None}
    changes = {name: stated.pop(name) for name in vars(usual) if name in stated}
    if isinstance(named := stated.get("estimator"), str):
        check_choice("estimator", named, tuple(ESTIMATORS))
        stated["estimator"] = ESTIMATORS[named]
    return Settings(preset=PRESETS[preset], perturbations=replace(usual, **changes), **stated)
