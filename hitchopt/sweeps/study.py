"""A study: problems and parameters, the file that holds them, and the cases that they make."""

from __future__ import annotations

import hashlib
import itertools
import json
from collections.abc import Iterator, Mapping
from copy import deepcopy
from dataclasses import asdict, dataclass, field, replace
from functools import cache
from importlib import metadata
from math import prod
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from hitchopt.errors import FileError, InputError, OneLine, short
from hitchopt.mission.problem import MAX_TITLE
from hitchopt.storage.yaml_file import Plain, key_path, plain, read_yaml, split_key
from hitchopt.values.fields import (
    ANYTHING,
    FLAGS,
    Key,
    Missing,
    dict_of,
    either,
    integers,
    join_key,
    list_of,
    mapping_of,
    strings,
    words,
)
from hitchopt.values.units import NONNEGATIVE, NUMBER, POSITIVE

Point = dict[str, Plain]
"""One value of every parameter, by key path."""

MAX_CASES = 1_000_000  # Largest number of points of one study; more are a typing error

# Packages whose versions are part of every case's digest
LIBRARIES = ("hitchopt", "numpy", "scipy", "casadi", "toppra", "osqp", "ruckig", "mujoco")


@dataclass(frozen=True)
class GridKeys:
    """Values at even distances, the ends among them."""

    low: Annotated[float, Key(NUMBER, "Lower end", 0.2, "from")]
    high: Annotated[float, Key(NUMBER, "Upper end", 0.6, "to")]
    count: Annotated[int, Key(integers(2, MAX_CASES), "Number of values", 4)]
    log: Annotated[bool, Key(FLAGS, "Even in the logarithm")] = False

    def __post_init__(self) -> None:
        if not self.low < self.high:
            raise InputError("from", self.low, f"below to, {self.high:g}", "exchange the two")
        if self.log and self.low <= 0.0:
            raise InputError("from", self.low, "above 0 where log is true", "leave out log")


@dataclass(frozen=True)
class ParameterKeys:
    """Values of a parameter that are not listed."""

    grid: Annotated[GridKeys, Key(mapping_of(GridKeys), "Values at even distances")]


PARAMETER = either(mapping_of(ParameterKeys), list_of(ANYTHING, 1))
Values = ParameterKeys | list[Any]


def values_in(given: Values) -> list[Plain]:
    """Return the values of a parameter in order."""
    if isinstance(given, list):
        return [plain(value) for value in given]
    space, grid = np.geomspace if given.grid.log else np.linspace, given.grid
    values: list[Plain] = space(grid.low, grid.high, grid.count).tolist()
    return values


def points(parameters: Mapping[str, Values]) -> list[Point]:
    """Return every combination of values, the last one's changing first; MAX_CASES at most."""
    values = [values_in(each) for each in parameters.values()]
    if (count := prod(map(len, values))) > MAX_CASES:
        raise InputError("parameters", count, f"at most {MAX_CASES} combinations", "list fewer")
    return [dict(zip(parameters, row, strict=True)) for row in itertools.product(*values)]


def with_values(base: Mapping[str, Plain], point: Point) -> dict[str, Plain]:
    """Return a copy of a mapping in which the keys have the values of a point.

    Missing mappings on the path are added. InputError for a key that is no key path, or leads
    through a value, or past the end of a list.
    """
    changed: dict[str, Plain] = deepcopy(dict(base))
    for key, value in point.items():
        parts: list[Any] = list(split_key(key))
        inner: Any = changed if key_path(parts) == key else None
        holder: Any = None
        try:
            for part in parts:
                holder = inner
                if isinstance(part, int) is not isinstance(inner, list):
                    raise TypeError
                inner = inner[part] if isinstance(inner, list) else inner.setdefault(part, {})
            holder[parts[-1]] = deepcopy(value)
        except (TypeError, IndexError, AttributeError):
            bound = "a path to a key of a mapping or a place in a list"
            remedy = "write it as team.tension or mission[0].form.altitude"
            raise InputError("parameters", key, bound, remedy) from None
    return changed


