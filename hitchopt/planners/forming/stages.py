"""Stages of forming and releasing: swap, swap, tighten, pull; and backward."""

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
from hitchopt.planners.forming.prehitch import PreHitch, SwapEllipses, clasp_places
from hitchopt.planners.timing.flight import turning_stretch
from hitchopt.planners.timing.profile import LIMIT_SHARE, usable_accelerations
from hitchopt.planners.timing.ramps import fastest_clock, timed_curve
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array

PULL_SECONDS = 1.0
"""[s] Shortest rise of the tensions, against which drones tilt."""

PULL_PERIODS = 3.0
"""Shortest rise of the tensions over the longest period of a cable (see ``rise_seconds``)."""

SMOOTH = np.array([0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0])
"""Bernstein coefficients of the rise from 0 to 1 with three derivatives zero at both ends."""

BACKWARD = {"swap 1": "unswap 2", "swap 2": "unswap 1", "tighten": "loosen", "tension": "relax"}
BACKWARD |= {"draw taut": "slacken", "slide in": "slide out", "lay": "lift", "roll": "unroll"}
BACKWARD |= {
    "approach": "leave",
    "open": "close",
    "lower": "raise",
    "pass weight": "pass weight back",
}
"""Names of the stages of forming when they are reversed."""


def forming_stages(
    prehitch: PreHitch,
    hitch: Hitch,
    requirements: Requirements,
    settings: SwapSettings,
    index: int = 0,
) -> list[Motion]:
    """Return the motions from the pre-hitch to the hitch, pulled by the team's tension.

    On their way out clasps move along with the drones, between places that all cables reach around
    at both ends: lengths are convex, so that cables reach in between.

    Parameters
    ----------
    index: of the step in its mission.
    """
    team, limits, own = hitch.team, requirements.limits, (hitch.team, requirements, index)
    # No drone goes farther than this, whatever the polygon.
    shorter = (1.0 - prehitch.share) * float(np.max(hitch.legs))
    out = _progress(team, limits, prehitch.drones, hitch.drones, shorter)
    drawn = _on_lines(out, clasp_places(prehitch.ellipses, hitch), hitch.vertices)
    swaps = [swap(prehitch.ellipses, limits, first, settings.seconds) for first in (0, 1)]
    rest = np.array([0.0, rise_seconds(team)])
    still, points, legs = (
        PiecewisePolynomial.constant(rest, value)
        for value in (hitch.drones, hitch.vertices, hitch.legs)
    )
    tensions = PiecewisePolynomial(rest, (team.tension[:, None] * SMOOTH)[None])
    hitched: dict[str, Any] = {"vertices": points, "legs": legs, "tensions": tensions}
    tightened = _on_lines(out, prehitch.drones, hitch.drones)
    return [
        *(
            stage(
                f"swap {k}",
                drones,
                *own,
                CableState.CLASPING,
                vertices=PiecewisePolynomial.constant(drones.breaks, hitch.vertices),
            )
            for k, drones in enumerate(swaps, 1)
        ),
        stage("tighten", tightened, *own, CableState.TIGHTENING, vertices=drawn),
        stage("tension", still, *own, state=CableState.HITCHED, **hitched),
    ]


def stage(
    name: str,
    drones: PiecewisePolynomial,
    team: Team,
    requirements: Requirements,
    index: int = 0,
    state: CableState = CableState.FREE,
    **further: Any,
) -> Motion:
    """Return the motion of drones from rest to rest, as one phase of forming or releasing.

    Cables that are meant to lie on the ground hang free where they are clear of it. The motion is
    slowed until no thrust turns faster than allowed.

    Parameters
    ----------
    name: of the phase.
    drones: (2n, 3) [m], from t = 0.
    index: of the step in its mission.
    state: of the cables.
    further: polynomials of vertices, legs and tensions, where they have a meaning.
    """
    phase = Phase(name, index, 0.0, drones.duration, state=state)
    motion = replace(Motion.single(team, requirements, drones, [phase]), **further)
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
    """Return how long the tensions rise, so that vertices hang still at the end [s].

    Cables sag until tension comes, and what lifts them fast leaves them swinging. The slowest swing
    of a regular hitch is that of its cables as strings, ends at rest: a wave runs to and fro in
    ``2 √(L m / T)``, m being the mass of the cable and of half the load at each of its clasps.
    After a rise along ``SMOOTH`` over 2.2 periods or more an oscillator keeps 2.2 % of the lift at
    most; three periods allow for the tensions that are still low, at which it is slower.
    """
    layout = team.layout
    meet, halves = np.append(layout.ahead, layout.behind), np.tile(0.5 * team.load, 2)
    loads = np.bincount(meet, halves, team.robots)
    masses = team.cable_density * team.cable_length + loads
    periods = 2.0 * np.sqrt(team.cable_length * masses / team.tension)
    return max(PULL_SECONDS, PULL_PERIODS * float(np.max(periods)))


