"""Models stored on disk from one process to the next.

A file is named by all that made it: the versions of hitchopt and casadi, the source that builds
the model, and the choice. It is written under a temporary name and then renamed, and starts with a
digest of the rest: models of damaged and foreign files are built anew, and the files replaced.
Nothing depends on the directory: where it cannot be read or written, models are built.

``HITCHOPT_CACHE`` moves it, or with the value ``off`` disables it.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import sys
import tempfile
from collections.abc import Callable
from functools import lru_cache, wraps
from importlib import metadata
from pathlib import Path

import casadi as ca

VARIABLE = "HITCHOPT_CACHE"
OFF = "off"

Builder = Callable[..., ca.Function]
"""Function that builds the model of some choices, each true or false."""


def cache_directory() -> Path | None:
    """Return where models are stored; None if they are not stored."""
    given = os.environ.get(VARIABLE, "")
    if given.lower() == OFF:
        return None
    if given:
        return Path(given)
    try:
        home = Path.home()
    except RuntimeError:  # a process without a user
        return None
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", home / "AppData" / "Local")) / "hitchopt"
    if sys.platform == "darwin":
        return home / "Library" / "Caches" / "hitchopt"
    base = Path(os.environ.get("XDG_CACHE_HOME", ""))
    return (base if base.is_absolute() else home / ".cache") / "hitchopt"


def stored(build: Builder) -> Builder:
    """Return a builder that stores its models in memory, and on disk for other processes."""

    @lru_cache
    @wraps(build)
    def found(*choices: bool) -> ca.Function:
        directory = cache_directory()
        if directory is None:
            return build(*choices)
        file = directory / f"{build.__name__}-{_key(build, choices)}.casadi"
        known = _read(file)
        if known is not None:
            return known
        model = build(*choices)
        _write(file, model)
        return model

    return found


def _key(build: Builder, choices: tuple[bool, ...]) -> str:
    """Return what a model depends on, in 32 hexadecimal digits."""
    made_of = repr((_version(), ca.CasadiMeta.version(), sys.platform, choices)).encode()
    with contextlib.suppress(OSError):  # in an archive, the version identifies the source
        for file in sorted(Path(build.__code__.co_filename).parent.glob("*.py")):
            made_of += file.read_bytes()
    return hashlib.sha256(made_of).hexdigest()[:32]


@lru_cache
def _version() -> str:
    try:
        return metadata.version("hitchopt")
    except metadata.PackageNotFoundError:
        return "unknown"


def _read(file: Path) -> ca.Function | None:
    """Return the model in a file, or None where the file is foreign or damaged."""
    try:
        digest, _, text = file.read_text(encoding="ascii").partition("\n")
    except (OSError, UnicodeDecodeError):
        return None
    if digest != _digest(text):
        return None
    try:
        return ca.Function.deserialize(text)
    except RuntimeError:  # casadi cannot read it
        return None


def _write(file: Path, model: ca.Function) -> None:
    """Write a model to a temporary file and rename it, if the directory permits."""
    text = model.serialize()
    with contextlib.suppress(OSError):
        file.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(prefix=".", suffix=".new", dir=file.parent)
        try:
            with os.fdopen(handle, "w", encoding="ascii", newline="\n") as stream:
                stream.write(f"{_digest(text)}\n{text}")
            Path(temporary).replace(file)
        except OSError:
            Path(temporary).unlink(missing_ok=True)


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode("ascii")).hexdigest()
