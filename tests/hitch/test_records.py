"""Teams, limits and settings: refusals with their messages, and derived values."""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np
import pytest

import hitchopt as ho
from hitchopt import Arena, ConvexPolygon, Hitch, InfeasibleError, Limits, Separation
from hitchopt.drones.quadrotor import GRAVITY, MODELS, Quadrotor
from hitchopt.forming.swap_settings import SwapSettings
from hitchopt.hitch.team import Assignment, Swarm, Team
from tests.helpers.refusals import Refusal, assert_refused

TRIANGLE = [[0.0, -1.0], [-0.4, 0.5], [0.4, 0.5]]
HILL = [[-0.6, -0.3], [0.5, 0.5], [1.7, -0.3]]
CHAIN: Any = {"robots": 2, "cable_length": 2.2, "topology": "open"}


def balanced(polygon: Any = TRIANGLE, **given: Any) -> Hitch:
    roll = given.pop("roll", 0.0)
    return Hitch.balanced(Team(**{"robots": 3, "cable_length": 2.4, **given}), polygon, roll=roll)


DEGREES = "must be below 1.571 rad; if degrees were meant, 0.785"
REFUSED: list[Refusal] = [
    *[(lambda n=n: Team(n, 2.0), "robots", "") for n in (1, 3.0, True, 10**9)],
    (lambda: Team(1, 2.2, topology="open"), "robots", "at least 2"),
    (lambda: Team(3, [2.0, 2.0]), "cable_length", "one per robot"),
    (lambda: Team(3, [2.0, 2.0, -1.0]), "cable_length[2]", "greater than 0"),
    (lambda: Team(3, 2.0, tension=0.0), "tension", "greater than 0"),
    (lambda: Team(3, 2.0, cable_density=-0.1), "cable_density", "at least 0"),
    (lambda: Team(3, 2.0, cable_friction=math.inf), "cable_friction", "finite"),
    (lambda: Team(3, 2.0, topology="ring"), "topology", "closed or open"),
    (lambda: Team(3, 2.0, quadrotor=[Quadrotor()] * 2), "quadrotor", "a list of 3"),
    (lambda: Team(3, 2.0, quadrotor=["x260_bolt", "x260", "x260"]), "quadrotor[1]", "did you mean"),
    (lambda: Quadrotor(model="crazyfly_2.1"), "model", "did you mean crazyflie_2.1?"),
    (lambda: Team(3, 2.4, load=[0.1, 0.2]), "load", "one per clasp"),
    (lambda: Team(3, 2.4, load=[0.1, -0.2, 0.1]), "load[1]", "at least 0"),
    (lambda: Quadrotor(mass=0.0), "mass", "greater than 0"),
    (lambda: Quadrotor(max_thrust=-1.0), "max_thrust", "greater than 0"),
    (lambda: Quadrotor(stiffness=0.0), "stiffness", "greater than 0"),
    *[
        (lambda m=m, s=s: Quadrotor(m, s * m * GRAVITY), "max_thrust", "above the drone's weight")
        for m in (0.03, 0.132, 7.0)
        for s in (0.2, 0.9, 0.999)
    ],
    (lambda: Quadrotor(0.5), "max_thrust", "(0.5 kg weigh 4.91 N), or it cannot hover; state the"),
    (lambda: Quadrotor(model="crazyflie_2.1", mass=0.06), "max_thrust", "or it cannot hover"),
    (lambda: Team(3, 2.4, quadrotor={"q2": {"mass": 0.3}}), "quadrotor.q2.max_thrust", "weight"),
    *[(lambda n=n: Swarm(n), "drones", "") for n in (0, 2.0, True, "3", 10**9)],
    (lambda: Limits(speed=0.0), "speed", "greater than 0"),
    (lambda: Limits(tilt=45), "tilt", f"tilt = 45: {DEGREES}"),
    (lambda: SwapSettings(tilt=1.6), "tilt", "below 1.571 rad; if degrees were meant, 0.0279"),
    (lambda: SwapSettings(radius=0.0), "radius", "greater than 0"),
    (lambda: SwapSettings(sense=2), "sense", "must be up, down or auto"),
    (lambda: Separation(radius=-0.1), "radius", "greater than 0"),
    (lambda: Separation(cable=-0.1), "cable", "at least 0"),
    (lambda: Arena([0, 0, 0], [1, 1]), "upper", "point"),
    (lambda: Arena([0, 0, 0], [1, -1, 1]), "upper", "greater than lower"),
    (lambda: Arena([0, 0, math.nan], [1, 1, 1]), "lower[2]", "finite"),
    (lambda: Assignment((0, 0), (False, False)), "assignment.robots", "must be 0 to 1"),
    (lambda: Assignment((0, 1), (False,)), "assignment.flipped", ""),
    (lambda: balanced(robots=4), "polygon", "3 points, not 4, one per robot"),
    (
        lambda: balanced(**CHAIN, polygon=ConvexPolygon(HILL)),
        "polygon",
        "a ConvexArc, since the team",
    ),
    (lambda: balanced(HILL, topology="open"), "polygon", "3 points, not 4, one more than robots"),
    *[(lambda roll=roll: balanced(roll=roll), "roll", "") for roll in (1.6, math.nan, [0.1, 0.2])],
    (lambda: Hitch(Team(3, 2.4), TRIANGLE, 1.0, [0.4, 0.4]), "legs", "one per robot"),
    (lambda: Hitch(Team(3, 2.4), TRIANGLE, math.nan, [0.4] * 3), "altitude", "finite"),
]


