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
from hitchopt.live.abort import Aborts, abort_table
from hitchopt.motion.motion import CableState
from hitchopt.motion.plan_file import read_plan

UNFORMED = "untied", "swarms/head_on"


@cache
def aborts_of(name: str) -> Aborts:
    """Aborts of a problem's plan, of a release, or of legs that are rolled, or lean."""
    if name == "untied":
        start = ho.Hitch.spread(ho.Team(3, 2.4), [[0, -0.9], [-0.72, 0.45], [0.72, 0.45]])
        return Aborts(ho.release(start).motion)
    if name == "rolled":  # what cables weigh on a clasp depends on its roll
        team, roll = (
            ho.Team(5, 2.2, tension=0.8, cable_density=0.01, load=0.01),
            [10, 35, 0, -15, 20],
        )
        corners = ho.regular_polygon(5, 1.0)
        start = ho.Hitch(team, corners, 1.5, np.full(5, 0.6), np.radians(roll))
        return Aborts(ho.transport(start, to=[0.5, 0.0, 1.5]).motion)
    if name == "leaning":
        team = ho.Team(4, 2.2, cable_friction=0.1)
        start = ho.Hitch.balanced(team, ho.regular_polygon(4, 1.0), 1.5)
        slow = ho.Limits(speed=0.06)
        return Aborts(ho.move_vertex(start, 0, by=[0.1, 0.1], limits=slow).motion)
    return Aborts(planned(name).motion)


@pytest.mark.parametrize(
    ("name", "share", "how"),
    [
        *(("triangle", 0.31, how) for how in ("hold", "land", "release_and_land")),
        ("form_triangle", 0.97, "back"),
        ("form_triangle", CableState.CLASPING, "hold"),
        ("form_triangle", CableState.TIGHTENING, "hold"),
        ("swarms/head_on", 0.4, "land"),
        ("untied", 0.8, "land"),  # the last swap goes on to its end, wherever the clock has stopped
        ("rolled", 0.1, "land"),
        ("leaning", 0.2, "land"),
        ("leaning", 0.2, "release_and_land"),
    ],
)
def test_commands_end_in_rest_as_they_say(name: str, share: float | CableState, how: str) -> None:
    plan = aborts_of(name).motion
    if isinstance(share, CableState):
        phase = next(p for p in plan.phases if p.state is share)
        share = (phase.start + 0.3 * (phase.end - phase.start)) / plan.duration
    found = aborts_of(name).found(share * plan.duration, how)
    whole = found.motion
    assert found.certificate.certified
    assert certify(whole, part=True).certified
    assert found.start >= share * plan.duration
    until = np.linspace(0.0, min(found.start, plan.duration), 9)
    np.testing.assert_allclose(whole.drones.at(until), plan.drones.at(until), atol=1e-12)
    np.testing.assert_allclose(whole.drones.at(until, 2), plan.drones.at(until, 2), atol=1e-7)
    stopped = whole.drones.at(min(found.start + found.seconds, whole.duration))
    np.testing.assert_allclose(stopped, plan.drones.at(found.rest), atol=1e-9)
    assert np.max(np.abs(whole.drones.at(whole.duration, 1))) <= 1e-9
    end, last, free = whole.drones.at(whole.duration), whole.phases[-1], CableState.FREE
    if how in ("hold", "back"):
        at = [found.rest] if how == "hold" else [p.end for p in plan.phases if p.state is free]
        np.testing.assert_allclose(end, plan.drones.at(at[-1]), atol=1e-9)
        assert how == "hold" or last.state is free
    else:
        assert np.min(end[:, 2]) == pytest.approx(0.0, abs=1e-9)
        assert last.formed == (how == "land" and name not in UNFORMED)
    if name == "untied":
        assert found.rest < 0.9 * plan.duration
        np.testing.assert_allclose(end[:, :2], plan.drones.at(plan.duration)[:, :2], atol=1e-9)
    if name == "leaning":  # they stand straight where the plan rests
        assert (found.start, found.seconds) == (plan.duration, 0.0)


def test_no_rest_while_tensions_rise() -> None:
    motion, last = aborts_of("form_triangle").motion, aborts_of("form_triangle").motion.phases[-1]
    assert np.ptp(motion.tensions.at(np.array([last.start, last.end]))) > 0.1
    found = aborts_of("form_triangle").found(last.start + 0.3, "hold")
    assert (found.rest, found.seconds) == (motion.duration, 0.0)


def test_what_cannot_be_is_refused() -> None:
    """Drones of a stack end above each other: they can land only until they pass each other."""
    table = abort_table(aborts_of("swarms/stack").motion, "land", 0.5)
    assert table.missing == [(table.entries[-1].start, table.end)]
    with pytest.raises(ho.InfeasibleError, match="separation"):
        aborts_of("swarms/stack").found(2.2, "land")
    with pytest.raises(ho.InfeasibleError, match="have not hung free before"):
        aborts_of("triangle").found(1.0, "back")
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
        assert certify(motion, part=True).certified
        assert motion.duration == pytest.approx(entry["ends"])
