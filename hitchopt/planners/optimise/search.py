"""The search for paths of a morph: guesses are optimised and refined one by one.

A guess is first moved to a path of minimum energy that keeps distances at its knots, then refined
until it is feasible between them too, and shortened as far as it stays feasible. If no guess leads
to a motion, guesses follow whose legs roll between the ends.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import partial
from typing import NamedTuple

import numpy as np

from hitchopt.geometry.vectors import length
from hitchopt.hitch import Hitch
from hitchopt.hitch.forces import if_balanced
from hitchopt.hitch.requirements import Limits, Requirements
from hitchopt.motion.motion import Motion
from hitchopt.planners.candidates import Effort
from hitchopt.planners.morph.legs import legs_clear, with_legs_clear
from hitchopt.planners.morph.morph import load_violation, shape_violation
from hitchopt.planners.optimise.cost import FlightCost
from hitchopt.planners.optimise.guesses import (
    STRAIGHT,
    WIDENED,
    distance_margins,
    is_hitch,
    polygon_guesses,
    rolled_guesses,
)
from hitchopt.planners.optimise.knots import Judge, KnotPath, SearchLimits, SolverStep
from hitchopt.planners.optimise.program import iterates
from hitchopt.planners.path import Path
from hitchopt.planners.timing.profile import (
    LIMIT_SHARE,
    demands_along,
    flight_estimate,
    flight_estimates,
    rest_ratios,
)
from hitchopt.planners.timing.ramps import fastest_ramps
from hitchopt.values import Array


class Refinement(NamedTuple):
    """A round of refinement."""

    steps_factor: int  # Number of steps between knots, over that of the path of minimum energy
    margin: float  # Enforced distances over their limits


REFINEMENTS = (
    Refinement(steps_factor=1, margin=1.03),
    Refinement(steps_factor=2, margin=1.05),
)
"""Rounds of refinement until the judge accepts a path."""


@dataclass(frozen=True)
class SearchTuning:
    """Numbers of the search; ``python -m benchmarks morphs`` shows their effect."""

    # Number of parts of every step, at whose ends refinement enforces distances
    refined_parts: int = 8
    refined_stride: float = 0.12  # [m] Stride of the optimiser in refinement
    min_stride: float = 0.02  # [m] Stride below which a feasible path is not shortened further
    max_initial_steps: int = 12  # Maximum number of steps from a guess
    # Maximum number of steps to a feasible path in a round of refinement
    max_refined_steps: int = 5
    hopeful_margin: float = 0.8
    """Margin of distances below which refinement goes on only while every step gains enough. Of 13
    pairs all refinements that succeeded had more after the second step, or gained 0.2 a step."""

    # Smallest gain of margin in a step with which such a refinement goes on
    min_margin_gain: float = 0.03
    max_fastest_steps: int = 12  # Maximum number of steps from a feasible path to faster ones
    # Maximum number of steps from a feasible path to better ones by a custom cost
    max_cost_steps: int = 36
    max_judged: int = 4
    """Maximum number of faster paths that are judged. They are feasible at samples, but distances
    between samples may fall short by a thousandth."""

    leg_perturbation: float = 0.05
    """Largest change of q-legs in guesses, over the shorter leg of their cable. Without changes all
    robots of regular polygons move alike up to saddle points, since all rows are linear."""

    # Smallest motion of vertices in a step over its stride, below which refinement ends
    min_refined_progress: float = 0.05
    knot_distance: float = 0.9
    """[m] Largest length of a vertex's path between two knots, within the bounds of their number.
    """

    min_steps: int = 8  # Minimum number of steps between the knots of a guess
    max_steps: int = 16  # Maximum number of steps between the knots of a guess
    max_guess_ratio: float = 1.3
    """Largest estimated duration of a guess that is optimised, over that of the fastest motion so
    far."""

    max_estimate_ratio: float = 1.1
    """Largest estimated duration of an optimised path that is refined, over that of the fastest
    motion so far."""

    min_gain: float = 0.01
    """Smallest gain over the fastest path so far, as a fraction of its duration, for which guesses
    are tried."""

    max_effort: float = 240.0
    """Limit of the effort if the straight path is infeasible, per robot and inner knot of the
    largest guess. Successful searches of 3 to 12 robots took up to 170."""

    # Smallest limit of the effort if the straight path is feasible: about 2 s
    min_effort: float = 2e4
    effort_per_robot: float = 300.0
    """Limit of the effort per robot if the straight path is feasible, if that is more: about ten
    times that of planning this path."""

    min_step_gain: float = 5e-4
    """Smallest gain of a step toward a faster path, as a share of its duration, below which no
    further one is tried."""

    min_guess_margin: float = 0.3  # Smallest margin of distances of a promising guess
    max_rolled: int = 8  # Maximum number of guesses with roll that are tried
    max_rolled_effort: float = 2.0
    """Maximum effort of these guesses together, over that of one, beyond which no further one is
    tried."""

    legs_effort_per_robot: float = 200.0
    """Effort per robot to find leg lengths along a guess and to judge it, which counts for the
    plan."""

    # Factor on the margins of the ends, which they then satisfy despite rounding
    end_margin_factor: float = 1.0 - 1e-4
    path_tolerance: float = 0.05  # [m] Difference at every knot below which paths are equal


TUNING = SearchTuning()

INITIAL_STEP = SolverStep(stride=0.17)  # Step of the optimiser from a guess


def min_duration(start: Hitch, end: Hitch, limits: Limits) -> float:
    """Return a lower bound of a morph's duration [s]: that of each drone and vertex on a line."""
    drone_distances = length(end.drones - start.drones)
    drone_durations, _ = fastest_ramps(
        drone_distances, limits.speed, limits.acceleration, limits.jerk
    )
    vertex_durations = length(end.vertices - start.vertices) / limits.vertex_speed
    return float(max(np.max(drone_durations), np.max(vertex_durations)))


