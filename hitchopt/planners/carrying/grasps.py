"""Grasps: hitches that may hold an object, whether they do, and how much they could hold."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from hitchopt.checks.grips import GRIP_LIMIT
from hitchopt.errors import InfeasibleError, Violation, rounded_up, violations_at
from hitchopt.hitch.holding import Grip, grip_capacity
from hitchopt.hitch.requirements import Requirements, Separation
from hitchopt.motion.motion import HoldBy
from hitchopt.objects import Rim
from hitchopt.planners.candidates import Candidate, error_of, first_feasible
from hitchopt.planners.carrying.capacity import best_rim_hold, team_for_rim
from hitchopt.planners.carrying.holds import RIM_EDGE, GripHold, RestHold
from hitchopt.planners.carrying.planner import MovePlanner
from hitchopt.planners.carrying.polygons import rest_polygons
from hitchopt.planners.task import StepPlan, StepTask, require_certified
from hitchopt.values.fields import keys_of, with_fields

LENGTH_LIMITED = frozenset({"separation", "cable_clearance", "crossing"})
"""Constraints of a loaded hold that longer cables may satisfy, or shorter ones."""

CLOSING_MARGIN = 1.03
"""Factor of the separation limits as legs close below a rim, since motion reduces distances."""

ROLL_RESERVE = 1.3
"""Factor of the smallest roll of unloaded legs: a load brings legs closer together."""

RESERVES = (1.0, 0.5, 0.25)
"""Shares of a carry's acceleration at which holds are judged, the largest first."""

LOAD_LIMITED = frozenset({"load", "thrust", "tilt", "equilibrium", "grip"})
"""Constraints that only less weight or more capacity satisfies."""


def require_hold(task: StepTask, planner: MovePlanner) -> None:
    """Raise InfeasibleError if the hold breaks limits at rest, or as the hitch rises to a rim."""
    hold = planner.hold
    name = f"objects.{planner.state.object}"
    when = f"with {name} off its support"
    with violations_at(when):
        if isinstance(hold, RestHold):
            hold.check_unbent(planner.state.tension)
            violation = hold.rim_violation(planner.state.tension)
            if violation is not None:
                raise InfeasibleError([violation])
        lifted = planner.from_state(carried=True)
        at_rest = lifted.motion([lifted.rest(1.0)], "hold")
        require_certified(StepPlan(at_rest, task.before), when)
    if isinstance(hold, RestHold):
        when = f"as the clasps take {name}"
        with violations_at(when):
            moves = [planner.rim_move(planner.gap, 0.0), planner.transfer(0.0, 1.0)]
            taking = planner.motion(moves, "lift")
            require_certified(StepPlan(taking, task.before), when)


def reserve_of(planner: MovePlanner) -> float:
    """Return the largest of RESERVES with which the hold can be carried; 0 if none."""
    shares = (
        share for share in RESERVES if error_of(partial(planner.require_reserve, share)) is None
    )
    return next(shares, 0.0)


def hold_error(task: StepTask, planner: MovePlanner, error: InfeasibleError) -> InfeasibleError:
    """Return the error of a hold, with its capacity and a suggested change."""
    hold = planner.hold
    mass = planner.body.mass
    capacity = hold_capacity(planner, task.requirements)
    hardware = "use the number of robots that hitchopt fit recommends"
    if any(RIM_EDGE in violation.where for violation in error.violations):
        hardware = _other_robots(planner, task.requirements)
    if hold.by is not HoldBy.REST:
        hardware = "use rougher cables"
        if capacity.rim_mass >= mass:
            two_cables = hold.team.robots == 2
            rim = "rest it on a rim with three robots" if two_cables else "add a rim"
            hardware = f"{hardware}, or {rim}"
    remedy = (
        f"lower objects.{planner.state.object}.mass, or request a different tension, "
        f"or {hardware}{capacity.text}"
    )
    violations = list[Violation]()
    if mass > capacity.max_mass:
        where = (planner.state.object,)
        when = error.violations[0].when
        load = Violation("load", mass, capacity.max_mass, "max", "kg", where, when, remedy)
        violations.append(load)
    for violation in error.violations:
        alternatives = ""
        if violation.constraint == "tilt":
            alternatives += ", or raise limits.tilt_deg"
        if violation.constraint == "keep_out" and planner.state.object in violation.where:
            alternatives += ", or use longer cables"  # drones are beside the held object itself
        elif violation.constraint in LENGTH_LIMITED:
            alternatives += ", or use cables of a different length"
        elif violation.constraint not in LOAD_LIMITED:
            alternatives += f", or {violation.remedy}"
        violations.append(replace(violation, remedy=remedy + alternatives))
    return InfeasibleError(violations)


