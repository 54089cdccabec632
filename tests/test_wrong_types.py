"""Arguments of wrong types: an InputError that names the argument, in every public function."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hitchopt as ho
from hitchopt import api

TRIANGLE = [[0.0, -1.0], [-0.4, 0.5], [0.4, 0.5]]
Q = [[-0.6, -1.2, 0.0], [-0.6, 0.0, 0.0], [-0.6, 1.2, 0.0]]
R = [[0.6, -1.2, 0.0], [0.6, 0.0, 0.0], [0.6, 1.2, 0.0]]
TEAM = ho.Team(3, 2.4)
START = ho.Hitch(TEAM, TRIANGLE, 1.0, [0.3, 0.8, 0.25])
PLAN = ho.hold(START, 1.0)
PAIR = ho.Swarm(2)
LOWER, UPPER = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]], [[0.0, 0.0, 1.0], [1.0, 0.0, 1.0]]
SECTION = ho.Section(radius=0.1)
CRATE = ho.Mission(TEAM, START, objects={"crate": ho.SolidObject(SECTION, at=[1.5, 0.0, 0.0])})
ENCLOSED = CRATE.enclose("crate")
HELD = ENCLOSED.grasp("crate", by="grip")
VERTICES = PLAN.at(0.0).vertices
FEEDBACK, PLAYER = ho.Feedback(PLAN), ho.Player(PLAN)
REST: dict[str, Any] = {"limits": None, "separation": None, "arena": None}
RECORDS: dict[str, Any] = {
    "limits": ho.Limits(),
    "separation": ho.Separation(),
    "arena": None,
    "title": "",
}
STEPS: dict[str, dict[str, Any]] = {
    "morph": {
        "polygon": TRIANGLE,
        "legs": None,
        "duration": None,
        "optimize": False,
        "tension": None,
    },
    "move_vertex": {"vertex": 0, "by": [0.0, 0.1], "legs": None, "duration": None},
    "move_edge": {"edge": 0, "by": [0.0, 0.1], "legs": None, "duration": None},
    "adjust": {"legs": "balanced", "duration": None},
    "follow_vertex": {"vertex": 0, "path": [[1.0, 0.0, -0.9]], "legs": None},
    "transport": {"to": [0.0, 0.0, 1.0], "yaw": 0.0, "duration": None},
    "hold": {"seconds": 1.0},
    "release": {"duration": None},
}
FORM: dict[str, Any] = {"polygon": TRIANGLE, "altitude": 1.0, "legs": None, "assign": "auto"}
AFTER = -1.0
"""A time that is refused, so that nothing is computed."""

NOWHERE = "there is no such file"
GOOD: list[tuple[Callable[..., object], dict[str, Any]]] = [
    *((getattr(ho, name), {"start": START, **values, **REST}) for name, values in STEPS.items()),
    *((getattr(ho.Mission(TEAM, START), name), values) for name, values in STEPS.items()),
    (ho.form, {"team": TEAM, "q": Q, "r": R, **FORM, "swap": None, "duration": None, **REST}),
    (ho.Mission(TEAM, ho.DronesStart(Q, R)).form, {**FORM, "swap": ho.SwapSettings()}),  # type: ignore[arg-type]
    (ho.land, {"team": TEAM, "q": Q, "r": R, "duration": None, **REST}),
    (ho.solve, {"problem": ho.Problem(TEAM, START, (ho.Hold(1.0),)), "limit": None}),
    (ho.separate, {"problem": NOWHERE}),
    (ho.suggestions, {"problem": NOWHERE}),
    (ho.repair, {"problem": NOWHERE}),
    (ho.certify, {"motion": PLAN.motion}),
    (ho.closest, {"plan": PLAN, "spans": 2}),
    (ho.settle, {"plan": PLAN, "t": AFTER}),
    (ho.tolerance, {"plan": PLAN, "t": AFTER}),
    (ho.hanging_cable, {"first": [0, 0, 0], "second": [1, 0, 0], "length": 2.0, "points": 5}),
    (ho.regular_polygon, {"n": 3, "edge": 1.0, "angle": 0.0}),
    (ho.load, {"directory": NOWHERE}),
    (ho.lint, {"path": NOWHERE}),
    (ho.calibrate, {"plan": NOWHERE, "recording": NOWHERE}),
    (ho.export, {"plan": PLAN, "format": "none", "folder": NOWHERE}),
    (ho.simulate, {"plan": NOWHERE, "preset": "fast", "perturbed": False, "perturbations": None}),
    (PLAN.at, {"t": 0.5}),
    (PLAN.to_dataframe, {"rate": 2.0}),
    (ho.Team, {"robots": 3, "cable_length": 2.4, "topology": "closed", "quadrotor": None}),
    (
        ho.Team,
        {"robots": 3, "cable_length": 2.4, "tension": 0.4, "load": 0.0},
    ),
    (ho.Swarm, {"drones": 2, "quadrotor": None}),
    (ho.Quadrotor, {"mass": 0.1, "max_thrust": 2.6, "stiffness": None, "integral": False}),
    (ho.Limits, {"speed": 1.0, "tilt": 0.7, "leg": 0.15, "duration": None, "body_rate": None}),
    (ho.Limits, {"tilt_deg": 40.0, "body_rate_deg": None}),
    (ho.Separation, {"radius": 0.1, "height": 0.3, "cable": 0.1, "crossing": 0.05}),
    (ho.Arena, {"lower": [0, 0, 0], "upper": [1, 1, 1]}),
    (ho.Prism, {"polygon": TRIANGLE, "lower": 0.0, "upper": 9.0}),
    (
        ho.Hitch,
        {"team": TEAM, "polygon": TRIANGLE, "altitude": 1.0, "q_legs": [0.3] * 3},
    ),
    (ho.Hitch.balanced, {"team": TEAM, "polygon": TRIANGLE, "altitude": 1.0, "roll": 0.0}),
    (ho.Hitch.spread, {"team": TEAM, "polygon": TRIANGLE, "limits": None, "separation": None}),
    (ho.DronesStart, {"q": Q, "r": R}),
    (
        ho.Problem,
        {"team": TEAM, "start": START, "mission": [ho.Hold(1.0)], "objects": {}, **RECORDS},
    ),
    (ho.Mission, {"team": TEAM, "start": START, "steps": (), "objects": {}, **RECORDS}),
    (ho.SwarmProblem, {"team": PAIR, "start": LOWER, "goal": UPPER, "keep_out": (), **RECORDS}),
    (ho.SwapSettings, {"radius": 0.15, "tilt": None, "seconds": None, "sense": 0}),
    (ho.ErrorSize, {"bound": 0.0, "deviation": 0.0}),
    (ho.Assignment, {"robots": (0, 1, 2), "flipped": (False,) * 3}),
    (ho.Section, {"outline": TRIANGLE}),
    (ho.Section, {"radius": 0.1}),
    (ho.Rim, {"section": SECTION, "height": 0.2}),
    (ho.SolidObject, {"section": SECTION, "lower": 0.0, "upper": 0.3, "mass": 0.1}),
    (ho.SolidObject, {"section": SECTION, "friction": 0.5, "at": [0, 0, 0], "yaw": 0.0}),
    (ho.SolidObject, {"section": SECTION, "rim": None, "fixed": False}),
    (CRATE.enclose, {"object": "crate", "duration": None}),
    (ENCLOSED.grasp, {"object": "crate", "by": "rest", "tension": None, "duration": None}),
    (HELD.lift, {"by": 0.5, "duration": None}),
    (HELD.lift(0.1).carry, {"object": "crate", "to": [0.0, 0.0, 1.0], "yaw": 0.0}),
    (HELD.lift(0.1).set_down, {"object": "crate", "duration": None}),
    (CRATE.transport_object, {"object": "crate", "to": [0, 0, 1], "by": None, "lift": 0.3}),
    (CRATE.transport_object, {"object": "crate", "to": [0, 0, 1], "tension": None, "yaw": 0.0}),
    (CRATE.then, {"step": ho.Hold(1.0)}),
    (ho.Feedback, {"plan": PLAN, "rate": 0.1, "reserve": 0.01, "delay": 0.05, "stiffness": None}),
    (FEEDBACK.step, {"time": 0.0, "seconds": 0.01, "vertices": None, "drones": None}),
    (
        FEEDBACK.step,
        {"time": 0.0, "seconds": 0.01, "vertices": VERTICES, "measured": None},
    ),
    (ho.Replanner, {"team": TEAM, "start": START, **REST}),
    (ho.Player, {"plan": PLAN, "time": 0.0, "rate": 1.0}),
    (PLAYER.step, {"seconds": 0.01}),
    (PLAYER.rate, {"rate": 1.0}),
    (PLAYER.seek, {"time": 0.5}),
    (ho.run_sweep, {"study": NOWHERE, "directory": NOWHERE, "workers": 1, "scheduler": ""}),
    (ho.load_sweep, {"directory": NOWHERE}),
    (ho.read_problem, {"path": NOWHERE}),
    (ho.load_problem, {"path": NOWHERE}),
    (ho.load_swarm, {"path": NOWHERE}),
    (ho.PiecewisePolynomial, {"breaks": [0.0, 1.0], "coefficients": [[0.0, 1.0]]}),
]
ARGUMENTS = [(function, values, name) for function, values in GOOD for name in values]

NEVER = [object(), 1j, len]
"""What no argument may be."""

SYNONYMS = {
    "q_legs": "legs",
    "breaks": "coefficients",
    "coefficients": "breaks",
}
"""Arguments whose messages name another key."""


class PlannedError(Exception):
    """All arguments were accepted."""


@pytest.fixture(autouse=True)
def _no_planning(monkeypatch: pytest.MonkeyPatch) -> None:
    def stop(*_: object, **__: object) -> None:
        raise PlannedError

    monkeypatch.setattr(api, "solve_problem", stop)


def label(case: tuple[Callable[..., object], dict[str, Any], str]) -> str:
    return f"{case[0].__qualname__}-{case[2]}"


@pytest.mark.parametrize("case", ARGUMENTS, ids=label)
def test_what_no_argument_may_be_is_refused_by_its_name(
    case: tuple[Callable[..., object], dict[str, Any], str],
) -> None:
    function, values, name = case
    for wrong in NEVER:
        with pytest.raises(ho.InputError) as caught:
            function(**{**values, name: wrong})
        assert name in caught.value.key or SYNONYMS.get(name, "-") in caught.value.key


@pytest.mark.parametrize("name", ["robots", "quadrotor", "limits", "separation"])
def test_what_no_argument_of_fit_may_be_is_refused_by_its_name(name: str) -> None:
    for wrong in NEVER:
        with pytest.raises(ho.InputError) as caught:
            ho.fit(-1.0, **{"robots": 3, name: wrong})  # type: ignore[arg-type]
        assert caught.value.key == name


def test_what_no_file_may_be_is_refused_by_its_name(tmp_path: Path) -> None:
    for wrong in (*NEVER, np.array(1.0)):
        calls: list[tuple[Callable[[Any], object], str]] = [
            (PLAN.report, "directory"),
            (lambda x: PLAN.save(tmp_path / "out", report=x), "report"),
            (PLAN.view, "save"),
            (lambda x: PLAN.view(ghost=x, browser=False), "ghost"),
            (lambda x: PLAN.abort(0.0, x), "how"),
            (lambda x: ho.certify(PLAN.motion, reports=x), "reports"),
            (lambda x: ho.certify(PLAN.motion, reports=[x]), "reports[0]"),
        ]
        for call, name in calls:
            with pytest.raises(ho.InputError) as caught:
                call(wrong)
            assert caught.value.key == name


def test_polygons_are_accepted_wherever_points_are(tmp_path: Path) -> None:
    polygon = ho.ConvexPolygon(TRIANGLE)
    assert ho.Hitch.balanced(TEAM, polygon).polygon is polygon
    assert ho.Prism(polygon, 0.0, 1.0).polygon is polygon
    assert ho.ConvexPolygon(polygon).vertices == pytest.approx(polygon.vertices)
    assert ho.Mission(TEAM, START).morph(polygon).steps[0].polygon is polygon  # type: ignore[attr-defined]
    with pytest.raises(ho.FileError):
        ho.load(tmp_path)
