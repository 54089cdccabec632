"""The convex QP around a sharing: bodies, their near pairs, and rows that keep them apart.

For a pair of bodies and any unit vector ν, ``ν·(a - b)`` taken at its smallest over their ends is a
lower bound of their distance and linear in ``d``; with ν from the present sharing it is tight
there.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from hitchopt.geometry import differences, shortest_offset
from hitchopt.geometry.broadphase import Boxes, close_pairs
from hitchopt.hitch.convex_qp import QuadraticProgram
from hitchopt.hitch.leg_task import LegTask
from hitchopt.hitch.parts import CABLE, CROSSING, SEPARATION, Parts
from hitchopt.hitch.statics import leg_directions
from hitchopt.requirements import Arena

Array = NDArray[np.float64]
Index = NDArray[np.intp]

PENALTY = 1e3
"""[m²] per robot and unit of margin: so dear that distances come first, deviation second."""


class LegBodies:
    """Nodes and pairs of a task, flat over its J polygons.

    Parameters
    ----------
    task: whose bodies.
    lowest, highest: sharings (J, n) [m] between which pairs have to come near to be kept.
    """

    def __init__(self, task: LegTask, lowest: Array, highest: Array) -> None:
        J, n = task.reference.shape
        p = task.polygons
        layout = task.team.layout
        edges = layout.edges(p)
        u = edges / np.linalg.norm(edges, axis=-1, keepdims=True)
        q, r = leg_directions(u, task.team.tension, task.team.topology)
        following = p[:, layout.ends] + task.slack[..., None] * r
        ends = np.stack([p[:, layout.starts], following], axis=2)
        slopes = np.stack([q, -r], axis=2).reshape(J, 2 * n, 2)
        self.base = np.concatenate([p, ends.reshape(J, 2 * n, 2)], axis=1).reshape(-1, 2)
        self.slope = np.concatenate([np.zeros_like(p), slopes], axis=1).reshape(-1, 2)
        cable = np.concatenate([np.zeros(layout.points, np.intp), np.repeat(np.arange(n), 2)])
        self.variable = (n * np.arange(J)[:, None] + cable).reshape(-1)
        self.count = layout.points + 2 * n
        drones = layout.points + np.arange(2 * n)
        self.drones = (self.count * np.arange(J)[:, None] + drones).reshape(-1)
        keep = task.requirements.separation
        self.limits = np.array([2.0 * keep.radius, keep.cable, keep.crossing])
        self._find_pairs(task, Parts.of(n, task.team.topology), lowest, highest)

    def nodes(self, d: Array) -> Array:
        """Return the nodes' positions (J·count, 2) [m]."""
        nodes: Array = self.base + self.slope * d.reshape(-1)[self.variable][:, None]
        return nodes

    def offsets(self, nodes: Array) -> Array:
        """Return the shortest vector of each pair, second body to first, (pairs, 2) [m]."""
        return shortest_offset(differences(nodes[self.first], nodes[self.second]))

    def margin(self, task: LegTask, d: Array) -> float:
        """Return the smallest distance over its limit; crossings count up to their margin only."""
        distance = np.linalg.norm(self.offsets(self.nodes(d)), axis=1)
        ratios = distance / self.limits[self.kind]
        enough = task.crossing_margins[self.frame] * (1.0 - 1e-9)
        apart = np.where((self.kind == CROSSING) & (ratios >= enough), np.inf, ratios)
        shares = apart / task.margins[self.frame]
        return task.wanted * float(np.min(shares, initial=np.inf))

    def inside(self, arena: Arena | None, d: Array) -> bool:
        """Return whether every drone is between the arena's upright walls."""
        if arena is None:
            return True
        drones = self.nodes(d)[self.drones]
        return bool(np.all((drones >= arena.lower[:2]) & (drones <= arena.upper[:2])))

    def _find_pairs(self, task: LegTask, parts: Parts, lower: Array, upper: Array) -> None:
        """Keep the pairs whose sweeps between two sharings come within reach of their limits."""
        J = len(task.reference)
        swept = np.stack([self.nodes(lower), self.nodes(upper)]).reshape(2, J, self.count, 2)
        corners = swept[:, :, parts.nodes].transpose(0, 3, 1, 2, 4).reshape(4, -1, 2)
        lowest, highest = np.min(corners, axis=0), np.max(corners, axis=0)
        cutoff = max(task.wanted, 1.0) * float(np.max(self.limits))
        # A third coordinate keeps the polygons apart, so that one tree serves them all.
        size = cutoff + float(np.max(highest) - np.min(lowest))
        level = np.repeat(np.arange(J) * 4.0 * size, len(parts.nodes))
        boxes = Boxes(np.column_stack([lowest, level]), np.column_stack([highest, level]))
        pairs = close_pairs(boxes, None, cutoff * (1.0 + 1e-9))
        frame, i = np.divmod(pairs.first, len(parts.nodes))
        j = pairs.second % len(parts.nodes)
        kind = parts.kind(i, j)
        wanted = (kind >= 0) & (self.limits[kind] > 0.0)
        if task.fixed is not None:  # what cannot change is no matter of the sharing
            wanted &= ~task.fixed[frame]
        offset = (self.count * frame[wanted])[:, None]
        self.frame: Index = frame[wanted]
        self.kind: Index = kind[wanted]
        self.first: Index = parts.nodes[i[wanted]] + offset
        self.second: Index = parts.nodes[j[wanted]] + offset


