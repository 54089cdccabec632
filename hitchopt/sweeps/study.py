"""A study: problems and parameters, the file that holds them, and the cases that they make."""

from __future__ import annotations

import hashlib
import itertools
import json
from collections.abc import Iterator, Mapping
from copy import deepcopy
from dataclasses import asdict, dataclass
from functools import cache
from importlib import metadata
from math import prod
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import BeforeValidator, ConfigDict, ValidationError, model_validator

from hitchopt.errors import FileError, InputError, OneLine
from hitchopt.mission.keys import MAX_TITLE
from hitchopt.mission.wording import translated
from hitchopt.steps.step_keys import Keys, fault
from hitchopt.steps.step_keys import key as option
from hitchopt.storage.yaml_file import Plain, key_path, plain, read_yaml, split_key

Point = dict[str, Plain]
"""One value of every parameter, by key path."""

SECTIONS = ("simulate", "settle", "export")
"""Sections of a study file that say what is done with a plan."""

MAX_CASES, MAX_SAMPLES = 1_000_000, 100_000
"""Largest number of cases of one study, more are a typing error; and of samples."""

LIBRARIES = ("hitchopt", "numpy", "scipy", "casadi", "toppra", "osqp", "ruckig", "mujoco")
"""Packages whose versions are part of every case's digest."""


class RangeKeys(Keys):
    """A range from which values are drawn."""

    model_config = ConfigDict(populate_by_name=True)
    low: float = option("Lower end", alias="from", examples=[0.2])
    high: float = option("Upper end", alias="to", examples=[0.6])
    log: bool = option("Even in the logarithm", False)

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if not self.low < self.high:
            raise fault("from below to", "exchange the two")
        if self.log and self.low <= 0.0:
            raise fault("from above 0 where log is true", "leave out log")
        return self

    def at(self, shares: Any) -> list[float]:
        """Return the values at shares of the range, 0 to 1."""
        if self.log:
            return [float(x) for x in self.low * (self.high / self.low) ** np.asarray(shares)]
        return [float(x) for x in np.interp(shares, [0.0, 1.0], [self.low, self.high])]


class GridKeys(RangeKeys):
    """Values at even distances, the ends among them."""

    count: int = option("Number of values", ge=2, le=MAX_SAMPLES, examples=[4])


class ParameterKeys(Keys):
    """What values a parameter takes: one of three keys."""

    values: list[Any] | None = option(
        "Given values", None, alias="list", min_length=1, examples=[[0.3, 0.4]]
    )
    grid: GridKeys | None = option("Values at even distances", None)
    random: RangeKeys | None = option("Values drawn at random", None)

    @model_validator(mode="after")
    def _exactly_one(self) -> Self:
        if (self.values, self.grid, self.random).count(None) != 2:
            raise fault("one of list, grid, random", "keep one of them")
        return self

    @property
    def listed(self) -> list[Plain]:
        """The listed values, each of which is taken with every value of the others."""
        if self.grid is not None:
            return list(self.grid.at(np.linspace(0.0, 1.0, self.grid.count)))
        return [plain(value) for value in self.values or ()]


def points(parameters: Mapping[str, ParameterKeys], samples: int, seed: int) -> list[Point]:
    """Return every combination of the listed values, with every sample of the drawn ones.

    Parameters
    ----------
    parameters: by key path, in the study's order, which is that of the points: the last listed one
        changes first, samples before it.
    samples: number of samples of the drawn ones; 1 counts where none is drawn.
    seed: of the samples.

    Raises
    ------
    InputError: more than MAX_CASES points.
    """
    drawn = {key: each.random for key, each in parameters.items() if each.random is not None}
    listed = {key: each.listed for key, each in parameters.items() if key not in drawn}
    samples = samples if drawn else 1
    count = prod(map(len, listed.values())) * samples
    if count > MAX_CASES:
        raise InputError("parameters", count, f"at most {MAX_CASES} combinations", "take fewer")
    chance = np.random.default_rng(seed)
    columns = {key: span.at(chance.random(samples)) for key, span in drawn.items()}
    found: list[Point] = []
    for values in itertools.product(*listed.values()):
        chosen: Point = dict(zip(listed, values, strict=True))
        for i in range(samples):
            chosen = {**chosen, **{key: column[i] for key, column in columns.items()}}
            found.append({key: chosen[key] for key in parameters})
    return found


