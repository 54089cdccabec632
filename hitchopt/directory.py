"""The files of a plan in its directory, and tables of its setpoints.

The set of files is replaced atomically. ``certificate.json`` is written last and contains the
digest of ``plan.npz``. Rows of setpoints are sorted by time, then drone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hitchopt.checks.certificate import Certificate
from hitchopt.errors import (
    FileError,
    HitchoptError,
    InfeasibleError,
    InputError,
    optional_module,
)
from hitchopt.motion.flight import Flight
from hitchopt.motion.loads import ramping
from hitchopt.motion.motion import Motion
from hitchopt.motion.plan_file import write_plan
from hitchopt.motion.states import (
    MAX_SAMPLES,
    States,
    flight_states_at,
    iterate_flight_states,
    sample_times,
)
from hitchopt.slices import provided
from hitchopt.storage.archive import PLAN
from hitchopt.storage.files import (
    DIAGNOSIS,
    Writer,
    digest,
    file_bytes,
    parsed_json,
    replace_files,
    strict_json,
    write_strict_json,
)
from hitchopt.values import Array

SETPOINTS = "setpoints.csv"  # Setpoints of drones
VERTICES = "vertices.csv"  # Vertices and tensions
CERTIFICATE = "certificate.json"  # Certificate of the plan
SUMMARY = "summary.png"  # Picture of the plan
REPORT = "report.html"  # Report of the plan
STATICS = "statics.json"  # Static equilibria of the plan
STATICS_PICTURES = ("statics.png", "statics.svg", "statics.pdf")  # Pictures of static equilibria
ABORTS = "aborts.json"  # Table of the plan's aborts
ABORT_PLANS = "aborts.zip"  # Plans of the aborts

CLOSE = 0.02
"""Largest relative difference of worst values of one plan.

Certificates of parts and of whole plans, and of different machines, differ by rounding, by up to
millimetres beside hanging cables."""

ROUNDING = 1e-6  # Largest difference of worst values that are rounding errors

TABLE_ROUNDING = 1.1e-3  # [m], [s] Largest difference of numbers in the table of losses, rounded

AFTER_LOSS = "after_loss"  # Key of the table of losses

COMPARED_APART = frozenset({"checks", "not_recomputed", "plan", "tables", AFTER_LOSS})
"""Keys of ``certificate.json`` that are compared by rules of their own."""

OWNED = (
    *(PLAN, SETPOINTS, VERTICES, CERTIFICATE, SUMMARY, DIAGNOSIS, REPORT),
    *(STATICS, *STATICS_PICTURES, ABORTS, ABORT_PLANS),
)
"""Names of hitchopt's files in DIR; other files are never replaced or removed."""

if TYPE_CHECKING:
    from pandas import DataFrame

DIAGNOSIS_FORMAT = "hitchopt-diagnosis/1"


def save_plan(
    directory: Path | str,
    flight: Flight,
    certificate: Certificate,
    title: str = "",
    rate: float = 100.0,
    pages: Mapping[str, Writer] | None = None,
    progress: Progress | None = None,
    problem: str = "",
) -> Path:
    """Write the files of a certified plan atomically; return the directory.

    Tables are sampled at ``rate`` [Hz]; ``pages`` are writers of further files of OWNED;
    ``progress`` is called with the fraction of setpoints, then of vertices written.

    Raises InputError with the longest phase if a table would have more than MAX_SAMPLES samples.
    """
    certificate.raise_if_violated()
    _check_samples(flight, rate)
    writers: dict[str, Writer] = {
        PLAN: lambda path: write_plan(path, flight, title, problem, certificate.stated_rules),
        SETPOINTS: lambda path: write_setpoints(path, flight, rate, progress),
        **(pages or {}),
    }
    if flight.has_cables:
        writers[VERTICES] = lambda path: write_vertices(path, flight, rate, progress)
    tables = [name for name in (SETPOINTS, VERTICES) if name in writers]

    def seal(path: Path) -> None:
        content = certificate_content(flight, certificate, path.with_name(PLAN))
        digests = {name: digest(path.with_name(name)) for name in tables}
        write_strict_json(path, content | {"tables": digests})

    writers[CERTIFICATE] = seal
    return replace_files(directory, writers, OWNED, seal=CERTIFICATE, previous="remove")


