"""The study file key by key, read and checked like a problem file."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, ConfigDict, ValidationError, model_validator

from hitchopt.errors import FileError, InputError
from hitchopt.mission.schema import MAX_TITLE, Keys, fault, key
from hitchopt.mission.wording import translated
from hitchopt.storage.plain import Plain, plain
from hitchopt.storage.yaml_file import read_yaml
from hitchopt.sweeps.parameters import Drawn, Listed, Parameter
from hitchopt.sweeps.study import Study, names_drawing

MAX_SAMPLES = 100_000
"""Largest number of samples of the parameters that are drawn."""


class GridKeys(Keys):
    """Values at even distances, the ends among them."""

    model_config = ConfigDict(populate_by_name=True)
    low: float = key("First value", alias="from", examples=[0.0])
    high: float = key("Last value", alias="to", examples=[0.3])
    count: int = key("Number of values", ge=2, le=MAX_SAMPLES, examples=[4])
    log: bool = key("Even in the logarithm", False)


class RangeKeys(Keys):
    """A range from which values are drawn."""

    model_config = ConfigDict(populate_by_name=True)
    low: float = key("Lower end", alias="from", examples=[0.2])
    high: float = key("Upper end", alias="to", examples=[0.6])
    log: bool = key("Even in the logarithm", False)


class ParameterKeys(Keys):
    """What values a parameter takes: one of four keys."""

    values: list[Any] | None = key(
        "Given values", None, alias="list", min_length=1, examples=[[0.3, 0.4]]
    )
    grid: GridKeys | None = key("Values at even distances", None)
    random: RangeKeys | None = key("Values drawn at random", None)
    quasi_random: RangeKeys | None = key(
        "Values of a Halton sequence, which fill the range evenly", None
    )

    @model_validator(mode="after")
    def _exactly_one(self) -> Self:
        given = [name for name in type(self).model_fields if getattr(self, name) is not None]
        if len(given) != 1:
            raise fault("one of list, grid, random, quasi_random", "keep one of them")
        for name in ("grid", "random", "quasi_random"):
            span = getattr(self, name)
            if span is not None and not span.low < span.high:
                raise fault("from below to", "exchange the two")
            if span is not None and span.log and span.low <= 0.0:
                raise fault("from above 0 where log is true", "leave out log")
        return self

    def parameter(self, key: str) -> Parameter:
        """Return the parameter of a key path."""
        import numpy as np

        if self.values is not None:
            return Listed(key, tuple(plain(value) for value in self.values))
        if self.grid is not None:
            span, space = self.grid, np.geomspace if self.grid.log else np.linspace
            return Listed(key, tuple(float(x) for x in space(span.low, span.high, span.count)))
        drawn = self.random or self.quasi_random
        assert drawn is not None
        return Drawn(key, drawn.low, drawn.high, drawn.log, self.random is None)


def _listed(value: object) -> object:
    return {"list": value} if isinstance(value, list) else value


class SimulateKeys(Keys):
    """Every plan is flown in the rope simulation."""

    seeds: int = key("Flights of every plan", 1, ge=1, le=100_000)
    seed: int = key("Seed of the first of them", 0, ge=0)
    preset: Literal["fast", "accurate"] = key("Resolution of ropes", "fast")
    drones: Literal["rigid", "point"] = key("Bodies of drones", "rigid")
    perturbed: bool = key("The usual perturbations", True)
    noise: float | None = key("Of measured positions [m]", None, ge=0)
    velocity_noise: float | None = key("Of velocities [m/s]", None, ge=0)
    wind: float | None = key("Force of gusts [N]", None, ge=0)
    steady_wind: float | None = key("Constant level force [N]", None, ge=0)
    cable_error: float | None = key("Of lengths, relative", None, ge=0)
    start_error: float | None = key("Of starts, per axis [m]", None, ge=0)
    friction: float | None = key("Replaces the team's", None, ge=0)
    density: float | None = key("Replaces the team's [kg/m]", None, gt=0)
    stiffness: float | None = key("Of position loops [N/m]", None, gt=0)


class SettleKeys(Keys):
    """Every plan's hitch is settled: where it rests, and with what tensions."""

    samples: int = key("Times over the taut hitch", 25, ge=1, le=1000)
    cable_length: float | None = key("Real length [m]", None, gt=0)
    cable_density: float | None = key("Real density [kg/m]", None, ge=0)
    stiffness: float | None = key("Of position loops [N/m]", None, gt=0)


