"""Geometric paths of a hitch: flat outputs over a parameter s from 0 to 1, not yet timed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.forces import cable_slack_of, sag_factors
from hitchopt.hitch.model import DroneJets, FlatJets, drone_jets
from hitchopt.hitch.series import JET
from hitchopt.planners.morph import jets
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array


class Path(Protocol):
    """A path that can be timed and flown; compared by identity."""

    def __hash__(self) -> int: ...

    @property
    def team(self) -> Team:
        """The team whose cables form the hitch."""

    def flat(self, s: Array, count: int = JET) -> FlatJets:
        """Return the flat outputs' jets by s at s (J,), of ``count`` numbers each."""


def drones_along(path: Path, s: Array) -> DroneJets:
    """Return the drones' jets by s at s (J,)."""
    return drone_jets(path.team, path.flat(s))


def path_jets(path: Path, s: Array) -> tuple[Array, Array, Array, Array]:
    """Return the jets by s at s (J,) of drones, vertices, legs and tensions: (J, *shape, 4)."""
    flat = path.flat(s)
    drones = drone_jets(path.team, flat)
    legs = drones.legs * path.team.layout.has_leg[..., None]  # exactly zero, not nearly
    return drones.positions, flat.vertices, legs, flat.tensions


@dataclass(frozen=True, eq=False)
class LegLaw:
    """Law of the q-legs by the slack of their cables: ``d = length + share · slack``.

    A fixed share keeps fractions; share 0 keeps ``d``; share 1 and length ``-e`` keep ``e``.

    Attributes
    ----------
    length: of shape (n,) over s [m].
    share: of shape (n,) over s.
    """

    length: PiecewisePolynomial
    share: PiecewisePolynomial

    @classmethod
    def of_fractions(cls, fractions: PiecewisePolynomial) -> LegLaw:
        """Return the law under which ``d_k / (d_k + e_k)`` is as given, (n,) over s."""
        nothing = PiecewisePolynomial.constant([0.0, 1.0], np.zeros(fractions.shape))
        return cls(nothing, fractions)

    def q_legs(self, s: Array, slack: Array) -> Array:
        """Return the jets (J, n, m) of ``d`` for those of the slack."""
        count = slack.shape[-1]
        shared = jets.product(self.share.jet(s, count), slack)
        return self.length.jet(s, count) + shared if np.any(self.length.coefficients) else shared


@dataclass(frozen=True, eq=False)
class ShapePath:
    """Vertices on polynomials of s, legs by a law.

    Attributes
    ----------
    team: whose cables.
    vertices: of shape (points, 3) over s in [0, 1] [m].
    legs: the law of the q-legs, wherever the ends of a chain leave a choice.
    tensions: of shape (n,) over s [N], or None for the team's.
    roll: of shape (clasps,) over s [rad], or None where legs are not rolled.
    """

    team: Team
    vertices: PiecewisePolynomial
    legs: LegLaw
    tensions: PiecewisePolynomial | None = None
    roll: PiecewisePolynomial | None = None

    @classmethod
    def straight(cls, start: Hitch, end: Hitch) -> ShapePath:
        """Return the path on which vertices go straight; fractions and roll change linearly."""
        whole = np.array([0.0, 1.0])
        vertices = np.stack([start.vertices, end.vertices], axis=-1)
        fractions = np.stack([start.fractions, end.fractions], axis=-1)
        return cls(
            start.team,
            PiecewisePolynomial(whole, vertices[None]),
            LegLaw.of_fractions(PiecewisePolynomial(whole, fractions[None])),
            roll=roll_between(start, end),
        )

    def flat(self, s: Array, count: int = JET) -> FlatJets:
        """Return the flat outputs' jets by s at s (J,), of ``count`` numbers each."""
        vertices = self.vertices.jet(s, count)
        tensions = _steady(self.team.tension, len(s), count)
        if self.tensions is not None:
            tensions = self.tensions.jet(s, count)
        roll = None if self.roll is None else self.roll.jet(s, count)
        edges = self.team.layout.edges(vertices, axis=1)
        slack = -cable_along(self.team, edges, tensions)
        slack[..., 0] += self.team.cable_length
        wanted, orders = self.legs.q_legs(s, slack), np.moveaxis(slack, -1, 0)
        q_legs = self.team.layout.q_legs_of(np.moveaxis(wanted, -1, 0), orders)
        return FlatJets(vertices, np.moveaxis(q_legs, 0, -1), tensions, roll)


