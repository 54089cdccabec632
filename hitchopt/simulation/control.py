"""Disturbances, and drones that answer them: controller, motors, feedback of vertices.

The controller is the geometric one of T. Lee, M. Leok and N. H. McClamroch, "Geometric tracking
control of a quadrotor UAV on SE(3)", CDC 2010, adapted to a hitch in two respects: the cable's
force that the setpoints hold is fed forward, and nothing else; and the position loop is soft, since
a stiff one turns every centimetre of error into tension.

A ``rigid`` drone has an attitude loop (some 60 ms of delay) and motors (first order, 20 ms) between
the desired force and the actual one; a ``point`` drone has one lag of 80 ms.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import InputError
from hitchopt.hitch import GRAVITY, Team
from hitchopt.live.feedback import Feedback
from hitchopt.objects import SolidObject
from hitchopt.simulation.contacts import ClaspContacts
from hitchopt.simulation.settings import Perturbations, Settings
from hitchopt.simulation.task import Setpoints, Task
from hitchopt.simulation.world import BODY_HALF_HEIGHT, BODY_RADIUS, World
from hitchopt.values import Array

NOISE_TIME, VELOCITY_NOISE_TIME, GUST_TIME = 0.3, 0.1, 1.0
"""Correlation times of errors of measured positions and velocities, and of gusts [s]."""

AIR_DENSITY = 1.2
"""Density of air [kg/m³]."""

DRAG_COEFFICIENT = 1.2
"""Drag coefficient of a cylinder in cross-flow at the Reynolds numbers of a cord."""

SPREADING = 0.094
"""Half-width of a turbulent round jet per distance (Pope, Turbulent Flows, 2000, table 5.1)."""

BLOCKED = 0.5
"""Share of the downward momentum through a drone's disk that becomes force on it."""

POSITION_GAIN, VELOCITY_GAIN = 36.0, 10.0
"""Gains of the position loop where the team states no stiffness [1/s²], [1/s]: 4.75 N/m at 132 g.
Another stiffness has the same damping ratio."""

INTEGRAL_TIME = 2.0
"""Time after which the integral of a constant error answers as much as the error itself [s]."""

ATTITUDE_GAIN, RATE_GAIN = 900.0, 54.0
"""Gains of the attitude loop [1/s²], [1/s], whose delay is some 60 ms."""

LEAST_FORCE = 1e-9
"""Thrust below which it has no direction [N]."""

ARM = 0.5
"""Lever arm of the thrust in a drone's largest roll and pitch moments, over the drone's radius."""

MOMENT_SHARES = np.array([1.0, 1.0, 0.2])
"""Largest roll, pitch and yaw moment over the largest roll moment: propellers' drag is small."""

MEASURED, ROUNDING = 0.01, 1e-9
"""Period of the measurements of vertices, and rounding of sums of periods [s]."""


class Drift:
    """Ornstein-Uhlenbeck process: a random walk that is drawn back to zero, with exact steps.

    Parameters
    ----------
    spread: standard deviation at every time, whatever the step.
    memory: correlation time [s].
    shape: shape of the values.
    random: source of random numbers.
    """

    def __init__(
        self, spread: float, memory: float, shape: tuple[int, ...], random: np.random.Generator
    ) -> None:
        self._spread, self._memory, self._random = spread, memory, random
        self.value: Array = spread * random.standard_normal(shape)

    def advance(self, seconds: float) -> Array:
        """Return the value ``seconds`` later."""
        decay = np.exp(-seconds / self._memory)
        new = self._spread * np.sqrt(1.0 - decay**2)
        self.value = decay * self.value + new * self._random.standard_normal(self.value.shape)
        return self.value


