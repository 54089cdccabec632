"""Robots that join a hitch in flight, or leave it, while all others remain tied.

Joining opens a vertex, so that both of its cables are straight. The new robot descends with a taut
cable onto both, or ascends from below. Its cable cuts off the corner: it crosses the others at two
new vertices with rolls of ±180°. Drones then move by centimetres to the balance with the weights of
the new vertices. Finally both pairs of the robot roll, first the one whose neighbouring leg is, at
the corner, on the side to which it rolls: up if the robot is on top, else down. Leaving is the
reverse.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import product, starmap
from typing import Any

import numpy as np

from hitchopt.checks.cables import LENGTH_LIMIT
from hitchopt.checks.clasps import OPEN_ROLL
from hitchopt.checks.linking import MAX_LAID_GAP, MAX_LEG_CHANGE
from hitchopt.errors import InfeasibleError, InputError, Violation
from hitchopt.geometry import ConvexPolygon, Outline, shortest_offset
from hitchopt.geometry.vectors import unit
from hitchopt.hitch import GRAVITY, Hitch, Team
from hitchopt.hitch.catenary import Catenary
from hitchopt.hitch.forces import sag_factors
from hitchopt.hitch.hitch import cable_slack
from hitchopt.hitch.requirements import Arena, Prism, Requirements
from hitchopt.hitch.slack_split import SPREAD_MARGIN, LegTask
from hitchopt.hitch.team import PartTeam
from hitchopt.motion.chapters import WaitingRobot, with_waiting
from hitchopt.motion.motion import CableState, Motion, Phase
from hitchopt.motion.retiming import append_motion, padded, resting
from hitchopt.planners.forming.approach import DirectApproach, separated
from hitchopt.planners.forming.laying import (
    SHARES,
    TENSION_SECONDS,
    RollPath,
    planned_distance,
    roll_motion,
)
from hitchopt.planners.forming.prehitch import MAX_SPAN_RATIO, MIN_SEPARATION, smallest_separation
from hitchopt.planners.forming.stages import (
    MIN_FLIGHT,
    PAUSE,
    Keyframe,
    best,
    hover_altitude,
    stage,
    straight_lines,
    straight_stages,
)
from hitchopt.planners.morph.path import shapes_along
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array

LAYING_GAP = 0.005  # [m] Height of the new robot's cable over the others at the end of its descent

SPLITS = (0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8)
"""Candidate slack splits if no split of the robot's legs alone suffices."""

CLEAR_ROLL_SHARE = 0.35
"""Share of its roll from which on the first leg must be clear of the neighbouring leg."""

ROLL_SAMPLES, SUFFICIENT_MARGIN = 13, 1.05
"""Number of sampled rolls, and margin at which the search ends."""

SPACE_SIZE, LEVEL_TOLERANCE = 100.0, 0.02
"""[m] Half the size of space around the goals without an arena, and vertical tolerance of an
approaching robot toward the ring."""

WAITING_DISTANCE, WAITING_STEP, MAX_WAITING_STEPS = 0.5, 0.1, 40
"""[m] Horizontal distance of a waiting robot to all others, step of the search for its position,
and number of steps."""

MIN_DIVISOR = 1e-9
"""Lower bound of divisors of limits, in their own units, and of lengths [m] of directions."""

APPROACH_SPAN_RATIO = 0.95
"""Distance of an approaching robot's drones over its cable's length, so that it hangs flat."""

NEWTON_ITERATIONS = 8  # Iterations for the chord of a taut cable, which converge quadratically


def corner_cut(polygon: Any, vertex: int, cut: float) -> ConvexPolygon:
    """Return the outline with a vertex cut off at a distance [m] along both of its edges.

    The new edge has the index of the vertex. Vertex n is vertex 0, with the new edge last.

    Raises
    ------
    InputError: a distance beyond the shorter one of these edges.
    """
    points, lengths = polygon.vertices, polygon.edge_lengths
    index, vertex = vertex, vertex % len(points)
    longest = float(min(lengths[vertex - 1], lengths[vertex]))
    if not cut < longest:
        bound = f"less than {longest:.4g} m, the shorter edge at vertex {vertex}"
        raise InputError("cut", cut, bound, "cut off less")
    along, corner = polygon.edge_directions, points[vertex]
    new = corner - cut * along[vertex - 1], corner + cut * along[vertex]
    outline = np.concatenate([points[:vertex], new, points[vertex + 1 :]])
    return ConvexPolygon(np.roll(outline, -int(index > vertex), axis=0))


