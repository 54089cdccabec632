"""hitchopt plans how teams of quadrotors tie and reshape polygonal cable hitches in midair.

The public names are imported when they are first used: ``import hitchopt`` stays light.
"""

from __future__ import annotations

from importlib import import_module

PUBLIC_NAMES = {
    "api": ("export", "form", "morph", "morphs", "repair", "separate", "solve", "suggestions"),
    "checks": ("Certificate", "Check", "certify"),
    "checks.custom": ("ClaspSpans", "DroneSpans", "Rule", "VertexSpans"),
    "errors": ("HitchoptError", "InfeasibleError", "InputError", "UnitWarning"),
    "exports.lint": ("lint",),
    "geometry": ("ConvexArc", "ConvexPolygon", "regular_polygon"),
    "hitch": ("Hitch", "Quadrotor", "Swarm", "Team"),
    "hitch.casadi_model": ("model",),
    "drones.controllers": ("Gains", "Tube"),
    "hitch.requirements": ("Arena", "Limits", "Prism", "Separation"),
    "lab.flights.evaluation": ("evaluate",),
    "lab.flights.readers": ("read_flight",),
    "lab.simulation.report": ("simulate",),
    "lab.statics.calibrate": ("calibrate",),
    "outline_fit": ("fit",),
    "lab.statics.equilibrium": ("equilibrium",),
    "lab.statics.tolerance": ("tolerance",),
    "live.reacting": ("Player",),
    "live.replanner": ("Replanner",),
    "mission.cache": ("Cache",),
    "mission.loading": ("load_problem", "problem_from_dict"),
    "mission.others": ("Other",),
    "mission.problem": ("Problem",),
    "mission.starts": ("DronesStart", "HitchStart"),
    "motion.flight": ("Flight",),
    "motion.motion": ("Motion",),
    "objects": ("Rim", "Section", "SolidObject"),
    "plan": ("Plan", "closest", "combine", "load"),
    "planners.forming": ("SwapSettings",),
    "planners.path": ("Path",),
    "stages": ("route", "time"),
    "steps.flying": ("Fly",),
}
"""Public names by the module of this package that defines them; ``__init__.pyi`` has the same.

Records of steps are public too: their modules in ``hitchopt/steps`` name them.
"""

ROOM_NAMES = {
    "checks": ("CertificateError",),
    "checks.separation": ("Closeness",),
    "errors": ("FileError", "TimeLimitError", "UnsupportedError", "Violation"),
    "hitch.catenary": ("hanging_cable",),
    "drones.controllers": ("FlightController",),
    "hitch.holding": ("Capacity", "Grip"),
    "hitch.team": ("Assignment",),
    "lab.flights.alignment": ("Alignment",),
    "lab.flights.evaluation": ("Evaluation",),
    "lab.flights.recordings": ("RecordedFlight", "Recording", "Signal", "Track"),
    "lab.statics.calibrate": ("Calibration", "Estimate"),
    "outline_fit": ("Fit", "Holding"),
    "lab.statics.equilibrium": ("Equilibrium",),
    "lab.statics.tolerance": ("ErrorSize", "Tolerance"),
    "live.player": ("Setpoints",),
    "live.replanner": ("Retarget",),
    "mission.changes": ("Change",),
    "mission.repair": ("Suggestion",),
    "motion.flight": ("TeamMotion",),
    "motion.motion": ("Phase",),
    "motion.states": ("States",),
    "trajectory": ("PiecewisePolynomial",),
}
"""Names that scripts rarely need, by the module of this package that they are imported from."""

_MODULES = {name: f"hitchopt.{module}" for module, names in PUBLIC_NAMES.items() for name in names}

_ROOMS = {name: f"hitchopt.{module}" for module, names in ROOM_NAMES.items() for name in names}


def _steps() -> dict[str, object]:
    """Return the records of steps by name."""
    return {kind.__name__: kind for kind in import_module("hitchopt.steps").STEPS}


def _public_names() -> list[str]:
    """Return all public names."""
    return sorted([*_MODULES, *_steps()])


def __getattr__(name: str) -> object:
    """Import a public name from its module."""
    if name == "__version__":
        metadata = import_module("importlib.metadata")
        try:
            return metadata.version("hitchopt")
        except metadata.PackageNotFoundError:
            return "unknown: this checkout is not installed"
    if name == "__all__":
        return _public_names()
    if name in _ROOMS:
        raise AttributeError(
            f"'{name}' is not in hitchopt itself: from {_ROOMS[name]} import {name}"
        )
    if name in _MODULES:
        value: object = getattr(import_module(_MODULES[name]), name)
        return value
    # Only names of classes: `from hitchopt import verify` must not import steps
    steps = _steps() if name[:1].isupper() else {}
    if name not in steps:
        sentence = import_module("hitchopt.retired").gone(f"ho.{name}")
        raise AttributeError(sentence or f"module 'hitchopt' has no attribute '{name}'")
    return steps[name]


def __dir__() -> list[str]:
    return [*_public_names(), "__version__"]
