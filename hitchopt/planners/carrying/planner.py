"""The planner of a hitch's moves with an object, as fast as limits allow."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, product
from typing import Any

import numpy as np

from hitchopt.checks import Check
from hitchopt.checks.registry import RULE_OF
from hitchopt.checks.spans import value_cache
from hitchopt.errors import InfeasibleError, InputError, Violation
from hitchopt.geometry.vectors import unit
from hitchopt.hitch import GRAVITY, Hitch, Team
from hitchopt.hitch.holding import residual_grip
from hitchopt.hitch.requirements import Requirements
from hitchopt.motion.motion import Motion, Phase, PhaseHold, concatenated
from hitchopt.objects import SolidObject
from hitchopt.planners.carrying.holds import GripHold, HoldingHitch
from hitchopt.planners.carrying.moves import Move, SmoothLaw
from hitchopt.planners.carrying.polygons import HoldPolygons
from hitchopt.values import Array

LIFT_SPEED, BELOW_RIM = 0.1, 0.01
"""Vertical speed with an object and toward its rim [m/s]; depth of cables below a rim in addition
to ``separation.object`` [m]."""

CARRY_ACCELERATION, LIFT_ACCELERATION = 1.0, 0.3
"""[m/s²] Largest accelerations of objects: carried, and lifted or set down."""

CARRY_CHECKS = ("equilibrium", "grip", "separation", "crossing", "object_clearance")
"""Checks to which moves of a carried object are slowed down."""

LOAD_LAW = SmoothLaw(0.75)
"""Law of changes of tensions, of friction feed-forward, and of weight from support to clasps."""

MIN_PATH = 1e-6  # [m] Length of paths up to which clasps do not move

MAX_SLOWINGS, SLOWING_FACTOR = 5, 1.5
"""Maximum number of slowings of a move, and factor of a slowing if the required one is unknown."""

OPENING_TENSIONS = (0.3, 0.6)
"""[N] Candidate tensions for opening grips. With low tensions cables hold each other less, but sag
more. The first one is also the lowest for closing, if edges would push the object."""

FRICTION_SHARES, FEEDFORWARD_CHECKS = (0.9, 0.6, 0.3, 0.0), ("separation", "cable_length")
"""Candidate friction feed-forwards of closing and opening, as shares of clasp friction, in order of
preference, and checks that reject them: the sag of edges jumps at other corners."""

MAX_RESIDUAL_GRIP, MAX_PUSH = 0.5, 0.9
"""Largest residual slip load of an open hitch over the weight, and largest push of edges on a
standing object over the friction with its support."""


@dataclass(frozen=True, eq=False)
class GraspState:
    """An object that a hitch encloses or holds."""

    object: str  # its name
    polygons: HoldPolygons  # of the hitch, in the object's frame
    tension: Array  # (n,) [N], of cables from grasping to loosening
    hold: HoldingHitch | None = None  # the hitch that holds it; None while it only encloses it
    carried: bool = False  # whether clasps carry its weight


def one_phase(
    parts: Sequence[Motion],
    requirements: Requirements,
    step: int,
    name: str,
    hold: PhaseHold | None = None,
) -> Motion:
    """Return consecutive motions as one phase of a step, with all remarks."""
    motion = concatenated([each.replaced(requirements=requirements) for each in parts])
    pulls, tension = motion.tensions.coefficients, None
    if np.any(pulls != motion.team.tension[:, None]):
        tension = float(np.min(pulls)), float(np.max(pulls))
    remark = "; ".join(dict.fromkeys(each.remark for each in motion.phases if each.remark))
    phase = Phase(name, step, 0.0, motion.duration, remark, tension=tension, hold=hold)
    return replace(motion, phases=(phase,))


def first_violated(motion: Motion, checks: Sequence[str]) -> Check | None:
    """Return the first check, of these names, that a motion violates; None if all hold."""
    with value_cache():
        results = filter(None, (RULE_OF[name].check(motion) for name in checks))
        return next((check for check in results if not check.holds), None)


@dataclass(frozen=True, eq=False)
class MovePlanner:
    """A planner of moves of a hitch with the object that it holds."""

    state: GraspState  # initial state of the grasp
    requirements: Requirements  # limits, and objects at their current positions
    step: int  # index of the step in its mission

    @property
    def hold(self) -> HoldingHitch:
        """The hitch with the object; raises InputError without one."""
        if (hold := self.state.hold) is None:
            raise InputError("object", self.state.object, "one that is held", "grasp it before")
        return hold

    @property
    def grip(self) -> GripHold:
        """The hitch that grips the object; raises InputError for another hold."""
        hold = self.hold
        if not isinstance(hold, GripHold):
            raise InputError("by", hold.by, "grip where cables close around it", "rest it instead")
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
        phase = Phase(name, self.step, 0.0, 1.0, remark, hold=hold)
        parts = [self.hold.motion(move, self.requirements, phase) for move in moves]
        return one_phase(parts, self.requirements, self.step, name, hold)

    def move(self, law: SmoothLaw, **changes: Any) -> Move:
        """Return a move from the state with the given changes."""
        place, share = self.body.place, float(self.state.carried)
        tensions = changes.pop("tension", (self.state.tension, self.state.tension))
        return replace(Move(place, place, np.stack(tensions), (share, share), law), **changes)

    def rest(self, seconds: float) -> Move:
        """Return a pause [s] as a move."""
        return self.move(SmoothLaw(0.5 * seconds))

    def transfer(self, before: float, after: float) -> Move:
        """Return the move that changes the clasps' fraction of the weight."""
        return self.within_limits(self.move(LOAD_LAW, load_share=(before, after)))

    @property
    def gap(self) -> float:
        """Depth of cables below a rim without contact [m]."""
        return self.requirements.separation.object + BELOW_RIM

    def retension(self, before: Array, after: Array) -> list[Move]:
        """Return the move that changes tensions (n,) [N] below the rim, if they differ."""
        if np.array_equal(before, after):
            return []
        move = self.move(LOAD_LAW, tension=(before, after), below=(self.gap, self.gap))
        return [self.within_limits(move)]

    def rim_move(self, before: float, after: float) -> Move:
        """Return the move between two depths below the rim [m], one of which is 0."""
        law = self._slow_law(max(before, after))
        return self.within_limits(self.move(law, below=(before, after)))

    def _slow_law(self, length: float) -> SmoothLaw:
        """Return the law of a slow motion over a length [m]."""
        limits = self.requirements.limits
        rates = LIFT_SPEED, 0.5 * limits.acceleration, 0.5 * limits.jerk
        return SmoothLaw.fastest(*(rate / length for rate in rates))

    def carry(self, to: Array, speed: float) -> Move:
        """Return the fastest straight move of the object to (4,) x, y, z [m] and yaw [rad].

        The speed of the object and of the drones about it is at most ``speed`` [m/s]. Raises
        InfeasibleError if it cannot be carried.
        """
        start, hold, limits = self.body.place, self.hold, self.requirements.limits
        length = float(np.linalg.norm((to - start)[:3])) + abs(float(to[3] - start[3])) * hold.reach
        vertical = bool(np.all(start[[0, 1, 3]] == to[[0, 1, 3]]))
        of_object = LIFT_ACCELERATION if vertical else CARRY_ACCELERATION
        acceleration = min(of_object, limits.acceleration, hold.largest_acceleration)
        law = SmoothLaw(0.5)
        if length > 0.0 and acceleration > 0.0:
            top = min(speed, limits.speed, limits.vertex_speed)
            law = SmoothLaw.fastest(top / length, acceleration / length, limits.jerk / length)
        carrying = self.from_state(carried=True)
        return carrying.within_limits(carrying.move(law, start=start, end=to), *CARRY_CHECKS)

    def within_limits(self, move: Move, *checks: str) -> Move:
        """Return a move slowed down to the limits of motion and to some checks, by name."""
        from hitchopt.planners.timing.timed_motion import needed_stretch

        for _ in range(MAX_SLOWINGS):
            try:
                motion = self.motion([move])
                factor = needed_stretch(motion)
                if factor <= 1.0 and first_violated(motion, checks):
                    factor = math.inf
            except InfeasibleError:
                if not checks:
                    raise
                factor = math.inf
            if factor == math.inf and checks:
                factor = SLOWING_FACTOR
            if not 1.0 < factor < math.inf:
                break
            move = replace(move, law=move.law.slowed(1.01 * factor))
        return move

    # Grips.

    def close_grip(self, before: Array, name: str) -> Motion:
        """Return the motion from around the object, with tensions (n,) [N], to the grip."""
        return self._passage((before, self.state.tension), (0.0, 1.0), name)[0]

    def draw_grip(self, after: Array) -> list[Motion]:
        """Return the motions that draw cables to the grip as they were tied, and raise tensions.

        The tension stays as it is until they grip, and rises to ``after`` (n,) [N] then.
        """
        before = self.state.tension
        motions = [self._passage((before, before), (0.0, 1.0), "draw")[0]]
        if np.any(before != after):
            motions.append(self.motion([self.move(LOAD_LAW, tension=(before, after))], "tighten"))
        return motions

    def open_grip(self, after: Array, name: str) -> Motion:
        """Return the motion from the grip to around the object, with tensions (n,) [N].

        Raises InfeasibleError if clasps would stick with too large a residual grip.
        """
        motion, moves = self._passage((self.state.tension, after), (1.0, 0.0), name)
        hold, layout, body = self.hold, self.hold.team.layout, self.body
        if hold.team.robots == 2:  # whose clasps are untied before they leave
            return motion
        last = [move for move in moves if move.closure[0] > move.closure[1]][-1]
        end = hold.curves(last, np.array([last.law.duration]))
        legs = (end["drones"] - end["vertices"][:, layout.anchors])[0, :, :2]
        pairs = np.stack([legs[2 * layout.ahead], legs[2 * layout.behind + 1]], axis=1)
        residual = residual_grip(pairs, last.tension[1], hold.team.cable_friction, body.friction)
        limit = MAX_RESIDUAL_GRIP * body.mass * GRAVITY
        if residual > limit:
            where, when = (f"objects.{self.state.object}",), "left as clasps stick"
            remedy = (
                "use smoother cables (team.cable_friction), longer ones, or a hitch tied larger"
            )
            violation = Violation("grip", residual, limit, "max", "N", where, when, remedy)
            raise InfeasibleError([violation])
        return motion

    def _passage(
        self, tension: tuple[Array, Array], closure: tuple[float, float], name: str
    ) -> tuple[Motion, list[Move]]:
        """Return the motion that closes or opens a hitch, and its moves.

        Tensions are so low that edges do not displace the object. ``tension`` (n,) [N] and
        ``closure`` of the hitch are those before and after.
        """
        hold, opens = self.grip, closure[0] > closure[1]
        friction, errors = bool(hold.team.cable_friction), list[InfeasibleError]()
        tensions = self._passage_tensions(hold, opens)
        for between, share in product(tensions, FRICTION_SHARES if friction else (0.0,)):
            ends = (tension[0], between, closure[0]), (between, tension[1], closure[1])
            first, last = (
                [self.move(LOAD_LAW, tension=(p, q), closure=(at, at))] if np.any(p != q) else []
                for p, q, at in ends
            )
            remark = f"legs lean against {share:.0%} of clasp friction" if friction else ""
            try:
                planner = self.from_state(tension=between)
                passage = planner.closure_moves(hold, *closure, -share if opens else share)
                moves = [*first, *passage, *last]
                motion = self.motion(moves, name, remark)
            except InfeasibleError as error:  # legs cannot pull so much harder
                errors.append(error)
                continue
            check = first_violated(motion, FEEDFORWARD_CHECKS)
            if check is None:
                return motion, moves
            when = (
                f"as the hitch {'opens' if opens else 'closes'} around objects.{self.state.object}"
            )
            remedy = "use lighter cables or other lengths of them, or smooth the outline"
            errors.append(InfeasibleError([check.violation(when, remedy)]))
        raise errors[0]

    def _passage_tensions(self, hold: GripHold, opens: bool) -> list[Array]:
        """Return tensions (n,) [N] with which edges do not displace the object in the passage."""
        tension, body = self.state.tension, self.body
        limit = MAX_PUSH * body.friction * body.mass * GRAVITY
        low, high = (np.minimum(tension, each) for each in OPENING_TENSIONS)
        reduced = tension * min(1.0, limit / max(hold.largest_push(tension), 1e-9))
        candidates = (low, high) if opens else (tension, np.maximum(low, reduced))
        tensions = [each for each in candidates if hold.largest_push(each) <= limit * (1.0 + 1e-9)]
        if not tensions:
            name, push = f"objects.{self.state.object}", hold.largest_push(low)
            remedy = f"give it more weight, or raise {name}.friction"
            when = "on its support, which its edges push it along"
            raise InfeasibleError(
                [Violation("grip", push, limit, "max", "N", (name,), when, remedy)]
            )
        return tensions

    def closure_moves(
        self, hold: GripHold, start: float, end: float, share: float
    ) -> Iterator[Move]:
        """Yield the moves from one closure to another, with friction feed-forward in between."""
        if share:
            yield self.move(LOAD_LAW, closure=(start, start), friction_share=(0.0, share))
        closures = np.unique([start, *hold.events, end])
        for one, other in pairwise((closures if start < end else closures[::-1]).tolist()):
            path = hold.travel * abs(other - one)
            # Clasps that are tied where they grip do not move, but their drones may
            law = self._slow_law(path) if path > MIN_PATH else LOAD_LAW
            move = self.move(law, closure=(one, other), friction_share=(share, share))
            yield self.within_limits(move)
        if share:
            yield self.move(LOAD_LAW, closure=(end, end), friction_share=(share, 0.0))


