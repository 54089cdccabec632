"""What a worker does with a case: plan, fly, settle, export it; and the row that comes of it."""

from __future__ import annotations

import resource
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hitchopt.errors import HitchoptError, InfeasibleError, InputError, TimeLimitError
from hitchopt.storage.plain import Plain
from hitchopt.sweeps.study import Case, Section

if TYPE_CHECKING:
    from hitchopt.plan import Plan

Row = dict[str, Any]
"""A row of the results, by column; what is not known is None."""

PLANNED, INFEASIBLE, LATE, FAILED, WRONG = "planned", "infeasible", "time limit", "failed", "wrong"
"""Values of the column ``status``."""

RATE = 100.0
"""Setpoints per second that are simulated [Hz]."""


@dataclass(frozen=True)
class Outcome:
    """What a worker returns.

    Attributes
    ----------
    digest: of the case.
    row: its row.
    files: bytes of its exported files, by name.
    """

    digest: str
    row: Row
    files: dict[str, bytes] = field(default_factory=dict)


def outcome_of(case: Case, digest: str) -> Outcome:
    """Return the outcome of a case; errors that hitchopt raises on purpose become rows."""
    from hitchopt.mission.loading import any_problem_from_dict
    from hitchopt.planning import solve

    row: Row = {"digest": digest, "problem": case.name, "seed": case.seed}
    row |= {f"parameter.{key}": value for key, value in case.point.items()}
    files: dict[str, bytes] = {}
    begin = time.process_time()
    try:
        plan = solve(any_problem_from_dict(case.problem), limit=case.limit)
        row |= {"status": PLANNED, "duration": plan.duration}
        row |= {f"check.{check.name}": check.worst for check in plan.certificate.checks}
        row["time.plan"] = time.process_time() - begin
        row |= _done(plan, case, files)
    except HitchoptError as error:
        row |= _refusal(error, "status" not in row)
        row.setdefault("time.plan", time.process_time() - begin)
    row["memory.peak"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    return Outcome(digest, row, files)


def _refusal(error: HitchoptError, of_plan: bool) -> Row:
    """Return what a row says of an error, of the plan or of what is done with it."""
    kinds = {TimeLimitError: LATE, InfeasibleError: INFEASIBLE, InputError: WRONG}
    status = next((word for kind, word in kinds.items() if isinstance(error, kind)), FAILED)
    told: Row = {"message": str(error)}
    if of_plan:
        told["status"] = status
    if isinstance(error, InfeasibleError) and error.violations:
        told["binding"] = error.violations[0].constraint
    return told


def _done(plan: Plan, case: Case, files: dict[str, bytes]) -> Row:
    """Return the columns of what is done with a plan; exported files are added to ``files``."""
    row: Row = {}
    for name, act in (("settle", _settled), ("simulate", _simulated)):
        keys = getattr(case, name)
        if keys is not None:
            begin = time.process_time()
            row |= {f"{name}.{key}": value for key, value in act(plan, keys, case).items()}
            row[f"time.{name}"] = time.process_time() - begin
    if case.export is not None:
        with tempfile.TemporaryDirectory() as place:
            parts = plan.export(str(case.export["format"]), place)
            for path in sorted(p for p in Path(place).rglob("*") if p.is_file()):
                files[path.relative_to(place).as_posix()] = path.read_bytes()
        row["export.position_error"] = max(part.verdict.position.worst for part in parts)
    return row


def _settled(plan: Plan, keys: Section, case: Case) -> Row:  # noqa: ARG001
    """Return figures of where the hitch comes to rest over the plan."""
    from hitchopt.settling.settle import settle
    from hitchopt.settling.tolerance import taut_times

    given: dict[str, Any] = {name: value for name, value in keys.items() if value is not None}
    t = taut_times(plan.motion, given.pop("samples"))
    settled = settle(plan, t, **given)
    return {
        "vertex_error": float(np.max(settled.displacements)),
        "tension_min": float(np.min(settled.tensions)),
        "tension_max": float(np.max(settled.tensions)),
        "slack": ", ".join(settled.slack_cables),
    }


def _simulated(plan: Plan, keys: Section, case: Case) -> Row:
    """Return figures of a simulated flight."""
    from hitchopt.exports.setpoints import write_setpoints
    from hitchopt.exports.vertices import write_vertices
    from hitchopt.simulation.flight_task import read_tables
    from hitchopt.simulation.simulate import simulate

    motion = plan.motion
    with tempfile.TemporaryDirectory() as place:
        setpoints, vertices = Path(place) / "setpoints.csv", Path(place) / "vertices.csv"
        write_setpoints(setpoints, motion, RATE)
        write_vertices(vertices, motion, RATE)
        task = read_tables(setpoints, vertices, motion.team)
    run = simulate(task, _settings(keys, case.seed or 0)).run
    row: Row = {"verdict": run.verdict, "succeeded": run.succeeded}
    if run.failures:
        first = run.failures[0]
        row |= {"failure": first.kind, "failure_time": first.time}
    for name in ("vertex_error", "resting", "moving", "without_sag", "tracking"):
        row |= {f"{name}_{key}": value for key, value in vars(getattr(run, name)).items()}
    return row | {name: getattr(run, name) for name in ("peak_tension", "peak_thrust", "saturated")}


def _settings(keys: Section, seed: int) -> Any:
    """Return the settings of a simulated flight."""
    from dataclasses import replace

    from hitchopt.simulation.simulation_settings import CALM, PRESETS, USUAL, Settings

    given: dict[str, Plain] = {name: value for name, value in keys.items() if value is not None}
    usual = USUAL if given.pop("perturbed") else CALM
    chosen: dict[str, Any] = {name: given.pop(name) for name in vars(usual) if name in given}
    others: dict[str, Any] = {
        "preset": PRESETS[str(given.pop("preset"))],
        "body": given.pop("drones"),
        **given,
    }
    return Settings(perturbations=replace(usual, **chosen), seed=seed, **others)
