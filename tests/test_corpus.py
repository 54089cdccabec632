"""The corpus: what it stores of a plan, and what it says of two of them."""

from __future__ import annotations

import copy
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks import corpus
from hitchopt.trajectory import bernstein
from tests.helpers.plans import PROBLEMS, planned


def store(folder: Path, data: dict[str, Any], curves: corpus.Curves) -> Path:
    folder.mkdir(exist_ok=True)
    (folder / "one.json").write_text(json.dumps(data))
    np.savez(folder / "one.npz", allow_pickle=False, **curves)
    return folder


def stored(name: str) -> tuple[dict[str, Any], corpus.Curves]:
    plan = planned(name)
    groups, curves = corpus.contents(plan.flight)
    data = {"exit": 0, "message": [], **plan.certificate.to_dict(), "groups": groups}
    return json.loads(json.dumps(data)), curves


def outcome(capsys: pytest.CaptureFixture[str], a: Path, b: Path) -> tuple[int, str]:
    code = corpus.compare(a, b, ["*"], 1e-6)
    return code, capsys.readouterr().out


@pytest.mark.parametrize(
    ("statement", "said"),
    [
        ("c['team/drones'][2, 5, 3] += 1e-8", "within\n    team/drones: 1e-08 at piece 2"),
        ("c['team/drones'][2, 5, 3] += 1e-5", "differs\n    team/drones: 1e-05 at piece 2"),
        ("c['team/breaks'][-1] += 1e-5", "differs\n    team/breaks: 1e-05 at piece"),
        ("c['team/legs'] = c['team/legs'][1:]", "differs\n    team/legs: shapes ("),
        ("del c['team/legs']", "differs\n    team/legs: shapes none, ("),
        ("d['duration'] += 1e-3", "differs\n    duration: "),
        ("d['checks'][4]['worst'] += 1e-9", "within\n    check.acceleration.worst: "),
        ("d['checks'][4]['worst'] += 1e-5", "differs\n    check.acceleration.worst: "),
        ("d['checks'][0]['where'] = ['q1', 'r0']", "within\n    check.separation.where"),
        ("d['checks'][0]['holds'] = False", "differs\n    check.separation.holds: False, True"),
        ("del d['checks'][1]", "differs\n    check.cable_clearance: None, {"),
        (
            "d['groups']['team'][0]['states'][1] = 'rolling'",
            "differs\n    groups.team[0].states[1]",
        ),
        ("d['message'] = ['warning: so heavy']", "differs\n    message: "),
        ("d['exit'] = 3", "differs\n    exit: 3, 0"),
        ("for x in d['checks']: x['worst'] = 1e9", "and 10 more"),
        ("pass", "equal"),
    ],
)
def test_every_difference_is_named(
    statement: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data, curves = stored("triangle")
    changed = copy.deepcopy((data, curves))
    exec(statement, {"d": changed[0], "c": changed[1]})
    a, b = store(tmp_path / "a", *changed), store(tmp_path / "b", data, curves)
    code, text = outcome(capsys, a, b)
    assert said in text
    assert code == ("differs\n" in text)


@pytest.mark.parametrize("name", ["friction", "move_vertex", "open_arc"])
def test_a_curve_that_is_left_out_equals_its_default(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Such as later versions may write, in any degree; others differ."""
    data, curves = stored(name)
    motion = planned(name).motion
    ends = (motion.drones.pieces, 6 * motion.team.robots, -1)
    stated = {
        "leg_tensions": np.repeat(curves["team/tensions"], 2, axis=1),
        "contacts": motion.contacts.coefficients.reshape(ends),
        "load_share": np.zeros((motion.drones.pieces, 2, 1)),
        "poses": np.tile(np.arange(10.0)[None, :, None], (motion.drones.pieces, 1, 3)),
    }
    full = {f"team/{key}": corpus.elevated(curve, 9) for key, curve in stated.items()} | curves
    a, b = store(tmp_path / "a", data, curves), store(tmp_path / "b", data, full)
    for pair in ((a, b), (b, a)):
        code, text = outcome(capsys, *pair)
        assert (code, "differs:" in text) == (0, True), text
    for key in full.keys() - curves.keys():
        wrong = full[key].copy()
        wrong[1, 0, 0] += 1e-3
        code, text = outcome(capsys, a, store(tmp_path / "c", data, full | {key: wrong}))
        assert (code, key in text) == (1, True)


def test_elevated_coefficients_are_those_of_the_same_polynomial() -> None:
    c, t = np.array([[2.0, -1.0, 0.5, 4.0], [0.0, 1.0, 0.0, 0.0]]), np.linspace(0.0, 1.0, 7)
    values = bernstein.evaluate(c[:, None], t)
    assert bernstein.evaluate(corpus.elevated(c, 9)[:, None], t) == pytest.approx(values)


def run(*arguments: object) -> int:
    return corpus.main([*map(str, arguments)])


@pytest.mark.slow
def test_problems_are_planned_and_compared(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    names = ("move_vertex", "infeasible/tilt_too_small", "bad/two_robots")
    for folder in "ab":
        assert run("-o", tmp_path / folder, "--only", *names) == 0
    assert "move_vertex: exit code 0" in capsys.readouterr().out
    codes = [json.loads((tmp_path / "a" / f"{name}.json").read_text())["exit"] for name in names]
    assert codes == [0, 3, 2]
    with np.load(tmp_path / "a" / "move_vertex.npz") as arrays:
        drones = planned("move_vertex").motion.drones.coefficients
        assert arrays["team/drones"].reshape(drones.shape) == pytest.approx(drones, abs=1e-9)
    assert run("--compare", tmp_path / "a", tmp_path / "b") == 0
    assert "equal: 3, within: 0, differs: 0" in capsys.readouterr().out
    (tmp_path / "b" / "bad" / "two_robots.json").unlink()
    assert run("--compare", tmp_path / "a", tmp_path / "b") == 1
    assert run("--compare", tmp_path / "a", tmp_path / "b", "--only", "move*") == 0
    with pytest.raises(SystemExit):
        run("-o", tmp_path / "c", "--package", PROBLEMS)
