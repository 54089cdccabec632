"""Samples of a plan: times, states of drones and vertices, and the final hitch."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hitchopt.errors import InputError, OneLine
from hitchopt.geometry.vectors import dot, length
from hitchopt.hitch import GRAVITY, Hitch, Swarm, Team
from hitchopt.hitch.forces import cable_force_rates, cable_forces
from hitchopt.motion.flight import Flight
from hitchopt.motion.loads import leg_tensions, tautness
from hitchopt.motion.motion import Motion
from hitchopt.support import Feature, Neighbour, refused_value, unsupported
from hitchopt.values import Array, as_array, finite, nonnegative, positive

HOVER = np.array([0.0, 0.0, GRAVITY])  # [m/s²] Specific thrust that compensates gravity

END_TOLERANCE = 1e-6
"""[s] Minimum distance of a plan's end from the last regular sample at which it is sampled."""

MIN_THRUST = 1e-9  # [N] Smallest divisor of thrusts
MAX_RATE = 10_000.0  # Maximum sampling rate [Hz]: no flight controller accepts a higher one
MAX_SAMPLES = 50_000_000  # Maximum number of samples; more are refused before memory is allocated

TAUT_RATIO = 0.9
"""Smallest tension of a taut hitch over the team's; vertices of loose ones are ill-defined."""

TIME_TOLERANCE = 1e-9
"""[s] Largest distance of a time outside the plan: rounding of sums of durations."""

ZERO_AT_REST = ("velocities", "accelerations", "jerks", "cable_force_rates", "vertex_velocities")
"""Fields of states that are zero after a plan's end."""

DRONE_FIELDS = (
    *("positions", "velocities", "accelerations", "jerks"),
    *("cable_forces", "cable_force_rates", "masses"),
)
"""Fields of states with one entry per drone."""

ITERATIONS = 30
"""Maximum Newton steps for the final hitch's legs and roll; without weight, the first is exact."""

CONVERGED = 1e-12  # [m], [rad] Largest step at convergence
ROLL_STEP = 1e-6  # [rad] Finite difference of roll
ROLL_ROUNDING = 1e-9  # [rad] Roll that counts as zero
MAX_ROLL_STEP = 0.5  # [rad] Largest change of a roll in one step
MAX_DEVIATION = 1e-6  # [m] Largest distance of a drone from that of the recovered hitch

BLOCK = 1 << 20
"""Number of coordinates of drones evaluated at a time: their coefficients take ten times the memory
of their values."""


