"""Editing of a problem file: its text, its handles, and the plan of the newest text.

The text is the only state. Each change creates a new text, which is planned in the background while
the last plan stays; plans of older texts are discarded.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from copy import deepcopy
from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from hitchopt.errors import FileError, HitchoptError, InfeasibleError, InputError
from hitchopt.geometry import Outline
from hitchopt.mission.cache import Cache
from hitchopt.mission.changes import with_edits_in
from hitchopt.mission.loading import parse_problem
from hitchopt.mission.problem import Problem, TeamMission
from hitchopt.mission.repair import NO_CHANGE, Suggestion, find_suggestions
from hitchopt.mission.solving import solve_problem
from hitchopt.mission.teams import CertifiedFlight
from hitchopt.motion.motion import Motion
from hitchopt.motion.states import states_at
from hitchopt.steps import STEP_KINDS
from hitchopt.steps.keys import TRIANGLE
from hitchopt.steps.knob import Edit
from hitchopt.storage.yaml_file import (
    Plain,
    parse_yaml,
    read_text,
    split_key,
    value_at,
    with_entries,
    with_value,
)
from hitchopt.support import Feature, Neighbour, refused_value
from hitchopt.values import Array
from hitchopt.values.fields import EMPTY, keys_of
from hitchopt.view.style import atomic_write

START = -1  # Index of the start, before the first step
# Default height of handles without a plan or a value in the file [m]
DEFAULT_HEIGHT = 1.0
# Path of a number in a file, and its axis
Number = tuple[tuple[str | int, ...], int]


@dataclass(frozen=True, eq=False)
class Handle:
    """A vertex, an edge, the whole hitch, an object or a drone that can be dragged."""

    name: str  # such as ``vertex 0``
    place: Array  # (3,) [m]
    numbers: tuple[Number, ...]  # numbers of the file that it moves

    @property
    def vertical(self) -> bool:
        """Return whether its height can be changed."""
        return any(axis == 2 for _, axis in self.numbers)

    def dragged(self, text: str, place: Array) -> str:
        """Return the text of a problem file with the handle at another position (3,) [m]."""
        by = (np.asarray(place, dtype=np.float64) - self.place).tolist()
        data = parse_yaml(text)
        for path, axis in self.numbers:
            if by[axis]:
                old = value_at(data, path)
                new = (DEFAULT_HEIGHT if old is None else old) + by[axis]
                text = with_value(text, path, float(new))
        return text


def handles(problem: Problem, data: Plain, index: int, height: float) -> Iterator[Handle]:
    """Yield the handles of a step, or of the start, in a file's data.

    ``height`` is the hitch's at the step's end [m], for steps without an altitude.
    """
    key = step_key(data, index)
    step = split_key(key)
    keys = value_at(data, step)
    has_altitude = key == "start.hitch" or key.endswith(".form")
    if has_altitude:
        height = float(keys.get("altitude", DEFAULT_HEIGHT))

    def handle(name: str, *points: tuple[str | int, ...], first: int = 0) -> Handle:
        """Return the handle in the middle of points; ``first`` is the index of x in a point."""
        values = np.array([value_at(keys, point)[first:] for point in points], float)
        place = np.append(np.mean(values, axis=0), height)[:3]
        axes = range(values.shape[1])
        numbers = (((*step, *point, first + axis), axis) for point in points for axis in axes)
        return Handle(name, place, tuple(numbers))

    if key == "start.drones":
        for k, name in product(range(len(keys["q"])), ("q", "r")):
            yield handle(f"{name}[{k}]", (name, k))
    elif "polygon" in keys:
        n = len(keys["polygon"])
        closed = problem.team.topology == "closed"
        corners: list[tuple[str | int, ...]] = [("polygon", k) for k in range(n)]
        yield from (handle(f"vertex {k}", corner) for k, corner in enumerate(corners))
        for k in range(n if closed else n - 1):
            yield handle(f"edge {k}", corners[k], corners[(k + 1) % n])
        hitch = handle("hitch", *corners)
        altitude = (((*step, "altitude"), 2),) if has_altitude else ()
        yield replace(hitch, numbers=(*hitch.numbers, *altitude))
    elif "path" in keys:
        for j, row in enumerate(keys["path"]):  # [t, x, y] or [x, y]
            yield handle(f"point {j}", ("path", j), first=len(row) - 2)
    elif ("vertex" in keys or "edge" in keys) and ("to" in keys or "by" in keys):
        kind = "vertex" if "vertex" in keys else "edge"
        name = f"{kind} {keys[kind]}"
        outline = outlines(problem.teams[""])[index + 1]
        if "to" in keys:
            yield handle(name, *([("to", 0), ("to", 1)] if kind == "edge" else [("to",)]))
        elif outline is not None:
            indices = keys[kind] + np.arange(1 if kind == "vertex" else 2)
            middle = np.mean(outline.vertices[indices % len(outline.vertices)], axis=0)
            yield replace(handle(name, ("by",)), place=np.append(middle, height))
    elif len(np.ravel(keys.get("to", 0.0))) == 3:
        yield handle(keys.get("object", "hitch"), ("to",))


def step_key(data: Plain, index: int) -> str:
    """Return the key of a step, or of the start, in a file."""
    path: tuple[str | int, ...] = ("start",) if index == START else ("mission", index)
    (name,) = value_at(data, path)
    return f"start.{name}" if index == START else f"mission[{index}].{name}"


def outlines(mission: TeamMission) -> list[Outline | None]:
    """Return the outlines at the start and after each step; None for free cables."""
    polygons = [mission.start_outline]
    for step in mission.steps:
        polygons.append(step.checked_polygon_after(mission.team, polygons[-1]))
    return polygons


def height_after(motion: Motion, index: int) -> float:
    """Return the height of the hitch at the end of a step, or at the start [m]."""
    phases = [phase for phase in motion.phases if phase.step == index] or motion.phases[-1:]
    state = states_at(motion, 0.0 if index == START else phases[-1].end)
    return float(np.mean(state.vertices[:, 2])) if bool(state.formed) else DEFAULT_HEIGHT


def new_step(problem: Problem, index: int, kind: str, height: float) -> dict[str, Plain]:
    """Return a new step after the one of an index; if possible it moves nothing.

    ``height`` is the hitch's there [m].
    """
    outline = outlines(problem.teams[""])[index + 1]
    vertices: Any = TRIANGLE if outline is None else np.round(outline.vertices, 6).tolist()
    centre = np.mean(vertices, axis=0) if outline is None else outline.centroid
    fields = keys_of(STEP_KINDS[kind])
    defaults: dict[str, Any] = {
        "polygon": vertices,
        "to": [*np.round(centre, 6).tolist(), round(height, 6)],
        "path": [[1.0, *vertices[0]]],
        "object": next(iter(problem.objects), ""),
    }
    values: dict[str, Any] = {
        name: defaults[name] if name in defaults else deepcopy(field.example)
        for name, field in fields.items()
        if field.default is EMPTY
    }
    if "vertex" in fields and "to" in fields:
        values["to"] = vertices[0]
    elif "edge" in fields:
        values["to"] = vertices[:2]
    return {kind: values}


class PlanState(StrEnum):
    """Relation of the current plan to the text."""

    CURRENT = "the plan of this problem"
    PLANNING = "an OLD plan: the changed problem is being planned"
    REFUSED = "an OLD plan: the changed problem is infeasible"


@dataclass(frozen=True, eq=False)
class Status:
    """State of planning the newest text."""

    stage: PlanState  # relation of the current plan to the text
    words: str = ""  # work in progress, or the error
    suggestions: tuple[Suggestion, ...] = ()  # verified changes that make the problem feasible


class _StaleError(BaseException):
    """Ends the planning of a text that is no longer the newest.

    It is not an Exception, so that planners that catch errors stop as well.
    """


class Editing:
    """Editing of the problem of a hitch by hand.

    Parameters
    ----------
    text: content of the problem file.
    path: path of the problem file; drawings of objects are relative to it.
    planned: plan of this text.
    """

    def __init__(self, text: str, path: Path, planned: CertifiedFlight) -> None:
        self.path, self.planned = path, planned
        self._worker: threading.Thread | None = None
        self._cache = Cache()  # an edit plans the later steps only
        self.listener: Callable[[], None] = lambda: None
        self._texts = [text]
        self._place = 0
        self._on_disk = text if path.exists() else None
        self._version = 0
        self._lock = threading.RLock()
        self._planning = threading.Lock()
        self.problem = self._read(text)
        self.status = Status(PlanState.CURRENT)

    @property
    def text(self) -> str:
        """Current content of the problem file."""
        return self._texts[self._place]

    @property
    def saved(self) -> bool:
        """Return whether the file on the disk holds this text."""
        return self.text == self._on_disk

    def now(self) -> tuple[str, Status, CertifiedFlight]:
        """Return a consistent text, status and plan."""
        with self._lock:
            return self.text, self.status, self.planned

    def handles(self, index: int) -> dict[str, Handle]:
        """Return the handles of a step, or of the start, by name."""
        height = self._height_after(index)
        data = parse_yaml(self.text)
        return {handle.name: handle for handle in handles(self.problem, data, index, height)}

    def _height_after(self, index: int) -> float:
        """Return the height of the planned hitch at the end of a step [m]."""
        return height_after(self.planned.flight.teams[0].motion, index)

    def change(self, text: str) -> None:
        """Replace the text; raise InputError or FileError if it is not the problem of a hitch."""
        with self._lock:
            problem = self._read(text)
            if text == self.text:
                return
            self._texts[self._place + 1 :] = [text]
            self._place += 1
            self._begin(problem)
        self.listener()

    def undo(self, steps: int = 1) -> bool:
        """Undo changes, or redo them if ``steps`` is negative; return whether that is possible."""
        with self._lock:
            place = self._place - steps
            if not 0 <= place < len(self._texts):
                return False
            self._place = place
            self._begin(self._read(self.text))
        self.listener()
        return True

    def put(self, *edits: Edit) -> None:
        """Write values into the file; errors as of ``change``."""
        self.change(with_edits_in(self.text, edits))

    def drag(self, index: int, name: str, place: Array) -> None:
        """Move a handle of a step to a position (3,) [m]; errors as of ``change``."""
        by_name = self.handles(index)
        if name not in by_name:
            raise InputError("handle", name, f"one of {', '.join(by_name)}", "choose another step")
        self.change(by_name[name].dragged(self.text, place))

    def add(self, index: int, kind: str) -> None:
        """Insert a new step after another one (START: first); errors as of ``change``."""
        step = new_step(self.problem, index, kind, self._height_after(index))
        self._rearrange(lambda steps: steps.insert(index + 1, step))

    def remove(self, index: int) -> None:
        """Remove a step; errors as of ``change``."""
        self._rearrange(lambda steps: steps.pop(index))

    def move(self, index: int, to: int) -> None:
        """Move a step to another index in the mission; errors as of ``change``."""
        if not 0 <= to < len(self.problem.mission):
            raise InputError("mission", to, "the index of a step", "the mission has no such step")
        self._rearrange(lambda steps: steps.insert(to, steps.pop(index)))

    def _rearrange(self, change: Callable[[list[Any]], object]) -> None:
        """Change the list of steps: indices of the current ones, and the content of a new one."""
        steps: list[Any] = list(range(len(self.problem.mission)))
        change(steps)
        self.change(with_entries(self.text, ("mission",), steps))

    def save(self) -> Path:
        """Write the problem file atomically and return its path.

        Raises FileError if it cannot be written, or has been changed by someone else.
        """
        with self._lock:
            content = read_text(self.path)[0] if self.path.exists() else None
            if content not in (self._on_disk, self.text):
                words = "was changed by another program; move it away, then save again"
                raise FileError(f"{self.path}: {words}")
            with atomic_write(self.path.resolve()) as draft:
                draft.write_bytes(self.text.encode())
            self._on_disk = self.text
        self.listener()
        return self.path

    def wait(self, seconds: float = 60.0) -> bool:
        """Wait for the planning to end; return whether it has ended."""
        if self._worker is not None:
            self._worker.join(seconds)
        return self._worker is None or not self._worker.is_alive()

    def close(self) -> None:
        """Stop planning."""
        self._version = -1
        self.wait()

    def _read(self, text: str) -> Problem:
        problem = parse_problem(text, self.path.name, self.path.parent)
        if problem.kind == "swarm":
            raise refused_value(Feature.EDITING, Neighbour.SINGLE_DRONES, "drones")
        if problem.kind == "teams":
            raise refused_value(Feature.EDITING, Neighbour.SEVERAL_TEAMS, "several")
        return problem

    def _begin(self, problem: Problem) -> None:
        """Start planning the newest text; it waits until the planning of older ones has ended."""
        self.problem = problem
        self.status = Status(PlanState.PLANNING)
        self._version += 1
        arguments = (self._version, problem)
        self._worker = threading.Thread(target=self._plan, args=arguments, daemon=True)
        self._worker.start()

    def _plan(self, version: int, problem: Problem) -> None:
        def report(words: str) -> None:
            self._publish(version, replace(self.status, words=words))

        with self._planning, suppress(_StaleError):
            self._check(version)
            try:
                planned = solve_problem(problem, report, cache=self._cache)
            except InfeasibleError as error:
                words = f"{error}\nlooking for changes that make it feasible …"
                self._publish(version, Status(PlanState.REFUSED, words))
                changes = find_suggestions(problem, error, progress=lambda _: self._check(version))
                words = str(error) if changes else f"{error}\n{NO_CHANGE}"
                self._publish(version, Status(PlanState.REFUSED, words, changes))
            except HitchoptError as error:
                self._publish(version, Status(PlanState.REFUSED, str(error)))
            except Exception as error:  # a bug must not end the editing
                self._publish(version, Status(PlanState.REFUSED, f"internal error: {error!r}"))
            else:
                self._publish(version, Status(PlanState.CURRENT), planned)

    def _check(self, version: int) -> None:
        if version != self._version:
            raise _StaleError

    def _publish(self, version: int, status: Status, plan: CertifiedFlight | None = None) -> None:
        with self._lock:
            self._check(version)
            self.status = status
            self.planned = plan or self.planned
        self.listener()
