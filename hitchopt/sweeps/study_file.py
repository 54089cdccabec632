"""The study file key by key, read and checked like a problem file."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, ConfigDict, Field, ValidationError, model_validator

from hitchopt.errors import FileError, InputError
from hitchopt.mission.schema import MAX_TITLE, Keys, fault
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
    low: float = Field(alias="from", description="First value", examples=[0.0])
    high: float = Field(alias="to", description="Last value", examples=[0.3])
    count: int = Field(ge=2, le=MAX_SAMPLES, description="Number of values", examples=[4])
    log: bool = Field(default=False, description="Even in the logarithm")


class RangeKeys(Keys):
    """A range from which values are drawn."""

    model_config = ConfigDict(populate_by_name=True)
    low: float = Field(alias="from", description="Lower end", examples=[0.2])
    high: float = Field(alias="to", description="Upper end", examples=[0.6])
    log: bool = Field(default=False, description="Even in the logarithm")


class ParameterKeys(Keys):
    """What values a parameter takes: one of four keys."""

    values: list[Any] | None = Field(
        default=None, alias="list", min_length=1, description="Given values", examples=[[0.3, 0.4]]
    )
    grid: GridKeys | None = Field(default=None, description="Values at even distances")
    random: RangeKeys | None = Field(default=None, description="Values drawn at random")
    quasi_random: RangeKeys | None = Field(
        default=None, description="Values of a Halton sequence, which fill the range evenly"
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

    seeds: int = Field(default=1, ge=1, le=100_000, description="Flights of every plan")
    seed: int = Field(default=0, ge=0, description="Seed of the first of them")
    preset: Literal["fast", "accurate"] = Field(default="fast", description="Resolution of ropes")
    drones: Literal["rigid", "point"] = Field(default="rigid", description="Bodies of drones")
    perturbed: bool = Field(default=True, description="The usual perturbations")
    noise: float | None = Field(default=None, ge=0, description="Of measured positions [m]")
    velocity_noise: float | None = Field(default=None, ge=0, description="Of velocities [m/s]")
    wind: float | None = Field(default=None, ge=0, description="Force of gusts [N]")
    steady_wind: float | None = Field(default=None, ge=0, description="Constant level force [N]")
    cable_error: float | None = Field(default=None, ge=0, description="Of lengths, relative")
    start_error: float | None = Field(default=None, ge=0, description="Of starts, per axis [m]")
    friction: float | None = Field(default=None, ge=0, description="Replaces the team's")
    density: float | None = Field(default=None, gt=0, description="Replaces the team's [kg/m]")
    stiffness: float | None = Field(default=None, gt=0, description="Of position loops [N/m]")


class SettleKeys(Keys):
    """Every plan's hitch is settled: where it rests, and with what tensions."""

    samples: int = Field(default=25, ge=1, le=1000, description="Times over the taut hitch")
    cable_length: float | None = Field(default=None, gt=0, description="Real length [m]")
    cable_density: float | None = Field(default=None, ge=0, description="Real density [kg/m]")
    stiffness: float | None = Field(default=None, gt=0, description="Of position loops [N/m]")


class ExportKeys(Keys):
    """Every plan is exported."""

    format: str = Field(description="Name of the format", examples=["skybrush"])


class StudyKeys(Keys):
    """A study: problems, parameters, and what is done with each of their combinations."""

    title: str = Field(default="", max_length=MAX_TITLE, description="Title of the study")
    problem: Any = Field(
        description="Path of a problem file, a list of paths, or a problem itself",
        examples=["triangle.yaml"],
    )
    parameters: dict[str, Annotated[ParameterKeys, BeforeValidator(_listed)]] = Field(
        default_factory=dict,
        description="What values a key takes; by its path in the problem file, or in this one",
    )
    samples: int = Field(default=1, ge=1, le=MAX_SAMPLES, description="Of what is drawn")
    seed: int = Field(default=0, ge=0, description="Seed of what is drawn")
    limit: float = Field(default=600.0, gt=0, description="Time limit of a plan [s]")
    simulate: SimulateKeys | None = Field(default=None, description="Simulated flights")
    settle: SettleKeys | None = Field(default=None, description="Statics")
    export: ExportKeys | None = Field(default=None, description="Files for fleets")


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
    from hitchopt.outlines.outline_file import read_outline  # heavy: readers of drawings

    found: Plain = read_outline(path).tolist()
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
