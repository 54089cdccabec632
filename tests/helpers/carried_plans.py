"""Objects that are carried in tests: a tray by rest; a drum and a stone by grip."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

import hitchopt as ho
from hitchopt.checks import Check
from hitchopt.checks.registry import RULE_OF
from hitchopt.motion.motion import Motion
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array
from tests.helpers.plans import planned_of

MASS, TO = 0.2, [-0.3, 0.9, 0.1]
"""Mass [kg] of the tray, and where it goes."""

DRUM, RADIUS = 0.1, 0.2
"""Mass [kg] and radius [m] of the drum."""


def tray(**changes: Any) -> dict[str, Any]:
    """A tray off the origin, to be set down on a low table, turned."""
    held = {"circle": 0.1, "to": 0.3, "mass": MASS, "at": [1.1, 0.2, 0.0], "yaw_deg": 20.0}
    held["rim"] = {"circle": 0.3, "at": 0.25}
    table = {"circle": 0.3, "to": 0.1, "at": [*TO[:2], 0.0], "fixed": True}
    step = {"object": "tray", "to": TO, "tension": 1.0, "yaw_deg": 40.0, "lift": 0.1}
    return {
        "team": {"robots": 3, "cable_length": 2.2, "tension": 0.8, "cable_density": 0.004},
        "limits": {"tilt_deg": 60},
        "objects": {"tray": {**held, **changes}, "table": table},
        "start": {"hitch": {"polygon": [[1.5, 0.2], [0.9, -0.1], [0.9, 0.5]], "altitude": 0.9}},
        "mission": [{"transport_object": step}],
    }


def drum(**changes: Any) -> dict[str, Any]:
    """A drum to be gripped, turned while it is carried."""
    held = {"circle": RADIUS, "to": 0.3, "mass": DRUM, "friction": 0.5, "at": [1.3, 0.2, 0.0]}
    step = {"object": "drum", "to": [1.0, 1.0, 0.0], "tension": 1.3, "lift": 0.1, "yaw_deg": 30}
    team = {"robots": 3, "cable_length": 1.6, "tension": 1.0, "cable_density": 0.004}
    return {
        "team": {**team, "cable_friction": 0.1},
        "limits": {"tilt_deg": 60},
        "objects": {"drum": {**held, **changes}},
        "start": {"hitch": {"polygon": [[1.8, 0.2], [1.0, -0.25], [1.0, 0.65]], "altitude": 0.8}},
        "mission": [{"transport_object": step}],
    }


def stone() -> dict[str, Any]:
    """A flat stone of nine corners, lopsided: edges bend round several of them."""
    angles = 0.1 - np.array([0.0, 0.6, 1.3, 2.1, 2.7, 3.5, 4.2, 4.8, 5.6])
    outline = np.column_stack([0.21 * np.cos(angles), 0.19 * np.sin(angles)])
    return drum(circle=None, outline=outline.tolist(), mass=0.05, friction=0.8)


@cache
def plan(name: str) -> ho.Plan:
    """Return the certified plan of one of them, which all tests share."""
    problem = {"tray": tray, "drum": drum, "stone": stone}[name]()
    found = planned_of(problem)
    assert found.certificate.certified
    return found


def check(motion: Motion, name: str) -> Check:
    """Return a check of the certificate that counts something."""
    found = RULE_OF[name].check(motion)
    assert found is not None
    return found


def lifted(motion: Motion) -> Array:
    """Times at which the object is off its support."""
    lift, down = (next(p for p in motion.phases if p.name == n) for n in ("lift", "set_down"))
    t = np.linspace(lift.start, down.end, 701)
    assert motion.load_share is not None
    return t[motion.load_share.at(t)[:, 0] > 1.0 - 1e-6]


def with_body(motion: Motion, name: str, **changes: Any) -> Motion:
    """Return the motion with another object of a name."""
    objects = dict(motion.requirements.objects)
    objects[name] = replace(objects[name], **changes)
    return motion.replaced(requirements=replace(motion.requirements, objects=objects))


def moved(part: PiecewisePolynomial | None, offset: list[float]) -> PiecewisePolynomial:
    assert part is not None
    return PiecewisePolynomial(part.breaks, part.coefficients + np.array(offset)[:, None])


def slipped(motion: Motion, angle: float, sunk: float = 0.0) -> Motion:
    """Return the motion in which the first object turns, and sinks [m], as it is carried.

    It does so bit by bit, at the joints of pieces.
    """
    (carry,), begins = [p for p in motion.phases if p.name == "carry"], motion.drones.breaks[:-1]
    c = motion.poses.coefficients.copy()
    share = np.clip((begins - carry.start) / (carry.end - carry.start), 0.0, 1.0)[:, None]
    heading = (c[:, 0, 3] + 1j * c[:, 0, 4]) * np.exp(1j * angle * share)
    c[:, 0, 2] -= sunk * share
    c[:, 0, 3:] = np.stack([heading.real, heading.imag], axis=1)
    return replace(motion, poses=motion.poses.replaced(c))
