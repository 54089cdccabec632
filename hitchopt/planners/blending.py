"""Flights through the hitches of several steps, without a stop in between."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np

from hitchopt.errors import InfeasibleError, Violation
from hitchopt.hitch import Hitch
from hitchopt.motion.motion import Phase
from hitchopt.planners.along import past_obstacles
from hitchopt.planners.candidates import Candidate, first_certified
from hitchopt.planners.morph.legs import largest_roll, rolling_paths
from hitchopt.planners.morph.morph import BlendedMorph, check_distances
from hitchopt.planners.path import Path
from hitchopt.planners.task import StepPlan, StepTask, require_certified
from hitchopt.planners.timing.timed_motion import motion_in_parts

BLEND_SHAPES = (0, 2, 6, 14)
"""Numbers of shapes of each step's own route through which a flight without stops is led."""

ROLLING_SHAPES = 2  # Such a number where legs roll
MAX_ROLLING = 2  # Maximum number of paths with legs that roll that are timed, the fastest first
TIME_TOLERANCE = 1e-6  # [s] Difference of durations below which they are equal


class PassedStep(NamedTuple):
    """A step of a flight without a stop."""

    name: str  # Name of its phase
    # Returns hitches that the flight passes in the step: about a number of them, and the end
    hitches: Callable[[int], list[Hitch]]
    duration: float | None  # Least duration of its share of the flight [s], or None
    stopping: StepPlan | None  # Its certified plan from rest to rest; None if there is none


@dataclass(frozen=True, eq=False)
class BlendedSteps:
    """Steps that are flown without a stop in between.

    One path leads through the hitches of all of them and is timed as a whole; the phase of each
    step, with its name, ends as the path passes its last hitch, and is no shorter than the step's
    duration. Where the path through the ends of the steps is infeasible, others lead through shapes
    of the routes on which the steps stop; then legs roll on such a path. A flight that is not
    faster than the steps with stops is infeasible.
    """

    task: StepTask  # The task of the first step
    steps: Sequence[PassedStep]  # The steps
    free_legs: bool = False  # Whether the hitches between the steps may have other legs and roll

    def plan(self) -> StepPlan:
        """Return the first certified plan."""
        self._check_duration(sum(step.duration or 0.0 for step in self.steps))
        return first_certified(self.candidates(), self.task.effort, self.task.progress)

    def candidates(self) -> Iterator[Candidate[StepPlan]]:
        """Yield the paths."""
        for count in BLEND_SHAPES:
            yield Candidate("blended path", partial(self._through_shapes, count))
        if self.free_legs:
            yield Candidate("rolling path", self._with_rolling_legs)

    def _check_duration(self, duration: float) -> None:
        """Raise InfeasibleError if a flight's duration [s] is not below that with stops."""
        stopping = [step.stopping for step in self.steps if step.stopping is not None]
        if len(stopping) < len(self.steps):
            return
        with_stops = sum(plan.motion.duration for plan in stopping)
        if duration >= with_stops - TIME_TOLERANCE:
            remedy = "stop between the steps"
            raise InfeasibleError(
                [Violation("duration", duration, with_stops, "max", "s", (), "", remedy)]
            )

    def _through_shapes(self, count: int) -> StepPlan:
        """Return the certified plan through a number of shapes of each route, and its end."""
        morph = self._morph(count)
        along = partial(self._along, morph)
        return past_obstacles(self.task, along(morph.path), morph.path, along)

    def _with_rolling_legs(self) -> StepPlan:
        """Return the certified plan along a path on which legs roll."""
        morph = self._morph(ROLLING_SHAPES)

        def rolling(path: Path) -> StepPlan:
            """Return the certified plan along a path with legs that roll."""
            roll = math.degrees(largest_roll(path))
            plan = require_certified(self._along(morph, path))
            return plan.with_remark(f"legs roll by up to {roll:.0f}° on the way")

        paths = rolling_paths(morph.path, self.task.requirements)[:MAX_ROLLING] or [morph.path]
        candidates = [Candidate("rolling path", partial(rolling, path)) for path in paths]
        return first_certified(candidates, self.task.effort, self.task.progress)

    def _morph(self, count: int) -> BlendedMorph:
        """Return the planner of the path through a number of shapes of each route, and its end."""
        passed = [step.hitches(count) for step in self.steps]
        return BlendedMorph(self.task.hitch, passed, self.task.requirements)

    def _along(self, morph: BlendedMorph, path: Path) -> StepPlan:
        """Return the plan along a path on which steps end as on that of a planner."""
        task = self.task
        check_distances(path, task.requirements)
        durations = np.array([step.duration or 0.0 for step in self.steps])
        motion, times = motion_in_parts(
            path, task.requirements, morph.ends, durations, self._check_duration
        )
        phased = motion.replaced(phases=self._phases(times.tolist()))
        return task.plan_ending(phased, morph.hitches[-1])

    def _phases(self, times: Sequence[float]) -> tuple[Phase, ...]:
        """Return the phases of the steps, which begin and end at times (steps + 1,) [s]."""
        remarks = ["continues without a stop"] * (len(self.steps) - 1) + [""]
        return tuple(
            Phase(step.name, self.task.index + j, times[j], times[j + 1], remarks[j])
            for j, step in enumerate(self.steps)
        )


def hitches_along(path: Path, count: int) -> list[Hitch]:
    """Return hitches at ``count`` evenly spaced points within a path at one altitude."""
    s = np.arange(1, count + 1) / (count + 1)
    shapes = path.shapes(s)
    altitudes = path.vertices.at(s)[:, 0, 2].tolist()
    rolls = np.zeros(count) if shapes.roll is None else shapes.roll
    return [
        Hitch(path.team, polygon, altitude, legs[:, 0], roll)
        for polygon, altitude, legs, roll in zip(
            shapes.polygons, altitudes, shapes.legs, rolls, strict=True
        )
    ]
