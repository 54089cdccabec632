"""Candidates: their order, their effort, and what is said of those that fail."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

import hitchopt as ho
from benchmarks.families import scattered_form
from hitchopt.errors import (
    FaultWarning,
    HitchoptError,
    InfeasibleError,
    InputError,
    PlannerError,
    RequestError,
    TimeLimitError,
    Violation,
)
from hitchopt.forming import prehitch
from hitchopt.forming.swap_settings import SwapSettings
from hitchopt.hitch.requirements import Requirements
from hitchopt.planners.candidates import (
    CANDIDATE_COST,
    Candidate,
    Effort,
    explained_once,
    first_certified,
    if_feasible,
)


def refused(value: float, limit: float = 1.0) -> InfeasibleError:
    """Return the error of a separation."""
    violation = Violation("separation", value, limit, "min", "ratio", ("q0",), "", "move")
    return InfeasibleError([violation])


def failing(error: HitchoptError) -> str:
    """Raise an error, as a planner does."""
    raise error


def candidates(*errors: HitchoptError | str) -> Iterator[Candidate[str]]:
    """Yield candidates that raise an error, or return a plan."""
    for error in errors:
        if isinstance(error, str):
            yield Candidate("circle", partial(str, error))
        else:
            yield Candidate("circle", partial(failing, error))


def test_the_first_certified_plan_is_returned_and_no_further_one_is_planned() -> None:
    ways = candidates(refused(0.5), "first", "second")
    assert first_certified(ways, Effort()) == "first"
    assert next(ways).plan() == "second"


def test_the_best_failure_is_raised_with_its_cause_and_what_was_tried() -> None:
    best = refused(0.9)
    swaps = Candidate("swaps", partial(failing, refused(0.2)))
    ways = [swaps, *candidates(refused(0.5), best, refused(0.7))]
    with pytest.raises(InfeasibleError) as caught:
        first_certified(ways, Effort())
    assert caught.value.violations == best.violations
    assert caught.value.__cause__ is best
    note = "the best of 4 candidates: swaps, 3 circles; swaps: separation: 0.2 is below"
    assert caught.value.note.startswith(note)


def test_only_the_best_failure_of_nested_searches_is_explained() -> None:
    explained = list[float]()

    def explain(error: InfeasibleError) -> InfeasibleError:
        explained.append(error.violations[0].value)
        return error.at("explained")

    def searched(*values: float) -> str:
        ways = [Candidate("hold", partial(failing, refused(x)), explained=explain) for x in values]
        return first_certified(ways, Effort())

    orientations = [
        Candidate("orientation", partial(searched, *values)) for values in ((0.2, 0.5), (0.8, 0.3))
    ]
    with pytest.raises(InfeasibleError) as caught, explained_once():
        first_certified(orientations, Effort())
    assert explained == [0.8]
    assert [(x.value, x.when) for x in caught.value.violations] == [(0.8, "explained")]
    assert "the best of 2 candidates: 2 holds" in caught.value.note
    assert "the best of 2 candidates: 2 orientations" in caught.value.note
    assert if_feasible("orientation", partial(searched, 0.1), None) is None
    assert explained == [0.8]


def test_a_single_failure_is_raised_as_it_is() -> None:
    error = refused(0.9)
    with pytest.raises(InfeasibleError) as caught:
        first_certified(candidates(error), Effort())
    assert caught.value is error


def test_effort_is_counted_in_candidates_and_ends_the_search() -> None:
    """The first candidate is tried in any case; parts of an effort count for the whole."""
    whole = Effort(2.5 * CANDIDATE_COST)
    ways = candidates(refused(0.1), refused(0.2), refused(0.3), "too late")
    with pytest.raises(InfeasibleError, match="used up the effort") as caught:
        first_certified(ways, Effort(whole=whole))
    assert caught.value.violations[0].value == 0.2
    with pytest.raises(InfeasibleError):
        first_certified(candidates(refused(0.1), "too late"), whole)


def test_progress_names_what_is_tried_after_a_failure() -> None:
    said = list[str]()
    ways = candidates(refused(0.1), refused(0.2), "planned")
    first_certified(ways, Effort(), said.append)
    assert said == ["trying circle 2", "trying circle 3"]


def test_a_candidate_is_followed_by_what_it_is_amended_to() -> None:
    """Until nothing can be changed; then the next one follows."""

    def planned(distance: float) -> float:
        if distance < 1.0:
            failing(refused(distance))
        return distance

    def amended(distance: float, error: InfeasibleError) -> Candidate[float] | None:
        missing = 1.0 - error.violations[0].value
        return farther(distance + missing) if missing < 0.5 else None

    def farther(distance: float) -> Candidate[float]:
        return Candidate("distance", partial(planned, distance), partial(amended, distance))

    assert first_certified([farther(0.9), farther(3.0)], Effort()) == 1.0
    assert first_certified([farther(0.2), farther(3.0)], Effort()) == 3.0


def test_errors_of_planners_are_no_errors_of_input() -> None:
    """Requests and time limits are; other candidates still lead to a plan, with a warning."""
    fault = InputError("altitude", float("inf"), "finite", "write a number")
    with pytest.warns(FaultWarning, match="circle: a planner failed: altitude = inf"):
        assert first_certified(candidates(fault, "planned"), Effort()) == "planned"
    with pytest.warns(FaultWarning, match="altitude = inf"):
        assert if_feasible("circle", partial(failing, fault), 0.0) == 0.0
    with pytest.raises(PlannerError, match="altitude = inf"):
        first_certified(candidates(fault, fault), Effort())
    assert not issubclass(PlannerError, InputError)
    for error in (RequestError("by", "grip", "rest", "omit it"), TimeLimitError([])):
        with pytest.raises(type(error)):
            first_certified(candidates(error, "planned"), Effort())


TEAM = {"robots": 3, "cable_length": 2.4, "cable_density": 0.005}
TRIANGLE = [[0.0, 0.6], [0.5, -0.3], [-0.5, -0.3]]
FORM = {
    "team": TEAM,
    "start": {
        "drones": {
            "q": [[-1.5, -1.0, 0], [-1.5, 0.5, 0], [1.5, -1.0, 0]],
            "r": [[-1.5, 0.0, 0], [-1.5, 1.5, 0], [1.5, 0.0, 0]],
        }
    },
    "mission": [{"form": {"polygon": TRIANGLE, "altitude": 1.5}}],
}
MORPH = {
    "team": TEAM,
    "start": {"hitch": {"polygon": TRIANGLE, "altitude": 1.5}},
    "mission": [{"morph": {"polygon": [[0.0, 0.7], [0.5, -0.3], [-0.5, -0.3]]}}],
}


@pytest.mark.parametrize(
    ("problem", "place"),
    [
        (FORM, "hitchopt.forming.prehitch._ellipses"),
        (FORM, "hitchopt.forming.tying.rest_plan"),
        (FORM, "hitchopt.forming.approach.straight_stages"),
        (MORPH, "hitchopt.planners.along.straight_path"),
        pytest.param(MORPH, "hitchopt.planners.along.motion_along", marks=pytest.mark.slow),
    ],
)
def test_records_that_planners_build_from_bad_values_leave_the_file_valid(
    problem: dict[str, object], place: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Wherever in a planner they are built: another candidate is planned, or a planner failed.

    In both cases the fault is told.
    """

    def fault(*_: object, **__: object) -> None:
        raise InputError("altitude", np.inf, "finite", "write a number")

    monkeypatch.setattr(place, fault)
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        try:
            plan = ho.solve(ho.problem_from_dict(problem))
        except HitchoptError as error:
            assert isinstance(error, PlannerError)  # noqa: PT017
        else:
            assert plan.certificate.certified
            assert any("altitude = inf" in str(each.message) for each in warned)


