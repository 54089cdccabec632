"""Timed motions along paths: piecewise polynomials of time, from rest to rest within all limits.

The clock speeds up toppra's smoothed profile until limits bind at samples. Polynomials with the
path's jets at every breakpoint are then slowed down until limits also hold between samples.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from hitchopt.errors import InfeasibleError, StepPlace, Violation, rounded_up
from hitchopt.geometry.vectors import length
from hitchopt.hitch.forces import cable_of, weight_ratios
from hitchopt.hitch.requirements import Limits, Requirements
from hitchopt.hitch.series import chained
from hitchopt.motion.motion import Motion
from hitchopt.planners.path import FlatPath, Path, path_jets
from hitchopt.planners.timing.clock import Clock, even_clock, first_clock, jerk_limited
from hitchopt.planners.timing.mesh import time_mesh
from hitchopt.planners.timing.profile import (
    RAMP_SHARE,
    WHOLE,
    Demands,
    SpeedProfile,
    acceleration_ramp,
    demands_along,
    fastest_profile,
    path_grid,
)
from hitchopt.planners.timing.stretch import by_piece, jerk_peaks, needed_stretch
from hitchopt.planners.timing.swing import calm_stretch, check_swing
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.trajectory.piecewise import divided
from hitchopt.values import Array


def in_duration(motion: Motion, duration: float) -> Motion:
    """Return the curves rescaled to start at t = 0 with a duration [s], without phases."""
    breaks = duration / motion.duration * motion.drones.breaks
    breaks[-1] = duration
    return motion.map_curves(lambda part: part.replaced(part.coefficients, breaks), ())


def check_duration(duration: float, fastest: float, *steps: StepPlace) -> None:
    """Raise InfeasibleError if a prescribed duration of steps is shorter than the fastest one [s].

    The steps may be unknown.
    """
    if duration < fastest:
        remedy = f"allow {rounded_up(fastest, 6):.6g} s or more, or raise the limits of motion"
        raise InfeasibleError(
            [Violation("duration", duration, fastest, "min", "s", (), "", remedy, steps)]
        )


TIMING_GRID = 160  # Number of steps of toppra's grid along the path
MAX_CABLE_ERROR = 1e-6  # Largest relative error of a cable's length, a hundredth of LENGTH_LIMIT
MAX_PIECES = 400  # Number of pieces at which refinement for MAX_CABLE_ERROR ends

MIN_RAMP_SHARE = 1e-5
"""Shortest ramp of the acceleration over the duration; polynomials do not resolve shorter ones."""

MIN_DURATION = 0.05
"""[s] Shortest duration if none is prescribed; shorter moves would be dominated by rounding."""


def motion_along(
    path: FlatPath, requirements: Requirements, duration: float | None = None
) -> Motion:
    """Return the motion along a path, from rest to rest and without phases.

    Parameters
    ----------
    path: of the hitch.
    requirements: with the limits of motion, which the polynomials' enclosures satisfy.
    duration: prescribed duration [s]; None for the fastest one, but at least MIN_DURATION.

    Raises
    ------
    InfeasibleError: ``duration`` is shorter than the limits permit.
    TimingError: no timing was found.
    """
    return within_limits(fastest_motion(path, requirements).motion, duration)


class ClockedMotion(NamedTuple):
    """A motion along a path, and the clock that gives the path parameter over time."""

    motion: Motion
    clock: Clock


class PeakedMotion(NamedTuple):
    """The fastest motion at samples, and the clock of the profile from which it was found."""

    first: Clock
    fastest: ClockedMotion


PACE_TOLERANCE = 1e-3  # Relative difference of a part's duration from its smallest one


@dataclass(frozen=True, eq=False)
class Pace:
    """Smallest times per parameter on the parts of a path, by default none on the whole path."""

    ends: tuple[float, ...] = WHOLE  # (parts + 1,): parameters at which they start and end
    slowness: Array = field(default_factory=lambda: np.zeros(1))  # (parts,) [s]: smallest 1 / ṡ

    def at(self, s: Array) -> Array:
        """Return the slowness (J,) at s (J,)."""
        slowness: Array = self.slowness[np.searchsorted(self.ends[1:-1], s, side="right")]
        return slowness

    @property
    def joints(self) -> Array:
        """(k,): parameters at which the slowness changes."""
        steps = np.diff(self.slowness, prepend=0.0, append=0.0)
        return np.asarray(np.array(self.ends)[steps != 0.0])

    def adjusted(self, times: Array, durations: Array) -> Pace:
        """Return the pace at which parts take their smallest durations (parts,) [s], or longer.

        It is the same if they do, with ``times`` (parts + 1,) [s] at their ends, up to a tolerance.
        """
        excess = np.diff(times) - durations
        is_off = np.abs(excess) > PACE_TOLERANCE * durations
        if not np.any(is_off & ((excess < 0.0) | (self.slowness > 0.0))):
            return self
        slowness = np.maximum(self.slowness - excess / np.diff(self.ends), 0.0)
        return Pace(self.ends, slowness)


MAX_PEAK = 1.003
"""Largest jerk between samples over its limit; beyond, pieces with such peaks are slowed down.
A whole flight that is stretched for a peak takes longer by a third of its excess."""

MAX_PEAK_ROUNDS = 2  # Maximum number of clocks with smaller peaks that are tried


def fastest_motion(path: FlatPath, requirements: Requirements) -> ClockedMotion:
    """Return the fastest motion along a path; between samples it may exceed limits.

    Raises
    ------
    TimingError: no timing was found.
    """
    return PacedTiming(path, requirements, Pace()).motion


@dataclass(frozen=True, eq=False)
class PacedTiming:
    """The fastest timing of a path at a pace, by a profile that a clock speeds up and smooths.

    Raises
    ------
    TimingError: no timing was found.
    """

    path: FlatPath
    requirements: Requirements
    pace: Pace

    @cached_property
    def limits(self) -> Limits:
        """Limits of motion of the clock."""
        return clocked_limits(self.path, self.requirements)

    @cached_property
    def on_grid(self) -> Demands:
        """Demands on toppra's grid."""
        ends = self.pace.ends
        grid = path_grid(TIMING_GRID, ends)
        demands = demands_along(self.path, self.requirements.limits, TIMING_GRID, ends)
        return replace(demands, limits=self.limits, slowness=self.pace.at(grid))

    @cached_property
    def profile(self) -> SpeedProfile:
        """The fastest motion without a limit of jerk."""
        return fastest_profile(path_grid(TIMING_GRID, self.pace.ends), self.on_grid)

    @cached_property
    def ramp(self) -> float:
        """Time [s] over which the profile is smoothed."""
        ramp = acceleration_ramp(self.profile, self.on_grid)
        return max(ramp, MIN_RAMP_SHARE * self.profile.duration)

    @property
    def estimated_times(self) -> Array:
        """(parts + 1,) [s]: estimates of the times at which the motion is at the ends of parts."""
        times = np.interp(self.pace.ends, self.profile.s, self.profile.times)
        times[1:] += 0.5 * RAMP_SHARE * self.ramp
        times[-1] += 0.5 * RAMP_SHARE * self.ramp
        return np.asarray(times)

    @property
    def motion(self) -> ClockedMotion:
        """The motion and its clock; between samples it may exceed limits."""
        return self._without_peaks(*self.peaked)

    @cached_property
    def peaked(self) -> PeakedMotion:
        """The motion with peaks of jerk between samples, without which none is faster."""
        refinement = 1
        while True:
            mesh = time_mesh(self.profile, self.ramp, refinement, self.pace.joints)
            first = first_clock(self.profile, self.ramp, mesh)
            fastest = self._clocked(first)
            motion = fastest.motion
            if motion.drones.pieces >= MAX_PIECES or cable_error(motion) <= MAX_CABLE_ERROR:
                return PeakedMotion(first, fastest)
            refinement *= 2

    def _clocked(self, first: Clock, jerk_shares: Array | None = None) -> ClockedMotion:
        """Return the fastest motion by a first clock, as of ``jerk_limited``."""

        def demands_at(s: Array) -> Demands:
            """Return the demands at s (J,)."""
            demands = Demands.along(self.path, self.limits, s)
            return replace(demands, slowness=self.pace.at(s))

        clock = jerk_limited(first, demands_at, jerk_shares)
        return ClockedMotion(motion_by(self.path, self.requirements, clock), clock)

    def _without_peaks(self, first: Clock, fastest: ClockedMotion) -> ClockedMotion:
        """Return a motion without peaks of jerk between samples, if it is faster once stretched."""
        best = fastest
        peaks = jerk_peaks(best.motion, self.limits)
        best_duration = np.cbrt(np.max(peaks)) * best.motion.duration
        shares = np.ones(len(peaks))
        for _ in range(MAX_PEAK_ROUNDS):
            if np.max(peaks) <= MAX_PEAK:
                break
            shares = shares / np.maximum(peaks, 1.0)
            slower = self._clocked(first, shares)
            peaks = jerk_peaks(slower.motion, self.limits)
            duration = np.cbrt(max(1.0, np.max(peaks))) * slower.motion.duration
            if duration < best_duration:
                best = slower
                best_duration = duration
        return best


