"""Rest of a plan's hitch with compliant drones, with friction or without.

Force residuals are recomputed from the returned positions and tensions.

By the capstan equation, the tension of a leg is between ``e^{-μβ}`` and ``e^{μβ}`` times that of
its edge, where β is the bend of the cable at the clasp (``hitch.twists``). At the ends of the band
of rest, both cables of all clasps slide alike, as when a hitch is tightened or loosened: legs pull
more than edges, or less, by the share of friction that each has then. They are computed by Newton's
method, in a continuation from the rest without friction over the friction coefficient.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hitchopt.errors import InfeasibleError, InputError, OneLine, Violation
from hitchopt.geometry.vectors import dot, length, unit
from hitchopt.hitch import Quadrotor, Team
from hitchopt.hitch.energy import AXIAL_STIFFNESS, HitchEnergy, energy_of
from hitchopt.motion.motion import Motion
from hitchopt.motion.states import states_at
from hitchopt.plan import Plan
from hitchopt.support import Feature, Neighbour, unsupported
from hitchopt.values import Array, as_array, check_instance, plain, true_runs
from hitchopt.values.fields import Key, keys_of
from hitchopt.values.units import AXIAL_FORCE, FRICTION, STIFFNESS

POSITIVE = float(np.finfo(np.float64).tiny)  # Smallest positive number
LARGEST = 1e12  # Largest magnitude of a finite condition: powers of it do not overflow

# Values of the plan, and conditions with an axis of samples, and their numbers of other axes
PLANNED = {"t": 0, "positions": 2, "vertices": 2, "tensions": 1, "cable_forces": 2}
SAMPLED = {"cable_length": 1, "offsets": 2, "forces": 2}

# Conditions of position loops by axis; one value per drone is broadcast
LOOP = ("stiffness", "integral")
FLAGGED = ("integral", "feed_forward")  # Conditions that may be given as true or false

MAX_RESIDUAL = 1e-6  # Largest force residual of a solution [N]
BLOCK = 4000  # Cables of all samples that are solved at once, to bound memory

SLACK_RATIO = 1e-6  # A cable is slack if its tension over the planned one is below this


def _stiffness(key: str, value: object) -> float:
    """Return a stiffness [N/m], infinite if rigid; InputError for other values."""
    number: float = value if value == math.inf else STIFFNESS.check(key, value)
    return number


def condition_keys() -> dict[str, Key]:
    """Return the keys of a team's real values, the plan's by default, under names of commands.

    ``density`` and ``friction`` are the team's ``cable_density`` and ``cable_friction``.
    """
    team, quadrotor = keys_of(Team), keys_of(Quadrotor)
    keys = {
        "cable_length": team["cable_length"],
        "density": team["cable_density"],
        "friction": replace(team["cable_friction"], kind=FRICTION),
        "load": team["load"],
        "axial_stiffness": Key(
            AXIAL_FORCE, f"Stiffness EA of cables to stretch; {AXIAL_STIFFNESS:g} N by default"
        ),
        "stiffness": replace(quadrotor["stiffness"], kind=replace(STIFFNESS, check=_stiffness)),
        "integral": quadrotor["integral"],
        "feed_forward": quadrotor["feed_forward"],
    }
    return {name: replace(key, text=key.text.partition(";")[0]) for name, key in keys.items()}


def conditions_of(team: Team, **stated: Any) -> dict[str, Any]:
    """Return all conditions of ``equilibrium`` as arrays; the team's by default, numbers broadcast.

    The stiffness (2n, 3) is infinite for drones that are rigid at their setpoints; ``integral`` is
    the largest force of integrals (2n, 3) [N]. Raises InputError for an unknown name, another
    shape, or a number that is not finite or out of its range.
    """
    drones = (team.drones,)
    conditions = {}
    defaults = {"offsets": 0.0, "forces": 0.0, "axial_stiffness": AXIAL_STIFFNESS}
    defaults["friction"] = team.friction
    table: dict[str, tuple[tuple[int, ...], float]] = {
        "cable_length": ((team.robots,), POSITIVE),
        "cable_density": ((), 0.0),
        "load": ((len(team.layout.clasps),), 0.0),
        "stiffness": ((*drones, 3), POSITIVE),
        "integral": ((*drones, 3), 0.0),
        "feed_forward": (drones, 0.0),
        "offsets": ((*drones, 3), -LARGEST),
        "forces": ((*drones, 3), -LARGEST),
        "axial_stiffness": ((), POSITIVE),
        "friction": ((), 0.0),
    }
    for name in stated.keys() - table:
        raise InputError(
            name, stated[name], f"one of {', '.join(table)}", "see hitchopt.equilibrium"
        )
    for name, (shape, lower) in table.items():
        value = stated.get(name)
        if value is None:
            value = defaults[name] if name in defaults else getattr(team, name)
        if name in FLAGGED:
            flags = np.asarray(plain(name, value))
            value = 1.0 * flags if flags.dtype == np.bool_ else value
        values = as_array(name, value)
        if name == "integral" and name in stated:
            values = np.where(values > 0.0, np.inf, 0.0)
        if name in LOOP and values.shape == drones:
            values = np.repeat(values[:, None], 3, axis=1)
        if values.ndim == 0:
            values = np.broadcast_to(values, shape)
        item_shape = values.shape[values.ndim - len(shape) :] if name in SAMPLED else values.shape
        upper = np.inf if name in LOOP else LARGEST
        if item_shape != shape or not np.all((values >= lower) & (values <= upper)):
            size = {POSITIVE: "positive ", 0.0: "non-negative "}.get(lower, "")
            array = f", or an array (…, {', '.join(map(str, shape))})" if shape else ""
            bound = f"one {size}number up to {LARGEST:g}{array}"
            raise InputError(name, value, bound, "use plain numbers in SI units")
        conditions[name] = values
    conditions["stiffness"] = np.where(
        np.isinf(conditions["integral"]), np.inf, conditions["stiffness"]
    )
    return conditions


@dataclass(frozen=True, eq=False)
class Equilibrium(OneLine):
    """Rest of a hitch in samples (…) at times of a plan.

    Attributes
    ----------
    team: the plan's.
    t: (…) [s]
    drones: (…, 2n, 3) [m]
    vertices: (…, points, 3) [m], without friction at the clasps.
    rests: (…, 2, points, 3) [m], vertices with fully used friction, legs pulling less than edges
        and more; both are ``vertices`` without friction, nan if there is no rest.
    tensions: (…, n) [N], at the heights of the edges' midpoints.
    slack: (…, n), whether a cable is slack: it has no tension, or sags by more than a quarter of
        its longest span.
    bears: (…, clasps), whether the two cables of a clasp press on each other.
    planned_drones, planned_vertices, planned_tensions: the plan's values at those times.
    force_residual: (…) [N], the largest force residual at a drone or a clasp.
    length_residual: (…) [m], the largest length error of a taut cable.
    """

    team: Team
    t: Array
    drones: Array
    vertices: Array
    rests: Array
    tensions: Array
    slack: NDArray[np.bool_]
    bears: NDArray[np.bool_]
    planned_drones: Array
    planned_vertices: Array
    planned_tensions: Array
    force_residual: Array
    length_residual: Array

    @property
    def band(self) -> Array:
        """Range of outward displacements of vertices at rest, with friction (…, points, 2) [m].

        Displacements are from the plan along the bisector, away from the neighbouring vertices. A
        bound is infinite if there is no rest with fully used friction in that sense.
        """
        planned = self.planned_vertices[..., None, :, :]
        ahead = unit(np.roll(planned, -1, axis=-2) - planned)
        behind = -np.roll(ahead, 1, axis=-2)
        if not self.team.layout.closed:
            ahead[..., -1, :] = behind[..., 0, :] = 0.0
        places = np.concatenate([self.vertices[..., None, :, :], self.rests], axis=-3)
        out = dot(places - planned, unit(-(ahead + behind)))
        least = np.min(np.where(np.isnan(out), -np.inf, out), axis=-2)
        most = np.max(np.where(np.isnan(out), np.inf, out), axis=-2)
        return np.stack([least, most], axis=-1)

    @property
    def slack_cables(self) -> tuple[str, ...]:
        """Names of cables that are slack in any sample: c0, c1, …."""
        slack = self.slack.reshape(-1, self.team.robots).any(axis=0)
        return tuple(f"c{k}" for k in sorted(np.array(self.team.labels)[slack].tolist()))

    @property
    def loose_clasps(self) -> tuple[str, ...]:
        """Names of points whose cables do not press on each other in some sample."""
        clasps = self.team.layout.clasps
        return tuple(f"p{k}" for k in clasps[~self.bears.reshape(-1, len(clasps)).all(axis=0)])


def motion_of(plan: Plan | Motion) -> Motion:
    """Return the motion of a plan; UnsupportedError for several teams."""
    check_instance("plan", plan, Plan, Motion)
    return plan.flight.of_one_team(Feature.STATICS) if isinstance(plan, Plan) else plan


def equilibrium(plan: Plan | Motion, t: ArrayLike, **conditions: Any) -> Equilibrium:
    """Return the rest of a plan's hitch: positions of drones and vertices, and tensions.

    Drones are displaced from their setpoints by ``(F + cable force)/k``, where k is the stiffness
    of their position loops and F the feed-forward. Integrals compensate up to their largest force.
    Tensions are those without friction. With friction a vertex may rest anywhere in its
    ``Equilibrium.band``.

    Parameters
    ----------
    plan: with a hitch at all these times; or its motion.
    t: (…) [s]; its axes broadcast with those of the conditions.
    conditions: deviations from the team, numbers or arrays. With axes (…) of samples:
        ``cable_length`` (…, n) [m] under the planned tension, ``offsets`` of setpoints and errors
        of the feed-forward ``forces`` (…, 2n, 3) [m], [N]. Without samples: ``cable_density``
        [kg/m], ``load`` (clasps,) [kg], ``stiffness`` of position loops (2n,) or by axis (2n, 3)
        [N/m], infinite if rigid, ``integral`` and ``feed_forward`` of the controllers (2n,),
        ``axial_stiffness`` of cables, EA [N], and ``friction``, the coefficient at the clasps.

    Raises
    ------
    InputError: a time without a hitch, or an invalid condition.
    UnsupportedError: single drones, several teams, or objects that are carried.
    InfeasibleError: there is no rest.
    """
    motion = motion_of(plan)
    resolved = conditions_of(motion.team, **conditions)
    shape, samples = samples_of(motion, t, resolved)
    size = max(1, BLOCK // motion.team.robots)
    blocks = [
        _rest(motion.team, resolved, {name: v[i : i + size] for name, v in samples.items()})
        for i in range(0, len(samples["t"]), size)
    ]
    arrays = {name: np.concatenate([block[name] for block in blocks]) for name in blocks[0]}
    return Equilibrium(
        motion.team, **{k: v.reshape((*shape, *v.shape[1:])) for k, v in arrays.items()}
    )


def samples_of(
    motion: Motion, t: ArrayLike, conditions: Mapping[str, Any]
) -> tuple[tuple[int, ...], dict[str, Array]]:
    """Return the broadcast shape of times and conditions, and values of all samples (S, …) by name.

    Names are those of ``States`` and ``conditions_of``; errors are those of ``equilibrium``.
    """
    if not motion.team.has_cables:
        raise unsupported(Feature.STATICS, Neighbour.SINGLE_DRONES)
    states = states_at(motion, t)
    if not np.all(states.formed):
        formed = [p.state.hitched for p in motion.phases]
        runs = [(motion.phases[i], motion.phases[j - 1]) for i, j in true_runs(np.array(formed))]
        spans = [f"{first.start:g} to {last.end:g} s" for first, last in runs]
        bound = f"within a hitch: {', '.join(spans) or 'never in this plan'}"
        raise InputError("t", float(states.t[~states.formed].flat[0]), bound, "see its phases")
    carrying = np.any(states.load_share > 0.0, axis=-1)
    if np.any(carrying):
        when = f"t = {float(states.t[carrying].flat[0]):.4g} s"
        raise unsupported(Feature.STATICS, Neighbour.OBJECTS, when)
    axes = PLANNED | SAMPLED
    values = {name: vars(states)[name] if name in PLANNED else conditions[name] for name in axes}
    item_shapes = {name: v.shape[v.ndim - axes[name] :] for name, v in values.items()}
    shape = np.broadcast_shapes(*(v.shape[: v.ndim - axes[k]] for k, v in values.items()))
    return shape, {
        name: np.broadcast_to(v, (*shape, *item_shapes[name])).reshape((-1, *item_shapes[name]))
        for name, v in values.items()
    }


def _rest(
    team: Team, conditions: Mapping[str, Any], samples: Mapping[str, Array]
) -> dict[str, NDArray[Any]]:
    """Return the arrays of ``Equilibrium`` for a block of samples."""
    energy = energy_of(team, conditions, samples)
    x = energy.at_rest()
    force = np.max(length(energy.slopes(x)), axis=1)
    if not np.max(force) <= MAX_RESIDUAL:  # nan as well
        worst = int(np.argmax(force))
        when = f"at t = {samples['t'][worst]:.4g} s"
        remedy = (
            "state a stiffness of the drones, use longer cables, or move drones away from vertices"
        )
        values = "settling", float(force[worst]), MAX_RESIDUAL, "max", "N", (), when, remedy
        raise InfeasibleError([Violation(*values)], "no equilibrium was found in these conditions")
    T = energy.tensions(x)
    ends = x[:, energy.nodes]
    points = energy.points
    excess = energy.forces(ends, T).lengths - energy.lengths
    excess -= energy.compliance * (T - energy.reference)
    slack = np.maximum(energy.slack_tension, SLACK_RATIO * energy.reference) >= T
    friction = float(conditions["friction"])
    tensions = T + energy.weight * energy.spans(ends).heights[..., 1]
    alike = replace(energy, alike=True)
    rests = [alike.rest_with_friction(x, sense * friction)[:, points] for sense in (-1.0, 1.0)]
    return {
        "t": samples["t"],
        "drones": x[:, : energy.drones],
        "vertices": x[:, points],
        "rests": np.stack(rests, axis=1),
        "tensions": tensions,
        "slack": slack,
        "bears": _bearing(team, energy, x, np.where(slack, 0.0, tensions)),
        "planned_drones": samples["positions"],
        "planned_vertices": samples["vertices"],
        "planned_tensions": samples["tensions"],
        "force_residual": force,
        "length_residual": np.max(np.where(slack, 0.0, np.abs(excess)), axis=-1),
    }


def _bearing(team: Team, energy: HitchEnergy, x: Array, tensions: Array) -> NDArray[np.bool_]:
    """Return whether the two cables of each clasp press on each other (S, clasps).

    The spans of a cable, with half of their weight, must pull the other cable into their bend.
    """
    bearing = np.ones((len(x), len(team.layout.clasps)), dtype=np.bool_)
    for cables, node, drone in ((team.layout.ahead, 1, 0), (team.layout.behind, 2, 3)):
        clasp, other, end = (x[:, energy.nodes[cables, k]] for k in (node, 3 - node, drone))
        leg, edge = end - clasp, other - clasp
        contact = -tensions[:, cables, None] * (unit(leg) + unit(edge))
        contact[..., 2] += 0.5 * energy.weight * (length(leg) + length(edge))
        bearing &= (dot(contact, leg) < 0.0) & (dot(contact, edge) < 0.0)
    return bearing
