"""Suggestions: as written they are feasible, smaller changes are not, and no field is lost."""

from __future__ import annotations

import copy
import itertools
import math
from collections.abc import Callable, Iterable
from dataclasses import fields, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hitchopt as ho
from hitchopt.drones.controllers import Tube
from hitchopt.errors import FaultWarning, RequestError, UnitWarning
from hitchopt.hitch.team import Assignment
from hitchopt.mission.cache import contents
from hitchopt.mission.loading import problem_from_dict
from hitchopt.mission.solving import solve_problem
from hitchopt.planners.task import StepPlan, StepTask
from hitchopt.repairs import repair
from hitchopt.repairs.alternatives import retuning_changes, rim_changes
from hitchopt.repairs.changes import change_of, with_edits
from hitchopt.repairs.fitted_values import fitting_cables
from hitchopt.repairs.knobs import knobs_of, scaled_outlines, team_edit
from hitchopt.repairs.repair import Suggestion, find_suggestions
from hitchopt.repairs.trials import Trial
from hitchopt.steps.knob import Edit, altitude_knobs
from hitchopt.steps.moving import Hold
from hitchopt.storage.yaml_file import read_yaml, split_key
from tests.helpers.clocks import Clock
from tests.helpers.plans import INFEASIBLE, PROBLEMS
from tests.helpers.problem_cases import hitch_start, triangle
from tests.helpers.refusing_steps import problem_of, refusal


def edited(data: Any, edits: Iterable[Edit]) -> dict[str, Any]:
    """Return a copy of a problem's mapping with the edits of a change; sections may be missing."""
    result = copy.deepcopy(data)
    for edit in edits:
        place = result
        *parents, last = split_key(edit.key)
        for part in parents:
            if isinstance(part, str) and place.get(part) is None:
                place[part] = {}
            place = place[part]
        place[last] = edit.value
    return dict(result)


CASES = {path.stem: path for path in INFEASIBLE}
SMALLEST = {
    "drones_too_close": "team.cable_length",
    "paper_experiment_1": "team.cable_length",
    "tilt_too_small": "limits.tilt_deg",
    "plan_too_long": "limits.duration",
    "points_too_fast": "mission[0].follow_vertex.path",
    "above_the_arena": "start.hitch.altitude",
    "star_tip": "mission[0].morph.legs",
    "form_starts_overlap": "start.drones",
    "form_cable_too_short": "team.cable_length",
    "form_start_overstretched": "team.cable_length",
}

PATIENCE = 600.0
"""[s] Searches of tests do not end by the clock, however busy the machine is."""


@cache
def suggested(stem: str) -> tuple[Suggestion, ...]:
    return ho.suggestions(CASES[stem], PATIENCE)


@pytest.mark.slow
@pytest.mark.parametrize("stem", SMALLEST)
def test_every_suggestion_plans_when_written_into_the_file(stem: str) -> None:
    suggestions = suggested(stem)
    assert suggestions[0].change.key == SMALLEST[stem]
    assert 1 <= len(suggestions) <= 3
    sizes = [round(suggestion.change.size, 6) for suggestion in suggestions]
    assert sizes == sorted(sizes)
    for suggestion in suggestions:
        assert_as_suggested(read_yaml(CASES[stem]), suggestion)


def assert_as_suggested(data: Any, suggestion: Suggestion) -> ho.Plan:
    plan = ho.solve(problem_from_dict(edited(data, suggestion.change.edits)))
    assert plan.certificate.certified
    assert plan.duration == pytest.approx(suggestion.duration, rel=1e-6)
    return plan


BEGINNERS: Any = read_yaml(Path(__file__).with_name("beginners.yaml"))
"""Problems by name, with the kinds of their faults."""

QUICK = {"cables_of_lead", "transport_into_the_ceiling"}
"""Those that take less than a second."""


@pytest.mark.parametrize(
    "name",
    [x if x in QUICK else pytest.param(x, marks=pytest.mark.slow) for x in BEGINNERS],
)
def test_faults_of_beginners_are_repaired(name: str) -> None:
    suggestions = ho.suggestions(problem_from_dict(BEGINNERS[name]["problem"]), PATIENCE)
    assert suggestions, BEGINNERS[name]["faults"]
    assert_as_suggested(BEGINNERS[name]["problem"], suggestions[0])


