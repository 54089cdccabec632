"""Run studies: compute the missing rows in parallel on dask, and load and summarise all rows.

A study's directory holds ``rows.jsonl``, one row per line, and ``study.json`` with the digests of
the study's cases, in order. Rows of other studies in the same directory are preserved and reused.
Each row is appended by one write, so an interrupted run leaves at most one incomplete line, which
is ignored.
"""

from __future__ import annotations

import contextlib
import json
import logging
import multiprocessing
import os
import time
from collections.abc import Callable, Generator, Iterator, Mapping
from dataclasses import dataclass
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hitchopt.errors import (
    FileError,
    HitchoptError,
    InfeasibleError,
    InputError,
    Progress,
    TimeLimitError,
    optional_module,
)
from hitchopt.lab.simulation.settings import ROPES
from hitchopt.lab.sweeps.study import Case, Study, digest_of, study_from_dict
from hitchopt.mission.loading import unit_of
from hitchopt.storage.files import file_bytes, file_text, replace_files, write_strict_json
from hitchopt.storage.yaml_file import located, parse_yaml, read_text
from hitchopt.values import integer, text
from hitchopt.values import path as as_path
from hitchopt.values.fields import suggest_keywords
from hitchopt.view import style

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure

    from hitchopt.plan import Plan

ROWS = "rows.jsonl"  # Results, one row per line
STUDY = "study.json"  # The study, as it was read
PICTURE = "sweep.png"  # Picture of the results
FORMAT = "hitchopt-sweep/1"  # Format of the study's file

PARAMETER = "parameter."  # Prefix of the columns of parameters
SEAL = "sha256"  # Key of the digest of a row's other columns

FIGURES = {"duration": "duration [s]", "simulate.peak_tension": "largest tension [N]"}
"""Columns whose medians are reported, and their labels."""

Row = dict[str, Any]  # A row of the results, by column; unknown values are None

PLANNED = "planned"  # Value of the column ``status`` of a case with a plan
# Value of the column ``status`` of a case without a plan, in addition to those of errors
FAILED = "failed"

STATUS = {TimeLimitError: "time limit", InfeasibleError: "infeasible", InputError: "wrong"}
"""Statuses of errors; other errors are FAILED."""

# Settings of dask. The profiler takes more than a tenth of the planning time, and returning freed
# memory to the system at once a seventh.
SETTINGS = {
    "distributed.scheduler.allowed-failures": 3,  # workers that a task may kill
    "distributed.comm.timeouts.connect": "5s",
    "distributed.admin.large-graph-warning-threshold": "1GB",  # a flight is sent once, as a task
    "distributed.worker.daemon": True,
    "distributed.worker.profile.enabled": False,
    "distributed.admin.system-monitor.gil.enabled": False,
    "distributed.nanny.pre-spawn-environ.MALLOC_TRIM_THRESHOLD_": None,
}


