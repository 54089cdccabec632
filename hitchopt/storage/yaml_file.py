"""YAML 1.2 from any source, bounded in size and depth, and changes of its text.

The library's parser only cuts the text into events; the values are made here, by the core schema
of YAML 1.2 (``1e-3`` is a number, ``yes`` is text), so nothing but plain data can come out: no
tags, anchors or aliases. A change is spliced into the text where the old value was read, so that
comments, order, number formats and line breaks of everything else stay those of the author.
"""

from __future__ import annotations

import json
import math
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import reduce
from io import StringIO
from itertools import pairwise
from pathlib import Path
from typing import Any, cast

import numpy as np
from ruamel.yaml import YAML, events

from hitchopt.errors import FileError, InputError, Place
from hitchopt.values.fields import join_key

Plain = dict[str, "Plain"] | list["Plain"] | str | int | float | bool | None
"""Data that a problem file is made of."""

MAX_DEPTH = 20  # Levels of nesting; a problem has six

MAX_NODES = 250_000
"""Values in all. A polygon for MAX_ROBOTS robots takes 30 000; reading so many takes seconds."""

MAX_TEXT = 10_000  # Characters of one text; the longest meaningful one is the title

_LARGEST = 10**300
"""Whole numbers beyond it are infinite for every purpose here, and costly to print."""

MAX_BYTES = 4_000_000  # Larger files are refused before they are read

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
"""Patterns of plain scalars that are no text, and how to read them; the first match counts."""

TEXT_KEYS = "a mapping whose keys are text", "write the key as a name, and decimals with a point"
"""Bound and remedy of keys that are not text."""

STDIN = "-"  # Path that stands for standard input


def read_yaml(path: str | Path) -> Plain:
    """Return what the YAML file at ``path`` holds; ``-`` is standard input.

    FileError tells that there is none, or that it is too large, not UTF-8 text, empty or not YAML,
    InputError of a key that is given twice or not text, of too deep nesting and too many values.
    """
    return parse_yaml(*read_text(path))


def parse_yaml(text: str, name: str = "text") -> Plain:
    """Return what the YAML ``text`` holds, called ``name`` in messages; errors as ``read_yaml``."""
    return read_node(text, name).value


def read_node(text: str, name: str = "text") -> Node:
    """Return what the YAML ``text`` holds with the places of its keys; errors as ``read_yaml``."""
    found = _Reader(text, name).document()
    if found is None or found.value is None:
        raise FileError(f"{name}: is empty; `hitchopt init` writes files to start from")
    return found


def read_text(path: str | Path) -> tuple[str, str]:
    """Return a YAML file's text, and what messages call the file; ``-`` is standard input.

    FileError tells that there is none, or that it is too large or not UTF-8 text.
    """
    if not isinstance(path, str | Path):
        raise InputError("path", path, "a path", "write its name in quotation marks")
    name, data = str(path), b""
    if name == STDIN:
        name, data = "<stdin>", sys.stdin.buffer.read(MAX_BYTES + 1)
    else:
        try:
            with open(name, "rb") as file:
                data = file.read(MAX_BYTES + 1)
        except FileNotFoundError:
            raise FileError(f"{name}: no such file; check the path") from None
        except (OSError, ValueError) as error:  # ValueError: a NUL in the path
            reason = getattr(error, "strerror", None) or str(error)
            raise FileError(f"{name!r}: cannot be read ({reason}); give a readable file") from None
    if len(data) > MAX_BYTES:
        raise FileError(f"{name}: is larger than the {MAX_BYTES} bytes that a problem may have")
    try:
        return data.decode("utf-8-sig"), name
    except UnicodeDecodeError as error:
        words = f"is not UTF-8 text (byte {error.start}); give a YAML file, saved as UTF-8"
        raise FileError(f"{name}: {words}") from None


