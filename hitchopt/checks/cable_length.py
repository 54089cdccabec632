"""Check ``cable_length``: legs and edge use up the cable, and the stored legs are the true ones.

While clasped cables are drawn out, none may be torn before the hitch exists. From the second swap
on neighbours hold each other, so that a cable no longer runs straight between its drones: their
distance (``span``) says too little. Every cable then has to reach around the plan's vertices, which
stand for where the clasps may lie: where it does for some places of the clasps, no cable is taut.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from hitchopt.checks.bounds.bodies import bent_edges, concatenated, leg_vectors
from hitchopt.checks.bounds.rounding_margins import position_margin
from hitchopt.checks.bounds.wrapped_arcs import arc_at, arc_enclosure, wrapped_arcs
from hitchopt.checks.rule import CheckRule, Ease, Finder, Finding
from hitchopt.geometry.vectors import length
from hitchopt.hitch import GRAVITY
from hitchopt.motion.carried import saved_lengths
from hitchopt.motion.motion import CableState, Motion
from hitchopt.motion.phases import HITCHED_STATE
from hitchopt.motion.tensions import lowered, tautness
from hitchopt.trajectory import bernstein, enclosure
from hitchopt.trajectory.extremum import Cells, Estimate, largest
from hitchopt.values import Array

LIMIT = 1e-4
"""Relative: 0.2 mm of a cable of 2 m, well below what a knot or a strain of 0.5 N takes up."""

EXPORTED = 1e-3
"""Relative: what files that hold millimetres can keep of a plan's 1e-4."""


def _used_up(motion: Motion, _: float) -> Finding:
    """Return the largest relative error of a cable's length; ``where`` names the cable.

    The largest of ``|leg + edge + leg - L| / L`` and of how far the plan's own ``d_k`` and ``e_k``
    are from the distances that they stand for, over L as well. Where cables have weight, legs and
    edges are longer than their chords s by ``(ρ g / T)² s³ cos²α / 24``, α their slope; ρ counts to
    the share that the cable is taut. Where a rim is on the legs, their cables run level up to its
    edge, and are shorter than straight legs by ``saved_lengths``.
    """
    length = motion.team.cable_length
    blocks = [motion.legs.coefficients / length[:, None, None]]
    if motion.team.cable_density > 0.0:
        blocks.append(_sags(motion))
    return _largest(motion, blocks)


def _sags(motion: Motion) -> Array:
    """Return, per piece and cable, its weight over its own length, and its tension, in newtons."""
    team = motion.team
    weight = GRAVITY * team.cable_density * team.cable_length[:, None] * tautness(motion)
    return lowered(np.stack([weight, motion.tensions.coefficients], axis=2))


def _reaching(motion: Motion, _: float) -> Finding:
    """Return by how much a clasped cable is too short, over its length; ``where`` names it."""
    return _largest(motion, [])


def _largest(motion: Motion, stored: list[Array]) -> Finding:
    length = motion.team.cable_length
    legs = leg_vectors(motion)
    parts = [legs[:, 0::2], legs[:, 1::2]]
    blocks: list[Array] = []
    if motion.contacts is None:
        parts.append(bent_edges(motion)[0])
    else:
        parts += bent_edges(motion)
        blocks = [wrapped_arcs(motion) / length[:, None, None]]
    wrapped, saved = len(blocks), saved_lengths(motion)
    if saved is not None:
        blocks.append(saved[:, :, None] / length[:, None, None])
    rows = concatenated(parts, axis=2) / length[:, None, None]
    margin = 4.0 * position_margin(motion) / length  # of three lengths, and of their sum
    bound = partial(_bound, wrapped=wrapped, saved=len(blocks) - wrapped)
    cells = Cells.over(motion.drones.breaks, [rows, *blocks, *stored], margin)
    found = largest(cells, bound)
    return Finding(found.worst, found.time, (f"cable {found.item}",))


