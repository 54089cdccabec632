"""A certified plan, written as fleets read it, and judged by what was written.

Files are read back from disk before they get their place: whoever loses a limit of what is flown
by its rounding or refitting is refused, and nothing that was there before is touched.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from hitchopt.checks.certificate import Certificate
from hitchopt.errors import FileError, InfeasibleError, InputError
from hitchopt.exports.formats.format import Arrangement, Candidate, Format, Task
from hitchopt.exports.manifest import (
    FILE,
    manifest_of,
    manifest_of_parts,
    owned_files,
    part_folders,
    write_manifest,
)
from hitchopt.exports.refusal import violations_of, with_slower
from hitchopt.exports.verification import Verdict, judge
from hitchopt.storage.atomic import Writer, replace_files

Progress = Callable[[str], None]


@dataclass(frozen=True)
class Export:
    """What was written.

    Attributes
    ----------
    folder: where.
    files: names of the files in it, without the manifest.
    verdict: errors and checks of what the files say.
    notes: what else is to be known of them.
    begins: when in the plan it begins [s]; 0 unless the plan was cut.
    """

    folder: Path
    files: tuple[str, ...]
    verdict: Verdict
    notes: tuple[str, ...]
    begins: float = 0.0


class _LostError(Exception):
    """What was written does not keep what the plan keeps."""

    def __init__(self, verdict: Verdict) -> None:
        super().__init__()
        self.verdict = verdict


def export_plan(
    kind: Format,
    task: Task,
    certificate: Certificate,
    folder: Path,
    progress: Progress | None = None,
    *,
    suggest: bool = True,
) -> tuple[Export, ...]:
    """Write the plan in a format; return what was written, part by part.

    Parameters
    ----------
    kind: the format.
    task: the plan, and how it is to be told.
    certificate: of that plan.
    folder: where to; made if it is missing. Only files of an earlier export there are replaced.
    progress: called with what is being done now.
    suggest: whether to look, after a refusal, for how much more slowly it could be flown.

    Raises
    ------
    CertificateError: the plan's certificate does not hold.
    InputError: a frame that the format cannot be in.
    InfeasibleError: the format cannot hold the plan, or loses a limit; nothing is written.
    FileError: the folder cannot be written to, or holds others' files of these names.
    """
    certificate.raise_if_violated()
    if task.room.frame not in kind.frames:
        raise InputError(
            "--frame",
            task.room.frame,
            f"one of {', '.join(kind.frames)} for {kind.name}",
            f"leave it out for {kind.frames[0]}",
        )
    refusals = []
    try:
        for arrangement in kind.arrangements(task):
            try:
                return _arranged(kind, arrangement, certificate, folder, progress)
            except InfeasibleError as error:
                refusals.append(error)
    except InfeasibleError as error:  # there is no other way to arrange it
        refusals.append(error)
    if not suggest:
        raise refusals[0]

    def trial(slower: Task) -> None:
        with tempfile.TemporaryDirectory() as place:
            export_plan(kind, slower, certificate, Path(place) / "trial", suggest=False)

    raise with_slower(refusals[0], task, trial, progress)


def _arranged(
    kind: Format,
    arrangement: Arrangement,
    certificate: Certificate,
    folder: Path,
    progress: Progress | None,
) -> tuple[Export, ...]:
    tasks, note = arrangement.tasks, arrangement.note
    before = part_folders(folder)  # the manifest that tells them is about to be replaced
    if len(tasks) == 1:
        exported = (_export(kind, tasks[0], certificate, folder, note, progress),)
        _remove_parts(folder, before)
        return exported
    names = tuple(f"part{i + 1}" for i in range(len(tasks)))
    with tempfile.TemporaryDirectory() as trial:  # all parts will do, or none is written
        for part, name in zip(tasks, names, strict=True):
            _export(kind, part, certificate, Path(trial) / name, note, progress)
    done = tuple(
        _export(kind, part, certificate, folder / name, f"{part.place}: {note}", progress)
        for part, name in zip(tasks, names, strict=True)
    )
    _remove_parts(folder, [name for name in before if name not in names])
    content = manifest_of_parts(kind, tasks, names)
    replace_files(
        folder,
        {FILE: lambda path: write_manifest(path, content)},
        {FILE, *owned_files(folder)},
        seal=FILE,
    )
    return done


def _export(
    kind: Format,
    task: Task,
    certificate: Certificate,
    folder: Path,
    note: str,
    progress: Progress | None,
) -> Export:
    refused: Verdict | None = None
    for number, candidate in enumerate(kind.candidates(task), 1):
        if progress is not None:
            progress(f"writing {kind.name}" + (f", attempt {number}" if number > 1 else ""))
        try:
            notes = (*candidate.notes, *((note,) if note else ()))
            return _written(kind, task, replace(candidate, notes=notes), folder, progress)
        except _LostError as lost:
            refused = refused or lost.verdict
    if refused is None:
        raise FileError(f"{kind.name}: has nothing to write")
    raise InfeasibleError(
        violations_of(kind, refused, certificate),
        f"{kind.name} is not written: what it rounds or refits costs more than the plan has left",
    )


def _written(
    kind: Format, task: Task, candidate: Candidate, folder: Path, progress: Progress | None
) -> Export:
    files = tuple(candidate.writers)
    owned = {FILE, *files, *owned_files(folder)}
    _refuse_strangers(folder, files)
    verdicts: list[Verdict] = []

    def check(path: Path) -> None:
        if progress is not None:
            progress(f"reading {kind.name} back")
        verdict = judge(task.motion, kind.read(path.parent, task), task.room, task.names)
        if verdict.lost or verdict.position.worst > kind.accuracy:
            raise _LostError(verdict)
        content = manifest_of(kind, task, files, verdict, candidate.notes)
        if candidate.receiver:
            content["receiver"] = dict(candidate.receiver)
        write_manifest(path, content)
        verdicts.append(verdict)

    writers: dict[str, Writer] = {**candidate.writers, FILE: check}
    replace_files(folder, writers, owned, seal=FILE)
    return Export(folder, files, verdicts[-1], candidate.notes, task.begins)


def _refuse_strangers(folder: Path, files: Sequence[str]) -> None:
    known = set(owned_files(folder))
    for name in files:
        if name not in known and (folder / name).exists():
            raise FileError(
                f"{folder / name}: is there already and not from an export; "
                "choose another folder with -o"
            )


def _remove_parts(folder: Path, names: Sequence[str]) -> None:
    """Remove the folders of an earlier export that was cut into more parts."""
    for name in names:
        part = folder / name
        if not part.is_dir():
            continue
        for file in owned_files(part):
            (part / file).unlink(missing_ok=True)
        if not any(part.iterdir()):
            part.rmdir()
