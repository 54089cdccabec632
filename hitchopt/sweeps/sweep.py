"""Runs of a study and the rows that they write: missing ones are computed, row by row.

A study's directory holds ``rows.jsonl``, one row a line, and ``study.json``: the digests of the
study's cases, in order. Rows of other studies that were run in the same directory stay; what is
computed already is not computed again. A row is appended by one write, so that whatever ends a run
leaves at most one line that is not whole, which is passed over.
"""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hitchopt.errors import FileError, InputError, UnsupportedError
from hitchopt.simulation.flight import Progress
from hitchopt.storage.files import replace_files, write_strict_json
from hitchopt.storage.yaml_file import located, parse_yaml, read_text
from hitchopt.sweeps.study import Study, digest_of, study_from_dict
from hitchopt.sweeps.work import FAILED, PLANNED, Row, finished, first_columns, row_of
from hitchopt.values import integer, text
from hitchopt.values import path as as_path

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure

ROWS, STUDY, PICTURE, FORMAT = "rows.jsonl", "study.json", "sweep.png", "hitchopt-sweep/1"

PARAMETER = "parameter."  # Beginning of the columns of parameters
SEAL = "sha256"  # of all else in a row

# Columns whose medians a summary shows, and what they are for people
FIGURES = {"duration": "duration [s]", "simulate.peak_tension": "largest tension [N]"}


def run_sweep(
    study: Study | Mapping[str, object] | str | Path,
    directory: Path | str,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    progress: Progress | None = None,
) -> pandas.DataFrame:
    """Compute the rows of a study that are missing in a directory; return all as ``load_sweep``.

    Every case is planned and certified, then simulated if the study says so. Every result is
    written as it arrives, keyed by a digest of problem, versions and seed: whatever ends a run, the
    same call goes on from there.

    Parameters
    ----------
    study: a study, its keys, or the path of its file.
    directory: created if it is missing.
    workers: number of processes on this machine; None for one per processor.
    scheduler: address of a dask scheduler that has workers; None for a cluster of this machine.
    progress: called after every row, with the number of rows.

    Raises
    ------
    InputError, FileError: a study that is wrong in itself, or a directory that cannot be written.
    SweepError: the scheduler was lost.
    UnsupportedError: dask.distributed or pandas is not installed.
    """
    place = as_path("directory", directory)
    if workers is not None:
        integer("workers", workers, 1)
    if scheduler is not None:
        text("scheduler", scheduler)
    if isinstance(study, str | Path):
        source = read_text(study)
        with located(*source):
            study = study_from_dict(parse_yaml(*source), Path(study).parent)
    elif isinstance(study, Mapping):
        study = study_from_dict(study)
    elif not isinstance(study, Study):
        raise InputError("study", study, "a Study, its keys, or a path", "see hitchopt.Study")
    cases = {case.digest: case for case in study.cases()}
    content = {
        "format": FORMAT,
        "title": study.keys.title,
        "parameters": list(study.keys.parameters),
        "cases": list(cases),
    }
    writers = {STUDY: lambda path: write_strict_json(path, content)}
    replace_files(place, writers, (STUDY,), seal=STUDY)
    known, refused = _read_rows(place), 0
    missing = {digest: case for digest, case in cases.items() if digest not in known}
    width = min(workers or os.cpu_count() or 1, len(missing))
    tasks = {digest: (case, digest) for digest, case in missing.items()}
    with contextlib.closing(finished(row_of, tasks, width, scheduler)) as done:
        for count, (digest, future) in enumerate(done, 1 + len(cases) - len(missing)):
            if future.status == "finished":
                row: Row = future.result()
            else:  # a case that kills its workers, or has a bug, is a row
                error = future.exception()
                words = {"status": FAILED, "message": f"{type(error).__name__}: {error}"}
                row = first_columns(missing[digest], digest) | words
            write_row(place, row)
            refused += row["status"] != PLANNED
            if progress is not None:
                progress(f"{count} of {len(cases)} rows, {refused} without a plan")
    return load_sweep(place)


