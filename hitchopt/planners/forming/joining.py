"""Robots that join a hitch in flight, or leave it, while all others stay tied.

A vertex is opened: both of its cables run straight through. The newcomer comes down on their lines,
taut by itself, on top of both, or up from below both, and cuts off the corner: where it crosses
them are two vertices, at rolls of ±180°. As the cables lie across each other, drones move by
centimetres to where they are in balance with the weights that the new vertices carry. Then its
pairs roll, first the one whose leg lies, at the corner, on the side to which it rolls: up if the
newcomer is on top, else down. Leaving is the same backward.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import product, starmap
from typing import Any

import numpy as np

from hitchopt.checks.cables import LENGTH_LIMIT
from hitchopt.checks.clasps import ROLLED
from hitchopt.checks.linking import LAID, MAX_PASSED
from hitchopt.errors import InfeasibleError, InputError, Violation, check_time
from hitchopt.geometry import ConvexPolygon, Outline, shortest_offset
from hitchopt.geometry.vectors import unit
from hitchopt.hitch import GRAVITY, Hitch, Team
from hitchopt.hitch.catenary import Catenary
from hitchopt.hitch.forces import sag_factors
from hitchopt.hitch.hitch import cable_slack
from hitchopt.hitch.requirements import Arena, Prism, Requirements
from hitchopt.hitch.slack_split import SPREAD_MARGIN, LegTask, reference_margin, reference_margins
from hitchopt.hitch.team import PartTeam
from hitchopt.motion.chapters import Waiting, with_waiting
from hitchopt.motion.motion import CableState, Motion, Phase
from hitchopt.motion.retiming import append_motion, padded, resting
from hitchopt.planners.forming.approach import DirectApproach, hover_altitude
from hitchopt.planners.forming.laying import (
    SHARES,
    TENSION_SECONDS,
    RollPath,
    planned_distance,
    rolling,
)
from hitchopt.planners.forming.prehitch import APART, SPAN, smallest_separation
from hitchopt.planners.forming.stages import MIN_FLIGHT, PAUSE, stage, straight_lines
from hitchopt.planners.morph.path import shapes_along
from hitchopt.planners.separation import SeparatedFlight
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array

GAP = 0.005
"""[m] Height of the newcomer's cable over those on which it is laid, as it becomes part of them."""

SPLITS = (0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8)
"""Slack splits that are tried where no split of the robot's legs alone clears."""

APART_AT = 0.35
"""Share of its roll from which on the first leg is expected to be clear of the one it lay on."""

PROBES, ENOUGH = 13, 1.05
"""Number of rolls at which distances are measured, and the factor on them that is enough."""

FAR, ALOFT = 100.0, 0.02
"""[m] Half the size of space without an arena; and how far a robot on its way may leave its level
towards the ring."""

ASIDE, ASIDE_STEP, ASIDE_STEPS = 0.5, 0.1, 40
"""[m] Distance to all others, seen from above, of a robot that has left, which is looked for in
steps [m], so many of them at most."""

LEVEL = 1e-9
"""Smallest angle [rad or °] and share that a limit is compared with."""

NARROW = 0.95
"""Distance of a robot's drones on its way over its cable's length: it hangs, but not deep."""

NEWTON = 8
"""Iterations for the chord of a taut cable, which converge quadratically."""


def corner_cut(polygon: Any, vertex: int, cut: float) -> ConvexPolygon:
    """Return the outline with a vertex cut off at a distance [m] along both of its edges.

    The new edge comes in the place of the vertex; vertex n is the first one with its new edge last.

    Raises
    ------
    InputError: a distance beyond the shorter one of these edges.
    """
    points, lengths = polygon.vertices, polygon.edge_lengths
    place, vertex = vertex, vertex % len(points)
    longest = float(min(lengths[vertex - 1], lengths[vertex]))
    if not cut < longest:
        bound = f"less than {longest:.4g} m, the shorter edge at vertex {vertex}"
        raise InputError("cut", cut, bound, "cut off less")
    along, corner = polygon.edge_directions, points[vertex]
    new = corner - cut * along[vertex - 1], corner + cut * along[vertex]
    outline = np.concatenate([points[:vertex], new, points[vertex + 1 :]])
    return ConvexPolygon(np.roll(outline, -int(place > vertex), axis=0))


