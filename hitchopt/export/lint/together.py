"""What all drones of a recording fly together: limits, separation, jumps; bounds for all t."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from hitchopt.certificate import acceleration, separation, speed
from hitchopt.certificate.report import Check, most_pressing
from hitchopt.errors import FileError
from hitchopt.export.lint.findings import (
    ERROR,
    FARTHEST,
    NOTE,
    WARNING,
    Finding,
    Flight,
    Loaded,
)
from hitchopt.export.lint.places import away_from_places
from hitchopt.export.lint.show_limits import DISTANCE, ShowLimits
from hitchopt.hitch import Limits, Separation, Swarm
from hitchopt.model.motion import SwarmMotion
from hitchopt.trajectory import PiecewisePolynomial

Array = NDArray[np.float64]

RADIOED = 32.767
"""[m] What formats of whole millimetres in 16 bits hold."""

SAME_START = 1e-3
"""[m] Drones that begin this close to one another are given relative trajectories."""

WATCHDOG = 0.5
"""[s] Without a setpoint for so long a Crazyflie levels itself."""

SLOWEST = 30.0
"""[Hz] At which full states are usefully streamed."""

SHORTEST = 1e-9
"""[s] No piece lasts less: rates over such times are no numbers any more."""

REMEDIES = {
    ("min", "ratio"): "move them apart",
    ("min", "m"): "move them apart",
    ("max", "m"): "fly lower",
}

SPEED, ACCELERATION = 3.0, 10.0
"""[m/s], [m/s²] Limits where nobody gives others."""


@dataclass(frozen=True)
class Rules:
    """What is held against the drones.

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

    def limits(self, own: ShowLimits | None) -> tuple[float, float]:
        """Return the limits of speed and acceleration for a show; inf where its own stand alone."""
        given = ((self.speed, SPEED), (self.acceleration, ACCELERATION))
        speed, acceleration = (
            limit if limit is not None else math.inf if own and own.limits(order) else default
            for order, (limit, default) in enumerate(given, 1)
        )
        return speed, acceleration


@dataclass
class _Seen:
    """What has been found so far, window by window."""

    checks: dict[str, list[Check]]
    jumps: list[tuple[float, str, float]]
    limits: tuple[float, float]
    reach: tuple[float, str] = (0.0, "")
    first: Array | None = None
    start: float = 0.0
    longest: float = 0.0
    last: PiecewisePolynomial | None = None


def flown_together(loaded: Loaded, rules: Rules) -> tuple[Flight, tuple[Finding, ...]]:
    """Return what the drones fly, and what is wrong with it.

    Raises
    ------
    FileError: the files are damaged further on.
    """
    recording = loaded.recording
    seen = _Seen({}, [(0.0, "", 0.0)] * (recording.smooth + 1), rules.limits(loaded.own))
    for window in recording.windows():
        _look(seen, window, loaded, rules)
    if seen.last is None or seen.first is None:  # a recording has windows, or raises
        raise ValueError("a recording without windows")
    worst = {name: most_pressing(checks) for name, checks in seen.checks.items()}
    kept = {name: check for name, check in worst.items() if check is not None}
    values = {name: check.worst for name, check in kept.items()}
    flight = Flight(
        float(seen.last.breaks[-1]) - seen.start,
        values.get("speed", math.nan),
        values.get("acceleration", math.nan),
        values.get("separation", math.nan) if len(recording.names) > 1 else math.inf,
        tuple(jump[0] for jump in seen.jumps),
        seen.reach[0],
        *seen.limits,
        tuple(kept[key] for key in (loaded.own.bounds if loaded.own else ()) if key in kept),
    )
    found = [
        *_broken(kept),
        *_relative(seen.first, loaded),
        *away_from_places(loaded, seen.first),
        *_jumping(seen, rules),
        *_stopping(seen.last, recording.names, rules),
        *_placed(seen, loaded),
    ]
    return flight, tuple(found)


def _look(seen: _Seen, window: PiecewisePolynomial, loaded: Loaded, rules: Rules) -> None:
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
    held = [min(limit, FARTHEST / SHORTEST) for limit in seen.limits]
    motion = SwarmMotion(
        Swarm(len(names)),
        Limits(speed=held[0], acceleration=held[1]),
        rules.separation,
        None,
        window,
        (),
    )
    found: dict[str, Check | None] = {"speed": speed.check(motion)}
    if len(names) > 1 and loaded.together and not _at_one_point(seen.first):
        found["separation"] = separation.check(motion)
        least = loaded.own.bounds.get(DISTANCE) if loaded.own else None
        if least is not None:
            apart = Separation(0.5 * least, 0.5 * least)
            found[DISTANCE] = _in_metres(separation.check(replace(motion, separation=apart)), least)
    if loaded.recording.smooth > 0:
        found["acceleration"] = acceleration.check(motion)
    for name, check in found.items():
        if check is not None:
            seen.checks.setdefault(name, []).append(_renamed(check, names))
    if loaded.own:
        for name, check in loaded.own.checks(window, loaded.recording.smooth, names).items():
            seen.checks.setdefault(name, []).append(check)
    for order in range(len(seen.jumps)):
        seen.jumps[order] = max(seen.jumps[order], _jump(seen.last, window, order, names))
    seen.reach = max(seen.reach, (float(np.max(reach)), names[int(np.argmax(reach))]))
    seen.longest = max(seen.longest, float(np.max(window.durations)))
    seen.last = window.taken(slice(window.pieces - 1, window.pieces))


