"""Contradictions of states, tensions at ends of ranges and ramps, each by a plan that has one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import hitchopt as ho
from hitchopt import verify as second
from hitchopt.motion.motion import Motion, Phase
from hitchopt.motion.plan_file import write_plan
from hitchopt.motion.retiming import cut, prolonged
from hitchopt.verify import consistency
from tests.helpers.plans import planned


def read(motion: Motion, folder: Path) -> second.Plan:
    """Return the verifier's plan of a motion."""
    write_plan(folder / "plan.npz", ho.Flight.of(motion))
    (plan,), _ = second.read(folder / "plan.npz")
    return plan


def with_phases(motion: Motion, change: Callable[[Phase], Phase]) -> Motion:
    return motion.replaced(phases=tuple(map(change, motion.phases)))


def test_tensions_rise_only_at_rest(tmp_path: Path) -> None:
    """A ramp is a rest of drones and vertices, up to the tension at which the hitch is held."""
    motion = planned("form_square").motion
    ramp = read(motion, tmp_path).ramp
    rising = np.flatnonzero(np.all(ramp, axis=1) & motion.formed)
    assert len(rising)
    for name, item in (("drones", 3), ("vertices", 1)):
        curve = getattr(motion, name)
        moved = curve.coefficients.copy()
        moved[rising[-1], item, 0, 2:-2] += 1e-6
        moving = read(motion.replaced(**{name: curve.replaced(moved)}), tmp_path).ramp
        assert not np.any(moving[rising])


@pytest.mark.parametrize("end", [0, -1])
def test_ranges_begin_and_end_with_the_tensions_of_the_team(end: int, tmp_path: Path) -> None:
    """Unless an object is held on both sides of an end."""
    motion = planned("move_vertex").motion
    off = np.linspace(0.0, 0.02, motion.drones.pieces + 1)[:: 1 if end else -1]
    tensions = motion.tensions.elevated(1).coefficients.copy()
    tensions += np.stack([off[:-1], off[1:]], axis=-1)[:, None]
    lifted = motion.replaced(tensions=motion.tensions.replaced(tensions))
    low, high = float(np.min(tensions)) - 0.01, float(np.max(tensions)) + 0.01
    ranged = with_phases(lifted, lambda phase: replace(phase, tension=(low, high)))
    errors = [*consistency.range_errors(read(ranged, tmp_path))]
    worst, time, _ = max(errors)
    assert worst == pytest.approx(0.02)
    assert time == pytest.approx(motion.drones.breaks[end])
    (row,) = (x for x in consistency.jumps(read(ranged, tmp_path)) if x.name == "tension")
    assert row.verdict == "violated"


@pytest.mark.parametrize(("share", "is_wrong"), [(0.0, False), (0.7, False), (1.2, True)])
def test_tightened_cables_have_their_full_length_for_half_of_their_time(
    share: float, is_wrong: bool, tmp_path: Path
) -> None:
    """They come to rest at it; a rest as long as the motion before it is that of a hitch."""
    motion = planned("form_triangle").motion
    tight = [phase.state.tightening for phase in motion.phases].index(True)
    pieces = np.flatnonzero(motion.phase_of_piece == tight)
    seconds = motion.phases[tight].end - motion.phases[tight].start
    rested = prolonged(cut(motion, 0, int(pieces[-1]) + 1), share * seconds)
    plan = read(rested, tmp_path)
    faults = consistency.tightened_faults(plan, plan.phase == tight)
    assert [wrong for wrong, _ in faults] == [is_wrong]
    (row, *_) = consistency.consistency(plan)
    assert ("full length" in row.where) is is_wrong
