"""Simulated hovers of drones whose rigid bodies are defined tilted, for recordings."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from hitchopt.lab.flights.recordings import RecordedFlight, Signal, Track
from hitchopt.values import Array

MASS, KP, KD, GRAVITY = 0.11, 1.0, 1.0, 9.81
RATE, STEP = 50.0, 2  # Of the recording [Hz]; steps of the simulation between samples
NAMES = ("cf2", "cf3", "cf5")


@dataclass(frozen=True)
class Hover:
    """A drone to be simulated: its tilt, its yaw, and what its thrust and commands are like."""

    tilt_deg: float
    toward: float  # direction of the tilt in the body's frame [rad]
    yaw: float  # [rad]
    thrust_factor: float = 1.0
    commands: str = ""  # none, positions or states
    circle: bool = False  # whether the setpoint moves along a circle at last
    seconds: float = 13.0  # at rest
    kp: float = KP
    kd: float = KD

    @property
    def tilt(self) -> Array:
        """Level over upright part of the body's z axis, in the body's frame at yaw 0 (2,)."""
        size = np.tan(np.radians(self.tilt_deg))
        return np.array([size * np.cos(self.toward), size * np.sin(self.toward)])

    @property
    def trim(self) -> Array:
        """Setpoint minus rest position in the body's frame at yaw 0 (2,) [m]."""
        return MASS * GRAVITY / self.kp * self.tilt


def random_hover(rng: np.random.Generator, **more: object) -> Hover:
    """Return a hover with a tilt of 0 to 12°, any yaw and any thrust factor."""
    tilt, toward, yaw = rng.uniform(0.0, 12.0), *rng.uniform(-np.pi, np.pi, 2)
    hover = Hover(tilt, toward, yaw, rng.uniform(0.9, 1.2))
    return replace(hover, **more)  # type: ignore[arg-type]


def flown(hovers: dict[str, Hover], seed: int, wander: float = 0.02) -> RecordedFlight:
    """Return a flight: on the ground, take-off, rest, perhaps a circle, landing.

    ``wander`` [m] is the standard deviation of the place at rest, by gusts of 1.5 s.
    """
    rng = np.random.default_rng(seed)
    tracks, setpoints = dict[str, Track](), dict[str, Track]()
    signals = dict[str, dict[str, Signal]]()
    for k, (name, hover) in enumerate(hovers.items()):
        end = 5.0 + hover.seconds + 8.0 * hover.circle
        t = np.arange(0.0, end + 4.0, 1.0 / RATE)
        target, velocity, acceleration = _targets(t, hover, end)
        target = target + [1.5 * k - 1.0, 0.3, 0.04]
        place, lean = _response(t, target, velocity, acceleration, hover, wander, rng)
        attitude = Rotation.from_euler("z", hover.yaw) * Rotation.from_rotvec(
            np.array([-hover.tilt[1], hover.tilt[0], 0.0])
            * np.radians(hover.tilt_deg) / max(np.hypot(*hover.tilt), 1e-12)
        )  # fmt: skip
        turns = np.stack([-lean[:, 1], lean[:, 0], np.zeros(len(t))], axis=1)
        turned = Rotation.from_rotvec(turns + 0.003 * rng.standard_normal((len(t), 3))) * attitude
        tracks[name] = Track(t, place + 3e-4 * rng.standard_normal(place.shape))
        lift = hover.thrust_factor * MASS * (GRAVITY + np.gradient(velocity[:, 2], t))
        values = {
            "attitude": turned.as_quat(),
            "thrust": (lift + 0.01 * rng.standard_normal(len(t)))[:, None],
        }
        if hover.commands:
            sent = (t > 4.0) & (t < end)
            setpoints[name] = Track(t[sent], target[sent])
            values["commanded_yaw"] = np.full((len(t), 1), hover.yaw)
        if hover.commands == "states":
            values |= {"commanded_velocity": velocity, "commanded_acceleration": acceleration}
        signals[name] = {
            quantity: Signal(t[sent], each[sent])
            if quantity.startswith("commanded")
            else Signal(t, each)
            for quantity, each in values.items()
        }
    return RecordedFlight("simulated", tracks, setpoints=setpoints, signals=signals)


def _targets(t: Array, hover: Hover, end: float) -> tuple[Array, Array, Array]:
    """Return setpoints, their velocities and accelerations (times, 3)."""
    target = np.zeros((len(t), 3))
    target[:, 2] = 0.6 * np.clip((t - 2.0) / 2.0, 0.0, 1.0) - 0.6 * np.clip((t - end) / 3, 0, 1)
    if hover.circle:
        angle = 0.5 * np.clip(t - 5.0 - hover.seconds, 0.0, 8.0) ** 2 / 4.0
        angle = np.where(t > end, angle[np.searchsorted(t, end) - 1], angle)
        target[:, 0], target[:, 1] = 0.8 * np.sin(angle), 0.8 - 0.8 * np.cos(angle)
    velocity: Array = np.stack([np.gradient(x, t) for x in target.T], axis=1)
    return target, velocity, np.stack([np.gradient(x, t) for x in velocity.T], axis=1)


def _response(
    t: Array,
    target: Array,
    velocity: Array,
    acceleration: Array,
    hover: Hover,
    wander: float,
    rng: np.random.Generator,
) -> tuple[Array, Array]:
    """Return places (times, 3) [m] and leans (times, 2) [rad] of a drone on its position loop."""
    c, s = np.cos(hover.yaw), np.sin(hover.yaw)
    trim = np.array([[c, -s], [s, c]]) @ hover.trim
    place, lean = target.copy(), np.zeros((len(t), 2))
    x, v, gust, dt = target[0, :2].copy(), np.zeros(2), np.zeros(2), 1.0 / RATE / STEP
    decay = np.exp(-1.0 / RATE / 1.5)
    for i in range(len(t)):
        place[i, :2] = x
        if target[i, 2] < target[0, 2] + 0.02:  # On the ground
            v[:] = 0.0
            continue
        gust = decay * gust + hover.kp * wander * np.sqrt(1 - decay**2) * rng.standard_normal(2)
        own = hover.kp * (target[i, :2] - trim)
        if hover.commands == "states":
            own = own + hover.kd * velocity[i, :2] + MASS * acceleration[i, :2]
        for _ in range(STEP):
            a = (own - hover.kp * x - hover.kd * v + gust) / MASS
            v = v + dt * a
            x = x + dt * v
        lean[i] = (a - gust / MASS) / GRAVITY
    place[:, 2] += 0.005 * np.sin(t)
    return place, lean
