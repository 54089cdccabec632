"""Campaigns: simulated flights of one plan with different seeds, success rate and failures."""

from __future__ import annotations

import contextlib
import csv
import os
from collections import Counter
from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from hitchopt.errors import HitchoptError, InputError, Progress, UnsupportedError
from hitchopt.lab.simulation.commands import resolved
from hitchopt.lab.simulation.departures import Failure
from hitchopt.lab.simulation.flight import FlightInProgress
from hitchopt.lab.simulation.judgement import NOT_SIMULATED, START, CampaignRun
from hitchopt.lab.simulation.report import CAMPAIGN, OWNED, RUNS, Simulation, number
from hitchopt.lab.simulation.settings import Settings
from hitchopt.lab.simulation.task import Task
from hitchopt.lab.sweeps.sweep import Share, run_tasks
from hitchopt.storage.files import Writer, replace_files, write_strict_json
from hitchopt.values import integer


@dataclass(frozen=True)
class Campaign:
    """Flights of one plan under perturbations of different seeds."""

    settings: Settings  # of all flights, with the first seed
    runs: tuple[CampaignRun, ...]  # by seed

    @property
    def successes(self) -> int:
        """Number of flights that succeeded."""
        return sum(run.succeeded for run in self.runs)

    @property
    def not_simulated(self) -> int:
        """Number of flights that could not be simulated; they count as not succeeded."""
        return sum(run.verdict == NOT_SIMULATED for run in self.runs)

    @property
    def interval(self) -> tuple[float, float]:
        """Wilson's 95 % confidence interval of the success rate."""
        return Share(self.successes, len(self.runs)).interval

    @property
    def failures(self) -> Counter[tuple[str, str]]:
        """Number of runs by kind and location of the first failure."""
        first = (run.failures[0] for run in self.runs if run.failures)
        return Counter((failure.kind, ", ".join(failure.where)) for failure in first)

    def to_dict(self) -> dict[str, Any]:
        """Return the campaign as plain data for JSON."""
        return {
            "format": "hitchopt-campaign/1",
            "settings": asdict(self.settings),
            "runs": len(self.runs),
            "successes": self.successes,
            "not_simulated": self.not_simulated,
            "rate": self.successes / len(self.runs),
            "rate_95_percent": list(self.interval),
            "first_failures": [
                {"kind": kind, "where": where, "runs": count}
                for (kind, where), count in self.failures.most_common()
            ],
        }


def run_campaign(
    task: Task,
    settings: Settings,
    runs: int,
    workers: int | None = None,
    progress: Progress | None = None,
) -> Campaign:
    """Simulate ``runs`` flights of a plan with consecutive seeds from that of the settings.

    They run in ``workers`` parallel processes, by default one per processor; a single one is this
    process.
    Raises InputError for an invalid number of runs or invalid settings.
    """
    workers = processes(runs, workers)
    flights = [replace(settings, seed=settings.seed + i) for i in range(runs)]
    completed: list[CampaignRun] = []
    with contextlib.ExitStack() as stack:
        results: Iterable[CampaignRun] = (run_flight(each, task) for each in flights)
        if workers > 1:
            tasks = {f"flight-{each.seed}": (each,) for each in flights}
            futures = run_tasks(run_flight, tasks, workers, shared=task)
            stack.enter_context(contextlib.closing(futures))
            results = (future.result() for _, future in futures)
        for run in results:
            completed.append(run)
            if progress is not None:
                succeeded = sum(run.succeeded for run in completed)
                progress(f"{len(completed)} of {runs} flown, {succeeded} succeeded")
    return Campaign(resolved(task, settings), tuple(sorted(completed, key=lambda run: run.seed)))


def processes(runs: int, workers: int | None = None) -> int:
    """Return the number of processes that simulate ``runs`` flights.

    Raises InputError for invalid numbers.
    """
    integer("runs", runs, 1)
    if workers is not None:
        integer("workers", workers, 1)
    return min(runs, workers or os.cpu_count() or 1)


def expected_seconds(task: Task, settings: Settings) -> float:
    """Return the processor time of a flight [s] from its first steps; nan if it cannot start."""
    try:
        return FlightInProgress(task, settings).expected_seconds()
    except (InputError, UnsupportedError):
        raise
    except HitchoptError:
        return float("nan")


def run_flight(settings: Settings, task: Task) -> CampaignRun:
    """Return the result of one flight; a flight that cannot start is a failure, not an error."""
    try:
        return Simulation.of(task, settings).run
    except (InputError, UnsupportedError):  # these would affect every flight
        raise
    except HitchoptError as error:
        return CampaignRun(settings.seed, NOT_SIMULATED, (Failure(START, (), 0.0, str(error)),), {})


def save_campaign(directory: Path | str, campaign: Campaign) -> Path:
    """Write the campaign's summary and a table of its runs; return the directory."""

    def write_runs(path: Path) -> None:
        rows = []
        for run in campaign.runs:
            first = run.failures[0] if run.failures else Failure("", (), float("nan"), "")
            figures = {"time": first.time, **run.figures}
            row = {"seed": run.seed, "verdict": run.verdict, "failure": first.kind}
            row |= {"where": " ".join(first.where), "words": first.words}
            rows.append(row | {name: number(value, 6) for name, value in figures.items()})
        with path.open("w", encoding="utf-8", newline="") as file:
            table = csv.DictWriter(file, max(map(list, rows), key=len), lineterminator="\n")
            table.writeheader()
            table.writerows(rows)

    writers: dict[str, Writer] = {
        RUNS: write_runs,
        CAMPAIGN: lambda path: write_strict_json(path, campaign.to_dict()),
    }
    return replace_files(directory, writers, OWNED, seal=CAMPAIGN)
