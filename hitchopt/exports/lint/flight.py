"""What is wrong with a flight, as findings: broken limits, jumps, ends in mid-flight, ranges."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from hitchopt.checks.certificate import Check, most_pressing
from hitchopt.exports.lint.findings import ERROR, NOTE, WARNING, Finding, Flight, Loaded
from hitchopt.exports.lint.places import away_from_places
from hitchopt.exports.lint.show_limits import DISTANCE
from hitchopt.exports.lint.together import Rules, Seen, at_one_point, seen_together
from hitchopt.trajectory import PiecewisePolynomial

Array = NDArray[np.float64]

RADIOED = 32.767
"""[m] What formats of whole millimetres in 16 bits hold."""

WATCHDOG = 0.5
"""[s] Without a setpoint for so long a Crazyflie levels itself."""

SLOWEST = 30.0
"""[Hz] At which full states are usefully streamed."""

REMEDIES = {
    "separation": "move them apart",
    DISTANCE: "move them apart",
    "maxAltitude": "fly lower",
}
"""By check; all others bound rates, which fall where a flight is slower."""


def flown_together(loaded: Loaded, rules: Rules) -> tuple[Flight, tuple[Finding, ...]]:
    """Return what the drones fly, and what is wrong with it.

    Raises
    ------
    FileError: the files are damaged further on.
    """
    recording, seen = loaded.recording, seen_together(loaded, rules)
    if seen.last is None or seen.first is None:  # a recording has windows, or raises
        raise ValueError("a recording without windows")
    worst = {name: most_pressing(checks) for name, checks in seen.checks.items()}
    kept = {name: check for name, check in worst.items() if check is not None}
    values = {name: check.bound for name, check in kept.items()}
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
                f"{check.bound:.4g}{unit} at t = {check.time:.4g} s is {relation} "
                f"{check.limit:.4g}{unit}; {remedy}",
            )
        )
    return found


def _relative(first: Array, loaded: Loaded) -> list[Finding]:
    """Return whether trajectories that are read as absolute look as if each had its own origin."""
    if not (loaded.together and at_one_point(first)):
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


def _jumping(seen: Seen, rules: Rules) -> list[Finding]:
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


def _placed(seen: Seen, loaded: Loaded) -> list[Finding]:
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
