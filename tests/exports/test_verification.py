"""Verification of exported motions; frames; sample times and states."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import hitchopt as ho
from hitchopt.checks import certifying
from hitchopt.checks.certificate import CertificateError
from hitchopt.checks.certifying import certificate_of
from hitchopt.errors import FileError, InputError
from hitchopt.exports.contents import WINDOW, FileContents, Trajectory
from hitchopt.exports.lint import load
from hitchopt.exports.placing import AXES, ReferenceFrame
from hitchopt.exports.verification import Flown, Verdict, verify
from hitchopt.motion.cable_state import CableState
from hitchopt.motion.motion import Motion
from hitchopt.motion.plan_file import read_plan
from hitchopt.motion.states import sample_times, states_at
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.trajectory.piecewise import on_breaks
from hitchopt.values import Array
from tests.helpers.exported_plans import (
    PROBLEM,
    exported,
    flown_checks,
    hitch_plan,
    reflown,
    swarm_plan,
)

PLAIN = ReferenceFrame()
EXPORTED_LIMITS = {"cable_length": 1e-3, "arena": -1e-4, "floor": -1e-4, "acceleration": 2.04}
"""Limits of exported curves that differ from those of plans."""


def recorded(curves: PiecewisePolynomial, names: tuple[str, ...]) -> FileContents:
    c = curves.coefficients
    each = [PiecewisePolynomial(curves.breaks, c[:, i]) for i in range(len(names))]
    return FileContents.of_curves(list(map(Trajectory, names, each)), "enu", 2)


def verified(motion: Motion, curves: PiecewisePolynomial) -> Verdict:
    names = motion.team.drone_names
    return verify(Flown(ho.Flight.of(motion)), recorded(curves, names), PLAIN, names)


@pytest.mark.parametrize("make", [hitch_plan, swarm_plan])
def test_the_plan_itself_is_verified_as_its_certificate_says(make: Callable[[], Motion]) -> None:
    motion = make()
    verdict, certificate = verified(motion, motion.drones), certificate_of(ho.Flight.of(motion))
    assert verdict.violated == ()
    assert max(verdict.position.worst, 1e-3 * verdict.velocity.worst) < 1e-9
    assert {check.name for check in verdict.checks} == set(flown_checks(motion))
    for check in verdict.checks:
        planned = certificate[check.name]
        if check.name in ("arena", "floor"):  # exports move drones alone: cables are the plan's
            planned = flown_checks(motion)[check.name]
        assert check.worst == pytest.approx(planned.worst, rel=3e-4, abs=1e-6)
        assert check.limit == EXPORTED_LIMITS.get(check.name, planned.limit)


def test_accelerations_are_limited_where_files_have_them() -> None:
    """Of formats whose acceleration jumps, and only of these, they are not."""
    motion = hitch_plan()
    limits = replace(motion.requirements.limits, acceleration=0.9 * 1.99)
    slower = motion.replaced(requirements=replace(motion.requirements, limits=limits))
    assert [check.name for check in verified(slower, slower.drones).violated] == ["acceleration"]
    names = motion.team.drone_names
    contents = replace(recorded(slower.drones, names), smooth=1)
    verdict = verify(Flown(ho.Flight.of(slower)), contents, PLAIN, names)
    assert verdict.violated == ()
    assert {"speed", "thrust", "tilt"} <= {check.name for check in verdict.checks}
    assert "Acceleration is discontinuous between pieces, and not certified" in verdict.not_carried


def test_a_motion_is_certified_once_and_another_one_again(
    tmp_path: Path,
) -> None:
    """Exports ask for the certificate of the very motion."""
    solved = ho.solve(ho.problem_from_dict(PROBLEM))
    solved.save(tmp_path / "plan")
    late = np.array(solved.motion.vertices.coefficients)
    late[-1, 0] += 0.01  # which no exported file shows
    moved = solved.motion.replaced(vertices=solved.motion.vertices.replaced(late))
    with pytest.raises(CertificateError, match=r"continuity|cable_length|equilibrium"):
        reflown(solved, moved).export("csv", tmp_path / "moved")
    read = read_plan(tmp_path / "plan" / "plan.npz")
    exported(read, "csv", tmp_path / "files")
    evaluated = list[str]()
    for flight in (solved.flight, read):
        assert certifying.certificate_of(flight, evaluated.append).certified
    assert evaluated == []
    certifying.certificate_of(read.stretched(1.1), evaluated.append)
    assert evaluated


@pytest.mark.slow
def test_curves_in_several_windows_are_verified_as_in_one() -> None:
    """Files of more than WINDOW pieces are read in parts."""
    motion = hitch_plan()
    late = np.array(motion.drones.coefficients)
    late[-1, 0, 0] += 1e-3  # what is off at the end alone is found in the last window
    curves = PiecewisePolynomial(motion.drones.breaks, late)
    pieces = WINDOW // motion.team.drones + 1
    first, last = curves.breaks[[0, -1]].tolist()
    breaks = np.union1d(curves.breaks, np.linspace(first, last, pieces))
    found = [verified(motion, curves), verified(motion, on_breaks(curves, breaks))]
    one, many = found
    assert many.position.worst == pytest.approx(one.position.worst)
    assert one.position.worst > 9e-4
    bounds = [{check.name: check.worst for check in verdict.checks} for verdict in found]
    assert bounds[1] == pytest.approx(bounds[0], rel=3e-4, abs=1e-6)


def test_it_rests_after_its_end_but_must_not_end_early() -> None:
    motion = hitch_plan()
    breaks, c = motion.drones.breaks, motion.drones.coefficients
    rest = np.repeat(c[-1:, ..., -1:], c.shape[-1], axis=-1)
    longer = PiecewisePolynomial(np.append(breaks, breaks[-1] + 0.3), np.concatenate([c, rest]))
    verdict = verified(motion, longer)
    assert verdict.duration == pytest.approx(motion.duration + 0.3)
    assert verdict.violated == ()
    assert verdict.position.worst < 1e-9
    with pytest.raises(FileError, match="before the plan does"):
        verified(motion, motion.drones.slice_pieces(slice(0, -1)))


@pytest.mark.parametrize(
    ("names", "words"), [(("d0", "b", "c"), "d0 is missing"), (("a", "b"), "more drones")]
)
def test_other_drones_are_refused(names: tuple[str, ...], words: str) -> None:
    with pytest.raises(FileError, match=words):
        verify(
            Flown(ho.Flight.of(swarm_plan())),
            recorded(swarm_plan().drones, ("a", "b", "c")),
            PLAIN,
            names,
        )


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
    assert "cable_length" in {check.name for check in verified(motion, curves).violated}
    verdict = verified(free, curves)
    assert "cable_length" not in {check.name for check in verdict.violated}
    assert verdict.position.worst == pytest.approx(0.3, rel=1e-3)


FRAMES = st.builds(
    ReferenceFrame,
    st.sampled_from(sorted(AXES)),
    st.lists(st.floats(-50.0, 50.0), min_size=3, max_size=3),
    st.floats(-7.0, 7.0),
)


@given(FRAMES)
def test_frames_there_and_back(frame: ReferenceFrame) -> None:
    rng, t = np.random.default_rng(0), np.array([0.2, 1.4])
    part = PiecewisePolynomial(np.array([0.0, 1.0, 1.5]), rng.normal(size=(2, 4, 3, 5)))
    placed = frame.placed(part)
    np.testing.assert_allclose(frame.in_plan(placed).coefficients, part.coefficients, atol=1e-12)
    np.testing.assert_allclose(placed.at(t), frame.points(part.at(t)), atol=1e-12)
    np.testing.assert_allclose(placed.at(t, 1), frame.vectors(part.at(t, 1)), atol=1e-11)


@pytest.mark.parametrize(
    ("name", "point", "heading"),
    [
        ("enu", [1.0, 2.0, 3.0], 0.0),
        ("nwu", [2.0, -1.0, 3.0], -0.5 * math.pi),
        ("ned", [2.0, 1.0, -3.0], 0.5 * math.pi),
    ],
)
def test_axes_by_hand(name: str, point: list[float], heading: float) -> None:
    frame = ReferenceFrame(name)
    assert frame.points(np.array([1.0, 2.0, 3.0])).tolist() == point
    assert frame.heading == pytest.approx(heading)


TIMES: tuple[object, ...] = (-0.1, math.nan, [0.0, math.inf], [])
NONSENSE: list[tuple[Callable[..., object], tuple[Any, ...], str]] = [
    (ReferenceFrame, ("neu",), "frame"),
    (ReferenceFrame, ("enu", [1, 2]), "origin"),
    (ReferenceFrame, ("enu", [1, 2, math.nan]), "origin"),
    (ReferenceFrame, ("enu", [0, 0, 0], math.inf), "yaw"),
    *((sample_times, (3.0, rate), "rate") for rate in (0.0, -1.0, math.nan, 1e12)),
    *((states_at, (swarm_plan(), t), "finite times of at least 0 s") for t in TIMES),
]


@pytest.mark.parametrize(("call", "given_", "words"), NONSENSE)
def test_nonsense_is_refused(
    call: Callable[..., object], given_: tuple[Any, ...], words: str
) -> None:
    with pytest.raises(InputError, match=words):
        call(*given_)


@given(st.floats(0.0, 40.0), st.floats(0.1, 60.0))
def test_times_are_all_multiples_and_the_end(duration: float, rate: float) -> None:
    times = sample_times(duration, rate)
    assert times[0] == 0.0
    assert np.all(np.diff(times) > 0.0)
    assert times[-1] <= duration
    multiples = [k / rate for k in range(len(times) + 2) if k / rate <= duration]
    extra = [duration] if duration - multiples[-1] > 1e-6 else []
    assert times.tolist() == multiples + extra


def test_edges_pull_the_drones_at_the_ends_of_a_chain_along_themselves() -> None:
    """These drones have no leg; their thrusts balance the weights and the last edges' tension."""
    team = ho.Team(3, [1.4, 1.5, 1.6], tension=0.7, topology="open")
    arc = [[0.3, -0.2], [0.6, 0.8], [1.6, 1.0], [2.4, 0.2]]
    hitch = ho.Hitch.balanced(team, arc, altitude=1.2)
    states = states_at(ho.solve(hitch, ho.Hold(1.0)).motion, 0.5)
    points = np.column_stack([arc, np.full(4, 1.2)])
    for drone, (own, other) in ((0, (0, 1)), (5, (3, 2))):
        along = points[other] - points[own]
        pull = 0.7 * along / np.linalg.norm(along)
        np.testing.assert_allclose(states.positions[drone], points[own], atol=1e-9)
        np.testing.assert_allclose(states.cable_forces[drone], pull, atol=1e-9)


