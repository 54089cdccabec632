"""The files of one solve in its directory, never a mixture of two."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from hitchopt.checks.certificate import Certificate
from hitchopt.errors import HitchoptError, InfeasibleError
from hitchopt.exports.setpoints import Progress, write_setpoints
from hitchopt.exports.vertices import write_vertices
from hitchopt.mission.repair import Suggestion
from hitchopt.motion.motion import Motion
from hitchopt.motion.plan_file import write_plan
from hitchopt.storage.atomic import Writer, replace_files
from hitchopt.storage.strict_json import write_strict_json

PLAN = "plan.npz"
SETPOINTS = "setpoints.csv"
VERTICES = "vertices.csv"
CERTIFICATE = "certificate.json"
SUMMARY = "summary.png"
DIAGNOSIS = "diagnosis.json"
STATICS = "statics.json"
STATICS_PICTURE = "statics.png"

OWNED = (
    PLAN,
    SETPOINTS,
    VERTICES,
    CERTIFICATE,
    SUMMARY,
    DIAGNOSIS,
    STATICS,
    STATICS_PICTURE,
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
) -> Path:
    """Write the files of a certified plan, whole or not at all; return the directory.

    Parameters
    ----------
    directory: made if it is missing.
    motion: the plan; that of a swarm without cables has no table of vertices.
    certificate: the plan's certificate.
    title: what the problem is called.
    rate: samples a second in the tables [Hz].
    pictures: for the name of a picture among OWNED (``summary.png``), what draws it at a path.
    progress: called with the fraction of the setpoints written.

    Raises
    ------
    CertificateError: the certificate does not hold; nothing is written.
    InputError: a rate that is not positive.
    FileError: the directory cannot be written to.
    """
    certificate.raise_if_violated()
    content = certificate.to_dict()
    if motion.assignment is not None:
        content["assignment"] = motion.assignment.to_dict()
    writers: dict[str, Writer] = {
        PLAN: lambda path: write_plan(path, motion, title),
        SETPOINTS: lambda path: write_setpoints(path, motion, rate, progress),
        **(pictures or {}),
        CERTIFICATE: lambda path: write_strict_json(path, content),
    }
    if motion.team.has_cables:
        writers[VERTICES] = lambda path: write_vertices(path, motion, rate)
    return replace_files(directory, writers, OWNED, seal=CERTIFICATE)


def save_diagnosis(
    directory: Path | str, reason: HitchoptError, suggestions: Sequence[Suggestion] = ()
) -> Path:
    """Write why there is no plan, and remove the files of an earlier one; return the directory.

    Parameters
    ----------
    directory: made if it is missing.
    reason: why there is no plan; an InfeasibleError names what binds.
    suggestions: the changes that are verified to remove the reason, the smallest first.

    Raises
    ------
    FileError: the directory cannot be written to.
    """
    violations = reason.violations if isinstance(reason, InfeasibleError) else ()
    content = {
        "format": DIAGNOSIS_FORMAT,
        "feasible": False,
        "message": str(reason),
        "violations": [{**vars(v), "message": str(v)} for v in violations],
        "suggestions": [suggestion.to_dict() for suggestion in suggestions],
    }
    writers = {DIAGNOSIS: lambda path: write_strict_json(path, content)}
    return replace_files(directory, writers, OWNED, seal=CERTIFICATE)
