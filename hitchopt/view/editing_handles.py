"""What can be dragged of a step of a problem file, and what a drag changes in the file."""

from __future__ import annotations

from collections.abc import Iterator
from copy import deepcopy
from dataclasses import dataclass
from typing import Any

import numpy as np

from hitchopt.geometry import Outline
from hitchopt.mission.file_models import STEP_KINDS, step_model
from hitchopt.mission.problem import Problem
from hitchopt.motion.motion import Motion
from hitchopt.motion.states import states_at
from hitchopt.steps.keys import TRIANGLE
from hitchopt.storage.plain import Plain
from hitchopt.storage.yaml_edits import split_key, value_at, with_value
from hitchopt.storage.yaml_file import parse_yaml
from hitchopt.values import Array

START = -1
"""Index of the start, before the first step."""

HEIGHT = 1.0
"""Height of handles where no plan tells that of the hitch, and of a file without one [m]."""

PLANE, SPACE = (0, 1), (0, 1, 2)
"""Numbers of a point that are its x, y and z."""


@dataclass(frozen=True)
class Target:
    """Numbers of a file that go with a handle.

    Attributes
    ----------
    key: of a point, of a list of points, or of a height.
    rows: which points of a list; None where the value is one point or a height.
    columns: which numbers of a point are its x, y and z; none of a height.
    """

    key: str
    rows: tuple[int, ...] | None = None
    columns: tuple[int, ...] = PLANE


@dataclass(frozen=True, eq=False)
class Handle:
    """A vertex, an edge, the whole hitch, an object or a drone that can be dragged.

    Attributes
    ----------
    name: such as ``vertex 0``.
    place: (3,) [m].
    targets: what goes with it.
    """

    name: str
    place: Array
    targets: tuple[Target, ...]

    @property
    def vertical(self) -> bool:
        """Whether its height can be changed."""
        return any(target.columns in ((), SPACE) for target in self.targets)


def dragged(text: str, handle: Handle, place: Array) -> str:
    """Return the text of a problem file with a handle at another place (3,) [m]."""
    by = np.asarray(place, dtype=np.float64) - handle.place
    data = parse_yaml(text)
    for target in handle.targets:
        path = split_key(target.key)
        value: Any = deepcopy(value_at(data, path))
        if not target.columns and by[2] == 0.0:
            continue
        if not target.columns:
            value = float((HEIGHT if value is None else value) + by[2])
        elif target.rows is None:
            _shift(value, target.columns, by)
        else:
            for row in target.rows:
                _shift(value[row], target.columns, by)
        text = with_value(text, path, value)
    return text


def _shift(point: list[float], columns: tuple[int, ...], by: Array) -> None:
    for axis, column in enumerate(columns):
        if by[axis] != 0.0:
            point[column] = float(point[column] + by[axis])


def handles(problem: Problem, data: Plain, index: int, height: float) -> tuple[Handle, ...]:
    """Return what can be dragged of the step of an index, or of the start.

    Parameters
    ----------
    problem, data: what a file describes, and what it holds.
    index: of the step; START for the start.
    height: of the hitch at the step's end [m], where the file does not tell.
    """
    return tuple(_handles(problem, data, index, height))


def _handles(problem: Problem, data: Plain, index: int, height: float) -> Iterator[Handle]:
    key = step_key(data, index)
    keys = value_at(data, split_key(key))
    if key == "start.drones":
        for k in range(len(keys["q"])):
            for name in ("q", "r"):
                target = Target(f"{key}.{name}", (k,), SPACE)
                yield Handle(f"{name}[{k}]", np.array(keys[name][k], np.float64), (target,))
    elif "polygon" in keys:
        ends = key == "start.hitch" or key.endswith(".form")
        z = float(keys.get("altitude", HEIGHT)) if ends else height
        yield from _shaped(problem, key, np.array(keys["polygon"], np.float64), z, ends)
    elif "path" in keys:
        for j, (_, x, y) in enumerate(keys["path"]):
            target = Target(f"{key}.path", (j,), (1, 2))
            yield Handle(f"point {j}", np.array([x, y, height], np.float64), (target,))
    elif "vertex" in keys or "edge" in keys:
        outline = outlines(problem)[index + 1]
        if outline is not None:
            yield _moved(key, keys, outline.vertices, height)
    elif len(np.ravel(keys.get("to", 0.0))) == len(SPACE):
        name = keys.get("object", "hitch")
        place = np.array(keys["to"], np.float64)
        yield Handle(name, place, (Target(f"{key}.to", None, SPACE),))


