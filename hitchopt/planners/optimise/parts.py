"""Parts of a hitch in motion whose limits are rows: clasps, and drones at ends of chains.

A part depends on few flat outputs: three points, two q-legs, and possibly the roll and two tensions
at a clasp. ``limit_function`` states a limit of one of its drones by the model of ``casadi_model``,
over the derivatives of these flat outputs with respect to a first clock τ and the squared rate
x = (dτ/dt)² of a second one:

    ẏ = √x Y',   ÿ = x Y'' + ½ x' Y',   y⃛ = √x (x Y''' + 3/2 x' Y'' + ½ x'' Y').

casadi differentiates it by both. All parts of a kind are evaluated together.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from enum import Enum
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hitchopt.drones.quadrotor import GRAVITY
from hitchopt.hitch import Team
from hitchopt.hitch.casadi_model import CLASP_INPUTS, chain_end_motion, clasp_motion
from hitchopt.hitch.requirements import Limits
from hitchopt.hitch.series import JET
from hitchopt.values import Array, Indices

if TYPE_CHECKING:
    import casadi as ca

SMOOTHING = 1e-6  # Added to squares in norms, which are then smooth at zero
CLOCK_JET = 3  # Number of derivatives of the squared rate x, with its value
BATCH = 64  # Number of parts that are evaluated at once


class Limit(Enum):
    """A limit of motion of a drone, or of the vertex at a clasp."""

    SPEED = "velocities"
    ACCELERATION = "accelerations"
    JERK = "jerks"
    THRUST = "thrusts"
    TILT = "tilts"
    VERTEX_SPEED = "vertex velocities"


DRONE_LIMITS = (Limit.SPEED, Limit.ACCELERATION, Limit.JERK, Limit.THRUST, Limit.TILT)
"""Limits of drones, in the order of ratios."""


@dataclass(frozen=True)
class PartKind:
    """What the function of a part depends on besides numbers."""

    weighted: bool  # Whether cables have weight
    loaded: bool  # Whether weights hang on clasps
    rolled: bool  # Whether legs roll
    equal: bool  # Whether all tensions are equal and constant
    climbs: bool  # Whether heights of points change
    varying: bool  # Whether tensions are unknowns
    last: bool = False  # Whether the cable ahead ends a chain
    chain_end: bool = False  # Whether the part is the drone at an end of a chain, at its point

    @property
    def points(self) -> int:
        """Number of points on which the part depends, its own in the middle or first."""
        return 2 if self.chain_end else 3

    @property
    def sides(self) -> int:
        """Number of drones."""
        return 1 if self.chain_end else 2

    @property
    def sizes(self) -> dict[str, int]:
        """Numbers of rows of the unknowns, by name."""
        sizes = {"points": 2 * self.points}
        if not self.chain_end:
            sizes["q_legs"] = CLASP_INPUTS["q_legs"]
            if self.rolled:
                sizes["roll"] = CLASP_INPUTS["roll"]
        if self.varying:
            sizes["tensions"] = self.sides
        return sizes

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return sum(self.sizes.values())

    @property
    def constants(self) -> dict[str, int]:
        """Numbers of rows of the constants, by name."""
        if self.chain_end:
            return {"tensions": 1, "masses": 1, "weight": 1}
        return {"tensions": 2, "cable_lengths": 2, "load": 1, "masses": 2, "weight": 1}


def _symbols(kind: PartKind, columns: int) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Return symbols of the unknowns, the heights and the constants of a part."""
    import casadi as ca

    heights = ca.SX.sym("heights", kind.points, columns if kind.climbs else 1)
    constants = ca.SX.sym("constants", sum(kind.constants.values()))
    return ca.SX.sym("unknowns", kind.size, columns), heights, constants


def _split(column: ca.SX, sizes: dict[str, int]) -> dict[str, ca.SX]:
    """Return blocks of rows by name."""
    import casadi as ca

    ends = np.append(0, np.cumsum(list(sizes.values()))).tolist()
    return dict(zip(sizes, ca.vertsplit(column, ends), strict=True))


