"""What drones do before a plan in a show of mavsdk_drone_show: they rise from the ground.

The receiver arms its drones on the ground, and counts altitudes from each one's first row. So that
row is on the ground below the plan's first place, and the drones wait there until all of them
follow their rows, rise together, straight up, and rest before the plan begins. Seen from above
nothing moves; a hitch whose drones begin at one altitude rises as it is. The cables' pull grows
with the altitude.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import ceil, floor

import numpy as np
from numpy.typing import NDArray

from hitchopt.checks import separation
from hitchopt.checks.certificate import Check
from hitchopt.errors import InfeasibleError
from hitchopt.exports.formats.format import Task, pull_of
from hitchopt.exports.formats.mavsdk_receiver import BLEND, LATE, Receiver
from hitchopt.hitch import Swarm
from hitchopt.motion.motion import Motion
from hitchopt.motion.states import states_at
from hitchopt.trajectory import PiecewisePolynomial

Array = NDArray[np.float64]

WAIT = LATE + BLEND
"""[s] On the ground: whoever is late, or is drawn to its row, is there by then."""

SETTLE = 3.0
"""[s] At the first places."""

SPEED, ACCELERATION = 0.5, 0.5
"""[m/s], [m/s²] While rising, at most."""

LEAST = 1.0
"""[s] That rising takes."""

DIGITS = 5e-9
"""Relative, by which the nine digits of a number in the files may be off."""

BELOW = 1.0
"""[m] How far thresholds are below all rows: those are never under them."""


@dataclass(frozen=True, eq=False)
class LeadIn:
    """The rows before a plan's own.

    Attributes
    ----------
    rows: how many; the plan begins after as many steps.
    duration: [s], ``rows`` steps of the show.
    share: of the rise, 0 to 1 over the duration, with continuous acceleration.
    ground: (D, 3) [m], where the drones begin, in the plan's frame.
    height: (D,) [m], by which they rise.
    check: of the separation meanwhile.
    """

    rows: int
    duration: float
    share: PiecewisePolynomial
    ground: Array
    height: Array
    check: Check | None

    def values(self, task: Task, t: Array) -> Array:
        """Return rows at times t (S,) [s]: positions, velocities, fed-forward accelerations.

        (S, D, 9) in the file's axes.
        """
        shares = [self.share.at(t, order)[:, None] for order in range(3)]
        rise = self.height[:, None] * np.array([0.0, 0.0, 1.0])
        pull = pull_of(task, states_at(task.motion, np.zeros(1)))
        room = task.room
        parts = (
            room.points(self.ground + shares[0] * rise),
            room.vectors(shares[1] * rise),
            room.vectors(shares[2] * rise) - shares[0] * pull,
        )
        return np.concatenate(parts, axis=-1)


def lead_in(task: Task) -> LeadIn:
    """Return the rows before the plan's own.

    Raises
    ------
    InfeasibleError: drones that begin above one another cannot rise straight up to there.
    """
    motion = task.motion
    first = motion.drones.coefficients[0, ..., 0]
    ground = first.copy()
    ground[:, 2] = motion.requirements.floor
    height = first[:, 2] - ground[:, 2]
    highest = float(np.max(np.abs(height)))
    speed = min(SPEED, motion.requirements.limits.speed)
    acceleration = min(ACCELERATION, motion.requirements.limits.acceleration)
    # The quintic at rest at both ends is fastest by 15/8, and accelerates most by 10/√3.
    rise = max(
        LEAST,
        1.875 * highest / speed,
        (10.0 / 3.0**0.5 * highest / acceleration) ** 0.5,
        (60.0 * highest / motion.requirements.limits.jerk) ** (1.0 / 3.0),
    )
    rows = ceil((WAIT + rise + SETTLE) * task.rate)
    duration = rows / task.rate
    ends = np.zeros((3, 4, 1))
    ends[0, 2:] = 1.0
    breaks = np.array([0.0, WAIT, WAIT + rise, duration])
    share = PiecewisePolynomial.hermite(breaks, ends[:, :-1], ends[:, 1:])
    lead = LeadIn(rows, duration, share, ground, height, _check(task, share, ground, height))
    if lead.check is not None and not lead.check.holds:
        raise InfeasibleError(
            (
                lead.check.violation(
                    "while the drones rise straight up from the ground to their first places",
                    "begin with the drones beside one another, or choose another format",
                ),
            ),
            "mavsdk_drone_show is not written: its drones take off from below their first places",
        )
    return lead


def _check(task: Task, share: PiecewisePolynomial, ground: Array, height: Array) -> Check | None:
    """Return the separation while rising, for all t, the rounding in the files included."""
    motion = task.motion
    points = np.repeat(ground[None, ..., None], share.degree + 1, axis=-1)
    points = np.repeat(points, share.pieces, axis=0)
    points[:, :, 2] += height[None, :, None] * share.coefficients
    curves = PiecewisePolynomial(share.breaks, points)
    rising = Motion.single(Swarm(len(ground)), replace(motion.requirements, arena=None), curves, ())
    found = separation.RULE.check(rising)
    if found is None:
        return None
    names = motion.team.drone_names
    where = tuple(names[int(drone[1:])] for drone in found.where)
    reach = float(np.max(np.abs(task.room.points(points[[0, -1], ..., 0]))))
    rounding = 2.0 * 3.0**0.5 * DIGITS * reach * float(np.max(motion.requirements.separation.scale))
    worst = found.bound - rounding
    return Check.of(found.name, worst, found.limit, found.sense, found.unit, found.time, where)


def receiver_for(task: Task) -> Receiver:
    """Return the settings with which every row is flown, with its velocity and acceleration."""
    lowest = (
        float(np.min(task.motion.drones.coefficients[:, :, 2])) - task.motion.requirements.floor
    )
    below = floor(min(0.0, lowest)) - BELOW
    return Receiver(
        climb_altitude=below,
        climb_time=0.0,
        ground_altitude=below,
        shared_origin=False,
        global_setpoints=False,
        velocities=True,
        accelerations=True,
    )
