"""Form and release: one step of a mission to a motion, and what it leaves behind."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import HitchoptError, InfeasibleError
from hitchopt.hitch import Hitch, Team
from hitchopt.mission.ends import shared_hitch
from hitchopt.mission.form_records import Form, Release
from hitchopt.mission.free_flight import LEVEL, check_part, lasting, staged
from hitchopt.mission.motions import certificate_at_rest, check_at_rest, flying
from hitchopt.mission.situation import Situation, Tied
from hitchopt.motion.motion import Motion, Phase, joined_motions
from hitchopt.planners.forming.approach import CLEARANCE, ApproachTask, approaches, hover_altitude
from hitchopt.planners.forming.prehitch import PreHitch, find_prehitch
from hitchopt.planners.forming.swap_settings import SwapSettings
from hitchopt.planners.forming.tying_stages import tied, undone
from hitchopt.planners.path.rigid_path import RigidPath
from hitchopt.planners.timing.fly_path import fly
from hitchopt.requirements import Requirements

Array = NDArray[np.float64]

TIGHTENING = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Of the way from the pre-hitch to the hitch, where the cables' heights are looked at."""


ROOM = (1.5, 1.25)
"""Times ``separation.cable`` that drones of a formed hitch keep from cables if they can."""


@dataclass(frozen=True, eq=False)
class _Site:
    """Where a hitch is tied or untied: so high that no cable touches the ground.

    Attributes
    ----------
    hitch: at that altitude.
    pre: the pre-hitch there.
    """

    hitch: Hitch
    pre: PreHitch


def plan_form(before: Situation, step: Form, i: int, requirements: Requirements) -> Tied:
    """Return the plan from drones on free cables to a hitch.

    Raises
    ------
    InfeasibleError: the hitch or the start breaks a limit at rest, or no approach was found.
    HitchoptError: a planner failed.
    """
    wanted = _wanted(before.team, step, requirements)
    check_at_rest(wanted, requirements, f"at the end of step {i} (form)")
    site = _site(wanted, step.swap, None, requirements)
    tying = staged(
        tied(site.pre, site.hitch, requirements.limits, step.swap), site.hitch, i, requirements
    )
    if site.pre.shortfall > 0.0:
        check_part(tying, requirements)  # no use to go there if nothing can be tied
    parts = [_approach(before, site.pre.drones, site.hitch, i, requirements), tying]
    if abs(site.hitch.altitude - wanted.altitude) > LEVEL:
        parts.append(_shifted(site.hitch, wanted.altitude, "lower", i, requirements))
    senses = np.sign(site.pre.turns.rise)
    after = Situation(before.team, wanted.drones, wanted, senses, step.swap)
    return Tied(lasting(joined_motions(parts), step.duration, i, step.name), after)


def _wanted(team: Team, step: Form, requirements: Requirements) -> Hitch:
    """Return the hitch to be formed; without ``legs`` one that is spread, with room at its cables.

    Where spreading leaves drones less than the first of ROOM times ``separation.cable`` from a
    cable, they get the most of ROOM that keeps every limit, and are spread beyond that. Drones that
    stand close lose little of a distance that has downwash in it; the one to cables has nothing to
    spare for a gust as a hitch is drawn tight.
    """
    legs = "spread" if step.legs is None else step.legs
    spread = shared_hitch(team, step.polygon, step.altitude, legs, requirements)
    if step.legs is not None:
        return spread
    cable = requirements.separation.cable
    beside = certificate_at_rest(spread, requirements)["cable_clearance"].bound
    for room in ROOM:
        if beside >= room * cable:
            break
        roomy = replace(
            requirements, separation=replace(requirements.separation, cable=room * cable)
        )
        hitch = shared_hitch(team, step.polygon, step.altitude, legs, roomy)
        if certificate_at_rest(hitch, roomy).certified:
            return hitch
    return spread


def plan_release(before: Situation, step: Release, i: int, requirements: Requirements) -> Tied:
    """Return the plan from a hitch to drones on free cables; errors as plan_form."""
    hitch = before.hitch
    if hitch is None:
        raise RuntimeError("there is no hitch to release")
    senses = np.ones(len(before.team.layout.clasps)) if before.senses is None else before.senses
    site = _site(hitch, before.swap, senses, requirements)
    stages = undone(tied(site.pre, site.hitch, requirements.limits, before.swap))
    parts = [staged(stages, site.hitch, i, requirements)]
    if abs(site.hitch.altitude - hitch.altitude) > LEVEL:
        parts.insert(0, _shifted(hitch, site.hitch.altitude, "raise", i, requirements))
    after = Situation(before.team, site.pre.drones, swap=before.swap)
    return Tied(lasting(joined_motions(parts), step.duration, i, step.name), after)


def _site(
    hitch: Hitch, swap: SwapSettings, senses: Array | None, requirements: Requirements
) -> _Site:
    """Return where to tie or untie: at the hitch's own altitude, or as much higher as it takes.

    Parameters
    ----------
    senses: of the way back of how it was formed, (clasps,); None to choose them.
    """
    pre = find_prehitch(hitch, requirements.separation, swap)
    if senses is not None:
        pre = replace(pre, turns=pre.turns.with_senses(senses))
    floor, clearance = requirements.floor, CLEARANCE * requirements.separation.cable
    altitude = max(
        hitch.altitude,
        floor + clearance + pre.measures.lowest,
        *(
            hover_altitude(
                hitch.team, pre.drones + share * (hitch.drones - pre.drones), floor, clearance
            )
            for share in TIGHTENING
        ),
    )
    by = altitude - hitch.altitude
    if by <= LEVEL:
        return _Site(hitch, pre)
    high = Hitch(hitch.team, hitch.polygon, altitude, hitch.q_legs)
    return _Site(high, replace(pre, turns=pre.turns.raised(by)))


def _shifted(
    hitch: Hitch, altitude: float, name: str, i: int, requirements: Requirements
) -> Motion:
    """Return the motion of the hitch straight up or down."""
    to = np.append(hitch.polygon.centroid, altitude)
    flight = fly(RigidPath(hitch, to, 0.0), requirements.limits)
    remark = "cables that hang need more room over the ground than the hitch"
    return flying(flight, hitch.team, requirements, [Phase(name, i, 0.0, flight.duration, remark)])


def _approach(
    before: Situation, goal: Array, hitch: Hitch, i: int, requirements: Requirements
) -> Motion:
    """Return the first way to the pre-hitch that the certificate holds for.

    Raises
    ------
    InfeasibleError: none; what binds on the first of them.
    """
    task = ApproachTask(
        before.team,
        before.drones,
        goal,
        requirements,
    )
    refusals: list[HitchoptError] = []
    for plan in approaches(task):
        try:
            motion = staged(plan(), hitch, i, requirements)
            check_part(motion, requirements)
        except HitchoptError as error:
            refusals.append(error)
        else:
            return motion
    raise _first(refusals)


def _first(refusals: Sequence[HitchoptError]) -> HitchoptError:
    """Return the first refusal that says what binds, with what else was tried."""
    for error in refusals:
        if isinstance(error, InfeasibleError):
            note = "no other way to the pre-hitch was found" if len(refusals) > 1 else ""
            return InfeasibleError(error.violations, error.note or note)
    return refusals[0]
