"""Simulated logs of drones that carry one load, with the firmware's filter for one marker."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.replay import cable_pulls
from hitchopt.drones.controllers import ONE_MARKER
from hitchopt.lab.flights.recordings import RecordedFlight, Signal, Track
from hitchopt.lab.simulation.estimator import Filter
from hitchopt.values import Array

GRAVITY, MASS, LOAD = 9.81, 0.0345, 0.01


def carried(
    seconds: float = 7.0, tilt_deg: float = 0.0, seed: int = 0, thrust_factor: float = 1.1
) -> RecordedFlight:
    """Return a flight of two drones with a load, as the firmware's filter for one marker logs it.

    Gyroscopes show fast changes of the pull, so the load swings slowly.
    Rigid bodies, whose attitudes are captured, are defined tilted.
    """
    t = np.arange(0.0, seconds, 0.01)
    wave = np.stack([0.4 * np.sin(1.2 * t), 0.2 * np.sin(1.7 * t), 0.05 * np.sin(t)], axis=1)
    swing = np.stack([0.06 * np.sin(0.5 * t), 0.05 * np.sin(0.4 * t + 1.0), 0.0 * t], axis=1)
    places = [wave + [0.3, 0.0, 1.0], wave + [-0.3, 0.0, 1.0]]
    load = wave + swing + [0.0, 0.0, 0.6]
    tracks = {f"cf{k}": Track(t, place) for k, place in enumerate(places)}
    flight = RecordedFlight("carried", tracks, loads={"load": Track(t, load)})
    signals, rng = dict[str, dict[str, Signal]](), np.random.default_rng(seed)
    for (name, track), pull in zip(tracks.items(), cable_pulls(flight, t, LOAD), strict=True):
        attitude, rates, force, thrust = _sensed(t, track.positions, pull / MASS)
        noisy = rates + 0.01 * rng.standard_normal(rates.shape)
        velocity = np.gradient(track.positions, t, axis=0)
        filters = Filter(ONE_MARKER, track.positions[:1], velocity[:1], attitude[:1])
        believed = [attitude[0]]
        for i in range(1, len(t)):
            filters.advance(0.5 * (noisy[i - 1 : i] + noisy[i : i + 1]), force[i : i + 1, 2], 0.01)
            filters.observe(track.positions[i : i + 1])
            believed.append(filters.attitudes[0])
        body = Rotation.from_euler("y", math.radians(tilt_deg)).as_matrix()
        values = {
            "attitude": Rotation.from_matrix(attitude @ body).as_quat(),
            "estimated_attitude": Rotation.from_matrix(np.stack(believed)).as_quat(),
            "estimated_velocity": velocity,
            "rates": noisy,
            "specific_force": force,
            "thrust": thrust_factor * MASS * thrust,
        }
        signals[name] = {quantity: Signal(t, each) for quantity, each in values.items()}
    return replace(flight, signals=signals)


def _sensed(t: Array, place: Array, pull: Array) -> tuple[Array, Array, Array, Array]:
    """Return attitudes, rates, specific forces and thrusts over mass, with a pull over mass."""
    acceleration = np.gradient(np.gradient(place, t, axis=0), t, axis=0)
    lift = acceleration + [0.0, 0.0, GRAVITY] - pull
    up = lift / np.linalg.norm(lift, axis=1, keepdims=True)
    side = np.cross(up, [1.0, 0.0, 0.0])
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    attitude = np.stack([np.cross(side, up), side, up], axis=2)
    relative = attitude[:-1].transpose(0, 2, 1) @ attitude[1:]
    turns = Rotation.from_matrix(relative).as_rotvec() / 0.01
    rates = np.stack([np.interp(t, 0.5 * (t[1:] + t[:-1]), x) for x in turns.T], axis=1)
    force = np.einsum("iba,ib->ia", attitude, acceleration + [0.0, 0.0, GRAVITY])
    return attitude, rates, force, np.linalg.norm(lift, axis=1, keepdims=True)