def leg_bounds(task: LegTask) -> tuple[Array, Array]:
    """Return the smallest and largest ``d`` (J, n) that leave both legs long enough.

    The same one at the ends of a chain, where a cable has one leg only.
    """
    slack, layout = task.slack, task.team.layout
    shortest = np.minimum(task.shortest_leg, 0.5 * slack)
    lower = layout.q_legs_of(shortest, slack)
    upper = layout.q_legs_of(slack - shortest, slack)
    if task.fixed is not None:
        lower[task.fixed] = upper[task.fixed] = task.reference[task.fixed]
    return lower, upper


def leg_program(task: LegTask, bodies: LegBodies, d: Array) -> QuadraticProgram:
    """Return the convex QP around ``d``; variables are d, then two slacks of the margins."""
    J, n = d.shape
    size = J * n + 2
    nodes = bodies.nodes(d)
    offsets = bodies.offsets(nodes)
    distance = np.linalg.norm(offsets, axis=1, keepdims=True)
    middle = nodes[bodies.first].mean(axis=1) - nodes[bodies.second].mean(axis=1)
    direction = np.where(distance > 1e-9, offsets, middle)
    length = np.linalg.norm(direction, axis=1, keepdims=True)
    normal = np.where(length > 0.0, direction / np.where(length > 0.0, length, 1.0), [1.0, 0.0])

    pair, a, b = _end_combinations(bodies)
    kind, nu = bodies.kind[pair], normal[pair]
    limit = bodies.limits[kind]
    crossing = kind == CROSSING
    row = np.arange(len(pair))
    entries = np.concatenate(
        [
            np.sum(nu * bodies.slope[a], axis=1),
            -np.sum(nu * bodies.slope[b], axis=1),
            limit,  # the slacks: one of all margins, one of crossings and walls
        ]
    )
    columns = np.concatenate(
        [bodies.variable[a], bodies.variable[b], np.where(crossing, size - 1, size - 2)]
    )
    # A hair more than asked for, so that rounding does not leave it a hair short.
    frame = bodies.frame[pair]
    margins = np.where(crossing, task.crossing_margins[frame], task.margins[frame])
    wanted = margins * (1.0 + 1e-7) * limit
    least = wanted - np.sum(nu * (bodies.base[a] - bodies.base[b]), axis=1)
    rows = sparse.csc_matrix((entries, (np.tile(row, 3), columns)), shape=(len(row), size))

    if task.requirements.arena is not None:
        walls, wall_least = _wall_rows(bodies, task.requirements.arena, size)
        rows, least = sparse.vstack([rows, walls], format="csc"), np.append(least, wall_least)
    hessian = sparse.eye(J * n, format="csc") + _roughness(task)
    full = sparse.csc_matrix(sparse.block_diag([hessian, sparse.csc_matrix((2, 2))]))
    gradient = np.append(-task.reference.reshape(-1), [PENALTY * n, PENALTY * n])
    lower, upper = leg_bounds(task)
    return QuadraticProgram(
        full,
        gradient,
        rows,
        least,
        np.append(lower.reshape(-1), [0.0, 0.0]),
        np.append(upper.reshape(-1), [np.inf, np.inf]),
    )


def _end_combinations(bodies: LegBodies) -> tuple[Index, Index, Index]:
    """Return (pair, node of the first, node of the second): one row of the QP each."""
    found: list[tuple[Index, Index, Index]] = []
    for kind, firsts, seconds in (
        (SEPARATION, (0,), (0,)),
        (CABLE, (0,), (0, 1)),
        (CROSSING, (0, 1), (0, 1)),
    ):
        pair = np.flatnonzero(bodies.kind == kind)
        for i in firsts:
            found += [(pair, bodies.first[pair, i], bodies.second[pair, j]) for j in seconds]
    pairs, a, b = zip(*found, strict=True)
    return np.concatenate(pairs), np.concatenate(a), np.concatenate(b)


def _wall_rows(bodies: LegBodies, arena: Arena, size: int) -> tuple[sparse.csc_matrix, Array]:
    """Return rows and bounds that keep every drone between the arena's upright walls."""
    base, slope = bodies.base[bodies.drones], bodies.slope[bodies.drones]
    entries = np.concatenate([slope[:, 0], slope[:, 1], -slope[:, 0], -slope[:, 1]])
    least = np.concatenate([*(arena.lower[:2] - base).T, *(base - arena.upper[:2]).T])
    # A wall parallel to the leg is no matter of the sharing: such a row could only be infeasible.
    free = np.abs(entries) > 1e-9
    columns = np.tile(bodies.variable[bodies.drones], 4)[free]
    row = np.arange(len(columns))
    # Walls share the crossings' slack: out of reach, they must not leave the rest undecided.
    values = np.append(entries[free], np.ones(len(row)))
    places = (np.tile(row, 2), np.append(columns, np.full(len(row), size - 1)))
    return sparse.csc_matrix((values, places), shape=(len(row), size)), least[free]


def _roughness(task: LegTask) -> sparse.csc_matrix:
    """Return the Hessian of the fractions' squared second differences along the knots."""
    J, n = task.reference.shape
    if task.roughness == 0.0 or J < 3:
        return sparse.csc_matrix((J * n, J * n))
    second = sparse.diags_array([1.0, -2.0, 1.0], offsets=[0, 1, 2], shape=(J - 2, J))
    fractions = sparse.diags_array(1.0 / task.slack.reshape(-1))
    bend = sparse.kron(second, sparse.eye_array(n)) @ fractions
    return sparse.csc_matrix(task.roughness * (bend.T @ bend))
