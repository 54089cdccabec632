"""Steering: a hitch that moves is given new goals, and every answer is certified."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from hitchopt.checks import certify
from hitchopt.errors import InfeasibleError, InputError, UnsupportedError
from hitchopt.geometry import Outline
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.cable_slack import cable_slack, fitting_polygon
from hitchopt.hitch.leg_lengths import quick_split
from hitchopt.hitch.leg_task import LIMIT_MARGIN, LegTask
from hitchopt.motion.motion import Motion, Phase
from hitchopt.motion.retiming import before, beside_objects, followed, resting
from hitchopt.one_line import OneLine
from hitchopt.plan import Plan
from hitchopt.requirements import Arena, Limits, Requirements, Separation
from hitchopt.steering.goal_distances import clearly_too_close
from hitchopt.steering.retarget import (
    BRAKES,
    IN_FLIGHT,
    NotNowError,
    Refusal,
    Retarget,
    braked_retarget,
)
from hitchopt.steering.retarget_path import SAME_STATE, MovingState, RetargetPath
from hitchopt.steering.retarget_timing import WAITS, brakes, turning_slowly
from hitchopt.steps.certified_motions import at_rest, infeasible
from hitchopt.steps.certified_motions import resting as rest_of
from hitchopt.values import Array, finite, instance, not_negative, points, whole

LEAST = 1e-3
"""[s] Least time that is flown of a piece of the present plan: derivatives of shorter pieces suffer
from rounding."""

HOLD = 1.0
"""[s] Rest with which steering begins."""


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
        for key, value, kind in (
            ("limits", limits, Limits),
            ("separation", separation, Separation),
            ("arena", arena, Arena),
        ):
            if value is not None:
                instance(key, value, kind)
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
        self._certificate = certify(self.motion, reports=IN_FLIGHT)
        self._load()
        if not self._certificate.certified:
            raise infeasible(self._certificate, self.motion)

    def _load(self) -> None:
        """Load the solver before the first goal is given."""
        goal = self._goal
        with suppress(NotNowError, InfeasibleError):
            self._end(goal.polygon, goal.altitude, goal.fractions, chosen=True)

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
        outline, altitude, turned = self._asked(polygon, vertex, to, yaw)
        return self._answered(outline, altitude, turned, at)

    def _answered(self, outline: Outline, altitude: float, turned: float, at: float) -> Retarget:
        """Return the answer to a goal, and fly there if it is accepted."""
        refusal = ""
        for wait in WAITS:
            try:
                found = self._planned(outline, altitude, turned, at + wait)
            except InfeasibleError as error:
                return self._kept(at, str(error))
            except NotNowError as late:
                refusal = refusal or str(late)
                continue
            answer, self._goal = found
            self.motion, self._certificate = answer.motion, answer.certificate
            return answer
        return self._kept(at, refusal)

    def _kept(self, at: float, reason: str) -> Retarget:
        return Retarget(False, at, self.motion, self.motion, self._certificate, reason)

    def _asked(
        self,
        polygon: Outline | ArrayLike | None,
        vertex: int | None,
        to: ArrayLike | None,
        yaw: float,
    ) -> tuple[Outline, float, float]:
        """Return outline, altitude and yaw of the goal that is asked for."""
        goal, team = self._goal, self.motion.team
        own = goal.polygon
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
        centre = own.centroid
        turned = (own.vertices - centre) @ np.array([[c, s], [-s, c]]) + place[:2]
        return fitting_polygon(team, turned), float(place[2]), yaw

    def _planned(
        self, outline: Outline, altitude: float, yaw: float, at: float
    ) -> tuple[Retarget, Hitch]:
        """Return the answer of a plan that leaves the present one at a time, and its goal."""
        past = self._past(at)
        alone = self._still(past)
        state, team, need = alone.state, past.team, self.requirements
        limits = turning_slowly(need.planned.limits)
        durations = brakes(alone, limits, BRAKES)
        if not durations:
            raise NotNowError(f"from t = {past.duration:.4g} s: no brake keeps all limits")
        fractions = self._goal.fractions
        refusal: InfeasibleError | Refusal | None = None
        given: Hitch | None = None
        hopeless: Hitch | None = None
        for chosen in (False, True):
            try:
                end = self._end(outline, altitude, fractions, chosen=chosen)
            except InfeasibleError as error:
                refusal = refusal or error
                continue
            if given is not None and np.allclose(end.q_legs, given.q_legs, 0.0, SAME_STATE):
                break  # the goal keeps all limits at rest: the path to it does not
            given = given if chosen else end
            if clearly_too_close(end, need.separation):
                hopeless = hopeless or end
                continue
            path = RetargetPath.to(team, state, end, yaw)
            found = braked_retarget(past, path, durations, need)
            if isinstance(found, Retarget):
                return found, end
            refusal = refusal or found
        if hopeless is not None and hopeless is given:
            still = beside_objects(past, at_rest(given, need))
            raise infeasible(certify(still.untimed, reports=()), still, "at the goal")
        assert refusal is not None
        raise refusal.complete() if isinstance(refusal, Refusal) else refusal

    def _end(self, outline: Outline, altitude: float, fractions: Array, *, chosen: bool) -> Hitch:
        """Return the hitch of a goal: with the present split of the slack, or one within limits."""
        team, need = self.motion.team, self.requirements
        slack = cable_slack(team, outline)
        q_legs = fractions * slack
        if chosen:
            wanted = team.layout.q_legs_of(q_legs, slack)[None]
            shortest = LIMIT_MARGIN * need.limits.leg
            task = LegTask(team, need, outline.vertices[None], wanted, shortest, LIMIT_MARGIN)
            q_legs = quick_split(task).q_legs[0]
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
        model = still.jets(np.zeros(1), 1.0, math.inf).drones[0, ..., 0]
        if away.max() > SAME_STATE or np.abs(model - state.drones[..., 0]).max() > SAME_STATE:
            raise NotNowError(f"{when} legs lean, are rolled, or do not have the team's tensions")
        return still
