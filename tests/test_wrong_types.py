"""Arguments of wrong types, refused by name in every public function, and of unusual units."""

from __future__ import annotations

import math
import sys
import warnings
from collections.abc import Callable, Iterator
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pandas
import pytest
from click.testing import CliRunner

import hitchopt as ho
from hitchopt.carrying.outline_fit import _section_of
from hitchopt.cli import main
from hitchopt.forming.steps import Form
from hitchopt.forming.swap_settings import SwapSettings
from hitchopt.hitch.catenary import hanging_cable
from hitchopt.hitch.team import Assignment
from hitchopt.lab.flights.recordings import Track
from hitchopt.lab.statics.tolerance import ErrorSize
from hitchopt.mission.loading import parse_problem
from hitchopt.mission.others import Other
from hitchopt.steps import STEP_KINDS, Step
from hitchopt.steps.moving import Hold, Morph, Transport
from hitchopt.trajectory import PiecewisePolynomial
from hitchopt.trajectory.enclosed import Enclosed
from hitchopt.values.fields import EMPTY, keys_of
from tests.helpers.plans import PROBLEMS
from tests.helpers.refusals import Refusal, assert_refused

TRIANGLE = [[0.0, -1.0], [-0.4, 0.5], [0.4, 0.5]]
Q = [[-0.6, -1.2, 0.0], [-0.6, 0.0, 0.0], [-0.6, 1.2, 0.0]]
R = [[0.6, -1.2, 0.0], [0.6, 0.0, 0.0], [0.6, 1.2, 0.0]]
TEAM = ho.Team(3, 2.4)
START = ho.Hitch(TEAM, TRIANGLE, 1.0, [0.3, 0.8, 0.25])
PLAN = ho.solve(START, ho.Hold(1.0))
SMALLER = [[0.0, -0.9], [-0.4, 0.5], [0.4, 0.5]]
PATH = ho.Path.of(TEAM, [START.vertices, 1.01 * START.vertices, START.vertices])
PAIR = ho.Swarm(2)
LOWER, UPPER = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]], [[0.0, 0.0, 1.0], [1.0, 0.0, 1.0]]
SECTION = ho.Section(radius=0.1)
CRATE = {"crate": ho.SolidObject(SECTION, at=[1.5, 0.0, 0.0])}
PLAYER = ho.Player(PLAN)
REST: dict[str, Any] = {"limits": None, "separation": None, "arena": None}
RECORDS: dict[str, Any] = {
    **REST,
    "limits": ho.Limits(),
    "separation": ho.Separation(),
    "title": "",
}


def arguments(kind: type[Step]) -> dict[str, Any]:
    """What a step may be given: examples of a file, or defaults."""
    given: dict[str, Any] = {
        name: key.default if key.default is not EMPTY else key.example
        for name, key in keys_of(kind).items()
    }
    moves = given.keys() >= {"to", "by"} and given["to"] is None
    return given | ({"by": [0.0, 0.1]} if moves else {})


def steps() -> Iterator[tuple[Callable[..., object], dict[str, Any]]]:
    """Records of all kinds of steps, and the shortcuts for two of them."""
    for kind in STEP_KINDS.values():
        yield kind, arguments(kind)
    for shortcut, kind, start in (
        (ho.morph, Morph, {"start": START}),
        (ho.form, Form, {"team": TEAM, "q": Q, "r": R}),
    ):
        alone = {name: value for name, value in arguments(kind).items() if name != "blend"}
        yield shortcut, {**start, **alone, **REST, "limit": None}


def height(spans: ho.DroneSpans) -> Enclosed:
    """Return the height of drones [m], for a rule."""
    return spans.position[2]


