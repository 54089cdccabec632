"""Where drones stand before the flight: held against their trajectories, or added to them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hitchopt.exports.lint.findings import WARNING, Finding, Loaded
from hitchopt.exports.recording import Recording
from hitchopt.trajectory import PiecewisePolynomial

Array = NDArray[np.float64]

AT_START = 0.1
"""[m] How far from its place a drone's trajectory may begin, across."""


def away_from_places(loaded: Loaded, first: Array) -> list[Finding]:
    """Return whose trajectory begins elsewhere than where the drone stands.

    Parameters
    ----------
    loaded: with the places.
    first: (D, 3) where the trajectories begin [m].
    """
    places = _places(loaded)[:, :2]
    apart = np.linalg.norm(places - first[:, :2], axis=1)
    return [
        Finding(
            WARNING,
            "start",
            loaded.recording.names[i],
            f"its {loaded.place_key} is {apart[i]:.3g} m beside where its trajectory begins; "
            "place it there, see that its path there is free, or use --relative if trajectories "
            "are flown from the drones' places",
        )
        for i in np.flatnonzero(apart > AT_START).tolist()
    ]


def flown_from_places(loaded: Loaded) -> Loaded:
    """Return the trajectories as they are flown relative to where each drone stands.

    All are taken to rise by the same height first. Where a place is missing, how close drones come
    is unknown: nothing is judged together then, and a finding says so.
    """
    places, recording = _places(loaded), loaded.recording
    missing = [n for n in recording.names if n not in loaded.places]
    findings = list(loaded.findings)
    if missing and len(recording.names) > 1:
        more = f" and {len(missing) - 1} more" if len(missing) > 1 else ""
        findings.append(
            Finding(
                WARNING,
                "separation",
                f"{missing[0]}{more}",
                "no place is known to fly relative to, so how close drones come is not judged; "
                "give initial_position in crazyflies.yaml beside the files, or homes in the show",
            )
        )

    def windows() -> Iterator[PiecewisePolynomial]:
        offsets: Array | None = None
        for window in recording.windows():
            if offsets is None:
                first = window.coefficients[0, ..., 0]
                offsets = np.where(np.isnan(places), 0.0, places - first)
            yield PiecewisePolynomial(window.breaks, window.coefficients + offsets[..., None])

    moved = Recording(recording.names, recording.frame, recording.smooth, windows)
    return replace(loaded, recording=moved, findings=tuple(findings), together=not missing)


def _places(loaded: Loaded) -> Array:
    """Return the drones' places (D, 3) [m], nan where they are not known."""
    places = np.full((len(loaded.recording.names), 3), np.nan)
    for i, name in enumerate(loaded.recording.names):
        place = loaded.places.get(name, ())
        places[i, : len(place)] = place
    return places
