"""Aborts: the plan until the command's stop, then a certified continuation to rest."""

from __future__ import annotations

import json
import zipfile
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from plans import planned

import hitchopt as ho
from hitchopt.checks import certify
from hitchopt.cli import main
from hitchopt.geometry import regular_polygon
from hitchopt.live.abort import Abort, Aborts
from hitchopt.mission.loading import problem_from_dict
from hitchopt.motion.motion import CableState
from hitchopt.motion.plan_file import read_plan


@cache
def aborts_of(stem: str) -> Aborts:
    return Aborts(planned(stem).motion)


def check_abort(aborts: Aborts, time: float, how: str) -> Abort:
    """It is certified, the plan until it begins, and ends at rest."""
    found = aborts.found(time, how)
    whole, plan = found.motion, ho.Plan(aborts.motion, found.certificate)
    assert found.certificate.certified
    assert found.start >= time
    until = np.linspace(0.0, min(found.start, aborts.motion.duration), 9)
    mine = ho.Plan(whole, found.certificate).at(until)
    np.testing.assert_allclose(mine.positions, plan.at(until).positions, atol=1e-12)
    np.testing.assert_allclose(mine.accelerations, plan.at(until).accelerations, atol=1e-7)
    assert np.max(np.abs(whole.drones.at(whole.duration, 1))) <= 1e-9
    return found


def test_a_hitch_is_held_lowered_and_untied() -> None:
    aborts = aborts_of("triangle")
    time = 0.31 * aborts.motion.duration
    held = check_abort(aborts, time, "hold")
    there = held.motion.drones
    np.testing.assert_allclose(
        there.at(there.duration), aborts.motion.drones.at(held.rest), atol=1e-12
    )
    for how in ("land", "release_and_land"):
        ended = check_abort(aborts, time, how).motion
        heights = ended.drones.at(ended.duration)[:, 2]
        assert np.min(heights) == pytest.approx(0.0, abs=1e-9)
        assert ended.phases[-1].formed == (how == "land")
    with pytest.raises(ho.InfeasibleError, match="have not hung free before"):
        aborts.found(time, "back")


def test_going_back_unties_what_was_tied() -> None:
    aborts = aborts_of("form_triangle")
    free = next(p for p in reversed(aborts.motion.phases) if p.state is CableState.FREE)
    found = check_abort(aborts, aborts.motion.duration - 0.5, "back").motion
    assert found.phases[-1].state is CableState.FREE
    np.testing.assert_allclose(
        found.drones.at(found.duration), aborts.motion.drones.at(free.end), atol=1e-9
    )


@pytest.mark.parametrize("state", [CableState.CLASPING, CableState.TIGHTENING])
def test_while_a_hitch_is_tied_every_command_ends_in_rest(state: CableState) -> None:
    aborts = aborts_of("form_triangle")
    phase = next(p for p in aborts.motion.phases if p.state is state)
    check_abort(aborts, phase.start + 0.3 * (phase.end - phase.start), "hold")


def test_single_drones_land_where_they_stop() -> None:
    aborts = aborts_of("swarms/head_on")
    found = check_abort(aborts, 0.4 * aborts.motion.duration, "land")
    whole = found.motion
    assert np.max(whole.drones.at(whole.duration)[:, 2]) == pytest.approx(0.0, abs=1e-9)


def test_single_drones_that_end_above_each_other_go_back_to_land() -> None:
    """They can land only where they are passing each other."""
    aborts = aborts_of("swarms/stack")
    found = check_abort(aborts, 2.2, "land").motion
    assert np.max(found.drones.at(found.duration)[:, 2]) == pytest.approx(0.0, abs=1e-9)


def test_wrong_arguments_are_named() -> None:
    aborts = aborts_of("triangle")
    for time, how, key in ((-1.0, "hold", "t"), (1e3, "hold", "t"), (0.1, "stay", "how")):
        with pytest.raises(ho.InputError) as found:
            aborts.found(time, how)
        assert found.value.key == key


def test_the_command_writes_a_table_that_can_be_recomputed(tmp_path: Path) -> None:
    plan = planned("triangle")
    plan.save(tmp_path, rate=10.0)
    done = CliRunner().invoke(main, ["abort", str(tmp_path), "--how", "hold", "--every", "1"])
    assert done.exit_code == 0, done.output
    table = json.loads((tmp_path / "aborts.json").read_text())
    assert (table["how"], table["missing"]) == ("hold", [])
    starts = [entry["start"] for entry in table["entries"]]
    assert starts == sorted(starts)
    assert starts[-1] == pytest.approx(plan.duration)
    rests = [entry["start"] + entry["seconds"] for entry in table["entries"]]
    waits = [rest - begin for rest, begin in zip(rests, [0.0, *starts], strict=False)]
    assert table["longest"] == pytest.approx(max(waits))
    with zipfile.ZipFile(tmp_path / "aborts.zip") as archive:
        assert archive.namelist() == [entry["plan"] for entry in table["entries"]]
        archive.extractall(tmp_path / "plans")
    for entry in table["entries"]:
        motion = read_plan(tmp_path / "plans" / entry["plan"])
        assert certify(motion, part=True).certified
        assert motion.duration == pytest.approx(entry["ends"])


def test_legs_that_lean_against_friction_stand_straight_where_the_plan_rests() -> None:
    polygon = regular_polygon(4, 1.0).vertices.tolist()
    problem = {
        "team": {"robots": 4, "cable_length": 2.2, "cable_friction": 0.1},
        "limits": {"speed": 0.06},
        "start": {"hitch": {"polygon": polygon, "altitude": 1.5}},
        "mission": [{"move_vertex": {"vertex": 0, "by": [0.1, 0.1]}}],
    }
    aborts = Aborts(ho.solve(problem_from_dict(problem)).motion)
    for how in ("land", "release_and_land"):
        found = check_abort(aborts, 0.2 * aborts.motion.duration, how)
        assert found.start == aborts.motion.duration
        assert found.seconds == 0.0


def test_heavy_hitches_on_rolled_legs_land() -> None:
    """What cables weigh on a clasp depends on its roll, which is found again at rest."""
    team = ho.Team(5, 2.2, tension=0.8, cable_density=0.01, load=0.01)
    roll = np.radians([10.0, 35.0, 0.0, -15.0, 20.0])
    hitch = ho.Hitch(team, regular_polygon(5, 1.0).vertices, 1.5, np.full(5, 0.6), roll)
    aborts = Aborts(ho.transport(hitch, to=[0.5, 0.0, 1.5]).motion)
    whole = check_abort(aborts, 0.4, "land").motion
    assert whole.duration > aborts.motion.duration