@dataclass(frozen=True, eq=False)
class States(OneLine):
    """States of drones and vertices at some times (…).

    Attributes
    ----------
    t: (…) [s], from the plan's start.
    formed: (…), whether the hitch exists; False for a swarm without cables.
    positions: (…, 2n, 3) [m], of the drones q0, r0, q1, r1, …, or d0, d1, … of a swarm, in the
        order of the problem.
    velocities, accelerations, jerks: (…, 2n, 3) [m/s], [m/s²], [m/s³]; at a break, those of the
        later piece.
    cable_forces: (…, 2n, 3) [N], of the cable on each drone: of its leg (of its edge at a chain's
        end), or of a hanging cable while there is no hitch (``forces.cable_forces``).
    cable_force_rates: (…, 2n, 3) [N/s], their time derivatives.
    vertices, vertex_velocities: (…, points, 3) [m], [m/s]. These, legs and tensions are only
        meaningful while the hitch exists.
    legs: (…, n, 2) [m], of the drones q and r of every robot.
    tensions: (…, n) [N], of the robots' cables.
    object_poses: (…, objects, 5): x, y, z [m] of their bases, cosine and sine of yaw.
    load_share: (…, objects), fraction of each object's weight that clasps carry.
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
    load_share: Array
    masses: Array

    def __getitem__(self, index: int | list[int] | slice) -> States:
        """Return the states of one sample, or of some."""
        return States(*(getattr(self, field.name)[index] for field in fields(self)))

    def ending_at_rest(self) -> States:
        """Return states (S, …) whose last sample is at rest, without velocities and rates."""
        values = {name: getattr(self, name).copy() for name in ZERO_AT_REST}
        for value in values.values():
            value[-1] = 0.0
        return replace(self, **values)

    def listed(self, team: Team) -> States:
        """Return states of a team with drones and robots in the order of the problem."""
        drones = team.listed
        robots = team.edges
        if np.array_equal(drones, np.arange(len(drones))):
            return self
        values = {name: getattr(self, name).take(drones, self.t.ndim) for name in DRONE_FIELDS}
        legs = self.legs.reshape(*self.t.shape, -1)[..., drones[: 2 * len(robots)]]
        values |= {"legs": legs.reshape(self.legs.shape), "tensions": self.tensions[..., robots]}
        return replace(self, **values)

    def thrusts(self, team: Team | Swarm) -> Array:
        """Return the thrust vectors (…, 2n, 3) [N], ``m (a + g ẑ) - cable force``.

        The team's drones are in the order of the states.
        """
        return np.asarray(team.mass[:, None] * (self.accelerations + HOVER) - self.cable_forces)

    def thrust_rates(self, team: Team | Swarm) -> Array:
        """Return the time derivatives of the thrust vectors (…, 2n, 3) [N/s]."""
        return np.asarray(team.mass[:, None] * self.jerks - self.cable_force_rates)

    def taut(self, tension: Array) -> NDArray[np.bool_]:
        """Return whether there is a taut hitch (…), of a team with tensions (n,) [N]."""
        taut: NDArray[np.bool_] = np.all(self.tensions >= TAUT_RATIO * tension, axis=-1)
        return self.formed & taut

    def held_forces(self, false_pull: Array) -> Array:
        """Return the cable forces (…, 2n, 3) [N] that controllers have to hold.

        To the cable force F, filters that take a pull across the thrust for an acceleration add
        ``false_pull (F - (F·b) b)``, with the thrust's direction b. ``false_pull`` (2n, 3) is that
        of ``FlightController``, of the drones in the order of the states.
        """
        if not np.any(false_pull):
            return self.cable_forces
        return self.cable_forces + false_pull * self._across_thrust[0]

    def held_force_rates(self, false_pull: Array) -> Array:
        """Return the time derivatives of ``held_forces`` (…, 2n, 3) [N/s]."""
        if not np.any(false_pull):
            return self.cable_force_rates
        return self.cable_force_rates + false_pull * self._across_thrust[1]

    @cached_property
    def _across_thrust(self) -> tuple[Array, Array]:
        """Parts of cable forces across the thrust, and their time derivatives (…, 2n, 3)."""
        masses = self.masses[..., None]
        forces = self.cable_forces
        rates = self.cable_force_rates
        thrusts = masses * (self.accelerations + HOVER) - forces
        thrust_rates = masses * self.jerks - rates
        size = np.maximum(length(thrusts), MIN_THRUST)[..., None]
        direction = thrusts / size
        turning = (thrust_rates - dot(thrust_rates, direction)[..., None] * direction) / size
        along = dot(forces, direction)[..., None]
        along_rates = (dot(rates, direction) + dot(forces, turning))[..., None]
        return (
            forces - along * direction,
            rates - along_rates * direction - along * turning,
        )

    @cached_property
    def _attitudes(self) -> Attitudes:
        """Attitudes and body rates of the drones, with the masses of the states."""
        masses = self.masses[..., None]
        thrusts = masses * (self.accelerations + HOVER) - self.cable_forces
        return attitudes(thrusts, masses * self.jerks - self.cable_force_rates)

    @property
    def quaternions(self) -> Array:
        """(…, 2n, 4), w, x, y, z: attitudes with yaw 0, z along the thrust (``attitudes``)."""
        return self._attitudes.quaternions

    @property
    def body_rates(self) -> Array:
        """(…, 2n, 3) [rad/s]: angular velocities about the drones' own axes."""
        return self._attitudes.body_rates


@dataclass(frozen=True, eq=False)
class Attitudes:
    """Attitudes of drones, and the rates of their bodies."""

    quaternions: Array  # (…, 4), w, x, y, z, from body to world
    body_rates: Array  # (…, 3) [rad/s], about the body's own axes


def attitudes(thrusts: Array, thrust_rates: Array, yaw: float = 0.0) -> Attitudes:
    """Return the attitudes that produce thrusts (…, 3) [N] at a constant yaw.

    A quadrotor thrusts along its body's z axis only, so the thrust vector and the yaw determine the
    attitude, and their derivatives the body rates (differential flatness: D. Mellinger and V.
    Kumar, "Minimum snap trajectory generation and control for quadrotors", ICRA 2011). Yaw is the
    first of the angles about the axes z, y, x. Rates are nan if the thrust is zero or points along
    the body's y axis at zero roll.

    Parameters
    ----------
    thrusts, thrust_rates: (…, 3) [N], and their time derivatives.
    yaw: [rad]
    """
    ahead, left, up = _components(thrusts, yaw)
    ahead_rate, left_rate, up_rate = _components(thrust_rates, yaw)
    upright = np.hypot(ahead, up)
    pitch = np.arctan2(ahead, up)
    roll = np.arctan2(-left, upright)
    with np.errstate(all="ignore"):
        pitch_rate = (up * ahead_rate - ahead * up_rate) / upright**2
        upright_rate = (ahead * ahead_rate + up * up_rate) / upright
        roll_rate = (left * upright_rate - left_rate * upright) / (left**2 + upright**2)
    body_rates = [roll_rate, pitch_rate * np.cos(roll), -pitch_rate * np.sin(roll)]
    return Attitudes(_quaternions(roll, pitch, yaw), np.stack(body_rates, axis=-1))