class ExportKeys(Keys):
    """Every plan is exported."""

    format: str = key("Name of the format", examples=["skybrush"])


class StudyKeys(Keys):
    """A study: problems, parameters, and what is done with each of their combinations."""

    title: str = key("Title of the study", "", max_length=MAX_TITLE)
    problem: Any = key(
        "Path of a problem file, a list of paths, or a problem itself", examples=["triangle.yaml"]
    )
    parameters: dict[str, Annotated[ParameterKeys, BeforeValidator(_listed)]] = key(
        "What values a key takes; by its path in the problem file, or in this one",
        default_factory=dict,
    )
    samples: int = key("Of what is drawn", 1, ge=1, le=MAX_SAMPLES)
    seed: int = key("Seed of what is drawn", 0, ge=0)
    limit: float = key("Time limit of a plan [s]", 600.0, gt=0)
    simulate: SimulateKeys | None = key("Simulated flights", None)
    settle: SettleKeys | None = key("Statics", None)
    export: ExportKeys | None = key("Files for fleets", None)


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
    """Return the study that ``data`` describes with the keys of a study file.

    Parameters
    ----------
    data: the keys.
    directory: where problem files are.

    Raises
    ------
    FileError, InputError: as ``load_study``.
    """
    values = plain(data)
    try:
        keys = StudyKeys.model_validate(values)
    except ValidationError as error:
        raise translated(error, StudyKeys) from None
    assert isinstance(values, dict)
    parts: dict[str, Any] = {
        name: _section(keys, name) for name in ("simulate", "settle", "export")
    }
    parameters = tuple(each.parameter(key) for key, each in keys.parameters.items())
    study = Study(
        problems=tuple(_problems(values["problem"], Path(directory))),
        parameters=parameters,
        drawings=_drawings(parameters, Path(directory)),
        samples=keys.samples,
        seed=keys.seed,
        limit=keys.limit,
        title=keys.title,
        **parts,
    )
    study.check(keys_of_section)
    return study


def keys_of_section(name: str, values: Plain) -> dict[str, Plain]:
    """Return the keys of a section with its defaults; raises InputError for what is wrong."""
    try:
        keys = StudyKeys.model_validate({"problem": "", name: values})
    except ValidationError as error:
        raise translated(error, StudyKeys) from None
    return _section(keys, name) or {}


def _section(keys: StudyKeys, name: str) -> dict[str, Plain] | None:
    section = getattr(keys, name)
    return None if section is None else section.model_dump()


def _problems(given: Plain, directory: Path) -> list[tuple[str, dict[str, Plain]]]:
    """Return the name and the mapping of every problem."""
    if isinstance(given, dict):
        return [("problem", _with_outlines(given, directory))]
    files = given if isinstance(given, list) else [given]
    found = []
    for i, file in enumerate(files):
        if not isinstance(file, str) or not file:
            key = f"problem[{i}]" if isinstance(given, list) else "problem"
            raise InputError(key, file, "the path of a problem file", "write triangle.yaml")
        data = read_yaml(directory / file)
        if not isinstance(data, dict):
            raise FileError(f"{directory / file}: is no problem file")
        found.append((Path(file).stem, _with_outlines(data, (directory / file).parent)))
    if not found:
        raise InputError("problem", [], "at least one problem", "name a problem file")
    return found


def _drawings(parameters: tuple[Parameter, ...], folder: Path) -> dict[str, Plain]:
    """Return the outlines of all drawings that parameters list, relative to the study's folder."""
    files = {
        value
        for p in parameters
        if isinstance(p, Listed) and names_drawing(p.key)
        for value in p.values
        if isinstance(value, str)
    }
    return {file: _outline(folder / file) for file in files}


def _outline(path: Path) -> Plain:
    from hitchopt.outlines.outline_file import object_outline  # heavy: readers of drawings

    found: Plain = object_outline(path).tolist()
    return found


def _with_outlines(problem: dict[str, Plain], folder: Path) -> dict[str, Plain]:
    """Return a problem with outlines in place of its objects' drawings, relative to ``folder``.

    Workers elsewhere need no drawings then, and digests depend on what these show.
    """
    objects = problem.get("objects")
    if not isinstance(objects, dict):
        return problem
    inlined: dict[str, Plain] = {}
    for name, each in objects.items():
        inlined[name] = each
        if isinstance(each, dict) and isinstance(each.get("file"), str):
            rest = {key: value for key, value in each.items() if key != "file"}
            inlined[name] = rest | {"outline": _outline(folder / str(each["file"]))}
    return problem | {"objects": inlined}
