"""What a plan shows of the keys of its steps: ``STEP_KEYS`` is the table of their comparison."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from .arithmetic import POS_TOL, Array, Items, norm, normalize
from .plan import CLASPING, TAUT_TOL, Plan
from .spans import Spans

CLOSE = 1e-6  # [m], [s] largest difference of what is asked for and shown, relative above 1
SLIDE = 9.99e-4  # [m] least change of legs after which vertices may over-travel
PATH_TOL = 1e-3  # [m] largest distance of a path from a point that it passes, between samples
SAMPLES = np.linspace(0.0, 1.0, 41)  # shares of a piece, where points of paths are looked for

Shown = Any  # a difference, an array or an iterator of differences
Shows = Callable[["Step", Any, Mapping[str, Any]], Shown]


class Step(NamedTuple):
    """One step of a plan: its pieces and its phases without waits at its start and end."""

    p: Plan
    pieces: Items
    phases: list[dict[str, Any]]
    #: Vertices (P, 3) that it starts from: the goals of a step that goes on without a stop
    before: Array
    continues: bool  #: Whether the step before it goes on without a stop
    first: int  #: Piece at which the steps begin that go on without a stop up to this one

    def points(self, end: int, of: slice) -> Array:
        """Return points (k, 3) at the step's start (0) or end (-1)."""
        return np.asarray(self.p.points.c[0][self.pieces[end], of, :, end])

    def vertices(self, end: int = -1) -> Array:
        """Return vertices (P, 3); nan without a hitch."""
        return vertices_at(self.p, self.pieces[end], end)

    def drones(self, end: int = -1) -> Array:
        """Return drones (N, 3) in the order of the problem."""
        return self.points(end, slice(0, self.p.N))[np.argsort(self.p.drone)]

    def pose(self, name: str, end: int = -1) -> Array:
        """Return the pose of an object (5,)."""
        return np.asarray(self.p.poses.c[0][self.pieces[end], self.body(name), :, end])

    def body(self, name: str) -> int:
        """Return the index of an object."""
        return [body.name for body in self.p.bodies].index(name)

    def held(self, step: Mapping[str, Any]) -> str:
        """Return the name of the object that a step names, or that is held in it."""
        named = step.get("object") or step.get("around")
        return str(named or next(x["hold"]["object"] for x in self.phases if x["hold"]))

    def samples(self, item: int) -> tuple[Array, Array]:
        """Return times (k,) from the step's start and positions (k, 3) of a point on its pieces."""
        p = self.p
        on = self.pieces[self.p.breaks[self.pieces] >= self.start - POS_TOL]
        c = p.points.c[0][on, item]
        n = c.shape[-1] - 1
        k = np.arange(n + 1)
        basis = [math.comb(n, j) for j in k] * SAMPLES[:, None] ** k
        places = np.einsum("mdj,sj->msd", c, basis * (1.0 - SAMPLES[:, None]) ** (n - k))
        times = p.breaks[on, None] + p.h[on, None] * SAMPLES - self.start
        return times.ravel(), places.reshape(-1, 3)

    @property
    def start(self) -> float:
        """Time [s] at which it stops waiting."""
        return float(self.phases[0]["start"])

    @property
    def swings(self) -> list[dict[str, Any]]:
        """Phases named settle at its end in which vertices over-travel, after cables slid."""
        found = list[dict[str, Any]]()
        for phase in reversed(self.phases):
            if phase["name"] != "settle" or not self.over_travels(phase):
                break
            found.append(phase)
        return found

    def over_travels(self, phase: Mapping[str, Any]) -> bool:
        """Return whether a phase ends where it starts, after cables slid against friction."""
        p = self.p
        within = (p.breaks[:-1] > phase["start"] - CLOSE) & (p.breaks[1:] < phase["end"] + CLOSE)
        pieces = np.flatnonzero(within)
        if not p.mu or not len(pieces):
            return False
        places = p.points.c[0][pieces][:, : p.V.stop]
        returns = np.all(np.abs(places[-1, ..., -1] - places[0, ..., 0]) <= CLOSE)
        return bool(returns) and self.slid(int(pieces[0]))

    def slid(self, end: int) -> bool:
        """Return whether cables slid, or were tied, since the last stop, up to a piece."""
        before = slice(self.first, end)
        legs = self.p.legs.c[0][before]
        slide = np.max(np.ptp(legs, axis=(0, -1)), initial=0.0) if len(legs) else 0.0
        return bool(slide > SLIDE or not np.all(self.p.formed[before]))

    @property
    def seconds(self) -> float:
        """Duration [s] without swings of drones at its end."""
        own = [phase for phase in self.phases if phase not in self.swings]
        return duration_of(own or self.phases)


