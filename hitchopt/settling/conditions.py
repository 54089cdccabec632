"""Conditions under which a plan's hitch settles: what differs from the plan."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hitchopt.errors import InputError
from hitchopt.hitch import Team
from hitchopt.hitch.position_control import undetermined_tension
from hitchopt.values import Array, not_negative, positive

AXIAL_STIFFNESS = 1e4
"""[N] EA of a braided polyethylene line of 1 mm: at 0.5 N it is longer by 5e-5. Cables that are
all but inextensible; without any stretch the tension between rigid drones would be undetermined."""

FRICTION = (
    "clasps are taken to be without friction: at a clasp where the cable bends by β its tension "
    "may differ by a factor of up to exp(friction·β)"
)
"""What is to be known of a team whose cables rub."""


@dataclass(frozen=True, eq=False)
class Conditions:
    """Lengths, weights, loads, controllers and errors; whatever is None is the team's.

    Leading axes (…) are samples; they broadcast with each other and with the times.

    Parameters
    ----------
    cable_length: real lengths [m] under the planned tension, one, (n,) or (…, n).
    cable_density: [kg/m]
    load: masses that hang at the clasps [kg], one, or (clasps,).
    stiffness: of the drones' position loops [N/m], one or (2n,); infinite where they are rigid.
    integral: whether the controllers drive position errors to zero.
    feed_forward: whether the controllers add the cable force that the set points hold.
    offsets: errors of the drones' set points (…, 2n, 3) [m].
    forces: errors of the force feed-forward (…, 2n, 3) [N].
    axial_stiffness: EA of the cables [N].

    Raises
    ------
    InputError: a number out of its range.
    """

    cable_length: ArrayLike | None = None
    cable_density: float | None = None
    load: ArrayLike | None = None
    stiffness: ArrayLike | None = None
    integral: bool | None = None
    feed_forward: bool | None = None
    offsets: ArrayLike = 0.0
    forces: ArrayLike = 0.0
    axial_stiffness: float = AXIAL_STIFFNESS

    def __post_init__(self) -> None:
        set_ = object.__setattr__
        set_(self, "axial_stiffness", positive("axial_stiffness", self.axial_stiffness))
        if self.cable_density is not None:
            set_(self, "cable_density", not_negative("cable_density", self.cable_density))

    def lengths(self, team: Team) -> Array:
        """Return (…, n) [m]."""
        given = team.cable_length if self.cable_length is None else self.cable_length
        return _array("cable_length", given, (team.robots,), least=0.0)

    def weight(self, team: Team) -> float:
        """Return the weight of the cables without gravity [kg/m]."""
        return team.cable_density if self.cable_density is None else self.cable_density

    def loads(self, team: Team) -> Array:
        """Return (clasps,) [kg]."""
        given = team.load if self.load is None else self.load
        return _array("load", given, (len(team.layout.clasps),), least=-1e-300)

    def drone_stiffness(self, team: Team) -> Array:
        """Return (2n,) [N/m]; infinite where a drone stands at its set point whatever the force."""
        given = team.stiffness if self.stiffness is None else self.stiffness
        try:
            stiffness = np.broadcast_to(np.asarray(given, np.float64), (team.drones,))
        except ValueError:
            stiffness = np.zeros(team.drones)
        if not np.all(stiffness > 0.0):
            bound = f"one positive number, or {team.drones} of them"
            raise InputError("stiffness", given, bound, "inf is rigid")
        integral = team.integral if self.integral is None else self.integral
        return np.where(integral, np.inf, stiffness)

    def fed_forward(self, team: Team) -> NDArray[np.bool_]:
        """Return (2n,), whether the drones' controllers add the cable force."""
        given = team.feed_forward if self.feed_forward is None else self.feed_forward
        return np.broadcast_to(np.asarray(given, np.bool_), (team.drones,))

    def notes(self, team: Team) -> tuple[str, ...]:
        """Return why the plan does not determine the tensions, and what else is to be known."""
        integral = team.integral if self.integral is None else np.array(self.integral)
        notes = undetermined_tension(
            integral=bool(np.any(integral)), feed_forward=bool(np.all(self.fed_forward(team)))
        )
        if team.cable_friction > 0.0:
            notes += (FRICTION,)
        return notes

    def errors(self, name: str, team: Team) -> Array:
        """Return the ``offsets`` or ``forces`` (…, 2n, 3)."""
        given: Any = getattr(self, name)
        return _array(name, given, (team.drones, 3))


def _array(name: str, given: ArrayLike, shape: tuple[int, ...], least: float = -np.inf) -> Array:
    """Return values of shape (…, *shape); one number stands for all.

    Raises
    ------
    InputError: another shape, or a number that is not finite or not above ``least``.
    """
    values = np.asarray(given, dtype=np.float64)
    if values.ndim == 0:
        values = np.broadcast_to(values, shape)
    if values.shape[-len(shape) :] != shape:
        raise InputError(name, values.shape, f"one number, or of shape (…, {shape})", "see help")
    if not np.all(np.isfinite(values) & (values > least)):
        bound = "finite" if least == -np.inf else "finite and positive"
        raise InputError(name, "an entry", bound, "give plain numbers in SI units")
    return values
