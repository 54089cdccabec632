"""A certified plan, written as fleets read it, and verified by what was written.

Files are read back from disk before they get their place: an export that loses a limit of what is
flown by its rounding or refitting is refused, and nothing that was there before is touched.
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from hitchopt.checks.certificate import Certificate
from hitchopt.errors import FileError, InfeasibleError, InputError
from hitchopt.exports.formats.format import Arrangement, Candidate, Format, Progress, Task
from hitchopt.exports.manifest import FILE, manifest_of, owned_files, part_folders, parts_manifest
from hitchopt.exports.verification import FLOWN, PLACES, SLOWER, Verdict, verify
from hitchopt.motion.cutting import stretched
from hitchopt.one_line import OneLine
from hitchopt.storage.atomic import Writer, replace_files
from hitchopt.storage.strict_json import write_strict_json

FACTORS = (1.002, 1.005, 1.01, 1.02, 1.05, 1.1)
"""Factors of slower flights that are tried after a refusal, in this order."""

MOST_DRONES = 100
"""Size of the largest team for which slower flights are tried; larger ones take too long."""


@dataclass(frozen=True)
class Export(OneLine):
    """Files that were written and verified.

    Attributes
    ----------
    folder: where they are.
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


def silent(_: str) -> None:
    """Ignore what is being done."""


def export_plan(
    kind: Format, task: Task, certificate: Certificate, folder: Path, progress: Progress = silent
) -> tuple[Export, ...]:
    """Write the plan in a format; return what was written, part by part.

    Parameters
    ----------
    kind: the format.
    task: the plan, and all that its files depend on.
    certificate: the plan's certificate.
    folder: where to; made if it is missing. Only files of an earlier export there are replaced.
    progress: called with what is being done now.

    Raises
    ------
    CertificateError: the plan's certificate does not hold.
    InputError: a frame that the format cannot be in.
    InfeasibleError: the format cannot hold the plan, or loses a limit; nothing is written. The
        smallest stretch that was tried and loses nothing is named.
    FileError: the folder cannot be written to, or holds others' files of these names.
    """
    certificate.raise_if_violated()
    if task.frame.name not in kind.frames:
        bound = f"one of {', '.join(kind.frames)} for {kind.name}"
        raise InputError("--frame", task.frame.name, bound, f"leave it out for {kind.frames[0]}")
    exporter = _Exporter(kind, certificate, progress)
    try:
        return exporter.first(task, folder)
    except InfeasibleError as refusal:
        eased = any(violation.remedy == SLOWER for violation in refusal.violations)
        # Offsets that hold the tension are of one pace: a slower flight needs others.
        tried = eased and len(task.names) <= MOST_DRONES and not task.options.hold_tension
        for factor in FACTORS if tried else ():
            progress(f"trying --stretch {factor:g}")
            slower = replace(task, motion=stretched(task.motion, factor))
            try:
                with tempfile.TemporaryDirectory() as trial:
                    _Exporter(kind, certificate, silent).first(slower, Path(trial) / "trial")
            except InfeasibleError:
                continue
            percent = f"{100 * (factor - 1):.2g} % slower"
            note = f"verified: --stretch {factor:g} ({percent}) loses nothing"
            both = f"{refusal.note}\n{note}" if refusal.note else note
            raise InfeasibleError(refusal.violations, both) from None
        raise