@dataclass(frozen=True, eq=False)
class Route:
    """A motion that the judge accepted."""

    name: str  # Name of its initial guess; empty for the straight path
    motion: Motion  # The motion along its path
    cost: float = 0.0  # [s] Estimate of the integral of a custom cost over its flight

    @property
    def objective(self) -> float:
        """Duration and cost [s], which the best route minimises."""
        return self.motion.duration + self.cost


class Routes(NamedTuple):
    """What a search found."""

    # Motions along feasible paths, the fastest first, or the cheapest with a cost
    accepted: list[Route]
    # The path with the largest margin of distances, if none was accepted and some were tried
    rejected: KnotPath | None


@dataclass(frozen=True, eq=False)
class OptimisedMorph:
    """A planner of morphs along optimised paths; those of chains are guesses as they are.

    If the straight path is feasible, it is the first route, and the search is limited to what
    can be faster.
    """

    start: Hitch  # Hitch at one altitude that satisfies all limits
    end: Hitch  # Hitch at the same altitude that satisfies all limits
    requirements: Requirements  # Limits, separation and arena
    judge: Judge  # Accepts or rejects paths; rejected ones are refined
    # [N] Smallest and largest one of variable tensions, or None
    tension: tuple[float, float] | None = None
    straight: Path | None = None  # Path with straight vertices; None if it is infeasible
    # Custom cost; with one all guesses are optimised, regardless of their durations
    cost: FlightCost | None = None
    # Effort of the plan of which the search is a part
    effort: Effort = field(default_factory=Effort)

    @property
    def min_duration(self) -> float:
        """Lower bound of the duration [s]."""
        return min_duration(self.start, self.end, self.requirements.limits)

    def solve(self) -> Routes:
        """Return the motions along feasible paths.

        Guesses are optimised in the order of their estimated durations; on ties, turning edges
        precede turning polygons. Optimised paths that equal earlier ones are skipped, and the
        search ends if no path can be faster by ``min_gain``.
        """
        routes = list[Route]()
        straight_motion = None if self.straight is None else self.judge(self.straight)
        if self.straight is not None and straight_motion is not None:
            cost = self._cost_of(self.straight, straight_motion)
            routes.append(Route("", straight_motion, cost))
        rejected: list[KnotPath] = []
        if self.start.team.layout.closed:
            routes += self._optimised(straight_motion, rejected)
        if not routes:
            routes += self._rolled(rejected)
        if not routes and rejected:
            margins = [_worst_margin(path, self.requirements) for path in rejected]
            return Routes([], rejected[int(np.argmax(margins))])
        return Routes(sorted(routes, key=lambda route: route.objective), None)

    def _cost_of(self, path: Path, motion: Motion) -> float:
        """Return an estimate of the cost of a motion [s]; 0 without a cost."""
        return 0.0 if self.cost is None else self.cost.at_rest(path, motion.duration)

    def _optimised(self, straight_motion: Motion | None, rejected: list[KnotPath]) -> list[Route]:
        """Return the motions along optimised guesses that may be faster than the straight one."""
        fastest = math.inf if straight_motion is None else straight_motion.duration
        if self.cost is None and self.min_duration > (1.0 - TUNING.min_gain) * fastest:
            return []
        # Tensions may vary on the straight path too, and a cost may bend it.
        can_improve_straight = self.tension is not None or self.cost is not None
        margins = self._guess_margins(with_straight=straight_motion is None or can_improve_straight)
        paths = [path for path in margins if _is_promising(margins[path])]
        if not paths and straight_motion is None:
            paths = list(margins)
        if not paths:
            return []
        paths = [path.resampled(_steps(path)) for path in paths]
        estimates = np.zeros(len(paths))
        if len(paths) > 1 or straight_motion is not None:
            smooth_paths = [path.path for path in paths]
            estimates = np.array(flight_estimates(smooth_paths, self.requirements.limits))
        order = np.argsort(estimates, kind="stable")
        guesses = [paths[index].with_perturbed_legs(TUNING.leg_perturbation) for index in order]
        max_effort = self._max_effort(paths, has_motion=straight_motion is not None)
        search = self._search_limits(max_effort, rejected)
        return self._routes_near(guesses, estimates[order], search, fastest)

    def _guess_margins(self, *, with_straight: bool) -> dict[KnotPath, Array]:
        """Return initial guesses that are hitches at all knots, and their margins of distances.

        Guesses differ from each other, and without ``with_straight`` from the straight path.
        """
        polygons_by_name = polygon_guesses(
            self.start.polygon, self.end.polygon, TUNING.min_steps + 1
        )
        excluded = [] if with_straight else [polygons_by_name[STRAIGHT]]
        guesses: list[KnotPath] = []
        for name, polygons in reversed(polygons_by_name.items()):  # those on turning edges first
            if any(_coincide(polygons, others) for others in excluded):
                continue
            excluded.append(polygons)
            guesses.append(KnotPath.through(name, self.start, self.end, polygons))
        paths = [path for path in guesses if is_hitch(path)]
        if not paths:
            return {}
        margins = dict(zip(paths, distance_margins(paths, self.requirements), strict=True))
        # Legs that pass each other on straight lines need no widened ones.
        legs_pass = not with_straight or any(
            path.name == STRAIGHT and _is_promising(margins[path]) for path in paths
        )
        if legs_pass:
            return {path: margins[path] for path in paths if path.name != WIDENED}
        return margins

    def _max_effort(self, paths: list[KnotPath], *, has_motion: bool) -> float:
        """Return the limit of the effort to optimise paths.

        Parameters
        ----------
        has_motion: whether there is a motion along the straight path.
        """
        most_robot_knots = max(path.robot_knots for path in paths)
        if self.cost is not None:
            return TUNING.max_effort * most_robot_knots * len(paths)  # all of them are optimised
        if not has_motion:
            return TUNING.max_effort * most_robot_knots
        return max(TUNING.min_effort, TUNING.effort_per_robot * self.start.team.robots)

    def _search_limits(self, max_effort: float, rejected: list[KnotPath]) -> SearchLimits:
        """Return the constraints of a search with a limit of its effort."""
        end_polygons = np.stack([self.start.polygon.vertices, self.end.polygon.vertices])
        ends = KnotPath.through("", self.start, self.end, end_polygons)
        margins = TUNING.end_margin_factor * distance_margins([ends], self.requirements)[0]
        first_margin, last_margin = margins.tolist()
        return SearchLimits(
            self.requirements,
            self.judge,
            self.tension,
            end_margins=(first_margin, last_margin),
            effort=Effort(max_effort, whole=self.effort),
            rejected=rejected,
            cost=self.cost,
        )

    def _routes_near(
        self, guesses: list[KnotPath], estimates: Array, search: SearchLimits, fastest: float
    ) -> list[Route]:
        """Return the motions along optimised guesses, in the order of their estimates [s].

        ``fastest`` is the duration of the straight motion [s], infinite without one.
        """
        routes: list[Route] = []
        visited: list[KnotPath] = []
        last_estimate = math.inf  # of the last optimised path with a motion [s]
        only_time = self.cost is None
        for guess, guess_estimate in zip(guesses, estimates, strict=True):
            if only_time and guess_estimate > TUNING.max_guess_ratio * fastest:
                break
            path = _optimised_path(guess, search, visited)
            visited.append(guess)
            if path is None:
                continue
            visited.append(path)
            estimate = _estimate(path, self.requirements)
            max_estimate = min(
                TUNING.max_estimate_ratio * fastest, (1.0 - TUNING.min_gain) * last_estimate
            )
            if only_time and estimate > max_estimate:
                continue
            route = _refined(path, search)
            if route is None:
                continue
            routes.append(route)
            last_estimate = estimate
            fastest = min(fastest, route.motion.duration)
            if only_time and self.min_duration > (1.0 - TUNING.min_gain) * fastest:
                break
        return routes

    def _rolled(self, rejected: list[KnotPath]) -> list[Route]:
        """Return the motion along the first feasible guess with roll, optimised or as it is."""
        guesses = rolled_guesses(self.start, self.end, self.requirements)[: TUNING.max_rolled]
        unoptimised: list[Route] = []
        spent = 0.0
        for guess in guesses:
            max_effort = TUNING.max_effort * guess.robot_knots
            if spent > TUNING.max_rolled_effort * max_effort:
                break
            search = self._search_limits(max_effort, rejected)
            if self.start.team.layout.closed:
                perturbed = guess.with_perturbed_legs(TUNING.leg_perturbation)
                path = _optimised_path(perturbed, search, visited=[])
                route = None if path is None else _refined(path, search)
                if route is not None:
                    return [route]
                spent += search.effort.spent
            if not unoptimised:
                # As it is, with leg lengths that keep distances
                self.effort.spend(TUNING.legs_effort_per_robot * guess.team.robots)
                clear = if_balanced(partial(self._clear_path, guess.path), None)
                motion = None if clear is None else self.judge(clear)
                if motion is None:
                    rejected.append(guess)
                else:
                    unoptimised = [Route(guess.name, motion, self._cost_of(guess.path, motion))]
        return unoptimised

    def _clear_path(self, path: Path) -> Path | None:
        """Return a path with leg lengths that keep distances; None if it breaks a limit."""
        if shape_violation(path) is not None:
            return None
        clear = with_legs_clear(path, self.requirements)
        if load_violation(clear, self.requirements.limits) is not None:
            return None
        return clear if legs_clear(clear, self.requirements) else None


