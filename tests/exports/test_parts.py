"""Parts of plans that do not fit in a drone's memory: where they are cut, how they rest there."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import hitchopt as ho
from hitchopt.cli import main
from hitchopt.exports.contents import read_manifest
from hitchopt.exports.format import ExportTask, format_of
from hitchopt.exports.held_tension import REST_TIME, held_tension
from hitchopt.exports.parts import cut_into_parts
from hitchopt.motion.motion import Phase
from tests.helpers.exported_plans import swarm_of, task_of
from tests.helpers.plans import GOOD, planned

MISSION = "tie_carry_untie"


@cache
def mission_task(*, holds_tension: bool) -> ExportTask:
    task = task_of(planned(MISSION).motion, "crazyswarm2")
    if not holds_tension:
        return task
    return replace(task, flight=held_tension(task.flight).flight, without_offsets=task.flight)


def end_of(name: str) -> float:
    (phase,) = (phase for phase in planned(MISSION).motion.phases if phase.name == name)
    return phase.end


def test_a_mission_is_cut_where_it_rests_and_rests_longer_there(tmp_path: Path) -> None:
    plan = planned(MISSION)
    with pytest.raises(ho.InfeasibleError, match=r"memory: .* add steps such as hold"):
        plan.export("crazyswarm2", tmp_path / "refused", longer_rests=False)
    assert not (tmp_path / "refused").exists()
    parts = plan.export("crazyswarm2", tmp_path / "show")
    assert len(parts) > 1
    spans = (read_manifest(tmp_path / "show") or {})["plan_spans"]
    begun = [*(begins for begins, _ in spans), plan.duration]
    assert [0.0, *(end for _, end in spans)] == pytest.approx(begun)
    (said,) = {note for part in parts for note in part.notes if "are extended by" in note}
    assert f"({REST_TIME * (len(parts) - 1):g} s in total)" in said
    names, kind = plan.motion.team.drone_names, format_of("crazyswarm2")
    ends = []
    for part, (begins, until) in zip(parts, spans, strict=True):
        assert (read_manifest(part.folder) or {})["plan_span"] == pytest.approx([begins, until])
        files = [part.folder / f"{name}.csv" for name in names]
        (curves,) = kind.load(files).windows()
        assert curves.duration == pytest.approx(until - begins + REST_TIME, abs=2e-3)
        assert np.max(np.abs(curves.at(curves.breaks[-1], 1))) < 1e-3  # where drones hover,
        ends.append((curves.at(0.0), curves.at(curves.breaks[-1])))
    for (_, last), (first, _) in pairwise(ends):
        np.testing.assert_allclose(first, last, atol=2e-3)  # and go on from


def test_no_part_is_a_take_off_alone() -> None:
    """Parts of any size cover the plan in order; too small ones are refused."""
    task, counts = mission_task(holds_tension=False), list[int]()
    take_off = end_of("take-off")
    for seconds in np.linspace(0.5 * take_off, 2.5 * take_off, 9).tolist():

        def fits(part: ExportTask, seconds: float = seconds) -> bool:
            return part.flight.duration <= seconds

        parts = cut_into_parts(task, fits)
        counts.append(len(parts))
        joints = [part.begins for part in parts]
        assert not np.any(np.isclose(joints, take_off))
        assert all(part.flight.duration <= seconds for part in parts)
        ends = [part.begins + part.flight.duration for part in parts]
        np.testing.assert_allclose(ends, [*joints[1:], task.flight.duration] if parts else [])
    assert counts[0] == 0
    assert counts[-1] > 1


@pytest.mark.parametrize(("latest", "cut"), [("relax", "hold"), ("unswap 2", "hold")])
def test_parts_end_where_the_longer_rest_is_certified(latest: str, cut: str) -> None:
    """Not where cables are hitched without tension; where they are taut, if that is no more parts.

    Each part's setpoints rest at its start and, after the longer rest, at its end.
    """
    task, end, whole = mission_task(holds_tension=True), end_of(latest), planned(MISSION).duration
    longest = max(end, whole - end_of(cut)) + REST_TIME + 1e-6

    def fits(part: ExportTask) -> bool:
        return part.flight.duration <= longest

    parts = cut_into_parts(task, fits)
    assert len(parts) == 2
    assert parts[1].begins == pytest.approx(end_of(cut))
    for part in parts:
        first, last = (part.flight.drones.ends(1)[side][index] for side, index in ((0, 0), (1, -1)))
        assert np.max(np.abs(first)) < 1e-9
        assert np.max(np.abs(last)) < 1e-3


def over_travelling_task(sizes: list[float]) -> ExportTask:
    """Two moves of five drones, with over-travels of some sizes [m] about each goal, and a rest.

    Over-travels last a second each.
    """
    start = np.random.default_rng(3).uniform(-2.0, 2.0, (5, 3)) + [1.0, -2.0, 4.0]
    places, breaks, phases = [start], [0.0], list[Phase]()
    for shift in ([0.3, 0.1, 0.0], [-0.2, 0.4, 0.1]):
        goal = places[-1] + shift
        beyond = [goal + [size, 0.0, 0.0] for size in sizes]
        for name, stops in (("morph", [goal]), ("settle", [*beyond, goal, goal]), ("hold", [goal])):
            begin = breaks[-1]
            breaks += [begin + 1.0 + i for i in range(len(stops))]
            places += stops
            phases.append(Phase(name, len(phases), begin, breaks[-1]))
    motion = swarm_of(np.array(places), np.array(breaks))
    return task_of(motion.replaced(phases=tuple(phases)), "crazyswarm2")


def test_parts_end_at_goals_rather_than_within_over_travels() -> None:
    """Where no goal fits, they end at the smallest over-travel, and a note says so."""
    sizes = [0.28, -0.23, 0.17, -0.12, 0.07, -0.03]
    task = over_travelling_task(sizes)
    off_goal = dict.fromkeys(task.flight.breaks.tolist(), 0.0)  # of rests [m]
    for settle in (phase for phase in task.flight.phases if phase.name == "settle"):
        off_goal |= {settle.start + 1.0 + i: abs(size) for i, size in enumerate(sizes)}
    counts = list[int]()  # of parts that end within over-travels
    for seconds in range(2, 21):

        def fits(part: ExportTask, seconds: int = seconds) -> bool:
            return part.flight.duration <= seconds

        parts = cut_into_parts(task, fits)
        joints = [part.begins for part in parts[1:]]
        for start, joint in zip([0.0, *joints], joints, strict=False):
            reached = [off for rest, off in off_goal.items() if start < rest <= start + seconds]
            assert off_goal[joint] == min(reached)
        within = [joint for joint in joints if off_goal[joint]]
        notes = [note for note in parts[0].notes if "reaches a goal" in note] if parts else []
        assert len(notes) == len(within)
        for note, joint in zip(notes, within, strict=True):
            distance = f"{100.0 * off_goal[joint]:.2g} cm from where settle ends"
            assert f"ends at t = {joint:.3f} s leaves drones up to {distance}" in note
        counts.append(len(within))
    assert counts[0] > 0
    assert counts[10] == 0


def is_named(path: Path) -> bool:
    kinds = {"controller:", "model:", "quadrotor: paper_132g", "quadrotor: crazyflie"}
    return any(kind in path.read_text("utf-8") for kind in kinds)


FAST = ("crazyflie_triangle", "form_triangle")
NAMED = [
    pytest.param(path.stem, marks=() if path.stem in FAST else pytest.mark.slow)
    for path in GOOD
    if is_named(path)
]


@pytest.mark.parametrize("name", NAMED)
def test_problems_with_named_drones_export_to_crazyflies(name: str, tmp_path: Path) -> None:
    """As they are, with the tension of their cables."""
    parts = planned(name).export("crazyswarm2", tmp_path)
    assert not any(part.goes_slack for part in parts)


@pytest.mark.slow
def test_the_problem_of_init_exports_to_crazyflies(tmp_path: Path) -> None:
    path = tmp_path / "problem.yaml"
    done = CliRunner().invoke(main, ["init", str(path)])
    assert done.exit_code == 0, done.output
    plan = ho.solve(path)
    parts = plan.export("crazyswarm2", tmp_path / "show")
    assert len(parts) > 1
    assert not any(part.goes_slack for part in parts)
    ends = [phase.end for phase in plan.motion.phases]
    for part in parts[1:]:
        assert min(abs(part.begins - end) for end in ends) < 1e-6
    assert not any("reaches a goal" in note for part in parts for note in part.notes)
