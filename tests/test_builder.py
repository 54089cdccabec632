"""Missions built step by step, what plans do in Python, and how records are written there."""

from __future__ import annotations

import dataclasses
import inspect
import math
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib import pyplot

import hitchopt as ho
from hitchopt import single_steps
from hitchopt.errors import MAX_REPR, OneLine, UnsupportedError, broken_limit, short
from hitchopt.hitch.catenary import hanging_cable
from hitchopt.steps import STEPS
from hitchopt.steps.moving import Hold
from hitchopt.steps.tying import Release
from hitchopt.values.fields import EMPTY, keys_of

TRIANGLE = [[0.3, -0.8], [-0.1, 0.7], [0.7, 0.7]]
OTHER = [[0.35, -0.7], [-0.15, 0.7], [0.7, 0.75]]
ARC = [[-1.2, 0.1], [-0.4, 0.9], [0.4, 0.9], [1.2, 0.1]]
TEAM = ho.Team(3, 2.4)
START = ho.Hitch(TEAM, TRIANGLE, 1.0, [0.3, 0.8, 0.25])


@pytest.fixture(scope="module")
def plan() -> ho.Plan:
    start = ho.Hitch.spread(ho.Team(3, [2.4, 2.5, 2.6]), TRIANGLE, altitude=1.2)
    return ho.Mission(start.team, start, title="Two <steps>").morph(OTHER).hold(0.5).solve()


REQUIRED = ["limits", "separation", "arena", "limit"]
NO_KEYS = {"morph": ["cost"]}  # Arguments that are functions, which no file can state


@pytest.mark.parametrize("kind", STEPS, ids=lambda kind: kind.name)
def test_methods_and_functions_have_the_arguments_and_words_of_their_records(
    kind: type[Hold],
) -> None:
    keys = keys_of(kind)
    first = ["team", "q", "r"] if kind.needs_hitch is False else ["start"]
    wanted = [(getattr(ho.Mission, kind.name), ["self", *keys])]
    if function := vars(single_steps).get(kind.name):
        own = [name for name in keys if name != "blend"]
        wanted.append((function, [*first, *own, *REQUIRED, *NO_KEYS.get(kind.name, [])]))
    for function, names in wanted:
        parameters = inspect.signature(function).parameters
        defaults = {k: p.default for k, p in parameters.items() if p.default is not p.empty}
        assert [*parameters] == names
        words = " ".join(inspect.cleandoc(function.__doc__).split())
        for name in set(names) & set(keys):
            default = keys[name].default
            assert defaults.get(name, EMPTY) == (None if name == "swap" else default)
            meaning = keys[name].described(keys[name].kind).replace("null:", "None:")
            assert f"{name}: {meaning[0].lower()}{meaning[1:]}." in words


def test_a_mission_is_the_problem_of_the_same_steps_and_objects() -> None:
    empty = ho.Mission(TEAM, START, limits=ho.Limits(speed=0.8))
    mission = empty.morph(OTHER, blend=True).move_vertex(0, by=[0.0, 0.05]).hold(1.0)
    assert empty.steps == ()
    assert [step.name for step in mission.steps] == ["morph", "move_vertex", "hold"]
    assert mission.problem.limits.speed == 0.8
    assert [step.blends for step in mission.problem.mission] == [True, False, False]
    assert mission.then(Release()).steps[-1].name == "release"
    tray = ho.SolidObject(ho.Section(radius=0.1), at=[1.5, 0.0, 0.0])
    around = ho.Mission(TEAM, START, objects={"tray": tray}).enclose("tray").leave("tray")
    assert around.problem.objects == {"tray": tray}


@pytest.mark.parametrize(
    ("add", "key"),
    [
        (lambda m: m.form(TRIANGLE), "mission[0].form"),
        (lambda m: m.hold(1.0).morph(ARC), "mission[1].morph.polygon"),
        (lambda m: m.release().release(), "mission[1].release"),
        (lambda m: m.then("release"), "step"),
        (lambda m: m.enclose("tray"), "mission[0].enclose.object"),
        (lambda m: m.problem, "mission"),
        (lambda m: m.hold(1.0).morph(OTHER, blend=True).problem, "mission[1].morph.blend"),
    ],
)
def test_the_step_that_does_not_fit_is_refused_at_once(add: Any, key: str) -> None:
    with pytest.raises(ho.InputError) as caught:
        add(ho.Mission(TEAM, START))
    assert caught.value.key == key


