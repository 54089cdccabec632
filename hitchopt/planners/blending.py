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
from hitchopt.planners.along import MAX_ROLLING, past_obstacles
from hitchopt.planners.candidates import Candidate, first_certified
from hitchopt.planners.compensation import with_friction_feedforward
from hitchopt.planners.morph.legs import largest_roll, rolling_paths
from hitchopt.planners.morph.morph import BlendedMorph
from hitchopt.planners.path import Path
from hitchopt.planners.task import StepPlan, StepTask, require_certified

MAX_ROLLING_RATIO = 1.05
"""Largest duration of blended steps whose legs roll, over that of the steps with stops."""

BLEND_SHAPES = (2, 6, 14)
"""Numbers of shapes of each step's own route through which a flight without stops is led."""


class PassedStep(NamedTuple):
    """A step of a flight without a stop."""

    name: str  # Name of its phase
    # Returns hitches that the flight passes in the step: about a number of them, and the end
    hitches: Callable[[int], list[Hitch]]
    duration: float | None  # Least duration of its share of the flight [s], or None


@dataclass(frozen=True, eq=False)
class BlendedSteps:
    """Steps that are flown without a stop in between.

    One path leads through the hitches of all of them and is timed as a whole; the phase of each
    step, with its name, ends as the path passes its last hitch. The whole flight is slowed down
    until no step is shorter than its duration. Where that path is infeasible, others lead through
    shapes of the routes on which the steps stop; then legs roll on these paths.
    """

    task: StepTask  # The task of the first step
    steps: Sequence[PassedStep]  # The steps
    # Returns the certified plans of the steps that stop, or raises InfeasibleError
    stopped: Callable[[], Sequence[StepPlan]]
    free_legs: bool = False  # Whether the hitches between the steps may have other legs and roll

    def plan(self) -> StepPlan:
        """Return the first certified plan."""
        return first_certified(self.candidates(), self.task.effort, self.task.progress)

    def candidates(self) -> Iterator[Candidate[StepPlan]]:
        """Yield the paths; raise InfeasibleError if a step that stops is infeasible itself."""
        ends = [step.hitches(0) for step in self.steps]
        yield Candidate("path through the ends", partial(self._through, ends))
        routes = self.stopped()
        for rolls in (False, True) if self.free_legs else (False,):
            for count in BLEND_SHAPES:
                yield Candidate(
                    "blended path", partial(self._through_shapes, routes, count, rolls=rolls)
                )

    def _through_shapes(self, routes: Sequence[StepPlan], count: int, *, rolls: bool) -> StepPlan:
        """Return the plan through a number of shapes of each route, and its end."""
        hitches = list[list[Hitch]]()
        for step, route in zip(self.steps, routes, strict=True):
            if route.path is None:
                hitches.append(step.hitches(count))
            else:
                hitches.append([*hitches_along(route.path, count), route.after.tied])
        plan = self._through(hitches, rolls=rolls)
        longest = MAX_ROLLING_RATIO * sum(route.motion.duration for route in routes)
        duration = plan.motion.duration
        if rolls and duration > longest:
            remedy = "stop between the steps"
            raise InfeasibleError(
                [Violation("duration", duration, longest, "max", "s", (), "", remedy)]
            )
        return plan

    def _through(self, hitches: Sequence[Sequence[Hitch]], *, rolls: bool = False) -> StepPlan:
        """Return the certified plan through the hitches of each step, the last one its end."""
        requirements = self.task.requirements
        passed = [hitch for of_step in hitches for hitch in of_step]
        morph = BlendedMorph([self.task.hitch, *passed], requirements)
        last = np.cumsum([len(of_step) for of_step in hitches])[:-1] - 1

        def along(path: Path) -> StepPlan:
            """Return the plan along a path."""
            motion, times_within = morph.timed(path)
            phases = self._phases([0.0, *times_within[last].tolist(), motion.duration])
            durations = np.array([step.duration or 0.0 for step in self.steps])
            flown = np.array([phase.end - phase.start for phase in phases])
            factor = max(1.0, float(np.max(durations / flown)))  # no step is shorter than that
            slowed = motion.replaced(phases=phases).slowed(factor)
            plan = self.task.plan_ending(slowed, passed[-1])
            return with_friction_feedforward(plan, timed=False)

        def rolling(path: Path) -> StepPlan:
            """Return the certified plan along a path with legs that roll."""
            roll = math.degrees(largest_roll(path))
            return require_certified(along(path)).with_remark(
                f"legs roll by up to {roll:.0f}° on the way"
            )

        path = morph.path
        if not rolls:
            return past_obstacles(self.task, along(path), path, along)
        paths = rolling_paths(path, requirements)[:MAX_ROLLING] or [path]
        candidates = [Candidate("rolling path", partial(rolling, path)) for path in paths]
        return first_certified(candidates, self.task.effort, self.task.progress)

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
