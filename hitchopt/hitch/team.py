"""The team: quadrotors, cables, the tensions of the cables, and which robot flies which role."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hitchopt.errors import InputError, OneLine
from hitchopt.hitch.flight_controller import FlightController, Gains
from hitchopt.values import (
    Array,
    Indices,
    choice,
    flag,
    instance,
    not_negative,
    per_robot,
    sequence,
    units,
    whole,
)
from hitchopt.values.units import check_lift, check_unit, store

CLOSED, OPEN = "closed", "open"


@dataclass(frozen=True, eq=False)
class Layout:
    """Indices into arrays of points, cables (or edges) and drones.

    Attributes
    ----------
    robots, points: number n of cables; number of points, n or n + 1.
    starts, ends: (n,), the points between which each edge runs.
    clasps: (c,), the points at which two cables bend around each other: all, or all inner ones.
    ahead, behind: (c,), the cables of the edges that start there and that end there.
    has_leg: (n, 2), whether q_k and r_k hang on a leg.
    anchors: (2n,), the point that each drone q0, r0, q1, … belongs to.
    pulled_to: (2n,), the point that its cable leads to from it: the same, or its edge's other end
        where there is no leg.
    neighbours: (n, 3), the cables k-1 … k+1; beyond a chain's ends the cable itself.
    """

    robots: int
    points: int
    starts: Indices
    ends: Indices
    clasps: Indices
    ahead: Indices
    behind: Indices
    has_leg: NDArray[np.bool_]
    anchors: Indices
    pulled_to: Indices
    neighbours: Indices

    @property
    def closed(self) -> bool:
        """Whether the last edge leads back to the first point."""
        return self.points == self.robots

    @cached_property
    def parts(self) -> Indices:
        """(parts,): taut cable parts ``3 k + type``, type 0 a q-leg, 1 an edge, 2 an r-leg."""
        exists = np.insert(self.has_leg, 1, True, axis=1)
        return np.flatnonzero(exists)

    def edges(self, points: Array, axis: int = -2) -> Array:
        """Return the edge vectors: points (…, points, d) to (…, n, d), along ``axis``."""
        return np.take(points, self.ends, axis) - np.take(points, self.starts, axis)

    def legs_of(self, q_legs: Array, slack: Array) -> Array:
        """Return both legs (…, n, 2) [m] of q-legs and slacks (…, n); exactly zero without leg."""
        legs: Array = np.where(self.has_leg, np.stack([q_legs, slack - q_legs], axis=-1), 0.0)
        return legs

    def q_legs_of(self, wanted: Array, slack: Array) -> Array:
        """Return the wanted q-legs (…, n) [m], or the only possible ones at a chain's ends."""
        with_r = np.where(self.has_leg[:, 0], wanted, 0.0)
        q_legs: Array = np.where(self.has_leg[:, 1], with_r, slack)
        return q_legs


@lru_cache(maxsize=64)
def layout_of(robots: int, topology: str) -> Layout:
    """Return the layout of ``robots`` cables, topology ``closed`` or ``open``."""
    k = np.arange(robots)
    has_leg = np.ones((robots, 2), dtype=np.bool_)
    if topology == CLOSED:
        points, following, clasps = robots, (k + 1) % robots, k
        neighbours = (k[:, None] + np.arange(-1, 2)) % robots
    else:
        points, following, clasps = robots + 1, k + 1, k[1:]
        neighbours = np.clip(k[:, None] + np.arange(-1, 2), 0, robots - 1)
        has_leg[0, 0] = has_leg[-1, 1] = False
    own = np.column_stack([k, following])
    layout = Layout(
        robots=robots,
        points=points,
        starts=k,
        ends=following,
        clasps=clasps,
        ahead=clasps,
        behind=(clasps - 1) % robots,
        has_leg=has_leg,
        anchors=own.ravel(),
        pulled_to=np.where(has_leg, own, own[:, ::-1]).ravel(),
        neighbours=neighbours,
    )
    for value in vars(layout).values():
        if isinstance(value, np.ndarray):
            value.setflags(write=False)
    return layout


GRAVITY = 9.81
"""[m/s²] Acceleration of gravity, downward."""

MAX_ROBOTS = 10_000
"""Largest number of robots, checked before any memory is allocated."""


