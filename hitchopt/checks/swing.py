"""Estimate ``swing``: the largest distance of a vertex from the plan by the inertia of cables.

Planned forces balance as they do at rest. Cables and loads at clasps have inertia, so vertices lag
behind while they move, and swing afterwards. The estimate is the linear response about planned
rests of ``hitchopt.hitch.swing``, of a hitch that is at rest when its cables become taut, while
they are taut, and for some time after the end of the motion.

The weight and the inertia of bodies that rest on clasps are part of the plan. Their masses make
the hitch swing more slowly: each clasp has its share, as if it were a load. Cables that grip a body
press on it, which holds them: grips are not estimated.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from hitchopt.checks.certificate import SAMPLED
from hitchopt.checks.rule import ReportRule, SpanResults, WorstCase
from hitchopt.geometry.vectors import length
from hitchopt.hitch.rest_errors import planned_rest
from hitchopt.hitch.swing import LinearHitch
from hitchopt.motion.loads import stated_tensions, supports_of
from hitchopt.motion.motion import HoldBy, Motion
from hitchopt.motion.states import TAUT_RATIO, states_at
from hitchopt.values import Array, Indices, true_runs

STEP = 0.02  # [s] Largest time between samples
LONGEST_REST = 30.0  # [s] Time of a rest after which nothing swings
LONGEST_PIECE = 60.0  # [s] Duration of a piece beyond which it moves too slowly to swing
MAX_SAMPLES = 100_000  # Largest number of samples: those of 2,000 s
AT_REST = 1e-6  # [m/s²] Largest acceleration of a plan at rest
AFTER = 3.0  # [s] Time for which vertices swing after the end of a motion
LEFT_SHARE = 0.5  # Largest share of the limit that planners leave while a motion rests
LEFT_MARGIN = 0.05  # Largest margin of this share within which it limits a plan's speed
MAX_CHANGE = 0.04
"""[m] Largest move of a node within its hitch, which is linear about one rest before another."""


@dataclass(frozen=True, eq=False)
class SwingingHitch:
    """A hitch that swings about its plan while its cables are taut."""

    hitch: LinearHitch
    samples: Indices  # (J,), number of samples about each of its rests
    accelerations: Array  # (S, nodes, 3) [m/s²], those of planned nodes
    times: Array  # (S,) [s], of the samples
    step: float  # [s] Time between samples

    @classmethod
    def of(cls, motion: Motion) -> SwingingHitch:
        """Return the hitch of a motion whose cables are taut throughout."""
        team = motion.team
        times, step = _sample_times(motion)
        firsts = _rests(_nodes(motion, times))
        rests = states_at(motion, times[firsts] - motion.drones.breaks[0])
        planned = planned_rest(
            team, rests.positions, rests.vertices, rests.tensions, rests.cable_forces
        )
        hitch = LinearHitch.of(team, planned, _held_masses(motion, times[firsts]))
        after = math.ceil(AFTER / STEP)
        accelerations = np.zeros((len(times) + after, *hitch.inertia.shape[1:2], 3))
        accelerations[: len(times)] = _nodes(motion, times, 2)
        samples = np.diff(firsts, append=len(accelerations))
        later = times[-1] + step * np.arange(1, after + 1)
        return cls(hitch, samples, accelerations, np.append(times, later), step)

    @property
    def moving(self) -> int:
        """Number of samples before the end of the motion."""
        return len(self.accelerations) - math.ceil(AFTER / STEP)

    def distances(self, slowing: float = 1.0) -> Array:
        """Return distances (S, points) [m] of points from the plan; times may be ``slowing``."""
        with np.errstate(all="ignore"):  # of numbers beyond all limits
            accelerations = self.accelerations / slowing**2
            offsets = self.hitch.response(self.samples, accelerations, slowing * self.step)
        return length(offsets[:, self.hitch.points])


def _sample_times(motion: Motion) -> tuple[Array, float]:
    """Return times (S,) [s] of samples of a motion, and the time [s] between them.

    They leave out what follows LONGEST_REST of a rest and LONGEST_PIECE of a piece that moves, too
    slowly to swing; a very long motion has MAX_SAMPLES.
    """
    breaks, durations = motion.drones.breaks, motion.drones.durations
    moves = np.zeros(len(durations), dtype=np.bool_)
    for curve in (motion.drones, motion.vertices):
        moves |= np.any(np.ptp(curve.coefficients, axis=-1) > 0.0, axis=(1, 2))
    kept = np.minimum(durations, np.where(moves, LONGEST_PIECE, LONGEST_REST))
    ends = np.append(0.0, np.cumsum(kept))
    steps = min(math.ceil(ends[-1] / STEP), MAX_SAMPLES)
    along = np.linspace(0.0, ends[-1], steps + 1)
    piece = np.clip(np.searchsorted(ends, along, "right") - 1, 0, len(kept) - 1)
    return np.asarray(breaks[piece] + (along - ends[piece])), float(ends[-1]) / steps


def _nodes(motion: Motion, times: Array, derivative: int = 0) -> Array:
    """Return planned nodes (S, nodes, 3) [m] or time derivatives: drones, then clasps."""
    clasps = motion.vertices.at(times, derivative)[:, motion.team.layout.clasps]
    return np.concatenate([motion.drones.at(times, derivative), clasps], axis=1)


def _rests(nodes: Array) -> Indices:
    """Return the first samples (J,) of rests about which a hitch is linear.

    A rest serves until the shape of its nodes (S, nodes, 3) [m] has changed by MAX_CHANGE; they may
    be displaced together.
    """
    shapes = nodes - np.mean(nodes, axis=1, keepdims=True)
    firsts = [0]
    while True:
        changes = np.max(length(shapes[firsts[-1] :] - shapes[firsts[-1]]), axis=1)
        has_changed = changes > MAX_CHANGE
        if not np.any(has_changed):
            return np.array(firsts)
        firsts.append(firsts[-1] + int(np.argmax(has_changed)))


def _held_masses(motion: Motion, times: Array) -> Array:
    """Return the masses (J, clasps) [kg] of bodies that clasps carry at times (J,) [s]."""
    held = np.zeros((len(times), len(motion.team.layout.clasps)))
    pieces = np.searchsorted(motion.drones.breaks[1:-1], times, "right")
    shares = motion.load_share.at(times)
    for index, body in enumerate(motion.requirements.objects.values()):
        if np.any(shares[:, index]):
            supports = supports_of(motion, index, body).shares[pieces]
            held += body.mass * shares[:, index, None] * supports
    return held


def has_inertia(motion: Motion) -> bool:
    """Return whether cables, loads or held bodies have masses for which a plan does not allow."""
    team = motion.team
    if not team.has_cables:
        return False
    return bool(team.cable_density > 0.0 or np.any(team.load > 0.0))


def swinging_hitches(motion: Motion) -> list[SwingingHitch]:
    """Return the hitch of each part of a motion in which cables are taut and grip nothing.

    There is none without inertia.
    """
    if not has_inertia(motion):
        return []
    lowest = stated_tensions(motion)[..., 0]
    tensions = np.min(motion.tensions.coefficients, axis=-1)
    grips = motion.in_phases(lambda phase: phase.hold is not None and phase.hold.by is HoldBy.GRIP)
    taut = motion.formed & ~grips & np.all(tensions >= TAUT_RATIO * lowest, axis=1)
    return [SwingingHitch.of(motion.on_pieces(*run)) for run in true_runs(taut)]


class Swing(NamedTuple):
    """The distances of vertices from the plan in a part of a motion."""

    times: Array  # (S,) [s]
    distances: Array  # (S, points) [m]
    moves: NDArray[np.bool_]  # (S,), whether the plan accelerates

    @classmethod
    def of(cls, hitch: SwingingHitch) -> Swing:
        """Return the distances of a hitch's vertices."""
        moves = np.max(np.abs(hitch.accelerations), axis=(1, 2)) > AT_REST
        return cls(hitch.times, hitch.distances(), moves)


