"""Where a plan's hitch comes to rest while its drones give way, with friction or without.

Forces without balance are recomputed from positions and tensions that are returned.

By the capstan's law a leg may pull with up to ``e^{μθ}`` times what its cable's edge pulls with, or
with as little as ``e^{-μθ}`` times that; θ is the angle by which the cable bends at the clasp. The
ends of the band of rest are where all clasps use their friction fully in one sense, as they do when
a hitch is drawn taut or let out: legs pull more than edges, or less. They are reached from the rest
without friction, in small steps of the share of friction that is used, by Newton's method.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hitchopt.errors import InfeasibleError, InputError, OneLine, UnsupportedError, Violation
from hitchopt.geometry.vectors import dot, length, unit
from hitchopt.hitch import GRAVITY, Team
from hitchopt.hitch.forces import undetermined_tension
from hitchopt.motion.motion import Motion
from hitchopt.motion.states import States, states_at
from hitchopt.plan import Plan
from hitchopt.statics.energy import HitchEnergy, hitch_energy, rubbing_nodes, settled_nodes
from hitchopt.values import Array, instance, not_negative, positive

AXIAL_STIFFNESS = 1e4
"""[N] EA of a braided polyethylene line of 1 mm: at 0.5 N it is longer by 5e-5. Cables that are
all but inextensible; without any stretch the tension between rigid drones would be undetermined."""

FRICTION = (
    "tensions are those without friction at the clasps: where the cable bends by β they may differ "
    "by a factor of up to exp(friction·β); each vertex rests somewhere in its band"
)
"""What is to be known of a team whose cables rub."""


@dataclass(frozen=True, eq=False)
class Conditions:
    """Lengths, weights, loads, controllers and errors; whatever is None is the team's.

    Leading axes (…) are samples; they broadcast with each other and with the times.

    Parameters
    ----------
    cable_length: real lengths [m] under the planned tension, one, (n,) or (…, n).
    cable_density: [kg/m]
    load: masses that hang at the clasps [kg], one, or (clasps,).
    stiffness: of the drones' position loops [N/m], one or (2n,); infinite where they are rigid.
    integral: whether the controllers drive position errors to zero.
    feed_forward: whether the controllers add the cable force that the set points hold.
    offsets: errors of the drones' set points (…, 2n, 3) [m].
    forces: errors of the force feed-forward (…, 2n, 3) [N].
    axial_stiffness: EA of the cables [N].
    friction: coefficient where one cable slides about the other; it makes bands of rest.

    Raises
    ------
    InputError: a number out of its range.
    """

    cable_length: ArrayLike | None = None
    cable_density: float | None = None
    load: ArrayLike | None = None
    stiffness: ArrayLike | None = None
    integral: bool | None = None
    feed_forward: bool | None = None
    offsets: ArrayLike = 0.0
    forces: ArrayLike = 0.0
    axial_stiffness: float = AXIAL_STIFFNESS
    friction: float | None = None

    def __post_init__(self) -> None:
        set_ = object.__setattr__
        set_(self, "axial_stiffness", positive("axial_stiffness", self.axial_stiffness))
        if self.cable_density is not None:
            set_(self, "cable_density", not_negative("cable_density", self.cable_density))
        if self.friction is not None:
            set_(self, "friction", not_negative("friction", self.friction))

    def lengths(self, team: Team) -> Array:
        """Return (…, n) [m]."""
        given = team.cable_length if self.cable_length is None else self.cable_length
        return _array("cable_length", given, (team.robots,), least=0.0)

    def weight(self, team: Team) -> float:
        """Return the weight of the cables without gravity [kg/m]."""
        return team.cable_density if self.cable_density is None else self.cable_density

    def rubbing(self, team: Team) -> float:
        """Return the coefficient of friction at the clasps."""
        return team.cable_friction if self.friction is None else self.friction

    def loads(self, team: Team) -> Array:
        """Return (clasps,) [kg]."""
        given = team.load if self.load is None else self.load
        return _array("load", given, (len(team.layout.clasps),), least=-1e-300)

    def drone_stiffness(self, team: Team) -> Array:
        """Return (2n,) [N/m]; infinite where a drone stands at its set point whatever the force."""
        given = team.stiffness if self.stiffness is None else self.stiffness
        try:
            stiffness = np.broadcast_to(np.asarray(given, np.float64), (team.drones,))
        except ValueError:
            stiffness = np.zeros(team.drones)
        if not np.all(stiffness > 0.0):
            bound = f"one positive number, or {team.drones} of them"
            raise InputError("stiffness", given, bound, "inf is rigid")
        integral = team.integral if self.integral is None else self.integral
        return np.where(integral, np.inf, stiffness)

    def fed_forward(self, team: Team) -> NDArray[np.bool_]:
        """Return (2n,), whether the drones' controllers add the cable force."""
        given = team.feed_forward if self.feed_forward is None else self.feed_forward
        return np.broadcast_to(np.asarray(given, np.bool_), (team.drones,))

    def notes(self, team: Team) -> tuple[str, ...]:
        """Return why the plan does not determine the tensions, and what else is to be known."""
        integral = team.integral if self.integral is None else np.array(self.integral)
        notes = undetermined_tension(
            integral=bool(np.any(integral)), feed_forward=bool(np.all(self.fed_forward(team)))
        )
        if self.rubbing(team) > 0.0:
            notes += (FRICTION,)
        return notes

    def errors(self, name: str, team: Team) -> Array:
        """Return the ``offsets`` or ``forces`` (…, 2n, 3)."""
        given: Any = getattr(self, name)
        return _array(name, given, (team.drones, 3))


