"""Hitches at rest as statics predicts them against settled ropes.

Usage: python -m benchmarks.settling [--cases N] [--slack N] [--formed N ...] [--processes P]
                                     [--output FILE]

Random hitches of 3 to 12 robots, ropes of 3 to 20 g/m and drones of 1 to 20 N/m, cables up to 1 cm
and set points up to 2 cm off, flown at rest; then, with ``--formed``, regular hitches tied in the
air; then hitches whose set points are all far too near to each other, so that ropes may hang slack.
Mean tensions and vertices are compared with those that ``settle`` says for the plan, the density,
the stiffness, the offsets and the effective lengths of the simulated ropes. Ropes are those of the
accurate preset, since segments longer than the ropes are thick catch on each other by centimetres,
and drones measure their places with noise, which shakes them loose: it displaces drones as errors
of their set points would, and statics are told of its mean. Ropes are longer than the cables whose
effective length they have: what their bends use up hangs at the clasps as a load.
"""

from __future__ import annotations

import argparse
import datetime
import tempfile
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

import hitchopt as ho
from benchmarks.environment import busy, environment
from benchmarks.flight_plans import tied
from hitchopt.geometry.vectors import unit
from hitchopt.hitch import GRAVITY
from hitchopt.hitch.statics import contact_forces
from hitchopt.motion.motion import Motion
from hitchopt.settling.cable_tension import SAG_RATIO
from hitchopt.settling.conditions import Conditions
from hitchopt.settling.settle import settle_motion
from hitchopt.simulation.disturbances import Disturbances
from hitchopt.simulation.error_measures import effective_lengths
from hitchopt.simulation.flight_records import Flight
from hitchopt.simulation.flight_task import Task, read_task
from hitchopt.simulation.rope_flight import CONTROL, REST, fly
from hitchopt.simulation.rope_flight import SETTLE as SETTLE_ROPES
from hitchopt.simulation.rope_thickness import bend_lengths
from hitchopt.simulation.simulation_settings import ACCURATE, Perturbations, Settings
from hitchopt.values import Array
from problems.random_morph import random_convex_polygon

LIMITATIONS = (
    "simulated ropes of 12 mm in segments of 10 mm, without friction; point masses; one flight "
    "each; noise of 1 cm, whose mean statics are told; means over 4 s; statics are told of the "
    "ropes' thickness by drones that stand up to 12 mm aside, as planned bends do, and by the "
    "weight of what rope the bends use up"
)

EDGE, JITTER = 1.3, 0.15
"""Mean edge [m] and jitter of the random polygons."""

SETTLE, MEASURE = 2.0, 3.0
"""[s] Time at rest before means are taken, and of the means; after it the flight rests 1 s more."""

CABLE, PLACE = 0.01, 0.02
"""[m] Largest errors of cables and of set points."""

INWARD = (0.3, 0.6)
"""[m] By how much drones are nearer to their vertices than planned where slack is looked for."""

TENSION, VERTEX = 0.1, 0.01
"""Errors that are wanted: of tensions (relative), of vertices [m]."""

SHAKEN = Perturbations(noise=0.01, lag=0.01)
"""What moves the drones; the thrust's lag, with which stiff drones are stable, has no part in
means."""


@dataclass(frozen=True)
class Compared:
    """One flight against statics.

    Attributes
    ----------
    row: of the table.
    tension: largest relative error of a tension; nan where ropes are slack.
    vertex: largest error of a vertex [m].
    slack: whether any rope is slack, that is pulls so little that a level span as long as its
        longest one hangs by a quarter of it, or any clasp bears less than 30 % of the plan's force.
    predicted: whether statics say so.
    flown: whether the simulation was valid to its end; else the flight counts for nothing.
    """

    row: str
    tension: float
    vertex: float
    slack: bool
    predicted: bool
    flown: bool

    @property
    def good(self) -> bool:
        """Whether both errors are as small as wanted."""
        return self.tension <= TENSION and self.vertex <= VERTEX


def random_case(seed: int) -> tuple[ho.Plan, float]:
    """Return the first random hitch of a seed that can stand, and its drones' stiffness [N/m]."""
    rng = np.random.default_rng(seed)
    n = 3 + seed % 10
    density, stiffness = rng.uniform(0.003, 0.02), float(np.exp(rng.uniform(0.0, np.log(20.0))))
    while True:
        polygon = random_convex_polygon(n, EDGE, rng, JITTER)
        lengths, tensions = rng.uniform(0.8, 0.95, n), rng.uniform(0.4, 0.6, n)
        team = ho.Team(n, polygon.edge_lengths + lengths, tension=tensions, cable_density=density)
        try:
            plan = ho.hold(ho.Hitch.spread(team, polygon, 1.8), SETTLE + MEASURE)
            plan.certificate.raise_if_violated()
        except (ho.InfeasibleError, ho.CertificateError):
            continue
        return plan, stiffness


