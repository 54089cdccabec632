"""Records as JSON values: fields by their names, arrays as lists.

Plan files store the records of a motion, and requests are compared, in this form.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import cache
from types import NoneType, UnionType
from typing import Any, Union, get_args, get_origin, get_type_hints

import numpy as np

from hitchopt.errors import InputError
from hitchopt.geometry import ConvexPolygon
from hitchopt.hitch import Swarm, Team
from hitchopt.hitch.team import MEASURED, Quadrotor

REMEDY = "do not edit plan files"

PLANNER_ONLY = ("position_error", "height_ratio")
"""Fields of requirements that planners set, which plan files do not have."""

TOLERANCE = 1e-9
"""Largest relative difference of equal numbers: conversion of angles to degrees rounds them."""


def encoded(value: Any) -> Any:
    """Return a record as JSON values: fields by name, arrays as lists."""
    if isinstance(value, ConvexPolygon):
        value = value.vertices
    if isinstance(value, Swarm):
        value = {"drones": value.drones, "quadrotor": value.quadrotor}
    elif is_dataclass(value):
        values = {each.name: getattr(value, each.name) for each in fields(value)}
        if isinstance(value, Quadrotor):
            absent = [name for name in MEASURED if values[name] is None]
            values = {name: each for name, each in values.items() if name not in absent}
        value = values
    elif isinstance(value, tuple) and hasattr(value, "_asdict"):
        value = value._asdict()
    if isinstance(value, Mapping):
        return {name: encoded(each) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return [encoded(each) for each in value]
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    return value.value if isinstance(value, Enum) else value


_hints = cache(get_type_hints)


def decoded(kind: Any, value: Any) -> Any:
    """Return the value of a type from JSON values; constructors check records.

    Raises TypeError, ValueError, KeyError or InputError for values of another form.
    """
    origin, args = get_origin(kind), get_args(kind)
    known = {float: (float, int), int: (int,), str: (str,), bool: (bool,)}.get(kind)
    if known is not None and type(value) not in known:
        raise InputError("", value, f"of the type {kind.__name__}", REMEDY)
    if origin in (Union, UnionType):
        if value is None and NoneType in args:
            return None
        form: Any = tuple if isinstance(value, list) else type(value)
        arms = [each for each in args if each is not NoneType and get_origin(each) is not Mapping]
        fitting = [
            each
            for each in arms
            if get_origin(each) is form or (form is dict and is_dataclass(each))
        ]
        value = decoded((fitting or arms)[0], value)
    elif origin is tuple:
        kinds = args[:1] * len(value) if args[1:] == (...,) else args
        value = tuple(decoded(*each) for each in zip(kinds, value, strict=True))
    elif origin is not None and issubclass(origin, Mapping):
        value = {name: decoded(args[1], each) for name, each in value.items()}
    elif kind is Team and "drones" in value:
        kinds = decoded(tuple[Quadrotor, ...], value["quadrotor"])
        value = Swarm(value["drones"], quadrotor=kinds)
    elif (is_dataclass(kind) and kind is not ConvexPolygon) or hasattr(kind, "_fields"):
        hints, values = _hints(kind), dict[str, Any]()
        for name, each in value.items():
            if name not in hints:
                raise InputError(name, each, "a known key", REMEDY)
            try:
                values[name] = decoded(hints[name], each)
            except InputError as error:
                raise error.within(name) from error
        value = kind(**values)
    elif isinstance(kind, type) and issubclass(kind, Enum):
        value = kind(value)
    return value


def check_same(
    prefix: str, request: Any, value: Any, suffix: str, slack: Mapping[str, float] | None = None
) -> None:
    """Raise InputError with the key if JSON values or records differ from the requested ones.

    Numbers are equal within TOLERANCE, and within ``slack`` where keys begin so.
    """
    if isinstance(request, dict) and isinstance(value, dict):  # most records are exactly equal
        same = {k for k, x in request.items() if is_dataclass(x) and x == value.get(k)}
        request, value = ({k: x[k] for k in x if k not in same} for x in (request, value))
    requested, actual = (dict(_leaves(prefix, encoded(each))) for each in (request, value))
    for key in requested | actual:
        allowed = max([by for name, by in (slack or {}).items() if key.startswith(name)] or [0.0])
        in_both = key in requested and key in actual
        if not (in_both and _equal(requested[key], actual[key], allowed)):
            bound = f"{requested[key]!r} {suffix}" if key in requested else f"left out {suffix}"
            raise InputError(key, actual.get(key, "left out"), bound, REMEDY)


def _leaves(key: str, value: Any) -> Iterator[tuple[str, Any]]:
    """Yield single values and empty containers by their keys in the file."""
    if isinstance(value, dict) and value:
        for name, each in value.items():
            yield from _leaves(f"{key}.{name}".lstrip("."), each)
    elif isinstance(value, list) and value:
        for i, each in enumerate(value):
            yield from _leaves(f"{key}[{i}]", each)
    else:
        yield key, value


def _equal(request: Any, value: Any, slack: float) -> bool:
    """Return whether single values are equal, numbers within TOLERANCE and ``slack``."""
    if any(
        isinstance(each, bool) or not isinstance(each, int | float) for each in (request, value)
    ):
        return type(request) is type(value) and bool(request == value)
    return math.isclose(request, value, rel_tol=TOLERANCE, abs_tol=slack)
