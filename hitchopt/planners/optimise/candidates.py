"""The search for a path: guesses are optimised, one by one, until their paths are clear."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain

import numpy as np

from hitchopt.geometry import ConvexPolygon
from hitchopt.geometry.vectors import length
from hitchopt.hitch import Hitch
from hitchopt.planners.optimise.guesses import Guess, guesses, widened
from hitchopt.planners.optimise.ipopt_steps import farthest, iterates
from hitchopt.planners.optimise.knot_path import KnotPath
from hitchopt.planners.optimise.screening import (
    clear,
    end_margins,
    estimate,
    judged,
    level_enough,
    loose,
    same,
    sound,
)
from hitchopt.planners.optimise.search_task import (
    Effort,
    Judge,
    Search,
    SolverStep,
    work_for,
)
from hitchopt.planners.path.shape_path import ShapePath
from hitchopt.planners.timing.flight_curves import Flight
from hitchopt.requirements import Requirements
from hitchopt.values import Array


@dataclass(frozen=True)
class Round:
    """One round of refinement: how closely a path is examined.

    Attributes
    ----------
    finer: how many times the first knots' steps.
    parts: of every step, at whose ends distances are enforced.
    margin: how many times their limits.
    """

    finer: int
    parts: int
    margin: float


ROUNDS = (Round(1, 4, 1.02), Round(1, 8, 1.03), Round(2, 4, 1.02), Round(2, 8, 1.05))
"""Rounds of refinement until a path is clear and the judge accepts it."""

FIRST_STEP = SolverStep(0.17)
"""Step of the optimiser from a guess."""

LATER_STRIDE = 0.12
"""[m] Stride from a path that the optimiser has found."""

FIRST_STEPS, LATER_STEPS, FASTEST_STEPS = 12, 5, 4
"""Largest numbers of steps from a guess, in a round, and towards a faster path."""

NEXT = 0.25
"""Share of its stride: a faster path whose vertices are that near to a guess is next to it."""

SURE = 0.999
"""Factor on the estimate of a faster path below which that of its guess is flown in its place:
estimates that differ by less may mistake which of two flights is the shorter one."""

STILL = 0.15
"""Share of its stride: a step that moves no vertex by more will not clear a path either."""

LENGTH = 0.9
"""[m] Length that a vertex's path from one of the first knots to the next should not exceed."""

FEWEST_KNOTS, MOST_KNOTS = 8, 16
"""Bounds of the number of steps between the first knots."""

WIDER = 0.25
"""Share by which guesses are widened half way where none has led to a path as it is."""

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
    path: as it was found.
    flight: along it.
    """

    name: str
    path: ShapePath
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
    asked: whether the problem asks for such a path; else large teams are searched less long.
    """

    start: Hitch
    end: Hitch
    requirements: Requirements
    judge: Judge
    tension: tuple[float, float] | None = None
    asked: bool = False

    @cached_property
    def guesses(self) -> list[Guess]:
        """First guesses, the straight one first."""
        first, last = self.start.polygon, self.end.polygon
        if not isinstance(first, ConvexPolygon) or not isinstance(last, ConvexPolygon):
            return []
        return guesses(first, last, FEWEST_KNOTS + 1)

    @property
    def problem(self) -> list[KnotPath]:
        """Paths that the search starts from: hitches everywhere, if possible not in one heap."""
        whole = self._paths((guess.name, guess.polygons) for guess in self.guesses)
        return loose(whole, self.requirements) or whole

    def solve(self) -> list[Candidate]:
        """Return the paths found, the fastest first."""
        if not self.guesses or not all(
            level_enough(hitch, self.requirements) for hitch in (self.start, self.end)
        ):
            return []
        margins = end_margins(self.start, self.end, self.requirements)
        effort = Effort(work_for(self.start.team.robots, asked=self.asked))
        search = Search(self.requirements, self.judge, self.tension, margins, effort=effort)
        # With wider polygons half way, legs have more room to pass one another.
        wide = ((guess.name, widened(guess.polygons, WIDER)) for guess in self.guesses[1:])
        return searched(self.problem, search) or searched(self._paths(wide), search)

    def _paths(self, polygons: Iterable[tuple[str, Array]]) -> list[KnotPath]:
        paths = (KnotPath.through(name, self.start, self.end, each) for name, each in polygons)
        return [path for path in paths if sound(path)]


