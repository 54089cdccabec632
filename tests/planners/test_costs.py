"""Custom costs: what they change, by which derivatives, and what is refused."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np
import pytest

import hitchopt as ho
from hitchopt.hitch.casadi_model import CostFunction
from hitchopt.planners.optimise.cost import FlightCost
from hitchopt.planners.optimise.knots import KnotPath

TEAM = ho.Team(robots=4, cable_length=2.4, cable_density=0.002)
SQUARE = ho.regular_polygon(4, 1.2)
START = ho.Hitch.spread(TEAM, SQUARE)
MOVED = SQUARE.translated([1.0, 0.0])
OUTPUTS = ("positions", "thrusts", "tilt_cosines", "legs", "exterior_angles", "separations")


def near_line(weight: float) -> CostFunction:
    """Return the cost of the centroid's distance from the line y = 0.3 m."""
    return lambda out, _: weight * (ca.sum1(out["vertices"][1::3]) / 4 - 0.3) ** 2


def objective(path: ho.Path, cost: CostFunction) -> float:
    duration = ho.time(path).duration
    return duration + FlightCost(TEAM, cost).at_rest(path, duration)


@pytest.mark.slow
def test_a_cost_bends_the_route_the_more_it_weighs() -> None:
    plain = ho.route(START, MOVED)
    distances, durations = [0.09], [ho.time(plain).duration]
    for weight in (1.0, 20.0):
        cost = near_line(weight)
        path = ho.route(START, MOVED, cost=cost)
        motion = ho.time(path)
        assert ho.certify(motion).certified
        assert objective(path, cost) < objective(plain, cost)
        distances.append(FlightCost(TEAM, near_line(1.0)).at_rest(path, 1.0))
        durations.append(motion.duration)
    assert np.all(np.diff(distances) < 0.0)
    assert np.all(np.diff(durations) > 0.0)
    assert FlightCost(TEAM, near_line(1.0)).at_rest(plain, 1.0) == pytest.approx(0.09, abs=1e-9)


def stated_cost(plan: ho.Plan) -> float:
    """Return the cost [s] that a plan states."""
    return float(plan.phases[0].remark.split("its cost is ")[1].removesuffix(" s"))


def test_morph_flies_the_route_of_its_cost_and_says_what_it_costs() -> None:
    cost = near_line(5.0)
    plan = ho.morph(START, MOVED, cost=cost)
    t = np.linspace(0.0, plan.duration, 401)
    from_line = plan.motion.vertices.at(t)[..., 1].mean(axis=1) - 0.3
    assert stated_cost(plan) == pytest.approx(5.0 * plan.duration * np.mean(from_line**2), rel=0.02)
    assert ho.morph(START, MOVED, cost=cost, duration=4.0).duration == 4.0
    # A new function is not answered from the cache of steps, and none leaves everything as it was.
    assert ho.morph(START, MOVED, cost=near_line(20.0)).duration > plan.duration
    assert ho.morph(START, MOVED).duration < plan.duration


@pytest.mark.slow
def test_a_cost_sees_the_hitch_in_motion() -> None:
    """A cost of accelerations slows the clock; the sum of duration and cost is lower."""
    plain = ho.morph(START, MOVED)
    plan = ho.morph(START, MOVED, cost=lambda out, _: 0.3 * ca.sumsqr(out["accelerations"]))

    def objective_of(flown: ho.Plan) -> float:
        t = np.linspace(0.0, flown.duration, 2001)
        squares = np.sum(flown.motion.drones.at(t, 2) ** 2, axis=(1, 2))
        return flown.duration * (1.0 + 0.3 * float(np.mean(squares)))

    assert plan.certificate.certified
    assert plan.duration > 1.2 * plain.duration
    assert objective_of(plan) < 0.8 * objective_of(plain)
    assert plan.duration + stated_cost(plan) == pytest.approx(objective_of(plan), rel=0.01)


