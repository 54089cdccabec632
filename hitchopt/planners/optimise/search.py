"""The search for a path: guesses are optimised, one by one, until their paths are clear."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from hitchopt.errors import InfeasibleError
from hitchopt.geometry import ConvexPolygon
from hitchopt.geometry.outline import centroids
from hitchopt.geometry.vectors import length
from hitchopt.hitch import Hitch
from hitchopt.hitch.requirements import Requirements
from hitchopt.hitch.slack_split import LegTask, reference_margins
from hitchopt.motion.motion import Motion
from hitchopt.planners.morph.legs import legs_clear
from hitchopt.planners.morph.morph import check_shapes, exterior_angles
from hitchopt.planners.optimise.knots import Judge, KnotPath, Search, SolverStep
from hitchopt.planners.optimise.program import iterates
from hitchopt.planners.timing.profile import (
    LIMIT_SHARE,
    TimingError,
    demands_along,
    flight_estimate,
    rest_ratios,
)
from hitchopt.values import Array

REFINEMENTS = ((1, 1.03), (2, 1.05))
"""Rounds of refinement until a path is clear and the judge accepts it: how many times the first
knots' steps, and how many times their limits distances are."""

PARTS = 8
"""Number of parts of every step, at whose ends distances are enforced then."""

FIRST_STEP = SolverStep(0.17)
"""Step of the optimiser from a guess."""

LATER_STRIDE = 0.12
"""[m] Stride from a path that the optimiser has found."""

FIRST_STEPS, LATER_STEPS, FASTEST_STEPS = 12, 5, 3
"""Largest numbers of steps from a guess, in a round, and towards a faster path."""

MIN_STRIDE = 0.15
"""Share of its stride: a step that moves no vertex by more will not clear a path either."""

LENGTH = 0.9
"""[m] Length that a vertex's path from one of the first knots to the next should not exceed."""

FEWEST_KNOTS, MOST_KNOTS = 8, 16
"""Bounds of the number of steps between the first knots."""

HOPELESS, WORSE = 1.3, 1.1
"""Factors on the duration of the fastest path found: slower guesses are not optimised, slower
estimates are not refined."""

CLOSEST = 0.3
"""Share of their limits that the distances of a guess must exceed for it to be tried."""

SHARPEST_LOSS = 0.1
"""Share of its ends' smallest exterior angle and shortest edge that a guess must exceed."""

WIDEST = 1.1
"""Largest margin of any round; larger ones count the same."""

BELOW = 1.0 - 1e-4
"""Factor on an end's own margin: the end is to satisfy it in spite of rounding."""

SAME = 0.05
"""[m] Paths that differ by less at every knot count as one."""

SHORTEST_EDGE = 0.3
"""Least share of the shorter of an edge's two lengths on a path of edges that turn."""

WIDENED = 1.4
"""Scale of the outline half way on a path that is widened, on which legs pass star tips."""