def corner_restored(polygon: Any, edge: int, robot: int) -> tuple[ConvexPolygon, Array]:
    """Return the outline whose neighbours of an edge meet, and their extensions (2,) [m].

    Raises
    ------
    InputError: neighbours that do not meet beyond the edge; it names the edge's ``robot``.
    """
    points, n = polygon.vertices, len(polygon.vertices)
    u = polygon.edge_directions
    behind, ahead = u[edge - 1], u[(edge + 1) % n]
    a, b = points[edge], points[(edge + 1) % n]
    turn = behind[0] * ahead[1] - behind[1] * ahead[0]  # negative where the outline turns right
    x, y = b - a
    extensions = np.array(
        [
            (x * ahead[1] - y * ahead[0]) / turn if turn else np.inf,
            (behind[0] * y - behind[1] * x) / turn if turn else np.inf,
        ]
    )
    converge = turn < -1e-6 and np.all(extensions > 0.0) and np.all(np.isfinite(extensions))
    if n <= 3 or not converge:
        bound = "one beyond whose edge the lines of its neighbours meet"
        raise InputError("robot", robot, bound, "morph before, so that their edges converge")
    corner = a + extensions[0] * behind
    remaining = np.delete(points, [edge, (edge + 1) % n], axis=0)
    return ConvexPolygon(np.insert(remaining, edge % (n - 1), corner, axis=0)), extensions


