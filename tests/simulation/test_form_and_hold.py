"""Hitches formed by drones that swap positions, from hanging cables to the pull test."""

from __future__ import annotations

import numpy as np
import pytest
from scripted import forming, regular_hitch

from hitchopt.simulation.simulate import Simulation, simulate
from hitchopt.simulation.simulation_settings import USUAL, Settings


def flown(n: int, turns: list[float] | list[tuple[float, float]], settings: Settings) -> Simulation:
    return simulate(forming(regular_hitch(n), turns, swap=2.0), settings)


@pytest.mark.slow
def test_two_half_turns_form_a_triangle_that_holds() -> None:
    done = flown(3, [1.0, 1.0, 1.0], Settings(perturbations=USUAL, seed=5))
    assert done.outcome.failures == ()
    assert done.outcome.hitched
    assert [clasp.name for clasp in done.outcome.clasps] == ["p0", "p1", "p2"]
    assert {abs(clasp.linking) for clasp in done.outcome.clasps} == {1}
    angle = 2.0 * np.pi / 3.0  # exterior: two pulls of 0.5 N close the force triangle
    for clasp in done.outcome.clasps:
        assert clasp.least_bearing == pytest.approx(0.3 * 2.0 * 0.5 * np.cos(0.5 * angle))
        assert clasp.bearing > 3.0 * clasp.least_bearing
    assert np.nanmax(done.errors.without_sag[-50:]) < 0.15
    tensions = done.flight.record.tensions
    assert np.max(tensions[:300]) < 0.5 * np.min(tensions[-50:])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("turns", "unlinked"),
    [
        ([(0.5, -0.5)] * 3, {"p0", "p1", "p2"}),  # turning back
        ([1.0, -1.0, 0.0], {"p2"}),  # one vertex left out, the others turned either way
    ],
    ids=["turning back", "one left out"],
)
def test_what_must_fail_does_and_is_named(
    turns: list[float] | list[tuple[float, float]], unlinked: set[str]
) -> None:
    done = flown(3, turns, Settings(body="point"))
    assert not done.outcome.hitched
    assert done.flight.error is None
    found = {f.where[0] for f in done.outcome.failures if f.kind == "unlinked"}
    assert found == unlinked
    links = {clasp.name: abs(clasp.linking) for clasp in done.outcome.clasps}
    assert links == {name: int(name not in unlinked) for name in ("p0", "p1", "p2")}


@pytest.mark.slow
@pytest.mark.parametrize("n", [3, 4])
def test_cables_that_merely_cross_are_no_clasps(n: int) -> None:
    """Half a turn, drawn tight as it is: every cable runs straight across its neighbours."""
    task = forming(regular_hitch(n), [(0.5, 0.0)] * n, swap=2.0, swapped=True)
    done = simulate(task, Settings(body="point", perturbations=USUAL, seed=7))
    clasps = done.outcome.clasps
    assert any(abs(clasp.linking) == 1 for clasp in clasps)  # Gauss's integral alone would hold
    assert all(0.0 < clasp.bearing < 0.2 * clasp.least_bearing for clasp in clasps)
    assert not any(clasp.bears or clasp.holds for clasp in clasps)
    lost = {f.where[0] for f in done.outcome.failures if f.kind == "lost"}
    assert lost == {clasp.name for clasp in clasps if abs(clasp.linking) == 1}


@pytest.mark.slow
def test_half_a_turn_holds_nothing() -> None:
    done = flown(3, [(0.5, 0.0)] * 3, Settings(body="point", pull_test=False))
    assert not done.outcome.hitched
    kinds = {failure.kind for failure in done.outcome.failures}
    assert "unlinked" in kinds
    assert np.isnan(done.flight.pulled)
