"""A directory exchanged for its successor at once, with all that others keep in it.

The successor is built next to it, in ``.NAME.hitchopt-….tmp/new``, with hard links to the files
that are not ours. One call exchanges the two. A symbolic link to where the exchange leaves it
stands for what cannot have two links (subdirectories), which then trades places with that link: so
every entry is reachable under its name wherever the process is killed, and the next writer finds
its working directory, sees how far it came and finishes.
"""

from __future__ import annotations

import contextlib
import ctypes
import errno
import json
import os
import shutil
import sys
import tempfile
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from hitchopt.storage.previous_set import PREVIOUS, empty_previous

SUFFIX = ".tmp"
"""End of the names of hidden directories."""


class ExchangeUnavailableError(Exception):
    """The directory cannot be exchanged here; nothing in it has changed."""


@dataclass(frozen=True)
class _Record:
    """Facts that settling needs.

    Attributes
    ----------
    successor: inode of the directory that was built.
    others: inodes of the entries that are not ours, by name.
    owned: names that are ours: another writer, who owns fewer, may have to finish.
    """

    successor: int
    others: dict[str, int]
    owned: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Swap:
    """The working directory of one exchange.

    Parameters
    ----------
    target: the directory to replace, no symbolic link.
    work: the working directory next to it.
    owned: the names that are ours to write and to remove.
    """

    target: Path
    work: Path
    owned: Collection[str]

    @classmethod
    def begun(cls, target: Path, owned: Collection[str]) -> Swap:
        """Return a swap with an empty successor that has the target's mode and owner.

        Raises
        ------
        ExchangeUnavailableError: the system, the file system or the place does not allow it.
        """
        try:
            work = tempfile.mkdtemp(SUFFIX, prefix(target), target.parent)
        except OSError as error:
            raise ExchangeUnavailableError from error
        swap = cls(target, Path(work), owned)
        try:
            swap.work.chmod(0o711)  # others pass through it to what stands there for a moment
            swap.new.mkdir()
            if target.exists():
                swap.record.mkdir()  # as a second directory to try the exchange with
                exchange(swap.new, swap.record)
                swap.record.rmdir()
                then, now = target.stat(), swap.new.stat()
                if (then.st_uid, then.st_gid) != (now.st_uid, now.st_gid):
                    os.chown(swap.new, then.st_uid, then.st_gid)
                shutil.copystat(target, swap.new)
        except OSError as error:
            swap.settle()
            raise ExchangeUnavailableError from error
        return swap

    @property
    def new(self) -> Path:
        """The successor; after the exchange, what was there before."""
        return self.work / "new"

    @property
    def record(self) -> Path:
        """File with what settling needs to know, written before the exchange."""
        return self.work / "record.json"

    def commit(self) -> None:
        """Put the successor in the target's place.

        Raises
        ------
        ExchangeUnavailableError: it cannot be done here; the target is as it was.
        """
        try:
            if self.target.exists():
                self._adopt_others()
                exchange(self.new, self.target)
            else:
                self.new.rename(self.target)
            sync(self.target.parent)
        except OSError as error:
            raise ExchangeUnavailableError from error

    def settle(self) -> None:
        """Bring others' entries over, remove the predecessor or an unused successor.

        The last step of every swap, finished or not, of this process or of one that was killed.

        Raises
        ------
        ExchangeUnavailableError: others' entries cannot be moved; the target is as it was.
        """
        record = self._recorded()
        used = (
            record is not None and self.new.exists() and self.new.stat().st_ino != record.successor
        )
        if used:
            self.target.mkdir(exist_ok=True)  # someone may have removed it since
            try:
                self._trade_stand_ins(self.target)
            except OSError as error:
                self._trade_stand_ins(self.new)
                exchange(self.new, self.target)
                self._clear(record, used=False)
                raise ExchangeUnavailableError from error
        self._clear(record, used=used)

    def _adopt_others(self) -> None:
        """Give the successor all of the target's entries that are not ours."""
        with os.scandir(self.target) as entries:
            others = [entry for entry in entries if entry.name not in self.owned]
        inodes = {entry.name: entry.inode() for entry in others}
        record = _Record(self.new.stat().st_ino, inodes, list(self.owned))
        self.record.write_text(json.dumps(vars(record)), encoding="utf-8")
        sync(self.record)
        for entry in others:
            self._adopt(entry)

    def _adopt(self, entry: os.DirEntry[str]) -> None:
        link = self.new / entry.name
        if not entry.is_dir(follow_symlinks=False):
            try:
                os.link(entry.path, link, follow_symlinks=False)
            except FileNotFoundError:  # its owner has just removed it
                return
            except OSError:  # no hard links here, or not to this one: as with a directory
                pass
            else:
                return
        link.symlink_to(self._stand_in(entry.name))

    def _stand_in(self, name: str) -> str:
        """Return where the symbolic link for ``name`` points, seen from the target."""
        return f"../{self.work.name}/{self.new.name}/{name}"

    def _is_stand_in(self, path: Path) -> bool:
        try:
            return os.readlink(path) == self._stand_in(path.name)
        except OSError:
            return False

    def _recorded(self) -> _Record | None:
        """Return the record, or None before it is whole and once the rest is cleared."""
        try:
            return _Record(**json.loads(self.record.read_text(encoding="utf-8")))
        except (OSError, ValueError, TypeError):
            return None

    def _trade_stand_ins(self, place: Path) -> None:
        """Let every stand-in in ``place`` and the subdirectory it stands for change places."""
        for name in _names(self.new):
            if self._is_stand_in(place / name):
                exchange(self.new / name, self.target / name)

    def _clear(self, record: _Record | None, *, used: bool) -> None:
        """Remove what is ours from the predecessor or an unused successor; move the rest back.

        In a successor links to others' files are ours too. Before there is a record, nothing else
        is in it.
        """
        others = {} if record is None else record.others
        owned = record.owned if record is not None and record.owned else self.owned
        ours = {*owned, *(() if used else others)}
        for name in _names(self.new):
            path, home = self.new / name, self.target / name
            with contextlib.suppress(OSError):
                if name == PREVIOUS and (record is None or name in owned) and path.is_dir():
                    empty_previous(path, path if record is None else home, owned)
                elif name in ours or self._is_stand_in(path):
                    path.unlink()
                elif record is not None and not os.path.lexists(home):  # made meanwhile
                    path.rename(home)
                elif used and os.path.samestat(path.lstat(), home.lstat()):
                    path.unlink()
                elif used and home.lstat().st_ino == others.get(name):  # replaced meanwhile
                    path.replace(home)
        with contextlib.suppress(OSError):  # not empty: something in it is not ours to delete
            if self.new.exists():
                self.new.rmdir()
            if self.record.is_dir():
                self.record.rmdir()
            self.record.unlink(missing_ok=True)
            self.work.rmdir()


