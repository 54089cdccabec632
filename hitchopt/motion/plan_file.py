"""Plan files, plan.npz: piecewise polynomials, exact to the last bit, and their records.

Polynomials are Bernstein coefficients (pieces, *shape, degree + 1) over ``breaks``, in a folder for
each team and each external plan. Everything else is JSON in ``settings``: the records of motions
by the names of their fields, and the problem, which states what was requested: its text, and the
same as data, ``request``, for readers without YAML.
Constructors validate what is read like arguments of a user.
"""

from __future__ import annotations

import hashlib
import json
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from hitchopt.errors import FileError, InputError, UnitWarning
from hitchopt.hitch import Team
from hitchopt.hitch.requirements import Requirements
from hitchopt.hitch.team import Assignment
from hitchopt.motion.flight import Flight, TeamMotion
from hitchopt.motion.motion import CURVES, JOINT, WAIT, Motion, Phase
from hitchopt.motion.request import PLANNER_ONLY, REMEDY, check_same, decoded, encoded, objects_at
from hitchopt.motion.retiming import shifted
from hitchopt.motion.stated_rules import StatedRule
from hitchopt.objects.placing import REST_DRIFT, check_overlaps, poses_of
from hitchopt.storage.archive import PLAN, READ_ERRORS, read_arrays
from hitchopt.storage.files import DIAGNOSIS, PREVIOUS, digest
from hitchopt.storage.yaml_file import parse_yaml
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Indices, line, text

FORMAT = "hitchopt-flight/1"

GROUPS = "groups"  # Key of the settings, and folder of the arrays, of teams
OTHERS = "others"  # Key of the settings, and folder of the arrays, of external plans
RULES = "rules"  # Key of the settings of custom rules, which plans without them omit

MAX_COEFFICIENT = 1e5
"""[m], [N] Largest coefficient of a plan: sums of such numbers stay far from overflow."""

MAX_DEGREE = 60  # Largest degree of a plan's curves
MAX_STEPS = 2**31  # Upper bound of a step's index, exclusive
TOLERANCE = 1e-9  # Largest difference of the curves of an external plan from those of its own file


class Records(NamedTuple):
    """The records of one team's motion, robots in the order of the problem."""

    team: Team
    requirements: Requirements
    phases: tuple[Phase, ...]
    assignment: Assignment | None


class SavedPlan(NamedTuple):
    """Contents of a plan file: the flight, its title, and the text of its problem if known.

    ``stated_rules`` are the custom rules that were certified when it was saved.
    """

    flight: Flight
    title: str = ""
    problem: str = ""
    stated_rules: tuple[StatedRule, ...] = ()


def write_plan(
    path: Path,
    flight: Flight,
    title: str = "",
    problem: str = "",
    stated_rules: tuple[StatedRule, ...] = (),
) -> None:
    """Write a plan, with the text of its problem file if known, to a new file or over an old one.

    The same plan gives the same bytes. Raises OSError if the file cannot be written.
    """
    saved = SavedPlan(flight, title, problem, stated_rules)
    settings = json.dumps(_settings(saved), allow_nan=False)
    arrays = {"format": np.array(FORMAT), "settings": np.array(settings)}
    for folder, teams in ((GROUPS, flight.teams), (OTHERS, flight.others)):
        for index, flown in enumerate(teams):
            for name, array in _arrays(flown.motion).items():
                arrays[f"{folder}/{index}/{name}"] = array
    with path.open("wb") as file:
        np.savez(file, allow_pickle=False, **arrays)


def _settings(saved: SavedPlan) -> dict[str, Any]:
    """Return everything but arrays, as JSON values."""
    data = parse_yaml(saved.problem, "problem") if saved.problem else None
    settings = {
        "title": saved.title,
        "problem": saved.problem,
        "request": data if isinstance(data, dict) else None,
        GROUPS: [_head(flown) for flown in saved.flight.teams],
        OTHERS: [_head(flown) for flown in saved.flight.others],
    }
    if saved.stated_rules:
        settings[RULES] = encoded(saved.stated_rules)
    return settings


_DIGESTS: WeakKeyDictionary[Motion, bytes] = WeakKeyDictionary()
"""Digests of motions that this process has computed."""


