"""A certificate from those of the parts, against one that looks at the whole anew."""

from __future__ import annotations

import numpy as np
import pytest
from motions import altered, plus, replaced

import hitchopt as ho
from hitchopt.checks import Certificate, certify, merged
from hitchopt.motion.motion import Motion, joined_motions

TRIANGLE = np.array([[3.0, 0.0], [2.6, 1.5], [3.4, 1.5]])


@pytest.fixture(scope="module")
def parts() -> list[Motion]:
    """Four steps of a triangle with drones of unequal thrust, off the origin."""
    kinds = [ho.Quadrotor(0.132, 2.6), ho.Quadrotor(0.140, 3.1), ho.Quadrotor(0.125, 2.9)]
    hitch = ho.Hitch.spread(ho.Team(3, 2.4, quadrotor=kinds), TRIANGLE)
    arena = ho.Arena((-1.0, -4.0, 0.0), (6.0, 4.0, 3.0))
    plans = (
        ho.move_vertex(hitch, 0, by=[0.0, 0.4], arena=arena),
        ho.hold(hitch, 0.7, arena=arena),
        ho.adjust(hitch, hitch.q_legs + [0.05, -0.05, 0.02], arena=arena),
        ho.transport(hitch, [3.1, 1.0, 1.2], yaw=0.3, arena=arena),
    )
    return [plan.motion for plan in plans]


def of_parts(parts: list[Motion]) -> Certificate:
    """Joined whether or not each begins where the last one ends: continuity must tell."""
    return merged(joined_motions(parts), [certify(part) for part in parts])


@pytest.mark.parametrize(
    ("count", "duration", "slower"),
    [(1, None, 1.0), (4, 100.0, 1.0), (4, 0.5, 1.0), (3, None, 0.7)],
)
def test_merging_equals_looking_anew(
    parts: list[Motion], duration: float | None, count: int, slower: float
) -> None:
    """Of parts that break limits as well."""
    parts = [part.slowed(slower) for part in parts[:count]]
    whole = replaced(joined_motions(parts), duration=duration)  # type: ignore[arg-type]
    anew, ours = certify(whole), merged(whole, [certify(part) for part in parts])
    assert ours.duration == anew.duration
    assert [c.name for c in ours.checks] == [c.name for c in anew.checks]
    for mine, other in zip(ours.checks, anew.checks, strict=True):
        for field in ("limit", "sense", "unit", "method", "holds"):
            assert getattr(mine, field) == getattr(other, field)
        assert mine.worst == pytest.approx(other.worst, rel=1e-4, abs=2e-7)
        assert 0.0 <= mine.time <= whole.duration
    assert ours["jerk"].holds is (slower == 1.0)
    for name in ("speed", "vertex_speed", "jerk"):
        assert ours[name].time == pytest.approx(anew[name].time, abs=0.05)


def test_a_jump_between_parts_is_found(parts: list[Motion]) -> None:
    certificate = of_parts([parts[1], altered(parts[1], "drones", plus(..., 0.01))])
    assert not certificate["tension"].holds  # legs turn at once, and thrusts with them
    check = certificate["continuity"]
    assert not check.holds
    assert check.worst == pytest.approx(0.01 * np.sqrt(3.0), rel=1e-6)
    assert check.time == pytest.approx(parts[1].duration)
