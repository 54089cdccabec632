"""Geometric paths of a hitch: flat outputs over a parameter s from 0 to 1, without timing."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hitchopt.errors import InputError, OneLine
from hitchopt.hitch import GRAVITY, Hitch, Team
from hitchopt.hitch.forces import cable_slack_of
from hitchopt.hitch.model import DroneJets, FlatJets, cable_between, drone_jets
from hitchopt.hitch.series import JET, Series, product
from hitchopt.planners.sampling import FunctionOrKnots, sampled
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.trajectory.piecewise import summed
from hitchopt.values import Array, as_array, bounded_points, check_instance, coordinate, positive

if TYPE_CHECKING:
    from matplotlib.axes import Axes


class FlatPath(Protocol):
    """A path that can be timed; hashed and compared by identity."""

    def __hash__(self) -> int: ...

    @property
    def team(self) -> Team:
        """The team of the hitch."""

    def flat(self, s: Array, count: int = JET) -> FlatJets:
        """Return the flat outputs' jets in s, with ``count`` coefficients, at s (J,)."""


def drones_along(path: FlatPath, s: Array) -> DroneJets:
    """Return the drones' jets in s at s (J,)."""
    return drone_jets(path.team, path.flat(s))


class PathJets(NamedTuple):
    """Jets in s of the curves of a motion, at J points of a path."""

    drones: Array  # (J, 2n, 3, 4) [m]: positions of drones
    vertices: Array  # (J, points, 3, 4) [m]
    # (J, n, 2, 4) [m]: ``d`` and ``e`` as cable lengths; exactly zero at a chain's ends
    legs: Array
    tensions: Array  # (J, n, 4) [N]


def path_jets(path: FlatPath, s: Array) -> PathJets:
    """Return the jets in s of a path's curves at s (J,)."""
    flat = path.flat(s)
    drones = drone_jets(path.team, flat)
    legs = drones.legs * path.team.layout.has_leg[..., None]
    return PathJets(drones.positions, flat.vertices, legs, flat.tensions)


@dataclass(frozen=True, eq=False)
class LegLaw:
    """Law of the q-legs in the slack of their cables: ``d = length + share · slack``.

    A constant share keeps fractions, share 0 keeps ``d``, and share 1 with length ``-e`` keeps
    ``e``.
    """

    length: PiecewisePolynomial  # (n,) [m]: the constant terms, over s
    share: PiecewisePolynomial  # (n,): the factors of the slack, over s

    @classmethod
    def of_fractions(cls, fractions: PiecewisePolynomial) -> LegLaw:
        """Return the law with prescribed fractions ``d_k / (d_k + e_k)``, (n,) over s."""
        no_length = PiecewisePolynomial.constant([0.0, 1.0], np.zeros(fractions.shape))
        return cls(no_length, fractions)

    @classmethod
    def of_lengths(cls, lengths: PiecewisePolynomial) -> LegLaw:
        """Return the law with prescribed q-legs ``d_k`` [m], (n,) over s."""
        no_share = PiecewisePolynomial.constant([0.0, 1.0], np.zeros(lengths.shape))
        return cls(lengths, no_share)

    def q_legs(self, s: Array, slack: Array) -> Array:
        """Return the jets (J, n, m) of ``d`` from those of the slack."""
        count = slack.shape[-1]
        part_of_slack = product(self.share.jet(s, count), slack)
        if not np.any(self.length.coefficients):
            return part_of_slack
        return self.length.jet(s, count) + part_of_slack


