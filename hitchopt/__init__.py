"""hitchopt plans how teams of quadrotors tie and reshape polygonal cable hitches in midair.

Names are imported when they are first used, so that ``import hitchopt`` stays light.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hitchopt.actions import (
        adjust,
        follow_vertex,
        form,
        hold,
        land,
        morph,
        move_edge,
        move_vertex,
        release,
        transport,
    )
    from hitchopt.checks import Certificate, CertificateError, Check, certify
    from hitchopt.checks.bounds.closest_pairs import Closeness
    from hitchopt.errors import (
        FileError,
        HitchoptError,
        InfeasibleError,
        InputError,
        TimeLimitError,
        UnsupportedError,
        Violation,
    )
    from hitchopt.exports.lint.linting import lint
    from hitchopt.geometry import ConvexArc, ConvexPolygon, regular_polygon
    from hitchopt.hitch import Hitch, Quadrotor, Swarm, Team
    from hitchopt.hitch.assignment import Assignment
    from hitchopt.mission.loading import load_problem, load_swarm, read_problem
    from hitchopt.mission.memory import forget
    from hitchopt.mission.problem import DronesStart, HitchStart, Problem
    from hitchopt.mission.repair import Change, Suggestion
    from hitchopt.mission.swarm_problem import SwarmProblem
    from hitchopt.motion.motion import Motion, Phase
    from hitchopt.motion.states import States
    from hitchopt.plan import Plan, closest, load
    from hitchopt.planners.forming.swap_settings import SwapSettings
    from hitchopt.planning import repair, separate, solve, suggestions
    from hitchopt.requirements import Arena, Limits, Prism, Separation
    from hitchopt.steps import (
        Adjust,
        FollowVertex,
        Form,
        Hold,
        Land,
        Morph,
        MoveEdge,
        MoveVertex,
        Release,
        Transport,
    )
    from hitchopt.trajectory import PiecewisePolynomial

_HOMES = {
    "Adjust": "steps",
    "Arena": "requirements",
    "Assignment": "hitch.assignment",
    "Certificate": "checks",
    "CertificateError": "checks",
    "Change": "mission.repair",
    "Check": "checks",
    "Closeness": "checks.bounds.closest_pairs",
    "ConvexArc": "geometry",
    "ConvexPolygon": "geometry",
    "DronesStart": "mission.problem",
    "FileError": "errors",
    "FollowVertex": "steps",
    "Form": "steps",
    "Hitch": "hitch",
    "HitchStart": "mission.problem",
    "HitchoptError": "errors",
    "Hold": "steps",
    "InfeasibleError": "errors",
    "InputError": "errors",
    "Land": "steps",
    "Limits": "requirements",
    "Morph": "steps",
    "Motion": "motion.motion",
    "MoveEdge": "steps",
    "MoveVertex": "steps",
    "Phase": "motion.motion",
    "PiecewisePolynomial": "trajectory",
    "Plan": "plan",
    "Prism": "requirements",
    "Problem": "mission.problem",
    "Quadrotor": "hitch",
    "Release": "steps",
    "Separation": "requirements",
    "States": "motion.states",
    "Suggestion": "mission.repair",
    "SwapSettings": "planners.forming.swap_settings",
    "Swarm": "hitch",
    "SwarmProblem": "mission.swarm_problem",
    "Team": "hitch",
    "TimeLimitError": "errors",
    "Transport": "steps",
    "UnsupportedError": "errors",
    "Violation": "errors",
    "adjust": "actions",
    "certify": "checks",
    "closest": "plan",
    "follow_vertex": "actions",
    "forget": "mission.memory",
    "form": "actions",
    "hold": "actions",
    "land": "actions",
    "lint": "exports.lint.linting",
    "load": "plan",
    "load_problem": "mission.loading",
    "load_swarm": "mission.loading",
    "morph": "actions",
    "move_edge": "actions",
    "move_vertex": "actions",
    "read_problem": "mission.loading",
    "regular_polygon": "geometry",
    "release": "actions",
    "repair": "planning",
    "separate": "planning",
    "solve": "planning",
    "suggestions": "planning",
    "transport": "actions",
}

__all__ = [
    "Adjust",
    "Arena",
    "Assignment",
    "Certificate",
    "CertificateError",
    "Change",
    "Check",
    "Closeness",
    "ConvexArc",
    "ConvexPolygon",
    "DronesStart",
    "FileError",
    "FollowVertex",
    "Form",
    "Hitch",
    "HitchStart",
    "HitchoptError",
    "Hold",
    "InfeasibleError",
    "InputError",
    "Land",
    "Limits",
    "Morph",
    "Motion",
    "MoveEdge",
    "MoveVertex",
    "Phase",
    "PiecewisePolynomial",
    "Plan",
    "Prism",
    "Problem",
    "Quadrotor",
    "Release",
    "Separation",
    "States",
    "Suggestion",
    "SwapSettings",
    "Swarm",
    "SwarmProblem",
    "Team",
    "TimeLimitError",
    "Transport",
    "UnsupportedError",
    "Violation",
    "adjust",
    "certify",
    "closest",
    "follow_vertex",
    "forget",
    "form",
    "hold",
    "land",
    "lint",
    "load",
    "load_problem",
    "load_swarm",
    "morph",
    "move_edge",
    "move_vertex",
    "read_problem",
    "regular_polygon",
    "release",
    "repair",
    "separate",
    "solve",
    "suggestions",
    "transport",
]


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module 'hitchopt' has no attribute '{name}'")
    value: object = getattr(import_module(f"hitchopt.{_HOMES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
