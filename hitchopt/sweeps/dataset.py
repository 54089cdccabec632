"""Rows of results on disk: a Parquet dataset, one file a row, each written whole or not at all.

A study's directory holds ``rows/DIGEST.parquet``, ``files/DIGEST/`` with what was exported, and
``study.json``: the digests of the study's cases, in order. Rows of other studies that were run in
the same directory stay; what is computed already is not computed again.
"""

from __future__ import annotations

import io
import json
import os
import shutil
import tempfile
import uuid
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hitchopt.errors import FileError, UnsupportedError
from hitchopt.storage.strict_json import write_strict_json
from hitchopt.sweeps.cluster import EXTRA
from hitchopt.sweeps.work import Outcome, Row
from hitchopt.values import path as as_path

if TYPE_CHECKING:
    import pandas

ROWS, FILES, STUDY = "rows", "files", "study.json"

FORMAT = "hitchopt-sweep/1"

MEASURED = ("time.", "memory.")
"""Beginnings of the columns that differ from run to run."""


def write_study(directory: Path, title: str, parameters: Sequence[str], digests: list[str]) -> None:
    """Write which cases a study has."""
    told = {"format": FORMAT, "title": title, "parameters": list(parameters), "cases": digests}
    with _as_file_error(directory):
        (directory / ROWS).mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=directory, prefix=".hitchopt-") as stage:
            write_strict_json(Path(stage) / STUDY, told)
            os.replace(Path(stage) / STUDY, directory / STUDY)


def read_study(directory: Path) -> dict[str, Any]:
    """Return what ``write_study`` wrote.

    Raises
    ------
    FileError: there is no study, or a broken one.
    """
    path = directory / STUDY
    try:
        told = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise FileError(f"{path}: cannot be read ({error}); run hitchopt sweep first") from None
    if not isinstance(told, dict) or told.get("format") != FORMAT:
        raise FileError(f"{path}: is not of the format {FORMAT}; run hitchopt sweep again")
    return told


def known_rows(directory: Path) -> set[str]:
    """Return the digests of the rows that are there."""
    return {path.stem for path in (directory / ROWS).glob("*.parquet")}


def write_outcome(directory: Path, outcome: Outcome) -> None:
    """Write an outcome's files, then its row; the row is there only when all is.

    Raises
    ------
    FileError: the disk is full, or cannot be written to.
    """
    data = _parquet(outcome.row)
    with _as_file_error(directory):
        if outcome.files:
            _write_files(directory, outcome)
        stage = directory / f".hitchopt-{uuid.uuid4().hex}"
        try:
            stage.write_bytes(data)
            os.replace(stage, directory / ROWS / f"{outcome.digest}.parquet")
        finally:
            stage.unlink(missing_ok=True)


def _write_files(directory: Path, outcome: Outcome) -> None:
    """Write an outcome's files, all at once."""
    with tempfile.TemporaryDirectory(dir=directory, prefix=".hitchopt-") as stage:
        made = Path(stage) / FILES
        for name, data in outcome.files.items():
            (made / name).parent.mkdir(parents=True, exist_ok=True)
            (made / name).write_bytes(data)
        place = directory / FILES / outcome.digest
        place.parent.mkdir(exist_ok=True)
        shutil.rmtree(place, ignore_errors=True)
        os.replace(made, place)


def _parquet(row: Row) -> bytes:
    """Return the Parquet file of a row; statistics and dictionaries of one value save nothing."""
    parquet, sink = _pyarrow("pyarrow.parquet"), io.BytesIO()
    options = {"compression": "none", "use_dictionary": False, "write_statistics": False}
    parquet.write_table(_table(row), sink, **options)
    return sink.getvalue()


def _table(row: Row) -> Any:
    """Return a table of one row; values that are no scalars as JSON."""
    pyarrow = _pyarrow("pyarrow")
    columns = {}
    for name in sorted(row):
        value = row[name]
        if isinstance(value, dict | list):
            value = json.dumps(value, sort_keys=True)
        if isinstance(value, int) and not isinstance(value, bool) and name != "seed":
            value = float(value)  # the same type in every row
        columns[name] = pyarrow.array([value])
    return pyarrow.table(columns)


def load_sweep(directory: Path | str) -> pandas.DataFrame:
    """Return the rows of a sweep as a data frame, in the study's order; those missing left out.

    Columns are ``problem``, ``seed``, ``parameter.KEY`` of every parameter, ``status`` (planned,
    infeasible, time limit, failed or wrong), ``binding`` (name of the limit), ``message``,
    ``duration`` [s], ``check.NAME`` for the worst value of every check of the certificate,
    ``simulate.…``, ``settle.…``, ``export.checked``, ``time.…`` (processor time [s]),
    ``memory.peak`` (largest memory of the worker so far [MiB]) and ``digest``.

    Parameters
    ----------
    directory: the directory of ``run_sweep``.

    Raises
    ------
    FileError: there is no sweep.
    UnsupportedError: pandas or pyarrow is not installed.
    """
    place = as_path("directory", directory)
    told = read_study(place)
    known = known_rows(place)
    paths = [place / ROWS / f"{d}.parquet" for d in told["cases"] if d in known]
    frames, pyarrow = _pyarrow("pandas"), _pyarrow("pyarrow")
    parquet = _pyarrow("pyarrow.parquet")
    if not paths:
        empty: pandas.DataFrame = frames.DataFrame({"digest": []})
        return empty
    tables = [parquet.read_table(path, partitioning=None) for path in paths]
    whole = pyarrow.concat_tables(tables, promote_options="permissive").to_pandas()
    first = ["problem", "seed", *(f"parameter.{key}" for key in told["parameters"])]
    first += ["status", "binding", "message", "duration"]
    last = [name for name in whole if name.startswith(MEASURED)] + ["digest"]
    named = {*first, *last}
    middle = sorted(name for name in whole if name not in named)
    rows: pandas.DataFrame = whole.reindex(columns=[*first, *middle, *last])
    return rows


def _pyarrow(name: str) -> Any:
    """Return a module of the extra, or raise UnsupportedError."""
    from importlib import import_module

    try:
        return import_module(name)
    except ImportError:
        raise UnsupportedError(f"sweeps need {name.split('.', maxsplit=1)[0]}: {EXTRA}") from None


class _as_file_error:  # noqa: N801, a context manager
    """Turns errors of the file system within it into FileErrors."""

    def __init__(self, directory: Path) -> None:
        self._directory = directory

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if isinstance(error, OSError):
            reason = error.strerror or str(error)
            raise FileError(
                f"{self._directory}: cannot be written: {reason}; free space or permissions there, "
                "then run the same study again: only what is missing is computed"
            ) from error