def corner_restored(polygon: Any, edge: int, robot: int) -> tuple[ConvexPolygon, Array]:
    """Return the outline without an edge, whose neighbours meet, and how much they grow (2,) [m].

    Raises
    ------
    InputError: neighbours that do not meet beyond it, for its ``robot``.
    """
    points, n = polygon.vertices, len(polygon.vertices)
    u = polygon.edge_directions
    behind, ahead = u[edge - 1], u[(edge + 1) % n]
    a, b = points[edge], points[(edge + 1) % n]
    turn = behind[0] * ahead[1] - behind[1] * ahead[0]  # negative where the outline turns right
    apart = b - a
    grown = np.array(
        [
            (apart[0] * ahead[1] - apart[1] * ahead[0]) / turn if turn else np.inf,
            (behind[0] * apart[1] - behind[1] * apart[0]) / turn if turn else np.inf,
        ]
    )
    if n <= 3 or not (turn < -1e-6 and np.all(grown > 0.0) and np.all(np.isfinite(grown))):
        bound = "one beyond whose edge the lines of its neighbours meet"
        raise InputError("robot", robot, bound, "morph before, so that their edges converge")
    corner = a + grown[0] * behind
    left = np.delete(points, [edge, (edge + 1) % n], axis=0)
    return ConvexPolygon(np.insert(left, edge % (n - 1), corner, axis=0)), grown


