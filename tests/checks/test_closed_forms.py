"""Single checks against numbers that follow from geometry, and violations that samples miss."""

from __future__ import annotations

import math
from collections.abc import Callable, Set
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq

from hitchopt.checks.certificate import Check
from hitchopt.checks.registry import RULE_OF
from hitchopt.checks.separation import leg_remedy
from hitchopt.errors import EXCHANGED
from hitchopt.geometry import ConvexPolygon, regular_polygon
from hitchopt.geometry.vectors import shortest_offset
from hitchopt.hitch import Hitch, Quadrotor, Team
from hitchopt.hitch.requirements import Arena, Prism, Requirements
from hitchopt.hitch.team import Assignment
from hitchopt.motion.motion import Motion
from hitchopt.planners.rests import rest_plan
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.values import Array
from tests.helpers.by_hand import off_prism, sampled
from tests.helpers.motions import (
    TRIANGLE,
    added,
    altered,
    bent,
    chain_motion,
    held_at,
    lines,
    outlined,
    plus,
    random_chain,
    replaced,
    row,
    still,
    triangle,
)
from tests.helpers.refusals import assert_refused

LEGS = [0.35, 0.5, 0.45]


def placed(motion: Motion, drone: int, place: Callable[[Array, Array], Array]) -> Motion:
    """Return the motion with one drone moved, by drones (…, 2n, 3) and vertices (…, n, 3)."""
    p = np.moveaxis(motion.vertices.coefficients, -1, 1)

    def change(c: Array) -> None:
        c[:, drone] = np.moveaxis(place(np.moveaxis(c, -1, 1), p), 1, -1)

    return altered(motion, "drones", change)


def corners(turn: float, n: int) -> Array:
    """Return a chain's points with equal turns [deg]; it may spiral."""
    return bent(100.0 - turn * np.arange(n), np.full(n, 1.3))


def chain(turn: float, n: int) -> Motion:
    """Only points matter: drones are those of a chain with smaller turns."""
    gentle = corners(20.0, n)
    motion = chain_motion(Team(n, 2.2, topology="open"), gentle, gentle, np.full(n, 0.4), order=3)
    return outlined(motion, corners(turn, n), corners(turn, n))


def test_an_approach_of_a_millisecond_is_detected() -> None:
    motion = held_at(triangle(), [0.0, 1.0011, 1.0021, 2.0])
    drones = motion.drones.coefficients[0, :, :, 0]
    path = np.zeros((3, 3, 7))
    path[1, :, 3] = 3.2 * (drones[3] + [0.0, 0.05, 0.0] - drones[0])  # a bump as high as 1
    darting = added(motion, 0, path)
    at_100_hz = sampled(darting, np.linspace(0.0, 2.0, 201))["separation"]
    in_between = sampled(darting, np.linspace(1.0011, 1.0021, 4001))["separation"]
    check = row(darting, "separation")
    assert row(motion, "separation").worst == pytest.approx(at_100_hz, rel=1e-3)
    assert in_between < 0.3 * at_100_hz
    assert in_between >= check.worst >= 0.99 * in_between
    assert check.where == ("q0", "r1")
    assert 1.0011 <= check.time <= 1.0021


PSI = 0.02
TURN = np.array(
    [[math.cos(PSI), -math.sin(PSI), 0], [math.sin(PSI), math.cos(PSI), 0], [0.0, 0.0, 1.0]]
)
HEXAGON = regular_polygon(6, 1.0).vertices
STAR = np.column_stack([f(-4.0 * math.pi * np.arange(5) / 5) for f in (np.cos, np.sin)])
WALLS = Arena([-2.0, -3.0, 0.2], [8.0, 7.0, 1.45])
KINDS = [Quadrotor(0.132, 2.6), Quadrotor(0.2, 2.4), Quadrotor(0.3, 9.0)]
PRISM = Prism([[1.0, -0.5], [0.2, 0.4], [0.9, 1.3], [2.1, 0.6]], 0.4, 1.7)


