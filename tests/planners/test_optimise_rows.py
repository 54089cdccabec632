"""The optimiser's programs: their rows, their derivatives, and what a solution keeps."""

import math
from collections import OrderedDict
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from optimise_cases import ends
from scipy import sparse

import hitchopt as ho
from hitchopt.geometry import regular_polygon
from hitchopt.hitch import Team
from hitchopt.hitch.leg_lengths import reference_margin
from hitchopt.hitch.leg_task import LegTask
from hitchopt.planners.optimise import ipopt_steps
from hitchopt.planners.optimise.guesses import guesses
from hitchopt.planners.optimise.ipopt_steps import solve_program
from hitchopt.planners.optimise.knot_path import KnotPath, columns_of
from hitchopt.planners.optimise.model_rows import Draft, Program, linear_value
from hitchopt.planners.optimise.morph_program import MorphProgram, build_program
from hitchopt.planners.optimise.search_task import (
    STATIC_SHARE,
    Search,
    SolverStep,
    static_tension,
)
from hitchopt.planners.optimise.separating_rows import (
    LEG_INSET,
    LEG_REACH,
    NearPairs,
    instants,
    near_pairs,
    rows_at_knots,
    rows_between,
)
from hitchopt.planners.timing.demands import loads_at_rest
from hitchopt.requirements import Requirements
from problems.random_morph import random_convex_polygon

QUIET = {"print_iter": False, "print_header": False, "print_info": False}


def search(
    tension: tuple[float, float] | None,
    margin: float,
    end_margins: tuple[float, float],
    requirements: Requirements | None = None,
) -> Search:
    return Search(requirements or Requirements(), lambda _: None, tension, end_margins, margin)


def expressions_of(program: Program) -> dict[str, ca.MX]:
    """Return x, f and g with the program's own parameters."""
    built = program.expressions()
    value = ca.Function("value", [built["x"], built["p"]], [built["f"], built["g"]])
    x = ca.MX.sym("x", len(program.numbers["x0"]))
    f, g = value(x, program.numbers["p"])
    return {"x": x, "f": f, "g": g}


def costs_and_rows(expressions: dict[str, ca.MX]) -> ca.Function:
    return ca.Function("value", [expressions["x"]], [expressions["f"], expressions["g"]])


def distances(nodes: np.ndarray, drones: NearPairs) -> np.ndarray:
    """Return the distances (m,) [m] of pairs of drones, of nodes (K, 3n, 2)."""
    first, second = (nodes[drones.frame, node[:, 0]] for node in (drones.first, drones.second))
    return np.asarray(np.linalg.norm(first - second, axis=1))


def program_of(
    n: int, step: SolverStep, tension: tuple[float, float] | None, shift: float = 0.0
) -> MorphProgram:
    rng = np.random.default_rng(n)
    first = random_convex_polygon(n, 1.1, rng)
    pulls = 0.4 if tension else rng.uniform(0.38, 0.42, n)
    last = first.rotated(1.0).translated([0.4, 0.1 + shift])
    start, end = ends(Team(n, 2.2, tension=pulls), first, last)
    polygons = guesses(first, last, 6)[1].polygons
    bounds = search(tension, 1.02, (1.5, 1.5))
    return build_program(KnotPath.through("turned", start, end, polygons), bounds, step)


