"""The slack split: the leg lengths of every cable that keep drones and cables apart.

On a given polygon every drone slides along a fixed line, so positions are affine in ``d`` and lower
bounds of distances make a convex QP whose every solution keeps the true distances at least as well
as it says. Repeated, the penalised deviation never grows (a convex inner approximation, Marks and
Wright 1978).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import InfeasibleError, check_time
from hitchopt.geometry import differences, shortest_offset
from hitchopt.geometry.vectors import EAST, dot, first_smallest, length, unit
from hitchopt.hitch.forces import (
    cable_slack_of,
    clasp_loads,
    leg_directions,
    leg_vectors,
    sag_factors,
)
from hitchopt.hitch.pairs import (
    CROSSING,
    SEPARATION,
    Bodies,
    end_combinations,
    limits_of,
    scales_of,
)
from hitchopt.hitch.requirements import Requirements
from hitchopt.hitch.team import Team
from hitchopt.values import Array, Indices

if TYPE_CHECKING:
    import casadi as ca
    import scipy.sparse as sp

SPREAD_MARGIN = 1.5
"""Distance over its limit that the leg lengths called ``spread`` keep."""

LIMIT_MARGIN = 1.001
"""Distance over its limit of all other leg lengths: a plan's small errors stay within limits."""

CROSSING_MARGIN = 1.005
"""Largest margin of cables without a common clasp: ``spread`` concerns drones."""


@dataclass(frozen=True, eq=False)
class LegTask:
    """The choice of a team's leg lengths on J polygons (one, or the knots of a path) at once.

    Attributes
    ----------
    team: its cables are split.
    requirements: distances, and the arena.
    polygons: (J, points, 2) [m]
    reference: (J, n) [m], ``d`` to deviate least from.
    shortest_leg: [m], for both legs of every cable.
    margin: each distance is to be at least this many times its limit; one, or one per knot (J,).
    roughness: [m²], weight of the fractions' second differences along the knots; 0 for none.
    fixed: (J,), knots that keep their reference.
    roll: one or (J, clasps) [rad], of the legs out of their plane; None for none.
    """

    team: Team
    requirements: Requirements
    polygons: Array
    reference: Array
    shortest_leg: float
    margin: float | Array
    roughness: float = 0.0
    fixed: NDArray[np.bool_] | None = None
    roll: Array | float | None = None

    @property
    def level(self) -> bool:
        """Whether all legs are level: they carry no weight and are not rolled."""
        return not self.team.loaded and (self.roll is None or not np.any(self.roll))

    @cached_property
    def margins(self) -> Array:
        """(3, J): the margin of every knot, by kind of pair."""
        each = np.broadcast_to(np.asarray(self.margin, dtype=np.float64), len(self.reference))
        return np.stack([each, each, np.minimum(each, CROSSING_MARGIN)])

    @cached_property
    def largest_margin(self) -> float:
        """The largest of the margins: the margin of leg lengths that keep them all."""
        return float(np.max(self.margins))

    @cached_property
    def slack(self) -> Array:
        """(J, n) [m]: slack of each cable for its two legs."""
        return cable_slack_of(self.team, self.team.layout.edges(self.polygons))

    @cached_property
    def bounds(self) -> tuple[Array, Array]:
        """The smallest and largest ``d`` (J, n) that leave both legs long enough.

        The same one at the ends of a chain, where a cable has one leg only.
        """
        slack, layout = self.slack, self.team.layout
        shortest = np.minimum(self.shortest_leg, 0.5 * slack)
        lower = layout.q_legs_of(shortest, slack)
        upper = layout.q_legs_of(slack - shortest, slack)
        if self.fixed is not None:
            lower[self.fixed] = upper[self.fixed] = self.reference[self.fixed]
        return lower, upper


@dataclass(frozen=True, eq=False)
class LegLengths:
    """Leg lengths ``d`` (J, n) [m], their margin, and ``Σ (d - reference)²`` [m²].

    The margin is the smallest distance over its limit, measured on these lengths.
    """

    q_legs: Array
    margin: float
    deviation: float


