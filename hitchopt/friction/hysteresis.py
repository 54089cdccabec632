"""Where friction holds the vertices of a hitch whose cables slide back and forth.

A cable sticks at its clasp as long as the coefficients x and y of both legs there, ``ln(T_leg /
T_edge)`` over the bends of their cables, are within the ellipse of ``twists``,

    x² + y² + 2 x y cos θ ≤ (μ sin θ)²,

where θ is the angle at which both cables cross. Slips maximise the dissipation: they are normal to
the ellipse. Ellipses of smaller friction are inside those of larger friction, and so are the rests.

Forces balance at every time, so rests depend on the order of the drones' positions, not on their
speed. In each step the leg lengths change by slips s, linear in the coefficients. With ``x + y =
2 μ a u`` and ``x - y = 2 μ b v``, where a and b are the sine and cosine of θ/2, the ellipse becomes
the unit disc, and the step ends where s, in these parts, is normal to the discs: a variational
inequality that projected gradient steps solve.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from hitchopt.hitch.energy import HitchEnergy, cosines_of, energy_of
from hitchopt.hitch.rest_errors import loops_of
from hitchopt.hitch.team import Layout, Team
from hitchopt.hitch.twists import half_axes
from hitchopt.values import Array

STICKING_STEPS = 12  # Newton steps to the balance without slips
SLIDING_STEPS = 12  # Newton steps to the balance with slips, from their linear prediction
ROUNDS = 2  # Linear steps of slips per sample
FIRST_STEPS = 30  # Newton steps to the balance at the start
MAX_STEP = 0.1  # [m] Largest displacement of a node in a step
MAX_RESIDUAL = 1e-3  # [N] Largest force residual of a balance
BALANCED = 0.01 * MAX_RESIDUAL  # [N] Largest slope at which Newton steps end
DAMPING = 1e-9  # [N/m] Damping of steps, as clasps of slack cables are free
PROJECTIONS = 300  # Largest number of projected gradient steps
CONVERGED = 1e-6  # Change of parts at which these end


@np.errstate(over="ignore", invalid="ignore")  # of friction that no balance bears
def held_vertices(team: Team, samples: Mapping[str, Array], frictions: Array, held: Array) -> Array:
    """Return vertices (S, F, points, 3) [m] in consecutive samples, for F coefficients of friction.

    Samples (S, …) are those of ``rest_errors.planned_rest``, from first to last. At the first one,
    clasps hold the shares ``held`` (F,) of the friction with which all legs pull more than their
    edges; 0 is the plan. Vertices are nan where forces have no balance.
    """
    count = len(frictions)
    loops = loops_of(team)
    parts = np.zeros((count, len(team.layout.clasps), 2))
    parts[..., 0] = held[:, None]
    nodes = planned = np.zeros(0)
    vertices = list[Array]()
    for i in range(len(samples["positions"])):
        sample = {name: np.repeat(x[i : i + 1], count, axis=0) for name, x in samples.items()}
        energy = energy_of(team, loops, sample)
        if not vertices:
            nodes = energy.at_rest()
            of_parts = _coefficients_of_parts(team.layout, energy, nodes, frictions)
            nodes = _balanced(energy, nodes, _friction(of_parts, parts), FIRST_STEPS)
        else:
            lengths = _leg_lengths(energy, nodes)
            nodes = nodes + energy.start - planned
            for _ in range(ROUNDS):
                of_parts = _coefficients_of_parts(team.layout, energy, nodes, frictions)
                nodes, parts = _slid(energy, nodes, lengths, of_parts, parts)
        planned = energy.start
        residuals = np.max(np.abs(energy.slopes(nodes, _friction(of_parts, parts))), axis=(1, 2))
        fails = ~(residuals <= MAX_RESIDUAL)[:, None, None]
        vertices.append(np.where(fails, np.nan, nodes[:, energy.points]))
    return np.array(vertices)


def _coefficients_of_parts(
    layout: Layout, energy: HitchEnergy, nodes: Array, frictions: Array
) -> Array:
    """Return matrices (F, 2n, 2 clasps) from parts u, v of all clasps to coefficients.

    The clasps' angles are those at nodes (F, nodes, 3) [m], means of both cables'.
    """
    cosines = cosines_of(energy.spans(nodes[:, energy.nodes]).directions).reshape(len(nodes), -1)
    ahead, behind = 2 * layout.ahead, 2 * layout.behind + 1
    alike, opposite = half_axes(np.clip(0.5 * (cosines[:, ahead] + cosines[:, behind]), -1.0, 1.0))
    clasps = np.arange(len(layout.clasps))
    matrices = np.zeros((len(nodes), 2 * layout.robots, 2 * len(clasps)))
    for legs, sign in ((ahead, 1.0), (behind, -1.0)):
        matrices[:, legs, 2 * clasps] = alike
        matrices[:, legs, 2 * clasps + 1] = sign * opposite
    return np.asarray(frictions[:, None, None] * matrices)


def _friction(of_parts: Array, parts: Array) -> Array:
    """Return the coefficients (F, n, 2) of all legs from parts (F, clasps, 2)."""
    coefficients = np.einsum("flp,fp->fl", of_parts, parts.reshape(len(parts), -1))
    return np.asarray(coefficients.reshape(len(parts), -1, 2))


def _leg_lengths(energy: HitchEnergy, nodes: Array) -> Array:
    """Return the chords (F, 2n) [m] of legs."""
    lengths = energy.spans(nodes[:, energy.nodes]).lengths[..., ::2]
    return np.asarray(lengths.reshape(len(nodes), -1))


def _balanced(energy: HitchEnergy, nodes: Array, friction: Array, steps: int) -> Array:
    """Return nodes (F, nodes, 3) [m] after Newton steps to the balance with friction (F, n, 2)."""
    for _ in range(steps):
        moves = energy.steps(nodes, DAMPING, MAX_STEP, friction, BALANCED)[0]
        if not np.any(moves):
            break
        nodes = nodes + moves
    return nodes


def _slid(
    energy: HitchEnergy, nodes: Array, lengths: Array, of_parts: Array, parts: Array
) -> tuple[Array, Array]:
    """Return nodes and parts after slips from leg lengths (F, 2n) [m]."""
    friction = _friction(of_parts, parts)
    nodes = _balanced(energy, nodes, friction, STICKING_STEPS)
    responses, shortening = _responses(energy, nodes, friction)
    growth = _leg_lengths(energy, nodes) - lengths
    slips = np.einsum("flp,fl->fp", of_parts, growth)
    stiffness = np.einsum("fap,fab,fbq->fpq", of_parts, shortening, of_parts)
    new = _in_discs(slips, stiffness, parts.reshape(len(parts), -1)).reshape(parts.shape)
    change = _friction(of_parts, new - parts).reshape(len(nodes), -1)
    nodes = nodes + np.einsum("fnil,fl->fni", responses, change)
    return _balanced(energy, nodes, _friction(of_parts, new), SLIDING_STEPS), new


def _responses(energy: HitchEnergy, nodes: Array, friction: Array) -> tuple[Array, Array]:
    """Return derivatives of nodes (F, nodes, 3, 2n) [m] by the coefficients of legs.

    The second array (F, 2n, 2n) [m] is by how much these coefficients shorten the legs.
    """
    bends = energy.bends(nodes)
    pulls = energy.leg_pulls(nodes) * (bends * np.exp(friction * bends))[..., None]
    by_leg = np.moveaxis(pulls.reshape(len(nodes), -1, 3), 1, 0)
    starts, ends = energy.nodes[:, [0, 2]].ravel(), energy.nodes[:, [1, 3]].ravel()
    legs = np.arange(len(starts))
    forces = np.zeros((*nodes.shape, len(legs)))
    forces[:, starts, :, legs] += by_leg
    forces[:, ends, :, legs] -= by_leg
    matrix = energy.matrix(nodes, energy.linear(nodes, friction).forces, DAMPING)
    responses = energy.solved(matrix, forces)
    directions = energy.spans(nodes[:, energy.nodes]).directions[..., ::2, :]
    along = directions.reshape(len(nodes), -1, 3)
    shortening = np.einsum("fli,flik->flk", along, responses[:, starts] - responses[:, ends])
    return responses, shortening


def _in_discs(slips: Array, stiffness: Array, parts: Array) -> Array:
    """Return parts (F, 2 clasps) in unit discs to which remaining slips are normal.

    Without a change of the parts, these slips are ``slips`` (F, 2 clasps) [m]; ``stiffness`` (F,
    2 clasps, 2 clasps) [m] is by how much parts reduce them.
    """
    rate = 1.0 / np.maximum(np.linalg.norm(stiffness, axis=(1, 2)), 1e-12)[:, None]
    reduced = rate[..., None] * stiffness
    steps = rate * slips + np.einsum("fpq,fq->fp", reduced, parts)
    new = parts
    for _ in range(PROJECTIONS):
        moved = new + steps - (reduced @ new[..., None])[..., 0]
        u, v = moved[:, ::2], moved[:, 1::2]
        sizes = np.maximum(np.sqrt(u * u + v * v), 1.0)
        previous, new = new, moved / np.repeat(sizes, 2, axis=-1)
        if np.abs(new - previous).max() <= CONVERGED:
            break
    return new
