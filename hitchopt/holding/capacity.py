"""The largest mass that a hold carries, and the limit that binds."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from hitchopt.errors import InfeasibleError
from hitchopt.one_line import OneLine

RESOLUTION = 1e-7
"""[kg] Resolution of masses."""

ROUNDING = 1e-9
"""Margin below zero at which a limit is kept, as by the certificate: pulls may be at a limit."""

EASED = 0.95
"""Share of the largest mass at rest that is suggested: lifting and carrying pull at it too."""

SUGGESTED = {
    "grip": "raise the tension, or use rougher cables",
    "tilt": "raise limits.tilt_deg",
    "thrust": "use stronger drones, or lower the tension",
    "separation": "use cables of another length",
    "cable_clearance": "use longer cables",
    "crossing": "use shorter cables",
    "keep_out": "use longer cables",
    "legs": "use longer cables",
    "equilibrium": "raise the tension",
    "support": "use a wider rim, or lower the centre of mass",
}
"""Changes that let a hold carry more, by the limit that binds."""


@dataclass(frozen=True)
class Capacity(OneLine):
    """What a hold carries at most.

    Attributes
    ----------
    mass: [kg]; 0 where it breaks a limit without a load.
    binding: the limit that binds, named as the certificate's check.
    """

    mass: float
    binding: str

    @property
    def suggested(self) -> str:
        """A change that raises it."""
        if self.mass == 0.0 and self.binding not in SUGGESTED:
            return "use another number of robots, or cables of another length"
        return SUGGESTED.get(self.binding, "use longer cables")


def largest_mass(margins: Callable[[float], Mapping[str, float]], most: float) -> Capacity:
    """Return the largest mass at which no margin is negative, and whose margin ends it.

    Parameters
    ----------
    margins: of a mass [kg], by limits; falling with the mass, as far as they bind. It may raise
        InfeasibleError where the hold has no balance.
    most: a mass [kg] that is too large.
    """

    def worst(mass: float) -> tuple[float, str]:
        try:
            found = margins(mass)
        except InfeasibleError as error:
            return -1.0, error.violations[0].constraint
        name = min(found, key=lambda key: found[key])
        return found[name], name

    margin, name = worst(0.0)
    if margin < -ROUNDING:
        return Capacity(0.0, name)
    if worst(most)[0] >= -ROUNDING:
        raise ValueError(f"{most} kg are held, and were to be too much")
    low, high = 0.0, most
    while high - low > RESOLUTION:
        middle = 0.5 * (low + high)
        margin, reason = worst(middle)
        if margin >= -ROUNDING:
            low = middle
        else:
            high, name = middle, reason
    return Capacity(low, name)
