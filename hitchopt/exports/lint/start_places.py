"""Places where drones stand before the flight: compared with trajectories, or added to them."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import replace
from typing import TypeGuard

import numpy as np

from hitchopt.exports.lint.findings import FARTHEST, Finding, Loaded, and_more, warning
from hitchopt.exports.recording import Recording
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array

AT_START = 0.1
"""[m] Largest distance across from a drone's place to where its trajectory begins."""


def is_place(value: object, lengths: Collection[int]) -> TypeGuard[list[float]]:
    """Return whether a value from a file is a list of so many coordinates within FARTHEST [m]."""
    return (
        isinstance(value, list)
        and len(value) in lengths
        and all(type(x) in {int, float} and abs(x) <= FARTHEST for x in value)
    )


def away_from_places(loaded: Loaded, first: Array) -> Iterator[Finding]:
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