def flown(seed: int, *, loose: bool) -> Compared:
    """Return how a random hitch with errors compares.

    Parameters
    ----------
    loose: whether all of its drones are far too near to their vertices.
    """
    plan, stiffness = random_case(seed)
    rng = np.random.default_rng(1000 + seed)
    team = plan.motion.team
    offsets = rng.uniform(-PLACE, PLACE, (team.drones, 3)) / np.sqrt(3.0)
    lengths = team.cable_length + rng.uniform(-CABLE, CABLE, team.robots)
    if loose:
        states = plan.at(0.0)
        legs = states.positions - states.vertices[team.layout.anchors]
        offsets -= rng.uniform(*INWARD, (team.drones, 1)) * unit(legs)
    task = saved(plan)
    setpoints = replace(task.setpoints, positions=task.setpoints.positions + offsets)
    real = replace(task, team=replace(task.team, cable_length=lengths), setpoints=setpoints)
    given = settings(seed, stiffness)
    flight = fly(real, given)
    offsets = offsets + passing(plan, ACCURATE.diameter) - mean_noise(flight, given)
    return compared(f"random {seed}{', loose' * loose}", plan.motion, flight, offsets, stiffness)


def formed(n: int) -> Compared:
    """Return how a regular hitch that was tied in the air compares."""
    problem = tied(n, 0.0)
    mission = (*problem.mission, ho.Hold(SETTLE + MEASURE))
    plan = ho.solve(replace(problem, mission=mission))
    stiffness = 4.75
    shaken = Perturbations(noise=SHAKEN.noise)
    given = replace(settings(n, stiffness), perturbations=shaken, body="rigid")
    flight = fly(saved(plan), given)
    offsets = passing(plan, ACCURATE.diameter) - mean_noise(flight, given)
    return compared(f"formed {n}", plan.motion, flight, offsets, stiffness)


def settings(seed: int, stiffness: float) -> Settings:
    """Return the settings of a calm flight."""
    return Settings(
        preset=ACCURATE,
        body="point",
        perturbations=SHAKEN,
        seed=seed,
        friction=0.0,
        stiffness=stiffness,
        pull_test=False,
    )


def mean_noise(flight: Flight, given: Settings) -> Array:
    """Return (2n, 3) [m]: mean error of the places that drones measured while means were taken."""
    preset, end = given.preset, flight.task.duration
    period = preset.time_step * max(1, round(CONTROL / preset.time_step))
    spans = ((-SETTLE_ROPES, SETTLE_ROPES), (0.0, end), (end, REST))
    t = np.concatenate([begin + period * np.arange(round(T / period)) for begin, T in spans])
    noise = Disturbances(given.perturbations, flight.task.team.robots, given.seed).noise
    errors = np.array([noise.advance(period) for _ in t])
    return np.asarray(np.mean(errors[t > flight.record.t[-1] - (REST + MEASURE)], axis=0))


def passing(plan: ho.Plan, diameter: float) -> Array:
    """Return (2n, 3) [m] where drones would be if ropes were thin, from where they are.

    A thick rope that bends about another passes the vertex aside, away from its edge, by
    ``1 - sin(h)/2`` diameters, h half of the angle between leg and edge: its leg points elsewhere.

    Parameters
    ----------
    diameter: of the ropes [m].
    """
    states, layout = plan.at(plan.duration), plan.motion.team.layout
    edges = unit(layout.edges(states.vertices))
    along = np.stack([edges, -edges], axis=1).reshape(-1, 3)
    legs = unit(states.positions - states.vertices[layout.anchors])
    cosine = np.sum(legs * along, axis=-1, keepdims=True)
    half = 0.5 * np.arccos(np.clip(cosine, -1.0, 1.0))
    aside: Array = diameter * (1.0 - 0.5 * np.sin(half)) * unit(along - cosine * legs)
    return aside


def saved(plan: ho.Plan) -> Task:
    """Return the plan's task, read back from files."""
    with tempfile.TemporaryDirectory() as place:
        plan.save(place)
        return read_task(Path(place))


