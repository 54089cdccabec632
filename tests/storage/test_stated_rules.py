"""Saved plans state custom rules as not recomputed, and are else as without rules."""

from __future__ import annotations

import json
import pickle
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

import hitchopt as ho
from hitchopt.checks import CertificateError
from hitchopt.cli import main
from hitchopt.errors import FileError
from hitchopt.plan import read_requested_plan
from hitchopt.verify import UnreadableError, verify

TEAM = ho.Team(robots=3, cable_length=2.4)
START = ho.Hitch.spread(TEAM, [[0, -0.5], [-0.4, 0.5], [0.4, 0.5]])
GOAL = [[0, -0.6], [-0.4, 0.5], [0.4, 0.5]]
LEG_ANGLE = ho.Rule(
    "leg_angle", "deg", "min", 35.0, ho.ClaspSpans, lambda clasp: clasp.q_leg.angle_to(clasp.r_leg)
)
CEILING = ho.Rule("ceiling", "m", "max", 1.5, ho.DroneSpans, lambda drone: drone.position[2])
RULES: list[ho.Rule[Any]] = [LEG_ANGLE, CEILING]


@cache
def plan() -> ho.Plan:
    """Return a plan that keeps two rules."""
    return ho.solve(START, ho.Morph(GOAL), team=TEAM, rules=RULES)


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    """Save the plan."""
    return plan().save(tmp_path / "ruled")


def settings_of(folder: Path) -> dict[str, Any]:
    """Return the settings of a plan file."""
    with np.load(folder / "plan.npz") as file:
        settings: dict[str, Any] = json.loads(str(file["settings"]))
    return settings


def alter(folder: Path, change: Callable[[dict[str, Any]], object]) -> None:
    """Change the settings of a plan file."""
    settings, path = settings_of(folder), folder / "plan.npz"
    change(settings)
    with np.load(path) as file:
        arrays = {name: file[name] for name in file}
    np.savez(path, allow_pickle=False, **(arrays | {"settings": np.array(json.dumps(settings))}))


def run(*arguments: object) -> tuple[int, str]:
    """Return exit code and output of a command."""
    result = CliRunner().invoke(main, [*map(str, arguments)])
    return result.exit_code, result.output


def test_loaded_plans_list_rules_as_not_recomputed_until_they_are(saved: Path) -> None:
    loaded = ho.load(saved)
    angle, ceiling = loaded.certificate.not_recomputed
    assert angle.worst == plan().certificate["leg_angle"].worst
    assert (angle.name, angle.unit, angle.sense, angle.limit) == ("leg_angle", "deg", "min", 35.0)
    assert (ceiling.worst, ceiling.limit) == (plan().certificate["ceiling"].worst, 1.5)
    with pytest.raises(KeyError):  # no check, which would hold or not
        loaded.certificate["leg_angle"]
    content = loaded.certificate.to_dict()
    assert content["not_recomputed"][0]["worst"] == angle.worst
    assert "not recomputed: leg_angle (39." in loaded.certificate._repr_html_()
    assert repr(loaded).endswith("limits hold, 2 not recomputed)")
    one = ho.certify(loaded, rules=[LEG_ANGLE])
    assert one["leg_angle"] == plan().certificate["leg_angle"]
    assert [rule.name for rule in one.not_recomputed] == ["ceiling"]
    assert ho.certify(loaded, rules=RULES).checks == ho.certify(plan(), rules=RULES).checks
    assert ho.certify(loaded.flight).not_recomputed == ()
    stricter = replace(LEG_ANGLE, limit=60.0)
    assert [x.name for x in ho.certify(loaded, rules=[stricter]).violated] == ["leg_angle"]


def test_plans_are_saved_again_as_they_were(saved: Path, tmp_path: Path) -> None:
    ho.load(saved).save(tmp_path / "again")
    first, again = (folder / "plan.npz" for folder in (saved, tmp_path / "again"))
    assert first.read_bytes() == again.read_bytes()
    assert ho.load(saved).draw(saved).exists()  # the picture of the same plan
    assert pickle.loads(pickle.dumps(ho.load(saved))).certificate.not_recomputed


def test_plans_without_rules_state_nothing(saved: Path, tmp_path: Path) -> None:
    bare = ho.solve(START, ho.Morph(GOAL), team=TEAM)
    bare.save(tmp_path / "bare")
    assert [*settings_of(tmp_path / "bare")] == ["title", "problem", "request", "groups", "others"]
    content = json.loads((tmp_path / "bare" / "certificate.json").read_text())
    assert [*content] == ["format", "certified", "duration", "checks", "plan", "tables"]
    assert not any("custom" in check for check in content["checks"])
    ruled = settings_of(saved)
    assert [rule["name"] for rule in ruled.pop("rules")] == ["leg_angle", "ceiling"]
    assert ruled == settings_of(tmp_path / "bare")
    for name in ("setpoints.csv", "vertices.csv"):
        assert (saved / name).read_bytes() == (tmp_path / "bare" / name).read_bytes()


def test_the_certificate_that_is_saved_marks_rules(saved: Path) -> None:
    checks = json.loads((saved / "certificate.json").read_text())["checks"]
    assert [x["name"] for x in checks if x.get("custom")] == ["leg_angle", "ceiling"]


