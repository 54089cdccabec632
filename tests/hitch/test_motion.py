"""Motions in parts: where a hitch exists, and swarms that have none."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from hitchopt.checks import certify
from hitchopt.checks.certificate import Check, most_pressing
from hitchopt.errors import InputError
from hitchopt.hitch import Hitch, Quadrotor, Swarm, Team
from hitchopt.hitch.requirements import Arena, Requirements
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


def test_what_is_broken_where_no_hitch_is_breaks_nothing() -> None:
    """Besides forming and releasing the hitch at once, without any swap."""
    motion = resting((False, True, True, False))
    for piece, off, kept in ((0, 0.0, True), (0, 0.3, True), (1, 0.3, False), (3, 0.3, True)):
        legs = np.array(motion.legs.coefficients)
        legs[piece] += off
        shifted = replace(motion, legs=PiecewisePolynomial(BREAKS, legs))
        names = {check.name for check in certify(shifted).violated}
        assert (names == {"interlacing", "tension"}) is kept


def test_the_worst_of_several_spans_is_told() -> None:
    motion = resting((True, False, True, True))
    vertices = np.array(motion.vertices.coefficients)
    vertices[0, 1] *= 1.001
    worse = certify(replace(motion, vertices=PiecewisePolynomial(BREAKS, vertices)))
    assert not worse["cable_length"].holds
    assert worse["cable_length"].time <= BREAKS[1]
    assert worse["convexity"].bound > 0.0


def test_the_most_pressing_check_depends_on_its_sense() -> None:
    for sense in ("min", "max"):
        low, high = (Check.of("x", worst, 1.0, sense, "m", 0.0, ()) for worst in (0.5, 2.0))
        assert most_pressing([high, low]) is (low if sense == "min" else high)
    assert most_pressing([]) is None


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
def test_phases_follow_one_another_and_cover_the_motion(
    spans: tuple[tuple[float, float], ...],
) -> None:
    phases = tuple(Phase("part", 0, start, end) for start, end in spans)
    with pytest.raises(InputError, match=r"phases = \[\["):
        replace(resting((True,) * 4), phases=phases)
    motion = swarm_motion()
    drones = motion.drones.stretched(1.75)  # as long as the hitch rests
    with pytest.raises(InputError, match=r"phases = \[\["):
        Motion.single(motion.team, motion.requirements, drones, phases)


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
    assert {phase.state for phase in swarm_motion().phases} == {CableState.NONE}


def swarm_motion(apart: float = 1.0, kinds: Quadrotor | None = None) -> Motion:
    """Return three drones in a row, ``apart`` metres, that move by 0.5 m in y in 2 s."""
    x = np.zeros((3, 3, 2))
    x[:, 0] = apart * np.arange(3.0)[:, None]
    x[:, 1, 1] = 0.5
    x[:, 2] = 1.0
    drones = PiecewisePolynomial.hermite(
        [0.0, 2.0], *(np.stack([x[None, ..., end], *np.zeros((3, 1, 3, 3))]) for end in (0, 1))
    )
    requirements = Requirements(arena=Arena([-1.0, -1.0, 0.0], [3.0, 2.0, 1.5]))
    phases = (Phase("separate", 0, 0.0, 2.0),)
    return Motion.single(Swarm(3, quadrotor=kinds), requirements, drones, phases)


def test_a_swarm_is_certified_by_the_checks_of_drones() -> None:
    motion = swarm_motion()
    certificate = certify(motion)
    assert certificate.certified
    names = "separation speed acceleration jerk thrust tilt arena continuity"
    expected = [*names.split(), "tracking_radius", "stoppable"]
    assert [check.name for check in certificate.checks] == expected
    assert certificate["separation"].worst == pytest.approx(1.0 / 0.24)
    assert certificate["arena"].worst == pytest.approx(0.5)
    # The septic from rest to rest is fastest half way, at 35/16 of its mean speed.
    assert certificate["speed"].worst == pytest.approx(0.25 * 35 / 16)
    t = np.linspace(0.0, 2.0, 20001)
    upward = motion.drones.at(t, 2) + np.array([0.0, 0.0, 9.81])
    thrust = 0.132 * np.max(np.linalg.norm(upward, axis=-1))
    assert certificate["thrust"].worst == pytest.approx(thrust, rel=2e-4)
    tilt = np.degrees(np.max(np.arctan2(np.abs(upward[..., 1]), upward[..., 2])))
    assert certificate["tilt"].worst == pytest.approx(tilt, rel=2e-4)
    one = PiecewisePolynomial(motion.drones.breaks, motion.drones.coefficients[:, :1])
    single = certify(replace(motion, team=Swarm(1), drones=one))
    assert single.certified
    assert [check.name for check in single.checks] == expected[1:]  # no separation


@pytest.mark.parametrize(
    ("apart", "weak", "broken"), [(0.2, 2.6, "separation"), (1, 1.2, "thrust")]
)
def test_a_swarm_that_breaks_a_limit_is_told(apart: float, weak: float, broken: str) -> None:
    certificate = certify(swarm_motion(apart, Quadrotor(max_thrust=weak)))
    assert [check.name for check in certificate.violated] == [broken]
    assert set(certificate[broken].where) <= {"d0", "d1", "d2"}
