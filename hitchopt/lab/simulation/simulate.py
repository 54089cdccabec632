"""Simulate a plan: its setpoints fly with simulated ropes in MuJoCo."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

from hitchopt.errors import InputError, Progress
from hitchopt.lab.simulation.judgement import Simulation
from hitchopt.lab.simulation.judgement import simulate as simulate_task
from hitchopt.lab.simulation.settings import CALM, PRESETS, Settings, settings_of
from hitchopt.lab.simulation.task import Task, read_task
from hitchopt.plan import Plan
from hitchopt.values import check_instance, closest_word, flag, text


def simulate(
    plan: Plan | Path | str,
    *,
    preset: Literal["fast", "accurate"] = "fast",
    perturbed: bool = False,
    perturbations: dict[str, float | bool] | None = None,
    progress: Progress | None = None,
    **settings: Any,
) -> Simulation:
    """Fly a plan with simulated ropes in MuJoCo; return the flight with its results.

    The flight has what the plan states: cables, drones, and their controller with the filter and
    files that are exported for it, unless settings replace them.

    Parameters
    ----------
    plan: a plan with cables, or the directory of a saved one. The hitches of several teams fly in
        one world; single drones and drones of other plans follow their setpoints exactly.
    preset: ``fast``: links of 30 mm, which show whether the hitch holds; ``accurate``: of 10 mm,
        five times slower, with correct friction, to measure vertices.
    perturbed: whether to add the usual disturbances of an indoor flight.
    perturbations: fields of ``Perturbations`` with other values, such as ``wind`` [N].
    progress: status callback.
    settings: further fields of ``Settings``: ``seed``, ``friction``, ``density``, ``stiffness``,
        ``pull_test``, ``feedback``; ``controller`` by name or ``ideal``, ``gains``, ``upload`` and
        an ``estimator``: ``ideal``, ``crazyflie``, ``firmware``, ``one_marker``.

    Raises
    ------
    InputError: an argument is invalid.
    CertificateError: the plan's certificate does not hold.
    UnsupportedError: mujoco is not installed, the plan has only single drones, or several teams and
        feedback.
    """
    if text("preset", preset) not in PRESETS:
        raise InputError("preset", preset, " or ".join(PRESETS), "write fast")
    changes = {} if perturbations is None else perturbations
    _check_names("perturbations", changes, vars(CALM))
    _check_names("settings", settings, vars(Settings()))
    is_perturbed = flag("perturbed", perturbed)
    options = settings_of(preset, perturbed=is_perturbed, **settings, **changes)
    if isinstance(plan, str | Path):
        return simulate_task(read_task(Path(plan)), options, progress)
    check_instance("plan", plan, Plan)
    plan.certificate.raise_if_violated()
    return simulate_task(Task.of(plan.motion), options, progress)


def _check_names(key: str, options: dict[str, Any], names: dict[str, Any]) -> None:
    """Raise InputError unless the options are a dict of known names."""
    if not isinstance(options, dict):
        raise InputError(key, options, "a dict", f"use the keys {', '.join(names)}")
    for name in options.keys() - names.keys():
        remedy = closest_word(str(name), [*names])
        raise InputError(f"{key}.{name}", options[name], "left out", remedy)
