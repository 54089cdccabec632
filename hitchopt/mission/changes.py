"""Changes of a problem that may make it feasible: knobs, and edits of the problem's file.

A knob is a number of the problem that can be raised or lowered.
"""

from __future__ import annotations

import contextlib
import math
import re
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from hitchopt.checks.registry import RULE_OF_KEY, distances_of
from hitchopt.drones.controllers import (
    MIN_TRACKING,
    Gains,
    Tube,
    of_same_firmware,
    stiffest_gains,
)
from hitchopt.errors import InfeasibleError, InputError, OneLine, UnitWarning, Violation
from hitchopt.geometry import Outline
from hitchopt.hitch import GRAVITY, Quadrotor
from hitchopt.hitch.requirements import Limits
from hitchopt.mission.problem import DronesStart, HitchStart, Problem
from hitchopt.objects import Rim
from hitchopt.planners.ends import RolledLegs
from hitchopt.steps.hitch_step import ShapeStep
from hitchopt.steps.step import (
    DECIMALS,
    PLAN_DURATION,
    Edit,
    Edits,
    Knob,
    altitude_knobs,
    checks_relaxed_by,
    scaled_outline_edit,
    scaled_points,
)
from hitchopt.storage.yaml_file import split_key, with_value
from hitchopt.values import Array
from hitchopt.values.fields import Key, keys_of, with_fields

DIGITS = 3  # Number of significant digits of a suggested value


@dataclass(frozen=True, eq=False)
class Change(OneLine):
    """Change of one quantity of a problem.

    Attributes
    ----------
    key, words: path of the quantity in the problem file; its description if the path is not enough.
    old, new, unit: old and new value [unit]; the unit is ``times`` for a factor, empty for words.
    relative: signed size of the change relative to the quantity; 0 for words.
    is_factor: whether the quantity is positive, so that sizes are compared as factors.
    problem, edits: problem with the change; edits of the problem's file.
    before: change that is made before it; ``edits`` then has the edits of both.
    covers: constraints that a larger change may repair.
    """

    key: str
    words: str
    old: float | str
    new: float | str
    unit: str
    relative: float
    problem: Problem
    edits: Edits
    before: Change | None = None
    covers: frozenset[str] = frozenset()
    is_factor: bool = True

    def __str__(self) -> str:
        return f"{self.before} and {self._words}" if self.before else self._words

    def after(self, before: Change) -> Change:
        """Return this change, of a problem changed by ``before``, combined with ``before``.

        Changes of the same quantity are merged, and omitted where the last undoes the others.
        """
        merged = dict[str, Change]()
        for each in (*before.together(), *self.together()):
            first = merged.pop(each.key, None)
            merged[each.key] = each if first is None else _merged(first, each)
        chain: Change | None = None
        for each in merged.values():
            if each.old != each.new:
                chain = replace(each, before=chain)
        edits = _last_of_each_key(before.edits + self.edits)
        return replace(chain or self, problem=self.problem, edits=edits, covers=self.covers)

    def together(self) -> list[Change]:
        """Return all changes in order."""
        return [*(self.before.together() if self.before else ()), self]

    @property
    def size(self) -> float:
        """Size of the largest of all changes, comparable between quantities (``size_of``)."""
        return max(size_of(each.relative, is_factor=each.is_factor) for each in self.together())

    def to_dict(self) -> dict[str, object]:
        """Return the change as plain values, for JSON."""
        hidden = {"problem", "words", "before", "covers", "is_factor"}
        plain = {k: v for k, v in vars(self).items() if k not in hidden}
        plain["edits"] = [vars(edit) for edit in self.edits]
        return plain | ({"before": self.before.to_dict()} if self.before else {})

    @property
    def _words(self) -> str:
        unit = f" {self.unit}" if self.unit else ""
        values = [v if isinstance(v, str) else f"{v:.6g}" for v in (self.old, self.new)]
        change = f"{self.key} {values[0]} -> {values[1]}{unit}"
        if not self.relative:
            return change
        words, percent = f"{self.words}, " if self.words else "", 100.0 * self.relative
        share = f"{percent:+.3g}" if abs(percent) < 999.5 else f"{percent:+.0f}"
        return f"{change} ({words}{share} %)"