RESIDUAL = 1e-6
"""Largest violation of a row or a bound, in its own unit, of a solution that is used."""


@dataclass(frozen=True, eq=False)
class QuadraticProgram:
    """``min ½ x'Px + q'x`` over ``lower ≤ A x ≤ upper`` and ``least ≤ x ≤ most``.

    P (m, m) is symmetric and positive semidefinite; entries of A (r, m) that happen to be zero are
    stored; least and most are (m,) or one bound for all unknowns.
    """

    P: sp.csc_array[np.float64]
    q: Array
    A: sp.csc_array[np.float64]
    lower: Array
    upper: Array
    least: Array | float = -np.inf
    most: Array | float = np.inf


class Rows:
    """Rows ``lower ≤ A x ≤ upper`` of so many unknowns, gathered block by block."""

    def __init__(self, unknowns: int) -> None:
        self.count = 0
        self._unknowns = unknowns
        self._entries: list[tuple[Indices, Indices, Array]] = []
        self._bounds: list[tuple[Array, Array]] = []

    def add(
        self,
        rows: Indices,
        columns: Indices,
        values: Array,
        lower: Array,
        upper: Array | float = np.inf,
    ) -> int:
        """Add rows, ``rows`` counting from the first of them; return the index of that one."""
        first = self.count
        self._entries.append((first + rows, columns, values))
        self._bounds.append((lower, np.broadcast_to(upper, len(lower))))
        self.count += len(lower)
        return first

    def extend(self, rows: Indices, columns: Indices, value: float) -> None:
        """Add the same entry to rows that were added before."""
        self._entries.append((rows, columns, np.full(len(rows), value)))

    def add_bounds(self, columns: Indices, lower: Array | float, upper: Array | float) -> None:
        """Bound single unknowns."""
        m = len(columns)
        self.add(np.arange(m), columns, np.ones(m), np.broadcast_to(lower, m), upper)

    def compressed(self) -> tuple[sp.csc_array[np.float64], Array, Array]:
        """Return A, lower and upper; entries that happen to be zero are stored too."""
        import scipy.sparse as sp

        rows, columns, values = (np.concatenate(part) for part in zip(*self._entries, strict=True))
        lower, upper = (np.concatenate(part) for part in zip(*self._bounds, strict=True))
        shape = (self.count, self._unknowns)
        return sp.csc_array((values, (rows, columns)), shape=shape), lower, upper


def solve_qp(program: QuadraticProgram) -> Array | None:
    """Return the minimiser, or None where no solution keeps rows and bounds within RESIDUAL.

    The solver is PIQP, an interior-point method that ships with casadi: OSQP is slow to reach the
    1e-6 and better that leg lengths need. Its status is not trusted; residuals are recomputed.
    """
    import casadi as ca

    def matrix(given: sp.csc_array[np.float64]) -> ca.DM:  # its own conversion takes a millisecond
        given.sort_indices()
        sparsity = ca.Sparsity(*given.shape, given.indptr.tolist(), given.indices.tolist())
        return ca.DM(sparsity, given.data)

    H, A = matrix(program.P), matrix(program.A)
    shapes = {"h": H.sparsity(), "a": A.sparsity()}
    solver = ca.conic("program", "piqp", shapes, {"error_on_fail": False})
    rows = {"lba": program.lower, "uba": program.upper}
    solution = solver(h=H, g=program.q, a=A, lbx=program.least, ubx=program.most, **rows)
    x = np.asarray(solution["x"], dtype=np.float64).reshape(-1)
    values = program.A @ x
    gaps = program.lower - values, values - program.upper, program.least - x, x - program.most
    feasible = np.max(np.concatenate(gaps)) <= RESIDUAL  # not of nan
    return np.clip(x, program.least, program.most) if feasible else None


PENALTY = 1e3
"""[m²] Penalty weight per robot and unit of margin: distances come first, deviation second."""

SWAY = 0.02
"""[m] Distance by which drones turn aside at most as the weight of their cables' legs changes."""