def _at_one_point(first: Array) -> bool:
    return len(first) > 1 and float(np.max(np.ptp(first, axis=0))) < SAME_START


def _in_metres(check: Check | None, least: float) -> Check | None:
    """Return a check of a ratio to the distance ``least`` [m] as one of that distance."""
    if check is None:
        return None
    return Check.of(DISTANCE, check.worst * least, least, "min", "m", check.time, check.where)


def _renamed(check: Check, names: Sequence[str]) -> Check:
    """Return the check with the files' names for drones d0, d1, …."""
    return replace(check, where=tuple(names[int(drone[1:])] for drone in check.where))


def _jump(
    before: PiecewisePolynomial | None,
    window: PiecewisePolynomial,
    order: int,
    names: Sequence[str],
) -> tuple[float, str, float]:
    """Return the largest jump of a derivative, whose and when; also from the window before."""
    left, right = window.ends(order)
    steps, times = left[1:] - right[:-1], window.breaks[1:-1]
    if before is not None:
        steps = np.concatenate([left[:1] - before.ends(order)[1], steps])
        times = np.concatenate([window.breaks[:1], times])
    if len(steps) == 0:
        return (0.0, "", 0.0)
    sizes = np.linalg.norm(steps, axis=-1)
    joint, drone = np.unravel_index(int(np.argmax(sizes)), sizes.shape)
    return (float(sizes[joint, drone]), names[int(drone)], float(times[joint]))


def _broken(worst: Mapping[str, Check]) -> list[Finding]:
    found = []
    for name, check in worst.items():
        if check.holds:
            continue
        unit = "" if check.unit == "ratio" else f" {check.unit}"
        relation = "below" if check.sense == "min" else "above"
        remedy = REMEDIES.get(name, "fly it more slowly")
        found.append(
            Finding(
                ERROR,
                name,
                ", ".join(check.where),
                f"{check.worst:.4g}{unit} at t = {check.time:.4g} s is {relation} "
                f"{check.limit:.4g}{unit}; {remedy}",
            )
        )
    return found


def _relative(first: Array, loaded: Loaded) -> list[Finding]:
    """Return whether trajectories that are read as absolute look as if each had its own origin."""
    if not (loaded.together and _at_one_point(first)):
        return []
    return [
        Finding(
            WARNING,
            "separation",
            "",
            "all drones begin at one point, so these are relative trajectories: how close they "
            "come depends on where they start; check them with --relative if places are known",
        )
    ]


def _jumping(seen: _Seen, rules: Rules) -> list[Finding]:
    found = []
    words = (("position", "m"), ("velocity", "m/s"), ("acceleration", "m/s²"))
    for order, (size, drone, t) in enumerate(seen.jumps):
        bound = rules.jumps[order]
        if size > bound:
            what, unit = words[order]
            found.append(
                Finding(
                    ERROR if order == 0 else WARNING,
                    "jump",
                    drone,
                    f"{what} jumps by {size:.3g} {unit} where pieces join at t = {t:.4g} s "
                    f"(more than {bound:g} {unit}); make the pieces meet",
                )
            )
    return found


def _stopping(last: PiecewisePolynomial, names: Sequence[str], rules: Rules) -> list[Finding]:
    """Return who still moves at the end: as what is cut off in mid-flight does."""
    _, ends = last.ends(1)
    speeds = np.linalg.norm(ends[-1], axis=-1)
    moving = np.flatnonzero(speeds > rules.jumps[1])
    if len(moving) == 0:
        return []
    drone = int(np.argmax(speeds))
    who = names[drone] + (f" and {len(moving) - 1} more" if len(moving) > 1 else "")
    return [
        Finding(
            WARNING,
            "end",
            who,
            f"still moves at {speeds[drone]:.3g} m/s at its end, t = {last.breaks[-1]:.4g} s "
            f"(more than {rules.jumps[1]:g} m/s); let it come to rest: is something cut off?",
        )
    ]


def _placed(seen: _Seen, loaded: Loaded) -> list[Finding]:
    found = []
    reach, drone = seen.reach
    if reach > RADIOED:
        level = ERROR if loaded.kind == "compressed" else NOTE
        found.append(
            Finding(
                level,
                "range",
                drone,
                f"goes {reach:.4g} m from the origin; formats of millimetres in 16 bits hold "
                f"±{RADIOED} m; move the origin",
            )
        )
    if seen.start != 0.0:
        found.append(
            Finding(WARNING, "start", "", f"time begins at {seen.start:g} s, not at 0; shift it")
        )
    if loaded.streamed and seen.longest > WATCHDOG:
        found.append(
            Finding(
                ERROR,
                "rate",
                "",
                f"{seen.longest:.3g} s between two setpoints; the drones' watchdog waits "
                f"{WATCHDOG} s; sample at {SLOWEST:g} Hz or more",
            )
        )
    elif loaded.kind == "ros2bag" and seen.longest * SLOWEST > 1.01:
        found.append(
            Finding(
                WARNING,
                "rate",
                "",
                f"{1.0 / seen.longest:.3g} Hz; full states are to be streamed at {SLOWEST:g} to "
                "100 Hz; sample more often",
            )
        )
    return found
