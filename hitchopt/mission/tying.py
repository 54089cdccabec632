"""Form, release and land: one step of a mission to a motion, and what it leaves behind."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hitchopt.certificate import certify
from hitchopt.errors import HitchoptError, InfeasibleError, Violation
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.limits import floor_of
from hitchopt.mission.diagnosis import infeasible
from hitchopt.mission.ends import shared_hitch
from hitchopt.mission.form_records import Form, Land, Release
from hitchopt.mission.motions import Kept, check_at_rest, flying
from hitchopt.mission.situation import Situation
from hitchopt.model.motion import Motion, Phase, joined_motions
from hitchopt.planners.flown import fly_unhurried
from hitchopt.planners.forming.approach import ApproachTask, hover_altitude, ways
from hitchopt.planners.forming.prehitch import PreHitch, find_prehitch
from hitchopt.planners.forming.stage import Stage
from hitchopt.planners.forming.straight import straight
from hitchopt.planners.forming.tying import tied, undone
from hitchopt.planners.rigid_path import RigidPath
from hitchopt.trajectory import PiecewisePolynomial

Array = NDArray[np.float64]

CLEARANCE = 1.1
"""How many times ``Separation.cable`` hanging cables keep off the ground."""

LEVEL = 1e-9
"""[m] Altitudes that differ by less are the same."""


@dataclass(frozen=True, eq=False)
class Tied:
    """The motion of a step, not certified yet, and where it ends."""

    motion: Motion
    after: Situation


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


def plan_form(before: Situation, step: Form, i: int, kept: Kept) -> Tied:
    """Return the plan from drones on free cables to a hitch.

    Raises
    ------
    InfeasibleError: the hitch or the start breaks a limit at rest, or no approach was found.
    HitchoptError: a planner failed.
    """
    legs = "spread" if step.legs is None else step.legs
    wanted = shared_hitch(before.team, step.polygon, step.altitude, legs, kept)
    check_at_rest(wanted, kept, f"at the end of step {i} (form)")
    site = _site(wanted, before, replace(before, swap=step.swap), kept)
    tying = staged(tied(site.pre, site.hitch, kept.limits, step.swap), site.hitch, i, kept)
    if site.pre.shortfall > 0.0:
        _check(tying, kept)  # no use to go there if nothing can be tied
    parts = [_approach(before, site.pre.drones, site.hitch, i, kept), tying]
    if abs(site.hitch.altitude - wanted.altitude) > LEVEL:
        parts.append(_shifted(site.hitch, wanted.altitude, "lower", i, kept))
    senses = np.sign(site.pre.turns.rise)
    after = Situation(before.team, wanted.drones, wanted, senses, step.swap)
    return Tied(_lasting(joined_motions(parts), step.duration, i, step.name), after)


def plan_release(before: Situation, step: Release, i: int, kept: Kept) -> Tied:
    """Return the plan from a hitch to drones on free cables; errors as plan_form."""
    hitch = before.hitch
    if hitch is None:
        raise RuntimeError("there is no hitch to release")
    site = _site(hitch, before, before, kept)
    stages = undone(tied(site.pre, site.hitch, kept.limits, before.swap))
    parts = [staged(stages, site.hitch, i, kept)]
    if abs(site.hitch.altitude - hitch.altitude) > LEVEL:
        parts.insert(0, _shifted(hitch, site.hitch.altitude, "raise", i, kept))
    after = Situation(before.team, site.pre.drones, swap=before.swap)
    return Tied(_lasting(joined_motions(parts), step.duration, i, step.name), after)


def plan_land(before: Situation, step: Land, i: int, kept: Kept) -> Tied:
    """Return the plan straight down to the ground; errors as plan_form."""
    down = before.drones.copy()
    down[:, 2] = floor_of(kept.arena)
    flight = straight(before.team, kept.limits, before.drones, down)
    motion = _free([Stage("land", flight)], before.team, i, kept)
    return Tied(_lasting(motion, step.duration, i, step.name), replace(before, drones=down))


def plan_hover(before: Situation, seconds: float, i: int, kept: Kept) -> Tied:
    """Return the plan in which drones on free cables stay for ``seconds`` [s]."""
    rest = PiecewisePolynomial.constant([0.0, seconds], before.drones)
    grounded = bool(np.all(before.drones[:, 2] <= floor_of(kept.arena) + LEVEL))
    return Tied(_free([Stage("land" if grounded else "hold", rest)], before.team, i, kept), before)


def check_start(before: Situation, kept: Kept) -> None:
    """Raise InfeasibleError where drones on free cables break a limit before anything moves."""
    floor = floor_of(kept.arena)
    needed = hover_altitude(before.team, before.drones, floor, kept.separation.cable)
    grounded = float(np.min(before.drones[:, 2])) < needed
    rest = PiecewisePolynomial.constant([0.0, 1.0], before.drones)
    stage = Stage("take-off" if grounded else "hold", rest)
    _check(_free([stage], before.team, 0, kept), kept, "at the start (t = 0)")


def staged(stages: Sequence[Stage], hitch: Hitch, i: int, kept: Kept) -> Motion:
    """Return the motion of stages one after the other, ``hitch`` being what they make or had."""
    return joined_motions([_staged(stage, hitch, i, kept) for stage in stages])


def _staged(stage: Stage, hitch: Hitch, i: int, kept: Kept) -> Motion:
    end = stage.drones.duration
    return Motion(
        hitch.team,
        kept.limits,
        kept.separation,
        kept.arena,
        stage.drones,
        stage.vertices(hitch),
        stage.legs(hitch),
        stage.tensions(hitch),
        (Phase(stage.name, i, 0.0, end, stage.remark, stage.formed),),
    )


def _free(stages: Sequence[Stage], team: Team, i: int, kept: Kept) -> Motion:
    """Return the motion of drones on free cables that no hitch is told of."""
    motions = []
    for stage in stages:
        breaks = stage.drones.breaks
        middle = np.mean(stage.drones.coefficients[0, ..., 0], axis=0)
        nothing = PiecewisePolynomial.constant
        motions.append(
            Motion(
                team,
                kept.limits,
                kept.separation,
                kept.arena,
                stage.drones,
                nothing(breaks, np.tile(middle, (team.layout.points, 1))),
                nothing(breaks, np.zeros((team.robots, 2))),
                nothing(breaks, np.zeros(team.robots)),
                (Phase(stage.name, i, 0.0, stage.drones.duration, stage.remark, formed=False),),
            )
        )
    return joined_motions(motions)


def _site(hitch: Hitch, before: Situation, how: Situation, kept: Kept) -> _Site:
    """Return where to tie or untie: at the hitch's own altitude, or as much higher as it takes."""
    pre = find_prehitch(hitch, kept.separation, how.swap)
    if before.hitch is not None:  # the way back of how it was formed, or is taken to have been
        senses = before.senses
        signs = np.ones(len(pre.turns.rise)) if senses is None else senses
        pre = replace(pre, turns=pre.turns.with_senses(signs))
    floor, clearance = floor_of(kept.arena), CLEARANCE * kept.separation.cable
    altitude = max(
        hitch.altitude,
        floor + clearance + pre.kept.lowest,
        hover_altitude(hitch.team, hitch.drones, floor, clearance),
        hover_altitude(hitch.team, pre.drones, floor, clearance),
    )
    by = altitude - hitch.altitude
    if by <= LEVEL:
        return _Site(hitch, pre)
    high = Hitch(hitch.team, hitch.polygon, altitude, hitch.q_legs)
    return _Site(high, replace(pre, turns=pre.turns.raised(by)))