@dataclass(frozen=True)
class Quadrotor(OneLine):
    """One quadrotor.

    Parameters
    ----------
    mass: [kg]
    max_thrust: largest collective thrust [N]
    stiffness: force with which the position loop answers an offset from its set point [N/m]; None
        is rigid, or the controller's.
    integral: whether the position loop drives the position error to zero, whatever the force; None
        is false, or the controller's.
    feed_forward: whether the position loop adds the cable force that the set points hold; None is
        true, or the controller's.
    controller: ``mellinger``, ``lee``, ``pid`` or ``px4``; None where only these numbers are known.
    gains: a ``Gains``, or a mapping with some of ``kp``, ``kd`` and ``ki``, each a number or a pair
        ``[level, upright]``; None for the controller's defaults.

    Raises
    ------
    InputError: a number out of its range, an unknown controller, gains without one or too stiff for
        it, or numbers that follow from it.
    """

    mass: float = 0.132
    max_thrust: float = 2.6
    stiffness: float | None = None
    integral: bool | None = None
    feed_forward: bool | None = None
    controller: str | None = None
    gains: Gains | Mapping[str, Any] | None = None

    def __post_init__(self) -> None:
        values = dict(vars(self))
        for name in ("integral", "feed_forward"):
            if values[name] is not None:
                values[name] = flag(name, values[name])
        if self.gains is not None:
            values["gains"] = Gains.of(self.gains)
        store(self, values)
        check_lift(self.mass, self.max_thrust, GRAVITY)
        if self.controller is None:
            if self.gains is not None:
                bound, remedy = "left out without a controller", "name one, or give stiffness"
                raise InputError("gains", self.gains, bound, remedy)
            return
        for name in ("stiffness", "integral", "feed_forward"):
            if (value := values[name]) is not None:
                bound = f"left out with controller {self.controller}, from which it follows"
                raise InputError(name, value, bound, "leave it out, or give gains")
        _loop(self)

    @property
    def loop(self) -> FlightController:
        """The position loop: the controller's, or what the numbers say."""
        return _loop(self)


@lru_cache(maxsize=1024)
def _loop(kind: Quadrotor) -> FlightController:
    if kind.controller is not None:
        return FlightController.of(kind.controller, kind.mass, kind.gains)
    fed = kind.feed_forward is None or kind.feed_forward
    return FlightController.plain(
        kind.mass, kind.stiffness, integral=bool(kind.integral), feed_forward=fed
    )


def kinds_of(
    given: Quadrotor | Sequence[Quadrotor] | None, count: int, owner: str
) -> tuple[Quadrotor, ...]:
    """Return one kind per owner; one kind is meant for all, and None for the default kind."""
    kind = Quadrotor() if given is None else given
    kinds = (kind,) * count if isinstance(kind, Quadrotor) else sequence("quadrotor", kind)
    for k, each in enumerate(kinds):
        instance(f"quadrotor[{k}]", each, Quadrotor)
    if len(kinds) != count:
        bound = f"one kind, or a list of {count}"
        raise InputError("quadrotor", len(kinds), bound, f"give one per {owner}")
    return kinds


