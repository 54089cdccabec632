"""Errors of vertices at rest, for the largest errors of cables, drones and friction."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from .arithmetic import Array, G, Items, norm
from .parts import sinh_over, solve, tanh_over
from .plan import Plan, tube_of
from .spans import SAMPLED, Row, Worst, worst_row

AXIAL = 1e4  # [N] stiffness EA of cables to stretch
STIFFEST = 36.0  # [1/s²] stiffness over mass of a position loop that states none
DEGREE_OF_TILT = 9.81 * math.pi / 180.0  # [m/s²]
UNSTATED = 0.02  # [m] error of drones without any statement
AT_REST = 1e-6  # [m/s], [m/s²]
USUAL = {"cable_length": 0.01, "drone": None, "friction": 0.0}  # largest errors [m], [m], 1
TAUT = 0.9  # fraction of the team's tension
SAME = 1e-6  # [m] of drones at the same rest
BEYOND = 2.0  # factor of the difference to first order
LEVELS = np.linspace(0.1, 1.0, 10)  # fractions of the errors, one after the other
ITERATIONS = 30  # of Newton's method, at each level
SOLVED = 1e-9  # [m] largest last step
LARGEST_STEP = 0.1  # [m] of a node in a step of Newton's method
STEP = 1e-30  # step of complex-step derivatives

# Horizontal and vertical gains
PER_MASS = {  # [1/s²] default gains kp of controllers over the mass
    "lee": (7.0, 7.0),
    "pid": (51.0 * DEGREE_OF_TILT, 51.0 * DEGREE_OF_TILT),
    "px4": (1.71, 4.0),
}
MELLINGER = (0.40, 1.25)  # [N/m] default gains kp of mellinger
PX4_DAMPING = (1.8, 4.0)  # [1/s] default gains kd of px4 over the mass
PX4_P = ((0.0, 2.0), (0.0, 1.5))  # [1/s] smallest and largest gains of position
PX4_VELOCITY = ((1.2, 5.0), (2.0, 15.0))  # [1/s] smallest and largest gains of velocity


def loop_stiffness(kind: dict[str, Any]) -> Array:
    """Return the stiffness (3,) [N/m] of a drone's position loop."""
    name = kind["controller"]
    mass = kind["mass"]
    gains = kind["gains"] or {}
    if name is None:
        return np.full(3, kind["stiffness"] or STIFFEST * mass)
    default = MELLINGER if name == "mellinger" else [mass * x for x in PER_MASS[name]]
    kp = np.array(gains.get("kp") or default, dtype=float)
    if name == "px4":
        kd = np.array(gains.get("kd") or [mass * x for x in PX4_DAMPING], dtype=float)
        kp = (
            mass
            * np.clip(kp / kd, *np.transpose(PX4_P))
            * np.clip(kd / mass, *np.transpose(PX4_VELOCITY))
        )
    return np.array([kp[0], kp[0], kp[1]])