@pytest.mark.parametrize(
    ("step", "tension"),
    [
        (SolverStep(0.17), None),
        (SolverStep(0.17, 3, fastest=True), None),
        (SolverStep(0.12, 4), (0.2, 0.6)),
        (SolverStep(0.12, fastest=True), (0.2, 0.6)),
    ],
)
def test_the_optimisers_derivatives_are_those_of_finite_differences(
    step: SolverStep, tension: tuple[float, float] | None
) -> None:
    program = program_of(3, step, tension).program
    rng = np.random.default_rng(1)
    multipliers = rng.normal(size=len(program.numbers["lbg"]))
    x, f, g = expressions_of(program).values()
    lagrangian = f + ca.dot(ca.DM(multipliers), g)
    gradient = ca.gradient(lagrangian, x)
    value = ca.Function("value", [x], [lagrangian, gradient])
    slope = ca.Function("slope", [x], [gradient, ca.jacobian(gradient, x)])
    start = program.numbers["x0"]
    point = start + 1e-3 * rng.normal(size=len(start))
    exact_gradient, exact_hessian = (np.asarray(v) for v in slope(point))
    h = 1e-5
    for _ in range(12):  # along random directions: all entries take part in each
        direction = rng.normal(size=len(point))
        around = [
            [np.asarray(v).ravel() for v in value.call([point + k * h * direction])]
            for k in (-2.0, -1.0, 1.0, 2.0)
        ]
        by_cost, by_slope = (
            (a - 8 * b + 8 * c - d) / (12 * h) for a, b, c, d in zip(*around, strict=True)
        )
        along = exact_gradient.ravel() @ direction
        assert by_cost[0] == pytest.approx(along, rel=1e-6, abs=1e-4)
        curved = exact_hessian @ direction
        np.testing.assert_allclose(by_slope, curved, atol=1e-5 * (1.0 + np.max(np.abs(curved))))


def loaded_program(n: int, density: float) -> MorphProgram:
    """Return a program of rolled legs and loads."""
    team = Team(n, 2.2, tension=1.0, cable_density=density, load=0.02)
    first = random_convex_polygon(n, 1.1, np.random.default_rng(n))
    start, end = (
        ho.Hitch.balanced(team, polygon, 1.0, roll)
        for polygon, roll in ((first, 0.1), (first.rotated(0.3), 0.2))
    )
    polygons = guesses(first, first.rotated(0.3), 6)[1].polygons
    path = KnotPath.through("turned", start, end, polygons)
    return build_program(path, search(None, 1.02, (1.5, 1.5)), SolverStep(0.12, 4, fastest=True))


@pytest.mark.parametrize(
    "program",
    [
        program_of(3, SolverStep(0.12, 4, fastest=True), None),
        program_of(5, SolverStep(0.17, 4), (0.2, 0.6)),
        loaded_program(3, 0.0),
        loaded_program(4, 0.01),
    ],
    ids=["unequal tensions", "free tensions", "loads", "heavy cables"],
)
def test_the_solver_is_given_the_derivatives_of_its_rows(program: MorphProgram) -> None:
    built, given = program.program.expressions(), program.program.derivatives()
    x, p, f, g = (built[name] for name in ("x", "p", "f", "g"))
    weight, multipliers = ca.MX.sym("weight"), ca.MX.sym("multipliers", g.numel())
    hessian = ca.triu(ca.hessian(weight * f + ca.dot(multipliers, g), x)[0])
    own = ca.Function("own", [x, p, weight, multipliers], [g, ca.jacobian(g, x), hessian])
    rng, numbers = np.random.default_rng(8), program.program.numbers
    point = numbers["x0"] + 1e-3 * rng.normal(size=len(numbers["x0"]))
    forces = rng.normal(size=g.numel())
    wanted = [ca.DM(part).full() for part in own(point, numbers["p"], 0.7, forces)]
    found = [
        *given["jac_g"](point, numbers["p"]),
        given["hess_lag"](point, numbers["p"], 0.7, forces),
    ]
    for ours, theirs in zip(found, wanted, strict=True):
        scale = float(np.max(np.abs(theirs)))
        np.testing.assert_allclose(ca.DM(ours).full(), theirs, atol=1e-12 * scale)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=15)
