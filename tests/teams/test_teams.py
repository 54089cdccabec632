"""Several teams in one problem, plans that fly besides, and two finished plans on one clock."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hitchopt as ho
from benchmarks.families import past_team
from hitchopt.checks import Certificate, certify
from hitchopt.mission.loading import problem_from_dict, request_in
from hitchopt.motion.motion import WAIT
from hitchopt.motion.plan_file import is_of, write_plan
from hitchopt.motion.request import check_request
from hitchopt.steps.moving import Hold, Transport
from hitchopt.storage.files import digest
from tests.helpers.plans import PROBLEMS, planned

TRIANGLE = [[0, 0.75], [0.65, -0.375], [-0.65, -0.375]]
BLENDED = {"morph": {"polygon": TRIANGLE, "blend": True}}
FILE: dict[str, Any] = {
    "teams": {"a": {"robots": 3, "cable_length": 2.3}, "b": {"drones": 2}},
    "start": {
        "a": {"hitch": {"polygon": TRIANGLE, "altitude": 1.5}},
        "b": [[3, 0, 1], [3, 1, 1]],
    },
    "mission": [
        {"a": {"hold": {"seconds": 1}}, "b": {"fly": {"goal": [[3, 0, 2], [3, 1, 2]]}}},
        {"a": [{"transport": {"to": [0, 0, 1.6]}}, {"hold": {"seconds": 2}}]},
        {"b": [{"fly": {"goal": [[3, 0, 1], [3, 1, 1]], "duration": 4}}]},
    ],
}


def teams(data: dict[str, Any]) -> ho.Problem:
    problem = problem_from_dict(data)
    assert problem.kind == "teams"
    return problem


def changed(path: tuple[str | int, ...], value: object) -> dict[str, Any]:
    data: Any = deepcopy(FILE)
    place = data
    for part in path[:-1]:
        place = place[part]
    if value is None:
        del place[path[-1]]
    else:
        place[path[-1]] = value
    return dict(data)


def test_every_team_has_its_steps_of_all_items() -> None:
    problem = teams(FILE)
    assert problem.items == [{"a": 1, "b": 1}, {"a": 2}, {"b": 1}]
    a, b = problem.teams.values()
    assert [step.name for step in a.steps] == ["hold", "transport", "hold"]
    assert [flight.prescribed_duration for flight in b.steps] == [None, 4.0]


def test_records_make_the_problem_of_the_file() -> None:
    array: Any = np.array
    fly = [
        ho.Fly(array([[3, 0, 2], [3, 1, 2]])),
        ho.Fly(array([[3, 0, 1], [3, 1, 1]]), duration=4),
    ]
    problem = ho.Problem(
        {"a": ho.Team(3, 2.3), "b": ho.Swarm(2)},
        {"a": ho.HitchStart(array(TRIANGLE), 1.5), "b": array([[3, 0, 1], [3, 1, 1]])},
        [
            {"a": Hold(1), "b": fly[0]},
            {"a": [Transport(array([0, 0, 1.6])), Hold(2)]},
            {"b": [fly[1]]},
        ],
    )
    assert problem.request == teams(FILE).request
    assert problem.items == teams(FILE).items


@pytest.mark.parametrize(
    ("path", "value", "key"),
    [
        (("teams", "b"), None, "teams"),
        (("teams", "a", "cable_length"), -1, "teams.a.cable_length"),
        (("teams", "two words"), {"drones": 1}, "teams.'two words'"),
        (("teams", "a_name_of_more_than_20"), {"drones": 1}, "teams.a_name_of_more_than_20"),
        (("teams", "c"), {"drones": 1}, "start.c"),
        (("start", "a"), None, "start.a"),
        (("start", "a"), [[0, 0, 1]], "start.a"),
        (("start", "a", "hitch", "polygon"), TRIANGLE[:2], "start.a.hitch.polygon"),
        (("start", "b"), [[0, 0, 1]], "start.b"),
        (("start", "c"), [[0, 0, 1]], "start.c"),
        (("mission", 0), {}, "mission[0]"),
        (("mission", 0, "c"), {"hold": {"seconds": 1}}, "mission[0].c"),
        (("mission", 0, "hold"), {"seconds": 1}, "mission[0].hold"),
        (("mission", 0, "a"), {"fly": {"goal": [[0, 0, 1]]}}, "mission[0].a.fly"),
        (("mission", 0, "b"), {"hold": {"seconds": 1}}, "mission[0].b.hold"),
        (("mission", 0, "b", "fly", "goal"), [[3, 0, 2]], "mission[0].b.fly.goal"),
        (("mission", 1, "a", 0, "transport", "to"), 1, "mission[1].a[0].transport.to"),
        (("mission", 1, "a", 1), {"form": {"polygon": TRIANGLE}}, "mission[1].a[1].form"),
        (("mission", 1, "a"), BLENDED, "mission[1].a.morph.blend"),
        (("mission",), [{"a": {"hold": {"seconds": 1}}}], "mission"),
        (("others",), {"a": {"plan": str(PROBLEMS / "show")}}, "others.a"),
        (("others",), {"c": {"plan": str(PROBLEMS / "show"), "at": -1}}, "others.c.at"),
        (("others",), [1], "others"),
        (("others",), {"c": 3}, "others.c"),
        (("team",), {"drones": 2}, "team"),
    ],
)  # fmt: skip
def test_mistakes_are_told_with_their_keys(
    path: tuple[str | int, ...], value: object, key: str
) -> None:
    with pytest.raises(ho.InputError) as caught:
        problem_from_dict(changed(path, value))
    assert caught.value.key == key


def test_an_object_that_a_step_names_belongs_to_that_team_alone() -> None:
    data = changed(("teams", "c"), FILE["teams"]["a"])
    hitch = {"polygon": [[5, 0.75], [5.65, -0.375], [4.35, -0.375]], "altitude": 1.5}
    data["start"]["c"] = {"hitch": hitch}
    box = {"circle": 0.1, "to": 0.3, "mass": 0.05}
    data["objects"] = {name: box | {"at": [0, y, 0]} for y, name in enumerate(("box", "post"))}
    data["mission"].append({"a": {"enclose": {"object": "box"}}, "c": {"hold": {"seconds": 1}}})
    objects = {name: [*each["objects"]] for name, each in teams(data).request.items()}
    assert objects == {"a": ["box", "post"], "b": ["post"], "c": ["post"]}
    data["mission"].append({"c": {"enclose": {"object": "box"}}})
    with pytest.raises(ho.InputError, match="that a does not name") as caught:
        teams(data)
    assert caught.value.key == "mission[4].c.enclose.object"


@pytest.mark.slow
def test_teams_with_one_goal_are_refused_with_both_named() -> None:
    with pytest.raises(ho.InfeasibleError, match=r"goals of b and a, near \(2.50, 0.00, 1.50\) m"):
        ho.solve(PROBLEMS / "infeasible" / "same_goal.yaml")


def test_a_team_waits_for_a_plan_that_flies_besides() -> None:
    plan = planned("beside_a_show")
    (show,) = plan.flight.others
    assert show.digest == digest(PROBLEMS / "show" / "plan.npz")
    assert show.motion.drones.breaks[0] == 8.0
    assert is_of(show, PROBLEMS / "show" / "plan.npz")
    text = (PROBLEMS / "beside_a_show.yaml").read_text()
    check_request(request_in(text, {}), plan.flight)
    for changed_text in (text.replace("at: 8", "at: 9"), text.replace("show: {", "other: {")):
        with pytest.raises(ho.InputError, match=r"request\.others"):
            check_request(request_in(changed_text, {}), plan.flight)
    assert [phase.name for phase in plan.phases] == ["transport", WAIT, "transport"]
    times = np.linspace(0.0, plan.duration, 1001)
    theirs = show.motion.drones.at(np.clip(times, *show.motion.drones.breaks[[0, -1]]))
    offsets = (plan.at(times).positions[:, :, None] - theirs[:, None]) / [0.24, 0.24, 0.6]
    worst = plan.certificate["separation"].worst
    assert np.min(np.linalg.norm(offsets, axis=-1)) == pytest.approx(worst, rel=1e-2)


def test_the_plan_of_the_show_is_that_of_its_problem() -> None:
    stored, plan_ = ho.load(PROBLEMS / "show"), planned("swarms/show")
    assert stored.problem == (PROBLEMS / "swarms" / "show.yaml").read_text()
    times = np.linspace(0.0, plan_.duration, 11)
    np.testing.assert_allclose(stored.at(times).positions, plan_.at(times).positions, atol=1e-6)


def test_other_plans_are_read_beside_the_file_and_must_be_certified(tmp_path: Path) -> None:
    data = changed(("others",), {"show": {"plan": "show", "at": 2}})
    with pytest.raises(ho.InputError, match=r"^others\.show: .*No plan in"):
        problem_from_dict(data, tmp_path)
    motion = planned("swarms/show").motion
    (tmp_path / "show").mkdir()
    write_plan(tmp_path / "show" / "plan.npz", ho.Flight.of(motion))
    show = problem_from_dict(data, tmp_path).others["show"]
    assert [each.motion.drones.breaks[0] for each in show.teams("show")] == [2.0]
    write_plan(tmp_path / "show" / "plan.npz", planned("two_teams").flight)
    hall = problem_from_dict(data, tmp_path).others["show"].teams("hall")
    assert [(each.name, each.motion.drones.breaks[0]) for each in hall] == [
        ("hall.a", 2.0),
        ("hall.b", 2.0),
    ]
    write_plan(tmp_path / "show" / "plan.npz", ho.Flight.of(motion.slowed(0.5)))
    with pytest.raises(ho.InputError, match="whose certificate holds, unlike") as caught:
        problem_from_dict(data, tmp_path)
    assert caught.value.key == "others.show.plan"


def test_two_finished_plans_on_one_clock_have_the_certificate_of_the_teams_together() -> None:
    low = replace(
        ho.load_problem(PROBLEMS / "two_teams.yaml"), arena=ho.Arena([-9, -9, 1], [9, 9, 2])
    )
    problem, together = low, ho.solve(low)  # b waits
    parts = {key: getattr(problem, key) for key in ("limits", "separation", "arena")}
    each = [ho.solve(ho.Problem(x.team, x.start, x.steps, **parts)) for x in problem.teams.values()]
    combined = ho.combine(each[0], each[1], at=7.0)
    for check in combined.certificate.checks:
        assert check.worst == pytest.approx(together.certificate[check.name].worst, abs=1e-6)
    at_once = ho.combine(each[0], each[1], names=("first", "second")).certificate
    assert {check.name for check in at_once.violated} >= {"separation", "crossing"}
    assert {name.partition(".")[0] for name in at_once["crossing"].where} == {"first", "second"}
    assert "a.q2, b.r0" in str(ho.closest(combined))
    with pytest.raises(ho.InputError, match="a unique name"):
        ho.combine(each[0], each[1], names=("a", "a"))


def test_teams_change_places_in_layers_but_for_steps_of_a_given_duration() -> None:
    polygon: Any = np.array(TRIANGLE)
    teams = {name: ho.Team(3, 2.3) for name in "ab"}
    places = {"a": [-1.5, 0.0], "b": [1.5, 0.0]}
    start: Any = {name: ho.HitchStart(polygon + at, 1.5) for name, at in places.items()}
    ends = {"a": np.array([1.5, 0, 1.5]), "b": np.array([-1.5, 0, 1.5])}

    def exchanged(duration: float | None, tracking: float = 0.0) -> ho.Plan:
        item = {name: Transport(end, duration=duration) for name, end in ends.items()}
        limits = ho.Limits(tracking=tracking)
        return ho.solve(ho.Problem(teams, start, [item], limits=limits))

    # A start at another team's goal does not shrink the room for tracking errors
    plan = exchanged(None, tracking=0.05)
    names = {phase.name for each in plan.flight.teams for phase in each.motion.phases}
    assert names >= {"climb", "descend", WAIT}
    with pytest.raises(ho.InfeasibleError, match="at any delay"):
        exchanged(9.0)


def test_crossing_teams_climb_on_their_way_and_waits_say_for_whom() -> None:
    """The climb keeps all limits; under a low ceiling the later team waits, and says so."""
    polygon = np.array(TRIANGLE) @ [[0.6, 0.8], [-0.8, 0.6]]
    team, places = ho.Team(3, 2.3), {"east": [-3.6, 0.3], "north": [0.2, -3.4]}
    start: Any = {name: ho.HitchStart(polygon + at, 1.4) for name, at in places.items()}
    item = {
        "east": Transport(np.array([3.4, 0.1, 1.4])),
        "north": Transport(np.array([0.1, 3.2, 1.4])),
    }
    teams = dict.fromkeys(places, team)
    free, low = (
        ho.solve(ho.Problem(teams, start, [item], arena=arena))
        for arena in (None, ho.Arena([-9.0, -9.0, 1.0], [9.0, 9.0, 1.9]))
    )
    remarks = {
        each.name: [(phase.name, phase.remark) for phase in each.motion.phases]
        for each in free.flight.teams
    }
    assert remarks == {
        "east": [("transport", ""), (WAIT, "until north ends item 0")],
        "north": [("transport", "+0.66 m on the way, past other teams")],
    }
    assert [phase.remark for phase in free.flight.phases] == [
        "north: +0.66 m on the way, past other teams",
        "east: until north ends item 0",
    ]
    (_, north) = free.flight.teams
    heights = north.motion.vertices.at(np.linspace(0.0, free.duration, 101))[:, 0, 2]
    np.testing.assert_allclose(heights[[0, 50, 100]], [1.4, 2.06, 1.4], atol=1e-9)
    assert free.certificate.certified
    assert free.duration < 0.9 * low.duration
    phases = [phase for each in low.flight.teams for phase in each.motion.phases]
    waits = [phase.remark for phase in phases if phase.name == WAIT]
    assert waits == ["until north ends item 0", "for east"]


@pytest.mark.slow
def test_teams_that_cross_rise_instead_of_waiting_where_that_takes_less_time() -> None:
    """Three paths that cross in one point; a low ceiling leaves only the wait."""
    polygon: Any = np.array(TRIANGLE)
    places = {"a": [-4.0, 0.0], "b": [2.0, -3.5], "c": [2.0, 3.5]}
    teams = {name: ho.Team(3, 2.3) for name in places}
    start: Any = {name: ho.HitchStart(polygon + at, 1.5) for name, at in places.items()}
    ends = {name: np.array([-at[0], -at[1], 1.5]) for name, at in places.items()}
    item = {name: Transport(end) for name, end in ends.items()}
    free = ho.Problem(teams, start, [item])
    low = ho.Problem(teams, start, [item], arena=ho.Arena([-9, -9, 1.0], [9, 9, 2.0]))
    above, waiting = ho.solve(free), ho.solve(low)
    names = {phase.name for each in above.flight.teams for phase in each.motion.phases}
    alone = max(
        ho.solve(ho.Problem(teams[name], start[name], [step])).duration
        for name, step in item.items()
    )
    assert above.duration < min(0.9 * waiting.duration, 1.25 * alone)
    assert names == {"transport", WAIT}


def test_start_times_have_a_larger_margin_until_all_teams_are_certified(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Distances at sampled times suffice only with a margin."""
    flights = list[ho.Flight]()

    def certify_third(flight: ho.Flight) -> Certificate:
        flights.append(flight)
        certificate = certify(flight)
        first, *rest = certificate.limited
        failed = replace(first, holds=len(flights) > 2)
        return replace(certificate, limited=(failed, *rest))

    monkeypatch.setattr("hitchopt.teams.planning.certify", certify_third)
    said = list[str]()
    plan = ho.solve(teams(FILE), progress=said.append)
    assert plan.flight is flights[2]
    assert "trying schedule 3" in said


