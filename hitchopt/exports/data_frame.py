"""The setpoints of a plan as a pandas data frame."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import UnsupportedError
from hitchopt.exports.setpoints import HEADER, setpoint_values
from hitchopt.motion.motion import Motion
from hitchopt.motion.states import sample_times, states_at

if TYPE_CHECKING:
    from pandas import DataFrame


def data_frame(motion: Motion, rate: float) -> DataFrame:
    """Return the rows of ``setpoints.csv`` and the name of the phase, by time, then drone.

    Raises
    ------
    InputError: a rate that is not positive.
    UnsupportedError: pandas is not installed.
    """
    try:
        import pandas
    except ImportError as error:
        remedy = "pip install 'hitchopt[pandas]'"
        raise UnsupportedError(f"data frames need the package pandas ({error}); {remedy}") from None
    times, names = sample_times(motion.duration, rate), motion.team.drone_names
    values = setpoint_values(states_at(motion, times))
    first, _, *columns = HEADER.split(",")
    phases = [f"{phase.name} ({i})" for i, phase in enumerate(motion.phases)]
    ends = np.array([phase.end for phase in motion.phases[:-1]])
    here = np.repeat(np.searchsorted(ends, times, side="right"), len(names))
    flat = values.reshape(-1, values.shape[-1])

    def words(codes: NDArray[np.intp], each: Iterable[str]) -> pandas.Categorical[str]:
        return pandas.Categorical.from_codes(codes, categories=pandas.Index(list(each)))

    return pandas.DataFrame(
        {first: flat[:, 0], "drone": words(np.tile(np.arange(len(names)), len(times)), names)}
        | {name: flat[:, i] for i, name in enumerate(columns, 1)}
        | {"phase": words(here, phases)}
    )