def _merged(first: Change, second: Change) -> Change:
    """Return one change of a quantity in place of two after each other."""
    old, middle, new = first.old, first.new, second.new
    if isinstance(old, str) or isinstance(middle, str) or isinstance(new, str):
        return replace(second, old=old)
    new = middle * new if second.unit == "times" else new
    relative = first.relative * (new - old) / (middle - old)
    return replace(second, old=old, new=new, relative=relative)


def _last_of_each_key(edits: Edits) -> Edits:
    """Return the edits that no later edit of the same key replaces."""
    keys = [edit.key for edit in edits]
    return tuple(edit for i, edit in enumerate(edits) if edit.key not in keys[i + 1 :])


def size_of(relative: float, *, is_factor: bool) -> float:
    """Return the size of a relative change; half and twice as much of a factor are the same."""
    return abs(math.log1p(relative)) if is_factor else abs(relative)


def change_of(problem: Problem, knob: Knob, size: float) -> Change | None:
    """Return a change of a relative size, rounded away from the old value; None if invalid."""
    extent = knob.extent or knob.old
    value = knob.old + knob.sign * size * extent
    step = 10.0 ** (math.floor(math.log10(knob.extent or abs(value))) + 1 - DIGITS)
    steps = value / step  # the margin of 1e-9 keeps values that are already rounded
    rounded = math.ceil(steps - 1e-9) if knob.sign > 0 else math.floor(steps + 1e-9)
    new = float(f"{rounded * step:.12g}")
    edits = knob.edits(new)
    try:
        changed = with_edits(problem, edits)
    except InputError:
        return None
    quantity = knob.key, knob.words, knob.old, new, knob.unit
    relative, is_factor = (new - knob.old) / extent, knob.extent is None
    return Change(*quantity, relative, changed, edits, covers=knob.covers, is_factor=is_factor)


def with_edits(problem: Problem, edits: Edits) -> Problem:
    """Return the problem with edits of its file, or raise InputError."""
    names = ("team", "start", "mission", "arena", "limits", "objects")
    parts = {name: getattr(problem, name) for name in names}
    for edit in edits:
        name, *path = re.findall(r"[^.\[\]]+", edit.key)
        if name == "start":
            del path[0]  # the kind of start
        elif name == "mission":
            del path[1]
        if path:
            parts[name] = _with_value(parts[name], path, edit.value)
        else:
            parts[name] = keys_of(Problem)[name].from_file(name, edit.value)
    return replace(problem, **parts)


def with_edits_in(text: str, edits: Edits) -> str:
    """Return the text of a problem file with edits; all else stays, including comments."""
    for edit in edits:
        text = with_value(text, split_key(edit.key), edit.value)  # type: ignore[arg-type]
    return text


def _with_value(record: Any, path: Sequence[str], value: Any) -> Any:
    """Return a record with the value at a path of file keys."""
    key, *rest = path
    if isinstance(record, tuple):
        i = int(key)
        return (*record[:i], _with_value(record[i], rest, value), *record[i + 1 :])
    if isinstance(record, Mapping):  # objects by name
        return {**record, key: _with_value(record[key], rest, value)}
    keys = {each.name: (name, each) for name, each in keys_of(type(record)).items()}
    name, declared = keys.get(key, (key, None))
    if rest:
        value = _with_value(getattr(record, name), rest, value)
    elif declared is not None:
        value = declared.from_file(key, value)
    return replace(record, **{name: value})


def broken_constraints(error: InfeasibleError) -> frozenset[str]:
    """Return the names of all violated constraints."""
    return frozenset(map(constraint_name, error.violations))


def constraint_name(violation: Violation) -> str:
    """Return the name of the constraint; PLAN_DURATION for the duration of the whole plan."""
    is_plan_duration = (violation.constraint, violation.sense) == ("duration", "max")
    return PLAN_DURATION if is_plan_duration else violation.constraint


def _min_size(violations: Iterable[Violation], name: str) -> float:
    """Return the minimum relative increase of a limit, or of a step's duration."""
    pairs = [(v.value, v.limit) for v in violations if constraint_name(v) == name]
    if name == "duration":
        pairs = [(limit, value) for value, limit in pairs]
    sizes = (larger / smaller - 1.0 for larger, smaller in pairs if smaller > 0.0)
    return max(filter(math.isfinite, sizes), default=0.0)


# Knobs and their changes.

# Constraints that longer cables may repair
SPACE_CHECKS = checks_relaxed_by("length") | {"tracking_radius"}
TIME_CHECKS = checks_relaxed_by("time")  # Constraints that slower motion may repair
FORCE_CHECKS = checks_relaxed_by("tension")  # Constraints that another tension may repair