@dataclass
class Node:
    """A value, and where it stands in its text."""

    value: Plain
    place: Place  # of its key, or of itself where it has none
    start: int  # of its first character in the text
    end: int  # of what it reads
    column: int  # of the first character, from 0 on
    flow: bool = True  # whether it is in brackets, or a scalar
    head: int = 0  # where its key ends
    children: dict[str | int, Node] = field(default_factory=dict)  # by key or index, in order

    def child(self, part: str | int) -> Node:
        """Return what is at a key or index; raise InputError where there is nothing."""
        if part not in self.children:
            raise InputError(str(part), self.value, "an entry of the file", "add it before")
        return self.children[part]

    def finder(self) -> Callable[[str], Place]:
        """Return what finds the place of a key, or of the innermost mapping or list around it."""
        places = dict(self._places([]))

        def place_of(key: str) -> Place:
            while key and key not in places:
                key = key[: max(key.rfind("."), key.rfind("["), 0)]
            return places[key]

        return place_of

    def _places(self, path: list[str | int]) -> Iterator[tuple[str, Place]]:
        yield key_path(path), self.place
        for part, child in self.children.items():
            yield from child._places([*path, part])


@contextmanager
def located(text: str, name: str) -> Iterator[None]:
    """Give errors of values their places in a YAML text, called ``name``."""
    try:
        yield
    except InputError as error:
        raise error.located(read_node(text, name).finder()) from None


class _Reader:
    """Values of one text, made by recursive descent; MAX_DEPTH bounds the recursion."""

    def __init__(self, text: str, name: str) -> None:
        self.text, self.name, self.budget = text, name, Budget()
        self.events, self.place = self._parsed(), Place(name, 1, 1)

    def document(self) -> Node | None:
        """Return the only document's value; None where there is none."""
        found: list[Node] = []
        try:
            for event in self.events:
                if isinstance(event, events.DocumentStartEvent) and found:
                    raise self._fault("a second document begins here; keep one problem per file")
                if isinstance(event, events.NodeEvent):
                    found.append(self._node(event, []))
        except InputError as error:
            raise error.located(lambda _: self.place) from None
        return found[0] if found else None

    def _parsed(self) -> Iterator[Any]:
        """Yield the events of the text; ``place`` is where the last one begins."""
        try:
            for event in YAML(typ="safe", pure=True).parse(StringIO(self.text)):
                mark = event.start_mark
                self.place = Place(self.name, mark.line + 1, mark.column + 1)
                yield event
        except Exception as error:  # the scanner trips over escapes such as "\U99999999", too
            mark = getattr(error, "problem_mark", None) or getattr(error, "context_mark", None)
            reason = getattr(error, "problem", None) or repr(str(error).partition("\n")[0])
            place = "" if mark is None else f":{mark.line + 1}:{mark.column + 1}"
            remedy = "indent with spaces" if "\\t" in reason else "correct this line"
            if "flow" in str(getattr(error, "context", "")):
                remedy += f", or close the bracket of line {error.context_mark.line + 1}"  # type: ignore[attr-defined]
            words = f"is not YAML ({reason}); {remedy}"
            raise FileError(f"{self.name}{place}: {words}") from None

    def _node(self, event: Any, path: list[str | int]) -> Node:
        self._refuse_extras(event)
        start = event.start_mark
        node = Node(None, self.place, start.index, event.end_mark.index, start.column)
        if isinstance(event, events.ScalarEvent):
            node.value = _scalar(event)
        self.budget.spend(path, node.value)
        if isinstance(event, events.CollectionStartEvent):
            self._fill(node, path, is_mapping=isinstance(event, events.MappingStartEvent))
            node.flow = event.flow_style
        if node.children and not node.flow:  # the parser goes on to what follows
            node.end = next(reversed(node.children.values())).end
        else:
            node.end = node.start + len(self.text[node.start : node.end].rstrip())
        return node

    def _fill(self, node: Node, path: list[str | int], *, is_mapping: bool) -> None:
        """Read the entries of a mapping or list, and its end."""
        for entry in self.events:
            place, head = self.place, entry.end_mark.index
            if isinstance(entry, events.CollectionEndEvent):
                node.end = head
                break
            key: str | int = len(node.children)
            if is_mapping:
                key = self._new_key(entry, path, node)
                entry = next(self.events)  # noqa: PLW2901
            child = self._node(entry, [*path, key])
            child.place, child.head = place, head
            node.children[key] = child
        values = {key: child.value for key, child in node.children.items()}
        node.value = cast("dict[str, Plain]", values) if is_mapping else list(values.values())

    def _refuse_extras(self, event: Any) -> None:
        """Raise FileError of what is no plain data."""
        if isinstance(event, events.AliasEvent):
            raise self._fault("aliases (*) are not allowed; write the value out")
        if event.anchor is not None:
            raise self._fault("anchors (&) are not allowed; write each value where it belongs")
        if event.ctag is not None:
            raise self._fault("tags (!) are not allowed; remove it")

    def _new_key(self, event: Any, path: list[str | int], node: Node) -> str:
        self._refuse_extras(event)
        if not isinstance(event, events.ScalarEvent):
            raise self._fault("a key must be a word; quote it if it is meant as text")
        key = _scalar(event)
        if not isinstance(key, str):
            raise InputError(_where(path), key, *TEXT_KEYS)
        if len(key) > MAX_TEXT:
            raise self._fault(f"a key must have at most {MAX_TEXT} characters; shorten it")
        if key in node.children:
            where = key_path([*path, key])
            raise InputError(where, "(twice)", "given once", "remove this one, or that before")
        return key

    def _fault(self, reason: str) -> FileError:
        return FileError(f"{self.place}: {reason}")


