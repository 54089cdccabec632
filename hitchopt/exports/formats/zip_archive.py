"""Zip files from anywhere, read within bounds."""

from __future__ import annotations

import contextlib
import zipfile
from collections.abc import Iterator, Sequence
from pathlib import Path

from hitchopt.errors import FileError
from hitchopt.storage.archive import BROKEN, checked_bytes, refuse_bomb

MAX_UNPACKED = 500_000_000
"""Size limit of all that is read of one zip, unpacked [B]."""


@contextlib.contextmanager
def opened_zip(path: Path, what: str) -> Iterator[zipfile.ZipFile]:
    """Open a zip file for the block; whatever is wrong with it within the block is a FileError.

    Parameters
    ----------
    path: name of the file.
    what: what it is expected to be, as in "is no ``what``".
    """
    try:
        with zipfile.ZipFile(path) as archive:
            yield archive
    except FileError as error:
        if str(error).startswith(str(path)):
            raise
        raise FileError(f"{path}: {error}") from error
    except (KeyError, TypeError, AttributeError, IndexError) as error:
        raise FileError(f"{path}: is no {what}: {error!r} in its description") from error
    except BROKEN as error:
        raise FileError(f"{path}: is no {what}, or a damaged one: {error}") from error


def read_members(
    path: Path, archive: zipfile.ZipFile, members: Sequence[zipfile.ZipInfo]
) -> Iterator[bytes]:
    """Yield the bytes of files in the archive, one after the other.

    Raises
    ------
    FileError: together they are too large, or they are packed in an unusual manner.
    BROKEN: the archive is damaged.
    """
    size = sum(member.file_size for member in members)
    if size > MAX_UNPACKED:
        raise FileError(f"its files unpack to {size:.3g} bytes; {MAX_UNPACKED} are the most")
    refuse_bomb(members, path.stat().st_size)
    for member in members:
        yield checked_bytes(archive, member)
