"""Steering: give a moving hitch new goals, with a certified plan for each.

The path has a closed form. The polygon's mean point, its shape in a frame that rotates with it, and
the split of the cables' slack are sums of two curves: a *brake*, the quartic of minimum jerk that
comes to rest in a given time at a free position, and a *shift*, the quintic from rest to rest that
leads from there to the goal. The contribution of the shift decreases with its duration, so the sum
keeps every limit that the brake keeps with a margin. The frame rotates from rest to rest, so that a
rotated hitch keeps its shape. The drones' trajectories follow from these flat outputs.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from hitchopt.checks import Certificate, certify
from hitchopt.checks.violations import infeasible_error
from hitchopt.errors import InfeasibleError, InputError, OneLine
from hitchopt.geometry import Outline
from hitchopt.geometry.vectors import column_lengths, length, rotated
from hitchopt.hitch import GRAVITY, Hitch, Team
from hitchopt.hitch.hitch import cable_slack, checked_polygon
from hitchopt.hitch.model import DroneJets, FlatJets, drone_jets
from hitchopt.hitch.requirements import Arena, Limits, Requirements, Separation
from hitchopt.hitch.series import Series, chained, product
from hitchopt.hitch.slack_split import LIMIT_MARGIN, LegTask
from hitchopt.motion.flight import Flight
from hitchopt.motion.motion import Motion, Phase
from hitchopt.motion.retiming import append_motion, cut, resting, truncated, with_last_poses
from hitchopt.plan import Plan
from hitchopt.planners.candidates import outcome
from hitchopt.planners.path import cable_along, cables_of_legs
from hitchopt.planners.rests import rest_motion
from hitchopt.support import Feature, Neighbour, refused_value
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.trajectory.piecewise import MIN_SPACING, spaced
from hitchopt.trajectory.search import rough_bounds
from hitchopt.values import Array, check_instance, finite, integer, nonnegative, points
from hitchopt.values.fields import suggest_keywords

HOLD = 1.0  # duration of the rest at the start of steering [s]
STATE_TOLERANCE = 1e-6  # tolerance of the model's drone positions [m] and tensions [N]
DELAYS = (0.0, 0.05, 0.1, 0.2, 0.4)  # candidate delays before leaving the current plan [s]

PIECE = 0.3  # Length of the pieces of a brake [s]
# Number of pieces of a shift unless they are shorter than that, so that relative errors of cable
# lengths are below 1e-6
SHIFT_PIECES = 10
MIN_PIECES = 4  # Minimum number of pieces

JET = 4  # Number of derivatives of a jet, including the zeroth
STATE = 3  # Number of derivatives of a state, including the zeroth
BRAKE_DURATIONS = (0.3, 0.45, 0.7, 1.0, 1.5, 2.2, 3.2)  # candidates [s]
MIN_SHIFT = 0.3  # minimum duration of a shift [s]
ONE_SIDED = 1e-9  # relative distance from a break at which one-sided derivatives are evaluated

# Share of the limits that is allowed at samples for the brake alone; the rest is a margin for the
# times between samples
BRAKE_SHARE = 0.9
SHARE = 0.99  # Fraction of the limits that is allowed at samples for the sum
TARGET_SHARE = 0.989  # Fraction of the limits that is the target of a longer shift

# Relative times of samples, of the sum and of a brake
SAMPLES = np.linspace(0.0, 1.0, 16, endpoint=False)
BRAKE_SAMPLES = np.append(np.linspace(0.0, 1.0, 8, endpoint=False), 1.0 - ONE_SIDED)

SHIFT_ROUNDS = 10  # Maximum number of extensions of a shift
MIN_GROWTH = 1.04  # Minimum factor of each extension


@dataclass(frozen=True, eq=False)
class Retarget(OneLine):
    """Result of a replanner.

    Attributes
    ----------
    accepted: whether the hitch flies to the new goal; if not, the current plan continues.
    start: time at which the new plan leaves the old one [s].
    motion: the current motion from the start of steering.
    ahead: the part from the last break before ``start``, with t = 0 there; ``motion`` if refused.
    certificate: all checks of ``ahead``; quantities without a limit are in that of ``plan``.
    reason: reason of a refusal.
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
        """The whole plan, with its own full certificate; the old plan until ``start``."""
        return Plan(Flight.of(self.motion), certify(self.motion), "Steered")


