"""Samples of a plan: their times, states of drones and vertices at them, and the final hitch."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hitchopt.errors import InputError, OneLine, UnsupportedError
from hitchopt.hitch import GRAVITY, Hitch, Swarm, Team
from hitchopt.hitch.forces import cable_force_rates, cable_forces
from hitchopt.motion.chapters import parts_at
from hitchopt.motion.loads import leg_tensions, tautness
from hitchopt.motion.motion import Motion
from hitchopt.values import Array, as_array, nonnegative, positive

UPWARD = np.array([0.0, 0.0, GRAVITY])
"""[m/s²] Added to accelerations: thrusts compensate gravity."""

END_TOLERANCE = 1e-6
"""[s] A plan's end closer than this to the last regular sample is not sampled."""

MAX_SAMPLES = 50_000_000
"""Maximum number of samples; more are refused before memory is allocated."""

TIME_TOLERANCE = 1e-9
"""[s] A time may lie outside the plan by this much: the rounding of sums of durations."""

AT_REST = ("velocities", "accelerations", "jerks", "cable_force_rates", "vertex_velocities")
"""Fields of states that are zero after a plan's end."""

OF_DRONES = (
    "positions",
    "velocities",
    "accelerations",
    "jerks",
    "cable_forces",
    "cable_force_rates",
    "masses",
)
"""Fields of states with an entry per drone."""

ITERATIONS = 30
"""Maximum corrections of the final hitch's legs and roll; without weight the first is exact."""

CONVERGED, ROLL_STEP, ROLL_ROUNDING = 1e-12, 1e-6, 1e-9
"""[m], [rad] Largest correction at convergence, step of the finite difference by roll, and roll
that counts as 0."""

MAX_DEVIATION = 1e-6
"""[m] Largest distance of a drone from the recovered hitch's, as for joints of a motion."""

BLOCK = 1 << 20
"""Number of coordinates of drones that are evaluated at once: their coefficients take ten times the
memory of their values."""


@dataclass(frozen=True, eq=False)
class States(OneLine):
    """States of drones and vertices at some times (…).

    Attributes
    ----------
    t: (…) [s], from the plan's start.
    formed: (…) whether the hitch exists; never of a swarm without cables.
    positions: of the drones q0, r0, q1, r1, … (…, 2n, 3) [m], or of a swarm's d0, d1, ….
    velocities, accelerations, jerks: (…, 2n, 3) [m/s], [m/s²], [m/s³]. Where pieces join, those of
        the later piece.
    cable_forces: (…, 2n, 3) [N], of the cable on each drone: of its leg (of its edge at a chain's
        end), or of a hanging cable while there is no hitch (``forces.cable_forces``).
    cable_force_rates: (…, 2n, 3) [N/s], their derivatives by time.
    vertices, vertex_velocities: (…, points, 3) [m], [m/s]. These, legs and tensions are meaningful
        only while the hitch is formed.
    legs: (…, n, 2) [m], ``d_k`` and ``e_k``.
    tensions: (…, n) [N].
    object_poses: (…, objects, 5): x, y, z [m] of their bases, cosine and sine of their yaws.
    borne: (…, objects), the share of each object's weight that clasps carry.
    masses: (…, 2n) [kg], of the drones.
    """

    t: Array
    formed: NDArray[np.bool_]
    positions: Array
    velocities: Array
    accelerations: Array
    jerks: Array
    cable_forces: Array
    cable_force_rates: Array
    vertices: Array
    vertex_velocities: Array
    legs: Array
    tensions: Array
    object_poses: Array
    borne: Array
    masses: Array

    def thrusts(self, team: Team | Swarm) -> Array:
        """Return (…, 2n, 3) [N] the thrust vectors ``m (a + g ẑ) - cable force``."""
        thrusts: Array = team.mass[:, None] * (self.accelerations + UPWARD) - self.cable_forces
        return thrusts

    def thrust_rates(self, team: Team | Swarm) -> Array:
        """Return (…, 2n, 3) [N/s] the derivatives of the thrust vectors by time."""
        rates: Array = team.mass[:, None] * self.jerks - self.cable_force_rates
        return rates

    @cached_property
    def _attitudes(self) -> Attitudes:
        masses = self.masses[..., None]
        thrusts = masses * (self.accelerations + UPWARD) - self.cable_forces
        return attitudes(thrusts, masses * self.jerks - self.cable_force_rates)

    @property
    def quaternions(self) -> Array:
        """(…, 2n, 4), w, x, y, z: attitudes with yaw 0, z along the thrust (``attitudes``)."""
        return self._attitudes.quaternions

    @property
    def body_rates(self) -> Array:
        """(…, 2n, 3) [rad/s]: angular velocity of the attitude about the drone's own axes."""
        return self._attitudes.body_rates


