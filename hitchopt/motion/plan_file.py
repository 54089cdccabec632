"""plan.npz: a plan as piecewise polynomials, exact to the last bit."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import FileError, InputError
from hitchopt.hitch import Quadrotor, Swarm, Team
from hitchopt.hitch.assignment import Assignment
from hitchopt.motion.motion import JOINT, CableState, Motion, Phase
from hitchopt.requirements import Arena, Limits, Prism, Requirements, Separation
from hitchopt.storage.archive import BROKEN, read_arrays
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import finite, positive

Array = NDArray[np.float64]

FORMAT = "hitchopt-plan/1"

POLYNOMIALS = ("drones", "vertices", "legs", "tensions")
"""Bernstein coefficients (pieces, *shape, degree + 1) under these names, common ``breaks``.

Of a swarm without cables the drones alone; with friction ``leg_tensions`` as well."""

LEG_TENSIONS = "leg_tensions"

PER_ROBOT = ("mass", "max_thrust", "cable_length", "tension")
"""(n,) each, of the team; of a swarm the first two, (N,)."""

SWARM_POLYNOMIALS, PER_DRONE = POLYNOMIALS[:1], PER_ROBOT[:2]

LARGEST = 1e6
"""[m], [N] No coefficient of a plan is larger; sums of such numbers stay far from overflow."""


def write_plan(path: Path, motion: Motion, title: str = "") -> None:
    """Write the plan; the same plan gives the same bytes.

    Raises
    ------
    OSError: the file cannot be written.
    """
    team, arena = motion.team, motion.requirements.arena
    arrays: dict[str, NDArray[Any]] = {
        "mass": np.array([kind.mass for kind in team.quadrotor]),
        "max_thrust": np.array([kind.max_thrust for kind in team.quadrotor]),
        "breaks": motion.drones.breaks,
    }
    if team.has_cables:
        who: dict[str, Any] = {
            "robots": team.robots,
            "topology": team.topology,
            "cable_density": team.cable_density,
            "cable_friction": team.cable_friction,
        }
        arrays |= {"cable_length": team.cable_length, "tension": team.tension}
    else:
        who = {"drones": team.drones}
    for name in POLYNOMIALS if team.has_cables else SWARM_POLYNOMIALS:
        arrays[name] = getattr(motion, name).coefficients
    if motion.leg_tensions is not None:
        arrays[LEG_TENSIONS] = motion.leg_tensions.coefficients
    settings: dict[str, Any] = {
        "title": title,
        "team": who,
        "limits": vars(motion.requirements.limits),
        "separation": vars(motion.requirements.separation),
        "arena": arena and {"lower": arena.lower.tolist(), "upper": arena.upper.tolist()},
        "phases": [vars(phase) for phase in motion.phases],
    }
    if not team.has_cables or motion.requirements.keep_out:
        settings["keep_out"] = [
            {
                "polygon": prism.polygon.vertices.tolist(),
                "lower": prism.lower,
                "upper": prism.upper,
            }
            for prism in motion.requirements.keep_out
        ]
    if motion.assignment is not None:
        settings["assignment"] = motion.assignment.to_dict()
    if LEG_TENSIONS in arrays:
        settings[LEG_TENSIONS] = True
    head = {
        "format": np.array(FORMAT),
        "settings": np.array(json.dumps(settings, allow_nan=False)),
    }
    with path.open("wb") as file:
        np.savez(file, allow_pickle=False, **head, **arrays)


def read_plan(path: Path) -> Motion:
    """Return the plan of a file that hitchopt wrote.

    Raises
    ------
    FileError: it cannot be read, or does not hold a plan.
    """
    try:
        return _motion(*_contents(path))
    except BROKEN as error:
        raise FileError(f"{path}: {_reason(error)}; solve the problem again") from error


def read_title(path: Path) -> str:
    """Return the title of the plan in a file that hitchopt wrote, or an empty one.

    Raises
    ------
    FileError: it cannot be read, or does not hold a plan.
    """
    try:
        return str(_contents(path)[0]["title"])
    except BROKEN as error:
        raise FileError(f"{path}: {_reason(error)}; solve the problem again") from error


def _contents(path: Path) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    head = read_arrays(path, ("format", "settings"))
    if str(head["format"]) != FORMAT:
        raise InputError("format", str(head["format"]), FORMAT, "use a plan that hitchopt wrote")
    settings = json.loads(str(head["settings"]))
    if not isinstance(settings, dict):
        raise InputError("settings", settings, "a mapping", "use a plan that hitchopt wrote")
    swarm = "drones" in settings["team"]
    names = (*PER_DRONE, *SWARM_POLYNOMIALS) if swarm else (*PER_ROBOT, *POLYNOMIALS)
    if settings.get(LEG_TENSIONS) is True:
        names = (*names, LEG_TENSIONS)
    arrays = read_arrays(path, ("breaks", *names))
    for name, array in arrays.items():
        if array.dtype != np.float64:
            raise InputError(name, array.dtype, "of double precision", "do not convert it")
    return settings, arrays


def _motion(settings: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> Motion:
    given = dict(settings["team"])
    kinds = [
        Quadrotor(float(mass), float(max_thrust))
        for mass, max_thrust in zip(arrays["mass"], arrays["max_thrust"], strict=True)
    ]
    names = [name for name in (*POLYNOMIALS, LEG_TENSIONS) if name in arrays]
    for name in names:
        if arrays[name].size and not np.max(np.abs(arrays[name])) <= LARGEST:
            raise InputError(name, "a coefficient", f"within ±{LARGEST:g}", "do not edit them")
    parts = {name: PiecewisePolynomial(arrays["breaks"], arrays[name]) for name in names}
    limits, separation = Limits(**settings["limits"]), Separation(**settings["separation"])
    arena = None if settings["arena"] is None else Arena(**settings["arena"])
    prisms = tuple(Prism(**entry) for entry in settings.get("keep_out", ()))
    requirements = Requirements(limits, separation, arena, prisms)
    alone = "vertices" not in parts
    phases = tuple(_phase(**entry, alone=alone) for entry in settings["phases"])
    motion: Motion
    if not alone:
        robots = given.pop("robots")
        lengths, tensions = arrays["cable_length"], arrays["tension"]
        team = Team(robots, lengths, tension=tensions, quadrotor=kinds, **given)
        given_to = settings.get("assignment")
        motion = Motion(
            team,
            requirements,
            parts["drones"],
            parts["vertices"],
            parts["legs"],
            parts["tensions"],
            phases,
            None if given_to is None else _assignment(**given_to),
            parts.get(LEG_TENSIONS),
        )
    else:
        swarm = Swarm(given["drones"], quadrotor=kinds)
        motion = Motion.single(swarm, requirements, parts["drones"], phases)
    _check_phases(motion)
    return motion


def _assignment(robots: list[int], flipped: list[bool]) -> Assignment:
    for values, kind in ((robots, int), (flipped, bool)):
        if not all(type(value) is kind for value in values):
            raise InputError("assignment", values, f"a list of {kind.__name__}", "do not edit it")
    return Assignment(tuple(robots), tuple(flipped))


def _check_phases(motion: Motion) -> None:
    """Raise InputError unless the phases cover the plan's time, from 0 on, and no more."""
    ends = [0.0, motion.duration]
    found = [[phase.start, phase.end] for phase in motion.phases]
    apart = [float(motion.drones.breaks[0])]
    if found:
        apart += [found[0][0] - ends[0], found[-1][1] - ends[1]]
    if not found or max(map(abs, apart)) > JOINT:
        words = f"one after the other from 0 to {motion.duration:g} s"
        raise InputError("phases", found, words, "do not edit them")