def _shaped(problem: Problem, key: str, points: Array, z: float, ends: bool) -> Iterator[Handle]:
    """Yield the handles of a polygon: vertices, edges, all of it."""
    n, key = len(points), f"{key}.polygon"
    places = np.column_stack([points, np.full(n, z)])
    for k in range(n):
        yield Handle(f"vertex {k}", places[k], (Target(key, (k,)),))
    for k in range(n if problem.team.topology == "closed" else n - 1):
        pair = (k, (k + 1) % n)
        yield Handle(f"edge {k}", places[list(pair)].mean(axis=0), (Target(key, pair),))
    height = (Target(f"{key.removesuffix('polygon')}altitude", None, ()),) if ends else ()
    everything = Target(key, tuple(range(n)))
    yield Handle("hitch", places.mean(axis=0), (everything, *height))


def _moved(key: str, keys: dict[str, Any], vertices: Array, height: float) -> Handle:
    """Return the handle of the vertex or the edge that a step moves."""
    name = "vertex" if "vertex" in keys else "edge"
    k = keys[name]
    ends = [k] if name == "vertex" else [k, (k + 1) % len(vertices)]
    target = Target(f"{key}.by") if "by" in keys else Target(f"{key}.to")
    if name == "edge" and "to" in keys:
        target = Target(f"{key}.to", (0, 1))
    return Handle(f"{name} {k}", np.append(vertices[ends].mean(axis=0), height), (target,))


def step_key(data: Plain, index: int) -> str:
    """Return the key of a step, or of the start, in a file."""
    path: tuple[str | int, ...] = ("start",) if index == START else ("mission", index)
    (name,) = value_at(data, path)
    return f"start.{name}" if index == START else f"mission[{index}].{name}"


def outlines(problem: Problem) -> list[Outline | None]:
    """Return the outline at the start, and after each step; None where there is no hitch."""
    found = [problem.start_outline]
    for step in problem.mission:
        found.append(step.polygon_left(problem.team, found[-1]))
    return found


def height_after(motion: Motion, index: int) -> float:
    """Return how high the hitch is when a step ends [m], or at the start."""
    ends = [phase.end for phase in motion.phases if phase.step == index]
    state = states_at(motion, 0.0 if index == START else max(ends, default=motion.duration))
    return float(np.mean(state.vertices[:, 2])) if bool(state.formed) else HEIGHT


def new_step(problem: Problem, index: int, kind: str, height: float) -> dict[str, Plain]:
    """Return a step to add after another one, as a file has it; it moves nothing where it may.

    Parameters
    ----------
    problem: to which it is added.
    index: of the step before; START for the first one.
    kind: what the file calls it.
    height: of the hitch there [m].
    """
    outline = outlines(problem)[index + 1]
    vertices: Any = TRIANGLE if outline is None else np.round(outline.vertices, 6).tolist()
    centre = np.mean(vertices, axis=0) if outline is None else outline.centroid
    usual: dict[str, Any] = {
        "polygon": vertices,
        "to": [*np.round(centre, 6).tolist(), round(height, 6)],
        "path": [[1.0, *vertices[0]]],
        "object": next(iter(problem.objects), ""),
    }
    fields = step_model(STEP_KINDS[kind]).model_fields
    values: dict[str, Any] = {
        name: usual[name] if name in usual else deepcopy((field.examples or [None])[0])
        for name, field in fields.items()
        if field.is_required()
    }
    if "vertex" in fields and "to" in fields:
        values["to"] = vertices[0]
    elif "edge" in fields:
        values["to"] = vertices[:2]
    return {kind: values}