class LegBodies:
    """Nodes and pairs of a task, flat over its J polygons.

    In the plane of level legs two coordinates suffice; else there are three, and heights between
    two drones count as much less as their ellipsoid is higher than wide. The directions of legs
    whose cables have weight depend on their lengths: they are those of the given lengths.
    Pairs that never come near between the lengths ``lowest`` and ``highest`` (J, n) are dropped.
    """

    def __init__(self, task: LegTask, lowest: Array, highest: Array) -> None:
        J, n = task.reference.shape
        layout, keep = task.team.layout, task.requirements.separation
        self.task, self._turns = task, task.team.cable_density > 0.0
        self.dimensions = 2 if task.level else 3
        self._points = np.zeros((J, layout.points, self.dimensions))
        self._points[..., :2] = task.polygons
        self._edges = unit(layout.edges(self._points))
        cable = np.concatenate([np.zeros(layout.points, np.intp), np.repeat(np.arange(n), 2)])
        self.variable = (n * np.arange(J)[:, None] + cable).reshape(-1)
        self.count = layout.points + 2 * n
        drones = layout.points + np.arange(2 * n)
        self.drones = (self.count * np.arange(J)[:, None] + drones).reshape(-1)
        self.limits, self.scale = limits_of(keep), scales_of(keep)[:, : self.dimensions]
        self._fixed = None if self._turns else self._lines(task.reference)
        # From above nothing is farther than in space.
        ends = [self.nodes(lowest)[:, :2]]
        if highest is not lowest:
            ends.append(self.nodes(highest)[:, :2])
        bodies = Bodies.of(layout)
        swept = np.stack(ends).reshape(-1, J, self.count, 2)
        corners = (
            swept[:, :, bodies.nodes].transpose(0, 3, 1, 2, 4).reshape(2 * len(ends), J, -1, 2)
        )
        # From there on a pair has its margin for certain.
        cutoff = max(task.largest_margin, 1.0) * float(np.max(self.limits)) * (1.0 + 1e-9)
        cutoff += SWAY if self._turns else 0.0
        boxes = np.min(corners, axis=0), np.max(corners, axis=0)
        pairs = bodies.near(*boxes, self.limits, cutoff)
        if task.fixed is not None:  # fixed knots cannot change
            pairs = pairs[:, ~task.fixed[pairs[0]]]
        self.frame, i, j, self.kind = pairs
        self.first: Indices = bodies.nodes[i] + self.count * self.frame[:, None]
        self.second: Indices = bodies.nodes[j] + self.count * self.frame[:, None]

    def lines(self, d: Array) -> tuple[Array, Array]:
        """Return, of legs of length d (J, n) [m], the lines that nodes slide on.

        Their nodes without legs, and by ``d``: (J·count, 2 or 3) [m] and without unit.
        """
        return self._fixed or self._lines(d)

    def _lines(self, d: Array) -> tuple[Array, Array]:
        task, team, p = self.task, self.task.team, self._points
        layout, slack, shape = team.layout, task.slack, (len(p), -1, self.dimensions)
        loads = None if task.level else clasp_loads(team, d, slack, task.roll)
        q, r = leg_directions(self._edges, team.tension, team.topology, loads)
        if self._turns:
            sag = sag_factors(team, team.tension)
            q, r = (
                leg_vectors(np.ones_like(legs), direction, sag * legs**2)
                for legs, direction in ((d, q), (slack - d, r))
            )
        ends = np.stack([p[:, layout.starts], p[:, layout.ends] + slack[..., None] * r], axis=2)
        slopes = np.stack([q, -r], axis=2)
        base = np.concatenate([p, ends.reshape(shape)], axis=1)
        slope = np.concatenate([np.zeros_like(p), slopes.reshape(shape)], axis=1)
        return base.reshape(shape[1:]), slope.reshape(shape[1:])

    def nodes(self, d: Array) -> Array:
        """Return the nodes' positions (J·count, 2 or 3) [m]."""
        base, slope = self.lines(d)
        nodes: Array = base + slope * d.reshape(-1)[self.variable][:, None]
        return nodes

    def offsets(self, nodes: Array) -> Array:
        """Return the shortest vector of each pair, second body to first, (pairs, 2 or 3) [m].

        Heights are scaled as the kinds of pairs have them.
        """
        between = differences(nodes[self.first], nodes[self.second])
        return shortest_offset(between * self.scale[self.kind][:, None])

    def margins(self, d: Array) -> Array:
        """Return the smallest distance over its limit (J,); crossings count up to their margin.

        Where margins differ from knot to knot, in proportion to the largest of them.
        """
        task = self.task
        ratios = length(self.offsets(self.nodes(d))) / self.limits[self.kind]
        enough = task.margins[CROSSING, self.frame] * (1.0 - 1e-9)
        apart = np.where((self.kind == CROSSING) & (ratios >= enough), np.inf, ratios)
        smallest = np.full(len(d), np.inf)
        np.minimum.at(smallest, self.frame, apart / task.margins[SEPARATION, self.frame])
        return task.largest_margin * smallest


