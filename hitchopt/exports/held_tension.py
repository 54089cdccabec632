"""Set points that hold the cables' tension where receivers do not feed it forward.

A controller of stiffness k and damping c that knows of its set point s no more than position,
velocity and acceleration moves a drone of mass m under the cable force F by

    m ẍ = m s̈ + c (ṡ - ẋ) + k (s - x) + F.

The drone is where the plan says if ``δ = s - x`` solves ``δ + (c/k) δ' + (m/k) δ'' = -F/k``; at
rest the set point is moved outward by T/k. The equation is solved forward from rest by collocation:
piece by piece a polynomial that fulfils it at Lobatto's points, ends included, so that the second
derivative is as continuous as F. What it misses between these points moves the drone by at most the
response's gain times the miss, which is measured and reported. The plan lasts a little longer so
that set points end at rest, too.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hitchopt.checks.bounds.rates import largest_rate
from hitchopt.errors import InfeasibleError, InputError, UnsupportedError, Violation
from hitchopt.exports.recording import lasted
from hitchopt.hitch import Team
from hitchopt.motion.motion import Motion
from hitchopt.motion.states import states_at
from hitchopt.requirements import Requirements
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.trajectory.splitting import on_breaks
from hitchopt.values import Array, positive

DAMPING_RATIO = 5.0 / 6.0
"""c/(2 √(k m)) unless it is given: gains of 36 and 10 per mass, as soft loops of hitches use."""

DEGREE = 8
"""Degree of the offset's pieces."""

LONGEST = 1.5
"""Longest piece over √(m/k), the time in which a drone swings by one radian."""

HALVINGS = 3
"""Number of times that the pieces are halved while the drones miss the plan by too much."""

LARGEST_MISS = 1e-4
"""[m] Largest distance of drones from the plan that a solution of the equation may leave."""

PROBES = 3
"""Points between two of Lobatto's at which the equation is checked."""

REST = 2.0
"""[s] Time by which the plan is prolonged; what is left of the offset's motion is then
``exp(-REST c/2m)``, 5e-5 at c/m = 10/s, and nothing that receivers could resolve."""

SPARE = 0.2
"""Share by which limits of speed and acceleration exceed the set points': whole millimetres cost
some cm/s where pieces are short."""


@dataclass(frozen=True, eq=False)
class PositionLoop:
    """Controllers of the drones.

    Attributes
    ----------
    stiffness: (2n,) [N/m]
    damping: (2n,) [N s/m]
    mass: (2n,) [kg]
    """

    stiffness: Array
    damping: Array
    mass: Array

    @classmethod
    def of(cls, team: Team, stiffness: float | None, damping: float | None) -> PositionLoop:
        """Return the team's loops, or those of other gains.

        Raises
        ------
        InputError: a gain that is not positive, or a team whose drones are rigid.
        """
        given = team.stiffness
        if stiffness is not None:
            given = np.full(team.drones, positive("--stiffness", stiffness))
        if not np.all(np.isfinite(given)):
            bound = "the position loop's [N/m], for --hold-tension"
            remedy = "give --stiffness, or team.quadrotor.stiffness in the problem"
            raise InputError("stiffness", None, bound, remedy)
        usual = 2.0 * DAMPING_RATIO * np.sqrt(given * team.mass)
        if damping is not None:
            usual = np.full(team.drones, positive("--damping", damping))
        return cls(given, usual, team.mass)

    @property
    def gain(self) -> float:
        """Largest offset of a drone over the largest miss of the equation, at any time.

        It is the integral of the absolute impulse response, ``coth(πζ/(2√(1-ζ²)))``; 1 where the
        response does not swing.
        """
        ratio = float(np.min(self.damping / (2.0 * np.sqrt(self.stiffness * self.mass))))
        if ratio >= 1.0:
            return 1.0
        return float(1.0 / np.tanh(0.5 * np.pi * ratio / np.sqrt(1.0 - ratio * ratio)))


@dataclass(frozen=True, eq=False)
class HeldTension:
    """A plan's set points that hold its tension.

    Attributes
    ----------
    motion: the plan, prolonged, with the set points in place of the drones.
    loop: the controllers that they are for.
    offset: largest distance of a set point from its drone [m].
    miss: largest distance of a drone from the plan, with these controllers [m].
    """

    motion: Motion
    loop: PositionLoop
    offset: float
    miss: float

    @property
    def note(self) -> str:
        """What users have to know."""
        k, c = self.loop.stiffness, self.loop.damping
        return (
            f"set points are up to {100.0 * self.offset:.3g} cm off the drones' places, for "
            f"position loops of {_span(k)} N/m and {_span(c)} N s/m that feed forward velocity, "
            "acceleration and gravity and no cable force; with these the drones are within "
            f"{max(1e3 * self.miss, 1e-3):.2g} mm of the plan"
        )


