"""Aborts that are planned while a plan flies: early flights react as complete tables, or hold."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import hitchopt as ho
from hitchopt.checks import certify
from hitchopt.errors import FileError
from hitchopt.live.abort import Abort, Aborts, AbortTable, abort_table, read_aborts, save_aborts
from hitchopt.live.ahead import AbortsAhead, next_time, outcomes
from hitchopt.live.fly import CommandedPlan
from hitchopt.values import Array
from tests.helpers.plans import planned

EVERY = 0.5


@cache
def plan() -> ho.Plan:
    """Two vertices of a triangle move, one after the other."""
    start = ho.Hitch.spread(ho.Team(3, 2.4), [[0, -1], [-0.4, 0.5], [0.4, 0.5]])
    return ho.solve(start, [ho.MoveVertex(0, by=[0.0, 0.4]), ho.MoveVertex(0, by=[0.0, -0.4])])


@cache
def whole() -> AbortTable:
    return abort_table(plan().flight, "land", EVERY)


def early(entries: int) -> AbortTable:
    """Return the table when its first entries are planned."""
    table = AbortTable.unplanned(plan().flight, "land", EVERY)
    for entry in whole().entries[:entries]:
        table = table.with_outcome(entry.asked, entry)
    return table


def course(table: AbortTable, time: float) -> CommandedPlan:
    """Return the plan flown with a table until a plan time [s]."""
    flown = CommandedPlan(plan().flight, {"land": table})
    flown.obey("resume")
    while flown.time < time - 1e-9:
        flown.step(0.05)
    return flown


def places(flown: CommandedPlan, seconds: float = 12.0) -> Array:
    return np.array([flown.step(0.1).setpoints.positions for _ in range(round(10 * seconds))])


def same(one: Abort, other: Abort) -> bool:
    keys = "asked", "start", "seconds", "rest"
    equal = [getattr(one, key) == getattr(other, key) for key in keys]
    first, second = (each.flight.drones.coefficients for each in (one, other))
    return all(equal) and np.array_equal(first, second)


def test_an_entry_serves_all_commands_up_to_its_stop() -> None:
    table, starts = whole(), [entry.start for entry in whole().entries]
    assert (table.pending, table.refused, table.missing, table.planned) == ((), (), (), 1.0)
    assert starts == sorted(starts)
    assert starts[-1] == pytest.approx(plan().duration)
    for asked in np.arange(0.0, plan().duration, EVERY):
        assert any(entry.asked <= asked <= entry.start + 1e-6 for entry in table.entries)
    assert all(entry.certificate.certified for entry in table.entries)
    none = AbortTable.unplanned(plan().flight, "land", EVERY)
    assert (none.planned, none.entries) == (0.0, ())


def test_a_flight_that_begins_early_reacts_as_with_the_whole_table() -> None:
    """Where the entry ahead is planned."""
    one, other = (course(table, 0.3) for table in (early(2), whole()))
    assert one.obey("land") == other.obey("land")
    np.testing.assert_array_equal(places(one), places(other))
    assert one.landed
    assert other.landed


@pytest.mark.slow
def test_before_an_entry_ahead_is_planned_the_team_flies_back_to_one_and_says_so() -> None:
    late = 0.7 * plan().duration
    flown = course(early(2), late)
    said = flown.obey("land")
    rest = whole().entries[1].rest
    assert f"back at t = {rest:.4g} s: no landing ahead is planned yet" in said
    sent = [flown.step(0.02).setpoints for _ in range(900)]
    limits = plan().flight.requirements.limits
    for name in ("speed", "acceleration", "jerk"):
        rates = {"speed": "velocities", "acceleration": "accelerations", "jerk": "jerks"}[name]
        most = max(np.max(np.linalg.norm(getattr(each, rates), axis=-1)) for each in sent)
        assert most <= getattr(limits, name) * (1.0 + 1e-6)
    assert flown.landed
    assert "planned yet" not in course(whole(), late).obey("land")


def test_without_any_entry_the_team_holds_until_one_is_planned() -> None:
    flown = course(early(0), 0.4)
    assert "no landing ahead is planned yet" in flown.obey("land")
    held = places(flown, 4.0)
    assert flown.resting
    np.testing.assert_array_equal(held[-1], held[-2])
    assert flown.retry() == ""  # nothing is planned yet
    flown.extend("land", early(2))
    assert flown.retry() == "land"
    assert flown.retry() == ""
    assert flown.obey("land").startswith("landing in ")
    places(flown)
    assert flown.landed
    other = course(early(0), 0.4)
    other.obey("land")
    other.obey("resume")
    other.extend("land", early(2))
    assert other.retry() == ""  # another command has replaced it
    with pytest.raises(ho.InfeasibleError, match="no such landing"):
        course(replace(early(0), pending=()), 0.4).obey("land")


def test_what_the_clock_has_overtaken_is_planned_last() -> None:
    flight, clock = plan().flight, SimpleNamespace(value=0.0)
    table = AbortTable.unplanned(flight, "land", EVERY)
    times = list[float]()
    for _, time, entry in outcomes(flight, {"land": table}, clock):
        times.append(time)
        table = table.with_outcome(time, entry)
        clock.value = 1.1
    assert times[:3] == [0.0, plan().duration, 2.0]
    behind = [time < 1.1 for time in times[1:]]
    assert behind == sorted(behind)
    assert any(behind)
    assert (table.pending, table.missing) == ((), ())
    long = AbortTable("land", (), 60.0, pending=(2.0, 4.0, 20.0, 28.0, 30.0))
    assert [next_time(long, now) for now in (1.0, 3.0, 22.5, 50.0)] == [2.0, 4.0, 28.0, 2.0]


@pytest.mark.slow
def test_another_process_plans_the_same_table_and_saved_ones_are_certified_again(
    tmp_path: Path,
) -> None:
    flight = plan().flight
    plan().save(tmp_path)
    assert read_aborts(tmp_path, flight) == {}
    broken = replace(whole().entries[1], flight=moved(whole().entries[1]))
    part = early(0).with_outcome(0.0, whole().entries[0]).with_outcome(broken.asked, broken)
    save_aborts(tmp_path, flight, [part])
    saved = read_aborts(tmp_path, flight)
    assert saved["land"].pending == part.pending
    assert all(map(same, saved["land"].entries, part.entries))
    ahead = AbortsAhead(flight, saved)
    assert (ahead.tables["land"].entries, ahead.covers(0.0)) == ((), False)
    assert all(map(same, ahead.to_save["land"].entries, part.entries))
    with ahead.planning():
        while ahead.receive():
            pass
    assert (ahead.planned, ahead.covers(1e3)) == (1.0, True)
    assert all(map(same, ahead.tables["land"].entries, whole().entries))
    assert len(ahead.tables["land"].entries) == len(whole().entries)


def moved(entry: Abort) -> ho.Flight:
    """Return the flight of an abort whose drones land elsewhere, in a jump."""
    motion = entry.flight.teams[0].motion
    coefficients = motion.drones.coefficients.copy()
    coefficients[-1, ..., -1] += 0.2
    drones = motion.drones.replaced(coefficients)
    return ho.Flight.of(replace(motion, drones=drones))


def test_saved_entries_are_flown_only_if_they_continue_the_plan_within_limits() -> None:
    aborts, entry = Aborts(plan().flight), whole().entries[1]
    assert aborts.holds(entry)
    assert not aborts.holds(replace(entry, flight=moved(entry)))
    assert not aborts.holds(replace(entry, rest=entry.rest + 0.2))
    assert not aborts.holds(replace(entry, seconds=0.5 * entry.seconds))
    other = abort_table(planned("triangle").flight, "land", 2.0).entries[0]
    assert not aborts.holds(other)


def test_saved_tables_of_another_plan_are_not_used(tmp_path: Path) -> None:
    flight, other = plan().flight, planned("triangle").flight
    save_aborts(tmp_path, flight, [whole()])
    assert [*read_aborts(tmp_path, flight)] == ["land"]
    assert read_aborts(tmp_path, other) == {}
    content = json.loads((tmp_path / "aborts.json").read_text())
    for key in ("format", "plan", "plans"):
        (tmp_path / "aborts.json").write_text(json.dumps(content | {key: "0"}))
        assert read_aborts(tmp_path, flight) == {}
    (tmp_path / "aborts.json").write_text("{")
    with pytest.raises(FileError, match=r"aborts\.json: cannot be read"):
        read_aborts(tmp_path, flight)


def test_certificates_from_the_last_rest_on_are_those_of_whole_flights() -> None:
    for how in ("hold", "release_and_land"):
        found = Aborts(plan().flight).plan(0.6 * plan().duration, how)
        assert certify(found.flight, reports=()).certified