@dataclass(frozen=True, eq=False)
class Case:
    """One plan, and the options of its flight."""

    name: str  # of the problem
    point: Point
    problem: dict[str, Plain]  # keys of its file
    simulate: dict[str, Plain] | None  # keys of the simulated flight, if there is one
    seed: int | None
    limit: float  # of the plan's time [s]

    @property
    def digest(self) -> str:
        """SHA-256 of all that the case's row depends on, versions of the libraries among it."""
        return digest_of({**asdict(self), "versions": versions()})


def digest_of(content: Mapping[str, Any]) -> str:
    """Return the SHA-256 of plain data."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


@cache
def versions() -> dict[str, str]:
    """Return the versions that a row depends on, by installed package."""
    here = {each.name.lower() for each in metadata.distributions() if each.name}
    return {name: metadata.version(name) for name in LIBRARIES if name in here}


OrNot = float | None


@dataclass(frozen=True)
class SimulateKeys:
    """Every plan is flown in the rope simulation."""

    seeds: Annotated[int, Key(integers(1, 100_000), "Flights of every plan")] = 1
    seed: Annotated[int, Key(integers(0, 2**63 - 1), "Seed of the first of them")] = 0
    preset: Annotated[str, Key(words("fast", "accurate"), "Resolution of ropes")] = "fast"
    perturbed: Annotated[bool, Key(FLAGS, "The usual perturbations")] = True
    noise: Annotated[OrNot, Key(NONNEGATIVE, "Of measured positions [m]")] = None
    velocity_noise: Annotated[OrNot, Key(NONNEGATIVE, "Of velocities [m/s]")] = None
    wind: Annotated[OrNot, Key(NONNEGATIVE, "Force of gusts [N]")] = None
    steady_wind: Annotated[OrNot, Key(NONNEGATIVE, "Constant level force [N]")] = None
    cable_error: Annotated[OrNot, Key(NONNEGATIVE, "Of lengths, relative")] = None
    start_error: Annotated[OrNot, Key(NONNEGATIVE, "Of starts, per axis [m]")] = None
    friction: Annotated[OrNot, Key(NONNEGATIVE, "Replaces the team's")] = None
    density: Annotated[OrNot, Key(POSITIVE, "Replaces the team's [kg/m]")] = None
    stiffness: Annotated[OrNot, Key(POSITIVE, "Of position loops [N/m]")] = None


@dataclass(frozen=True)
class StudyKeys:
    """A study: problems, parameters, and options of all plans and flights."""

    problem: Annotated[
        Any,
        Key(ANYTHING, "Path of a problem file, a list of paths, or a problem", "triangle.yaml"),
    ]
    title: Annotated[str, Key(strings(MAX_TITLE), "Title of the study")] = ""
    parameters: Annotated[
        dict[str, Values],
        Key(
            dict_of(PARAMETER, strings(1000)),
            "A list or a grid of values, by a key path in the problem file, or in this one",
        ),
    ] = field(default_factory=dict)
    limit: Annotated[float, Key(POSITIVE, "Time limit of a plan [s]")] = 600.0
    simulate: Annotated[SimulateKeys | None, Key(mapping_of(SimulateKeys), "Simulated flights")] = (
        None
    )


STUDY = mapping_of(StudyKeys)


@dataclass(frozen=True, eq=False)
class Study(OneLine):
    """Problems, parameters, and options of all plans and flights.

    Attributes
    ----------
    keys: of the study file.
    problems: name of each, its folder, where its drawings are, and its keys.
    """

    keys: StudyKeys
    problems: tuple[tuple[str, Path, dict[str, Plain]], ...]

    def cases(self) -> Iterator[Case]:
        """Yield all cases in order: problems, points, seeds."""
        for case in self._at(points(self.keys.parameters)):
            options: Any = case.simulate
            first, count = (options.pop("seed"), options.pop("seeds")) if options else (None, 1)
            for seed in [None] if first is None else range(first, first + count):
                yield replace(case, seed=seed)

    def _at(self, chosen: list[Point]) -> Iterator[Case]:
        """Yield the cases at every chosen point, without their seeds."""
        options = None if self.keys.simulate is None else vars(self.keys.simulate)
        sections = {} if options is None else {"simulate": options}
        outlines: dict[Path, Plain] = {}
        for (name, folder, base), point in itertools.product(self.problems, chosen):
            keys = with_values(base | sections, point)
            simulate: Any = keys.pop("simulate", None)
            problem = _with_outlines(keys, folder, outlines)
            yield Case(name, point, problem, simulate, None, self.keys.limit)

    def check(self) -> None:
        """Raise InputError for paths and values that no problem or flight can have.

        Every value is tried by itself.
        """
        from hitchopt.mission.loading import any_problem_from_dict

        first = points(self.keys.parameters)[0]
        trials = [first]
        for key, each in self.keys.parameters.items():
            trials += [{**first, key: value} for value in values_in(each)[1:]]
            if key.split(".")[0] == "simulate" and self.keys.simulate is None:
                remedy = "add simulate: to the study"
                raise InputError(f"parameters.{key}", "simulate", "a section of the study", remedy)
        for case in self._at(trials):
            try:
                any_problem_from_dict(case.problem)
            except InputError as error:
                found = [key for key in case.point if error.key.startswith(key)]
                if not found:
                    raise FileError(f"problem {case.name}: {error}") from None
                key = join_key("parameters", found[0])
                raise InputError(key, error.value, error.bound, error.remedy) from None
            STUDY.check("", {"problem": "", "simulate": case.simulate})


def study_from_dict(data: object, directory: str | Path = ".") -> Study:
    """Return the study that a mapping describes, its files relative to ``directory``.

    Raises
    ------
    FileError: a problem file that cannot be read.
    InputError: keys, types or values that are wrong, or a problem that is.
    """
    values = plain(data)
    if not isinstance(values, dict):
        bound = "a mapping with the keys problem and parameters"
        raise InputError("study", short(values), bound, "see hitchopt.Study")
    if "problem" not in values and {"team", "teams"} & values.keys():
        remedy = "hitchopt solve plans it; a study names it, as problem: FILE"
        raise InputError("problem", Missing(), "given: this is a problem, no study", remedy)
    study = Study(STUDY.check("", values), tuple(_problems(values["problem"], Path(directory))))
    study.check()
    return study


def _problems(given: Any, directory: Path) -> Iterator[tuple[str, Path, dict[str, Plain]]]:
    """Yield name, folder and mapping of every problem."""
    if isinstance(given, dict):
        yield "problem", directory, given
        return
    files = [given] if isinstance(given, str) else given
    if not (isinstance(files, list) and files and all(isinstance(x, str) and x for x in files)):
        bound = "a problem, the path of its file, or several paths"
        raise InputError("problem", given, bound, "write triangle.yaml")
    for path in (directory / file for file in files):
        data = read_yaml(path)
        if not isinstance(data, dict):
            raise FileError(f"{path}: is no problem file")
        yield path.stem, path.parent, data


def _with_outlines(
    problem: dict[str, Plain], folder: Path, known: dict[Path, Plain]
) -> dict[str, Plain]:
    """Return a problem with outlines in place of its objects' drawings, relative to ``folder``.

    Workers need no drawings then, and digests depend on the outlines. ``known`` were read before.
    """
    from hitchopt.geometry.drawings import read_drawing  # heavy: readers of drawings

    objects = problem.get("objects")
    for each in objects.values() if isinstance(objects, dict) else ():
        if isinstance(each, dict) and isinstance(file := each.get("file"), str):
            path = folder / str(each.pop("file"))
            if path not in known:
                known[path] = read_drawing(folder / file).outline.tolist()
            each["outline"] = known[path]
    return problem
