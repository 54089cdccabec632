"""Friction at clasps: the range of a leg's pull, which checks ``equilibrium`` and ``tension`` use.

A cable that turns about another one by the angle θ pulls on its leg between ``e^{-μ β}`` and
``e^{μ β}`` times as much as on its edge, with its bend ``β = π sin(θ/2)`` (``hitch.twists``) and
the team's ``cable_friction`` μ. The excess of a pull over
this range is a residual of ``equilibrium``; in ``tension``, the range is that much wider for legs.
"""

from __future__ import annotations

import numpy as np

from hitchopt.checks.drones import Drones
from hitchopt.checks.rule import WorstCase
from hitchopt.checks.spans import ROUNDING, bent_edges, cached, without_shared_zeros
from hitchopt.hitch.twists import bend
from hitchopt.motion.motion import Motion
from hitchopt.trajectory.bernstein import same_degree
from hitchopt.trajectory.enclosed import Bound, Enclosed
from hitchopt.trajectory.search import worst
from hitchopt.values import Array, lazy


@cached
def _leg_and_edge(motion: Motion) -> list[Array]:
    """Return the pull of every drone's leg, and its cable's tension [N], without common zeros."""
    pulls = motion.pulls.coefficients
    tensions = np.repeat(motion.tensions.coefficients, 2, axis=1)
    tables = without_shared_zeros([pulls[:, :, None], tensions[:, :, None]])
    return [table[:, :, 0] for table in tables]


class FrictionLegs(Drones):
    """Spans of all legs, each by its drone, with the friction of their cables at the clasps."""

    @lazy
    def friction_ratio(self) -> Array:
        """(spans,) ``e^{μ β}``, β the smallest bend of the cable at its clasp."""
        leaving, arriving = bent_edges(self.source)
        edges = np.stack([leaving, -arriving], axis=2).reshape(len(leaving), -1, *leaving.shape[2:])
        edge_directions = Enclosed(self.read(edges), self.noise).direction
        opposite = self.along.dot(edge_directions).lower.value - ROUNDING  # -cos θ
        bends = bend(-np.clip(opposite, -1.0, 1.0))
        return np.asarray(np.exp(self.source.team.friction * bends))


def leg_excess(spans: FrictionLegs) -> Bound:
    """Return the excess of a leg's pull over the range of friction, relative to the tension.

    The range is from ``e^{-μ β}`` to ``e^{μ β}`` times the edge's pull. A quotient of polynomials
    with a positive divisor lies between the quotients of their coefficients.
    """
    pulls, tensions = _leg_and_edge(spans.source)
    pull, tension = same_degree(spans.read(pulls), spans.read(tensions))
    ratios = np.divide(pull, tension, out=np.full_like(pull, np.inf), where=tension > 0.0)
    highest = np.max(ratios, axis=-1) * (1.0 + ROUNDING)
    lowest = np.min(ratios, axis=-1) * (1.0 - ROUNDING)
    above = highest - spans.friction_ratio
    below = 1.0 / spans.friction_ratio - lowest
    return Bound(np.maximum(above, below), np.full(len(spans), 0.5))


def friction_excess(motion: Motion) -> WorstCase:
    """Return the largest excess of a leg's pull over the range of friction (``leg_excess``)."""
    largest = worst(FrictionLegs.of(motion), leg_excess, "max")
    point = motion.team.layout.anchors[largest.item]
    return WorstCase(largest.worst, largest.time, (f"p{point}",))