def load_sweep(directory: Path | str) -> pandas.DataFrame:
    """Return the rows of a sweep as a data frame, in the study's order; those missing left out.

    Columns are ``problem``, ``seed``, ``parameter.KEY`` of every parameter, ``status`` (planned,
    infeasible, time limit, failed or wrong), ``binding`` (name of the limit), ``message``,
    ``duration`` [s], ``check.NAME`` for the worst value of every check of the certificate,
    ``simulate.…``, ``time.…`` (processor time [s]) and ``digest``.

    Parameters
    ----------
    directory: the directory of ``run_sweep``.

    Raises
    ------
    FileError: there is no sweep.
    UnsupportedError: pandas is not installed.
    """
    try:
        import pandas
    except ImportError:
        raise UnsupportedError("sweeps need pandas: pip install 'hitchopt[sweep]'") from None
    place = as_path("directory", directory)
    study, rows = read_study(place), _read_rows(place)
    table = pandas.DataFrame([rows[digest] for digest in study["cases"] if digest in rows])
    if table.empty:
        return pandas.DataFrame({"digest": []})
    first = ["problem", "seed", *(f"parameter.{key}" for key in study["parameters"])]
    first += ["status", "binding", "message", "duration"]
    return table.reindex(columns=[*first, *sorted(set(table.columns) - set(first))])


def read_study(directory: Path) -> dict[str, Any]:
    """Return title, parameters and cases of the study that was run in a directory, or FileError."""
    path = directory / STUDY
    try:
        study = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        words = getattr(error, "strerror", None) or error
        raise FileError(f"{path}: cannot be read ({words}); run hitchopt sweep first") from None
    if not isinstance(study, dict) or study.get("format") != FORMAT:
        raise FileError(f"{path}: is not of the format {FORMAT}; run hitchopt sweep again")
    return study


def _read_rows(directory: Path) -> dict[str, Row]:
    """Return the rows of a directory by digest; lines that are not whole are left out.

    Raises FileError for a row that was edited.
    """
    path, rows = directory / ROWS, dict[str, Row]()
    try:
        lines = path.read_text("utf-8", "replace").splitlines() if path.exists() else []
    except OSError as error:
        raise FileError(f"{path}: cannot be read: {error}") from error
    for number, line in enumerate(lines, 1):
        with contextlib.suppress(ValueError, KeyError, TypeError):
            row = json.loads(line)
            rows[row["digest"]] = row
            if row.pop(SEAL, None) != digest_of(row):
                raise FileError(
                    f"{path}: line {number} was edited, or is of an earlier release; delete it, "
                    "and run the study again: it is computed anew"
                )
    return rows


def write_row(directory: Path, row: Row) -> None:
    """Append a row as one line; raises FileError where the disk is full or cannot be written to."""
    values = {name: _scalar(name, value) for name, value in row.items()}
    values[SEAL] = digest_of(values)
    line = f"\n{json.dumps(values)}\n".encode()  # a line of its own after one that is not whole
    try:
        with (directory / ROWS).open("ab", buffering=0) as file:
            if file.write(line) != len(line):
                raise OSError(0, "the disk is full")
    except OSError as error:
        raise FileError(
            f"{directory}: cannot be written: {error.strerror or error}; free space or permissions "
            "there, then run the same study again: only what is missing is computed"
        ) from error


def _scalar(name: str, value: object) -> object:
    """Return a value of one type in all rows: lists and mappings are JSON, numbers floats."""
    if isinstance(value, dict | list):
        return json.dumps(value, sort_keys=True)
    number = isinstance(value, int) and not isinstance(value, bool) and name != "seed"
    return float(value) if number else value  # type: ignore[arg-type]