def with_kinds(*kinds: Quadrotor) -> Motion:
    return still(Team(3, [2.4, 2.5, 2.6], quadrotor=list(kinds)), TRIANGLE, LEGS)


def two(offset: list[float]) -> Motion:
    places = np.array([[0.0, 0.0, 0.0], offset]) + [0.0, 0.0, 3.0]
    return lines(places, places)


def resting(team: Team) -> Motion:
    q_legs = Hitch.balanced(team, regular_polygon(6, 1.0)).q_legs
    return still(team, np.array([2.0, 1.0]) + HEXAGON, q_legs)


def weighed(**weight: Any) -> Motion:
    """A plan without weight for a team with weight: the residual is the weight over T."""
    return replace(resting(Team(6, 2.0, tension=0.5)), team=Team(6, 2.0, tension=0.5, **weight))


# A hexagon of level edges of 1 m and level legs of 0.5 m; spans need more cable. Both pull along
# their ends: catenaries by the roots of ``σ / cosh σ = w s / 2 T``.
EDGE, LEG = (
    brentq(lambda x, size=size: x / math.cosh(x) - 0.5 * 0.0981 * size / 0.5, 1e-6, 1.0)
    for size in (1.0, 0.5)
)
LESS = 1.0 / math.cosh(LEG) - 1.0 / math.cosh(EDGE)  # difference of their level pulls, over T
WEIGHT = 0.0981 * (math.sinh(EDGE) / EDGE + 0.5 * math.sinh(LEG) / LEG)  # of all four halves
ARCS = math.sinh(EDGE) / EDGE - 1.0 + (math.sinh(LEG) / LEG - 1.0)
EXTERIOR = np.min(ConvexPolygon(TRIANGLE).exterior_angles[:2])
ANY: set[tuple[str, ...]] = set()

