"""Timing: jets, ramps, limits, and optima in closed form."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

import hitchopt as ho
from hitchopt import Hitch, Limits, Separation, Team
from hitchopt.checks.drones import Drones
from hitchopt.checks.registry import RULE_OF, RULES
from hitchopt.checks.rule import CheckRule, Evaluator, WorstOverSpans
from hitchopt.hitch import GRAVITY
from hitchopt.hitch.requirements import Requirements
from hitchopt.hitch.team import Swarm
from hitchopt.mission.loading import load_problem
from hitchopt.motion.motion import Motion
from hitchopt.planners.path import Path
from hitchopt.planners.stages import straight_lines
from hitchopt.planners.timing import stretch
from hitchopt.planners.timing.clock import ClockedPath, RateRows
from hitchopt.planners.timing.profile import (
    Demands,
    fastest_profile,
    flight_estimate,
    flight_estimates,
    path_grid,
)
from hitchopt.planners.timing.ramps import fastest_clock, fastest_ramps
from hitchopt.planners.timing.stretch import further_stretch, needed_stretch
from hitchopt.planners.timing.timed_motion import (
    MAX_PACE_GAIN,
    MAX_PEAK,
    PACE_TOLERANCE,
    TIMING_GRID,
    fastest_motion,
    motion_along,
    motion_in_parts,
)
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.trajectory.piecewise import MIN_SPACING
from hitchopt.values.fields import with_fields
from problems.random_morph import irregular_pairs, random_convex_polygon
from tests.helpers.plans import PROBLEMS, planned


@given(st.floats(1e-3, 50.0), st.floats(0.1, 5.0), st.floats(0.2, 9.0), st.floats(0.5, 90.0))
@settings(max_examples=60)
def test_fastest_ramps_are_those_of_the_clock(d: float, v: float, a: float, j: float) -> None:
    """By ruckig, another library."""
    (duration,), (rise,) = fastest_ramps(np.array([d]), v, a, j)
    clock = fastest_clock(d, v, a, j)
    phases = np.array([min(a / j, 0.5 * rise), rise - 2.0 * a / j, duration - 2.0 * rise])
    if np.all((phases < 1e-12) | (phases > MIN_SPACING)):
        assert duration == pytest.approx(clock.duration, rel=1e-6)
    assert duration <= clock.duration * (1.0 + 1e-6)
    assert 2.0 * rise <= duration * (1.0 + 1e-12)
    assert d <= v * (duration - rise) * (1.0 + 1e-9)


@given(
    st.floats(1e-5, 1e2),
    st.floats(1e-2, 30.0),
    st.floats(0.1, 30.0),
    st.floats(-3.0, 4.0).map(lambda exponent: 10.0**exponent),
)
@settings(max_examples=200)
@example(0.6, 1.0, 5.0, 1e4)
def test_no_phase_of_a_clock_is_too_short_for_its_derivatives(
    d: float, v: float, a: float, j: float
) -> None:
    clock = fastest_clock(d, v, a, j)
    assert np.min(clock.durations) >= MIN_SPACING
    for order, limit in ((1, v), (2, a), (3, j)):
        assert np.max(np.abs(clock.at(clock.breaks, order))) <= limit * (1.0 + 1e-6)
    (fastest,) = fastest_ramps(np.array([d]), v, a, j).durations
    assert clock.duration <= 1.1 * fastest + 16.0 * MIN_SPACING


@pytest.mark.parametrize("jerk", [0.03, 700.0, 4e3, 1e4])
def test_limits_of_jerk_over_their_range_leave_no_jumps(jerk: float) -> None:
    """Of tied hitches that move, and of lines, whose clocks ruckig makes."""
    limits = Limits(jerk=jerk, acceleration=5.0)
    start = Hitch.spread(Team(3, 2.4), [[0, 0.6], [0.5, -0.3], [-0.5, -0.3]], altitude=1.5)
    motion = ho.solve(start, ho.Transport(to=[5.2, -3.1, 1.7]), limits=limits).motion
    lines = straight_lines(start.team, limits, start.drones, start.drones + [0.01, 3.0, 0.2])
    for flown in (motion, motion.single(start.team, motion.requirements, lines, [])):
        assert np.min(flown.drones.durations) >= 0.5 * MIN_SPACING
        jumps = RULE_OF["continuity"].check(flown)
        assert jumps is not None
        assert jumps.worst <= 1e-7


@pytest.mark.slow
def test_a_hitch_is_formed_with_the_largest_jerk() -> None:
    q, r = ([[x, 1.2 * k, 0.0] for k in (-1, 0, 1)] for x in (-0.6, 0.6))
    polygon = [[0, 0.6], [0.5, -0.3], [-0.5, -0.3]]
    plan = ho.form(Team(3, 2.4), q, r, polygon, altitude=1.5, limits=Limits(jerk=1e4))
    assert plan.certificate["continuity"].worst <= 1e-7


def ends(
    n: int, seed: int, limits: Limits, offset: tuple[float, float] | None = None
) -> tuple[Hitch, Hitch]:
    """Of a random morph, or of a rigid shift by ``offset``."""
    rng = np.random.default_rng(seed)
    first = random_convex_polygon(n, 1.0, rng)
    second = first.scaled(1.08).rotated(0.1).translated(rng.normal(scale=0.4, size=2))
    second = second if offset is None else first.translated(offset)
    team = Team(n, 2.2, tension=rng.uniform(0.38, 0.42, n))
    start, kept = Hitch.balanced(team, first), {"limits": limits, "separation": Separation()}
    return start, Hitch.nearest(team, second, 1.0, start.fractions, **kept)  # type: ignore[arg-type]


@pytest.mark.parametrize("distance", [0.1, 0.6, 3.0])
def test_a_rigid_shift_takes_the_known_time(distance: float) -> None:
    """By trapezoids without a jerk limit: D/v + v/a; with one as the fastest clock takes."""
    v, a, j = 0.8, 2.0, 20.0
    limits = Limits(v, a, j, tilt=1.5, vertex_speed=100.0)
    path = Path.straight(*ends(4, 3, limits, (0.6 * distance, 0.8 * distance)))
    bang = distance / v + v / a if distance > v * v / a else 2.0 * math.sqrt(distance / a)
    profile = fastest_profile(
        path_grid(TIMING_GRID), Demands.along(path, limits, path_grid(TIMING_GRID))
    )
    assert profile.duration == pytest.approx(bang, rel=2e-3)
    optimum = fastest_clock(distance, v, a, j).duration
    assert optimum <= motion_along(path, Requirements(limits)).duration <= 1.02 * optimum


def line_demands(progress: np.ndarray, rate: np.ndarray, distance: float) -> Demands:
    """Of single drones side by side on a line, at a share (J,) of a distance [m], unbent."""
    swarm = Swarm(3)
    jets = np.zeros((len(progress), 3, 3, 4))
    jets[:, :, 0, 0] = distance * progress[:, None]
    jets[:, :, 0, 1] = distance * rate[:, None]
    weights = swarm.mass[:, None] * np.array([0.0, 0.0, GRAVITY])
    loads = np.broadcast_to(weights, (len(progress), 3, 3))
    limits = Limits(0.8, 2.0, tilt=1.5, vertex_speed=100.0)
    return Demands(jets, np.zeros(len(progress)), loads, swarm, limits)


@pytest.mark.parametrize("distance", [1e-8, 1e-4, 0.1, 3.0, 1e4])
@pytest.mark.parametrize("pause", [0.0, 0.01, 0.2])
def test_lines_of_any_length_take_the_known_time_also_if_the_path_pauses(
    distance: float, pause: float
) -> None:
    """Where the drones do not move with the path's parameter, its speed is unbounded."""
    s, (v, a) = path_grid(TIMING_GRID), (0.8, 2.0)
    moving = np.abs(s - 0.5) >= 0.5 * pause
    progress = np.where(
        s < 0.5, np.minimum(s, 0.5 - 0.5 * pause), np.maximum(s - pause, 0.5 - 0.5 * pause)
    )
    rate = moving / (1.0 - pause)
    profile = fastest_profile(s, line_demands(progress / (1.0 - pause), rate, distance))
    bang = distance / v + v / a if distance > v * v / a else 2.0 * math.sqrt(distance / a)
    assert profile.duration == pytest.approx(bang, rel=0.02)