def flight_digest(flight: Flight) -> str:
    """Return the SHA-256 of the curves and records of a flight, as plan files store them."""
    found = hashlib.sha256()
    for folder, teams in ((GROUPS, flight.teams), (OTHERS, flight.others)):
        for flown in teams:
            found.update(json.dumps([folder, flown.name, flown.plan, flown.digest]).encode())
            found.update(_motion_digest(flown.motion))
    return found.hexdigest()


def _motion_digest(motion: Motion) -> bytes:
    """Return the SHA-256 of the curves and records of a motion, computed only once."""
    if motion not in _DIGESTS:
        found = hashlib.sha256(json.dumps(_records(motion)).encode())
        for name, array in _arrays(motion).items():
            found.update(f"{name}{array.shape}".encode())
            found.update(array.tobytes())
        _DIGESTS[motion] = found.digest()
    return _DIGESTS[motion]


def _head(flown: TeamMotion) -> dict[str, Any]:
    """Return a team, or one of an external plan, without its arrays, as JSON values."""
    records = _records(flown.motion)
    return {"name": flown.name, "plan": flown.plan, "digest": flown.digest, "records": records}


def _records(motion: Motion) -> dict[str, Any]:
    """Return the records of a motion as JSON values."""
    requirements = replace(motion.requirements, objects=objects_at(motion))
    phases = with_cables(motion.phases, motion.team.labels)
    records: dict[str, Any] = encoded(
        Records(motion.team.of_problem, requirements, phases, motion.assignment)
    )
    for name in PLANNER_ONLY:
        del records["requirements"][name]
    return records


def _arrays(motion: Motion) -> dict[str, NDArray[np.float64]]:
    """Return the arrays of one team's motion, drones and robots in the order of the problem."""
    names = CURVES
    curves = {name: getattr(motion, name).coefficients for name in names}
    if motion.team.assignment is not None:
        curves |= in_order(curves, motion.team.listed, motion.team.edges)
    return {"breaks": motion.drones.breaks, **curves}


OF_DRONES = ("drones", "legs", "leg_tensions", "contacts")
"""Arrays of a row for every drone: of itself, of its leg, or of its end of an edge."""


def in_order(
    curves: Mapping[str, NDArray[np.float64]], drones: Indices, robots: Indices
) -> dict[str, NDArray[np.float64]]:
    """Return the arrays of drones and cables with their rows in another order."""
    ordered = {"tensions": curves["tensions"][:, robots]}
    for name in OF_DRONES:
        array = curves.get(name)
        if array is not None:
            rows = array.reshape(len(array), len(drones), -1)
            ordered[name] = rows[:, drones].reshape(array.shape)
    return ordered


def with_cables(phases: Iterable[Phase], numbers: Sequence[int]) -> tuple[Phase, ...]:
    """Return phases whose holds name each cable by another number, in order of the present ones."""

    def renamed(phase: Phase) -> Phase:
        if phase.hold is None:
            return phase
        cables = tuple(int(numbers[cable]) for cable in phase.hold.cables)
        return replace(phase, hold=replace(phase.hold, cables=cables))

    return tuple(map(renamed, phases))


def read_plan(path: Path) -> Flight:
    """Return the plan of a file that hitchopt wrote; errors are those of ``read_saved_plan``."""
    return read_saved_plan(path).flight


def saved_others(name: str, path: Path, plan: str, at: float) -> tuple[TeamMotion, ...]:
    """Return the teams of a plan file as those of an external plan that starts at ``at`` [s].

    They are named ``name``, or ``name.a``, ``name.b`` for several teams; ``plan`` is the path as
    written. External plans of that plan are omitted. Errors are those of ``read_saved_plan``.
    """
    return tuple(
        TeamMotion(
            ".".join(filter(None, (name, flown.name))),
            shifted(flown.motion, at),
            digest(path),
            plan,
        )
        for flown in read_plan(path).teams
    )


