"""Plans of two cables that are tied around an object while other teams fly next to them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hitchopt as ho
from hitchopt.mission.loading import problem_from_dict
from hitchopt.motion.motion import CableState
from hitchopt.motion.plan_file import write_plan
from hitchopt.objects.placing import REST_DRIFT
from tests.helpers.plans import planned, planned_of
from tests.helpers.second_opinions import opinion_of

CABLES = {"robots": 2, "cable_length": 2.4, "cable_density": 0.005, "tension": 1.0}
DRUM = {"circle": 0.12, "to": 0.4, "mass": 0.08, "friction": 0.5, "at": [0, 0, 0]}
POLYGON: Any = np.array([[0, 0.75], [0.65, -0.375], [-0.65, -0.375]])


def problem(sense: float = 1.0, *, reverse: bool = False) -> dict[str, Any]:
    """Return two cables that carry a drum by 0.5 m, which a triangle passes above.

    The triangle flies towards y > 0, or mirrored; the order of teams may be reversed.
    """
    teams: dict[str, Any] = {
        "pair": {**CABLES, "quadrotor": "paper_132g"},
        "ring": {"robots": 3, "cable_length": 2.3},
    }
    order = list(reversed(teams)) if reverse else list(teams)
    polygon = (POLYGON * [1.0, sense] + [0.0, -2.6 * sense])[:: int(sense)]
    drones = {"q": [[-1.0, 0.5, 0], [1.0, -0.5, 0]], "r": [[1.0, 0.5, 0], [-1.0, -0.5, 0]]}
    carry = [
        {"lift": {"by": 0.3}},
        {"carry": {"object": "drum", "to": [0.5, 0, 0.3]}},
        {"set_down": {"object": "drum"}},
    ]
    items: list[dict[str, Any]] = [
        {"pair": {"tie": {"around": "drum", "at": 0.35}}, "ring": {"hold": {"seconds": 1}}},
        {"pair": carry, "ring": {"transport": {"to": [0, 2.6 * sense, 1.5]}}},
        {"pair": [{"untie": {}}, {"land": {}}]},
    ]
    starts: dict[str, Any] = {
        "pair": {"drones": drones},
        "ring": {"hitch": {"polygon": polygon.tolist(), "altitude": 1.5}},
    }
    return {
        "teams": {name: teams[name] for name in order},
        "limits": {"tilt_deg": 60},
        "objects": {"drum": DRUM},
        "start": {name: starts[name] for name in order},
        "mission": items,
    }


def worst(plan: ho.Plan) -> dict[str, float]:
    return {check.name: check.worst for check in plan.certificate.checks}


@pytest.mark.slow
def test_a_drum_is_tied_carried_and_untied_below_a_triangle(tmp_path: Path) -> None:
    plan = planned_of(problem())
    assert plan.certificate.certified
    pair, ring = (flown.motion for flown in plan.flight.teams)
    assert {CableState.BENT, CableState.ROLLING, CableState.HITCHED} <= pair.cable_states
    end = pair.poses.at(pair.duration)[0]
    np.testing.assert_allclose(end[:3], [0.5, 0.0, 0.0], atol=REST_DRIFT)
    times = np.linspace(0.0, plan.duration, 2001)
    ring_drones, pair_drones = ring.drones.at(times), pair.drones.at(times)
    assert np.min(np.linalg.norm(np.mean(ring_drones, axis=1)[:, :2], axis=-1)) < 0.01
    gaps = ring_drones[:, :, None] - pair_drones[:, None]
    assert np.min(np.linalg.norm(gaps, axis=-1)) < 1.5
    assert {row.verdict for row in opinion_of(plan.flight, tmp_path)} == {"proven"}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("other", "differing"),
    [(problem(reverse=True), set()), (problem(-1.0), {"downwash"})],
    ids=["order", "mirror"],
)
def test_plans_do_not_depend_on_the_order_of_teams_or_the_side(
    other: dict[str, Any], differing: set[str]
) -> None:
    """A mirrored triangle passes above legs of another length: both of a cable differ."""
    here, there = planned_of(problem()), planned_of(other)
    assert there.duration == pytest.approx(here.duration, rel=1e-6)
    same = worst(here).keys() - differing
    expected, found = ({name: worst(plan)[name] for name in same} for plan in (here, there))
    assert found == pytest.approx(expected, rel=5e-3, abs=1e-3)


@pytest.mark.slow
def test_a_triangle_waits_for_an_external_plan_that_ties_a_drum(tmp_path: Path) -> None:
    """It would meet the legs of the cables that bend around the drum."""
    write_plan(tmp_path / "plan.npz", planned("two_robots_drum").flight)
    beside: dict[str, Any] = {
        "team": {"robots": 3, "cable_length": 2.3},
        "others": {"pair": {"plan": str(tmp_path), "at": 0.0}},
        "start": {"hitch": {"polygon": (POLYGON + [0.0, -3.0]).tolist(), "altitude": 0.9}},
        "mission": [{"transport": {"to": [0, 3.0, 0.9]}}],
    }
    plan = ho.solve(problem_from_dict(beside))
    assert plan.certificate.certified
    assert plan.phases[0].name == "wait"
    assert {row.verdict for row in opinion_of(plan.flight, tmp_path)} == {"proven"}
    at_once = ho.combine(
        planned("two_robots_drum"), ho.solve(_alone(beside)), names=("pair", "ring")
    )
    assert {"crossing", "cable_clearance"} & {x.name for x in at_once.certificate.violated}


def _alone(data: dict[str, Any]) -> ho.Problem:
    """Return the problem without external plans."""
    return problem_from_dict({key: value for key, value in data.items() if key != "others"})
