"""``vertex_error``: never beaten by hitches that settle with smaller errors, and laws."""

import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import hitchopt as ho
from hitchopt.checks.certifying import certify
from hitchopt.checks.swing import swings_at_rests
from hitchopt.checks.vertex_errors import error_in_words, errors_at_rests, states_at_rests
from hitchopt.geometry.vectors import length, unit
from hitchopt.hitch.requirements import Requirements
from hitchopt.hitch.rest_errors import ErrorSizes, planned_rest, settled
from hitchopt.hitch.team import Errors, Swarm
from hitchopt.motion.flight import Flight
from hitchopt.motion.motion import PLAIN, HoldBy, Motion, Phase, PhaseHold
from hitchopt.motion.plan_file import write_plan
from hitchopt.planners.rests import rest_motion
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array, known
from hitchopt.verify import verify
from hitchopt.verify.reading import read
from hitchopt.verify.request import contradicts
from hitchopt.verify.statics import Rest, rests

DRAWS = 200

LOOSE = Errors(cable_length=0.01, drone=0.02)
WITH_FRICTION = Errors(cable_length=0.01, drone=ho.Tube(0.01, 0.02), friction=0.01)


@cache
def plan(
    robots: int, topology: str, density: float = 0.0, controller: str | None = None
) -> ho.Plan:
    """Return a morph of a polygon or a chain, off the origin and with unequal cables."""
    lengths = [2.4 + 0.1 * (k % 3) for k in range(robots)]
    team = ho.Team(
        robots,
        lengths,
        topology=topology,
        tension=0.5,
        cable_density=density,
        quadrotor=ho.Quadrotor(controller=controller, gains={"kp": 4.0} if controller else None),
    )
    if topology == "open":
        corners = np.array([[-0.9, 0.1], [-0.35, 0.5], [0.4, 0.55], [0.9, 0.0]])[: robots + 1]
        other = corners + [[0.0, 0.0], [0.05, 0.1], [0.0, 0.1], [0.0, 0.0]]
    else:
        angles = -2.0 * np.pi * (np.arange(robots) + 0.1 * np.arange(robots) % 0.2) / robots
        radius = 0.2 + 0.09 * robots
        corners = radius * np.column_stack([np.cos(angles), np.sin(angles)])
        other = corners * [1.1, 0.9]
    shift = [1.3, -0.7]
    start = ho.Hitch.spread(team, corners + shift, altitude=1.6)
    return ho.morph(start, other + shift)


Case = tuple[int, str, float, str | None]
PLANS: list[Case] = [
    (3, "closed", 0.0, None),
    (4, "closed", 0.004, "mellinger"),
    (6, "closed", 0.0, "mellinger"),
    (3, "open", 0.0, None),
]

CASES = [pytest.param(case, marks=[pytest.mark.slow] if case[0] == 6 else []) for case in PLANS]


def with_errors(motion: Motion, errors: Errors) -> Motion:
    """Return the motion of a team with errors."""
    return replace(motion, team=replace(motion.team, errors=errors))


def drawn_errors(
    motion: Motion, errors: Errors, rng: np.random.Generator, *, corner: bool
) -> tuple[Array, Array, Array]:
    """Return errors of lengths, setpoints and friction of draws; at the bounds if ``corner``."""
    n, sizes = motion.team.robots, ErrorSizes.of(motion.team, None)

    def number(*shape: int) -> Array:
        return np.sign(rng.normal(size=shape)) if corner else rng.uniform(-1.0, 1.0, shape)

    directions = unit(rng.normal(size=(DRAWS, 2 * n, 3)))
    if not corner:
        directions *= rng.uniform(0.0, 1.0, (DRAWS, 2 * n, 1)) ** (1.0 / 3.0)
    offsets = directions * [sizes.drone.level, sizes.drone.level, sizes.drone.height]
    return (
        errors.cable_length * number(DRAWS, n),
        offsets,
        errors.friction * number(DRAWS, n, 2),
    )


@pytest.mark.parametrize("errors", [LOOSE, WITH_FRICTION], ids=["loose", "friction"])
@pytest.mark.parametrize(
    "case",
    [
        pytest.param(case, marks=() if case[:2] == (3, "closed") else pytest.mark.slow)
        for case in PLANS
    ],
    ids=lambda case: f"{case[1]}-{case[0]}",
)
def test_no_settled_hitch_beats_the_bound(
    case: tuple[int, str, float, str], errors: Errors
) -> None:
    """Hitches settle with 200 random errors each, half of them at the bounds."""
    motion = with_errors(plan(*case).motion, errors)
    rests, states = errors_at_rests(motion), states_at_rests(motion)
    assert states is not None
    assert len(rests) == 2  # before and after the morph
    rng = np.random.default_rng(5)
    for i, rest in enumerate(rests):
        for corner in (False, True):
            lengths, offsets, ratios = drawn_errors(motion, errors, rng, corner=corner)
            one = states[[i] * DRAWS]
            samples = planned_rest(
                motion.team, one.positions, one.vertices, one.tensions, one.cable_forces
            )
            points = settled(motion.team, samples, lengths, offsets, ratios)
            off = length(points - one.vertices)
            assert np.all(np.isfinite(off))
            assert np.all(np.max(off, axis=0) <= rest.radii)