def vertices_at(p: Plan, piece: int, end: int) -> Array:
    """Return vertices (P, 3) at the start (0) or end (-1) of a piece; nan without a hitch."""
    vertices = p.points.c[0][piece, p.V, :, end]
    return np.asarray(vertices if p.formed[piece] else np.full_like(vertices, np.nan))


def duration_of(phases: list[dict[str, Any]]) -> float:
    """Return the sum of the phases' durations [s]."""
    return float(sum(phase["end"] - phase["start"] for phase in phases))


def infinite_if(wrong: Any) -> float:
    """Return an infinite difference of what is wrong, or none."""
    return math.inf if wrong else 0.0


def angle_between(first: Array, last: Array, turn: float) -> float:
    """Return the turn of a direction (2,) in excess of ``turn`` [rad], without whole turns."""
    z = complex(*last[:2]) * complex(*first[:2]).conjugate()
    return float(np.angle(z * np.exp(-1j * turn))) if z else math.inf


def duration(s: Step, value: Any, step: Mapping[str, Any]) -> Shown:
    """Return the difference from a duration [s], the least one of a step that is blended."""
    off = s.seconds - value
    return min(off, 0.0) if s.continues or step.get("blend") else off


def polygon(s: Step, value: Any, _: Mapping[str, Any]) -> Shown:
    """Return differences of vertices from their goals."""
    return s.vertices()[:, :2] - np.array(value, dtype=float)


def moved_vertices(step: Mapping[str, Any], count: int) -> list[int]:
    """Return the indices of the vertices, of ``count``, that the keys of a step move."""
    if "polygon" in step:
        return [*range(count)]
    if "edge" in step:
        return [int(step["edge"]), (int(step["edge"]) + 1) % count]
    return [int(step["vertex"])] if "vertex" in step else []


def goals_after(s: Step, step: Mapping[str, Any]) -> Array:
    """Return the vertices (P, 3) that the keys of a step lead to."""
    goals = s.before.copy()
    place = np.array(step.get("to") or (), dtype=float)
    if place.shape == (3,):  # of a transport
        arms = goals - centroid_of(goals, closed=s.p.closed)
        turn = math.radians(step.get("yaw_deg") or 0.0)
        cosine, sine = math.cos(turn), math.sin(turn)
        turned_arms = arms[:, :2] @ np.array([[cosine, sine], [-sine, cosine]])
        return np.asarray(place + np.column_stack([turned_arms, arms[:, 2]]))
    moved = moved_vertices(step, len(goals))
    if step.get("by") is not None:
        goals[moved, :2] += step["by"]
    elif (places := step.get("polygon", step.get("to"))) is not None:
        goals[moved, :2] = places
    return goals


def moved_to(s: Step, value: Any, step: Mapping[str, Any], by: float) -> Shown:
    """Return differences of a vertex, or of both ends of an edge, from goals, or from offsets."""
    moved = moved_vertices(step, len(s.before))
    return (s.vertices() - by * s.before)[moved, :2] - np.array(value, dtype=float)


def others_stay(s: Step, _value: Any, step: Mapping[str, Any]) -> Shown:
    """Return how far vertices move that the step does not name, and the heights of all."""
    moves = s.vertices() - s.before
    moves[moved_vertices(step, len(moves)), :2] = 0.0
    return moves