DURATION_CHECKS = frozenset({"duration", PLAN_DURATION})
"""Constraints that a faster plan or more time repairs."""

DISTANCE_CHECKS = frozenset(rule.name for rule in distances_of("drones", "cables")) | {
    "tracking_radius",
    "survivable",
}
"""Constraints that more distance repairs."""

LOAD_CHECKS = frozenset({"load"})
"""Constraints that a higher tension or a lighter object repairs."""

GRIP_CHECKS = frozenset({"grip"})
"""Constraints that a higher tension or a rougher object repairs."""

MAX_FRICTION = 1.0
"""Maximum coefficient of friction of suggestions."""

WEIGHT_SHARE = 0.4
"""Tension of two cables that hold an object, over its weight divided by its friction."""

MAX_TILT_DEG = 80.0
"""Maximum tilt of suggestions [deg]."""

LOAD_SHARE = 0.95
"""First mass to try, as a fraction of the maximum mass at rest, since carrying adds forces."""


def knobs_of(problem: Problem, violations: Sequence[Violation]) -> Iterator[Knob]:
    """Yield the knobs of a problem; safety distances are never changed."""
    yield from _start_knobs(problem)
    yield from _team_knobs(problem, violations)
    yield from _object_knobs(problem, violations)
    for name, limit in keys_of(Limits).items():
        key = f"limits.{limit.name}"
        value, rule = getattr(problem.limits, name), RULE_OF_KEY.get(key)
        if value is None or rule is None:
            continue
        old, check = limit.to_file(value), PLAN_DURATION if name == "duration" else rule.name
        covers = frozenset({check}) | (DURATION_CHECKS if rule.derivative else frozenset())
        knob = Knob(key, old, rule.unit, covers=covers)
        max_size = MAX_TILT_DEG / old - 1.0 if name == "tilt" else math.inf
        if rule.sense == "min":
            yield replace(knob, sign=-1)
        elif max_size > 0.0:
            yield replace(knob, min_size=_min_size(violations, check), max_size=max_size)
    names = _names(violations)
    for i, step in enumerate(problem.mission):
        slowdown = _min_size((v for v in violations if f"step {i} " in v.when), "duration")
        for knob in step.knobs():

            def make_edits(new: float, i: int = i, knob: Knob = knob) -> Edits:
                return _in_step(problem, i, knob.edits(new))

            key = f"mission[{i}].{step.name}.{knob.key}"
            min_size = slowdown if "duration" in knob.covers else 0.0
            increase = step.least_increase(
                knob, problem.objects, names, problem.requirements.separation
            )
            min_size = max(min_size, increase)
            if "hinge" in knob.covers:
                lacking = (v.limit - v.value for v in violations if v.constraint == "hinge")
                min_size = max(0.0, *lacking, 0.0) / knob.old
            yield replace(knob, key=key, make_edits=make_edits, min_size=min_size)
    yield from _wall_knobs(problem, violations)


def _start_knobs(problem: Problem) -> Iterator[Knob]:
    """Yield the knobs of the start: a hitch's altitude, or distances of robots and of pairs."""
    start = problem.start
    if isinstance(start, HitchStart):
        yield from altitude_knobs("start.hitch.altitude", start.altitude)
    if not isinstance(start, DronesStart):
        return
    middles, arms = 0.5 * (start.q + start.r)[:, :2], 0.5 * (start.r - start.q)[:, :2]

    def scale(middle_factor: float, arm_factor: float) -> Edits:
        """Return the edits that scale the middles of robots, and the arms to their drones."""
        centres = scaled_points(middles, middle_factor, np.mean(middles, axis=0))
        edits = []
        for name, sign in (("q", -1.0), ("r", 1.0)):
            level = np.round(centres + sign * arm_factor * arms, DECIMALS)
            places = np.column_stack([level, getattr(start, name)[:, 2]])
            edits.append(Edit(f"start.drones.{name}", places.tolist()))
        return tuple(edits)

    key, span = "start.drones", frozenset({"span"}) | _hanging_checks(problem)
    robots, pairs = "robots from their middle", "two drones of a robot"
    yield Knob(key, 1.0, "times", lambda factor: scale(factor, 1.0), 1, DISTANCE_CHECKS, robots)
    arms_only = partial(scale, 1.0)
    yield Knob(key, 1.0, "times", arms_only, 1, DISTANCE_CHECKS, pairs)
    yield Knob(key, 1.0, "times", arms_only, -1, span, pairs)


