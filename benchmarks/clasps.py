"""Comparison of cables that slide through clasps with ropes of short links, after settled morphs.

Usage: python -m benchmarks clasps [--cases N] [--first S] [--link METRES]

Random hitches of three or four robots, whose cables are short for the ropes' sake, are morphed and
settled against friction. Ideal drones fly each plan with either model in calm air, from the same
hitch at rest without friction. There thick ropes of four robots are up to 1 cm off already; their
vertices are compared over the last second of rest, as they are and relative to this start.
"""

from __future__ import annotations

import numpy as np

import hitchopt as ho
from benchmarks.measuring import Array, Table, parser
from hitchopt.lab.simulation.report import Simulation
from hitchopt.lab.simulation.rests import Rest
from hitchopt.lab.simulation.settings import ACCURATE, CLASPS, Preset, Settings
from hitchopt.lab.simulation.task import Task
from problems.random_morph import random_convex_polygon

LIMITATIONS = (
    "ropes of 12 mm, as heavy as the cables; ideal drones in calm air, which hold 36/s² times "
    "their masses; one flight each"
)

EDGE, JITTER = 0.75, 0.15
"""Mean length of an edge [m], and jitter of the vertices."""

SPARE, MOVED, CHANGED = (0.62, 0.75), (0.08, 0.18), 0.03
"""Lengths [m] of cables beyond their longest edges, of the way of one vertex, and of the others'
along each axis."""

FRICTION = 0.05, 0.1

DENSITY, TENSION = (0.008, 0.01), (0.4, 0.5)
"""[kg/m], [N]. Lighter cables need shorter time steps."""

START = 5
"""Samples at the start, before the hitch moves."""

WITHIN = 0.01
"""[m] Distance of vertices at which both models agree."""


def settled_morph(seed: int) -> ho.Plan:
    """Return the first feasible morph of a seed, which settles."""
    rng = np.random.default_rng(seed)
    n = 3 + seed % 2
    while True:
        first = random_convex_polygon(n, EDGE, rng, JITTER)
        second = first.vertices + rng.uniform(-CHANGED, CHANGED, (n, 2))
        angle = rng.uniform(0.0, 2.0 * np.pi)
        second[0] += rng.uniform(*MOVED) * np.array([np.cos(angle), np.sin(angle)])
        longest = np.maximum(first.edge_lengths, ho.ConvexPolygon(second).edge_lengths)
        team = ho.Team(
            n,
            longest + rng.uniform(*SPARE, n),
            tension=float(rng.uniform(*TENSION)),
            cable_density=float(rng.uniform(*DENSITY)),
            cable_friction=float(rng.choice(FRICTION)),
        )
        start = ho.HitchStart(first.vertices.tolist(), 1.5)
        try:
            return ho.solve(start, ho.Morph(second.tolist()), team=team)
        except (ho.InfeasibleError, ho.InputError):
            continue


def last_rest(task: Task, settings: Settings) -> tuple[Array, Rest]:
    """Return the vertices (2, clasps, 3) [m] at a flight's last rest, and relative to its start."""
    simulation = Simulation.of(task, settings)
    record, rest = simulation.flight.record, simulation.rests[-1]
    rows = (record.t > rest.start) & (record.t <= rest.end)
    vertices = np.nanmean(record.vertices[rows], axis=0)
    return np.stack([vertices, vertices - np.nanmean(record.vertices[:START], axis=0)]), rest


def row(seed: int, link: float) -> tuple[object, ...]:
    """Return the row of a morph: errors of vertices with both models, and their distances [cm]."""
    plan = settled_morph(seed)
    team, task = plan.motion.team, Task.of(plan.flight)
    step = ACCURATE.time_step * link / ACCURATE.segment
    ropes = Settings(preset=Preset("short", link, ACCURATE.diameter, step), pull_test=False)
    (first, sliding), (second, roped) = (
        last_rest(task, settings) for settings in (Settings(cables=CLASPS), ropes)
    )
    away = np.linalg.norm(first - second, axis=-1)
    columns = [[vertex.mean for vertex in rest.vertices.values()] for rest in (sliding, roped)]
    texts = (" ".join(f"{100.0 * x:.1f}" for x in values) for values in (*columns, *away))
    within = np.sum(away <= WITHIN, axis=1).tolist()
    return seed, team.robots, team.friction, plan.duration, *texts, *within


def main() -> None:
    """Print and write the table."""
    options = parser(__doc__, cases=8, first=0, link=0.005).parse_args()
    table = Table(options.output / "clasps.md", "Clasps", LIMITATIONS, ("mujoco",))
    title = f"Settled morphs, links of {1e3 * options.link:g} mm"
    columns = "clasps: off by [cm]", "ropes: off by [cm]", "apart by [cm]", "since the start [cm]"
    within = "within 1 cm", "since the start"
    table.section(title, "seed", "n", "μ", "plan [s]", *columns, *within)
    seeds = range(options.first, options.first + options.cases)
    agreeing = np.zeros(2, dtype=np.intp)
    for seed in seeds:
        cells = row(seed, options.link)
        agreeing += np.array(cells[-2:]) == cells[1]
        table.row(*cells)
    whole, since = agreeing.tolist()
    table.note(f"all vertices within 1 cm: {whole} of {len(seeds)}; since the start: {since}")
