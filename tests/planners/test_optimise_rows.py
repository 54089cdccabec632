"""The optimiser's programs: their rows, their derivatives, and what a solution keeps."""

import casadi as ca
import numpy as np
import pytest
from optimise_cases import FREE, PENTAGON, ends

from hitchopt.hitch import Team
from hitchopt.hitch.requirements import Requirements
from hitchopt.planners.optimise.guesses import guesses
from hitchopt.planners.optimise.knots import (
    KnotPath,
    Search,
    SolverStep,
)
from hitchopt.planners.optimise.program import (
    MorphProgram,
    build_program,
    iterates,
    solve_program,
)
from problems.random_morph import random_convex_polygon


def search(
    tension: tuple[float, float] | None,
    margin: float,
    end_margins: tuple[float, float],
    requirements: Requirements | None = None,
) -> Search:
    return Search(requirements or Requirements(), lambda _: None, tension, end_margins, margin)


def program_of(
    n: int, step: SolverStep, tension: tuple[float, float] | None, shift: float = 0.0
) -> MorphProgram:
    rng = np.random.default_rng(n)
    first = random_convex_polygon(n, 1.1, rng)
    pulls = 0.4 if tension else rng.uniform(0.38, 0.42, n)
    last = first.rotated(1.0).translated([0.4, 0.1 + shift])
    start, end = ends(Team(n, 2.2, tension=pulls), first, last)
    polygons = list(guesses(first, last, 6).values())[1]
    bounds = search(tension, 1.02, (1.5, 1.5))
    return build_program(KnotPath.through("turned", start, end, polygons), bounds, step)


@pytest.mark.parametrize(
    ("step", "tension"),
    [
        (SolverStep(0.17), None),
        (SolverStep(0.17, fastest=True), None),
        (SolverStep(0.12, 4), (0.2, 0.6)),
        (SolverStep(0.12, fastest=True), (0.2, 0.6)),
    ],
)
def test_the_optimisers_derivatives_are_those_of_finite_differences(
    step: SolverStep, tension: tuple[float, float] | None
) -> None:
    program = program_of(3, step, tension).draft
    rng = np.random.default_rng(1)
    multipliers = rng.normal(size=len(program.numbers["lbg"]))
    x, f, g = program.expressions.values()
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


def test_a_solved_program_keeps_its_rows_and_lowers_its_cost() -> None:
    around = program_of(4, SolverStep(0.17), None)
    way, program = solve_program(around), around.draft
    assert way is not None
    x, f, g = program.expressions.values()
    value = ca.Function("value", [x], [f, g])
    cost, rows = value(way.table[1:-1].ravel())
    assert np.all(np.asarray(rows).ravel() >= program.numbers["lbg"] - 1e-4)
    assert np.all(np.asarray(rows).ravel() <= program.numbers["ubg"] + 1e-4)
    assert float(cost) <= float(value(program.numbers["x0"])[0]) + 1e-6


def smallest_distance(path: KnotPath, parts: int) -> float:
    """Smallest distance of two drones at ends of all parts of steps [m]."""
    drones = path.at(np.linspace(0.0, 1.0, parts * path.steps + 1)).table[:, path.columns.drones]
    first, second = np.triu_indices(drones.shape[1], 1)
    return float(np.min(np.linalg.norm(drones[:, first] - drones[:, second], axis=-1)))


def test_parts_of_steps_keep_drones_apart_between_the_knots() -> None:
    last = PENTAGON.renumbered(2)
    start, end = ends(Team(5, 2.6), PENTAGON, last)
    polygons = list(guesses(PENTAGON, last, 9).values())[1]
    first, limit = KnotPath.through("turned", start, end, polygons), 2.0 * FREE.separation.radius
    for parts, kept in ((1, False), (8, True)):
        *_, path = iterates(first, search(None, 1.03, (1.5, 1.5)), SolverStep(0.17, parts), 12)
        assert smallest_distance(path, 1) > limit
        assert (smallest_distance(path, 8) > limit) == kept
