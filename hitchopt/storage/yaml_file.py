"""Reading YAML 1.2 that a stranger wrote: no tags, anchors or aliases, and never without bounds.

The library's parser only cuts the text into events; the values are made here, by the core schema
of YAML 1.2 (``1e-3`` is a number, ``yes`` is text), so nothing but plain data can come out.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.error import MarkedYAMLError, YAMLError
from ruamel.yaml.events import (
    AliasEvent,
    CollectionEndEvent,
    DocumentStartEvent,
    MappingStartEvent,
    NodeEvent,
    ScalarEvent,
    SequenceStartEvent,
)

from hitchopt.errors import FileError, InputError
from hitchopt.storage.plain import MAX_TEXT, Budget, Plain, key_path

MAX_BYTES = 4_000_000
"""Larger files are refused before they are read."""

_NULL = re.compile(r"(?:~|null|Null|NULL|)\Z")
_TRUE = re.compile(r"(?:true|True|TRUE)\Z")
_FALSE = re.compile(r"(?:false|False|FALSE)\Z")
_DECIMAL = re.compile(r"[-+]?[0-9]{1,300}\Z")
_BASED = re.compile(r"0(?:o[0-7]{1,300}|x[0-9a-fA-F]{1,200})\Z")
_FLOAT = re.compile(r"[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?\Z")
_SPECIAL = re.compile(r"(?:[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN))\Z")


@dataclass
class _Open:
    """A mapping or list whose end has not been reached."""

    value: dict[str, Plain] | list[Plain]
    key: str | None = None


def read_yaml(path: str | Path) -> Plain:
    """Return what the YAML file at ``path`` holds.

    Raises
    ------
    FileError: no such file, too large, not UTF-8 text, empty, or not YAML.
    InputError: a key twice or not text, too deeply nested or too many values.
    """
    name = str(path)
    return parse_yaml(_read_text(name), name)


def parse_yaml(text: str, name: str = "text") -> Plain:
    """Return what the YAML ``text`` holds; ``name`` is what messages call it.

    Raises
    ------
    FileError, InputError: as ``read_yaml``.
    """
    stack: list[_Open] = []
    budget = Budget()
    found: list[Plain] = []
    for event in _events(text, name):
        if isinstance(event, DocumentStartEvent) and found:
            raise _fault(name, event, "a second document begins here; keep one problem per file")
        if isinstance(event, CollectionEndEvent):
            stack.pop()
        elif isinstance(event, NodeEvent):
            _refuse_extras(name, event)
            if stack and isinstance(stack[-1].value, dict) and stack[-1].key is None:
                stack[-1].key = _new_key(name, event, stack)
                continue
            budget.spend(_path(stack))
            value = _value(event, stack)
            _put(value, stack, found)
            if isinstance(value, dict | list):
                stack.append(_Open(value))
    if not found or found[0] is None:
        raise FileError(f"{name}: is empty; `hitchopt init` writes a problem file to start from")
    return found[0]


def _read_text(name: str) -> str:
    try:
        with open(name, "rb") as file:
            data = file.read(MAX_BYTES + 1)
    except FileNotFoundError:
        raise FileError(f"{name}: no such file; check the path, or run `hitchopt init`") from None
    except IsADirectoryError:
        raise FileError(f"{name}: is a directory; give the problem file in it") from None
    except (OSError, ValueError) as error:  # ValueError: a NUL in the path
        reason = getattr(error, "strerror", None) or str(error)
        raise FileError(f"{name!r}: cannot be read ({reason}); give a readable file") from None
    if len(data) > MAX_BYTES:
        raise FileError(
            f"{name}: is larger than the {MAX_BYTES} bytes that a problem file may have"
        )
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise FileError(f"{name}: is UTF-16; save it as UTF-8")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise FileError(
            f"{name}: is not UTF-8 text (byte {error.start}); give a YAML file, saved as UTF-8"
        ) from None


def _events(text: str, name: str) -> Iterator[Any]:
    yaml = YAML(typ="safe", pure=True)
    try:
        yield from yaml.parse(StringIO(text))
    except MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        place = f":{mark.line + 1}:{mark.column + 1}" if mark is not None else ""
        reason = error.problem or error.context
        raise FileError(f"{name}{place}: is not YAML ({reason}); correct this line") from None
    except YAMLError as error:
        reason = str(error).splitlines()[0]
        raise FileError(f"{name}: is not YAML ({reason!r}); remove such characters") from None
    except Exception as error:  # whatever else the scanner trips over, such as "\U99999999"
        raise FileError(f"{name}: is not YAML ({error}); check its escapes") from None


def _refuse_extras(name: str, event: Any) -> None:
    if isinstance(event, AliasEvent):
        raise _fault(name, event, "aliases (*) are not allowed; write the value out")
    if event.anchor is not None:
        raise _fault(name, event, "anchors (&) are not allowed; write each value where it belongs")
    if event.ctag is not None:
        raise _fault(name, event, "tags (!) are not allowed; remove it")


def _new_key(name: str, event: Any, stack: list[_Open]) -> str:
    if not isinstance(event, ScalarEvent):
        raise _fault(name, event, "a key must be a word; quote it if it is meant as text")
    key = _scalar(event)
    line = event.start_mark.line + 1
    if not isinstance(key, str):
        raise InputError(
            key_path(_path(stack)) or "problem",
            key,
            "a mapping whose keys are text",
            f"write the key in line {line} as a name",
        )
    if len(key) > MAX_TEXT:
        raise _fault(name, event, f"a key must have at most {MAX_TEXT} characters; shorten it")
    mapping = stack[-1].value
    if key in mapping:
        raise InputError(
            key_path([*_path(stack), key]),
            "(twice)",
            "given once",
            f"remove one of the two (the second is in line {line})",
        )
    return key


def _value(event: Any, stack: list[_Open]) -> Plain:
    if isinstance(event, MappingStartEvent):
        return {}
    if isinstance(event, SequenceStartEvent):
        return []
    value = _scalar(event)
    if isinstance(value, str) and len(value) > MAX_TEXT:
        raise InputError(
            key_path(_path(stack)), value, f"at most {MAX_TEXT} characters long", "shorten it"
        )
    return value


def _put(value: Plain, stack: list[_Open], found: list[Plain]) -> None:
    if not stack:
        found.append(value)
        return
    top = stack[-1]
    if isinstance(top.value, list):
        top.value.append(value)
    elif top.key is not None:
        top.value[top.key] = value
        top.key = None


def _path(stack: list[_Open]) -> list[str | int]:
    """Return where the next value goes; enclosing mappings have put theirs already."""
    path: list[str | int] = []
    for k, frame in enumerate(stack):
        innermost = k == len(stack) - 1
        if isinstance(frame.value, list):
            path.append(len(frame.value) - (not innermost))
        elif not innermost:
            path.append(next(reversed(frame.value)))
        elif frame.key is not None:
            path.append(frame.key)
    return path


def _scalar(event: Any) -> Plain:
    """Return the scalar's value by the core schema of YAML 1.2."""
    text: str = event.value
    if (
        not text.isascii()
    ):  # JSON writes characters beyond 16 bits as two escapes; halves are no text
        text = text.encode("utf-16-le", "surrogatepass").decode("utf-16-le", "replace")
    value: Plain = text
    if not event.implicit[0]:  # quoted, or a block
        pass
    elif _NULL.match(text):
        value = None
    elif _TRUE.match(text) or _FALSE.match(text):
        value = bool(_TRUE.match(text))
    elif _DECIMAL.match(text):
        value = int(text)
    elif _BASED.match(text):
        value = int(text, 0)
    elif _FLOAT.match(text):
        value = float(text)
    elif _SPECIAL.match(text):
        value = float(text.lower().replace(".", ""))
    return value


def _fault(name: str, event: Any, reason: str) -> FileError:
    mark = event.start_mark
    return FileError(f"{name}:{mark.line + 1}:{mark.column + 1}: {reason}")
