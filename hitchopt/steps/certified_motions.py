"""Motions of single steps, at rest or flying, with their certificates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hitchopt.checks import Certificate, certify
from hitchopt.hitch import Hitch, Team
from hitchopt.motion.motion import Motion, Phase
from hitchopt.planners.timing.flight_curves import Flight
from hitchopt.requirements import Requirements
from hitchopt.steps.diagnosis import infeasible
from hitchopt.trajectory import PiecewisePolynomial


@dataclass(frozen=True, eq=False)
class Certified:
    """A motion and the certificate that holds for it."""

    motion: Motion
    certificate: Certificate


def certified(motion: Motion) -> Certified:
    """Return the motion of one step with its certificate, the whole plan's duration left open."""
    return Certified(motion, certify(motion.untimed))


def resting(hitch: Hitch, requirements: Requirements, seconds: float, phase: Phase) -> Motion:
    """Return the motion in which the hitch stays for ``seconds`` [s]; the phase's end is set."""
    breaks = np.array([0.0, seconds])
    values = (hitch.drones, hitch.vertices, hitch.legs, hitch.team.tension)
    drones, vertices, legs, tensions = (
        PiecewisePolynomial.constant(breaks, value) for value in values
    )
    return Motion(
        hitch.team,
        requirements,
        drones,
        vertices,
        legs,
        tensions,
        (replace(phase, start=0.0, end=seconds),),
    )


def flying(
    flight: Flight, team: Team, requirements: Requirements, phases: Sequence[Phase]
) -> Motion:
    """Return the motion of a flight, its phases from t = 0."""
    return Motion(
        team,
        requirements,
        flight.drones,
        flight.vertices,
        flight.legs,
        flight.tensions,
        tuple(phases),
    )


def certificate_at_rest(hitch: Hitch, requirements: Requirements) -> Certificate:
    """Return the certificate of the hitch without any motion."""
    return certify(resting(hitch, requirements.untimed, 1.0, Phase("hold", 0, 0.0, 1.0)))


def check_at_rest(hitch: Hitch, requirements: Requirements, when: str) -> None:
    """Raise InfeasibleError where the hitch breaks a limit without moving."""
    certificate = certificate_at_rest(hitch, requirements)
    if not certificate.certified:
        raise infeasible(certificate, requirements.separation, when=when)
