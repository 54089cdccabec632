"""The law of motion of what is carried: limits, ends and smoothness."""

from __future__ import annotations

import numpy as np
import pytest

from hitchopt.planners.carrying.moves import SmoothLaw


@pytest.mark.parametrize("limits", [(0.5, 1.0, 20.0), (5.0, 1.0, 20.0), (0.1, 3.0, 0.5)])
def test_the_law_keeps_its_limits_and_uses_them(limits: tuple[float, float, float]) -> None:
    law = SmoothLaw.fastest(*limits)
    t = np.linspace(0.0, law.duration, 20_001)
    share, speed, change = law.jet(t).T
    assert share[0] == 0.0
    assert share[-1] == pytest.approx(1.0)
    assert np.all(np.diff(share) >= -1e-13)
    np.testing.assert_allclose(np.gradient(share, t)[1:-1], speed[1:-1], atol=1e-6)
    np.testing.assert_allclose(np.gradient(speed, t)[1:-1], change[1:-1], atol=1e-4)
    jerk = np.gradient(change, t)
    used = np.array([np.max(np.abs(each)) for each in (speed, change, jerk)]) / limits
    assert np.max(used) == pytest.approx(1.0, rel=2e-3)
    assert np.all(jerk[[0, -1]] < 1e-3 * np.max(jerk))


def test_a_slower_law_takes_longer() -> None:
    law = SmoothLaw.fastest(0.5, 1.0, 20.0)
    assert law.slowed(2.0).duration == pytest.approx(2.0 * law.duration)
    breaks = law.breaks(0.3)
    assert np.all(np.diff(breaks) > 0.0)
    assert breaks[0] == 0.0
    assert breaks[-1] == law.duration
