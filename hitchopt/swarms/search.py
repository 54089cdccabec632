"""The search from one guess: a sequence of convex programs, each around the curves of the last."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import Progress
from hitchopt.planners.candidates import Effort
from hitchopt.swarms.evaluation import CurveBounds, evaluate
from hitchopt.swarms.guesses import on_routes, stuck_in_prisms
from hitchopt.swarms.program import (
    PLANE_MARGIN,
    Planes,
    moved_curves,
    planes_between,
    planes_to_prism,
)
from hitchopt.swarms.task import Setting
from hitchopt.values import Array, Indices


@dataclass(frozen=True)
class SearchTuning:
    """Numbers of the search; ``python -m benchmarks separation`` shows their effect.

    A round is a program and the evaluation of its curves; it is idle if it improves nothing.
    """

    max_programs: int = 16  # Maximum number of programs from one guess
    max_iterations: int = 1500  # Maximum iterations of OSQP in one program
    # Target duration of the next program over the current one, while the curves are clear
    speedup: float = 0.85
    # Smallest target duration over that of single flights; splines cannot be faster
    min_duration_ratio: float = 1.03
    good_ratio: float = 1.05  # Duration over that of single flights at which the search ends
    # Duration over that of single flights at which the search ends after ``max_idle_fair``
    fair_ratio: float = 1.15
    min_gain: float = 0.02  # Smallest relative improvement
    # Weight of squared changes in a program, as in Levenberg and Marquardt's method
    damping: float = 1e-4
    damping_factor: float = 10.0  # Increase of that weight after every idle round
    max_idle_fair: int = 2  # Maximum number of consecutive idle rounds with fair curves
    max_idle: int = 3  # Maximum number of consecutive idle rounds with clear curves
    max_idle_unclear: int = 6  # Maximum number of consecutive idle rounds with other curves
    max_hurried_programs: int = 10
    """Number of programs among prisms that apply the limits at once at the shortest duration, and
    not at that of the current curves, while no curves are clear."""

    max_hurried_idle: int = 4  # Maximum number of consecutive idle rounds of such programs
    # Share of the distance to a prism below which a drone counts as stuck in it
    stuck_share: float = 0.95
    max_stuck: int = 2
    """Maximum number of consecutive rounds that are idle, or too close to prisms alone, before
    drones that are stuck in prisms are put back on their routes."""

    max_resets: int = 6  # Maximum number of rounds after which drones are put back
    nearly_apart: float = 0.05
    """Shortfall of separations below which planes to prisms get the margin that curves lacked,
    after an idle round."""

    max_prism_margin: float = 0.1  # Largest such margin, over the distance
    # Separation [1] in excess of the limit up to which pairs of pieces have a plane
    plane_range: float = 1.0
    crowd_plane_range: float = 0.5  # The same in crowds
    large_crowd: int = 256
    """Smallest number of drones for which a program moves only those that are too close, and the
    search ends with the first clear curves: programs that couple all drones would need too much
    time."""

    # Separation [1] in excess of the limit below which such drones are too close
    close_range: float = 0.1


IN_FREE_SPACE = SearchTuning()  # Numbers of the search without prisms

AMONG_PRISMS = SearchTuning(max_programs=24, max_iterations=400)
"""Numbers of the search among prisms, whose planes change more from one program to the next."""


class Guess(NamedTuple):
    """Curves from which a search starts."""

    setting: Setting  # The task on the time grid of the curves
    coefficients: Array  # (N, count, 3) [m]
    rule: str  # Which drones give way to others; empty for direct routes


def improved(guess: Guess, report: Progress, effort: Effort) -> CurveBounds:
    """Return the best curves that programs reach from a guess; they spend effort."""
    start = evaluate(guess.setting, guess.coefficients)
    return CurveSearch(guess.setting, current=start, best=start).run(report, effort)


def is_good(setting: Setting, duration: float) -> bool:
    """Return whether a duration [s] is the prescribed one, or near that of single flights."""
    return duration <= (setting.task.duration or IN_FREE_SPACE.good_ratio * setting.single_duration)


NO_SIDES = np.zeros((0, 3), dtype=np.intp)  # Sides of no pairs


@dataclass(eq=False)
class CurveSearch:
    """The state of a search."""

    setting: Setting  # The task on the time grid of the curves
    current: CurveBounds  # Curves of the last program
    best: CurveBounds  # Best curves so far
    # (pairs, 3): sides of drones on which the last program had planes
    required_sides: Indices = field(default_factory=lambda: NO_SIDES)
    prism_margin: float = 0.0  # Margin of planes to prisms, over the distance
    idle: int = 0  # Consecutive idle rounds
    stuck: int = 0  # Consecutive rounds that are idle, or too close to prisms alone
    resets: int = 0  # Rounds after which drones were put back on their routes
    # Whether all programs so far applied the limits at the shortest duration
    was_hurried: bool = True

    @property
    def among_prisms(self) -> bool:
        """Whether there are prisms."""
        return bool(self.setting.task.requirements.keep_out)

    @property
    def tuning(self) -> SearchTuning:
        """Numbers of the search."""
        return AMONG_PRISMS if self.among_prisms else IN_FREE_SPACE

    def run(self, report: Progress, effort: Effort) -> CurveBounds:
        """Return the best curves of all rounds."""
        setting, tuning = self.setting, self.tuning
        drones = setting.task.drones
        for round_ in range(tuning.max_programs):
            if self.best.clear and drones >= tuning.large_crowd:
                break
            effort.spend(drones * setting.grid.pieces)
            planes, moving = self._planes()
            self.required_sides = planes.sides[planes.sides[:, 2] >= 0]  # between drones
            duration = self._program_duration(round_)  # may reset the idle rounds
            damping = tuning.damping * tuning.damping_factor**self.idle
            current = self.current.coefficients
            moved = moved_curves(
                setting, current, duration, planes, moving, damping, tuning.max_iterations
            )
            if moved is None:
                break
            self.current = evaluate(setting, moved)
            duration, closest = self.current.duration, self.current.closest
            report(f"round {round_ + 1}: {duration:.3g} s, separation {closest:.3f}")
            self._compare()
            self._put_back_stuck()
            if self._ends:
                break
        return self.best

    def _program_duration(self, round_: int) -> float:
        """Return the duration [s] at which the next program applies the limits.

        Among prisms it is the shortest one at first, until that stops to improve the curves, and
        again once curves are clear.
        """
        setting, tuning = self.setting, self.tuning
        shortest = setting.task.duration or tuning.min_duration_ratio * setting.single_duration
        if self.among_prisms:
            if self.was_hurried and not self.best.clear:
                self.was_hurried = (
                    self.idle < tuning.max_hurried_idle and round_ < tuning.max_hurried_programs
                )
                self.idle = self.idle if self.was_hurried else 0
            if self.was_hurried or (self.best.clear and not self.idle):
                return shortest
        factor = tuning.speedup if self.current.clear else 1.0
        return max(factor * self.current.duration, shortest)

    def _compare(self) -> None:
        """Compare the current curves with the best ones, which they may replace."""
        tuning, current = self.tuning, self.current
        is_better = current.merit < (1.0 - tuning.min_gain) * self.best.merit
        self.idle = 0 if is_better else self.idle + 1
        if current.merit < self.best.merit:
            self.best = current
        if self.best.clear:
            self.prism_margin = 0.0
        elif self.idle and current.closest >= 1.0 - tuning.nearly_apart:
            lacking = self.prism_margin + 1.0 - current.to_prisms
            self.prism_margin = min(lacking, tuning.max_prism_margin)

    def _put_back_stuck(self) -> None:
        """Put drones that are stuck in prisms back on their routes, if nothing else helps."""
        tuning, current = self.tuning, self.current
        is_stuck = not current.clear and (current.closest >= 1.0 or self.idle > 0)
        self.stuck = self.stuck + 1 if is_stuck else 0
        if self.stuck < tuning.max_stuck or self.resets >= tuning.max_resets:
            return
        stuck = stuck_in_prisms(self.setting, current.coefficients, tuning.stuck_share)
        if np.any(stuck) and not np.all(stuck):
            put_back = on_routes(self.setting, current.coefficients, stuck)
            self.current = evaluate(self.setting, put_back)
            self.required_sides = NO_SIDES
            self.idle = self.stuck = 0
            self.resets += 1

    @property
    def _ends(self) -> bool:
        """Whether the best curves suffice, or too many rounds have not improved them."""
        setting, tuning, best = self.setting, self.tuning, self.best
        if not best.clear:
            return self.idle >= tuning.max_idle_unclear
        fair_duration = setting.task.duration or tuning.fair_ratio * setting.single_duration
        is_fair = best.duration <= fair_duration and self.current.clear
        return (
            is_good(setting, best.duration)
            or (is_fair and self.idle >= tuning.max_idle_fair)
            or self.idle >= tuning.max_idle
        )

    def _planes(self) -> tuple[Planes, NDArray[np.bool_]]:
        """Return the planes of the next program, and the mask (N,) of drones that move.

        In a large crowd only drones move that are too close to others, as long as there are any.
        """
        task, tuning, current = self.setting.task, self.tuning, self.current
        separation = task.requirements.separation
        pieces = self.setting.grid.pieces_of(current.coefficients)
        is_crowd = task.drones >= tuning.large_crowd and not current.clear
        plane_range = tuning.crowd_plane_range if is_crowd else tuning.plane_range
        cutoff = 1.0 + PLANE_MARGIN + plane_range
        planes = planes_between(pieces, separation, cutoff, self.required_sides)
        moving = np.ones(task.drones, dtype=np.bool_)
        close = np.min(planes.gaps, axis=1) < 1.0 + PLANE_MARGIN + tuning.close_range
        if is_crowd and np.any(close):
            moving[:] = False
            moving[planes.sides[close, 1:]] = True
        distance = separation.radius + 2.0 * self.setting.trust
        arena = task.requirements.arena
        planes_to_prisms = [
            planes_to_prism(pieces, prism, separation.radius, distance, arena)
            for prism in task.requirements.keep_out
        ]
        widened = [part.with_margin(self.prism_margin) for part in planes_to_prisms]
        fields = zip(planes, *widened, strict=True)
        return Planes(*map(np.concatenate, fields)), moving
