"""Studies: problems and parameters, their file, and the cases of all combinations."""

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

from hitchopt.errors import FileError, InputError, Missing, OneLine, short
from hitchopt.lab.simulation.settings import MAX_SEED, PRESETS, flight_keys
from hitchopt.mission.problem import TITLE
from hitchopt.storage.yaml_file import Plain, key_path, plain, read_yaml, split_key
from hitchopt.values.fields import (
    ANYTHING,
    FLAGS,
    Key,
    dict_of,
    either,
    integers,
    join_key,
    keys_of,
    list_of,
    mapping_of,
    plain_mapping_of,
    strings,
    words,
)
from hitchopt.values.units import NUMBER, POSITIVE

Point = dict[str, Plain]  # One value of every parameter, by key path

MAX_CASES = 1_000_000  # Maximum number of points of a study; more are a typing error

# Packages whose versions are part of every case's digest
LIBRARIES = ("hitchopt", "numpy", "scipy", "casadi", "toppra", "osqp", "ruckig", "mujoco")


@dataclass(frozen=True)
class GridKeys:
    """Evenly spaced values, including both ends."""

    low: Annotated[float, Key(NUMBER, "Lower end", 0.2, "from")]
    high: Annotated[float, Key(NUMBER, "Upper end", 0.6, "to")]
    count: Annotated[int, Key(integers(2, MAX_CASES), "Number of values", 4)]
    log: Annotated[bool, Key(FLAGS, "Logarithmic spacing")] = False

    def __post_init__(self) -> None:
        if not self.low < self.high:
            raise InputError("from", self.low, f"below to, {self.high:g}", "swap the two")
        if self.log and self.low <= 0.0:
            raise InputError("from", self.low, "above 0 if log is true", "omit log")


@dataclass(frozen=True)
class ParameterKeys:
    """Values of a parameter on a grid."""

    grid: Annotated[GridKeys, Key(mapping_of(GridKeys), "Evenly spaced values")]


PARAMETER = either(mapping_of(ParameterKeys), list_of(ANYTHING, 1))
Values = ParameterKeys | list[Any]


def parameter_values(values: Values) -> list[Plain]:
    """Return the values of a parameter in order."""
    if isinstance(values, list):
        return [plain(value) for value in values]
    space = np.geomspace if values.grid.log else np.linspace
    grid = values.grid
    return [*space(grid.low, grid.high, grid.count).tolist()]


def points(parameters: Mapping[str, Values]) -> list[Point]:
    """Return all combinations of values, those of the last parameter changing fastest."""
    values = [parameter_values(each) for each in parameters.values()]
    if (count := prod(map(len, values))) > MAX_CASES:
        raise InputError("parameters", count, f"at most {MAX_CASES} combinations", "list fewer")
    return [dict(zip(parameters, row, strict=True)) for row in itertools.product(*values)]


def with_values(base: Mapping[str, Plain], point: Point) -> dict[str, Plain]:
    """Return a copy of a mapping with the values of a point at its key paths.

    Missing mappings on a path are added. Raises InputError for an invalid key path, or one that
    leads through a scalar or past the end of a list.
    """
    result: dict[str, Plain] = deepcopy(dict(base))
    for key, value in point.items():
        parts: list[Any] = list(split_key(key))
        inner: Any = result if key_path(parts) == key else None
        parent: Any = None
        try:
            for part in parts:
                parent = inner
                if isinstance(part, int) is not isinstance(inner, list):
                    raise TypeError
                inner = inner[part] if isinstance(inner, list) else inner.setdefault(part, {})
            parent[parts[-1]] = deepcopy(value)
        except (TypeError, IndexError, AttributeError):
            bound = "a path to a key of a mapping or an entry of a list"
            remedy = "write it as team.tension or mission[0].form.altitude"
            raise InputError("parameters", key, bound, remedy) from None
    return result


@dataclass(frozen=True, eq=False)
class Case:
    """A problem at one point, and the options of its flight."""

    name: str  # of the problem
    point: Point
    problem: dict[str, Plain]  # keys of the problem file
    simulate: dict[str, Plain] | None  # keys of the simulated flight, if any
    seed: int | None
    limit: float  # time limit of planning [s]

    @property
    def digest(self) -> str:
        """SHA-256 of all inputs of the case's row, including versions of libraries."""
        return digest_of({**asdict(self), "versions": versions()})