Worst = float | Callable[[Motion], float]
FORMS: dict[str, tuple[Callable[[], Motion], str, Worst, bool, Set[tuple[str, ...]]]] = {
    "the ellipsoid's height scales an offset": (
        lambda: placed(triangle(), 2, lambda x, _: x[:, :, 1] + [0, 0, 0.45]),
        *("separation", 0.75, False, {("r0", "q1")}),
    ),
    "a drone is off its own edge by its leg times the sine": (
        lambda: still(Team(24, 2.0), regular_polygon(24, 1.3).vertices, np.full(24, 0.35)),
        *("cable_clearance", 0.35 * math.sin(2.0 * math.pi / 24), False),
        {(f"{end}{k}", f"cable {k}") for end in "qr" for k in range(24)},
    ),
    "a drone over a foreign leg, half way along it": (
        lambda: placed(
            triangle(), 5, lambda x, p: 0.5 * (p[:, :, 1] + x[:, :, 2]) + [0.0, 0.0, 0.07]
        ),
        *("cable_clearance", 0.07, False, {("r2", "cable 1")}),
    ),
    "a drone over its own other leg": (
        lambda: placed(
            triangle(), 5, lambda x, p: 0.5 * (p[:, :, 2] + x[:, :, 4]) + [0.0, 0.0, 0.07]
        ),
        *("cable_clearance", 0.07, False, {("r2", "cable 2")}),
    ),
    # On a regular hexagon the lines of edges k - 1 and k + 1 meet an edge's length away.
    "legs that end before the star tip, at 60°": (
        lambda: still(Team(6, 2.9), HEXAGON, np.full(6, 0.95)),
        *("crossing", 0.05, True, {(f"q-leg {k}", f"r-leg {k}") for k in range(6)}),
    ),
    "legs past the star tip": (
        lambda: still(Team(6, 3.1), HEXAGON, np.full(6, 1.05)),
        *("crossing", 0.0, False, {(f"q-leg {k}", f"r-leg {k}") for k in range(6)}),
    ),
    "parts that meet at a clasp are not crossing": (
        *(triangle, "crossing", sampled(triangle(), np.array([0.0]))["crossing"], True, ANY),
    ),
    "82 % of a weak drone's thrust counts more than a strong one's": (
        lambda: with_kinds(*KINDS),
        *("thrust", math.hypot(0.2 * 9.81, 0.4), True, {("q1",), ("r1",)}),
    ),
    "a weaker drone": (
        lambda: with_kinds(*KINDS[:2], Quadrotor(0.3, 2.96)),
        *("thrust", math.hypot(0.3 * 9.81, 0.4), False, {("q2",), ("r2",)}),
    ),
    "a drone leans as its cable pulls": (
        *(triangle, "tilt", math.degrees(math.atan2(0.4, 0.132 * 9.81)), True, ANY),
    ),
    "the nearest wall": (
        lambda: triangle(arena=WALLS),
        *("arena", 0.45, True, {(f"{end}{k}",) for end in "qr" for k in range(3)}),
    ),
    "outside of the arena": (
        lambda: placed(triangle(arena=WALLS), 4, lambda x, _: x[:, :, 4] + [0.0, 0.0, 0.55]),
        *("arena", -0.1, False, {("q2",)}),
    ),
    "the shortest leg": (triangle, "legs", 0.35, True, {("q-leg 0",)}),
    "an end drone off its point, upward: its edge is no longer": (
        lambda: altered(random_chain(3, 7), "drones", plus((slice(None), 5, 2), 0.003)),
        *("cable_length", lambda x: 0.003 / x.team.cable_length[2], False, {("cable 2",)}),
    ),
    "a chain's end with a stated leg": (
        lambda: altered(random_chain(4, 9), "legs", plus((slice(None), 0, 0), 0.01)),
        *("cable_length", lambda x: 0.01 / x.team.cable_length[0], False, {("cable 0",)}),
    ),
    "a wrong stated r-leg": (
        lambda: altered(triangle(), "legs", plus((slice(None), 2, 1), 1e-3)),
        *("cable_length", 1e-3 / 2.6, False, {("cable 2",)}),
    ),
    "massless spans leave no cable over for sagging ones": (
        lambda: weighed(cable_density=0.01),
        *("cable_length", ARCS / 2.0, False, ANY),
    ),
    "level legs do not carry their own weight": (
        lambda: weighed(cable_density=0.01),
        *("equilibrium", math.hypot(WEIGHT / 0.5, LESS), False, ANY),
    ),
    "nor a load": (lambda: weighed(load=0.015), "equilibrium", 9.81 * 0.015 / 0.5, False, ANY),
    "a leg turned by ψ leaves 2 sin(ψ/2) of its tension": (
        lambda: placed(triangle(), 2, lambda x, p: p[:, :, 1] + (x[:, :, 2] - p[:, :, 1]) @ TURN.T),
        *("equilibrium", 2.0 * math.sin(0.5 * PSI), False, {("p1",)}),
    ),
    "|ΔT| |u_k + u_{k-1}| over the smaller tension": (
        lambda: altered(triangle(), "tensions", plus((slice(None), [1, 2]), 0.1)),
        *("equilibrium", 0.25 * 2.0 * math.cos(0.5 * EXTERIOR), False, {("p0",), ("p1",)}),
    ),
    "the sharpest corner": (
        *(triangle, "convexity", 180.0 - math.degrees(math.acos(0.4 / math.hypot(0.4, 1.5)))),
        *(True, {("p1",), ("p2",)}),
    ),
    "a polygon that goes around twice": (
        lambda: outlined(still(Team(5, 4.0), regular_polygon(5, 1.2).vertices, 0.5), STAR, STAR),
        *("convexity", -360.0, False, {()}),
    ),
    "a chain of three corners": (lambda: chain(50.0, 4), "convexity", 50.0, True, ANY),
    "nearly once around": (lambda: chain(85.0, 5), "convexity", 20.0, True, {("p0", "p5")}),
    "more than once around": (lambda: chain(91.0, 5), "convexity", -4.0, False, {("p0", "p5")}),
    "once around in three": (lambda: chain(119.0, 4), "convexity", 3.0, True, {("p0", "p4")}),
    "twice around": (lambda: chain(100.0, 9), "convexity", -440.0, False, {("p0", "p9")}),
    "a chain that bends the other way": (
        *(lambda: chain(-10.0, 4), "convexity", -10.0, False, ANY),
    ),
    "two drones aside": (partial(two, [1, 0, 0]), "tracking_radius", 0.38, True, {("d0", "d1")}),
    "one above the other": (partial(two, [0, 0, 1]), "tracking_radius", 0.2, True, {("d0", "d1")}),
    "not far off": (partial(two, [0, -0.3, 0]), "tracking_radius", 0.03, True, {("d0", "d1")}),
    "a drone past a prism's face": (
        lambda: lines([[0, -1, 1], [-2, 0, 1]], [[0, 3, 1], [-2, 0, 1]], keep_out=(PRISM,)),
        *("keep_out", 0.2, True, {("d0",)}),
    ),
    "the second of two prisms": (
        lambda: lines([[5, 5, 1]], [[5, 5, 1]], keep_out=(Prism(PRISM.polygon, 9, 10), PRISM)),
        *("keep_out", float(off_prism(np.array([5.0, 5.0, 1.0]), PRISM)), True, ANY),
    ),
    "a drone within a prism": (
        lambda: lines([[1, 0.5, 1]], [[1, 0.5, 1]], keep_out=(PRISM,)),
        *("keep_out", 0.0, False, {("d0",)}),
    ),
}
"""A motion, a check, its worst value, whether it holds, and where it may be."""


