"""A plan's table of aborts: from every time the clock alone reaches an entry."""

from __future__ import annotations

import tempfile
import zipfile
from dataclasses import dataclass
from pathlib import Path

from hitchopt.errors import InfeasibleError
from hitchopt.exports.directory import ABORT_PLANS, ABORTS
from hitchopt.motion.motion import JOINT, Motion
from hitchopt.motion.plan_file import write_plan
from hitchopt.stopping.abort import Abort, Aborts
from hitchopt.storage.atomic import replace_files
from hitchopt.storage.strict_json import write_strict_json
from hitchopt.time_limit import Progress
from hitchopt.values import positive

FORMAT = "hitchopt-aborts/1"

EVERY = 2.0
"""[s] Usual distance of the entries of a table."""


@dataclass(frozen=True, eq=False)
class AbortTable:
    """Certified aborts over all of a plan.

    Attributes
    ----------
    how: what they do.
    entries: by the time at which the clock begins to slow down: a command between two entries lets
        the plan run on to the later one.
    missing: spans of time [s], each from one entry to the next, from which no abort was found.
    """

    how: str
    entries: tuple[Abort, ...]
    missing: tuple[tuple[float, float], ...]

    @property
    def longest(self) -> float:
        """Longest time from the command to rest [s]."""
        begins = [0.0, *(entry.start for entry in self.entries)]
        return max(
            (
                entry.start - begin + entry.seconds
                for begin, entry in zip(begins, self.entries, strict=False)
            ),
            default=float("inf"),
        )


def abort_table(
    motion: Motion, how: str, every: float = EVERY, progress: Progress | None = None
) -> AbortTable:
    """Return aborts from all of a plan, about ``every`` [s] of plan time apart.

    Raises
    ------
    InputError: an unknown kind of abort, or a distance that is not positive.
    """
    every = positive("every", every)
    aborts = Aborts(motion)
    entries: list[Abort] = []
    missing: list[tuple[float, float]] = []
    time = 0.0
    while True:
        if progress is not None:
            progress(f"{how} from t = {time:.4g} s")
        begin = entries[-1].start if entries else 0.0
        try:
            found = aborts.found(time, how)
        except InfeasibleError:
            missing.append((begin, motion.duration))
            break
        entries.append(found)
        if found.start >= motion.duration - JOINT:
            break
        time = min(found.start + every, motion.duration)
    return AbortTable(how, tuple(entries), tuple(missing))


def save_aborts(directory: Path | str, table: AbortTable) -> Path:
    """Write ``aborts.json`` and ``aborts.zip``, a plan file per entry, next to a plan.

    Raises
    ------
    FileError: the directory cannot be written to.
    """
    names = [f"{table.how}_{i:03d}.npz" for i in range(len(table.entries))]
    content = {
        "format": FORMAT,
        "how": table.how,
        "longest": table.longest if table.entries else None,
        "missing": [list(span) for span in table.missing],
        "entries": [
            {
                "start": entry.start,
                "seconds": entry.seconds,
                "rest": entry.rest,
                "ends": entry.certified.motion.duration,
                "plan": name,
            }
            for entry, name in zip(table.entries, names, strict=True)
        ],
    }

    def write_plans(path: Path) -> None:
        with zipfile.ZipFile(path, "w") as archive, tempfile.TemporaryDirectory() as place:
            for entry, name in zip(table.entries, names, strict=True):
                file = Path(place) / name
                write_plan(file, entry.certified.motion, f"{table.how} at {entry.start:g} s")
                archive.write(file, name)

    writers = {ABORTS: lambda path: write_strict_json(path, content), ABORT_PLANS: write_plans}
    return replace_files(directory, writers, tuple(writers), seal=ABORTS)