def _bound(blocks: tuple[Array, ...], wrapped: int = 0, saved: int = 0) -> Estimate:
    """Bound by how much lengths sum to more than 1; with stored legs, errors of any sign.

    Parameters
    ----------
    blocks: both legs and the edge (cells, 9, degree + 1), or both of its straight parts (cells, 12,
        …); then what ``wrapped_arcs`` and ``saved_lengths`` return, as often as ``wrapped`` and
        ``saved`` say; stored legs; sags.
    """
    vectors = blocks[0].reshape(len(blocks[0]), -1, 3, blocks[0].shape[-1])
    further = 1 + wrapped + saved
    bends, less, stored = (
        blocks[1 : 1 + wrapped],
        blocks[1 + wrapped : further],
        blocks[further:][:1],
    )
    sags = blocks[further + 1 :]
    lengths = enclosure.norm(vectors)
    arcs = [_arcs(vectors, lengths, sag) for sag in sags]
    arcs += [arc_enclosure(bend) for bend in bends]
    order = max(bernstein.degree(part) for part in (lengths.coefficients, *less, *stored))
    order = max(order, *(bernstein.degree(arc.coefficients) for arc in arcs), 0)
    parts = bernstein.elevate(lengths.coefficients, order)
    longer = [bernstein.elevate(arc.coefficients, order)[:, None] for arc in arcs]
    longer += [-bernstein.elevate(each, order) for each in less]
    reach = _errors(parts, tuple(bernstein.elevate(legs, order) for legs in stored), longer)
    reach[:, 0] += np.sum(lengths.radius, axis=1)[:, None]
    for arc in arcs:
        reach[:, 0] += arc.radius[:, None]
    reach[:, 1:] += lengths.radius[:, : reach.shape[1] - 1, None]
    index = np.argmax(np.max(reach, axis=1), axis=-1)
    x = index / max(1, order)
    spans = bernstein.evaluate_at(vectors, index[:, None, None], order)
    there = length(spans)
    given = tuple(bernstein.evaluate_at(legs, index[:, None], order)[..., None] for legs in stored)
    longer = [arc_at(bend, x)[:, None, None] for bend in bends]
    longer += [-bernstein.evaluate(each, x[:, None])[..., None] for each in less]
    for sag in sags:
        factor = _ratios_at(sag, x) ** 2
        level = _whole_spans(spans[..., None])[..., 0]
        arc_there = np.sum(there * (level[..., 0] ** 2 + level[..., 1] ** 2), axis=1)
        longer.append((factor / 24.0 * arc_there)[:, None, None])
    value = np.max(_errors(there[..., None], given, longer), axis=(1, 2))
    return Estimate(np.max(reach, axis=(1, 2), initial=0.0), np.maximum(value, 0.0), x)


def _ratios_at(sag: Array, x: Array) -> Array:
    """Return the weights over the tensions (cells,) at x; their limits where tensions vanish."""
    weight, tension = np.moveaxis(bernstein.evaluate(sag, x[:, None]), -1, 0)
    pulling = sag[:, 1] > 0.0
    last = sag.shape[-1] - 1 - np.argmax(pulling[:, ::-1], axis=1)
    nearest = np.where(x < 0.5, np.argmax(pulling, axis=1), last)  # that leads at the cell's end
    there = np.take_along_axis(sag, nearest[:, None, None], axis=-1)[..., 0]
    weight, tension = np.where(tension > 0.0, [weight, tension], there.T)
    ratios: Array = np.divide(weight, tension, out=np.zeros_like(weight), where=tension > 0.0)
    return ratios


def _whole_spans(vectors: Array) -> Array:
    """Return the spans that sag (cells, parts, 3, …): both straight parts of an edge sag as one."""
    if vectors.shape[1] == 3:
        return vectors
    edge = np.sum(vectors[:, 2:], axis=1, keepdims=True)
    return np.concatenate([vectors[:, :2], edge, edge], axis=1)


def _arcs(vectors: Array, lengths: enclosure.Enclosure, sag: Array) -> enclosure.Enclosure:
    """Enclose by how much the spans of a cable are longer than their chords (cells,)."""
    sagging = _whole_spans(vectors)[:, :, :2]
    level = bernstein.dot(sagging, sagging)
    product = np.sum(bernstein.multiply(lengths.coefficients, level), axis=1)
    radius = np.sum(lengths.radius * np.max(np.abs(level), axis=-1), axis=1)
    # A quotient of polynomials lies between those of their coefficients, the divisor positive. A
    # weight that rises with the tension has the same ratio to it where both vanish.
    weight, tension = sag[:, 0], sag[:, 1]
    pulling = tension > 0.0
    ratios = np.divide(weight, tension, out=np.zeros_like(weight), where=pulling)
    most = np.max(ratios, axis=-1)
    least = np.min(np.where(pulling, ratios, most[:, None]), axis=-1)
    most, least = most * most / 24.0, least * least / 24.0
    middle, spread = 0.5 * (most + least), 0.5 * (most - least)
    whole = np.max(np.abs(product), axis=-1) + radius
    return enclosure.Enclosure(middle[:, None] * product, middle * radius + spread * whole)


def _errors(lengths: Array, stored: tuple[Array, ...], longer: list[Array]) -> Array:
    """Return the error of the sum, and those of stored legs (cells, 1 or 3, coefficients).

    Parameters
    ----------
    longer: (cells, 1, coefficients), by how much cables are longer than the sum of their spans.
    """
    excess: Array = np.sum(lengths, axis=1, keepdims=True) - 1.0
    for arcs in longer:
        excess = excess + arcs
    if stored:
        excess = np.abs(np.concatenate([excess, stored[0] - lengths[:, :2]], axis=1))
    return excess


RULE = CheckRule(
    "cable_length",
    "1",
    "max",
    LIMIT,
    (
        Finder(_used_up, HITCHED_STATE, exported=True),
        Finder(_reaching, frozenset({CableState.TIGHTENING})),
    ),
    free_remedy="use a longer cable, or a smaller polygon",
    ease=Ease.LENGTH,
    exported_limit=EXPORTED,
)
