"""Rules for the drones' joint flight: limits, jumps, ends in mid-flight, ranges, rates, places.

Places where drones stand before the flight are compared with trajectories, or added to them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from hitchopt.checks.certificate import Check, most_pressing
from hitchopt.exports.lint.findings import Finding, Flight, Loaded, and_more, error, note, warning
from hitchopt.exports.lint.joint_flight import Rules, Seen, at_one_point, seen_together
from hitchopt.exports.lint.show_limits import DISTANCE
from hitchopt.exports.recording import Recording
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array

RADIOED = 32.767
"""[m] Largest coordinate in formats of whole millimetres in 16 bits."""

WATCHDOG = 0.5
"""[s] Longest gap between setpoints before a Crazyflie levels itself."""

SLOWEST = 30.0
"""[Hz] Lowest rate at which full states are usefully streamed."""

AT_START = 0.1
"""[m] Largest distance across from a drone's place to where its trajectory begins."""

REMEDIES = {
    "separation": "move them apart",
    DISTANCE: "move them apart",
    "maxAltitude": "fly lower",
}
"""Remedies by check; all others bound rates, which fall where a flight is slower."""


def flown_together(loaded: Loaded, rules: Rules) -> tuple[Flight, tuple[Finding, ...]]:
    """Return the figures of the joint flight, and the findings on it.

    Raises
    ------
    FileError: the files are damaged further on.
    """
    recording, seen = loaded.recording, seen_together(loaded, rules)
    if seen.last is None or seen.first is None:  # a recording has windows, or raises
        raise ValueError("a recording without windows")
    pressing = {name: most_pressing(checks) for name, checks in seen.checks.items()}
    worst = {name: check for name, check in pressing.items() if check is not None}
    values = {name: check.bound for name, check in worst.items()}
    flight = Flight(
        float(seen.last.breaks[-1]) - seen.start,
        values.get("speed", math.nan),
        values.get("acceleration", math.nan),
        values.get("separation", math.nan) if len(recording.names) > 1 else math.inf,
        tuple(jump[0] for jump in seen.jumps),
        seen.reach[0],
        *seen.limits,
        tuple(worst[key] for key in loaded.own.bounds if key in worst),
    )
    found = (
        *_broken(worst),
        *_relative(seen.first, loaded),
        *_away_from_places(loaded, seen.first),
        *_jumping(seen, rules),
        *_stopping(seen.last, recording.names, rules),
        *_placed(seen, loaded),
    )
    return flight, found


def _broken(worst: Mapping[str, Check]) -> Iterator[Finding]:
    for name, check in worst.items():
        if not check.holds:
            unit = "" if check.unit == "ratio" else f" {check.unit}"
            relation = "below" if check.sense == "min" else "above"
            yield error(
                name,
                ", ".join(check.where),
                f"{check.bound:.4g}{unit} at t = {check.time:.4g} s is {relation} "
                f"{check.limit:.4g}{unit}; {REMEDIES.get(name, 'fly it more slowly')}",
            )


def _relative(first: Array, loaded: Loaded) -> Iterator[Finding]:
    """Yield whether trajectories that are read as absolute look as if each had its own origin."""
    if loaded.together and at_one_point(first):
        yield warning(
            "separation",
            "",
            "all drones begin at one point, so these are relative trajectories: how close they "
            "come depends on where they start; check them with --relative if places are known",
        )


def _jumping(seen: Seen, rules: Rules) -> Iterator[Finding]:
    words = ("position", "velocity", "acceleration"), ("m", "m/s", "m/s²")
    for what, unit, (size, drone, t), bound in zip(*words, seen.jumps, rules.jumps, strict=False):
        if size > bound:
            yield (error if what == "position" else warning)(
                "jump",
                drone,
                f"{what} jumps by {size:.3g} {unit} where pieces join at t = {t:.4g} s "
                f"(more than {bound:g} {unit}); make the pieces meet",
            )