def _hanging_checks(problem: Problem) -> frozenset[str]:
    """Return the constraints of cables that hang between drones at the start, if shallow."""
    hangs = isinstance(problem.start, DronesStart) and np.any(problem.team.cable_density > 0.0)
    return FORCE_CHECKS if hangs else frozenset()


def _team_knobs(problem: Problem, violations: Sequence[Violation]) -> Iterator[Knob]:
    """Yield the knobs of cables, outlines and forces."""
    tension = _team_values(problem, "tension", "N")
    length = replace(_team_values(problem, "cable_length", "m"), words="all cables")
    yield replace(length, covers=SPACE_CHECKS | _hanging_checks(problem))
    yield replace(length, sign=-1, covers=DISTANCE_CHECKS | {"arena"})
    scale = partial(scaled_outlines, problem)
    polygons = Knob("polygon", 1.0, "times", scale, 1, DISTANCE_CHECKS, "scale of all polygons")
    covers = SPACE_CHECKS | TIME_CHECKS | DURATION_CHECKS | {"arena"}
    yield replace(polygons, sign=-1, covers=covers)
    yield polygons
    held_by = two_cable_tension(problem) / float(np.max(problem.team.tension))
    yield replace(tension, sign=-1, covers=FORCE_CHECKS, max_size=max(0.0, 1.0 - held_by))
    holding = LOAD_CHECKS | GRIP_CHECKS
    min_size = max(_min_size(violations, "load"), held_by - 1.0)
    yield replace(tension, covers=holding, min_size=min_size)
    if np.any(problem.team.load > 0.0):
        covers = LOAD_CHECKS | FORCE_CHECKS | DISTANCE_CHECKS
        yield replace(_team_values(problem, "load", "kg"), sign=-1, covers=covers)
    thrust = _team_values(problem, "max_thrust", "N")
    key = "team.quadrotor.max_thrust" if thrust.unit == "N" else "team.quadrotor"
    yield replace(thrust, key=key, covers=DURATION_CHECKS | {"thrust"})


def two_cable_tension(problem: Problem) -> float:
    """Return the tension [N] that two cables need to hold the objects of the mission; 0 if none.

    It is that of docs/how_to/carry.md, with which objects hang safely in simulation.
    """
    handled = {vars(step).get("object", vars(step).get("around")) for step in problem.mission}
    bodies = [body for name, body in problem.objects.items() if name in handled and not body.fixed]
    if problem.team.robots != 2:
        return 0.0
    needed = (WEIGHT_SHARE * GRAVITY * x.mass / x.friction for x in bodies if x.friction > 0.0)
    return max(needed, default=0.0)


def _team_values(problem: Problem, name: str, unit: str) -> Knob:
    """Return the knob of the team's values: their common value, or a factor of all."""
    team = problem.team
    values: Array = getattr(team, name)
    if name == "max_thrust":
        values = np.array([kind.max_thrust for kind in team.quadrotor])
    are_equal = bool(np.ptp(values) == 0.0)
    ratios = np.ones(len(values)) if are_equal else values
    old, words = (float(values[0]), "") if are_equal else (1.0, f"every {name}")

    def make_edits(new: float) -> Edits:
        return (team_edit(problem, name, new * ratios),)

    return Knob(f"team.{name}", old, unit if are_equal else "times", make_edits, words=words)


def team_edit(problem: Problem, name: str, values: Array) -> Edit:
    """Return the edit of a team's values: one value if all are equal."""
    rounded: list[Any] = [round(float(value), DECIMALS) for value in values]
    if name == "max_thrust":
        name, kinds = "quadrotor", problem.team.quadrotor
        thrusts = zip(kinds, rounded, strict=True)
        rounded = [_quadrotor_keys(kind) | {"max_thrust": x} for kind, x in thrusts]
    are_equal = all(value == rounded[0] for value in rounded)
    return Edit(f"team.{name}", rounded[0] if are_equal else rounded)