@dataclass(frozen=True, eq=False)
class Joining:
    """A ring without a robot and with it.

    Attributes
    ----------
    before, after: the ring without the robot, and with it.
    vertex: place of the robot in the ring after; its edge cuts off the corner of the one before.
    senses: (n,) of the clasps before, 1 where the cable ahead is on top.
    side: 1 if the robot is on top of both neighbours, -1 if it is below both.
    """

    before: Hitch
    after: Hitch
    vertex: int
    senses: Array
    side: float

    @property
    def robot(self) -> int:
        """Number of the robot."""
        return self.after.team.labels[self.vertex]

    @property
    def corner(self) -> int:
        """Vertex of the ring before that is cut off."""
        return self.vertex % self.before.team.robots

    @property
    def ends(self) -> list[int]:
        """Both vertices of the robot's edge."""
        return [self.vertex, (self.vertex + 1) % self.after.team.robots]

    @property
    def senses_after(self) -> Array:
        """(n + 1,): those of the clasps after."""
        senses = np.insert(self.senses, self.vertex, 0.0)
        senses[self.ends] = [self.side, -self.side]
        return senses

    @cached_property
    def opened(self) -> RollPath:
        """The roll that opens the vertex."""
        end = self.before.roll.copy()
        end[self.corner] = -np.pi * self.senses[self.corner]
        return RollPath(self.before, self.before.roll, end)

    @cached_property
    def rolls(self) -> tuple[RollPath, RollPath]:
        """Both rolls, of the robot's two pairs, first that of the leg which is free to roll."""
        start = self.after.roll.copy()
        start[self.ends] = [-np.pi * self.side, np.pi * self.side]
        first = self.ends[int(self.side * self.senses[self.corner] > 0.0)]
        middle = start.copy()
        middle[first] = self.after.roll[first]
        return RollPath(self.after, start, middle), RollPath(self.after, middle, self.after.roll)

    def margin(self, requirements: Requirements, above: float = -np.inf) -> float:
        """Return by what factor all distances and legs are kept at some rolls of all, at least.

        At first the legs that lie across each other at the corner touch. What is known not to be
        ``above`` is not looked at further: some bound of it is returned.
        """
        separation, least = replace(requirements.separation, crossing=0.0), np.inf
        touching, (first, second) = replace(requirements, separation=separation), self.rolls
        for path, start, end, needed in (
            (self.opened, 0.0, 1.0, requirements),
            (second, 0.0, 1.0, requirements),
            (first, APART_AT, 1.0, requirements),
            (first, 0.0, APART_AT, touching),
        ):
            if least <= above:
                return least
            shapes = shapes_along(path, np.linspace(start, end, PROBES))
            least = min(least, float(np.min(shapes.legs)) / requirements.limits.leg)
            if least >= 1.0:
                q_legs, leg = shapes.legs[..., 0], requirements.limits.leg
                places = (path.team, needed, shapes.polygons, q_legs, leg, SPREAD_MARGIN)
                least = min(least, reference_margin(LegTask(*places, roll=shapes.roll)))
        if least >= 1.0:
            laid = self.with_robot(self.opened.drones(np.ones(1))[0])
            apart = smallest_separation(laid[None], requirements.separation)
            least = min(least, apart, self.open_at(laid))
        return least

    def open_at(self, laid: Array) -> float:
        """Return limits over how much legs lean with drones (2n, 3) [m] as its cable lies on both.

        Cut edges sag, so that it lies lower than the vertices that it will have; the shorter legs
        are, the more they lean. Both pairs count as open only near 180°, drones' pulls may change
        by a cable's weight there, lengths by its sag, and legs' by MAX_PASSED. The leg on top at
        the corner stays there.
        """
        hitch, team, n, k = self.after, self.after.team, self.after.team.robots, self.vertex
        legs, c = laid - hitch.vertices[team.layout.anchors], np.array(self.ends)
        along, lengths = unit(legs), np.linalg.norm(legs, axis=1).reshape(n, 2)
        u = np.column_stack([hitch.polygon.edge_directions, np.zeros(n)])
        q, axis = along[2 * c], unit(along[2 * c] + along[2 * c - 1])
        upward = np.cross(u[c] + u[c - 1], axis)
        rise, run = np.sum(q * upward, axis=1), np.sum(q * np.cross(axis, upward), axis=1)
        off = np.degrees(np.abs(np.arctan2(rise, -run)))
        balanced = self.rolls[0].drones(np.zeros(1))[0]
        curved = np.sum((balanced - laid) ** 2, axis=1).reshape(n, 2) / (8.0 * lengths)
        parts = np.column_stack([hitch.polygon.edge_lengths, lengths])
        sags = sag_factors(team, team.tension)
        whole = np.sum(parts + sags[:, None] * parts**3, axis=1)
        longer = whole / team.cable_length - 1.0
        midway = 0.5 * longer - np.sum(curved, axis=1) / team.cable_length
        longer = np.maximum(np.abs(longer), np.abs(midway))
        own, tension = slice(2 * k, 2 * k + 2), team.tension[k]
        weighs = GRAVITY * team.cable_density
        chord, weight = laid[2 * k + 1] - laid[2 * k], weighs * team.cable_length[k]
        slope = chord[2] / np.linalg.norm(chord) * np.array([-1.0, 1.0])
        before, after = 0.5 * weight + tension * slope, 0.5 * weighs * lengths[k]
        jump = np.abs(before - after - tension * along[own, 2])
        beneath = [self._beneath(drones) for drones in (laid, balanced)]
        ratios = (
            LAID / np.maximum(beneath, LEVEL),
            MAX_PASSED / np.maximum(np.abs(lengths - hitch.legs).ravel(), LEVEL),
            (180.0 - ROLLED) / np.maximum(off, LEVEL),
            weight / np.maximum(jump, LEVEL),
            (LENGTH_LIMIT + sags * team.cable_length**2) / np.maximum(longer, LEVEL),
        )
        return float(np.min(np.concatenate(ratios))) if weight else np.inf

    def _beneath(self, drones: Array) -> float:
        """Return how far the leg on top at the corner is beneath the other, straight [m]."""
        points, corner, heights = self.after.vertices, self.before.vertices[self.corner], []
        for end, drone in zip(self.ends, (2 * self.vertex - 1, 2 * self.ends[1]), strict=True):
            leg = drones[drone] - points[end]
            away = np.linalg.norm((corner - points[end])[:2]) / np.linalg.norm(leg[:2])
            heights.append(points[end, 2] + away * leg[2])
        return float(self.senses[self.corner] * (heights[0] - heights[1]))

    def checked(self) -> Joining:
        """Return it, or raise InfeasibleError where neighbours sag too much to lie across them."""
        ratio = self.open_at(self.with_robot(self.opened.drones(np.ones(1))[0]))
        if ratio < 1.0:
            when = "(limits over how its legs lean on cables that sag)"
            remedy = "raise team.tension, cut off less, or use lighter cables"
            where = (f"cable {self.robot}",)
            broken = Violation("tension", ratio, 1.0, "min", "", where, when, remedy)
            raise InfeasibleError([broken])
        return self

    def with_robot(self, opened: Array) -> Array:
        """Return the drones (2n, 3) [m] as the robot's cable lies on both others."""
        k = 2 * self.vertex
        return np.concatenate([opened[:k], self.laid, opened[k:]])

    @property
    def alone(self) -> Team:
        """The robot by itself."""
        return PartTeam.of(self.after.team, [self.vertex])

    @cached_property
    def laid(self) -> Array:
        """(2, 3) [m]: the robot's drones where its cable, taut, lies on both others."""
        k, hitch = self.vertex, self.after
        team, length = self.alone, float(hitch.team.cable_length[k])
        factor, share = float(sag_factors(team, team.tension)[0]) * length**2, 1.0
        for _ in range(NEWTON):
            share -= (share + factor * share**3 - 1.0) / (1.0 + 3.0 * factor * share**2)
        points = hitch.vertices[self.ends]
        along, cut = unit(points[1] - points[0]), float(np.linalg.norm(points[1] - points[0]))
        q_leg = (share * length - cut) * float(hitch.fractions[k])
        q = points[0] - q_leg * along
        places = np.stack([q, q + share * length * along])
        cable = Catenary.between(places[:1], places[1:], team.cable_length)
        at = np.linalg.norm(points - q, axis=1) / (share * length)
        depth = np.array([float(cable.depth(2.0 * x - 1.0)[0]) for x in at])
        level = depth - self._sags + self.side * GAP
        rise = np.linalg.solve(np.stack([1.0 - at, at], axis=1), level)
        places[:, 2] += rise
        shorter = 1.0 - np.sqrt(1.0 - ((rise[1] - rise[0]) / (share * length)) ** 2)
        places[1] -= shorter * share * length * along
        return places

    @property
    def _sags(self) -> Array:
        """(2,) [m]: by how much the cut edges of the ring sag at the new vertices."""
        team, own, k = self.before.team, self.before, self.corner
        lengths, cables = own.polygon.edge_lengths[[k - 1, k]], np.array([k - 1, k])
        cut = np.linalg.norm(self.after.vertices[self.ends] - own.vertices[k], axis=1)
        weight = GRAVITY * team.cable_density / (2.0 * team.tension[cables])
        sags: Array = weight * cut * (lengths - cut)
        return sags

    def clear(self, requirements: Requirements) -> float:
        """Return an altitude [m] at which its drones and cable are clear of all others.

        Over them its cable may hang as deep as half of its length; below them its drones are on
        top.
        """
        separation = requirements.separation
        keep = planned_distance(separation)
        heights = self.opened.drones(np.ones(1))[..., 2]
        if self.side > 0.0:
            hangs = 0.5 * float(self.after.team.cable_length[self.vertex]) + keep
            return float(np.max(heights)) + max(hangs, 2.0 * APART * separation.height)
        team = self.before.team
        sags = sag_factors(team, team.tension) * 3.0 * self.before.polygon.edge_lengths**2
        lowest = min(float(np.min(heights)), self.before.altitude - float(np.max(np.sqrt(sags))))
        return lowest - max(keep, 2.0 * APART * separation.height)

    def raised(self, requirements: Requirements) -> tuple[Array, Array]:
        """Return the robot's drones (2, 3) [m] over its place, hanging and taut."""
        taut = self.laid.copy()
        edge = np.min if self.side > 0.0 else np.max
        taut[:, 2] += self.clear(requirements) - edge(taut[:, 2])
        middle, length = np.mean(taut, axis=0), float(self.after.team.cable_length[self.vertex])
        share = SPAN * length / float(np.linalg.norm(taut[1] - taut[0]))
        return middle + share * (taut - middle), taut