def _is_promising(margins: Array) -> bool:
    """Return whether a guess with margins (J + 1,) of distances is optimised before others."""
    return bool(np.min(margins) >= TUNING.min_guess_margin)


def _steps(path: KnotPath) -> int:
    """Return the number of steps between knots for the longest vertex path."""
    longest = float(np.max(np.sum(length(np.diff(path.polygons, axis=0)), axis=0)))
    return int(np.clip(np.ceil(longest / TUNING.knot_distance), TUNING.min_steps, TUNING.max_steps))


def _estimate(path: KnotPath, requirements: Requirements) -> float:
    """Return an estimate of the duration [s] of a flight along a path, feasible or not."""
    return flight_estimate(path.path, requirements.limits)


def _objective(path: KnotPath, search: SearchLimits) -> float:
    """Return an estimate of the duration [s] plus the custom cost, if any [s]."""
    duration = _estimate(path, search.requirements)
    return duration + search.cost_of(path.path, duration)


def _equal(path: KnotPath, other: KnotPath) -> bool:
    """Return whether two paths are equal up to ``path_tolerance``."""
    if path.steps != other.steps:
        other = other.resampled(path.steps)
    return _coincide(path.polygons, other.polygons) and _coincide(path.q_legs, other.q_legs)


def _coincide(values: Array, others: Array) -> bool:
    """Return whether coordinates or lengths [m] are equal up to ``path_tolerance``."""
    return bool(np.max(np.abs(values - others)) < TUNING.path_tolerance)


