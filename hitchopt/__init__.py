"""hitchopt plans how teams of quadrotors reshape polygonal cable hitches in midair.

Names are imported when they are first used, so that ``import hitchopt`` stays light.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hitchopt.certificate import Certificate, CertificateError, Check, certify
    from hitchopt.errors import (
        FileError,
        HitchoptError,
        InfeasibleError,
        InputError,
        UnsupportedError,
        Violation,
    )
    from hitchopt.export.sampling import States
    from hitchopt.geometry import ConvexPolygon, regular_polygon
    from hitchopt.hitch import Arena, Hitch, Limits, Quadrotor, Separation, Team
    from hitchopt.mission.loading import load_problem
    from hitchopt.mission.problem import HitchStart, Hold, Morph, Problem
    from hitchopt.model.motion import Motion, Phase
    from hitchopt.plan import Plan, hold, load, morph, solve
    from hitchopt.trajectory import PiecewisePolynomial

_HOMES = {
    "Arena": "hitch",
    "Certificate": "certificate",
    "CertificateError": "certificate",
    "Check": "certificate",
    "ConvexPolygon": "geometry",
    "FileError": "errors",
    "Hitch": "hitch",
    "HitchStart": "mission.problem",
    "HitchoptError": "errors",
    "Hold": "mission.problem",
    "InfeasibleError": "errors",
    "InputError": "errors",
    "Limits": "hitch",
    "Morph": "mission.problem",
    "Motion": "model.motion",
    "Phase": "model.motion",
    "PiecewisePolynomial": "trajectory",
    "Plan": "plan",
    "Problem": "mission.problem",
    "Quadrotor": "hitch",
    "Separation": "hitch",
    "States": "export.sampling",
    "Team": "hitch",
    "UnsupportedError": "errors",
    "Violation": "errors",
    "certify": "certificate",
    "hold": "plan",
    "load": "plan",
    "load_problem": "mission.loading",
    "morph": "plan",
    "regular_polygon": "geometry",
    "solve": "plan",
}

__all__ = [
    "Arena",
    "Certificate",
    "CertificateError",
    "Check",
    "ConvexPolygon",
    "FileError",
    "Hitch",
    "HitchStart",
    "HitchoptError",
    "Hold",
    "InfeasibleError",
    "InputError",
    "Limits",
    "Morph",
    "Motion",
    "Phase",
    "PiecewisePolynomial",
    "Plan",
    "Problem",
    "Quadrotor",
    "Separation",
    "States",
    "Team",
    "UnsupportedError",
    "Violation",
    "certify",
    "hold",
    "load",
    "load_problem",
    "morph",
    "regular_polygon",
    "solve",
]


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module 'hitchopt' has no attribute '{name}'")
    value: object = getattr(import_module(f"hitchopt.{_HOMES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