def test_states_are_those_of_the_polynomials() -> None:
    motion, orders = hitch_plan(), ("positions", "velocities", "accelerations", "jerks")
    t = np.random.default_rng(1).uniform(0.0, motion.duration, (5, 7))
    states = states_at(motion, t)
    assert np.array_equal(states.t, t)
    expected: dict[str, Any] = {name: motion.drones.at(t, i) for i, name in enumerate(orders)}
    expected |= {name: getattr(motion, name).at(t) for name in ("vertices", "legs", "tensions")}
    expected["vertex_velocities"] = motion.vertices.at(t, 1)
    for name, values in expected.items():
        np.testing.assert_allclose(getattr(states, name), values, rtol=1e-9, atol=1e-9)
    # At a break they are the later piece's, at the end the earlier's: the jerk does jump.
    left, right = motion.drones.ends(3)
    assert not np.allclose(left[1:], right[:-1], atol=1e-3)
    at = states_at(motion, motion.drones.breaks).jerks
    np.testing.assert_allclose(at[:-1], left, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(at[-1], right[-1], atol=1e-6)
    # After its end a plan rests where it ended.
    later, end = states_at(motion, [1.0, 9.0]), states_at(motion, motion.duration)
    for name in ("positions", "cable_forces"):
        np.testing.assert_array_equal(getattr(later, name)[1], getattr(end, name))
    for rate in (later.velocities, later.accelerations, later.jerks):
        assert np.any(rate[0]) > np.any(rate[1])


@pytest.mark.parametrize("name", ["csv", "crazyswarm2", "compressed", "skybrush"])
def test_setpoints_include_trims_that_turn_with_the_heading(name: str, tmp_path: Path) -> None:
    """Shows have no heading. Files are held against the planned places."""
    plan, trim = swarm_plan(), np.array([0.1, -0.03])
    kinds = [replace(kind, trim=tuple(trim)) for kind in plan.team.kinds[:1]]
    team = ho.Swarm(3, quadrotor=[*kinds, *plan.team.kinds[1:]])
    for yaw in (0.0, 0.5 * np.pi):
        places: list[Array] = []
        for number, motion in enumerate((plan, replace(plan, team=team))):
            (part,) = exported(motion, name, tmp_path / f"{yaw:.0f}{number}", yaw=yaw)
            assert part.verdict.position.worst < 0.005
            kind, contents = load(part.folder)
            first = next(contents.windows()).coefficients[0, :, :, 0]
            places.append(first[[contents.names.index(x) for x in plan.team.drone_names]])
            trimmed = any("trims of drones" in note for note in part.notes)
            assert trimmed == bool(number)
        frame = ReferenceFrame(contents.frame or "enu", yaw=yaw)
        expected = np.zeros((3, 3))
        if kind.has_heading:
            expected[0] = frame.vectors(np.append(trim, 0.0))
        np.testing.assert_allclose(places[1] - places[0], expected, atol=3e-3)
