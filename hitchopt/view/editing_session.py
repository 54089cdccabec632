"""A problem file being edited: its text, what was planned of it, and what is planned now.

The text is the only state. Every change makes another text, which is planned in the background
while the last plan stays; a plan of a text that is no longer the newest is discarded.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path

from hitchopt.errors import FileError, HitchoptError, InfeasibleError, InputError
from hitchopt.mission.loading import parse_problem
from hitchopt.mission.problem import Problem
from hitchopt.mission.repair.change import NO_CHANGE, Edit, Suggestion
from hitchopt.mission.repair.suggest import find_suggestions
from hitchopt.mission.solving import solve_problem
from hitchopt.steps.certified_motions import Certified
from hitchopt.storage.yaml_edits import (
    split_key,
    with_entry,
    with_entry_moved,
    with_value,
    without_entry,
)
from hitchopt.storage.yaml_file import parse_yaml, read_text
from hitchopt.time_limit import Progress
from hitchopt.values import Array
from hitchopt.view.editing_handles import dragged, handles, height_after, new_step

MISSION = ("mission",)


class Stage(StrEnum):
    """How the plan that is there relates to the text."""

    CURRENT = "the plan of this problem"
    PLANNING = "an OLD plan: the changed problem is being planned"
    REFUSED = "an OLD plan: the changed problem cannot be met"
    SUGGESTED = "the plan of a suggested change: the problem as it is cannot be met"


@dataclass(frozen=True, eq=False)
class Status:
    """What is known of the newest text.

    Attributes
    ----------
    stage: how the plan that is there relates to it.
    words: what is being done, or what binds.
    suggestions: changes that make it feasible, verified.
    """

    stage: Stage
    words: str = ""
    suggestions: tuple[Suggestion, ...] = ()


class _StaleError(BaseException):
    """Ends the planning of a text that is no longer the newest.

    It is no Exception, so that planners which try another guess after a refusal do not go on.
    """


Planner = Callable[[Problem, Progress], Certified]
Repairer = Callable[[Problem, InfeasibleError, Progress], Sequence[Suggestion]]


def _suggested(
    problem: Problem, error: InfeasibleError, progress: Progress
) -> Sequence[Suggestion]:
    return find_suggestions(problem, error, progress=progress)


class Editing:
    """A problem that is edited by hand.

    Parameters
    ----------
    text: what the problem file holds.
    path: where it is saved; outlines of objects are beside it.
    planned: the plan of this text, or of a change that makes it feasible.
    plan, repair: what plans a problem, and what finds changes that make it feasible.
    status: how they relate; by default it is the plan of this text.

    Raises
    ------
    InputError, FileError: the text is no problem of a hitch.
    """

    def __init__(
        self,
        text: str,
        path: Path,
        planned: Certified,
        plan: Planner = solve_problem,
        repair: Repairer = _suggested,
        status: Status | None = None,
    ) -> None:
        self.path, self.planned = path, planned
        self.listener: Callable[[], None] = lambda: None
        self._plan, self._repair = plan, repair
        self._texts, self._place, self._version = [text], 0, 0
        self._on_disk = text if path.exists() else None
        self._changed = threading.Condition(threading.RLock())
        self._open = True
        self.problem = self._read(text)
        self.status = status or Status(Stage.CURRENT)
        self._worker = threading.Thread(target=self._work, daemon=True)
        self._worker.start()

    @property
    def text(self) -> str:
        """The problem file as it would be saved."""
        return self._texts[self._place]

    def now(self) -> tuple[str, Status, Certified]:
        """Return the text, what is known of it, and the plan that is there, of one moment."""
        with self._changed:
            return self.text, self.status, self.planned

    @property
    def saved(self) -> bool:
        """Whether the file on the disk holds this text."""
        return self.text == self._on_disk

    def change(self, text: str) -> None:
        """Go on with another text.

        Raises
        ------
        InputError, FileError: it is no problem of a hitch; nothing has changed.
        """
        with self._changed:
            problem = self._read(text)
            if text == self.text:
                return
            self._texts[self._place + 1 :] = [text]
            self._place += 1
            self._begin(problem)
        self.listener()

    def undo(self, steps: int = 1) -> bool:
        """Take changes back, or with a negative number make them again; return whether it can."""
        with self._changed:
            place = self._place - steps
            if not 0 <= place < len(self._texts):
                return False
            self._place = place
            self._begin(self._read(self.text))
        self.listener()
        return True

    def put(self, *edits: Edit) -> None:
        """Write values into the file; errors as of ``change``."""
        text = self.text
        for edit in edits:
            text = with_value(text, split_key(edit.key), edit.value)  # type: ignore[arg-type]
        self.change(text)

    def drag(self, index: int, name: str, place: Array) -> None:
        """Put a handle of a step to a place (3,) [m]; errors as of ``change``."""
        height = height_after(self.planned.motion, index)
        found = {h.name: h for h in handles(self.problem, parse_yaml(self.text), index, height)}
        if name not in found:
            raise InputError("handle", name, f"one of {', '.join(found)}", "choose another step")
        self.change(dragged(self.text, found[name], place))

    def add(self, index: int, kind: str) -> None:
        """Add a step of a kind after another one (START: before all); errors as of ``change``."""
        step = new_step(self.problem, index, kind, height_after(self.planned.motion, index))
        self.change(with_entry(self.text, MISSION, index + 1, step))

    def remove(self, index: int) -> None:
        """Remove a step; errors as of ``change``."""
        self.change(without_entry(self.text, MISSION, index))

    def move(self, index: int, to: int) -> None:
        """Put a step to another place in the mission; errors as of ``change``."""
        if not 0 <= to < len(self.problem.mission):
            raise InputError("mission", to, "the index of a step", "there is no place beyond it")
        self.change(with_entry_moved(self.text, MISSION, index, to))

    def apply(self, suggestion: Suggestion) -> None:
        """Make a suggested change; errors as of ``change``."""
        self.put(*suggestion.change.edits)

    def save(self) -> Path:
        """Write the problem file, and return where.

        Raises
        ------
        FileError: it cannot be written, or someone else has changed it meanwhile.
        """
        with self._changed:
            there = read_text(self.path)[0] if self.path.exists() else None
            if there not in (self._on_disk, self.text):
                raise FileError(
                    f"{self.path}: has been changed by someone else; move it away, then save again"
                )
            _write(self.path.resolve(), self.text)
            self._on_disk = self.text
        self.listener()
        return self.path

    def wait(self, seconds: float = 60.0) -> bool:
        """Wait until nothing is being computed; return whether that is so."""
        with self._changed:
            return self._changed.wait_for(lambda: self._idle, seconds)

    def close(self) -> None:
        """Stop planning."""
        with self._changed:
            self._open = False
            self._version += 1
            self._changed.notify_all()
        self._worker.join()

    def _read(self, text: str) -> Problem:
        problem = parse_problem(text, self.path.name, self.path.parent)
        if not isinstance(problem, Problem):
            raise InputError("team", "drones", "a team of catenary robots", "edit the file")
        return problem

    def _begin(self, problem: Problem) -> None:
        self.problem = problem
        self.status = Status(Stage.PLANNING)
        self._version += 1
        self._idle = False
        self._changed.notify_all()

    _idle = True

    def _work(self) -> None:
        """Plan the newest text, again and again."""
        while True:
            with self._changed:
                self._changed.wait_for(lambda: not self._open or not self._idle)
                if not self._open:
                    return
                version, problem = self._version, self.problem
            try:
                self._answer(version, problem)
            except _StaleError:
                continue
            with self._changed:
                if version == self._version:
                    self._idle = True
                    self._changed.notify_all()

    def _answer(self, version: int, problem: Problem) -> None:
        def tell(words: str) -> None:
            self._publish(version, replace(self.status, words=words))

        def go_on(_: str) -> None:
            if version != self._version:
                raise _StaleError

        try:
            planned = self._plan(problem, tell)
        except InfeasibleError as error:
            refused = Status(Stage.REFUSED, f"{error}\nlooking for changes that make it feasible …")
            self._publish(version, refused)
            found = tuple(self._repair(problem, error, go_on))
            words = str(error) if found else f"{error}\n{NO_CHANGE}"
            self._publish(version, Status(Stage.REFUSED, words, found))
        except HitchoptError as error:
            self._publish(version, Status(Stage.REFUSED, str(error)))
        except Exception as error:  # a fault of ours must not end the editing
            self._publish(version, Status(Stage.REFUSED, f"internal error: {error!r}"))
        else:
            self._publish(version, Status(Stage.CURRENT), planned)

    def _publish(self, version: int, status: Status, planned: Certified | None = None) -> None:
        with self._changed:
            if version != self._version:
                raise _StaleError
            self.status = status
            if planned is not None:
                self.planned = planned
        self.listener()


def _write(path: Path, text: str) -> None:
    """Write a file at once or not at all."""
    part = path.with_name(f".{path.name}.part")
    try:
        part.write_bytes(text.encode())
        os.replace(part, path)
    except OSError as error:
        raise FileError(f"{path}: cannot be written ({error.strerror}); check the path") from None
