"""Compiled code and numpy's path say the same, and plans do not load numba."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest
from certificate_cases import random_motion, still, with_drones
from open_chain_cases import random_chain

import hitchopt as ho
from hitchopt.checks.bounds import stop_bounds, stop_rows
from hitchopt.checks.bounds.clock_limits import ClockLimits
from hitchopt.checks.bounds.derivative_grid import CURVED, DENSER, NODES, DerivativeGrid
from hitchopt.checks.bounds.quick_stops import quick_stop_table
from hitchopt.checks.bounds.rounding_margins import LAST_PLACE, ROUNDING
from hitchopt.checks.bounds.static_thrust import StaticThrust
from hitchopt.checks.bounds.stop_rows import LimitTables
from hitchopt.checks.certify import certify
from hitchopt.checks.stoppable import QUICK
from hitchopt.compiled.kernel_switch import kernels, kernels_on
from hitchopt.feedback.covered_set import LARGEST, PASSES, cell_breaks, covered_set
from hitchopt.motion.retiming import before
from hitchopt.steering.retarget_path import MovingState, RetargetPath
from hitchopt.steering.retarget_timing import excess
from hitchopt.trajectory import distance, enclosure
from hitchopt.trajectory.compiled_search import KnownBound, largest, smallest
from hitchopt.trajectory.distance import distance_bound
from hitchopt.trajectory.extremum import Cells, Estimate
from hitchopt.values import Array

TRIANGLE = np.array([[0.0, -1.0], [-0.4, 0.5], [0.4, 0.5]]) + [1.0, 2.0]

CABLES = np.array([2.0, 2.2, 2.1])


@pytest.fixture(autouse=True)
def _needs_numba() -> None:
    pytest.importorskip("numba")


def broken() -> ho.Motion:
    """A hitch one of whose drones is on its vertex, and another far beyond all limits."""
    motion = still(ho.Team(3, CABLES), TRIANGLE, [0.4, 0.4, 0.4])
    c = motion.drones.coefficients.copy()
    c[:, 0] = motion.vertices.coefficients[:, 0]
    c[:, 3, 2] += np.linspace(0.0, 40.0, c.shape[-1])
    return with_drones(motion, c)


MOTIONS: dict[str, Callable[[], ho.Motion]] = {
    "triangle": lambda: random_motion(3, 1),
    "heptagon": lambda: random_motion(7, 2),
    "chain": lambda: random_chain(4, 3),
    "two cables": lambda: random_chain(2, 5),
    "broken": broken,
    "still": lambda: still(ho.Team(3, CABLES), TRIANGLE, [0.4, 0.5, 0.6]),
}


def agree(plain: ho.Certificate, compiled: ho.Certificate) -> None:
    """Assert that two certificates are the same to rounding."""
    assert [each.name for each in compiled.checks] == [each.name for each in plain.checks]
    for mine, other in zip(compiled.checks, plain.checks, strict=True):
        assert mine.holds == other.holds, mine.name
        assert mine.bound == pytest.approx(other.bound, rel=1e-8, abs=1e-12), mine.name


@pytest.mark.parametrize("name", MOTIONS)
def test_certificates_agree(name: str) -> None:
    motion = MOTIONS[name]()
    plain = certify(motion, reports=(QUICK,))
    with kernels() as used:
        assert used
        compiled = certify(motion, reports=(QUICK,))
    assert not kernels_on()
    agree(plain, compiled)


@pytest.mark.parametrize("limit", [2.0, 0.2])
def test_stops_agree(limit: float) -> None:
    """Also where most of them are not shown at first."""
    motion = random_motion(4, 6, limits=ho.Limits(acceleration=limit, jerk=10.0 * limit))
    plain, thrust = quick_stop_table(motion), StaticThrust.of(motion).thrust
    with kernels():
        compiled, enclosed = quick_stop_table(motion), StaticThrust.of(motion).thrust
    assert len(np.unique(plain.durations)) > 3
    np.testing.assert_allclose(compiled.durations, plain.durations, rtol=1e-9)
    np.testing.assert_allclose(enclosed.coefficients, thrust.coefficients, atol=1e-12)
    np.testing.assert_allclose(enclosed.radius, thrust.radius, rtol=1e-3, atol=1e-12)


@pytest.mark.parametrize("seed", [4, 6])
def test_tables_that_stops_are_held_against_agree(seed: int) -> None:
    """Number by number: what is off by a little seldom shows in a certificate."""
    from hitchopt.compiled.grid_kernel import stop_grid

    motion = random_motion(4, seed)
    limits, static, drones = ClockLimits(motion), StaticThrust.of(motion).thrust, motion.drones
    grid = DerivativeGrid(limits, 0.02)
    plain = LimitTables.of(limits, grid)
    own, team = motion.requirements.limits, motion.team
    found = stop_grid(
        drones.coefficients.copy(),
        drones.breaks.copy(),
        (static.coefficients.copy(), static.radius.copy()),
        np.stack([team.mass, team.max_thrust]),
        np.array([own.acceleration, own.jerk, own.tilt]),
        (max(0.02, drones.duration / NODES), CURVED, DENSER),
        (LAST_PLACE, ROUNDING),
    )
    for name in ("begin", "until", "width", "piece", "left"):
        np.testing.assert_allclose(getattr(found, name), getattr(grid, name), err_msg=name)
    margins = found.margins.transpose(0, 2, 1)
    scale = np.max(margins, axis=(1, 2), keepdims=True)
    expected = plain.margins.reshape(5, -1, drones.pieces)
    np.testing.assert_allclose(margins[:5] / scale[:5], expected / scale[:5], atol=1e-12)
    np.testing.assert_allclose(margins[5:7], plain.loads, rtol=1e-12)
    np.testing.assert_allclose(found.margins[8], grid.slope, rtol=1e-9)
    np.testing.assert_allclose(found.margins[9], grid.bend, rtol=1e-9)
    sizes = np.stack(found.sizes).transpose(0, 2, 1)
    np.testing.assert_allclose(sizes, plain.sizes, rtol=1e-12)
    np.testing.assert_allclose(found.largest.T, plain.largest, rtol=1e-12)
    np.testing.assert_allclose(found.spare, plain.spare, rtol=1e-12)


@pytest.mark.parametrize("yaw", [0.0, -0.8])
@pytest.mark.parametrize("chain", [False, True])
def test_paths_agree(chain: bool, yaw: float) -> None:
    motion = random_chain(4, 3) if chain else random_motion(5, 4)
    n = motion.team.robots
    team = replace(motion.team, tension=np.full(n, 0.4), cable_density=0.0)
    state = MovingState.at_end(before(motion, 0.45 * motion.duration))
    assert state.moves
    end = state.vertices[..., 0] + [0.1, -0.2, 0.3]
    path = RetargetPath(team, state, end, 0.9 * state.fractions[:, 0], yaw)
    times, limits = np.linspace(0.0, 2.0, 9), motion.requirements.limits
    plain, share = path.jets(times, 0.7, 1.6), excess(path, limits, times, 0.7, 1.6)
    with kernels():
        compiled = path.jets(times, 0.7, 1.6)
        assert excess(path, limits, times, 0.7, 1.6) == pytest.approx(share, rel=1e-9)
    for name, values in vars(plain).items():
        scale = np.max(np.abs(values))
        np.testing.assert_allclose(vars(compiled)[name], values, atol=1e-12 * scale, err_msg=name)


def cells(rows: Array) -> Cells:
    """One piece of one second."""
    return Cells.over(np.array([0.0, 1.0]), [rows[None]])


def test_what_is_compiled_is_used_and_what_is_not_goes_on_in_numpy() -> None:
    calls = []

    def counted(blocks: tuple[Array, ...]) -> Estimate:
        calls.append(1)
        return distance_bound(blocks)

    rng = np.random.default_rng(0)
    few, many = (rng.normal(2.0, 1.0, (5, 12, order + 1)) for order in (5, 30))
    with kernels():
        found = smallest(cells(few), counted, KnownBound("distance"))
        assert not calls
        for rows in (many, 1e61 * few):
            smallest(cells(rows), counted, KnownBound("distance"))
            assert calls
            calls.clear()
        nothing = smallest(cells(few[:0]), counted, KnownBound("distance"))
    assert nothing.item == -1
    plain = smallest(cells(few), distance_bound, KnownBound("distance"))
    assert found.item == plain.item
    assert found.worst == pytest.approx(plain.worst, rel=1e-12)
    assert plain.value >= plain.worst


def test_what_nothing_bounds_is_as_bad_as_can_be() -> None:
    """A tension of zero holds nothing."""
    rows, pulls = np.ones((1, 12, 2)), np.zeros((1, 2, 1))
    given = Cells.over(np.array([0.0, 1.0]), [rows[None], pulls[None]])

    def unused(blocks: tuple[Array, ...]) -> Estimate:
        raise AssertionError(blocks)

    with kernels():
        assert largest(given, unused, KnownBound("balance", 2, 1e-9, 1e-5, 1e-12)).worst == np.inf


@pytest.mark.parametrize("wrong", [np.nan, np.inf, 1e200])
@pytest.mark.parametrize("name", ["drones", "vertices", "legs", "tensions"])
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_numbers_that_nothing_may_be_hold_nowhere(name: str, wrong: float) -> None:
    motion = random_motion(3, 1)
    part = getattr(motion, name)
    coefficients = part.coefficients.copy()
    coefficients.reshape(-1)[1] = wrong
    motion = motion.altered(**{name: part.alike(coefficients)})  # such numbers are refused else
    plain = certify(motion, reports=())
    with kernels():
        compiled = certify(motion, reports=())
    broken = {each.name for each in plain.violated}
    assert broken
    assert {each.name for each in compiled.violated} == broken


def test_constants_are_the_same() -> None:
    from hitchopt.compiled import distance_kernel, enclosure_kernels, stop_kernel

    assert distance.TIE == distance_kernel.TIE
    assert enclosure.ROUNDING == enclosure_kernels.ENCLOSED
    assert stop_rows.SWITCH == stop_kernel.SWITCH
    assert stop_bounds.SLACK == stop_kernel.SLACK


@pytest.mark.parametrize("scale", [0.1, 1.0])
def test_projections_onto_half_spaces_agree(scale: float) -> None:
    from hitchopt.compiled.half_space_kernel import within

    rng = np.random.default_rng(int(100.0 * scale))
    motion = random_motion(5, 4)
    cells = covered_set(motion, cell_breaks(motion), 0.01).cells
    moved = 0
    for cell in filter(None, cells):
        given = rng.normal(0.0, scale, (motion.team.drones, 3))
        plain = cell.within(given)
        found = within(*cell.by_drones, given, PASSES, LARGEST)
        np.testing.assert_allclose(found, plain, atol=1e-12)
        moved += bool(np.any(np.abs(plain - given) > 1e-9))
    assert moved


@contextmanager
def without_numba() -> Iterator[None]:
    """Look for numba in vain."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("hitchopt.compiled.kernel_switch.find_spec", lambda _: None)
        yield