@pytest.mark.parametrize("errors", [LOOSE, WITH_FRICTION], ids=["loose", "friction"])
@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case[1]}-{case[0]}")
def test_some_errors_at_the_bounds_reach_two_thirds_of_it(case: Case, errors: Errors) -> None:
    """Errors climb: each takes the side on which the settled vertex is farther off."""
    motion = with_errors(plan(*case).motion, errors)
    rest, states = errors_at_rests(motion)[0], states_at_rests(motion)
    assert states is not None
    n, sizes = motion.team.robots, ErrorSizes.of(motion.team, None)
    bounds = np.concatenate([[errors.cable_length] * n, [errors.friction] * 2 * n])
    axes = np.array([sizes.drone.level, sizes.drone.level, sizes.drone.height])

    def settle(lengths: Array, offsets: Array, friction: Array) -> Array:
        one = states[[0] * len(lengths)]
        samples = planned_rest(
            motion.team, one.positions, one.vertices, one.tensions, one.cable_forces
        )
        return settled(motion.team, samples, lengths, offsets, friction) - one.vertices

    vertex, step = int(np.argmax(rest.radii)), 1e-4
    count = 3 * n + 6 * n
    probes = step * np.eye(count)
    moves = (
        settle(
            probes[:, :n],
            probes[:, 3 * n :].reshape(count, 2 * n, 3),
            probes[:, n : 3 * n].reshape(count, n, 2),
        )[:, vertex]
        / step
    )
    best = 0.0
    for direction in np.linalg.svd(moves * np.concatenate([bounds, np.tile(axes, 2 * n)])[:, None])[
        2
    ]:
        pushes = moves @ direction
        offsets = axes * unit(axes * pushes[3 * n :].reshape(-1, 3))
        scalars = bounds * np.sign(pushes[: 3 * n])
        for sign in (1.0, -1.0):
            off = settle(
                sign * scalars[None, :n],
                sign * offsets[None],
                sign * scalars[None, n:].reshape(1, n, 2),
            )
            best = max(best, float(length(off[0, vertex])))
    assert best <= rest.radii[vertex] <= 1.5 * best


def moved(motion: Motion, matrix: Array, shift: Array) -> Motion:
    """Return a motion whose drones and vertices are mapped by a matrix and a shift."""
    curves = {}
    for name in ("drones", "vertices"):
        curve = getattr(motion, name)
        mapped = np.einsum("ij,...jk->...ik", matrix, curve.coefficients) + shift[:, None]
        curves[name] = replace(curve, coefficients=mapped)
    plain = {"leg_tensions": PLAIN, "contacts": PLAIN}
    return replace(motion, **curves, **plain)


TURN = np.array([[0.6, -0.8, 0.0], [0.8, 0.6, 0.0], [0.0, 0.0, 1.0]])


@pytest.mark.parametrize(
    "matrix", [np.eye(3), TURN, np.diag([-1.0, 1.0, 1.0])], ids=["shift", "turn", "mirror"]
)
@pytest.mark.parametrize(
    "case",
    [pytest.param(case, marks=() if case[0] == 3 else pytest.mark.slow) for case in PLANS],
    ids=lambda case: f"{case[1]}-{case[0]}",
)
def test_errors_do_not_depend_on_place_and_heading(case: Case, matrix: Array) -> None:
    motion = with_errors(plan(*case).motion, WITH_FRICTION)
    other = moved(motion, matrix, np.array([3.0, -5.0, 0.4]))
    pairs = zip(errors_at_rests(motion), errors_at_rests(other), strict=True)
    for first, second in pairs:
        assert second.radii == pytest.approx(first.radii, rel=1e-5)
        assert second.parts == pytest.approx(first.parts, rel=1e-4, abs=1e-7)


