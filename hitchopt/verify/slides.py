"""Where other friction than planned leaves vertices whose cables slide: rests with a history."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from copy import copy

import numpy as np

from .arithmetic import BIG, Array, Items, Mask, norm, runs_of
from .objects import clear_objects
from .plan import Plan
from .spans import SAMPLED, Row, Worst, worst_row
from .statics import AT_REST, STEP, TAUT, Rest

SHARES = np.linspace(0.0, 1.0, 9)  # of the range of friction
SLIDE = 1e-3  # [m] least change of leg lengths in a phase with slides
BETWEEN = 3  # samples from one rest of vertices to the next
FARTHEST = 0.15  # [m] of vertices or drones between samples
MORE = 0.25  # of differences between samples: twice that of a parabola
ITERATIONS = 20  # of Newton's method
SOLVED = 1e-6  # [m] largest last step
NUDGE = 1e-7  # [m] step of differences of bends
ROUNDS = 3  # of slips and balances
SWEEPS = 400  # steps of gradients
CONVERGED = 1e-7  # change of parts in the last one
STILL = 1e-6  # [m/s], [N/s] largest rate of drones and tensions at rest
RETURN = 1e-4  # [m] from its place before over-travels to that of a vertex after them


class Slider:
    """Drones and clasps that friction holds where cables stopped, or started to slide back.

    At a clasp the coefficients of both legs are ``μ (a u + b v)`` and ``μ (a u - b v)``, a and b
    the sine and cosine of half of the angle at which cables cross: they stick as long as u and v,
    its parts, are in the unit disc, and slip along their direction on it.
    """

    def __init__(self, p: Plan, friction: float, share: float) -> None:
        self.plan, self.friction = p, friction
        self.legs = np.stack([2 * p.clasps, 2 * p.behind + 1])
        self.of_parts = np.zeros((2 * p.n, len(p.clasps), 2))
        self.parts = np.zeros((len(p.clasps), 2))
        self.parts[:, 0] = share
        self.at, self.unknowns, self.lengths = np.zeros(0), np.zeros(0), np.zeros(0)

    def move(self, piece: int, end: int) -> Array:
        """Return the vertices (P, 3) [m] at an end of the next piece; nan without a balance."""
        p = self.plan
        T = p.tensions.c[0][piece, :, 0, end]
        places = p.points.c[0][piece, ..., end]
        rest = Rest(p, places[: p.N], places[p.V], T, p.pulls.c[0][piece, :, 0, end])
        at = np.concatenate([rest.planned.ravel(), T])
        is_first = not self.at.size
        start = at if is_first else self.unknowns + at - self.at
        self.at = at
        self.cross(rest, start)
        self.unknowns, by_friction = self.balanced(rest, start)
        for _ in range(0 if is_first or self.friction == 0.0 else ROUNDS):
            self.cross(rest, self.unknowns)
            self.slip(self.leg_slopes(rest) @ by_friction, self.leg_lengths(rest) - self.lengths)
            self.unknowns, by_friction = self.balanced(rest, self.unknowns)
        self.lengths = self.leg_lengths(rest)
        return rest.places(self.unknowns)

    def cross(self, rest: Rest, unknowns: Array) -> None:
        """Set what parts do to friction, from the angles at which cables cross."""
        sines = rest.half_chords(unknowns).ravel()[self.legs]
        square = np.mean(sines**2, axis=0)
        clasps = np.arange(len(square))
        for legs, sign in zip(self.legs, (1.0, -1.0), strict=True):
            self.of_parts[legs, clasps, 0] = self.friction * np.sqrt(square)
            self.of_parts[legs, clasps, 1] = sign * self.friction * np.sqrt(1.0 - square)

    def balanced(self, rest: Rest, unknowns: Array) -> tuple[Array, Array]:
        """Return the unknowns in balance, and their derivatives (…, 2 n) by friction."""
        legs = 2 * self.plan.n
        errors = np.zeros(len(rest.errors))
        errors[-legs:] = np.tensordot(self.of_parts, self.parts, 2)
        for _ in range(ITERATIONS):
            by_unknowns, by_errors = self.slopes(rest, unknowns, errors)
            residual = rest.balance(unknowns, errors, rest.bends(unknowns))
            try:
                step = -np.linalg.solve(by_unknowns, np.column_stack([residual, by_errors]))
            except np.linalg.LinAlgError:
                break
            moved = float(np.max(np.abs(step[: rest.planned.size, 0])))
            unknowns = unknowns + step[:, 0] * min(1.0, 0.1 / max(moved, SOLVED))
            if moved <= SOLVED:
                return unknowns, np.asarray(step[:, -legs:])
        return np.full(len(unknowns), np.nan), np.zeros((len(unknowns), legs))

    def slopes(self, rest: Rest, unknowns: Array, errors: Array) -> tuple[Array, Array]:
        """Return derivatives of the balance by unknowns, as bends follow these, and by errors."""
        by_unknowns, by_errors = rest.slopes(unknowns, errors)
        bends = np.maximum(rest.bends(unknowns), STEP)
        by_bends = by_errors[:, -len(bends) :] * errors[-len(bends) :] / bends  # enter as products
        steps = NUDGE * np.eye(len(unknowns))
        changes = [rest.bends(unknowns + x) - rest.bends(unknowns - x) for x in steps]
        return np.asarray(by_unknowns + by_bends @ np.transpose(changes) / (2.0 * NUDGE)), by_errors

    def leg_lengths(self, rest: Rest) -> Array:
        """Return the lengths (2 n,) [m] of legs."""
        return norm(self.leg_vectors(rest))

    def leg_vectors(self, rest: Rest) -> Array:
        """Return the vectors (2 n, 3) [m] along legs."""
        nodes = self.unknowns[: rest.planned.size].reshape(-1, 3)[rest.nodes]
        return np.asarray(np.diff(nodes, axis=1)[:, ::2].reshape(-1, 3))

    def leg_slopes(self, rest: Rest) -> Array:
        """Return the derivatives (2 n, unknowns) of lengths of legs."""
        legs = self.leg_vectors(rest)
        u = legs / np.maximum(norm(legs), STEP)[:, None]
        slopes = np.zeros((len(legs), len(self.unknowns)))
        for leg, (start, end) in enumerate(rest.nodes[:, [0, 1, 2, 3]].reshape(-1, 2)):
            slopes[leg, 3 * start : 3 * start + 3] -= u[leg]
            slopes[leg, 3 * end : 3 * end + 3] += u[leg]
        return slopes

    def slip(self, by_friction: Array, slips: Array) -> None:
        """Change the parts of clasps until slips (2 n,) [m] are normal, by Nesterov's method."""
        B = self.of_parts.reshape(len(slips), -1)
        gain = B.T @ by_friction @ B
        if not np.all(np.isfinite(gain)):
            return
        rate = 1.0 / max(float(np.linalg.norm(gain, 2)), STEP)
        start = old = ahead = self.parts.ravel()
        for k in range(SWEEPS):
            moved = ahead + rate * (B.T @ slips + gain @ (ahead - start))
            discs = moved.reshape(-1, 2)
            new = (discs / np.maximum(norm(discs), 1.0)[:, None]).ravel()
            ahead = new + k / (k + 3.0) * (new - old)
            change, old = float(np.max(np.abs(new - old))), new
            if k and change <= CONVERGED:
                break
        self.parts = old.reshape(-1, 2)


