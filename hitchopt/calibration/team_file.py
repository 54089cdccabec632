"""The team as estimated, as the block ``team:`` of a problem file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path

import numpy as np

from hitchopt.calibration.calibrate import Calibration
from hitchopt.calibration.estimates import Estimate
from hitchopt.errors import FileError
from hitchopt.hitch import Quadrotor, Team


def save_team(path: Path, calibration: Calibration) -> None:
    """Write the block ``team:`` with the estimates; comments state their standard errors.

    What the recording does not determine is as in the plan.

    Raises
    ------
    FileError: the file cannot be written.
    """
    try:
        path.write_text(team_text(calibration), encoding="utf-8")
    except OSError as error:
        raise FileError(f"{path}: cannot be written: {error}") from error


def team_text(calibration: Calibration) -> str:
    """Return the block ``team:`` in YAML."""
    team, friction = calibration.task.team, calibration.friction
    values: dict[str, str] = {}
    for field in fields(Team):
        value = getattr(team, field.name)
        values[field.name] = _plain(value.tolist() if isinstance(value, np.ndarray) else value)
    errors = ", ".join(f"{one.error:.1g}" for one in calibration.lengths)
    lengths = ", ".join(f"{one.value:.4f}" for one in calibration.lengths)
    values["cable_length"] = f"[{lengths}]  # ± {errors} m"
    values["cable_density"] = f"{_plain(calibration.density)}  # as assumed"
    values["cable_friction"] = f"{_plain(team.cable_friction)}  # of the plan: not determined"
    if friction.known:
        values["cable_friction"] = f"{friction.value:.3f}  # ± {friction.error:.1g}"
    values["quadrotor"] = _quadrotors(team.quadrotor, calibration.stiffness)
    return "\n".join(["team:", *(f"  {name}: {text}" for name, text in values.items())]) + "\n"


def _quadrotors(kinds: Sequence[Quadrotor], stiffness: Sequence[Estimate]) -> str:
    """Return one kind where all robots have the same, else a list."""
    texts, remarks = [], []
    for kind, estimate in zip(kinds, stiffness, strict=True):
        entries = {field.name: _plain(getattr(kind, field.name)) for field in fields(Quadrotor)}
        if estimate.known:
            entries["stiffness"] = f"{estimate.value:.3g}"
        texts.append("{" + ", ".join(f"{name}: {text}" for name, text in entries.items()) + "}")
        known = f"± {estimate.error:.1g} N/m" if estimate.known else "of the plan: not determined"
        remarks.append(f"  # stiffness {known}")
    if len(set(texts)) == 1:
        return texts[0] + remarks[0]
    return "".join(f"\n    - {a}{b}" for a, b in zip(texts, remarks, strict=True))


def _plain(value: object) -> str:
    """Return a value in YAML."""
    if value is None:
        return "null"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list):
        return "[" + ", ".join(map(_plain, value)) + "]"
    return f"{value:.9g}" if isinstance(value, float) else str(value)