def leg_program(bodies: LegBodies, d: Array) -> QuadraticProgram:
    """Return the convex QP around ``d``; variables are d, then two slacks of the margins.

    For a pair of bodies and any unit vector ν, ``ν·(a - b)`` taken at its smallest over their ends
    is a lower bound of their distance and linear in ``d``; with ν from the present leg lengths it
    is tight there. One slack is that of drones, the other one of crossings and walls: out of reach,
    these must not leave the rest undecided.
    """
    task, size = bodies.task, d.size + 2
    (base, slope), nodes = bodies.lines(d), bodies.nodes(d)
    middles = nodes[bodies.first].mean(axis=1) - nodes[bodies.second].mean(axis=1)
    normal = unit(bodies.offsets(nodes), unit(middles, EAST[: bodies.dimensions]), 1e-9)
    pair, a, b = end_combinations(bodies.kind, bodies.first, bodies.second)
    kind, row = bodies.kind[pair], np.arange(len(pair))
    nu, limit = normal[pair] * bodies.scale[kind], bodies.limits[kind]
    slacks = np.where(kind == CROSSING, size - 1, size - 2)
    # Slightly more than required, so that rounding does not leave it short.
    wanted = task.margins[kind, bodies.frame[pair]] * (1.0 + 1e-7) * limit
    least = wanted - np.sum(nu * (base[a] - base[b]), axis=1)
    moved = np.sum(nu * slope[a], axis=1), -np.sum(nu * slope[b], axis=1)
    columns = np.concatenate([bodies.variable[a], bodies.variable[b], slacks])
    rows = Rows(size)
    rows.add(np.tile(row, 3), columns, np.concatenate([*moved, limit]), least)
    arena = task.requirements.arena
    if arena is not None:  # every drone between its upright walls
        base, slope = base[bodies.drones, :2], slope[bodies.drones, :2]
        entries = np.concatenate([slope, -slope], axis=1).T.ravel()
        least = np.concatenate([arena.lower[:2] - base, base - arena.upper[:2]], axis=1).T.ravel()
        # No leg length moves a drone along a parallel wall: such a row could only be infeasible.
        free = np.abs(entries) > 1e-9
        columns = np.tile(bodies.variable[bodies.drones], 4)[free]
        row = np.arange(len(columns))
        first = rows.add(row, columns, entries[free], least[free])
        rows.extend(first + row, np.full(len(row), size - 1), 1.0)
    penalty = np.full(2, PENALTY * task.team.robots)
    lower, upper = (
        np.append(bound.reshape(-1), [end, end])
        for bound, end in zip(task.bounds, (0.0, np.inf), strict=True)
    )
    gradient = np.append(-task.reference.reshape(-1), penalty)
    return QuadraticProgram(_hessian(task, size), gradient, *rows.compressed(), lower, upper)