def _motion(
    kind: PartKind, unknowns: ca.SX, heights: ca.SX, constants: dict[str, ca.SX]
) -> dict[str, ca.SX]:
    """Return the model's outputs of a part for jets (rows, 4) by time, or (rows, 1) at rest."""
    import casadi as ca

    def padded(jet: ca.SX) -> ca.SX:
        """Return a jet whose missing derivatives are zero."""
        return ca.horzcat(jet, ca.SX(jet.shape[0], JET - jet.shape[1]))

    blocks = _split(padded(unknowns), kind.sizes)
    climbing = padded(heights)
    plan_view = ca.vertsplit(blocks["points"], 2)
    points = ca.vertcat(*(ca.vertcat(place, climbing[k, :]) for k, place in enumerate(plan_view)))
    tensions = blocks["tensions"] if kind.varying else padded(constants["tensions"])
    if kind.chain_end:
        function = chain_end_motion(weighted=kind.weighted)
        outputs = function(
            points=points, tension=tensions, weight=constants["weight"], mass=constants["masses"]
        )
    else:
        function = clasp_motion(
            weighted=kind.weighted,
            loaded=kind.loaded,
            rolled=kind.rolled,
            equal=kind.equal,
            last=kind.last,
        )
        outputs = function(
            points=points,
            q_legs=blocks["q_legs"],
            tensions=tensions,
            roll=blocks.get("roll", ca.SX(1, JET)),
            **{name: constants[name] for name in ("cable_lengths", "load", "weight", "masses")},
        )
    middle = 0 if kind.chain_end else 3
    return {**outputs, "vertex velocities": points[middle : middle + 3, 1]}


@lru_cache
def limit_function(kind: PartKind, limit: Limit, side: int) -> ca.Function:
    """Return the function of a limit of one drone: its value over the limit, and derivatives.

    Inputs are the jets by τ of unknowns (size, 4) and heights, the clock (3, 1), constants, and the
    ``limit`` in its own unit, for tilt the angle. Outputs are ``ratio``, and ``slopes``
    (4 size + 3, 1) by the unknowns' jets, column by column, and by the clock. The tilt's ratio is 1
    minus the distance of the thrust from its cone over the weight.
    """
    import casadi as ca

    jets, heights, constants = _symbols(kind, JET)
    clock = ca.SX.sym("clock", CLOCK_JET)
    bound = ca.SX.sym("limit")

    def by_time(jet: ca.SX) -> ca.SX:
        """Return derivatives by t from those by τ."""
        if jet.shape[1] == 1:
            return jet
        rate, slope, curvature = ca.vertsplit(clock)
        root = ca.sqrt(rate)
        first, second, third = jet[:, 1], jet[:, 2], jet[:, 3]
        return ca.horzcat(
            jet[:, 0],
            root * first,
            rate * second + 0.5 * slope * first,
            root * (rate * third + 1.5 * slope * second + 0.5 * curvature * first),
        )

    by_name = _split(constants, kind.constants)
    motion = _motion(kind, by_time(jets), by_time(heights), by_name)
    if limit is Limit.TILT:
        thrust = motion["thrusts"][:, side]
        level = ca.sqrt(ca.sumsqr(thrust[:2]) + SMOOTHING)
        excess = level * ca.cos(bound) - thrust[2] * ca.sin(bound)
        ratio = 1.0 + excess / (GRAVITY * by_name["masses"][side])
    else:
        ratio = ca.sqrt(ca.sumsqr(motion[limit.value][:, side]) + SMOOTHING) / bound
    slopes = ca.densify(ca.gradient(ratio, ca.vertcat(ca.vec(jets), clock)))
    return ca.Function(
        "limit",
        [jets, heights, clock, constants, bound],
        [ratio, slopes],
        ["unknowns", "heights", "clock", "constants", "limit"],
        ["ratio", "slopes"],
        {"cse": True},
    )


@lru_cache
def shape_function(kind: PartKind) -> ca.Function:
    """Return the function of the shape of a clasp at rest, and its derivatives.

    Outputs are ``values`` (7, 1), positions of its drones [m] and the sine of its exterior angle,
    and ``slopes`` (7, size) by the unknowns.
    """
    import casadi as ca

    unknowns, heights, constants = _symbols(kind, 1)
    motion = _motion(kind, unknowns, heights, _split(constants, kind.constants))
    values = ca.vertcat(ca.vec(motion["positions"]), motion["turn"])
    slopes = ca.densify(ca.jacobian(values, unknowns))
    return ca.Function(
        "shape",
        [unknowns, heights, constants],
        [ca.densify(values), slopes],
        ["unknowns", "heights", "constants"],
        ["values", "slopes"],
        {"cse": True},
    )


