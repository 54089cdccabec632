"""Reading of plan files: the plans of their teams, and other plans on the same clock."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np

from .arithmetic import POS_TOL, Effort, varies
from .plan import REST_TOL, Plan
from .settings import check_members, check_texts, check_type, fold

EFFORT = 40_000_000  # effort of all proofs of a file, besides PER_FIRST of their first passes


class UnreadableError(Exception):
    """The file is not a plan."""


def read(path: Path) -> tuple[list[Plan], list[Plan]]:
    """Return the plans of a file: those of its teams, and others on the same clock."""
    try:
        if path.exists() and not path.is_file():  # A pipe or a device may never end
            raise ValueError("it is not a regular file")
        with np.load(path, allow_pickle=False) as file:
            form, s = str(file["format"]), json.loads(str(file["settings"]))
            check_texts({"format": form, **s})
            check_members([x.orig_filename for x in file.zip.infolist()])
            if form != "hitchopt-flight/1":
                raise ValueError(f"format is {form!r:.60}, not hitchopt-flight/1")
            return plans_of_teams(file, s)
    except Exception as error:  # malformed files raise many kinds
        words = " ".join(f"{type(error).__name__}: {error}".split())
        raise UnreadableError(words[:300]) from error


def asked_of(problem: Any, name: str) -> dict[str, Any]:
    """Return the problem of one team, in the form of a team alone; nothing without a problem.

    A flight of single drones is a mission of one step.
    """
    if problem is None:
        return {}
    if not isinstance(problem, dict) or "start" not in problem:
        raise ValueError(f"request is {problem!r:.60}, not a problem")
    if "goal" in problem:
        flight = {key: problem[key] for key in ("goal", "duration") if key in problem}
        return {**problem, "mission": [{"fly": flight}]}
    if not name:
        return problem
    steps = list[Any]()
    for item in problem["mission"]:
        own = item.get(name, [])
        steps += own if isinstance(own, list) else [own]
    own_parts = {"team": problem["teams"][name], "start": problem["start"][name], "mission": steps}
    return {**problem, **own_parts}


def plans_of_teams(file: Any, s: dict[str, Any]) -> tuple[list[Plan], list[Plan]]:
    """Return the plans of teams and other plans."""
    check_type("settings", s, "settings")
    plans, seen, effort = list[Plan](), {"others"}, Effort(EFFORT)
    for key in ("groups", "others"):
        for i, head in enumerate(s[key]):
            name, several = head["name"], len(s["groups"]) > 1 or key == "others"
            form = r"[^\W\d][\w-]*" + r"(\.[^\W\d][\w-]*)?" * (key == "others")
            if not (re.fullmatch(form, name) if several else name == "") or fold(name) in seen:
                raise ValueError(f"{name!r:.60} is not a valid name, or not unique")
            if key == "groups" and (head["plan"] or head["digest"]):
                raise ValueError("a team is from another plan")
            seen.add(fold(name))
            plans.append(Plan(file, head, f"{key}/{i}/", effort))
    teams = s["groups"]
    own = plans[: len(teams)]
    own[0].stated = s.get("rules", [])
    for plan in own:
        plan.request = asked_of(s["request"], plan.label.rstrip("."))
    if max(abs(p.breaks[-1] - own[0].breaks[-1]) for p in own) > POS_TOL:
        raise ValueError("teams have different durations")
    if any(p.breaks[0] != 0.0 for p in own):
        raise ValueError("breaks do not start at 0")
    for p in own:
        p.may_wait = len(plans) > 1
        curves = p.points, p.poses, p.legs, p.pulls, p.tensions, p.load_share
        for i in (i for i, phase in enumerate(p.phases) if phase["name"] == "wait"):
            if any(varies(x.c[0][p.phase == i], REST_TOL) for x in curves):
                raise ValueError(f"{p.label}phases[{i}] is a wait, but something moves")
    return own, plans[len(teams) :]
