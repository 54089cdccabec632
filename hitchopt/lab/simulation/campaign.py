"""Campaigns: simulated flights of one plan with different seeds, success rate and failures."""

from __future__ import annotations

import csv
import multiprocessing
import os
import signal
from collections import Counter
from collections.abc import Generator, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import binomtest

from hitchopt.errors import HitchoptError, InputError, Progress, UnsupportedError
from hitchopt.lab.simulation.commands import resolved
from hitchopt.lab.simulation.departures import Failure
from hitchopt.lab.simulation.flight import FlightInProgress, fly_seeds
from hitchopt.lab.simulation.judgement import NOT_SIMULATED, START, CampaignRun
from hitchopt.lab.simulation.report import (
    CAMPAIGN,
    CAMPAIGN_PICTURE,
    OWNED,
    RUNS,
    Simulation,
    number,
)
from hitchopt.lab.simulation.settings import CLASPS, Settings
from hitchopt.lab.simulation.task import Task
from hitchopt.storage.files import Writer, replace_files, write_strict_json
from hitchopt.values import integer
from hitchopt.view import style

LARGEST_BATCH = 50
"""Largest number of flights with clasps that are simulated at once, for their memory."""

SIZE = (13.0, 7.2)  # [inch] Width and height of the picture
WIDTH = 0.35  # Half-width of a column of points, over the distance of columns
SHOWN_FAILURES = 3  # Number of kinds of failures that the picture names

SHOWN = {
    "tracking_largest": ("largest drone error [cm]", 0.01),
    "separation": ("minimum separation [ellipsoids]", 1.0),
    "tension_ratio_mean": ("mean tension / planned", 1.0),
    "peak_tension": ("largest tension [N]", 1.0),
}
"""Figures that the picture shows, with labels and units."""


