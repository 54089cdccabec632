"""Where a plan's hitch comes to rest while its drones give way."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from hitchopt.errors import InfeasibleError, InputError, UnsupportedError, Violation
from hitchopt.hitch import GRAVITY
from hitchopt.motion.motion import Motion
from hitchopt.motion.states import States, states_at
from hitchopt.plan import Plan
from hitchopt.settling.cable_tension import CableLaw, least_tension
from hitchopt.settling.conditions import Conditions
from hitchopt.settling.energy_minimum import settled_nodes
from hitchopt.settling.hitch_energy import HitchEnergy
from hitchopt.settling.rigging import Rigging
from hitchopt.settling.settled_hitch import Settled, bearing, residuals
from hitchopt.values import Array, instance

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
    factor of up to ``exp(μβ)``, β the angle of the bend. Positions and tensions minimise an energy
    (``hitchopt.settling.hitch_energy``); the balance of forces is recomputed from them.

    Parameters
    ----------
    plan: with a hitch at all these times.
    t: (…) [s]; its axes broadcast with those of the conditions.
    conditions: the keywords of ``Conditions``, all optional: ``cable_length``, ``cable_density``,
        ``load``, ``stiffness``, ``integral``, ``feed_forward``, ``offsets``, ``forces``,
        ``axial_stiffness``.

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
    return Settled(
        team,
        t,
        x[:, : team.drones],
        x[:, energy.rigging.points],
        found,
        energy.law.hanging(spans, pulling),
        bearing(team, energy.rigging, x, found, energy.law.weight),
        positions,
        vertices,
        tensions,
        force,
        length,
    )