def test_coarser_changes_are_tried_where_small_ones_take_too_long(
    clock: Clock,
) -> None:
    """Exact cables that are too heavy do not fit by a change of their length; a tension does."""
    tried, lead = list[str](), BEGINNERS["cables_of_lead"]["problem"]
    data = edited(lead, [Edit("team.cable_density", 0.025)])  # more need more plans
    problem = problem_from_dict(data)
    with pytest.raises(ho.InfeasibleError) as caught:
        ho.solve(problem)
    clock.tick = 0.0

    def progress(line: str) -> None:
        """Let every plan take a twelfth of the time."""
        tried.append(line)
        clock.now += PATIENCE / 12.0

    suggestions = find_suggestions(problem, caught.value, PATIENCE, progress)
    changes = [line.partition("(all cables, ")[2] for line in tried]
    sizes = [each for each in changes if each]
    assert sizes[-4:] == ["+10 %)", "+25 %)", "+60 %)", "+150 %)"]
    assert_as_suggested(data, suggestions[0])


CLOSE_CEILING: dict[str, Any] = {
    "team": {"robots": 3, "cable_length": 2.4, "cable_density": 0.01},
    "start": {
        "drones": {
            "q": [[-0.6, -1.2, 0], [-0.6, 0, 0], [-0.6, 1.2, 0]],
            "r": [[0.6, -1.2, 0], [0.6, 0, 0], [0.6, 1.2, 0]],
        }
    },
    "arena": {"lower": [-3, -3, 0], "upper": [3, 3, 1.6]},
    "mission": [{"form": {"polygon": [[0, 0.6], [0.5, -0.3], [-0.5, -0.3]], "altitude": 1.5}}],
}
"""A ceiling below which the end fits if it is raised by 4.5 cm, but no way there."""


@pytest.mark.slow
def test_plans_that_take_long_are_given_up_for_changes_that_are_planned_at_once(
    clock: Clock,
) -> None:
    """Every check of the time takes a second of this clock."""
    assert clock.tick == 1.0
    suggestions = ho.suggestions(problem_from_dict(CLOSE_CEILING), 3000.0)
    assert suggestions[0].change.key == "mission[0].form.altitude"
    assert_as_suggested(CLOSE_CEILING, suggestions[0])


def test_a_plan_without_time_is_given_up() -> None:
    problem = problem_from_dict(CLOSE_CEILING)
    knob = next(x for x in knobs_of(problem, ()) if x.key == "arena.upper[2]")
    change = change_of(problem, knob, 0.1)
    assert change is not None
    trial = Trial.of(change, {}, optimiser=False, seconds=0.0)
    assert trial.given_up
    assert not trial.certified


def test_shallow_cables_at_the_start_are_lengthened_or_their_drones_moved_together() -> None:
    """Cables nearly as long as the distance of their drones pull more than drones can."""
    q = [[-0.45, 1.2, 0], [-0.45, 0, 0], [-0.45, -1.2, 0]]
    data = {
        "team": {"robots": 3, "cable_length": 0.9002, "cable_density": 0.02},
        "start": {"drones": {"q": q, "r": [[-x, y, z] for x, y, z in q]}},
        "mission": [{"hold": {"seconds": 1}}],
    }
    suggestions = ho.suggestions(problem_from_dict(data), PATIENCE)
    keys = [each.change.key for each in suggestions]
    assert {"team.cable_length", "start.drones"} <= set(keys)
    for each in suggestions:
        assert_as_suggested(data, each)


HEPTAGON = [
    [[1.45, -0.014], [1.097, -0.85], [-0.619, -1.175], [-1.326, -0.526], [-1.413, 0.293]]
    + [[-0.148, 1.292], [1.125, 0.82]],
    [[1.386, 0.215], [0.786, -1.272], [-0.122, -1.531], [-1.282, -0.618], [-1.232, 0.73]]
    + [[-0.024, 1.536], [0.648, 1.362]],
]
CRATE = {
    "outline": [[-0.175, -0.125], [-0.175, 0.125], [0.175, 0.125], [0.175, -0.125]],
    **{"to": 0.2, "mass": 0.06, "at": [1.2, 0.4, 0]},
}