class Batched:
    """A casadi function with dense inputs and outputs, evaluated on arrays of rows.

    An instance has buffers of its own and is not shared between threads.
    """

    def __init__(self, function: ca.Function) -> None:
        mapped = function.map(BATCH)
        shapes = [function.size_in(i) for i in range(function.n_in())]
        self._inputs = [np.zeros((BATCH, columns, rows)) for rows, columns in shapes]
        shapes = [function.size_out(i) for i in range(function.n_out())]
        self._outputs = [np.zeros((BATCH, columns, rows)) for rows, columns in shapes]
        buffers: tuple[Any, Callable[[], None]] = mapped.buffer()
        self._buffers, self._run = buffers  # casadi reads and writes the arrays in place
        for i, array in enumerate(self._inputs):
            self._buffers.set_arg(i, array.data)
        for i, array in enumerate(self._outputs):
            self._buffers.set_res(i, array.data)

    def __call__(self, *arguments: Array) -> list[Array]:
        """Return the outputs (count, columns, rows) for inputs (count, columns, rows)."""
        count = len(arguments[0])
        results = [np.empty((count, *output.shape[1:])) for output in self._outputs]
        for first in range(0, count, BATCH):
            rows = slice(first, min(first + BATCH, count))
            size = rows.stop - first
            for buffer, argument in zip(self._inputs, arguments, strict=True):
                buffer[:size] = argument[rows].reshape(size, *buffer.shape[1:])
            self._run()
            for result, buffer in zip(results, self._outputs, strict=True):
                result[rows] = buffer[:size]
        return results


@dataclass(frozen=True, eq=False)
class Columns:
    """Unknowns of a path: the coordinates of points, q-legs, roll and tensions, as far as free."""

    team: Team  # The team of the hitch
    rolled: bool  # Whether legs roll
    varying: bool  # Whether tensions vary

    @property
    def points(self) -> Indices:
        """(points, 2): x and y of points."""
        points = self.team.layout.points
        return np.arange(2 * points).reshape(points, 2)

    @property
    def q_legs(self) -> Indices:
        """(n,): lengths of q-legs; those of a chain's end cables that have no choice are fixed."""
        return 2 * self.team.layout.points + np.arange(self.team.robots)

    @property
    def roll(self) -> Indices:
        """(clasps,): roll of clasps; empty if no leg rolls."""
        clasps = len(self.team.layout.clasps) if self.rolled else 0
        return 2 * self.team.layout.points + self.team.robots + np.arange(clasps)

    @property
    def tensions(self) -> Indices:
        """(n,): tensions of cables; empty if they are constant."""
        first = 2 * self.team.layout.points + self.team.robots + len(self.roll)
        return first + np.arange(self.team.robots if self.varying else 0)

    @property
    def size(self) -> int:
        """Number of unknowns."""
        layout = self.team.layout
        return 2 * layout.points + self.team.robots + len(self.roll) + len(self.tensions)

    @property
    def is_free(self) -> NDArray[np.bool_]:
        """(size,): whether unknowns change."""
        free = np.ones(self.size, dtype=np.bool_)
        free[self.q_legs] = np.all(self.team.layout.has_leg, axis=1)
        return free


@dataclass(frozen=True, eq=False)
class Group:
    """All parts of one kind."""

    kind: PartKind  # What their function depends on
    columns: Indices  # (parts, size): their unknowns
    points: Indices  # (parts, 2 or 3): points whose heights they depend on
    vertices: Indices  # (parts,): their own points
    drones: Indices  # (parts, sides): their drones
    constants: Array  # (parts, rows): constants of the function

    def of_kind(self, kind: PartKind, chosen: Indices) -> Group:
        """Return chosen parts (parts,) as a group of another kind."""
        return Group(
            kind,
            self.columns[chosen],
            self.points[chosen],
            self.vertices[chosen],
            self.drones[chosen],
            self.constants[chosen],
        )


def groups_of(columns: Columns, *, climbs: bool) -> Iterator[Group]:
    """Yield the clasps of a team by kind, and the ends of a chain."""
    team = columns.team
    layout = team.layout
    kind = PartKind(
        weighted=team.cable_density > 0.0,
        loaded=bool(np.any(team.load)),
        rolled=columns.rolled,
        equal=not columns.varying and bool(np.ptp(team.tension) == 0.0),
        climbs=climbs,
        varying=columns.varying,
    )
    clasps = _clasps(columns, kind)
    is_last = ~layout.has_leg[layout.ahead, 1]
    for last in (False, True):
        chosen = np.flatnonzero(is_last == last)
        if len(chosen):
            yield clasps.of_kind(replace(kind, last=last), chosen)
    if not layout.closed:
        yield _chain_ends(columns, replace(kind, chain_end=True))


def _clasps(columns: Columns, kind: PartKind) -> Group:
    """Return all clasps of a team."""
    team = columns.team
    layout = team.layout
    cables = np.column_stack([layout.behind, layout.ahead])
    points = np.column_stack(
        [layout.starts[layout.behind], layout.clasps, layout.ends[layout.ahead]]
    )
    unknowns = [columns.points[points].reshape(len(points), -1), columns.q_legs[cables]]
    if columns.rolled:
        unknowns.append(columns.roll[:, None])
    if columns.varying:
        unknowns.append(columns.tensions[cables])
    drones = np.column_stack([2 * layout.behind + 1, 2 * layout.ahead])
    load = GRAVITY * np.broadcast_to(team.load, len(points))[:, None]
    weight = np.full((len(points), 1), GRAVITY * team.cable_density)
    constants = [team.tension[cables], team.cable_length[cables], load, team.mass[drones], weight]
    return Group(
        kind,
        np.concatenate(unknowns, axis=1),
        points,
        layout.clasps,
        drones,
        np.concatenate(constants, axis=1),
    )