def roll_between(
    start: Hitch, end: Hitch, grown: tuple[float, ...] = (0.0, 1.0)
) -> PiecewisePolynomial | None:
    """Return the roll of shape (clasps,) that goes from one hitch's to the other's, over s.

    None where neither of them is rolled.

    Parameters
    ----------
    grown: Bernstein coefficients of the share of the change that is made.
    """
    if not np.any(start.roll) and not np.any(end.roll):
        return None
    change = (end.roll - start.roll)[:, None] * np.asarray(grown)
    return PiecewisePolynomial(np.array([0.0, 1.0]), (start.roll[:, None] + change)[None])


def cable_along(team: Team, chords: Array, tensions: Array) -> Array:
    """Return the jets (J, k, m) [m] of the lengths of cable along chords (J, k, 3, m) [m].

    By ``hitch.forces.cable_of``, for tensions (J, k, m) [N].
    """
    squares = jets.product(chords, chords)
    lengths = jets.square_root(np.sum(squares, axis=2))
    if team.cable_density == 0.0:
        return lengths
    factors = sag_factors(team, 1.0) * jets.reciprocal(jets.product(tensions, tensions))
    level = np.sum(squares[:, :, :2], axis=2)
    return lengths + jets.product(factors, jets.product(lengths, level))


@dataclass(frozen=True, eq=False)
class Shapes:
    """Shapes at J points of a path.

    Attributes
    ----------
    polygons: (J, points, 2) [m], in plan view.
    legs: (J, n, 2) [m], ``d`` and ``e``: lengths of cable, negative where a cable is too short,
        zero where a chain's end has no leg.
    roll: (J, clasps) [rad], or None where legs are not rolled.
    """

    polygons: Array
    legs: Array
    roll: Array | None = None

    def chosen(self, which: NDArray[np.bool_]) -> Shapes:
        """Return the shapes where ``which`` (J,) holds."""
        roll = None if self.roll is None else self.roll[which]
        return Shapes(self.polygons[which], self.legs[which], roll)


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
    """Centroid on a straight line, the hitch turning about it; both linear in s.

    Parameters
    ----------
    start: the hitch at s = 0.
    to: (3,) [m], where its centroid is at s = 1.
    yaw: by how much it turns until then, counter-clockwise [rad]; more than a turn is one.
    """

    start: Hitch
    to: Array
    yaw: float

    @property
    def team(self) -> Team:
        """The team whose cables form the hitch."""
        return self.start.team

    @property
    def centroid(self) -> Array:
        """(3,) [m]: where the centroid is at s = 0."""
        return np.append(self.start.polygon.centroid, self.start.altitude)

    @property
    def still(self) -> bool:
        """Whether nothing moves."""
        return self.yaw == 0.0 and bool(np.max(np.abs(self.to - self.centroid)) < 1e-9)

    def flat(self, s: Array, count: int = JET) -> FlatJets:
        """Return the flat outputs' jets by s at s (J,), of ``count`` numbers each."""
        hitch = self.start
        arms = (hitch.vertices[:, :2] - self.centroid[:2]) @ [1.0, 1.0j]
        turned = np.exp(1.0j * self.yaw * s)[:, None] * arms
        turned = turned[..., None] * (1.0j * self.yaw) ** np.arange(count)
        vertices = np.zeros((len(s), len(arms), 3, count))
        vertices[:, :, 0], vertices[:, :, 1] = turned.real, turned.imag
        offset = self.to - self.centroid
        vertices[..., 0] += (self.centroid + s[:, None] * offset)[:, None]
        vertices[..., 1:2] += offset[:, None]
        constant = hitch.q_legs, hitch.team.tension, hitch.roll
        q_legs, tensions, roll = (_steady(values, len(s), count) for values in constant)
        return FlatJets(vertices, q_legs, tensions, roll if np.any(hitch.roll) else None)


def _steady(values: Array, points: int, count: int) -> Array:
    """Return the jets (points, k, count) of what keeps its values (k,)."""
    constant = np.zeros((points, len(values), count))
    constant[..., 0] = values
    return constant