def _loads(given: float | Sequence[float] | ArrayLike, clasps: int) -> NDArray[np.float64]:
    """Return the masses that hang at the clasps (clasps,) [kg].

    An array of one value holds for any number of clasps, so that a team can be copied with others.
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
    quadrotor: one kind for all, or one per robot, for both of its drones; stored as the latter.
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
        choice("topology", topology, (CLOSED, OPEN))
        n = whole("robots", robots, 3 if topology == CLOSED else 2, MAX_ROBOTS)
        kinds = kinds_of(quadrotor, n, "robot")
        values: dict[str, object] = {
            "robots": n,
            "cable_length": per_robot("cable_length", cable_length, n),
            "topology": topology,
            "cable_density": cable_density,
            "cable_friction": cable_friction,
            "tension": per_robot("tension", tension, n),
            "quadrotor": kinds,
            "load": _loads(load, len(layout_of(n, topology).clasps)),
        }
        store(self, values)
        check_unit("cable_length", self.cable_length, units.CABLE_LENGTH)
        check_unit("tension", self.tension, units.TENSION)
        check_unit("load", self.load, units.LOAD)

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
        return self._per_drone("mass")

    @property
    def max_thrust(self) -> NDArray[np.float64]:
        """(2n,) [N]: largest thrust of each drone, in the order q0, r0, q1, r1, …."""
        return self._per_drone("max_thrust")

    @property
    def stiffness(self) -> NDArray[np.float64]:
        """(2n, 3) [N/m]: stiffness of each drone's position loop, infinite where it is rigid."""
        return self._per_axis("kp")

    @property
    def damping(self) -> NDArray[np.float64]:
        """(2n, 3) [N s/m]: damping of each drone's position loop, infinite where it is rigid."""
        return self._per_axis("kd")

    @property
    def integral_gain(self) -> NDArray[np.float64]:
        """(2n, 3) [N/(m s)]: gain of each drone's integral, zero where it has none."""
        return self._per_axis("ki")

    @property
    def integral(self) -> NDArray[np.float64]:
        """(2n, 3) [N]: largest force of each drone's integral, zero where it has none."""
        return self._per_axis("ki_limit")

    @property
    def feed_forward(self) -> NDArray[np.bool_]:
        """(2n,): whether each drone's controller adds the cable force that its set points hold."""
        return self._of_loops("feed_forward") > 0.0

    @property
    def max_tilt(self) -> NDArray[np.float64]:
        """(2n,) [rad]: largest tilt that each drone's controller commands, π/2 if any."""
        return self._of_loops("max_tilt")

    @property
    def tracking(self) -> float | None:
        """Largest tracking error [m] of the drones' controllers; None if none is named."""
        known = [loop.tracking for kind in self.quadrotor if (loop := kind.loop).name]
        return max((each for each in known if each is not None), default=None)

    def _per_axis(self, name: str) -> NDArray[np.float64]:
        """Return a pair of the position loops, level and upright, as (2n, 3)."""
        return self._of_loops(name)[:, [0, 0, 1]]

    def _of_loops(self, name: str) -> NDArray[np.float64]:
        """Return one value, or one pair, of the position loops per drone."""
        values = np.array([getattr(kind.loop, name) for kind in self.quadrotor], dtype=np.float64)
        return np.repeat(values, self.drones // len(values), axis=0)

    def _per_drone(self, name: str) -> NDArray[np.float64]:
        """Return one value per drone; both drones of a robot are of its kind."""
        values = np.array([getattr(kind, name) for kind in self.quadrotor], dtype=np.float64)
        return np.repeat(values, self.drones // len(values))

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
    return tuple(f"{kind}{k}" for k in range(count) for kind in kinds)


MAX_DRONES = 2 * MAX_ROBOTS
"""Largest number of drones, checked before any memory is allocated."""


@dataclass(frozen=True, eq=False)
class Swarm(Team):
    """N single quadrotors: a team without cables, so that every array over robots is empty.

    Of their number, and one kind for all or one per drone.

    Raises
    ------
    InputError: a count that is wrong in itself.
    """

    def __init__(
        self, drones: int, *, quadrotor: Quadrotor | Sequence[Quadrotor] | None = None
    ) -> None:
        whole("drones", drones, 1, MAX_DRONES)
        none = np.zeros(0)
        none.setflags(write=False)
        values = dict.fromkeys(("cable_length", "tension", "load"), none)
        numbers = {"robots": 0, "topology": CLOSED, "cable_density": 0.0, "cable_friction": 0.0}
        store(self, {**values, **numbers, "quadrotor": kinds_of(quadrotor, int(drones), "drone")})

    @property
    def drones(self) -> int:
        """Number N of drones."""
        return len(self.quadrotor)

    @property
    def drone_names(self) -> tuple[str, ...]:
        """(N,): d0, d1, …."""
        return _names("d", self.drones)


@dataclass(frozen=True)
class Assignment(OneLine):
    """An assignment of robots to roles, of which role k holds edge k.

    Parameters
    ----------
    robots: for every role the robot that flies it, each once.
    flipped: for every role whether that robot's q and r are exchanged.

    Raises
    ------
    InputError: no such assignment.
    """

    robots: tuple[int, ...]
    flipped: tuple[bool, ...]

    def __post_init__(self) -> None:
        for name in ("robots", "flipped"):
            object.__setattr__(self, name, sequence(f"assignment.{name}", getattr(self, name)))
        n = len(self.robots)
        for i, robot in enumerate(self.robots):
            whole(f"assignment.robots[{i}]", robot, 0)
        if sorted(self.robots) != list(range(n)):
            bound, remedy = f"0 to {n - 1}, each once", f"pass a permutation of 0..{n - 1}"
            raise InputError("assignment.robots", self.robots, bound, remedy)
        if len(self.flipped) != n:
            bound = f"{n} truth values"
            raise InputError("assignment.flipped", self.flipped, bound, "give one per role")

    @classmethod
    def fixed(cls, robots: int) -> Assignment:
        """Return the assignment under which robot k flies role k as it is."""
        return cls(tuple(range(robots)), (False,) * robots)

    def to_dict(self) -> dict[str, object]:
        """Return the assignment as files store it."""
        return {"robots": list(self.robots), "flipped": list(self.flipped)}

    def team(self, team: Team) -> Team:
        """Return the team in the order of its roles."""
        order = list(self.robots)
        return replace(
            team,
            cable_length=team.cable_length[order],
            tension=team.tension[order],
            quadrotor=tuple(team.quadrotor[i] for i in order),
        )

    def drones(self, drones: Array) -> Array:
        """Return robots' drones (2n, 3) in the order of their roles."""
        pairs = drones.reshape(-1, 2, 3)[list(self.robots)]
        flipped = np.array(self.flipped, dtype=np.bool_)
        pairs = np.where(flipped[:, None, None], pairs[:, ::-1], pairs)
        ordered: Array = pairs.reshape(-1, 3)
        return ordered
