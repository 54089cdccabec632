"""Bag files as recorders leave them: split, compressed, or not closed.

A file that cannot be read as it is gets a repaired copy in a temporary directory.
"""

from __future__ import annotations

import re
import shutil
import sqlite3
import struct
import sys
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, BinaryIO

from hitchopt.errors import FileError
from hitchopt.lab.flights.recordings import library
from hitchopt.storage.files import opened

METADATA = "metadata.yaml"  # File of a closed ROS 2 bag, which lists its parts
ACTIVE = ".active"  # Suffix of a ROS 1 bag that is not closed

SQLITE_MAGIC = b"SQLite format 3"  # First bytes of SQLite files
MCAP_MAGIC = b"\x89MCAP0\r\n"  # First bytes of MCAP files
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"  # First bytes of zstd files
ROS1_MAGIC = b"#ROSBAG V2.0"
ZSTD = "compression.zstd" if sys.version_info >= (3, 14) else "backports.zstd"

PART_NUMBER = re.compile(r"_(\d+)\.\w+(\.zstd)?$")  # End of the name of a part of a split bag
MAX_PART_GAP = 1.0  # Largest time between the parts of a split bag [s]

# Records of mcap: a byte for the kind, the length of the content, and the content
RECORD_HEAD = struct.Struct("<BQ")
DATA_END = struct.pack("<BQI", 0x0F, 4, 0)
FOOTER = struct.pack("<BQQQI", 0x02, 20, 0, 0, 0)  # Without a summary: readers scan the records
END_KINDS = (0x00, 0x02, 0x0F)  # Kinds of no record, of the footer, and of the end of data
SQLITE_LOGS = ("-wal", "-journal")  # Suffixes of files that complete a database


class Bag:
    """An open bag.

    Attributes
    ----------
    source: ``ROS 1 bag`` or ``ROS 2 bag``.
    types: message types by topic, of topics with messages.
    notes: repairs, a sentence each.
    """

    def __init__(self, reader: Any, notes: Sequence[str]) -> None:
        self._reader = reader
        self.source = f"ROS {'2' if reader.is2 else '1'} bag"
        self.types: dict[str, str] = {
            connection.topic: connection.msgtype
            for connection in reader.connections
            if connection.msgcount
        }
        self.notes = tuple(notes)

    def messages(self, topics: Collection[str]) -> dict[str, list[tuple[float, Any]]]:
        """Return the times of arrival [s] and the messages of topics."""
        messages: dict[str, list[tuple[float, Any]]] = {topic: [] for topic in topics}
        connections = [each for each in self._reader.connections if each.topic in messages]
        if not connections:  # Without connections rosbags reads all of them
            return messages
        for connection, arrival, data in self._reader.messages(connections):
            message = self._reader.deserialize(data, connection.msgtype)
            messages[connection.topic].append((1e-9 * arrival, message))
        return messages


