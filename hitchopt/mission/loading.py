"""Loading of problems from files, or from mappings with the keys of one."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path

from pydantic import ValidationError

from hitchopt.errors import FileError, InputError
from hitchopt.mission.building import built_problem, built_swarm
from hitchopt.mission.file_models import ProblemKeys
from hitchopt.mission.problem import Problem
from hitchopt.mission.swarm_problem import SwarmProblem
from hitchopt.mission.swarm_schema import SwarmKeys
from hitchopt.storage.plain import Plain, plain
from hitchopt.storage.yaml_file import key_places, parse_yaml, place_of, read_text

_KINDS = {list: "a list", str: "only text", bool: "true or false"}


AnyProblem = Problem | SwarmProblem
"""A problem of a hitch, or of single drones."""


def read_problem(path: str | Path) -> AnyProblem:
    """Return the problem in the YAML file at ``path``, of a hitch or of single drones.

    Parameters
    ----------
    path: of the file; ``-`` is standard input.

    Raises
    ------
    FileError: a file that cannot be read as YAML.
    InputError: keys, types, counts, ranges or shapes that are wrong; JointInputError if several.
    """
    text, name = read_text(path)
    return parse_problem(text, name, Path(path).parent)


def parse_problem(text: str, name: str = "text", directory: Path = Path()) -> AnyProblem:
    """Return the problem in YAML, of a hitch or of single drones.

    Parameters
    ----------
    text: what a problem file holds.
    name: what messages call it.
    directory: where outlines of objects are.

    Raises
    ------
    FileError, InputError: as ``read_problem``.
    """
    try:
        return _problem_of(parse_yaml(text, name), name, directory)
    except InputError as error:
        places = key_places(text, name)
        raise error.located(partial(place_of, places)) from None


def _problem_of(data: Plain, name: str, directory: Path) -> AnyProblem:
    if not isinstance(data, dict):
        raise FileError(
            f"{name}: holds {_KINDS.get(type(data), 'a number')}, but a problem is a mapping with "
            f"the keys {', '.join(ProblemKeys.model_fields)}; `hitchopt init` writes one"
        )
    return any_problem_from_dict(data, directory)


def load_problem(path: str | Path) -> Problem:
    """Return the problem of a hitch in the YAML file at ``path``.

    Raises
    ------
    InputError: a problem of single drones; as ``read_problem``.
    FileError, UnsupportedError: as ``read_problem``.
    """
    return _of_a_hitch(read_problem(path))


def load_swarm(path: str | Path) -> SwarmProblem:
    """Return the problem of single drones in the YAML file at ``path``.

    Raises
    ------
    InputError: a problem of a hitch; as ``read_problem``.
    FileError: as ``read_problem``.
    """
    problem = read_problem(path)
    if not isinstance(problem, SwarmProblem):
        raise InputError("team", "robots", "a team of single drones", "use load_problem")
    return problem


def any_problem_from_dict(data: Mapping[str, object], folder: Path | None = None) -> AnyProblem:
    """Return the problem that ``data`` describes with the keys of a problem file in ``folder``.

    Raises
    ------
    InputError: as ``read_problem``.
    """
    values = plain(data)
    single = isinstance(values, dict) and _of_single_drones(values)
    try:
        if single:
            return built_swarm(SwarmKeys.model_validate(values), folder)
        return built_problem(ProblemKeys.model_validate(values), folder)
    except ValidationError as error:
        from hitchopt.mission.wording import translated

        raise translated(error, SwarmKeys if single else ProblemKeys) from None


def problem_from_dict(data: Mapping[str, object]) -> Problem:
    """Return the problem of a hitch that ``data`` describes; errors as ``load_problem``."""
    return _of_a_hitch(any_problem_from_dict(data))


def _of_a_hitch(problem: AnyProblem) -> Problem:
    if not isinstance(problem, Problem):
        raise InputError("team", "drones", "a team of catenary robots", "use load_swarm")
    return problem


def _of_single_drones(values: dict[str, Plain]) -> bool:
    """Return whether a problem file is one of single drones: its team counts those."""
    team = values.get("team")
    return isinstance(team, dict) and "drones" in team and "robots" not in team