MAX_SLOPE = 0.065
"""Weight at a clasp over the tension with which cables are tied by default. The length that sags
jumps at corners of objects, by a tenth of a millimetre at this slope."""

MIN_TENSION = 0.15  # [N] Smallest default of that tension, unless the team's is smaller


def tying_tension(team: Team) -> float:
    """Return the tension [N] with which cables are tied if the problem states none."""
    weight = 0.25 * GRAVITY * team.cable_density * float(np.max(team.cable_length))
    return min(max(weight / MAX_SLOPE, MIN_TENSION), float(np.min(team.tension)))


def check_pull(tension: float, team: Team, requirements: Requirements) -> None:
    """Raise InfeasibleError for a horizontal pull [N] that no drone can hold."""
    limit, binding = team.quadrotor[0].level_pull(requirements.limits.tilt)
    if tension <= limit:
        return
    remedy = f"grasp with a tension of {limit:.3g} N or less"
    if binding == "tilt":
        tilt = np.degrees(requirements.limits.tilt)
        needed = np.ceil(np.degrees(np.arctan(tension / (GRAVITY * team.mass[0])))) + 5
        raised = f"limits.tilt_deg of {needed:.0f}, above {tilt:.3g}"
        remedy = f"level pulls of {tension:.3g} N need {raised}; or {remedy}"
    violation = Violation(binding, tension, limit, "max", "N", (), "to grip at rest", remedy)
    raise InfeasibleError([violation])