def digest_of(content: Mapping[str, Any]) -> str:
    """Return the SHA-256 of plain data."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


@cache
def versions() -> dict[str, str]:
    """Return the versions of the installed LIBRARIES."""
    installed = {each.name.lower() for each in metadata.distributions() if each.name}
    return {name: metadata.version(name) for name in LIBRARIES if name in installed}


@dataclass(frozen=True)
class SimulateKeys:
    """Flights of every plan in the rope simulation."""

    seeds: Annotated[int, Key(integers(1, 100_000), "Flights per plan")] = 1
    seed: Annotated[int, Key(integers(0, MAX_SEED), "Seed of the first flight")] = 0
    preset: Annotated[str, Key(words(*PRESETS), "Resolution of ropes")] = "fast"
    perturbed: Annotated[
        bool, Key(FLAGS, "The usual perturbations; false if omitted with drones, which have theirs")
    ] = True


def simulate_keys() -> dict[str, Key]:
    """Return the keys of flights: those of ``SimulateKeys``, of perturbations and of settings.

    Without a value the latter are as usual, or as the plan states.
    """
    own = keys_of(SimulateKeys)
    others = flight_keys()
    optional = {name: replace(others[name], default=None) for name in others if name not in own}
    return own | optional


@dataclass(frozen=True)
class StudyKeys:
    """A study: problems, parameters, and options of all plans and flights."""

    problem: Annotated[
        Any,
        Key(ANYTHING, "Path of a problem file, a list of paths, or a problem", "triangle.yaml"),
    ]
    title: Annotated[str, Key(TITLE, "Title of the study")] = ""
    parameters: Annotated[
        dict[str, Values],
        Key(
            dict_of(PARAMETER, strings(1000)),
            "A list or a grid of values, by a key path in the problem file, or in this one",
        ),
    ] = field(default_factory=dict)
    limit: Annotated[float, Key(POSITIVE, "Time limit of a plan [s]")] = 600.0
    simulate: Annotated[
        dict[str, Plain] | None,
        Key(
            plain_mapping_of("SimulateKeys", "Simulated flights of every plan.", simulate_keys()),
            "Simulated flights",
        ),
    ] = None


STUDY = mapping_of(StudyKeys)


@dataclass(frozen=True, eq=False)
class Study(OneLine):
    """Problems, parameters, and options of all plans and flights.

    Attributes
    ----------
    keys: of the study file.
    problems: name, folder (of its drawings) and keys of each problem.
    """

    keys: StudyKeys
    problems: tuple[tuple[str, Path, dict[str, Plain]], ...]

    def cases(self) -> Iterator[Case]:
        """Yield all cases in order of problems, points and seeds."""
        for case in self._cases_at(points(self.keys.parameters)):
            options: Any = case.simulate
            first, count = (options.pop("seed"), options.pop("seeds")) if options else (None, 1)
            for seed in [None] if first is None else range(first, first + count):
                yield replace(case, seed=seed)

    def _cases_at(self, points: list[Point]) -> Iterator[Case]:
        """Yield the cases of all problems at some points, without seeds."""
        options = self.keys.simulate
        stated = {f"simulate.{name}" for name in options or ()}
        sections = {} if options is None else {"simulate": vars(SimulateKeys()) | options}
        outlines: dict[Path, Plain] = {}
        for (name, folder, base), point in itertools.product(self.problems, points):
            keys = with_values(base | sections, point)
            simulate: Any = keys.pop("simulate", None)
            if simulate and "simulate.perturbed" not in stated | point.keys():
                simulate["perturbed"] = simulate.get("drones") is None
            problem = _with_outlines(keys, folder, outlines)
            yield Case(name, point, problem, simulate, None, self.keys.limit)

    def check(self) -> None:
        """Raise InputError for invalid key paths and values of parameters, tested one at a time."""
        from hitchopt.mission.loading import problem_from_dict

        first = points(self.keys.parameters)[0]
        tests = [first]
        for key, values in self.keys.parameters.items():
            tests += [{**first, key: value} for value in parameter_values(values)[1:]]
            if key.split(".")[0] == "simulate" and self.keys.simulate is None:
                remedy = "add simulate: to the study"
                raise InputError(f"parameters.{key}", "simulate", "a section of the study", remedy)
        for case in self._cases_at(tests):
            try:
                problem_from_dict(case.problem)
            except InputError as error:
                parameter = next((key for key in case.point if error.key.startswith(key)), None)
                if parameter is None:
                    raise FileError(f"problem {case.name}: {error}") from None
                key = join_key("parameters", parameter)
                raise InputError(key, error.value, error.bound, error.remedy) from None
            STUDY.check("", {"problem": "", "simulate": case.simulate})


def study_from_dict(data: object, directory: str | Path = ".") -> Study:
    """Return the study of a mapping, with file names relative to ``directory``.

    Raises FileError for a problem file that cannot be read, and InputError for an invalid key, type
    or value of the study or of a problem.
    """
    values = plain(data)
    if not isinstance(values, dict):
        bound = "a mapping with the keys problem and parameters"
        raise InputError("study", short(values), bound, "see hitchopt.lab.sweeps.study.Study")
    if "problem" not in values and {"team", "teams"} & values.keys():
        remedy = "this is a problem: plan it with hitchopt solve, or name it in a study"
        raise InputError("problem", Missing(), "given", remedy)
    study = Study(STUDY.check("", values), tuple(_problems(values["problem"], Path(directory))))
    study.check()
    return study


def _problems(value: Any, directory: Path) -> Iterator[tuple[str, Path, dict[str, Plain]]]:
    """Yield name, folder and mapping of every problem."""
    if isinstance(value, dict):
        yield "problem", directory, value
        return
    files = [value] if isinstance(value, str) else value
    if not (isinstance(files, list) and files and all(isinstance(x, str) and x for x in files)):
        bound = "a problem, the path of its file, or several paths"
        raise InputError("problem", value, bound, "write triangle.yaml")
    for path in (directory / file for file in files):
        data = read_yaml(path)
        if not isinstance(data, dict):
            raise FileError(f"{path}: is not a problem file")
        yield path.stem, path.parent, data


def _with_outlines(
    problem: dict[str, Plain], folder: Path, outlines: dict[Path, Plain]
) -> dict[str, Plain]:
    """Return a problem with its objects' drawings, relative to ``folder``, replaced by outlines.

    Then workers need no drawings, and digests depend on the outlines. ``outlines`` is a cache.
    """
    from hitchopt.geometry.drawings import read_drawing  # heavy: readers of drawings

    objects = problem.get("objects")
    for each in objects.values() if isinstance(objects, dict) else ():
        if isinstance(each, dict) and isinstance(file := each.get("file"), str):
            path = folder / str(each.pop("file"))
            if path not in outlines:
                outlines[path] = read_drawing(folder / file).outline.tolist()
            each["outline"] = outlines[path]
    return problem
