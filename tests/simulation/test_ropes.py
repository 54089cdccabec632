"""Limits of a preset are checked before anything is simulated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hitchopt.errors import InputError
from hitchopt.hitch import Team
from hitchopt.simulation.ropes import Ropes, ropes_of
from hitchopt.simulation.simulation_settings import (
    ACCURATE,
    CALM,
    DENSITY,
    FAST,
    FORCE_LAG,
    MOTOR_LAG,
    Perturbations,
    Preset,
    Settings,
)


def test_segments_are_even_equal_and_no_longer_than_asked() -> None:
    ropes = Ropes(np.array([2.4, 2.41, 0.05, 1.0]), 0.01, 0.1, replace(FAST, segment=0.025))
    np.testing.assert_array_equal(ropes.segments, [96, 98, 2, 40])
    np.testing.assert_allclose(ropes.segments * ropes.segment_lengths, ropes.lengths)
    assert np.all(ropes.segment_lengths <= 0.025 + 1e-12)


def test_too_long_a_time_step_is_refused_with_one_that_works() -> None:
    team = Team(3, 2.4, tension=0.5, cable_density=0.01)
    coarse = replace(FAST, time_step=0.004)
    with pytest.raises(InputError, match=r"time_step = 0\.004: must be at most") as caught:
        ropes_of(team, Settings(preset=coarse))
    step = float(caught.value.bound.split()[2])
    finer = Settings(preset=replace(FAST, time_step=0.999 * step))
    assert ropes_of(team, finer).largest_tension >= 1.0
    # The wave's speed is sqrt(T/density): so much lighter cables need a shorter step.
    with pytest.raises(InputError, match="heavier cables"):
        ropes_of(team, Settings(density=0.0005))


def test_cables_without_weight_get_one() -> None:
    assert ropes_of(Team(3, 2.4), Settings()).density == DENSITY
    assert ropes_of(Team(3, 2.4, cable_density=0.004), Settings(preset=ACCURATE)).density == 0.004
    assert ropes_of(Team(3, 2.4, cable_density=0.004), Settings(density=0.02)).density == 0.02
    assert ropes_of(Team(3, 2.4, cable_friction=0.3), Settings()).friction == 0.3
    assert ropes_of(Team(3, 2.4, cable_friction=0.3), Settings(friction=0.0)).friction == 0.0


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Preset("x", 0.0, 0.01, 0.001), "segment"),
        (lambda: Perturbations(noise=-1.0), "noise"),
        (lambda: Perturbations(lag=float("nan")), "lag"),
        (lambda: Perturbations(cable_error=0.5), "cable_error"),
        (lambda: Settings(body="solid"), "body"),
        (lambda: Settings(seed=-1), "seed"),
        (lambda: Settings(friction=-0.1), "friction"),
        (lambda: Settings(density=0.0), "density"),
        (lambda: Settings(ground=float("inf")), "ground"),
        (lambda: Ropes(np.array([1.0, -1.0]), 0.01, 0.1, FAST), r"lengths\[1\]"),
    ],
)
def test_wrong_numbers_are_refused_by_name(make: object, words: str) -> None:
    assert callable(make)
    with pytest.raises(InputError, match=f"^{words} = "):
        make()


def test_a_body_has_its_own_default_lag() -> None:
    assert Settings().lag == MOTOR_LAG
    assert Settings(body="point").lag == FORCE_LAG
    assert Settings(perturbations=replace(CALM, lag=0.0)).lag == 0.0