def nothing_moves(s: Step, _value: Any, _: Mapping[str, Any]) -> Shown:
    """Return how far drones and objects move."""
    curves = s.p.points.c[0][:, : s.p.N], s.p.poses.c[0]
    return max(float(np.max(np.ptp(x[s.pieces], axis=(0, -1)), initial=0.0)) for x in curves)


def holds(s: Step, value: Any, _: Mapping[str, Any]) -> Shown:
    """Return no difference if an object is held at the end, or if none is."""
    return infinite_if(bool(np.any(s.p.held[:, s.pieces[-1]])) is not value)


def untied(s: Step, _value: Any, _: Mapping[str, Any]) -> Shown:
    """Return no difference if there is no hitch at the end."""
    return infinite_if(s.p.formed[s.pieces[-1]])


def centroid_of(vertices: Array, *, closed: bool) -> Array:
    """Return the centroid (3,) of the area of a polygon, or of the length of an open chain."""
    origin = vertices[0, :2]
    x = vertices[:, :2] - origin
    y = np.roll(x, -1, axis=0)
    if closed:
        cross = x[:, 0] * y[:, 1] - x[:, 1] * y[:, 0]
        level = (x + y).T @ cross / (3.0 * np.sum(cross))
    else:
        lengths = norm(y - x)[:-1]
        level = (0.5 * (x + y)[:-1]).T @ lengths / np.sum(lengths)
    return np.append(origin + level, np.mean(vertices[:, 2]))


def turned(s: Step, value: Any, _: Mapping[str, Any]) -> Shown:
    """Return the angle between the hitch and the one that was turned."""
    first, last = (x[1] - x[0] for x in (s.before, s.vertices()))
    return angle_between(first, last, math.radians(value))


def path(s: Step, value: Any, step: Mapping[str, Any]) -> Shown:
    """Yield distances of a vertex from its points, at their times if they have times."""
    times, places = s.samples(s.p.N + int(step["vertex"]))
    yield from (s.vertices()[int(step["vertex"]), :2] - value[-1][-2:]).tolist()
    for point in value[:-1]:
        goal = np.array(point[-2:], dtype=float)
        if len(point) == 3:
            at = [np.interp(point[0], times, x) for x in places.T[:2]]
            yield max(float(norm(at - goal)) - PATH_TOL, 0.0)
        else:
            a = places[:-1, :2]
            d = np.diff(places[:, :2], axis=0)
            share = np.sum((goal - a) * d, -1) / np.maximum(np.sum(d * d, -1), 1e-300)
            near = norm(a + np.clip(share, 0.0, 1.0)[:, None] * d - goal)
            yield max(float(np.min(near)) - PATH_TOL, 0.0)


def speed(s: Step, value: Any, step: Mapping[str, Any]) -> Shown:
    """Return by how much a vertex is too fast at samples [m/s]."""
    times, places = s.samples(s.p.N + int(step["vertex"]))
    h = np.diff(times)
    rates = norm(np.diff(places, axis=0)[h > 0.0]) / h[h > 0.0]
    return max(float(np.max(rates)) - (1.0 + CLOSE) * float(value), 0.0)


def tension(s: Step, value: Any, _: Mapping[str, Any]) -> Shown:
    """Return the distance of tensions from a range, or of those at a joint from a number [N]."""
    taut = s.pieces[s.p.formed[s.pieces]]
    if isinstance(value, dict | list):
        low, high = (value["min"], value["max"]) if isinstance(value, dict) else value
        T = s.p.tensions.c[0][taut]
        return max(low - float(np.min(T)), float(np.max(T)) - high, TAUT_TOL) - TAUT_TOL
    off = [np.max(np.abs(x.c[0][taut, :, 0, -1] - value), 1) for x in (s.p.tensions, s.p.pulls)]
    return max(float(np.min(off, initial=math.inf)) - TAUT_TOL, 0.0)


def held_by(s: Step, value: Any, _: Mapping[str, Any]) -> Shown:
    """Return no difference if an object is held in one of the step's phases, in that way."""
    holds = {x["hold"]["by"] for x in s.phases if x["hold"]}
    return infinite_if(holds != {value})