@pytest.mark.slow
def test_statics_suggest_the_cables_of_polygons_and_grips() -> None:
    """Lengths for which the heptagon is planned, and those of ``fit`` for the crate."""
    start = {"hitch": {"polygon": HEPTAGON[0], "altitude": 1.5, "legs": "spread"}}
    heptagon: dict[str, Any] = {
        "team": {"robots": 7, "cable_length": 4.0},
        "start": start,
        "mission": [{"morph": {"polygon": HEPTAGON[1]}}],
    }
    lengths = fitting_cables(problem_from_dict(heptagon))
    assert min(lengths) < 2.35 < max(lengths) < 4.0
    with pytest.raises(ho.InfeasibleError) as raised:
        solve_problem(problem_from_dict(heptagon), optimiser=False)
    assert "use a shorter cable or a larger polygon" in raised.value.violations[0].remedy
    heptagon["team"]["cable_length"] = lengths[1]
    assert solve_problem(problem_from_dict(heptagon), optimiser=False).certificate.certified


@pytest.mark.parametrize(("kind", "is_reported"), [(ho.InputError, True), (RequestError, False)])
def test_faults_in_fitting_cables_to_objects_are_reported_and_hide_no_other_length(
    monkeypatch: pytest.MonkeyPatch,
    recwarn: pytest.WarningsRecorder,
    kind: type[ho.InputError],
    is_reported: bool,
) -> None:
    """What is wrong with the request is not: the object's step refuses it."""

    def faulty(*_: object) -> None:
        raise kind("grip", 1.0, "another one", "report it")

    monkeypatch.setattr("hitchopt.repairs.fitted_values.shortest_judge", faulty)
    data = small(objects={"crate": CRATE}, mission=[{"enclose": {"object": "crate"}}])
    without = fitting_cables(problem_from_dict(small()))
    assert fitting_cables(problem_from_dict(data)) == without
    assert [w.category for w in recwarn.list] == [FaultWarning] * is_reported


@pytest.mark.slow
def test_a_crate_whose_yaw_no_cables_hold_gets_a_rim() -> None:
    """Four edges turn an oblong crate about its corners, whatever their length."""
    data = small(
        team={"robots": 4, "cable_length": 2.0},
        objects={"crate": CRATE},
        start={"hitch": {"polygon": [[-0.3, -0.3], [-0.3, 0.3], [0.3, 0.3], [0.3, -0.3]]}},
        mission=[{"transport_object": {"object": "crate", "to": [0, 1.5, 0]}}],
    )
    data["start"]["hitch"]["altitude"] = 1.2
    with pytest.raises(ho.InfeasibleError, match=r"^yaw: "):
        ho.solve(problem_from_dict(data))
    (suggestion,) = ho.suggestions(problem_from_dict(data), PATIENCE)
    assert [each.key for each in suggestion.change.together()] == ["objects.crate.rim"]
    assert_as_suggested(data, suggestion)


def test_objects_that_cables_cannot_grip_get_a_rim_that_rests_on_them() -> None:
    """Four heavy cables of 2 m find no grip; no words promise a rim that was not tried."""
    hitch = {"polygon": [[-0.4, 0.4], [0.4, 0.4], [0.4, -0.4], [-0.4, -0.4]], "altitude": 1.2}
    data: Any = {
        "team": {"robots": 4, "cable_length": 2.0, "cable_density": 0.01},
        "objects": {"crate": CRATE},
        "start": {"hitch": hitch},
        "mission": [{"enclose": {"object": "crate"}}],
    }
    problem = problem_from_dict(data)
    with pytest.raises(ho.InfeasibleError, match="no grip by 4 cables") as refused:
        ho.solve(problem)
    assert "rim" not in str(refused.value)
    (fault,) = refused.value.violations
    (change,) = rim_changes(problem, [fault])
    rim = change.edits[0]
    assert (rim.key, change.size > 0.0) == ("objects.crate.rim", True)
    assert contents(problem_from_dict(edited(data, [rim]))) == contents(change.problem)
    assert solve_problem(change.problem).certificate.certified
    assert not list(rim_changes(problem, [replace(fault, reason=None)]))
    round_crate = {key: value for key, value in CRATE.items() if key != "outline"} | {
        "circle": 0.16
    }
    data["objects"]["crate"] = round_crate
    (change,) = rim_changes(problem_from_dict(data), [fault])
    assert change.edits[0].value == {"circle": pytest.approx(0.19), "at": 0.2}


