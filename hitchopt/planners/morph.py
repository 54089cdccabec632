"""Morph: one hitch to another, along straight vertex paths or optimised ones."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hitchopt.errors import HitchoptError
from hitchopt.hitch import Arena, Hitch, Limits, Separation
from hitchopt.planners.feasibility import check_loads, check_shapes
from hitchopt.planners.flight import Flight
from hitchopt.planners.flown import fly_unhurried
from hitchopt.planners.leg_law import KeptDistances, with_legs_clear
from hitchopt.planners.optimise.search import candidates
from hitchopt.planners.path import ShapePath

STILL = 1e-9
"""[m] A morph whose drones move by less is none."""


def straight_morph(
    start: Hitch,
    end: Hitch,
    limits: Limits,
    separation: Separation,
    arena: Arena | None = None,
    duration: float | None = None,
) -> Flight | None:
    """Return the flight from one hitch to another, or None where they are the same.

    Vertices go straight and legs change so that distances hold on the way. Whether all limits
    hold for all t is for the certificate to say.

    Raises
    ------
    InfeasibleError: the polygon loses its convexity, a leg or the thrust at rest gives out on the
        way, or ``duration`` [s] is too short.
    TimingError, WarpError: no timing was found.
    """
    if np.max(np.abs(end.drones - start.drones)) < STILL:
        return None
    path = ShapePath.straight(start, end)
    check_shapes(path)
    path = with_legs_clear(path, KeptDistances(limits, separation, arena))
    check_loads(path, limits)
    return fly_unhurried(path, limits, duration)


def optimised_flights(
    start: Hitch,
    end: Hitch,
    kept: KeptDistances,
    duration: float | None = None,
    tension: tuple[float, float] | None = None,
) -> Iterator[tuple[str, Flight]]:
    """Yield flights along optimised ways with their guesses' names, about the fastest first.

    Every one keeps its limits where it was looked at; whether for all t is for the certificate to
    say. Ways that cannot be timed, or not within ``duration`` [s], are left out. None for chains.

    Parameters
    ----------
    start, end: hitches at one altitude that keep all limits at rest.
    kept: limits, separation and arena.
    duration: exactly that long [s]; None for as fast as the limits allow.
    tension: smallest and largest [N] where tensions may change on the way.
    """
    for candidate in candidates(start, end, kept, tension):
        try:
            flight = fly_unhurried(candidate.path, kept.limits, duration)
        except HitchoptError:  # not this one: it is too slow for the duration, or has no timing
            continue
        yield candidate.name, flight
