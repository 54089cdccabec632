"""Problems before planning: teams with their starts, steps and requirements."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Annotated, Any, Literal, NamedTuple

from hitchopt.checks.custom import Rule, checked_rules
from hitchopt.checks.registry import NAMES, RULE_OF_KEY
from hitchopt.checks.swing import SWING
from hitchopt.drones.quadrotor import quadrotors
from hitchopt.errors import Circumstance, InputError, Missing
from hitchopt.geometry import Outline
from hitchopt.hitch import Hitch, Swarm, Team
from hitchopt.hitch.requirements import (
    Arena,
    Limits,
    Prism,
    Requirements,
    Separation,
    check_requirements,
)
from hitchopt.hitch.team import MAX_DRONES, Assignment
from hitchopt.mission.objects import OBJECTS
from hitchopt.mission.others import MAX_TEAMS, NAME, OTHERS, Other
from hitchopt.mission.starts import DronesStart, HitchStart, resolved_start, words_of
from hitchopt.mission.step_order import resolved_steps
from hitchopt.motion.request import request_fields
from hitchopt.objects import SolidObject
from hitchopt.steps import ALL_STEP_KINDS, STEP_KINDS
from hitchopt.steps.keys import SWARM_PLACES, TRIANGLE, shown_legs
from hitchopt.steps.step import Step
from hitchopt.values import ByValue, check_instance, closest_word, sequence
from hitchopt.values.fields import (
    Key,
    by_key,
    collect,
    dict_of,
    documented,
    either,
    integers,
    join_key,
    list_of,
    mapping_of,
    one_or_each,
    single_key,
    store,
    titles,
)

MAX_TITLE = 200  # Maximum number of characters of a title
MAX_STEPS = 1000  # Maximum number of steps in a file
MAX_PRISMS = 1000  # Maximum number of prisms in a file

TITLE = titles(MAX_TITLE)
START = single_key(
    "Start",
    "Start of the plan.",
    {"hitch": HitchStart, "drones": DronesStart},
    "hitch: {polygon: [[x, y], …], altitude: 1.0}",
    (Hitch, HitchStart, DronesStart),
)
STEP = single_key(
    "Step",
    "One step of the mission.",
    STEP_KINDS,
    "one step per list entry, such as hold: {seconds: 1.0}",
    (Step,),
)


@dataclass(frozen=True, eq=False)
class TeamMission:
    """The start and the steps of one team, and the requirements of its plan.

    Raises InputError for what does not fit the team, with the key of a problem of this team alone.
    """

    name: str  # empty for a team alone
    team: Team
    start: Any  # Start; the positions (N, 3) [m] of single drones
    steps: tuple[Step, ...]
    requirements: Requirements  # with the objects that it carries, and obstacles

    def __post_init__(self) -> None:
        object.__setattr__(self, "start", resolved_start(self.name, self.team, self.start))
        self.requirements.check_placed()
        if not self.steps and self.name:
            value = f"no step of {self.name}"
            remedy = f"add {self.name}: {{{words_of(self.team).step_example}}}"
            raise InputError("mission", value, "of at least one item", remedy)
        if not self.steps:
            bound = "a list of at least one step"
            raise InputError("mission", [], bound, "add a morph or a hold")
        objects = self.requirements.objects
        steps = resolved_steps(self.name, self.team, self.steps, self.start_outline, objects)
        object.__setattr__(self, "steps", steps)

    @property
    def request(self) -> dict[str, Any]:
        """The start and requirements of its plan (``hitchopt.motion.request``)."""
        start: dict[str, Any] = {"drones": self.start}
        team = self.team
        if self.start_outline is not None:
            altitude = self.start.altitude
            start = {"hitch": {"polygon": self.start_outline.vertices, "altitude": altitude}}
            if isinstance(self.start, HitchStart):
                start["hitch"] |= shown_legs(self.start.legs)
            assignment = team.assignment or Assignment.fixed(team.robots)
            start["assignment"] = assignment.to_dict()  # of the plan that ended so
            team = team.of_problem
        elif self.form is not None and self.form.assigns_in_order:
            start["assignment"] = Assignment.fixed(team.robots).to_dict()
        return request_fields(team, self.requirements, start)

    @property
    def form(self) -> Step | None:
        """The first step that ties a hitch, which says how robots are assigned to edges."""
        return next((step for step in self.steps if step.assigns_in_order is not None), None)

    @property
    def start_outline(self) -> Outline | None:
        """Outline at the start; None for free cables and single drones."""
        if isinstance(self.start, HitchStart):
            return self.start.outline
        return self.start.polygon if isinstance(self.start, Hitch) else None


@dataclass(frozen=True, eq=False)
class SwarmTeam:
    """The team of single drones without cables."""

    drones: Annotated[int, Key(integers(1, MAX_DRONES), "Number N of drones", 2)]
    quadrotor: Annotated[
        Any,
        Key(
            quadrotors(1, MAX_DRONES),
            "Kind of quadrotor or name of a model: one for all, one per drone, or common values "
            "and, by names such as d0, values of single drones; null: the default kind",
        ),
    ] = None

    def team(self) -> Swarm:
        """Return the team."""
        return Swarm(self.drones, quadrotor=self.quadrotor)


SWARM_TEAM = mapping_of(SwarmTeam, SwarmTeam.team)
HITCH_LIMITS = (
    *(
        key.removeprefix("limits.")
        for key, rule in RULE_OF_KEY.items()
        if rule.bodies and all({"vertices", "cables"} & {*bodies} for bodies in rule.bodies)
    ),
    SWING.key.removeprefix("limits."),
)
"""Keys of limits that do not apply to single drones."""

HITCH_SEPARATION = ("cable", "crossing", "object")
"""Keys of distances that do not apply to single drones."""


ANY_STEP = single_key(
    "TeamStep",
    "One step of a team, or of single drones.",
    ALL_STEP_KINDS,
    "one step, or a list of steps, such as hold: {seconds: 1.0}",
    (Step,),
)


def check_team_names(teams: Any, start: Any, mission: Any) -> None:
    """Raise InputError for starts and steps that are not under the name of a team."""
    names = list(teams) if isinstance(teams, Mapping) else []
    items = mission if isinstance(mission, list | tuple) else ()
    sections = {"start": start} | {f"mission[{i}]": item for i, item in enumerate(items)}
    for path, section in sections.items() if len(names) > 1 else ():
        for name in section if isinstance(section, Mapping) else ():
            if name not in names:
                remedy = closest_word(name, names)
                if name in ALL_STEP_KINDS:
                    remedy = f"write {names[0]}: {{{name}: …}}"
                outside = Circumstance("not under the name of a team")
                raise InputError(join_key(path, name), outside, "under a team's name", remedy)


TEAM = mapping_of(Team)
TEAMS = dict_of(by_key({"robots": TEAM, "drones": SWARM_TEAM}), NAME, MAX_TEAMS)
STARTS = dict_of(either(START, SWARM_PLACES), NAME, MAX_TEAMS)
ITEMS = list_of(dict_of(one_or_each(ANY_STEP, 1, MAX_STEPS), NAME, MAX_TEAMS), 1, MAX_STEPS)
"""Teams, their starts, and the items of their mission, by the names of teams."""


def _no_step(key: str, value: object) -> InputError:
    """Return the error of a value in place of a step, whose word may be the name of a step."""
    kind = STEP_KINDS.get(value) if isinstance(value, str) else None
    example = "hitchopt.Hold(1.0)" if kind is None else f"hitchopt.{kind.__name__}(…)"
    return InputError(key, value, "a step", f"write it as a record, such as {example}")


class PlacedStep(NamedTuple):
    """A step of one of several teams, with its place in the file."""

    key: str  # Key of the step, such as ``mission[0].left[1]``.
    step: Step  # The step
    ends_item: bool  # Whether it is the team's last step in its item of the mission


@documented
@dataclass(frozen=True, eq=False)
class Problem(ByValue):
    """Missions of a team with a hitch, of single drones, or of several teams.

    Single drones are a ``Swarm`` that starts at positions (N, 3) [m] and whose steps are ``Fly``.

    ``keep_out`` has prisms that drones stay out of by ``Separation.radius``. In problems with
    hitches they become fixed ``objects`` named ``prism_0``, ``prism_1``, …, of which cables and
    carried objects keep clear, too.

    Several teams are mappings by name: ``team`` has their teams, ``start`` their starts, and items
    of ``mission`` a step, or a sequence of steps, of some of them. The steps of an item begin
    together, or as soon after that as all keep clear of each other; the next item begins when all
    are done. A team alone carries an object that a step of it names; all others are obstacles of
    all teams.

    ``rules`` are custom limits, which files cannot state. Planners ignore them: a plan that
    violates one is refused.

    ``teams`` has start, steps and requirements of every team by name; a single team has the name
    ``""``.

    Raises
    ------
    InputError: names, objects or steps that do not match one another, a team or its outline; no
        step; a rule with the name of another check.
    """

    team: Annotated[Any, Key(TEAM, "The team", {"robots": 3, "cable_length": 2.4})]
    start: Annotated[
        Any, Key(START, "Start of the plan", {"hitch": {"polygon": TRIANGLE, "altitude": 1.0}})
    ]
    mission: Annotated[
        Any,
        Key(
            list_of(STEP, 1, MAX_STEPS), "Steps, one after the other", [{"hold": {"seconds": 1.0}}]
        ),
    ]
    limits: Annotated[Limits, Key(mapping_of(Limits), "Limits of motion")] = field(
        default_factory=Limits
    )
    separation: Annotated[Separation, Key(mapping_of(Separation), "Distances to keep")] = field(
        default_factory=Separation
    )
    arena: Annotated[Arena | None, Key(mapping_of(Arena), "Box that the drones stay in")] = None
    title: Annotated[str, Key(TITLE, "Title of the plan")] = ""
    objects: Annotated[
        Mapping[str, SolidObject], Key(OBJECTS, "Carried objects and obstacles, by name")
    ] = field(default_factory=dict)
    others: Annotated[
        Mapping[str, Other],
        Key(OTHERS, "External plans in the same airspace, by name, at rest before and after"),
    ] = field(default_factory=dict)
    keep_out: Annotated[
        tuple[Prism, ...],
        Key(list_of(mapping_of(Prism), 0, MAX_PRISMS), "Prisms that the drones stay out of"),
    ] = ()
    rules: Sequence[Rule[Any]] = ()
    teams: Mapping[str, TeamMission] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        store(self, keep_out=sequence("keep_out", self.keep_out))
        store(self, rules=checked_rules(self.rules, NAMES))
        check_requirements(self)
        store(self, title=self.title, others=self.others)
        if not isinstance(self.objects, Mapping):
            remedy = "write {'box': hitchopt.SolidObject(…)}"
            raise InputError("objects", self.objects, "a dict of objects by name", remedy)
        for name, body in self.objects.items():
            check_instance(f"objects.{name}", body, SolidObject)
        object.__setattr__(self, "objects", dict(self.objects))
        if isinstance(self.team, Mapping):
            self._prisms_to_objects()
            store(self, teams=self._resolved_teams())
        else:
            check_instance("team", self.team, Team)
            if self.team.has_cables:
                self._prisms_to_objects()
            if isinstance(self.mission, str):
                raise _no_step("mission", self.mission)
            steps = sequence("mission", self.mission)
            for i, step in enumerate(steps):
                if not isinstance(step, Step):
                    raise _no_step(f"mission[{i}]", step)
            requirements = self._requirements(self.team, self.objects)
            own = TeamMission("", self.team, self.start, steps, requirements)
            for name, value in (("start", own.start), ("mission", own.steps), ("teams", {"": own})):
                object.__setattr__(self, name, value)

    def _prisms_to_objects(self) -> None:
        """Replace the prisms of ``keep_out`` by fixed objects."""
        prisms = {f"prism_{k}": prism.as_object() for k, prism in enumerate(self.keep_out)}
        for name in prisms.keys() & self.objects.keys():
            bound = "another name than that of a prism of keep_out"
            raise InputError(f"objects.{name}", name, bound, "rename the object")
        object.__setattr__(self, "objects", {**self.objects, **prisms})
        object.__setattr__(self, "keep_out", ())

    def _requirements(self, team: Team, objects: Mapping[str, SolidObject]) -> Requirements:
        parts = self.limits, self.separation, self.arena, self.keep_out, objects
        return Requirements(*parts).flown_by(team)

    @property
    def kind(self) -> Literal["hitch", "swarm", "teams"]:
        """Return the kind of problem: one team with cables, single drones, or several teams."""
        if isinstance(self.team, Mapping):
            return "teams"
        return "hitch" if self.team.has_cables else "swarm"

    @property
    def requirements(self) -> Requirements:
        """Requirements of the plan of a single team."""
        return self.teams[""].requirements

    @property
    def request(self) -> dict[str, Any]:
        """The request that the plan must satisfy; of several teams by name."""
        requests = {name: each.request for name, each in self.teams.items()}
        return requests.get("", requests)

    @property
    def items(self) -> list[dict[str, int]]:
        """Number of steps of each team in each item of the mission.

        Items of a single team are its groups of steps without a stop.
        """
        if self.kind == "teams":
            return [
                {name: 1 if isinstance(x, Step) else len(x) for name, x in item.items()}
                for item in self.mission
            ]
        ends = [-1, *(k for k, step in enumerate(self.mission) if not step.blends)]
        return [{"": last - first} for first, last in pairwise(ends)]

    def _resolved_teams(self) -> dict[str, TeamMission]:
        """Check team, start and mission of several teams; return their missions."""
        for name, kind in (("team", TEAMS), ("start", STARTS), ("mission", ITEMS)):
            key = "teams" if name == "team" else name
            object.__setattr__(self, name, kind.check(key, getattr(self, name)))
        names = list(self.team)
        if len(names) < 2:
            remedy = "with one team write team, and its start and steps without a name"
            raise InputError("teams", names, "at least two teams", remedy)
        check_team_names(self.team, self.start, self.mission)
        for name in self.others.keys() & self.team.keys():
            raise InputError(f"others.{name}", name, "a name that no team has", "rename it")
        for i, item in enumerate(self.mission):
            if not item:
                remedy = f"write a step, such as {names[0]}: {{hold: {{seconds: 1.0}}}}"
                raise InputError(f"mission[{i}]", {}, "steps of at least one team", remedy)
        owners = self._owners()
        missions = collect(lambda name: self._named_mission(name, owners), names)
        replace(missions[0].requirements, objects=self.objects).check_placed()
        return dict(zip(names, missions, strict=True))

    def _steps(self, name: str) -> list[PlacedStep]:
        """Return the steps of a team with their places in the file."""
        steps = list[PlacedStep]()
        for i, item in enumerate(self.mission):
            key = f"mission[{i}].{name}"
            own = item.get(name, ())
            if isinstance(own, Step):
                steps.append(PlacedStep(key, own, ends_item=True))
                continue
            for j, step in enumerate(own, 1):
                steps.append(PlacedStep(f"{key}[{j - 1}]", step, ends_item=j == len(own)))
        return steps

    def _owners(self) -> dict[str, str]:
        """Return the team that carries each object; obstacles have no owner."""
        owners = dict[str, str]()
        for name in self.team:
            for key, step, _ in self._steps(name):
                body = step.object_name
                if body is not None and owners.setdefault(body, name) != name:
                    bound = f"an object that {owners[body]} does not name"
                    remedy = "let one team carry it"
                    raise InputError(f"{key}.{step.name}.object", body, bound, remedy)
        return owners

    def _named_mission(self, name: str, owners: Mapping[str, str]) -> TeamMission:
        """Return the mission of one of several teams."""
        team = self.team[name]
        start = self.start.get(name, Missing())
        steps = self._steps(name)
        for key, step, ends_item in steps:
            if ends_item and step.blends:
                bound = "false in the last step of an item"
                remedy = "omit it: the next item begins when all rest"
                raise InputError(f"{key}.{step.name}.blend", True, bound, remedy)
        bodies = {k: body for k, body in self.objects.items() if owners.get(k, name) == name}
        requirements = self._requirements(team, bodies)

        def with_name(key: str) -> str:
            key = re.sub(r"^mission\[(\d+)\]", lambda match: steps[int(match[1])].key, key)
            return re.sub(r"^start\b", f"start.{name}", re.sub(r"^team\b", f"teams.{name}", key))

        try:
            return TeamMission(
                name, team, start, tuple(placed.step for placed in steps), requirements
            )
        except InputError as error:
            raise error.renamed(with_name) from None
