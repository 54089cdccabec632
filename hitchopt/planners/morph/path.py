"""Geometric paths of a hitch: flat outputs over a parameter s from 0 to 1, without timing."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from hitchopt.hitch import GRAVITY, Hitch, Team
from hitchopt.hitch.forces import cable_slack_of
from hitchopt.hitch.model import DroneJets, FlatJets, cable_of_span, drone_jets
from hitchopt.hitch.series import JET, Series, product
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array


class Path(Protocol):
    """A path that can be timed; hashed and compared by identity."""

    def __hash__(self) -> int: ...

    @property
    def team(self) -> Team:
        """The team of the hitch."""

    def flat(self, s: Array, count: int = JET) -> FlatJets:
        """Return the flat outputs' jets in s, with ``count`` coefficients, at s (J,)."""


def drones_along(path: Path, s: Array) -> DroneJets:
    """Return the drones' jets in s at s (J,)."""
    return drone_jets(path.team, path.flat(s))


def path_jets(path: Path, s: Array) -> tuple[Array, Array, Array, Array]:
    """Return jets (J, *shape, 4) in s of drones, vertices, legs and tensions at s (J,)."""
    flat = path.flat(s)
    drones = drone_jets(path.team, flat)
    legs = drones.legs * path.team.layout.has_leg[..., None]  # without rounding errors
    return drones.positions, flat.vertices, legs, flat.tensions


@dataclass(frozen=True, eq=False)
class LegLaw:
    """Law of the q-legs in the slack of their cables: ``d = length + share · slack``.

    A constant share keeps fractions, share 0 keeps ``d``, and share 1 with length ``-e`` keeps
    ``e``.
    """

    length: PiecewisePolynomial  # of shape (n,) over s [m]
    share: PiecewisePolynomial  # of shape (n,) over s

    @classmethod
    def of_fractions(cls, fractions: PiecewisePolynomial) -> LegLaw:
        """Return the law with prescribed fractions ``d_k / (d_k + e_k)``, (n,) over s."""
        zero = PiecewisePolynomial.constant([0.0, 1.0], np.zeros(fractions.shape))
        return cls(zero, fractions)

    def q_legs(self, s: Array, slack: Array) -> Array:
        """Return the jets (J, n, m) of ``d`` from those of the slack."""
        count = slack.shape[-1]
        part = product(self.share.jet(s, count), slack)
        return self.length.jet(s, count) + part if np.any(self.length.coefficients) else part


@dataclass(frozen=True, eq=False)
class ShapePath:
    """A path with polynomial vertices and a leg law."""

    team: Team  # of the hitch
    vertices: PiecewisePolynomial  # of shape (points, 3) over s in [0, 1] [m]
    legs: LegLaw  # law of the q-legs, except at the ends of a chain
    tensions: PiecewisePolynomial | None = None  # of shape (n,) over s [N], or None for the team's
    roll: PiecewisePolynomial | None = None  # of shape (clasps,) over s [rad], or None for none

    @classmethod
    def straight(cls, start: Hitch, end: Hitch) -> ShapePath:
        """Return the path with linear vertices, fractions and roll."""
        breaks = np.array([0.0, 1.0])
        vertices = np.stack([start.vertices, end.vertices], axis=-1)
        fractions = np.stack([start.fractions, end.fractions], axis=-1)
        return cls(
            start.team,
            PiecewisePolynomial(breaks, vertices[None]),
            LegLaw.of_fractions(PiecewisePolynomial(breaks, fractions[None])),
            roll=roll_between(start, end),
        )

    def climbing(self, by: float) -> ShapePath:
        """Return the path with a climb of the hitch's plane [m], linear in s."""
        breaks, heights = self.vertices.breaks, self.vertices.coefficients.copy()
        shares = np.linspace(0.0, 1.0, heights.shape[-1])
        s = breaks[:-1, None] + np.diff(breaks)[:, None] * shares  # Bernstein coefficients of s
        heights[:, :, 2] += by * s[:, None]
        return replace(self, vertices=PiecewisePolynomial(breaks, heights))

    def flat(self, s: Array, count: int = JET) -> FlatJets:
        """Return the flat outputs' jets in s, with ``count`` coefficients, at s (J,)."""
        vertices = self.vertices.jet(s, count)
        tensions = _constant_jets(self.team.tension, len(s), count)
        if self.tensions is not None:
            tensions = self.tensions.jet(s, count)
        roll = None if self.roll is None else self.roll.jet(s, count)
        edges = self.team.layout.edges(vertices, axis=1)
        slack = -cable_along(self.team, edges, tensions)
        slack[..., 0] += self.team.cable_length
        q_legs = self.team.layout.q_leg_jets(self.legs.q_legs(s, slack), slack)
        return FlatJets(vertices, q_legs, tensions, roll)