def _array(name: str, given: ArrayLike, shape: tuple[int, ...], least: float = -np.inf) -> Array:
    """Return values of shape (…, *shape); one number stands for all.

    Raises
    ------
    InputError: another shape, or a number that is not finite or not above ``least``.
    """
    values = np.asarray(given, dtype=np.float64)
    if values.ndim == 0:
        values = np.broadcast_to(values, shape)
    if values.shape[-len(shape) :] != shape:
        raise InputError(name, values.shape, f"one number, or of shape (…, {shape})", "see help")
    if not np.all(np.isfinite(values) & (values > least)):
        bound = "finite" if least == -np.inf else "finite and positive"
        raise InputError(name, "an entry", bound, "give plain numbers in SI units")
    return values


SLACK_SHARE = 1e-6
"""Tension over the planned one up to which a cable is slack, its length not compared."""


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
        less than edges and more; both are ``vertices`` without friction, nan where none is found.
    tensions: (…, n) [N], at the heights of the edges' middles.
    slack: (…, n) whether a cable is slack: it does not pull, or hangs by more than a quarter of one
        of its spans.
    bears: (…, clasps) whether the two cables of a clasp press on each other.
    planned_drones, planned_vertices, planned_tensions: what the plan says at those times.
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
    def displacements(self) -> Array:
        """(…, points) [m]: distance of every vertex from the planned one."""
        found: Array = np.linalg.norm(self.vertices - self.planned_vertices, axis=-1)
        return found

    @property
    def band(self) -> Array:
        """(…, points, 2) [m]: how far outside of its plan every vertex can rest, least and most.

        Outside is away from the neighbouring vertices, along the bisector; inside is negative. The
        band is infinite where no rest is found with friction fully used in that sense.
        """
        outward = outward_directions(self.team, self.planned_vertices)
        places = np.stack([self.vertices, *np.moveaxis(self.rests, -3, 0)], axis=-2)
        apart = places - self.planned_vertices[..., None, :]
        out = np.sum(apart * outward[..., None, :], axis=-1)
        lost = np.isnan(out)
        least = np.min(np.where(lost, -np.inf, out), axis=-1)
        most = np.max(np.where(lost, np.inf, out), axis=-1)
        return np.stack([least, most], axis=-1)

    @property
    def slack_cables(self) -> tuple[str, ...]:
        """Names of the cables that are slack in any sample: c0, c1, …."""
        return named("c", self.slack)

    @property
    def loose_clasps(self) -> tuple[str, ...]:
        """Names of the points whose cables do not press on each other in some sample."""
        loose = ~self.bears.reshape(-1, self.bears.shape[-1]).all(axis=0)
        return tuple(f"p{k}" for k in self.team.layout.clasps[loose])


