"""The planner of a hitch's moves with an object, as fast as limits allow."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise, product
from typing import Any, NamedTuple

import numpy as np

from hitchopt.carrying.holding import residual_grip
from hitchopt.carrying.holds import GripHold, HoldingHitch
from hitchopt.carrying.moves import MAX_STEP_SLOPE, Move, SmoothLaw
from hitchopt.carrying.polygons import HoldPolygons
from hitchopt.checks import Check
from hitchopt.checks.registry import RULE_OF
from hitchopt.checks.spans import value_cache
from hitchopt.errors import InfeasibleError, RequestError, Violation, rounded_down
from hitchopt.geometry import ConvexPolygon
from hitchopt.geometry.vectors import unit
from hitchopt.hitch import GRAVITY, Hitch, Team
from hitchopt.hitch.forces import BalanceError
from hitchopt.hitch.requirements import Requirements
from hitchopt.hitch.twists import bend_together
from hitchopt.motion.motion import Motion, Phase, PhaseHold, concatenated
from hitchopt.objects import SolidObject
from hitchopt.planners.candidates import Candidate, Effort, first_certified
from hitchopt.planners.ends import spread_hitch
from hitchopt.planners.timing.stretch import needed_stretch
from hitchopt.planners.timing.swing import calm_stretch
from hitchopt.values import Array

LIFT_SPEED = 0.4  # [m/s] Vertical speed with an object

AROUND_SPEED = 0.4
"""[m/s] Largest speed of hitches that move around an object, and of clasps that rise to a rim."""

CLOSING_SPEED = 0.25
"""[m/s] Largest speed of clasps through which cables slide as a hitch closes around an object or
opens. At 0.4 m/s links of simulated ropes catch and snap by more than five times the tension."""

BELOW_RIM = 0.01  # [m] Depth of cables below a rim, in addition to ``separation.object``.
CARRY_ACCELERATION = 1.0  # [m/s²] Largest acceleration of objects that are carried
LIFT_ACCELERATION = 0.8  # [m/s²] Largest acceleration of objects that are lifted or set down

CARRY_CHECKS = ("equilibrium", "grip", "separation", "crossing", "object_clearance")
"""Checks to which moves of a carried object are slowed down."""

RESERVE_CHECKS = (*CARRY_CHECKS, "cable_clearance", "keep_out")
"""Checks that holds keep at the accelerations of a carry."""

TRIAL_DIRECTIONS = (
    *(
        (np.array([math.cos(angle), math.sin(angle), 0.0, 0.0]), CARRY_ACCELERATION)
        for angle in np.radians([0.0, 45.0, 90.0, 135.0])
    ),
    (np.array([0.0, 0.0, 1.0, 0.0]), LIFT_ACCELERATION),
)
"""Directions of x, y, z and yaw in which holds are tried, forward and braking, and the largest
acceleration [m/s²] of each."""

TRIAL_HEIGHT = 1.0  # [m] Height above its place at which a held object is tried

LOAD_LAW = SmoothLaw(0.3)
"""Law of changes of tensions, of friction feed-forward, and of weight from support to clasps."""

MAX_SLOWINGS = 10  # Maximum number of slowings of a move
SLOWING_FACTOR = 1.5  # Factor of a slowing if the required one is unknown
SLOWING_BISECTIONS = 3  # Number of durations that are tried between the last two slowings
SLOWING_RESERVE = 1.01  # Factor of a slowing over the required one

LOW_OPENING_TENSION = 0.3
"""[N] Preferred tension of cables as grips open, and the lowest one as they close, if edges would
push the object. With low tensions cables hold each other less, but sag more."""

HIGH_OPENING_TENSION = 0.6  # [N] Other candidate tension of cables as grips open

FRICTION_SHARES = (0.9, 0.6, 0.3, 0.0)
"""Candidate friction feed-forwards of closing and opening, as shares of clasp friction, in order of
preference."""

PASSAGE_CHECKS = ("separation", "cable_length", "equilibrium")
"""Checks that reject a friction feed-forward, with which the sag of edges jumps at other corners,
or a tension, with which heavy cables sag too far."""

MAX_RESIDUAL_GRIP = 0.5  # Largest residual slip load of an open hitch over the weight
MAX_PUSH = 0.9  # Largest push of edges on a standing object over the friction with its support


@dataclass(frozen=True, eq=False)
class GraspState:
    """An object that a hitch encloses or holds."""

    object: str  # Name of the object
    polygons: HoldPolygons  # Polygons of the hitch, in the object's frame
    tension: Array  # (n,) [N], of cables from grasping to loosening
    # The hitch that holds the object; None while it only encloses it
    hold: HoldingHitch | None = None
    carried: bool = False  # True if clasps carry the object's weight


class Passage(NamedTuple):
    """The closing or the opening of a grip."""

    motion: Motion  # The motion, as one phase
    moves: list[Move]  # Its consecutive moves


def one_phase(
    parts: Sequence[Motion],
    requirements: Requirements,
    step: int,
    name: str,
    hold: PhaseHold | None = None,
) -> Motion:
    """Return consecutive motions as one phase of a step, with all remarks."""
    motion = concatenated([part.replaced(requirements=requirements) for part in parts])
    tensions = motion.tensions.coefficients
    tension_range = None
    if np.any(tensions != motion.team.tension[:, None]):
        tension_range = float(np.min(tensions)), float(np.max(tensions))
    remarks = dict.fromkeys(phase.remark for phase in motion.phases if phase.remark)
    phase = Phase(
        name, step, 0.0, motion.duration, "; ".join(remarks), tension=tension_range, hold=hold
    )
    return replace(motion, phases=(phase,))


def first_violated(motion: Motion, checks: Sequence[str]) -> Check | None:
    """Return the first check, of these names, that a motion violates; None if all hold."""
    with value_cache():
        for name in checks:
            check = RULE_OF[name].check(motion)
            if check is not None and not check.holds:
                return check
    return None


@dataclass(frozen=True, eq=False)
class MovePlanner:
    """A planner of moves of a hitch with the object that it holds."""

    state: GraspState  # Initial state of the grasp
    requirements: Requirements  # Limits, and objects at their current positions
    step: int  # Index of the step in its mission

    @property
    def hold(self) -> HoldingHitch:
        """The hitch with the object; raises InputError without one."""
        hold = self.state.hold
        if hold is None:
            raise RequestError("object", self.state.object, "one that is held", "grasp it first")
        return hold

    @property
    def grip(self) -> GripHold:
        """The hitch that grips the object; raises InputError for another hold."""
        hold = self.hold
        if not isinstance(hold, GripHold):
            raise RequestError("by", hold.by, "grip if cables close around it", "rest it instead")
        return hold

    @property
    def body(self) -> SolidObject:
        """The object at its current position."""
        return self.requirements.objects[self.state.object]

    def from_state(self, **changes: Any) -> MovePlanner:
        """Return the planner with another state."""
        return replace(self, state=replace(self.state, **changes))

    def motion(self, moves: Sequence[Move], name: str = "", remark: str = "") -> Motion:
        """Return the motion of consecutive moves as one phase."""
        cables = tuple(range(self.hold.team.robots))
        hold = PhaseHold(self.state.object, self.hold.by, cables)
        parts = list[Motion]()
        for move in moves:
            remarks = "; ".join(filter(None, [remark, move.remark]))
            phase = Phase(name, self.step, 0.0, 1.0, remarks, hold=hold)
            parts.append(self.hold.motion(move, self.requirements, phase))
        return one_phase(parts, self.requirements, self.step, name, hold)

    def move(
        self, law: SmoothLaw, tension: tuple[Array, Array] | None = None, **changes: Any
    ) -> Move:
        """Return a move from the state with the given changes.

        ``tension`` is the one before and after, (n,) [N] each; None if it does not change.
        """
        if tension is None:
            tension = (self.state.tension, self.state.tension)
        place = self.body.place
        load_share = float(self.state.carried)
        rest = Move(place, place, np.stack(tension), (load_share, load_share), law)
        return replace(rest, **changes)

    def rest(self, seconds: float) -> Move:
        """Return a pause [s] as a move."""
        return self.move(SmoothLaw(0.5 * seconds))

    def _load_move(self, tension: tuple[Array, Array] | None = None, **changes: Any) -> Move:
        """Return the move that changes loads of the hold, as fast as limits allow."""
        return self.within_limits(self.move(LOAD_LAW, tension, **changes))

    def transfer(self, before: float, after: float) -> Move:
        """Return the move that changes the clasps' fraction of the weight."""
        return self._load_move(load_share=(before, after))

    @property
    def gap(self) -> float:
        """Depth of cables below a rim without contact [m]."""
        return self.requirements.separation.object + BELOW_RIM

    def retension(self, before: Array, after: Array) -> list[Move]:
        """Return the move that changes tensions (n,) [N] below the rim, if they differ."""
        if np.array_equal(before, after):
            return []
        return [self._load_move((before, after), below=(self.gap, self.gap))]

    def rim_move(self, before: float, after: float) -> Move:
        """Return the move between two depths below the rim [m], one of which is 0."""
        distance = max(before, after)
        move = self.move(self._law_around(distance, AROUND_SPEED), below=(before, after))
        return self.within_limits(move)

    def _law_around(self, length: float, speed: float) -> SmoothLaw:
        """Return the fastest law of a motion over a length [m] at most at a speed [m/s]."""
        limits = self.requirements.limits
        return SmoothLaw.fastest(
            speed=min(speed, limits.vertex_speed) / length,
            acceleration=limits.acceleration / length,
            jerk=limits.jerk / length,
        )

    def carry(self, to: Array, speed: float) -> Move:
        """Return the fastest straight move of the object to (4,) x, y, z [m] and yaw [rad].

        The speed of the object and of the drones about it is at most ``speed`` [m/s]. Raises
        InfeasibleError if it cannot be carried.
        """
        start = self.body.place
        hold = self.hold
        limits = self.requirements.limits
        distance = float(np.linalg.norm((to - start)[:3]))
        turned_arc = abs(float(to[3] - start[3])) * hold.reach
        length = distance + turned_arc
        is_vertical = bool(np.all(start[[0, 1, 3]] == to[[0, 1, 3]]))
        of_object = min(CARRY_ACCELERATION, hold.largest_acceleration)
        if is_vertical:
            of_object = LIFT_ACCELERATION
        acceleration = min(of_object, limits.acceleration)
        law = SmoothLaw(0.5)
        if length > 0.0 and acceleration > 0.0:
            top_speed = min(speed, limits.speed, limits.vertex_speed)
            law = SmoothLaw.fastest(top_speed / length, acceleration / length, limits.jerk / length)
        carrying = self.from_state(carried=True)
        move = carrying.move(law, start=start, end=to)
        return carrying.within_limits(move, *carrying.met_at_rest(CARRY_CHECKS))

    def require_reserve(self, share: float) -> None:
        """Raise InfeasibleError if the hold breaks a limit as it starts to be carried.

        The object is off its support, away from obstacles, and accelerates at a ``share`` of the
        largest acceleration in TRIAL_DIRECTIONS, and upward.
        """
        place = self.body.place + [0.0, 0.0, TRIAL_HEIGHT, 0.0]
        objects = {self.state.object: self.body.moved_to(place)}
        free = replace(self.requirements, objects=objects, arena=None, keep_out=())
        planner = replace(self.from_state(carried=True), requirements=free)
        limits = self.requirements.limits
        of_hold = min(limits.acceleration, self.hold.largest_acceleration)
        for direction, largest in TRIAL_DIRECTIONS:
            acceleration = share * min(largest, of_hold)
            speed = min(limits.speed, limits.vertex_speed)
            distance = MAX_STEP_SLOPE * speed**2 / acceleration  # half of it to reach the speed
            law = SmoothLaw.fastest(
                speed / distance, acceleration / distance, limits.jerk / distance
            )
            motion = planner.motion([planner.move(law, end=place + distance * direction)])
            violated = first_violated(motion, RESERVE_CHECKS)
            if violated is not None:
                name = self.state.object
                when = f"with objects.{name} carried at {acceleration:.2g} m/s²"
                remedy = RULE_OF[violated.name].remedy
                raise InfeasibleError([violated.violation(when, remedy, object=name)])

    def met_at_rest(self, checks: Sequence[str]) -> list[str]:
        """Return the checks that the hold meets at rest: slower moves violate the others too."""
        at_rest = self.motion([self.rest(0.5)])
        return [name for name in checks if first_violated(at_rest, [name]) is None]

    def within_limits(self, move: Move, *checks: str) -> Move:
        """Return a move slowed down to the limits of motion and to some checks, by name.

        Its remark names the last check that slowed it down.
        """
        unslowed = move.law.duration
        cause = ""
        too_fast = None
        for _ in range(MAX_SLOWINGS):
            factor, violated = self._needed_slowing(move, checks)
            if not 1.0 < factor < math.inf:
                break
            if violated:
                cause = violated
                too_fast = move
            move = replace(move, law=move.law.slowed(SLOWING_RESERVE * factor))
        if too_fast is None:
            return move
        slow_enough = self._between(too_fast, move, checks)
        remark = f"slowed down from {unslowed:.3g} s to keep {cause}"
        return replace(slow_enough, remark=remark)

    def _between(self, too_fast: Move, slow: Move, checks: Sequence[str]) -> Move:
        """Return the fastest move between one that breaks a check and a slower one, by bisection.

        If the slow one breaks a check, too, it is returned.
        """
        if self._needed_slowing(slow, checks)[0] > 1.0:
            return slow
        for _ in range(SLOWING_BISECTIONS):
            factor = math.sqrt(slow.law.duration / too_fast.law.duration)
            middle = replace(too_fast, law=too_fast.law.slowed(factor))
            if self._needed_slowing(middle, checks)[0] > 1.0:
                too_fast = middle
            else:
                slow = middle
        return slow

    def _needed_slowing(self, move: Move, checks: Sequence[str]) -> tuple[float, str]:
        """Return the factor by which a move must be slowed, and which check requires it in words.

        The factor is at most 1 if the move is slow enough. That of limits of motion is known, inf
        if no slowing satisfies them. That of checks is not: for a move that violates one, or that
        the hold cannot carry, it is SLOWING_FACTOR.
        """
        try:
            motion = self.motion([move])
            factor = calm_stretch(motion, needed_stretch(motion))
            violated = first_violated(motion, checks) if factor <= 1.0 else None
        except BalanceError as error:  # of a motion that is too fast, not of the hold
            if not checks:
                raise
            return SLOWING_FACTOR, error.violations[0].constraint
        if violated is not None:
            at = " and ".join(violated.where)
            return SLOWING_FACTOR, f"{violated.name} at {at}" if at else violated.name
        return (SLOWING_FACTOR if checks and factor == math.inf else factor), ""

    # Grips.

    def close_grip(self, before: Array, name: str) -> Motion:
        """Return the motion from around the object, with tensions (n,) [N], to the grip."""
        return self._passage((before, self.state.tension), (0.0, 1.0), name).motion

    def open_grip(self, after: Array, name: str) -> Motion:
        """Return the motion from the grip to around the object, with tensions (n,) [N].

        Raises InfeasibleError if clasps would stick with too large a residual grip.
        """
        passage = self._passage((self.state.tension, after), (1.0, 0.0), name)
        self._check_residual_grip(passage.moves)
        return passage.motion

    def _check_residual_grip(self, moves: Sequence[Move]) -> None:
        """Raise InfeasibleError if clasps that stick after these moves hold too much weight."""
        team = self.hold.team
        layout = team.layout
        body = self.body
        last_opening = [move for move in moves if move.closure[0] > move.closure[1]][-1]
        end = self.hold.curves(last_opening, np.array([last_opening.law.duration]))
        legs = (end["drones"] - end["vertices"][:, layout.anchors])[0, :, :2]
        legs_at_clasps = np.stack([legs[2 * layout.ahead], legs[2 * layout.behind + 1]], axis=1)
        residual = residual_grip(
            legs_at_clasps, last_opening.tension[1], team.friction, body.friction
        )
        limit = MAX_RESIDUAL_GRIP * body.mass * GRAVITY
        if residual > limit:
            where = (f"objects.{self.state.object}",)
            when = "left as clasps stick"
            remedy = (
                "use smoother cables (team.cable_friction), longer ones, or a hitch tied larger"
            )
            violation = Violation("grip", residual, limit, "max", "N", where, when, remedy)
            raise InfeasibleError([violation])

    def _passage(
        self, tension: tuple[Array, Array], closure: tuple[float, float], name: str
    ) -> Passage:
        """Return the passage that closes or opens a hitch.

        Tensions in between are so low that edges do not displace the object. ``tension`` (n,) [N]
        and ``closure`` of the hitch are those before and after.
        """
        hold = self.grip
        opens = closure[0] > closure[1]
        has_friction = hold.team.friction > 0.0
        friction_shares = FRICTION_SHARES if has_friction else (0.0,)
        tensions_between = self._tensions_between(hold, tension[1] if opens else None)

        def passed(between: Array, friction_share: float) -> Passage:
            """Return the passage at tensions in between, with a share of friction compensated."""
            feedforward = -friction_share if opens else friction_share
            remark = ""
            if has_friction:
                remark = f"legs lean against {friction_share:.0%} of clasp friction"
            moves = self._passage_moves(hold, tension, between, closure, feedforward)
            motion = self.motion(moves, name, remark)
            violated = first_violated(motion, PASSAGE_CHECKS)
            if violated is None:
                return Passage(motion, moves)
            verb = "opens" if opens else "closes"
            body = self.state.object
            when = f"as the hitch {verb} around objects.{body}"
            remedy = "use lighter cables or a different cable length, or smooth the outline"
            raise InfeasibleError([violated.violation(when, remedy, object=body)])

        shares = product(tensions_between, friction_shares)
        passages = (Candidate("passage", partial(passed, *share)) for share in shares)
        return first_certified(passages, Effort())

    def _passage_moves(
        self,
        hold: GripHold,
        tension: tuple[Array, Array],
        between: Array,
        closure: tuple[float, float],
        feedforward: float,
    ) -> list[Move]:
        """Return the moves of a passage: to the tension in between, of clasps, and from it.

        Parameters
        ----------
        hold: the grip.
        tension: (n,) [N], before and after.
        between: (n,) [N], tension while clasps move.
        closure: before and after.
        feedforward: share of clasp friction, negative as the hitch opens.
        """
        before, after = tension
        start, end = closure
        moves = list[Move]()
        if feedforward or np.any(before != between):
            rising = (0.0, feedforward)
            change = (before, between)
            moves.append(self._load_move(change, closure=(start, start), friction_share=rising))
        planner = self.from_state(tension=between)
        moves.extend(planner.closure_moves(hold, start, end, feedforward))
        if feedforward or np.any(between != after):
            falling = (feedforward, 0.0)
            change = (between, after)
            moves.append(self._load_move(change, closure=(end, end), friction_share=falling))
        return moves

    def _tensions_between(self, hold: GripHold, opened: Array | None) -> list[Array]:
        """Return tensions (n,) [N] with which edges do not displace the object in the passage.

        ``opened`` (n,) [N] are those of the opened grip; None as it closes.
        """
        tension = self.state.tension
        low = np.minimum(tension, LOW_OPENING_TENSION)
        high = np.minimum(tension, HIGH_OPENING_TENSION)
        body = self.body
        limit = MAX_PUSH * body.friction * body.mass * GRAVITY
        push = max(hold.largest_push(tension), 1e-9)  # not zero: it divides
        reduced = tension * min(1.0, limit / push)
        lowest = np.maximum(np.minimum(low, reduced), np.minimum(tension, MIN_TENSION))
        candidates: tuple[Array, ...] = (tension, np.maximum(low, reduced), lowest)
        if opened is not None:  # no higher than needed around an object that stands again
            candidates = (np.minimum(low, opened), low, high, opened, lowest)
        rounded_limit = limit * (1.0 + 1e-9)
        tensions = [
            candidate for candidate in candidates if hold.largest_push(candidate) <= rounded_limit
        ]
        if not tensions:
            name = f"objects.{self.state.object}"
            push = hold.largest_push(low)
            when = "on its support, pushed by the edges"
            remedy = f"make it heavier, or raise {name}.friction"
            violation = Violation("grip", push, limit, "max", "N", (name,), when, remedy)
            raise InfeasibleError([violation])
        return tensions

    def closure_moves(
        self, hold: GripHold, start: float, end: float, friction_share: float
    ) -> Iterator[Move]:
        """Yield the moves from one closure to another, with friction feed-forward in between."""
        closures = np.unique([start, *hold.events, end])
        if start > end:
            closures = closures[::-1]
        for before, after in pairwise(closures.tolist()):
            path = hold.travel * abs(after - before)
            # Clasps that are tied where they grip do not move, but their drones may
            law = LOAD_LAW
            if path > 1e-6:  # clasps move
                law = self._law_around(path, CLOSING_SPEED)
            constant = (friction_share, friction_share)
            move = self.move(law, closure=(before, after), friction_share=constant)
            yield self.within_limits(move)


