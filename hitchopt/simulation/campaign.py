"""Many flights of one plan, on several processes: how often it succeeds, and what fails where."""

from __future__ import annotations

import csv
import multiprocessing
import os
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from hitchopt.errors import HitchoptError, InputError, UnsupportedError
from hitchopt.export.atomic import Writer, replace_files
from hitchopt.export.strict_json import write_strict_json
from hitchopt.simulation.error_measures import Spread, tracking_errors
from hitchopt.simulation.flight_outcome import NOT_SIMULATED, START, SUCCEEDED, Failure
from hitchopt.simulation.run_report import CAMPAIGN, OWNED, RUNS, settings_summary
from hitchopt.simulation.simulate import Task, simulate
from hitchopt.simulation.simulation_settings import Settings

Progress = Callable[[str], None]

FORMAT = "hitchopt-campaign/1"

CONFIDENCE = 1.959963984540054
"""Standard deviations of a normal distribution that hold 95 %."""


@dataclass(frozen=True)
class Run:
    """What one flight of a campaign came to.

    Attributes
    ----------
    seed: of its perturbations; the same seed alone flies the same flight.
    verdict: what became of it, as of an Outcome.
    failures: all that went wrong, by time.
    vertex_error, without_sag: over vertices and time [m].
    moving_without_sag: over the time in which the plan moves a vertex; nan where it moves none.
    tracking: of drones [m].
    peak_tension: [N]
    saturated: share of samples at which a drone wanted more thrust than it has.
    pace: simulated seconds per second of one processor.
    """

    seed: int
    verdict: str
    failures: tuple[Failure, ...]
    vertex_error: Spread
    without_sag: Spread
    moving_without_sag: Spread
    tracking: Spread
    peak_tension: float
    saturated: float
    pace: float

    @property
    def succeeded(self) -> bool:
        """Whether nothing went wrong."""
        return self.verdict == SUCCEEDED


@dataclass(frozen=True)
class Campaign:
    """Flights of one plan under perturbations of fresh seeds.

    Attributes
    ----------
    settings: of all of them, but the seed, which is the first one's.
    runs: by seed.
    digest: of setpoints.csv.
    """

    settings: Settings
    runs: tuple[Run, ...]
    digest: str

    @property
    def successes(self) -> int:
        """How many succeeded."""
        return sum(run.succeeded for run in self.runs)

    @property
    def not_simulated(self) -> int:
        """How many the simulation itself failed; they count as not succeeded."""
        return sum(run.verdict == NOT_SIMULATED for run in self.runs)

    @property
    def interval(self) -> tuple[float, float]:
        """Of the success rate, at 95 %."""
        return wilson_interval(self.successes, len(self.runs))

    @property
    def failures(self) -> Counter[tuple[str, str]]:
        """How many runs had each first failure: its kind, and where."""
        first = (run.failures[0] for run in self.runs if run.failures)
        return Counter((failure.kind, ", ".join(failure.where)) for failure in first)

    def to_dict(self) -> dict[str, Any]:
        """Return the campaign, ready for JSON."""
        low, high = self.interval
        return {
            "format": FORMAT,
            "setpoints_sha256": self.digest,
            "settings": settings_summary(self.settings),
            "runs": len(self.runs),
            "successes": self.successes,
            "not_simulated": self.not_simulated,
            "rate": self.successes / len(self.runs),
            "rate_95_percent": [low, high],
            "first_failures": [
                {"kind": kind, "where": where, "runs": count}
                for (kind, where), count in self.failures.most_common()
            ],
        }


def wilson_interval(successes: int, runs: int) -> tuple[float, float]:
    """Return the 95 % interval of a success rate, by Wilson (1927): good for few runs too.

    Raises
    ------
    InputError: no run, or not as many as succeeded.
    """
    if not 0 <= successes <= runs or runs == 0:
        raise InputError("successes", successes, f"from 0 to the {runs} runs", "fly at least one")
    z2 = CONFIDENCE**2 / runs
    rate = successes / runs
    middle = (rate + 0.5 * z2) / (1.0 + z2)
    half = np.sqrt(z2 * (rate * (1.0 - rate) + 0.25 * z2)) / (1.0 + z2)
    return max(0.0, float(middle - half)), min(1.0, float(middle + half))


