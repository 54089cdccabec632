"""The search for a path: guesses are optimised, one by one, until their paths are clear."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain

import numpy as np

from hitchopt.errors import InfeasibleError
from hitchopt.geometry import ConvexPolygon
from hitchopt.geometry.vectors import length
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.leg_program import LegTask
from hitchopt.hitch.legs import reference_margin, reference_margins
from hitchopt.hitch.requirements import Requirements
from hitchopt.planners.morph.legs import CLEAR, leg_task_of
from hitchopt.planners.morph.morph import check_shapes_at, exterior_angles
from hitchopt.planners.morph.path import ShapePath, Shapes, shapes_along
from hitchopt.planners.optimise.guesses import guesses
from hitchopt.planners.optimise.knots import Judge, KnotPath, Search, SolverStep
from hitchopt.planners.optimise.program import iterates
from hitchopt.planners.timing.flight import Flight
from hitchopt.planners.timing.profile import (
    LIMIT_SHARE,
    TimingError,
    demands_along,
    flight_estimate,
    rest_ratios,
)
from hitchopt.values import Array

ROUNDS = ((1, 1.03), (2, 1.05))
"""Rounds of refinement until a path is clear and the judge accepts it: how many times the first
knots' steps, and how many times their limits distances are."""

PARTS = 8
"""Number of parts of every step, at whose ends distances are enforced then."""

FIRST_STEP = SolverStep(0.17)
"""Step of the optimiser from a guess."""

LATER_STRIDE = 0.12
"""[m] Stride from a path that the optimiser has found."""

FIRST_STEPS, LATER_STEPS, FASTEST_STEPS = 12, 5, 4
"""Largest numbers of steps from a guess, in a round, and towards a faster path."""

STILL = 0.15
"""Share of its stride: a step that moves no vertex by more will not clear a path either."""

LENGTH = 0.9
"""[m] Length that a vertex's path from one of the first knots to the next should not exceed."""

FEWEST_KNOTS, MOST_KNOTS = 8, 16
"""Bounds of the number of steps between the first knots."""

HOPELESS = 1.3
"""Factor on the duration of the fastest path found: slower guesses are not optimised."""

WORSE = 1.1
"""Factor on the duration of the fastest path found: slower estimates are not refined."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """A path that the judge has accepted.

    Attributes
    ----------
    name: of the guess that it came from.
    flight: along it.
    """

    name: str
    flight: Flight


@dataclass(frozen=True, eq=False)
class OptimisedMorph:
    """The planner of a morph along paths that the optimiser finds; none for chains.

    Attributes
    ----------
    start, end: hitches at one altitude that satisfy all limits.
    requirements: limits, separation and arena.
    judge: decides about every path; those that it rejects are refined.
    tension: smallest and largest [N] where tensions may change on the path.
    """

    start: Hitch
    end: Hitch
    requirements: Requirements
    judge: Judge
    tension: tuple[float, float] | None = None

    @cached_property
    def guesses(self) -> dict[str, Array]:
        """First guesses (J, n, 2) [m] by name, the straight one first."""
        first, last = self.start.polygon, self.end.polygon
        if not isinstance(first, ConvexPolygon) or not isinstance(last, ConvexPolygon):
            return {}
        return guesses(first, last, FEWEST_KNOTS + 1)

    @property
    def problem(self) -> list[KnotPath]:
        """Paths that the search starts from: hitches everywhere, if possible not in one heap."""
        named = self.guesses.items()
        paths = [KnotPath.through(name, self.start, self.end, each) for name, each in named]
        whole = [path for path in paths if sound(path)]
        bare = replace(self.requirements, arena=None)

        def smallest(path: KnotPath) -> float:
            return float(np.min(margins(bare, path.team, path.polygons, path.q_legs, path.roll)))

        return [path for path in whole if smallest(path) >= CLOSEST] or whole

    def solve(self) -> list[Candidate]:
        """Return the paths found, the fastest first."""
        bare, ends = replace(self.requirements, arena=None), (self.start, self.end)
        named = ((end.polygon.vertices, end.q_legs, end.roll) for end in ends)
        places = (np.stack(each) for each in zip(*named, strict=True))
        first, last = BELOW * margins(bare, self.start.team, *places)
        own = (float(first), float(last))
        return searched(self.problem, Search(self.requirements, self.judge, self.tension, own))


def searched(paths: Sequence[KnotPath], search: Search) -> list[Candidate]:
    """Return the paths found from the given first ones, the fastest first.

    Those that take the least time as they are come first, edges that turn before whole polygons
    where guesses are one: guesses like one that led to a path are left out, and others that come to
    the same path are given up.
    """
    found: list[Candidate] = []
    led: list[KnotPath] = []
    seen: list[KnotPath] = []
    fastest = np.inf
    firsts = [path.resampled(_steps(path) + 1) for path in reversed(paths)]
    estimates = [estimate(path, search.requirements) for path in firsts]
    for k in np.argsort(estimates, kind="stable"):
        if estimates[k] > HOPELESS * fastest:
            break
        if any(same(firsts[k], other) for other in led):
            continue
        settled = _settled(firsts[k], search, seen)
        if settled is None or estimate(settled, search.requirements) > WORSE * fastest:
            continue
        refined = _refined(settled, search)
        if refined is not None:
            found.append(refined)
            led.append(firsts[k])
            fastest = min(fastest, refined.flight.duration)
    return sorted(found, key=lambda candidate: candidate.flight.duration)


def _settled(knots: KnotPath, search: Search, seen: list[KnotPath]) -> KnotPath | None:
    """Return the path of least energy near a guess; None where it is one that was seen before."""
    found: KnotPath | None = None
    before = tuple(seen)
    for moved in iterates(knots, search, FIRST_STEP, FIRST_STEPS):
        if any(same(moved, other) for other in before):
            return None
        found = moved
        seen.append(moved)
    return found


def _refined(path: KnotPath, search: Search) -> Candidate | None:
    """Return a path of least energy refined, or a faster one near it, with its flight.

    Where limits are broken between the knots, rows are added there, then knots; a path on which
    none is has its least energy already.
    """
    steps = path.steps
    for finer, margin in ROUNDS:
        if path.steps != finer * steps:
            path = path.resampled(finer * steps + 1)
        closer, step = replace(search, margin=margin), SolverStep(LATER_STRIDE, PARTS)
        as_it_is = [path] if finer == 1 else []
        for moved in chain(as_it_is, iterates(path, closer, step, LATER_STEPS, STILL)):
            path = moved
            if clear(path, search):
                break
        else:
            continue
        quicker = iterates(path, closer, replace(step, fastest=True), FASTEST_STEPS, STILL)
        faster = [moved for moved in quicker if clear(moved, search)]
        choices = [*faster, path]
        best = min(choices, key=lambda each: estimate(each, search.requirements))
        found = _flown(dict.fromkeys([best, path]), search)
        if found is not None:
            return found
    return None


def _flown(paths: Iterable[KnotPath], search: Search) -> Candidate | None:
    """Return the first path that the judge accepts, with its flight."""
    for choice in paths:
        try:
            flight = search.judge(choice.path)
        except (InfeasibleError, TimingError):
            continue
        if flight is not None:
            return Candidate(choice.name, flight)
    return None


def _steps(path: KnotPath) -> int:
    """Return how many steps between knots a path needs, its longest vertex path's being LENGTH."""
    longest = float(np.max(np.sum(length(np.diff(path.polygons, axis=0)), axis=0)))
    return int(np.clip(np.ceil(longest / LENGTH), FEWEST_KNOTS, MOST_KNOTS))