@suggest_keywords
def run_sweep(
    study: Study | Mapping[str, object] | str | Path,
    directory: Path | str,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    progress: Progress | None = None,
) -> pandas.DataFrame:
    """Compute the rows of a study that are missing in a directory; return all as ``load_sweep``.

    Every case is planned and certified, then simulated if the study requests it. Every row is saved
    immediately, keyed by a digest of problem, versions and seed, so that the same call continues an
    interrupted run.

    Parameters
    ----------
    study: a study, its keys, or the path of its file.
    directory: created if it is missing.
    workers: number of processes on this machine; None for one per processor.
    scheduler: address of a dask scheduler with workers; None for processes on this machine.
    progress: status callback, called after every row.

    Raises
    ------
    InputError, FileError: the study is invalid, the directory is not writable, or a script calls
        this without ``if __name__ == "__main__":``, so that workers cannot import it.
    SweepError: the scheduler was lost.
    UnsupportedError: dask.distributed or pandas is not installed, or mujoco for simulated ropes.
    """
    folder = as_path("directory", directory)
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
        remedy = "see hitchopt.lab.sweeps.study.Study"
        raise InputError("study", study, "a Study, its keys, or a path", remedy)
    cases = {case.digest: case for case in study.cases()}
    for name in ("dask", "distributed", "pandas"):  # before anything is computed
        optional_module(name, "sweeps need", "sweep")
    simulated = [case.simulate for case in cases.values() if case.simulate is not None]
    if any(keys.get("cables", ROPES) == ROPES for keys in simulated):
        optional_module("mujoco", "simulating needs", "simulate")
    content = {
        "format": FORMAT,
        "title": study.keys.title,
        "parameters": list(study.keys.parameters),
        "cases": list(cases),
    }
    writers = {STUDY: lambda path: write_strict_json(path, content)}
    replace_files(folder, writers, (STUDY,), seal=STUDY)
    computed = _read_rows(folder)
    refused = 0
    missing = {digest: case for digest, case in cases.items() if digest not in computed}
    workers = min(workers or os.cpu_count() or 1, len(missing))
    tasks = {digest: (case, digest) for digest, case in missing.items()}
    with contextlib.closing(run_tasks(compute_row, tasks, workers, scheduler)) as futures:
        for count, (digest, future) in enumerate(futures, 1 + len(cases) - len(missing)):
            if future.status == "finished":
                row: Row = future.result()
            else:  # the case killed its workers, or raised another error
                error = future.exception()
                failure = {"status": FAILED, "message": f"{type(error).__name__}: {error}"}
                row = case_columns(missing[digest], digest) | failure
            write_row(folder, row)
            refused += row["status"] != PLANNED
            if progress is not None:
                progress(f"{count} of {len(cases)} rows, {refused} without a plan")
    return load_sweep(folder)


@suggest_keywords
def load_sweep(directory: Path | str) -> pandas.DataFrame:
    """Return the rows of a sweep as a data frame, in the study's order, without missing rows.

    Columns are ``problem``, ``seed``, ``parameter.KEY`` of every parameter, ``status`` (planned,
    infeasible, time limit, failed or wrong), ``binding`` (the limit that binds), ``message``,
    ``duration`` [s], ``check.NAME`` with the worst value of every check of the certificate,
    ``simulate.…``, ``time.…`` (processor time [s]) and ``digest``.

    Parameters
    ----------
    directory: the directory of ``run_sweep``.

    Raises
    ------
    FileError: there is no sweep.
    UnsupportedError: pandas is not installed.
    """
    frames = optional_module("pandas", "sweeps need", "sweep")
    folder = as_path("directory", directory)
    study, rows = read_study(folder), _read_rows(folder)
    done = [rows[digest] for digest in study["cases"] if digest in rows]
    table: pandas.DataFrame = frames.DataFrame(done or {"digest": []})
    if not done:
        return table
    first = ["problem", "seed", *(f"parameter.{key}" for key in study["parameters"])]
    first += ["status", "binding", "message", "duration"]
    return table.reindex(columns=[*first, *sorted(set(table.columns) - set(first))])


def read_study(directory: Path) -> dict[str, Any]:
    """Return title, parameters and cases of a directory's study; raises FileError if invalid."""
    path = directory / STUDY
    try:
        study = json.loads(file_text(path))
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise FileError(f"{path}: cannot be read ({reason}); run hitchopt sweep first") from None
    if not isinstance(study, dict) or study.get("format") != FORMAT:
        raise FileError(f"{path}: is not of the format {FORMAT}; run hitchopt sweep again")
    return study


def _read_rows(directory: Path) -> dict[str, Row]:
    """Return the rows of a directory by digest, without incomplete lines.

    Raises FileError if a row was edited.
    """
    path = directory / ROWS
    rows = dict[str, Row]()
    try:
        lines = file_bytes(path).decode("utf-8", "replace").splitlines() if path.exists() else []
    except OSError as error:
        raise FileError(f"{path}: cannot be read: {error}") from error
    for number, line in enumerate(lines, 1):
        with contextlib.suppress(ValueError, KeyError, TypeError):
            row = json.loads(line)
            rows[row["digest"]] = row
            if row.pop(SEAL, None) != digest_of(row):
                raise FileError(
                    f"{path}: line {number} was edited, or comes from an earlier release; "
                    "delete it, "
                    "and run the study again, which computes it"
                )
    return rows


