"""Arguments of wrong types: an InputError that names the argument, in every public function."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hitchopt as ho
from hitchopt import api
from hitchopt.steps import STEPS, Step
from hitchopt.steps.step import keys_of

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
    **REST,
    "limits": ho.Limits(),
    "separation": ho.Separation(),
    "title": "",
}
BEGUN: dict[str, ho.Mission] = {
    **dict.fromkeys(("form", "land"), ho.Mission(TEAM, ho.DronesStart(Q, R))),  # type: ignore[arg-type]
    **{"enclose": CRATE, "transport_object": CRATE, "grasp": ENCLOSED, "lift": HELD},
    **{"carry": HELD.lift(0.1), "set_down": HELD.lift(0.1), "loosen": HELD},
    "leave": ENCLOSED,
}
"""Missions in which steps are possible, where not at the start of one with a hitch."""


def arguments(kind: type[Step]) -> dict[str, Any]:
    """What a step may be given: examples of a file, or defaults."""
    given: dict[str, Any] = {
        name: key.examples[0] if key.examples else default
        for name, (key, default) in keys_of(kind).items()
        if not isinstance(default, type)
    }
    given |= {"object": "crate"} if "object" in given else {}
    return given | ({"by": [0.0, 0.1]} if "to" in given and given["to"] is None else {})


def steps() -> Iterator[tuple[Callable[..., object], dict[str, Any]]]:
    """Methods and functions of all kinds of steps, but for what only a team with friction does."""
    for kind in STEPS:
        given = arguments(kind)
        if kind is ho.Settle:
            continue
        if kind in api.ALONE:
            free = kind.needs_hitch is False
            start = {"team": TEAM, "q": Q, "r": R} if free else {"start": START}
            alone = {name: value for name, value in given.items() if name != "blend"}
            yield getattr(ho, kind.name), {**start, **alone, **REST}
        yield getattr(BEGUN.get(kind.name, ho.Mission(TEAM, START)), kind.name), given


AFTER = -1.0
"""A time that is refused, so that nothing is computed."""

NOWHERE = "there is no such file"
# fmt: off
GOOD: list[tuple[Callable[..., object], dict[str, Any]]] = [
    *steps(),
    (ho.solve, {"problem": ho.Problem(TEAM, START, (ho.Hold(1.0),)), "limit": None}),
    *((call, {"problem": NOWHERE}) for call in (ho.separate, ho.suggestions, ho.repair)),
    (ho.lint, {"path": NOWHERE}),
    *((call, {"path": NOWHERE}) for call in (ho.read_problem, ho.load_problem, ho.load_swarm)),
    *((call, {"directory": NOWHERE}) for call in (ho.load, ho.load_sweep)),
    *((call, {"plan": PLAN, "t": AFTER}) for call in (ho.settle, ho.tolerance)),
    (ho.certify, {"motion": PLAN.motion}),
    (ho.closest, {"plan": PLAN, "spans": 2}),
    (ho.hanging_cable, {"first": [0, 0, 0], "second": [1, 0, 0], "length": 2.0, "points": 5}),
    (ho.regular_polygon, {"n": 3, "edge": 1.0, "angle": 0.0}),
    (ho.calibrate, {"plan": NOWHERE, "recording": NOWHERE}),
    (ho.export, {"plan": PLAN, "format": "none", "folder": NOWHERE}),
    (ho.simulate, {"plan": NOWHERE, "preset": "fast", "perturbed": False, "perturbations": None}),
    (PLAN.at, {"t": 0.5}),
    (PLAN.to_dataframe, {"rate": 2.0}),
    (ho.Team, {"robots": 3, "cable_length": 2.4, "topology": "closed", "quadrotor": None,
               "tension": 0.4, "load": 0.0}),
    (ho.Swarm, {"drones": 2, "quadrotor": None}),
    (ho.Quadrotor, {"mass": 0.1, "max_thrust": 2.6, "stiffness": None, "integral": False}),
    (ho.Limits, {"speed": 1.0, "tilt": 0.7, "leg": 0.15, "duration": None, "body_rate": None}),
    (ho.Limits, {"tilt_deg": 40.0, "body_rate_deg": None}),
    (ho.Separation, {"radius": 0.1, "height": 0.3, "cable": 0.1, "crossing": 0.05}),
    (ho.Arena, {"lower": [0, 0, 0], "upper": [1, 1, 1]}),
    (ho.Prism, {"polygon": TRIANGLE, "lower": 0.0, "upper": 9.0}),
    (ho.Hitch, {"team": TEAM, "polygon": TRIANGLE, "altitude": 1.0, "q_legs": [0.3] * 3}),
    (ho.Hitch.balanced, {"team": TEAM, "polygon": TRIANGLE, "altitude": 1.0, "roll": 0.0}),
    (ho.Hitch.spread, {"team": TEAM, "polygon": TRIANGLE, "limits": None, "separation": None}),
    (ho.DronesStart, {"q": Q, "r": R}),
    (ho.Problem,
     {"team": TEAM, "start": START, "mission": [ho.Hold(1.0)], "objects": {}, **RECORDS}),
    (ho.Mission, {"team": TEAM, "start": START, "mission": (), "objects": {}, **RECORDS}),
    (ho.SwarmProblem, {"team": PAIR, "start": LOWER, "goal": UPPER, "keep_out": (), **RECORDS}),
    (ho.SwapSettings, {"radius": 0.15, "tilt": None, "seconds": None, "sense": 0}),
    (ho.ErrorSize, {"bound": 0.0, "deviation": 0.0}),
    (ho.Assignment, {"robots": (0, 1, 2), "flipped": (False,) * 3}),
    (ho.Section, {"outline": TRIANGLE}), (ho.Section, {"radius": 0.1}),
    (ho.Rim, {"section": SECTION, "height": 0.2}),
    (ho.SolidObject, {"section": SECTION, "lower": 0.0, "upper": 0.3, "mass": 0.1}),
    (ho.SolidObject, {"section": SECTION, "friction": 0.5, "at": [0, 0, 0], "yaw": 0.0}),
    (ho.SolidObject, {"section": SECTION, "rim": None, "fixed": False}),
    (CRATE.then, {"step": ho.Hold(1.0)}),
    (ho.Feedback, {"plan": PLAN, "rate": 0.1, "reserve": 0.01, "delay": 0.05, "stiffness": None}),
    (FEEDBACK.step, {"time": 0.0, "seconds": 0.01, "vertices": None, "drones": None}),
    (FEEDBACK.step, {"time": 0.0, "seconds": 0.01, "vertices": VERTICES, "measured": None}),
    (ho.Replanner, {"team": TEAM, "start": START, **REST}),
    (ho.Player, {"plan": PLAN, "time": 0.0, "rate": 1.0}),
    (PLAYER.step, {"seconds": 0.01}),
    (PLAYER.rate, {"rate": 1.0}),
    (PLAYER.seek, {"time": 0.5}),
    (ho.run_sweep, {"study": NOWHERE, "directory": NOWHERE, "workers": 1, "scheduler": ""}),
    (ho.PiecewisePolynomial, {"breaks": [0.0, 1.0], "coefficients": [[0.0, 1.0]]}),
]
# fmt: on
ARGUMENTS = [(function, values, name) for function, values in GOOD for name in values]

NEVER = [object(), 1j, len]
"""What no argument may be."""

SYNONYMS = {"q_legs": "legs", "breaks": "coefficients", "coefficients": "breaks"}
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


def fitted(name: str) -> Callable[[Any], object]:
    return lambda x: ho.fit(-1.0, **{"robots": 3, name: x})


# fmt: off
CALLS: list[tuple[Callable[[Any], object], str]] = [
    *((fitted(name), name) for name in ("robots", "quadrotor", "limits", "separation")),
    (PLAN.report, "directory"), (PLAN.view, "save"),
    (lambda x: PLAN.save(Path("out"), report=x), "report"),
    (lambda x: PLAN.view(ghost=x, browser=False), "ghost"),
    (lambda x: PLAN.abort(0.0, x), "how"),
    (lambda x: ho.certify(PLAN.motion, reports=x), "reports"),
]
# fmt: on


@pytest.mark.usefixtures("place")
def test_what_no_file_and_no_option_may_be_is_refused_by_its_name() -> None:
    for wrong in (*NEVER, np.array(1.0)):
        for call, name in CALLS:
            with pytest.raises(ho.InputError) as caught:
                call(wrong)
            assert caught.value.key == name


def test_polygons_are_accepted_wherever_points_are() -> None:
    polygon = ho.ConvexPolygon(TRIANGLE)
    assert ho.Hitch.balanced(TEAM, polygon).polygon is polygon
    assert ho.Prism(polygon, 0.0, 1.0).polygon is polygon
    assert ho.Mission(TEAM, START).morph(polygon).steps[0].polygon is polygon  # type: ignore[attr-defined]
    assert ho.ConvexPolygon(polygon).vertices == pytest.approx(polygon.vertices)
