"""Errors of every field name all that its values may be, and whether it can be omitted."""

from __future__ import annotations

import pkgutil
import warnings
from collections.abc import Iterator
from dataclasses import is_dataclass
from functools import cache
from importlib import import_module
from typing import Any

import pytest

import hitchopt as ho
from hitchopt.values import form_of
from hitchopt.values.fields import EMPTY, Key, keys_of

WRONG: tuple[Any, ...] = (None, "neither", True, -7.5, [], {}, object())
"""Values of all forms, which fields of other forms refuse."""

TRIANGLE = [[0, -1], [-0.4, 0.5], [0.4, 0.5]]


def found_keys() -> Iterator[tuple[str, Key]]:
    """Yield the keys of all records of the package, by record and name."""
    for found in pkgutil.walk_packages(ho.__path__, "hitchopt."):
        module = vars(import_module(found.name))
        names = module if module.get("Key") is Key else {}
        for record in (each for each in names.values() if isinstance(each, type)):
            if is_dataclass(record) and record.__module__ == found.name != Key.__module__:
                for key in keys_of(record).values():
                    yield f"{record.__name__}.{key.name}", key


@cache
def keys() -> dict[str, Key]:
    """Return the keys of all records of the package, by record and name."""
    return dict(found_keys())


def error_of(key: Key, value: Any) -> ho.InputError | None:
    """Return the error of a value in a file; None if it is accepted."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ho.UnitWarning)
        try:
            key.from_file("here", value)
        except ho.InputError as error:
            return error
    return None


def words_of(key: Key) -> set[str]:
    """Return the valid words of a key."""
    return {word for word in key.file_kind.accepted if word.isidentifier()}


def test_errors_name_all_that_values_may_be() -> None:
    assert len(keys()) > 240
    for name, key in keys().items():
        kind = key.file_kind
        for wrong in WRONG:
            error = error_of(key, wrong)
            if form_of(wrong) not in kind.forms and error is not None:
                assert (error.key, error.bound) == ("here", kind.bound), name


def test_wrong_words_are_told_the_other_forms() -> None:
    for name, key in keys().items():
        error = error_of(key, "neither")
        if words_of(key) and error is not None:
            assert all(each in error.bound for each in key.file_kind.accepted), name


def test_words_that_errors_name_are_accepted() -> None:
    for name, key in keys().items():
        for word in words_of(key):
            assert error_of(key, {"true": True, "false": False}.get(word, word)) is None, name


def test_only_what_has_a_default_can_be_omitted() -> None:
    for name, key in keys().items():
        error = error_of(key, None)
        if error is not None:
            assert ("omit" in error.remedy) is (key.default is not EMPTY), name
    with pytest.raises(ho.InputError, match=r"cable_length = None: must be .*; set a value$"):
        ho.Team(3, None)  # type: ignore[arg-type]
    with pytest.raises(ho.InputError, match=r"speed = None: must be a number; .*, or omit it$"):
        ho.Limits(speed=None)  # type: ignore[arg-type]


def test_words_numbers_and_flags_are_named_together() -> None:
    for wrong in ("no", True, [1.0]):
        with pytest.raises(ho.InputError, match=r"settle = .*: must be auto, a number or false; "):
            ho.Morph(TRIANGLE, settle=wrong)  # type: ignore[arg-type]