def with_values(base: Mapping[str, Plain], point: Point) -> dict[str, Plain]:
    """Return a copy of a mapping in which the keys have the values of a point.

    Mappings that are missing on the way are made; lists are as long as they are.

    Raises
    ------
    InputError: no key path, or one that leads through a value, or past the end of a list.
    """
    made: dict[str, Plain] = deepcopy(dict(base))
    for key, value in point.items():
        parts = split_key(key)
        if not parts or key_path(parts) != key:
            bound = "a key path such as team.tension or mission[0].form.altitude"
            raise InputError("parameters", key, bound, "names with dots, places in brackets")
        inner: Any = made
        part: Any
        for part, following in itertools.zip_longest(parts, parts[1:]):
            if not isinstance(inner, list if isinstance(part, int) else dict):
                bound = "a place in brackets in a list, the name of a key in a mapping"
                remedy = f"what is there is of type {type(inner).__name__}"
                raise InputError(f"parameters.{key}", part, bound, remedy)
            if isinstance(part, int) and part >= len(inner):
                bound = f"below {len(inner)}, the list's length"
                raise InputError(f"parameters.{key}", f"[{part}]", bound, "count from 0")
            if following is None:
                inner[part] = deepcopy(value)
            elif isinstance(inner, dict):
                inner.setdefault(part, {} if isinstance(following, str) else [])
            inner = inner[part]
    return made


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
    simulate: dict[str, Plain] | None
    settle: dict[str, Plain] | None
    export: dict[str, Plain] | None
    seed: int | None
    limit: float

    @property
    def digest(self) -> str:
        """SHA-256 of all that the case's row depends on, versions of the libraries among it."""
        told = {**asdict(self), "versions": versions()}
        text = json.dumps(told, sort_keys=True, ensure_ascii=True, allow_nan=True)
        return hashlib.sha256(text.encode()).hexdigest()


@cache
def versions() -> dict[str, str]:
    """Return the versions that a row depends on, by package; empty where it is not installed."""
    found = dict.fromkeys(LIBRARIES, "")
    for name in LIBRARIES:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return found


class SimulateKeys(Keys):
    """Every plan is flown in the rope simulation."""

    seeds: int = option("Flights of every plan", 1, ge=1, le=100_000)
    seed: int = option("Seed of the first of them", 0, ge=0)
    preset: Literal["fast", "accurate"] = option("Resolution of ropes", "fast")
    perturbed: bool = option("The usual perturbations", True)
    noise: float | None = option("Of measured positions [m]", None, ge=0)
    velocity_noise: float | None = option("Of velocities [m/s]", None, ge=0)
    wind: float | None = option("Force of gusts [N]", None, ge=0)
    steady_wind: float | None = option("Constant level force [N]", None, ge=0)
    cable_error: float | None = option("Of lengths, relative", None, ge=0)
    start_error: float | None = option("Of starts, per axis [m]", None, ge=0)
    friction: float | None = option("Replaces the team's", None, ge=0)
    density: float | None = option("Replaces the team's [kg/m]", None, gt=0)
    stiffness: float | None = option("Of position loops [N/m]", None, gt=0)


class SettleKeys(Keys):
    """Every plan's hitch is settled: where it rests, and with what tensions."""

    samples: int = option("Times over the taut hitch", 25, ge=1, le=1000)
    cable_length: float | None = option("Real length [m]", None, gt=0)
    cable_density: float | None = option("Real density [kg/m]", None, ge=0)
    stiffness: float | None = option("Of position loops [N/m]", None, gt=0)


class ExportKeys(Keys):
    """Every plan is exported."""

    format: str = option("Name of the format", examples=["skybrush"])


def _as_list(value: object) -> object:
    return {"list": value} if isinstance(value, list) else value


class StudyKeys(Keys):
    """A study: problems, parameters, and what is done with each of their combinations."""

    title: str = option("Title of the study", "", max_length=MAX_TITLE)
    problem: Any = option(
        "Path of a problem file, a list of paths, or a problem itself", examples=["triangle.yaml"]
    )
    parameters: dict[str, Annotated[ParameterKeys, BeforeValidator(_as_list)]] = option(
        "What values a key takes; by its path in the problem file, or in this one",
        default_factory=dict,
    )
    samples: int = option("Of what is drawn", 1, ge=1, le=MAX_SAMPLES)
    seed: int = option("Seed of what is drawn", 0, ge=0)
    limit: float = option("Time limit of a plan [s]", 600.0, gt=0)
    simulate: SimulateKeys | None = option("Simulated flights", None)
    settle: SettleKeys | None = option("Statics", None)
    export: ExportKeys | None = option("Files for fleets", None)