@pytest.mark.parametrize(
    ("team", "legs"),
    [
        (ho.Team(3, [2.4, 2.5, 2.6]), "balanced"),
        (ho.Team(3, 2.4, cable_density=0.004, load=[0.003, 0.004, 0.01]), "spread"),
        (ho.Team(3, 2.4), {"sharing": "spread", "roll_deg": [3.0, -4.0, 8.0]}),
        (ho.Team(3, 2.4, cable_density=0.003), {"sharing": "spread", "roll_deg": 12.0}),
        (ho.Team(3, 2.4, cable_friction=0.2), "spread"),
        (ho.Team(3, 2.4, topology="open"), "spread"),
    ],
)
def test_the_end_is_the_hitch_that_drones_and_cables_are_in(team: ho.Team, legs: Any) -> None:
    outline = ARC if team.topology == "open" else TRIANGLE
    loose = ho.Separation(radius=0.05, cable=0.02, crossing=0.01)
    start = ho.Hitch.spread(team, outline, 1.3, separation=loose)
    mission = ho.Mission(team, start, separation=loose)
    plan = mission.adjust(legs).transport([0.2, 0.3, 1.5], 0.4).solve()
    end, last = plan.end, plan.at(plan.duration)
    assert end.drones == pytest.approx(last.positions, abs=1e-9)
    assert end.vertices == pytest.approx(last.vertices, abs=1e-9)
    assert end.cable_forces == pytest.approx(last.cable_forces, abs=1e-9)
    onward = ho.hold(end, 1.0, separation=loose)
    assert onward.at(0.0).positions == pytest.approx(last.positions, abs=1e-9)


def test_a_saved_plan_ends_in_the_same_hitch_and_one_with_free_cables_in_none(
    plan: ho.Plan, tmp_path: Path
) -> None:
    loaded = ho.load(plan.save(tmp_path / "out", rate=5.0, picture=False))
    assert loaded.end.q_legs == pytest.approx(plan.end.q_legs, abs=1e-12)
    q, r = (np.array([[x, y, 1.0] for y in (-1.2, 0.0, 1.2)]) for x in (-0.6, 0.6))
    landed = ho.land(TEAM, q, r)
    with pytest.raises(ho.InputError, match="end = 'free cables': must be a hitch"):
        _ = landed.end


def test_a_plan_is_drawn_on_axes(plan: ho.Plan) -> None:
    pyplot.switch_backend("Agg")
    axes = plan.plot()
    assert axes.get_xlabel() == "x [m]"
    assert plan.plot(axes) is axes
    pyplot.close("all")


