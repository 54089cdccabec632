"""Cables as MuJoCo simulates them; a resolution that cannot work is refused beforehand.

MuJoCo reports nothing where ropes of this kind fail, therefore their limits are checked here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hitchopt.errors import InputError
from hitchopt.hitch import Team
from hitchopt.simulation.simulation_settings import DENSITY, Preset, Settings
from hitchopt.values import Array, not_negative, per_robot, positive

COURANT = 0.7
"""Largest ratio of the time step to the time in which a transverse wave passes a segment."""

RESERVE = 2.0
"""Tension that a simulation must bear, over the team's; the pull test takes 1.5."""

ROUNDING = 1e-9
"""Tolerance of a count of segments: 2.4 m are 96 of 0.025 m in spite of rounding."""


@dataclass(frozen=True, eq=False)
class Ropes:
    """n cables, each divided into segments of equal length.

    Parameters
    ----------
    lengths: cable lengths (n,) [m].
    density: mass per length [kg/m].
    friction: coefficient between cables, and with the ground.
    preset: resolution.
    """

    lengths: Array
    density: float
    friction: float
    preset: Preset

    def __post_init__(self) -> None:
        lengths = per_robot("lengths", self.lengths, len(self.lengths))
        object.__setattr__(self, "lengths", lengths)
        object.__setattr__(self, "density", positive("density", self.density))
        object.__setattr__(self, "friction", not_negative("friction", self.friction))

    @property
    def segments(self) -> NDArray[np.intp]:
        """Number of segments of each cable (n,), even."""
        halves = np.ceil(self.lengths / (2.0 * self.preset.segment) - ROUNDING)
        counts: NDArray[np.intp] = 2 * np.maximum(halves, 1.0).astype(np.intp)
        return counts

    @property
    def segment_lengths(self) -> Array:
        """Length of one segment of each cable (n,) [m]."""
        return self.lengths / self.segments

    @property
    def largest_tension(self) -> float:
        """Largest tension at which waves and contacts are resolved [N]; beyond it ropes pass."""
        wave = COURANT * float(np.min(self.segment_lengths)) / self.preset.time_step
        return self.density * wave**2

    def check_tension(self, tension: float) -> None:
        """Check that the time step suits cables of a given tension [N].

        Raises
        ------
        InputError: a time step that is too long.
        """
        needed = RESERVE * tension
        if self.largest_tension < needed:
            shortest = float(np.min(self.segment_lengths))
            step = COURANT * shortest * math.sqrt(self.density / needed)
            raise InputError(
                "time_step",
                self.preset.time_step,
                f"at most {step:.3g} s for cables of {self.density:g} kg/m in segments of "
                f"{shortest:.3g} m that pull with up to {needed:.3g} N",
                "shorten it, or simulate heavier cables",
            )


def ropes_of(team: Team, settings: Settings, lengths: ArrayLike | None = None) -> Ropes:
    """Return the ropes of a team's cables.

    Parameters
    ----------
    team: supplies what the settings leave open.
    settings: resolution; density and friction where they replace the team's.
    lengths: (n,) [m]; None: the team's.

    Raises
    ------
    InputError: a resolution that cannot bear the team's tension.
    """
    ropes = Ropes(
        team.cable_length if lengths is None else np.asarray(lengths),
        settings.density or team.cable_density or DENSITY,
        team.cable_friction if settings.friction is None else settings.friction,
        settings.preset,
    )
    ropes.check_tension(float(np.max(team.tension)))
    return ropes
