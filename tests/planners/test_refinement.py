"""Route and clock refined together: laws of the model's rows, and flights that are never longer."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

import hitchopt as ho
from hitchopt.drones.quadrotor import GRAVITY
from hitchopt.hitch.model import FlatJets, drone_jets
from hitchopt.hitch.requirements import Requirements
from hitchopt.motion.motion import Motion
from hitchopt.planners.candidates import Effort
from hitchopt.planners.optimise.cost import FlightCost
from hitchopt.planners.optimise.flight import Flight, with_leg_lengths
from hitchopt.planners.optimise.motion_rows import ChosenRows
from hitchopt.planners.optimise.parts import (
    DRONE_LIMITS,
    SMOOTHING,
    Columns,
    Limit,
    PartFunctions,
    groups_of,
)
from hitchopt.planners.optimise.refinement import refined
from hitchopt.planners.optimise.trust_region import TrustRegion
from hitchopt.planners.timing.timed_motion import motion_along
from hitchopt.trajectory.splines import bspline
from hitchopt.values import Array
from problems.random_morph import irregular_pairs, wild_morph
from tests.helpers.second_opinions import is_proven

PAIRS = irregular_pairs()

TEAMS: dict[str, dict[str, Any]] = {
    "plain": {},
    "unequal": {"tension": [0.4, 0.44, 0.42, 0.38]},
    "heavy": {"cable_density": 0.004, "tension": 0.6},
    "loaded": {"load": [0.003, 0.0, 0.005, 0.002]},
    "heavy, loaded and unequal": {
        "cable_density": 0.003,
        "load": 0.004,
        "tension": [0.6, 0.63, 0.65, 0.58],
    },
}

MIXED = {"plain", "heavy, loaded and unequal"}
"""The simplest team, and that of which all terms count."""


def smooth_length(vectors: Array) -> Array:
    """Return the lengths (…) of vectors (…, 3), smooth at zero."""
    return np.asarray(np.sqrt(np.sum(vectors**2, axis=-1) + SMOOTHING))


def random_flat(
    team: ho.Team, rng: np.random.Generator, *, rolled: bool, varying: bool
) -> FlatJets:
    """Return random flat outputs of a square or an arc, with derivatives."""
    points = team.layout.points
    angles = -2.0 * np.pi * np.arange(points) / (points + (0 if team.layout.closed else 3))
    vertices = 0.1 * rng.uniform(-1.0, 1.0, (3, points, 3, 4))
    vertices[:, :, :2, 0] += np.column_stack([np.cos(angles), np.sin(angles)])
    vertices[:, :, 2] = 0.0
    vertices[:, :, 2, 0] = 1.5
    q_legs = 0.1 * rng.uniform(-1.0, 1.0, (3, team.robots, 4))
    q_legs[..., 0] += 0.5
    q_legs[:, ~np.all(team.layout.has_leg, axis=1)] = 0.0
    roll = 0.2 * rng.uniform(-1.0, 1.0, (3, len(team.layout.clasps), 4)) if rolled else None
    tensions = np.zeros((3, team.robots, 4))
    tensions[..., 0] = team.tension
    if varying:
        tensions += 0.02 * rng.uniform(-1.0, 1.0, tensions.shape)
    return FlatJets(vertices, q_legs, tensions, roll)


@pytest.mark.parametrize("topology", ["closed", "open"])
@pytest.mark.parametrize(
    ("rolled", "varying"),
    [
        (False, False),
        pytest.param(False, True, marks=pytest.mark.slow),
        pytest.param(True, False, marks=pytest.mark.slow),
        (True, True),
    ],
)
@pytest.mark.parametrize(
    "kind", [pytest.param(x, marks=() if x in MIXED else pytest.mark.slow) for x in TEAMS]
)
def test_casadi_and_series_state_the_same_flight(
    kind: str, rolled: bool, varying: bool, topology: str
) -> None:
    """Values of all limits agree, and with them positions, three derivatives and thrusts."""
    options = dict(TEAMS[kind])
    if topology == "open" and isinstance(options.get("load"), list):
        options["load"] = options["load"][1:]
    team = ho.Team(4, 2.6, topology=topology, **options)
    rng = np.random.default_rng([len(kind), rolled, varying])
    flat = random_flat(team, rng, rolled=rolled, varying=varying)
    columns = Columns(team, rolled, varying)
    parts = [flat.vertices[:, :, :2].reshape(3, -1, 4), flat.q_legs]
    parts += [] if flat.roll is None else [flat.roll]
    parts += [flat.tensions] if varying else []
    jets = np.concatenate(parts, axis=1).swapaxes(1, 2)
    heights = flat.vertices[:, :, 2].swapaxes(1, 2)
    exact = flat
    if topology == "open":  # the last leg takes the slack
        exact = with_last_leg(team, flat)
    drones = drone_jets(team, exact)
    thrusts = drones.thrusts
    limits = ho.Limits()
    level = smooth_length(thrusts[..., :2])
    outside = np.cos(limits.tilt) * level - np.sin(limits.tilt) * thrusts[..., 2]
    norms = {
        Limit.SPEED: smooth_length(drones.positions[..., 1]) / limits.speed,
        Limit.ACCELERATION: smooth_length(drones.positions[..., 2]) / limits.acceleration,
        Limit.JERK: smooth_length(drones.positions[..., 3]) / limits.jerk,
        Limit.THRUST: smooth_length(thrusts) / team.max_thrust,
        Limit.TILT: 1.0 + outside / (GRAVITY * team.mass),
    }
    clock = np.tile([1.0, 0.0, 0.0], (3, 1))  # τ is time
    seen = set[int]()
    for group in groups_of(columns, climbs=False):
        functions = PartFunctions(group, limits, limits.tilt, team.max_thrust)
        for side in range(group.kind.sides):
            for part, drone in enumerate(group.drones[:, side]):
                seen.add(int(drone))
                for limit in DRONE_LIMITS:
                    which = np.full(3, part)
                    slopes = functions.slopes(limit, side, which, jets, heights, clock)
                    np.testing.assert_allclose(
                        slopes.ratio, norms[limit][:, drone], rtol=1e-9, atol=1e-11
                    )
    assert seen == set(range(team.drones))


def with_last_leg(team: ho.Team, flat: FlatJets) -> FlatJets:
    """Return flat outputs of a chain whose last q-leg takes all that its edge leaves."""
    from hitchopt.planners.path import cable_along

    slack = -cable_along(team, team.layout.edges(flat.vertices, axis=1), flat.tensions)
    slack[..., 0] += team.cable_length
    q_legs = team.layout.q_leg_jets(flat.q_legs, slack)
    return FlatJets(flat.vertices, q_legs, flat.tensions, flat.roll)


ROUTES: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "rolled": ({"roll": 0.3}, {}),
    "heavy": ({"cable_density": 0.004, "tension": 0.6}, {}),
    "tension": ({"cable_density": 0.002}, {"tension": (0.3, 0.6)}),
}


def route_of(kind: str) -> ho.Path:
    """Return a short route of a square."""
    team_options, options = ROUTES[kind]
    keys = dict(team_options)
    roll = keys.pop("roll", 0.0)
    start = ho.Hitch.balanced(ho.Team(4, 2.4, **keys), ho.regular_polygon(4, 1.2), 1.0, roll)
    goal = ho.regular_polygon(4, 1.25).rotated(0.2).translated([0.4, 0.1])
    return ho.route(start, goal, **options)


@pytest.mark.parametrize(
    "kind", [x if x == "rolled" else pytest.param(x, marks=pytest.mark.slow) for x in ROUTES]
)
def test_derivatives_of_rows_are_those_of_finite_differences(kind: str) -> None:
    """Rows of limits by coefficients of splines, and rows of distances."""
    requirements = Requirements(ho.Limits(), ho.Separation())
    path = with_leg_lengths(route_of(kind))
    flight = Flight.along(path, requirements, (0.3, 0.6))
    assert flight is not None
    rng = np.random.default_rng(0)
    chosen = ChosenRows.near(flight.limits.ratios(flight.path, flight.samples.rate), 0.3)
    block = flight.limits.block(chosen)
    margin = 1.0
    shape = flight.shape_block(0.3, margin)
    step = 1e-5
    for _ in range(3):
        direction = rng.uniform(-1.0, 1.0, (flight.splines.count, flight.splines.columns.size))
        direction[[0, -1]] = 0.0
        direction[:, ~flight.splines.columns.is_free] = 0.0
        others = [
            replace(flight, path=flight.moved(sign * step * direction)) for sign in (1.0, -1.0)
        ]
        values = [other.limits.block(chosen).values for other in others]
        numeric = (values[0] - values[1]) / (2.0 * step)
        exact = np.asarray(block.rows[:, : flight.splines.width] @ direction.ravel())
        np.testing.assert_allclose(exact, numeric, rtol=1e-4, atol=1e-4)
        # Distances that are near on all three paths
        short = [other.shape_block(0.3, margin).smallest for other in others]
        assert len(short[0]) == len(short[1]) == len(shape.smallest)
        numeric = (short[1] - short[0]) / (2.0 * step)
        exact = np.asarray(shape.rows @ direction.ravel())
        np.testing.assert_allclose(exact, numeric, rtol=1e-3, atol=1e-3)


def test_a_clock_is_a_variable_too() -> None:
    """Rows of limits by the squared rate of the clock."""
    requirements = Requirements(ho.Limits(), ho.Separation())
    flight = Flight.along(with_leg_lengths(route_of("rolled")), requirements, None)
    assert flight is not None
    direction = np.random.default_rng(1).uniform(-1.0, 1.0, flight.samples.rate_count)
    change = bspline(flight.samples.rate_knots, direction, 3)
    step = 1e-6
    chosen = ChosenRows.near(flight.limits.ratios(flight.path, flight.samples.rate), 0.5)
    values = []
    for sign in (1.0, -1.0):
        rate = flight.clock.squared_rate
        moved = rate.replaced(rate.coefficients + sign * step * change.coefficients)
        other = replace(flight, clock=replace(flight.clock, squared_rate=moved))
        values.append(other.limits.block(chosen).values)
    numeric = (values[0] - values[1]) / (2.0 * step)
    exact = np.asarray(flight.limits.block(chosen).rows[:, flight.splines.width :] @ direction)
    np.testing.assert_allclose(exact, numeric, rtol=1e-4, atol=1e-4)


@pytest.mark.slow
def test_derivatives_of_a_cost_in_motion_are_those_of_finite_differences() -> None:
    """By coefficients of splines and by those of the clock's squared rate."""
    path = with_leg_lengths(route_of("rolled"))
    cost = FlightCost(
        path.team,
        lambda out, s: (
            (1.0 + s)
            * (
                ca.sumsqr(out["velocities"])
                + 0.1 * ca.sumsqr(out["accelerations"])
                + out["legs"][1]
            )
            + ca.sumsqr(out["thrusts"])
            + ca.sumsqr(out["vertex_velocities"])
        ),
    )
    requirements = Requirements(ho.Limits(), ho.Separation())
    flight = Flight.along(path, requirements, None, cost)
    assert flight is not None
    program = TrustRegion.of(flight, 0.03, flight.shape_block(0.1, 1.0))
    rng = np.random.default_rng(2)
    direction = np.zeros(flight.splines.width)
    direction[program.free] = rng.uniform(-1.0, 1.0, len(program.free))
    step = 1e-5
    moved = [replace(flight, path=flight.moved(sign * step * direction)) for sign in (1.0, -1.0)]
    numeric = (moved[0].cost() - moved[1].cost()) / (2.0 * step)
    exact = program.cost_gradient @ direction[program.free]
    assert exact == pytest.approx(numeric, rel=1e-5)
    objectives = []
    for sign in (1.0, -1.0):
        rate = flight.clock.squared_rate
        clock = replace(flight.clock, squared_rate=rate.replaced(rate.coefficients + sign * step))
        objectives.append(clock.breaks[-1] + replace(flight, clock=clock).cost())
    by_rate = (objectives[0] - objectives[1]) / (2.0 * step)
    assert np.sum(program.rate_gradient) == pytest.approx(by_rate, rel=1e-4)