class _Departure(NamedTuple):
    """The current plan until a time, the path to rest from there, and the brake on it [s]."""

    past: Motion
    stop: RetargetPath
    brake: float


class Replanner(OneLine):
    """A hitch that is steered by new goals while it moves.

    Times start with steering. Positions, velocities and accelerations are continuous. The motion
    before a retarget is not changed.

    Parameters
    ----------
    team: of the hitch.
    start: the hitch at t = 0, or a plan in flight.
    limits, separation, arena: requirements of the plans; None for the plan's, or the defaults. As
        in problems, drones' models and controllers provide what they do not state.

    Raises
    ------
    InputError: the start belongs to another team, or ends without a hitch.
    InfeasibleError: the start violates a limit at rest.
    UnsupportedError: several teams, or other plans, fly.
    """

    @suggest_keywords
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
            motion = start.flight.of_one_team(Feature.REPLANNER)
            if not motion.team.has_cables:
                raise refused_value(Feature.REPLANNER, Neighbour.SINGLE_DRONES, start)
            if not motion.formed[-1]:
                raise refused_value(Feature.REPLANNER, Neighbour.FREE_CABLES, start)
            goal = start.end
        else:
            phase = Phase("hold", 0, 0.0, HOLD)
            motion = rest_motion(start, Requirements(), HOLD, phase)
            goal = start
        flown = motion.team
        has_same_drones = flown.drone_names == team.drone_names
        if not has_same_drones or np.any(flown.cable_length != team.cable_length):
            raise InputError("start", start, "of the same team", "use the team of the start")
        specified = {key: value for key, value in options.items() if value is not None}
        self.requirements = replace(motion.requirements, **specified).flown_by(flown).in_haste
        self.motion = replace(motion, requirements=self.requirements)
        self._goal = goal
        self._limits = self.requirements.with_reserve.limits.of_clocks(GRAVITY)
        self._certificate = certify(self.motion, reports=())
        with suppress(InfeasibleError):  # load the solver before the first goal
            self._end(self._goal.polygon, self._goal.altitude)
        if not self._certificate.certified:
            raise infeasible_error(self._certificate, self.motion)

    def _parts(self) -> Iterator[str]:
        yield f"{self.motion.team.drones} drones"
        yield f"until {self.motion.duration:.4g} s"

    @property
    def goal(self) -> Hitch:
        """The hitch at the end of the current plan."""
        return self._goal

    @property
    def plan(self) -> Plan:
        """The current plan from the start of steering, with its full certificate."""
        return Plan(Flight.of(self.motion), certify(self.motion), "Steered")

    def retarget(
        self,
        polygon: Outline | ArrayLike | None = None,
        *,
        vertex: int | None = None,
        to: ArrayLike | None = None,
        yaw: float = 0.0,
        at: float,
    ) -> Retarget:
        """Plan to a new goal; adopt and return the plan if it is certified, else a refusal.

        Parameters
        ----------
        polygon: goal of all vertices, (points, 2) [m], clockwise.
        vertex: index of a vertex that moves ``to`` (2,) [m], all others to the current goal.
        to: without ``vertex``, new centroid of the current goal (3,) [m].
        yaw: rotation of the goal about its centroid [rad].
        at: time at which to leave the current plan [s]; up to 0.4 s later if limits require it.

        Raises
        ------
        InputError: not exactly one goal, or an invalid one.
        """
        at = nonnegative("at", at)
        goal = self._requested(polygon, vertex, to, yaw)
        reason = ""
        for departure in self._departures(at):
            if isinstance(departure, str):
                reason = reason or departure
                continue
            retargeted = outcome(partial(self._retarget, *goal, departure))
            if isinstance(retargeted, InfeasibleError):
                reason = str(retargeted)
                break
            result, self._goal = retargeted
            self.motion, self._certificate = result.motion, result.certificate
            return result
        return Retarget(False, at, self.motion, self.motion, self._certificate, reason)

    def _requested(
        self,
        polygon: Outline | ArrayLike | None,
        vertex: int | None,
        to: ArrayLike | None,
        yaw: float,
    ) -> tuple[Outline, float, float]:
        """Return outline, altitude and yaw of the requested goal."""
        goal = self._goal
        team = self.motion.team
        own = self._goal.polygon
        yaw = finite("yaw", yaw)
        specified = polygon is not None, vertex is not None, to is not None
        kinds = [(True, False, False), (False, True, True), (False, False, True)]
        if specified not in kinds or (yaw != 0.0 and specified != kinds[-1]):
            remedy = "specify a polygon; or a vertex and to; or to alone, (3,), and a yaw"
            raise InputError("polygon", polygon, "exactly one goal", remedy)
        if polygon is not None:
            return checked_polygon(team, polygon), goal.altitude, 0.0
        if vertex is not None:
            vertices = own.vertices.copy()
            k = integer("vertex", vertex, 0, len(vertices) - 1)
            vertices[k] = points("to", [to], (1, 2), "a point [x, y]", "specify two numbers [m]")[0]
            return checked_polygon(team, vertices), goal.altitude, 0.0
        centroid = points("to", [to], (1, 3), "a point [x, y, z]", "specify three numbers [m]")[0]
        vertices = rotated(own.vertices - own.centroid, yaw) + centroid[:2]
        return checked_polygon(team, vertices), float(centroid[2]), yaw

    def _departures(self, at: float) -> Iterator[_Departure | str]:
        """Yield the departures from the current plan at ``at`` [s] or later, or why not then."""
        for delays in (DELAYS[:1], DELAYS[1:]):  # all later ones at once
            yield from _departures([self._past(at + delay) for delay in delays], self._limits)

    def _retarget(
        self, outline: Outline, altitude: float, yaw: float, departure: _Departure
    ) -> tuple[Retarget, Hitch]:
        """Return the result of a departure from the current plan, and the hitch at its end."""
        past, stop, brake = departure
        recent = cut(past, past.drones.pieces - 1, past.drones.pieces)
        end = self._end(outline, altitude)
        path = RetargetPath.to(past.team, stop.state, end, yaw)
        curves = path.fastest(self._limits, brake)
        if curves is None:
            raise InfeasibleError([], "no duration keeps all limits on the way to the goal")
        drones, vertices, legs, tensions = curves
        phase = Phase("retarget", past.phases[-1].step + 1, 0.0, drones.duration)
        new = Motion(path.team, self.requirements, drones, vertices, legs, tensions, (phase,))
        new = with_last_poses(past, new)
        ahead = append_motion(recent, new)
        with rough_bounds():  # for speed
            certificate = certify(ahead.untimed, reports=())
        if not certificate.certified:
            raise infeasible_error(certificate, ahead)
        return Retarget(True, past.duration, append_motion(past, new), ahead, certificate), end

    def _end(self, outline: Outline, altitude: float) -> Hitch:
        """Return the hitch of a goal, with the current slack split if limits allow it."""
        team = self.motion.team
        need = self.requirements
        slack = cable_slack(team, outline)
        q_legs = team.layout.q_legs_of(self._goal.fractions * slack, slack)
        task = LegTask.at_rest(team, outline, q_legs, need, LIMIT_MARGIN)
        return Hitch(team, outline, altitude, task.split(first=True).q_legs[0])

    def _past(self, at: float) -> Motion:
        """Return the current plan up to a time [s]; after its end the hitch rests."""
        duration = self.motion.duration
        breaks = self.motion.drones.breaks
        if at > duration + MIN_SPACING:
            phase = replace(self.motion.phases[-1], name="hold", remark="")
            return append_motion(self.motion, resting(self.motion, at - duration, phase))
        if at > duration - 1e-6:
            return self.motion
        return truncated(self.motion, max(float(spaced(at, breaks)), MIN_SPACING))


