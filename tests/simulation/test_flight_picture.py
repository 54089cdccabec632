"""Pictures of simulated flights: the plan's moments that were reached, and how a flight ended."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread
from scripted import NO_WIRES, Array, no_poses, standing, unformed

from hitchopt.actions import hold
from hitchopt.geometry import regular_polygon
from hitchopt.hitch import Hitch, Team
from hitchopt.simulation.drone_control import PositionGains
from hitchopt.simulation.error_measures import vertex_errors
from hitchopt.simulation.flight_outcome import Failure, judge
from hitchopt.simulation.flight_picture import drawn_flight, flight_scene
from hitchopt.simulation.flight_records import Film, Flight, Record
from hitchopt.simulation.simulate import Simulation
from hitchopt.simulation.simulation_settings import Settings
from hitchopt.view.style import save_figure

SECONDS, END = 0.5, 1.5
"""Time of the plan, and of the flight with rest and pull test [s]."""

NODES = 12
"""Points of a recorded rope."""

HITCH = Hitch.balanced(
    Team(3, [2.3, 2.4, 2.5], tension=0.5), regular_polygon(3, 1.2).vertices + [1.5, -0.5], 2.0
)


def flown(linking: Array | None, *, formed: bool = True, end: float = END) -> Simulation:
    """Return a flight in which everything stays where it is planned, 1 cm too low."""
    task = standing(HITCH, SECONDS)
    if not formed:
        task = unformed(task)
    t = np.arange(0.0, end + 1e-9, 0.01)
    samples, lower = len(t), np.array([0.0, 0.0, -0.01])
    drones = np.repeat(HITCH.drones[None], samples, axis=0)
    vertices = np.repeat(HITCH.vertices[None] + lower, samples, axis=0)
    tensions = np.full((samples, 3), 0.5)
    record = Record(
        t, drones + lower, drones, vertices, np.ones((samples, 3)), tensions, tensions,
        np.full((samples, 6), 1.4), np.zeros((samples, 6), dtype=np.bool_),
        no_poses(samples).astype(np.float64),
        np.zeros((samples, 0), dtype=np.bool_),
    )  # fmt: skip
    share = np.linspace(0.0, 1.0, NODES)[:, None]
    q, r = HITCH.drones[0::2], HITCH.drones[1::2]
    ropes = np.concatenate([(1 - share) * a + share * b for a, b in zip(q, r, strict=True)])
    frames = t[::5]
    nodes = np.repeat(ropes[None], len(frames), axis=0).astype(np.float32)
    film = Film(frames, nodes, NODES * np.arange(4), no_poses(len(frames)), NO_WIRES)
    links = None if linking is None else linking.astype(np.int64)
    gains = PositionGains.of(task.team, Settings())
    rested, pulled = (1.0, end) if end > SECONDS else (np.nan, np.nan)
    flight = Flight(
        task, record, film, (), links, rested, pulled, 0.01, np.full(3, 0.1), gains, 0.0, None
    )
    return Simulation(Settings(), flight, judge(flight), vertex_errors(flight), 1.0)


LINKED = np.ones((3, 3)) - np.eye(3)


def test_the_storyboard_ends_after_the_pull_test(tmp_path: Path) -> None:
    figure = drawn_flight(flown(LINKED), hold(HITCH, SECONDS).motion, "Three ropes")
    titles = [axes.get_title() for axes in figure.axes]
    assert titles[:2] == ["start, 0.0 s", f"after the pull test, {END:.1f} s"]
    words = "Three ropes\n3 robots, 6 drones, 0.5 s, simulated: every vertex holds"
    assert figure.get_suptitle() == words
    path = tmp_path / "flight.png"
    save_figure(figure, path)
    picture = imread(path)[..., :3]
    assert picture.shape[:2] == (864, 1560)
    assert np.mean(np.ptp(picture, axis=-1) > 0.3) > 1e-3  # cables in colours
    errors = figure.axes[-3].lines[0].get_ydata()
    np.testing.assert_allclose(np.asarray(errors), 1.0, atol=1e-9)  # [cm]


@pytest.mark.parametrize(
    ("linking", "formed", "words"),
    [
        (None, True, "not simulated to its end"),
        (np.zeros((3, 3)), False, "untied, as planned"),
        (LINKED, False, "not untied"),
    ],
)
def test_a_flight_is_called_what_it_was(linking: Array | None, *, formed: bool, words: str) -> None:
    simulation = flown(linking, formed=formed)
    figure = drawn_flight(simulation, hold(HITCH, SECONDS).motion)
    assert figure.get_suptitle().endswith(words)


def test_a_flight_without_frames_has_no_scene_and_still_a_picture() -> None:
    simulation = flown(None, end=0.02)
    motion = hold(HITCH, SECONDS).motion
    assert flight_scene(simulation, motion) is None
    assert len(drawn_flight(simulation, motion).axes) == 4


def test_a_flight_that_dropped_something_does_not_look_well() -> None:
    simulation = flown(LINKED)
    failure = Failure("dropped", ("tray",), 0.3, "tray is dropped: far below")
    outcome = replace(simulation.outcome, failures=(failure,))
    object.__setattr__(simulation, "outcome", outcome)
    figure = drawn_flight(simulation, hold(HITCH, SECONDS).motion)
    assert figure.get_suptitle().endswith("every vertex holds, but tray is dropped: far below")
