"""Comparison of a plan with the request of the problem in its file.

A key of a problem file is compared if the file states it and the curves, phases or settings of the
plan can contradict it; ``steps.py`` compares those of steps. Not compared are planners' choices and
preferences, such as ``optimize`` and a word for ``legs``.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from .arithmetic import POS_TOL, Array
from .plan import Plan
from .reading import UnreadableError, read
from .settings import TYPES
from .spans import Fault, Row, fault_row
from .steps import CLOSE, Step, differences, goals_after, legs, size_of, vertices_at, wider_tensions

Section = tuple[str, Any, Any]  # path of its keys, its requested values, and those of the plan

NAMES = {"circle": "radius", "to": "upper", "from": "lower", "outline": ""}
"""Names in plan files of keys of objects; outlines are stored in another form."""

DEFAULTS = {"floor": 0.0}
"""Limits of problems that do not state them; lower ones would hide what others limit."""

LEFT_OUT = {key[:-1] for key in re.findall(r"\w+\*", " ".join(TYPES.values()))}
"""Keys that plans omit if the problem states none."""


def contradictions(path: Path) -> list[str]:
    """Return what a plan's curves show otherwise than the problem in its file requests."""
    try:
        plans, _ = read(path)
    except UnreadableError as error:
        return [f"not a plan, or a damaged one: {error}"]
    rows = (row for plan in plans for row in requested(plan))
    return [f"the problem in it differs: {row.where}" for row in rows if row.verdict == "violated"]


def requested(p: Plan) -> Iterator[Row]:
    """Check what a plan shows of the problem in its file; no row if the file has none."""
    if not p.request:
        return
    try:
        faults = [*setting_faults(p), *start_faults(p), *step_faults(p)]
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        faults = [(0.0, True, f"the request is not a problem: {type(error).__name__}: {error}")]
    yield fault_row("request", faults)


def setting_faults(p: Plan) -> Iterator[Fault]:
    """Yield keys of the team, of limits and of objects whose values the plan contradicts."""
    time = float(p.breaks[0])
    prisms = [*(p.request.get("keep_out") or ())]
    own_prisms = [*p.settings["keep_out"]] or [*prisms_of(p, len(prisms))]
    yield time, len(prisms) != len(own_prisms), "keep_out has another number of prisms"
    of_prisms = [("keep_out", x, y) for x, y in zip(prisms, own_prisms, strict=False)]
    for path, stated, own in (*sections(p), *of_prisms):
        for key, value in stated.items() if isinstance(stated, dict) else ():
            yield time, contradicts(key, value, own or {}), f"{path}.{key} is not as requested"


def sections(p: Plan) -> Iterator[Section]:
    """Yield the sections of a problem except those of its prisms."""
    request, own = p.request, p.settings
    team = request["team"] or {}
    yield "team", {key: team[key] for key in team if key != "quadrotor"}, own["team"]
    for name in ("separation", "arena"):
        yield name, request.get(name), own[name]
    yield "limits", {**DEFAULTS, **(request.get("limits") or {})}, p.limits
    kinds = own["team"]["quadrotor"]
    models = team.get("quadrotor")
    of_robots = models if isinstance(models, list) else [models] * len(kinds)
    for k, (model, kind) in enumerate(zip(of_robots, kinds, strict=False)):
        if isinstance(model, dict):  # of both drones of a robot, or by their names
            drone = f"{'qr'[k % 2]}{k // 2}"
            yield "team.quadrotor", model.get(drone, model), kind
    for name, body in (request.get("objects") or {}).items():
        stored = own["objects"].get(name) or {}
        yield f"objects.{name}", body, {**stored, **stored.get("section", {})}


def prisms_of(p: Plan, count: int) -> Iterator[dict[str, Any]]:
    """Yield the prisms of plans with hitches, where they are fixed objects by their own names."""
    fixed = {body.name: body for body in p.bodies if body.fixed}
    for k in range(count):
        body = fixed.get(f"prism_{k}")
        if body is not None:
            c, s = body.pose[3:]
            outline = body.stem.core @ np.array([[c, s], [-s, c]]) + body.pose[:2]
            lower, upper = (body.pose[2] + x for x in (body.stem.lower, body.stem.upper))
            yield {"polygon": outline, "lower": lower, "upper": upper}


