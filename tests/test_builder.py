"""Missions of steps, what plans do in Python, and how records are written there."""

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
from hitchopt.errors import MAX_REPR, OneLine, UnsupportedError, broken_limit, short
from hitchopt.hitch.catenary import hanging_cable
from hitchopt.slices import by_module
from hitchopt.steps import STEP_KINDS, Step
from hitchopt.values.fields import keys_of

ROOMS = ho.ROOM_NAMES | by_module("room_names")  # Names by their modules

TRIANGLE = [[0.3, -0.8], [-0.1, 0.7], [0.7, 0.7]]
OTHER = [[0.35, -0.7], [-0.15, 0.7], [0.7, 0.75]]
ARC = [[-1.2, 0.1], [-0.4, 0.9], [0.4, 0.9], [1.2, 0.1]]
TEAM = ho.Team(3, 2.4)
START = ho.Hitch(TEAM, TRIANGLE, 1.0, [0.3, 0.8, 0.25])
HELD = ho.Problem(TEAM, START, [ho.Hold(1.0)])
Q, R = ([[x, y, 0.0] for y in (-1.2, 0.0, 1.2)] for x in (-0.6, 0.6))


@pytest.fixture(scope="module")
def plan() -> ho.Plan:
    start = ho.Hitch.spread(ho.Team(3, [2.4, 2.5, 2.6]), TRIANGLE, altitude=1.2)
    return ho.solve(start, [ho.Morph(OTHER), ho.Hold(0.5)], title="Two <steps>")


REQUIRED = ["limits", "separation", "arena", "limit"]


@pytest.mark.parametrize(
    ("function", "kind", "first", "last"),
    [(ho.morph, ho.Morph, ["start"], ["cost", "like"]), (ho.form, ho.Form, ["team", "q", "r"], [])],
)
def test_shortcuts_have_the_arguments_and_words_of_their_records(
    function: Any, kind: type[Step], first: list[str], last: list[str]
) -> None:
    keys = {name: key for name, key in keys_of(kind).items() if name != "blend"}
    parameters = inspect.signature(function).parameters
    assert [*parameters] == [*first, *keys, *REQUIRED, *last]
    words = " ".join(inspect.cleandoc(function.__doc__).split())
    for name, key in keys.items():
        assert parameters[name].default == (None if name == "swap" else key.default)
        meaning = key.described(key.kind).replace("null:", "None:")
        assert f"{name}: {meaning[0].lower()}{meaning[1:]}." in words


@pytest.mark.parametrize("kind", [*STEP_KINDS.values(), ho.Fly], ids=lambda kind: kind.name)
def test_help_of_a_step_has_its_keys(kind: type[Step]) -> None:
    words = " ".join(inspect.getdoc(kind).split())  # type: ignore[union-attr]
    assert [*inspect.signature(kind).parameters][: len(keys_of(kind))] == [*keys_of(kind)]
    for name, key in keys_of(kind).items():
        meaning = key.described(key.kind).replace("null:", "None:")
        assert f"{name}: {meaning[0].lower()}{meaning[1:]}." in words


def assert_same_motion(plan: ho.Plan, other: ho.Plan) -> None:
    drones, others = plan.motion.drones, other.motion.drones
    np.testing.assert_array_equal(drones.coefficients, others.coefficients)


def test_a_mission_of_steps_is_the_problem_of_the_same_steps() -> None:
    steps = [ho.Morph(OTHER, blend=True), ho.MoveVertex(0, by=[0.0, 0.05]), ho.Hold(1.0)]
    limits = ho.Limits(speed=0.8)
    plan = ho.solve(START, steps, limits=limits, title="Three steps")
    whole = ho.solve(ho.Problem(TEAM, START, steps, limits=limits, title="Three steps"))
    assert plan.title == whole.title == "Three steps"
    assert [phase.step for phase in plan.phases] == [0, 1, 2]
    assert_same_motion(plan, whole)
    assert_same_motion(ho.solve(START, ho.Morph(OTHER)), ho.morph(START, OTHER))


