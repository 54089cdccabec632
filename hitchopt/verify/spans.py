"""Spans of time with the terms of all formulas, and proofs of limits by halving them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from .arithmetic import (
    BIG,
    TOLERANCE,
    UP,
    Array,
    Index,
    Items,
    Line,
    Mask,
    concatenate,
    maximum,
    minimum,
)
from .parts import Part, stretch, taut_length, taut_part
from .plan import CLASPING, LOOSE, Plan

Names = Sequence[Sequence[str]]
Fault = tuple[float, bool, str]  # time [s], whether it applies, text
Worst = tuple[float, float, str]  # value, time [s], place

MIN_TENSION = 1e-3  # [N] smallest divisor of forces
RESOLUTION = 1e-3  # resolution of worst values, relative to limits
ROW_EFFORT = 20_000_000  # effort of the proof of a limit
PER_FIRST = 30  # more of it for that of its first pass, over whole pieces
PER_SAMPLE = 16  # effort of a sample, besides that of the values that it reads
CHUNK = 8192  # samples at once
DEPTH = 46  # halvings
SAMPLED = "at samples"  # verdict on values that are not bounded between samples
NOTHING = "nothing to check"  # verdict on a limit of which there are no values


class Row(NamedTuple):
    """Verdict on a limit: the worst sampled value, its time [s] and place.

    ``with_errors`` is the worst value as tracking errors may change it; nan if they do not.
    """

    name: str
    unit: str
    verdict: str
    worst: float
    limit: float
    sense: str
    time: float
    where: str
    samples: int
    with_errors: float = math.nan

    @property
    def excess(self) -> float:
        """Return the excess of the worst value over its limit, relative or over a limit of 0."""
        sign = 1.0 if self.sense == "max" else -1.0
        return sign * (self.worst - self.limit) / abs(self.limit or 1.0)


class Spans:
    """Spans of time with items (m, c): piece (m,), relative midpoint x (m,) and half width w (m,).

    ``names`` are lists of names for each column of items; ``moving`` is 0 before and after a plan,
    at rest, else 1. Methods are terms of formulas, for drones i, vertices j, cables k and bodies b
    (m,).
    """

    def __init__(
        self, plan: Plan, piece: Items, item: Items, x: Array, w: Array, names: Names = ()
    ) -> None:
        self.plan, self.piece, self.item, self.x, self.w = plan, piece, item, x, w
        self.effort = plan.effort
        self.t = np.maximum(w * plan.h[piece], 1e-12)
        self.names = names
        self.moving = 1.0 + 0.0 * x
        self._weights = dict[int, Array]()
        self.zero = Line(0.0 * x[:, None], 0.0 * x[:, None], 0.0 * x, self.t)
        self.time = plan.breaks[piece] + x * plan.h[piece]

    @classmethod
    def of(cls, plan: Plan, on: Mask, items: Any, *names: Sequence[str]) -> Spans:
        """Return whole pieces with items (k,) or (k, c), for a mask (m,) or (m, k)."""
        items = np.array(items, dtype=int)
        items = items[:, None] if items.ndim == 1 else items
        piece, k = np.nonzero(np.broadcast_to(on.reshape(len(on), -1), (len(on), len(items))))
        half = np.full(len(k), 0.5)
        return cls(plan, piece, items[k], half, half, names)

    def weights(self, n: int) -> Array:
        """Return Bernstein polynomials of degree n at midpoints (m, n + 1)."""
        if n not in self._weights:
            x = self.x[:, None]
            j = np.arange(n + 1)
            binomials = np.array([math.comb(n, k) for k in j.tolist()], dtype=float)
            self._weights[n] = binomials * x**j * (1.0 - x) ** (n - j)
        return self._weights[n]

    def select(self, k: Any) -> Spans:
        """Return selected spans."""
        return Spans(self.plan, self.piece[k], self.item[k], self.x[k], self.w[k], self.names)

    def subspan(self, middle: Array | float, width: float = 0.0) -> Spans:
        """Return parts of spans: midpoint and half width are relative to the half width."""
        x = self.x + middle * self.w
        w = width * self.w
        return Spans(self.plan, self.piece, self.item, x, w, self.names)

    def point(self, i: Index, k: int = 0) -> Line:
        """Return k-th derivatives of points."""
        return self.plan.points.on(self, i, k)

    def edge(self, k: Index) -> list[Line]:
        """Return edge vectors at ``p_k`` and at ``p_{k+1}``."""
        a, b, c, d = (self.point(i) for i in self.plan.edges[:, k])
        return [b - a, d - c]

    def leg(self, i: Index) -> Line:
        """Return legs from their inner ends; zero at the ends of a chain."""
        return self.point(i) - self.point(self.plan.anchor[i])

    def ends(self, k: Index, b: int = -1) -> list[Line]:
        """Return both drones of cables in the frame of body b."""
        return [self.local(b, self.point(2 * k + end)) for end in (0, 1)]

    def level_chord(self, k: Index) -> list[Line]:
        """Return both drones of cables in the horizontal plane."""
        return [x[:2] for x in self.ends(k)]

    def sheet(self, k: Index) -> list[Line]:
        """Return both ends of hanging cables, and places below which no part of them is."""
        q, r = self.ends(k)
        return [q, r, (q + r - UP * self.plan.length[k]) * 0.5]

    def hull(self, k: Index, b: int = -1) -> list[Line]:
        """Return corners of vertical regions that contain clasped, tightened or loose cables.

        In plan view they span the hull of the chord and of the route over the middles of turning
        pairs, or over the vertices, and over the vertices of the hitch before or after.
        """
        p = self.plan
        ends = []
        turning = p.state[self.piece] == CLASPING
        for vertex in (p.begin[k], p.end[k]):
            one, other = p.pairs[vertex - p.N].T
            middle = (self.point(one) + self.point(other)) * 0.5
            clasp = middle.where(turning) + self.point(vertex).where(~turning)
            tied = p.tied_vertices[self.piece, vertex - p.N]
            taut = (self.zero + tied).where(p.tied[self.piece]) + clasp.where(~p.tied[self.piece])
            ends.append([self.local(b, clasp), self.local(b, taut)])
        (a, c), (d, e) = ends
        q, r = self.ends(k, b)
        loose = p.state[self.piece] == LOOSE
        depth = np.where(loose[:, None], self.hanging_depth(k), 0.5 * p.length[k])
        return [q, a, c, e, d, r, (q + r) * 0.5 - UP * depth]

    def hanging_depth(self, k: Index) -> Array:
        """Return how far cables hang at most below the middle of their ends (m, 1) [m].

        They are in an ellipsoid of revolution about both ends.
        """
        level = self.q_to_r(k)[:2].norm().low[:, None]
        squares = self.plan.length[k] ** 2 - np.maximum(level, 0.0) ** 2
        return np.asarray(0.5 * np.sqrt(np.maximum(squares, 0.0)))

    def near_hulls(self, k: Index, x: Line, reach: float) -> Spans:
        """Return the spans on which points may be within a horizontal reach of cables' hulls."""
        if not len(self.x):
            return self
        q, *corners = (corner[:2] for corner in self.hull(k)[:-1])
        size = np.max([(corner - q).norm().high for corner in corners], axis=0)
        return self.select((x[:2] - q).norm().low < reach + size)

    def segment(self, j: Index, b: int = -1) -> list[Line]:
        """Return both ends of straight segments of taut cables in the frame of body b."""
        return [self.local(b, self.point(self.plan.segments[j, end])) for end in (0, 1)]

    def q_to_r(self, k: Index) -> Line:
        """Return vectors from q to r of cables."""
        return self.point(2 * k + 1) - self.point(2 * k)

    def route_length(self, k: Index) -> Line:
        """Return lengths of cables along their vertices."""
        parts = self.leg(2 * k), self.leg(2 * k + 1), *self.edge(k)
        return sum((x.norm() for x in parts), self.zero)

    def leg_chord(self, i: Index) -> Line:
        """Return legs to drones; at the ends of a chain, edges to drones."""
        return self.point(i) - self.point(self.plan.pull_point[i])

    def tautness(self, k: Index) -> Line:
        """Return the tautness τ of cables: ``T / T_stated``, at most 1."""
        ratio = self.plan.tensions.on(self, k) * (1.0 / self.plan.min_tension[self.piece, k])
        return minimum(ratio, 1.0).where(self.plan.pulling[self.piece])

    def weight_ratio(self, T: Line, k: Index) -> Line | None:
        """Return ``τ ρ g / T`` of parts of cables k of tension T [1/m]; None without weight."""
        p = self.plan
        if p.weight == 0.0:
            return None
        of_edge = p.tensions.on(self, k)
        ratio = maximum(of_edge, p.min_tension[self.piece, k]).inverse() * p.weight
        if p.frictional:
            ratio = ratio * maximum(of_edge, MIN_TENSION) * maximum(T, MIN_TENSION).inverse()
        return ratio

    def leg_part(self, i: Index) -> Part:
        """Return the parts of cables that pull drones, from the clasp to the drone."""
        T = self.plan.pulls.on(self, i)
        return taut_part(self.leg_chord(i), T, self.weight_ratio(T, i // 2))

    def leg_length(self, i: Index) -> Line:
        """Return lengths of legs along the cable; zero at the ends of a chain."""
        return taut_length(self.leg(i), self.weight_ratio(self.plan.pulls.on(self, i), i // 2))

    def edge_part(self, k: Index, *, from_end: bool = False) -> Part:
        """Return edges from their start, or from their end, at which they have their tension."""
        p = self.plan
        T = p.tensions.on(self, k)
        ratio = self.weight_ratio(T, k)
        if p.has_contacts:
            leaving, arriving = self.edge(k)
            length, pull = self.level_pull(k)
            mean = (-arriving if from_end else leaving).unit() * pull
            return Part(length, mean, T * 0.0 if ratio is None else T * ratio * length * 0.5)
        chord = self.point(p.end[k]) - self.point(p.begin[k])
        return taut_part(-chord if from_end else chord, T, ratio)

    def level_pull(self, k: Index) -> tuple[Line, Line]:
        """Return full lengths l of level edges, and the level part of their tension.

        It is ``√(T² - (w l / 2)²)``, and lengths include arcs around objects.
        """
        T = self.plan.tensions.on(self, k)
        ratio = self.weight_ratio(T, k)
        length = -(self.leg_length(2 * k) + self.leg_length(2 * k + 1)) + self.plan.length[k]
        if ratio is None:
            return length, T
        half = ratio * length * 0.5
        share = (half * half).map(lambda x: np.sqrt(1.0 - x), lambda x: -0.5 / np.sqrt(1.0 - x))
        return length, T * share

    def edge_length(self, k: Index) -> Line:
        """Return lengths of edges along the cable, without arcs around objects.

        Those of a chain may slope: the first one has its tension at its end, its only clasp. Parts
        of an edge beside an arc sag as one level edge between them does.
        """
        p = self.plan
        ratio = self.weight_ratio(p.tensions.on(self, k), k)
        if p.has_contacts:
            leaving, arriving = self.edge(k)
            straight = leaving.norm() + arriving.norm()
            return straight if ratio is None else straight * stretch(leaving + arriving, ratio)
        sense = 1.0 if p.closed else np.where(np.equal(k, 0), -1.0, 1.0)[..., None]
        chord = (self.point(p.end[k]) - self.point(p.begin[k])) * sense
        return taut_length(chord, ratio)

    def local(self, b: int, x: Line) -> Line:
        """Return points in the frame of body b; -1 is the world."""
        return x if b < 0 else self.rotated(b, x - self.plan.poses.on(self, b)[:3])

    def rotated(self, b: int, x: Line) -> Line:
        """Return vectors in axes that turn with body b."""
        pose = self.plan.poses.on(self, b)
        c, r = pose[3], pose[4]
        return concatenate(x[0] * c + x[1] * r, x[1] * c - x[0] * r, x[2])

    def world(self, b: int, x: Array, k: int = 0) -> Line:
        """Return the k-th derivative of the world position of a point x (3,) of body b."""
        pose = self.plan.poses.on(self, b, k)
        up = float(x[2]) * (k == 0)
        c, r = pose[3], pose[4]
        return pose[:3] + concatenate(c * x[0] - r * x[1], r * x[0] + c * x[1], self.zero + up)


def prove(header: str, limit: float, s: Spans, formula: Callable[..., Line]) -> Row:
    """Halve spans until a limit is proven on all of them and the worst value is resolved.

    It is not proven if that takes more than the limit's effort, or than that of all proofs.
    ``header`` is the name, the unit, and the sense min or max of the limit. The formula takes spans
    and the columns of their items.
    """
    name, unit, sense = header.split()
    if s.plan.only and name not in s.plan.only:
        return Row(name, unit, "not proven", math.nan, limit, sense, math.nan, "", samples=0)
    sign = 1.0 if sense == "min" else -1.0
    target = sign * limit - TOLERANCE * max(abs(limit), s.plan.size if unit == "m" else 0.0)
    worst = math.inf
    time = 0.0
    where = ""
    verdict = "proven"
    samples = 0
    depth = 0
    effort = s.effort
    start = s.effort.spent
    granted = ROW_EFFORT
    while len(s.x):
        bounds = []
        for part in (s.select(slice(i, i + CHUNK)) for i in range(0, len(s.x), CHUNK)):
            with np.errstate(all="ignore"):
                x = formula(part, *part.item.T) * sign
            bounds.append(np.nan_to_num(x.low, nan=-BIG))
            value = np.nan_to_num(x.v[:, 0], nan=-BIG)
            i = int(np.argmin(value))
            if value[i] < worst:
                worst = float(value[i])
                time = float(part.time[i])
                where = ", ".join(s.names[c][k] for c, k in enumerate(part.item[i]))
        bound = np.concatenate(bounds)
        depth = depth + 1
        samples = samples + len(s.x)
        undecided = bound < target
        error = max(RESOLUTION * max(abs(limit), 1e-3), 0.02 * (worst - target))
        effort.spent += PER_SAMPLE * len(s.x)
        spent = effort.spent - start
        if depth == 1:
            granted += PER_FIRST * spent
            effort.allowed += PER_FIRST * spent
        exhausted = spent > granted or effort.spent > effort.allowed or depth > DEPTH
        if worst < target or (np.any(undecided) and exhausted):
            verdict = "violated" if worst < target else "not proven"
            break
        s = s.select(undecided | ((bound < worst - error) & (3 * spent < granted)))
        s = s.select(np.repeat(np.arange(len(s.x)), 2)).subspan(np.tile([-0.5, 0.5], len(s.x)), 0.5)
    return Row(name, unit, verdict, sign * worst, limit, sense, time, where, samples)


def nothing_row(header: str, limit: float) -> Row:
    """Return the row of a limit of which there are no values; ``header`` is that of ``prove``."""
    name, unit, sense = header.split()
    return Row(name, unit, NOTHING, math.nan, limit, sense, math.nan, "", samples=0)


def worst_row(name: str, unit: str, limit: float, values: Sequence[Worst]) -> Row:
    """Return a row of the largest of values with times and places; nan is infinite."""
    if not values:
        return nothing_row(f"{name} {unit} max", limit)
    worst, time, where = max((BIG if math.isnan(x) else x, t, at) for x, t, at in values)
    verdict = "proven" if worst <= limit + TOLERANCE * max(abs(limit), 1.0) else "violated"
    return Row(name, unit, verdict, worst, limit, "max", time, where, 1)


def fault_row(name: str, faults: Iterable[Fault]) -> Row:
    """Return a row of faults: the number of kinds, the first time, and texts."""
    wrong = sorted((time, text) for time, applies, text in faults if applies)
    kinds = [*dict.fromkeys(text for _, text in wrong)]
    first = wrong[0][0] if wrong else 0.0
    return worst_row(name, "1", 0.0, [(float(len(kinds)), first, ", ".join(kinds[:6]))])
