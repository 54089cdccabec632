"""Missions in Python, step by step: ``Mission(team, start).form(…).morph(…).release().solve()``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from hitchopt.hitch import Hitch, Team
from hitchopt.mission.problem import (
    DronesStart,
    HitchStart,
    Problem,
    Start,
    fitting_start,
    named_objects,
)
from hitchopt.mission.step_order import fitting_steps
from hitchopt.objects import SolidObject
from hitchopt.one_line import OneLine
from hitchopt.plan import Plan
from hitchopt.planning import solve
from hitchopt.requirements import Arena, Limits, Separation, check_requirements
from hitchopt.step_methods import StepMethods
from hitchopt.steps import Step
from hitchopt.time_limit import Progress
from hitchopt.values import instance, sequence, text


@dataclass(frozen=True, eq=False)
class Mission(StepMethods, OneLine):
    """A mission that is built step by step; every method returns a longer one.

    There is a method for every kind of step, with the arguments of its record: ``form``, ``morph``,
    ``move_vertex``, …. What is wrong in itself is refused by the step that has it.

    Parameters
    ----------
    team: who flies.
    start: a Hitch, a HitchStart, or a DronesStart: drones on free cables.
    limits, separation, arena, title, objects: as of a Problem.

    Raises
    ------
    InputError: a start that does not fit the team, or a wrong type.
    """

    team: Team
    start: Start
    limits: Limits = field(default_factory=Limits)
    separation: Separation = field(default_factory=Separation)
    arena: Arena | None = None
    title: str = ""
    steps: tuple[Step, ...] = ()
    objects: Mapping[str, SolidObject] = field(default_factory=dict)

    def __post_init__(self) -> None:
        instance("team", self.team, Team)
        instance("start", self.start, Hitch, DronesStart, HitchStart)
        check_requirements(self)
        text("title", self.title)
        object.__setattr__(self, "objects", named_objects(self.objects))
        start = fitting_start(self.team, self.start)
        object.__setattr__(self, "start", start)
        outline = None if isinstance(start, DronesStart) else start.polygon
        steps, last = list(sequence("steps", self.steps)), None
        for i, step in enumerate(steps):
            instance(f"steps[{i}]", step, Step)
        if steps and steps[-1].blends:  # into one that is still to come
            last = steps.pop()
            steps.append(_with_blend(last, False))
        fitted = fitting_steps(self.team, outline, tuple(steps), self.objects)
        if last is not None:
            fitted = (*fitted[:-1], _with_blend(fitted[-1], True))
        object.__setattr__(self, "steps", fitted)

    @property
    def problem(self) -> Problem:
        """The problem that ``solve`` plans; raises InputError where there is no step."""
        rest = self.limits, self.separation, self.arena, self.title, self.objects
        return Problem(self.team, self.start, self.steps, *rest)

    def then(self, step: Step) -> Mission:
        """Return the mission with one more step, given as its record.

        Raises
        ------
        InputError: it is none, or does not fit what is there before it.
        """
        instance("step", step, Step)
        return replace(self, steps=(*self.steps, step))

    def solve(self, progress: Progress | None = None, *, limit: float | None = None) -> Plan:
        """Return the certified plan; arguments and errors are those of ``hitchopt.solve``."""
        return solve(self.problem, progress, limit=limit)


def _with_blend(step: Any, blend: bool) -> Step:
    changed: Step = replace(step, blend=blend)
    return changed