AFTER, NOWHERE = -1.0, "there is no such file"  # Refused, so that nothing is computed
# fmt: off
GOOD: list[tuple[Callable[..., object], dict[str, Any]]] = [
    *steps(),
    (ho.solve, {"start": ho.Problem(TEAM, START, (Hold(1.0),)), "limit": None, "rules": ()}),
    (ho.solve, {"start": START, "mission": [Hold(1.0)], "team": TEAM, "objects": {}, "others": {},
                "keep_out": (), "title": "", **REST, "limit": None, "cache": None}),
    (ho.Cache, {"size": 1}),
    *((call, {"problem": NOWHERE}) for call in (ho.separate, ho.suggestions, ho.repair)),
    (ho.lint, {"path": NOWHERE}),
    *((call, {"path": NOWHERE}) for call in (ho.load_problem,)),
    (ho.load, {"directory": NOWHERE}),
    *((call, {"plan": PLAN, "t": AFTER}) for call in (ho.equilibrium, ho.tolerance)),
    (ho.certify, {"flight": PLAN.flight}),
    (ho.route, {"start": START, "polygon": TRIANGLE, "legs": "balanced", "optimize": False,
                "tension": None, **REST, "limit": None}),
    (lambda cost: ho.morph(START, SMALLER, cost=cost), {"cost": None}),
    (ho.time, {"path": PATH, "duration": None, **REST}),
    (ho.Path.of, {"team": TEAM, "vertices": [TRIANGLE] * 3, "legs": None, "roll": None,
                  "altitude": 1.0}),
    (PATH.shapes, {"s": [0.0]}), (PATH.drones, {"s": [0.0]}),
    (ho.closest, {"plan": PLAN, "spans": 2}),
    (hanging_cable, {"first": [0, 0, 0], "second": [1, 0, 0], "length": 2.0, "points": 5}),
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
     {"team": TEAM, "start": START, "mission": [Hold(1.0)], "objects": {}, **RECORDS}),
    (ho.Problem,
     {"team": PAIR, "start": LOWER, "mission": [ho.Fly(np.array(UPPER))], "keep_out": (),
      **RECORDS}),
    (SwapSettings, {"radius": 0.15, "tilt": None, "seconds": None, "sense": 0}),
    (ErrorSize, {"bound": 0.0, "deviation": 0.0}),
    (Assignment, {"robots": (0, 1, 2), "flipped": (False,) * 3}),
    (lambda flipped: Assignment((0,), (flipped,)), {"flipped": False}),
    (Assignment.fixed, {"robots": 3}),
    *((kind, {"vertices": TRIANGLE}) for kind in (ho.ConvexArc, ho.ConvexPolygon)),
    (Track, {"t": [0.0, 1.0], "positions": LOWER}),
    (ho.read_flight, {"path": NOWHERE, "unit": None}),
    (lambda recording: ho.evaluate(recording, PLAN), {"recording": NOWHERE}),
    (ho.combine, {"plan": PLAN, "other": PLAN, "at": 1.0}),
        (Other, {"plan": NOWHERE}),
    (ho.Fly, {"goal": UPPER, "duration": None}),
    (ho.Motion, {each.name: getattr(PLAN.motion, each.name) for each in fields(PLAN.motion)}),
    (lambda phases: replace(PLAN.motion, phases=(phases,)), {"phases": PLAN.phases[0]}),
    (ho.Section, {"outline": TRIANGLE}), (ho.Section, {"radius": 0.1}),
    (ho.Rim, {"section": SECTION, "height": 0.2}),
    (ho.SolidObject, {"section": SECTION, "lower": 0.0, "upper": 0.3, "mass": 0.1}),
    (ho.SolidObject, {"section": SECTION, "friction": 0.5, "at": [0, 0, 0], "yaw": 0.0}),
    (ho.SolidObject, {"section": SECTION, "rim": None, "fixed": False}),
    (ho.Replanner, {"team": TEAM, "start": START, **REST}),
    (ho.Player, {"plan": PLAN, "time": 0.0, "rate": 1.0}),
    (PLAYER.step, {"seconds": 0.01}),
    (PLAYER.rate, {"rate": 1.0}),
    (PLAYER.seek, {"time": 0.5}),
    (PiecewisePolynomial, {"breaks": [0.0, 1.0], "coefficients": [[0.0, 1.0]]}),
    (ho.fit, {"outline": -1.0, "robots": 3, "quadrotor": None, "limits": None, "separation": None}),
    (PLAN.report, {"directory": NOWHERE}), (PLAN.view, {"save": NOWHERE}),
    (PLAN.abort, {"t": AFTER, "how": "hold"}),
    (lambda ghost: PLAN.view(ghost=ghost, browser=False), {"ghost": NOWHERE}),
    (lambda report: PLAN.save("out", report=report), {"report": False}),
    (lambda reports: ho.certify(PLAN.motion, reports=reports), {"reports": "speed"}),
    (lambda rules: ho.certify(PLAN.motion, rules=rules), {"rules": []}),
    (
        lambda name, unit, sense, limit, over: ho.Rule(name, unit, sense, limit, over, height),
        {"name": "high", "unit": "m", "sense": "max", "limit": 2.0, "over": ho.DroneSpans},
    ),
]
# fmt: on
ARGUMENTS = [(function, values, name) for function, values in GOOD for name in values]
NEVER = [object(), 1j, len]  # What no argument may be
SYNONYMS = {
    "q_legs": "legs",
    "breaks": "coefficients",
    "coefficients": "breaks",
    "vertices": "polygon",
}