def _departures(pasts: Sequence[Motion], limits: Limits) -> Iterator[_Departure | str]:
    """Yield departures from the ends of motions, or why these cannot be left.

    A brake is the first of BRAKE_DURATIONS that keeps the limits at samples.
    """
    free = [p for p in pasts if p.phases[-1].state.hitched and p.phases[-1].hold is None]
    for past in pasts:
        if past not in free:
            reason = "an object is held" if past.phases[-1].state.hitched else "there is no hitch"
            yield f"at t = {past.duration:.4g} s {reason}"
    if not free:
        return
    stops = [RetargetPath.to_rest(past.team, MovingState.at_end(past)) for past in free]
    times = np.outer(BRAKE_DURATIONS, BRAKE_SAMPLES)
    shape = (len(free), *times.shape)
    t = times.ravel()
    durations = np.repeat(BRAKE_DURATIONS, times.shape[1])
    weights = _weights(t, durations, None)
    outputs = np.concatenate([stop.ends @ weights for stop in stops])
    drones = _drones(free[0].team, outputs)
    shares = _excess(drones, limits, np.tile(t, len(free))).reshape(shape).max(axis=2)
    models = drones.positions[:: len(t), ..., 0]
    for past, stop, model, share in zip(free, stops, models, shares, strict=True):
        tensions = past.tensions.coefficients[-1, :, -1]
        errors = tensions - past.team.tension, model - stop.state.drones[..., 0]
        feasible = np.flatnonzero(share <= BRAKE_SHARE) if stop.state.moves else [0]
        if any(np.abs(error).max() > STATE_TOLERANCE for error in errors):
            reason = "legs are rolled, or do not have the team's tensions"
            yield f"at t = {past.duration:.4g} s {reason}"
        elif not len(feasible):
            yield f"from t = {past.duration:.4g} s: no brake keeps all limits"
        else:
            yield _Departure(past, stop, BRAKE_DURATIONS[feasible[0]])


