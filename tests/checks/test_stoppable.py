"""``stoppable``: clocks that keep all limits, and how long it takes to stop on them."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import hitchopt as ho
from hitchopt.checks import certify, stops
from hitchopt.checks.drones import LIMITS, Drones
from hitchopt.checks.registry import RULES
from hitchopt.checks.rule import CheckRule, Evaluator, WorstOverSpans
from hitchopt.checks.stops import ClockLimits, stop_table
from hitchopt.cli import main
from hitchopt.motion.motion import Motion
from hitchopt.motion.plan_file import write_plan
from hitchopt.motion.retiming import truncated
from hitchopt.motion.states import states_at
from hitchopt.steps.moving import MoveVertex, Transport
from hitchopt.trajectory.clock_phases import ClockPhases, advance
from tests.helpers.motions import replaced

SQUARE = np.array([[-0.7, -0.7], [-0.7, 0.7], [0.7, 0.7], [0.7, -0.7]]) + [2.0, -1.0]


@cache
def motion_of(reserve: float = 1.0) -> Motion:
    """Return a square off the origin with unequal cables and drones, reshaped and carried."""
    kinds = [ho.Quadrotor(0.132 + 0.01 * k, 2.6 + 0.3 * k) for k in range(4)]
    team = ho.Team(4, [2.4, 2.5, 2.6, 2.45], quadrotor=kinds)
    start = ho.Hitch.spread(team, SQUARE)
    steps = (
        MoveVertex(0, by=np.array([0.2, 0.3])),
        Transport(np.array([2.5, -0.6, 1.3]), 0.4),
    )
    return ho.solve(ho.Problem(team, start, steps, ho.Limits(reserve=reserve))).motion


def stop(start: float, duration: float, sense: float = 1.0) -> ClockPhases:
    """Return a clock from the plan's rate to rest, or back, with two phases of jerk 4/T²."""
    half, jerk = 0.5 * duration, 4.0 / duration**2
    first = sense * np.array([0.0, 1.0, 0.0, -jerk]) + [start, 0.0, 0.0, 0.0]
    second = advance(first, half)
    second[3] = sense * jerk
    return ClockPhases(np.zeros(2, dtype=np.intp), np.stack([first, second]), np.full(2, half))


def flown(motion: Motion, clock: ClockPhases, count: int = 200) -> dict[str, float]:
    """The largest acceleration, jerk, thrust and tilt over their limits, sampled on a clock.

    And the largest turning rate of a thrust [rad/s], and rate of one [N/s].
    """
    limits, mass = motion.requirements.limits, motion.team.mass[:, None]
    steps = [np.linspace(0.0, duration, count) for duration in clock.duration]
    jets = np.concatenate([advance(*each) for each in zip(clock.jets, steps, strict=True)])
    jets = jets[(jets[:, 0] >= 0.0) & (jets[:, 0] < motion.drones.breaks[-1])]
    s, a, j = (jets[:, k, None, None] for k in (1, 2, 3))
    states = states_at(motion, jets[:, 0])
    d1, d2, d3 = states.velocities, states.accelerations, states.jerks
    acceleration = s**2 * d2 + a * d1
    jerk = s**3 * d3 + 3.0 * s * a * d2 + j * d1
    thrust = mass * (acceleration + [0.0, 0.0, 9.81]) - states.cable_forces
    rate = mass * jerk - s * states.cable_force_rates
    size, level = np.linalg.norm(thrust, axis=-1), np.linalg.norm(thrust[..., :2], axis=-1)
    result = {
        "acceleration": np.linalg.norm(acceleration, axis=-1) / limits.acceleration,
        "jerk": np.linalg.norm(jerk, axis=-1) / limits.jerk,
        "thrust": size / motion.team.max_thrust,
        "tilt": np.arctan2(level, thrust[..., 2]) / limits.tilt,
        "turning": np.linalg.norm(np.cross(thrust, rate), axis=-1) / size**2,
        "rate": np.linalg.norm(rate, axis=-1),
    }
    return {name: float(np.max(values, initial=0.0)) for name, values in result.items()}


def freed(motion: Motion, name: str, factor: float) -> Motion:
    """A motion with one limit multiplied by a factor, and others that nothing reaches."""
    limits, team = motion.requirements.limits, motion.team
    factors = {"acceleration": 50.0, "jerk": 50.0, "thrust": 3.0, "tilt": 3.0, name: factor}
    kinds = tuple(replace(q, max_thrust=factors["thrust"] * q.max_thrust) for q in team.quadrotor)
    return replaced(
        replace(motion, team=replace(team, quadrotor=kinds)),
        acceleration=factors["acceleration"] * limits.acceleration,
        jerk=factors["jerk"] * limits.jerk,
        tilt=min(factors["tilt"] * limits.tilt, 1.5),
        body_rate=factor if name == "turning" else None,
    )


@cache
def clocks(sense: float) -> list[tuple[ClockPhases, dict[str, float]]]:
    """Return stops, or starts, of several durations, and what is flown on them."""
    motion, rng = motion_of(), np.random.default_rng(8)
    starts = (rng.uniform(0.1, 0.9, 4) * motion.duration).tolist()
    spans = zip(starts, (0.9, 0.2, 2.0, 0.45), strict=True)
    each = [stop(start, duration, sense) for start, duration in spans]
    return [(clock, flown(motion, clock, 4000)) for clock in each]


