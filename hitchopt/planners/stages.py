"""Stages of forming and, in reverse, of releasing; flights of drones with hanging cables."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple, TypeVar

import numpy as np

from hitchopt.checks.hanging import above_ground
from hitchopt.errors import InfeasibleError, Violation, check_time
from hitchopt.geometry.vectors import length
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.catenary import Catenary, bounded_radius
from hitchopt.hitch.requirements import HANGING, Limits, Requirements
from hitchopt.motion.cable_state import CableState
from hitchopt.motion.motion import Motion, Phase
from hitchopt.planners.morph.morph import POSITION_TOLERANCE
from hitchopt.planners.timing.profile import LIMIT_SHARE, usable_accelerations
from hitchopt.planners.timing.ramps import fastest_clock
from hitchopt.planners.timing.stretch import further_stretch
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.trajectory.piecewise import joined
from hitchopt.values import Array
from hitchopt.values.fields import with_fields

T = TypeVar("T")

MIN_RISE_SECONDS = 1.0  # [s] Shortest rise of the tensions, against which drones tilt

MIN_RISE_PERIODS = 3.0
"""Shortest rise of the tensions over the longest period of a cable (see ``rise_seconds``)."""

SMOOTH = np.array([0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0])
"""Bernstein coefficients of a rise from 0 to 1 with three zero derivatives at both ends."""

BACKWARD = {
    "swap 1": "unswap 2",
    "swap 2": "unswap 1",
    "tighten": "loosen",
    "tension": "relax",
    "approach": "leave",
    "lower": "raise",
}
"""Names of reversed stages of forming."""


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
    to the limits that no clock bounds, as of body rates.

    Parameters
    ----------
    name: of the phase.
    drones: (2n, 3) [m], from t = 0.
    index: of the step in its mission.
    state: of the cables.
    curves: polynomials of vertices, legs and tensions, if the state has them.
    """
    phase = Phase(name, index, 0.0, drones.duration, state=state)
    motion = Motion.single(team, requirements, drones, [phase]).replaced(**curves)
    if state.on_ground and above_ground(motion):
        motion = replace(motion, phases=(replace(phase, state=CableState.FREE),))
    factor = further_stretch(motion)
    return motion.slowed(factor) if 1.0 < factor < math.inf else motion


class Keyframe(NamedTuple):
    """The end of a stage in which drones fly on straight lines, with their cables in one state."""

    name: str  # Name of the phase
    drones: Array  # (2n, 3) [m]
    state: CableState = CableState.FREE  # State of the cables


def straight_stages(
    start: Array, keyframes: Iterable[Keyframe], team: Team, requirements: Requirements, index: int
) -> list[Motion]:
    """Return the stages from a start (2n, 3) [m] to each keyframe; none where no drone moves."""
    stages = list[Motion]()
    for name, drones, state in keyframes:
        if np.max(np.abs(drones - start)) >= POSITION_TOLERANCE:
            lines = straight_lines(team, requirements.limits, start, drones)
            stages.append(stage(name, lines, team, requirements, index, state))
        start = drones
    return stages


def tension_stage(
    hitch: Hitch,
    drones: Array,
    legs: Array,
    seconds: float,
    requirements: Requirements,
    index: int,
    state: CableState,
    start: Array | float = 0.0,
) -> Motion:
    """Return the stage in which tensions rise from ``start`` (n,) [N] to those of a hitch.

    Its drones (2n, 3) [m] and vertices are at rest.
    """
    team = hitch.team
    breaks = np.array([0.0, seconds])
    first = np.broadcast_to(start, team.robots)[:, None]
    rising = first + (team.tension[:, None] - first) * SMOOTH  # (n, coefficients)
    return stage(
        "tension",
        PiecewisePolynomial.constant(breaks, drones),
        team,
        requirements,
        index,
        state,
        vertices=PiecewisePolynomial.constant(breaks, hitch.vertices),
        legs=PiecewisePolynomial.constant(breaks, legs),
        tensions=PiecewisePolynomial(breaks, rising[None]),
    )