@pytest.mark.parametrize("distance", [1e-8, 0.1, 3.0])
def test_a_path_that_stops_midway_is_timed(distance: float) -> None:
    """The path slows to a stop and goes on: s - 1/2 enters by its cube."""
    s = np.linspace(0.0, 1.0, 161)
    centered = 2.0 * s - 1.0  # 0 at the middle point
    demands = line_demands(0.5 + 0.5 * centered**3, 3.0 * centered**2, distance)
    demands.drones[:, :, 0, 2] = distance * 12.0 * centered[:, None]
    straight = fastest_profile(s, line_demands(s, np.ones_like(s), distance))
    assert straight.duration < fastest_profile(s, demands).duration < 2.0 * straight.duration


@pytest.mark.parametrize(
    ("limits", "binding"),
    [
        (Limits(), "vertex_speed"),
        (Limits(vertex_speed=9.0, speed=0.4), "speed"),
        (Limits(vertex_speed=9.0, speed=9.0, jerk=200.0), "acceleration"),
        (Limits(vertex_speed=9.0, speed=9.0), "jerk"),
        (Limits(vertex_speed=9.0, speed=9.0, tilt=math.radians(21.0)), "tilt"),
    ],
)
def test_one_limit_binds_near_the_optimal_duration(limits: Limits, binding: str) -> None:
    start, goal = ends(3, 13, limits)
    loose = Separation(radius=0.01, height=0.01, cable=0.0, crossing=0.0)
    plan = ho.morph(start, goal.polygon, goal.q_legs, limits=limits, separation=loose)
    check = plan.certificate[binding]
    assert plan.certificate.certified
    assert check.worst >= 0.985 * (check.limit or 0.0)
    fine = np.linspace(0.0, 1.0, 1001)
    exact = Demands.along(Path.straight(start, goal), limits, fine)
    optimum = fastest_profile(fine, exact).duration
    assert plan.duration <= 1.03 * optimum + limits.acceleration / limits.jerk