def run_campaign(
    task: Task,
    settings: Settings,
    runs: int,
    processes: int | None = None,
    progress: Progress | None = None,
) -> Campaign:
    """Return ``runs`` flights of a plan, with seeds from that of the settings on.

    Parameters
    ----------
    task: what is flown.
    settings: how; its seed is the first one.
    runs: how many, at least 1.
    processes: at a time; by default one per processor. One flies in this process.
    progress: called with how many are done.

    Raises
    ------
    InputError: no runs, or settings that no flight can be simulated with.
    UnsupportedError: mujoco is not installed.
    """
    if runs < 1:
        raise InputError("runs", runs, "at least 1", "a campaign needs some flights")
    if processes is not None and processes < 1:
        raise InputError("processes", processes, "at least 1", "leave it out for all processors")
    jobs = [(task, replace(settings, seed=settings.seed + i)) for i in range(runs)]
    width = min(runs, processes or os.cpu_count() or 1)
    found: list[Run] = []
    for run in _flown(jobs, width):
        found.append(run)
        if progress is not None:
            succeeded = sum(run.succeeded for run in found)
            progress(f"{len(found)} of {runs} flown, {succeeded} succeeded")
    found.sort(key=lambda run: run.seed)
    return Campaign(settings, tuple(found), task.digest)


def _flown(jobs: list[tuple[Task, Settings]], processes: int) -> Iterator[Run]:
    if processes == 1:
        yield from (one_run(job) for job in jobs)
        return
    fresh = multiprocessing.get_context("spawn")  # a fork would copy threads' locks
    with ProcessPoolExecutor(processes, mp_context=fresh) as pool:
        for done in as_completed([pool.submit(one_run, job) for job in jobs]):
            yield done.result()


def one_run(job: tuple[Task, Settings]) -> Run:
    """Return what one flight came to; one that cannot begin is a failure, not an error.

    Raises
    ------
    InputError, UnsupportedError: what would stop every other flight as well.
    """
    task, settings = job
    nothing = Spread(np.nan, np.nan, np.nan)
    try:
        done = simulate(task, settings)
    except (InputError, UnsupportedError):
        raise
    except HitchoptError as error:
        failure = Failure(START, (), 0.0, str(error))
        spreads = (nothing, nothing, nothing, nothing)
        return Run(settings.seed, NOT_SIMULATED, (failure,), *spreads, np.nan, np.nan, np.nan)
    record, errors = done.flight.record, done.errors
    return Run(
        settings.seed,
        done.outcome.verdict,
        done.outcome.failures,
        Spread.of(errors.errors),
        Spread.of(errors.without_sag),
        Spread.of(errors.without_sag[errors.moving]),
        Spread.of(tracking_errors(done.flight)),
        float(np.max(record.peak_tensions)),
        float(np.mean(record.saturated)),
        done.pace,
    )


def save_campaign(directory: Path | str, campaign: Campaign) -> Path:
    """Write the campaign's summary and a table of its runs; return the directory.

    Raises
    ------
    FileError: the directory cannot be written to.
    """
    writers: dict[str, Writer] = {
        RUNS: lambda path: _write_runs(path, campaign),
        CAMPAIGN: lambda path: write_strict_json(path, campaign.to_dict()),
    }
    return replace_files(directory, writers, OWNED, seal=CAMPAIGN)


def _write_runs(path: Path, campaign: Campaign) -> None:
    spreads = ("vertex_error", "without_sag", "moving_without_sag", "tracking")
    parts = ("mean", "deviation", "largest")
    names = [f"{spread}_{part}" for spread in spreads for part in parts]
    with path.open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(
            ["seed", "verdict", "succeeded", "failure", "where", "time", "words", *names]
            + ["peak_tension", "saturated", "pace"]
        )
        for run in campaign.runs:
            first = run.failures[0] if run.failures else None
            told = (
                [first.kind, " ".join(first.where), f"{first.time:.3f}", first.words]
                if first
                else ["", "", "", ""]
            )
            numbers = [getattr(getattr(run, s), p) for s in spreads for p in parts]
            numbers += [run.peak_tension, run.saturated, run.pace]
            texts = [f"{x:.6g}" if np.isfinite(x) else "" for x in numbers]
            table.writerow([run.seed, run.verdict, int(run.succeeded), *told, *texts])
