"""Motions of single steps, at rest or flying, with their certificates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

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


def checked(motion: Motion, when: str = "") -> Certified:
    """Return the motion with its certificate, or raise InfeasibleError for what it breaks.

    Parameters
    ----------
    motion: of one step or a part of it.
    when: said in place of the time, for a motion at rest.
    """
    found = certified(motion)
    if not found.certificate.certified:
        raise infeasible(found.certificate, motion, when)
    return found


def resting(hitch: Hitch, requirements: Requirements, seconds: float, phase: Phase) -> Motion:
    """Return the motion in which the hitch stays for ``seconds`` [s]; the phase's end is set."""
    values = (hitch.drones, hitch.vertices, hitch.legs, hitch.team.tension)
    flight = Flight(*(PiecewisePolynomial.constant([0.0, seconds], value) for value in values))
    return flying(flight, hitch.team, requirements, [replace(phase, start=0.0, end=seconds)])


def flying(
    flight: Flight, team: Team, requirements: Requirements, phases: Sequence[Phase]
) -> Motion:
    """Return the motion of a flight, its phases from t = 0."""
    return Motion(team, requirements, **vars(flight), phases=tuple(phases))


def at_rest(hitch: Hitch, requirements: Requirements) -> Motion:
    """Return the motion of the hitch without any motion, as long as limits do not matter."""
    return resting(hitch, requirements, 1.0, Phase("hold", 0, 0.0, 1.0))


def certificate_at_rest(hitch: Hitch, requirements: Requirements) -> Certificate:
    """Return the certificate of the hitch without any motion."""
    return certified(at_rest(hitch, requirements)).certificate


def check_at_rest(hitch: Hitch, requirements: Requirements, when: str) -> None:
    """Raise InfeasibleError where the hitch breaks a limit without moving."""
    checked(at_rest(hitch, requirements), when)
