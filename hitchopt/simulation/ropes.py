"""The cables as MuJoCo knows them: their grain, checked before anything is simulated.

MuJoCo stays silent where ropes of this kind fail, so that what it cannot do is refused here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import InputError
from hitchopt.hitch import Team
from hitchopt.simulation.simulation_settings import DENSITY, Preset
from hitchopt.values import not_negative, positive

Array = NDArray[np.float64]

COURANT = 0.7
"""Longest time step over the time in which a transverse wave passes a segment."""

RESERVE = 2.0
"""A run must bear at least this times the team's tension: the pull test takes 1.5."""


@dataclass(frozen=True, eq=False)
class Ropes:
    """n cables, each cut into segments of equal length.

    Parameters
    ----------
    lengths: (n,) [m]
    density: [kg/m]
    friction: coefficient between cables, and to the ground.
    preset: how finely they are cut.
    """

    lengths: Array
    density: float
    friction: float
    preset: Preset

    def __post_init__(self) -> None:
        lengths = np.array(self.lengths, dtype=np.float64)
        if lengths.ndim != 1 or not np.all(np.isfinite(lengths) & (lengths > 0.0)):
            raise InputError("lengths", self.lengths, "positive lengths", "give one per cable")
        lengths.setflags(write=False)
        object.__setattr__(self, "lengths", lengths)
        object.__setattr__(self, "density", positive("density", self.density))
        object.__setattr__(self, "friction", not_negative("friction", self.friction))

    @property
    def segments(self) -> NDArray[np.intp]:
        """(n,): how many each cable has, an even number."""
        halves = np.ceil(self.lengths / (2.0 * self.preset.segment) - ROUNDING)
        counts: NDArray[np.intp] = 2 * np.maximum(halves, 1.0).astype(np.intp)
        return counts

    @property
    def segment_lengths(self) -> Array:
        """(n,) [m]: one segment of each."""
        return self.lengths / self.segments

    @property
    def largest_tension(self) -> float:
        """[N] Beyond it a wave passes a segment within the time step, and ropes pass each other."""
        wave = COURANT * float(np.min(self.segment_lengths)) / self.preset.time_step
        return self.density * wave**2

    def check_tension(self, tension: float) -> None:
        """Raise InputError unless the time step suits cables that pull with ``tension`` [N]."""
        needed = RESERVE * tension
        if self.largest_tension < needed:
            step = COURANT * float(np.min(self.segment_lengths)) * math.sqrt(self.density / needed)
            raise InputError(
                "time_step",
                self.preset.time_step,
                f"at most {step:.3g} s for cables of {self.density:g} kg/m in segments of "
                f"{float(np.min(self.segment_lengths)):.3g} m that pull with up to {needed:.3g} N",
                "shorten it, or simulate heavier cables",
            )


ROUNDING = 1e-9
"""In segments: 2.4 m are 96 of 0.025 m, whatever the last digit says."""


def ropes_of(
    team: Team,
    preset: Preset,
    density: float | None = None,
    friction: float | None = None,
    lengths: Array | None = None,
) -> Ropes:
    """Return the ropes of a team's cables.

    Parameters
    ----------
    team: whose cables they are.
    preset: how finely they are cut.
    density, friction, lengths: instead of the team's, or None; (n,) [m].

    Raises
    ------
    InputError: a grain that cannot carry the team's tension.
    """
    weight = density if density is not None else team.cable_density or DENSITY
    ropes = Ropes(
        team.cable_length if lengths is None else lengths,
        weight,
        team.cable_friction if friction is None else friction,
        preset,
    )
    ropes.check_tension(float(np.max(team.tension)))
    return ropes
