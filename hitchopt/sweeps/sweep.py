"""Runs of a study and the rows that they write: what is missing is computed, row by row.

A study's directory holds ``rows/DIGEST.parquet``, ``files/DIGEST/`` with what was exported, and
``study.json``: the digests of the study's cases, in order. Rows of other studies that were run in
the same directory stay; what is computed already is not computed again.
"""

from __future__ import annotations

import contextlib
import difflib
import io
import json
import os
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hitchopt.errors import FileError, InputError, UnsupportedError
from hitchopt.storage.files import write_strict_json
from hitchopt.sweeps.study import Study, load_study, study_from_dict
from hitchopt.sweeps.work import (
    EXTRA,
    FAILED,
    PLANNED,
    Outcome,
    Row,
    finished,
    first_columns,
    outcome_of,
)
from hitchopt.values import path as as_path
from hitchopt.values import text, whole

if TYPE_CHECKING:
    import pandas

ROWS, FILES, STUDY = "rows", "files", "study.json"

FORMAT = "hitchopt-sweep/1"

MEASURED = ("time.", "memory.")
"""Beginnings of the columns that differ from run to run."""

LEVEL = 0.95
"""Confidence of Wilson's intervals."""


@dataclass(frozen=True)
class Count:
    """How far a sweep has come.

    Attributes
    ----------
    done, cases: number of rows there are, and that there will be.
    computed: number of rows that this run has computed.
    refused: number of these that are not planned.
    left: estimate of the time left [s]; None before the first row.
    """

    done: int
    cases: int
    computed: int
    refused: int
    left: float | None

    @property
    def fraction(self) -> float:
        """Share of the rows that are there."""
        return self.done / max(self.cases, 1)

    def __str__(self) -> str:
        left = "" if self.left is None else f", about {self.left:.0f} s left"
        return f"{self.done} of {self.cases} rows, {self.refused} without a plan{left}"


def run_sweep(
    study: Study | Mapping[str, object] | str | Path,
    directory: Path | str,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    progress: Callable[[Count], None] | None = None,
) -> pandas.DataFrame:
    """Compute the rows of a study that are missing in a directory; return all of them.

    Every case is planned and certified, then simulated, settled or exported as the study says.
    Every result is written whole as it arrives, keyed by a digest of problem, versions and seed:
    whatever ends a run, the same call goes on from there.

    Parameters
    ----------
    study: a study, its keys, or the path of its file.
    directory: made if it is missing.
    workers: number of processes on this machine; None for one per processor.
    scheduler: address of a dask scheduler that has workers; None for a cluster of this machine.
    progress: called after every row.

    Returns
    -------
    As ``load_sweep``.

    Raises
    ------
    InputError, FileError: a study that is wrong in itself, or a directory that cannot be written.
    SweepError: the scheduler was lost.
    UnsupportedError: dask.distributed, pandas or pyarrow is not installed.
    """
    place = as_path("directory", directory)
    if workers is not None:
        whole("workers", workers, 1)
    if scheduler is not None:
        text("scheduler", scheduler)
    if isinstance(study, str | Path):
        study = load_study(study)
    elif isinstance(study, Mapping):
        study = study_from_dict(study)
    elif not isinstance(study, Study):
        raise InputError("study", study, "a Study, its keys, or a path", "see hitchopt.Study")
    cases = {case.digest: case for case in study.cases()}
    write_study(place, study.keys.title, [p.key for p in study.parameters], list(cases))
    known = {path.stem for path in (place / ROWS).glob("*.parquet")}
    missing = {digest: case for digest, case in cases.items() if digest not in known}
    begin, refused = time.monotonic(), 0
    width = min(workers or os.cpu_count() or 1, len(missing))
    tasks = {digest: (case, digest) for digest, case in missing.items()}
    with contextlib.closing(finished(outcome_of, tasks, width, scheduler)) as done:
        for computed, (digest, future) in enumerate(done if missing else (), 1):
            if future.status == "finished":
                outcome: Outcome = future.result()
            else:  # a case that kills its workers, or has a bug, is a row
                error = future.exception()
                told = {"status": FAILED, "message": f"{type(error).__name__}: {error}"}
                outcome = Outcome(digest, first_columns(missing[digest], digest) | told)
            write_outcome(place, outcome)
            refused += outcome.row["status"] != PLANNED
            if progress is not None:
                left = (time.monotonic() - begin) / computed * (len(missing) - computed)
                there = len(cases) - len(missing) + computed
                progress(Count(there, len(cases), computed, refused, left))
    return load_sweep(place)


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
    files = [place / ROWS / f"{digest}.parquet" for digest in told["cases"]]
    frames, pyarrow, parquet = map(_extra, ("pandas", "pyarrow", "pyarrow.parquet"))
    tables = [parquet.read_table(file, partitioning=None) for file in files if file.exists()]
    if not tables:
        empty: pandas.DataFrame = frames.DataFrame({"digest": []})
        return empty
    table = pyarrow.concat_tables(tables, promote_options="permissive").to_pandas()
    first = ["problem", "seed", *(f"parameter.{key}" for key in told["parameters"])]
    first += ["status", "binding", "message", "duration"]
    last = [name for name in table if name.startswith(MEASURED)] + ["digest"]
    middle = sorted(name for name in table if name not in {*first, *last})
    rows: pandas.DataFrame = table.reindex(columns=[*first, *middle, *last])
    return rows