@dataclass(frozen=True)
class Share:
    """How many of some rows have a property, and Wilson's interval of the rate (1927)."""

    count: int
    rows: int

    @property
    def interval(self) -> tuple[float, float]:
        """Wilson's 95 % interval, which suits few rows too."""
        from scipy.stats import binomtest

        low, high = binomtest(self.count, self.rows).proportion_ci(0.95, method="wilson")
        return float(low), float(high)

    def __str__(self) -> str:
        low, high = self.interval
        return f"{self.count} of {self.rows} ({100 * low:.0f}–{100 * high:.0f} %)"


@dataclass(frozen=True)
class Summary:
    """A sweep in figures."""

    cases: int  # of the study; of rows there may be fewer
    planned: Share  # of rows with a plan
    succeeded: Share | None  # of simulated flights; None where there are none
    binding: tuple[tuple[str, int], ...]  # limits that bound, or other reasons, most frequent first


def summary(rows: pandas.DataFrame, cases: int) -> Summary:
    """Return the summary of a sweep's rows; InputError without rows."""
    if not len(rows):
        raise InputError("rows", 0, "at least 1", "run the sweep first")
    planned, flown, share = rows["status"] == PLANNED, rows.get("simulate.succeeded"), None
    if flown is not None and len(flown := flown.dropna()):
        share = Share(int(flown.astype(bool).sum()), len(flown))
    reasons = rows.loc[~planned, "binding"].fillna(rows.loc[~planned, "status"])
    binding = tuple((str(name), int(count)) for name, count in reasons.value_counts().items())
    return Summary(cases, Share(int(planned.sum()), len(rows)), share, binding)


def outcomes(rows: pandas.DataFrame) -> list[dict[str, Any]]:
    """Return parameters that vary, and what became of every point (medians), by a table's heads."""
    keys = [x for x in rows.columns if x == "problem" or x.startswith(PARAMETER)]
    keys = [key for key in keys if rows[key].nunique(dropna=False) > 1]
    found = list[dict[str, Any]]()
    for at, same in rows.groupby(keys or ["problem"], sort=False, dropna=False):
        row = {key.removeprefix(PARAMETER): value for key, value in zip(keys, at, strict=False)}
        refused = same[same["status"] != PLANNED]
        row["planned"] = refused.empty
        row |= {head: float(same[name].median()) for name, head in FIGURES.items() if name in same}
        if len(refused):
            row["binding"] = refused["binding"].fillna(refused["status"]).iloc[0]
        if len(flown := same.get("simulate.succeeded", same["status"][:0]).dropna()):
            row["flown well"] = f"{int(flown.astype(bool).sum())} of {len(flown)}"
        found.append(row)
    return found


def drawn_sweep(points: list[dict[str, Any]]) -> Figure | None:
    """Return the picture of ``outcomes``: the last figure over the first parameter, if any varies.

    Every combination of the others is a curve; a point without a plan is a cross with its reason.
    """
    from hitchopt.view import style
    from hitchopt.view.pictures import STYLES

    heads = list(points[0])
    if not (keys := heads[: heads.index("planned")]):
        return None
    figure, head = style.new_figure((6.5, 4.0)), [x for x in FIGURES.values() if x in heads][-1]
    axes = figure.add_subplot(xlabel=keys[0], ylabel=head)
    curves = dict[str, list[dict[str, Any]]]()
    for row in points:
        curves.setdefault(", ".join(f"{key} {row[key]}" for key in keys[1:]), []).append(row)
    for (words, curve), (colour, line) in zip(curves.items(), cycle(STYLES)):
        at = [x if isinstance(x := row[keys[0]], int | float) else str(x) for row in curve]
        axes.plot(at, [row[head] for row in curve], "o", ls=line, ms=4, color=colour, label=words)
        for x, row in zip(at, curve, strict=True):
            if not row["planned"]:
                axes.plot(x, 0.0, "x", color=style.LIMIT_COLOUR)
                style.write(axes, row["binding"], (x, 0.0), (0, 6), rotation=90, va="bottom")
    style.from_zero(axes)
    if 1 < len(curves) <= len(STYLES):
        axes.legend(fontsize="small", frameon=False)
    return figure
