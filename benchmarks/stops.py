"""Random stops of the common clock at 1 kHz, and random aborts at 10 kHz.

Usage: python -m benchmarks.stops [--stops N] [--aborts N] [--rows FILE] [PROBLEM …]

It plans problems of the collection, stops each N times at random, aborts it N times at random in
every way, and prints what the largest value over its limit is. Samples share nothing with the
certificate but the polynomials. An abort that is not found counts where its goal is feasible from
rest: where all but ``continuity`` is certified of a plan that stands still at once, there and then.
Times with the same stop ahead have the same aborts, which are sampled once.
Rows are appended to FILE, and problems that it has already are left out.
"""

from __future__ import annotations

import argparse
import platform
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import hitchopt as ho
from benchmarks.clock_balance import derivatives, unbalanced
from hitchopt.checks import certify
from hitchopt.errors import InfeasibleError
from hitchopt.motion.cutting import rests
from hitchopt.motion.motion import Motion
from hitchopt.motion.retiming import before, followed, resting
from hitchopt.steps.certified_motions import Certified
from hitchopt.stopping.abort import HOLD, WAYS, Aborts, How, Stopped
from hitchopt.stopping.clock_changes import STEADY
from hitchopt.stopping.player import Player
from hitchopt.trajectory.clock_phases import ClockPhases, advanced
from hitchopt.values import Array

PROBLEMS = Path(__file__).parents[1] / "problems"
USUAL = ("triangle", "move_edge", "hexagon", "tie_carry_untie", "swarms/head_on")
RATE, ABORT_RATE = 1e3, 1e4
"""[Hz]"""

OVER = 1e-6
"""Values over their limits by more than this are printed one by one."""

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


def broken(plan: ho.Plan, jets: Array) -> float:
    """Return the largest acceleration, jerk or lack of balance over its limit on a clock.

    Parameters
    ----------
    jets: (samples, 4), of the clock.
    """
    limits = plan.motion.requirements.limits
    first, second, third = derivatives(plan.motion.drones, jets[:, 0])
    s, a, j = jets[:, 1:, None, None].transpose(1, 0, 2, 3)
    return max(
        over(s**2 * second + a * first, limits.acceleration),
        over(s**3 * third + 3.0 * s * a * second + j * first, limits.jerk),
        unbalanced(plan.motion, jets),
    )


