"""What remains after the loss of a robot: the table ``after_loss`` of certificates."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from hitchopt.checks.losses import AfterLoss, after_losses
from hitchopt.checks.stops import stop_table
from hitchopt.hitch.losses import Losses, displacement_by_energy
from hitchopt.motion.flight import Flight, TeamMotion
from hitchopt.planners.forming.stages import rise_seconds
from hitchopt.planners.timing.ramps import fastest_ramps

DELAY = 0.1
"""[s] Time from a loss until the others react."""

ASSUMPTION = "no other cable pulls with more than twice its tension, along the planned direction"
"""What ``loss_displacement`` assumes."""

CHAIN = "chain"
TWO_PIECES = "two pieces, which hold nothing: all drop their cables and land"
UNTIED = "nothing is tied: its drones drop their cable, and all land"
SLACK = "nothing is taut: all drop their cables and land"


def after_loss(flight: Flight) -> dict[str, Any]:
    """Return what remains after the loss of each robot, and in phases without a taut hitch.

    Teams are those with ``limits.survive``, at least one.
    """
    teams = [each for each in flight.teams if each.motion.requirements.limits.survive is not None]
    longest, _ = stop_table(flight).longest
    stop = DELAY + float(np.max(longest))
    return {
        "assumes": ASSUMPTION,
        "displacement_at_rest_by_energy": max(
            displacement_by_energy(each.motion.team) for each in teams
        ),
        "robots": [row for each in teams for row in _robots(each, stop)],
        "phases": [row for each in teams for row in _phases(each)],
    }


def _robots(flown: TeamMotion, stop: float) -> Iterator[dict[str, Any]]:
    """Yield what remains after the loss of each robot while its hitch is taut.

    ``stop`` is the time [s] until all drones rest.
    """
    motion = flown.motion
    team = motion.team
    parts = after_losses(motion)
    names = [flown.label(str(number)) for number in team.labels]
    survived = Losses.of(team.layout).robots.tolist()
    for cable in team.edges.tolist() if parts else ():
        if cable not in survived:
            yield {"robot": names[cable], "remains": TWO_PIECES}
            continue
        ways = {
            flown.label(name): round(way, 4) for name, way in sorted(_ways(parts, cable).items())
        }
        distances = [max(part.rise for part in parts), max(ways.values())]
        limits = motion.requirements.limits.with_reserve
        times = fastest_ramps(distances, limits.speed, limits.acceleration, limits.jerk).durations
        seconds = round(stop + float(np.sum(times)) + rise_seconds(motion.team), 2)
        yield {"robot": names[cable], "remains": CHAIN, "ways": ways, "seconds": seconds}


def _ways(parts: tuple[AfterLoss, ...], cable: int) -> dict[str, float]:
    """Return the longest ways [m] of the drones that move after the loss of a cable, by name."""
    ways = dict[str, float]()
    for part in parts:
        rows = np.flatnonzero(part.lost == cable)
        for row, way in zip(rows.tolist(), np.max(part.ways[:, rows], axis=0), strict=True):
            name = part.motion.team.drone_names[part.drone[row]]
            ways[name] = max(ways.get(name, 0.0), float(way))
    return ways


def _phases(flown: TeamMotion) -> Iterator[dict[str, Any]]:
    """Yield what remains in phases in which no hitch is taut."""
    taut = [part.motion.drones.breaks[[0, -1]] for part in after_losses(flown.motion)]
    for phase in flown.motion.phases:
        middle = 0.5 * (phase.start + phase.end)
        if any(start <= middle <= end for start, end in taut):
            continue
        remains = SLACK if phase.formed else UNTIED
        yield {"phase": flown.label(phase.name), "start": phase.start, "remains": remains}
