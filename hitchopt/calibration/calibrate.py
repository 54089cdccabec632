"""Calibration: a team's cable lengths, stiffness and friction from a recorded flight of a plan."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hitchopt.calibration.clasp_sliding import sliding_clasps
from hitchopt.calibration.estimates import Estimate, robust_mean
from hitchopt.calibration.flight_windows import Windows, windows_of
from hitchopt.calibration.force_balance import ForceBalance
from hitchopt.calibration.friction_fit import fit_friction, part_tensions
from hitchopt.calibration.plan_comparison import Comparison, compare
from hitchopt.calibration.recordings import Recording, read_recording
from hitchopt.calibration.stiffness_fit import StiffnessFit, fit_stiffness
from hitchopt.errors import InputError
from hitchopt.hitch import Team
from hitchopt.hitch.cable_parts import CableParts
from hitchopt.one_line import OneLine
from hitchopt.simulation.flight_records import Flight
from hitchopt.simulation.flight_task import Task, read_task
from hitchopt.values import Array, not_negative, path

LEAST_SCALE = 3e-4
"""Least scatter that is assumed of a measured cable length [m]."""


@dataclass(frozen=True, eq=False)
class Calibration(OneLine):
    """Estimates from a recorded flight, and its deviations from the plan.

    Attributes
    ----------
    task: the plan.
    recording: what was measured.
    density: of the cables [kg/m], as assumed.
    lengths: of each cable [m], between its drones: legs, edge and the arcs of their sag.
    stiffness: of the position loops of each robot's drones [N/m].
    friction: coefficient at the clasps.
    comparison: deviations from the plan.
    """

    task: Task
    recording: Recording
    density: float
    lengths: tuple[Estimate, ...]
    stiffness: tuple[Estimate, ...]
    friction: Estimate
    comparison: Comparison


def calibrate(
    recording: Recording | Flight | Path | str,
    plan: Path | str | None = None,
    *,
    density: float | None = None,
) -> Calibration:
    """Estimate cable lengths, stiffness and friction from a recorded flight of a plan.

    Lengths are the robust means of measured legs and edges, arcs included. The stiffness follows
    from where drones are on average, friction from cables that slide while drones give way: see
    ``stiffness_fit`` and ``friction_fit``. What a recording does not determine is said so.

    Parameters
    ----------
    recording: a table with the columns ``t,name,x,y,z``, the directory of a simulated flight, or
        such a recording or flight itself.
    plan: directory of the plan that was flown; None: that of the flight, or the directory that the
        recording lies in.
    density: of the cables [kg/m], as weighed; None: that of the simulated flight, else the plan's.

    Raises
    ------
    FileError: a recording or a plan that cannot be read, or a recording without its hitch.
    InputError: no plan, or a negative density.
    """
    if not isinstance(recording, Recording | Flight):
        recording = path("recording", recording)
    task = _task(recording, plan)
    if isinstance(recording, Flight):
        recording = Recording.of_flight(recording)
    elif not isinstance(recording, Recording):
        recording = read_recording(Path(recording), task.team)
    given = recording.density if density is None else not_negative("density", density)
    return estimate_team(recording, task, task.team.cable_density if given is None else given)


def estimate_team(recording: Recording, task: Task, density: float) -> Calibration:
    """Return the calibration from a recording of a task, with cables of a density [kg/m].

    Raises
    ------
    InputError: drones and vertices are never seen together while the plan has a hitch.
    """
    team = task.team
    windows = windows_of(recording, task)
    if not len(windows.t):
        raise InputError(
            "recording",
            f"{len(recording.t)} samples",
            "of a flight in which drones and vertices are seen while the plan has a hitch",
            "record the vertices too, and let t count from the plan's start",
        )
    feeds = recording.feed_forward if recording.feed_forward is not None else team.feed_forward
    winds = recording.integral if recording.integral is not None else team.integral
    fit: StiffnessFit | None = None
    remark = "integral action returns drones to their set points, whatever their stiffness"
    if not np.any(winds):
        fit = fit_stiffness(team, ForceBalance.of(team, windows.spans(), density), feeds)
    stiffness = (Estimate.unknown(remark),) * team.robots
    if fit is not None:
        stiffness = tuple(fit.stiffness[kind] for kind in fit.kinds[::2])
    friction, tensions = _friction(team, recording, windows, density, fit, stiffness, feeds)
    parts = CableParts.of(team, windows.drones, windows.vertices)
    means, errors = robust_mean(parts.lengths(density, tensions), LEAST_SCALE)
    lengths = tuple(
        Estimate(float(mean), float(error)) for mean, error in zip(means, errors, strict=True)
    )
    return Calibration(
        task, recording, density, lengths, stiffness, friction, compare(recording, task)
    )


def _task(recording: Recording | Flight | Path, plan: Path | str | None) -> Task:
    """Return the plan that was flown.

    Raises
    ------
    FileError, InputError: there is none.
    """
    if plan is not None:
        return read_task(path("plan", plan))
    if isinstance(recording, Flight):
        return recording.task
    if isinstance(recording, Recording):
        raise InputError("plan", None, "the directory of a plan", "name the plan that was flown")
    return read_task(recording.absolute().parent)


def _friction(
    team: Team,
    recording: Recording,
    windows: Windows,
    density: float,
    fit: StiffnessFit | None,
    stiffness: tuple[Estimate, ...],
    feed_forward: NDArray[np.bool_],
) -> tuple[Estimate, Array]:
    """Return the friction, and the edges' tensions (windows, n) [N], planned where unknown."""
    found = np.repeat([one.value if one.known else np.nan for one in stiffness], 2)
    k = np.where(np.isnan(found), team.stiffness, found)
    if not np.all(np.isfinite(k)):
        remark = "the drones' stiffness is neither determined nor stated by the plan's team"
        return Estimate.unknown(f"tensions are unknown: {remark}"), windows.tensions
    balance = ForceBalance.of(team, windows, density)
    wind = np.zeros(2) if fit is None else fit.wind
    tensions = part_tensions(balance, 1.0 / k, wind, feed_forward)
    friction = fit_friction(sliding_clasps(team, recording, balance, tensions))
    planned = windows.tensions
    edges = np.clip(tensions[:, : team.robots], planned / 3.0, 3.0 * planned)
    return friction, edges
