"""Motions of drones on free cables, their stages, and whether drones may start so."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hitchopt.checks.bounds.hanging_clearance import above_ground
from hitchopt.errors import InfeasibleError, Violation
from hitchopt.hitch import Hitch
from hitchopt.motion.motion import CableState, Motion, Phase, joined_motions
from hitchopt.motion.tensions import tautness
from hitchopt.planners.forming.tying_stages import Stage
from hitchopt.planners.timing.flight_curves import Flight, check_duration
from hitchopt.planners.timing.turning_stretch import turning_stretch
from hitchopt.requirements import Requirements
from hitchopt.steps.certified_motions import checked, flying
from hitchopt.steps.situation import Situation, StepTask
from hitchopt.trajectory import PiecewisePolynomial

LEVEL = 1e-9
"""Altitudes that differ by less are the same [m]."""


def hovering(task: StepTask, seconds: float) -> Motion:
    """Return the motion in which drones on free cables stay: parked, or hovering."""
    rest = PiecewisePolynomial.constant([0.0, seconds], task.before.drones)
    motion = free_motion(Stage("parked", rest, CableState.GROUND), task)
    (phase,) = motion.phases
    hanging = phase.state is CableState.FREE
    return replace(motion, phases=(replace(phase, name="hold"),)) if hanging else motion


def check_start(task: StepTask) -> None:
    """Raise InfeasibleError where drones on free cables break a limit before anything moves."""
    still = hovering(task, 1.0)
    try:
        checked(still, "at the start (t = 0)")
    except InfeasibleError as error:
        found = [_span(v, task.before) if v.constraint == "span" else v for v in error.violations]
        found.sort(key=lambda v: v.constraint != "span")  # what else is broken follows from it
        raise InfeasibleError(found, error.note) from None


def _span(violation: Violation, before: Situation) -> Violation:
    """Return the violation with the drones named that are too far apart, and by how much."""
    k = int(violation.where[0].removeprefix("cable "))
    apart = float(np.linalg.norm(before.drones[2 * k + 1] - before.drones[2 * k]))
    length = float(before.team.cable_length[k])
    return replace(
        violation,
        where=(f"robot {k}", f"q{k}", f"r{k}"),
        when=f"({apart:.6g} m apart on a cable of {length:.6g} m) {violation.when}",
        remedy=f"move q{k} and r{k} of start.drones closer together, or use a longer cable",
    )


def check_above_ground(motion: Motion) -> None:
    """Raise InfeasibleError where a drone goes below the ground, z = 0, that it takes off from.

    An arena's floor has a check of its own.
    """
    heights = motion.drones.coefficients[:, :, 2]
    if motion.requirements.arena is not None or np.min(heights) >= -LEVEL:
        return
    piece, drone, _ = np.unravel_index(int(np.argmin(heights)), heights.shape)
    lowest, name = float(np.min(heights)), motion.team.drone_names[drone]
    when = f"over the ground at about t = {motion.drones.breaks[piece]:.4g} s"
    remedy = "keep altitudes above 0, or give an arena with a lower floor"
    raise InfeasibleError([Violation("arena", lowest, 0.0, "min", "m", (name,), when, remedy)])


def staged(stages: Sequence[Stage], hitch: Hitch, i: int, requirements: Requirements) -> Motion:
    """Return the motion of stages one after the other, ``hitch`` being what they make or had."""
    return joined_motions([_staged(stage, hitch, i, requirements) for stage in stages])


def _staged(stage: Stage, hitch: Hitch, i: int, requirements: Requirements) -> Motion:
    """Return the motion of a stage."""
    phase = Phase(stage.name, i, 0.0, stage.drones.duration, state=stage.state)
    curves = Flight(stage.drones, stage.vertices(hitch), stage.legs(hitch), stage.tensions(hitch))
    return _raised(flying(curves, hitch.team, requirements, [phase]))


def free_motion(stage: Stage, task: StepTask) -> Motion:
    """Return the motion of drones on free cables, of which no hitch is made."""
    phase = Phase(stage.name, task.index, 0.0, stage.drones.duration, state=stage.state)
    return _raised(Motion.single(task.before.team, task.requirements, stage.drones, [phase]))


def _raised(motion: Motion) -> Motion:
    """Return the motion of one phase, its cables hanging free where they are clear of the ground.

    A stage that begins or ends on the ground is meant to have them lie there.
    """
    (phase,) = motion.phases
    if phase.state is CableState.GROUND and above_ground(motion):
        motion = replace(motion, phases=(replace(phase, state=CableState.FREE),))
    return _turning_slowly(motion)


def _turning_slowly(motion: Motion) -> Motion:
    """Return the motion, from rest to rest, slowed until no thrust turns faster than allowed."""
    limit = motion.requirements.limits.body_rate
    if limit is None:
        return motion
    breaks = motion.drones.breaks
    pulls = np.where(motion.formed[:, None, None], motion.pulls.coefficients, 0.0)
    forces = (PiecewisePolynomial(breaks, c) for c in (pulls, tautness(motion)))
    factor = turning_stretch(motion.team, limit, (motion.drones, motion.vertices, *forces))
    return motion.slowed(factor) if 1.0 < factor < math.inf else motion


def lasting(motion: Motion, duration: float | None, i: int, name: str) -> Motion:
    """Return the motion slowed to last exactly as long as a step was given."""
    if duration is None:
        return motion
    check_duration(duration, motion.duration, f"of step {i} ({name})")
    return motion.slowed(duration / motion.duration)
