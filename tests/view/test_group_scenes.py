"""Several groups, and plans that fly besides, in scenes, pictures and reports."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from groups import moved
from matplotlib.transforms import Bbox
from plans import planned

import hitchopt as ho
from hitchopt.checks import certify
from hitchopt.motion.combined import combined
from hitchopt.motion.motion import Group, Motion
from hitchopt.motion.retiming import shifted
from hitchopt.view.painter import chosen_shots
from hitchopt.view.pictures import draw_summary, panels, plot_from_above, sampled_states
from hitchopt.view.scene import concerned, scene_at
from hitchopt.view.style import OTHERS, new_figure


def pair(*, others: bool = False) -> Motion:
    """Return a triangle below a square that begins a second later."""
    first = planned("triangle").motion
    second = shifted(moved(planned("square_quarter_turn").motion, 0.0, 0.0, 4.0), 1.0)
    if others:
        return combined([Group("", first)], [Group("show", second, "digest")])
    return combined([Group("a", first), Group("b", second)])


def test_a_scene_has_what_each_group_has_alone() -> None:
    """Drones and cables of each are those of its own scene; one that waits is at its start."""
    for motion in (pair(), pair(others=True)):
        t = np.array([0.0, 0.4, 2.0])
        scene, own = scene_at(motion, t), motion.flying
        for group, drones, cables in zip(
            own,
            np.split(scene.drones, [6], axis=1),
            np.split(scene.cables, [3], axis=1),
            strict=True,
        ):
            since = np.clip(t - group.motion.drones.breaks[0], 0.0, group.motion.duration)
            alone = scene_at(group.motion.replaced(others=()), since)
            assert np.allclose(drones, alone.drones, atol=1e-9)
            assert cables.shape == alone.cables.shape
            assert np.max(np.abs(cables - alone.cables)) < 0.05  # bends are as wide as cables
        assert np.allclose(scene.drones[0, 6:], scene.drones[1, 6:])


def test_groups_differ_by_colour_and_name() -> None:
    look, beside = (scene_at(pair(others=each), np.zeros(1)).appearance for each in (False, True))
    assert [group.name for group in look.groups] == ["a", "b"]
    assert len(set(look.drone_colours[:6])) == len(set(look.drone_colours[6:])) == 1
    assert look.drone_colours[0] != look.drone_colours[-1]
    assert look.drones[:2] + look.drones[-1:] == ("a.q0", "a.r0", "b.r3")
    assert look.hollow[:2] == (False, True)
    assert [clasp.name for clasp in look.clasps][3] == "b.p0"
    assert [group.name for group in beside.groups] == ["show"]
    assert set(beside.cable_colours[3:]) == {OTHERS}


def test_names_of_checks_are_found_in_their_group() -> None:
    motion = pair()
    found = concerned(motion, ["b.q1", "a.cable 2", "b.edge 1", "b.p0", "q0"])
    assert (found.drones, found.cables, found.vertices) == ((8,), (2, 4), (3,))


def test_names_of_groups_around_the_same_centre_are_apart() -> None:
    plan = planned("hitch_and_swarm")
    figure = draw_summary(plan.motion, plan.certificate)
    figure.draw_without_rendering()
    named = [[t for t in axes.texts if t.get_fontweight() == "bold"] for axes in figure.axes]
    pairs = [[text.get_window_extent() for text in texts] for texts in named if texts]
    assert len(pairs) == len(chosen_shots(plan.motion))
    for first, second in pairs:
        assert Bbox.intersection(first, second) is None


def test_a_robot_that_joins_is_shown_in_pictures_and_reports(tmp_path: Path) -> None:
    plan = planned("join_a_fourth")
    words = [shot.words for shot in chosen_shots(plan.motion)]
    assert words == ["start", "roll", "lower", "roll", "unroll", "close"]
    shown = panels(plan.motion, sampled_states(plan.motion))
    worst = {check.name: check.bound for check in plan.certificate.checks}
    for panel in shown[1:]:  # of speed and thrust: never beyond what the certificate found
        assert 0.95 * worst[panel.name] < np.max(panel.values) < worst[panel.name] + 1e-9
    plan.view(save=tmp_path / "plan.html")
    text = (tmp_path / "plan.html").read_text(encoding="utf-8")
    data = json.loads(next(iter(re.findall(r"<script[^>]*json[^>]*>(\{.*?)</script>", text, re.S))))
    assert data["names"][-1] == "r3"
    assert data["clasps"] == []  # every ring has its own
    (tension,) = [plot for plot in data["plots"] if plot["label"].startswith("tension")]
    least = [value for value in tension["curves"][0] if value is not None]
    assert least[-1] == pytest.approx(0.7)  # of the ring: the robot that waits has none
    axes = draw_summary(plan.motion, plan.certificate).axes
    assert len(axes) == len(words) + len(shown)
    above = plot_from_above(plan.motion, new_figure((5.0, 5.0)).add_subplot())
    assert {text.get_text() for text in above.texts} == {"p0", "p1", "p2"}


def test_reports_and_pictures_show_all_groups(tmp_path: Path) -> None:
    motion = pair(others=True)
    plan = ho.Plan(motion, certify(motion), "Beside a show")
    plan.view(save=tmp_path / "plan.html")
    text = (tmp_path / "plan.html").read_text(encoding="utf-8")
    data = json.loads(next(iter(re.findall(r"<script[^>]*json[^>]*>(\{.*?)</script>", text, re.S))))
    assert data["names"][-1] == "show.r3"
    assert "beside show" in data["facts"]
    plan.view(save=tmp_path / "plan.png")
    assert (tmp_path / "plan.png").stat().st_size > 20_000