@dataclass(frozen=True, eq=False)
class Attitudes:
    """Attitudes (…, 4), w, x, y, z, body to world, and body rates (…, 3) [rad/s]."""

    quaternions: Array
    body_rates: Array


def attitudes(thrusts: Array, thrust_rates: Array, yaw: float = 0.0) -> Attitudes:
    """Return the attitudes that produce thrusts (…, 3) [N] at a constant yaw.

    A quadrotor thrusts along its body's z axis only, so the thrust vector and the yaw determine the
    attitude, and their derivatives the body rates (differential flatness: D. Mellinger and V.
    Kumar, "Minimum snap trajectory generation and control for quadrotors", ICRA 2011). Yaw is the
    first of the angles about the axes z, y, x. Rates are nan if the thrust is zero or points along
    the body's y axis at zero roll.

    Parameters
    ----------
    thrusts, thrust_rates: (…, 3) [N], and their derivatives by time.
    yaw: [rad]
    """
    c, s = np.cos(yaw), np.sin(yaw)
    # As seen from axes that are turned by the yaw.
    (ahead, left, up), (ahead_rate, left_rate, up_rate) = (
        (c * f[..., 0] + s * f[..., 1], c * f[..., 1] - s * f[..., 0], f[..., 2])
        for f in (thrusts, thrust_rates)
    )
    upright = np.hypot(ahead, up)
    pitch, roll = np.arctan2(ahead, up), np.arctan2(-left, upright)
    with np.errstate(all="ignore"):
        pitch_rate = (up * ahead_rate - ahead * up_rate) / upright**2
        stretch = (ahead * ahead_rate + up * up_rate) / upright
        roll_rate = (left * stretch - left_rate * upright) / (left**2 + upright**2)
    body_rates = [roll_rate, pitch_rate * np.cos(roll), -pitch_rate * np.sin(roll)]
    (cr, sr), (cp, sp), (cy, sy) = (
        (np.cos(0.5 * angle), np.sin(0.5 * angle)) for angle in (roll, pitch, yaw)
    )
    quaternions = [
        cy * cp * cr + sy * sp * sr,
        cy * cp * sr - sy * sp * cr,
        cy * sp * cr + sy * cp * sr,
        sy * cp * cr - cy * sp * sr,
    ]
    return Attitudes(np.stack(quaternions, axis=-1), np.stack(body_rates, axis=-1))


def sample_times(duration: float, rate: float) -> Array:
    """Return (samples,) [s]: every multiple of 1/rate [Hz] from 0, and the plan's end.

    The end is left out if it is within 1e-6 s of the last multiple.

    Raises
    ------
    InputError: a number out of its range, or more than MAX_SAMPLES samples.
    """
    duration = nonnegative("duration", duration)
    rate = positive("rate", rate)
    if duration * rate > MAX_SAMPLES:
        bound = f"at most {MAX_SAMPLES / duration:g} Hz"
        raise InputError("rate", rate, bound, "request fewer samples")
    times: Array = np.arange(int(duration * rate) + 2) / rate
    times = times[times <= duration]
    return times if duration - times[-1] <= END_TOLERANCE else np.append(times, duration)


