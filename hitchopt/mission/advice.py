"""Advice of a refusal: what in the mission or its team, if changed, would make a plan possible."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hitchopt.checks import Certificate
from hitchopt.checks.arena import ARENA, FLOOR, nearest_wall
from hitchopt.checks.linking import DURATION
from hitchopt.checks.registry import RULES, names_of
from hitchopt.checks.violations import infeasible_error, named_checks
from hitchopt.drones.controllers import Gains, Tube, of_same_firmware, stiffest_gains
from hitchopt.errors import EXCHANGED, InfeasibleError, StepPlace, Violation
from hitchopt.hitch import Quadrotor, Team
from hitchopt.hitch.requirements import Requirements
from hitchopt.motion.flight import Flight
from hitchopt.motion.motion import Motion
from hitchopt.steps.step import Step
from hitchopt.values.fields import with_fields

WIDENED = names_of(rule for rule in RULES if rule.pairs and rule is not FLOOR)
"""Checks of distances that ``limits.tracking`` increases: not of the floor, where drones stand."""


def with_tracking_advice(
    error: InfeasibleError, requirements: Requirements, team: Team
) -> InfeasibleError:
    """Return an error with advice on distances that only tracking errors make too short."""
    if not (tube := requirements.limits.tube).level:
        return error
    stiffer = ""
    if tube == Tube.of(team.tracking) and can_be_stiffer(team.quadrotor):
        stiffer = "use stiffer gains"
        if any(len(of_same_firmware(x.controller)) > 1 for x in team.quadrotor if x.controller):
            stiffer += " or another controller"
        advice = (
            f"{stiffer}, since its tracking errors of {tube} add to this distance; set "
            "limits.tracking only to measured errors"
        )
    else:
        advice = f"lower limits.tracking, but only to measured errors: {tube} adds to this distance"
    violations = list[Violation]()
    for each in error.violations:
        in_reach = (
            each.unit != "m" or each.limit - each.value <= 2.0 * tube.largest
        )  # of two bodies
        if each.constraint in WIDENED and in_reach:
            violations.append(replace(each, remedy=_remedy(each, advice)))
        elif each.constraint == "tracking_radius" and stiffer:
            violations.append(replace(each, remedy=_remedy(each, stiffer)))
        else:
            violations.append(each)
    return error.with_violations(violations)


def with_tilt_advice(
    error: InfeasibleError, requirements: Requirements, team: Team
) -> InfeasibleError:
    """Return an error that says where controllers, not ``limits.tilt``, limit the tilt."""
    largest_tilt = float(np.min(team.max_tilt))
    if requirements.limits.tilt < largest_tilt:
        return error
    by_controllers = f"the controllers tilt by at most {math.degrees(largest_tilt):.3g}°"
    violations = list[Violation]()
    for violation in error.violations:
        is_silent = violation.constraint == "tilt" and by_controllers not in violation.remedy
        remedy = f"{violation.remedy}; {by_controllers}" if is_silent else violation.remedy
        violations.append(replace(violation, remedy=remedy))
    return error.with_violations(violations)


def placed_in_step(error: InfeasibleError, first: int, group: Sequence[Step]) -> InfeasibleError:
    """Return the error with the step's name from the file in each violation."""
    of_group = tuple(StepPlace(i, step.name) for i, step in enumerate(group, first))
    violations = []
    for violation in error.violations:
        steps = tuple(
            _named_place(place, step)
            for place in violation.steps
            for i, step in enumerate(group, first)
            if i == place.step
        )
        remedy = _remedy(violation, "omit blend" if len(group) > 1 else "")
        violations.append(replace(violation, steps=steps or of_group, remedy=remedy))
    return error.with_violations(violations)


def _named_place(place: StepPlace, step: Step) -> StepPlace:
    """Return a place with the step's name from the file before that of another phase."""
    return StepPlace(place.step, step.name, "" if place.name == step.name else place.name)


def refusal(motion: Motion, certificate: Certificate, steps: Sequence[Step]) -> InfeasibleError:
    """Return the error of a failed certificate with advice that depends on the steps."""
    error = infeasible_error(certificate, motion)
    named = named_checks(certificate, Flight.of(motion))
    violations = []
    for unnamed, check in zip(error.violations, named, strict=True):
        places = tuple(_named_place(place, steps[place.step]) for place in unnamed.steps)
        violation = replace(unnamed, steps=places)
        indices = [p.step for p in motion.phases if p.start <= check.time <= p.end]
        neighbours = [steps[i] for k in indices for i in (k - 1, k) if i >= 0]
        is_blended = any(step.blends for step in neighbours)
        if check.name == DURATION.name:
            violations.append(replace(violation, remedy=_duration_remedy(steps)))
            continue
        binding = check.binding or check.name
        if binding == ARENA.name:
            binding = nearest_wall(motion, check)
        of_steps = (steps[k].advice(binding, f"mission[{k}].{steps[k].name}") for k in indices)
        advice = next(filter(None, of_steps), "omit blend" if is_blended else "")
        violations.append(replace(violation, remedy=_remedy(violation, advice)))
    return error.with_violations(violations)


def _remedy(violation: Violation, advice: str) -> str:
    """Return the remedy of a violation with further advice; a question stays at its end."""
    if not advice:
        return violation.remedy
    remedy = violation.remedy
    question = ""
    if remedy.endswith(EXCHANGED):
        remedy = remedy.removesuffix(EXCHANGED)
        question = EXCHANGED
    return f"{remedy}, or {advice}{question}"


def _duration_remedy(steps: Sequence[Step]) -> str:
    """Return how to keep the largest duration of a plan, whose steps may prescribe theirs."""
    prescribed = [
        f"mission[{i}].{step.name}.{step.time_key}"
        for i, step in enumerate(steps)
        if step.prescribed_duration is not None
    ]
    remedies = ["raise limits.duration"]
    if len(prescribed) < len(steps):
        remedies.append("raise the limits of motion")
    if prescribed:
        remedies.append(f"lower {' or '.join(prescribed)}")
    return ", or ".join(remedies)


def can_be_stiffer(kinds: Sequence[Quadrotor]) -> bool:
    """Return whether a controller of some firmware has smaller errors with other gains."""
    errors = (
        [Tube.of(each.loop.tracking).largest for each in (stiffest(kind), kind)]
        for kind in kinds
        if kind.controller is not None
    )
    return any(smallest < error for smallest, error in errors)


def stiffest(kind: Quadrotor) -> Quadrotor:
    """Return a quadrotor with the controller of its firmware that has the smallest errors.

    On a Crazyflie that is mellinger. A quadrotor without a named controller stays as it is.
    """
    if kind.controller is None:
        return kind
    name = "mellinger" if "mellinger" in of_same_firmware(kind.controller) else kind.controller
    gains = stiffest_gains(kind.mass, kind.latency, name)
    return with_fields(kind, controller=name, gains=Gains.of(gains))
