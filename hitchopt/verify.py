"""Independent verification of a plan: proofs of all limits from ``plan.npz`` by samples and rates.

``python verify.py DIR`` needs only numpy. The file format is that of docs/reference/files.md.
Neither code nor method is shared with hitchopt, whose certificate encloses quantities by Bernstein
coefficients. Here a quantity is computed at the midpoint of a time span, and its rate of change is
bounded: with a slope g at the midpoint, slopes within q of g on the span, and half the duration t
of the span, the quantity stays within ``(|g| + q) t`` of its value at the midpoint. For a
polynomial, q is t times the largest coefficient of its second derivative; sums, products, norms and
directions follow from the chain rule (class ``Line``). Spans are halved until the limit is proven
on all of them (``proven``), violated at a sample (``violated``), or the budget is exhausted (``not
proven``).

Rounding: a polynomial has an error of ``2**-48`` of its coordinates, its k-th derivative one of
``2**-48 2^k N!/(N-k)! / h^k`` of its largest difference of consecutive coefficients (degree N,
duration h of a piece). As in the certificate, the tolerance of a limit is 1e-9 of the largest of
itself and the coordinates. With ``limits.tracking``, distances are larger by the effect of tracking
errors of all drones. Excluded are ``stoppable`` and ``survivable``, and the tracking radius unless
it is limited.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from itertools import chain, combinations, groupby, pairwise, product, repeat
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Items = NDArray[np.intp]
Index = Items | int
Names = Sequence[Sequence[str]]
Mask = NDArray[np.bool_]
Fault = tuple[float, bool, str]  # time [s], whether it is present, words
Worst = tuple[float, float, str]  # value, time [s], place

G, UP = 9.81, np.array([0.0, 0.0, 1.0])
BIG, TINY = 1e30, 1e-300
TOLERANCE, RESOLUTION = 1e-9, 1e-3  # of limits, and of worst values, relative to limits
REST, TOUCH, CONTACT, WRAP = 1e-9, 1e-6, 1e-4, 2e-5  # [m] tolerances of the file format
MIN_GAP = 1e-4  # [m] smallest distance of cables that cannot pass through each other
OPEN_ROLL = 175.0  # [deg] smallest roll of an open clasp: at 180° cables run straight
MIN_TENSION = 1e-3  # [N] smallest divisor of forces
NEAR, LINKS = 0.5, 96  # [m] range of exact distances to hanging cables; links of a hanging cable
DEGREES = math.degrees(1.0)
BUDGET, CHUNK, DEPTH = 6_000_000, 8192, 46  # samples of a limit, samples at once, halvings
GOOD = {"proven", "warning"}  # the ground is unknown without an arena, hence warnings
CROSSINGS = {"on the ground": 0, "hanging free": 0, "being tightened": 1, "hitched": 1}
LAID, ROLLING = "being laid", "rolling"  # single taut cables; pairs between crossing and clasp
LYING, UNTIED = "lying across", {"on the ground", "hanging free"}  # weight is transferred; no ties
STATES = {*CROSSINGS, "clasping", LAID, ROLLING, LYING, "none"}
POSITIVE = ("mass", "max_thrust", "cable_length", "tension")
MAX_COEFFS = 61  # coefficients of a curve
SAG_TOL = 0.02  # [m] largest gap of cables that lie on each other, due to different sags


# Keys of settings and their forms: * optional, ? may be null, [] is a list, [2] a list of two.
FORMS = {
    "settings": "title:text team:any limits:limits separation:separation arena:arena? asked:any "
    "keep_out:prism[] phases:any[] objects:any* problem:text* assignment:roles* control:flag* "
    "controllers:named?[]* leg_tensions:flag* poses:flag* borne:flag* contacts:flag*",
    "several": "title:text problem:text* teams:any others:any asked:groups",
    "groups": "teams:text[] others:any",
    "other": "plan:text at:number digest:text",
    "team": "robots:count topology:text cable_density:0+ cable_friction:0+ load:0+[]",
    "single": "drones:count",
    "limits": "speed:+ acceleration:+ jerk:+ tilt:+ body_rate:+? vertex_speed:+ leg:+ duration:+? "
    "reserve:+ tracking:+*",
    "separation": "radius:+ height:+ cable:0+ crossing:0+ object:0+",
    "arena": "lower:number[3] upper:number[3]",
    "prism": "polygon:number[2][] lower:number upper:number",
    "phase": "name:text step:count remark:text start:number end:number state:text tension:+[2]? "
    "hold:hold?",
    "hold": "object:text by:text cables:count[]",
    "named": "controller:text gains:gains?",
    "gains": "kp:+[2]? kd:+[2]? ki:0+[2]?",
    "roles": "robots:count[] flipped:flag[]",
    "body": "section:section lower:number upper:number mass:+ friction:0+ at:number[3] yaw:number "
    "rim:rim? fixed:flag",
    "section": "outline:number[2][]? radius:+?",
    "rim": "section:section height:number",
}
FORMS["member"] = f"{FORMS['phase']} ring:count[] waiting:any[2][]"  # if robots join and leave
KINDS: dict[str, Callable[[Any], bool]] = {
    "text": lambda x: type(x) is str,
    "flag": lambda x: type(x) is bool,
    "count": lambda x: type(x) is int and 0 <= x < 2**31,
    "number": lambda x: type(x) in (int, float) and abs(x) < BIG,
    "+": lambda x: KINDS["number"](x) and x > 0,
    "0+": lambda x: KINDS["number"](x) and x >= 0,
    "any": lambda _: True,
}
DEFAULTS = {"stiffness": math.inf, "integral": 0.0, "feed_forward": 1.0}  # of controllers


class Row(NamedTuple):
    """Verdict on a limit: the worst sampled value, its time [s] and place."""

    name: str
    unit: str
    verdict: str
    worst: float
    limit: float
    sense: str
    time: float
    where: str
    samples: int


class UnreadableError(Exception):
    """The file is not a plan."""


def check_form(key: str, x: Any, form: str) -> None:
    """Raise ValueError with the key of a setting that does not have a form."""
    if x is None and "?" in form:
        return
    kind = form.rstrip("?*")
    each, _, count = kind.rstrip("]").rpartition("[")
    if kind in FORMS and isinstance(x, dict):
        forms = dict(entry.split(":") for entry in FORMS[kind].split())
        for name in forms | x:
            given, left_out = forms.get(name, ""), "*" in forms.get(name, "")
            if given and name in x and (x[name] or not left_out):
                check_form(f"{key}.{name}", x[name], given)
            elif name in x or not left_out:
                raise ValueError(f"{key}.{name} is left out, empty, or unknown")
    elif each and isinstance(x, list) and count in ("", str(len(x))):
        for i, y in enumerate(x):
            check_form(f"{key}[{i}]", y, each)
    elif kind not in KINDS or not KINDS[kind](x):
        raise ValueError(f"{key} is {x!r:.60}, not of the form {form}")


class Line:
    """Vectors (m, d) on m spans of time, scalars as (m, 1), with bounds.

    ``v`` and ``g`` are value and slope at midpoints; ``q`` (m,) bounds the deviation of slopes from
    g on a span, and ``t`` (m,) is half of its duration [s]. Derived bounds: ``rate`` (m,) of
    slopes, ``reach`` (m,) of the deviation from v, ``low`` and ``high`` (m,) of scalars. Operands
    may also be constants: numbers, vectors (d,), or columns (m, d).
    """

    def __init__(self, v: Array, g: Array, q: Array, t: Array) -> None:
        self.v, self.g, self.q, self.t = v, g, q, t
        self.rate = length(g) + q
        self.reach = self.rate * t
        self.low, self.high = v[:, 0] - self.reach, v[:, 0] + self.reach

    def __getitem__(self, k: int | slice) -> Line:
        k = slice(k, k + 1) if isinstance(k, int) else k
        return Line(self.v[:, k], self.g[:, k], self.q, self.t)

    def as_line(self, o: Line | Array | float) -> Line:
        """Return a constant as a Line."""
        if isinstance(o, Line):
            return o
        v = np.atleast_2d(o) + np.zeros((len(self.t), 1))
        return Line(v, 0.0 * v, np.zeros(len(v)), self.t)

    def __add__(self, o: Line | Array | float) -> Line:
        o = self.as_line(o)
        return Line(self.v + o.v, self.g + o.g, self.q + o.q, self.t)

    def __neg__(self) -> Line:
        return Line(-self.v, -self.g, self.q, self.t)

    def __sub__(self, o: Line | Array | float) -> Line:
        return self + -o

    def __mul__(self, o: Line | Array | float) -> Line:
        return self._product(np.multiply, self.as_line(o))

    def dot(self, o: Line | Array) -> Line:
        """Scalar product."""
        return self._product(lambda x, y: np.sum(x * y, -1, keepdims=True), self.as_line(o))

    def cross(self, o: Line) -> Line:
        """Vector product."""
        return self._product(np.cross, o)

    def _product(self, f: Callable[[Array, Array], Array], o: Line) -> Line:
        """``(x y)' = x' y + x y'``, with deviations of slopes and factors from midpoints."""
        q = self.q * (length(o.v) + o.reach) + length(self.g) * o.reach
        q = q + o.q * (length(self.v) + self.reach) + length(o.g) * self.reach
        return Line(f(self.v, o.v), f(self.g, o.v) + f(self.v, o.g), q, self.t)

    def norm(self) -> Line:
        """``|y|' = û·y'``, where û deviates by at most ``reach / min |y|``."""
        n, u = length(self.v), direction(self.v)
        known = n > self.reach
        g = np.sum(u * self.g, -1, keepdims=True) * known[:, None]
        q = np.where(known, self.q + length(self.g) * self.reach / (n - self.reach), self.rate)
        return Line(n[:, None], g, q, self.t)

    def unit(self) -> Line:
        """Directions; nan if vectors may vanish."""
        return self * self.norm().inverse()

    def map(self, f: Callable[[Array], Array], df: Callable[[Array], Array]) -> Line:
        """Apply a function with a monotone derivative to a non-negative scalar."""
        slope, ends = df(self.v), df(np.stack([np.maximum(self.low, 0.0), self.high]))
        q = np.max(np.abs(ends - slope[:, 0]), 0) * length(self.g)
        q = np.max(np.abs(ends), 0) * self.q + q
        return Line(f(self.v), slope * self.g, q, self.t)

    def inverse(self) -> Line:
        """``1 / f`` of a positive scalar."""
        return self.map(lambda x: 1.0 / x, lambda x: -1.0 / x**2)

    def where(self, on: Mask) -> Line:
        """Return zero outside a mask (m,)."""
        v, g = (np.where(on[:, None], x, 0.0) for x in (self.v, self.g))
        return Line(v, g, np.where(on, self.q, 0.0), self.t)


def length(v: Array) -> Array:
    """Return lengths of vectors."""
    return np.asarray(np.linalg.norm(v, axis=-1))


def direction(v: Array) -> Array:
    """Return unit vectors; zero for zero vectors."""
    return v / np.maximum(length(v), TINY)[..., None]


def varies(c: Array, most: Array | float = TOUCH) -> bool:
    """Return whether any polynomial (pieces, ..., N + 1) varies by more than a tolerance."""
    return c.size > 0 and bool(np.any(np.ptp(c, axis=(0, -1)) > most))


def joined(*parts: Line) -> Line:
    """Return a vector from components."""
    v, g = (np.concatenate([getattr(p, k) for p in parts], axis=1) for k in "vg")
    return Line(v, g, np.sqrt(sum(p.q**2 for p in parts)), parts[0].t)


def minimum(first: Line, *others: Line | Array | float) -> Line:
    """Return the minimum of scalars; with a slope if it is the same scalar on the span."""
    lines = [first, *map(first.as_line, others)]
    keys = "v", "g", "q", "rate", "low", "high"
    v, g, q, rate, low, high = (np.stack([getattr(x, k) for x in lines]) for k in keys)
    at = np.argmin(v[..., 0], axis=0), np.arange(len(first.t))
    may = ~(low > high[at])
    alone = np.sum(may, axis=0) == 1
    q = np.where(alone, q[at], np.max(np.where(may, rate, 0.0), axis=0))
    return Line(v[at], g[at] * alone[:, None], q, first.t)


def maximum(first: Line, *others: Line | Array | float) -> Line:
    """Return the maximum of scalars."""
    return -minimum(-first, *(-x for x in others))


def angle(a: Line, b: Line) -> Line:
    """Angle between vectors [rad]: ``2 arcsin(|â - b̂| / 2)``."""
    chord = (a.unit() - b.unit()).norm()
    return chord.map(lambda x: 2.0 * np.arcsin(x / 2.0), lambda x: 1.0 / np.sqrt(1.0 - x**2 / 4.0))


class Curve:
    """Bernstein polynomials (pieces, items, d, N + 1) on pieces of h seconds, and derivatives."""

    def __init__(self, c: Array, h: Array) -> None:
        max_step = np.max(np.abs(np.diff(c, axis=-1)), axis=(2, 3), initial=0.0)
        noise = 2.0**-48 * np.max(np.abs(c), axis=(2, 3), initial=0.0)
        self.c, self.noise, N = [c], [noise], c.shape[-1] - 1
        for k in range(1, 6):
            n = N + 1 - k
            rise = np.diff(self.c[-1], axis=-1) if n > 0 else 0.0 * self.c[-1]
            self.c.append(rise * (n / h)[:, None, None, None])
            self.noise.append(2.0 ** (k - 48) * math.perm(N, k) / h[:, None] ** k * max_step)
        self.most = [np.max(np.linalg.norm(x, axis=2), axis=-1, initial=0.0) for x in self.c]

    def at(self, s: Spans, i: Index, k: int = 0) -> Array:
        """Return k-th derivatives (m, d) of items i (m,) at midpoints."""
        c, x = self.c[k][s.piece, i], s.x[:, None]
        n = c.shape[-1] - 1
        weights = [math.comb(n, j) * x**j * (1.0 - x) ** (n - j) for j in range(n + 1)]
        return np.asarray(np.einsum("mdj,mj->md", c, np.hstack(weights)))

    def on(self, s: Spans, i: Index, k: int = 0) -> Line:
        """Return k-th derivatives of items i (m,) on spans."""
        q = self.most[k + 2][s.piece, i] * s.t * s.moves + self.noise[k][s.piece, i] / s.t
        return Line(self.at(s, i, k), self.at(s, i, k + 1) * np.c_[s.moves], q, s.t)


