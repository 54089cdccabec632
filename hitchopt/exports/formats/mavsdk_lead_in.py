"""The rows before a plan in a show of mavsdk_drone_show: drones rise from the ground.

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

from hitchopt.checks import separation
from hitchopt.checks.certificate import Check
from hitchopt.errors import InfeasibleError
from hitchopt.exports.formats.format import Task
from hitchopt.exports.formats.mavsdk_receiver import BLEND, LATE, Receiver
from hitchopt.hitch import Swarm
from hitchopt.motion.motion import Motion
from hitchopt.motion.states import states_at
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array

WAIT = LATE + BLEND
"""Wait on the ground [s]: a drone that is late, or is drawn to its row, is there by then."""

SETTLE = 3.0
"""Wait at the first places [s]."""

SPEED, ACCELERATION = 0.5, 0.5
"""Largest speed and acceleration while rising [m/s], [m/s²]."""

LEAST = 1.0
"""Shortest duration of the rise [s]."""

DIGITS = 5e-9
"""Relative error of a number in the files, which has nine digits."""

BELOW = 1.0
"""Distance of thresholds below all rows [m]: those are never under them."""


@dataclass(frozen=True, eq=False)
class LeadIn:
    """The rows before a plan's own.

    Attributes
    ----------
    rows: how many; the plan begins after as many steps.
    duration: [s], ``rows`` steps of the show.
    share: share of the rise, 0 to 1 over the duration, with continuous acceleration.
    ground: (D, 3) [m], where the drones begin, in the plan's axes.
    height: (D,) [m], by which they rise.
    """

    rows: int
    duration: float
    share: PiecewisePolynomial
    ground: Array
    height: Array

    @property
    def curves(self) -> PiecewisePolynomial:
        """Positions (D, 3) [m] while rising, in the plan's axes."""
        rise = self.height[:, None, None] * np.array([[0.0], [0.0], [1.0]])
        share = self.share.coefficients[:, None, None, :]
        return PiecewisePolynomial(self.share.breaks, self.ground[..., None] + rise * share)

    def values(self, task: Task, t: Array) -> Array:
        """Return rows at times t (S,) [s]: positions, velocities, fed-forward accelerations.

        They are (S, D, 9) in the file's axes.
        """
        frame, curves = task.frame, self.curves
        pull = self.share.at(t)[:, None, None] * task.pulls(states_at(task.motion, np.zeros(1)))
        velocities, accelerations = (frame.vectors(curves.at(t, order)) for order in (1, 2))
        parts = (frame.points(curves.at(t)), velocities, accelerations - pull)
        return np.concatenate(parts, axis=-1)


def lead_in(task: Task) -> LeadIn:
    """Return the rows before the plan's own."""
    motion = task.motion
    limits = motion.requirements.limits
    first = motion.drones.coefficients[0, ..., 0]
    ground = first.copy()
    ground[:, 2] = motion.requirements.floor
    height = first[:, 2] - ground[:, 2]
    highest = float(np.max(np.abs(height)))
    # The quintic at rest at both ends is fastest by 15/8, and accelerates most by 10/√3.
    rise = max(
        LEAST,
        1.875 * highest / min(SPEED, limits.speed),
        (10.0 / 3.0**0.5 * highest / min(ACCELERATION, limits.acceleration)) ** 0.5,
        (60.0 * highest / limits.jerk) ** (1.0 / 3.0),
    )
    rows = ceil((WAIT + rise + SETTLE) * task.rate)
    duration = rows / task.rate
    ends = np.zeros((3, 4))
    ends[0, 2:] = 1.0
    breaks = np.array([0.0, WAIT, WAIT + rise, duration])
    share = PiecewisePolynomial.hermite(breaks, ends[:, :-1], ends[:, 1:])
    return LeadIn(rows, duration, share, ground, height)


def rising_check(task: Task, lead: LeadIn) -> Check | None:
    """Return the separation for all t, the rounding in the files included; None of one drone.

    Raises
    ------
    InfeasibleError: drones that begin above one another cannot rise straight up to there.
    """
    motion, curves = task.motion, lead.curves
    unwalled = replace(motion.requirements, arena=None)
    c = separation.RULE.check(Motion.single(Swarm(len(lead.ground)), unwalled, curves, ()))
    if c is None:
        return None
    where = tuple(motion.team.drone_names[int(drone[1:])] for drone in c.where)
    reach = float(np.max(np.abs(task.frame.points(curves.coefficients[[0, -1], ..., 0]))))
    scale = float(np.max(motion.requirements.separation.scale))
    worst = c.bound - 2.0 * 3.0**0.5 * DIGITS * reach * scale
    c = Check.of(c.name, worst, c.limit, c.sense, c.unit, c.time, where)
    if not c.holds:
        when = "while the drones rise straight up from the ground to their first places"
        remedy = "begin with the drones side by side, or choose another format"
        raise InfeasibleError(
            (c.violation(when, remedy),),
            "mavsdk_drone_show is not written: its drones take off from below their first places",
        )
    return c


def receiver_for(task: Task) -> Receiver:
    """Return the settings with which every row is flown, with its velocity and acceleration."""
    altitudes = task.motion.drones.coefficients[:, :, 2] - task.motion.requirements.floor
    below = floor(min(0.0, float(np.min(altitudes)))) - BELOW
    return Receiver(
        climb_altitude=below,
        climb_time=0.0,
        ground_altitude=below,
        shared_origin=False,
        global_setpoints=False,
        velocities=True,
        accelerations=True,
    )