OPENING_DISTANCE = 0.02
"""[m] Outward motion from which on a clasp counts as opening; positions may err by 1 cm."""


def check_opens(hitch: Hitch, around: Array, requirements: Requirements, remedy: str) -> None:
    """Raise InfeasibleError if friction prevents legs from opening a hitch.

    A clasp opens if its legs, at an angle β, pull outward harder than its edges pull inward:
    ``cos(β/2) > e^{μ θ} cos(β_edges/2)``, where μ is the friction between cables and θ the angle by
    which they turn, the mean of both angles. β is smallest if the two drones are side by side.

    Parameters
    ----------
    hitch: before it opens.
    around: (n, 2) [m], goals of its vertices, about any centre.
    requirements: the distance of drones.
    remedy: alternative to smoother cables, for the message.
    """
    friction, layout = hitch.team.cable_friction, hitch.team.layout
    if friction == 0.0 or np.any(hitch.roll):
        return
    vertices = hitch.polygon.vertices
    ahead, behind = (unit(np.roll(vertices, shift, axis=0) - vertices) for shift in (-1, 1))
    moved = (around - np.mean(around, axis=0)) - (vertices - np.mean(vertices, axis=0))
    opens = -np.sum(unit(ahead + behind) * moved, axis=1) > OPENING_DISTANCE
    edges = np.arccos(np.clip(np.sum(ahead * behind, axis=1), -1.0, 1.0))
    d, e = hitch.legs[layout.ahead, 0], hitch.legs[layout.behind, 1]
    distance = 2.0 * requirements.separation.radius
    legs = np.arccos(np.clip((d**2 + e**2 - distance**2) / (2.0 * d * e), -1.0, 1.0))
    turns, log_ratio = 0.5 * (edges + legs), np.log(np.cos(0.5 * legs) / np.cos(0.5 * edges))
    utilization = np.where(opens, np.exp(friction * turns - log_ratio), 0.0)
    worst = int(np.argmax(utilization))
    if utilization[worst] <= 1.0:
        return
    where, ratio = (hitch.team.point_names[layout.clasps[worst]],), float(utilization[worst])
    smoother = log_ratio[worst] / turns[worst]
    if smoother > 0.0:
        smoother = math.floor(1000.0 * smoother) / 1000.0
        remedy = f"{remedy}, or use smoother cables, team.cable_friction {smoother:.3g} or less"
    when = "as the hitch opens"
    violation = Violation("equilibrium", ratio, 1.0, "max", "ratio", where, when, remedy)
    raise InfeasibleError([violation])
