"""``stoppable``: clocks that keep all limits, and how long it takes to stop on them."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import hitchopt as ho
from hitchopt.checks import certify
from hitchopt.checks.drones import largest_at_rest, used_thrust
from hitchopt.checks.drones import tilt as tilt_of
from hitchopt.checks.stops import ClockLimits, DronesOnClock, StopTable, stop_phases, stop_table
from hitchopt.motion.motion import Motion
from hitchopt.motion.retiming import before
from hitchopt.motion.states import states_at
from hitchopt.trajectory import bernstein
from hitchopt.trajectory.clock_phases import ClockPhases, advanced

SQUARE = np.array([[-0.7, -0.7], [-0.7, 0.7], [0.7, 0.7], [0.7, -0.7]]) + [2.0, -1.0]


@cache
def motion_of(reserve: float = 1.0) -> Motion:
    """A square off the origin with unequal cables and drones, reshaped and carried."""
    kinds = [ho.Quadrotor(0.132 + 0.01 * k, 2.6 + 0.3 * k) for k in range(4)]
    team = ho.Team(4, [2.4, 2.5, 2.6, 2.45], quadrotor=kinds)
    start = ho.Hitch.spread(team, SQUARE)
    limits = ho.Limits(reserve=reserve)
    steps = (
        ho.MoveVertex(0, by=np.array([0.2, 0.3])),
        ho.Transport(np.array([2.5, -0.6, 1.3]), 0.4),
    )
    return ho.solve(ho.Problem(team, start, steps, limits)).motion


def flown(motion: Motion, clock: ClockPhases, count: int = 200) -> dict[str, float]:
    """The largest acceleration, jerk, thrust and tilt over their limits, sampled on a clock.

    And the largest turning rate of a thrust [rad/s].
    """
    limits, mass = motion.requirements.limits, motion.team.mass[:, None]
    jets = np.concatenate(
        [
            advanced(jet, np.linspace(0.0, duration, count))
            for jet, duration in zip(clock.jets, clock.duration, strict=True)
        ]
    )
    jets = jets[(jets[:, 0] >= 0.0) & (jets[:, 0] < motion.drones.breaks[-1])]
    s, a, j = (jets[:, k, None, None] for k in (1, 2, 3))
    states = states_at(motion, jets[:, 0])
    d1, d2, d3 = states.velocities, states.accelerations, states.jerks
    acceleration = s**2 * d2 + a * d1
    jerk = s**3 * d3 + 3.0 * s * a * d2 + j * d1
    thrust = mass * (acceleration + [0.0, 0.0, 9.81]) - states.cable_forces
    rate = mass * jerk - s * states.cable_force_rates
    size, level = np.linalg.norm(thrust, axis=-1), np.hypot(thrust[..., 0], thrust[..., 1])
    found = {
        "acceleration": np.linalg.norm(acceleration, axis=-1) / limits.acceleration,
        "jerk": np.linalg.norm(jerk, axis=-1) / limits.jerk,
        "thrust": size / motion.team.max_thrust,
        "tilt": np.arctan2(level, thrust[..., 2]) / limits.tilt,
        "turning": np.linalg.norm(np.cross(thrust, rate), axis=-1) / size**2,
    }
    return {name: float(np.max(values, initial=0.0)) for name, values in found.items()}


def kept_of(shares: dict[str, float]) -> float:
    """The largest share of a limit."""
    return max(share for name, share in shares.items() if name != "turning")


@cache
def table_of(reserve: float = 1.0) -> StopTable:
    return stop_table(motion_of(reserve))


@settings(max_examples=10, deadline=None)
@given(
    start=st.floats(0.0, 1.0),
    duration=st.floats(0.1, 2.5),
    tight=st.floats(0.2, 1.0),
    back=st.booleans(),
)
def test_what_samples_break_is_never_certified(
    start: float, duration: float, tight: float, back: bool
) -> None:
    """With all limits tightened: also thrust and tilt decide then; of clocks that run back too."""
    motion = motion_of()
    limits = replace(motion.requirements.limits, tilt=tight * motion.requirements.limits.tilt)
    motion = replace(motion, requirements=replace(motion.requirements, limits=limits))
    clock = stop_phases(np.array([start * motion.duration]), np.array([duration]))
    if back:
        jets = -clock.jets
        jets[:, 0] += 2.0 * start * motion.duration
        clock = ClockPhases(clock.owner, jets, clock.duration)
    worst = kept_of(flown(motion, clock))
    kept = bool(ClockLimits(motion).keep(clock, 1)[0])
    assert not (kept and worst > 1.0 + 1e-9)
    if not kept:
        assert worst > 0.98  # a bound is refused only where it is nearly reached


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_accelerations_on_a_clock_lie_in_what_encloses_them(sign: float) -> None:
    """Of a clock that runs on, and of one that runs back, all along a cell."""
    motion = motion_of()
    begin, end = motion.drones.breaks[2:4]
    middle, span = 0.5 * (begin + end), 0.3 * (end - begin)
    cell = ClockPhases(
        np.zeros(1, int), np.array([[middle, sign, -0.5 * sign, 0.2]]), np.array([span])
    )
    spans = DronesOnClock.passed(motion, motion.drones.breaks, cell, np.array([2]), np.array([0]))
    found = spans.moved(2)
    radius = float(np.asarray(found.r)[0])
    assert radius < 0.2 * float(np.max(np.abs(found.c)))
    ends = np.sort([cell.jets[0, 0], cell.ends[0, 0]])
    for t in np.linspace(0.0, span, 11):
        place, s, slope, _ = advanced(cell.jets, t)[0]
        here = states_at(motion, np.array([place]))
        exact = s**2 * here.accelerations[0, 0] + slope * here.velocities[0, 0]
        x = (place - ends[0]) / np.ptp(ends)
        assert np.linalg.norm(bernstein.evaluate(found.c[0], x) - exact) <= radius


@pytest.mark.slow
@pytest.mark.parametrize("name", ["acceleration", "jerk", "thrust", "tilt", "turning"])
def test_a_limit_just_below_its_largest_sample_is_refused(name: str) -> None:
    """Each quantity by itself, the others being free; one a twentieth higher is kept."""
    motion, rng = motion_of(), np.random.default_rng(8)
    starts = rng.uniform(0.0, 0.9 * motion.duration, 10)
    durations = np.geomspace(0.2, 2.0, 10)[rng.permutation(10)]
    for start, duration in zip(starts, durations, strict=True):
        clock = stop_phases(np.array([start]), np.array([duration]))
        share = flown(motion, clock, 4000)[name]
        for factor, kept in ((share * (1.0 - 1e-8), False), (share * 1.05, True)):
            found = ClockLimits(freed(motion, name, factor)).keep(clock, 1)
            assert bool(found[0]) == kept


def freed(motion: Motion, name: str, factor: float) -> Motion:
    """A motion with one limit multiplied by a factor, and others that nothing reaches."""
    limits, team = motion.requirements.limits, motion.team
    factors = {"acceleration": 50.0, "jerk": 50.0, "thrust": 3.0, "tilt": 3.0, name: factor}
    limits = replace(
        limits,
        acceleration=factors["acceleration"] * limits.acceleration,
        jerk=factors["jerk"] * limits.jerk,
        tilt=min(factors["tilt"] * limits.tilt, 1.5),
        body_rate=factor if name == "turning" else None,
    )
    kinds = tuple(replace(q, max_thrust=factors["thrust"] * q.max_thrust) for q in team.quadrotor)
    requirements = replace(motion.requirements, limits=limits)
    return replace(motion, team=replace(team, quadrotor=kinds), requirements=requirements)


def test_stops_of_the_table_keep_all_limits() -> None:
    table = table_of()
    found = np.isfinite(table.durations)
    assert np.sum(found) > 10
    for start, duration in zip(table.starts[found], table.durations[found], strict=True):
        clock = stop_phases(np.array([start]), np.array([duration]))
        assert clock.ends[-1, 1] == pytest.approx(0.0, abs=1e-12)
        assert clock.ends[-1, 0] == pytest.approx(start + 0.5 * duration)
        assert kept_of(flown(motion_of(), clock)) <= 1.0 + 1e-9


def test_with_a_reserve_a_stop_can_begin_at_every_time() -> None:
    motion = motion_of(0.8)
    certificate = certify(motion)
    assert certificate.certified
    assert certificate["acceleration"].limit == pytest.approx(0.8 * 2.0)
    assert certificate["jerk"].limit == pytest.approx(0.8 * 20.0)
    for reserve, everywhere in ((0.8, True), (1.0, False)):
        starts = table_of(reserve).starts
        clocks = stop_phases(starts, np.full(len(starts), 1.0))
        kept = ClockLimits(motion_of(reserve)).keep(clocks, len(starts))
        assert np.all(kept) == everywhere
    assert motion.duration > motion_of().duration
    assert certificate["stoppable"].bound < certify(motion_of())["stoppable"].bound


def test_hovering_is_bounded_for_all_times() -> None:
    motion = motion_of()
    states = states_at(motion, np.linspace(0.0, motion.duration, 3000))
    static = motion.team.mass[:, None] * np.array([0.0, 0.0, 9.81]) - states.cable_forces
    thrust = np.max(np.linalg.norm(static, axis=-1) / motion.team.max_thrust)
    level = np.hypot(static[..., 0], static[..., 1])
    tilt = np.degrees(np.max(np.arctan2(level, static[..., 2])))
    assert thrust <= largest_at_rest(motion, used_thrust) <= 1.001 * thrust
    assert tilt <= largest_at_rest(motion, tilt_of) <= 1.001 * tilt


def test_a_plan_that_does_not_end_at_rest_says_so() -> None:
    motion = motion_of()
    cut = before(motion, 0.5 * motion.phases[0].end)
    assert np.max(np.abs(cut.drones.at(cut.duration, 1))) > 0.1
    assert np.isinf(np.max(stop_table(cut).longest[0]))