def best(candidates: Iterable[tuple[float, T]], enough: float) -> T:
    """Return the first candidate with a margin of at least ``enough``, or the one with the most.

    Raises ValueError without a candidate.
    """
    largest: tuple[float, T] | None = None
    for margin, candidate in candidates:
        check_time()
        if largest is None or margin > largest[0]:
            largest = margin, candidate
        if largest[0] >= enough:
            break
    if largest is None:
        raise ValueError("no candidate")
    return largest[1]


def rise_seconds(team: Team) -> float:
    """Return the rise time [s] of the tensions after which vertices are nearly at rest.

    The tensions lift sagging cables, which swing after a fast rise. The longest period of a regular
    hitch is that of its cables as strings with fixed ends, ``2 √(L m / T)``, where m is the mass of
    the cable and of half the load at each of its clasps. After a rise along ``SMOOTH`` over at
    least 2.2 periods the residual amplitude of an oscillator is at most 2.2 % of the lift. Three
    periods allow for the longer periods at low tensions.
    """
    layout = team.layout
    cables_at_clasps = np.append(layout.ahead, layout.behind)
    half_loads = np.tile(0.5 * team.load, 2)
    loads = np.bincount(cables_at_clasps, half_loads, team.robots)
    masses = team.cable_density * team.cable_length + loads
    periods = 2.0 * np.sqrt(team.cable_length * masses / team.tension)
    return max(MIN_RISE_SECONDS, MIN_RISE_PERIODS * float(np.max(periods)))


def reversed_stages(stages: Sequence[Motion]) -> list[Motion]:
    """Return the time-reversed motions of forming, which release the hitch."""
    backward = list[Motion]()
    for motion in reversed(stages):
        phases = [replace(phase, name=BACKWARD[phase.name]) for phase in motion.phases]
        backward.append(motion.map_curves(lambda curve: curve.reversed(), phases))
    return backward


# Flights on straight lines, and hovering.

GROUND_CLEARANCE = 1.1
"""Height of hanging cables above the ground, over ``Requirements.ground_clearance``."""

JOINT_RESERVE = 2e-3
"""[m] Reserve for bounds of ``tracking_radius``, which are lower than values at samples."""

SLACK_SAMPLES = 201  # Number of samples of a motion that makes cables taut
PAUSE = 0.01  # [s] Duration of a flight in which no drone moves


def straight_lines(team: Team, limits: Limits, start: Array, end: Array) -> PiecewisePolynomial:
    """Return the drones (2n, 3) [m] on straight lines, synchronised and from rest to rest."""
    return on_lines(line_progress(team, limits, start, end), start, end)


def line_progress(
    team: Team, limits: Limits, start: Array, end: Array, min_distance: float = 0.0
) -> PiecewisePolynomial:
    """Return the progress along straight lines, from 0 to 1.

    It is timed for the longest line, or for ``min_distance`` [m] if that is longer.
    """
    distance = float(np.max(np.linalg.norm(end - start, axis=1)))
    if distance < POSITION_TOLERANCE:
        return PiecewisePolynomial.constant([0.0, PAUSE], 1.0)
    shares = np.linspace(0.0, 1.0, 9)[:, None, None]
    on_line = start + shares * (end - start)
    usable = float(np.min(usable_accelerations(team, limits, on_line)))
    clock = fastest_clock(
        max(distance, min_distance),
        LIMIT_SHARE * limits.speed,
        usable,
        LIMIT_SHARE * limits.jerk,
    )
    progress = clock.coefficients / clock.coefficients[-1, -1]
    # Rounding would lead below the floor
    return PiecewisePolynomial(clock.breaks, np.clip(progress, 0.0, 1.0))