def _scalar(event: Any) -> Plain:
    """Return the scalar's value by the core schema of YAML 1.2."""
    text: str = event.value
    if not text.isascii():
        # JSON writes characters beyond 16 bits as two escapes; halves are no text.
        text = text.encode("utf-16-le", "surrogatepass").decode("utf-16-le", "replace")
    return _unquoted(text) if event.implicit[0] else text  # else quoted, or a block


def _unquoted(text: str) -> Plain:
    return next((value(text) for kind, value in _CORE_SCHEMA if kind.fullmatch(text)), text)


def key_path(parts: Iterable[str | int]) -> str:
    """Return a path as messages show it, such as ``mission[0].morph.legs[1]``."""
    return reduce(join_key, parts, "")


class Budget:
    """Limits on plain data while they are read: MAX_NODES values, MAX_DEPTH levels, MAX_TEXT."""

    def __init__(self) -> None:
        self.nodes = 0

    def spend(self, path: list[str | int], value: object) -> None:
        """Count a value; raise InputError where it is too deep, one too many or too long a text."""
        self.nodes += 1
        if len(path) > MAX_DEPTH:
            bound, remedy = f"nested at most {MAX_DEPTH} levels deep", "six are enough"
            value = f"{len(path)} levels"
        elif self.nodes > MAX_NODES:
            bound, remedy = f"within {MAX_NODES} values in all", "plan fewer steps at a time"
            value = f"{self.nodes} values"
        elif isinstance(value, str) and len(value) > MAX_TEXT:
            bound, remedy = f"at most {MAX_TEXT} characters long", "shorten it"
        else:
            return
        raise InputError(key_path(path), value, bound, remedy)


def plain(data: object) -> Plain:
    """Return ``data`` with mappings as dict, sequences and arrays as list, scalars as Python's.

    InputError tells of other types, keys that are not text, cycles, too deep or too large data.
    """
    return _plain(data, [], Budget())


def _plain(data: object, path: list[str | int], budget: Budget) -> Plain:
    budget.spend(path, data)
    if isinstance(data, np.ndarray | np.generic):
        if data.size > MAX_NODES:  # before a list of it is made
            bound = f"within {MAX_NODES} values in all"
            raise InputError(_where(path), f"{data.size} values", bound, "give less")
        data = data.tolist()
    if data is None or isinstance(data, bool | float):
        return data
    if isinstance(data, int):
        infinite = math.inf if data > 0 else -math.inf
        return int(data) if abs(data) <= _LARGEST else infinite
    if isinstance(data, str):
        return str(data)
    if isinstance(data, list | tuple):
        return [_plain(entry, [*path, i], budget) for i, entry in enumerate(data)]
    if not isinstance(data, Mapping):
        bound = "a mapping, list, text, number, boolean or nothing"
        raise InputError(_where(path), type(data).__name__, bound, "give plain data")
    for key in data:
        if not isinstance(key, str):
            raise InputError(_where(path), key, *TEXT_KEYS)
    return {str(key): _plain(value, [*path, key], budget) for key, value in data.items()}


def _where(path: list[str | int]) -> str:
    return key_path(path) or "problem"


DECIMALS = 9  # Decimals of written numbers: far below any tolerance, and short enough to read

KeyPath = Sequence[str | int]  # Keys and indices from the top of a file to a value