def _chain_ends(columns: Columns, kind: PartKind) -> Group:
    """Return the drones at the ends of a chain."""
    team = columns.team
    layout = team.layout
    ends = np.flatnonzero(~layout.has_leg.ravel())
    cables = ends // 2
    points = np.column_stack([layout.anchors[ends], layout.pulled_to[ends]])
    unknowns = [columns.points[points].reshape(len(ends), -1)]
    if columns.varying:
        unknowns.append(columns.tensions[cables][:, None])
    weight = np.full(len(ends), GRAVITY * team.cable_density)
    return Group(
        kind,
        np.concatenate(unknowns, axis=1),
        points,
        points[:, 0],
        ends[:, None],
        np.column_stack([team.tension[cables], team.mass[ends], weight]),
    )


class LimitSlopes(NamedTuple):
    """Values of limits of parts over the limits, and their derivatives."""

    ratio: Array  # (rows,)
    by_unknowns: Array  # (rows, 4, size): by jets of the part's unknowns by τ
    by_clock: Array  # (rows, 3): by x and its derivatives by τ


@dataclass(frozen=True, eq=False)
class PartFunctions:
    """The functions of a group of parts, with buffers."""

    group: Group  # The parts
    limits: Limits  # Limits of motion
    tilt: float  # [rad] Enforced limit of tilt
    max_thrust: Array  # (2n,) [N]

    @cached_property
    def _functions(self) -> dict[tuple[Limit, int], Batched]:
        return {}

    @cached_property
    def _shape(self) -> Batched:
        return Batched(shape_function(self.group.kind))

    def _bounds(self, limit: Limit, drones: Indices) -> Array:
        """Return the limits (rows,) of drones (rows,) in their own unit."""
        if limit is Limit.THRUST:
            return np.asarray(self.max_thrust[drones])
        by_limit = {
            Limit.SPEED: self.limits.speed,
            Limit.ACCELERATION: self.limits.acceleration,
            Limit.JERK: self.limits.jerk,
            Limit.TILT: self.tilt,
            Limit.VERTEX_SPEED: self.limits.vertex_speed,
        }
        return np.full(len(drones), by_limit[limit])

    def slopes(
        self, limit: Limit, side: int, parts: Indices, jets: Array, heights: Array, clock: Array
    ) -> LimitSlopes:
        """Return a limit of parts (rows,) and its derivatives.

        Parameters
        ----------
        side: which of their drones.
        jets: (rows, 4, all unknowns), by τ.
        heights: (rows, 4, all points) [m], by τ.
        clock: (rows, 3): x and its derivatives.
        """
        group = self.group
        key = limit, side
        if key not in self._functions:
            self._functions[key] = Batched(limit_function(group.kind, limit, side))
        rows = np.arange(len(parts))[:, None, None]
        orders = np.arange(JET)[:, None]
        own = jets[rows, orders, group.columns[parts][:, None]]
        own_heights = heights[rows, orders, group.points[parts][:, None]]
        if not group.kind.climbs:
            own_heights = own_heights[:, :1]
        ratio, slopes = self._functions[key](
            own,
            own_heights,
            clock,
            group.constants[parts],
            self._bounds(limit, group.drones[parts, side]),
        )
        size = JET * group.kind.size
        slopes = slopes.reshape(len(parts), -1)
        by_unknowns = slopes[:, :size].reshape(len(parts), JET, group.kind.size)
        return LimitSlopes(ratio.ravel(), by_unknowns, slopes[:, size:])

    def shapes(self, unknowns: Array, heights: Array) -> tuple[Array, Array]:
        """Return values (J, parts, 7) and slopes (J, parts, 7, size) of clasps at rest.

        Parameters
        ----------
        unknowns: (J, all unknowns).
        heights: (J, all points) [m].
        """
        group = self.group
        parts = len(group.columns)
        count = len(unknowns) * parts
        constants = np.broadcast_to(group.constants, (len(unknowns), *group.constants.shape))
        values, slopes = self._shape(
            unknowns[:, group.columns].reshape(count, 1, -1),
            heights[:, group.points].reshape(count, 1, -1),
            constants.reshape(count, 1, -1),
        )
        slopes = slopes.reshape(len(unknowns), parts, group.kind.size, -1).swapaxes(2, 3)
        return values.reshape(len(unknowns), parts, -1), slopes