@contextmanager
def opened_bag(paths: Sequence[Path], definitions: Mapping[str, str]) -> Iterator[Bag]:
    """Open a bag of ROS 1 or 2 from one file, or from all parts of a split one.

    ``definitions`` are those of message types that a bag may lack. Raises FileError for several
    recordings; exceptions of rosbags for damaged files have no common base class.
    """
    highlevel, typesys = library("rosbags.highlevel"), library("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    for name, text in definitions.items():
        store.register(typesys.get_types_from_msg(text, name))
    with TemporaryDirectory(prefix="hitchopt-") as scratch:
        sources, notes = _readable_sources(paths, Path(scratch))
        with highlevel.AnyReader(sources, default_typestore=store) as reader:
            if len(sources) > 1:
                _require_continuous_parts(paths, reader.readers)
                notes.append(f"read from {len(sources)} parts without {METADATA}")
            yield Bag(reader, notes)


def single_file(paths: Sequence[Path]) -> Path:
    """Return the only file of a recording; FileError if a directory has several."""
    if len(paths) > 1:
        listed = ", ".join(path.name for path in paths[:5])
        raise FileError(f"contains {len(paths)} recordings, {listed}: name one file")
    return paths[0]


def _readable_sources(paths: Sequence[Path], scratch: Path) -> tuple[list[Path], list[str]]:
    """Return paths that rosbags can read, and notes on repairs.

    They are the directory of a closed bag, or files, which may be copies in ``scratch``.
    """
    directory = paths[0].parent
    metadata = directory / METADATA
    is_closed = metadata.is_file() and metadata.stat().st_size > 0
    if is_closed and not any(map(_is_open_mcap, paths)):
        return [directory], []
    if not _are_parts(paths):
        single_file(paths)
    sources, notes = list[Path](), list[str]()
    for path in paths:
        source, note = _readable(path, scratch)
        sources.append(source)
        notes += [note] * bool(note)
    return sources, notes


def _are_parts(paths: Sequence[Path]) -> bool:
    """Return whether files are numbered like the parts of a split bag."""
    matches = [PART_NUMBER.search(path.name) for path in paths]
    numbers = sorted(int(match[1]) for match in matches if match)
    is_numbered = len(numbers) == len(paths)
    return is_numbered and all(later == number + 1 for number, later in pairwise(numbers))


def _require_continuous_parts(paths: Sequence[Path], readers: Sequence[Any]) -> None:
    """Raise FileError unless each part begins when the one before ends."""
    spans = sorted((each.start_time, each.end_time) for each in readers if each.message_count)
    gaps = [1e-9 * (later[0] - earlier[1]) for earlier, later in pairwise(spans)]
    if any(abs(gap) > MAX_PART_GAP for gap in gaps):
        single_file(paths)


def _readable(path: Path, scratch: Path) -> tuple[Path, str]:
    """Return a file that rosbags can read, and a note on its repair, which may be empty."""
    if path.suffix == ACTIVE and _begins(path, ROS1_MAGIC):
        raise FileError(f"{path.name} was not closed; run `rosbag reindex` on it, named .bag")
    note = ""
    if _begins(path, ZSTD_MAGIC):
        path = _unpacked(path, scratch)
    if _is_open_mcap(path):
        path = _closed_mcap(path, scratch)
        note = "to the last whole chunk"
    logs = [log for suffix in SQLITE_LOGS if (log := Path(f"{path}{suffix}")).is_file()]
    if _begins(path, SQLITE_MAGIC) and any(log.stat().st_size for log in logs):
        path = _recovered_database(path, logs, scratch)
        note = "to the last transaction"
    return path, note and f"{path.name} is truncated, because its recorder was killed: read {note}"


def _begins(path: Path, magic: bytes) -> bool:
    with opened(path) as file:
        return file.read(len(magic)) == magic


def _unpacked(path: Path, scratch: Path) -> Path:
    """Decompress a file into a directory, without its suffix."""
    unpacked = scratch / path.stem
    with library(ZSTD).open(path, "rb") as source, unpacked.open("wb") as target:
        shutil.copyfileobj(source, target)
    return unpacked


def _is_open_mcap(path: Path) -> bool:
    """Return whether a file is of mcap and lacks its end."""
    with opened(path) as file:
        if file.read(len(MCAP_MAGIC)) != MCAP_MAGIC:
            return False
        file.seek(max(len(MCAP_MAGIC), path.stat().st_size - len(MCAP_MAGIC)))
        return file.read() != MCAP_MAGIC


def _closed_mcap(path: Path, scratch: Path) -> Path:
    """Copy the whole records of a file of mcap that lacks its end, and close the copy."""
    closed = scratch / path.name
    if closed == path:  # It is a copy already
        closed = scratch / f"closed_{path.name}"
    size = path.stat().st_size
    with opened(path) as source, closed.open("wb") as target:
        target.write(source.read(len(MCAP_MAGIC)))
        for record in _whole_records(source, size):
            target.write(record)
        target.write(DATA_END + FOOTER + MCAP_MAGIC)
    return closed


def _whole_records(source: BinaryIO, size: int) -> Iterator[bytes]:
    """Yield the records of mcap up to the first that reaches beyond the size [B] of the file."""
    while len(head := source.read(RECORD_HEAD.size)) == RECORD_HEAD.size:
        kind, length = RECORD_HEAD.unpack(head)
        if kind in END_KINDS or source.tell() + length > size:
            return
        yield head + source.read(length)


def _recovered_database(path: Path, logs: Sequence[Path], scratch: Path) -> Path:
    """Copy a database with its logs, and let sqlite complete the copy."""
    copy = scratch / path.name
    for file in (path, *logs):
        if file.parent != scratch:
            shutil.copyfile(file, scratch / file.name)
    with closing(sqlite3.connect(copy)) as database:
        database.execute("PRAGMA journal_mode = DELETE").fetchall()
    return copy
