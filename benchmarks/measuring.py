"""Shared functions of benchmarks: environment, measurements and tables."""

from __future__ import annotations

import argparse
import datetime
import os
import platform
import resource
import time
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

import hitchopt as ho

Array = NDArray[np.float64]
T = TypeVar("T")

ROOT = Path(__file__).parents[1]
PROBLEMS, RESULTS = ROOT / "problems", ROOT / "demo" / "benchmarks"

LIBRARIES = ("hitchopt", "numpy", "scipy", "casadi", "toppra", "osqp")

DEFAULT_CLEARANCE = ho.Separation().cable
"""Default cable clearance of problems [m]."""

CLEARANCE = "cable [mm]"
"""Heading of a column of cable clearances."""

CLEARANCE_NOTE = (
    f"{CLEARANCE}: the cable clearance that is kept; * below the default of "
    f"{1e3 * DEFAULT_CLEARANCE:g} mm"
)


def parser(description: str | None, **defaults: Any) -> argparse.ArgumentParser:
    """Return the parser of a benchmark: the folder of its table, and options with these defaults.

    An option whose default is a list accepts several values.
    """
    cli = argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    cli.add_argument("-o", "--output", type=Path, default=RESULTS, help="folder of the table")
    for name, default in defaults.items():
        several = isinstance(default, list)
        cli.add_argument(
            f"--{name}",
            type=type(default[0] if several else default),
            default=default,
            nargs="*" if several else None,
            choices=("fast", "accurate") if name == "preset" else None,
        )
    return cli


def environment(more: Sequence[str] = ()) -> str:
    """Return machine, versions and load in one line, with the versions of further libraries."""
    versions = ", ".join(f"{name} {_version(name)}" for name in (*LIBRARIES, *more))
    return (
        f"{platform.machine()}, {os.cpu_count()} cores{_processor()}, {platform.system()}; "
        f"Python {platform.python_version()}, {versions}; "
        f"load average {os.getloadavg()[0]:.1f} before"
    )


def timed(work: Callable[[], T]) -> tuple[T, float]:
    """Return the result of a call and its processor time [s]."""
    start_time = time.process_time()
    return work(), time.process_time() - start_time


def most_common(kinds: Iterable[str]) -> str:
    """Return how often each kind of failure occurs, the most common first."""
    return "; ".join(f"{kind}: {count}" for kind, count in Counter(kinds).most_common())


def peak_memory() -> float:
    """Return the peak memory of this process [MB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def slope(n: Sequence[float], values: Sequence[float]) -> float:
    """Return the log-log slope of values over n, by least squares."""
    return float(np.polyfit(np.log(n), np.log(values), 1)[0])


def clearance_text(clearance: float) -> str:
    """Return a cable clearance [m] in millimetres, with an asterisk below the default."""
    return f"{1e3 * clearance:.3g}{'*' if clearance < DEFAULT_CLEARANCE else ''}"


@dataclass
class Table:
    """A table that is printed and written row by row, so that it can be interrupted.

    Parameters
    ----------
    path: path of the Markdown file; a file may have several ``sections``.
    title: heading of the file.
    limitations: limitations of the figures.
    libraries: further libraries whose versions are listed.
    """

    path: Path
    title: str
    limitations: str
    libraries: Sequence[str] = ()
    _lines: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._append(f"# {self.title}", "")
        self._append(f"- {datetime.date.today()}, {environment(self.libraries)}")
        self._append(f"- limitations: {self.limitations}")

    def section(self, title: str, *columns: str) -> None:
        """Begin a table, with a heading unless the title is empty."""
        self._append("", *([f"## {title}", ""] if title else []))
        self._append(f"| {' | '.join(columns)} |", "|---" * len(columns) + "|")

    def row(self, *cells: object) -> None:
        """Add a row; floats have three digits."""
        texts = (f"{cell:.3g}" if isinstance(cell, float) else str(cell) for cell in cells)
        self._append(f"| {' | '.join(texts)} |")

    def note(self, *lines: str) -> None:
        """Add lines of a list."""
        self._append("", *(f"- {line}" for line in lines))

    def _append(self, *lines: str) -> None:
        print("\n".join(lines), flush=True)
        self._lines += lines
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self.path.write_text("\n".join([*self._lines, ""]), encoding="utf-8")


def _version(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return "not installed"


def _processor() -> str:
    """Return the processor's name in brackets, if it is known."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return ""
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return f" ({names[0]})" if names else ""
