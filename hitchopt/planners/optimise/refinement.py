"""Refinement of a certified morph: its route and its clock move together.

The clock of a flight is the fastest one for its route, but the route was chosen before it. Here the
unknowns are those of both: splines over s that are added to vertices, q-legs, roll and varying
tensions, and the squared rate x of a clock over that of the flight. Around the current flight

    min Σ w / √x    over all linearised limits of motion, distances, walls, legs and angles,

within a trust region, is a sparse quadratic program; PIQP solves it (``casadi.conic``). Rows have
casadi's exact derivatives of the model of a clasp (``parts``). Limits of motion have rows where
they are nearly reached, and more where a solution breaks them. Every new route gets its own
clock; the shortest flight that the judge certifies is returned, so that nothing is lost.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Generic, NamedTuple, TypeVar

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from hitchopt.errors import check_time
from hitchopt.geometry.vectors import length
from hitchopt.hitch.forces import if_balanced
from hitchopt.hitch.quadratic_program import QuadraticProgram, solve_qp
from hitchopt.hitch.requirements import Requirements
from hitchopt.hitch.series import JET, chained
from hitchopt.motion.motion import Motion
from hitchopt.planners.candidates import Effort
from hitchopt.planners.morph.morph import shape_violation
from hitchopt.planners.optimise.cost import (
    MOTION_JET,
    Expansion,
    FlightCost,
    convex_parts,
)
from hitchopt.planners.optimise.parts import (
    DRONE_LIMITS,
    Columns,
    Group,
    Limit,
    PartFunctions,
    groups_of,
)
from hitchopt.planners.optimise.program import ENTRY_COST
from hitchopt.planners.optimise.shape_rows import (
    DEGREE,
    LocalBasis,
    PathShapes,
    ShapeBlock,
    scattered,
)
from hitchopt.planners.path import LegLaw, Path
from hitchopt.planners.timing.clock import Clock, ClockedPath
from hitchopt.planners.timing.profile import LIMIT_SHARE, Demands, TimingError
from hitchopt.planners.timing.timed_motion import (
    ClockedMotion,
    clocked_limits,
    fastest_motion,
    in_duration,
    motion_by,
    needed_stretch,
    within_limits,
)
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.trajectory.piecewise import merged_breaks, on_breaks, summed
from hitchopt.trajectory.splines import bspline, evenly_interpolated, knots_through
from hitchopt.values import Array, Indices

T = TypeVar("T")


@dataclass(frozen=True)
class Settings:
    """Settings of the refinement, varied on pairs of irregular polygons."""

    pieces: int = 5
    """Number of pieces of the splines that are added to the flat outputs."""

    samples: int = 97
    """Number of s at which distances, legs and angles have rows."""

    nodes: int = 2
    """Number of Gauss nodes in each piece of the clock, at which limits of motion have rows."""

    max_steps: int = 16
    """Maximum number of programs that are linearised anew."""

    max_stalled: int = 3
    """Number of consecutive steps that gain less than ``min_gain`` after which refinement ends."""

    max_rounds: int = 4
    """Maximum number of programs of one step, with more rows each."""

    min_gain: float = 1e-3
    """Gain over the duration, expected or reached, that is too small to go on."""

    stride: float = 0.03
    """[m] First trust radius of the splines' coefficients."""

    min_stride: float = 0.004
    """[m] Trust radius below which refinement ends."""

    max_stride: float = 0.12
    """[m] Largest trust radius."""

    rate_change: float = 0.3
    """Trust radius of x over its current value."""

    margin: float = 1.006
    """Enforced distances over their limits; with 1.003 some flights were not certified."""

    near: float = 0.8
    """Share of a limit above which it has a row at first."""

    near_distance: float = 0.5
    """Distance to its bound, in strides, below which a distance has a row at first."""

    bend_weight: float = 1e-2
    """[s/m²] Weight of second differences of the splines' coefficients."""

    penalty: float = 10.0
    """[s/m] Penalty of distances that are too short, which the next step restores."""

    max_shortfall: float = 5e-4
    """[m] Largest shortfall at samples of a flight that the judge sees."""


SETTINGS = Settings()

RATE_DEGREE = 3
"""Degree of the spline x."""

LEG_SAMPLES = 129
"""Number of even s through which q-legs of a route become a spline, within 1e-8 m."""

BROKEN = 1.02
"""Value over its limit above which a limit of motion gets a row."""

SLACK_UNIT = 0.01
"""[m] Unit of slacks of distances, which scales the program."""

