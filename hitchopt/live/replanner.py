"""Steering: a hitch that moves is given new goals, and every answer is certified.

The path is in closed form. The polygon's mean point, its shape as seen from a frame that turns with
it, and the split of the cables' slack are sums of two curves: a *brake*, the quartic with the least
jerk that comes to rest in a given time wherever that is, and a *shift*, the quintic from rest to
rest that leads from there to the goal. The longer the shift takes the less it adds, so that the sum
keeps every limit that the brake keeps with something to spare. The frame turns from rest to rest,
so that a hitch that is to be turned keeps its shape. Drones follow from these flat outputs.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from hitchopt.checks import Certificate, certify
from hitchopt.errors import InfeasibleError, InputError, OneLine, UnsupportedError
from hitchopt.geometry import Outline
from hitchopt.hitch import GRAVITY, Hitch, Team
from hitchopt.hitch.hitch import cable_slack, checked_polygon
from hitchopt.hitch.model import DroneJets, FlatJets, drone_jets
from hitchopt.hitch.requirements import Arena, Limits, Requirements, Separation
from hitchopt.hitch.slack_split import LIMIT_MARGIN, LegTask, split_slack
from hitchopt.motion.motion import Motion, Phase
from hitchopt.motion.retiming import append_motion, before, cut, resting, with_last_poses
from hitchopt.plan import Plan
from hitchopt.planners.morph import jets
from hitchopt.steps.certified_motions import infeasible_error, rest_motion
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.trajectory.search import rough_bounds
from hitchopt.values import Array, check_instance, finite, integer, nonnegative, points

# Least time that is flown of a piece of the present plan: derivatives of shorter pieces suffer from
# rounding [s]
LEAST = 1e-3
HOLD = 1.0  # rest with which steering begins [s]
SAME_STATE = 1e-6  # largest distance of drones from where the team's tensions put them [m]
WAITS = (0.0, 0.05, 0.1, 0.2, 0.4)  # how long the old plan is flown on first [s]

# Length of the pieces of the brake [s], which is as quick as limits allow; number of pieces of a
# shift where they are no shorter, so that a cable's length is right within 1e-6 of it; least number
PIECE, PIECES, FEWEST = 0.3, 10, 4

JET, STATE = 4, 3  # numbers of derivatives of a jet and of a state, the zeroth included
BRAKES = (0.3, 0.45, 0.7, 1.0, 1.5, 2.2, 3.2)  # durations of the brake that are tried [s]
SHORTEST = 0.3  # shortest shift [s]
SIDE = 1e-9  # share of a duration by which one-sided derivatives are taken inside of it

# Shares of the limits that are used at samples, by the brake alone and by the whole, and to which
# that is prolonged; the rest is for what is between samples
BRAKE_SHARE, SHARE, AIM = 0.9, 0.99, 0.989

# Samples over the duration, of the whole and of a brake
PLACES = np.linspace(0.0, 1.0, 16, endpoint=False)
BRAKE_PLACES = np.append(np.linspace(0.0, 1.0, 8, endpoint=False), 1.0 - SIDE)

# Maximum number of times that a shift is prolonged, and the least factor by which it is
SHIFT_ROUNDS, GROWTH = 10, 1.04


@dataclass(frozen=True, eq=False)
class Retarget(OneLine):
    """Answer of a replanner.

    Attributes
    ----------
    accepted: whether the hitch flies to the new goal; if not, all goes on as before.
    start: time at which the new plan leaves the old one [s].
    motion: what flies now, from the beginning of steering.
    ahead: the part from the last break before ``start`` on, t = 0 there; of a refusal the motion.
    certificate: of ``ahead``, all checks; quantities without a limit are in that of ``plan``.
    reason: of a refusal, in words.
    """

    accepted: bool
    start: float
    motion: Motion
    ahead: Motion
    certificate: Certificate
    reason: str = ""

    def _parts(self) -> Iterator[str]:
        yield "accepted" if self.accepted else f"refused: {self.reason}"
        yield f"from t = {self.start:.4g} s, until {self.motion.duration:.4g} s"

    @cached_property
    def plan(self) -> Plan:
        """The whole plan, the old one until ``start``, with a full certificate of its own."""
        return Plan(self.motion, certify(self.motion), "Steered")


class NotNowError(Exception):
    """A retarget cannot begin at this time."""


class Replanner(OneLine):
    """A hitch that is steered: it is given new goals while it moves.

    Times are those since steering began. From a moving state positions, velocities and
    accelerations go on without a jump. What was flown until then stays as it is.

    Parameters
    ----------
    team: with cables that have no weight and clasps that carry none.
    start: the hitch at t = 0, or a plan that is being flown.
    limits, separation, arena: what plans must satisfy; None for the plan's, or the defaults.

    Raises
    ------
    InputError: a start of another team, or one that ends without a hitch.
    InfeasibleError: the start breaks a limit at rest.
    UnsupportedError: cables with weight, or loads.
    """

    def __init__(
        self,
        team: Team,
        start: Hitch | Plan,
        *,
        limits: Limits | None = None,
        separation: Separation | None = None,
        arena: Arena | None = None,
    ) -> None:
        check_instance("team", team, Team)
        check_instance("start", start, Hitch, Plan)
        options: dict[str, Any] = {"limits": limits, "separation": separation, "arena": arena}
        for (key, value), kind in zip(options.items(), (Limits, Separation, Arena), strict=True):
            check_instance(key, value, kind, type(None))
        if isinstance(start, Plan):
            start.motion.refuse_several("a replanner")
            motion, goal = start.motion, start.end
        else:
            phase = Phase("hold", 0, 0.0, HOLD)
            motion, goal = rest_motion(start, Requirements(), HOLD, phase), start
        own = motion.team
        if own.drone_names != team.drone_names or np.any(own.cable_length != team.cable_length):
            raise InputError("start", start, "of the same team", "give the team of the start")
        if team.cable_density > 0.0 or np.any(team.load):
            raise UnsupportedError("steering plans cables without weight and clasps without load")
        changed = {key: value for key, value in options.items() if value is not None}
        self.requirements = replace(motion.requirements, **changed)
        self.motion, self._goal = replace(motion, requirements=self.requirements), goal
        self._limits = limits = self.requirements.with_reserve.limits
        if limits.body_rate is not None:  # with a jerk that turns a hovering drone so fast
            self._limits = replace(limits, jerk=min(limits.jerk, GRAVITY * limits.body_rate))
        self._certificate = certify(self.motion, reports=())
        with suppress(InfeasibleError):  # loads the solver before the first goal is given
            self._end(self._goal.polygon, self._goal.altitude)
        if not self._certificate.certified:
            raise infeasible_error(self._certificate, self.motion)

    def _parts(self) -> Iterator[str]:
        yield f"{self.motion.team.drones} drones"
        yield f"until {self.motion.duration:.4g} s"

    @property
    def goal(self) -> Hitch:
        """The hitch in which the present plan ends."""
        return self._goal

    @property
    def plan(self) -> Plan:
        """The present plan from the beginning of steering, with its full certificate."""
        return Plan(self.motion, certify(self.motion), "Steered")

    def retarget(
        self,
        polygon: Outline | ArrayLike | None = None,
        *,
        vertex: int | None = None,
        to: ArrayLike | None = None,
        yaw: float = 0.0,
        at: float,
    ) -> Retarget:
        """Return the answer to a new goal, and fly there if it is accepted.

        Parameters
        ----------
        polygon: where the vertices go, (points, 2) [m], clockwise.
        vertex: the one that goes ``to`` (2,) [m], all others to the present goal.
        to: without ``vertex``, (3,) [m], where the centroid of the present goal goes.
        yaw: by how much that is turned about its centroid [rad].
        at: time at which the present plan is to be left [s]; where the limits do not allow that,
            up to 0.4 s later.

        Raises
        ------
        InputError: not exactly one goal, or one that is wrong in itself.
        """
        at = nonnegative("at", at)
        goal = self._requested(polygon, vertex, to, yaw)
        refusal = ""
        for wait in WAITS:
            try:
                answer, self._goal = self._planned(*goal, at + wait)
            except NotNowError as late:
                refusal = refusal or str(late)
                continue
            except InfeasibleError as error:
                refusal = str(error)
                break
            self.motion, self._certificate = answer.motion, answer.certificate
            return answer
        return Retarget(False, at, self.motion, self.motion, self._certificate, refusal)

    def _requested(
        self,
        polygon: Outline | ArrayLike | None,
        vertex: int | None,
        to: ArrayLike | None,
        yaw: float,
    ) -> tuple[Outline, float, float]:
        """Return outline, altitude and yaw of the requested goal."""
        goal, team, own, yaw = self._goal, self.motion.team, self._goal.polygon, finite("yaw", yaw)
        given = polygon is not None, vertex is not None, to is not None
        kinds = [(True, False, False), (False, True, True), (False, False, True)]
        if given not in kinds or (yaw != 0.0 and given != kinds[-1]):
            remedy = "give a polygon; or a vertex and to; or to alone, (3,), and a yaw"
            raise InputError("polygon", polygon, "exactly one goal", remedy)
        if polygon is not None:
            return checked_polygon(team, polygon), goal.altitude, 0.0
        if vertex is not None:
            moved = own.vertices.copy()
            k = integer("vertex", vertex, 0, len(moved) - 1)
            moved[k] = points("to", [to], (1, 2), "a point [x, y]", "give two numbers [m]")[0]
            return checked_polygon(team, moved), goal.altitude, 0.0
        place = points("to", [to], (1, 3), "a point [x, y, z]", "give three numbers [m]")[0]
        c, s = math.cos(yaw), math.sin(yaw)
        turned = (own.vertices - own.centroid) @ np.array([[c, s], [-s, c]]) + place[:2]
        return checked_polygon(team, turned), float(place[2]), yaw

    def _planned(
        self, outline: Outline, altitude: float, yaw: float, at: float
    ) -> tuple[Retarget, Hitch]:
        """Return the answer of a plan that leaves the present one at a time, and its goal."""
        past = self._past(at)
        still = self._still(past)
        brake = still.brake(self._limits)
        if brake is None:
            raise NotNowError(f"from t = {past.duration:.4g} s: no brake keeps all limits")
        recent = cut(past, past.drones.pieces - 1, past.drones.pieces)
        end = self._end(outline, altitude)
        path = RetargetPath.to(past.team, still.state, end, yaw)
        shift = path.shortest_shift(self._limits, brake)
        if shift is None:
            raise InfeasibleError([], "no duration keeps all limits on the way to the goal")
        phase = Phase("retarget", past.phases[-1].step + 1, 0.0, max(brake, shift))
        breaks = _breaks(brake if path.state.moves else 0.0, shift)
        drones, vertices, legs, tensions = path.curves(breaks, brake, shift)
        fresh = Motion(path.team, self.requirements, drones, vertices, legs, tensions, (phase,))
        fresh = with_last_poses(past, fresh)
        ahead = append_motion(recent, fresh)
        certificate = _certificate(ahead)
        if not certificate.certified:
            raise infeasible_error(certificate, ahead)
        return Retarget(True, past.duration, append_motion(past, fresh), ahead, certificate), end

    def _end(self, outline: Outline, altitude: float) -> Hitch:
        """Return the hitch of a goal, its slack split as now where limits allow that."""
        team, need = self.motion.team, self.requirements
        slack = cable_slack(team, outline)
        wanted = team.layout.q_legs_of(self._goal.fractions * slack, slack)[None]
        shortest = LIMIT_MARGIN * need.limits.leg
        task = LegTask(team, need, outline.vertices[None], wanted, shortest, LIMIT_MARGIN)
        return Hitch(team, outline, altitude, split_slack(task, first=True).q_legs[0])

    def _past(self, at: float) -> Motion:
        """Return the present plan until a time, resting after its end."""
        duration, breaks = self.motion.duration, self.motion.drones.breaks
        if at > duration + LEAST:
            phase = replace(self.motion.phases[-1], name="hold", remark="")
            return append_motion(self.motion, resting(self.motion, at - duration, phase))
        if at > duration - 1e-6:
            return self.motion
        piece = max(int(np.searchsorted(breaks, at - 1e-9)) - 1, 0)
        first, last = breaks[piece : piece + 2].tolist()
        return before(self.motion, max(at, min(first + LEAST, last)))

    def _still(self, past: Motion) -> RetargetPath:
        """Return the path that ends where a motion does, from the state there."""
        when = f"at t = {past.duration:.4g} s"
        if not past.phases[-1].formed or past.phases[-1].hold is not None:
            why = "an object is held" if past.phases[-1].formed else "there is no hitch"
            raise NotNowError(f"{when} {why}")
        state = MovingState.at_end(past)
        away = np.abs(past.tensions.coefficients[-1, :, -1] - past.team.tension)
        still = RetargetPath(past.team, state, state.vertices[..., 0], state.fractions[:, 0])
        model = still.jets(np.zeros(1), 1.0, None)[1].positions[0, ..., 0]
        if away.max() > SAME_STATE or np.abs(model - state.drones[..., 0]).max() > SAME_STATE:
            raise NotNowError(f"{when} legs lean, are rolled, or do not have the team's tensions")
        return still


def _certificate(ahead: Motion) -> Certificate:
    """Return the certificate of the motion ahead, with bounds that are computed quickly."""
    with rough_bounds():
        return certify(ahead.untimed, reports=())


def _breaks(brake: float, shift: float) -> Array:
    """Return the breaks: the ends [s] of brake and shift, and more in between."""
    least = min(PIECE, max(brake, shift) / FEWEST)
    later, parts = max(least, shift / PIECES), [np.zeros(1)]
    for start, end in pairwise([0.0, *sorted((brake, shift))]):
        piece = least if end <= brake else later
        count = math.ceil((end - start) / piece * (1.0 - 1e-9))
        parts.append(np.linspace(start, end, count + 1)[1:])
    return np.concatenate(parts)


@dataclass(frozen=True, eq=False)
class MovingState:
    """A hitch in motion: values with their first two derivatives by time."""

    vertices: Array  # (points, 3, 3) [m]
    fractions: Array  # (n, 3), ``d_k / (d_k + e_k)``
    drones: Array  # (2n, 3, 3) [m]
    legs: Array  # (n, 2, 3) [m]

    @classmethod
    def at_end(cls, motion: Motion) -> MovingState:
        """Return the state in which a motion ends."""
        legs, layout = motion.legs.end_jet(STATE), motion.team.layout
        slack = legs[:, 0] + legs[:, 1]
        free = ~np.all(layout.has_leg, axis=1) & (slack[:, 0] <= 0.0)
        slack[free, 0] = 1.0  # of cables at a chain's ends that have no leg at all
        fractions = jets.product(legs[:, 0], jets.reciprocal(slack))
        return cls(motion.vertices.end_jet(STATE), fractions, motion.drones.end_jet(STATE), legs)

    @property
    def moves(self) -> bool:
        """Whether anything moves or accelerates."""
        return bool((np.abs(self.drones[..., 1:]) > 1e-9).any())


@dataclass(frozen=True, eq=False)
class RetargetPath:
    """Flat outputs from a moving state to a hitch at rest."""

    team: Team
    state: MovingState
    end: Array  # vertices (points, 3) [m] at rest
    fractions: Array  # (n,), shares of the slack at rest
    yaw: float = 0.0  # angle by which the frame turns [rad]

    @classmethod
    def to(cls, team: Team, state: MovingState, end: Hitch, yaw: float) -> RetargetPath:
        """Return the path to a hitch, full turns chosen to come closest to a yaw [rad].

        Its frame turns by what is left from the state to the hitch, also where the state has not
        finished an earlier turn: on straight lines to the goal a half-turned polygon would shrink.
        """
        vertices = end.vertices
        left = _turn(state.vertices[:, :2, 0], vertices[:, :2])
        left += 2.0 * math.pi * round((yaw - left) / (2.0 * math.pi))
        return cls(team, state, vertices, end.fractions, left)

    @cached_property
    def _ends(self) -> tuple[Array, Array]:
        """Mean point, shape about it, fractions, turn: (m, 3) at the start, (m,) in the end."""
        centre, goal = self.state.vertices.mean(axis=0), self.end.mean(axis=0)
        shape = (self.state.vertices - centre).reshape(-1, STATE)
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        back = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        first = (centre, shape, self.state.fractions, np.zeros((1, STATE)))
        last = (goal, ((self.end - goal) @ back).ravel(), self.fractions, [self.yaw])
        return np.concatenate(first), np.concatenate(last)

    def jets(self, t: Array, brake: float | Array, shift: float | None) -> tuple[Array, DroneJets]:
        """Return the jets of vertices (J, points, 3, 4) and of drones at times t (J,) [s].

        ``brake``, also one a time (J,), and ``shift`` are durations [s]; no shift leads to where
        the brake does.
        """
        team, layout = self.team, self.team.layout
        start, goal = self._ends
        slowed = np.broadcast_to(brake, t.shape)
        rest = np.stack([np.ones(len(t)), 0.5 * slowed, slowed**2 / 12.0], axis=1) @ start.T
        each = _to_rest(start, rest, slowed, t)
        if shift is not None:
            each += _to_rest(np.zeros(start.shape), goal - rest, np.full(len(t), shift), t)
        centre, split = each[:, :3], each[:, 3 + 3 * layout.points : -1]
        shape = each[:, 3 : 3 + 3 * layout.points].reshape(len(t), layout.points, 3, JET)
        vertices = centre[:, None] + (_turned(shape, each[:, -1]) if self.yaw != 0.0 else shape)
        edges = layout.edges(vertices, axis=1)
        slack = -jets.square_root(np.sum(jets.product(edges, edges), axis=2))
        slack[..., 0] += team.cable_length
        wanted, orders = jets.product(split, slack), np.moveaxis(slack, -1, 0)
        q_legs = np.moveaxis(layout.q_legs_of(np.moveaxis(wanted, -1, 0), orders), 0, -1)
        tensions = np.zeros((len(t), team.robots, JET))
        tensions[..., 0] = team.tension
        return vertices, drone_jets(team, FlatJets(vertices, q_legs, tensions))

    def curves(self, breaks: Array, brake: float, shift: float) -> list[PiecewisePolynomial]:
        """Return a motion's four polynomials, which meet the state itself at their start."""
        count, h = len(breaks) - 1, SIDE * (breaks[1:] - breaks[:-1])
        sides = np.concatenate([breaks[:-1] + h, breaks[1:] - h])
        vertices, drones = self.jets(sides, brake, shift)
        legs = drones.legs * self.team.layout.has_leg[..., None]
        starts = (self.state.drones, self.state.vertices, self.state.legs)
        each = [part.reshape(2 * count, -1, JET) for part in (drones.positions, vertices, legs)]
        orders = np.moveaxis(np.concatenate(each, axis=1), -1, 0)
        left, right = orders[:, :count], orders[:, count:]
        left[:STATE, 1:] = right[:STATE, :-1]
        left[:STATE, 0] = np.concatenate([part.reshape(-1, STATE) for part in starts]).T
        right[1:STATE, -1] = 0.0
        both = PiecewisePolynomial.hermite(breaks, left, right)
        curves, points, leg_curves = both.split([part.shape[:-1] for part in starts])
        pulls = np.repeat(self.team.tension[None, :, None], count, axis=0)
        return [curves, points, leg_curves, both.alike(pulls)]

    def excess(self, limits: Limits, t: Array, brake: float | Array, shift: float | None) -> Array:
        """Return how many times slower a motion would have to be at times (J,) [s], at most.

        Thrust and tilt, which do not scale, count by the square root of their share of the limit.
        At t = 0 only the jerk counts: the state is given.
        """
        points, drones = self.jets(t, brake, shift)
        rates = np.einsum("jdxk,jdxk->kjd", drones.positions, drones.positions).max(axis=2) ** 0.5
        moved = np.linalg.norm(points[..., 1], axis=2).max(axis=1)
        level = np.hypot(drones.thrusts[..., 0], drones.thrusts[..., 1])
        used = np.hypot(level, drones.thrusts[..., 2]) / self.team.max_thrust
        tilt = np.arctan2(level, drones.thrusts[..., 2])
        ratios = [
            rates[1] / limits.speed,
            moved / limits.vertex_speed,
            np.sqrt(rates[2] / limits.acceleration),
            np.sqrt(used.max(axis=1)),
            np.sqrt(tilt.max(axis=1) / limits.tilt),
        ]
        slower = np.maximum(np.max(ratios, axis=0) * (t > 0.0), np.cbrt(rates[3] / limits.jerk))
        most: Array = np.nan_to_num(slower, nan=math.inf, posinf=math.inf)
        return most

    def brake(self, limits: Limits) -> float | None:
        """Return the duration [s] in which the state comes to rest within the limits, or None."""
        if not self.state.moves:
            return BRAKES[0]
        times = np.outer(BRAKES, BRAKE_PLACES)
        each = np.repeat(BRAKES, times.shape[1])
        excess = self.excess(limits, times.ravel(), each, None).reshape(times.shape)
        feasible = np.flatnonzero(excess.max(axis=1) <= BRAKE_SHARE)
        return BRAKES[feasible[0]] if len(feasible) else None

    def shortest_shift(self, limits: Limits, brake: float) -> float | None:
        """Return the duration [s] of a shift that keeps all limits at samples, or None."""
        shift = SHORTEST
        for _ in range(SHIFT_ROUNDS):
            last = np.array([brake, shift]) * (1.0 - SIDE)
            times = np.concatenate([max(shift, brake) * PLACES, last])
            excess = float(self.excess(limits, times, brake, shift).max())
            if excess <= SHARE:
                return shift
            if not math.isfinite(excess):
                return None
            shift *= max(excess / AIM, GROWTH)
        return None


