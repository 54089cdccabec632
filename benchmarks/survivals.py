"""Shares of (drone, time) whose loss has a certified reaction, over whole missions.

Usage: python -m benchmarks.survivals [--robots N …]

Regular hitches are tied from a grid on the ground, carried, untied and landed. Printed are how many
(drone, time) have a reaction, while the hitch is tied and in all of the mission, and what stands
against the others, each reason with one of its numbers.
"""

from __future__ import annotations

import argparse
import platform
import re
import time
from collections import Counter

import numpy as np

import hitchopt as ho
from hitchopt.errors import InfeasibleError
from hitchopt.geometry import regular_polygon
from hitchopt.losing.reaction import Reactions
from hitchopt.losing.survivable import EVERY
from hitchopt.mission.loading import problem_from_dict

ROBOTS = (4, 6, 8, 10, 12)
COLUMNS = {12: 3}
"""Cables side by side on the ground; 2 of other teams."""

PITCH = (1.8, 0.9)
"""[m] Distances of the cables' middles."""

NUMBERS = r"\b[qr]\d+\b|\d+(\.\d+)?(e[-+]?\d+)?%?"
"""Drones and numbers in a reason, which reasons of one kind do not share."""

LENGTH, EDGE, ALTITUDE = 2.3, 1.3, 1.5
"""[m]"""


def mission(n: int) -> ho.Plan:
    """Return the plan of a mission of n robots."""
    columns = COLUMNS.get(n, 2)
    rows = n // columns
    middles = np.array(
        [
            [PITCH[0] * (j - 0.5 * (columns - 1)), PITCH[1] * (0.5 * (rows - 1) - i), 0.0]
            for i in range(rows)
            for j in range(columns)
        ]
    )
    polygon = regular_polygon(n, EDGE).vertices
    drones = {
        "q": (middles - [0.5, 0.0, 0.0]).tolist(),
        "r": (middles + [0.5, 0.0, 0.0]).tolist(),
    }
    problem = problem_from_dict(
        {
            "team": {"robots": n, "cable_length": LENGTH},
            "start": {"drones": drones},
            "mission": [
                {"form": {"polygon": polygon.tolist(), "altitude": ALTITUDE, "legs": "balanced"}},
                {"transport": {"to": [0.8, -0.3, ALTITUDE], "yaw_deg": 20}},
                {"hold": {"seconds": 1.0}},
                {"release": {}},
                {"land": {}},
            ],
        }
    )
    return ho.solve(problem)


def measure(n: int) -> str:
    """Return a row of the table, and what was refused."""
    plan = mission(n)
    motion, reactions = plan.motion, Reactions(plan.motion)
    count = round(motion.duration / EVERY)
    edges = np.linspace(0.0, motion.duration, count + 1)
    t = 0.5 * (edges[1:] + edges[:-1])
    formed = plan.at(t).formed
    covered = np.zeros((count, motion.team.drones), bool)
    reasons: Counter[str] = Counter()
    example: dict[str, str] = {}
    for i, moment in enumerate(t.tolist()):
        for drone, name in enumerate(motion.team.drone_names):
            try:
                reactions.found(name, moment)
                covered[i, drone] = True
            except InfeasibleError as error:
                words = re.sub(NUMBERS, "#", str(error))
                kind = ("tied: " if formed[i] else "not tied: ") + words
                reasons[kind] += 1
                example.setdefault(kind, str(error))
    tied = f"{np.sum(covered[formed])}/{covered[formed].size} | {np.mean(covered[formed]):.0%}"
    whole = f"{np.sum(covered)}/{covered.size} | {np.mean(covered):.0%}"
    lines = [f"| {n} | {motion.duration:.1f} | {tied} | {whole} |"]
    lines += [
        f"<!-- {number} {kind.split(':')[0]}, such as {example[kind]} -->"
        for kind, number in reasons.most_common()
    ]
    return "\n".join(lines)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", type=int, nargs="*", default=ROBOTS)
    given = parser.parse_args()
    print(f"{platform.machine()}, Python {platform.python_version()}, numpy {np.__version__}\n")
    print("| n | mission [s] | tied | share | whole mission | share |\n|---|---|---|---|---|---|")
    for n in given.robots:
        begin = time.perf_counter()
        print(measure(n), f"<!-- {time.perf_counter() - begin:.0f} s -->", flush=True)


if __name__ == "__main__":
    main()