@dataclass(frozen=True, eq=False)
class RingChange:
    """A ring without a robot and with it."""

    before: Hitch  # the ring without the robot
    after: Hitch  # the ring with it
    # index of the robot in the ring after; its edge cuts off the corner of the one before
    vertex: int
    senses: Array  # (n,) of the clasps before, 1 if the cable ahead is on top, else -1
    side: float  # 1 if the robot is on top of both neighbours, -1 if it is below both

    @property
    def robot(self) -> int:
        """Number of the robot."""
        return self.after.team.labels[self.vertex]

    @property
    def corner(self) -> int:
        """Vertex of the ring before that the robot's edge cuts off."""
        return self.vertex % self.before.team.robots

    @property
    def ends(self) -> list[int]:
        """Both vertices of the robot's edge."""
        return [self.vertex, (self.vertex + 1) % self.after.team.robots]

    @property
    def senses_after(self) -> Array:
        """(n + 1,): senses of the clasps after."""
        senses = np.insert(self.senses, self.vertex, 0.0)
        senses[self.ends] = [self.side, -self.side]
        return senses

    @cached_property
    def opening(self) -> RollPath:
        """The roll that opens the vertex."""
        end = self.before.roll.copy()
        end[self.corner] = -np.pi * self.senses[self.corner]
        return RollPath(self.before, self.before.roll, end)

    @cached_property
    def rolls(self) -> tuple[RollPath, RollPath]:
        """The rolls of the robot's two pairs, in the order in which their legs are free to roll."""
        start = self.after.roll.copy()
        start[self.ends] = [-np.pi * self.side, np.pi * self.side]
        first = self.ends[int(self.side * self.senses[self.corner] > 0.0)]
        middle = start.copy()
        middle[first] = self.after.roll[first]
        return RollPath(self.after, start, middle), RollPath(self.after, middle, self.after.roll)

    def margin(self, requirements: Requirements, cutoff: float = -np.inf) -> float:
        """Return the smallest margin of distances and legs over sampled rolls.

        Early in the first roll the crossing legs at the corner may touch. The search ends with an
        upper bound once that is at most the ``cutoff``.
        """
        separation, margin = replace(requirements.separation, crossing=0.0), np.inf
        touching, (first, second) = replace(requirements, separation=separation), self.rolls
        for path, start, end, enforced in (
            (self.opening, 0.0, 1.0, requirements),
            (second, 0.0, 1.0, requirements),
            (first, CLEAR_ROLL_SHARE, 1.0, requirements),
            (first, 0.0, CLEAR_ROLL_SHARE, touching),
        ):
            if margin <= cutoff:
                return margin
            shapes = shapes_along(path, np.linspace(start, end, ROLL_SAMPLES))
            margin = min(margin, float(np.min(shapes.legs)) / requirements.limits.leg)
            if margin >= 1.0:
                q_legs, leg = shapes.legs[..., 0], requirements.limits.leg
                arguments = path.team, enforced, shapes.polygons, q_legs, leg, SPREAD_MARGIN
                margin = min(margin, LegTask(*arguments, roll=shapes.roll).reference_margin())
        if margin >= 1.0:
            laid = self.drones_laid
            separated = smallest_separation(laid[None], requirements.separation)
            margin = min(margin, separated, self._sag_margin(laid))
        return margin

    def _sag_margin(self, laid: Array) -> float:
        """Return the smallest limit over a quantity due to sag, drones (2n, 3) [m] as cables lie.

        Cut edges sag, so that the robot's cable lies lower than its vertices and legs slope, the
        more the shorter they are. Limits apply to the roll of both pairs, which count as open only
        near 180°, to changes of vertical forces (a cable's weight), of cable lengths (its sag) and
        of legs (MAX_LEG_CHANGE), and to the height of the crossing legs at the corner.
        """
        hitch, team, n, k = self.after, self.after.team, self.after.team.robots, self.vertex
        legs, c = laid - hitch.vertices[team.layout.anchors], np.array(self.ends)
        along, lengths = unit(legs), np.linalg.norm(legs, axis=1).reshape(n, 2)
        u = np.column_stack([hitch.polygon.edge_directions, np.zeros(n)])
        q, axis = along[2 * c], unit(along[2 * c] + along[2 * c - 1])
        upward = np.cross(u[c] + u[c - 1], axis)
        rise, run = np.sum(q * upward, axis=1), np.sum(q * np.cross(axis, upward), axis=1)
        roll_error = np.degrees(np.abs(np.arctan2(rise, -run)))
        balanced = self.rolls[0].drones(np.zeros(1))[0]
        curvature = np.sum((balanced - laid) ** 2, axis=1).reshape(n, 2) / (8.0 * lengths)
        parts = np.column_stack([hitch.polygon.edge_lengths, lengths])
        sags = sag_factors(team, team.tension)
        total = np.sum(parts + sags[:, None] * parts**3, axis=1)
        length_error = total / team.cable_length - 1.0
        midway = 0.5 * length_error - np.sum(curvature, axis=1) / team.cable_length
        length_error = np.maximum(np.abs(length_error), np.abs(midway))
        own, tension = slice(2 * k, 2 * k + 2), team.tension[k]
        line_weight = GRAVITY * team.cable_density
        chord, weight = laid[2 * k + 1] - laid[2 * k], line_weight * team.cable_length[k]
        slope = chord[2] / np.linalg.norm(chord) * np.array([-1.0, 1.0])
        before, after = 0.5 * weight + tension * slope, 0.5 * line_weight * lengths[k]
        jump = np.abs(before - after - tension * along[own, 2])
        depths = [self._crossing_depth(drones) for drones in (laid, balanced)]
        ratios = (
            MAX_LAID_GAP / np.maximum(depths, MIN_DIVISOR),
            MAX_LEG_CHANGE / np.maximum(np.abs(lengths - hitch.legs).ravel(), MIN_DIVISOR),
            (180.0 - OPEN_ROLL) / np.maximum(roll_error, MIN_DIVISOR),
            weight / np.maximum(jump, MIN_DIVISOR),
            (LENGTH_LIMIT + sags * team.cable_length**2) / np.maximum(length_error, MIN_DIVISOR),
        )
        return float(np.min(np.concatenate(ratios))) if weight else np.inf

    def _crossing_depth(self, drones: Array) -> float:
        """Return the depth [m] of the upper leg at the corner below the other one, if straight."""
        points, corner, heights = self.after.vertices, self.before.vertices[self.corner], []
        for end, drone in zip(self.ends, (2 * self.vertex - 1, 2 * self.ends[1]), strict=True):
            leg = drones[drone] - points[end]
            share = np.linalg.norm((corner - points[end])[:2]) / np.linalg.norm(leg[:2])
            heights.append(points[end, 2] + share * leg[2])
        return float(self.senses[self.corner] * (heights[0] - heights[1]))

    def checked(self) -> RingChange:
        """Return the joining, or raise InfeasibleError if cut edges sag too much."""
        ratio = self._sag_margin(self.drones_laid)
        if ratio < 1.0:
            when = "(limits over the slope of its legs on cables that sag)"
            remedy = "raise team.tension, cut off less, or use lighter cables"
            where = (f"cable {self.robot}",)
            violation = Violation("tension", ratio, 1.0, "min", "", where, when, remedy)
            raise InfeasibleError([violation])
        return self

    @property
    def drones_laid(self) -> Array:
        """(2n, 3) [m]: the drones when the robot's cable lies on both others."""
        return self.with_robot(self.opening.drones(np.ones(1))[0])

    def with_robot(self, drones: Array) -> Array:
        """Return the drones (2n, 3) [m] of the open ring and the robot whose cable lies on it."""
        k = 2 * self.vertex
        return np.concatenate([drones[:k], self.robot_laid, drones[k:]])

    @property
    def robot_team(self) -> Team:
        """The team of the robot alone."""
        return PartTeam.of(self.after.team, [self.vertex])

    @cached_property
    def robot_laid(self) -> Array:
        """(2, 3) [m]: the robot's drones when its taut cable lies on both others."""
        k, hitch = self.vertex, self.after
        team, length = self.robot_team, float(hitch.team.cable_length[k])
        factor, share = float(sag_factors(team, team.tension)[0]) * length**2, 1.0
        for _ in range(NEWTON_ITERATIONS):
            share -= (share + factor * share**3 - 1.0) / (1.0 + 3.0 * factor * share**2)
        points = hitch.vertices[self.ends]
        along, cut = unit(points[1] - points[0]), float(np.linalg.norm(points[1] - points[0]))
        q_leg = (share * length - cut) * float(hitch.fractions[k])
        q = points[0] - q_leg * along
        drones = np.stack([q, q + share * length * along])
        cable = Catenary.between(drones[:1], drones[1:], team.cable_length)
        at = np.linalg.norm(points - q, axis=1) / (share * length)
        depth = np.array([float(cable.depth(2.0 * x - 1.0)[0]) for x in at])
        height = depth - self._sags + self.side * LAYING_GAP
        rise = np.linalg.solve(np.stack([1.0 - at, at], axis=1), height)
        drones[:, 2] += rise
        shortening = 1.0 - np.sqrt(1.0 - ((rise[1] - rise[0]) / (share * length)) ** 2)
        drones[1] -= shortening * share * length * along
        return drones

    @property
    def _sags(self) -> Array:
        """(2,) [m]: sag of the ring's cut edges at the new vertices."""
        team, own, k = self.before.team, self.before, self.corner
        lengths, cables = own.polygon.edge_lengths[[k - 1, k]], np.array([k - 1, k])
        cut = np.linalg.norm(self.after.vertices[self.ends] - own.vertices[k], axis=1)
        weight = GRAVITY * team.cable_density / (2.0 * team.tension[cables])
        sags: Array = weight * cut * (lengths - cut)
        return sags

    def clear_altitude(self, requirements: Requirements) -> float:
        """Return an altitude [m] at which the robot is clear of all others, above or below them.

        Above them the cable may hang as deep as half of its length.
        """
        separation = requirements.separation
        distance = planned_distance(separation)
        heights = self.opening.drones(np.ones(1))[..., 2]
        if self.side > 0.0:
            depth = 0.5 * float(self.after.team.cable_length[self.vertex]) + distance
            return float(np.max(heights)) + max(depth, 2.0 * MIN_SEPARATION * separation.height)
        team = self.before.team
        sags = sag_factors(team, team.tension) * 3.0 * self.before.polygon.edge_lengths**2
        lowest = min(float(np.min(heights)), self.before.altitude - float(np.max(np.sqrt(sags))))
        return lowest - max(distance, 2.0 * MIN_SEPARATION * separation.height)

    def robot_clear(self, requirements: Requirements) -> tuple[Array, Array]:
        """Return the robot's drones (2, 3) [m] at ``clear_altitude``, cable hanging and taut."""
        taut = self.robot_laid.copy()
        nearest = np.min if self.side > 0.0 else np.max
        taut[:, 2] += self.clear_altitude(requirements) - nearest(taut[:, 2])
        middle, length = np.mean(taut, axis=0), float(self.after.team.cable_length[self.vertex])
        share = MAX_SPAN_RATIO * length / float(np.linalg.norm(taut[1] - taut[0]))
        return middle + share * (taut - middle), taut


