"""Aborts end at rest as commanded."""

from __future__ import annotations

import json
import zipfile
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import hitchopt as ho
from hitchopt.checks import certify
from hitchopt.cli import main
from hitchopt.live.abort import Aborts, abort_table, until_stop
from hitchopt.motion.cable_state import CableState
from hitchopt.motion.plan_file import read_plan
from hitchopt.trajectory.piecewise import MIN_SPACING
from tests.helpers.plans import planned


@cache
def aborts_of(name: str) -> Aborts:
    """Aborts of a problem's plan, of a release, or of legs that are rolled."""
    if name == "untied":
        start = ho.Hitch.spread(ho.Team(3, 2.4), [[0, -0.9], [-0.72, 0.45], [0.72, 0.45]])
        return Aborts(ho.solve(start, ho.Release()).flight)
    if name == "rolled":  # what cables weigh on a clasp depends on its roll
        team, roll = (
            ho.Team(5, 2.2, tension=0.8, cable_density=0.01, load=0.01),
            [10, 35, 0, -15, 20],
        )
        corners = ho.regular_polygon(5, 1.0)
        start = ho.Hitch(team, corners, 1.5, np.full(5, 0.6), np.radians(roll))
        return Aborts(ho.solve(start, ho.Transport(to=[0.5, 0.0, 1.5])).flight)
    return Aborts(planned(name).flight)


@pytest.mark.parametrize(
    ("name", "share", "how"),
    [
        *(("triangle", 0.31, how) for how in ("hold", "land", "release_and_land")),
        ("form_triangle", 0.97, "back"),
        ("form_triangle", CableState.CLASPING, "hold"),
        ("form_triangle", CableState.TIGHTENING, "hold"),
        ("swarms/head_on", 0.4, "land"),
        ("untied", 0.9, "land"),  # back to the hitch, from where it lands sooner
        ("rolled", 0.1, "land"),
    ],
)
def test_commands_end_in_rest_as_they_say(name: str, share: float | CableState, how: str) -> None:
    plan = aborts_of(name).flight
    if isinstance(share, CableState):
        phase = next(p for p in plan.phases if p.state == share)
        share = (phase.start + 0.3 * (phase.end - phase.start)) / plan.duration
    found = aborts_of(name).plan(share * plan.duration, how)
    whole = found.flight
    assert found.certificate.certified
    assert found.start >= share * plan.duration
    until = np.linspace(0.0, min(found.start, plan.duration), 9)
    np.testing.assert_allclose(whole.drones.at(until), plan.drones.at(until), atol=1e-12)
    np.testing.assert_allclose(whole.drones.at(until, 2), plan.drones.at(until, 2), atol=1e-7)
    stopped = whole.drones.at(min(found.start + found.seconds, whole.duration))
    np.testing.assert_allclose(stopped, plan.drones.at(found.rest), atol=1e-9)
    assert np.max(np.abs(whole.drones.at(whole.duration, 1))) <= 1e-9
    end, last, free = whole.drones.at(whole.duration), whole.phases[-1], CableState.FREE
    if how in ("hold", "back"):
        at = [found.rest] if how == "hold" else [p.end for p in plan.phases if p.state == free]
        np.testing.assert_allclose(end, plan.drones.at(at[-1]), atol=1e-9)
        assert how == "hold" or last.state == free
    else:
        assert np.min(end[:, 2]) == pytest.approx(0.0, abs=1e-9)
        assert last.state.hitched == (how == "land" and name != "swarms/head_on")


@pytest.mark.parametrize("name", ["triangle", "form_triangle", "two_teams"])
def test_stops_right_after_breaks_leave_no_short_pieces(name: str) -> None:
    flight = aborts_of(name).flight
    rng = np.random.default_rng(5)
    offs = [1e-8, 1e-6, 9.5e-5, 1e-3, 3.5e-3]
    own = [np.min(flown.motion.drones.durations) for flown in flight.teams]
    for time in rng.choice(flight.breaks[:-1], 6) + rng.choice(offs, 6):
        stop = until_stop(flight, float(time))
        assert stop.start >= time - 1e-7
        for flown, shortest in zip(stop.flight.teams, own, strict=True):
            assert np.min(flown.motion.drones.durations) >= 0.9 * min(MIN_SPACING, shortest)