def write_row(directory: Path, row: Row) -> None:
    """Append a row as one line; raises FileError if the disk is full or not writable."""
    values = {name: _scalar(name, value) for name, value in row.items()}
    values[SEAL] = digest_of(values)
    line = f"\n{json.dumps(values)}\n".encode()  # the last line may be incomplete
    try:
        with (directory / ROWS).open("ab", buffering=0) as file:
            if file.write(line) != len(line):
                raise OSError(0, "the disk is full")
    except OSError as error:
        raise FileError(
            f"{directory}: cannot be written: {error.strerror or error}; free space or change the "
            "permissions, then run the same study again: only missing rows are computed"
        ) from error


def _scalar(name: str, value: object) -> object:
    """Return a cell's value: lists and mappings as JSON, numbers except seeds as floats."""
    if isinstance(value, dict | list):
        return json.dumps(value, sort_keys=True)
    is_number = isinstance(value, int) and not isinstance(value, bool) and name != "seed"
    return float(value) if is_number else value  # type: ignore[arg-type]


@dataclass(frozen=True)
class Share:
    """Number of rows with a property, and Wilson's interval of the rate (1927)."""

    count: int
    rows: int

    @property
    def interval(self) -> tuple[float, float]:
        """Wilson's 95 % confidence interval, which is valid for few rows too."""
        from scipy.stats import binomtest

        low, high = binomtest(self.count, self.rows).proportion_ci(0.95, method="wilson")
        return float(low), float(high)

    def __str__(self) -> str:
        low, high = self.interval
        return f"{self.count} of {self.rows} ({100 * low:.0f}–{100 * high:.0f} %)"


@dataclass(frozen=True)
class Summary:
    """Totals of a sweep."""

    cases: int  # of the study; there may be fewer rows
    planned: Share  # of rows with a plan
    succeeded: Share | None  # of simulated flights, if any
    binding: tuple[tuple[str, int], ...]  # limits that bind, or other reasons, most frequent first


def summary(rows: pandas.DataFrame, cases: int) -> Summary:
    """Return the totals of a sweep's rows; raises InputError if there are none."""
    if not len(rows):
        raise InputError("rows", 0, "at least 1", "run the sweep first")
    planned = rows["status"] == PLANNED
    flights = rows.get("simulate.succeeded")
    share = None
    if flights is not None and len(flights := flights.dropna()):
        share = Share(int(flights.astype(bool).sum()), len(flights))
    reasons = rows.loc[~planned, "binding"].fillna(rows.loc[~planned, "status"])
    binding = tuple((str(name), int(count)) for name, count in reasons.value_counts().items())
    return Summary(cases, Share(int(planned.sum()), len(rows)), share, binding)


def outcomes(rows: pandas.DataFrame) -> list[dict[str, Any]]:
    """Return the varying parameters and median results of every point, by column headings."""
    keys = [x for x in rows.columns if x == "problem" or x.startswith(PARAMETER)]
    keys = [key for key in keys if rows[key].nunique(dropna=False) > 1]
    heads = [_with_unit(key.removeprefix(PARAMETER)) for key in keys]
    table = list[dict[str, Any]]()
    for values, group in rows.groupby(keys or ["problem"], sort=False, dropna=False):
        row = dict[str, Any](zip(heads, values, strict=False))
        refused = group[group["status"] != PLANNED]
        row["planned"] = refused.empty
        row |= {head: float(group[key].median()) for key, head in FIGURES.items() if key in group}
        if len(refused):
            row["binding"] = refused["binding"].fillna(refused["status"]).iloc[0]
        if len(flights := group.get("simulate.succeeded", group["status"][:0]).dropna()):
            row["flown well"] = f"{int(flights.astype(bool).sum())} of {len(flights)}"
        table.append(row)
    return table