class Spans:
    """Spans of time with items (m, c): piece (m,), relative midpoint x (m,) and half width w (m,).

    ``names`` are lists of names for each column of items. Methods are terms of formulas, for drones
    i, vertices j, cables k and bodies b (m,).
    """

    def __init__(
        self, plan: Plan, piece: Items, item: Items, x: Array, w: Array, names: Names = ()
    ) -> None:
        self.plan, self.piece, self.item, self.x, self.w = plan, piece, item, x, w
        self.t, self.names = np.maximum(w * plan.h[piece], 1e-12), names
        self.moves: Array | float = 1.0  # 0 before and after a plan, when it rests
        self.zero = Line(0.0 * x[:, None], 0.0 * x[:, None], 0.0 * x, self.t)
        self.time = plan.breaks[piece] + x * plan.h[piece]

    def select(self, k: Any) -> Spans:
        """Return selected spans."""
        return Spans(self.plan, self.piece[k], self.item[k], self.x[k], self.w[k], self.names)

    def within(self, share: Array | float, width: float = 0.0) -> Spans:
        """Return parts of spans: midpoint and half width are relative to the half width."""
        x, w = self.x + share * self.w, width * self.w
        return Spans(self.plan, self.piece, self.item, x, w, self.names)

    def point(self, i: Index, k: int = 0) -> Line:
        """Return k-th derivatives of points."""
        return self.plan.points.on(self, i, k)

    def edge(self, k: Index) -> list[Line]:
        """Edge vectors at ``p_k`` and at ``p_{k+1}``."""
        a, b, c, d = (self.point(i) for i in self.plan.edges[:, k])
        return [b - a, d - c]

    def leg(self, i: Index) -> Line:
        """Legs from their own vertices; zero at the ends of a chain."""
        return self.point(i) - self.point(self.plan.anchor[i])

    def ends(self, k: Index, b: int = -1) -> list[Line]:
        """Both drones of cables in the frame of body b."""
        return [self.local(b, self.point(2 * k + end)) for end in (0, 1)]

    def chord(self, k: Index) -> list[Line]:
        """Both drones of cables seen from above."""
        return [x[:2] for x in self.ends(k)]

    def sheet(self, k: Index) -> list[Line]:
        """Corners of upright sheets that contain hanging cables."""
        q, r = self.ends(k)
        return [q, r, (q + r - UP * self.plan.length[k]) * 0.5]

    def strip(self, k: Index) -> list[Line]:
        """Corners of upright strips below chords that contain laid cables.

        A cable is at most ``½ √(L² - c²) c / s`` below a chord c of level length s.
        """
        q, r = self.ends(k)
        short = 1.0 - self.plan.sag[k] - 1e-4  # chords over lengths, at least
        deep = (r - q).norm() * (r - q)[:2].norm().inverse() * self.plan.length[k]
        deep = deep * (0.5 * np.sqrt(1.0 - short**2))
        return [q, r, q - deep * UP, r - deep * UP]

    def part(self, j: Index, b: int = -1) -> list[Line]:
        """Both ends of straight parts of taut cables in the frame of body b."""
        return [self.local(b, self.point(self.plan.parts[j, end])) for end in (0, 1)]

    def across(self, k: Index) -> Line:
        """Return vectors from q to r of cables."""
        return self.point(2 * k + 1) - self.point(2 * k)

    def around(self, k: Index) -> Line:
        """Lengths of cables' routes via their vertices."""
        ways = self.leg(2 * k), self.leg(2 * k + 1), *self.edge(k)
        return sum((x.norm() for x in ways), self.zero)

    def leg_chord(self, i: Index) -> Line:
        """Return legs to drones; at the ends of a chain, edges to drones."""
        return self.point(i) - self.point(self.plan.pull_point[i])

    def taut(self, k: Index) -> Line:
        """Return the tautness τ of cables: ``T / T_stated``, at most 1."""
        share = self.plan.tensions.on(self, k) * (1.0 / self.plan.least[self.piece, k])
        return minimum(share, 1.0).where(self.plan.formed[self.piece])

    def inverse_tension(self, T: Line, k: Index) -> Line:
        """Return ``τ / T`` of parts of cables k of tension T."""
        ratio = maximum(self.plan.tensions.on(self, k), self.plan.least[self.piece, k]).inverse()
        if not self.plan.slid:
            return ratio
        taut = self.taut(k).low >= 1.0  # by friction, of taut cables alone
        return ratio.where(~taut) + maximum(T, MIN_TENSION).inverse().where(taut)

    def level_pull(self, T: Line, k: Index, square: Line) -> Line:
        """``√(T² - (w/2)² cos² γ)``: pull of level parts of cables k with a tension T.

        ``square`` is the square of the level length, and w the weight with ``τ ρ g`` per length.
        """
        if self.plan.weight == 0.0:
            return T
        half = self.inverse_tension(T, k) * (0.5 * self.plan.weight)
        rest = square * half * half
        return T * rest.map(lambda x: np.sqrt(1.0 - x), lambda x: -0.5 / np.sqrt(1.0 - x))

    def pull(self, i: Index) -> Line:
        """``P = (w/2) sin γ + √(T² - (w/2)² cos² γ)``: pull of legs along their chords."""
        way, k = self.leg_chord(i), i // 2
        rise = way[2] * self.taut(k) * (0.5 * self.plan.weight)
        return self.level_pull(self.plan.pulls.on(self, i), k, way[:2].dot(way[:2])) + rise

    def edge_pull(self, k: Index) -> Line:
        """Return the pull of edges; edges around objects have their full length, arcs included."""
        way = (self.point(self.plan.end[k]) - self.point(self.plan.begin[k]))[:2]
        if self.plan.bent:
            way = -(self.leg(2 * k).norm() + self.leg(2 * k + 1).norm()) + self.plan.length[k]
        return self.level_pull(self.plan.tensions.on(self, k), k, way.dot(way))

    def thrust(self, i: Index) -> Line:
        """``m (a + g ẑ) + P û + ½ ρ g d τ ẑ - (1 - τ) w`` (w: the pull of the hanging cable)."""
        p, found = self.plan, (self.point(i, 2) + G * UP) * self.plan.mass[i]
        if p.n:
            leg, tau = self.leg_chord(i), self.taut(i // 2)
            taut = leg.unit() * self.pull(i) + leg.norm() * tau * (0.5 * p.weight) * UP
            found = found + taut.where(p.formed[self.piece])
            if p.weight > 0.0 and np.any(tau.low < 1.0):
                loose = -tau + 1.0
                hung = hanging_pull(self, i) * loose * p.weight
                found = found - hung.where(loose.high > TOLERANCE)
        return found

    def local(self, b: int, x: Line) -> Line:
        """Points in the frame of body b; -1 is the world."""
        return x if b < 0 else self.rotated(b, x - self.plan.poses.on(self, b)[:3])

    def rotated(self, b: int, x: Line) -> Line:
        """Vectors rotated into the heading of body b."""
        pose = self.plan.poses.on(self, b)
        c, r = pose[3], pose[4]
        return joined(x[0] * c + x[1] * r, x[1] * c - x[0] * r, x[2])

    def world(self, b: int, x: Array, k: int = 0) -> Line:
        """Return the k-th derivative of the world position of a point x (3,) of body b."""
        pose, up = self.plan.poses.on(self, b, k), float(x[2]) * (k == 0)
        c, r = pose[3], pose[4]
        return pose[:3] + joined(c * x[0] - r * x[1], r * x[0] + c * x[1], self.zero + up)


def prove(what: str, limit: float, s: Spans, formula: Callable[..., Line]) -> Row:
    """Halve spans until a limit is proven on all of them and the worst value is resolved.

    ``what`` is the name, the unit, and the sense min or max of the limit. The formula takes spans
    and the columns of their items.
    """
    name, unit, sense = what.split()
    sign = 1.0 if sense == "min" else -1.0
    goal = sign * limit - TOLERANCE * max(abs(limit), s.plan.size if unit == "m" else 0.0)
    best, time, where, verdict, spent, depth = math.inf, 0.0, "", "proven", 0, 0
    while len(s.x):
        bounds = []
        for part in (s.select(slice(i, i + CHUNK)) for i in range(0, len(s.x), CHUNK)):
            with np.errstate(all="ignore"):
                x = formula(part, *part.item.T) * sign
            bounds.append(np.nan_to_num(x.low, nan=-BIG))
            value = np.nan_to_num(x.v[:, 0], nan=-BIG)
            i = int(np.argmin(value))
            if value[i] < best:
                best, time = float(value[i]), float(part.time[i])
                where = ", ".join(s.names[c][k] for c, k in enumerate(part.item[i]))
        bound, depth, spent = np.concatenate(bounds), depth + 1, spent + len(s.x)
        left, close = bound < goal, max(RESOLUTION * max(abs(limit), 1e-3), 0.02 * (best - goal))
        if best < goal or (np.any(left) and (spent > BUDGET or depth > DEPTH)):
            verdict = "violated" if best < goal else "not proven"
            break
        s = s.select(left | ((bound < best - close) & (spent < BUDGET // 3)))
        s = s.select(np.repeat(np.arange(len(s.x)), 2)).within(np.tile([-0.5, 0.5], len(s.x)), 0.5)
    return Row(name, unit, verdict, sign * best, limit, sense, time, where, spent)


# Distances, along the shortest connections at midpoints.


def closest(a: Array, b: Array, c: Array, d: Array) -> Array:
    """Return the shortest vectors (m, d) from segments c d to segments a b."""
    u, v, w = b - a, d - c, a - c
    uu, vv, uv, uw, vw = (np.sum(x * y, -1) for x, y in ((u, u), (v, v), (u, v), (u, w), (v, w)))

    def share(x: Array, y: Array) -> Array:
        return np.clip(x / np.where(y > 0.0, y, 1.0), 0.0, 1.0)

    j = share(vw + share(uv * vw - vv * uw, uu * vv - uv**2) * uv, vv)
    return w + share(j * uv - uw, uu)[:, None] * u - j[:, None] * v


def distance(a: Sequence[Line], b: Sequence[Line]) -> Line:
    """Distance of points or segments."""
    w = direction(closest(a[0].v, a[-1].v, b[0].v, b[-1].v))
    return minimum(*((x - y).dot(w) for x in a for y in b))


def prism_gap(a: Sequence[Line], b: Sequence[Line]) -> Line:
    """Level distance of the first two corners, or vertical distance of all corners."""
    z_coordinates = [[x[2] for x in corners] for corners in (a, b)]
    (low, floor), (high, top) = ([f(*z) for z in z_coordinates] for f in (minimum, maximum))
    beside = distance([x[:2] for x in a[:2]], [x[:2] for x in b[:2]])
    return maximum(beside, low - top, floor - high)


class Slab:
    """A convex section between two heights: clockwise corners, and a radius about them."""

    def __init__(self, outline: Any, radius: Any, lower: float, upper: float) -> None:
        self.round, self.radius = outline is None, radius or 0.0
        self.lower, self.upper = lower, upper
        self.core = np.array([[0.0, 0.0]] if outline is None else outline, dtype=float)
        self.sides = np.roll(self.core, -1, 0) - self.core
        self.out = direction(np.stack([-self.sides[:, 1], self.sides[:, 0]], -1))
        turn, area = (np.sum(self.out * np.roll(x, -1, 0), -1) for x in (self.sides, self.core))
        if lower > upper:
            raise ValueError("a body's floor is above its ceiling")
        if self.radius <= 0.0 if self.round else self.radius < 0.0 or np.any(turn >= 0.0):
            raise ValueError("a section is a convex, clockwise outline or a circle's radius")
        area = (area * length(self.sides))[:, None]
        middle = (self.core + np.roll(self.core, -1, 0)) / 3.0
        self.centroid = np.sum(middle * area, 0) / np.maximum(np.sum(area), TINY)

    def depth(self, x: Array) -> Array:
        """Depth of points (…, 2) inside, as a lower bound; negative outside."""
        to = x[..., None, :] - self.core
        inside = -np.max(np.sum(to * self.out, -1), -1)
        return -length(to[..., 0, :]) + self.radius if self.round else inside

    def off(self, x: Array) -> Array:
        """Return the shortest vectors to points (m, 3)."""
        to = x[:, None, :2] - self.core
        share = np.sum(to * self.sides, -1) / np.maximum(np.sum(self.sides**2, -1), TINY)
        gaps = to - np.clip(share, 0.0, 1.0)[..., None] * self.sides
        gap = gaps[np.arange(len(x)), np.argmin(length(gaps), axis=1)]
        beyond = np.maximum(length(gap) - self.radius, 0.0) * (self.depth(x[:, :2]) < 0.0)
        above = x[:, 2] - np.clip(x[:, 2], self.lower, self.upper)
        return np.column_stack([direction(gap) * beyond[:, None], above])

    def grown(self, radius: float, lower: float, upper: float) -> Slab:
        """Return a slab with a larger radius between other heights."""
        return Slab(None if self.round else self.core, self.radius + radius, lower, upper)

    def gap(self, *points: Line) -> Line:
        """Distance to the hull of points, by its sides."""
        found = []
        for a, b in pairwise(points if points[1:] else points * 2):
            low, high = np.zeros((len(a.v), 1)), np.ones((len(a.v), 1))
            for _ in range(60 if a is not b else 0):
                x, y = low + (high - low) / 3.0, high - (high - low) / 3.0
                one, two = (length(self.off(a.v + z * (b.v - a.v))) for z in (x, y))
                low, high = np.where(one > two, x.T, low.T).T, np.where(one > two, high.T, y.T).T
            w = direction(self.off(a.v + low * (b.v - a.v)))
            most = np.max(w[:, :2] @ self.core.T, -1) + self.radius * length(w[:, :2])
            most += np.maximum(self.lower * w[:, 2], self.upper * w[:, 2])
            found.append(minimum(*(p.dot(w) for p in points)) - most[:, None])
        return maximum(*found)


class Body:
    """An object: its stem and rim, its first pose and its centre of mass in its own frame."""

    def __init__(self, name: str, o: dict[str, Any]) -> None:
        check_form(f"objects.{name}", o, "body")
        self.name, self.fixed, rim = name, bool(o["fixed"]), o["rim"]
        sections = [o["section"], *([rim["section"]] if rim else [])]
        if any((x["outline"] is None) == (x["radius"] is None) for x in sections):
            raise ValueError(f"objects.{name} has a section of an outline and a radius, or neither")
        self.mass, self.friction = float(o["mass"]), float(o["friction"])
        self.stem, self.rim = Slab(**o["section"], lower=o["lower"], upper=o["upper"]), None
        self.height = o["lower"] if rim is None else rim["height"]
        if rim is not None:
            self.rim = Slab(**rim["section"], lower=self.height, upper=self.height)
        self.slabs = [slab for slab in (self.stem, self.rim) if slab]
        self.pose = np.array([*o["at"], math.cos(o["yaw"]), math.sin(o["yaw"])])
        self.centre = np.append(self.stem.centroid, 0.5 * (self.stem.lower + self.stem.upper))


class Plan:
    """Contents of a plan file: curves of all moving points, and their limits.

    Points are N drones, then P vertices, then the two contacts of every edge with an object; twice
    the midpoint for a straight edge. Cable k runs from q_k via vertices begin[k] and end[k] to r_k.
    The i-th leg starts at vertex anchor[i] and pulls at point pull_point[i].

    If robots join and leave, ``chapters`` are runs of pieces with one ring: plans of that ring and
    of every robot that waits ``beside`` it, from ``since`` to ``until``. Otherwise the plan is its
    only chapter. ``guests`` are indices of the robots that join or leave at its start and end.
    """

    def __init__(
        self, file: Any, s: dict[str, Any], folder: str = "", at: float = 0.0, robots: Any = ()
    ) -> None:
        self.file, self.folder, self.settings = file, folder, s
        self.label = folder.removeprefix("others/").replace("/", ".")
        self.arrays, self.robots, self.guests = dict[str, Array](), np.array(robots), [-1, -1]
        self.since, self.until, self.beside = -math.inf, math.inf, self
        check_form("settings", s, "settings")
        check_form("settings.team", s["team"], "team" if "robots" in s["team"] else "single")
        form = "member[]" if "ring" in s["phases"][0] else "phase[]"
        check_form("settings.phases", s["phases"], form)
        self._read(s)
        if not robots and self.breaks[0] != at:
            raise ValueError(f"{self.label}breaks do not rise from {at:g}")
        for words in () if robots else differences("", s["asked"], recorded_request(self)):
            raise ValueError(f"{self.label}{words}")
        self.chapters = [[self]] if "ring" not in self.phases[0] else chapters(self)

    def _array(self, name: str, *shape: int, other: Any = None, most: float = 1e5) -> Array:
        """Return an array of the file, or ``other`` if the settings do not name it."""
        if self.settings.get(name) is not True and (0 in shape or other is not None):
            return np.zeros((*shape, 1)) if other is None else np.asarray(other)
        x: Array = self.file[self.folder + name]
        self.arrays[name] = x
        fits = (x.shape[:-1] if shape[1:] else x.shape) == shape and x.dtype == np.float64
        fits &= (x.size > 0 or 0 in shape) and [*self.file].count(self.folder + name) == 1
        fits &= not shape[1:] or x.shape[-1] <= MAX_COEFFS
        fits &= name not in POSITIVE or bool(np.all(x > 0.0))
        if not fits or not np.all(np.abs(x) <= most):
            raise ValueError(f"{name} has another shape, or numbers beyond their bounds")
        return x

    def _set_distances(self, separation: dict[str, float], off: float) -> None:
        """Set minimum distances, larger by the effect of tracking errors ``off`` [m]."""
        self.sep, self.tracking = dict(separation), off
        # Ellipsoid that contains the sum of an ellipsoid and a ball, with the smallest radius
        wide, high = self.sep["radius"], self.sep["height"]
        self.sep["height"] = math.sqrt((high**2 + wide * off) * (1.0 + off / wide))
        for key, times in (("radius", 1.0), ("cable", 2.0), ("crossing", 2.0), ("object", 1.0)):
            self.sep[key] += times * off
        self.scale = 0.5 / np.array([self.sep["radius"], self.sep["radius"], self.sep["height"]])
        names = "cable_clearance", "crossing", "object_clearance"  # of distances from cables [m]
        rooms = ((f"{x} m min", max(float(self.sep[x.split("_")[0]]), MIN_GAP)) for x in names)
        self.cable, self.crossing, self.object = rooms

    def _read(self, s: dict[str, Any]) -> None:
        team, self.breaks, self.phases = s["team"], self.file[f"{self.folder}breaks"], s["phases"]
        self.limits, self.arena, label = dict(s["limits"]), s["arena"], self.label
        self._set_distances(s["separation"], float(self.limits.get("tracking") or 0.0))
        self.limits["leg"] += 2.0 * self.tracking  # vertices are as far off as drones
        self.h, self.n = np.diff(self.breaks), int(team.get("robots", 0))
        m, n, self.closed = len(self.h), self.n, team.get("topology") == "closed"
        N, P = 2 * n or int(team["drones"]), n if self.closed else n + (n > 0)
        self.N, self.V, self.every = N, slice(N, N + P), np.ones(m, dtype=bool)
        if m < 1 or not np.all(self.h > 0.0):
            raise ValueError(f"{label}breaks do not rise")
        self._array("breaks", m + 1, most=BIG)
        few = n < 2 + self.closed and not len(self.robots)
        if n and (team["topology"] not in ("closed", "open") or few):
            raise ValueError("team has too few robots, or another topology than closed or open")
        if self.limits["reserve"] > 1.0 or self.limits["tilt"] >= 0.5 * math.pi:
            raise ValueError("limits.reserve is above 1, or limits.tilt no acute angle")
        box = s["arena"] or {"lower": [0.0], "upper": [1.0]}
        if np.any(np.array(box["lower"]) >= box["upper"]):
            raise ValueError("arena has no room")
        self.given = {key: self._array(key, n or N) for key in ("mass", "max_thrust")}
        self.mass, self.max_thrust = (
            np.repeat(x[:, None], 1 + (n > 0), axis=0) for x in self.given.values()
        )
        for key, x in DEFAULTS.items():
            other = None if s.get("control") is True else np.full(n or N, x)
            self.given[key] = self._array(key, n or N, other=other, most=math.inf)
        self.robots = self.robots if len(self.robots) else np.arange(n)
        self.names = [f"{label}{end}{k}" for k in self.robots for end in "qr"]
        self.names += [f"{label}d{i}" for i in range(N - 2 * n)]
        self.cables = [f"{label}cable {k}" for k in self.robots]
        self.labels = [*self.names, *(f"{label}p{j}" for j in range(P)), *np.repeat(self.cables, 2)]
        self.floor = 0.0 if self.arena is None else float(self.arena["lower"][2])
        self.within = "ground m min" if self.arena is None else "arena m min"
        until = [float(phase["end"]) for phase in self.phases[:-1]]
        self.phase = np.searchsorted(until, self.breaks[:-1] + 0.5 * self.h)
        self._check_phases()
        self.state = np.array([phase["state"] for phase in self.phases])[self.phase]
        self.formed = np.isin(self.state, ("hitched", ROLLING, LYING))
        self.free = ~self.formed & (n > 0)
        self.follows = np.where(self.state == LYING, ROLLING, self.state)  # what may roll next
        self._read_bodies(m, n)
        parts = [self._array("drones", m, N, 3), *self._read_cables(m, n, N, P)]
        drones, *ends = (elevated(x, max(y.shape[-1] for y in parts)) for x in parts)
        self.points = Curve(np.concatenate([drones, *ends], axis=1), self.h)
        self.size = max(
            float(np.max(np.abs(x), initial=0.0)) for x in (drones, *(x[self.formed] for x in ends))
        )
        self.length_loss, self.pull_loss, self.depth, self.shares = rim_loads(self)
        # Ramps: tensions rise from 0, or fall to it, at rest next to a span without a hitch.
        still = np.all(np.ptp(self.points.c[0][:, : N + P], axis=-1) <= REST, axis=(1, 2))
        near = ~self.formed
        for _ in range(m):
            near[1:] |= still[1:] & near[:-1]
            near[:-1] |= still[:-1] & near[1:]
        self.ramp = near & self.formed
        # Pieces on which all drones go straight up or down, or rest.
        extents = np.ptp(self.points.c[0][:, :N, :2], axis=-1)
        self.upright: Mask = np.max(extents, axis=(1, 2)) <= TOUCH

    def _check_phases(self) -> None:
        """Raise ValueError unless phases are consecutive and consistent."""
        end, before = self.breaks[0], dict[str, Any]()
        named, team = self.settings.get("objects", {}), self.settings["team"]
        moving = self.settings.keys() & {"poses", "borne", "contacts"}
        for i, phase in enumerate(self.phases):
            at, state, low, hold = (phase[key] for key in ("start", "state", "tension", "hold"))
            follows, end = abs(at - end) <= TOUCH and at < phase["end"], phase["end"]
            alike = all(phase.get(x) == before.get(x) for x in ("state", "ring", "waiting"))
            broken, before = alike or np.min(np.abs(self.breaks - at)) <= TOUCH, phase
            ring, waiting = phase.get("ring"), phase.get("waiting", [])
            whole = sorted([*(ring or ()), *(k for k, _ in waiting)]) == [*range(self.n)]
            whole &= len(ring or ()) > 2 and self.closed and not (any(team["load"]) or hold)
            whole &= not moving and {*UNTIED, LAID}.issuperset(x for _, x in waiting)
            known = not hold or (hold["object"] in named and hold["by"] in ("rest", "grip"))
            known &= {*range(self.n)}.issuperset(hold["cables"] if hold else ())
            for good, words in (
                (follows, "does not follow what is before"),
                (broken, "begins another state within a piece"),
                (ring is None or whole, "has a ring, or robots that wait, that cannot be"),
                (state in STATES and (state == "none") is (self.n == 0), f"is {state}"),
                (low is None or low[0] <= low[1], "has no range of tensions"),
                (known, "holds what is not there"),
            ):
                if not good:
                    raise ValueError(f"{self.label}phases[{i}] {words}")
        if abs(end - self.breaks[-1]) > TOUCH:
            raise ValueError("phases do not end with the plan")

    def _read_bodies(self, m: int, n: int) -> None:
        """Read objects, how they are held (o, m), and by which cables (o, m, n)."""
        self.bodies = [Body(name, o) for name, o in self.settings.get("objects", {}).items()]
        o, prisms = len(self.bodies), self.settings["keep_out"]
        self.slabs = [(b, slab) for b, body in enumerate(self.bodies) for slab in body.slabs]
        self.walls = [(-1, Slab(e["polygon"], None, e["lower"], e["upper"])) for e in prisms]
        self.rest, self.grip, self.holding = *np.zeros((2, o, m), bool), np.zeros((o, m, n), bool)
        for p, hold in enumerate(self.phases[p]["hold"] for p in self.phase):
            if hold is not None:
                j = [b.name for b in self.bodies].index(hold["object"])
                {"rest": self.rest, "grip": self.grip}[hold["by"]][j, p] = True
                self.holding[j, p, hold["cables"]] = True
        still = np.array([b.pose for b in self.bodies]).reshape(1, o, 5, 1) * np.ones((m, 1, 1, 1))
        self.poses = Curve(self._array("poses", m, o, 5, other=still), self.h)
        borne = self._array("borne", m, o, other=np.zeros((m, o, 1)))
        borne = np.where(np.abs(borne - np.round(borne)) <= 2.0**-40, np.round(borne), borne)
        self.borne = Curve(borne[:, :, None], self.h)
        self.held, self.lifted = self.rest | self.grip, np.all(borne == 1.0, axis=-1).T
        self.moving = np.any(np.ptp(self.poses.c[0], axis=-1) > REST, axis=-1).T
        self.active = self.moving | np.any(borne != 0.0, axis=-1).T  # moving or borne (o, m)
        since = np.where(self.active & np.roll(self.active, 1, axis=1), 0, np.arange(m))
        self.hold_start: Items = np.maximum.accumulate(since, axis=1)  # first pieces

    def _read_cables(self, m: int, n: int, N: int, P: int) -> list[Array]:
        """Read cables; return coefficients of vertices and of contacts of edges."""
        team = {"cable_density": 0.0, "cable_friction": 0.0, "load": 0.0, **self.settings["team"]}
        k = np.arange(n)
        self.begin, self.end, self.clasps = N + k, N + (k + 1) % max(P, 1), k[not self.closed :]
        self.behind = (self.clasps - 1) % max(n, 1)  # the other cable of a clasp
        self.pair = np.stack([self.behind, self.clasps])
        self.edges = np.stack([self.begin, N + P + 2 * k, N + P + 2 * k + 1, self.end])
        own, leg = np.stack([self.begin, self.end], -1), np.ones((n, 2), dtype=bool)
        leg[:1, 0] = leg[-1:, 1] = self.closed
        self.leg, self.anchor = leg.ravel(), own.ravel()
        self.pull_point = np.where(leg, own, own[:, ::-1]).ravel()
        self.weight, self.mu = G * float(team["cable_density"]), float(team["cable_friction"])
        self.load = (np.array(team["load"], dtype=float) * np.ones(len(self.clasps)))[:, None]
        self.length, self.team = (self._array(x, n)[:, None] for x in ("cable_length", "tension"))
        vertices, T = self._array("vertices", m, P, 3), self._array("tensions", m, n)
        middle = 0.5 * (vertices + np.roll(vertices, -1, 1))[:, :n]
        middle = np.stack([middle, middle], 2)
        contacts, both = self._array("contacts", m, n, 2, 3, other=middle), np.stack([T, T], 2)
        pulls = self._array("leg_tensions", m, n, 2, other=both)
        self.bent, self.slid = contacts is not middle, pulls is not both
        legs = self._array("legs", m, n, 2)
        flat = (x.reshape(m, 2 * n, 1, x.shape[-1]) for x in (pulls, legs))
        self.pulls, self.legs = (Curve(x, self.h) for x in flat)
        self.tensions = Curve(T[:, :, None], self.h)
        self.tied = np.zeros((n, n), dtype=bool)  # cables that clasp each other
        self.tied[self.clasps, self.behind] = self.tied[self.behind, self.clasps] = True
        # Ranges of tensions that phases state (m, n, 2) [N], and which phase does.
        self.ranged, self.range = np.full(m, -1), np.tile(self.team, (m, 1, 2))
        for i, phase in enumerate(self.phases):
            if phase["tension"] is not None:
                within = self.breaks[:-1] >= phase["start"] - TOUCH
                within &= self.breaks[1:] <= phase["end"] + TOUCH
                self.ranged[within], self.range[within] = i, phase["tension"]
        self.least = np.minimum(self.range[..., :1], self.team)
        self.sag = np.asarray(np.square(self.weight * self.length / self.team) / 24.0)  # shares
        # Straight parts of taut cables: both points, cable, and vertices at the ends (k, 5).
        stops, on = self.edges if self.bent else self.edges[[0, 3]], np.flatnonzero(self.leg)
        rows = [(self.anchor[on], on, on // 2, self.anchor[on], self.anchor[on])]
        rows += [(a, b, k, self.begin, self.end) for a, b in pairwise(stops)]
        self.parts = np.concatenate([np.stack(row, -1) for row in rows])
        edges = [f"{self.label}edge {j}" for j in k] * (len(rows) - 1)
        self.kinds = [f"{self.label}{'qr'[j % 2]}-leg {self.robots[j // 2]}" for j in on] + edges
        return [vertices, contacts.reshape(m, 2 * n, 3, contacts.shape[-1])]

    def spans(self, on: Mask, items: Any, *names: Sequence[str]) -> Spans:
        """Return whole pieces with items (k,) or (k, c), for a mask (pieces,) or (pieces, k)."""
        items = np.array(items, dtype=int)
        items = items[:, None] if items.ndim == 1 else items
        piece, k = np.nonzero(np.broadcast_to(on.reshape(len(on), -1), (len(on), len(items))))
        half = np.full(len(k), 0.5)
        return Spans(self, piece, items[k], half, half, names)


def chapters(p: Plan) -> list[list[Plan]]:
    """Return the plans of rings, each with those of the waiting robots."""
    found, first = list[list[Plan]](), 0
    for ring, run in groupby(p.phases[i]["ring"] for i in p.phase):
        pieces = slice(first, first := first + len([*run]))
        alone = [[k] for k in range(p.n) if k not in ring]
        found.append([chapter(p, pieces, robots) for robots in (ring, *alone)])
        if np.any(p.arrays["vertices"][pieces, len(ring) :]):
            raise ValueError("vertices has more of them than a ring")
        for x in found[-1]:
            x.beside = found[-1][0]
    for one, other in pairwise(found):
        at, changed = float(other[0].breaks[0]), {*one[0].robots} ^ {*other[0].robots}
        for x in one + other:
            x.since, x.until = (x.since, at) if x in one else (at, x.until)
            if len(changed) == 1 and changed <= {*x.robots}:
                x.guests[x in one] = x.robots.tolist().index(*changed)
    return found


def chapter(p: Plan, pieces: slice, robots: list[int]) -> Plan:
    """Return the plan of a ring, or of a waiting robot, on a run of pieces."""
    arrays, n = dict[str, Array](), len(robots)
    ends, vertices = [2 * k + end for k in robots for end in (0, 1)], [*range(max(n, 2))]
    rows = {"drones": ends, "vertices": vertices}
    for name, x in p.arrays.items():
        arrays[p.folder + name] = x[robots] if x.ndim == 1 else x[pieces, rows.get(name, robots)]
    arrays[f"{p.folder}breaks"] = p.breaks[pieces.start : pieces.stop + 1]
    clasps, topology = (n, "closed") if n > 1 else (0, "open")
    team = {"robots": n, "topology": topology, "load": [0.0] * clasps}
    phases = list[dict[str, Any]]()
    for i in dict.fromkeys(p.phase[pieces].tolist()):
        phase = {key: x for key, x in p.phases[i].items() if key not in ("ring", "waiting")}
        waiting = dict(p.phases[i]["waiting"])
        phases.append(phase if n > 1 else phase | {"state": waiting[robots[0]], "tension": None})
    settings = p.settings | {"team": p.settings["team"] | team, "phases": phases}
    return Plan(arrays, settings, p.folder, robots=robots)


def elevated(c: Array, count: int) -> Array:
    """Return polynomials with elevated degree."""
    while c.shape[-1] < count:
        share, zero = np.arange(c.shape[-1] + 1) / c.shape[-1], np.zeros_like(c[..., :1])
        c = share * np.concatenate([zero, c], -1) + (1 - share) * np.concatenate([c, zero], -1)
    return c


def in_frame(pose: Array, x: Array) -> Array:
    """Points x (…, 3) in the frames of bodies with poses (…, 5)."""
    o, c, r = x - pose[..., :3], pose[..., 3], pose[..., 4]
    return np.stack([c * o[..., 0] + r * o[..., 1], c * o[..., 1] - r * o[..., 0], o[..., 2]], -1)


# Hanging cables: catenaries of given lengths between moving ends.


def steepness(ratio: Array) -> Array:
    """σ with ``sinh σ / σ = ratio``, by bisection; nan for ratios up to 1."""
    low, high = np.zeros_like(ratio), 8.0 + 2.0 * np.log(np.maximum(ratio, 1.0))
    for _ in range(60):
        x = 0.5 * (low + high)
        less = np.sinh(x) < ratio * x
        low, high = np.where(less, x, low), np.where(less, high, x)
    return np.where(ratio > 1.0, low, np.nan)


def hanging(s: Spans, i: Index) -> tuple[Line, Line]:
    """Return vectors from drone i to its cable's other end, and σ.

    ``sinh σ / σ = √(L² - h²) / s`` with the level distance s and the rise h of the ends;
    ``σ' = σ² / (σ cosh σ - sinh σ)``.
    """
    off = s.point(i + 1 - 2 * (i % 2)) - s.point(i)
    whole = -(off[2] * off[2]) + s.plan.length[i // 2] ** 2
    whole = whole.map(np.sqrt, lambda x: 0.5 / np.sqrt(x))

    def slope(x: Array) -> Array:
        sigma = steepness(x)
        return sigma**2 / (sigma * np.cosh(sigma) - np.sinh(sigma))

    return off, (whole * off[:2].norm().inverse()).map(steepness, slope)


def hanging_pull(s: Spans, i: Index) -> Line:
    """Force of a cable of unit weight per length on drone i: ``(s / 2σ, ½ h coth σ - ½ L)``."""
    off, sigma = hanging(s, i)
    coth = sigma.map(lambda x: 1.0 / np.tanh(x), lambda x: -1.0 / np.sinh(x) ** 2)
    return joined(off[:2] * sigma.inverse(), off[2] * coth - s.plan.length[i // 2]) * 0.5


def depth(L: Array, h: Array, sigma: Array, mu: Array) -> Array:
    """Depth of cables below their chords at μ from -1 to 1."""
    arch = L * np.sinh(0.5 * (1.0 + mu) * sigma) * np.sinh(0.5 * (1.0 - mu) * sigma)
    return np.asarray((arch - 0.5 * h * np.sinh(mu * sigma)) / np.sinh(sigma) + 0.5 * h * mu)


def hanging_links(s: Spans, k: Index) -> tuple[list[Line], list[Line], Array]:
    """Points of cables, points of their chords above, and the sag below links (m, 1).

    At μ from -1 to 1 a cable is ``L (cosh σ - cosh μσ) / 2 sinh σ + h (μ - sinh μσ / sinh σ) / 2``
    below its chord, with derivatives of at most ``(L + |h|) / 4`` by σ and ½ by h. A convex curve
    sags below a link by at most a quarter of its width times the change of slope.
    """
    off, sigma = hanging(s, 2 * k)
    L, h, g = s.plan.length[k, 0], off.v[:, 2], sigma.v[:, 0]
    tilt = np.arcsinh(h / np.sqrt(L**2 - h**2))
    slopes = np.linspace(np.sinh(tilt - g), np.sinh(tilt + g), LINKS + 1)  # even along the cable
    places = np.clip((np.arcsinh(slopes) - tilt) / g, -1.0, 1.0)
    rate = 0.25 * (L + np.abs(h) + off.reach) * sigma.rate + 0.5 * off[2].rate
    cable, chord = [], []
    for mu in places:
        deep = depth(L, h, g, mu)[:, None]
        chord.append(s.point(2 * k) + off * (0.5 * (1.0 + mu))[:, None])
        cable.append(chord[-1] - Line(deep, 0.0 * deep, rate, s.t) * UP)
    sag = np.max(np.diff(slopes, axis=0) * np.diff(places, axis=0), axis=0)
    return cable, chord, 0.125 * (sag * length(off.v[:, :2]))[:, None]


def sway(s: Spans, k: Index) -> Line:
    """Return displacements of points of hanging cables beyond the tracking error r of their ends.

    They are ``√(1 + ¼) r`` and the effect of σ: ``(coth σ - 1/σ) σ' = (ln √(L² - h²) / s)'`` with s
    and h within 2 r. Slopes of depths over L are at most ¼, and ``(1/eσ + e^-σ) / 2`` for σ > 1.
    """
    ends, L, r = s.point(2 * k + 1) - s.point(2 * k), s.plan.length[k, 0], 2.0 * s.plan.tracking

    def moved(low: Array, high: Array, h: Array) -> Array:
        whole, flat = (np.sqrt(L**2 - x**2) for x in (h, h + r))
        g = steepness(flat / (high + r))
        change = np.log(low / (low - r) * whole / flat) / (1.0 / np.tanh(g) - 1.0 / g)
        wide = np.maximum(g, 1.0)
        deeper = L * np.minimum(0.25, 0.5 * (np.exp(-1.0) / wide + np.exp(-wide)))
        return np.asarray((deeper + 0.25 * (h + r)) * change + 0.06 * r)

    if not r:
        return s.zero
    level_distance, h = ends[:2].norm(), np.abs(ends.v[:, 2])
    x = moved(level_distance.v[:, 0], level_distance.v[:, 0], h)
    q = (moved(level_distance.low, level_distance.high, h + ends[2].reach) - x) / s.t
    return Line(x[:, None], 0.0 * x[:, None], q, s.t)


def lowest(s: Spans, k: Index) -> Line:
    """Height of the lowest points of hanging cables."""
    cable, _, sag = hanging_links(s, k)
    return minimum(*(x[2] for x in cable)) - sag


# The limits.


def drones(p: Plan) -> Iterator[Row]:
    """Distances, rates and forces of drones."""
    s, lim, sep = p.spans(p.every, range(p.N), p.names), p.limits, p.sep
    pairs = p.spans(p.every, np.column_stack(np.triu_indices(p.N, 1)), p.names, p.names)

    def turning(s: Spans, i: Index) -> Line:
        """``|f × f'| / |f|²``: rotation rate of the thrust."""
        u = s.thrust(i).unit()
        return Line(length(u.g)[:, None], s.zero.g, u.q / s.t, s.t) * DEGREES

    apart = "separation ratio min", 1.0
    yield prove(*apart, pairs, lambda s, i, j: ((s.point(i) - s.point(j)) * p.scale).norm())
    for k, what in enumerate(("speed m/s max", "acceleration m/s² max", "jerk m/s³ max"), 1):
        most = lim[what.split()[0]] * (lim["reserve"] if k > 1 else 1.0)  # the reserve is for stops
        yield prove(what, most, s, lambda s, i, k=k: s.point(i, k).norm())
    share, tilt = 1.0 / p.max_thrust, lim["tilt"] * DEGREES
    yield prove("thrust share max", 1.0, s, lambda s, i: s.thrust(i).norm() * share[i])
    yield prove("tilt deg max", tilt, s, lambda s, i: angle(s.thrust(i), s.zero + UP) * DEGREES)
    if lim["body_rate"] is not None:
        yield prove("body_rate deg/s max", lim["body_rate"] * DEGREES, s, turning)
    yield prove(p.within, 0.0, s, lambda s, i: wall_gap(s, [s.point(i)]))
    out = "keep_out m min", sep["radius"]
    for b, slab in [*p.slabs, *p.walls]:
        yield prove(*out, s, lambda s, i, b=b, slab=slab: slab.gap(s.local(b, s.point(i))))


def wall_gap(s: Spans, x: Sequence[Line], deep: Line | float = 0.0, reach: float = 0.0) -> Line:
    """Distance of points to walls or ground, less a level ``reach`` and a depth below."""
    arena = s.plan.arena or {"lower": [-BIG, -BIG, 0.0], "upper": [BIG] * 3}
    lower, upper = np.array(arena["lower"]), np.array(arena["upper"])
    off = s.plan.tracking  # except for the floor, on which drones stand
    found = [(each - lower)[k] - reach - off for each in x for k in range(2)]
    found += [(-each + upper)[k] - reach * (k < 2) - off for each in x for k in range(3)]
    return minimum(*found, *(each[2] - lower[2] - deep for each in x))


def taut_cables(p: Plan) -> Iterator[Row]:
    """Distances, lengths and shapes of hitches; tensions and force residuals of clasps."""
    on, lim, ties = p.formed, p.limits, p.parts[:, 3:]
    clasps = p.spans(on, range(len(p.clasps)), [p.labels[p.V][c] for c in p.clasps])
    legs = p.spans(on, np.flatnonzero(p.leg), p.names)
    cables = p.spans(on, range(p.n), p.cables)
    vertices = p.spans(on, range(p.V.start, p.V.stop), p.labels)
    own = np.where(p.leg, np.arange(p.N), p.anchor)  # other end of the part at each drone
    foreign = np.argwhere(np.all(p.parts[:, :2] != own[:, None, None], axis=2))
    shared = np.any(ties[:, None, :, None] == ties[None, :, None, :], axis=(2, 3))
    s = p.spans(on, foreign, p.names, p.kinds)
    both, cut = np.argwhere(np.triu(~shared, 1)), [*corners_cut(p).values()]
    meeting = [mask[:, None] & np.all(both == sorted(legs), axis=1) for mask, legs, _ in cut]
    pairs = p.spans(on[:, None] & ~sum(meeting, ~p.every[:, None]), both, p.kinds, p.kinds)

    def room(s: Spans, _: Index) -> Line:
        """Margin to a total turn of more than once, or of a full turn for a chain."""
        turns = sum((exterior_angle(s, c) for c in range(len(p.clasps))), s.zero)
        return -turns + (361.0 if p.closed else 360.0)

    def tension(s: Spans, k: Index) -> Line:
        """``T - T_max``, or ``T_min - T`` outside ramps."""
        x, (low, high) = p.tensions.on(s, k), p.range[s.piece, k, :, None].swapaxes(0, 1)
        return maximum(x - high, -x + np.where(p.ramp[s.piece, None], 0.0, low))

    def slid(s: Spans, i: Index) -> Line:
        """Tensions of legs between ``e^{-μθ} T`` and ``e^{μθ} T``."""
        x, T, held = p.pulls.on(s, i), p.tensions.on(s, i // 2), capstan(s, i)
        return maximum(x - T * held, T - x * held) * maximum(T, MIN_TENSION).inverse()

    def bend(s: Spans, k: Index) -> Line:
        (a, b), (first, last) = s.edge(k), (s.point(i) for i in p.edges[1:3, k])
        return maximum(a.unit().cross(b.unit()).norm(), (last - first).norm())

    def inside(s: Spans, j: Index, *, leg: bool) -> Line:
        """Distances of straight parts to walls, with a sag of ``ρ g s² / 8 T`` at the middle."""
        (a, b), k = s.part(j), p.parts[j, 2]
        way, T = b - a, p.pulls.on(s, p.parts[j, 1]) if leg else p.tensions.on(s, k)
        deep = way.dot(way) * s.inverse_tension(T, k) * (0.125 * p.weight)
        inner = wall_gap(s, [a + way * x for x in (0.25, 0.5, 0.75)], deep)
        return minimum(wall_gap(s, [a, b]), inner)

    for items in np.split(np.arange(len(p.parts)), [int(np.sum(p.leg))]):
        yield prove(p.within, 0.0, p.spans(on, items, p.kinds), partial(inside, leg=not items[0]))
    yield prove(*p.cable, s, lambda s, i, j: distance([s.point(i)], s.part(j)))
    yield prove(*p.crossing, pairs, lambda s, i, j: distance(s.part(i), s.part(j)))
    speed = "vertex_speed m/s max", lim["vertex_speed"]
    yield prove(*speed, vertices, lambda s, i: s.point(i, 1).norm())
    yield prove("legs m min", lim["leg"], legs, lambda s, i: s.leg(i).norm())
    yield prove("cable_length 1 max", 1e-4, cables, length_error)
    yield prove("equilibrium 1 max", 5e-3, clasps, force_residual)
    shut = clasps.select(p.state[clasps.piece] == "hitched")
    yield prove("contact deg max", OPEN_ROLL, shut, roll_angle)
    if p.weight or np.any(p.load) or np.any(p.active):
        yield prove("contact 1 max", 0.0, shut, contact)
    yield prove("convexity deg min", 0.0, clasps, exterior_angle)
    yield prove("convexity turn min", 0.0, p.spans(on, [0], ["outline"]), room)
    yield prove("tension N max", 1e-4, cables, tension)
    if p.slid:
        yield prove("equilibrium 1 max", 5e-3, legs, slid)
    if p.bent:
        straight = p.spans(on & ~np.any(p.grip, axis=0), range(p.n), p.cables)
        yield prove("grip bend max", 2 * WRAP, straight, bend)


def corners_cut(p: Plan) -> dict[int, tuple[Mask, list[int], float]]:
    """Return crossing legs beyond the edge of a robot that has joined (0), or leaves (1).

    Values: mask of pieces on which they may touch, as cables lie across each other and roll before
    or after; r-leg of the cable behind and q-leg of the one ahead; 1 if the latter is on top, or
    -1.
    """
    found = dict[int, tuple[Mask, list[int], float]]()
    for end, k in enumerate(p.guests):
        order = slice(None, None, 1 - 2 * end)
        lying = np.logical_and.accumulate(p.state[order] == LYING)
        if k >= 0 and lying[0] and p.n > 1:
            after = p.phase[order][np.append(lying, False).argmin() :][:1]
            mask = (lying | np.isin(p.phase[order], after) & (p.state[order] == ROLLING))[order]
            legs = [2 * ((k - 1) % p.n) + 1, 2 * ((k + 1) % p.n)]
            s = p.spans(mask, [legs])
            x = np.concatenate([over(s.within(x), *legs).v for x in (-1.0, 0.0, 1.0)])
            found[end] = mask, legs, float(np.sign(x.flat[np.argmax(np.abs(x))]))
    return found


def over(s: Spans, i: Index, j: Index) -> Line:
    """Height of legs j over legs i: the signed distance of their lines."""
    n = s.leg(i).cross(s.leg(j)).unit()
    return (s.point(s.plan.anchor[j]) - s.point(s.plan.anchor[i])).dot(n)


def cut_legs(p: Plan) -> Iterator[Row]:
    """Height of the upper of crossing legs over the lower one, until they are separated."""

    def above(s: Spans, i: Index, j: Index, sign: float) -> Line:
        a, b = ([s.point(k), s.point(p.anchor[k])] for k in (i, j))
        return maximum(over(s, i, j) * sign, distance(a, b) - SAG_TOL - p.crossing[1])

    for mask, legs, sign in corners_cut(p).values():
        s = p.spans(mask, [legs], p.names, p.names)
        yield prove("laid m min", -SAG_TOL, s, partial(above, sign=sign))


def capstan(s: Spans, i: Index) -> Line:
    """``e^{μθ}`` for the angle θ between leg and edge at the clasps of drones i."""
    leaving, arriving = s.edge(i // 2)
    q = np.broadcast_to(i % 2 == 0, len(s.x))
    theta = angle(-s.leg_chord(i), leaving.where(q) - arriving.where(~q))
    return (theta * s.plan.mu).map(np.exp, np.exp)


def length_error(s: Spans, k: Index) -> Line:
    """``|d + l + e - L| / L``, or errors of stored legs.

    Parts of chord s at a slope α are longer than s by ``(ρ g τ / T)² s³ cos² α / 24``.
    """
    p, (leaving, arriving), total = s.plan, s.edge(k), wrapped_length(s, k) - s.plan.length[k]
    spans = [(x.norm(), x) for x in (s.leg(2 * k), s.leg(2 * k + 1))]
    off = [p.legs.on(s, 2 * k + end) - spans[end][0] for end in (0, 1)]
    pulled = maximum(p.tensions.on(s, k), p.least[s.piece, k]).inverse() * p.weight
    for chord, way in [*spans, (leaving.norm() + arriving.norm(), leaving + arriving)]:
        total = total + chord + chord * way[:2].dot(way[:2]) * pulled * pulled * (1.0 / 24.0)
    for b in range(len(p.bodies)):
        total = total - p.borne.on(s, b) * p.borne.on(s, b) * p.length_loss[b, s.piece, k, None]
    most = maximum(total, *off, -total, *(-x for x in off)) * (1.0 / p.length[k])
    lies = p.state[s.piece] == LYING
    return most.where(~lies) + (most - p.sag[k]).where(lies)


def wrapped_length(s: Spans, k: Index) -> Line:
    """Lengths of edges along gripped objects: ``2 R arcsin(c / 2 R)``, or sides."""
    p, ends = s.plan, [s.point(i) for i in s.plan.edges[1:3, k]]
    found = chord = (ends[1] - ends[0]).norm()
    for b in map(int, np.flatnonzero(np.any(p.grip, axis=1))):
        stem, on = p.bodies[b].stem, p.grip[b, s.piece]
        if stem.round:
            half = chord * (0.5 / stem.radius)
            half = half.map(np.arcsin, lambda x: 1.0 / np.sqrt(1.0 - x**2))
            around = half * (2.0 * stem.radius)
        else:
            ring = np.append(0.0, np.cumsum(length(stem.sides)))
            gaps = [length(s.local(b, x).v[:, None, :2] - stem.core) for x in ends]
            first, last = (ring[np.argmin(x, axis=1), None] for x in gaps)
            around = s.zero + np.where(chord.v < REST, 0.0, (last - first) % ring[-1])
        found = found.where(~on) + around.where(on)
    return found


def rim_loads(p: Plan) -> tuple[Array, Array, Array, Array]:
    """Return the effects on cables of bodies that rest on clasps, at starts of pieces; else 0.

    A rim on the clasps bends legs: below it they are level, beyond it they rise with ``sin α =
    W / (2 Σ T)`` for a weight W of body and edges. Level parts l of each leg shorten the cable by
    ``l (1 / cos α - 1)`` (o, m, n), and the rim reduces the pull of edges by ``1 - cos α`` (o, m),
    both with the squared load share. Vertices are ``tan α`` times the mean l below it (o, m).
    Shares (o, m, n, 3) of the body's mass and moments are least-squares solutions.
    """
    saved, taken, depth = np.zeros(p.holding.shape), *np.zeros((2, *p.rest.shape))
    shares = np.zeros((*p.holding.shape, 3))
    for b, q in np.argwhere(p.rest & p.active & p.closed).tolist():
        body, x, T = p.bodies[b], p.points.c[0][q, p.V, :, 0], p.tensions.c[0][q, :, 0, 0]
        at = in_frame(p.poses.c[0][q, b, :, 0], x)[:, :2]
        moments = np.column_stack([np.ones(p.n), at - body.centre[:2]])
        weight = G * body.mass + p.weight * np.sum(length(np.roll(x, -1, 0) - x))
        sine = min(weight / (2.0 * np.sum(T)), 1.0 - TOLERANCE)
        cosine = math.sqrt(1.0 - sine**2)
        shares[b, q], taken[b, q] = np.linalg.pinv(moments).T, 1.0 - cosine
        if body.rim is not None:  # how far its edge is beyond clasps, along edges: by bisection
            to = np.stack([np.roll(at, -1, 0), at])
            way, low, high = direction(to - to[::-1]), np.zeros((2, p.n)), np.full((2, p.n), 1e3)
            for _ in range(80):
                y = 0.5 * (low + high)
                inside = body.rim.depth(to + y[..., None] * way) > 0.0
                low, high = np.where(inside, y, low), np.where(inside, high, y)
            saved[b, q] = (np.roll(low[0], 1) + np.roll(low[1], -1)) * (1.0 / cosine - 1.0)
            depth[b, q] = np.mean(np.sum(low, axis=0)) * 0.5 * sine / cosine
    return saved, taken, depth, shares


def clasp_forces(s: Spans, c: Index) -> tuple[list[Line], list[Line], list[Line], Line]:
    """Directions u and pulls P at clasps of ``q̂_k, u_k, r̂_{k-1}, u_{k-1}``; weights, body forces w.

    ``P q̂_k + P_k u_k + P' r̂_{k-1} - P_{k-1} u_{k-1} - W ẑ + w = 0``. W is the sum of ``τ (½ g load
    + ½ ρ g (L - other leg))`` of both cables; ``w = -m μ (a_k + g b ẑ) + m h (G·a) ẑ`` with the
    load share b, the clasp's shares μ and G of mass and moments, and the height h above clasps.
    """
    p, k, j = s.plan, s.plan.clasps[c], s.plan.behind[c]
    ways = s.leg_chord(2 * k), s.edge(k)[0], s.leg_chord(2 * j + 1), s.edge(j)[1]
    kept, rests, weights = s.zero + 1.0, s.zero * UP, []
    for b, body in enumerate(p.bodies):
        share, (mass, x, y) = p.borne.on(s, b), p.shares[b, s.piece, c, :, None].swapaxes(0, 1)
        kept = kept - share * share * p.pull_loss[b, s.piece, None]
        a = s.rotated(b, s.world(b, body.centre, 2))
        moment = (a[0] * x + a[1] * y) * UP * (body.centre[2] - body.height)
        inertia = (moment - s.point(p.begin[k], 2) * mass).where(p.moving[b, s.piece])
        rests = rests + (inertia - share * mass * G * UP) * body.mass
    for cable, other in ((k, 2 * k + 1), (j, 2 * j)):
        used = -s.leg(other).norm().where(p.leg[other]) + p.length[cable]
        weights.append(s.taut(cable) * (used * (0.5 * p.weight) + 0.5 * G * p.load[c]) * UP)
    P, P_j = (s.edge_pull(x) * kept for x in (k, j))
    return [x.unit() for x in ways], [s.pull(2 * k), P, s.pull(2 * j + 1), P_j], weights, rests


def force_residual(s: Spans, c: Index) -> Line:
    """Return the force residual of a clasp, over the smaller tension of its cables.

    Weights of cables that lie across each other may be supported elsewhere.
    """
    u, P, (a, b), rests = clasp_forces(s, c)
    total = u[0] * P[0] + u[1] * P[1] + u[2] * P[2] - u[3] * P[3] - a - b + rests
    p, lies = s.plan, s.plan.state[s.piece] == LYING
    both, most = np.stack([p.clasps[c], p.behind[c]]), maximum(minimum(P[1], P[3]), MIN_TENSION)
    passed: Array = p.weight * np.sum(p.length[both], axis=0) / np.min(p.team[both], axis=0)
    lacks = total.norm() * most.inverse()
    return lacks.where(~lies) + (lacks - passed).where(lies)


def roll_angle(s: Spans, c: Index) -> Line:
    """Roll of pairs about the sum of their legs' pulls [deg]; at 180° clasps are open.

    It is the angle from ``u_k + u_{k-1}`` to the difference of the pulls, both normal to their sum;
    zero where tensions vanish at the ends of ramps.
    """
    k, j = s.plan.clasps[c], s.plan.behind[c]
    q, r = (s.leg_chord(i).unit() * s.pull(i) for i in (2 * k, 2 * j + 1))
    axis = (q + r).unit()
    bisector = s.edge(k)[0].unit() + s.edge(j)[1].unit()
    components = [x - axis * axis.dot(x) for x in (bisector, q - r)]
    return (angle(*components) * DEGREES).where(has_tension(s, k, j))


def has_tension(s: Spans, *cables: Index) -> Mask:
    """Return a mask (m,) of cables under tension, which excludes the ends of ramps."""
    weakest = minimum(*(s.plan.tensions.on(s, k) for k in cables))
    return np.asarray((weakest.high > MIN_TENSION) | ~s.plan.ramp[s.piece])


def contact(s: Spans, c: Index) -> Line:
    """Contact condition: ``C = W_k ẑ - P q̂_k - P_k u_k - ½ w``; C·q̂_k, C·u_k, -C·r̂_{k-1}, … < 0.

    With different tensions due to friction, the means of both conditions of a cable.
    """
    p, (u, P, weights, rests) = s.plan, clasp_forces(s, c)
    C, weakest = weights[0] - u[0] * P[0] - u[1] * P[1] - rests * 0.5, minimum(P[1], P[3])
    strong = has_tension(s, p.clasps[c], p.behind[c])
    pressing = [C.dot(u[0]), C.dot(u[1]), -C.dot(u[2]), C.dot(u[3])]
    if p.slid:
        pressing = [(pressing[i] + pressing[i + 1]) * 0.5 for i in (0, 2)]
    over = maximum(*pressing) * weakest.inverse()
    return over.where(strong) - np.where(strong, 0.0, 1.0)[:, None]


def exterior_angle(s: Spans, c: Index) -> Line:
    """Exterior angles at clasps seen from above [deg], positive for clockwise turns."""
    p, k, x = s.plan, s.plan.clasps[c], s.point(s.plan.begin[s.plan.clasps[c]])
    a, b = (x - s.point(p.begin[p.behind[c]]))[:2], (s.point(p.end[k]) - x)[:2]
    right = a[1] * b[0] - a[0] * b[1]
    turn = angle(a, b) * DEGREES * np.where(right.v < 0.0, -1.0, 1.0)
    return Line(turn.v, turn.g, np.where(right.low * right.high > 0.0, turn.q, BIG), s.t)


def free_cables(p: Plan) -> Iterator[Row]:
    """Distances of cables that lie, hang, clasp or are tightened."""
    k, ground, ends = range(p.n), p.state == "on the ground", (p.names, p.cables)
    pairs, foreign = np.triu_indices(p.n, 1), np.argwhere(np.arange(p.N)[:, None] // 2 != k)
    tied = p.tied[pairs] & ~np.isin(p.state, ("on the ground", "hanging free"))[:, None]
    both = p.spans(p.free[:, None] & ~tied, np.column_stack(pairs), p.cables, p.cables)
    free, hangs = (p.spans(on, k, p.cables) for on in (p.free, p.free & ~ground))
    lies, tight = p.spans(p.free & ground, foreign, *ends), p.state == "being tightened"

    def to_cable(s: Spans, i: Index, k: Index) -> Line:
        cable, _, sag = hanging_links(s, k)
        return minimum(*(distance([s.point(i)], x) for x in pairwise(cable))) - sag - sway(s, k)

    def to_sheet(s: Spans, i: Index, k: Index) -> Line:
        """Distances of drones from sheets between hanging cables and their chords."""
        cable, chord, sag = hanging_links(s, k)
        low = [x - UP * sag for x in cable]
        links = zip(pairwise(chord), pairwise(low), strict=True)
        return minimum(*(prism_gap([s.point(i)], [*top, *bottom]) for top, bottom in links))

    whole, off = "span 1 max", 2.0 * p.tracking
    yield prove(whole, 1.0, free, lambda s, k: (s.across(k).norm() + off) * (1.0 / p.length[k]))
    yield prove(*p.crossing, both, lambda s, i, j: distance(s.chord(i), s.chord(j)))
    yield prove(*p.cable, lies, lambda s, i, k: distance([s.point(i)[:2]], s.chord(k)))
    yield prove(*p.cable, hangs, lambda s, k: lowest(s, k) - p.floor - sway(s, k))
    # Distances of a point of a cable to both ends sum to at most its length
    s = p.spans(p.free & ~ground, foreign, *ends)
    far = sum(((s.point(s.item[:, 0]) - x).norm() for x in s.ends(s.item[:, 1])), s.zero)
    s = s.select(far.low < p.length[s.item[:, 1], 0] + 2.0 * (p.sep["cable"] + NEAR))
    yield prove(*p.cable, s, to_cable)
    yield prove("strands m min", TOUCH, s, to_sheet)
    longer = "cable_length 1 max", 1e-4  # bound of routes via vertices
    s = p.spans(tight, k, p.cables)
    yield prove(*longer, s, lambda s, k: s.around(k) * (1.0 / p.length[k]) - 1.0)
    yield from laid_cables(p)


def laid_cables(p: Plan) -> Iterator[Row]:
    """Lengths of single taut cables, and distances of laid neighbours."""
    laid = p.state == LAID
    s = p.spans(laid, range(p.n), p.cables)

    def off(s: Spans, k: Index) -> Line:
        """``|c (1 + (ρ g L / T)² cos² α / 24) - L| / L`` of chords c."""
        way = s.across(k)
        x = way.norm() * (1.0 / p.length[k])
        x = x + x * way[:2].dot(way[:2]) * (p.sag[k] / p.length[k] ** 2) - 1.0
        return maximum(x, -x) - 0.2 * p.sag[k]  # tolerance of an eighth of the tension

    def beside(s: Spans, k: Index, j: Index) -> Line:
        """Level distance, or height of one cable over the other."""
        over = [lowest(s, a) - maximum(*(x[2] for x in s.ends(b))) for a, b in ((k, j), (j, k))]
        return maximum(distance(s.chord(k), s.chord(j)), *over)

    yield prove("cable_length 1 max", 1e-4, s, off)
    pairs = p.spans(laid & ~p.upright, p.pair[::-1].T, p.cables, p.cables)
    yield prove(*p.crossing, pairs, beside)
    passed, ties = np.zeros((p.n, p.n, len(p.h) + 1)), np.zeros((2, len(p.clasps)))
    _, sign, end = replay(p, passed, ties, ("", ""))
    s = p.spans(laid & p.upright, range(len(p.clasps)), p.labels[p.V])

    def above(s: Spans, c: Index) -> Line:
        """Height of the upper cable over its contact, or over its bound."""
        z = s.point(2 * p.clasps[c])[2] - s.point(2 * p.behind[c])[2]
        return z * sign[s.piece, c, None] - end[s.piece, c, None]

    yield prove("laid m min", -TOUCH, s, above)


def intersections(a: Array, u: Array, b: Array, w: Array) -> tuple[Array, Array]:
    """Parameters at which segments a + x u and b + y w cross seen from above, or nan."""
    apart, turn = b - a, u[..., 0] * w[..., 1] - u[..., 1] * w[..., 0]
    x, y = (apart[..., 0] * v[..., 1] - apart[..., 1] * v[..., 0] for v in (w, u))
    x, y = (z / np.where(turn == 0.0, TINY, turn) for z in (x, y))
    inside = (x > 0.0) & (x < 1.0) & (y > 0.0) & (y < 1.0)
    return np.where(inside, x, np.nan), np.where(inside, y, np.nan)


def cable_heights(s: Spans, k: Items, share: Array) -> Array:
    """Heights (m,) of hanging cables at relative positions along their chords."""
    with np.errstate(all="ignore"):
        off, g = (x.v for x in hanging(s, 2 * k))
        deep = depth(s.plan.length[k, 0], off[:, 2], g[:, 0], 2.0 * share - 1.0)
    return np.asarray(s.point(2 * k).v[:, 2] + share * off[:, 2] - deep)


def crossing_heights(p: Plan, q: int, end: int) -> Array:
    """Heights of cables over those behind at crossings (c,), or nan, at an end of piece q."""
    s = p.spans(np.arange(len(p.h)) == q, p.clasps).within(2.0 * end - 1.0)
    chords = [(s.point(2 * k).v, s.across(k).v) for k in (p.clasps, p.behind)]
    x, y = intersections(*chords[0], *chords[1])
    return cable_heights(s, p.clasps, x) - cable_heights(s, p.behind, y)


def laid_contacts(alone: Plan) -> dict[int, tuple[Mask, Items, Array, Array, Array]]:
    """Return contacts of a robot's cable that is lifted after leaving (0), or laid to join (1).

    Values: mask of pieces on which it moves vertically from or to edges of a resting ring; crossed
    edges (k,), positions of crossings (k, 2), heights of its q at contact (k,), and 1 above or -1
    below the edge (k,). It lies on the edges at one end, and is clear of all at the other end.
    """
    ring, found = alone.beside, dict[int, Any]()
    still = np.max(np.ptp(ring.points.c[0][:, : ring.V.stop], axis=-1), axis=(1, 2)) <= TOUCH
    down = (alone.state == LAID) & alone.upright & ring.formed & still
    for end in (end for end in (0, 1) if alone.guests[end] >= 0 and down[-end]):
        order = slice(None, None, 1 - 2 * end)
        run = np.logical_and.accumulate(down[order])[order]
        c, points = (each.points.c[0][-end, ..., -end] for each in (alone, ring))
        a, way = points[ring.begin], points[ring.end] - points[ring.begin]
        here, there = intersections(c[:1], c[1:2] - c[:1], a, way)
        k = np.flatnonzero(~np.isnan(here))
        a, way, y = a[k], way[k], there[k]
        sag = 0.5 * ring.weight / ring.team[k, 0] * y * (1.0 - y) * length(way) ** 2
        s = alone.spans(np.arange(len(run)) == -end % len(run), 0 * k).within(2.0 * end - 1.0)
        gaps = cable_heights(s, 0 * k, here[k]) + sag - a[:, 2] - y * way[:, 2]
        far = gaps + alone.points.c[0][np.flatnonzero(run)[end - 1], 0, 2, end - 1] - c[0, 2]
        side, places = np.sign(far), a[:, :2] + y[:, None] * way[:, :2]
        good = (side * gaps >= -TOUCH) & (np.abs(gaps) <= SAG_TOL) & (side == side[:1])
        if np.all(good & (np.abs(far) >= alone.crossing[1])):
            found[end] = run, k, places, c[0, 2] - gaps, side
    return found


def roll_changes(p: Plan, run: Items) -> tuple[Array, Array, Mask]:
    """Return rolls at the start of a run, their changes (c,) [deg], and a mask of known changes.

    Rolls are sampled several times per piece, so that legs turn by much less than a right angle.
    """
    count, parts = len(p.clasps), 6
    places = np.repeat((np.arange(parts) + 0.5) / parts, count)
    q, x = np.repeat(run, len(places)), np.asarray(np.tile(places, len(run)), np.float64)
    c = np.tile(np.arange(count), parts * len(run))
    s = Spans(p, q, c[:, None], x, 0.0 * x + 0.5 / parts)
    k, j = p.clasps[c], p.behind[c]
    with np.errstate(all="ignore"):  # of legs that may vanish
        q_, r = (s.leg_chord(i).unit() for i in (2 * k, 2 * j + 1))
        axis, u = (q_ + r).unit(), s.edge(k)[0].unit() + s.edge(j)[1].unit()
        m, m0 = (y - axis * axis.dot(y) for y in (q_ - r, u))
        known = (m.reach < 0.5 * length(m.v)) & (m0.reach < 0.1 * length(m0.v))
    sine = np.sum(np.cross(m0.v, axis.v) * m.v, -1)
    angles = np.degrees(np.arctan2(sine, np.sum(m0.v * m.v, -1))).reshape(-1, count)
    steps = (np.diff(angles, axis=0) + 180.0) % 360.0 - 180.0
    return angles[0], np.sum(steps, axis=0), np.all(known.reshape(-1, count), axis=0)


def replay(
    p: Plan, passed: Array, ties: Array, around: Sequence[str]
) -> tuple[list[Fault], Array, Array]:
    """Replay half crossings of neighbours that are laid and roll, and add them to ``passed``.

    ``ties`` (2, c) are senses of ties, and which cable lies on top; they are updated from start to
    end. ``around`` are the states before and after.

    Returns faults and, on pieces with vertical motion, the sign (m, c) of the upper cable, and the
    smallest height of its q over the other one's, times that sign.
    """
    m, count, faults = len(p.h), len(p.clasps), list[Fault]()
    sign, end = np.zeros((m, count)), np.full((m, count), -BIG)
    sense, lies = ties
    runs = [(str(s), np.array([*q])) for s, q in groupby(range(m), lambda q: p.follows[q])]
    names = [around[0], *(s for s, _ in runs), around[1]]
    i, j = np.minimum(p.clasps, p.behind), np.maximum(p.clasps, p.behind)

    def wrong(q: int, bad: Any, words: str) -> None:
        faults.append((float(p.breaks[q]), bool(np.any(bad)), words))

    for at, (state, run) in enumerate(runs):
        before, after, q = names[at], names[at + 2], int(run[0])
        number = np.sum(passed[i, j, : q + 1], axis=-1)
        tied = np.abs(number) == 1.0
        if state == LAID:
            wrong(q, before != ROLLING and np.any(tied | (lies != 0.0)), "tied cables are laid")
            for straight, part in groupby(run.tolist(), lambda q: bool(p.upright[q])):
                pieces = [*part]
                ups = before == ROLLING and pieces[0] == q
                downs = after == ROLLING and pieces[-1] == run[-1]
                lying, e = ups or downs, int(not ups)  # at which end
                wrong(q, (ups and downs) or (lying and not straight), "cables that lie are moved")
                if not straight:
                    continue
                there, away = (crossing_heights(p, pieces[x - 1], 1 - x) for x in (1 - e, e))
                over, apart = np.sign(np.nan_to_num(away)), np.isnan(away) & (not lying)
                near = ~(apart | (np.abs(away) >= p.crossing[1]))  # if they cross, or do not rest
                wrong(q, near, "cables are not over each other")
                x = p.points.c[0][pieces[-e], :, 2, -e]
                rise = (x[2 * p.clasps] - x[2 * p.behind]) * over
                floor = rise if lying else rise - over * there + p.crossing[1]
                sign[pieces], end[pieces] = over, np.where(apart, -BIG, floor)
                wrong(q, lying and ~(np.abs(there) <= SAG_TOL), "cables do not lie")
                wrong(q, ups and over != lies, "a cable is lifted through another one")
                lies = over if downs else 0.0 * over
            if before == ROLLING:
                passed[i, j, q + 1] -= sense
        elif state == ROLLING:
            start, change, known = roll_changes(p, run)
            opened = np.abs(start) >= OPEN_ROLL
            lies = np.where(opened, np.sign(change), 0.0) if not before else lies
            wrong(q, ~known | (opened != (lies != 0.0)) | ~(opened | tied), "untied cables roll")
            passed[i, j, run[-1] + 1] += np.where(tied, 0.0, lies)
            sense = np.where(lies != 0.0, lies, sense)
            left = start + 180.0 * sense  # from where they lie across
            left = np.where(opened, (left + 180.0) % 360.0 - 180.0, left) + change
            across = np.abs(left) <= 180.0 - OPEN_ROLL
            wrong(q, ~across & (np.abs(left - 180.0 * sense) >= OPEN_ROLL), "pairs roll wrongly")
            wrong(q, across & (after == "hitched"), "half a roll is missing")
            lies = np.where(across, sense, 0.0)
        elif state == "hitched" and before not in ("", ROLLING):
            sense = number
    ties[:] = sense, lies
    return faults, sign, end


def clear_objects(p: Plan, b: int) -> Iterator[Row]:
    """Distances of a body to cables, other bodies, ground and walls."""
    body, stem, may = p.bodies[b], p.bodies[b].stem, allowed_contacts(p, b)
    held, items = p.holding[b][:, p.parts[:, 2]] & p.formed[:, None], range(len(p.parts))
    wound = p.grip[b][:, None] & (p.parts[:, 3] != p.parts[:, 4])  # edges around it, not legs
    off, inside = (p.spans(on, items, p.kinds) for on in (p.formed[:, None] & ~held, held & ~wound))
    free = p.spans(p.free, range(p.n), p.cables)
    moving, carried = (p.spans(x[b], [0], [body.name]) for x in (p.moving, p.held))
    enters = "enters m min"

    def beside(s: Spans, k: Index, slab: Slab) -> Line:
        """Height of hanging cables above the body, or level distance of their chords."""
        over = lowest(s, k) - p.poses.on(s, b)[2] - slab.upper - sway(s, k)
        over = over.where(p.state[s.piece] != "on the ground")
        return maximum(slab.grown(0.0, -BIG, BIG).gap(*s.ends(k, b)), over)

    def within(s: Spans, _: Index, slab: Slab) -> Line:
        """Return distances to walls and ceiling; the floor is a contact."""
        top = [s.world(b, np.append(x, slab.upper)) for x in slab.core]
        return wall_gap(s, top, -BIG, slab.radius)

    def others(s: Spans, _: Index, o: int, slab: Slab, block: Slab) -> Line:
        over = s.local(o, s.world(b, UP * slab.lower))[2] - block.upper
        touches = ((over + 2.0 * TOUCH) * 1e6).where(may[s.piece, o])  # allowed contacts
        return maximum(body_gap(s, b, slab, s, o, block), touches)

    ground = -1, Slab(None, BIG, -BIG, p.floor)
    for slab in body.slabs:
        yield prove(*p.object, off, lambda s, j, slab=slab: slab.gap(*s.part(j, b)))
        yield prove(*p.object, free, partial(beside, slab=slab))
        for o, block in (ground, *p.slabs):
            if o != b:
                yield prove(*p.object, moving, partial(others, o=o, slab=slab, block=block))
        yield prove(p.within, 0.0, carried, partial(within, slab=slab))

    def apart(s: Spans, _: Index, slab: Slab, o: int, block: Slab) -> Line:
        """Return the distance to a slightly smaller body, as surfaces may touch."""
        core = None if block.round else block.core + 1e-5 * (block.centroid - block.core)
        inner = Slab(core, (1.0 - 1e-5) * block.radius, block.lower + TOUCH, block.upper - TOUCH)
        return maximum(body_gap(s, b, slab, s, o, inner), body_gap(s, o, inner, s, b, slab))

    first = p.spans(np.arange(len(p.h)) == 0, [0], [body.name]).within(-1.0)
    for slab, (o, block) in product(body.slabs, p.slabs):
        if o != b and block.upper > block.lower and not (body.fixed and p.bodies[o].fixed):
            yield prove(enters, 0.5 * TOUCH, first, partial(apart, slab=slab, o=o, block=block))
    if body.height != stem.lower or body.rim is None:  # a slim pillar below a tray is none
        yield prove(enters, WRAP, inside, lambda s, j: stem.gap(*s.part(j, b)))
    s = p.spans(p.held[b], range(len(p.labels)), p.labels)
    yield prove(enters, -WRAP, s, lambda s, i: s.point(i)[2] - p.floor)


def body_gap(s: Spans, b: int, slab: Slab, t: Spans, o: int, block: Slab) -> Line:
    """Distance of a slab of body b of spans s to a block of body o of spans t."""
    seen = [t.local(o, s.world(b, np.append(x, slab.lower))) for x in (*slab.core, slab.core[0])]
    return block.grown(slab.radius, block.lower - slab.upper + slab.lower, block.upper).gap(*seen)


def allowed_contacts(p: Plan, b: int) -> Mask:
    """Return a mask of supports of a body by piece, the ground last, at lifts and descents."""
    c, bottom = p.poses.c[0], p.bodies[b].stem.lower
    upright = np.all(np.ptp(c[:, b, [0, 1, 3, 4]], axis=-1) <= TOUCH, axis=-1)
    runs, may = np.cumsum(~upright), np.zeros((len(c), len(p.bodies) + 1), dtype=bool)
    for q, end in ((q, end) for q in np.flatnonzero(upright) for end in (0, -1)):
        top, under = support_below(p, b, c[q, ..., end])
        if abs(c[q, b, 2, end] + bottom - top) <= TOUCH or (q == 0 and end == 0):
            may[upright & (runs == runs[q]), under] = True
    return may


def support_below(p: Plan, b: int, poses: Array) -> tuple[float, int]:
    """Return the height and the index of the support under a body (-1: the ground)."""
    c, (x, y, z), found = poses[b], p.bodies[b].centre, [(p.floor, -1)]
    centre = c[:3] + [c[3] * x - c[4] * y, c[4] * x + c[3] * y, z]
    for o, other in enumerate(p.bodies):
        top = float(poses[o, 2] + other.stem.upper)
        inside = other.stem.depth(in_frame(poses[o], centre)[:2]) >= 0.0
        found += [(top, o)] if o != b and inside and top <= centre[2] + TOUCH else []
    return max(found)


def resting(p: Plan, b: int) -> Iterator[Row]:
    """Clasps stay in place, friction holds the rim, and its force line is between the clasps."""
    body, on, rim = p.bodies[b], p.rest[b] & p.active[b], p.bodies[b].rim
    if rim is None or not p.closed:
        return
    q = p.hold_start[b]
    places = in_frame(p.poses.c[0][q, b, None, :, 0], p.points.c[0][q, p.V, :, 0])

    def off(s: Spans, j: Index) -> Line:
        """Displacements of clasps since the start of the hold, and from depths below the rim."""
        x, at, deep = s.local(b, s.point(p.begin[j])), places[s.piece, j], p.depth[b, s.piece, None]
        under, over = rim.lower - deep, np.where(p.lifted[b, s.piece, None], deep, 0.0) - rim.lower
        beyond = np.where(rim.depth(at[:, :2]) > CONTACT, 0.0, 1.0)[:, None]
        return maximum((x[:2] - at[:, :2]).norm(), -x[2] + under, x[2] + over, beyond)

    def slides(s: Spans, j: Index) -> Line:
        a = s.point(p.begin[j], 2)
        return (a[2] + G) * body.friction - a[:2].norm()

    def inside(s: Spans, j: Index) -> Line:
        """``n·(c - p_k) - h n·a / (g + a_z)`` of every side's inward normal n."""
        side = (places[s.piece, (j + 1) % p.n] - places[s.piece, j])[:, :2]
        n = direction(np.stack([side[:, 1], -side[:, 0]], -1))
        a = s.rotated(b, s.world(b, body.centre, 2))
        lean = a[:2].dot(n) * (a[2] + G).inverse() * (float(body.centre[2]) - rim.lower)
        return (
            (-s.local(b, s.point(p.begin[j]))[:2] + body.centre[:2]).dot(n) - lean - 2.0 * CONTACT
        )

    s, up = (p.spans(x, range(p.n), p.labels[p.V]) for x in (on, on & p.lifted[b]))
    yield prove("rim m max", CONTACT, s, off)
    yield prove("rim m/s² min", 0.0, s, slides)
    yield prove("support m min", 0.0, up, inside)


def gripped(p: Plan, b: int) -> Iterator[Row]:
    """Edges around a gripped body hold it, balance it, and are tangent to it."""
    body, stem, on, cables = p.bodies[b], p.bodies[b].stem, p.grip[b], range(p.n)
    away, around = length(stem.core - stem.centroid), float(np.max(length(stem.core))) + stem.radius
    turning = (np.max(away) + stem.radius) ** 2 / (stem.radius or np.min(away))
    q, contacts = p.hold_start[b], p.edges[1:3].ravel()
    start = in_frame(p.poses.c[0][q, b, None, :, 0], p.points.c[0][q, ..., 0][:, contacts])
    side = direction(start[..., :2] - stem.centroid)[..., ::-1] * [-1.0, 1.0]

    def ratio(s: Spans, _: Index) -> Line:
        """Slip load ``μ Σ T_k e^{-μ' β} θ_k`` over load ``m (b (g + a_z) + α R² / r)``."""
        slip = s.zero
        for k in cables:
            weak = (p.pulls.on(s, i) * capstan(s, i).inverse() for i in (2 * k, 2 * k + 1))
            slip = slip + angle(*(x[:2] for x in s.edge(k))) * minimum(*weak) * body.friction
        a = p.poses.on(s, b, 2)
        load = (p.borne.on(s, b) * (a[2] + G) + a[3:].norm() * turning) * body.mass
        return slip * maximum(load, 1e-6).inverse()

    def balance(s: Spans, _: Index) -> Line:
        """Residuals of forces and moments over the smallest tension, less ground friction."""
        up, share, centre = p.lifted[b, s.piece], p.borne.on(s, b), s.world(b, body.centre)
        force = s.world(b, body.centre, 2).where(up) * -body.mass - share * UP * (body.mass * G)
        moment, tensions = s.zero * UP, [s.edge_pull(k) for k in cables]
        for k in cables:
            leaving, arriving = s.edge(k)
            for end, u in ((0, -leaving.unit()), (1, arriving.unit())):
                pull = u * s.edge_pull(k)
                force = force + pull
                moment = moment + (s.point(p.edges[1 + end, k]) - centre).cross(pull)
        propped = (-share + 1.0) * (body.friction * body.mass * G)
        level_force = maximum(force[:2].norm() - propped, force[2].norm()).where(~up)
        whole = maximum(force.norm(), moment.norm() * (1.0 / around)).where(up)
        return (whole + level_force) * maximum(minimum(*tensions), MIN_TENSION).inverse()

    def spun(s: Spans, _: Index) -> Line:
        """Mean rotation against the contacts since the start of the hold [m]."""
        away = [s.local(b, s.point(int(i)))[:2] - stem.centroid for i in contacts]
        turned = sum((x.unit().dot(side[s.piece, j]) for j, x in enumerate(away)), s.zero)
        return turned.norm() * (around / len(contacts))

    def wrapped(s: Spans, k: Index) -> Line:
        """Errors of contacts from section and height, and depths of straight parts inside."""
        ends, (leaving, arriving) = [s.local(b, s.point(i)) for i in p.edges[1:3, k]], s.edge(k)
        bend = length(np.cross(direction(leaving.v), direction(arriving.v)))
        bent = (length(ends[1].v - ends[0].v) > WRAP) | (bend > 2.0 * WRAP)
        found = [leaving[0] * arriving[1] - leaving[1] * arriving[0]]  # [m²] turns to the left
        for x, way in zip(ends, s.edge(k), strict=True):
            near = stem.core[np.argmin(length(x.v[:, None, :2] - stem.core), axis=1)]
            apart = (x[:2] - near).norm() - stem.radius
            off, bounds = x[2] - start[s.piece, k, 2:], (x[2] - stem.upper, -x[2] + stem.lower)
            found += [y.where(bent) for y in (apart, -apart, off, -off, *bounds)]
            u = s.rotated(b, way)[:2]
            there, n = u.norm().high > WRAP, u.unit()
            for corner in stem.core:
                to = -x[:2] + corner
                found.append((n[0] * to[1] - n[1] * to[0] + stem.radius).where(there))
        return maximum(*found)

    bearing = on & np.any(p.borne.c[0][:, b, 0] > 0.0, axis=-1)
    yield prove("grip 1 min", 1.5, p.spans(bearing, [0], [body.name]), ratio)
    yield prove("equilibrium 1 max", 5e-3, p.spans(on, [0], [body.name]), balance)
    yield prove("grip wrap max", 3 * WRAP, p.spans(on, cables, p.cables), wrapped)
    yield prove("grip wrap max", CONTACT, p.spans(on & p.active[b], [0], [body.name]), spun)


# Several plans on one clock.


class Pair(Plan):
    """Two plans on common breaks; a plan rests before its start and after its end.

    Items of its spans are pairs of items. Minimum distances are the largest of all own plans.
    """

    def __init__(self, p: Plan, q: Plan, separation: dict[str, float], off: float) -> None:
        self.plans, self.size = (p, q), max(p.size, q.size)
        breaks = np.concatenate([p.breaks, q.breaks])
        self.breaks = np.unique(breaks.clip(max(p.since, q.since), min(p.until, q.until)))
        self.h = np.diff(self.breaks)
        self._set_distances(separation, off)

    def pieces(self, time: Array) -> Iterator[Items]:
        """Yield pieces of each plan at times (m,), the first or last one beyond its duration."""
        for p in self.plans:
            yield np.clip(np.searchsorted(p.breaks, time) - 1, 0, len(p.h) - 1)

    def both(self, s: Spans) -> Iterator[Spans]:
        """Yield spans of each plan."""
        for p, piece in zip(self.plans, self.pieces(s.time), strict=True):
            x = (s.time - p.breaks[piece]) / p.h[piece]
            own = Spans(p, piece, s.item, np.clip(x, 0.0, 1.0), 0.0 * x)
            own.t, own.zero, own.moves = s.t, s.zero, 1.0 * ((x > 0.0) & (x < 1.0))
            yield own

    def items(self, first: Solid, second: Solid) -> Spans:
        """Return spans of all pairs of items of both plans."""
        one, two = self.pieces(self.breaks[:-1] + 0.5 * self.h)
        items = np.indices((len(first[1]), len(second[1]))).reshape(2, -1).T
        return self.spans(first[0][one] & second[0][two], items, first[1], second[1])


Solid = tuple[Mask, Sequence[str], Callable[..., Any]]


def solids(p: Plan) -> list[Solid]:
    """Masks of pieces, names and corners of drones, straight parts of cables, sheets and strips."""
    drones, laid = (p.every, p.names, lambda s, i: [s.point(i)]), p.state == LAID
    sheets = (p.free & ~laid, p.cables, Spans.sheet), (laid, p.cables, Spans.strip)
    return [drones, (p.formed, p.kinds, Spans.part), *sheets]


def across(pair: Pair) -> Iterator[Row]:
    """Distances between drones and cables of two plans.

    Sheets below the chords contain hanging and lying cables. Distances to sheets are level or
    vertical ones. A cable that is laid on edges or lifted from them must not pass through them.
    """
    p, q = pair.plans
    low = [*laid_contacts(q).values()] if q.beside is p else []

    def ratio(a: list[Line], b: list[Line]) -> Line:
        return ((a[0] - b[0]) * pair.scale).norm()

    def apart(s: Spans, *items: Index, of: Sequence[Solid], how: Callable[..., Line]) -> Line:
        return how(*(x[2](t, k) for x, t, k in zip(of, pair.both(s), items, strict=True)))

    for (i, one), (j, two) in product(*(enumerate(solids(p)) for p in pair.plans)):
        how: Callable[..., Line] = prism_gap if max(i, j) > 1 else distance
        what, s = pair.cable if 0 in (i, j) else pair.crossing, pair.items(one, two)
        if i == j == 0:
            how, what = ratio, ("separation ratio min", 1.0)
        if (i, j) == (1, 3):
            for run, edges, *_ in low:
                s = s.select(~(run[s.piece] & np.isin(s.item[:, 0], 2 * p.n + edges)))
        yield prove(*what, s, partial(apart, of=(one, two), how=how))
    for run, edges, _, touch, side in low:

        def above(s: Spans, k: Index, touch: Array = touch, side: Array = side) -> Line:
            return (s.point(0 * k)[2] - touch[k, None]) * side[k, None]

        s = q.spans(run, range(len(edges)), [p.kinds[2 * p.n + k] for k in edges])
        yield prove("laid m min", -TOUCH, s, above)


def beside_objects(pair: Pair) -> Iterator[Row]:
    """Distances of drones, cables and objects of the first plan to other objects of the second.

    Distances of hanging cables are level ones.
    """
    p, q = pair.plans

    def foreign(p: Plan, q: Plan) -> Iterator[tuple[int, Slab, Solid]]:
        mine, theirs = (x.settings.get("objects", {}) for x in (p, q))
        for b, slab in p.slabs:
            name = p.bodies[b].name
            if np.any(p.moving[b]) or mine[name] != theirs.get(name):
                yield b, slab, (p.every, [name], Spans.world)

    def gap(s: Spans, *i: Index, b: int, slab: Slab, how: Any) -> Line:
        mine, theirs = pair.both(s)
        return slab.gap(*(theirs.local(b, x) for x in how(mine, i[0])[:2]))

    def between(s: Spans, *_: Index, b: int, slab: Slab, o: int, block: Slab) -> Line:
        mine, theirs = pair.both(s)
        return body_gap(mine, o, block, theirs, b, slab)

    room = pair.object[0], pair.object[1] + pair.tracking  # objects are as far off as drones
    for b, slab, body in foreign(q, p):
        for i, one in enumerate(solids(p)):
            what = room if i else ("keep_out m min", pair.sep["radius"] + pair.tracking)
            high = slab.grown(0.0, -BIG, BIG) if i > 1 else slab
            yield prove(*what, pair.items(one, body), partial(gap, b=b, slab=high, how=one[2]))
        for o, block, other in foreign(p, q):
            formula = partial(between, b=b, slab=slab, o=o, block=block)
            yield prove(*room, pair.items(other, body), formula)


# Checks at single times: joints, crossings, and the story.


def worst_row(name: str, unit: str, limit: float, found: Sequence[Worst]) -> Row:
    """Return a row of the largest of values with times and places."""
    worst, time, where = max(found, default=(0.0, 0.0, ""))
    good = worst <= limit + TOLERANCE * max(abs(limit), 1.0)
    return Row(name, unit, "proven" if good else "violated", worst, limit, "max", time, where, 1)


def fault_row(name: str, faults: Iterable[Fault]) -> Row:
    """Return a row of faults: the number of kinds, the first time, and words."""
    wrong = sorted((time, words) for time, bad, words in faults if bad)
    kinds = [*dict.fromkeys(words for _, words in wrong)]
    found = [(float(len(kinds)), wrong[0][0], ", ".join(kinds[:6]))] if wrong else []
    return worst_row(name, "1", 0.0, found)


def jumps(p: Plan, *, rests: bool = False) -> Iterator[Row]:
    """Jumps at joints of pieces: sums for positions, velocities and accelerations; thrusts, pulls.

    Where rings change, thrusts may jump by the weights of cables that lie on each other. A plan
    that ``rests`` before and after must be at rest at its ends.
    """
    parts, bodies = [*chain(*p.chapters)], [body.name for body in p.bodies]
    same = ~np.isin(p.breaks[1:-1], [x.since for x in parts])[:, None]
    both = (p.formed[1:] & p.formed[:-1])[:, None] & same

    def jump(
        c: Array, names: Sequence[str], on: Any = True, less: Any = 0.0, fold: Any = np.max
    ) -> Iterator[Worst]:
        x = (length(c[1:, ..., 0] - c[:-1, ..., -1]) - less) * on
        if x.size:
            i = int(np.argmax(each := fold(x, axis=0)))
            yield float(each[i]), float(p.breaks[np.argmax(x[:, i]) + 1]), names[i]

    def total(x: Array, axis: int) -> Array:
        """Return sums of jumps above rounding errors."""
        some = np.sum(np.where(x > 1e-9, x, 0.0), axis)
        return np.asarray(np.maximum(some, np.max(x, axis)))

    found, added = list[Worst](), partial(jump, fold=total)
    for k in range(3):
        found += [*added(p.points.c[k][:, : p.N], p.names), *added(p.poses.c[k], bodies)]
        found += added(p.points.c[k][:, p.V], p.labels[p.V], both)
        found += added(p.legs.c[k], p.names, both)
        for curve, names in ((p.points.c[k][:, : p.N], p.names), (p.poses.c[k], bodies)):
            for end in (0, -1) if rests and k else ():
                at = repeat(float(p.breaks[end]))
                found += zip(length(curve[end, ..., end]).tolist(), at, names, strict=False)
    yield worst_row("continuity", "m", 1e-6, found)
    if not p.n:
        return
    f = np.zeros((len(p.h), p.n, 2, 3, 2))  # thrusts as pieces begin and end
    for x in parts:
        s, pieces = x.spans(x.every, range(x.N)), np.isin(p.breaks[:-1], x.breaks[:-1])
        with np.errstate(all="ignore"):
            ends = [s.within(end).thrust(s.item[:, 0]).v for end in (-1.0, 1.0)]
        f[np.ix_(pieces, x.robots)] = np.stack(ends, -1).reshape(-1, x.n, 2, 3, 2)
    on, less = p.formed[:, None, None, None], p.weight * np.repeat(p.length[:, 0], 2) * ~same
    found = [*jump(f.reshape(-1, p.N, 3, 2), p.names, less=less)]
    found += [*jump(p.tensions.c[0] * on, p.cables, same), *jump(p.pulls.c[0] * on, p.names, same)]
    # At ends of a range of tensions, these are the team's unless something is held
    for x in (rings[0] for rings in p.chapters):
        held, ranged = np.pad(np.any(x.held, axis=0), 1, "edge"), np.append(x.ranged, -1)
        for q, end in product(np.flatnonzero(x.formed & (x.ranged >= 0)), (0, -1)):
            o = q - 1 - 2 * end  # no range before and after; what is held stays so
            if ranged[o] != ranged[q] and not (held[q + 1] and held[o + 1]):
                off = np.max(np.abs(x.tensions.c[0][q, :, :, end] - x.team))
                found.append((float(off), float(x.breaks[q - end]), "range"))
    yield worst_row("tension", "N", 1e-4, found)


def interlacing(p: Plan) -> Iterator[Row]:
    """Pairs of cables whose crossings contradict the states of phases."""
    faults, rings, first = list[Fault](), [chapter[0] for chapter in p.chapters], 0
    known = np.zeros((3, p.n, p.n))  # crossings, senses, and who lies on whom, [behind, ahead]
    known[:2, *rings[0].robots[rings[0].pair]] = float(p.formed[0])
    later = np.flip(np.logical_or.accumulate(np.flip(p.free)))  # cables are free then, or later
    names = ["", "", *(x.follows[end] for x in rings for end in (0, -1)), "", ""]
    for at, ring in enumerate(rings):
        loose = later[first : (first := first + len(ring.h))]
        faults += link_faults(ring, known, loose, names[2 * at + 1 : 2 * at + 5 : 3])
        if ring is not rings[-1]:
            faults += seam_faults(p.chapters[at], p.chapters[at + 1], known)
    if np.any(p.free) or np.any(np.isin(p.state, (LAID, ROLLING, LYING))):
        yield fault_row("interlacing", faults)


def link_faults(p: Plan, known: Array, loose: Mask, around: Sequence[str]) -> Iterator[Fault]:
    """Count crossings of ``loose`` chords in a chapter, and update all ties.

    A hitch keeps its links: chords are followed through it if cables are released later. On spans
    on which chords may touch, each must certainly cross the other, seen along their common normal;
    the sign of ``(q_j - q_i)·((r_i - q_i) × (r_j - q_j))`` changes with each crossing.
    """
    n, m = p.n, len(p.h)
    passed = np.zeros((n, n, m + 1))  # initial crossings, then those of each piece

    def sign(s: Spans, end: float) -> Array:
        """Return the sign at an end of spans; at joints that of the later piece."""
        x = s.x + end * s.w
        later = (x >= 1.0) & (s.piece < m - 1)
        there = Spans(p, s.piece + later, s.item, np.where(later, 0.0, x), 0.0 * x)
        i, j = s.item.T
        off = (there.point(2 * j) - there.point(2 * i)).v
        return np.asarray(np.sign(np.sum(off * np.cross(there.across(i).v, there.across(j).v), -1)))

    def decided(s: Spans, i: Index, j: Index) -> Line:
        ends, ways = (s.ends(i), s.ends(j)), (s.across(i), s.across(j))
        apart = distance(*ends).low > TOUCH
        normal, sure = direction(np.cross(ways[0].v, ways[1].v)), ~apart
        for way, (base, _), others in zip(ways, ends, ends[::-1], strict=True):
            a, b = (way.cross(x - base).dot(normal) for x in others)
            sure &= ((a.low > 0) & (b.high < 0)) | ((a.high < 0) & (b.low > 0))
        np.add.at(passed, (*s.item.T, s.piece + 1), 0.5 * (sign(s, 1.0) - sign(s, -1.0)) * sure)
        return Line(s.zero.v, s.zero.g, np.where(apart | sure, 0.0, BIG), s.t)

    # Laid or rolling neighbours have other checks, as have those beyond a guest's edge
    both, laid = np.triu_indices(n, 1), np.isin(p.state, (LAID, ROLLING, LYING))
    loose = loose[:, None] & ~(laid[:, None] & p.tied[both])
    for mask, legs, _ in corners_cut(p).values():
        loose[mask] &= np.any(np.stack(both, -1) != sorted(k // 2 for k in legs), axis=1)
    pairs = p.spans(loose, np.column_stack(both), p.cables, p.cables)
    row = prove("interlacing 1 min", 0.0, pairs, decided)
    yield row.time, row.verdict != "proven", row.where
    i, j, ties = np.minimum(*p.pair), np.maximum(*p.pair), known[:, *p.robots[p.pair]]
    passed[i, j, 0] = ties[0]
    if np.any(laid):
        yield from replay(p, passed, ties[1:], around)[0]
    count = np.cumsum(passed, axis=-1)
    ties[0] = count[i, j, -1]
    known[:, *p.robots[p.pair]] = ties
    want = np.where(p.tied[..., None], [CROSSINGS.get(state, -1) for state in p.state], 0)
    same = np.concatenate([[False], p.formed[1:] & p.formed[:-1], [False]])  # within a hitch
    wrong = (np.abs(count[..., 1:]) != want) & ~same[1:]
    wrong = (wrong | (np.abs(count[..., :-1]) != want) & ~same[:-1]) & (want >= 0)
    wrong[..., -1] |= (count[..., -1] != 0.0) & ~p.formed[-1]
    for k, o, q in np.argwhere(wrong & np.triu(np.ones((n, n), dtype=bool), 1)[..., None]):
        yield float(p.breaks[q]), True, f"{p.cables[k]}, {p.cables[o]}"


def seam_faults(one: list[Plan], other: list[Plan], known: Array) -> Iterator[Fault]:
    """Carry ties over to the next chapter, whose ring has one robot more or less.

    This robot moves vertically onto both neighbours, which lie across each other, from above or
    from below, and leaves likewise; the order at their corner remains. Rings of untied cables may
    change freely.
    """
    a, b, time = one[0], other[0], float(other[0].breaks[0])
    if UNTIED.issuperset((a.state[-1], b.state[0])):
        known[:] = 0.0
        laid = [*(x.state[-1] for x in one), *(x.state[0] for x in other)]
        yield time, LAID in laid, "a robot that waits is laid beside free cables"
        return
    joins = b.n > a.n
    less, more, end = (a, b, -1) if joins else (b, a, 0)
    k = more.guests[not joins]
    robot, *rest = np.roll(more.robots, -k).tolist()
    turned = [np.roll(less.robots, x).tolist() for x in range(less.n)]
    passes = more.state[-1 - end] == LYING and less.state[end] == ROLLING
    if k < 0 or not passes or rest not in turned:
        yield time, True, "rings differ otherwise than by a robot between neighbours that lie"
        return
    behind, ahead, alone = rest[-1], rest[0], (one if joins else other)[1:]
    low = laid_contacts(next(x for x in alone if x.robots == robot)).get(int(joins))
    corner, side, ends = corners_cut(more)[int(not joins)][2], 0.0, [more.begin[k], more.end[k]]
    if low is not None:
        (_, edges, places, _, above), new = low, more.points.c[0][-1 - end, :, :2, -1 - end][ends]
        near = length(places - new[1 * (less.robots[edges] == ahead)]) <= SAG_TOL
        if {*less.robots[edges].tolist()} == {behind, ahead}:
            side = float(above[0] * np.all(near))
    goes, comes = {(behind, ahead): corner}, {(behind, robot): side, (robot, ahead): -side}
    goes, comes = (goes, comes) if joins else (comes, goes)
    for pair, lies in (goes | comes).items():
        wrong = lies == 0.0 or (pair in goes and known[2, *pair] != lies)
        yield time, wrong, f"cables {pair[0]} and {pair[1]} do not lie as a robot joins or leaves"
        known[:, *pair] = 0.0, 0.0, lies * (pair in comes)
    (x, last), (y, first) = ((r.robots[r.pair].T, r.points.c[0][:, r.begin]) for r in (a, b))
    moved = length(last[-1, :, None, :, -1] - first[0, None, :, :, 0]) > TOUCH
    yield time, bool(np.any(moved & np.all(x[:, None] == y, axis=-1))), "a vertex moves"


def story(p: Plan) -> Iterator[Row]:
    """Contradictions of phases and objects, and the duration."""
    yield fault_row("story", (*phases(p), *objects(p)))
    if p.limits["duration"] is not None:
        end = float(p.breaks[-1])
        yield worst_row("duration", "s", p.limits["duration"], [(end, end, "")])


def phases(p: Plan) -> Iterator[Fault]:
    """Curves that contradict the states of cables in phases."""
    c = p.points.c[0][:, : p.N]
    for i, phase in enumerate(p.phases):
        at, state, on = phase["start"], phase["state"], p.phase == i
        s, k = p.spans(on & p.free, range(p.n)), np.tile(np.arange(p.n), np.sum(on & p.free))
        pulls = any(np.any(x.c[0][on & p.free]) for x in (p.legs, p.tensions, p.pulls))
        yield at, pulls, "tensions or legs without a hitch"
        if state == LAID:
            yield at, varies((c[:, 1::2] - c[:, 0::2])[on]), "cables turn as they are laid"
        if state in (ROLLING, LYING) and np.any(on):
            legs = p.legs.c[0][on]  # change as they sag, or as weight passes
            sag = (p.weight / p.team) ** 2 / 24.0 * np.max(legs, (0, -1)).reshape(p.n, 2) ** 3
            drift = SAG_TOL if state == LYING else (sag + 1e-4).reshape(legs.shape[1:-1])
            rolls = varies(p.points.c[0][on][:, p.V]) or varies(legs, drift)
            yield at, rolls, "vertices or legs move as pairs roll"
            T, pulled = p.tensions.c[0][on], p.pulls.c[0][on]
            other = np.ptp(p.team) > 0.0 or np.max(np.abs(pulled - np.repeat(T, 2, 1))) > 1e-4
            busy = np.any(p.load) or np.any(p.held[:, on]) or other
            yield at, bool(busy), "pairs with loads or unequal tensions roll"
            start, change, _ = roll_changes(p, np.flatnonzero(on))
            shut = np.abs([start, start + change]) < OPEN_ROLL
            yield at, bool(np.all(shut)), "no pair rolls, or lies across"
            passing = [mask for mask, *_ in corners_cut(p).values()]
            ends = np.all(np.any([*passing, ~on], axis=0))
            ends = ends and np.max(np.abs(change)) < 180 - OPEN_ROLL
            yield at, state == LYING and not ends, "cables pass weight as none joins or leaves"
        if p.n and state == "on the ground":
            with np.errstate(all="ignore"):
                depth = [np.min(lowest(s.within(x), k).v) for x in (-1.0, 0.0, 1.0)]
            high = min(depth) - p.floor > p.settings["separation"]["cable"] + RESOLUTION
            high |= varies(c[on][:, :, :2])
            yield at, high, "cables do not lie on the ground where they are said to"
        if state == "clasping":
            middle = 0.5 * (c[on][:, 2 * p.clasps] + c[on][:, 2 * p.behind + 1])
            yield at, varies(middle, RESOLUTION), "drones do not turn about each other"
        if state == "being tightened":
            over = s.around(k).v.reshape(-1, p.n) - (1.0 - 1e-4) * p.length[:, 0]
            full = np.sum(p.h[on] * (over @ p.team[:, 0] > 0.0)) > 0.5 * np.sum(p.h[on])
            yield at, full, "cables said to be slack are at their full length"


def objects(p: Plan) -> Iterator[Fault]:
    """Objects that stand on nothing, move without being held, or are carried wrongly."""
    c = p.poses.c[0]
    for b, body in enumerate(p.bodies):
        moving, busy, lifted, s = p.moving[b], p.active[b], p.lifted[b], p.spans(p.every, [b])
        head = [length(p.poses.at(s.within(x), b)[:, 3:]) for x in (-1.0, -0.5, 0.0, 0.5, 1.0)]
        under = np.array([support_below(p, b, x)[0] for x in c[..., 0]])
        falls = (np.abs(c[:, b, 2, 0] + body.stem.lower - under) > TOUCH) & ~lifted & ~moving
        loose, share = p.rest[b] & (body.rim is None or not p.closed), p.borne.c[0][:, b, 0]
        if p.n and not np.all(loose):
            seen = in_frame(c[:, b, None, :, 0], p.points.c[0][:, p.V, :, 0])
            side, to = (np.roll(seen, -1, 1) - seen)[..., :2], body.centre[:2] - seen[..., :2]
            right = side[..., 1] * to[..., 0] - side[..., 0] * to[..., 1] > 0.0
            loose |= p.rest[b] & ~np.all(right & (seen[..., 2] <= body.height + CONTACT), axis=1)
        for wrong, words in (
            (np.max(np.abs(np.array(head) - 1.0), axis=0) > TOUCH, "has no heading"),
            (np.max(np.abs(c[:1, b, :, 0] - body.pose)) > REST, "does not begin where it stands"),
            (busy & ~(p.held[b] & p.formed), "moves or is borne unheld"),
            (moving & ~lifted, "moves but is not borne"),
            (np.any((share < 0.0) | (share > 1.0), axis=-1), "is borne by a share beyond 0 to 1"),
            (busy & body.fixed, "is fixed, and moves"),
            (falls & (not body.fixed), "stands on nothing"),
            (p.grip[b] & (not p.n or not p.bent), "is gripped by straight edges"),
            (loose, "is not within clasps below its rim"),
        ):
            yield float(p.breaks[np.argmax(wrong)]), bool(np.any(wrong)), f"{body.name} {words}"


def recorded_request(p: Plan) -> dict[str, Any]:
    """Return the request that the file's contents imply, in the order of robots."""
    s, count = p.settings, p.n or p.N
    given = s.get("assignment") or {"robots": [*range(count)], "flipped": [False] * count}
    roles = [given["robots"].index(i) for i in range(count)]
    first, team = p.points.c[0][0, ..., 0].tolist(), {**s["team"]}
    start: dict[str, Any] = {"drones": first[: p.N]}
    if p.n:
        flown = [[2 * k + (end ^ given["flipped"][k]) for k in roles] for end in (0, 1)]
        start["drones"] = {"qr"[end]: [first[i] for i in flown[end]] for end in (0, 1)}
        team |= {"cable_length": p.length[roles, 0].tolist(), "tension": p.team[roles, 0].tolist()}
        if p.formed[0]:
            start["hitch"] = outline(p, 0, 0)
    said: dict[str, dict[float, Any]] = {"stiffness": {math.inf: None}}  # of numbers
    said |= {key: {0.0: False, 1.0: True} for key in ("integral", "feed_forward")}
    named, team["quadrotor"] = s.get("controllers") or [None], []  # one for all, or one per kind
    for k in roles:
        own = named[k % len(named)] or {}
        given = {key: float(x[k]) for key, x in p.given.items() if not own or key not in DEFAULTS}
        team["quadrotor"] += [own | {key: said.get(key, {}).get(x, x) for key, x in given.items()}]
    limits = {**s["limits"]}
    for key in ("tilt", "body_rate"):
        x = limits.pop(key)
        limits[f"{key}_deg"] = None if x is None else math.degrees(x)
    found = {"objects": s.get("objects", {}), "start": start, "team": team, "limits": limits}
    found |= {key: s[key] for key in ("separation", "arena", "keep_out")}
    found["problem"] = hashlib.sha256(s.get("problem", "").encode()).hexdigest()
    found["mission"] = [step_of(p, [*run]) for _, run in groupby(p.phases, lambda x: x["step"])]
    older = {"problem", "mission"} - s["asked"].keys()  # files of earlier releases
    return {key: x for key, x in found.items() if key not in older}


def step_of(p: Plan, run: list[dict[str, Any]]) -> dict[str, Any]:
    """Return tensions, holds and final positions of a step from its phases."""
    last = max(int(np.argmin(np.abs(p.breaks - run[-1]["end"]))) - 1, 0)
    x, poses = p.points.c[0][last, ..., -1], p.poses.c[0][last, ..., -1].tolist()
    found: dict[str, Any] = {"objects": {b.name: y for b, y in zip(p.bodies, poses, strict=True)}}
    if not p.n:
        return found | {"drones": x.tolist()}
    ranges, holds = ([y[key] for y in run if y[key] is not None] for key in ("tension", "hold"))
    whole = [min(low for low, _ in ranges), max(high for _, high in ranges)] if ranges else None
    found |= {"tension": whole, "polygon": None, "altitude": None}
    found["holds"] = [[*y] for y in dict.fromkeys((y["object"], y["by"]) for y in holds)]
    found |= {key: x for key, x in run[-1].items() if key == "ring"}
    return found | (outline(p, last, -1) if p.formed[last] else {})


def outline(p: Plan, q: int, end: int) -> dict[str, Any]:
    """Return the polygon and the altitude of a hitch at an end of a piece."""
    count = len(p.phases[p.phase[q]].get("ring", range(p.V.stop)))
    vertices = p.points.c[0][q, p.V, :, end][:count]
    return {"polygon": vertices[:, :2].tolist(), "altitude": float(np.mean(vertices[:, 2]))}


def differences(key: str, asked: Any, found: Any) -> Iterator[str]:
    """Yield differences of settings by keys; positions differ by more than TOUCH."""
    if isinstance(asked, dict) and isinstance(found, dict):
        for name in sorted(asked.keys() ^ found.keys()):
            yield f"{key}.{name} is {'not ' * (name in found)}asked"[1:]
        for name in sorted(asked.keys() & found.keys()):
            yield from differences(f"{key}.{name}", asked[name], found[name])
    elif isinstance(asked, list) and isinstance(found, list) and len(asked) == len(found):
        for i, pair in enumerate(zip(asked, found, strict=True)):
            yield from differences(f"{key}[{i}]", *pair)
    elif KINDS["number"](asked) and KINDS["number"](found):
        slack = TOUCH if key.startswith((".start", ".mission")) else 0.0
        if not math.isclose(asked, found, rel_tol=TOLERANCE, abs_tol=slack):
            yield f"{key[1:]} is {found}, asked {asked}"
    elif type(asked) is not type(found) or asked != found:
        yield f"{key[1:]} is {found}, asked {asked}"


def plan_rows(p: Plan) -> Iterator[Row]:
    """Yield the rows of all checks, several for some limits."""
    for part in chain(*p.chapters):
        taut = (taut_cables, cut_legs) if np.any(part.formed) else ()
        for check in (story, drones, *taut, *((free_cables,) if p.n else ())):
            yield from check(part)
        for check_of, b in product((resting, gripped, clear_objects), range(len(p.bodies))):
            yield from check_of(part, b)
    yield from (*jumps(p), *interlacing(p))


def read(path: Path) -> tuple[list[Plan], list[Plan]]:
    """Return the plans of a file: those of its teams, and others on the same clock."""
    try:
        with np.load(path, allow_pickle=False) as file:
            form, s = str(file["format"]), json.loads(str(file["settings"]))
            if len({*file}) < len([*file]):
                raise ValueError("holds something twice")
            if form == "hitchopt-plan/1":
                return [Plan(file, s)], []
            if form != "hitchopt-plan/2":
                raise ValueError("its format is neither hitchopt-plan/1 nor hitchopt-plan/2")
            return plans_of_groups(file, s)
    except Exception as error:  # malformed files raise many kinds
        words = " ".join(f"{type(error).__name__}: {error}".split())
        raise UnreadableError(words[:300]) from error


def plans_of_groups(file: Any, s: dict[str, Any]) -> tuple[list[Plan], list[Plan]]:
    """Return the plans of a file of format 2."""
    check_form("settings", s, "several")
    teams, others, asked = s["teams"], s["others"], s["asked"]["others"]
    names, plans = [*teams, *others], list[Plan]()
    if s["asked"]["teams"] != [*teams] or asked.keys() != others.keys() or not teams:
        raise ValueError("other groups are there than were asked")
    if len(names) < 2 or len({*names, "others"}) <= len(names):
        raise ValueError("groups are too few, or share a name")
    head = {key: s[key] for key in ("title", "problem") if key in s}
    for name, x in (*teams.items(), *others.items()):
        form = r"[^\W\d][\w-]*" + r"(\.[^\W\d][\w-]*)?" * (name in others)
        known = re.fullmatch(form, name) or (name == "" and [*teams] == [""])
        if not known or head.keys() & x.keys():
            raise ValueError(f"{name!r:.60} is no name, or has a title of its own")
        folder, at = f"{name}/" if name else "", 0.0
        if name in others:
            check_form(f"asked.others.{name}", asked[name], "other")
            folder, at = f"others/{name}/", asked[name]["at"]
        plans.append(Plan(file, head | x, folder, at))
    own = plans[: len(teams)]
    if max(abs(p.breaks[-1] - own[0].breaks[-1]) for p in own) > TOUCH:
        raise ValueError("teams do not cover the same time")
    for p in own:
        curves = p.points, p.poses, p.legs, p.pulls, p.tensions, p.borne
        for i in (i for i, phase in enumerate(p.phases) if phase["name"] == "wait"):
            if any(varies(x.c[0][p.phase == i], REST) for x in curves):
                raise ValueError(f"{p.label}phases[{i}] waits, but something moves")
    return own, plans[len(teams) :]


def verify(path: str | Path) -> Iterator[Row]:
    """Yield a row for every limit of a plan; UnreadableError if the file is not a plan."""
    path = Path(path)
    own, others = read(path / "plan.npz" if path.is_dir() else path)
    rows, order = [row for p in own for row in plan_rows(p)], ("violated", "not proven", "proven")
    if len(own) + len(others) > 1:
        rests = (row for p in (*own, *others) for row in jumps(p, rests=True))
        rows += (row for row in rests if row.name == "continuity")
    parts, besides = ([x for p in plans for x in chain(*p.chapters)] for plans in (own, others))
    keys, off = own[0].settings["separation"], max(p.tracking for p in own)
    wide = {key: max(p.settings["separation"][key] for p in own) for key in keys}
    for p, q in combinations([*parts, *besides], 2):
        if p in parts and max(p.since, q.since) < min(p.until, q.until):
            one, two = Pair(p, q, wide, off), Pair(q, p, wide, off)
            rows += [*across(one), *beside_objects(one), *beside_objects(two)]
    rows = [row for row in rows if row.samples]
    for name, unit in dict.fromkeys((row.name, row.unit) for row in rows):
        same = [row for row in rows if (row.name, row.unit) == (name, unit)]
        sign = 1.0 if same[0].sense == "min" else -1.0

        def left(row: Row, sign: float = sign) -> tuple[int, float]:  # limits of teams may differ
            return order.index(row.verdict), sign * (row.worst - row.limit) / abs(row.limit or 1.0)

        worst = min(same, key=left)
        verdict = "warning" if name == "ground" and worst.verdict != "proven" else worst.verdict
        yield worst._replace(verdict=verdict, samples=sum(row.samples for row in same))


def cells(row: Row) -> tuple[str, ...]:
    """Return cells of a row: check, worst, limit, unit, place, time and verdict."""
    shape, sense = row.unit in ("turn", "wrap", "bend"), "≥" if row.sense == "min" else "≤"
    name, unit = (f"{row.name} ({row.unit})", "") if shape else (row.name, row.unit.strip("1"))
    worst, limit, when = f"{row.worst:.5g}", f"{sense} {row.limit:.4g}", f"{row.time:.3f} s"
    return name, worst, limit, unit, row.where, when, row.verdict


def verdict(rows: Sequence[Row]) -> str:
    """Return the verdict of all rows in words."""
    bad = dict.fromkeys(row.name for row in rows if row.verdict not in GOOD)
    return f"not proven: {', '.join(bad)}" if bad else "proven: every limit holds at all times"


def main(arguments: Sequence[str]) -> int:
    """Print the rows of the plan in a directory; return 0 proven, 3 not proven, 2 unreadable."""
    if len(arguments) != 1:
        sys.stderr.write("usage: python verify.py DIR\n")
        return 2
    rows = []
    try:
        for row in verify(arguments[0]):
            rows.append(row)
            sys.stdout.write("{:16} {:>10} {:8} {:5} {:16} {:>9} {}\n".format(*cells(row)))
    except UnreadableError as error:
        sys.stderr.write(f"{arguments[0]}: not a plan, or a damaged one: {error}\n")
        return 2
    sys.stdout.write(f"{verdict(rows)}\n")
    return 0 if all(row.verdict in GOOD for row in rows) else 3


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
