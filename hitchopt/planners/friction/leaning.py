"""Legs that lean against friction, so that vertices stay where they are planned.

A cable that slides through a clasp pulls harder on the side that it is drawn to. With legs where
they hold without friction the vertex is dragged along until the clasp balances again. Planned for,
the same balance is found by the legs: they pull with what friction makes of the tension, and lean
as the force triangle at the clasp requires (``model.slipping``).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from hitchopt.geometry.vectors import length
from hitchopt.hitch import Team
from hitchopt.hitch.cable_spans import sag_factors
from hitchopt.model.evaluation import slipping_drones
from hitchopt.model.robot import JET
from hitchopt.motion.motion import Motion
from hitchopt.planners.friction.slip_tensions import counted_on
from hitchopt.planners.path import jets
from hitchopt.planners.timing.stretch import needed_stretch
from hitchopt.requirements import Limits
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.trajectory.splitting import on_breaks
from hitchopt.values import Array

SMALLEST = math.radians(0.5)
"""Smallest lean: legs that would lean less stay as they are."""

FINER = 2
"""Number of pieces of the drones' polynomials for one of the splines."""


@dataclass(frozen=True, eq=False)
class Leaning:
    """A motion whose legs lean against friction.

    Attributes
    ----------
    motion: with ``leg_tensions``, its phases slowed with it.
    turned: the largest angle by which a leg leans [rad].
    """

    motion: Motion
    turned: float


def leaning(motion: Motion, limits: Limits, share: float, *, slower: bool) -> Leaning | None:
    """Return the same motion with legs that lean against friction; None where none would.

    Vertices, legs' lengths and edges' tensions stay as they are, but for the pace.

    Parameters
    ----------
    motion: from rest to rest, formed all of the time.
    limits: that the leaning drones satisfy, by going slower.
    share: of the friction that is counted on, in (0, 1].
    slower: whether it may last longer; else None is returned where it would have to. So it is where
        legs at rest pull their drones beyond a limit.
    """
    slip = counted_on(motion, share)
    if slip is None:
        return None
    found = _leaned(motion, slip)
    if found is None or found.turned < SMALLEST:
        return None
    leaned = found.motion
    factor = needed_stretch(motion.team, limits, leaned.drones, leaned.vertices, leaned.pulls)
    if factor <= 1.0:
        return found
    if not slower or not math.isfinite(factor):
        return None
    return replace(found, motion=leaned.slowed(factor))


def worth_leaning(motion: Motion) -> bool:
    """Return whether legs would lean by more than the least, if limits allowed it."""
    slip = counted_on(motion, 1.0)
    if slip is None:
        return False
    found = _leaned(motion, slip)
    return found is None or found.turned >= SMALLEST


def _leaned(motion: Motion, slip: PiecewisePolynomial) -> Leaning | None:
    """Return the motion with pulls ``T e^slip``; None where a clasp cannot balance so."""
    layout = motion.team.layout
    breaks = _refined(motion.drones.breaks, motion.duration / (FINER * slip.pieces))
    drones, vertices, legs, tensions = (
        on_breaks(part, breaks)
        for part in (motion.drones, motion.vertices, motion.legs, motion.tensions)
    )
    # From both sides of every break: jerks jump where timed points begin to be followed.
    at = [_end_jets(part) for part in (drones, vertices, legs, tensions)]
    d, p, lengths, T = (np.concatenate(pair) for pair in at)
    logs = slip.jet(np.concatenate([breaks[:-1], breaks[1:]]), JET)
    grown = jets.chained(np.repeat(np.exp(logs[..., :1]), JET, axis=-1), logs)
    pulls = np.repeat(T[:, :, None], 2, axis=2)
    pulls[:, layout.behind, 1] = jets.product(grown[:, :, 0], T[:, layout.behind])
    pulls[:, layout.ahead, 0] = jets.product(grown[:, :, 1], T[:, layout.ahead])
    cables = cables_of_legs(motion.team, d - p[:, layout.anchors], lengths, T)
    found = slipping_drones(motion.team, p, lengths, T, pulls, d, cables)
    if not np.all(np.isfinite(found)):
        return None
    places = np.stack([d[:, 2 * layout.behind + 1], d[:, 2 * layout.ahead]], axis=2)[..., 0]
    clasps = p[:, layout.clasps][..., 0][:, :, None]
    turned = _angles_between(places - clasps, found[..., 0] - clasps)
    d[:, 2 * layout.behind + 1], d[:, 2 * layout.ahead] = found[:, :, 0], found[:, :, 1]
    leaned = replace(
        motion,
        drones=_hermite(breaks, d),
        vertices=vertices,
        legs=legs,
        tensions=tensions,
        leg_tensions=_hermite(breaks, pulls),
    )
    return Leaning(leaned, float(np.max(turned)))


def cables_of_legs(team: Team, chords: Array, lengths: Array, tensions: Array) -> Array | None:
    """Return jets (J, n, 2, 4) of the lengths of cable in legs [m]; None where they do not sag.

    By ``hitch.cable_spans.cable_of``, for chords (J, 2n, 3, 4) [m] that are ``lengths`` long.
    """
    if team.cable_density == 0.0:
        return None
    level = jets.product(chords[:, :, 0], chords[:, :, 0])
    level += jets.product(chords[:, :, 1], chords[:, :, 1])
    factors = sag_factors(team, 1.0) * jets.reciprocal(jets.product(tensions, tensions))
    sag = jets.product(factors[:, :, None], level.reshape(lengths.shape))
    return lengths + jets.product(sag, lengths)


def _refined(breaks: Array, longest: float) -> Array:
    """Return the breaks with every piece cut evenly into parts no longer than ``longest`` [s]."""
    parts = np.maximum(1, np.ceil(np.diff(breaks) / longest - 1e-9).astype(np.intp))
    first = np.repeat(np.cumsum(parts) - parts, parts)
    within = (np.arange(len(first)) - first) / np.repeat(parts, parts)
    starts = np.repeat(breaks[:-1], parts) + within * np.repeat(np.diff(breaks), parts)
    return np.append(starts, breaks[-1])


def _end_jets(part: PiecewisePolynomial) -> tuple[Array, Array]:
    """Return the jets (pieces, *shape, 4) at both ends of every piece."""
    ends = [part.ends(order) for order in range(JET)]
    left, right = zip(*ends, strict=True)
    return np.stack(left, axis=-1), np.stack(right, axis=-1)


def _hermite(breaks: Array, both: Array) -> PiecewisePolynomial:
    """Return the polynomials with given jets (2 pieces, *shape, 4): first all left ends."""
    left, right = np.split(np.moveaxis(both, -1, 0), 2, axis=1)
    return PiecewisePolynomial.hermite(breaks, left, right)


def _angles_between(a: Array, b: Array) -> Array:
    """Return the angles (…) [rad] between vectors (…, 3); 0 where one has no length."""
    sizes = length(a) * length(b)
    cosine = np.divide(np.sum(a * b, axis=-1), sizes, out=np.ones_like(sizes), where=sizes > 0.0)
    angles: Array = np.arccos(np.clip(cosine, -1.0, 1.0))
    return angles