@pytest.mark.filterwarnings("ignore::hitchopt.errors.UnitWarning")
@pytest.mark.parametrize("name", FORMS)
def test_checks_match_closed_forms(name: str) -> None:
    make, which, worst, holds, where = FORMS[name]
    motion = make()
    check, worst = row(motion, which), worst(motion) if callable(worst) else worst
    rel = {"convexity": 1e-4, "keep_out": 1e-3}.get(
        which,
        5e-5 if "off its point" in name else 1e-6,  # a leg of 3 mm, and its bounds
    )
    assert check.worst == pytest.approx(worst, rel=rel, abs=1e-9)
    assert check.holds is holds
    assert check.where in where or not where or where == {()}
    if which == "thrust":  # held against the limit of what is named
        assert check.limit == motion.team.max_thrust[motion.team.drone_names.index(check.where[0])]


def test_open_clasps_have_an_infinite_residual() -> None:
    """Forces are balanced to the last digit, but a clasp would have to push a cable down."""
    held = still(Team(3, 2.4, tension=0.5, load=0.05), regular_polygon(3, 1.0).vertices, [0.7] * 3)
    assert row(held, "equilibrium").holds

    def exchanged(c: Array) -> None:
        """Each cable is nearly straight, and nothing holds the two together."""
        legs = c - held.vertices.coefficients[:, [0, 1, 1, 2, 2, 0]]
        c[:, [0, 5, 2, 1, 4, 3]] += legs[:, [5, 0, 1, 2, 3, 4]] - legs[:, [0, 5, 2, 1, 4, 3]]

    through = altered(held, "drones", exchanged)
    assert sampled(through, np.array([0.5]))["equilibrium"] < 1e-9
    result = row(through, "equilibrium")
    assert result.worst > 1e300
    assert not result.holds


def test_body_rate_is_zero_at_rest_and_unbounded_in_free_fall() -> None:
    assert row(replaced(triangle(), body_rate=1.0), "body_rate").worst < 1e-6
    fall = [[[0.0, 0.0, 9.0 - k * 9.81 / 2.0]] for k in (0.0, 0.0, 1.0)]
    c = np.moveaxis(np.array(fall), 0, -1)[None]
    dropped = replaced(lines([[0, 0, 9]], [[0, 0, 9]]), body_rate=1.0)
    dropped = replace(dropped, drones=PiecewisePolynomial(dropped.drones.breaks, c))
    assert not row(dropped, "body_rate").holds