def joining(
    before: Hitch,
    team: Team,
    vertex: int,
    outline: ConvexPolygon,
    senses: Array,
    side: float,
    requirements: Requirements,
) -> Joining:
    """Return a robot's joining, with legs split so that all keep their distances.

    ``team`` is the ring with it, ``outline`` its polygon. If no split of its own legs does, its
    neighbours' legs are split otherwise as well, before it comes.
    """
    k, n, corner = vertex, team.robots, vertex % before.team.robots
    new, old = outline.vertices[[k, (k + 1) % n]], before.polygon.vertices[corner]
    cut = np.linalg.norm(new - old, axis=1)
    slack = Hitch.balanced(team, outline, before.altitude).slack
    neighbours = [(k - 1) % before.team.robots, corner]
    fractions, whole = before.fractions[neighbours], before.slack[neighbours]

    splits = _splits(before.fractions[neighbours], [(share,) for share in SHARES])
    kept = splits[:, 1:] == fractions
    own = np.where(kept, before.q_legs[neighbours], splits[:, 1:] * whole)
    starts = np.tile(before.q_legs, (len(splits), 1))
    starts[:, neighbours] = own
    ends = np.insert(starts, k, splits[:, 0] * slack[k], axis=1)
    ends[:, (k + 1) % n] += cut[1]
    roll = np.insert(before.roll, k, 0.0)

    def tried(i: int) -> Joining:
        """Return the joining with a split of the robot's legs and of its neighbours'."""
        start = Hitch(before.team, before.polygon, before.altitude, starts[i], before.roll)
        after = Hitch(team, outline, before.altitude, ends[i], roll)
        return Joining(start, after, vertex, senses, side)

    rest = _rest_margins(team, outline, ends, roll, requirements)
    rest = np.minimum(rest, _slid_margins(before, starts, requirements))
    return _widest(tried, rest, requirements).checked()


