"""Numbers as callers have them: lists, scalars, and arrays of any library."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from hitchopt.errors import InputError

PLAIN = frozenset({float, int, bool, str, list, tuple, dict, type(None), np.float64, np.bool_})
"""Types of values that are not converted."""

NUMBERS, FLAGS = "iuf", "b"  # Kinds of numpy's types of real numbers, and of true and false


def plain(key: str, value: Any) -> Any:
    """Return an array of any library as one of numpy; others as they are.

    An array is whatever has ``__array__``: tensors of torch and jax, tables of pandas, polars and
    xarray. One without axes is returned as a number, one of objects and a range as lists.

    Raises
    ------
    InputError: an array of text, times or complex numbers; masked entries; a quantity with a unit.
    """
    kind = type(value)
    if kind in PLAIN or (kind is np.ndarray and value.ndim and value.dtype.kind in NUMBERS):
        return value
    if not hasattr(type(value), "__array__"):
        is_list = isinstance(value, Sequence) and not isinstance(value, str | bytes | bytearray)
        return list(value) if is_list and not isinstance(value, list | tuple) else value
    if unit := _unit(value):
        remedy = "convert it to SI units and pass its numbers alone"
        raise InputError(key, value, f"without a unit ({unit})", remedy)
    if np.ma.is_masked(value):
        raise InputError(key, value, "without masked entries", "fill or remove them")
    try:
        array = np.asarray(value)
    except (TypeError, ValueError, RuntimeError) as error:  # such as a tensor on another device
        raise InputError(key, value, "an array that numpy reads", f"convert it: {error}") from error
    if array.dtype.kind == "O":  # such as a table with missing values
        return array.tolist()
    if array.dtype.kind not in NUMBERS + FLAGS:
        raise InputError(key, value, f"real numbers, not {array.dtype}", _remedy(array.dtype.kind))
    return array if array.ndim else array[()]


def _unit(quantity: Any) -> str:
    """Return the unit that a quantity of pint, astropy or unyt, or a table states; else ""."""
    is_own = isinstance(quantity, np.ndarray | np.generic)
    wrapped = None if is_own else getattr(quantity, "data", None)  # the array of an xarray
    for holder in (quantity, wrapped):
        for name in ("units", "unit"):
            unit = getattr(holder, name, None)
            is_column = hasattr(unit, "__array__")  # of a table, by its name
            if unit is not None and not is_column and not callable(unit):
                return str(unit)
    attributes = getattr(quantity, "attrs", None)
    return str(attributes.get("units", "")) if isinstance(attributes, Mapping) else ""


def _remedy(kind: str) -> str:
    """Return what to do with an array of a kind of numpy's types that is none of numbers."""
    if kind == "m":
        return "divide it by np.timedelta64(1, 's')"
    if kind == "M":
        return "pass seconds from the start of the plan"
    if kind == "c":
        return "pass its real part"
    return "convert it to numbers, as array.astype(float) does"
