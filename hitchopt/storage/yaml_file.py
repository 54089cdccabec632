"""Read YAML 1.2 from untrusted sources, bounded in size and depth, and edit its text.

The library only parses the text into events. Values are constructed here by the core schema of
YAML 1.2 (``1e-3`` is a number, ``yes`` is text), so the result is plain data: no tags, anchors or
aliases. An edit replaces the text of the old value, and preserves comments, order, number formats
and line breaks of everything else.
"""

from __future__ import annotations

import json
import math
import re
import sys
import unicodedata
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import reduce
from io import StringIO
from pathlib import Path
from typing import Any, cast

import numpy as np
from ruamel.yaml import YAML, events

from hitchopt.errors import Circumstance, FileError, InputError, Place
from hitchopt.storage.files import opened
from hitchopt.values.fields import join_key

Plain = dict[str, "Plain"] | list["Plain"] | str | int | float | bool | None
"""Data of a problem file."""

MAX_DEPTH = 20  # Maximum levels of nesting; a problem has six
MAX_NODES = 250_000  # Maximum number of values. A polygon for MAX_ROBOTS robots has 30 000.
MAX_KEYS = 2500  # Maximum number of keys of a mapping. One of drones for MAX_ROBOTS has 2000.
MAX_TEXT = 10_000  # Maximum characters of a string; the longest meaningful one is the title
_MAX_INTEGER = 10**300  # Larger integers are read as infinity, because they are costly to print
MAX_BYTES = 4_000_000  # Size limit of a file [B]

