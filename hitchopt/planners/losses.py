"""What remains after the loss of a robot: the table ``after_loss`` of certificates."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from hitchopt.checks.losses import AfterLoss, after_losses
from hitchopt.hitch.losses import Losses, displacement_by_energy
from hitchopt.motion.flight import Flight, TeamMotion
from hitchopt.motion.motion import JOINT, Motion
from hitchopt.planners.reactions import DELAY, Chain, PreparedStop, prepared_stops, rests_taut

ASSUMPTION = "no other cable pulls with more than twice its tension, along the planned direction"
"""What ``loss_displacement`` assumes."""

CHAIN = "chain"
TWO_PIECES = "two pieces, which hold nothing: all drop their cables and land"
UNTIED = "nothing is tied: its drones drop their cable, and all land"
SLACK = "nothing is taut: all drop their cables and land"
MOVING = "the plan does not stop before its hitch is slack: all drop their cables and land"


def after_loss(flight: Flight) -> dict[str, Any]:
    """Return what remains after the loss of each robot, and in phases without a taut hitch.

    Teams are those with ``limits.survive``, at least one.
    """
    teams = [each for each in flight.teams if each.motion.requirements.limits.survive is not None]
    stops = prepared_stops(flight)
    return {
        "assumes": ASSUMPTION,
        "displacement_at_rest_by_energy": max(
            displacement_by_energy(each.motion.team) for each in teams
        ),
        "robots": [row for each in teams for row in _robots(each, stops)],
        "phases": [row for each in teams for row in (*_phases(each), *_moving(each, stops))],
    }


def _robots(flown: TeamMotion, stops: list[PreparedStop]) -> Iterator[dict[str, Any]]:
    """Yield what remains after the loss of each robot while its hitch is taut.

    ``stops`` are those of the plan.
    """
    motion = flown.motion
    team = motion.team
    parts = after_losses(motion)
    names = [flown.label(str(number)) for number in team.labels]
    survived = Losses.of(team.layout).robots.tolist()
    answers = [each for each in _answers(motion, stops) if each.is_taut]
    paths = {stop: stop.stopping(motion).drones for _, stop, _, _ in answers if stop.seconds}
    for cable in team.edges.tolist() if parts else ():
        if cable not in survived:
            yield {"robot": names[cable], "remains": TWO_PIECES}
            continue
        ways = {
            flown.label(name): round(way, 4) for name, way in sorted(_ways(parts, cable).items())
        }
        chain = Chain(motion, cable)
        seconds = [
            DELAY + stop.start - stop.since + chain.reaction(run, stop.rest, paths.get(stop)).taut
            for run, stop, _, _ in answers
        ]
        row = {"robot": names[cable], "remains": CHAIN, "ways": ways}
        yield row | ({"seconds": round(max(seconds), 3)} if seconds else {})


class _Answer(NamedTuple):
    """A stop that answers losses in a part of a motion with a taut hitch."""

    run: Motion  # The part
    stop: PreparedStop  # The stop
    times: tuple[float, float]  # [s] First and last time of these losses
    is_taut: bool  # Whether the hitch rests as in this part


def _answers(motion: Motion, stops: list[PreparedStop]) -> Iterator[_Answer]:
    """Yield the stops that answer losses at all times with a taut hitch."""
    for part in after_losses(motion):
        run = part.motion
        begin, end = run.drones.breaks[[0, -1]].tolist()
        for stop in stops:
            first = max(begin, stop.since - DELAY)
            last = end if stop is stops[-1] else min(end, stop.start - DELAY)
            if first <= last:
                yield _Answer(run, stop, (first, last), rests_taut(run, motion, stop.rest))


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


def _moving(flown: TeamMotion, stops: list[PreparedStop]) -> Iterator[dict[str, Any]]:
    """Yield when a taut hitch is slack before the plan stops after a loss."""
    for _, _, (first, last), is_taut in _answers(flown.motion, stops):
        if not is_taut:
            phase = flown.label(flown.motion.overlapping(first - JOINT, last + 2.0 * JOINT)[0].name)
            yield {"phase": phase, "start": first, "end": last, "remains": MOVING}
