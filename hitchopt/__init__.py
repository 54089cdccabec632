"""hitchopt plans how teams of quadrotors tie and reshape polygonal cable hitches in midair.

The public names are imported when they are first used: ``import hitchopt`` stays light.
"""

from __future__ import annotations

from importlib import import_module

PUBLIC_NAMES = {
    "api": ("Mission", "export", "repair", "separate", "solve", "suggestions"),
    "checks": ("Certificate", "CertificateError", "Check", "certify"),
    "checks.custom": ("ClaspSpans", "DroneSpans", "Rule", "VertexSpans"),
    "checks.distances": ("Closeness",),
    "errors": (
        "FileError",
        "HitchoptError",
        "InfeasibleError",
        "InputError",
        "TimeLimitError",
        "UnitWarning",
        "UnsupportedError",
        "Violation",
    ),
    "exports.lint": ("lint",),
    "geometry": ("ConvexArc", "ConvexPolygon", "regular_polygon"),
    "hitch": ("Hitch", "Quadrotor", "Swarm", "Team"),
    "hitch.casadi_model": ("model",),
    "hitch.catenary": ("hanging_cable",),
    "hitch.flight_controller": ("FlightController", "Gains", "Tube"),
    "hitch.holding": ("Capacity", "Grip"),
    "hitch.requirements": ("Arena", "Limits", "Prism", "Separation"),
    "hitch.team": ("Assignment",),
    "lab.feedback": ("Feedback",),
    "lab.flights.alignment": ("Alignment",),
    "lab.flights.evaluation": ("Evaluation", "evaluate"),
    "lab.flights.hover": ("DroneHover", "HoverCalibration", "calibrate_hover"),
    "lab.flights.readers": ("read_flight",),
    "lab.flights.recordings": ("RecordedFlight", "Recording", "Signal", "Track"),
    "lab.simulation.report": ("simulate",),
    "lab.statics.calibrate": ("Calibration", "Estimate", "calibrate"),
    "lab.statics.fit": ("Fit", "Holding", "fit"),
    "lab.statics.equilibrium": ("Equilibrium", "equilibrium"),
    "lab.statics.tolerance": ("ErrorSize", "Tolerance", "tolerance"),
    "lab.sweeps.study": ("Study",),
    "lab.sweeps.sweep": ("SweepError", "load_sweep", "run_sweep"),
    "live.player": ("Player", "Setpoints"),
    "live.replanner": ("Replanner", "Retarget"),
    "mission.changes": ("Change",),
    "mission.loading": ("load_problem", "problem_from_dict"),
    "mission.others": ("Other",),
    "mission.problem": ("DronesStart", "HitchStart", "Problem"),
    "mission.repair": ("Suggestion",),
    "mission.solving": ("forget",),
    "motion.flight": ("Flight", "TeamMotion"),
    "motion.motion": ("Motion", "Phase"),
    "motion.states": ("States",),
    "objects": ("Rim", "Section", "SolidObject"),
    "plan": ("Plan", "closest", "combine", "load"),
    "planners.forming": ("SwapSettings",),
    "planners.morph.path": ("Path",),
    "single_steps": (
        "adjust",
        "follow_vertex",
        "form",
        "hold",
        "land",
        "morph",
        "move_edge",
        "move_vertex",
        "open_vertex",
        "release",
        "settle",
        "transport",
    ),
    "stages": ("route", "time"),
    "steps.carrying": (
        "Carry",
        "Enclose",
        "Grasp",
        "Leave",
        "Lift",
        "Loosen",
        "SetDown",
        "TransportObject",
    ),
    "steps.flying": ("Fly",),
    "steps.moving": (
        "Adjust",
        "FollowVertex",
        "Hold",
        "Morph",
        "MoveEdge",
        "MoveVertex",
        "Settle",
        "Transport",
    ),
    "steps.straddling": ("Tie", "Untie"),
    "steps.tying": ("CloseVertex", "Form", "Land", "OpenVertex", "Release"),
    "trajectory": ("PiecewisePolynomial",),
}
"""Public names by the module of this package that defines them; ``__init__.pyi`` has the same."""

_MODULES = {name: f"hitchopt.{module}" for module, names in PUBLIC_NAMES.items() for name in names}

__all__ = sorted(_MODULES)  # noqa: PLE0605, the names above


def __getattr__(name: str) -> object:
    """Import a public name from its module."""
    if name == "__version__":
        return import_module("importlib.metadata").version("hitchopt")
    if name not in _MODULES:
        raise AttributeError(f"module 'hitchopt' has no attribute '{name}'")
    value: object = getattr(import_module(_MODULES[name]), name)
    return value


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
