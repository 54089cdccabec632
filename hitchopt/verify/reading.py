"""Plan files: types of settings, arrays, states of cables, holds of objects."""

from __future__ import annotations

import json
import math
import re
import unicodedata
from collections.abc import Callable, Sequence, Set
from copy import copy
from functools import cached_property
from itertools import pairwise, product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .arithmetic import (
    BIG,
    POS_TOL,
    TOLERANCE,
    Array,
    Curve,
    Effort,
    G,
    Items,
    Mask,
    differ,
    elevate,
    norm,
    normalize,
    varies,
)
from .shapes import Slab, to_frame

REST_TOL = 1e-9  # [m] of the file format, as the next two
CONTACT_TOL = 1e-4  # [m]
WRAP_TOL = 2e-5  # [m]
MIN_GAP = 1e-4  # [m] minimum distance of cables that cannot pass through each other
TAUT_TOL = 1e-4  # [N] largest difference of a tension from that of taut cables
SAG_TOL = 0.02  # [m] largest gap of cables that lie on each other, due to different sags
EXACT_RANGE = 0.5  # [m] of exact distances of hanging cables
MAX_COEFFS = 61  # coefficients of a curve
EFFORT = 40_000_000  # effort of all proofs of a file, besides PER_FIRST of their first passes

# States of cables
CROSSINGS = {"on the ground": 0, "hanging free": 0, "being drawn taut": 0}
CROSSINGS |= {"being tightened": 1, "loose after a loss": 1, "hitched": 1}  # of a clasp's cables
LAID = "being laid"  # single taut cables
ROLLING = "rolling"  # pairs between crossing and clasp
CLASPING = "clasping"
TIGHTENED = "being tightened"
LOOSE = "loose after a loss"  # at the start of a plan, until a chain is tightened
UNLINKED = {"on the ground", "hanging free"}  # no links
DRAWN = "being drawn taut"  # single cables
BENT = "bent around an object"  # single cables, with edges
OF_TWO = {*UNLINKED, DRAWN, BENT, ROLLING, "hitched"}  # states of two cables that clasp twice
STATES = {*CROSSINGS, CLASPING, LAID, ROLLING, BENT, "none"}

