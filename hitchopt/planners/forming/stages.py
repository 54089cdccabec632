"""Stages of forming, two swaps, tightening and tension, and of releasing, the reverse."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from hitchopt.checks.clearance import above_ground
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.requirements import Limits, Requirements
from hitchopt.motion.loads import tautness
from hitchopt.motion.motion import CableState, Motion, Phase
from hitchopt.planners.forming import SwapSettings
from hitchopt.planners.forming.prehitch import PreHitch, SwapEllipses, clasp_points
from hitchopt.planners.timing.flight import turning_stretch
from hitchopt.planners.timing.profile import LIMIT_SHARE, usable_accelerations
from hitchopt.planners.timing.ramps import fastest_clock, timed_curve
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array

MIN_RISE_SECONDS = 1.0
"""[s] Shortest rise of the tensions, against which drones tilt."""

MIN_RISE_PERIODS = 3.0
"""Shortest rise of the tensions over the longest period of a cable (see ``rise_seconds``)."""

SMOOTH = np.array([0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0])
"""Bernstein coefficients of a rise from 0 to 1 with three zero derivatives at both ends."""

BACKWARD = {"swap 1": "unswap 2", "swap 2": "unswap 1", "tighten": "loosen", "tension": "relax"}
BACKWARD |= {"draw taut": "slacken", "slide in": "slide out", "lay": "lift", "roll": "unroll"}
BACKWARD |= {
    "approach": "leave",
    "open": "close",
    "lower": "raise",
    "pass weight": "pass weight back",
}
"""Names of reversed stages of forming."""


def forming_stages(
    prehitch: PreHitch,
    hitch: Hitch,
    requirements: Requirements,
    settings: SwapSettings,
    index: int = 0,
) -> list[Motion]:
    """Return the motions from the pre-hitch to the hitch with the team's tensions.

    While drones move out, clasps move on lines too. Their ends are within reach of all cables, and
    since the lengths of routes are convex, so are the points between.

    Parameters
    ----------
    index: of the step in its mission.
    """
    team, limits, context = hitch.team, requirements.limits, (hitch.team, requirements, index)
    # Upper bound of the drones' motion for any polygon.
    distance = (1.0 - prehitch.share) * float(np.max(hitch.legs))
    progress = _progress(team, limits, prehitch.drones, hitch.drones, distance)
    clasps = _on_lines(progress, clasp_points(prehitch.ellipses, hitch), hitch.vertices)
    swaps = [swap(prehitch.ellipses, limits, first, settings.seconds) for first in (0, 1)]
    rest = np.array([0.0, rise_seconds(team)])
    drones, points, legs = (
        PiecewisePolynomial.constant(rest, value)
        for value in (hitch.drones, hitch.vertices, hitch.legs)
    )
    tensions = PiecewisePolynomial(rest, (team.tension[:, None] * SMOOTH)[None])
    curves: dict[str, Any] = {"vertices": points, "legs": legs, "tensions": tensions}
    outward = _on_lines(progress, prehitch.drones, hitch.drones)
    return [
        *(
            stage(
                f"swap {k}",
                turning,
                *context,
                CableState.CLASPING,
                vertices=PiecewisePolynomial.constant(turning.breaks, hitch.vertices),
            )
            for k, turning in enumerate(swaps, 1)
        ),
        stage("tighten", outward, *context, CableState.TIGHTENING, vertices=clasps),
        stage("tension", drones, *context, state=CableState.HITCHED, **curves),
    ]


def stage(
    name: str,
    drones: PiecewisePolynomial,
    team: Team,
    requirements: Requirements,
    index: int = 0,
    state: CableState = CableState.FREE,
    **curves: Any,
) -> Motion:
    """Return the motion of drones from rest to rest, as one phase of forming or releasing.

    The state GROUND becomes FREE if all cables are clear of the ground. The motion is slowed down
    to the limit of the body rate.

    Parameters
    ----------
    name: of the phase.
    drones: (2n, 3) [m], from t = 0.
    index: of the step in its mission.
    state: of the cables.
    curves: polynomials of vertices, legs and tensions, if the state has them.
    """
    phase = Phase(name, index, 0.0, drones.duration, state=state)
    motion = replace(Motion.single(team, requirements, drones, [phase]), **curves)
    if state is CableState.GROUND and above_ground(motion):
        motion = replace(motion, phases=(replace(phase, state=CableState.FREE),))
    limit = requirements.limits.body_rate
    if limit is None:
        return motion
    pulls = np.where(motion.formed[:, None, None], motion.pulls.coefficients, 0.0)
    forces = (PiecewisePolynomial(drones.breaks, c) for c in (pulls, tautness(motion)))
    factor = turning_stretch(team, limit, (drones, motion.vertices, *forces))
    return motion.slowed(factor) if 1.0 < factor < math.inf else motion


def rise_seconds(team: Team) -> float:
    """Return the rise time [s] of the tensions after which vertices are nearly at rest.

    The tensions lift sagging cables, which swing after a fast rise. The longest period of a regular
    hitch is that of its cables as strings with fixed ends, ``2 √(L m / T)``, where m is the mass of
    the cable and of half the load at each of its clasps. After a rise along ``SMOOTH`` over at
    least 2.2 periods the residual amplitude of an oscillator is at most 2.2 % of the lift. Three
    periods allow for the longer periods at low tensions.
    """
    layout = team.layout
    cables, halves = np.append(layout.ahead, layout.behind), np.tile(0.5 * team.load, 2)
    loads = np.bincount(cables, halves, team.robots)
    masses = team.cable_density * team.cable_length + loads
    periods = 2.0 * np.sqrt(team.cable_length * masses / team.tension)
    return max(MIN_RISE_SECONDS, MIN_RISE_PERIODS * float(np.max(periods)))


def reversed_stages(stages: Sequence[Motion]) -> list[Motion]:
    """Return the time-reversed motions of forming, which release the hitch."""
    return [
        each.map_curves(
            lambda part: part.reversed(),
            [replace(phase, name=BACKWARD[phase.name]) for phase in each.phases],
        )
        for each in reversed(stages)
    ]


# Flights of drones: half a turn of all pairs, and straight lines.

MAX_PIECE_ANGLE = 0.3
"""[rad] Largest angle on one polynomial of degree 7, which is within 1e-9 of the ellipse."""

TURNING_SHARES = (0.25, 0.35, 0.45, 0.55, 0.65, 0.75, 0.85)
"""Shares of the acceleration that are centripetal at full speed; the rest is tangential."""

JERK_SHARE = 0.7
"""Share of the jerk for the angle's own rate."""

