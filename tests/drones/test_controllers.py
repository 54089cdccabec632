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
    MAX_TRACKING,
    MIN_TRACKING,
    FlightController,
    Gains,
    stiffest_gains,
    wind_force,
)
from hitchopt.errors import InputError, UnitWarning

RETUNED = {"kp": 4.75, "kd": 1.32, "ki": 0}


def loop(controller: str, mass: float = 0.132, **gains: Any) -> FlightController:
    thrust = 20.0 * mass  # [N], about twice the weight
    return ho.Quadrotor(mass, thrust, controller=controller, gains=gains or None).loop


@pytest.mark.parametrize(
    ("name", "kp", "after"),
    [  # as the firmwares' benches show them at 132 g
        ("mellinger", (0.40, 1.25), math.inf),
        ("lee", (0.92, 0.92), math.inf),
        ("pid", (1.3, 1.3), 25.0),  # level after 3 s, part of which is the integral's
        ("px4", (0.23, 0.53), 4.6),
    ],
)
def test_defaults_are_those_of_the_public_firmwares(
    name: str, kp: tuple[float, float], after: float
) -> None:
    found = loop(name)
    level = found.kp[0] + (3.0 * found.ki[0] if name == "pid" else 0.0)
    assert level == pytest.approx(kp[0], rel=0.03)
    assert found.kp[1] == pytest.approx(kp[1], rel=0.15)
    if math.isfinite(after):
        assert found.kp[0] / found.ki[0] == pytest.approx(after, rel=0.05)
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


def test_mellingers_integral_has_a_largest_force() -> None:
    assert loop("mellinger").ki_limit == pytest.approx((0.10, 0.02))
    assert loop("mellinger", ki=[0.1, 0]).ki_limit == pytest.approx((0.2, 0.0))
    assert loop("mellinger", **RETUNED).ki_limit == (0.0, 0.0)
    assert loop("px4").ki_limit == (math.inf, math.inf)


@pytest.mark.parametrize(
    ("name", "mass", "gains", "measured"),
    [  # what 95 of 100 flights keep [m], as python -m benchmarks tracking_errors writes
        ("mellinger", 0.132, {}, 0.339),
        ("mellinger", 0.0393, {}, 0.143),
        ("mellinger", 0.5, {}, 0.379),
        ("mellinger", 0.0393, stiffest_gains(0.0393), 0.062),
        ("mellinger", 0.029, stiffest_gains(0.029), 0.067),
        ("mellinger", 0.132, RETUNED, 0.045),
        ("lee", 0.132, {}, 0.151),
        ("lee", 0.0393, {}, 0.216),
        ("pid", 0.132, {}, 0.391),
        ("px4", 0.132, {}, 0.414),
        ("px4", 0.25, {}, 0.245),
        ("px4", 0.25, stiffest_gains(0.25, name="px4"), 0.1),
    ],
)
def test_tracking_errors_are_at_least_those_of_perturbed_flights(
    name: str, mass: float, gains: dict[str, Any], measured: float
) -> None:
    tracking = loop(name, mass, **gains).tracking
    assert tracking is not None
    assert tracking >= measured


@given(st.sampled_from(CONTROLLERS), st.floats(0.03, 0.5), st.floats(0.6, 1.0))
def test_tracking_errors_grow_by_a_multiple_of_the_offset_in_wind(
    name: str, mass: float, softer: float
) -> None:
    """Three stiffnesses with the same offsets in between have errors with the same differences."""
    stiff = loop(name, mass).kp[0]
    offsets = np.array([1.0, 1.0 / softer, 2.0 / softer - 1.0]) / stiff
    errors: list[Any] = [loop(name, mass, kp=1.0 / offset).tracking for offset in offsets]
    first, second = np.diff(errors)
    assert second == pytest.approx(first, rel=1e-6, abs=1e-9)
    assert first >= 0.0


@given(st.floats(0.01, 0.132), st.floats(0.2, 1.0))
def test_wind_pushes_drones_by_their_area(mass: float, scale: float) -> None:
    """Drones of equal density and half the length have a quarter of the area."""
    assert wind_force(scale**3 * mass) == pytest.approx(scale**2 * wind_force(mass))
    assert wind_force(0.132 / scale) == wind_force(0.132)


def test_tracking_errors_are_bounded() -> None:
    assert loop("mellinger", **RETUNED).tracking == MIN_TRACKING
    with pytest.warns(UnitWarning):
        assert loop("mellinger", kp=1e-6).tracking == MAX_TRACKING


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
