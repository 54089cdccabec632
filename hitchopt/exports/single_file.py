"""Exports of one file, at a path that the user names, instead of a folder."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from hitchopt.checks.certificate import Certificate
from hitchopt.errors import FileError, InputError
from hitchopt.exports.exporting import Export, export_plan
from hitchopt.exports.formats.format import Format, Task
from hitchopt.exports.manifest import FILE

ENDINGS = (".csv", ".parquet", ".npz", ".json", ".skyc", ".zip", ".mcap", ".db3", ".bin", ".yaml")
"""Of what goes into an export's folder: whoever names such a file means no folder."""


def manifest_beside(path: Path) -> Path:
    """Return where the manifest of a single file lies: ``plan.csv.export.json``."""
    return path.with_name(f"{path.name}.{FILE}")


def export_file(
    kind: Format,
    task: Task,
    certificate: Certificate,
    path: Path,
    progress: Callable[[str], None] | None = None,
) -> tuple[Export, ...]:
    """Write the plan as one file, its manifest beside it; return what was written.

    Parameters
    ----------
    kind, task, certificate, progress: as of ``export_plan``.
    path: of the file; its folder is made if it is missing.

    Raises
    ------
    InputError: the format writes several files, or one of another ending.
    FileError: there is a file that no export wrote, or it cannot be written.
    InfeasibleError, CertificateError, UnsupportedError: as ``export_plan``.
    """
    manifest = manifest_beside(path)
    if path.exists() and not manifest.exists():
        raise FileError(f"{path}: is there already, and no export's; choose another name")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".hitchopt-", dir=path.parent) as place:
            done = export_plan(kind, task, certificate, Path(place) / "export", progress)
            (name,) = _only_file(kind, done, path)
            written = done[0].folder
            manifest.unlink(missing_ok=True)  # it seals the file: gone first, back last
            os.replace(written / name, path)
            os.replace(written / FILE, manifest)
    except OSError as error:
        raise FileError(f"{path}: cannot be written: {error.strerror or error}") from error
    return (replace(done[0], folder=path.parent, files=(path.name,)),)


def _only_file(kind: Format, done: tuple[Export, ...], path: Path) -> tuple[str, ...]:
    """Return the name of the one file that was written, if it is such a one as was asked for."""
    names = tuple(name for part in done for name in part.files)
    if len(done) == 1 and len(names) == 1 and Path(names[0]).suffix == path.suffix.lower():
        return names
    some = ", ".join(names[:3]) + (", …" if len(names) > 3 else "")
    raise InputError(
        "-o",
        str(path),
        f"a folder for {kind.name}, or a name that ends as its only file does",
        f"it writes {some}",
    )