def _with_unit(key: str) -> str:
    """Return a key of problem files with its unit, if it has one."""
    unit = unit_of(key)
    return f"{key} [{unit}]" if unit else key


def _stated(head: str, value: object) -> str:
    """Return the value of a column, with its unit if the heading has one."""
    key, _, unit = head.partition(" [")
    return f"{key} {value} {unit.removesuffix(']')}".rstrip()


@style.own_style()
def draw_sweep(points: list[dict[str, Any]], width: float | None = None) -> Figure | None:
    """Plot the last figure of ``outcomes`` over the first varying parameter, if any.

    Every combination of the other parameters has its own colour. Points are joined if the first
    parameter is a number. A point without a plan is drawn as a cross with the reason. With a
    ``width`` [inch] it is a figure for a paper.
    """
    from hitchopt.view.pictures import STYLES

    heads = list(points[0])
    if not (keys := heads[: heads.index("planned")]):
        return None
    figure = style.new_figure((6.5, 4.0))
    head = [x for x in FIGURES.values() if x in heads][-1]
    if width is not None:
        figure = style.page_figure(width, style.PAGE_SHARE * width)
    axes = figure.add_subplot(xlabel=keys[0], ylabel=head)
    curves = dict[str, list[dict[str, Any]]]()
    for row in points:
        curves.setdefault(", ".join(_stated(key, row[key]) for key in keys[1:]), []).append(row)
    for (label, curve), (colour, style_of_line) in zip(curves.items(), cycle(STYLES)):
        xs = [row[keys[0]] for row in curve]
        line = style_of_line
        if any(isinstance(x, bool) or not isinstance(x, int | float) for x in xs):  # names
            xs = list(map(str, xs))
            line = "none"
        axes.plot(xs, [row[head] for row in curve], "o", ls=line, ms=4, color=colour, label=label)
        for x, row in zip(xs, curve, strict=True):
            if not row["planned"]:
                axes.plot(x, 0.0, "x", color=style.LIMIT_COLOUR)
                style.write(axes, row["binding"], (x, 0.0), (0, 6), rotation=90, va="bottom")
    style.from_zero(axes)
    if 1 < len(curves) <= len(STYLES):
        axes.legend(fontsize="small", frameon=False)
    if width is not None:
        style.set_page_text(figure)
    return figure


class SweepError(HitchoptError):
    """An interrupted sweep: computed rows are saved, and the same call continues it."""


def case_columns(case: Case, digest: str) -> Row:
    """Return the columns of a row that identify the case."""
    row: Row = {"digest": digest, "problem": case.name, "seed": case.seed}
    return row | {f"parameter.{key}": value for key, value in case.point.items()}


def compute_row(case: Case, digest: str) -> Row:
    """Return the row of a case; a HitchoptError becomes a row."""
    from hitchopt.api import solve
    from hitchopt.mission.loading import problem_from_dict

    row = case_columns(case, digest)
    start = time.process_time()
    try:
        plan = solve(problem_from_dict(case.problem), limit=case.limit)
        row |= {"status": PLANNED, "duration": plan.duration}
        for check in plan.certificate.checks:
            row[f"check.{check.name}"] = check.worst if check.is_evaluated else None
        row["time.plan"] = time.process_time() - start
        if case.simulate is not None:
            start = time.process_time()
            row |= {f"simulate.{key}": value for key, value in _simulate(plan, case).items()}
            row["time.simulate"] = time.process_time() - start
    except HitchoptError as error:
        status = next((word for kind, word in STATUS.items() if isinstance(error, kind)), FAILED)
        row.setdefault("status", status)  # PLANNED if only the simulation failed
        row["message"] = str(error)
        if isinstance(error, InfeasibleError) and error.violations:
            row["binding"] = error.violations[0].constraint
        row.setdefault("time.plan", time.process_time() - start)
    return row


