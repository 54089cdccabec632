"""Slices: capabilities in folders of their own, and all that the core has to ask them for.

The core imports no slice: it asks this table, which imports a slice's module when it is used. A
slice imports the core, and the slices of its ``needs``. Without its record and its folder, all else
works: its keys, commands and names are unknown.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib import import_module
from types import ModuleType
from typing import Any

from hitchopt.errors import UnsupportedError

Names = Mapping[str, tuple[str, ...]]  # Names by the module of a slice that defines them


@dataclass(frozen=True)
class Slice:
    """A slice; modules are relative to its folder, but those of commands.

    Functions are given by their places, ``module:name``. They are asked for by ``hooks``, to which
    all slices answer, or by ``provided``, to which one does.
    """

    name: str  # Its folder in hitchopt, and in tests
    needs: tuple[str, ...] = ()  # Slices that it imports
    steps: Names = field(default_factory=dict)  # Steps of missions, in the order of keys
    drone_steps: Names = field(default_factory=dict)  # The only step of single drones
    checks: tuple[str, ...] = ()  # Modules with rules and reports of certificates
    limits: tuple[str, ...] = ()  # Fields of ``Limits`` that these rules certify
    functions: Mapping[str, str] = field(default_factory=dict)  # Places that the core asks for
    names: Names = field(default_factory=dict)  # Public names of hitchopt
    room_names: Names = field(default_factory=dict)  # Names that scripts rarely need
    # Modules of its commands, relative to hitchopt, by headings of the help and names
    commands: Mapping[str, Mapping[str, str]] = field(default_factory=dict)


SLICES = (
    Slice(
        "friction",
        steps={"steps": ("Settle",)},
        checks=("shifts",),
        limits=("rest_shift",),
        functions={
            "after_step": "settling:with_settling",
            "notes": "shifts:rest_notes",
        },
    ),
    Slice(
        "forming",
        needs=("swarms",),
        steps={"steps": ("Form", "Release", "Land")},
        functions={"untie": "steps:untied"},
        names={"api": ("form",), "swap_settings": ("SwapSettings",)},
    ),
    Slice(
        "carrying",
        needs=("view",),
        steps={
            "steps": (
                "Enclose",
                "Grasp",
                "Lift",
                "Carry",
                "SetDown",
                "Loosen",
                "Leave",
                "TransportObject",
            )
        },
        functions={"held_rest": "held:held_rest"},
        names={"outline_fit": ("fit",)},
        room_names={"holding": ("Capacity", "Grip"), "outline_fit": ("Fit", "Holding")},
        commands={"Plan": {"fit": "carrying.commands"}},
    ),
    Slice(
        "swarms",
        drone_steps={"steps": ("Fly",)},
        names={"api": ("separate",), "steps": ("Fly",)},
    ),
    Slice(
        "teams",
        functions={
            "schedule": "planning:schedule_teams",
            "check_across": "across:check_across",
            "radius_across": "across:radius_across",
        },
    ),
    Slice(
        "repairs",
        needs=("carrying",),
        functions={
            "suggestions": "repair:find_suggestions",
            "changed_text": "changes:with_edits_in",
        },
        names={"api": ("repair", "suggestions")},
        room_names={"changes": ("Change",), "repair": ("Suggestion",)},
    ),
    Slice(
        "verify",
        functions={"contradictions": "request:contradictions"},
        commands={"Trust": {"verify": "cli.verifying"}},
    ),
    Slice(
        "view",
        functions={
            "card": "of_plans:card",
            "plot": "of_plans:plot",
            "draw": "of_plans:draw",
            "report": "of_plans:report",
            "view": "of_plans:view",
            "draw_closeness": "of_plans:closeness_picture",
        },
        commands={"Look": {"report": "view.commands", "view": "view.commands"}},
    ),
    Slice(
        "exports",
        needs=("view",),
        functions={"export": "exporting:export_plan"},
        names={"lint": ("lint",)},
        commands={"Fly": {"export": "exports.commands", "lint": "exports.commands"}},
    ),
    Slice(
        "live",
        needs=("exports",),
        functions={"abort": "abort:aborted"},
        names={"player": ("Player",), "replanner": ("Replanner",)},
        room_names={"player": ("Setpoints",), "replanner": ("Retarget",)},
        commands={"Fly": {"abort": "live.commands", "fly": "live.commands"}},
    ),
    Slice(
        "losses",
        needs=("live",),
        checks=("checks",),
        limits=("survive",),
        functions={
            "after_loss": "losing:after_loss_of",
            "after_loss_at_rest": "losing:after_loss_at_rest",
            "check_loss": "losing:check_loss",
            "dropped_at_rest": "losing:dropped_at_rest",
            "team_of_robot": "losing:team_of",
            "loss_table": "table:after_loss",
        },
        commands={"Fly": {"react": "losses.commands"}},
    ),
    Slice(
        "lab",
        needs=("exports", "view"),
        names={
            "flights.evaluation": ("evaluate",),
            "flights.readers": ("read_flight",),
            "simulation.report": ("simulate",),
            "statics.calibrate": ("calibrate",),
            "statics.equilibrium": ("equilibrium",),
            "statics.tolerance": ("tolerance",),
        },
        room_names={
            "flights.alignment": ("Alignment",),
            "flights.evaluation": ("Evaluation",),
            "flights.recordings": ("RecordedFlight", "Recording", "Signal", "Track"),
            "statics.calibrate": ("Calibration", "Estimate"),
            "statics.equilibrium": ("Equilibrium",),
            "statics.tolerance": ("ErrorSize", "Tolerance"),
        },
        commands={
            "Trust": {"simulate": "lab.cli.simulating", "statics": "lab.cli.estimates"},
            "Study": {"evaluate": "lab.cli.measuring", "calibrate": "lab.cli.estimates"},
        },
    ),
)
"""All slices."""


def place_of(each: Slice, place: str) -> Any:
    """Return what is at a place of a slice, ``module:name``; its module is imported."""
    module, _, name = place.partition(":")
    return getattr(module_of(each, module), name)


def module_of(each: Slice, module: str) -> ModuleType:
    """Return a module of a slice."""
    return import_module(f"hitchopt.{each.name}.{module}")


@cache
def hooks(name: str) -> tuple[Callable[..., Any], ...]:
    """Return the functions that slices provide under a name, in the order of SLICES."""
    return tuple(place_of(each, each.functions[name]) for each in SLICES if name in each.functions)


def provided(name: str) -> Callable[..., Any]:
    """Return the function that a slice provides under a name.

    Raises UnsupportedError if no slice does.
    """
    functions = hooks(name)
    if not functions:
        raise lacking(name)
    return functions[0]


def lacking(name: str) -> UnsupportedError:
    """Return the error about what no slice of this installation gives."""
    return UnsupportedError(f"{name}: this installation of hitchopt lacks the slice for it")


def check_modules() -> Iterator[ModuleType]:
    """Yield the modules of slices with rules and reports of certificates."""
    for each in SLICES:
        for module in each.checks:
            yield module_of(each, module)


def by_module(names: str) -> dict[str, tuple[str, ...]]:
    """Return the names of all slices by their modules in hitchopt; ``names`` is their field."""
    return {
        f"{each.name}.{module}": those
        for each in SLICES
        for module, those in getattr(each, names).items()
    }


def commands() -> dict[str, dict[str, str]]:
    """Return the commands of slices and their modules in hitchopt, by headings of the help."""
    found = dict[str, dict[str, str]]()
    for each in SLICES:
        for heading, names in each.commands.items():
            found[heading] = found.get(heading, {}) | dict(names)
    return found