_CORE_SCHEMA: tuple[tuple[re.Pattern[str], Callable[[str], Plain]], ...] = (
    (re.compile(r"~|null|Null|NULL|"), lambda _: None),
    (re.compile(r"true|True|TRUE|false|False|FALSE"), lambda text: text.lower() == "true"),
    (re.compile(r"[-+]?[0-9]{1,300}"), int),
    (re.compile(r"0(o[0-7]{1,300}|x[0-9a-fA-F]{1,200})"), lambda text: int(text, 0)),
    (re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?"), float),
    (
        re.compile(r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)"),
        lambda text: float(text.replace(".", "")),
    ),
)
"""Patterns of plain scalars other than strings, and their parsers; the first match is used."""

LOOKALIKES = {
    **dict.fromkeys(map(ord, "\u2212\u2010\u2011\u2012\u2013\ufe63\uff0d"), "-"),
    **dict.fromkeys(map(ord, "\u00a0\u2007\u2009\u200a\u202f\u3000\ufeff\u200b"), " "),
}
"""Characters that look like a minus or a blank, as word processors and web pages write them."""

TEXT_KEYS = "a mapping whose keys are text", "write the key as a name, and decimals with a point"
"""Bound and remedy of keys that are not strings."""

STDIN = "-"  # Path of standard input


def read_yaml(path: str | Path) -> Plain:
    """Return the data of the YAML file at ``path``; ``-`` is standard input.

    Raises FileError if the file is missing, too large, not UTF-8 text, empty or not YAML, and
    InputError for duplicate keys, keys that are not strings, too deep nesting or too many values.
    """
    return parse_yaml(*read_text(path))


def parse_yaml(text: str, name: str = "text") -> Plain:
    """Return the data of a YAML text, called ``name`` in messages; errors as ``read_yaml``."""
    return read_node(text, name).value


def read_node(text: str, name: str = "text") -> Node:
    """Return the data of a YAML text with its positions; errors as ``read_yaml``."""
    document = _Reader(text, name).document()
    if document is None or document.value is None:
        raise FileError(f"{name}: is empty; `hitchopt init` writes files to start from")
    return document


def read_text(path: str | Path) -> tuple[str, str]:
    """Return the text of a YAML file, and its name in messages; ``-`` is standard input.

    Raises FileError if the file is missing, too large or not UTF-8 text.
    """
    if not isinstance(path, str | Path):
        raise InputError("path", path, "a path", "write its name in quotation marks")
    name = str(path)
    data = b""
    if name == STDIN:
        name = "<stdin>"
        data = sys.stdin.buffer.read(MAX_BYTES + 1)
    else:
        try:
            with opened(name) as file:
                data = file.read(MAX_BYTES + 1)
        except FileNotFoundError:
            raise FileError(f"{name}: no such file; check the path") from None
        except IsADirectoryError:
            raise FileError(f"{name}: is a directory; name the YAML file of a problem") from None
        except (OSError, ValueError) as error:  # ValueError: a NUL in the path
            reason = getattr(error, "strerror", None) or str(error)
            raise FileError(f"{name!r}: cannot be read ({reason}); name a readable file") from None
    if len(data) > MAX_BYTES:
        raise FileError(f"{name}: is larger than the {MAX_BYTES} bytes that a problem may have")
    try:
        return data.decode("utf-8-sig"), name
    except UnicodeDecodeError as error:
        reason = f"is not UTF-8 text (byte {error.start}); name a YAML file, saved as UTF-8"
        raise FileError(f"{name}: {reason}") from None


@dataclass
class Node:
    """A value and its position in the text."""

    value: Plain
    place: Place  # of its key, or of the value if it has no key
    start: int  # offset of the first character in the text
    end: int  # offset after the last character
    column: int  # column of the first character, from 0
    flow: bool = True  # True in brackets, and for scalars
    head: int = 0  # offset after the key
    children: dict[str | int, Node] = field(default_factory=dict)  # by key or index, in order

    def child(self, part: str | int) -> Node:
        """Return the node at a key or index; raises InputError if it does not exist."""
        if part not in self.children:
            raise InputError(str(part), self.value, "an entry of the file", "add it first")
        return self.children[part]

    def places(self, path: KeyPath = ()) -> Iterator[tuple[str, Place]]:
        """Yield the keys of this node and all descendants, with their positions."""
        yield key_path(path), self.place
        for part, child in self.children.items():
            yield from child.places([*path, part])


@contextmanager
def located(text: str, name: str) -> Iterator[None]:
    """Add positions in a YAML text, called ``name``, to InputErrors of the context.

    The position of a missing key is that of the innermost mapping or list around it.
    """
    try:
        yield
    except InputError as error:
        places = dict(read_node(text, name).places())

        def place_of(key: str) -> Place:
            while key and key not in places:
                key = key[: max(key.rfind("."), key.rfind("["), 0)]
            return places[key]

        raise error.located(place_of) from None


class _Reader:
    """Recursive descent parser of one text; MAX_DEPTH bounds the recursion."""

    def __init__(self, text: str, name: str) -> None:
        self.text = text
        self.name = name
        self.budget = _Budget()
        self.events = self._parsed()
        self.place = Place(name, 1, 1)

    def document(self) -> Node | None:
        """Return the root node of the only document, or None for an empty text."""
        root: Node | None = None
        try:
            for event in self.events:
                if isinstance(event, events.DocumentStartEvent) and root is not None:
                    raise self._error("a second document begins here; keep one problem per file")
                if isinstance(event, events.NodeEvent):
                    root = self._node(event, [])
        except InputError as error:
            raise error.located(lambda _: self.place) from None
        return root

    def _parsed(self) -> Iterator[Any]:
        """Yield the events of the text; ``place`` is the start of the last one."""
        try:
            for event in YAML(typ="safe", pure=True).parse(StringIO(self.text)):
                mark = event.start_mark
                self.place = Place(self.name, mark.line + 1, mark.column + 1)
                yield event
        except Exception as error:  # the scanner also fails on escapes such as "\U99999999"
            mark = getattr(error, "problem_mark", None) or getattr(error, "context_mark", None)
            reason = getattr(error, "problem", None) or repr(str(error).partition("\n")[0])
            place = "" if mark is None else f":{mark.line + 1}:{mark.column + 1}"
            remedy = "indent with spaces" if "\\t" in reason else "correct this line"
            context = str(getattr(error, "context", ""))
            begin = getattr(error, "context_mark", None)
            for kind, name in (("flow", "bracket"), ("quoted", "quote")):
                if kind in context and begin is not None:
                    remedy += f", or close the {name} of line {begin.line + 1}"
            if "block" in context or "mapping values" in reason:
                remedy += " or the one above: entries of one list or mapping are indented alike, "
                remedy += "those of a list begin with `- `, keys end with `: `"
            lines = self.text.splitlines()[: mark.line + 1] if mark is not None else []
            for number in dict.fromkeys(each.line for each in (begin, mark) if each is not None):
                if number < len(lines) and (lookalike := _lookalike(lines[number])):
                    remedy = f"line {number + 1} has {lookalike}"
            raise FileError(f"{self.name}{place}: is not YAML ({reason}); {remedy}") from None

    def _node(self, event: Any, path: list[str | int]) -> Node:
        self._check_plain(event)
        start = event.start_mark
        node = Node(None, self.place, start.index, event.end_mark.index, start.column)
        if isinstance(event, events.ScalarEvent):
            node.value = self._scalar(event)
        self.budget.spend(path, node.value)
        if isinstance(event, events.CollectionStartEvent):
            self._fill(node, path, is_mapping=isinstance(event, events.MappingStartEvent))
            node.flow = event.flow_style
        if node.children and not node.flow:  # the parser's mark is at the next token
            node.end = next(reversed(node.children.values())).end
        else:
            node.end = node.start + len(self.text[node.start : node.end].rstrip())
        return node

    def _fill(self, node: Node, path: list[str | int], *, is_mapping: bool) -> None:
        """Read the entries and the end of a mapping or list."""
        for entry in self.events:
            place = self.place
            head = entry.end_mark.index
            if isinstance(entry, events.CollectionEndEvent):
                node.end = head
                break
            key: str | int = len(node.children)
            if is_mapping:
                _check_key_count(path, len(node.children) + 1)
                key = self._new_key(entry, path, node)
                entry = next(self.events)  # noqa: PLW2901
            child = self._node(entry, [*path, key])
            child.place, child.head = place, head
            node.children[key] = child
        values = {key: child.value for key, child in node.children.items()}
        node.value = cast("dict[str, Plain]", values) if is_mapping else list(values.values())

    def _check_plain(self, event: Any) -> None:
        """Raise FileError unless the event is of plain data."""
        if isinstance(event, events.AliasEvent):
            raise self._error("aliases (*) are not allowed; write the value out")
        if event.anchor is not None:
            raise self._error("anchors (&) are not allowed; write each value where it belongs")
        if event.ctag is not None:
            raise self._error("tags (!) are not allowed; remove it")

    def _new_key(self, event: Any, path: list[str | int], node: Node) -> str:
        self._check_plain(event)
        if not isinstance(event, events.ScalarEvent):
            raise self._error("a key must be a word; quote it if it is meant as text")
        key = self._scalar(event)
        if not isinstance(key, str):
            raise InputError(_path_in_problem(path), key, *TEXT_KEYS)
        if len(key) > MAX_TEXT:
            raise self._error(f"a key must have at most {MAX_TEXT} characters; shorten it")
        if key in node.children:
            remedy = "remove one of the two"
            twice = Circumstance("given twice")
            raise InputError(key_path([*path, key]), twice, "given once", remedy)
        return key

    def _scalar(self, event: Any) -> Plain:
        """Return the value of a scalar; FileError if it only looks like a number or a key."""
        text = event.value
        value = _scalar(event)
        plain = text.translate(LOOKALIKES)
        if plain != text and event.implicit[0]:
            is_number = not isinstance(_plain_scalar(plain.strip()), str)
            is_syntax = plain.startswith("- ") or (": " in plain and ": " not in text)
            if is_number or is_syntax or plain != plain.strip():
                raise self._error(f"{text[:60]!r} has {_lookalike(text)}")
        return value

    def _error(self, reason: str) -> FileError:
        return FileError(f"{self.place}: {reason}")


def _lookalike(text: str) -> str:
    """Return what to do with the first character of LOOKALIKES in a text; "" without one."""
    character = next((each for each in text if ord(each) in LOOKALIKES), "")
    if not character:
        return ""
    name = unicodedata.name(character, "a character").lower()
    plain = LOOKALIKES[ord(character)]
    remedy = f"write {plain!r}" if plain.strip() else "write a blank"
    return f"the character U+{ord(character):04X} ({name}); {remedy}"


def _scalar(event: Any) -> Plain:
    """Return the value of a scalar by the core schema of YAML 1.2."""
    text: str = event.value
    if not text.isascii():
        # JSON writes characters beyond 16 bits as surrogate pairs; a lone surrogate is invalid.
        text = text.encode("utf-16-le", "surrogatepass").decode("utf-16-le", "replace")
    return _plain_scalar(text) if event.implicit[0] else text  # else quoted, or a block


def _plain_scalar(text: str) -> Plain:
    return next((parse(text) for pattern, parse in _CORE_SCHEMA if pattern.fullmatch(text)), text)


def key_path(parts: Iterable[str | int]) -> str:
    """Format a path for messages, such as ``mission[0].morph.legs[1]``."""
    return reduce(join_key, parts, "")


class _Budget:
    """Limits on plain data: MAX_NODES values, MAX_DEPTH levels and MAX_TEXT characters."""

    def __init__(self) -> None:
        self.nodes = 0

    def spend(self, path: list[str | int], value: object) -> None:
        """Count a value; raises InputError if a limit is exceeded."""
        self.nodes += 1
        if len(path) > MAX_DEPTH:
            bound = f"nested at most {MAX_DEPTH} levels deep"
            remedy = "six are enough"
            value = f"{len(path)} levels"
        elif self.nodes > MAX_NODES:
            bound = f"within {MAX_NODES} values in all"
            remedy = "plan fewer steps at a time"
            value = f"{self.nodes} values"
        elif isinstance(value, str) and len(value) > MAX_TEXT:
            bound = f"at most {MAX_TEXT} characters long"
            remedy = "shorten it"
        else:
            return
        raise InputError(key_path(path), value, bound, remedy)


def plain(data: object) -> Plain:
    """Convert mappings to dict, sequences and arrays to list, and scalars to Python's types.

    Raises InputError for other types, keys that are not strings, cycles, too deep or large data.
    """
    return _plain(data, [], _Budget())


def _plain(data: object, path: list[str | int], budget: _Budget) -> Plain:
    budget.spend(path, data)
    if isinstance(data, np.ndarray | np.generic):
        if data.size > MAX_NODES:  # before conversion to a list
            bound = f"within {MAX_NODES} values in all"
            raise InputError(_path_in_problem(path), f"{data.size} values", bound, "reduce it")
        data = data.tolist()
    if data is None or isinstance(data, bool | float):
        return data
    if isinstance(data, int):
        infinite = math.inf if data > 0 else -math.inf
        return int(data) if abs(data) <= _MAX_INTEGER else infinite
    if isinstance(data, str):
        return str(data)
    if isinstance(data, list | tuple):
        return [_plain(entry, [*path, i], budget) for i, entry in enumerate(data)]
    if not isinstance(data, Mapping):
        bound = "a mapping, list, text, number, boolean or nothing"
        raise InputError(_path_in_problem(path), type(data).__name__, bound, "use plain data")
    _check_key_count(path, len(data))
    for key in data:
        if not isinstance(key, str):
            raise InputError(_path_in_problem(path), key, *TEXT_KEYS)
    return {str(key): _plain(value, [*path, key], budget) for key, value in data.items()}


def _check_key_count(path: list[str | int], count: int) -> None:
    """Raise InputError for a mapping with more than MAX_KEYS keys."""
    if count > MAX_KEYS:
        value, bound = f"more than {MAX_KEYS} keys", f"a mapping of at most {MAX_KEYS} keys"
        raise InputError(_path_in_problem(path), value, bound, "leave some out")


def _path_in_problem(path: list[str | int]) -> str:
    return key_path(path) or "problem"


DECIMALS = 9  # Decimals of written numbers: far below any tolerance, and short enough to read
KeyPath = Sequence[str | int]  # Keys and indices from the root of a file to a value

_WORD = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_LINE_END = re.compile(r"\r?\n|\Z")
_PARTS = re.compile(r"\[(\d+)\]|([^.\[\]]+)")


def split_key(key: str) -> tuple[str | int, ...]:
    """Return the path of a key such as ``mission[0].morph.polygon``."""
    return tuple(int(i) if i else name for i, name in _PARTS.findall(key))


def value_at(data: Plain, path: KeyPath) -> Any:
    """Return the value at a path, or None if there is none."""
    value: Any = data
    for part in path:
        try:
            value = value[part]
        except (KeyError, IndexError, TypeError):
            return None
    return value


def with_value(text: str, path: KeyPath, value: Plain) -> str:
    """Return the text with a new value at a path; missing keys of the path are added.

    Raises InputError for an index out of range, FileError if the text is not YAML.
    """
    node = read_node(text)
    for i, part in enumerate(path):
        if isinstance(node.value, dict) and isinstance(part, str) and part not in node.children:
            for name in reversed(path[i + 1 :]):
                value = {str(name): value}
            return _replaced(text, [_insertion(text, node, f"{flow(part)}: {flow(value)}")])
        node = node.child(part)
    return _replaced(text, _replacements(node, value))


def _replaced(text: str, replacements: Iterable[tuple[int, int, str]]) -> str:
    """Return the text with replacements: start, end and new text of each."""
    for start, end, new in sorted(replacements, reverse=True):
        text = text[:start] + new + text[end:]
    return text


def _line_end(text: str, offset: int) -> int:
    """Return the offset of the next line break."""
    return next(_LINE_END.finditer(text, offset)).start()


def _replacements(node: Node, value: Plain) -> Iterator[tuple[int, int, str]]:
    """Yield replacements that change a node's value, entry by entry if the shapes match."""
    old = node.value
    if old == value and isinstance(old, bool) is isinstance(value, bool):
        return
    parts: list[Any] = list(value if isinstance(value, dict) else ())
    if isinstance(value, list):
        parts = list(range(len(value)))
    if parts and parts == list(node.children):
        for part, child in node.children.items():
            yield from _replacements(child, value_at(value, [part]))
        return
    # The entries of a block list may have the column of their key; another value must not.
    block = bool(node.children) and not node.flow and isinstance(old, list)
    yield node.start, node.end, ("  " if block else "") + flow(value)


def _insertion(text: str, node: Node, entry: str) -> tuple[int, int, str]:
    """Return the replacement that appends an entry to a mapping."""
    if not node.children:
        return node.start + 1, node.start + 1, entry
    end = next(reversed(node.children.values())).end
    if node.flow:
        return end, end, f", {entry}"
    end = _line_end(text, end)
    return end, end, f"{_line_break(text)}{' ' * node.column}{entry}"


def _line_break(text: str) -> str:
    return "\r\n" if "\r\n" in text else "\n"


def flow(value: Plain) -> str:
    """Return a value in flow style, on one line."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{flow(k)}: {flow(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(flow, value)) + "]"
    if isinstance(value, str):
        is_plain = _WORD.fullmatch(value) and _plain_scalar(value) == value
        return value if is_plain else json.dumps(value, ensure_ascii=False)
    if isinstance(value, float) and math.isfinite(value):
        return repr(round(value, DECIMALS) + 0.0)
    return json.dumps(value)
