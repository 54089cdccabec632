"""The team: robots, cables, their tensions, and the assignment of robots to roles."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hitchopt.drones.controllers import (
    TRACKING,
    Tube,
)
from hitchopt.drones.quadrotor import GRAVITY, Quadrotor, Quadrotors, kinds_of, quadrotors
from hitchopt.errors import InputError, OneLine
from hitchopt.values import (
    Array,
    ByValue,
    Indices,
    check_instance,
    flag,
    integer,
    lazy,
    per_robot,
    sequence,
    units,
)
from hitchopt.values.fields import (
    Key,
    Record,
    documented,
    either,
    integers,
    list_of,
    mapping_of,
    one_or_each,
    store,
    with_suggestions,
    words,
)

CLOSED = "closed"  # Topology of a polygon of cables
OPEN = "open"  # Topology of a chain of cables

PER_ROBOT = "one for all or one per robot"


@dataclass(frozen=True, eq=False)
class Layout:
    """Indices into arrays of points, cables (or edges) and drones."""

    robots: int  # The number n of cables
    points: int  # The number of points, n or n + 1
    starts: Indices  # (n,), the point at which each edge starts
    ends: Indices  # (n,), the point at which each edge ends
    # (clasps,), the points at which two cables bend around each other: all, or all inner ones
    clasps: Indices
    ahead: Indices  # (clasps,), the cable whose edge starts at each clasp
    behind: Indices  # (clasps,), the cable whose edge ends at each clasp
    has_leg: NDArray[np.bool_]  # (n, 2), whether q_k and r_k have a leg
    # (2n,), the point of each drone q0, r0, q1, …: the other end of its leg, if any
    anchors: Indices
    pulled_to: Indices
    """(2n,), the next point along the cable of each drone: its anchor, or without a leg the other
    end of its edge."""

    neighbours: Indices  # (n, 3), the cables k-1 … k+1; beyond a chain's ends the cable itself

    @property
    def closed(self) -> bool:
        """Return whether the last edge ends at the first point."""
        return self.points == self.robots

    @cached_property
    def routes(self) -> Indices:
        """(n, 4): nodes along each cable; nodes are the points, then drones q0, r0, …."""
        q, r = self.points + np.arange(2 * self.robots).reshape(-1, 2).T
        return np.column_stack([q, self.starts, self.ends, r])

    @cached_property
    def exists(self) -> NDArray[np.bool_]:
        """(n, 3): whether cables have a q-leg, an edge and an r-leg."""
        return np.insert(self.has_leg, 1, True, axis=1)

    @cached_property
    def parts(self) -> Indices:
        """(parts,): taut cable parts ``3 k + type``; types are 0 q-leg, 1 edge and 2 r-leg."""
        return np.flatnonzero(self.exists)

    @cached_property
    def part_nodes(self) -> Indices:
        """(parts, 2): nodes at the ends of taut cable parts."""
        cable, kind = np.divmod(self.parts, 3)
        return np.stack([self.routes[cable, kind], self.routes[cable, kind + 1]], axis=1)

    def edges(self, points: Array, axis: int = -2) -> Array:
        """Return the edge vectors: points (…, points, d) to (…, n, d), along ``axis``."""
        return points.take(self.ends, axis) - points.take(self.starts, axis)

    def legs_of(self, q_legs: Array, slack: Array) -> Array:
        """Return both legs (…, n, 2) [m] from q-legs and slacks (…, n); zero if there is no leg."""
        legs: Array = np.where(self.has_leg, np.stack([q_legs, slack - q_legs], axis=-1), 0.0)
        return legs

    def q_legs_of(self, q_legs: Array, slack: Array) -> Array:
        """Return q-legs (…, n) [m] with the only possible ones at a chain's ends."""
        if self.closed:
            return q_legs
        with_r = np.where(self.has_leg[:, 0], q_legs, 0.0)
        exact: Array = np.where(self.has_leg[:, 1], with_r, slack)
        return exact

    def q_leg_jets(self, q_legs: Array, slack: Array) -> Array:
        """Return jets (…, n, m) of q-legs, as ``q_legs_of``."""
        jets: Array = self.q_legs_of(q_legs.swapaxes(-1, -2), slack.swapaxes(-1, -2))
        return jets.swapaxes(-1, -2)


