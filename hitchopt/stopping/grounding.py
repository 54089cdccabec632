"""What brings a plan at rest to the ground: untied first, or as it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hitchopt.checks import Certificate
from hitchopt.checks.registry import RULE_OF
from hitchopt.errors import HitchoptError, InfeasibleError
from hitchopt.hitch import Hitch
from hitchopt.motion.motion import Motion, Phase
from hitchopt.motion.phases import JOINT, CableState
from hitchopt.motion.retiming import beside_objects, followed
from hitchopt.planners.forming.straight import straight
from hitchopt.requirements import Requirements
from hitchopt.steps import Land, Release
from hitchopt.steps.certified_motions import infeasible
from hitchopt.steps.situation import Situation, StepTask
from hitchopt.steps.tying_site import lifted
from hitchopt.values import Array

OBSTACLES = ("keep_out", "object_clearance")
"""Checks of what stands in the way of a landing."""

SAME = 1e-7
"""[m] Drones of a hitch found again stand where the plan has them, within this."""

ROUNDS = 8
"""Corrections of the lengths of legs that sag, and of their roll."""

CLOSER = 0.5
"""Share of the distance to a hitch that a correction of its roll leaves at most: legs that lean
against friction stay farther from any."""

STEP = 1e-4
"""[rad] Half of the difference of two rolls between which the derivatives of legs are found."""


def released(whole: Motion) -> Motion:
    """Return a plan at rest followed by untying its hitch, if there is one, and landing.

    Raises
    ------
    InfeasibleError: there is no plan for it, or the hitch is not one that a step can start from.
    """
    if not whole.phases[-1].formed:
        return descended(whole)
    task = _task(whole)
    untied = Release().plan(task)
    whole = followed(whole, _certifiable(untied.motion, whole))
    landed = Land().plan(replace(task, before=untied.after, index=task.index + 1))
    return followed(whole, _certifiable(landed.motion, whole))


def descended(whole: Motion) -> Motion:
    """Return a plan at rest followed by straight flights down to the ground, tied or not.

    Raises
    ------
    InfeasibleError: as released.
    """
    floor = whole.requirements.floor
    drones = whole.drones.coefficients[-1, ..., -1]
    if not whole.phases[-1].formed:
        down = drones.copy()
        down[:, 2] = floor
        if whole.team.has_cables:
            task = StepTask(Situation(whole.team, drones), _index(whole), _requirements(whole))
            return followed(whole, _certifiable(Land().plan(task).motion, whole))
        flight = straight(whole.team, whole.requirements.limits.planned, drones, down)
        phase = Phase("land", _index(whole), 0.0, flight.duration)
        return followed(whole, Motion.single(whole.team, whole.requirements, flight, [phase]))
    task = _task(whole)
    lower = task.hitch.altitude - (float(np.min(drones[:, 2])) - floor)
    motion = lifted(task.hitch, lower, "land", task)
    motion = replace(motion, phases=tuple(replace(p, remark="") for p in motion.phases))
    return followed(whole, _certifiable(motion, whole))


def check_obstacles(whole: Motion, since: float) -> None:
    """Raise InfeasibleError where a plan comes too close to obstacles after a time [s].

    They are what most landings fail on, and the checks of the whole plan take far longer.
    """
    breaks = whole.drones.breaks
    first = int(np.searchsorted(breaks, since - JOINT))
    ahead = whole.taken(slice(first, None), whole.overlapping(breaks[first], breaks[-1]))
    for name in OBSTACLES:
        check = RULE_OF[name].check(ahead)
        if check is not None and not check.holds:
            raise infeasible(Certificate(whole.duration, (check,)), whole)


def _index(whole: Motion) -> int:
    return whole.phases[-1].step + 1


def _certifiable(motion: Motion, whole: Motion) -> Motion:
    """Return the motion under the requirements of the whole plan, objects where that ends."""
    return beside_objects(whole, replace(motion, requirements=whole.requirements))


def _requirements(whole: Motion) -> Requirements:
    """Return what a step has to satisfy that begins where a plan ends, with objects as it ends."""
    objects = dict(whole.requirements.objects)
    poses = whole.object_poses.coefficients[-1, ..., -1]
    for pose, (name, body) in zip(poses, objects.items(), strict=True):
        objects[name] = replace(body, at=pose[:3], yaw=float(np.arctan2(pose[4], pose[3])))
    return replace(whole.requirements, objects=objects).planned


def _task(whole: Motion) -> StepTask:
    """Return what a step is asked that begins where a plan has come to rest with a hitch."""
    hitch = resting_hitch(whole)
    before = Situation(whole.team, hitch.drones, hitch, _senses(whole))
    return StepTask(before, _index(whole), _requirements(whole))


def _senses(whole: Motion) -> Array | None:
    """Return how pairs have turned to form the hitch (clasps,): 1 where q went up first."""
    tied = [phase for phase in whole.phases if phase.state is CableState.CLASPING]
    if not tied:
        return None
    layout, first = whole.team.layout, tied[0]
    there = whole.drones.at(first.start + 0.5 * (first.end - first.start))
    above = there[2 * layout.ahead, 2] - there[2 * layout.behind + 1, 2]
    return np.where(above >= 0.0, 1.0, -1.0)


def resting_hitch(whole: Motion) -> Hitch:
    """Return the hitch with which a plan ends.

    Raises
    ------
    InfeasibleError: legs stand otherwise than a hitch at rest has them, as where they lean against
        friction.
    """
    drones, vertices, legs = (
        part.coefficients[-1, ..., -1] for part in (whole.drones, whole.vertices, whole.legs)
    )
    roll, off, last = np.zeros(len(whole.team.layout.clasps)), np.inf, np.inf
    try:
        for _ in range(ROUNDS):
            hitch = _fitted(whole, vertices, legs, roll)
            off = float(np.max(np.abs(hitch.drones - drones)))
            if off <= SAME or off > CLOSER * last:
                break
            roll, last = roll + _turn(hitch, drones), off
    except HitchoptError:
        pass
    if off > SAME:
        words = "legs stand otherwise than those of a hitch at rest, from which steps start"
        remedy = "abort earlier or later, or choose hold or back"
        raise InfeasibleError([], f"at rest at t = {whole.duration:.4g} s: {words}; {remedy}")
    return hitch


def _fitted(whole: Motion, vertices: Array, legs: Array, roll: Array) -> Hitch:
    """Return the hitch whose q-legs have given distances, by correcting their lengths."""
    outline = vertices[:, :2]
    q = legs[:, 0].copy()
    for _ in range(ROUNDS):
        hitch = Hitch(whole.team, outline, float(np.mean(vertices[:, 2])), q, roll)
        q = q + legs[:, 0] - hitch.legs[:, 0]
    return hitch


def _turn(hitch: Hitch, drones: Array) -> Array:
    """Return by how much the legs of a hitch are to roll (clasps,) [rad] toward given drones.

    A Newton step: what heavy cables put on a clasp depends on its roll too.
    """
    layout = hitch.team.layout
    ahead = 2 * layout.ahead
    low, high = (
        Hitch(hitch.team, hitch.polygon, hitch.altitude, hitch.q_legs, hitch.roll + step)
        for step in (-STEP, STEP)
    )
    rate = (high.leg_directions[ahead] - low.leg_directions[ahead]) / (2.0 * STEP)
    away = drones[ahead] - hitch.vertices[layout.anchors[ahead]]
    away = away / np.linalg.norm(away, axis=-1, keepdims=True) - hitch.leg_directions[ahead]
    turn: Array = np.sum(away * rate, axis=-1) / np.sum(rate**2, axis=-1)
    return turn