class Disturbances:
    """Disturbances of one flight.

    Parameters
    ----------
    perturbations: magnitudes.
    robots: number n of catenary robots.
    seed: every quantity has a stream of its own, thus disabling one does not change the others.

    Attributes
    ----------
    cable_scale: (n,), lengths of the cables over the team's.
    start_offset: (2n, 3) [m], of the drones' first positions.
    noise, velocity_noise: errors of what drones measure (2n, 3) [m], [m/s].
    wind: gusts (2n, 3) [N].
    steady_wind: (3,) [N], constant and level, alike for all drones.
    """

    def __init__(self, perturbations: Perturbations, robots: int, seed: int) -> None:
        streams = map(np.random.default_rng, np.random.SeedSequence(seed).spawn(8))
        cables, start, noise, wind, velocity, direction, self._objects, self._vertices = streams
        given = self._perturbations = perturbations
        drones = (2 * robots, 3)
        self.cable_scale: Array = 1.0 + given.cable_error * cables.standard_normal(robots)
        self.start_offset: Array = given.start_error * start.standard_normal(drones)
        self.noise = Drift(given.noise, NOISE_TIME, drones, noise)
        self.velocity_noise = Drift(given.velocity_noise, VELOCITY_NOISE_TIME, drones, velocity)
        self.wind = Drift(given.wind / np.sqrt(3.0), GUST_TIME, drones, wind)
        heading = direction.uniform(0.0, 2.0 * np.pi)
        level = np.array([np.cos(heading), np.sin(heading), 0.0])
        self.steady_wind: Array = given.steady_wind * level

    def measured(self, vertices: Array) -> Array:
        """Return vertices (clasps, 3) [m] as they are measured."""
        spread = self._perturbations.vertex_noise
        return vertices + spread * self._vertices.standard_normal(vertices.shape)

    def disturbed(self, objects: Mapping[str, SolidObject]) -> dict[str, SolidObject]:
        """Return objects as they really are; call it once.

        Masses and friction deviate evenly within their bounds, the places of those that can move
        evenly within a circle.
        """
        given = self._perturbations
        mass, friction, far = self._objects.uniform(-1.0, 1.0, (3, len(objects)))
        heading = self._objects.uniform(0.0, 2.0 * np.pi, len(objects))
        away = given.object_place * np.sqrt(np.abs(far))
        offsets = np.column_stack([away * np.cos(heading), away * np.sin(heading), 0.0 * away])
        return {
            name: replace(
                each,
                mass=each.mass * (1.0 + given.object_mass * mass[i]),
                friction=each.friction * (1.0 + given.object_friction * friction[i]),
                at=each.at if each.fixed else each.at + offsets[i],
            )
            for i, (name, each) in enumerate(objects.items())
        }


def drag(world: World, damping: float = 0.0) -> Array:
    """Return (nodes, 3) [N]: the air's drag on the cables' inner nodes, as on cylinders.

    ``damping`` is an additional rate at which the nodes lose speed [1/s].
    """
    velocities, ropes = world.data.qvel[world.node_dofs], world.ropes
    segments = np.repeat(ropes.segment_lengths, ropes.segments - 1)
    speed = np.linalg.norm(velocities, axis=-1)
    area, mass = ropes.preset.diameter * segments, ropes.density * segments
    rate = 0.5 * AIR_DENSITY * DRAG_COEFFICIENT * area * speed + damping * mass
    forces: Array = -rate[:, None] * velocities
    return forces


def downwash(drones: Array, thrusts: Array) -> Array:
    """Return (2n, 3) [N]: the forces with which drones push down those below them.

    Below its disk a rotor's wake is modelled as a turbulent round jet: it carries the momentum of
    the thrust, in a Gaussian profile whose half-width grows by ``SPREADING`` per distance (Pope
    2000, section 5.1), starting from half of the drone's radius. A drone in it receives ``BLOCKED``
    times the momentum that meets its disk. Real wakes of four rotors differ near the drone. All
    pairs are evaluated, which suits teams of some hundred drones.

    Parameters
    ----------
    drones: positions (2n, 3) [m].
    thrusts: (2n,) [N]
    """
    offset = drones[:, None] - drones[None]  # [below, above]
    depth = -offset[..., 2]
    below = depth > BODY_HALF_HEIGHT
    half_width = 0.5 * BODY_RADIUS + SPREADING * np.where(below, depth, 0.0)
    spread = half_width**2 / (4.0 * np.log(2.0))  # of the momentum, whose profile is the square
    across = offset[..., 0] ** 2 + offset[..., 1] ** 2
    share = np.pi * BODY_RADIUS**2 / (2.0 * np.pi * spread) * np.exp(-0.5 * across / spread)
    push = np.where(below, BLOCKED * np.minimum(share, 1.0) * thrusts[None], 0.0)
    forces = np.zeros_like(drones)
    forces[:, 2] = -np.sum(push, axis=1)
    return forces


