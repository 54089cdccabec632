"""Forming, release and landing in missions: plans, roles, refusals."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hitchopt as ho
from hitchopt.hitch.team import Assignment
from hitchopt.values import Array
from tests.helpers.plans import planned

TEAM = ho.Team(3, 2.4)
TRIANGLE = np.array([[0.0, 0.6], [0.5, -0.3], [-0.5, -0.3]])
LINES = np.array([[-0.6, -1.2, 0.0], [-0.6, 0.0, 0.0], [-0.6, 1.2, 0.0]])
MIRROR = np.array([-1, 1, 1])
HIGH = LINES + [0.0, 0.0, 2.0]


def forming(q: Array, r: Array, **keys: Any) -> ho.Plan:
    options = {"team": TEAM, "polygon": TRIANGLE, "altitude": 1.5, **keys}
    return ho.form(q=q, r=r, **options)


def test_a_whole_mission_is_one_plan_with_one_certificate() -> None:
    plan = planned("tie_carry_untie")
    assert [phase.name for phase in plan.phases] == [
        *("take-off", "approach", "swap 1", "swap 2", "tighten", "tension"),
        *("morph", "transport", "hold"),
        *("relax", "loosen", "unswap 1", "unswap 2", "land"),
    ]
    assert [p.state.hitched for p in plan.phases] == [False] * 5 + [True] * 5 + [False] * 4
    assert [p.step for p in plan.phases] == [0] * 6 + [1, 2, 3] + [4] * 4 + [5]
    assert plan.certificate.certified
    assert plan.certificate["interlacing"].worst == 0.0
    ends = plan.at([0.0, plan.duration])
    assert not np.any(ends.formed)
    np.testing.assert_allclose(ends.positions[..., 2], 0.0, atol=1e-12)
    tensions = plan.at(np.array([p.end for p in plan.phases if p.name in {"tension", "hold"}]))
    np.testing.assert_allclose(tensions.tensions, 0.4, atol=1e-12)


def test_a_saved_plan_tells_its_roles_and_vertices_while_it_is_tied(tmp_path: Path) -> None:
    plan = planned("tie_carry_untie")
    plan.save(tmp_path, rate=10.0)
    roles, rows = plan.motion.assignment, (tmp_path / "vertices.csv").read_text().splitlines()[1:]
    assert roles is not None
    expected = {"robots": list(roles.robots), "flipped": list(roles.flipped)}
    assert json.loads((tmp_path / "certificate.json").read_text())["assignment"] == expected
    times, formed = (
        [float(row.split(",")[0]) for row in rows],
        [p for p in plan.phases if p.state.hitched],
    )
    assert formed[0].start - 1e-9 <= min(times) <= max(times) <= formed[-1].end + 0.1


def test_drones_start_where_the_problem_places_them() -> None:
    """Auto: any order of the robots, with ends exchanged, gives the same plan for each drone."""
    # One robot aside, as mirror images tie; all of them aside would leave the tie.
    offset = [[0.0, 0.0, 0.0], [0.13, 0.0, 0.0], [0.0, 0.0, 0.0]]
    q_start, r_start = LINES + offset, LINES * MIRROR + offset
    plan = forming(q_start, r_start)
    order, flip = [2, 0, 1], np.array([[True], [False], [True]])
    q, r = np.where(flip, r_start, q_start)[order], np.where(flip, q_start, r_start)[order]
    other = forming(q, r)
    t = np.linspace(0.0, plan.duration, 101)
    listed = np.array([2 * k + (end ^ flip[k, 0]) for k in order for end in (0, 1)])
    expected = plan.at(t).positions[:, listed]
    np.testing.assert_allclose(other.at(t).positions, expected, atol=1e-9)
    ends = np.stack([q, r], axis=1).reshape(-1, 3)
    np.testing.assert_array_equal(other.at(0.0).positions, ends)


def test_hitches_near_the_ground_are_tied_higher_up_and_lowered() -> None:
    """Low hitches are also raised before release."""
    plan = forming(LINES, LINES * MIRROR, altitude=0.5)
    assert plan.phases[-1].name == "lower"
    assert "hang" in plan.phases[-1].remark
    np.testing.assert_allclose(plan.at(plan.duration).positions[:, 2], 0.5, atol=1e-9)
    for altitude, raised in ((0.5, ["raise"]), (1.6, [])):
        start = ho.Hitch.spread(TEAM, TRIANGLE, altitude)
        up = ho.solve(start, ho.Release())
        names = [*raised, "relax", "loosen", "unswap 1", "unswap 2"]
        assert [phase.name for phase in up.phases] == names
        assert up.certificate["cable_clearance"].worst > 0.1
        np.testing.assert_allclose(up.at(0.0).positions, start.drones, atol=1e-12)


def test_drones_that_hover_need_not_take_off_and_land_where_they_are() -> None:
    assert forming(HIGH, HIGH * MIRROR).phases[0].name == "approach"
    for low in (0.0, 0.4):
        arena = ho.Arena([-3, -3, low], [3, 3, 3])
        landed = ho.solve(ho.DronesStart(HIGH, HIGH * MIRROR), ho.Land(), team=TEAM, arena=arena)
        assert [p.name for p in landed.phases] == ["land"]
        expected = landed.at(0.0).positions
        expected = np.column_stack([expected[:, :2], np.full(6, low)])
        np.testing.assert_allclose(landed.at(landed.duration).positions, expected, atol=1e-12)
        assert landed.certificate["arena"].worst == pytest.approx(0.0, abs=1e-11)
        assert landed.certificate["arena"].holds


def test_open_chains_are_tied_as_well() -> None:
    q = np.array([[-2.0, -1, 0], [-0.5, -1, 0], [1, -1, 0]])
    arc = [[-1.5, 0], [-0.6, 0.8], [0.6, 0.8], [1.5, 0]]
    plan = ho.form(ho.Team(3, 2.0, topology="open"), q, q + [1.0, 0.0, 0.0], arc, 1.5)
    assert plan.certificate.certified
    assert plan.certificate["interlacing"].worst == 0.0


def test_steps_last_as_long_as_they_are_given() -> None:
    plan = forming(LINES, LINES * MIRROR, duration=20.0)
    assert [plan.duration, plan.phases[-1].end] == pytest.approx([20.0, 20.0], rel=1e-12)
    with pytest.raises(ho.InfeasibleError, match=r"^duration: 2 s is below the limit of \d.*form"):
        forming(LINES, LINES * MIRROR, duration=2.0)


def test_scattered_robots_in_the_wrong_order_gather_first() -> None:
    """Straight ways would tangle: cables are drawn together and carried around each other."""
    angles = np.random.default_rng(1).uniform(-np.pi, np.pi, 4)
    arms = 0.5 * np.column_stack([np.cos(angles), np.sin(angles), np.zeros(4)])
    middles = 1.6 * np.array([[0, 0, 0], [1, 1, 0], [1, 0, 0], [0, 1, 0]])
    square = [[0.3, 1.3], [1.3, 1.3], [1.3, 0.3], [0.3, 0.3]]
    plan = ho.form(ho.Team(4, 2.0), middles - arms, middles + arms, square, 1.5, assign="fixed")
    names = [phase.name for phase in plan.phases]
    assert plan.motion.assignment == Assignment((0, 1, 2, 3), (False,) * 4)
    assert names[:5] == ["take-off", "gather", "turn", "approach", "open"]
    assert plan.certificate["interlacing"].worst == 0.0


@pytest.mark.parametrize(
    ("q", "r", "keys", "binds"),
    [
        (LINES * [1, 0.05, 1], LINES * [-1, 0.05, 1], {}, "separation"),
        (LINES * [1, 0.5, 1], LINES[::-1] * [-1, 0.5, 1], {}, "crossing"),
        (LINES, LINES * MIRROR, {"legs": [0.05, 0.7, 0.7]}, "legs"),
        (LINES, LINES * MIRROR, {"limits": ho.Limits(tilt=0.1)}, "tilt"),
    ],
)
def test_what_binds_is_told_with_time(q: Array, r: Array, keys: dict[str, Any], binds: str) -> None:
    with pytest.raises(ho.InfeasibleError) as raised:
        forming(q, r, **keys)
    when = "step 0" if keys else "at the start (t = 0)"
    assert binds in {violation.constraint for violation in raised.value.violations}
    assert all(when in violation.moment for violation in raised.value.violations)


def test_plans_go_on_from_the_end_of_one_that_has_exchanged_robots(tmp_path: Path) -> None:
    """Also with unequal cables, whose robots the other plan's problem lists in another order."""
    q = [[-1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [1.0, -1.0, 0.0]]
    r = [[-0.5, 1.0, 0.0], [1.0, 0.5, 0.0], [0.5, -1.0, 0.0]]
    triangle = [[0.3, -0.8], [-0.1, 0.7], [0.7, 0.7]]
    end = ho.form(ho.Team(3, [2.4, 2.5, 2.6]), q, r, triangle).end
    assert end.team.assignment is not None
    assert end.team.assignment.robots != (0, 1, 2)
    plan = ho.solve(end, ho.Transport([0.2, 0.1, 1.1]))
    plan.save(tmp_path)
    assert ho.load(tmp_path).certificate.certified
    assert ho.solve(end, ho.Release()).certificate.certified


def test_a_cable_through_which_another_robot_would_have_to_be_pulled_is_refused() -> None:
    """Two robots start with crossed cables, one over the other: no certified plan unties them."""
    q = np.array([[-0.6, -0.6, 2.0], [-0.6, 0.6, 2.6], [2.0, 2.0, 2.0]])
    r = np.array([[0.6, 0.6, 2.0], [0.6, -0.6, 2.6], [3.0, 2.0, 2.0]])
    with pytest.raises(ho.InfeasibleError) as raised:
        forming(q, r)
    assert raised.value.violations[0].constraint in {"cable_clearance", "crossing"}


@pytest.mark.slow
def test_nobody_flies_below_the_ground() -> None:
    """The floor of an arena is the ground."""
    for low, altitude in ((0.0, -1.0), (-1.0, 1.2)):
        below = [0.0, 0.0, low]
        with pytest.raises(ho.InfeasibleError, match="above the ground"):
            forming(LINES + below, LINES * MIRROR + below, altitude=altitude)
    arena, below = ho.Arena([-5.0, -5.0, -3.0], [5.0, 5.0, 3.0]), [0.0, 0.0, -3.0]
    forming(LINES + below, LINES * MIRROR + below, altitude=-1.0, arena=arena)


def test_a_hitch_is_untied_with_the_errors_that_a_first_plan_lacks() -> None:
    """A first plan is short of these errors by half a millimetre."""
    team = ho.Team(3, 1.45, cable_density=0.0015, quadrotor="crazyflie_2.1_brushless")
    start = ho.HitchStart([[0, 0.4], [0.35, -0.2], [-0.35, -0.2]], 1.2)
    plan = ho.solve(start, ho.Release(), team=team, limits=ho.Limits(tracking=0.05))
    assert plan.certificate["tracking_radius"].worst >= 0.05
