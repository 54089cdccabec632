"""Hitches at rest that break a limit: what is advised, and how far apart drones are."""

import numpy as np
import pytest

import hitchopt as ho
from hitchopt.errors import Violation
from hitchopt.hitch.requirements import Requirements
from hitchopt.steps.certified_motions import check_at_rest

TEAM = ho.Team(3, 2.4)
TRIANGLE = ho.regular_polygon(3, 1.3)


def hitch(team: ho.Team = TEAM, legs: float = 0.55) -> ho.Hitch:
    return ho.Hitch(team, TRIANGLE, 1.0, np.full(3, legs))


def refused(given: ho.Hitch, requirements: Requirements) -> dict[str, Violation]:
    """Return what a hitch breaks at rest, by the names of the checks."""
    with pytest.raises(ho.InfeasibleError) as error:
        check_at_rest(given, requirements, "at rest")
    return {violation.constraint: violation for violation in error.value.violations}


def test_longer_legs_are_advised_only_between_bodies_of_one_clasp() -> None:
    wide = Requirements(separation=ho.Separation(radius=0.4, cable=0.6))
    near = refused(hitch(), wide)
    for name in ("separation", "cable_clearance"):
        assert near[name].remedy.startswith("give the drones longer legs")
    # Legs along the edges of a pentagon end at the tips of a star: the two of one cable meet.
    polygon = ho.regular_polygon(5, 0.5)
    tips = 0.5 * (1.0 + 2.0 * 0.5 * (1.0 + 5.0**0.5))
    own_cable = {(f"q{k}", f"r{k}") for k in range(5)}
    star = refused(ho.Hitch.balanced(ho.Team(5, tips), polygon), Requirements())["separation"]
    assert star.where in own_cable
    assert "longer" not in star.remedy
    assert "(0 m apart, 0.24 m too close)" in star.when
    # Where one is above the other the ratio is no distance in metres.
    rolled = ho.Hitch.balanced(ho.Team(5, tips), polygon, roll=0.05)
    above = refused(rolled, Requirements())["separation"]
    assert above.where in own_cable
    assert "apart" not in above.when