@pytest.mark.parametrize("refusal", REFUSED)
def test_bad_values_name_their_key(refusal: Refusal) -> None:
    assert_refused(*refusal)


def test_edges_too_long_for_their_cable_are_refused_by_name() -> None:
    with pytest.raises(InfeasibleError, match=re.escape("edge 0 is 1.55242 m long on a cable of")):
        balanced(cable_length=1.5)
    with pytest.raises(InfeasibleError, match=re.escape("cable 1 leaves 1.6 m")):
        Hitch(Team(3, 2.4), TRIANGLE, 1.0, [0.4, 1.7, 0.4])


def test_per_robot_values_reach_their_drones() -> None:
    kinds = [Quadrotor(0.1 * k, 1.0 * k) for k in (1, 2, 3)]
    team = Team(3, [2.0, 2.5, 3.0], quadrotor=kinds, cable_density=0.02)
    np.testing.assert_allclose(team.mass, [0.1, 0.1, 0.2, 0.2, 0.3, 0.3])
    np.testing.assert_allclose(team.max_thrust, [1, 1, 2, 2, 3, 3])
    np.testing.assert_allclose(team.cable_weight, 0.0981 * np.repeat([2, 2.5, 3], 2))
    assert team.drone_names == ("q0", "r0", "q1", "r1", "q2", "r2")
    swarm = Swarm(2, quadrotor=kinds[:2])
    np.testing.assert_array_equal([swarm.mass, swarm.max_thrust], [[0.1, 0.2], [1, 2]])
    hitch = balanced(cable_length=[2.4, 2.5, 2.6])
    np.testing.assert_allclose(hitch.legs[:, 0], hitch.legs[:, 1])


def test_separation_scale_is_one_where_ellipsoids_touch() -> None:
    scale = Separation(radius=0.12, height=0.3).scale
    np.testing.assert_allclose(scale * [0.24, 0.24, 0.6], 1.0)


@pytest.mark.parametrize("name", MODELS)
def test_the_default_tension_of_a_model_is_a_share_of_its_pull(name: str) -> None:
    team, named = Team(3, 2.4, quadrotor=name), Quadrotor(model=name)
    assert team.quadrotor == (named,) * 3
    weight, level = 9.81 * named.mass, team.tension[0] / 0.31
    assert math.degrees(math.atan2(level, weight)) == pytest.approx(45.0, abs=0.5)  # not 46°
    assert math.hypot(level, weight) < named.max_thrust
    assert isinstance(team.tracking, float)
    assert 0.06 <= team.tracking < 0.08  # light drones are off by more in wind
    own = Team(3, 2.4, quadrotor=[name, Quadrotor(), name], tension=None)
    assert own.tension.tolist() == [team.tension[0], 0.4, team.tension[0]]
    assert Team(3, 2.4, quadrotor=name, tension=0.07).tension.tolist() == [0.07] * 3


def test_the_drones_of_the_paper_have_the_gains_that_fly() -> None:
    kind = Quadrotor(model="paper_132g")
    assert (kind.mass, kind.max_thrust, kind.tension) == (0.132, 2.6, 0.4)
    loop = kind.loop
    assert (loop.kp, loop.kd, loop.ki) == ((4.75, 4.75), (1.32, 1.32), (0.0, 0.0))
    assert loop.feed_forward
    assert loop == Quadrotor(0.132, 2.6, controller="mellinger", gains=kind.gains).loop