def test_starts_of_drones_and_of_several_teams_are_planned() -> None:
    formed = ho.solve(ho.DronesStart(Q, R), [ho.Form(TRIANGLE, 1.2), ho.Hold(0.5)], team=TEAM)
    tied = ho.form(TEAM, Q, R, TRIANGLE, 1.2)
    assert formed.duration == pytest.approx(tied.duration + 0.5)
    swarm, goal = ho.Swarm(2), [[0.0, 0.0, 1.5], [1.0, 0.0, 1.5]]
    flown = ho.solve([[0.0, 0.0, 1.0], [1.0, 0.0, 1.0]], ho.Fly(goal), team=swarm)
    assert flown.at(flown.duration).positions == pytest.approx(np.array(goal))
    far = ho.Hitch(ho.Team(3, 2.4), np.array(TRIANGLE) + [6.0, 0.0], 1.0, [0.3, 0.8, 0.25])
    items = [{"a": ho.Hold(0.5), "b": [ho.Hold(0.2), ho.Transport([6.5, 0.2, 1.2])]}]
    plans = [
        ho.solve({"a": START, "b": far}, items),
        ho.solve({"a": START, "b": far}, items[0], team={"a": TEAM, "b": far.team}),
    ]
    assert [each.name for each in plans[0].flight.teams] == ["a", "b"]
    assert plans[0].duration == plans[1].duration
    mixed = {"a": START, "b": np.array(goal) + [5.0, 0.0, 0.0]}
    beside = {"a": ho.Hold(0.5), "b": ho.Fly(np.array(goal) + [5.0, 0.5, 0.0])}
    plan = ho.solve(mixed, beside, team={"a": TEAM, "b": swarm})
    assert plan.certificate.certified


@pytest.mark.parametrize(
    ("call", "key"),
    [
        (lambda: ho.solve(START), "mission"),
        (lambda: ho.solve(START, []), "mission"),
        (lambda: ho.solve(START, print), "mission"),  # type: ignore[arg-type]
        (lambda: ho.solve(START, ["hold"]), "mission[0]"),  # type: ignore[list-item]
        (lambda: ho.solve(ho.DronesStart(Q, R), ho.Form(TRIANGLE)), "team"),
        (lambda: ho.solve([[0, 0, 1], [1, 0, 1]], ho.Fly([[0, 0, 1], [1, 0, 1]])), "team"),
        (lambda: ho.solve({"a": START, "b": ho.DronesStart(Q, R)}, {"a": ho.Hold(1.0)}), "team"),
        (lambda: ho.solve(HELD, ho.Hold(1.0)), "mission"),
        (lambda: ho.solve(HELD, limits=ho.Limits(speed=0.5)), "limits"),
        (lambda: ho.solve(START, ho.Hold(1.0), team=ho.Team(3, 2.4)), "start"),
        (lambda: ho.solve(START, ho.Form(TRIANGLE)), "mission[0].form"),
        (lambda: ho.solve(START, [ho.Hold(1.0), ho.Morph(ARC)]), "mission[1].morph.polygon"),
        (lambda: ho.solve(START, [ho.Release(), ho.Release()]), "mission[1].release"),
        (lambda: ho.solve(START, ho.Enclose("tray")), "mission[0].enclose.object"),
        (lambda: ho.solve(START, ho.Morph(OTHER, blend=True)), "mission[0].morph.blend"),
    ],
)
def test_what_does_not_fit_is_refused_by_its_key(call: Any, key: str) -> None:
    with pytest.raises(ho.InputError) as caught:
        call()
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
    steps = [ho.Adjust(legs), ho.Transport([0.2, 0.3, 1.5], 0.4)]
    plan = ho.solve(start, steps, separation=loose)
    end, last = plan.end, plan.at(plan.duration)
    assert end.drones == pytest.approx(last.positions, abs=1e-9)
    assert end.vertices == pytest.approx(last.vertices, abs=1e-9)
    assert end.cable_forces == pytest.approx(last.cable_forces, abs=1e-9)
    onward = ho.solve(end, ho.Hold(1.0), separation=loose)
    assert onward.at(0.0).positions == pytest.approx(last.positions, abs=1e-9)


