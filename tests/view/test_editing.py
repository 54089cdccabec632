"""Editing by hand, without a browser: changes, undo, stale plans, refusals and saved files."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import hitchopt as ho
from hitchopt.cli import main
from hitchopt.errors import Progress
from hitchopt.mission.keys import StepKeys
from hitchopt.mission.loading import parse_problem
from hitchopt.mission.problem import Problem
from hitchopt.mission.repair import Change, Edit, Suggestion
from hitchopt.mission.solving import solve_problem
from hitchopt.motion.states import states_at
from hitchopt.steps import STEPS
from hitchopt.steps.certified_motions import Certified
from hitchopt.storage.yaml_file import parse_yaml
from hitchopt.view.editing import (
    START,
    Editing,
    Handle,
    Stage,
    Status,
    handles,
    height_after,
    new_step,
)

TEXT = """\
# A triangle off the origin.
team: {robots: 3, cable_length: [2.4, 2.5, 2.4]}  # unequal
start:
  hitch: {polygon: [[1.0, -0.5], [0.6, 1.0], [1.4, 1.0]], altitude: 1.2}
mission:
  # one vertex
  - move_vertex: {vertex: 0, by: [0.0, 0.2]}
  - hold: {seconds: 1.0}  # rest
"""


class Desk:
    """An editing of TEXT whose planner waits where a test tells it to."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.path = folder / "problem.yaml"
        self.path.write_text(TEXT)
        plan = ho.solve(self.path)
        self.first = Certified(plan.motion, plan.certificate)
        self.free, self.begun = threading.Event(), threading.Semaphore(0)
        self.free.set()
        self.planned: list[Problem] = []
        self.repairs: tuple[Suggestion, ...] = ()
        self.seen: list[Status] = []
        monkeypatch.setattr("hitchopt.view.editing.solve_problem", self._plan)
        monkeypatch.setattr("hitchopt.view.editing.find_suggestions", self._repair)
        self.editing = Editing(TEXT, self.path, self.first)
        self.editing.listener = lambda: self.seen.append(self.editing.status)

    def _plan(self, problem: Problem, progress: Progress) -> Certified:
        self.planned.append(problem)
        self.begun.release()
        assert self.free.wait(30.0)
        progress("going on")
        return solve_problem(problem, progress)

    def _repair(
        self, problem: Problem, error: ho.InfeasibleError, *, progress: Progress
    ) -> tuple[Suggestion, ...]:
        progress("looking")
        assert error.violations
        assert problem is self.planned[-1]
        return self.repairs


@pytest.fixture
def desk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Desk]:
    made = Desk(tmp_path, monkeypatch)
    yield made
    made.free.set()
    made.editing.close()


SECONDS = "mission[1].hold.seconds"


def test_a_dragged_vertex_is_planned_certified_and_saved(desk: Desk) -> None:
    editing = desk.editing
    assert editing.saved
    editing.drag(0, "vertex 0", np.array([1.05, -0.25, 1.2]))
    assert editing.wait()
    assert editing.status.stage is Stage.CURRENT
    assert editing.planned.certificate.certified
    end = states_at(editing.planned.motion, editing.planned.motion.duration)
    np.testing.assert_allclose(end.vertices[0], [1.05, -0.25, 1.2], atol=1e-9)
    assert editing.text == TEXT.replace("by: [0.0, 0.2]", "by: [0.05, 0.25]")
    assert not editing.saved
    assert editing.save() == desk.path
    assert editing.saved
    assert desk.path.read_text() == editing.text
    assert [p.name for p in desk.path.parent.iterdir()] == ["problem.yaml"]
    desk.path.write_text("other")
    editing.put(Edit(SECONDS, 3.0))
    with pytest.raises(ho.FileError, match="by someone else"):
        editing.save()
    assert desk.path.read_text() == "other"


def test_while_a_plan_is_made_the_old_one_is_called_old_and_stale_ones_go(desk: Desk) -> None:
    editing, first = desk.editing, desk.first.motion
    desk.free.clear()
    editing.put(Edit(SECONDS, 5.0))
    assert [height_after(first, i) for i in (START, 1)] == pytest.approx([1.2, 1.2])
    assert desk.begun.acquire(timeout=30.0)
    editing.put(Edit(SECONDS, 2.0))
    text, status, planned = editing.now()
    assert "2.0" in text
    assert status.stage is Stage.PLANNING
    assert planned is desk.first
    desk.free.set()
    assert editing.wait()
    assert len(desk.planned) == 2
    assert editing.planned.motion.duration == pytest.approx(first.duration + 1.0, abs=1e-6)
    assert [s.stage for s in desk.seen].count(Stage.CURRENT) == 1


def test_changes_are_undone_and_made_again(desk: Desk) -> None:
    editing = desk.editing
    assert not editing.undo()
    editing.remove(1)
    removed = editing.text
    editing.add(0, "hold")
    assert len(editing.problem.mission) == 2
    for text in (removed, TEXT):
        assert editing.undo()
        assert editing.text == text
    assert editing.wait()
    assert editing.planned.motion.duration == desk.first.motion.duration
    assert editing.undo(-1)
    assert editing.text == removed
    editing.put(Edit("mission[0].move_vertex.by", [0.0, 0.1]))
    assert not editing.undo(-1)  # the other branch is gone
    editing.change(TEXT)
    editing.move(1, 0)
    assert "mission:\n  - hold: {seconds: 1.0}  # rest\n  # one vertex\n  - move" in editing.text
    with pytest.raises(ho.InputError, match="index of a step"):
        editing.move(0, 2)


