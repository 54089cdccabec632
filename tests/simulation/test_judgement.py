"""Flights made by hand: which of them are failures, how far off they are, and how they look."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.image import imread
from numpy.typing import NDArray
from scripted import flight_of, formed_where, regular_hitch, standing, unformed

import hitchopt as ho
from hitchopt.cli.simulating import INEXACT, flight_tables
from hitchopt.geometry import regular_polygon
from hitchopt.hitch import Hitch, Team
from hitchopt.simulation.judgement import (
    FAILED,
    NOT_SIMULATED,
    SUCCEEDED,
    Failure,
    Outcome,
    Simulation,
    judge,
    tracking_errors,
    vertex_errors,
    warnings,
)
from hitchopt.simulation.report import drawn_flight, flight_scene
from hitchopt.simulation.settings import ACCURATE, FAST, Settings
from hitchopt.simulation.world import InvalidRunError
from hitchopt.view.style import save_figure

HITCH = regular_hitch(4)
NEIGHBOURS = np.array([[0, 1, 0, 1], [1, 0, 1, 0], [0, 1, 0, 1], [1, 0, 1, 0]])
STRAIN = InvalidRunError("strain", "strain of 5 %", 1.25, "cable 3")


def judged(
    linking: NDArray[np.int64] | None = NEIGHBOURS,
    moved: float = 0.02,
    lost: int | None = None,
    *,
    formed: bool = True,
    pulled: float = 5.0,
    swing: float = 0.0,
    touches: dict[tuple[str, str], float] | None = None,
    error: InvalidRunError | None = None,
) -> Outcome:
    """Return the outcome of a flight of which the second vertex moves under the pull test.

    It swings about its place besides, by ``swing`` to either side.
    """
    t = np.arange(0.0, 5.005, 0.01)
    vertices = np.repeat(HITCH.vertices[None], len(t), axis=0)
    vertices[t > 3.005, 1] += [moved, 0.0, 0.0]
    vertices[:, 1, 1] += swing * np.sin(1.5 * np.pi * t)  # farthest at 3 and at 5 s
    bearing = np.ones((len(t), 4))
    if lost is not None:
        vertices[:, lost], bearing[:, lost] = np.nan, 0.2
    task = standing(HITCH, 2.0) if formed else unformed(standing(HITCH, 2.0))
    known = {"vertices": vertices, "bearing": bearing, "linking": linking, "rested": 3.0}
    flight = flight_of(task, HITCH, t, pulled=pulled, touches=touches or {}, error=error, **known)
    return judge(flight)


def linked(i: int, j: int, number: int) -> NDArray[np.int64]:
    """Return the linking numbers of a hitch of which one pair is linked otherwise."""
    linking = NEIGHBOURS.copy()
    linking[i, j] = linking[j, i] = number
    return linking


UNTESTED = {"pulled": float("nan")}
UNENDED = {"linking": None, "error": STRAIN, **UNTESTED}
PAIRS = [(f"cable {i}", f"cable {j}") for i, j in ((0, 1), (0, 3), (1, 2), (2, 3))]
TOUCH = {("q0", "cable 2"): 0.5}
BROKEN = ("invalid", ("cable 3",), 1.25)


@pytest.mark.parametrize(
    ("given", "verdict", "failures", "hitched"),
    [
        ({}, SUCCEEDED, [], True),
        ({"linking": -NEIGHBOURS}, SUCCEEDED, [], True),  # either sense
        (UNTESTED, SUCCEEDED, [], True),  # no pull test was asked for
        # 14 cm off between two instants, but rest is judged over a second
        ({"moved": 0.0, "swing": 0.07}, SUCCEEDED, [], True),
        ({"linking": linked(0, 1, 0)}, FAILED, [("unlinked", ("p1",), 3.0)], False),
        ({"linking": linked(3, 0, 0)}, FAILED, [("unlinked", ("p0",), 3.0)], False),
        ({"linking": linked(1, 2, 2)}, FAILED, [("unlinked", ("p2",), 3.0)], False),
        ({"linking": linked(0, 2, 1)}, FAILED, [("tangled", ("cable 0", "cable 2"), 3.0)], True),
        ({"linking": linked(1, 3, -1)}, FAILED, [("tangled", ("cable 1", "cable 3"), 3.0)], True),
        ({"moved": 0.13}, FAILED, [("slipped", ("p1",), 5.0)], False),
        ({"lost": 2}, FAILED, [("lost", ("p2",), 3.0)], False),
        ({"lost": 2, **UNTESTED}, FAILED, [("lost", ("p2",), 3.0)], False),
        ({"linking": 0 * NEIGHBOURS, "formed": False}, SUCCEEDED, [], False),
        ({"formed": False}, FAILED, [("tangled", pair, 3.0) for pair in PAIRS], False),
        (UNENDED, NOT_SIMULATED, [BROKEN], False),
        ({"touches": TOUCH, **UNENDED}, FAILED, [("touch", *TOUCH, 0.5), BROKEN], False),
        ({"error": STRAIN, **UNTESTED}, NOT_SIMULATED, [BROKEN], False),  # as it pulled
    ],
)
def test_flights_are_judged_by_links_contact_and_pull(
    given: dict[str, Any], verdict: str, failures: list[Any], hitched: bool
) -> None:
    outcome = judged(**given)
    assert [(found.kind, found.where, found.time) for found in outcome.failures] == failures
    assert (outcome.verdict, outcome.hitched) == (verdict, hitched)
    assert outcome.succeeded is (verdict == SUCCEEDED)


def test_clasps_tell_their_movement_and_force() -> None:
    assert [round(clasp.moved, 9) for clasp in judged().clasps] == [0.0, 0.02, 0.0, 0.0]
    assert judged(moved=0.0, swing=0.07).clasps[1].moved < 0.04
    assert "moves 0.130 m" in judged(moved=0.13).failures[0].words
    assert "presses with 0.200 N, less than 0.212 N" in judged(lost=2).failures[0].words
    assert [clasp.holds for clasp in judged(lost=2).clasps] == [True, True, False, True]
    assert all(np.isnan(clasp.moved) for clasp in judged(lost=2, pulled=np.nan).clasps)
    pulling = judged(error=STRAIN, pulled=np.nan).clasps
    assert [(clasp.bears, clasp.holds) for clasp in pulling] == [(True, False)] * 4
    assert judged(None, error=STRAIN, pulled=np.nan).clasps == ()


def test_errors_are_distances_where_there_is_a_hitch_until_it_has_rested() -> None:
    hitch = regular_hitch(3)
    task = standing(hitch, 0.2)
    late = formed_where(task, hitch, np.arange(len(task.t)) >= 10)
    t = np.append(np.minimum(task.t + 0.003, 0.2), 0.9)  # the last one is after the flight
    found = np.repeat(hitch.vertices[None], len(t), axis=0) + [0.0, 0.03, -0.04]
    found[-2, 1] = np.nan
    errors = vertex_errors(flight_of(late, hitch, t, vertices=found))
    np.testing.assert_allclose(errors.t, t[10:-1])
    np.testing.assert_allclose(errors.errors[:-1], 0.05)
    np.testing.assert_array_equal(np.isnan(errors.errors[-1]), [False, True, False])
    np.testing.assert_allclose(errors.without_sag[0], 0.03)
    np.testing.assert_allclose(errors.offsets[0, :, 2], -0.04)
    assert not errors.moving.any()
    shift = np.concatenate([np.zeros(10), np.linspace(0, 0.1, 11)])
    moving = replace(late, vertices=late.vertices + shift[:, None, None])
    drawn = replace(late, tensions=late.tensions * (1.0 + shift[:, None]))
    for changed in (moving, drawn):
        again = vertex_errors(flight_of(changed, hitch, t, vertices=found))
        np.testing.assert_array_equal(again.moving, [False, *[True] * 10])
    t = np.append(task.t, [0.4, 0.7, 0.9])  # rest, then the pull test
    rested = vertex_errors(flight_of(moving, hitch, t, rested=0.7))
    np.testing.assert_allclose(rested.t, t[10:-1])
    np.testing.assert_array_equal(rested.moving, [False, *[True] * 10, False, False])
    free = unformed(task)
    flight = flight_of(free, hitch, task.t, drones=free.setpoints.positions + [0.03, 0.0, 0.04])
    assert vertex_errors(flight).errors.shape == (0, 3)
    np.testing.assert_allclose(tracking_errors(flight), 0.05)


# Time of the plan, and of the flight with rest and pull test [s]; points of a recorded rope
SECONDS, END, NODES = 0.5, 1.5, 12

LINKED = np.ones((3, 3), dtype=np.int64) - np.eye(3, dtype=np.int64)

TRIANGLE = Hitch.balanced(
    Team(3, [2.3, 2.4, 2.5], tension=0.5), regular_polygon(3, 1.2).vertices + [1.5, -0.5], 2.0
)
MOTION = ho.hold(TRIANGLE, SECONDS).motion


def flown(
    linking: NDArray[np.int64] | None,
    *,
    formed: bool = True,
    end: float = END,
    settings: Settings = Settings(),  # noqa: B008
) -> Simulation:
    """Return a flight in which everything stays where it is planned, 1 cm too low."""
    task = standing(TRIANGLE, SECONDS)
    t, lower = np.arange(0.0, end + 1e-9, 0.01), np.array([0.0, 0.0, -0.01])
    share = np.linspace(0.0, 1.0, NODES)[:, None]
    ends = zip(TRIANGLE.drones[0::2], TRIANGLE.drones[1::2], strict=True)
    ropes = np.concatenate([(1 - share) * a + share * b for a, b in ends])
    flight = flight_of(
        task if formed else unformed(task),
        TRIANGLE,
        t,
        vertices=np.repeat(TRIANGLE.vertices[None] + lower, len(t), axis=0),
        nodes=np.repeat(ropes[None], len(t), axis=0),
        cables=NODES * np.arange(4),
        linking=linking,
        rested=1.0 if end > SECONDS else np.nan,
        pulled=end if end > SECONDS else np.nan,
        settings=settings,
    )
    return Simulation(flight, judge(flight), vertex_errors(flight))


def test_the_picture_tells_what_a_flight_was(tmp_path: Path) -> None:
    figure = drawn_flight(flown(LINKED), MOTION, "Three ropes")
    titles = [axes.get_title() for axes in figure.axes]
    assert titles[:2] == ["start, 0.0 s", f"after the pull test, {END:.1f} s"]
    words = "Three ropes\n3 robots, 6 drones, 0.5 s, simulated: every vertex holds"
    assert figure.get_suptitle() == words
    path = tmp_path / "flight.png"
    save_figure(figure, path)
    assert imread(path).shape[:2] == (864, 1560)
    untied, failure = 0 * LINKED, Failure("dropped", ("tray",), 0.3, "tray is dropped: far below")
    for simulation, words in (
        (flown(untied), "not hitched"),
        (flown(None), "not simulated to its end"),
        (flown(untied, formed=False), "untied, as planned"),
        (flown(LINKED, formed=False), "not untied"),
        (replace(flown(LINKED), outcome=Outcome((), (failure,))), f"but {failure.words}"),
    ):
        assert drawn_flight(simulation, MOTION).get_suptitle().endswith(words)
    brief = flown(None, end=0.005)  # without frames
    assert flight_scene(brief, MOTION) is None
    assert len(drawn_flight(brief, MOTION).axes) == 3


def test_centimetres_are_those_of_the_accurate_preset() -> None:
    for preset in (ACCURATE, FAST):
        text, exact = flight_tables(flown(LINKED, settings=Settings(preset))), preset is ACCURATE
        assert ("1.0 ± 0.0 (1.0)" in text) is ("without sag" in text) is exact
        assert text.count(INEXACT) == (not exact)


def test_friction_that_is_left_at_0_is_warned_of() -> None:
    task = standing(TRIANGLE, 0.1)
    assert "friction is left at 0" in warnings(task, Settings())[0]
    assert warnings(task, Settings(friction=0.0)) == ()
    assert warnings(standing(regular_hitch(3), 0.1), Settings()) == ()