def find_joining(
    before: Hitch,
    team: Team,
    vertex: int,
    outline: ConvexPolygon,
    senses: Array,
    side: float,
    requirements: Requirements,
) -> RingChange:
    """Return a robot's joining with a slack split that keeps all distances.

    ``team`` is the ring with the robot, ``outline`` its polygon. If no split of the robot's own
    slack suffices, the search includes its neighbours', which change before it arrives.
    """
    k, n, corner = vertex, team.robots, vertex % before.team.robots
    new, old = outline.vertices[[k, (k + 1) % n]], before.polygon.vertices[corner]
    cut = np.linalg.norm(new - old, axis=1)
    slack = Hitch.balanced(team, outline, before.altitude).slack
    neighbours = [(k - 1) % before.team.robots, corner]
    fractions = before.fractions[neighbours]

    splits = _splits(fractions, [(share,) for share in SHARES])
    q_legs = splits[:, 1:] * before.slack[neighbours]
    starts = np.tile(before.q_legs, (len(splits), 1))
    unchanged = splits[:, 1:] == fractions
    starts[:, neighbours] = np.where(unchanged, before.q_legs[neighbours], q_legs)
    ends = np.insert(starts, k, splits[:, 0] * slack[k], axis=1)
    ends[:, (k + 1) % n] += cut[1]
    roll = np.insert(before.roll, k, 0.0)

    def candidate(i: int) -> RingChange:
        """Return the joining with the i-th split."""
        start = Hitch(before.team, before.polygon, before.altitude, starts[i], before.roll)
        after = Hitch(team, outline, before.altitude, ends[i], roll)
        return RingChange(start, after, vertex, senses, side)

    margins = _rest_margins(team, outline, ends, roll, requirements)
    margins = np.minimum(margins, _sliding_margins(before, starts, requirements))
    return _best_joining(candidate, margins, requirements).checked()