def _breaks(brake: float, shift: float) -> Array:
    """Return the breaks of a path [s], the ends of brake and shift among them."""
    brake_piece = min(PIECE, max(brake, shift) / MIN_PIECES)
    shift_piece = max(brake_piece, shift / SHIFT_PIECES)
    parts = [np.zeros(1)]
    for start, end in pairwise([0.0, *sorted((brake, shift))]):
        piece = brake_piece if end <= brake else shift_piece
        count = math.ceil((end - start) / piece * (1.0 - 1e-9))
        parts.append(np.linspace(start, end, count + 1)[1:])
    return np.concatenate(parts)


@dataclass(frozen=True, eq=False)
class MovingState:
    """The state of a moving hitch: values with first and second time derivatives."""

    vertices: Array  # (points, 3, 3) [m]
    fractions: Array  # (n, 3), ``d_k / (d_k + e_k)``
    drones: Array  # (2n, 3, 3) [m]
    legs: Array  # (n, 2, 3) [m]

    @classmethod
    def at_end(cls, motion: Motion) -> MovingState:
        """Return the state at the end of a motion."""
        team = motion.team
        layout = motion.team.layout
        drones, vertices, legs, tensions = (
            part.end_jet(STATE)
            for part in (motion.drones, motion.vertices, motion.legs, motion.tensions)
        )
        chords = drones - vertices[layout.anchors]
        cables = cables_of_legs(team, chords[None], legs[None], tensions[None])
        d, e = (legs if cables is None else cables[0]).swapaxes(0, 1)
        slack = d + e
        without_legs = ~np.all(layout.has_leg, axis=1) & (slack[:, 0] <= 0.0)
        slack[without_legs, 0] = 1.0  # end cables of a chain
        fractions = (Series.of_jet(d) / Series.of_jet(slack)).jet
        return cls(vertices, fractions, drones, legs)

    @property
    def moves(self) -> bool:
        """Return whether anything moves or accelerates."""
        return bool((np.abs(self.drones[..., 1:]) > 1e-9).any())