@pytest.mark.slow
def test_legs_of_their_own_and_tensions_follow_a_cost() -> None:
    start = ho.Hitch(TEAM, SQUARE, 1.0, [0.4, 0.8, 0.4, 0.8])
    path = ho.route(
        start, MOVED, cost=lambda out, _: 5 * ca.sumsqr(out["legs"][::2] - out["legs"][1::2])
    )
    s = np.linspace(0.0, 1.0, 51)
    uneven = [
        np.abs(np.diff(each.shapes(s).legs, axis=2)).mean()
        for each in (path, ho.route(start, MOVED))
    ]
    assert uneven[0] < 0.5 * uneven[1]
    loose = ho.route(
        START, MOVED, tension=(0.3, 0.6), cost=lambda out, _: 10 * ca.sumsqr(out["tensions"] - 0.55)
    )
    assert ho.time(loose).tensions.at(1.0).min() > 0.45


def everything(out: Mapping[str, Any], s: Any) -> Any:
    """Return a cost of all outputs, curved in all of them."""
    return (1.0 + s) * sum(0.1 * ca.sumsqr(ca.sin(out[name])) for name in OUTPUTS) + ca.sumsqr(
        out["q_legs"]
    )


@pytest.mark.parametrize("roll", [0.0, 0.2])
def test_derivatives_are_those_of_finite_differences(roll: float) -> None:
    start = ho.Hitch.balanced(TEAM, SQUARE, 1.0, roll)
    end = ho.Hitch.balanced(TEAM, MOVED.rotated(0.1), 1.0, roll)
    polygons = np.linspace(SQUARE.vertices, end.polygon.vertices, 5)
    path = KnotPath.through("", start, end, polygons)
    cost = FlightCost(TEAM, everything)
    terms = cost.terms(path, 1.0)
    assert np.linalg.eigvalsh(terms.hessian.toarray()).min() > -1e-9
    columns, step = path.columns, 1e-5
    for column in (columns.vertices[1, 0], columns.q_legs[2], columns.tensions[3]):
        values = []
        for sign in (1.0, -1.0):
            table = path.table.copy()
            table[2, column] += sign * step
            moved = path.with_table(table)
            by = [*columns.vertices.ravel(), *columns.q_legs, *columns.tensions]
            shape = moved.table[2, by][None]
            rolled = None if path.roll is None else path.roll[2:3]
            expansion = cost.expand(shape, np.ones((1, 4)), rolled, np.array([0.5]))
            values.append(expansion.values[0])
        numeric = (values[0] - values[1]) / (2.0 * step) / path.steps
        exact = terms.gradient[(2 - 1) * columns.size + column]
        assert exact == pytest.approx(numeric, rel=1e-5, abs=1e-8)


class Opaque(ca.Callback):
    """A function of one number without derivatives."""

    def __init__(self) -> None:
        super().__init__()
        self.construct("opaque", {})

    def eval(self, values: Sequence[ca.DM]) -> list[ca.DM]:
        return [values[0] ** 2]


REFUSED: list[tuple[Any, str]] = [
    (lambda out, _: out["legs"], "one number, not 8 x 1"),
    (lambda out, _: out["speeds"][0], "'speeds' is not one of positions"),
    (lambda _, s: s, "does not depend on the hitch"),
    (lambda out, _: ca.floor(out["legs"][0]), "floor has no useful derivative"),
    (lambda out, _: out["positions"][0] > 1, "its derivative is zero"),
    (lambda out, _: ca.if_else(out["legs"][0] > 1, 0, 1), "its derivative is zero"),
    (lambda out, _: Opaque()(out["legs"][0]), "it raises RuntimeError: Derivatives cannot"),
    (lambda out, _: 1.0 if out["legs"][0] > 1 else 0.0, "it raises RuntimeError"),
    (lambda out, _: ca.log(-out["legs"][0]), "not finite on the route"),
    (lambda: 0.0, "it raises TypeError"),
    (3, "int"),
]


@pytest.mark.parametrize(("cost", "words"), REFUSED)
def test_what_casadi_does_not_differentiate_is_refused(cost: Any, words: str) -> None:
    with pytest.raises(ho.InputError, match=words) as caught:
        ho.morph(START, MOVED, cost=cost)
    assert caught.value.key == "cost"


def test_chains_take_no_cost() -> None:
    team = ho.Team(robots=2, cable_length=2.4, topology="open")
    start = ho.Hitch.spread(team, [[-1.0, 0.0], [0.0, 0.5], [1.0, 0.0]])
    with pytest.raises(ho.InputError, match="closed hitch") as caught:
        ho.route(start, [[-1.0, 0.0], [0.0, 0.6], [1.0, 0.0]], cost=lambda out, _: out["legs"][1])
    assert caught.value.key == "cost"
