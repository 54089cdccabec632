"""A problem to a plan, step by step, certified as a whole."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from hitchopt.certificate import Certificate, certify
from hitchopt.errors import HitchoptError, InfeasibleError
from hitchopt.geometry import ConvexPolygon
from hitchopt.hitch import Arena, Hitch, Limits, Separation, Team
from hitchopt.mission.diagnosis import infeasible
from hitchopt.mission.problem import Hold, LegSharing, Morph, Problem
from hitchopt.model.motion import Motion, Phase, joined_motions
from hitchopt.planners.flight import Flight
from hitchopt.planners.morph import straight_morph
from hitchopt.trajectory import PiecewisePolynomial

Progress = Callable[[str], None]

IDLE = 0.01
"""[s] What a morph takes that moves nothing and was given no duration."""


@dataclass(frozen=True, eq=False)
class Certified:
    """A motion and the certificate that holds for it."""

    motion: Motion
    certificate: Certificate


@dataclass(frozen=True, eq=False)
class Kept:
    """What every step of a mission has to keep."""

    limits: Limits
    separation: Separation
    arena: Arena | None


def solve_problem(problem: Problem, progress: Progress | None = None) -> Certified:
    """Return the plan of all steps with its certificate.

    Parameters
    ----------
    problem: what is to be flown.
    progress: called with what is being done now.

    Raises
    ------
    InfeasibleError: what binds, where and when; no plan that breaks a limit is returned.
    HitchoptError: a planner failed to find what may exist, and says so.
    """
    kept = Kept(problem.limits, problem.separation, problem.arena)
    start = problem.start
    _tell(progress, "sharing the start's legs")
    hitch = start_hitch(problem.team, start.polygon, start.altitude, start.legs, kept)
    return solve_steps(hitch, problem.mission, kept, progress)


def solve_steps(
    start: Hitch,
    steps: tuple[Morph | Hold, ...],
    kept: Kept,
    progress: Progress | None = None,
) -> Certified:
    """Return the plan of ``steps`` from a formed hitch; errors as solve_problem."""
    _check_at_rest(start, kept, "at the start (t = 0)")
    hitch = start
    motions: list[Motion] = []
    for i, step in enumerate(steps):
        if isinstance(step, Hold):
            motions.append(_resting(hitch, kept, step.seconds, i, "hold"))
            continue
        _tell(progress, f"planning step {i} (morph)")
        try:
            end = _end_hitch(hitch, step, kept)
            _check_at_rest(end, kept, f"at the end of step {i} (morph)")
            flight = straight_morph(
                hitch, end, kept.limits, kept.separation, kept.arena, step.duration
            )
        except InfeasibleError as error:
            raise _in_step(error, i) from None
        motions.append(
            _resting(end, kept, step.duration or IDLE, i, "morph")
            if flight is None
            else _flying(flight, hitch.team, kept, i)
        )
        hitch = end
    motion = joined_motions(motions)
    certificate = certify(motion, progress and (lambda name: progress(f"certifying {name}")))
    if not certificate.certified:
        raise infeasible(certificate, motion.phases)
    return Certified(motion, certificate)


def start_hitch(
    team: Team,
    polygon: ConvexPolygon | ArrayLike,
    altitude: float,
    legs: LegSharing,
    kept: Kept,
) -> Hitch:
    """Return the hitch with its legs shared as asked."""
    if isinstance(legs, np.ndarray):
        return Hitch(team, polygon, altitude, legs)
    if legs == "balanced":
        return Hitch.balanced(team, polygon, altitude)
    return Hitch.spread(team, polygon, altitude, limits=kept.limits, separation=kept.separation)


def _end_hitch(hitch: Hitch, step: Morph, kept: Kept) -> Hitch:
    if step.legs is not None:
        return start_hitch(hitch.team, step.polygon, hitch.altitude, step.legs, kept)
    return Hitch.nearest(
        hitch.team,
        step.polygon,
        hitch.altitude,
        hitch.fractions,
        limits=kept.limits,
        separation=kept.separation,
        arena=kept.arena,
    )


def _check_at_rest(hitch: Hitch, kept: Kept, when: str) -> None:
    """Raise InfeasibleError where the hitch breaks a limit without moving."""
    timeless = replace(kept, limits=replace(kept.limits, duration=None))
    certificate = certify(_resting(hitch, timeless, 1.0, 0, "hold"))
    if not certificate.certified:
        raise infeasible(certificate, when=when)


def _resting(hitch: Hitch, kept: Kept, seconds: float, step: int, name: str) -> Motion:
    breaks = np.array([0.0, seconds])
    values = (hitch.drones, hitch.vertices, hitch.legs, hitch.team.tension)
    drones, vertices, legs, tensions = (
        PiecewisePolynomial.constant(breaks, value) for value in values
    )
    return Motion(
        hitch.team,
        kept.limits,
        kept.separation,
        kept.arena,
        drones,
        vertices,
        legs,
        tensions,
        (Phase(name, step, 0.0, seconds),),
    )


def _flying(flight: Flight, team: Team, kept: Kept, step: int) -> Motion:
    return Motion(
        team,
        kept.limits,
        kept.separation,
        kept.arena,
        flight.drones,
        flight.vertices,
        flight.legs,
        flight.tensions,
        (Phase("morph", step, 0.0, flight.duration),),
    )


def _in_step(error: InfeasibleError, step: int) -> HitchoptError:
    """Return the error with the step named wherever its words do not name it yet."""
    suffix = f"of step {step} (morph)"
    return InfeasibleError(
        [
            v if f"step {step}" in v.when else replace(v, when=f"{v.when} {suffix}".strip())
            for v in error.violations
        ]
    )


def _tell(progress: Progress | None, message: str) -> None:
    if progress is not None:
        progress(message)
