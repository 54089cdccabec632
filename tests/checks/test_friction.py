"""What friction may do to legs' pulls, held against samples."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from certificate_cases import applied
from certificate_sampling import sampled
from numpy.typing import NDArray

import hitchopt as ho
from hitchopt.checks import certify
from hitchopt.checks.cables import TENSION, beyond_friction
from hitchopt.checks.clasps import EQUILIBRIUM as RULE
from hitchopt.hitch import Team
from hitchopt.motion.motion import Motion
from hitchopt.trajectory import PiecewisePolynomial

Array = NDArray[np.float64]

FRICTION = 0.2
POLYGON = [[2.0, 0.3], [1.2, -1.0], [0.1, -0.4], [0.5, 0.6]]


check = partial(applied, RULE)


def team(friction: float) -> Team:
    tension = [0.5, 0.45, 0.55, 0.5]
    return Team(4, [2.9, 2.8, 2.7, 3.0], tension=tension, cable_friction=friction)


@pytest.fixture(scope="module")
def leaned() -> Motion:
    start = ho.Hitch.spread(team(FRICTION), POLYGON, altitude=1.2)
    motion = ho.move_vertex(start, 0, by=[0.25, 0.1], duration=4.0).motion
    assert isinstance(motion, Motion)
    assert motion.leg_tensions is not None
    return motion


def ratios(motion: Motion, t: Array) -> Array:
    """(times, n, 2, 2): pull over tension, and what friction makes of it at most.

    A cable wraps by how much it turns on its way from the drone along its edge.
    """
    p, x, T = motion.vertices.at(t), motion.drones.at(t), motion.tensions.at(t)
    P = motion.pulls.at(t).reshape(len(t), -1, 2)
    n = motion.team.robots
    found = np.empty((len(t), n, 2, 2))
    for k in range(n):
        ends = p[:, k], p[:, (k + 1) % n]
        for end in range(2):
            arriving, leaving = ends[end] - x[:, 2 * k + end], ends[1 - end] - ends[end]
            cosine = np.sum(arriving * leaving, axis=1)
            cosine /= np.linalg.norm(arriving, axis=1) * np.linalg.norm(leaving, axis=1)
            found[:, k, end, 0] = P[:, k, end] / T[:, k]
            found[:, k, end, 1] = np.exp(motion.team.cable_friction * np.arccos(cosine))
    return found


def test_samples_never_pass_what_is_certified(leaned: Motion) -> None:
    t = np.linspace(0.0, leaned.duration, 20_001)
    certificate, found = certify(leaned), sampled(leaned, t)
    assert certificate.certified
    for name, share in (("equilibrium", 1.0), ("tilt", 1.0), ("thrust", 2.6)):
        worst = certificate[name].bound
        assert share * found[name] <= worst <= share * found[name] * 1.001 + 1e-6
    ratio, most = np.moveaxis(ratios(leaned, t), -1, 0)
    assert np.all((ratio <= most) & (ratio >= 1.0 / most))
    assert np.ptp(ratio) > 0.05  # there is something to hold against it


def test_legs_at_their_cables_tension_are_judged_as_those_that_say_nothing(leaned: Motion) -> None:
    """Also where friction is none: then nothing else is allowed."""
    start = ho.Hitch.spread(team(0.0), POLYGON, altitude=1.2)
    plain = ho.move_vertex(start, 0, by=[0.25, 0.1], duration=4.0).motion
    assert isinstance(plain, Motion)
    assert plain.leg_tensions is None
    c = np.repeat(plain.tensions.coefficients[:, :, None], 2, axis=2)
    told = replace(plain, leg_tensions=PiecewisePolynomial(plain.drones.breaks, c))
    assert check(told).worst == pytest.approx(check(plain).worst, rel=2e-4)
    thrusts = [certify(motion)["thrust"].worst for motion in (plain, told)]
    assert thrusts[0] == pytest.approx(thrusts[1], rel=2e-4)
    assert not check(replace(leaned, team=team(0.0))).holds


def swinging(leaned: Motion, seed: int) -> Motion:
    """Pulls that no leg would have, larger or smaller, swinging between all breaks."""
    assert leaned.leg_tensions is not None
    rng = np.random.default_rng(seed)
    lower, upper = ((0.9, 1.4), (0.6, 1.05), (0.5, 1.5))[seed]

    def swung(part: PiecewisePolynomial, least: float, most: float) -> PiecewisePolynomial:
        c = part.elevated(7).coefficients
        swing = rng.uniform(least, most, c.shape)
        swing[..., [0, -1]] = 1.0  # pieces still join
        return PiecewisePolynomial(part.breaks, c * swing)

    pulls, tensions = swung(leaned.leg_tensions, lower, upper), swung(leaned.tensions, 0.97, 1.03)
    return replace(leaned, team=team(0.04), leg_tensions=pulls, tensions=tensions)


@pytest.mark.parametrize("case", [0.0, 0.02, 0.05, *"012"])
def test_more_than_friction_gives_is_unbalanced_by_as_much(
    leaned: Motion, case: float | str
) -> None:
    """Of less friction than legs lean for, and of pulls that have nothing to do with it."""
    random = isinstance(case, str)
    motion = swinging(leaned, int(case)) if random else replace(leaned, team=team(float(case)))
    t = np.linspace(0.0, motion.duration, 40_001)
    ratio, most = np.moveaxis(ratios(motion, t), -1, 0)
    beyond = np.maximum(ratio - most, 1.0 / most - ratio)
    found, worst = beyond_friction(motion), float(np.max(beyond))
    assert worst <= found.worst <= worst * 1.001 + 1e-6
    when, cable, end = np.unravel_index(np.argmax(beyond), beyond.shape)
    assert found.where == (f"p{(cable + end) % 4}",)
    assert found.time == pytest.approx(t[when], abs=0.05)
    told = check(motion)
    assert told.bound >= found.worst if random else told.worst == found.worst
    assert not told.holds


def test_a_weak_edge_is_what_a_residual_is_held_against(leaned: Motion) -> None:
    """Not the legs' pulls, which may be larger: of a cable that hardly pulls along its edge."""
    assert leaned.leg_tensions is not None
    c = leaned.tensions.coefficients.copy()
    c[:, 1] *= 0.1
    weak = replace(leaned, tensions=PiecewisePolynomial(leaned.tensions.breaks, c))
    worst = sampled(weak, np.linspace(0.0, leaned.duration, 20_001))["equilibrium"]
    assert worst <= check(weak).bound <= 1.001 * worst