def contradicts(key: str, value: Any, own: Mapping[str, Any]) -> bool:
    """Return whether the settings of a plan have another value of a key than a problem states."""
    name = NAMES.get(key, key.removesuffix("_deg"))
    stored = own.get(name)
    if name == "tracking":
        value, stored = by_direction(value), by_direction(stored)
    if name not in own or value is None:
        return value is not None and name in LEFT_OUT
    if isinstance(value, dict):
        return any(contradicts(x, y, stored or {}) for x, y in value.items())
    if isinstance(value, str):
        return isinstance(stored, str) and stored != value
    try:
        stated = np.array(value, dtype=float)
        found = np.array(stored, dtype=float)
        stated = np.radians(stated) if key.endswith("_deg") else stated
        if name == "tilt":  # the plan has that of controllers that tilt less
            found = np.maximum(stated, found)
        return not np.allclose(stated, found, rtol=1e-9, atol=1e-12)
    except (TypeError, ValueError):  # a list of words, or of another form
        return False


def by_direction(tracking: Any) -> Any:
    """Return tracking errors by direction, if one number [m] states both."""
    is_number = isinstance(tracking, int | float)
    return {"level": tracking, "height": tracking} if is_number else tracking


def start_faults(p: Plan) -> Iterator[Fault]:
    """Yield keys of the start where the plan begins elsewhere."""
    time, start = float(p.breaks[0]), p.request["start"]
    s = Step(p, np.array([0]), p.phases[:1], vertices_at(p, 0, 0), continues=False, first=0)
    hitch, drones = (start.get(x) if isinstance(start, dict) else None for x in ("hitch", "drones"))
    if hitch:
        stated = hitch
        shown = {"polygon": s.vertices(0)[:, :2], "altitude": s.vertices(0)[:, 2]}
        off = size_of(legs(s, hitch.get("legs"), {}, 0))
        yield time, not off <= CLOSE, "start.hitch.legs is not as requested"
    elif drones:
        stated, shown = drones, {"q": s.drones(0)[::2], "r": s.drones(0)[1::2]}
    else:
        stated, shown = {"": start}, {"": s.drones(0)}
    for key, value in stated.items():
        if key in shown and not isinstance(value, str | dict | None):
            off = size_of(shown[key] - np.array(value, dtype=float))
            path = f"start.{key}".rstrip(".")
            yield time, not off <= CLOSE, f"{path} is not as requested"


def step_faults(p: Plan) -> Iterator[Fault]:
    """Yield keys of steps whose values the plan contradicts."""
    mission = p.request["mission"]
    phases_by_step = [[*phases] for _, phases in groupby(p.phases, key=lambda x: x["step"])]
    words = f"mission has {len(mission)} steps, and the plan {len(phases_by_step)}"
    yield float(p.breaks[0]), len(phases_by_step) != len(mission), words
    goals: Array | None = None  # of a step that goes on without a stop
    first = 0  # piece at which the steps begin that go on without a stop up to the next one
    for i, (phases, stated) in enumerate(zip(phases_by_step, mission, strict=False)):
        ((name, stated_keys),) = stated.items()
        keys = stated_keys or {}
        step = step_of(p, phases, goals, first)
        goals = goals_after(step, keys) if keys.get("blend") else None
        first = step.first if keys.get("blend") else int(step.pieces[-1]) + 1
        end, path = float(phases[-1]["end"]), f"mission[{i}].{name}"
        yield end, wider_tensions(step, keys), f"{path}.tension is not as requested"
        settling = [x for x in step.phases if x["name"] == "settle" != name]
        hidden = len(settling) > len(step.swings)
        yield end, hidden, f"{path} has a phase settle that is no over-travel after a slide"
        for key, off in differences(step, name, keys):
            yield end, not off <= CLOSE, f"{path}.{key} is not as requested"


def step_of(p: Plan, phases: list[dict[str, Any]], goals: Array | None, first: int) -> Step:
    """Return a step with its phases, the goals of the one before it if that does not stop.

    The steps that go on without a stop up to it begin at the ``first`` piece.
    """
    start, end = float(phases[0]["start"]), float(phases[-1]["end"])
    within = (p.breaks[:-1] >= start - POS_TOL) & (p.breaks[1:] <= end + POS_TOL)
    pieces = np.flatnonzero(within)
    moving = without_waits(phases) if p.may_wait else phases
    before = vertices_at(p, pieces[0], 0) if goals is None else goals
    return Step(p, pieces, moving, before, continues=goals is not None, first=first)


def without_waits(phases: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the phases of a step from the first to the last one that does not wait, if any."""
    moving = [i for i, x in enumerate(phases) if x["name"] != "wait"]
    return phases[moving[0] : moving[-1] + 1] if moving else phases
