"""The models of a problem file of single drones to the record that the planner takes."""

from __future__ import annotations

from functools import partial

from hitchopt.hitch import Swarm
from hitchopt.mission.building import built_limits, built_quadrotors, checked_title
from hitchopt.mission.faults import Collector
from hitchopt.mission.swarm import SwarmProblem
from hitchopt.mission.swarm_schema import PrismKeys, SwarmKeys
from hitchopt.requirements import Arena, Prism, Separation


def built_swarm(keys: SwarmKeys) -> SwarmProblem:
    """Return the problem that ``keys`` describe.

    Raises
    ------
    InputError: what single values do not tell, such as counts and shapes; a joint error if several.
    """
    faults = Collector()
    attempt = faults.attempt
    title = attempt("", lambda: checked_title(keys.title))
    team = attempt(
        "team", lambda: Swarm(keys.team.drones, quadrotor=built_quadrotors(keys.team.quadrotor))
    )
    limits = attempt("limits", lambda: built_limits(keys.limits))
    separation = attempt("separation", lambda: Separation(**keys.separation.model_dump()))
    box = keys.arena
    arena = attempt("arena", lambda: Arena(box.lower, box.upper)) if box is not None else None
    prisms = [
        attempt(f"keep_out[{k}]", partial(_prism, prism)) for k, prism in enumerate(keys.keep_out)
    ]
    problem = None
    if team is not None and limits is not None and separation is not None:
        problem = attempt(
            "",
            lambda: SwarmProblem(
                team,
                keys.start,  # type: ignore[arg-type]
                keys.goal,  # type: ignore[arg-type]
                limits,
                separation,
                arena,
                tuple(prism for prism in prisms if prism is not None),
                keys.duration,
                title or "",
            ),
        )
    error = faults.error()
    if error is not None:
        raise error
    if problem is None:
        raise RuntimeError("a part of the problem is missing although nothing was refused")
    return problem


def _prism(keys: PrismKeys) -> Prism:
    return Prism(keys.polygon, keys.lower, keys.upper)
