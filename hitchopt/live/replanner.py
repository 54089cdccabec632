"""Steering: a hitch that moves is given new goals, and every answer is certified."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from hitchopt.checks import Certificate, certify
from hitchopt.errors import InfeasibleError, InputError, OneLine, UnsupportedError
from hitchopt.geometry import Outline
from hitchopt.hitch import GRAVITY, Hitch, Team
from hitchopt.hitch.hitch import cable_slack, fitting_polygon
from hitchopt.hitch.leg_program import LIMIT_MARGIN, LegTask
from hitchopt.hitch.legs import split_slack
from hitchopt.hitch.requirements import Arena, Limits, Requirements, Separation
from hitchopt.live.retarget_path import MovingState, RetargetPath
from hitchopt.motion.motion import Motion, Phase
from hitchopt.motion.retiming import before, beside_objects, cut, followed, resting
from hitchopt.plan import Plan
from hitchopt.steps.certified_motions import flying, infeasible
from hitchopt.steps.certified_motions import resting as rest_of
from hitchopt.trajectory.search import rough_bounds
from hitchopt.values import Array, finite, instance, not_negative, points, whole

LEAST = 1e-3
"""[s] Least time that is flown of a piece of the present plan: derivatives of shorter pieces suffer
from rounding."""

HOLD = 1.0
"""[s] Rest with which steering begins."""

SAME_STATE = 1e-6
"""[m] Largest distance of drones from where the team's tensions put them, to begin from there."""

WAITS = (0.0, 0.05, 0.1, 0.2, 0.4)
"""[s] How long the old plan is flown on where a retarget cannot begin at once."""

PIECE, PIECES, FEWEST = 0.3, 10, 4
"""[s] Length of the pieces of the brake, which is as quick as limits allow; number of pieces that a
shift is divided into where they are no shorter, so that a cable's length is right within 1e-6 of
it; and least number of pieces."""

EASED = frozenset(
    {
        *("speed", "vertex_speed", "acceleration", "jerk", "thrust", "tilt", "body_rate"),
        *("cable_length", "equilibrium", "tension"),
    }
)
"""Checks that a slower shift on shorter pieces eases."""

SLOWER, FINER = 1.1, 0.5
"""Factors of a shift's duration and of its pieces' for that second try."""


