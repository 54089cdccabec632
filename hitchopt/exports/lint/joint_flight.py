"""Scan the drones' joint flight: limits, separation and jumps, bounded for all t."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from hitchopt import units
from hitchopt.checks import acceleration, separation, speed
from hitchopt.checks.certificate import Check
from hitchopt.errors import FileError, UnitWarning
from hitchopt.exports.lint.findings import FARTHEST, Loaded
from hitchopt.exports.lint.show_limits import DISTANCE, ShowLimits
from hitchopt.hitch import Swarm
from hitchopt.motion.motion import Motion
from hitchopt.requirements import Limits, Requirements, Separation
from hitchopt.trajectory import PiecewisePolynomial, joined
from hitchopt.values import Array

SAME_START = 1e-3
"""[m] Drones that begin this close to one another are given relative trajectories."""

SHORTEST = 1e-9
"""[s] Shortest piece: rates over shorter times overflow."""

SPEED, ACCELERATION = 3.0, 10.0
"""[m/s], [m/s²] Default limits."""


@dataclass(frozen=True)
class Rules:
    """Limits of the drones' flight.

    Attributes
    ----------
    speed: [m/s], of every drone; None: the show's own limits alone, or SPEED where it has none.
    acceleration: [m/s²], of every drone; None: the show's own, or ACCELERATION.
    separation: of any two drones.
    jumps: between pieces, of position [m], velocity [m/s], acceleration [m/s²]: beyond the first a
        flight is expected to fail, beyond the others to shake.
    """

    speed: float | None = None
    acceleration: float | None = None
    separation: Separation = field(default_factory=Separation)
    jumps: tuple[float, float, float] = (2e-3, 0.1, 2.0)

    def limits(self, own: ShowLimits) -> tuple[float, float]:
        """Return the limits of speed and acceleration for a show; inf where its own stand alone."""
        given = ((self.speed, SPEED), (self.acceleration, ACCELERATION))
        speed, acceleration = (
            limit if limit is not None else math.inf if own.limits(order) else default
            for order, (limit, default) in enumerate(given, 1)
        )
        return speed, acceleration


@dataclass
class Seen:
    """Results over the windows so far."""

    checks: dict[str, list[Check]]
    jumps: list[tuple[float, str, float]]
    limits: tuple[float, float]
    reach: tuple[float, str] = (0.0, "")
    first: Array | None = None
    start: float = 0.0
    longest: float = 0.0
    last: PiecewisePolynomial | None = None


def seen_together(loaded: Loaded, rules: Rules) -> Seen:
    """Return the results for all drones over all windows.

    Raises
    ------
    FileError: the files are damaged further on, or hold what no drone flies.
    """
    recording = loaded.recording
    seen = Seen({}, [(0.0, "", 0.0)] * (recording.smooth + 1), rules.limits(loaded.own))
    for window in recording.windows():
        _look(seen, window, loaded, rules)
    return seen


def _look(seen: Seen, window: PiecewisePolynomial, loaded: Loaded, rules: Rules) -> None:
    names = loaded.recording.names
    reach = np.max(np.abs(window.coefficients), axis=(0, 2, 3))
    if np.max(reach) > FARTHEST:
        name = names[int(np.argmax(reach))]
        raise FileError(f"{name} goes {np.max(reach):.3g} m from the origin; units are metres")
    if np.min(window.durations) < SHORTEST:
        at = float(window.breaks[np.argmin(window.durations)])
        raise FileError(
            f"a piece lasts {np.min(window.durations):.2g} s at t = {at:g} s; leave it out"
        )
    if seen.first is None:
        seen.first, seen.start = window.coefficients[0, ..., 0], float(window.breaks[0])
    most = (units.SPEED.possible[1], units.ACCELERATION.possible[1])
    fastest, steepest = map(min, seen.limits, most)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UnitWarning)  # a show may have no limit
        limits = Limits(speed=fastest, acceleration=steepest)
    requirements = Requirements(limits, rules.separation)
    motion = Motion.single(Swarm(len(names)), requirements, window, ())
    found: dict[str, Check | None] = {"speed": speed.RULE.check(motion)}
    if len(names) > 1 and loaded.together and not at_one_point(seen.first):
        found["separation"] = separation.RULE.check(motion)
        least = loaded.own.bounds.get(DISTANCE)
        if least is not None:
            apart = replace(requirements, separation=Separation(0.5 * least, 0.5 * least))
            wider = replace(motion, requirements=apart)
            found[DISTANCE] = _in_metres(separation.RULE.check(wider), least)
    if loaded.recording.smooth > 0:
        found["acceleration"] = acceleration.RULE.check(motion)
    for name, check in found.items():
        if check is not None:
            seen.checks.setdefault(name, []).append(_renamed(check, names))
    for name, check in loaded.own.checks(window, loaded.recording.smooth, names).items():
        seen.checks.setdefault(name, []).append(check)
    whole = window if seen.last is None else joined([seen.last, window])
    for order in range(len(seen.jumps)):
        seen.jumps[order] = max(seen.jumps[order], _jump(whole, order, names))
    seen.reach = max(seen.reach, (float(np.max(reach)), names[int(np.argmax(reach))]))
    seen.longest = max(seen.longest, float(np.max(window.durations)))
    seen.last = window.taken(slice(window.pieces - 1, window.pieces))


def at_one_point(first: Array) -> bool:
    """Return whether several drones (D, 3) begin at one point, each having an origin of its own."""
    return len(first) > 1 and float(np.max(np.ptp(first, axis=0))) < SAME_START


def _in_metres(check: Check | None, least: float) -> Check | None:
    """Return a check of a ratio to the distance ``least`` [m] as one of that distance."""
    if check is None:
        return None
    return Check.of(DISTANCE, check.bound * least, least, "min", "m", check.time, check.where)


def _renamed(check: Check, names: Sequence[str]) -> Check:
    """Return the check with the files' names for drones d0, d1, …."""
    return replace(check, where=tuple(names[int(drone[1:])] for drone in check.where))


def _jump(
    window: PiecewisePolynomial, order: int, names: Sequence[str]
) -> tuple[float, str, float]:
    """Return the largest jump of a derivative where pieces join, whose it is, and when."""
    left, right = window.ends(order)
    sizes = np.linalg.norm(left[1:] - right[:-1], axis=-1)
    if sizes.size == 0:
        return (0.0, "", 0.0)
    joint, drone = np.unravel_index(int(np.argmax(sizes)), sizes.shape)
    return (float(sizes[joint, drone]), names[int(drone)], float(window.breaks[1 + int(joint)]))
