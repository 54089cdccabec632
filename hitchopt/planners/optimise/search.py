"""The search for paths of a morph: guesses are optimized and refined one by one."""

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
from hitchopt.hitch.slack_split import LegTask
from hitchopt.motion.motion import Motion
from hitchopt.planners.morph.legs import legs_clear
from hitchopt.planners.morph.morph import check_shapes, exterior_angles
from hitchopt.planners.morph.path import ShapePath
from hitchopt.planners.optimise.knots import Effort, Judge, KnotPath, SearchLimits, SolverStep
from hitchopt.planners.optimise.program import iterates
from hitchopt.planners.timing.profile import (
    LIMIT_SHARE,
    TimingError,
    demands_along,
    flight_estimate,
    flight_estimates,
    rest_ratios,
)
from hitchopt.planners.timing.ramps import fastest_ramps
from hitchopt.values import Array

REFINEMENTS = ((1, 1.03), (2, 1.05))
"""Rounds of refinement until the judge accepts a path: factor of the number of knots, and margin of
distances."""

REFINED_PARTS = 8
"""Number of parts of every step, at whose ends refinement enforces distances."""

INITIAL_STEP = SolverStep(0.17)
"""Step of the optimizer from a guess."""

REFINED_STRIDE = 0.12
"""[m] Stride of the optimizer in refinement."""

MAX_INITIAL_STEPS, MAX_REFINED_STEPS, MAX_FASTEST_STEPS = 12, 5, 6
"""Maximum numbers of steps from a guess, in a round of refinement, and toward a faster path."""

LEG_PERTURBATIONS = (0.05, 0.0)
"""Largest changes of q-legs in guesses, over the shorter leg of their cable; one after the other is
tried until a motion is found. Without changes all robots of regular polygons move alike up to
saddle points, as all rows are linear."""

MIN_REFINED_PROGRESS = 0.05
"""Smallest motion of vertices in a step over its stride, below which refinement ends."""

KNOT_DISTANCE = 0.9
"""[m] Largest length of a vertex's path between two knots, within the bounds of their number."""

MIN_STEPS, MAX_STEPS = 8, 16
"""Bounds of the number of steps between the knots of a guess."""

MAX_GUESS_RATIO, MAX_ESTIMATE_RATIO = 1.3, 1.1
"""Largest estimated durations, over the fastest path so far, of guesses that are optimized, and of
optimized paths that are refined."""

MIN_GAIN = 0.01
"""Smallest gain over the fastest path so far, as a share of its duration, for which guesses are
tried."""

MAX_EFFORT = 240.0
"""Limit of the effort if the straight path is infeasible, per robot and inner knot of the largest
guess. Successful searches of 3 to 12 robots took up to 170."""

MIN_EFFORT, EFFORT_PER_ROBOT = 2e4, 300.0
"""Limit of the effort if the straight path is feasible, which is about ten times that of planning
it, or about 2 s if that is more."""

MIN_STEP_GAIN = 5e-4
"""Smallest gain of a step toward a faster path, as a share of its duration, below which no further
one is tried."""

MIN_GUESS_MARGIN = 0.3
"""Smallest margin of distances of a preferred guess."""

MIN_SHAPE_SHARE = 0.1
"""Smallest exterior angle and edge of a guess, over those at its ends."""

MAX_MARGIN = 1.1
"""Largest margin of distances that is computed."""

END_MARGIN_FACTOR = 1.0 - 1e-4
"""Factor on the margins of the ends, which they then satisfy despite rounding."""

PATH_TOLERANCE = 0.05
"""[m] Difference at every knot below which paths are equal."""

MIN_EDGE_SHARE = 0.3
"""Smallest edge of a guess whose edges turn, over the shorter one of both ends."""

WIDENING = 1.4
"""Scale of the outline halfway on a widened path, on which legs pass the tips of stars."""

