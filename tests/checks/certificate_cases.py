"""Hitches in motion for the tests: the paper's class on polygons that move."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hitchopt.checks import Check
from hitchopt.checks.rule import CheckRule
from hitchopt.hitch import Quadrotor, Team
from hitchopt.hitch.forces import (
    cable_slack_of,
    clasp_loads,
    leg_directions,
    leg_vectors,
    sag_factors,
)
from hitchopt.hitch.requirements import Arena, Limits, Requirements, Separation
from hitchopt.motion.motion import Motion, Phase
from hitchopt.trajectory import PiecewisePolynomial, bernstein

Array = NDArray[np.float64]


def convex_polygon(n: int, rng: np.random.Generator, centre: ArrayLike = (0.0, 0.0)) -> Array:
    """(n, 2): points of an ellipse, clockwise, with gaps that differ by up to a half."""
    gaps = rng.uniform(0.8, 1.2, n)
    angles = rng.uniform(0.0, 2.0 * math.pi) - 2.0 * math.pi * np.cumsum(gaps) / np.sum(gaps)
    radius = 0.6 / math.sin(math.pi / n)
    axes = radius * np.array([1.0, rng.uniform(0.6, 1.0)])
    points: Array = axes * np.column_stack([np.cos(angles), np.sin(angles)])
    return np.asarray(centre, dtype=np.float64) + points


def smooth_step(s: Array) -> Array:
    """From 0 to 1 with three derivatives zero at both ends."""
    return s**4 * (35.0 - 84.0 * s + 70.0 * s**2 - 20.0 * s**3)


def fitted(breaks: Array, function: Callable[[Array], Array], order: int) -> PiecewisePolynomial:
    """Return what interpolates ``function`` (times (m,) to values (m, *shape)) on every piece."""
    x = bernstein.nodes(order)
    times = breaks[:-1, None] + np.diff(breaks)[:, None] * x
    values = function(times.ravel())
    values = np.moveaxis(values.reshape(len(breaks) - 1, order + 1, *values.shape[1:]), 1, -1)
    return PiecewisePolynomial(breaks, bernstein.interpolate(values))


def moving(
    team: Team,
    polygon_at: Callable[[Array], Array],
    q_legs: ArrayLike,
    *,
    seconds: float = 4.0,
    pieces: int = 8,
    order: int = 7,
    altitude: float = 1.0,
    tension_at: Callable[[Array], Array] | None = None,
    limits: Limits | None = None,
    separation: Separation | None = None,
    arena: Arena | None = None,
    roll: ArrayLike | None = None,
) -> Motion:
    """Return the motion of the clasps' law through polygons (times) -> (times, n, 2)."""
    breaks = np.linspace(0.0, seconds, pieces + 1)
    d = np.asarray(q_legs, dtype=np.float64)

    def tensions(t: Array) -> Array:
        if tension_at is None:
            return np.broadcast_to(team.tension, (len(t), team.robots))
        return tension_at(t)

    def vertices(t: Array) -> Array:
        flat = polygon_at(t)
        return np.concatenate([flat, np.full((*flat.shape[:-1], 1), altitude)], axis=-1)

    def lengths(t: Array) -> Array:
        p = vertices(t)
        edges: Array = np.linalg.norm(np.roll(p, -1, axis=1) - p, axis=-1)
        return edges

    def chords(t: Array) -> tuple[Array, Array]:
        p, T = vertices(t), tensions(t)
        edges = np.roll(p, -1, axis=1) - p
        slack = cable_slack_of(team, edges, T)
        given = np.broadcast_to(d, slack.shape)
        loads = clasp_loads(team, given, slack, roll)
        q_dir, r_dir = leg_directions(edges / lengths(t)[..., None], T, loads=loads)
        sag = sag_factors(team, T)
        return leg_vectors(given, q_dir, sag), leg_vectors(slack - given, r_dir, sag)

    def legs(t: Array) -> Array:
        both: Array = np.linalg.norm(np.stack(chords(t), axis=2), axis=-1)
        return both

    def drones(t: Array) -> Array:
        p, (q, r) = vertices(t), chords(t)
        following = np.roll(p, -1, axis=1)
        return np.stack([p + q, following + r], axis=2).reshape(len(t), -1, 3)

    return Motion(
        team,
        Requirements(limits or Limits(), separation or Separation(), arena),
        fitted(breaks, drones, order),
        fitted(breaks, vertices, order),
        fitted(breaks, legs, order),
        fitted(breaks, lambda t: np.array(tensions(t)), order if tension_at else 0),
        (Phase("morph", 0, 0.0, seconds),),
    )


def random_motion(n: int, seed: int, **given: object) -> Motion:
    """Return a hitch of unequal cables whose vertices go some way to another convex polygon."""
    rng = np.random.default_rng(seed)
    start = convex_polygon(n, rng, rng.uniform(-3.0, 3.0, 2))
    inward = 0.12 * rng.uniform(0.2, 1.0, (n, 1)) * (np.mean(start, axis=0) - start)
    shift = rng.uniform(-0.4, 0.4, 2)
    seconds = 4.0
    turn = rng.uniform(-0.3, 0.3)
    centre = np.mean(start, axis=0)

    def polygon_at(t: Array) -> Array:
        s = smooth_step(t / seconds)[:, None, None]
        shape = start + s * (inward / n + shift) - centre
        angle = turn * s[..., 0]
        c, si = np.cos(angle), np.sin(angle)
        x = c * shape[..., 0] - si * shape[..., 1]
        y = si * shape[..., 0] + c * shape[..., 1]
        points: Array = centre + np.stack([x, y], axis=-1)
        return points

    edges = np.linalg.norm(np.roll(start, -1, axis=0) - start, axis=-1)
    slack = edges * rng.uniform(0.5, 0.6, n)
    team = Team(n, edges + slack, tension=0.4)
    q_legs = slack * rng.uniform(0.4, 0.6, n)
    return moving(team, polygon_at, q_legs, seconds=seconds, altitude=1.3, **given)  # type: ignore[arg-type]