@lru_cache(maxsize=64)
def layout_of(robots: int, topology: str) -> Layout:
    """Return the layout of ``robots`` cables with topology ``closed`` or ``open``."""
    edges = np.arange(robots)
    has_leg = np.ones((robots, 2), dtype=np.bool_)
    adjacent = edges[:, None] + np.arange(-1, 2)
    if topology == CLOSED:
        points = robots
        ends = (edges + 1) % robots
        clasps = edges
        neighbours = adjacent % robots
    else:
        points = robots + 1
        ends = edges + 1
        clasps = edges[1:]
        neighbours = np.clip(adjacent, 0, robots - 1)
        has_leg[0, 0] = False
        has_leg[-1, 1] = False
    edge_ends = np.column_stack([edges, ends])
    layout = Layout(
        robots=robots,
        points=points,
        starts=edges,
        ends=ends,
        clasps=clasps,
        ahead=clasps,
        behind=(clasps - 1) % robots,
        has_leg=has_leg,
        anchors=edge_ends.ravel(),
        pulled_to=np.where(has_leg, edge_ends, edge_ends[:, ::-1]).ravel(),
        neighbours=neighbours,
    )
    for value in vars(layout).values():
        if isinstance(value, np.ndarray):
            value.setflags(write=False)
    return layout


@dataclass(frozen=True)
class Assignment(OneLine):
    """The robots of a problem on the hitch: edge k is held by ``robots[k]``.

    Parameters
    ----------
    robots: the robot on every edge, each once.
    flipped: for every edge, whether that robot's q and r are exchanged: its r is at the edge's
        start.

    Raises
    ------
    InputError: not a permutation, or not one flag per edge.
    """

    robots: tuple[int, ...]
    flipped: tuple[bool, ...]

    def __post_init__(self) -> None:
        for name in ("robots", "flipped"):
            object.__setattr__(self, name, sequence(f"assignment.{name}", getattr(self, name)))
        n = len(self.robots)
        for edge, robot in enumerate(self.robots):
            integer(f"assignment.robots[{edge}]", robot, 0)
        if sorted(self.robots) != list(range(n)):
            bound = f"0 to {n - 1}, each once"
            remedy = f"pass a permutation of 0..{n - 1}"
            raise InputError("assignment.robots", self.robots, bound, remedy)
        if len(self.flipped) != n:
            bound = f"{n} truth values"
            raise InputError("assignment.flipped", self.flipped, bound, "specify one per edge")
        for edge, is_flipped in enumerate(self.flipped):
            flag(f"assignment.flipped[{edge}]", is_flipped)

    @classmethod
    def fixed(cls, robots: int) -> Assignment:
        """Return the assignment of robot k to edge k, unflipped."""
        count = integer("robots", robots, 1)
        return cls(tuple(range(count)), (False,) * count)

    @property
    def is_identity(self) -> bool:
        """Return whether every robot holds the edge of its number, unflipped."""
        return self == Assignment.fixed(len(self.robots))

    @property
    def drones(self) -> Indices:
        """(2n,): the drones in order along the hitch, as indices into q0, r0, q1, …."""
        flipped = np.array(self.flipped, dtype=np.intp)
        first, last = 2 * np.array(self.robots) + [flipped, 1 - flipped]
        return np.column_stack([first, last]).ravel()

    def to_dict(self) -> dict[str, object]:
        """Return the assignment as problem files state it."""
        return {"robots": list(self.robots), "flipped": list(self.flipped)}

    def team(self, team: Team) -> Team:
        """Return a team of the problem with its robots and drones in order along the hitch."""
        robots = list(self.robots)
        kinds = team.kinds
        return replace(
            team,
            cable_length=team.cable_length[robots],
            tension=team.tension[robots],
            quadrotor=tuple(kinds[drone] for drone in self.drones),
            assignment=self,
        )


