"""What records hold, to the last bit, in one digest: equal digests mean equal contents.

Records are walked by their fields, so that a field that is added to one is looked at without
anybody remembering to. A record of a class from elsewhere, whose methods may be anything, and
whatever else has no contents that are surely all of it, is refused.
"""

from __future__ import annotations

import hashlib
import struct
from dataclasses import fields, is_dataclass
from enum import Enum

import numpy as np

OURS = f"{__name__.partition('.')[0]}."
"""Of the modules whose classes are looked into."""

KINDS = "biuf"
"""Of arrays' numbers: those whose bytes are all there is to them."""


class UnknownContents(TypeError):  # noqa: N818, it is caught and nobody is told
    """Something whose contents cannot be told in full."""


def digest_of(*values: object) -> bytes:
    """Return the digest (32,) of records, arrays, numbers, words and tuples and lists of these.

    Where an array's rows lie in memory is part of it, since sums may round otherwise.

    Raises
    ------
    UnknownContents: anything else.
    """
    return hashlib.sha256(_written(values, {})).digest()


def _written(value: object, known: dict[int, bytes]) -> bytes:
    """Return bytes that tell the value from every other; ``known`` has those of records by id."""
    kind = type(value)
    if isinstance(value, tuple | list) and kind in {tuple, list}:
        return _framed(kind.__name__, b"".join(_written(item, known) for item in value))
    plain = _plain(value)
    if plain is not None:
        return plain
    found = known.get(id(value))
    if found is None:
        parts = [_framed(name, _written(part, known)) for name, part in held_by(value).items()]
        name = f"{kind.__module__}.{kind.__qualname__}"
        found = known[id(value)] = _framed(name, hashlib.sha256(b"".join(parts)).digest())
    return found


def _plain(value: object) -> bytes | None:
    """Return the bytes of a number, a word, a member of an enumeration or an array, else None."""
    kind = type(value)
    content: bytes | None = None
    name = kind.__name__
    if value is None or kind in {bool, int}:
        content = repr(value).encode()
    elif isinstance(value, Enum) and kind.__module__.startswith(OURS):
        name, content = f"{kind.__module__}.{kind.__qualname__}", value.name.encode()
    elif kind is float:
        content = struct.pack("<d", value)
    elif kind is str:
        content = str(value).encode("utf-8", "surrogatepass")
    elif isinstance(value, np.generic) and value.dtype.kind in KINDS:
        name, content = f"number {value.dtype.str}", value.tobytes()
    elif isinstance(value, np.ndarray) and kind is np.ndarray and value.dtype.kind in KINDS:
        name = f"array {value.dtype.str} {value.shape} {value.strides}"
        content = value.tobytes()
    return None if content is None else _framed(name, content)


def held_by(record: object) -> dict[str, object]:
    """Return what a record's fields hold, by name.

    Raises
    ------
    UnknownContents: no record of this package, or one that holds something beside its fields.
    """
    kind = type(record)
    if not is_dataclass(record) or not kind.__module__.startswith(OURS):
        raise UnknownContents(kind.__qualname__)
    held = {field.name: getattr(record, field.name) for field in fields(record)}
    if vars(record).keys() != held.keys():
        raise UnknownContents(f"{kind.__qualname__}, which has more than its fields")
    return held


def _framed(name: str, content: bytes) -> bytes:
    """Return content behind its name and length, so that no two sequences read alike."""
    return f"{len(name)}:{name} {len(content)}:".encode() + content
