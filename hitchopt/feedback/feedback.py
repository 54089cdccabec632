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

from hitchopt.errors import InputError, UnsupportedError
from hitchopt.feedback.correction_law import (
    CorrectionState,
    Law,
    StepFlags,
    StepTimes,
    corrected,
    filtered,
    uncorrected,
)
from hitchopt.feedback.covered_set import LARGEST, ONES, PASSES, cell_breaks, covered_set
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

STEADY = (1.0, 0.0, 0.0)
"""Rate of the plan's own clock, and its derivatives."""

LAW = Law(
    PROPORTIONAL,
    INTEGRAL,
    LEAD,
    UNWINDING,
    SMOOTHING,
    LARGEST_ERROR,
    LARGEST_MOVE,
    HELD,
    FADING,
    PASSES,
    LARGEST,
)


class Feedback(OneLine):
    """Corrections of a plan by measured vertices, for one flight.

    Distances keep their limits at all times while every drone is within ``reserve`` of its
    corrected setpoint and every vertex within it of the plan, as far as the plan itself leaves so
    much: corrected setpoints stay within half-spaces that the plan's polynomials give for whole
    spans of time. A shift of all drones together is limited by the arena alone.

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
        inverse = np.ascontiguousarray(found.inverse)
        self._response = list(zip(found.forward, inverse, strict=True))
        self._spans = [
            (s.drones.breaks[0], s.drones.breaks[-1]) for s in motion.spans(HITCHED_STATE)
        ]
        self._end = float(breaks[-1])
        clasps = motion.vertices.coefficients[:, team.layout.clasps]
        self._drones = Sampler(motion.drones)
        self._vertices = Sampler(PiecewisePolynomial(motion.vertices.breaks, clasps))
        self.reset()

    def _parts(self) -> Iterator[str]:
        yield f"{self.motion.team.drones} drones"
        yield f"{self.motion.duration:.4g} s, cells: {len(self._cells)}"

    def reset(self) -> None:
        """Forget all measurements and corrections."""
        clasps = len(self.motion.team.layout.clasps)
        error, speed, integral = np.zeros((3, clasps, 3))
        offsets, self._velocities = np.zeros((2, self.motion.team.drones, 3))
        self._state = CorrectionState(error, speed, integral, np.full(clasps, math.inf), offsets)
        self._here = -1

    @property
    def offsets(self) -> Array:
        """(2n, 3) [m]: corrections of the drones' setpoints in force."""
        return self._state.offsets.copy()

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
        clock: tuple[float, float, float] = STEADY,
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
        jet = clock
        if clock is not STEADY:
            jet = _shaped("clock", clock, (3,), "give a rate and its two derivatives").tolist()
        planned = self._drones.values(time, *jet)
        here = min(max(bisect_right(self._breaks, time) - 1, 0), len(self._cells) - 1)
        if seconds > 0.0:
            if vertices is not None:
                then = time - jet[0] * self._delay
                then = then if measured is None else finite("measured", measured)
                self._measure(_shaped("vertices", vertices, self._state.error.shape), then, jet[0])
            np.add(self._state.age, seconds, out=self._state.age)
            growing = drones is None or not self._strayed(planned[0], drones)
            self._correct(time, here, seconds, growing=growing)
        planned[0] += self._state.offsets
        planned[1] += self._velocities
        return Setpoints(time, jet[0], *planned)

    def _strayed(self, planned: Array, drones: ArrayLike) -> bool:
        """Return whether a drone is far from where it was last told to be."""
        away = _shaped("drones", drones, planned.shape) - planned - self._state.offsets
        return bool(np.fmax.reduce((away * away) @ ONES) > FAR * FAR)

    def _measure(self, vertices: Array, time: float, rate: float) -> None:
        """Filter the errors of the vertices that a measurement of a plan time holds."""
        if self._row[min(max(bisect_right(self._breaks, time) - 1, 0), len(self._row) - 1)] < 0:
            return
        there = self._vertices.values(min(max(time, 0.0), self._end))
        np.multiply(there[1], rate, out=self._state.speed)
        filtered(self._state, vertices, there[0], LAW)

    def _correct(self, time: float, here: int, seconds: float, *, growing: bool) -> None:
        """Advance the integral and the offsets by some time."""
        offsets, share = self._state.offsets, self._authority(time)
        cell, following = self._cells[here], self._cells[min(here + 1, len(self._cells) - 1)]
        followed = following is not None and following is not cell
        times = StepTimes(seconds, self._rate * seconds, share)
        flags = StepFlags(growing, followed, here != self._here)
        self._here, row = here, self._row[here]
        if cell is None or share == 0.0:
            found = uncorrected(self._state, cell, times, flags, LAW)
        else:
            cells = cell, cell if following is None else following
            found = corrected(self._state, cells, self._response[row], times, flags, LAW)
        self._velocities = (found - offsets) / seconds
        offsets[:] = found

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