@dataclass(frozen=True)
class _Exporter:
    """Writes motions in a format and verifies them, with the plan's certificate for comparison."""

    kind: Format
    certificate: Certificate
    progress: Progress

    def first(self, task: Task, folder: Path) -> tuple[Export, ...]:
        """Write the first arrangement that loses nothing, or raise what the first of all loses."""
        refusals = []
        try:
            for arrangement in self.kind.arrangements(task):
                try:
                    return self._parts(arrangement, folder)
                except InfeasibleError as error:
                    refusals.append(error)
        except InfeasibleError as error:  # there is no other arrangement
            refusals.append(error)
        raise refusals[0]

    def _parts(self, arrangement: Arrangement, folder: Path) -> tuple[Export, ...]:
        tasks, note = arrangement.tasks, arrangement.note
        before = part_folders(folder)  # the manifest that names them is about to be replaced
        names: tuple[str, ...] = ()
        if len(tasks) == 1:
            done = [self._whole(tasks[0], folder, note)]
        else:
            names = tuple(f"part{i + 1}" for i in range(len(tasks)))
            with tempfile.TemporaryDirectory() as trial:  # all parts will do, or none is written
                tried = [
                    self._whole(part, Path(trial) / name, f"{part.part}: {note}")
                    for part, name in zip(tasks, names, strict=True)
                ]
                done = [self._copied(each, folder / each.folder.name) for each in tried]
            write = partial(write_strict_json, content=parts_manifest(self.kind, tasks, names))
            replace_files(folder, {FILE: write}, {FILE, *owned_files(folder)}, seal=FILE)
        for name in before:  # an earlier export was cut into more parts
            if name not in names and (folder / name).is_dir():
                for file in owned_files(folder / name):
                    (folder / name / file).unlink(missing_ok=True)
                if not any((folder / name).iterdir()):
                    (folder / name).rmdir()
        return tuple(done)

    def _whole(self, task: Task, folder: Path, note: str) -> Export:
        """Write the first candidate that loses nothing, or raise what the first of all loses."""
        refusal: InfeasibleError | None = None
        for number, candidate in enumerate(self.kind.candidates(task), 1):
            attempt = f", attempt {number}" if number > 1 else ""
            self.progress(f"writing {self.kind.name}{attempt}")
            more = (*task.notes, *task.undetermined, *((note,) if note else ()))
            noted = replace(candidate, notes=(*candidate.notes, *more))
            try:
                return self._candidate(task, noted, folder)
            except InfeasibleError as error:
                refusal = refusal or error
        raise refusal or FileError(f"{self.kind.name}: has nothing to write")

    def _candidate(self, task: Task, candidate: Candidate, folder: Path) -> Export:
        kind, files = self.kind, tuple(candidate.writers)
        owned = _owned(folder, files)
        verdicts: list[Verdict] = []

        def check(path: Path) -> None:
            self.progress(f"reading {kind.name} back")
            rules = PLACES if task.options.hold_tension else FLOWN
            recording = kind.read(path.parent, task)
            verdict = verify(task.motion, recording, task.frame, task.names, rules)
            if lost := verdict.violations(self.certificate, kind.accuracy):
                note = "what it rounds or refits costs more than the plan has left"
                raise InfeasibleError(lost, f"{kind.name} is not written: {note}")
            kind.certify(path.parent, task)
            write_strict_json(path, manifest_of(kind, task, candidate, verdict))
            verdicts.append(verdict)

        replace_files(folder, {**candidate.writers, FILE: check}, owned, seal=FILE)
        return Export(folder, files, verdicts[-1], candidate.notes, task.begins)

    def _copied(self, done: Export, folder: Path) -> Export:
        """Copy what was written and verified elsewhere into the folder, all of it or nothing."""
        writers: dict[str, Writer] = {
            name: partial(shutil.copyfile, done.folder / name) for name in (*done.files, FILE)
        }
        replace_files(folder, writers, _owned(folder, done.files), seal=FILE)
        return replace(done, folder=folder)


def _owned(folder: Path, files: Sequence[str]) -> set[str]:
    """Return the files of an earlier export and of the next one, which replaces no others.

    Raises
    ------
    FileError: a file of such a name is there and not from an export.
    """
    owned = {FILE, *owned_files(folder)}
    for name in files:
        if name not in owned and (folder / name).exists():
            raise FileError(
                f"{folder / name}: is there already and not from an export; "
                "choose another folder with -o"
            )
    return {*owned, *files}