def _components(vectors: Array, yaw: float) -> tuple[Array, Array, Array]:
    """Return the components (…) of vectors (…, 3) ahead, to the left and up at a yaw [rad]."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    cosine = np.cos(yaw)
    sine = np.sin(yaw)
    return cosine * x + sine * y, cosine * y - sine * x, z


def _quaternions(roll: Array, pitch: Array, yaw: float) -> Array:
    """Return the quaternions (…, 4) of turns by yaw, then pitch, then roll (…) [rad]."""
    cos_roll, sin_roll = np.cos(0.5 * roll), np.sin(0.5 * roll)
    cos_pitch, sin_pitch = np.cos(0.5 * pitch), np.sin(0.5 * pitch)
    cos_yaw, sin_yaw = np.cos(0.5 * yaw), np.sin(0.5 * yaw)
    w = cos_yaw * cos_pitch * cos_roll + sin_yaw * sin_pitch * sin_roll
    x = cos_yaw * cos_pitch * sin_roll - sin_yaw * sin_pitch * cos_roll
    y = cos_yaw * sin_pitch * cos_roll + sin_yaw * cos_pitch * sin_roll
    z = sin_yaw * cos_pitch * cos_roll - cos_yaw * sin_pitch * sin_roll
    return np.stack([w, x, y, z], axis=-1)


def sample_times(duration: float, rate: float) -> Array:
    """Return times (samples,) [s]: all multiples of 1/rate [Hz] from 0, and the plan's end.

    The end is omitted within 1e-6 s of the last multiple.

    Raises InputError for a number out of its range, or more than MAX_SAMPLES samples.
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
    """Return the states of one team at times t (…) [s], at least one, from the motion's start.

    After its end, a plan stays at rest.

    Raises InputError for no time, a time before the start, or one that is not finite.
    """
    return flight_states_at(Flight.of(motion), t)


