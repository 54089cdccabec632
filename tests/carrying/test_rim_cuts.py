"""Legs below a rim bend at its edge: as chords they cut it by little, or are refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import hitchopt as ho
from hitchopt import verify
from hitchopt.motion.loads import RIM_CUT, held_pieces
from hitchopt.motion.motion import HoldBy, Motion
from hitchopt.motion.plan_file import write_plan
from hitchopt.objects import Rim, Section
from hitchopt.verify.objects import clear_held
from tests.helpers.carried_plans import check, plan, with_body
from tests.helpers.plans import planned

STEPS = np.linspace(0.0, 1.0, 401)[:, None]
RESOLUTION = 3e-4
"""[m] By which samples of legs and times may miss the deepest cut."""


def motion_of(name: str) -> Motion:
    return plan("tray").motion if name == "tray" else planned(name).motion


def widened(motion: Motion, name: str, by: float) -> Motion:
    """The flight with a rim that is wider all around [m]."""
    rim = motion.requirements.objects[name].rim
    assert rim is not None
    core = rim.section.core
    if rim.section.outline is None:
        section = Section(radius=rim.section.rounding + by)
    else:
        half = np.max(np.abs(core), axis=0)
        section = Section(core * (half + by) / half)
    return with_body(motion, name, rim=Rim(section, rim.height))


def deepest_cut(motion: Motion, name: str) -> float:
    """The largest height [m] of points of legs above a rim that rests on them, inside of it."""
    index = [*motion.requirements.objects].index(name)
    rim, height = motion.requirements.objects[name].rim, -np.inf
    assert rim is not None
    pieces = np.flatnonzero(held_pieces(motion, name, HoldBy.REST))
    breaks = motion.drones.breaks
    for t in np.linspace(breaks[pieces] + 1e-9, breaks[pieces + 1] - 1e-9, 9).ravel().tolist():
        x, y, z, cosine, sine = motion.poses.at(t)[index]
        to_object = np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])
        clasps, drones = (
            (points - [x, y, z]) @ to_object.T
            for points in (motion.vertices.at(t), motion.drones.at(t))
        )
        for k, clasp in enumerate(clasps):
            for drone in (drones[2 * k], drones[2 * k - 1]):
                leg = clasp + STEPS * (drone - clasp)
                inside = leg[rim.section.clearance(leg[:, :2])[0] <= 0.0, 2]
                height = max(height, float(np.max(inside, initial=-np.inf)) - rim.height)
    return height


def both_believe(motion: Motion, name: str, folder: Path) -> tuple[bool, bool]:
    """Whether certificate and verify find legs clear of the rim that they hold."""
    file = folder / "plan.npz"
    write_plan(file, ho.Flight.of(motion))
    ((found,), _) = verify.read(file)
    index = [body.name for body in found.bodies].index(name)
    rows = [row for row in clear_held(found, index) if row.samples]
    proven = all(row.verdict == "proven" for row in rows)
    return check(motion, "object_clearance").holds, proven


CASES = [
    ("tray", "tray"),
    pytest.param("carry_box", "box", marks=pytest.mark.slow),
    pytest.param("carry_tray", "tray", marks=pytest.mark.slow),
]


@pytest.mark.parametrize(("problem", "name"), CASES)
def test_chords_of_legs_cut_rims_by_millimetres(problem: str, name: str, tmp_path: Path) -> None:
    motion = motion_of(problem)
    assert 5e-4 < deepest_cut(motion, name) < 0.8 * RIM_CUT
    assert both_believe(motion, name, tmp_path) == (True, True)


@pytest.mark.parametrize("by", [0.002, 0.007, 0.014, 0.03])
@pytest.mark.parametrize(("problem", "name"), CASES)
def test_rims_that_legs_cut_deeper_are_refused(
    problem: str, name: str, by: float, tmp_path: Path
) -> None:
    """Chords leave a wider rim higher, wherever the tampered file says that it ends."""
    motion = widened(motion_of(problem), name, by)
    cut = deepest_cut(motion, name)
    assert abs(cut - RIM_CUT) > RESOLUTION
    believed = cut < RIM_CUT
    assert both_believe(motion, name, tmp_path) == (believed, believed)