def _splits(fractions: Array, first: Sequence[tuple[float, ...]]) -> Array:
    """Return slack splits (J, 3) of a robot and its neighbours, ordered by the neighbours' change.

    ``fractions`` (2,) are the neighbours' splits, with which the robot has those of ``first``.
    """
    grid = np.array(list(product(SPLITS, SPLITS)))
    nearest = grid[np.argsort(np.sum((grid - fractions) ** 2, axis=1), kind="stable")]
    unchanged = [(*share, *fractions) for share in first]
    return np.array([*unchanged, *((share, *split) for split in nearest for share in SPLITS)])


def _rest_margins(
    team: Team, outline: Outline, q_legs: Array, roll: Array, requirements: Requirements
) -> Array:
    """Return the margins (J,) of distances and legs at rest, for q-legs (J, n) [m]."""
    leg, slack = requirements.limits.leg, cable_slack(team, outline)
    polygons = np.broadcast_to(outline.vertices, (len(q_legs), *outline.vertices.shape))
    rolls = np.broadcast_to(roll, q_legs.shape)
    task = LegTask(team, requirements, polygons, q_legs, leg, SPREAD_MARGIN, roll=rolls)
    shortest = np.min(np.minimum(q_legs, slack - q_legs), axis=1)
    margins: Array = np.minimum(task.reference_margins(), shortest / leg)
    return margins


def _sliding_margins(hitch: Hitch, q_legs: Array, requirements: Requirements) -> Array:
    """Return the smallest margins (J,) while cables slide linearly to q-legs (J, n) [m]."""
    shares = np.linspace(0.0, 1.0, ROLL_SAMPLES)[:, None, None]
    between = hitch.q_legs + shares * (q_legs - hitch.q_legs)
    rows = between.reshape(-1, hitch.team.robots)
    margins = _rest_margins(hitch.team, hitch.polygon, rows, hitch.roll, requirements)
    smallest: Array = np.min(margins.reshape(ROLL_SAMPLES, -1), axis=0)
    return smallest


def _best_joining(
    candidate: Callable[[int], RingChange], rest_margins: Array, requirements: Requirements
) -> RingChange:
    """Return the first joining with a sufficient margin, else the one with the largest.

    Candidates are those that keep all limits at rest, where they have ``rest_margins`` (J,); if
    there are none, those with the largest margin there.
    """

    def joinings() -> Iterator[tuple[float, RingChange]]:
        largest = -np.inf
        for i in np.flatnonzero(rest_margins >= min(1.0, np.max(rest_margins))).tolist():
            if rest_margins[i] > largest:
                joining = candidate(i)
                margin = joining.margin(requirements, largest)
                largest = max(largest, margin)
                yield margin, joining

    return best(joinings(), SUFFICIENT_MARGIN)