MIN_OTHER_TURN = 0.75 * math.pi
"""[rad] Smallest turn for which the opposite turn is a guess as well."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """A motion that the judge accepted, and the name of its guess; "" for the straight path."""

    name: str
    motion: Motion


@dataclass(frozen=True, eq=False)
class OptimisedMorph:
    """A planner of morphs along optimized paths; there are none for chains.

    If the straight path is feasible, it is the first candidate, and the search is limited to what
    can be faster.
    """

    start: Hitch  # hitch at one altitude that satisfies all limits
    end: Hitch  # hitch at the same altitude that satisfies all limits
    requirements: Requirements  # limits, separation and arena
    judge: Judge  # accepts or rejects paths; rejected ones are refined
    # smallest and largest [N] of variable tensions, or None
    tension: tuple[float, float] | None = None
    straight: ShapePath | None = None  # path with straight vertices; None if it is infeasible

    @property
    def min_duration(self) -> float:
        """Lower bound of the duration [s]: that of each drone and vertex alone, on a line."""
        limits = self.requirements.limits
        drones = length(self.end.drones - self.start.drones)
        durations, _ = fastest_ramps(drones, limits.speed, limits.acceleration, limits.jerk)
        vertices = length(self.end.vertices - self.start.vertices) / limits.vertex_speed
        return float(max(np.max(durations), np.max(vertices)))

    def margins(self, *, straight: bool = True) -> dict[KnotPath, Array]:
        """Return initial guesses that are hitches at all knots, and their margins of distances.

        Each differs from all others, and without ``straight`` from the straight path.
        """
        first, last = self.start.polygon, self.end.polygon
        if not isinstance(first, ConvexPolygon) or not isinstance(last, ConvexPolygon):
            return {}
        named = guesses(first, last, MIN_STEPS + 1)
        line, distinct = named["straight"], dict[str, Array]()
        for name, each in reversed(named.items()):
            others = [*distinct.values()] if straight else [line, *distinct.values()]
            if not any(np.max(np.abs(each - other)) < PATH_TOLERANCE for other in others):
                distinct[name] = each
        paths = [KnotPath.through(name, self.start, self.end, p) for name, p in distinct.items()]
        paths = [path for path in paths if _is_hitch(path)]
        if not paths:
            return {}
        polygons, q_legs, rolls = (
            [getattr(path, name) for path in paths] for name in ("polygons", "q_legs", "roll")
        )
        shapes = np.concatenate(polygons), np.concatenate(q_legs), 0.0, MAX_MARGIN
        roll = None if rolls[0] is None else np.concatenate(rolls)
        requirements = replace(self.requirements, arena=None)
        task = LegTask(self.start.team, requirements, *shapes, roll=roll)
        return dict(zip(paths, task.reference_margins().reshape(len(paths), -1), strict=True))

    def solve(self) -> list[Candidate]:
        """Return the motions along feasible paths, the fastest first.

        Guesses are optimized in the order of their estimated durations; on ties, turning edges
        precede turning polygons. Optimized paths that equal earlier ones are skipped, and the
        search ends if no path can be faster by MIN_GAIN.
        """
        motion = None if self.straight is None else _judged(self.straight, self.judge)
        candidates = [] if motion is None else [Candidate("", motion)]
        fastest = math.inf if motion is None else motion.duration
        min_duration = self.min_duration
        if min_duration > (1.0 - MIN_GAIN) * fastest:
            return candidates
        # Tensions may vary on the straight path too.
        margins = self.margins(straight=motion is None or self.tension is not None)
        paths = [path for path, each in margins.items() if np.min(each) >= MIN_GUESS_MARGIN]
        if motion is None:
            paths = paths or list(margins)
        if not paths:
            return candidates
        first, last = (END_MARGIN_FACTOR * margins[paths[0]])[[0, -1]].tolist()
        paths = [path.resampled(_steps(path)) for path in paths]
        if motion is None:
            max_effort = MAX_EFFORT * max(path.size for path in paths)
        else:
            max_effort = max(MIN_EFFORT, EFFORT_PER_ROBOT * self.start.team.robots)
        estimates = np.zeros(len(paths))
        if len(paths) > 1 or candidates:
            smooth = [path.path for path in paths]
            estimates = np.array(flight_estimates(smooth, self.requirements.limits))
        order = np.argsort(estimates, kind="stable")
        for share in LEG_PERTURBATIONS:
            effort = Effort(max_effort)
            search = SearchLimits(
                self.requirements, self.judge, self.tension, (first, last), effort=effort
            )
            tried = [paths[k].with_perturbed_legs(share) for k in order]
            candidates += self._near(tried, estimates[order], search, fastest)
            if candidates:
                break
        return sorted(candidates, key=lambda candidate: candidate.motion.duration)

    def _near(
        self, tried: list[KnotPath], estimates: Array, search: SearchLimits, fastest: float
    ) -> list[Candidate]:
        """Return the motions along optimized guesses, in the order of their estimates [s].

        ``fastest`` is the duration of the straight motion [s], infinite without one.
        """
        candidates: list[Candidate] = []
        visited: list[KnotPath] = []
        for guess, estimate in zip(tried, estimates, strict=True):
            if estimate > MAX_GUESS_RATIO * fastest:
                break
            path = _optimized(guess, search, visited)
            visited.append(guess)
            if path is None:
                continue
            visited.append(path)
            if _estimate(path, self.requirements) > MAX_ESTIMATE_RATIO * fastest:
                continue
            motion = _refined(path, search)
            if motion is None:
                continue
            candidates.append(Candidate(path.name, motion))
            fastest = min(fastest, motion.duration)
            if self.min_duration > (1.0 - MIN_GAIN) * fastest:
                break
        return candidates


def guesses(first: ConvexPolygon, last: ConvexPolygon, count: int) -> dict[str, Array]:
    """Return initial guesses (count, n, 2) [m] of different homotopy classes by name.

    Straight lines need not be convex, and collapse to a point in a half turn. Edges that turn
    evenly, with the nearest lengths that close, form convex polygons; so do polygons that turn
    while their shape changes, if the shapes are similar. In a polygon that is widened halfway legs
    can pass each other.
    """
    s = np.linspace(0.0, 1.0, count)
    guesses = {"straight": _line(first.vertices, last.vertices, s)}
    middle = guesses["straight"].mean(axis=1, keepdims=True)
    scale = 1.0 + (WIDENING - 1.0) * np.sin(math.pi * s)[:, None, None]
    guesses["widened"] = middle + scale * (guesses["straight"] - middle)
    start, goal = (_directions(polygon) for polygon in (first, last))
    # The turns of edges differ by less than a full turn and are unwrapped together.
    mean = float(np.mean(goal - start))
    turn = mean - 2.0 * math.pi * math.ceil((mean - math.pi) / (2.0 * math.pi))
    other = turn - math.copysign(2.0 * math.pi, turn)
    centres = _line(first.centroid, last.centroid, s)[:, None]
    for angle in (turn, other) if abs(turn) > MIN_OTHER_TURN else (turn,):
        name = f"turned {math.degrees(angle):.0f}°"
        shape = _rotated(last.vertices - last.centroid, np.array([-angle]))[0]
        shapes = _line(first.vertices - first.centroid, shape, s)
        guesses[name] = centres + _rotated(shapes, angle * s)
        sides = _line(start, goal + angle - mean, s)[..., None]
        sides = np.concatenate([np.cos(sides), np.sin(sides)], axis=-1)
        lengths, across = _line(first.edge_lengths, last.edge_lengths, s), np.swapaxes(sides, 1, 2)
        lengths -= (sides @ np.linalg.solve(across @ sides, across @ lengths[..., None]))[..., 0]
        if np.all(lengths >= MIN_EDGE_SHARE * np.minimum(first.edge_lengths, last.edge_lengths)):
            edges = lengths[..., None] * sides
            corners = np.cumsum(edges, axis=1) - edges
            guesses[f"edges {name}"] = corners + centres - centroids(corners)[:, None]
    return guesses


def _directions(polygon: ConvexPolygon) -> Array:
    """Return the edges' directions (n,) [rad], decreasing by the exterior angles."""
    u = polygon.edge_directions[0]
    start = math.atan2(u[1], u[0])
    return start - np.append(0.0, np.cumsum(polygon.exterior_angles[1:]))