def still(team: Team, polygon: Array, q_legs: ArrayLike, **given: object) -> Motion:
    """Return a hitch at rest for two seconds."""
    points = np.asarray(polygon, dtype=np.float64)
    options: dict[str, object] = {"seconds": 2.0, "pieces": 2, "order": 3, **given}
    return moving(
        team,
        lambda t: np.broadcast_to(points, (len(t), *points.shape)),
        q_legs,
        **options,  # type: ignore[arg-type]
    )


def with_parts(
    motion: Motion, change: Callable[[PiecewisePolynomial], PiecewisePolynomial]
) -> Motion:
    """Return the motion, all of whose functions of time are changed alike, and its phases."""
    drones = change(motion.drones)
    before, after = motion.drones.breaks[[0, -1]], drones.breaks[[0, -1]]
    phases = tuple(
        replace(
            phase,
            start=float(np.interp(phase.start, before, after)),
            end=float(np.interp(phase.end, before, after)),
        )
        for phase in motion.phases
    )
    return replace(
        motion,
        phases=phases,
        drones=drones,
        vertices=change(motion.vertices),
        legs=change(motion.legs),
        tensions=change(motion.tensions),
    )


def cut(part: PiecewisePolynomial) -> PiecewisePolynomial:
    """Return the same curves, every piece in two."""
    breaks = np.sort(np.concatenate([part.breaks, part.breaks[:-1] + 0.3 * part.durations]))
    c = part.coefficients
    pieces = [bernstein.restrict(c, 0.0, 0.3), bernstein.restrict(c, 0.3, 1.0)]
    both = np.stack(pieces, axis=1).reshape(-1, *c.shape[1:])
    return PiecewisePolynomial(breaks, both)


def wild_motion(
    rng: np.random.Generator, n: int, pieces: int, order: int, noise: float, **given: Any
) -> Motion:
    """Return polynomials that are no hitch at all, in a phase that says so."""
    breaks = np.concatenate([[0.0], np.cumsum(rng.uniform(0.1, 2.0, pieces))])
    vertices = np.column_stack([convex_polygon(n, rng, rng.uniform(-3.0, 3.0, 2)), np.ones(n)])
    drones = np.repeat(vertices, 2, axis=0) + 0.5 * rng.normal(size=(2 * n, 3))

    def around(places: Array) -> PiecewisePolynomial:
        off = noise * rng.normal(size=(pieces, *places.shape, order + 1))
        return PiecewisePolynomial(breaks, places[..., None] + off)

    return Motion(
        Team(n, rng.uniform(2.0, 3.0, n), cable_density=0.003),
        Requirements(**given),
        around(drones),
        around(vertices),
        PiecewisePolynomial(breaks, rng.uniform(0.1, 0.6, (pieces, n, 2, 4))),
        PiecewisePolynomial(breaks, rng.uniform(0.2, 0.8, (pieces, n, 3))),
        (Phase("morph", 0, 0.0, float(breaks[-1]), tension=(0.2, 0.8)),),  # taut all the time
    )


def loaded_motion(seed: int, n: int, density: float = 0.01, rolled: float = 0.5) -> Motion:
    """Return a hitch of unlike drones in which all moves, tensions too, and clasps bear loads."""
    rng = np.random.default_rng(seed)
    angles = 2.0 * math.pi * (np.arange(n) + 0.15 * rng.uniform(-1.0, 1.0, n)) / n
    start = np.array([4.0, -3.0]) + np.column_stack([np.cos(angles), -np.sin(angles)])
    edges = np.linalg.norm(np.roll(start, -1, axis=0) - start, axis=1)
    team = Team(
        n,
        edges + rng.uniform(0.9, 1.1, n),
        tension=0.9,
        cable_density=density,
        load=rng.uniform(0.0, 0.006, n),
        quadrotor=[Quadrotor(0.13 + 0.01 * k, 3.0 - 0.1 * k) for k in range(n)],
    )
    phases = rng.uniform(0.0, 6.0, n)
    made = moving(
        team,
        lambda t: start + 0.06 * np.sin(t[:, None, None] * [0.8, 1.1] + start),
        0.4 + 0.05 * rng.uniform(0.0, 1.0, n),
        order=9,
        tension_at=lambda t: 0.9 + 0.03 * np.sin(0.7 * t[:, None] + phases),
        roll=rolled * rng.uniform(-1.0, 1.0, n),
        limits=Limits(body_rate=1.0),
    )
    # A range of tensions, so that cables are taut all of the time.
    return replace(made, phases=(replace(made.phases[0], tension=(0.8, 1.0)),))


def applied(rule: CheckRule, motion: Motion) -> Check:
    """Return the check of a motion that a rule applies to."""
    found = rule.check(motion)
    assert found is not None
    return found


def with_drones(motion: Motion, coefficients: Array) -> Motion:
    """Return the motion with other drones."""
    return replace(motion, drones=PiecewisePolynomial(motion.drones.breaks, coefficients))