def test_a_data_frame_holds_the_rows_of_setpoints_csv(
    plan: ho.Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import pandas as pd

    frame = plan.to_dataframe(rate=7.0)
    table = pd.read_csv(plan.save(tmp_path / "out", rate=7.0, picture=False) / "setpoints.csv")
    assert list(frame.columns) == [*table.columns, "phase"]
    assert list(frame["drone"]) == list(table["drone"])
    numbers = [name for name in table.columns if name != "drone"]
    np.testing.assert_allclose(frame[numbers], table[numbers], atol=1e-9)
    assert list(frame["phase"].unique()) == ["morph (0)", "hold (1)"]
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(UnsupportedError, match=r"pip install 'hitchopt\[pandas\]'"):
        plan.to_dataframe()


def test_notebooks_show_cards(plan: ho.Plan) -> None:
    card = plan._repr_html_()
    held = "<b>Two &lt;steps&gt;</b>: 3 robots", 'src="data:image/png;base64,', "<td>morph</td>"
    names = [f"<td>{check.title}</td>" for check in plan.certificate.checks]
    for words in (*held, plan.certificate._repr_html_(), "certified for all t", *names):
        assert words in card
    assert "http" not in card


def test_a_plan_is_flown_and_exported(plan: ho.Plan, tmp_path: Path) -> None:
    (part,) = ho.export(plan, "csv", tmp_path / "csv", rate=10.0)
    assert list(part.files) == ["setpoints_enu.csv"]
    with pytest.raises(ho.InputError, match=r"perturbations\.gusts"):
        ho.simulate(plan, perturbations={"gusts": 1.0})


@pytest.mark.parametrize("second", [[1.1, 0.4, 1.3], [0.1, 0.2, 2.0], [2.0, 0.2, 0.3]])
def test_a_hanging_cable_has_its_length_and_its_ends(second: list[float]) -> None:
    first, length = [0.1, 0.2, 0.3], 2.3
    points = hanging_cable(first, second, length, points=2001)
    parts = np.linalg.norm(np.diff(points, axis=0), axis=-1)
    assert points[[0, -1]] == pytest.approx(np.array([first, second]))
    assert np.max(parts) <= length / 2000 * (1 + 1e-6)
    assert length - 2 * np.max(parts) < np.sum(parts) <= length * (1 + 1e-6)  # one at a sharp bend
    at_once = hanging_cable(np.add([second] * 2, 5.0), np.add(first, 5.0), length, points=2001)
    assert at_once[1, ::-1] - 5.0 == pytest.approx(points, abs=1e-9)
    for wrong, count, told in ((1.3, 5, "the distance of its ends"), (2.3, 10**30, "at most 1000")):
        with pytest.raises(ho.InputError, match=told):
            hanging_cable(first, second, wrong, points=count)


EVEN = [[0.0, -1.0], [-0.4, 0.5], [0.4, 0.5]]
ARRAYS = [np.zeros((4, 3)), np.arange(5000.0), np.zeros(0), np.float64(2.5), object()]
PLAIN = st.none() | st.floats() | st.text(max_size=300) | st.sampled_from(ARRAYS)
VALUES = PLAIN | st.lists(PLAIN, max_size=12) | st.lists(st.lists(PLAIN, max_size=3), max_size=12)


@given(st.lists(VALUES, max_size=8))
@settings(max_examples=15)
def test_every_public_record_is_written_on_one_line_whatever_its_values(values: list[Any]) -> None:
    public = [getattr(ho, name) for name in ho.__all__]
    public += [
        getattr(import_module(f"hitchopt.{room}"), name)
        for room, names in ho.ROOM_NAMES.items()
        for name in names
    ]
    records = [x for x in public if inspect.isclass(x) and not issubclass(x, BaseException)]
    assert records
    assert all(getattr(kind, "__repr__") is OneLine.__repr__ for kind in records)  # noqa: B009
    names = [f"field_{i}" for i in range(len(values))]
    text = repr(dataclasses.make_dataclass("Record", names, bases=(OneLine,))(*values))
    assert len(text) <= MAX_REPR
    assert len(text.splitlines()) == 1
    assert text.startswith("Record(")


def test_records_are_written_in_their_own_words() -> None:
    start = ho.Hitch(TEAM, EVEN, 1.0, [0.3, 0.8, 0.25])
    plan = ho.hold(start, 2.0)
    held = len(plan.certificate.limited)
    polygon = "[[0, -1], [-0.4, 0.5], [0.4, 0.5]]"
    for record, words in (
        (ho.Limits(), "Limits()"),
        (ho.Limits(speed=0.8), "Limits(speed=0.8)"),
        (ho.ConvexPolygon(EVEN), f"ConvexPolygon(vertices={polygon})"),
        (plan, f"Plan(6 drones, 2 s, phases: 1, {held} of {held} limits hold)"),
        (start, "Hitch(3 robots, closed, altitude=1, q_legs=[0.3, 0.8, 0.25], roll=0)"),
    ):
        assert repr(record) == words
    assert (short(np.full(600, 2.4)), short(np.zeros((600, 3)))) == ("2.4", "array(600, 3)")
    assert short([[1.0] * 30] * 20) == "<20 entries>"
    error = ho.InputError("key", "value\n" * 50, "bound", "remedy " * 50)
    assert repr(error).startswith('InputError("key = ')
    states = plan.at([0.0, 1.0])
    parts = (plan.phases[0], ho.closest(plan), plan.certificate, plan.certificate["speed"])
    for part in (error, plan.motion, plan.motion.drones, states, *parts):
        assert len(repr(part)) <= MAX_REPR


@pytest.mark.parametrize(
    ("limit", "words"),
    [
        (("grip", -math.inf, 1.5, "min", "1", ("drum",)), "-inf is below the limit of 1.5 at drum"),
        (("grip", -sys.float_info.max, 1.5, "min", "1", ()), "-inf is below the limit of 1.5"),
        (
            ("speed", 1.0 + 1e-11, 1.0, "max", "m/s", ()),
            "1.00000000001 m/s is above the limit of 1 m/s",
        ),
    ],
)
def test_values_just_beyond_a_limit_differ_from_it_in_words(limit: Any, words: str) -> None:
    """What contradicts itself is infinitely far off."""
    assert broken_limit(*limit) == f"{limit[0]}: {words}"


@pytest.mark.parametrize(
    ("call", "given", "words"),
    [
        (ho.Limits, "max_speed", "Limits() has no argument 'max_speed'; did you mean speed?"),
        (
            ho.Team,
            "mass",
            "Team() has no argument 'mass'; use one of robots, cable_length, topology, "
            "cable_density, cable_friction, tension, quadrotor, load, errors, assignment",
        ),
        (ho.Team, "tensoin", "Team() has no argument 'tensoin'; did you mean tension?"),
        (
            ho.Hitch.spread,
            "height",
            "Hitch.spread() has no argument 'height'; did you mean altitude?",
        ),
        (ho.move_edge, "by", "move_edge() missing 1 required positional argument: 'edge'"),
        (ho.Section, "diameter", "Section() has no argument 'diameter'; did you mean radius?"),
        (ho.Hitch, "height", "Hitch() has no argument 'height'; did you mean altitude?"),
        (ho.hold, "time", "hold() has no argument 'time'; did you mean seconds?"),
        (
            ho.Mission.morph,
            "points",
            "Mission.morph() has no argument 'points'; did you mean polygon?",
        ),
    ],
)
def test_unknown_arguments_are_suggested(call: Any, given: str, words: str) -> None:
    with pytest.raises(TypeError) as refused:
        call(None, **{given: 1})
    assert str(refused.value) == words