def _line(first: Array, last: Array, s: Array) -> Array:
    """Return linear interpolations at s (J,)."""
    return first + np.multiply.outer(s, last - first)


def _rotated(points: Array, angles: Array) -> Array:
    """Return points (n, 2) or (J, n, 2) rotated by angles (J,), as (J, n, 2)."""
    c, s = np.cos(angles), np.sin(angles)
    rotated: Array = points @ np.moveaxis(np.array([[c, s], [-s, c]]), -1, 0)
    return rotated


def _is_hitch(path: KnotPath) -> bool:
    """Return whether a guess is convex, with edges and slack, at all knots."""
    values = exterior_angles(path.team.layout, path.edges), length(path.edges)
    degenerate = (np.min(each) <= MIN_SHAPE_SHARE * np.min(each[[0, -1]]) for each in values)
    return bool(np.min(path.slack) > 0.0) and not any(degenerate)


def _steps(path: KnotPath) -> int:
    """Return the number of steps between knots for the longest vertex path."""
    longest = float(np.max(np.sum(length(np.diff(path.polygons, axis=0)), axis=0)))
    return int(np.clip(np.ceil(longest / KNOT_DISTANCE), MIN_STEPS, MAX_STEPS))


def _estimate(path: KnotPath, requirements: Requirements) -> float:
    """Return an estimate of the duration [s] of a flight along a path, feasible or not."""
    return flight_estimate(path.path, requirements.limits)