def _optimised_path(
    guess: KnotPath, search: SearchLimits, visited: list[KnotPath]
) -> KnotPath | None:
    """Return the path of minimum energy near a guess; None if it reaches a visited path."""
    path: KnotPath | None = None
    for iterate in iterates(guess, search, INITIAL_STEP, TUNING.max_initial_steps):
        if any(_equal(iterate, other) for other in visited):
            return None
        path = iterate
    return path


def _refined(path: KnotPath, search: SearchLimits) -> Route | None:
    """Return the motion along a refined path of minimum energy, or along a better one near it.

    Refinement enforces distances between the knots, then adds knots, up to a feasible path. With a
    cost, further knots then improve this path.
    """
    initial_steps = path.steps
    best: Route | None = None
    for refinement in REFINEMENTS:
        tight = replace(search, margin=refinement.margin)
        adds_knots = refinement.steps_factor > 1
        if adds_knots:
            path = path.resampled(refinement.steps_factor * initial_steps)
        if (adds_knots and search.cost is None) or not _is_feasible(path, search):
            path, feasible = _feasible_near(path, tight)
            if not feasible:
                if _worst_margin(path, search.requirements) < TUNING.hopeful_margin:
                    break
                continue
        better_paths = _better_paths(path, tight)
        accepted = _last_accepted([path, *better_paths[-TUNING.max_judged :]], search)
        if accepted is None:
            continue
        accepted_path, route = accepted
        if search.cost is None:
            return route
        if best is None or route.objective < best.objective:
            best = route
            path = accepted_path
    if best is None:
        search.rejected.append(path)
    return best