def states_at(motion: Motion, t: ArrayLike) -> States:
    """Return the states at times t (…) [s], at least one, counted from the plan's start.

    After its end a plan stays at rest where it ended.

    Raises
    ------
    InputError: no time, a time before the start, or one that is not finite.
    """
    requested = as_array(t)
    if requested.size == 0 or not np.all((requested >= -TIME_TOLERANCE) & np.isfinite(requested)):
        raise InputError("t", t, "finite times from 0 s on", "count from the plan's start")
    times = np.minimum(requested, motion.duration)
    size = max(1, BLOCK // (3 * len(motion.team.drone_names)))
    blocks = list(iterate_states(motion, times.ravel(), size))
    states: dict[str, Any] = {}
    for field in fields(States):
        values = np.concatenate([getattr(block, field.name) for block in blocks])
        states[field.name] = values.reshape((*times.shape, *values.shape[1:]))
    for name in AT_REST:
        states[name][requested > motion.duration + TIME_TOLERANCE] = 0.0
    return States(**states | {"t": requested})


def iterate_states(motion: Motion, times: Array, size: int) -> Iterator[States]:
    """Yield the states at ``times`` (samples,) [s] in blocks of at most ``size``.

    Those of several groups have the drones of all; what cables do is known to each alone. Where a
    hitch changes its robots, vertices are counted along the ring of the time.
    """
    if len(motion.groups) > 1:
        each = [iterate_states(group.motion, times, size) for group in motion.groups]
        for blocks in zip(*each, strict=True):
            t = blocks[0].t
            here: dict[str, Any] = {
                name: np.concatenate([getattr(block, name) for block in blocks], axis=1)
                for name in OF_DRONES
            }
            for name in ("vertices", "legs", "tensions", "object_poses", "object_shares"):
                here[name] = getattr(motion, name).at(motion.drones.breaks[0] + t)
            here |= {"vertex_velocities": here["vertices"], "borne": here.pop("object_shares")}
            yield States(t=t, formed=np.zeros(len(t), np.bool_), **here)
        return
    if motion.changes:
        own = [replace(phase, ring=None, waiting=()) for phase in motion.phases]
        whole = motion.replaced(phases=tuple(own))
        for block in iterate_states(whole, times, size):
            for part, index, robots in parts_at(motion, block.t):
                since = motion.drones.breaks[0] - part.drones.breaks[0] + block.t[index]
                (known,) = iterate_states(part, np.maximum(since, 0.0), len(index))
                rows = np.add.outer(2 * robots, [0, 1]).ravel()
                for name in ("cable_forces", "cable_force_rates"):
                    getattr(block, name)[np.ix_(index, rows)] = getattr(known, name)
            yield block
        return
    pulls, taut = map(motion.drones.alike, (leg_tensions(motion), tautness(motion)))
    parts = motion.drones, motion.vertices, pulls, taut
    rates, inner = [part.differentiated() for part in parts], motion.drones.breaks[1:-1]
    second, third = (motion.drones.differentiated(order) for order in (2, 3))
    for first in range(0, len(times), size):
        t = times[first : first + size]
        at = np.minimum(motion.drones.breaks[0] + t, motion.drones.breaks[-1])
        values, slopes = (tuple(part.at(at) for part in each) for each in (parts, rates))
        yield States(
            t=t,
            formed=motion.formed[np.searchsorted(inner, at, side="right")],  # as the later piece
            positions=values[0],
            velocities=slopes[0],
            accelerations=second.at(at),
            jerks=third.at(at),
            cable_forces=cable_forces(motion.team, *values),
            cable_force_rates=cable_force_rates(motion.team, values, slopes),
            vertices=values[1],
            vertex_velocities=slopes[1],
            legs=motion.legs.at(at),
            tensions=motion.tensions.at(at),
            object_poses=motion.object_poses.at(at),
            borne=motion.object_shares.at(at),
            masses=np.broadcast_to(motion.team.mass, values[0].shape[:-1]),
        )


def final_hitch(motion: Motion) -> Hitch:
    """Return the hitch whose vertices and drones are those of the motion's end.

    Raises
    ------
    InputError: there is no hitch at the end.
    UnsupportedError: no hitch has its drones there, as cables have other tensions than the team's;
        there are several; or it changes its robots.
    """
    if len(motion.groups) > 1:
        raise UnsupportedError("several teams end; go on with one of them, of plan.motion.groups")
    if motion.changes:
        motion.refuse_several("going on from a plan's end", others=False)
    if not (motion.team.has_cables and motion.formed[-1]):
        remedy = "form one, or go on with the drones at plan.at(plan.duration)"
        raise InputError("end", "free cables", "a hitch", remedy)
    team, layout = motion.team, motion.team.layout
    drones, vertices, legs = (
        part.coefficients[-1, ..., -1] for part in (motion.drones, motion.vertices, motion.legs)
    )
    outline, altitude = vertices[:, :2], float(np.mean(vertices[:, 2]))
    raised = 2 * layout.clasps  # q_k, whose leg is at clasp k

    def tied(q_legs: Array, roll: Array) -> Hitch:
        return Hitch(team, outline, altitude, q_legs, roll)

    q_legs = layout.q_legs_of(legs[:, 0], Hitch.balanced(team, outline, altitude).slack)
    hitch = tied(q_legs, np.zeros(len(layout.clasps)))
    for _ in range(ITERATIONS):
        longer = np.where(layout.has_leg[:, 0], legs[:, 0] - hitch.legs[:, 0], 0.0)
        there = hitch.drones[raised, 2]
        higher = tied(hitch.q_legs, hitch.roll + ROLL_STEP).drones[raised, 2]
        turned = (drones[raised, 2] - there) * ROLL_STEP / (higher - there)
        hitch = tied(hitch.q_legs + longer, hitch.roll + np.clip(turned, -0.5, 0.5))
        if max(np.max(np.abs(longer)), np.max(np.abs(turned))) < CONVERGED:
            break
    hitch = tied(hitch.q_legs, np.where(np.abs(hitch.roll) < ROLL_ROUNDING, 0.0, hitch.roll))
    if np.max(np.abs(hitch.drones - drones)) > MAX_DEVIATION:
        raise UnsupportedError("the plan's end is no hitch with the team's tensions to go on from")
    return hitch