@dataclass(frozen=True, eq=False)
class PositionGains:
    """Gains of the drones' position loops.

    Attributes
    ----------
    stiffness, damping, integral: (2n,) [N/m], [N s/m], [N/(m s)]
    feed_forward: (2n,), whether the cable force of the setpoints is added.
    """

    stiffness: Array
    damping: Array
    integral: Array
    feed_forward: NDArray[np.bool_]

    @classmethod
    def of(cls, team: Team, settings: Settings) -> PositionGains:
        """Return the gains of a team's drones, the settings replacing what they state.

        Raises
        ------
        InputError: a stiffness with which a drone oscillates more and more.
        """
        own, given = POSITION_GAIN * team.mass, settings.stiffness
        stated = np.where(np.isfinite(team.stiffness), team.stiffness, own)
        stiffness = stated if given is None else np.full(team.drones, given)
        damping = VELOCITY_GAIN * np.sqrt(stiffness * team.mass / POSITION_GAIN)
        winds = team.integral if settings.integral is None else settings.integral
        feeds = team.feed_forward if settings.feed_forward is None else settings.feed_forward
        integral = np.where(winds, stiffness / INTEGRAL_TIME, 0.0)
        gains = cls(stiffness, damping, integral, np.broadcast_to(feeds, stiffness.shape))
        gains._check_stable(team.mass, settings)
        return gains

    def _check_stable(self, masses: Array, settings: Settings) -> None:
        """Check that errors decay: the loop's characteristic polynomial has no growing root.

        Raises
        ------
        InputError: a drone whose errors grow.
        """
        delay = np.array([settings.lag, 1.0])  # denominator of the delay, highest power first
        if settings.body == "rigid":
            delay = np.array([settings.lag, 1.0, RATE_GAIN, ATTITUDE_GAIN]) / ATTITUDE_GAIN
        for mass, *gains in np.unique(
            np.column_stack([masses, self.damping, self.stiffness, self.integral]), axis=0
        ):
            order = 3 if gains[2] > 0.0 else 2
            inertia = np.polymul(delay, mass * np.eye(order + 1)[0])
            growth = np.max(np.roots(np.polyadd(inertia, gains[:order])).real)
            if growth >= 0.0:
                raise InputError(
                    "stiffness",
                    float(gains[1]),
                    f"low enough for a drone of {mass:g} kg whose thrust lags behind its command; "
                    "at this one it oscillates more and more",
                    "lower it, or take --drones point with a shorter --lag",
                )


def desired_thrusts(
    setpoints: Setpoints,
    masses: Array,
    gains: PositionGains,
    positions: Array,
    velocities: Array,
    wound: Array | float = 0.0,
) -> Array:
    """Return the thrust (2n, 3) [N] that leads drones back to their setpoints.

    Parameters
    ----------
    setpoints: commands (2n, …).
    masses: (2n,) [kg]
    gains: of the position loops.
    positions, velocities: measured (2n, 3) [m], [m/s].
    wound: force of the integral action so far (2n, 3) [N].
    """
    error, rate = setpoints.positions - positions, setpoints.velocities - velocities
    forces: Array = masses[:, None] * (setpoints.accelerations + [0.0, 0.0, GRAVITY])
    forces += gains.stiffness[:, None] * error + gains.damping[:, None] * rate + wound
    forces -= gains.feed_forward[:, None] * setpoints.cable_forces
    return forces


def attitude_command(
    setpoints: Setpoints,
    desired: Array,
    attitudes: Array,
    rates: Array,
    masses: Array,
    inertia: Array,
) -> tuple[Array, Array]:
    """Return the thrust along each drone's axis and the moment that turns it to the desired one.

    Parameters
    ----------
    setpoints: their jerks and yaws are used.
    desired: thrust (2n, 3) [N].
    attitudes: (2n, 3, 3), columns are the body's axes in the world.
    rates: (2n, 3) [rad/s], about the body's axes.
    masses, inertia: (2n,) [kg], (2n, 3) [kg m²]

    Returns
    -------
    thrusts (2n,) [N], moments (2n, 3) [N m] about the body's axes; before any limit.
    """
    goals = desired_attitudes(desired, setpoints.yaw)
    size = np.maximum(np.linalg.norm(desired, axis=-1, keepdims=True), LEAST_FORCE)
    turning = np.einsum("iba,ib->ia", goals, masses[:, None] * setpoints.jerks / size)
    goal_rates = np.stack([-turning[:, 1], turning[:, 0], np.zeros(len(turning))], axis=-1)
    across = np.einsum("iba,ibc->iac", goals, attitudes)  # R_d^T R
    skew = 0.5 * (across - across.transpose(0, 2, 1))
    error = np.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], axis=-1)
    carried = np.einsum("iba,ib->ia", across, goal_rates)  # R^T R_d omega_d
    answer = -ATTITUDE_GAIN * error - RATE_GAIN * (rates - carried)
    moments = inertia * answer + _cross(rates, inertia * rates)
    return np.einsum("ia,ia->i", desired, attitudes[:, :, 2]), moments


def desired_attitudes(desired: Array, yaw: Array) -> Array:
    """Return (2n, 3, 3): the third axis along the desired thrust, the first toward the yaw."""
    third = desired / np.maximum(np.linalg.norm(desired, axis=-1, keepdims=True), LEAST_FORCE)
    heading = np.stack([np.cos(yaw), np.sin(yaw), np.zeros_like(yaw)], axis=-1)
    second = _cross(third, heading)
    second /= np.maximum(np.linalg.norm(second, axis=-1, keepdims=True), LEAST_FORCE)
    attitudes: Array = np.stack([_cross(second, third), second, third], axis=-1)
    return attitudes


def _cross(a: Array, b: Array) -> Array:
    """Return cross products (k, 3); numpy's takes longer than all other parts of a command."""
    (x, y, z), (u, v, w) = a.T, b.T
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=-1)


