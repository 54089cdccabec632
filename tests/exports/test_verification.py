from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from exported_plans import certificate_of, flown_checks, hitch_plan, swarm_plan
from hypothesis import given, settings
from hypothesis import strategies as st

from hitchopt.errors import FileError
from hitchopt.exports.recording import Recording, recording_of_curves
from hitchopt.exports.reference_frame import ReferenceFrame
from hitchopt.exports.verification import FLOWN, Verdict, verify
from hitchopt.motion.motion import CableState, Motion
from hitchopt.trajectory import PiecewisePolynomial

PLAIN = ReferenceFrame()


def recorded(
    curves: PiecewisePolynomial,
    names: tuple[str, ...],
    smooth: int = 2,
    frame: ReferenceFrame = PLAIN,
) -> Recording:
    placed = frame.placed(curves)
    each = [
        PiecewisePolynomial(placed.breaks, placed.coefficients[:, i]) for i in range(len(names))
    ]
    return recording_of_curves(names, each, frame.name, smooth)


def verified(motion: Motion, curves: PiecewisePolynomial, smooth: int = 2) -> Verdict:
    names = motion.team.drone_names
    return verify(motion, recorded(curves, names, smooth), PLAIN, names)


@pytest.mark.parametrize("motion", [hitch_plan(), swarm_plan()], ids=["hitch", "swarm"])
def test_the_plan_itself_is_verified_as_its_certificate_says(motion: Motion) -> None:
    verdict = verified(motion, motion.drones)
    assert verdict.lost == ()
    assert verdict.position.worst < 1e-9
    assert verdict.velocity.worst < 1e-6
    certificate = certificate_of(motion)
    assert {check.name for check in verdict.checks} <= {rule.name for rule in FLOWN}
    for check in verdict.checks:
        planned = certificate[check.name]
        assert check.worst == pytest.approx(planned.worst, rel=3e-4, abs=1e-6)
        assert check.limit == {"cable_length": 1e-3, "arena": -1e-4}.get(check.name, planned.limit)
        assert flown_checks(motion)[check.name].worst == pytest.approx(planned.worst, rel=3e-4)


@pytest.mark.slow
@settings(max_examples=15)
@given(st.integers(0, 1000))
def test_samples_never_beat_the_bounds(seed: int) -> None:
    motion = hitch_plan()
    rng = np.random.default_rng(seed)
    curves = motion.drones
    coefficients = curves.coefficients + 1e-3 * rng.normal(size=curves.coefficients.shape)
    coefficients[1:, ..., 0] = coefficients[:-1, ..., -1]
    wild = PiecewisePolynomial(curves.breaks, coefficients)
    verdict = verified(motion, wild)
    t = rng.uniform(0.0, curves.duration, 500)
    apart = np.linalg.norm(wild.at(t) - curves.at(t), axis=-1)
    assert np.max(apart) <= verdict.position.worst
    speeds = np.linalg.norm(wild.at(t, 1) - curves.at(t, 1), axis=-1)
    assert np.max(speeds) <= verdict.velocity.worst
    checks = {check.name: check for check in verdict.checks}
    assert np.max(np.linalg.norm(wild.at(t, 1), axis=-1)) <= checks["speed"].worst
    places = wild.at(t) * motion.requirements.separation.scale
    pairs = np.linalg.norm(places[:, :, None] - places[:, None], axis=-1)
    pairs[:, np.arange(6), np.arange(6)] = np.inf
    assert np.min(pairs) >= checks["separation"].worst


def test_what_is_lost_is_reported() -> None:
    motion = hitch_plan()
    coefficients = np.array(motion.drones.coefficients)
    coefficients[:, 0] = coefficients[:, 3] + np.array([0.05, 0.0, 0.0])[:, None]
    verdict = verified(motion, PiecewisePolynomial(motion.drones.breaks, coefficients))
    assert {"separation", "cable_length"} <= {check.name for check in verdict.lost}


@pytest.mark.slow
def test_windows_of_any_size_say_the_same() -> None:
    motion = hitch_plan()
    names = motion.team.drone_names
    whole = recorded(motion.drones, names)

    def windows() -> object:
        for i in range(motion.drones.pieces):
            yield motion.drones.taken(slice(i, i + 1))

    pieces = replace(whole, windows=windows)  # type: ignore[arg-type]
    one, many = (verify(motion, recording, PLAIN, names) for recording in (whole, pieces))
    for a, b in zip(one.checks, many.checks, strict=True):
        assert a.worst == pytest.approx(b.worst, rel=3e-4, abs=1e-6)
        assert a.name == b.name


def test_it_rests_after_its_end_but_must_not_end_early() -> None:
    motion = hitch_plan()
    longer = PiecewisePolynomial(
        np.append(motion.drones.breaks, motion.duration + 0.3),
        np.concatenate(
            [
                motion.drones.coefficients,
                np.repeat(motion.drones.coefficients[-1:, ..., -1:], 8, axis=-1),
            ]
        ),
    )
    verdict = verified(motion, longer)
    assert verdict.duration == pytest.approx(motion.duration + 0.3)
    assert verdict.lost == ()
    with pytest.raises(FileError, match="before the plan does"):
        verified(motion, motion.drones.taken(slice(0, -1)))


def test_other_drones_are_refused() -> None:
    motion = swarm_plan()
    recording = recorded(motion.drones, ("a", "b", "c"))
    with pytest.raises(FileError, match="d0 is missing"):
        verify(motion, recording, PLAIN, motion.team.drone_names)
    with pytest.raises(FileError, match="more of them"):
        verify(motion, recording, PLAIN, ("a", "b"))


def test_cables_are_verified_while_the_hitch_exists() -> None:
    """A drone far off its leg during a span without a hitch: only the drones' own checks see it."""
    motion = hitch_plan()
    first, pause, last = motion.phases
    free = replace(motion, phases=(first, replace(pause, state=CableState.FREE), last))
    coefficients = np.array(motion.drones.coefficients)
    middles = 0.5 * (motion.drones.breaks[1:] + motion.drones.breaks[:-1])
    within = (middles > pause.start) & (middles < pause.end)
    coefficients[within, 0, 2] += 0.3
    curves = PiecewisePolynomial(motion.drones.breaks, coefficients)
    assert "cable_length" in {check.name for check in verified(motion, curves).lost}
    verdict = verified(free, curves)
    assert "cable_length" not in {check.name for check in verdict.lost}
    assert verdict.position.worst == pytest.approx(0.3, rel=1e-3)
