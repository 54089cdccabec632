"""Certified reactions to the loss of a drone: survivors release tension and descend clear of it.

Survivors react DELAY after the loss. The plan's clock stops as soon as the certificate allows. The
team descends with all distances unchanged until its lowest drone or cable is on the ground; drones
then descend vertically. The survivors of a hitch release tension within RELEASE_TIME, while the
lost drone swings below its clasp and its cable slides. With free cables, the lost drone must reach
the ground before its cable is taut, because no drone can carry two.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache, partial
from itertools import pairwise

import numpy as np

from hitchopt.checks.arena import height_above_floor
from hitchopt.checks.certificate import SAMPLED, Check
from hitchopt.checks.drones import largest_at_rest, thrust_share
from hitchopt.checks.linking import CONTINUITY
from hitchopt.checks.losses import SURVIVABLE
from hitchopt.checks.registry import distances_of, rules_of
from hitchopt.checks.rule import WorstCase
from hitchopt.errors import InfeasibleError, InputError, OneLine, Progress
from hitchopt.hitch import GRAVITY
from hitchopt.hitch.pairs import FIXED
from hitchopt.live.abort import straight_down, until_stop
from hitchopt.motion.flight import Flight
from hitchopt.motion.motion import Motion
from hitchopt.motion.retiming import append_motion, resting
from hitchopt.motion.states import States, states_at
from hitchopt.planners.candidates import error_of
from hitchopt.planners.forming.prehitch import smallest_separation
from hitchopt.planners.timing.ramps import fastest_clock
from hitchopt.support import REFUSALS, Feature, Neighbour
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.trajectory.piecewise import on_breaks
from hitchopt.values import Array, nonnegative, positive

DELAY = 0.05  # time from the loss until the survivors react [s]
LIMIT_SHARE = 0.8  # fraction of the limits that is used in the descent
STOP_DELAYS = (0.0, 0.1, 0.25)  # candidate delays of the stop [s]
GROUND_TOLERANCE = 1e-3  # height up to which drones are on the ground [m]

# Time in which survivors release tension [s]. The falling drone pulls hardest on taut level cables,
# and accelerates longer on slack ones: in simulated flights peaks of tension were larger with an
# immediate release, and with one in twice the time
RELEASE_TIME = 0.3

# Distance by which a lost drone pulls its partner toward their clasp [m]: in simulated flights
# legs of 0.29 m were pulled to their clasps, those of 0.37 m were not
MAX_PULL = 0.36
MIN_LEG = 0.05  # Shortest remaining leg [m]

# Angle lost in a swing [rad], because sliding cables dissipate energy. Computed swings of legs from
# 0.3 to 0.8 m, with tensions up to 0.4 N and coefficients of friction up to 0.2, reversed 27° to
# 52° before the symmetric angle
SWING_LOSS = np.radians(25.0)

SWING_SAMPLES = 40  # Number of sampled angles of a swing
SLIDE_SAMPLES = 5  # Number of sampled lengths of the sliding cable of a swing
# Number of times at which survivors are compared with the lost drone on the ground
GROUND_SAMPLES = 400
FALL_STEP = 0.02  # Time between samples of a free fall [s]

DEFAULT_INTERVAL = 1.0  # Default interval of the sampled times of losses [s]
MIN_SAMPLES = 8  # Minimum number of sampled times of losses

# Rules of the drones' vertical landing (without the cables, which fold on the ground), and of the
# team's motion before, both including the lost drone's path
LAND_RULES = rules_of("drones", *FIXED)
DESCENT_RULES = tuple(
    dict.fromkeys([*LAND_RULES, *distances_of("drones", "cables", "vertices"), CONTINUITY])
)


@dataclass(frozen=True, eq=False)
class Reaction(OneLine):
    """A certified reaction to the loss of a drone."""

    drone: str
    start: float  # time at which survivors react [s]
    motion: Motion  # the plan until then and the descent, the same for the loss of any drone
    # largest ratio of thrust to maximum thrust of a survivor that hovers while its level cable
    # carries the lost drone's weight
    thrust: float
    nearest: float  # minimum separation of survivors, or distance to the lost one over two radii


class Reactions:
    """The reactions of one plan; motions after a loss are shared by all drones."""

    def __init__(self, motion: Motion) -> None:
        self.motion = motion
        self._motion_after = lru_cache(maxsize=256)(self._certified_motion)

    def plan(self, drone: str, time: float) -> Reaction:
        """Return the reaction to the loss of a drone at a time [s].

        Raises InfeasibleError with the limit that binds.
        """
        motion = self.motion
        names = self.motion.team.drone_names
        if drone not in names:
            raise InputError(
                "lose", drone, f"one of {', '.join(motion.team.listed_names)}", "name a drone"
            )
        if nonnegative("t", time) > motion.duration:
            raise InputError(
                "t", time, f"within {motion.duration:g} s", "choose a time within the plan"
            )
        states = states_at(motion, time)
        lost = names.index(drone)
        descent = self._motion_after(float(time))
        start = min(time + DELAY, motion.duration)
        if bool(states.formed):
            thrust, nearest = self._check_swing(lost, states)
        else:
            thrust = 0.0
            nearest = self._check_fall(descent.drones, time, start, lost)
        thrust = max(largest_at_rest(motion, thrust_share), thrust)
        if thrust > 1.0:
            raise _no_reaction(
                time, f"holding {drone} on its cable takes {thrust:.0%} of a drone's thrust"
            )
        if nearest < 1.0:
            raise _no_reaction(
                time, f"a survivor comes within {nearest:.3g} times the minimum distance"
            )
        return Reaction(drone, start, descent, thrust, nearest)

    def _certified_motion(self, time: float) -> Motion:
        """Return the certified motion after a loss at a time [s]."""
        if self.motion.team.has_cables and self.motion.requirements.objects:
            reason = str(REFUSALS[Feature.REACTION, Neighbour.OBJECTS])
            raise _no_reaction(time, reason)
        reasons = list[str]()
        for delay in STOP_DELAYS:
            motion, violated = _with_descent(self.motion, time + DELAY + delay)
            if violated is None:
                return motion
            reasons.append(f"descending would violate {violated.in_words}")
        raise _no_reaction(time, reasons[0])

    def _check_swing(self, lost: int, states: States) -> tuple[float, float]:
        """Return thrust ratio and nearest distance of a hitch whose lost drone swings."""
        team = self.motion.team
        partner = lost ^ 1
        points = team.layout.pulled_to
        others = np.arange(team.drones) != lost
        near_loss = others & ((points == points[lost]) | (np.arange(team.drones) == partner))
        thrusts = GRAVITY * np.hypot(team.mass, team.mass[lost]) / team.max_thrust
        leg = states.positions[partner] - states.vertices[points[partner]]
        length = float(np.linalg.norm(leg))
        max_slide = max(length - MIN_LEG, 0.0)
        swing = self._swing(lost, states, max_slide)
        positions = states.positions.copy()
        positions[partner] -= min(max_slide, MAX_PULL) / length * leg
        separation = self.motion.requirements.separation
        ratio = smallest_separation(positions[None, others], separation)
        nearest = min(self._to_lost(states.positions[others, None], swing), ratio)
        return float(np.max(thrusts[near_loss])), nearest

    def _swing(self, lost: int, states: States, max_slide: float) -> Array:
        """Return positions (k, 3) [m] of the lost drone in all possible swings below its clasp.

        Its cable slides by up to ``max_slide`` [m], depending on tension, friction and the partner.
        """
        clasp = states.vertices[self.motion.team.layout.pulled_to[lost]]
        leg = states.positions[lost] - clasp
        horizontal = float(np.hypot(*leg[:2]))
        start = np.arctan2(-leg[2], horizontal)
        angles = np.linspace(start, np.pi - start - SWING_LOSS, SWING_SAMPLES)[:, None]
        outward = leg * [1.0, 1.0, 0.0] / max(horizontal, 1e-9)
        arcs = np.cos(angles) * outward - np.sin(angles) * [0.0, 0.0, 1.0]
        slides = np.linspace(0.0, max_slide, SLIDE_SAMPLES)[:, None, None]
        positions: Array = (clasp + (np.linalg.norm(leg) + slides) * arcs).reshape(-1, 3)
        return np.maximum(positions, [-np.inf, -np.inf, self.motion.requirements.floor])

    def _check_fall(
        self, drones: PiecewisePolynomial, time: float, start: float, lost: int
    ) -> float:
        """Return the nearest distance to a lost drone that falls freely."""
        team = self.motion.team
        floor = self.motion.requirements.floor
        at_loss = self.motion.drones.at(time)[lost], self.motion.drones.at(time, 1)[lost]
        times, fall = free_fall(*at_loss, floor)
        survivors = drones.at(np.minimum(time + times, drones.breaks[-1]))
        if team.has_cables:
            chords = np.linalg.norm(survivors[:, lost ^ 1] - fall, axis=-1)
            taut = chords > team.cable_length[lost // 2]
            if np.any(taut):
                height = fall[np.argmax(taut), 2] - floor
                reason = f"hangs from its partner {height:.2g} m above the ground"
                raise _no_reaction(time, f"{team.drone_names[lost]} {reason}")
        later = drones.at(np.linspace(start, drones.breaks[-1], GROUND_SAMPLES))
        survivors, later = (np.delete(each, lost, axis=1) for each in (survivors, later))
        return min(self._to_lost(survivors, fall[:, None]), self._to_lost(later, fall[-1]))

    def _to_lost(self, survivors: Array, positions: Array) -> float:
        """Return the minimum distance of survivors (…, 3) to the lost drone, over two radii.

        The distance counts equally in all directions: without motors there is no downwash.
        """
        distances = np.linalg.norm(survivors - positions, axis=-1)
        radius = self.motion.requirements.separation.radius
        return float(np.min(distances, initial=np.inf)) / (2.0 * radius)


def _no_reaction(time: float, reason: str) -> InfeasibleError:
    return InfeasibleError([], f"no reaction to a loss at t = {time:.4g} s: {reason}")


def free_fall(position: Array, velocity: Array, floor: float) -> tuple[Array, Array]:
    """Return times (k,) [s] and positions (k, 3) [m] of a free fall to the ground."""
    height = position[2] - floor
    up = velocity[2]
    duration = (up + np.sqrt(max(up**2 + 2.0 * GRAVITY * height, 0.0))) / GRAVITY
    times = np.append(np.arange(0.0, duration, FALL_STEP), duration)
    positions = position + times[:, None] * velocity
    positions[:, 2] -= 0.5 * GRAVITY * times**2
    return times, np.maximum(positions, [-np.inf, -np.inf, floor])


def _heights(motion: Motion) -> Array:
    """Return the heights of drones above the ground at the end of a motion (2n,) [m]."""
    heights: Array = motion.drones.coefficients[-1, :, 2, -1] - motion.requirements.floor
    return heights


def _with_descent(motion: Motion, time: float) -> tuple[Motion, Check | None]:
    """Return a plan that stops from a time [s] on and lands, and the first violated check."""
    (stopped,) = until_stop(Flight.of(motion), min(time, motion.duration)).flight.teams
    motion = stopped.motion
    if motion.phases[-1].formed or not motion.team.has_cables:
        motion = _with_common_descent(motion)  # hanging cables would be dragged on the ground
    checks = [rule.check(motion) for rule in DESCENT_RULES]
    if np.max(_heights(motion)) > GROUND_TOLERANCE:
        landing = straight_down(motion)
        checks += [rule.check(landing) for rule in LAND_RULES]
        motion = append_motion(motion, landing)
    return motion, next((each for each in checks if each is not None and not each.holds), None)


def _with_common_descent(motion: Motion) -> Motion:
    """Return a plan with a descent of the whole team until a drone or cable is on the ground."""
    depth = height_above_floor(resting(motion, 1.0))
    limits = motion.requirements.limits
    if depth <= GROUND_TOLERANCE:
        return motion
    bounds = (LIMIT_SHARE * bound for bound in (limits.speed, limits.acceleration, limits.jerk))
    depths = fastest_clock(depth, *bounds)
    rest = resting(motion, depths.duration)
    rest = rest.map_curves(lambda part: on_breaks(part, depths.breaks), rest.phases)
    lower = depths.coefficients[:, None, None] * np.array([0.0, 0.0, -1.0])[:, None]
    drones, vertices = (
        part.replaced(part.coefficients + lower) for part in (rest.drones, rest.vertices)
    )
    return append_motion(motion, rest.replaced(drones=drones, vertices=vertices))


@dataclass(frozen=True)
class UnsurvivableSpan(OneLine):
    """A span of a plan in which the loss of a drone has no certified reaction."""

    drone: str
    start: float  # half-way to the previous sampled time [s]
    end: float  # half-way to the next sampled time [s]
    reason: str  # at the first sampled time


def survivable(
    motion: Motion, every: float = DEFAULT_INTERVAL, progress: Progress | None = None
) -> tuple[Check, list[UnsurvivableSpan]]:
    """Return the share of (drone, time), about ``every`` [s], with a certified reaction to a loss.

    It is sampled, not a bound for all times. Spans without a reaction are listed.
    """
    reactions = Reactions(motion)
    names = motion.team.drone_names
    spans: dict[str, list[UnsurvivableSpan]] = {name: [] for name in names}
    count = max(MIN_SAMPLES, round(motion.duration / positive("every", every)))
    edges = np.linspace(0.0, motion.duration, count + 1).tolist()
    refused = 0
    for start, end in pairwise(edges):
        time = 0.5 * (start + end)
        if progress is not None:
            progress(f"losses at t = {time:.4g} s of {motion.duration:.4g} s")
        for name, found in spans.items():
            error = error_of(partial(reactions.plan, name, time))
            if error is None:
                continue
            refused += 1
            if found and found[-1].end == start:
                found[-1] = replace(found[-1], end=end)
            else:
                found.append(UnsurvivableSpan(name, start, end, str(error)))
    without = [each for found in spans.values() for each in found]
    share = 1.0 - refused / (count * len(names))
    where = dict.fromkeys(x.drone for x in without)
    time = min((each.start for each in without), default=0.0)
    worst = WorstCase(share, time, tuple(where))
    return replace(worst.check(SURVIVABLE, None), method=SAMPLED), without
