"""The second opinion agrees with the certificate, needs nothing but numpy, and its bounds hold."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.optimize import brentq

import hitchopt as ho
from hitchopt import verify as second
from hitchopt.checks.friction import friction_excess
from hitchopt.cli import main
from hitchopt.motion.plan_file import write_plan
from hitchopt.verify import arithmetic, catenary, driver, shapes
from hitchopt.verify.arithmetic import Curve, Effort, Line
from hitchopt.verify.spans import Spans, prove
from tests.helpers.leaning import leaning
from tests.helpers.plans import planned

QUICK = (
    *("triangle", "open_chain", "friction", "weight_hexagon", "form_square"),
    "swarms/circle_6",
)
GROUPS = ("two_teams", "two_layers", "beside_a_show", "hitch_and_swarm")
SLOW = (
    *("carry_tray", "grip_drum", "tie_carry_untie", "roll_32_gon", "form_triangle", "open_arc"),
    "form_twelve_gon",
)
OWN = {
    *("request", "consistency", "cable_loops", "contact", "penetration", "rim"),
    *("outline_turn", "bend", "wrap"),
}
"""Limits that the certificate counts to others, or to infinity where they are broken."""

PROVEN = "proven: every limit holds at all times"


def saved(name: str, folder: Path) -> ho.Plan:
    plan = planned(name)
    plan.save(folder, rate=10.0)
    return plan


@pytest.mark.parametrize(
    "name", [*QUICK, *GROUPS, *(pytest.param(each, marks=pytest.mark.slow) for each in SLOW)]
)
def test_it_agrees_with_the_certificate(name: str, tmp_path: Path) -> None:
    plan = saved(name, tmp_path)
    rows = [*second.verify(tmp_path)]
    assert {row.verdict for row in rows} == {"proven"}
    found = {row.name: row for row in rows}
    for check in plan.certificate.checks:
        if check.name in {"tracking_radius", "vertex_error", "swing"} or not check.is_evaluated:
            continue
        if check.limit is None:  # only reported
            continue
        row, limit = found.pop(check.name), check.number
        assert row.sense == check.sense
        if check.name != "continuity":  # which jump is the largest is rounding
            assert row.unit == check.unit
        assert row.limit == pytest.approx(limit, rel=1e-12)
        jumps = check.name == "downwash"  # as a body passes the height of a drone
        share = 0.002 if name in GROUPS and not jumps else 0.02
        worst = pytest.approx(check.worst, rel=share, abs=share * (limit or 1e-3))
        assert row.worst == worst
        erring = plan.flight.requirements.limits.tracking and check.name in driver.ERRING
        assert np.isnan(row.with_errors) is not bool(erring)
        if erring:
            sign = 1.0 if check.sense == "min" else -1.0
            assert sign * limit <= sign * row.with_errors <= sign * row.worst  # equal at a floor
    assert found.keys() <= OWN


def test_errors_stand_in_a_column_of_their_own(tmp_path: Path) -> None:
    """Both bodies of a distance err; cables are as long as chords that are longer at both ends."""
    error, polygon = 0.02, [[0, -0.8], [-0.4, 0.5], [0.4, 0.5]]
    start = ho.Hitch.spread(
        ho.Team(robots=3, cable_length=2.4), [[0, -1], [-0.4, 0.5], [0.4, 0.5]], altitude=1.0
    )
    arena = ho.Arena([-4, -4, -9], [4, 4, 9])
    limits = ho.Limits(tracking=error)
    plan = ho.morph(start, polygon, limits=limits, arena=arena)
    plan.save(tmp_path, rate=10.0)
    rows = {row.name: row for row in second.verify(tmp_path)}
    for name, change in (("cable_clearance", 2.0), ("crossing", 2.0), ("legs", 2.0)):
        row, check = rows[name], plan.certificate[name]
        assert row.limit == pytest.approx(check.limit, rel=1e-12)
        assert row.worst == pytest.approx(check.worst, rel=0.02)
        assert row.with_errors == pytest.approx(row.worst - change * error, abs=2e-3)
    assert rows["separation"].worst == pytest.approx(plan.certificate["separation"].worst, rel=0.02)
    assert 1.0 <= rows["separation"].with_errors < rows["separation"].worst
    assert rows["arena"].with_errors == pytest.approx(rows["arena"].worst - error, abs=2e-3)
    others = [row for row in rows.values() if row.name not in driver.ERRING]
    assert np.all(np.isnan([row.with_errors for row in others]))
    assert "with errors" in CliRunner().invoke(main, ["verify", str(tmp_path)]).output


@pytest.mark.parametrize("factor", [0.6, 1.6])
def test_pulls_beyond_friction_exceed_by_as_much_in_both(factor: float, tmp_path: Path) -> None:
    """Both relate excesses, above the range and below it, to the cable's tension."""
    motion = leaning(planned("friction").motion, 0.1)
    pulls = motion.leg_tensions.replaced(factor * motion.leg_tensions.coefficients)
    slid = motion.replaced(leg_tensions=pulls)
    write_plan(tmp_path / "plan.npz", ho.Flight.of(slid))
    (own,), _ = second.read(tmp_path / "plan.npz")
    rows = [row for row in driver.plan_rows(own) if row.name == "equilibrium"]
    of_forces, of_legs = rows
    assert {of_forces.verdict, of_legs.verdict} == {"violated"}
    assert of_legs.worst == pytest.approx(friction_excess(slid).worst, rel=0.01)