def _check_samples(flight: Flight, rate: float) -> None:
    """Raise InputError with the longest phase if a table would have too many samples."""
    if flight.duration * rate <= MAX_SAMPLES:
        return
    longest = max(flight.phases, key=lambda phase: phase.end - phase.start)
    seconds = longest.end - longest.start
    bound = f"at most {MAX_SAMPLES / flight.duration:.3g} Hz in a plan of {flight.duration:g} s"
    remedy = f"shorten step {longest.step} ({longest.name}), which lasts {seconds:g} s, or lower it"
    raise InputError("rate", rate, bound, remedy)


def certificate_content(flight: Flight, certificate: Certificate, plan: Path) -> dict[str, Any]:
    """Return the content of ``certificate.json`` for the motion in a plan file."""
    assigned = (
        {} if flight.team.assignment is None else {"assignment": flight.team.assignment.to_dict()}
    )
    content = {**certificate.to_dict(), **assigned}
    if any(flown.motion.requirements.limits.survive for flown in flight.teams):
        content[AFTER_LOSS] = provided("loss_table")(flight)
    return content | {"plan": digest(plan)}


def save_picture(directory: Path, certificate: Certificate, write: Writer) -> Path:
    """Write ``summary.png`` next to the plan of a certificate; return its path.

    Raises FileError if another plan, or none, is in the directory by the time it is drawn.
    """
    expected = _recomputed(parsed_json(strict_json(certificate.to_dict())))

    def check() -> None:
        path = directory / CERTIFICATE
        content = _recomputed(parsed_json(file_bytes(path))) if path.is_file() else {}
        if any(content.get(key) != value for key, value in expected.items()):
            raise FileError(
                f"{directory / SUMMARY}: is not written: the directory has another plan, or none"
            )

    return replace_files(directory, {SUMMARY: write}, (SUMMARY,), SUMMARY, check=check) / SUMMARY


def _recomputed(content: dict[str, Any]) -> dict[str, Any]:
    """Return the content of a certificate without custom rules, which need their formulas."""
    checks = [check for check in content.get("checks", []) if not check.get("custom")]
    return {key: x for key, x in content.items() if key != "not_recomputed"} | {"checks": checks}


def changed_tables(directory: Path) -> list[str]:
    """Return the names of tables whose digests differ from those of the certificate."""
    try:
        content = parsed_json(file_bytes(directory / CERTIFICATE))
        digests = content.get("tables", {}).items()
        tables = [(directory / k, value) for k, value in digests if k in (SETPOINTS, VERTICES)]
    except (OSError, ValueError, AttributeError):
        return []  # an incomplete set of files, which refuse_mixture reports
    return [file.name for file, value in tables if file.is_file() and digest(file) != value]


def certificate_differences(directory: Path, recomputed: Mapping[str, Any]) -> list[str]:
    """Return messages on what ``certificate.json`` states otherwise than ``certificate_content``.

    Worst values differ if they do by more than CLOSE of themselves and ROUNDING. Quantities that
    only one of both evaluated are compared if they have a limit. There is no difference without
    the file.
    """
    path = directory / CERTIFICATE
    if not path.is_file():
        return []
    expected = parsed_json(strict_json(dict(recomputed)))
    try:
        content = parsed_json(file_bytes(path))
        has_plan = content["plan"] == expected["plan"]
        stated, own = _stated_values(content), _stated_values(expected)
        off = [name for name in own | stated if not _agree(stated.get(name), own.get(name))]
        keys = sorted((content.keys() | expected.keys()) - COMPARED_APART)
        off += [key for key in keys if content.get(key) != expected.get(key)]
        off += [AFTER_LOSS] * (not _alike(content.get(AFTER_LOSS), expected.get(AFTER_LOSS)))
    except (ValueError, LookupError, TypeError, AttributeError) as error:
        return [f"{path}: is not a certificate: {error!r}; solve again"]
    differences = [f"{path}: {name} is not as recomputed from {PLAN}; solve again" for name in off]
    return differences if has_plan else [f"{path}: is that of another {PLAN}; solve again"]


def _stated_values(content: Mapping[str, Any]) -> dict[str, tuple[Any, ...]]:
    """Return worst values, limits and further entries of checks and custom rules by their names.

    Raises ValueError if a name is repeated.
    """
    entries = [*content["checks"], *content.get("not_recomputed", ())]
    values = {
        entry["name"]: (entry["worst"], entry["limit"], entry.get("sense"), entry.get("gamma"))
        for entry in entries
    }
    if len(values) < len(entries):
        raise ValueError("a check is repeated")
    return values