def _other_robots(planner: MovePlanner, requirements: Requirements) -> str:
    """Return what to use where legs cut a rim: another number of robots, if one holds it."""
    team = planner.hold.team
    cable_length = float(np.min(team.cable_length))
    other = team_for_rim(
        team.robots,
        planner.body,
        cable_length,
        float(np.min(planner.state.tension)),
        team.quadrotor[0],
        requirements,
        planner.gap,
    )
    if other is None:
        return "use a rounder rim"
    cables = ""
    if other.cable_length > cable_length:
        cables = f" with cables of {rounded_up(other.cable_length, 3):.3g} m or more"
    return f"use {other.robots} robots{cables}, whose legs stay below the rim"


class HoldCapacity(NamedTuple):
    """Masses that a hold, and a rim, can carry."""

    text: str
    """Both in words, in parentheses after a space; empty if neither can be computed."""

    max_mass: float
    """Maximum mass [kg] of the hold; inf if it cannot be computed."""

    rim_mass: float
    """Maximum mass [kg] on a rim; 0 if it cannot be computed."""


def hold_capacity(planner: MovePlanner, requirements: Requirements) -> HoldCapacity:
    """Return the capacities of the hold, and of a rim that at least three robots hold."""
    hold = planner.hold
    # Some bodies have no polygons of clasps
    candidate = Candidate("rim", lambda: _rim_capacity(planner, requirements))
    rim_mass = first_feasible([candidate], None)
    if isinstance(hold, GripHold):
        grip_mass = _grip_mass(planner, hold)
        rim = "" if rim_mass is None else f", a rim {rim_mass:.2g} kg"
        return HoldCapacity(f" (a grip holds {grip_mass:.2g} kg{rim})", grip_mass, rim_mass or 0.0)
    # Rolled legs may hold an object that unrolled ones do not
    if not rim_mass:
        return HoldCapacity("", np.inf, 0.0)
    max_mass = rim_mass if isinstance(hold, RestHold) else np.inf
    return HoldCapacity(f" (a rim holds {rim_mass:.2g} kg)", max_mass, rim_mass)


def _grip_mass(planner: MovePlanner, hold: GripHold) -> float:
    """Return the largest mass that a grip holds [kg]."""
    team, body = hold.team, planner.body
    cable_length = float(np.min(team.cable_length))
    tension = float(np.min(planner.state.tension))
    grip = Grip.of(body.section, hold.polygon, cable_length, tension, team.cable_friction)
    return grip_capacity(grip, team.quadrotor[0], body.friction, GRIP_LIMIT).mass


def _rim_capacity(planner: MovePlanner, requirements: Requirements) -> float:
    """Return the largest mass on the rim, or for a grip on its section as a rim [kg]."""
    team, body = planner.hold.team, planner.body
    polygons = planner.state.polygons
    if isinstance(planner.hold, GripHold):
        body = with_fields(body, rim=Rim(body.section, body.lower))
        robots = max(team.robots, 3)
        polygons = rest_polygons(planner.state.object, body, robots, planner.gap)[0]
    cable_length = float(np.min(team.cable_length))
    tension = float(np.min(planner.state.tension))
    best = best_rim_hold(body, polygons, cable_length, tension, team.quadrotor[0], requirements)
    return best.capacity.mass


def wider_for_closing(separation: Separation) -> Separation:
    """Return the distances to keep with the margin for closing."""
    wider = {key: CLOSING_MARGIN * getattr(separation, key) for key in keys_of(Separation)}
    return replace(separation, **wider)
