"""Plan files of formats 1 and 2, as releases until November 2026 wrote them, in format 3.

They hold numbers of the team as arrays, and the request once more (``asked``), which is not read:
the problem's text states it. Format 2 has teams and external plans by name.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from hitchopt.errors import InputError
from hitchopt.hitch import Quadrotor, Swarm, Team
from hitchopt.hitch.requirements import Limits
from hitchopt.motion.request import encoded
from hitchopt.storage.archive import read_arrays

FORMATS = ("hitchopt-plan/1", "hitchopt-plan/2")

CURVES = {
    "leg_tensions": "leg_tensions",
    "poses": "poses",
    "load_share": "borne",
    "contacts": "contacts",
}
"""Curves that are stored if a setting of the same name is true, with these names."""

LOOP = {"stiffness": math.inf, "integral": 0.0, "feed_forward": 1.0}
"""Arrays of position loops without a named controller, and values that stand for the defaults."""


def converted(
    version: str, settings: Mapping[str, Any], path: Path
) -> tuple[dict[str, Any], dict[str, list[dict[str, Any]]]]:
    """Return settings of format 3, and the arrays of every team and external plan.

    Raises InputError for another format, and others of READ_ERRORS for damaged files.
    """
    if version not in FORMATS:
        raise InputError("format", version, "one of 1 to 3", "use hitchopt's own files")
    several = version == FORMATS[1]
    asked = settings["asked"]["others"] if several else {}
    stored = {"groups": settings["teams"] if several else {"": settings}}
    stored["others"] = settings["others"] if several else {}
    heads, arrays = dict[str, list[Any]](), dict[str, list[Any]]()
    for key, groups in stored.items():
        folder = "others/" if key == "others" else ""
        each = [_group(path, f"{folder}{name}/" * bool(name), own) for name, own in groups.items()]
        arrays[key], heads[key] = [x for _, x in each], list[Any]()
        for name, (records, _) in zip(groups, each, strict=True):
            origin = asked[name] if key == "others" else {"plan": "", "digest": ""}
            head = {"name": name, "plan": origin["plan"], "digest": origin["digest"]}
            heads[key].append(head | {"records": records})
    head = {"title": settings["title"], "problem": settings.get("problem", "")}
    return head | heads, arrays


def _group(path: Path, folder: str, own: Mapping[str, Any]) -> tuple[dict[str, Any], Any]:
    """Return the records of one motion in format 3, and its arrays by their names there."""
    has_cables = "robots" in own["team"]
    names = {name: name for name in ("breaks", "drones")}
    names |= {name: name for name in ("vertices", "legs", "tensions") if has_cables}
    names |= {name: old for name, old in CURVES.items() if own.get(old) is True}
    columns = ["mass", "max_thrust", *(LOOP if own.get("control") is True else ())]
    robots = ["cable_length", "tension"] if has_cables else []
    stored = read_arrays(path, [folder + x for x in (*names.values(), *columns, *robots)])
    arrays = {name: stored[folder + old] for name, old in names.items()}
    numbers = {name: stored[folder + name].tolist() for name in (*columns, *robots)}
    kinds = _kinds({name: numbers[name] for name in columns}, own.get("controllers", []))
    team: Team
    if has_cables:
        team = Team(**own["team"], **{name: numbers[name] for name in robots}, quadrotor=kinds)
    else:
        team, count = Swarm(own["team"]["drones"], quadrotor=kinds), len(arrays["drones"])
        shapes = {"vertices": (team.layout.points, 3), "legs": (0, 2), "tensions": (0,)}
        arrays |= {name: np.zeros((count, *shape, 1)) for name, shape in shapes.items()}
    requirements = {key: own[key] for key in ("separation", "arena", "keep_out")}
    requirements |= {"limits": encoded(Limits(**own["limits"])), "objects": own.get("objects", {})}
    records = {"team": encoded(team), "requirements": requirements, "phases": own["phases"]}
    return records | {"assignment": own.get("assignment")}, arrays


def _kinds(columns: dict[str, list[Any]], controllers: list[Any]) -> list[Quadrotor]:
    """Return the kinds of quadrotors; a single controller is that of all."""
    count = len(columns["mass"])
    named = controllers if len(controllers) > 1 else [*controllers, None][:1] * count
    kinds = []
    for i, controller in zip(range(count), named, strict=True):
        values = {name: column[i] for name, column in columns.items()}
        for name in LOOP.keys() & values:
            values[name] = None if controller or values[name] == LOOP[name] else values[name]
            if name != "stiffness" and values[name] in (0.0, 1.0):  # others are refused
                values[name] = bool(values[name])
        kinds.append(Quadrotor(**values | (controller or {})))
    return kinds