def _alike(one: Any, other: Any) -> bool:
    """Return whether two tables agree, numbers within TABLE_ROUNDING."""
    if isinstance(one, dict) and isinstance(other, dict):
        return one.keys() == other.keys() and all(_alike(one[key], other[key]) for key in one)
    if isinstance(one, list) and isinstance(other, list):
        return len(one) == len(other) and all(map(_alike, one, other))
    if type(one) is float and type(other) is float:
        return abs(one - other) <= TABLE_ROUNDING
    return type(one) is type(other) and bool(one == other)


def _agree(one: tuple[Any, ...] | None, other: tuple[Any, ...] | None) -> bool:
    """Return whether the entries of a check in two certificates agree."""
    if one is None or other is None:
        return all(entry is None or entry[1] is None for entry in (one, other))
    (worst, *others), (other_worst, *others_of_other) = one, other
    if others != others_of_other:
        return bool(others[-1] != others_of_other[-1])  # with another gamma, it is another quantity
    if worst is None or other_worst is None:
        return worst is other_worst
    largest = max(abs(worst), abs(other_worst))
    return bool(abs(worst - other_worst) <= max(CLOSE * largest, ROUNDING))


def refuse_mixture(directory: Path) -> None:
    """Raise FileError unless the certificate is that of the plan."""
    path = directory / CERTIFICATE
    try:
        expected = parsed_json(file_bytes(path)).get("plan")
        actual = digest(directory / PLAN)
    except (OSError, ValueError, AttributeError) as error:
        reason = f"{path}: cannot be read: {error}; a save may have been interrupted; solve again"
        raise FileError(reason) from error
    if expected != actual:
        raise FileError(
            f"{path}: belongs to a different {PLAN} than the one in this directory; solve again"
        )


def save_diagnosis(directory: Path | str, content: dict[str, Any]) -> Path:
    """Write ``diagnosis.json`` with the content of ``diagnosis_content``.

    The files of the last certified plan are kept in the subdirectory ``previous``.
    """
    writers = {DIAGNOSIS: lambda path: write_strict_json(path, content)}
    return replace_files(directory, writers, OWNED, seal=CERTIFICATE, previous="keep")


def diagnosis_content(
    reason: HitchoptError, suggestions: Iterable[dict[str, object]] = ()
) -> dict[str, Any]:
    """Return the content of ``diagnosis.json``: the reason and verified changes, smallest first.

    The violations are those of an InfeasibleError; ``suggestions`` are changes as plain data.
    """
    violations = reason.violations if isinstance(reason, InfeasibleError) else ()
    return {
        "format": DIAGNOSIS_FORMAT,
        "feasible": False,
        "message": str(reason),
        "violations": [{**v.to_dict(), "message": str(v)} for v in violations],
        "suggestions": [*suggestions],
    }


QUANTITIES = {
    "positions": ("x", "y", "z"),
    "velocities": ("vx", "vy", "vz"),
    "accelerations": ("ax", "ay", "az"),
    "jerks": ("jx", "jy", "jz"),
    "yaw": ("yaw",),
    "cable_forces": ("cable_x", "cable_y", "cable_z"),
}
"""Quantities of a row and their columns: [m], [m/s], [m/s²], [m/s³], [rad], [N]."""

HEADER = ",".join(("t", "drone", *(name for group in QUANTITIES.values() for name in group)))

VERTICES_HEADER = "t,vertex,x,y,z,tension,balanced"

ROWS = 20_000  # Rows that are sampled at once
DIGITS = 9  # Significant digits of numbers in tables of plans
Progress = Callable[[float], None]  # Callback with the completed fraction, 0 to 1


def _values(states: States) -> Array:
    """Return the values of QUANTITIES (S, D, 16), without negative zeros."""
    motion = (states.positions, states.velocities, states.accelerations, states.jerks)
    yaw = np.zeros((*states.positions.shape[:2], 1))
    values: Array = np.concatenate((*motion, yaw, states.cable_forces), axis=-1) + 0.0
    return values


