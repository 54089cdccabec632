"""Times of recorded samples: those of a clock that has not begun, and those taken at receipt.

Samples that are stamped where they arrive are late in bursts: one waits, and those behind it arrive
with it. If the sender has a rate, every sample belongs into a period of its own.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hitchopt.values import Array

MIN_SAMPLES = 20  # Fewest samples of a body whose intervals are judged
FIRST_SAMPLES = 64  # Samples to which a rate is fitted first; then to twice as many, and so on
ROUNDS = 3  # Fits of a rate to the same samples
ON_TIME = 0.25  # Largest deviation of a sample from its period, over the period
MAX_JITTER = 0.1  # Largest root mean square deviation of samples on time, likewise
MIN_ON_TIME = 0.5  # Smallest fraction of samples that are on time if a rate fits
MIN_LATE = 2e-3  # Smallest fraction of late samples that is evened out
LONGEST_BURST = 1.0  # Longest time that the first samples are late [s]
MAX_IRREGULAR = 0.02  # Largest fraction of irregular intervals that is not reported
LATE_CLOCK = 10.0  # Gap after a time of zero that shows an unset clock, over the median step


def before_the_clock(t: Array, *, repeats: bool = False) -> int:
    """Return the number of samples at times (m,) [s] of exactly zero before a clock begins.

    Clocks that count from zero have this time once, or with ``repeats`` once per sample of a
    frame, and go on from there.
    """
    later = np.flatnonzero(t != 0.0)
    if not len(later) or later[0] == 0:
        return 0
    zeros = int(later[0])
    steps = np.diff(np.unique(t[zeros:]))
    is_far = len(steps) > 0 and t[zeros] > LATE_CLOCK * np.median(steps)
    return zeros if is_far or (zeros > 1 and not repeats) else 0


class Stamps(NamedTuple):
    """Times of samples, and what is irregular about them."""

    t: Array  # (m,) [s], evened out where a rate fits
    late: NDArray[np.bool_]  # (m,) samples whose times are evened out
    irregular: float = 0.0  # fraction of irregular intervals where no rate fits
    rate: float = 0.0  # [Hz], of times that are evened out


def evened(t: Array) -> Stamps:
    """Return times (m,) [s] that do not descend, with late ones in the periods of a rate.

    Lost samples are periods without a sample, and change nothing. Times stay as they are where no
    rate fits.
    """
    as_recorded = Stamps(t, np.zeros(len(t), np.bool_))
    if len(t) < MIN_SAMPLES or not t[-1] > t[0]:
        return as_recorded
    fit = _fitted_rate(t)
    if fit is None:
        steps = np.diff(t) / np.median(np.diff(np.unique(t)))
        irregular = float(np.mean(np.abs(steps - np.rint(steps)) > ON_TIME))
        return as_recorded._replace(irregular=irregular if irregular > MAX_IRREGULAR else 0.0)
    start, step = fit
    regular = start + step * _periods(t, start, step)
    late = t - regular > ON_TIME * step
    first_on_time = int(np.argmin(late))
    if t[first_on_time] - t[0] > LONGEST_BURST:
        late[:first_on_time] = False  # A repeated sample shifts the periods of all before it
    if np.mean(late) < MIN_LATE:
        return as_recorded
    return Stamps(np.where(late, regular, t), late, rate=1.0 / step)


def _periods(t: Array, start: float, step: float) -> Array:
    """Return the periods (m,) of times: the nearest ones, but each before that of the next."""
    order = np.arange(len(t))
    nearest = np.rint((t - start) / step)
    periods: Array = np.minimum.accumulate((nearest - order)[::-1])[::-1] + order
    return periods


def _fitted_rate(t: Array) -> tuple[float, float] | None:
    """Return the start and the period [s] of most times (m,); None if no rate fits."""
    steps = np.diff(np.unique(t))
    usual = np.abs(steps / np.median(steps) - 1.0) < 2.0 * ON_TIME
    step = float(np.mean(steps[usual]))
    size = min(len(t), FIRST_SAMPLES)
    turns = np.exp(2j * np.pi * (t[:size] - t[0]) / step)
    start = t[0] + step * float(np.angle(np.sum(turns))) / (2.0 * np.pi)
    while True:
        for _ in range(ROUNDS):
            periods = _periods(t[:size], start, step)
            on_time = np.abs(t[:size] - start - step * periods) < ON_TIME * step
            if np.mean(on_time) < MIN_ON_TIME or np.ptp(periods[on_time]) < 1.0:
                break  # a burst may end these samples; more of them may show the rate
            step, start = np.polyfit(periods[on_time], t[:size][on_time], 1).tolist()
        else:
            if size == len(t):
                jitter = (t - start - step * periods)[on_time]
                return (start, step) if np.std(jitter) < MAX_JITTER * step else None
        if size == len(t):
            return None
        size = min(len(t), 2 * size)
