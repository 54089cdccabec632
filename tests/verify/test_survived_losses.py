"""The verifier proves what remains after losses by its own arithmetic, and refuses lies."""

from __future__ import annotations

import json
import math
import shutil
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

import hitchopt as ho
from hitchopt import verify as second
from hitchopt.cli import main
from hitchopt.directory import certificate_content, certificate_differences
from hitchopt.hitch.losses import Losses, places_after_loss
from hitchopt.losses.table import after_loss
from hitchopt.motion.plan_file import write_plan
from hitchopt.storage.files import strict_json
from hitchopt.verify import Row
from hitchopt.verify.losses import (
    AfterLosses,
    Pairs,
    clasped_first,
    losses,
    moves,
    read_stated,
    taut_pieces,
)
from hitchopt.verify.reading import read
from tests.helpers.survivors import BOUNDS, at_bound, below_a_whole_cable

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


def test_without_a_taut_hitch_no_loss_is_checked(tmp_path: Path) -> None:
    motion = plan(3, 2.4, 0.0).motion
    slack = motion.tensions.replaced(0.5 * motion.tensions.coefficients)
    write_plan(tmp_path / "plan.npz", ho.Flight.of(motion.replaced(tensions=slack)))
    row = rows_of(tmp_path)["survivable"]
    assert (row.verdict, row.sense, row.limit) == ("nothing to check", "min", 1.0)


Saved = tuple[Path, ho.Plan, second.Plan]  # A plan in a folder, and as the verifier reads it


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> Saved:
    folder = tmp_path_factory.mktemp("saved")
    own = plan(3, 2.4, 0.0)
    own.save(folder, picture=False)
    ((read_plan,), _) = read(folder / "plan.npz")
    return folder, own, read_plan


def recomputed(own: ho.Plan, folder: Path) -> Content:
    return certificate_content(own.flight, own.certificate, folder / "plan.npz")


def believers(text: str, tmp_path: Path, saved: Saved) -> set[str]:
    """Return which of both commands believe a certificate, by what they compare."""
    folder, own, read_plan = saved
    shutil.copy(folder / "plan.npz", tmp_path)
    (tmp_path / "certificate.json").write_text(text, "utf-8")
    found = set[str]()
    if not certificate_differences(tmp_path, recomputed(own, tmp_path)):
        found.add("check")
    try:
        stated = read_stated(tmp_path / "plan.npz", [read_plan])
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError):
        return found
    rows = losses(read_plan, stated)
    row = next(row for row in rows if row.name == "after_loss")
    return found | {"verify"} if row.verdict == "proven" else found


def drawn_lie(rng: np.random.Generator, content: Content) -> None:
    """Change what a certificate states of losses, by a drawn kind, robot, drone and number."""
    table = content["after_loss"]
    row = table["robots"][rng.integers(len(table["robots"]))]
    drone = sorted(row["ways"])[rng.integers(2)]
    wrong: Any = [math.nan, math.inf, -0.5, None, "0.7", True, [0.7], {}][rng.integers(8)]
    share = float(rng.choice([rng.uniform(0.2, 0.995), rng.uniform(1.05, 3.0)]))
    (jump,) = [each for each in content["checks"] if each["name"] == "loss_displacement"]
    (survived,) = [each for each in content["checks"] if each["name"] == "survivable"]
    low = {**row, "ways": dict.fromkeys(row["ways"], 0.01), "seconds": 0.1}
    lies: list[Callable[[], object]] = [
        lambda: row["ways"].update({drone: row["ways"][drone] * share}),
        lambda: row["ways"].update({drone: wrong}),
        lambda: row["ways"].pop(drone),
        lambda: row["ways"].update({"q9": 0.5}),
        lambda: row.update(ways={"q0": 0.6, "q1": 0.6}),
        lambda: row.update(ways=[0.6, wrong]),
        lambda: row.update(seconds=row["seconds"] * rng.uniform(0.05, 0.5)),
        lambda: row.update(seconds=wrong),
        lambda: row.pop("seconds"),
        lambda: row.update(robot=["9", "a.0", 0, "", None][rng.integers(5)]),
        lambda: row.update(remains="a hitch of three robots"),
        lambda: table["robots"].insert(rng.integers(4), low),
        lambda: table["robots"].append({**low, "robot": "9"}),
        lambda: table["robots"].remove(row),
        lambda: table.update(phases=["morph"]),
        lambda: table.update(assumes="nothing"),
        lambda: table.update(robots=wrong),
        lambda: content.update(after_loss=wrong),
        lambda: content.pop("after_loss"),
        lambda: jump.update(worst=jump["worst"] * rng.uniform(0.1, 0.9)),
        lambda: content["checks"].remove(survived),
        lambda: content["checks"].append({**jump, "worst": 0.001}),
    ]
    lies[rng.integers(len(lies))]()