def write_setpoints(
    path: Path, flight: Flight, rate: float, progress: Progress | None = None
) -> None:
    """Write one row per sample at ``rate`` [Hz] and drone, by time, then drone; yaw is 0."""
    times = sample_times(flight.duration, rate)
    team = flight.team
    names = team.listed_names

    def blocks() -> Iterator[tuple[Array, Array]]:
        for states in iterate_flight_states(flight, times, max(1, ROWS // len(names))):
            yield states.t, _values(states.listed(team))
            if progress is not None:
                progress(min(float(states.t[-1]) / float(times[-1] or 1.0), 1.0))

    write_rows(path, HEADER, (names, blocks()))


def write_vertices(
    path: Path, flight: Flight, rate: float, progress: Progress | None = None
) -> None:
    """Write one row per sample and vertex, while the hitch exists; row k has edge k's tension.

    The last column is 1 where vertices are in balance there, and 0 while tensions rise or fall:
    cables are then heavier than their tensions bear, and vertices below these places. The tension
    of the last point of an open chain is empty. Vertices of several teams have names such as
    ``b.p2``, one team after the other.
    """
    times = sample_times(flight.duration, rate)

    def blocks(part: Motion, t: Array, points: int) -> Iterator[tuple[Array, Array]]:
        breaks = part.drones.breaks
        size = max(1, ROWS // points)
        plan_times = np.minimum(breaks[0] + t, breaks[-1])
        piece = np.searchsorted(breaks[1:-1], plan_times, side="right")
        formed = part.formed[piece]
        balanced = ~ramping(part)[piece[formed]]
        t, plan_times = t[formed], plan_times[formed]
        for block in (slice(first, first + size) for first in range(0, len(t), size)):
            values = np.full((len(t[block]), points, 5), np.nan)
            values[..., :3] = part.vertices.at(plan_times[block])
            values[:, : part.team.robots, 3] = part.tensions.at(plan_times[block])
            values[..., 4] = balanced[block, None]
            yield t[block], values + 0.0  # no negative zeros
            if progress is not None:
                progress(min(float(t[block][-1]) / float(times[-1] or 1.0), 1.0))

    tables = []
    for each in flight.teams:
        if points := each.motion.team.layout.points:
            names = [each.label(f"p{k}") if each.name else str(k) for k in range(points)]
            tables.append((names, blocks(each.motion, times, points)))
    write_rows(path, VERTICES_HEADER, *tables)


def write_rows(
    path: Path,
    header: str,
    *tables: tuple[Sequence[str], Iterable[tuple[Array, Array]]],
    digits: int = DIGITS,
) -> None:
    """Write a header and one line per sample and item: the time, the item's name, the numbers.

    Each table has the names (D,) of items, and blocks of times (S,) [s] and numbers (S, D, C). A
    nan in the last column is an empty cell. The numbers of the first sample have decimal points:
    readers such as polars infer from the first rows whether a column has integers.
    """
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.write(f"{header}\n")
        for names, blocks in tables:
            number = f"%#.{digits}g"
            for t, values in blocks:
                times = np.broadcast_to(t[:, None, None], (*values.shape[:2], 1))
                rows = np.concatenate([times, values], axis=-1).reshape(len(t), -1)
                for sample in rows.tolist():
                    cells = f",{number}" * values.shape[-1]
                    lines = "".join(f"{number},{name}{cells}\n" for name in names)
                    file.write((lines % tuple(sample)).replace(",nan\n", ",\n"))
                    number = f"%.{digits}g"


def data_frame(flight: Flight, rate: float) -> DataFrame:
    """Return the rows of ``setpoints.csv`` and the name of the phase, by time, then drone."""
    pandas = optional_module("pandas", "data frames need", "pandas")
    times = sample_times(flight.duration, rate)
    names = flight.team.listed_names
    states = flight_states_at(flight, times).listed(flight.team)
    values = _values(states).reshape(len(times) * len(names), -1)
    phases = [f"{phase.name} ({i})" for i, phase in enumerate(flight.phases)]
    ends = np.array([phase.end for phase in flight.phases[:-1]])
    current = np.repeat(np.array(phases)[np.searchsorted(ends, times, side="right")], len(names))
    first, drone, *columns = HEADER.split(",")
    drones = pandas.Categorical(np.tile(names, len(times)), pandas.Index(list(names)))
    rows = {first: np.repeat(times, len(names)), drone: drones}
    numbers = dict(zip(columns, values.T, strict=True))
    phase = pandas.Categorical(current, pandas.Index(phases))
    frame: DataFrame = pandas.DataFrame(rows | numbers | {"phase": phase})
    return frame