def names_object(s: Step, value: Any, _: Mapping[str, Any]) -> Shown:
    """Return no difference if no other object is held or moves."""
    own = s.body(str(value))
    p = s.p
    others = (p.held | p.active)[:, s.pieces]
    return infinite_if(np.any(np.delete(others, own, axis=0)))


def assigned(s: Step, value: Any, _: Mapping[str, Any]) -> Shown:
    """Return no difference if robots take edges in order, where that is requested."""
    return infinite_if(value == "fixed" and np.any(s.p.drone != np.arange(s.p.N)))


def legs(s: Step, value: Any, _: Mapping[str, Any], end: int = -1) -> Shown:
    """Yield differences of lengths of q-legs, and of their roll."""
    p = s.p
    sharing, roll = value, None
    if isinstance(value, dict):
        sharing, roll = value.get("sharing"), value.get("roll_deg")
    if isinstance(sharing, list):
        cables = np.arange(p.n)
        lengths = at_end(s, cables, end).leg_length(2 * cables).v[:, 0]
        yield from (lengths - np.array(sharing, dtype=float)).tolist()
    if roll not in (None, "auto"):
        yield from (rolls(s, end) - np.radians(roll)).tolist()


def at_end(s: Step, items: Items, end: int) -> Spans:
    """Return spans of no width at the step's start (0) or end (-1)."""
    zero = np.zeros(len(items))
    return Spans(s.p, np.full(len(items), s.pieces[end]), items[:, None], zero - end, zero)


def rolls(s: Step, end: int) -> Array:
    """Return the angles [rad] from the plane of a clasp's edges to its q-leg, positive upward.

    They are about the sum of both legs' tensions at the clasp.
    """
    p = s.p
    ahead = 2 * p.clasps
    behind = 2 * p.behind + 1
    at = at_end(s, ahead, end)
    q, r = (at.leg_part(i).first.v for i in (ahead, behind))
    axis = normalize(q + r)
    bisector = normalize(at.edge(p.clasps)[0].v) + normalize(at.edge(p.behind)[1].v)
    level, leg = (x - np.sum(x * axis, 1, keepdims=True) * axis for x in (bisector, q))
    rise = np.sum(leg * np.cross(level, axis), 1)
    return np.asarray(np.arctan2(rise, np.sum(leg * level, 1)))


def settled(s: Step, value: Any, step: Mapping[str, Any]) -> Shown:
    """Return the error [s] of the duration of over-travels, if there are any, or cables slid."""
    last = s.swings[-1]["start"] if s.swings else math.inf
    end = int(np.sum(s.p.breaks[s.pieces] < last - CLOSE)) + int(s.pieces[0])
    is_due = value is not False and not step.get("blend") and s.p.mu and s.slid(end)
    return duration_of(s.swings) - float(value) if s.swings or is_due else 0.0


SENSES = {"up": 1, "down": -1, "auto": 0}
"""Words for which drone of a pair goes up first: q, r or any."""


def swap(s: Step, value: Any, _: Mapping[str, Any]) -> Shown:
    """Yield by how much pairs turn faster [s], closer [m], or about other axes, than requested.

    The axis of a pair is normal to the chord of its drones, and tilted upward from horizontal so
    that the upper drone passes inside.
    """
    p = s.p
    phases = [x for x in s.phases if x["state"] == CLASPING]
    seconds, radius = value.get("seconds") or 0.0, value.get("radius") or 0.0
    tilt = value.get("tilt_deg")
    stated = value.get("sense", 0)
    sense = int(SENSES.get(stated, stated))
    yield from (max(seconds - (x["end"] - x["start"]), 0.0) for x in phases)
    on = s.pieces[p.state[s.pieces] == CLASPING]
    c = p.points.c[0][on]
    for k, j in zip(2 * p.clasps, 2 * p.behind + 1, strict=True):
        apart = 0.5 * (c[:, k] - c[:, j])
        turns = np.any(np.ptp(apart, axis=-1) > CLOSE, axis=1)
        nearest = float(np.min(norm(apart[turns, :, 0]), initial=math.inf))
        yield max(radius - nearest, 0.0)
        chord = normalize(apart[0, :, 0])
        beside = apart[:, :, -1] - np.outer(apart[:, :, -1] @ chord, chord)
        highest = beside[np.argmax(norm(beside))]
        first = beside[np.argmax(norm(beside) > 0.5 * norm(highest))]
        yield infinite_if(sense * first[2] < 0.0)
        if tilt is not None:
            inward = highest[0] * chord[1] - highest[1] * chord[0]
            up = math.copysign(1.0, highest[2])
            yield math.atan2(up * inward, up * highest[2]) - math.radians(tilt)