@pytest.mark.parametrize("seed", range(40))
def test_no_forged_table_is_believed(seed: int, tmp_path: Path, saved: Saved) -> None:
    folder, own, _ = saved
    content = json.loads(strict_json(recomputed(own, folder)))
    assert believers(json.dumps(content), tmp_path, saved) == {"check", "verify"}
    drawn_lie(np.random.default_rng(seed), content)
    assert not believers(json.dumps(content), tmp_path, saved)


@pytest.mark.parametrize("share", [0.9, 0.99, 1.01, 1.5, 100.0])
def test_check_recomputes_times_that_verify_only_bounds_from_below(
    share: float, tmp_path: Path, saved: Saved
) -> None:
    folder, own, _ = saved
    content = json.loads(strict_json(recomputed(own, folder)))
    row = content["after_loss"]["robots"][1]
    row["seconds"] *= share
    assert "check" not in believers(json.dumps(content), tmp_path, saved)


@pytest.mark.parametrize(
    "text",
    [
        *("", "{", "[]", "5", "null", '"certificate"', "\x00", "{}", "[" * 100_000),
        *('{"checks": 5}', '{"checks": [5]}', '{"checks": [{}]}', '{"checks": null, "plan": 5}'),
        '{"checks": [], "after_loss": {"robots": []}}',
    ],
)
def test_malformed_certificates_are_refused_in_words(
    text: str, tmp_path: Path, saved: Saved
) -> None:
    assert not believers(text, tmp_path, saved)
    with pytest.raises(second.UnreadableError, match=r"certificate\.json: "):
        next(second.verify(tmp_path))


@pytest.mark.parametrize("checks", [None, [1], [{"worst": 1}], [{"name": []}], {"a": 1}, "all"])
def test_malformed_checks_are_refused_by_both_commands(
    checks: object, tmp_path: Path, saved: Saved
) -> None:
    folder, own, _ = saved
    content = recomputed(own, folder) | {"checks": checks}
    assert not believers(json.dumps(content), tmp_path, saved)
    for command, code in (("check", 3), ("verify", 2)):
        done = CliRunner().invoke(main, [command, str(tmp_path)])
        assert done.exit_code == code, done.output
        assert "certificate.json" in done.stderr


def test_stated_paths_suffice(saved: Saved) -> None:
    """They are rounded up, so that samples of the plan's motion find no longer ones."""
    _, own, _ = saved
    motion = own.motion
    rows = Losses.of(motion.team.layout)
    times = np.random.default_rng(2).uniform(0.0, motion.duration, 400)
    arrays = (motion.drones.at(times), motion.vertices.at(times), motion.tensions.at(times))
    places, _ = places_after_loss(motion.team, *arrays)
    sampled = np.max(np.linalg.norm(places - arrays[0][:, rows.drone], axis=-1), axis=0)
    for row in after_loss(own.flight)["robots"]:
        for drone, way in row["ways"].items():
            place = motion.team.drone_names.index(drone)
            (index,) = np.flatnonzero((rows.drone == place) & (rows.lost == int(row["robot"])))
            assert sampled[index] <= way <= 1.01 * sampled[index] + 1e-4


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


def after_losses_of(motion: ho.Motion, tmp_path: Path) -> AfterLosses:
    write_plan(tmp_path / "plan.npz", ho.Flight.of(motion))
    ((own,), _) = read(tmp_path / "plan.npz")
    return AfterLosses(own, moves(own), taut_pieces(own))


@pytest.mark.parametrize("bound", BOUNDS)
@pytest.mark.parametrize("margin", [4e-3, -4e-3])
def test_losses_are_proven_just_within_a_bound(bound: str, margin: float, tmp_path: Path) -> None:
    verdicts = {row.verdict for row in after_losses_of(at_bound(bound, margin), tmp_path).proofs()}
    assert verdicts == {"proven"} if margin > 0.0 else "violated" in verdicts


def test_drones_that_rise_below_a_cable_touch_it(tmp_path: Path) -> None:
    rows = after_losses_of(below_a_whole_cable(), tmp_path).clearances()
    assert ("q0, cable 2", "violated") in {(row.where, row.verdict) for row in rows}
