"""Losses of robots: how many random plans survive any of them, and drawn cuts flown in ropes.

Usage: python -m benchmarks losses [--plans N] [--cuts N] [--first SEED] [--preset fast]
           [--friction MU]

Irregular hitches of 3 to 8 robots, which can drop their cables, are reshaped or carried with
``limits.survive: cable``. Plans are certified for the loss of every robot at all times, and proven
by hitchopt verify. Then robots and times are drawn: the robot drops its cable, leaves upward, and
the others form a chain. Its vertices are compared with where the plan has stopped.
"""

from __future__ import annotations

import tempfile
from dataclasses import asdict, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

import hitchopt as ho
from benchmarks.measuring import Array, Table, most_common, parser, timed
from hitchopt import verify
from hitchopt.checks import certify
from hitchopt.lab.simulation.cuts import task_with_cut
from hitchopt.lab.simulation.flight import fly
from hitchopt.lab.simulation.judgement import loss_outcome
from hitchopt.lab.simulation.settings import PRESETS, Loss, Settings
from hitchopt.lab.simulation.task import Task
from hitchopt.losses.checks import after_losses
from hitchopt.values.fields import with_fields
from problems.random_morph import is_certified

LIMITATIONS = (
    "one machine, one run each; processor time of certification; starts are drawn until they "
    "survive at rest, and none is left out afterwards; calm drones with the simplified controller"
)

ROBOTS = range(3, 9)
"""Numbers of robots, in turn."""

EDGE = (0.8, 1.3)
"""[m] Mean length of edges."""

LEG = (0.3, 0.5)
"""[m] Lengths of legs."""

JITTER = 0.2
"""Largest change of the angle of a corner, over that between two."""

CHANGE = 0.08
"""Largest change of a corner, over the mean edge."""

LAST = 0.5
"""[s] Time at the end over which places of vertices are averaged."""

TAUT_SECONDS = (4.0, 6.0)
"""[s] Times within which chains that are taut again are counted."""

REPEATS = 3
"""Number of certifications, of which the fastest counts."""

SURVIVE: dict[str, Any] = {"limits": {"survive": "cable"}}


def random_plan(seed: int) -> dict[str, Any]:
    """Return a random morph or transport, whose start survives losses at rest."""
    rng = np.random.default_rng(seed)
    n = ROBOTS[seed % len(ROBOTS)]
    while True:
        edge, leg = rng.uniform(*EDGE), rng.uniform(*LEG)
        corners = _corners(n, edge, rng)
        longest = float(np.max(np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)))
        team = {
            "robots": n,
            "cable_length": round(longest + 2.0 * leg, 2),
            "tension": round(rng.uniform(0.2, 0.4), 2),
            "cable_density": round(rng.uniform(0.0, 0.006), 4),
            "quadrotor": "paper_132g",
            "release": True,
        }
        start = {"hitch": {"polygon": corners.tolist(), "altitude": 1.6}}
        if is_certified(team, start, SURVIVE):
            break
    step: dict[str, Any]
    if rng.random() < 0.5:
        place = [*np.round(rng.uniform(-1.0, 1.0, 2), 3).tolist(), 1.8]
        step = {"transport": {"to": place, "yaw_deg": round(rng.uniform(-40.0, 40.0), 1)}}
    else:
        moved: Array = corners + edge * rng.uniform(-CHANGE, CHANGE, corners.shape)
        step = {"morph": {"polygon": np.round(moved, 4).tolist()}}
    return {"team": team, "start": start, "mission": [step], **SURVIVE}


def _corners(n: int, edge: float, rng: np.random.Generator) -> Array:
    """Return an irregular convex n-gon on an ellipse, with a mean edge [m], clockwise."""
    spacing = 2.0 * np.pi / n
    angles = -spacing * (np.arange(n) + rng.uniform(-JITTER, JITTER, n)) + rng.uniform(0.0, 6.0)
    axes = np.array([1.0, rng.uniform(0.8, 1.0)])
    corners = axes * np.column_stack([np.cos(angles), np.sin(angles)])
    lengths = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
    sized: Array = edge / np.mean(lengths) * (corners - np.mean(corners, axis=0))
    return np.round(sized, 4)


class Planned(NamedTuple):
    """A plan, and what its certificate says of losses."""

    plan: ho.Plan
    proven: bool
    seconds: tuple[float, float]
    """[s] Processor times of certification, with losses and without."""

    margin: float
    """By how much ways and balance after any loss at least keep their limits, over these."""


def _certification_time(motion: ho.Motion) -> float:
    """Return the fastest of some times [s] of certifying a motion."""
    flights = [ho.Flight.of(_copied(motion)) for _ in range(REPEATS)]
    return min(timed(partial(certify, flight))[1] for flight in flights)


def planned(data: dict[str, Any]) -> Planned:
    """Return a plan, verified, with the times of its certification."""
    plan = ho.solve(ho.problem_from_dict(data))
    with tempfile.TemporaryDirectory() as folder:
        rows = verify.verify(plan.save(folder))
        proven = {row.verdict for row in rows} <= verify.PASSING
    need = plan.motion.requirements
    without = replace(need, limits=with_fields(need.limits, survive=None))
    copies = [plan.motion.replaced(requirements=each) for each in (need, without)]
    first, second = map(_certification_time, copies)
    margin = min(part.worst().worst for part in after_losses(plan.motion)) - 1.0
    return Planned(plan, proven, (first, second), margin)


