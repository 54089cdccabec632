"""The files of one solve in its directory, never a mixture of two; the tables among them.

``certificate.json`` is written last and names the digest of ``plan.npz``. Rows of setpoints are by
time, then drone, as text and as a data frame.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hitchopt.checks.certificate import Certificate
from hitchopt.errors import FileError, HitchoptError, InfeasibleError, UnsupportedError
from hitchopt.motion.chapters import parts_at
from hitchopt.motion.motion import Motion
from hitchopt.motion.plan_file import write_plan
from hitchopt.motion.states import States, iterate_states, sample_times, states_at
from hitchopt.storage.archive import PLAN
from hitchopt.storage.files import Writer, digest, parsed_json, replace_files, write_strict_json
from hitchopt.values import Array

SETPOINTS, VERTICES = "setpoints.csv", "vertices.csv"
CERTIFICATE, DIAGNOSIS = "certificate.json", "diagnosis.json"
SUMMARY, REPORT = "summary.png", "report.html"
STATICS, STATICS_PICTURE = "statics.json", "statics.png"
ABORTS, ABORT_PLANS = "aborts.json", "aborts.zip"

OWNED = (
    *(PLAN, SETPOINTS, VERTICES, CERTIFICATE, SUMMARY, DIAGNOSIS, REPORT),
    *(STATICS, STATICS_PICTURE, ABORTS, ABORT_PLANS),
)
"""The names in DIR that are ours: nothing else there is ever replaced or removed."""

if TYPE_CHECKING:
    from pandas import DataFrame

DIAGNOSIS_FORMAT = "hitchopt-diagnosis/1"


def save_plan(
    directory: Path | str,
    motion: Motion,
    certificate: Certificate,
    title: str = "",
    rate: float = 100.0,
    pictures: Mapping[str, Writer] | None = None,
    progress: Progress | None = None,
    problem: str = "",
) -> Path:
    """Write the files of a certified plan, whole or not at all; return the directory.

    Tables are sampled at ``rate`` [Hz]; ``pictures`` has, for names among OWNED, what draws them at
    a path; ``progress`` is called with the fraction of the setpoints written.
    """
    certificate.raise_if_violated()
    writers: dict[str, Writer] = {
        PLAN: lambda path: write_plan(path, motion, title, problem),
        SETPOINTS: lambda path: write_setpoints(path, motion, rate, progress),
        **(pictures or {}),
    }
    if motion.has_cables:
        writers[VERTICES] = lambda path: write_vertices(path, motion, rate)
    tables = [name for name in (SETPOINTS, VERTICES) if name in writers]

    def seal(path: Path) -> None:
        content = certificate_content(motion, certificate, path.with_name(PLAN))
        digests = {name: digest(path.with_name(name)) for name in tables}
        write_strict_json(path, content | {"tables": digests})

    writers[CERTIFICATE] = seal
    return replace_files(directory, writers, OWNED, seal=CERTIFICATE, previous="remove")


def certificate_content(motion: Motion, certificate: Certificate, plan: Path) -> dict[str, Any]:
    """Read certificate.json of the motion in a plan file."""
    assigned = {} if motion.assignment is None else {"assignment": motion.assignment.to_dict()}
    return {**certificate.to_dict(), **assigned, "plan": digest(plan)}


def changed_tables(directory: Path) -> list[str]:
    """Return the tables there that are others than were written with the certificate there."""
    try:
        content = parsed_json((directory / CERTIFICATE).read_bytes())
        digests = content.get("tables", {}).items()
        there = [(name, known) for name, known in digests if name in (SETPOINTS, VERTICES)]
    except (OSError, ValueError, AttributeError):
        return []  # no certificate of a whole plan, which others refuse
    files = ((directory / name, known) for name, known in there)
    return [file.name for file, known in files if file.is_file() and digest(file) != known]


def refuse_mixture(directory: Path) -> None:
    """Raise FileError unless the certificate is that of the plan: a killed save leaves none."""
    path = directory / CERTIFICATE
    try:
        named = parsed_json(path.read_bytes()).get("plan")
        actual = digest(directory / PLAN)
    except (OSError, ValueError, AttributeError) as error:
        words = f"{path}: cannot be read: {error}; was a save killed? solve again"
        raise FileError(words) from error
    if named != actual:
        raise FileError(f"{path}: is of another {PLAN} than the one next to it; solve again")


def save_diagnosis(directory: Path | str, content: dict[str, Any]) -> Path:
    """Write ``diagnosis.json`` with the content of ``diagnosis_content``.

    The files of the last certified plan move to the subdirectory ``previous``, or stay there.
    """
    writers = {DIAGNOSIS: lambda path: write_strict_json(path, content)}
    return replace_files(directory, writers, OWNED, seal=CERTIFICATE, previous="keep")


def diagnosis_content(
    reason: HitchoptError, suggestions: Iterable[dict[str, object]] = ()
) -> dict[str, Any]:
    """Return why there is no plan, and verified changes that remove the reason, smallest first.

    An InfeasibleError names the limits that bind; ``suggestions`` are changes as plain values.
    """
    violations = reason.violations if isinstance(reason, InfeasibleError) else ()
    return {
        "format": DIAGNOSIS_FORMAT,
        "feasible": False,
        "message": str(reason),
        "violations": [{**vars(v), "message": str(v)} for v in violations],
        "suggestions": [*suggestions],
    }


SAVED = {
    "positions": ("x", "y", "z"),
    "velocities": ("vx", "vy", "vz"),
    "accelerations": ("ax", "ay", "az"),
    "jerks": ("jx", "jy", "jz"),
    "yaw": ("yaw",),
    "cable_forces": ("cable_x", "cable_y", "cable_z"),
}
"""Quantities of a row and their columns: [m], [m/s], [m/s²], [m/s³], [rad], [N]."""

HEADER = ",".join(("t", "drone", *(name for group in SAVED.values() for name in group)))

VERTICES_HEADER = "t,vertex,x,y,z,tension"

NUMBER = "%#.12g"
"""Twelve significant digits and a decimal point always: readers such as polars take a column that
begins without one for whole numbers."""

ROWS = 2000  # Rows that are formatted at once: more leave the processor's cache

Progress = Callable[[float], None]  # Function that is called with the fraction done, 0 to 1


def _values(states: States) -> Array:
    """Return the numbers of SAVED (S, D, 16), without negative zeros."""
    motion = (states.positions, states.velocities, states.accelerations, states.jerks)
    yaw = np.zeros((*states.positions.shape[:2], 1))
    values: Array = np.concatenate((*motion, yaw, states.cable_forces), axis=-1) + 0.0
    return values


def write_setpoints(
    path: Path, motion: Motion, rate: float, progress: Progress | None = None
) -> None:
    """Write one row per sample at ``rate`` [Hz] and drone, by time, then drone; yaw is 0."""
    times, names = sample_times(motion.duration, rate), motion.team.drone_names

    def blocks() -> Iterator[tuple[Array, Array]]:
        for states in iterate_states(motion, times, max(1, ROWS // len(names))):
            yield states.t, _values(states)
            if progress is not None:
                progress(min(float(states.t[-1]) / float(times[-1] or 1.0), 1.0))

    write_rows(path, HEADER, (names, blocks()))


def write_vertices(path: Path, motion: Motion, rate: float) -> None:
    """Write one row per sample and vertex, while the hitch exists; row k has cable k's tension.

    The last row of an open chain, which has one point more than cables, leaves it empty. Vertices
    of several groups are called as ``b.p2``, one group after the other. Where a hitch changes its
    robots, vertices are counted along the ring of the time, and so are tensions.
    """
    times = sample_times(motion.duration, rate)

    def blocks(own: Motion, t: Array, points: int) -> Iterator[tuple[Array, Array]]:
        begin = own.drones.breaks[0] - motion.drones.breaks[0]
        for states in iterate_states(own, np.maximum(t - begin, 0.0), max(1, ROWS // points)):
            values = np.full((len(states.t), points, 4), np.nan)
            values[..., :3] = states.vertices
            values[:, : own.team.robots, 3] = states.tensions
            here = states.formed
            yield begin + states.t[here], values[here] + 0.0  # no negative zeros

    tables = []
    for each in motion.groups:
        for part, index, _ in parts_at(each.motion, times):
            if points := part.team.layout.points:
                names = [each.label(f"p{k}") if each.name else str(k) for k in range(points)]
                tables.append((names, blocks(part, times[index], points)))
    write_rows(path, VERTICES_HEADER, *tables)


def write_rows(
    path: Path, header: str, *tables: tuple[Sequence[str], Iterable[tuple[Array, Array]]]
) -> None:
    """Write a header and one line per sample and item: the time, the item's name, the numbers.

    Tables, one after the other, have the names (D,) of items and blocks of times (S,) [s] and
    numbers (S, D, C); where these are nan nothing is written.
    """
    numbers = f",{NUMBER}" * (header.count(",") - 1) + "\n"
    with path.open("w", encoding="utf-8", newline="") as file:
        file.write(header + "\n")
        for names, blocks in tables:
            lines = "".join(f"{NUMBER},{name.replace('%', '%%')}{numbers}" for name in names)
            for t, values in blocks:
                times = np.broadcast_to(t[:, None, None], (*values.shape[:2], 1))
                flat = np.concatenate([times, values], -1).ravel()
                text = lines * len(t) % tuple(flat.tolist())
                file.write(text.replace(",nan\n", ",\n") if np.isnan(flat).any() else text)


def data_frame(motion: Motion, rate: float) -> DataFrame:
    """Return the rows of ``setpoints.csv`` and the name of the phase, by time, then drone."""
    try:
        import pandas
    except ImportError as error:
        words = f"data frames need pandas ({error}); pip install 'hitchopt[pandas]'"
        raise UnsupportedError(words) from None
    times, names = sample_times(motion.duration, rate), motion.team.drone_names
    values = _values(states_at(motion, times)).reshape(len(times) * len(names), -1)
    phases = [f"{phase.name} ({i})" for i, phase in enumerate(motion.phases)]
    ends = np.array([phase.end for phase in motion.phases[:-1]])
    here = np.repeat(np.array(phases)[np.searchsorted(ends, times, side="right")], len(names))
    first, drone, *columns = HEADER.split(",")
    who = pandas.Categorical(np.tile(names, len(times)), pandas.Index(list(names)))
    rows = {first: np.repeat(times, len(names)), drone: who}
    numbers = dict(zip(columns, values.T, strict=True))
    when = pandas.Categorical(here, pandas.Index(phases))
    return pandas.DataFrame(rows | numbers | {"phase": when})