@pytest.mark.slow
def test_a_copy_of_the_folder_needs_numpy_alone(tmp_path: Path) -> None:
    saved("triangle", tmp_path)
    shutil.copytree(Path(second.__file__).parent, tmp_path / "second_opinion")
    code = f"""
import runpy, sys
before = {{*sys.modules}}
sys.path.insert(0, {str(tmp_path)!r})
sys.argv = ["second_opinion", {str(tmp_path)!r}]
try:
    runpy.run_module("second_opinion", run_name="__main__")
finally:
    known = {{*sys.stdlib_module_names, "numpy", "second_opinion"}}
    needed = {{name.partition(".")[0] for name in {{*sys.modules}} - before}}
    assert needed <= known, needed - known
"""
    for status, words in ((0, PROVEN), (2, "not a plan")):
        told = subprocess.run(
            [sys.executable, "-I", "-c", code], capture_output=True, text=True, check=False
        )
        assert told.returncode == status, told.stderr
        assert words in told.stdout + told.stderr
        (tmp_path / "plan.npz").write_bytes(b"PK")


def test_the_command_ends_with_3_where_a_limit_is_broken(tmp_path: Path) -> None:
    saved("triangle", tmp_path)
    path, command = tmp_path / "plan.npz", ["verify", str(tmp_path)]
    done = CliRunner().invoke(main, command, env={"COLUMNS": "80"})
    assert done.exit_code == 0
    assert max(map(len, done.output.splitlines())) <= 80
    with np.load(path) as file:
        arrays = dict(file)
    settings = json.loads(str(arrays["settings"]))
    settings["groups"][0]["records"]["requirements"]["limits"]["jerk"] = 10.0
    settings |= {"problem": "", "request": None}  # else the limit is compared with these first
    np.savez(path, **{**arrays, "settings": np.array(json.dumps(settings))})
    run = CliRunner().invoke(main, command)
    assert run.exit_code == 3
    assert re.search(r"^jerk .* violated$", run.output, re.MULTILINE)
    path.write_bytes(b"PK")
    assert CliRunner().invoke(main, command).exit_code == 2


@pytest.mark.slow
def zigzag(arrays: dict[str, Any]) -> None:
    arrays["groups/0/drones"][..., 1::2] += 0.3


def stairs(arrays: dict[str, Any]) -> None:
    arrays["groups/0/drones"] += (
        0.2 * (np.arange(len(arrays["groups/0/drones"])) % 2)[:, None, None, None]
    )


def slack(arrays: dict[str, Any]) -> None:
    arrays["groups/0/tensions"] *= 0.0