OTHER_TURN = 0.75 * math.pi
"""[rad] Smallest turn for which turning in the other direction is a guess as well."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """A motion that the judge has accepted, and the name of the guess that it came from."""

    name: str
    motion: Motion


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

    @property
    def problem(self) -> list[KnotPath]:
        """Paths that the search starts from: hitches everywhere, if possible not in one heap."""
        first, last = self.start.polygon, self.end.polygon
        if not isinstance(first, ConvexPolygon) or not isinstance(last, ConvexPolygon):
            return []
        named = guesses(first, last, FEWEST_KNOTS + 1).items()
        paths = [KnotPath.through(name, self.start, self.end, each) for name, each in named]
        whole = [path for path in paths if _sound(path)]
        return [path for path in whole if np.min(self._margins(path)) >= CLOSEST] or whole

    def solve(self) -> list[Candidate]:
        """Return the paths found, the fastest first.

        Guesses that take the least time as they are come first, edges that turn before whole
        polygons: those like one tried before are left out, as are those that come to a path seen
        before.
        """
        candidates: list[Candidate] = []
        seen: list[KnotPath] = []
        fastest, paths = math.inf, self.problem
        if not paths:
            return []
        first, last = (BELOW * self._margins(paths[0]))[[0, -1]].tolist()
        search = Search(self.requirements, self.judge, self.tension, (first, last))
        firsts = [path.resampled(_steps(path)) for path in reversed(paths)]
        estimates = [_estimate(path, self.requirements) for path in firsts]
        for k in np.argsort(estimates, kind="stable"):
            if estimates[k] > HOPELESS * fastest:
                break
            if any(_same(firsts[k], other) for other in seen):
                continue
            settled = _settled(firsts[k], search, seen)
            seen.append(firsts[k])
            if settled is None:
                continue
            seen.append(settled)
            if _estimate(settled, self.requirements) > WORSE * fastest:
                continue
            motion = _refined(settled, search)
            if motion is not None:
                candidates.append(Candidate(settled.name, motion))
                fastest = min(fastest, motion.duration)
        return sorted(candidates, key=lambda candidate: candidate.motion.duration)

    def _margins(self, path: KnotPath) -> Array:
        """Return how many times their limits the distances at the knots (J + 1,) are."""
        bare, places = replace(self.requirements, arena=None), (path.polygons, path.q_legs)
        return reference_margins(LegTask(path.team, bare, *places, 0.0, WIDEST, roll=path.roll))


def guesses(first: ConvexPolygon, last: ConvexPolygon, count: int) -> dict[str, Array]:
    """Return first guesses (count, n, 2) [m], each of another homotopy, by their names.

    Straight lines need not stay convex, and a half turn along them collapses to a point. Turning
    the edges' directions evenly, with the nearest lengths that close, gives convex polygons; so
    does turning the whole polygon while its shape changes, where the shapes are alike. A polygon
    that is widened half way lets legs pass each other.
    """
    s = np.linspace(0.0, 1.0, count)
    guesses = {"straight": _line(first.vertices, last.vertices, s)}
    middle = guesses["straight"].mean(axis=1, keepdims=True)
    swell = 1.0 + (WIDENED - 1.0) * np.sin(math.pi * s)[:, None, None]
    guesses["widened"] = middle + swell * (guesses["straight"] - middle)
    start, goal = (_directions(polygon) for polygon in (first, last))
    # Edges turn by amounts that differ by less than a full turn: one unwrapping serves them all.
    mean = float(np.mean(goal - start))
    turn = mean - 2.0 * math.pi * math.ceil((mean - math.pi) / (2.0 * math.pi))
    other = turn - math.copysign(2.0 * math.pi, turn)
    centres = _line(first.centroid, last.centroid, s)[:, None]
    for angle in (turn, other) if abs(turn) > OTHER_TURN else (turn,):
        name = f"turned {math.degrees(angle):.0f}°"
        shape = _rotated(last.vertices - last.centroid, np.array([-angle]))[0]
        shapes = _line(first.vertices - first.centroid, shape, s)
        guesses[name] = centres + _rotated(shapes, angle * s)
        sides = _line(start, goal + angle - mean, s)[..., None]
        sides = np.concatenate([np.cos(sides), np.sin(sides)], axis=-1)
        lengths, across = _line(first.edge_lengths, last.edge_lengths, s), np.swapaxes(sides, 1, 2)
        lengths -= (sides @ np.linalg.solve(across @ sides, across @ lengths[..., None]))[..., 0]
        if np.all(lengths >= SHORTEST_EDGE * np.minimum(first.edge_lengths, last.edge_lengths)):
            edges = lengths[..., None] * sides
            corners = np.cumsum(edges, axis=1) - edges
            guesses[f"edges {name}"] = corners + centres - centroids(corners)[:, None]
    return guesses


def _directions(polygon: ConvexPolygon) -> Array:
    """Return the edges' directions (n,) [rad], falling by the exterior angles from edge to edge."""
    u = polygon.edge_directions[0]
    start = math.atan2(u[1], u[0])
    return start - np.append(0.0, np.cumsum(polygon.exterior_angles[1:]))