@documented
@dataclass(frozen=True)
class Errors(Record):
    """Largest errors of a team at rest, for the check ``vertex_error``: worst cases.

    Raises
    ------
    InputError: a number out of its range.
    """

    cable_length: Annotated[
        float, Key(units.LENGTH_ERROR, "Largest error of every cable's length")
    ] = 0.01
    drone: Annotated[
        float | Tube | None,
        Key(
            TRACKING,
            "Largest position error of every drone, a number, or level and height; null: "
            "limits.tracking, or that of the drones, or 0.02",
        ),
    ] = None
    friction: Annotated[
        float, Key(units.FRICTION, "Coefficient of friction that still acts at clasps at rest")
    ] = 0.0


def _friction(key: str, value: object) -> float | tuple[float, float]:
    """Return a coefficient of friction, or the least and the largest one."""
    checked: float | list[float] = _FRICTION_FORMS.check(key, value)
    if not isinstance(checked, list):
        return checked
    least, largest = checked
    if least > largest:
        bound = "the least coefficient, then the largest"
        raise InputError(key, value, bound, f"write [{largest:g}, {least:g}]")
    return least, largest


_FRICTION_FORMS = either(units.FRICTION, list_of(units.FRICTION, 2, 2))
FRICTION_RANGE = replace(_FRICTION_FORMS, check=_friction)

MAX_ROBOTS = 10_000  # Largest number of robots, checked before any memory is allocated


def _loads(load: float | Sequence[float] | ArrayLike, clasps: int) -> NDArray[np.float64]:
    """Return the masses that hang at the clasps (clasps,) [kg].

    Arrays of equal values fit any number of clasps, as ``replace`` needs for another topology.
    """
    if isinstance(load, np.ndarray) and load.size > 0 and load.ndim > 0:
        load = float(load[0]) if np.all(load == load[0]) else load
    return per_robot("load", load, clasps, units.LOAD.check, "clasp")


def _checked_assignment(assignment: Assignment | None, robots: int) -> Assignment | None:
    """Return the assignment of a number of robots, or None."""
    if assignment is not None:
        check_instance("assignment", assignment, Assignment)
        if len(assignment.robots) != robots:
            bound = f"of {robots} robots"
            raise InputError("assignment", assignment.robots, bound, "specify one per edge")
    return assignment