@pytest.mark.parametrize(("power", "jump"), [(0, 2e-3), (1, 3e-3), (2, 4e-3)])
def test_jumps_of_position_velocity_and_acceleration(power: int, jump: float) -> None:
    motion = held_at(triangle(), [0.0, 0.5, 2.0])
    path = np.zeros((2, 3, 3))
    # On the second piece: jump · (t - 0.5)^power / power!, as Bernstein coefficients.
    path[1, 1] = [[1.0, 1.0, 1.0], [0.0, 0.75, 1.5], [0.0, 0.0, 1.125]][power]
    check = row(added(motion, 1, jump * path), "continuity")
    assert row(motion, "continuity").worst < 1e-10
    assert check.worst == pytest.approx(jump, rel=1e-6)
    assert (check.time, check.where, check.holds) == (0.5, ("r0",), False)
    assert check.unit == ["m", "m/s", "m/s²"][power]
    whole = row(held_at(triangle(), [0.0, 1.0]), "continuity")  # a single piece: no joint
    assert (whole.worst, whole.holds) == (-math.inf, True)  # nothing to check


@pytest.mark.parametrize(("jump", "holds"), [(1e-8, False), (1e-10, True)])
def test_small_jumps_add_up_unless_they_are_rounding(jump: float, holds: bool) -> None:
    motion = held_at(triangle(), np.linspace(0.0, 1.0, 201).tolist())
    path = np.zeros((200, 3, 1))
    path[:, 1, 0] = jump * np.arange(200)
    check = row(added(motion, 1, path), "continuity")
    assert (check.holds, check.where) == (holds, ("r0",))
    assert check.worst == pytest.approx(jump if holds else 199.0 * jump, abs=1e-11, rel=1e-3)


def test_a_chain_that_curls_up_on_the_way_is_refused() -> None:
    """Every corner turns right at all times; only the sum exceeds 360° at the end."""
    most = []
    for last in (84.0, 96.0):
        motion = outlined(chain(84.0, 5), corners(84.0, 5), corners(last, 5))
        check = row(motion, "convexity")
        value = sampled(motion, np.linspace(0.0, motion.duration, 999))["convexity"]
        assert check.worst <= value
        assert value == pytest.approx(360.0 - 4 * last)
        assert check.where == ("p0", "p5")
        most.append(check.holds)
    assert most == [True, False]


@pytest.mark.parametrize(
    ("outline", "lower", "key", "words"),
    [
        (TRIANGLE[::-1], 0.0, "polygon", "clockwise"),
        (TRIANGLE, 1.0, "upper", "greater than lower 1"),
        (TRIANGLE, math.nan, "lower", "finite"),
    ],
)
def test_invalid_prisms_are_refused(outline: Array, lower: float, key: str, words: str) -> None:
    assert_refused(lambda: Prism(outline, lower, 1.0), key, words)


WIDE = [[0.0, -1.0], [-0.8, 0.6], [0.8, 0.6]]


@pytest.mark.parametrize("density", [0.0, 0.01, 0.02])
def test_edges_sag_toward_the_floor_and_no_clasp_is_below_it(density: float) -> None:
    """A level edge of length s sags by some ``ρ g s² / 8 T``; walls move with the hitch."""
    team, outline = Team(3, 3.0, cable_density=density, tension=0.5), np.array(WIDE)
    longest = max(np.linalg.norm(outline - np.roll(outline, 1, axis=0), axis=1))
    share = 0.5 * density * 9.81 * longest / 0.5
    steep = brentq(lambda x: x - share * math.cosh(x), 0.0, 1.0)
    sag = 0.25 * longest * math.sinh(steep)  # of tangents at its ends
    for shift in ([0.0, 0.0], [3.0, -2.0]):
        here = still(team, outline + shift, [0.4] * 3)
        drones, z = here.drones.coefficients[0, ..., 0], here.vertices.coefficients[0, 0, 2, 0]

        def room(lower: Any, upper: Any, lift: float = 0.0, here: Motion = here) -> Check:
            vertices = here.vertices.coefficients + np.array([[0.0], [0.0], [lift]])
            walled = replace(here.requirements, arena=Arena(lower, upper))
            vertices_ = here.vertices.replaced(vertices)
            return row(here.replaced(requirements=walled, vertices=vertices_), "arena")

        floor = room([-9, -9, z - 0.2], [9, 9, 9])
        assert floor.worst == pytest.approx(0.2 - sag, rel=1e-6)
        assert floor.holds == (sag < 0.2)
        assert density == 0.0 or floor.where[0].startswith("edge")
        assert room([-9, -9, -9], [9, np.max(drones[:, 1]) + 0.07, 9]).worst == pytest.approx(0.07)
        for lift in (-0.3, 0.3):  # vertices alone
            assert not room([-9, -9, z - 0.25], [9, 9, z + 0.25], lift).holds


