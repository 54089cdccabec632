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

import json
import math
import re
import sys
import unicodedata
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cached_property, partial
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
Lazy = cached_property[Array]
Fault = tuple[float, bool, str]  # time [s], whether it applies, text
Worst = tuple[float, float, str]  # value, time [s], place

G, UP = 9.81, np.array([0.0, 0.0, 1.0])
FAR = 1e3  # ratio of bodies above a drone, which its downwash does not meet
BIG, TINY = 1e30, 1e-300
TOLERANCE, RESOLUTION = 1e-9, 1e-3  # of limits, and of worst values, relative to limits
REST_TOL, POS_TOL, CONTACT_TOL, WRAP_TOL = 1e-9, 1e-6, 1e-4, 2e-5  # [m] of the file format
MIN_GAP = 1e-4  # [m] smallest distance of cables that cannot pass through each other
OPEN_ROLL = 175.0  # [deg] smallest roll of an open clasp: at 180° cables run straight
PAST_ROLL = 0.286  # [deg] largest roll past 180°, where cables pull by 5e-3 of their tension
MIN_TENSION = 1e-3  # [N] smallest divisor of forces
HINGE = 0.03  # [m] smallest height of two clasps above the centre of mass of what they carry
PASSED = 0.4  # largest share of a cable's weight at a clasp that a cable below it may bear
EXACT_RANGE, LINKS = 0.5, 96  # of hanging cables: range of exact distances [m], links
OWN_DISTANCES = 2.0  # distance along a cable from which it counts for its drone, over the smallest
OWN_LINK = 0.75  # place of the end of the last link that does not count, over that distance
DEGREES = math.degrees(1.0)
BUDGET, CHUNK, DEPTH = 6_000_000, 8192, 46  # samples of a limit, samples at once, halvings
PASSING = {"proven", "warning"}  # the ground is unknown without an arena, hence warnings
CROSSINGS = {"on the ground": 0, "hanging free": 0, "being drawn taut": 0}
CROSSINGS |= {"being tightened": 1, "hitched": 1}  # of both cables of a clasp
LAID, ROLLING = "being laid", "rolling"  # single taut cables; pairs between crossing and clasp
CLASPING, TIGHTENED = "clasping", "being tightened"
UNLINKED = {"on the ground", "hanging free"}  # no links
DRAWN, BENT = "being drawn taut", "bent around an object"  # single cables, the latter with edges
OF_TWO = {*UNLINKED, DRAWN, BENT, ROLLING, "hitched"}  # states of two cables that clasp twice
STATES = {*CROSSINGS, "clasping", LAID, ROLLING, BENT, "none"}
SAME = 1e-9  # [m], [N] largest difference of contacts from midpoints, of pulls from tensions
MAX_COEFFS = 61  # coefficients of a curve
SAG_TOL = 0.02  # [m] largest gap of cables that lie on each other, due to different sags

# Keys of settings and their types: ? nullable, [] list, [2] list of two; keys with * may be absent.
TYPES = {
    "settings": "title:text problem:text groups:group[] others:group[]",
    "group": "name:text plan:text digest:text records:records",
    "records": "team:any requirements:requirements phases:phase[] assignment:roles?",
    "requirements": "limits:limits separation:separation arena:arena? keep_out:prism[] objects:any",
    "team": "robots:count cable_length:+[] topology:text cable_density:0+ cable_friction:0+ "
    "tension:+[] quadrotor:kind[] load:0+[]",
    "single": "drones:count quadrotor:kind[]",
    "kind": "mass:+ max_thrust:+ stiffness:+? integral:flag? feed_forward:flag? controller:text? "
    "gains:gains? latency:0+? model:text? trim*:number[2] thrust_factor*:+ tracking*:tube",
    "tube": "level:0+ height:0+",
    "gains": "kp:+[2]? kd:+[2]? ki:0+[2]?",
    "limits": "speed:+ acceleration:+ jerk:+ tilt:+ body_rate:+? vertex_speed:+ leg:+ duration:+? "
    "reserve:+ tracking:tube?",
    "separation": "radius:+ height:+ cable:0+ crossing:0+ object:0+",
    "arena": "lower:number[3] upper:number[3]",
    "prism": "polygon:number[2][] lower:number upper:number",
    "phase": "name:text step:count start:number end:number remark:text state:text tension:+[2]? "
    "hold:hold?",
    "hold": "object:text by:text cables:count[]",
    "roles": "robots:count[] flipped:flag[]",
    "body": "section:section lower:number upper:number mass:+ friction:0+ at:number[3] yaw:number "
    "rim:rim? fixed:flag",
    "section": "outline:number[2][]? radius:+?",
    "rim": "section:section height:number",
}
SCALARS: dict[str, Callable[[Any], bool]] = {
    "text": lambda x: type(x) is str,
    "flag": lambda x: type(x) is bool,
    "count": lambda x: type(x) is int and 0 <= x < 2**31,
    "number": lambda x: type(x) in (int, float) and abs(x) < BIG,
    "+": lambda x: SCALARS["number"](x) and x > 0,
    "0+": lambda x: SCALARS["number"](x) and x >= 0,
    "tube": lambda x: SCALARS["number"](x) and x >= 0,
    "any": lambda _: True,
}


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


def check_type(key: str, x: Any, form: str) -> None:
    """Raise ValueError with the key of a setting whose value is not of a type of ``TYPES``."""
    if x is None and "?" in form:
        return
    kind = form.rstrip("?")
    item, _, count = kind.rstrip("]").rpartition("[")
    if kind in TYPES and isinstance(x, dict):
        forms = dict(entry.split(":") for entry in TYPES[kind].split())
        absent = {name for name in forms if name[-1] == "*" and name[:-1] not in x}
        forms = {name.strip("*"): form for name, form in forms.items() if name not in absent}
        if forms.keys() != x.keys():
            names = ", ".join(sorted(forms.keys() ^ x.keys()))
            raise ValueError(f"{key} lacks keys, or has unknown ones: {names:.99}")
        for name, child in forms.items():
            check_type(f"{key}.{name}", x[name], child)
    elif item and isinstance(x, list) and count in ("", str(len(x))):
        for i, y in enumerate(x):
            check_type(f"{key}[{i}]", y, item)
    elif kind not in SCALARS or not SCALARS[kind](x):
        raise ValueError(f"{key} is {x!r:.60}, not of the type {form}")


class Line:
    """Vectors (m, d) on m spans of time, scalars as (m, 1), with bounds.

    ``v`` and ``g`` are value and slope at midpoints; ``q`` (m,) bounds the deviation of slopes from
    g on a span, and ``t`` (m,) is half of its duration [s]. Derived bounds: ``rate`` (m,) of
    slopes, ``deviation`` (m,) from v, ``low`` and ``high`` (m,) of scalars. Operands
    may also be constants: numbers, vectors (d,), or columns (m, d).
    """

    def __init__(self, v: Array, g: Array, q: Array, t: Array) -> None:
        self.v, self.g, self.q, self.t = v, g, q, t

    size: Lazy = cached_property(lambda self: norm(self.v))
    slope: Lazy = cached_property(lambda self: norm(self.g))
    rate: Lazy = cached_property(lambda self: self.slope + self.q)
    deviation: Lazy = cached_property(lambda self: self.rate * self.t)
    low: Lazy = cached_property(lambda self: self.v[:, 0] - self.deviation)
    high: Lazy = cached_property(lambda self: self.v[:, 0] + self.deviation)

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
        q = self.q * (o.size + o.deviation) + self.slope * o.deviation
        q = q + o.q * (self.size + self.deviation) + o.slope * self.deviation
        return Line(f(self.v, o.v), f(self.g, o.v) + f(self.v, o.g), q, self.t)

    def norm(self) -> Line:
        """``|y|' = û·y'``; û deviates by at most ``deviation / min |y|``."""
        n, u = self.size, normalize(self.v)
        positive, turn = n > self.deviation, self.slope * self.deviation / (n - self.deviation)
        g = np.sum(u * self.g, -1, keepdims=True) * positive[:, None]
        q = np.where(positive, self.q + turn, self.rate)
        return Line(n[:, None], g, q, self.t)

    def unit(self) -> Line:
        """Return directions; nan if vectors may vanish."""
        return self * self.norm().inverse()

    def map(self, f: Callable[[Array], Array], df: Callable[[Array], Array]) -> Line:
        """Apply a function with a monotone derivative to a non-negative scalar."""
        slope, ends = df(self.v), df(np.stack([np.maximum(self.low, 0.0), self.high]))
        q = np.max(np.abs(ends - slope[:, 0]), 0) * self.slope
        q = np.max(np.abs(ends), 0) * self.q + q
        return Line(f(self.v), slope * self.g, q, self.t)

    def inverse(self) -> Line:
        """``1 / f`` of a positive scalar."""
        return self.map(lambda x: 1.0 / x, lambda x: -1.0 / x**2)

    def where(self, on: Mask) -> Line:
        """Return zero outside a mask (m,)."""
        v, g = (np.where(on[:, None], x, 0.0) for x in (self.v, self.g))
        return Line(v, g, np.where(on, self.q, 0.0), self.t)

    def flat(self, ratio: float) -> Line:
        """Return points with heights divided by a ratio of at least 1."""
        by = np.array([1.0, 1.0, 1.0 / ratio])
        return self if ratio == 1.0 else Line(self.v * by, self.g * by, self.q, self.t)

    def unless(self, over: Line) -> Line:
        """Return FAR where a scalar is positive; this scalar bounds it where that is unsure."""
        far, low = over.v > 0.0, np.where(over.low > 0.0, FAR, np.minimum(self.low, FAR))
        v, g = np.where(far, FAR, self.v), np.where(far, 0.0, self.g)
        return Line(v, g, np.where(far[:, 0], (FAR - low) / self.t, self.q), self.t)


def norm(v: Array) -> Array:
    """Return lengths of vectors."""
    return np.abs(v[..., 0]) if v.shape[-1] == 1 else np.sqrt(np.einsum("...i,...i->...", v, v))


def normalize(v: Array) -> Array:
    """Return unit vectors; zero for zero vectors."""
    return v / np.maximum(norm(v), TINY)[..., None]


def varies(c: Array, tolerance: Array | float = POS_TOL) -> bool:
    """Return whether any polynomial (pieces, ..., N + 1) varies by more than a tolerance."""
    return c.size > 0 and bool(np.any(np.ptp(c, axis=(0, -1)) > tolerance))


def concatenate(*parts: Line) -> Line:
    """Return a vector from components."""
    v, g = (np.concatenate([getattr(p, k) for p in parts], axis=1) for k in "vg")
    return Line(v, g, np.sqrt(sum(p.q**2 for p in parts)), parts[0].t)


def minimum(first: Line, *others: Line | Array | float) -> Line:
    """Return the minimum of scalars; its slope is 0 where several may be the smallest."""
    lines = [first, *map(first.as_line, others)]
    keys = "v", "g", "q", "rate", "low", "high"
    v, g, q, rate, low, high = (np.stack([getattr(x, k) for x in lines]) for k in keys)
    at = np.argmin(v[..., 0], axis=0), np.arange(len(first.t))
    candidate = ~(low > high[at])
    unique = np.sum(candidate, axis=0) == 1
    q = np.where(unique, q[at], np.max(np.where(candidate, rate, 0.0), axis=0))
    return Line(v[at], g[at] * unique[:, None], q, first.t)


def maximum(first: Line, *others: Line | Array | float) -> Line:
    """Return the maximum of scalars."""
    return -minimum(-first, *(-x for x in others))