@pytest.mark.parametrize("seed", range(2))
def test_flights_take_a_little_longer_than_their_estimates(seed: int) -> None:
    """And forever where a path cannot even be held at rest."""
    for limits in (Limits(), Limits(speed=0.5, vertex_speed=5.0, acceleration=1.0)):
        path = Path.straight(*ends(3 + seed, seed, limits))
        duration = motion_along(path, Requirements(limits)).duration
        assert 0.995 * duration - 0.05 < flight_estimate(path, limits) < duration
        tensions = PiecewisePolynomial.constant([0.0, 1.0], 0.6 * np.ones(path.team.robots))
        slow = replace(path, tensions=tensions)
        both = [flight_estimate(each, limits) for each in (path, slow)]
        assert flight_estimates([path, slow], limits) == pytest.approx(both, rel=1e-9)
    limits = Limits(tilt=math.radians(10.0))
    assert flight_estimate(path, limits) == math.inf
    assert flight_estimates([path, path], limits) == [math.inf, math.inf]
    with pytest.raises(ho.HitchoptError):
        motion_along(path, Requirements(limits))


def clocked(seed: int, samples: int) -> ClockedPath:
    """Drones on smooth curves of τ in [0, 1], no two alike, pulled by cables."""
    rng, team, shape = np.random.default_rng(seed), Team(3, 2.0), (6, 3)
    tau = np.linspace(0.0, 1.0, samples)[:, None, None]
    size, phase = rng.uniform(0.1, 0.3, shape), rng.uniform(0.0, 6.0, shape)
    rate = rng.uniform(1.0, 3.0, shape)
    first, second, third = (
        size * rate**k * np.sin(rate * tau + phase + k * np.pi / 2.0) for k in (1, 2, 3)
    )
    weight = team.mass[:, None] * np.array([0.0, 0.0, 9.81])
    loads = np.broadcast_to(weight - rng.normal(scale=0.1, size=shape), (samples, *shape))
    jets = np.stack([np.zeros_like(first), first, second, third], axis=-1)
    limits = Limits(1.1, 1.7, 9.0, math.radians(24.0))
    demands = Demands(jets, np.zeros(samples), loads, team, limits)
    largest_jerks = np.full(samples, limits.jerk)
    return ClockedPath(demands, first, second, third, np.full(samples, 1.5), largest_jerks)


def test_jerks_on_a_clock_are_rates_of_accelerations() -> None:
    """By differences over the clock τ, whose rate is √x."""
    path, tau = clocked(5, 2001), np.linspace(0.0, 1.0, 2001)
    x, x1, x2 = 1.0 + 0.5 * tau - 0.4 * tau**2, 0.5 - 0.8 * tau, np.full(2001, -0.8)
    shape = (-1, 1, 1)
    accelerations = x.reshape(shape) * path.second + 0.5 * x1.reshape(shape) * path.first
    rates = np.gradient(accelerations, tau, axis=0, edge_order=2)
    jerks = np.sqrt(x)[:, None] * np.linalg.norm(rates, axis=-1)
    limits, ratios = path.demands.limits, path.ratios(np.stack([x, x1, x2]))
    acceleration = np.linalg.norm(accelerations, axis=-1)
    np.testing.assert_allclose(ratios[0], acceleration / limits.acceleration, rtol=1e-12)
    np.testing.assert_allclose(ratios[1], jerks / limits.jerk, rtol=1e-4, atol=1e-6)