def _quadrotor_keys(kind: Quadrotor) -> dict[str, Any]:
    """Return a quadrotor's values by key: mass, thrust and all that differs from the default."""
    required, defaults = ("mass", "max_thrust"), vars(Quadrotor())
    values = {key: v for key, v in vars(kind).items() if key in required or v != defaults[key]}
    if kind.gains is not None:
        gains = {key: pair for key, pair in vars(kind.gains).items() if pair is not None}
        values["gains"] = {
            key: level if level == upright else [level, upright]
            for key, (level, upright) in gains.items()
        }
    if kind.trim is not None:
        values["trim"] = list(kind.trim)
    if isinstance(kind.tracking, Tube):
        values["tracking"] = vars(kind.tracking)
    return values


def unit_change(problem: Problem) -> Change | None:
    """Return the change of all values that seem to be in another unit; None without any."""
    combined: Change | None = None
    changed = problem
    for place, record in _records(problem):
        for name, declared in keys_of(type(record)).items():
            value = _plain_numbers(declared.to_file(getattr(record, name)))
            key = f"{place}.{declared.name}"
            factor = None if value is None else _unit_factor(declared, key, value)
            if factor is None:
                continue
            converted = np.round(np.multiply(value, factor), DECIMALS).tolist()
            edits = (Edit(key, converted),)
            changed = with_edits(changed, edits)
            is_number = isinstance(value, float)
            old = value if is_number else "as given"
            new = converted if is_number else f"multiplied by {factor:g}"
            unit = declared.file_kind.unit if is_number else ""
            change = Change(key, "", old, new, unit, 0.0, changed, edits)
            combined = change if combined is None else change.after(combined)
    return combined


def _records(problem: Problem) -> Iterator[tuple[str, Any]]:
    """Yield the problem's records with their places in the file."""
    yield "team", problem.team
    if isinstance(problem.start, HitchStart):
        yield "start.hitch", problem.start
    for i, step in enumerate(problem.mission):
        yield f"mission[{i}].{step.name}", step


def _plain_numbers(value: Any) -> Any:
    """Return a number or lists of numbers; None for other values."""
    if isinstance(value, Outline):
        return value.vertices.tolist()
    if isinstance(value, np.ndarray):
        return value.tolist()
    return value if isinstance(value, float) else None


def _unit_factor(declared: Key, key: str, value: Any) -> float | None:
    """Return the factor that converts a value from the unit that was probably meant, if any."""
    with warnings.catch_warnings(record=True) as caught, contextlib.suppress(InputError):
        warnings.simplefilter("always", UnitWarning)
        declared.from_file(key, value)
    factors = [w.message.factor for w in caught if isinstance(w.message, UnitWarning)]
    return factors[0] if factors else None


def retuning_changes(problem: Problem) -> Iterator[Change]:
    """Yield the controllers' error as ``limits.tracking``, and the stiffest gains of a firmware."""
    own = max(MIN_TRACKING, Tube.of(problem.team.tracking).largest)
    if (error := problem.limits.tube.largest) > own:
        edits = (Edit("limits.tracking", own),)
        relative, changed = own / error - 1.0, with_edits(problem, edits)
        yield Change("limits.tracking", "", error, own, "m", relative, changed, edits)
    kinds = problem.team.quadrotor
    if not can_be_stiffer(kinds):
        return
    values = [_quadrotor_keys(_stiffest(kind)) for kind in kinds]
    are_equal = all(each == values[0] for each in values)
    edits = (Edit("team.quadrotor", values[0] if are_equal else values),)
    changed = with_edits(problem, edits)
    old = ", ".join(dict.fromkeys(str(kind.controller) for kind in kinds if kind.controller))
    new = f"{values[0].get('controller')} with gains {values[0].get('gains')}".replace("'", "")
    yield Change("team.quadrotor.controller", "", old, new, "", 0.0, changed, edits)


def can_be_stiffer(kinds: Sequence[Quadrotor]) -> bool:
    """Return whether a controller of some firmware has smaller errors with other gains."""
    errors = (
        [Tube.of(each.loop.tracking).largest for each in (_stiffest(kind), kind)]
        for kind in kinds
        if kind.controller is not None
    )
    return any(smallest < error for smallest, error in errors)


def _stiffest(kind: Quadrotor) -> Quadrotor:
    """Return a quadrotor with the controller of its firmware that has the smallest errors.

    On a Crazyflie that is mellinger. A quadrotor without a named controller stays as it is.
    """
    if kind.controller is None:
        return kind
    name = "mellinger" if "mellinger" in of_same_firmware(kind.controller) else kind.controller
    gains = stiffest_gains(kind.mass, kind.latency, name)
    return with_fields(kind, controller=name, gains=Gains.of(gains))