def searched(paths: Sequence[KnotPath], search: Search) -> list[Candidate]:
    """Return the paths found from the given first ones, the fastest first.

    Those that take the least time as they are come first; the others have to be near them. Guesses
    that are one would come to the same: another of them is tried only where one led nowhere.
    """
    found: list[Candidate] = []
    seen: list[KnotPath] = []
    fastest = np.inf
    groups = _alike(paths)
    firsts = [group[0].resampled(_steps(group[0]) + 1) for group in groups]
    direct = _quickened(firsts[0], search) if len(firsts) == 1 else None
    if direct is not None:
        return [direct]
    estimates = _estimates(firsts, search)
    for k in np.argsort(estimates, kind="stable"):
        if estimates[k] > HOPELESS * fastest:
            break
        others = (path.resampled(_steps(path) + 1) for path in groups[k][1:])
        settling = (_settled(knots, search, seen) for knots in chain([firsts[k]], others))
        settled = next((path for path in settling if path is not None), None)
        if settled is None:
            continue
        if found and estimate(settled, search.requirements) > WORSE * fastest:
            continue
        refined = _refined(settled, search)
        if refined is not None:
            found.append(refined)
            fastest = min(fastest, refined.flight.duration)
    return sorted(found, key=lambda candidate: candidate.flight.duration)


def _alike(paths: Sequence[KnotPath]) -> list[list[KnotPath]]:
    """Return the paths in groups of one each, the last ones first: edges that turn stay convex."""
    groups: list[list[KnotPath]] = []
    for path in reversed(paths):
        group = next((group for group in groups if same(path, group[0])), None)
        if group is None:
            groups.append([path])
        else:
            group.append(path)
    return groups


def _estimates(paths: Sequence[KnotPath], search: Search) -> list[float]:
    """Return estimates of the paths' durations [s] to order them by; a single one needs none."""
    if len(paths) == 1:
        return [0.0]
    return [estimate(path, search.requirements) for path in paths]


def _quickened(guess: KnotPath, search: Search) -> Candidate | None:
    """Return the faster path next to a guess that is clear, with its flight; None if there is none.

    Where one step of the optimiser leads farther away, the path of least energy comes first.
    """
    if not clear(guess, search):
        return None
    closer = replace(search, margin=ROUNDS[0].margin)
    step = SolverStep(LATER_STRIDE, ROUNDS[0].parts, fastest=True, multipliers=False, near=NEXT)
    faster = next(iterates(guess, closer, step, 1), None)
    if faster is None or farthest(faster, guess) >= NEXT * step.stride:
        return None
    if not clear(faster, search):
        return None
    by_step, as_it_is = _estimates([faster, guess], search)
    return _flown([guess] if as_it_is < SURE * by_step else [faster, guess], search)


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

    Where limits are broken between the knots, rows are added there, then more knots; a path on
    which none is has its least energy already.
    """
    steps = path.steps
    for how in ROUNDS:
        if path.steps != how.finer * steps:
            path = path.resampled(how.finer * steps + 1)
        closer = replace(search, margin=how.margin)
        step = SolverStep(LATER_STRIDE, how.parts)
        as_it_is = [path] if how is ROUNDS[0] else []
        for moved in chain(as_it_is, iterates(path, closer, step, LATER_STEPS, STILL)):
            path = moved
            if clear(path, search):
                break
        else:
            continue
        quicker = iterates(path, closer, replace(step, fastest=True), FASTEST_STEPS, STILL)
        faster = [moved for moved in quicker if clear(moved, search)]
        choices = [*faster, path]
        best = choices[int(np.argmin(_estimates(choices, search)))]
        found = _flown(dict.fromkeys([best, path]), search)
        if found is not None:
            return found
    return None


def _flown(paths: Iterable[KnotPath], search: Search) -> Candidate | None:
    """Return the first path that the judge accepts, with its flight."""
    for choice in paths:
        shape = choice.path
        flight = judged(shape, search)
        if flight is not None:
            return Candidate(choice.name, shape, flight)
    return None


def _steps(path: KnotPath) -> int:
    """Return how many steps between knots a path needs, its longest vertex path's being LENGTH."""
    longest = float(np.max(np.sum(length(np.diff(path.polygons, axis=0)), axis=0)))
    return int(np.clip(np.ceil(longest / LENGTH), FEWEST_KNOTS, MOST_KNOTS))
