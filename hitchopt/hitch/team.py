"""The team: quadrotors, cables, and the tensions of the cables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hitchopt import units
from hitchopt.errors import InputError
from hitchopt.hitch.layout import CLOSED, OPEN, Layout, layout_of
from hitchopt.one_line import OneLine
from hitchopt.units import check_lift, check_unit
from hitchopt.values import instance, not_negative, per_robot, positive, sequence

GRAVITY = 9.81
"""[m/s²] Acceleration of gravity, downward."""

MAX_ROBOTS = 10_000
"""Largest number of robots, checked before any memory is allocated."""

TOPOLOGIES = (CLOSED, OPEN)

UNITS = {
    "cable_length": units.CABLE_LENGTH,
    "cable_density": units.DENSITY,
    "cable_friction": units.FRICTION,
    "tension": units.TENSION,
    "load": units.LOAD,
}
"""Quantities whose units are checked."""


@dataclass(frozen=True)
class Quadrotor(OneLine):
    """One quadrotor.

    Parameters
    ----------
    mass: [kg]
    max_thrust: largest collective thrust [N]
    stiffness: force with which the position loop answers an offset from its set point [N/m]; None
        is rigid.
    integral: whether the controller drives the position error to zero, whatever the force.
    feed_forward: whether the controller adds the cable force that the set points hold.
    """

    mass: float = 0.132
    max_thrust: float = 2.6
    stiffness: float | None = None
    integral: bool = False
    feed_forward: bool = True

    def __post_init__(self) -> None:
        object.__setattr__(self, "mass", positive("mass", self.mass))
        object.__setattr__(self, "max_thrust", positive("max_thrust", self.max_thrust))
        check_unit("mass", self.mass, units.MASS)
        check_unit("max_thrust", self.max_thrust, units.THRUST)
        check_lift(self.mass, self.max_thrust, GRAVITY)
        if self.stiffness is not None:
            object.__setattr__(self, "stiffness", positive("stiffness", self.stiffness))
            check_unit("stiffness", self.stiffness, units.STIFFNESS)
        for name in ("integral", "feed_forward"):
            value = getattr(self, name)
            if not isinstance(value, bool):
                raise InputError(name, value, "true or false", "write true or false")


def kinds_of(
    given: Quadrotor | Sequence[Quadrotor] | None, count: int, owner: str
) -> tuple[Quadrotor, ...]:
    """Return one kind per owner; one kind is meant for all, and None for the default kind."""
    kind = Quadrotor() if given is None else given
    kinds = (kind,) * count if isinstance(kind, Quadrotor) else sequence("quadrotor", kind)
    for k, each in enumerate(kinds):
        instance(f"quadrotor[{k}]", each, Quadrotor)
    if len(kinds) != count:
        raise InputError(
            "quadrotor", len(kinds), f"one kind, or a list of {count}", f"give one per {owner}"
        )
    return kinds


def _loads(given: float | Sequence[float] | ArrayLike, clasps: int) -> NDArray[np.float64]:
    """Return what hangs at the clasps (clasps,) [kg].

    An array of one value throughout holds for any number of clasps, so that a team can be copied
    with another topology or number of robots.
    """
    if isinstance(given, np.ndarray) and given.size > 0 and given.ndim > 0:
        given = float(given[0]) if np.all(given == given[0]) else given
    return per_robot("load", given, clasps, not_negative, "clasp")


@dataclass(frozen=True, eq=False)
class Team(OneLine):
    """n catenary robots: two quadrotors each, on the ends of one cable.

    Parameters
    ----------
    robots: number n of catenary robots.
    cable_length: one, or one per robot (n,) [m].
    topology: ``closed`` (a polygon of n points) or ``open`` (a chain along an arc of n + 1).
    cable_density: [kg/m]
    cable_friction: coefficient at the clasps, where one cable slides about the other.
    tension: one, or one per robot (n,) [N].
    quadrotor: one kind for all, or one per robot; both drones of a robot are of its kind. Stored as
        one per robot.
    load: what hangs at the clasps, one or one per clasp (clasps,) [kg]: at every vertex of a closed
        hitch, at the inner points of a chain.

    Raises
    ------
    InputError: a count, sign or number that is wrong in itself.
    """

    robots: int
    cable_length: NDArray[np.float64]
    topology: str
    cable_density: float
    cable_friction: float
    tension: NDArray[np.float64]
    quadrotor: tuple[Quadrotor, ...] = field(repr=False)
    load: NDArray[np.float64] = field(repr=False)

    def __init__(
        self,
        robots: int,
        cable_length: float | Sequence[float] | ArrayLike,
        *,
        topology: str = CLOSED,
        cable_density: float = 0.0,
        cable_friction: float = 0.0,
        tension: float | Sequence[float] | ArrayLike = 0.4,
        quadrotor: Quadrotor | Sequence[Quadrotor] | None = None,
        load: float | Sequence[float] | ArrayLike = 0.0,
    ) -> None:
        if topology not in TOPOLOGIES:
            raise InputError("topology", topology, " or ".join(TOPOLOGIES), "write closed")
        least = 3 if topology == CLOSED else 2
        if isinstance(robots, bool) or not isinstance(robots, int | np.integer):
            raise InputError("robots", robots, "a whole number", "count the catenary robots")
        if not least <= robots <= MAX_ROBOTS:
            raise InputError(
                "robots", robots, f"from {least} to {MAX_ROBOTS}", f"{topology} hitches need these"
            )
        n = int(robots)
        kinds = kinds_of(quadrotor, n, "robot")
        values: dict[str, object] = {
            "robots": n,
            "cable_length": per_robot("cable_length", cable_length, n),
            "topology": topology,
            "cable_density": not_negative("cable_density", cable_density),
            "cable_friction": not_negative("cable_friction", cable_friction),
            "tension": per_robot("tension", tension, n),
            "quadrotor": kinds,
            "load": _loads(load, len(layout_of(n, topology).clasps)),
        }
        for name, quantity in UNITS.items():
            check_unit(name, values[name], quantity)
        for name, value in values.items():
            object.__setattr__(self, name, value)

    @property
    def drones(self) -> int:
        """Number of drones."""
        return 2 * self.robots

    @property
    def has_cables(self) -> bool:
        """Whether the team has cables, as all teams but single drones."""
        return self.robots > 0

    @property
    def loaded(self) -> bool:
        """Whether clasps carry weight: that of cables, or a load."""
        return self.cable_density > 0.0 or bool(np.any(self.load))

    @property
    def layout(self) -> Layout:
        """Indices of the points, cables and drones that belong together."""
        return layout_of(self.robots, self.topology)

    @property
    def mass(self) -> NDArray[np.float64]:
        """(2n,) [kg]: mass of each drone, in the order q0, r0, q1, r1, …."""
        return self._per_drone([kind.mass for kind in self.quadrotor])

    @property
    def max_thrust(self) -> NDArray[np.float64]:
        """(2n,) [N]: largest thrust of each drone, in the order q0, r0, q1, r1, …."""
        return self._per_drone([kind.max_thrust for kind in self.quadrotor])

    @property
    def stiffness(self) -> NDArray[np.float64]:
        """(2n,) [N/m]: stiffness of each drone's position loop, infinite where it is rigid."""
        return self._per_drone(
            [np.inf if kind.stiffness is None else kind.stiffness for kind in self.quadrotor]
        )

    @property
    def integral(self) -> NDArray[np.bool_]:
        """(2n,): whether each drone's controller drives its position error to zero."""
        return self._per_drone([kind.integral for kind in self.quadrotor]).astype(np.bool_)

    @property
    def feed_forward(self) -> NDArray[np.bool_]:
        """(2n,): whether each drone's controller adds the cable force that its set points hold."""
        return self._per_drone([kind.feed_forward for kind in self.quadrotor]).astype(np.bool_)

    def _per_drone(self, values: Sequence[float]) -> NDArray[np.float64]:
        """Return one value per drone from one per kind; both drones of a robot are of its kind."""
        return np.repeat(np.array(values, dtype=np.float64), 2)

    @property
    def point_names(self) -> tuple[str, ...]:
        """(points,): p0, p1, …, names of the vertices or of a chain's points."""
        return _names("p", self.layout.points)

    @property
    def drone_names(self) -> tuple[str, ...]:
        """(2n,): q0, r0, q1, r1, …."""
        return _names("qr", self.robots)

    @property
    def cable_weight(self) -> NDArray[np.float64]:
        """(2n,) [N]: the half of its cable's weight that each drone carries."""
        return np.repeat(0.5 * GRAVITY * self.cable_density * self.cable_length, 2)


@lru_cache(maxsize=64)
def _names(kinds: str, count: int) -> tuple[str, ...]:
    """Return one name of every kind with the number 0, then with 1, and so on."""
    return tuple(f"{kind}{k}" for k in range(count) for kind in kinds)