REGULARISATION = 1e-9
"""Added to the Hessian's diagonal."""

REACH_MARGIN = 5e-3
"""[m] Distance beyond twice the stride up to which pairs have rows."""

FLIGHT_COST = 40.0
"""Effort per robot of timing a route, and of one judgement, in the unit of ``Effort``."""

MAX_EFFORT = 1.2e4
"""Limit of the effort: about 3 s."""

Certify = Callable[[Path, Motion], T | None]
"""Function that returns what is certified of a motion along a path, or None."""


class Refined(NamedTuple, Generic[T]):
    """A refined flight."""

    certified: T
    """What the judge made of it."""

    cost: float
    """[s] Its custom cost."""


def refined(
    path: Path,
    motion: Motion,
    tension: tuple[float, float] | None,
    certify: Certify[T],
    effort: Effort,
    settings: Settings = SETTINGS,
    cost: FlightCost | None = None,
) -> Refined[T] | None:
    """Return the shortest certified flight near a flight, or None if none is shorter.

    With a cost, flights are compared by their durations and costs together.

    Parameters
    ----------
    path: the path of the flight.
    motion: its motion, with the requirements of all flights.
    tension: [N] range of tensions that vary on the path, or None.
    certify: judges a flight that is shorter.
    effort: limit of the work.
    """
    requirements = motion.requirements
    first = flight_along(with_leg_lengths(path), requirements, tension, settings, cost)
    if first is None:
        return None
    candidates = [
        Candidate.of(flight)
        for flight in (first, *_better_flights(first, effort))
        if flight.shortfall < settings.max_shortfall
    ]
    # The first flight is as long as the motion up to rounding
    unrefined = motion.duration + first.cost(motion.duration / first.duration)
    largest = unrefined - MIN_SHORTER * motion.duration
    better = [each for each in candidates if each.objective < largest]
    better.sort(key=lambda candidate: candidate.objective)
    for index in _judged(len(better)):
        effort.spend(FLIGHT_COST * path.team.robots)
        certified = certify(better[index].path, better[index].motion)
        if certified is not None:
            return Refined(certified, better[index].cost)
    return None


def flight_cost(path: Path, motion: Motion, cost: FlightCost) -> float:
    """Return the custom cost [s] of the fastest motion along a path."""
    flight = flight_along(with_leg_lengths(path), motion.requirements, None, SETTINGS, cost)
    return 0.0 if flight is None else flight.cost(motion.duration / flight.duration)


class Candidate(NamedTuple):
    """A flight that may be returned."""

    path: Path
    """Its path."""

    motion: Motion
    """Its motion, within the limits."""

    cost: float
    """[s] Its custom cost."""

    @property
    def objective(self) -> float:
        """Its duration and cost [s]."""
        return self.motion.duration + self.cost

    @classmethod
    def of(cls, flight: Flight) -> Candidate:
        """Return a flight, stretched until its limits hold."""
        motion = within_limits(flight.motion)
        cost = flight.cost(motion.duration / flight.duration)
        return cls(flight.path, motion, cost)


