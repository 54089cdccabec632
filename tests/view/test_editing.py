"""Editing by hand, without a browser: changes, undo, stale plans, refusals and saved files."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

import hitchopt as ho
from hitchopt.cli import main
from hitchopt.errors import FileError
from hitchopt.mission.loading import parse_problem
from hitchopt.mission.problem import STEP
from hitchopt.mission.teams import CertifiedFlight
from hitchopt.motion.states import flight_states_at
from hitchopt.steps import STEPS
from hitchopt.steps.knob import Edit
from hitchopt.storage.yaml_file import parse_yaml
from hitchopt.view.editing import (
    START,
    Editing,
    Handle,
    PlanState,
    handles,
    height_after,
    new_step,
    outlines,
)
from tests.helpers.plans import PROBLEMS, planned, planned_of

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


@pytest.fixture
def editing(tmp_path: Path) -> Iterator[Editing]:
    path = tmp_path / "problem.yaml"
    path.write_text(TEXT)
    problem: Any = parse_yaml(TEXT, "problem")
    plan = planned_of(problem)
    editing = Editing(TEXT, path, CertifiedFlight(plan.flight, plan.certificate))
    yield editing
    editing.close()


def test_steps_that_open_vertices_have_no_handles() -> None:
    path, plan = PROBLEMS / "lay_hexagon.yaml", planned("lay_hexagon")
    editing = Editing(path.read_text(), path, CertifiedFlight(plan.flight, plan.certificate))
    steps = range(len(editing.problem.mission))
    assert [bool(editing.handles(index)) for index in steps] == [True, *[False] * (len(steps) - 1)]
    corners = [outline and len(outline.vertices) for outline in outlines(editing.problem.teams[""])]
    assert corners[:5] == [None, 6, 6, 6, 6]
    heights = [height_after(plan.motion, index) for index in range(4)]
    np.testing.assert_allclose(heights, 1.5, atol=1e-9)
    editing.close()


SECONDS = "mission[1].hold.seconds"


def test_a_dragged_vertex_is_planned_certified_and_saved(editing: Editing) -> None:
    path = editing.path
    assert editing.saved
    editing.drag(0, "vertex 0", np.array([1.05, -0.25, 1.2]))
    assert editing.wait()
    assert editing.status.stage is PlanState.CURRENT
    assert editing.planned.certificate.certified
    end = flight_states_at(editing.planned.flight, editing.planned.flight.duration)
    np.testing.assert_allclose(end.vertices[0], [1.05, -0.25, 1.2], atol=1e-9)
    assert editing.text == TEXT.replace("by: [0.0, 0.2]", "by: [0.05, 0.25]")
    assert not editing.saved
    assert editing.save() == path
    assert editing.saved
    assert path.read_text() == editing.text
    assert [p.name for p in path.parent.iterdir()] == ["problem.yaml"]
    path.write_text("other")
    editing.put(Edit(SECONDS, 3.0))
    with pytest.raises(FileError, match="by another program"):
        editing.save()
    assert path.read_text() == "other"


def test_while_a_plan_is_made_the_old_one_is_called_old_and_stale_ones_go(
    editing: Editing,
) -> None:
    first, stages = editing.planned, list[PlanState]()
    free, entered = threading.Event(), threading.Semaphore(0)

    def listen() -> None:
        stages.append(editing.status.stage)
        if threading.current_thread() is not threading.main_thread():  # a planner at work
            entered.release()
            assert free.wait(30.0)

    editing.listener = listen
    assert [height_after(first.flight.teams[0].motion, i) for i in (START, 1)] == pytest.approx(
        [1.2, 1.2]
    )
    editing.put(Edit(SECONDS, 5.0))
    assert entered.acquire(timeout=30.0)
    editing.put(Edit(SECONDS, 2.0))
    text, status, planned = editing.now()
    assert ("2.0" in text, status.stage, planned) == (True, PlanState.PLANNING, first)
    free.set()
    assert editing.wait()
    duration = first.flight.duration + 1.0
    assert editing.planned.flight.duration == pytest.approx(duration, abs=1e-6)
    assert stages.count(PlanState.CURRENT) == 1


def test_changes_are_undone_and_made_again(editing: Editing) -> None:
    first = editing.planned
    assert not editing.undo()
    editing.remove(1)
    removed = editing.text
    editing.add(0, "hold")
    assert len(editing.problem.mission) == 2
    for text in (removed, TEXT):
        assert editing.undo()
        assert editing.text == text
    assert editing.wait()
    assert editing.planned.flight.duration == first.flight.duration
    assert editing.undo(-1)
    assert editing.text == removed
    editing.put(Edit("mission[0].move_vertex.by", [0.0, 0.1]))
    assert not editing.undo(-1)  # the other branch is gone
    editing.change(TEXT)
    editing.move(1, 0)
    assert "mission:\n  - hold: {seconds: 1.0}  # rest\n  # one vertex\n  - move" in editing.text
    with pytest.raises(ho.InputError, match="index of a step"):
        editing.move(0, 2)


def test_what_is_no_problem_changes_nothing(editing: Editing) -> None:
    before = editing.now()
    with pytest.raises(ho.InputError, match=r"mission\[1\]\.hold\.seconds"):
        editing.put(Edit(SECONDS, -1.0))
    with pytest.raises(ho.InputError, match="one of vertex 0"):
        editing.drag(0, "edge 2", np.zeros(3))
    assert editing.now() == before


ELSEWHERE = {"vertex": 0, "path": [[0.0, 9.0, 9.0], [2.0, 1.0, -0.5]]}
"""A path that does not begin at its vertex."""


def test_what_binds_is_told_and_a_suggestion_can_be_taken(editing: Editing) -> None:
    first = editing.planned
    editing.change(f"{TEXT}  - follow_vertex: {json.dumps(ELSEWHERE)}\n")
    assert editing.wait()
    _, status, planned = editing.now()
    assert (status.stage, status.suggestions, planned) == (PlanState.REFUSED, (), first)
    assert "no change was found" in status.words
    editing.change(TEXT)
    editing.put(Edit("team.cable_length", 1.6))
    assert editing.wait()
    _, status, planned = editing.now()
    assert (status.stage, planned.flight) == (PlanState.REFUSED, editing.planned.flight)
    assert "no change was found" not in status.words
    editing.put(*status.suggestions[0].change.edits)
    assert editing.wait()
    assert editing.status.stage is PlanState.CURRENT
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

    def handles_of(text: str) -> dict[str, Handle]:
        problem = parse_problem(text)
        assert isinstance(problem, ho.Problem)
        return {each.name: each for each in handles(problem, parse_yaml(text), index, 1.0)}

    handled = handles_of(STEPPED)
    for name in ("edge 1", "edge 3") if "edge 3" in handled and "vertex 0" in handled else ():
        ends = [handled[f"vertex {(int(name[-1]) + i) % 4}"].place for i in (0, 1)]
        np.testing.assert_allclose(handled[name].place, np.mean(ends, axis=0), atol=1e-9)
    for name, handle in handled.items():
        by = np.array([0.02, -0.03, 0.04 if handle.vertical else 0.0])
        again = handles_of(handle.dragged(STEPPED, handle.place + by))
        np.testing.assert_allclose(again[name].place, handle.place + by, atol=1e-8)
        assert handle.dragged(STEPPED, handle.place) == STEPPED


@pytest.mark.parametrize("kind", [step.name for step in STEPS])
def test_a_new_step_is_one_that_a_file_may_have(kind: str) -> None:
    problem = parse_problem(STEPPED)
    assert isinstance(problem, ho.Problem)
    for index in (START, 0):
        STEP.check("", new_step(problem, index, kind, 1.0))


def test_a_problem_file_is_planned_and_shown_or_refused(tmp_path: Path) -> None:
    file, page = tmp_path / "problem.yaml", tmp_path / "plan.html"
    command = ["view", str(file), "--save", str(page)]
    file.write_text(TEXT.replace("[2.4, 2.5, 2.4]", "1.9"))  # legs too short to keep apart
    result = CliRunner().invoke(main, command)
    assert (result.exit_code, page.exists()) == (3, False)
    assert "error: separation: " in result.output
    file.write_text(TEXT)
    assert CliRunner().invoke(main, command).exit_code == 0
    assert "# A triangle off the origin." in page.read_text()