def _splits(fractions: Array, first: Sequence[tuple[float, ...]]) -> Array:
    """Return splits (J, 3) of a robot's legs and of its neighbours', the nearest to these first.

    ``fractions`` (2,) are the neighbours'; with these as they are ``first`` has the robot's.
    """
    grid = np.array(list(product(SPLITS, SPLITS)))
    nearest = grid[np.argsort(np.sum((grid - fractions) ** 2, axis=1), kind="stable")]
    as_they_are = [(*share, *fractions) for share in first]
    return np.array([*as_they_are, *((share, *split) for split in nearest for share in SPLITS)])


def _rest_margins(
    team: Team, outline: Outline, q_legs: Array, roll: Array, requirements: Requirements
) -> Array:
    """Return by what factor distances and legs are kept at rest (J,), for q-legs (J, n) [m]."""
    leg, slack = requirements.limits.leg, cable_slack(team, outline)
    polygons = np.broadcast_to(outline.vertices, (len(q_legs), *outline.vertices.shape))
    rolls = np.broadcast_to(roll, q_legs.shape)
    task = LegTask(team, requirements, polygons, q_legs, leg, SPREAD_MARGIN, roll=rolls)
    shortest = np.min(np.minimum(q_legs, slack - q_legs), axis=1)
    margins: Array = np.minimum(reference_margins(task), shortest / leg)
    return margins


def _slid_margins(hitch: Hitch, q_legs: Array, requirements: Requirements) -> Array:
    """Return the least of ``_rest_margins`` (J,) as cables slide straight to q-legs (J, n) [m]."""
    shares = np.linspace(0.0, 1.0, PROBES)[:, None, None]
    between = hitch.q_legs + shares * (q_legs - hitch.q_legs)
    rows = between.reshape(-1, hitch.team.robots)
    margins = _rest_margins(hitch.team, hitch.polygon, rows, hitch.roll, requirements)
    least: Array = np.min(margins.reshape(PROBES, -1), axis=0)
    return least


def _widest(tried: Callable[[int], Joining], at_rest: Array, requirements: Requirements) -> Joining:
    """Return the first joining that keeps distances with a margin, else that with the largest.

    Of those that keep them ``at_rest`` (J,), if there are any.
    """
    best, apart = None, -np.inf
    chosen = np.flatnonzero(at_rest >= min(1.0, np.max(at_rest)))
    for i in chosen.tolist():
        check_time()
        if at_rest[i] <= apart:
            continue
        each = tried(i)
        here = each.margin(requirements, apart)
        if here > apart:
            best, apart = each, here
        if apart >= ENOUGH:
            break
    assert best is not None
    return best