def _shifted(hitch: Hitch, altitude: float, name: str, i: int, kept: Kept) -> Motion:
    """Return the motion of the hitch straight up or down."""
    to = np.append(hitch.polygon.centroid, altitude)
    flight = fly_unhurried(RigidPath(hitch, to, 0.0), kept.limits)
    remark = "cables that hang need more room over the ground than the hitch"
    return flying(flight, hitch.team, kept, [Phase(name, i, 0.0, flight.duration, remark)])


def _approach(before: Situation, goal: Array, hitch: Hitch, i: int, kept: Kept) -> Motion:
    """Return the first way to the pre-hitch that the certificate holds for.

    Raises
    ------
    InfeasibleError: none; what binds on the first of them.
    """
    task = ApproachTask(
        before.team,
        before.drones,
        goal,
        kept.limits,
        kept.separation,
        kept.arena,
        floor_of(kept.arena),
    )
    refusals: list[HitchoptError] = []
    for plan in ways(task):
        try:
            motion = staged(plan(), hitch, i, kept)
            _check(motion, kept)
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


def _check(motion: Motion, kept: Kept, when: str = "") -> None:
    """Raise InfeasibleError where a part of a plan breaks a limit, its duration left open."""
    limits = replace(motion.limits, duration=None)
    certificate = certify(replace(motion, limits=limits))
    if not certificate.certified:
        raise infeasible(certificate, kept.separation, motion.phases, when)


def _lasting(motion: Motion, duration: float | None, i: int, name: str) -> Motion:
    """Return the motion slowed to last exactly as long as a step was given."""
    if duration is None:
        return motion
    if duration < motion.duration:
        raise InfeasibleError(
            [
                Violation(
                    "duration",
                    duration,
                    motion.duration,
                    "min",
                    "s",
                    (),
                    f"of step {i} ({name})",
                    f"give it {motion.duration:.6g} s or more, or raise the limits of motion",
                )
            ]
        )
    factor = duration / motion.duration
    phases = tuple(
        replace(phase, start=factor * phase.start, end=factor * phase.end)
        for phase in motion.phases
    )
    return replace(
        motion,
        drones=motion.drones.stretched(factor),
        vertices=motion.vertices.stretched(factor),
        legs=motion.legs.stretched(factor),
        tensions=motion.tensions.stretched(factor),
        phases=phases,
    )