@pytest.mark.usefixtures("place")
@pytest.mark.parametrize(
    ("function", "values", "name"),
    ARGUMENTS,
    ids=[f"{f.__qualname__}-{x}" for f, _, x in ARGUMENTS],
)
def test_what_no_argument_may_be_is_refused_by_its_name(
    function: Callable[..., object], values: dict[str, Any], name: str
) -> None:
    for wrong in NEVER:
        with pytest.raises(ho.InputError) as caught:
            function(**{**values, name: wrong})
        assert name in caught.value.key or SYNONYMS.get(name, "-") in caught.value.key


class Tensor:
    """An array of another library, as torch, jax and polars have them."""

    def __init__(self, values: Any) -> None:
        self.values = values

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Any:
        return np.array(self.values, dtype, copy=copy is not False)


class Quantity(Tensor):
    """A quantity in feet, as pint, astropy and unyt have them."""

    @property
    def units(self) -> str:
        return "foot"


class Unyt(Tensor):
    """A quantity whose instance states the unit."""

    def __init__(self, values: Any) -> None:
        super().__init__(values)
        self.units = "yard"


class Table(Tensor):
    """An array that states its unit as xarray and pandas do."""

    attrs: ClassVar[dict[str, str]] = {"units": "mm"}


def others(value: Any) -> dict[str, Any]:
    """Return what resembles an array of numbers without being one, by the word of its refusal."""
    numbers = np.array(value, np.float64)
    return {
        "foot": Quantity(numbers),
        "(yard)": Unyt(numbers),
        "(mm)": Table(numbers),
        "masked": np.ma.masked_equal(numbers, numbers.flat[-1]),
        "<U": np.char.mod("%g", numbers),
        "timedelta64": Tensor(1e3 * numbers).__array__("m8[ms]"),
        "datetime64": Tensor(1e3 * numbers).__array__("M8[ms]"),
        "complex128": Tensor(numbers + 0.0j),
        "object": np.full(numbers.shape, object()),
        "is on another device": Unreadable(),
    }


class Unreadable:
    """A tensor that numpy cannot read."""

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Any:
        raise TypeError("it is on another device")


def numeric(value: Any) -> bool:
    """Return whether a value is a number or an array of numbers."""
    if isinstance(value, int | float | list | tuple | np.ndarray) and not isinstance(value, bool):
        try:
            return np.array(value, np.float64).size > 0
        except (TypeError, ValueError):
            pass
    return False


NUMERIC = [
    (function, values, name) for function, values, name in ARGUMENTS if numeric(values[name])
]


