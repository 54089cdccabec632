"""Refinement of a certified morph: its route and its clock move together.

The clock of a flight is the fastest one for its route, but the route was chosen before it. Here the
unknowns are those of both: splines over s that are added to vertices, q-legs, roll and varying
tensions (``splines``), and the squared rate x of a clock over that of the flight (``flight``).
Around the current flight

    min Σ w / √x    over all linearised limits of motion, distances, walls, legs and angles,

within a trust region, is a sparse quadratic program (``trust_region``); PIQP solves it
(``casadi.conic``). Rows (``motion_rows``, ``shape_rows``) have casadi's exact derivatives of the
model of a clasp (``parts``). Every new route gets its own clock; the shortest flight that the judge
certifies is returned, so that nothing is lost.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Generic, NamedTuple, TypeVar

from hitchopt.errors import check_time
from hitchopt.motion.motion import Motion
from hitchopt.planners.candidates import Effort
from hitchopt.planners.optimise.cost import FlightCost
from hitchopt.planners.optimise.flight import PENALTY, Flight, with_leg_lengths
from hitchopt.planners.optimise.trust_region import REGULARISATION, best_step
from hitchopt.planners.path import Path
from hitchopt.planners.timing.timed_motion import within_limits

T = TypeVar("T")


@dataclass(frozen=True)
class RefinementTuning:
    """Numbers of the refinement; ``python -m benchmarks morphs`` shows their effect."""

    max_steps: int = 16  # Maximum number of programs that are linearised anew
    # Number of consecutive steps without ``min_gain`` after which refinement ends
    max_stalled: int = 3
    # Gain over the duration, expected or reached, that is too small to go on
    min_gain: float = 1e-3
    min_shorter: float = 1e-4  # Gain over the duration below which a flight is not replaced
    stride: float = 0.03  # [m] First trust radius of the splines' coefficients
    min_stride: float = 0.004  # [m] Trust radius below which refinement ends
    max_stride: float = 0.12  # [m] Largest trust radius
    rejected_factor: float = 0.35  # Factor of the trust radius after a step that is not accepted
    max_shortfall: float = 5e-4  # [m] Largest shortfall at samples of a flight that the judge sees
    # Effort per robot of timing a route, and of one judgement, in the unit of ``Effort``
    flight_cost: float = 40.0
    max_effort: float = 1.2e4  # Limit of the effort: about 3 s


TUNING = RefinementTuning()


ACCEPTED = 0.05  # Gain over the expected one above which a step is accepted

STRIDE_FACTORS = ((0.7, 1.6), (0.3, 1.0), (ACCEPTED, 0.5))
"""Gains over expected ones, and factors of the trust radius above them."""


Certify = Callable[[Path, Motion], T | None]
"""Function that returns what is certified of a motion along a path, or None."""


class Refined(NamedTuple, Generic[T]):
    """A refined flight."""

    certified: T  # What the judge made of it
    cost: float  # [s] Its custom cost


def refined(
    path: Path,
    motion: Motion,
    tension: tuple[float, float] | None,
    certify: Certify[T],
    effort: Effort,
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
    first = Flight.along(with_leg_lengths(path), motion.requirements, tension, cost)
    if first is None:
        return None
    flown = [
        Flown.of(flight)
        for flight in (first, *_better_flights(first, effort))
        if flight.shortfall < TUNING.max_shortfall
    ]
    # The first flight is as long as the motion up to rounding
    unrefined = motion.duration + first.cost(motion.duration / first.duration)
    largest = unrefined - TUNING.min_shorter * motion.duration
    better = [each for each in flown if each.objective < largest]
    better.sort(key=lambda each: each.objective)
    last = len(better) - 1
    # Consecutive flights fail alike
    for index in sorted({0, 1, len(better) // 2, last} & set(range(len(better)))):
        effort.spend(TUNING.flight_cost * path.team.robots)
        certified = certify(better[index].path, better[index].motion)
        if certified is not None:
            return Refined(certified, better[index].cost)
    return None


def flight_cost(path: Path, motion: Motion, cost: FlightCost) -> float:
    """Return the custom cost [s] of the fastest motion along a path."""
    flight = Flight.along(with_leg_lengths(path), motion.requirements, None, cost)
    return 0.0 if flight is None else flight.cost(motion.duration / flight.duration)


class Flown(NamedTuple):
    """A flight within its limits, which may be returned."""

    path: Path  # Its path
    motion: Motion  # Its motion
    cost: float  # [s] Its custom cost

    @property
    def objective(self) -> float:
        """Its duration and cost [s]."""
        return self.motion.duration + self.cost

    @classmethod
    def of(cls, flight: Flight) -> Flown:
        """Return a flight, stretched until its limits hold."""
        motion = within_limits(flight.motion)
        return cls(flight.path, motion, flight.cost(motion.duration / flight.duration))


def _better_flights(flight: Flight, effort: Effort) -> Iterator[Flight]:
    """Yield the flights after each step that lowers the objective, or restores distances."""
    stride = TUNING.stride
    stalled = 0
    for _ in range(TUNING.max_steps):
        check_time()
        step = best_step(flight, stride, effort)
        if step is None:
            return
        expected = step.gain + PENALTY * flight.shortfall
        effort.spend(TUNING.flight_cost * flight.path.team.robots)
        moved = flight.after(step)
        gain = 0.0 if moved is None else flight.merit - moved.merit
        ratio = gain / max(expected, REGULARISATION)
        least = TUNING.min_gain * flight.duration
        stalled = stalled + 1 if gain < least else 0
        if moved is not None and ratio > ACCEPTED:
            flight = moved
            yield flight
        factors = (factor for least_ratio, factor in STRIDE_FACTORS if ratio > least_ratio)
        stride = min(stride * next(factors, TUNING.rejected_factor), TUNING.max_stride)
        if stride < TUNING.min_stride or stalled == TUNING.max_stalled or expected < least:
            return