@dataclass(frozen=True, eq=False)
class Path(OneLine):
    """The shapes of a hitch over a parameter s from 0 to 1: polynomials without timing.

    ``ho.route`` searches one, ``Path.of`` makes one by hand, and ``ho.time`` times both.

    Parameters
    ----------
    team: the robots.
    vertices: shape (points, 3) over s [m].
    legs: law of the q-legs d_k, except at the ends of a chain.
    tensions: shape (n,) over s [N]; None for the team's.
    roll: shape (clasps,) over s [rad]; None if there is none.
    duration: if s is time, that of the path [s]; None if the path has no timing.
    """

    team: Team
    vertices: PiecewisePolynomial
    legs: LegLaw
    tensions: PiecewisePolynomial | None = None
    roll: PiecewisePolynomial | None = None
    duration: float | None = None

    @classmethod
    def of(
        cls,
        team: Team,
        vertices: FunctionOrKnots,
        legs: FunctionOrKnots | None = None,
        roll: FunctionOrKnots | None = None,
        altitude: float = 1.0,
        duration: float | None = None,
    ) -> Path:
        """Return a custom path.

        A function of s is replaced by a quintic spline through 65 to 513 evenly spaced samples. The
        spline is within 0.1 mm of the function at 2048 other values of s, which are irrational and
        at most 0.001 apart; what the function does between them is not seen. Knots are joined by a
        natural quintic spline, which passes through them and minimises the third derivative. The
        spline is the path. Shapes are checked by ``ho.time``, limits by ``ho.certify``.

        With a ``duration``, s is time: ``ho.time`` keeps this timing, and splines rest at both
        ends, where their first two derivatives vanish.

        Parameters
        ----------
        team: the robots.
        vertices: a function of s from 0 to 1 that returns [x, y] or [x, y, z] [m] of all points; or
            knots (J, points, 2 or 3) [m] at evenly spaced s, three or more.
        legs: q-legs d_k [m], a function of s that returns (n,), or knots (J, n); by default each
            cable's slack is split evenly.
        roll: roll of the legs at each clasp [rad], a function that returns (clasps,), or knots.
        altitude: height of vertices [x, y] [m].
        duration: time from s = 0 to 1 [s]; by default the path has no timing.

        Raises
        ------
        InputError: values of another shape, or that are masked, complex or not finite; or a
            function that jumps or turns too often for 513 samples, or with a duration is not at
            rest at its ends.
        """
        check_instance("team", team, Team)
        points = team.layout.points
        height = coordinate("altitude", altitude)
        seconds = None if duration is None else positive("duration", duration)
        is_timed = seconds is not None
        samples = sampled("vertices", vertices, ((points, 2), (points, 3)), at_rest=is_timed)
        positions = bounded_points("vertices", samples.values)
        if positions.shape[-1] == 2:
            heights = np.full((*positions.shape[:2], 1), height)
            positions = np.concatenate([positions, heights], axis=-1)
        spline = replace(samples, values=positions).spline
        if legs is None:
            halves = PiecewisePolynomial.constant([0.0, 1.0], np.full(team.robots, 0.5))
            law = LegLaw.of_fractions(halves)
        else:
            lengths = sampled("legs", legs, ((team.robots,),), at_rest=is_timed)
            law = LegLaw.of_lengths(lengths.spline)
        roll_spline = None
        if roll is not None:
            angles = sampled("roll", roll, ((len(team.layout.clasps),),), at_rest=is_timed)
            roll_spline = angles.spline
        return cls(team, spline, law, roll=roll_spline, duration=seconds)

    def _parts(self) -> Iterator[str]:
        yield f"{self.team.drones} drones"
        yield f"pieces: {self.vertices.pieces}"

    def shapes(self, s: ArrayLike) -> Shapes:
        """Return the shapes at s (J,) from 0 to 1.

        They have ``polygons`` (J, points, 2) [m], ``legs`` (J, n, 2) [m], d_k and e_k, and ``roll``
        (J, clasps) [rad], None if there is none.
        """
        return shapes_along(self, _checked_s(s))

    def drones(self, s: ArrayLike) -> Array:
        """Return the positions (J, 2n, 3) [m] of drones at s (J,), in the order q0, r0, q1, …."""
        positions: Array = drones_along(self, _checked_s(s)).positions[..., 0]
        return positions

    def plot(self, axes: Axes | None = None) -> Axes:
        """Draw outlines from above, darker from first to last, and the curves of the drones.

        Without ``axes``, a new pyplot figure is created.
        """
        from matplotlib import pyplot

        if axes is None:
            axes = pyplot.subplots(figsize=(6.5, 6.5), layout="constrained")[1]
        drones = self.drones(np.linspace(0.0, 1.0, 201))
        for k in range(self.team.drones):
            axes.plot(drones[:, k, 0], drones[:, k, 1], color="0.75", linewidth=0.8)
        for s in np.linspace(0.0, 1.0, 7):
            outline = self.vertices.at(float(s))
            if self.team.layout.closed:
                outline = np.vstack([outline, outline[:1]])
            grey = 0.7 * (1.0 - float(s))
            axes.plot(outline[:, 0], outline[:, 1], "o-", color=str(grey), markersize=3.0)
        axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
        return axes

    @classmethod
    def straight(cls, start: Hitch, end: Hitch) -> Path:
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

    def climbing(self, by: float) -> Path:
        """Return the path with a climb of the hitch's plane [m], linear in s."""
        climb = np.array([[0.0, 0.0], [0.0, 0.0], [0.0, by]])
        return self.translated(PiecewisePolynomial(np.array([0.0, 1.0]), climb[None]))

    def translated(self, by: PiecewisePolynomial) -> Path:
        """Return the path with the whole hitch translated by (3,) over s [m]."""
        return replace(self, vertices=summed(self.vertices, by.reshaped(1, 3)))

    def flat(self, s: Array, count: int = JET) -> FlatJets:
        """Return the flat outputs' jets in s, with ``count`` coefficients, at s (J,)."""
        return self.flat_of(self.vertices.jet(s, count), s)

    def flat_of(self, vertices: Array, s: Array) -> FlatJets:
        """Return the flat outputs at s (J,) for other vertices with jets (J, points, 3, m)."""
        count = vertices.shape[-1]
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
    with np.errstate(all="ignore"):  # chords of zero length are left out below
        chord = Series.of_jet(chords)
        tension = Series.of_jet(tensions[..., None, :])
        cable_jets = cable_between(chord, tension, weight).jet[..., 0, :]
    has_chord = chords[..., 0].any(axis=-1, keepdims=True)  # false for legs at a chain's ends
    return np.where(has_chord, cable_jets, 0.0)