@pytest.mark.usefixtures("place")
@pytest.mark.parametrize(
    ("function", "values", "name"), NUMERIC, ids=[f"{f.__qualname__}-{x}" for f, _, x in NUMERIC]
)
def test_what_resembles_numbers_is_refused_by_its_name(
    function: Callable[..., object], values: dict[str, Any], name: str
) -> None:
    for words, wrong in others(values[name]).items():
        with pytest.raises(ho.InputError) as caught:
            function(**{**values, name: wrong})
        assert name in caught.value.key or SYNONYMS.get(name, "-") in caught.value.key
        assert words in str(caught.value)


READ = [
    lambda x: ho.Hitch.spread(TEAM, x).vertices,
    lambda x: ho.ConvexPolygon(x).vertices,
    lambda x: ho.Section(x).outline,
    lambda x: _section_of(x)[0].outline,  # as fit reads it
    lambda x: ho.Path.of(TEAM, [x, x, x]).shapes([0.5]).polygons,
    lambda x: ho.ConvexPolygon(ho.Morph(x).polygon).vertices,
    lambda x: ho.Prism(x, 0.0, 1.0).polygon.vertices,
    lambda x: ho.FollowVertex(0, x, speed=0.2).path,
    lambda x: PiecewisePolynomial(np.arange(4.0), x).at([0.5]),
]


@pytest.mark.parametrize("read", READ)
def test_arrays_of_other_libraries_are_those_of_numpy(read: Callable[[Any], Any]) -> None:
    expected = read(np.array(TRIANGLE))
    table = pandas.DataFrame(TRIANGLE, columns=["x", "y"])
    for given in (
        Tensor(TRIANGLE),
        [Tensor(row) for row in TRIANGLE],
        table,
        table.convert_dtypes(),
    ):
        assert np.array_equal(read(given), expected)


@pytest.mark.parametrize("wrong", ["0.5", True, [True], ["0.5"], pandas.Timedelta("500ms"), {}])
def test_what_numpy_would_convert_is_no_time(wrong: Any) -> None:
    with pytest.raises(ho.InputError) as caught:
        PLAN.at(wrong)
    assert caught.value.key in {"t", "t[0]"}


def test_numbers_of_other_libraries_are_those_of_python() -> None:
    for two in (Tensor(2.0), np.array(2.0), np.float32(2.0), Tensor(2)):
        assert ho.Limits(speed=two).speed == 2.0  # type: ignore[arg-type]
        assert ho.Team(3, two).cable_length.tolist() == [2.0] * 3
        assert PLAN.at(two).positions == pytest.approx(PLAN.at(2.0).positions)
    assert ho.Team(Tensor(3), 2.0).robots == 3  # type: ignore[arg-type]
    assert PLAN.at(range(2)).t.tolist() == [0.0, 1.0]


def test_polygons_are_accepted_wherever_points_are() -> None:
    polygon = ho.ConvexPolygon(TRIANGLE)
    assert ho.Hitch.balanced(TEAM, polygon).polygon is polygon
    assert ho.Prism(polygon, 0.0, 1.0).polygon is polygon
    assert ho.Morph(polygon).polygon is polygon
    assert ho.ConvexPolygon(polygon).vertices == pytest.approx(polygon.vertices)


ORIGIN = np.array([0.0, 0.0, 1.0])
FILE = """
team: {robots: 3, cable_length: 2.4, quadrotor: {mass: MASS}}
limits: {tilt_deg: TILT}
start: {hitch: {polygon: [[0, -1], [-0.4, 0.5], [0.4, 0.5]]}}
mission: [{hold: {seconds: 1}}]
"""