def test_errors_are_those_of_renumbered_robots() -> None:
    motion = with_errors(plan(*PLANS[2]).motion, WITH_FRICTION)
    curves = {"drones": 4, "vertices": 2, "legs": 2, "tensions": 2}
    rolled = {
        name: replace(
            getattr(motion, name), coefficients=np.roll(getattr(motion, name).coefficients, -by, 1)
        )
        for name, by in curves.items()
    }
    plain = {"leg_tensions": PLAIN, "contacts": PLAIN}
    team = replace(motion.team, cable_length=np.roll(motion.team.cable_length, -2))
    other = replace(motion, team=team, **rolled, **plain)
    pairs = zip(errors_at_rests(motion), errors_at_rests(other), strict=True)
    for first, second in pairs:
        assert second.radii == pytest.approx(np.roll(first.radii, -2), rel=1e-5)


@pytest.mark.parametrize("cause", ["cable_length", "drone", "friction"])
def test_larger_errors_have_larger_bounds_and_none_has_none(cause: str) -> None:
    motion = plan(*PLANS[1]).motion
    none = {"cable_length": 0.0, "drone": 0.0, "friction": 0.0}
    bounds = [
        errors_at_rests(with_errors(motion, Errors(**{**none, cause: size})))[0].radii
        for size in (0.0, 0.005, 0.01)
    ]
    assert np.all(bounds[0] < 1e-3)  # the plan's own sag
    assert np.all(bounds[1] < bounds[2])
    assert 0.5 * bounds[2] == pytest.approx(bounds[1], rel=0.2, abs=1e-3)


def test_drones_are_off_by_the_errors_that_are_stated_first() -> None:
    motion = plan(*PLANS[0]).motion
    limits = {
        size: replace(
            motion,
            requirements=replace(
                motion.requirements, limits=replace(motion.requirements.limits, tracking=size)
            ),
        )
        for size in (None, 0.0, 0.02, ho.Tube(0.01, 0.02))
    }
    radii = {size: errors_at_rests(each)[0].radii for size, each in limits.items()}
    assert radii[None] == pytest.approx(radii[0.02])  # the stated default
    assert np.all(radii[0.0] < radii[ho.Tube(0.01, 0.02)])
    assert np.all(radii[ho.Tube(0.01, 0.02)] < radii[0.02])
    stated = with_errors(limits[0.0], Errors(drone=0.02))
    assert errors_at_rests(stated)[0].radii == pytest.approx(radii[0.02])


def test_hitches_that_hold_something_and_single_drones_have_no_error() -> None:
    swarm = Swarm(2)
    breaks, places = [0.0, 1.0], [[0.0, 0.0, 1.0], [1.0, 0.0, 1.0]]
    none = Motion.single(
        swarm,
        Requirements(),
        PiecewisePolynomial.constant(breaks, places),
        [Phase("wait", 0, 0.0, 1.0)],
    )
    held = plan(*PLANS[0]).motion
    hold = PhaseHold("box", HoldBy.GRIP, (0,))
    held = replace(held, phases=tuple(replace(each, hold=hold) for each in held.phases))
    for motion in (none, held):
        assert not errors_at_rests(motion)
        assert not error_in_words(motion)


def test_words_add_up_to_the_largest_error() -> None:
    motion = with_errors(plan(*PLANS[0]).motion, WITH_FRICTION)
    rests = errors_at_rests(motion)
    words = error_in_words(motion)
    worst = max(rests, key=lambda rest: float(np.max(rest.radii)))
    vertex = int(np.argmax(worst.radii))
    total, *parts = (float(x) for x in re.findall(r"([0-9.e-]+) cm", words))
    assert total == pytest.approx(100.0 * worst.radii[vertex], rel=0.01)
    assert parts[:-1] == pytest.approx(100.0 * worst.parts[vertex], rel=0.06)
    assert sum(parts) == pytest.approx(total, rel=0.06)


def test_a_limit_is_checked_and_proven_independently(tmp_path: Path) -> None:
    plain = plan(*PLANS[0])
    worst = plain.certificate["vertex_error"]
    assert (worst.limit, worst.holds, worst.gamma) == (None, True, None)
    for limit, holds in ((1.01 * worst.worst, True), (0.99 * worst.worst, False)):
        requirements = replace(
            plain.motion.requirements,
            limits=replace(plain.motion.requirements.limits, vertex_error=limit),
        )
        limited = Flight.of(replace(plain.motion, requirements=requirements))
        assert certify(limited)["vertex_error"].holds is holds
        write_plan(tmp_path / "plan.npz", limited)
        row = next(row for row in verify(tmp_path) if row.name == "vertex_error")
        assert row.verdict == ("proven" if holds else "violated")
        assert row.worst == pytest.approx(worst.worst, rel=1e-3)