def leaving(
    after: Hitch,
    team: Team,
    vertex: int,
    outline: ConvexPolygon,
    grown: Array,
    senses: Array,
    requirements: Requirements,
    *,
    slides: bool = True,
) -> Joining:
    """Return a robot's leaving, as its joining backward, with legs split as in ``joining``.

    ``team`` is the ring without it, ``outline`` its polygon, and ``grown`` (2,) [m] by how much the
    edges of its neighbours grow; ``senses`` (n,) are those of the clasps after. Its cables slide
    straight from their legs, or, if not ``slides``, have any at first.

    Raises
    ------
    InfeasibleError: legs of its neighbours that are too short for the corner.
    """
    k, n = vertex, after.team.robots
    own = [k, (k - 1) % n, (k + 1) % n]
    fractions, slack = after.fractions[own], after.slack

    splits = _splits(fractions[1:], [(fractions[0],)])
    ends = np.tile(after.q_legs, (len(splits), 1))
    ends[:, own] = np.where(splits == fractions, after.q_legs[own], splits * slack[own])
    starts = ends.copy()
    starts[:, own[2]] -= grown[1]
    shortest = np.minimum(starts[:, own[2]], slack[k - 1] - ends[:, k - 1] - grown[0])
    given = after.team, after.polygon, ends, after.roll, requirements
    rest = _slid_margins(after, ends, requirements) if slides else _rest_margins(*given)
    if np.max(shortest) < (least := requirements.limits.leg):
        names = tuple(f"cable {team.labels[j]}" for j in (k - 1, k % team.robots))
        when = "where the lines of its neighbours meet"
        longest, remedy = float(np.max(shortest)), "give them longer cables, or morph before"
        raise InfeasibleError([Violation("legs", longest, least, "min", "m", names, when, remedy)])
    rest = np.where(shortest < least, -np.inf, rest)
    starts = np.delete(starts, k, axis=1)

    def tried(i: int, corner: float) -> Joining:
        """Return the leaving with a split of the robot's legs and of its neighbours'."""
        left = np.delete(senses, k)
        left[k % team.robots] = corner
        there = Hitch(after.team, after.polygon, after.altitude, ends[i], after.roll)
        start = Hitch(team, outline, after.altitude, starts[i], np.delete(after.roll, k))
        return Joining(start, there, k, left, float(senses[k]))

    def enough(each: Joining) -> tuple[float, bool]:
        """Return up to what is enough its margin, and whether legs stay as they are."""
        same = np.array_equal(each.after.q_legs, after.q_legs)
        return min(each.margin(requirements), ENOUGH), same

    both = [_widest(partial(tried, corner=x), rest, requirements) for x in (1.0, -1.0)]
    return max(both, key=enough).checked()


def at_rest(team: Team, places: Array, requirements: Requirements) -> Waiting:
    """Return a robot that waits with its drones (2, 3) [m] at rest, its cable hanging or lying."""
    hangs = float(np.min(places[:, 2])) >= hover_altitude(team, places, requirements) - MIN_FLIGHT
    return Waiting(places, CableState.FREE if hangs else CableState.GROUND)


def landed(
    motion: Motion, whole: Team, waiting: Mapping[int, Array], requirements: Requirements
) -> Motion:
    """Return the motion in which a ring lands with the robots that wait, all straight down."""
    floor = requirements.floor
    flights = dict[int, Motion]()
    for robot, places in waiting.items():
        team, down = PartTeam.of(whole, [robot]), places.copy()
        down[:, 2] = floor
        lines = straight_lines(team, requirements.limits, places, down)
        flights[robot] = stage("land", lines, team, requirements, 0, CableState.GROUND)
    longest = max(each.duration for each in (motion, *flights.values()))
    besides = {
        robot: Waiting(
            padded(each, 0.0, longest).drones,
            each.phases[0].state if each.duration > PAUSE else CableState.GROUND,
        )
        for robot, each in flights.items()
    }
    (phase,) = motion.phases
    whole_time = padded(motion, 0.0, longest)
    own = whole_time.replaced(phases=(phase.retimed(0.0, longest),))
    return with_waiting(own, whole, besides, requirements)


