"""A study: problems and parameters, and the cases that they make."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, field
from functools import cache
from importlib import metadata
from typing import Any

from hitchopt.errors import InputError
from hitchopt.one_line import OneLine
from hitchopt.storage.plain import Plain
from hitchopt.sweeps.parameters import Listed, Parameter, Point, key_parts, points, with_values

Section = dict[str, Plain]
"""Keys of one section of a study file."""

LIBRARIES = ("hitchopt", "numpy", "scipy", "casadi", "toppra", "osqp", "ruckig")
"""Packages whose versions are part of every case's digest."""

SIMULATOR = "mujoco"
"""Package whose version counts where flights are simulated."""


@dataclass(frozen=True, eq=False)
class Case:
    """One plan, and what is done with it.

    Attributes
    ----------
    name: of the problem.
    point: value of every parameter.
    problem: keys of the problem file.
    simulate, settle, export: keys of what is done; None for nothing.
    seed: of the simulated flight; None where there is none.
    limit: time limit of the plan [s].
    """

    name: str
    point: Point
    problem: dict[str, Plain]
    simulate: Section | None
    settle: Section | None
    export: Section | None
    seed: int | None
    limit: float

    @property
    def digest(self) -> str:
        """SHA-256 of all that the case's row depends on, versions of the libraries among it."""
        told = {**asdict(self), "versions": versions(self.simulate is not None)}
        text = json.dumps(told, sort_keys=True, ensure_ascii=True, allow_nan=True)
        return hashlib.sha256(text.encode()).hexdigest()


@dataclass(frozen=True, eq=False)
class Study(OneLine):
    """Problems, parameters, and what is done with every combination of them.

    Parameters
    ----------
    problems: name of each, and its keys as in a problem file.
    parameters: parameters, by key path in the problem or in this study's own sections.
    samples: number of samples of parameters that are drawn.
    seed: of these samples.
    limit: time limit of every plan [s].
    simulate, settle, export: keys of these sections of a study file, or None.
    title: title.
    drawings: outlines of the drawings that parameters ``objects.NAME.file`` name, by file.
    """

    problems: tuple[tuple[str, dict[str, Plain]], ...]
    parameters: tuple[Parameter, ...] = ()
    samples: int = 1
    seed: int = 0
    limit: float = 600.0
    simulate: Section | None = None
    settle: Section | None = None
    export: Section | None = None
    title: str = ""
    drawings: Mapping[str, Plain] = field(default_factory=dict)
    _points: list[Point] = field(default_factory=list, repr=False)

    def __post_init__(self) -> None:
        self._points.extend(points(self.parameters, self.samples, self.seed))

    def cases(self) -> Iterator[Case]:
        """Yield all cases in order: problems, points, seeds."""
        for name, problem in self.problems:
            for point in self._points:
                yield from self._cases_at(name, problem, point)

    def _cases_at(self, name: str, problem: Mapping[str, Plain], point: Point) -> Iterator[Case]:
        sections = {key: getattr(self, key) for key in ("simulate", "settle", "export")}
        own = {key: keys for key, keys in sections.items() if keys is not None}
        whole = with_values({**problem, **own}, self._outlined(point))
        done: dict[str, Any] = {key: whole.pop(key, None) for key in sections}
        flown = done["simulate"]
        seeds: list[int | None] = [None]
        if isinstance(flown, dict):
            first, count = flown["seed"], flown["seeds"]
            seeds = list(range(first, first + count))
            done["simulate"] = {k: v for k, v in flown.items() if k not in {"seed", "seeds"}}
        for seed in seeds:
            yield Case(name, point, whole, **done, seed=seed, limit=self.limit)

    def _outlined(self, point: Point) -> Point:
        """Return a point with outlines in place of drawings, as problems have them."""
        made: Point = {}
        for key, value in point.items():
            if names_drawing(key) and isinstance(value, str):
                made[key.removesuffix("file") + "outline"] = self.drawings.get(value, value)
            else:
                made[key] = value
        return made

    def check(self, keys_of: Callable[[str, Plain], Section]) -> None:
        """Raise InputError for paths and values that no problem or section can have.

        Every listed value is tried by itself; drawn ones at their first sample.

        Parameters
        ----------
        keys_of: checks the keys of a section of the study, by name.
        """
        from hitchopt.mission.loading import any_problem_from_dict

        if not self._points:
            return
        trials = [self._points[0]]
        for p in self.parameters:
            if isinstance(p, Listed):
                trials += [{**self._points[0], p.key: value} for value in p.values[1:]]
            section = key_parts(p.key)[0]
            if section in {"simulate", "settle", "export"} and getattr(self, str(section)) is None:
                remedy = f"add {section}: to the study"
                raise InputError(f"parameters.{p.key}", section, "a section of the study", remedy)
        for _, problem in self.problems:
            for point in trials:
                case = next(self._cases_at("", problem, point))
                any_problem_from_dict(case.problem)
                for name in ("simulate", "settle", "export"):
                    if getattr(case, name) is not None:
                        keys_of(name, getattr(case, name))


def names_drawing(key: str) -> bool:
    """Return whether a key path is that of an object's drawing."""
    parts = key_parts(key)
    return parts[0] == "objects" and parts[-1] == "file"


@cache
def versions(simulated: bool) -> dict[str, str]:
    """Return the versions that a row depends on, by package."""
    names = (*LIBRARIES, SIMULATOR) if simulated else LIBRARIES
    return {name: _version(name) for name in names}


def _version(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return ""