# fmt: off
DISC, WIDE = ho.Section(radius=0.2), ho.Section([[-175, 125], [175, 125], [175, -125]])
UNUSUAL: list[tuple[Callable[[], object], str]] = [
    (lambda: ho.Team(3, 2400), "2400 m; usual values are 0.05 to 30 m; if millimetres"),
    (lambda: ho.Team(3, [2.4, 240, 2.4]), r"cable_length\[1\]: 240 m; .* if centimetres .* 2.4"),
    (lambda: ho.Team(3, 2.4, cable_density=5), "cable_density: 5 kg/m; .* grams per metre"),
    (lambda: ho.Team(3, 2.4, cable_friction=20), "cable_friction: 20 .* per cent were"),
    (lambda: ho.Quadrotor(0.004, 0.06), "mass: 0.004 kg; usual values are 0.005 to 100 kg"),
    (lambda: ho.Limits(speed=800), "speed: 800 m/s; .* if mm/s were meant, 0.8"),
    (lambda: ho.Limits(tilt_deg=0.785), "tilt_deg: 0.785 °; .* if radians were meant, 45"),
    (lambda: ho.Limits(body_rate=200), "body_rate: 200 rad/s; .* degrees per second"),
    (lambda: ho.Arena([-4e3, -4, 0], [4] * 3), r"lower\[0\]: -4000 m; .* millimetres"),
    (lambda: ho.SolidObject(DISC, upper=300), "upper: 300 m; .* millimetres were meant, 0.3"),
    (lambda: ho.SolidObject(DISC, mass=80), "mass: 80 kg; .* grams were meant, 0.08"),
    (lambda: ho.SolidObject(DISC, friction=50), "friction: 50 .* per cent were meant, 0.5"),
    (lambda: ho.SolidObject(ho.Section(radius=120)), r"section.radius: 120 m; .* millimetres"),
    (lambda: ho.SolidObject(WIDE), r"section.outline: 175 m; .* millimetres were meant, 0.175"),
    (lambda: ho.SolidObject(DISC, upper=20, rim=ho.Rim(ho.Section(radius=25), 1)), "rim.section"),
    (lambda: ho.Tube(5, 0.05), "level: 5 m; .* centimetres were meant, 0.05"),
    (lambda: ho.Tube(0.05, 50), "height: 50 m; .* millimetres were meant, 0.05"),
    (lambda: Hold(2e5), "seconds: 200000 s; .* if milliseconds were meant, 200"),
    (lambda: Transport(ORIGIN, 30), "yaw: 30 rad, more than a turn; .* meant, 0.524"),
]
REFUSED: list[Refusal] = [
    (lambda: ho.Quadrotor(34.0), "mass", "if grams were meant, 0.034"),
    (lambda: ho.Quadrotor(0.034, 60.0), "max_thrust", "if grams of force were meant, 0.589"),
    (lambda: ho.Team(3, 2e4), "cable_length", "from 0.001 to 10000 m; if millimetres"),
    (lambda: ho.Limits(tilt=45), "tilt", "below 1.571 rad; if degrees were meant, 0.785"),
    (lambda: ho.Limits(tilt_deg=95), "tilt_deg", "below 90 °"),
    (lambda: ho.Limits(tilt=0.5, tilt_deg=30), "tilt_deg", "omitted if tilt is given"),
    (lambda: Transport(ORIGIN, 90), "yaw", "if degrees were meant, 1.57"),
    (lambda: parse_problem(written("34"), "x.yaml", Path()), "team.quadrotor.mass", "meant, 0.034"),
    (lambda: parse_problem(written("0.1, gains: {kp: 1}")), "team.quadrotor.gains", "= {'kp': [1"),
    (lambda: ho.Team(3, "2.4 m"), "cable_length", "(one per robot); use a plain number in SI"),
    (lambda: ho.solve({}), "start", "convert a dict with problem_from_dict"),
    (lambda: ho.form(TEAM, Q[:2], R, TRIANGLE), "q", "2 points"),
    (
        lambda: ho.solve(START, ho.Enclose("crat"), objects=CRATE),
        "mission[0].enclose.object",
        "did you mean crate?",
    ),
    (lambda: ho.closest(PLAN, 1, "c.txt"), "picture", "a name in .png, .svg or .pdf"),
]
# fmt: on


def written(mass: str = "0.132", tilt: str = "45") -> str:
    return FILE.replace("MASS", mass).replace("TILT", tilt)