@dataclass(frozen=True, eq=False)
class Study(OneLine):
    """Problems, parameters, and what is done with every combination of them.

    Attributes
    ----------
    keys: of the study file.
    problems: name of each, its folder, where its drawings are, and its keys.
    """

    keys: StudyKeys
    problems: tuple[tuple[str, Path, dict[str, Plain]], ...]

    def cases(self) -> Iterator[Case]:
        """Yield all cases in order: problems, points, seeds."""
        found = points(self.keys.parameters, self.keys.samples, self.keys.seed)
        for name, point, problem, done in self._at(found):
            seeds: list[int | None] = [None]
            if (flown := done["simulate"]) is not None:
                first = flown.pop("seed")
                seeds = list(range(first, first + flown.pop("seeds")))
            for seed in seeds:
                yield Case(name, point, problem, **done, seed=seed, limit=self.keys.limit)

    def _at(self, chosen: list[Point]) -> Iterator[tuple[str, Point, dict[str, Plain], Any]]:
        """Yield name, point, keys of the problem, and what is done, at every chosen point."""
        sections = {key: getattr(self.keys, key) for key in SECTIONS}
        own = {key: keys.model_dump() for key, keys in sections.items() if keys is not None}
        outlines: dict[Path, Plain] = {}
        for (name, folder, problem), point in itertools.product(self.problems, chosen):
            whole = with_values({**problem, **own}, point)
            done = {key: whole.pop(key, None) for key in SECTIONS}
            yield name, point, _with_outlines(whole, folder, outlines), done

    def check(self) -> None:
        """Raise InputError for paths and values that no problem or section can have.

        Every listed value is tried by itself; drawn ones at their first sample.
        """
        from hitchopt.mission.loading import any_problem_from_dict

        first = points(self.keys.parameters, self.keys.samples, self.keys.seed)[0]
        trials = [first]
        for key, each in self.keys.parameters.items():
            trials += [{**first, key: value} for value in each.listed[1:]]
            section = key.split(".")[0]
            if section in SECTIONS and getattr(self.keys, section) is None:
                remedy = f"add {section}: to the study"
                raise InputError(f"parameters.{key}", section, "a section of the study", remedy)
        for _, _, problem, done in self._at(trials):
            any_problem_from_dict(problem)
            _checked({"problem": "", **{key: keys for key, keys in done.items() if keys}})


def load_study(path: str | Path) -> Study:
    """Return the study in the YAML file at ``path``; problem files are relative to it.

    Raises
    ------
    FileError: a file that cannot be read.
    InputError: keys, types or values that are wrong, or a problem that is.
    """
    data = read_yaml(path)
    if not isinstance(data, dict):
        raise FileError(f"{path}: a study is a mapping with the keys problem and parameters")
    return study_from_dict(data, Path(path).parent)


def study_from_dict(data: Mapping[str, object], directory: str | Path = ".") -> Study:
    """Return the study that ``data`` describes, its files relative to ``directory``.

    Raises
    ------
    FileError, InputError: as ``load_study``.
    """
    values = plain(data)
    keys = _checked(values)
    assert isinstance(values, dict)
    study = Study(keys, tuple(_problems(values["problem"], Path(directory))))
    study.check()
    return study


def _checked(values: Plain) -> StudyKeys:
    """Return the keys of a study; raises InputError for what is wrong."""
    try:
        return StudyKeys.model_validate(values)
    except ValidationError as error:
        raise translated(error, StudyKeys) from None


def _problems(given: Plain, directory: Path) -> Iterator[tuple[str, Path, dict[str, Plain]]]:
    """Yield name, folder and mapping of every problem."""
    if isinstance(given, dict):
        yield "problem", directory, given
        return
    files = given if isinstance(given, list) else [given]
    if not files:
        raise InputError("problem", [], "at least one problem", "name a problem file")
    for i, file in enumerate(files):
        if not isinstance(file, str) or not file:
            key = f"problem[{i}]" if isinstance(given, list) else "problem"
            raise InputError(key, file, "the path of a problem file", "write triangle.yaml")
        path = directory / file
        data = read_yaml(path)
        if not isinstance(data, dict):
            raise FileError(f"{path}: is no problem file")
        yield path.stem, path.parent, data


def _with_outlines(
    problem: dict[str, Plain], folder: Path, known: dict[Path, Plain]
) -> dict[str, Plain]:
    """Return a problem with outlines in place of its objects' drawings, relative to ``folder``.

    Workers elsewhere need no drawings then, and digests depend on what these show. ``known`` are
    those that were read before, by path.
    """
    from hitchopt.geometry.drawings import object_outline  # heavy: readers of drawings

    objects = problem.get("objects")
    for each in objects.values() if isinstance(objects, dict) else ():
        if isinstance(each, dict) and isinstance(file := each.get("file"), str):
            path = folder / str(each.pop("file"))
            if path not in known:
                known[path] = object_outline(folder / file).tolist()
            each["outline"] = known[path]
    return problem
