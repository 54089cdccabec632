"""Knobs of a problem: numbers that repair may raise or lower."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from hitchopt.checks.registry import RULE_OF_KEY, distances_of, names_of
from hitchopt.checks.swing import SWING
from hitchopt.errors import Violation
from hitchopt.hitch.requirements import Limits
from hitchopt.mission.problem import Problem
from hitchopt.mission.starts import DronesStart, HitchStart
from hitchopt.repairs.changes import constraint_name, in_step, quadrotor_keys
from hitchopt.steps.knob import (
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
from hitchopt.values import Array
from hitchopt.values.fields import keys_of

SPACE_CHECKS = checks_relaxed_by("length") | {"tracking_radius", "vertex_error", "rest_shift"}
"""Constraints that longer cables may repair."""

TIME_CHECKS = checks_relaxed_by("time")  # Constraints that slower motion may repair
FORCE_CHECKS = checks_relaxed_by("tension")  # Constraints that another tension may repair

DURATION_CHECKS = frozenset({"duration", PLAN_DURATION})
"""Constraints that a faster plan or more time repairs."""

DISTANCE_CHECKS = names_of(distances_of("drones", "cables")) | {
    "tracking_radius",
    "survivable",
}
"""Constraints that more distance repairs."""

LOAD_CHECKS = frozenset({"load"})  # Constraints that a higher tension or a lighter object repairs
GRIP_CHECKS = frozenset({"grip"})  # Constraints that a higher tension or a rougher object repairs
MAX_FRICTION = 1.0  # Maximum coefficient of friction of suggestions

MAX_TILT_DEG = 80.0  # Maximum tilt of suggestions [deg]

REST_CHECKS = frozenset({"rest_shift", "vertex_error"})  # Constraints of friction at rest

LOAD_SHARE = 0.95
"""First mass to try, as a fraction of the maximum mass at rest, since carrying adds forces."""


def knobs_of(problem: Problem, violations: Sequence[Violation]) -> Iterator[Knob]:
    """Yield the knobs of a problem; safety distances are never changed."""
    yield from _start_knobs(problem)
    yield from _team_knobs(problem, violations)
    yield from _object_knobs(problem, violations)
    yield from _limit_knobs(problem, violations)
    yield from _step_knobs(problem, violations)
    yield from _wall_knobs(problem, violations)


def _limit_knobs(problem: Problem, violations: Sequence[Violation]) -> Iterator[Knob]:
    """Yield the limits that a problem states."""
    for name, limit in keys_of(Limits).items():
        key = f"limits.{limit.name}"
        value = getattr(problem.limits, name)
        rule = SWING if key == SWING.key else RULE_OF_KEY.get(key)
        if value is None or rule is None or name == "floor":  # the ground is where it is
            continue
        old, check = limit.to_file(value), PLAN_DURATION if name == "duration" else rule.name
        covers = frozenset({check}) | (DURATION_CHECKS if rule.derivative else frozenset())
        knob = Knob(key, old, rule.unit, covers=covers)
        max_size = MAX_TILT_DEG / old - 1.0 if name == "tilt" else math.inf
        if rule.sense == "min":
            yield replace(knob, sign=-1)
        elif max_size > 0.0:
            yield replace(knob, min_size=_min_size(violations, check), max_size=max_size)


def _step_knobs(problem: Problem, violations: Sequence[Violation]) -> Iterator[Knob]:
    """Yield the knobs of all steps."""
    names = _names(violations)
    for i, step in enumerate(problem.mission):
        slowdown = _min_size((v for v in violations if v.step == i), "duration")
        for knob in step.knobs():

            def make_edits(new: float, i: int = i, knob: Knob = knob) -> Edits:
                return in_step(problem, i, knob.edits(new))

            key = f"mission[{i}].{step.name}.{knob.key}"
            min_size = slowdown if "duration" in knob.covers else 0.0
            increase = step.least_increase(
                knob, problem.objects, names, problem.requirements.separation
            )
            min_size = max(min_size, increase)
            yield replace(knob, key=key, make_edits=make_edits, min_size=min_size)


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
    yield replace(tension, sign=-1, covers=FORCE_CHECKS, max_size=1.0)
    holding = LOAD_CHECKS | GRIP_CHECKS
    yield replace(tension, covers=holding, min_size=_min_size(violations, "load"))
    if np.any(problem.team.load > 0.0):
        covers = LOAD_CHECKS | FORCE_CHECKS | DISTANCE_CHECKS
        yield replace(_team_values(problem, "load", "kg"), sign=-1, covers=covers)
    yield from _friction_knobs(problem, violations)
    thrust = _team_values(problem, "max_thrust", "N")
    key = "team.quadrotor.max_thrust" if thrust.unit == "N" else "team.quadrotor"
    yield replace(thrust, key=key, covers=DURATION_CHECKS | {"thrust"})


def _friction_knobs(problem: Problem, violations: Sequence[Violation]) -> Iterator[Knob]:
    """Yield the friction of cables that hold vertices off their goals at rest.

    Its smallest change is in proportion to the distance.
    """
    team = problem.team
    shifts = [v.limit / v.value for v in violations if v.constraint in REST_CHECKS and v.value > 0]
    if not shifts or team.friction == 0.0:
        return
    ratios = np.array([team.least_friction, team.friction]) / team.friction

    def make_edits(new: float) -> Edits:
        """Return the edit of the friction, or of both ends of its range."""
        rounded = [round(float(each), DECIMALS) for each in new * ratios]
        is_range = isinstance(team.cable_friction, tuple)
        return (Edit("team.cable_friction", rounded if is_range else rounded[1]),)

    covers = SPACE_CHECKS | REST_CHECKS | {"arena", "crossing", "friction_shift"}
    knob = Knob("team.cable_friction", team.friction, "", make_edits, -1, covers)
    yield replace(knob, min_size=max(0.0, 1.0 - min(shifts)))


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
        rounded = [quadrotor_keys(kind) | {"max_thrust": x} for kind, x in thrusts]
    are_equal = all(value == rounded[0] for value in rounded)
    return Edit(f"team.{name}", rounded[0] if are_equal else rounded)


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
        edits += in_step(problem, i, step_edits)
    return tuple(edits)


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
        mentions = (v.object == name or name in v.where for v in violations)
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

    covers, min_size = (
        frozenset({"arena", "vertex_error", "rest_shift"}),
        2.0 * excess / float(np.min(extents[:2])),
    )
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


def _min_size(violations: Iterable[Violation], name: str) -> float:
    """Return the minimum relative increase of a limit, or of a step's duration."""
    pairs = [(v.value, v.limit) for v in violations if constraint_name(v) == name]
    if name == "duration":
        pairs = [(limit, value) for value, limit in pairs]
    sizes = (larger / smaller - 1.0 for larger, smaller in pairs if smaller > 0.0)
    return max(filter(math.isfinite, sizes), default=0.0)
