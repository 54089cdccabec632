"""Functions of a plan: simulate it, and export it."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from hitchopt.errors import InputError
from hitchopt.plan import Plan, load
from hitchopt.time_limit import Progress
from hitchopt.values import flag, instance, path, text

if TYPE_CHECKING:
    from hitchopt.exports.exporting import Export
    from hitchopt.simulation.simulate import Simulation


def simulate(
    plan: Plan | Path | str,
    *,
    preset: Literal["fast", "accurate"] = "fast",
    perturbed: bool = False,
    perturbations: dict[str, float | bool] | None = None,
    progress: Progress | None = None,
    **settings: Any,
) -> Simulation:
    """Fly a plan's setpoints with simulated ropes in MuJoCo; return the judged flight.

    ``hitchopt simulate`` does the same for a plan's directory, and writes what came of it.

    Parameters
    ----------
    plan: a plan of a team with cables, or the directory that one was saved to.
    preset: ``fast``: whether it holds; ``accurate``: with correct friction, five times slower.
    perturbed: whether there are the usual disturbances of a flight indoors.
    perturbations: fields of ``Perturbations`` that differ from those, such as ``wind`` [N].
    progress: called with what is being done now.
    settings: further fields of ``Settings``: ``body``, ``seed``, ``friction``, ``density``,
        ``stiffness``, ``integral``, ``feed_forward``, ``ground``, ``pull_test``,
        ``feedback``.

    Raises
    ------
    InputError: an argument that is wrong in itself.
    CertificateError: the plan's certificate does not hold.
    UnsupportedError: mujoco is not installed, or single drones.
    """
    from hitchopt.simulation.flight_task import read_task
    from hitchopt.simulation.simulate import simulate as simulated
    from hitchopt.simulation.simulation_settings import CALM, PRESETS, USUAL, Settings

    if text("preset", preset) not in PRESETS:
        raise InputError("preset", preset, " or ".join(PRESETS), "write fast")
    usual = USUAL if flag("perturbed", perturbed) else CALM
    changes = _known("perturbations", {} if perturbations is None else perturbations, vars(usual))
    given = _known("settings", settings, vars(Settings()))
    chosen = Settings(
        **{"preset": PRESETS[preset], "perturbations": replace(usual, **changes), **given}
    )
    if isinstance(plan, str | Path):
        return simulated(read_task(Path(plan)), chosen, progress)
    instance("plan", plan, Plan)
    with tempfile.TemporaryDirectory() as place:
        task = read_task(plan.save(Path(place) / "plan"))
    return simulated(task, chosen, progress)


def export(
    plan: Plan | Path | str, format: str, folder: Path | str, **options: Any
) -> tuple[Export, ...]:
    """Write a plan, or the one in a directory, in a fleet's format; see ``Plan.export``."""
    text("format", format)
    path("folder", folder)
    if isinstance(plan, str | Path):
        plan = load(plan)
    instance("plan", plan, Plan)
    return plan.export(format, folder, **options)


def _known(key: str, given: dict[str, Any], names: dict[str, Any]) -> dict[str, Any]:
    """Return the fields that a user gave, or raise InputError for one that there is not."""
    if not isinstance(given, dict):
        raise InputError(key, given, "a dict", f"use the keys {', '.join(names)}")
    for name in given.keys() - names.keys():
        raise InputError(f"{key}.{name}", given[name], "left out", f"use {', '.join(names)}")
    return given