def test_specified_numbers_override_the_models() -> None:
    light, kind = Quadrotor(model="crazyflie_2.1"), Quadrotor(model="crazyflie_2.1", mass=0.035)
    assert (kind.mass, kind.max_thrust, kind.controller) == (0.035, 0.45, "mellinger")
    assert kind.loop.kp[0] / light.loop.kp[0] == pytest.approx(0.035 / 0.029, rel=0.01)
    assert (
        Quadrotor(model="x260_bolt", controller="px4").loop
        == Quadrotor(0.32, 11, controller="px4").loop
    )
    # It cannot tilt as far as it could pull: √(0.35² - 0.343²) N.
    weak = Team(3, 2.4, quadrotor=Quadrotor(model="crazyflie_2.1", mass=0.035, max_thrust=0.35))
    assert weak.tension[0] == pytest.approx(
        0.31 * math.sqrt(0.35**2 - (0.035 * 9.81) ** 2), rel=0.1
    )


def by_drone(**own: Any) -> Team:
    return Team(3, 2.4, quadrotor={"mass": 0.1, **own})


def test_quadrotors_by_drone_have_common_keys_and_their_own() -> None:
    team = by_drone(q0={"trim": [0.1, -0.2]}, r2={"mass": 0.2, "thrust_factor": 1.1})
    np.testing.assert_allclose(team.mass, [0.1] * 5 + [0.2])
    np.testing.assert_allclose(team.trim[:2], [[0.1, -0.2], [0.0, 0.0]])
    np.testing.assert_allclose(team.thrust_factor, [1.0] * 5 + [1.1])
    assert len(by_drone().quadrotor) == 3
    assert by_drone(q1={}).quadrotor == by_drone().quadrotor  # equal kinds are those of robots
    named = Team(3, 2.4, quadrotor={"model": "crazyflie_2.1", "r0": {"trim": [0, 0.1]}})
    assert named.kinds[1].model == "crazyflie_2.1"
    assert Team(3, 2.4, quadrotor=team.quadrotor).quadrotor == team.quadrotor
    swarm = ho.Swarm(3, quadrotor={"d1": {"trim": [0.1, 0.0]}})
    np.testing.assert_allclose(swarm.trim[:, 0], [0.0, 0.1, 0.0])


@pytest.mark.parametrize(
    ("kinds", "message"),
    [
        ({"q3": {}}, r"quadrotor\.q3: .*no such drone"),
        ({"d0": {}}, r"quadrotor\.d0: .*no such drone"),
        ({"q0": {"trm": [0, 0]}}, r"quadrotor\.q0\.trm.*did you mean trim"),
        ({"q0": {"trim": [0.1]}}, r"quadrotor\.q0\.trim"),
        ({"q0": {"trim": [30, 0]}}, r"quadrotor\.q0\.trim.*within ±2"),
        ({"q0": 3}, r"quadrotor\.q0 = 3: must be a mapping"),
        ({"q0": {"tracking": {"level": 0, "height": 0.2}}}, r"q0\.tracking\.level.*greater than 0"),
        ({"q0": {"thrust_factor": 0}}, r"q0\.thrust_factor.*greater than 0"),
    ],
)
def test_wrong_quadrotors_by_drone_are_refused(kinds: Any, message: str) -> None:
    with pytest.raises(ho.InputError, match=message):
        Team(3, 2.4, quadrotor=kinds)


def test_drones_keep_their_own_kinds_in_other_roles() -> None:
    team = by_drone(q0={"trim": [0.1, 0.0]}, r1={"trim": [0.2, 0.0]}, q2={"trim": [0.3, 0.0]})
    roles = Assignment((2, 0, 1), (True, False, True)).team(team)
    np.testing.assert_allclose(roles.trim[:, 0], [0.0, 0.3, 0.1, 0.0, 0.2, 0.0])


def test_single_drones_are_named_in_the_singular() -> None:
    assert repr(Swarm(1)) == "Swarm(drones=1)"
    assert repr(Swarm(3, quadrotor="x260_bolt")) == "Swarm(drones=3, quadrotor=x260_bolt)"
    plan = ho.solve([[0.0, 0.0, 1.0]], ho.Fly([[1.0, 0.0, 1.0]]), team=Swarm(1))
    for words in map(repr, (plan, plan.flight, plan.motion)):
        assert "(1 drone, " in words
    with pytest.raises(ho.InputError, match="goal: 2 points, not 1 point, one per drone; change"):
        ho.solve([[0.0, 0.0, 1.0]], ho.Fly([[1.0, 0.0, 1.0], [2.0, 0.0, 1.0]]), team=Swarm(1))
