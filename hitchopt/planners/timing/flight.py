"""Flights along paths: piecewise polynomials of time, from rest to rest within all limits.

toppra's profile, smoothed, is sped up by the clock until limits bind at samples; polynomials that
meet the path's jets at every break are then slowed until their limits hold between samples too.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import InfeasibleError, Violation
from hitchopt.geometry.vectors import dot, length
from hitchopt.hitch import GRAVITY, Team
from hitchopt.hitch.forces import (
    cable_force_rates,
    cable_forces,
    cable_of,
    sag_factors,
    taut_forces,
)
from hitchopt.hitch.requirements import Limits
from hitchopt.planners.morph.jets import chained, polynomials_through
from hitchopt.planners.morph.path import Path, path_jets
from hitchopt.planners.timing.clock import Clock, first_clock, jerk_limited
from hitchopt.planners.timing.demands import FINAL_SHARE, LIMIT_SHARE, Demands, loads_at_rest
from hitchopt.planners.timing.profile import (
    SpeedProfile,
    acceleration_ramp,
    fastest_profile,
    path_grid,
)
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.values import Array, Indices

MOVES = 1e-9
"""[m] Distance from its first place within which a drone or vertex counts as at rest."""


@dataclass(frozen=True, eq=False)
class Flight:
    """The curves of a formed hitch on common breaks, from rest to rest.

    Attributes
    ----------
    drones, vertices, legs, tensions: as in a Motion, from t = 0.
    """

    drones: PiecewisePolynomial
    vertices: PiecewisePolynomial
    legs: PiecewisePolynomial
    tensions: PiecewisePolynomial

    @property
    def duration(self) -> float:
        """Duration from rest to rest [s]."""
        return self.drones.duration

    @property
    def pulls(self) -> PiecewisePolynomial:
        """Pulls of the legs (2n,) [N]: every leg pulls with its cable's tension."""
        both = np.repeat(self.tensions.coefficients, 2, axis=1)
        return PiecewisePolynomial(self.tensions.breaks, both)

    def lasting(self, duration: float) -> Flight:
        """Return the same curves flown in exactly ``duration`` [s]."""
        breaks = duration / self.duration * self.drones.breaks
        breaks[-1] = duration
        parts = (self.drones, self.vertices, self.legs, self.tensions)
        return Flight(*(PiecewisePolynomial(breaks, part.coefficients) for part in parts))


def check_duration(duration: float, fastest: float, when: str = "") -> None:
    """Raise InfeasibleError where a wanted duration is shorter than the fastest one [s]."""
    if duration < fastest:
        remedy = f"give it {fastest:.6g} s or more, or raise the limits of motion"
        raise InfeasibleError(
            [Violation("duration", duration, fastest, "min", "s", (), when, remedy)]
        )


def moving(drones: PiecewisePolynomial) -> NDArray[np.bool_]:
    """Return which drones (2n,) leave their first place, by the hull of their polynomials.

    Parameters
    ----------
    drones: of shape (2n, 3) [m].
    """
    c = drones.coefficients
    away = np.linalg.norm(c - c[0, ..., :1], axis=-2)
    moved: NDArray[np.bool_] = np.max(away, axis=(0, -1)) > MOVES
    return moved


GRID = 160
"""Number of steps of toppra's grid along the path."""

MODEL_ERROR = 1e-6
"""Largest relative error of a cable's length: a tenth of what a plan guarantees."""

PAIRS = 32_000
"""Pairs of a time and a drone at which cables are looked at in one go: arrays fit in the caches."""

FINEST = 400
"""Number of pieces at which refining for the sake of MODEL_ERROR ends."""

SHORTEST_RAMP = 1e-5
"""Shortest ramp of the acceleration, as a share of the duration: polynomials do not resolve ramps
of microseconds in flights of a month."""

SHORTEST_FLIGHT = 0.05
"""[s] Shortest duration chosen: a move of micrometres would be over before its polynomials are
above their rounding."""


GENTLER = 1.005
"""Stretch for the sake of the body rate above which a flight with less jerk is tried as well."""


@lru_cache(maxsize=1)
def timing_demands(path: Path, limits: Limits) -> Demands:
    """Return the demands of a path on toppra's grid; those of the last path are stored."""
    return Demands.along(path, limits, path_grid(GRID))