def _to_rest(start: Array, rest: Array, duration: Array, t: Array) -> Array:
    """Return the jets (J, m, 4) of quintics from a state (m, 3) to rest at places (J, m).

    Each time t (J,) has a quintic of its own, of a duration (J,) [s].
    """
    (p, v, a), h = start.T, duration[:, None]
    inner = p + h / 5.0 * v, p + h * (0.4 * v + h / 20.0 * a)
    curves = np.stack(np.broadcast_arrays(p, *inner, rest, rest, rest), axis=-1)
    weights = bernstein.jet_basis(np.minimum(t / duration, 1.0), 5, JET)
    weights[t >= duration, :, 1:] = 0.0
    result: Array = curves @ (weights / h[..., None] ** np.arange(JET))
    return result


def _turned(shape: Array, angle: Array) -> Array:
    """Return the jets of shapes (J, points, 3, 4) turned by angles with jets (J, 4)."""
    c, s = np.cos(angle[:, 0]), np.sin(angle[:, 0])
    outer = np.stack([[c, -s, -c, s], [s, c, -s, -c]])  # derivatives of cosine and sine
    around = jets.chained(np.moveaxis(outer, 2, 0), angle[:, None])
    # (J, points, 2, 2, 4): cosine and sine times x and y.
    parts = jets.product(around[:, None, :, None], shape[:, :, None, :2])
    turned = shape.copy()
    turned[:, :, 0] = parts[:, :, 0, 0] - parts[:, :, 1, 1]
    turned[:, :, 1] = parts[:, :, 1, 0] + parts[:, :, 0, 1]
    return turned


def _turn(first: Array, last: Array) -> float:
    """Return the angle [rad] by which points (k, 2) about their mean fit the last ones best."""
    x, y = first - first.mean(axis=0), last - last.mean(axis=0)
    return math.atan2(x[:, 0] @ y[:, 1] - x[:, 1] @ y[:, 0], np.vdot(x, y))
