"""Drones at the rests of a recorded flight: trims, and the errors that remain.

At rest a drone is off its planned position by its trim and by ``(F + cable force)/k``, see
``equilibrium``. An offset that the equilibrium of measured cables does not explain is a trim if it
is the same at every rest, and a position error of the drone if it differs. A steady wind counts as
a trim, as does a force that the plan neglects.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from hitchopt.checks.vertex_errors import SAME_PLACE, states_at_rests
from hitchopt.errors import OneLine
from hitchopt.geometry.vectors import length
from hitchopt.hitch.energy import energy_of
from hitchopt.hitch.rest_errors import MAX_RESIDUAL, planned_rest
from hitchopt.hitch.team import Errors, Team
from hitchopt.lab.flights.recordings import Windows
from hitchopt.motion.motion import Motion
from hitchopt.motion.states import States
from hitchopt.values import Array

REPEATABILITY = 0.01  # [m] Smallest standard deviation of trims from flight to flight
MIN_RATIO = 2.0  # Smallest trim over its standard error that is written
MIN_WINDOWS = 3  # Smallest number of windows at a rest
WINDOW_MOVES = 1e-4  # [m] Largest distance of a window's setpoints from those of its rest
LENGTH_ERRORS = 3.0  # Largest error of a cable's length over its standard error
LENGTH_BIAS = 0.003  # [m] Largest bias of measured lengths, in perturbed simulated flights
ROUNDING = 0.001  # [m] Step to which errors are rounded up


@dataclass(frozen=True, eq=False)
class DronesAtRests(OneLine):
    """Drones at the R rests that a recording shows, in the order of the problem.

    Attributes
    ----------
    t: (R,) [s], times of the rests in the plan.
    offsets: (R, 2n, 3) [m], mean positions at rest minus those that measured cables explain.
    flown_trims: (2n, 2) [m], with which the plan flew.
    """

    t: Array
    offsets: Array
    flown_trims: Array

    @classmethod
    def without_rests(cls, team: Team) -> DronesAtRests:
        """Return those of a flight without rests."""
        return cls(np.zeros(0), np.zeros((0, team.drones, 3)), team.trim[team.listed])

    @property
    def trim_errors(self) -> Array:
        """(2n,) [m]: standard errors of trims; infinite with fewer than two rests."""
        rests = len(self.t)
        if rests < 2:
            return np.full(self.offsets.shape[1], np.inf)
        scatter = length(np.std(self.offsets[..., :2], axis=0, ddof=1))
        return np.hypot(scatter / math.sqrt(rests), REPEATABILITY)

    @property
    def trims(self) -> Array:
        """(2n, 2) [m]: trims of setpoints; those of the plan where no other is determined."""
        if not len(self.t):
            return self.flown_trims
        change = -np.mean(self.offsets[..., :2], axis=0)
        determined = length(change) > MIN_RATIO * self.trim_errors
        return self.flown_trims + np.where(determined[:, None], change, 0.0)

    @property
    def largest_error(self) -> float:
        """Largest distance [m] of a drone at rest from its plan, with ``trims``; nan if none."""
        if not len(self.t):
            return math.nan
        remaining = self.offsets.copy()
        remaining[..., :2] += self.trims - self.flown_trims
        return float(np.max(length(remaining)))

    def errors(self, planned: Errors, lengths: Array) -> Errors:
        """Return the largest errors of the next flight; those ``planned`` where none is measured.

        ``lengths`` (n,) [m] are standard errors of measured cables, infinite if not determined. The
        friction is as planned, since a flight that moves its clasps determines little of the
        remaining friction.
        """
        cable_length = planned.cable_length
        largest_deviation = float(np.max(lengths))
        if math.isfinite(largest_deviation):
            cable_length = _rounded_up(LENGTH_ERRORS * largest_deviation + LENGTH_BIAS)
        drone = planned.drone
        if not math.isnan(self.largest_error):
            drone = _rounded_up(self.largest_error)
        return Errors(cable_length, drone, planned.friction)


def _rounded_up(size: float) -> float:
    """Return a size [m] rounded up to millimetres."""
    return round(max(math.ceil(size / ROUNDING - 1e-6), 1) * ROUNDING, 3)


def drones_at_rests(
    motion: Motion, windows: Windows, conditions: Mapping[str, Any], lengths: Array
) -> DronesAtRests:
    """Return drones at the rests of a motion that ``windows`` of a recording show.

    ``conditions`` are those of ``equilibrium``; ``lengths`` (n,) [m] are measured cables, in the
    order of edges. A rest is used if it has three windows and the conditions have an equilibrium.
    """
    team = motion.team
    rests = states_at_rests(motion)
    if rests is None:
        return DronesAtRests.without_rests(team)
    times = list[float]()
    offsets = list[Array]()
    for index in range(len(rests.t)):
        rest = rests[[index]]
        distances = np.max(length(windows.positions - rest.positions), axis=1)
        at_rest = distances <= WINDOW_MOVES + SAME_PLACE
        expected = _expected(team, rest, conditions, lengths)
        if np.count_nonzero(at_rest) < MIN_WINDOWS or expected is None:
            continue
        times.append(float(rest.t[0]))
        offsets.append(np.mean(windows.drones[at_rest], axis=0) - expected)
    by_place = np.array(offsets).reshape(-1, team.drones, 3)
    listed = team.listed
    return DronesAtRests(np.array(times), by_place[:, listed], team.trim[listed])


def _expected(
    team: Team, rest: States, conditions: Mapping[str, Any], lengths: Array
) -> Array | None:
    """Return positions of drones (2n, 3) [m] at a rest in equilibrium; None without one.

    ``rest`` is a single sample; other arguments are those of ``drones_at_rests``.
    """
    if np.all(np.isinf(conditions["stiffness"])):
        return np.asarray(rest.positions[0])
    planned = planned_rest(team, rest.positions, rest.vertices, rest.tensions, rest.cable_forces)
    measured = planned | {"cable_length": lengths[None]}
    energy = energy_of(team, conditions, measured)
    nodes = energy.at_rest()
    residual = np.max(np.abs(energy.slopes(nodes)))
    is_at_rest = residual <= MAX_RESIDUAL  # a residual of nan is not
    return np.asarray(nodes[0, : energy.drones]) if is_at_rest else None
