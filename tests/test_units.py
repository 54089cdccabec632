"""Values in another unit than the one expected: refused, or warned of, with what was meant."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from refusals import Refusal, assert_refused

import hitchopt as ho
from hitchopt.cli import main
from hitchopt.mission.loading import parse_problem

TRIANGLE = [[0.0, -1.0], [-0.4, 0.5], [0.4, 0.5]]
ORIGIN = np.array([0.0, 0.0, 1.0])
FILE = """
team: {robots: 3, cable_length: 2.4, quadrotor: {mass: MASS}}
limits: {tilt_deg: TILT}
start: {hitch: {polygon: [[0, -1], [-0.4, 0.5], [0.4, 0.5]]}}
mission: [{hold: {seconds: 1}}]
"""

# fmt: off
UNUSUAL: list[tuple[Callable[[], object], str]] = [
    (lambda: ho.Team(3, 2400), "cable_length: 2400 m; usual are 0.05 to 100 m; if millimetres"),
    (lambda: ho.Team(3, [2.4, 240, 2.4]), r"cable_length\[1\]: 240 m; .* meant, 0.24"),
    (lambda: ho.Team(3, 2.4, cable_density=5), "cable_density: 5 kg/m; .* grams per metre"),
    (lambda: ho.Team(3, 2.4, cable_friction=20), "cable_friction: 20 .* per cent were"),
    (lambda: ho.Quadrotor(0.004, 0.06), "mass: 0.004 kg; usual are 0.005 to 100 kg"),
    (lambda: ho.Limits(speed=800), "speed: 800 m/s; .* if mm/s were meant, 0.8"),
    (lambda: ho.Limits(tilt_deg=0.785), "tilt_deg: 0.785 °; .* if radians were meant, 45"),
    (lambda: ho.Limits(body_rate=200), "body_rate: 200 rad/s; .* degrees per second"),
    (lambda: ho.Arena([-4e3, -4, 0], [4] * 3), r"lower\[0\]: -4000 m; .* millimetres"),
    (lambda: ho.Hold(2e5), "seconds: 200000 s; .* if milliseconds were meant, 200"),
    (lambda: ho.Transport(ORIGIN, 30), "yaw: 30 rad, more than a turn; .* meant, 0.524"),
]
REFUSED: list[Refusal] = [
    (lambda: ho.Quadrotor(34.0), "mass", "if grams were meant, 0.034"),
    (lambda: ho.Quadrotor(0.034, 60.0), "max_thrust", "if grams of force were meant, 0.589"),
    (lambda: ho.Team(3, 2e4), "cable_length", "from 0.001 to 10000 m; if millimetres"),
    (lambda: ho.Limits(tilt=45), "tilt", "45 degrees are 0.785 rad"),
    (lambda: ho.Limits(tilt_deg=95), "tilt_deg", "below 90°"),
    (lambda: ho.Limits(tilt=0.5, tilt_deg=30), "tilt_deg", "left out where tilt is given"),
    (lambda: ho.Transport(ORIGIN, 90), "yaw", "if degrees were meant, 1.57"),
    (lambda: parse_problem(written("34"), "x.yaml", Path()), "team.quadrotor.mass", "meant, 0.034"),
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
    assert {warning.filename for warning in caught} == {__file__}


@pytest.mark.parametrize("refusal", REFUSED)
def test_what_nothing_has_that_flies_is_refused(refusal: Refusal) -> None:
    assert_refused(*refusal)


def test_copies_warn_where_a_user_makes_them_only() -> None:
    with pytest.warns(ho.UnitWarning, match="^speed: 800"):
        limits = ho.Limits(speed=800)
    start = ho.Hitch(ho.Team(3, 2.4), TRIANGLE, 1.0, [0.3, 0.8, 0.25])
    assert ho.hold(start, 1.0, limits=limits).certificate.certified  # which copies the limits
    with pytest.warns(ho.UnitWarning, match="^speed: 800"):
        replace(limits, jerk=10.0)


def test_a_polygon_in_millimetres_says_so() -> None:
    with pytest.raises(ho.InfeasibleError, match=r"if millimetres were meant, 1\.55 m"):
        ho.Hitch.balanced(ho.Team(3, 2.4), [[1e3 * x for x in point] for point in TRIANGLE])


def test_angles_in_degrees_are_those_in_radians() -> None:
    limits = ho.Limits(tilt_deg=30, body_rate_deg=200)
    assert limits == ho.Limits(tilt=math.radians(30), body_rate=math.radians(200))
    assert limits.tilt_deg == pytest.approx(30)
    assert ho.Limits(tilt_deg=45) == ho.Limits()


def test_the_command_line_warns_on_stderr_once(tmp_path: Path) -> None:
    path = tmp_path / "problem.yaml"
    path.write_text(written(tilt="0.785"))
    done = CliRunner().invoke(main, ["solve", str(path), "-o", str(tmp_path / "out")])
    assert done.exit_code == 3
    warned = [line for line in done.stderr.splitlines() if line.startswith("warning: ")]
    words = "usual are 1.1 to 90 °; if radians were meant, 45"
    assert warned == [f"warning: limits.tilt_deg: 0.785 °; {words}"]