def test_swings_count_at_rests_and_are_not_proven(tmp_path: Path) -> None:
    """The verifier has the same errors without them."""
    motion = plan(*PLANS[1]).motion
    rests = errors_at_rests(motion)
    left = swings_at_rests(motion, np.array([rest.time for rest in rests]))
    assert [rest.swing.tolist() for rest in rests] == left.tolist()
    assert np.all(left[0] == 0.0)
    assert 0.0 < np.max(left[-1]) <= 0.5 * known(motion.requirements.limits.swing)
    limits = replace(motion.requirements.limits, vertex_error=0.3)
    limited = motion.replaced(requirements=replace(motion.requirements, limits=limits))
    write_plan(tmp_path / "plan.npz", Flight.of(limited))
    row = next(row for row in verify(tmp_path) if row.name == "vertex_error")
    without = max(float(np.max(rest.radii - rest.swing)) for rest in rests)
    assert row.verdict == "at samples"
    assert row.worst == pytest.approx(without, rel=1e-3)


@pytest.mark.parametrize(
    "kind",
    [
        ho.Quadrotor(stiffness=2.0),
        ho.Quadrotor(controller="lee"),
        ho.Quadrotor(controller="px4"),
        ho.Quadrotor(controller="px4", gains={"kp": [1.0, 9.0], "kd": 0.5}),
        ho.Quadrotor(controller="mellinger"),
        ho.Quadrotor(model="crazyflie_2.1_brushless"),
        ho.Quadrotor(mass=0.3, max_thrust=8.0),
    ],
    ids=lambda kind: f"{kind.controller}-{kind.mass:g}",
)
@pytest.mark.parametrize("topology", ["closed", "open"])
def test_both_bounds_agree_for_every_loop(
    kind: ho.Quadrotor, topology: str, tmp_path: Path
) -> None:
    n, density = 4, 0.002
    team = ho.Team(n, 2.4, topology=topology, quadrotor=kind, cable_density=density, tension=0.12)
    team = replace(team, errors=Errors(0.004, ho.Tube(0.01, 0.015), 0.005))
    corners = [[-0.6, -0.4], [-0.5, 0.5], [0.5, 0.6], [0.7, -0.3]]
    if topology == "open":
        corners = [[-1.2, 0.0], [-0.6, 0.4], [0.0, 0.5], [0.6, 0.4], [1.2, 0.1]]
    hitch = ho.Hitch.spread(team, np.array(corners) + 2.0, altitude=1.5)
    requirements = Requirements(limits=ho.Limits(vertex_error=0.5, tracking=0.0))
    motion = rest_motion(hitch, requirements, 1.0, Phase("hold", 0, 0.0, 1.0))
    own = errors_at_rests(motion)
    write_plan(tmp_path / "plan.npz", Flight.of(motion))
    plans, _ = read(tmp_path / "plan.npz")
    tube = (0.01, 0.015)
    errors = {"cable_length": 0.004, "friction": 0.005}
    for rest, (_, other) in zip(own, rests(plans[0]), strict=True):
        # The verifier's legs sag by their own tension with friction, which moves soft loops
        assert other.radii(errors, tube) == pytest.approx(rest.radii, abs=2e-4)


def test_drones_are_held_by_as_much_more_as_legs_pull_by_friction(tmp_path: Path) -> None:
    """The verifier follows a rest from its planned pulls, of which friction takes the rest."""
    hitch = ho.Hitch.spread(ho.Team(3, [2.4, 2.3, 2.5]), [[0, 0.6], [0.6, -0.4], [-0.5, -0.5]])
    motion = rest_motion(hitch, Requirements(), 1.0, Phase("hold", 0, 0.0, 1.0))
    write_plan(tmp_path / "plan.npz", Flight.of(motion))
    (plan, *_), _ = read(tmp_path / "plan.npz")
    tensions = motion.team.tension
    pulls = np.repeat(tensions, 2) * [1.1, 0.9, 1.05, 1.0, 0.97, 1.2]
    plain, leaning = (
        Rest(plan, hitch.drones, hitch.vertices, tensions, each) for each in (None, pulls)
    )
    more = length((leaning.held - plain.held)[:6])
    assert more == pytest.approx(np.abs(pulls - np.repeat(tensions, 2)))


def test_a_plan_that_leaves_out_the_stated_limit_or_errors_contradicts_its_request() -> None:
    settings = {"speed": 1.0, "vertex_error": 0.06}
    assert not contradicts("vertex_error", 0.06, settings)
    assert contradicts("vertex_error", 0.05, settings)
    assert contradicts("vertex_error", 0.05, {"speed": 1.0})
    assert not contradicts("vertex_error", None, {"speed": 1.0})
    assert contradicts("errors", {"drone": 0.01}, {"robots": 3})
    assert contradicts("errors", {"drone": 0.01}, {"errors": {"drone": 0.02, "friction": 0.0}})
    assert not contradicts("errors", {"drone": 0.01}, {"errors": {"drone": 0.01, "friction": 0.0}})