# Keys of settings and their types: ? nullable, [] list, [2] list of two; keys with * may be absent.
TYPES = {
    "settings": "title:text problem:text request:any groups:group[] others:group[] rules*:rule[]",
    "rule": "name:text unit:text sense:sense limit:number worst:number?",
    "group": "name:text plan:text digest:text records:records",
    "records": "team:any requirements:requirements phases:phase[] assignment:roles?",
    "requirements": "limits:limits separation:separation arena:arena? keep_out:prism[] objects:any",
    "team": "robots:count cable_length:+[] topology:text cable_density:0+ cable_friction:range "
    "tension:+[] quadrotor:kind[] load:0+[] errors*:errors release*:flag",
    "errors": "cable_length:0+ drone:tube? friction:0+",
    "single": "drones:count quadrotor:kind[]",
    "kind": "mass:+ max_thrust:+ stiffness:+? integral:flag? feed_forward:flag? controller:text? "
    "gains:gains? latency:0+? model:text? trim*:number[2] thrust_factor*:+ tracking*:tube",
    "tube": "level:0+ height:0+",
    "gains": "kp:+[2]? kd:+[2]? ki:0+[2]?",
    "limits": "speed:+ acceleration:+ jerk:+ tilt:+ body_rate:+? vertex_speed:+ leg:+ duration:+? "
    "reserve:+ tracking:tube? vertex_error*:+ survive*:text",
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
    "range": lambda x: (
        all(SCALARS["0+"](y) for y in x) and len(x) == 2 and x[0] <= x[1]
        if type(x) is list
        else SCALARS["0+"](x)
    ),
    "sense": lambda x: x in ("min", "max"),
    "tube": lambda x: SCALARS["number"](x) and x >= 0,
    "any": lambda _: True,
}


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
    """Return horizontal and vertical tracking errors [m] of a limit."""
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
    only: Set[str] = frozenset()  # names of the rows to prove; empty for all
    asked: dict[str, Any] = {}  # noqa: RUF012  # of the problem: the sections of this team alone
    stated: Sequence[dict[str, Any]] = ()  # rules of the user, whose formulas are not in the file

    def __init__(self, file: Any, head: dict[str, Any], folder: str, effort: Effort) -> None:
        self.file, self.folder, records, self.effort = file, folder, head["records"], effort
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

    def set_distances(self, separation: dict[str, float], tube: tuple[float, float]) -> None:
        """Set minimum distances, widened by horizontal and vertical errors of drones [m].

        Where heights are divided by ``ratio`` of the errors, errors are within a ball, and no
        distance is longer.
        """
        self.sep, (error, height) = dict(separation), tube
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

    def without_errors(self) -> Plan:
        """Return the plan of drones without tracking errors."""
        plan = copy(self)
        plan.set_distances(self.settings["separation"], (0.0, 0.0))
        return plan

    def proving(self, names: Set[str]) -> Plan:
        """Return the plan of which only some rows are proven."""
        plan = copy(self)
        plan.only = names
        return plan

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
        self.tube = tube_of(self.limits["tracking"])
        self.set_distances(s["separation"], self.tube)
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
        self.vertical = np.max(np.ptp(drones[:, :, :2], axis=-1), axis=(1, 2)) <= POS_TOL

    @cached_property
    def ramp(self) -> Mask:
        """Pieces on which a cable's tension rises from 0, or falls to it (m, n).

        A ramp begins next to a piece without a hitch, is at rest, and ends at the first joint at
        which the tension is the smallest at which the hitch is held. What never gets there is none.
        """
        still = np.delete(self.points.c[0], self.edges[1:3].ravel(), axis=1)
        rest = np.all(np.ptp(still, axis=-1) <= REST_TOL, axis=(1, 2))
        ends = self.tensions.c[0][:, :, 0][..., [0, -1]]
        low, ramp = ends < self.min_tension - TAUT_TOL, np.zeros(ends.shape[:2], bool)
        forward = range(len(rest))
        for (pieces, start), k in product(((forward, 0), (forward[::-1], 1)), range(self.n)):
            rising: list[int] | None = None  # pieces since there was no hitch
            for q in pieces:
                if not self.taut[q]:
                    rising = []
                elif rising is None or not (rest[q] and low[q, k, start]):
                    rising = None
                else:
                    rising.append(q)
                    if not low[q, k, 1 - start]:
                        ramp[rising, k], rising = True, None
        return ramp

    @cached_property
    def rim(self) -> RimLoads:
        """Effects of resting bodies on cables, which only proofs need."""
        return rim_loads(self)

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
        """Read the problem's robots (n,) and drones (N,) in order along the hitch.

        Robot ``robot[k]`` holds edge k, and cables and drones are in order along the hitch from
        here.
        """
        n, roles = self.n, assignment or {"robots": [*range(self.n)], "flipped": [False] * self.n}
        if (sorted(roles["robots"]), len(roles["flipped"])) != ([*range(n)], n):
            raise ValueError(f"{self.label}assignment is not a permutation")
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
        self.weight = G * float(team["cable_density"])
        self.mu = float(np.max(team["cable_friction"]))
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
            on_cables.append(self._read_inner_ends(vertices))
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
        self.min_tension = self.tension_range[..., :1]  # from which on cables are taut
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

    def _read_inner_ends(self, vertices: Array) -> Array:
        """Read the inner ends of legs (m, 2n, 3, N + 1), and let legs and edges end there.

        Cables that bend on their own state theirs. Those of other cables are at vertices.
        """
        m, n = len(vertices), self.n
        stated = self._array("anchors", m, n, 2, 3)
        coefficients = max(stated.shape[-1], vertices.shape[-1])
        at_vertices = elevate(vertices, coefficients)[:, self.anchor - self.N]
        stated = elevate(stated, coefficients).reshape(at_vertices.shape)
        last_contact = self.edges[2, -1]
        inner_ends = last_contact + 1 + np.arange(2 * n)
        self.anchor = self.pull_point = inner_ends
        self.edges[0], self.edges[3] = inner_ends[0::2], inner_ends[1::2]
        self.labels += self.names
        return np.where(self.bent[:, None, None, None], stated, at_vertices)

    def _read_ties(self, vertices: Array) -> None:
        """Read which drones turn about vertices, and vertices of the hitch before or after."""
        (m, P), n, N = vertices.shape[:2], self.n, self.N
        # Drones that turn about each vertex; twice the same at the ends of a chain (P, 2)
        j = np.arange(P)
        self.pairs = np.stack([2 * j, 2 * j - 1], -1) % max(N, 1)
        if not self.closed and n:
            self.pairs[[0, -1]] = [[0, 0], [N - 1, N - 1]]
        # Vertices of the hitch before or after each piece on which cables clasp (m, P, 3)
        self.clasping = np.isin(self.state, (CLASPING, TIGHTENED, LOOSE))
        self.tied, self.tied_vertices = np.zeros(m, bool), np.zeros((m, P, 3))
        for piece in np.flatnonzero(self.clasping & (self.state != LOOSE)):
            run = np.flatnonzero(~self.clasping)
            before, after = run[run < piece][-1:], run[run > piece][:1]
            for near, end in ((after, 0), (before, -1)):
                if len(near) and self.formed[near[0]]:
                    self.tied[piece] = True
                    self.tied_vertices[piece] = vertices[near[0], ..., end]