def _judged(count: int) -> list[int]:
    """Return which flights are judged, the shortest first: consecutive ones fail alike."""
    return sorted({0, 1, count // 2, count - 1} & set(range(count)))


MIN_SHORTER = 1e-4
"""Gain over the duration below which a flight is not replaced."""


def _better_flights(flight: Flight, effort: Effort) -> Iterator[Flight]:
    """Yield the flights after each step that lowers the objective, or restores distances."""
    settings = flight.settings
    stride = settings.stride
    stalled = 0
    for _ in range(settings.max_steps):
        check_time()
        step = flight.step(stride, effort)
        if step is None:
            return
        expected = step.gain + settings.penalty * flight.shortfall
        effort.spend(FLIGHT_COST * flight.path.team.robots)
        moved = flight.after(step)
        gain = 0.0 if moved is None else flight.merit - moved.merit
        ratio = gain / max(expected, REGULARISATION)
        least = settings.min_gain * flight.duration
        stalled = stalled + 1 if gain < least else 0
        if moved is not None and ratio > ACCEPTED:
            flight = moved
            yield flight
        stride = min(stride * _stride_factor(ratio), settings.max_stride)
        ends = stride < settings.min_stride or stalled == settings.max_stalled
        if ends or expected < least:
            return


ACCEPTED = 0.05
"""Gain over the expected one above which a step is accepted."""

STRIDE_FACTORS = ((0.7, 1.6), (0.3, 1.0), (ACCEPTED, 0.5))
"""Gains over expected ones, and factors of the trust radius above them."""

REJECTED_FACTOR = 0.35
"""Factor of the trust radius after a step that is not accepted."""


def _stride_factor(ratio: float) -> float:
    """Return the factor of the trust radius for the ratio of a gain to the expected one."""
    return next((factor for least, factor in STRIDE_FACTORS if ratio > least), REJECTED_FACTOR)


def with_leg_lengths(path: Path) -> Path:
    """Return the path with q-legs as splines of their own, which do not depend on the slack."""
    flat = path.flat(np.linspace(0.0, 1.0, LEG_SAMPLES), 1)
    return replace(path, legs=LegLaw.of_lengths(evenly_interpolated(flat.q_legs[..., 0])))


def flight_along(
    path: Path,
    requirements: Requirements,
    tension: tuple[float, float] | None,
    settings: Settings,
    cost: FlightCost | None = None,
) -> Flight | None:
    """Return the fastest flight along a path, or None if it cannot be flown."""
    if shape_violation(path) is not None:
        return None
    clocked = if_balanced(partial(_fastest_motion, path, requirements), None)
    if clocked is None:
        return None
    motion, clock = clocked
    return Flight(path, motion, clock, requirements, tension, settings, cost)


def _fastest_motion(path: Path, requirements: Requirements) -> ClockedMotion | None:
    """Return the fastest motion along a path, or None if no timing was found."""
    try:
        return fastest_motion(path, requirements)
    except TimingError:
        return None


class LimitBlock(NamedTuple):
    """Rows of limits of motion."""

    rows: sp.csr_array[np.float64]
    """(rows, variables): derivatives by the splines' coefficients, then by those of x."""

    values: Array
    """(rows,): values over the limits."""

    @property
    def largest(self) -> Array:
        """(rows,): largest changes."""
        return np.maximum(LIMIT_SHARE - self.values, 0.0)


class Step(NamedTuple):
    """The solution of a step's last program."""

    change: PiecewisePolynomial
    """(unknowns,) over s."""

    rate_change: PiecewisePolynomial
    """Change of x over τ."""

    gain: float
    """[s] Expected gain of duration and cost."""


class Ratios(NamedTuple):
    """Limits of motion over their limits at M samples."""

    drones: Array
    """(5, M, 2n), in the order of DRONE_LIMITS."""

    vertices: Array
    """(M, points): speeds of points."""


@dataclass(frozen=True, eq=False)
class Flight:
    """A path with its fastest clock, and the program around it."""

    path: Path
    """The path; its q-legs are splines."""

    motion: Motion
    """Its motion by the clock, which may exceed limits between the clock's samples."""

    clock: Clock
    """Its clock."""

    requirements: Requirements
    """Requirements of all flights."""

    tension: tuple[float, float] | None
    """[N] Range of tensions, or None."""

    settings: Settings
    """Settings of the refinement."""

    custom_cost: FlightCost | None = None
    """Custom cost, which is added to the duration."""

    @property
    def duration(self) -> float:
        """Duration of the clock [s]."""
        return self.motion.duration

    @property
    def merit(self) -> float:
        """Duration and cost [s] plus the penalty of distances that are too short."""
        return self.duration + self.cost() + self.settings.penalty * self.shortfall

    @cached_property
    def cost_expansion(self) -> Expansion | None:
        """The custom cost at the samples, and its derivatives; None without one."""
        return None if self.custom_cost is None else self._expand(self.custom_cost, self.rate)

    def _expand(self, custom_cost: FlightCost, rate: Array) -> Expansion:
        """Return the custom cost at the samples for another rate x (M, 3)."""
        return custom_cost.expand_flight(
            self.jets_by_clock[:, :MOTION_JET],
            self.heights_by_clock[:, :MOTION_JET],
            rate[:, :2],
            self.progress[:, 0],
            self.columns,
        )

    def cost(self, stretch: float = 1.0) -> float:
        """Return the custom cost [s] of the flight, stretched in time; 0 without one."""
        if self.custom_cost is None:
            return 0.0
        expansion = self.cost_expansion
        if expansion is None or stretch != 1.0:
            expansion = self._expand(self.custom_cost, self.rate / stretch**2)
        return float(self.weights @ expansion.values)

    @cached_property
    def columns(self) -> Columns:
        """The unknowns."""
        path = self.path
        return Columns(path.team, path.roll is not None, path.tensions is not None)

    @cached_property
    def knots(self) -> Array:
        """Knots of the splines of the unknowns over s."""
        inner = np.linspace(0.0, 1.0, self.settings.pieces + 1)
        return np.concatenate([np.zeros(DEGREE), inner, np.ones(DEGREE)])

    @property
    def count(self) -> int:
        """Number of coefficients of each spline."""
        return self.settings.pieces + DEGREE

    @property
    def width(self) -> int:
        """Number of coefficients of all splines: spline by spline within each B-spline."""
        return self.count * self.columns.size

    def jets(self, path: Path, s: Array, count: int) -> Array:
        """Return the jets (J, unknowns, count) of a path by s at s (J,)."""
        layout = path.team.layout
        vertices = path.vertices.jet(s, count)[:, :, :2]
        legs = path.legs.length.jet(s, count) * np.all(layout.has_leg, axis=1)[:, None]
        parts = [vertices.reshape(len(s), -1, count), legs]
        parts += [each.jet(s, count) for each in (path.roll, path.tensions) if each is not None]
        return np.concatenate(parts, axis=1)

    def moved(self, change: PiecewisePolynomial) -> Path:
        """Return the path with a change (unknowns,) over s."""
        path = self.path
        columns = self.columns

        def of(indices: Indices) -> PiecewisePolynomial:
            """Return the change of some unknowns."""
            return change.replaced(change.coefficients[:, indices])

        vertices = on_breaks(path.vertices, merged_breaks([path.vertices.breaks, change.breaks]))
        vertices = vertices.elevated(max(vertices.degree, change.degree))
        coefficients = vertices.coefficients.copy()
        shift = on_breaks(change, vertices.breaks).elevated(vertices.degree).coefficients
        coefficients[:, :, :2] += shift[:, columns.points]
        return Path(
            path.team,
            vertices.replaced(coefficients),
            LegLaw.of_lengths(summed(path.legs.length, of(columns.q_legs))),
            None if path.tensions is None else summed(path.tensions, of(columns.tensions)),
            None if path.roll is None else summed(path.roll, of(columns.roll)),
        )

    def after(self, step: Step) -> Flight | None:
        """Return the flight after a step, or None if it cannot be flown.

        Without a custom cost its clock is the fastest one for its path. With one it is that of the
        step, which may be slower than limits need, and is slowed down where they need that.
        """
        path = self.moved(step.change)
        if self.custom_cost is None:
            return flight_along(path, self.requirements, self.tension, self.settings)
        if shape_violation(path) is not None:
            return None
        rate = summed(self.clock.squared_rate, step.rate_change)
        moved = if_balanced(
            partial(self._slowed, path, replace(self.clock, squared_rate=rate)), None
        )
        return moved if moved is None or math.isfinite(moved.duration) else None

    def _slowed(self, path: Path, clock: Clock) -> Flight:
        """Return the flight along a path by a clock, slowed down until limits hold."""
        motion = motion_by(path, self.requirements, clock)
        stretch = max(1.0, needed_stretch(motion))
        rate = clock.squared_rate
        slower = rate.replaced(rate.coefficients / stretch**2)
        return replace(
            self,
            path=path,
            motion=in_duration(motion, stretch * motion.duration),
            clock=replace(clock, squared_rate=slower),
        )

    # Limits of motion, at samples of the clock.

    @cached_property
    def tau(self) -> Array:
        """(M,) [s]: samples of the first clock."""
        nodes, _ = np.polynomial.legendre.leggauss(self.settings.nodes)
        half = 0.5 * np.diff(self.clock.knots)[:, None]
        return np.asarray((self.clock.knots[:-1, None] + half * (1.0 + nodes)).ravel())

    @cached_property
    def weights(self) -> Array:
        """(M,) [s]: weights of integrals over τ."""
        _, weights = np.polynomial.legendre.leggauss(self.settings.nodes)
        return np.asarray((0.5 * np.diff(self.clock.knots)[:, None] * weights).ravel())

    @cached_property
    def progress(self) -> Array:
        """(M, 4): s and its derivatives by τ at the samples."""
        progress = self.clock.progress.jet(self.tau, JET)
        progress[:, 0] = progress[:, 0].clip(0.0, 1.0)
        return progress

    @cached_property
    def rate(self) -> Array:
        """(M, 3): x and its derivatives by τ at the samples."""
        return self.clock.squared_rate.jet(self.tau, JET - 1)

    @cached_property
    def basis(self) -> LocalBasis:
        """The splines of the unknowns by τ at the samples."""
        basis = LocalBasis.of(self.knots, DEGREE, self.progress[:, 0], JET)
        return LocalBasis(basis.first, chained(basis.jets, self.progress[:, None]))

    @cached_property
    def rate_basis(self) -> LocalBasis:
        """The spline x at the samples."""
        return LocalBasis.of(self.rate_knots, RATE_DEGREE, self.tau, JET - 1)

    @cached_property
    def rate_knots(self) -> Array:
        """Knots of the spline x over τ."""
        return knots_through(self.clock.knots, RATE_DEGREE)

    @property
    def rate_coefficients(self) -> Array:
        """(coefficients of x,): x where each coefficient matters most."""
        knots = self.rate_knots
        averages = np.convolve(knots[1:-1], np.full(RATE_DEGREE, 1.0 / RATE_DEGREE), "valid")
        return self.clock.squared_rate.at(averages)

    @property
    def rate_count(self) -> int:
        """Number of coefficients of x."""
        return len(self.rate_knots) - RATE_DEGREE - 1

    @cached_property
    def functions(self) -> list[PartFunctions]:
        """The functions of all parts."""
        team = self.path.team
        heights = self.path.vertices.coefficients[:, :, 2]
        climbs = bool(np.ptp(heights) > 0.0)
        limits = clocked_limits(self.path, self.requirements)
        tilt = LIMIT_SHARE * limits.tilt
        return [
            PartFunctions(group, limits, tilt, team.max_thrust)
            for group in groups_of(self.columns, climbs=climbs)
        ]

    def ratios(self, path: Path, rate: Array) -> Ratios:
        """Return the limits of motion at the samples of a path and x (M, 3)."""
        limits = self.functions[0].limits
        flat = path.flat(self.progress[:, 0])
        clocked = ClockedPath.of(Demands.of(path.team, flat, limits), self.progress)
        root = np.sqrt(rate[:, :1])
        speeds = root * length(clocked.first) / limits.speed
        drones = np.concatenate([speeds[None], clocked.ratios(rate.T)])
        vertex_speeds = root * self.progress[:, 1:2] * length(flat.vertices[..., 1])
        return Ratios(drones, vertex_speeds / limits.vertex_speed)

    @cached_property
    def jets_by_clock(self) -> Array:
        """(M, 4, unknowns): derivatives of the unknowns by τ."""
        jets = chained(self.jets(self.path, self.progress[:, 0], JET), self.progress[:, None])
        return np.ascontiguousarray(jets.swapaxes(1, 2))

    @cached_property
    def heights_by_clock(self) -> Array:
        """(M, 4, points) [m]: derivatives of the points' heights by τ."""
        heights = self.path.vertices.jet(self.progress[:, 0], JET)[:, :, 2]
        return np.ascontiguousarray(chained(heights, self.progress[:, None]).swapaxes(1, 2))

    def limit_block(self, chosen: ChosenRows) -> LimitBlock:
        """Return the rows of chosen limits."""
        blocks: list[sp.csr_array[np.float64]] = []
        values: list[Array] = []
        for functions in self.functions:
            group = functions.group
            for limit, side, sample, part in chosen.of(group):
                slopes = functions.slopes(
                    limit,
                    side,
                    part,
                    self.jets_by_clock[sample],
                    self.heights_by_clock[sample],
                    self.rate[sample],
                )
                basis = self.basis.jets[sample]  # (rows, coefficients, 4)
                entries = np.einsum("rok,rco->rck", slopes.by_unknowns, basis)
                coefficient = self.basis.first[sample][:, None] + np.arange(DEGREE + 1)
                columns = coefficient[..., None] * self.columns.size + group.columns[part][:, None]
                of_rate = np.einsum("ro,rco->rc", slopes.by_clock, self.rate_basis.jets[sample])
                rate_columns = self.rate_basis.first[sample][:, None] + np.arange(RATE_DEGREE + 1)
                count = len(part)
                all_columns = [columns.reshape(count, -1), self.width + rate_columns]
                all_entries = [entries.reshape(count, -1), of_rate]
                blocks.append(
                    scattered(
                        np.concatenate(all_columns, axis=1),
                        np.concatenate(all_entries, axis=1),
                        self.width + self.rate_count,
                    )
                )
                values.append(slopes.ratio)
        if not blocks:
            return LimitBlock(sp.csr_array((0, self.width + self.rate_count)), np.zeros(0))
        return LimitBlock(sp.csr_array(sp.vstack(blocks)), np.concatenate(values))

    # Shapes, at samples of the path.

    @cached_property
    def shapes(self) -> PathShapes:
        """The shapes at the inner samples, which are closer at the ends."""
        evenly = np.linspace(0.0, 1.0, self.settings.samples)[1:-1]
        toward_ends = 0.5 - 0.5 * np.cos(np.pi * evenly)
        s = 0.5 * (evenly + toward_ends)
        unknowns = self.jets(self.path, s, 1)[..., 0]
        heights = self.path.vertices.jet(s, 1)[:, :, 2, 0]
        basis = LocalBasis.of(self.knots, DEGREE, s, 1)
        return PathShapes.of(self.columns, self.functions, s, unknowns, heights, basis)

    def shape_block(self, reach: float, margin: float) -> ShapeBlock:
        """Return the rows of distances, legs, walls, angles and tensions.

        Parameters
        ----------
        reach: [m] distance beyond the enforced one up to which bodies have rows.
        margin: enforced distances over their limits.
        """
        shapes = self.shapes
        blocks = [
            shapes.pair_block(self.requirements, reach, margin),
            shapes.leg_block(self.requirements, reach),
            shapes.wall_block(self.requirements, reach),
            shapes.turn_block(),
        ]
        blocks += list(shapes.obstacle_blocks(self.requirements, reach, margin))
        if self.tension is not None and self.columns.varying:
            blocks.append(shapes.tension_block(self.tension))
        rows = sp.csr_array(sp.vstack([block.rows for block in blocks]))
        return ShapeBlock(rows, np.concatenate([block.smallest for block in blocks]))

    @cached_property
    def shortfall(self) -> float:
        """Largest shortfall of a distance at the samples [m]."""
        half_margin = 1.0 + (self.settings.margin - 1.0) / 3.0
        block = self.shape_block(0.0, half_margin)
        return float(np.max(block.smallest, initial=0.0))

    # The program.

    def step(self, stride: float, effort: Effort) -> Step | None:
        """Return the solution of programs within a trust radius [m], or None without one."""
        settings = self.settings
        chosen = ChosenRows.near(self.ratios(self.path, self.rate), settings.near)
        limit_blocks = [self.limit_block(chosen)]
        shape = self.shape_block(2.0 * stride + REACH_MARGIN, settings.margin)
        enforced = shape.smallest > -settings.near_distance * stride
        program = TrustRegion.of(self, stride, shape)
        for _ in range(settings.max_rounds):
            qp = program.joined(limit_blocks, enforced)
            if not effort.spend(ENTRY_COST * float(qp.P.nnz + qp.A.nnz)):
                return None
            solution = solve_qp(qp)
            if solution is None:
                return None
            change, rate_change = program.changes(solution)
            trial = bspline(self.knots, change.reshape(self.count, -1), DEGREE)
            columns = self.rate_basis.first[:, None] + np.arange(RATE_DEGREE + 1)
            moved_rate = self.rate + np.einsum(
                "rco,rc->ro", self.rate_basis.jets, rate_change[columns]
            )
            ratios = self.ratios(self.moved(trial), moved_rate)
            more = ChosenRows.near(ratios, BROKEN).without(chosen)
            shortfall = shape.smallest - shape.rows @ change
            is_short = shortfall > 0.0
            if not more.any and not np.any(is_short & ~enforced):
                break
            enforced |= shortfall > -ADDED_DISTANCE * stride
            if more.any:
                chosen = chosen.plus(more)
                limit_blocks.append(self.limit_block(more))
        rates = bspline(self.rate_knots, rate_change, RATE_DEGREE)
        return Step(trial, rates, program.expected_gain(change, rate_change))


ADDED_DISTANCE = 0.1
"""Distance to its bound, in strides, below which a distance gets a row with others."""


@dataclass(frozen=True, eq=False)
class ChosenRows:
    """Limits of motion that have rows."""

    drones: NDArray[np.bool_]
    """(5, M, 2n), in the order of DRONE_LIMITS."""

    vertices: NDArray[np.bool_]
    """(M, points)"""

    @classmethod
    def near(cls, ratios: Ratios, share: float) -> ChosenRows:
        """Return the limits above a share."""
        return cls(ratios.drones > share, ratios.vertices > share)

    def without(self, others: ChosenRows) -> ChosenRows:
        """Return those that are not among others."""
        return ChosenRows(self.drones & ~others.drones, self.vertices & ~others.vertices)

    def plus(self, others: ChosenRows) -> ChosenRows:
        """Return those and others."""
        return ChosenRows(self.drones | others.drones, self.vertices | others.vertices)

    @property
    def any(self) -> bool:
        """Return whether there are any."""
        return bool(np.any(self.drones) or np.any(self.vertices))

    def of(self, group: Group) -> Iterator[tuple[Limit, int, Indices, Indices]]:
        """Yield limit, side, samples (rows,) and parts (rows,) of those of a group."""
        for limit, is_chosen in zip(DRONE_LIMITS, self.drones, strict=True):
            for side in range(group.kind.sides):
                sample, part = np.nonzero(is_chosen[:, group.drones[:, side]])
                if len(sample):
                    yield limit, side, sample, part
        sample, part = np.nonzero(self.vertices[:, group.vertices])
        if len(sample):
            yield Limit.VERTEX_SPEED, 0, sample, part


@dataclass(frozen=True, eq=False)
class TrustRegion:
    """The program of a step, without its rows: variables, objective and bounds.

    Variables are the changes of the splines' free coefficients over their trust radii, the changes
    of the coefficients of x, and slacks of distances that are too short.
    """

    flight: Flight
    """The current flight."""

    shape: ShapeBlock
    """All rows of shapes."""

    free: Indices
    """(free,): coefficients of splines that change."""

    radii: Array
    """(free,): their trust radii."""

    rate_gradient: Array
    """(coefficients of x,) [s]: derivatives of the duration."""

    cost_gradient: Array
    """(coefficients of splines,) [s]: derivatives of the custom cost."""

    hessian: sp.csc_array[np.float64]
    """(variables, variables)"""

    @classmethod
    def of(cls, flight: Flight, stride: float, shape: ShapeBlock) -> TrustRegion:
        """Return the program around a flight within a trust radius [m].

        Radii decrease toward the ends of the path, as far as these are away in pieces: without
        that, coefficients next to the fixed ends bend the path more than they move it.
        """
        settings = flight.settings
        size = flight.columns.size
        averages = np.convolve(flight.knots[1:-1], np.full(DEGREE, 1.0 / DEGREE), "valid")
        from_ends = settings.pieces * np.minimum(averages, 1.0 - averages)
        per_coefficient = stride * np.minimum(1.0, from_ends)
        radii = np.outer(per_coefficient, flight.columns.is_free).ravel()
        free = np.flatnonzero(radii)
        x = flight.rate[:, 0]
        columns = flight.rate_basis.first[:, None] + np.arange(RATE_DEGREE + 1)
        values = scattered(columns, flight.rate_basis.jets[..., 0], flight.rate_count)
        gradient = np.asarray(values.T @ (-0.5 * flight.weights * x**-1.5))
        curvature = values.T @ sp.diags_array(0.75 * flight.weights * x**-2.5) @ values
        differences = settings.pieces * np.diff(np.eye(flight.count), n=2, axis=0)
        bends = sp.csr_array(sp.kron(differences.T @ differences, sp.eye_array(size)))
        bends = bends[free][:, free] * (settings.bend_weight / flight.path.team.robots)
        unit_radii = sp.diags_array(radii[free])
        violated = int(np.count_nonzero(shape.smallest > 0.0))
        hessian = sp.block_diag([unit_radii @ bends @ unit_radii, curvature])
        cost_gradient = np.zeros(flight.width)
        if flight.cost_expansion is not None:
            cost = _cost_terms(flight, flight.cost_expansion, radii)
            cost_gradient = cost.gradient[: flight.width]
            gradient = gradient + cost.gradient[flight.width :]
            kept = np.append(free, flight.width + np.arange(flight.rate_count))
            hessian = hessian + cost.hessian[kept][:, kept]
        hessian = 0.5 * (hessian + hessian.T) + REGULARISATION * sp.eye_array(hessian.shape[0])
        slacks = sp.csr_array((violated, violated))
        whole = sp.csc_array(sp.block_diag([hessian, slacks]))
        return cls(flight, shape, free, radii[free], gradient, cost_gradient[free], whole)

    def joined(
        self, limit_blocks: Sequence[LimitBlock], enforced: NDArray[np.bool_]
    ) -> QuadraticProgram:
        """Return the program with rows of limits and enforced rows (rows,) of shapes."""
        flight = self.flight
        violated = np.flatnonzero(self.shape.smallest > 0.0)
        slacks = len(violated)
        shape = (len(self.shape.smallest), slacks)
        entries = (np.full(slacks, SLACK_UNIT), (violated, np.arange(slacks)))
        slack_rows = sp.csr_array(entries, shape)[enforced]
        limits = sp.csr_array(sp.vstack([block.rows for block in limit_blocks]))
        largest = np.concatenate([block.largest for block in limit_blocks])
        radii = sp.diags_array(self.radii)
        of_limits = [limits[:, self.free] @ radii, limits[:, flight.width :], None]
        of_shapes = [self.shape.rows[enforced][:, self.free] @ radii, None, slack_rows]
        smallest = self.shape.smallest[enforced]
        free = np.ones(len(self.free))
        rate = flight.settings.rate_change * flight.rate_coefficients
        of_splines = self.radii * self.cost_gradient
        penalty = flight.settings.penalty * SLACK_UNIT * SLACK_PENALTY
        return QuadraticProgram(
            P=self.hessian,
            q=np.concatenate([of_splines, self.rate_gradient, np.full(slacks, penalty)]),
            A=sp.csc_array(sp.block_array([of_limits, of_shapes])),
            lower=np.append(np.full(len(largest), -np.inf), smallest),
            upper=np.append(largest, np.full(len(smallest), np.inf)),
            x_min=np.concatenate([-free, -rate, np.zeros(slacks)]),
            x_max=np.concatenate([free, rate, np.full(slacks, np.inf)]),
        )

    def expected_gain(self, change: Array, rate_change: Array) -> float:
        """Return the expected gain of duration and cost [s] by changes of all coefficients."""
        of_cost = self.cost_gradient @ change[self.free]
        return -float(self.rate_gradient @ rate_change + of_cost)

    def changes(self, solution: Array) -> tuple[Array, Array]:
        """Return the changes of all splines' coefficients, and of those of x."""
        change = np.zeros(self.flight.width)
        count = len(self.free)
        change[self.free] = self.radii * solution[:count]
        return change, solution[count : count + self.flight.rate_count]


class CostTerms(NamedTuple):
    """Convex second-order expansion of the custom cost."""

    gradient: Array
    """(variables,) [s]: by the coefficients of splines, then by those of x."""

    hessian: sp.csr_array[np.float64]
    """(variables, variables): the same in units of trust radii."""


def _cost_terms(flight: Flight, expansion: Expansion, radii: Array) -> CostTerms:
    """Return the expansion of the custom cost by the coefficients of splines and of x.

    Each sample's Hessian is convex in units of trust radii, by clipped eigenvalues.
    """
    size = flight.columns.size
    count = len(expansion.values)
    splines = (DEGREE + 1) * size
    local = splines + RATE_DEGREE + 1
    # Derivatives of a sample's variables by its coefficients
    tangent = np.zeros((count, MOTION_JET * size + 2, local))
    unknown = np.arange(size)
    for order in range(MOTION_JET):
        for coefficient in range(DEGREE + 1):
            rows = order * size + unknown
            columns = coefficient * size + unknown
            tangent[:, rows, columns] = flight.basis.jets[:, coefficient, order, None]
    rate_jets = flight.rate_basis.jets[:, :, :2].swapaxes(1, 2)
    tangent[:, -2:, splines:] = rate_jets
    coefficients = flight.basis.first[:, None] + np.arange(DEGREE + 1)
    places = (coefficients[..., None] * size + unknown).reshape(count, -1)
    rate_columns = flight.rate_basis.first[:, None] + np.arange(RATE_DEGREE + 1)
    places = np.concatenate([places, flight.width + rate_columns], axis=1)
    scale = np.append(radii, np.full(flight.rate_count, 1.0))[places]
    weights = flight.weights
    gradients = weights[:, None] * np.einsum("mv,mvl->ml", expansion.gradients, tangent)
    scaled = tangent * scale[:, None]
    hessians = convex_parts(scaled.swapaxes(1, 2) @ expansion.hessians @ scaled)
    hessians = weights[:, None, None] * hessians
    total = flight.width + flight.rate_count
    gradient = np.zeros(total)
    np.add.at(gradient, places, gradients)
    rows, columns = np.broadcast_arrays(places[:, :, None], places[:, None])
    entries = (hessians.ravel(), (rows.ravel(), columns.ravel()))
    return CostTerms(gradient, sp.csr_array(sp.coo_array(entries, (total, total))))


SLACK_PENALTY = 10.0
"""Penalty of slacks over that of shortfalls of flights."""
