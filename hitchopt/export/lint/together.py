"""What all drones of a recording fly together: limits, separation, jumps; bounds for all t."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from hitchopt.certificate import acceleration, separation, speed
from hitchopt.certificate.report import Check, most_pressing
from hitchopt.export.lint.findings import ERROR, NOTE, WARNING, Finding, Flight, Loaded
from hitchopt.hitch import Swarm
from hitchopt.model.motion import Motion
from hitchopt.requirements import Limits, Requirements, Separation
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


@dataclass(frozen=True)
class Rules:
    """What is held against the drones.

    Attributes
    ----------
    speed: [m/s], of every drone.
    acceleration: [m/s²], of every drone.
    separation: of any two drones.
    jumps: between pieces, of position [m], velocity [m/s], acceleration [m/s²]: beyond the first a
        flight is expected to fail, beyond the others to shake.
    """

    speed: float = 3.0
    acceleration: float = 10.0
    separation: Separation = field(default_factory=Separation)
    jumps: tuple[float, float, float] = (2e-3, 0.1, 2.0)


@dataclass
class _Seen:
    """What has been found so far, window by window."""

    checks: dict[str, list[Check]]
    jumps: list[tuple[float, str, float]]
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
    jumps = [(0.0, "", 0.0)] * (recording.smooth + 1)
    seen = _Seen({"separation": [], "speed": [], "acceleration": []}, jumps)
    for window in recording.windows():
        _look(seen, window, loaded, rules)
    if seen.last is None or seen.first is None:  # a recording has windows, or raises
        raise ValueError("a recording without windows")
    worst = {name: most_pressing(checks) for name, checks in seen.checks.items()}
    values = {name: math.nan if check is None else check.worst for name, check in worst.items()}
    flight = Flight(
        float(seen.last.breaks[-1]) - seen.start,
        values["speed"],
        values["acceleration"],
        values["separation"] if len(recording.names) > 1 else math.inf,
        tuple(jump[0] for jump in seen.jumps),
        seen.reach[0],
    )
    found = [
        *_broken(worst, seen.first, len(recording.names)),
        *_jumping(seen, rules),
        *_stopping(seen.last, recording.names, rules),
        *_placed(seen, loaded),
    ]
    return flight, tuple(found)


def _look(seen: _Seen, window: PiecewisePolynomial, loaded: Loaded, rules: Rules) -> None:
    names = loaded.recording.names
    if seen.first is None:
        seen.first, seen.start = window.coefficients[0, ..., 0], float(window.breaks[0])
    limits = Limits(speed=rules.speed, acceleration=rules.acceleration)
    requirements = Requirements(limits, rules.separation)
    motion = Motion.single(Swarm(len(names)), requirements, window, ())
    found: dict[str, Check | None] = {"speed": speed.check(motion)}
    if len(names) > 1:
        found["separation"] = separation.check(motion)
    if loaded.recording.smooth > 0:
        found["acceleration"] = acceleration.check(motion)
    for name, check in found.items():
        if check is not None:
            seen.checks[name].append(_renamed(check, names))
    for order in range(len(seen.jumps)):
        seen.jumps[order] = max(seen.jumps[order], _jump(seen.last, window, order, names))
    reach = np.max(np.abs(window.coefficients), axis=(0, 2, 3))
    seen.reach = max(seen.reach, (float(np.max(reach)), names[int(np.argmax(reach))]))
    seen.longest = max(seen.longest, float(np.max(window.durations)))
    seen.last = window.taken(slice(window.pieces - 1, window.pieces))


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


def _broken(worst: dict[str, Check | None], first: Array, drones: int) -> list[Finding]:
    found = []
    relative = drones > 1 and float(np.max(np.ptp(first, axis=0))) < SAME_START
    for name, check in worst.items():
        if check is None or check.holds:
            continue
        where = ", ".join(check.where)
        if name == "separation" and relative:
            found.append(
                Finding(
                    WARNING,
                    name,
                    "",
                    "all drones begin at one point, so these are relative trajectories: how close "
                    "they come depends on where they start; absolute ones can be checked",
                )
            )
            continue
        unit = "" if check.unit == "ratio" else f" {check.unit}"
        relation = "below" if check.sense == "min" else "above"
        remedy = "move them apart" if name == "separation" else "fly it more slowly"
        found.append(
            Finding(
                ERROR,
                name,
                where,
                f"{check.worst:.4g}{unit} at t = {check.time:.4g} s is {relation} "
                f"{check.limit:.4g}{unit}; {remedy}",
            )
        )
    return found


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