def test_what_is_no_problem_changes_nothing(desk: Desk) -> None:
    with pytest.raises(ho.InputError, match=r"mission\[1\]\.hold\.seconds"):
        desk.editing.put(Edit(SECONDS, -1.0))
    with pytest.raises(ho.InputError, match="one of vertex 0"):
        desk.editing.drag(0, "edge 2", np.zeros(3))
    assert desk.editing.now() == (TEXT, desk.editing.status, desk.first)
    assert desk.editing.status.stage is Stage.CURRENT
    assert not desk.planned


def test_what_binds_is_told_and_a_suggestion_can_be_taken(desk: Desk) -> None:
    editing, edit = desk.editing, Edit("team.cable_length", 2.4)
    for length, told in ((1.6, "no single change"), (1.61, "")):
        editing.put(Edit("team.cable_length", length))
        assert editing.wait()
        assert editing.status.stage is Stage.REFUSED
        assert told in editing.status.words
        assert editing.planned is desk.first
        assert editing.status.suggestions == desk.repairs
        names = ("team.cable_length", "", 1.6, 2.4, "m", 0.5)
        desk.repairs = (Suggestion(Change(*names, desk.planned[-1], (edit,)), 2.0),)
    editing.put(*desk.repairs[0].change.edits)
    assert editing.wait()
    assert editing.now()[1].stage is Stage.CURRENT
    assert editing.planned.certificate.certified


STEPPED = """\
team: {robots: 4, cable_length: 2.4}
objects:
  box: {outline: [[0, 0], [0.1, 0], [0.1, 0.1]], to: 0.2, mass: 0.1, at: [3, 1, 0]}
start:
  drones:
    q: [[-0.9, -0.5, 0], [-0.5, 0.9, 0], [0.9, 0.5, 0], [0.5, -0.9, 0]]
    r: [[-0.9, 0.5, 0], [0.5, 0.9, 0], [0.9, -0.5, 0], [-0.5, -0.9, 0]]
mission:
  - form: {polygon: [[-0.5, -0.5], [-0.5, 0.5], [0.5, 0.5], [0.5, -0.5]]}
  - morph: {polygon: [[-0.6, -0.5], [-0.5, 0.5], [0.5, 0.5], [0.5, -0.5]]}
  - move_edge: {edge: 3, to: [[0.6, -0.6], [-0.6, -0.6]]}
  - move_vertex: {vertex: 1, to: [-0.6, 0.5]}
  - follow_vertex: {vertex: 1, path: [[2.0, -0.5, 0.5]]}
  - transport: {to: [0.5, 0, 1.3]}
  - hold: {seconds: 1}
"""


@pytest.mark.parametrize("index", range(START, 6))
def test_a_handle_goes_where_it_is_dragged(index: int) -> None:
    """Dragged by a vector, every handle is found again at its place plus that vector."""

    def found(text: str) -> dict[str, Handle]:
        problem = parse_problem(text)
        assert isinstance(problem, Problem)
        return {each.name: each for each in handles(problem, parse_yaml(text), index, 1.0)}

    handled = found(STEPPED)
    for name in ("edge 1", "edge 3") if "edge 3" in handled and "vertex 0" in handled else ():
        ends = [handled[f"vertex {(int(name[-1]) + i) % 4}"].place for i in (0, 1)]
        np.testing.assert_allclose(handled[name].place, np.mean(ends, axis=0), atol=1e-9)
    for name, handle in handled.items():
        by = np.array([0.02, -0.03, 0.04 if handle.vertical else 0.0])
        again = found(handle.dragged(STEPPED, handle.place + by))
        np.testing.assert_allclose(again[name].place, handle.place + by, atol=1e-8)
        assert handle.dragged(STEPPED, handle.place) == STEPPED


@pytest.mark.parametrize("kind", [step.name for step in STEPS])
def test_a_new_step_is_one_that_a_file_may_have(kind: str) -> None:
    problem = parse_problem(STEPPED)
    assert isinstance(problem, Problem)
    for index in (START, 0):
        StepKeys.model_validate(new_step(problem, index, kind, 1.0))


def test_a_problem_file_is_planned_and_shown_or_refused(tmp_path: Path) -> None:
    file, page = tmp_path / "problem.yaml", tmp_path / "plan.html"
    command = ["view", str(file), "--save", str(page)]
    file.write_text(TEXT.replace("[2.4, 2.5, 2.4]", "1.9"))  # legs too short to keep apart
    done = CliRunner().invoke(main, command)
    assert (done.exit_code, page.exists()) == (3, False)
    assert "error: separation: " in done.output
    file.write_text(TEXT)
    assert CliRunner().invoke(main, command).exit_code == 0
    assert "# A triangle off the origin." in page.read_text()
