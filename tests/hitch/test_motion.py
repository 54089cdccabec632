"""Motions in parts: where a hitch exists, and swarms that have none."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from hitchopt.errors import InputError
from hitchopt.hitch import Hitch, Swarm, Team
from hitchopt.hitch.requirements import Requirements
from hitchopt.motion.motion import FREE_STATES, HITCHED_STATE, CableState, Motion, Phase
from hitchopt.motion.retiming import cut
from hitchopt.trajectory import PiecewisePolynomial

BREAKS = np.array([0.0, 0.5, 1.25, 2.0, 3.5])
POINTS = np.array([[0.3, 0.1], [0.6, 1.4], [1.7, 0.6]])


def resting(formed: tuple[bool, ...]) -> Motion:
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
    motion = resting(formed)
    np.testing.assert_array_equal(motion.formed, formed)
    spans = motion.spans(HITCHED_STATE)
    assert [(s.drones.breaks[0], s.drones.breaks[-1]) for s in spans] == [
        (BREAKS[a], BREAKS[b]) for a, b in runs
    ]
    for span, (a, b) in zip(spans, runs, strict=True):
        assert span.phases == motion.phases[a:b]
        assert np.all(span.formed)
        np.testing.assert_array_equal(span.legs.coefficients, motion.legs.coefficients[a:b])
    others = motion.spans(FREE_STATES)
    assert sum(s.duration for s in (*spans, *others)) == pytest.approx(motion.duration)


def test_slowed_and_cut_motions_keep_their_phases() -> None:
    motion = resting((True, False, True, True))
    slow = motion.slowed(1.5)
    for name in ("drones", "vertices", "legs", "tensions"):
        np.testing.assert_allclose(getattr(slow, name).breaks, 1.5 * BREAKS)
    for phase, before in zip(slow.phases, motion.phases, strict=True):
        assert phase == replace(before, start=1.5 * before.start, end=1.5 * before.end)
    part = cut(motion, 1, 3)
    np.testing.assert_allclose(part.drones.breaks, [0.0, 0.75, 1.5])
    told = [(phase.name, phase.start, phase.end) for phase in part.phases]
    assert told == [("part 1", 0.0, 0.75), ("part 2", 0.75, 1.5)]


@pytest.mark.parametrize(
    "spans",
    [
        ((0.0, 3.5), (3.5, 0.0), (0.0, 3.5)),  # there, back and there again
        ((0.0, 1.25), (2.0, 3.5)),  # a gap
        ((0.0, 2.0), (1.25, 3.5)),  # twice
        ((0.0, 1.25), (1.25, 1.25), (1.25, 3.5)),  # no time at all
        ((0.5, 3.5),),  # late
        ((0.0, 2.0),),  # over before the motion is
        ((0.0, float("nan")), (float("nan"), 3.5)),
    ],
)
def test_phases_cover_the_motion_in_order(
    spans: tuple[tuple[float, float], ...],
) -> None:
    phases = tuple(Phase("part", 0, start, end) for start, end in spans)
    with pytest.raises(InputError, match=r"phases = \[\["):
        replace(resting((True,) * 4), phases=phases)
    drones = PiecewisePolynomial.constant(BREAKS, np.zeros((3, 3)))
    with pytest.raises(InputError, match=r"phases = \[\["):
        Motion.single(Swarm(3), Requirements(), drones, phases)


def test_cables_change_their_state_at_a_break_and_have_one() -> None:
    motion = resting((False, False, True, True))
    first, second, *others = motion.phases
    moved = (replace(first, end=0.75), replace(second, start=0.75), *others)
    assert replace(motion, phases=moved).phases == moved  # both hang free
    clasping = (replace(moved[0], state=CableState.CLASPING), *moved[1:])
    with pytest.raises(InputError, match="breaks where states change"):
        replace(motion, phases=clasping)
    late = (first, second, replace(others[0], start=1.3), others[1])
    with pytest.raises(InputError, match="phases"):
        replace(motion, phases=late)
    with pytest.raises(InputError, match=r"phases\.state"):
        replace(motion, phases=(*motion.phases[:3], replace(others[1], state=CableState.NONE)))