def tightening_progress(
    team: Team,
    limits: Limits,
    start: Array,
    end: Array,
    slack: Array,
    error: float,
    speed: float,
    min_distance: float = 0.0,
) -> PiecewisePolynomial:
    """Return the progress along straight lines on which cables become taut, from 0 to 1.

    Parameters
    ----------
    team, limits, start, end, min_distance: as of ``line_progress``.
    slack: (S,) [m], length that the tautest cable lacks, at equal steps of the progress.
    error: largest position error of a drone [m]; 0 counts for no motion.
    speed: largest speed of drones [m/s] from where two errors could pull a cable taut.
    """
    if not error:
        return line_progress(team, limits, start, end, min_distance)
    shares = np.linspace(0.0, 1.0, len(slack))
    is_tight = np.append(slack <= 2.0 * error + JOINT_RESERVE, True)
    share = float(shares[max(int(np.argmax(is_tight)) - 1, 0)])
    middle = start + share * (end - start)
    slow = with_fields(limits, speed=min(limits.speed, speed))
    parts = list[PiecewisePolynomial]()
    if share > 0.0:
        first = line_progress(team, limits, start, middle, share * min_distance)
        parts.append(first.replaced(share * first.coefficients))
    if share < 1.0:
        last = line_progress(team, slow, middle, end)
        parts.append(last.replaced(share + (1.0 - share) * last.coefficients))
    return joined(parts)


def on_lines(progress: PiecewisePolynomial, start: Array, end: Array) -> PiecewisePolynomial:
    """Return points (k, 3) [m] on straight lines at a progress from 0 to 1."""
    share = progress.coefficients[:, None, None, :]
    points = start[..., None] * (1.0 - share) + end[..., None] * share
    return PiecewisePolynomial(progress.breaks, points)


def hover_altitude(team: Team, drones: Array, requirements: Requirements) -> float:
    """Return the lowest altitude [m] at which cables of drones over (…, 2n, 3) [m] hang free.

    Raises InfeasibleError where errors of position may pull a cable taut, or its drones over each
    other: its shape, and so the altitude that it needs, is then unbounded.
    """
    level = drones * np.array([1.0, 1.0, 0.0])
    altitude = missing_height(team, level, requirements)
    if math.isfinite(altitude):
        return altitude
    raise taut_by_errors(team, drones, requirements)


def taut_by_errors(team: Team, drones: Array, requirements: Requirements) -> InfeasibleError:
    """Return the error of cables of drones (…, 2n, 3) [m] that errors of position may pull taut."""
    level = drones * np.array([1.0, 1.0, 0.0])
    spans = length(level[..., 1::2, :] - level[..., 0::2, :]).reshape(-1, team.robots)
    span_range = np.min(spans, axis=0), np.max(spans, axis=0)
    radii = bounded_radius(span_range, team.cable_length, requirements.height_ratio)
    cable = int(np.argmin(radii))
    where = (team.cable_names[cable],)
    when = "between its drones' positions"
    remedy = "use a longer cable, and place its drones apart, by less than its full length"
    violation = Violation(
        "tracking_radius",
        float(radii[cable]),
        requirements.position_error,
        "min",
        "m",
        where,
        when,
        remedy,
    )
    return InfeasibleError([violation])


def ground_clearance(requirements: Requirements) -> float:
    """Return the height [m] of hanging cables above the ground that flights keep."""
    return GROUND_CLEARANCE * requirements.ground_clearance


def missing_height(team: Team, drones: Array, requirements: Requirements) -> float:
    """Return the height [m] by which hanging cables of drones (…, 2n, 3) [m] are too low.

    Position errors of drones displace cables farther. ``tracking_radius`` combines the lowest cable
    with the largest displacement of all.
    """
    q = drones[..., 0::2, :]
    r = drones[..., 1::2, :]
    cables = Catenary.between(q, r, team.cable_length)
    ratio = requirements.height_ratio
    lowest = q[..., 2] + cables.lowest
    sinking = ratio * cables.extra_displacement(requirements.position_error, ratio)
    lowest_cable = float(np.min(lowest - sinking)) - ground_clearance(requirements)
    lowest_with_largest = float(np.min(lowest) - np.max(sinking)) - JOINT_RESERVE
    lowest_counted = lowest_with_largest - requirements.ground_clearance
    return requirements.ground_for(HANGING) - min(lowest_cable, lowest_counted)