def _checked_s(s: ArrayLike) -> Array:
    """Return parameters (J,) of a path, or raise InputError."""
    values = as_array("s", s)
    if values.ndim != 1 or not len(values) or not np.all((values >= 0.0) & (values <= 1.0)):
        raise InputError("s", s, "a list of numbers from 0 to 1", "0 is the start, 1 the end")
    return values


@dataclass(frozen=True, eq=False)
class Shapes:
    """Shapes at J points of a path."""

    polygons: Array  # (J, points, 2) [m]: vertices in plan view
    legs: Array
    """(J, n, 2) [m]: ``d`` and ``e`` as cable lengths.

    They are negative if a cable is too short, and zero at a chain's ends."""

    roll: Array | None = None  # (J, clasps) [rad], or None

    def __getitem__(self, mask: NDArray[np.bool_]) -> Shapes:
        roll = None if self.roll is None else self.roll[mask]
        return Shapes(self.polygons[mask], self.legs[mask], roll)


def shapes_along(path: FlatPath, s: Array) -> Shapes:
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
    """A path with a straight centroid and a rotation about it, both linear in s, and a detour.

    Parameters
    ----------
    start: the hitch at s = 0.
    to: (3,) [m], its centroid at s = 1.
    yaw: counter-clockwise rotation [rad], of any number of turns.
    detour: translation (3,) over s [m], zero at both ends; None without one.
    """

    start: Hitch
    to: Array
    yaw: float
    detour: PiecewisePolynomial | None = None

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
        """Return whether start and end are equal."""
        return self.yaw == 0.0 and bool(np.max(np.abs(self.to - self.centroid)) < 1e-9)

    def translated(self, by: PiecewisePolynomial) -> RigidPath:
        """Return the path with a detour (3,) over s [m]."""
        return replace(self, detour=by if self.detour is None else summed(self.detour, by))

    def flat(self, s: Array, count: int = JET) -> FlatJets:
        """Return the flat outputs' jets in s, with ``count`` coefficients, at s (J,)."""
        hitch = self.start
        # Rotations of the plane are products of complex numbers x + iy
        arms = (hitch.vertices[:, :2] - self.centroid[:2]) @ [1.0, 1.0j]
        rotated = np.exp(1.0j * self.yaw * s)[:, None] * arms
        rotated_jets = rotated[..., None] * (1.0j * self.yaw) ** np.arange(count)
        vertices = np.zeros((len(s), len(arms), 3, count))
        vertices[:, :, 0] = rotated_jets.real
        vertices[:, :, 1] = rotated_jets.imag
        offset = self.to - self.centroid
        vertices[..., 0] += (self.centroid + s[:, None] * offset)[:, None]
        vertices[..., 1:2] += offset[:, None]  # there is none for a single coefficient
        if self.detour is not None:
            vertices += self.detour.jet(s, count)[:, None]
        roll = _constant_jets(hitch.roll, len(s), count) if np.any(hitch.roll) else None
        return FlatJets(
            vertices,
            _constant_jets(hitch.q_legs, len(s), count),
            _constant_jets(hitch.team.tension, len(s), count),
            roll,
        )


def _constant_jets(values: Array, points: int, count: int) -> Array:
    """Return the jets (points, k, count) of constants (k,)."""
    constants = np.zeros((points, len(values), count))
    constants[..., 0] = values
    return constants


def cables_of_legs(team: Team, chords: Array, lengths: Array, tensions: Array) -> Array | None:
    """Return jets (J, n, 2, 4) of legs' cable lengths [m]; None for massless cables.

    Legs have chords (J, 2n, 3, 4) [m] and the chords' lengths (J, n, 2, 4) [m].
    """
    if team.cable_density == 0.0:
        return None
    return cable_along(team, chords, np.repeat(tensions, 2, axis=1)).reshape(lengths.shape)