MAX_PACES = 4  # Maximum number of paces of profiles that are tried for durations of parts
MAX_TIMINGS = 2  # Maximum number of paces at which motions are timed; the rest is a stretch
MAX_PACE_GAIN = 0.015  # Largest share of a motion's duration by which another pace shortens it


class PartedMotion(NamedTuple):
    """A motion along a path, and when it is at the ends of its parts."""

    motion: Motion
    times: Array  # (parts + 1,) [s]


def motion_in_parts(
    path: FlatPath,
    requirements: Requirements,
    ends: Array,
    durations: Array,
    check_total: Callable[[float], None],
) -> PartedMotion:
    """Return the fastest motion along a path whose parts take their smallest durations, or longer.

    Parts that would be shorter are flown at a smaller speed, which is found by a few profiles, and
    then by a few motions.

    Parameters
    ----------
    ends: (parts + 1,), path parameters at which the parts start and end, from 0 to 1.
    durations: (parts,) [s], smallest durations; 0 for none.
    check_total: called with an estimate of the whole duration [s], with about its lower bound, and
        with the duration.

    Raises
    ------
    TimingError: no timing was found.
    """
    pace = Pace(tuple(ends.tolist()), durations / np.diff(ends))
    for _ in range(MAX_PACES):
        current = pace
        times = PacedTiming(path, requirements, current).estimated_times
        pace = current.adjusted(times, durations)
        if pace is current:
            break
    check_total(float(times[-1]))
    gain = MAX_PACE_GAIN if np.any(durations) else 0.0
    for timed in range(MAX_TIMINGS):
        current = pace
        timing = PacedTiming(path, requirements, current)
        if timed == 0:
            check_total((1.0 - gain) * timing.peaked.fastest.motion.duration)
        fastest, clock = timing.motion
        motion = within_limits(fastest)
        inner = clock.times_at(ends[1:-1]) * (motion.duration / fastest.duration)
        times = np.concatenate([[0.0], inner, [motion.duration]])
        pace = current.adjusted(times, durations)
        if pace is current:
            break
    factor = max(1.0, float(np.max(durations / np.diff(times))))
    factor = calm_stretch(motion, factor) if factor > 1.0 else factor
    check_total(factor * motion.duration)
    return PartedMotion(motion.slowed(factor), factor * times)


