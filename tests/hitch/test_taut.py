"""Taut cables against an integration of their equation: the tension grows by the weight."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from hitchopt.geometry import regular_polygon
from hitchopt.hitch import Hitch, Team
from hitchopt.hitch.energy import energy_of
from hitchopt.hitch.forces import cable_of, leg_vectors, weight_ratios
from hitchopt.hitch.rest_errors import loops_of, planned_rest
from hitchopt.hitch.series import Series
from hitchopt.hitch.taut import closed_sag, series_sag, taut_chord, taut_part

Array = NDArray[np.float64]

EXACT = 1e-5  # of the tension, where a cable sags by a tenth of its level length


def integrated(start: Array, weight: float, length: float) -> Array:
    """Return the chord [m] of a cable that leaves its first end with a tension (3,) [N]."""

    def direction(s: float, _: Array) -> Array:
        tension = start + [0.0, 0.0, weight * s]
        return np.asarray(tension / np.linalg.norm(tension))

    path = solve_ivp(direction, (0.0, length), np.zeros(3), rtol=1e-11, atol=1e-12)
    return np.asarray(path.y[:, -1])


def drawn_cables(count: int) -> list[tuple[Array, float, float, float]]:
    """Return directions at the first end, tensions, weights and lengths: steep ones as well."""
    rng = np.random.default_rng(7)
    cables = list[tuple[Array, float, float, float]]()
    while len(cables) < count:
        weight, tension = rng.uniform(0.005, 0.25), rng.uniform(0.15, 1.0)
        slope, heading, length = (
            rng.uniform(-0.9, 1.3),
            rng.uniform(0.0, 6.3),
            rng.uniform(0.1, 2.5),
        )
        level = math.cos(slope)
        if weight * length <= 0.8 * tension * level:  # sags by a tenth at most
            direction = [level * math.cos(heading), level * math.sin(heading), math.sin(slope)]
            cables.append((np.array(direction), tension, weight, length))
    return cables


def scalar(value: float) -> Series:
    return Series(np.full((1, 1, 1), value))


def test_chords_lengths_and_forces_are_those_of_the_integrated_cable() -> None:
    for direction, tension, weight, length in drawn_cables(60):
        chord = integrated(tension * direction, weight, length)
        ratio = scalar(0.5 * weight / tension)
        along = Series.of_vectors(direction[None])
        found = taut_chord(along, scalar(length), ratio).value[:, 0]
        assert found == pytest.approx(chord, abs=EXACT * length)
        part = taut_part(Series.of_vectors(chord[None]), ratio)
        assert part.length.value.item() == pytest.approx(length, rel=EXACT)
        start, end = (part.force(second=second).value[:, 0] for second in (False, True))
        assert start == pytest.approx(direction, abs=EXACT)
        assert end == pytest.approx(direction + [0.0, 0.0, weight * length / tension], abs=EXACT)


def test_parts_turned_about_the_vertical_and_reversed_are_the_same() -> None:
    rng = np.random.default_rng(3)
    chords = rng.uniform(0.2, 1.0, (20, 3))
    ratios = rng.uniform(0.01, 0.15, 20)
    part = taut_part(Series.of_vectors(chords), Series(ratios[None, None]))
    cosine, sine = math.cos(0.7), math.sin(0.7)
    turn = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    turned = taut_part(Series.of_vectors(chords @ turn.T), Series(ratios[None, None]))
    assert turned.length.value == pytest.approx(part.length.value, rel=1e-14)
    assert turned.force().value == pytest.approx(turn @ part.force().value, abs=1e-14)
    upper = np.linalg.norm(part.force(second=True).value, axis=0)  # over the lower tension
    assert upper == pytest.approx(1.0 + 2.0 * ratios * chords[:, 2], abs=EXACT)
    back = taut_part(Series.of_vectors(-chords), Series((ratios / upper)[None, None]))
    assert back.length.value == pytest.approx(part.length.value, rel=EXACT)
    assert -upper * back.force().value == pytest.approx(part.force(second=True).value, abs=EXACT)


def test_series_and_closed_forms_agree_as_their_slopes_do() -> None:
    level, rise = np.meshgrid(np.linspace(0.0, 0.1, 9), np.linspace(0.0, 0.02, 5))
    series, exact = series_sag(level, rise), closed_sag(level, rise)
    assert series.x == pytest.approx(exact.x, abs=5e-7)
    assert series.stretch == pytest.approx(exact.stretch, abs=5e-6)
    assert series.bulge == pytest.approx(exact.bulge, abs=2e-6)
    step = 1e-5
    ahead, behind = (closed_sag(level[:, 1:] + sign * step, rise[:, 1:]) for sign in (1.0, -1.0))
    mid = closed_sag(level[:, 1:], rise[:, 1:])
    change = ahead.x - behind.x
    assert (ahead.stretch - behind.stretch) / change == pytest.approx(mid.stretch_slope, rel=1e-6)
    assert (ahead.bulge - behind.bulge) / change == pytest.approx(mid.bulge_slope, rel=1e-6)


def test_the_first_term_is_the_parabolas() -> None:
    """``(ρ g / T)² s³ / 24`` longer than its chord, and the next term as κ⁴."""
    team = Team(3, 2.4, cable_density=0.01, tension=0.4)
    chord = np.array([[0.8, 0.0]] * 3)
    excess = [
        cable_of(share * chord, weight_ratios(team, team.tension))[0] / (0.8 * share) - 1.0
        for share in (0.25, 0.5)
    ]
    parabola = [(9.81 * 0.01 / 0.4 * 0.8 * share) ** 2 / 24.0 for share in (0.25, 0.5)]
    errors = [a / b - 1.0 for a, b in zip(excess, parabola, strict=True)]
    assert errors[1] / errors[0] == pytest.approx(4.0, rel=0.02)
    straight = np.array([[0.0, 0.0, 0.7]])
    assert cable_of(straight, np.array([0.1]))[0] == pytest.approx(0.7, abs=1e-15)


@pytest.mark.parametrize("n", [3, 5])
def test_a_planned_hitch_is_the_rest_of_its_energy(n: int) -> None:
    team = Team(n, 2.6, cable_density=0.012, tension=0.35, quadrotor="paper_132g")
    hitch = Hitch.balanced(team, regular_polygon(n, 0.9), 1.5)
    at_rest = planned_rest(
        team, *(x[None] for x in (hitch.drones, hitch.vertices, team.tension, hitch.cable_forces))
    )
    energy = energy_of(team, loops_of(team), at_rest)
    assert np.max(np.abs(energy.slopes(energy.start))) < EXACT * 0.35
    assert energy.tensions(energy.start)[0] == pytest.approx(team.tension, rel=EXACT)


def test_the_forces_of_the_energy_are_its_derivatives_also_where_cables_are_slack() -> None:
    team = Team(3, 2.6, cable_density=0.02, tension=0.4, quadrotor="paper_132g")
    hitch = Hitch.balanced(team, regular_polygon(3, 0.9), 1.5)
    at_rest = planned_rest(
        team, *(x[None] for x in (hitch.drones, hitch.vertices, team.tension, hitch.cable_forces))
    )
    energy = energy_of(team, loops_of(team), at_rest)
    rng = np.random.default_rng(0)
    for closer in (1.0, 0.97, 0.85):
        places = energy.start.copy()
        places[:, : team.drones] = places[:, : team.drones] * closer + 1e-3
        way = rng.normal(size=places.shape) * energy.free
        step = 1e-6
        difference = energy.values(places + step * way) - energy.values(places - step * way)
        slope = np.sum(energy.slopes(places) * way)
        assert difference[0] / (2.0 * step) == pytest.approx(slope, rel=1e-4, abs=1e-6)


def test_legs_leave_in_their_directions_and_reach_their_chords() -> None:
    ratios = np.array([0.0, 0.1, 0.2])
    directions = np.array([[0.6, 0.0, 0.8], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    chords = leg_vectors(np.array([0.9, 0.8, 0.7]), directions, ratios)
    assert chords[0] == pytest.approx(0.9 * directions[0])
    assert np.all(chords[1:, 2] > 0.0)  # level legs rise on their way
    assert cable_of(chords, ratios) == pytest.approx([0.9, 0.8, 0.7], rel=EXACT)