def test_no_rest_while_tensions_rise() -> None:
    motion = planned("form_triangle").motion
    (rise,) = (phase for phase in motion.phases if phase.name == "tension")
    assert np.ptp(motion.tensions.at(np.array([rise.start, rise.end]))) > 0.1
    found = aborts_of("form_triangle").plan(rise.start + 0.3, "hold")
    assert (found.rest, found.seconds) == (rise.end, 0.0)


def test_impossible_aborts_are_refused() -> None:
    """Drones that start and end above each other cannot land."""
    stacks = np.array([[[0, 0, 1], [0, 0, 2.2]], [[1, 0.2, 1], [1, 0.2, 2.2]]])
    motion = ho.separate(ho.Problem(ho.Swarm(2), stacks[0], [ho.Fly(stacks[1])])).motion
    table = abort_table(ho.Flight.of(motion), "land", 0.5)
    assert (table.entries, table.missing) == ((), ((0.0, motion.duration),))
    with pytest.raises(ho.InfeasibleError, match="separation"):
        Aborts(ho.Flight.of(motion)).plan(1.0, "land")
    with pytest.raises(ho.InfeasibleError, match="were never free before"):
        aborts_of("triangle").plan(1.0, "back")
    for time, how, key in ((-1.0, "hold", "t"), (1e3, "hold", "t"), (0.1, "stay", "how")):
        with pytest.raises(ho.InputError, match=f"^{key} "):
            aborts_of("triangle").plan(time, how)


def test_the_command_writes_a_table_that_can_be_recomputed(tmp_path: Path) -> None:
    plan = planned("triangle")
    plan.save(tmp_path, rate=10.0)
    done = CliRunner().invoke(main, ["abort", str(tmp_path), "--how", "hold", "--every", "1"])
    assert done.exit_code == 0, done.output
    (table,) = json.loads((tmp_path / "aborts.json").read_text())["tables"]
    assert (table["how"], table["missing"]) == ("hold", [])
    starts, seconds = np.array([[e["start"], e["seconds"]] for e in table["entries"]]).T
    assert np.all(np.diff(starts) > 0.0)
    assert starts[-1] == pytest.approx(plan.duration)
    waits = starts + seconds - [0.0, *starts[:-1]]
    assert table["longest"] == pytest.approx(np.max(waits))
    with zipfile.ZipFile(tmp_path / "aborts.zip") as archive:
        assert archive.namelist() == [entry["plan"] for entry in table["entries"]]
        assert {member.date_time for member in archive.infolist()} == {(1980, 1, 1, 0, 0, 0)}
        archive.extractall(tmp_path / "plans")
    for entry in table["entries"]:
        motion = read_plan(tmp_path / "plans" / entry["plan"])
        assert certify(motion, reports=()).certified
        assert motion.duration == pytest.approx(entry["ends"])


TIME = 0.8


@cache
def heavy() -> ho.Plan:
    """Return a plan whose drones are above their clasps, which are above the middle of edges."""
    team = ho.Team(3, 2.65, tension=0.4, cable_density=0.01)
    start = ho.Hitch.spread(team, [[0, 0.64], [0.55, -0.32], [-0.55, -0.32]], 1.6)
    return ho.solve(start, ho.Transport(to=[0.3, 0.2, 1.6]))


def test_a_hitch_whose_cables_reach_the_ground_first_does_not_land_tied() -> None:
    with pytest.raises(ho.InfeasibleError, match=r"its cables would be 0\.21 m below"):
        Aborts(heavy().flight).plan(TIME, "land")