@pytest.mark.parametrize(
    ("name", "sense"),
    [
        *((name, 1.0) for name in ("acceleration", "jerk", "thrust", "tilt", "turning")),
        *((name, -1.0) for name in ("acceleration", "jerk", "turning")),
    ],
)
def test_a_limit_just_below_its_largest_sample_is_refused(name: str, sense: float) -> None:
    """Each quantity by itself, the others being free; one a twentieth higher is kept."""
    motion = motion_of()
    for clock, shares in clocks(sense):
        share = shares[name]
        for factor, requirements in ((share * (1.0 - 1e-8), False), (share * 1.05, True)):
            result = ClockLimits(ho.Flight.of(freed(motion, name, factor))).keep(clock, 1)
            assert bool(result[0]) == requirements


def rate_of_thrust(limit: float) -> CheckRule:
    """Return the record of a limit that only its formula knows [N/s]."""
    formula = WorstOverSpans(Drones, lambda spans: spans.jets.thrust.rate.norm_upper, "max", 0.0)
    return CheckRule("rate", "N/s", "max", limit, (Evaluator(formula),), derivative=3)


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_a_clock_keeps_a_limit_by_its_record(sense: float, monkeypatch: pytest.MonkeyPatch) -> None:
    free = freed(motion_of(), "rate", 1.0)
    for clock, largest in clocks(sense):
        for factor, is_kept in ((1.0 - 1e-8, False), (1.05, True)):
            monkeypatch.setattr(stops, "OTHERS", (rate_of_thrust(factor * largest["rate"]),))
            assert bool(ClockLimits(ho.Flight.of(free)).keep(clock, 1)[0]) is is_kept


def test_what_clocks_may_break_is_a_limit_of_drones() -> None:
    """Limits of other bodies would need their spans on clocks."""
    for rule in RULES:
        formulas = [each.evaluate for each in rule.evaluators]
        if rule.derivative >= 2:
            assert rule in LIMITS
            assert all(x.spans is Drones for x in formulas if isinstance(x, WorstOverSpans))


def test_stops_of_the_table_keep_all_limits_and_the_report_is_the_longest_wait() -> None:
    motion = motion_of()
    table = stop_table(ho.Flight.of(motion))
    result = np.isfinite(table.durations)
    assert np.sum(result) > 10
    for start, duration in zip(table.starts[result], table.durations[result], strict=True):
        clock = stop(start, duration)
        np.testing.assert_allclose(clock.ends[-1, :2], [start + 0.5 * duration, 0.0], atol=1e-12)
        shares = flown(motion, clock)
        del shares["turning"], shares["rate"]  # which have no limits
        assert max(shares.values()) <= 1.0 + 1e-9
    waits = []
    for time in np.linspace(0.0, motion.duration, 500)[:-1].tolist():
        start, duration = table.after(time)
        assert start >= time
        waits.append(start + duration - time)
    longest = certify(motion)["stoppable"].worst
    assert 0.9 * longest <= max(waits) <= longest + 1e-9


@pytest.mark.parametrize(("reserve", "everywhere"), [(0.8, True), (1.0, False)])
def test_with_a_reserve_a_stop_can_begin_at_every_time(reserve: float, everywhere: bool) -> None:
    motion, usual = motion_of(reserve), motion_of()
    certificate, limits = certify(motion), ClockLimits(ho.Flight.of(motion))
    assert certificate.certified
    assert certificate["acceleration"].limit == pytest.approx(reserve * 2.0)
    assert certificate["jerk"].limit == pytest.approx(reserve * 20.0)
    starts = np.linspace(0.0, motion.duration, 60)[:-1].tolist()
    assert all(limits.keep(stop(start, 1.0), 1)[0] for start in starts) is everywhere
    assert (motion.duration > usual.duration) is everywhere
    shorter = certificate["stoppable"].worst < certify(usual)["stoppable"].worst
    assert shorter is everywhere


def test_largest_values_at_rest_hold_for_all_times(tmp_path: Path) -> None:
    """The command abort says what it takes at most."""
    motion = motion_of()
    write_plan(tmp_path / "plan.npz", ho.Flight.of(motion))
    output = CliRunner().invoke(main, ["abort", str(tmp_path)]).output
    result = re.search(
        r"up to ([\d.]+)%\sof\sa\sdrone's\sthrust\sand\sa\stilt\sof\s([\d.]+)°", output
    )
    assert result
    forces = states_at(motion, np.linspace(0.0, motion.duration, 3000)).cable_forces
    static = motion.team.mass[:, None] * np.array([0.0, 0.0, 9.81]) - forces
    thrust = 100.0 * np.max(np.linalg.norm(static, axis=-1) / motion.team.max_thrust)
    level = np.linalg.norm(static[..., :2], axis=-1)
    tilt = np.degrees(np.max(np.arctan2(level, static[..., 2])))
    assert float(result[1]) == pytest.approx(thrust, abs=0.06 + 1e-3 * thrust)
    assert float(result[2]) == pytest.approx(tilt, abs=0.006 + 1e-3 * tilt)


def test_plans_that_do_not_end_at_rest_are_reported() -> None:
    motion = motion_of()
    cut = truncated(motion, 0.5 * motion.phases[0].end)
    assert np.max(np.abs(cut.drones.at(cut.duration, 1))) > 0.1
    assert certify(cut)["stoppable"].worst > 1e9