def compared(name: str, motion: Motion, flight: Flight, offsets: Array, k: float) -> Compared:
    """Return how far statics are from what a flight measured while it rested.

    Without effective lengths, where a clasp has come loose, those that the ropes have are taken.
    """
    team, record = motion.team, flight.record
    rows = record.t > record.t[-1] - (REST + MEASURE)
    T = np.mean(record.tensions[rows], axis=0)
    seen = record.vertices[rows]
    there = np.mean(np.isfinite(seen[..., 0]), axis=0) > 0.5
    vertices = np.full(seen.shape[1:], np.nan)
    vertices[there] = np.nanmean(seen[:, there], axis=0)
    lengths = effective_lengths(flight)
    lengths = np.where(np.isfinite(lengths), lengths, flight.task.team.cable_length)
    bends = 2.0 * bend_lengths(flight.task, ACCURATE.diameter, ACCURATE.segment)
    conditions = Conditions(
        cable_length=lengths,
        cable_density=flight.density,
        load=team.load + flight.density * bends,
        stiffness=k,
        offsets=offsets,
    )
    try:
        found = settle_motion(motion, motion.duration, conditions)
    except ho.InfeasibleError as error:
        return unsettled(name, flight, k, error)
    places = found.planned_vertices.copy()
    places[team.layout.clasps[there]] = vertices[there]
    drones = np.mean(record.drones[rows], axis=0)
    legs = np.linalg.norm(drones - places[team.layout.anchors], axis=-1).reshape(-1, 2)
    edges = np.linalg.norm(team.layout.edges(places), axis=-1)
    longest = np.maximum(edges, np.max(legs, axis=-1))
    ratio = SAG_RATIO / 8.0 * GRAVITY * flight.density * longest / T
    slack = bool(np.any(ratio >= 1.0)) or not there.all()
    directions = unit(team.layout.edges(found.vertices))
    forces = contact_forces(directions, found.tensions, team.topology)
    loose = int(np.sum(~found.bears | (forces < flight.least_bearing)))
    said = [f"slack: {len(found.slack_cables)}"] * bool(np.any(found.slack))
    said += [f"loose clasps: {loose}"] * bool(loose)
    predicted = bool(said)
    tension = float(np.max(np.abs(found.tensions / T - 1.0)))
    away = (found.vertices[team.layout.clasps] - vertices)[there]
    away = away if there.any() else np.full((1, 3), np.nan)
    distances = np.linalg.norm(away, axis=-1)
    vertex = float(np.max(distances))
    cells = (
        name,
        str(team.robots),
        f"{1e3 * flight.density:.1f}",
        f"{k:.1f}",
        f"{np.min(T):.3f} to {np.max(T):.3f}",
        f"{100.0 * tension:.1f}",
        f"{1e3 * vertex:.1f}",
        f"{1e3 * np.mean(distances):.1f}",
        f"{1e3 * np.max(np.abs(away[:, 2])):.1f}",
        f"{'yes' if slack else 'no'} ({np.max(ratio):.2f})",
        "; ".join(said) or "no",
        f"{np.sum(there)} of {len(there)}",
        "completed" if flight.error is None else str(flight.error),
    )
    return Compared(
        f"| {' | '.join(cells)} |", tension, vertex, slack, predicted, flight.error is None
    )


def unsettled(name: str, flight: Flight, k: float, error: ho.InfeasibleError) -> Compared:
    """Return what a flight gives for which statics find no rest: neither taut nor slack."""
    said = f"no rest: {error.violations[0].value:.2g} N"
    cells = [name, str(flight.task.team.robots), f"{1e3 * flight.density:.1f}", f"{k:.1f}"]
    cells += ["–"] * 6 + [said, "–", "completed" if flight.error is None else str(flight.error)]
    return Compared(f"| {' | '.join(cells)} |", np.inf, np.inf, False, True, flight.error is None)


def called(flight: Callable[[], Compared]) -> Compared:
    """Return what a flight gives, in a process of its own."""
    return flight()


COLUMNS = (
    "hitch",
    "n",
    "g/m",
    "k [N/m]",
    "tensions [N]",
    "tension off by [%]",
    "vertex off by [mm]",
    "mean [mm]",
    "height off by [mm]",
    "slack (sag over a quarter)",
    "said so",
    "clasps that bear",
    "flight",
)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print and write a row for every flight, and how many are as close as wanted."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=20)
    parser.add_argument("--first", type=int, default=0, help="seed of the first random one")
    parser.add_argument("--slack", type=int, default=8)
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--formed", type=int, nargs="*", default=[])
    parser.add_argument("--output", type=Path)
    given = parser.parse_args(arguments)
    lines = [
        f"# Settled hitches, {datetime.date.today()}",
        "",
        "`python -m benchmarks.settling`",
        "",
        f"- {environment(('mujoco',))}",
        f"- limitations: {LIMITATIONS}",
        f"- load {busy():.1f}",
        "",
        f"| {' | '.join(COLUMNS)} |",
        f"| {' | '.join(['---'] * len(COLUMNS))} |",
    ]
    print("\n".join(lines), flush=True)
    flights: list[Callable[[], Compared]] = [
        *(
            partial(flown, seed, loose=False)
            for seed in range(given.first, given.first + given.cases)
        ),
        *(partial(formed, n) for n in given.formed),
        *(
            partial(flown, seed, loose=True)
            for seed in range(given.first, given.first + given.slack)
        ),
    ]
    found = []
    with ProcessPoolExecutor(given.processes) as pool:
        for one in pool.map(called, flights):
            found.append(one)
            lines.append(one.row)
            print(one.row, flush=True)
    taut = [one for one in found if one.flown and not one.slack]  # also where no rest is found
    slack = [one for one in found if one.flown and one.slack]
    summary = [
        "",
        f"- taut: {sum(one.good for one in taut)} of {len(taut)} within {TENSION:.0%} of tension "
        f"and {100.0 * VERTEX:g} cm",
        f"- slack: said so in {sum(one.predicted for one in slack)} of {len(slack)} flights",
        f"- false alarms: {sum(one.predicted for one in taut)} of {len(taut)}",
        f"- not simulated to their end: {sum(not one.flown for one in found)} of {len(found)}",
    ]
    print("\n".join(summary))
    if given.output is not None:
        given.output.write_text("\n".join([*lines, *summary]) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
