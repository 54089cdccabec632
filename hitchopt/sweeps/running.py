"""Runs of a study on dask: what is missing is computed, every row written as it arrives."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hitchopt.errors import InputError
from hitchopt.sweeps.cluster import finished
from hitchopt.sweeps.dataset import known_rows, load_sweep, write_outcome, write_study
from hitchopt.sweeps.study import Case, Study
from hitchopt.sweeps.study_file import load_study, study_from_dict
from hitchopt.sweeps.work import FAILED, Outcome, Row, outcome_of
from hitchopt.values import path, text, whole

if TYPE_CHECKING:
    import pandas


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
    place = path("directory", directory)
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
    write_study(place, study.title, [p.key for p in study.parameters], list(cases))
    known = known_rows(place)
    missing = {digest: case for digest, case in cases.items() if digest not in known}
    begin, refused = time.monotonic(), 0
    if missing:
        width = workers or os.cpu_count() or 1
        tasks = {digest: (case, digest) for digest, case in missing.items()}
        done = finished(outcome_of, tasks, min(width, len(missing)), scheduler)
        with contextlib.closing(done):
            for computed, (digest, future) in enumerate(done, 1):
                outcome = _outcome(digest, future, missing[digest])
                write_outcome(place, outcome)
                refused += outcome.row["status"] != "planned"
                if progress is not None:
                    left = (time.monotonic() - begin) / computed * (len(missing) - computed)
                    there = len(cases) - len(missing) + computed
                    progress(Count(there, len(cases), computed, refused, left))
    return load_sweep(place)


def _outcome(digest: str, future: Any, case: Case) -> Outcome:
    """Return the outcome of a future; a case that kills its workers, or has a bug, is a row."""
    if future.status == "finished":
        found: Outcome = future.result()
        return found
    error = future.exception()
    row: Row = {"digest": digest, "problem": case.name, "seed": case.seed, "status": FAILED}
    row |= {f"parameter.{key}": value for key, value in case.point.items()}
    return Outcome(digest, row | {"message": f"{type(error).__name__}: {error}"})