def test_check_and_verify_list_rules_as_not_recomputed(saved: Path) -> None:
    code, output = run("check", saved)
    assert code == 0
    assert (
        "not recomputed: leg_angle (39.97 deg, limit ≥ 35 deg), ceiling (1 m, limit ≤ 1.5 m)"
        in output
    )
    assert f"certified; recomputed from {saved / 'plan.npz'}, but not leg_angle, ceiling" in output
    code, output = run("check", saved, "--json")
    certificate = json.loads(output)["certificate"]
    assert "leg_angle" not in [check["name"] for check in certificate["checks"]]
    assert [x["name"] for x in certificate["not_recomputed"]] == ["leg_angle", "ceiling"]
    code, output = run("verify", saved)
    assert code == 0
    assert output.rstrip().endswith("times; not recomputed: leg_angle, ceiling")
    rows = {row.name: row for row in verify(saved)}
    assert {row.verdict for row in rows.values()} == {"proven", "not recomputed"}
    assert rows["ceiling"].worst == ho.load(saved).stated_rules[1].worst
    assert run("verify", saved, "--json")[0] == 0


def test_exports_say_that_rules_are_not_recomputed(saved: Path, tmp_path: Path) -> None:
    code, output = run("export", saved, "--format", "csv", "-o", tmp_path / "csv")
    assert code == 0
    assert "note: custom rules are not recomputed in the export: leg_angle, ceiling" in output


def test_plans_that_violate_a_rule_are_neither_saved_nor_exported(tmp_path: Path) -> None:
    broken = replace(plan(), certificate=ho.certify(plan(), rules=[replace(CEILING, limit=0.5)]))
    for write in (broken.save, lambda folder: broken.export("csv", folder)):
        with pytest.raises(CertificateError, match="ceiling: 1 m is above the limit"):
            write(tmp_path / "broken")
    assert not (tmp_path / "broken").exists()


def test_other_flights_of_a_plan_do_not_claim_its_rules() -> None:
    abort = plan().abort(0.1)
    assert [(x.name, x.worst) for x in abort.stated_rules] == [
        ("leg_angle", None),
        ("ceiling", None),
    ]
    moved = ho.solve(START, ho.Transport([5.0, 0.0, 1.0]))
    both = ho.combine(plan(), moved, at=2.0)
    assert both.certificate.not_recomputed == plan().stated_rules


def test_rules_without_items_have_no_worst_value(tmp_path: Path) -> None:
    team = ho.Swarm(2)
    start, goal = [[0, 0, 1], [2, 0, 1]], [[0, 1, 1], [2, 1, 1]]
    plan = ho.solve(start, ho.Fly(goal), team=team, rules=[LEG_ANGLE])
    folder = plan.save(tmp_path)
    (rule,) = ho.load(folder).stated_rules
    assert rule.worst is None
    assert "leg_angle (no value, limit ≥ 35 deg)" in run("check", folder)[1]
    assert run("verify", folder)[0] == 0


LIES: list[tuple[str, Callable[[dict[str, Any]], object], bool]] = [
    ("a check's name", lambda rule: rule.update(name="separation"), False),
    ("an invalid name", lambda rule: rule.update(name="Leg angle"), False),
    ("no limit", lambda rule: rule.pop("limit"), True),
    ("a limit of another type", lambda rule: rule.update(limit="35"), True),
    ("a verdict", lambda rule: rule.update(holds=True), True),
    ("another sense", lambda rule: rule.update(sense="above"), True),
]


@pytest.mark.parametrize(("words", "change", "is_form"), LIES, ids=[words for words, *_ in LIES])
def test_damaged_rules_are_refused(
    words: str, change: Callable[[dict[str, Any]], object], is_form: bool, saved: Path
) -> None:
    alter(saved, lambda settings: change(settings["rules"][0]))
    with pytest.raises(FileError):
        read_requested_plan(saved / "plan.npz")
    assert run("check", saved)[0] == 2, words
    assert run("verify", saved)[0] == 2
    if is_form:
        with pytest.raises(UnreadableError):
            list(verify(saved))


@pytest.mark.parametrize(("sense", "worst"), [("max", 99.0), ("min", 9.0)])
def test_a_rule_that_its_own_record_violates_is_violated(
    saved: Path, sense: str, worst: float
) -> None:
    def change(settings: dict[str, Any]) -> None:
        settings["rules"] = [
            {"name": "leg_angle", "unit": "deg", "sense": sense, "limit": 10.0, "worst": worst}
        ]

    alter(saved, change)
    loaded = ho.load(saved)
    assert [check.name for check in loaded.certificate.violated] == ["leg_angle"]
    with pytest.raises(CertificateError, match="leg_angle: "):
        loaded.save(saved.parent / "again")
    loaded.report(saved.parent / "shown")
    assert not ho.combine(loaded, plan(), at=100.0).certificate.certified
    for command in ("check", "verify"):
        code, output = run(command, saved)
        assert (code, "leg_angle" in output) == (3, True)


def test_other_limits_do_not_replace_stated_rules(saved: Path, tmp_path: Path) -> None:
    loaded = ho.load(saved)
    others = (
        replace(LEG_ANGLE, limit=1.0),
        replace(LEG_ANGLE, limit=179.0, sense="max"),
        replace(LEG_ANGLE, limit=0.1, unit="m", formula=lambda clasp: clasp.q_leg.norm),
    )
    for other in others:
        found = ho.certify(loaded, rules=[other, CEILING])
        assert [rule.limit for rule in found.not_recomputed] == [35.0]
        ho.Plan(loaded.flight, found).save(tmp_path / "again")
        again = ho.load(tmp_path / "again").certificate.not_recomputed
        stated = [(rule.unit, rule.limit) for rule in again if rule.name == "leg_angle"]
        assert stated == [(other.unit, other.limit), ("deg", 35.0)]