def test_sizes_are_compared_as_factors() -> None:
    problem = problem_from_dict(small(arena=ARENA))
    tension = [x for x in knobs_of(problem, ()) if x.key == "team.tension"]
    lower, higher = sorted(tension, key=lambda knob: knob.sign)
    half, double = change_of(problem, lower, 0.5), change_of(problem, higher, 1.0)
    assert half is not None
    assert double is not None
    assert half.size == pytest.approx(double.size)
    assert half.size == pytest.approx(math.log(2.0))
    (wall,) = (x for x in knobs_of(problem, ()) if x.key == "arena.upper[0]")
    moved = change_of(problem, wall, 0.5)  # a position, not a factor
    assert moved is not None
    assert moved.size == pytest.approx(0.5)


def test_outlines_are_scaled_about_one_point() -> None:
    """Distances of polygons scale with them."""
    shifted = (EDGE.vertices + [0.6, -0.2]).tolist()
    problem = problem_from_dict(small(mission=[{"morph": {"polygon": shifted}}]))
    first, second = outlines(problem)
    scaled = outlines(with_edits(problem, scaled_outlines(problem, 0.8)))
    between = second.vertices - first.vertices[0]
    after = scaled[1].vertices - scaled[0].vertices[0]
    np.testing.assert_allclose(after, 0.8 * between, atol=1e-8)


EDGE = ho.regular_polygon(3, 1.2)
AT: list[float] = EDGE.vertices[0].tolist()
LED = {"follow_vertex": {"vertex": 0, "path": [[4.0, AT[0], AT[1] + 0.1], [8.0, *AT]]}}
CASE = [[0, -1], [-0.4, 0.5], [0.4, 0.5]]
HEAVY = {"robots": 3, "cable_length": 2.2, "load": 0.05}


def small(**keys: Any) -> dict[str, Any]:
    """A hitch that stays for a second."""
    return {
        "team": {"robots": 3, "cable_length": 2.4},
        "start": {"hitch": {"polygon": EDGE.vertices.tolist(), "altitude": 1.0}},
        "mission": [{"hold": {"seconds": 1.0}}],
        **keys,
    }


@pytest.mark.slow
def test_what_is_late_or_heavy_is_given_time_or_made_lighter() -> None:
    slow, heavy = small(limits={"duration": 7.0}, mission=[LED]), small(team=HEAVY)
    for data, key in (
        (slow, "mission[0].follow_vertex.path"),
        (heavy, "team.load"),
        (heavy, "team.tension"),
    ):
        problem = problem_from_dict(data)
        by_key = {s.change.key: s for s in ho.suggestions(problem, PATIENCE)}
        plan = assert_as_suggested(data, by_key[key])
        assert data is heavy or plan.duration == pytest.approx(7.0, rel=0.03)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("stem", "key", "needed"),
    [
        # A pull of T on m g tilts by atan(T / (m g)): the file's numbers, by hand.
        ("tilt_too_small", "limits.tilt_deg", math.degrees(math.atan(0.4 / (0.132 * 9.81)))),
        ("tilt_too_small", "team.tension", 0.132 * 9.81 * math.tan(math.radians(15.0))),
        ("tension_too_high", "team.tension", 0.132 * 9.81),
        ("plan_too_long", "limits.duration", 3.0),
    ],
)
def test_suggestions_are_just_beyond_what_statics_need(stem: str, key: str, needed: float) -> None:
    change: Any = {s.change.key: s.change for s in suggested(stem)}[key]
    assert (change.new - needed) * (change.new - change.old) >= 0.0  # beyond it, away from old
    assert change.new == pytest.approx(needed, rel=0.015)


def test_repair_gives_the_plan_of_the_smallest_change() -> None:
    plan = ho.repair(CASES["drones_too_close"], PATIENCE)
    best = suggested("drones_too_close")[0]
    assert plan.certificate.certified
    assert plan.title == f"Drones too close with {best.change}"
    assert np.unique(plan.motion.team.cable_length) == pytest.approx([best.change.new])


def test_what_can_be_met_needs_no_repair_and_what_nothing_mends_is_refused_as_before() -> None:
    good = problem_from_dict(small(title="Good"))
    assert ho.suggestions(good) == ()
    assert ho.repair(good).title == "Good"
    path = CASES["points_begin_elsewhere"]
    with pytest.raises(ho.InfeasibleError) as before:
        ho.solve(path)
    with pytest.raises(ho.InfeasibleError, match="no change was found") as after:
        ho.repair(path)
    assert after.value.violations == before.value.violations
    assert ho.suggestions(path) == ho.suggestions(CASES["drones_too_close"], budget=0.0) == ()