def fly(path: Path, limits: Limits, duration: float | None = None) -> Flight:
    """Return the flight along a path, from rest to rest.

    Parameters
    ----------
    path: what is flown.
    limits: of which none is broken where the polynomials are sampled.
    duration: exact duration [s]; None for as fast as the limits allow, SHORTEST_FLIGHT at least.

    Raises
    ------
    InfeasibleError: ``duration`` is shorter than the limits allow.
    TimingError, WarpError: no timing was found.
    """
    flight, slower = _timed(path, limits, limits)
    if limits.body_rate is not None and GENTLER < slower < math.inf:
        # Thrusts turn with the jerk: with less of it, speed and acceleration need not suffer.
        gentle = _timed(path, replace(limits, jerk=limits.jerk / slower**3), limits)
        flight, slower = min(
            (flight, slower), gentle, key=lambda timed: timed[0].duration * timed[1]
        )
    fastest = slower * flight.duration
    if duration is None:
        return flight.lasting(max(fastest, SHORTEST_FLIGHT))
    check_duration(duration, fastest)
    return flight.lasting(duration)


def _timed(path: Path, aimed: Limits, limits: Limits) -> tuple[Flight, float]:
    """Return a flight timed for limits ``aimed`` at, and how much slower it keeps ``limits``."""
    demands = timing_demands(path, aimed)
    profile = fastest_profile(path_grid(GRID), demands)
    ramp = max(acceleration_ramp(profile, demands), SHORTEST_RAMP * profile.duration)
    finer = 1
    while True:
        clock = first_clock(profile, ramp, time_mesh(profile, ramp, finer))
        flight = _polynomials(path, jerk_limited(clock, lambda s: Demands.along(path, aimed, s)))
        if flight.drones.pieces >= FINEST or _cable_error(path.team, flight) <= MODEL_ERROR:
            break
        finer *= 2
    curves = (flight.drones, flight.vertices, flight.pulls)
    return flight, needed_stretch(path.team, limits, *curves)


def _polynomials(path: Path, clock: Clock) -> Flight:
    """Return polynomials that meet value, velocity, acceleration and jerk at every break."""
    breaks, progress = clock.breaks, clock.jets()
    s = np.clip(progress[:, 0], 0.0, 1.0)
    s[0], s[-1] = 0.0, 1.0
    *parts, tensions = path_jets(path, s)

    def timed(jets: Array) -> PiecewisePolynomial:
        """Return the polynomials for jets by s (J, *shape, 4)."""
        inner = progress.reshape(len(s), *(1,) * (jets.ndim - 2), 4)
        return polynomials_through(breaks, chained(jets, inner))

    steady = not np.any(tensions[..., 1:]) and np.all(tensions == tensions[0])
    constant = PiecewisePolynomial.constant(breaks, tensions[0, :, 0])
    drones, vertices, legs = map(timed, parts)
    return Flight(drones, vertices, legs, constant if steady else timed(tensions))


