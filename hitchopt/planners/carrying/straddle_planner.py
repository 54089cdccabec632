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
from hitchopt.geometry.vectors import length, rotated, turn, unit
from hitchopt.hitch import Team
from hitchopt.hitch.catenary import Catenary
from hitchopt.hitch.holding import wraps_around
from hitchopt.hitch.requirements import Requirements
from hitchopt.motion.motion import CableState, Motion, Phase, PhaseHold, concatenated
from hitchopt.motion.retiming import resting
from hitchopt.objects.placing import poses_of
from hitchopt.planners.carrying.holds import GripHold
from hitchopt.planners.carrying.moves import Move, SmoothLaw, polynomials
from hitchopt.planners.carrying.planner import GraspState, MovePlanner, first_violated
from hitchopt.planners.carrying.polygons import HoldPolygons
from hitchopt.planners.carrying.straddle import MIN_BEND, OPEN, Place, PlaceChange, Straddle
from hitchopt.planners.forming.prehitch import MAX_SPAN_RATIO, MIN_SEPARATION
from hitchopt.planners.forming.stages import (
    SMOOTH,
    Keyframe,
    best,
    hover_altitude,
    straight_stages,
)
from hitchopt.planners.timing.timed_motion import needed_stretch
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array

SHORT_SHARES = (0.43, 0.4, 0.37, 0.34, 0.3, 0.26)
"""Candidate shares of q-legs, in the order of trial: drones of a pair pass each other at different
distances from the object."""

SCALES = (1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 5.0, 6.0)
"""Candidate distances of clasps to the object's centre as they are tied, over those of the grip."""

MIN_RADIAL = 0.05
"""[m] Length of legs in addition to ``limits.leg`` where clasps are tied far from the object."""

PITCHES = tuple(np.radians([4.0, 6.0, 8.0, 11.0, 15.0]))
"""[rad] Candidate slopes of cables, q-drones up, in the order of trial."""

STRADDLE_SPEED = 0.3
"""[m/s] Largest speed of drones while cables bend around an object."""

MAX_TURN = math.radians(20.0)
"""[rad] Largest angle by which hanging cables turn about an object on straight lines."""

SLACK = 6.0
"""Slack of hanging cables over the position error of drones, which displaces tauter ones far."""

BESIDE = 0.08
"""[m] Distance of straight cables to the object, in addition to ``separation.object``."""

DISTANCE_FACTOR, EXTRA_DISTANCE = 1.1, 0.01
"""Factor on the distances of cables, and distance added to them [m], in planning."""

MIN_HEIGHT = 0.06
"""[m] Smallest height of drones over the ground while cables are tied."""

TENSION_SECONDS = 0.5
"""[s] Rise of the tension from that of cables drawn taut."""

SAMPLES, FINE_SAMPLES = 21, 121
"""Number of samples of a change of the place, and of one whose first samples keep distances."""

UNFIT = -1e3
"""Margin of candidates that no plan can use."""


class Distance(NamedTuple):
    """The smallest of the distances that a check of the certificate limits."""

    check: str
    value: float
    limit: float
    planned: float  # limit with the reserve of planning
    unit: str = "m"

    @property
    def margin(self) -> float:
        """Margin over the planned distance."""
        return self.value / self.planned - 1.0