def write_study(directory: Path, title: str, parameters: Sequence[str], digests: list[str]) -> None:
    """Write which cases a study has."""
    told = {"format": FORMAT, "title": title, "parameters": list(parameters), "cases": digests}
    with _stage(directory) as stage:
        (directory / ROWS).mkdir(exist_ok=True)
        write_strict_json(stage / STUDY, told)
        os.replace(stage / STUDY, directory / STUDY)


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


def write_outcome(directory: Path, outcome: Outcome) -> None:
    """Write an outcome's files, then its row; the row is there only when all is.

    Raises
    ------
    FileError: the disk is full, or cannot be written to.
    """
    data = _parquet(outcome.row)
    with _stage(directory) as stage:
        for name, content in outcome.files.items():
            (stage / FILES / name).parent.mkdir(parents=True, exist_ok=True)
            (stage / FILES / name).write_bytes(content)
        if outcome.files:
            place = directory / FILES / outcome.digest
            place.parent.mkdir(exist_ok=True)
            shutil.rmtree(place, ignore_errors=True)
            os.replace(stage / FILES, place)
        (stage / ROWS).write_bytes(data)
        os.replace(stage / ROWS, directory / ROWS / f"{outcome.digest}.parquet")


@contextlib.contextmanager
def _stage(directory: Path) -> Iterator[Path]:
    """Yield a temporary directory within another one; errors of files become FileErrors."""
    try:
        directory.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=directory, prefix=".hitchopt-") as stage:
            yield Path(stage)
    except OSError as error:
        raise FileError(
            f"{directory}: cannot be written: {error.strerror or error}; free space or permissions "
            "there, then run the same study again: only what is missing is computed"
        ) from error


def _parquet(row: Row) -> bytes:
    """Return the Parquet file of a row; values that are no scalars are JSON.

    Statistics and dictionaries of one value save nothing.
    """
    pyarrow, parquet, sink = _extra("pyarrow"), _extra("pyarrow.parquet"), io.BytesIO()
    columns = {}
    for name, given in sorted(row.items()):
        value = json.dumps(given, sort_keys=True) if isinstance(given, dict | list) else given
        number = isinstance(value, int) and not isinstance(value, bool) and name != "seed"
        columns[name] = pyarrow.array([float(value) if number else value])  # one type in all rows
    options = {"compression": "none", "use_dictionary": False, "write_statistics": False}
    parquet.write_table(pyarrow.table(columns), sink, **options)
    return sink.getvalue()


def _extra(name: str) -> Any:
    """Return a module of the extra, or raise UnsupportedError."""
    try:
        return import_module(name)
    except ImportError:
        raise UnsupportedError(f"sweeps need {name.split('.', maxsplit=1)[0]}: {EXTRA}") from None


@dataclass(frozen=True)
class Share:
    """How many of some rows have a property, and Wilson's interval of the rate (1927)."""

    count: int
    rows: int

    @property
    def interval(self) -> tuple[float, float]:
        """Wilson's 95 % interval, which suits few rows too."""
        from scipy.stats import binomtest

        found = binomtest(self.count, self.rows).proportion_ci(LEVEL, method="wilson")
        return float(found.low), float(found.high)

    def __str__(self) -> str:
        low, high = self.interval
        return f"{self.count} of {self.rows} ({100 * low:.0f}–{100 * high:.0f} %)"


@dataclass(frozen=True)
class Summary:
    """A sweep in figures.

    Attributes
    ----------
    cases: number of cases of the study; of rows there may be fewer.
    planned: share of rows with a plan.
    succeeded: share of simulated flights that succeeded; None where none was simulated.
    binding: names of limits that bound, or other reasons, with their counts, the most frequent
        first.
    medians: median, smallest and largest value of every figure, by column.
    """

    cases: int
    planned: Share
    succeeded: Share | None
    binding: tuple[tuple[str, int], ...]
    medians: dict[str, tuple[float, float, float]]


def summary(rows: pandas.DataFrame, cases: int) -> Summary:
    """Return what the rows of a sweep come to.

    Raises
    ------
    InputError: no rows.
    """
    if not len(rows):
        raise InputError("rows", 0, "at least 1", "run the sweep first")
    planned, flown, share = rows["status"] == PLANNED, rows.get("simulate.succeeded"), None
    if flown is not None and flown.notna().any():
        share = Share(int(flown.fillna(False).astype(bool).sum()), int(flown.notna().sum()))
    reasons = rows.loc[~planned, "binding"].fillna(rows.loc[~planned, "status"])
    medians = {}
    for name in map(str, rows.columns):
        known = rows[name].dropna()
        figure = name == "duration" or name.startswith(("check.", "simulate.", "settle.", "time."))
        if figure and known.dtype.kind == "f" and len(known):
            medians[name] = (float(known.median()), float(known.min()), float(known.max()))
    return Summary(
        cases,
        Share(int(planned.sum()), len(rows)),
        share,
        tuple((str(name), int(count)) for name, count in reasons.value_counts().items()),
        medians,
    )


def column_of(rows: pandas.DataFrame, name: str) -> str:
    """Return the column that a name means: itself, or a parameter's, or a check's.

    Raises
    ------
    InputError: no such column; the remedy names near ones.
    """
    for column in (name, f"parameter.{name}", f"check.{name}", f"simulate.{name}"):
        if column in rows and rows[column].notna().any():
            return column
    near = difflib.get_close_matches(name, list(map(str, rows.columns)), n=3, cutoff=0.3)
    raise InputError("--plot", name, "a column with values", f"such as {', '.join(near)}")