def reversed_stages(stages: Sequence[Motion]) -> list[Motion]:
    """Return the motions of forming backward in time, which release the hitch."""
    return [
        each.map_curves(
            lambda part: part.reversed(),
            [replace(phase, name=BACKWARD[phase.name]) for phase in each.phases],
        )
        for each in reversed(stages)
    ]


# Flights of drones: half a turn of all pairs, and straight lines.

PIECE = 0.3
"""[rad] Largest angle on one polynomial of degree 7, which is within 1e-9 of the ellipse."""

TURNING_SHARES = (0.25, 0.35, 0.45, 0.55, 0.65, 0.75, 0.85)
"""Shares of the acceleration that turning takes at full speed; the rest is for speeding up."""

JERK_SHARE = 0.7
"""Share of the jerk that the angle's own rate takes."""

ANGLES, PROBES = 25, 9
"""Numbers of angles, and of places on a line, at which the drones' reserves are computed."""

MIN_FLIGHT = 1e-9
"""[m] Shortest distance that is flown."""

PAUSE = 0.01
"""[s] Duration of a flight in which no drone moves."""


def swap(
    ellipses: SwapEllipses, limits: Limits, first: int, seconds: float | None
) -> PiecewisePolynomial:
    """Return the drones (2n, 3) [m] on half a turn, from rest to rest.

    As fast as the limits of every drone's speed, acceleration and jerk allow, whatever their
    number: pairs move at the same time.

    Parameters
    ----------
    ellipses: of all pairs.
    limits: of every drone.
    first: 0 for the turn from θ = 0, 1 for the one from θ = π.
    seconds: no faster than this [s], or None.
    """
    start = first * math.pi
    angles = np.linspace(start, start + math.pi, ANGLES)
    reserve = float(np.min(usable_accelerations(ellipses.team, limits, ellipses.drones(angles))))
    size = float(max(np.max(ellipses.half), np.max(np.abs(ellipses.rise))))

    def half_turn(share: float) -> PiecewisePolynomial:
        """Return the turn whose angle is limited by the share, slowed to the drones' limits."""
        speed = min(limits.speed / size, math.sqrt(share * reserve / size))
        spare = math.sqrt(max(reserve * reserve - (speed * speed * size) ** 2, 1e-12)) / size
        clock = fastest_clock(math.pi, speed, spare, JERK_SHARE * limits.jerk / size)
        return timed_curve(
            lambda at, k: ellipses.drones(start + at, k), clock, PIECE, limits, reserve
        )

    best = min(map(half_turn, TURNING_SHARES), key=lambda drones: drones.duration)
    return best.stretched(max(1.0, (seconds or 0.0) / best.duration))


def straight_lines(team: Team, limits: Limits, start: Array, end: Array) -> PiecewisePolynomial:
    """Return the drones (2n, 3) [m] on straight lines, from rest to rest at the same times."""
    return _on_lines(_progress(team, limits, start, end), start, end)


def _progress(
    team: Team, limits: Limits, start: Array, end: Array, least: float = 0.0
) -> PiecewisePolynomial:
    """Return the share of straight lines that is flown, from 0 to 1.

    The farthest drone goes ``least`` [m] at least, as far as the clock is concerned.
    """
    distance = float(np.max(np.linalg.norm(end - start, axis=1)))
    if distance < MIN_FLIGHT:
        return PiecewisePolynomial.constant([0.0, PAUSE], 1.0)
    share = np.linspace(0.0, 1.0, PROBES)[:, None, None]
    reserve = float(np.min(usable_accelerations(team, limits, start + share * (end - start))))
    clock = fastest_clock(
        max(distance, least), LIMIT_SHARE * limits.speed, reserve, LIMIT_SHARE * limits.jerk
    )
    share = clock.coefficients / clock.coefficients[-1, -1]
    return PiecewisePolynomial(clock.breaks, np.clip(share, 0.0, 1.0))  # not through the floor


def _on_lines(share: PiecewisePolynomial, start: Array, end: Array) -> PiecewisePolynomial:
    """Return points (k, 3) [m] on their lines, by the share of these."""
    s = share.coefficients[:, None, None, :]
    return PiecewisePolynomial(share.breaks, start[..., None] * (1.0 - s) + end[..., None] * s)