_WORD = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_LINE_END = re.compile(r"\r?\n|\Z")
_PARTS = re.compile(r"\[(\d+)\]|([^.\[\]]+)")


def split_key(key: str) -> tuple[str | int, ...]:
    """Return the path of a key such as ``mission[0].morph.polygon``."""
    return tuple(int(i) if i else name for i, name in _PARTS.findall(key))


def value_at(data: Plain, path: KeyPath) -> Any:
    """Return the value at a path, or None where there is none."""
    found: Any = data
    for part in path:
        try:
            found = found[part]
        except (KeyError, IndexError, TypeError):
            return None
    return found


def with_value(text: str, path: KeyPath, value: Plain) -> str:
    """Return the text with another value at a path; missing keys on its way are added.

    InputError tells of an index that is not there, FileError of a text that is not YAML.
    """
    node = read_node(text)
    for i, part in enumerate(path):
        if isinstance(node.value, dict) and isinstance(part, str) and part not in node.children:
            for name in reversed(path[i + 1 :]):
                value = {str(name): value}
            return _spliced(text, [_new_entry(text, node, f"{flow(part)}: {flow(value)}")])
        node = node.child(part)
    return _spliced(text, _differences(node, value))


def with_entries(text: str, path: KeyPath, entries: Iterable[int | dict[str, Plain]]) -> str:
    """Return the text with other entries of the list at a path.

    Entries that were there are given by their index, and keep their text and the comment lines
    above it; new ones are given as mappings of one key. Errors are those of ``with_value``.
    """
    node = read_node(text)
    for part in path:
        node = node.child(part)
    children = node.children.values()
    if node.flow or not children:
        old = [text[child.start : child.end] for child in children]
        parts = [old[e] if isinstance(e, int) else flow(e) for e in entries]
        return _spliced(text, [(node.start, node.end, f"[{', '.join(parts)}]")])
    ends = [_line_end(text, place) for place in (node.head, *(c.end for c in children))]
    old, dash = [text[a:b] for a, b in pairwise(ends)], f"{_line_break(text)}{' ' * node.column}- "
    body = "".join(old[e] if isinstance(e, int) else dash + flow(e)[1:-1] for e in entries)
    return _spliced(text, [(ends[0], ends[-1], body or " []")])


def _spliced(text: str, splices: Iterable[tuple[int, int, str]]) -> str:
    """Return the text with others between places."""
    for start, end, new in sorted(splices, reverse=True):
        text = text[:start] + new + text[end:]
    return text


def _line_end(text: str, place: int) -> int:
    """Return where the line of a place ends, before its line break."""
    return next(_LINE_END.finditer(text, place)).start()


def _differences(node: Node, value: Plain) -> Iterator[tuple[int, int, str]]:
    """Yield what to write for another value, entry by entry where the shape is the same."""
    old = node.value
    if old == value and isinstance(old, bool) is isinstance(value, bool):
        return
    parts: list[Any] = list(value if isinstance(value, dict) else ())
    if isinstance(value, list):
        parts = list(range(len(value)))
    if parts and parts == list(node.children):
        for part, child in node.children.items():
            yield from _differences(child, value_at(value, [part]))
        return
    # An entry of a block may stand in the column of its key, which another value must not.
    block = bool(node.children) and not node.flow and isinstance(old, list)
    yield node.start, node.end, ("  " if block else "") + flow(value)


def _new_entry(text: str, node: Node, written: str) -> tuple[int, int, str]:
    """Return where to write a new key and its value in a mapping, and what."""
    if not node.children:
        return node.start + 1, node.start + 1, written
    end = next(reversed(node.children.values())).end
    if node.flow:
        return end, end, f", {written}"
    place = _line_end(text, end)
    return place, place, f"{_line_break(text)}{' ' * node.column}{written}"


def _line_break(text: str) -> str:
    return "\r\n" if "\r\n" in text else "\n"


def flow(value: Plain) -> str:
    """Return a value on one line."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{flow(k)}: {flow(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(flow, value)) + "]"
    if isinstance(value, str):
        plain = _WORD.fullmatch(value) and _unquoted(value) == value
        return value if plain else json.dumps(value, ensure_ascii=False)
    if isinstance(value, float) and math.isfinite(value):
        return repr(round(value, DECIMALS) + 0.0)
    return json.dumps(value)
