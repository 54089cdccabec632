"""The records that planners take, built from the models of a problem file; names every fault."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from hitchopt.errors import InputError
from hitchopt.hitch import Quadrotor, Swarm, Team
from hitchopt.mission.faults import Collector
from hitchopt.mission.file_models import STEP_KINDS, ProblemKeys
from hitchopt.mission.object_keys import objects_of
from hitchopt.mission.problem import DronesStart, HitchStart, Problem, Start, fitting_start
from hitchopt.mission.schema import Keys, StartKeys, TeamKeys
from hitchopt.mission.swarm_problem import SwarmProblem
from hitchopt.mission.swarm_schema import SwarmKeys, SwarmTeamKeys
from hitchopt.requirements import Arena, Limits, Prism, Separation
from hitchopt.steps import Step
from hitchopt.units import seen_from


def built_problem(keys: ProblemKeys, folder: Path | None = None) -> Problem:
    """Return the problem of a hitch that ``keys`` describe; drawings are looked for in ``folder``.

    Raises
    ------
    InputError: what single values do not tell, such as counts and shapes; a joint error if several.
    """
    faults = Collector()
    common = _common_parts(keys, faults)
    common["objects"] = objects_of(keys.objects, folder, faults)
    team = faults.attempt("team", lambda: Team(**_team_values(keys.team)))
    if team is None:  # nothing else can be judged without it
        return faults.made(None)
    start = _start(keys.start, team, faults)
    steps = [_step(i, step, team, faults) for i, step in enumerate(keys.mission)]
    faults.check()
    mission = tuple(step for step in steps if step is not None)
    return faults.made(Problem(team, start, mission, **common) if start else None)


def built_swarm(keys: SwarmKeys, folder: Path | None = None) -> SwarmProblem:
    """Return the problem of single drones that ``keys`` describe; as ``built_problem``."""
    faults = Collector()
    common = _common_parts(keys, faults)
    common["objects"] = objects_of(keys.objects, folder, faults)
    team = faults.attempt("team", lambda: Swarm(**_team_values(keys.team)))
    keep_out = [
        faults.attempt(f"keep_out[{k}]", partial(Prism, **prism.model_dump()))
        for k, prism in enumerate(keys.keep_out)
    ]
    places: dict[str, Any] = {"start": np.array(keys.start), "goal": np.array(keys.goal)}
    prisms = tuple(prism for prism in keep_out if prism is not None)
    rest: dict[str, Any] = {"keep_out": prisms, "duration": keys.duration}
    if team is None:
        return faults.made(None)
    return faults.made(faults.attempt("", lambda: SwarmProblem(team, **places, **common, **rest)))


def _common_parts(keys: ProblemKeys | SwarmKeys, faults: Collector) -> dict[str, Any]:
    """Return the parts that problems of both kinds have, by name, those refused left out."""
    box = keys.arena
    parts = {
        "title": faults.attempt("", partial(_title, keys.title)),
        "limits": faults.attempt("limits", lambda: Limits(**keys.limits.model_dump())),
        "separation": faults.attempt(
            "separation", lambda: Separation(**keys.separation.model_dump())
        ),
        "arena": box and faults.attempt("arena", lambda: Arena(box.lower, box.upper)),
    }
    return {name: part for name, part in parts.items() if part is not None}


def _title(title: str) -> str:
    """Return the title, or raise InputError where a terminal would obey it."""
    if not title.isprintable():  # a terminal would obey its control characters
        raise InputError("title", title, "printable text on one line", "remove such characters")
    return title


def _team_values(keys: TeamKeys | SwarmTeamKeys) -> dict[str, Any]:
    """Return the arguments of the team that ``keys`` describe."""
    values = keys.model_dump()
    kinds = values["quadrotor"]
    one = isinstance(kinds, dict)
    found = []
    for k, kind in enumerate([kinds] if one else kinds):
        with seen_from("quadrotor" if one else f"quadrotor[{k}]"):
            found.append(Quadrotor(**kind))
    values["quadrotor"] = found[0] if one else found
    return values


def _start(keys: StartKeys, team: Team, faults: Collector) -> Start | None:
    """Return where the plan starts; None where it has been refused."""
    start: Start | None = None
    if keys.hitch is not None:
        values: dict[str, Any] = keys.hitch.model_dump()
        start = faults.attempt("start.hitch", lambda: HitchStart(**values))
    elif keys.drones is not None:
        q, r = np.array(keys.drones.q), np.array(keys.drones.r)
        start = faults.attempt("start.drones", lambda: DronesStart(q, r))
    return start and faults.attempt("", partial(fitting_start, team, start))


def _step(i: int, keys: Keys, team: Team, faults: Collector) -> Step | None:
    """Return the record of a step; None where it has been refused."""
    ((name, given),) = ((name, step) for name, step in keys if step is not None)
    kind, values = STEP_KINDS[name], given.model_dump()
    return faults.attempt(f"mission[{i}].{name}", lambda: kind.from_file(values).fitting(team))
