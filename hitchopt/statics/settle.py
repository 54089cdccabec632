"""Where a plan's hitch comes to rest while its drones give way, with friction or without.

Residuals of what has settled are recomputed from positions and tensions alone, without the energy
whose minimum the solver looks for.

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
from hitchopt.hitch import GRAVITY, Team
from hitchopt.hitch.forces import undetermined_tension
from hitchopt.motion.motion import Motion
from hitchopt.motion.states import States, states_at
from hitchopt.plan import Plan
from hitchopt.statics.energy import (
    INCIDENCE,
    LEAST_STIFFNESS,
    ROUNDED_FORCE,
    CableLaw,
    HitchEnergy,
    Rigging,
    Spans,
    add_at_nodes,
    least_tension,
    settled_nodes,
)
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
"""Tension over the planned one up to which the length of a cable is not compared: it is slack."""


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


def residuals(energy: HitchEnergy, x: Array, tensions: Array) -> tuple[Array, Array]:
    """Return the largest force without balance (S,) [N] and error of a taut cable's length [m].

    A span of length s and level length h, with the tension m at the height of its chord's middle,
    pulls its two ends along its chord with ``m - w² h²/(24 m)``, less ``w² s/(12 m)`` times its
    level part; it puts half of its arc's weight on each. Where m is less than the least tension at
    which a cable is taut, arcs are those at that tension, and the force is linear in m.

    Parameters
    ----------
    energy: what is known of drones, cables and loads.
    x: (S, nodes, 3) [m]
    tensions: (S, n) [N], at the heights of the edges' middles.
    """
    rigging, law = energy.rigging, energy.law
    forces = energy.forces.copy()
    soft = np.flatnonzero(rigging.free[: rigging.drones])
    away = (energy.places - x[:, : rigging.drones])[:, soft]
    forces[:, soft] += energy.stiffness[soft, None] * away
    lengths = np.zeros(tensions.shape)
    edges = 0.5 * (x[:, rigging.nodes[:, 1], 2] + x[:, rigging.nodes[:, 2], 2])
    for part in range(3):
        cables = np.flatnonzero(rigging.spans[:, part])
        first, second = rigging.nodes[cables, part], rigging.nodes[cables, part + 1]
        chord = x[:, second] - x[:, first]
        s, h = (np.sqrt(np.sum(chord[..., :axes] ** 2, axis=-1)) for axes in (3, 2))
        middle = 0.5 * (x[:, first, 2] + x[:, second, 2])
        m = tensions[:, cables] + law.weight * (middle - edges[:, cables])
        held = np.maximum(m, law.least[:, cables])
        held = np.where(held > 0.0, held, np.inf)
        sag = law.weight**2 / (24.0 * held**2)
        bent = sag * (2.0 * held - m) if law.weight > 0.0 else np.zeros_like(m)
        force = ((m - bent * h**2) / s)[..., None] * chord
        force[..., :2] -= (2.0 * bent * s)[..., None] * chord[..., :2]
        add_at_nodes(forces, first, force)
        add_at_nodes(forces, second, -force)
        arc = s + sag * s * h**2
        for end in (first, second):
            add_at_nodes(forces[..., 2], end, -0.5 * law.weight * arc)
        lengths[:, cables] += arc
    free = np.sqrt(np.sum(forces**2, axis=-1))[:, rigging.free]
    lower = tensions - law.weight * (edges - law.heights)  # at the reference height
    stretched = law.lengths + law.compliance * (lower - law.reference)
    taut = (lower > law.least) & (lower > SLACK_SHARE * law.reference)
    wrong = np.where(taut, np.abs(lengths - stretched), 0.0)
    return np.max(free, axis=-1, initial=0.0), np.max(wrong, axis=-1)


def bearing(
    team: Team, rigging: Rigging, x: Array, tensions: Array, weight: float
) -> NDArray[np.bool_]:
    """Return (S, clasps) whether the two cables of each clasp press on each other.

    The force C with which the other cable acts on a cable is what that cable's two spans pull with,
    and half of their weight, turned round; it has to point into the cable's bend.

    Parameters
    ----------
    x: (S, nodes, 3) [m]
    tensions: (S, n) [N]
    weight: of the cables per length [N/m].
    """
    layout = team.layout
    found = np.ones((len(x), len(layout.clasps)), dtype=np.bool_)
    for cables, node in ((layout.ahead, 1), (layout.behind, 2)):
        here = rigging.nodes[cables]
        to_drone = x[:, here[:, node - 1 if node == 1 else 3]] - x[:, here[:, node]]
        to_edge = x[:, here[:, 3 - node]] - x[:, here[:, node]]
        sizes = [np.linalg.norm(part, axis=-1, keepdims=True) for part in (to_drone, to_edge)]
        leg, edge = to_drone / sizes[0], to_edge / sizes[1]
        contact = -tensions[:, cables, None] * (leg + edge)
        contact[..., 2] += 0.5 * weight * (sizes[0] + sizes[1])[..., 0]
        for direction in (leg, edge):
            found &= np.sum(contact * direction, axis=-1) < 0.0
    return found


SHARES = np.linspace(0.1, 1.0, 10)
"""Shares of the friction at which the hitch settles on the way to the ends of its band."""

BAND_STEPS = 20
"""Number of Newton iterations at each of them; three to five are usual."""

LARGEST_FORCE = 1e-7
"""[N] Largest force without balance at an end of the band, but for rounding of stiff cables."""

LONGEST_BAND_STEP = 0.1
"""[m] Longest step of a node."""

DIFFERENCE, STRETCH_SHARE = 1e-6, 1e-2
"""[m] Half width of the central differences of friction's forces, less where cables are so stiff
that it would be more than this share of their stretch."""


@dataclass(frozen=True, eq=False)
class Rubbing:
    """Friction at the clasps of a hitch.

    Attributes
    ----------
    energy: without friction, of S samples.
    friction: μ times the share of it that is used, positive where legs pull more than edges.
    """

    energy: HitchEnergy
    friction: float

    def forces(self, ends: Array) -> Array:
        """Return what friction adds to the slopes (…, S, n, 4, 3) [N] at the cables' nodes."""
        spans = Spans.between(ends, self.energy.rigging.spans)
        law = self.energy.law
        pulls = law.pulls(spans, law.tensions(spans))
        along = spans.directions
        cosines = np.sum(along[..., 1:, :] * along[..., :-1, :], axis=-1)
        bends = np.arccos(np.clip(cosines, -1.0, 1.0))
        factors = np.expm1(self.friction * bends)
        added = np.zeros(pulls.shape)
        added[..., (0, 2), :] = factors[..., None] * pulls[..., (0, 2), :]
        return np.asarray(np.einsum("pa,...pi->...ai", INCIDENCE, added))

    def slopes(self, x: Array) -> Array:
        """Return minus the force on every node (S, nodes, 3) [N]; zero on those that are held."""
        slopes = self.energy.slopes(x)
        nodes = self.energy.rigging.nodes
        add_at_nodes(slopes, nodes, self.forces(x[:, nodes]))
        return np.where(self.energy.rigging.free[:, None], slopes, 0.0)

    def newton_steps(self, x: Array, slopes: Array) -> Array:
        """Return the Newton steps (S, nodes, 3) [m], none of them too long."""
        ends = x[:, self.energy.rigging.nodes]
        law = self.energy.law
        stretch = float(np.min(law.compliance) * np.min(law.reference))
        width = min(DIFFERENCE, STRETCH_SHARE * stretch) or DIFFERENCE
        moved = width * np.eye(12).reshape(12, 1, 1, 4, 3)
        apart = self.forces(ends + moved) - self.forces(ends - moved)
        columns = apart.reshape(*apart.shape[:3], 12) / (2.0 * width)
        added = np.moveaxis(columns, 0, -1)
        diagonal = np.tile(self.energy.diagonal + LEAST_STIFFNESS, (len(x), 1))
        steps = -self.energy.rigging.factor(self.energy.blocks(x) + added, diagonal).solve(slopes)
        longest = np.max(np.linalg.norm(steps, axis=-1), axis=1)
        shorter = np.minimum(1.0, LONGEST_BAND_STEP / np.maximum(longest, 1e-300))
        return np.asarray(steps * shorter[:, None, None])


