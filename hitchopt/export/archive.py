"""Arrays of an npz file from anywhere: checked before memory is spent on them."""

from __future__ import annotations

import math
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import IO, Any

from numpy.lib import format as npy
from numpy.typing import NDArray

from hitchopt.errors import FileError

MODEST = 64 * 2**20
"""[bytes] Arrays of this size altogether are read whatever they were packed into."""

MAX_EXPANSION = 100
"""Beyond MODEST, by how much unpacked arrays may exceed their file: more is a decompression bomb.
hitchopt's own files are not compressed."""

MAX_HEADER = 10_000
"""[bytes] The longest description of an array's shape that is parsed."""


def read_arrays(path: Path, names: Sequence[str]) -> dict[str, NDArray[Any]]:
    """Return the named arrays of the npz file; others in it are not looked at.

    Raises
    ------
    FileError: an array is missing, given twice, of objects, or absurdly large.
    OSError, ValueError, EOFError, RuntimeError, zipfile.BadZipFile, zlib.error: a file that is no
        such archive, or a damaged one.
    """
    with path.open("rb") as file, zipfile.ZipFile(file) as archive:
        listed = archive.namelist()
        wanted = {name: f"{name}.npy" for name in names}
        for name, member in wanted.items():
            if listed.count(member) != 1:
                raise FileError(f"array {name!r} is in it {listed.count(member)} times, not once")
        sizes = {name: archive.getinfo(member).file_size for name, member in wanted.items()}
        size = sum(sizes.values())
        if size > MODEST and size > MAX_EXPANSION * path.stat().st_size:
            raise FileError(f"its arrays would unpack to {size:.3g} bytes, far more than the file")
        arrays = {}
        for name, member in wanted.items():
            with archive.open(member) as stream:
                _refuse_misfit(name, stream, sizes[name])
            with archive.open(member) as stream:
                arrays[name] = npy.read_array(
                    stream, allow_pickle=False, max_header_size=MAX_HEADER
                )
                if stream.read(1):  # also makes the archive compare its checksum
                    raise FileError(f"array {name!r} is followed by something else")
        return arrays


def _refuse_misfit(name: str, stream: IO[bytes], size: int) -> None:
    """Raise FileError unless the array that the header promises is as large as its entry."""
    version = npy.read_magic(stream)
    if version == (1, 0):
        shape, _, dtype = npy.read_array_header_1_0(stream, max_header_size=MAX_HEADER)
    elif version == (2, 0):
        shape, _, dtype = npy.read_array_header_2_0(stream, max_header_size=MAX_HEADER)
    else:
        raise FileError(f"array {name!r} is in version {version} of its format, not in 1 or 2")
    if dtype.hasobject:
        raise FileError(f"array {name!r} holds objects, not numbers")
    promised = math.prod(shape) * dtype.itemsize
    if any(length < 0 for length in shape) or promised != size - stream.tell():
        raise FileError(
            f"array {name!r} promises {promised} bytes of numbers and has {size - stream.tell()}"
        )