class Rest:
    """A hitch at rest as planned, and its balance with errors.

    Unknowns are the positions of drones, then of clasps, then the tensions of cables. Errors are n
    of lengths [m], 3 N of setpoints [m], and 2 n coefficients μ of friction: a leg pulls ``e^{μβ}``
    times as much as its edge, where the cable bends by β.
    """

    def __init__(
        self, p: Plan, drones: Array, vertices: Array, tensions: Array, pulls: Array | None = None
    ) -> None:
        n, N, clasps = p.n, p.N, p.clasps
        node = np.full(len(vertices), -1)
        node[clasps] = N + np.arange(len(clasps))
        node[node < 0] = [0, N - 1][: int(np.sum(node < 0))]  # a chain's ends are drones
        k = np.arange(n)
        self.nodes: Items = np.stack([2 * k, node[p.begin - N], node[p.end - N], 2 * k + 1], axis=1)
        self.exists = np.insert(p.leg.reshape(n, 2), 1, True, axis=1)
        self.vertices, self.at, self.tensions = vertices, node, tensions
        self.length = p.length[:, 0]
        self.weight = p.weight
        self.load = G * p.load[:, 0]
        kinds = p.settings["team"]["quadrotor"]
        each = np.repeat([loop_stiffness(kind) for kind in kinds], N // len(kinds), axis=0)
        self.stiffness = each[p.drone]
        self.setpoints = drones
        self.planned = np.concatenate([drones, vertices[clasps]])
        ends = self.planned[self.nodes]
        self.heights = 0.5 * (ends[:, 1, 2] + ends[:, 2, 2])
        if not p.closed:  # edges to a chain's ends have their tension at their clasp
            self.heights[0], self.heights[-1] = ends[0, 2, 2], ends[-1, 1, 2]
        self.held = np.zeros((N, 3))
        unknowns = np.concatenate([self.planned.ravel(), tensions])
        bends = self.bends(unknowns)
        self.errors = np.zeros(n + 3 * N + 2 * n)  # friction of the pulls (2 n,) [N] of legs
        if pulls is not None:
            ratios = np.log(pulls / np.repeat(tensions, 2))
            self.errors[n + 3 * N :] = ratios / np.where(bends > 0.0, bends, 1.0)
        forces = self.balance(unknowns, self.errors, bends)[: 3 * N]
        self.held = -forces.reshape(N, 3)

    def balance(self, unknowns: Array, errors: Array, bends: Array) -> Array:
        """Return minus forces on nodes, and excess lengths of cables, for bends (2 n,) [rad].

        Either unknowns or errors may have a leading axis.
        """
        n, N = len(self.length), len(self.setpoints)
        positions = unknowns[..., :-n].reshape(*unknowns.shape[:-1], -1, 3)
        tensions = unknowns[..., -n:]
        of_lengths, of_setpoints, of_friction = np.split(errors, [n, n + 3 * N], axis=-1)
        ratios = np.exp(of_friction * bends).reshape(*errors.shape[:-1], n, 2)
        of_edges = np.ones(ratios.shape[:-1])
        of_parts = np.stack([ratios[..., 0], of_edges, ratios[..., 1]], -1)
        at_clasps = tensions[..., None] * of_parts
        pull, down, arc = self.spans(positions[..., self.nodes, :], at_clasps)

        shape = np.broadcast_shapes(unknowns.shape[:-1], errors.shape[:-1])
        force = np.zeros((*shape, *positions.shape[-2:]), np.result_type(unknowns, errors))
        for span in range(3):
            for k in range(n):
                first, second = self.nodes[k, span : span + 2]
                force[..., first, :] += (down - pull)[..., k, span, :]
                force[..., second, :] += (down + pull)[..., k, span, :]
        offsets = of_setpoints.reshape(*errors.shape[:-1], N, 3)
        deviations = positions[..., :N, :] - self.setpoints - offsets
        force[..., :N, :] += self.stiffness * deviations + self.held
        force[..., N:, 2] += self.load

        stretch = self.length / AXIAL * (tensions - self.tensions)
        excess = np.sum(arc, axis=-1) - (self.length + of_lengths) - stretch
        excess = np.broadcast_to(excess, (*shape, n))
        return np.concatenate([force.reshape(*shape, -1), excess], axis=-1)

    def spans(self, ends: Array, tensions: Array) -> tuple[Array, Array, Array]:
        """Return pull [N], weight at each end [N] and length [m] of a leg, an edge and a leg each.

        With a chord of the horizontal part D and the rise h, the tension m at its middle and its
        length L, a span has the energy ``m (D² tanh σ / (σ L) + L + h² / L) / 2``, see ``parts``.
        Its derivative by the chord is the pull, its derivative by m the length; m grows by the
        weight per height of the middle. Spans that do not exist have neither.
        """
        w = self.weight
        chord = np.where(self.exists[..., None], ends[..., 1:, :] - ends[..., :-1, :], 0.0)
        middle = 0.5 * (ends[..., 1:, 2] + ends[..., :-1, 2])
        m = tensions + w * (middle - self.heights[:, None])
        level_square = chord[..., 0] ** 2 + chord[..., 1] ** 2
        rise_square = chord[..., 2] ** 2
        along = chord
        stretch = 1.0
        if w:
            factor = (0.5 * w / m) ** 2
            y = solve(factor * rise_square, factor * level_square)
            flatness = tanh_over(y)
            along = chord * np.stack([flatness, flatness, np.ones_like(y)], axis=-1)
            stretch = sinh_over(y) ** 2
        length = np.sqrt(rise_square + stretch * level_square)
        pull = (m / np.where(self.exists, length, 1.0))[..., None] * along
        down = np.zeros(pull.shape, dtype=pull.dtype)
        down[..., 2] = 0.5 * w * length
        return pull, down, length

    def slopes(self, unknowns: Array, errors: Array) -> tuple[Array, Array]:
        """Return derivatives (unknowns, unknowns) and (unknowns, errors), at constant bends."""
        bends = self.bends(unknowns)
        by_unknowns = self.balance(unknowns + 1j * STEP * np.eye(len(unknowns)), errors, bends)
        by_errors = self.balance(unknowns, errors + 1j * STEP * np.eye(len(errors)), bends)
        return by_unknowns.imag.T / STEP, by_errors.imag.T / STEP

    def settled(self, errors: Array) -> Array:
        """Return the unknowns at rest with errors, by Newton's method; nan if it does not end.

        Errors rise in LEVELS, each of which starts from the rest at the one before.
        """
        unknowns = np.concatenate([self.planned.ravel(), self.tensions])
        for level in LEVELS:
            for _ in range(ITERATIONS):
                slopes = self.slopes(unknowns, level * errors)[0]
                residual = self.balance(unknowns, level * errors, self.bends(unknowns))
                try:
                    step = np.linalg.solve(slopes, -residual)
                except np.linalg.LinAlgError:
                    return np.full(len(unknowns), np.nan)
                moved = float(np.max(np.abs(step[: self.planned.size])))
                unknowns = unknowns + step * min(1.0, LARGEST_STEP / max(moved, SOLVED))
                if not moved > SOLVED:  # also for nan, with which unknowns are nan
                    break
            else:
                return np.full(len(unknowns), np.nan)
        return unknowns

    def places(self, unknowns: Array) -> Array:
        """Return the vertices (P, 3) [m]."""
        return np.asarray(unknowns[: self.planned.size].reshape(-1, 3)[self.at])

    def bends(self, unknowns: Array) -> Array:
        """Return the bends (2 n,) [rad] of cables, half turns of a helix; 0 without a leg."""
        return np.asarray((math.pi * self.half_chords(unknowns) * self.exists[:, ::2]).ravel())

    def half_chords(self, unknowns: Array) -> Array:
        """Return sines (n, 2) of half of the angles by which cables turn from legs to edges."""
        chord = np.diff(unknowns[: self.planned.size].reshape(-1, 3)[self.nodes], axis=1)
        u = chord / np.maximum(norm(chord), STEP)[..., None]
        return np.asarray(0.5 * norm(u[:, 1:] - u[:, :-1]))

    def radii(self, errors: dict[str, Any], tube: tuple[float, float]) -> Array:
        """Return bounds (P,) [m] of how far vertices are off, for the largest errors."""
        n, N = len(self.length), len(self.setpoints)
        none = np.zeros(n + 3 * N + 2 * n)
        rest = self.settled(none)
        by_unknowns, by_errors = self.slopes(rest, none)
        moves = -np.linalg.solve(by_unknowns, by_errors)[: self.planned.size]
        moves = moves.reshape(-1, 3, len(none))[self.at]
        level, height = tube
        size = np.concatenate(
            [
                np.full(n, errors["cable_length"]),
                np.tile([level, level, max(level, height)], N),
                np.full(2 * n, errors["friction"]),
            ]
        )
        group = np.concatenate([np.arange(n), n + np.arange(3 * N) // 3, n + N + np.arange(2 * n)])
        moves = moves * size
        sums = np.zeros((len(moves), 3, 3))
        total = np.zeros(len(moves))
        for j in range(n + N + 2 * n):
            part = moves[:, :, group == j]
            trace = np.sqrt(np.sum(part**2, axis=(1, 2)))
            scale = np.where(trace > 0.0, trace, 1.0)[:, None, None]
            sums += part @ part.swapaxes(1, 2) / scale
            total += trace
        squares, axes = np.linalg.eigh(total[:, None, None] * sums)
        first = np.sqrt(squares[:, -1])
        worst = int(np.argmax(first))
        push = axes[worst, :, -1] @ moves[worst]
        sizes = np.sqrt(np.bincount(group, push**2))[group]
        corner = push / np.where(sizes > 0.0, sizes, 1.0)
        beyond = 0.0
        for sign in (1.0, -1.0):
            at = self.places(self.settled(sign * size * corner)) - self.places(rest)
            beyond = max(beyond, float(np.max(norm(at - sign * moves @ corner), initial=0.0)))
            if not np.all(np.isfinite(at)):
                beyond = math.inf
        return np.asarray(first + norm(self.places(rest) - self.vertices) + BEYOND * beyond)


def rests(p: Plan) -> Iterator[tuple[float, Rest]]:
    """Yield the times [s] of different rests of a hitch that holds nothing, and the hitches."""
    places = list[Array]()
    empty = (p.state == "hitched") & ~np.any(p.held, axis=0)
    empty &= ~np.any(p.load_share.c[0] != 0.0, axis=(1, 2, 3))
    for q in np.flatnonzero(empty):
        for end in (0, -1):
            drones, speed, rate = (p.points.c[k][q, : p.N, :, end] for k in range(3))
            T = p.tensions.c[0][q, :, 0, end]
            still = max(float(np.max(np.abs(speed))), float(np.max(np.abs(rate)))) <= AT_REST
            if not still or not np.all(TAUT * p.stated_tension[:, 0] <= T):
                continue
            if all(np.max(np.abs(drones - other)) > SAME for other in places):
                places.append(drones)
                at = float(p.breaks[q - end])
                yield at, Rest(p, drones, p.points.c[0][q, p.V, :, end], T)


def vertex_errors(p: Plan) -> Iterator[Row]:
    """Yield the row of the largest errors of vertices at rest, if they are limited.

    The certificate adds an estimate of how far cables and loads with inertia still swing.
    """
    limit = p.limits.get("vertex_error")
    if limit is None or not p.n:
        return
    errors: dict[str, Any] = USUAL | (p.settings["team"].get("errors") or {})
    tracking = p.limits["tracking"] if errors["drone"] is None else errors["drone"]
    tube = tube_of(UNSTATED if tracking is None else tracking)
    values = list[Worst]()
    for time, rest in rests(p):
        radii = rest.radii(errors, tube)
        values += zip(radii.tolist(), [time] * len(radii), p.labels[p.V], strict=True)
    row = worst_row("vertex_error", "m", limit, values)
    swings = p.weight > 0.0 or bool(np.any(p.load > 0.0))
    yield row._replace(verdict=SAMPLED) if swings and row.verdict == "proven" else row