def scaled_outlines(problem: Problem, factor: float) -> Edits:
    """Return the edits that scale all outlines about one point, the centroid of the first.

    The hitch keeps its goals: after a transport, the point is the goal.
    """
    centre, edits = np.zeros(2), list[Edit]()
    if isinstance(problem.start, HitchStart):
        outline = problem.start.outline
        centre = outline.centroid
        edits.append(scaled_outline_edit("start.hitch.polygon", outline, factor, centre))
    for i, step in enumerate(problem.mission):
        step_edits, centre = step.scaled(factor, centre)
        edits += _in_step(problem, i, step_edits)
    return tuple(edits)


def _in_step(problem: Problem, i: int, edits: Edits) -> Edits:
    """Return edits of step i with their paths in the file."""
    name = problem.mission[i].name
    return tuple(Edit(f"mission[{i}].{name}.{edit.key}", edit.value) for edit in edits)


def _object_knobs(problem: Problem, violations: Sequence[Violation]) -> Iterator[Knob]:
    """Yield the mass and friction of the objects that violations mention."""
    grips = [v.value / v.limit for v in violations if v.constraint == "grip" and v.limit > 0.0]
    loads = [v.limit / v.value for v in violations if v.constraint == "load" and v.value > 0.0]
    grip_share, mass_share = (
        LOAD_SHARE * min((each for each in shares if 0.0 < each < 1.0), default=1.0 / LOAD_SHARE)
        for shares in (grips, grips + loads)
    )
    holding = GRIP_CHECKS | LOAD_CHECKS
    covers = holding | FORCE_CHECKS | DISTANCE_CHECKS | {"equilibrium", "keep_out"}
    for name, body in problem.objects.items():
        mentions = (f"objects.{name}" in v.when or name in v.where for v in violations)
        if body.fixed or not any(mentions):
            continue
        min_size = round(1.0 - mass_share, 9)
        yield Knob(f"objects.{name}.mass", body.mass, "kg", None, -1, covers, min_size=min_size)
        if 0.0 < body.friction <= grip_share * MAX_FRICTION:
            knob = Knob(f"objects.{name}.friction", body.friction, "", covers=holding)
            max_size = MAX_FRICTION / body.friction - 1.0
            yield replace(knob, min_size=1.0 / grip_share - 1.0, max_size=max_size)


def _names(violations: Sequence[Violation]) -> list[str]:
    """Return the names of bodies in violations, each once."""
    return [*dict.fromkeys(name for each in violations for name in each.where)]


RIM_OVERHANG = 0.03
"""[m] Overhang over the body of rims that suggestions try."""


def rim_changes(problem: Problem, violations: Sequence[Violation]) -> Iterator[Change]:
    """Yield rims at the ceilings of objects for which no grip was found.

    Three or more robots rest objects with rims on their cables; two grip every object.
    """
    for name, body in problem.objects.items():
        ungripped = any(v.when.startswith(f"around objects.{name} ") for v in violations)
        if problem.team.robots == 2 or not ungripped:
            continue
        wider, radius = body.section.widened(RIM_OVERHANG), math.sqrt(body.section.area / math.pi)
        keys = (
            {"circle": wider.radius}
            if wider.outline is None
            else {"outline": wider.outline.tolist()}
        )
        edits = (Edit(f"objects.{name}.rim", {**keys, "at": body.upper}),)
        with_rim = with_fields(body, rim=Rim(wider, body.upper))
        changed = replace(problem, objects={**problem.objects, name: with_rim})
        new, relative = f"{RIM_OVERHANG:g} m wide at {body.upper:g} m", RIM_OVERHANG / radius
        yield Change(edits[0].key, "of the mean radius", "none", new, "", relative, changed, edits)


