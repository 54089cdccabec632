"""The height of two clasps on an object, which hangs from them as from a hinge."""

from __future__ import annotations

import math

from hitchopt.checks.grips import MIN_HINGE
from hitchopt.errors import InfeasibleError, Violation
from hitchopt.hitch.requirements import Requirements
from hitchopt.objects import SolidObject
from hitchopt.planners.carrying.planner import MovePlanner

PREFERRED_HINGE = 0.15
"""[m] Preferred height of clasps above a centre of mass, as far below the top as drones may be off.
In simulation a drum tilted by up to 9° at 15 cm."""

EDGE = 0.02  # [m] Minimum distance of clasps to the top and the bottom of an object

RIM_DISTANCE = 0.03
"""[m] Preferred distance of clasps to a rim above them, which cables must not touch."""

HEIGHT_ROUNDING = 1e-9  # [m] Rounding of a height that equals its limit
MILLIMETRE_ROUNDING = 1e-3  # [mm] Rounding of a suggested height, which is in whole millimetres


def _height_error(requirements: Requirements) -> float:
    """Return the largest height error of drones [m]."""
    return requirements.limits.tube.largest or requirements.height_error


def needed_height(body: SolidObject, requirements: Requirements) -> float:
    """Return the lowest height of two clasps above an object's base [m] with which it hangs."""
    return float(body.centre_of_mass[2]) + MIN_HINGE + _height_error(requirements)


def clasp_height(body: SolidObject, requirements: Requirements) -> float:
    """Return the height of two clasps above an object's base [m]: safe, but below its rim."""
    lowest = needed_height(body, requirements)
    highest = body.upper - max(EDGE, _height_error(requirements))
    if body.rim is not None and body.rim.height - RIM_DISTANCE >= lowest:
        highest = min(highest, body.rim.height - RIM_DISTANCE)
    preferred = min(float(body.centre_of_mass[2]) + PREFERRED_HINGE, highest)
    return min(max(lowest, preferred), body.upper - EDGE)


def check_hinge(planner: MovePlanner) -> None:
    """Raise InfeasibleError if an object would tip over on two clasps that lift it."""
    hold = planner.hold
    body = planner.body
    if hold.team.robots != 2:
        return
    needed = needed_height(body, planner.requirements)
    if hold.height >= needed - HEIGHT_ROUNDING:
        return
    centre = float(body.centre_of_mass[2])
    highest = body.upper - EDGE
    suggested = math.ceil(1e3 * needed - MILLIMETRE_ROUNDING) / 1e3
    remedy = f"tie it at {suggested:g} m or higher above its base"
    if needed > highest:
        error = _height_error(planner.requirements)
        largest_error = highest - centre - MIN_HINGE
        allowed = "it is too low for two clasps"
        if largest_error > 0.0:
            allowed = f"it allows errors of {largest_error:.3g} m"
        remedy = (
            f"even clasps at {highest:.3g} m above its base, the highest place, let it tip over if "
            f"drones may be off by {error:.3g} m in height; {allowed}"
        )
    where = (planner.state.object,)
    when = "above the centre of mass, while it is lifted"
    value = hold.height - centre
    violation = Violation("hinge", value, needed - centre, "min", "m", where, when, remedy)
    raise InfeasibleError([violation])