def samples_of(p: Plan, pieces: Items, ends: Sequence[int] = ()) -> Items:
    """Return (samples, 2): pieces and the end at which they are sampled, 0 or -1, in order.

    They include all rests of vertices, and the ends of some pieces; beyond the first start, samples
    are ends.
    """
    c = p.points.c[0]
    speed = np.max(norm(p.points.c[1][pieces][:, p.V, :, -1]), axis=1)
    rests = np.flatnonzero((speed <= AT_REST) | np.isin(pieces, ends))
    chosen = [-1]
    for last in sorted({*rests.tolist(), len(pieces) - 1}):
        run = np.arange(chosen[-1] + 1, last + 1)
        places = c[pieces[run]][:, : p.V.stop]
        way = float(np.max(np.sum(norm(places[..., -1] - places[..., 0]), axis=0)))
        count = max(BETWEEN, math.ceil(way / FARTHEST)) if way > AT_REST else 1
        kept = np.linspace(run[0] - 1, last, count + 1)[1:]
        chosen += np.unique(np.ceil(kept - 1e-9).astype(int)).tolist()
    return np.array([[pieces[0], 0], *([pieces[k], -1] for k in chosen[1:])])


def free_pieces(p: Plan) -> Mask:
    """Return a mask of the pieces with a taut hitch that holds nothing."""
    least = np.min(p.tensions.c[0][:, :, 0], axis=-1)
    taut = np.all(least >= TAUT * p.stated_tension[:, 0], axis=1)
    return np.asarray((p.state == "hitched") & ~np.any(p.held, axis=0) & taut)


def frictions(p: Plan) -> Array:
    """Return frictions of the stated range."""
    stated = p.settings["team"]["cable_friction"]
    least = min(stated) if isinstance(stated, list) else 0.0
    return np.asarray(least + (p.mu - least) * SHARES)


def histories(p: Plan, samples: Items, share: float = 0.0) -> Array:
    """Return the vertices (samples, frictions, P, 3) [m], infinitely far without a balance."""
    sliders = [Slider(p, friction, share) for friction in frictions(p)]
    with np.errstate(all="ignore"):  # forged plans have no balance
        steps = [[slider.move(q, end) for slider in sliders] for q, end in samples.tolist()]
    places = np.array(steps)
    return np.where(np.isfinite(places), places, np.inf)


def widened(x: Array, axes: int) -> Array:
    """Return values plus a share of the largest difference to a neighbour on the first axes."""
    most = np.zeros(x.shape)
    for axis in range(axes):
        with np.errstate(invalid="ignore"):  # of two that are infinitely far
            step = np.nan_to_num(np.abs(np.diff(x, axis=axis)), nan=0.0, posinf=np.inf)
        last = np.zeros_like(x.take([0], axis))
        for ends in ([step, last], [last, step]):
            most = np.maximum(most, np.concatenate(ends, axis))
    return np.asarray(x + MORE * most)


