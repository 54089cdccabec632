"""hitchopt plans how teams of quadrotors tie and reshape polygonal cable hitches in midair.

The public names are imported when they are first used: ``import hitchopt`` stays light.
"""

from __future__ import annotations

from importlib import import_module

from hitchopt.slices import by_module

PUBLIC_NAMES = {
    "api": ("export", "morph", "morphs", "solve"),
    "checks": ("Certificate", "Check", "certify"),
    "checks.custom": ("ClaspSpans", "DroneSpans", "Rule", "VertexSpans"),
    "errors": ("HitchoptError", "InfeasibleError", "InputError", "UnitWarning"),
    "geometry": ("ConvexArc", "ConvexPolygon", "regular_polygon"),
    "hitch": ("Hitch", "Quadrotor", "Swarm", "Team"),
    "hitch.casadi_model": ("model",),
    "drones.controllers": ("Gains", "Tube"),
    "hitch.requirements": ("Arena", "Limits", "Prism", "Separation"),
    "mission.cache": ("Cache",),
    "mission.loading": ("load_problem", "problem_from_dict"),
    "mission.others": ("Other",),
    "mission.problem": ("Problem",),
    "mission.starts": ("DronesStart", "HitchStart"),
    "motion.flight": ("Flight",),
    "motion.motion": ("Motion",),
    "objects": ("Rim", "Section", "SolidObject"),
    "plan": ("Plan", "closest", "combine", "load"),
    "planners.path": ("Path",),
    "stages": ("route", "time"),
}
"""Public names of the core by the module that defines them; ``__init__.pyi`` has those of all.

Those of slices are in ``hitchopt.slices``; records of steps are public too.
"""

ROOM_NAMES = {
    "checks": ("CertificateError",),
    "checks.separation": ("Closeness",),
    "errors": ("FileError", "TimeLimitError", "UnsupportedError", "Violation"),
    "hitch.catenary": ("hanging_cable",),
    "drones.controllers": ("FlightController",),
    "hitch.team": ("Assignment",),
    "motion.flight": ("TeamMotion",),
    "motion.motion": ("Phase",),
    "motion.states": ("States",),
    "trajectory": ("PiecewisePolynomial",),
}
"""Names of the core that scripts rarely need, by the module that they are imported from."""


def _modules() -> dict[str, str]:
    """Return the modules of all public names but those of steps."""
    names = PUBLIC_NAMES | by_module("names")
    return {name: f"hitchopt.{module}" for module in names for name in names[module]}


def _rooms() -> dict[str, str]:
    """Return the modules of names that scripts rarely need."""
    names = ROOM_NAMES | by_module("room_names")
    return {name: f"hitchopt.{module}" for module in names for name in names[module]}


def _steps() -> dict[str, str]:
    """Return the modules of the records of steps by their names."""
    modules: dict[str, str] = import_module("hitchopt.steps").STEP_KINDS.modules
    return {name: f"hitchopt.{module}" for name, module in modules.items()}


def _public_names() -> list[str]:
    """Return all public names."""
    return sorted([*_modules(), *_steps()])


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
    if module := _rooms().get(name):
        raise AttributeError(f"'{name}' is not in hitchopt itself: from {module} import {name}")
    # Only names of classes: `from hitchopt import verify` must not import steps
    module = _modules().get(name) or (_steps().get(name) if name[:1].isupper() else None)
    if module is None:
        sentence = import_module("hitchopt.retired").gone(f"ho.{name}")
        raise AttributeError(sentence or f"module 'hitchopt' has no attribute '{name}'")
    value: object = getattr(import_module(module), name)
    return value


def __dir__() -> list[str]:
    return [*_public_names(), "__version__"]