def test_what_legs_pull_over_tensions_that_rise_from_zero_is_told_by_its_limit(
    leaned: Motion,
) -> None:
    breaks = leaned.drones.breaks
    rising = np.linspace(0.0, 0.5, len(breaks))
    c = np.stack([rising[:-1], rising[1:]], axis=-1)
    tensions = np.repeat(c[:, None], 4, axis=1)
    for factor in (1.0, 2.0):
        pulls = factor * np.repeat(tensions[:, :, None], 2, axis=2)
        motion = replace(
            leaned,
            tensions=PiecewisePolynomial(breaks, tensions),
            leg_tensions=PiecewisePolynomial(breaks, pulls),
        )
        assert motion.leg_tensions is not None
        found = beyond_friction(motion).worst
        assert found < 1e-9 if factor == 1.0 else 0.8 < found < 1.0


def test_legs_may_pull_with_what_friction_makes_of_the_range(leaned: Motion) -> None:
    assert certify(leaned).certified
    assert leaned.leg_tensions is not None
    t = np.linspace(0.0, leaned.duration, 20_001)
    most, T = ratios(leaned, t)[..., 1], leaned.team.tension[:, None]
    for factor in (1.6, 0.6):
        c = factor * leaned.leg_tensions.coefficients
        changed = replace(leaned, leg_tensions=PiecewisePolynomial(leaned.drones.breaks, c))
        pulls = changed.pulls.at(t).reshape(most.shape)
        worst = float(np.max(np.maximum(pulls - T * most, T / most - pulls)))
        found = applied(TENSION, changed)
        assert 0.01 < worst <= found.bound <= worst * 1.001 + 1e-6
        assert found.where[0] in leaned.team.drone_names
    assert applied(TENSION, replace(changed, team=team(1.0))).holds


@pytest.mark.parametrize(("cable", "end", "point"), [(0, 0, 0), (2, 1, 3)])
def test_at_a_chains_ends_friction_makes_nothing_of_the_tension(
    cable: int, end: int, point: int
) -> None:
    chain = Team(3, 2.4, topology="open", tension=0.5, cable_friction=0.1)
    points = [[-1.5, -0.4], [-0.6, 0.2], [0.6, 0.2], [1.5, -0.4]]
    start = ho.Hitch.spread(chain, points, altitude=1.0)
    motion = ho.move_vertex(start, 1, by=[0.1, 0.15], duration=4.0).motion
    assert isinstance(motion, Motion)
    assert motion.leg_tensions is not None
    assert check(motion).holds
    for factor in (0.0, 0.98, 1.02):
        c = motion.leg_tensions.coefficients.copy()
        c[:, cable, end] *= factor
        tampered = replace(motion, leg_tensions=PiecewisePolynomial(motion.drones.breaks, c))
        found = check(tampered)
        assert not found.holds
        assert found.worst == pytest.approx(abs(1.0 - factor), rel=1e-3)
        assert found.where == (f"p{point}",)