def _simulate(plan: Plan, case: Case) -> Row:
    """Return the results of a simulated flight."""
    from hitchopt.lab.simulation.report import Simulation
    from hitchopt.lab.simulation.settings import settings_of
    from hitchopt.lab.simulation.task import Task

    keys: dict[str, Any] = {**(case.simulate or {}), "seed": case.seed}
    run = Simulation.of(Task.of(plan.flight), settings_of(**keys)).run
    row: Row = {"verdict": run.verdict, "succeeded": run.succeeded, **run.figures}
    if run.failures:
        row |= {"failure": run.failures[0].kind, "failure_time": run.failures[0].time}
    return row


def run_tasks(
    function: Callable[..., Any],
    tasks: Mapping[str, tuple[Any, ...]],
    workers: int,
    scheduler: str | None = None,
    *,
    shared: object = None,
) -> Generator[tuple[str, Any], None, None]:
    """Run tasks in parallel; yield the key and the completed future of each.

    Workers call ``function`` with the arguments of each task and, unless it is None, with the
    ``shared`` argument, which is sent only once. They are processes of this machine, or those of a
    dask ``scheduler`` at an address. Raises SweepError if the scheduler is lost, InputError if it
    cannot be reached, and UnsupportedError without dask.distributed.
    """
    if not tasks:
        return
    with _client(workers, scheduler) as (client, as_completed):
        columns = [list(column) for column in zip(*tasks.values(), strict=True)]
        if shared is not None:  # a task, which dask recomputes if workers die
            columns.append([client.submit(lambda value: value, shared, pure=False)] * len(tasks))
        reason = ""
        try:
            futures = client.map(function, *columns, key=list(tasks), pure=False, batch_size=1000)
            for future in as_completed(futures, loop=client.loop, raise_errors=False):
                if future.status not in {"finished", "error"}:
                    reason = f"a task was {future.status}"
                    break
                yield str(future.key), future
        except (OSError, TimeoutError) as error:
            reason = str(error) or type(error).__name__
        if reason:
            raise SweepError(
                f"the scheduler was lost ({reason}); written rows are kept: run the same "
                "study again"
            )


def _is_imported_by_worker() -> bool:
    """Return whether a script runs only because a new worker process imports it.

    Such a process already has its own name, but no parent until it has imported the script.
    """
    is_named = multiprocessing.current_process().name != "MainProcess"
    return is_named and multiprocessing.parent_process() is None


@contextlib.contextmanager
def _cluster(workers: int) -> Iterator[str]:
    """Yield the address of the scheduler of a temporary cluster on this machine."""
    import distributed

    if _is_imported_by_worker():  # the script calls without a guard, as the process above reports
        raise SystemExit(1)
    try:
        cluster = distributed.LocalCluster(
            n_workers=workers, threads_per_worker=1, processes=True,
            dashboard_address="127.0.0.1:0", host="127.0.0.1",
        )  # fmt: skip
    except RuntimeError as error:
        guard = 'if __name__ == "__main__":'
        remedy = f"in a script, call it under `{guard}`, because workers import the script"
        bound = f"processes that can be started ({error})"
        raise InputError("workers", workers, bound, remedy) from None
    with cluster:
        yield cluster.scheduler_address


@contextlib.contextmanager
def _client(workers: int, scheduler: str | None) -> Iterator[Any]:
    """Yield a client of a scheduler's cluster, or of a temporary cluster on this machine."""
    packages = ("dask", "distributed")
    dask, distributed = (optional_module(name, "sweeps need", "sweep") for name in packages)
    for name in ("distributed", "distributed.scheduler", "distributed.nanny", "distributed.worker"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    with dask.config.set(SETTINGS), contextlib.ExitStack() as stack:
        address = scheduler if scheduler else stack.enter_context(_cluster(workers))
        try:
            client = distributed.Client(address, set_as_default=False)
        except (OSError, ValueError, TimeoutError) as error:
            remedy = "start `dask scheduler` and `dask worker ADDRESS`"
            raise InputError("scheduler", scheduler, f"reachable ({error})", remedy) from None
        yield stack.enter_context(client), distributed.as_completed
