"""Plans for exports: off the origin, unequal cables and masses, an arena; swarms; long plans."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from hitchopt.checks import certify
from hitchopt.checks.certificate import Check
from hitchopt.exports.exporting import Export, export_flight
from hitchopt.exports.format import ExportTask, format_of
from hitchopt.exports.options import HOMES, ExportOptions
from hitchopt.exports.placing import ReferenceFrame, placeholder_fleet
from hitchopt.exports.verification import EXPORT_RULES
from hitchopt.hitch import Quadrotor, Swarm
from hitchopt.hitch.requirements import Arena, Limits, Requirements, Separation
from hitchopt.motion.flight import Flight
from hitchopt.motion.motion import Motion, Phase
from hitchopt.motion.plan_file import SavedPlan
from hitchopt.plan import Plan
from hitchopt.trajectory import PiecewisePolynomial
from tests.helpers.plans import planned_of

Array = NDArray[np.float64]

EACH_FORMAT = [
    pytest.param(name, marks=[pytest.mark.slow] if name == "mjcf" else []) for name in HOMES
]
"""Names of formats for tests of each one; ropes of mjcf settle for seconds."""

PROBLEM = {
    "title": 'A triangle with "quotes" and ünïcode',
    "team": {
        "robots": 3,
        "cable_length": [2.4, 2.6, 2.5],
        "cable_density": 0.002,
        "tension": [0.4, 0.45, 0.42],
        "quadrotor": [{"mass": 0.13 + 0.01 * k, "max_thrust": 2.6} for k in range(3)],
    },
    "arena": {"lower": [-3, -3, 0], "upper": [5, 6, 3]},
    "start": {"hitch": {"polygon": [[1.0, 0.5], [0.6, 2.0], [1.5, 2.1]], "altitude": 1.2}},
    "mission": [
        {"morph": {"polygon": [[1.0, 0.9], [0.6, 2.0], [1.5, 2.1]]}},
        {"hold": {"seconds": 0.3}},
        {"move_vertex": {"vertex": 1, "by": [-0.05, 0.1]}},
    ],
}


@lru_cache
def hitch_plan() -> Motion:
    return planned_of(PROBLEM).motion


def flown_checks(motion: Motion) -> dict[str, Check]:
    """The checks of exports for the plan itself, by name."""
    found = {rule.name: rule.check(motion, exported=True) for rule in EXPORT_RULES}
    return {name: check for name, check in found.items() if check is not None}


def swarm_of(places: Array, breaks: Array) -> Motion:
    """Drones through places (K, D, 3) at breaks (K,), at rest at each."""
    ends = np.zeros((4, len(breaks), *places.shape[1:]))
    ends[0] = places
    drones = PiecewisePolynomial.hermite(breaks, ends[:, :-1], ends[:, 1:])
    kinds = [Quadrotor(0.03 + 0.001 * i, 0.6) for i in range(places.shape[1])]
    return Motion.single(
        Swarm(len(kinds), quadrotor=kinds),
        Requirements(Limits(), Separation(), Arena([-5, -5, 0], [5, 5, 3])),
        drones,
        (Phase("morph", 0, float(breaks[0]), float(breaks[-1])),),
    )


@lru_cache
def swarm_plan() -> Motion:
    first = [[0.1, 0.2, 1.0], [1.1, 0.3, 1.1], [2.1, -0.4, 1.2]]
    second = [[0.3, 0.5, 1.0], [1.1, 0.6, 1.3], [2.4, -0.2, 1.2]]
    last = [[0.3, 0.5, 1.2], [1.4, 0.6, 1.3], [2.4, 0.2, 1.0]]
    return swarm_of(np.array([first, second, last]), np.array([0.0, 1.7, 3.4123]))


@lru_cache
def restless_plan() -> Motion:
    """Two drones on wavy lines that never rest until the end."""
    duration = 40.0
    t = np.linspace(0.0, duration, int(8 * duration) + 1)
    wave = 0.05 * np.sin(np.pi * t / duration) ** 2 * np.sin(2.0 * np.pi * 1.1 * t)
    there = np.stack([wave, 0.0 * t, 1.0 + 0.0 * t], axis=-1)
    ends = np.zeros((3, len(t), 2, 3))
    ends[0] = np.stack([there, there + [1.0, 0.0, 0.0]], axis=1)
    for order in (1, 2):
        ends[order, 1:-1] = np.gradient(ends[order - 1], t, axis=0)[1:-1]
    drones = PiecewisePolynomial.hermite(t, ends[:, :-1], ends[:, 1:])
    limits = Limits(speed=2.0, acceleration=20.0, jerk=1e4)
    requirements = replace(swarm_plan().requirements, limits=limits)
    phase = Phase("wave", 0, 0.0, duration)
    return Motion.single(Swarm(2), requirements, drones, (phase,))


def task_of(
    flown: Motion | Flight, name: str = "csv", rate: float | None = None, **place: object
) -> ExportTask:
    kind = format_of(name)
    options = ExportOptions(name, **place)  # type: ignore[arg-type]
    frame = ReferenceFrame(options.frame or kind.frames[0], options.origin, options.yaw)
    flight = Flight.of(flown)
    fleet = placeholder_fleet(flight.team.drone_names)
    return ExportTask(flight, "A plan", frame, fleet, rate or kind.rate, options)


def exported(flown: Motion | Flight, name: str, folder: Path, **options: Any) -> tuple[Export, ...]:
    """Export a flight, with slack cables where nothing holds their tension."""
    saved = SavedPlan(Flight.of(flown), "A plan")
    return export_flight(saved, ExportOptions(name, **{"allow_slack": True, **options}), folder)


def reflown(plan: Plan, motion: Motion) -> Plan:
    """Return a plan with another motion, and its certificate."""
    flight = Flight.of(motion)
    return replace(plan, flight=flight, certificate=certify(flight))
