"""Problems of several teams: their starts, and items of a mission whose steps start together."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated, Any, ClassVar

import numpy as np

from hitchopt.errors import InputError, JointInputError, OneLine
from hitchopt.hitch import Swarm, Team
from hitchopt.hitch.requirements import Limits, Separation
from hitchopt.mission.objects import OBJECTS
from hitchopt.mission.others import MAX_GROUPS, NAME
from hitchopt.mission.problem import (
    MAX_STEPS,
    START,
    SWARM_PLACES,
    SWARM_TEAM,
    ArenaOrNone,
    Others,
    Problem,
    Start,
    SwarmProblem,
    Title,
)
from hitchopt.objects import SolidObject
from hitchopt.objects.placing import check_placed
from hitchopt.steps import STEP_KINDS, Step
from hitchopt.steps.step import TRIANGLE
from hitchopt.values import Array, closest_word
from hitchopt.values.fields import (
    Key,
    Missing,
    Record,
    by_key,
    collect,
    dict_of,
    documented,
    either,
    join_key,
    list_of,
    mapping_of,
    one_or_each,
    single_key,
    store,
)
from hitchopt.values.units import DURATION


@documented
@dataclass(frozen=True, eq=False)
class Fly(Record):
    """A flight of single drones beside teams with cables."""

    name: ClassVar[str] = "fly"
    blends: ClassVar[bool] = False
    goal: Annotated[
        Array,
        Key(
            SWARM_PLACES,
            "Where they come to rest (N, 3) [m], [x, y, z] per drone",
            [[1, 0, 1], [-1, 0, 1]],
        ),
    ]
    duration: Annotated[
        float | None, Key(DURATION, "Exactly that long; without it as fast as possible")
    ] = None


ANY_STEP = single_key(
    "TeamStep",
    "One step of a team, or of single drones.",
    STEP_KINDS | {Fly.name: Fly},
    "one step, or a list of steps, such as hold: {seconds: 1.0}",
)

EXAMPLES: Mapping[str, Any] = {
    "teams": {name: {"robots": 3, "cable_length": 2.4} for name in "ab"},
    "start": {
        "a": {"hitch": {"polygon": TRIANGLE, "altitude": 1.0}},
        "b": {"hitch": {"polygon": TRIANGLE, "altitude": 2.5}},
    },
    "mission": [{"a": {"hold": {"seconds": 1.0}}, "b": {"hold": {"seconds": 1.0}}}],
}


def check_team_names(teams: Any, start: Any, mission: Any) -> None:
    """Raise InputError for starts and steps that are not under the name of a team."""
    names = list(teams) if isinstance(teams, Mapping) else []
    items = mission if isinstance(mission, list | tuple) else ()
    sections = {"start": start} | {f"mission[{i}]": item for i, item in enumerate(items)}
    for path, section in sections.items() if len(names) > 1 else ():
        for name in section if isinstance(section, Mapping) else ():
            if name not in names:
                remedy = closest_word(name, names)
                if name in (*STEP_KINDS, Fly.name):
                    remedy = f"write {names[0]}: {{{name}: …}}"
                value = "a start" if path == "start" else "a step"
                raise InputError(join_key(path, name), value, "under the name of a team", remedy)


@documented
@dataclass(frozen=True, eq=False)
class TeamsProblem(OneLine):
    """Several teams in one arena: teams with a hitch, or single drones, and what each does.

    The steps of an item of the mission begin together, or as soon after that as all keep off each
    other; the next item begins when all are done. A team alone carries an object that a step of it
    names; all others are obstacles of all teams.

    Raises
    ------
    InputError: names, objects or steps that do not fit one another or a team.
    """

    teams: Annotated[
        Mapping[str, Team],
        Key(
            dict_of(by_key({"robots": mapping_of(Team), "drones": SWARM_TEAM}), NAME, MAX_GROUPS),
            "The teams by name, of robots or of single drones",
            EXAMPLES["teams"],
        ),
    ]
    start: Annotated[
        Mapping[str, Start | Array],
        Key(
            dict_of(either(START, SWARM_PLACES), NAME, MAX_GROUPS),
            "The start of every team; of single drones their places [x, y, z] [m]",
            EXAMPLES["start"],
        ),
    ]
    mission: Annotated[
        Sequence[Mapping[str, Any]],
        Key(
            list_of(dict_of(one_or_each(ANY_STEP, 1, MAX_STEPS), NAME, MAX_GROUPS), 1, MAX_STEPS),
            "Items, one after the other: a step, or a list of steps, of some teams",
            EXAMPLES["mission"],
        ),
    ]
    limits: Annotated[Limits, Key(mapping_of(Limits), "Limits of motion of all teams")] = field(
        default_factory=Limits
    )
    separation: Annotated[
        Separation, Key(mapping_of(Separation), "Distances to keep, between teams too")
    ] = field(default_factory=Separation)
    arena: ArenaOrNone = None
    title: Title = ""
    objects: Annotated[
        Mapping[str, SolidObject], Key(OBJECTS, "Carried objects and obstacles, by name")
    ] = field(default_factory=dict)
    others: Others = field(default_factory=dict)

    def __post_init__(self) -> None:
        checked = ("teams", "start", "mission", "title", "others")
        store(self, **{name: value for name, value in vars(self).items() if name in checked})
        names = list(self.teams)
        if len(names) < 2:
            remedy = "with one team write team, and its start and steps without a name"
            raise InputError("teams", names, "at least two teams", remedy)
        check_team_names(self.teams, self.start, self.mission)
        collect(self._check_team, names)
        for name in self.others.keys() & self.teams.keys():
            raise InputError(f"others.{name}", name, "a name that no team has", "rename it")
        for i, item in enumerate(self.mission):
            if not item:
                remedy = f"write a step, such as {names[0]}: {{hold: {{seconds: 1.0}}}}"
                raise InputError(f"mission[{i}]", {}, "steps of one team at least", remedy)
        first = next(iter(self.problems.values()))
        requirements = first.requirements if isinstance(first, Problem) else first[0].requirements
        check_placed(self.objects, requirements.floor)

    def _check_team(self, name: str) -> None:
        """Raise InputError if a team's start or steps are missing, or of the other kind."""
        is_swarm, start = isinstance(self.teams[name], Swarm), self.start.get(name, Missing())
        kind, bound = "a team of robots", "a hitch, or drones q and r"
        start_example = "{hitch: {polygon: [[x, y], …], altitude: 1}}"
        step_example, step_bound = "hold: {seconds: 1}", f"a step of {kind}"
        if is_swarm:
            kind, bound = "single drones", "a list of places [x, y, z], one per drone"
            start_example, step_example = "[[x, y, z], …]", "fly: {goal: …}"
            step_bound = "fly, the only step of single drones"
        if isinstance(start, Missing) or isinstance(start, np.ndarray) is not is_swarm:
            raise InputError(f"start.{name}", start, bound, f"write {name}: {start_example}")
        if not self._steps(name):
            remedy = f"add {name}: {{{step_example}}}"
            raise InputError("mission", f"no step of {name}", "of an item at least", remedy)
        for key, step, is_last in self._steps(name):
            if isinstance(step, Fly) is not is_swarm:
                raise InputError(f"{key}.{step.name}", "a step", step_bound, f"{name} is {kind}")
            if is_last and step.blends:
                bound = "false in the last step of an item"
                remedy = "leave it out: the next item begins when all rest"
                raise InputError(f"{key}.{step.name}.blend", True, bound, remedy)

    def _steps(self, name: str) -> list[tuple[str, Any, bool]]:
        """Return the steps of a team with their keys, and whether each is the last of its item."""
        steps = list[tuple[str, Any, bool]]()
        for i, item in enumerate(self.mission):
            key, own = f"mission[{i}].{name}", item.get(name, ())
            if isinstance(own, Step | Fly):
                steps.append((key, own, True))
            else:
                last = len(own) - 1
                steps += [(f"{key}[{j}]", step, j == last) for j, step in enumerate(own)]
        return steps

    @cached_property
    def owners(self) -> dict[str, str]:
        """Team that carries each object, by the object's name; obstacles have no owner."""
        owners = dict[str, str]()
        for name in self.teams:
            for key, step, _ in self._steps(name):
                body = getattr(step, "object", None)
                if body is not None and owners.setdefault(body, name) != name:
                    bound = f"an object that {owners[body]} does not name"
                    remedy = "let one team carry it"
                    raise InputError(f"{key}.{step.name}.object", body, bound, remedy)
        return owners

    @cached_property
    def problems(self) -> dict[str, Problem | tuple[SwarmProblem, ...]]:
        """Problem of each team alone; for single drones one problem per flight."""
        return dict(collect(lambda name: (name, self._problem(name)), self.teams))

    def _problem(self, name: str) -> Problem | tuple[SwarmProblem, ...]:
        team, steps, flights = self.teams[name], self._steps(name), list[SwarmProblem]()
        start: Any = self.start[name]
        parts: dict[str, Any] = {
            key: getattr(self, key) for key in ("limits", "separation", "arena")
        }
        parts["objects"] = {
            key: body for key, body in self.objects.items() if self.owners.get(key, name) == name
        }
        try:
            if not isinstance(team, Swarm):
                return Problem(team, start, tuple(step for _, step, _ in steps), **parts)
            for _, step, _ in steps:
                flights += [SwarmProblem(team, start, step.goal, duration=step.duration, **parts)]
                start = step.goal
            return tuple(flights)
        except InputError as error:

            def with_team(one: InputError) -> InputError:
                key = re.sub(r"^(goal|duration)", f"mission[{len(flights)}].fly.\\1", one.key)
                key = re.sub(r"^mission\[(\d+)\]", lambda match: steps[int(match[1])][0], key)
                key = re.sub(r"^start\b", f"start.{name}", re.sub(r"^team\b", f"teams.{name}", key))
                return InputError(key, one.value, one.bound, one.remedy, one.place)

            if isinstance(error, JointInputError):
                raise JointInputError(list(map(with_team, error.errors))) from None
            raise with_team(error) from None

    @property
    def items(self) -> list[dict[str, int]]:
        """Number of steps of each team in each item of the mission."""
        return [
            {name: 1 if isinstance(x, Step | Fly) else len(x) for name, x in item.items()}
            for item in self.mission
        ]

    @property
    def asked(self) -> dict[str, Any]:
        """Request of each team by name, as ``Problem.asked``."""
        requests = dict[str, Any]()
        for name, each in self.problems.items():
            flights = (each,) if isinstance(each, Problem) else each
            steps = [step for flight in flights for step in flight.asked["mission"]]
            requests[name] = flights[0].asked | {"mission": steps}
        return requests


AnyProblem = Problem | SwarmProblem | TeamsProblem
"""A problem of a hitch, of single drones, or of several teams."""
