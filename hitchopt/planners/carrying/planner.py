"""Moves of a hitch that takes, carries and lets go of an object, as fast as limits allow."""

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
from hitchopt.errors import InfeasibleError, Violation
from hitchopt.geometry.vectors import unit
from hitchopt.hitch import GRAVITY, Hitch, Team
from hitchopt.hitch.holding import residual_grip
from hitchopt.hitch.requirements import Requirements
from hitchopt.motion import motion as motions
from hitchopt.motion.motion import Motion, Phase, joined_motions
from hitchopt.objects import SolidObject
from hitchopt.planners.carrying.holds import GripHold, Hold
from hitchopt.planners.carrying.moves import Move, SmoothLaw
from hitchopt.planners.carrying.polygons import HoldPolygons
from hitchopt.values import Array

LIFT_SPEED, BELOW_RIM = 0.1, 0.01
"""Vertical speed with an object, and against its rim [m/s]; depth of cables below a rim besides
``separation.object`` [m]."""

CARRY_ACCELERATION, LIFT_ACCELERATION = 1.0, 0.3
"""[m/s²] Largest acceleration of carried objects, and of those that are lifted or set down."""

CARRY_CHECKS = ("equilibrium", "grip", "separation", "crossing")
"""Checks for which a carried object is slowed down."""

LOAD_LAW = SmoothLaw(0.75)
"""Law of changing tensions, of legs that turn to lead, and of weight from support to clasps."""

MAX_SLOWINGS, SLOWER = 5, 1.5
"""Maximum slowings of a move until limits hold; factor of one if the needed one is unknown."""

LOOSE = (0.3, 0.6)
"""[N] Tensions with which grips are opened: the less cables pull, the less they hold each other,
but the more they sag; with the first they are closed if edges would push the object."""

LEADS, LEAD_CHECKS = (0.9, 0.6, 0.3, 0.0), ("separation", "cable_length")
"""Shares of clasp friction that legs overcome while a hitch closes or opens, in order of
preference, and checks that decide. Edges that meet other corners change their sag at once."""

MAX_RESIDUAL_GRIP, MAX_PUSH = 0.5, 0.9
"""Largest share of the weight that a hitch may still grip once it has opened, and of friction with
its support that edges may push a standing object with."""


@dataclass(frozen=True, eq=False)
class GraspState:
    """An object that a hitch is around, or holds.

    Attributes
    ----------
    object: its name.
    polygons: of the hitch, in the object's frame.
    tension: (n,) [N], of cables from grasping to loosening.
    hold: the hitch that holds it; None while it is only around it.
    borne: whether clasps carry its weight.
    """

    object: str
    polygons: HoldPolygons
    tension: Array
    hold: Hold | None = None
    borne: bool = False


def one_phase(
    parts: Sequence[Motion],
    requirements: Requirements,
    step: int,
    name: str,
    hold: motions.Hold | None = None,
) -> Motion:
    """Return motions in a row as one phase of a step, with all remarks; an object may be held."""
    motion = joined_motions([replace(each, requirements=requirements) for each in parts])
    pulls, tension = motion.tensions.coefficients, None
    if np.any(pulls != motion.team.tension[:, None]):
        tension = float(np.min(pulls)), float(np.max(pulls))
    remark = "; ".join(dict.fromkeys(each.remark for each in motion.phases if each.remark))
    phase = Phase(name, step, 0.0, motion.duration, remark, tension=tension, hold=hold)
    return replace(motion, phases=(phase,))


def first_violated(motion: Motion, checks: Sequence[str]) -> Check | None:
    """Return the first of some checks, by name, that a motion violates; None if all hold."""
    with value_cache():
        results = filter(None, (RULE_OF[name].check(motion) for name in checks))
        return next((check for check in results if not check.holds), None)