_SWINGS: WeakKeyDictionary[Motion, list[Swing]] = WeakKeyDictionary()
"""Swings that this process has computed."""


def swings_of(motion: Motion) -> list[Swing]:
    """Return the swings of a motion, in order of time; computed only once."""
    if motion not in _SWINGS:
        _SWINGS[motion] = list(map(Swing.of, swinging_hitches(motion)))
    return _SWINGS[motion]


def swings_at_rests(motion: Motion, times: Array) -> Array:
    """Return how far points (J, points) [m] swing while a motion rests from times (J,) [s] on."""
    left = np.zeros((len(times), motion.team.layout.points))
    for swing in swings_of(motion):
        for rest, time in enumerate(times.tolist()):
            first = int(np.searchsorted(swing.times, time))
            moves = np.append(swing.moves[first:], True)
            at_rest = swing.distances[first : first + max(int(np.argmax(moves)), 1)]
            left[rest] = np.maximum(left[rest], np.max(at_rest, axis=0, initial=0.0))
    return left


def worst_swing(motion: Motion) -> WorstCase | None:
    """Return the largest distance [m]; None without inertia, or if cables are never taut."""
    swings = swings_of(motion)
    if not swings:
        return None
    largest = max(swings, key=lambda swing: float(np.max(swing.distances)))
    sample, vertex = np.unravel_index(int(np.argmax(largest.distances)), largest.distances.shape)
    where = (motion.team.point_names[vertex],)
    return WorstCase(float(np.max(largest.distances)), float(largest.times[sample]), where)


def _largest_swing(motion: Motion, _results: SpanResults, _gamma: float) -> WorstCase | None:
    """Return ``worst_swing``, which also limits a plan's speed by what it leaves at rests."""
    worst = worst_swing(motion)
    limit = motion.requirements.limits.swing
    if worst is None or limit is None:
        return worst
    at_rest = (swing.distances[~swing.moves] for swing in swings_of(motion))
    left = max(float(np.max(distances, initial=0.0)) for distances in at_rest)
    if left < (1.0 - LEFT_MARGIN) * LEFT_SHARE * limit:
        return worst
    return replace(worst, binds_within=1.0 - (1.0 - LEFT_MARGIN) * LEFT_SHARE)


SWING = ReportRule(
    "swing",
    "m",
    "max",
    _largest_swing,
    limit=lambda requirements: requirements.limits.swing,
    remedy="move more slowly, pull harder (team.tension), or use lighter cables and loads",
    free_remedy="",
    assumes_gamma=False,
    has_default=True,
    applies=has_inertia,
    group="distances",
    derivative=2,
    key="limits.swing",
    method=SAMPLED,
    proves="an estimate of the largest distance [m] of a vertex from the plan by the inertia of "
    "cables and loads, while cables are taut and after the end",
    unproven="grips; it is the response of a linear model at samples, without friction",
)
