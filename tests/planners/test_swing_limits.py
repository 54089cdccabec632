"""``limits.swing``: clocks stretch until it holds, and stated times that break it are refused."""

import json
import re
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hitchopt as ho
from hitchopt.checks.certificate import CertificateError
from hitchopt.checks.swing import LEFT_SHARE, swinging_hitches, worst_swing
from hitchopt.errors import InfeasibleError
from hitchopt.motion.flight import Flight
from hitchopt.motion.motion import Motion
from hitchopt.motion.plan_file import write_plan
from hitchopt.planners.timing.stretch import needed_stretch
from hitchopt.planners.timing.swing import after_swing, calm_stretch
from hitchopt.steps.moving import FollowVertex
from hitchopt.verify import verify
from tests.helpers.commands import run

CORNERS = np.array([[0.0, 0.64], [0.55, -0.32], [-0.55, -0.32]])
PULLED = CORNERS + [[0.0, 0.15], [0.0, 0.0], [0.0, 0.0]]


def hitch(density: float = 0.01, **values: Any) -> ho.Hitch:
    """Return the triangle of ``hitchopt init``."""
    team = ho.Team(3, 2.35, cable_density=density, tension=0.4, **values)
    return ho.Hitch.balanced(team, CORNERS, 1.6)


@cache
def pulled(swing: float | None = 0.05, density: float = 0.01) -> ho.Plan:
    """Return the plan in which a vertex is pulled out."""
    return ho.morph(hitch(density), PULLED, limits=ho.Limits(swing=swing))


def worst(motion: Motion) -> float:
    """Return the certified estimate [m]."""
    found = worst_swing(motion)
    assert found is not None
    return found.worst


def test_the_default_is_five_centimetres() -> None:
    assert ho.Limits().swing == 0.05
    assert pulled().certificate["swing"].limit == 0.05


@pytest.mark.parametrize("limit", [0.08, 0.05, 0.02, 0.005])
def test_a_clock_is_as_slow_as_its_swing_needs(limit: float) -> None:
    """It keeps the limit, and half of it at the end; 3 % faster, it breaks one of both."""
    motion = pulled(limit).motion
    (swinging,) = swinging_hitches(motion)

    def keeps(slowing: float) -> bool:
        """Return whether a slower or faster motion keeps both."""
        distances = swinging.distances(slowing)
        left = np.max(distances[swinging.moving :])
        return bool(max(np.max(distances), left / LEFT_SHARE) <= limit)

    assert keeps(1.0)
    assert not keeps(0.97)
    assert "swing" in pulled(limit).certificate.binding
    assert "swing allows" in str(pulled(limit).certificate)


def test_the_profile_of_the_planner_is_stretched() -> None:
    """Slow motion of the fastest plan is the plan, up to the clock's rounding."""
    fast, slow = pulled(None).motion, pulled().motion
    assert worst(fast) > 0.05
    assert slow.duration > 1.5 * fast.duration
    shares = np.linspace(0.0, 1.0, 21)
    places = [each.drones.at(each.duration * shares) for each in (fast, slow)]
    assert np.max(np.abs(places[0] - places[1])) < 1e-9
    assert needed_stretch(slow) < 1.0


def test_without_inertia_or_limit_nothing_is_slower() -> None:
    weightless = [pulled(limit, 0.0).motion for limit in (0.05, None)]
    coefficients = [motion.drones.coefficients for motion in weightless]
    assert np.array_equal(coefficients[0], coefficients[1])
    assert "swing" not in {check.name for check in pulled(0.05, 0.0).certificate.checks}
    assert calm_stretch(pulled(None).motion) == 1.0


def test_a_stated_duration_is_refused_with_one_that_holds() -> None:
    with pytest.raises(InfeasibleError) as refused:
        ho.morph(hitch(), PULLED, duration=0.8)
    (violation,) = refused.value.violations
    assert (violation.constraint, violation.limit) == ("swing", 0.05)
    found = re.search(r"allow ([0-9.]+) s", violation.remedy)
    assert found is not None
    seconds = float(found[1])
    assert ho.morph(hitch(), PULLED, duration=seconds).duration == pytest.approx(seconds)
    with pytest.raises(InfeasibleError, match="swing"):
        ho.morph(hitch(), PULLED, duration=0.95 * seconds)


def test_a_timed_path_is_refused_with_a_time_that_holds() -> None:
    def followed(seconds: float) -> ho.Plan:
        """Return the plan of a vertex that is out at a time."""
        return ho.solve(hitch(), FollowVertex(0, [[seconds, 0.0, 0.79]]))

    with pytest.raises(InfeasibleError, match=r"swing: .* allow [0-9.]+ s") as refused:
        followed(0.9)
    found = re.search(r"allow ([0-9.]+) s", refused.value.violations[0].remedy)
    assert found is not None
    assert followed(float(found[1])).certificate.certified


def test_steps_leave_room_for_what_still_swings() -> None:
    """Of several moves in a row, the whole plan keeps the limit."""
    steps = [ho.Morph(PULLED), ho.Morph(CORNERS), ho.Morph(PULLED), ho.Morph(CORNERS)]
    plan = ho.solve(hitch(), steps)
    assert plan.certificate.certified
    first = pulled().motion
    lowered = after_swing(first.requirements, first).limits.swing
    assert lowered is not None
    left = worst_left(first)
    assert 0.05 - left - 0.005 <= lowered <= 0.05 - left


def worst_left(motion: Motion) -> float:
    """Return how far vertices swing after the end [m]."""
    (swinging,) = swinging_hitches(motion)
    return float(np.max(swinging.distances()[swinging.moving :]))


def test_check_refuses_a_clock_made_faster(tmp_path: Path) -> None:
    """The row is recomputed from the polynomials; the verifier leaves it out, and still proves."""
    plan = pulled()
    write_plan(tmp_path / "plan.npz", plan.flight)
    assert {row.name for row in verify(tmp_path) if row.verdict == "violated"} == set()
    faster = plan.motion.slowed(1.0 / 1.3)
    write_plan(tmp_path / "plan.npz", Flight.of(faster))
    with pytest.raises(CertificateError, match="swing"):
        ho.certify(ho.load(tmp_path)).raise_if_violated()


def test_null_states_no_limit(tmp_path: Path) -> None:
    problem = {
        "team": {"robots": 3, "cable_length": 2.35, "cable_density": 0.01, "tension": 0.4},
        "limits": {"swing": None},
        "start": {"hitch": {"polygon": CORNERS.tolist(), "altitude": 1.6}},
        "mission": [{"morph": {"polygon": PULLED.tolist()}}],
    }
    (tmp_path / "problem.yaml").write_text(json.dumps(problem), encoding="utf-8")
    result = run("solve", tmp_path / "problem.yaml", "-o", tmp_path / "out", "--no-picture")
    assert result.exit_code == 0, result.output
    plan = ho.load(tmp_path / "out")
    assert plan.motion.requirements.limits.swing is None
    assert plan.certificate["swing"].limit is None
    assert plan.certificate["swing"].worst > 0.05
    assert replace(plan.motion.requirements.limits, swing=0.05) == ho.Limits()
