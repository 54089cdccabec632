"""Flight controllers: gains by mass, derived values, and inconsistent settings."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import hitchopt as ho
from hitchopt.drones.controllers import (
    CONTROLLERS,
    FlightController,
    Gains,
    stiffest_gains,
)
from hitchopt.errors import InputError

RETUNED = {"kp": 4.75, "kd": 1.32, "ki": 0}


def loop(controller: str, mass: float = 0.132, **gains: Any) -> FlightController:
    thrust = 20.0 * mass  # [N], about twice the weight
    return ho.Quadrotor(mass, thrust, controller=controller, gains=gains or None).loop


@pytest.mark.parametrize(
    ("name", "kp", "after", "tracking"),
    [  # as the firmwares' benches show them at 132 g
        ("mellinger", (0.40, 1.25), math.inf, 0.22),
        ("lee", (0.92, 0.92), math.inf, 0.35),
        ("pid", (1.3, 1.3), 25.0, 0.52),  # level after 3 s, part of which is the integral's
        ("px4", (0.23, 0.53), 4.6, 0.22),
    ],
)
def test_defaults_are_those_of_the_public_firmwares(
    name: str, kp: tuple[float, float], after: float, tracking: float
) -> None:
    found = loop(name)
    level = found.kp[0] + (3.0 * found.ki[0] if name == "pid" else 0.0)
    assert level == pytest.approx(kp[0], rel=0.03)
    assert found.kp[1] == pytest.approx(kp[1], rel=0.15)
    if math.isfinite(after):
        assert found.kp[0] / found.ki[0] == pytest.approx(after, rel=0.05)
    assert found.tracking == pytest.approx(tracking)
    assert found.feed_forward == (name != "pid")
    tilt = 0.132 * 9.81 * math.tan(loop("pid").max_tilt)
    assert tilt == pytest.approx(0.47, abs=0.005)  # the largest pull that a PID holds [N]


@given(st.sampled_from(CONTROLLERS), st.floats(0.03, 0.5), st.floats(1.2, 3.0))
def test_gains_scale_with_the_mass_but_for_mellingers(
    name: str, mass: float, factor: float
) -> None:
    light, heavy = loop(name, mass), loop(name, factor * mass)
    ratio = 1.0 if name == "mellinger" else factor
    for key in ("kp", "kd", "ki"):
        np.testing.assert_allclose(getattr(heavy, key), np.multiply(ratio, getattr(light, key)))
    assert light.tracking is not None
    assert heavy.tracking is not None
    assert heavy.tracking >= light.tracking - 1e-12  # no drone of less acceleration is closer


def test_mellingers_integral_has_a_largest_force() -> None:
    assert loop("mellinger").ki_limit == pytest.approx((0.10, 0.02))
    assert loop("mellinger", ki=[0.1, 0]).ki_limit == pytest.approx((0.2, 0.0))
    assert loop("mellinger", **RETUNED).ki_limit == (0.0, 0.0)
    assert loop("px4").ki_limit == (math.inf, math.inf)


def test_tracking_errors_match_three_flights_with_mellingers_controller() -> None:
    """The last one is perturbed, and its error what 95 of 100 such flights keep."""
    offs: list[Any] = [loop("mellinger", mass).tracking for mass in (0.132, 0.0393)]
    offs.append(loop("mellinger", **RETUNED).tracking)
    np.testing.assert_allclose(offs, [0.22, 0.11, 0.057], rtol=0.07)


def test_gains_reach_their_drones_and_axes() -> None:
    named = ho.Quadrotor(0.132, controller="mellinger", gains={"kp": [3.0, 2.0]})
    kinds = [named, ho.Quadrotor(0.1, stiffness=4.0, integral=True), ho.Quadrotor()]
    team = ho.Team(3, 2.4, quadrotor=kinds)
    rows = [[3.0, 3.0, 2.0], [4.0] * 3, [np.inf] * 3]
    np.testing.assert_array_equal(team.stiffness, np.repeat(rows, 2, axis=0))
    rows = [[0.2, 0.2, 0.4], [10.0 / 6.0 * math.sqrt(0.4)] * 3, [np.inf] * 3]
    np.testing.assert_allclose(team.damping, np.repeat(rows, 2, axis=0))
    np.testing.assert_allclose(team.integral[::2], [[0.1, 0.1, 0.02], [np.inf] * 3, [0.0] * 3])
    np.testing.assert_allclose(team.integral_gain[::2], [[0.05] * 3, [2.0] * 3, [0.0] * 3])
    assert team.tracking == named.loop.tracking
    assert ho.Team(3, 2.4).tracking is None


@given(st.sampled_from(["mellinger", "lee"]), st.floats(0.03, 0.5), st.floats(0.016, 0.2))
def test_gains_for_a_delay_are_accepted_and_stiffer_ones_refused(
    name: str, mass: float, latency: float
) -> None:
    gains = stiffest_gains(mass, latency, name)
    found = ho.Quadrotor(mass, 20.0 * mass, controller=name, gains=gains, latency=latency).loop
    scale = 0.055 / (latency + 0.04)
    usual = stiffest_gains(mass, None, name)
    assert found.kp[0] == pytest.approx(scale**2 * usual["kp"], rel=0.01)
    assert found.kd[0] == pytest.approx(scale * usual["kd"], rel=0.01)
    for key in ("kp", "kd"):
        stiffer = {**gains, key: 1.03 * gains[key]}
        ho.Quadrotor(mass, 20.0 * mass, controller=name, gains={**usual, key: 0.9 * usual[key]})
        with pytest.raises(
            InputError,
            match=rf"gains.{key} = .* latency of .*; the stiffest stable gains are {{kp: ",
        ):
            ho.Quadrotor(mass, 20.0 * mass, controller=name, gains=stiffer, latency=latency)


def test_models_of_drones_have_gains_for_the_stated_delay() -> None:
    kind = ho.Quadrotor(model="crazyflie_2.1_brushless", latency=0.04)
    assert kind.gains == Gains.of(stiffest_gains(kind.mass, 0.04))
    assert kind.loop.kp[0] == pytest.approx((0.055 / 0.08) ** 2 * 36.0 * kind.mass, rel=0.005)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"controller": "melinger"}, "controller = 'melinger': must be mellinger, lee"),
        ({"gains": {"kp": 1.0}}, "gains = .*: must be omitted without a controller"),
        ({"latency": 0.03}, "latency = 0.03: must be omitted without a controller"),
        ({"controller": "lee", "latency": 0.08}, "gains.kp = .*at a latency of 80 ms"),
        ({"controller": "lee", "stiffness": 2.0}, "stiffness = 2.0: .* with controller lee"),
        ({"controller": "lee", "integral": False}, "integral = False: .* with controller lee"),
        ({"controller": "pid", "feed_forward": True}, "feed_forward = True: .* controller pid"),
        ({"controller": "lee", "gains": {"kp": 4.75}}, r"gains.kp = 4.75: .* at most 14/s² .*1.85"),
        ({"controller": "lee", "gains": {"kp": [1, 2, 3]}}, "gains.kp = .*at most 2 entries"),
        ({"controller": "lee", "gains": {"kd": 0.0}}, "gains.kd = 0.0: must be greater than 0"),
        ({"controller": "lee", "gains": {"p": 0.0}}, "gains.p = 0.0: .* did you mean kp"),
    ],
)
def test_inconsistent_settings_are_refused(given: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        ho.Quadrotor(**given)