def outward_directions(team: Team, vertices: Array) -> Array:
    """Return the units (…, points, 3) from the vertices away from their neighbours' middle."""
    ahead = np.roll(vertices, -1, axis=-2) - vertices
    ahead /= np.linalg.norm(ahead, axis=-1, keepdims=True)
    behind = -np.roll(ahead, 1, axis=-2)
    if not team.layout.closed:
        ahead[..., -1, :] = 0.0
        behind[..., 0, :] = 0.0
    outward = -(ahead + behind)
    sizes = np.linalg.norm(outward, axis=-1, keepdims=True)
    return np.asarray(outward / np.where(sizes > 0.0, sizes, 1.0))


def named(letter: str, flags: NDArray[np.bool_]) -> tuple[str, ...]:
    """Return the names of the columns of flags (…, n) in which any is set."""
    columns: Sequence[int] = np.flatnonzero(flags.reshape(-1, flags.shape[-1]).any(axis=0)).tolist()
    return tuple(f"{letter}{k}" for k in columns)


def bearing(team: Team, energy: HitchEnergy, x: Array, tensions: Array) -> NDArray[np.bool_]:
    """Return (S, clasps) whether the two cables of each clasp press on each other.

    The force with which the other cable acts on a cable is what that cable's two spans pull with,
    and half of their weight, turned round; it has to point into the cable's bend.

    Parameters
    ----------
    x: (S, nodes, 3) [m]
    tensions: (S, n) [N], in the edges' middles.
    """
    found = np.ones((len(x), len(team.layout.clasps)), dtype=np.bool_)
    for cables, node, drone in ((team.layout.ahead, 1, 0), (team.layout.behind, 2, 3)):
        clasp, other, end = (x[:, energy.nodes[cables, k]] for k in (node, 3 - node, drone))
        leg, edge = end - clasp, other - clasp
        contact = -tensions[:, cables, None] * (unit(leg) + unit(edge))
        contact[..., 2] += 0.5 * energy.law.weight * (length(leg) + length(edge))
        found &= (dot(contact, leg) < 0.0) & (dot(contact, edge) < 0.0)
    return found


LARGEST_RESIDUAL = 1e-6
"""[N] Largest force without balance of a solution that is returned."""

NO_LEG = 1e-4
"""[m] Length below which a leg has no direction: its drone has come to its vertex."""

BLOCK = 4000
"""Cables of all samples that are solved for at once, which bounds the memory."""


def settle(plan: Plan, t: ArrayLike, **conditions: Any) -> Settled:
    """Return where drones and vertices of a plan's hitch come to rest, and with what tensions.

    Drones stand at their set points, offset by ``(F + cable force)/k``: k is the stiffness of their
    position loops, F the cable force that the set points hold and that is fed forward. Cables are
    held by clasps without friction, one tension a cable: friction at a clasp lets it change by a
    factor of up to ``exp(μβ)``, β the angle of the bend, so that a vertex rests anywhere in its
    ``Settled.band``. Positions and tensions minimise an energy
    (``hitchopt.statics.energy``); the balance of forces is recomputed from them.

    Parameters
    ----------
    plan: with a hitch at all these times.
    t: (…) [s]; its axes broadcast with those of the conditions.
    conditions: the keywords of ``Conditions``, all optional: ``cable_length``, ``cable_density``,
        ``load``, ``stiffness``, ``integral``, ``feed_forward``, ``offsets``, ``forces``,
        ``axial_stiffness``, ``friction``.

    Raises
    ------
    InputError: a time without hitch, or a condition that is wrong in itself.
    UnsupportedError: single drones.
    InfeasibleError: no rest is found.
    """
    instance("plan", plan, Plan)
    return settle_motion(plan.motion, t, Conditions(**conditions))