def is_of(other: TeamMotion, path: Path) -> bool:
    """Return whether a plan file contains an external plan, as ``saved_others`` reads it."""
    try:
        at = float(other.motion.drones.breaks[0])
        teams = saved_others(other.name.partition(".")[0], path, other.plan, at)
        saved = next(flown for flown in teams if flown.name == other.name)
        check_same("", _head(saved), _head(other), "as in its plan")
    except (FileError, InputError, StopIteration):
        return False
    arrays = _arrays(other.motion)
    return all(
        arrays[name].shape == saved_array.shape
        and np.allclose(arrays[name], saved_array, rtol=0.0, atol=TOLERANCE)
        for name, saved_array in _arrays(saved.motion).items()
    )


def read_saved_plan(path: Path) -> SavedPlan:
    """Return the contents of a plan file.

    Raises FileError if it cannot be read, is not a plan, or is one of another format.
    """
    try:
        version = str(read_arrays(path, ["format"])["format"])
        if version == FORMAT:
            return _saved_plan(path)
    except READ_ERRORS as error:
        if isinstance(error, FileError) and str(error).startswith(f"{path}: "):
            raise
        reason = f"not a plan that hitchopt wrote, or a damaged one: {error or repr(error)}"
        if isinstance(error, FileNotFoundError | NotADirectoryError):
            words = f"{path}: there is no such file" if path.name != PLAN else ""
            words = words or f'No plan in "{path.parent}"'
            remedy = "name a directory that hitchopt solve -o wrote"
            if path.name == PLAN and (path.parent / DIAGNOSIS).is_file():
                words = f'No plan in "{path.parent}", where hitchopt solve was refused'
                remedy = f"{path.parent / DIAGNOSIS} says why"
            if path.name == PLAN and (path.parent / PREVIOUS / PLAN).is_file():
                last = f"the last certified plan is in {path.parent / PREVIOUS}"
                remedy = f"{remedy}; {last}" if "refused" in words else last
            raise FileError(f"{words}: {remedy}.") from None
        if isinstance(error, KeyError):
            reason = f"not a plan that hitchopt wrote: {error} is missing"
        elif isinstance(error, OSError) and error.strerror:
            reason = f"cannot be read: {error.strerror}"
        reason = " ".join(reason.split())  # arrays are printed over several lines
        raise FileError(f"{path}: {reason}; solve the problem again") from error
    raise FileError(f"{path}: its format is {version!r:.60}, not {FORMAT}; solve the problem again")


def _saved_plan(path: Path) -> SavedPlan:
    """Return the contents of a file of this format; READ_ERRORS if it is damaged."""
    settings = json.loads(str(read_arrays(path, ["settings"])["settings"]))
    if not isinstance(settings, dict):
        raise InputError("settings", settings, "a mapping", "use a plan that hitchopt wrote")
    teams = _team_motions(path, GROUPS, settings[GROUPS])
    others = _team_motions(path, OTHERS, settings[OTHERS])
    _check_teams(teams)
    saved = SavedPlan(
        Flight(teams, others),
        title=line("title", settings["title"]),
        problem=text("problem", settings["problem"]),
        stated_rules=decoded(tuple[StatedRule, ...], settings.get(RULES, [])),
    )
    check_same("", _settings(saved), settings, "as plans are written")
    return saved


def _team_motions(
    path: Path, key: str, heads: Sequence[Mapping[str, Any]]
) -> tuple[TeamMotion, ...]:
    """Return teams, or those of external plans, from their heads and arrays."""
    return tuple([_team_motion(path, key, index, head) for index, head in enumerate(heads)])


