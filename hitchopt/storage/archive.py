"""Read zips and npz files from any source, checked before memory is spent on them.

Bytes are compared with the archive's checksum first. Only then is an array's header read, of which
numpy takes plain literals alone: no text of a file is evaluated as Python.
"""

from __future__ import annotations

import contextlib
import io
import math
import struct
import warnings
import zipfile
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import FileError, HitchoptError, UnsupportedError

PLAN = "plan.npz"  # Name of the archive with a plan, in the plan's directory
RECORDING = "recording.npz"  # Name of the shapes of a simulated or evaluated flight

MODEST = 64 * 2**20
"""[bytes] Members of this size altogether are read whatever they were packed into."""

MAX_EXPANSION = 100
"""Largest ratio of unpacked members beyond MODEST to their file: more is a decompression bomb.
hitchopt's own plans are not compressed."""

MAX_UNPACKED = 500_000_000  # Size limit of all that is read of one zip, unpacked [B]

MAX_HEADER = 10_000  # [bytes] The longest description of an array's shape that is parsed

PACKINGS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
"""Methods by which members may be packed: those that numpy and shows use."""

BROKEN = (
    *(OSError, ValueError, TypeError, LookupError, AttributeError, EOFError, ArithmeticError),
    *(RuntimeError, MemoryError, struct.error, zipfile.BadZipFile, zlib.error, HitchoptError),
)
"""Exceptions that readers raise on a file of another kind, or on a damaged one."""


def read_arrays(path: Path, names: Sequence[str]) -> dict[str, NDArray[Any]]:
    """Return the named arrays of the npz file, read-only; others in it are ignored.

    FileError tells of an array that is missing, given twice, of objects, or absurdly large, others
    of BROKEN of a file that is no such archive, or a damaged one.
    """
    with path.open("rb") as file, zipfile.ZipFile(file) as archive:
        listed = archive.namelist()
        wanted = {name: f"{name}.npy" for name in names}
        for name, member in wanted.items():
            if listed.count(member) != 1:
                raise FileError(f"array {name!r} is in it {listed.count(member)} times, not once")
        members = [archive.getinfo(member) for member in wanted.values()]
        refuse_expansion(sum(info.file_size for info in members), path.stat().st_size)
        return {
            name: _array(name, checked_bytes(archive, info))
            for name, info in zip(wanted, members, strict=True)
        }


@contextlib.contextmanager
def reading(path: Path, what: str, kind: type[Exception] = HitchoptError) -> Iterator[None]:
    """Turn what a file that is no ``what``, or a damaged one, raises into a FileError.

    ``kind`` is the root of the exceptions of a library that reads it, besides ``BROKEN``.
    """
    try:
        yield
    except UnsupportedError:
        raise
    except FileError as error:
        if str(error).startswith(str(path)):
            raise
        raise FileError(f"{path}: {error}") from error
    except (*BROKEN, kind) as error:
        words = repr(error) if isinstance(error, LookupError) else str(error).strip()
        first = (words.splitlines() or [type(error).__name__])[0]
        raise FileError(f"{path}: is no {what}, or a damaged one: {first}") from error


def read_members(
    path: Path, archive: zipfile.ZipFile, members: Sequence[zipfile.ZipInfo]
) -> Iterator[bytes]:
    """Yield the bytes of files in the archive, one after the other.

    FileError tells that together they are too large, or packed in an unusual manner.
    """
    size = sum(member.file_size for member in members)
    if size > MAX_UNPACKED:
        raise FileError(f"its files unpack to {size:.3g} bytes; {MAX_UNPACKED} are the most")
    refuse_expansion(size, path.stat().st_size)
    for member in members:
        yield checked_bytes(archive, member)


def refuse_expansion(size: int, packed: int) -> None:
    """Raise FileError if ``size`` bytes are far more than a file of ``packed`` bytes can hold."""
    if size > MODEST and size > MAX_EXPANSION * packed:
        raise FileError(f"it would unpack to {size:.3g} bytes from {packed:.3g}, far too many")


def checked_bytes(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> bytes:
    """Return all bytes of a member, which agree with its checksum.

    FileError tells of an unusual method, or of another length than the archive says.
    """
    if member.compress_type not in PACKINGS:
        raise FileError(f"{member.filename!r} is packed by an unknown method; deflate it, or store")
    with archive.open(member) as stream:  # read to its end, the archive compares its checksum
        data = stream.read(member.file_size) + stream.read(1)
    if len(data) != member.file_size:
        raise FileError(f"{member.filename!r} has {len(data)} bytes, not {member.file_size}")
    return data


def _array(name: str, data: bytes) -> NDArray[Any]:
    """Return the array of an npy file; raise FileError if numpy writes no such bytes."""
    stream, layout = io.BytesIO(data), np.lib.format
    try:
        first = layout.read_magic(stream) == (1, 0)
        head = layout.read_array_header_1_0 if first else layout.read_array_header_2_0
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # of headers as Python 2 wrote them
            shape, fortran, dtype = head(stream, max_header_size=MAX_HEADER)
    except Exception as error:  # its parser raises many, its tokenizer's among them
        words = f"array {name!r} has a header that numpy does not write: {str(error)[:99]}"
        raise FileError(words) from error
    if dtype.hasobject or dtype.names is not None:
        raise FileError(f"array {name!r} holds objects, not numbers")
    numbers, claimed = len(data) - stream.tell(), math.prod(shape) * dtype.itemsize
    if any(length < 0 for length in shape) or claimed != numbers:
        raise FileError(f"array {name!r} claims {claimed} bytes of numbers and has {numbers}")
    if claimed == 0:
        return np.zeros(shape, dtype)
    whole = np.frombuffer(data, dtype, offset=stream.tell())
    return whole.reshape(shape, order="F" if fortran else "C")
