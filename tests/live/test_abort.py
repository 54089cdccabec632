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
from hitchopt.live.abort import Abort, Aborts, abort_table
from hitchopt.motion.motion import CableState
from hitchopt.motion.plan_file import read_plan


@cache
def aborts_of(stem: str) -> Aborts:
    return Aborts(planned(stem).motion)


def check_abort(aborts: Aborts, time: float, how: str) -> Abort:
    """It is certified, the plan until it begins, and ends at rest, on the ground if it lands."""
    found, plan = aborts.found(time, how), aborts.motion
    whole = found.motion
    assert found.certificate.certified
    assert certify(whole, reports=()).certified
    assert found.start >= time
    until = np.linspace(0.0, min(found.start, plan.duration), 9)
    np.testing.assert_allclose(whole.drones.at(until), plan.drones.at(until), atol=1e-12)
    np.testing.assert_allclose(whole.drones.at(until, 2), plan.drones.at(until, 2), atol=1e-7)
    stopped = whole.drones.at(min(found.start + found.seconds, whole.duration))
    np.testing.assert_allclose(stopped, plan.drones.at(found.rest), atol=1e-9)
    assert np.max(np.abs(whole.drones.at(whole.duration, 1))) <= 1e-9
    lowest = np.min(whole.drones.at(whole.duration)[:, 2])
    assert how in ("hold", "back") or lowest == pytest.approx(0.0, abs=1e-9)
    return found


def test_a_hitch_is_held_lowered_and_untied() -> None:
    aborts = aborts_of("triangle")
    time = 0.31 * aborts.motion.duration
    held = check_abort(aborts, time, "hold")
    there = held.motion.drones
    at_rest = aborts.motion.drones.at(held.rest)
    np.testing.assert_allclose(there.at(there.duration), at_rest, atol=1e-12)
    for how in ("land", "release_and_land"):
        assert check_abort(aborts, time, how).motion.phases[-1].formed == (how == "land")
    with pytest.raises(ho.InfeasibleError, match="have not hung free before"):
        aborts.found(time, "back")


def test_going_back_unties_what_was_tied() -> None:
    aborts = aborts_of("form_triangle")
    free = next(p for p in reversed(aborts.motion.phases) if p.state is CableState.FREE)
    found = check_abort(aborts, aborts.motion.duration - 0.5, "back").motion
    assert found.phases[-1].state is CableState.FREE
    there = aborts.motion.drones.at(free.end)
    np.testing.assert_allclose(found.drones.at(found.duration), there, atol=1e-9)


@pytest.mark.parametrize("state", [CableState.CLASPING, CableState.TIGHTENING])
def test_while_a_hitch_is_tied_every_command_ends_in_rest(state: CableState) -> None:
    aborts = aborts_of("form_triangle")
    phase = next(p for p in aborts.motion.phases if p.state is state)
    check_abort(aborts, phase.start + 0.3 * (phase.end - phase.start), "hold")


def test_drones_land_where_a_hitch_is_untied() -> None:
    """A command in the last swap lets it go on to its end, wherever the clock has stopped."""
    plan = ho.release(ho.Hitch.spread(ho.Team(3, 2.4), [[0, -0.9], [-0.72, 0.45], [0.72, 0.45]]))
    found = check_abort(Aborts(plan.motion), 0.8 * plan.duration, "land")
    assert found.rest < 0.9 * plan.duration
    there, end = (each.drones.at(each.duration)[:, :2] for each in (found.motion, plan.motion))
    np.testing.assert_allclose(there, end, atol=1e-9)


def test_no_rest_while_tensions_rise() -> None:
    aborts = aborts_of("form_triangle")
    motion, last = aborts.motion, aborts.motion.phases[-1]
    assert np.ptp(motion.tensions.at(np.array([last.start, last.end]))) > 0.1
    found = check_abort(aborts, last.start + 0.3, "hold")
    assert (found.rest, found.seconds) == (motion.duration, 0.0)


def test_single_drones_land_where_they_stop() -> None:
    """Those of a stack end above each other: they can land only until they pass each other."""
    aborts = aborts_of("swarms/head_on")
    check_abort(aborts, 0.4 * aborts.motion.duration, "land")
    table = abort_table(aborts_of("swarms/stack").motion, "land", 0.5)
    assert table.missing == [(table.entries[-1].start, table.end)]
    with pytest.raises(ho.InfeasibleError, match="separation"):
        aborts_of("swarms/stack").found(2.2, "land")


def test_wrong_arguments_are_named() -> None:
    for time, how, key in ((-1.0, "hold", "t"), (1e3, "hold", "t"), (0.1, "stay", "how")):
        with pytest.raises(ho.InputError, match=f"^{key} "):
            aborts_of("triangle").found(time, how)


def test_the_command_writes_a_table_that_can_be_recomputed(tmp_path: Path) -> None:
    plan = planned("triangle")
    plan.save(tmp_path, rate=10.0)
    done = CliRunner().invoke(main, ["abort", str(tmp_path), "--how", "hold", "--every", "1"])
    assert done.exit_code == 0, done.output
    table = json.loads((tmp_path / "aborts.json").read_text())
    assert (table["how"], table["missing"]) == ("hold", [])
    starts, seconds = np.array([[e["start"], e["seconds"]] for e in table["entries"]]).T
    assert np.all(np.diff(starts) > 0.0)
    assert starts[-1] == pytest.approx(plan.duration)
    waits = starts + seconds - [0.0, *starts[:-1]]
    assert table["longest"] == pytest.approx(np.max(waits))
    with zipfile.ZipFile(tmp_path / "aborts.zip") as archive:
        assert archive.namelist() == [entry["plan"] for entry in table["entries"]]
        archive.extractall(tmp_path / "plans")
    for entry in table["entries"]:
        motion = read_plan(tmp_path / "plans" / entry["plan"])
        assert certify(motion, reports=()).certified
        assert motion.duration == pytest.approx(entry["ends"])


def test_legs_that_lean_against_friction_stand_straight_where_the_plan_rests() -> None:
    team = ho.Team(4, 2.2, cable_friction=0.1)
    start = ho.Hitch.balanced(team, regular_polygon(4, 1.0).vertices, 1.5)
    plan = ho.move_vertex(start, 0, by=[0.1, 0.1], limits=ho.Limits(speed=0.06))
    for how in ("land", "release_and_land"):
        found = check_abort(Aborts(plan.motion), 0.2 * plan.duration, how)
        assert (found.start, found.seconds) == (plan.duration, 0.0)


def test_heavy_hitches_on_rolled_legs_land() -> None:
    """What cables weigh on a clasp depends on its roll, which is found again at rest."""
    team = ho.Team(5, 2.2, tension=0.8, cable_density=0.01, load=0.01)
    roll = np.radians([10.0, 35.0, 0.0, -15.0, 20.0])
    hitch = ho.Hitch(team, regular_polygon(5, 1.0).vertices, 1.5, np.full(5, 0.6), roll)
    check_abort(Aborts(ho.transport(hitch, to=[0.5, 0.0, 1.5]).motion), 0.4, "land")