ANGLES, LINE_SAMPLES = 25, 9
"""Numbers of angles, and of points on a line, at which usable accelerations are computed."""

MIN_FLIGHT = 1e-9
"""[m] Shortest distance of a flight."""

PAUSE = 0.01
"""[s] Duration of a flight in which no drone moves."""


def swap(
    ellipses: SwapEllipses, limits: Limits, first: int, seconds: float | None
) -> PiecewisePolynomial:
    """Return the drones (2n, 3) [m] on half a turn of all pairs at once, from rest to rest.

    The turn is as fast as the limits of every drone's speed, acceleration and jerk allow.

    Parameters
    ----------
    ellipses: of all pairs.
    limits: of every drone.
    first: 0 for the turn from θ = 0, 1 for the one from θ = π.
    seconds: shortest duration [s], or None.
    """
    start = first * math.pi
    angles = np.linspace(start, start + math.pi, ANGLES)
    usable = float(np.min(usable_accelerations(ellipses.team, limits, ellipses.drones(angles))))
    size = float(max(np.max(ellipses.half), np.max(np.abs(ellipses.rise))))

    def half_turn(share: float) -> PiecewisePolynomial:
        """Return the turn with a centripetal share of the acceleration, within drones' limits."""
        speed = min(limits.speed / size, math.sqrt(share * usable / size))
        tangential = math.sqrt(max(usable * usable - (speed * speed * size) ** 2, 1e-12)) / size
        clock = fastest_clock(math.pi, speed, tangential, JERK_SHARE * limits.jerk / size)
        return timed_curve(
            lambda at, k: ellipses.drones(start + at, k), clock, MAX_PIECE_ANGLE, limits, usable
        )

    best = min(map(half_turn, TURNING_SHARES), key=lambda drones: drones.duration)
    return best.stretched(max(1.0, (seconds or 0.0) / best.duration))


def straight_lines(team: Team, limits: Limits, start: Array, end: Array) -> PiecewisePolynomial:
    """Return the drones (2n, 3) [m] on straight lines, synchronized and from rest to rest."""
    return _on_lines(_progress(team, limits, start, end), start, end)


def _progress(
    team: Team, limits: Limits, start: Array, end: Array, min_distance: float = 0.0
) -> PiecewisePolynomial:
    """Return the progress along straight lines, from 0 to 1.

    It is timed for the longest line, but for no less than ``min_distance`` [m].
    """
    distance = float(np.max(np.linalg.norm(end - start, axis=1)))
    if distance < MIN_FLIGHT:
        return PiecewisePolynomial.constant([0.0, PAUSE], 1.0)
    share = np.linspace(0.0, 1.0, LINE_SAMPLES)[:, None, None]
    usable = float(np.min(usable_accelerations(team, limits, start + share * (end - start))))
    length = max(distance, min_distance)
    clock = fastest_clock(length, LIMIT_SHARE * limits.speed, usable, LIMIT_SHARE * limits.jerk)
    share = clock.coefficients / clock.coefficients[-1, -1]
    return PiecewisePolynomial(clock.breaks, np.clip(share, 0.0, 1.0))  # rounding: not below floors


def _on_lines(progress: PiecewisePolynomial, start: Array, end: Array) -> PiecewisePolynomial:
    """Return points (k, 3) [m] on straight lines at a progress from 0 to 1."""
    s = progress.coefficients[:, None, None, :]
    return PiecewisePolynomial(progress.breaks, start[..., None] * (1.0 - s) + end[..., None] * s)
