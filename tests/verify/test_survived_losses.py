"""The verifier proves what remains after losses by its own arithmetic, and refuses lies."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hitchopt as ho
from hitchopt import verify as second
from hitchopt.motion.plan_file import write_plan
from hitchopt.verify import Row
from hitchopt.verify.losses import Pairs, clasped_first, moves
from hitchopt.verify.reading import read

Content = dict[str, Any]


@cache
def plan(robots: int, length: float, density: float) -> ho.Plan:
    team = ho.Team(
        *(robots, length),
        tension=0.3,
        cable_density=density,
        release=True,
        quadrotor=ho.Quadrotor(stiffness=4.75),
    )
    corners = ho.regular_polygon(robots, 1.1).vertices
    start = ho.Hitch.balanced(team, corners, 1.6)
    moved = corners + 0.1 * np.eye(robots)[:, :1]
    steps = [ho.Morph(moved), ho.Transport(to=[0.4, 0.2, 1.6], yaw=0.3)]
    return ho.solve(start, steps, limits=ho.Limits(survive="cable"))


def rows_of(folder: Path) -> dict[str, Row]:
    return {row.name: row for row in second.verify(folder)}


@pytest.mark.parametrize(
    ("robots", "length", "density"),
    [(3, 2.4, 0.0), (3, 2.5, 0.005), pytest.param(5, 2.0, 0.0, marks=pytest.mark.slow)],
)
def test_both_prove_that_losses_are_survived(
    robots: int, length: float, density: float, tmp_path: Path
) -> None:
    own = plan(robots, length, density)
    rows = rows_of(own.save(tmp_path, picture=False))
    assert {row.verdict for row in rows.values()} <= second.PASSING
    for name in ("survivable", "loss_displacement"):
        check = own.certificate[name]
        row = rows[name]
        assert (row.unit, row.sense) == (check.unit, check.sense)
        assert row.limit == pytest.approx(check.limit)
        assert row.worst == pytest.approx(check.worst, rel=1e-4)
    assert rows["after_loss"].verdict == "proven"


def _other_drones(content: Content) -> None:
    ways = content["after_loss"]["robots"][1]["ways"]
    content["after_loss"]["robots"][1]["ways"] = {"q0": ways["q2"], "r2": ways["r0"]}


def _shorter_way(content: Content) -> None:
    content["after_loss"]["robots"][0]["ways"]["q1"] -= 0.1


def _sooner(content: Content) -> None:
    content["after_loss"]["robots"][2]["seconds"] *= 0.5


def _never(content: Content) -> None:
    del content["after_loss"]["robots"][2]["seconds"]


def _robot_left_out(content: Content) -> None:
    del content["after_loss"]["robots"][2]


def _lighter_drone(content: Content) -> None:
    (check,) = [each for each in content["checks"] if each["name"] == "loss_displacement"]
    check["worst"] *= 0.9


def _unsaid(content: Content) -> None:
    content["checks"] = [each for each in content["checks"] if each["name"] != "survivable"]


@pytest.mark.parametrize(
    "lie",
    [_other_drones, _shorter_way, _sooner, _never, _robot_left_out, _lighter_drone, _unsaid],
)
def test_lies_of_the_certificate_are_refused(
    lie: Callable[[Content], None], tmp_path: Path
) -> None:
    path = plan(3, 2.4, 0.0).save(tmp_path, picture=False) / "certificate.json"
    content = json.loads(path.read_text("utf-8"))
    lie(content)
    path.write_text(json.dumps(content), "utf-8")
    assert rows_of(tmp_path)["after_loss"].verdict == "violated"


def _requirements(own: ho.Plan, **limits: object) -> ho.Motion:
    values = {"survive": "cable", "tracking": 0.06428} | limits
    need = replace(own.motion.requirements, limits=ho.Limits(**values))  # type: ignore[arg-type]
    return own.motion.replaced(requirements=need)


def test_lies_of_the_plan_are_refused(tmp_path: Path) -> None:
    """A smaller tracking error than drones jump by, and ends of a hexagon that would meet."""
    file = tmp_path / "plan.npz"
    write_plan(file, ho.Flight.of(_requirements(plan(3, 2.4, 0.0), tracking=0.05)))
    assert rows_of(tmp_path)["loss_displacement"].verdict == "violated"
    legs, others = np.full(6, 0.3), np.full(6, 0.3)
    legs[1] = others[5] = 0.8
    quadrotor = ho.Quadrotor(stiffness=4.75)
    team = ho.Team(6, 1.0 + legs + others, tension=0.3, release=True, quadrotor=quadrotor)
    hexagon = ho.Hitch(team, ho.regular_polygon(6, 1.0), 1.6, legs)
    held = ho.solve(hexagon, ho.Hold(0.5))
    write_plan(file, ho.Flight.of(_requirements(held, tracking=0.065)))
    assert rows_of(tmp_path)["survivable"].verdict == "violated"


@pytest.mark.parametrize("n", [3, 4, 5])
def test_all_that_may_meet_after_a_loss_is_compared(n: int, tmp_path: Path) -> None:
    """Pairs by counting: 2n drones move, of which two after one loss, in which two drones leave.

    The others' n - 1 cables are those of both, and n - 3 that keep their clasps.
    """
    folder = plan(n, 2.4 if n == 3 else 2.2, 0.0).save(tmp_path, picture=False)
    ((own,), _) = read(folder / "plan.npz")
    rows = moves(own)
    pairs = Pairs.of(own, rows)
    moved, drones, whole = 2 * n, 2 * n, n - 3
    assert {name: len(items) for name, items in pairs._asdict().items()} == {
        "others": moved * (drones - 3),
        "both": moved,
        "leaving": moved * 2,
        "staying": drones * (drones - 2),
        "beside": moved * whole,
        "leave_beside": drones * whole,
        "stay_beside": n * {3: 0, 4: 4, 5: 8}[n],  # drones of other cables than a whole one
        "whole": {3: 0, 4: 0, 5: 5}[n],  # of a pentagon, two neighbours
    }
    ends = clasped_first(own, pairs.both, rows.drone[pairs.both] // 2)
    shared = {3: moved, 4: 0, 5: 0}[n]  # both loose cables of a triangle share a clasp
    assert [len(items) for items in ends] == [shared, moved - shared]