def _hessian(task: LegTask, size: int) -> sp.csc_array[np.float64]:
    """Return the Hessian of half the sum of squares of lengths, and of fractions' roughness."""
    import scipy.sparse as sp

    squares = np.append(np.ones(size - 2), [0.0, 0.0])
    diagonal = sp.csc_array((squares, np.arange(size), np.arange(size + 1)), shape=(size, size))
    J, n = task.reference.shape
    if task.roughness == 0.0 or J < 3:
        return diagonal
    second = sp.diags_array([1.0, -2.0, 1.0], offsets=[0, 1, 2], shape=(J - 2, J))
    fractions = sp.diags_array(1.0 / task.slack.reshape(-1))
    bend = sp.kron(second, sp.eye_array(n)) @ fractions
    rough = sp.block_diag([task.roughness * (bend.T @ bend), sp.csc_array((2, 2))])
    return sp.csc_array(diagonal + rough)


START_ROUNDS, PATH_ROUNDS = 60, 20
"""Maximum numbers of convex programs from one start: on one polygon, and along a path, where ten
are enough or none are."""

GAIN = 1e-6
"""Smallest relative gain of merit that counts: a mirror image gains less."""

SETTLED, QUICKLY_SETTLED = 1e-9, 1e-5
"""[m] Largest change of a leg in the last round; and where the first split that keeps the margin is
taken: a round that changes so little does not raise the margin either."""


def split_slack(task: LegTask, *, first: bool = False) -> LegLengths:
    """Return the leg lengths nearest to the reference that keep the margin, else the best ones.

    The search is local: it starts from the reference and, where that fails on a single polygon,
    from a few uneven splits as well (along a path the fixed ends leave little freedom). Its cost
    is linear in J·n. With ``first`` it ends at the first lengths that keep the margin: many times
    as fast.
    """
    bodies = LegBodies(task, *task.bounds)
    best = _reference_kept(bodies) or _refined(bodies, task.reference, first)
    if len(task.reference) > 1 or (_keeps(task, best) and (first or best.deviation <= 1e-12)):
        return best
    for fractions in _uneven_fractions(task):
        split = _refined(bodies, fractions * task.slack, first)
        if _merit(task, split) < (1.0 - GAIN) * _merit(task, best):
            best = split
        if first and _keeps(task, best):
            break
    return best


def reference_margin(task: LegTask) -> float:
    """Return the smallest distance over its limit of the reference itself.

    Pairs beyond the largest margin may be left out.
    """
    return float(np.min(reference_margins(task)))


def reference_margins(task: LegTask) -> Array:
    """Return the same (J,) of every polygon by itself."""
    return LegBodies(task, task.reference, task.reference).margins(task.reference)


def _reference_kept(bodies: LegBodies) -> LegLengths | None:
    """Return the reference if it keeps the margin and all bounds to the last bit, else None."""
    task, arena = bodies.task, bodies.task.requirements.arena
    start = np.clip(task.reference, *task.bounds)
    if task.roughness > 0.0 or not np.array_equal(start, task.reference):
        return None
    margin, drones = float(np.min(bodies.margins(start))), bodies.nodes(start)[bodies.drones, :2]
    if margin < task.largest_margin or (
        arena and np.any((drones < arena.lower[:2]) | (drones > arena.upper[:2]))
    ):
        return None
    return LegLengths(start, margin, 0.0)


def _uneven_fractions(task: LegTask) -> Array:
    """Return fractions (4 or 6, n): equal ones, or alternating from the sharpest clasp on.

    Counted from there, they are the same for a hitch that is renumbered or mirrored.
    """
    layout = task.team.layout
    along = unit(layout.edges(task.polygons[0]))
    cosines = dot(along[layout.ahead], along[layout.behind])
    sharpest = layout.clasps[int(first_smallest(cosines, 1.0))]
    k = np.arange(layout.robots)
    onward = (k - sharpest) % layout.robots % 2 == 0
    back = (sharpest - 1 - k) % layout.robots % 2 == 1
    alike = np.ones_like(onward)
    return np.unique(np.where([alike, ~alike, onward, ~onward, back, ~back], 0.3, 0.7), axis=0)