def test_pair_rows_never_promise_more_than_the_distance(seed: int) -> None:
    """Kept rows mean kept distances, wherever the bodies have gone; and nothing near is missed."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(3, 7))
    first = random_convex_polygon(n, 1.1, rng)
    start, end = ends(Team(n, 2.0), first, first.rotated(0.4))
    way = KnotPath.through("turned", start, end, guesses(first, first.rotated(0.4), 5)[1].polygons)
    columns = columns_of(n)
    table = way.table
    moved = table.copy()
    moved[1:-1] += rng.uniform(-0.03, 0.03, moved[1:-1].shape)  # well within a step
    moved[:, columns.tensions] = table[:, columns.tensions]
    other = way.with_table(moved)
    moved[1:-1] = other.table[1:-1]  # drones where the moved hitch has them
    pairs = near_pairs(table[1:-1][:, columns.nodes], ho.Separation(), np.ones(3), 0.5)
    drones, others = (pairs.chosen(which) for which in (pairs.kind == 0, pairs.kind != 0))
    rows = rows_at_knots(way, others)
    places = moved[1:-1][:, columns.nodes]
    apart = distances(places, drones)
    kept = bool(np.all(rows.rows @ moved[1:-1].ravel() >= rows.least)) and bool(
        np.all(apart >= drones.enforced)
    )
    task = LegTask(way.team, Requirements(), other.polygons[1:-1], other.q_legs[1:-1], 0.0, 1.0)
    assert reference_margin(task) >= 1.0 - 1e-9 or not kept


@given(st.integers(0, 2**32 - 1), st.integers(2, 5))
@settings(max_examples=15)
def test_rows_between_knots_are_tight_for_the_way_and_right_for_its_translations(
    seed: int, parts: int
) -> None:
    """By how much a row is kept is by how much its pair is, wherever the whole way is moved."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(3, 7))
    first = random_convex_polygon(n, 1.1, rng)
    start, end = ends(Team(n, 2.0), first, first.rotated(0.4))
    way = KnotPath.through("turned", start, end, guesses(first, first.rotated(0.4), 6)[1].polygons)
    columns, places = columns_of(n), instants(5, parts)
    assert np.all((places > 0.0) & (places < 5.0) & (places % 1.0 > 0.0))
    bounds = search(None, 1.05, (1.2, 1.01))
    table = way.table
    found = rows_between(way, bounds, parts, 0.3)
    nodes = way.at(places / 5.0).table[:, columns.nodes]
    pairs = near_pairs(nodes, ho.Separation(), bounds.margins(5, places), 0.3)
    excess = np.full(len(pairs.enforced), np.inf)
    pair, _, _ = pairs.sides()
    x = table[1:-1].ravel()
    np.minimum.at(excess, pair, (found.rows @ x - found.least)[: len(pair)])
    gaps = [
        np.min(np.linalg.norm(points_on(a, 60)[:, None] - points_on(b, 60)[None], axis=-1))
        for a, b in zip(
            nodes[pairs.frame[:, None], pairs.first],
            nodes[pairs.frame[:, None], pairs.second],
            strict=True,
        )
    ]
    np.testing.assert_allclose(excess + pairs.enforced, gaps, atol=2e-3)
    assert np.all(excess + pairs.enforced <= np.array(gaps) + 1e-9)  # samples are never nearer
    # The inner knots all moved alike: pairs within a step between inner knots stay as they are.
    inner = np.abs(places[pairs.frame[pair]] - 2.5) < 1.5
    moved = table[1:-1].copy()
    moved[:, columns.nodes] += rng.normal(size=2)
    before, after = ((found.rows @ a)[: len(pair)] for a in (x, moved.ravel()))
    np.testing.assert_allclose(after[inner], before[inner], atol=1e-9)


def points_on(segment: np.ndarray, count: int) -> np.ndarray:
    """Return points (count, 2) along a segment (2, 2)."""
    return np.linspace(segment[0], segment[1], count)


def test_a_solved_program_keeps_its_rows_and_lowers_its_cost() -> None:
    around = program_of(4, SolverStep(0.17, 2), None)
    way, program = solve_program(around), around.program
    assert way is not None
    value = costs_and_rows(expressions_of(program))
    x = way.table[1:-1].ravel()
    cost, rows = value(x)
    assert np.all(np.asarray(rows).ravel() >= program.numbers["lbg"] - 1e-4)
    assert np.all(np.asarray(rows).ravel() <= program.numbers["ubg"] + 1e-4)
    assert float(cost) <= float(value(program.numbers["x0"])[0]) + 1e-6


