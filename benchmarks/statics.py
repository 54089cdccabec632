"""Comparison of statics with simulated ropes: predictions of ``ho.equilibrium``, and calibration.

Usage: python -m benchmarks statics [--cases N] [--first S] [--calibrated M]

Random hitches of 3 to 6 robots whose drones hold 1 to 20 N/m and whose ropes weigh 3 to 20 g/m rest
in the accurate preset without friction, their drones shaken by noise so that ropes do not catch.
Then teams are estimated from perturbed flights of 36 s: a triangle stands, moves a vertex by 0.4 m,
stands, and moves it back. Stiffness, friction and cable lengths follow from the seed; positions
are recorded with noise of 1 mm.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np

import hitchopt as ho
from benchmarks.measuring import Array, Table, parser
from hitchopt.lab.flights.recordings import Recording
from hitchopt.lab.simulation.control import Disturbances
from hitchopt.lab.simulation.fleet import CONTROL_PERIOD
from hitchopt.lab.simulation.flight import SETTLE_TIME
from hitchopt.lab.simulation.record import SimulatedFlight
from hitchopt.lab.simulation.report import Simulation
from hitchopt.lab.simulation.ropes import bend_lengths
from hitchopt.lab.simulation.settings import ACCURATE
from problems.random_morph import random_convex_polygon

LIMITATIONS = (
    "simulated ropes of 12 mm in segments of 10 mm, without friction; one flight each; noise of "
    "1 cm; statics are given its mean, and the weight and effective lengths of the ropes"
)

CALIBRATION_LIMITATIONS = (
    "simulated ropes of 12 mm in segments of 10 mm, whose weight is known, and whose length for "
    "the hitch to 2 mm; triangles alone, one flight each, perturbed; ± are the stated standard "
    "errors"
)

ROPE = ACCURATE.diameter, ACCURATE.segment
"""Thickness of simulated ropes and length of their segments [m]."""

PERTURBATIONS = {"noise": 0.01, "lag": 0.01}
REST_TIME = 3.0
"""Averaging time [s]."""


def random_case(seed: int) -> tuple[ho.Plan, float]:
    """Return the first feasible random hitch of a seed, and its drones' stiffness [N/m]."""
    rng = np.random.default_rng(seed)
    n = 3 + seed % 4
    density, stiffness = rng.uniform(0.003, 0.02), float(np.exp(rng.uniform(0.0, np.log(20.0))))
    while True:
        polygon = random_convex_polygon(n, 1.3, rng, 0.15)
        spare, tension = rng.uniform(0.8, 0.95, n), rng.uniform(0.4, 0.6, n)
        lengths = polygon.edge_lengths + spare
        team = ho.Team(n, lengths, tension=tension, cable_density=density)
        try:
            plan = ho.solve(ho.Hitch.spread(team, polygon, 1.8), ho.Hold(2.0 + REST_TIME))
        except ho.InfeasibleError:
            continue
        if plan.certificate.certified:
            return plan, stiffness


def settle_row(seed: int) -> tuple[object, ...]:
    """Return the row of a hitch at rest: errors of tensions [%] and of vertices [mm]."""
    plan, stiffness = random_case(seed)
    team = plan.motion.team
    simulation = ho.simulate(
        plan, preset="accurate", perturbations=dict(PERTURBATIONS), seed=seed, friction=0.0,
        stiffness=stiffness, pull_test=False,
    )  # fmt: skip
    record = simulation.flight.record
    rows = (record.t > plan.duration - REST_TIME) & (record.t <= plan.duration)
    pulls = np.mean(record.tensions[rows], axis=0)
    vertices = np.nanmean(record.vertices[rows], axis=0)
    bends = bend_lengths(simulation.flight.task.teams[0], *ROPE)
    equilibrium = ho.equilibrium(
        plan,
        plan.duration,
        cable_length=effective_lengths(simulation.flight),
        cable_density=simulation.flight.density,
        load=team.load + simulation.flight.density * 2.0 * bends,
        stiffness=stiffness,
        offsets=-mean_noise(simulation),
    )
    tension = float(np.max(np.abs(equilibrium.tensions / pulls - 1.0)))
    away = np.linalg.norm(equilibrium.vertices[team.layout.clasps] - vertices, axis=-1)
    density = float(np.mean(team.cable_density))
    errors = (100.0 * tension, 1e3 * float(np.max(away)), 1e3 * float(np.mean(away)))
    return seed, team.robots, 1e3 * density, stiffness, *errors