def _wall_knobs(problem: Problem, violations: Sequence[Violation]) -> Iterator[Knob]:
    """Yield the arena's walls and ceiling: all vertical ones together, and each alone."""
    arena = problem.arena
    if arena is None:
        return
    excess = max((-v.value for v in violations if v.constraint == "arena"), default=0.0)
    middle, extents = 0.5 * (arena.lower + arena.upper), arena.upper - arena.lower

    def widen(factor: float) -> Edits:
        half = 0.5 * extents * [factor, factor, 1.0]
        corners = {"lower": middle - half, "upper": middle + half}
        return (Edit("arena", {k: np.round(x, DECIMALS).tolist() for k, x in corners.items()}),)

    covers, min_size = frozenset({"arena"}), 2.0 * excess / float(np.min(extents[:2]))
    yield Knob("arena", 1.0, "times", widen, 1, covers, "length and width", min_size=min_size)
    for axis in range(3):
        extent = float(extents[axis])
        for side, sign in (("lower", -1), ("upper", 1)):
            if (axis, side) == (2, "lower"):  # the ground is where it is
                continue

            def move_wall(new: float, side: str = side, axis: int = axis) -> Edits:
                corners = {name: getattr(arena, name).tolist() for name in ("lower", "upper")}
                corners[side][axis] = new
                return (Edit("arena", corners),)

            key, old = f"arena.{side}[{axis}]", float(getattr(arena, side)[axis])
            min_size = excess / extent
            yield Knob(key, old, "m", move_wall, sign, covers, "one wall", extent, min_size)


TRIED_ROLLS = (15, 30)
"""[deg] Rolls of legs at an end that suggestions try."""

VERTEX_SHIFTS = (0.1, 0.25)
"""Shifts of a vertex of a goal outward that suggestions try, over its distance to the centroid."""


def roll_changes(problem: Problem) -> Iterator[Change]:
    """Yield changes to rolled legs at the start, and after steps that change the polygon."""
    records: list[tuple[str, object]] = [
        (f"mission[{i}].{step.name}", step)
        for i, step in enumerate(problem.mission)
        if isinstance(step, ShapeStep)
    ]
    if isinstance(problem.start, HitchStart):
        records.append(("start.hitch", problem.start))
    for roll in TRIED_ROLLS:
        for place, record in records:
            legs: Any = getattr(record, "legs", None)
            if isinstance(legs, RolledLegs) and legs.roll is not None:
                continue
            edits = (Edit(f"{place}.legs", {"sharing": "spread", "roll_deg": roll}),)
            old = legs if isinstance(legs, str) else "as they are"
            new, changed = f"spread with roll_deg: {roll}", with_edits(problem, edits)
            yield Change(edits[0].key, "", old, new, "", 0.0, changed, edits)


def vertex_changes(problem: Problem, violations: Sequence[Violation]) -> Iterator[Change]:
    """Yield changes of a vertex of a goal that moves outward, next to the bodies that are close."""
    robots = problem.team.robots
    names = " ".join(name for each in violations for name in each.where)
    cables = dict.fromkeys(int(number) for number in re.findall(r"\d+", names))
    ends = {"p": (0,), "q": (0,), "r": (1,)}
    bodies = re.findall(r"([pqr])(\d+)", names)
    vertices = [(int(k) + offset) % robots for kind, k in bodies for offset in ends[kind]]
    vertices += [(k + offset) % robots for k in cables for offset in (0, 1)]
    for i, step in enumerate(problem.mission):
        outline: Outline | None = vars(step).get("polygon")
        if outline is None or not isinstance(step, ShapeStep):
            continue
        for shift in VERTEX_SHIFTS:
            for vertex in dict.fromkeys(k for k in vertices if k < len(outline)):
                points = outline.vertices.copy()
                points[vertex] += shift * (points[vertex] - outline.centroid)
                points[vertex] = np.round(points[vertex], 3)
                edits = _in_step(problem, i, (Edit("polygon", points.tolist()),))
                try:
                    changed = with_edits(problem, edits)
                except InputError:  # not convex
                    continue
                key = f"{edits[0].key}[{vertex}]"
                old, new = (str(each[vertex].tolist()) for each in (outline.vertices, points))
                yield Change(key, "", old, new, "", 0.0, changed, edits)


def spread_changes(problem: Problem) -> Iterator[Change]:
    """Yield the changes from other legs to spread ones, at the start or after steps."""
    records: list[tuple[str, object]] = [("start.hitch", problem.start)]
    records += [(f"mission[{i}].{step.name}", step) for i, step in enumerate(problem.mission)]
    for place, record in records:
        legs: Any = getattr(record, "legs", None)
        sharing = legs.sharing if isinstance(legs, RolledLegs) else legs
        if sharing is None or (isinstance(sharing, str) and sharing == "spread"):
            continue
        edits = (Edit(f"{place}.legs", "spread"),)
        old, changed = legs if isinstance(legs, str) else "as given", with_edits(problem, edits)
        yield Change(edits[0].key, "", old, "spread", "", 0.0, changed, edits)