def find_leaving(
    after: Hitch,
    team: Team,
    vertex: int,
    outline: ConvexPolygon,
    extensions: Array,
    senses: Array,
    requirements: Requirements,
    *,
    slides: bool = True,
) -> RingChange:
    """Return a robot's leaving, as the reversed joining, with a slack split as in ``find_joining``.

    ``after`` and ``senses`` (n,) are of the ring with the robot, ``team`` and ``outline`` of the
    one without it; ``extensions`` (2,) [m] are of its neighbours' edges. With ``slides`` margins
    also hold while cables slide to the split. Raises InfeasibleError if legs of its neighbours are
    too short for the corner.
    """
    k, n = vertex, after.team.robots
    own = [k, (k - 1) % n, (k + 1) % n]
    fractions, slack = after.fractions[own], after.slack

    splits = _splits(fractions[1:], [(fractions[0],)])
    ends = np.tile(after.q_legs, (len(splits), 1))
    ends[:, own] = np.where(splits == fractions, after.q_legs[own], splits * slack[own])
    starts = ends.copy()
    starts[:, own[2]] -= extensions[1]
    shortest = np.minimum(starts[:, own[2]], slack[k - 1] - ends[:, k - 1] - extensions[0])
    rest = after.team, after.polygon, ends, after.roll, requirements
    margins = _sliding_margins(after, ends, requirements) if slides else _rest_margins(*rest)
    if np.max(shortest) < (limit := requirements.limits.leg):
        names = tuple(f"cable {team.labels[j]}" for j in (k - 1, k % team.robots))
        when = "where the lines of its neighbours meet"
        longest, remedy = float(np.max(shortest)), "give them longer cables, or morph before"
        raise InfeasibleError([Violation("legs", longest, limit, "min", "m", names, when, remedy)])
    margins = np.where(shortest < limit, -np.inf, margins)
    starts = np.delete(starts, k, axis=1)

    def candidate(i: int, corner: float) -> RingChange:
        """Return the leaving with the i-th split and a sense of the restored corner."""
        senses_before = np.delete(senses, k)
        senses_before[k % team.robots] = corner
        end = Hitch(after.team, after.polygon, after.altitude, ends[i], after.roll)
        start = Hitch(team, outline, after.altitude, starts[i], np.delete(after.roll, k))
        return RingChange(start, end, k, senses_before, float(senses[k]))

    def priority(joining: RingChange) -> tuple[float, bool]:
        """Return the margin up to the sufficient one, and whether legs are unchanged."""
        unchanged = np.array_equal(joining.after.q_legs, after.q_legs)
        return min(joining.margin(requirements), SUFFICIENT_MARGIN), unchanged

    both = [_best_joining(partial(candidate, corner=x), margins, requirements) for x in (1.0, -1.0)]
    return max(both, key=priority).checked()


def waiting_robot(team: Team, drones: Array, requirements: Requirements) -> WaitingRobot:
    """Return a robot that waits with its drones (2, 3) [m] at rest, its cable hanging or lying."""
    hangs = float(np.min(drones[:, 2])) >= hover_altitude(team, drones, requirements) - MIN_FLIGHT
    return WaitingRobot(drones, CableState.FREE if hangs else CableState.GROUND)


def landing_motion(
    motion: Motion, whole: Team, waiting: Mapping[int, Array], requirements: Requirements
) -> Motion:
    """Return the motion of a ring that lands together with the waiting robots, straight down."""
    flights = dict[int, Motion]()
    for robot, drones in waiting.items():
        team, down = PartTeam.of(whole, [robot]), drones.copy()
        down[:, 2] = requirements.floor
        lines = straight_lines(team, requirements.limits, drones, down)
        flights[robot] = stage("land", lines, team, requirements, 0, CableState.GROUND)
    longest = max(each.duration for each in (motion, *flights.values()))
    robots = {
        robot: WaitingRobot(
            padded(each, 0.0, longest).drones,
            each.phases[0].state if each.duration > PAUSE else CableState.GROUND,
        )
        for robot, each in flights.items()
    }
    (phase,) = motion.phases
    ring = padded(motion, 0.0, longest).replaced(phases=(phase.retimed(0.0, longest),))
    return with_waiting(ring, whole, robots, requirements)