def prefix(target: Path) -> str:
    """Return how the names of the working directories for ``target`` begin."""
    return f".{target.name}.hitchopt-"


def abandoned(target: Path, owned: Collection[str]) -> Iterator[Swap]:
    """Yield the swaps of ``target`` that killed processes have left."""
    with contextlib.suppress(OSError):
        for name in _names(target.parent):
            work = target.parent / name
            ours = name.startswith(prefix(target)) and name.endswith(SUFFIX)
            if ours and work.is_dir() and not work.is_symlink():
                yield Swap(target, work, owned)


def _names(directory: Path) -> list[str]:
    try:
        return sorted(os.listdir(directory))
    except FileNotFoundError:
        return []


def sync(path: Path) -> None:
    """Make what was written to a file or directory outlast a loss of power, where that works."""
    try:
        descriptor = os.open(path, os.O_RDONLY)
    except OSError:  # a directory, on systems that do not open them
        return
    try:
        with contextlib.suppress(OSError):
            os.fsync(descriptor)
    finally:
        os.close(descriptor)


AT_FDCWD = -100
"""Linux: relative paths start at the current directory."""

RENAME_EXCHANGE = 2
"""Linux: the flag of renameat2."""

RENAME_SWAP = 2
"""MacOS: the flag of renamex_np."""


def exchange(first: Path, second: Path) -> None:
    """Let the two existing entries change places, at once.

    Raises
    ------
    OSError: ENOSYS where the system knows no such call; else what the system says.
    """
    a, b = os.fsencode(first), os.fsencode(second)
    library = ctypes.CDLL(None, use_errno=True) if os.name == "posix" else None
    if sys.platform == "darwin":
        call = getattr(library, "renamex_np", None)
        arguments: tuple[object, ...] = (a, b, ctypes.c_uint(RENAME_SWAP))
    else:
        call = getattr(library, "renameat2", None)
        arguments = (AT_FDCWD, a, AT_FDCWD, b, ctypes.c_uint(RENAME_EXCHANGE))
    if call is None:
        raise OSError(errno.ENOSYS, os.strerror(errno.ENOSYS), str(second))
    if call(*arguments) != 0:
        code = ctypes.get_errno()
        raise OSError(code, os.strerror(code), str(second))
