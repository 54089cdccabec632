"""How often the optimiser finds a way where the straight one may be shut, and how good it is.

Usage: python -m benchmarks.hard_morphs [--seeds N] [--restarts M] [--robots N …]

Random hard morphs (``hitchopt.mission.random_morph``, seeded): turned by any angle, scaled,
shifted, reshaped. Every success is a certificate. Of those not solved, and of the named hard ones,
M random restarts (turned either way, bent, swollen or shrunk on the way) tell what might be found.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import hitchopt as ho
from benchmarks.environment import print_environment
from hitchopt.geometry import ConvexPolygon
from hitchopt.geometry.outline import Outline
from hitchopt.mission.loading import problem_from_dict
from hitchopt.mission.random_morph import random_morph
from hitchopt.model.motion import Motion, Phase
from hitchopt.planners.flight import Flight, fly
from hitchopt.planners.leg_law import KeptDistances
from hitchopt.planners.optimise.guesses import mean_turn
from hitchopt.planners.optimise.search import (
    ROUNDS,
    Candidate,
    Search,
    candidates,
    end_margin,
    searched,
)
from hitchopt.planners.optimise.way import Way
from hitchopt.planners.path import ShapePath

Array = NDArray[np.float64]

LIMITATIONS = (
    "one machine, one run; 'believed infeasible' means that no restart found a way, no proof; "
    "ends that break a limit at rest are counted apart"
)


@dataclass(frozen=True, eq=False)
class Case:
    """One morph: its ends and what they keep."""

    name: str
    start: ho.Hitch
    end: ho.Hitch
    kept: KeptDistances

    def judge(self, path: ShapePath) -> Flight | None:
        """Return the flight along a path if its certificate holds."""
        flight = fly(path, self.kept.limits)
        motion = Motion(
            self.start.team,
            self.kept.limits,
            self.kept.separation,
            self.kept.arena,
            flight.drones,
            flight.vertices,
            flight.legs,
            flight.tensions,
            (Phase("morph", 0, 0.0, flight.duration),),
        )
        return flight if ho.certify(motion).certified else None

    def rests(self) -> bool:
        """Return whether both ends keep all limits at rest."""
        kept = self.kept
        try:
            for hitch in (self.start, self.end):
                ho.hold(
                    hitch, 1.0, limits=kept.limits, separation=kept.separation, arena=kept.arena
                )
        except ho.InfeasibleError:
            return False
        return True


def random_case(n: int, seed: int) -> Case | None:
    """Return a random hard morph, or None where an end breaks a limit at rest."""
    problem = problem_from_dict(random_morph(n, seed, hard=True))
    (step,) = problem.mission
    if not isinstance(step, ho.Morph) or not isinstance(problem.start, ho.HitchStart):
        raise TypeError("a random morph is one morph")
    kept = KeptDistances(problem.limits, problem.separation, problem.arena)
    case = make_case(
        f"n = {n}, seed {seed}", problem.team, problem.start.polygon, step.polygon, kept
    )
    return case if case.rests() else None


def make_case(name: str, team: ho.Team, first: Outline, last: Outline, kept: KeptDistances) -> Case:
    """Return the morph from a spread hitch to the sharing nearest to it."""
    start = ho.Hitch.spread(team, first, limits=kept.limits, separation=kept.separation)
    end = ho.Hitch.nearest(
        team,
        last,
        1.0,
        start.fractions,
        limits=kept.limits,
        separation=kept.separation,
        arena=kept.arena,
    )
    return Case(name, start, end, kept)


def named_cases() -> list[Case]:
    """Return the hard morphs that every version must plan."""
    free = KeptDistances(ho.Limits(), ho.Separation(), None)
    narrow = KeptDistances(
        ho.Limits(), ho.Separation(), ho.Arena([-1.55, -1.55, 0.0], [1.55, 1.55, 3.0])
    )
    square = ho.regular_polygon(4, 1.2, np.pi / 4)
    pentagon = ConvexPolygon([[0.0, 0.0], [0.1, 1.2], [1.1, 1.9], [2.2, 1.2], [1.6, -0.1]])
    octagon = ho.regular_polygon(8, 1.3)
    four, weak = ho.Team(4, 2.4), ho.Quadrotor(0.132, 1.6)
    thrust_bound = ho.Team(4, 2.4, tension=0.8, quadrotor=weak)
    moved = square.rotated(0.9).translated([0.5, 0.2])
    return [
        make_case("square, quarter turn", four, square, square.renumbered(1), free),
        make_case("square, half turn", four, square, square.renumbered(2), free),
        make_case("octagon, 45°", ho.Team(8, 2.0), octagon, octagon.rotated(np.pi / 4), free),
        make_case("pentagon", ho.Team(5, 2.6), pentagon, pentagon.renumbered(2), free),
        make_case("thrust-bound", thrust_bound, square, moved, free),
        make_case("narrow arena", four, square, square.renumbered(1), narrow),
    ]


def restarted(case: Case, rng: np.random.Generator) -> list[Candidate]:
    """Return what one random first guess comes to."""
    first, last = case.start.polygon, case.end.polygon
    s = np.linspace(0.0, 1.0, 9)
    if not isinstance(first, ConvexPolygon) or not isinstance(last, ConvexPolygon):
        return []
    angle = mean_turn(first, last) + 2.0 * np.pi * rng.choice([-1, 0, 0, 0, 1])
    bump = np.sin(np.pi * s)
    turn = angle * (s + 0.15 * rng.normal() * bump)
    size = 1.0 + 0.25 * rng.normal() * bump
    bow = np.outer(bump, rng.normal(scale=0.4, size=2))
    shape = first.vertices - first.centroid
    goal = last.translated(-last.centroid).rotated(-angle).vertices
    blend = shape + s[:, None, None] * (goal - shape)
    blend = blend + 0.05 * bump[:, None, None] * rng.normal(size=shape.shape)
    c, d = np.cos(turn), np.sin(turn)
    matrices = np.stack([np.stack([c, d], axis=-1), np.stack([-d, c], axis=-1)], axis=-2)
    centres = first.centroid + s[:, None] * (last.centroid - first.centroid) + bow
    polygons = centres[:, None] + size[:, None, None] * (blend @ matrices)
    polygons[0], polygons[-1] = first.vertices, last.vertices
    way = Way.through("restart", case.start, case.end, polygons)
    if np.min(way.slack) <= 0.0:
        return []
    margins = (end_margin(case.start, case.kept), end_margin(case.end, case.kept))
    return searched([way], Search(case.kept, case.judge, None, margins))


def best_of_restarts(case: Case, count: int) -> float:
    """Return the shortest certified duration of random restarts, infinity if there is none [s]."""
    rng = np.random.default_rng(0)
    best = np.inf
    for _ in range(count):
        for candidate in restarted(case, rng):
            best = min(best, candidate.flight.duration)
    return float(best)


def by_default(case: Case) -> tuple[float, float]:
    """Return the certified duration of the default search (infinity if none), and its time [s]."""
    began = time.perf_counter()
    found = candidates(case.start, case.end, case.kept, case.judge)
    duration = found[0].flight.duration if found else np.inf
    return duration, time.perf_counter() - began


def main() -> None:
    """Print the named morphs against their restarts, then the random ones by n."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=20, help="random morphs for every n")
    parser.add_argument("--restarts", type=int, default=50)
    parser.add_argument("--robots", type=int, nargs="*", default=list(range(3, 13)))
    arguments = parser.parse_args()
    print_environment(LIMITATIONS)
    print(f"knots and margins of the rounds: {ROUNDS}; {arguments.restarts} restarts")
    print(f"{'named morph':24s} {'flight [s]':>10s} {'search [s]':>10s} {'best restart [s]':>17s}")
    for case in named_cases():
        duration, seconds = by_default(case)
        best = best_of_restarts(case, arguments.restarts)
        print(f"{case.name:24s} {duration:10.3f} {seconds:10.2f} {best:17.3f}", flush=True)
    counts: Counter[str] = Counter()
    for n in arguments.robots:
        seconds_of: list[float] = []
        row: Counter[str] = Counter()
        for seed in range(arguments.seeds):
            found = random_case(n, seed)
            if found is None:
                row["ends"] += 1
                continue
            duration, seconds = by_default(found)
            seconds_of.append(seconds)
            if np.isfinite(duration):
                row["solved"] += 1
            elif np.isfinite(best_of_restarts(found, arguments.restarts)):
                row["failed"] += 1
                print(f"  {found.name}: a restart solves it")
            else:
                row["believed infeasible"] += 1
                print(f"  {found.name}: no restart solves it")
        counts += row
        median, worst = (float(f(seconds_of)) for f in (np.median, np.max))
        print(
            f"n = {n:2d}: {dict(row)}; search {median:.2f} s median, {worst:.2f} s at most",
            flush=True,
        )
    print(f"all: {dict(counts)}")


if __name__ == "__main__":
    main()
