"""Changes of the text of a YAML file: only what changes is written, the rest stays as it was typed.

Values are spliced into the text where the parser found the old ones, so comments, order, number
formats and line breaks of everything else are those of the author.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from io import StringIO
from itertools import pairwise
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.nodes import MappingNode, SequenceNode

from hitchopt.errors import InputError
from hitchopt.storage.yaml_file import Plain, parse_yaml

DECIMALS = 9  # Decimals of written numbers: far below any tolerance, and short enough to read

Path = Sequence[str | int]  # Keys and indices from the top of a file to a value

_WORD = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_LINE_END = re.compile(r"\r?\n|\Z")
_PARTS = re.compile(r"\[(\d+)\]|([^.\[\]]+)")


def split_key(key: str) -> tuple[str | int, ...]:
    """Return the path of a key such as ``mission[0].morph.polygon``."""
    return tuple(int(i) if i else name for i, name in _PARTS.findall(key))


def value_at(data: Plain, path: Path) -> Any:
    """Return the value at a path, or None where there is none."""
    found: Any = data
    for part in path:
        try:
            found = found[part]
        except (KeyError, IndexError, TypeError):
            return None
    return found


def with_value(text: str, path: Path, value: Plain) -> str:
    """Return the text with another value at a path; missing keys on its way are added.

    Raises
    ------
    InputError: an index that is not there.
    FileError: the text is not YAML.
    """
    node, old = _composed(text), parse_yaml(text)
    for i, part in enumerate(path):
        child = _child(node, part)
        if child is None:
            if not isinstance(node, MappingNode) or not isinstance(part, str):
                raise InputError(str(part), list(path), "an entry of the file", "add it before")
            for name in reversed(path[i + 1 :]):
                value = {str(name): value}
            return _spliced(text, [_new_key(text, node, part, value)])
        node, old = child, value_at(old, (part,))
    return _spliced(text, list(_differences(text, node, old, value)))


def with_entry(text: str, path: Path, index: int, value: Plain) -> str:
    """Return the text with a value inserted before an entry of the list at a path."""

    def insert(entries: list[str], column: int | None) -> list[str]:
        written = flow(value) if column is None else f"{' ' * column}- {_entry(value)}"
        return [*entries[:index], written, *entries[index:]]

    return _rearranged(text, path, insert)


def without_entry(text: str, path: Path, index: int) -> str:
    """Return the text without an entry of the list at a path, and the comment above that entry."""
    return _rearranged(text, path, lambda all_, _: [*all_[:index], *all_[index + 1 :]])


def with_entry_moved(text: str, path: Path, index: int, to: int) -> str:
    """Return the text with an entry, and the comment above it, at another place of its list."""

    def move(entries: list[str], _: int | None) -> list[str]:
        others = [*entries[:index], *entries[index + 1 :]]
        return [*others[:to], entries[index], *others[to:]]

    return _rearranged(text, path, move)


@dataclass(frozen=True)
class _Splice:
    start: int
    end: int
    text: str


def _composed(text: str) -> Any:
    parse_yaml(text)  # refuses what is not plain YAML, with words
    return YAML(typ="safe", pure=True).compose(StringIO(text))


def _spliced(text: str, splices: list[_Splice]) -> str:
    for splice in sorted(splices, key=lambda s: s.start, reverse=True):
        text = text[: splice.start] + splice.text + text[splice.end :]
    return text


def _child(node: Any, part: str | int) -> Any:
    if isinstance(node, MappingNode) and isinstance(part, str):
        return next((value for key, value in node.value if key.value == part), None)
    if isinstance(node, SequenceNode) and isinstance(part, int) and part < len(node.value):
        return node.value[part]
    return None


def _children(node: Any) -> list[Any]:
    if isinstance(node, MappingNode):
        return [value for _, value in node.value]
    return list(node.value) if isinstance(node, SequenceNode) else []


def _start(node: Any) -> int:
    return int(node.start_mark.index)


def _end(text: str, node: Any) -> int:
    """Return where the text of a node ends, without what the parser skips after it."""
    children = _children(node)
    if children and not node.flow_style:
        return _end(text, children[-1])
    end = int(node.end_mark.index)
    return _start(node) + len(text[_start(node) : end].rstrip())


def _line_end(text: str, place: int) -> int:
    """Return where the line of a place ends, before its line break."""
    match = _LINE_END.search(text, place)
    return len(text) if match is None else match.start()


def _line_break(text: str) -> str:
    return "\r\n" if "\r\n" in text else "\n"


def _differences(text: str, node: Any, old: Plain, value: Plain) -> Iterator[_Splice]:
    """Yield what to write for another value, entry by entry where the shape is the same."""
    if old == value and isinstance(old, bool) is isinstance(value, bool):
        return
    if isinstance(old, list) and isinstance(value, list) and len(old) == len(value):
        for child, before, after in zip(node.value, old, value, strict=True):
            yield from _differences(text, child, before, after)
    elif isinstance(old, dict) and isinstance(value, dict) and list(old) == list(value):
        for child, name in zip(_children(node), old, strict=True):
            yield from _differences(text, child, old[name], value[name])
    else:
        block = bool(_children(node)) and not node.flow_style
        # An entry of a block may stand in the column of its key, which another value must not.
        indent = "  " if block and isinstance(node, SequenceNode) else ""
        yield _Splice(_start(node), _end(text, node), indent + flow(value))


def _new_key(text: str, node: MappingNode, name: str, value: Plain) -> _Splice:
    written = f"{flow(name)}: {flow(value)}"
    if not node.value:
        return _Splice(_start(node) + 1, _start(node) + 1, written)
    end = _end(text, node.value[-1][1])
    if node.flow_style:
        return _Splice(end, end, f", {written}")
    place = _line_end(text, end)
    indent = " " * int(node.start_mark.column)
    return _Splice(place, place, f"{_line_break(text)}{indent}{written}")


def _rearranged(text: str, path: Path, change: Callable[[list[str], int | None], list[str]]) -> str:
    """Return the text with the entries of a list changed, given as their texts.

    ``change`` receives the column of the dashes as well, or None for a list in brackets.
    """
    parent = _composed(text)
    for part in path[:-1]:
        parent = _child(parent, part)
    node = _child(parent, path[-1])
    if node.flow_style or not node.value:
        parts = [text[_start(child) : _end(text, child)] for child in node.value]
        place = _Splice(_start(node), _end(text, node), f"[{', '.join(change(parts, None))}]")
        return _spliced(text, [place])
    key = next(key for key, value in parent.value if value is node)
    ends = [_line_end(text, int(key.end_mark.index))]
    ends += [_line_end(text, _end(text, child)) for child in node.value]
    line = _line_break(text)
    entries = [text[a:b].removeprefix(line) for a, b in pairwise(ends)]
    changed = change(entries, int(node.start_mark.column))
    body = "".join(f"{line}{entry}" for entry in changed) if changed else " []"
    return _spliced(text, [_Splice(ends[0], ends[-1], body)])


def _entry(value: Plain) -> str:
    """Return an entry of a block list: a mapping of one key without its braces."""
    if isinstance(value, dict) and len(value) == 1:
        ((name, inner),) = value.items()
        return f"{flow(name)}: {flow(inner)}"
    return flow(value)


def flow(value: Plain) -> str:
    """Return a value on one line."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{flow(k)}: {flow(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(flow, value)) + "]"
    if isinstance(value, str):
        plain = _WORD.fullmatch(value) and parse_yaml(value) == value
        return value if plain else json.dumps(value, ensure_ascii=False)
    if isinstance(value, float) and math.isfinite(value):
        return repr(round(value, DECIMALS) + 0.0)
    return json.dumps(value)