@dataclass(frozen=True, eq=False)
class Retarget(OneLine):
    """Answer of a replanner.

    Attributes
    ----------
    accepted: whether the hitch flies to the new goal; if not, all goes on as before.
    start: time at which the new plan leaves the old one [s].
    motion: what flies now, from the beginning of steering.
    ahead: the part from the last break before ``start`` on, t = 0 there; of a refusal the motion.
    certificate: of ``ahead``, all checks; what is only reported, that of ``plan`` tells.
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
        instance("team", team, Team)
        instance("start", start, Hitch, Plan)
        instance("limits", limits, Limits, type(None))
        instance("separation", separation, Separation, type(None))
        instance("arena", arena, Arena, type(None))
        own = start.motion.team if isinstance(start, Plan) else start.team
        if own.drone_names != team.drone_names or np.any(own.cable_length != team.cable_length):
            raise InputError("start", start, "of the same team", "give the team of the start")
        if team.cable_density > 0.0 or np.any(team.load):
            raise UnsupportedError("steering plans cables without weight and clasps without load")
        given = start.motion.requirements if isinstance(start, Plan) else Requirements()
        self.requirements = replace(
            given,
            limits=limits or given.limits,
            separation=separation or given.separation,
            arena=arena or given.arena,
        )
        if isinstance(start, Plan):
            self.motion = replace(start.motion, requirements=self.requirements)
            self._goal = start.end
        else:
            phase = Phase("hold", 0, 0.0, HOLD)
            self.motion = rest_of(start, self.requirements, HOLD, phase)
            self._goal = start
        limits = self.requirements.planned.limits
        turning = math.inf if limits.body_rate is None else GRAVITY * limits.body_rate
        self._limits = replace(limits, jerk=min(limits.jerk, turning))
        """Those of planning, with a jerk that turns a hovering drone at ``body_rate`` at most."""
        self._certificate = certify(self.motion, reports=())
        with suppress(InfeasibleError):  # loads the solver before the first goal is given
            self._end(self._goal.polygon, self._goal.altitude, chosen=True)
        if not self._certificate.certified:
            raise infeasible(self._certificate, self.motion)

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
        at = not_negative("at", at)
        goal = self._asked(polygon, vertex, to, yaw)
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

    def _asked(
        self,
        polygon: Outline | ArrayLike | None,
        vertex: int | None,
        to: ArrayLike | None,
        yaw: float,
    ) -> tuple[Outline, float, float]:
        """Return outline, altitude and yaw of the goal that is asked for."""
        goal, team, own = self._goal, self.motion.team, self._goal.polygon
        yaw = finite("yaw", yaw)
        remedy = "give a polygon; or a vertex and to; or to alone, (3,)"
        if (polygon is None) is (to is None):
            raise InputError("polygon", polygon, "exactly one goal", remedy)
        if polygon is not None and vertex is not None:
            raise InputError("vertex", vertex, "left out where a polygon is given", remedy)
        if yaw != 0.0 and (polygon is not None or vertex is not None):
            raise InputError("yaw", yaw, "left out but with to alone", remedy)
        if polygon is not None:
            return fitting_polygon(team, polygon), goal.altitude, 0.0
        if vertex is not None:
            k = whole("vertex", vertex, 0)
            if k >= len(own.vertices):
                raise InputError("vertex", k, f"below {len(own.vertices)}", "count from 0")
            moved = own.vertices.copy()
            moved[k] = points("to", [to], (1, 2), "a point [x, y]", "give two numbers [m]")[0]
            return fitting_polygon(team, moved), goal.altitude, 0.0
        place = points("to", [to], (1, 3), "a point [x, y, z]", "give three numbers [m]")[0]
        c, s = math.cos(yaw), math.sin(yaw)
        turned = (own.vertices - own.centroid) @ np.array([[c, s], [-s, c]]) + place[:2]
        return fitting_polygon(team, turned), float(place[2]), yaw

    def _planned(
        self, outline: Outline, altitude: float, yaw: float, at: float
    ) -> tuple[Retarget, Hitch]:
        """Return the answer of a plan that leaves the present one at a time, and its goal.

        The present split of the slack is tried first, then one within all limits at the goal.

        Raises
        ------
        NotNowError: nothing can begin at that time.
        InfeasibleError: says what keeps the first path that was tried from being certified.
        """
        past = self._past(at)
        still = self._still(past)
        brake = still.brake(self._limits)
        if brake is None:
            raise NotNowError(f"from t = {past.duration:.4g} s: no brake keeps all limits")
        refusal: InfeasibleError | None = None
        for chosen in (False, True):
            try:
                end = self._end(outline, altitude, chosen=chosen)
                path = RetargetPath.to(past.team, still.state, end, yaw)
                return self._certified(past, path, brake), end
            except InfeasibleError as error:
                refusal = refusal or error
        assert refusal is not None
        raise refusal

    def _end(self, outline: Outline, altitude: float, *, chosen: bool) -> Hitch:
        """Return the hitch of a goal: with the present split of the slack, or one within limits."""
        team, need = self.motion.team, self.requirements
        slack = cable_slack(team, outline)
        q_legs = self._goal.fractions * slack
        if chosen:
            wanted = team.layout.q_legs_of(q_legs, slack)[None]
            shortest = LIMIT_MARGIN * need.limits.leg
            task = LegTask(team, need, outline.vertices[None], wanted, shortest, LIMIT_MARGIN)
            q_legs = split_slack(task, first=True).q_legs[0]
        return Hitch(team, outline, altitude, q_legs)

    def _past(self, at: float) -> Motion:
        """Return the present plan until a time, resting after its end."""
        duration = self.motion.duration
        if at <= duration - 1e-6:
            breaks = self.motion.drones.breaks
            piece = max(int(np.searchsorted(breaks, at - 1e-9)) - 1, 0)
            first, last = breaks[piece : piece + 2].tolist()
            return before(self.motion, max(at, min(first + LEAST, last)))
        if at <= duration + 1e-3:
            return self.motion
        phase = replace(self.motion.phases[-1], name="hold", remark="")
        return followed(self.motion, resting(self.motion, at - duration, phase))

    def _still(self, past: Motion) -> RetargetPath:
        """Return the path that ends where a motion does, from the state there.

        Raises
        ------
        NotNowError: no hitch there with the team's tensions.
        """
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

    def _certified(self, past: Motion, path: RetargetPath, brake: float) -> Retarget:
        """Return the answer for a path and a brake [s].

        Raises
        ------
        InfeasibleError: what was found first.
        """
        shift = path.shortest_shift(self._limits, brake)
        if shift is None:
            raise InfeasibleError([], "no duration keeps all limits on the way to the goal")
        recent = cut(past, past.drones.pieces - 1, past.drones.pieces)
        slowed = ((shift, 1.0), (SLOWER * shift, FINER))
        refusal: InfeasibleError | None = None
        for lasting, finer in slowed:
            phase = Phase("retarget", past.phases[-1].step + 1, 0.0, max(brake, lasting))
            breaks = _breaks(brake if path.state.moves else 0.0, lasting, finer)
            flight = path.flight(breaks, brake, lasting)
            fresh = beside_objects(past, flying(flight, path.team, self.requirements, [phase]))
            ahead = followed(recent, fresh)
            certificate = _certificate(ahead)
            if certificate.certified:
                return Retarget(True, past.duration, followed(past, fresh), ahead, certificate)
            refusal = refusal or infeasible(certificate, ahead)
            if not {check.name for check in certificate.violated} <= EASED:
                break
        assert refusal is not None
        raise refusal


def _certificate(ahead: Motion) -> Certificate:
    """Return the certificate of what is ahead, with bounds that are found quickly."""
    with rough_bounds():
        return certify(ahead.untimed, reports=())


def _breaks(brake: float, shift: float, finer: float) -> Array:
    """Return the breaks of a retarget: its end, the brake's and the shift's, and more.

    Parameters
    ----------
    brake, shift: durations [s].
    finer: factor of the pieces' lengths.
    """
    least = min(PIECE, max(brake, shift) / FEWEST)
    later = max(least, shift / PIECES)
    edges = [0.0, brake, shift] if brake < shift else [0.0, shift, brake]
    parts = [np.zeros(1)]
    for start, end in pairwise(edges):
        piece = finer * (least if end <= brake else later)
        count = math.ceil((end - start) / piece * (1.0 - 1e-9))
        parts.append(np.linspace(start, end, count + 1)[1:])
    return np.concatenate(parts)