def stopped(plan: ho.Plan, moments: Array, first: Player) -> tuple[float, float]:
    """Return the largest value over its limit in stops at plan times, and the longest stop [s]."""
    worst = longest = 0.0
    for block in np.array_split(moments, -(-len(moments) // BLOCK)):
        clocks = []
        for moment in block.tolist():
            player = Player(plan, moment, like=first)
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


def standing(motion: Motion, time: float) -> Motion:
    """Return a plan that stands still at once at a time [s], where its velocity jumps to zero."""
    short = before(motion, time)
    return followed(short, resting(short, HOLD)).untimed


def feasible_from_rest(common: Aborts, time: float, how: str) -> bool:
    """Return whether an abort is found for a plan that stands still at once at a time [s]."""
    try:
        whole = standing(common.motion, time)
        found = common.continuation(Stopped(whole, time, 0.0, time), how)
    except InfeasibleError:
        return False
    return {check.name for check in certify(found).violated} <= {"continuity"}


@dataclass
class Count:
    """How many aborts of a kind were found, and how many others are feasible from rest."""

    found: int = 0
    missed: int = 0

    def __str__(self) -> str:
        return f"{self.found}/{self.found + self.missed}"


class Remembered(Aborts):
    """The aborts of one plan, of which each continuation is looked for once."""

    def __init__(self, motion: Motion) -> None:
        super().__init__(motion)
        self._known: dict[tuple[object, ...], Certified | InfeasibleError] = {}
        self.sampled: dict[Certified, float] = {}
        """Largest value over its limit in the motions that were sampled."""

    def continued(self, stopped: Stopped, how: str, origin: float | None = None) -> Certified:
        """Return the certified continuation of a plan at rest."""
        key = (stopped.start, stopped.seconds, how, origin)
        if key not in self._known:
            try:
                self._known[key] = super().continued(stopped, how, origin)
            except InfeasibleError as error:
                self._known[key] = error
        found = self._known[key]
        if isinstance(found, InfeasibleError):
            raise found
        return found


def groups(common: Aborts, moments: Array) -> list[Array]:
    """Return times (k,) [s] by the first rest that is ahead of them: they have the same aborts."""
    still = common.motion.drones.breaks[rests(common.motion)]
    first = [np.searchsorted(common.stops.starts, moments), np.searchsorted(still, moments)]
    _, which = np.unique(np.stack(first), axis=1, return_inverse=True)
    return [moments[which == each] for each in range(which.max(initial=-1) + 1)]


def aborted(stem: str, common: Remembered, moments: Array, counts: dict[How, Count]) -> float:
    """Return the largest value over its limit in aborts at plan times, which are counted."""
    largest = 0.0
    for times in groups(common, moments):
        for how, count in counts.items():
            try:
                done = common.found(float(times[-1]), how)
            except InfeasibleError as error:
                reason = str(error).splitlines()[0]
                for moment in times.tolist():
                    if how == "hold" or feasible_from_rest(common, moment, how):
                        count.missed += 1
                        print(f"<!-- {stem}: no {how} at {moment:.6f} s: {reason} -->", flush=True)
                continue
            count.found += len(times)
            if done.certified not in common.sampled:
                whole = ho.Plan(done.certified.motion, done.certified.certificate)
                common.sampled[done.certified] = flown(whole, max(done.start - 0.01, 0.0))
            value = common.sampled[done.certified]
            if value > 1.0 + OVER:
                print(f"<!-- {stem}: {how} at {times[-1]:.6f} s has {value:.7f} -->", flush=True)
            largest = max(largest, value)
    return largest


def measure(stem: str, stops: int, aborts: int) -> str:
    """Return a row of the table."""
    plan = ho.solve(PROBLEMS / f"{stem}.yaml")
    rng = np.random.default_rng(1)
    common = Remembered(plan.motion)
    moments = rng.uniform(0.0, plan.duration, stops)
    worst, longest = stopped(plan, moments, common.player)
    counts = {how: Count() for how in WAYS}
    largest = aborted(stem, common, rng.uniform(0.0, plan.duration, aborts), counts)
    reported = plan.certificate["stoppable"].bound
    shown = " | ".join(str(count) for count in counts.values())
    return (
        f"| {stem} | {plan.motion.team.drones} | {stops} | {worst:.7f} | {longest:.3f} | "
        f"{reported:.3f} | {aborts} | {shown} | {largest:.7f} |"
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--stops", type=int, default=100)
    parser.add_argument("--aborts", type=int, default=3)
    parser.add_argument("--rows", type=Path)
    parser.add_argument("problems", nargs="*", default=USUAL)
    given = parser.parse_args()
    print(f"{platform.machine()}, Python {platform.python_version()}, numpy {np.__version__}\n")
    print(
        "| plan | drones | stops | largest value over its limit | longest stop [s] | "
        f"stoppable [s] | abort times | {' | '.join(WAYS)} | largest value over its limit |"
    )
    print("|---" * (8 + len(WAYS)) + "|")
    rows = given.rows.read_text() if given.rows and given.rows.exists() else ""
    for stem in given.problems:
        if f"| {stem} |" in rows:
            continue
        begin = time.process_time()
        row = measure(stem, given.stops, given.aborts)
        print(row, f"<!-- {time.process_time() - begin:.0f} s -->", flush=True)
        if given.rows:
            with given.rows.open("a") as file:
                file.write(f"{row}\n")


if __name__ == "__main__":
    main()