def placed(s: Step, value: Any, step: Mapping[str, Any]) -> Shown:
    """Return the difference of an object from its goal."""
    return s.pose(s.held(step))[:3] - np.array(value, dtype=float)


def object_turned(s: Step, value: Any, step: Mapping[str, Any]) -> Shown:
    """Return the angle between an object and the one that was turned."""
    name = s.held(step)
    return angle_between(s.pose(name, 0)[3:], s.pose(name)[3:], math.radians(value))


def via(s: Step, value: Any, step: Mapping[str, Any]) -> Shown:
    """Yield distances of an object from its waypoints, which it visits in order."""
    places = s.p.poses.c[0][s.pieces, s.body(s.held(step)), :3, -1]
    for place in value:
        off = norm(places - np.array(place, dtype=float))
        i = int(np.argmax(off <= CLOSE)) if np.any(off <= CLOSE) else int(np.argmin(off))
        yield float(off[i])
        places = places[i:]


def highest(s: Step, value: Any, step: Mapping[str, Any]) -> Shown:
    """Return the height error of an object's flight, over the higher of start and goal."""
    z = s.p.poses.c[0][s.pieces, s.body(s.held(step)), 2]
    top = max(float(z[0, 0]), float(z[-1, -1])) + value
    asked = max([top, *(float(place[2]) for place in step.get("via") or ())])
    return float(np.max(z)) - asked


def risen(s: Step, value: Any, step: Mapping[str, Any]) -> Shown:
    """Return the difference of an object from its position that much higher."""
    first, last = (s.pose(s.held(step), end)[:3] for end in (0, -1))
    return last - first - np.array([0.0, 0.0, value])


def flown(s: Step, value: Any, _: Mapping[str, Any]) -> Shown:
    """Return differences of drones from their goals."""
    return s.drones() - np.array(value, dtype=float)


def on_spots(s: Step, value: Any, step: Mapping[str, Any]) -> Shown:
    """Return differences of drones from landing spots in plan view, in order or of the nearest."""
    if value is None:
        return ()
    spots = np.array(value, dtype=float)
    drones = s.drones()[:, :2]
    if step.get("assign") == "fixed":
        return drones - spots
    distances = norm(drones[:, None] - spots)
    return np.concatenate([np.min(distances, axis=0), np.min(distances, axis=1)])


def assigned_spots(s: Step, value: Any, step: Mapping[str, Any]) -> Shown:
    """Return differences of drones from the step's landing spots, if they are assigned so."""
    return on_spots(s, step.get("to"), {"assign": value})


def grounded(s: Step, _value: Any, _: Mapping[str, Any]) -> Shown:
    """Return the heights of drones above the floor."""
    return s.drones()[:, 2] - s.p.floor


def stopped(s: Step, value: Any, _: Mapping[str, Any]) -> Shown:
    """Return the speed of drones at the end of a step, unless it continues without a stop."""
    rates = norm(s.p.points.c[1][s.pieces[-1], : s.p.N, :, -1])
    return 0.0 if value else float(np.max(rates))


