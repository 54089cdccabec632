"""A certificate from those of the parts, against one that looks at the whole anew."""

from dataclasses import replace

import numpy as np
import pytest

import hitchopt as ho
from hitchopt.checks import certify, merged
from hitchopt.motion.motion import Motion, joined_motions

TRIANGLE = [[0.0, -1.0], [-0.4, 0.5], [0.4, 0.5]]


@pytest.fixture(scope="module")
def parts() -> list[Motion]:
    """Four steps of a triangle with drones of unequal thrust, off the origin."""
    quadrotors = [ho.Quadrotor(0.132, 2.6), ho.Quadrotor(0.140, 3.1), ho.Quadrotor(0.125, 2.9)]
    polygon = np.array(TRIANGLE) + [3.0, 1.0]
    team = ho.Team(3, 2.4, quadrotor=quadrotors)
    hitch = ho.Hitch.spread(team, polygon)
    arena = ho.Arena((-1.0, -4.0, 0.0), (6.0, 4.0, 3.0))
    plans = (
        ho.move_vertex(hitch, 0, by=[0.0, 0.4], arena=arena),
        ho.hold(hitch, 0.7, arena=arena),
        ho.adjust(hitch, hitch.q_legs + [0.05, -0.05, 0.02], arena=arena),
        ho.transport(hitch, [3.1, 1.0, 1.2], yaw=0.3, arena=arena),
    )
    return [plan.motion for plan in plans]


def one_after_the_other(parts: list[Motion], duration: float | None) -> Motion:
    """Joined whether or not each begins where the last one ends: continuity must tell."""
    whole = joined_motions(parts)
    return replace(
        whole,
        requirements=replace(
            whole.requirements, limits=replace(whole.requirements.limits, duration=duration)
        ),
    )


@pytest.mark.parametrize(("count", "duration"), [(1, None), (4, 100.0), (4, 0.5)])
def test_merging_equals_looking_anew(
    parts: list[Motion], duration: float | None, count: int
) -> None:
    parts = parts[:count]
    whole = one_after_the_other(parts, duration)
    anew, ours = certify(whole), merged(whole, [certify(part) for part in parts])
    assert ours.duration == anew.duration
    assert [c.name for c in ours.checks] == [c.name for c in anew.checks]
    for mine, other in zip(ours.checks, anew.checks, strict=True):
        assert (mine.limit, mine.sense, mine.unit, mine.method) == (
            other.limit,
            other.sense,
            other.unit,
            other.method,
        )
        assert mine.holds == other.holds
        assert mine.worst == pytest.approx(other.worst, rel=1e-4, abs=2e-7)
        assert 0.0 <= mine.time <= whole.duration


def test_a_jump_between_parts_is_found(parts: list[Motion]) -> None:
    moved = replace(
        parts[1],
        drones=type(parts[1].drones)(parts[1].drones.breaks, parts[1].drones.coefficients + 0.01),
    )
    broken = one_after_the_other([parts[1], moved], None)
    certificate = merged(broken, [certify(parts[1]), certify(moved)])
    assert not certificate["tension"].holds  # legs turn at once, and thrusts with them
    check = certificate["continuity"]
    assert not check.holds
    assert check.worst == pytest.approx(0.01 * np.sqrt(3.0), rel=1e-6)
    assert check.time == pytest.approx(parts[1].duration)


def test_one_part_that_breaks_a_limit_breaks_the_whole(parts: list[Motion]) -> None:
    fast = replace(
        parts[0],
        **{
            name: getattr(parts[0], name).stretched(0.7)
            for name in ("drones", "vertices", "legs", "tensions")
        },
    )
    whole = one_after_the_other([parts[1], fast], None)
    check = merged(whole, [certify(parts[1]), certify(fast)])["jerk"]
    assert not check.holds
    assert check.time > parts[1].duration
    assert check.worst == pytest.approx(certify(fast)["jerk"].worst)
