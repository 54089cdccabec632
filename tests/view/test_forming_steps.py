"""The picture of a hitch being tied."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

import hitchopt as ho
from problems.forming_steps import save_forming_steps

HITCH = ho.Hitch.spread(ho.Team(3, 2.4), [[0, 0.6], [0.5, -0.3], [-0.5, -0.3]], 1.5)


@pytest.mark.slow
def test_four_panels_with_cables_and_drones_in_them(tmp_path: Path) -> None:
    high = np.array([[-0.6, -1.2, 2.2], [-0.6, 0, 2.2], [-0.6, 1.2, 2.2]])
    polygon = HITCH.polygon
    plan = ho.form(ho.Team(3, 2.4), high, high * [-1, 1, 1], polygon, 1.5)
    path = tmp_path / "steps.png"
    nameless = tuple(replace(phase, name="hold") for phase in plan.phases)
    save_forming_steps(path, replace(plan.motion, phases=nameless))
    picture = imread(path)[..., :3]
    for panel in np.array_split(picture, 4, axis=1):
        colours = np.unique((panel[60:-60] * 8).astype(int).reshape(-1, 3), axis=0)
        assert len(colours) > 20  # three cables, drones and paths, not an empty frame
    assert picture.shape[1] > 3 * picture.shape[0]


def test_a_plan_that_forms_nothing_is_refused(tmp_path: Path) -> None:
    plan = ho.hold(HITCH, 1.0)
    with pytest.raises(ho.InputError, match=r"motion = 'no swap': must be a plan that forms"):
        save_forming_steps(tmp_path / "steps.png", plan.motion)
    assert not (tmp_path / "steps.png").exists()
