"""The polygon that grips a section hardest, and the largest mass that it lifts within all limits.

The search is local, by sequential quadratic programs (SLSQP) from several polygons: failure does
not prove that there is no grip. What it returns is measured anew.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from scipy.optimize import minimize

from hitchopt.errors import InfeasibleError, Violation, check_time
from hitchopt.geometry.vectors import TIE
from hitchopt.hitch.requirements import Requirements
from hitchopt.hitch.team import GRAVITY, Quadrotor
from hitchopt.holding.capacity import Capacity, largest_mass
from hitchopt.holding.grip import NO_GRIP, Grip, broken_limit_of, grip_margins
from hitchopt.objects import Section
from hitchopt.values import Array

STEP = 1e-6
"""[m] Step of central differences of margins."""

KEPT = 0.05
"""Margin of all distances, over their limits: lifting moves drones by less."""

BALANCED = 1e-6
"""Largest level force on the section over the tension, and moment over tension and size."""

SCREENING, ITERATIONS = 12, 60
"""Most quadratic programs from every start, and from those that come farthest with these."""

FINALISTS = 2
"""Starts that are followed to the end."""

ALL, SMALLEST = 36, 6
"""Every quadratic program contains so many margins of a kind, or else its smallest ones, whose
slopes jump where two are equal."""

OFFSETS = ((0.25, 0.25), (0.12, 0.4), (0.4, 0.12))
"""Distances of every other starting vertex to the section, and of those between, over its mean
radius; the first pair where they do not alternate."""

FEWEST = 3
"""Smallest number of cables."""

PLACES = 12
"""Decimal places of centroids: what rounding leaves of none is none."""

TURNS = 3
"""Starting polygons, turned by equal parts of their symmetry, besides those that face sides."""


@dataclass(frozen=True, eq=False)
class GripTask:
    """A grip to be found.

    Attributes
    ----------
    section: to be gripped.
    robots: number n of cables.
    cable_length: of all cables [m].
    tension: of all legs [N].
    clasp_friction: coefficient of cables on each other.
    requirements: limits and distances.
    kind: of all drones.
    """

    section: Section
    robots: int
    cable_length: float
    tension: float
    clasp_friction: float
    requirements: Requirements
    kind: Quadrotor

    def grip(self, vertices: Array, weight: float = 0.0) -> Grip:
        """Return the grip with vertices (…, n, 2) [m] that lifts a weight [N]."""
        return Grip.of(
            self.section, vertices, self.cable_length, self.tension,
            clasp_friction=self.clasp_friction, weight=weight,
        )  # fmt: skip

    def margins(self, grip: Grip) -> dict[str, Array]:
        """Return the margins (…, items) of a grip."""
        return grip_margins(grip, self.requirements, self.kind)

    def imbalance(self, grip: Grip) -> Array:
        """Return the largest level force over the tension, or moment over that and the size (…)."""
        scale = np.array([1.0, 1.0, math.sqrt(self.section.area)]) * self.tension
        largest: Array = np.max(np.abs(grip.level_imbalance) / scale, axis=-1)
        return largest


def best_grip(task: GripTask) -> Grip:
    """Return the grip whose slip load is largest, within all limits, before it lifts anything.

    It is searched about the section's centroid: where the outline has its origin does not matter.

    Raises
    ------
    InfeasibleError: none was found; the violation is that of the nearest one.
    """
    centre = np.round(task.section.centroid, PLACES)
    if task.section.outline is None or not np.any(centre):
        return _best_centred(task)
    centred = replace(task, section=Section(task.section.outline - centre))
    return task.grip(_best_centred(centred).vertices[..., :2] + centre)


def _best_centred(task: GripTask) -> Grip:
    """Return the best grip of a section whose centroid is the origin."""
    starts, best_first = _starts(task), partial(merit, task)
    for iterations, kept in ((SCREENING, FINALISTS), (ITERATIONS, 1)):
        found = [_refined(task, start, iterations) for start in starts]
        grips = (each for each in found if each and _turns_once(each.vertices[..., :2]))
        ranked = sorted(grips, key=best_first, reverse=True)[:kept]
        starts = [each.vertices[..., :2] for each in ranked]
    if not ranked or merit(task, ranked[0]) <= 0.0:
        raise _no_grip(task, ranked)
    return ranked[0]


def _turns_once(vertices: Array) -> bool:
    """Return whether a polygon (n, 2) turns right at all vertices, once around in all."""
    onward = np.roll(vertices, -1, axis=0) - vertices
    before = np.roll(onward, 1, axis=0)
    right = before[:, 1] * onward[:, 0] - before[:, 0] * onward[:, 1]
    turns = np.arctan2(right, np.sum(before * onward, axis=1))
    return bool(np.all(turns > 0.0) and np.sum(turns) < 3.0 * math.pi)


def merit(task: GripTask, grip: Grip) -> float:
    """Return the slip load over friction [N] of a grip within all limits; else what it lacks."""
    short = min(float(np.min(each)) for each in task.margins(grip).values())
    unbalanced = float(task.imbalance(grip)) - BALANCED
    loose = -float(np.min(grip.wraps.angles))
    lacking = max(-short, unbalanced, 0.0)
    if lacking > 0.0 or loose >= 0.0:
        return -lacking - max(loose, 0.0)
    return float(grip.slip_load(1.0))


def grip_capacity(task: GripTask, grip: Grip, friction: float, factor: float) -> Capacity:
    """Return the largest mass [kg] that a grip lifts within all limits, and what binds.

    Parameters
    ----------
    friction: coefficient between cables and object.
    factor: least slip load over load.
    """

    def margins(mass: float) -> dict[str, float]:
        lifting = task.grip(grip.vertices[..., :2], mass * GRAVITY)
        kept = {name: float(np.min(each)) for name, each in task.margins(lifting).items()}
        slip = float(lifting.slip_load(friction))
        return kept | {"grip": slip / (factor * max(mass, TIE) * GRAVITY) - 1.0}

    most = float(grip.slip_load(friction)) / (factor * GRAVITY)
    return largest_mass(margins, 1.5 * max(most, 1e-3))


def _starts(task: GripTask) -> list[Array]:
    """Return polygons (n, 2) [m] around the section: turned evenly, and facing its sides."""
    core, n = task.section.core, task.robots
    symmetry = 2.0 * math.pi / n
    sides = np.roll(core, -1, axis=0) - core
    facing = np.arctan2(sides[:, 0], -sides[:, 1])[np.argsort(-np.hypot(*sides.T), kind="stable")]
    even = 0.5 * math.pi - symmetry * np.arange(TURNS) / TURNS
    turns = even[:1] if len(core) == 1 else np.append(facing[:SMALLEST], even)
    _, first = np.unique(np.round(turns % symmetry, 6) % symmetry, return_index=True)
    centre, size = task.section.centroid, math.sqrt(task.section.area / math.pi)
    found = []
    for turn in turns[np.sort(first)]:
        angles = turn - symmetry * np.arange(n)
        out = np.column_stack([np.cos(angles), np.sin(angles)])
        on_rays = np.linspace(0.0, 3.0, 601)[:, None, None] * task.section.circumradius * out
        gaps = task.section.clearance(centre + on_rays)[0]
        for pair in OFFSETS if n % 2 == 0 else OFFSETS[:1]:
            first = np.argmax(gaps >= size * np.resize(pair, n), axis=0)
            found.append(centre + on_rays[first, np.arange(n)])
    return found


def _refined(task: GripTask, start: Array, iterations: int) -> Grip | None:
    """Return the grip that sequential quadratic programs reach from a polygon; None if none."""
    program = _Program(task, start)
    rows = [("eq", slice(1, 4), 0.0), ("ineq", slice(4, None), KEPT)]
    constraints: list[Any] = [
        {
            "type": kind,
            "fun": lambda x, part=part, least=least: program.values(x)[part] - least,
            "jac": lambda x, part=part: program.slopes(x)[part],
        }
        for kind, part, least in rows
    ]

    def lost(x: Array) -> float:
        return -float(program.values(x)[0])

    def steepest(x: Array) -> Array:
        slope: Array = -program.slopes(x)[0]
        return slope

    check_time()
    options: Any = {"maxiter": iterations, "ftol": 1e-7}
    try:
        found = minimize(
            lost, start.ravel(), jac=steepest, method="SLSQP", constraints=constraints,
            options=options,
        )  # fmt: skip
        return task.grip(np.asarray(found.x).reshape(start.shape))
    except InfeasibleError:
        return None


class _Program:
    """Slip load, imbalances and smallest margins of a task's grips, by their vertices.

    A disc has no moment, however it is gripped, and all turned grips of it are equal: there the
    third imbalance is how far vertices turn from where they start.
    """

    def __init__(self, task: GripTask, start: Array) -> None:
        self._task, self._shape, self._start = task, start.shape, start.ravel()
        self._at: dict[tuple[str, bytes], Array] = {}
        self._turning: Array | None = None
        if len(task.section.core) == 1:
            x, y = (start - task.section.centroid).T
            self._turning = np.column_stack([-y, x]).ravel() / math.hypot(*x, *y)

    def values(self, x: Array) -> Array:
        """Return the values (rows,) at vertices x (2 n,) [m]."""
        return self._remembered("values", x, self._values)

    def slopes(self, x: Array) -> Array:
        """Return their slopes (rows, 2 n) [1/m], by central differences."""
        return self._remembered("slopes", x, self._slopes)

    def _remembered(self, name: str, x: Array, of: Callable[[Array], Array]) -> Array:
        key = name, x.tobytes()
        if key not in self._at:
            self._at = {k: v for k, v in self._at.items() if k[1] == key[1]}
            self._at[key] = of(x)
        return self._at[key]

    def _slopes(self, x: Array) -> Array:
        moves = STEP * np.eye(x.size)
        both = self._values(np.stack([x + moves, x - moves]))
        slopes: Array = ((both[0] - both[1]) / (2.0 * STEP)).T
        return slopes

    def _values(self, x: Array) -> Array:
        task = self._task
        grip = task.grip(x.reshape(*x.shape[:-1], *self._shape))
        kept = [
            each
            if each.shape[-1] <= ALL
            else np.sort(np.partition(each, SMALLEST - 1)[..., :SMALLEST])
            for each in _searched(task, grip)
        ]
        goal = grip.slip_load(1.0)[..., None] / task.tension
        unbalanced = grip.level_imbalance / task.tension
        if self._turning is not None:
            unbalanced[..., 2] = (x - self._start) @ self._turning
        return np.concatenate([goal, unbalanced, *kept], axis=-1)


def _searched(task: GripTask, grip: Grip) -> list[Array]:
    """Return the margins that vertices change: level pulls do not depend on them."""
    fixed = ("tilt", "thrust")
    margins = [each for name, each in task.margins(grip).items() if name not in fixed]
    return [*margins, grip.wraps.angles]


def _no_grip(task: GripTask, nearest: list[Grip]) -> InfeasibleError:
    """Return the refusal: what the nearest grip breaks most, or that it does not wrap."""
    note = f"no grip by {task.robots} cables of {task.cable_length:.3g} m was found"
    broken = Violation("grip", 0.0, 1.0, "min", "ratio", (), "", NO_GRIP)
    for grip in nearest[:1]:
        short = {key: float(np.min(each)) for key, each in task.margins(grip).items()}
        worst = min(short, key=lambda key: short[key])
        if short[worst] < 0.0:
            broken = broken_limit_of(worst, short[worst], task.requirements, task.kind)
    if task.robots > FEWEST:
        broken = replace(broken, remedy=f"use three cables; or {broken.remedy}")
    return InfeasibleError([broken], note)