@pytest.mark.slow
@pytest.mark.parametrize("seed", [8, 2, 4])
def test_a_team_that_stays_is_passed_above_or_below_all_of_it(seed: int) -> None:
    """Legs that roll reach farther up and down than one layer."""
    data = past_team(seed)
    above, below = heights_in_passing(data)
    assert above > 0.0 > below
    motion = ho.solve(problem_from_dict(data)).flight.teams[0].motion
    ceiling = 0.1 + max(float(np.max(motion.drones.at(t)[:, 2])) for t in (0.0, motion.duration))
    low = {**data, "arena": {"lower": [-20, -20, 0], "upper": [20, 20, ceiling]}}
    if seed == 4:  # too little room above and below
        with pytest.raises(ho.InfeasibleError, match="at any delay"):
            ho.solve(problem_from_dict(low))
    else:
        above, below = heights_in_passing(low)
        assert above < 0.0 < below


def heights_in_passing(data: dict[str, Any]) -> tuple[float, float]:
    """Return by how much [m] drones that pass are above, and below, those of the other team.

    Less the height that separation asks for.
    """
    plan = ho.solve(problem_from_dict(data))
    passing, staying = (each.motion for each in plan.flight.teams)
    times = np.linspace(0.0, plan.flight.duration, 2001)
    places, there = passing.drones.at(times), staying.drones.at(times)
    near = places[np.abs(np.mean(places[..., 0], axis=1)) < 0.5]
    gap = 2.0 * passing.requirements.separation.height
    above = np.min(near[..., 2]) - np.max(there[..., 2]) - gap
    below = np.min(there[..., 2]) - np.max(near[..., 2]) - gap
    return float(above), float(below)


def test_layers_leave_room_for_errors_of_position_and_refusals_count_them() -> None:
    limits = {"tracking": 0.05}
    data = {**past_team(8), "limits": limits}
    above, below = heights_in_passing(data)
    assert above > 2.0 * 0.05
    low = {**data, "arena": {"lower": [-20, -20, 0.5], "upper": [20, 20, 2.2]}}
    with pytest.raises(ho.InfeasibleError, match="at any delay") as refused:
        ho.solve(problem_from_dict(low))
    (violation,) = refused.value.violations
    assert violation.value < violation.limit
    assert violation.limit > 1.0
    assert violation.unit == "ratio"
    assert below < 0.0
