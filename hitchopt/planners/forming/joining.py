"""Robots that join a hitch in flight, or leave it, while all others stay tied.

A vertex is opened: both of its cables run straight through. The newcomer comes down on their lines,
taut by itself, on top of both, and cuts off the corner: where it crosses them are two vertices, at
rolls of ±180°. As the cables lie across each other, drones move by centimetres to where they are in
balance with the weights that the new vertices carry. Then its pairs roll, first the one whose leg
lies on top of the other one at the corner, as it rises. Leaving is the same backward.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from hitchopt.errors import InfeasibleError, InputError, Violation, check_time
from hitchopt.geometry import ConvexPolygon, shortest_offset
from hitchopt.geometry.vectors import unit
from hitchopt.hitch import GRAVITY, Hitch, Team
from hitchopt.hitch.catenary import Catenary
from hitchopt.hitch.forces import sag_factors
from hitchopt.hitch.requirements import Requirements, Separation
from hitchopt.hitch.team import PartTeam
from hitchopt.motion.chapters import Waiting, with_waiting
from hitchopt.motion.motion import CableState, Motion, Phase
from hitchopt.motion.retiming import padded, resting
from hitchopt.planners.forming.approach import DirectApproach, hover_altitude
from hitchopt.planners.forming.laying import ANGLES, MARGIN, ROOM, SHARES, RollPath, rolling
from hitchopt.planners.forming.prehitch import APART, SPAN, smallest_separation
from hitchopt.planners.forming.stages import MIN_FLIGHT, PAUSE, stage, straight_lines
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array

GAP = 0.005
"""[m] Height of the newcomer's cable over those on which it is laid, as it becomes part of them."""

NEWTON = 8
"""Iterations for the chord of a taut cable, which converge quadratically."""


def corner_cut(polygon: Any, vertex: int, cut: float) -> ConvexPolygon:
    """Return the outline with a vertex cut off at a distance [m] along both of its edges.

    Raises
    ------
    InputError: a distance beyond the shorter one of these edges.
    """
    points, lengths = polygon.vertices, polygon.edge_lengths
    longest = float(min(lengths[vertex - 1], lengths[vertex]))
    if not cut < longest:
        bound = f"less than {longest:.4g} m, the shorter edge at vertex {vertex}"
        raise InputError("cut", cut, bound, "cut off less")
    along, corner = polygon.edge_directions, points[vertex]
    new = corner - cut * along[vertex - 1], corner + cut * along[vertex]
    return ConvexPolygon(np.concatenate([points[:vertex], new, points[vertex + 1 :]]))


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
    """

    before: Hitch
    after: Hitch
    vertex: int
    senses: Array

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
        """(n + 1,): those of the clasps after; the robot is on top of both neighbours."""
        senses = np.insert(self.senses, self.vertex, 0.0)
        senses[self.ends] = [1.0, -1.0]
        return senses

    @cached_property
    def opened(self) -> RollPath:
        """The roll that opens the vertex."""
        end = self.before.roll.copy()
        end[self.corner] = -np.pi * self.senses[self.corner]
        return RollPath(self.before, self.before.roll, end)

    @cached_property
    def rolls(self) -> tuple[RollPath, RollPath]:
        """Both rolls, of the robot's two pairs, that of the upper leg at the corner first."""
        start = self.after.roll.copy()
        start[self.ends] = [-np.pi, np.pi]
        first = self.ends[int(self.senses[self.corner] > 0.0)]
        middle = start.copy()
        middle[first] = self.after.roll[first]
        return RollPath(self.after, start, middle), RollPath(self.after, middle, self.after.roll)

    def margin(self, separation: Separation) -> float:
        """Return by what factor distances are kept along both rolls, at least.

        Of all drones, and of each of the robot's legs to that of the other neighbour, which it
        rolls under or over.
        """
        s, n = np.linspace(0.0, 1.0, ANGLES), self.after.team.robots
        places = np.concatenate([path.drones(s) for path in self.rolls])
        points, (first, last), k = self.after.vertices, self.ends, self.vertex
        behind, ahead = (k - 1) % n, (k + 1) % n
        least = smallest_separation(places, separation)
        keep = max(separation.cable, separation.crossing)
        for mine, at, other, there in (
            (2 * k, first, 2 * ahead, last),
            (2 * k + 1, last, 2 * behind + 1, first),
        ):
            leg, its = (
                np.stack([np.broadcast_to(points[p], places[:, 0].shape), places[:, drone]], axis=1)
                for p, drone in ((at, mine), (there, other))
            )
            apart = shortest_offset(leg[:, [0, 0, 1, 1]] - its[:, [0, 1, 0, 1]])
            least = min(least, float(np.min(np.linalg.norm(apart, axis=-1))) / keep)
        return least

    @property
    def alone(self) -> Team:
        """The robot by itself."""
        return PartTeam(self.after.team, [self.vertex])

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
        places[:, 2] += float(np.max(depth - self._sags)) + GAP
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
        """Return an altitude [m] at which its cable hangs clear over all others."""
        separation = requirements.separation
        keep = MARGIN * max(separation.cable, separation.crossing) + ROOM
        hangs = 0.5 * float(self.after.team.cable_length[self.vertex]) + keep
        highest = float(np.max(self.opened.drones(np.ones(1))[..., 2]))
        return highest + max(hangs, 2.0 * APART * separation.height)

    def raised(self, requirements: Requirements) -> tuple[Array, Array]:
        """Return the robot's drones (2, 3) [m] over its place, hanging and taut."""
        taut = self.laid.copy()
        taut[:, 2] = self.clear(requirements)
        middle, length = np.mean(taut, axis=0), float(self.after.team.cable_length[self.vertex])
        share = SPAN * length / float(np.linalg.norm(taut[1] - taut[0]))
        return middle + share * (taut - middle), taut


