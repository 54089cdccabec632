"""Random disturbances of a flight, all from one seed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from hitchopt.objects import SolidObject
from hitchopt.simulation.simulation_settings import Perturbations
from hitchopt.values import Array

NOISE_TIME = 0.3
"""Correlation time of the error of measured positions [s]."""

VELOCITY_NOISE_TIME = 0.1
"""Correlation time of the error of measured velocities [s]."""

GUST_TIME = 1.0
"""Correlation time of gusts [s]."""


class Drift:
    """Ornstein-Uhlenbeck process: a random walk that is drawn back to zero.

    Its steps are exact, such that its spread does not depend on the step.

    Parameters
    ----------
    spread: standard deviation at every time.
    memory: correlation time [s].
    shape: shape of the values.
    random: source of random numbers.
    """

    def __init__(
        self, spread: float, memory: float, shape: tuple[int, ...], random: np.random.Generator
    ) -> None:
        self._spread = spread
        self._memory = memory
        self._random = random
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
        cables, start, noise, wind, velocity, direction, self._objects, vertices = streams
        self._perturbations = perturbations
        drones = (2 * robots, 3)
        self.cable_scale: Array = 1.0 + perturbations.cable_error * cables.standard_normal(robots)
        self.start_offset: Array = perturbations.start_error * start.standard_normal(drones)
        self.noise = Drift(perturbations.noise, NOISE_TIME, drones, noise)
        self.velocity_noise = Drift(
            perturbations.velocity_noise, VELOCITY_NOISE_TIME, drones, velocity
        )
        self.wind = Drift(perturbations.wind / np.sqrt(3.0), GUST_TIME, drones, wind)
        self._vertices = vertices
        heading = direction.uniform(0.0, 2.0 * np.pi)
        self.steady_wind: Array = perturbations.steady_wind * np.array(
            [np.cos(heading), np.sin(heading), 0.0]
        )

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
