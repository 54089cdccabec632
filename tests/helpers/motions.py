"""Motions for the tests: hitches and chains through moving outlines, free cables, single drones."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from hitchopt.checks import Check, certify
from hitchopt.checks.registry import RULE_OF, TEAM_REPORTS
from hitchopt.hitch import Hitch, Quadrotor, Swarm, Team
from hitchopt.hitch.forces import cable_slack_of
from hitchopt.hitch.requirements import Arena, Limits, Requirements
from hitchopt.motion.cable_state import CableState
from hitchopt.motion.motion import Motion, Phase
from hitchopt.trajectory import PiecewisePolynomial, bernstein
from hitchopt.values import Array

TRIANGLE = np.array([[3.0, 1.0], [2.6, 2.5], [3.4, 2.5]])
SQUARE = np.array([[2.0, 0.3], [1.2, -1.0], [0.1, -0.4], [0.5, 0.6]])
ARENA = Arena([-40.0, -50.0, -1.0], [45.0, 40.0, 3.0])


def row(motion: Motion, name: str) -> Check:
    """Return one check of the certificate, or a report that takes them all."""
    rule = RULE_OF.get(name)
    result = rule.check(motion) if rule else certify(motion, reports=TEAM_REPORTS)[name]
    assert result is not None
    return result


def convex_polygon(n: int, rng: np.random.Generator, centre: ArrayLike = (0.0, 0.0)) -> Array:
    """Return points (n, 2) of an ellipse, clockwise, with gaps that differ by up to a half."""
    gaps = rng.uniform(0.8, 1.2, n)
    angles = rng.uniform(0.0, 2.0 * math.pi) - 2.0 * math.pi * np.cumsum(gaps) / np.sum(gaps)
    axes = 0.6 / math.sin(math.pi / n) * np.array([1.0, rng.uniform(0.6, 1.0)])
    points: Array = np.asarray(centre) + axes * np.column_stack([np.cos(angles), np.sin(angles)])
    return points


def bent(headings: ArrayLike, lengths: ArrayLike, origin: ArrayLike = (1.5, -0.7)) -> Array:
    """Return the points (n + 1, 2) of a polyline with headings [deg] and lengths [m]."""
    angle = np.radians(np.asarray(headings, dtype=np.float64))
    steps = np.asarray(lengths)[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    points: Array = np.vstack([np.zeros(2), np.cumsum(steps, axis=0)]) + np.asarray(origin)
    return points


def smooth_step(s: float) -> float:
    """Return a step from 0 to 1 with three zero derivatives at both ends."""
    return s**4 * (35.0 - 84.0 * s + 70.0 * s**2 - 20.0 * s**3)


def moving(
    team: Team,
    outline_at: Callable[[float], Array],
    q_legs: ArrayLike,
    *,
    seconds: float = 4.0,
    pieces: int = 8,
    order: int = 7,
    altitude: float = 1.0,
    tension_at: Callable[[float], Array] | None = None,
    roll: ArrayLike = 0.0,
    **requirements: Any,
) -> Motion:
    """Return hitches with outlines as functions of time, interpolated on every piece."""
    breaks, layout = np.linspace(0.0, seconds, pieces + 1), team.layout
    times = breaks[:-1, None] + np.diff(breaks)[:, None] * bernstein.nodes(order)
    hitches = []
    for t in times.ravel().tolist():
        at, points = team, outline_at(t)
        if tension_at is not None:
            at = replace(team, tension=tension_at(t))
        slack = cable_slack_of(at, layout.edges(points))
        legs = layout.q_legs_of(np.broadcast_to(q_legs, slack.shape), slack)
        hitches.append(Hitch(at, points, altitude, legs, roll))

    def fitted(values: list[Array]) -> PiecewisePolynomial:
        each = np.array(values).reshape(pieces, order + 1, *values[0].shape)
        return PiecewisePolynomial(breaks, bernstein.interpolate(np.moveaxis(each, 1, -1)))

    return Motion(
        team,
        Requirements(**requirements),
        fitted([h.drones for h in hitches]),
        fitted([h.vertices for h in hitches]),
        fitted([h.legs for h in hitches]),
        PiecewisePolynomial.constant(breaks, team.tension)
        if tension_at is None
        else fitted([h.team.tension for h in hitches]),
        (Phase("morph", 0, 0.0, seconds),),
    )


def still(team: Team, outline: Array, q_legs: ArrayLike, **given: Any) -> Motion:
    """Return a hitch at rest for two seconds."""
    options = {"seconds": 2.0, "pieces": 2, "order": 3} | given
    return moving(team, lambda _: outline, q_legs, **options)


def triangle(**given: Any) -> Motion:
    """Return a hitch of three unequal cables at rest."""
    return still(Team(3, [2.4, 2.5, 2.6]), TRIANGLE, [0.35, 0.5, 0.45], **given)


def random_motion(n: int, seed: int, **requirements: Any) -> Motion:
    """Return a hitch of unequal cables whose vertices move toward another convex polygon."""
    return replace(_random_motion(n, seed), requirements=Requirements(**requirements))


@cache
def _random_motion(n: int, seed: int) -> Motion:
    rng = np.random.default_rng(seed)
    start = convex_polygon(n, rng, rng.uniform(-3.0, 3.0, 2))
    centre = np.mean(start, axis=0)
    inward = 0.12 * rng.uniform(0.2, 1.0, (n, 1)) * (centre - start) / n
    shift, turn = rng.uniform(-0.4, 0.4, 2), rng.uniform(-0.3, 0.3)

    def outline_at(t: float) -> Array:
        s = smooth_step(t / 4.0)
        c, si = math.cos(turn * s), math.sin(turn * s)
        points: Array = centre + (start - centre + s * (inward + shift)) @ [[c, si], [-si, c]]
        return points

    edges = np.linalg.norm(np.roll(start, -1, axis=0) - start, axis=-1)
    slack = edges * rng.uniform(0.5, 0.6, n)
    team = Team(n, edges + slack, tension=0.4)
    return moving(team, outline_at, slack * rng.uniform(0.4, 0.6, n), altitude=1.3)


def loaded_motion(seed: int, n: int, density: float = 0.01) -> Motion:
    """Return a moving hitch of different drones, with varying tensions and loads at clasps."""
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
    motion = moving(
        team,
        lambda t: start + 0.06 * np.sin(t * np.array([0.8, 1.1]) + start),
        0.4 + 0.05 * rng.uniform(0.0, 1.0, n),
        order=9,
        tension_at=lambda t: 0.9 + 0.03 * np.sin(0.7 * t + phases),
        roll=0.5 * rng.uniform(-1.0, 1.0, n),
        limits=Limits(body_rate=1.0),
    )
    # A range of tensions, so that cables are taut all of the time.
    return replace(motion, phases=(replace(motion.phases[0], tension=(0.8, 1.0)),))


def wild_motion(
    rng: np.random.Generator, n: int, pieces: int, order: int, noise: float, **requirements: Any
) -> Motion:
    """Return random polynomials as a hitched motion."""
    breaks = np.concatenate([[0.0], np.cumsum(rng.uniform(0.1, 2.0, pieces))])
    vertices = np.column_stack([convex_polygon(n, rng, rng.uniform(-3.0, 3.0, 2)), np.ones(n)])
    drones = np.repeat(vertices, 2, axis=0) + 0.5 * rng.normal(size=(2 * n, 3))

    def around(places: Array) -> PiecewisePolynomial:
        off = noise * rng.normal(size=(pieces, *places.shape, order + 1))
        return PiecewisePolynomial(breaks, places[..., None] + off)

    return Motion(
        Team(n, rng.uniform(2.0, 3.0, n), cable_density=0.003),
        Requirements(**requirements),
        around(drones),
        around(vertices),
        PiecewisePolynomial(breaks, rng.uniform(0.1, 0.6, (pieces, n, 2, 4))),
        PiecewisePolynomial(breaks, rng.uniform(0.2, 0.8, (pieces, n, 3))),
        (Phase("morph", 0, 0.0, float(breaks[-1]), tension=(0.2, 0.8)),),  # taut all the time
    )


def chain_motion(team: Team, start: Array, end: Array, q_legs: ArrayLike, **given: Any) -> Motion:
    """Return points that move straight from start to end, with constant inner q-legs."""
    options = {"seconds": 3.0, "pieces": 6, "altitude": 1.3} | given
    seconds = float(options["seconds"])
    return moving(
        team, lambda t: start + smooth_step(t / seconds) * (end - start), q_legs, **options
    )


@cache
def random_chain(n: int, seed: int) -> Motion:
    """Return a chain of unequal cables and tensions, off the origin, that bends and stretches."""
    rng = np.random.default_rng(seed)
    turn = rng.uniform(0.6, 1.0, n - 1)
    headings = rng.uniform(0.0, 360.0) - np.append(0.0, np.cumsum(turn)) * min(60.0, 200.0 / n)
    lengths = rng.uniform(1.1, 1.4, n)
    start = bent(headings, lengths, rng.uniform(-3.0, 3.0, 2))
    end = bent(
        0.9 * headings + rng.uniform(-20.0, 20.0),
        lengths * rng.uniform(0.92, 1.08, n),
        start[0] + rng.uniform(-0.4, 0.4, 2),
    )
    team = Team(
        n,
        1.1 * lengths + rng.uniform(0.7, 0.9, n),
        topology="open",
        tension=rng.uniform(0.4, 0.44, n),
        cable_density=0.004,
    )
    arena = Arena(np.append(start[0] - 30.0, 0.1), np.append(start[0] + 31.0, 2.9))
    return chain_motion(team, start, end, rng.uniform(0.3, 0.5, n), arena=arena)


def free_motion(
    team: Team, drones: PiecewisePolynomial, *states: CableState, **requirements: Any
) -> Motion:
    """Return phases in these states, one per piece (the last one for the rest); by default free."""
    last = states[-1] if states else CableState.FREE
    each = [*states, *[last] * (drones.pieces - len(states))]
    spans = zip(drones.breaks[:-1].tolist(), drones.breaks[1:].tolist(), each, strict=True)
    constant, n = PiecewisePolynomial.constant, team.robots
    return Motion(
        team,
        Requirements(**requirements),
        drones,
        constant(drones.breaks, np.zeros((team.layout.points, 3))),
        constant(drones.breaks, np.zeros((n, 2))),
        constant(drones.breaks, np.zeros(n)),
        tuple(Phase("approach", 0, a, b, state=state) for a, b, state in spans),
    )


def single(curves: PiecewisePolynomial, **requirements: Any) -> Motion:
    """Return drones without cables on curves (N, 3)."""
    phases = (Phase("fly", 0, *curves.breaks[[0, -1]].tolist()),)
    return Motion.single(Swarm(curves.shape[0]), Requirements(**requirements), curves, phases)


def lines(*places: ArrayLike, seconds: float = 1.0, **requirements: Any) -> Motion:
    """Return drones without cables along lines between positions (N, 3) [m] at equal times."""
    each = np.array(places, dtype=np.float64)
    c = np.stack([each[:-1], each[1:]], axis=-1)
    return single(PiecewisePolynomial(np.linspace(0.0, seconds, len(each)), c), **requirements)


def random_curves(
    n: int, seed: int, spread: float = 0.5, centre: ArrayLike = (5, -3, 4)
) -> PiecewisePolynomial:
    """Return curves (n, 3) that jump at two joints and touch at some times."""
    rng = np.random.default_rng(seed)
    middle = rng.uniform(-2.0, 2.0, (n, 3)) + np.asarray(centre)
    c = middle[None, :, :, None] + rng.normal(scale=spread, size=(3, n, 3, 6))
    return PiecewisePolynomial(np.array([0.0, 0.5, 1.7, 2.4]), c)


def through(times: ArrayLike, places: ArrayLike) -> PiecewisePolynomial:
    """Return motions from rest to rest between positions (J, 2n, 3) at times (J,)."""
    each = np.asarray(places, dtype=np.float64)
    rest = np.zeros_like(each[:-1])
    return PiecewisePolynomial.hermite(
        times, np.stack([each[:-1], rest, rest]), np.stack([each[1:], rest, rest])
    )


def random_flight(seed: int, n: int = 4, pieces: int = 3) -> tuple[Team, PiecewisePolynomial]:
    """Return wandering robots with slack, unequal cables, off the origin."""
    rng = np.random.default_rng(seed)
    topology = "closed" if n > 2 else "open"
    team = Team(n, 1.6 + 0.1 * np.arange(n), cable_density=0.01, topology=topology)
    middles = rng.uniform(-1.0, 1.0, (pieces + 1, n, 3)) * [1.2, 1.2, 0.3] + [3.0, -2.0, 2.5]
    arms = rng.uniform(-0.45, 0.45, (pieces + 1, n, 3)) * [1.0, 1.0, 0.4]
    places = np.stack([middles - arms, middles + arms], axis=2).reshape(pieces + 1, -1, 3)
    return team, through(np.concatenate([[0.0], np.cumsum(rng.uniform(0.5, 1.5, pieces))]), places)


def altered(motion: Motion, part: str, change: Callable[[Array], object]) -> Motion:
    """Return the motion with changed coefficients of one part."""
    given: PiecewisePolynomial = getattr(motion, part)
    c = given.coefficients.copy()
    result = change(c)
    new = c if result is None else np.asarray(result)
    return motion.replaced(**{part: PiecewisePolynomial(given.breaks, new)})


def plus(where: Any, value: ArrayLike) -> Callable[[Array], None]:
    """Add to some coefficients."""

    def change(c: Array) -> None:
        c[where] += value

    return change


def added(motion: Motion, drone: int, path: Array) -> Motion:
    """Return the motion with ``path`` (pieces, 3, degree + 1) added to one drone."""
    finer = replace(motion, drones=motion.drones.elevated(path.shape[-1] - 1))
    return altered(finer, "drones", plus((slice(None), drone), path))


def outlined(motion: Motion, start: Array, end: Array) -> Motion:
    """Return a motion at rest with points that move straight from start to end."""
    share = np.linspace(0.0, 1.0, 3 * motion.vertices.pieces + 1)

    def change(c: Array) -> None:
        for piece, part in enumerate(c):  # of degree 3
            there = share[3 * piece : 3 * piece + 4]
            part[:, :2] = start[:, :, None] + there * (end - start)[:, :, None]

    return altered(motion, "vertices", change)


def with_parts(
    motion: Motion, change: Callable[[PiecewisePolynomial], PiecewisePolynomial]
) -> Motion:
    """Return the motion with all functions of time changed in the same way, and its phases."""
    before, after = motion.drones.breaks[[0, -1]], change(motion.drones).breaks[[0, -1]]
    phases = [
        phase.retimed(*np.interp([phase.start, phase.end], before, after).tolist())
        for phase in motion.phases
    ]
    return motion.map_curves(change, phases)


def cut(part: PiecewisePolynomial) -> PiecewisePolynomial:
    """Return the same curves with every piece halved."""
    breaks = np.sort(np.concatenate([part.breaks, part.breaks[:-1] + 0.3 * part.durations]))
    c = part.coefficients
    both = np.stack([bernstein.restrict(c, *span) for span in ((0.0, 0.3), (0.3, 1.0))], axis=1)
    return PiecewisePolynomial(breaks, both.reshape(2 * len(c), *c.shape[1:]))


def held_at(motion: Motion, breaks: list[float], order: int = 0) -> Motion:
    """Return a motion at rest at its start, on other breaks."""
    at = PiecewisePolynomial.constant
    return with_parts(motion, lambda p: at(breaks, p.at(p.breaks[0]), order))


def replaced(motion: Motion, **limits: Any) -> Motion:
    """Return the motion with other limits."""
    spec = motion.requirements
    return motion.replaced(requirements=replace(spec, limits=replace(spec.limits, **limits)))
