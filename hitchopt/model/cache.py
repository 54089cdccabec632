"""Models kept on disk from one process to the next.

A file is named by all that made it: the versions of hitchopt and casadi, the source that builds
the model, and what was asked for. It is written beside and then renamed, and starts with a digest
of the rest: one that was cut short, altered, or is not ours is built anew and replaced. Nothing
depends on the directory: where it cannot be read or written, models are built.

``HITCHOPT_CACHE`` moves it, or with the value ``off`` does without.
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

Builder = Callable[[bool], ca.Function]
"""Builds a model of one choice."""


def cache_directory() -> Path | None:
    """Return where models are kept; None where they are not to be."""
    asked = os.environ.get(VARIABLE, "")
    if asked.lower() == OFF:
        return None
    if asked:
        return Path(asked)
    try:
        home = Path.home()
    except RuntimeError:  # nobody's process
        return None
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", home / "AppData" / "Local")) / "hitchopt"
    if sys.platform == "darwin":
        return home / "Library" / "Caches" / "hitchopt"
    given = Path(os.environ.get("XDG_CACHE_HOME", ""))
    return (given if given.is_absolute() else home / ".cache") / "hitchopt"


def kept(build: Builder) -> Builder:
    """Return a builder that keeps its models in memory, and on disk for other processes."""

    @lru_cache
    @wraps(build)
    def found(choice: bool) -> ca.Function:
        directory = cache_directory()
        if directory is None:
            return build(choice)
        file = directory / f"{build.__name__}-{_key(build, choice)}.casadi"
        known = _read(file)
        if known is not None:
            return known
        model = build(choice)
        _write(file, model)
        return model

    return found


def _key(build: Builder, choice: bool) -> str:
    """Return what a model depends on, in 32 hexadecimal digits."""
    source = Path(build.__code__.co_filename)
    with contextlib.suppress(OSError):  # as from an archive: then the version has to do
        digest = hashlib.sha256(source.read_bytes())
        digest.update(repr((_version(), ca.CasadiMeta.version(), sys.platform, choice)).encode())
        return digest.hexdigest()[:32]
    return hashlib.sha256(repr((_version(), ca.CasadiMeta.version(), choice)).encode()).hexdigest()[
        :32
    ]


@lru_cache
def _version() -> str:
    try:
        return metadata.version("hitchopt")
    except metadata.PackageNotFoundError:
        return "unknown"


def _read(file: Path) -> ca.Function | None:
    """Return the model in a file, or None where it is none of ours, or no longer whole."""
    try:
        digest, _, text = file.read_text(encoding="ascii").partition("\n")
    except (OSError, UnicodeDecodeError):
        return None
    if digest != _digest(text):
        return None
    try:
        return ca.Function.deserialize(text)
    except RuntimeError:  # casadi's word for what it cannot read
        return None


def _write(file: Path, model: ca.Function) -> None:
    """Write a model beside and rename it; where that cannot be done, it is not."""
    text = model.serialize()
    with contextlib.suppress(OSError):
        file.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        handle, beside = tempfile.mkstemp(prefix=".", suffix=".new", dir=file.parent)
        try:
            with os.fdopen(handle, "w", encoding="ascii", newline="\n") as stream:
                stream.write(f"{_digest(text)}\n{text}")
            Path(beside).replace(file)
        except OSError:
            Path(beside).unlink(missing_ok=True)


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode("ascii")).hexdigest()