@dataclass(frozen=True, eq=False)
class RetargetPath:
    """Flat outputs from a moving state to a hitch at rest."""

    team: Team
    state: MovingState
    end: Array  # vertices (points, 3) [m] at rest
    fractions: Array  # (n,), fractions of the slack at rest
    yaw: float = 0.0  # rotation of the frame [rad]

    @classmethod
    def to(cls, team: Team, state: MovingState, end: Hitch, yaw: float) -> RetargetPath:
        """Return the path to a hitch, with the number of full turns that is closest to a yaw [rad].

        The frame rotates by the angle between the state and the hitch, even if an earlier rotation
        is not complete: with straight lines to the goal, a polygon that turns by half would shrink.
        """
        vertices = end.vertices
        angle = _rotation_angle(state.vertices[:, :2, 0], vertices[:, :2])
        angle += 2.0 * math.pi * round((yaw - angle) / (2.0 * math.pi))
        return cls(team, state, vertices, end.fractions, angle)

    @classmethod
    def to_rest(cls, team: Team, state: MovingState) -> RetargetPath:
        """Return the path to rest at the positions of a state."""
        return cls(team, state, state.vertices[..., 0], state.fractions[:, 0])

    @cached_property
    def ends(self) -> Array:
        """(m, 4): mean point, relative shape, fractions and angle: start with rates, and end."""
        centre = self.state.vertices.mean(axis=0)
        goal = self.end.mean(axis=0)
        shape = (self.state.vertices - centre).reshape(-1, STATE)
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        back = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        ends = np.zeros((len(shape) + len(self.fractions) + 4, STATE + 1))
        ends[:-1, :STATE] = np.concatenate([centre, shape, self.state.fractions])
        last = goal, ((self.end - goal) @ back).ravel(), self.fractions, [self.yaw]
        ends[:, STATE] = np.concatenate(last)
        return ends

    def drones(self, t: Array, brake: float, shift: float) -> DroneJets:
        """Return the drones at times t (J,) [s] for durations of brake and shift [s]."""
        return _drones(self.team, self.ends @ _weights(t, brake, shift), turns=self.yaw != 0.0)

    def fastest(self, limits: Limits, brake: float) -> list[PiecewisePolynomial] | None:
        """Return the four polynomials of a motion that keeps all limits at samples, or None.

        The duration of its shift is the first one, in increasing order, with which all limits hold.
        The model is evaluated once for each: at samples, and at both ends of every piece.
        """
        shift = MIN_SHIFT
        for _ in range(SHIFT_ROUNDS):
            breaks = _breaks(brake if self.state.moves else 0.0, shift)
            inset = ONE_SIDED * (breaks[1:] - breaks[:-1])
            piece_ends = np.concatenate([breaks[:-1] + inset, breaks[1:] - inset])
            ends = np.array([brake, shift]) * (1.0 - ONE_SIDED)
            samples = np.concatenate([max(shift, brake) * SAMPLES, ends])
            times = np.concatenate([piece_ends, samples])
            drones = self.drones(times, brake, shift)
            at_samples = slice(len(piece_ends), None)
            excess = float(_excess(drones, limits, times)[at_samples].max())
            if excess <= SHARE:
                return self._curves(breaks, drones)
            if not math.isfinite(excess):
                return None
            shift *= max(excess / TARGET_SHARE, MIN_GROWTH)
        return None

    def _curves(self, breaks: Array, drones: DroneJets) -> list[PiecewisePolynomial]:
        """Return the four polynomials for drones at all starts and ends of pieces, then others.

        They start exactly at the state.
        """
        count = len(breaks) - 1
        legs = drones.legs * self.team.layout.has_leg[..., None]
        starts = (self.state.drones, self.state.vertices, self.state.legs)
        rows = [
            part[: 2 * count].reshape(2 * count, -1, JET)
            for part in (drones.positions, drones.flat.vertices, legs)
        ]
        derivatives = np.moveaxis(np.concatenate(rows, axis=1), -1, 0)
        left = derivatives[:, :count]
        right = derivatives[:, count:]
        left[:STATE, 1:] = right[:STATE, :-1]
        left[:STATE, 0] = np.concatenate([part.reshape(-1, STATE) for part in starts]).T
        right[1:STATE, -1] = 0.0
        curves = PiecewisePolynomial.hermite(breaks, left, right)
        pulls = np.repeat(self.team.tension[None, :, None], count, axis=0)
        return [*curves.split([part.shape[:-1] for part in starts]), curves.replaced(pulls)]


def _drones(team: Team, outputs: Array, *, turns: bool = False) -> DroneJets:
    """Return the drones for jets (J, m, JET) of the outputs: mean point, shape, fractions, angle.

    Without ``turns``, all angles are zero.
    """
    layout = team.layout
    count = len(outputs)
    centre = outputs[:, :3]
    split = outputs[:, 3 + 3 * layout.points : -1]
    shape = outputs[:, 3 : 3 + 3 * layout.points].reshape(count, layout.points, 3, JET)
    vertices = centre[:, None] + (_rotated(shape, outputs[:, -1]) if turns else shape)
    edges = layout.edges(vertices, axis=1)
    tensions = np.zeros((count, team.robots, JET))
    tensions[..., 0] = team.tension
    slack = -cable_along(team, edges, tensions)
    slack[..., 0] += team.cable_length
    q_legs = layout.q_leg_jets(product(split, slack), slack)
    return drone_jets(team, FlatJets(vertices, q_legs, tensions))


