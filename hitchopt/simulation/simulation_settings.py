"""What a simulated flight is like: its grain, its drones, and everything that disturbs it."""

from __future__ import annotations

from dataclasses import dataclass

from hitchopt.errors import InputError
from hitchopt.values import finite, not_negative, positive

BODIES = ("rigid", "point")


@dataclass(frozen=True)
class Preset:
    """How finely ropes are cut, in space and in time.

    Parameters
    ----------
    name: what it is called.
    segment: a rope's segments are no longer than this [m].
    diameter: of the simulated ropes [m]. Thicker than real ones: contact needs it.
    time_step: [s]
    """

    name: str
    segment: float
    diameter: float
    time_step: float

    def __post_init__(self) -> None:
        for name in ("segment", "diameter", "time_step"):
            object.__setattr__(self, name, positive(name, getattr(self, name)))

    @property
    def friction_holds(self) -> bool:
        """Whether segments are short enough for friction to be right, not only topology."""
        return self.segment <= FRICTION_GRAIN * self.diameter


FRICTION_GRAIN = 0.85
"""Longest segment over diameter with which a clasp's friction is that of a capstan."""

FAST = Preset("fast", 0.030, 0.012, 0.001)
"""For topology: does it hold. Bends are made of too few segments for friction to be right."""

ACCURATE = Preset("accurate", 0.010, 0.012, 0.0004)
"""For friction: the tension ratio of a clasp is that of a capstan."""

PRESETS = {preset.name: preset for preset in (FAST, ACCURATE)}


@dataclass(frozen=True)
class Perturbations:
    """What a flight meets that its plan knows nothing of; all of it drawn from one seed.

    Parameters
    ----------
    noise: standard deviation, per axis, of the position that a drone believes [m].
    wind: root mean square of the force of gusts on a drone [N].
    lag: time constant of the thrust [s]; by default MOTOR_LAG of a rigid body, FORCE_LAG of a
        point mass, which has no attitude to turn first.
    cable_error: standard deviation of the cables' lengths, relative.
    start_error: standard deviation, per axis, of where the drones start [m].
    downwash: whether drones blow on those below them.
    """

    noise: float = 0.0
    wind: float = 0.0
    lag: float | None = None
    cable_error: float = 0.0
    start_error: float = 0.0
    downwash: bool = False

    def __post_init__(self) -> None:
        for name in ("noise", "wind", "cable_error", "start_error"):
            object.__setattr__(self, name, not_negative(name, getattr(self, name)))
        if self.lag is not None:
            object.__setattr__(self, "lag", not_negative("lag", self.lag))
        if self.cable_error > LARGEST_CABLE_ERROR:
            raise InputError(
                "cable_error",
                self.cable_error,
                f"at most {LARGEST_CABLE_ERROR}",
                "give the standard deviation as a fraction of the length",
            )


LARGEST_CABLE_ERROR = 0.1

CALM = Perturbations()

USUAL = Perturbations(noise=0.01, wind=0.05, cable_error=0.005, start_error=0.02)
"""As rope simulations of the swap have been flown before; with 80 ms from command to force."""

MOTOR_LAG = 0.02
"""[s] Of a rigid drone's motors; its attitude loop takes the other 60 ms."""

FORCE_LAG = 0.08
"""[s] From a point mass's command to its force."""


@dataclass(frozen=True)
class Settings:
    """One simulated flight.

    Parameters
    ----------
    preset: the grain.
    body: ``rigid`` bodies with an attitude, or ``point`` masses.
    perturbations: what disturbs it.
    seed: of everything random.
    friction: at the clasps, instead of the team's; or None.
    density: of the cables [kg/m], instead of the team's; None: the team's, and DENSITY where the
        team's cables have no weight, since a rope without mass cannot be simulated.
    ground: its height [m]; None: 0, or lower where drones are told to go lower, so that they stand
        on it.
    pull_test: whether the hitch is pulled at in the end.
    """

    preset: Preset = FAST
    body: str = "rigid"
    perturbations: Perturbations = CALM
    seed: int = 0
    friction: float | None = None
    density: float | None = None
    ground: float | None = None
    pull_test: bool = True

    def __post_init__(self) -> None:
        if self.body not in BODIES:
            raise InputError("body", self.body, " or ".join(BODIES), "write rigid")
        if isinstance(self.seed, bool) or self.seed < 0:
            raise InputError("seed", self.seed, "a whole number, at least 0", "0 will do")
        if self.friction is not None:
            object.__setattr__(self, "friction", not_negative("friction", self.friction))
        if self.density is not None:
            object.__setattr__(self, "density", positive("density", self.density))
        if self.ground is not None:
            object.__setattr__(self, "ground", finite("ground", self.ground))

    @property
    def lag(self) -> float:
        """[s] Time constant from the command to the force (rigid: along the drone's axis)."""
        if self.perturbations.lag is not None:
            return self.perturbations.lag
        return MOTOR_LAG if self.body == "rigid" else FORCE_LAG


DENSITY = 0.01
"""[kg/m] Of cables whose team gives them no weight: a cord of 4 mm."""
