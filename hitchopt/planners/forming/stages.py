"""Stages of forming and releasing: swap, swap, tighten, pull; and backward."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from hitchopt.checks.clearance import above_ground
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.requirements import Requirements
from hitchopt.motion.loads import tautness
from hitchopt.motion.motion import CableState, Motion, Phase
from hitchopt.planners.forming import SwapSettings
from hitchopt.planners.forming.prehitch import PreHitch, clasps_drawn_out
from hitchopt.planners.forming.turns import straight, swap
from hitchopt.planners.timing.flight import turning_stretch
from hitchopt.trajectory import PiecewisePolynomial

PULL_SECONDS = 1.0
"""[s] Shortest rise of the tensions, against which drones tilt."""

PULL_PERIODS = 3.0
"""Shortest rise of the tensions over the longest period of a cable (see ``rise_seconds``)."""

SMOOTH = np.array([0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0])
"""Bernstein coefficients of the rise from 0 to 1 with three derivatives zero at both ends."""

BACKWARD = {"swap 1": "unswap 2", "swap 2": "unswap 1", "tighten": "loosen", "tension": "relax"}
"""Names of the stages of forming when they are undone."""


def tied(
    pre: PreHitch, hitch: Hitch, requirements: Requirements, settings: SwapSettings, index: int = 0
) -> list[Motion]:
    """Return the motions from the pre-hitch to the hitch, pulled by the team's tension.

    Parameters
    ----------
    index: of the step in its mission.
    """
    team, limits = hitch.team, requirements.limits
    # No drone goes farther than this, whatever the polygon.
    shorter = (1.0 - pre.share) * float(np.max(hitch.legs))
    out = straight(team, limits, pre.drones, hitch.drones, shorter)
    rest = [0.0, rise_seconds(team)]
    swaps = (swap(pre.turns, limits, first, settings.seconds) for first in (0, 1))
    still, points, legs = (
        PiecewisePolynomial.constant(rest, value)
        for value in (hitch.drones, hitch.vertices, hitch.legs)
    )
    tensions = PiecewisePolynomial(np.array(rest), (team.tension[:, None] * SMOOTH)[None])
    own = team, requirements, index
    drawn = clasps_drawn_out(pre.turns, pre.scale, hitch, out)
    return [
        *(
            stage(f"swap {k}", drones, *own, CableState.CLASPING, vertices=_still(drones, hitch))
            for k, drones in enumerate(swaps, 1)
        ),
        stage("tighten", out, *own, CableState.TIGHTENING, vertices=drawn),
        stage(
            "tension",
            still,
            *own,
            CableState.HITCHED,
            vertices=points,
            legs=legs,
            tensions=tensions,
        ),
    ]


def _still(drones: PiecewisePolynomial, hitch: Hitch) -> PiecewisePolynomial:
    return PiecewisePolynomial.constant(drones.breaks, hitch.vertices)


def stage(
    name: str,
    drones: PiecewisePolynomial,
    team: Team,
    requirements: Requirements,
    index: int = 0,
    state: CableState = CableState.FREE,
    **further: Any,
) -> Motion:
    """Return the motion of drones from rest to rest, as one phase of forming or releasing.

    Cables that are meant to lie on the ground hang free where they are clear of it. The motion is
    slowed until no thrust turns faster than allowed.

    Parameters
    ----------
    name: of the phase.
    drones: (2n, 3) [m], from t = 0.
    index: of the step in its mission.
    state: of the cables.
    further: polynomials of vertices, legs and tensions, where they have a meaning.
    """
    phase = Phase(name, index, 0.0, drones.duration, state=state)
    motion = replace(Motion.single(team, requirements, drones, [phase]), **further)
    if state is CableState.GROUND and above_ground(motion):
        motion = replace(motion, phases=(replace(phase, state=CableState.FREE),))
    limit = requirements.limits.body_rate
    if limit is None:
        return motion
    pulls = np.where(motion.formed[:, None, None], motion.pulls.coefficients, 0.0)
    forces = (PiecewisePolynomial(drones.breaks, c) for c in (pulls, tautness(motion)))
    factor = turning_stretch(team, limit, (drones, motion.vertices, *forces))
    return motion.slowed(factor) if 1.0 < factor < math.inf else motion


def rise_seconds(team: Team) -> float:
    """Return how long the tensions rise, so that vertices hang still at the end [s].

    Cables sag until tension comes, and what lifts them fast leaves them swinging. The slowest swing
    of a regular hitch is that of its cables as strings, ends at rest: a wave runs to and fro in
    ``2 √(L m / T)``, m being the mass of the cable and of half the load at each of its clasps.
    After a rise along ``SMOOTH`` an oscillator of that period keeps 19 % of the lift if the rise
    lasts 1.6 periods, nothing at 2.2, and 2.2 % at most from there on; three periods allow for the
    tensions that are still low, at which it is slower.
    """
    layout = team.layout
    meet, halves = np.append(layout.ahead, layout.behind), np.tile(0.5 * team.load, 2)
    loads = np.bincount(meet, halves, team.robots)
    masses = team.cable_density * team.cable_length + loads
    periods = 2.0 * np.sqrt(team.cable_length * masses / team.tension)
    return max(PULL_SECONDS, PULL_PERIODS * float(np.max(periods)))


def undone(stages: Sequence[Motion]) -> list[Motion]:
    """Return the motions of forming backward in time: the hitch is taken apart."""
    return [
        each.changed(
            lambda part: part.reversed(),
            [replace(phase, name=BACKWARD[phase.name]) for phase in each.phases],
        )
        for each in reversed(stages)
    ]