MIN_TENSION = 0.15
"""[N] Smallest default of that tension, and smallest one as grips close and open, unless the team's
is smaller."""


TILT_RESERVE = 5.0
"""[deg] Reserve of a suggested ``limits.tilt_deg`` over the tilt that a pull at rest needs."""


def check_pull(tension: float, team: Team, requirements: Requirements) -> None:
    """Raise InfeasibleError for a horizontal pull [N] that no drone can hold."""
    limit, binding = team.quadrotor[0].level_pull(requirements.limits.tilt)
    if tension <= limit:
        return
    remedy = f"grasp with a tension of {rounded_down(limit, 3):.3g} N or less"
    if binding == "tilt":
        tilt = np.degrees(requirements.limits.tilt)
        tilt_of_pull = np.degrees(np.arctan(tension / (GRAVITY * team.mass[0])))
        largest_tilt = np.degrees(np.min(team.max_tilt))
        if tilt_of_pull < largest_tilt:
            suggested = min(np.ceil(tilt_of_pull) + TILT_RESERVE, largest_tilt)
            needed = f"limits.tilt_deg of {suggested:.3g}, above {tilt:.3g}"
        else:
            needed = (
                f"a tilt of {tilt_of_pull:.3g}°, but the controllers tilt by at most "
                f"{largest_tilt:.3g}°"
            )
        remedy = f"horizontal pulls of {tension:.3g} N need {needed}; or {remedy}"
    violation = Violation(binding, tension, limit, "max", "N", (), "to grip at rest", remedy)
    raise InfeasibleError([violation])