def joining(
    before: Hitch,
    team: Team,
    vertex: int,
    outline: ConvexPolygon,
    senses: Array,
    requirements: Requirements,
) -> Joining:
    """Return a robot's joining, with its legs split so that drones clear as its pairs roll.

    ``team`` is the ring with it, ``outline`` its polygon. Legs of other cables end where they did.
    """
    k, n = vertex, team.robots
    cut = np.linalg.norm(outline.vertices[[k, (k + 1) % n]] - before.polygon.vertices[k], axis=1)
    slack = Hitch.balanced(team, outline, before.altitude).slack
    q_legs = np.insert(before.q_legs, k, 0.0)
    q_legs[(k + 1) % n] += cut[1]
    best, apart = None, -np.inf
    for share in SHARES:
        check_time()
        q_legs[k] = share * slack[k]
        after = Hitch(team, outline, before.altitude, q_legs.copy(), np.insert(before.roll, k, 0.0))
        each = Joining(before, after, vertex, senses)
        here = each.margin(requirements.separation)
        if here > apart:
            best, apart = each, here
        if apart >= APART:
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
    side: float,
) -> Joining:
    """Return a robot's leaving, as its joining backward.

    ``team`` is the ring without it, ``outline`` its polygon, and ``grown`` (2,) [m] by how much the
    edges of its neighbours grow; ``senses`` (n,) are those of the clasps after, and ``side`` that
    of the new one, 1 where the cable ahead comes to lie on top.

    Raises
    ------
    InfeasibleError: legs of its neighbours that are too short for the corner.
    """
    k, n = vertex, after.team.robots
    left = {
        f"r-leg {after.team.labels[k - 1]}": float(after.r_legs[k - 1]) - grown[0],
        f"q-leg {after.team.labels[(k + 1) % n]}": float(after.q_legs[(k + 1) % n]) - grown[1],
    }
    where, least = min(left.items(), key=lambda each: each[1])
    if least <= 0.0:
        remedy = "give its neighbours longer legs there by adjust, or longer cables"
        when = "where the lines of its neighbours meet"
        raise InfeasibleError([Violation("legs", least, 0.0, "min", "m", (where,), when, remedy)])
    q_legs = after.q_legs.copy()
    q_legs[(k + 1) % n] -= grown[1]
    own = np.delete(senses, k)
    before = Hitch(team, outline, after.altitude, np.delete(q_legs, k), np.delete(after.roll, k))
    own[k % team.robots] = side
    return Joining(before, after, k, own)


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
        team, down = PartTeam(whole, [robot]), places.copy()
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
            robot: at_rest(PartTeam(self.whole, [robot]), places, self.requirements)
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

    def arrival(self, start: Array) -> list[Motion]:
        """Return the motions from drones (2, 3) [m] to over the place, its cable hanging."""
        team, own = self.joined.alone, (self.requirements, self.index)
        goal = self.joined.raised(self.requirements)[0]
        motions, here = list[Motion](), start
        hovers = float(hover_altitude(team, start, self.requirements))
        for name, height, state in (
            ("take-off", hovers, CableState.GROUND),
            ("climb", float(goal[0, 2]), CableState.FREE),
        ):
            over = here.copy()
            over[:, 2] = np.maximum(here[:, 2], height)
            if np.max(over - here) >= MIN_FLIGHT:
                lines = straight_lines(team, self.requirements.limits, here, over)
                motions.append(stage(name, lines, team, *own, state))
            here = over
        if np.max(np.abs(here - goal)) >= MIN_FLIGHT:
            motions += DirectApproach(team, here, goal, *own).solve()
        return [self._beside(each) for each in motions]

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
        before, k = self._opening.drones.coefficients[-1, ..., -1], 2 * joined.vertex
        start = np.concatenate([before[:k], joined.laid, before[k:]])
        passing = _passing(joined.after, start, first.drones.coefficients[0, ..., 0], *own)
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
    still = (
        PiecewisePolynomial.constant(drones.breaks, value)
        for value in (hitch.vertices, team.tension)
    )
    vertices, tensions = still
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
