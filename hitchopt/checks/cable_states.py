"""Contradictions of the states of cables: on the ground, being clasped or tightened.

States claim that cables are free, at rest or slack. The checks derive this from the curves alone
and do not trust the names of phases.
"""

from __future__ import annotations

import numpy as np

from hitchopt.checks.cables import LENGTH_LIMIT
from hitchopt.checks.chords import chord_crossings
from hitchopt.checks.distances import Flags
from hitchopt.checks.hanging import above_ground
from hitchopt.checks.spans import clasped_pairs, edge_vectors, leg_vectors, pair_of
from hitchopt.geometry.vectors import dot, length
from hitchopt.hitch.forces import cable_of, weight_ratios
from hitchopt.motion.motion import Motion
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.values import Indices

MAX_DRIFT = 1e-3
"""[m] Largest motion of the midpoint of two drones that turn about each other, and largest distance
of a clasp from a straight line while cables are tightened."""

TINY = 1e-12  # [m²] Smallest divisor
MAX_SIDEWAYS = 1e-6  # [m] Largest horizontal motion of drones that move vertically

MAX_TAUT_SHARE = 0.5
"""Largest fraction of a tightening phase with cables at their full length: tightening comes to rest
there, which takes a few hundredths of its time."""

PROBES = np.linspace(0.0, 1.0, 9)
"""Local parameters of a piece, one of which shows that cables are slack."""


def contradictions(motion: Motion) -> Indices:
    """Return the cables and pairs that contradict the state of a motion with a single state.

    Without a hitch, legs are zero, and so are tensions unless cables are tightened. Cables on the
    ground, tightened cables and clasping pairs have rules of their own.
    """
    state = motion.phases[0].state
    wrong = np.zeros(motion.team.robots, dtype=np.bool_)
    if not motion.formed[0]:
        wrong = _differ_from_zero(motion, motion.legs)
    if not motion.pulling[0]:
        wrong |= _differ_from_zero(motion, motion.tensions, motion.pulls)
    if state.on_ground:
        wrong = wrong | _off_ground(motion)
    if state.tightening:
        wrong = wrong | _not_tightening(motion)
    cables = np.flatnonzero(wrong)
    items = cables * (motion.team.robots + 1)  # as pairs of a cable with itself
    if state.clasping:
        items = np.concatenate([items, _wrong_clasping_pairs(motion)])
    return np.unique(items)


def _differ_from_zero(motion: Motion, *curves: PiecewisePolynomial) -> Flags:
    """Return the cables (n,) on which one of some curves (n, …) is not zero."""
    has_values = np.zeros(motion.team.robots, dtype=np.bool_)
    for curve in curves:
        largest = np.max(np.abs(curve.coefficients), axis=(0, -1))
        has_values |= np.any(largest.reshape(len(has_values), -1) > 0.0, axis=1)
    return has_values


def _off_ground(motion: Motion) -> Flags:
    """Return the cables (n,) that contradict lying on the ground.

    Drones move only vertically, and some cable is closer to the ground than one may be that hangs.
    """
    level = motion.drones.coefficients[:, :, :2]
    travel = np.ptp(level, axis=(0, -1)).reshape(motion.team.robots, -1)
    moves_sideways = np.any(travel > MAX_SIDEWAYS, axis=1)
    return np.asarray(moves_sideways | above_ground(motion))


def _not_tightening(motion: Motion) -> Flags:
    """Return all cables (n,) unless they are slack for most of the time, and clasps go straight."""
    is_wrong = _taut_share(motion) > MAX_TAUT_SHARE or _detour(motion) > MAX_DRIFT
    return np.full(motion.team.robots, is_wrong)


def _detour(motion: Motion) -> float:
    """Return the largest distance [m] of a vertex from the straight line between its ends."""
    vertices = np.moveaxis(motion.vertices.coefficients, -1, 1)  # (pieces, degree + 1, points, 3)
    start, end = vertices[0, 0], vertices[-1, -1]
    along = end - start
    shares = dot(vertices - start, along) / np.maximum(dot(along, along), TINY)
    nearest = start + np.clip(shares, 0.0, 1.0)[..., None] * along
    return float(np.max(length(vertices - nearest)))


def _wrong_clasping_pairs(motion: Motion) -> Indices:
    """Return the pairs that contradict clasping.

    Some chords cross, and drones at a clasp turn about a fixed point.
    """
    layout = motion.team.layout
    pairs: Indices = clasped_pairs(layout)
    crossings = chord_crossings(motion.drones)
    crossed = pair_of(layout, crossings.first, crossings.second)
    if not np.any(np.isin(crossed, pairs)):
        return pairs
    drones = motion.drones.coefficients
    centres = 0.5 * (drones[:, 2 * layout.ahead] + drones[:, 2 * layout.behind + 1])
    drifts = np.max(np.ptp(centres, axis=(0, -1)), axis=-1)
    drifting: Indices = pairs[drifts > MAX_DRIFT]
    return drifting


def _taut_share(motion: Motion) -> float:
    """Return the fraction of time in which cables are not provably slack around the vertices.

    Lengths are weighted by tensions: their sum is smallest where taut cables balance, so no choice
    of vertices hides cables at their full length.
    """
    team = motion.team
    places = PROBES[:, None, None, None]
    legs = bernstein.evaluate(leg_vectors(motion)[None], places)  # (probes, pieces, 2n, 3)
    edges = bernstein.evaluate(edge_vectors(motion)[None], places)
    ratios = weight_ratios(team, team.tension)
    q_legs = cable_of(legs[:, :, 0::2], ratios)
    r_legs = cable_of(legs[:, :, 1::2], ratios)
    lengths = cable_of(edges, ratios) + q_legs + r_legs
    shares = lengths @ team.tension / float(team.cable_length @ team.tension)
    taut = np.max(1.0 - shares, axis=0) <= LENGTH_LIMIT
    return float(np.sum(motion.drones.durations[taut]) / motion.duration)