@pytest.mark.parametrize("index", [3, 37, 38])
@pytest.mark.slow
def test_pairs_that_searches_leave_early_gain_the_most(index: int, tmp_path: Path) -> None:
    """Their plans are shorter by 4 to 11 %, say so, and are proven."""
    pair = PAIRS[index]
    team = ho.Team(pair["n"], pair["cable_length"])
    start = ho.Hitch.spread(team, pair["start"], pair["altitude"])
    route = ho.morph(start, pair["goal"])
    plan = ho.morph(start, pair["goal"], optimize=True)
    assert plan.duration < 0.96 * route.duration
    assert f"→ {plan.duration:.2f} s" in plan.phases[0].remark
    assert is_proven(plan, tmp_path)


ARC = np.array([[-1.0, 0.0], [-0.7, 0.8], [0.2, 1.1], [1.0, 0.7]])


def refined_morph(kind: str) -> tuple[ho.Plan, ho.Plan]:
    """Return a plan and the refined one."""
    if kind == "wild and heavy":
        problem = wild_morph(4, 1, heavy=True)
        plain = ho.solve(ho.problem_from_dict(problem))
        problem["mission"][0]["morph"]["optimize"] = True
        return plain, ho.solve(ho.problem_from_dict(problem))
    if "chain" in kind:
        heavy: dict[str, Any] = {"cable_density": 0.004, "tension": 0.5}
        team = ho.Team(3, 2.2, topology="open", **(heavy if "heavy" in kind else {}))
        start = ho.Hitch.spread(team, ARC, 1.5)
        return ho.morph(start, -ARC), ho.morph(start, -ARC, optimize=True)
    if kind == "friction":
        square = ho.regular_polygon(4, 1.3)
        start = ho.Hitch.spread(ho.Team(4, 2.4, cable_density=0.003, cable_friction=0.1), square)
        goal = square.rotated(0.9).translated([0.4, 0.0])
        return ho.morph(start, goal), ho.morph(start, goal, optimize=True)
    pair = PAIRS[1]
    loads: dict[str, Any] = {"load": 0.005} if kind == "loaded" else {}
    team = ho.Team(pair["n"], pair["cable_length"], **loads)
    start = ho.Hitch.spread(team, pair["start"], pair["altitude"])
    options_of: dict[str, dict[str, Any]] = {
        "tension": {"tension": (0.3, 0.6)},
        "tracking": {"limits": ho.Limits(tracking=0.02)},
        "body rate": {"limits": ho.Limits(body_rate=1.0)},
    }
    options = options_of.get(kind, {})
    return (
        ho.morph(start, pair["goal"], **options),
        ho.morph(start, pair["goal"], optimize=True, **options),
    )