@settings(max_examples=20)
@given(st.integers(0, 10_000))
def test_derivatives_of_rows_by_differences(seed: int) -> None:
    path, rng, step = clocked(seed, 4), np.random.default_rng(seed), 1e-6
    rows = RateRows.of(path, np.broadcast_to(np.arange(6), (4, 4, 6)))
    p = np.vstack([rng.uniform(0.3, 2.0, 4), rng.normal(size=(2, 4))])
    weights = rng.uniform(0.0, 1.0, rows.c.shape)
    (_, gradients), curvature = rows.at(p), rows.curvature(p, weights)
    for i, shift in enumerate(step * np.eye(3)[:, :, None]):
        after, before = rows.at(p + shift), rows.at(p - shift)
        difference, change = ((x - y) / (2.0 * step) for x, y in zip(after, before, strict=True))
        np.testing.assert_allclose(gradients[i], difference, rtol=1e-5, atol=1e-6)
        bent = np.einsum("rm,irm->im", weights, change)
        np.testing.assert_allclose(curvature[i], bent, rtol=1e-5, atol=1e-5)
    convex = rows.curvature(p, weights, convex=True)  # what is omitted bends the other way
    parts = np.moveaxis(np.stack([convex, convex - curvature]), 3, 1)
    assert np.min(np.linalg.eigvalsh(parts)) >= -1e-9


def turning(name: str, rate_deg: float) -> ho.Plan:
    problem = load_problem(PROBLEMS / f"{name}.yaml")
    limits = replace(problem.limits, body_rate=math.radians(rate_deg))
    return ho.solve(replace(problem, limits=limits))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "rate"),
    [
        ("triangle", 40.0),
        ("form_triangle", 50.0),
        ("square_quarter_turn", 60.0),  # by the optimiser
        ("swarms/head_on", 30.0),
    ],
)
def test_plans_keep_a_body_rate_and_come_close_to_it(name: str, rate: float) -> None:
    plan = turning(name, rate)
    check = plan.certificate["body_rate"]
    assert check.limit == pytest.approx(rate)
    assert plan.certificate.certified
    assert 0.9 * rate < check.worst <= rate
    assert plan.duration > planned(name).duration
    states = plan.at(np.linspace(0.0, plan.duration, 3001))
    level = np.degrees(np.linalg.norm(states.body_rates[..., :2], axis=-1))
    assert 0.85 * rate < np.max(level) <= check.worst


@pytest.mark.filterwarnings("ignore::hitchopt.errors.UnitWarning")
def test_infeasible_timed_points_are_refused_with_a_remedy() -> None:
    with pytest.raises(ho.InfeasibleError, match=r"body_rate.*limits\.body_rate_deg"):
        turning("open_chain", 0.5)


def test_the_stretch_of_a_known_turn_is_exact() -> None:
    """A level drone with jerk j turns by j / g: slowed by κ, by j / (g κ³)."""
    coefficients = np.zeros((1, 1, 3, 4))
    coefficients[0, 0, 0, 3] = 30.0 * 0.01**3 / 6.0
    part = PiecewisePolynomial(np.array([0.0, 0.01]), coefficients)
    limited = Requirements(ho.Limits(body_rate=0.5))
    turn = Motion.single(Swarm(1), limited, part, ())
    found = further_stretch(turn)
    assert found == pytest.approx((30.0 / GRAVITY / 0.5) ** (1 / 3), rel=2e-3)
    assert further_stretch(turn, 7.0) == 7.0
    assert further_stretch(Motion.single(Swarm(1), Requirements(), part, ()), 1.5) == 1.5