@pytest.mark.parametrize(
    ("change", "name"), [(zigzag, "jerk"), (stairs, "continuity"), (slack, "tension")]
)
def test_curves_that_are_no_plan_are_refused_at_once(
    change: Callable[[dict[str, Any]], None], name: str, tmp_path: Path
) -> None:
    """Few samples suffice: other rows are not computed."""
    saved("hexagon", tmp_path)
    (path,) = tmp_path.rglob("plan.npz")
    with np.load(path) as file:
        arrays = {key: file[key].copy() for key in file.files}
    change(arrays)
    np.savez(path, **arrays)
    rows = [*second.verify(path)]
    assert name in {each.name for each in rows}
    assert {each.verdict for each in rows} == {"violated"}
    assert sum(each.samples for each in rows) < 10_000


FORMULAS: dict[str, Callable[[Line, Line], Line]] = {
    "product": lambda x, y: x * y.dot(x) + y * 2.0 - 1.0,
    "square": lambda x, _: x.dot(x),
    "exponential": lambda x, _: (x[0] * x[0] * 0.1).map(np.exp, np.exp),
    "norm": lambda x, _: x.norm(),
    "direction": lambda x, _: x.unit(),
    "inverse": lambda x, _: x.norm().inverse(),
    "angle": arithmetic.angle,
    "turning": lambda x, y: x.cross(y) * x.dot(x).inverse(),
    "clipped": lambda x, _: arithmetic.minimum(arithmetic.maximum(x[0], 2.0), 2.1),
    "joined": lambda x, y: arithmetic.concatenate(x[0] * y[1], y[2], x.norm()) * arithmetic.UP,
    "least": lambda x, y: arithmetic.minimum(x[0], y[1], -x[2]),
}


WIDE = pytest.mark.filterwarnings("ignore::RuntimeWarning")
"""What is not known of a wide span is infinite, or not a number."""


def spans_of(seed: int, width: float, offset: float, degree: int = 5) -> Spans:
    """Return spans of polynomials; cables hang between them."""
    rng = np.random.default_rng(seed)
    plan: Any = SimpleNamespace(h=np.array([0.7, 1.3]), breaks=np.array([0.0, 0.7, 2.0]))
    plan.points, plan.effort = (
        Curve(rng.normal(size=(2, 8, 3, degree + 1)) + offset, plan.h),
        Effort(10**6),
    )
    plan.length = np.full((8, 1), 60.0)
    piece, item = np.repeat([0, 1], 4), np.tile(np.arange(4), 2)[:, None]
    return Spans(plan, piece, item, rng.uniform(width, 1.0 - width, size=8), np.full(8, width))


@WIDE
@pytest.mark.parametrize("width", [0.1, 0.01, 0.001])
@pytest.mark.parametrize("degree", [1, 2, 5])
@pytest.mark.parametrize("formula", FORMULAS)
def test_values_and_slopes_stay_within_their_bounds(
    formula: str, degree: int, width: float
) -> None:
    """Slopes of lines and parabolas deviate by as much as is told, those of others by less."""
    make = FORMULAS[formula]
    for seed in range(3):
        s = spans_of(seed, width, 2.0, degree)
        i = s.item[:, 0]
        found, far = make(s.point(i), s.point(i + 4)), np.zeros(8)
        for share in np.linspace(-1.0, 1.0, 41):
            there = s.subspan(float(share), 1e-9)
            now = make(there.point(i), there.point(i + 4))
            far = np.maximum(far, arithmetic.norm(now.v - found.v))
            assert not np.any(arithmetic.norm(now.g - found.g) > found.q * (1.0 + 1e-9) + 1e-9)
        assert not np.any(far > found.deviation * (1.0 + 1e-9) + 1e-12)
        if width == 0.001:  # and they are of use
            assert np.median(found.deviation / np.maximum(far, 1e-9)) < 1.5