def rubbing_nodes(energy: HitchEnergy, rest: Array, friction: float) -> Array:
    """Return the nodes (S, nodes, 3) [m] at an end of the band; nan where no rest is found.

    Parameters
    ----------
    energy: of S samples.
    rest: (S, nodes, 3) [m], where they rest without friction.
    friction: coefficient, positive for legs that pull more than edges, negative for less.
    """
    x, lost = rest, np.zeros(len(rest), dtype=np.bool_)
    rounded = 10.0 * ROUNDED_FORCE / np.min(energy.law.compliance) * np.max(np.abs(rest))
    for share in SHARES:
        rubbing = Rubbing(energy, friction * share)
        for _ in range(BAND_STEPS):
            slopes = rubbing.slopes(x)
            moving = ~lost & ~(np.max(np.abs(slopes), axis=(1, 2)) <= LARGEST_FORCE + rounded)
            if not np.any(moving):
                break
            x = np.where(moving[:, None, None], x + rubbing.newton_steps(x, slopes), x)
        else:
            lost |= moving
            x = np.where(lost[:, None, None], rest, x)
    return np.where(lost[:, None, None], np.nan, x)


LARGEST_RESIDUAL = 1e-6
"""[N] Largest force without balance of a solution that is returned."""

NO_LEG = 1e-4
"""[m] Length below which a leg has no direction: its drone has come to its vertex."""

