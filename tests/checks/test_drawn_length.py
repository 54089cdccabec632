"""Clasped cables that are drawn out farther than they reach, though no chord is longer than one."""

import numpy as np
import pytest
from test_interlacing import FEW, stage_of, stages_of

from hitchopt.checks import certify
from hitchopt.hitch.requirements import Limits
from hitchopt.motion.motion import CableState, joined_motions
from hitchopt.planners.forming.turns import straight


@pytest.mark.slow
@pytest.mark.parametrize("n", FEW)
def test_tightening_beyond_the_hitch_tears_cables(n: int) -> None:
    hitch, stages = stages_of(n)
    right = certify(joined_motions(stages))["cable_length"]
    assert right.holds
    drones = hitch.drones
    farther = np.mean(drones, axis=0) + 1.1 * (drones - np.mean(drones, axis=0))
    out = [
        stage_of(
            hitch, "tighten", straight(hitch.team, Limits(), first, last), CableState.TIGHTENING
        )
        for first, last in ((drones, farther), (farther, drones))
    ]
    torn = certify(joined_motions([*stages[:3], *out, stages[3]]))
    assert torn["span"].holds
    assert not torn["cable_length"].holds
    # Farthest out, around the hitch's vertices: two longer legs and the edge between them.
    layout, reach = hitch.team.layout, np.linalg.norm
    legs = reach(farther - hitch.vertices[layout.anchors], axis=1).reshape(-1, 2)
    edges = reach(hitch.vertices[layout.ends] - hitch.vertices[layout.starts], axis=1)
    needed = np.max((np.sum(legs, axis=1) + edges) / hitch.team.cable_length)
    assert needed > 1.02
    assert torn["cable_length"].worst == pytest.approx(needed - 1.0, rel=2e-4)
