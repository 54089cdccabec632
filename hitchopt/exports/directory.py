"""The files of one solve in its directory, never a mixture of two.

``certificate.json`` is written last and names the digest of ``plan.npz``.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from hitchopt.checks.certificate import Certificate
from hitchopt.errors import FileError, HitchoptError, InfeasibleError
from hitchopt.exports.setpoints import Progress, write_setpoints, write_vertices
from hitchopt.mission.repair import Suggestion
from hitchopt.motion.motion import Motion
from hitchopt.motion.plan_file import write_plan
from hitchopt.storage.archive import PLAN
from hitchopt.storage.files import Writer, parsed_json, replace_files, write_strict_json

SETPOINTS = "setpoints.csv"
VERTICES = "vertices.csv"
CERTIFICATE = "certificate.json"
SUMMARY = "summary.png"
DIAGNOSIS = "diagnosis.json"
REPORT = "report.html"
STATICS = "statics.json"
STATICS_PICTURE = "statics.png"
ABORTS = "aborts.json"
ABORT_PLANS = "aborts.zip"

OWNED = (
    *(PLAN, SETPOINTS, VERTICES, CERTIFICATE, SUMMARY, DIAGNOSIS, REPORT),
    *(STATICS, STATICS_PICTURE, ABORTS, ABORT_PLANS),
)
"""The names in DIR that are ours: nothing else there is ever replaced or removed."""

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

    Parameters
    ----------
    directory: made if it is missing.
    motion: the plan; that of a swarm without cables has no table of vertices.
    certificate: the plan's certificate.
    title: what the problem is called.
    rate: samples a second in the tables [Hz].
    pictures: for names among OWNED (``summary.png``), what draws them at a path; written after the
        plan.
    progress: called with the fraction of the setpoints written.
    problem: the text of the problem file, if it is known.

    Raises
    ------
    CertificateError: the certificate does not hold; nothing is written.
    InputError: a rate that is not positive.
    FileError: the directory cannot be written to.
    """
    certificate.raise_if_violated()
    writers: dict[str, Writer] = {
        PLAN: lambda path: write_plan(path, motion, title, problem),
        SETPOINTS: lambda path: write_setpoints(path, motion, rate, progress),
        **(pictures or {}),
    }
    if motion.team.has_cables:
        writers[VERTICES] = lambda path: write_vertices(path, motion, rate)
    writers[CERTIFICATE] = lambda path: write_strict_json(
        path, certificate_content(motion, certificate, path.with_name(PLAN))
    )
    return replace_files(directory, writers, OWNED, seal=CERTIFICATE, previous="remove")


def certificate_content(motion: Motion, certificate: Certificate, plan: Path) -> dict[str, Any]:
    """Return what certificate.json says of the motion in a plan file."""
    assigned = {} if motion.assignment is None else {"assignment": motion.assignment.to_dict()}
    return {**certificate.to_dict(), **assigned, "plan": _digest(plan)}


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def refuse_mixture(directory: Path) -> None:
    """Raise FileError unless the directory's certificate is that of its plan.

    For readers of files beside ``plan.npz``: a save that was killed leaves no certificate.
    """
    path = directory / CERTIFICATE
    try:
        named = parsed_json(path.read_bytes()).get("plan")
        found = _digest(directory / PLAN)
    except (OSError, ValueError, AttributeError) as error:
        words = f"{path}: cannot be read: {error}; was a save killed? solve again"
        raise FileError(words) from error
    if named != found:
        raise FileError(f"{path}: is of another {PLAN} than the one beside it; solve again")


def save_diagnosis(
    directory: Path | str, reason: HitchoptError, suggestions: Sequence[Suggestion] = ()
) -> Path:
    """Write why there is no plan; return the directory.

    The files of the last certified plan move to the subdirectory ``previous``, or stay there.

    Parameters
    ----------
    directory: made if it is missing.
    reason: why there is no plan; an InfeasibleError names what binds.
    suggestions: the changes that are verified to remove the reason, the smallest first.

    Raises
    ------
    FileError: the directory cannot be written to.
    """
    content = diagnosis_content(reason, suggestions)
    writers = {DIAGNOSIS: lambda path: write_strict_json(path, content)}
    return replace_files(directory, writers, OWNED, seal=CERTIFICATE, previous="keep")


def diagnosis_content(
    reason: HitchoptError, suggestions: Sequence[Suggestion] = ()
) -> dict[str, Any]:
    """Return what diagnosis.json says; arguments as those of ``save_diagnosis``."""
    violations = reason.violations if isinstance(reason, InfeasibleError) else ()
    return {
        "format": DIAGNOSIS_FORMAT,
        "feasible": False,
        "message": str(reason),
        "violations": [{**vars(v), "message": str(v)} for v in violations],
        "suggestions": [suggestion.to_dict() for suggestion in suggestions],
    }