@dataclass(frozen=True, eq=False)
class MovePlanner:
    """The planner of moves of a hitch with the object that it holds.

    Attributes
    ----------
    state: of the grasp, at first.
    requirements: with the limits to keep and objects where they are.
    step: index of the mission's step.
    """

    state: GraspState
    requirements: Requirements
    step: int

    @property
    def hold(self) -> Hold:
        """The hitch with the object."""
        assert self.state.hold is not None
        return self.state.hold

    @property
    def body(self) -> SolidObject:
        """The object, where it is."""
        return self.requirements.objects[self.state.object]

    def from_state(self, **changes: Any) -> MovePlanner:
        """Return the planner with another state."""
        return replace(self, state=replace(self.state, **changes))

    def motion(self, moves: Sequence[Move], name: str = "", remark: str = "") -> Motion:
        """Return the motion of moves in a row as one phase."""
        cables = tuple(range(self.hold.team.robots))
        hold = motions.Hold(self.state.object, self.hold.by, cables)
        phase = Phase(name, self.step, 0.0, 1.0, remark, hold=hold)
        parts = [self.hold.motion(move, self.requirements, phase) for move in moves]
        return one_phase(parts, self.requirements, self.step, name, hold)

    def move(self, law: SmoothLaw, **changes: Any) -> Move:
        """Return a move from the state with the given changes."""
        place, share = self.body.place, float(self.state.borne)
        pulls = changes.pop("tension", (self.state.tension, self.state.tension))
        return replace(Move(place, place, np.stack(pulls), (share, share), law), **changes)

    def rest(self, seconds: float) -> Move:
        """Return the move of ``seconds`` [s] in which nothing changes."""
        return self.move(SmoothLaw(0.5 * seconds))

    def transfer(self, before: float, after: float) -> Move:
        """Return the move in which shares of the weight pass to the clasps or back."""
        return self.within_limits(self.move(LOAD_LAW, borne=(before, after)))

    @property
    def gap(self) -> float:
        """Depth of cables below a rim that they do not touch [m]."""
        return self.requirements.separation.object + BELOW_RIM

    def retension(self, before: Array, after: Array) -> list[Move]:
        """Return the change of tensions (n,) [N] off the rim, if there is one."""
        if np.array_equal(before, after):
            return []
        move = self.move(LOAD_LAW, tension=(before, after), below=(self.gap, self.gap))
        return [self.within_limits(move)]

    def rim_move(self, before: float, after: float) -> Move:
        """Return the move from one depth below the rim to another [m], one of them 0."""
        law = self._slow_law(max(before, after))
        return self.within_limits(self.move(law, below=(before, after)))

    def _slow_law(self, length: float) -> SmoothLaw:
        """Return the law of a slow motion over a length [m]."""
        limits = self.requirements.limits
        rates = LIFT_SPEED, 0.5 * limits.acceleration, 0.5 * limits.jerk
        return SmoothLaw.fastest(*(rate / length for rate in rates))

    def carry(self, to: Array, speed: float) -> Move:
        """Return the fastest straight move of the object to (4,) x, y, z [m] and yaw [rad].

        The object, and drones about it, move with ``speed`` [m/s] at most. Raises InfeasibleError
        if it cannot be carried.
        """
        start, hold, limits = self.body.place, self.hold, self.requirements.limits
        length = float(np.linalg.norm((to - start)[:3])) + abs(float(to[3] - start[3])) * hold.reach
        vertical = bool(np.all(start[[0, 1, 3]] == to[[0, 1, 3]]))
        gentle = LIFT_ACCELERATION if vertical else CARRY_ACCELERATION
        acceleration = min(gentle, limits.acceleration, hold.largest_acceleration)
        law = SmoothLaw(0.5)
        if length > 0.0 and acceleration > 0.0:
            top = min(speed, limits.speed, limits.vertex_speed)
            law = SmoothLaw.fastest(top / length, acceleration / length, limits.jerk / length)
        lifted = self.from_state(borne=True)
        return lifted.within_limits(lifted.move(law, start=start, end=to), *CARRY_CHECKS)

    def within_limits(self, move: Move, *checks: str) -> Move:
        """Return a move slowed until limits of motion hold, and some checks by name."""
        from hitchopt.planners.timing.flight import needed_stretch

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
                factor = SLOWER
            if not 1.0 < factor < math.inf:
                break
            move = replace(move, law=move.law.slowed(1.01 * factor))
        return move

    # Grips.

    def close_grip(self, before: Array, name: str) -> Motion:
        """Return the motion from around the object, with tensions (n,) [N], to the state's grip."""
        return self._passage((before, self.state.tension), (0.0, 1.0), name)[0]

    def open_grip(self, after: Array, name: str) -> Motion:
        """Return the motion from the state's grip to around the object, with tensions (n,) [N].

        InfeasibleError: clasps would stick and grip too much of the weight.
        """
        motion, moves = self._passage((self.state.tension, after), (1.0, 0.0), name)
        hold, layout, body = self.hold, self.hold.team.layout, self.body
        last = [move for move in moves if move.closed[0] > move.closed[1]][-1]
        end = hold.curves(last, np.array([last.law.duration]))
        legs = (end["drones"] - end["vertices"][:, layout.anchors])[0, :, :2]
        pairs = np.stack([legs[2 * layout.ahead], legs[2 * layout.behind + 1]], axis=1)
        left = residual_grip(pairs, last.tension[1], hold.team.cable_friction, body.friction)
        most = MAX_RESIDUAL_GRIP * body.mass * GRAVITY
        if left > most:
            where, when = (f"objects.{self.state.object}",), "left as clasps stick"
            remedy = (
                "use smoother cables (team.cable_friction), longer ones, or a hitch tied larger"
            )
            raise InfeasibleError([Violation("grip", left, most, "max", "N", where, when, remedy)])
        return motion

    def _passage(
        self, tension: tuple[Array, Array], closed: tuple[float, float], name: str
    ) -> tuple[Motion, list[Move]]:
        """Return the motion that closes or opens a hitch, and its moves.

        Cables pull so that edges do not push the object along. ``tension`` (n,) [N] and ``closed``,
        the closure of the hitch, are before and after.
        """
        hold, opens = self.hold, closed[0] > closed[1]
        assert isinstance(hold, GripHold)
        friction, refusals = bool(hold.team.cable_friction), list[InfeasibleError]()
        tensions, leads = self._gentle_tensions(hold, opens), LEADS if friction else (0.0,)
        for between, lead in product(tensions, leads):
            ends = (tension[0], between, closed[0]), (between, tension[1], closed[1])
            first, last = (
                [self.move(LOAD_LAW, tension=(p, q), closed=(at, at))] if np.any(p != q) else []
                for p, q, at in ends
            )
            remark = f"legs lean against {lead:.0%} of clasp friction" if friction else ""
            try:
                loose = self.from_state(tension=between)
                moves = [*first, *loose._leading(hold, *closed, -lead if opens else lead), *last]
                motion = self.motion(moves, name, remark)
            except InfeasibleError as error:  # legs cannot pull so much harder
                refusals.append(error)
                continue
            broken = first_violated(motion, LEAD_CHECKS)
            if broken is None:
                return motion, moves
            when = (
                f"as the hitch {'opens' if opens else 'closes'} around objects.{self.state.object}"
            )
            remedy = "use lighter cables or other lengths of them, or smooth the outline"
            refusals.append(InfeasibleError([broken.violation(when, remedy)]))
        raise refusals[0]

    def _gentle_tensions(self, hold: GripHold, opens: bool) -> list[Array]:
        """Return tensions (n,) [N] with which edges do not push the object while a hitch passes."""
        pull, body = self.state.tension, self.body
        most = MAX_PUSH * body.friction * body.mass * GRAVITY
        low, high = (np.minimum(pull, each) for each in LOOSE)
        gentle = pull * min(1.0, most / max(hold.largest_push(pull), 1e-9))
        candidates = (low, high) if opens else (pull, np.maximum(low, gentle))
        tensions = [each for each in candidates if hold.largest_push(each) <= most * (1.0 + 1e-9)]
        if not tensions:
            name, push = f"objects.{self.state.object}", hold.largest_push(low)
            remedy = f"give it more weight, raise {name}.friction, or give it a rim"
            when = "on its support, which its edges push it along"
            raise InfeasibleError(
                [Violation("grip", push, most, "max", "N", (name,), when, remedy)]
            )
        return tensions

    def _leading(self, hold: GripHold, start: float, end: float, lead: float) -> Iterator[Move]:
        """Yield moves from one closure to another; legs lead in between."""
        if lead:
            yield self.move(LOAD_LAW, closed=(start, start), lead=(0.0, lead))
        shares = np.unique([start, *hold.events, end])
        for one, other in pairwise((shares if start < end else shares[::-1]).tolist()):
            law = self._slow_law(hold.travel * abs(other - one))
            yield self.within_limits(self.move(law, closed=(one, other), lead=(lead, lead)))
        if lead:
            yield self.move(LOAD_LAW, closed=(end, end), lead=(lead, 0.0))