@dataclass(frozen=True, eq=False)
class Joins:
    """How a robot joins, as motions of the whole team.

    Attributes
    ----------
    joined: the rings.
    whole: the team.
    waiting: (2, 3) [m] the drones of all other robots in neither ring, by their numbers.
    requirements: satisfied all along.
    index: of the step in its mission.
    """

    joined: Joining
    whole: Team
    waiting: Mapping[int, Array]
    requirements: Requirements
    index: int

    def _motion(self, ring: Motion, own: Waiting | None = None) -> Motion:
        """Return the motion of a ring as the robot moves, or waits, besides."""
        waiting = {
            robot: at_rest(PartTeam.of(self.whole, [robot]), places, self.requirements)
            for robot, places in self.waiting.items()
        }
        if own is not None:
            waiting[self.joined.robot] = own
        return with_waiting(ring, self.whole, waiting, self.requirements)

    def _beside(self, own: Motion) -> Motion:
        """Return the robot's own motion as the ring lies open, at rest."""
        (phase,) = own.phases
        there = resting(self._opening, own.duration, replace(phase, state=CableState.ROLLING))
        return self._motion(there, Waiting(own.drones, phase.state))

    @cached_property
    def _opening(self) -> Motion:
        return rolling(self.joined.opened, self.requirements, Phase("open", self.index, 0.0, 0.0))

    def opening(self, places: Array) -> Motion:
        """Return the motion that opens the vertex as the robot's drones (2, 3) [m] wait."""
        own = at_rest(self.joined.alone, places, self.requirements)
        return self._motion(self._opening, own)

    def aside(self) -> Array:
        """Return where its drones (2, 3) [m] wait beside all others, seen from above.

        There it may land, others may join, and the ring may be untied. Over, or below, its place if
        there is no room.
        """
        joined, requirements, ring = self.joined, self.requirements, self.joined.before
        over, layout = joined.raised(requirements)[0], ring.team.layout
        x, y = joined.after.polygon.edge_directions[joined.vertex]
        nodes = np.concatenate([ring.vertices, ring.drones])
        others = np.array([*self.waiting.values()]).reshape(-1, 2, 3)
        bodies = np.concatenate([others, nodes[layout.part_nodes]]) * [1.0, 1.0, 0.0]
        arena = requirements.arena
        for direction in ([-y, x, 0.0], [x, y, 0.0], [-x, -y, 0.0]):
            for step in range(ASIDE_STEPS):
                places = over + step * ASIDE_STEP * np.array(direction)
                own = places * [1.0, 1.0, 0.0]
                offsets = shortest_offset(own[[0, 0, 1, 1]] - bodies[:, [0, 1, 0, 1]])
                apart = np.linalg.norm(offsets, axis=-1)
                if arena and np.any((places < arena.lower) | (places > arena.upper)):
                    break
                if np.min(apart[: len(others)], initial=np.inf) < ASIDE:
                    break
                if np.min(apart) >= ASIDE:
                    return places
        return over

    def returning(self, aside: Array) -> list[Motion]:
        """Return the motion from there to over its place, or below it."""
        over, team = self.joined.raised(self.requirements)[0], self.joined.alone
        if np.max(np.abs(over - aside)) < MIN_FLIGHT:
            return []
        lines = straight_lines(team, self.requirements.limits, aside, over)
        return [self._beside(stage("approach", lines, team, self.requirements, self.index))]

    def arrival(self, start: Array) -> list[Motion]:
        """Return the motions from drones (2, 3) [m] to over the place, its cable hanging."""
        team, own = self.joined.alone, (self.requirements, self.index)
        goal = self.joined.raised(self.requirements)[0]
        motions, here = list[Motion](), start
        hovers = float(hover_altitude(team, start, self.requirements))
        aloft = start.copy()
        aloft[:, 2] = np.maximum(start[:, 2], hovers)
        middle, length = np.mean(aloft, axis=0), float(team.cable_length[0])
        spread = middle + NARROW * length * (aloft - middle) / np.linalg.norm(aloft[1] - aloft[0])
        level = spread * [1.0, 1.0, 0.0] + goal * [0.0, 0.0, 1.0]
        for name, to, state in (
            ("take-off", aloft, CableState.GROUND),
            ("spread", spread, CableState.FREE),
            ("climb" if self.joined.side > 0.0 else "descend", level, CableState.FREE),
        ):
            if np.max(np.abs(to - here)) >= MIN_FLIGHT:
                lines = straight_lines(team, self.requirements.limits, here, to)
                motions.append(stage(name, lines, team, *own, state))
            here = to
        if np.max(np.abs(here - goal)) >= MIN_FLIGHT:
            task = DirectApproach(team, here, goal, *own).problem
            others = (*task.requirements.keep_out, *starmap(self._around, self.waiting.items()))
            clear = replace(task.requirements, arena=self._clear_of_ring(goal), keep_out=others)
            drones = SeparatedFlight(replace(task, requirements=clear)).solve().drones
            motions.append(stage("approach", drones, team, *own))
        return [self._beside(each) for each in motions]

    def _around(self, robot: int, places: Array) -> Prism:
        """Return a prism around drones (2, 3) [m] that wait, their downwash, and their cable.

        It hangs at most half of its length deep.
        """
        start, end = places[:, :2]
        along = unit(end - start, [1.0, 0.0], LEVEL) * self.requirements.separation.cable
        left = np.array([-along[1], along[0]])
        corners = [start - along + left, end + along + left, end + along - left]
        lower = np.min(places[:, 2]) - 0.5 * float(self.whole.cable_length[robot])
        upper = np.max(places[:, 2]) + 2.0 * self.requirements.separation.height
        return Prism([*corners, start - along - left], lower, upper)

    def _clear_of_ring(self, goal: Array) -> Arena:
        """Return the arena above its place, or below it."""
        arena = self.requirements.arena
        lower, upper = (
            (np.full(3, -FAR), np.full(3, FAR)) if arena is None else (arena.lower, arena.upper)
        )
        lower, upper = lower.copy(), upper.copy()
        if self.joined.side > 0.0:
            lower[2] = float(np.min(goal[:, 2])) - ALOFT
        else:
            upper[2] = float(np.max(goal[:, 2])) + ALOFT
        return Arena(lower, upper)

    def tying(self) -> list[Motion]:
        """Return the motions from there to the ring with the robot."""
        joined, own = self.joined, (self.requirements, self.index)
        team, limits = joined.alone, self.requirements.limits
        hanging, taut = joined.raised(self.requirements)
        lines = (
            ("draw taut", hanging, taut, CableState.FREE),
            ("lower", taut, joined.laid, CableState.LAYING),
        )
        alone = (
            stage(name, straight_lines(team, limits, start, end), team, *own, state)
            for name, start, end, state in lines
        )
        first, second = (
            rolling(path, self.requirements, Phase("roll", self.index, 0.0, 0.0))
            for path in joined.rolls
        )
        start = joined.with_robot(self._opening.drones.coefficients[-1, ..., -1])
        passing = _passing(joined.after, start, first.drones.coefficients[0, ..., 0], *own)
        passing = append_motion(resting(passing, TENSION_SECONDS, first=True), passing)
        return [*map(self._beside, alone), *map(self._motion, (passing, first, second))]


def _passing(
    hitch: Hitch, start: Array, end: Array, requirements: Requirements, index: int
) -> Motion:
    """Return the motion of drones (2n, 3) [m] to where cables that lie across are in balance."""
    team = hitch.team
    drones = straight_lines(team, requirements.limits, start, end)
    anchors = hitch.vertices[team.layout.anchors]
    ends = [np.linalg.norm(each - anchors, axis=1) for each in (start, end)]
    moved = np.max(np.abs(end - start), axis=1)
    most = int(np.argmax(moved))
    axis = int(np.argmax(np.abs(end[most] - start[most])))
    c = drones.coefficients[:, most, axis]
    share = (c - start[most, axis]) / (end[most, axis] - start[most, axis])
    legs = ends[0][:, None] + (ends[1] - ends[0])[:, None] * share[:, None, :]
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
        drones.alike(legs.reshape(shape)),
        tensions,
        (phase,),
    )