def _excess(drones: DroneJets, limits: Limits, t: Array) -> Array:
    """Return the factor by which motions are too fast at times (J,) [s]; at most 1 is feasible.

    Thrust and tilt, which do not scale, count by the square root of their fraction of the limit.
    At t = 0 only the jerk counts, because the state is fixed.
    """
    rates = np.maximum.reduce(column_lengths(drones.positions), axis=1).T
    vertex_speed = np.maximum.reduce(length(drones.flat.vertices[..., 1]), axis=1)
    thrusts = drones.thrusts
    horizontal = np.hypot(thrusts[..., 0], thrusts[..., 1])
    upward = thrusts[..., 2]
    thrust = np.hypot(horizontal, upward) / drones.team.max_thrust
    tilt = np.arctan2(horizontal, upward)
    ratios = [
        rates[1] / limits.speed,
        vertex_speed / limits.vertex_speed,
        np.sqrt(rates[2] / limits.acceleration),
        np.sqrt(np.maximum.reduce(thrust, axis=1)),
        np.sqrt(np.maximum.reduce(tilt, axis=1) / limits.tilt),
    ]
    moving = np.maximum.reduce(ratios) * (t > 0.0)
    factor = np.maximum(moving, np.cbrt(rates[3] / limits.jerk))
    return np.where(np.isnan(factor), math.inf, factor)


def _weights(t: Array, brake: float | Array, shift: float | None) -> Array:
    """Return the weights (J, 4, 4) of a state's three columns and of a goal in the outputs' jets.

    The brake is the quintic from a state to rest at a free position, of minimum jerk; the shift is
    the one from rest there to rest at the goal.
    """
    weights = np.zeros((len(t), JET, JET))
    h = np.asarray(brake).reshape(-1, 1)
    _, first, second, *resting = _quintics(t, h[:, 0])
    at_rest = resting[0] + resting[1] + resting[2]
    weights[:, 0, 0] = 1.0
    weights[:, 1] = h * (0.2 * first + 0.4 * second + 0.5 * at_rest)
    weights[:, 2] = h**2 * (0.05 * second + at_rest / 12.0)
    if shift is not None:
        last = _quintics(t, np.array([shift]))[3:]
        at_goal = last[0] + last[1] + last[2]
        weights[:, 0] -= at_goal
        weights[:, 1] -= 0.5 * h * at_goal
        weights[:, 2] -= h**2 / 12.0 * at_goal
        weights[:, 3] = at_goal
    return weights


def _quintics(t: Array, duration: Array) -> Array:
    """Return the jets (6, J, 4) of the Bernstein polynomials over durations, constant after."""
    weights = bernstein.jet_basis(np.minimum(t / duration, 1.0), 5, JET).transpose(1, 0, 2)
    weights = weights / duration[:, None] ** np.arange(JET)
    weights[:, t >= duration, 1:] = 0.0
    return weights


def _rotated(shape: Array, angle: Array) -> Array:
    """Return the jets of shapes (J, points, 3, 4) rotated by angles with jets (J, 4)."""
    outer = np.exp(1.0j * angle[:, :1]) * 1.0j ** np.arange(JET)
    level = shape[:, :, 0] + 1.0j * shape[:, :, 1]
    level = product(chained(outer, angle)[:, None], level)
    rotated = shape.copy()
    rotated[:, :, 0], rotated[:, :, 1] = level.real, level.imag
    return rotated


def _rotation_angle(first: Array, last: Array) -> float:
    """Return the angle [rad] of the rotation about the mean that fits points (k, 2) best."""
    x, y = first - first.mean(axis=0), last - last.mean(axis=0)
    return math.atan2(x[:, 0] @ y[:, 1] - x[:, 1] @ y[:, 0], np.vdot(x, y))