def test_what_is_short_of_its_bound_may_stay_so_at_a_price_and_the_rest_may_not() -> None:
    draft = Draft()
    x = draft.variables(np.array([0.0, 2.0]), np.full(2, -5.0), np.full(2, 5.0))
    least, now = np.array([1.0, 1.5]), np.array([0.0, 2.0])
    draft.soft_bound(lambda at: at.variables[x], least, now, 3.0)
    draft.cost(lambda at: ca.sumsqr(at.variables[x]))
    program = draft.program()
    expressions, numbers = program.expressions(), program.numbers
    rows = costs_and_rows(expressions_of(program))
    cost, values = rows(numbers["x0"])
    np.testing.assert_allclose(np.asarray(values).ravel(), [1.0, 2.0])  # feasible where it starts
    assert float(cost) == pytest.approx(4.0 + 3.0 * 1.0)
    np.testing.assert_array_equal(numbers["lbx"], [-5.0, -5.0, 0.0])
    found = ca.qpsol("soft", "qrqp", expressions, QUIET)(**numbers)
    # Worth 3 a metre, the first one is raised to its bound of 1, where a square costs 2 a metre.
    np.testing.assert_allclose(np.asarray(found["x"]).ravel(), [1.0, 1.5, 0.0], atol=1e-6)


@pytest.mark.filterwarnings("ignore::hitchopt.errors.UnitWarning")
def test_legs_that_get_short_between_knots_are_told_as_they_are() -> None:
    first = regular_polygon(4, 1.2)
    last = first.rotated(0.5).scaled(0.9)
    start, end = ends(Team(4, [2.4, 2.5, 2.6, 2.4]), first, last)
    way = KnotPath.through("turned", start, end, guesses(first, last, 6)[1].polygons)
    columns, places = columns_of(4), instants(5, 4)
    both = np.concatenate([columns.q_legs, columns.r_legs])
    legs, at_knots = (w[:, both] for w in (way.at(places / 5.0).table, way.table))
    limits = ho.Limits(leg=float(np.min(legs)) + 0.02)
    bounds = search(
        None, 1.0, (1.0, 1.0), Requirements(limits, ho.Separation(1e-4, 1e-4, 0.0, 0.0))
    )
    rows = rows_between(way, bounds, 4, 0.0)  # of no pair: their limits are next to none
    shortest = np.minimum(limits.leg + LEG_INSET, np.minimum(at_knots[0], at_knots[-1]))
    near = legs < limits.leg + LEG_REACH
    excess = rows.rows @ way.table[1:-1].ravel() - rows.least
    assert 0 < np.sum(near) < near.size
    np.testing.assert_allclose(excess, (legs - shortest)[near], atol=1e-9)


@given(st.integers(0, 2**32 - 1), st.integers(2, 5))
@settings(max_examples=10)
def test_rows_between_knots_follow_the_chord_between_moved_knots(seed: int, parts: int) -> None:
    """Their change is that of pairs on straight lines from each knot to the next, all moved."""
    rng = np.random.default_rng(seed)
    n, steps = int(rng.integers(3, 7)), 5
    first = random_convex_polygon(n, 1.1, rng)
    start, end = ends(Team(n, 2.0), first, first.rotated(0.4))
    path = KnotPath.through("turned", start, end, guesses(first, first.rotated(0.4), 6)[1].polygons)
    places = instants(steps, parts)
    asked = search(None, 1.05, (1.2, 1.01), Requirements(ho.Limits(leg=float(np.min(path.q_legs)))))
    rows = rows_between(path, asked, parts, 0.3)
    change = rng.normal(size=path.table.shape)
    change[[0, -1]] = 0.0  # the ends are given
    knots = np.arange(steps + 1.0)
    there = np.stack([np.interp(places, knots, column) for column in change.T], axis=1)

    columns = path.columns
    table = path.at(places / steps).table
    margins = asked.margins(steps, places)
    pairs = near_pairs(table[:, columns.nodes], ho.Separation(), margins, 0.3)
    pair, a, b = pairs.sides()
    moved = there[:, columns.nodes][pairs.frame[pair]]
    at = np.arange(len(pair))
    apart = np.sum(pairs.normal[pair] * (moved[at, a] - moved[at, b]), axis=1)
    legs = np.concatenate([columns.q_legs, columns.r_legs])
    near = table[:, legs] < asked.requirements.limits.leg + LEG_REACH
    assert np.any(near)
    wanted = np.concatenate([apart, there[:, legs][near]])
    np.testing.assert_allclose(rows.rows @ change[1:-1].ravel(), wanted, atol=1e-12)