STEP_KEYS: dict[str, Shows] = {
    "duration": duration,
    "seconds": lambda s, x, _: s.seconds - x,
    "polygon": polygon,
    "altitude": lambda s, x, _: s.vertices()[:, 2] - x,
    "legs": legs,
    "blend": stopped,
    "tension": tension,
    "settle": settled,
    "object": names_object,
    "form.assign": assigned,
    "form.swap": swap,
    "move_vertex.to": partial(moved_to, by=0.0),
    "move_vertex.by": partial(moved_to, by=1.0),
    "move_edge.to": partial(moved_to, by=0.0),
    "move_edge.by": partial(moved_to, by=1.0),
    "follow_vertex.path": path,
    "follow_vertex.speed": speed,
    "transport.to": lambda s, x, _: centroid_of(s.vertices(), closed=s.p.closed) - x,
    "transport.yaw_deg": turned,
    "grasp.by": held_by,
    "lift.by": risen,
    "carry.to": placed,
    "carry.yaw_deg": object_turned,
    "transport_object.by": held_by,
    "transport_object.to": placed,
    "transport_object.yaw_deg": object_turned,
    "transport_object.lift": highest,
    "transport_object.via": via,
    "fly.goal": flown,
    "release.to": on_spots,
    "release.assign": assigned_spots,
    "land.to": on_spots,
    "land.assign": assigned_spots,
}
"""Functions by key, or by step and key, for the difference of a plan from a key's request.

Keys without a step mean the same in every step.
"""

IMPLICIT: dict[str, Shows] = {
    "on_the_ground": grounded,
    "nothing_moves": nothing_moves,
    "others_stay": others_stay,
    "holds": holds,
    "untied": untied,
}
"""Functions as those of ``STEP_KEYS``, for what steps do without a key."""

IMPLIED: dict[str, dict[str, Any]] = {
    "hold": {"nothing_moves": True},
    "release": {"untied": True},
    "land": {"on_the_ground": True},
    "morph": {"others_stay": True},
    "move_vertex": {"others_stay": True},
    "move_edge": {"others_stay": True},
    "follow_vertex": {"others_stay": True},
    "adjust": {"others_stay": True},
    "settle": {"others_stay": True},
    "grasp": {"holds": True},
    "lift": {"holds": True},
    "carry": {"holds": True},
    "set_down": {"holds": True},
    "enclose": {"holds": False},
    "loosen": {"holds": False},
    "leave": {"holds": False},
    "transport_object": {"holds": False},
}
"""Keys of ``IMPLICIT`` by step; every step ends at rest unless it blends."""

OF_END = {"polygon", "altitude", "legs", "to", "by", "yaw_deg", "others_stay"}
"""Keys of the end of a step, which steps that go on without a stop do not show."""


def wider_tensions(s: Step, keys: Mapping[str, Any]) -> bool:
    """Return whether phases of a step without holds state tensions that it does not request."""
    value = keys.get("tension")
    low, high = (value["min"], value["max"]) if isinstance(value, dict) else (math.inf, -math.inf)
    is_holding = any(x["hold"] for x in s.phases)
    ranges = [x["tension"] for x in s.phases if x["tension"] is not None and not is_holding]
    return any(x[0] < low - TAUT_TOL or x[1] > high + TAUT_TOL for x in ranges)


def differences(s: Step, name: str, keys: Mapping[str, Any]) -> Iterator[tuple[str, float]]:
    """Yield keys of a step with the plan's difference from each; inf without such a value."""
    for key, value in {"blend": False, **keys, **IMPLIED.get(name, {})}.items():
        shows = IMPLICIT.get(key, STEP_KEYS.get(f"{name}.{key}", STEP_KEYS.get(key)))
        not_shown = key in OF_END and keys.get("blend")
        if shows is None or value is None or value == "auto" or not_shown:
            continue
        try:
            off = size_of(shows(s, value, keys))
        except (IndexError, KeyError, StopIteration, TypeError, ValueError):
            off = math.inf
        yield key, off / (max(1.0, abs(value)) if type(value) in (int, float) else 1.0)


def size_of(values: Any) -> float:
    """Return the largest magnitude of numbers."""
    numbers = [*values] if isinstance(values, Iterator) else values
    return float(np.max(np.abs(np.array(numbers, dtype=float)), initial=0.0))
