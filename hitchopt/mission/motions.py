"""Motions of single steps: a hitch at rest, a flight, and what every step has to keep."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hitchopt.certificate import Certificate, certify
from hitchopt.hitch import Arena, Hitch, Limits, Separation, Team
from hitchopt.mission.diagnosis import infeasible
from hitchopt.model.motion import Motion, Phase
from hitchopt.planners.flown import Flown
from hitchopt.planners.leg_law import KeptDistances
from hitchopt.trajectory import PiecewisePolynomial


@dataclass(frozen=True, eq=False)
class Kept:
    """What every step of a mission has to keep.

    Attributes
    ----------
    limits, separation, arena: of the problem.
    optimiser: whether steps whose own way will not do are given to the optimiser.
    """

    limits: Limits
    separation: Separation
    arena: Arena | None
    optimiser: bool = True

    @property
    def distances(self) -> KeptDistances:
        """The same, as planners take it."""
        return KeptDistances(self.limits, self.separation, self.arena)


@dataclass(frozen=True, eq=False)
class Certified:
    """A motion and the certificate that holds for it."""

    motion: Motion
    certificate: Certificate


def certified(motion: Motion) -> Certified:
    """Return the motion of one step with its certificate, the whole plan's duration left open."""
    timeless = replace(motion, limits=replace(motion.limits, duration=None))
    return Certified(motion, certify(timeless))


def resting(hitch: Hitch, kept: Kept, seconds: float, phase: Phase) -> Motion:
    """Return the motion in which the hitch stays for ``seconds`` [s]; the phase's end is set."""
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
        (replace(phase, start=0.0, end=seconds),),
    )


def flying(flight: Flown, team: Team, kept: Kept, phases: Sequence[Phase]) -> Motion:
    """Return the motion of a flight, its phases from t = 0."""
    return Motion(
        team,
        kept.limits,
        kept.separation,
        kept.arena,
        flight.drones,
        flight.vertices,
        flight.legs,
        flight.tensions,
        tuple(phases),
    )


def certificate_at_rest(hitch: Hitch, kept: Kept) -> Certificate:
    """Return the certificate of the hitch without any motion."""
    timeless = replace(kept, limits=replace(kept.limits, duration=None))
    return certify(resting(hitch, timeless, 1.0, Phase("hold", 0, 0.0, 1.0)))


def check_at_rest(hitch: Hitch, kept: Kept, when: str) -> None:
    """Raise InfeasibleError where the hitch breaks a limit without moving."""
    certificate = certificate_at_rest(hitch, kept)
    if not certificate.certified:
        raise infeasible(certificate, kept.separation, when=when)
