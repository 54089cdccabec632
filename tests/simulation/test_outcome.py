"""Outcomes of flights made by hand: which of them are failures."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scripted import NO_WIRES, no_poses, regular_hitch, standing, unformed

from hitchopt.simulation.drone_control import PositionGains
from hitchopt.simulation.flight_outcome import FAILED, NOT_SIMULATED, SUCCEEDED, Outcome, judge
from hitchopt.simulation.flight_records import Film, Flight, Record, Touch
from hitchopt.simulation.simulation_settings import Settings
from hitchopt.simulation.validity import InvalidRunError

Array = NDArray[np.float64]

HITCH = regular_hitch(4)
NEIGHBOURS = np.array([[0, 1, 0, 1], [1, 0, 1, 0], [0, 1, 0, 1], [1, 0, 1, 0]])


def judged(
    linking: NDArray[np.int64] | None = NEIGHBOURS,
    moved: float = 0.02,
    lost: int | None = None,
    *,
    formed: bool = True,
    pulled: float = 5.0,
    touches: tuple[Touch, ...] = (),
    error: InvalidRunError | None = None,
) -> Outcome:
    """Return the outcome of a flight of which the second vertex moves under the pull test."""
    t = np.arange(0.0, 5.01, 0.1)
    vertices = np.repeat(HITCH.vertices[None], len(t), axis=0)
    vertices[t > 3.05, 1] += [moved, 0.0, 0.0]
    some = np.ones((len(t), 4))
    bearing = some.copy()
    if lost is not None:
        vertices[:, lost] = np.nan
        bearing[:, lost] = 0.2
    many = np.ones((len(t), 8))
    drones = np.zeros((len(t), 8, 3))
    nothing = no_poses(len(t)).astype(np.float64), np.zeros((len(t), 0), dtype=np.bool_)
    record = Record(t, drones, drones, vertices, bearing, some, some, many, many > 2.0, *nothing)
    shapes = np.zeros((len(t), 2, 3), dtype=np.float32), np.array([0, 2])
    film = Film(t, *shapes, no_poses(len(t)), NO_WIRES)
    task = standing(HITCH, 2.0) if formed else unformed(standing(HITCH, 2.0))
    least = np.full(4, 0.3)
    gains = PositionGains.of(task.team, Settings())
    ended = (linking, 3.0, pulled, 0.01, least, gains, 0.0, error)
    return judge(Flight(task, record, film, touches, *ended))


def test_linked_bearing_and_held_is_hitched() -> None:
    outcome = judged()
    assert outcome.succeeded
    assert outcome.hitched
    assert [round(clasp.moved, 9) for clasp in outcome.clasps] == [0.0, 0.02, 0.0, 0.0]
    assert judged(-NEIGHBOURS).hitched  # either sense
    assert judged(pulled=float("nan")).hitched  # no pull test was asked for


@pytest.mark.parametrize(
    ("pair", "number", "kind", "where"),
    [
        ((0, 1), 0, "unlinked", ("p1",)),
        ((3, 0), 0, "unlinked", ("p0",)),
        ((1, 2), 2, "unlinked", ("p2",)),
        ((0, 2), 1, "tangled", ("cable 0", "cable 2")),
        ((1, 3), -1, "tangled", ("cable 1", "cable 3")),
    ],
)
def test_wrong_links_are_named(
    pair: tuple[int, int], number: int, kind: str, where: tuple[str, ...]
) -> None:
    linking = NEIGHBOURS.copy()
    linking[pair] = linking[pair[::-1]] = number
    outcome = judged(linking)
    (failure,) = outcome.failures
    assert (failure.kind, failure.where, failure.time) == (kind, where, 3.0)
    assert not outcome.succeeded
    assert outcome.hitched == (kind == "tangled")


def test_a_vertex_that_gives_way_has_slipped() -> None:
    (failure,) = judged(moved=0.13).failures
    assert (failure.kind, failure.where, failure.time) == ("slipped", ("p1",), 5.0)
    assert "0.130 m" in failure.words


def test_cables_that_do_not_bear_have_lost_their_vertex() -> None:
    outcome = judged(lost=2)
    (failure,) = outcome.failures
    assert (failure.kind, failure.where) == ("lost", ("p2",))
    assert "press with 0.200 N, less than the 0.300 N from which on a clasp bears" in failure.words
    assert [clasp.holds for clasp in outcome.clasps] == [True, True, False, True]
    untested = judged(lost=2, pulled=float("nan"))
    assert [clasp.holds for clasp in untested.clasps] == [True, True, False, True]
    assert all(np.isnan(clasp.moved) for clasp in untested.clasps)


def test_a_plan_that_ends_without_a_hitch_has_to_end_untangled() -> None:
    assert judged(np.zeros((4, 4), dtype=np.int64), formed=False).succeeded
    outcome = judged(formed=False)
    assert {failure.kind for failure in outcome.failures} == {"tangled"}
    assert len(outcome.failures) == 4
    assert not outcome.hitched


def test_a_run_that_left_its_range_is_not_a_failed_plan() -> None:
    error = InvalidRunError("strain", 0.05, 0.02, "m/m", -1.25, "cable 3")
    settling = judged(None, error=error, pulled=float("nan"))
    assert (settling.verdict, settling.succeeded, settling.clasps) == (NOT_SIMULATED, False, ())
    touched = Touch(0.5, "q0", "cable 2")
    assert judged(None, touches=(touched,), error=error, pulled=float("nan")).verdict == FAILED
    assert (judged().verdict, judged(lost=2).verdict) == (SUCCEEDED, FAILED)
    pulling = judged(error=error, pulled=float("nan"))  # linked and bearing until then
    assert pulling.verdict == NOT_SIMULATED
    assert [(clasp.bears, clasp.holds) for clasp in pulling.clasps] == [(True, False)] * 4


def test_touches_and_an_early_end_come_in_order_of_time() -> None:
    error = InvalidRunError("strain", 0.05, 0.02, "m/m", 1.25, "cable 3")
    touched = Touch(0.5, "q0", "cable 2")
    outcome = judged(None, touches=(touched,), error=error, pulled=float("nan"))
    assert [(f.kind, f.where, f.time) for f in outcome.failures] == [
        ("touch", ("q0", "cable 2"), 0.5),
        ("invalid", ("cable 3",), 1.25),
    ]
    assert not outcome.hitched