ARENA = {"lower": [-4, -4, 0], "upper": [4, 4, 1.3]}


@pytest.mark.slow
def test_faults_of_several_steps_are_repaired_together_and_the_rest_is_named() -> None:
    limits, raised = {"duration": 5.0}, {"transport": {"to": [0, 0, 1.5]}}
    data = small(limits=limits, arena=ARENA, mission=[raised, {"hold": {"seconds": 6.0}}])
    with pytest.raises(ho.InfeasibleError, match=r"not checked yet: steps 1 \(hold\)$"):
        ho.solve(problem_from_dict(data))
    suggestion = ho.suggestions(problem_from_dict(data), PATIENCE)[0]
    assert_as_suggested(data, suggestion)
    before, change = suggestion.change.before, suggestion.change
    assert before is not None
    assert before.key == "arena.upper[2]"
    assert change.key in {"limits.duration", "mission[1].hold.seconds"}
    assert str(suggestion).startswith(f"suggested change: {before} and {change.key}")
    plain: Any = suggestion.to_dict()
    assert [each["key"] for each in plain["edits"]] == ["arena", change.key]
    assert plain["before"]["key"] == before.key


@pytest.mark.slow
def test_tension_and_cable_are_changed_together() -> None:
    team = {"robots": 3, "cable_length": 1.9, "tension": 1.4}
    data = small(team=team, start={"hitch": {"polygon": CASE, "altitude": 1.0}})
    suggestions = ho.suggestions(problem_from_dict(data), PATIENCE)
    pairs = [{x.key for x in (s.change.before, s.change) if x is not None} for s in suggestions]
    assert_as_suggested(data, suggestions[pairs.index({"team.tension", "team.cable_length"})])


@pytest.mark.slow
def test_faults_behind_others_are_repaired_and_one_quantity_is_named_once() -> None:
    """Cables too short to tie hide a tilt; longer ones have to be longer still for the morph."""
    narrow, grown = ([[0.0, y], [0.5, -0.3], [-0.5, -0.3]] for y in (0.6, 0.9))
    data = small(
        team={"robots": 3, "cable_length": 1.0, "tension": 1.4},
        start={"hitch": {"polygon": narrow, "altitude": 1.0}},
        mission=[{"morph": {"polygon": grown}}],
    )
    suggestions = ho.suggestions(problem_from_dict(data), PATIENCE)
    for suggestion in suggestions:
        keys = [each.key for each in suggestion.change.together()]
        assert "team.cable_length" in keys or "polygon" in keys
        assert len(set(keys)) == len(keys) > 1
    assert_as_suggested(data, suggestions[0])


@pytest.mark.slow
def test_walls_on_several_sides_are_moved_together() -> None:
    data = small(arena={"lower": [-0.6, -0.6, 0], "upper": [0.6, 0.6, 2]})
    by_key = {s.change.key: s for s in ho.suggestions(problem_from_dict(data), PATIENCE)}
    assert_as_suggested(data, by_key["arena"])
    corners: Any = by_key["arena"].change.edits[0].value
    assert corners["lower"] == [-x for x in corners["upper"][:2]] + [0]
    assert corners["upper"][2] == 2


def test_changes_of_one_quantity_after_each_other_are_one() -> None:
    problem = problem_from_dict(small(arena=ARENA))
    knobs = {each.key: each for each in knobs_of(problem, ())}
    for key in ("team.cable_length", "polygon", "arena.upper[0]"):
        first = change_of(problem, knobs[key], 0.2)
        assert first is not None
        again = {each.key: each for each in knobs_of(first.problem, ())}
        second = change_of(first.problem, again[key], 0.5)
        between = change_of(first.problem, again["limits.speed"], 0.1)
        assert second is not None
        assert between is not None
        both = second.after(between.after(first))
        assert [each.key for each in both.together()] == ["limits.speed", key]
        share = (1.0 + 0.2 * (sign := knobs[key].sign)) * (1.0 + 0.5 * sign) - 1.0
        share = 0.2 + 0.5 * 1.2 if key == "arena.upper[0]" else share
        assert both.relative == pytest.approx(share, rel=0.01)
        assert both.old == first.old
        edited_problem = with_edits(problem, both.edits)
        for part in ("arena", "team", "start"):
            actual, expected = (getattr(x, part) for x in (edited_problem, second.problem))
            assert contents(actual) == contents(expected)