@dataclass(frozen=True, eq=False)
class StraddlePlanner(MovePlanner):
    """A planner of two cables that are tied on a path around an object.

    Its grasp is the grip to which they are drawn, with the tension with which they are tied.
    """

    path: Straddle

    # Distances, at samples.

    @cached_property
    def closest_rolling(self) -> Distance:
        """The distance with the smallest margin while pairs roll.

        Raises InfeasibleError for clasps that tensions cannot balance.
        """
        path = self.path
        origin, tension = path.hold.body.place, np.stack([path.tension, path.tension])
        roll = Move(origin, origin, tension, (0.0, 0.0), SmoothLaw(0.5), roll=(OPEN, 0.0))
        curves = path.hold.curves(roll, np.linspace(0.0, 1.0, SAMPLES))
        return self._closest(curves, curves["vertices"][:, path.hold.team.layout.anchors])

    @cached_property
    def closest_bent(self) -> Distance:
        """The distance with the smallest margin, from straight to crossing cables."""
        path, found = self.path, list[Distance]()
        places = [path.first, path.ready, *path.bent, path.laid]
        for count in (SAMPLES, FINE_SAMPLES):
            for start, end in pairwise(places):
                change = PlaceChange(start, end, SmoothLaw(0.5))
                curves = path.curves(change, np.linspace(0.0, 1.0, count))
                found.append(self._closest(curves, curves["anchors"]))
            if min(each.margin for each in found) < 0.0:
                break
        return min(found, key=lambda each: each.margin)

    def _closest(self, curves: dict[str, Array], inner: Array) -> Distance:
        """Return the distance with the smallest margin, with inner ends of legs (J, …, 3) [m]."""
        requirements, drones = self.requirements, curves["drones"]
        separation, count = requirements.separation, drones.shape[1]
        points, (i, j) = drones * separation.scale, np.triu_indices(count, 1)
        closest = float(np.min(length(points[:, i] - points[:, j])))
        pairs, ends = (each.reshape(curves["contacts"].shape) for each in (drones, inner))
        corners = np.stack([pairs, ends, curves["contacts"]], axis=2)  # (J, n, 3, 2, 3)
        route = np.concatenate([corners[..., 0, :], corners[:, :, ::-1, 1]], axis=2)
        parts = np.stack([route[:, :, :-1], route[:, :, 1:]], axis=3)
        cable, drone = np.nonzero(np.arange(count) // 2 != np.arange(count // 2)[:, None])
        offsets = shortest_offset(differences(drones[:, drone, None, None], parts[:, cable]))
        gap = float(np.min(length(offsets)))
        lowest = float(np.min(drones[..., 2])) - requirements.floor
        off = requirements.position_error * requirements.height_ratio
        wide = DISTANCE_FACTOR * separation.cable + EXTRA_DISTANCE
        each = (
            Distance("separation", closest, 1.0, MIN_SEPARATION, "ratio"),
            Distance("cable_clearance", gap, separation.cable, wide),
            Distance("arena", lowest, off, MIN_HEIGHT + off),
        )
        return min(each, key=lambda x: x.margin)

    @cached_property
    def unbalanced(self) -> Check | None:
        """The check that cables lying on one another violate individually, or None.

        One cable of a clasp bears the other if their legs are of very different lengths.
        """
        change = PlaceChange(self.path.laid, self.path.laid, SmoothLaw(0.5))
        return first_violated(self._bent(change, "lay"), ["equilibrium"])

    # Motions.

    @cached_property
    def hanging(self) -> tuple[Array, float]:
        """Drones (2n, 3) [m] with cables that hang beside the object, and their rise [m].

        Cables also keep off the ground as they turn about it there.
        """
        team, pairs = self.hold.team, self.path.drones_taut.reshape(-1, 2, 3)
        middle, chords = np.mean(pairs, axis=1, keepdims=True), length(pairs[:, 1] - pairs[:, 0])
        longest = np.minimum(_longest_spans(team, self.requirements), chords)
        rises = (pairs[:, 1] - pairs[:, 0])[:, 2]
        share = np.sqrt((longest**2 - rises**2) / (chords**2 - rises**2))
        scale = share[:, None, None] * [1.0, 1.0, 0.0] + [0.0, 0.0, 1.0]
        scales = np.stack([scale, math.cos(0.5 * MAX_TURN) * scale])  # also turned
        both = (middle + scales * (pairs - middle)).reshape(2, -1, 3)
        drones, lowest = both[0], hover_altitude(team, both, self.requirements)
        rise = max(lowest - float(np.min(drones[:, 2])), 0.0)
        return drones + [0.0, 0.0, rise], rise

    def stages(self) -> list[Motion]:
        """Return the motions from hanging cables to those that are tied, with one tension."""
        path, (drones, rise) = self.path, self.hanging
        raised = Keyframe("draw taut", path.drones_taut + [0.0, 0.0, rise], CableState.DRAWN)
        drawn = straight_stages(drones, [raised], self.hold.team, self.requirements, self.step)
        hold = PhaseHold(self.state.object, self.hold.by, tuple(range(self.hold.team.robots)))
        bent, first = list[Motion](), path.first._replace(above=rise)
        if first != path.ready:
            bent.append(self._through([first, path.ready], "lower"))
        bent.append(self._through([path.ready, *path.bent], "straddle", hold))
        bent.append(self._through([path.crossed, path.laid], "lay", hold))
        phase = replace(bent[0].phases[0], name="tension", hold=None)
        tension = resting(bent[0], TENSION_SECONDS, phase, first=True)
        rising = (path.tension[:, None] * SMOOTH)[None]
        tension = tension.replaced(tensions=PiecewisePolynomial(tension.drones.breaks, rising))
        opened = self.from_state(hold=path.hold)
        roll = opened.within_limits(opened.move(SmoothLaw(1.0), roll=(OPEN, 0.0)), "separation")
        rolled = opened.motion([roll], "roll")
        rolling = replace(rolled.phases[0], state=CableState.ROLLING, tension=phase.tension)
        return [*drawn, tension, *bent, rolled.replaced(phases=(rolling,))]

    def _through(self, places: Sequence[Place], name: str, hold: PhaseHold | None = None) -> Motion:
        """Return the motion through places, at rest at each, as one phase."""
        limits, parts = self.requirements.limits, list[Motion]()
        for start, end in pairwise(places):
            change = PlaceChange(start, end, SmoothLaw(0.5))
            drones = self.path.curves(change, np.linspace(0.0, 1.0, SAMPLES))["drones"]
            travel = max(float(np.max(np.sum(length(np.diff(drones, axis=0)), axis=0))), 1e-6)
            speed = min(STRADDLE_SPEED, limits.speed, limits.vertex_speed) / travel
            rates = speed, 0.5 * limits.acceleration / travel, 0.5 * limits.jerk / travel
            change = replace(change, law=SmoothLaw.fastest(*rates))
            motion = self._bent(change, name, hold)
            factor = needed_stretch(motion)
            if 1.0 < factor < math.inf:
                change = replace(change, law=change.law.slowed(1.01 * factor))
                motion = self._bent(change, name, hold)
            parts.append(motion)
        whole = concatenated(parts)
        return whole.replaced(phases=(replace(parts[0].phases[0], end=whole.duration),))

    def _bent(self, change: PlaceChange, name: str, hold: PhaseHold | None = None) -> Motion:
        """Return the motion of a change of the place as one phase; objects are at rest."""
        tension = float(np.min(self.path.tension)), float(np.max(self.path.tension))
        phase = Phase(name, self.step, 0.0, change.law.duration, hold=hold, tension=tension)
        parts: dict[str, Any] = polynomials(change, lambda t: self.path.curves(change, t))
        breaks, objects = parts["drones"].breaks, self.requirements.objects
        parts["poses"] = PiecewisePolynomial.constant(breaks, poses_of(objects))
        parts["load_share"] = PiecewisePolynomial.constant(breaks, np.zeros(len(objects)))
        phases = (replace(phase, state=CableState.BENT),)
        return Motion(self.hold.team, self.requirements, **parts, phases=phases)


def _longest_spans(team: Team, requirements: Requirements) -> Array:
    """Return the distances (n,) [m] of drones whose cables hang beside the object."""
    off = requirements.position_error * requirements.height_ratio
    L = team.cable_length
    return np.asarray(np.minimum(MAX_SPAN_RATIO * L, L - SLACK * off))


def find_straddle(
    name: str,
    hold: GripHold,
    tension: Array,
    requirements: Requirements,
    step: int = 0,
    drones: Array | None = None,
) -> StraddlePlanner:
    """Return the planner of the first path that keeps distances, else of that with most margin.

    Clasps are tied so far from the object that drones which turn about each other keep off the
    ground, and are drawn to those of ``hold`` then.

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
    centre, team = np.mean(hold.polygon, axis=0), hold.team
    aligned = rotated(hold.polygon - centre, _angle_to_side(hold))
    beside = _distance_beside(hold, requirements, drones)

    def candidates() -> Iterator[tuple[float, StraddlePlanner]]:
        for scale, share in product(SCALES, SHORT_SHARES):
            around = centre + scale * aligned
            legs = share * (team.cable_length - wraps_around(hold.body.section, around).lengths)
            if scale > 1.0 and np.min(legs) < requirements.limits.leg + MIN_RADIAL:
                continue
            grip = replace(hold, around=around, open_fractions=np.full(2, share))
            grasp = GraspState(name, HoldPolygons(around, hold.polygon), tension, grip)
            path = Straddle(grip, tension, 0.0, beside)
            rolled = StraddlePlanner(grasp, requirements, step, path)
            try:
                margin = rolled.closest_rolling.margin
            except InfeasibleError:
                margin = -math.inf
            if margin < 0.0:
                yield margin - 1.0, rolled
                continue
            if path.sides_passed or rolled.unbalanced:
                yield UNFIT, rolled
                continue
            for pitch in PITCHES:
                bent = replace(rolled, path=replace(path, pitch=float(pitch)))
                yield min(margin, bent.closest_bent.margin), bent

    found = best(candidates(), 0.0)
    if found.path.sides_passed:
        raise InfeasibleError([_met_sides(found.path)])
    if found.unbalanced:
        remedy = "raise the tension of tie, or use lighter cables or other lengths of them"
        raise InfeasibleError([found.unbalanced.violation("as cables lie on one another", remedy)])
    closest = [found.closest_rolling]
    if found.path.pitch > 0.0:  # of pairs that can roll
        closest.append(found.closest_bent)
    check, value, limit, _, unit_of_both = min(closest, key=lambda each: each.margin)
    if value < limit:
        remedy = "use longer cables, or enclose a narrow outline in a circle"
        if check == "arena":
            remedy = "tie it higher above the ground"
        when = "as cables bend around the object and roll, wherever they are tied"
        violation = Violation(check, value, limit, "min", unit_of_both, (), when, remedy)
        raise InfeasibleError([violation])
    return found


def _distance_beside(hold: GripHold, requirements: Requirements, drones: Array | None) -> float:
    """Return the distance [m] of straight cables to the object.

    Cables that hang there, and between ``drones`` (2n, 3) [m], keep off as they turn about it.
    """
    team, off = hold.team, requirements.position_error
    spans = _longest_spans(team, requirements)
    hanging = [Catenary.spanning(spans, 0.0, team.cable_length)]
    if drones is not None:
        hanging.append(Catenary.between(drones[0::2], drones[1::2], team.cable_length))
    displaced = [x.extra_displacement(off, requirements.height_ratio) for x in hanging]
    farthest = float(np.max(displaced, where=np.isfinite(displaced), initial=0.0))
    x, y = unit(hold.polygon[1] - hold.polygon[0])
    radius = max(each.section.circumradius for each in hold.body.slabs)
    width = float(np.sum(hold.body.section.support(np.array([[-y, x], [y, -x]]))))
    return requirements.separation.object + BESIDE + farthest + radius - 0.5 * width


def _angle_to_side(hold: GripHold) -> float:
    """Return the angle [rad] of the nearest side to the line through both clasps, if it is tiny.

    Grips are so accurate only. Straight cables must touch a side along all of its length.
    """
    sides = hold.body.section.sides
    angles = turn(hold.polygon[1] - hold.polygon[0], sides[:, 1] - sides[:, 0])
    angles = (angles + 0.5 * math.pi) % math.pi - 0.5 * math.pi
    nearest = float(angles[np.argmin(np.abs(angles))])
    return nearest if len(sides) > 1 and abs(nearest) < MIN_BEND else 0.0


def _met_sides(path: Straddle) -> Violation:
    """Return the violation of pitched cables that meet the sides of an object."""
    largest = math.degrees(float(np.max(path.turns)))
    value, limit = (largest * bend for bend in (max(path.sides_passed), path.largest_pitched))
    remedy = "use longer cables, which are tied farther out, or enclose the outline in a circle"
    when = "where cables cross beyond the object and meet another of its sides as they bend"
    return Violation("continuity", value, limit, "max", "deg", (), when, remedy)