def _cable_error(team: Team, flight: Flight) -> float:
    """Return the largest relative error of a cable's length at samples between the breaks."""
    inner, breaks = (np.arange(5) + 0.5) / 5, flight.drones.breaks
    times = np.append(breaks[:-1, None] + np.diff(breaks)[:, None] * inner, breaks)
    error, many = 0.0, max(1, PAIRS // team.drones)
    for first in range(0, len(times), many):
        t = times[first : first + many]
        p, sag = flight.vertices.at(t), sag_factors(team, flight.tensions.at(t))
        legs = flight.drones.at(t) - p[:, team.layout.anchors]
        spans = (legs[:, 0::2], team.layout.edges(p), legs[:, 1::2])
        cables = np.sum([cable_of(span, sag) for span in spans], axis=0)
        error = max(error, float(np.max(np.abs(cables / team.cable_length - 1.0))))
    return error


WIDEST = 1.0 / 12.0
"""Longest piece, as a share of the whole time."""

PER_RAMP = 6.0
"""Number of pieces in a change of the acceleration from one limit to the other."""

SHORTEST = 5e-3
"""[s] Shortest piece: shorter ones lose more digits in third derivatives than they gain speed."""

MOST = 200
"""Approximate number of pieces of the first mesh; where more would be needed, all are wider."""

GRADING = 0.4
"""Largest growth of pieces' lengths with their distance from one another."""

SAME = 1e-9
"""Share of the whole time: places closer than this are one, which rounding alone tells apart."""

ACTIVE = 0.1
"""Share of the largest change of acceleration below which a time counts as quiet."""


def time_mesh(profile: SpeedProfile, ramp: float, finer: int = 1) -> Array:
    """Return the knots (K + 1,) [s] for a profile smoothed over ``ramp`` [s].

    Parameters
    ----------
    profile: toppra's optimum.
    ramp: width of the moving average; the knots run from 0 to the profile's duration and this.
    finer: every piece is divided by about as much.
    """
    whole = profile.duration + ramp
    # Wherever the smoothed profile's acceleration may begin or end to change, and in between.
    places = np.concatenate([profile.times, profile.times + 0.5 * ramp, profile.times + ramp])
    t = np.unique(np.clip(np.append(places, np.linspace(0.0, whole, 801)), 0.0, whole))
    t = t[np.append(True, np.diff(t) > SAME * whole)]
    # The acceleration jumps at t: it is evaluated in between, where no rounding changes it.
    middle = 0.5 * (t[1:] + t[:-1])
    change = np.abs(profile.acceleration(middle) - profile.acceleration(middle - ramp))
    busy = np.append(change > ACTIVE * np.max(change), False)
    busy[1:] |= busy[:-1]
    fine = max(ramp / PER_RAMP, SHORTEST)
    widths = np.where(busy, np.minimum(fine, WIDEST * whole), WIDEST * whole)
    widths = np.maximum(_graded(t, widths), SHORTEST)
    density = 0.5 * (1.0 / widths[1:] + 1.0 / widths[:-1]) * np.diff(t)
    pieces = np.append(0.0, np.cumsum(density))
    count = finer * max(int(np.ceil(min(pieces[-1], MOST))), 4)
    knots: Array = np.interp(np.linspace(0.0, pieces[-1], count + 1), pieces, t)
    knots[0], knots[-1] = 0.0, whole
    return knots


def _graded(t: Array, widths: Array) -> Array:
    """Return the widths lowered until none exceeds another by more than GRADING of its distance."""
    # min over u of w(u) + g |t - u|, from the left and from the right.
    left = np.minimum.accumulate(widths - GRADING * t) + GRADING * t
    right = np.minimum.accumulate((widths + GRADING * t)[::-1])[::-1] - GRADING * t
    return np.minimum(left, right)


SPANS = 8
"""Number of spans of a piece on which its rates are enclosed: within about 0.1 %."""

ENCLOSING = 8
"""Number of coefficients on a span: those of the drones' septic pieces."""

CHUNK = 20_000
"""Number of coefficients of drones that are processed in one go."""

FIRST = 64
"""Number of pieces that are looked at closely at a time, those of the largest bounds first."""

LOOSE = 1.001
"""Factor on what whole pieces need of a flight: on their spans it is no more."""


def needed_stretch(
    team: Team,
    limits: Limits,
    drones: PiecewisePolynomial,
    vertices: PiecewisePolynomial,
    pulls: PiecewisePolynomial,
) -> float:
    """Return how many times slower a flight must be to satisfy its limits.

    Rates are not sampled but enclosed: a vector polynomial stays within the hull of its
    coefficients, which lie close to it on a short span of time.

    Parameters
    ----------
    drones, vertices: of shapes (2n, 3) and (n, 3) [m], on common breaks.
    pulls: of shape (2n,) [N], of the cables on the drones.
    """

    def of_vertices(piece: Indices, vertex: Indices, spans: int) -> Array:
        """Return the factors (k,) that some vertices need on some pieces."""
        rates = length(_rates(vertices, piece, vertex, 1, spans))
        slower: Array = np.max(rates, axis=0) / (FINAL_SHARE * limits.vertex_speed)
        return slower

    def of_drones(piece: Indices, drone: Indices, spans: int) -> Array:
        """Return the factors (k,) that some drones need on some pieces."""
        inner = np.linspace(0.0, 1.0, spans * ENCLOSING)
        ends = team.layout.pulled_to[drone]
        x, p, pull = (
            np.moveaxis(
                part.coefficients[piece, item] @ bernstein.basis(inner, part.degree).T, -1, 0
            )
            for part, item in ((drones, drone), (vertices, ends), (pulls, drone))
        )
        mass = team.mass[drone]
        loads = np.broadcast_to(mass[:, None] * np.array([0.0, 0.0, GRAVITY]), x.shape)
        if team.has_cables:
            loads = loads - taut_forces(x - p, pull, 0.5 * GRAVITY * team.cable_density)
        jets = [x, *(_rates(drones, piece, drone, order, spans) for order in (1, 2, 3))]
        still, most = np.zeros(len(inner)), team.max_thrust[drone]
        jet = np.stack(jets, axis=-1)
        return Demands(jet, still, loads, mass, most, limits, FINAL_SHARE).stretches()

    factor = _largest(vertices.coefficients.shape[:2], of_vertices, 1e-12)
    factor = _largest(drones.coefficients.shape[:2], of_drones, factor)
    taut = PiecewisePolynomial.constant(drones.breaks, np.ones(team.robots))
    return turning_stretch(team, limits.body_rate, (drones, vertices, pulls, taut), factor)


def _largest(
    shape: tuple[int, ...], needed: Callable[[Indices, Indices, int], Array], known: float
) -> float:
    """Return the largest factor, ``known`` at least, of all items on pieces: (pieces, items).

    Those are looked at closely that may decide by what they need on whole pieces.

    Parameters
    ----------
    needed: returns the factors (k,) of pieces (k,) of items (k,) by a number of spans.
    """

    def factors(some: Indices, spans: int) -> Array:
        size = max(1, CHUNK // (spans * ENCLOSING))
        parts = [some[first : first + size] for first in range(0, len(some), size)]
        return np.concatenate([needed(*np.divmod(part, shape[1]), spans) for part in parts])

    bounds = LOOSE * factors(np.arange(math.prod(shape)), 1)
    left = np.argsort(-bounds)
    while len(left := left[bounds[left] > known]):
        known, left = max(known, float(np.max(factors(left[:FIRST], SPANS)))), left[FIRST:]
    return known


def _rates(
    part: PiecewisePolynomial, piece: Indices, item: Indices, order: int, spans: int
) -> Array:
    """Return the coefficients (spans · ENCLOSING, k, 3) of a derivative by time of some items.

    On each of the spans of their pieces in turn.
    """
    c = part.coefficients[piece, item]
    for _ in range(order):
        c = bernstein.differentiate(c)
    c = c / part.durations[piece, None, None] ** order
    return np.moveaxis(c @ _on_spans(bernstein.degree(c), spans).T, -1, 0)


@lru_cache
def _on_spans(order: int, spans: int) -> Array:
    """(spans · ENCLOSING, order + 1): maps coefficients on a piece to those on its spans."""
    same = bernstein.elevate(np.eye(order + 1), ENCLOSING - 1)[:, None]
    starts = np.arange(spans) / spans
    rows: Array = bernstein.restrict(same, starts, starts + 1.0 / spans)
    rows = rows.reshape(order + 1, -1).T
    rows.setflags(write=False)
    return rows


SAMPLES = 33
"""Number of samples of a piece, ends included: a rate errs by 1e-3 of its change on the piece."""

TURNING_CHUNK = 60_000
"""Number of samples of drones that are processed in one go."""

SLOWEST = 1e6
"""Largest stretch that is tried."""

PRECISION = 1e-4
"""Relative precision of a stretch."""


def turning_stretch(
    team: Team, limit: float | None, curves: Sequence[PiecewisePolynomial], least: float = 1.0
) -> float:
    """Return how many times slower, at least ``least``, a flight must be to keep its body rates.

    Slowed by κ, a thrust ``m a + l`` (l holds weight and cable) becomes ``m a / κ² + l`` and its
    derivative ``m j / κ³ + l̇ / κ``: the rate at which it turns falls with κ³ at most. Infinite
    where no stretch was found.

    Parameters
    ----------
    limit: of the body rate [rad/s]; None for no limit.
    curves: drones (2n, 3) [m], vertices (points, 3) [m], pulls (2n,) [N] and tautness (n,), as
        ``cable_forces`` takes them, on common breaks; of single drones the first one.
    """
    if limit is None:
        return least
    size, factor = max(1, TURNING_CHUNK // (SAMPLES * team.drones)), least
    chunks = [slice(first, first + size) for first in range(0, curves[0].pieces, size)]
    while math.isfinite(factor):
        fastest = max(_turning_rate(team, curves, chunk, factor) for chunk in chunks)
        if fastest <= LIMIT_SHARE * limit:
            break
        slower = (1.0 + PRECISION) * (fastest / (LIMIT_SHARE * limit)) ** (1.0 / 3.0)
        factor = factor * slower if factor < SLOWEST else math.inf
    return factor


def _turning_rate(
    team: Team, curves: Sequence[PiecewisePolynomial], pieces: slice, stretch: float
) -> float:
    """Return the largest turning rate [rad/s] of thrusts on pieces of a flight, slowed."""
    values, rates, second, third = (
        [_sampled(part, pieces, order) for part in curves[: 1 if order > 1 else None]]
        for order in range(4)
    )
    pull = pulled = np.zeros_like(values[0])
    if team.has_cables:
        pull, pulled = (
            cable_forces(team, *values),
            cable_force_rates(team, tuple(values), tuple(rates)),
        )
    mass = team.mass[:, None]
    thrust = mass * second[0] / stretch**2 + loads_at_rest(team, pull)
    rate = mass * third[0] / stretch**3 - pulled / stretch
    squared = dot(thrust, thrust)
    if not np.all(squared > 0.0):
        return math.inf
    return float(np.max(length(np.cross(thrust, rate)) / squared))


def _sampled(part: PiecewisePolynomial, pieces: slice, order: int) -> Array:
    """Return a derivative by time at SAMPLES places on each of the pieces, (…, *shape)."""
    c = part.coefficients[pieces]
    rows = bernstein.derivative_basis(np.linspace(0.0, 1.0, SAMPLES), bernstein.degree(c), order)
    found = np.moveaxis(c @ rows.T, -1, 1)
    h = part.durations[pieces].reshape(-1, *(1,) * (found.ndim - 1))
    values: Array = (found / h**order).reshape(-1, *part.shape)
    return values