def steered() -> list[ho.Retarget]:
    """Answers to a vertex, a pose, and a polygon that needs another split of the slack."""
    start = ho.Hitch.spread(ho.Team(3, 2.4), TRIANGLE, 1.0)
    replanner = ho.Replanner(start.team, start)
    return [
        replanner.retarget(vertex=0, to=TRIANGLE[0] + [0.1, 0.2], at=0.4),
        replanner.retarget(to=[1.4, 2.3, 1.2], yaw=0.9, at=0.9),
        replanner.retarget(to=[1.0e4, 0.0, -3.0], at=1.2),
        replanner.retarget(TRIANGLE * [0.8, 1.0], at=1.5),
    ]


def test_retargets_do_not_depend_on_numba() -> None:
    compiled = steered()
    with without_numba():
        with kernels() as used:
            assert not used
        plain = steered()
    assert any(answer.accepted for answer in plain)
    for mine, other in zip(compiled, plain, strict=True):
        assert (mine.accepted, mine.start, mine.reason) == (
            other.accepted,
            other.start,
            other.reason,
        )
        assert mine.motion.duration == pytest.approx(other.motion.duration, rel=1e-12)
        times = np.linspace(0.0, mine.motion.duration, 50)
        for a, b in ((mine.motion.drones, other.motion.drones),):
            np.testing.assert_allclose(a.at(times), b.at(times), atol=1e-10)