def _feasible_near(path: KnotPath, search: SearchLimits) -> tuple[KnotPath, bool]:
    """Return the first feasible path on the way to minimum energy, or the last one and False."""
    step = SolverStep(TUNING.refined_stride, TUNING.refined_parts)
    last_path = path
    last_margin = -math.inf
    for iterate in iterates(
        path, search, step, TUNING.max_refined_steps, TUNING.min_refined_progress
    ):
        if _is_feasible(iterate, search):
            return iterate, True
        last_path = iterate
        margin = _worst_margin(iterate, search.requirements)
        sufficient = min(TUNING.hopeful_margin, last_margin + TUNING.min_margin_gain)
        if margin < sufficient:  # low, and hardly larger than the last one
            break
        last_margin = margin
    return last_path, False


def _better_paths(path: KnotPath, search: SearchLimits) -> list[KnotPath]:
    """Return the feasible paths of repeated steps from a feasible one, each better than the last.

    A path is better if it takes less time, with a cost less time and cost together.
    Steps go on from infeasible paths too, whose distances the next step restores. When they gain no
    more, they start again from the best feasible path with half the stride.
    """
    max_programs = TUNING.max_fastest_steps if search.cost is None else TUNING.max_cost_steps
    step = SolverStep(TUNING.refined_stride, TUNING.refined_parts, fastest=True)
    best = path
    best_objective = _objective(path, search)
    better = list[KnotPath]()
    programs = 0
    while step.stride >= TUNING.min_stride:
        better_but_infeasible = False
        last_objective = math.inf
        for iterate in iterates(best, search, step, max_programs, TUNING.min_refined_progress):
            programs += 1
            objective = _objective(iterate, search)
            if objective < best_objective:
                feasible = _is_feasible(iterate, search)
                better_but_infeasible = not feasible
                if feasible:
                    best = iterate
                    best_objective = objective
                    better.append(iterate)
            min_gain = TUNING.min_step_gain * abs(last_objective)
            if objective > last_objective - min_gain or programs >= max_programs:
                break
            last_objective = objective
        # Steps may pass the minimum of a cost: shorter ones follow.
        can_improve = better_but_infeasible or search.cost is not None
        if programs >= max_programs or not can_improve:
            break
        step = replace(step, stride=0.5 * step.stride)
    return better


def _last_accepted(paths: list[KnotPath], search: SearchLimits) -> tuple[KnotPath, Route] | None:
    """Return the last of several paths that the judge accepts, and its motion; None without one."""
    for path in reversed(paths):
        motion = search.judge(path.path)
        if motion is not None:
            return path, Route(path.name, motion, search.cost_of(path.path, motion.duration))
    return None


def _worst_margin(path: KnotPath, requirements: Requirements) -> float:
    """Return the smallest margin of distances at the knots and between them."""
    refined = path.resampled(TUNING.refined_parts * path.steps)
    return float(np.min(distance_margins([refined], requirements)))


def _is_feasible(knots: KnotPath, search: SearchLimits) -> bool:
    """Return whether a path satisfies its limits at samples, before the judge's decision."""
    path = knots.path
    requirements = search.requirements
    if shape_violation(path) is not None or not legs_clear(path, requirements):
        return False
    demands = demands_along(path, requirements.limits)
    if np.max(rest_ratios(path.team, requirements.limits, demands.loads)) >= LIMIT_SHARE:
        return False
    arena = requirements.arena
    if arena is None:
        return True
    drones = demands.drones[..., 0]
    return bool(np.all((drones >= arena.lower) & (drones <= arena.upper)))