@pytest.mark.parametrize(("make", "words"), UNUSUAL)
def test_the_unusual_is_warned_of_at_the_line_that_gave_it(
    make: Callable[[], object], words: str
) -> None:
    with pytest.warns(ho.UnitWarning, match=words) as caught:
        make()
    if sys.version_info >= (3, 12):
        assert {warning.filename for warning in caught} == {__file__}


@pytest.mark.parametrize(
    "make",
    [lambda: ho.Limits(speed=800), lambda: ho.Limits(tilt_deg=0.785), lambda: Hold(2e5)],
)
def test_a_record_is_warned_of_at_the_line_that_makes_it(make: Callable[[], object]) -> None:
    """Also with Python 3.11, which skips a number of frames, not the files of a package."""
    with pytest.warns(ho.UnitWarning) as caught:
        make()
    assert [warning.filename for warning in caught] == [__file__]


@pytest.mark.parametrize("refusal", REFUSED)
def test_what_nothing_has_that_flies_is_refused(refusal: Refusal) -> None:
    assert_refused(*refusal)


def test_copies_warn_where_a_user_makes_them_only() -> None:
    """Planners copy records with values that they compute; warnings are errors here."""
    with pytest.warns(ho.UnitWarning, match="^speed: 200"):
        limits = ho.Limits(speed=200)
    with pytest.warns(ho.UnitWarning, match="^speed: 200"):
        replace(limits, jerk=10.0)
    assert ho.form(TEAM, Q, R, TRIANGLE, limits=limits).certificate.certified


def test_a_polygon_in_millimetres_says_so() -> None:
    with pytest.raises(ho.InfeasibleError, match=r"if millimetres were meant, 1\.55 m"):
        ho.Hitch.balanced(ho.Team(3, 2.4), [[1e3 * x for x in point] for point in TRIANGLE])
    with pytest.raises(ho.InputError, match="if these are millimetres, use metres"):
        ho.Hitch.balanced(ho.Team(3, 2.4), [[2e3 * x for x in point] for point in TRIANGLE])


def test_cables_that_are_too_heavy_are_not_to_be_longer() -> None:
    with pytest.raises(ho.InfeasibleError, match=r"raise team\.tension or lower team\.cable_den"):
        ho.Hitch.balanced(ho.Team(3, 2.4, cable_density=0.9), TRIANGLE)


def test_angles_in_degrees_are_those_in_radians() -> None:
    limits = ho.Limits(tilt_deg=30, body_rate_deg=200)
    assert limits == ho.Limits(tilt=math.radians(30), body_rate=math.radians(200))
    assert ho.Limits(tilt_deg=45) == ho.Limits()
    assert replace(limits, jerk=9.0) == ho.Limits(jerk=9.0, tilt_deg=30, body_rate_deg=200)
    assert replace(limits, tilt=0.4).tilt == 0.4


def test_the_command_line_warns_on_stderr_once(tmp_path: Path) -> None:
    path = tmp_path / "problem.yaml"
    path.write_text(written(tilt="0.785"))
    done = CliRunner().invoke(
        main, ["solve", str(path), "-o", str(tmp_path / "out"), "--no-repair"]
    )
    assert done.exit_code == 3
    warned = [line for line in done.stderr.splitlines() if line.startswith("warning: ")]
    words = "usual values are 1.1 to 90 °; if radians were meant, 45"
    assert warned == [f"warning: limits.tilt_deg: 0.785 °; {words}"]


def test_the_numbers_of_a_plan_are_warned_of_once_under_the_problem_s_keys(tmp_path: Path) -> None:
    text = (PROBLEMS / "triangle.yaml").read_text()
    unusual = text.replace("team:", "team:\n  errors: {cable_length: 0.6}", 1)
    with pytest.warns(ho.UnitWarning) as caught:
        plan = ho.solve(parse_problem(unusual))
    assert [str(each.message).split(":")[0] for each in caught] == ["team.errors.cable_length"]
    plan.save(tmp_path)
    with warnings.catch_warnings(record=True) as again:
        warnings.simplefilter("always")
        ho.load(tmp_path)
    assert not again
