"""A problem file, or the same as a mapping, to a Problem."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from pydantic import ValidationError

from hitchopt.errors import FileError
from hitchopt.mission.building import built_problem
from hitchopt.mission.faults import JointInputError
from hitchopt.mission.plain import plain
from hitchopt.mission.problem import Problem
from hitchopt.mission.steps import ProblemKeys
from hitchopt.mission.wording import translated
from hitchopt.mission.yaml_file import read_yaml

__all__ = ["JointInputError", "load_problem", "problem_from_dict"]

_KINDS = {list: "a list", str: "only text", bool: "true or false"}


def load_problem(path: str | Path) -> Problem:
    """Return the problem in the YAML file at ``path``.

    Raises
    ------
    FileError: a file that cannot be read as YAML.
    InputError: keys, types, counts, ranges or shapes that are wrong; JointInputError if several.
    """
    data = read_yaml(path)
    if not isinstance(data, dict):
        raise FileError(
            f"{path}: holds {_KINDS.get(type(data), 'a number')}, but a problem is a mapping with "
            f"the keys {', '.join(ProblemKeys.model_fields)}; `hitchopt init` writes one"
        )
    return problem_from_dict(data)


def problem_from_dict(data: Mapping[str, object]) -> Problem:
    """Return the problem that ``data`` describes with the keys of a problem file.

    Raises
    ------
    InputError: as ``load_problem``.
    """
    try:
        keys = ProblemKeys.model_validate(plain(data))
    except ValidationError as error:
        raise translated(error) from None
    return built_problem(keys)
