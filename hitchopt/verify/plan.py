"""The plan of one team in a file: its settings, phases, objects, and the curves of all its points.

``Plan`` is read in the order of its methods; the table of its fields states their shapes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence, Set
from copy import copy
from functools import cached_property
from itertools import pairwise, product
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
)
from .settings import check_type
from .shapes import Slab, to_frame

REST_TOL = 1e-9  # [m] of the file format, as the next two
CONTACT_TOL = 1e-4  # [m]
WRAP_TOL = 2e-5  # [m]
MIN_GAP = 1e-4  # [m] minimum distance of cables that cannot pass through each other
TAUT_TOL = 1e-4  # [N] largest difference of a tension from that of taut cables
EXACT_RANGE = 0.5  # [m] of exact distances of hanging cables
MAX_COEFFS = 61  # coefficients of a curve
NO_CABLES: dict[str, Any] = {  # of teams of single drones
    "cable_length": [],
    "tension": [],
    "load": 0.0,
    "cable_density": 0.0,
    "cable_friction": 0.0,
}

# States of cables
GROUNDED = "on the ground"
HANGING = "hanging free"
CLASPING = "clasping"
TIGHTENED = "being tightened"
LOOSE = "loose after a loss"  # at the start of a plan, until a chain is tightened
HITCHED = "hitched"
CROSSINGS = {GROUNDED: 0, HANGING: 0, TIGHTENED: 1, LOOSE: 1, HITCHED: 1}  # of a clasp
UNLINKED = (GROUNDED, HANGING)  # no links
STATES = {*CROSSINGS, CLASPING, "none"}


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

    It has m pieces, n robots and cables, N drones, P vertices and o objects. Cable k runs from its
    drone 2k, named q, along a leg, an edge and a leg to its drone 2k + 1, named r. Cables and
    drones are in order along the hitch.

    Points are N drones, then P vertices, then the two contacts of every edge with an object; twice
    the midpoint for a straight edge. If cables bend on their own, further points are the inner ends
    of legs: their own ones then, and vertices otherwise.
    """

    # Of the request
    only: Set[str] = frozenset()  # names of the rows to prove; empty for all
    request: dict[str, Any] = {}  # noqa: RUF012  # the problem of this team alone
    may_wait = False  # whether other teams or plans fly, for which it waits before and after steps
    stated: Sequence[dict[str, Any]] = ()  # rules of the user, whose formulas are not in the file

    # Settings
    label: str  # prefix of names: "a." of team a; "" of a team alone
    settings: dict[str, Any]  # of the team, with requirements and phases
    limits: dict[str, Any]
    arena: dict[str, Any] | None
    floor: float  # [m] height of the ground; -BIG without one

    # Numbers of bodies
    n: int  # robots; 0 for single drones
    N: int  # drones
    V: slice  # of the vertices among the points
    closed: bool  # a ring of cables; else a chain
    two: bool  # both cables clasp each other twice, around an object

    # Distances, widened by tracking errors
    erring_bodies = 1  # of drones and what is below them: objects that stand have no errors
    tube: tuple[float, float]  # [m] tracking errors that the plan states
    tracking: float  # [m] horizontal tracking error that widens distances
    ratio: float  # of vertical to horizontal errors, at least 1: heights are divided by it
    sep: dict[str, float]  # [m] limits of separation
    scale: Array  # (3,) [1/m] of differences of drones: 1 if their ellipsoids touch
    wash: Array  # (3,) [1/m] of differences from what is below a drone
    wash_lead: float  # height above a drone, scaled by ``wash``, up to which it meets cables
    cable_limit: tuple[str, float]  # header and limit of rows of drones and cables
    crossing_limit: tuple[str, float]  # of two cables
    object_limit: tuple[str, float]  # of cables and objects

    # Pieces and phases
    breaks: Array  # (m + 1,) [s]
    h: Array  # (m,) [s] durations
    phases: list[dict[str, Any]]
    phase: Items  # (m,) index of the phase
    state: Any  # (m,) state of cables, a text
    all_pieces: Mask  # (m,) all true
    formed: Mask  # (m,) there is a hitch
    pulling: Mask  # (m,) cables have a tension: formed, or tightened
    free: Mask  # (m,) cables without edges
    clasping: Mask  # (m,) cables clasp, are tightened or loose after a loss
    range_phase: Items  # (m,) phase that states a range of tensions; -1 without one
    tied: Mask  # (m,) cables clasp before or after a hitch
    tied_vertices: Array  # (m, P, 3) [m] vertices of that hitch

    # Drones and cables, in order along the hitch
    drone: Items  # (N,) numbers in the problem
    robot: Items  # (n,) numbers in the problem
    edge: Items  # (n,) of each robot of the problem
    names: list[str]  # of drones
    cables: list[str]  # names
    labels: list[str]  # of all points
    mass: Array  # (N, 1) [kg]
    max_thrust: Array  # (N, 1) [N]
    length: Array  # (n, 1) [m] of cables
    stated_tension: Array  # (n, 1) [N] of the team
    tension_range: Array  # (m, n, 2) [N]
    min_tension: Array  # (m, n, 1) [N] from which on cables are taut
    weight: float  # [N/m] of cables
    mu: float  # largest friction of cables
    load: Array  # (clasps, 1) [kg]

    # How cables run: indices of points, unless said otherwise
    begin: Items  # (n,) vertices at the starts of edges
    end: Items  # (n,) vertices at the ends of edges
    clasps: Items  # (clasps,) cables that begin at a clasp
    behind: Items  # (clasps,) cables that end there
    edges: Items  # (4, n) vertex or inner end, both contacts, vertex or inner end
    leg: Mask  # (2n,) drone has a leg: all but those at the ends of a chain
    anchor: Items  # (2n,) inner ends of legs
    pull_point: Items  # (2n,) towards which cables pull drones
    pairs: Items  # (P, 2) drones that turn about each vertex; twice the same at a chain's ends
    clasped: Mask  # (n, n) cables that clasp each other
    segments: Items  # (k, 5) straight segments: both ends, cable, and the vertices at its ends
    segment_names: list[str]
    has_contacts: bool  # some edge touches an object, or bends on its own
    frictional: bool  # tensions of some leg and edge differ

    # Curves
    points: Curve  # (m, points, 3)
    legs: Curve  # (m, 2n, 1) lengths of chords, as stated
    tensions: Curve  # (m, n, 1) of edges
    pulls: Curve  # (m, 2n, 1) tensions of legs
    poses: Curve  # (m, o, 5): position, and the direction of its first axis
    load_share: Curve  # (m, o, 1) of an object's weight
    size: float  # [m] largest coordinate

    # Objects
    bodies: list[Body]
    slabs: list[tuple[int, Slab]]  # sections of objects, with their numbers
    walls: list[tuple[int, Slab]]  # prisms, with the number -1
    rest: Mask  # (o, m) held by resting on cables
    grip: Mask  # (o, m) held by a grip
    held: Mask  # (o, m) by either
    holding: Mask  # (o, m, n) cables that hold it
    lifted: Mask  # (o, m) cables carry all of its weight
    moving: Mask  # (o, m)
    active: Mask  # (o, m) moving or loaded
    hold_start: Items  # (o, m) first piece on which it is active

    def __init__(self, file: Any, head: dict[str, Any], folder: str, effort: Effort) -> None:
        records = head["records"]
        self.file, self.folder, self.effort = file, folder, effort
        self.label = f"{head['name']}." if head["name"] else ""
        self.settings = {**records, **records["requirements"]}
        team = records["team"]
        check_type("team", team, "team" if "robots" in team else "single")
        self._read_sizes(team)
        self._read_clock()
        self._read_limits()
        self._read_quadrotors(team)
        self._read_places(self.settings["assignment"])
        self._name_points()
        self._read_phases()
        self._read_bodies()
        self._index_cables()
        self._read_cables(team)
        self._read_curves()
        self._read_tension_ranges()
        self._list_segments()

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
        if self.n and name in ("legs", "leg_tensions", "contacts"):
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
        self.cable_limit = self._distance_limit("cable_clearance", "cable")
        self.crossing_limit = self._distance_limit("crossing", "crossing")
        self.object_limit = self._distance_limit("object_clearance", "object")

    def _distance_limit(self, name: str, key: str) -> tuple[str, float]:
        """Return the header of a row of distances, and the limit [m] of a key of separation."""
        return f"{name} m min", max(float(self.sep[key]), MIN_GAP)

    def _semi_axes(self, separation: dict[str, float], error: float) -> Array:
        """Return those of the ellipsoid that contains a drone's one and a ball of errors.

        It has the smallest radius.
        """
        wide, high = separation["radius"], separation["height"] / self.ratio
        high = math.sqrt((high**2 + wide * error) * (1.0 + error / wide))
        return np.array([wide + error, wide + error, high * self.ratio])

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

    def _read_sizes(self, team: dict[str, Any]) -> None:
        """Read the numbers of robots, drones and vertices."""
        self.n = int(team.get("robots", 0))
        self.N = 2 * self.n or int(team["drones"])
        self.closed = team.get("topology") == "closed"
        vertices = self.n if self.closed else self.n + (self.n > 0)
        self.V = slice(self.N, self.N + vertices)
        if self.n and (team["topology"] not in ("closed", "open") or self.n < 2):
            raise ValueError("team has too few robots, or a topology other than closed or open")

    def _read_clock(self) -> None:
        """Read breaks."""
        self.breaks = self.file[f"{self.folder}breaks"]
        self.h = np.diff(self.breaks)
        self.all_pieces = np.ones(len(self.h), dtype=bool)
        if len(self.h) < 1 or not np.all(self.h > 0.0):
            raise ValueError(f"{self.label}breaks do not increase")
        self._array("breaks", len(self.h) + 1, bound=BIG)

    def _read_limits(self) -> None:
        """Read limits, minimum distances and the arena."""
        settings = self.settings
        self.limits, self.arena = dict(settings["limits"]), settings["arena"]
        self.tube = tube_of(self.limits["tracking"])
        self.set_distances(settings["separation"], self.tube)
        if self.limits["reserve"] > 1.0 or self.limits["tilt"] >= 0.5 * math.pi:
            raise ValueError("limits.reserve is above 1, or limits.tilt is not below 90 degrees")
        self.limits.setdefault("floor", 0.0)  # which files omit
        self.floor = -BIG if self.limits["floor"] is None else float(self.limits["floor"])
        if self.arena is not None:
            self.floor = max(self.floor, float(self.arena["lower"][2]))
            if np.any(np.array(self.arena["lower"]) >= self.arena["upper"]):
                raise ValueError("arena has a lower bound that is not below its upper bound")

    def _read_quadrotors(self, team: dict[str, Any]) -> None:
        """Read masses and thrusts of drones, in the problem's order."""
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
        """Read the problem's robots and drones in order along the hitch.

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

    def _name_points(self) -> None:
        """Name drones, cables, and all points."""
        label, vertices = self.label, self.V.stop - self.V.start
        drones = [f"{'qr'[i % 2]}{i // 2}" if self.n else f"d{i}" for i in self.drone]
        self.names = [f"{label}{drone}" for drone in drones]
        self.cables = [f"{label}cable {i}" for i in self.robot]
        of_contacts = np.repeat(self.cables, 2)
        self.labels = [*self.names, *(f"{label}p{j}" for j in range(vertices)), *of_contacts]

    def _read_phases(self) -> None:
        """Read phases, and the states of cables on pieces."""
        self.phases = self.settings["phases"]
        ends = [float(phase["end"]) for phase in self.phases[:-1]]
        self.phase = np.searchsorted(ends, self.breaks[:-1] + 0.5 * self.h)
        self._check_phases()
        self.state = np.array([phase["state"] for phase in self.phases])[self.phase]
        self.formed = self.state == HITCHED
        self.pulling = self.formed | (self.state == TIGHTENED)
        self.free = ~self.formed & (self.n > 0)
        self.clasping = np.isin(self.state, (CLASPING, TIGHTENED, LOOSE))

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
            states = STATES
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

    def _read_bodies(self) -> None:
        """Read objects, their poses, how they are held, and the shares of their weight."""
        m, n = len(self.h), self.n
        self.bodies = [Body(name, body) for name, body in self.settings["objects"].items()]
        self.slabs = [(b, slab) for b, body in enumerate(self.bodies) for slab in body.slabs]
        self.walls = [
            (-1, Slab(prism["polygon"], None, prism["lower"], prism["upper"]))
            for prism in self.settings["keep_out"]
        ]
        o = len(self.bodies)
        self.rest, self.grip = np.zeros((2, o, m), dtype=bool)
        self.holding = np.zeros((o, m, n), dtype=bool)
        names = [body.name for body in self.bodies]
        for piece, hold in enumerate(self.phases[i]["hold"] for i in self.phase):
            if hold is not None:
                body = names.index(hold["object"])
                held_so = self.rest if hold["by"] == "rest" else self.grip
                held_so[body, piece] = True
                self.holding[body, piece, self.edge[hold["cables"]]] = True
        self.held = self.rest | self.grip
        self.poses = Curve(self._array("poses", m, o, 5), self.h)
        first = np.array([body.pose for body in self.bodies]).reshape(o, 5)
        if np.any(np.abs(self.poses.c[0][0, ..., 0] - first) > REST_TOL):
            raise ValueError(f"{self.label}an object starts at another pose")
        share = self._array("load_share", m, o)
        share = np.where(np.abs(share - np.round(share)) <= 2.0**-40, np.round(share), share)
        self.load_share = Curve(share[:, :, None], self.h)
        self.lifted = np.all(share == 1.0, axis=-1).T
        self.moving = np.any(np.ptp(self.poses.c[0], axis=-1) > REST_TOL, axis=-1).T
        self.active = self.moving | np.any(share != 0.0, axis=-1).T
        continues = self.active & np.roll(self.active, 1, axis=1)
        self.hold_start = np.maximum.accumulate(np.where(continues, 0, np.arange(m)), axis=1)

    def _index_cables(self) -> None:
        """Set how cables run: along which points, and which cables clasp each other."""
        n, N = self.n, self.N
        vertices = self.V.stop - self.V.start
        cable = np.arange(n)
        self.begin, self.end = N + cable, N + (cable + 1) % max(vertices, 1)
        self.clasps = cable[not self.closed :]
        self.behind = (self.clasps - 1) % max(n, 1)
        first_contact = N + vertices + 2 * cable
        self.edges = np.stack([self.begin, first_contact, first_contact + 1, self.end])
        at_ends = np.stack([self.begin, self.end], axis=-1)  # vertices at both ends of cables
        has_leg = np.ones((n, 2), dtype=bool)
        has_leg[:1, 0] = has_leg[-1:, 1] = self.closed
        self.leg, self.anchor = has_leg.ravel(), at_ends.ravel()
        self.pull_point = np.where(has_leg, at_ends, at_ends[:, ::-1]).ravel()
        vertex = np.arange(vertices)
        self.pairs = np.stack([2 * vertex, 2 * vertex - 1], axis=-1) % max(N, 1)
        if not self.closed and n:
            self.pairs[[0, -1]] = [[0, 0], [N - 1, N - 1]]
        self.clasped = np.zeros((n, n), dtype=bool)
        self.clasped[self.clasps, self.behind] = self.clasped[self.behind, self.clasps] = True

    def _read_cables(self, team: dict[str, Any]) -> None:
        """Read lengths, tensions, weights, loads and friction of cables."""
        team = {**NO_CABLES, **team}
        self.weight = G * float(team["cable_density"])
        self.mu = float(np.max(team["cable_friction"]))
        self.load = (np.array(team["load"], dtype=float) * np.ones(len(self.clasps)))[:, None]
        self.length = np.array(team["cable_length"], dtype=float)[self.robot, None]
        self.stated_tension = np.array(team["tension"], dtype=float)[self.robot, None]

    def _read_curves(self) -> None:
        """Read the curves of drones and cables: of straight edges and equal tensions as one."""
        m, n, N, vertex_count = len(self.h), self.n, self.N, self.V.stop - self.V.start
        drones = self._array("drones", m, N, 3)
        vertices = self._array("vertices", m, vertex_count, 3)
        tensions = self._array("tensions", m, n)
        contacts, middles = self._array("contacts", m, n, 2, 3), midpoints(vertices, n)
        pulls, of_edges = self._array("leg_tensions", m, n, 2), np.stack([tensions, tensions], 2)
        self.has_contacts = differ(contacts, middles)
        self.frictional = differ(pulls, of_edges)
        contacts = contacts if self.has_contacts else middles
        pulls = pulls if self.frictional else of_edges
        legs = self._array("legs", m, n, 2)
        self.tensions = Curve(tensions[:, :, None], self.h)
        self.pulls, self.legs = (
            Curve(of_legs.reshape(m, 2 * n, 1, of_legs.shape[-1]), self.h)
            for of_legs in (pulls, legs)
        )
        parts = [drones, vertices, contacts.reshape(m, 2 * n, 3, contacts.shape[-1])]
        self._set_ties(vertices)
        count = max(part.shape[-1] for part in parts)
        parts = [elevate(part, count) for part in parts]
        self.points = Curve(np.concatenate(parts, axis=1), self.h)
        drones, *on_cables = parts
        used = drones, *(part[self.formed] for part in on_cables)
        self.size = max(float(np.max(np.abs(part), initial=0.0)) for part in used)

    def _set_ties(self, vertices: Array) -> None:
        """Set vertices of the hitch before or after pieces on which cables clasp."""
        m, count = vertices.shape[:2]
        self.tied, self.tied_vertices = np.zeros(m, dtype=bool), np.zeros((m, count, 3))
        others = np.flatnonzero(~self.clasping)
        for piece in np.flatnonzero(self.clasping & (self.state != LOOSE)):
            before, after = others[others < piece][-1:], others[others > piece][:1]
            for near, end in ((after, 0), (before, -1)):
                if len(near) and self.formed[near[0]]:
                    self.tied[piece] = True
                    self.tied_vertices[piece] = vertices[near[0], ..., end]

    def _read_tension_ranges(self) -> None:
        """Read the ranges of tensions that phases state; without one, tensions are the team's."""
        m = len(self.h)
        self.range_phase = np.full(m, -1)
        self.tension_range = np.tile(self.stated_tension, (m, 1, 2))
        for i, phase in enumerate(self.phases):
            if phase["tension"] is not None:
                within = self.breaks[:-1] >= phase["start"] - POS_TOL
                within &= self.breaks[1:] <= phase["end"] + POS_TOL
                self.range_phase[within], self.tension_range[within] = i, phase["tension"]
        self.min_tension = self.tension_range[..., :1]

    def _list_segments(self) -> None:
        """List the straight segments of taut cables: legs first, then parts of edges."""
        cable, with_leg = np.arange(self.n), np.flatnonzero(self.leg)
        vertex = np.stack([self.begin, self.end], axis=-1).ravel()[with_leg]
        legs = (self.anchor[with_leg], with_leg, with_leg // 2, vertex, vertex)
        along_edge = self.edges if self.has_contacts else self.edges[::3]
        parts = [(a, b, cable, self.begin, self.end) for a, b in pairwise(along_edge)]
        self.segments = np.concatenate([np.stack(part, axis=-1) for part in (legs, *parts)])
        drones = [divmod(self.drone[i], 2) for i in with_leg]
        leg_names = [f"{self.label}{'qr'[end]}-leg {robot}" for robot, end in drones]
        edge_names = [f"{self.label}edge {k}" for k in cable]
        self.segment_names = leg_names + edge_names * len(parts)

    @cached_property
    def ramp(self) -> Mask:
        """Pieces on which a cable's tension rises from 0, or falls to it (m, n).

        A ramp begins next to a piece without a hitch, is at rest, and ends at the first joint at
        which the tension is the smallest at which the hitch is held. What never gets there is none.
        Cables that are tightened are on one throughout.
        """
        still = np.delete(self.points.c[0], self.edges[1:3].ravel(), axis=1)
        rest = np.all(np.ptp(still, axis=-1) <= REST_TOL, axis=(1, 2))
        ends = self.tensions.c[0][:, :, 0][..., [0, -1]]
        low = ends < self.min_tension - TAUT_TOL
        ramp = np.repeat((self.state == TIGHTENED)[:, None], self.n, axis=1)
        forward = range(len(rest))
        for (pieces, start), k in product(((forward, 0), (forward[::-1], 1)), range(self.n)):
            rising: list[int] | None = None  # pieces since there was no hitch
            for q in pieces:
                if not self.formed[q]:
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


def midpoints(vertices: Array, n: int) -> Array:
    """Return contacts of straight edges (m, n, 2, 3, N + 1)."""
    middle = 0.5 * (vertices + np.roll(vertices, -1, 1))[:, :n]
    return np.stack([middle, middle], 2)


class RimLoads(NamedTuple):
    """Effects of resting bodies on cables, at starts of pieces; 0 without a body.

    A rim on the clasps bends legs: below it they are horizontal, beyond it they rise with ``sin α =
    W / (2 Σ T)`` for a weight W of body and edges, on a horizontal length l of each leg.
    """

    # (o, m, n) [m] by which cables are shorter, ``l (1 / cos α - 1)`` at the full load share
    length_loss: Array
    # (o, m) Share by which the rim reduces the pull of edges, ``1 - cos α`` at the full share
    pull_loss: Array
    depth: Array  # (o, m) [m] of vertices below the rim, ``tan α`` times the mean l
    shares: Array  # (o, m, n, 3) of the body's mass and moments, by least squares


def rim_loads(p: Plan) -> RimLoads:
    """Return the effects of resting bodies on the cables of a plan."""
    length_loss, shares = np.zeros(p.holding.shape), np.zeros((*p.holding.shape, 3))
    pull_loss, depth = np.zeros(p.rest.shape), np.zeros(p.rest.shape)
    for b, q in np.argwhere(p.rest & p.active & p.closed).tolist():
        body = p.bodies[b]
        vertices = p.points.c[0][q, p.V, :, 0]
        tensions = p.tensions.c[0][q, :, 0, 0]
        clasps = to_frame(p.poses.c[0][q, b, :, 0], vertices)[:, :2]
        moments = np.column_stack([np.ones(p.n), clasps - body.centre[:2]])
        shares[b, q] = np.linalg.pinv(moments).T
        edges = norm(np.roll(vertices, -1, axis=0) - vertices)
        weight = G * body.mass + p.weight * np.sum(edges)
        sine = min(weight / (2.0 * np.sum(tensions)), 1.0 - TOLERANCE)
        cosine = math.sqrt(1.0 - sine**2)
        pull_loss[b, q] = 1.0 - cosine
        if body.rim is not None:
            ahead, back = lengths_below(body.rim, clasps)
            length_loss[b, q] = (np.roll(ahead, 1) + np.roll(back, -1)) * (1.0 / cosine - 1.0)
            depth[b, q] = np.mean(ahead + back) * 0.5 * sine / cosine
    return RimLoads(length_loss, pull_loss, depth, shares)


def lengths_below(rim: Slab, clasps: Array) -> tuple[Array, Array]:
    """Return the lengths (n,) [m] of edges' extensions below a rim, beyond their ends and starts.

    They are found by bisection; edges run between consecutive clasps (n, 2) of a ring.
    """
    ends = np.stack([np.roll(clasps, -1, axis=0), clasps])
    outward = normalize(ends - ends[::-1])
    inside, outside = np.zeros(ends.shape[:2]), np.full(ends.shape[:2], 1e3)
    for _ in range(80):
        middle = 0.5 * (inside + outside)
        is_below = rim.depth(ends + middle[..., None] * outward) > 0.0
        inside, outside = np.where(is_below, middle, inside), np.where(is_below, outside, middle)
    beyond_ends, beyond_starts = inside
    return beyond_ends, beyond_starts
