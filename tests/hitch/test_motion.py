"""Parts of motions, and states: attitudes and body rates against scipy and finite differences."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hitchopt.errors import InputError
from hitchopt.hitch import Hitch, Swarm, Team
from hitchopt.hitch.requirements import Requirements
from hitchopt.motion.cable_state import CableState
from hitchopt.motion.motion import Motion, Phase
from hitchopt.motion.retiming import cut
from hitchopt.motion.states import states_at
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array
from tests.helpers.plans import planned

BREAKS = np.array([0.0, 0.5, 1.25, 2.0, 3.5])
POINTS = np.array([[0.3, 0.1], [0.6, 1.4], [1.7, 0.6]])


def resting_motion(formed: tuple[bool, ...]) -> Motion:
    """Return a hitch at rest whose phases are the pieces."""
    team = Team(3, [2.4, 2.5, 2.6])
    hitch = Hitch.balanced(team, POINTS, 1.2)
    places = hitch.drones, hitch.vertices, hitch.legs, team.tension
    phases = tuple(
        Phase(f"part {i}", 0, a, b, state=CableState.HITCHED if f else CableState.FREE)
        for i, ((a, b), f) in enumerate(zip(pairwise(BREAKS), formed, strict=True))
    )
    drones, vertices, legs, tensions = (PiecewisePolynomial.constant(BREAKS, x) for x in places)
    return Motion(team, Requirements(), drones, vertices, legs, tensions, phases)


@pytest.mark.parametrize(
    ("formed", "runs"),
    [
        ((True,) * 4, [(0, 4)]),
        ((False,) * 4, []),
        ((False, True, True, False), [(1, 3)]),
        ((True, False, True, True), [(0, 1), (2, 4)]),
    ],
)
def test_spans_are_the_longest_runs(formed: tuple[bool, ...], runs: list[tuple[int, int]]) -> None:
    motion = resting_motion(formed)
    np.testing.assert_array_equal(motion.formed, formed)
    spans = motion.spans(lambda state: state.hitched)
    for span, (a, b) in zip(spans, runs, strict=True):
        assert (span.drones.breaks[0], span.drones.breaks[-1]) == (BREAKS[a], BREAKS[b])
        assert span.phases == motion.phases[a:b]
        assert np.all(span.formed)
        np.testing.assert_array_equal(span.legs.coefficients, motion.legs.coefficients[a:b])
    others = motion.spans(lambda state: state.slack)
    assert sum(s.duration for s in (*spans, *others)) == pytest.approx(motion.duration)


def test_slowed_and_cut_motions_keep_their_phases() -> None:
    motion = resting_motion((True, False, True, True))
    slow = motion.slowed(1.5)
    for name in ("drones", "vertices", "legs", "tensions"):
        np.testing.assert_allclose(getattr(slow, name).breaks, 1.5 * BREAKS)
    for phase, original in zip(slow.phases, motion.phases, strict=True):
        assert phase == replace(original, start=1.5 * original.start, end=1.5 * original.end)
    part = cut(motion, 1, 3)
    np.testing.assert_allclose(part.drones.breaks, [0.0, 0.75, 1.5])
    actual = [(phase.name, phase.start, phase.end) for phase in part.phases]
    assert actual == [("part 1", 0.0, 0.75), ("part 2", 0.75, 1.5)]


@pytest.mark.parametrize(
    "spans",
    [
        ((0.0, 3.5), (3.5, 0.0), (0.0, 3.5)),  # backward in time
        ((0.0, 1.25), (2.0, 3.5)),  # a gap
        ((0.0, 2.0), (1.25, 3.5)),  # overlapping
        ((0.0, 1.25), (1.25, 1.25), (1.25, 3.5)),  # empty
        ((0.5, 3.5),),  # starts late
        ((0.0, 2.0),),  # too short
        ((0.0, float("nan")), (float("nan"), 3.5)),
    ],
)
def test_phases_cover_the_motion_in_order(spans: tuple[tuple[float, float], ...]) -> None:
    phases = tuple(Phase("part", 0, start, end) for start, end in spans)
    with pytest.raises(InputError, match=r"phases = \[\["):
        replace(resting_motion((True,) * 4), phases=phases)
    drones = PiecewisePolynomial.constant(BREAKS, np.zeros((3, 3)))
    with pytest.raises(InputError, match=r"phases = \[\["):
        Motion.single(Swarm(3), Requirements(), drones, phases)


def test_cables_change_their_state_at_breaks() -> None:
    motion = resting_motion((False, False, True, True))
    first, second, *others = motion.phases
    moved = (replace(first, end=0.75), replace(second, start=0.75), *others)
    assert replace(motion, phases=moved).phases == moved  # both hang free
    clasping = (replace(moved[0], state=CableState.CLASPING), *moved[1:])
    with pytest.raises(InputError, match="breaks where states change"):
        replace(motion, phases=clasping)
    shifted = (first, second, replace(others[0], start=1.3), others[1])
    with pytest.raises(InputError, match="phases"):
        replace(motion, phases=shifted)
    with pytest.raises(InputError, match=r"phases\.state"):
        replace(motion, phases=(*motion.phases[:3], replace(others[1], state=CableState.NONE)))


def rotation_of(quaternions: Array) -> Rotation:
    return Rotation.from_quat(quaternions.reshape(-1, 4), scalar_first=True)


@pytest.mark.parametrize("stem", ["weight_hexagon", "form_hanging_to_the_floor"])
def test_states_rotate_at_their_body_rates(stem: str) -> None:
    """Check a morph, and cables with weight that hang, are tightened and hitched."""
    motion = planned(stem).motion
    breaks, h = motion.drones.breaks, 1e-6
    share = np.random.default_rng(6).uniform(0.1, 0.9, motion.drones.pieces)
    t = breaks[:-1] - breaks[0] + share * np.diff(breaks)
    now, before, after = (states_at(motion, t + step) for step in (0.0, -h, h))
    slope = (after.cable_forces - before.cable_forces) / (2.0 * h)
    np.testing.assert_allclose(now.cable_force_rates, slope, atol=2e-6)
    slope = (after.thrusts(motion.team) - before.thrusts(motion.team)) / (2.0 * h)
    np.testing.assert_allclose(now.thrust_rates(motion.team), slope, atol=2e-6)
    along = [rotation_of(state.quaternions) for state in (before, after)]
    turned = (along[0].inv() * along[1]).as_rotvec() / (2.0 * h)
    np.testing.assert_allclose(turned, now.body_rates.reshape(-1, 3), atol=2e-5)
    assert np.max(np.abs(now.body_rates)) > 0.1
    thrusts = now.thrusts(motion.team).reshape(-1, 3)
    third = rotation_of(now.quaternions).apply(np.linalg.norm(thrusts, axis=1)[:, None] * [0, 0, 1])
    np.testing.assert_allclose(third, thrusts, atol=1e-12)


def test_parts_have_the_states_of_the_whole_and_ended_motions_rest() -> None:
    """Times count from the start of the part."""
    motion = planned("weight_hexagon").motion
    start = float(motion.drones.breaks[2])
    part = motion.slice_pieces(slice(2, None), motion.overlapping(start, motion.duration))
    t = part.duration * np.linspace(0.013, 0.987, 7)
    here, there = states_at(part, t), states_at(motion, start + t)
    for name in ("positions", "velocities", "vertices", "cable_forces"):
        np.testing.assert_allclose(getattr(here, name), getattr(there, name), atol=1e-9)
    over = states_at(motion, motion.duration + 1.0)
    assert not np.any(over.body_rates)
    assert not np.any(over.thrust_rates(motion.team))