def effective_lengths(flight: SimulatedFlight) -> Array:
    """Return effective cable lengths (n,) [m] at rest: legs and edges with their sag."""
    record, layout = flight.record, flight.task.team.layout
    rows = (record.t > flight.task.duration + 1e-5) & (record.t <= flight.rested)
    drones, vertices = np.mean(record.drones[rows], axis=0), np.empty((layout.points, 3))
    vertices[layout.anchors] = drones  # a chain's ends; clasps follow
    vertices[layout.clasps] = np.mean(record.vertices[rows], axis=0)
    corners = drones[0::2], vertices[layout.starts], vertices[layout.ends], drones[1::2]
    chords = np.diff(np.stack(corners, axis=1), axis=1)
    sizes, level = (np.linalg.norm(chords[..., :axes], axis=-1) for axes in (3, 2))
    slack = 9.81 * flight.density / np.mean(record.tensions[rows], axis=0)[:, None]
    return np.asarray(np.sum(sizes + slack**2 * sizes * level**2 / 24.0, axis=-1))


def mean_noise(simulation: Simulation) -> Array:
    """Return the mean error of measured positions (2n, 3) [m] over the averaging time."""
    flight, settings = simulation.flight, simulation.settings
    end, preset = flight.task.duration, settings.preset
    period = preset.time_step * max(1, round(CONTROL_PERIOD / preset.time_step))
    spans = ((-SETTLE_TIME, SETTLE_TIME), (0.0, end))
    t = np.concatenate([begin + period * np.arange(round(T / period)) for begin, T in spans])
    robots = flight.task.team.robots
    noise = Disturbances(settings.perturbations, robots, settings.seed).noise
    errors = np.array([noise.advance(period) for _ in t])
    return np.asarray(np.mean(errors[(t > end - REST_TIME) & (t <= end)], axis=0))


def calibration_row(seed: int) -> tuple[object, ...]:
    """Return the row of a flight's estimates: truth, estimate and stated error."""
    rng = np.random.default_rng(seed)
    stiffness, friction = float(np.exp(rng.uniform(np.log(2.0), np.log(15.0)))), 0.1 * (seed % 4)
    hitch = {"polygon": ho.regular_polygon(3, 1.3).vertices.tolist(), "altitude": 1.0}
    stop: dict[str, Any] = {"hold": {"seconds": 8.0}}
    out, back = (
        {"move_vertex": {"vertex": 0, "by": [0.0, by], "duration": 8.0}} for by in (0.4, -0.4)
    )
    plan = ho.solve(
        ho.problem_from_dict(
            {
                "team": {"robots": 3, "cable_length": 2.4},
                "start": {"hitch": {**hitch, "legs": "balanced"}},
                "mission": [stop, out, stop, back, {"hold": {"seconds": 2.0}}],
            }
        )
    )
    flight = ho.simulate(
        plan, preset="accurate", perturbed=True, seed=seed, friction=friction,
        stiffness=stiffness, pull_test=False,
    ).flight  # fmt: skip
    record = flight.record
    rows = record.t <= np.fmax(flight.task.duration, flight.rested) + 1e-9
    drones, vertices = (
        places[rows] + 1e-3 * rng.normal(size=places[rows].shape)
        for places in (record.drones, record.vertices)
    )
    noisy = Recording(record.t[rows], drones, vertices)
    with tempfile.TemporaryDirectory() as place:
        estimate = ho.calibrate(
            noisy, plan.save(Path(place) / "plan"), density=float(flight.density)
        )
    lengths = effective_lengths(flight)
    off = np.array([one.value for one in estimate.lengths]) - lengths
    worst, (k, mu) = int(np.argmax(np.abs(off))), (estimate.stiffness[0], estimate.friction)
    length = f"{1e3 * off[worst]:+.1f} ± {1e3 * estimate.lengths[worst].error:.1f}"
    estimates = f"{k.value:.2f} ± {k.error:.2f}", f"{mu.value:.3f} ± {mu.error:.3f}"
    return seed, length, stiffness, estimates[0], friction, estimates[1]


def main() -> None:
    """Print and write both tables."""
    options = parser(__doc__, cases=8, first=0, calibrated=2).parse_args()
    seeds = range(options.first, options.first + options.cases)
    if seeds:
        table = Table(options.output / "statics.md", "Statics", LIMITATIONS, ("mujoco",))
        columns = ("tension off by [%]", "vertex off by [mm]", "mean [mm]")
        table.section("Hitches at rest", "seed", "n", "g/m", "k [N/m]", *columns)
        rows = [settle_row(seed) for seed in seeds]
        for row in rows:
            table.row(*row)
        good = sum(row[4] <= 10.0 and row[5] <= 10.0 for row in rows)  # type: ignore[operator]
        table.note(f"within 10 % of tension and 1 cm: {good} of {len(rows)}")
    title = "Calibration from simulated flights"
    table = Table(options.output / "calibration.md", title, CALIBRATION_LIMITATIONS, ("mujoco",))
    lengths = "worst length off by [mm]"
    table.section("", "seed", lengths, "k [N/m]", "estimated", "μ", "estimated")
    for seed in range(options.first, options.first + options.calibrated):
        table.row(*calibration_row(seed))