def test_rows_at_knots_are_the_slopes_of_distances_along_their_normals() -> None:
    """By central differences of the distance between the sides of each pair, knot by knot."""
    rng = np.random.default_rng(7)
    first = random_convex_polygon(5, 1.1, rng)
    start, end = ends(Team(5, 2.0), first, first.rotated(0.4))
    path = KnotPath.through("turned", start, end, guesses(first, first.rotated(0.4), 6)[1].polygons)
    columns, inner = path.columns, path.table[1:-1]
    pairs = near_pairs(inner[:, columns.nodes], ho.Separation(), np.ones(4), 0.5)
    others = pairs.chosen(pairs.kind != 0)
    rows = rows_at_knots(path, others)
    pair, a, b = others.sides()

    def apart(x: np.ndarray) -> np.ndarray:
        nodes = x.reshape(inner.shape)[:, columns.nodes]
        frame = others.frame[pair]
        apart = others.normal[pair] * (nodes[frame, a] - nodes[frame, b])
        return np.asarray(np.sum(apart, axis=1))

    x, direction = inner.ravel(), rng.normal(size=inner.size)
    slope = (apart(x + 1e-4 * direction) - apart(x - 1e-4 * direction)) / 2e-4
    np.testing.assert_allclose(rows.rows @ direction, slope, atol=1e-9)
    np.testing.assert_allclose(rows.rows @ x, apart(x), atol=1e-12)
    np.testing.assert_allclose(rows.least, others.enforced[pair], atol=1e-12)


@pytest.mark.parametrize(
    "binding",
    [
        {"max_thrust": 1.9, "tilt": math.radians(60.0)},  # thrust binds
        {"max_thrust": 9.0, "tilt": math.radians(20.0)},  # tilt binds
    ],
    ids=["thrust", "tilt"],
)
def test_the_static_tension_is_where_drones_that_carry_their_cables_reach_a_limit(
    binding: dict[str, float],
) -> None:
    """A hitch at rest: thrust and tilt of the model itself, at that tension.

    Exactly where legs are level; those of heavy cables rise, which the estimate leaves out.
    """
    for density, accuracy in ((0.0, 1e-9), (0.02, 0.03)):
        check_static_tension(binding, density, accuracy)


def check_static_tension(binding: dict[str, float], density: float, accuracy: float) -> None:
    tilt = binding["tilt"]
    kinds = [ho.Quadrotor(0.132 + 0.01 * k, binding["max_thrust"]) for k in range(4)]
    team = Team(4, [2.2, 2.4, 2.2, 2.4], tension=0.4, quadrotor=kinds, cable_density=density)
    largest = static_tension(team, tilt)
    assert len(set(largest)) == 4
    for k in range(4):
        same = replace(team, tension=np.full(4, largest[k]))
        hitch = ho.Hitch.balanced(same, regular_polygon(4, 1.2))
        thrust = loads_at_rest(same, hitch.cable_forces)[2 * k : 2 * k + 2]
        level = np.hypot(thrust[:, 0], thrust[:, 1])
        by_thrust = np.linalg.norm(thrust, axis=1) / binding["max_thrust"]
        by_tilt = np.arctan2(level, thrust[:, 2]) / tilt
        assert max(np.max(by_thrust), np.max(by_tilt)) == pytest.approx(STATIC_SHARE, rel=accuracy)


def test_the_bounds_of_free_tensions_are_static_ones_or_those_of_the_range() -> None:
    """In the variables that the solver gets, of cables with weight."""
    quadrotor = ho.Quadrotor(0.132, 1.8)
    team = Team(4, [2.2, 2.4, 2.2, 2.4], tension=0.4, quadrotor=quadrotor, cable_density=0.02)
    square = regular_polygon(4, 1.2)
    start, end = ends(team, square, square.rotated(0.3))
    path = KnotPath.through(
        "turned", start, end, guesses(square, square.rotated(0.3), 6)[1].polygons
    )
    tilt = ho.Limits().tilt
    for top in (0.5, 5.0):
        task = search((0.2, top), 1.02, (1.5, 1.5))
        program = build_program(path, task, SolverStep(0.17)).program
        size = path.columns.size * (path.steps - 1)
        upper = program.numbers["ubx"][:size].reshape(path.steps - 1, -1)[:, path.columns.tensions]
        lift = team.mass[::2] * 9.81 + team.cable_weight[::2]
        by_thrust = np.sqrt((0.97 * 1.8) ** 2 - lift**2)
        static = np.minimum(by_thrust, lift * math.tan(0.97 * tilt))
        wanted = np.minimum(top - 0.02 * (top - 0.2), static)
        np.testing.assert_allclose(upper, np.tile(wanted, (path.steps - 1, 1)), rtol=1e-6)