def test_a_change_that_is_undone_is_left_out() -> None:
    problem = problem_from_dict(small(arena=ARENA))
    knob = {(each.key, each.sign): each for each in knobs_of(problem, ())}
    lower = change_of(problem, knob["team.tension", -1], 0.5)
    assert lower is not None
    raised = {(each.key, each.sign): each for each in knobs_of(lower.problem, ())}
    between = change_of(lower.problem, raised["limits.speed", 1], 0.1)
    higher = change_of(lower.problem, raised["team.tension", 1], 1.0)
    assert between is not None
    assert higher is not None
    assert higher.new == lower.old
    (only,) = higher.after(between.after(lower)).together()
    assert only.key == "limits.speed"
    assert [edit.key for edit in higher.after(between.after(lower)).edits] == [
        "limits.speed",
        "team.tension",
    ]
    further = change_of(lower.problem, raised["limits.speed", 1], 0.2)
    assert further is not None
    assert further.after(higher.after(lower)).old == problem.limits.speed


def test_the_ground_stays_where_it_is_and_hitches_on_it_are_raised() -> None:
    problem = problem_from_dict(small(arena=ARENA))
    assert "arena.lower[2]" not in {each.key for each in knobs_of(problem, ())}
    (knob,) = altitude_knobs("altitude", 0.0)
    assert (knob.sign, knob.extent) == (1, 1.0)


@pytest.mark.slow
def test_changes_that_repair_several_faults_are_tried_before_those_that_repair_one() -> None:
    """A lower tension repairs thrust and tilt, but not the ceiling."""
    team = {"robots": 3, "cable_length": 2.4, "tension": 2.4}
    data = small(
        team=team,
        arena={"lower": [-4, -4, 0], "upper": [4, 4, 3]},
        start={"hitch": {"polygon": CASE, "altitude": 3.2}},
    )
    suggestion = ho.suggestions(problem_from_dict(data), PATIENCE)[0]
    assert suggestion.change.before is not None
    assert (suggestion.change.before.key, suggestion.change.key) == (
        "team.tension",
        "start.hitch.altitude",
    )
    assert_as_suggested(data, suggestion)


@pytest.mark.slow
def test_obstacles_without_a_free_side_are_passed_above() -> None:
    tray = {"circle": 0.1, "mass": 0.2, "at": [1.2, 0, 0], "rim": {"circle": 0.3, "at": 0.25}}
    wall = [[-0.05, -6.0], [-0.05, 6.0], [0.05, 6.0], [0.05, -6.0]]
    polygon = [[0.4, 0], [-0.2, -0.35], [-0.2, 0.35]]
    data: Any = small(
        team={"robots": 3, "cable_length": 2.2, "cable_density": 0.01, "tension": 1.0},
        objects={
            "tray": tray,
            "wall": {"outline": wall, "to": 0.8, "at": [3.3, 0, 0], "fixed": True},
        },
        arena={"lower": [-2, -4, 0], "upper": [8, 4, 4]},
        start={"hitch": {"polygon": polygon, "altitude": 1.0}},
        mission=[{"transport_object": {"object": "tray", "to": [5.5, 0.0, 0.0]}}],
    )
    key = "mission[0].transport_object"
    with pytest.raises(ho.InfeasibleError) as raised:
        ho.solve(problem_from_dict(data))
    assert f"raise {key}.lift, or carry it around with {key}.via" in str(raised.value)
    by_key = {s.change.key: s for s in ho.suggestions(problem_from_dict(data), PATIENCE)}
    # Its base is as far above the wall as objects are from each other.
    assert by_key[f"{key}.lift"].change.new == pytest.approx(0.8 + 0.035, abs=0.01)
    assert_as_suggested(data, by_key[f"{key}.lift"])