def stated_motion(path: Path, duration: float, requirements: Requirements) -> ClockedMotion:
    """Return the motion along a path whose s is time, in its duration [s], whatever its limits."""
    clock = even_clock(duration, path.vertices.breaks)
    while True:
        motion = motion_by(path, requirements, clock)
        if motion.drones.pieces >= MAX_PIECES or cable_error(motion) <= MAX_CABLE_ERROR:
            return ClockedMotion(motion, clock)
        clock = replace(clock, knots=divided(clock.knots, np.full(len(clock.knots) - 1, 2)))


def clocked_limits(path: FlatPath, requirements: Requirements) -> Limits:
    """Return the limits of motion of the clock, with the smallest thrust on the path at rest."""
    demands = demands_along(path, requirements.limits, TIMING_GRID)
    smallest = float(np.min(length(demands.loads) / path.team.mass))
    return requirements.limits.of_clocks(smallest)


def within_limits(motion: Motion, duration: float | None = None) -> Motion:
    """Return a motion slowed down until its limits hold, or in a prescribed duration [s].

    Raises
    ------
    InfeasibleError: ``duration`` is shorter than the limits permit, or with it vertices swing
        farther than they do.
    """
    fastest = needed_stretch(motion)
    if duration is None:
        calm = calm_stretch(motion, fastest) * motion.duration
        return in_duration(motion, max(calm, MIN_DURATION))
    check_duration(duration, fastest * motion.duration)
    timed = in_duration(motion, duration)
    check_swing(timed)
    return timed


def motion_by(path: FlatPath, requirements: Requirements, clock: Clock) -> Motion:
    """Return the motion with the path's value and three derivatives at every breakpoint."""
    breaks = clock.breaks
    progress = clock.jets()
    s = np.clip(progress[:, 0], 0.0, 1.0)
    s[0] = 0.0
    s[-1] = 1.0
    jets = path_jets(path, s)
    rows = np.concatenate([jet.reshape(len(s), -1, 4) for jet in jets], axis=1)
    curves = PiecewisePolynomial.through_jets(breaks, chained(rows, progress[:, None]))
    drones, vertices, legs, tensions = curves.split([jet.shape[1:-1] for jet in jets])
    is_constant = not jets.tensions[..., 1:].any() and (jets.tensions == jets.tensions[0]).all()
    if is_constant:
        tensions = PiecewisePolynomial.constant(breaks, jets.tensions[0, :, 0])
    return Motion(path.team, requirements, drones, vertices, legs, tensions, phases=())


def cable_error(motion: Motion) -> float:
    """Return the largest relative error of a cable's length at samples."""
    team = motion.team
    vertices = _sampled(motion.vertices)
    legs = _sampled(motion.drones) - vertices[:, team.layout.anchors]
    ratios = weight_ratios(team, _sampled(motion.tensions))
    cables: Array = cable_of(legs[:, 0::2], ratios) + cable_of(legs[:, 1::2], ratios)
    cables += cable_of(team.layout.edges(vertices), ratios)
    return float(np.abs(cables / team.cable_length - 1.0).max())


CABLE_SAMPLES = np.array([0.0, 0.1, 0.3, 0.5, 0.7, 0.9, 1.0])
"""Local parameters in pieces at which lengths of cables are computed."""


def _sampled(part: PiecewisePolynomial) -> Array:
    """Return the values (pieces · samples, *shape) at CABLE_SAMPLES."""
    coefficients = part.coefficients
    basis = bernstein.basis(CABLE_SAMPLES, coefficients.shape[-1] - 1)
    values = bernstein.transform(coefficients, basis)
    return by_piece(values).reshape(-1, *part.shape)