def test_a_saved_plan_ends_in_the_same_hitch_and_one_with_free_cables_in_none(
    plan: ho.Plan, tmp_path: Path
) -> None:
    loaded = ho.load(plan.save(tmp_path / "out", rate=5.0))
    assert loaded.end.q_legs == pytest.approx(plan.end.q_legs, abs=1e-12)
    q, r = (np.array(places) + [0.0, 0.0, 1.0] for places in (Q, R))
    landed = ho.solve(ho.DronesStart(q, r), ho.Land(), team=TEAM)
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
    table = pd.read_csv(plan.save(tmp_path / "out", rate=7.0) / "setpoints.csv")
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
    with pytest.raises(ho.InputError, match=r"write perturbations=\{'wind': 0\.1\}"):
        ho.simulate(plan, wind=0.1)


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
        for room, names in ROOMS.items()
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
    plan = ho.solve(start, ho.Hold(2.0))
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


def test_every_public_function_suggests_arguments() -> None:
    """So do records that users write; records of results do not."""
    public: list[Any] = [getattr(ho, name) for name in ho.__all__]
    functions: list[Any] = [each for each in public if inspect.isfunction(each)]
    for each in [*functions, ho.Plan, ho.Rule, ho.Swarm, ho.Rim]:
        *_, last = inspect.signature(each).parameters.values()
        if last.kind is not inspect.Parameter.VAR_KEYWORD:  # those check their options
            with pytest.raises(TypeError, match=rf"^{each.__name__}\(\) has no argument 'x9'; "):
                each(x9=1)


def test_signatures_have_plain_types() -> None:
    kinds: list[Any] = [*STEP_KINDS.values(), ho.Fly, ho.Team, ho.Limits, ho.Problem, ho.Quadrotor]
    assert not any("Annotated" in str(inspect.signature(kind)) for kind in kinds)
    signature = str(inspect.signature(ho.Morph))
    for words in ("polygon: 'ArrayLike | Outline'", "duration: 'float | None' = None"):
        assert words in signature


@pytest.mark.parametrize(("mission", "example"), [("hold", "Hold(…)"), ("held", "Hold(1.0)")])
def test_a_word_is_no_mission(mission: Any, example: str) -> None:
    for call in (lambda: ho.solve(START, mission), lambda: ho.Problem(TEAM, START, mission)):
        with pytest.raises(ho.InputError) as refused:
            call()
        words = f"must be a step; write it as a record, such as hitchopt.{example}"
        assert str(refused.value) == f"mission = {mission!r}: {words}"


def test_a_printed_certificate_is_its_table(plan: ho.Plan) -> None:
    title, heads, _, *rows = str(plan.certificate).splitlines()
    assert (title, heads.split()[:3]) == ("Certificate", ["check", "worst", "limit"])
    assert rows[0] == "distances:"
    assert len(repr(plan.certificate)) <= MAX_REPR


@pytest.mark.parametrize(
    ("call", "given", "words"),
    [
        (ho.Limits, "max_speed", "Limits() has no argument 'max_speed'; did you mean speed?"),
        (
            ho.Team,
            "mass",
            "Team() has no argument 'mass'; use one of robots, cable_length, topology, "
            "cable_density, cable_friction, tension, quadrotor, load, errors, release, assignment",
        ),
        (ho.Team, "tensoin", "Team() has no argument 'tensoin'; did you mean tension?"),
        (
            ho.Hitch.spread,
            "height",
            "Hitch.spread() has no argument 'height'; did you mean altitude?",
        ),
        (ho.Section, "diameter", "Section() has no argument 'diameter'; did you mean radius?"),
        (ho.Hitch, "height", "Hitch() has no argument 'height'; did you mean altitude?"),
        (ho.morph, "polygn", "morph() has no argument 'polygn'; did you mean polygon?"),
        (ho.Hold, "time", "Hold() has no argument 'time'; did you mean seconds?"),
        (ho.Morph, "poligon", "Morph() has no argument 'poligon'; did you mean polygon?"),
        (ho.Morph, "points", "Morph() has no argument 'points'; did you mean polygon?"),
        (ho.solve, "limts", "solve() has no argument 'limts'; did you mean limits?"),
    ],
)
def test_unknown_arguments_are_suggested(call: Any, given: str, words: str) -> None:
    with pytest.raises(TypeError) as refused:
        call(None, **{given: 1})
    assert str(refused.value) == words