def _phase(
    name: object,
    step: object,
    start: float,
    end: float,
    remark: object = "",
    formed: object = None,
    state: object = None,
    tension: object = None,
    *,
    alone: bool,
) -> Phase:
    """Return a phase as it is stored; files of before have ``formed`` in place of a state.

    Parameters
    ----------
    alone: whether the drones carry no cables.
    """
    if not isinstance(name, str) or isinstance(step, bool) or not isinstance(step, int):
        raise InputError("phases", [name, step], "a name and a step's index", "do not edit them")
    if not isinstance(remark, str):
        raise InputError("phases", remark, "a remark in words", "do not edit them")
    times = finite("phases.start", start), finite("phases.end", end)
    stated = _tension_range(tension)
    if state is None:
        if formed is not None and not isinstance(formed, bool):
            raise InputError("phases", formed, "formed as true or false", "do not edit them")
        known = CableState.of_label(name, formed=formed is not False)
        return Phase(name, step, *times, remark, known, stated)
    allowed = [each for each in CableState if (each is CableState.NONE) is alone]
    if formed is not None or not isinstance(state, str) or state not in allowed:
        words = f"one of {', '.join(allowed)}, without formed"
        raise InputError("phases.state", state, words, "do not edit them")
    return Phase(name, step, *times, remark, CableState(state), stated)


def _tension_range(given: object) -> tuple[float, float] | None:
    """Return a phase's range of tensions [N]; None of a phase that states none."""
    if given is None:
        return None
    if isinstance(given, list) and len(given) == 2:
        least, most = (positive("phases.tension", value) for value in given)
        if least <= most:
            return least, most
    raise InputError("phases.tension", given, "[smallest, largest] or null", "do not edit them")


def _reason(error: BaseException) -> str:
    if isinstance(error, FileNotFoundError):
        return "there is no such file"
    if isinstance(error, KeyError):
        return f"not a plan that hitchopt wrote: {error} is missing"
    if isinstance(error, OSError) and error.strerror:
        return f"cannot be read: {error.strerror}"
    return f"not a plan that hitchopt wrote, or a damaged one: {error or type(error).__name__}"
