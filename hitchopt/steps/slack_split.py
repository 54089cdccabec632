"""How a user says where a cable's slack goes: the legs of its two drones."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from hitchopt.errors import InputError
from hitchopt.hitch import Team
from hitchopt.values import Array, not_negative, per_robot, positive

SlackSplit = Literal["balanced", "spread"] | Array
"""The slack split of a hitch: ``balanced``, ``spread``, or (n,) [m] the q-legs ``d_k``."""


def slack_split(legs: str | Sequence[float] | ArrayLike, team: Team) -> SlackSplit:
    """Return what a user wrote for ``legs``, checked.

    Raises
    ------
    InputError: another word, or a list that does not have one positive length per robot, none of
        them zero but the first of a chain.
    """
    bound = "balanced, spread or a list of d_k"
    if isinstance(legs, str):
        if legs == "balanced":
            return "balanced"
        if legs == "spread":
            return "spread"
        raise InputError("legs", legs, bound, "write legs: spread")
    if isinstance(legs, int | float):
        raise InputError("legs", legs, bound, "give one length per robot")
    q_legs = per_robot("legs", legs, team.robots, not_negative)
    zero = np.flatnonzero(team.layout.has_leg[:, 0] & (q_legs == 0.0))
    if len(zero) > 0:
        positive(f"legs[{zero[0]}]", 0.0)
    return q_legs
