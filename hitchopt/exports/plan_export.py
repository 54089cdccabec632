"""The export of a plan with the options of a user: a folder of files, or one file."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from hitchopt.checks import certify
from hitchopt.checks.certificate import Certificate
from hitchopt.errors import FileError, InfeasibleError, InputError
from hitchopt.exports.export_options import ExportOptions, checked_rate
from hitchopt.exports.exporting import Export, export_plan, silent
from hitchopt.exports.fleet import placeholder_fleet, read_fleet
from hitchopt.exports.formats.format import Format, Progress, Task
from hitchopt.exports.formats.known_formats import format_of
from hitchopt.exports.held_tension import PositionLoop, held_tension
from hitchopt.exports.manifest import FILE
from hitchopt.exports.reference_frame import ReferenceFrame
from hitchopt.hitch.position_control import undetermined_tension
from hitchopt.motion.cutting import stretched
from hitchopt.motion.motion import Motion

ENDINGS = (".csv", ".parquet", ".npz", ".json", ".skyc", ".zip", ".mcap", ".db3", ".bin", ".yaml")
"""Endings of files in exports: such a name is that of a single file, not of a folder."""


def export_motion(
    motion: Motion,
    title: str,
    options: ExportOptions,
    folder: Path | str,
    progress: Progress | None = None,
) -> tuple[Export, ...]:
    """Write the plan with these options; return what was written, one entry per part.

    Parameters
    ----------
    motion: the plan; it is certified first, stretched as the options say.
    title: what it is called.
    options: the format, and how the plan is placed and sampled in it.
    folder: where to; a name that ends as the format's only file does is that file, its manifest
        next to it.
    progress: called with what is being done now.

    Raises
    ------
    InputError, FileError: what was asked is wrong in itself, or cannot be written.
    CertificateError: the plan's certificate does not hold.
    InfeasibleError: the format cannot hold the plan, or loses a limit; nothing is written.
    UnsupportedError: a library that the format needs is not installed.
    """
    kind = format_of(options.format)
    roles = motion.team.drone_names
    plan = stretched(motion, options.stretch)
    task = Task(
        plan,
        title,
        ReferenceFrame(options.frame or kind.frames[0], options.origin, options.yaw),
        placeholder_fleet(roles) if options.fleet is None else read_fleet(options.fleet, roles),
        _rate(kind, options.rate),
        options,
        undetermined=_undetermined(kind, motion, options),
    )
    place = Path(folder)
    single = place.suffix.lower() in ENDINGS and not place.is_dir()
    if place.exists() and not (single or place.is_dir()):
        raise FileError(f"{place}: is a file; an export is a folder, choose another one")
    certificate = certify(plan, progress)
    if options.stretch > 1.0 and motion.borne is not None and certificate.violated:
        words = f"with --stretch {options.stretch:g}: legs lean by the inertia of what is carried"
        remedy = "stretch it less, or plan the steps with a longer duration"
        raise InfeasibleError(each.violation(words, remedy) for each in certificate.violated)
    if options.hold_tension:
        loop = PositionLoop.of(motion.team, options.stiffness, options.damping)
        held = held_tension(plan, loop)
        task = replace(task, motion=held.motion, notes=(held.note,))
    if single:
        return export_file(kind, task, certificate, place, progress or silent)
    return export_plan(kind, task, certificate, place, progress or silent)


def _undetermined(kind: Format, motion: Motion, options: ExportOptions) -> tuple[str, ...]:
    """Return why the files leave the tension undetermined; nothing without a hitch."""
    team = motion.team
    if not np.any(motion.formed):
        return ()
    fed_forward = kind.carries_pull and bool(np.all(team.feed_forward))
    return undetermined_tension(
        integral=kind.receiver_integral or bool(np.any(team.integral)),
        feed_forward=fed_forward or options.hold_tension,
    )


def _rate(kind: Format, rate: float | None) -> float:
    if rate is None:
        return kind.rate
    if kind.rate == 0.0:
        raise InputError("--rate", rate, f"left out for {kind.name}", "it does not sample")
    return checked_rate(rate)


def export_file(
    kind: Format, task: Task, certificate: Certificate, path: Path, progress: Progress
) -> tuple[Export, ...]:
    """Write the plan as one file, its manifest next to it (``plan.csv.export.json``).

    Parameters and errors are those of ``export_plan``, but for these.

    Parameters
    ----------
    path: name of the file; its folder is made if it is missing.

    Raises
    ------
    InputError: the format writes several files, or one of another ending.
    FileError: there is a file that no export wrote, or it cannot be written.
    """
    manifest = path.with_name(f"{path.name}.{FILE}")
    if path.exists() and not manifest.exists():
        raise FileError(f"{path}: is there already, and no export's; choose another name")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".hitchopt-", dir=path.parent) as place:
            done = export_plan(kind, task, certificate, Path(place) / "export", progress)
            names = [name for part in done for name in part.files]
            if len(names) > 1 or Path(names[0]).suffix != path.suffix.lower():
                some = ", ".join(names[:3]) + (", …" if len(names) > 3 else "")
                bound = f"a folder for {kind.name}, or a name that ends as its only file does"
                raise InputError("-o", str(path), bound, f"it writes {some}")
            manifest.unlink(missing_ok=True)  # it seals the file: gone first, back last
            (done[0].folder / names[0]).replace(path)
            (done[0].folder / FILE).replace(manifest)
    except OSError as error:
        raise FileError(f"{path}: cannot be written: {error.strerror or error}") from error
    return (replace(done[0], folder=path.parent, files=(path.name,)),)
