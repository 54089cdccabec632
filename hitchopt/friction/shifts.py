"""Checks ``friction_shift`` and ``rest_shift``: where other friction than planned leaves vertices.

``team.cable_friction`` is a range. Vertices over-travel to where its largest friction stops them;
with less of it they go farther beyond. ``friction.hysteresis`` follows them, at samples, for
several frictions of the range:

- ``friction_shift`` is how far they leave their ways in a phase in which cables slide. On these
  ways, distances are those of the plan; all points of cables leave those of their plan by no more.
  What stands still allows for over-travels, after which vertices are where they were: their limit
  is the distance that vertices keep from walls and floor, and cables from objects beyond
  ``separation.object``. Other phases have none: in them, friction holds vertices back.
- ``rest_shift`` is how far vertices are from the plan at rests of any duration, of which the end of
  a plan is one. It depends on their turning points alone, not on speeds. ``limits.rest_shift`` and
  ``vertex_error`` limit it.

Both add a quarter of the largest difference to the neighbours among samples and frictions. The
vertex of a parabola through three values is beyond the middle one by an eighth of it at most.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from hitchopt.checks.arena import ARENA
from hitchopt.checks.certificate import SAMPLED, Check
from hitchopt.checks.clearance import OBJECT_CLEARANCE
from hitchopt.checks.distances import Flags
from hitchopt.checks.rule import ReportRule, SpanResults, WorstCase
from hitchopt.checks.spans import phase_parts
from hitchopt.friction.hysteresis import held_vertices
from hitchopt.geometry.vectors import dot, length
from hitchopt.hitch.requirements import Arena, Requirements
from hitchopt.hitch.rest_errors import planned_rest
from hitchopt.hitch.team import Team
from hitchopt.motion.motion import Motion
from hitchopt.motion.states import TAUT_RATIO, states_at
from hitchopt.values import Array, ByValue, true_runs

FRICTIONS = 9  # Number of frictions of the range, from the least to the largest
MIN_SLIDE = 1e-3  # [m] Change of leg lengths below which a phase has no slides

AT_REST = 1e-6
"""Largest speed of vertices where they turn and of drones at rest [m/s], and largest rate of
tensions at rest [N/s]."""

MAX_RETURN = 1e-4  # [m] Largest distance of a vertex after over-travels from its place before
SETTLED = 0.05
"""[m] Largest distance from the plan at which vertices count as settled, unless a problem limits
it. Vertices of simulated triangles rest within 2.4 cm."""

SAMPLE_WAY = 0.1  # [m] Largest way between samples
SAMPLES = 2  # Least number of samples from one rest of vertices to the next
MAX_SAMPLES = 24  # Largest number of samples from one rest of vertices to the next
WAY_SAMPLES = 200  # Number of samples of the ways of a phase

DECIMALS = 9
"""Decimals of planned states [m], [N]: the same motion at another time differs by rounding only."""

MAX_COURSES = 64  # Number of courses whose vertices are stored

TINY = 1e-12  # Smallest divisor


class Held(NamedTuple):
    """Vertices for several frictions, at samples."""

    times: Array  # (S,) [s], since the start of the motion
    planned: Array  # (S, points, 3) [m], the plan
    vertices: Array  # (S, F, points, 3) [m], infinitely far without a balance


@dataclass(frozen=True, eq=False)
class Course(ByValue):
    """Consecutive planned states of a hitch, and the frictions for which vertices are followed."""

    team: Team  # The team
    positions: Array  # (S, 2n, 3) [m], of drones
    vertices: Array  # (S, points, 3) [m]
    tensions: Array  # (S, n) [N]
    cable_forces: Array  # (S, 2n, 3) [N], on drones
    frictions: Array  # (F,) coefficients of friction
    shares: Array  # (F,) shares of it that clasps hold at the first state, as in ``held_vertices``


def held(motion: Motion, t: Array, frictions: Array, shares: Array) -> Held:
    """Return where frictions (F,) hold the vertices of a hitch at consecutive times t (S,) [s].

    At the first time, clasps hold the fractions ``shares`` (F,) of their friction, as in
    ``held_vertices``.
    """
    states = states_at(motion, t)
    planned = (states.positions, states.vertices, states.tensions, states.cable_forces)
    # Equal courses are computed once: as part of a step, a candidate and a whole plan, a motion
    # starts at other times, and its values differ by rounding
    rounded = [np.round(values, DECIMALS) + 0.0 for values in planned]  # no negative zeros
    positions, vertices, tensions, cable_forces = rounded
    course = Course(motion.team, positions, vertices, tensions, cable_forces, frictions, shares)
    return Held(t, states.vertices, _held_on(course))


@lru_cache(maxsize=MAX_COURSES)
def _held_on(course: Course) -> Array:
    """Return ``Held.vertices`` of a course, computed once for steps, candidates and whole plans."""
    rests = planned_rest(
        course.team, course.positions, course.vertices, course.tensions, course.cable_forces
    )
    vertices = held_vertices(course.team, rests, course.frictions, course.shares)
    return np.where(np.isfinite(vertices), vertices, np.inf)


def sample_times(motion: Motion, first: int, last: int, ends: Sequence[float] = ()) -> Array:
    """Return times (S,) [s] since the start of a motion, on the pieces from first to last.

    They include all times at which vertices rest, and more where these move far.
    ``ends`` are further breaks that they include.
    """
    breaks = motion.drones.breaks[first : last + 1]
    speeds = length(motion.vertices.at(breaks, 1))
    rests = breaks[(np.max(speeds, axis=-1, initial=0.0) <= AT_REST) | np.isin(breaks, ends)]
    stops = np.unique(np.concatenate([breaks[:1], rests, breaks[-1:]]))
    times = [stops[:1]]
    for start, end in pairwise(stops.tolist()):
        t = np.linspace(start, end, MAX_SAMPLES + 1)
        points = np.concatenate([motion.drones.at(t), motion.vertices.at(t)], axis=1)
        way = float(np.max(np.sum(length(np.diff(points, axis=0)), axis=0)))
        if way <= AT_REST:
            times.append(t[-1:])
            continue
        count = min(max(SAMPLES, math.ceil(way / SAMPLE_WAY)), MAX_SAMPLES)
        times.append(np.linspace(start, end, count + 1)[1:])
    return np.asarray(np.concatenate(times) - motion.drones.breaks[0])


def frictions_of(motion: Motion) -> Array:
    """Return the frictions (F,) of the range that are followed."""
    return np.linspace(motion.team.least_friction, motion.team.friction, FRICTIONS)


def distances_from_ways(places: Array, ways: Array) -> Array:
    """Return distances (S, points) [m] of places (S, points, 3) from ways (samples, points, 3)."""
    along = np.diff(ways, axis=0)
    offsets = places[:, None] - ways[:-1]
    shares = dot(offsets, along) / np.maximum(dot(along, along), TINY)
    nearest = np.clip(shares, 0.0, 1.0)[..., None] * along
    return np.asarray(np.min(length(offsets - nearest), axis=1))


def with_reserve_between_samples(values: Array, axes: tuple[int, ...]) -> Array:
    """Return values plus a quarter of their largest difference to neighbours along axes.

    The axes are those of samples: of times, and of frictions.
    """
    steps = np.zeros_like(values)
    for axis in axes:
        with np.errstate(invalid="ignore"):  # of two without a balance
            change = np.nan_to_num(np.abs(np.diff(values, axis=axis)), nan=0.0, posinf=np.inf)
        before, after = [(0, 0)] * values.ndim, [(0, 0)] * values.ndim
        before[axis], after[axis] = (1, 0), (0, 1)
        steps = np.maximum(steps, np.maximum(np.pad(change, before), np.pad(change, after)))
    return np.asarray(values + 0.25 * steps)


def _has_friction(motion: Motion) -> bool:
    """Return whether a hitch that holds nothing has friction."""
    if not motion.team.has_cables or motion.team.friction == 0.0:
        return False
    return bool(np.any(_is_free(motion)))


def _is_free(motion: Motion) -> Flags:
    """Return on which pieces (pieces,) there is a taut hitch that holds nothing."""
    least = np.min(motion.tensions.coefficients, axis=-1)
    is_taut = np.all(least >= TAUT_RATIO * motion.team.tension, axis=1)
    return np.asarray(motion.formed & ~motion.holding & is_taut)


def _largest_shift(motion: Motion, _results: SpanResults, _gamma: float) -> WorstCase | None:
    """Return the shift [m] that is largest for its limit; None if no cable slides."""
    if not _has_friction(motion):
        return None
    return max(_shifts(motion), key=_excess, default=None)


def _excess(shift: WorstCase) -> tuple[float, float]:
    """Return by how much a shift exceeds its limit, if it has one, and the shift [m]."""
    limit = math.inf if shift.limit is None else shift.limit
    return shift.worst - limit, shift.worst


def _shifts(motion: Motion) -> Iterator[WorstCase]:
    """Yield the largest shift [m] of every phase in which cables slide, with its limit."""
    frictions = frictions_of(motion)
    for part in phase_parts(motion):
        phase = part.motion
        if not np.all(_is_free(phase)):
            continue
        lengths = phase.legs.coefficients
        if np.max(np.ptp(lengths, axis=(0, -1)), initial=0.0) < MIN_SLIDE:
            continue
        t = sample_times(phase, 0, len(lengths))
        vertices_by_friction = held(phase, t, frictions, np.zeros(len(frictions))).vertices
        ways = states_at(phase, np.linspace(0.0, phase.duration, WAY_SAMPLES)).vertices
        shifts_at_samples = np.stack(
            [distances_from_ways(places, ways) for places in vertices_by_friction.swapaxes(0, 1)],
            axis=1,
        )  # (S, F, points)
        shifts = with_reserve_between_samples(shifts_at_samples, (0, 1))
        sample, _, vertex = np.unravel_index(int(np.argmax(shifts)), shifts.shape)
        time = float(motion.drones.breaks[part.pieces.start] + t[sample])
        where = (motion.team.point_names[vertex],)
        room, binding = _room(phase)
        limit = room if math.isfinite(room) else None
        yield WorstCase(float(np.max(shifts)), time, where, limit=limit, binding=binding)


def _room(motion: Motion) -> tuple[float, str]:
    """Return the largest shift [m] that a phase allows for, and the check that limits it."""
    requirements = motion.requirements
    ends = motion.vertices.coefficients[[0, -1], ..., [0, -1]]
    if np.max(length(ends[1] - ends[0])) > MAX_RETURN:
        return math.inf, ""
    rooms = [(math.inf, "")]
    if requirements.arena is not None:
        rooms.append((_wall_distance(motion, requirements.arena), ARENA.name))
    for result in OBJECT_CLEARANCE.span_results(motion):
        slack = result.check.worst - result.check.number
        rooms.append((max(slack, 0.0), OBJECT_CLEARANCE.name))
    return min(rooms)


def _wall_distance(motion: Motion, arena: Arena) -> float:
    """Return the distance of vertices from the walls [m], for all t.

    Since the walls are convex, cables are within them if their vertices and drones are.
    """
    corners = np.moveaxis(motion.vertices.coefficients, 2, -1)
    return float(min(np.min(corners - arena.lower), np.min(arena.upper - corners)))


def _largest_rest_shift(motion: Motion, _results: SpanResults, _gamma: float) -> WorstCase | None:
    """Return the largest distance from the plan at rest [m]; None without friction."""
    if not _has_friction(motion):
        return None
    return max(_rest_shifts(motion), key=lambda shift: shift.worst, default=None)


def _rest_shifts(motion: Motion) -> Iterator[WorstCase]:
    """Yield the largest distance from the plan [m] at every rest of a hitch that holds nothing.

    The end of the motion is one. Before its first slide, a hitch at the start is as planned. One
    that was tied, or held an object, has any friction.
    """
    frictions = frictions_of(motion)
    breaks = motion.drones.breaks
    at_rest = _rests(motion)
    for first, last in true_runs(_is_free(motion)):
        runs = first + np.array(true_runs(at_rest[first:last]), dtype=np.intp).reshape(-1, 2)
        ends = breaks[runs[:, 1]].tolist()
        if last == motion.drones.pieces:
            ends.append(float(breaks[-1]))
        if not ends:
            continue
        shares = np.array([0.0] if first == 0 else [-1.0, 1.0])
        t = sample_times(motion, first, last, ends)
        found = held(motion, t, np.tile(frictions, len(shares)), np.repeat(shares, len(frictions)))
        offsets = length(found.vertices - found.planned[:, None])
        offsets = offsets.reshape(len(t), len(shares), len(frictions), -1)
        for sample in np.flatnonzero(np.isin(t, np.subtract(ends, breaks[0]))).tolist():
            shifts = with_reserve_between_samples(offsets[sample], (1,))
            vertex = int(np.unravel_index(int(np.argmax(shifts)), shifts.shape)[-1])
            time = float(breaks[0] + t[sample])
            yield WorstCase(float(np.max(shifts)), time, (motion.team.point_names[vertex],))


def _rests(motion: Motion) -> Flags:
    """Return the pieces (pieces,) on which drones and tensions are at rest."""
    durations = motion.drones.durations
    moves = np.max(np.ptp(motion.drones.coefficients, axis=-1), axis=(1, 2))
    changes = np.max(np.ptp(motion.tensions.coefficients, axis=-1), axis=1)
    return np.asarray(np.maximum(moves, changes) <= AT_REST * durations)


def _limit(requirements: Requirements) -> float | None:
    """Return infinity if phases may limit shifts, else None."""
    is_limited = requirements.arena is not None or requirements.objects
    return math.inf if is_limited else None


FRICTION_SHIFT = ReportRule(
    "friction_shift",
    "m",
    "max",
    _largest_shift,
    limit=_limit,
    remedy="state a larger least friction (cable_friction: [least, largest]), or move farther from "
    "objects and walls",
    free_remedy="",
    assumes_gamma=False,
    applies=_has_friction,
    group="distances",
    key="arena",
    method=SAMPLED,
    proves="the largest distance [m] from their ways at which vertices are with any friction of "
    "its range where cables slide, for which objects and walls leave room at over-travels",
    unproven="times and frictions between samples, swings, held objects; distances to drones and "
    "to other teams",
)

REST_SHIFT = ReportRule(
    "rest_shift",
    "m",
    "max",
    _largest_rest_shift,
    limit=lambda requirements: requirements.limits.held_at_rest,
    remedy="let vertices over-travel (settle: auto), give them room, or use smoother cables "
    "(cable_friction)",
    free_remedy="",
    assumes_gamma=False,
    of_whole=True,
    applies=_has_friction,
    group="distances",
    key="limits.rest_shift",
    method=SAMPLED,
    proves="the largest distance [m] from the plan at which any friction of its range holds a "
    "vertex while the plan rests, for any course of time",
    unproven="frictions between samples, swings, objects",
)

PART_REPORTS = (FRICTION_SHIFT,)
"""Reports of each team whose values of a joined motion follow from those of its parts."""

TEAM_REPORTS = (REST_SHIFT,)  # Other reports of each team


def rest_notes(checks: Iterable[Check]) -> Iterator[str]:
    """Yield a note if friction may hold a vertex farther off at rest than SETTLED."""
    for check in checks:
        if check.name == REST_SHIFT.name and check.limit is None and check.worst > SETTLED:
            yield (
                f"friction may hold {', '.join(check.where)} {100.0 * check.worst:.2g} cm off "
                f"the plan, at rest at t = {check.time:.4g} s: settle, give vertices room to "
                "over-travel, or use smoother cables; limits.rest_shift refuses it"
            )
