"""Motions of two cables that are tied around an object, and the search for their path."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise, product
from typing import Any, NamedTuple

import numpy as np

from hitchopt.checks import Check
from hitchopt.errors import InfeasibleError, Violation
from hitchopt.geometry import differences, shortest_offset
from hitchopt.geometry.vectors import left_of, length, rotated, turn, unit
from hitchopt.hitch import Team
from hitchopt.hitch.catenary import Catenary
from hitchopt.hitch.holding import wraps_around
from hitchopt.hitch.requirements import Requirements
from hitchopt.motion.motion import CableState, Motion, Phase, PhaseHold, concatenated
from hitchopt.motion.retiming import resting
from hitchopt.objects.placing import poses_of
from hitchopt.planners.candidates import if_feasible
from hitchopt.planners.carrying.holds import GripHold
from hitchopt.planners.carrying.moves import Move, SmoothLaw, polynomials
from hitchopt.planners.carrying.planner import (
    MAX_PUSH,
    GraspState,
    MovePlanner,
    first_violated,
    lowest_untying_tension,
)
from hitchopt.planners.carrying.polygons import HoldPolygons
from hitchopt.planners.carrying.straddle import MIN_BEND, OPEN, Place, PlaceChange, Straddle
from hitchopt.planners.forming.prehitch import MIN_SEPARATION, longest_spans
from hitchopt.planners.forming.stages import SMOOTH, Keyframe, best, hover_altitude, straight_stages
from hitchopt.planners.timing.stretch import needed_stretch
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array

SHORT_SHARES = (0.43, 0.4, 0.37, 0.34, 0.3, 0.26)
"""Candidate shares of q-legs, in the order of trial: drones of a pair pass each other at different
distances from the object."""

SCALES = (1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 5.0, 6.0)
"""Candidate distances of clasps to the object's centre as they are tied, over those of the grip.
Those at which one cable alone would drag the object are tried last."""

MIN_RADIAL = 0.05
"""[m] Length of legs in addition to ``limits.leg`` where clasps are tied far from the object."""

PITCHES = tuple(float(np.radians(angle)) for angle in (4.0, 6.0, 8.0, 11.0, 15.0))
"""[rad] Candidate slopes of cables, q-drones up, in the order of trial."""

STRADDLE_SPEED = 0.3  # [m/s] Largest speed of drones while cables bend around an object

MAX_TURN = math.radians(20.0)
"""[rad] Largest angle by which hanging cables turn about an object on straight lines."""

BESIDE = 0.08
"""[m] Distance of straight cables to the object, in addition to ``separation.object``."""

DISTANCE_FACTOR = 1.1  # Factor on the distances of cables in planning
EXTRA_DISTANCE = 0.01  # [m] Distance of cables in planning, in addition to the scaled one
MIN_HEIGHT = 0.06  # [m] Smallest height of drones over the ground while cables are tied
TENSION_SECONDS = 0.5  # [s] Rise of the tension from that of cables drawn taut
SAMPLED_LAW = SmoothLaw(0.5)  # Law of changes of which only the shape is used
SAMPLES = 21  # Number of samples of a change of the place

MIN_TRAVEL = 1e-3
"""[m] Smallest path of drones by which limits of a change of the place are divided."""

SLOWING_RESERVE = 1.01  # Factor of a slowing over the required one
UNFIT = -1e3  # Margin of candidates that no plan can use


class Distance(NamedTuple):
    """The smallest of the distances that a check of the certificate limits."""

    check: str  # Name of the check
    value: float  # The smallest distance [unit]
    limit: float  # Its limit [unit]
    planned: float  # The limit with the reserve of planning [unit]
    unit: str = "m"  # Unit of all three

    @property
    def margin(self) -> float:
        """Margin over the planned distance."""
        return self.value / self.planned - 1.0

    @property
    def is_kept(self) -> bool:
        """Return whether the distance is at least its limit."""
        return self.value >= self.limit


class HangingDrones(NamedTuple):
    """Drones of two cables that hang next to an object."""

    drones: Array  # (2n, 3) [m]
    rise: float  # Their height above the drones of cables that are drawn taut there [m]


@dataclass(frozen=True, eq=False)
class StraddlePlanner(MovePlanner):
    """A planner of two cables that are tied on a path around an object.

    Its grasp is the grip to which they are drawn, with the tension with which they are tied.
    """

    path: Straddle  # The path of the cables

    # Distances, at samples.

    @cached_property
    def closest_rolling(self) -> Distance:
        """The tightest distance while pairs roll.

        Raises InfeasibleError for clasps that tensions cannot balance.
        """
        hold = self.path.hold
        place = hold.body.place
        tensions = np.stack([self.path.tension, self.path.tension])
        roll = Move(place, place, tensions, (0.0, 0.0), SAMPLED_LAW, roll=(OPEN, 0.0))
        curves = hold.curves(roll, np.linspace(0.0, SAMPLED_LAW.duration, SAMPLES))
        return self._closest(curves, curves["vertices"][:, hold.team.layout.anchors])

    @cached_property
    def closest_bent(self) -> Distance:
        """The tightest distance from straight to crossing cables."""
        path = self.path
        places = [path.first, path.ready, *path.bent, path.laid]
        changes = [PlaceChange(start, end, SAMPLED_LAW) for start, end in pairwise(places)]
        distances = list[Distance]()
        for count in (SAMPLES, 121):
            for change in changes:
                curves = path.curves(change, np.linspace(0.0, SAMPLED_LAW.duration, count))
                distances.append(self._closest(curves, curves["anchors"]))
            if _tightest(distances).margin < 0.0:
                break
        return _tightest(distances)

    def _closest(self, curves: dict[str, Array], leg_ends: Array) -> Distance:
        """Return the tightest distance of samples, with inner ends of legs (J, …, 3) [m]."""
        requirements = self.requirements
        separation = requirements.separation
        drones = curves["drones"]
        scaled = drones * separation.scale
        first, second = np.triu_indices(drones.shape[1], 1)
        closest = float(np.min(length(scaled[:, first] - scaled[:, second])))
        gap = _gap_to_cables(drones, leg_ends, curves["contacts"])
        height = float(np.min(drones[..., 2])) - requirements.floor
        height_error = requirements.height_error
        planned_gap = DISTANCE_FACTOR * separation.cable + EXTRA_DISTANCE
        distances = (
            Distance("separation", closest, 1.0, MIN_SEPARATION, "ratio"),
            Distance("cable_clearance", gap, separation.cable, planned_gap),
            Distance("arena", height, height_error, MIN_HEIGHT + height_error),
        )
        return _tightest(distances)

    @cached_property
    def unbalanced(self) -> Check | None:
        """The check that cables lying on one another violate individually, or None.

        One cable of a clasp bears the other if their legs are of very different lengths.
        """
        change = PlaceChange(self.path.laid, self.path.laid, SAMPLED_LAW)
        return first_violated(self._bent(change, "lay"), ["equilibrium"])

    def candidates(self) -> Iterator[tuple[float, StraddlePlanner]]:
        """Yield planners whose cables are pitched, with their smallest margins.

        If pairs cannot roll, or cables cannot be pitched or balanced, only this one, with
        horizontal cables.
        """
        rolling = if_feasible("rolling pairs", lambda: self.closest_rolling, None)
        if rolling is None:
            yield -math.inf, self
            return
        if not rolling.is_kept:
            yield rolling.margin - 1.0, self
            return
        if self.path.sides_passed or self.unbalanced:
            yield UNFIT, self
            return
        for pitch in PITCHES:
            pitched = replace(self, path=replace(self.path, pitch=pitch))
            yield min(rolling.margin, pitched.closest_bent.margin), pitched

    # Motions.

    @cached_property
    def hanging(self) -> HangingDrones:
        """Drones with cables hanging next to the object, off the ground while turning about it."""
        team = self.hold.team
        pairs = self.path.drones_taut.reshape(-1, 2, 3)
        middles = np.mean(pairs, axis=1, keepdims=True)
        chords = pairs[:, 1] - pairs[:, 0]
        chord_lengths = length(chords)
        chord_rises = chords[:, 2]
        spans = np.minimum(longest_spans(team, self.requirements), chord_lengths)
        level_share = np.sqrt((spans**2 - chord_rises**2) / (chord_lengths**2 - chord_rises**2))
        scale = level_share[:, None, None] * [1.0, 1.0, 0.0] + [0.0, 0.0, 1.0]
        halfway_scale = math.cos(0.5 * MAX_TURN) * scale  # drones are nearest halfway through turns
        scales = np.stack([scale, halfway_scale])
        straight_and_turned = (middles + scales * (pairs - middles)).reshape(2, -1, 3)
        drones = straight_and_turned[0]
        altitude = hover_altitude(team, straight_and_turned, self.requirements)
        rise = max(altitude - float(np.min(drones[:, 2])), 0.0)
        return HangingDrones(drones + [0.0, 0.0, rise], rise)

    def stages(self) -> list[Motion]:
        """Return the motions from hanging cables to those that are tied, with one tension."""
        path = self.path
        team = self.hold.team
        drones, rise = self.hanging
        raised = Keyframe("draw taut", path.drones_taut + [0.0, 0.0, rise], CableState.DRAWN)
        drawn = straight_stages(drones, [raised], team, self.requirements, self.step)
        hold = PhaseHold(self.state.object, self.hold.by, tuple(range(team.robots)))
        first = path.first._replace(above=rise)
        bent = list[Motion]()
        if first != path.ready:
            bent.append(self._through([first, path.ready], "lower"))
        bent.append(self._through([path.ready, *path.bent], "straddle", hold))
        bent.append(self._through([path.crossed, path.laid], "lay", hold))

        phase = replace(bent[0].phases[0], name="tension", hold=None)
        at_rest = resting(bent[0], TENSION_SECONDS, phase, first=True)
        rising = path.tension[:, None] * SMOOTH  # (n, coefficients)
        tensions = PiecewisePolynomial(at_rest.drones.breaks, rising[None])
        tightened = at_rest.replaced(tensions=tensions)
        return [*drawn, tightened, *bent, self._rolled(bent[0])]

    def _rolled(self, bent: Motion) -> Motion:
        """Return the roll of pairs, with the stated tension of the motion before."""
        planner = self.from_state(hold=self.path.hold)
        roll = planner.within_limits(planner.move(SmoothLaw(1.0), roll=(OPEN, 0.0)), "separation")
        motion = planner.motion([roll], "roll")
        phase = replace(motion.phases[0], state=CableState.ROLLING, tension=bent.phases[0].tension)
        return motion.replaced(phases=(phase,))

    def _through(self, places: Sequence[Place], name: str, hold: PhaseHold | None = None) -> Motion:
        """Return the motion through places, at rest at each, as one phase."""
        parts = list[Motion]()
        for start, end in pairwise(places):
            change = PlaceChange(start, end, self._fastest_law(start, end))
            motion = self._bent(change, name, hold)
            factor = needed_stretch(motion)
            if 1.0 < factor < math.inf:
                change = replace(change, law=change.law.slowed(SLOWING_RESERVE * factor))
                motion = self._bent(change, name, hold)
            parts.append(motion)
        whole = concatenated(parts)
        return whole.replaced(phases=(replace(parts[0].phases[0], end=whole.duration),))

    def _fastest_law(self, start: Place, end: Place) -> SmoothLaw:
        """Return the law between two places for the longest path of a drone."""
        limits = self.requirements.limits
        change = PlaceChange(start, end, SAMPLED_LAW)
        times = np.linspace(0.0, SAMPLED_LAW.duration, SAMPLES)
        drones = self.path.curves(change, times)["drones"]
        paths = np.sum(length(np.diff(drones, axis=0)), axis=0)
        travel = max(float(np.max(paths)), MIN_TRAVEL)
        top_speed = min(STRADDLE_SPEED, limits.speed, limits.vertex_speed)
        return SmoothLaw.fastest(
            speed=top_speed / travel,
            acceleration=0.5 * limits.acceleration / travel,
            jerk=0.5 * limits.jerk / travel,
        )

    def _bent(self, change: PlaceChange, name: str, hold: PhaseHold | None = None) -> Motion:
        """Return the motion of a change of the place as one phase; objects are at rest."""
        tension_range = float(np.min(self.path.tension)), float(np.max(self.path.tension))
        phase = Phase(
            name,
            self.step,
            0.0,
            change.law.duration,
            hold=hold,
            tension=tension_range,
            state=CableState.BENT,
        )
        curves: dict[str, Any] = polynomials(change, lambda t: self.path.curves(change, t))
        breaks = curves["drones"].breaks
        objects = self.requirements.objects
        return Motion(
            self.hold.team,
            self.requirements,
            **curves,
            phases=(phase,),
            poses=PiecewisePolynomial.constant(breaks, poses_of(objects)),
            load_share=PiecewisePolynomial.constant(breaks, np.zeros(len(objects))),
        )


def _tightest(distances: Sequence[Distance]) -> Distance:
    """Return the distance with the smallest margin; one that breaks its limit, if there is any."""
    return min(distances, key=lambda distance: (distance.is_kept, distance.margin))


def _gap_to_cables(drones: Array, leg_ends: Array, contacts: Array) -> float:
    """Return the smallest distance [m] of drones to cables of others.

    Cables are straight from drone to leg end, contact, contact, leg end and drone.

    Parameters
    ----------
    drones: (J, 2n, 3) [m]
    leg_ends: (J, …, 3) [m], inner ends of legs.
    contacts: (J, n, 2, 3) [m]
    """
    pairs = drones.reshape(contacts.shape)
    ends = leg_ends.reshape(contacts.shape)
    corners = [pairs[:, :, 0], ends[:, :, 0], contacts[:, :, 0]]
    corners += [contacts[:, :, 1], ends[:, :, 1], pairs[:, :, 1]]
    routes = np.stack(corners, axis=2)  # (J, n, 6, 3)
    parts = np.stack([routes[:, :, :-1], routes[:, :, 1:]], axis=3)  # (J, n, 5, 2, 3)
    cable_of_drone = np.arange(drones.shape[1]) // 2
    cables = np.arange(contacts.shape[1])
    cable, drone = np.nonzero(cable_of_drone != cables[:, None])
    offsets = shortest_offset(differences(drones[:, drone, None, None], parts[:, cable]))
    return float(np.min(length(offsets)))


def find_straddle(
    name: str,
    hold: GripHold,
    tension: Array,
    requirements: Requirements,
    step: int = 0,
    drones: Array | None = None,
) -> StraddlePlanner:
    """Return the planner of the first path that keeps distances, or of the one nearest to that.

    Clasps are tied so far from the object that drones which turn about each other keep clear of the
    ground, and are then drawn to those of ``hold``. Cables of a grip that is tied already keep
    the difference of their legs.

    Parameters
    ----------
    name: of the object.
    hold: the grip.
    tension: (n,) [N], of cables as they are tied.
    requirements: with the distances to keep.
    step: index of the step in its mission.
    drones: (2n, 3) [m], before, with hanging cables.

    Raises
    ------
    InfeasibleError: a distance is too small at samples, pitched cables would meet sides of the
        object, or cables do not balance, wherever clasps are tied.
    """
    team = hold.team
    centre = np.mean(hold.polygon, axis=0)
    aligned = rotated(hold.polygon - centre, _angle_to_side(hold))
    before = [] if drones is None else [_hanging_cables(team, drones)]
    level_cables = Catenary.spanning(longest_spans(team, requirements), 0.0, team.cable_length)
    beside = _distance_beside(hold, requirements, [level_cables, *before])

    is_tied = bool(np.any(hold.leg_differences))
    shares = SHORT_SHARES[:1] if is_tied else SHORT_SHARES

    def drags(scale: float) -> bool:
        """Return whether one cable alone, pulling as weakly as it can be untied, drags the object.

        Farther out cables bend less, and pull less.
        """
        opened = replace(hold, around=centre + scale * aligned)
        return MAX_PUSH * opened.standing_tension < lowest_untying_tension(team)

    def candidates() -> Iterator[tuple[float, StraddlePlanner]]:
        for scale, share in product(sorted(SCALES, key=drags), shares):
            around = centre + scale * aligned
            slack = team.cable_length - wraps_around(hold.body.section, around).lengths
            differences = hold.leg_differences if is_tied else (2.0 * share - 1.0) * slack
            shortest_leg = 0.5 * np.min(slack - np.abs(differences))
            if scale > 1.0 and shortest_leg < requirements.limits.leg + MIN_RADIAL:
                continue
            grip = hold.drawn_from(around, differences)
            grasp = GraspState(name, HoldPolygons(around, hold.polygon), tension, grip)
            level = Straddle(grip, tension, pitch=0.0, beside=beside)
            yield from StraddlePlanner(grasp, requirements, step, level).candidates()

    planner = best(candidates(), 0.0)
    _check_straddle(planner)
    hanging_cables = _hanging_cables(team, planner.hanging.drones)
    beside = _distance_beside(hold, requirements, [hanging_cables, *before])
    return replace(planner, path=replace(planner.path, beside=beside))


def _check_straddle(planner: StraddlePlanner) -> None:
    """Raise InfeasibleError if the best planner of all candidates breaks a limit."""
    path = planner.path
    if path.sides_passed:
        largest_turn = math.degrees(float(np.max(path.turns)))
        value = largest_turn * max(path.sides_passed)
        limit = largest_turn * path.largest_pitched
        when = "where cables cross beyond the object and touch another of its sides as they bend"
        remedy = "use longer cables, which are tied farther out, or enclose the outline in a circle"
        raise InfeasibleError(
            [Violation("continuity", value, limit, "max", "deg", (), when, remedy)]
        )
    if planner.unbalanced:
        when = "as cables lie on one another"
        remedy = "raise tie.tension, or use lighter cables or a different cable length"
        raise InfeasibleError([planner.unbalanced.violation(when, remedy)])
    distances = [planner.closest_rolling]
    if path.pitch > 0.0:  # of pairs that can roll
        distances.append(planner.closest_bent)
    tightest = _tightest(distances)
    if not tightest.is_kept:
        when = "as cables bend around the object and roll, wherever they are tied"
        remedy = "use longer cables, or enclose a narrow outline in a circle"
        if tightest.check == "arena":
            remedy = "tie it higher above the ground"
        violation = Violation(
            tightest.check,
            tightest.value,
            tightest.limit,
            "min",
            tightest.unit,
            (),
            when,
            remedy,
        )
        raise InfeasibleError([violation])


def _hanging_cables(team: Team, drones: Array) -> Catenary:
    """Return the cables (n,) that hang between drones (2n, 3) [m]."""
    return Catenary.between(drones[0::2], drones[1::2], team.cable_length)


def _distance_beside(
    hold: GripHold, requirements: Requirements, hanging: Sequence[Catenary]
) -> float:
    """Return the distance [m] of straight cables to the object.

    The ``hanging`` cables keep off the object there and as they turn about it, however position
    errors of their drones displace them.
    """
    displacements = [
        cables.extra_displacement(requirements.position_error, requirements.height_ratio)
        for cables in hanging
    ]
    displacement = float(np.max(displacements, where=np.isfinite(displacements), initial=0.0))
    left = left_of(unit(hold.polygon[1] - hold.polygon[0]))
    half_width = 0.5 * float(np.sum(hold.body.section.support(np.stack([left, -left]))))
    radius = max(slab.section.circumradius for slab in hold.body.slabs)
    return requirements.separation.object + BESIDE + displacement + radius - half_width


def _angle_to_side(hold: GripHold) -> float:
    """Return the angle [rad] of the nearest side to the line through both clasps, if it is tiny.

    Grips are so accurate only. Straight cables must touch a side along all of its length.
    """
    sides = hold.body.section.sides
    to_sides = turn(hold.polygon[1] - hold.polygon[0], sides[:, 1] - sides[:, 0])
    angles = (to_sides + 0.5 * math.pi) % math.pi - 0.5 * math.pi  # of lines without direction
    nearest = float(angles[np.argmin(np.abs(angles))])
    return nearest if len(sides) > 1 and abs(nearest) < MIN_BEND else 0.0