def test_plans_do_not_load_numba() -> None:
    probe = (
        "import sys, numpy as np, hitchopt as ho\n"
        "start = ho.Hitch.spread(ho.Team(3, 2.4), [[0, -1], [-0.4, 0.5], [0.4, 0.5]], 1.0)\n"
        "plan = ho.transport(start, to=[0.1, 0.0, 1.1])\n"
        "assert plan.certificate.certified\n"
        "sys.exit('numba is loaded' if 'numba' in sys.modules else 0)"
    )
    done = subprocess.run(
        [sys.executable, "-c", probe], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


def test_anybody_may_plan_with_compiled_code() -> None:
    """Motions and certificates are the same to rounding."""
    start = ho.Hitch.spread(ho.Team(3, 2.4), TRIANGLE, altitude=1.0)

    def planned() -> ho.Plan:
        return ho.morph(start, start.polygon.vertices + [0.2, 0.1])

    plain = planned()
    with ho.kernels() as used:
        assert used
        compiled = planned()
    assert not kernels_on()
    for name in ("drones", "vertices", "legs", "tensions"):
        here, there = (getattr(plan.motion, name).coefficients for plan in (plain, compiled))
        np.testing.assert_allclose(here, there, rtol=1e-12, atol=1e-12)
    agree(plain.certificate, compiled.certificate)


def corrected(plan: ho.Plan) -> Array:
    """Offsets of a flight with vertices that are off, some of them missing for a while."""
    feedback, rng = ho.Feedback(plan), np.random.default_rng(5)
    found = []
    for i, time in enumerate(np.arange(0.0, plan.duration, 0.02).tolist()):
        seen = plan.at(time).vertices + rng.normal([0.05, -0.1, -0.2], 0.02, (3, 3))
        seen[1] = np.nan if 60 < i < 90 else seen[1]
        feedback.step(time, 0.02, None if i % 3 == 0 else seen)
        found.append(feedback.offsets)
    return np.array(found)


def test_corrections_do_not_depend_on_numba() -> None:
    start = ho.Hitch.spread(ho.Team(3, 2.4), TRIANGLE, 1.0)
    plan = ho.morph(start, TRIANGLE * [0.9, 1.0], duration=4.0)
    compiled = corrected(plan)
    with without_numba():
        plain = corrected(plan)
    np.testing.assert_allclose(compiled, plain, rtol=0.0, atol=1e-12)
    assert 0.05 < np.max(np.abs(plain)) < 0.4
