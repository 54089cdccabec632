"""A plan's table of aborts: from every time the clock alone reaches an entry."""

from __future__ import annotations

import tempfile
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from hitchopt.checks import certify
from hitchopt.errors import FileError, InfeasibleError
from hitchopt.exports.directory import ABORT_PLANS, ABORTS
from hitchopt.exports.formats.file_reading import opened_zip, read_members
from hitchopt.motion.motion import JOINT, Motion
from hitchopt.motion.plan_file import read_plan, write_plan
from hitchopt.steps.certified_motions import Certified
from hitchopt.stopping.abort import Abort, Aborts
from hitchopt.storage.atomic import replace_files
from hitchopt.storage.strict_json import parsed_json, write_strict_json
from hitchopt.time_limit import Progress
from hitchopt.values import positive

FORMAT = "hitchopt-aborts/1"

SAME = 1e-7
"""[m] Drones of an entry fly the plan within this until it begins, as its retimed curves do."""

SAMES = 33
"""Number of times at which that is looked at."""

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


def read_aborts(
    directory: Path, motion: Motion, progress: Progress | None = None
) -> AbortTable | None:
    """Return the table that stands next to a plan, certified anew; None where there is none.

    Raises
    ------
    FileError: it is damaged, not of this plan, or one of its entries is not certified.
    """
    if not (directory / ABORTS).exists():
        return None
    source = directory / ABORTS
    try:
        content = parsed_json(source.read_bytes())
        if content["format"] != FORMAT:
            raise ValueError(f"its format is not {FORMAT}")
        with tempfile.TemporaryDirectory() as place:
            with opened_zip(directory / ABORT_PLANS, "table of aborts") as archive:
                members = [archive.getinfo(str(each["plan"])) for each in content["entries"]]
                found = list(read_members(directory / ABORT_PLANS, archive, members))
            entries = []
            for given, data in zip(content["entries"], found, strict=True):
                if progress is not None:
                    progress(f"certifying {content['how']} at {float(given['start']):.4g} s")
                file = Path(place) / "plan.npz"
                file.write_bytes(data)
                entries.append(_entry(given, read_plan(file), motion))
        missing = tuple((float(a), float(b)) for a, b in content["missing"])
        return AbortTable(str(content["how"]), tuple(entries), missing)
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise FileError(f"{source}: {error}; run hitchopt abort again") from error


def _entry(given: Mapping[str, Any], whole: Motion, motion: Motion) -> Abort:
    """Return an entry whose plan is the given one until its clock slows down, and is certified.

    Raises
    ------
    ValueError: it is another plan's, or not certified.
    """
    start, seconds, rest = (float(given[name]) for name in ("start", "seconds", "rest"))
    if not 0.0 <= start <= motion.duration + JOINT or whole.team.drones != motion.team.drones:
        raise ValueError(f"the entry at {start:g} s is of another plan")
    times = np.linspace(0.0, min(start, motion.duration), SAMES)
    places = [each.drones.at(times) for each in (whole, motion)]
    ends = whole.drones.at(min(start + seconds, whole.duration)), motion.drones.at(rest)
    if not all(np.allclose(a, b, rtol=0.0, atol=SAME) for a, b in (places, ends)):
        raise ValueError(f"the entry at {start:g} s does not fly this plan until then")
    whole = replace(whole, team=motion.team, requirements=motion.requirements.untimed)
    certificate = certify(whole)
    if not certificate.certified:
        broken = ", ".join(check.name for check in certificate.violated)
        raise ValueError(f"the entry at {start:g} s is not certified: {broken}")
    return Abort(start, seconds, rest, Certified(whole, certificate))


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