def friction_shifts(p: Plan) -> Iterator[Row]:
    """Yield a row for each phase in which cables slide: how far vertices leave their ways.

    Its limit is the shift for which walls and objects leave room; there is no row without any.
    """
    if not p.n or not p.mu:
        return
    free = free_pieces(p)
    for i in range(len(p.phases)):
        on = p.phase == i
        pieces = np.flatnonzero(on)
        if not len(pieces) or not np.all(free[on]):
            continue
        if np.max(np.ptp(p.legs.c[0][on], axis=(0, -1))) < SLIDE:
            continue
        samples = samples_of(p, pieces)
        corners = p.points.c[0][on][:, p.V]
        ways = np.concatenate([corners[..., 0], corners[-1:, ..., -1]])
        off = np.array([[distances_from(ways, x) for x in y] for y in histories(p, samples)])
        values = list[Worst]()
        for (q, end), x in zip(samples.tolist(), np.max(widened(off, 2), axis=1), strict=True):
            at = float(p.breaks[q - end])
            values += zip(x.tolist(), [at] * len(x), p.labels[p.V], strict=True)
        room, verdict = clear_of_shift(p, max(values)[0], on)
        if room == BIG:
            continue
        row = worst_row("friction_shift", "m", room, values)
        yield row._replace(verdict=verdict) if row.verdict == "proven" else row


def clear_of_shift(p: Plan, shift: float, on: Mask) -> tuple[float, str]:
    """Return the shift [m] for which there is room on pieces, and a verdict.

    Walls and objects leave it where vertices return to their places.
    """
    rooms, verdicts = [BIG], [SAMPLED]
    corners = np.moveaxis(p.points.c[0][on][:, p.V], 2, -1)
    if np.max(norm(corners[-1, :, -1] - corners[0, :, 0])) > RETURN:
        return BIG, SAMPLED
    if p.arena is not None:
        lower, upper = (np.array(p.arena[side]) for side in ("lower", "upper"))
        rooms += [float(np.min(corners - lower)), float(np.min(upper - corners))]
    q = copy(p)
    name, least = p.without_errors().object_limit
    q.object_limit, q.formed = (name, least + shift), p.formed & on
    q = q.proving(frozenset({"object_clearance"}))
    for row in (row for b in range(len(p.bodies)) for row in clear_objects(q, b)):
        if row.samples:
            rooms.append(row.worst - least)
            verdicts.append(SAMPLED if row.verdict == "proven" else row.verdict)
    return min(rooms), max(verdicts)


def rest_shifts(p: Plan) -> Iterator[Row]:
    """Yield how far friction of its range holds vertices from their plan at rest, if limited."""
    stated = [p.limits.get(key) for key in ("rest_shift", "vertex_error")]
    limit = min((x for x in stated if x is not None), default=None)
    if limit is None:
        return
    row = worst_row("rest_shift", "m", limit, [*offsets_at_rests(p)] if p.n and p.mu else ())
    yield row._replace(verdict=SAMPLED) if row.verdict == "proven" else row


def offsets_at_rests(p: Plan) -> Iterator[Worst]:
    """Yield distances from the plan at rests of any duration; the plan's end is one."""
    drift = np.max(np.ptp(p.points.c[0][:, : p.N], axis=-1), axis=(1, 2))
    drift = np.maximum(drift, np.max(np.ptp(p.tensions.c[0], axis=-1), axis=(1, 2)))
    still = drift <= STILL * p.h
    for pieces in runs_of(free_pieces(p)):
        on = np.isin(np.arange(len(still)), pieces)
        ends = {int(run[-1]) for run in runs_of(still & on)} | {len(still) - 1} & {*pieces.tolist()}
        if not ends:
            continue
        samples = samples_of(p, pieces, [*ends])
        for share in (0.0,) if pieces[0] == 0 else (-1.0, 1.0):
            off = histories(p, samples, share) - p.points.c[0][samples[:, 0], p.V, :, -1][:, None]
            for (q, end), x in zip(samples.tolist(), norm(off), strict=True):
                if end and q in ends:
                    radii = np.max(widened(x, 1), axis=0)
                    at = [float(p.breaks[q + 1])] * len(radii)
                    yield from zip(radii.tolist(), at, p.labels[p.V], strict=True)


def distances_from(ways: Array, places: Array) -> Array:
    """Return the distances (P,) [m] of places (P, 3) from polylines (points, P, 3)."""
    start, along = ways[:-1], np.diff(ways, axis=0)
    with np.errstate(invalid="ignore"):  # places may be infinitely far
        share = np.sum((places - start) * along, axis=-1) / np.maximum(norm(along) ** 2, STEP)
        nearest = start + np.clip(share, 0.0, 1.0)[..., None] * along
        off = np.min(norm(places - nearest), axis=0)
    return np.where(np.isfinite(off), off, np.inf)