def _line(first: Array, last: Array, s: Array) -> Array:
    """Return values that change linearly, at s (J,)."""
    return first + np.multiply.outer(s, last - first)


def _rotated(points: Array, angles: Array) -> Array:
    """Return (J, n, 2): points (n, 2) or (J, n, 2) turned by angles (J,)."""
    c, s = np.cos(angles), np.sin(angles)
    turned: Array = points @ np.moveaxis(np.array([[c, s], [-s, c]]), -1, 0)
    return turned


def _sound(path: KnotPath) -> bool:
    """Return whether a guess is a hitch everywhere: convex, with edges, legs and slack."""
    values = exterior_angles(path.team.layout, path.edges), length(path.edges)
    lost = (np.min(each) <= SHARPEST_LOSS * np.min(each[[0, -1]]) for each in values)
    return bool(np.min(path.slack) > 0.0) and not any(lost)


def _steps(path: KnotPath) -> int:
    """Return how many steps between knots a path needs, its longest vertex path's being LENGTH."""
    longest = float(np.max(np.sum(length(np.diff(path.polygons, axis=0)), axis=0)))
    return int(np.clip(np.ceil(longest / LENGTH), FEWEST_KNOTS, MOST_KNOTS))


def _estimate(path: KnotPath, requirements: Requirements) -> float:
    """Return an estimate of how long a flight along a path takes [s], clear or not."""
    return flight_estimate(path.path, requirements.limits)


def _same(path: KnotPath, other: KnotPath) -> bool:
    """Return whether two guesses have come to one and the same path."""
    if path.steps != other.steps:
        other = other.resampled(path.steps)
    apart = (path.polygons - other.polygons, path.q_legs - other.q_legs)
    return max(float(np.max(np.abs(part))) for part in apart) < SAME


def _settled(guess: KnotPath, search: Search, seen: list[KnotPath]) -> KnotPath | None:
    """Return the path of least energy near a guess; None where it comes to one seen before."""
    path: KnotPath | None = None
    for path in iterates(guess, search, FIRST_STEP, FIRST_STEPS):
        if any(_same(path, other) for other in seen):
            return None
    return path


def _refined(path: KnotPath, search: Search) -> Motion | None:
    """Return the motion along a path of least energy refined, or a faster one near it.

    Where limits are broken between the knots, rows are added there, then knots; a path on which
    none is has its least energy already.
    """
    steps = path.steps
    for finer, margin in REFINEMENTS:
        path = path if finer == 1 else path.resampled(finer * steps)
        closer, step = replace(search, margin=margin), SolverStep(LATER_STRIDE, PARTS)
        as_it_is = [path] if finer == 1 else []
        for moved in chain(as_it_is, iterates(path, closer, step, LATER_STEPS, MIN_STRIDE)):
            path = moved
            if _clear(path, search):
                break
        else:
            continue
        quicker = iterates(path, closer, replace(step, fastest=True), FASTEST_STEPS, MIN_STRIDE)
        choices = [*(moved for moved in quicker if _clear(moved, search)), path]
        best = min(choices, key=lambda each: _estimate(each, search.requirements))
        for choice in dict.fromkeys([best, path]):
            try:
                motion = search.judge(choice.path)
            except (InfeasibleError, TimingError):
                continue
            if motion is not None:
                return motion
    return None


def _clear(knots: KnotPath, search: Search) -> bool:
    """Return whether a path looks as if it could be flown: cheap, the judge decides later."""
    path, requirements = knots.path, search.requirements
    try:
        check_shapes(path)
    except InfeasibleError:
        return False
    if not legs_clear(path, requirements):
        return False
    demands = demands_along(path, requirements.limits)
    if np.max(rest_ratios(path.team, requirements.limits, demands.loads)) >= LIMIT_SHARE:
        return False
    arena, drones = requirements.arena, demands.drones[..., 0]
    return arena is None or bool(np.all((drones >= arena.lower) & (drones <= arena.upper)))