def settle_motion(motion: Motion, t: ArrayLike, conditions: Conditions) -> Settled:
    """Return where the hitch of a motion comes to rest; see ``settle``."""
    shape, samples = samples_of(motion, t, conditions)
    size = max(1, BLOCK // motion.team.robots)
    blocks = [
        _settled(motion, conditions, [values[first : first + size] for values in samples])
        for first in range(0, len(samples[0]), size)
    ]
    joined = {
        name: np.concatenate([getattr(block, name) for block in blocks])
        for name in vars(blocks[0])
        if name != "team"
    }
    parts: dict[str, Any] = {
        name: values.reshape((*shape, *values.shape[1:])) for name, values in joined.items()
    }
    return Settled(team=motion.team, **parts)


def hitched_states(motion: Motion, t: ArrayLike) -> States:
    """Return the states at times (…) [s], or raise an error unless the hitch exists at all of them.

    Raises
    ------
    InputError: a time without hitch.
    UnsupportedError: single drones.
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
    return states


def samples_of(
    motion: Motion, t: ArrayLike, conditions: Conditions
) -> tuple[tuple[int, ...], list[Array]]:
    """Return the shape of times and conditions together, and the arrays (S, …) of all samples.

    The arrays are times [s], the plan's positions (2n, 3), vertices (points, 3) [m], tensions (n)
    and cable forces (2n, 3) [N], then lengths (n), offsets (2n, 3) [m] and forces (2n, 3) [N] of
    the conditions.
    """
    team, states = motion.team, hitched_states(motion, t)
    given = (
        (states.t, 0),
        (states.positions, 2),
        (states.vertices, 2),
        (states.tensions, 1),
        (states.cable_forces, 2),
        (conditions.lengths(team), 1),
        (conditions.errors("offsets", team), 2),
        (conditions.errors("forces", team), 2),
    )
    inner = [values.shape[values.ndim - axes :] for values, axes in given]
    shape = np.broadcast_shapes(*(v.shape[: v.ndim - axes] for v, axes in given))
    return shape, [
        np.broadcast_to(values, (*shape, *own)).reshape((-1, *own))
        for (values, _), own in zip(given, inner, strict=True)
    ]


def energy_of(
    motion: Motion, conditions: Conditions, samples: Sequence[Array]
) -> tuple[HitchEnergy, Array]:
    """Return the energy of samples, see ``samples_of``, and the nodes to start from [m]."""
    team = motion.team
    _, positions, vertices, tensions, cable_forces, lengths, offsets, forces = samples
    weights = np.zeros((len(team.layout.clasps), 3))
    weights[:, 2] = -GRAVITY * conditions.loads(team)
    fed = conditions.fed_forward(team)[:, None]
    return hitch_energy(
        team,
        conditions.drone_stiffness(team),
        (positions, vertices),
        tensions,
        lengths,
        GRAVITY * conditions.weight(team),
        conditions.axial_stiffness,
        positions + offsets,
        (forces - np.where(fed, cable_forces, 0.0), weights),
    )


def _settled(motion: Motion, conditions: Conditions, samples: Sequence[Array]) -> Settled:
    team = motion.team
    energy, start = energy_of(motion, conditions, samples)
    law, x = energy.law, settled_nodes(energy, start)
    ends = x[:, energy.nodes]
    T = law.tensions(ends)
    _, sizes, heights = law.spans(ends)
    force = np.max(length(energy.slopes(x)), axis=1)
    if not np.max(force) <= LARGEST_RESIDUAL:  # nan as well
        worst = int(np.argmax(force))
        remedy = "give drones a stiffness, or cables more length"
        short = np.min(np.where(law.exist, sizes[worst], np.inf), axis=-1)
        if np.min(short) < NO_LEG:
            cable = int(np.argmin(short))
            remedy = f"lead its drones farther out: a leg of cable c{cable} has no length left"
        when = f"at t = {samples[0][worst]:.4g} s"
        limit = LARGEST_RESIDUAL
        broken = Violation("settling", float(force[worst]), limit, "max", "N", (), when, remedy)
        raise InfeasibleError([broken], "the hitch finds no rest under these conditions")
    missing = law.forces(ends, T)[1] - law.lengths - law.compliance * (T - law.reference)
    pulling = SLACK_SHARE * law.reference < T
    taut = pulling & (law.least < T)
    friction, points = conditions.rubbing(team), energy.points
    rests = [rubbing_nodes(energy, x, sense * friction)[:, points] for sense in (-1.0, 1.0)]
    tensions = T + law.weight * heights[..., 1]
    return Settled(
        team,
        samples[0],
        x[:, : team.drones],
        x[:, points],
        np.stack(rests, axis=1),
        tensions,
        ~pulling | law.hanging(ends, T),
        bearing(team, energy, x, np.where(pulling, tensions, 0.0)),
        samples[1],
        samples[2],
        samples[3],
        force,
        np.max(np.where(taut, np.abs(missing), 0.0), axis=-1),
    )