def angle(a: Line, b: Line) -> Line:
    """Return the angle between vectors [rad]: ``2 arcsin(|â - b̂| / 2)``."""
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
            difference = np.diff(self.c[-1], axis=-1) if n > 0 else 0.0 * self.c[-1]
            self.c.append(difference * (n / h)[:, None, None, None])
            self.noise.append(2.0 ** (k - 48) * math.perm(N, k) / h[:, None] ** k * max_step)
        self.bounds = [np.max(np.linalg.norm(x, axis=2), axis=-1, initial=0.0) for x in self.c]

    def at(self, s: Spans, i: Index, k: int = 0) -> Array:
        """Return k-th derivatives (m, d) of items i (m,) at midpoints."""
        c = self.c[k][s.piece, i]
        return np.asarray(np.einsum("mdj,mj->md", c, s.weights(c.shape[-1] - 1)))

    def on(self, s: Spans, i: Index, k: int = 0) -> Line:
        """Return k-th derivatives of items i (m,) on spans."""
        q = self.bounds[k + 2][s.piece, i] * s.t * s.moving + self.noise[k][s.piece, i] / s.t
        return Line(self.at(s, i, k), self.at(s, i, k + 1) * s.moving[:, None], q, s.t)


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
        self.t, self.names = np.maximum(w * plan.h[piece], 1e-12), names
        self.moving, self._weights = 1.0 + 0.0 * x, dict[int, Array]()
        self.zero = Line(0.0 * x[:, None], 0.0 * x[:, None], 0.0 * x, self.t)
        self.time = plan.breaks[piece] + x * plan.h[piece]

    def weights(self, n: int) -> Array:
        """Return Bernstein polynomials of degree n at midpoints (m, n + 1)."""
        if n not in self._weights:
            x, j = self.x[:, None], np.arange(n + 1)
            binomials = np.array([math.comb(n, k) for k in j.tolist()], dtype=float)
            self._weights[n] = binomials * x**j * (1.0 - x) ** (n - j)
        return self._weights[n]

    def select(self, k: Any) -> Spans:
        """Return selected spans."""
        return Spans(self.plan, self.piece[k], self.item[k], self.x[k], self.w[k], self.names)

    def subspan(self, middle: Array | float, width: float = 0.0) -> Spans:
        """Return parts of spans: midpoint and half width are relative to the half width."""
        x, w = self.x + middle * self.w, width * self.w
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

    def halves(self, k: Index, end: int) -> list[list[Line]]:
        """Return both ends of edge and leg beyond the contact at an end of cables, inside first."""
        inner, outer = self.point(self.plan.edges[3 * end, k]), self.point(2 * k + end)
        return [[self.point(self.plan.edges[1 + end, k]), inner], [inner, outer]]

    def ends(self, k: Index, b: int = -1) -> list[Line]:
        """Return both drones of cables in the frame of body b."""
        return [self.local(b, self.point(2 * k + end)) for end in (0, 1)]

    def level_chord(self, k: Index) -> list[Line]:
        """Return both drones of cables in the horizontal plane."""
        return [x[:2] for x in self.ends(k)]

    def sheet(self, k: Index) -> list[Line]:
        """Return corners of vertical triangles that contain hanging cables."""
        q, r = self.ends(k)
        return [q, r, (q + r - UP * self.plan.length[k]) * 0.5]

    def strip(self, k: Index) -> list[Line]:
        """Return corners of vertical strips below chords that contain laid cables.

        A cable is at most ``½ √(L² - c²) c / s`` below a chord c of horizontal length s.
        """
        q, r = self.ends(k)
        ratio = 1.0 - self.plan.sag[k] - 1e-4  # smallest chord over length
        depth = (r - q).norm() * (r - q)[:2].norm().inverse() * self.plan.length[k]
        depth = depth * (0.5 * np.sqrt(1.0 - ratio**2))
        return [q, r, q - depth * UP, r - depth * UP]

    def hull(self, k: Index, b: int = -1) -> list[Line]:
        """Return corners of upright regions that contain cables which clasp or are tightened.

        In plan view they span the hull of chord and route, over the middles of pairs that turn or
        over the vertices, and over the vertices of the hitch before or after.
        """
        p, ends = self.plan, []
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
        return [q, a, c, e, d, r, (q + r - UP * p.length[k]) * 0.5]

    def near_hulls(self, k: Index, x: Line, reach: float) -> Spans:
        """Return the spans on which points may be within a level reach of the hulls of cables."""
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
        return minimum(ratio, 1.0).where(self.plan.taut[self.piece])

    def inverse_tension(self, T: Line, k: Index) -> Line:
        """Return ``τ / T`` of segments of cables k of tension T."""
        p = self.plan
        ratio = maximum(p.tensions.on(self, k), p.min_tension[self.piece, k]).inverse()
        if not p.frictional:
            return ratio
        taut = self.tautness(k).low >= 1.0  # leg and edge tensions differ for taut cables only
        return ratio.where(~taut) + maximum(T, MIN_TENSION).inverse().where(taut)

    def chord_force(self, T: Line, k: Index, square: Line) -> Line:
        """Return ``√(T² - (w/2)² cos² γ)``: the chord force of segments of tension T.

        ``square`` is the squared horizontal length, and w the weight, ``τ ρ g`` per length.
        """
        if self.plan.weight == 0.0:
            return T
        half = self.inverse_tension(T, k) * (0.5 * self.plan.weight)
        rest = square * half * half
        return T * rest.map(lambda x: np.sqrt(1.0 - x), lambda x: -0.5 / np.sqrt(1.0 - x))

    def pull(self, i: Index) -> Line:
        """Return ``P = (w/2) sin γ + √(T² - (w/2)² cos² γ)``: forces of legs along their chords."""
        leg, k = self.leg_chord(i), i // 2
        weight = leg[2] * self.tautness(k) * (0.5 * self.plan.weight)
        return self.chord_force(self.plan.pulls.on(self, i), k, leg[:2].dot(leg[:2])) + weight

    def edge_pull(self, k: Index) -> Line:
        """Return the pull of edges; edges around objects have their full length, arcs included."""
        edge = (self.point(self.plan.end[k]) - self.point(self.plan.begin[k]))[:2]
        if self.plan.has_contacts:
            edge = -(self.leg(2 * k).norm() + self.leg(2 * k + 1).norm()) + self.plan.length[k]
        return self.chord_force(self.plan.tensions.on(self, k), k, edge.dot(edge))

    def thrust(self, i: Index) -> Line:
        """Return ``m (a + g ẑ) + P û + ½ ρ g d τ ẑ - (1 - τ) w``; w is a hanging cable's force."""
        p, force = self.plan, (self.point(i, 2) + G * UP) * self.plan.mass[i]
        if p.n:
            leg, tau = self.leg_chord(i), self.tautness(i // 2)
            taut = leg.unit() * self.pull(i) + leg.norm() * tau * (0.5 * p.weight) * UP
            force = force + taut.where(p.taut[self.piece])
            if p.weight > 0.0 and np.any(tau.low < 1.0):
                slack = -tau + 1.0
                hanging = catenary_force(self, i) * slack * p.weight
                force = force - hanging.where(slack.high > TOLERANCE)
        return force

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
        pose, up = self.plan.poses.on(self, b, k), float(x[2]) * (k == 0)
        c, r = pose[3], pose[4]
        return pose[:3] + concatenate(c * x[0] - r * x[1], r * x[0] + c * x[1], self.zero + up)


def prove(header: str, limit: float, s: Spans, formula: Callable[..., Line]) -> Row:
    """Halve spans until a limit is proven on all of them and the worst value is resolved.

    ``header`` is the name, the unit, and the sense min or max of the limit. The formula takes spans
    and the columns of their items.
    """
    name, unit, sense = header.split()
    sign = 1.0 if sense == "min" else -1.0
    target = sign * limit - TOLERANCE * max(abs(limit), s.plan.size if unit == "m" else 0.0)
    worst, time, where, verdict, samples, depth = math.inf, 0.0, "", "proven", 0, 0
    while len(s.x):
        bounds = []
        for part in (s.select(slice(i, i + CHUNK)) for i in range(0, len(s.x), CHUNK)):
            with np.errstate(all="ignore"):
                x = formula(part, *part.item.T) * sign
            bounds.append(np.nan_to_num(x.low, nan=-BIG))
            value = np.nan_to_num(x.v[:, 0], nan=-BIG)
            i = int(np.argmin(value))
            if value[i] < worst:
                worst, time = float(value[i]), float(part.time[i])
                where = ", ".join(s.names[c][k] for c, k in enumerate(part.item[i]))
        bound, depth, samples = np.concatenate(bounds), depth + 1, samples + len(s.x)
        undecided = bound < target
        error = max(RESOLUTION * max(abs(limit), 1e-3), 0.02 * (worst - target))
        if worst < target or (np.any(undecided) and (samples > BUDGET or depth > DEPTH)):
            verdict = "violated" if worst < target else "not proven"
            break
        s = s.select(undecided | ((bound < worst - error) & (samples < BUDGET // 3)))
        s = s.select(np.repeat(np.arange(len(s.x)), 2)).subspan(np.tile([-0.5, 0.5], len(s.x)), 0.5)
    return Row(name, unit, verdict, sign * worst, limit, sense, time, where, samples)


# Distances, along the shortest connections at midpoints.


def closest(a: Array, b: Array, c: Array, d: Array) -> Array:
    """Return the shortest vectors (m, d) from segments c d to segments a b."""
    u, v, w = b - a, d - c, a - c
    uu, vv, uv, uw, vw = (np.sum(x * y, -1) for x, y in ((u, u), (v, v), (u, v), (u, w), (v, w)))

    def share(x: Array, y: Array) -> Array:
        return np.clip(x / np.where(y > 0.0, y, 1.0), 0.0, 1.0)

    j = share(vw + share(uv * vw - vv * uw, uu * vv - uv**2) * uv, vv)
    return w + share(j * uv - uw, uu)[:, None] * u - j[:, None] * v


def distance(a: Sequence[Line], b: Sequence[Line], ratio: float = 1.0) -> Line:
    """Return the distance of points or segments, heights divided by a ratio."""
    a, b = ([x.flat(ratio) for x in corners] for corners in (a, b))
    w = normalize(closest(a[0].v, a[-1].v, b[0].v, b[-1].v))
    return minimum(*((x - y).dot(w) for x in a for y in b))


def hull_distance(a: Sequence[Line], b: Sequence[Line]) -> Line:
    """Return the distance of convex hulls in the plane, along that of their nearest sides."""
    sides = [[*combinations(x if x[1:] else [*x, *x], 2)] for x in (a, b)]
    gaps = [closest(*(y.v for y in (*p, *q))) for p, q in product(*sides)]
    nearest = np.argmin([norm(x) for x in gaps], axis=0)
    w = normalize(np.stack(gaps)[nearest, np.arange(len(nearest))])
    return minimum(*((x - y).dot(w) for x in a for y in b))


def prism_gap(a: Sequence[Line], b: Sequence[Line], ratio: float = 1.0) -> Line:
    """Return horizontal distances, or vertical ones of all corners, divided by a ratio.

    In plan view, bodies are on their first two corners, or in the hull of all but the last of more
    than four corners.
    """
    z_coordinates = [[x.flat(ratio)[2] for x in corners] for corners in (a, b)]
    (low, floor), (high, top) = ([f(*z) for z in z_coordinates] for f in (minimum, maximum))
    outlines = [[x[:2] for x in (c[:2] if len(c) < 5 else c[:-1])] for c in (a, b)]
    horizontal = (distance if max(map(len, outlines)) < 3 else hull_distance)(*outlines)
    return maximum(horizontal, low - top, floor - high)


class Slab:
    """A convex section between two heights: clockwise corners and a radius around them."""

    def __init__(self, outline: Any, radius: Any, lower: float, upper: float) -> None:
        self.round, self.radius = outline is None, radius or 0.0
        self.lower, self.upper = lower, upper
        self.core = np.array([[0.0, 0.0]] if outline is None else outline, dtype=float)
        self.sides = np.roll(self.core, -1, 0) - self.core
        self.normals = normalize(np.stack([-self.sides[:, 1], self.sides[:, 0]], -1))
        turn, area = (np.sum(self.normals * np.roll(x, -1, 0), -1) for x in (self.sides, self.core))
        if lower > upper:
            raise ValueError("a body's lower height is above its upper height")
        if self.radius <= 0.0 if self.round else self.radius < 0.0 or np.any(turn >= 0.0):
            raise ValueError("a section is neither a convex, clockwise outline nor a circle")
        area = (area * norm(self.sides))[:, None]
        middle = (self.core + np.roll(self.core, -1, 0)) / 3.0
        self.centroid = np.sum(middle * area, 0) / np.maximum(np.sum(area), TINY)

    def depth(self, x: Array) -> Array:
        """Return a lower bound of the depth of points (…, 2) inside; negative outside."""
        to = x[..., None, :] - self.core
        inside = -np.max(np.sum(to * self.normals, -1), -1)
        return -norm(to[..., 0, :]) + self.radius if self.round else inside

    def gap_vectors(self, x: Array) -> Array:
        """Return the shortest vectors to points (m, 3)."""
        to = x[:, None, :2] - self.core
        share = np.sum(to * self.sides, -1) / np.maximum(np.sum(self.sides**2, -1), TINY)
        gaps = to - np.clip(share, 0.0, 1.0)[..., None] * self.sides
        gap = gaps[np.arange(len(x)), np.argmin(norm(gaps), axis=1)]
        beyond = np.maximum(norm(gap) - self.radius, 0.0) * (self.depth(x[:, :2]) < 0.0)
        above = x[:, 2] - np.clip(x[:, 2], self.lower, self.upper)
        return np.column_stack([normalize(gap) * beyond[:, None], above])

    def enlarged(self, radius: float, lower: float, upper: float) -> Slab:
        """Return a slab with a larger radius, between the given heights."""
        return Slab(None if self.round else self.core, self.radius + radius, lower, upper)

    def scaled(self, by: Array) -> Slab:
        """Return the slab in coordinates scaled by (3,), the first two alike."""
        core = None if self.round else self.core * by[:2]
        return Slab(core, self.radius * by[0], self.lower * by[2], self.upper * by[2])

    def below(self, x: Line, lead: float) -> Line:
        """Return the distance to a point, large where the slab is above it by a ``lead``."""
        return self.gap(x).unless(-x[2] + self.lower - lead)

    def gap(self, *points: Line, ratio: float = 1.0) -> Line:
        """Return the distance to the convex hull of points, by its edges.

        Heights are divided by a ratio.
        """
        if ratio != 1.0:
            flat = self.scaled(np.array([1.0, 1.0, 1.0 / ratio]))
            return flat.gap(*(x.flat(ratio) for x in points))
        gaps = []
        for a, b in pairwise(points if points[1:] else points * 2):
            low, high = np.zeros((len(a.v), 1)), np.ones((len(a.v), 1))
            for _ in range(60 if a is not b else 0):
                x, y = low + (high - low) / 3.0, high - (high - low) / 3.0
                one, two = (norm(self.gap_vectors(a.v + z * (b.v - a.v))) for z in (x, y))
                low, high = np.where(one > two, x.T, low.T).T, np.where(one > two, high.T, y.T).T
            w = normalize(self.gap_vectors(a.v + low * (b.v - a.v)))
            most = np.max(w[:, :2] @ self.core.T, -1) + self.radius * norm(w[:, :2])
            most += np.maximum(self.lower * w[:, 2], self.upper * w[:, 2])
            gaps.append(minimum(*(p.dot(w) for p in points)) - most[:, None])
        return maximum(*gaps)


class Body:
    """An object: its stem and rim, its first pose and its centre of mass in its own frame."""

    def __init__(self, name: str, o: dict[str, Any]) -> None:
        check_type(f"objects.{name}", o, "body")
        self.name, self.fixed, rim = name, bool(o["fixed"]), o["rim"]
        sections = [o["section"], *([rim["section"]] if rim else [])]
        if any((x["outline"] is None) == (x["radius"] is None) for x in sections):
            raise ValueError(f"objects.{name} needs either an outline or a radius for each section")
        self.mass, self.friction = float(o["mass"]), float(o["friction"])
        self.stem, self.rim = Slab(**o["section"], lower=o["lower"], upper=o["upper"]), None
        self.height = o["lower"] if rim is None else rim["height"]
        if rim is not None:
            self.rim = Slab(**rim["section"], lower=self.height, upper=self.height)
        self.slabs = [slab for slab in (self.stem, self.rim) if slab]
        self.pose = np.array([*o["at"], math.cos(o["yaw"]), math.sin(o["yaw"])])
        self.centre = np.append(self.stem.centroid, 0.5 * (self.stem.lower + self.stem.upper))


def tube_of(tracking: Any) -> tuple[float, float]:
    """Return level and upright tracking errors [m] of a limit."""
    if not isinstance(tracking, dict):
        tracking = {"level": tracking or 0.0, "height": tracking or 0.0}
    if tracking["height"] > 0.0 == tracking["level"]:
        raise ValueError("limits.tracking has a height without a level")
    return float(tracking["level"]), float(tracking["height"])


class Plan:
    """Contents of a plan file: curves of all moving points, and their limits.

    Points are N drones, then P vertices, then the two contacts of every edge with an object; twice
    the midpoint for a straight edge. Cable k runs from q_k via vertices begin[k] and end[k] to r_k.
    The i-th leg starts at point anchor[i] and pulls at point pull_point[i]. If cables bend on their
    own, further points are the inner ends of legs: their own ones then, and vertices otherwise.
    """

    erring_bodies = 1  # of drones and what is below them: objects that stand have no errors

    def __init__(self, file: Any, head: dict[str, Any], folder: str = "") -> None:
        self.file, self.folder, records = file, folder, head["records"]
        self.label = f"{head['name']}." if head["name"] else ""
        self.settings = {**records, **records["requirements"]}
        team = records["team"]
        check_type("team", team, "team" if "robots" in team else "single")
        self._read(self.settings)

    def _array(self, name: str, *shape: int, bound: float = 1e5) -> Array:
        """Return an array of the file; a polynomial if its shape has several numbers.

        Its drones and cables are in the order of their places.
        """
        x: Array = self.file[self.folder + name]
        fits = (x.shape[:-1] if shape[1:] else x.shape) == shape and x.dtype == np.float64
        fits &= x.shape[-1] > 0 and [*self.file].count(self.folder + name) == 1
        fits &= not shape[1:] or x.shape[-1] <= MAX_COEFFS
        if not fits or not np.all(np.abs(x) <= bound):
            raise ValueError(f"{name} has a wrong shape, or numbers beyond their bounds")
        if name == "drones":
            return x[:, self.drone]
        if name == "tensions":
            return x[:, self.robot]
        if self.n and name in ("legs", "leg_tensions", "contacts", "anchors"):
            ends = x.reshape(len(x), len(self.drone), *x.shape[3:])
            return np.asarray(ends[:, self.drone].reshape(x.shape))
        return x

    def _set_distances(self, separation: dict[str, float], tube: tuple[float, float]) -> None:
        """Set minimum distances, larger by the effect of tracking errors, level and upright [m].

        Where heights are divided by ``ratio`` of the errors, errors are within a ball, and no
        distance is longer.
        """
        self.sep, self.tube, (error, height) = dict(separation), tube, tube
        self.tracking, self.ratio = error, max(1.0, height / error) if error else 1.0
        self.scale = 0.5 / self._semi_axes(separation, error)
        for key, factor in (("radius", 1.0), ("cable", 2.0), ("crossing", 2.0), ("object", 1.0)):
            self.sep[key] += factor * error
        errors = error * self.erring_bodies
        self.wash = 1.0 / self._semi_axes(separation, errors)
        self.wash_lead = errors * self.ratio * float(self.wash[2])
        names = "cable_clearance", "crossing", "object_clearance"
        limits = ((f"{x} m min", max(float(self.sep[x.split("_")[0]]), MIN_GAP)) for x in names)
        self.cable_limit, self.crossing_limit, self.object_limit = limits

    def _semi_axes(self, separation: dict[str, float], error: float) -> Array:
        """Return those of the ellipsoid that contains a drone's one and a ball of errors.

        It has the smallest radius.
        """
        wide, high = separation["radius"], separation["height"] / self.ratio
        high = math.sqrt((high**2 + wide * error) * (1.0 + error / wide))
        return np.array([wide + error, wide + error, high * self.ratio])

    def _read(self, s: dict[str, Any]) -> None:
        team, self.breaks, self.phases = s["team"], self.file[f"{self.folder}breaks"], s["phases"]
        self.limits, self.arena, label = dict(s["limits"]), s["arena"], self.label
        self._set_distances(s["separation"], tube_of(self.limits["tracking"]))
        self.limits["leg"] += 2.0 * self.tracking  # vertices may be off as far as drones
        self.h, self.n = np.diff(self.breaks), int(team.get("robots", 0))
        m, n, self.closed = len(self.h), self.n, team.get("topology") == "closed"
        N, P = 2 * n or int(team["drones"]), n if self.closed else n + (n > 0)
        self.N, self.V, self.all_pieces = N, slice(N, N + P), np.ones(m, dtype=bool)
        if m < 1 or not np.all(self.h > 0.0):
            raise ValueError(f"{label}breaks do not increase")
        self._array("breaks", m + 1, bound=BIG)
        self.two = self.closed and n == 2  # both cables clasp each other twice, around an object
        if n and (team["topology"] not in ("closed", "open") or n < 2):
            raise ValueError("team has too few robots, or a topology other than closed or open")
        if self.limits["reserve"] > 1.0 or self.limits["tilt"] >= 0.5 * math.pi:
            raise ValueError("limits.reserve is above 1, or limits.tilt is not below 90 degrees")
        box = s["arena"] or {"lower": [0.0], "upper": [1.0]}
        if np.any(np.array(box["lower"]) >= box["upper"]):
            raise ValueError("arena has a lower bound that is not below its upper bound")
        self._read_quadrotors(team)
        self._read_places(s["assignment"])
        self.names = [f"{label}{'qr'[i % 2]}{i // 2}" if n else f"{label}d{i}" for i in self.drone]
        self.cables = [f"{label}cable {i}" for i in self.robot]
        self.labels = [*self.names, *(f"{label}p{j}" for j in range(P)), *np.repeat(self.cables, 2)]
        self.floor = 0.0 if self.arena is None else float(self.arena["lower"][2])
        self.arena_row = "ground m min" if self.arena is None else "arena m min"
        ends = [float(phase["end"]) for phase in self.phases[:-1]]
        self.phase = np.searchsorted(ends, self.breaks[:-1] + 0.5 * self.h)
        self._check_phases()
        self._set_states()
        self._read_bodies(m, n)
        curves = [self._array("drones", m, N, 3), *self._read_cables(m, n, N, P)]
        drones, *on_cables = (elevate(x, max(y.shape[-1] for y in curves)) for x in curves)
        self.points = Curve(np.concatenate([drones, *on_cables], axis=1), self.h)
        used = drones, *(x[self.taut] for x in on_cables)
        self.size = max(float(np.max(np.abs(x), initial=0.0)) for x in used)
        self.length_loss, self.pull_loss, self.rim_depth, self.shares = rim_loads(self)
        # Ramps: tensions rise from 0, or fall to it, at rest next to pieces without a hitch.
        still = np.delete(self.points.c[0], self.edges[1:3].ravel(), axis=1)
        rest = np.all(np.ptp(still, axis=-1) <= REST_TOL, axis=(1, 2))
        reached = ~self.taut
        for _ in range(m):
            reached[1:] |= rest[1:] & reached[:-1]
            reached[:-1] |= rest[:-1] & reached[1:]
        self.ramp = reached & self.taut
        self.vertical = np.max(np.ptp(drones[:, :, :2], axis=-1), axis=(1, 2)) <= POS_TOL

    def _read_quadrotors(self, team: dict[str, Any]) -> None:
        """Read masses and thrusts (N, 1) of drones."""
        n, N = self.n, self.N
        kinds = team["quadrotor"]
        counts = [len(team[key]) for key in ("cable_length", "tension") if n]
        counts += [(n or N) if len(kinds) == N else len(kinds)]  # of drones, or of robots
        if {*counts} != {n or N} or (n and len(team["load"]) != n - 1 + self.closed):
            raise ValueError("team has a wrong number of kinds, lengths, tensions or loads")
        self.mass, self.max_thrust = (
            np.repeat([[float(kind[key])] for kind in kinds], N // len(kinds), axis=0)
            for key in ("mass", "max_thrust")
        )

    def _read_places(self, assignment: dict[str, Any] | None) -> None:
        """Read which robot (n,) and which drone (N,) of the problem is at each place.

        Robot ``robot[k]`` holds edge k, and cables and drones are in the order of places from here.
        """
        n, roles = self.n, assignment or {"robots": [*range(self.n)], "flipped": [False] * self.n}
        if (sorted(roles["robots"]), len(roles["flipped"])) != ([*range(n)], n):
            raise ValueError(f"{self.label}assignment is no permutation")
        self.robot = np.array(roles["robots"], dtype=int)
        self.edge = np.argsort(self.robot)
        first = 2 * self.robot + np.array(roles["flipped"], dtype=int)  # at the edges' starts
        self.drone = np.column_stack([first, first ^ 1]).ravel() if n else np.arange(self.N)
        self.mass, self.max_thrust = self.mass[self.drone], self.max_thrust[self.drone]

    def _set_states(self) -> None:
        """Set states of pieces, and masks of those with a hitch, and with taut parts of cables."""
        self.state = np.array([phase["state"] for phase in self.phases])[self.phase]
        self.formed = np.isin(self.state, ("hitched", ROLLING))
        self.bent = self.state == BENT
        self.taut = self.formed | self.bent
        self.free = ~self.taut & (self.n > 0)

    def _check_phases(self) -> None:
        """Raise ValueError unless phases are consecutive and consistent."""
        end, before = self.breaks[0], dict[str, Any]()
        objects = self.settings["objects"]
        for i, phase in enumerate(self.phases):
            start, state, range_, hold = (phase[x] for x in ("start", "state", "tension", "hold"))
            follows, end = abs(start - end) <= POS_TOL and start < phase["end"], phase["end"]
            same = state == before.get("state")
            at_break, before = same or np.min(np.abs(self.breaks - start)) <= POS_TOL, phase
            known = not hold or (hold["object"] in objects and hold["by"] in ("rest", "grip"))
            known &= {*range(self.n)}.issuperset(hold["cables"] if hold else ())
            known &= not (self.two and hold) or (hold["by"], len({*hold["cables"]})) == ("grip", 2)
            states = OF_TWO if self.two else STATES - {BENT}
            for valid, text in (
                (follows, "does not start at the end of the previous phase"),
                (at_break, "changes the state within a piece"),
                (state in states and (state == "none") is (self.n == 0), f"has the state {state}"),
                (range_ is None or range_[0] <= range_[1], "has an empty range of tensions"),
                (known, "holds an unknown object, or with unknown cables"),
            ):
                if not valid:
                    raise ValueError(f"{self.label}phases[{i}] {text}")
        if abs(end - self.breaks[-1]) > POS_TOL:
            raise ValueError("phases do not end with the plan")

    def _read_bodies(self, m: int, n: int) -> None:
        """Read objects, masks of their holds (o, m), and of the cables that hold them (o, m, n)."""
        self.bodies = [Body(name, o) for name, o in self.settings["objects"].items()]
        o, prisms = len(self.bodies), self.settings["keep_out"]
        self.slabs = [(b, slab) for b, body in enumerate(self.bodies) for slab in body.slabs]
        self.walls = [(-1, Slab(e["polygon"], None, e["lower"], e["upper"])) for e in prisms]
        self.rest, self.grip, self.holding = *np.zeros((2, o, m), bool), np.zeros((o, m, n), bool)
        for p, hold in enumerate(self.phases[p]["hold"] for p in self.phase):
            if hold is not None:
                j = [b.name for b in self.bodies].index(hold["object"])
                {"rest": self.rest, "grip": self.grip}[hold["by"]][j, p] = True
                self.holding[j, p, self.edge[hold["cables"]]] = True
        self.poses = Curve(self._array("poses", m, o, 5), self.h)
        first = np.array([b.pose for b in self.bodies]).reshape(o, 5)
        if np.any(np.abs(self.poses.c[0][0, ..., 0] - first) > REST_TOL):
            raise ValueError(f"{self.label}an object starts at another pose")
        share = self._array("load_share", m, o)
        share = np.where(np.abs(share - np.round(share)) <= 2.0**-40, np.round(share), share)
        self.load_share = Curve(share[:, :, None], self.h)
        self.held, self.lifted = self.rest | self.grip, np.all(share == 1.0, axis=-1).T
        self.moving = np.any(np.ptp(self.poses.c[0], axis=-1) > REST_TOL, axis=-1).T
        self.active = self.moving | np.any(share != 0.0, axis=-1).T  # moving or loaded (o, m)
        since = np.where(self.active & np.roll(self.active, 1, axis=1), 0, np.arange(m))
        self.hold_start: Items = np.maximum.accumulate(since, axis=1)  # first pieces

    def _read_cables(self, m: int, n: int, N: int, P: int) -> list[Array]:
        """Read cables; return coefficients of vertices and of contacts of edges."""
        none = {"cable_density": 0.0, "cable_friction": 0.0, "load": 0.0}
        team = none | {"cable_length": [], "tension": []} | self.settings["team"]
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
        self.length: Array = np.array(team["cable_length"], dtype=float)[self.robot, None]
        self.team: Array = np.array(team["tension"], dtype=float)[self.robot, None]
        vertices, T = self._array("vertices", m, P, 3), self._array("tensions", m, n)
        middle, both = midpoints(vertices, n), np.stack([T, T], 2)
        contacts, pulls = self._array("contacts", m, n, 2, 3), self._array("leg_tensions", m, n, 2)
        self.has_contacts = differ(contacts, middle) or bool(np.any(self.bent))
        self.frictional = differ(pulls, both)
        contacts = contacts if self.has_contacts else middle
        pulls = pulls if self.frictional else both
        legs = self._array("legs", m, n, 2)
        flat = (x.reshape(m, 2 * n, 1, x.shape[-1]) for x in (pulls, legs))
        self.pulls, self.legs = (Curve(x, self.h) for x in flat)
        self.tensions = Curve(T[:, :, None], self.h)
        on_cables = [vertices, contacts.reshape(m, 2 * n, 3, contacts.shape[-1])]
        if np.any(self.bent):
            on_cables.append(self._inner_ends(vertices))
        self._read_ties(vertices)
        self.clasped = np.zeros((n, n), dtype=bool)  # cables that clasp each other
        self.clasped[self.clasps, self.behind] = self.clasped[self.behind, self.clasps] = True
        # Phases that state a range of tensions (m,), and the ranges (m, n, 2) [N].
        self.range_phase, self.tension_range = np.full(m, -1), np.tile(self.team, (m, 1, 2))
        for i, phase in enumerate(self.phases):
            if phase["tension"] is not None:
                within = self.breaks[:-1] >= phase["start"] - POS_TOL
                within &= self.breaks[1:] <= phase["end"] + POS_TOL
                self.range_phase[within], self.tension_range[within] = i, phase["tension"]
        self.min_tension = np.minimum(self.tension_range[..., :1], self.team)
        self.sag = np.asarray(np.square(self.weight * self.length / self.team) / 24.0)  # relative
        # Straight segments of taut cables: both points, cable, and vertices at the ends (k, 5).
        ends, on = self.edges[:: 1 if self.has_contacts else 3], np.flatnonzero(self.leg)
        rows = [(self.anchor[on], on, on // 2, own.ravel()[on], own.ravel()[on])]
        rows += [(a, b, k, self.begin, self.end) for a, b in pairwise(ends)]
        self.segments = np.concatenate([np.stack(row, -1) for row in rows])
        drones = [divmod(self.drone[j], 2) for j in on]
        leg_names = [f"{self.label}{'qr'[end]}-leg {robot}" for robot, end in drones]
        self.segment_names = leg_names + [f"{self.label}edge {j}" for j in k] * (len(rows) - 1)
        return on_cables

    def _inner_ends(self, vertices: Array) -> Array:
        """Read inner ends of legs (m, 2n, 3, N + 1) of cables that bend on their own."""
        m, n = len(vertices), self.n
        own = self._array("anchors", m, n, 2, 3)
        count = max(own.shape[-1], vertices.shape[-1])
        clasps = elevate(vertices, count)[:, self.anchor - self.N]
        own = elevate(own, count).reshape(clasps.shape)
        self.anchor = self.pull_point = self.edges[2, -1] + 1 + np.arange(2 * n)
        self.edges[[0, 3]] = self.anchor.reshape(n, 2).T
        self.labels += self.names
        return np.where(self.bent[:, None, None, None], own, clasps)

    def _read_ties(self, vertices: Array) -> None:
        """Read which drones turn about vertices, and vertices of the hitch before or after."""
        (m, P), n, N = vertices.shape[:2], self.n, self.N
        # Drones that turn about each vertex; twice the same at the ends of a chain (P, 2)
        j = np.arange(P)
        self.pairs = np.stack([2 * j, 2 * j - 1], -1) % max(N, 1)
        if not self.closed and n:
            self.pairs[[0, -1]] = [[0, 0], [N - 1, N - 1]]
        # Vertices of the hitch before or after each piece on which cables clasp (m, P, 3)
        self.clasping = np.isin(self.state, (CLASPING, TIGHTENED))
        self.tied, self.tied_vertices = np.zeros(m, bool), np.zeros((m, P, 3))
        for piece in np.flatnonzero(self.clasping):
            run = np.flatnonzero(~self.clasping)
            before, after = run[run < piece][-1:], run[run > piece][:1]
            for near, end in ((after, 0), (before, -1)):
                if len(near) and self.formed[near[0]]:
                    self.tied[piece] = True
                    self.tied_vertices[piece] = vertices[near[0], ..., end]

    def spans(self, on: Mask, items: Any, *names: Sequence[str]) -> Spans:
        """Return whole pieces with items (k,) or (k, c), for a mask (m,) or (m, k)."""
        items = np.array(items, dtype=int)
        items = items[:, None] if items.ndim == 1 else items
        piece, k = np.nonzero(np.broadcast_to(on.reshape(len(on), -1), (len(on), len(items))))
        half = np.full(len(k), 0.5)
        return Spans(self, piece, items[k], half, half, names)


def midpoints(vertices: Array, n: int) -> Array:
    """Return contacts of straight edges (m, n, 2, 3, N + 1)."""
    middle = 0.5 * (vertices + np.roll(vertices, -1, 1))[:, :n]
    return np.stack([middle, middle], 2)


def differ(c: Array, d: Array) -> bool:
    """Return whether polynomials differ by more than SAME."""
    count = max(c.shape[-1], d.shape[-1])
    return bool(np.any(np.abs(elevate(c, count) - elevate(d, count)) > SAME))


def elevate(c: Array, count: int) -> Array:
    """Return polynomials of a higher degree, with ``count`` coefficients."""
    while c.shape[-1] < count:
        share, zero = np.arange(c.shape[-1] + 1) / c.shape[-1], np.zeros_like(c[..., :1])
        c = share * np.concatenate([zero, c], -1) + (1 - share) * np.concatenate([c, zero], -1)
    return c


def to_frame(pose: Array, x: Array) -> Array:
    """Return points x (…, 3) in the frames of bodies with poses (…, 5)."""
    o, c, r = x - pose[..., :3], pose[..., 3], pose[..., 4]
    return np.stack([c * o[..., 0] + r * o[..., 1], c * o[..., 1] - r * o[..., 0], o[..., 2]], -1)


# Hanging cables: catenaries of given lengths between moving ends.


def catenary_sigma(ratio: Array) -> Array:
    """Return σ of ``sinh σ / σ = ratio``, by bisection; nan for ratios up to 1."""
    low, high = np.zeros_like(ratio), 8.0 + 2.0 * np.log(np.maximum(ratio, 1.0))
    for _ in range(60):
        x = 0.5 * (low + high)
        below = np.sinh(x) < ratio * x
        low, high = np.where(below, x, low), np.where(below, high, x)
    return np.where(ratio > 1.0, low, np.nan)


def catenary(s: Spans, i: Index) -> tuple[Line, Line]:
    """Return vectors from drone i to its cable's other end, and σ.

    ``sinh σ / σ = √(L² - h²) / s`` with horizontal distance s and height h of the other end;
    ``σ' = σ² / (σ cosh σ - sinh σ)``.
    """
    chord = s.point(i + 1 - 2 * (i % 2)) - s.point(i)
    square = -(chord[2] * chord[2]) + s.plan.length[i // 2] ** 2
    root = square.map(np.sqrt, lambda x: 0.5 / np.sqrt(x))

    def slope(x: Array) -> Array:
        sigma = catenary_sigma(x)
        return sigma**2 / (sigma * np.cosh(sigma) - np.sinh(sigma))

    return chord, (root * chord[:2].norm().inverse()).map(catenary_sigma, slope)


def catenary_force(s: Spans, i: Index) -> Line:
    """Return the force of a cable of unit weight on drone i: ``(s / 2σ, ½ h coth σ - ½ L)``."""
    chord, sigma = catenary(s, i)
    coth = sigma.map(lambda x: 1.0 / np.tanh(x), lambda x: -1.0 / np.sinh(x) ** 2)
    return concatenate(chord[:2] * sigma.inverse(), chord[2] * coth - s.plan.length[i // 2]) * 0.5


def catenary_depth(L: Array, h: Array, sigma: Array, mu: Array) -> Array:
    """Return depths of cables below their chords at μ from -1 to 1."""
    arch = L * np.sinh(0.5 * (1.0 + mu) * sigma) * np.sinh(0.5 * (1.0 - mu) * sigma)
    return np.asarray((arch - 0.5 * h * np.sinh(mu * sigma)) / np.sinh(sigma) + 0.5 * h * mu)


class Links(NamedTuple):
    """A chain that replaces hanging cables: points at shares of lengths and positions μ.

    ``chord`` has points of chords above, ``sag`` (m, 1) how far cables sag below links, and
    ``rate`` (m,) bounds rates of depths below chords, and of lengths up to points.
    """

    cable: list[Line]
    chord: list[Line]
    sag: Array
    shares: Array
    places: Array
    rate: Array


def catenary_links(s: Spans, k: Index, *distances: float) -> Links:
    """Return the links of cables, with points at distances along them from both ends as well.

    At μ from -1 to 1 a cable is ``L (cosh σ - cosh μσ) / 2 sinh σ + h (μ - sinh μσ / sinh σ) / 2``
    below its chord, and ``L (1 + sinh μσ / sinh σ) / 2 - h (cosh σ - cosh μσ) / 2 sinh σ`` long up
    to there, both with derivatives of at most ``(L + |h|) / 4`` by σ and ½ by h. A convex curve
    sags below a link by at most a quarter of its width times the change of slope.
    """
    span, sigma = catenary(s, 2 * k)
    L, h, g = s.plan.length[k, 0], span.v[:, 2], sigma.v[:, 0]
    tilt = np.arcsinh(h / np.sqrt(L**2 - h**2))
    ends = [np.minimum(x / L, 1.0) for x in distances]
    ends += [1.0 - x for x in ends]
    shares = np.linspace(0.0, 1.0, LINKS + 1)[:, None] + 0.0 * L
    shares = np.sort(np.concatenate([shares, *(x[None] for x in ends)]), axis=0)
    low, high = np.sinh(tilt - g), np.sinh(tilt + g)
    slopes = low + shares * (high - low)  # proportional to the length
    places = np.clip((np.arcsinh(slopes) - tilt) / g, -1.0, 1.0)
    rate = 0.25 * (L + np.abs(h) + span.deviation) * sigma.rate + 0.5 * span[2].rate
    cable, chord = [], []
    for mu in places:
        depth = catenary_depth(L, h, g, mu)[:, None]
        chord.append(s.point(2 * k) + span * (0.5 * (1.0 + mu))[:, None])
        cable.append(chord[-1] - Line(depth, 0.0 * depth, rate, s.t) * UP)
    sag = np.max(np.diff(slopes, axis=0) * np.diff(places, axis=0), axis=0)
    sag = 0.125 * (sag * norm(span.v[:, :2]))[:, None]
    return Links(cable, chord, sag, shares, places, rate)


def own_cable_gap(s: Spans, i: Index, k: Index) -> Line:
    """Return distances of drones i from their hanging cables k, where these rise again.

    That is beyond OWN_DISTANCES of the smallest distance along the cable. Slopes are ``sinh(μσ +
    artanh(h / L))``. Links that lead down, or end nearer, throughout a span do not count.
    """
    nearest = OWN_DISTANCES * s.plan.cable_limit[1]
    links, (span, sigma) = catenary_links(s, k, OWN_LINK * nearest), catenary(s, 2 * k)
    at_r, L, h = i % 2 == 1, s.plan.length[k, 0], span[2]
    share = np.minimum((np.abs(h.v[:, 0]) + h.deviation) / L, 1.0)
    turn = np.arctanh(h.v[:, 0] / L), h.deviation / np.maximum(L * (1.0 - share**2), TINY)
    rates = (np.abs(links.places) * sigma.deviation + turn[1]) / s.t
    y, along = links.places * sigma.v[:, 0] + turn[0], links.shares * L
    reached = OWN_LINK * nearest * (1.0 + TOLERANCE)

    def line(x: Array, rate: Array) -> Line:
        return Line(x[:, None], s.zero.g, rate, s.t)

    values, counted = list[Array](), list[Line]()
    for j, link in enumerate(pairwise(links.cable)):  # positive where a link does not count
        descent = np.where(at_r, y[j], -y[j + 1]), np.where(at_r, rates[j], rates[j + 1])
        far_end = np.where(at_r, L - along[j], along[j + 1])
        ahead = np.where(far_end <= reached, nearest - far_end, -nearest)
        away = maximum(line(*descent), line(ahead, links.rate))
        absent, gap = away.low > 0.0, distance([s.point(i)], link, s.plan.ratio)
        counted.append(gap.where(~absent) + np.where(absent, FAR, 0.0)[:, None])
        values.append(np.where(away.v > 0.0, FAR, gap.v))
    value, gap = np.min(values, axis=0), minimum(*counted)
    unsure = np.any(value > gap.v, axis=1)  # whether nearer links count
    gap = gap.where(~unsure) + line(value[:, 0], (value[:, 0] - gap.low) / s.t).where(unsure)
    return gap - links.sag - shift(s, k)


def shift(s: Spans, k: Index) -> Line:
    """Return how far points of hanging cables move by the tracking error r of ends, beyond r.

    They move by ``√(1 + ¼) r`` and by the effect of σ: ``(coth σ - 1/σ) σ' = (ln √(L² - h²) / s)'``
    s and h within 2 r. Slopes of depths over L are at most ¼, and ``(1/eσ + e^-σ) / 2`` for σ > 1.
    Errors of h are larger by the ratio, by which heights are divided; σ only moves points upright.
    """
    L, r, ratio = s.plan.length[k, 0], 2.0 * s.plan.tracking, s.plan.ratio
    up = r * ratio

    def bound(low: Array, high: Array, h: Array) -> Array:
        whole, flat = (np.sqrt(L**2 - x**2) for x in (h, h + up))
        g = catenary_sigma(flat / (high + r))
        change = np.log(low / (low - r) * whole / flat) / (1.0 / np.tanh(g) - 1.0 / g)
        wide = np.maximum(g, 1.0)
        slope = L * np.minimum(0.25, 0.5 * (np.exp(-1.0) / wide + np.exp(-wide)))
        return np.asarray((slope + 0.25 * (h + up)) * change / ratio + 0.06 * r)

    if not r:
        return s.zero
    span = s.q_to_r(k)
    horizontal, h = span[:2].norm(), np.abs(span.v[:, 2])
    x = bound(horizontal.v[:, 0], horizontal.v[:, 0], h)
    q = (bound(horizontal.low, horizontal.high, h + span[2].deviation) - x) / s.t
    return Line(x[:, None], 0.0 * x[:, None], q, s.t)


def lowest_height(s: Spans, k: Index) -> Line:
    """Return heights of the lowest points of hanging cables."""
    links = catenary_links(s, k)
    return minimum(*(x[2] for x in links.cable)) - links.sag


def above_floor(s: Spans, k: Index) -> Line:
    """Return heights of hanging cables over the floor; only errors are larger by the ratio."""
    p = s.plan
    more: float = (p.ratio - 1.0) * p.settings["separation"]["cable"]
    return (lowest_height(s, k) - p.floor + more) * (1.0 / p.ratio) - shift(s, k)


def drones(p: Plan) -> Iterator[Row]:
    """Prove distances, rates and forces of drones."""
    s, lim, sep = p.spans(p.all_pieces, range(p.N), p.names), p.limits, p.sep
    pairs = p.spans(p.all_pieces, np.column_stack(np.triu_indices(p.N, 1)), p.names, p.names)

    def turning(s: Spans, i: Index) -> Line:
        """Return ``|f × f'| / |f|²``: the rotation rate of the thrust."""
        u = s.thrust(i).unit()
        return Line(norm(u.g)[:, None], s.zero.g, u.q / s.t, s.t) * DEGREES

    def to_slab(s: Spans, i: Index, b: int, slab: Slab) -> Line:
        return slab.gap(s.local(b, s.point(i)), ratio=p.ratio)

    def over_slab(s: Spans, i: Index, b: int, slab: Slab) -> Line:
        return slab.below(s.local(b, s.point(i)) * p.wash, p.wash_lead)

    ratio = "separation ratio min", 1.0
    yield prove(*ratio, pairs, lambda s, i, j: ((s.point(i) - s.point(j)) * p.scale).norm())
    for k, header in enumerate(("speed m/s max", "acceleration m/s² max", "jerk m/s³ max"), 1):
        limit = lim[header.split()[0]] * (lim["reserve"] if k > 1 else 1.0)  # reserved for stops
        yield prove(header, limit, s, lambda s, i, k=k: s.point(i, k).norm())
    share, tilt = 1.0 / p.max_thrust, lim["tilt"] * DEGREES
    yield prove("thrust share max", 1.0, s, lambda s, i: s.thrust(i).norm() * share[i])
    yield prove("tilt deg max", tilt, s, lambda s, i: angle(s.thrust(i), s.zero + UP) * DEGREES)
    if lim["body_rate"] is not None:
        yield prove("body_rate deg/s max", lim["body_rate"] * DEGREES, s, turning)
    yield prove(p.arena_row, 0.0, s, lambda s, i: wall_gap(s, [s.point(i)]))
    keep_out = "keep_out m min", sep["radius"]
    for b, slab in [*p.slabs, *p.walls]:
        gap = partial(to_slab, b=b, slab=slab)
        yield prove(*keep_out, s, gap)
    for b, slab in [] if p.n else p.slabs:
        if moves(p, p.bodies[b]):
            over = partial(over_slab, b=b, slab=slab.scaled(p.wash))
            yield prove("downwash ratio min", 1.0, s, over)


def moves(p: Plan, body: Body) -> bool:
    """Return whether the largest thrust of a drone exceeds the friction of a body that stands."""
    grip = body.friction * body.mass * G
    return not body.fixed and grip < float(np.max(p.max_thrust))


def wall_gap(s: Spans, x: Sequence[Line], depth: Line | float = 0.0, radius: float = 0.0) -> Line:
    """Return the distance to walls or ground from points with a horizontal radius and a depth."""
    arena = s.plan.arena or {"lower": [-BIG, -BIG, 0.0], "upper": [BIG] * 3}
    lower, upper = np.array(arena["lower"]), np.array(arena["upper"])
    error = s.plan.tracking  # except for the floor, on which drones stand
    gaps = [(each - lower)[k] - radius - error for each in x for k in range(2)]
    gaps += [(-each + upper)[k] - radius - error for each in x for k in range(2)]
    gaps += [(-each + upper)[2] - error * s.plan.ratio for each in x]
    return minimum(*gaps, *(each[2] - lower[2] - depth for each in x))


def taut_cables(p: Plan) -> Iterator[Row]:
    """Prove distances, lengths and shapes of hitches, tensions, and force residuals of clasps."""
    on, lim, ties, names = p.taut, p.limits, p.segments[:, 3:], p.segment_names
    clasps = p.spans(p.formed, range(len(p.clasps)), [p.labels[p.V][c] for c in p.clasps])
    legs, cables = p.spans(on, np.flatnonzero(p.leg), p.names), p.spans(on, range(p.n), p.cables)
    vertices = p.spans(p.formed, range(p.V.start, p.V.stop), p.labels)
    own = np.where(p.leg, np.arange(p.N), p.anchor)  # other end of the segment at each drone
    foreign = np.argwhere(np.all(p.segments[:, :2] != own[:, None, None], axis=2))
    shared = np.any(ties[:, None, :, None] == ties[None, :, None, :], axis=(2, 3))
    pairs = p.spans(on, np.argwhere(np.triu(~shared, 1)), names, names)

    def turn_margin(s: Spans, _: Index) -> Line:
        """Return the margin of the total turn to more than one turn, or to one for a chain."""
        return -total_turn(s) + (361.0 if p.closed else 360.0)

    def range_excess(s: Spans, k: Index) -> Line:
        """Return ``T - T_max``, or ``T_min - T`` outside ramps."""
        x, (low, high) = p.tensions.on(s, k), p.tension_range[s.piece, k, :, None].swapaxes(0, 1)
        return maximum(x - high, -x + np.where(p.ramp[s.piece, None], 0.0, low))

    def friction_excess(s: Spans, i: Index) -> Line:
        """Return excesses of legs' tensions beyond ``e^{-μθ} T`` and ``e^{μθ} T``."""
        x, T, ratio = p.pulls.on(s, i), p.tensions.on(s, i // 2), capstan(s, i)
        return maximum(x - T * ratio, T - x * ratio) * maximum(T, MIN_TENSION).inverse()

    def bend(s: Spans, k: Index) -> Line:
        (a, b), (first, last) = s.edge(k), (s.point(i) for i in p.edges[1:3, k])
        return maximum(a.unit().cross(b.unit()).norm(), (last - first).norm())

    def arena_gap(s: Spans, j: Index, *, leg: bool) -> Line:
        """Return distances of segments to walls, with a sag of ``ρ g s² / 8 T`` at the middle."""
        (a, b), k = s.segment(j), p.segments[j, 2]
        chord, T = b - a, p.pulls.on(s, p.segments[j, 1]) if leg else p.tensions.on(s, k)
        sag = chord.dot(chord) * s.inverse_tension(T, k) * (0.125 * p.weight)
        inner = wall_gap(s, [a + chord * x for x in (0.25, 0.5, 0.75)], sag)
        return minimum(wall_gap(s, [a, b]), inner)

    for j in np.split(np.arange(len(p.segments)), [int(np.sum(p.leg))]):
        yield prove(p.arena_row, 0.0, p.spans(on, j, names), partial(arena_gap, leg=not j[0]))
    s = p.spans(on, foreign, p.names, names)
    near = partial(distance, ratio=p.ratio)
    yield prove(*p.cable_limit, s, lambda s, i, j: near([s.point(i)], s.segment(j)))
    yield prove(*p.crossing_limit, pairs, lambda s, i, j: near(s.segment(i), s.segment(j)))
    speed = "vertex_speed m/s max", lim["vertex_speed"]
    yield prove(*speed, vertices, lambda s, i: s.point(i, 1).norm())
    yield prove("legs m min", lim["leg"], legs, lambda s, i: s.leg(i).flat(p.ratio).norm())
    yield prove("cable_length 1 max", 1e-4, cables, length_error)
    yield prove("equilibrium 1 max", 5e-3, clasps, force_residual)
    closed = clasps.select(p.state[clasps.piece] == "hitched")
    yield prove("contact deg max", OPEN_ROLL, closed, roll_angle)
    if p.weight or np.any(p.load) or np.any(p.active):
        yield prove("contact 1 max", 0.0, closed, contact)
    yield prove("convexity deg min", 0.0, clasps, exterior_angle)
    yield prove("convexity turn min", 0.0, p.spans(p.formed, [0], ["outline"]), turn_margin)
    yield prove("tension N max", 1e-4, cables, range_excess)
    if p.frictional:
        yield prove("equilibrium 1 max", 5e-3, legs, friction_excess)
    if p.has_contacts:
        straight = p.spans(on & ~np.any(p.grip, axis=0), range(p.n), p.cables)
        yield prove("grip bend max", 2 * WRAP_TOL, straight, bend)


def capstan(s: Spans, i: Index) -> Line:
    """Return ``e^{μθ}`` for the angle θ between leg and edge at the clasps of drones i."""
    leaving, arriving = s.edge(i // 2)
    q = np.broadcast_to(i % 2 == 0, len(s.x))
    theta = angle(-s.leg_chord(i), leaving.where(q) - arriving.where(~q))
    return (theta * s.plan.mu).map(np.exp, np.exp)


def length_error(s: Spans, k: Index) -> Line:
    """Return ``|d + l + e - L| / L``, or errors of stored legs.

    Segments of chord s at a slope α are longer than s by ``(ρ g τ / T)² s³ cos² α / 24``.
    """
    p, (leaving, arriving), excess = s.plan, s.edge(k), wrapped_length(s, k) - s.plan.length[k]
    segments = [(x.norm(), x) for x in (s.leg(2 * k), s.leg(2 * k + 1))]
    errors = [(p.legs.on(s, 2 * k + end) - segments[end][0]).norm() for end in (0, 1)]
    pulled = maximum(p.tensions.on(s, k), p.min_tension[s.piece, k]).inverse() * p.weight
    for chord, x in [*segments, (leaving.norm() + arriving.norm(), leaving + arriving)]:
        excess = excess + chord + chord * x[:2].dot(x[:2]) * pulled * pulled * (1.0 / 24.0)
    for b in range(len(p.bodies)):
        share = p.load_share.on(s, b)
        excess = excess - share * share * p.length_loss[b, s.piece, k, None]
    return maximum(excess.norm(), *errors) * (1.0 / p.length[k])


def wrapped_length(s: Spans, k: Index) -> Line:
    """Return lengths of edges along gripped objects: ``2 R arcsin(c / 2 R)``, or sides."""
    p, ends = s.plan, [s.point(i) for i in s.plan.edges[1:3, k]]
    total = chord = (ends[1] - ends[0]).norm()
    for b in map(int, np.flatnonzero(np.any(p.grip, axis=1))):
        stem, on = p.bodies[b].stem, p.grip[b, s.piece]
        if stem.round:
            half = chord * (0.5 / stem.radius)
            half = half.map(np.arcsin, lambda x: 1.0 / np.sqrt(1.0 - x**2))
            wrapped = half * (2.0 * stem.radius)
        else:
            ring = np.append(0.0, np.cumsum(norm(stem.sides)))
            gaps = [norm(s.local(b, x).v[:, None, :2] - stem.core) for x in ends]
            first, last = (ring[np.argmin(x, axis=1), None] for x in gaps)
            wrapped = s.zero + np.where(chord.v < REST_TOL, 0.0, (last - first) % ring[-1])
        total = total.where(~on) + wrapped.where(on)
    return total


def rim_loads(p: Plan) -> tuple[Array, Array, Array, Array]:
    """Return the effects of resting bodies on cables, at starts of pieces; 0 without a body.

    A rim on the clasps bends legs: below it they are horizontal, beyond it they rise with ``sin α =
    W / (2 Σ T)`` for a weight W of body and edges. The horizontal length l of each leg shortens the
    cable by ``l (1 / cos α - 1)`` (o, m, n), and the rim reduces the pull of edges by ``1 - cos α``
    (o, m), both with the squared load share. Vertices are ``tan α`` times the mean l below it
    (o, m). Shares (o, m, n, 3) of the body's mass and moments are least-squares solutions.
    """
    length_loss, pull_loss, depth = np.zeros(p.holding.shape), *np.zeros((2, *p.rest.shape))
    shares = np.zeros((*p.holding.shape, 3))
    for b, q in np.argwhere(p.rest & p.active & p.closed).tolist():
        body, x, T = p.bodies[b], p.points.c[0][q, p.V, :, 0], p.tensions.c[0][q, :, 0, 0]
        at = to_frame(p.poses.c[0][q, b, :, 0], x)[:, :2]
        moments = np.column_stack([np.ones(p.n), at - body.centre[:2]])
        weight = G * body.mass + p.weight * np.sum(norm(np.roll(x, -1, 0) - x))
        sine = min(weight / (2.0 * np.sum(T)), 1.0 - TOLERANCE)
        cosine = math.sqrt(1.0 - sine**2)
        shares[b, q], pull_loss[b, q] = np.linalg.pinv(moments).T, 1.0 - cosine
        if body.rim is not None:  # length of edges' extensions below the rim, by bisection
            to = np.stack([np.roll(at, -1, 0), at])
            u, low, high = normalize(to - to[::-1]), np.zeros((2, p.n)), np.full((2, p.n), 1e3)
            for _ in range(80):
                y = 0.5 * (low + high)
                inside = body.rim.depth(to + y[..., None] * u) > 0.0
                low, high = np.where(inside, y, low), np.where(inside, high, y)
            length_loss[b, q] = (np.roll(low[0], 1) + np.roll(low[1], -1)) * (1.0 / cosine - 1.0)
            depth[b, q] = np.mean(np.sum(low, axis=0)) * 0.5 * sine / cosine
    return length_loss, pull_loss, depth, shares


def clasp_forces(s: Spans, c: Index) -> tuple[list[Line], list[Line], list[Line], Line]:
    """Return directions and pulls of ``q̂_k, u_k, r̂_{k-1}, u_{k-1}``; weights and body forces.

    ``P q̂_k + P_k u_k + P' r̂_{k-1} - P_{k-1} u_{k-1} - W ẑ + w = 0``. W is the sum of ``τ (½ g load
    + ½ ρ g (L - other leg))`` of both cables; ``w = -m μ (a_k + g b ẑ) + m h (G·a) ẑ`` with the
    load share b, the clasp's shares μ and G of mass and moments, and the height h above clasps.
    """
    p, k, j = s.plan, s.plan.clasps[c], s.plan.behind[c]
    chords = s.leg_chord(2 * k), s.edge(k)[0], s.leg_chord(2 * j + 1), s.edge(j)[1]
    factor, body_force, weights = s.zero + 1.0, s.zero * UP, []
    for b, body in enumerate(p.bodies):
        share, (mass, x, y) = p.load_share.on(s, b), p.shares[b, s.piece, c, :, None].swapaxes(0, 1)
        factor = factor - share * share * p.pull_loss[b, s.piece, None]
        a = s.rotated(b, s.world(b, body.centre, 2))
        moment = (a[0] * x + a[1] * y) * UP * (body.centre[2] - body.height)
        inertia = (moment - s.point(p.begin[k], 2) * mass).where(p.moving[b, s.piece])
        body_force = body_force + (inertia - share * mass * G * UP) * body.mass
    for cable, other in ((k, 2 * k + 1), (j, 2 * j)):
        length = -s.leg(other).norm().where(p.leg[other]) + p.length[cable]
        weights.append(s.tautness(cable) * (length * (0.5 * p.weight) + 0.5 * G * p.load[c]) * UP)
    pulls = [s.pull(2 * k), s.edge_pull(k) * factor, s.pull(2 * j + 1), s.edge_pull(j) * factor]
    return [x.unit() for x in chords], pulls, weights, body_force


def force_residual(s: Spans, c: Index) -> Line:
    """Return the force residual of a clasp, over the smaller tension of its cables."""
    u, P, (a, b), body_force = clasp_forces(s, c)
    total = u[0] * P[0] + u[1] * P[1] + u[2] * P[2] - u[3] * P[3] - a - b + body_force
    return total.norm() * maximum(minimum(P[1], P[3]), MIN_TENSION).inverse()


def roll_angle(s: Spans, c: Index) -> Line:
    """Return the roll of pairs about the sum of their legs' pulls [deg]; at 180° clasps are open.

    It is the angle from ``u_k + u_{k-1}`` to the difference of the pulls, both normal to their sum;
    zero where tensions vanish at the ends of ramps.
    """
    k, j = s.plan.clasps[c], s.plan.behind[c]
    q, r = (s.leg_chord(i).unit() * s.pull(i) for i in (2 * k, 2 * j + 1))
    axis = (q + r).unit()
    bisector = s.edge(k)[0].unit() + s.edge(j)[1].unit()
    components = [x - axis * axis.dot(x) for x in (bisector, q - r)]
    return (angle(*components) * DEGREES).where(has_tension(s, k, j))


def past_roll(s: Spans, c: Index, sense: Array) -> Line:
    """Return 0 where pairs certainly do not roll past lying across; otherwise negative values.

    From lying across, at -180° times its sense, a pair rolls to its clasp, and may pass it by a
    right angle.
    """
    k, j = s.plan.clasps[c], s.plan.behind[c]
    q, r = (s.leg_chord(i).unit() * s.pull(i) for i in (2 * k, 2 * j + 1))
    axis, bisector = (q + r).unit(), s.edge(k)[0].unit() + s.edge(j)[1].unit()
    sine = axis.cross(bisector).dot(q - r) * sense[s.piece, c, None]
    cosine = axis.dot(bisector) * axis.dot(q - r) - bisector.dot(q - r)
    x = maximum(sine + cosine * math.tan(PAST_ROLL / DEGREES), -cosine).where(has_tension(s, k, j))
    return Line(np.minimum(x.v, 0.0), s.zero.g, np.where(x.low >= 0.0, 0.0, BIG), s.t)


def has_tension(s: Spans, *cables: Index) -> Mask:
    """Return a mask (m,) of cables under tension, which excludes the ends of ramps."""
    weakest = minimum(*(s.plan.tensions.on(s, k) for k in cables))
    return np.asarray((weakest.high > MIN_TENSION) | ~s.plan.ramp[s.piece])


def contact(s: Spans, c: Index) -> Line:
    """Return contact products over the weaker pull: negative while the cables press together.

    ``C = W_k ẑ - P q̂_k - P_k u_k - ½ w``; the products are C·q̂_k, C·u_k, -C·r̂_{k-1}, C·u_{k-1}.
    With different tensions due to friction they are the means of both products of a cable.
    """
    p, (u, P, weights, body_force) = s.plan, clasp_forces(s, c)
    C, weakest = weights[0] - u[0] * P[0] - u[1] * P[1] - body_force * 0.5, minimum(P[1], P[3])
    tensioned = has_tension(s, p.clasps[c], p.behind[c])
    products = [C.dot(u[0]), C.dot(u[1]), -C.dot(u[2]), C.dot(u[3])]
    if p.frictional:
        products = [(products[i] + products[i + 1]) * 0.5 for i in (0, 2)]
    largest = maximum(*products) * weakest.inverse()
    return largest.where(tensioned) - np.where(tensioned, 0.0, 1.0)[:, None]


def wrap_angle(s: Spans, k: Index) -> Line:
    """Return angles by which edges turn along an object in the horizontal plane [rad]."""
    return angle(*(x[:2] for x in s.edge(k)))


def total_turn(s: Spans) -> Line:
    """Return sums of exterior angles, and of the turns of two cables along an object [deg]."""
    turns = [exterior_angle(s, c) for c in range(len(s.plan.clasps))]
    turns += [wrap_angle(s, k) * DEGREES for k in range(2 * s.plan.two)]
    return sum(turns, s.zero)


def exterior_angle(s: Spans, c: Index) -> Line:
    """Return exterior angles at clasps in the horizontal plane [deg]; clockwise is positive."""
    p, k, x = s.plan, s.plan.clasps[c], s.point(s.plan.begin[s.plan.clasps[c]])
    a, b = (x - s.point(p.begin[p.behind[c]]))[:2], (s.point(p.end[k]) - x)[:2]
    if p.two:  # edges bend around an object
        a, b = s.edge(p.behind[c])[1][:2], s.edge(k)[0][:2]
    right = a[1] * b[0] - a[0] * b[1]
    turn = angle(a, b) * DEGREES * np.where(right.v < 0.0, -1.0, 1.0)
    return Line(turn.v, turn.g, np.where(right.low * right.high > 0.0, turn.q, BIG), s.t)


def crossing_parts(s: Spans, c: Index) -> Iterator[tuple[list[Line], list[Line]]]:
    """Yield pairs of straight parts beyond an object on which bent cables of a clasp cross.

    They are of the cable ahead, towards its q, and of the one behind, towards its r.
    """
    yield from product(s.halves(s.plan.clasps[c], 0), s.halves(s.plan.behind[c], 1))


def signed_distance(a: Sequence[Line], b: Sequence[Line]) -> Line:
    """Return the distance of lines b to lines a along ``a × b``; -FAR where that may vanish."""
    n = (a[1] - a[0]).cross(b[1] - b[0])
    valid = n.norm().low > 0.0
    return (a[0] - b[0]).dot(n.unit()).where(valid) - np.where(valid, 0.0, FAR)[:, None]


def runs_of(on: Mask) -> Iterator[Items]:
    """Yield the runs of pieces in a mask."""
    runs = groupby(range(len(on)), lambda q: bool(on[q]))
    yield from (np.array([*pieces]) for valid, pieces in runs if valid)


def bent_orders(p: Plan, run: Items) -> tuple[Array, Array, Array]:
    """Return how bent cables cross beyond the object on a run of pieces, for every clasp (c,).

    Values: the sign of signed distances, and height orders at the start and at the end, 1 if the
    cable ahead is above; 0 if cables do not clearly cross at any sample.
    """
    count, parts = len(p.clasps), 8
    x = np.tile(np.repeat((np.arange(parts) + 0.5) / parts, count), len(run))
    c = np.tile(np.arange(count), parts * len(run))
    s = Spans(p, np.repeat(run, parts * count), c[:, None], x, 0.0 * x)
    gaps = np.zeros((len(c), 4))
    with np.errstate(all="ignore"):
        for k, (a, b) in enumerate(crossing_parts(s, c)):
            u, w = ((y[1] - y[0]).v for y in (a, b))
            inside = intersections(a[0].v, u, b[0].v, w)[0]
            gaps[:, k] = np.where(np.isnan(inside), 0.0, signed_distance(a, b).v[:, 0])
    gaps = gaps.reshape(-1, count, 4).swapaxes(1, 2).reshape(-1, count)
    largest = gaps[np.argmax(np.abs(gaps), axis=0), np.arange(count)]
    sign = np.sign(largest) * (np.abs(largest) > 2.0 * SAG_TOL + MIN_GAP)
    orders = []
    for q, end in ((run[0], -1.0), (run[-1], 1.0)):
        t = p.spans(np.arange(len(p.h)) == q, range(count)).subspan(end)
        a, b = next(crossing_parts(t, t.item[:, 0]))
        up = np.cross((a[1] - a[0]).v, (b[1] - b[0]).v)[:, 2]
        orders.append(sign * np.sign(up))
    return sign, orders[0], orders[1]


def bent_cables(p: Plan) -> Iterator[Row]:
    """Prove that two cables bend around an object, balanced, and do not pass through each other.

    Their arcs are on opposite sides of a line. They cross beyond the object only, with the same one
    above until they are apart; their other straight parts are apart. Without an object between
    them, all of their parts are.
    """
    legs = p.spans(p.bent, range(p.N), p.names)
    clasps = p.spans(p.bent, range(len(p.clasps)), p.labels[p.V])
    both = p.spans(p.bent, [[0, 1]], p.cables, p.cables)
    signs, first = np.zeros((len(p.h), len(p.clasps))), np.arange(p.N) % 2 == 0
    for run in runs_of(p.bent):
        signs[run] = bent_orders(p, run)[0]

    def opposite(s: Spans, *_: Index) -> Line:
        """Return distances of arcs across a line [m], less than 0 where they may be on one side.

        An arc turns by less than half a turn. It is on the side of its contacts if both straight
        parts of its edge have the normal to that side on their left.
        """
        left = [[concatenate(-x[1], x[0]) for x in s.edge(k)] for k in (0, 1)]
        first, second = (normalize(x.v) + normalize(y.v) for x, y in left)
        n = normalize(first - second)
        contacts = ([s.point(int(i))[:2] for i in p.edges[1:3, k]] for k in (0, 1))
        gaps = [(a - b).dot(n) for a, b in product(*contacts)]
        return minimum(*gaps, *(x.dot(n) for x in left[0]), *(x.dot(-n) for x in left[1]))

    def residual(s: Spans, i: Index) -> Line:
        """Return forces where legs meet edges, over the tension.

        Not counted are PASSED of the weight, which the other cable may bear, and level forces of
        second order, ``(½ ρ g L / T)²``, as both are chords of one sagging cable.
        """
        k, (leaving, arriving) = i // 2, s.edge(i // 2)
        edge = leaving.where(first[i]) - arriving.where(~first[i])
        other, pull = s.leg(i + 1 - 2 * (i % 2)).norm(), s.edge_pull(k)
        weight = s.tautness(k) * (-other + p.length[k]) * (0.5 * p.weight)
        force = s.leg_chord(i).unit() * s.pull(i) + edge.unit() * pull - weight * UP
        share = maximum(minimum(pull, s.pull(i)), MIN_TENSION).inverse()
        loss = s.inverse_tension(p.tensions.on(s, k), k) * p.length[k] * (0.5 * p.weight)
        level = maximum(force[:2].norm() * share - loss * loss, 0.0)
        upright = maximum((force[2].norm() - weight * PASSED) * share, 0.0)
        return concatenate(level, upright).norm()

    def apart(s: Spans, i: Index, j: Index) -> Line:
        """Return distances of straight parts of cables that are at different ends of an object."""
        pairs = (product(s.halves(i, end), s.halves(j, end)) for end in (0, 1))
        return minimum(*(distance(a, b) for a, b in chain(*pairs)))

    def above(s: Spans, c: Index) -> Line:
        """Return signed distances of cables that cross, or large ones where they are apart."""
        sign, gaps = signs[s.piece, c, None], list[Line]()
        for a, b in crossing_parts(s, c):
            crossed = signed_distance(a, b) * sign - np.where(sign == 0.0, FAR, 0.0)
            gaps.append(maximum(crossed, distance(a, b) - (2.0 * SAG_TOL + MIN_GAP)))
        return minimum(*gaps)

    yield prove("equilibrium 1 max", 5e-3, legs, residual)
    yield prove("crossing m min", MIN_GAP, both, opposite)
    yield prove("crossing m min", SAG_TOL, both, apart)
    cable, parts = p.segments[:, 2], p.segment_names
    pairs = np.argwhere((cable[:, None] == 0) & (cable == 1))
    loose = p.spans(p.bent & ~np.any(p.held, axis=0), pairs, parts, parts)
    near = partial(distance, ratio=p.ratio)
    yield prove(*p.crossing_limit, loose, lambda s, i, j: near(s.segment(i), s.segment(j)))
    yield prove("laid m min", -SAG_TOL, clasps, above)


def free_cables(p: Plan) -> Iterator[Row]:
    """Prove distances of cables that lie, hang, clasp or are tightened."""
    k, ground, ends = range(p.n), p.state == "on the ground", (p.names, p.cables)
    pairs, foreign = np.triu_indices(p.n, 1), np.argwhere(np.arange(p.N)[:, None] // 2 != k)
    clasped = p.clasped[pairs] & ~np.isin(p.state, (*UNLINKED, DRAWN))[:, None]
    both = p.spans(p.free[:, None] & ~clasped, np.column_stack(pairs), p.cables, p.cables)
    drawn, level = p.state == DRAWN, ground | (p.state == DRAWN)
    free, hanging = (p.spans(on, k, p.cables) for on in (p.free, p.free & ~level))
    lying, tightened = p.spans(p.free & level, foreign, *ends), p.state == TIGHTENED
    apart = p.clasping[:, None] & ~p.clasped[pairs]
    loose = p.spans(apart, np.column_stack(pairs), p.cables, p.cables)
    on_clasps = p.pairs[np.stack([p.begin, p.end], -1)[foreign[:, 1]] - p.N]
    turning = np.any(on_clasps == foreign[:, :1, None], axis=(1, 2))
    beside = p.clasping[:, None] & ~(turning & (p.state == CLASPING)[:, None])

    def to_cable(s: Spans, i: Index, k: Index) -> Line:
        links = catenary_links(s, k)
        gaps = (distance([s.point(i)], x, p.ratio) for x in pairwise(links.cable))
        return minimum(*gaps) - links.sag - shift(s, k)

    def to_hull(s: Spans, i: Index, k: Index) -> Line:
        return prism_gap([s.point(i)], s.hull(k), p.ratio)

    def chord_share(s: Spans, k: Index) -> Line:
        """Return chords, longer by errors of both ends, over lengths.

        Where cables are drawn taut, errors change the tension at which they are straight.
        """
        chord, error = s.q_to_r(k), np.where(drawn[s.piece, None], 0.0, 2.0 * p.tracking)
        if p.ratio == 1.0:
            return (chord.norm() + error) * (1.0 / p.length[k])
        level, height = chord[:2].norm() + error, chord[2].norm() + error * p.ratio
        return concatenate(level, height).norm() * (1.0 / p.length[k])

    def between_hulls(s: Spans, i: Index, j: Index) -> Line:
        return hull_distance(*([x[:2] for x in s.hull(k)[:-1]] for k in (i, j)))

    def to_sheet(s: Spans, i: Index, k: Index) -> Line:
        """Return distances of drones from sheets between hanging cables and their chords."""
        links = catenary_links(s, k)
        lower = [x - UP * links.sag for x in links.cable]
        parts = zip(pairwise(links.chord), pairwise(lower), strict=True)
        return minimum(*(prism_gap([s.point(i)], [*top, *bottom]) for top, bottom in parts))

    span, chord = ("span 1 max", 1.0), Spans.level_chord
    yield prove(*span, free, chord_share)
    yield prove(*p.crossing_limit, both, lambda s, i, j: distance(chord(s, i), chord(s, j)))
    yield prove(*p.cable_limit, lying, lambda s, i, k: distance([s.point(i)[:2]], chord(s, k)))
    yield prove(*p.cable_limit, hanging, above_floor)
    # Distances of a point of a cable to both ends sum to at most its length
    s = p.spans(p.free & ~level, foreign, *ends)
    total = sum(((s.point(s.item[:, 0]) - x).norm() for x in s.ends(s.item[:, 1])), s.zero)
    reach = (p.sep["cable"] + EXACT_RANGE) * p.ratio
    s = s.select(total.low < p.length[s.item[:, 1], 0] + 2.0 * reach)
    yield prove(*p.cable_limit, s, to_cable)
    yield prove("cable_loops m min", POS_TOL, s, to_sheet)
    own = np.column_stack([np.arange(p.N), np.arange(p.N) // 2])
    yield prove(*p.cable_limit, p.spans(p.free & ~level, own, *ends), own_cable_gap)
    yield prove(*p.crossing_limit, loose, between_hulls)
    s = p.spans(beside, foreign, *ends)
    s = s.near_hulls(s.item[:, 1], s.point(s.item[:, 0]), p.cable_limit[1] + EXACT_RANGE)
    yield prove(*p.cable_limit, s, to_hull)
    longer = "cable_length 1 max", 1e-4  # bound of lengths along vertices
    s = p.spans(tightened, k, p.cables)
    yield prove(*longer, s, lambda s, k: s.route_length(k) * (1.0 / p.length[k]) - 1.0)
    yield from laid_cables(p)
    yield from drawn_cables(p)


def drawn_cables(p: Plan) -> Iterator[Row]:
    """Prove that drones of cables drawn taut move either apart or together, above the ground.

    Cables hang lowest where their drones are nearest.
    """
    for run in runs_of(p.state == DRAWN):
        s = p.spans(np.isin(np.arange(len(p.h)), run), range(p.n), p.cables)
        ends = [s.select(s.piece == q).subspan(x) for q, x in ((run[0], -1.0), (run[-1], 1.0))]
        first, last = (norm(x.q_to_r(x.item[:, 0]).v) for x in ends)
        parting = first <= last
        for x, lowest in zip(ends, (parting, ~parting), strict=True):
            yield prove(*p.cable_limit, x.select(lowest), above_floor)

        def drawing(s: Spans, k: Index, parting: Mask = parting) -> Line:
            """Return the rate at which drones move apart, or together, times their distance."""
            rate = s.q_to_r(k).dot(s.point(2 * k + 1, 1) - s.point(2 * k, 1))
            return rate * np.where(parting[k], 1.0, -1.0)[:, None]

        yield prove("drawn m²/s min", -RESOLUTION, s, drawing)


def laid_cables(p: Plan) -> Iterator[Row]:
    """Prove lengths of single taut cables, and distances of laid neighbours."""
    laid = p.state == LAID
    s = p.spans(laid, range(p.n), p.cables)

    def length_error(s: Spans, k: Index) -> Line:
        """Return ``|c (1 + (ρ g L / T)² cos² α / 24) - L| / L`` of chords c."""
        chord = s.q_to_r(k)
        x = chord.norm() * (1.0 / p.length[k])
        x = x + x * chord[:2].dot(chord[:2]) * (p.sag[k] / p.length[k] ** 2) - 1.0
        return x.norm() - 0.2 * p.sag[k]  # tolerance of an eighth of the tension

    def gap(s: Spans, k: Index, j: Index) -> Line:
        """Return the horizontal distance, or the height of one cable over the other."""
        tops = [maximum(*(x[2] for x in s.ends(i))) for i in (j, k)]
        heights = lowest_height(s, k) - tops[0], lowest_height(s, j) - tops[1]
        return maximum(
            distance(s.level_chord(k), s.level_chord(j)), *(x * (1.0 / p.ratio) for x in heights)
        )

    yield prove("cable_length 1 max", 1e-4, s, length_error)
    pairs = p.spans(laid & ~p.vertical, p.pair[::-1].T, p.cables, p.cables)
    yield prove(*p.crossing_limit, pairs, gap)
    half_crossings, unlinked = np.zeros((p.n, p.n, len(p.h) + 1)), np.zeros(len(p.clasps))
    _, sign, least = replay(p, half_crossings, unlinked, unlinked)
    s = p.spans(laid & p.vertical, range(len(p.clasps)), p.labels[p.V])

    def above(s: Spans, c: Index) -> Line:
        """Return the height of the upper cable over its smallest allowed height."""
        z = s.point(2 * p.clasps[c])[2] - s.point(2 * p.behind[c])[2]
        return z * sign[s.piece, c, None] - least[s.piece, c, None]

    yield prove("laid m min", -POS_TOL, s, above)


def intersections(a: Array, u: Array, b: Array, w: Array) -> tuple[Array, Array]:
    """Return x and y at which segments a + x u and b + y w cross horizontally, or nan."""
    offset, turn = b - a, u[..., 0] * w[..., 1] - u[..., 1] * w[..., 0]
    x, y = (offset[..., 0] * v[..., 1] - offset[..., 1] * v[..., 0] for v in (w, u))
    x, y = (z / np.where(turn == 0.0, TINY, turn) for z in (x, y))
    inside = (x > 0.0) & (x < 1.0) & (y > 0.0) & (y < 1.0)
    return np.where(inside, x, np.nan), np.where(inside, y, np.nan)


def cable_heights(s: Spans, k: Items, share: Array) -> Array:
    """Return heights (m,) of hanging cables at relative positions along their chords."""
    with np.errstate(all="ignore"):
        chord, g = (x.v for x in catenary(s, 2 * k))
        depth = catenary_depth(s.plan.length[k, 0], chord[:, 2], g[:, 0], 2.0 * share - 1.0)
    return np.asarray(s.point(2 * k).v[:, 2] + share * chord[:, 2] - depth)


def crossing_heights(p: Plan, q: int, end: int) -> Array:
    """Return heights of cables over those behind where they cross at an end of piece q, or nan."""
    s = p.spans(np.arange(len(p.h)) == q, p.clasps).subspan(2.0 * end - 1.0)
    chords = [(s.point(2 * k).v, s.q_to_r(k).v) for k in (p.clasps, p.behind)]
    x, y = intersections(*chords[0], *chords[1])
    return cable_heights(s, p.clasps, x) - cable_heights(s, p.behind, y)


def roll_changes(p: Plan, run: Items) -> tuple[Array, Array, Mask]:
    """Return rolls at the start of a run, their changes (c,) [deg], and a mask of valid changes.

    Rolls are sampled several times per piece, so that legs turn by much less than a right angle.
    """
    count, parts = len(p.clasps), 6
    places = np.repeat((np.arange(parts) + 0.5) / parts, count)
    q, x = np.repeat(run, len(places)), np.asarray(np.tile(places, len(run)), np.float64)
    c = np.tile(np.arange(count), parts * len(run))
    s = Spans(p, q, c[:, None], x, 0.0 * x + 0.5 / parts)
    k, j = p.clasps[c], p.behind[c]
    with np.errstate(all="ignore"):  # legs may vanish
        q_, r = (s.leg_chord(i).unit() for i in (2 * k, 2 * j + 1))
        axis, u = (q_ + r).unit(), s.edge(k)[0].unit() + s.edge(j)[1].unit()
        m, m0 = (y - axis * axis.dot(y) for y in (q_ - r, u))
        valid = (m.deviation < 0.5 * norm(m.v)) & (m0.deviation < 0.1 * norm(m0.v))
    sine = np.sum(np.cross(m0.v, axis.v) * m.v, -1)
    angles = np.degrees(np.arctan2(sine, np.sum(m0.v * m.v, -1))).reshape(-1, count)
    steps = (np.diff(angles, axis=0) + 180.0) % 360.0 - 180.0
    return angles[0], np.sum(steps, axis=0), np.all(valid.reshape(-1, count), axis=0)


def rolled(
    p: Plan, run: Items, linked: Mask, sense: Array, order: Array, before: str, after: str
) -> tuple[Array, Array, list[tuple[Mask, str]]]:
    """Return senses and height orders (c,) after pairs have rolled, and masks of faults.

    ``before`` and ``after`` are the states of cables before and after, empty at ends of the plan.
    """
    start, change, valid = roll_changes(p, run)
    opened = np.abs(start) >= OPEN_ROLL
    valid &= (opened == (order != 0.0)) & (opened | linked)
    sense = np.where(order != 0.0, order, sense)
    roll = start + 180.0 * sense  # relative to lying across
    roll = np.where(opened, (roll + 180.0) % 360.0 - 180.0, roll) + change
    across = np.abs(roll) <= 180.0 - OPEN_ROLL
    short = ~across & (np.abs(roll - 180.0 * sense) >= OPEN_ROLL)
    faults = [(opened & (not before), "a clasp is open at the start")]
    faults += [(~valid, "unlinked cables roll")]
    faults += [(short | across & (after == "hitched"), "pairs do not roll by a half turn")]
    return sense, np.where(across, sense, 0.0), faults


def replay(
    p: Plan, half_crossings: Array, sense: Array, order: Array
) -> tuple[list[Fault], Array, Array]:
    """Replay half crossings of neighbours that are laid and roll, and add them to an array.

    ``sense`` and ``order`` (c,) are senses of links and height orders at the start, 1 if a cable
    lies on the one behind.
    Returns faults and, on pieces with vertical motion, the sign (m, c) of the upper cable, and the
    smallest height of its q over the other one's, times that sign; on pieces that roll, the sign is
    that of the sense.
    """
    m, count, faults = len(p.h), len(p.clasps), list[Fault]()
    sign, least = np.zeros((m, count)), np.full((m, count), -BIG)
    runs = [(str(s), np.array([*q])) for s, q in groupby(range(m), lambda q: p.state[q])]
    names = ["", *(s for s, _ in runs), ""]
    i, j = np.minimum(p.clasps, p.behind), np.maximum(p.clasps, p.behind)

    def check(q: int, wrong: Any, text: str) -> None:
        faults.append((float(p.breaks[q]), bool(np.any(wrong)), text))

    for at, (state, run) in enumerate(runs):
        before, after, q = names[at], names[at + 2], int(run[0])
        number = np.sum(half_crossings[i, j, : q + 1], axis=-1) / (1 + p.two)
        linked = np.abs(number) == 1.0
        if state == LAID:
            check(q, (before != ROLLING) & (linked | (order != 0.0)), "linked cables are laid")
            for vertical, part in groupby(run.tolist(), lambda q: bool(p.vertical[q])):
                pieces = [*part]
                lifted = before == ROLLING and pieces[0] == q
                lowered = after == ROLLING and pieces[-1] == run[-1]
                contact, e = lifted or lowered, int(not lifted)  # the end at which they touch
                check(q, contact and (lowered == lifted or not vertical), "touching cables move")
                if not vertical:
                    continue
                near, far = (crossing_heights(p, pieces[x - 1], 1 - x) for x in (1 - e, e))
                upper, apart = np.sign(np.nan_to_num(far)), np.isnan(far) & (not contact)
                clear = apart | (np.abs(far) >= p.crossing_limit[1])
                check(q, ~clear, "the height order of cables is not clear")
                x = p.points.c[0][pieces[-e], :, 2, -e]
                rise = (x[2 * p.clasps] - x[2 * p.behind]) * upper
                floor = rise if contact else rise - upper * near + p.crossing_limit[1]
                sign[pieces], least[pieces] = upper, np.where(apart, -BIG, floor)
                check(q, contact and ~(np.abs(near) <= SAG_TOL), "cables do not touch")
                check(q, lifted and upper != order, "a cable is lifted through another one")
                order = upper if lowered else 0.0 * upper
            if before == ROLLING:
                half_crossings[i, j, q + 1] -= sense
        elif state == BENT:
            _, first, last = bent_orders(p, run)
            check(q, (before != ROLLING) & ((number != 0.0) | (order != 0.0)), "linked cables bend")
            check(q, (before == ROLLING) & (first != order), "cables are lifted through each other")
            check(q, (after == ROLLING) & (last == 0.0), "the height order of cables is not clear")
            np.subtract.at(half_crossings[..., q + 1], (i, j), sense * (before == ROLLING))
            order = last * (after == ROLLING)
        elif state == ROLLING:
            np.add.at(half_crossings[..., run[-1] + 1], (i, j), np.where(linked, 0.0, order))
            sense, order, wrong = rolled(p, run, linked, sense, order, before, after)
            sign[run] = sense
            for each, text in wrong:
                check(q, each, text)
        elif state == "hitched" and before not in ("", ROLLING):
            sense = number
    return faults, sign, least


def clear_objects(p: Plan, b: int) -> Iterator[Row]:
    """Prove distances of a body to cables, other bodies, ground and walls."""
    body, allowed = p.bodies[b], allowed_contacts(p, b)
    others = p.taut[:, None] & ~p.holding[b][:, p.segments[:, 2]]
    off = p.spans(others, range(len(p.segments)), p.segment_names)
    free, clasping = (p.spans(on, range(p.n), p.cables) for on in (p.free, p.clasping))
    moving, carried = (p.spans(x[b], [0], [body.name]) for x in (p.moving, p.held))
    header = "penetration m min"

    def hanging_gap(s: Spans, k: Index, slab: Slab) -> Line:
        """Return heights of hanging cables above the body, or horizontal distances of chords."""
        height = (lowest_height(s, k) - p.poses.on(s, b)[2] - slab.upper) * (1.0 / p.ratio)
        height = height - shift(s, k)
        height = height.where(~np.isin(p.state[s.piece], ("on the ground", DRAWN)))
        return maximum(slab.enlarged(0.0, -BIG, BIG).gap(*s.ends(k, b)), height)

    def hull_gap(s: Spans, k: Index, slab: Slab) -> Line:
        *outline, lowest = s.hull(k, b)
        tall = slab.enlarged(0.0, -BIG, BIG)
        height = (lowest[2] - slab.upper) * (1.0 / p.ratio)
        return maximum(tall.gap(*outline, outline[0]), height)

    def arena_gap(s: Spans, _: Index, slab: Slab) -> Line:
        """Return distances to walls and ceiling; the floor is a contact."""
        top = [s.world(b, np.append(x, slab.upper)) for x in slab.core]
        return wall_gap(s, top, -BIG, slab.radius)

    def other_gap(s: Spans, _: Index, o: int, slab: Slab, block: Slab) -> Line:
        height = s.local(o, s.world(b, UP * slab.lower))[2] - block.upper
        touching = ((height + 2.0 * POS_TOL) * 1e6).where(allowed[s.piece, o])
        return maximum(body_gap(s, b, slab, s, o, block, p.ratio), touching)

    ground = -1, Slab(None, BIG, -BIG, p.floor)
    for slab in body.slabs:
        near = partial(slab.gap, ratio=p.ratio)
        yield prove(*p.object_limit, off, lambda s, j, near=near: near(*s.segment(j, b)))
        yield prove(*p.object_limit, free, partial(hanging_gap, slab=slab))
        reach = p.object_limit[1] + slab.radius + float(np.max(norm(slab.core))) + EXACT_RANGE
        place = p.poses.on(clasping, b)[:3]
        close = clasping.near_hulls(clasping.item[:, 0], place, reach)
        yield prove(*p.object_limit, close, partial(hull_gap, slab=slab))
        for o, block in (ground, *p.slabs):
            if o != b:
                gap = partial(other_gap, o=o, slab=slab, block=block)
                yield prove(*p.object_limit, moving, gap)
        yield prove(p.arena_row, 0.0, carried, partial(arena_gap, slab=slab))

    def inner_gap(s: Spans, _: Index, slab: Slab, o: int, block: Slab) -> Line:
        """Return the distance to a slightly smaller body, as surfaces may touch."""
        core = None if block.round else block.core + 1e-5 * (block.centroid - block.core)
        heights = block.lower + POS_TOL, block.upper - POS_TOL
        inner = Slab(core, (1.0 - 1e-5) * block.radius, *heights)
        return maximum(body_gap(s, b, slab, s, o, inner), body_gap(s, o, inner, s, b, slab))

    first = p.spans(np.arange(len(p.h)) == 0, [0], [body.name]).subspan(-1.0)
    for slab, (o, block) in product(body.slabs, p.slabs):
        if o != b and block.upper > block.lower and not (body.fixed and p.bodies[o].fixed):
            gap = partial(inner_gap, slab=slab, o=o, block=block)
            yield prove(header, 0.5 * POS_TOL, first, gap)


def clear_held(p: Plan, b: int) -> Iterator[Row]:
    """Prove that cables which hold a body do not enter it, nor the ground.

    Edges touch a body that they grip: ``gripped`` proves how. A rim rests on cables only below it.
    """
    body, header = p.bodies[b], "penetration m min"
    held, items = p.holding[b][:, p.segments[:, 2]] & p.taut[:, None], range(len(p.segments))
    wrapped, is_leg = p.grip[b][:, None], p.segments[:, 3] == p.segments[:, 4]
    is_tray = body.rim is not None and body.height == body.stem.lower  # above what it rests on
    masks = [held & (is_leg | ~wrapped) & (wrapped | (not is_tray)), held & wrapped]
    for slab, on in zip(body.slabs, masks, strict=False):
        s = p.spans(on, items, p.segment_names)
        yield prove(header, WRAP_TOL, s, lambda s, j, slab=slab: slab.gap(*s.segment(j, b)))
    s = p.spans(p.held[b], range(len(p.labels)), p.labels)
    yield prove(header, -WRAP_TOL, s, lambda s, i: s.point(i)[2] - p.floor)


def body_gap(
    s: Spans, b: int, slab: Slab, t: Spans, o: int, block: Slab, ratio: float = 1.0
) -> Line:
    """Return the distance of a slab of body b of spans s to a block of body o of spans t.

    Heights are divided by a ratio.
    """
    ring = [t.local(o, s.world(b, np.append(x, slab.lower))) for x in (*slab.core, slab.core[0])]
    lower = block.lower - slab.upper + slab.lower
    return block.enlarged(slab.radius, lower, block.upper).gap(*ring, ratio=ratio)


def allowed_contacts(p: Plan, b: int) -> Mask:
    """Return a mask of supports of a body by piece, the ground last, at lifts and descents."""
    c, bottom = p.poses.c[0], p.bodies[b].stem.lower
    vertical = np.all(np.ptp(c[:, b, [0, 1, 3, 4]], axis=-1) <= POS_TOL, axis=-1)
    runs, allowed = np.cumsum(~vertical), np.zeros((len(c), len(p.bodies) + 1), dtype=bool)
    for q, end in ((q, end) for q in np.flatnonzero(vertical) for end in (0, -1)):
        top, support = support_below(p, b, c[q, ..., end])
        if abs(c[q, b, 2, end] + bottom - top) <= POS_TOL or (q == 0 and end == 0):
            allowed[vertical & (runs == runs[q]), support] = True
    return allowed


def support_below(p: Plan, b: int, poses: Array) -> tuple[float, int]:
    """Return the height and the index of the support under a body (-1: the ground)."""
    c, (x, y, z), supports = poses[b], p.bodies[b].centre, [(p.floor, -1)]
    centre = c[:3] + [c[3] * x - c[4] * y, c[4] * x + c[3] * y, z]
    for o, other in enumerate(p.bodies):
        top = float(poses[o, 2] + other.stem.upper)
        inside = other.stem.depth(to_frame(poses[o], centre)[:2]) >= 0.0
        supports += [(top, o)] if o != b and inside and top <= centre[2] + POS_TOL else []
    return max(supports)


def resting(p: Plan, b: int) -> Iterator[Row]:
    """Prove that clasps keep their places, and that friction and support hold the rim."""
    body, on, rim = p.bodies[b], p.rest[b] & p.active[b], p.bodies[b].rim
    if rim is None or not p.closed:
        return
    q = p.hold_start[b]
    places = to_frame(p.poses.c[0][q, b, None, :, 0], p.points.c[0][q, p.V, :, 0])

    def drift(s: Spans, j: Index) -> Line:
        """Return drifts of clasps since the start of the hold, and from depths below the rim."""
        x, at = s.local(b, s.point(p.begin[j])), places[s.piece, j]
        depth, lifted = p.rim_depth[b, s.piece, None], p.lifted[b, s.piece, None]
        upper = np.where(lifted, depth, 0.0) - rim.lower
        outside = np.where(rim.depth(at[:, :2]) > CONTACT_TOL, 0.0, 1.0)[:, None]
        return maximum((x[:2] - at[:, :2]).norm(), -x[2] + rim.lower - depth, x[2] + upper, outside)

    def friction_margin(s: Spans, j: Index) -> Line:
        a = s.point(p.begin[j], 2)
        return (a[2] + G) * body.friction - a[:2].norm()

    def support_margin(s: Spans, j: Index) -> Line:
        """Return ``n·(c - p_k) - h n·a / (g + a_z)`` of every side's inward normal n."""
        side = (places[s.piece, (j + 1) % p.n] - places[s.piece, j])[:, :2]
        n = normalize(np.stack([side[:, 1], -side[:, 0]], -1))
        a, x = s.rotated(b, s.world(b, body.centre, 2)), s.local(b, s.point(p.begin[j]))
        lean = a[:2].dot(n) * (a[2] + G).inverse() * (float(body.centre[2]) - rim.lower)
        return (-x[:2] + body.centre[:2]).dot(n) - lean - 2.0 * CONTACT_TOL

    s, lifted = (p.spans(x, range(p.n), p.labels[p.V]) for x in (on, on & p.lifted[b]))
    yield prove("rim m max", CONTACT_TOL, s, drift)
    yield prove("rim m/s² min", 0.0, s, friction_margin)
    yield prove("support m min", 0.0, lifted, support_margin)


def gripped(p: Plan, b: int) -> Iterator[Row]:
    """Prove that edges around a gripped body hold it, balance it, and are tangent to it."""
    body, stem, on, cables = p.bodies[b], p.bodies[b].stem, p.grip[b], range(p.n)
    arms, radius = norm(stem.core - stem.centroid), float(np.max(norm(stem.core))) + stem.radius
    turning = (np.max(arms) + stem.radius) ** 2 / (stem.radius or np.min(arms))
    q, contacts = p.hold_start[b], p.edges[1:3].ravel()
    start = to_frame(p.poses.c[0][q, b, None, :, 0], p.points.c[0][q, ..., 0][:, contacts])
    tangent = normalize(start[..., :2] - stem.centroid)[..., ::-1] * [-1.0, 1.0]

    def grip_ratio(s: Spans, _: Index) -> Line:
        """Return slip load ``μ Σ T_k e^{-μ' β} θ_k`` over load ``m (b (g + a_z) + α R² / r)``."""
        slip = s.zero
        for k in cables:
            weaker = (p.pulls.on(s, i) * capstan(s, i).inverse() for i in (2 * k, 2 * k + 1))
            slip = slip + wrap_angle(s, k) * minimum(*weaker) * body.friction
        a = p.poses.on(s, b, 2)
        load = (p.load_share.on(s, b) * (a[2] + G) + a[3:].norm() * turning) * body.mass
        return slip * maximum(load, 1e-6).inverse()

    def residual(s: Spans, _: Index) -> Line:
        """Return force and moment residuals over the smallest tension, less ground friction."""
        lifted, share, centre = p.lifted[b, s.piece], p.load_share.on(s, b), s.world(b, body.centre)
        a, moment = s.world(b, body.centre, 2).where(lifted), s.zero * UP
        force = -(a + share * UP * G) * body.mass
        for k in cables:
            leaving, arriving = s.edge(k)
            for end, u in ((0, -leaving.unit()), (1, arriving.unit())):
                pull = u * s.edge_pull(k)
                force = force + pull
                moment = moment + (s.point(p.edges[1 + end, k]) - centre).cross(pull)
        friction = (-share + 1.0) * (body.friction * body.mass * G)
        standing = maximum(force[:2].norm() - friction, force[2].norm()).where(~lifted)
        flying = maximum(force.norm(), moment.norm() * (1.0 / radius)).where(lifted)
        tension = maximum(minimum(*(s.edge_pull(k) for k in cables)), MIN_TENSION)
        return (flying + standing) * tension.inverse()

    def rotation(s: Spans, _: Index) -> Line:
        """Return the mean rotation against the contacts since the start of the hold [m]."""
        arms = [s.local(b, s.point(int(i)))[:2] - stem.centroid for i in contacts]
        turns = sum((x.unit().dot(tangent[s.piece, j]) for j, x in enumerate(arms)), s.zero)
        return turns.norm() * (radius / len(contacts))

    def wrap_error(s: Spans, k: Index) -> Line:
        """Return errors of contacts, and depths of straight parts inside the section."""
        ends, (leaving, arriving) = [s.local(b, s.point(i)) for i in p.edges[1:3, k]], s.edge(k)
        bend = norm(np.cross(normalize(leaving.v), normalize(arriving.v)))
        bent = (norm(ends[1].v - ends[0].v) > WRAP_TOL) | (bend > 2.0 * WRAP_TOL)
        errors = [leaving[0] * arriving[1] - leaving[1] * arriving[0]]  # [m²] turns to the left
        for x, edge in zip(ends, s.edge(k), strict=True):
            corner = stem.core[np.argmin(norm(x.v[:, None, :2] - stem.core), axis=1)]
            gap, rise = (x[:2] - corner).norm() - stem.radius, x[2] - start[s.piece, k, 2:]
            bounds = gap.norm(), rise.norm(), x[2] - stem.upper, -x[2] + stem.lower
            errors += [y.where(bent) for y in bounds]
            u = s.rotated(b, edge)[:2]
            valid, n = u.norm().high > WRAP_TOL, u.unit()
            for corner in stem.core:
                to = -x[:2] + corner
                errors.append((n[0] * to[1] - n[1] * to[0] + stem.radius).where(valid))
        return maximum(*errors)

    slides = np.any(p.load_share.c[0][:, b, 0] > 0.0, axis=-1)
    yield prove("grip 1 min", 1.5, p.spans(on & slides, [0], [body.name]), grip_ratio)
    yield prove("equilibrium 1 max", 5e-3, p.spans(on, [0], [body.name]), residual)
    yield prove("grip wrap max", 3 * WRAP_TOL, p.spans(on, cables, p.cables), wrap_error)
    yield prove("grip wrap max", CONTACT_TOL, p.spans(on & p.active[b], [0], [body.name]), rotation)


def hinged(p: Plan, b: int) -> Iterator[Row]:
    """Prove that a body does not fall over two clasps, nor over its foot as cables bend around it.

    All forces of both cables' legs pass through the line through their clasps.
    """
    body, stem, held = p.bodies[b], p.bodies[b].stem, p.grip[b] & p.two

    def hinge(s: Spans, j: Index) -> Line:
        """Return heights of clasps above the centre of mass."""
        return s.point(p.begin[j])[2] - s.world(b, body.centre)[2]

    def foot(s: Spans, _: Index) -> Line:
        """Return distances of the force line of a standing body from the edge of its foot.

        Edges pull at contacts. The foot is the largest disc about the centre of the section.
        """
        base, weight = s.world(b, np.append(stem.centroid, stem.lower)), G * body.mass
        down, moment = s.zero + weight, s.zero * UP
        for k in (0, 1):
            leaving, arriving = s.edge(k)
            for end, u in ((0, -leaving.unit()), (1, arriving.unit())):
                pull = u * s.edge_pull(k)
                down = down - pull[2]
                moment = moment + (s.point(p.edges[1 + end, k]) - base).cross(pull)
        return (down * float(stem.depth(stem.centroid)) - moment[:2].norm()) * (1.0 / weight)

    loaded = held & np.any(p.load_share.c[0][:, b, 0] > 0.0, axis=-1)
    clasps = p.spans(loaded, range(p.n), p.labels[p.V])
    yield prove("hinge m min", HINGE + p.tracking * p.ratio, clasps, hinge)
    standing = held & p.bent & (not body.fixed)
    yield prove("support m min", 0.0, p.spans(standing, [0], [body.name]), foot)


class Pair(Plan):
    """Two plans on common breaks; a plan rests before its start and after its end.

    Items of its spans are pairs of items. Minimum distances are the largest of all teams.
    """

    erring_bodies = 2

    def __init__(
        self, p: Plan, q: Plan, separation: dict[str, float], tube: tuple[float, float]
    ) -> None:
        self.plans, self.size = (p, q), max(p.size, q.size)
        breaks = np.concatenate([p.breaks, q.breaks])
        self.breaks = np.unique(breaks)
        self.h = np.diff(self.breaks)
        self._set_distances(separation, tube)

    def pieces(self, time: Array) -> Iterator[Items]:
        """Yield pieces of each plan at times (m,), the first or last one beyond its duration."""
        for p in self.plans:
            yield np.clip(np.searchsorted(p.breaks, time) - 1, 0, len(p.h) - 1)

    def both(self, s: Spans) -> Iterator[Spans]:
        """Yield spans of each plan."""
        for p, piece in zip(self.plans, self.pieces(s.time), strict=True):
            x = (s.time - p.breaks[piece]) / p.h[piece]
            own = Spans(p, piece, s.item, np.clip(x, 0.0, 1.0), 0.0 * x)
            own.t, own.zero, own.moving = s.t, s.zero, 1.0 * ((x > 0.0) & (x < 1.0))
            yield own

    def items(self, first: Solid, second: Solid) -> Spans:
        """Return spans of all pairs of items of both plans."""
        one, two = self.pieces(self.breaks[:-1] + 0.5 * self.h)
        items = np.indices((len(first[1]), len(second[1]))).reshape(2, -1).T
        return self.spans(first[0][one] & second[0][two], items, first[1], second[1])


Solid = tuple[Mask, Sequence[str], Callable[..., Any]]


def solids(p: Plan) -> list[Solid]:
    """Return masks of pieces, names and corners of drones and of cables.

    Cables are segments, sheets if they hang, strips if they are laid, or hulls if they clasp.
    """
    drones, laid = (p.all_pieces, p.names, lambda s, i: [s.point(i)]), p.state == LAID
    hanging = p.free & ~laid & ~p.clasping
    sheets = (hanging, p.cables, Spans.sheet), (laid, p.cables, Spans.strip)
    hulls = p.clasping, p.cables, Spans.hull
    return [drones, (p.taut, p.segment_names, Spans.segment), *sheets, hulls]


def between_plans(pair: Pair) -> Iterator[Row]:
    """Prove distances between drones and cables of two plans.

    Upright regions contain cables without a hitch. Distances to them are horizontal or vertical
    ones.
    """

    def ratio(a: list[Line], b: list[Line]) -> Line:
        return ((a[0] - b[0]) * pair.scale).norm()

    def below(a: list[Line], b: list[Line]) -> Line:
        """Return the distance over half an ellipsoid, large for cables above the drone.

        A point is as far from a strip as the chord above from the points up to the strip's depth
        over that point.
        """
        drone, cable = (a[0], b) if len(a) == 1 else (b[0], a)
        drone, *cable = (x * pair.wash for x in (drone, *cable))
        rise = minimum(*(x[2] for x in cable)) - drone[2] - pair.wash_lead
        over = [drone + (cable[0] - cable[2])] if cable[2:] else []
        return distance([drone, *over], cable[:2]).unless(rise)

    def gap(s: Spans, *items: Index, of: Sequence[Solid], measure: Callable[..., Line]) -> Line:
        return measure(*(x[2](t, k) for x, t, k in zip(of, pair.both(s), items, strict=True)))

    for (i, one), (j, two) in product(*(enumerate(solids(p)) for p in pair.plans)):
        measure = partial(prism_gap if max(i, j) > 1 else distance, ratio=pair.ratio)
        limit, s = pair.cable_limit if 0 in (i, j) else pair.crossing_limit, pair.items(one, two)
        if i == j == 0:
            measure, limit = partial(ratio), ("separation ratio min", 1.0)
        yield prove(*limit, s, partial(gap, of=(one, two), measure=measure))
        if {i, j} in ({0, 1}, {0, 3}):  # cables are taut, or laid
            yield prove("downwash ratio min", 1.0, s, partial(gap, of=(one, two), measure=below))


def object_distances(pair: Pair) -> Iterator[Row]:
    """Prove distances of drones, cables and objects of a plan to another plan's own objects.

    Distances of hanging cables are horizontal ones.
    """
    p, q = pair.plans

    def own_objects(p: Plan, q: Plan) -> Iterator[tuple[int, Slab, Solid]]:
        mine, theirs = (x.settings["objects"] for x in (p, q))
        for b, slab in p.slabs:
            name = p.bodies[b].name
            if np.any(p.moving[b]) or mine[name] != theirs.get(name):
                yield b, slab, (p.all_pieces, [name], Spans.world)

    def gap(s: Spans, *i: Index, b: int, slab: Slab, corners: Any) -> Line:
        mine, theirs = pair.both(s)
        points = [theirs.local(b, x) for x in corners(mine, i[0])]
        if len(points) < 5:
            return slab.gap(*points[:2], ratio=pair.ratio)
        *outline, lowest = points
        height = (lowest[2] - top[b]) * (1.0 / pair.ratio)
        return maximum(slab.gap(*outline, outline[0], ratio=pair.ratio), height)

    def height_ratio(s: Spans, i: Index, _: Index, b: int, slab: Slab) -> Line:
        mine, theirs = pair.both(s)
        return slab.below(theirs.local(b, mine.point(i)) * pair.wash, pair.wash_lead)

    def object_gap(s: Spans, *_: Index, b: int, slab: Slab, o: int, block: Slab) -> Line:
        mine, theirs = pair.both(s)
        return body_gap(mine, o, block, theirs, b, slab, pair.ratio)

    top = [max(slab.upper for slab in body.slabs) for body in q.bodies]
    cable_limit = pair.object_limit[0], pair.object_limit[1] + pair.tracking  # objects err too
    for b, slab, body in own_objects(q, p):
        for i, one in enumerate(solids(p)):
            limit = cable_limit if i else ("keep_out m min", pair.sep["radius"] + pair.tracking)
            tall = slab.enlarged(0.0, -BIG, BIG) if i > 1 else slab
            yield prove(*limit, pair.items(one, body), partial(gap, b=b, slab=tall, corners=one[2]))
        if np.any(q.moving[b]) or moves(p, q.bodies[b]):
            drones = solids(p)[0]
            over = partial(height_ratio, b=b, slab=slab.scaled(pair.wash))
            yield prove("downwash ratio min", 1.0, pair.items(drones, body), over)
        for o, block, other in own_objects(p, q):
            gaps = partial(object_gap, b=b, slab=slab, o=o, block=block)
            yield prove(*cable_limit, pair.items(other, body), gaps)


def worst_row(name: str, unit: str, limit: float, values: Sequence[Worst]) -> Row:
    """Return a row of the largest of values with times and places."""
    worst, time, where = max(values, default=(0.0, 0.0, ""))
    verdict = "proven" if worst <= limit + TOLERANCE * max(abs(limit), 1.0) else "violated"
    return Row(name, unit, verdict, worst, limit, "max", time, where, 1)


def fault_row(name: str, faults: Iterable[Fault]) -> Row:
    """Return a row of faults: the number of kinds, the first time, and texts."""
    wrong = sorted((time, text) for time, applies, text in faults if applies)
    kinds = [*dict.fromkeys(text for _, text in wrong)]
    values = [(float(len(kinds)), wrong[0][0], ", ".join(kinds[:6]))] if wrong else []
    return worst_row(name, "1", 0.0, values)


def jumps(p: Plan, *, rests: bool = False) -> Iterator[Row]:
    """Check jumps of curves at joints of pieces, as sums over time, and jumps of thrusts and pulls.

    With ``rests``, the plan must be at rest at its ends.
    """
    bodies, both = [body.name for body in p.bodies], (p.taut[1:] & p.taut[:-1])[:, None]

    def jump(c: Array, names: Sequence[str], on: Any = True, fold: Any = np.max) -> Iterator[Worst]:
        x = norm(c[1:, ..., 0] - c[:-1, ..., -1]) * on
        if x.size:
            i = int(np.argmax(each := fold(x, axis=0)))
            yield float(each[i]), float(p.breaks[np.argmax(x[:, i]) + 1]), names[i]

    def total(x: Array, axis: int) -> Array:
        """Return sums of jumps above rounding errors."""
        jumps = np.sum(np.where(x > 1e-9, x, 0.0), axis)
        return np.asarray(np.maximum(jumps, np.max(x, axis)))

    values, summed = list[Worst](), partial(jump, fold=total)
    for k in range(3):
        curves = (p.points.c[k][:, : p.N], p.names), (p.poses.c[k], bodies)
        values += chain(*(summed(curve, names) for curve, names in curves))
        values += summed(p.points.c[k][:, p.V], p.labels[p.V], both)
        if np.any(p.bent):  # inner ends of legs
            values += summed(p.points.c[k][:, p.anchor], p.names, both)
        values += summed(p.legs.c[k], p.names, both)
        for (curve, names), end in product(curves, (0, -1) if rests and k else ()):
            time = repeat(float(p.breaks[end]))
            values += zip(norm(curve[end, ..., end]).tolist(), time, names, strict=False)
    yield worst_row("continuity", "m", 1e-6, values)
    if not p.n:
        return
    drones = p.spans(p.all_pieces, range(p.N))
    with np.errstate(all="ignore"):
        ends = [drones.subspan(end).thrust(drones.item[:, 0]).v for end in (-1.0, 1.0)]
    on = p.taut[:, None, None, None]
    values = [*jump(np.stack(ends, -1).reshape(-1, p.N, 3, 2), p.names)]
    values += [*jump(p.tensions.c[0] * on, p.cables), *jump(p.pulls.c[0] * on, p.names)]
    # At both ends of a range, tensions are the team's unless an object is held there
    held, ranged = np.pad(np.any(p.held, axis=0), 1, "edge"), np.append(p.range_phase, -1)
    for q, end in product(np.flatnonzero(p.formed & (p.range_phase >= 0)), (0, -1)):
        o = q - 1 - 2 * end  # without a range, but with the same hold, beyond the plan
        if ranged[o] != ranged[q] and not (held[q + 1] and held[o + 1]):
            error = np.max(np.abs(p.tensions.c[0][q, :, :, end] - p.team))
            values.append((float(error), float(p.breaks[q - end]), "range"))
    yield worst_row("tension", "N", 1e-4, values)


def interlacing(p: Plan) -> Iterator[Row]:
    """Check the crossings of all pairs of cables against the states of phases."""
    if np.any(p.free) or np.any(np.isin(p.state, (LAID, ROLLING, BENT))):
        yield fault_row("interlacing", link_faults(p))


def link_faults(p: Plan) -> Iterator[Fault]:
    """Count crossings of chords on pieces on which cables are free now or later.

    A hitch keeps its links: chords are followed through it if cables are released later. On spans
    on which chords may touch, each must provably cross the other, projected along their common
    normal; the sign of ``(q_j - q_i)·((r_i - q_i) × (r_j - q_j))`` changes with each crossing.
    """
    n, m = p.n, len(p.h)
    half_crossings = np.zeros((n, n, m + 1))  # initial ones, then those of each piece

    def sign(s: Spans, end: float) -> Array:
        """Return the sign at an end of spans; at joints the one of the later piece."""
        x = s.x + end * s.w
        later = (x >= 1.0) & (s.piece < m - 1)
        there = Spans(p, s.piece + later, s.item, np.where(later, 0.0, x), 0.0 * x)
        i, j = s.item.T
        off = (there.point(2 * j) - there.point(2 * i)).v
        return np.asarray(np.sign(np.sum(off * np.cross(there.q_to_r(i).v, there.q_to_r(j).v), -1)))

    def decided(s: Spans, i: Index, j: Index) -> Line:
        ends, chords = (s.ends(i), s.ends(j)), (s.q_to_r(i), s.q_to_r(j))
        apart = distance(*ends).low > POS_TOL
        normal, crosses = normalize(np.cross(chords[0].v, chords[1].v)), ~apart
        for chord, (base, _), others in zip(chords, ends, ends[::-1], strict=True):
            a, b = (chord.cross(x - base).dot(normal) for x in others)
            crosses &= ((a.low > 0) & (b.high < 0)) | ((a.high < 0) & (b.low > 0))
        step = 0.5 * (sign(s, 1.0) - sign(s, -1.0)) * crosses
        np.add.at(half_crossings, (*s.item.T, s.piece + 1), step)
        return Line(s.zero.v, s.zero.g, np.where(apart | crosses, 0.0, BIG), s.t)

    # replay checks laid or rolling neighbours
    both, laid = np.triu_indices(n, 1), np.isin(p.state, (LAID, ROLLING, BENT))
    later_free = np.flip(np.logical_or.accumulate(np.flip(p.free)))
    loose = later_free[:, None] & ~(laid[:, None] & p.clasped[both])
    pairs = p.spans(loose, np.column_stack(both), p.cables, p.cables)
    row = prove("interlacing 1 min", 0.0, pairs, decided)
    yield row.time, row.verdict != "proven", row.where
    i, j = np.minimum(*p.pair), np.maximum(*p.pair)
    linked = np.full(len(p.clasps), float(p.formed[0]))  # as a hitch at the start is
    half_crossings[i, j, 0] = linked * (1 + p.two)
    if np.any(laid):
        faults, sense, _ = replay(p, half_crossings, linked, 0.0 * linked)
        s = p.spans(p.state == ROLLING, range(len(p.clasps)), p.labels[p.V])
        row = prove("roll 1 min", 0.0, s, partial(past_roll, sense=sense))
        past = row.verdict != "proven", f"the pair at {row.where} rolls past lying across"
        yield from (*faults, (row.time, *past))
    count = np.cumsum(half_crossings, axis=-1)
    numbers = np.array([CROSSINGS.get(state, -1) for state in p.state]) * (1 + p.two)
    expected = np.where(p.clasped[..., None], numbers, 0)
    same = np.concatenate([[False], p.formed[1:] & p.formed[:-1], [False]])  # within a hitch
    wrong = (np.abs(count[..., 1:]) != expected) & ~same[1:]
    wrong = (wrong | (np.abs(count[..., :-1]) != expected) & ~same[:-1]) & (expected >= 0)
    wrong[..., -1] |= (count[..., -1] != 0.0) & ~p.formed[-1]
    for k, o, q in np.argwhere(wrong & np.triu(np.ones((n, n), dtype=bool), 1)[..., None]):
        yield float(p.breaks[q]), True, f"{p.cables[k]}, {p.cables[o]}"


def consistency(p: Plan) -> Iterator[Row]:
    """Check phases and objects for contradictions, and the duration."""
    yield fault_row("consistency", (*phase_faults(p), *object_faults(p)))
    if p.limits["duration"] is not None:
        end = float(p.breaks[-1])
        yield worst_row("duration", "s", p.limits["duration"], [(end, end, "")])


def phase_faults(p: Plan) -> Iterator[Fault]:
    """Yield contradictions between curves and the states of cables in phases."""
    c = p.points.c[0][:, : p.N]
    for i, phase in enumerate(p.phases):
        at, state, on = phase["start"], phase["state"], p.phase == i
        s, k = p.spans(on & p.free, range(p.n)), np.tile(np.arange(p.n), np.sum(on & p.free))
        pulls = any(np.any(x.c[0][on & p.free]) for x in (p.legs, p.tensions, p.pulls))
        yield at, pulls, "tensions or legs without a hitch"
        if state == LAID:
            yield at, varies((c[:, 1::2] - c[:, 0::2])[on]), "cables turn while they are laid"
        if state == ROLLING and np.any(on):
            legs = p.legs.c[0][on]  # change as they sag, or as weight passes
            lowest = np.min(p.min_tension[on], axis=0)
            sag = (p.weight / lowest) ** 2 / 24.0 * np.max(legs, (0, -1)).reshape(p.n, 2) ** 3
            drift = (sag + 1e-4).reshape(legs.shape[1:-1])
            rolls = varies(p.points.c[0][on][:, p.V]) or varies(legs, drift)
            yield at, rolls, "vertices or legs move while pairs roll"
            T, pulled = p.tensions.c[0][on], p.pulls.c[0][on]
            other = np.ptp(p.team) > 0.0 or np.max(np.abs(pulled - np.repeat(T, 2, 1))) > 1e-4
            busy = np.any(p.load) or np.any((p.rest | p.active)[:, on]) or other
            yield at, bool(busy), "pairs with loads or unequal tensions roll"
            start, change, _ = roll_changes(p, np.flatnonzero(on))
            shut = np.abs([start, start + change]) < OPEN_ROLL
            yield at, bool(np.all(shut)), "no pair rolls or lies across"
        if state == DRAWN and np.any(on):
            yield at, varies(c[on][:, :, 2]), "drones change their heights as cables are drawn taut"
        if p.two and np.any(on & p.formed):
            yield at, phase["hold"] is None, "two cables are tied around nothing"
        if p.n and state == "on the ground":
            with np.errstate(all="ignore"):
                depth = [np.min(lowest_height(s.subspan(x), k).v) for x in (-1.0, 0.0, 1.0)]
            high = min(depth) - p.floor > p.settings["separation"]["cable"] + RESOLUTION
            high |= varies(c[on][:, :, :2])
            yield at, high, "cables do not lie on the ground as stated"
        if state == "clasping":
            middle = 0.5 * (c[on][:, 2 * p.clasps] + c[on][:, 2 * p.behind + 1])
            yield at, varies(middle, RESOLUTION), "drones do not turn about each other"
        if state == "being tightened":
            over = s.route_length(k).v.reshape(-1, p.n) - (1.0 - 1e-4) * p.length[:, 0]
            full = np.sum(p.h[on] * (over @ p.team[:, 0] > 0.0)) > 0.5 * np.sum(p.h[on])
            yield at, full, "cables stated as slack have their full length"


def object_faults(p: Plan) -> Iterator[Fault]:
    """Yield objects without support, that move unheld, or with inconsistent load shares."""
    c = p.poses.c[0]
    for b, body in enumerate(p.bodies):
        moving, busy, lifted, s = p.moving[b], p.active[b], p.lifted[b], p.spans(p.all_pieces, [b])
        head = [norm(p.poses.at(s.subspan(x), b)[:, 3:]) for x in (-1.0, -0.5, 0.0, 0.5, 1.0)]
        under = np.array([support_below(p, b, x)[0] for x in c[..., 0]])
        falls = (np.abs(c[:, b, 2, 0] + body.stem.lower - under) > POS_TOL) & ~lifted & ~moving
        loose, share = p.rest[b] & (body.rim is None or not p.closed), p.load_share.c[0][:, b, 0]
        if p.n and not np.all(loose):
            seen = to_frame(c[:, b, None, :, 0], p.points.c[0][:, p.V, :, 0])
            side, to = (np.roll(seen, -1, 1) - seen)[..., :2], body.centre[:2] - seen[..., :2]
            right = side[..., 1] * to[..., 0] - side[..., 0] * to[..., 1] > 0.0
            below = seen[..., 2] <= body.height + CONTACT_TOL
            loose |= p.rest[b] & ~np.all(right & below, axis=1)
        for wrong, words in (
            (np.max(np.abs(np.array(head) - 1.0), axis=0) > POS_TOL, "has an invalid heading"),
            (busy & ~(p.held[b] & p.formed), "moves or has a load share without a hold"),
            (moving & ~lifted, "moves without a load share of 1"),
            (np.any((share < 0.0) | (share > 1.0), axis=-1), "has a load share outside 0 to 1"),
            (busy & body.fixed, "is fixed but moves"),
            (falls & (not body.fixed), "has no support"),
            (p.grip[b] & (not p.n or not p.has_contacts), "is gripped by straight edges"),
            (loose, "is not inside the clasps below its rim"),
        ):
            yield float(p.breaks[np.argmax(wrong)]), bool(np.any(wrong)), f"{body.name} {words}"


def plan_rows(p: Plan) -> Iterator[Row]:
    """Yield the rows of all checks, several for some limits."""
    taut = (taut_cables,) if np.any(p.taut) else ()
    bent = (bent_cables,) if np.any(p.bent) else ()
    for check in (consistency, drones, *taut, *bent, *((free_cables,) if p.n else ())):
        yield from check(p)
    of_bodies = resting, gripped, hinged, clear_objects, clear_held
    for check_of, b in product(of_bodies, range(len(p.bodies))):
        yield from check_of(p, b)
    yield from (*jumps(p), *interlacing(p))


def read(path: Path) -> tuple[list[Plan], list[Plan]]:
    """Return the plans of a file: those of its teams, and others on the same clock."""
    try:
        if path.exists() and not path.is_file():  # A pipe or a device may never end
            raise ValueError("it is no file on a disk")
        with np.load(path, allow_pickle=False) as file:
            form, s = str(file["format"]), json.loads(str(file["settings"]))
            check_members([x.orig_filename for x in file.zip.infolist()])
            if form != "hitchopt-flight/1":
                raise ValueError(f"format is {form!r:.60}, not hitchopt-flight/1")
            return plans_of_groups(file, s)
    except Exception as error:  # malformed files raise many kinds
        words = " ".join(f"{type(error).__name__}: {error}".split())
        raise UnreadableError(words[:300]) from error


def fold(name: str) -> str:
    """Return a name as readers compare it that ignore case and normalise Unicode."""
    return unicodedata.normalize("NFKC", unicodedata.normalize("NFKC", name).casefold())


def check_members(names: Sequence[str]) -> None:
    """Raise ValueError for names that some reader changes, or takes for one another."""
    words, seen = r"\w[\w.-]*(?<!\.)/", set[str]()
    for name in names:
        if not re.fullmatch(rf"({words})*\w+\.npy", name):
            raise ValueError(f"{name!r:.60} is not the name of an array")
        if fold(name) in seen:
            raise ValueError(f"an array occurs twice, or is easily taken for {name!r:.60}")
        seen.add(fold(name))


def plans_of_groups(file: Any, s: dict[str, Any]) -> tuple[list[Plan], list[Plan]]:
    """Return the plans of teams and other plans."""
    check_type("settings", s, "settings")
    plans, seen = list[Plan](), {"others"}
    for key in ("groups", "others"):
        for i, head in enumerate(s[key]):
            name, several = head["name"], len(s["groups"]) > 1 or key == "others"
            form = r"[^\W\d][\w-]*" + r"(\.[^\W\d][\w-]*)?" * (key == "others")
            if not (re.fullmatch(form, name) if several else name == "") or fold(name) in seen:
                raise ValueError(f"{name!r:.60} is not a valid name of its own")
            if key == "groups" and (head["plan"] or head["digest"]):
                raise ValueError("a team is from another plan")
            seen.add(fold(name))
            plans.append(Plan(file, head, f"{key}/{i}/"))
    teams = s["groups"]
    own = plans[: len(teams)]
    if max(abs(p.breaks[-1] - own[0].breaks[-1]) for p in own) > POS_TOL:
        raise ValueError("teams have different durations")
    if any(p.breaks[0] != 0.0 for p in own):
        raise ValueError("breaks do not start at 0")
    for p in own if len(own) > 1 else ():
        curves = p.points, p.poses, p.legs, p.pulls, p.tensions, p.load_share
        for i in (i for i, phase in enumerate(p.phases) if phase["name"] == "wait"):
            if any(varies(x.c[0][p.phase == i], REST_TOL) for x in curves):
                raise ValueError(f"{p.label}phases[{i}] is a wait, but something moves")
    return own, plans[len(teams) :]


def verify(path: str | Path) -> Iterator[Row]:
    """Yield a row for every limit of a plan; UnreadableError if the file is not a plan."""
    path = Path(path)
    own, others = read(path / "plan.npz" if path.is_dir() else path)
    rows, order = [row for p in own for row in plan_rows(p)], ("violated", "not proven", "proven")
    if len(own) + len(others) > 1:
        rests = (row for p in (*own, *others) for row in jumps(p, rests=True))
        rows += (row for row in rests if row.name == "continuity")
    keys = own[0].settings["separation"]
    off = max(p.tube[0] for p in own), max(p.tube[1] for p in own)
    wide = {key: max(p.settings["separation"][key] for p in own) for key in keys}
    for p, q in combinations([*own, *others], 2):
        if p in own:
            one, two = Pair(p, q, wide, off), Pair(q, p, wide, off)
            rows += [*between_plans(one), *object_distances(one), *object_distances(two)]
    rows = [row for row in rows if row.samples]
    for name, unit in dict.fromkeys((row.name, row.unit) for row in rows):
        same = [row for row in rows if (row.name, row.unit) == (name, unit)]
        sign = 1.0 if same[0].sense == "min" else -1.0

        def rank(row: Row, sign: float = sign) -> tuple[int, float]:  # limits of teams may differ
            return order.index(row.verdict), sign * (row.worst - row.limit) / abs(row.limit or 1.0)

        worst = min(same, key=rank)
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
    bad = dict.fromkeys(row.name for row in rows if row.verdict not in PASSING)
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
    return 0 if all(row.verdict in PASSING for row in rows) else 3


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
