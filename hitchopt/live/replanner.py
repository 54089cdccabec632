"""Steering: a hitch that moves is given new goals, and every answer is certified."""

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
from hitchopt.checks.clasps import QUICK_EQUILIBRIUM
from hitchopt.checks.spans import shared_values
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

# Least time that is flown of a piece of the present plan: derivatives of shorter pieces suffer from
# rounding [s]
LEAST = 1e-3
HOLD = 1.0  # rest with which steering begins [s]
SAME_STATE = 1e-6  # largest distance of drones from where the team's tensions put them [m]
WAITS = (0.0, 0.05, 0.1, 0.2, 0.4)  # how long the old plan is flown on first [s]

# Length of the pieces of the brake [s], which is as quick as limits allow; number of pieces of a
# shift where they are no shorter, so that a cable's length is right within 1e-6 of it; least number
PIECE, PIECES, FEWEST = 0.3, 10, 4

# Whether the slack is split anew; factors of a shift's duration, and of its pieces' lengths
ATTEMPTS = ((False, 1.0, 1.0), (False, 1.1, 0.5), (True, 1.1, 0.5))


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
        options: dict[str, Any] = {"limits": limits, "separation": separation, "arena": arena}
        for (key, value), kind in zip(options.items(), (Limits, Separation, Arena), strict=True):
            instance(key, value, kind, type(None))
        own = start.motion.team if isinstance(start, Plan) else start.team
        if own.drone_names != team.drone_names or np.any(own.cable_length != team.cable_length):
            raise InputError("start", start, "of the same team", "give the team of the start")
        if team.cable_density > 0.0 or np.any(team.load):
            raise UnsupportedError("steering plans cables without weight and clasps without load")
        given = start.motion.requirements if isinstance(start, Plan) else Requirements()
        changed = {key: value for key, value in options.items() if value is not None}
        self.requirements = replace(given, **changed)
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
        goal, team, own, yaw = self._goal, self.motion.team, self._goal.polygon, finite("yaw", yaw)
        given = polygon is not None, vertex is not None, to is not None
        kinds = [(True, False, False), (False, True, True), (False, False, True)]
        if given not in kinds or (yaw != 0.0 and given != kinds[-1]):
            remedy = "give a polygon; or a vertex and to; or to alone, (3,), and a yaw"
            raise InputError("polygon", polygon, "exactly one goal", remedy)
        if polygon is not None:
            return fitting_polygon(team, polygon), goal.altitude, 0.0
        if vertex is not None:
            moved = own.vertices.copy()
            k = whole("vertex", vertex, 0, len(moved) - 1)
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

        Raises
        ------
        NotNowError: nothing can begin at that time.
        InfeasibleError: says what keeps the first attempt from being certified.
        """
        past = self._past(at)
        still = self._still(past)
        brake = still.brake(self._limits)
        if brake is None:
            raise NotNowError(f"from t = {past.duration:.4g} s: no brake keeps all limits")
        recent = cut(past, past.drones.pieces - 1, past.drones.pieces)
        refusal: InfeasibleError | None = None
        for chosen, slower, finer in ATTEMPTS:
            try:
                end = self._end(outline, altitude, chosen=chosen)
                path = RetargetPath.to(past.team, still.state, end, yaw)
                shift = path.shortest_shift(self._limits, brake)
                if shift is None:
                    words = "no duration keeps all limits on the way to the goal"
                    raise InfeasibleError([], words)
                phase = Phase("retarget", past.phases[-1].step + 1, 0.0, max(brake, slower * shift))
                breaks = _breaks(brake if path.state.moves else 0.0, slower * shift, finer)
                flight = path.flight(breaks, brake, slower * shift)
                fresh = flying(flight, path.team, self.requirements, [phase])
                fresh = beside_objects(past, fresh)
                ahead = followed(recent, fresh)
                found = _certificate(ahead)
                if found.certified:
                    motion = followed(past, fresh)
                    return Retarget(True, past.duration, motion, ahead, found), end
                raise infeasible(found, ahead)
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
        duration, breaks = self.motion.duration, self.motion.drones.breaks
        if at > duration + LEAST:
            phase = replace(self.motion.phases[-1], name="hold", remark="")
            return followed(self.motion, resting(self.motion, at - duration, phase))
        if at > duration - 1e-6:
            return self.motion
        piece = max(int(np.searchsorted(breaks, at - 1e-9)) - 1, 0)
        first, last = breaks[piece : piece + 2].tolist()
        return before(self.motion, max(at, min(first + LEAST, last)))

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


def _certificate(ahead: Motion) -> Certificate:
    """Return the certificate of what is ahead, with bounds that are found quickly."""
    checked = ahead.untimed
    with shared_values(), rough_bounds():
        known = {QUICK_EQUILIBRIUM.name: QUICK_EQUILIBRIUM.findings(checked)}
        return certify(checked, reports=(), known=known)


def _breaks(brake: float, shift: float, finer: float) -> Array:
    """Return the breaks: the ends [s] of brake and shift, and more, pieces by a factor shorter."""
    least = min(PIECE, max(brake, shift) / FEWEST)
    later, parts = max(least, shift / PIECES), [np.zeros(1)]
    for start, end in pairwise([0.0, *sorted((brake, shift))]):
        piece = finer * (least if end <= brake else later)
        count = math.ceil((end - start) / piece * (1.0 - 1e-9))
        parts.append(np.linspace(start, end, count + 1)[1:])
    return np.concatenate(parts)