OPENING_DISTANCE = 0.02
"""[m] Outward motion above which a clasp counts as opening; positions may err by 1 cm."""


def check_opens(hitch: Hitch, around: Array, requirements: Requirements, remedy: str) -> None:
    """Raise InfeasibleError if friction prevents legs from opening a hitch.

    A clasp opens if its legs, at an angle β, pull outward harder than its edges pull inward:
    ``cos(β/2) > e^{μ γ} cos(β_edges/2)``, where μ is the friction between cables and γ what counts
    of it for cables that slide alike (``hitch.twists.bend_together``) and turn by the mean of both
    angles. β is smallest if the two drones are side by side.

    Parameters
    ----------
    hitch: before it opens.
    around: (n, 2) [m], goals of its vertices, about any centre.
    requirements: the distance of drones.
    remedy: what to say where a hitch with the polygon ``around`` keeps its distances, so that it
        can be tied at that size.
    """
    team = hitch.team
    friction = team.friction
    if friction == 0.0 or np.any(hitch.roll):
        return
    vertices = hitch.polygon.vertices
    to_next = unit(np.roll(vertices, -1, axis=0) - vertices)
    to_previous = unit(np.roll(vertices, 1, axis=0) - vertices)
    inward = unit(to_next + to_previous)
    motion = (around - np.mean(around, axis=0)) - (vertices - np.mean(vertices, axis=0))
    outward_motion = -np.sum(inward * motion, axis=1)
    opens = outward_motion > OPENING_DISTANCE

    edge_angles = np.arccos(np.clip(np.sum(to_next * to_previous, axis=1), -1.0, 1.0))
    side_by_side = 2.0 * requirements.separation.radius
    q_legs = hitch.legs[team.layout.ahead, 0]
    r_legs = hitch.legs[team.layout.behind, 1]
    cosines = (q_legs**2 + r_legs**2 - side_by_side**2) / (2.0 * q_legs * r_legs)
    leg_angles = np.arccos(np.clip(cosines, -1.0, 1.0))
    bends = bend_together(0.5 * (edge_angles + leg_angles))
    log_ratio = np.log(np.cos(0.5 * leg_angles) / np.cos(0.5 * edge_angles))
    utilization = np.where(opens, np.exp(friction * bends - log_ratio), 0.0)
    worst = int(np.argmax(utilization))
    if utilization[worst] <= 1.0:
        return
    tied = spread_hitch(team, ConvexPolygon(around), hitch.altitude, requirements)
    remedies = [] if tied is None else [remedy]
    largest_friction = log_ratio[worst] / bends[worst]
    if largest_friction > 0.0:
        rounded = math.floor(1000.0 * largest_friction) / 1000.0
        remedies.append(f"use smoother cables, team.cable_friction {rounded:.3g} or less")
    where = (team.point_names[team.layout.clasps[worst]],)
    when = "as the hitch opens"
    ratio = float(utilization[worst])
    suggested = ", or ".join(remedies)
    violation = Violation("equilibrium", ratio, 1.0, "max", "ratio", where, when, suggested)
    raise InfeasibleError([violation])