def _copied(motion: ho.Motion) -> ho.Motion:
    """Return a copy of a motion, of which nothing is known yet."""
    return motion.replaced(requirements=replace(motion.requirements))


def drawn_loss(plan: ho.Plan, rng: np.random.Generator) -> Loss:
    """Return the loss of a random robot at a random time of a plan."""
    robot = int(rng.integers(plan.motion.team.robots))
    return Loss(str(robot), round(float(rng.uniform(0.0, plan.duration - 0.2)), 2))


def _refusal(error: ho.InfeasibleError) -> str:
    """Return the first limit that an error names."""
    return error.violations[0].constraint if error.violations else str(error)


def cut(plan: ho.Plan, loss: Loss, preset: str, friction: float) -> dict[str, Any]:
    """Return the outcome of a loss in a simulated flight."""
    task, found = task_with_cut(Task.of(plan.flight), loss, react=True)
    settings = Settings(preset=PRESETS[preset], lost=loss, controller="ideal", friction=friction)
    flight = fly(task, settings)
    outcome = loss_outcome(flight)
    assert outcome is not None  # a robot is lost
    touches = [pair for pair in outcome.others if loss.cable not in pair]
    team, record = plan.motion.team, flight.record
    layout, lost = team.layout, team.drone_names.index(loss.drones[0]) // 2
    remain = (layout.ahead != lost) & (layout.behind != lost)
    planned_places = plan.motion.vertices.at(found.rest)[layout.clasps[remain]]
    places = np.mean(record.vertices[record.t > record.t[-1] - LAST][:, remain], axis=0)
    error = float(np.max(np.linalg.norm(places - planned_places, axis=-1)))
    return asdict(outcome) | {
        "others": touches,
        "valid": flight.error is None,
        "vertices": error,
    }


def main() -> None:
    """Print and write the tables."""
    defaults = {"plans": 8, "cuts": 6, "first": 0, "preset": "fast", "friction": 0.0}
    options = parser(__doc__, **defaults).parse_args()
    table = Table(options.output / "losses.md", "Losses of robots", LIMITATIONS)
    columns = ("proven", "certified [s]", "over without", "margin [%]")
    table.section("Plans", "seed", "n", "step", "planned", *columns)
    results, refusals = list[Planned](), list[str]()
    for seed in range(options.first, options.first + options.plans):
        data = random_plan(seed)
        head = seed, data["team"]["robots"], next(iter(data["mission"][0]))
        try:
            result = planned(data)
        except ho.InfeasibleError as error:
            refusals.append(_refusal(error))
            table.row(*head, refusals[-1], "", "", "", "")
            continue
        results.append(result)
        ratio = result.seconds[0] / result.seconds[1]
        table.row(*head, "yes", result.proven, result.seconds[0], ratio, 100.0 * result.margin)
    proven = sum(each.proven for each in results)
    ratios = [each.seconds[0] / each.seconds[1] for each in results]
    table.note(
        f"planned {len(results)} of {options.plans}, proven {proven}; {most_common(refusals)}",
        f"certification over that without: median {np.median(ratios):.3g}, {max(ratios):.3g} most",
        f"smallest margin, at least {100.0 * min(x.margin for x in results):.3g} % of its limit",
    )
    rng, refusals = np.random.default_rng(options.first), []
    headings = ("touches", "displaced [cm]", "bound [cm]", "taut after [s]", "vertices [cm]")
    table.section("Cuts", "n", "robot@time", *headings)
    outcomes = list[dict[str, Any]]()
    for index in range(options.cuts):
        plan = results[index % len(results)].plan
        loss = drawn_loss(plan, rng)
        words = f"{loss.name}@{loss.time:g}"
        try:
            found = cut(plan, loss, options.preset, options.friction)
        except ho.InfeasibleError as error:
            refusals.append(_refusal(error))
            table.row(plan.motion.team.robots, words, refusals[-1], "", "", "", "")
            continue
        outcomes.append(found)
        touches = len(found["among"]) + len(found["others"])
        sizes = 100.0 * found["displaced"], 100.0 * found["bound"]
        end = found["taut_after"], 100.0 * found["vertices"] if found["valid"] else "not simulated"
        table.row(plan.motion.team.robots, words, touches, *sizes, *end)
    free = sum(not (each["among"] or each["others"]) and each["valid"] for each in outcomes)
    within = sum(each["displaced"] <= each["bound"] for each in outcomes)
    taut = (
        f"{sum(each['taut_after'] <= most for each in outcomes)} within {most:g} s"
        for most in TAUT_SECONDS
    )
    table.note(
        f"certified reactions: {len(outcomes)} of {options.cuts}; {most_common(refusals)}",
        f"{free} without a touch, {within} within the bound",
        f"taut again: {', '.join(taut)}",
        f"vertices at most {100.0 * max(x['vertices'] for x in outcomes):.3g} cm off",
    )


if __name__ == "__main__":
    main()
