"""Where a plan's hitch comes to rest while its drones give way, with friction or without.

Forces without balance are recomputed from positions and tensions that are returned.

By the capstan's law a leg may pull with up to ``e^{μθ}`` times what its cable's edge pulls with, or
with as little as ``e^{-μθ}`` times that; θ is the angle by which the cable bends at the clasp. The
ends of the band of rest are where all clasps use their friction fully in one sense, as they do when
a hitch is drawn taut or let out: legs pull more than edges, or less. They are reached from the rest
without friction, in small steps of the share of friction that is used, by Newton's method.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hitchopt.errors import InfeasibleError, InputError, OneLine, UnsupportedError, Violation
from hitchopt.geometry.vectors import dot, length, unit
from hitchopt.hitch import GRAVITY, Team
from hitchopt.motion.motion import Motion
from hitchopt.motion.states import states_at
from hitchopt.plan import Plan
from hitchopt.statics.energy import HitchEnergy
from hitchopt.values import Array, Indices, check_instance

# Least positive and largest finite number
POSITIVE, LARGEST = (getattr(np.finfo(np.float64), name) for name in ("tiny", "max"))

# Values of the plan, and conditions that may differ from sample to sample, with their axes
PLANNED = {"t": 0, "positions": 2, "vertices": 2, "tensions": 1, "cable_forces": 2}
SAMPLED = {"cable_length": 1, "offsets": 2, "forces": 2}

# Conditions of position loops with a value per axis; one for all of a drone's is allowed
LOOP = ("stiffness", "integral")

# EA of a braided polyethylene line of 1 mm [N], which is all but inextensible; without stretch
# rigid drones would not determine tensions
AXIAL_STIFFNESS = 1e4

LARGEST_RESIDUAL = 1e-6  # Largest force without balance of a solution that is returned [N]
BLOCK = 4000  # Cables of all samples that are solved for at once, which bounds the memory

# A cable is slack where a level span as long as its longest one would hang by more than its chord
# over the first number, or its tension is no more than the second over the planned one
SAG_RATIO, SLACK_SHARE = 4.0, 1e-6


def conditions_of(team: Team, **given: Any) -> dict[str, Any]:
    """Return all conditions of ``settle`` as arrays: one number is for all, others are the team's.

    The stiffness (2n, 3) is infinite where a drone stands at its set point whatever the force; of
    integrals there is the largest force (2n, 3) [N].

    Raises
    ------
    InputError: an unknown name, another shape, or a number that is not finite or out of its range.
    """
    drones, conditions = (team.drones,), {}
    own = {"offsets": 0.0, "forces": 0.0, "axial_stiffness": AXIAL_STIFFNESS}
    own["friction"] = team.cable_friction
    table: dict[str, tuple[tuple[int, ...], float]] = {
        "cable_length": ((team.robots,), POSITIVE),
        "cable_density": ((), 0.0),
        "load": ((len(team.layout.clasps),), 0.0),
        "stiffness": ((*drones, 3), POSITIVE),
        "integral": ((*drones, 3), 0.0),
        "feed_forward": (drones, 0.0),
        "offsets": ((*drones, 3), -np.inf),
        "forces": ((*drones, 3), -np.inf),
        "axial_stiffness": ((), POSITIVE),
        "friction": ((), 0.0),
    }
    for name in given.keys() - table:
        raise InputError(name, given[name], f"one of {', '.join(table)}", "see hitchopt.settle")
    for name, (shape, least) in table.items():
        value = given.get(name)
        if value is None:
            value = own[name] if name in own else getattr(team, name)
        values = np.asarray(value, np.float64)
        if name == "integral" and value is not None and name in given:  # whether, not how much
            values = np.where(values > 0.0, np.inf, 0.0)
        if name in LOOP and values.shape == drones:
            values = np.repeat(values[:, None], 3, axis=1)
        if values.ndim == 0:
            values = np.broadcast_to(values, shape)
        each = values.shape[values.ndim - len(shape) :] if name in SAMPLED else values.shape
        largest = np.inf if name in LOOP else LARGEST
        if each != shape or not np.all((values >= least) & (values <= largest)):
            size = {POSITIVE: "positive ", 0.0: "non-negative "}.get(least, "")
            array = f", or an array (…, {', '.join(map(str, shape))})" if shape else ""
            bound = f"one {size}number{array}"
            raise InputError(name, value, bound, "give plain numbers in SI units")
        conditions[name] = values
    conditions["stiffness"] = np.where(
        np.isinf(conditions["integral"]), np.inf, conditions["stiffness"]
    )
    return conditions


@dataclass(frozen=True, eq=False)
class Settled(OneLine):
    """Positions at rest of samples (…) at times of a plan.

    Attributes
    ----------
    team: the plan's.
    t: (…) [s]
    drones: (…, 2n, 3) [m]
    vertices: (…, points, 3) [m], where clasps have no friction.
    rests: (…, 2, points, 3) [m], where vertices rest with clasps' friction fully used, legs pulling
        less than edges and more; both are ``vertices`` without friction, nan if there is none.
    tensions: (…, n) [N], at the heights of the edges' middles.
    slack: (…, n) whether a cable is slack: it does not pull, or hangs by more than a quarter of its
        longest span.
    bears: (…, clasps) whether the two cables of a clasp press on each other.
    planned_drones, planned_vertices, planned_tensions: the plan's values at those times.
    force_residual: (…) [N], the largest force without balance at a drone or a clasp.
    length_residual: (…) [m], the largest length that a taut cable has too much or too little.
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
        """(…, points, 2) [m]: how far outside of its plan every vertex can rest, least and most.

        Outside is away from the neighbouring vertices, along the bisector; inside is negative. The
        band is infinite if there is no rest with friction fully used in that sense.
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
        """Names of the cables that are slack in any sample: c0, c1, …."""
        return named("c", self.slack, np.arange(self.team.robots))

    @property
    def loose_clasps(self) -> tuple[str, ...]:
        """Names of the points whose cables do not press on each other in some sample."""
        return named("p", ~self.bears, self.team.layout.clasps)


def named(letter: str, flags: NDArray[np.bool_], numbers: Indices) -> tuple[str, ...]:
    """Return the names of the columns of flags (…, n) in which any is set."""
    any_ = flags.reshape(-1, flags.shape[-1]).any(axis=0)
    return tuple(f"{letter}{k}" for k in numbers[any_])


def settle(plan: Plan | Motion, t: ArrayLike, **conditions: Any) -> Settled:
    """Return the rest of a plan's hitch: places of drones and vertices, and tensions.

    Drones stand at their set points, offset by ``(F + cable force)/k``: k is the stiffness of their
    position loops, F the cable force that the set points hold and that is fed forward. An integral
    takes up to its largest force from that. Tensions are
    those without friction, which lets a vertex rest anywhere in its ``Settled.band``.

    Parameters
    ----------
    plan: with a hitch at all these times; or its motion.
    t: (…) [s]; its axes broadcast with those of the conditions.
    conditions: deviations from the team, one number or an array, with axes (…) of samples:
        ``cable_length`` (…, n) [m] under the planned tension, ``offsets`` of set points and errors
        of the feed-forward ``forces`` (…, 2n, 3) [m], [N]. Without samples: ``cable_density``
        [kg/m], ``load`` (clasps,) [kg], ``stiffness`` of position loops (2n,) or by axis (2n, 3)
        [N/m], infinite where rigid, ``integral`` and ``feed_forward`` of the controllers (2n,),
        ``axial_stiffness`` of cables, EA [N], and ``friction``, the coefficient at the clasps.

    Raises
    ------
    InputError: a time without hitch, or a condition that is wrong in itself.
    UnsupportedError: single drones, several teams, or objects that are carried.
    InfeasibleError: there is no rest.
    """
    check_instance("plan", plan, Plan, Motion)
    motion = plan.motion if isinstance(plan, Plan) else plan
    motion.refuse_several("settle", others=False)
    known = conditions_of(motion.team, **conditions)
    shape, samples = samples_of(motion, t, known)
    size = max(1, BLOCK // motion.team.robots)
    blocks = [
        _rest(motion.team, known, {name: v[i : i + size] for name, v in samples.items()})
        for i in range(0, len(samples["t"]), size)
    ]
    arrays = {name: np.concatenate([block[name] for block in blocks]) for name in blocks[0]}
    return Settled(motion.team, **{k: v.reshape((*shape, *v.shape[1:])) for k, v in arrays.items()})


def samples_of(
    motion: Motion, t: ArrayLike, known: Mapping[str, Any]
) -> tuple[tuple[int, ...], dict[str, Array]]:
    """Return the common shape of times and conditions, and the values of all samples (S, …).

    That is by name, as of ``States`` and ``conditions_of``; errors are those of ``settle``.
    """
    if not motion.team.has_cables:
        raise UnsupportedError("a plan of single drones has no cables that could settle")
    states = states_at(motion, t)
    if not np.all(states.formed):
        spans = [f"{p.start:g} to {p.end:g} s" for p in motion.phases if p.formed]
        bound = f"within a hitch: {', '.join(spans) or 'never in this plan'}"
        raise InputError("t", float(states.t[~states.formed].flat[0]), bound, "see its phases")
    carrying = np.any(states.borne > 0.0, axis=-1)
    if np.any(carrying):
        when = f"t = {float(states.t[carrying].flat[0]):.4g} s"
        raise UnsupportedError(f"{when}: statics do not know of objects that a hitch carries")
    axes = PLANNED | SAMPLED
    values = {name: vars(states)[name] if name in PLANNED else known[name] for name in axes}
    own = {name: v.shape[v.ndim - axes[name] :] for name, v in values.items()}
    shape = np.broadcast_shapes(*(v.shape[: v.ndim - axes[k]] for k, v in values.items()))
    return shape, {
        name: np.broadcast_to(v, (*shape, *own[name])).reshape((-1, *own[name]))
        for name, v in values.items()
    }


def energy_of(team: Team, known: Mapping[str, Any], samples: Mapping[str, Array]) -> HitchEnergy:
    """Return the energy of samples, see ``samples_of``."""
    layout = team.layout
    clasps = team.drones + np.arange(len(layout.clasps))
    points = np.zeros(layout.points, dtype=np.intp)
    points[-1] = team.drones - 1  # a chain's ends are its outer drones, nodes 0 and this
    points[layout.clasps] = clasps
    nodes = np.append(points, np.arange(team.drones))[layout.routes]
    drones, vertices = samples["positions"], samples["vertices"][:, layout.clasps]
    at = np.concatenate([drones, vertices], axis=1)[:, nodes]
    weight = GRAVITY * float(known["cable_density"])
    held = np.isinf(known["stiffness"])
    loads = np.zeros((len(at), team.drones + len(clasps), 3))
    fed = known["feed_forward"][:, None] * samples["cable_forces"]
    loads[:, : team.drones] = samples["forces"] - fed
    loads[:, team.drones :, 2] = -GRAVITY * known["load"]
    free = np.ones((team.drones + len(clasps), 3), dtype=np.bool_)
    free[: team.drones] = ~held
    return HitchEnergy(
        nodes,
        exist=layout.exists,
        points=points,
        free=free,
        start=np.concatenate([drones + samples["offsets"], vertices], axis=1),
        stiffness=np.where(held, 0.0, known["stiffness"]),
        integral=np.where(held, 0.0, known["integral"]),
        loads=loads,
        lengths=samples["cable_length"],
        weight=weight,
        compliance=team.cable_length / known["axial_stiffness"],
        reference=samples["tensions"],
        heights=0.5 * (at[:, :, 1, 2] + at[:, :, 2, 2]),
        least=weight * SAG_RATIO / 8.0 * np.max(length(np.diff(at, axis=2)), axis=-1),
    )


def _rest(
    team: Team, known: Mapping[str, Any], samples: Mapping[str, Array]
) -> dict[str, NDArray[Any]]:
    """Return the arrays of ``Settled`` for some samples."""
    energy = energy_of(team, known, samples)
    x = energy.settled()
    force = np.max(length(energy.slopes(x)), axis=1)
    if not np.max(force) <= LARGEST_RESIDUAL:  # nan as well
        worst = int(np.argmax(force))
        when, words = f"at t = {samples['t'][worst]:.4g} s", "finds no rest under these conditions"
        remedy = "give drones a stiffness, cables more length, or lead drones farther from vertices"
        broken = "settling", float(force[worst]), LARGEST_RESIDUAL, "max", "N", (), when, remedy
        raise InfeasibleError([Violation(*broken)], f"the hitch {words}")
    T, ends, points = energy.tensions(x), x[:, energy.nodes], energy.points
    missing = energy.forces(ends, T)[1] - energy.lengths
    missing -= energy.compliance * (T - energy.reference)
    slack = np.maximum(energy.least, SLACK_SHARE * energy.reference) >= T
    friction = float(known["friction"])
    tensions = T + energy.weight * energy.spans(ends)[2][..., 1]
    rests = [energy.rubbing(x, sense * friction)[:, points] for sense in (-1.0, 1.0)]
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
        "length_residual": np.max(np.where(slack, 0.0, np.abs(missing)), axis=-1),
    }


def _bearing(team: Team, energy: HitchEnergy, x: Array, tensions: Array) -> NDArray[np.bool_]:
    """Return (S, clasps) whether the two cables of each clasp press on each other.

    A cable's two spans pull on the other one, by half of their weight too, into their own bend.
    """
    bearing = np.ones((len(x), len(team.layout.clasps)), dtype=np.bool_)
    for cables, node, drone in ((team.layout.ahead, 1, 0), (team.layout.behind, 2, 3)):
        clasp, other, end = (x[:, energy.nodes[cables, k]] for k in (node, 3 - node, drone))
        leg, edge = end - clasp, other - clasp
        contact = -tensions[:, cables, None] * (unit(leg) + unit(edge))
        contact[..., 2] += 0.5 * energy.weight * (length(leg) + length(edge))
        bearing &= (dot(contact, leg) < 0.0) & (dot(contact, edge) < 0.0)
    return bearing