@pytest.mark.parametrize(
    ("step", "tension"),
    [(SolverStep(0.12, 4), None), (SolverStep(0.12, 4, fastest=True), (0.2, 0.6))],
)
def test_programs_of_one_structure_differ_in_their_numbers_alone(
    step: SolverStep, tension: tuple[float, float] | None
) -> None:
    one, other = (program_of(4, step, tension, shift).program for shift in (0.0, 1e-5))
    assert one.structure == other.structure
    assert not np.array_equal(one.numbers["p"], other.numbers["p"])
    x = one.numbers["x0"] + 0.01 * np.random.default_rng(2).normal(size=len(one.numbers["x0"]))
    found = []
    for built in (one.expressions(), other.expressions()):
        value = ca.Function("value", [built["x"], built["p"]], [built["f"], built["g"]])
        found.append([np.asarray(part) for part in value(x, other.numbers["p"])])
    for part, same in zip(*found, strict=True):
        np.testing.assert_allclose(part, same, rtol=1e-12, atol=1e-12)


def test_a_stored_solver_finds_what_a_new_one_does(monkeypatch: pytest.MonkeyPatch) -> None:
    step = SolverStep(0.12, 4)
    first, second = (program_of(4, step, None, shift) for shift in (0.0, 1e-5))
    stored: OrderedDict[object, ca.Function] = OrderedDict()
    monkeypatch.setattr(ipopt_steps, "_SOLVERS", stored)
    assert solve_program(first) is not None
    (solver,) = stored.values()
    again = solve_program(second)
    assert list(stored.values()) == [solver]
    stored.clear()
    alone = solve_program(second)
    assert list(stored.values()) != [solver]
    assert again is not None
    assert alone is not None
    np.testing.assert_array_equal(again.table, alone.table)


@pytest.mark.parametrize("change", ["cables", "speeds", "fastest", "knots"])
def test_structures_tell_programs_apart(change: str) -> None:
    square = regular_polygon(4, 1.2)
    team = Team(4, 2.21 if change == "cables" else 2.2)
    start, end = ends(team, square, square.rotated(0.3))
    count = 7 if change == "knots" else 6
    polygons = guesses(square, square.rotated(0.3), count)[1].polygons
    limits = ho.Limits(vertex_speed=0.4 if change == "speeds" else 0.5)
    task = search(None, 1.02, (1.5, 1.5), Requirements(limits))
    step = SolverStep(0.17, fastest=change == "fastest")
    plain = SolverStep(0.17)
    usual = search(None, 1.02, (1.5, 1.5))
    both = ends(Team(4, 2.2), square, square.rotated(0.3))
    six = guesses(square, square.rotated(0.3), 6)[1].polygons
    one = build_program(KnotPath.through("turned", *both, six), usual, plain)
    other = build_program(KnotPath.through("turned", start, end, polygons), task, step)
    again = build_program(KnotPath.through("turned", *both, six), usual, plain)
    assert one.program.structure == again.program.structure != other.program.structure


def test_rows_of_parameters_are_their_matrix() -> None:
    rng = np.random.default_rng(6)
    row, column = rng.integers(0, 7, 30), rng.integers(0, 5, 30)  # some places twice
    matrix = sparse.csc_matrix((rng.normal(size=30), (row, column)), shape=(7, 5))
    draft, x = Draft(), rng.normal(size=5)
    value = linear_value(draft, draft.variables(x, x, x), matrix)
    draft.bound(value, np.zeros(7), np.zeros(7))
    _, rows = costs_and_rows(expressions_of(draft.program()))(x)
    np.testing.assert_allclose(
        np.asarray(rows).ravel(), matrix.toarray() @ x, rtol=1e-12, atol=1e-12
    )