NODES = 40_000
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
    team = motion.team
    states = hitched_states(motion, t)
    lengths = conditions.lengths(team)
    offsets, forces = conditions.errors("offsets", team), conditions.errors("forces", team)
    shape = np.broadcast_shapes(
        states.t.shape, lengths.shape[:-1], offsets.shape[:-2], forces.shape[:-2]
    )

    def samples(values: Array, axes: int) -> Array:
        inner = values.shape[values.ndim - axes :]
        return np.broadcast_to(values, (*shape, *inner)).reshape((-1, *inner))

    given = [
        samples(states.t, 0),
        samples(states.positions, 2),
        samples(states.vertices, 2),
        samples(states.tensions, 1),
        samples(states.cable_forces, 2),
        samples(lengths, 1),
        samples(offsets, 2),
        samples(forces, 2),
    ]
    size = max(1, NODES // team.robots)
    blocks = [
        _settled(motion, conditions, *(values[first : first + size] for values in given))
        for first in range(0, len(given[0]), size)
    ]
    joined = {
        name: np.concatenate([getattr(block, name) for block in blocks])
        for name in vars(blocks[0])
        if name != "team"
    }
    parts: dict[str, Any] = {
        name: values.reshape((*shape, *values.shape[1:])) for name, values in joined.items()
    }
    return Settled(team=team, **parts)


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


def energy_of(
    motion: Motion,
    conditions: Conditions,
    positions: Array,
    vertices: Array,
    tensions: Array,
    cable_forces: Array,
    lengths: Array,
    offsets: Array,
    forces: Array,
) -> tuple[HitchEnergy, Array]:
    """Return the energy of S samples, and the nodes (S, nodes, 3) [m] from which to start.

    Parameters
    ----------
    positions, vertices, tensions, cable_forces: the plan's (S, …).
    lengths, offsets, forces: (S, n) [m], (S, 2n, 3) [m], (S, 2n, 3) [N], those of the conditions.
    """
    team, weight = motion.team, GRAVITY * conditions.weight(motion.team)
    stiffness = conditions.drone_stiffness(team)
    rigging = Rigging.of(team, np.isinf(stiffness))
    places = positions + offsets
    start = np.concatenate([places, vertices[:, rigging.clasps]], axis=1)
    pushed = np.zeros(start.shape)
    fed = conditions.fed_forward(team)[:, None]
    pushed[:, : team.drones] = forces - np.where(fed, cable_forces, 0.0)
    pushed[:, team.drones :, 2] = -GRAVITY * conditions.loads(team)
    planned = np.concatenate([positions, vertices[:, rigging.clasps]], axis=1)
    ends = planned[:, rigging.nodes]
    chords = np.linalg.norm(np.diff(ends, axis=2), axis=-1)
    law = CableLaw(
        lengths,
        weight,
        team.cable_length / conditions.axial_stiffness,
        tensions,
        0.5 * (ends[:, :, 1, 2] + ends[:, :, 2, 2]),
        least_tension(weight, chords),
    )
    return HitchEnergy(rigging, law, places, stiffness, pushed), start


def _settled(
    motion: Motion,
    conditions: Conditions,
    t: Array,
    positions: Array,
    vertices: Array,
    tensions: Array,
    *others: Array,
) -> Settled:
    team = motion.team
    energy, start = energy_of(motion, conditions, positions, vertices, tensions, *others)
    x = settled_nodes(energy, start)
    spans = energy.spans(x)
    pulling = energy.law.tensions(spans)
    found = energy.law.middle_tensions(spans, pulling)[..., 1]
    force, length = residuals(energy, x, found)
    if not np.max(force) <= LARGEST_RESIDUAL:  # nan as well
        worst = int(np.argmax(force))
        remedy = "give drones a stiffness, or cables more length"
        short = np.where(energy.rigging.spans, spans.chords[worst], np.inf)
        if np.min(short) < NO_LEG:
            cable = int(np.argmin(np.min(short, axis=-1)))
            remedy = f"lead its drones farther out: a leg of cable c{cable} has no length left"
        when = f"at t = {t[worst]:.4g} s"
        limit = LARGEST_RESIDUAL
        broken = Violation("settling", float(force[worst]), limit, "max", "N", (), when, remedy)
        raise InfeasibleError([broken], "the hitch finds no rest under these conditions")
    friction, points = conditions.rubbing(team), energy.rigging.points
    ends = [rubbing_nodes(energy, x, sense * friction)[:, points] for sense in (-1.0, 1.0)]
    return Settled(
        team,
        t,
        x[:, : team.drones],
        x[:, points],
        np.stack(ends, axis=1),
        found,
        energy.law.hanging(spans, pulling),
        bearing(team, energy.rigging, x, found, energy.law.weight),
        positions,
        vertices,
        tensions,
        force,
        length,
    )