def _keeps(task: LegTask, split: LegLengths) -> bool:
    return split.margin >= task.largest_margin * (1.0 - 1e-9)


def _merit(task: LegTask, split: LegLengths) -> float:
    short = max(0.0, task.largest_margin - split.margin)
    return PENALTY * task.team.robots * (short if short > 1e-7 else 0.0) + 0.5 * split.deviation


def _refined(bodies: LegBodies, start: Array, first: bool) -> LegLengths:
    """Return the leg lengths that repeated convex approximation reaches from ``start``.

    Or the ``first`` iterate that keeps the margin.
    """
    task = bodies.task
    d, settled = np.clip(start, *task.bounds), QUICKLY_SETTLED if first else SETTLED
    for _ in range(START_ROUNDS if len(d) == 1 else PATH_ROUNDS):
        check_time()
        x = solve_qp(leg_program(bodies, d))
        if x is None:
            break
        before, d = d, x[: d.size].reshape(d.shape)
        if float(np.max(np.abs(d - before))) < settled:
            break
        if first and np.min(bodies.margins(d)) >= task.largest_margin * (1.0 - 1e-9):
            break
    margin = float(np.min(bodies.margins(d)))
    return LegLengths(d, margin, float(np.sum((d - task.reference) ** 2)))


ROLL_CANDIDATES = tuple(
    math.radians(angle) for angle in (5.0, 10.0, 15.0, 20.0, 30.0, 40.0, 50.0, 60.0)
)
"""[rad] Rolls in ascending order; the first that suffices is used. Simulated clasps hold to 60°."""

COARSE, LESS = (ROLL_CANDIDATES[3], ROLL_CANDIDATES[5]), 0.9
"""[rad] Rolls at which other lengths of legs are looked for, which takes longer; and the share of
the roll that the reference needs at which they have to suffice for that to be worth its time."""


def split_with_least_roll(task: LegTask) -> tuple[LegLengths, Array | float]:
    """Return leg lengths on one polygon and the roll [rad] that goes with them.

    The task's own, or none, where legs keep all limits with it. Else the smallest one tried with
    which they keep the margin that is wanted, else the limits, as they are or with other lengths;
    the task's own where no roll helps. Its sense is that of the task's own, upward of q-legs
    without one.
    """
    own = 0.0 if task.roll is None else task.roll
    without = split_slack(task)
    if without.margin >= 1.0:
        return without, own
    sense = -1.0 if np.sum(own) < 0.0 else 1.0
    for margin in dict.fromkeys((task.largest_margin, LIMIT_MARGIN)):
        aim = replace(task, margin=margin)
        given = least_roll(aim, sense)
        ladder = COARSE if given is None else (LESS * abs(given),)
        chosen = least_roll(aim, sense, lambda rolled: split_slack(rolled).margin, ladder, 3)
        roll = given if chosen is None else chosen
        if roll is not None:
            return split_slack(replace(aim, roll=roll)), roll
    return without, own


def least_roll(
    task: LegTask,
    sense: float = 1.0,
    margin_of: Callable[[LegTask], float] = reference_margin,
    ladder: tuple[float, ...] = ROLL_CANDIDATES,
    halvings: int = 7,
) -> float | None:
    """Return the smallest roll [rad] tried that gives the largest margin, or None.

    To a hundredth of the step between two rungs of a ladder; a roll that leaves loads no balance
    gives none.
    """

    def suffices(angle: float) -> bool:
        try:
            rolled = replace(task, roll=sense * angle)
            return margin_of(rolled) >= task.largest_margin * (1.0 - 5e-7)
        except InfeasibleError:
            return False

    upper = next((rung for rung in ladder if suffices(rung)), None)
    if upper is None:
        return None
    lower = max((rung for rung in ladder if rung < upper), default=0.0)
    for _ in range(halvings):
        middle = 0.5 * (lower + upper)
        lower, upper = (lower, middle) if suffices(middle) else (middle, upper)
    return sense * upper
