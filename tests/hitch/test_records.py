"""Team, limits, configuration: what is refused, in which words, and what is derived."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from hitchopt import (
    Arena,
    Hitch,
    InfeasibleError,
    InputError,
    Limits,
    Quadrotor,
    Separation,
    SwapSettings,
    Team,
)

TRIANGLE = [[0.0, -1.0], [-0.4, 0.5], [0.4, 0.5]]


@pytest.mark.parametrize(
    ("angle", "words"),
    [
        (45, "tilt = 45.0: must be below π/2 rad; 45 degrees are 0.785 rad"),
        (1.6, "tilt = 1.6: must be below π/2 rad; 1.6 degrees are 0.0279 rad"),
        (100, "tilt = 100.0: must be below π/2 rad; 45 degrees are 0.785 rad"),
    ],
)
@pytest.mark.parametrize("record", [Limits, SwapSettings])
def test_angles_in_degrees_are_refused_in_radians(
    record: type[Limits | SwapSettings], angle: float, words: str
) -> None:
    with pytest.raises(InputError) as caught:
        record(tilt=angle)
    assert str(caught.value) == words


@pytest.mark.parametrize(
    ("make", "key"),
    [
        (lambda: Team(2, 2.0), "robots"),
        (lambda: Team(3.0, 2.0), "robots"),  # type: ignore[arg-type]
        (lambda: Team(True, 2.0), "robots"),
        (lambda: Team(10**9, 2.0), "robots"),
        (lambda: Team(3, [2.0, 2.0]), "cable_length"),
        (lambda: Team(3, [2.0, 2.0, -1.0]), "cable_length[2]"),
        (lambda: Team(3, math.nan), "cable_length"),
        (lambda: Team(3, 2.0, tension=0.0), "tension"),
        (lambda: Team(3, 2.0, cable_density=-0.1), "cable_density"),
        (lambda: Team(3, 2.0, cable_friction=math.inf), "cable_friction"),
        (lambda: Team(3, 2.0, topology="ring"), "topology"),
        (lambda: Team(3, 2.0, quadrotor=[Quadrotor()] * 2), "quadrotor"),
        (lambda: Quadrotor(mass=0.0), "mass"),
        (lambda: Quadrotor(max_thrust=-1.0), "max_thrust"),
        (lambda: Quadrotor(stiffness=0.0), "stiffness"),
        (lambda: Quadrotor(integral=1), "integral"),  # type: ignore[arg-type]
        (lambda: Quadrotor(feed_forward=None), "feed_forward"),  # type: ignore[arg-type]
        (lambda: Limits(speed=0.0), "speed"),
        (lambda: Limits(tilt=1.6), "tilt"),
        (lambda: Limits(duration=-1.0), "duration"),
        (lambda: Limits(leg="long"), "leg"),  # type: ignore[arg-type]
        (lambda: Separation(radius=-0.1), "radius"),
        (lambda: Separation(cable=-0.1), "cable"),
        (lambda: Arena([0, 0, 0], [1, 1]), "upper"),
        (lambda: Arena([0, 0, 0], [1, -1, 1]), "upper"),
        (lambda: Arena([0, 0, math.nan], [1, 1, 1]), "lower[2]"),
        (lambda: Hitch.balanced(Team(4, 2.4), TRIANGLE), "polygon"),
        (lambda: Hitch(Team(3, 2.4), TRIANGLE, 1.0, [0.4, 0.4]), "legs"),
        (lambda: Hitch(Team(3, 2.4), TRIANGLE, math.nan, [0.4, 0.4, 0.4]), "altitude"),
    ],
)
def test_bad_values_name_their_key(make: Callable[[], object], key: str) -> None:
    with pytest.raises(InputError) as caught:
        make()
    assert caught.value.key == key
    assert caught.value.bound
    assert caught.value.remedy


def test_an_edge_longer_than_its_cable_is_infeasible_and_says_which() -> None:
    with pytest.raises(InfeasibleError, match="edge 0 is 1\\.55242 m long on a cable of 1\\.5 m"):
        Hitch.balanced(Team(3, 1.5), TRIANGLE)


def test_a_leg_list_that_uses_up_the_cable_is_infeasible() -> None:
    with pytest.raises(InfeasibleError, match="cable 1 leaves 1\\.6 m"):
        Hitch(Team(3, 2.4), TRIANGLE, 1.0, [0.4, 1.7, 0.4])


def test_per_robot_values_reach_their_drones() -> None:
    kinds = [Quadrotor(0.1 * k, 1.0 * k) for k in (1, 2, 3)]
    team = Team(3, [2.0, 2.5, 3.0], quadrotor=kinds, cable_density=0.02)
    np.testing.assert_allclose(team.mass, [0.1, 0.1, 0.2, 0.2, 0.3, 0.3])
    np.testing.assert_allclose(team.max_thrust, [1, 1, 2, 2, 3, 3])
    np.testing.assert_allclose(
        team.cable_weight, 0.5 * 9.81 * 0.02 * np.array([2, 2, 2.5, 2.5, 3, 3])
    )
    assert team.drone_names == ("q0", "r0", "q1", "r1", "q2", "r2")


def test_separation_scale_is_one_where_ellipsoids_touch() -> None:
    scale = Separation(radius=0.12, height=0.3).scale
    assert np.linalg.norm(scale * [0.24, 0.0, 0.0]) == pytest.approx(1.0)
    assert np.linalg.norm(scale * [0.0, 0.0, 0.6]) == pytest.approx(1.0)


def test_balanced_legs_are_half_the_slack() -> None:
    hitch = Hitch.balanced(Team(3, [2.4, 2.5, 2.6]), TRIANGLE)
    np.testing.assert_allclose(hitch.legs[:, 0], hitch.legs[:, 1])
    np.testing.assert_allclose(hitch.legs.sum(axis=1) + hitch.polygon.edge_lengths, [2.4, 2.5, 2.6])