def _equal(path: KnotPath, other: KnotPath) -> bool:
    """Return whether two paths are equal up to PATH_TOLERANCE."""
    if path.steps != other.steps:
        other = other.resampled(path.steps)
    differences = (path.polygons - other.polygons, path.q_legs - other.q_legs)
    return max(float(np.max(np.abs(each))) for each in differences) < PATH_TOLERANCE


def _optimized(guess: KnotPath, search: SearchLimits, visited: list[KnotPath]) -> KnotPath | None:
    """Return the path of minimum energy near a guess; None if it reaches a visited path."""
    path: KnotPath | None = None
    for path in iterates(guess, search, INITIAL_STEP, MAX_INITIAL_STEPS):
        if any(_equal(path, other) for other in visited):
            return None
    return path


def _refined(path: KnotPath, search: SearchLimits) -> Motion | None:
    """Return the motion along a refined path of minimum energy, or along a faster one near it.

    Refinement enforces distances between the knots, then adds knots, up to a feasible path.
    """
    steps = path.steps
    for factor, margin in REFINEMENTS:
        path = path if factor == 1 else path.resampled(factor * steps)
        refined, step = replace(search, margin=margin), SolverStep(REFINED_STRIDE, REFINED_PARTS)
        unchanged = [path] if factor == 1 else []
        moved = iterates(path, refined, step, MAX_REFINED_STEPS, MIN_REFINED_PROGRESS)
        for path in chain(unchanged, moved):
            if _is_feasible(path, search):
                break
        else:
            continue
        choices = [(_estimate(path, search.requirements), path)]
        fastest, last = replace(step, fastest=True), math.inf
        for each in iterates(path, refined, fastest, MAX_FASTEST_STEPS, MIN_REFINED_PROGRESS):
            estimate = _estimate(each, search.requirements)
            if _is_feasible(each, search):
                choices.append((estimate, each))
            if estimate > (1.0 - MIN_STEP_GAIN) * last:
                break
            last = estimate
        _, best = min(choices, key=lambda choice: choice[0])
        for choice in dict.fromkeys([best, path]):
            motion = _judged(choice.path, search.judge)
            if motion is not None:
                return motion
    return None


def _judged(path: ShapePath, judge: Judge) -> Motion | None:
    """Return the motion along a path, or None if the judge or its timing rejects it."""
    try:
        return judge(path)
    except (InfeasibleError, TimingError):
        return None


def _is_feasible(knots: KnotPath, search: SearchLimits) -> bool:
    """Return whether a path satisfies its limits at samples, before the judge's decision."""
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