@pytest.mark.parametrize("length", [0.2, 1.05, 4.6])
def test_lowest_points_of_hanging_cables_are_found_exactly(length: float) -> None:
    """Short spans are compared with ``y = a cosh(x / a)``, whose length sets ``a``."""

    def surplus(a: float, width: float, arc: float) -> float:
        return float(2.0 * a * np.sinh(0.5 * width / a) - arc)

    rng = np.random.default_rng(7)
    tried = rng.uniform([0.02, -0.9, -3.0], [0.9, 0.9, 3.0], (12, 3))
    for share, steepness, bottom in tried:
        height = steepness * length  # of the end r over the end q
        width = share * np.sqrt(length**2 - height**2)
        points = np.zeros((1, 2, 3, 6))
        points[0, 0] = np.array([1.3, -0.4, bottom])[:, None]
        points[0, 1] = points[0, 0] + np.array([0.8 * width, -0.6 * width, height])[:, None]
        plan: Any = SimpleNamespace(
            h=np.ones(1),
            breaks=np.arange(2.0),
            length=np.full((1, 1), length),
            effort=Effort(10**6),
        )
        plan.points = Curve(points, plan.h)
        first = np.zeros(1, dtype=int)
        s = Spans(plan, first, first[:, None], np.full(1, 0.5), np.full(1, 1e-3))
        arc = np.sqrt(length**2 - height**2)
        a = brentq(surplus, width / 60.0, 1e3 * width, args=(width, arc))
        middle = a * np.arctanh(height / length)  # of both ends, from the lowest point
        ends = middle + 0.5 * width * np.array([-1.0, 1.0])
        drop = a * np.cosh(ends[0] / a) - a * np.cosh(np.clip(0.0, *ends) / a)
        lowest = catenary.lowest_height(s, first)
        assert lowest.v[0, 0] == pytest.approx(bottom - drop, abs=1e-6)
        assert lowest.low[0] == pytest.approx(bottom - drop, abs=1e-5)


@pytest.mark.parametrize(
    ("limit", "verdict"), [(-1e-6, "proven"), (0.0, "not proven"), (1e-6, "violated")]
)
def test_what_stays_undecided_is_not_proven(limit: float, verdict: str) -> None:
    """A parabola touches the limit of zero, so that no width of spans decides."""
    plan: Any = SimpleNamespace(h=np.ones(1), breaks=np.arange(2.0), only=(), effort=Effort(10**6))
    line = np.linspace(-0.3, 0.7, 6)
    plan.points = Curve(np.tile(line, (1, 1, 3, 1)), plan.h)
    first = np.zeros(1, dtype=int)
    s = Spans(plan, first, first[:, None], np.full(1, 0.5), np.full(1, 0.5), (["q0"],))
    row = prove("height 1 min", limit, s, lambda s, i: s.point(i)[0] * s.point(i)[0])
    assert row.verdict == verdict
    assert 0.0 <= row.worst < 1e-3


@WIDE
@pytest.mark.slow
@pytest.mark.parametrize("width", [0.1, 0.01])
def test_hanging_cables_move_no_farther_than_told(width: float) -> None:
    for seed in range(2):
        s = spans_of(seed, width, 0.0)
        k = s.item[:, 0]
        links = catenary.catenary_links(s, k)
        cable, far = links.cable, links.sag
        lowest, pull = catenary.lowest_height(s, k), catenary.catenary_force(s, 2 * k)
        length = sum(arithmetic.norm(b.v - a.v) for a, b in pairwise(cable))
        assert length == pytest.approx(60.0 * np.ones(8), rel=0.01)
        for share in np.linspace(-1.0, 1.0, 5):
            there = s.subspan(float(share), 1e-9)
            for x in catenary.catenary_links(there, k).cable[::40]:
                ways = [shapes.closest(x.v, x.v, a.v, b.v) for a, b in pairwise(cable)]
                apart = np.min([arithmetic.norm(way) for way in ways], axis=0)
                assert not np.any(
                    apart > far[:, 0] + np.max([y.deviation for y in cable], axis=0) + 1e-9
                )
            assert not np.any(catenary.lowest_height(there, k).v[:, 0] < lowest.low - 1e-9)
            off = catenary.catenary_force(there, 2 * k).v - pull.v
            assert not np.any(arithmetic.norm(off) > pull.deviation)