@dataclass(frozen=True, eq=False)
class RingChangeMotions:
    """The motions of the whole team while a robot joins."""

    joining: RingChange  # the rings
    whole: Team  # the team
    # drones (2, 3) [m] of all other robots that are in neither ring, by robot
    waiting: Mapping[int, Array]
    requirements: Requirements  # enforced at all times
    index: int  # of the step in its mission

    def _with_all(self, ring: Motion, own: WaitingRobot | None = None) -> Motion:
        """Return the motion of a ring with all waiting robots, and the joining one if not in it."""
        waiting = {
            robot: waiting_robot(PartTeam.of(self.whole, [robot]), drones, self.requirements)
            for robot, drones in self.waiting.items()
        }
        if own is not None:
            waiting[self.joining.robot] = own
        return with_waiting(ring, self.whole, waiting, self.requirements)

    def _with_ring(self, own: Motion) -> Motion:
        """Return the robot's own motion with the open ring at rest."""
        (phase,) = own.phases
        ring = resting(self._opening, own.duration, replace(phase, state=CableState.ROLLING))
        return self._with_all(ring, WaitingRobot(own.drones, phase.state))

    @cached_property
    def _opening(self) -> Motion:
        phase = Phase("open", self.index, 0.0, 0.0)
        return roll_motion(self.joining.opening, self.requirements, phase)

    def opening(self, drones: Array) -> Motion:
        """Return the motion that opens the vertex while the robot's drones (2, 3) [m] wait."""
        own = waiting_robot(self.joining.robot_team, drones, self.requirements)
        return self._with_all(self._opening, own)

    def waiting_position(self) -> Array:
        """Return drones (2, 3) [m] of the robot beside all others in plan view.

        There it may land, others may join, and the ring may be untied. If there is no space, return
        those above or below its edge.
        """
        joining, requirements, ring = self.joining, self.requirements, self.joining.before
        clear, layout = joining.robot_clear(requirements)[0], ring.team.layout
        x, y = joining.after.polygon.edge_directions[joining.vertex]
        nodes = np.concatenate([ring.vertices, ring.drones])
        others = np.array([*self.waiting.values()]).reshape(-1, 2, 3)
        bodies = np.concatenate([others, nodes[layout.part_nodes]]) * [1.0, 1.0, 0.0]
        arena = requirements.arena
        for direction in ([-y, x, 0.0], [x, y, 0.0], [-x, -y, 0.0]):
            for step in range(MAX_WAITING_STEPS):
                drones = clear + step * WAITING_STEP * np.array(direction)
                own = drones * [1.0, 1.0, 0.0]
                offsets = shortest_offset(own[[0, 0, 1, 1]] - bodies[:, [0, 1, 0, 1]])
                distances = np.linalg.norm(offsets, axis=-1)
                if arena and np.any((drones < arena.lower) | (drones > arena.upper)):
                    break
                if np.min(distances[: len(others)], initial=np.inf) < WAITING_DISTANCE:
                    break
                if np.min(distances) >= WAITING_DISTANCE:
                    return drones
        return clear

    def return_motions(self, start: Array) -> list[Motion]:
        """Return the motions from a waiting position (2, 3) [m] to above or below the edge."""
        goal, team = self.joining.robot_clear(self.requirements)[0], self.joining.robot_team
        context = team, self.requirements, self.index
        return [
            *map(self._with_ring, straight_stages(start, [Keyframe("approach", goal)], *context))
        ]

    def arrival_motions(self, start: Array) -> list[Motion]:
        """Return the motions from drones (2, 3) [m] to above or below the edge, cable hanging."""
        team, context = self.joining.robot_team, (self.requirements, self.index)
        goal = self.joining.robot_clear(self.requirements)[0]
        altitude = float(hover_altitude(team, start, self.requirements))
        hovering = start.copy()
        hovering[:, 2] = np.maximum(start[:, 2], altitude)
        middle, length = np.mean(hovering, axis=0), float(team.cable_length[0])
        chord = np.linalg.norm(hovering[1] - hovering[0])
        spread = middle + APPROACH_SPAN_RATIO * length * (hovering - middle) / chord
        level = spread * [1.0, 1.0, 0.0] + goal * [0.0, 0.0, 1.0]
        keyframes = (
            Keyframe("take-off", hovering, CableState.GROUND),
            Keyframe("spread", spread),
            Keyframe("climb" if self.joining.side > 0.0 else "descend", level),
        )
        motions = straight_stages(start, keyframes, team, *context)
        if np.max(np.abs(level - goal)) >= MIN_FLIGHT:
            task = DirectApproach(team, level, goal, *context).problem
            prisms = (*task.requirements.keep_out, *starmap(self._prism, self.waiting.items()))
            own = replace(task.requirements, arena=self._clear_arena(goal), keep_out=prisms)
            flight = separated(replace(task, requirements=own))
            motions.append(stage("approach", flight, team, *context))
        return [self._with_ring(each) for each in motions]

    def _prism(self, robot: int, drones: Array) -> Prism:
        """Return a prism around waiting drones (2, 3) [m], their downwash and hanging cable."""
        start, end = drones[:, :2]
        along = unit(end - start, [1.0, 0.0], MIN_DIVISOR) * self.requirements.separation.cable
        left = np.array([-along[1], along[0]])
        corners = [start - along + left, end + along + left, end + along - left]
        lower = np.min(drones[:, 2]) - 0.5 * float(self.whole.cable_length[robot])
        upper = np.max(drones[:, 2]) + 2.0 * self.requirements.separation.height
        return Prism([*corners, start - along - left], lower, upper)

    def _clear_arena(self, goal: Array) -> Arena:
        """Return the part of the arena above or below the ring."""
        centre = np.mean(goal, axis=0)
        arena = self.requirements.arena or Arena(centre - SPACE_SIZE, centre + SPACE_SIZE)
        lower, upper = arena.lower.copy(), arena.upper.copy()
        if self.joining.side > 0.0:
            lower[2] = float(np.min(goal[:, 2])) - LEVEL_TOLERANCE
        else:
            upper[2] = float(np.max(goal[:, 2])) + LEVEL_TOLERANCE
        return Arena(lower, upper)

    def tying_motions(self) -> list[Motion]:
        """Return the motions from above or below the edge to the ring with the robot."""
        joining, context = self.joining, (self.requirements, self.index)
        hanging, taut = joining.robot_clear(self.requirements)
        lowered = Keyframe("lower", joining.robot_laid, CableState.LAYING)
        keyframes = Keyframe("draw taut", taut), lowered
        own = straight_stages(hanging, keyframes, joining.robot_team, *context)
        first, second = (
            roll_motion(path, self.requirements, Phase("roll", self.index, 0.0, 0.0))
            for path in joining.rolls
        )
        start = joining.with_robot(self._opening.drones.coefficients[-1, ..., -1])
        end = first.drones.coefficients[0, ..., 0]
        transfer = _weight_transfer(joining.after, start, end, *context)
        transfer = append_motion(resting(transfer, TENSION_SECONDS, first=True), transfer)
        return [*map(self._with_ring, own), *map(self._with_all, (transfer, first, second))]