def test_a_fault_within_a_candidate_is_told_once() -> None:
    """A planner that tries candidates of its own is no other fault, and hides none."""
    fault = InputError("altitude", float("inf"), "finite", "write a number")
    within = Candidate("morph", lambda: first_certified(candidates(fault), Effort()))
    with pytest.warns(FaultWarning, match=r"^morph: a planner failed: altitude = inf") as warned:
        assert first_certified([within, *candidates("planned")], Effort()) == "planned"
    assert len(warned) == 1
    with pytest.raises(PlannerError, match=r"^a planner failed: altitude = inf"):
        first_certified([within], Effort())


def test_what_a_search_does_not_find_is_no_fault() -> None:
    lost = PlannerError(HitchoptError("no route was found"))
    for error in (lost, HitchoptError("no route was found"), refused(0.5)):
        assert first_certified(candidates(error, "planned"), Effort()) == "planned"


def test_a_cable_that_errors_may_pull_taut_has_no_altitude() -> None:
    hitch = ho.Hitch.balanced(ho.Team(3, 2.4, cable_density=0.005), TRIANGLE, 1.5)
    requirements = replace(Requirements(), position_error=1.1)
    found = prehitch.find_prehitch(hitch, Requirements(), SwapSettings())
    with pytest.raises(InfeasibleError, match="tracking_radius"):
        replace(found, depth=np.inf).clear_of_ground(requirements)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [15, 17, 20, 28])
def test_forms_are_tied_where_the_first_way_fails(seed: int) -> None:
    """A cable that errors pull taut, missing height, another altitude, shapes in doubt."""
    plan = ho.solve(ho.problem_from_dict(scattered_form(seed)))
    assert plan.certificate.certified