def flight_states_at(flight: Flight, t: ArrayLike) -> States:
    """Return the states of all drones of a flight, as ``states_at``.

    Of several teams, vertices, legs and tensions are omitted: they are those of each team.
    """
    requested = as_array("t", t)
    if requested.size == 0 or not np.all((requested >= -TIME_TOLERANCE) & np.isfinite(requested)):
        raise InputError("t", t, "finite times of at least 0 s", "pass times from the plan's start")
    times = np.minimum(requested, flight.duration)
    block_size = max(1, BLOCK // (3 * len(flight.team.drone_names)))
    blocks = list(iterate_flight_states(flight, times.ravel(), block_size))
    states: dict[str, Any] = {}
    for field in fields(States):
        values = np.concatenate([getattr(block, field.name) for block in blocks])
        states[field.name] = values.reshape((*times.shape, *values.shape[1:]))
    for name in ZERO_AT_REST:
        states[name][requested > flight.duration + TIME_TOLERANCE] = 0.0
    return States(**states | {"t": requested})


def iterate_flight_states(flight: Flight, times: Array, block_size: int) -> Iterator[States]:
    """Yield the states of all drones of a flight in blocks, as ``iterate_states``.

    Of several teams, vertices, legs and tensions are omitted: they are those of each team.
    """
    of_teams = [iterate_states(flown.motion, times, block_size) for flown in flight.teams]
    if len(of_teams) == 1:
        yield from of_teams[0]
        return
    for blocks in zip(*of_teams, strict=True):
        t = blocks[0].t
        count = len(t)
        of_drones: dict[str, Array] = {
            name: np.concatenate([getattr(block, name) for block in blocks], axis=1)
            for name in DRONE_FIELDS
        }
        poses = flight.poses.at(flight.breaks[0] + t)
        yield States(
            t=t,
            formed=np.zeros(count, np.bool_),
            vertices=np.zeros((count, 0, 3)),
            vertex_velocities=np.zeros((count, 0, 3)),
            legs=np.zeros((count, 0, 2)),
            tensions=np.zeros((count, 0)),
            object_poses=poses,
            load_share=np.zeros(poses.shape[:2]),
            **of_drones,
        )


def iterate_states(motion: Motion, times: Array, block_size: int) -> Iterator[States]:
    """Yield the states of one team at times (samples,) [s] in blocks of at most ``block_size``."""
    drones = motion.drones
    pulls = drones.replaced(leg_tensions(motion))
    taut = drones.replaced(tautness(motion))
    sources_of_force = drones, motion.pull_points, pulls, taut
    force_rate_sources = [curve.differentiated() for curve in sources_of_force]
    vertex_velocities = motion.vertices.differentiated()
    accelerations = drones.differentiated(2)
    jerks = drones.differentiated(3)
    for first in range(0, len(times), block_size):
        t = times[first : first + block_size]
        plan_times = np.minimum(drones.breaks[0] + t, drones.breaks[-1])
        piece = np.searchsorted(drones.breaks[1:-1], plan_times, side="right")
        values = tuple(curve.at(plan_times) for curve in sources_of_force)
        rates = tuple(curve.at(plan_times) for curve in force_rate_sources)
        yield States(
            t=t,
            formed=motion.formed[piece],
            positions=values[0],
            velocities=rates[0],
            accelerations=accelerations.at(plan_times),
            jerks=jerks.at(plan_times),
            cable_forces=cable_forces(motion.team, *values),
            cable_force_rates=cable_force_rates(motion.team, values, rates),
            vertices=motion.vertices.at(plan_times),
            vertex_velocities=vertex_velocities.at(plan_times),
            legs=motion.legs.at(plan_times),
            tensions=motion.tensions.at(plan_times),
            object_poses=motion.poses.at(plan_times),
            load_share=motion.load_share.at(plan_times),
            masses=np.broadcast_to(motion.team.mass, values[0].shape[:-1]),
        )


def final_hitch(motion: Motion) -> Hitch:
    """Return the hitch with the vertices and drones of the motion's end.

    Raises InputError if there is no hitch at the end; UnsupportedError if cables end with other
    tensions than the team's.
    """
    team = motion.team
    if not team.has_cables:
        raise refused_value(Feature.END, Neighbour.SINGLE_DRONES, "single drones")
    if not motion.formed[-1]:
        raise refused_value(Feature.END, Neighbour.FREE_CABLES, "free cables")
    drones = motion.drones.coefficients[-1, ..., -1]
    vertices = motion.vertices.coefficients[-1, ..., -1]
    hitch = fitted_hitch(team, drones, vertices, motion.legs.coefficients[-1, ..., -1])
    if np.max(np.abs(hitch.drones - drones)) > MAX_DEVIATION:
        raise unsupported(Feature.END, Neighbour.OTHER_TENSIONS)
    return hitch


def fitted_hitch(team: Team, drones: Array, vertices: Array, legs: Array) -> Hitch:
    """Return the hitch with vertices (points, 3), legs (n, 2) and heights of drones (2n, 3) [m].

    Newton's method on the roll of each clasp, by the height of its q-drone, and on the q-legs.
    """
    layout = team.layout
    outline = vertices[:, :2]
    altitude = float(np.mean(vertices[:, 2]))
    q_drones = 2 * layout.clasps  # q_k, whose leg is at clasp k

    def hitch_of(q_legs: Array, roll: Array) -> Hitch:
        return Hitch(team, outline, altitude, q_legs, roll)

    q_legs = layout.q_legs_of(legs[:, 0], Hitch.balanced(team, outline, altitude).slack)
    hitch = hitch_of(q_legs, np.zeros(len(layout.clasps)))
    for _ in range(ITERATIONS):
        leg_step = np.where(layout.has_leg[:, 0], legs[:, 0] - hitch.legs[:, 0], 0.0)
        heights = hitch.drones[q_drones, 2]
        raised_heights = hitch_of(hitch.q_legs, hitch.roll + ROLL_STEP).drones[q_drones, 2]
        roll_step = (drones[q_drones, 2] - heights) * ROLL_STEP / (raised_heights - heights)
        limited_step = np.clip(roll_step, -MAX_ROLL_STEP, MAX_ROLL_STEP)
        hitch = hitch_of(hitch.q_legs + leg_step, hitch.roll + limited_step)
        if max(np.max(np.abs(leg_step)), np.max(np.abs(roll_step))) < CONVERGED:
            break
    return hitch_of(hitch.q_legs, np.where(np.abs(hitch.roll) < ROLL_ROUNDING, 0.0, hitch.roll))


def checked_rate(rate: object, key: str = "rate") -> float:
    """Return the rate [Hz]; raises InputError if it is no number or out of range."""
    number = finite(key, rate)
    if not 0.0 < number <= MAX_RATE:
        raise InputError(key, rate, f"above 0 and at most {MAX_RATE:g} Hz", "100 Hz is usual")
    return number
