"""Read zip and npz files from untrusted sources, checked before memory is allocated.

Bytes are compared with the archive's checksum before an array's header is parsed. Numpy parses
headers as plain literals: no text of a file is evaluated as Python.
"""

from __future__ import annotations

import contextlib
import io
import math
import re
import struct
import unicodedata
import warnings
import zipfile
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import FileError, HitchoptError, UnsupportedError
from hitchopt.storage.files import opened

PLAN = "plan.npz"  # File name of a plan in its directory
RECORDING = "recording.npz"  # File name of a simulated or evaluated flight

MAX_UNCOMPRESSED_SIZE = 64 * 2**20
"""Total size of members up to which their compression ratio is not checked [B]."""

MAX_COMPRESSION = 100
"""Largest ratio of larger members to the size of their file; more is a decompression bomb.
hitchopt's own plans are not compressed."""

MAX_TOTAL_SIZE = 500_000_000  # Limit of the total size of the members that are read of a zip [B]
MAX_HEADER = 10_000  # Size limit of an array's header [B]

ARRAY_NAME = re.compile(r"(?:\w(?:[\w.-]*[\w-])?/)*\w+\.npy")
"""Names of an npz file's members: every reader and every file system takes them literally."""

COMPRESSION_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
"""Supported compression methods: those that numpy and Skybrush shows use."""

READ_ERRORS = (
    *(OSError, ValueError, TypeError, LookupError, AttributeError, EOFError, ArithmeticError),
    *(RuntimeError, MemoryError, struct.error, zipfile.BadZipFile, zlib.error, HitchoptError),
)
"""Exceptions that readers raise on damaged files, and on files of another format."""


def read_arrays(path: Path, names: Sequence[str]) -> dict[str, NDArray[Any]]:
    """Return the named arrays of an npz file, read-only; others in it are ignored.

    Raises FileError if an array is missing, duplicated, too large or contains objects, if other
    readers may take a member for another one, and others of READ_ERRORS if the file is damaged or
    no npz file.
    """
    with opened(path) as file, zipfile.ZipFile(file) as archive:
        listed = archive.namelist()
        seen = dict[str, str]()
        for name in (info.orig_filename for info in archive.infolist()):
            if not ARRAY_NAME.fullmatch(name):
                reason = "is not the name of an array, such as 'a/drones.npy'"
                raise FileError(f"its member {name!r:.99} {reason}")
            if (other := seen.setdefault(folded(name), name)) is not name:
                raise FileError(f"readers may confuse its members {other!r:.99} and {name!r:.99}")
        for name in names:
            if (count := listed.count(f"{name}.npy")) != 1:
                raise FileError(f"it contains the array {name!r} {count} times, not once")
        members = {name: archive.getinfo(f"{name}.npy") for name in names}
        check_expansion(sum(info.file_size for info in members.values()), path.stat().st_size)
        return {name: _array(name, _read(archive, info)) for name, info in members.items()}


def folded(name: str) -> str:
    """Return a name as readers compare it that ignore case and normalise Unicode."""
    return unicodedata.normalize("NFKC", unicodedata.normalize("NFKC", name).casefold())


@contextlib.contextmanager
def reading(path: Path, what: str, kind: type[Exception] = HitchoptError) -> Iterator[None]:
    """Convert errors of readers into FileError: the file at ``path`` is not a valid ``what``.

    ``kind`` is the base class of the reader's own exceptions, in addition to ``READ_ERRORS``.
    """
    try:
        yield
    except UnsupportedError:
        raise
    except FileError as error:
        if str(error).startswith(str(path)):
            raise
        raise FileError(f"{path}: {error}") from error
    except (*READ_ERRORS, kind) as error:
        message = repr(error) if isinstance(error, LookupError) else str(error).strip()
        first_line = (message.splitlines() or [type(error).__name__])[0]
        raise FileError(f"{path}: is not a valid {what}: {first_line}") from error


def read_members(
    path: Path, archive: zipfile.ZipFile, members: Sequence[zipfile.ZipInfo]
) -> Iterator[bytes]:
    """Yield the bytes of files in the archive one by one.

    Raises FileError if their total size is too large, or their compression method unsupported.
    """
    size = sum(member.file_size for member in members)
    if size > MAX_TOTAL_SIZE:
        raise FileError(f"its files unpack to {size:.3g} bytes; at most {MAX_TOTAL_SIZE} are read")
    check_expansion(size, path.stat().st_size)
    for member in members:
        yield _read(archive, member)


def check_expansion(size: int, file_size: int) -> None:
    """Raise FileError if a file of ``file_size`` [B] unpacks to implausibly many bytes."""
    if size > MAX_UNCOMPRESSED_SIZE and size > MAX_COMPRESSION * file_size:
        raise FileError(f"it would unpack to {size:.3g} bytes from {file_size:.3g}, far too many")


def _read(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> bytes:
    """Return the bytes of a member, verified by its checksum.

    Raises FileError if its compression method is unsupported, or its size not the one declared.
    """
    if member.compress_type not in COMPRESSION_METHODS:
        reason = "has an unsupported compression method; deflate it, or store"
        raise FileError(f"{member.filename!r} {reason}")
    with archive.open(member) as stream:  # reading to the end verifies the checksum
        data = stream.read(member.file_size) + stream.read(1)
    if len(data) != member.file_size:
        raise FileError(f"{member.filename!r} has {len(data)} bytes, not {member.file_size}")
    return data


def _array(name: str, data: bytes) -> NDArray[Any]:
    """Return the array of an npy file; raises FileError if the file is invalid."""
    stream = io.BytesIO(data)
    npy = np.lib.format
    try:
        is_first = npy.read_magic(stream) == (1, 0)
        read_header = npy.read_array_header_1_0 if is_first else npy.read_array_header_2_0
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # on headers written by Python 2
            shape, fortran, dtype = read_header(stream, max_header_size=MAX_HEADER)
    except Exception as error:  # numpy's parser raises many types, also of its tokenizer
        reason = f"array {name!r} has a header that numpy does not write: {str(error)[:99]}"
        raise FileError(reason) from error
    if dtype.hasobject or dtype.names is not None:
        raise FileError(f"array {name!r} contains objects, not numbers")
    size = len(data) - stream.tell()
    declared = math.prod(shape) * dtype.itemsize
    if any(length < 0 for length in shape) or declared != size:
        raise FileError(f"array {name!r} claims {declared} bytes of numbers and has {size}")
    if declared == 0:
        return np.zeros(shape, dtype)
    entries = np.frombuffer(data, dtype, offset=stream.tell())
    return entries.reshape(shape, order="F" if fortran else "C")
