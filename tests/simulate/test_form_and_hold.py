"""Hitches formed by drones that swap places, from hanging cables to the pull test."""

from __future__ import annotations

import numpy as np
import pytest
from scripted import forming, regular_hitch

from hitchopt.simulate.settings import USUAL, Settings
from hitchopt.simulate.simulation import Simulation, Task, simulate


def flown(n: int, turns: list[float] | list[tuple[float, float]], settings: Settings) -> Simulation:
    hitch = regular_hitch(n)
    return simulate(Task(hitch.team, *forming(hitch, turns, swap=3.0)), settings)


def test_two_half_turns_form_a_triangle_that_holds() -> None:
    done = flown(3, [1.0, 1.0, 1.0], Settings(perturbations=USUAL, seed=5))
    assert done.outcome.failures == ()
    assert done.outcome.hitched
    assert [clasp.name for clasp in done.outcome.clasps] == ["p0", "p1", "p2"]
    assert {abs(clasp.linking) for clasp in done.outcome.clasps} == {1}
    assert np.nanmax(done.errors.without_sag[-50:]) < 0.15
    tensions = done.flight.record.tensions
    assert np.max(tensions[:300]) < 0.5 * np.min(tensions[-50:])


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


def test_half_a_turn_holds_nothing() -> None:
    done = flown(3, [(0.5, 0.0)] * 3, Settings(body="point", pull_test=False))
    assert not done.outcome.hitched
    kinds = {failure.kind for failure in done.outcome.failures}
    assert "unlinked" in kinds
    assert np.isnan(done.flight.pulled)
