"""Where a hitch is tied or untied: so high that no cable touches the ground."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hitchopt.hitch import Hitch
from hitchopt.motion.motion import Motion, Phase
from hitchopt.planners.forming.prehitch import PreHitch, find_prehitch
from hitchopt.planners.forming.turns import SwapSettings
from hitchopt.planners.path.rigid_path import RigidPath
from hitchopt.planners.timing.fly_path import fly
from hitchopt.requirements import Requirements
from hitchopt.steps.certified_motions import flying
from hitchopt.steps.free_cables import LEVEL
from hitchopt.steps.situation import StepTask
from hitchopt.values import Array

TIGHTENING = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Shares of the move from the pre-hitch to the hitch at which the cables' heights are sampled."""


@dataclass(frozen=True, eq=False)
class TyingSite:
    """A hitch at the altitude where it is tied.

    Attributes
    ----------
    hitch: at that altitude.
    pre: the pre-hitch there.
    """

    hitch: Hitch
    pre: PreHitch


def tying_site(
    hitch: Hitch, swap: SwapSettings, senses: Array | None, requirements: Requirements
) -> TyingSite:
    """Return where to tie or untie: at the hitch's own altitude, or as much higher as it takes.

    Parameters
    ----------
    hitch: to be tied or untied.
    swap: how the drones turn about each other.
    senses: (clasps,) how it was formed, to be reversed; None to choose them.
    requirements: what the plan must satisfy.
    """
    from hitchopt.planners.forming.approach import CLEARANCE, hover_altitude

    pre = find_prehitch(hitch, requirements.separation, swap)
    if senses is not None:
        pre = replace(pre, turns=pre.turns.with_senses(senses))
    floor, clearance = requirements.floor, CLEARANCE * requirements.separation.cable
    drawn = (pre.drones + share * (hitch.drones - pre.drones) for share in TIGHTENING)
    hanging = (hover_altitude(hitch.team, drones, floor, clearance) for drones in drawn)
    altitude = max(hitch.altitude, floor + clearance + pre.measures.lowest, *hanging)
    by = altitude - hitch.altitude
    if by <= LEVEL:
        return TyingSite(hitch, pre)
    high = Hitch(hitch.team, hitch.polygon, altitude, hitch.q_legs, hitch.roll)
    return TyingSite(high, replace(pre, turns=pre.turns.raised(by)))


def lifted(hitch: Hitch, altitude: float, name: str, task: StepTask) -> Motion:
    """Return the motion of the hitch straight up or down, as one phase of a step."""
    to = np.append(hitch.polygon.centroid, altitude)
    flight = fly(RigidPath(hitch, to, 0.0), task.requirements.limits)
    remark = "cables that hang need more room over the ground than the hitch"
    phase = Phase(name, task.index, 0.0, flight.duration, remark)
    return flying(flight, hitch.team, task.requirements, [phase])
