"""What the drones of a file or folder fly: curves of time, given window by window.

A recording is read off exported numbers, ours or anybody else's, after rounding. Windows follow one
another without a gap, so that tables of any length are looked at without being held in memory.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import FileError
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.trajectory.splitting import merged_breaks, on_breaks

Array = NDArray[np.float64]

WINDOW = 20_000
"""Pieces times drones that are looked at together: about 40 MB of coefficients and bounds."""

MAX_TIMES = 50_000_000
"""More samples than that are no table of a flight."""


@dataclass(frozen=True, eq=False)
class Samples:
    """Consecutive samples of all drones, in a file's frame.

    Attributes
    ----------
    t: (S,) [s]
    derivatives: positions, and velocities and accelerations where the file has them, (m, S, D, 3).
    """

    t: Array
    derivatives: Array


@dataclass(frozen=True, eq=False)
class Recording:
    """The curves that exported numbers stand for.

    Attributes
    ----------
    names: (D,) of the drones, in the file's order.
    frame: enu, nwu or ned; empty where the file does not say.
    smooth: the highest derivative by time that does not jump: 0 positions, 1 velocities,
        2 accelerations.
    windows: gives the curves (D, 3) [m] over one span of time after the other.
    """

    names: tuple[str, ...]
    frame: str
    smooth: int
    windows: Callable[[], Iterator[PiecewisePolynomial]]


def recording_of_curves(
    names: Sequence[str], curves: Sequence[PiecewisePolynomial], frame: str, smooth: int
) -> Recording:
    """Return the recording of one curve (3,) per drone, each with breaks of its own from 0.

    Who ends before the others stays where it ended. Written drone by drone where breaks differ:
    every file may have its own.
    """
    first = curves[0].breaks
    degree = max(curve.degree for curve in curves)
    if all(np.array_equal(curve.breaks, first) for curve in curves):
        breaks = first
        parts = [bernstein.elevate(curve.coefficients, degree) for curve in curves]
    else:
        end = max(float(curve.breaks[-1]) for curve in curves)
        lasting = [lasted(curve, end) for curve in curves]
        breaks = merged_breaks([curve.breaks for curve in lasting])
        parts = [bernstein.elevate(on_breaks(c, breaks).coefficients, degree) for c in lasting]
    whole = PiecewisePolynomial(breaks, np.stack(parts, axis=1))
    size = max(1, WINDOW // len(names))

    def windows() -> Iterator[PiecewisePolynomial]:
        for start in range(0, whole.pieces, size):
            yield whole.taken(slice(start, start + size))

    return Recording(tuple(names), frame, smooth, windows)


def recording_of_samples(
    names: Sequence[str],
    blocks: Callable[[], Iterable[Samples]],
    frame: str,
    smooth: int,
) -> Recording:
    """Return the recording of samples: between two of them the curve that meets both.

    Straight lines through positions, cubics through velocities as well, quintics through
    accelerations too.

    Raises
    ------
    FileError, from the windows: times that do not increase, or fewer than two samples.
    """

    def windows() -> Iterator[PiecewisePolynomial]:
        last: Samples | None = None
        given = 0
        for block in blocks():
            here = block if last is None else _appended(last, block)
            last = Samples(block.t[-1:], block.derivatives[:, -1:])
            if len(here.t) < 2:
                continue
            if not np.all(np.diff(here.t) > 0.0):
                late = float(here.t[1:][np.diff(here.t) <= 0.0][0])
                raise FileError(f"its times do not increase at t = {late:g} s; sort its rows")
            used = here.derivatives[: smooth + 1]
            given += 1
            yield PiecewisePolynomial.hermite(here.t, used[:, :-1], used[:, 1:])
        if given == 0:
            raise FileError("has fewer than two samples; nothing moves between them")

    return Recording(tuple(names), frame, smooth, windows)


def lasted(curve: PiecewisePolynomial, end: float) -> PiecewisePolynomial:
    """Return the curve, staying where it ended until ``end`` [s], if that is later."""
    if end <= curve.breaks[-1]:
        return curve
    rest = np.broadcast_to(curve.coefficients[-1:, ..., -1:], curve.coefficients[-1:].shape)
    return PiecewisePolynomial(
        np.append(curve.breaks, end), np.concatenate([curve.coefficients, rest])
    )


def _appended(last: Samples, block: Samples) -> Samples:
    return Samples(
        np.concatenate([last.t, block.t]),
        np.concatenate([last.derivatives, block.derivatives], axis=1),
    )