def _stopping(last: PiecewisePolynomial, names: Sequence[str], rules: Rules) -> Iterator[Finding]:
    """Yield who still moves at the end, as drones do whose trajectory is cut off in mid-flight."""
    speeds = np.linalg.norm(last.ends(1)[1][-1], axis=-1)
    drone = int(np.argmax(speeds))
    if speeds[drone] > rules.jumps[1]:
        yield warning(
            "end",
            and_more(names[drone], np.count_nonzero(speeds > rules.jumps[1])),
            f"still moves at {speeds[drone]:.3g} m/s at its end, t = {last.breaks[-1]:.4g} s "
            f"(more than {rules.jumps[1]:g} m/s); let it come to rest: is something cut off?",
        )


def _placed(seen: Seen, loaded: Loaded) -> Iterator[Finding]:
    """Yield what is wrong with the frame of space and time: far away, late, or too few samples."""
    reach, drone = seen.reach
    if reach > RADIOED:
        yield (error if loaded.kind == "compressed" else note)(
            "range",
            drone,
            f"goes {reach:.4g} m from the origin; formats of millimetres in 16 bits hold "
            f"±{RADIOED} m; move the origin",
        )
    if seen.start != 0.0:
        yield warning("start", "", f"time begins at {seen.start:g} s, not at 0; shift it")
    if loaded.streamed and seen.longest > WATCHDOG:
        yield error(
            "rate",
            "",
            f"{seen.longest:.3g} s between two setpoints; the drones' watchdog waits "
            f"{WATCHDOG} s; sample at {SLOWEST:g} Hz or more",
        )
    elif loaded.kind == "ros2bag" and seen.longest * SLOWEST > 1.01:
        yield warning(
            "rate",
            "",
            f"{1.0 / seen.longest:.3g} Hz; full states are to be streamed at {SLOWEST:g} to "
            "100 Hz; sample more often",
        )


def _away_from_places(loaded: Loaded, first: Array) -> Iterator[Finding]:
    """Yield a warning for every drone whose trajectory begins elsewhere than where it stands.

    Parameters
    ----------
    loaded: with the places.
    first: (D, 3) where the trajectories begin [m].
    """
    apart = np.linalg.norm(_places(loaded)[:, :2] - first[:, :2], axis=1)
    for i in np.flatnonzero(apart > AT_START).tolist():
        yield warning(
            "start",
            loaded.recording.names[i],
            f"its {loaded.place_key} is {apart[i]:.3g} m away from where its trajectory begins; "
            "place it there, see that its path there is free, or use --relative if trajectories "
            "are flown from the drones' places",
        )


def flown_from_places(loaded: Loaded) -> Loaded:
    """Return the trajectories as they are flown relative to where each drone stands.

    All are taken to rise by the same height first. Where a place is missing, distances between
    drones are unknown: they are not checked then, and a finding states it.
    """
    places, recording = _places(loaded), loaded.recording
    missing = [n for n in recording.names if n not in loaded.places]
    findings = loaded.findings
    if missing and len(recording.names) > 1:
        unknown = warning(
            "separation",
            and_more(missing[0], len(missing)),
            "no place is known to fly relative to, so how close drones come is not checked; "
            "give initial_position in crazyflies.yaml beside the files, or homes in the show",
        )
        findings = (*findings, unknown)

    def windows() -> Iterator[PiecewisePolynomial]:
        offsets: Array | None = None
        for window in recording.windows():
            if offsets is None:
                first = window.coefficients[0, ..., 0]
                offsets = np.where(np.isnan(places), 0.0, places - first)
            yield PiecewisePolynomial(window.breaks, window.coefficients + offsets[..., None])

    moved = Recording(recording.names, recording.frame, recording.smooth, windows)
    return replace(loaded, recording=moved, findings=findings, together=not missing)


def _places(loaded: Loaded) -> Array:
    """Return the drones' places (D, 3) [m], nan where they are not known."""
    places = np.full((len(loaded.recording.names), 3), np.nan)
    for i, name in enumerate(loaded.recording.names):
        place = loaded.places.get(name, ())
        places[i, : len(place)] = place
    return places