def check_pull(tension: float, team: Team, requirements: Requirements) -> None:
    """Raise InfeasibleError for a level pull [N] that no drone can hold."""
    most, binding = team.quadrotor[0].level_pull(requirements.limits.tilt)
    if tension <= most:
        return
    remedy = f"grasp with a tension of {most:.3g} N or less"
    if binding == "tilt":
        tilt = np.degrees(requirements.limits.tilt)
        needed = np.ceil(np.degrees(np.arctan(tension / (GRAVITY * team.mass[0])))) + 5
        raised = f"limits.tilt_deg of {needed:.0f}, above {tilt:.3g}"
        remedy = f"level pulls of {tension:.3g} N need {raised}; or {remedy}"
    broken = Violation(binding, tension, most, "max", "N", (), "to grip at rest", remedy)
    raise InfeasibleError([broken])


OUTWARD = 0.02
"""[m] Clasps that move outward by more open: their places are uncertain by a centimetre."""


def check_opens(hitch: Hitch, around: Array, requirements: Requirements, remedy: str) -> None:
    """Raise InfeasibleError if friction keeps legs from opening a hitch.

    A clasp opens if its legs, which enclose β, pull outward harder than its edges do inward:
    ``cos(β/2) > e^{μ θ} cos(β_edges/2)``, μ the cables' friction and θ the mean of both angles, by
    which cables turn. Legs enclose the least angle with their drones side by side.

    Parameters
    ----------
    hitch: before it opens.
    around: (n, 2) [m], goals of its vertices, about any centre.
    requirements: the distance of drones.
    remedy: besides smoother cables.
    """
    friction, layout = hitch.team.cable_friction, hitch.team.layout
    if friction == 0.0 or np.any(hitch.roll):
        return
    here = hitch.polygon.vertices
    ahead, behind = (unit(np.roll(here, shift, axis=0) - here) for shift in (-1, 1))
    moved = (around - np.mean(around, axis=0)) - (here - np.mean(here, axis=0))
    opens = -np.sum(unit(ahead + behind) * moved, axis=1) > OUTWARD
    edges = np.arccos(np.clip(np.sum(ahead * behind, axis=1), -1.0, 1.0))
    d, e = hitch.legs[layout.ahead, 0], hitch.legs[layout.behind, 1]
    apart = 2.0 * requirements.separation.radius
    legs = np.arccos(np.clip((d**2 + e**2 - apart**2) / (2.0 * d * e), -1.0, 1.0))
    turned, reserve = 0.5 * (edges + legs), np.log(np.cos(0.5 * legs) / np.cos(0.5 * edges))
    excess = np.where(opens, np.exp(friction * turned - reserve), 0.0)
    worst = int(np.argmax(excess))
    if excess[worst] <= 1.0:
        return
    where, ratio = (hitch.team.point_names[layout.clasps[worst]],), float(excess[worst])
    smoother = reserve[worst] / turned[worst]
    if smoother > 0.0:
        smoother = math.floor(1000.0 * smoother) / 1000.0
        remedy = f"{remedy}, or use smoother cables, team.cable_friction {smoother:.3g} or less"
    broken = Violation(
        "equilibrium", ratio, 1.0, "max", "ratio", where, "as the hitch opens", remedy
    )
    raise InfeasibleError([broken])
