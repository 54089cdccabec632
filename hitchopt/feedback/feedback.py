"""Corrected setpoints of a plan in flight, from measured vertices.

The measured error of the vertices, filtered, enters a proportional and integral law; the damped
inverse of the hitch's response (``vertex_response``) says which setpoints of drones move vertices
so. What is commanded stays in the plan's covered set (``covered_set``), and changes slowly.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterator

import numpy as np
from numpy.typing import ArrayLike

from hitchopt.compiled.kernel_switch import kernels
from hitchopt.errors import InputError, UnsupportedError
from hitchopt.feedback.covered_set import ONES, cell_breaks, covered_set, projection
from hitchopt.feedback.vertex_response import vertex_response
from hitchopt.motion.motion import Motion
from hitchopt.motion.phases import HITCHED_STATE
from hitchopt.motion.states import states_at
from hitchopt.one_line import OneLine
from hitchopt.stopping.sampler import Sampler, Setpoints
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array, as_array, finite, not_negative, per_robot, positive

PROPORTIONAL, INTEGRAL = 1.2, 2.5
"""Gains [1], [1/s]. Setpoints of drones of 4.75 N/m take 0.3 s to move vertices, measurements and
their filter as long again: the loop has a phase margin of some 50°."""

LEAD = 0.4
"""[s] Setpoints lead the plan of a vertex by so long, as friction is to be overcome first."""

UNWINDING = 0.5
"""[s] Time constant with which the integral forgets what could not be commanded."""

SMOOTHING = 0.2
"""[s] Time constant of the filter of errors: 1 cm of white noise at 100 Hz leaves 2 mm."""

LARGEST_ERROR = 0.5
"""[m] A measured error larger than this is no error of a vertex, but a false measurement."""

LARGEST_MOVE = 0.5
"""[m] Largest correction of a vertex that is asked for."""

HELD, FADING = 0.3, 2.0
"""[s] A vertex not measured for HELD loses its correction with the time constant FADING."""

HANDOVER = 2.0
"""[s] Corrections fade over this time before the hitch is untied, and grow so after it is tied."""

FAR = 0.15
"""[m] Corrections do not grow while a measured drone is farther from its corrected setpoint."""

GAIN = 36.0
"""[1/s²] Stiffness over mass of drones of which none is stated."""


class Feedback(OneLine):
    """Corrections of a plan by measured vertices, for one flight.

    Distances keep their limits at all times while every drone is within ``reserve`` of its
    corrected setpoint and every vertex within it of the plan, as far as the plan itself leaves so
    much: corrected setpoints stay within half-spaces that the plan's polynomials give for whole
    spans of time. A shift of all drones together is limited by the arena alone. With numba
    installed the projection onto them is compiled: corrections are the same to rounding.

    Parameters
    ----------
    plan: a plan of a hitch, or its motion.
    rate: largest speed at which corrections change [m/s].
    reserve: [m], see above.
    delay: age of the measurements, where ``step`` is not told [s].
    stiffness: of the drones' position loops [N/m], one or one per drone; None for the team's, or
        36/s² times their masses where these are rigid.

    Raises
    ------
    InputError: a plan without cables, or a number out of its range.
    UnsupportedError: objects or keep-outs, to which corrections keep no distance.
    """

    def __init__(
        self,
        plan: object,
        *,
        rate: float = 0.1,
        reserve: float = 0.01,
        delay: float = 0.05,
        stiffness: ArrayLike | None = None,
    ) -> None:
        motion = getattr(plan, "motion", plan)
        if not isinstance(motion, Motion) or not motion.team.has_cables:
            raise InputError("plan", plan, "a Plan or Motion of a hitch", "solve or load one")
        if motion.requirements.keep_out or motion.requirements.objects:
            words = "feedback keeps no distance to keep-outs and objects: fly without them"
            raise UnsupportedError(words)
        self.motion, team = motion, motion.team
        self._rate, self._delay = positive("rate", rate), not_negative("delay", delay)
        own = np.where(np.isfinite(team.stiffness), team.stiffness, GAIN * team.mass)
        given = own if stiffness is None else stiffness
        self._stiffness = per_robot("stiffness", given, team.drones, owner="drone")
        breaks = cell_breaks(motion)
        covered = covered_set(motion, breaks, not_negative("reserve", reserve))
        states = states_at(motion, 0.5 * (breaks[1:] + breaks[:-1]))
        self._cells = covered.cells
        with kernels():
            self._within = projection()
        self._breaks = breaks.tolist()
        formed = np.array([cell is not None for cell in covered.cells])
        found = vertex_response(
            team,
            states.positions[formed],
            states.vertices[formed],
            states.tensions[formed],
            self._stiffness,
        )
        self._row = (np.cumsum(formed) - 1).tolist()
        self._forward, self._inverse = found.forward, found.inverse
        self._spans = [
            (s.drones.breaks[0], s.drones.breaks[-1]) for s in motion.spans(HITCHED_STATE)
        ]
        self._end = float(breaks[-1])
        clasps = motion.vertices.coefficients[:, team.layout.clasps]
        self._drones = Sampler(motion.drones)
        self._vertices = Sampler(PiecewisePolynomial(motion.vertices.breaks, clasps))
        self.reset()
        for cell in filter(None, self._cells):  # compiles, and lays out, before the first step
            self._within(cell, self._offsets)

    def _parts(self) -> Iterator[str]:
        yield f"{self.motion.team.drones} drones"
        yield f"{self.motion.duration:.4g} s, cells: {len(self._cells)}"

    def reset(self) -> None:
        """Forget all measurements and corrections."""
        clasps = len(self.motion.team.layout.clasps)
        self._error = np.zeros((clasps, 3))
        self._integral = np.zeros((clasps, 3))
        self._speed = np.zeros((clasps, 3))
        self._age = np.full(clasps, math.inf)
        self._offsets = np.zeros((self.motion.team.drones, 3))
        self._velocities = np.zeros_like(self._offsets)
        self._here = -1

    @property
    def offsets(self) -> Array:
        """(2n, 3) [m]: corrections of the drones' setpoints in force."""
        return self._offsets.copy()

    @property
    def velocities(self) -> Array:
        """(2n, 3) [m/s]: how fast the corrections change."""
        return self._velocities.copy()

    def step(
        self,
        time: float,
        seconds: float,
        vertices: ArrayLike | None = None,
        drones: ArrayLike | None = None,
        *,
        measured: float | None = None,
        clock: tuple[float, float, float] = (1.0, 0.0, 0.0),
    ) -> Setpoints:
        """Return the corrected setpoints at a plan time.

        Parameters
        ----------
        time: plan time [s].
        seconds: time since the last step [s].
        vertices: measured clasps (clasps, 3) [m], a row of nan where one is missing; None where no
            measurement has come.
        drones: measured drones (2n, 3) [m], nan where one is missing; or None.
        measured: plan time of the measurement [s]; None for the delay before ``time``.
        clock: rate of the plan's clock, and its first and second derivatives.

        Raises
        ------
        InputError: measurements of another shape, or a time that is not finite.
        """
        seconds = not_negative("seconds", seconds)
        time = min(max(finite("time", time), 0.0), self._end)
        jet = _shaped("clock", clock, (3,), "give a rate and its two derivatives").tolist()
        planned = self._drones.at(time, *jet)
        here = min(max(bisect_right(self._breaks, time) - 1, 0), len(self._cells) - 1)
        if seconds > 0.0:
            if vertices is not None:
                then = time - jet[0] * self._delay
                then = then if measured is None else finite("measured", measured)
                self._measure(_shaped("vertices", vertices, self._error.shape), then, jet[0])
            self._age += seconds
            growing = drones is None or not self._strayed(planned, drones)
            self._correct(time, here, seconds, growing=growing)
        return Setpoints(
            planned.time,
            planned.rate,
            planned.positions + self._offsets,
            planned.velocities + self._velocities,
            planned.accelerations,
            planned.jerks,
        )

    def _strayed(self, planned: Setpoints, drones: ArrayLike) -> bool:
        """Return whether a drone is far from where it was last told to be."""
        away = _shaped("drones", drones, self._offsets.shape) - planned.positions - self._offsets
        return bool(np.fmax.reduce((away * away) @ ONES) > FAR * FAR)

    def _measure(self, vertices: Array, time: float, rate: float) -> None:
        """Filter the errors of the vertices that a measurement of a plan time holds."""
        if self._row[min(max(bisect_right(self._breaks, time) - 1, 0), len(self._row) - 1)] < 0:
            return
        there = self._vertices.at(min(max(time, 0.0), self._end), 1.0, 0.0, 0.0)
        self._speed = rate * there.velocities
        error = there.positions - vertices
        good = (error * error) @ ONES <= LARGEST_ERROR * LARGEST_ERROR  # false for nan
        weight = -np.expm1(self._age / -SMOOTHING)
        weight[self._age > HELD] = 1.0
        if not good.all():
            weight[~good] = 0.0
            error[~good] = 0.0
        self._error += weight[:, None] * (error - self._error)
        self._age[good] = 0.0

    def _correct(self, time: float, here: int, seconds: float, *, growing: bool) -> None:
        """Advance the integral and the offsets by some time."""
        error, speed = self._error, self._speed
        if np.maximum.reduce(self._age) > HELD:
            fresh = self._age <= HELD
            error, speed = fresh[:, None] * error, fresh[:, None] * speed
            self._integral[~fresh] *= math.exp(-seconds / FADING)
        if growing:
            self._integral += (INTEGRAL * seconds) * error
        np.minimum(np.maximum(self._integral, -LARGEST_MOVE), LARGEST_MOVE, out=self._integral)
        share, asked = self._authority(time), None
        cell = self._cells[here]
        if cell is None or share == 0.0:
            goal = np.zeros_like(self._offsets)
        else:
            row = self._row[here]
            wanted = PROPORTIONAL * error + self._integral + LEAD * speed
            asked = (self._inverse[row] @ (share * wanted).ravel()).reshape(-1, 3)
            goal = self._within(cell, asked)
            following = self._cells[min(here + 1, len(self._cells) - 1)]
            if following is not None and following is not cell:
                goal = self._within(following, goal)
        change = goal - self._offsets
        largest = math.sqrt(np.maximum.reduce((change * change) @ ONES))
        step = min(1.0, self._rate * seconds / largest) if largest > 0.0 else 0.0
        offsets = self._offsets + step * change
        if cell is not None and here != self._here:  # else between two of the same convex set
            offsets = self._within(cell, offsets)
        self._here = here
        if asked is not None:
            missed = (self._forward[self._row[here]] @ (offsets - asked).ravel()).reshape(-1, 3)
            self._integral += min(seconds / UNWINDING, 1.0) * missed
        self._velocities = (offsets - self._offsets) / seconds
        self._offsets = offsets

    def _authority(self, time: float) -> float:
        """Return the share of the correction that applies: it fades where the hitch is untied."""
        for first, last in self._spans:
            if first <= time <= last:
                grown = 1.0 if first <= 0.0 else (time - first) / HANDOVER
                left = 1.0 if last >= self._end else (last - time) / HANDOVER
                return min(1.0, grown, left)
        return 0.0


MISSING = "give a row of nan where one is missing"


def _shaped(key: str, values: object, shape: tuple[int, ...], remedy: str = MISSING) -> Array:
    """Return an array of a shape; nan is allowed."""
    found = as_array(values)
    if found.shape != shape:
        raise InputError(key, values, f"numbers of shape {shape}", remedy)
    return found