CLOSEST = 0.3
"""Share of their limits that the distances of a guess must exceed for it to be tried."""

SHARPEST_LOSS = 0.1
"""Share of its ends' smallest exterior angle and shortest edge that a guess must exceed."""

WIDEST = 1.1
"""Largest margin of any round; larger ones need not be told apart."""

BELOW = 1.0 - 1e-4
"""Factor on an end's own margin: the end is to satisfy it in spite of rounding."""

SAME = 0.05
"""[m] Paths that differ by less at every knot count as one."""

PROBES = 33
"""Number of points at which a path's distances are evaluated before the judge decides, and again
near each end; its shapes at twice as many."""

NEAR_END = 0.1
"""Share of the path that is near an end."""

SPARSE, DENSE = (np.linspace(0.0, 1.0, count) for count in (PROBES, 2 * PROBES - 1))

NEAR_ENDS = np.concatenate([NEAR_END * SPARSE[1:-1], 1.0 - NEAR_END * SPARSE[1:-1]])

PLACES = np.unique(np.concatenate([DENSE, NEAR_ENDS]))
"""Where a path's shapes are evaluated."""

DISTANCES = np.isin(PLACES, np.concatenate([SPARSE, NEAR_ENDS]))
"""(PLACES,): whether its distances are evaluated there too."""


def sound(path: KnotPath) -> bool:
    """Return whether a guess is a hitch everywhere: convex, with edges, legs and slack."""
    lengths = length(path.edges)
    angles = exterior_angles(path.team.layout, path.edges)
    smallest, shortest = (np.min(values[[0, -1]]) for values in (angles, lengths))
    return bool(
        np.min(path.slack) > 0.0
        and np.min(angles) > SHARPEST_LOSS * smallest
        and np.min(lengths) > SHARPEST_LOSS * shortest
    )


def margins(
    requirements: Requirements, team: Team, polygons: Array, q_legs: Array, roll: Array | None
) -> Array:
    """Return how many times their limits the distances of hitches (J,) are."""
    return reference_margins(LegTask(team, requirements, polygons, q_legs, 0.0, WIDEST, roll=roll))


def same(path: KnotPath, other: KnotPath) -> bool:
    """Return whether two guesses have come to one and the same path."""
    if path.steps != other.steps:
        other = other.resampled(path.steps + 1)
    apart = (path.polygons - other.polygons, path.q_legs - other.q_legs)
    return max(float(np.max(np.abs(part))) for part in apart) < SAME


def clear(knots: KnotPath, search: Search) -> bool:
    """Return whether a path looks as if it could be flown: cheap, the judge decides later."""
    path, requirements = knots.path, search.requirements
    shapes = shapes_along(path, PLACES)
    try:
        check_shapes_at(PLACES, shapes, path.team.layout)
    except InfeasibleError:
        return False
    if not _distances_hold(path, requirements, shapes.chosen(DISTANCES)):
        return False
    demands = demands_along(path, requirements.limits)
    if np.max(rest_ratios(path.team, requirements.limits, demands.loads)) >= LIMIT_SHARE:
        return False
    arena, drones = requirements.arena, demands.drones[..., 0]
    return arena is None or bool(np.all((drones >= arena.lower) & (drones <= arena.upper)))


def estimate(path: KnotPath, requirements: Requirements) -> float:
    """Return an estimate of how long a flight along a path takes [s], clear or not."""
    return flight_estimate(path.path, requirements.limits)


def _distances_hold(path: ShapePath, requirements: Requirements, shapes: Shapes) -> bool:
    """Return whether legs are long enough and distances hold at shapes of a path."""
    if np.min(shapes.legs[1:-1]) < requirements.limits.leg:
        return False
    return reference_margin(leg_task_of(path, requirements, shapes, CLEAR)) >= CLEAR