@pytest.mark.slow
def test_a_slipping_grip_gets_a_lighter_or_rougher_object() -> None:
    data: Any = read_yaml(PROBLEMS / "grip_drum.yaml")
    form, carry, *_ = data["mission"]
    data["team"] = {key: data["team"][key] for key in data["team"].keys() - {"quadrotor"}}
    data["team"]["cable_length"] = 1.6
    del data["limits"]["tracking"]
    data |= {"start": {"hitch": {**form["form"]}}, "mission": [carry]}
    (name, body), *_ = data["objects"].items()
    body["mass"] *= 3.0
    by_key: Any = {s.change.key: s for s in ho.suggestions(problem_from_dict(data), PATIENCE)}
    lighter, rougher = (by_key[f"objects.{name}.{key}"].change.new for key in ("mass", "friction"))
    assert lighter < body["mass"]
    assert body["friction"] < rougher <= 1.0
    assert_as_suggested(data, by_key[f"objects.{name}.mass"])
    body["mass"] = 0.5 * (lighter + body["mass"])
    with pytest.raises(ho.InfeasibleError):
        ho.solve(problem_from_dict(data))


def test_searches_end_where_each_change_breaks_another_limit_and_warn_of_no_trial(
    recwarn: pytest.WarningsRecorder,
) -> None:
    broken, speeds = itertools.cycle(("speed", "tilt", "acceleration")), list[float]()

    class Refused(Hold):
        """A step that breaks one limit after the other."""

        def plan(self, task: StepTask) -> StepPlan:
            name, limits = next(broken), task.requirements.limits
            speeds.append(limits.speed)
            raise refusal(name, getattr(limits, name))

    problem = problem_of(Refused(1.0), speed=60.0)
    with pytest.raises(ho.InfeasibleError) as refused:
        ho.solve(problem)
    assert find_suggestions(problem, refused.value, PATIENCE) == ()
    assert not recwarn.list
    with pytest.warns(UnitWarning):
        ho.Limits(speed=max(speeds))


def test_scaled_outlines_stay_similar_through_all_kinds_of_steps() -> None:
    data, factor = triangle(), 0.83
    problem = problem_from_dict(data)
    edits = scaled_outlines(problem, factor)
    before = outlines(problem)
    for changed in (with_edits(problem, edits), problem_from_dict(edited(data, edits))):
        after = outlines(changed)
        for old, new in zip(before, after, strict=True):
            assert new.edge_lengths == pytest.approx(factor * old.edge_lengths, abs=1e-7)
        assert after[0].centroid == pytest.approx(before[0].centroid, abs=1e-8)
        assert after[-1].centroid == pytest.approx([2.0, 1.2], abs=1e-8)  # where transport goes


def outlines(problem: ho.Problem) -> list[Any]:
    polygons: list[Any] = [hitch_start(problem).polygon]
    for step in problem.mission:
        polygons.append(step.checked_polygon_after(problem.team, polygons[-1]))
    return polygons


ARC = [[-1.0, 0.0], [-0.5, 0.9], [0.5, 1.1], [1.4, 0.7], [1.7, -0.3]]
TEAM = ho.Team(
    4,
    [2.4, 2.5, 2.6, 2.7],
    topology="open",
    tension=[0.41, 0.42, 0.43, 0.44],
    cable_density=0.003,
    cable_friction=0.05,
    quadrotor=[ho.Quadrotor(0.1 + 0.01 * k, 2.0 + 0.1 * k, 4.0 + k, k == 1) for k in range(4)],
    load=[0.001, 0.002, 0.003],
    errors={"cable_length": 0.004},
    release=True,
)
"""No field is its default; those per robot all differ."""


@pytest.mark.parametrize(
    ("edit", "changed"),
    [
        (lambda p: (team_edit(p, "cable_length", 1.1 * p.team.cable_length),), "cable_length"),
        (lambda p: (team_edit(p, "tension", 1.1 * p.team.tension),), "tension"),
        (lambda p: (team_edit(p, "max_thrust", 1.1 * p.team.max_thrust[::2]),), "quadrotor"),
        (lambda p: scaled_outlines(p, 0.9), ""),
    ],
)
def test_repaired_problems_keep_all_fields(edit: Callable[[ho.Problem], Any], changed: str) -> None:
    """A team with renumbered robots keeps them as well."""
    start = ho.HitchStart(ho.Hitch.balanced(TEAM, ARC, 1.1).polygon, 1.1, "balanced")
    problem = ho.Problem(TEAM, start, (Hold(2.0),))
    order, plain = (2, 0, 3, 1), ho.Team(3, 1.0)
    team = with_edits(problem, edit(problem)).team
    renumbered = Assignment(order, (False, True, False, True)).team(TEAM)
    assert renumbered.of_problem == TEAM
    for name in (field.name for field in fields(ho.Team) if field.name != "assignment"):
        values = [getattr(each, name) for each in (team, TEAM)]
        assert np.array_equal(*values) is (name != changed), name
        assert not np.array_equal(getattr(plain, name), values[1]), name
        per_robot = name in {"cable_length", "tension", "quadrotor"}
        expected = [values[1][i] for i in order] if per_robot else values[1]
        np.testing.assert_array_equal(getattr(renumbered, name), expected, err_msg=name)