def midpoints(vertices: Array, n: int) -> Array:
    """Return contacts of straight edges (m, n, 2, 3, N + 1)."""
    middle = 0.5 * (vertices + np.roll(vertices, -1, 1))[:, :n]
    return np.stack([middle, middle], 2)


class RimLoads(NamedTuple):
    """Effects of resting bodies on cables, at starts of pieces; 0 without a body.

    A rim on the clasps bends legs: below it they are horizontal, beyond it they rise with ``sin α =
    W / (2 Σ T)`` for a weight W of body and edges, on a horizontal length l of each leg.
    """

    length_loss: Array
    """(o, m, n) [m] by which cables are shorter, ``l (1 / cos α - 1)`` at the full load share."""

    pull_loss: Array
    """(o, m) Share by which the rim reduces the pull of edges, ``1 - cos α`` at the full share."""

    depth: Array
    """(o, m) [m] of vertices below the rim, ``tan α`` times the mean l."""

    shares: Array
    """(o, m, n, 3) of the body's mass and moments, by least squares."""


def rim_loads(p: Plan) -> RimLoads:
    """Return the effects of resting bodies on the cables of a plan."""
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
    return RimLoads(length_loss, pull_loss, depth, shares)


def read(path: Path) -> tuple[list[Plan], list[Plan]]:
    """Return the plans of a file: those of its teams, and others on the same clock."""
    try:
        if path.exists() and not path.is_file():  # A pipe or a device may never end
            raise ValueError("it is not a regular file")
        with np.load(path, allow_pickle=False) as file:
            form, s = str(file["format"]), json.loads(str(file["settings"]))
            check_texts({"format": form, **s})
            check_members([x.orig_filename for x in file.zip.infolist()])
            if form != "hitchopt-flight/1":
                raise ValueError(f"format is {form!r:.60}, not hitchopt-flight/1")
            return plans_of_teams(file, s)
    except Exception as error:  # malformed files raise many kinds
        words = " ".join(f"{type(error).__name__}: {error}".split())
        raise UnreadableError(words[:300]) from error


def check_texts(settings: dict[str, Any]) -> None:
    """Raise ValueError for control characters in texts, which terminals may obey.

    The text of the problem may have line breaks and tabs.
    """
    problem = re.sub(r"[\t\n\r\x85]", "", str(settings.get("problem")))
    values: list[Any] = [{**settings, "problem": problem}]
    while values:
        x = values.pop()
        if isinstance(x, dict | list):
            values += [*x, *x.values()] if isinstance(x, dict) else x
        elif isinstance(x, str) and {"Cc", "Cs"} & {*map(unicodedata.category, x)}:
            raise ValueError(f"{x!r:.60} has control characters")


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
            raise ValueError(f"an array occurs twice, or is easily confused with {name!r:.60}")
        seen.add(fold(name))


def asked_of(problem: Any, name: str) -> dict[str, Any]:
    """Return the problem of one team, in the form of a team alone; nothing without a problem.

    A flight of single drones is a mission of one step.
    """
    if problem is None:
        return {}
    if not isinstance(problem, dict) or "start" not in problem:
        raise ValueError(f"request is {problem!r:.60}, not a problem")
    if "goal" in problem:
        flight = {key: problem[key] for key in ("goal", "duration") if key in problem}
        return {**problem, "mission": [{"fly": flight}]}
    if not name:
        return problem
    steps = list[Any]()
    for item in problem["mission"]:
        own = item.get(name, [])
        steps += own if isinstance(own, list) else [own]
    own_parts = {"team": problem["teams"][name], "start": problem["start"][name], "mission": steps}
    return {**problem, **own_parts}


def plans_of_teams(file: Any, s: dict[str, Any]) -> tuple[list[Plan], list[Plan]]:
    """Return the plans of teams and other plans."""
    check_type("settings", s, "settings")
    plans, seen, effort = list[Plan](), {"others"}, Effort(EFFORT)
    for key in ("groups", "others"):
        for i, head in enumerate(s[key]):
            name, several = head["name"], len(s["groups"]) > 1 or key == "others"
            form = r"[^\W\d][\w-]*" + r"(\.[^\W\d][\w-]*)?" * (key == "others")
            if not (re.fullmatch(form, name) if several else name == "") or fold(name) in seen:
                raise ValueError(f"{name!r:.60} is not a valid name, or not unique")
            if key == "groups" and (head["plan"] or head["digest"]):
                raise ValueError("a team is from another plan")
            seen.add(fold(name))
            plans.append(Plan(file, head, f"{key}/{i}/", effort))
    teams = s["groups"]
    own = plans[: len(teams)]
    own[0].stated = s.get("rules", [])
    for plan in own:
        plan.asked = asked_of(s["request"], plan.label.rstrip("."))
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