@documented
@dataclass(frozen=True, eq=False)
class Team(ByValue):
    """n catenary robots: two quadrotors each, on the ends of one cable.

    Robots and drones are in order along the hitch. Their names are those of the problem, which
    ``assignment`` maps to the hitch; None if robot k holds edge k. ``listed`` are the drones in the
    order of the problem.

    Raises
    ------
    InputError: an invalid count, sign or number.
    """

    robots: Annotated[
        int, Key(integers(2, MAX_ROBOTS), "Number n of cables; each has two quadrotors", 3)
    ]
    cable_length: Annotated[
        NDArray[np.float64],
        Key(one_or_each(units.CABLE_LENGTH, 2, MAX_ROBOTS), f"Lengths of cables, {PER_ROBOT}", 2.4),
    ]
    topology: Annotated[
        str, Key(words(CLOSED, OPEN), "closed: a polygon of n points; open: an arc of n + 1")
    ]
    cable_density: Annotated[float, Key(units.DENSITY, "Mass per length of the cables")]
    cable_friction: Annotated[
        float | tuple[float, float],
        Key(
            FRICTION_RANGE,
            "Coefficient of friction at the clasps, or the range [least, largest] within which "
            "vertices settle, from 0 for a number; grips, legs and ropes have the largest",
        ),
    ]
    tension: Annotated[
        NDArray[np.float64],
        Key(
            one_or_each(units.TENSION, 2, MAX_ROBOTS),
            f"Tensions of cables, {PER_ROBOT}; null: 0.4 N, or 0.31 times the horizontal pull of a "
            "model",
        ),
    ]
    quadrotor: Annotated[
        tuple[Quadrotor, ...],
        Key(
            quadrotors(2, 2 * MAX_ROBOTS),
            "Kind of quadrotor or name of a model: one for all, one per robot or drone, or common "
            "values and, by names such as q0, values of single drones; null: the default kind",
        ),
    ] = field(repr=False)
    load: Annotated[
        NDArray[np.float64],
        Key(
            one_or_each(units.LOAD, 1, MAX_ROBOTS),
            "Loads that hang at the clasps, one for all or one per clasp: every vertex of a "
            "closed hitch, the inner points of a chain",
        ),
    ] = field(repr=False)
    errors: Annotated[
        Errors | None,
        Key(
            mapping_of(Errors),
            "Largest errors at rest, for ``vertex_error``; null: defaults",
            omitted=True,
        ),
    ] = field(repr=False)
    release: Annotated[
        bool | None,
        Key(
            words(True, False),
            "Whether drones can drop the ends of their cables; null: they cannot",
            omitted=True,
        ),
    ] = field(repr=False)
    assignment: Assignment | None = field(repr=False, default=None)

    def __init__(
        self,
        robots: int,
        cable_length: float | Sequence[float] | ArrayLike,
        *,
        topology: str = CLOSED,
        cable_density: float = 0.0,
        cable_friction: float | tuple[float, float] = 0.0,
        tension: float | Sequence[float] | ArrayLike | None = None,
        quadrotor: Quadrotors | None = None,
        load: float | Sequence[float] | ArrayLike = 0.0,
        errors: Errors | Mapping[str, Any] | None = None,
        release: bool | None = None,
        assignment: Assignment | None = None,
    ) -> None:
        store(self, topology=topology, cable_density=cable_density, cable_friction=cable_friction)
        store(self, errors=errors, release=release)
        n = integer("robots", robots, 2, MAX_ROBOTS)
        cable_lengths = per_robot("cable_length", cable_length, n, units.CABLE_LENGTH.check)
        kinds = kinds_of(quadrotor, n, "robot", _names("qr", n))
        if tension is None:
            tension = np.min(np.reshape([kind.tension for kind in kinds], (n, -1)), axis=1)
        values = {
            "robots": n,
            "cable_length": cable_lengths,
            "tension": per_robot("tension", tension, n, units.TENSION.check),
            "quadrotor": kinds,
            "load": _loads(load, len(layout_of(n, topology).clasps)),
            "assignment": _checked_assignment(assignment, n),
        }
        for name, value in values.items():
            object.__setattr__(self, name, value)

    @property
    def friction(self) -> float:
        """Largest coefficient of friction at the clasps."""
        stated = self.cable_friction
        return stated[1] if isinstance(stated, tuple) else stated

    @property
    def least_friction(self) -> float:
        """Least coefficient of friction at the clasps, 0 if one number is stated."""
        stated = self.cable_friction
        return stated[0] if isinstance(stated, tuple) else 0.0

    @property
    def drones(self) -> int:
        """Number of drones."""
        return 2 * self.robots

    @property
    def has_cables(self) -> bool:
        """Return whether the team has cables; single drones have none."""
        return self.robots > 0

    @property
    def loaded(self) -> bool:
        """Return whether clasps carry the weight of cables or a load."""
        return self.cable_density > 0.0 or bool(np.any(self.load))

    @property
    def layout(self) -> Layout:
        """Indices into arrays of points, cables and drones."""
        return layout_of(self.robots, self.topology)

    @lazy
    def mass(self) -> NDArray[np.float64]:
        """(2n,) [kg]: mass of each drone, in the order q0, r0, q1, r1, …."""
        return self._per_drone("mass")

    @lazy
    def max_thrust(self) -> NDArray[np.float64]:
        """(2n,) [N]: largest thrust of each drone, in the order q0, r0, q1, r1, …."""
        return self._per_drone("max_thrust")

    @property
    def stiffness(self) -> NDArray[np.float64]:
        """(2n, 3) [N/m]: stiffness of each drone's position loop; infinite if rigid."""
        return self._per_axis("kp")

    @property
    def damping(self) -> NDArray[np.float64]:
        """(2n, 3) [N s/m]: damping of each drone's position loop; infinite if rigid."""
        return self._per_axis("kd")

    @property
    def integral_gain(self) -> NDArray[np.float64]:
        """(2n, 3) [N/(m s)]: gain of each drone's integral; zero without one."""
        return self._per_axis("ki")

    @property
    def integral(self) -> NDArray[np.float64]:
        """(2n, 3) [N]: largest force of each drone's integral; zero without one."""
        return self._per_axis("ki_limit")

    @property
    def feed_forward(self) -> NDArray[np.bool_]:
        """(2n,): whether each drone's controller adds the cable force of its setpoints."""
        return self._of_loops("feed_forward") > 0.0

    @property
    def false_pull(self) -> NDArray[np.float64]:
        """(2n, 3): force of each drone's damping over a pull across its thrust, at rest."""
        return self._per_axis("false_pull")

    @property
    def max_tilt(self) -> NDArray[np.float64]:
        """(2n,) [rad]: largest tilt that each drone's controller commands; π/2 if unlimited."""
        return self._of_loops("max_tilt")

    @property
    def kinds(self) -> tuple[Quadrotor, ...]:
        """(2n,): kind of each drone, in the order q0, r0, q1, r1, …."""
        per_kind = self.drones // len(self.quadrotor)
        return tuple(kind for kind in self.quadrotor for _ in range(per_kind))

    @property
    def tracking(self) -> float | Tube | None:
        """Largest tracking errors of drones; None without named controllers and measurements."""
        tubes = [kind.tube for kind in self.quadrotor]
        tube = Tube.enclosing(tube for tube in tubes if tube is not None)
        return None if tube is None else tube.tracking

    @property
    def trim(self) -> NDArray[np.float64]:
        """(2n, 2) [m]: setpoint minus rest position of each drone at yaw 0."""
        return np.array([kind.trim or (0.0, 0.0) for kind in self.kinds])

    @property
    def thrust_factor(self) -> NDArray[np.float64]:
        """(2n,): ratio of each drone's commanded to its actual thrust."""
        return np.array([kind.thrust_factor or 1.0 for kind in self.kinds])

    def _per_axis(self, name: str) -> NDArray[np.float64]:
        """Return a horizontal and vertical pair of the position loops as (2n, 3)."""
        return self._of_loops(name)[:, [0, 0, 1]]

    def _of_loops(self, name: str) -> NDArray[np.float64]:
        """Return one value, or one pair, of the position loops per drone."""
        values = np.array([getattr(kind.loop, name) for kind in self.quadrotor], dtype=np.float64)
        return np.repeat(values, self.drones // len(values), axis=0)

    def _per_drone(self, name: str) -> NDArray[np.float64]:
        """Return one value per drone."""
        kinds = np.array([getattr(kind, name) for kind in self.quadrotor], dtype=np.float64)
        values = np.repeat(kinds, self.drones // len(kinds))
        values.setflags(write=False)
        return values

    @property
    def point_names(self) -> tuple[str, ...]:
        """(points,): p0, p1, …, names of the vertices or of a chain's points."""
        return _names("p", self.layout.points)

    @property
    def labels(self) -> tuple[int, ...]:
        """(n,): numbers of the robots in the problem, and in the names of drones and cables."""
        return tuple(range(self.robots)) if self.assignment is None else self.assignment.robots

    @property
    def drone_names(self) -> tuple[str, ...]:
        """(2n,): the problem's names q0, r0, q1, r1, … of drones in order along the hitch."""
        names = _names("qr", self.robots)
        return names if self.assignment is None else _at_places(names, self.assignment)

    @property
    def listed_names(self) -> tuple[str, ...]:
        """(drones,): names of the drones in the order of the problem."""
        return tuple(self.drone_names[place] for place in self.listed)

    @property
    def leg_names(self) -> tuple[str, ...]:
        """(2n,): q-leg 0, r-leg 0, …, the legs of the drones in order along the hitch."""
        return tuple(f"{name[0]}-leg {name[1:]}" for name in self.drone_names)

    @property
    def cable_names(self) -> tuple[str, ...]:
        """(n,): cable 0, cable 1, …, named after the robots that hold them."""
        return tuple(f"cable {robot}" for robot in self.labels)

    @property
    def listed(self) -> Indices:
        """(drones,): indices along the hitch of the problem's drones q0, r0, q1, …."""
        return np.argsort(self.assignment.drones) if self.assignment else np.arange(self.drones)

    @property
    def edges(self) -> Indices:
        """(n,): edges held by the robots, in the order of the problem."""
        return np.argsort(self.labels)

    @property
    def of_problem(self) -> Team:
        """The team with its robots in the order of the problem."""
        if self.assignment is None:
            return self
        return replace(
            self,
            cable_length=self.cable_length[self.edges],
            tension=self.tension[self.edges],
            quadrotor=tuple(self.kinds[place] for place in self.listed),
            assignment=None,
        )

    @property
    def cable_weight(self) -> NDArray[np.float64]:
        """(2n,) [N]: half of its cable's weight for each drone."""
        return np.repeat(0.5 * GRAVITY * self.cable_density * self.cable_length, 2)


@lru_cache(maxsize=64)
def _at_places(names: tuple[str, ...], assignment: Assignment) -> tuple[str, ...]:
    """Return names of drones in order along the hitch."""
    return tuple(names[drone] for drone in assignment.drones)


@lru_cache(maxsize=64)
def _names(kinds: str, count: int) -> tuple[str, ...]:
    """Return names such as q0, r0, q1, … for kinds such as ``qr``."""
    return tuple(f"{kind}{number}" for number in range(count) for kind in kinds)


MAX_DRONES = 2 * MAX_ROBOTS  # Largest number of drones, checked before any memory is allocated


@with_suggestions
@dataclass(frozen=True, eq=False)
class Swarm(Team):
    """N single quadrotors of one kind or one per drone: a team without cables.

    Arrays over robots are empty. Raises InputError for an invalid count.
    """

    def __init__(self, drones: int, *, quadrotor: Quadrotors | None = None) -> None:
        count = integer("drones", drones, 1, MAX_DRONES)
        empty = np.zeros(0)
        empty.setflags(write=False)
        values: dict[str, object] = {
            "robots": 0,
            "cable_length": empty,
            "topology": CLOSED,
            "cable_density": 0.0,
            "cable_friction": 0.0,
            "tension": empty,
            "load": empty,
            "quadrotor": kinds_of(quadrotor, count, "drone", _names("d", count)),
            "errors": None,
            "release": None,
        }
        for name, value in values.items():
            object.__setattr__(self, name, value)

    def _parts(self) -> Iterator[str]:
        yield f"drones={self.drones}"
        models = dict.fromkeys(str(kind.model) for kind in self.quadrotor if kind.model)
        yield from [f"quadrotor={', '.join(models)}"] if models else []

    @property
    def drones(self) -> int:
        """Number N of drones."""
        return len(self.quadrotor)

    @property
    def drone_names(self) -> tuple[str, ...]:
        """(N,): d0, d1, …."""
        return _names("d", self.drones)