def _weight_transfer(
    hitch: Hitch, start: Array, end: Array, requirements: Requirements, index: int
) -> Motion:
    """Return the motion of drones (2n, 3) [m] to the balance of cables that lie on each other."""
    team = hitch.team
    drones = straight_lines(team, requirements.limits, start, end)
    anchors = hitch.vertices[team.layout.anchors]
    ends = [np.linalg.norm(each - anchors, axis=1) for each in (start, end)]
    farthest = int(np.argmax(np.max(np.abs(end - start), axis=1)))
    axis = int(np.argmax(np.abs(end[farthest] - start[farthest])))
    c = drones.coefficients[:, farthest, axis]
    progress = (c - start[farthest, axis]) / (end[farthest, axis] - start[farthest, axis])
    legs = ends[0][:, None] + (ends[1] - ends[0])[:, None] * progress[:, None, :]
    vertices, tensions = (
        PiecewisePolynomial.constant(drones.breaks, value)
        for value in (hitch.vertices, team.tension)
    )
    phase = Phase("pass weight", index, 0.0, drones.duration, state=CableState.LYING)
    shape = (len(legs), team.robots, 2, legs.shape[-1])
    return Motion(
        team,
        requirements,
        drones,
        vertices,
        drones.replaced(legs.reshape(shape)),
        tensions,
        (phase,),
    )
