"""Steps of a mission: records with their keys, planning and knobs.

A module's ``__all__`` names its steps; those of slices are in ``hitchopt.slices``. From these lists
follow the attributes of ``hitchopt``, the keys of problem files and the pages of the reference.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from importlib import import_module

from hitchopt.slices import by_module
from hitchopt.steps import moving
from hitchopt.steps.step import Step as Step
from hitchopt.steps.step import key_of


class StepKinds(Mapping[str, type[Step]]):
    """Kinds of steps by their keys in a problem file; a slice is imported with its first step."""

    def __init__(self, modules: Mapping[str, tuple[str, ...]]) -> None:
        self._places = {
            key_of(name): (module, name) for module in modules for name in modules[module]
        }

    def __getitem__(self, key: str) -> type[Step]:
        """Return the kind of steps with a key; raises KeyError for other words."""
        module, name = self._places[key]
        kind: type[Step] = getattr(import_module(f"hitchopt.{module}"), name)
        return kind

    def __iter__(self) -> Iterator[str]:
        return iter(self._places)

    def __len__(self) -> int:
        return len(self._places)

    @property
    def modules(self) -> dict[str, str]:
        """Modules in hitchopt by the names of their records."""
        return {name: module for module, name in self._places.values()}


_STEPS = {"steps.moving": tuple(moving.__all__), **by_module("steps")}
_DRONE_STEPS = by_module("drone_steps")

STEP_KINDS = StepKinds(_STEPS)
"""Kinds of steps of a team with cables, in the order in which a problem file's keys are listed."""

DRONE_STEP_KINDS = StepKinds(_DRONE_STEPS)  # Kinds of steps of single drones
ALL_STEP_KINDS = StepKinds(_STEPS | _DRONE_STEPS)  # All kinds of steps