@pytest.mark.parametrize(
    "kind",
    [
        "wild and heavy",
        "chain",
        "heavy chain",
        "loaded",
        "tension",
        "tracking",
        "body rate",
        "friction",
    ],
)
@pytest.mark.slow
def test_a_refined_flight_is_shorter_and_proven(kind: str, tmp_path: Path) -> None:
    """Weight, loads, chains, varying tensions, errors, body rates and friction are rows too."""
    plain, plan = refined_morph(kind)
    assert plan.duration < plain.duration
    assert "refined with its clock" in plan.phases[0].remark
    assert is_proven(plan, tmp_path)


def test_refinement_never_loses_and_ends_at_the_limit_of_its_effort() -> None:
    path = route_of("rolled")
    requirements = Requirements(ho.Limits(), ho.Separation())
    motion = motion_along(path, requirements)

    def certify(_: ho.Path, motion: Motion) -> Motion:
        return motion

    assert refined(path, motion, None, lambda _, __: None, Effort()) is None
    whole = Effort()
    shorter = refined(path, motion, None, certify, whole)
    assert shorter is not None
    assert shorter.certified.duration < motion.duration
    part = Effort(0.3 * whole.spent)
    less = refined(path, motion, None, certify, part)
    assert part.spent < 0.7 * whole.spent
    longest = motion.duration if less is None else less.certified.duration
    assert shorter.certified.duration <= longest <= motion.duration