def test_no_suggestion_adds_a_change_to_a_smaller_one() -> None:
    problem = problem_from_dict(small(arena=ARENA))
    knobs = {(each.key, each.sign): each for each in knobs_of(problem, ())}
    slower = change_of(problem, knobs["team.tension", -1], 0.1)
    assert slower is not None
    faster = change_of(slower.problem, knobs["limits.speed", 1], 0.2)
    assert faster is not None
    one, both = repair.Suggestion(slower, 1.0), repair.Suggestion(faster.after(slower), 1.0)
    alone = change_of(problem, knobs["limits.speed", 1], 0.3)
    assert alone is not None
    other = repair.Suggestion(alone, 1.0)
    assert repair._smallest([other, both, one]) == (one, other)
    assert repair._smallest([other, both]) == (both, other)


def test_values_in_another_unit_are_converted_and_nothing_else_is_suggested() -> None:
    """An altitude in centimetres and an outline in millimetres, not kilometres of cable."""
    outline = (1000.0 * EDGE.scaled(0.9).vertices).round(3).tolist()
    data = small(arena=ARENA, mission=[{"morph": {"polygon": outline}}])
    data["start"]["hitch"]["altitude"] = 105
    with pytest.warns(UnitWarning):
        problem = problem_from_dict(data)
    (suggestion,) = ho.suggestions(problem, PATIENCE)
    assert "altitude 105 -> 1.05 m and mission[0].morph.polygon as given" in str(suggestion)
    assert_as_suggested(data, suggestion)


@pytest.mark.filterwarnings("ignore::hitchopt.errors.UnitWarning")
def test_lengths_do_not_grow_twentyfold() -> None:
    problem = problem_from_dict(small(arena=ARENA))
    knobs = {(each.key, each.sign): each for each in knobs_of(problem, ())}
    changes = [
        change_of(problem, knobs["team.cable_length", 1], 9.0),
        change_of(problem, knobs["team.cable_length", 1], 30.0),
        change_of(problem, knobs["arena.upper[2]", 1], 100.0),
        change_of(problem, knobs["limits.speed", 1], 50.0),
    ]
    suggestions = [repair.Suggestion(change, 1.0) for change in changes if change is not None]
    assert {round(x.change.relative) for x in repair._smallest(suggestions)} == {9, 50}


def with_quadrotor(*kinds: ho.Quadrotor) -> ho.Problem:
    problem = problem_from_dict(small())
    return replace(problem, team=ho.Team(3, 2.4, quadrotor=[*kinds]))


def test_controllers_are_replaced_by_those_of_the_same_firmware() -> None:
    """Of PX4 there is one: its gains become the largest that it declares, once."""
    of_px4 = ho.Quadrotor(2.0, 40.0, controller="px4")
    plain, lee = ho.Quadrotor(), ho.Quadrotor(controller="lee")
    (change,) = retuning_changes(with_quadrotor(of_px4, plain, of_px4))
    new = change.problem.team.quadrotor
    assert [kind.controller for kind in new] == ["px4", None, "px4"]
    assert new[0].loop == ho.Quadrotor(2.0, 40.0, controller="px4", gains=PX4_GAINS).loop
    errors = [Tube.of(kind.loop.tracking).largest for kind in (new[0], of_px4)]
    assert errors[0] < 0.9 * errors[1]
    assert not list(retuning_changes(change.problem))
    (change,) = retuning_changes(with_quadrotor(lee, lee, plain))
    assert [kind.controller for kind in change.problem.team.quadrotor] == ["mellinger"] * 2 + [None]


PX4_GAINS = {"kp": [20.0, 45.0], "kd": [10.0, 30.0], "ki": 0.0}
"""Gains for 2 kg of docs/how_to/before_you_fly.md."""
