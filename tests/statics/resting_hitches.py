"""Hitches at rest, as motions that stand still, off the origin and of unequal cables."""

from __future__ import annotations

from typing import Any

import numpy as np

from hitchopt import ConvexArc, Hitch, Motion, Phase, Quadrotor, Team, regular_polygon
from hitchopt.hitch.requirements import Requirements
from hitchopt.statics.settle import Settled, settle
from hitchopt.trajectory import PiecewisePolynomial
from problems.random_morph import random_convex_polygon


def standing(hitch: Hitch) -> Motion:
    breaks = np.array([0.0, 2.0])
    drones, vertices, legs, tensions = (
        PiecewisePolynomial.constant(breaks, value)
        for value in (hitch.drones, hitch.vertices, hitch.legs, hitch.team.tension)
    )
    phases = (Phase("hold", 0, 0.0, 2.0),)
    return Motion(hitch.team, Requirements(), drones, vertices, legs, tensions, phases)


def random_hitch(
    seed: int, n: int, topology: str = "closed", *, density: float = 0.0, stiffness: float = 5.0
) -> Hitch:
    """Unequal cables, tensions, masses, stiffness, leg lengths, at a random place."""
    rng = np.random.default_rng(seed)
    if topology == "closed":
        outline: Any = random_convex_polygon(n, 1.3, rng).translated(rng.normal(size=2))
    else:
        polygon = random_convex_polygon(n + 3, 1.3, rng).translated(rng.normal(size=2))
        outline = ConvexArc(polygon.vertices[: n + 1])
    length = outline.edge_lengths + rng.uniform(0.7, 1.1, n)
    kinds = [Quadrotor(0.1 + 0.01 * k, 2.6, stiffness * (1.0 + 0.1 * k)) for k in range(n)]
    team = Team(
        n,
        length,
        topology=topology,
        tension=rng.uniform(0.45, 0.55, n),
        cable_density=density,
        quadrotor=kinds,
    )
    slack = length - outline.edge_lengths
    legs = team.layout.q_legs_of(slack * rng.uniform(0.35, 0.65, n), slack)
    return Hitch(team, outline, 0.8 + rng.uniform(), legs)


def regular_hitch(n: int, tension: float = 0.5, **team: Any) -> Hitch:
    made = Team(n, 2.4, tension=tension, **team)
    return Hitch.balanced(made, regular_polygon(n, 1.2), 1.3)


def settled(hitch: Hitch, **conditions: Any) -> Settled:
    return settle(standing(hitch), 1.0, **conditions)