@dataclass(frozen=True)
class Distribution:
    """Distribution of a figure over the flights that have it; nan without any."""

    mean: float
    deviation: float
    median: float
    high: float  # 95 % are at most as large
    largest: float

    @classmethod
    def of(cls, values: Iterable[float]) -> Distribution:
        """Return the distribution of finite values."""
        finite = np.array([value for value in values if np.isfinite(value)] or [np.nan])
        median, high, largest = np.quantile(finite, [0.5, 0.95, 1.0]).tolist()
        return cls(float(np.mean(finite)), float(np.std(finite)), median, high, largest)


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
        """Wilson's 95 % confidence interval of the success rate, valid for few runs too."""
        interval = binomtest(self.successes, len(self.runs)).proportion_ci(0.95, method="wilson")
        return float(interval.low), float(interval.high)

    @property
    def figures(self) -> dict[str, list[float]]:
        """Figures of the flights by name, nan for those without one."""
        names = max((run.figures for run in self.runs), key=len)
        return {name: [run.figures.get(name, np.nan) for run in self.runs] for name in names}

    @property
    def rests(self) -> dict[tuple[str, str], list[float]]:
        """Mean errors [m] of the flights by rest and vertex, nan for those that ended before."""
        rests = max((run.rests for run in self.runs), key=len)
        return {
            (rest, vertex): [run.rests.get(rest, {}).get(vertex, np.nan) for run in self.runs]
            for rest, vertices in rests.items()
            for vertex in vertices
        }

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
            "figures": {
                name: asdict(Distribution.of(values)) for name, values in self.figures.items()
            },
            "vertex_errors": [
                {"rest": rest, "vertex": vertex, **asdict(Distribution.of(errors))}
                for (rest, vertex), errors in self.rests.items()
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
    seeds = range(settings.seed, settings.seed + runs)
    size = min(-(-runs // workers), LARGEST_BATCH) if settings.cables == CLASPS else 1
    batches = [seeds[first : first + size] for first in range(0, runs, size)]
    completed: list[CampaignRun] = []
    with closing(_results(task, settings, batches, workers)) as results:
        for batch_of_runs in results:
            completed += batch_of_runs
            if progress is not None:
                succeeded = sum(run.succeeded for run in completed)
                progress(f"{len(completed)} of {runs} flown, {succeeded} succeeded")
    return Campaign(resolved(task, settings), tuple(sorted(completed, key=lambda run: run.seed)))


def _results(
    task: Task, settings: Settings, batches: Sequence[Sequence[int]], workers: int
) -> Generator[list[CampaignRun], None, None]:
    """Yield the results of batches of seeds as they are finished, in any order.

    A generator that is closed, or that raises, ends its processes and their flights.
    """
    count = min(workers, len(batches))
    if count == 1:
        yield from (run_flights(batch, settings, task) for batch in batches)
        return
    others = {*multiprocessing.active_children()}
    spawning = multiprocessing.get_context("spawn")  # a fork would copy locks of threads
    # Ctrl-C reaches all processes of a terminal; this one ends the others
    pool = ProcessPoolExecutor(count, spawning, signal.signal, (signal.SIGINT, signal.SIG_IGN))
    try:
        futures = [pool.submit(run_flights, batch, settings, task) for batch in batches]
        for future in as_completed(futures):
            yield future.result()
    except BrokenProcessPool:
        bound = "as many processes as memory holds, of which one was ended"
        raise InputError("workers", workers, bound, "lower it") from None
    finally:
        pool.shutdown(wait=False, cancel_futures=True)
        for process in {*multiprocessing.active_children()} - others:
            process.terminate()
            process.join()


def processes(runs: int, workers: int | None = None) -> int:
    """Return the number of processes that simulate ``runs`` flights.

    Raises InputError for invalid numbers.
    """
    integer("runs", runs, 1)
    if workers is not None:
        integer("workers", workers, 1)
    return min(runs, workers or os.cpu_count() or 1)


def expected_seconds(task: Task, settings: Settings) -> float:
    """Return the processor time of a flight with ropes [s] from its first steps.

    It is nan for a flight that cannot start, and for others.
    """
    if settings.cables == CLASPS:
        return float("nan")
    try:
        return FlightInProgress(task, settings).expected_seconds()
    except (InputError, UnsupportedError):
        raise
    except HitchoptError:
        return float("nan")


def run_flights(seeds: Sequence[int], settings: Settings, task: Task) -> list[CampaignRun]:
    """Return the results of flights that are simulated at once.

    A flight that cannot start is a failure, not an error.
    """
    try:
        flights = fly_seeds(task, settings, seeds)
    except (InputError, UnsupportedError):  # these would affect every flight
        raise
    except HitchoptError as error:
        failure = Failure(START, (), 0.0, str(error))
        return [CampaignRun(seed, NOT_SIMULATED, (failure,), {}) for seed in seeds]
    return [Simulation.judged(flight).run for flight in flights]


def save_campaign(directory: Path | str, campaign: Campaign) -> Path:
    """Write the campaign's summary, table of runs and picture; return the directory."""

    def write_runs(path: Path) -> None:
        rows = []
        for run in campaign.runs:
            first = run.failures[0] if run.failures else Failure("", (), float("nan"), "")
            figures = {"time": first.time, **run.figures}
            row = {"seed": run.seed, "verdict": run.verdict, "failure": first.kind}
            row |= {"where": " ".join(first.where), "words": first.words}
            errors = {
                f"{rest} {vertex}": error
                for rest, vertices in run.rests.items()
                for vertex, error in vertices.items()
            }
            figures |= errors
            rows.append(row | {name: number(value, 6) for name, value in figures.items()})
        with path.open("w", encoding="utf-8", newline="") as file:
            table = csv.DictWriter(file, max(map(list, rows), key=len), lineterminator="\n")
            table.writeheader()
            table.writerows(rows)

    writers: dict[str, Writer] = {
        RUNS: write_runs,
        CAMPAIGN_PICTURE: lambda path: style.save_figure(drawn_campaign(campaign), path),
        CAMPAIGN: lambda path: write_strict_json(path, campaign.to_dict()),
    }
    return replace_files(directory, writers, OWNED, seal=CAMPAIGN)


@style.own_style()
def drawn_campaign(campaign: Campaign) -> Figure:
    """Return the picture of a campaign: every flight's errors of vertices at rests, and figures."""
    figure = style.new_figure(SIZE)
    rests, figures = campaign.rests, campaign.figures
    rows = figure.add_gridspec(2, 1)
    accuracy = "" if campaign.settings.measures_vertices else "\n± 1 to 2 cm"
    top = figure.add_subplot(rows[0], ylabel=f"mean vertex error\nat rest [cm]{accuracy}")
    columns = [100.0 * np.array(errors) for errors in rests.values()]
    for place, errors in enumerate(columns):
        spread = WIDTH * (np.argsort(np.argsort(errors)) / max(len(errors) - 1, 1) - 0.5)
        top.plot(place + spread, errors, ".", color=style.INK, ms=3)
        median = Distribution.of(errors).median
        top.plot([place - WIDTH, place + WIDTH], [median] * 2, color=style.LIMIT_COLOUR)
    top.set_xticks(range(len(rests)), [vertex for _, vertex in rests], fontsize="small")
    names = [rest for rest, _ in rests]
    for name in dict.fromkeys(names):
        first, count = names.index(name), names.count(name)
        if first:
            top.axvline(first - 0.5, color="0.8", lw=0.8)
        middle, above = first + 0.5 * (count - 1), top.get_xaxis_transform()
        top.text(middle, 1.02, name, transform=above, ha="center", fontsize="small")
    top.set_xlim(-0.5, max(len(rests), 1) - 0.5)
    if columns:
        style.from_zero(top)
    panels = rows[1].subgridspec(1, len(SHOWN))
    for panel, (name, (label, unit)) in enumerate(SHOWN.items()):
        axes = figure.add_subplot(panels[panel], xlabel=label)
        values = np.array(figures.get(name, [])) / unit
        finite = np.sort(values[np.isfinite(values)])
        fraction = np.arange(1, len(finite) + 1) / max(len(finite), 1)
        axes.plot(finite, fraction, ".-", color=style.INK, ms=3, lw=0.8, drawstyle="steps-post")
        axes.set_ylim(0.0, 1.05)
        axes.set_ylabel("fraction of flights\nup to this value" if panel == 0 else "")
        axes.ticklabel_format(useOffset=False)
        axes.locator_params("x", nbins=4)
        if panel:
            axes.set_yticklabels([])
    rate = f"{campaign.successes} of {len(campaign.runs)} flights succeeded; red: medians"
    failures = [
        f"{kind} {where} ({runs})"
        for (kind, where), runs in campaign.failures.most_common(SHOWN_FAILURES)
    ]
    style.headline(
        figure, rate, f"most frequent first failures: {', '.join(failures)}" if failures else ""
    )
    return figure