@pytest.mark.parametrize(("name", "limit"), [("triangle", 1.8), ("swarms/head_on", 1.7)])
def test_a_limit_is_planned_for_by_its_record(
    name: str, limit: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without a line in planners: of rates of thrust, which no clock bounds."""
    formula = WorstOverSpans(Drones, lambda spans: spans.jets.thrust.rate.norm_upper, "max", 0.0)
    evaluators = (Evaluator(formula),)
    rule = CheckRule("thrust_rate", "N/s", "max", limit, evaluators, ease="time", derivative=3)
    without = rule.check(planned(name).motion)
    monkeypatch.setattr(stretch, "SLOWED", (rule,))
    kept = rule.check(ho.solve(PROBLEMS / f"{name}.yaml").motion)
    assert without is not None
    assert kept is not None
    assert kept.holds
    assert not without.holds
    assert kept.worst > 0.95 * limit


def test_limits_that_slower_motion_keeps_are_of_what_decreases_with_it() -> None:
    """By the order of the derivative that each record states, the search of a stretch ends."""
    for rule in RULES:
        if rule.ease == "time":
            assert rule.sense == "max"
            assert rule.derivative >= 1


def test_a_flight_with_the_needed_stretch_just_keeps_its_limit() -> None:
    """Of thrusts' rates jerks are the largest part, or rates of cables' forces if all is slow."""
    motion = planned("triangle").motion
    rest = math.atan(0.4 / (0.132 * 9.81))
    tilt = 0.5 * (rest + math.radians(planned("triangle").certificate["tilt"].worst))
    for name, limit in (("tilt", tilt), ("body_rate", math.radians(1.0))):
        limits = with_fields(motion.requirements.limits, **{name: limit})
        tight = motion.replaced(requirements=replace(motion.requirements, limits=limits))
        stretch = needed_stretch(tight)
        assert stretch > 1.05
        for share, kept in ((1.001, True), (0.98, False)):
            check = RULE_OF[name].check(tight.slowed(share * stretch))
            assert check is not None
            assert check.holds is kept


@pytest.mark.parametrize("index", [3, 10])
def test_a_peak_of_jerk_between_samples_slows_its_piece_alone(index: int) -> None:
    """Flights of both routes would be stretched by 0.8 and 1.1 % for two peaks."""
    pair = irregular_pairs()[index]
    team = Team(pair["n"], pair["cable_length"])
    path = ho.route(Hitch.spread(team, pair["start"], pair["altitude"]), pair["goal"])
    motion = fastest_motion(path, Requirements()).motion
    assert needed_stretch(motion) <= MAX_PEAK ** (1.0 / 3.0) + 5e-4


def any_total(_: float) -> None:
    """Accept every duration."""


def test_parts_take_their_durations_and_do_not_slow_the_others() -> None:
    path = Path.straight(*ends(5, 7, Limits()))
    joints = np.array([0.0, 0.3, 0.75, 1.0])
    requirements = Requirements()
    none = np.zeros(3)
    whole = motion_along(path, requirements)
    free = motion_in_parts(path, requirements, joints, none, any_total)
    assert free.motion.duration == pytest.approx(whole.duration, rel=2e-3)
    flown = np.diff(free.times)
    for durations in ([4.0 * flown[0], 0.0, 0.0], [0.0, 0.0, 3.0], 2.0 * flown, 0.9 * flown):
        least = np.array(durations)
        motion, times = motion_in_parts(path, requirements, joints, least, any_total)
        assert needed_stretch(motion) <= 1.0 + 1e-9
        assert times[-1] == pytest.approx(motion.duration, rel=1e-12)
        np.testing.assert_allclose(motion.vertices.at(times), path.vertices.at(joints), atol=1e-6)
        assert np.all(np.diff(times) >= least * (1.0 - 1e-12))
        is_slow = least > flown
        slow = np.diff(times)[is_slow]
        assert np.all(slow <= least[is_slow] * (1.0 + 10.0 * PACE_TOLERANCE))
        # From a part that is slower, others take up to a stop's ramps longer
        ramps = 2.0 * requirements.limits.acceleration / requirements.limits.jerk
        stops = np.sum(flown[~is_slow]) + np.count_nonzero(is_slow) * ramps
        assert motion.duration <= np.sum(slow) + stops


def test_totals_are_checked_before_a_motion_is_timed() -> None:
    path = Path.straight(*ends(4, 2, Limits()))
    totals = list[float]()
    motion, _ = motion_in_parts(
        path, Requirements(), np.array([0.0, 0.5, 1.0]), np.array([3.0, 0.0]), totals.append
    )
    estimate, bound, duration = totals
    assert duration == motion.duration
    assert estimate == pytest.approx(duration, rel=0.05)
    assert (1.0 - 2.0 * MAX_PACE_GAIN) * duration <= bound <= duration