@pytest.mark.parametrize(
    ("robots", "edge", "length"),
    [(3, 0.8, 1.3), (4, 0.9, 1.7), (7, 0.9, 1.5), (7, 0.9, 1.95)],
    ids=["diverging", "parallel", "converging", "near_the_tip"],
)
@pytest.mark.parametrize("pair", [("q1", "r1"), ("q1", "r0"), ("q1", "cable 1"), ("q1", "cable 0")])
def test_remedies_of_legs_increase_the_distance(
    robots: int, edge: float, length: float, pair: tuple[str, str]
) -> None:
    """Each suggested change, alone, moves the two apart; the opposite one does not."""

    def distance(edge: float, length: float) -> float:
        hitch = Hitch.balanced(Team(robots, length), regular_polygon(robots, edge), 1.0)
        drones, points = hitch.drones, hitch.vertices
        if pair[1].startswith("r"):
            return float(np.linalg.norm(drones[2] - drones[2 * int(pair[1][1]) + 1]))
        k = int(pair[1][-1])  # parts of the cable that do not end at q1
        end = points[(k + 1) % robots]
        parts = np.stack([points[k], end]), np.stack([end, drones[2 * k + 1]])
        return float(min(np.linalg.norm(shortest_offset(drones[2] - part)) for part in parts))

    hitch = Hitch.balanced(Team(robots, length), regular_polygon(robots, edge), 1.0)
    motion = rest_plan(hitch, Requirements()).motion
    remedy = leg_remedy(motion, Check.of("separation", 0.5, 1.0, "min", "ratio", 0.0, pair), "d")
    now, step = distance(edge, length), 1e-3
    words = {"longer cable": (0.0, 1), "shorter cable": (0.0, -1), "larger": (1, 0.0)}
    words["smaller polygon"] = (-1, 0.0)
    for word, (wider, longer) in words.items():
        change = distance(edge * (1.0 + step * wider), length * (1.0 + step * longer)) - now
        assert (word in remedy) == (change > 1e-6), (word, remedy, change)


@pytest.mark.parametrize(
    ("places", "is_noted"),
    [([[3, 0, 1], [2, 1, 1]], True), ([[3, 0, 1], [2, 2, 1]], False), ([[0, 5, 1]] * 2, False)],
)
def test_drones_outside_an_arena_may_have_x_and_y_exchanged(
    places: list[list[float]], is_noted: bool
) -> None:
    """If all of them are inside with both exchanged."""
    motion = lines(places, places, arena=Arena([-1.5, -4.0, 0.0], [1.5, 4.0, 3.0]))
    check = row(motion, "arena")
    assert not check.holds
    assert RULE_OF["arena"].remedy_at(motion, check).endswith(EXCHANGED) is is_noted


def test_legs_are_named_after_the_robots_that_hold_them() -> None:
    motion = triangle()
    assert row(motion, "legs").where == ("q-leg 0",)
    team = replace(motion.team, assignment=Assignment((1, 2, 0), (True, False, False)))
    assert row(motion.replaced(team=team), "legs").where == ("r-leg 1",)