def held_tension(motion: Motion, loop: PositionLoop) -> HeldTension:
    """Return the set points with which controllers fly a plan without feed-forward of the pull.

    Raises
    ------
    UnsupportedError: single drones.
    InfeasibleError: forces that change so fast that the equation is not solved well enough.
    """
    if not motion.team.has_cables:
        raise UnsupportedError("--hold-tension: single drones carry no cables that could pull")
    whole = _prolonged(motion)
    step = LONGEST * float(np.min(np.sqrt(loop.mass / loop.stiffness)))
    for _ in range(HALVINGS + 1):
        breaks = _split(whole.drones.breaks, step)
        offsets = _offsets(whole, loop, breaks)
        miss = loop.gain * _miss(whole, loop, offsets)
        if miss <= LARGEST_MISS:
            break
        step *= 0.5
    else:
        remedy = "fly it slower with --stretch"
        broken = Violation("held_tension", miss, LARGEST_MISS, "max", "m", (), "", remedy)
        raise InfeasibleError([broken], "set points that hold the tension are not found")
    split = whole.changed(lambda part: on_breaks(part, breaks), whole.phases)
    degree = max(split.drones.degree, DEGREE)
    places = bernstein.elevate(split.drones.coefficients, degree)
    places = places + bernstein.elevate(offsets.coefficients, degree)
    drones = PiecewisePolynomial(breaks, places)
    parts = dict(vars(split)) | {
        "drones": drones,
        "requirements": _eased(split.requirements, drones),
    }
    largest = float(np.max(np.linalg.norm(offsets.coefficients, axis=-2)))
    return HeldTension(Motion(**parts), loop, largest, miss)


def _eased(requirements: Requirements, drones: PiecewisePolynomial) -> Requirements:
    """Return requirements whose speed and acceleration set points keep: shows state such limits."""
    limits, share = requirements.limits.planned, 1.0 + SPARE
    eased = replace(
        limits,
        speed=max(limits.speed, share * largest_rate(drones, 1).worst),
        acceleration=max(limits.acceleration, share * largest_rate(drones, 2).worst),
    )
    return replace(requirements, limits=eased)


def _prolonged(motion: Motion) -> Motion:
    end = float(motion.drones.breaks[-1]) + REST
    *phases, last = motion.phases
    longer = (*phases, replace(last, end=end))
    return motion.untimed.changed(lambda part: lasted(part, end), longer)


def _split(breaks: Array, step: float) -> Array:
    """Return the breaks with pieces split into equal parts no longer than ``step`` [s]."""
    counts = np.maximum(1, np.ceil(np.diff(breaks) / step).astype(np.intp))
    piece = np.repeat(np.arange(len(counts)), counts)
    part = np.arange(len(piece)) - np.repeat(np.cumsum(counts) - counts, counts)
    found = breaks[piece] + (np.diff(breaks) / counts)[piece] * part
    return np.append(found, breaks[-1])


def _lobatto(count: int) -> Array:
    """Return Lobatto's points (count,) on [0, 1]: the ends, and zeros of a Legendre slope."""
    slope = np.polynomial.legendre.Legendre.basis(count - 1).deriv()
    return np.concatenate([[0.0], 0.5 + 0.5 * np.sort(slope.roots().real), [1.0]])


def _rows(x: Array, loop: PositionLoop, h: float) -> Array:
    """Return (2n, points, DEGREE + 1): the equation's left side at x (points,) of a piece [s]."""
    a = (loop.damping / loop.stiffness)[:, None, None] / h
    b = (loop.mass / loop.stiffness)[:, None, None] / h**2
    order = [bernstein.derivative_basis(x, DEGREE, derivative) for derivative in range(3)]
    rows: Array = order[0] + a * order[1] + b * order[2]
    return rows


def _wanted(motion: Motion, loop: PositionLoop, times: Array) -> Array:
    """Return -F/k (…, 2n, 3) [m] at times (…) [s] from the plan's first break."""
    forces = states_at(motion, times).cable_forces
    wanted: Array = -forces / loop.stiffness[:, None]
    return wanted


def _offsets(motion: Motion, loop: PositionLoop, breaks: Array) -> PiecewisePolynomial:
    """Return the offsets, of shape (2n, 3) [m], that solve the equation at Lobatto's points."""
    x = _lobatto(DEGREE - 1)
    durations = np.diff(breaks)
    times = breaks[:-1, None] + durations[:, None] * x
    times[:, -1] = breaks[1:]  # the very time at which the next piece begins
    wanted = _wanted(motion, loop, times - breaks[0])
    found = np.zeros((len(durations), motion.team.drones, 3, DEGREE + 1))
    value, slope = wanted[0, 0], np.zeros_like(wanted[0, 0])
    for piece, h in enumerate(durations):
        rows = _rows(x, loop, float(h))
        first = np.stack([value, value + h * slope / DEGREE], axis=-1)
        right = np.moveaxis(wanted[piece], 0, 1) - np.einsum("dpi,dci->dpc", rows[..., :2], first)
        others = np.linalg.solve(rows[..., 2:], right)
        found[piece, ..., :2] = first
        found[piece, ..., 2:] = np.moveaxis(others, 1, 2)
        c = found[piece]
        value, slope = c[..., -1], DEGREE / h * (c[..., -1] - c[..., -2])
    return PiecewisePolynomial(breaks, found)


def _miss(motion: Motion, loop: PositionLoop, offsets: PiecewisePolynomial) -> float:
    """Return the largest error of the equation [m] at points between Lobatto's."""
    x = _lobatto(DEGREE - 1)
    inner = np.arange(1, PROBES + 1) / (PROBES + 1)
    probes = (x[:-1, None] + np.diff(x)[:, None] * inner).ravel()
    worst = 0.0
    for piece, h in enumerate(offsets.durations):
        start = offsets.breaks[piece] - offsets.breaks[0]
        wanted = _wanted(motion, loop, start + float(h) * probes)
        left = np.einsum("dpi,dci->pdc", _rows(probes, loop, float(h)), offsets.coefficients[piece])
        worst = max(worst, float(np.max(np.linalg.norm(left - wanted, axis=-1))))
    return worst


def _span(values: Array) -> str:
    low, high = (f"{value:.4g}" for value in (np.min(values), np.max(values)))
    return low if low == high else f"{low} to {high}"
