"""Random stops of the common clock at 1 kHz, and random aborts at 10 kHz.

Usage: python -m benchmarks.stops [--stops N] [--aborts N] [PROBLEM …]

It plans problems of the collection, stops each N times at random, aborts it N times at random in
every way, and prints what the largest value over its limit is. Samples share nothing with the
certificate but the polynomials.
"""

from __future__ import annotations

import argparse
import platform
import time
from pathlib import Path

import numpy as np

import hitchopt as ho
from hitchopt.checks.bounds.clock_stops import StopTable
from hitchopt.errors import InfeasibleError
from hitchopt.stopping.abort import WAYS, Aborts
from hitchopt.stopping.clock_changes import STEADY
from hitchopt.stopping.player import Player
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.trajectory.clock_phases import ClockPhases, advanced
from hitchopt.values import Array

PROBLEMS = Path(__file__).parents[1] / "problems"
USUAL = ("triangle", "move_edge", "hexagon", "tie_carry_untie", "swarms/head_on")
RATE, ABORT_RATE = 1e3, 1e4
"""[Hz]"""

BLOCK = 50
"""Number of stops that are sampled in one go."""


def over(values: Array, limit: float) -> float:
    """Return the largest norm over its limit."""
    return float(np.max(np.linalg.norm(values, axis=-1))) / limit


def sampled(clock: ClockPhases) -> Array:
    """Return plan times and their derivatives (samples, 4) at RATE, and at the clock's end."""
    ends = np.cumsum(clock.duration)
    t = np.append(np.arange(0.0, ends[-1], 1.0 / RATE), ends[-1])
    phase = np.minimum(np.searchsorted(ends, t, side="right"), len(ends) - 1)
    return advanced(clock.jets[phase], t - (ends - clock.duration)[phase])


def derivatives(drones: PiecewisePolynomial, times: Array) -> list[Array]:
    """Return the first three derivatives (samples, drones, 3) at plan times, piece by piece."""
    piece = np.clip(np.searchsorted(drones.breaks, times, side="right") - 1, 0, drones.pieces - 1)
    x = np.clip((times - drones.breaks[piece]) / drones.durations[piece], 0.0, 1.0)
    found = [np.empty((len(times), *drones.shape)) for _ in range(3)]
    for each in np.unique(piece).tolist():
        here = piece == each
        for order, values in enumerate(found, 1):
            c = drones.differentiated(order).coefficients[each]
            weights = bernstein.basis(x[here], c.shape[-1] - 1)
            values[here] = (weights @ c.reshape(-1, c.shape[-1]).T).reshape(-1, *drones.shape)
    return found


def broken(plan: ho.Plan, jets: Array) -> float:
    """Return the largest acceleration or jerk over its limit on a clock with jets (samples, 4)."""
    limits = plan.motion.requirements.limits
    first, second, third = derivatives(plan.motion.drones, jets[:, 0])
    s, a, j = jets[:, 1:, None, None].transpose(1, 0, 2, 3)
    return max(
        over(s**2 * second + a * first, limits.acceleration),
        over(s**3 * third + 3.0 * s * a * second + j * first, limits.jerk),
    )


def stopped(plan: ho.Plan, moments: Array, table: StopTable) -> tuple[float, float]:
    """Return the largest value over its limit in stops at plan times, and the longest stop [s]."""
    worst = longest = 0.0
    for block in np.array_split(moments, -(-len(moments) // BLOCK)):
        clocks = []
        for moment in block.tolist():
            player = Player(plan, moment, stops=table)
            longest = max(longest, player.pause())
            if len(player.ahead):
                clocks.append(sampled(player.ahead))
                if abs(clocks[-1][-1, 1]) > STEADY and clocks[-1][-1, 0] < plan.duration - STEADY:
                    return np.inf, longest
        if clocks:
            worst = max(worst, broken(plan, np.concatenate(clocks)))
    return worst, longest


def flown(plan: ho.Plan, begin: float) -> float:
    """Return the largest value over its limit in a plan from a time on, sampled."""
    limits, team = plan.motion.requirements.limits, plan.motion.team
    worst = 0.0
    for times in np.array_split(
        np.arange(begin, plan.duration, 1.0 / ABORT_RATE), int(plan.duration) + 1
    ):
        states = plan.at(times)
        thrusts = states.thrusts(team)
        level = np.hypot(thrusts[..., 0], thrusts[..., 1])
        worst = max(
            worst,
            over(states.velocities, limits.speed),
            over(states.accelerations, limits.acceleration),
            over(states.jerks, limits.jerk),
            float(np.max(np.linalg.norm(thrusts, axis=-1) / team.max_thrust)),
            float(np.max(np.arctan2(level, thrusts[..., 2]))) / limits.tilt,
        )
    return worst


def measure(stem: str, stops: int, aborts: int) -> str:
    """Return a row of the table."""
    plan = ho.solve(PROBLEMS / f"{stem}.yaml")
    rng = np.random.default_rng(1)
    common = Aborts(plan.motion)
    moments = rng.uniform(0.0, plan.duration, stops)
    worst, longest = stopped(plan, moments, common.player.stops)
    ended, tried, largest = 0, 0, 0.0
    held = 0
    for moment in rng.uniform(0.0, plan.duration, aborts):
        for how in WAYS:
            tried += 1
            try:
                done = common.found(float(moment), how)
            except InfeasibleError:
                continue
            ended += 1
            held += how == "hold"
            whole = ho.Plan(done.certified.motion, done.certified.certificate)
            largest = max(largest, flown(whole, max(done.start - 0.01, 0.0)))
    reported = plan.certificate["stoppable"].bound
    return (
        f"| {stem} | {stops} | {worst:.7f} | {longest:.3f} | {reported:.3f} | {held}/{aborts} | "
        f"{ended}/{tried} | {largest:.7f} |"
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--stops", type=int, default=100)
    parser.add_argument("--aborts", type=int, default=3)
    parser.add_argument("problems", nargs="*", default=USUAL)
    given = parser.parse_args()
    print(f"{platform.machine()}, Python {platform.python_version()}, numpy {np.__version__}\n")
    print(
        "| plan | stops | largest value over its limit | longest stop [s] | stoppable [s] | "
        "holds | aborts | largest value over its limit |"
    )
    print("|---|---|---|---|---|---|---|---|")
    for stem in given.problems:
        begin = time.perf_counter()
        print(
            measure(stem, given.stops, given.aborts),
            f"<!-- {time.perf_counter() - begin:.0f} s -->",
            flush=True,
        )


if __name__ == "__main__":
    main()