class Motors:
    """Motors with limits and a lag, which apply their forces to the drones of a world.

    Parameters
    ----------
    world: simulated world.
    max_thrust: (2n,) [N]
    lag: time constant [s].

    Attributes
    ----------
    saturated: whether the last command exceeded the thrust (2n,).
    thrusts: present thrusts (2n,) [N].
    """

    def __init__(self, world: World, max_thrust: Array, lag: float) -> None:
        self._world, self._max_thrust, self._lag = world, np.array(max_thrust), lag
        self._state: Array | None = None
        self.saturated = np.zeros(len(max_thrust), dtype=np.bool_)
        self.thrusts = np.zeros(len(max_thrust))

    def stop(self, drone: int) -> None:
        """Stop the motors of a drone, whose thrust fades with their lag."""
        self._max_thrust[drone] = 0.0

    def apply(self, desired: Array, setpoints: Setpoints, seconds: float) -> None:
        """Apply forces to the world's drones for the next ``seconds``, until the next command.

        Parameters
        ----------
        desired: thrust (2n, 3) [N].
        setpoints: define the yaw, and how the attitude is to turn.
        seconds: time until the next command.
        """
        world, most = self._world, self._max_thrust
        attitudes = world.data.xmat[world.drone_bodies].reshape(-1, 3, 3)
        if world.rigid:  # along the axis, and moments (2n, 4)
            rates = world.data.qvel[world.drone_dofs + 3]
            drones = (attitudes, rates, world.masses, world.inertia)
            size, moments = attitude_command(setpoints, desired, *drones)
            limit = ARM * BODY_RADIUS * most[:, None] * MOMENT_SHARES
            command = np.column_stack([np.clip(size, 0.0, most), np.clip(moments, -limit, limit)])
        else:  # the desired force (2n, 3), within its limit
            size = np.linalg.norm(desired, axis=-1)
            command = desired * np.minimum(1.0, most / np.maximum(size, LEAST_FORCE))[:, None]
        self.saturated = (size > most) & (most > 0.0)
        remains = np.exp(-seconds / self._lag) if self._lag > 0.0 else 0.0
        before = command if self._state is None else self._state
        state = self._state = command + (before - command) * remains
        applied = world.data.xfrc_applied
        if world.rigid:
            self.thrusts = state[:, 0]
            applied[world.drone_bodies, :3] = self.thrusts[:, None] * attitudes[:, :, 2]
            applied[world.drone_bodies, 3:] = np.einsum("iab,ib->ia", attitudes, state[:, 1:])
        else:
            self.thrusts = np.linalg.norm(state, axis=-1)
            applied[world.drone_bodies, :3] = state


class VertexFeedback:
    """The feedback of a flight: vertices measured with noise and delay, setpoints corrected.

    Parameters
    ----------
    task, settings, world, disturbances: of the flight.
    stiffness: (2n,) of the drones' position loops [N/m].

    Raises
    ------
    InputError: a task without its plan.
    """

    def __init__(
        self,
        task: Task,
        settings: Settings,
        world: World,
        disturbances: Disturbances,
        stiffness: Array,
    ) -> None:
        if task.motion is None:
            raise InputError("feedback", True, "with a plan", "give the plan's directory")
        self._delay = settings.perturbations.vertex_delay
        self._feedback = Feedback(task.motion, delay=self._delay, stiffness=stiffness)
        self._start = float(task.t[0])
        self._contacts, self._disturbances = ClaspContacts(world, task.team), disturbances
        self._waiting: deque[tuple[float, Array]] = deque()
        self._measured = 0.0

    @property
    def offsets(self) -> Array:
        """(2n, 3) [m]: corrections of the setpoints in force."""
        return self._feedback.offsets

    def corrected(
        self, setpoints: Setpoints, time: float, seconds: float, drones: Array
    ) -> Setpoints:
        """Return the setpoints with the corrections at a time [s] of the flight.

        ``seconds`` have passed since the last call; ``drones`` are as measured (2n, 3) [m].
        """
        told = None
        while self._waiting and self._waiting[0][0] <= time - self._delay + ROUNDING:
            told = self._waiting.popleft()
        given = (None, None) if told is None else (told[1], self._start + told[0])
        self._feedback.step(self._start + time, seconds, given[0], drones, measured=given[1])
        return replace(
            setpoints,
            positions=setpoints.positions + self._feedback.offsets,
            velocities=setpoints.velocities + self._feedback.velocities,
        )

    def observe(self, time: float, least_bearing: Array) -> None:
        """Measure the vertices, where it is time to, after a step until a time [s]."""
        self._contacts.gather()
        if time - self._measured >= MEASURED - ROUNDING:
            self._measured = time
            vertices, _ = self._contacts.collect(least_bearing)
            self._waiting.append((time, self._disturbances.measured(vertices)))