def _team_motion(path: Path, key: str, index: int, head: Mapping[str, Any]) -> TeamMotion:
    """Return a team, or one of an external plan, from its head and its arrays."""
    names = ["breaks", *CURVES]
    stored = read_arrays(path, [f"{key}/{index}/{label}" for label in names])
    arrays = dict(zip(names, stored.values(), strict=True))
    name = line("name", head["name"])
    try:
        for label, array in arrays.items():
            if array.dtype != np.float64:
                raise InputError(label, array.dtype, "of double precision", "do not convert it")
        curves = {label: array for label, array in arrays.items() if label != "breaks"}
        for label, array in curves.items():
            _check_coefficients(label, array)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UnitWarning)  # said of the problem, under its keys
            team, requirements, phases, assignment = decoded(Records, head["records"])
        if assignment is not None:
            team = assignment.team(team)
            curves |= in_order(curves, assignment.drones, np.array(assignment.robots))
            phases = with_cables(phases, team.edges.tolist())
        polynomials: dict[str, Any] = {
            label: PiecewisePolynomial(arrays["breaks"], array) for label, array in curves.items()
        }
        motion = Motion(team, requirements, phases=phases, **polynomials)
        first = float(motion.drones.breaks[0])
        if key == GROUPS and first != 0.0:
            raise InputError("breaks", first, "rising from 0", REMEDY)
        _check_phases(motion)
        objects = motion.requirements.objects
        poses = motion.poses.coefficients[0, ..., 0]
        if np.max(np.abs(poses - poses_of(objects)), initial=0.0) > REST_DRIFT:
            raise InputError("poses", poses.tolist(), "where the objects stand", REMEDY)
        check_overlaps(objects)
    except InputError as error:
        raise error.within(f"{key}.{name}" if name else key) from error
    file_digest = line("digest", head["digest"])
    plan = line("plan", head["plan"])
    if key == OTHERS:
        return TeamMotion(name, motion, file_digest, plan)
    return TeamMotion(name, motion)


def _check_coefficients(name: str, curve: NDArray[np.float64]) -> None:
    """Raise InputError for a curve of too large a degree, or with coefficients that are."""
    if curve.size and not np.max(np.abs(curve)) <= MAX_COEFFICIENT:
        raise InputError(name, "a coefficient", f"within ±{MAX_COEFFICIENT:g}", REMEDY)
    degree = curve.shape[-1] - 1
    if degree > MAX_DEGREE:
        raise InputError(name, f"of degree {degree}", f"at most {MAX_DEGREE}", REMEDY)


def _check_teams(teams: Sequence[TeamMotion]) -> None:
    """Raise InputError unless teams end together, and nothing moves in phases named WAIT."""
    duration = teams[0].motion.duration
    for flown in teams:
        end = flown.motion.duration
        if abs(end - duration) > JOINT:
            bound = f"up to {duration:g} s, as for all teams"
            raise InputError(f"{flown.name}.breaks", end, bound, REMEDY)
        _check_waits(flown)


def _check_waits(flown: TeamMotion) -> None:
    """Raise InputError if anything moves in a phase named WAIT."""
    motion = flown.motion
    for index, phase in enumerate(motion.phases):
        pieces = motion.phase_of_piece == index
        if phase.name != WAIT or not np.any(pieces):
            continue
        for name in CURVES:
            curve = getattr(motion, name).coefficients[pieces]
            if np.max(np.ptp(curve, axis=(0, -1)), initial=0.0) > REST_DRIFT:
                key = flown.label(f"phases[{index}].name")
                raise InputError(key, WAIT, "of a phase of rest", REMEDY)


def _check_phases(motion: Motion) -> None:
    """Raise InputError for phases with invalid times or ranges, or holds of missing objects.

    The motion has verified that they are contiguous and cover the pieces.
    """
    spans = [[phase.start, phase.end] for phase in motion.phases]
    first, last = motion.drones.breaks[[0, -1]].tolist()
    if not spans or max(abs(spans[0][0] - first), abs(spans[-1][1] - last)) > JOINT:
        words = f"one after the other from {first:g} to {last:g} s"
        raise InputError("phases", spans, words, REMEDY)
    objects = motion.requirements.objects
    cables = range(motion.team.robots)
    for phase in motion.phases:
        if not 0 <= phase.step < MAX_STEPS:
            raise InputError("phases.step", phase.step, "an index of a step", REMEDY)
        low, high = phase.tension or (1.0, 1.0)
        if not 0.0 < low <= high < np.inf:
            words = "a smallest and a largest tension, or null"
            raise InputError("phases.tension", phase.tension, words, REMEDY)
        hold = phase.hold
        if hold and not (hold.object in objects and set(hold.cables) <= set(cables)):
            bound = f"an object of {sorted(objects)} and cables from 0 to {len(cables) - 1}"
            raise InputError("phases.hold", vars(hold), bound, REMEDY)