def roll_between(
    start: Hitch, end: Hitch, progress: tuple[float, ...] = (0.0, 1.0)
) -> PiecewisePolynomial | None:
    """Return the roll of shape (clasps,) over s between two hitches; None if neither has roll.

    Parameters
    ----------
    progress: Bernstein coefficients of the progress from 0 to 1.
    """
    if not np.any(start.roll) and not np.any(end.roll):
        return None
    change = (end.roll - start.roll)[:, None] * np.asarray(progress)
    return PiecewisePolynomial(np.array([0.0, 1.0]), (start.roll[:, None] + change)[None])


def cable_along(team: Team, chords: Array, tensions: Array) -> Array:
    """Return the jets (J, k, m) [m] of ``forces.cable_of`` for chords (J, k, 3, m) [m].

    Tensions have jets (J, k, m) [N].
    """
    weight = GRAVITY * team.cable_density or None
    with np.errstate(all="ignore"):
        spans = Series.of_jet(chords), Series.of_jet(tensions[..., None, :])
        cable = cable_of_span(*spans, weight)[0].jet[..., 0, :]
    stretched = chords[..., 0].any(axis=-1, keepdims=True)  # others are legs at a chain's ends
    return np.where(stretched, cable, 0.0)


@dataclass(frozen=True, eq=False)
class Shapes:
    """Shapes at J points of a path."""

    polygons: Array  # (J, points, 2) [m], in plan view
    # (J, n, 2) [m], ``d`` and ``e`` as cable lengths, negative if a cable is too short, zero at a
    # chain's ends
    legs: Array
    roll: Array | None = None  # (J, clasps) [rad], or None for none

    def __getitem__(self, mask: NDArray[np.bool_]) -> Shapes:
        roll = None if self.roll is None else self.roll[mask]
        return Shapes(self.polygons[mask], self.legs[mask], roll)


def shapes_along(path: Path, s: Array) -> Shapes:
    """Return the shapes at s (J,)."""
    return shapes_of(path.team, path.flat(s, 1))


def shapes_of(team: Team, flat: FlatJets) -> Shapes:
    """Return the shapes of flat outputs."""
    layout = team.layout
    edges = layout.edges(flat.vertices[..., 0])
    slack = cable_slack_of(team, edges, flat.tensions[..., 0])
    legs = layout.legs_of(flat.q_legs[..., 0], slack)
    roll = None if flat.roll is None else flat.roll[..., 0]
    return Shapes(flat.vertices[:, :, :2, 0], legs, roll)


@dataclass(frozen=True, eq=False)
class RigidPath:
    """A path with a straight centroid and a rotation about it, both linear in s.

    Parameters
    ----------
    start: the hitch at s = 0.
    to: (3,) [m], its centroid at s = 1.
    yaw: counter-clockwise rotation [rad], of any number of turns.
    """

    start: Hitch
    to: Array
    yaw: float

    @property
    def team(self) -> Team:
        """The team of the hitch."""
        return self.start.team

    @property
    def centroid(self) -> Array:
        """(3,) [m]: centroid at s = 0."""
        return np.append(self.start.polygon.centroid, self.start.altitude)

    @property
    def is_constant(self) -> bool:
        """Whether start and end are equal."""
        return self.yaw == 0.0 and bool(np.max(np.abs(self.to - self.centroid)) < 1e-9)

    def flat(self, s: Array, count: int = JET) -> FlatJets:
        """Return the flat outputs' jets in s, with ``count`` coefficients, at s (J,)."""
        hitch = self.start
        arms = (hitch.vertices[:, :2] - self.centroid[:2]) @ [1.0, 1.0j]
        rotated = np.exp(1.0j * self.yaw * s)[:, None] * arms
        rotated = rotated[..., None] * (1.0j * self.yaw) ** np.arange(count)
        vertices = np.zeros((len(s), len(arms), 3, count))
        vertices[:, :, 0], vertices[:, :, 1] = rotated.real, rotated.imag
        offset = self.to - self.centroid
        vertices[..., 0] += (self.centroid + s[:, None] * offset)[:, None]
        vertices[..., 1:2] += offset[:, None]
        constants = hitch.q_legs, hitch.team.tension, hitch.roll
        q_legs, tensions, roll = (_constant_jets(values, len(s), count) for values in constants)
        return FlatJets(vertices, q_legs, tensions, roll if np.any(hitch.roll) else None)


def _constant_jets(values: Array, points: int, count: int) -> Array:
    """Return the jets (points, k, count) of constants (k,)."""
    constants = np.zeros((points, len(values), count))
    constants[..., 0] = values
    return constants
