"""What remains after the loss of a robot: the table ``after_loss`` of certificates."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from hitchopt.hitch.losses import Losses
from hitchopt.losses.checks import AfterLoss, after_losses
from hitchopt.losses.reactions import DELAY, Chain, PreparedStop, prepared_stops, rests_taut
from hitchopt.motion.flight import Flight, TeamMotion
from hitchopt.motion.motion import Motion


def after_loss(flight: Flight) -> dict[str, Any]:
    """Return what follows the loss of each robot after which the others are a chain.

    Teams are those with ``limits.survive``, at least one.
    """
    teams = [each for each in flight.teams if each.motion.requirements.limits.survive is not None]
    stops = prepared_stops(flight)
    return {"robots": [row for each in teams for row in _robots(each, stops)]}


def _robots(flown: TeamMotion, stops: list[PreparedStop]) -> Iterator[dict[str, Any]]:
    """Yield the row of each robot: paths of the drones that move [m], and the time [s].

    ``stops`` are those of the plan. There is no time if the plan never stops with a taut hitch.
    """
    motion = flown.motion
    team = motion.team
    parts = after_losses(motion)
    answers = [*_answers(motion, stops)]
    paths = {stop: stop.stopping(motion).drones for _, stop in answers if stop.seconds}
    for cable in Losses.of(team.layout).robots.tolist() if parts else ():
        chain = Chain(motion, cable)
        seconds = [
            DELAY + stop.start - stop.since + chain.reaction(run, stop.rest, paths.get(stop)).taut
            for run, stop in answers
        ]
        ways = sorted(_ways(parts, cable).items())
        row = {
            "robot": flown.label(str(team.labels[cable])),
            "ways": {flown.label(name): _rounded_up(way, 4) for name, way in ways},
        }
        yield row | ({"seconds": _rounded_up(max(seconds), 3)} if seconds else {})


def _rounded_up(value: float, decimals: int) -> float:
    """Return a value rounded up to some decimals."""
    scale = 10.0**decimals
    return math.ceil(value * scale) / scale


def _answers(motion: Motion, stops: list[PreparedStop]) -> Iterator[tuple[Motion, PreparedStop]]:
    """Yield the parts of a motion with a taut hitch, with stops that answer losses in them.

    The hitch rests as in the part.
    """
    for part in after_losses(motion):
        run = part.motion
        begin, end = run.drones.breaks[[0, -1]].tolist()
        for stop in stops:
            first = max(begin, stop.since - DELAY)
            last = end if stop is stops[-1] else min(end, stop.start - DELAY)
            if first <= last and rests_taut(run, motion, stop.rest):
                yield run, stop


def _ways(parts: tuple[AfterLoss, ...], cable: int) -> dict[str, float]:
    """Return the longest ways [m] of the drones that move after the loss of a cable, by name."""
    ways = dict[str, float]()
    for part in parts:
        rows = np.flatnonzero(part.lost == cable)
        for row, way in zip(rows.tolist(), np.max(part.ways[:, rows], axis=0), strict=True):
            name = part.motion.team.drone_names[part.drone[row]]
            ways[name] = max(ways.get(name, 0.0), float(way))
    return ways
